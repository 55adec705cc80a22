"""Samples of any rate averaged into beats of about 50 ms, far below the waves, for a filter that runs once per beat."""

from __future__ import annotations

from math import inf, isfinite, nan
from typing import Final

BEAT_S: Final = 0.05
BREAK_S: Final = 0.075
"""A gap within a beat that is longer than this, and than 2.5 intervals, ends it: it is the mean of fewer."""
BEAT_MIN_S: Final = 0.04
"""Rings are sized for beats this short."""
APART_S: Final = 0.02
"""Stamps that come in bursts make one beat, and never one closer than this to the last: what is sized by time has a
bound whatever the stamps are."""
BEAT_INTERVALS: Final = 101
BEAT_FIRST_INTERVALS: Final = 7
"""Intervals from which the usual one is taken, and the first time."""


class Beat:
    """Averages a handful of samples into one; their mean time with them. Lost ones make it a mean of fewer.

    Nothing is dropped once the interval is known: what a gap has cut short is given with the first sample after it.
    """

    def __init__(self, period_s: float = nan) -> None:
        """``period_s``: the usual interval, where it is known from before."""
        self._count = 0
        self._given_s = -inf
        self._set(period_s)
        self._t = self._a = self._first_s = 0.0
        self._previous_s = nan
        self._intervals: list[float] = []

    def take(self, t_s: float, a_mps2: float) -> tuple[float, float] | None:
        """The beat that this sample completes, or None."""
        interval = t_s - self._previous_s
        self._previous_s = t_s
        done = None
        if isfinite(interval):
            was_whole_s = self._whole_s
            self._learn(interval)
            if was_whole_s == inf != self._whole_s:
                self._count = 0  # What was begun before the interval was known is no beat.
            elif interval > self._break_s and self._count:
                done = self._mean()
        if self._count == 0:
            self._first_s, self._t, self._a = t_s, 0.0, 0.0
        since_s = t_s - self._first_s
        self._count += 1
        self._t += since_s
        self._a += a_mps2
        if since_s < self._whole_s or t_s - self._given_s < APART_S or done is not None:
            return done
        return self._mean()

    def _mean(self) -> tuple[float, float]:
        self._given_s = self._first_s + self._t / self._count
        done = self._given_s, self._a / self._count
        self._count = 0
        return done

    def _learn(self, interval_s: float) -> None:
        """The usual interval: a median, because a machine that was held up gives a long one and several short ones."""
        self._intervals.append(interval_s)
        wanted = BEAT_INTERVALS if isfinite(self.period_s) else BEAT_FIRST_INTERVALS
        if len(self._intervals) >= wanted:
            self._set(sorted(self._intervals)[wanted // 2])
            self._intervals.clear()

    def _set(self, period_s: float) -> None:
        """From its first sample on, a beat is whole after ``_whole_s``, and broken by a gap of ``_break_s``."""
        self.period_s = period_s
        if isfinite(period_s):
            self._whole_s = (max(1, int(BEAT_S / period_s + 0.25)) - 1.5) * period_s
            self._break_s = max(2.5 * period_s, BREAK_S)
        else:
            self._whole_s, self._break_s = inf, inf
