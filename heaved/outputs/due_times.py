"""Which of what comes is due, where less is wanted than comes: one in a while, at exactly the wanted mean rate."""

from __future__ import annotations

from math import inf


class DueTimes:
    """Due times stand one period apart, whatever the times of what comes, so that the mean rate is the wanted one; what
    is nearest to a due time is taken. After a gap they begin anew.
    """

    def __init__(self, rate_hz: float | None) -> None:
        """``rate_hz``: None: all of it is due."""
        self._period_s = 0.0 if rate_hz is None else 1.0 / rate_hz
        self._due_s = self._last_s = -inf

    def is_due(self, t_s: float) -> bool:
        """To be asked once for each that comes, with its time."""
        if self._period_s <= 0.0:
            return True
        interval_s, self._last_s = t_s - self._last_s, t_s
        if t_s < self._due_s - 0.5 * interval_s:
            return False
        next_s = self._due_s + self._period_s
        self._due_s = next_s if next_s > t_s else t_s + self._period_s
        return True
