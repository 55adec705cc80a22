"""Samples of any rate averaged into beats of about 50 ms, far below the waves, for a filter that runs once per beat.

Whatever shakes the sensor near 20 or 40 Hz, a generator of 1200 revolutions, would fold into the waves. A plain mean of
each beat lets a share |f - 20| / 20 of it through, a tenth of a m/s2 too much. So each beat is a triangular mean over
itself and the one before (two plain means, one after the other), which leaves the square of that share. The time of a
beat is the weighed mean of its samples': what the mean costs is the age of the beat, no phase.
"""

from __future__ import annotations

from math import inf, isfinite, nan
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

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


def passed(f_hz: Array, period_s: float, averaged: int) -> Array:
    """What beats of ``averaged`` samples every ``period_s`` let through of the power at ``f_hz`` (n,) > 0."""
    if averaged == 1:
        return np.ones_like(f_hz)
    half = np.pi * f_hz * period_s
    return np.asarray((np.sin(averaged * half) / (averaged * np.sin(half))) ** 4)


class Beat:
    """Averages a handful of samples into one; their mean time with them. Lost ones make it a mean of fewer.

    What follows a gap is the plain mean of its own samples.

    Nothing is dropped once the interval is known: what a gap has cut short is given with the first sample after it.
    """

    def __init__(self, period_s: float = nan) -> None:
        """``period_s``: the usual interval, where it is known from before."""
        self._given_s = -inf
        self._set(period_s)
        self._before: list[tuple[float, float]] = []
        """Time and value of the samples of the beat before, when this one follows it."""
        self._samples: list[tuple[float, float]] = []
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
                self._samples.clear()  # What was begun before the interval was known is no beat.
            elif interval > self._break_s and self._samples:
                done = self._mean()
                self._before = []
        self._samples.append((t_s, a_mps2))
        if t_s - self._samples[0][0] < self._whole_s or t_s - self._given_s < APART_S or done is not None:
            return done
        return self._mean()

    def _mean(self) -> tuple[float, float]:
        first_s = self._samples[0][0]
        if len(self._before) > 1 and len(self._samples) > 1:
            width_s = max(self._samples[-1][0] - first_s + self.period_s, first_s - self._before[0][0])
            rows = [
                (1.0 - abs(t_s - first_s) / width_s, t_s - first_s, a) for t_s, a in (*self._before, *self._samples)
            ]
        else:
            rows = [(1.0, t_s - first_s, a) for t_s, a in self._samples]
        total = sum([weight for weight, _, _ in rows])
        mean_s = first_s + sum([weight * since_s for weight, since_s, _ in rows]) / total
        done = mean_s, sum([weight * a for weight, _, a in rows]) / total
        self._given_s = mean_s
        self._before, self._samples = self._samples, []
        return done

    @property
    def averaged(self) -> int:
        """Samples in a beat."""
        return max(1, int(BEAT_S / self.period_s + 0.25)) if isfinite(self.period_s) else 1

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
            self._whole_s = (self.averaged - 1.5) * period_s
            self._break_s = max(2.5 * period_s, BREAK_S)
        else:
            self._whole_s, self._break_s = inf, inf
