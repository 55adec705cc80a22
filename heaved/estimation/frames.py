"""Attitude and vertical acceleration. Axes x forward, y port, z up; roll port up, pitch bow up (see heaved.samples)."""

from __future__ import annotations

from math import cos, sin

from heaved.samples import GRAVITY_MPS2


def up_acceleration(fx: float, fy: float, fz: float, roll_rad: float, pitch_rad: float) -> float:
    """Vertical acceleration in m/s2, positive up, from the specific force (m/s2, body axes) and the attitude.

    The third row of the rotation from body to level axes, applied to the specific force, less gravity:
    sin(pitch) fx + sin(roll) cos(pitch) fy + cos(roll) cos(pitch) fz - g. It is zero at rest for any attitude.
    A wrong sign of roll or pitch shows as an error of 2 g sin^2(tilt) and as cross-talk from sway and surge.
    """
    cp = cos(pitch_rad)
    return sin(pitch_rad) * fx + sin(roll_rad) * cp * fy + cos(roll_rad) * cp * fz - GRAVITY_MPS2
