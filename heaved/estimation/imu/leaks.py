"""What an IMU that is not as its profile says puts into the vertical acceleration, as columns whose sizes are unknown.

A triad shows r = M f of the specific force f: M has what the triad is turned by against the frame of the attitude (its
skew part), what its axes leak into each other and by how much their scales differ. Gravity is removed with the third
row u of the rotation from body to level axes, so that the vertical acceleration is off by

    u (M - 1) f = sum over i, j of m_ij u_i f_j,

and by k sum over i of u_i f_i |f_i| / g where axes show a share k more for each g. That is linear in what is not known,
for any attitude and any motion. Four of the columns are waves (m_zx fx, m_xz g pitch, and those across); products of
two waves have their difference frequency, far below both, where a millimetre per second squared is decimetres of heave.

The scale is not among them, nor what a bend makes of it (2 k): that is a gain of the heave, which is learned as such.
Differences between the scales of the axes are left out too: 1 % is a product with the square of a tilt, a tenth of a
millimetre per second squared, and half a minute of waves tells it badly.
"""

from __future__ import annotations

from enum import IntEnum
from math import cos, sin

from heaved.samples import GRAVITY_MPS2


class Leak(IntEnum):
    """The columns, in their order."""

    FORWARD_UPRIGHT = 0
    """m_zx: the upright axis shows a share of the forward one,"""
    PORT_UPRIGHT = 1
    """m_zy: of the one to port;"""
    UPRIGHT_FORWARD = 2
    """m_xz: the forward axis shows a share of the upright one,"""
    UPRIGHT_PORT = 3
    """m_yz: so does the one to port;"""
    ACROSS = 4
    """m_xy = m_yx: these two show each other;"""
    BEND = 5
    """k: each axis shows more for each g."""


Leaks = tuple[float, float, float, float, float, float]


def leaks_mps2(fx: float, fy: float, fz: float, roll_rad: float, pitch_rad: float) -> Leaks:
    """The columns for a specific force (m/s2, body axes) and the attitude of its moment, for 1 of each unknown."""
    c = cos(pitch_rad)
    x, y, z = sin(pitch_rad), sin(roll_rad) * c, cos(roll_rad) * c
    along = x * fx + y * fy + z * fz - GRAVITY_MPS2
    bent = (x * fx * abs(fx) + y * fy * abs(fy) + z * fz * abs(fz)) / GRAVITY_MPS2 - GRAVITY_MPS2 - 2.0 * along
    return z * fx, z * fy, x * fz, y * fz, x * fy + y * fx, bent
