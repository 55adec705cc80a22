"""The past that the sea is fitted to: as it comes, when it is time to fit it again, and put on an even grid for that.

The samples here are those of the filter, means of some of the sensor's.
"""

from __future__ import annotations

import itertools
from math import inf, nan
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common import down_sampler
from heaved.estimation.common.ring import RingBuffer
from heaved.estimation.common.spline import CubicSpline

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from heaved.estimation.heave.sea.model import SeaSystem

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """When the past is looked at, and how it is put on an even grid."""

    early_every_s: float = 10.0
    """Between fits, until ``early_s`` of record: each sees much more than the one before."""
    early_s: float = 120.0
    """Until so much of a record fits come early."""
    again_s: float = 1.0
    """After an answer that could not be used the next look is due this soon."""
    much_mps2: float = 5e-4
    """RMS by which the past is amended from which the sea is looked at anew at once: below the waves, so much is as
    much as the noise of a good sensor."""
    hole: float = 3.5
    """Neighbours further apart than this many intervals have a hole between them; closer ones are interpolated."""
    bridged_s: float = 0.3
    """So are those closer than this: a quarter of the shortest wave that is fitted."""
    on_the_grid: float = 1e-3
    """Deviation, in intervals, up to which a sample is taken as it is."""
    lossy: float = 0.1
    """Share of neighbours more than an interval apart beyond which nothing is interpolated but at the samples."""
    shortest_s: float = 0.01
    """The grid is never finer than this, whatever the stamps are."""
    near_whole: float = 0.15
    """Neighbours are whole intervals apart when they are off by less than that share of one,"""
    most: float = 0.95
    """and that many of them are."""
    quantiles: tuple[float, float] = (0.25, 0.1)
    """Of the distances between neighbours, where the interval is looked for beside their median, which is several
    intervals with half the samples lost or more."""


TUNING: Final = Tuning()


class SeaRecord:
    """Samples of the last ``length_s``, and which fit of them is awaited.

    Attributes:
        started_s: time of the first sample; nan: none yet.
    """

    def __init__(self, length_s: float, first_fit_s: float, refresh_s: float) -> None:
        self._length_s, self._first_fit_s, self._refresh_s = length_s, first_fit_s, refresh_s
        self._early_s = min(TUNING.early_every_s, refresh_s)
        self._samples = RingBuffer(int(length_s / down_sampler.TUNING.least_s), 2)
        self._number = 0
        self.clear()

    def clear(self) -> None:
        """Forget the past; what is awaited is not of it."""
        self._samples.clear()
        self._newest_s = self.started_s = self._asked_s = nan
        self._cuts: list[tuple[float, float]] = []
        self._spoilt: list[tuple[float, float]] = []
        self._blows: list[float] = []
        self._drifts: list[tuple[float, float]] = []
        self._number += 1
        self._awaited = -1

    def start(self, t_s: float) -> None:
        """Time runs from here."""
        self.started_s = self._asked_s = t_s

    # --- samples -----------------------------------------------------------------------------------------------------

    def follows(self, t_s: float) -> bool:
        """Whether a sample at ``t_s`` comes after those that are stored."""
        return not t_s <= self._newest_s

    def push(self, t_s: float, a_mps2: float) -> None:
        """Store a sample."""
        self._samples.push((t_s, a_mps2))
        self._newest_s = t_s

    def amend(self, t_s: Array, more_mps2: Array) -> None:
        """Add ``more_mps2`` (n,) to what is stored, linear between ``t_s`` (n,). If it is much, look soon."""
        self._samples.add(1, t_s, more_mps2)
        if float(np.sqrt(np.mean(more_mps2**2))) > TUNING.much_mps2:
            self.ask_again()

    def cut(self, from_s: float, to_s: float) -> None:
        """From ``to_s`` on it is measured otherwise than before (another level, another tilt); between, as neither."""
        self._cuts = [cut for cut in self._cuts if cut[1] > to_s - self._length_s] + [(from_s, to_s)]
        self.end_drift(from_s)

    def begin_drift(self, from_s: float) -> None:
        """The level goes on in one direction from ``from_s`` on."""
        first_s = self._cuts[-1][1] if self._cuts else -inf
        kept = [drift for drift in self._drifts if drift[1] > from_s - self._length_s]
        # What begins anew before the last one had ended is one drift.
        joined = [drift for drift in kept if drift[1] > from_s and drift[0] >= first_s]
        from_s = min([max(from_s, first_s), *(drift[0] for drift in joined)])
        self._drifts = [*(drift for drift in kept if drift not in joined), (from_s, inf)]

    def end_drift(self, to_s: float) -> None:
        """The last drift is over, if it was not."""
        if self._drifts and self._drifts[-1][1] == inf:
            self._drifts[-1] = self._drifts[-1][0], to_s

    @property
    def drifts_s(self) -> tuple[tuple[float, float], ...]:
        """From when until when the level has gone on in one direction; until inf while it does."""
        return tuple(self._drifts)

    @property
    def cuts_s(self) -> tuple[tuple[float, float], ...]:
        """Where the past is cut: no spectrum is taken across, and no bias."""
        return tuple(self._cuts)

    def spoil(self, from_s: float, to_s: float) -> None:
        """What is stored of this span has turned out not to be of the sea."""
        self._spoilt = [span for span in self._spoilt if span[1] > to_s - self._length_s] + [(from_s, to_s)]

    def mark_blow(self, t_s: float) -> None:
        """Something has struck the hull since the last sample; that at ``t_s`` is in part of before."""
        self._blows = [blow for blow in self._blows if blow > t_s - self._length_s] + [t_s]

    @property
    def blows_s(self) -> tuple[float, ...]:
        """First samples after something struck the hull."""
        return tuple(self._blows)

    @property
    def spoilt_s(self) -> tuple[tuple[float, float], ...]:
        """Spans of which nothing is to be learned."""
        return tuple(self._spoilt)

    def since(self, t_s: float) -> Array:
        """(n, 2) time and acceleration of the samples from ``t_s`` on: a view, overwritten by later ones."""
        return self._samples.since(t_s)

    # --- fits --------------------------------------------------------------------------------------------------------

    def is_due(self, t_s: float, *, is_changing: bool) -> bool:
        """Whether it is time for another look at the past; sooner early on, and when the sea ``is_changing``."""
        if not t_s - self.started_s >= self._first_fit_s:
            return False
        was_asked, since_s = self._asked_s > self.started_s, t_s - self._asked_s
        if was_asked and since_s < self._early_s:
            return False
        is_early = t_s - self.started_s < TUNING.early_s or is_changing
        return not was_asked or is_early or since_s >= self._refresh_s

    def ask(self, t_s: float) -> tuple[int, Array]:
        """The past (n, 2) that the longest window sees, for a fit, and the number that its answer carries."""
        self._asked_s = t_s
        self._number += 1
        self._awaited = self._number
        return self._number, self._samples.since(t_s - self._length_s)

    def ask_again(self) -> None:
        """The answer could not be used: the next look is due soon."""
        self._asked_s -= max(self._refresh_s - TUNING.again_s, 0.0)

    def answered(self, number: int) -> bool:
        """Whether an answer of this number is the one that is awaited, which then is no more."""
        if number != self._awaited:
            return False
        self._awaited = -1
        return True


class EvenRecord(msgspec.Struct, frozen=True, eq=False):
    """Vertical acceleration on an even grid that ends at the last sample."""

    end_s: float
    """Time of the last value."""
    dt_s: float
    a_mps2: Array
    """(n,); in a hole, a straight line."""
    is_known: NDArray[np.bool_]
    """(n,); False in a hole."""
    cuts: tuple[int, ...] = ()
    """First samples after a step of the level: nothing is known of the bias there."""
    blows: tuple[int, ...] = ()
    """First samples after a blow: nothing is known of what rings."""

    def last(self, count: int) -> EvenRecord:
        """The newest ``count`` samples."""
        left_out = max(len(self.a_mps2) - count, 0)
        cuts, blows = (
            tuple([place - left_out for place in places if place > left_out]) for places in (self.cuts, self.blows)
        )
        return EvenRecord(self.end_s, self.dt_s, self.a_mps2[left_out:], self.is_known[left_out:], cuts, blows)

    def opened(self, system: SeaSystem, P: Array, place: int) -> Array:
        """``P`` (n, n) before the sample at ``place``, by what is not known any more there."""
        if place in self.cuts or place in self.blows:
            return system.opened(P, bias=place in self.cuts, resonances=place in self.blows)
        return P

    def cut(
        self,
        cuts_s: Sequence[tuple[float, float]],
        spoilt_s: Sequence[tuple[float, float]] = (),
        blows_s: Sequence[float] = (),
    ) -> EvenRecord:
        """With a cut at the end of each of the spans ``cuts_s`` (s), nothing known within them and ``spoilt_s``, and a
        blow before each of ``blows_s``.
        """
        first_s = self.end_s - self.dt_s * (len(self.a_mps2) - 1)
        is_known, places = self.is_known.copy(), set()
        for i, span in enumerate((*cuts_s, *spoilt_s)):
            begin, end = (min(max(round((t_s - first_s) / self.dt_s), 0), len(is_known)) for t_s in span)
            is_known[begin:end] = False
            if i < len(cuts_s) and 0 < end < len(is_known):
                places.add(end)
        blows = {round((t_s - first_s) / self.dt_s) for t_s in blows_s}
        struck = tuple([place for place in sorted(blows) if 0 < place < len(is_known)])
        return msgspec.structs.replace(self, is_known=is_known, cuts=tuple(sorted(places)), blows=struck)

    def without_mixed(self, mixed: int) -> EvenRecord:
        """With nothing known of the ``mixed`` samples from each blow on that are in part of before it."""
        is_known = self.is_known.copy()
        for place in self.blows:
            is_known[place : place + mixed] = False
        return msgspec.structs.replace(self, is_known=is_known)


def even(t_s: Array, a_mps2: Array) -> EvenRecord:
    """Samples at increasing, not quite even times (n,), n >= 8, on an even grid of their own usual interval.

    A cubic spline through neighbours: at ten samples to a wave its error is 1e-4 of the wave.
    """
    gaps = np.diff(t_s)
    usual = max(_usual(gaps), TUNING.shortest_s)
    dt = max(float(np.mean(gaps[gaps < 1.5 * usual])), TUNING.shortest_s)
    steps, longest = np.rint(gaps / dt), max(TUNING.hole, TUNING.bridged_s / dt)
    if np.mean(steps > 1.0) > TUNING.lossy:
        longest = 1.5  # Noise between so few samples would be made up by the spline, and told as measured.
    is_even = bool(np.all(np.abs(gaps - dt * steps) < TUNING.on_the_grid * dt)) and bool(np.all(steps >= 1.0))
    if is_even and abs((t_s[-1] - t_s[0]) / np.sum(steps) - dt) * np.sum(steps) < 0.1 * dt:
        index = np.concatenate(([0.0], np.cumsum(steps))).astype(np.int64)
        grid = np.arange(index[-1] + 1)
        values, known = np.interp(grid, index, a_mps2), np.zeros(len(grid), dtype=np.bool_)
        known[index] = True
        near = np.repeat(steps <= longest, steps.astype(np.int64))
        known[1:] |= near
        if not known[index].all() or len(index) < len(grid):
            values = _filled(grid.astype(np.float64), values, known, index.astype(np.float64), a_mps2)
        return EvenRecord(float(t_s[-1]), dt, values, known)
    count = int((t_s[-1] - t_s[0]) / dt) + 1
    times = t_s[-1] - dt * np.arange(count - 1, -1, -1.0)
    after = np.clip(np.searchsorted(t_s, times - 1e-9), 1, len(t_s) - 1)
    at_sample = np.minimum(t_s[after] - times, times - t_s[after - 1]) <= 0.5 * dt
    known = (gaps[after - 1] <= longest * dt) | at_sample
    return EvenRecord(float(t_s[-1]), dt, _filled(times, np.interp(times, t_s, a_mps2), known, t_s, a_mps2), known)


def _usual(gaps: Array) -> float:
    """The longest distance (s) of which most of ``gaps`` (n,) are whole multiples; their median where there is none."""
    found = [float(np.median(gaps)), *(float(np.quantile(gaps, q)) for q in TUNING.quantiles)]
    for usual in found:
        steps = gaps / max(usual, TUNING.shortest_s)
        whole = np.rint(steps)
        if np.mean((whole >= 1.0) & (np.abs(steps - whole) < TUNING.near_whole)) >= TUNING.most:
            return usual
    return found[0]


def _filled(times: Array, line: Array, known: NDArray[np.bool_], t_s: Array, a_mps2: Array) -> Array:
    """The spline where it is ``known``, the straight ``line`` in the holes."""
    return np.where(known, CubicSpline(t_s, a_mps2)(times), line)


def stretches_of(record: EvenRecord, places: Sequence[int] = ()) -> Iterator[tuple[int, int, bool]]:
    """(first, end, is_known) of each stretch that is all known or all unknown, without a cut, or one of ``places``, in
    it.
    """
    is_known = record.is_known
    changes = 1 + np.flatnonzero(np.diff(is_known.astype(np.int8)))
    edges = {*changes.tolist(), *record.cuts, *places, 0, len(is_known)}
    for first, end in itertools.pairwise(sorted(edges)):
        yield first, end, bool(is_known[first])
