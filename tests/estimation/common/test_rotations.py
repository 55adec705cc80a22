"""Rotations against scipy's and against what a crane base on a level ship must read."""

from __future__ import annotations

from math import pi, radians

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from heaved.estimation.common.rotations import (
    AttitudeAngles,
    attitude_of,
    crane_base_attitude,
    cross_matrix,
    from_euler,
    level_from_body,
    passive,
    rotation_vector,
    to_euler,
)
from heaved.estimation.imu.attitude import up_acceleration
from heaved.samples import GRAVITY_MPS2

angles = st.floats(-3.0, 3.0)
tilts = st.floats(-1.5, 1.5)


@settings(max_examples=60)
@given(angles, angles, angles)
def test_a_passive_rotation_is_the_exponential_of_minus_the_cross_product(x: float, y: float, z: float) -> None:
    r = np.array([x, y, z])
    assert passive(r) == pytest.approx(expm(-cross_matrix(r)), abs=1e-12)
    assert cross_matrix(r) @ np.array([1.0, -2.0, 0.5]) == pytest.approx(np.cross(r, [1.0, -2.0, 0.5]), abs=1e-12)


@settings(max_examples=60)
@given(angles, angles, angles)
def test_rotation_vector_is_that_of_scipy(x: float, y: float, z: float) -> None:
    C = passive(np.array([x, y, z]))
    expected = -Rotation.from_matrix(C).as_rotvec()
    found = rotation_vector(C)
    if np.linalg.norm(expected) < pi - 1e-3:  # at half a turn either sign is right
        assert found == pytest.approx(expected, abs=1e-9)
    assert passive(found) == pytest.approx(C, abs=1e-9)


@pytest.mark.parametrize("size", [1e-12, 1e-6, 9e-5, 1.1e-4, 1.0, pi - 1e-9, pi])
def test_rotation_vector_at_its_seams(size: float) -> None:
    for axis in (np.eye(3)[0], np.eye(3)[2], np.array([2.0, -1.0, 2.0]) / 3.0):
        C = np.asarray(Rotation.from_rotvec(-size * axis).as_matrix())
        found = rotation_vector(C)
        assert np.linalg.norm(found) == pytest.approx(size, rel=1e-6)
        assert passive(found) == pytest.approx(C, abs=1e-8)


@settings(max_examples=60)
@given(angles, tilts, angles)
def test_euler_angles_are_r3_r2_r1(x: float, y: float, z: float) -> None:
    R1, R2, R3 = (passive(a * e) for a, e in zip((x, y, z), np.eye(3), strict=True))
    C = from_euler(x, y, z)
    assert np.max(np.abs(C - R3 @ R2 @ R1)) < 1e-12
    assert to_euler(C) == pytest.approx((x, y, z), abs=1e-7)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_at_ninety_degrees_the_angles_give_the_matrix_back(sign: float) -> None:
    C = from_euler(0.3, sign * pi / 2, -0.8)
    x, y, z = to_euler(C)
    assert x == 0.0
    assert from_euler(x, y, z) == pytest.approx(C, abs=1e-9)


@settings(max_examples=60)
@given(tilts, tilts, st.floats(0.0, 6.2))
def test_attitudes_agree_with_the_vertical_of_the_heave_chain(roll: float, pitch: float, yaw: float) -> None:
    """``up_acceleration`` is the third row of level_from_body applied to the specific force, less gravity."""
    attitude = AttitudeAngles(roll, pitch, yaw)
    force = np.array([0.3, -1.1, 9.0])
    up = level_from_body(attitude)[2] @ force - GRAVITY_MPS2
    assert up == pytest.approx(up_acceleration(force[0], force[1], force[2], roll, pitch), abs=1e-12)
    back = attitude_of(level_from_body(attitude))
    assert (back.roll_rad, back.pitch_rad) == pytest.approx((roll, pitch), abs=1e-7)
    assert (back.yaw_rad - yaw + 1.0) % (2 * pi) == pytest.approx(1.0, abs=1e-7)


@pytest.mark.parametrize(
    ("deformation_deg", "expected_deg"),
    [
        ((1.0, 0.0, 0.0), (1.0, 0.0, 50.0)),  # right-handed about x lifts the port side: roll +
        ((0.0, 1.0, 0.0), (0.0, -1.0, 50.0)),  # right-handed about y (port) lowers the bow: pitch -
        ((0.0, 0.0, 1.0), (0.0, 0.0, 49.0)),  # right-handed about z turns to port: yaw -
    ],
)
def test_signs_of_the_crane_base_on_a_level_ship(
    deformation_deg: tuple[float, float, float], expected_deg: tuple[float, float, float]
) -> None:
    C = from_euler(*(radians(a) for a in deformation_deg))
    crane = crane_base_attitude(AttitudeAngles(0.0, 0.0, radians(50.0)), C)
    found = np.degrees([crane.roll_rad, crane.pitch_rad, crane.yaw_rad])
    assert found == pytest.approx(expected_deg, abs=1e-9)


def test_the_vertical_seen_from_the_crane_base_is_the_vertical() -> None:
    """A plumb line in midships axes, carried over by C, is the plumb line of the composed attitude."""
    midships, C = AttitudeAngles(0.1, -0.2, 1.0), from_euler(0.02, -0.03, 0.6)
    plumb = level_from_body(midships)[2]
    assert level_from_body(crane_base_attitude(midships, C))[2] == pytest.approx(C @ plumb, abs=1e-12)
