"""Samples of any rate averaged into beats of about 50 ms, far below the waves, for a filter that runs once per beat."""

from __future__ import annotations

from math import isfinite, nan
from typing import Final

BEAT_S: Final = 0.05
BEAT_MIN_S: Final = 0.04
"""Rings are sized for beats this short."""
BEAT_INTERVALS: Final = 101
BEAT_FIRST_INTERVALS: Final = 7
"""Intervals from which the usual one is taken, and the first time."""


class Beat:
    """Averages a handful of samples into one; their mean time with them."""

    def __init__(self, period_s: float = nan) -> None:
        """``period_s``: the usual interval, where it is known from before."""
        self._count = self._size = 0
        self._set(period_s)
        self._t = self._a = self._first_s = self._last_s = 0.0
        self._previous_s = nan
        self._intervals: list[float] = []

    def take(self, t_s: float, a_mps2: float) -> tuple[float, float] | None:
        """The beat that this sample completes, or None."""
        interval = t_s - self._previous_s
        self._previous_s = t_s
        if isfinite(interval):
            was_known = self._size > 0
            self._learn(interval)
            if interval > 2.5 * self.period_s or (self._size > 0) != was_known:
                self._count = 0  # What was begun before a gap, or before the interval was known, is no beat.
        if self._count == 0:
            self._first_s, self._t, self._a = t_s, 0.0, 0.0
        self._count += 1
        self._t += t_s - self._first_s
        self._a += a_mps2
        if not 0 < self._size <= self._count:
            return None
        done = self._first_s + self._t / self._count, self._a / self._count
        self._count = 0
        return done

    def _learn(self, interval_s: float) -> None:
        """The usual interval: a median, because a machine that was held up gives a long one and several short ones."""
        self._intervals.append(interval_s)
        wanted = BEAT_INTERVALS if self._size else BEAT_FIRST_INTERVALS
        if len(self._intervals) >= wanted:
            self._set(sorted(self._intervals)[wanted // 2])
            self._intervals.clear()

    def _set(self, period_s: float) -> None:
        self.period_s = period_s
        self._size = max(1, int(BEAT_S / period_s + 0.25)) if isfinite(period_s) else 0
        """Samples in a beat; 0: not known yet."""
