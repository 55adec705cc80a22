"""Signs and units of an IMU, judged by what gravity must look like in it: for the reasons, before any estimate is made.

At rest az is +9.8 m/s2. And the deck that heels shows gravity: ay = g sin(roll) cos(pitch) + sway, ax = g sin(pitch) +
surge. Sway and surge are coherent with the angles, and may outweigh them: a stiff barge leans less than the wave does,
and ay against g sin(roll) then has a negative slope although nothing is wrong. So a negative slope is only suspected of
being a wrong sign. It certainly is one when no vessel sways that much, or when the vertical acceleration is the worse
for having the tilt removed: below the waves there is nothing in it but what tilt removal has left, g roll^2 / 2 without
it, 2 g roll^2 with the wrong sign.
"""

from __future__ import annotations

from collections import deque
from math import exp, isfinite, isnan, nan, sin, sqrt
from statistics import median
from typing import Final

import msgspec

from heaved.estimation.imu.attitude import up_acceleration
from heaved.samples import GRAVITY_MPS2


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """When units and signs are wrong."""

    every_s: float = 0.1
    """Readings are looked at so often."""
    near_mps2: float = 4.0
    """az is that near to gravity most of the time, in any sea and at any heel."""
    told_s: float = 5.0
    """Away from it for so long it is told."""
    back_s: float = 1.0
    """Near it for so long it is well again; the crests of a sea, gravity removed, are shorter."""
    kept: int = 50
    """Readings away from it that are looked at together."""
    uneven: float = 0.3
    """Readings that lie about their median by more than this share of it, or of g, are not gravity in any unit."""
    in_g: float = 0.25
    """az in g is that near to one."""
    in_unit: float = 0.2
    """az in another unit is that near, relatively, to gravity in it."""
    gap_s: float = 1.0
    """Angles and accelerations further apart do not follow the ones before."""
    memory_s: float = 60.0
    """Of the slopes of accelerations on angles, and of variances."""
    learnt_s: float = 30.0
    """Of motion, before anything is said of signs."""
    slow_s: float = 3.0
    """Four low-passes of this time constant leave a hundredth of a 10 s wave."""
    warm_s: float = 25.0
    """Until they have forgotten how they began."""
    least_mps2: float = 0.02
    """RMS of g sin(angle) below which there is nothing to tell: a tenth of a degree."""
    suspect_slope: float = -0.5
    """Slope of the acceleration on g sin(angle), 1 by rights, below which the sign is suspected,"""
    suspect_correlation: float = -0.8
    """if the correlation of the two is below this."""
    cleared_slope: float = -0.2
    """From here on a suspicion is dropped."""
    most_sway: float = 1.5
    """Horizontal over vertical acceleration, RMS: waves move a vessel as much either way, its ends half as much
    again."""
    worse: float = 3.0
    """Times the variance below the waves with the tilt removed, over that without."""


TUNING: Final = Tuning()
OTHER_UNITS: Final = (("mm/s2", 1e3), ("cm/s2 or in mg", 1e2), ("ft/s2", 3.28084))
"""Units that are told by their size, in so many per m/s2."""


class UnitsCheck:
    """Says what az looks like when it does not look like gravity.

    Attributes:
        reason: why no sample can be used; empty: az is near gravity, or is a fault of another kind.
    """

    def __init__(self) -> None:
        self.reason = ""
        self._since_s = self._wrong_s = self._kept_s = nan
        self._kept: deque[tuple[float, float, float]] = deque(maxlen=TUNING.kept)

    def step(self, t_s: float, ax: float, ay: float, az: float) -> None:
        """Specific force as read; az is finite."""
        is_wrong = not abs(az - GRAVITY_MPS2) < TUNING.near_mps2
        if is_wrong:
            self._wrong_s = t_s
            if isnan(self._since_s):
                self._since_s, self._kept_s = t_s, -1e300
        elif isnan(self._since_s):
            return
        elif t_s - self._wrong_s >= TUNING.back_s:
            self._since_s = nan
            self._kept.clear()
            self.reason = ""
            return
        if t_s - self._kept_s >= TUNING.every_s:
            self._kept_s = t_s
            self._kept.append((ax, ay, az))
            if is_wrong and t_s - self._since_s >= TUNING.told_s:
                self.reason = self._likeness()

    def _likeness(self) -> str:
        """What the readings that are kept look like; empty: nothing that is known."""
        ax, ay, az = (median(column) if isfinite(sum(column)) else nan for column in zip(*self._kept, strict=True))
        if abs(az - GRAVITY_MPS2) < TUNING.near_mps2:
            return ""  # Most are well.
        spread = median(abs(row[2] - az) for row in self._kept)
        size = abs(az)
        if abs(size - 1.0) < TUNING.in_g and spread < TUNING.in_g:
            return "az about 1: in g? m/s2 are wanted" if az > 0.0 else "az about -1: in g, and upside down?"
        if not spread < TUNING.uneven * max(size, GRAVITY_MPS2):
            return ""
        return _likeness_of(ax, ay, az)


def _likeness_of(ax: float, ay: float, az: float) -> str:
    """The same of readings that are steady, and neither gravity nor in g."""
    if abs(az) < TUNING.near_mps2:
        if max(abs(ax), abs(ay)) > GRAVITY_MPS2 - TUNING.near_mps2:
            axis, value = ("ax", ax) if abs(ax) > abs(ay) else ("ay", ay)
            return f"az about 0 and {axis} about {value:.1f} m/s2: mounted on its side? z is up"
        return "az about 0: gravity removed? at rest +9.8 m/s2 are wanted"
    if abs(az + GRAVITY_MPS2) < TUNING.near_mps2:
        return "az about -9.8 m/s2: wrong sign, or upside down? at rest it is +9.8"
    for unit, per_mps2 in OTHER_UNITS:
        if abs(az / (per_mps2 * GRAVITY_MPS2) - 1.0) < TUNING.in_unit:
            return f"az about {az:.0f}: in {unit}? m/s2 are wanted"
    return f"az about {az:.3g}, not 9.8 m/s2: another unit, or another register?"


class _Line:
    """Slope and correlation of one quantity on another over the last minute."""

    def __init__(self) -> None:
        self._x = self._y = self._xx = self._xy = self._yy = 0.0
        self.is_suspect = False

    def step(self, share: float, x: float, y: float) -> None:
        dx, dy = x - self._x, y - self._y
        self._x += share * dx
        self._y += share * dy
        self._xx += share * ((1.0 - share) * dx * dx - self._xx)
        self._xy += share * ((1.0 - share) * dx * dy - self._xy)
        self._yy += share * ((1.0 - share) * dy * dy - self._yy)
        if self._xx < TUNING.least_mps2**2 or self._xy > TUNING.cleared_slope * self._xx:
            self.is_suspect = False
        elif self._xy < TUNING.suspect_slope * self._xx and self._xy < TUNING.suspect_correlation * sqrt(
            self._xx * self._yy
        ):
            self.is_suspect = True

    @property
    def opposed_mps2(self) -> float:
        """RMS of what sways against the angle."""
        return -self._xy / sqrt(self._xx)


class _Slow:
    """What is below the waves: four low-passes in a row, and the variance of what they leave."""

    def __init__(self) -> None:
        self._stages: list[float] = []
        self._mean = self.variance = 0.0

    def step(self, gain: float, share: float, value: float, is_warm: bool) -> None:
        stages = self._stages
        if not stages:
            stages[:] = [value] * 4
        for i in range(4):
            stages[i] += gain * (value - stages[i])
            value = stages[i]
        if is_warm:
            off = value - self._mean
            self._mean += share * off
            self.variance += share * ((1.0 - share) * off * off - self.variance)


class SignCheck:
    """Holds roll against ay and pitch against ax.

    Attributes:
        suspicion: what may be wrong; empty: nothing.
        certain: the same, when it certainly is: the tilt must not be removed with these angles.
    """

    def __init__(self) -> None:
        self.suspicion = self.certain = ""
        self._t_s = nan
        self._seconds = self._warm_seconds = 0.0
        self._roll, self._pitch = _Line(), _Line()
        self._with, self._without = _Slow(), _Slow()
        self._mean = self._square = 0.0

    @property
    def is_open(self) -> bool:
        """Whether there is a suspicion that has not been held against enough of what is below the waves yet."""
        return bool(self.suspicion) and self._warm_seconds < TUNING.memory_s

    def step(self, t_s: float, ax: float, ay: float, az: float, roll_rad: float, pitch_rad: float) -> None:
        """Specific force and attitude of one moment, all finite; more often than TUNING.every_s is not looked at."""
        since_s = t_s - self._t_s
        if since_s < TUNING.every_s - 1e-6:
            return
        self._t_s = t_s
        if not since_s < TUNING.gap_s:
            return
        self._seconds = min(self._seconds + since_s, TUNING.memory_s)
        share = since_s / self._seconds
        self._roll.step(share, GRAVITY_MPS2 * sin(roll_rad), ay)
        self._pitch.step(share, GRAVITY_MPS2 * sin(pitch_rad), ax)
        off = az - self._mean
        self._mean += share * off
        self._square += share * ((1.0 - share) * off * off - self._square)
        self._look_below(since_s, ax, ay, az, roll_rad, pitch_rad)
        self._conclude()

    def _look_below(self, since_s: float, ax: float, ay: float, az: float, roll_rad: float, pitch_rad: float) -> None:
        is_warm = self._seconds > TUNING.warm_s
        if is_warm:
            self._warm_seconds = min(self._warm_seconds + since_s, TUNING.memory_s)
        gain, share = 1.0 - exp(-since_s / TUNING.slow_s), since_s / max(self._warm_seconds, since_s)
        self._with.step(gain, share, up_acceleration(ax, ay, az, roll_rad, pitch_rad), is_warm)
        self._without.step(gain, share, az - GRAVITY_MPS2, is_warm)

    def _conclude(self) -> None:
        if self._seconds < TUNING.learnt_s:
            return
        pairs = ((self._roll, "roll", "ay"), (self._pitch, "pitch", "ax"))
        suspects = [(line, angle, axis) for line, angle, axis in pairs if line.is_suspect]
        if not suspects:
            self.suspicion = self.certain = ""
            return
        names = ", ".join([f"{angle} and {axis} disagree" for _, angle, axis in suspects])
        self.suspicion = f"{names}: wrong sign?"
        sways = max(line.opposed_mps2 for line, _, _ in suspects)
        is_worse = self._warm_seconds > TUNING.learnt_s and self._with.variance > TUNING.worse * self._without.variance
        if is_worse or sways > TUNING.most_sway * sqrt(self._square) or self.certain:
            self.certain = self.suspicion
