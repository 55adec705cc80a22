"""Samples in, block means out to the direct predictor, and a prediction from every sample in between.

A block of samples becomes one: their mean, taken about the curve that was predicted for them, so that missing samples,
jitter and spikes leave no trace, and valid at the middle of the block. Predictions of the samples in between follow
that curve over the horizons, corrected by what came since (:mod:`heaved.estimation.rock.carry`). Both are linear: one
matrix for each place in the block leads from [curve | innovations] to what is published, and what is handed out is just
these (:class:`heaved.block_outlook.BlockOutlook`): few of a hundred predictions a second are looked at one by one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import ceil, inf, isfinite, nan
from operator import sub
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from heaved.block_outlook import BlockMaps, BlockOutlook, Moment
from heaved.estimation.rock.block_learning import ON_TIME, BlockLearner
from heaved.estimation.rock.carry import CORRECTED_S
from heaved.estimation.rock.direct import DirectPredictor, Params
from heaved.predictions import Limits

Array = NDArray[np.float64]

PHASE_GAIN, INTERVAL_GAIN = 0.1, 0.0025
"""Of the loop that follows phase and interval of the blocks: critically damped."""
DRIFT: Final = 1e-3
"""Relative change of the interval after which the places on the curve are worked out anew."""
FINE_S: Final = 0.25
"""Up to here the curve has a node for each block: what is published soon lies between them at any phase."""


class Blocks:
    """Blocks of ``samples`` for n channels; arrays published are (H, n)."""

    def __init__(
        self,
        params: Params,
        samples: int,
        interval_s: float,
        channels: int,
        *,
        rates: bool = False,
        limits: Limits | None = None,
    ) -> None:
        """``interval_s``: of the samples; ``rates``: the first derivative of every channel is given with each.

        ``limits``: what no channel does.
        """
        self._horizons = np.unique(params.horizons_s)
        self._samples, self._n = samples, channels
        self.interval_s = interval_s
        """Of the samples, as they come."""
        self._max_gap_s = params.max_gap_s
        nodes_s = self._nodes()
        at_nodes = msgspec.structs.replace(params, horizons_s=nodes_s)
        self.fed = DirectPredictor(channels, at_nodes, rates=rates, limits=limits)
        """What predicts from the block means."""
        self._aim()
        self._learner = BlockLearner(self._horizons, samples, interval_s, self._weights, channels)
        self.switch = self._learner.switch
        """What knows the errors of what is published."""
        self._map()
        self.gated = 0
        """Samples of blocks that were left out as spikes."""
        self._unknown = np.full((len(self._horizons), channels), nan)
        self.latest: Moment | Array = self._unknown
        """What is published."""
        self._nothing = [nan] * channels
        self._no_curve = np.full((len(nodes_s) + 1, channels), nan)
        self._slots = [slice(channels * (place - 1), channels * place) for place in range(samples + 1)]
        """Of the channels, among those of a block's samples, by their place from 1."""
        self._end_s = self.origin_s = -inf
        """When the last block ended, and its middle."""
        self._expected: list[list[float]]
        """Of its samples, and of its middle."""
        self._outlook: BlockOutlook
        self._phase: int
        self._late: float
        """Of all samples of the block together, in samples."""
        self._came: int
        self._values: list[float]
        self._rates: list[Sequence[float]]
        self._rate_places: list[int]
        self._are_rated = rates
        self._last_rates = self._nothing
        self._shown_phase: int
        self._shown_now: Moment | None
        """What is published at that place, and will be scored."""
        self._lose()

    @property
    def _block_s(self) -> float:
        return self._samples * self.interval_s

    def _nodes(self) -> tuple[float, ...]:
        """Horizons of what is fed with means, from which the curve is drawn."""
        samples, interval_s, block_s = self._samples, self.interval_s, self._block_s
        lag_s = 0.5 * (samples - 1) * interval_s
        late_s = lag_s + block_s - interval_s
        horizons_s = self._horizons.tolist()
        fine = ceil((min(FINE_S, horizons_s[-1]) + late_s) / block_s - 1e-6)
        nodes = {i for i in range(1, fine + 1) if i * block_s <= FINE_S + 1e-6 or i == 1}
        for h in horizons_s:
            if h + late_s > FINE_S:  # near the middle of where it moves, or on both sides where little is lost
                first, last = (h + lag_s) / block_s, (h + late_s) / block_s
                nodes |= {int(first + 1e-6), ceil(last)} if h <= CORRECTED_S else {round(0.5 * (first + last))}
        return tuple(float(i * block_s) for i in sorted(nodes))

    def _aim(self) -> None:
        """What follows from the interval, which the first stamps tell within some percent only."""
        samples, interval_s = self._samples, self.interval_s
        self._aimed_s = interval_s
        self._lag_s = 0.5 * (samples - 1) * interval_s
        nodes = np.append(0.0, self.fed.horizons_s)
        spline = CubicSpline(nodes, np.eye(len(nodes)), axis=0)
        # The curve at each horizon, for each sample of a block (0: when it is fed); what is expected of the samples of
        # the next, and of its middle.
        since_s = self._lag_s + interval_s * np.arange(samples + 1)
        self._weights = spline(np.minimum(since_s[:, None] + self._horizons, nodes[-1]))
        self._expectation = spline(np.minimum(np.append(since_s, samples * interval_s), nodes[-1]))

    def _map(self) -> None:
        """What is published of a block: along the curve, and corrected."""
        samples, horizons, nodes = self._samples, len(self._horizons), self._weights.shape[2]
        weights = np.zeros((self._n, samples, horizons, nodes + samples - 1))
        weights[..., :nodes] = self._weights[:-1]
        carry = self._learner.carry
        weights[:, 1:, : self._learner.short, nodes:] = carry.gains.transpose(1, 0, 2, 3)
        slopes = np.diff(self._weights[:-1], axis=0, prepend=self._weights[:1])
        self._maps = BlockMaps(weights=weights, slopes=slopes, gates=carry.gate)
        self._gate: list[float] = carry.gate[-1].tolist()

    # -- one sample ------------------------------------------------------------------------------------------------

    def step(self, t_s: float, values: list[float], rates: Sequence[float] | None) -> Moment | Array:
        """Take a sample later than the one before and predict from it."""
        if self._end_s == -inf:
            self._end_s = t_s - self.interval_s
            self.origin_s = self._end_s - self._lag_s
        place = (t_s - self._end_s) / self.interval_s
        phase = round(place)
        if phase > self._samples:
            place = self._catch_up(t_s)
            phase = round(place)
        off = place - phase
        self._late += off
        self._came += 1
        if phase < 1:
            return self.latest
        expected = self._expected[phase]
        if -ON_TIME <= off <= ON_TIME:
            off = 0.0
        else:
            expected = [x + off * (x - y) for x, y in zip(expected, self._expected[phase - 1], strict=True)]
        here = self._slots[phase]
        self._values[here] = values
        if rates is not None:
            self._rates.append(rates)
            self._rate_places.append(phase)
        if phase == self._samples:
            self._feed(map(sub, values, expected))
            phase, off = 0, 0.0
        else:
            if phase == self._phase:  # two for one place: what was predicted from the first stays
                outlook = self._outlook
                self._outlook = BlockOutlook(outlook.curve, outlook.innovations.copy(), outlook.maps)
            self._outlook.innovations[here] = map(sub, values, expected)
        self._phase = phase
        moment = self.latest = self._outlook, phase, off
        if phase == self._shown_phase:
            self._shown_now = moment
        return moment

    @property
    def correction(self) -> Array:
        """What is added to the curve for the samples since the last block, (H, n)."""
        outlook = self._outlook
        nothing = BlockOutlook(outlook.curve, [nan] * len(outlook.innovations), outlook.maps)
        return outlook.at(self._phase, 0.0) - nothing.at(self._phase, 0.0)

    def _catch_up(self, t_s: float) -> float:
        """Samples are missing at the end of a block: it is closed with what it has; the next ones have nothing."""
        if t_s - self._end_s > self._max_gap_s + self._block_s:
            blocks = int((t_s - self._end_s) / self._block_s)
            self._end_s += blocks * self._block_s
            self.origin_s = self._end_s - self._lag_s
            self._learner.lose()
            self._lose()
        while round((t_s - self._end_s) / self.interval_s) > self._samples:
            self._feed(self._nothing)
        return (t_s - self._end_s) / self.interval_s

    # -- one block -------------------------------------------------------------------------------------------------

    def _feed(self, last: Iterable[float]) -> None:
        """Close a block: feed its mean, begin the next. ``last``: its last innovation."""
        self._end_s += self._block_s
        if self._came:
            # Of all samples: those that fall on one place are not the ones that tell how late they come in the mean.
            deviation_s = self._late / self._came * self.interval_s
            self._end_s += PHASE_GAIN * deviation_s
            self.interval_s += INTERVAL_GAIN * deviation_s / self._samples
        innovations = [*self._outlook.innovations, *last]
        mean = self._means(innovations)
        is_due = self._learner.keep(self._values, innovations, self._outlook.curve, self._shown_now)
        rates = self._mean_rates() if self._are_rated else None
        self.origin_s = self._end_s - self._lag_s
        self.fed.step(self.origin_s, mean, rates)
        if is_due:
            if abs(self.interval_s - self._aimed_s) > DRIFT * self.interval_s:
                self._aim()
                self._learner.aim(self.interval_s, self._weights)
            self._learner.batch(self._block_s, self.fed.shaking_square)
            self._map()
        curve = self.fed.curve
        self._expected = self._expectation.dot(curve).tolist()
        self._open(curve)

    def _lose(self) -> None:
        """Nothing is expected."""
        self.latest = self._unknown
        self._expected = [self._nothing] * (self._samples + 2)
        self._open(self._no_curve)

    def _open(self, curve: Array) -> None:
        """A block without samples."""
        samples, nothing = self._samples, self._nothing
        self._phase = self._came = 0
        self._late = 0.0
        self._outlook = BlockOutlook(curve, nothing * (samples - 1), self._maps)
        self._values = nothing * samples
        self._rates, self._rate_places = [], []
        self._shown_phase, self._shown_now = self._learner.scored_place, None

    def _mean_rates(self) -> list[float]:
        """Of a block, for its middle; nan: there are none. Those of a part of it are moved there by how they change."""
        count = len(self._rates)
        totals = list(map(sum, zip(*self._rates, strict=True)))
        if count == self._samples and isfinite(sum(totals)):
            self._last_rates = [total / count for total in totals]
            return self._last_rates
        placed = zip(self._rate_places, self._rates, strict=True)
        known = [(place, rates) for place, rates in placed if all(map(isfinite, rates))]
        if not known:
            self._last_rates = self._nothing
            return self._nothing
        early = 0.5 * (self._samples + 1) - sum(place for place, _ in known) / len(known)
        means = [total / len(known) for total in map(sum, zip(*(rates for _, rates in known), strict=True))]
        change = early / (self._samples - early)
        self._last_rates = [
            mean + change * (mean - last) if isfinite(last) else mean
            for mean, last in zip(means, self._last_rates, strict=True)
        ]
        return self._last_rates

    def _means(self, innovations: list[float]) -> list[float]:
        """Of a block, for its middle: about the curve, where there is one, and without what is far from it."""
        means = []
        samples, n = self._samples, self._n
        for channel, (limit, middle) in enumerate(zip(self._gate, self._expected[-1], strict=True)):
            e = innovations[channel::n]
            total = sum(e)
            if isfinite(total) and -limit <= min(e) and max(e) <= limit:
                means.append(middle + total / samples)
            else:
                means.append(self._mean_of_some(channel, innovations))
        return means

    def _mean_of_some(self, channel: int, innovations: list[float]) -> float:
        """Of a channel with missing samples, spikes (which are taken out), or nothing to be expected."""
        mine = slice(channel, None, self._n)
        known = [e for e in innovations[mine] if isfinite(e)]
        if not known:
            plain = [value for value in self._values[mine] if isfinite(value)]
            return sum(plain) / len(plain) if plain else nan
        limit = self._gate[channel]
        near = [e for e in known if -limit <= e <= limit]
        if len(near) < len(known) < 2 * len(near):
            self.gated += len(known) - len(near)
            known = near
            for place in range(channel, len(innovations), self._n):
                if not -limit <= innovations[place] <= limit:  # No measurement: it teaches nothing and judges nobody.
                    self._values[place] = innovations[place] = nan
        middle: float = self._expected[-1][channel]
        return middle + sum(known) / len(known)
