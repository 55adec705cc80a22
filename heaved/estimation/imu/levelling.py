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
    return level_acceleration(fx, fy, fz, roll_rad, pitch_rad)[2]


def level_acceleration(
    fx: float, fy: float, fz: float, roll_rad: float, pitch_rad: float
) -> tuple[float, float, float]:
    """Acceleration forward, to port and up, m/s2, in the level frame that turns with the heading, likewise."""
    sr, cr, sp, cp = sin(roll_rad), cos(roll_rad), sin(pitch_rad), cos(pitch_rad)
    mast = sr * fy + cr * fz  # along the z axis of the hull before it rolls
    return cp * fx - sp * mast, cr * fy - sr * fz, sp * fx + cp * mast - GRAVITY_MPS2
