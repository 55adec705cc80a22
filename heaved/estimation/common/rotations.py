"""Rotations between the frames of a ship: direction cosines, rotation vectors, and the attitude of a second frame.

Two conventions meet here and nowhere else. A *deformation* is passive and right-handed: ``C = local_from_midships``
takes the components of a vector from the midships frame to the local one, ``C = R3(z) R2(y) R1(x)``. An *attitude* has
the signs of ``heaved.samples``: roll positive port up (right-handed about x), but pitch positive bow up and yaw
positive clockwise from above, both *against* the right hand. So a crane base that stands turned by ``z`` (right-handed,
to port) on a level ship heads ``-z``, and one that stands turned by ``y`` about the port axis pitches by ``-y``.
"""

from __future__ import annotations

from math import asin, atan2, cos, hypot, pi, sin, sqrt
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ARCSEC: Final = pi / 180.0 / 3600.0
"""One second of arc, rad."""
GIMBAL_COS: Final = 1e-6
"""Below this cosine of y the angles x and z turn about the same axis: x is taken as zero, z gets both."""


class AttitudeAngles(msgspec.Struct, frozen=True, gc=False):
    """Signs of ``heaved.samples``: roll port up, pitch bow up, yaw clockwise in [0, 2 pi)."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float


def cross_matrix(v: Array) -> Array:
    """[v x], (3, 3), for v (3,)."""
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def passive(rotation: Array) -> Array:
    """exp(-[r x]): takes components into a frame that is turned by the rotation vector r (3,), rad (Rodrigues)."""
    angle = sqrt(float(rotation.dot(rotation)))
    K = cross_matrix(rotation)
    if angle < 1e-4:  # the next terms are below 1e-16
        first, second = 1.0 - angle**2 / 6.0, 0.5 - angle**2 / 24.0
    else:
        first, second = sin(angle) / angle, (1.0 - cos(angle)) / angle**2
    result: Array = np.eye(3) - first * K + second * K.dot(K)
    return result


def rotation_vector(C: Array) -> Array:
    """The r (3,) in rad with ``passive(r) = C``, at most pi long."""
    axis = np.array([C[1, 2] - C[2, 1], C[2, 0] - C[0, 2], C[0, 1] - C[1, 0]]) / 2.0
    sine, cosine = sqrt(float(axis.dot(axis))), (float(np.trace(C)) - 1.0) / 2.0
    if sine > 1e-6:
        return np.asarray(axis * (atan2(sine, cosine) / sine))
    if cosine > 0.0:
        return axis
    # Half a turn: the sine says nothing, the symmetric part is 2 a a' - 1.
    symmetric = (C + C.T) / 4.0 + np.eye(3) / 2.0
    k = int(np.argmax(np.diag(symmetric)))
    return np.asarray(symmetric[k] * (pi / sqrt(float(symmetric[k, k]))))


def from_euler(x: float, y: float, z: float) -> Array:
    """``local_from_midships`` C = R3(z) R2(y) R1(x), passive elementary rotations, rad."""
    sx, cx, sy, cy, sz, cz = sin(x), cos(x), sin(y), cos(y), sin(z), cos(z)
    return np.array(
        [
            [cz * cy, cz * sy * sx + sz * cx, -cz * sy * cx + sz * sx],
            [-sz * cy, -sz * sy * sx + cz * cx, sz * sy * cx + cz * sx],
            [sy, -cy * sx, cy * cx],
        ]
    )


def to_euler(C: Array) -> tuple[float, float, float]:
    """(x, y, z) in rad of C = R3(z) R2(y) R1(x), y in [-pi/2, pi/2]. At y = +-pi/2 only x +- z is defined: x = 0."""
    y = asin(min(1.0, max(-1.0, float(C[2, 0]))))
    if hypot(float(C[0, 0]), float(C[1, 0])) < GIMBAL_COS:
        return 0.0, y, atan2(float(C[0, 1]), float(C[1, 1]))
    return atan2(-float(C[2, 1]), float(C[2, 2])), y, atan2(-float(C[1, 0]), float(C[0, 0]))


def level_from_body(attitude: AttitudeAngles) -> Array:
    """Components along (north, west, up) from those along (forward, port, up).

    Rz(-yaw) Ry(-pitch) Rx(roll) of active right-handed rotations; an active one is the passive one of minus the angle.
    Its third row is the vertical of ``imu.levelling.up_acceleration``.
    """
    return from_euler(-attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)


def attitude_of(level_from_frame: Array) -> AttitudeAngles:
    """The attitude whose ``level_from_body`` is the given matrix (3, 3); pitch in [-pi/2, pi/2]."""
    x, y, z = to_euler(level_from_frame)
    return AttitudeAngles(-x, y, z % (2.0 * pi))


def crane_base_attitude(midships: AttitudeAngles, local_from_midships: Array) -> AttitudeAngles:
    """AttitudeAngles of the crane base: midships attitude composed with the deformation C (3, 3).

    level_from_local = level_from_midships C'.
    """
    return attitude_of(level_from_body(midships).dot(local_from_midships.T))
