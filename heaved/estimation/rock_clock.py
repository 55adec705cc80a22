"""Sample stamps on an even grid of their own rate: what block means and whole-sample lags need.

Polls come with jitter, get lost, and come at a rate nobody tells the predictor. The interval is the least-squares slope
of the first stamps over their indices on a grid of the usual interval (so a lost sample does no harm), then followed
with the phase by a critically damped second-order loop. A sample is handed on as "so many steps after the last one,
this late".
"""

from __future__ import annotations

from collections import deque
from math import inf, nan
from typing import Final

import numpy as np
from numpy.typing import NDArray

from heaved.estimation.arrivals import usual_interval

Array = NDArray[np.float64]

FIRST: Final = 11
"""Stamps before the interval is known."""
PHASE_GAIN: Final = 0.05
"""Share of a stamp's deviation that the phase takes over: averages the jitter of some 40 stamps."""
INTERVAL_GAIN: Final = PHASE_GAIN**2 / 4.0
"""Critical damping."""
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

    def start(self, stamps_s: list[float]) -> bool:
        """Find the interval from increasing stamps, at least :data:`FIRST`; the last of them is the grid's origin."""
        if len(stamps_s) < FIRST:
            return False
        t = np.array(stamps_s)
        slope, first = np.polyfit(np.rint((t - t[-1]) / max(usual_interval(t), LEAST_S)), t - t[-1], 1)
        self.interval_s = max(float(slope), LEAST_S)
        self.late_s = -float(first)
        self._grid_s = t[-1] + float(first)
        self._last_s = float(t[-1])
        self._recent.clear()
        self._steps.clear()
        return True

    def step(self, t_s: float) -> int:
        """Whole grid steps from the last sample to this later one; 0: both fall on the same grid time."""
        since_s = t_s - self._grid_s
        steps = round(since_s / self.interval_s)
        self._recent.append(t_s - self._last_s)
        self._steps.append(min(steps, GAP))
        self._last_s = t_s
        deviation_s = since_s - steps * self.interval_s
        self._grid_s += steps * self.interval_s
        if 0 < steps <= GAP:
            self._grid_s += PHASE_GAIN * deviation_s
            self.interval_s += INTERVAL_GAIN * deviation_s / steps
        self.late_s = t_s - self._grid_s
        return steps

    def changed(self) -> bool:
        """Whether the recent stamps come at another rate than the grid's."""
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
