"""The direct predictor at a pace: fed some 20 times a second whatever the rate of the samples, predicting from each.

A regression on lags costs the same for every sample, and of a motion of seconds 20 samples a second tell all but the
sensor's noise. So samples at a faster rate are fed in blocks (:mod:`heaved.estimation.rock.blocks`). Errors, deviations
and intervals are those of what is published, against the single samples.

Readings that come regularly, but not with every sample, are a stream of their own rate; from the samples in between
is predicted along the curve of the last reading, and deviations are those of horizons that much longer.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from math import exp, inf, isfinite, nan
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from heaved.block_outlook import Moment
from heaved.estimation.common.sample_rate import are_still_apart, usual_interval
from heaved.estimation.rock.blocks import Blocks
from heaved.estimation.rock.direct import BACKWARDS, SURPRISED_S, DirectPredictor, Params
from heaved.estimation.rock.experts import GAUSSIAN_QUANTILE, Switch
from heaved.estimation.rock.rate_gate import RateGate
from heaved.estimation.rock.sample_clock import LEAST_S
from heaved.predictions import Limits

Array = NDArray[np.float64]

PACE_HZ: Final = 20.0
SPARE: Final = 0.05
"""A rate of 99.9 Hz is one of 100 Hz."""
FIRST: Final = 11
"""Stamps before the interval is known, and those by which it is judged later, at least."""
FIRST_S: Final = 2.0
"""And so much time: the polls of a start are held up by 20-50 ms now and then, and jitter has to average out. Nothing
is lost, for nothing is published before 2 s are there."""
JUDGED_S: Final = 2.0
"""The recent past by which the interval is judged."""
CHECKED_S: Final = 1.0
"""It is judged so often: a new rate is noticed within 3 s."""
CHANGED: Final = 0.2
"""Relative change of the usual interval that asks for other blocks."""
SAME_S: Final = 1e-4
"""Samples closer together are one; where they come in bursts, those closer than the shortest interval."""
BURSTS: Final = 0.7
"""Share of the samples that are farther apart than that, below which they come in bursts."""
WAIT_S: Final = 8.0
"""For so long readings are waited for to show their rate: a sensor of 1.4 Hz does."""
SLOWER: Final = 1.5
"""Intervals of samples to one of readings, at least, that make them a stream of their own,"""
REGULAR: Final = 0.7
"""and share of their intervals that are the usual one, within CHANGED."""
THIN_S: Final = 2.0
"""Blocks that miss samples have means with as much more noise, by what was missing lately."""
GROWN: Final = 2.0
"""But not for more than so many times as long as it takes to be noticed: a ship comes back."""
BEYOND_S: Final = 0.5
"""A curve is believed for so long after its last horizon."""


class PacedPredictor:
    """Predicts n channels at once; arrays are (H, n), in the unit of the channels, as those of DirectPredictor."""

    def __init__(
        self,
        channels: int,
        params: Params | None = None,
        *,
        rates: bool = False,
        limits: Limits | None = None,
    ) -> None:
        """``rates``: the first derivative of every channel is given with each sample.

        ``limits``: what no channel does; a prediction beyond them begins everything anew.
        """
        self._params = params if params is not None else Params()
        self._n, self._rates, self._limits = channels, rates, limits
        self.horizons_s = tuple(sorted(set(self._params.horizons_s)))
        count = len(self.horizons_s)
        self._growth = np.clip(np.array(self.horizons_s) / SURPRISED_S, 1.0, GROWN)[:, None] ** 2
        """Of what surprises: a force that is new moves a ship as the square of time."""
        self._unknown = np.full((count, channels), nan)
        self._nothing_scored = Switch(np.array(self.horizons_s), 1, channels, np.zeros(count, dtype=np.intp))
        self._begun_anew: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.t_s = -inf
        """Of the last sample that was taken."""
        self._whole_s = -inf
        """Of the last sample with a reading of every channel."""
        self._read_s = [-inf] * self._n
        """Of the last reading of each channel, until there is one of every channel."""
        self._thin = False
        """Samples of blocks are missing, or were lately:"""
        self._lost_s = [0.0] * self._n
        """so much of the last THIN_S, of each channel,"""
        self._thin_s = 0.0
        """as of then."""
        self._same_s = SAME_S
        self._is_sparse = False
        """Readings come at their own rate: samples without any are not fed."""
        self._backwards = 0
        self._rate_gate = RateGate(self._n)
        self._pending: list[tuple[float, list[float], Sequence[float] | None]] = []
        self._recent: deque[float] = deque()
        """Stamps of the last JUDGED_S."""
        self._check_s = inf
        """When the interval is judged again."""
        self.latest: Moment | Array = self._unknown
        """Predictions from the last sample, or what they are worked out from."""
        self.fed: DirectPredictor | None = None
        """What predicts; None until the rate is known."""
        self._blocks: Blocks | None = None
        """What it is fed through; None if with every sample."""
        self._taking: Blocks | DirectPredictor | None = None
        """Which of them takes the samples."""
        self.scored: Switch | DirectPredictor = self._nothing_scored
        """What knows the errors of what is published."""

    # -- what is known of the errors -------------------------------------------------------------------------------

    @property
    def std(self) -> Array:
        """Standard deviation of the prediction errors."""
        return self.scored.std

    @property
    def half_width(self) -> Array:
        """Half-width of the 95 % interval."""
        return self.scored.half_width

    @property
    def rms_error(self) -> Array:
        """Rolling RMS of what was published against what was measured then."""
        return self.scored.rms_error

    @property
    def coverage(self) -> Array:
        """Rolling share of measured values inside the published interval."""
        return self.scored.coverage

    @property
    def restarts(self) -> int:
        """Times that the stream was begun anew."""
        return self.begun_anew["restart"] + self.begun_anew["out of bounds"]

    @property
    def begun_anew(self) -> Counter[str]:
        """By reason: how often the stream, or (lost track) one channel of it, was begun anew."""
        return self._begun_anew + self.fed.begun_anew if self.fed is not None else self._begun_anew

    @property
    def spikes(self) -> int:
        """Samples held back for good since the stream was begun."""
        gated = self._blocks.gated if self._blocks is not None else 0
        return gated + (self.fed.spikes if self.fed is not None else 0)

    @property
    def level_steps(self) -> int:
        """Steps of the level since the stream was begun."""
        return self.fed.level_steps if self.fed is not None else 0

    # -- one sample ------------------------------------------------------------------------------------------------

    @property
    def values(self) -> Array:
        """Predictions from the last sample."""
        latest = self.latest
        return latest if isinstance(latest, np.ndarray) else latest[0].at(*latest[1:])

    def step(self, t_s: float, values: list[float], rates: Sequence[float] | None = None) -> Array:
        """Take one sample as :meth:`take` does and predict from it."""
        self.take(t_s, values, rates)
        return self.values

    def take(self, t_s: float, values: list[float], rates: Sequence[float] | None = None) -> Moment | Array:
        """Take one sample of all channels (nan: not known); what is predicted from it is worked out when needed.

        A sample that is not later than the last one is ignored; twenty of them in a row begin everything anew.
        """
        if not t_s > self.t_s:
            self._backwards += t_s == t_s
            if self._backwards >= BACKWARDS:
                self._restart()
            return self.latest
        self._backwards = 0
        if t_s - self.t_s < self._same_s:
            return self.latest
        if isfinite(sum(values)):
            self._whole_s = t_s
        else:
            values = [value if isfinite(value) else nan for value in values]
            known = [value == value for value in values]
            if self._blocks is not None:
                self._follow_thin(t_s)
                self._lost_s = [
                    lost_s if is_known else lost_s + self._interval_s
                    for is_known, lost_s in zip(known, self._lost_s, strict=True)
                ]
                self._thin = True
            if self._is_sparse and not any(known):
                self.latest = self.at(t_s)
                return self.latest
            self._read_s = [
                t_s if is_known else max(read_s, self._whole_s)
                for is_known, read_s in zip(known, self._read_s, strict=True)
            ]
        if rates is not None:
            rates = self._rate_gate.take(t_s, rates)
        if self._taking is None:
            if t_s - self.t_s > self._params.max_gap_s:
                self._pending = []
            self.t_s = t_s
            self._pending.append((t_s, values, rates))
            if len(self._pending) >= FIRST and t_s - self._pending[0][0] >= FIRST_S:
                self._begin()
            return self.latest
        self.t_s = t_s
        self._recent.append(t_s)
        if t_s >= self._check_s and self._rate_changed():
            self._restart()
            return self.latest
        self.latest = self._taking.step(t_s, values, rates)
        return self.latest

    def deviations(self, t_s: float) -> tuple[Array, Array]:
        """Standard deviations and half-widths of what is predicted from a moment: those of horizons longer by the age
        of the readings, or what the filter for holes says, if that is more."""
        std, half_width = self.scored.std, self.scored.half_width
        fed = self.fed
        if fed is not None and max(fed.surplus) > 0.0:
            wider = 1.0 + self._growth * fed.surplus
            std, half_width = std * wider, half_width * wider
        if fed is None or (self._whole_s == t_s and not fed.holed and not fed.given_back and not self._thin):
            return std, half_width
        std, half_width, horizons = std.copy(), half_width.copy(), np.array(self.horizons_s)
        origin_s = self._blocks.origin_s if self._blocks is not None else self.t_s
        for c in range(self._n):
            later = horizons + max(t_s - max(self._read_s[c], self._whole_s), 0.0)
            own_std = np.interp(later, horizons, std[:, c])
            half_width[:, c] = np.interp(later, horizons, half_width[:, c])
            if c in fed.holed or c in fed.given_back:
                spread = fed.spread if c in fed.holed else fed.spread_left
                own = spread(c, horizons + (t_s - origin_s))
                half_width[:, c] = np.fmax(half_width[:, c], GAUSSIAN_QUANTILE * own)
                own_std = np.fmax(own_std, own)
            std[:, c] = own_std
        if self._thin:
            self._follow_thin(t_s)
            for c, lost_s in enumerate(self._lost_s):
                if c not in fed.holed:
                    thinner = 1.0 / max(1.0 - lost_s / THIN_S, 0.1) ** 0.5
                    std[:, c] *= thinner
                    half_width[:, c] *= thinner
        return std, half_width

    def _follow_thin(self, t_s: float) -> None:
        """What was missing within the blocks fades."""
        fade = exp((self._thin_s - t_s) / THIN_S)
        self._thin_s = t_s
        self._lost_s = [fade * lost_s for lost_s in self._lost_s]
        self._thin = max(self._lost_s) > 0.01 * THIN_S

    def at(self, t_s: float) -> Array:
        """Predictions as seen from a moment without a sample, a little after the last one."""
        if self.fed is None or not 0.0 <= t_s - self.t_s <= self._params.max_gap_s:
            return self._unknown
        curve = self.fed.curve
        if not np.isfinite(curve).any():
            return self._unknown
        origin_s = self._blocks.origin_s if self._blocks is not None else self.t_s
        nodes = np.append(0.0, self.fed.horizons_s)
        at_s = t_s - origin_s + np.array(self.horizons_s)
        believed = np.isfinite(curve).all(axis=0) & (at_s <= nodes[-1] + BEYOND_S)[:, None]
        at_s = np.minimum(at_s, nodes[-1])
        seen: Array = np.where(believed, CubicSpline(nodes, np.nan_to_num(curve))(at_s), nan)
        return seen if self._blocks is None else seen + self._blocks.correction

    def _rate_changed(self) -> bool:
        recent = self._recent
        self._check_s = self.t_s + CHECKED_S
        while len(recent) > FIRST and self.t_s - recent[0] > JUDGED_S:
            recent.popleft()
        if len(recent) < FIRST:
            return False
        allowed_s = CHANGED * self._interval_s
        mean_s = (recent[-1] - recent[0]) / (len(recent) - 1)
        if abs(mean_s - self._interval_s) <= allowed_s:
            return False  # Held-up polls change intervals, not their mean; lost ones the mean, not the usual interval.
        stamps_s = np.array(recent)
        if are_still_apart(stamps_s - stamps_s[0], self._interval_s):
            return False
        return abs(usual_interval(stamps_s) - self._interval_s) > allowed_s

    def _restart(self) -> None:
        self._begun_anew = self.begun_anew
        self._begun_anew["restart"] += 1
        self.reset()

    def _begin(self) -> None:
        """The rate is known: build, and take what has waited."""
        apart = np.diff([t for t, _, _ in self._pending], prepend=-inf) >= LEAST_S
        if np.mean(apart) < BURSTS and self._same_s < LEAST_S:
            self._same_s = LEAST_S
            self._pending = [one for one, is_apart in zip(self._pending, apart.tolist(), strict=True) if is_apart]
            if len(self._pending) < FIRST:
                return
        interval_s = max(usual_interval(np.array([t for t, _, _ in self._pending])), LEAST_S)
        stamps_s = [t for t, values, _ in self._pending if any(value == value for value in values)]
        if len(stamps_s) < len(self._pending):
            if len(stamps_s) < FIRST and self.t_s - self._pending[0][0] < WAIT_S:
                return
            if (own_s := _own_interval(stamps_s)) > SLOWER * interval_s:
                self._is_sparse, interval_s = True, own_s
        self._interval_s = interval_s
        self._check_s = self.t_s + CHECKED_S
        samples = max(1, int(1.0 / (PACE_HZ * interval_s) + SPARE))
        if samples > 1:
            blocks = self._taking = self._blocks = Blocks(
                self._params, samples, interval_s, self._n, rates=self._rates, limits=self._limits
            )
            self.fed, self.scored = blocks.fed, blocks.switch
        else:
            self._taking = self.fed = self.scored = DirectPredictor(
                self._n, self._params, rates=self._rates, limits=self._limits
            )
        pending, self._pending = self._pending, []
        for t, values, rates in pending:
            if self._is_sparse and not any(value == value for value in values):
                continue
            self.t_s = t
            self.latest = self._taking.step(t, values, rates)


def _own_interval(stamps_s: Sequence[float]) -> float:
    """Of readings that come regularly; nan: they do not."""
    if len(stamps_s) < FIRST:
        return nan
    stamps = np.array(stamps_s)
    interval_s = usual_interval(stamps)
    usual = np.abs(np.diff(stamps) - interval_s) < CHANGED * interval_s
    return interval_s if np.mean(usual) >= REGULAR else nan
