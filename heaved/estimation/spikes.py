"""Gates for readings of the accelerometer that cannot be true: wild ones, and ones that no longer change."""

from __future__ import annotations

from math import isfinite, nan, sqrt
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
        limit = max(WIDTH * sqrt(self._mean_square), FLOOR_MPS2)
        if self._steps >= 100 and abs(step) > limit and elapsed < LASTING_S:
            self.rejected += 1
            return nan
        self._steps += 1
        weight = max(MEMORY, 1.0 / self._steps)
        self._mean_square += weight * (min(step * step, 4.0 * limit * limit) - self._mean_square)
        self._t_s, self._value = t_s, value
        return value


STUCK_S: Final = 5.0
"""The very same reading for this long is no measurement. A ship in dock shakes a sensor more than that; a device that
knows its own resolution says so sooner (``stuck_after_s``)."""


class StuckGate:
    """Tells when the readings have been one and the same for STUCK_S."""

    def __init__(self) -> None:
        self._value = self._since_s = nan
        self.is_stuck = False

    def __call__(self, t_s: float, value: float) -> bool:
        """Whether ``value`` is a repetition that must not be used any more."""
        if value != self._value:
            self._value, self._since_s = value, t_s
        self.is_stuck = t_s - self._since_s >= STUCK_S
        return self.is_stuck
