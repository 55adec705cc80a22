"""Monitoring points against a rotation by matrices and a numerical derivative."""

from math import cos, nan, sin

import numpy as np
import pytest

from heaved.estimation.lever_arm import AttitudeMotion, Point, motion


def up_of(point: Point, roll: float, pitch: float) -> float:
    """Height of the point over the IMU: roll about x (port side up), then pitch (bow up: minus the right-hand rotation
    about y), on the body vector.
    """
    about_x = np.array([[1, 0, 0], [0, cos(roll), -sin(roll)], [0, sin(roll), cos(roll)]])
    about_y = np.array([[cos(pitch), 0, -sin(pitch)], [0, 1, 0], [sin(pitch), 0, cos(pitch)]])
    return float((about_y @ about_x @ np.array([point.forward_m, point.port_m, point.up_m]))[2])


@pytest.mark.parametrize("seed", range(5))
def test_heave_is_what_the_rotation_gives_and_velocity_its_derivative(seed: int) -> None:
    rng = np.random.default_rng(seed)
    point = Point(name="tip", **dict(zip(("forward_m", "port_m", "up_m"), rng.uniform(-60, 60, 3), strict=True)))
    roll, pitch = rng.uniform(-0.5, 0.5, 2)
    roll_rate, pitch_rate = rng.uniform(-0.2, 0.2, 2)
    heave, velocity = rng.uniform(-3, 3, 2)
    found = motion(point, heave, velocity, AttitudeMotion(roll, pitch, roll_rate, pitch_rate))
    assert found.heave_m == pytest.approx(heave + up_of(point, roll, pitch) - point.up_m, abs=1e-9)
    h = 1e-5
    ahead, behind = (up_of(point, roll + s * h * roll_rate, pitch + s * h * pitch_rate) for s in (1, -1))
    assert found.heave_velocity_mps == pytest.approx(velocity + (ahead - behind) / (2 * h), abs=1e-6)


def test_signs_are_those_that_people_use() -> None:
    """Port side up lifts a point to port, bow up one forward; the IMU itself moves with the heave alone."""
    roll, pitch = AttitudeMotion(0.1, 0.0, 0.0, 0.0), AttitudeMotion(0.0, 0.1, 0.0, 0.0)
    assert motion(Point(name="a", port_m=10.0), 0.0, 0.0, roll).heave_m == pytest.approx(10.0 * sin(0.1))
    assert motion(Point(name="b", forward_m=10.0), 0.0, 0.0, pitch).heave_m == pytest.approx(10.0 * sin(0.1))
    assert motion(Point(name="c"), 1.5, 0.5, AttitudeMotion(0.3, -0.2, 1.0, 1.0)).heave_m == pytest.approx(1.5)


def test_without_attitude_or_heave_there_is_no_number() -> None:
    point = Point(name="tip", forward_m=10.0)
    assert np.isnan(motion(point, 1.0, 1.0, AttitudeMotion(nan, 0.0, 0.0, 0.0)).heave_m)
    assert np.isnan(motion(point, nan, nan, AttitudeMotion(0.0, 0.0, 0.0, 0.0)).heave_m)


@pytest.mark.parametrize("seed", range(3))
def test_the_deviation_is_that_of_heave_and_of_angles_through_the_lever_arm(seed: int) -> None:
    """Against the spread of many draws."""
    rng = np.random.default_rng(seed)
    point = Point(name="tip", forward_m=40.0, port_m=-10.0, up_m=25.0)
    roll, pitch = rng.uniform(-0.2, 0.2, 2)
    found = motion(point, 1.0, 0.0, AttitudeMotion(roll, pitch, 0.0, 0.0, 0.002, 0.001), 0.03)
    drawn = [
        motion(point, 1.0 + h, 0.0, AttitudeMotion(roll + r, pitch + p, 0.0, 0.0)).heave_m
        for h, r, p in rng.normal(0.0, (0.03, 0.002, 0.001), (4000, 3)).tolist()
    ]
    assert found.heave_std_m == pytest.approx(np.std(drawn), rel=0.05)
    at_the_imu = motion(Point(name="imu"), 1.0, 0.0, AttitudeMotion(roll, pitch, 0.0, 0.0), 0.03)
    assert at_the_imu.heave_std_m == pytest.approx(0.03)
    assert np.isnan(motion(point, 1.0, 0.0, AttitudeMotion(roll, pitch, 0.0, 0.0), 0.03).heave_std_m)
