"""Attitude and vertical acceleration. Axes x forward, y port, z up; roll port up, pitch bow up (see heaved.samples)."""

from __future__ import annotations

from math import cos, hypot, isfinite, nan, sin
from typing import Final

from heaved.samples import GRAVITY_MPS2


def up_acceleration(fx: float, fy: float, fz: float, roll_rad: float, pitch_rad: float) -> float:
    """Vertical acceleration in m/s2, positive up, from the specific force (m/s2, body axes) and the attitude.

    The third row of the rotation from body to level axes, applied to the specific force, less gravity:
    sin(pitch) fx + sin(roll) cos(pitch) fy + cos(roll) cos(pitch) fz - g. It is zero at rest for any attitude.
    A wrong sign of roll or pitch shows as an error of 2 g sin^2(tilt) and as cross-talk from sway and surge.
    """
    cp = cos(pitch_rad)
    return sin(pitch_rad) * fx + sin(roll_rad) * cp * fy + cos(roll_rad) * cp * fz - GRAVITY_MPS2


LEVEL_TIME_S: Final = 600.0
"""Memory of the mean horizontal acceleration: long against the drift of a vessel on station."""
LEVEL_MIN_S: Final = 60.0
"""Before that, waves are in the mean."""
LEVEL_SHARE: Final = 0.75
"""How much of a mean is taken for a crooked mounting, the rest for bias: mountings are off by half a degree, biases of
0.05 m/s2 look like 0.3 degrees; 0.5^2 / (0.5^2 + 0.3^2)."""
LEVEL_FORCE: Final = (0.5, 1.5)
"""Shares of gravity between which a force is believed: registers that read zero, or nothing, say nothing of angles."""
LEVEL_LIMIT_RAD: Final = 0.05
"""A sensor that is off by more was not mounted, but dropped: its profile wants correcting."""


class Levelling:
    """How the accelerometers are turned against the frame in which the attitude is given, from gravity itself.

    A vessel on station does not accelerate sideways in the mean, so what is left of the horizontal specific force, over
    g, is the angle. One degree uncorrected lets 1.7 % of the sway into the heave.
    """

    def __init__(self) -> None:
        self._forward = self._port = self._seconds = 0.0
        self._t_s = nan

    def take(self, t_s: float, fx: float, fy: float, fz: float, roll_rad: float, pitch_rad: float) -> None:
        """One sample: specific force in m/s2, body axes, and the attitude in rad. What cannot be is passed over."""
        low, high = LEVEL_FORCE
        if not low * GRAVITY_MPS2 <= hypot(fx, fy, fz) <= high * GRAVITY_MPS2:
            return
        dt = min(t_s - self._t_s, 1.0) if isfinite(self._t_s) else 0.0
        self._t_s = t_s
        if dt <= 0.0:
            return
        sr, cr, sp, cp = sin(roll_rad), cos(roll_rad), sin(pitch_rad), cos(pitch_rad)
        self._seconds = min(self._seconds + dt, LEVEL_TIME_S)
        weight = dt / self._seconds
        self._forward += weight * (cp * fx - sp * (sr * fy + cr * fz) - self._forward)
        self._port += weight * (cr * fy - sr * fz - self._port)

    def angles(self) -> tuple[float, float]:
        """Roll and pitch (rad) to add to the attitude, for the accelerometers; zero until a minute is known."""
        if self._seconds < LEVEL_MIN_S:
            return 0.0, 0.0
        ramp = LEVEL_SHARE * min(1.0, (self._seconds - LEVEL_MIN_S) / LEVEL_MIN_S) / GRAVITY_MPS2
        roll, pitch = ramp * self._port, ramp * self._forward
        limit = LEVEL_LIMIT_RAD
        return min(max(roll, -limit), limit), min(max(pitch, -limit), limit)
