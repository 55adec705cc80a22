"""The delayed heave as it is published: with what the laser has taught, and as sure as the laser has shown it to be.

The smoother's standard deviation is that of the model. Where the sensor is not what the model has it for (a scale, a
lag that changes with frequency), the delayed heave is off by more than that, and nothing in the smoother says so. Laser
readings of the same time do, a minute later; what they have shown is remembered while there are none.
"""

from __future__ import annotations

from collections import deque
from math import hypot, inf, nan, sqrt
from typing import Final

from heaved.estimation.heave.laser.lead import LeadTracker
from heaved.samples import DelayedHeave

OVERCONFIDENCE: Final = 2.0
"""Published over modelled standard deviation: the smoothed value is so good that what the model leaves out shows, the
fit's own error first (1.5 covers that) and, on a vessel that rolls, the attitude's (1.5 covers 0.88, 2 covers 0.96 of
the errors on S6: tools/accuracy.py headline)."""
EVERY_S: Final = 0.1
"""Readings closer together than this are left out."""
MOST_WAITING: Final = 4096
"""Readings that are kept until the delayed heave of their time is there."""
MAX_STEP_S: Final = 0.5
"""Between delayed heaves further apart than this nothing is compared."""
MEMORY_S: Final = 180.0
"""Of the comparison, in seconds of laser: what is off is off for longer than a wave."""
FIRST_S: Final = 60.0
"""Seconds of laser before it says anything."""
LARGEST_SCALE: Final = 20.0


class DelayedOutput:
    """Feed it the delayed heaves of the observer, and the accepted readings of the laser.

    Attributes:
        newest: what is published, or None.
        scale: factor between the error that the laser has shown and the modelled one, 1 or more.
    """

    def __init__(self, noise_std_m: float) -> None:
        """``noise_std_m``: standard deviation of one reading of the laser."""
        self._noise2 = noise_std_m**2
        self.newest: DelayedHeave | None = None
        self.scale = 1.0
        self._of: DelayedHeave | None = None
        self._readings: deque[tuple[float, float]] = deque(maxlen=MOST_WAITING)
        self._read_s = -inf
        self._compared_s = nan
        self._seconds = self._shown2 = self._modelled2 = 0.0

    def give(self, t_s: float, heave_m: float) -> None:
        """A reading of the laser as heave, its constant removed."""
        if t_s - self._read_s >= EVERY_S:
            self._read_s = t_s
            self._readings.append((t_s, heave_m))

    def take(self, found: DelayedHeave | None, taught: LeadTracker) -> None:
        """What the observer has newest, and what the laser has taught of the sensor: how early it is, and its scale.

        How well these two are known is in the standard deviation: a thousandth of a wave is more than the smoother is
        off.
        """
        if found is self._of:
            return
        self._of, before = found, self.newest
        if found is None:
            self.newest = None
            return
        t_s, heave_m = found.t_s + taught.learned_s, taught.gain * found.heave_m
        step_s = nan if before is None else t_s - before.t_s
        is_next = before is not None and 0.0 < step_s <= MAX_STEP_S
        velocity_mps = (heave_m - before.heave_m) / step_s if before is not None and is_next else 0.0
        modelled_m = hypot(OVERCONFIDENCE * taught.gain * found.std_m, taught.error_std_m(found.heave_m, velocity_mps))
        if self._readings:
            self._compare(before, t_s, heave_m, modelled_m)
        self.newest = DelayedHeave(t_s=t_s, heave_m=heave_m, std_m=self.scale * modelled_m)

    def _compare(self, before: DelayedHeave | None, t_s: float, heave_m: float, modelled_m: float) -> None:
        """With the readings up to ``t_s``, which lie between two delayed heaves."""
        readings, step_s = self._readings, inf if before is None else t_s - before.t_s
        while readings and readings[0][0] <= t_s:
            at_s, laser_m = readings.popleft()
            if before is None or not (before.t_s <= at_s and 0.0 < step_s <= MAX_STEP_S):
                continue
            share = (at_s - before.t_s) / step_s
            off_m = before.heave_m + share * (heave_m - before.heave_m) - laser_m
            # After a pause of the laser its first reading stands for itself, not for the pause.
            since_s = at_s - self._compared_s
            along_s = since_s if 0.0 < since_s <= 1.0 else EVERY_S
            self._compared_s = at_s
            self._seconds += along_s
            memory = min(along_s / min(self._seconds, MEMORY_S), 1.0)
            self._shown2 += memory * (off_m * off_m - self._shown2)
            self._modelled2 += memory * (modelled_m * modelled_m - self._modelled2)
        if self._seconds >= FIRST_S and self._modelled2 > 0.0:
            self.scale = min(max(sqrt(max(self._shown2 - self._noise2, 0.0) / self._modelled2), 1.0), LARGEST_SCALE)
