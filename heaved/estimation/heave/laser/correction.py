"""The learned residual correction: rows for the trainer, the guard before a new network, and the network in use.

Source: Zhang et al. 2022 (UKF multi-step + BP), eq. (15)-(17): a 50-10-1 network maps the last 50 observer outputs X*
to the residual (laser - X*), and the published heave is X~ = X* + y. Training happens elsewhere; here is what keeps a
learned correction from ever making the output worse than the physics underneath it:

* nothing is learned while the laser does not follow the heave at all (stuck, wrong sign, on another target);
* the last part of each window is held out, and a network replaces the one in use only if it beats it, and
  "no correction", there;
* while the laser is there, the running correlation of the correction with the residual decides how much of it is
  applied: nothing unless its regression coefficient is two standard errors above zero, counted for a residual that
  beats; then the coefficient, up to 1;
* without the laser it goes on only while the sea resembles that of the training;
* it is clipped and faded, never switched.
"""

from __future__ import annotations

from math import exp, isfinite, nan, sqrt
from typing import Annotated, Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.ring import RingBuffer
from heaved.estimation.heave.laser.network import Network
from heaved.samples import CorrectionState, TrainedNetwork, TrainingWindow

Array = NDArray[np.float64]

HOLDOUT: Final = 0.25
"""Share of the rows, the newest, on which a network is judged."""
WORTH: Final = 0.9
"""A network must take at least 10 % off the mean square of the held-out residuals: less can be chance."""
GUARD_TIME_S: Final = 90.0
"""Memory of the running comparison of correction and residual, in seconds of laser."""
INDEPENDENT_S: Final = 10.0
"""Residuals this far apart count as independent: they are narrow-banded, and grow and fade over several waves."""
SURE: Final = (2.0, 2.5)
"""Coefficient over its standard error: below the first the agreement with the residual can be chance, and nothing is
applied; from the second on all that the coefficient says. With a minute and a half of laser: three tenths and four
tenths of the residual's mean square; networks with less, seen on sensors whose lag the laser had taught, do harm as
often as good."""
AGREEMENT_TIME_S: Final = 15.0
"""Memory of the comparison of residual and heave: two wave periods."""
DISAGREEMENT: Final = 0.8
"""RMS residual over RMS heave above which there is nothing to learn: 1 is a stuck laser, 2 one of wrong sign. The
harmonic observer is at 0.5 on the broadest of seas."""
SEA_TIME_S: Final = 30.0
"""Memory of the variance that is compared with that of the training."""
FADE_S: Final = 2.0
"""Time constant of fading in and out."""
SAME_AMPLITUDE: Final = (1.5, 2.2)
"""Ratio of the RMS heave to that of the training, either way: below the first the same sea, above the second not."""
SAME_FREQUENCY: Final = (1.12, 1.3)
"""The same for the dominant frequency."""


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


class Saved(msgspec.Struct, frozen=True, kw_only=True):
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
    """A window that is with the trainer: its held-out rows, and what the sea was like."""

    number: int
    held_inputs: Array
    held_residuals: Array
    input_std_m: float
    omega_radps: float
    residual_rms_m: float


class _Evidence:
    """Running moments of the correction y and the residual e, over the last GUARD_TIME_S of laser."""

    def __init__(self, seconds: float = 0.0, square: float = 0.0, cross: float = 0.0, total: float = 0.0) -> None:
        self._seconds = seconds
        self._square, self._cross, self._total = square, cross, total
        self._t_s = nan

    def add(self, t_s: float, residual_m: float, correction_m: float) -> None:
        dt = min(t_s - self._t_s, 0.5) if isfinite(self._t_s) else 0.0
        self._t_s = t_s
        self._seconds = min(self._seconds + dt, GUARD_TIME_S)
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
        error = sqrt(left / self._square / max(self._seconds / INDEPENDENT_S, 1.0))
        sure = (coefficient - SURE[0] * error) / (SURE[1] - SURE[0])
        return min(coefficient, 1.0) * min(max(sure / error, 0.0), 1.0) if error > 0.0 else min(coefficient, 1.0)


class ResidualCorrection:
    """Feed it the observer's output at every sample and the laser where it is; it gives the correction to add."""

    def __init__(self, params: Params, max_rate_hz: float = 250.0) -> None:
        self._params = params
        self._lags = params.step_s * np.arange(params.taps - 1, -1, -1.0)
        self._outputs = RingBuffer(int((self._lags[0] + 5.0) * max_rate_hz), 3)
        self._rows = RingBuffer(max(1, int(params.window_s / params.step_s)), 2 + params.taps)
        self.network: Network | None = None
        self._in_use: Saved | None = None
        self._pending: _Pending | None = None
        self._number = 0
        self._trained_t_s = nan
        self._rows_since_training = 0
        self._variance = self._variance_weight = 0.0
        self._evidence = _Evidence()
        self._residual2 = self._heave2 = 0.0
        self._learned_t_s = nan
        self._weight = 0.0
        self._replaced, self._carry_m = False, 0.0
        self._t_s = nan
        self.value_m = 0.0

    @property
    def windows(self) -> int:
        """Windows handed out so far."""
        return self._number

    def state(self, laser_fresh: bool) -> CorrectionState:
        if not self._params.enabled:
            return CorrectionState.OFF
        if self.network is None:
            return CorrectionState.LEARNING
        return CorrectionState.ACTIVE if laser_fresh and self._weight > 0.5 else CorrectionState.HOLDING

    def step(self, t_s: float, observer_m: float, omega_radps: float) -> float:
        """Correction (m) to add to the observer's output at ``t_s``."""
        if not self._params.enabled:
            return 0.0
        dt = min(t_s - self._t_s, 1.0) if isfinite(self._t_s) else 0.0
        self._t_s = t_s
        self._variance_weight = min(self._variance_weight + dt, SEA_TIME_S)
        if self._variance_weight > 0.0:
            self._variance += dt / self._variance_weight * (observer_m**2 - self._variance)
        inputs = self._inputs(t_s, observer_m) if self.network is not None else None
        raw = 0.0
        target = 0.0
        if self.network is not None and self._in_use is not None and inputs is not None:
            limit = self._in_use.limit_m
            raw = min(max(self.network.predict(inputs), -limit), limit)
            target = self._evidence.share() * self._likeness(omega_radps)
        self._outputs.push((t_s, observer_m, raw))
        self._weight += (1.0 - exp(-dt / FADE_S)) * (target - self._weight)
        if self._replaced:
            self._carry_m, self._replaced = self.value_m - self._weight * raw, False
        self._carry_m *= exp(-dt / FADE_S)
        self.value_m = self._weight * raw + self._carry_m
        return self.value_m

    def learn(self, t_s: float, residual_m: float, constant_m: float) -> None:
        """Take a laser reading: ``residual_m`` = signed reading - observer at ``t_s``, the unknown constant included.

        constant_m: the constant as it is known now; nothing is learned before (nan).
        """
        _, observer_m, raw_m = self._outputs.at(t_s).tolist()
        if not self._params.enabled or not isfinite(constant_m + observer_m):
            return
        if self.network is not None:
            self._evidence.add(t_s, residual_m - constant_m, raw_m)
        newest = self._rows.last(1)
        due = not len(newest) or t_s - newest[0, 0] >= 0.95 * self._params.step_s
        if self._agrees(t_s, residual_m - constant_m, observer_m) and due:
            inputs = self._inputs(t_s, nan)
            if inputs is not None:
                self._rows.push(np.concatenate(([t_s, residual_m], inputs)))
                self._rows_since_training += 1

    def _agrees(self, t_s: float, residual_m: float, observer_m: float) -> bool:
        """Whether laser and observer see the same motion, by their recent mean squares."""
        dt = min(t_s - self._learned_t_s, 1.0) if isfinite(self._learned_t_s) else 0.05
        self._learned_t_s = t_s
        memory = 1.0 - exp(-dt / AGREEMENT_TIME_S)
        self._residual2 += memory * (residual_m**2 - self._residual2)
        self._heave2 += memory * (observer_m**2 - self._heave2)
        return self._residual2 < DISAGREEMENT**2 * self._heave2

    def forget_rows(self) -> None:
        """Drop what was learned from: the lead, the constant or the observer has been changed under it."""
        self._rows.clear()
        self._pending = None
        self._rows_since_training = 0

    def forget_outputs(self) -> None:
        """The observer was restarted: its outputs do not continue the old ones."""
        self._outputs.clear()
        self._weight = self._carry_m = 0.0
        self.forget_rows()

    def due(self, t_s: float, omega_radps: float) -> TrainingWindow | None:
        """The window to train on, when it is time; its last part stays here, held out."""
        p = self._params
        fresh_s = self._rows_since_training * p.step_s
        enough = len(self._rows) * p.step_s >= p.min_laser_s and fresh_s >= p.period_s / 3.0
        waiting = isfinite(self._trained_t_s) and t_s - self._trained_t_s < p.period_s
        if not p.enabled or not enough or waiting:
            return None
        rows = self._rows.last(len(self._rows))
        split = int(len(rows) * (1.0 - HOLDOUT))
        # The inputs of neighbouring rows overlap: a gap of one input window keeps the held-out rows unseen.
        training = rows[: max(1, split - p.taps)]
        mean = float(np.mean(training[:, 1]))
        self._number += 1
        self._trained_t_s = t_s
        self._rows_since_training = 0
        held = rows[split:]
        self._pending = _Pending(
            number=self._number,
            held_inputs=held[:, 2:].copy(),
            held_residuals=held[:, 1] - mean,
            input_std_m=float(np.std(training[:, 2:])),
            omega_radps=omega_radps,
            residual_rms_m=float(np.std(training[:, 1])),
        )
        return TrainingWindow(
            number=self._number,
            inputs=np.ascontiguousarray(training[:, 2:]).tobytes(),
            targets=(training[:, 1] - mean).tobytes(),
            rows=len(training),
            width=p.taps,
            hidden=p.hidden,
            learning_rate=p.learning_rate,
            epochs=p.epochs,
            output=p.output,
            seed=self._number,
        )

    def accept(self, trained: TrainedNetwork) -> str:
        """Judge a network on the rows that were held out: "accepted", "rejected" or "failed"."""
        pending = self._pending
        if trained.message or pending is None or trained.number != pending.number:
            return "failed" if trained.message else "rejected"
        self._pending = None
        try:
            network = Network.from_bytes(
                trained.weights, width=trained.width, hidden=trained.hidden, output=trained.output
            )
        except ValueError:
            return "failed"
        if trained.width != self._params.taps:
            return "failed"
        limit = self._params.clip * pending.residual_rms_m
        residuals = pending.held_residuals
        corrections = np.clip(network.predict_many(pending.held_inputs), -limit, limit)
        bar = _mean_square(residuals)
        if self.network is not None and self._in_use is not None:
            old = np.clip(self.network.predict_many(pending.held_inputs), -self._in_use.limit_m, self._in_use.limit_m)
            bar = min(bar, _mean_square(residuals - old))
        if not _mean_square(residuals - corrections) < WORTH * bar:
            return "rejected"
        self._replaced = self.network is not None
        self.network = network
        self._in_use = Saved(
            weights=trained.weights,
            width=trained.width,
            hidden=trained.hidden,
            output=trained.output,
            step_s=self._params.step_s,
            input_std_m=pending.input_std_m,
            omega_radps=pending.omega_radps,
            limit_m=limit,
        )
        self._evidence = _Evidence(
            seconds=len(residuals) * self._params.step_s,
            square=_mean_square(corrections),
            cross=float(corrections @ residuals) / len(residuals),
            total=_mean_square(residuals),
        )
        return "accepted"

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
        return min(_between(amplitude, SAME_AMPLITUDE), _between(frequency, SAME_FREQUENCY))

    def saved(self) -> Saved | None:
        return self._in_use

    def restore(self, saved: Saved) -> None:
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
        self._evidence = _Evidence(seconds=GUARD_TIME_S / 3.0, square=square, cross=square, total=square)


def _mean_square(values: Array) -> float:
    return float(values @ values) / len(values)


def _ratio(a: float, b: float) -> float:
    """How far apart two positive numbers are, as a ratio of at least 1."""
    low, high = sorted((a, b))
    return high / low if low > 0.0 else float("inf")


def _between(ratio: float, limits: tuple[float, float]) -> float:
    return min(1.0, max(0.0, (limits[1] - ratio) / (limits[1] - limits[0])))
