"""How often samples come, and how many of them are lost, from their stamps alone.

Nobody tells an estimator the rate; polls come early and late, are held up, and get lost.
"""

from __future__ import annotations

from math import nan
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PAIRS: Final = 0.4
"""Quantile of the length of two intervals together to begin with: below the median, for polls get lost and none are
added."""
SPAN: Final = 3
"""Intervals whose steps are counted together."""
HIDDEN: Final = 0.1
"""Median deviation of the intervals, relative, from which jitter hides how many steps they are."""
LONG: Final = 0.02
"""Share of intervals longer than two in the mean from which stamps are missing."""

FIRST: Final = 12
"""Stamps that are looked at together, at least,"""
WINDOW_S: Final = 2.0
"""and so much time."""
MEMORY_S: Final = 60.0
"""Of the share of lost samples."""
WHOLE: Final = 0.1
"""Intervals are whole numbers of the usual one when that is, in the mean, how far off they are."""


def usual_interval(stamps_s: Array) -> float:
    """Interval at which increasing stamps (n,), n > 3, are meant to come, whatever befell some of them.

    On a busy machine a poll comes up to an interval late and the next one soon after: the single intervals then lie in
    two heaps beside the true one, and their median in either. Lateness cancels in the sum of neighbours, and a lost
    poll shows in every sum across it. So the steps in spans of three intervals are counted, rounded to whole ones, and
    time is divided by steps, as often as it takes to agree with itself. Jitter of half an interval makes anything agree
    with itself; then, if none are missing, the stamps themselves are counted.
    """
    pairs = stamps_s[2:] - stamps_s[:-2]
    interval_s = 0.5 * float(np.quantile(pairs, PAIRS))
    spans = stamps_s[SPAN:] - stamps_s[:-SPAN]
    total_s = float(spans.sum())
    for _ in range(5):
        steps = float(np.rint(spans / interval_s).sum())
        if steps <= 0.0 or total_s / steps == interval_s:
            break
        interval_s = total_s / steps
    gaps = np.diff(stamps_s)
    mean_s = float(gaps.mean())
    if float(np.median(np.abs(gaps - interval_s))) > HIDDEN * interval_s and np.mean(gaps > 2.0 * mean_s) < LONG:
        return mean_s
    return interval_s


class Arrivals:
    """Feed it stamps in order of time.

    Attributes:
        period_s: usual interval; nan: not known yet.
        missing: share of the samples that were lost in the last minute.
    """

    def __init__(self) -> None:
        self.period_s = nan
        self.missing = 0.0
        self._stamps: list[float] = []

    def take(self, t_s: float) -> None:
        """A sample at ``t_s``, later than the last one."""
        stamps = self._stamps
        stamps.append(t_s)
        if t_s - stamps[0] >= WINDOW_S and len(stamps) >= FIRST:
            self._judge(np.array(stamps))
            self._stamps = [t_s]

    def _judge(self, stamps_s: Array) -> None:
        gaps, seconds = np.diff(stamps_s), float(stamps_s[-1] - stamps_s[0])
        if not self._still_holds(gaps):
            self.period_s = usual_interval(stamps_s)
        lost = max(1.0 - len(gaps) * self.period_s / seconds, 0.0)
        self.missing += min(seconds / MEMORY_S, 1.0) * (lost - self.missing)

    def _still_holds(self, gaps: Array) -> bool:
        """What is lost must not become what is usual: whether the intervals are the usual one so far, and gaps. With
        no interval among them that is the usual one itself it is a slower sensor."""
        steps = gaps / self.period_s
        whole = np.rint(steps)
        return bool(np.mean(np.abs(steps - whole)) < WHOLE and np.any(whole == 1.0))
