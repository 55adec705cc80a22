"""Monitoring points: heave of a crane tip or a moonpool from that of the IMU, the attitude and the lever arm."""

from __future__ import annotations

from math import cos, sin
from typing import Annotated

import msgspec

from heaved.samples import PointMotion


class Point(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[[point]]``: a place on the vessel, from the IMU, in metres."""

    name: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_.-]{1,32}\Z")]
    forward_m: float = 0.0
    port_m: float = 0.0
    up_m: float = 0.0


class Attitude(msgspec.Struct, frozen=True, gc=False):
    """Roll (port side up), pitch (bow up) and their rates, rad and rad/s."""

    roll_rad: float
    pitch_rad: float
    roll_rate_radps: float
    pitch_rate_radps: float


def motion(point: Point, heave_m: float, velocity_mps: float, attitude: Attitude) -> PointMotion:
    """Heave and its velocity at ``point``; nan where heave or attitude is.

    h + sin(pitch) x + sin(roll) cos(pitch) y + (cos(roll) cos(pitch) - 1) z, and its derivative: the third row of the
    rotation from body to level axes, as for the acceleration.
    """
    sr, cr = sin(attitude.roll_rad), cos(attitude.roll_rad)
    sp, cp = sin(attitude.pitch_rad), cos(attitude.pitch_rad)
    x, y, z = point.forward_m, point.port_m, point.up_m
    lever_m = sp * x + sr * cp * y + (cr * cp - 1.0) * z
    by_roll, by_pitch = cr * cp * y - sr * cp * z, cp * x - sr * sp * y - cr * sp * z
    return PointMotion(
        name=point.name,
        heave_m=heave_m + lever_m,
        heave_velocity_mps=velocity_mps + by_roll * attitude.roll_rate_radps + by_pitch * attitude.pitch_rate_radps,
    )
