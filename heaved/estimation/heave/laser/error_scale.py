"""How large the laser shows the errors of the heave to be, over what the model says: at once, and in hindsight.

A standard deviation is that of the model. Where the sensor is not what the model has it for (a scale, a lag that
changes with frequency), the heave is off by more than that, and nothing in the observer or the smoother says so. Laser
readings of the same time do, for the delayed heave a minute later; what they have shown is remembered while there are
none.
"""

from __future__ import annotations

from collections import deque
from math import exp, hypot, inf, nan, sqrt
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.samples import DelayedHeave

if TYPE_CHECKING:
    from heaved.estimation.heave.laser.lead import LeadTracker


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of both scales, then of the one of the published heave, then of the delayed one. Seconds are those of laser."""

    memory_s: float = 180.0
    """Of the comparison: the error of a swell grows and fades over 40-80 s, a minute of either kind is not the error
    that an outage will have, and what is off in hindsight is off for longer than a wave."""
    independent_s: float = 40.0
    """As long as such an error grows or fades: two numbers of it, amplitude and phase, are independent of the last."""
    surely: float = 2.0
    """Standard errors by which the laser must have shown a smaller error than the modelled one."""
    follow_s: float = 60.0
    """Time constant with which the standard deviation takes it over."""
    limits: tuple[float, float] = (0.2, 10.0)
    """Bounds of what the laser may do to the modelled standard deviation."""
    least_noise: float = 0.25
    """No error is taken to be smaller than that share of the noise of a reading."""
    overconfidence: float = 2.0
    """Published over modelled standard deviation of the delayed heave: the smoothed value is so good that what the
    model leaves out shows, the fit's own error first (1.5 covers that) and, on a vessel that rolls, the attitude's (1.5
    covers 0.88, 2 covers 0.96 of the errors on S6: tools/accuracy.py headline)."""
    every_s: float = 0.1
    """Readings closer together than this are left out of the delayed comparison."""
    most_waiting: int = 4096
    """Readings that are kept until the delayed heave of their time is there."""
    longest_step_s: float = 0.5
    """Between delayed heaves further apart than this nothing is compared."""
    first_s: float = 60.0
    """Before so much laser it says nothing of the delayed heave."""
    largest: float = 20.0
    """Of the delayed heave's scale."""


TUNING: Final = Tuning()


class PublishedScale:
    """Factor between the error of the published heave that the laser has shown and the modelled one; 1 before any."""

    def __init__(self, noise_std_m: float) -> None:
        """``noise_std_m``: standard deviation of one reading of the laser."""
        self._noise_std_m = noise_std_m
        self._scale2, self._judged_s = 1.0, nan
        self._shown2 = self._modelled2 = self._seconds = 0.0

    @property
    def value(self) -> float:
        """At the last reading."""
        return sqrt(self._scale2)

    def at(self, t_s: float) -> float:
        """For a moment after the last reading: that the heave is better than modelled is of the sea of then, that it is
        worse is of the sensor, and stays.
        """
        if self._scale2 >= 1.0 or not t_s > self._judged_s:
            return self.value
        return sqrt(1.0 + exp((self._judged_s - t_s) / TUNING.memory_s) * (self._scale2 - 1.0))

    def step(self, t_s: float, dt: float, deviation_m: float, modelled_std_m: float, *, may_judge: bool) -> None:
        """A reading at ``t_s``, ``dt`` of laser after the last, and how far it is off; both of the same time, for after
        a gap both are large for a while. ``may_judge``: there has been enough of this target.
        """
        self._seconds += dt
        memory = min(1.0, dt / min(0.5 * self._seconds, TUNING.memory_s))
        self._shown2 += memory * (deviation_m**2 - self._shown2)
        memory = memory if self._modelled2 > 0.0 else 1.0
        self._modelled2 += memory * (modelled_std_m**2 - self._modelled2)
        if not may_judge:
            return
        noise_m = self._noise_std_m
        shown2 = max(self._shown2 - noise_m**2, (TUNING.least_noise * noise_m) ** 2)
        low, high = TUNING.limits
        scale2 = min(max(shown2 / self._modelled2, low**2), high**2)
        if scale2 < 1.0:  # To be better than it thinks takes as long to see as its error takes to come and go.
            independent = 2.0 * max(min(self._seconds, TUNING.memory_s) / TUNING.independent_s, 1.0)
            scale2 = min(scale2 * (1.0 + TUNING.surely * sqrt(2.0 / independent)), 1.0)
        self._scale2, self._judged_s = self.at(t_s - dt) ** 2, t_s
        self._scale2 += (1.0 - exp(-dt / TUNING.follow_s)) * (scale2 - self._scale2)


class DelayedScale:
    """The same for the delayed heave, 1 or more. Step it with those of the observer; push it the accepted readings.

    Attributes:
        value: the factor.
        newest: what is published, or None.
    """

    def __init__(self, noise_std_m: float) -> None:
        """``noise_std_m``: standard deviation of one reading of the laser."""
        self._noise2 = noise_std_m**2
        self.newest: DelayedHeave | None = None
        self.value = 1.0
        self._of: DelayedHeave | None = None
        self._readings: deque[tuple[float, float]] = deque(maxlen=TUNING.most_waiting)
        self._read_s = -inf
        self._compared_s = nan
        self._seconds = self._shown2 = self._modelled2 = 0.0

    def push(self, t_s: float, heave_m: float) -> None:
        """A reading of the laser as heave, its constant removed."""
        if t_s - self._read_s >= TUNING.every_s:
            self._read_s = t_s
            self._readings.append((t_s, heave_m))

    def step(self, found: DelayedHeave | None, taught: LeadTracker) -> DelayedHeave | None:
        """What the observer has newest, with what the laser has taught of the sensor: how early it is, and its scale.

        How well these two are known is in the standard deviation: a thousandth of a wave is more than the smoother is
        off.
        """
        if found is self._of:
            return self.newest
        self._of, before = found, self.newest
        if found is None:
            self.newest = None
            return None
        t_s, heave_m = found.t_s + taught.learned_s, taught.gain * found.heave_m
        step_s = nan if before is None else t_s - before.t_s
        is_next = before is not None and 0.0 < step_s <= TUNING.longest_step_s
        velocity_mps = (heave_m - before.heave_m) / step_s if before is not None and is_next else 0.0
        modelled_m = TUNING.overconfidence * taught.gain * found.std_m
        modelled_m = hypot(modelled_m, taught.error_std_m(found.heave_m, velocity_mps))
        if self._readings:
            self._compare(before, t_s, heave_m, modelled_m)
        self.newest = DelayedHeave(t_s=t_s, heave_m=heave_m, std_m=self.value * modelled_m)
        return self.newest

    def _compare(self, before: DelayedHeave | None, t_s: float, heave_m: float, modelled_m: float) -> None:
        """With the readings up to ``t_s``, which lie between two delayed heaves."""
        readings, step_s = self._readings, inf if before is None else t_s - before.t_s
        while readings and readings[0][0] <= t_s:
            at_s, laser_m = readings.popleft()
            if before is None or not (before.t_s <= at_s and 0.0 < step_s <= TUNING.longest_step_s):
                continue
            share = (at_s - before.t_s) / step_s
            off_m = before.heave_m + share * (heave_m - before.heave_m) - laser_m
            # After a pause of the laser its first reading stands for itself, not for the pause.
            since_s = at_s - self._compared_s
            along_s = since_s if 0.0 < since_s <= 1.0 else TUNING.every_s
            self._compared_s = at_s
            self._seconds += along_s
            memory = min(along_s / min(self._seconds, TUNING.memory_s), 1.0)
            self._shown2 += memory * (off_m * off_m - self._shown2)
            self._modelled2 += memory * (modelled_m * modelled_m - self._modelled2)
        if self._seconds >= TUNING.first_s and self._modelled2 > 0.0:
            scale = sqrt(max(self._shown2 - self._noise2, 0.0) / self._modelled2)
            self.value = min(max(scale, 1.0), TUNING.largest)
