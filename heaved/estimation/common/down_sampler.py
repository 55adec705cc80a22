"""Samples of any rate averaged into means of about 50 ms, far below the waves, for a filter that runs once for each.

Whatever shakes the sensor near 20 or 40 Hz, a generator of 1200 revolutions, would fold into the waves. A plain mean of
50 ms lets a share |f - 20| / 20 of it through, a tenth of a m/s2 too much. So each is a triangular mean over its own
samples and those of the one before (two plain means, one after the other), which leaves the square of that share. The
time of a mean is the weighed mean of its samples': what averaging costs is the age of the mean, no phase.
"""

from __future__ import annotations

from math import inf, isfinite, nan
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of a :class:`DownSampler`; s."""

    length_s: float = 0.05
    """Of a mean: waves of 1 Hz lose nothing in it."""
    least_s: float = 0.04
    """What keeps means is sized for ones this short."""
    apart_s: float = 0.02
    """Stamps that come in bursts make one mean, and never one closer than this to the last: what is sized by time has a
    bound whatever the stamps are."""
    break_s: float = 0.075
    """A gap within a mean that is longer than this, and than ..."""
    break_intervals: float = 2.5
    """... so many intervals, ends it: it is one of fewer."""
    intervals: int = 101
    """Intervals from which the usual one is taken,"""
    first_intervals: int = 7
    """and the first time."""


TUNING: Final = Tuning()


def passed(f_hz: Array, period_s: float, averaged: int) -> Array:
    """What means of ``averaged`` samples every ``period_s`` let through of the power at ``f_hz`` (n,) > 0."""
    if averaged == 1:
        return np.ones_like(f_hz)
    half = np.pi * f_hz * period_s
    return np.asarray((np.sin(averaged * half) / (averaged * np.sin(half))) ** 4)


class DownSampler:
    """Averages a handful of samples into one; their mean time with them. Lost ones make it a mean of fewer.

    What follows a gap is the plain mean of its own samples. Nothing is dropped once the interval is known: what a gap
    has cut short is given with the first sample after it.

    Attributes:
        period_s: usual interval of the samples; nan: not known yet.
    """

    def __init__(self, period_s: float = nan) -> None:
        """``period_s``: the usual interval, where it is known from before."""
        self._given_s = -inf
        self._set(period_s)
        self._before: list[tuple[float, float]] = []
        """Time and value of the samples of the mean before, when this one follows it."""
        self._samples: list[tuple[float, float]] = []
        self._previous_s = nan
        self._intervals: list[float] = []

    def step(self, t_s: float, value: float) -> tuple[float, float] | None:
        """Time and value of the mean that this sample completes, or None."""
        interval_s, self._previous_s = t_s - self._previous_s, t_s
        done = None
        if isfinite(interval_s):
            was_known = isfinite(self.period_s)
            self._learn(interval_s)
            if isfinite(self.period_s) and not was_known:
                self._samples.clear()  # What was begun before the interval was known is no mean.
            elif interval_s > self._break_s and self._samples:
                done = self._mean()
                self._before = []
        self._samples.append((t_s, value))
        if t_s - self._samples[0][0] < self._whole_s or t_s - self._given_s < TUNING.apart_s or done is not None:
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
        """Samples in a mean."""
        return max(1, int(TUNING.length_s / self.period_s + 0.25)) if isfinite(self.period_s) else 1

    def _learn(self, interval_s: float) -> None:
        """The usual interval: a median, because a machine that was held up gives a long one and several short ones."""
        self._intervals.append(interval_s)
        wanted = TUNING.intervals if isfinite(self.period_s) else TUNING.first_intervals
        if len(self._intervals) >= wanted:
            self._set(sorted(self._intervals)[wanted // 2])
            self._intervals.clear()

    def _set(self, period_s: float) -> None:
        """From its first sample on, a mean is whole after ``_whole_s``, and broken by a gap of ``_break_s``."""
        self.period_s = period_s
        if isfinite(period_s):
            self._whole_s = (self.averaged - 1.5) * period_s
            self._break_s = max(TUNING.break_intervals * period_s, TUNING.break_s)
        else:
            self._whole_s, self._break_s = inf, inf
