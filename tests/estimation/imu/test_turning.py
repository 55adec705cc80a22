"""Angles that do not turn as the body rates do. Oracle: the motion that angles and rates are made of."""

from __future__ import annotations

from math import nan, radians

import numpy as np
import pytest

from heaved.estimation.imu.turning import TurnCheck
from heaved.samples import ImuSample

FROM_S, UNTIL_S, END_S = 90.0, 100.0, 130.0
Array = np.ndarray


def motion(rate_hz: float, roll_deg: float, pitch_deg: float) -> tuple[Array, Array, Array, Array, Array]:
    """Times, roll and pitch, and their derivatives, of two swells that roll and pitch otherwise."""
    t = np.arange(0.0, END_S, 1.0 / rate_hz)
    parts = []
    for deg, hz in ((roll_deg, (0.09, 0.13)), (pitch_deg, (0.12, 0.16))):
        w = 2.0 * np.pi * np.array(hz)
        parts.append((radians(deg) * np.sin(np.outer(t, w)).sum(axis=1), radians(deg) * (np.cos(np.outer(t, w)) @ w)))
    (roll, roll_rate), (pitch, pitch_rate) = parts
    return t, roll, pitch, roll_rate, pitch_rate


def checked(
    rate_hz: float, read: tuple[Array, Array], made: tuple[Array, Array, Array, Array, Array], *, has_rates: bool = True
) -> Array:
    """Which readings of roll and pitch, with noise of 0.02 degrees, are believed; the rates are those of the motion."""
    t, _, _, roll_rate, pitch_rate = made
    rng, check = np.random.default_rng(3), TurnCheck()
    noise = radians(0.02) * rng.standard_normal((len(t), 2))
    believed = []
    for i, t_s in enumerate(t.tolist()):
        roll, pitch = float(read[0][i] + noise[i, 0]), float(read[1][i] + noise[i, 1])
        # At small angles the body rates are those of the angles, pitch turned round.
        gx, gy, gz = (float(roll_rate[i]), -float(pitch_rate[i]), 0.0) if has_rates else (nan, nan, nan)
        sample = ImuSample(t_s=t_s, gx_radps=gx, gy_radps=gy, gz_radps=gz)
        believed.append(check.step(sample, roll, pitch, are_rates_there=has_rates))
    return np.array(believed)


@pytest.mark.parametrize("rate_hz", [10.0, 50.0])
@pytest.mark.parametrize("degrees", [(4.0, 2.0), (1.0, 0.6)])
def test_roll_in_the_place_of_pitch_is_refused_while_it_is_there(rate_hz: float, degrees: tuple[float, float]) -> None:
    made = motion(rate_hz, *degrees)
    t, roll, pitch = made[:3]
    inside = (t >= FROM_S) & (t < UNTIL_S)
    read = np.where(inside, pitch, roll), np.where(inside, roll, pitch)
    believed = checked(rate_hz, read, made)
    assert believed[t < FROM_S].all()
    assert believed[inside].mean() < 0.25
    assert np.all(np.abs(read[0] - roll)[inside & believed] < radians(1.0))
    assert believed[t > UNTIL_S + 6.0].all()


def test_a_solution_that_levels_itself_anew_is_believed_after_half_a_wave() -> None:
    made = motion(20.0, 3.0, 2.0)
    t, roll, pitch = made[:3]
    believed = checked(20.0, (roll + radians(2.0) * (t >= FROM_S), pitch), made)
    assert not believed[(t >= FROM_S) & (t < FROM_S + 3.0)].any()
    assert believed[t > FROM_S + 6.0].all()


def test_without_body_rates_angles_are_not_doubted() -> None:
    made = motion(20.0, 3.0, 2.0)
    assert checked(20.0, (made[2], made[1]), made, has_rates=False).all()


def test_rates_that_have_never_led_from_angle_to_angle_doubt_nothing() -> None:
    made = motion(20.0, 3.0, 2.0)
    t, roll, pitch, roll_rate, pitch_rate = made
    wrong = t, roll, pitch, pitch_rate, -roll_rate
    assert checked(20.0, (roll, pitch), wrong).all()


def test_one_angle_alone_is_as_the_last_two_were() -> None:
    made = motion(20.0, 3.0, 1.5)
    t, roll, pitch, roll_rate, pitch_rate = made
    check, said = TurnCheck(), {}
    for i, t_s in enumerate(t.tolist()):
        sample = ImuSample(t_s=t_s, gx_radps=float(roll_rate[i]), gy_radps=-float(pitch_rate[i]), gz_radps=0.0)
        is_alone = i % 2 == 1
        read = (float(pitch[i]), float(roll[i])) if FROM_S <= t_s < UNTIL_S else (float(roll[i]), float(pitch[i]))
        said[t_s] = check.step(sample, read[0], nan if is_alone else read[1], are_rates_there=True)
    assert all(said[t_s] for t_s in t.tolist() if t_s < FROM_S)
    assert not any(said[t_s] for t_s in t.tolist() if FROM_S + 1.0 < t_s < UNTIL_S)
