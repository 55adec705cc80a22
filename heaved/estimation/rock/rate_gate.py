"""Rates of the angles on their way into the direct predictor: readings that no motion has made are taken out.

A regression that has learned to trust a quiet gyroscope is thrown by a single wrong reading of it, for as long as its
lags reach back, and what it learns from such readings is not to trust any. So each is held against the line through
those before it. One that is farther off than the usual one by a wide margin, whatever shakes the sensor usually, is
replaced by that line; so is one that is missing, for a moment.
"""

from __future__ import annotations

from bisect import insort
from math import exp, inf, isfinite, nan
from typing import TYPE_CHECKING, Final

import msgspec

if TYPE_CHECKING:
    from collections.abc import Sequence


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What this file is set to."""

    gate: float = 12.0
    """Medians of how far off readings usually are: eight standard deviations of normal ones."""
    quanta: float = 3.0
    """Steps of a coarse register that are never refused."""
    first: int = 20
    """Readings by whose median it is first known how far off they are; none is refused before."""
    higher: float = 1.01
    lower: float = 0.99
    """By so much of itself that goes up with a reading that is further off and down with one that is not: it is the
    median of a hundred or so, and a quarter of wrong readings moves it little."""
    slope_s: float = 0.1
    """Time constant of the slope of the line."""
    line_s: float = 0.12
    """The line serves for so long after the last reading: the slope of a roll of 3 s period has changed by a fourth."""
    lasting: int = 4
    """So many readings refused in a row, over at least..."""
    lasting_s: float = 0.3
    """...are no spikes: it is known anew how far off readings are."""
    stale_s: float = 1.0
    """After a gap this long nothing is known of the line."""


TUNING: Final = Tuning()


class _Axis:
    """What is known of one rate."""

    __slots__ = ("first", "interval_s", "limit", "quantum", "rate", "refused", "refused_s", "slope", "t_s", "usual")

    def __init__(self) -> None:
        self.quantum = inf
        """Least change between readings: the step of the register, where it is coarse."""
        self.begin(-inf, nan)

    def begin(self, t_s: float, rate: float) -> None:
        """From a reading of which it is not known what came before."""
        self.t_s, self.rate, self.slope = t_s, rate, 0.0
        """The line through the last readings that were taken."""
        self.interval_s = 0.0
        """Between them, at least; 0: not known."""
        self.first: list[float] = []
        """How far off the line they were, in ascending order, while they are few;"""
        self.usual = nan
        """the median of it, from then on."""
        self.limit = -inf
        """A reading this far off is taken without another look; none while they are few."""
        self.refused = 0
        """Readings in a row, since..."""
        self.refused_s = nan


class RateGate:
    """Judges the rates of n channels; feed it every sample in order of time."""

    def __init__(self, channels: int) -> None:
        self.refused = 0
        """Readings so far."""
        self._axes = [_Axis() for _ in range(channels)]
        self._elapsed_s = self._share = nan

    def step(self, t_s: float, rates: Sequence[float]) -> list[float]:
        """The rates as they may be used; nan: neither a reading nor the line serves."""
        taken = []
        for axis, rate in zip(self._axes, rates, strict=True):
            elapsed_s = t_s - axis.t_s
            off = rate - axis.rate - elapsed_s * axis.slope
            if -axis.limit <= off <= axis.limit:
                self._follow(axis, t_s, elapsed_s, rate, off)
                taken.append(rate)
            else:
                taken.append(self._judged(axis, t_s, elapsed_s, rate, off))
        return taken

    def _follow(self, axis: _Axis, t_s: float, elapsed_s: float, rate: float, off: float) -> None:
        size, change = abs(off), abs(rate - axis.rate)
        if 0.0 < change < axis.quantum:
            axis.quantum = change
        if axis.limit >= 0.0:
            axis.usual = usual = axis.usual * (TUNING.higher if size > axis.usual else TUNING.lower)
            axis.limit = TUNING.gate * usual
            axis.limit = max(axis.limit, TUNING.quanta * axis.quantum)
        else:
            insort(axis.first, size)
            axis.interval_s = min(axis.interval_s or elapsed_s, elapsed_s)
            if len(axis.first) == TUNING.first:
                axis.usual = axis.first[TUNING.first // 2]
                axis.limit = max(TUNING.gate * axis.usual, TUNING.quanta * axis.quantum)
        if elapsed_s != self._elapsed_s:
            self._elapsed_s, self._share = elapsed_s, (1.0 - exp(-elapsed_s / TUNING.slope_s)) / elapsed_s
        axis.slope += off * self._share
        axis.t_s, axis.rate = t_s, rate
        axis.refused = 0

    def _judged(self, axis: _Axis, t_s: float, elapsed_s: float, rate: float, off: float) -> float:
        """What serves for a reading that does not simply pass."""
        if isfinite(rate):
            if elapsed_s > TUNING.stale_s:
                axis.begin(t_s, rate)
                return rate
            # The motion is not straight: over several intervals the line leads astray by as many times more.
            if axis.limit < 0.0 or abs(off) <= max(elapsed_s / axis.interval_s, 1.0) * axis.limit:
                self._follow(axis, t_s, elapsed_s, rate, off)
                return rate
            if not axis.refused:
                axis.refused_s = t_s
            axis.refused += 1
            self.refused += 1
            if axis.refused >= TUNING.lasting and t_s - axis.refused_s >= TUNING.lasting_s:
                axis.begin(t_s, rate)
                return rate
        return axis.rate + elapsed_s * axis.slope if elapsed_s <= max(TUNING.line_s, 1.5 * axis.interval_s) else nan
