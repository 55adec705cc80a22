"""Oracle: the beam, turned by scipy's rotations, ends where the target is."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from heaved.simulate.gauge import AT_THE_IMU, Gauge, gauge_at
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import measure
from heaved.simulate.vessel import Motion

angles = st.floats(-0.5, 0.5)
metres = st.floats(-20.0, 20.0)
lean = st.floats(-0.2, 0.2)


def motion_at(**values: float) -> Motion[float]:
    return Motion(**(dict.fromkeys(Motion.__struct_fields__, 0.0) | values))


@given(
    roll=angles, pitch=angles, heave=st.floats(-3, 3), at=st.tuples(metres, metres, metres), ahead=lean, across=lean,
    down=st.sampled_from([-1.0, 1.0]),
)  # fmt: skip
def test_a_beam_from_the_vessel_ends_on_the_level_target(
    roll: float, pitch: float, heave: float, at: tuple[float, float, float], ahead: float, across: float, down: float
) -> None:
    gauge = Gauge(at_m=at, beam=(ahead, across, down), distance_m=40.0)
    distance = gauge.read(motion_at(roll_rad=roll, pitch_rad=pitch, heave_m=heave))
    ship = Rotation.from_euler("YX", [-pitch, roll])  # bow up is against the right hand
    beam = np.array([ahead, across, down])
    end = ship.apply(at) + distance * ship.apply(beam / np.linalg.norm(beam))
    assert heave + end[2] == pytest.approx(at[2] + down * 40.0, abs=1e-9)


@given(roll=angles, pitch=angles, heave=st.floats(-3, 3), at=st.tuples(metres, metres, metres))
def test_a_beam_from_something_fixed_ends_on_the_deck(
    roll: float, pitch: float, heave: float, at: tuple[float, float, float]
) -> None:
    gauge = Gauge(at_m=at, distance_m=60.0, is_fixed=True)
    distance = gauge.read(motion_at(roll_rad=roll, pitch_rad=pitch, heave_m=heave))
    end = np.array([at[0], at[1], at[2] + 60.0 - distance - heave])  # from the IMU, in level axes
    on_board = Rotation.from_euler("YX", [-pitch, roll]).inv().apply(end)
    assert on_board[2] == pytest.approx(at[2], abs=1e-9)  # the deck is level in the axes of the vessel


def test_signs_of_readings() -> None:
    up = motion_at(heave_m=1.0)
    assert AT_THE_IMU.read(up) == pytest.approx(13.0)
    for gauge, sign in (
        (AT_THE_IMU, 1),
        (Gauge(beam=(0.0, 0.0, 1.0)), -1),
        (Gauge(is_fixed=True), -1),
        (Gauge(beam=(0.0, 0.0, 1.0), is_fixed=True), 1),
    ):
        assert gauge.sign == sign
        assert gauge.read(up) == pytest.approx(12.0 + sign)
    assert Gauge(at_m=(8.0, 0.0, 0.0)).read(motion_at(pitch_rad=0.1)) > 12.79  # bow up
    assert Gauge(at_m=(0.0, 8.0, 0.0)).read(motion_at(roll_rad=0.1)) > 12.79  # port up


def test_a_beam_that_meets_nothing_reads_nothing() -> None:
    gauge = Gauge(beam=(1.0, 0.0, -0.2))
    assert math.isnan(gauge.read(motion_at(pitch_rad=0.5)))
    moving = seaway("S4").motion(np.arange(100) / 10.0)
    assert np.isnan(measure(moving, imu_rate_hz=10.0, gauge=Gauge(distance_m=-50.0)).laser_m).all()


def test_a_gauge_in_words() -> None:
    assert gauge_at("8,-1.5,2", "0.1,0,-1") == Gauge(at_m=(8.0, -1.5, 2.0), beam=(0.1, 0.0, -1.0))


@pytest.mark.parametrize(
    ("at", "beam", "why"),
    [
        ("8,0", "0,0,-1", "place of the laser '8,0' is not understood"),
        ("8,0,up", "0,0,-1", "place of the laser"),
        ("8,0,nan", "0,0,-1", "place of the laser"),
        ("8,0,2", "1,0,0", "must point down or up"),
        ("8,0,2", "0,0,0", "must point down or up"),
        ("8,0,2", "down", "direction of the laser's beam 'down' is not understood"),
    ],
)
def test_words_that_are_no_gauge(at: str, beam: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        gauge_at(at, beam)
