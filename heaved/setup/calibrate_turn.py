"""The mounting of a sensor from the verticals that it has seen: one gives its tilt, a second one all of it.

The vertical in the axes of the vessel is known where she lies level, or lists and trims by what her marks say. In
those of the sensor it was measured. One pair leaves open by how much the sensor is turned about the vertical; after the
vessel, or the plate that it is bolted to, was tilted about a known axis by any angle, the way the vertical has moved is
known, too (TRIAD; Black 1964).
"""

from __future__ import annotations

from enum import StrEnum
from math import asin, cos, degrees, hypot, sin
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.devices.mounting import Matrix, Vector, angles_deg, rotation

Array = NDArray[np.float64]

ALIKE_RAD: Final = 0.035
"""Verticals less than 2 degrees apart are too alike,"""
UNKNOWN_RAD: Final = 0.035
"""and so are those that leave the rotation uncertain by more than 2 degrees."""
DOUBTFUL_RAD: Final = 0.0035
"""A standard error of 0.2 degrees is said to be one."""
ROUNDS: Final = 6
TURN: Final = "how far it is turned about the vertical"


class Tilted(StrEnum):
    """What was lifted."""

    BOW_UP = "bow up"
    BOW_DOWN = "bow down"
    PORT_UP = "port up"
    PORT_DOWN = "port down"


class Turned(msgspec.Struct, frozen=True, kw_only=True):
    """How a sensor is mounted."""

    rotation_deg: Vector
    tilt_std_rad: float
    """Standard error of the tilt, about either level axis,"""
    turn_std_rad: float
    """and of the rotation about the vertical; inf: it was not measured."""
    apart_rad: float = 0.0
    """How far the two verticals are apart."""


class TiltError(Exception):
    """Two tilts that do not show how a sensor is turned; the message says why."""


def by_rest(up: Vector, up_std_rad: float, *, z_deg: float, roll_rad: float = 0.0, pitch_rad: float = 0.0) -> Turned:
    """The mounting from one vertical, turned about that of the vessel as ``z_deg`` says.

    Args:
        up: in the axes of the sensor.
        z_deg: as far as is known from elsewhere.
        roll_rad: of the vessel meanwhile, port up,
        pitch_rad: and bow up.
    """
    x, y, z = up
    # Of Rz Ry Rx the last row is (-sin y, cos y sin x, cos y cos x).
    x_deg, y_deg = degrees(float(np.arctan2(y, z))), degrees(asin(min(1.0, max(-1.0, -x))))
    vessel = np.array(rotation(degrees(roll_rad), -degrees(pitch_rad), 0.0))
    found, heading_deg = (0.0, 0.0, 0.0), z_deg
    # Of a vessel with a list, its z is not quite the heading of the sensor in the level frame.
    for _ in range(ROUNDS):
        found = angles_deg(_matrix(vessel.T @ np.array(rotation(x_deg, y_deg, heading_deg))))
        heading_deg += (z_deg - found[2] + 180.0) % 360.0 - 180.0
    return Turned(rotation_deg=found, tilt_std_rad=up_std_rad, turn_std_rad=np.inf)


def by_two(
    first: Vector, second: Vector, std_rad: float, tilted: Tilted, *, roll_rad: float = 0.0, pitch_rad: float = 0.0
) -> Turned:
    """The mounting from a vertical at rest and one after something was lifted.

    ``std_rad``: standard error of either. ``roll_rad`` and ``pitch_rad``: of the vessel at rest.

    Raises:
        TiltError: the two are nearly the same, or tell nothing.
    """
    start = by_rest(first, std_rad, z_deg=0.0, roll_rad=roll_rad, pitch_rad=pitch_rad)
    R = np.array(rotation(*start.rotation_deg))
    up, moved = R @ np.array(first), R @ np.array(second)
    along = float(up @ moved)
    off = moved - along * up
    sine = float(np.linalg.norm(off))
    apart = float(np.arctan2(sine, along))
    if not ALIKE_RAD < apart < np.pi - ALIKE_RAD:
        raise TiltError(
            f"the two tilts are {degrees(apart):.1f} degrees apart: too alike to show {TURN}; lift it by 5 degrees or "
            "more, 10 are better"
        )
    turn_std = hypot(std_rad, std_rad) / sine
    if turn_std > UNKNOWN_RAD:
        raise TiltError(
            f"the two tilts are {degrees(apart):.1f} degrees apart, each known to {degrees(std_rad):.2f}: that leaves "
            f"{TURN} uncertain by {degrees(turn_std):.1f} degrees; lift it further, or make longer records"
        )
    # Axes of the plane across the vertical: the vessel's bow as seen in it, and what is to port of that.
    bow = np.array((1.0, 0.0, 0.0)) - up[0] * up
    bow /= np.linalg.norm(bow)
    port = np.cross(up, bow)
    if tilted in (Tilted.BOW_UP, Tilted.BOW_DOWN):
        # Roll stays: the vertical goes where its y and z keep their ratio.
        athwart = np.array((0.0, cos(roll_rad), -sin(roll_rad)))
        way = np.cross(athwart, up) * (1.0 if tilted is Tilted.BOW_UP else -1.0)
    else:
        # Pitch stays: x of the vertical does.
        share = up[0] * (1.0 - along) / (sine * float(bow[0]))
        side = np.sqrt(max(1.0 - share * share, 0.0)) * (1.0 if tilted is Tilted.PORT_UP else -1.0)
        way = share * bow + side * port
    now, wanted = (np.arctan2(float(v @ port), float(v @ bow)) for v in (off, way))
    turn = _about(up, float(wanted - now))
    return Turned(
        rotation_deg=angles_deg(_matrix(turn @ R)), tilt_std_rad=std_rad, turn_std_rad=turn_std, apart_rad=apart
    )


def apart_rad(first: Vector, second: Vector) -> float:
    """Angle between two mountings, ``rotation_deg`` of each."""
    turn = np.array(rotation(*first)).T @ np.array(rotation(*second))
    sine = np.linalg.norm((turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]))
    return float(np.arctan2(sine, np.trace(turn) - 1.0))


def _about(axis: Array, angle_rad: float) -> Array:
    x, y, z = axis.tolist()
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + sin(angle_rad) * K + (1.0 - cos(angle_rad)) * K @ K)


def _matrix(found: Array) -> Matrix:
    first, second, third = ((row[0], row[1], row[2]) for row in found.tolist())
    return first, second, third
