"""What came true of blocks: corrections are learned from it and what was published is scored, every few seconds.

Until then a block is kept as it came (:class:`_Closed`); then those that are new go into arrays, the oldest leave them.
"""

from __future__ import annotations

from math import ceil, nan
from struct import Struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from heaved.block_outlook import Moment, worked_out
from heaved.estimation.rock.carry import CORRECTED_S, DEVIATION, SCALE_MEMORY_S, Carry
from heaved.estimation.rock.experts import Switch

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

ON_TIME: Final = 0.02
"""Deviation of a stamp from its place, in samples, that makes no difference."""
BATCH_S: Final = 4.0
SCORED: Final = 2
"""Every second block is scored, one place after the other: errors closer together are hardly different ones."""
ROOM: Final = 1.25
"""Most samples there may be in a time over those that there were in the first one: beyond it is another rate."""
NEIGHBOURS: Final = (-1.0 / 6.0, 4.0 / 6.0)
"""Weights of the cubic through the two readings on either side of one, there: on the outer ones and the inner ones."""


class _Closed:
    """Blocks since the last batch; numbers packed as they come, for they are not looked at before."""

    def __init__(self) -> None:
        self.samples = bytearray()
        """(blocks, 2, S, n): measured, and innovations."""
        self.curves: list[Array] = []
        self.moments: list[Moment | None] = []
        """What was published of those that are scored; None: there was no such sample."""


class BlockLearner:
    """For blocks of S samples, H horizons, n channels."""

    def __init__(self, horizons_s: Array, samples: int, interval_s: float, weights: Array, channels: int) -> None:
        """``interval_s``, ``weights``: as of :meth:`aim`."""
        self._horizons_s, self._samples, self._n = horizons_s, samples, channels
        block_s = samples * interval_s
        count, nodes = len(horizons_s), weights.shape[2]
        self.short = int(np.count_nonzero(horizons_s <= CORRECTED_S))
        """How many horizons are corrected."""
        self.carry = Carry(samples - 1, self.short, channels, block_s)
        self.switch = Switch(horizons_s, 1, channels, np.zeros(count, dtype=np.intp))
        self.aim(interval_s, weights)
        self._per_batch = SCORED * max(1, round(BATCH_S / block_s / SCORED))
        self._kept = self._per_batch + ceil(ROOM * self._delay[max(self.short - 1, 0)]) + SCORED
        self._noise_square = np.full(channels, nan)
        """Of single readings."""
        self._measured = np.full((self._kept, samples, channels), nan)
        self._innovations = np.full((self._kept, samples - 1, channels), nan)
        self._curves = np.full((self._kept, nodes, channels), nan)
        # Of those that are scored: what was published, and with which interval.
        self._kept_shown = (self._per_batch + ceil(ROOM * self._delay[-1])) // SCORED + 1
        self._shown = np.full((self._kept_shown, 2, count, channels), nan)
        self._no_curve = np.full((nodes, channels), nan)
        self._packed = Struct(f"{2 * samples * channels}d").pack
        self._closed = _Closed()
        self._blocks = 0

    def aim(self, interval_s: float, weights: Array) -> None:
        """The samples come at this interval; ``weights`` (S + 1, H, nodes): of the curve, at each horizon, by place."""
        self._weights = weights[1:-1, : self.short]
        ahead = self._horizons_s / interval_s
        # Until what was predicted has come true, in blocks, even ones: those that are scored.
        self._delay = SCORED * np.ceil((self._samples + ahead + 1.0) / self._samples / SCORED).astype(np.intp)
        # Row b holds the samples 1 ... S after its block was begun.
        self._later = _Places(np.arange(1, self._samples)[:, None] + ahead[: self.short] - 1.0)
        self._due = _Places(ahead - 1.0)

    @property
    def scored_place(self) -> int:
        """Of the block that is open, the sample whose predictions are scored; -1: none."""
        return -1 if self._blocks % SCORED else self._blocks // SCORED % self._samples

    def keep(self, measured: list[float], innovations: list[float], curve: Array, moment: Moment | None) -> bool:
        """A block is closed: S n samples and innovations (nan: not known), the curve (nodes, n) that it was begun with,
        and what was published at its scored place. True: a batch is due."""
        closed, block = self._closed, self._blocks
        closed.samples += self._packed(*measured, *innovations)
        closed.curves.append(curve)
        if block % SCORED == 0:
            closed.moments.append(moment)
        self._blocks = block + 1
        return block > 0 and block % self._per_batch == 0

    def lose(self) -> None:
        """Nothing is known of the blocks that there were."""
        for ring in (self._measured, self._innovations, self._curves, self._shown):
            ring[:] = nan
        closed = self._closed
        closed.samples[:] = np.full(len(closed.samples) // 8, nan).tobytes()
        closed.curves[:] = [self._no_curve] * len(closed.curves)
        closed.moments[:] = [None] * len(closed.moments)

    def batch(self, block_s: float, shaking_square: Array) -> None:
        """Learn from what came true of the blocks, of this length, whose targets are known, and score it.

        ``shaking_square`` (n,): of what shakes the channels; deviations are no less.
        """
        self._keep_closed()
        samples, count = self._samples, self._per_batch
        flat = self._measured.reshape(-1, self._n)
        if self.short:
            end = self._kept - int(self._delay[self.short - 1])
            rows = slice(end - count, end)
            later = self._later.of(flat, samples * np.arange(end - count, end)[:, None, None])
            planned = self._weights.reshape(-1, self._weights.shape[2]) @ self._curves[rows]
            self.carry.learn(self._innovations[rows], later - planned.reshape(later.shape))
        back = self._delay + SCORED * np.arange(count // SCORED)[:, None]
        phase = (self._blocks - 1 - back) // SCORED % samples
        shown, half_width = self._shown[-1 - back // SCORED, :, np.arange(len(self._delay))].transpose(2, 0, 1, 3)
        error = self._due.of(flat, samples * (self._kept - 1 - back) + phase) - shown
        errors = np.repeat(error[:, :, None], 2, axis=2)  # the only expert is what is published
        self.switch.score(SCORED * block_s, errors, half_width)
        found, before = _noise_square(flat[-count * samples :]), self._noise_square
        share = min(count * block_s / SCALE_MEMORY_S, 1.0)
        self._noise_square = np.where(
            np.isfinite(found - before), before + share * (found - before), np.fmax(found, before)
        )
        self.switch.least_square[:] = np.fmax(shaking_square, self._noise_square)
        self.switch.choose(np.ones((1, self._n), dtype=bool))

    def _keep_closed(self) -> None:
        """The blocks that have been closed since go into the arrays."""
        closed, self._closed = self._closed, _Closed()
        shown = np.full((len(closed.moments), *self._shown.shape[1:]), nan)
        shown[:, 1] = self.switch.half_width
        if moments := {row: moment for row, moment in enumerate(closed.moments) if moment is not None}:
            shown[list(moments), 0] = worked_out(list(moments.values()))
        samples = np.frombuffer(closed.samples).reshape(-1, 2, self._samples, self._n)
        self._measured = _latest(self._measured, samples[:, 0])
        self._innovations = _latest(self._innovations, samples[:, 1, :-1])
        self._curves = _latest(self._curves, np.array(closed.curves))
        self._shown = _latest(self._shown, shown)


def _latest(ring: Array, new: Array) -> Array:
    """As many rows as ``ring`` has, the last of them ``new``."""
    return np.concatenate((ring, new))[-len(ring) :]


def _noise_square(readings: Array) -> Array:
    """Of single readings (m, n), nan where there are none: what of each a cubic through its neighbours does not show.

    Errors at horizons that lie between readings are those against a mean of some, which has less noise than one.
    """
    neighbours = NEIGHBOURS[0] * (readings[:-4] + readings[4:]) + NEIGHBOURS[1] * (readings[1:-3] + readings[3:-1])
    off = np.sort(np.abs(readings[2:-2] - neighbours), axis=0)  # what is not known is last
    half = np.maximum(np.isfinite(off).sum(axis=0) - 1, 0) // 2
    middle = np.take_along_axis(off, half[None], axis=0)[0]
    square: Array = (DEVIATION * middle) ** 2 / (1.0 + 2.0 * (NEIGHBOURS[0] ** 2 + NEIGHBOURS[1] ** 2))
    return square


class _Places:
    """Where targets lie between samples, from any sample on."""

    def __init__(self, ahead: Array) -> None:
        """``ahead`` (...): in samples; what is nearly whole is taken for it."""
        whole = np.rint(ahead)
        ahead = np.where(np.abs(ahead - whole) < ON_TIME, whole, ahead)
        low = np.floor(ahead)
        self._low: Indices = low.astype(np.intp)
        self._share: Array = (ahead - low)[..., None]
        self._whole = not self._share.any()

    def of(self, samples: Array, first: Indices) -> Array:
        """Linear interpolation of ``samples`` (m, n) so far after ``first`` (broadcasts with ahead); (..., n)."""
        low = first + self._low
        here: Array = samples.take(low, axis=0)
        if self._whole:
            return here
        there = samples.take(np.minimum(low + 1, len(samples) - 1), axis=0)
        return np.where(self._share > 0.0, here + self._share * (there - here), here)
