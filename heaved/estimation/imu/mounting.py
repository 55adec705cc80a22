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
from math import exp, isfinite, nan, sin, sqrt
from statistics import median
from typing import Final

from heaved.estimation.imu.levelling import up_acceleration
from heaved.samples import GRAVITY_MPS2

NEAR_MPS2: Final = 4.0
"""az is that near to gravity most of the time, in any sea and at any heel."""
TOLD_S: Final = 5.0
"""Away from it for so long it is told."""
BACK_S: Final = 1.0
"""Near it for so long it is well again; the crests of a sea, gravity removed, are shorter."""
KEPT: Final = 50
"""Readings that are looked at, EVERY_S apart."""
EVERY_S: Final = 0.1
UNEVEN: Final = 0.3
"""Readings that lie about their median by more than this share of it, or of g, are not gravity in any unit."""
IN_G: Final = 0.25
"""az in g is that near to one."""

MEMORY_S: Final = 60.0
LEARNT_S: Final = 30.0
"""Of motion, before anything is said of signs."""
SLOW_S: Final = 3.0
"""Four low-passes of this time constant leave a hundredth of a 10 s wave."""
WARM_S: Final = 25.0
"""Until they have forgotten how they began."""
LEAST_MPS2: Final = 0.02
"""RMS of g sin(angle) below which there is nothing to tell: a tenth of a degree."""
SUSPECT_SLOPE: Final = -0.5
SUSPECT_CORRELATION: Final = -0.8
CLEARED_SLOPE: Final = -0.2
"""From here on a suspicion is dropped."""
MOST_SWAY: Final = 1.5
"""Horizontal over vertical acceleration, RMS: waves move a vessel as much either way, its ends half as much again."""
WORSE: Final = 3.0
"""Times the variance below the waves with the tilt removed, over that without."""


class UnitsWatch:
    """Says what az looks like when it does not look like gravity.

    Attributes:
        reason: why no sample can be used; empty: az is near gravity, or is a fault of another kind.
    """

    def __init__(self) -> None:
        self.reason = ""
        self._since_s = self._wrong_s = self._kept_s = nan
        self._kept: deque[tuple[float, float, float]] = deque(maxlen=KEPT)

    def take(self, t_s: float, ax: float, ay: float, az: float) -> None:
        """Specific force as read; az is finite."""
        is_wrong = not abs(az - GRAVITY_MPS2) < NEAR_MPS2
        if is_wrong:
            self._wrong_s = t_s
            if self._since_s != self._since_s:
                self._since_s, self._kept_s = t_s, -1e300
        elif self._since_s != self._since_s:
            return
        elif t_s - self._wrong_s >= BACK_S:
            self._since_s = nan
            self._kept.clear()
            self.reason = ""
            return
        if t_s - self._kept_s >= EVERY_S:
            self._kept_s = t_s
            self._kept.append((ax, ay, az))
            if is_wrong and t_s - self._since_s >= TOLD_S:
                self.reason = self._likeness()

    def _likeness(self) -> str:
        ax, ay, az = (median(v for v in column if isfinite(v)) if isfinite(sum(column)) else nan
                      for column in zip(*self._kept, strict=True))  # fmt: skip
        if abs(az - GRAVITY_MPS2) < NEAR_MPS2:
            return ""  # Most are well.
        spread = median(abs(row[2] - az) for row in self._kept)
        size = abs(az)
        if abs(size - 1.0) < IN_G and spread < IN_G:
            return "az about 1: in g? m/s2 are wanted" if az > 0.0 else "az about -1: in g, and upside down?"
        if not spread < UNEVEN * max(size, GRAVITY_MPS2):
            return ""
        if size < NEAR_MPS2:
            if max(abs(ax), abs(ay)) > GRAVITY_MPS2 - NEAR_MPS2:
                axis, value = ("ax", ax) if abs(ax) > abs(ay) else ("ay", ay)
                return f"az about 0 and {axis} about {value:.1f} m/s2: mounted on its side? z is up"
            return "az about 0: gravity removed? at rest +9.8 m/s2 are wanted"
        if abs(az + GRAVITY_MPS2) < NEAR_MPS2:
            return "az about -9.8 m/s2: wrong sign, or upside down? at rest it is +9.8"
        for unit, per_mps2 in (("mm/s2", 1e3), ("cm/s2 or in mg", 1e2), ("ft/s2", 3.28084)):
            if abs(az / (per_mps2 * GRAVITY_MPS2) - 1.0) < 0.2:
                return f"az about {az:.0f}: in {unit}? m/s2 are wanted"
        return f"az about {az:.3g}, not 9.8 m/s2: another unit, or another register?"


class _Line:
    """Slope and correlation of one quantity on another over MEMORY_S."""

    def __init__(self) -> None:
        self._x = self._y = self._xx = self._xy = self._yy = 0.0
        self.is_suspect = False

    def take(self, share: float, x: float, y: float) -> None:
        dx, dy = x - self._x, y - self._y
        self._x += share * dx
        self._y += share * dy
        self._xx += share * ((1.0 - share) * dx * dx - self._xx)
        self._xy += share * ((1.0 - share) * dx * dy - self._xy)
        self._yy += share * ((1.0 - share) * dy * dy - self._yy)
        if self._xx < LEAST_MPS2**2 or self._xy > CLEARED_SLOPE * self._xx:
            self.is_suspect = False
        elif self._xy < SUSPECT_SLOPE * self._xx and self._xy < SUSPECT_CORRELATION * sqrt(self._xx * self._yy):
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

    def take(self, gain: float, share: float, value: float, is_warm: bool) -> None:
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


class SignWatch:
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
        return bool(self.suspicion) and self._warm_seconds < MEMORY_S

    def take(self, t_s: float, ax: float, ay: float, az: float, roll_rad: float, pitch_rad: float) -> None:
        """Specific force and attitude of one moment, all finite; more often than EVERY_S is not looked at."""
        since_s = t_s - self._t_s
        if since_s < EVERY_S - 1e-6:
            return
        self._t_s = t_s
        if not since_s < BACK_S:
            return
        self._seconds = min(self._seconds + since_s, MEMORY_S)
        share = since_s / self._seconds
        self._roll.take(share, GRAVITY_MPS2 * sin(roll_rad), ay)
        self._pitch.take(share, GRAVITY_MPS2 * sin(pitch_rad), ax)
        off = az - self._mean
        self._mean += share * off
        self._square += share * ((1.0 - share) * off * off - self._square)
        self._look_below(since_s, ax, ay, az, roll_rad, pitch_rad)
        self._conclude()

    def _look_below(self, since_s: float, ax: float, ay: float, az: float, roll_rad: float, pitch_rad: float) -> None:
        is_warm = self._seconds > WARM_S
        if is_warm:
            self._warm_seconds = min(self._warm_seconds + since_s, MEMORY_S)
        gain, share = 1.0 - exp(-since_s / SLOW_S), since_s / max(self._warm_seconds, since_s)
        self._with.take(gain, share, up_acceleration(ax, ay, az, roll_rad, pitch_rad), is_warm)
        self._without.take(gain, share, az - GRAVITY_MPS2, is_warm)

    def _conclude(self) -> None:
        if self._seconds < LEARNT_S:
            return
        pairs = ((self._roll, "roll", "ay"), (self._pitch, "pitch", "ax"))
        suspects = [(line, angle, axis) for line, angle, axis in pairs if line.is_suspect]
        if not suspects:
            self.suspicion = self.certain = ""
            return
        names = ", ".join([f"{angle} and {axis} disagree" for _, angle, axis in suspects])
        self.suspicion = f"{names}: wrong sign?"
        sways = max(line.opposed_mps2 for line, _, _ in suspects)
        is_worse = self._warm_seconds > LEARNT_S and self._with.variance > WORSE * self._without.variance
        if is_worse or sways > MOST_SWAY * sqrt(self._square) or self.certain:
            self.certain = self.suspicion
