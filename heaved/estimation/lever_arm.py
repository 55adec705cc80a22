"""Monitoring points: heave of a crane tip or a moonpool from that of the IMU, the attitude and the lever arm."""

from __future__ import annotations

from math import cos, hypot, nan, sin
from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.samples import PointMotion


class Point(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[[point]]``: a place on the vessel, in metres.

    frame "hull": from the IMU, along its axes. frame "crane": from the crane base, along the axes of the IMU there.
    """

    name: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_.-]{1,32}\Z")]
    forward_m: float = 0.0
    port_m: float = 0.0
    up_m: float = 0.0
    frame: Literal["hull", "crane"] = "hull"


class Crane(msgspec.Struct, frozen=True, eq=False, gc=False):
    """Where the crane base is and how it stands."""

    base_m: tuple[float, float, float]
    """From the IMU amidships, along its axes."""
    local_from_midships: NDArray[np.float64]
    """(3, 3) total."""
    static: NDArray[np.float64]
    """(3, 3) without the flexure."""


class AttitudeMotion(msgspec.Struct, frozen=True, gc=False):
    """Roll (port side up), pitch (bow up) and their rates, rad and rad/s."""

    roll_rad: float
    pitch_rad: float
    roll_rate_radps: float
    pitch_rate_radps: float
    roll_std_rad: float = nan
    pitch_std_rad: float = nan


def motion(
    point: Point, heave_m: float, velocity_mps: float, attitude: AttitudeMotion, heave_std_m: float = nan
) -> PointMotion:
    """Heave, its standard deviation and its velocity at ``point`` from those of the IMU; nan where one of them is.

    h + sin(pitch) x + sin(roll) cos(pitch) y + (cos(roll) cos(pitch) - 1) z, and its derivative: the third row of the
    rotation from body to level axes, as for the acceleration. Errors of heave, roll and pitch are taken as independent.
    """
    sr, cr = sin(attitude.roll_rad), cos(attitude.roll_rad)
    sp, cp = sin(attitude.pitch_rad), cos(attitude.pitch_rad)
    x, y, z = point.forward_m, point.port_m, point.up_m
    lever_m = sp * x + sr * cp * y + (cr * cp - 1.0) * z
    by_roll, by_pitch = cr * cp * y - sr * cp * z, cp * x - sr * sp * y - cr * sp * z
    return PointMotion(
        name=point.name,
        heave_m=heave_m + lever_m,
        heave_std_m=hypot(heave_std_m, _by(by_roll, attitude.roll_std_rad), _by(by_pitch, attitude.pitch_std_rad)),
        heave_velocity_mps=velocity_mps + by_roll * attitude.roll_rate_radps + by_pitch * attitude.pitch_rate_radps,
    )


def _by(lever_m: float, std_rad: float) -> float:
    """What an angle that is known to ``std_rad`` contributes; without a lever arm nothing, known or not."""
    return lever_m * std_rad if lever_m != 0.0 else 0.0


def crane_motion(
    point: Point,
    heave_m: float,
    velocity_mps: float,
    attitude: AttitudeMotion,
    crane: Crane | None,
    heave_std_m: float = nan,
) -> PointMotion:
    """Motion of a point that is fixed to the crane base; nan while it is not known how that stands (``crane`` None).

    Up to the base the lever arm b is the hull's, beyond it r has the attitude of the crane base. With C local from
    midships and u the vertical in midships axes, that is u . (b + C' r): a lever arm of the hull that changes with the
    deformation. Heave is counted from the level ship in its static shape C0, so e_z . (b + C0' r) is taken off; what
    is left of C is the flexure. The rate of the flexure, arcseconds a second, is not in the velocity.
    """
    if crane is None:
        return PointMotion(name=point.name)
    arm = np.array([point.forward_m, point.port_m, point.up_m])
    lever = crane.local_from_midships.T.dot(arm)
    raised_m = float(lever[2] - crane.static.T.dot(arm)[2])
    x, y, z = (lever + crane.base_m).tolist()
    rigid = Point(name=point.name, forward_m=x, port_m=y, up_m=z)
    moved = motion(rigid, heave_m, velocity_mps, attitude, heave_std_m)
    return msgspec.structs.replace(moved, heave_m=moved.heave_m + raised_m)
