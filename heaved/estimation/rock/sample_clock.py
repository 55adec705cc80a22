"""Sample stamps on an even grid of their own rate: what means over lags and whole-sample horizons need.

Polls come with jitter, late, get lost, and come at a rate nobody tells the predictor. The interval is found from the
first stamps, on whose grid a lost or late one does no harm, and then followed with the phase by a critically damped
second-order loop. A sample is handed on as "so many steps after the last one, this late". Once a second the recent
stamps are looked at: whether they are still those of this grid.

Of a sensor that is slower than its polls a clock is followed, too (:mod:`heaved.estimation.imu.sensor_clock`): there
each poll says no more than that a tick lies since the one before, and how many there were is known. Here stamps are
seen themselves, and how many steps lie between two of them is what is asked.
"""

from __future__ import annotations

from collections import deque
from math import nan
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

from heaved.estimation.common.sample_rate import are_on_grid, are_still_apart, usual_interval

if TYPE_CHECKING:
    from collections.abc import Sequence


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What this file is set to; shares are of the interval."""

    phase_gain: float = 0.05
    """Share of a stamp's deviation that the phase takes over: averages the jitter of some 40 stamps. The interval takes
    over a quarter of its square, which is critical damping."""
    trusted: float = 0.3
    """Deviations that move phase and interval as far as they are."""
    late: float = 0.2
    """Stamps are not early by more than this after a hole: nobody answers before being asked."""
    own: float = 0.3
    """So long after the last one a stamp is one of its own."""
    gap: int = 4
    """Steps at once that are a gap, and say little about phase or interval."""
    judged_s: float = 2.0
    """The recent past by which the interval is judged,"""
    checked_s: float = 1.0
    """so often: a new rate is noticed within 3 s."""
    judged: int = 11
    """Stamps by which it is judged, at least."""
    changed: float = 0.08
    """Change of the usual interval that is another rate;"""
    moved: float = 0.02
    """and one that is so twice in a row: farther than the loop finds, and than stamps that are late may show once."""
    looks: int = 30
    """Where the stamps are on no grid at all, as those of a machine that does not keep up, so many looks in a row must
    show another rate: each of them says little, and to begin anew costs all that was learned."""
    least_s: float = 1e-3
    """Shortest interval, s: sizes what is as long as some seconds of samples."""


TUNING: Final = Tuning()


class SampleClock:
    """Tracks interval and phase of a stream of stamps.

    Attributes:
        interval_s: of the grid.
        late_s: how long after its grid time the last sample was stamped (either sign).
        is_other: the recent stamps come at another rate than the grid's.
    """

    def __init__(self, stamps_s: Sequence[float], interval_s: float = nan) -> None:
        """From increasing stamps, four at least; ``interval_s``: where it is nearly known, and only refined."""
        trusted = TUNING.trusted
        t = np.array(stamps_s)
        since_s = t - t[-1]
        interval_s = interval_s if interval_s > 0.0 else max(usual_interval(t), TUNING.least_s)
        # The mean of the phases, which late stamps move little; on whole steps about it, a straight line.
        phase = float(np.angle(np.exp(2j * np.pi * since_s / interval_s).mean())) / (2.0 * np.pi)
        steps = np.rint(since_s / interval_s - phase)
        off_s = since_s - (steps + phase) * interval_s
        slope, first = np.polyfit(steps, np.clip(off_s, -trusted * interval_s, trusted * interval_s), 1)
        self.interval_s = max(interval_s + float(slope), TUNING.least_s)
        self._grid_s = float(t[-1] + steps[-1] * self.interval_s + float(first) + phase * interval_s)
        self.late_s = float(t[-1]) - self._grid_s
        self.is_other = False
        self._moved_by = 0.0
        """By how much of the interval the last look has found it to be off."""
        self._are_on_grid = True
        """The recent stamps; of others, which are all late and never early, the interval is not to be learned."""
        self._looks = 0
        """So many in a row have shown another rate, of stamps on no grid."""
        self._recent: deque[float] = deque()
        """Stamps of the last ``judged_s``."""
        self._check_s = float(t[-1]) + TUNING.checked_s

    def steps_of(self, stamps_s: Sequence[float]) -> list[int]:
        """Whole grid steps of each of increasing stamps from the one before; the first is one step on."""
        index = np.rint((np.array(stamps_s) - self._grid_s) / self.interval_s)
        return [int(step) for step in np.diff(index, prepend=index[0] - 1.0)]

    def step(self, t_s: float) -> int:
        """Whole grid steps from the last sample to this later one; 0: both fall on the same grid time."""
        interval_s = self.interval_s
        since_s = t_s - self._grid_s
        steps: int = round(since_s / interval_s)
        if steps > 1 and since_s / interval_s - steps < -TUNING.late:
            steps -= 1  # a late one, whose place is free, and not an early one
        elif steps == 0 and since_s > TUNING.own * interval_s:
            steps = 1  # an early one, whose place is free: were it left out, the loop would see late ones alone
        deviation_s = since_s - steps * interval_s
        self._grid_s += steps * interval_s
        if 0 < steps <= TUNING.gap:
            trusted_s = TUNING.trusted * interval_s
            trusted_s = min(max(deviation_s, -trusted_s), trusted_s)
            self._grid_s += TUNING.phase_gain * trusted_s
            if self._are_on_grid:
                self.interval_s += TUNING.phase_gain**2 / 4.0 * trusted_s / steps
        self.late_s = t_s - self._grid_s
        self._recent.append(t_s)
        if t_s >= self._check_s:
            self._check(t_s)
        return steps

    def _check(self, t_s: float) -> None:
        """Held-up polls change intervals, not their mean; lost ones the mean, not the usual interval."""
        recent, interval_s = self._recent, self.interval_s
        self._check_s = t_s + TUNING.checked_s
        while len(recent) > TUNING.judged and t_s - recent[0] > TUNING.judged_s:
            recent.popleft()
        before, self._moved_by = self._moved_by, 0.0
        looks, self._looks, self._are_on_grid = self._looks, 0, True
        if len(recent) < TUNING.judged:
            return
        mean_s = (recent[-1] - recent[0]) / (len(recent) - 1)
        if abs(mean_s / interval_s - 1.0) <= TUNING.moved:
            return
        since_s = np.array(recent) - recent[0]
        if are_still_apart(since_s, interval_s):
            return
        self._are_on_grid = False
        other_s = usual_interval(since_s)
        self._moved_by = moved_by = other_s / interval_s - 1.0
        is_same = before * moved_by > 0.0 and min(abs(before), abs(moved_by)) > TUNING.moved
        if abs(moved_by) > TUNING.changed or is_same:
            self._looks = looks + 1
            self.is_other = self._looks >= TUNING.looks or are_on_grid(since_s, other_s)
