"""The learned residual correction: rows for the trainer, the guard before a new network, and the network in use.

Source: Zhang et al. 2022 (UKF multi-step + BP), eq. (15)-(17): a 50-10-1 network maps the last 50 observer outputs X*
to the residual (laser - X*), and the published heave is X~ = X* + y. Training happens elsewhere; here is what keeps a
learned correction from ever making the output worse than the physics underneath it:

* nothing is learned while the laser does not follow the heave at all (stuck, wrong sign, on another target);
* the last part of each window is held out, and a network replaces the one in use only if it beats it, and
  "no correction", there; a window of which a regression says that no network will is not trained at all;
* while the laser is there, the running correlation of the correction with the residual decides how much of it is
  applied: nothing unless its regression coefficient is two standard errors above zero, counted for a residual that
  beats; then the coefficient, up to 1;
* without the laser it goes on only while the sea resembles that of the training;
* a network is dropped when what it corrects has become another output: a lead, a gain or axes that are learned take
  out what it was trained to take out, and it would take it out once more, for as long as no laser says so;
* it is clipped and faded, never switched.
"""

from __future__ import annotations

from math import exp, hypot, inf, isfinite, nan, sqrt
from typing import Annotated, Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.ring import RingBuffer
from heaved.estimation.heave.laser.network import Network
from heaved.estimation.heave.laser.ridge import Rows, can_gain
from heaved.estimation.heave.observer import Verdict
from heaved.samples import CorrectionState, TrainedNetwork, TrainingWindow

Array = NDArray[np.float64]


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[correction]``: the network and its training."""

    enabled: bool = True
    taps: Annotated[int, msgspec.Meta(ge=2, le=500)] = 50
    """Observer outputs that go in (d)."""
    step_s: Annotated[float, msgspec.Meta(ge=0.01, le=1)] = 0.1
    """Spacing of the inputs; taps * step_s should span 2.5-5 s."""
    hidden: Annotated[int, msgspec.Meta(ge=1, le=100)] = 10
    output: Literal["linear", "sigmoid"] = "linear"
    learning_rate: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.01
    epochs: Annotated[int, msgspec.Meta(ge=1, le=100_000)] = 1000
    window_s: Annotated[float, msgspec.Meta(ge=30, le=3600)] = 200.0
    """Seconds of laser that a training sees at most."""
    min_laser_s: Annotated[float, msgspec.Meta(ge=20, le=3600)] = 60.0
    """Seconds of laser before the first training."""
    period_s: Annotated[float, msgspec.Meta(ge=5, le=3600)] = 30.0
    """Interval of trainings while the laser is there."""
    clip: Annotated[float, msgspec.Meta(gt=0, le=10)] = 3.0
    """Bound on the correction, in RMS residuals of its training."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What is set for the guard. Ratios have no unit; times of the laser count only while it is there."""

    holdout: float = 0.25
    """Share of the rows, the newest, on which a network is judged."""
    worth: float = 0.9
    """A network must take at least 10 % off the mean square of the held-out residuals: less can be chance."""
    guard_time_s: float = 90.0
    """Memory of the running comparison of correction and residual, in seconds of laser."""
    independent_s: float = 10.0
    """Residuals this far apart count as independent: they are narrow-banded, and grow and fade over several waves."""
    sure: tuple[float, float] = (2.0, 2.5)
    """Coefficient over its standard error: below the first the agreement with the residual can be chance, and nothing
    is applied; from the second on all that the coefficient says. With a minute and a half of laser: three tenths and
    four tenths of the residual's mean square; networks with less, seen on sensors whose lag the laser had taught, do
    harm as often as good."""
    agreement_time_s: float = 15.0
    """Memory of the comparison of residual and heave: two wave periods."""
    disagreement: float = 0.8
    """RMS residual over RMS heave above which there is nothing to learn: 1 is a stuck laser, 2 one of wrong sign. The
    harmonic observer is at 0.5 on the broadest of seas."""
    sea_time_s: float = 30.0
    """Memory of the variance that is compared with that of the training."""
    fade_s: float = 2.0
    """Time constant of fading in and out."""
    same_amplitude: tuple[float, float] = (1.5, 2.2)
    """Ratio of the RMS heave to that of the training, either way: below the first the same sea, above the second
    not."""
    same_frequency: tuple[float, float] = (1.12, 1.3)
    """The same for the dominant frequency."""
    moved: float = 0.3
    """A network is dropped when its observer's output has been moved by that share of the RMS residual that it was
    trained on: its correction is then off by as much."""


TUNING: Final = Tuning()


class SavedNetwork(msgspec.Struct, frozen=True, kw_only=True):
    """What a restart remembers of the network in use."""

    weights: bytes
    width: int
    hidden: int
    output: str
    step_s: float
    input_std_m: float
    omega_radps: float
    limit_m: float


class _Pending(msgspec.Struct, frozen=True, eq=False):
    """A window that is with the trainer: what its network will be judged on, and what the sea was like."""

    number: int
    held: Rows
    bar_m2: float
    """Mean square of the held-out residuals, less what the network in use takes off it."""
    limit_m: float
    input_std_m: float
    omega_radps: float


class _Evidence:
    """Running moments of the correction y and the residual e, over ``guard_time_s`` of laser."""

    def __init__(self, seconds: float = 0.0, square: float = 0.0, cross: float = 0.0, total: float = 0.0) -> None:
        self._seconds = seconds
        self._square, self._cross, self._total = square, cross, total
        self._t_s = nan

    def push(self, t_s: float, residual_m: float, correction_m: float) -> None:
        dt = min(t_s - self._t_s, 0.5) if isfinite(self._t_s) else 0.0
        self._t_s = t_s
        self._seconds = min(self._seconds + dt, TUNING.guard_time_s)
        memory = dt / self._seconds if self._seconds > 0.0 else 0.0
        self._square += memory * (correction_m**2 - self._square)
        self._cross += memory * (correction_m * residual_m - self._cross)
        self._total += memory * (residual_m**2 - self._total)

    def share(self) -> float:
        """How much of y to apply, 0..1: the coefficient of e on y, if that is surely above zero."""
        coefficient = self._cross / self._square if self._square > 0.0 else 0.0
        if coefficient <= 0.0 or self._seconds <= 0.0:
            return 0.0
        left = max(self._total - coefficient * self._cross, 0.0)
        error = sqrt(left / self._square / max(self._seconds / TUNING.independent_s, 1.0))
        sure = (coefficient - TUNING.sure[0] * error) / (TUNING.sure[1] - TUNING.sure[0])
        return min(coefficient, 1.0) * min(max(sure / error, 0.0), 1.0) if error > 0.0 else min(coefficient, 1.0)


class ResidualCorrection:
    """Step it with the observer's output at every sample and teach it the laser where that is; it gives the correction.

    Attributes:
        network: the one in use, or None.
        value_m: the correction at the last sample; ``raw_m``: the same as the network has it, nothing faded.
        nothing_to_learn: windows that were not handed out, because no network would have been accepted.
    """

    def __init__(self, params: Params, outputs: RingBuffer) -> None:
        """``outputs``: time and X* of the past in its first two columns; who steps this pushes to it afterwards."""
        self._params = params
        self._outputs = outputs
        self._lags = lags_s(params)
        self._rows = RingBuffer(max(1, int(params.window_s / params.step_s)), 2 + params.taps)
        """Time, residual with the laser's constant, inputs."""
        self.network: Network | None = None
        self._in_use: SavedNetwork | None = None
        self._pending: _Pending | None = None
        self._number = self.nothing_to_learn = 0
        self._asked_t_s = nan
        self._new_rows = 0
        self._variance = self._variance_weight = 0.0
        self._evidence = _Evidence()
        self._residual2 = self._heave2 = 0.0
        self._learned_t_s, self._row_t_s = nan, -inf
        self._weight = 0.0
        self._replaced, self._left_m = False, 0.0
        """Left of the network before: it fades out while the new one is in use at once."""
        self._moved = [0.0, 0.0, 0.0]
        """Since the training: gain, phase (rad), and RMS of what else, m."""
        self._t_s = nan
        self.value_m = self.raw_m = 0.0

    @property
    def windows(self) -> int:
        """Windows handed out so far."""
        return self._number - self.nothing_to_learn

    @property
    def is_applied(self) -> bool:
        """Whether most of what the network says is."""
        return self._weight > 0.5

    def state(self, *, laser_is_fresh: bool) -> CorrectionState:
        """What people should know of it."""
        if not self._params.enabled:
            return CorrectionState.OFF
        if self.network is None:
            return CorrectionState.LEARNING
        return CorrectionState.ACTIVE if laser_is_fresh and self.is_applied else CorrectionState.HOLDING

    def step(self, t_s: float, observer_m: float, omega_radps: float) -> float:
        """Correction (m) to add to the observer's output at ``t_s``, which is not among the outputs yet."""
        if not self._params.enabled:
            return 0.0
        dt = min(t_s - self._t_s, 1.0) if isfinite(self._t_s) else 0.0
        self._t_s = t_s
        self._variance_weight = min(self._variance_weight + dt, TUNING.sea_time_s)
        if self._variance_weight > 0.0:
            self._variance += dt / self._variance_weight * (observer_m**2 - self._variance)
        faded = exp(-dt / TUNING.fade_s)
        if self.network is None or self._in_use is None:
            self._left_m *= faded
            self.value_m = self._left_m
            return self.value_m
        self.raw_m = target = 0.0
        if (inputs := self._inputs(t_s, observer_m)) is not None:
            limit = self._in_use.limit_m
            self.raw_m = min(max(self.network.predict(inputs), -limit), limit)
            target = self._evidence.share() * self._likeness(omega_radps)
        self._weight += (1.0 - faded) * (target - self._weight)
        if self._replaced:
            self._left_m, self._replaced = self.value_m - self._weight * self.raw_m, False
        self._left_m *= faded
        self.value_m = self._weight * self.raw_m + self._left_m
        return self.value_m

    def learn(self, t_s: float, residual_m: float, constant_m: float, observer_m: float, raw_m: float) -> None:
        """Take a laser reading: ``residual_m`` = signed reading - observer at ``t_s``, the unknown constant included.

        constant_m: the constant as it is known now; nothing is learned before (nan). observer_m, raw_m: X* and
        :attr:`raw_m` at ``t_s``.
        """
        if not self._params.enabled or not isfinite(constant_m + observer_m):
            return
        if self.network is not None:
            self._evidence.push(t_s, residual_m - constant_m, raw_m)
        due = t_s - self._row_t_s >= 0.95 * self._params.step_s
        if self._agrees(t_s, residual_m - constant_m, observer_m) and due:
            inputs = self._inputs(t_s, nan)
            if inputs is not None:
                self._rows.push(np.concatenate(((t_s, residual_m), inputs)))
                self._row_t_s = t_s
                self._new_rows += 1

    def _agrees(self, t_s: float, residual_m: float, observer_m: float) -> bool:
        """Whether laser and observer see the same motion, by their recent mean squares."""
        dt = min(t_s - self._learned_t_s, 1.0) if isfinite(self._learned_t_s) else 0.05
        self._learned_t_s = t_s
        memory = 1.0 - exp(-dt / TUNING.agreement_time_s)
        self._residual2 += memory * (residual_m**2 - self._residual2)
        self._heave2 += memory * (observer_m**2 - self._heave2)
        return self._residual2 < TUNING.disagreement**2 * self._heave2

    def reset_rows(self) -> None:
        """Drop what was learned from: the lead, the constant or the observer has been changed under it."""
        self._rows.clear()
        self._row_t_s = -inf
        self._pending = None
        self._new_rows = 0

    def move(self, gain: float = 0.0, phase_rad: float = 0.0, by_m: float = 0.0) -> None:
        """What it corrects is another output from now on: larger by a share of it, turned by a phase, or moved by an
        RMS of something else.
        """
        if (used := self._in_use) is None:
            return
        of_gain, turned, other_m = self._moved
        self._moved = [of_gain + gain, turned + phase_rad, hypot(other_m, by_m)]
        moved_m = hypot(used.input_std_m * hypot(*self._moved[:2]), self._moved[2])
        if moved_m > TUNING.moved * used.limit_m / self._params.clip:
            self._drop()

    def _drop(self) -> None:
        """Have no network; what the last one corrects fades out."""
        self._left_m, self._weight, self.raw_m = self.value_m, 0.0, 0.0
        self._replaced = False
        self.network = self._in_use = None
        self._evidence = _Evidence()
        self.reset_rows()

    def reset(self) -> None:
        """The observer was restarted: its outputs do not continue the old ones, which are forgotten elsewhere."""
        self._weight = self._left_m = 0.0
        self.reset_rows()

    def due(self, t_s: float, omega_radps: float) -> TrainingWindow | None:
        """The window to train on, when it is time and a network may gain by it; its last part stays here, held out."""
        p = self._params
        fresh_s = self._new_rows * p.step_s
        enough = len(self._rows) * p.step_s >= p.min_laser_s and fresh_s >= p.period_s / 3.0
        waiting = isfinite(self._asked_t_s) and t_s - self._asked_t_s < p.period_s
        if not p.enabled or not enough or waiting:
            return None
        self._number += 1
        self._asked_t_s = t_s
        self._new_rows = 0
        rows = self._rows.last(len(self._rows))
        split = int(len(rows) * (1.0 - TUNING.holdout))
        # The inputs of neighbouring rows overlap: a gap of one input window keeps the held-out rows unseen.
        known = rows[: max(1, split - p.taps)]
        mean = float(np.mean(known[:, 1]))
        training, held = (
            Rows(inputs=part[:, 2:].copy(), residuals=part[:, 1] - mean) for part in (known, rows[split:])
        )
        limit_m = p.clip * float(np.std(training.residuals))
        bar_m2 = self._bar_m2(held)
        if not can_gain(training, held, limit_m=limit_m, bar_m2=bar_m2):
            self._pending = None
            self.nothing_to_learn += 1
            return None
        self._pending = _Pending(
            number=self._number,
            held=held,
            bar_m2=bar_m2,
            limit_m=limit_m,
            input_std_m=float(np.std(training.inputs)),
            omega_radps=omega_radps,
        )
        return TrainingWindow(
            number=self._number,
            inputs=training.inputs.tobytes(),
            targets=training.residuals.tobytes(),
            rows=len(training.residuals),
            width=p.taps,
            hidden=p.hidden,
            learning_rate=p.learning_rate,
            epochs=p.epochs,
            output=p.output,
            seed=self._number,
        )

    def _bar_m2(self, held: Rows) -> float:
        """Mean square of the held-out residuals, as they are or with the network in use, whichever is less."""
        bar_m2 = _mean_square(held.residuals)
        if self.network is None or self._in_use is None:
            return bar_m2
        limit_m = self._in_use.limit_m
        return min(bar_m2, _mean_square(held.residuals - _clipped(self.network, held.inputs, limit_m)))

    def accept(self, trained: TrainedNetwork) -> Verdict:
        """Judge a network on the rows that were held out."""
        pending = self._pending
        if trained.message or pending is None or trained.number != pending.number:
            return Verdict.FAILED if trained.message else Verdict.REJECTED
        self._pending = None
        try:
            network = Network.from_bytes(
                trained.weights, width=trained.width, hidden=trained.hidden, output=trained.output
            )
        except ValueError:
            return Verdict.FAILED
        if trained.width != self._params.taps:
            return Verdict.FAILED
        residuals = pending.held.residuals
        corrections = _clipped(network, pending.held.inputs, pending.limit_m)
        if not _mean_square(residuals - corrections) < TUNING.worth * pending.bar_m2:
            return Verdict.REJECTED
        self._replaced = self.network is not None
        self._moved = [0.0, 0.0, 0.0]
        self.network = network
        self._in_use = SavedNetwork(
            weights=trained.weights,
            width=trained.width,
            hidden=trained.hidden,
            output=trained.output,
            step_s=self._params.step_s,
            input_std_m=pending.input_std_m,
            omega_radps=pending.omega_radps,
            limit_m=pending.limit_m,
        )
        self._evidence = _Evidence(
            seconds=len(residuals) * self._params.step_s,
            square=_mean_square(corrections),
            cross=float(corrections @ residuals) / len(residuals),
            total=_mean_square(residuals),
        )
        return Verdict.ACCEPTED

    def _inputs(self, t_s: float, observer_m: float) -> Array | None:
        """The last ``taps`` outputs before ``t_s``, oldest first; the one at ``t_s`` itself is given, unless nan."""
        span = self._outputs.since(t_s - self._lags[0] - self._params.step_s)
        if not len(span) or span[0, 0] > t_s - self._lags[0] or (not isfinite(observer_m) and span[-1, 0] < t_s):
            return None
        times, values = span[:, 0], span[:, 1]
        if isfinite(observer_m):
            times, values = np.append(times, t_s), np.append(values, observer_m)
        return np.interp(t_s - self._lags, times, values)

    def _likeness(self, omega_radps: float) -> float:
        """1 while amplitude and frequency are those of the training, 0 when they are not, straight between."""
        trained = self._in_use
        if trained is None or self._variance_weight <= 0.0:
            return 0.0
        amplitude = _ratio(sqrt(max(self._variance, 0.0)), trained.input_std_m)
        frequency = _ratio(omega_radps, trained.omega_radps)
        return min(_between(amplitude, TUNING.same_amplitude), _between(frequency, TUNING.same_frequency))

    def saved(self) -> SavedNetwork | None:
        """What a restart shall remember."""
        return self._in_use

    def restore(self, saved: SavedNetwork) -> None:
        """Use the network of an earlier run.

        Raises:
            ValueError: it has another shape or another spacing of its inputs than the configuration asks for.
        """
        p = self._params
        asked = (p.taps, p.hidden, p.output, p.step_s)
        if (saved.width, saved.hidden, saved.output, saved.step_s) != asked:
            raise ValueError(
                f"saved network {saved.width}-{saved.hidden}-1 ({saved.output}, {saved.step_s} s) does not fit the "
                f"configured {p.taps}-{p.hidden}-1 ({p.output}, {p.step_s} s)"
            )
        self.network = Network.from_bytes(saved.weights, width=saved.width, hidden=saved.hidden, output=saved.output)
        self._in_use = saved
        # Nothing but the likeness of the sea speaks for it until the laser does, which soon outweighs this.
        square = (saved.limit_m / p.clip) ** 2
        self._evidence = _Evidence(seconds=TUNING.guard_time_s / 3.0, square=square, cross=square, total=square)


def lags_s(params: Params) -> Array:
    """(taps,) how long before the last of them each input of a network is, oldest first."""
    return params.step_s * np.arange(params.taps - 1, -1, -1.0)


def _clipped(network: Network, inputs: Array, limit_m: float) -> Array:
    return np.clip(network.predict_many(inputs), -limit_m, limit_m)


def _mean_square(values: Array) -> float:
    return float(values @ values) / len(values)


def _ratio(a: float, b: float) -> float:
    """How far apart two positive numbers are, as a ratio of at least 1."""
    low, high = sorted((a, b))
    return high / low if low > 0.0 else float("inf")


def _between(ratio: float, limits: tuple[float, float]) -> float:
    return min(1.0, max(0.0, (limits[1] - ratio) / (limits[1] - limits[0])))
