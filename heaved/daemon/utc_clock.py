"""UTC as an offset from the monotonic clock: estimates live on monotonic time, only what leaves is given UTC."""

from __future__ import annotations

import time
from statistics import median
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

STEP_S = 0.5
"""A larger departure is a step (a clock set by hand, the first fix of a time server) and is adopted at once."""
SLEW = 5e-3
"""A smaller one is followed at this rate at most (seconds per second), so that published times go on increasing."""
_READS = 5
"""A read that was interrupted between its two clocks is far off; the median of a few is not."""


class UtcClock:
    """Tracks UTC minus monotonic time; :meth:`update` wants to be called about once a second.

    Attributes:
        offset_s: UTC (seconds since 1970) minus the monotonic clock.
        steps: steps adopted since the start.
    """

    def __init__(
        self, monotonic: Callable[[], float] = time.monotonic, realtime: Callable[[], float] = time.time
    ) -> None:
        self._monotonic = monotonic
        self._realtime = realtime
        self.offset_s = self._read()
        self.steps = 0
        self._updated_s = monotonic()

    def update(self) -> float:
        """Follow the system's clock; returns the step that was adopted in seconds, or 0.0."""
        now_s = self._monotonic()
        elapsed_s, self._updated_s = now_s - self._updated_s, now_s
        departure_s = self._read() - self.offset_s
        if abs(departure_s) > STEP_S:
            self.offset_s += departure_s
            self.steps += 1
            return departure_s
        most_s = SLEW * max(elapsed_s, 0.0)
        self.offset_s += min(max(departure_s, -most_s), most_s)
        return 0.0

    def utc_s(self, t_s: float) -> float:
        """UTC, seconds since 1970, of the monotonic time ``t_s``."""
        return t_s + self.offset_s

    def _read(self) -> float:
        offsets = []
        for _ in range(_READS):
            before_s = self._monotonic()
            utc_s = self._realtime()
            offsets.append(utc_s - 0.5 * (before_s + self._monotonic()))
        return median(offsets)
