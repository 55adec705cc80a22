"""Gates for readings of the accelerometer that cannot be true: wild ones, and ones that no longer change."""

from __future__ import annotations

from math import exp, inf, isfinite, nan, sqrt
from typing import Final

WIDTH: Final = 8.0
"""Steps beyond this many RMS steps are suspect; a Gaussian gives one in 1e15."""
FLOOR_MPS2: Final = 0.5
"""Steps below this are never suspect: slams and engine vibration are real."""
LASTING_S: Final = 0.15
"""A level that lasts is real; a spike is over after a reading or two."""
PLAUSIBLE_MPS2: Final = 8.0
"""No vessel that lifts loads heaves harder, for however long; free fall is what a register left at zero reads."""
MEMORY: Final = 0.005
"""Weight of one step in the mean square (the last 200 steps)."""
STALE_S: Final = 0.5
"""After a gap this long the last reading says nothing about the next."""


class SpikeGate:
    """Passes a reading, or withholds it (nan) while it stands out of the steps seen so far."""

    def __init__(self) -> None:
        self.rejected = 0
        self._t_s = self._value = nan
        self._mean_square = 0.0
        self._steps = 0

    def __call__(self, t_s: float, value: float) -> float:
        """The value, or nan for a spike. Not finite: nan. The first 100 steps are only learned from."""
        if not isfinite(value):
            return nan
        if abs(value) > PLAUSIBLE_MPS2:
            self.rejected += 1
            return nan
        step = value - self._value
        elapsed = t_s - self._t_s
        if not isfinite(step) or elapsed > STALE_S:
            self._t_s, self._value = t_s, value
            return value
        width = WIDTH * sqrt(self._mean_square)
        limit = width if width > FLOOR_MPS2 else FLOOR_MPS2
        if self._steps >= 100 and abs(step) > limit and elapsed < LASTING_S:
            self.rejected += 1
            return nan
        self._steps += 1
        weight = MEMORY if self._steps > 1.0 / MEMORY else 1.0 / self._steps
        square, most = step * step, 4.0 * limit * limit
        self._mean_square += weight * ((square if square < most else most) - self._mean_square)
        self._t_s, self._value = t_s, value
        return value


STUCK_S: Final = 5.0
"""The very same reading for this long is no measurement. A ship in dock shakes a sensor more than that; a device that
knows its own resolution says so sooner (``stuck_after_s``)."""
SOON_S: Final = 0.1
"""While the vessel moves, a reading that repeats for this long stands still, and so does one of RUNS usual runs."""
RUNS: Final = 3.0
LONGEST_RUN_S: Final = 0.5
"""A device that measures less often is of no use for waves."""
RUN_MEMORY_S: Final = 60.0
MOVES: Final = 20.0
"""The vessel moves when the RMS of the readings about their mean is that many steps of the resolution."""
SPREAD_TIME_S: Final = 10.0
STOP_MEMORY_S: Final = 60.0
MANY_STOPS: Final = 4


class StuckGate:
    """Tells when the readings repeat and are no measurement: a sensor that hangs, or that is at the end of its range.

    Coarse registers and devices that are asked more often than they measure repeat themselves too, but the readings go
    on in the same direction afterwards; the longest such run is the patience. The end of a range is turned back from,
    and is reached again and again: what was a stop is one from its first reading on.
    """

    def __init__(self) -> None:
        self.is_stuck = False
        self._value = self._before = self._since_s = self._t_s = nan
        self._run_s = 0.0
        self._resolution = inf
        self._mean = self._mean_square = 0.0
        self._stops: dict[float, float] = {}

    def __call__(self, t_s: float, value: float) -> bool:
        """Whether ``value`` is a repetition that must not be used any more."""
        if not isfinite(value):
            self.is_stuck = False
            return False
        if value != self._value:
            self._changed(t_s, value)
            self._t_s = t_s
            # A reading that has just come is not one that repeats, but it may be a stop that is known.
            self.is_stuck = bool(self._stops) and t_s - self._stops.get(value, -inf) < STOP_MEMORY_S
            return self.is_stuck
        self._t_s = t_s
        held_s = t_s - self._since_s
        is_moving = sqrt(self._mean_square) > MOVES * self._resolution
        patience_s = SOON_S + RUNS * self._run_s if is_moving else STUCK_S
        self.is_stuck = held_s >= patience_s - 1e-6
        if self.is_stuck:
            self._stops[value] = t_s
            if len(self._stops) > MANY_STOPS:
                del self._stops[min(self._stops, key=lambda stop: self._stops[stop])]
        elif t_s - self._stops.get(value, -inf) < STOP_MEMORY_S:
            self.is_stuck = True
        return self.is_stuck

    def _changed(self, t_s: float, value: float) -> None:
        """A new reading: what the last one and its run say."""
        elapsed = t_s - self._since_s
        if isfinite(elapsed):
            if self._run_s > 0.0:
                self._run_s *= exp(-elapsed / RUN_MEMORY_S)
            run_s, step = self._t_s - self._since_s, value - self._value
            if run_s > self._run_s and run_s < LONGEST_RUN_S and elapsed < 2.0 * run_s + SOON_S:
                passes = step * (self._value - self._before) > 0.0
                self._run_s = run_s if passes else self._run_s
            if abs(step) < self._resolution:
                self._resolution = abs(step)
            weight = min(1.0, elapsed / SPREAD_TIME_S)
            self._mean += weight * (value - self._mean)
            self._mean_square += weight * ((value - self._mean) ** 2 - self._mean_square)
        else:
            self._mean = value
        self._before, self._value, self._since_s = self._value, value, t_s
