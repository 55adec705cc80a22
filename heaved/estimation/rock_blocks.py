"""Samples in, block means out to the direct predictor, and a prediction from every sample in between.

A block of samples becomes one: their mean, taken about the curve that was predicted for them, so that missing samples,
jitter and spikes leave no trace, and valid at the middle of the block. Predictions of the samples in between follow
that curve over the horizons, corrected by what came since (:mod:`heaved.estimation.rock_carry`). Both are linear: one
matrix for each place in the block leads from [curve | innovations] to what is published.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, inf, isfinite, nan
from operator import sub
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from heaved.estimation.rock_carry import CORRECTED_S, Carry
from heaved.estimation.rock_direct import DirectPredictor, Params
from heaved.estimation.rock_experts import Switch

Array = NDArray[np.float64]

PHASE_GAIN, INTERVAL_GAIN = 0.1, 0.0025
"""Of the loop that follows phase and interval of the blocks: critically damped."""
DRIFT: Final = 1e-3
"""Relative change of the interval after which the places on the curve are worked out anew."""
ON_TIME: Final = 0.02
"""Deviation of a stamp from its place, in samples, that makes no difference."""
FINE_S: Final = 0.25
"""Up to here the curve has a node for each block: what is published soon lies between them at any phase."""
BATCH_S: Final = 4.0
SCORED: Final = 2
"""Every second block is scored, one phase after the other: errors closer together are hardly different ones."""


class Blocks:
    """Blocks of ``samples`` for n channels; arrays published are (H, n)."""

    def __init__(self, params: Params, samples: int, interval_s: float, channels: int, *, rates: bool = False) -> None:
        """``interval_s``: of the samples; ``rates``: the first derivative of every channel is given with each."""
        self._horizons = np.unique(params.horizons_s)
        self._samples, self._interval_s, self._n = samples, interval_s, channels
        self._max_gap_s = params.max_gap_s
        block_s = self._block_s = samples * interval_s
        nodes_s = self._nodes()
        self.fed = DirectPredictor(channels, msgspec.structs.replace(params, horizons_s=nodes_s), rates=rates)
        """What predicts from the block means."""
        horizons, nodes = len(self._horizons), len(nodes_s) + 1
        self._short = short = int(np.count_nonzero(self._horizons <= CORRECTED_S))
        self._carry = Carry(samples - 1, short, channels, block_s)
        self.switch = Switch(self._horizons, 1, channels, np.zeros(horizons, dtype=np.intp))
        self.gated = 0
        """Samples of blocks that were left out as spikes."""
        self._unknown = np.full((horizons, channels), nan)
        self.values: Array = self._unknown
        """What is published."""

        # Of a channel: the curve (latest mean and nodes), then the innovations since; maps by samples since.
        self._state = np.zeros((channels, nodes + samples - 1, 1))
        self._curve, self._e = self._state[:, :nodes, 0], self._state[:, nodes:, 0]
        self._maps = np.zeros((samples, channels, horizons, nodes + samples - 1))
        self._aim()
        self._build_rings(horizons, nodes)
        self._since_batch = 0
        self._blocks = 0
        self._shown_phase = -1
        self._gates: list[list[float]] = self._carry.gate.tolist()
        self._end_s = self.origin_s = -inf
        """When the last block ended, and its middle."""
        self._nothing = [nan] * channels
        self._values_in: list[list[float]]
        self._e_in: list[list[float]]
        self._rates_in: list[Sequence[float]] = []
        self._lose()

    def _build_rings(self, horizons: int, nodes: int) -> None:
        """By blocks: what was measured, what of it had not been expected, from which curve; what was published."""
        samples, channels = self._samples, self._n
        self._per_batch = max(SCORED, SCORED * round(BATCH_S / self._block_s / SCORED))
        # In blocks, even ones: those that are scored.
        self._delay = SCORED * np.ceil((samples + self._ahead + 1.0) / samples / SCORED).astype(np.intp)
        self._kept = self._per_batch + int(self._delay[-1]) + SCORED + 1
        self._measured = np.full((2 * self._kept, samples, channels), nan)
        self._innovations = np.full((2 * self._kept, samples - 1, channels), nan)
        self._curves = np.full((2 * self._kept, nodes, channels), nan)
        self._shown = np.full((2 * self._kept, horizons, channels), nan)
        self._shown_half = np.full((2 * self._kept, horizons, channels), nan)
        self._row = self._kept

    def _nodes(self) -> tuple[float, ...]:
        """Horizons of what is fed with means, from which the curve is drawn."""
        samples, interval_s, block_s = self._samples, self._interval_s, self._block_s
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
        samples, interval_s = self._samples, self._interval_s
        self._aimed_s = interval_s
        self._lag_s = 0.5 * (samples - 1) * interval_s
        self._ahead = self._horizons / interval_s
        nodes = np.append(0.0, self.fed.horizons_s)
        spline = CubicSpline(nodes, np.eye(len(nodes)), axis=0)
        # The curve at each horizon, for each sample of a block (0: when it is fed); what is expected of the samples of
        # the next, and of its middle.
        since_s = self._lag_s + interval_s * np.arange(samples + 1)
        self._weights = spline(np.minimum(since_s[:, None] + self._horizons, nodes[-1]))
        self._expectation = spline(np.minimum(np.append(since_s, samples * interval_s), nodes[-1]))
        self._maps[..., : len(nodes)] = self._weights[:-1, None]

    # -- one sample ------------------------------------------------------------------------------------------------

    def step(self, t_s: float, values: list[float], rates: Sequence[float] | None) -> Array:
        """Take a sample later than the one before and predict from it."""
        if self._end_s == -inf:
            self._end_s = t_s - self._interval_s
            self.origin_s = self._end_s - self._lag_s
        place = (t_s - self._end_s) / self._interval_s
        phase = round(place)
        if phase > self._samples:
            place = self._catch_up(t_s)
            phase = round(place)
        if phase < 1:
            return self.values
        off = place - phase
        expected = self._expected[phase]
        if is_off := not -ON_TIME <= off <= ON_TIME:
            expected = [x + off * (x - y) for x, y in zip(expected, self._expected[phase - 1], strict=True)]
        innovation = [*map(sub, values, expected)]
        self._values_in[phase - 1] = values
        self._e_in[phase - 1] = innovation
        if rates is not None:
            self._rates_in.append(rates)
        if phase == self._samples:
            self._end_s += self._block_s
            deviation_s = t_s - self._end_s
            self._end_s += PHASE_GAIN * deviation_s
            self._block_s += INTERVAL_GAIN * deviation_s
            self._interval_s = self._block_s / self._samples
            self._feed()
            phase, is_off = 0, False
        else:
            gates = self._gates[phase - 1]
            self._e[:, phase - 1] = [
                e if -gate <= e <= gate else 0.0 for e, gate in zip(innovation, gates, strict=True)
            ]
        self._phase = phase
        self.values = (self._maps[phase] @ self._state)[:, :, 0].T
        if is_off:
            self.values += off * ((self._weights[phase] - self._weights[phase - 1]) @ self._curve.T)
        if phase == self._shown_phase:
            self._shown[self._row] = self.values
            self._shown_half[self._row] = self.switch.half_width
        return self.values

    @property
    def correction(self) -> Array:
        """What is added to the curve for the samples since the last block, (H, n)."""
        nodes = self._curve.shape[1]
        added: Array = self._maps[self._phase, :, :, nodes:] @ self._state[:, nodes:]
        return added[:, :, 0].T

    def _catch_up(self, t_s: float) -> float:
        """Samples are missing at the end of a block: it is closed with what it has; the next ones have nothing."""
        if t_s - self._end_s > self._max_gap_s + self._block_s:
            blocks = int((t_s - self._end_s) / self._block_s)
            self._end_s += blocks * self._block_s
            self.origin_s = self._end_s - self._lag_s
            for ring in (self._measured, self._shown, self._curves, self._innovations):
                ring[:] = nan
            self._lose()
        while round((t_s - self._end_s) / self._interval_s) > self._samples:
            self._end_s += self._block_s
            self._feed()
        return (t_s - self._end_s) / self._interval_s

    # -- one block -------------------------------------------------------------------------------------------------

    def _feed(self) -> None:
        """Close a block that ends at ``_end_s``: feed its mean, begin the next."""
        row = self._row
        self._measured[row] = self._values_in
        self._innovations[row] = self._e_in[:-1]
        mean = [self._mean(c, e) for c, e in enumerate(zip(*self._e_in, strict=True))]
        rates = [sum(r) / len(r) for r in zip(*self._rates_in, strict=True)] or None
        self.origin_s = self._end_s - self._lag_s
        self.fed.step(self.origin_s, mean, rates)
        if self._since_batch >= self._per_batch:
            self._batch()
        self._blocks += 1
        self._since_batch += 1
        self._row += 1
        if self._row == len(self._measured):
            for ring in (self._measured, self._innovations, self._curves, self._shown, self._shown_half):
                ring[: self._kept] = ring[self._row - self._kept :]
            self._row = self._kept
        self._shown[self._row] = nan
        self._shown_phase = self._blocks // SCORED % self._samples if self._blocks % SCORED == 0 else -1
        curve = self._curves[self._row] = self.fed.curve
        self._curve[:] = curve.T
        self._expected = (self._expectation @ curve).tolist()
        self._empty()

    def _lose(self) -> None:
        """Nothing is expected."""
        self.values = self._unknown
        self._expected = [self._nothing] * (self._samples + 2)
        self._curve[:] = nan
        self._empty()

    def _empty(self) -> None:
        """A block without samples."""
        self._phase = 0
        self._values_in = [self._nothing] * self._samples
        self._e_in = [self._nothing] * self._samples
        self._rates_in.clear()
        self._e[:] = 0.0

    def _mean(self, channel: int, innovations: Sequence[float]) -> float:
        """Of a block, for its middle: about the curve, where there is one, and without what is far from it."""
        limit = self._gates[-1][channel]
        if not (isfinite(sum(innovations)) and -limit <= min(innovations) and max(innovations) <= limit):
            known = [e for e in innovations if isfinite(e)]
            if not known:
                plain = [v[channel] for v in self._values_in if isfinite(v[channel])]
                return sum(plain) / len(plain) if plain else nan
            near = [e for e in known if -limit <= e <= limit]
            if len(near) < len(known) < 2 * len(near):
                self.gated += len(known) - len(near)
                known = near
                for phase, e in enumerate(innovations):  # What is no measurement teaches nothing and judges nobody.
                    if not -limit <= e <= limit:
                        self._measured[self._row, phase, channel] = nan
                        if phase < self._samples - 1:
                            self._innovations[self._row, phase, channel] = nan
            innovations = known
        middle: float = self._expected[-1][channel]
        return middle + sum(innovations) / len(innovations)

    # -- every few seconds -----------------------------------------------------------------------------------------

    def _batch(self) -> None:
        """Learn from what came true of the blocks whose targets are known, and score it."""
        self._since_batch = 0
        if abs(self._interval_s - self._aimed_s) > DRIFT * self._interval_s:
            self._aim()
        samples, short, count = self._samples, self._short, self._per_batch
        flat = self._measured.reshape(-1, self._n)
        if short:
            end = self._row - int(self._delay[short - 1]) + 1
            rows = slice(end - count, end)
            ahead = np.arange(1, samples)[:, None] + self._ahead[:short]
            # Row b holds the samples 1 ... n after its block was begun.
            later = _between(flat, samples * np.arange(end - count, end)[:, None, None] + ahead - 1.0)
            weights = self._weights[1:-1, :short]
            planned = weights.reshape(-1, weights.shape[2]) @ self._curves[rows]
            self._carry.learn(self._innovations[rows], later - planned.reshape(later.shape))
            self._maps[1:, :, :short, self._curve.shape[1] :] = self._carry.gains
            self._gates = self._carry.gate.tolist()
        back = self._blocks % SCORED + self._delay + SCORED * np.arange(count // SCORED)[:, None]
        rows_shown = self._row - back
        phase = (self._blocks - back) // SCORED % samples
        h = np.arange(len(self._delay))
        error = _between(flat, samples * rows_shown + phase + self._ahead - 1.0) - self._shown[rows_shown, h]
        self.switch.score(SCORED * self._block_s, error[:, :, None], error, self._shown_half[rows_shown, h])
        self.switch.choose(np.ones((1, self._n), dtype=bool))


def _between(samples: Array, place: Array) -> Array:
    """Linear interpolation of ``samples`` (m, n) at fractional places; (..., n)."""
    whole = np.rint(place)
    place = np.where(np.abs(place - whole) < ON_TIME, whole, place)
    low = np.floor(place).astype(np.intp)
    share = (place - low)[..., None]
    here: Array = samples[low]
    if share.any():
        there = samples[np.minimum(low + 1, len(samples) - 1)]
        here = np.where(share > 0.0, here + share * (there - here), here)
    return here
