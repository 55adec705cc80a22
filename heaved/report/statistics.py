"""Statistics of any number of values in memory that does not grow: errors against their claims, and envelopes. Pure."""

from __future__ import annotations

from math import nan, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf, ndtri

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]

WITHIN: Final = (1.0, 2.0, 3.0)
"""Standard deviations, of which the shares within are counted..."""
EXPECTED: Final = tuple(float(erf(k / sqrt(2.0))) for k in WITHIN)
"""...and those of a normal error: 68.3, 95.4 and 99.7 %."""
LEVELS: Final = (*(round(0.05 * k, 2) for k in range(1, 20)), 0.99)
"""Shares that intervals about the value are made for; how many errors each really holds is its reliability."""
HISTOGRAM_EDGES: Final = np.linspace(-5.0, 5.0, 51)
"""In claimed standard deviations; what is beyond is counted in the outermost."""
_HALF_WIDTHS: Final = ndtri(0.5 + 0.5 * np.array(LEVELS))


class ErrorStatistics(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of one quantity, in its unit, beside the standard deviations that were claimed for them; nan: there are
    none.
    """

    count: int = 0
    mean: float = nan
    rms: float = nan
    claimed_rms: float = nan
    """Of the standard deviations."""
    nees: float = nan
    """Mean square of error over claim: 1 when the claim is right, more when it is too small."""
    within: tuple[float, ...] = (nan,) * len(WITHIN)
    """Shares within 1, 2 and 3 claimed standard deviations."""
    worst: float = nan
    """The error of the greatest size."""
    worst_t_s: float = nan
    interval: float = nan
    """Share within the interval that was given beside the standard deviation."""


class Errors:
    """Takes down errors and their claims; see :class:`ErrorStatistics`.

    Attributes:
        count: of errors with a claim.
        in_levels: (L,) of these, within the interval of each of LEVELS.
        histogram: (B,) of these, in bins of HISTOGRAM_EDGES.
    """

    def __init__(self) -> None:
        self.count = 0
        self.in_levels = np.zeros(len(LEVELS), dtype=np.int64)
        self.histogram = np.zeros(len(HISTOGRAM_EDGES) - 1, dtype=np.int64)
        self._sums = np.zeros(4)
        """Of error, its square, the square of the claim, the square of their ratio."""
        self._within = np.zeros(len(WITHIN), dtype=np.int64)
        self._worst = self._worst_t_s = nan
        self._in_interval, self._with_interval = 0, 0

    def push(self, t_s: Array, error: Array, std: Array, half_width: Array | None = None) -> None:
        """Errors (n,) at their times, the standard deviations that were claimed, and the half-widths of the interval
        given beside them, if one is. What is nan, or claims to be exact, is left out.
        """
        known = np.isfinite(error) & (std > 0.0) & np.isfinite(std)
        if not known.any():
            return
        t_s, error, std = t_s[known], error[known], std[known]
        ratio = error / std
        size = np.abs(ratio)
        self.count += len(error)
        self._sums += error.sum(), error @ error, std @ std, ratio @ ratio
        self._within += [int(np.count_nonzero(size <= k)) for k in WITHIN]
        self.in_levels += np.searchsorted(np.sort(size), _HALF_WIDTHS, side="right")
        low, high = HISTOGRAM_EDGES[0], HISTOGRAM_EDGES[-1]
        self.histogram += np.histogram(np.clip(ratio, low, high), HISTOGRAM_EDGES)[0]
        at = int(np.argmax(np.abs(error)))
        if not abs(float(error[at])) <= abs(self._worst):
            self._worst, self._worst_t_s = float(error[at]), float(t_s[at])
        if half_width is not None:
            width = half_width[known]
            given = np.isfinite(width)
            self._with_interval += int(np.count_nonzero(given))
            self._in_interval += int(np.count_nonzero(np.abs(error[given]) <= width[given]))

    def statistics(self) -> ErrorStatistics:
        """Of all so far."""
        n = self.count
        if n == 0:
            return ErrorStatistics()
        total, square, claimed, ratio = self._sums.tolist()
        return ErrorStatistics(
            count=n,
            mean=total / n,
            rms=sqrt(square / n),
            claimed_rms=sqrt(claimed / n),
            nees=ratio / n,
            within=tuple((self._within / n).tolist()),
            worst=self._worst,
            worst_t_s=self._worst_t_s,
            interval=self._in_interval / self._with_interval if self._with_interval else nan,
        )

    @property
    def reliability(self) -> Array:
        """(L,) share of the errors within the interval of each of LEVELS; nan: there are none."""
        return self.in_levels / self.count if self.count else np.full(len(LEVELS), nan)


class Moments:
    """Number, mean, standard deviation and extremes of a quantity.

    Attributes:
        count, mean, least, most: of the values that are numbers.
    """

    def __init__(self) -> None:
        self.count = 0
        self.mean = self.least = self.most = nan
        self._squares = 0.0

    def push(self, values: Array) -> None:
        """Values (n,), nan where there is none. Blocks are joined by the formula of Chan, Golub and LeVeque (1979)."""
        values = values[np.isfinite(values)]
        n = len(values)
        if n == 0:
            return
        mean = float(values.mean())
        squares = float(np.square(values - mean).sum())
        both = self.count + n
        if self.count == 0:
            self.mean, self._squares = mean, squares
        else:
            away = mean - self.mean
            self.mean += away * n / both
            self._squares += squares + away * away * self.count * n / both
        self.count = both
        self.least = float(np.fmin(self.least, values.min()))
        self.most = float(np.fmax(self.most, values.max()))

    @property
    def std(self) -> float:
        """Standard deviation; nan: there is no value."""
        return sqrt(self._squares / self.count) if self.count else nan

    @property
    def rms(self) -> float:
        """Root mean square; nan likewise."""
        return sqrt(self._squares / self.count + self.mean * self.mean) if self.count else nan


class Drawn(msgspec.Struct, frozen=True, eq=False):
    """An envelope, ready to be drawn. Arrays (k,) of bins in which there is something of some column."""

    place: NDArray[np.int64]
    """Numbers of the bins, from the first."""
    t_s: Array
    """Middles of the bins."""
    least: dict[str, Array]
    """By column; nan where that has no value."""
    most: dict[str, Array]
    mean: dict[str, Array]
    count: dict[str, Array]
    width_s: float

    def joined(self, name: str, times: int) -> tuple[Array, Array]:
        """Times and means of one column over so many bins together, each value of the same weight."""
        _, place = np.unique(self.place // times, return_inverse=True)
        count = np.bincount(place, self.count[name])
        total = np.bincount(place, np.nan_to_num(self.mean[name]) * self.count[name])
        t_s = np.bincount(place, self.t_s) / np.bincount(place)
        return t_s[count > 0], total[count > 0] / count[count > 0]


class Envelope:
    """Least, greatest and mean value of some quantities in each of a bounded number of bins of time.

    The bins are as many for a minute as for a day: when there is no room for more, neighbours become one.
    """

    def __init__(self, columns: Sequence[str], *, bins: int = 1024, width_s: float = 0.0625) -> None:
        """At most ``bins``, an even number; at first each ``width_s`` wide."""
        self.columns = tuple(columns)
        self.width_s = width_s
        self._bins = bins
        shape = bins, len(self.columns)
        self._least, self._most = np.full(shape, nan), np.full(shape, nan)
        self._total, self._count = np.zeros(shape), np.zeros(shape)
        self._begin_s = nan

    def push(self, t_s: Array, *values: Array) -> None:
        """Values (n,) of each column at times (n,), none of them before the first; nan where there is none."""
        if len(t_s) == 0:
            return
        if np.isnan(self._begin_s):
            self._begin_s = float(t_s[0])
        while t_s[-1] - self._begin_s >= self._bins * self.width_s:
            self._halve()
        place = ((t_s - self._begin_s) / self.width_s).astype(np.int64)
        table = np.stack(values, axis=1)
        there = np.isfinite(table)
        np.fmin.at(self._least, place, np.where(there, table, nan))
        np.fmax.at(self._most, place, np.where(there, table, nan))
        np.add.at(self._total, place, np.where(there, table, 0.0))
        np.add.at(self._count, place, there)

    def _halve(self) -> None:
        half = self._bins // 2
        for bins, join, empty in (
            (self._least, np.fmin, nan),
            (self._most, np.fmax, nan),
            (self._total, np.add, 0.0),
            (self._count, np.add, 0.0),
        ):
            bins[:half] = join(bins[::2], bins[1::2])
            bins[half:] = empty
        self.width_s *= 2.0

    def drawn(self) -> Drawn:
        """What there is so far."""
        used = self._count.any(axis=1)
        place = np.flatnonzero(used)
        with np.errstate(invalid="ignore"):
            mean = self._total / self._count

        def by_column(table: Array) -> dict[str, Array]:
            return {name: table[used, i] for i, name in enumerate(self.columns)}

        return Drawn(
            place,
            np.asarray((self._begin_s if len(place) else 0.0) + (place + 0.5) * self.width_s, dtype=np.float64),
            by_column(self._least),
            by_column(self._most),
            by_column(mean),
            by_column(self._count),
            self.width_s,
        )


def between(t_s: Array, known_s: Array, values: Array, longest_s: float) -> Array:
    """Values at ``t_s`` (n,) on straight lines between those known at ``known_s`` (k,), increasing; nan outside, and
    between two that are more than ``longest_s`` apart. A value at a known time is that value.
    """
    found = np.full(len(t_s), nan)
    if len(known_s) == 0:
        return found
    after = np.searchsorted(known_s, t_s, side="left")
    inside = after < len(known_s)
    exact = inside.copy()
    exact[inside] = known_s[after[inside]] == t_s[inside]
    found[exact] = values[after[exact]]
    i = np.flatnonzero(inside & ~exact & (after > 0))
    right = after[i]
    left = right - 1
    step_s = known_s[right] - known_s[left]
    near = step_s <= longest_s
    i, left, right, step_s = i[near], left[near], right[near], step_s[near]
    found[i] = values[left] + (t_s[i] - known_s[left]) / step_s * (values[right] - values[left])
    return found
