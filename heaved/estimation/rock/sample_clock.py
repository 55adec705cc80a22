"""Sample stamps on an even grid of their own rate: what block means and whole-sample lags need.

Polls come with jitter, late, get lost, and come at a rate nobody tells the predictor. The interval is found from the
first stamps, on whose grid a lost or late one does no harm, looked at once more while they become many, and then
followed with the phase by a critically damped second-order loop. A sample is handed on as "so many steps after the last
one, this late".
"""

from __future__ import annotations

from collections import deque
from math import inf, nan
from typing import Final

import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.sample_rate import are_still_apart, usual_interval

Array = NDArray[np.float64]

FIRST: Final = 11
"""Stamps before the interval is known."""
PHASE_GAIN: Final = 0.05
"""Share of a stamp's deviation that the phase takes over: averages the jitter of some 40 stamps."""
INTERVAL_GAIN: Final = PHASE_GAIN**2 / 4.0
"""Critical damping."""
TRUSTED: Final = 0.3
"""Deviations, in intervals, that move phase and interval as far as they are."""
LATE: Final = 0.2
"""Stamps are not early by more than so many intervals: nobody answers before being asked."""
LOOKED_AT: Final = (64, 128, 256)
"""So many first stamps are looked at once more: what 2 s of late ones have shown is some percent off, and the loop does
not find back from there."""
RECENT: Final = 32
"""Intervals that decide whether the rate has changed."""
CHANGED: Final = 0.08
"""Relative change of the median interval that is a new rate, when the intervals scatter by less than this."""
GAP: Final = 4
"""Steps at once that are a gap, and say little about phase, interval or rate."""
RATIO: Final = (0.6, 1.6)
"""Samples per grid step outside of which the rate is another, however much they scatter."""
LEAST_S: Final = 1e-3
"""Shortest interval: sizes what is as long as some seconds of samples."""


class SampleClock:
    """Tracks interval and phase of a stream of stamps."""

    def __init__(self) -> None:
        self.interval_s = nan
        """Of the grid; nan until known."""
        self.late_s = 0.0
        """How long after its grid time the last sample was stamped (either sign)."""
        self._grid_s = nan
        self._recent: deque[float] = deque(maxlen=RECENT)
        self._steps: deque[int] = deque(maxlen=RECENT)
        self._last_s = nan
        self._first: list[float] = []
        """Stamps, until they are LOOKED_AT[-1]."""
        self._is_other = False
        """They have shown another interval than the first of them."""

    def start(self, stamps_s: list[float]) -> bool:
        """Find the interval from increasing stamps, at least :data:`FIRST`; the last of them is the grid's origin."""
        if len(stamps_s) < FIRST:
            return False
        self._first = list(stamps_s)
        self._fit()
        t = self._first
        self._last_s = t[-1]
        self._recent.clear()
        self._steps.clear()
        return True

    def _fit(self) -> None:
        """Interval and phase from all first stamps."""
        t = np.array(self._first)
        since_s = t - t[-1]
        interval_s = max(usual_interval(t), LEAST_S)
        if abs(interval_s - self.interval_s) > CHANGED * self.interval_s:
            self._is_other = are_still_apart(since_s, interval_s) and not are_still_apart(since_s, self.interval_s)
            return
        # The mean of the phases, which late stamps move little; on whole steps about it, a straight line.
        phase = float(np.angle(np.exp(2j * np.pi * since_s / interval_s).mean())) / (2.0 * np.pi)
        steps = np.rint(since_s / interval_s - phase)
        off_s = since_s - (steps + phase) * interval_s
        slope, first = np.polyfit(steps, np.clip(off_s, -TRUSTED * interval_s, TRUSTED * interval_s), 1)
        self.interval_s = max(interval_s + float(slope), LEAST_S)
        self._grid_s = t[-1] + steps[-1] * self.interval_s + float(first) + phase * interval_s
        self.late_s = float(t[-1] - self._grid_s)

    @property
    def _trusted_s(self) -> tuple[float, float]:
        """What of a deviation is believed: a stamp that is late by more may be so by any number of steps."""
        return -TRUSTED * self.interval_s, TRUSTED * self.interval_s

    def step(self, t_s: float) -> int:
        """Whole grid steps from the last sample to this later one; 0: both fall on the same grid time."""
        since_s = t_s - self._grid_s
        steps = round(since_s / self.interval_s)
        if steps > 1 and since_s / self.interval_s - steps < -LATE:
            steps -= 1  # a late one, whose place is free, and not an early one
        self._recent.append(t_s - self._last_s)
        self._steps.append(min(steps, GAP))
        self._last_s = t_s
        deviation_s = since_s - steps * self.interval_s
        self._grid_s += steps * self.interval_s
        if 0 < steps <= GAP:
            low_s, high_s = self._trusted_s
            trusted_s = min(max(deviation_s, low_s), high_s)
            self._grid_s += PHASE_GAIN * trusted_s
            self.interval_s += INTERVAL_GAIN * trusted_s / steps
        self.late_s = t_s - self._grid_s
        if len(self._first) < LOOKED_AT[-1]:
            self._first.append(t_s)
            if len(self._first) in LOOKED_AT:
                self._fit()
        return steps

    def changed(self) -> bool:
        """Whether the recent stamps come at another rate than the grid's."""
        if self._is_other:
            return True
        if len(self._recent) < RECENT:
            return False
        ordered = sorted(self._recent)
        low, middle, high = ordered[RECENT // 5], ordered[RECENT // 2], ordered[-1 - RECENT // 5]
        regular = high - low < CHANGED * self.interval_s
        if regular and abs(middle - self.interval_s) > CHANGED * self.interval_s:
            return True
        total = sum(self._steps)
        ratio = RECENT / total if total > 0 else inf
        return not RATIO[0] < ratio < RATIO[1]
