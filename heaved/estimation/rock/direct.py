"""Rock prediction at the bound: direct regression of each horizon on geometrically spaced lags.

One linear regression per horizon, of the motion h later on means of the past over blocks that grow with their age
(:mod:`heaved.estimation.rock.lags`), learned with exponential forgetting. It is the finite-past Wiener predictor with
some 34 taps instead of 800, found from the record itself: no model of the ship is needed, and no recursion of one-step
predictions that would let its errors grow.

* What is fitted is the residual to a fading-memory extrapolation up to 0.5 s, to the latest block beyond.
* All features are differences to the latest block, and the slow mean is one of them. So every prediction moves with the
  level: a list, a change of draught or heading shifts nothing but the mean.
* Experts run side by side: regressions on 2, 10 and 40 s of lags (each learns once its own lags are filled), the
  extrapolation, hold and the mean. Per horizon the one with the least realised error is published.
* Work is in samples on an even grid (:mod:`heaved.estimation.rock.sample_clock`); equations are taken every 0.2 s,
  and every few seconds they are summed and, some sets in turn, solved (:mod:`heaved.estimation.rock.learner`).

A missing sample is filled with the prediction. Where many are missing, a channel is predicted by a filter that needs
none of them (:mod:`heaved.estimation.rock.holes`), nothing is learned from what was filled, and the lags are given what
the filter knows of the holes once it hands over again. What else may be wrong with samples is dealt with in
:mod:`heaved.estimation.rock.gate`. While the motion leaves its own range nothing is learned.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from math import ceil, exp, inf, isfinite, nan
from typing import Annotated, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.rock.experts import Switch
from heaved.estimation.rock.features import Regressors
from heaved.estimation.rock.gate import JUDGED_S, Channel, Timing
from heaved.estimation.rock.holes import NODE_S, NODES, HoleFilter
from heaved.estimation.rock.lags import SMOOTHED_S, SampleWindow, curve_weights, fading_taps, lag_knots
from heaved.estimation.rock.learner import (
    BATCH_S,
    EXPERT_SPANS_S,
    FILTER_LIKE,
    ROW_S,
    Learner,
    expert_count,
    first_choice,
)
from heaved.estimation.rock.sample_clock import SampleClock
from heaved.predictions import Limits

Array = NDArray[np.float64]

BACKWARDS: Final = 20
"""Stamps in a row that are not later: the clock has been set back, begin anew."""
HOLES_MEMORY_S: Final = 2.0
"""Of what is missing."""
HOLES_S: Final = (0.4, 0.15)
"""So much missing within that memory makes a channel one with holes, and so little ends it."""
RATED_HOLES_S: Final = (0.1, 0.05)
"""The same where rates are given: they tell much, while they are there."""
RUN_S: Final = 0.15
"""And so much missing on end begins it."""
FILLED_S: Final = 10.0
"""What the filter said of its errors fades within that time, for the lags hold what it has filled them with."""
MEASURED: Final = 0.75
"""Share of the nodes that a filter for holes learns from that were measured: the odd missing one is filled well."""
SURPRISED_S: Final = 0.5
"""Predictions for so long ahead, the longest that is known so soon, show that the motion has become another one,"""
SURPRISED: Final = 1.5
"""when they are off by more than usual by so many of their deviations; what is more widens all others."""
SURPRISED_FOR_S: Final = 4.0
OUT: Final = 4
"""Predictions are looked at as often as experts are chosen: so often beyond the limits on end, which is longer than a
spike is seen, and everything begins anew."""
LEARNED_TOGETHER: Final = 40
"""Rows (of the learner) after which the filters for holes learn; from every other one, for neighbours are alike."""


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The part of ``[rock]`` that the direct predictor reads."""

    horizons_s: tuple[Annotated[float, msgspec.Meta(ge=0.01, le=60.0)], ...] = (0.05, 0.10, 0.15, 0.5, 1.0, 2.0, 5.0)
    memory_s: Annotated[float, msgspec.Meta(ge=60.0, le=1800.0)] = 300.0
    """Of the regression on 40 s of lags; those on 10 and 2 s forget faster."""
    max_gap_s: Annotated[float, msgspec.Meta(ge=0.05, le=5.0)] = 2.0
    """Gaps up to this are filled with predictions; after longer ones the lags are filled anew."""
    choice_s: Annotated[float, msgspec.Meta(ge=0.1, le=4.0)] = 1.0
    """Predictions are scored and experts chosen so often: how soon a turn is noticed, and a good part of the cost."""


class DirectPredictor:
    """Predicts n channels at once; arrays published are (H, n), in the unit of the channels.

    ``values`` of a channel are nan until 2 s of it have been seen and after a gap longer than ``max_gap_s``;
    ``std`` and ``half_width`` (of the 95 % interval) until some errors are known. Both are against the *measured*
    value, so sensor noise is in them.
    """

    def __init__(
        self,
        channels: int,
        params: Params | None = None,
        *,
        rates: bool = False,
        limits: Limits | None = None,
    ) -> None:
        """``rates``: the first derivative of every channel will be given with each sample.

        ``limits``: what no channel does; a prediction beyond them begins everything anew.
        """
        self._params = params if params is not None else Params()
        self.horizons_s = tuple(sorted(set(self._params.horizons_s)))
        self._horizons = np.array(self.horizons_s)
        self._n = channels
        self._with_rates = rates
        self._no_rates = [0.0] * channels
        self._unknown_curve = np.full((len(self.horizons_s) + 1, channels), nan)
        self._limits = limits
        self.begun_anew: Counter[str] = Counter()
        """By reason: the stream, or (lost track) one channel of it."""
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._clock = SampleClock()
        self._t_s = -inf
        self._backwards = 0
        self._pending: list[tuple[float, Sequence[float], Sequence[float]]] = []
        self._built = False
        self._channels: list[Channel] = []
        self.filters: list[HoleFilter] = []
        """Of the channels, for holes."""
        self.holed: set[int] = set()
        """The channels that are predicted by them."""
        self.given_back: dict[int, tuple[int, Array]] = {}
        """Of those that no longer are: when that ended, and the deviations now and at the horizons then."""
        experts = expert_count(rates=self._with_rates)
        self.surplus = [0.0] * self._n
        """By how much of themselves deviations are larger than usual: the motion has just become another one."""
        self._switch = Switch(self._horizons, experts, self._n, first_choice(self._horizons))
        self.curve = self._unknown_curve
        """What is known of the latest sample (filled where it was missing) and of the horizons, (H + 1, n)."""
        self.values = self._unknown_curve[1:]

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
    def shaking_square(self) -> Array:
        """Mean square of what of each channel is vibration and noise, (n,)."""
        return self._learner.shaking_square if self._built else np.zeros(self._n)

    @property
    def spikes(self) -> int:
        """Samples held back for good since the stream was begun."""
        return sum(channel.spikes for channel in self._channels)

    @property
    def level_steps(self) -> int:
        """Steps of the level since the stream was begun."""
        return sum(channel.level_steps for channel in self._channels)

    @property
    def restarts(self) -> int:
        """Times that the stream was begun anew."""
        return self.begun_anew["restart"] + self.begun_anew["out of bounds"]

    @property
    def experts(self) -> NDArray[np.intp]:
        """The expert in office, (H, n): 0, 1, 2 regressions by their lags, then extrapolation, hold, mean, and the
        regressions without rates."""
        return self._switch.best

    def spread(self, channel: int, ahead_s: Array) -> Array:
        """Deviations, so long after the latest grid time, of a channel that is predicted by its filter for holes.

        Of what it does not see, for its model ends after 10 s, the regression on as many tells.
        """
        deviations: Array = np.sqrt(self.filters[channel].variance(self._row_index, ahead_s))
        return np.fmax(deviations, np.interp(ahead_s, self._horizons, self._switch.rms_of(FILTER_LIKE)[:, channel]))

    def spread_left(self, channel: int, ahead_s: Array) -> Array:
        """The same of a channel that was predicted so until lately."""
        row, deviations = self.given_back[channel]
        fade = exp((row - self._row_index) * self._interval_s / FILLED_S)
        if fade < 0.05:
            del self.given_back[channel]
        left: Array = fade * np.interp(ahead_s, self._curve_s, deviations)
        return left

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
            self.holed.clear()
            self._learner.forget(slice(None))
            steps = 1
        for _ in range(steps - 1):
            self._row(self._unmeasured, self._unmeasured, 0.0)
        if steps > 0:
            self._row(values, given, late_s)
        if self._out >= OUT:
            self._restart("out of bounds")
        elif self._batch_due and self._clock.changed():
            self._restart()
        else:
            self._publish(late_s)
        return self.values

    def _restart(self, reason: str = "restart") -> None:
        self.begun_anew[reason] += 1
        self.reset()

    def _begin(self) -> None:
        if not self._clock.start([t for t, _, _ in self._pending]):
            return
        self._build(self._clock.interval_s)
        index = np.rint((np.array([t for t, _, _ in self._pending]) - self._pending[-1][0]) / self._clock.interval_s)
        steps = np.diff(index, prepend=index[0] - 1.0).astype(int).tolist()
        for count, (_, values, rates) in zip(steps, self._pending, strict=True):
            for _ in range(count - 1):
                self._row(self._unmeasured, self._unmeasured, 0.0)
            if count > 0:
                self._row(values, rates, 0.0)
        self._pending.clear()
        self._publish(self._clock.late_s)

    # -- geometry, for one sample interval -------------------------------------------------------------------------

    def _build(self, interval_s: float) -> None:
        """Everything whose shape depends on the sample interval."""
        self._built = True
        horizons, n = self._horizons, self._n
        count = len(horizons)
        knots = lag_knots(interval_s, EXPERT_SPANS_S[-1])
        taps = fading_taps(interval_s, np.append(horizons, [0.0, 1e-3]))
        settling = taps.shape[1]
        self._longest_gap = max(round(self._params.max_gap_s / interval_s), 3)
        judged = max(round(JUDGED_S / interval_s), 3)
        self._unmeasured, self._rates = [nan] * n, [0.0] * n

        self._nodes = max(1, round(NODE_S / interval_s)) * np.arange(NODES)
        """Of the filters, in rows back from the newest."""
        learned = LEARNED_TOGETHER * max(1, round(ROW_S / interval_s))
        reach = max(int(knots[-1]) + round((BATCH_S + 1.0) / interval_s) + judged, int(self._nodes[-1]) + learned)
        keep = reach + round(SMOOTHED_S / interval_s) + 8
        columns = 3 * n if self._with_rates else 2 * n
        self._window = SampleWindow(knots, columns, max(keep, settling))
        # Predictions by extrapolation, and the slope now.
        taps = np.concatenate([taps[:count], (taps[-1:] - taps[-2:-1]) / 1e-3])
        self._regressors = Regressors(self._window, n, taps, rates=self._with_rates)
        now, soon = fading_taps(interval_s, np.array([interval_s, interval_s + 1e-3]))
        self._next_slope = np.zeros(self._regressors.width)
        """On the vectors of the sample before: the slope of the extrapolation at the next one."""
        self._next_slope[-settling:] = (soon - now)[::-1] / 1e-3
        self._learner = Learner(
            horizons,
            interval_s,
            self._params.memory_s,
            self._params.choice_s,
            knots=knots,
            window=self._window,
            regressors=self._regressors,
            switch=self._switch,
        )
        self._until_row = self._learner.every
        self._batch_due = False

        self._curve_s = np.append(0.0, horizons)
        self._surprised_node = max(int(np.searchsorted(horizons, SURPRISED_S + 1e-6)) - 1, 0)
        ahead = max(round(float(horizons[self._surprised_node]) / interval_s), 1)
        self._earlier: deque[list[float]] = deque(maxlen=ahead)
        self._surprise = [0.0] * n
        """Of each channel: by how many deviations predictions were off lately, at most; it fades."""
        # Interpolation of the predicted curve: one sample on, and its slope at each horizon.
        ahead_s = interval_s * np.arange(1, ceil(horizons[-1] / interval_s) + 2)
        gap_weights = curve_weights(horizons, ahead_s)
        self._one_step = gap_weights[:1]
        self._slopes = curve_weights(horizons, horizons, derivative=1)
        self._seen = np.zeros((n, count + 3, 1))
        self._map = self._mapped()
        self._levels: list[float] = []
        timing = Timing(interval_s=interval_s, settling=settling, longest_gap=self._longest_gap, judged=judged)
        self._channels = [Channel(timing, gap_weights) for _ in range(n)]
        self._interval_s = interval_s
        self._row_index = 0
        self._out = 0
        """Times on end that predictions were beyond the limits."""
        self.filters = [HoleFilter(int(self._nodes[1]), interval_s, float(horizons[-1])) for _ in range(n)]
        self._holes_s = RATED_HOLES_S if self._with_rates else HOLES_S
        self._missing = [0.0] * n
        """Samples missing lately."""
        self._missed_row = [0] * n
        """When that was."""
        self._until_learned = LEARNED_TOGETHER

    @property
    def _curves(self) -> Array:
        """(n, H + 1) the latest sample and the predictions, without levels: a view, made when it is asked for; one that
        is kept would stay with the original when a predictor is copied."""
        return self._seen[:, :-2, 0]

    def _mapped(self) -> Array:
        """(n, H + 3, width) from the vectors to the latest sample, the predictions, one step on, the slope."""
        regressors, n = self._regressors, self._n
        now, slope = (np.tile(row, (n, 1, 1)) for row in (regressors.sample, regressors.taps[-1]))
        curve = np.concatenate([now, self._learner.weights], axis=1)
        return np.concatenate([curve, self._one_step @ curve, slope], axis=1)

    # -- one sample ------------------------------------------------------------------------------------------------

    def _row(self, values: Sequence[float], rates: Sequence[float], late_s: float) -> None:
        """One step of the grid: take the sample, predict, learn when it is time."""
        window, channels = self._window, self._channels
        taken, known, means = [], [], []
        curves, near = self._curves, self._seen[:, -2:, 0].tolist()
        self._row_index += 1
        for c, channel in enumerate(channels):
            if c in self.holed:
                x, measured = self._take_holed(c, values[c], late_s)
            else:
                x, measured = channel.take(values[c], late_s, curves[c], *near[c])
            if channel.since == 1:
                window.flatten(c, x)
                self._learner.forget(c)
            taken.append(x)
            known.append(measured)
            means.append(channel.mean)
        if self._with_rates:
            if not isfinite(sum(rates)):
                # One that is missing is what the angles' extrapolation has for now. The slope of what was predicted
                # from earlier ones of these would be fed with itself, and run away.
                expected = (self._regressors.now() @ self._next_slope).tolist()
                rates = [r if isfinite(r) else p if isfinite(p) else 0.0 for r, p in zip(rates, expected, strict=True)]
            self._rates = list(rates)
            taken += self._rates
        window.append(taken + means, known)
        if not all(known):
            for c, channel in enumerate(channels):
                if (instead := channel.judge()) is not None:
                    window.replace(c, instead)
                if not known[c] and not isfinite(values[c]):
                    self._miss(c)
        np.matmul(self._map, self._regressors.now()[:, :, None], out=self._seen)
        if not all(known):
            for c, channel in enumerate(channels):
                if not isfinite(values[c]) and c not in self.holed and channel.since:
                    curves[c] = channel.carried(self._curve_s)
        for c in self.holed:
            hole = self.filters[c]
            curves[c] = hole.mean + hole.curve(self._row_index, self._curve_s)
        self._bound(taken)
        self._be_surprised(known)
        self._until_row -= 1
        self._batch_due = False
        if self._until_row == 0:
            self._until_row = self._learner.every
            if self._learner.keep(curves[:, 1:].T, channels):
                if self._learner.batch(channels):
                    self._map = self._mapped()
                self._batch_due = True
                for c in self.holed:
                    self._give_back(c, self._row_index)
            self._until_learned -= 1
            if self._until_learned == 0:
                self._until_learned = LEARNED_TOGETHER
                self._learn_for_holes()
        if self._batch_due and self._limits is not None:
            # A filter for holes that knows too little yet is not published, nor held against it.
            levels = [
                nan if c in self.holed and not self.filters[c].known else channel.level
                for c, channel in enumerate(channels)
            ]
            published = curves.T + levels
            self._out = self._out + 1 if self._limits.left_by(published, (0.0, *self.horizons_s)).any() else 0

    def _bound(self, taken: Sequence[float]) -> None:
        """Predictions of channels with limits stay within reach of the motion."""
        if self._limits is None:
            return
        means, reaches = [], []
        for channel, x, largest in zip(self._channels, taken, self._limits.largest, strict=False):
            means.append(channel.mean)
            reaches.append(channel.reach(x) if largest < inf else inf)
        mean, reach = np.array((means, reaches))[:, :, None]
        curves = self._curves
        np.maximum(curves, mean - reach, out=curves)
        np.minimum(curves, mean + reach, out=curves)

    def _be_surprised(self, known: Sequence[bool]) -> None:
        """Hold what was predicted SURPRISED_S ago against what there is now."""
        curves, earlier, node = self._curves, self._earlier, self._surprised_node
        if len(earlier) == earlier.maxlen:
            now, stds = curves[:, 0].tolist(), self._switch.std[node].tolist()
            fade = exp(-self._interval_s / SURPRISED_FOR_S)
            for c, (is_known, x, expected, std) in enumerate(zip(known, now, earlier[0], stds, strict=True)):
                surprise = fade * self._surprise[c]
                off = abs(x - expected)
                if is_known and 0.0 <= surprise * std < off < inf and std > 0.0 and c not in self.holed:
                    surprise = off / std
                self._surprise[c] = surprise
                self.surplus[c] = max(0.0, surprise - SURPRISED - 1.0)
        later = curves[:, node + 1].tolist()
        for c, channel in enumerate(self._channels):
            if channel.unsettled > 0 or not channel.ready:
                later[c] = nan
        earlier.append(later)

    # -- holes -----------------------------------------------------------------------------------------------------

    def _miss(self, c: int) -> None:
        """A sample of a channel is missing: where too many are, its filter takes over."""
        row, channel, hole = self._row_index, self._channels[c], self.filters[c]
        self._missing[c] = 1.0 + self._missing[c] * self._share_left(row - self._missed_row[c])
        self._missed_row[c] = row
        if c in self.holed or not channel.since:
            return
        if max(self._missing[c] - self._holes_s[0] / self._interval_s, channel.absent - RUN_S / self._interval_s) < 0.0:
            return
        window = self._window
        at = window.end - 1 - self._nodes
        if hole.begin(row, window.x[at, c], window.known[at, c], channel.mean, channel.noise_square):
            self.holed.add(c)

    def _share_left(self, rows: int) -> float:
        return exp(-rows * self._interval_s / HOLES_MEMORY_S)

    def _take_holed(self, c: int, value: float, late_s: float) -> tuple[float, bool]:
        """What goes into the lags of a channel with holes, and whether it was measured."""
        row, channel, hole = self._row_index, self._channels[c], self.filters[c]
        hole.to(row)
        measured = isfinite(value)
        if measured:
            at = row + late_s / self._interval_s
            x = value - channel.level
            if measured := hole.read(at, x - hole.mean):
                x -= hole.value(at)[0] - hole.value(row)[0]
            elif hole.is_lost(row):
                self.begun_anew["lost track"] += 1
                channel.forget()
        if not measured:
            x = hole.mean + hole.value(row)[0]
        if not channel.bridge(x, measured=measured):
            self.holed.discard(c)
        elif measured:
            missing = self._missing[c] * self._share_left(row - self._missed_row[c])
            if missing * self._interval_s < self._holes_s[1]:
                self.given_back[c] = row, self.spread(c, self._curve_s)
                self.holed.discard(c)
                self._give_back(c, row - 1)  # the latest has not been appended
        return x, measured

    def _give_back(self, c: int, row: int) -> None:
        """The lags of a channel get what its filter has come to know of the holes."""
        window, hole = self._window, self.filters[c]
        count = min(self._channels[c].since - 2, int(self._nodes[-1]) - int(self._nodes[1]))
        if count <= 0:
            return
        ago = np.arange(count - 1, -1, -1)
        window.fill(c, hole.mean + hole.past((row - ago).astype(np.float64)))

    def _learn_for_holes(self) -> None:
        """From stretches without any: every other of the rows since the last time, smoothed, for the noise of readings
        is taken care of elsewhere."""
        window, n, taps = self._window, self._n, self._learner.shaking_taps
        half = len(taps) // 2
        ends = window.end - 1 - half - 2 * int(self._learner.every) * np.arange(LEARNED_TOGETHER // 2)
        at = ends[:, None] - self._nodes
        known = window.known[at, :n]
        used = np.ones((len(ends), n), dtype=bool) if known.all() else known.mean(axis=1) >= MEASURED  # (R, n)
        for c, (channel, hole) in enumerate(zip(self._channels, self.filters, strict=True)):
            if c in self.holed:
                hole.move_mean(channel.mean)
                used[:, c] = False
        if not used.any():
            return
        first = int(at[-1, -1])
        stretch = window.x[first - half : window.end, :n]
        shaking = np.stack([np.convolve(column, taps, "valid") for column in stretch.T], axis=-1)
        nodes = (stretch[half:-half] if half else stretch)[at - first] - shaking[at - first]
        nodes -= window.x[ends, -n:][:, None]
        if not used.all():
            nodes = np.where(used[:, None], nodes, 0.0)
        rows = np.ascontiguousarray(nodes.transpose(2, 0, 1))
        moments = rows.transpose(0, 2, 1) @ rows
        for hole, of_channel, count in zip(self.filters, moments, used.sum(axis=0).tolist(), strict=True):
            if count:
                hole.model.learn(2.0 * of_channel, 2 * count)

    def _publish(self, late_s: float) -> None:
        """The latest predictions as seen from ``late_s`` after their grid time."""
        levels = [channel.level if channel.ready else nan for channel in self._channels]
        for c in self.holed:
            if not self.filters[c].known:
                levels[c] = nan
        if levels != self._levels:
            self._levels, self._level = levels, np.array(levels)
        curves = self._curves.T
        self.curve = curves + self._level
        self.values = self.curve[1:]
        if abs(late_s) > 1e-5:
            self.values += late_s * (self._slopes @ curves)
