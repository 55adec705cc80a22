"""Rock prediction at the bound: direct regression of each horizon on geometrically spaced lags.

One linear regression per horizon, of the motion h later on means of the past over spans that grow with their age
(:mod:`heaved.estimation.rock.features`), learned with exponential forgetting. It is the finite-past Wiener predictor
with some 34 taps instead of 800, found from the record itself: no model of the ship is needed, and no recursion of
one-step predictions that would let its errors grow.

* What is fitted is the residual to a fading-memory extrapolation up to 0.5 s, to the newest mean beyond.
* All features are differences to the newest mean, and the slow mean is one of them. So every prediction moves with the
  level: a list, a change of draught or heading shifts nothing but the mean.
* Experts run side by side: regressions on 2, 10 and 40 s of lags (each learns once its own lags are filled), the
  extrapolation, hold and the mean. Per horizon the one with the least realised error is published.
* Work is in samples on an even grid (:mod:`heaved.estimation.rock.sample_clock`), whatever their rate: means and
  learned targets (:mod:`heaved.estimation.rock.learner`) take what noise there is out of many samples. Equations are
  taken every 0.2 s, and every few seconds they are summed and, some sets in turn, solved.

::

    sample, rates --- rate gate                          every 0.2 s         every 1-4 s
       |                |          window of samples --- row, waits for  --- experts scored and chosen,
       '--- gate of each channel --- and running sums    its targets         equations summed and solved
                ^  (holes: a filter)        |                                      |
                '--- one step ahead ---  map of sums to curve  <-------------------'
                                            '--- predictions, deviations

A missing sample is filled with the prediction. Where many are missing, a channel is predicted by a filter that needs
none of them (:mod:`heaved.estimation.rock.holes`), nothing is learned from what was filled, and the lags are given what
the filter knows of the holes once it hands over again. What else may be wrong with samples is dealt with in
:mod:`heaved.estimation.rock.gate`. While the motion leaves its own range nothing is learned.

Readings that come regularly, but not with every sample, are a stream of their own rate; from the samples in between
is predicted along the curve of the last reading, and deviations are those of horizons that much longer.
"""

from __future__ import annotations

from collections import Counter, deque
from enum import StrEnum
from math import ceil, exp, inf, isfinite, nan
from typing import TYPE_CHECKING, Annotated, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.rock import experts, gate, learner
from heaved.estimation.rock.autoregression import NODES
from heaved.estimation.rock.autoregression import TUNING as MODEL
from heaved.estimation.rock.experts import Switch
from heaved.estimation.rock.fading import finite_taps
from heaved.estimation.rock.features import Regressors, SampleWindow, curve_spline, lag_knots, samples_per_step
from heaved.estimation.rock.first_samples import FirstSamples, Sample
from heaved.estimation.rock.gate import Channel, Timing
from heaved.estimation.rock.holes import HoleFilter
from heaved.estimation.rock.learner import Learner, expert_count, first_choice
from heaved.estimation.rock.rate_gate import RateGate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.estimation.rock.limits import Limits
    from heaved.estimation.rock.sample_clock import SampleClock

Array = NDArray[np.float64]


class Reset(StrEnum):
    """What there is to count."""

    RESTART = "restart"
    """The stream was begun anew: its clock was set back, or it has another rate."""
    OUT_OF_BOUNDS = "out of bounds"
    """Likewise, for what it predicted."""
    LOST_TRACK = "lost track"
    """One channel was begun anew: what was read is not what its filter for holes followed."""
    SPIKE = "spike"
    """Samples held back for good."""
    LEVEL_STEP = "level step"


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The part of ``[rock]`` that the direct predictor reads."""

    horizons_s: tuple[Annotated[float, msgspec.Meta(ge=0.01, le=60.0)], ...] = (0.05, 0.10, 0.15, 0.5, 1.0, 2.0, 5.0)
    memory_s: Annotated[float, msgspec.Meta(ge=60.0, le=1800.0)] = 300.0
    """Of the regression on 40 s of lags; those on 10 and 2 s forget faster."""
    max_gap_s: Annotated[float, msgspec.Meta(ge=0.05, le=5.0)] = 2.0
    """Gaps up to this are filled with predictions; after longer ones the lags are filled anew."""
    choice_s: Annotated[float, msgspec.Meta(ge=0.1, le=4.0)] = 1.0
    """Predictions are scored and experts chosen so often: how soon a turn is noticed, and a good part of the cost."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What this file is set to."""

    backwards: int = 20
    """Stamps in a row that are not later: the clock has been set back, begin anew."""
    other: float = 5e-4
    """Change of the interval by which everything that was built for it is built anew: half a millisecond in 1 s."""
    beyond_s: float = 0.5
    """A curve is believed for so long after its last horizon,"""
    short_s: float = 2.0
    """and goes on for so long where that is less than this: beyond, it moves little for what is known of it."""
    late_s: float = 1e-5
    """A sample that is late by less is on time."""
    holes_memory_s: float = 2.0
    """Of what is missing."""
    holes_s: tuple[float, float] = (0.4, 0.15)
    """So much missing within that memory makes a channel one with holes, and so little ends it."""
    rated_holes_s: tuple[float, float] = (0.1, 0.05)
    """The same where rates are given: they tell much, while they are there."""
    run_s: float = 0.15
    """And so much missing on end begins it."""
    still_holed: float = 0.4
    """Share of the samples within that memory that are missing, short holes too, above which it does not end: what the
    regressions have learned, if anything, they have learned from few that were filled."""
    one_hole_s: float = 0.5
    """With less missing than this it was one hole, and what was in it is known from both sides when ..."""
    whole_again_s: float = 0.5
    """... nothing has been missing for so long: then the lags tell more than the filter."""
    learned_s: float = 120.0
    """Before, regressions on 40 s of lags are so young that they make much of what little is wrong with these, and
    deviations are those of few errors."""
    rated_whole_again_s: float = 0.15
    """The same where rates are given, which the filter does not know of: that many of them are looked at."""
    filled_s: float = 10.0
    """What the filter said of its errors fades within that time, for the lags hold what it has filled them with."""
    measured: float = 0.75
    """Share of the nodes that a filter for holes learns from that were measured: the odd missing one is filled well."""
    filter_like: int = 1
    """The expert that sees as much of the past as the filter for holes."""
    surprised_s: float = 0.5
    """Predictions for so long ahead, the longest that is known so soon, show that the motion has become another one,"""
    surprised: float = 1.5
    """when they are off by more than usual by so many of their deviations; what is more widens all others."""
    surprised_for_s: float = 4.0
    foreign_s: float = 1.0
    """Predictions for so long ahead, and those just named, show that something else than waves moves the ship, as a
    crane that lifts or turns, ..."""
    foreign: float = 4.0
    """... when they are off by so many of their deviations: in waves that is so once in a thousand hours."""
    foreign_share: float = 0.1
    """Less of the motion's own deviation is not worth it."""
    foreign_for_s: float = 4.0
    """It goes on for so long after it has shown."""
    grown: float = 2.0
    """A force that is new moves a ship as the square of time, but not for more than so many times as long as it takes
    to be noticed: a ship comes back."""
    out: int = 4
    """Predictions are looked at as often as experts are chosen: so often beyond the limits on end, which is longer than
    a spike is seen, and everything begins anew."""
    learned_together: int = 40
    """Rows (of the learner) after which the filters for holes learn; from every other one, for neighbours are alike."""


TUNING: Final = Tuning()


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
        longest_s = self.horizons_s[-1]
        more_s = [longest_s + TUNING.beyond_s] if longest_s < TUNING.short_s else []
        self._horizons = np.array([*self.horizons_s, *more_s])
        """And one more, where the curve of a moment without a sample would end too soon."""
        self._published = slice(0, len(self.horizons_s))
        self._shown = slice(1, 1 + len(self.horizons_s))
        """The same of a curve, which begins with now."""
        self._n = channels
        self._with_rates = rates
        self._no_rates = [0.0] * channels
        self._unknown_curve = np.full((len(self._horizons) + 1, channels), nan)
        self._growth = np.clip(self._horizons / TUNING.surprised_s, 1.0, TUNING.grown)[:, None] ** 2
        self._limits = limits
        self.begun_anew: Counter[Reset] = Counter()
        """By reason: how often the stream, or (lost track) one channel of it, was begun anew."""
        self._channels: list[Channel] = []
        self._of_before: Counter[Reset] = Counter()
        """Spikes and level steps of the streams before this one."""
        self.reset()

    def reset(self) -> None:
        """Forget everything but what is counted."""
        self._of_before = Counter({Reset.SPIKE: self.spikes, Reset.LEVEL_STEP: self.level_steps})
        self.t_s = -inf
        """Of the last sample that was taken."""
        self._read_s = [-inf] * self._n
        """Of the last reading of each channel."""
        self._backwards = 0
        self._first = FirstSamples()
        self._clock: SampleClock | None = None
        """None until the rate is known, and everything is built for it."""
        self._rate_gate = RateGate(self._n)
        self._forget_built()

    def _forget_built(self) -> None:
        self._channels = []
        self.filters: list[HoleFilter] = []
        """Of the channels, for holes."""
        self.holed: set[int] = set()
        """The channels that are predicted by them."""
        self._left: dict[int, tuple[int, Array]] = {}
        """Of those that no longer are: when that ended, and the deviations now and at the horizons then."""
        count = expert_count(rates=self._with_rates)
        self._replaced: tuple[Array, Array] | None = None
        """Deviations and half-widths of those who made the latest predictions, if others are in office now."""
        self.surplus = [0.0] * self._n
        """By how much of themselves deviations are larger than usual: the motion has just become another one."""
        self._foreign_until = [-inf] * self._n
        """Row until which something else than waves moves a channel."""
        self._unrated_row = -inf
        """The last row whose rates were expected and are not known: what is off then may be off for that."""
        self._switch = Switch(self._horizons, count, self._n, first_choice(self._horizons))
        self._curve = self._unknown_curve
        """What is known of the latest sample (filled where it was missing) and of the horizons."""
        self.values = self._unknown_curve[self._shown]
        """What is predicted."""

    # -- what is known of the errors -------------------------------------------------------------------------------

    @property
    def std(self) -> Array:
        """Standard deviation of the prediction errors, (H, n)."""
        return self._switch.std[self._published]

    @property
    def half_width(self) -> Array:
        """Half-width of the 95 % interval, (H, n)."""
        return self._switch.half_width[self._published]

    @property
    def rms_error(self) -> Array:
        """Rolling RMS of what was published, against what was measured then, (H, n)."""
        return self._switch.rms_error[self._published]

    @property
    def coverage(self) -> Array:
        """Rolling share of measured values inside the published interval, (H, n)."""
        return self._switch.coverage[self._published]

    @property
    def spikes(self) -> int:
        """Samples held back for good."""
        return self._of_before[Reset.SPIKE] + sum(channel.spikes for channel in self._channels)

    @property
    def level_steps(self) -> int:
        """Steps of the level."""
        return self._of_before[Reset.LEVEL_STEP] + sum(channel.level_steps for channel in self._channels)

    @property
    def resets(self) -> Counter[Reset]:
        """By reason, as far as there are any: what was begun anew, held back, or moved."""
        return self.begun_anew + Counter({Reset.SPIKE: self.spikes, Reset.LEVEL_STEP: self.level_steps})

    @property
    def restarts(self) -> int:
        """Times that the stream was begun anew."""
        return self.begun_anew[Reset.RESTART] + self.begun_anew[Reset.OUT_OF_BOUNDS]

    @property
    def experts(self) -> NDArray[np.intp]:
        """The expert in office, (H, n): 0, 1, 2 regressions by their lags, then extrapolation, hold, mean, and the
        regressions without rates.
        """
        return self._switch.best[self._published]

    def deviations(self, t_s: float) -> tuple[Array, Array]:
        """Standard deviations and half-widths of what is predicted from a moment: those of horizons longer by the age
        of the readings, or what the filter for holes says, if that is more.
        """
        std, half_width = self._switch.std, self._switch.half_width
        if self._replaced is not None:
            std, half_width = (np.fmax(now, then) for now, then in zip((std, half_width), self._replaced, strict=True))
        if max(self.surplus) > 0.0:
            wider = 1.0 + self._growth * self.surplus
            std, half_width = std * wider, half_width * wider
        if min(self._read_s) >= t_s and not self.holed and not self._left:
            return self._of_horizons(std), self._of_horizons(half_width)
        std, half_width, horizons = std.copy(), half_width.copy(), self._horizons
        for c, read_s in enumerate(self._read_s):
            if read_s < t_s:
                later = horizons + (t_s - read_s)
                std[:, c] = np.interp(later, horizons, std[:, c])
                half_width[:, c] = np.interp(later, horizons, half_width[:, c])
            if c in self.holed or c in self._left:
                spread = self._spread if c in self.holed else self._spread_left
                own = spread(c, horizons + (t_s - self.t_s))
                half_width[:, c] = np.fmax(half_width[:, c], experts.TUNING.gaussian_quantile * own)
                std[:, c] = np.fmax(std[:, c], own)
        return self._of_horizons(std), self._of_horizons(half_width)

    def _of_horizons(self, found: Array) -> Array:
        return found if len(found) == len(self.horizons_s) else found[self._published]

    def _spread(self, channel: int, ahead_s: Array) -> Array:
        """Deviations, so long after the latest grid time, of a channel that is predicted by its filter for holes.

        Of what it does not see, for its model ends after 10 s, the regression on as many tells.
        """
        deviations: Array = np.sqrt(self.filters[channel].variance(self._row_index, ahead_s))
        alike = self._switch.rms_of(TUNING.filter_like)[:, channel]
        return experts.TUNING.sure * np.fmax(deviations, np.interp(ahead_s, self._horizons, alike))

    def _spread_left(self, channel: int, ahead_s: Array) -> Array:
        """The same of a channel that was predicted so until lately."""
        row, deviations = self._left[channel]
        fade = exp((row - self._row_index) * self._interval_s / TUNING.filled_s)
        if fade < 0.05:
            del self._left[channel]
        left: Array = fade * np.interp(ahead_s, self._curve_s, deviations)
        return left

    # -- samples ---------------------------------------------------------------------------------------------------

    def step(self, t_s: float, values: Sequence[float], rates: Sequence[float] | None = None) -> Array:
        """Take one sample of all channels (nan: not known) and predict from it, (H, n).

        A sample that is not later than the last one is ignored; twenty of them in a row begin everything anew.
        """
        if not t_s > self.t_s:
            self._backwards += t_s == t_s
            if self._backwards >= TUNING.backwards:
                self._restart()
            return self.values
        self._backwards = 0
        if t_s - self.t_s < self._first.same_s:
            return self.values
        if isfinite(sum(values)):
            self._read_s = [t_s] * self._n
        else:
            values = [value if isfinite(value) else nan for value in values]
            known = [value == value for value in values]
            if self._first.is_sparse and not any(known):
                self.values = self.at(t_s)
                return self.values
            self._read_s = [t_s if there else before for there, before in zip(known, self._read_s, strict=True)]
        rates = self._no_rates if rates is None else self._rate_gate.step(t_s, rates)
        first, clock = self._first, self._clock
        if clock is None and t_s - self.t_s > self._params.max_gap_s:
            first.samples.clear()
        self.t_s = t_s
        if clock is None or first.samples:
            first.samples.append(Sample(t_s, values, rates))
        if clock is None:
            if (clock := first.find_clock()) is not None:
                self._build(clock)
            return self.values
        steps, late_s = clock.step(t_s), clock.late_s
        self._rows(steps, values, rates, late_s)
        if self._out >= TUNING.out:
            self._restart(Reset.OUT_OF_BOUNDS)
        elif first.is_look_due(clock):
            self._take_up(first.look_again(clock))
            first.looked()
        elif clock.is_other:
            self._restart()
        else:
            self._publish(late_s)
        return self.values

    def at(self, t_s: float) -> Array:
        """Predictions as seen from a moment without a sample, a little after the last one."""
        if self._clock is None or not 0.0 <= t_s - self.t_s <= self._params.max_gap_s:
            return self._unknown_curve[self._shown]
        at_s = t_s - self.t_s + self._clock.late_s + self._horizons[self._published]
        end_s = float(self._horizons[-1])
        seen: Array = self._curve_spline(np.minimum(at_s, end_s)) @ self._curve
        seen[at_s > end_s + TUNING.beyond_s] = nan
        return seen

    def _restart(self, reason: Reset = Reset.RESTART) -> None:
        self.begun_anew[reason] += 1
        self.reset()

    # -- the rate --------------------------------------------------------------------------------------------------

    def _take_up(self, clock: SampleClock) -> None:
        """Go on with what more of the first samples have shown: for another interval all is built anew."""
        if abs(clock.interval_s - self._interval_s) > TUNING.other * self._interval_s:
            self._forget_built()
            self._build(clock)
        else:
            self._clock = clock
            self._publish(clock.late_s)

    def _build(self, clock: SampleClock) -> None:
        """Everything whose shape depends on the sample interval; then the first samples are taken."""
        self._clock = clock
        self._build_for(clock.interval_s)
        for count, (_, values, rates) in zip(clock.steps_of(self._first.stamps_s), self._first.samples, strict=True):
            self._rows(count, values, rates, 0.0)
        self._publish(clock.late_s)

    def _build_for(self, interval_s: float) -> None:
        horizons, n = self._horizons, self._n
        count = len(horizons)
        self._interval_s = interval_s
        knots = lag_knots(interval_s, learner.TUNING.expert_spans_s[-1])
        taps = finite_taps(interval_s, np.append(horizons, [0.0, 1e-3]))
        settling = taps.shape[1]
        self._longest_gap = max(round(self._params.max_gap_s / interval_s), 3)
        judged = max(round(gate.TUNING.judged_s / interval_s), 3)
        self._unmeasured, self._rates = [nan] * n, [0.0] * n

        self._nodes = max(1, round(MODEL.node_s / interval_s)) * np.arange(NODES)
        """Of the filters, in rows back from the newest."""
        learned = TUNING.learned_together * max(1, round(learner.TUNING.row_s / interval_s))
        batch = round((learner.TUNING.batch_s + 1.0) / interval_s)
        reach = max(int(knots[-1]) + batch + judged, int(self._nodes[-1]) + learned)
        keep = reach + round(learner.TUNING.smoothed_s / interval_s) + 8
        columns = 3 * n if self._with_rates else 2 * n
        self._window = SampleWindow(knots, columns, max(keep, settling))
        # Predictions by extrapolation, and the slope now.
        taps = np.concatenate([taps[:count], (taps[-1:] - taps[-2:-1]) / 1e-3])
        self._regressors = Regressors(self._window, n, taps, rates=self._with_rates)
        now, soon = finite_taps(interval_s, np.array([interval_s, interval_s + 1e-3]))
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

        self._curve_s = np.append(0.0, horizons)
        self._surprised_node = max(int(np.searchsorted(horizons, TUNING.surprised_s + 1e-6)) - 1, 0)
        self._bridged = bridged = samples_per_step(interval_s)
        """Samples between the first knots: so many missing in a row are no hole, for means hold the readings beside."""
        foreign_node = max(int(np.searchsorted(horizons, TUNING.foreign_s + 1e-6)) - 1, 0)
        self._watched = tuple(
            (node, deque[list[float]](maxlen=max(round(float(horizons[node]) / interval_s / bridged), 1)))
            for node in dict.fromkeys((self._surprised_node, foreign_node))
        )
        """Horizons, by number, whose predictions are held against what came, and what was predicted since."""
        self._surprise = [0.0] * n
        """Of each channel: by how many deviations predictions were off lately, at most; it fades."""
        self._surprise_fade = exp(-bridged * interval_s / TUNING.surprised_for_s)
        # Interpolation of the predicted curve: one sample on, and its slope at each horizon.
        self._curve_spline = curve_spline(horizons)
        ahead_s = interval_s * np.arange(1, ceil(horizons[-1] / interval_s) + 2)
        gap_weights = self._curve_spline(np.minimum(ahead_s, horizons[-1]))
        self._one_step = gap_weights[:1]
        self._slopes = self._curve_spline.slope(horizons)[self._published]
        self._seen = np.zeros((n, count + 3, 1))
        self._lowest, self._highest = np.full(self._seen.shape, -inf), np.full(self._seen.shape, inf)
        """Of what is seen, while there are limits: of the curves, that is."""
        self._map = self._mapped()
        self._levels: list[float] = []
        timing = Timing(interval_s=interval_s, settling=settling, longest_gap=self._longest_gap, judged=judged)
        self._channels = [Channel(timing, gap_weights) for _ in range(n)]
        self._row_index = 0
        self._out = 0
        """Times on end that predictions were beyond the limits."""
        self.filters = [HoleFilter(int(self._nodes[1]), interval_s, float(horizons[-1])) for _ in range(n)]
        self._holes_s = TUNING.rated_holes_s if self._with_rates else TUNING.holes_s
        self._whole_again_s = TUNING.rated_whole_again_s if self._with_rates else TUNING.whole_again_s
        self._missing = [0.0] * n
        """Samples missing lately, of those further from the reading before than the first knots are apart."""
        self._missed_row = [0] * n
        """When that was."""
        self._missing_share = [0.0] * n
        """Of the samples of holed channels, in any hole."""
        self._until_learned = TUNING.learned_together

    @property
    def _curves(self) -> Array:
        """(n, H + 1) the latest sample and the predictions, without levels: a view, made when it is asked for; one that
        is kept would stay with the original when a predictor is copied.
        """
        return self._seen[:, :-2, 0]

    def _mapped(self) -> Array:
        """(n, H + 3, width) from the vectors to the latest sample, the predictions, one step on, the slope."""
        regressors, n = self._regressors, self._n
        now, slope = (np.broadcast_to(row, (n, 1, len(row))) for row in (regressors.sample, regressors.taps[-1]))
        curve = np.concatenate([now, self._learner.weights], axis=1)
        return np.concatenate([curve, self._one_step @ curve, slope], axis=1)

    # -- one sample on the grid ------------------------------------------------------------------------------------

    def _rows(self, steps: int, values: Sequence[float], rates: Sequence[float], late_s: float) -> None:
        """So many steps of the grid, the last of which is a sample."""
        if steps > self._longest_gap:
            for channel in self._channels:
                channel.lose()
            self.holed.clear()
            self._learner.forget(slice(None))
            steps = 1
        before, between = self._rates, self._unmeasured
        for k in range(1, steps):
            if self._with_rates and steps <= self._bridged:
                between = [x + k / steps * (y - x) for x, y in zip(before, rates, strict=True)]
            self._row(self._unmeasured, between, 0.0)
        if steps > 0:
            self._row(values, rates, late_s)

    def _row(self, values: Sequence[float], rates: Sequence[float], late_s: float) -> None:
        """One step of the grid: take the sample, predict, learn when it is time."""
        window, channels = self._window, self._channels
        taken, known, means = [], [], []
        curves, near = self._curves, self._seen[:, -2:, 0].tolist()
        self._row_index += 1
        for c, channel in enumerate(channels):
            if c in self.holed:
                x, measured = self._step_holed(c, values[c], late_s)
            else:
                x, measured = channel.step(values[c], late_s, curves[c], *near[c])
            if channel.since == 1:
                window.flatten(c, x)
                self._learner.forget(c)
                self._lowest[c], self._highest[c] = -inf, inf
            taken.append(x)
            known.append(measured)
            means.append(channel.mean)
        if self._with_rates:
            if not isfinite(sum(rates)):
                self._unrated_row = self._row_index
                # One that is missing is what the angles' extrapolation has for now. The slope of what was predicted
                # from earlier ones of these would be fed with itself, and run away.
                expected = (self._regressors.now() @ self._next_slope).tolist()
                rates = [r if isfinite(r) else p if isfinite(p) else 0.0 for r, p in zip(rates, expected, strict=True)]
            self._rates = list(rates)
            taken += self._rates
        window.push(taken + means, known)
        all_known = all(known)
        if not all_known:
            for c, channel in enumerate(channels):
                if (instead := channel.judge()) is not None:
                    window.replace(c, instead)
                if not known[c] and not isfinite(values[c]):
                    self._miss(c)
        np.matmul(self._map, self._regressors.now()[:, :, None], out=self._seen)
        if not all_known:
            for c, channel in enumerate(channels):
                if not isfinite(values[c]) and c not in self.holed and channel.since:
                    curves[c] = channel.last_curve(self._curve_s)
        for c in self.holed:
            hole = self.filters[c]
            curves[c] = hole.mean + hole.curve(self._row_index, self._curve_s)
        if self._limits is not None:
            np.maximum(self._seen, self._lowest, out=self._seen)
            np.minimum(self._seen, self._highest, out=self._seen)
        if self._row_index % self._bridged == 0:
            self._be_surprised(known)
        self._until_row -= 1
        self._replaced = None
        if self._until_row == 0:
            self._until_row = self._learner.every
            self._learn()

    def _learn(self) -> None:
        """A row for the learner, and what falls due with it."""
        channels, curves = self._channels, self._curves
        if self._limits is not None:
            self._bound(self._limits)
        if self._learner.keep(curves[:, 1:].T, channels):
            before = self._switch.std, self._switch.half_width
            if self._learner.batch(channels):
                self._map, self._replaced = self._mapped(), before
            for c in self.holed:
                self._fill(c, self._row_index)
            if self._limits is not None:
                # A filter for holes that knows too little yet is not published, nor held against it.
                levels = [
                    nan if c in self.holed and not self.filters[c].known else channel.level
                    for c, channel in enumerate(channels)
                ]
                is_out = self._limits.left_by(curves.T + levels, tuple(self._curve_s.tolist())).any()
                self._out = self._out + 1 if is_out else 0
        self._until_learned -= 1
        if self._until_learned == 0:
            self._until_learned = TUNING.learned_together
            self._learn_for_holes()

    def _bound(self, limits: Limits) -> None:
        """Predictions of channels with limits stay within reach of the motion."""
        for c, (channel, x, largest) in enumerate(
            zip(self._channels, self._curves[:, 0].tolist(), limits.largest, strict=True)
        ):
            if largest < inf:
                reach = channel.reach(x)
                self._lowest[c, :-2], self._highest[c, :-2] = channel.mean - reach, channel.mean + reach

    def _be_surprised(self, known: Sequence[bool]) -> None:
        """Hold what was predicted some time ago against what there is now."""
        curves, channels = self._curves, self._channels
        now = curves[:, 0].tolist()
        unsettled = [channel.unsettled > 0 or not channel.ready for channel in channels]
        for node, earlier in self._watched:
            if len(earlier) == earlier.maxlen:
                stds = self._switch.std[node].tolist()
                for c, (is_known, x, expected, std) in enumerate(zip(known, now, earlier[0], stds, strict=True)):
                    off = abs(x - expected)
                    stds_off = off / std if is_known and std > 0.0 and c not in self.holed else nan
                    if node == self._surprised_node:
                        surprise = max(self._surprise_fade * self._surprise[c], stds_off if stds_off < inf else 0.0)
                        self._surprise[c] = surprise
                        self.surplus[c] = max(0.0, surprise - TUNING.surprised - 1.0)
                    if TUNING.foreign < stds_off < inf:
                        self._note_foreign(c, off, len(earlier) * self._bridged)
            later = curves[:, node + 1].tolist()
            earlier.append([nan if young else value for value, young in zip(later, unsettled, strict=True)])
        for c, channel in enumerate(channels):
            if self._row_index < self._foreign_until[c]:
                channel.calm = 0

    def _note_foreign(self, c: int, off: float, since: int) -> None:
        """Something else than waves has moved a channel by so much within so many rows: nothing is learned from it, nor
        predicted with what it has left in the lags, of which nothing was learned.
        """
        channel, row = self._channels[c], self._row_index
        is_new = row >= self._foreign_until[c]
        if (row - self._unrated_row) * self._interval_s < TUNING.foreign_s:
            return
        if is_new and (
            channel.calm * self._interval_s < TUNING.learned_s or off < TUNING.foreign_share * channel.spread
        ):
            return
        self._foreign_until[c] = row + round(TUNING.foreign_for_s / self._interval_s)
        if is_new:
            self._learner.unlearn(c, since)

    # -- holes -----------------------------------------------------------------------------------------------------

    def _miss(self, c: int) -> None:
        """A sample of a channel is missing: where too many are, its filter takes over."""
        row, channel = self._row_index, self._channels[c]
        if channel.absent < self._bridged:
            return
        self._missing[c] = 1.0 + self._missing[c] * self._share_left(row - self._missed_row[c])
        self._missed_row[c] = row
        if c in self.holed or not channel.since:
            return
        is_holed = self._missing[c] * self._interval_s >= self._holes_s[0]
        if not is_holed and channel.absent * self._interval_s < TUNING.run_s:
            return
        if self._begin_filter(c):
            self.holed.add(c)
            self._missing_share[c] = 1.0

    def _begin_filter(self, c: int) -> bool:
        window, channel = self._window, self._channels[c]
        at = window.end - 1 - self._nodes
        return self.filters[c].begin(
            self._row_index, window.x[at, c], window.known[at, c], channel.mean, channel.noise_square
        )

    def _share_left(self, rows: int) -> float:
        return exp(-rows * self._interval_s / TUNING.holes_memory_s)

    def _step_holed(self, c: int, value: float, late_s: float) -> tuple[float, bool]:
        """What goes into the lags of a channel with holes, and whether it was measured."""
        row, channel, hole = self._row_index, self._channels[c], self.filters[c]
        hole.to(row)
        measured = isfinite(value)
        if measured and hole.is_astray:
            self._begin_filter(c)
        self._missing_share[c] += (1.0 - self._share_left(1)) * ((not measured) - self._missing_share[c])
        if measured:
            at = row + late_s / self._interval_s
            x = value - channel.level
            if measured := hole.read(at, x - hole.mean):
                x -= hole.value(at)[0] - hole.value(row)[0]
            if hole.is_lost(row):
                self.begun_anew[Reset.LOST_TRACK] += 1
                channel.forget()
        if not measured:
            x = hole.mean + hole.value(row)[0]
        if not channel.step_judged(x, measured=measured):
            self.holed.discard(c)
        elif measured:
            since = row - self._missed_row[c]
            missing_s = self._missing[c] * self._share_left(since) * self._interval_s
            is_whole = since * self._interval_s > self._whole_again_s
            is_old = self._row_index * self._interval_s > TUNING.learned_s
            was_one = is_whole and is_old and missing_s < TUNING.one_hole_s
            is_rare = missing_s < self._holes_s[1] and self._missing_share[c] < TUNING.still_holed
            if was_one or is_rare:
                self._left[c] = row, self._spread(c, self._curve_s)
                self.holed.discard(c)
                self._fill(c, row - 1)  # the latest is not in the window yet
        return x, measured

    def _fill(self, c: int, row: int) -> None:
        """The lags of a channel get what its filter has come to know of the holes."""
        window, hole = self._window, self.filters[c]
        count = min(self._channels[c].since - 2, int(self._nodes[-1]) - int(self._nodes[1]))
        if count <= 0:
            return
        ago = np.arange(count - 1, -1, -1)
        window.fill(c, hole.mean + hole.past((row - ago).astype(np.float64)))

    def _learn_for_holes(self) -> None:
        """From stretches without any: every other of the rows since the last time, smoothed, for the noise of readings
        is taken care of elsewhere.
        """
        window, n, taps = self._window, self._n, self._learner.shaking_taps
        half = len(taps) // 2
        ends = window.end - 1 - half - 2 * int(self._learner.every) * np.arange(TUNING.learned_together // 2)
        at = ends[:, None] - self._nodes
        # A node is known by a reading that is nearer than the first knots are.
        known = window.known[at[:, :, None] - np.arange(self._bridged), :n].any(axis=2)
        used = np.ones((len(ends), n), dtype=bool) if known.all() else known.mean(axis=1) >= TUNING.measured  # (R, n)
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
        self._curve = curves + self._level
        self.values = self._curve[self._shown]
        if abs(late_s) > TUNING.late_s:
            self.values = self.values + late_s * (self._slopes @ curves)
