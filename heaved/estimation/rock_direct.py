"""Rock prediction at the bound: direct regression of each horizon on geometrically spaced lags.

One linear regression per horizon, of the motion h later on means of the past over blocks that grow with their age
(:mod:`heaved.estimation.rock_lags`), learned with exponential forgetting. It is the finite-past Wiener predictor with
some 34 taps instead of 800, found from the record itself: no model of the ship is needed, and no recursion of one-step
predictions that would let its errors grow.

* What is fitted is the residual to a fading-memory extrapolation up to 0.5 s, to the latest block beyond.
* All features are differences to the latest block, and the slow mean is one of them. So every prediction moves with the
  level: a list, a change of draught or heading shifts nothing but the mean.
* Experts run side by side: regressions on 2, 10 and 40 s of lags (each learns once its own lags are filled), the
  extrapolation, hold and the mean. Per horizon the one with the least realised error is published.
* Work is in samples on an even grid (:mod:`heaved.estimation.rock_clock`); equations are taken every 50 ms; once
  or twice a second they are summed and, a few sets in turn, solved.

Missing samples are filled with the prediction; what else may be wrong with them is dealt with in
:mod:`heaved.estimation.rock_gate`. While the motion leaves its own range nothing is learned.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, inf, isfinite, nan
from typing import Annotated, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.rock_clock import SampleClock
from heaved.estimation.rock_equations import NormalEquations, moments_of
from heaved.estimation.rock_experts import Switch
from heaved.estimation.rock_gate import JUDGED_S, Channel, Timing
from heaved.estimation.rock_lags import (
    SampleWindow,
    between,
    curve_weights,
    fading_taps,
    lag_knots,
    samples_per_step,
)

Array = NDArray[np.float64]

EXPERT_SPANS_S: Final = (2.0, 10.0, 40.0)
"""Lags of the regressions, s."""
EXPERT_MEMORY: Final = (0.4, 0.7, 1.0)
"""Their memory over that of the configuration."""
FADING, HOLD, MEAN = 3, 4, 5
"""The experts that are not regressions."""
EXPERTS: Final = 6
EXTRAPOLATED_S: Final = 0.5
"""Up to this horizon the residual to the fading-memory extrapolation is fitted."""
RIDGE: Final = 0.1
"""Ridge over the noise variance, for which the square of the one-step error stands."""
YOUNG_BATCH_S, BATCH_S = 0.5, 1.0
"""Predictions are scored, equations summed and solved so often: while young, and then."""
SCORE_S: Final = 0.11
"""Errors closer together than this are hardly different ones."""
SOLVED_PER_BATCH: Final = 1
"""Sets of equations (three experts, short and long horizons) solved in a batch, in turn: each every 6 s, a fiftieth of
the memory. While young all of them."""
YOUNG_S: Final = 120.0
RATE_LAGS: Final = 4
RATE_SCALE_S: Final = 0.1
"""Makes an angular rate commensurate with differences of angles over a step or two."""
BACKWARDS: Final = 20
"""Stamps in a row that are not later: the clock has been set back, begin anew."""


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The part of ``[rock]`` that the direct predictor reads."""

    horizons_s: tuple[Annotated[float, msgspec.Meta(ge=0.01, le=60.0)], ...] = (0.05, 0.10, 0.15, 0.5, 1.0, 2.0, 5.0)
    memory_s: Annotated[float, msgspec.Meta(ge=60.0, le=1800.0)] = 300.0
    """Of the regression on 40 s of lags; those on 10 and 2 s forget faster."""
    max_gap_s: Annotated[float, msgspec.Meta(ge=0.05, le=5.0)] = 2.0
    """Gaps up to this are filled with predictions; after longer ones the lags are filled anew."""


class DirectPredictor:
    """Predicts n channels at once; arrays published are (H, n), in the unit of the channels.

    ``values`` of a channel are nan until 2 s of it have been seen and after a gap longer than ``max_gap_s``;
    ``std`` and ``half_width`` (of the 95 % interval) until some errors are known. Both are against the *measured*
    value, so sensor noise is in them.
    """

    def __init__(self, channels: int, params: Params | None = None, *, rates: bool = False) -> None:
        """``rates``: the first derivative of every channel will be given with each sample."""
        self._params = params if params is not None else Params()
        self.horizons_s = tuple(sorted(set(self._params.horizons_s)))
        self._horizons = np.array(self.horizons_s)
        self._n = channels
        self._with_rates = rates
        self._no_rates = [0.0] * channels
        self._unknown_values = np.full((len(self.horizons_s), channels), nan)
        self.restarts = 0
        """Times that the stream was begun anew."""
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._clock = SampleClock()
        self._t_s = -inf
        self._backwards = 0
        self._pending: list[tuple[float, Sequence[float], Sequence[float]]] = []
        self._built = False
        self._channels: list[Channel] = []
        self._switch = Switch(self._horizons, EXPERTS, self._n, self._first_choice())
        self.values = self._unknown_values

    def _first_choice(self) -> NDArray[np.intp]:
        return np.where(self._horizons <= EXTRAPOLATED_S, FADING, HOLD).astype(np.intp)

    @property
    def curve(self) -> Array:
        """What is known of the latest sample (filled where it was missing) and the predictions, (H + 1, n)."""
        if not self._built:
            return np.concatenate([self._unknown_values[:1], self._unknown_values])
        now = [channel.level if channel.ready else nan for channel in self._channels]
        return np.concatenate([[self._curve[0] + now], self.values])

    @property
    def std(self) -> Array:
        """Standard deviation of the prediction errors, (H, n)."""
        return self._switch.std

    @property
    def half_width(self) -> Array:
        """Half-width of the 95 % interval, (H, n)."""
        return self._switch.half_width

    @property
    def rms_error(self) -> Array:
        """Rolling RMS of what was published, against what was measured then, (H, n)."""
        return self._switch.rms_error

    @property
    def coverage(self) -> Array:
        """Rolling share of measured values inside the published interval, (H, n)."""
        return self._switch.coverage

    @property
    def spikes(self) -> int:
        """Samples held back for good since the stream was begun."""
        return sum(channel.spikes for channel in self._channels)

    @property
    def level_steps(self) -> int:
        """Steps of the level since the stream was begun."""
        return sum(channel.level_steps for channel in self._channels)

    @property
    def experts(self) -> NDArray[np.intp]:
        """The expert in office, (H, n): 0, 1, 2 regressions by their lags, then extrapolation, hold, mean."""
        return self._switch.best

    def step(self, t_s: float, values: Sequence[float], rates: Sequence[float] | None = None) -> Array:
        """Take one sample of all channels (nan: not known) and predict from it, (H, n).

        A sample that is not later than the last one is ignored; twenty of them in a row begin everything anew.
        """
        if not t_s > self._t_s:
            self._backwards += t_s == t_s
            if self._backwards >= BACKWARDS:
                self._restart()
            return self.values
        self._backwards = 0
        self._t_s = t_s
        given = self._no_rates if rates is None else rates
        if not self._built:
            self._pending.append((t_s, tuple(values), tuple(given)))
            self._begin()
            return self.values
        steps = self._clock.step(t_s)
        late_s = self._clock.late_s
        if steps > self._longest_gap:
            for channel in self._channels:
                channel.lose()
            self._made[:] = self._shown[:] = self._aims[:] = nan
            steps = 1
        for _ in range(steps - 1):
            self._row(self._unmeasured, self._no_rates, 0.0)
        if steps > 0:
            self._row(values, given, late_s)
        if self._batch_due and self._clock.changed():
            self._restart()
            return self.values
        self.values = self._published(late_s)
        return self.values

    def _restart(self) -> None:
        self.restarts += 1
        self.reset()

    def _begin(self) -> None:
        if not self._clock.start([t for t, _, _ in self._pending]):
            return
        self._build(self._clock.interval_s)
        index = np.rint((np.array([t for t, _, _ in self._pending]) - self._pending[-1][0]) / self._clock.interval_s)
        steps = np.diff(index, prepend=index[0] - 1.0).astype(int).tolist()
        for count, (_, values, rates) in zip(steps, self._pending, strict=True):
            for _ in range(count - 1):
                self._row(self._unmeasured, self._no_rates, 0.0)
            if count > 0:
                self._row(values, rates, 0.0)
        self._pending.clear()
        self.values = self._published(self._clock.late_s)

    # -- geometry, for one sample interval -------------------------------------------------------------------------

    def _build(self, interval_s: float) -> None:
        """Everything whose shape depends on the sample interval."""
        self._built = True
        horizons, n = self._horizons, self._n
        count = len(horizons)
        self._interval_s = interval_s
        self._every = samples_per_step(interval_s)
        spacing_s = self._spacing_s = self._every * interval_s
        self._score_every = 2 if 2.0 * spacing_s < SCORE_S else 1
        self._rows_per_batch = max(1, round(YOUNG_BATCH_S / spacing_s))
        self._rows_per_late_batch = max(1, round(BATCH_S / spacing_s))
        knots = lag_knots(interval_s, EXPERT_SPANS_S[-1])
        self._spans = np.array([round(s / interval_s) for s in EXPERT_SPANS_S])
        self._fronts = 1 + (RATE_LAGS if self._with_rates else 0)
        lags = [int(np.searchsorted(knots, span + 0.5)) - 2 for span in self._spans]
        self._sizes = [self._fronts + max(lag, 1) for lag in lags]
        self._width = self._sizes[-1] = self._fronts + len(knots) - 2

        # Predictions by extrapolation, and the slope now.
        taps = fading_taps(interval_s, np.append(horizons, [0.0, 1e-3]))
        self._taps = np.concatenate([taps[:count], (taps[-1:] - taps[-2:-1]) / 1e-3])
        self._extrapolated = int(np.count_nonzero(horizons <= EXTRAPOLATED_S))
        # Interpolation of the predicted curve: one sample on, and its slope at each horizon.
        ahead_s = interval_s * np.arange(1, ceil(self._horizons[-1] / interval_s) + 2)
        self._gap_weights = curve_weights(horizons, ahead_s)
        slopes = curve_weights(horizons, horizons, derivative=1)
        self._curve_weights = np.concatenate([self._gap_weights[:1], slopes])
        # Where the measured value of each horizon lies, in samples and in rows.
        self._target = between(horizons / interval_s)
        self._whole = bool(np.all(self._target.weights == (0.0, 1.0, 0.0, 0.0)))
        self._delay = np.ceil((self._target.first + 3) / self._every).astype(np.intp)
        self._longest_gap = max(round(self._params.max_gap_s / interval_s), 3)
        judged = max(round(JUDGED_S / interval_s), 3)
        self._unmeasured = [nan] * n

        keep = int(knots[-1]) + self._every * (self._rows_per_late_batch + 2) + judged + 8
        self._window = SampleWindow(knots, 2 * n if self._with_rates else n, max(keep, self._taps.shape[1]))
        self._build_rows(count, n)
        # Horizons that share a set of equations: those whose targets are known early, and the others.
        groups = [np.flatnonzero(horizons <= EXTRAPOLATED_S), np.flatnonzero(horizons > EXTRAPOLATED_S)]
        self._groups = [slice(int(g[0]), int(g[-1]) + 1) for g in groups if len(g)]
        memory = [self._params.memory_s * share / spacing_s for share in EXPERT_MEMORY]
        self._equations = [
            [NormalEquations(n, g.stop - g.start, p, m) for p, m in zip(self._sizes, memory, strict=True)]
            for g in self._groups
        ]
        self._turn = 0
        self._coefficients = np.full((n, count, len(EXPERT_SPANS_S), self._width), nan)
        self._flat_coefficients = self._coefficients.reshape(n, count * len(EXPERT_SPANS_S), self._width)
        self._batch_due = False

        timing = Timing(
            interval_s=interval_s,
            settling=self._taps.shape[1],
            longest_gap=self._longest_gap,
            judged=judged,
        )
        self._channels = [Channel(timing, self._gap_weights) for _ in range(n)]
        self._ahead = np.zeros((count + 1, n))
        self._curve = np.zeros((count + 1, n))
        self._curves = list(self._curve.T)
        self._slope = [0.0] * n

    def _build_rows(self, count: int, n: int) -> None:
        """Rings of what is kept per equation until its targets are known."""
        self._kept = int(self._delay[-1]) + self._rows_per_late_batch + 2
        capacity = 4 * self._kept
        self._features = np.zeros((capacity, n, self._width))
        self._offsets = np.zeros((capacity, count, n))
        self._made = np.full((capacity, count, EXPERTS, n), nan)
        self._shown = np.full((capacity, count, n), nan)
        self._shown_half = np.full((capacity, count, n), nan)
        self._aims = np.full((capacity, count, n), nan)
        self._age = np.zeros((capacity, n), dtype=np.intp)
        self._sample = np.zeros(capacity, dtype=np.intp)
        self._row_end = self._kept  # as if there had been rows that predicted nothing
        self._rows_seen = 0
        self._until_row = self._every
        self._until_batch = self._rows_per_batch

    # -- one sample ------------------------------------------------------------------------------------------------

    def _row(self, values: Sequence[float], rates: Sequence[float], late_s: float) -> None:
        """One step of the grid: take the sample, look back, predict."""
        window, n = self._window, self._n
        taken, known = [], []
        one_step = self._ahead[0].tolist()
        for c, channel in enumerate(self._channels):
            x, measured = channel.take(values[c], late_s, one_step[c], self._slope[c], self._curves[c])
            if channel.since == 1:
                window.flatten(c, x)
            taken.append(x)
            known.append(measured)
        if self._with_rates:
            previous = window.x[window.end - 1, n:].tolist()
            taken += [r if isfinite(r) else p for r, p in zip(rates, previous, strict=True)]
            known += known
        window.append(taken, known)
        for c, channel in enumerate(self._channels):
            if (instead := channel.judge()) is not None:
                window.replace(c, instead)

        self._until_row -= 1
        learned = self._until_row <= 0
        features, offset, made = self._look_back()
        best = made[self._switch._horizon, self._switch.best, self._switch._channel]
        self._curve[0] = window.x[window.end - 1, :n]
        self._curve[1:] = best
        np.matmul(self._curve_weights, self._curve, out=self._ahead)
        self._batch_due = False
        if learned:
            self._until_row = self._every
            self._keep_row(features, offset, made, best)
            self._rows_seen += 1
            self._until_batch -= 1
            if self._until_batch == 0:
                self._batch()
                self._batch_due = True
                if self._rows_seen * self._spacing_s > YOUNG_S:
                    self._rows_per_batch = self._rows_per_late_batch
                self._until_batch = self._rows_per_batch

    def _look_back(self) -> tuple[Array, Array, Array]:
        """Features (n, p) of the latest sample, what the regression adds to (H, n), all predictions (H, E, n)."""
        n, fronts = self._n, self._fronts
        means = self._window.means()
        latest = means[0, :n]
        features = np.empty((n, self._width))
        slow = np.array([channel.mean for channel in self._channels])
        features[:, 0] = slow - latest
        features[:, fronts:] = (means[1:, :n] - latest).T
        if self._with_rates:
            features[:, 1:fronts] = RATE_SCALE_S * means[:RATE_LAGS, n:].T
        base = self._taps @ self._window.latest(self._taps.shape[1])[:, :n]
        extrapolation = base[:-1]
        offset = extrapolation.copy()
        offset[self._extrapolated :] = latest
        made = np.empty((len(offset), EXPERTS, n))
        regressed = self._flat_coefficients @ features[:, :, None]
        np.add(regressed.reshape(n, -1, FADING).transpose(1, 2, 0), offset[:, None], out=made[:, :FADING])
        made[:, FADING] = extrapolation
        made[:, HOLD] = latest
        made[:, MEAN] = slow
        self._slope = base[-1].tolist()
        return features, offset, made

    def _keep_row(self, features: Array, offset: Array, made: Array, best: Array) -> None:
        if self._row_end == len(self._features):
            start = self._row_end - self._kept
            rings = (self._features, self._offsets, self._made, self._shown, self._shown_half, self._aims)
            for ring in (*rings, self._age, self._sample):
                ring[: self._kept] = ring[start:]
            self._row_end = self._kept
        row = self._row_end
        self._features[row] = features
        self._offsets[row] = offset
        self._made[row] = made
        for c, channel in enumerate(self._channels):
            if channel.unsettled > 0 or channel.since == 0:
                channel.unsettled -= self._every
                self._made[row, :, :, c] = nan
        self._shown[row] = best
        self._shown_half[row] = self._switch.half_width
        self._age[row] = [channel.calm for channel in self._channels]
        self._sample[row] = self._window.end - 1 + self._window.moved
        self._row_end += 1

    def _published(self, late_s: float) -> Array:
        """The latest predictions as seen from ``late_s`` after their grid time."""
        values: Array = self._curve[1:] + [channel.level for channel in self._channels]
        if abs(late_s) > 1e-5:
            values += late_s * self._ahead[1:]
        blind = [c for c, channel in enumerate(self._channels) if not channel.ready]
        if blind:
            values[:, blind] = nan
        return values

    # -- once or twice a second ---------------------------------------------------------------------------------------

    def _batch(self) -> None:
        """Score what came true, learn from it, solve, choose."""
        self._score()
        back = self._row_end - 1 - np.arange(self._rows_per_batch)
        solved = 0
        young = self._rows_seen * self._spacing_s < YOUNG_S
        for g, group in enumerate(self._groups):
            rows = back - self._delay[group.stop - 1]
            aims = self._aims[rows, group]
            wanted = (aims - self._offsets[rows, group]).transpose(2, 0, 1)
            known = np.isfinite(wanted).all(axis=2).T
            augmented = np.concatenate([wanted, self._features[rows].transpose(1, 0, 2)], axis=2)
            targets = group.stop - group.start
            age = self._age[rows]
            used = known & (age >= self._spans[0])
            moments = moments_of(augmented, used)
            for equations, span, size in zip(self._equations[g], self._spans, self._sizes, strict=True):
                if not ((age >= span) | ~used).all():  # fewer equations than of the shorter lags
                    used &= age >= span
                    moments = moments_of(augmented, used)
                width = targets + size
                equations.add(moments[:, :width, :width], used.sum(axis=0))
        pairs = len(self._groups) * len(self._sizes)
        for i in range(pairs):
            if not young and solved >= SOLVED_PER_BATCH:
                break
            which = (self._turn + i) % pairs
            self._solve(*divmod(which, len(self._sizes)))
            solved += 1
        self._turn = (self._turn + solved) % pairs
        self._choose()

    def _solve(self, g: int, expert: int) -> None:
        group, size = self._groups[g], self._sizes[expert]
        for c, channel in enumerate(self._channels):
            found = self._equations[g][expert].solve(c, RIDGE * channel.noise_square)
            if found is not None:
                self._coefficients[c, group, expert, :size] = found
                self._coefficients[c, group, expert, size:] = 0.0

    def _choose(self) -> None:
        calm = np.array([channel.calm for channel in self._channels])
        available = np.ones((EXPERTS, self._n), dtype=bool)
        available[:FADING] = calm >= self._spans[:, None]
        self._switch.choose(available)

    def _score(self) -> None:
        rows = self._row_end - 1 - np.arange(self._rows_per_batch)[:, None] - self._delay
        h = np.arange(len(self._delay))
        window, weights = self._window, self._target.weights
        first = self._sample[rows] - window.moved + self._target.first
        if self._whole:
            measured: Array = window.x[first + 1, : self._n]
            known = window.known[first + 1, : self._n]
        else:
            support = first[:, :, None] + np.arange(4)
            measured = (weights[:, None, :] @ window.x[support, : self._n])[:, :, 0]
            known = (window.known[support, : self._n] | (weights == 0.0)[:, :, None]).all(axis=2)
        if not known.all():
            measured[~known] = nan
        self._aims[rows, h] = measured
        if self._score_every > 1:
            rows, measured = rows[:: self._score_every], measured[:: self._score_every]
        error = measured[:, :, None, :] - self._made[rows, h]
        filled = self._age[rows][:, :, None, :] >= self._spans[:, None]
        if not filled.all():
            error[:, :, :FADING][~filled] = nan
        shown = measured - self._shown[rows, h]
        self._switch.score(self._score_every * self._spacing_s, error, shown, self._shown_half[rows, h])
