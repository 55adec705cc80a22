"""Angles between their readings. Oracle: the motion that the readings are made of."""

from __future__ import annotations

from math import cos, degrees, isnan, nan, pi, radians, sin

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from heaved.estimation.imu.attitude import TUNING, Attitude, AttitudePropagator, up_acceleration
from heaved.samples import GRAVITY_MPS2, ImuSample, RockPrediction

RATE_HZ = 20.0
OMEGA = 2.0 * pi / 8.0
UNKNOWN = tuple(RockPrediction(horizon_s=h) for h in (0.05, 0.10, 0.15))


def roll_rad(t_s: float) -> float:
    return radians(8.0) * sin(OMEGA * t_s)


def roll_rate_radps(t_s: float) -> float:
    return radians(8.0) * OMEGA * cos(OMEGA * t_s)


def seen(t_s: float) -> Attitude:
    return Attitude(t_s, roll_rad(t_s), 0.0, nan, roll_rate_radps(t_s), 0.0, measured_s=t_s)


def foreseen(t_s: float, std_rad: float) -> tuple[RockPrediction, ...]:
    return tuple(
        RockPrediction(horizon_s=h, roll_rad=roll_rad(t_s + h), pitch_rad=0.0, roll_std_rad=std_rad, pitch_std_rad=0.0)
        for h in (0.05, 0.10, 0.15)
    )


def carried(every: int, gain: float = 1.0, std_rad: float = nan, gone_from_s: float = 1e9) -> list[tuple[float, float]]:
    """Age of the last reading and how far off the angle is, degrees, of each sample of the second half of a minute;
    readings in every n-th sample, none from some time on; body rates are off by a factor ``gain`` (nan: there are
    none), predictions are good to ``std_rad`` (nan: there are none).
    """
    one, found = AttitudePropagator(), []
    for k in range(int(60.0 * RATE_HZ)):
        t_s = k / RATE_HZ
        sample = ImuSample(t_s=t_s, gx_radps=gain * roll_rate_radps(t_s), gy_radps=0.0 * gain, gz_radps=0.0 * gain)
        is_read = k % every == 0 and t_s < gone_from_s
        one.step(sample, seen(t_s) if is_read else None, UNKNOWN if isnan(std_rad) else foreseen(t_s, std_rad))
        if t_s >= 30.0 and one.latest.t_s == t_s:
            found.append((t_s - one.latest.measured_s, degrees(one.latest.roll_rad - roll_rad(t_s))))
    return found


@pytest.mark.parametrize("every", [2, 5, 10, 30])
def test_body_rates_lead_from_reading_to_reading(every: int) -> None:
    found = carried(every)
    assert len(found) == 600
    assert max(abs(off) for _, off in found) < 0.05


@pytest.mark.parametrize("gain", [-1.0, 57.3, 1.0 / 57.3, nan], ids=["sign", "degrees", "radians twice", "none"])
def test_rates_that_do_not_agree_with_the_angles_are_not_believed(gain: float) -> None:
    assert len(carried(10, gain)) == 60  # the readings alone
    found = carried(10, gain, std_rad=radians(0.1))
    assert len(found) == 600
    assert max(abs(off) for _, off in found) < 0.002  # On a line back it would be 0.012, always towards the mean.


def test_what_is_not_known_well_does_not_serve() -> None:
    assert len(carried(10, nan, std_rad=radians(0.4))) == 60


@pytest.mark.parametrize("gain", [1.0, nan])
def test_nothing_is_carried_for_ever(gain: float) -> None:
    ages = [age for age, _ in carried(1, gain, std_rad=radians(0.1), gone_from_s=40.0)]
    assert max(ages) == pytest.approx(TUNING.longest_s, abs=0.06)


def test_a_line_serves_as_long_as_the_motion_is_straight() -> None:
    one = AttitudePropagator()
    for k in range(400):
        one.step(ImuSample(t_s=k / RATE_HZ), seen(k / RATE_HZ), UNKNOWN)
    # RMS of half of the angular acceleration: 8 degrees times OMEGA squared over two and the root of two.
    expected_s = (0.25 / (8.0 * OMEGA**2 / 2.0 / 2.0**0.5)) ** 0.5
    assert one.serves(one.latest.t_s + 0.85 * expected_s)
    assert not one.serves(one.latest.t_s + 1.15 * expected_s)


# ---- body axes -------------------------------------------------------------------------------------------------------


def body_force(level: np.ndarray, roll: float, pitch: float) -> np.ndarray:
    """Oracle: scipy's rotations. Right-handed about x (port up) and, bow up being positive, minus about y (port)."""
    level_from_body = Rotation.from_euler("ZYX", [0.3, -pitch, roll])
    return level_from_body.inv().apply(Rotation.from_euler("Z", 0.3).apply(level))


@pytest.mark.parametrize("roll", [-1.2, -0.05, 0.0, 0.4, 3.0])
@pytest.mark.parametrize("pitch", [-1.5, -0.1, 0.0, 0.02, 1.1])
def test_vanishes_at_rest_for_any_attitude(roll: float, pitch: float) -> None:
    f = body_force(np.array([0.0, 0.0, GRAVITY_MPS2]), roll, pitch)
    assert up_acceleration(f[0], f[1], f[2], roll, pitch) == pytest.approx(0.0, abs=1e-12)


def test_gives_the_vertical_part_of_any_motion() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        level = rng.normal(0.0, 3.0, 3)
        roll, pitch = rng.uniform(-1.0, 1.0, 2)
        f = body_force(level + np.array([0.0, 0.0, GRAVITY_MPS2]), roll, pitch)
        assert up_acceleration(f[0], f[1], f[2], roll, pitch) == pytest.approx(level[2], abs=1e-12)


def test_signs_at_small_angles() -> None:
    # Bow up: gravity's reaction has a part along +x (forward). Port up: along +y (port).
    assert body_force(np.array([0.0, 0.0, 9.8]), 0.0, 0.1)[0] > 0.9
    assert body_force(np.array([0.0, 0.0, 9.8]), 0.1, 0.0)[1] > 0.9
