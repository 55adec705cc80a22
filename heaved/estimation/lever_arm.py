"""Monitoring points: heave of a crane tip or a moonpool from that of the IMU, the attitude and the lever arm.

With the vertical in ship axes u = (sin p, sin r cos p, cos r cos p) and the lever arm q from the IMU, a place stands
u . q over the IMU. Its heave is counted from where it stands on the level ship: h + u . q - e_z . q. An arm may move
against the ship, as that of a crane does: what that adds of itself, on a level ship, is no heave but the place's own
motion, and what is left of it in the heave and its velocity comes of the ship's attitude.
"""

from __future__ import annotations

from math import cos, hypot, nan, sin, sqrt
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.samples import PointMotion

if TYPE_CHECKING:
    from heaved.estimation.crane.estimator import Place

Vector = tuple[float, float, float]
STILL: Vector = (0.0, 0.0, 0.0)


class Point(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[[point]]``: a place on the vessel, in metres.

    frame "hull": from the IMU, along its axes. frame "crane": from the crane base, along the axes of the IMU there.
    frame "boom": from the tip of the moving crane, "hook": from its hook, both of ``[crane]``: outward (where the boom
    points), to the left of that, up.
    """

    name: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_.-]{1,32}\Z")]
    forward_m: float = 0.0
    port_m: float = 0.0
    up_m: float = 0.0
    frame: Literal["hull", "crane", "boom", "hook"] = "hull"

    @property
    def rides(self) -> bool:
        """Whether it is on what the crane moves."""
        return self.frame in ("boom", "hook")


class Crane(msgspec.Struct, frozen=True, eq=False, gc=False):
    """Where the crane base is and how it stands."""

    base_m: tuple[float, float, float]
    """From the IMU amidships, along its axes."""
    local_from_midships: NDArray[np.float64]
    """(3, 3) total."""
    static: NDArray[np.float64]
    """(3, 3) without the flexure."""


class AttitudeMotion(msgspec.Struct, frozen=True, gc=False):
    """Roll (port side up), pitch (bow up), their rates and accelerations; rad, rad/s, rad/s2."""

    roll_rad: float
    pitch_rad: float
    roll_rate_radps: float
    pitch_rate_radps: float
    roll_std_rad: float = nan
    pitch_std_rad: float = nan
    roll_acceleration_radps2: float = nan
    pitch_acceleration_radps2: float = nan
    late_std_s: float = 0.0
    """How well the moment is known at which both angles were so."""


class Arm(msgspec.Struct, frozen=True, gc=False):
    """Lever arm of one moment, metres along the axes of the IMU amidships."""

    at_m: Vector
    own_height_m: float
    """Height of the place over the IMU on the level ship, in its static shape."""
    raised_m: float = 0.0
    """What the bending of the hull adds to that."""
    velocity_mps: Vector = STILL
    own_velocity_mps: float = 0.0
    raised_velocity_mps: float = 0.0
    spread_m: tuple[tuple[Vector, float], ...] = ()
    """One standard deviation of each thing that it hangs on, and its own of ``raised_m``."""


# --- arms -------------------------------------------------------------------------------------------------------------


def fixed_arm(point: Point) -> Arm:
    """Of a point that is fixed to the hull."""
    return Arm((point.forward_m, point.port_m, point.up_m), point.up_m)


def crane_base_arm(point: Point, crane: Crane) -> Arm:
    """Of a point that is fixed to the crane base.

    Up to the base the lever arm b is the hull's, beyond it r has the attitude of the crane base. With C local from
    midships that is b + C' r: it changes with the deformation. Heave is counted from the level ship in its static shape
    C0, where the point stands e_z . (b + C0' r) high; what is left of C is the flexure. The rate of the flexure,
    arcseconds a second, is not in the velocity.
    """
    at_m, raised_m = _through(crane, (point.forward_m, point.port_m, point.up_m))
    x, y, z = crane.base_m
    at = (x + at_m[0], y + at_m[1], z + at_m[2])
    return Arm(at, at[2] - raised_m, raised_m)


def moving_arm(place: Place, crane: Crane | None) -> Arm:
    """Of a place on the moving crane, whose geometry is given from the IMU, or (``crane``) from the crane base.

    What hangs plumb below a place is lower by as much whatever the attitude: it has the heave of that place.
    """
    at, velocity, spread_m = place.at_m, place.velocity_mps, place.spread_m
    raised_m = raised_velocity = 0.0
    spread = tuple([(way, 0.0) for way in spread_m])
    if crane is not None:
        (rx, ry, rz), raised_m = _through(crane, at)
        x, y, z = crane.base_m
        at = (x + rx, y + ry, z + rz)
        velocity, raised_velocity = _through(crane, velocity)
        spread = tuple([_through(crane, way) for way in spread_m])
    return Arm(
        at,
        at[2] - raised_m - place.hang_m,
        raised_m,
        velocity,
        velocity[2] - raised_velocity - place.hang_velocity_mps,
        raised_velocity,
        spread,
    )


def _through(crane: Crane, local: Vector) -> tuple[Vector, float]:
    """A vector at the crane base in midships axes, and by how much the flexure has raised its end."""
    arm = np.array(local)
    turned = crane.local_from_midships.T.dot(arm)
    x, y, z = turned.tolist()
    return (x, y, z), float(turned[2] - crane.static.T.dot(arm)[2])


# --- motions ----------------------------------------------------------------------------------------------------------


def motion(
    point: Point, heave_m: float, velocity_mps: float, attitude: AttitudeMotion, heave_std_m: float = nan
) -> PointMotion:
    """Heave, its standard deviation and its velocity at a point of the hull; see :func:`arm_motion`."""
    return arm_motion(point.name, fixed_arm(point), heave_m, velocity_mps, attitude, heave_std_m)


def arm_motion(
    name: str, arm: Arm, heave_m: float, velocity_mps: float, attitude: AttitudeMotion, heave_std_m: float = nan
) -> PointMotion:
    """Heave, its standard deviation and its velocity at the end of ``arm`` from those of the IMU; nan where one is.

    h + sin(pitch) x + sin(roll) cos(pitch) y + (cos(roll) cos(pitch) - 1) z, and its derivative: the third row of the
    rotation from body to level axes, as for the acceleration. Errors of heave, roll, pitch and the arm are taken as
    independent; what the angles are off by for their moment is not, and goes as their rates of now do.
    """
    sr, cr = sin(attitude.roll_rad), cos(attitude.roll_rad)
    sp, cp = sin(attitude.pitch_rad), cos(attitude.pitch_rad)
    x, y, z = arm.at_m
    lever_m = sp * x + sr * cp * y + (cr * cp - 1.0) * z
    by_roll, by_pitch = cr * cp * y - sr * cp * z, cp * x - sr * sp * y - cr * sp * z
    lever_mps = by_roll * attitude.roll_rate_radps + by_pitch * attitude.pitch_rate_radps
    std_m = hypot(
        heave_std_m,
        _by(by_roll, attitude.roll_std_rad),
        _by(by_pitch, attitude.pitch_std_rad),
        _by(attitude.late_std_s, lever_mps),
    )
    if arm.spread_m:
        std_m = sqrt(std_m * std_m + _spread_variance(arm, sp, sr * cp, cr * cp - 1.0))
    if arm.velocity_mps is not STILL:
        vx, vy, vz = arm.velocity_mps
        lever_mps += sp * vx + sr * cp * vy + (cr * cp - 1.0) * vz + arm.raised_velocity_mps
    return PointMotion(
        name=name,
        heave_m=heave_m + lever_m + arm.raised_m,
        heave_std_m=std_m,
        heave_velocity_mps=velocity_mps + lever_mps,
        own_height_m=arm.own_height_m,
        own_velocity_mps=arm.own_velocity_mps,
    )


def lever_acceleration(arm: Arm, attitude: AttitudeMotion) -> float:
    """What the lever adds to the acceleration of the heave, m/s2: the second derivative of u . q, that of the arm
    itself left out, of which encoders say nothing. (Against a tilt of 0.1 it is a tenth of what the crane accelerates.)
    """
    sr, cr = sin(attitude.roll_rad), cos(attitude.roll_rad)
    sp, cp = sin(attitude.pitch_rad), cos(attitude.pitch_rad)
    x, y, z = arm.at_m
    roll_rate, pitch_rate = attitude.roll_rate_radps, attitude.pitch_rate_radps
    across = sr * y + cr * z
    by_roll, by_pitch = cp * (cr * y - sr * z), cp * x - sp * across
    acceleration = by_roll * attitude.roll_acceleration_radps2 + by_pitch * attitude.pitch_acceleration_radps2
    acceleration -= roll_rate * roll_rate * cp * across + pitch_rate * pitch_rate * (sp * x + cp * across)
    acceleration -= 2.0 * roll_rate * pitch_rate * sp * (cr * y - sr * z)
    if arm.velocity_mps is not STILL:
        vx, vy, vz = arm.velocity_mps
        v_roll, v_pitch = cp * (cr * vy - sr * vz), cp * vx - sp * (sr * vy + cr * vz)
        acceleration += 2.0 * (v_roll * roll_rate + v_pitch * pitch_rate)
    return acceleration


def _spread_variance(arm: Arm, x: float, y: float, z: float) -> float:
    """Of the heave, from that of the arm, with the vertical less that of the level ship."""
    found = 0.0
    for (dx, dy, dz), raised_m in arm.spread_m:
        lifted_m = x * dx + y * dy + z * dz + raised_m
        found += lifted_m * lifted_m
    return found


def _by(lever_m: float, std_rad: float) -> float:
    """What an angle that is known to ``std_rad`` contributes; without a lever arm nothing, known or not."""
    return lever_m * std_rad if lever_m != 0.0 else 0.0
