"""What is wrong with an IMU, seen in its rates alone: missing, stuck, slower than asked."""

from __future__ import annotations

from math import isfinite
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MEMORY: Final = 0.03
"""Weight of one sample in the shares."""
STUCK_S: Final = 1.0
"""Repeated for so long: it no longer measures."""
MISSING_SHARE: Final = 0.2
REPEATED_SHARE: Final = 0.3
LARGEST_RADPS: Final = 10.0
"""No ship turns faster: the value is a bus error."""
_NOTHING: Final = np.full(3, np.nan)


class Health:
    """Readings of one IMU on the common time base."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._last: tuple[float, ...] | None = None
        self.repeats = 0
        self._missing = self._repeated = 0.0

    def take(self, rates_radps: Array) -> Array:
        """The reading (3,), or nan where it says nothing: not finite, beyond any ship, or exactly the one before.

        A gyro with noise does not repeat itself; a slave that is asked faster than it samples does, and a repeated
        value is late by an unknown time.
        """
        x, y, z = now = tuple(rates_radps.tolist())
        missing = not (isfinite(x) and isfinite(y) and isfinite(z)) or max(abs(x), abs(y), abs(z)) > LARGEST_RADPS
        repeated = not missing and now == self._last
        self._missing += MEMORY * (missing - self._missing)
        if not missing:
            self.repeats = self.repeats + 1 if repeated else 0
            self._repeated += MEMORY * (repeated - self._repeated)
            self._last = now
        return _NOTHING if missing or repeated else rates_radps

    @property
    def stuck(self) -> bool:
        return self.repeats >= STUCK_S * self._rate_hz

    @property
    def missing(self) -> bool:
        return self._missing > MISSING_SHARE

    @property
    def slow(self) -> bool:
        return self._repeated > REPEATED_SHARE and not self.stuck
