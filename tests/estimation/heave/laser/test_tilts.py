"""Oracle: angles that run straight, or along a wave."""

from __future__ import annotations

import math

import pytest

from heaved.estimation.heave.laser.tilts import Tilts
from heaved.estimation.imu.attitude import Attitude
from heaved.estimation.imu.attitude_error import Lean


def filled(rate_hz: float = 20.0, lean: Lean | None = None, late_s: float = 0.0) -> Tilts:
    """Ten seconds of a roll of 0.1 rad/s and a pitch of -0.05 rad/s, shown late."""
    tilts = Tilts(1000)
    for i in range(round(10.0 * rate_hz) + 1):
        t = i / rate_hz
        shown = t - late_s
        tilts.push(
            Attitude(t_s=t, roll_rad=0.1 * shown, pitch_rad=-0.05 * shown, roll_rate_radps=0.1, pitch_rate_radps=-0.05),
            lean or Lean(),
            late_s,
        )
    return tilts


@pytest.mark.parametrize("t_s", [0.0, 3.0, 3.017, 10.0, 10.1])
def test_angles_are_those_of_the_moment(t_s: float) -> None:
    found = filled().at(t_s)
    assert found is not None
    assert found == pytest.approx((0.1 * t_s, -0.05 * t_s))


def test_lean_and_lateness_are_taken_out() -> None:
    tilts = filled(lean=Lean(roll_rad=0.02, pitch_rad=-0.01), late_s=0.08)
    for t_s in (5.0, 9.98):  # the later one on the way beyond the last that was shown
        found = tilts.at(t_s)
        assert found is not None
        assert found == pytest.approx((0.1 * t_s - 0.02, -0.05 * t_s + 0.01))


@pytest.mark.parametrize("t_s", [-0.1, 10.3, math.nan])
def test_nothing_is_known_outside(t_s: float) -> None:
    assert filled().at(t_s) is None


def test_nothing_is_known_in_a_gap() -> None:
    assert filled(rate_hz=1.0).at(4.5) is None
    assert filled(rate_hz=1.0).at(4.0) is not None


def test_an_attitude_that_is_not_known_or_not_new_is_none() -> None:
    tilts = filled()
    tilts.push(Attitude(), Lean(), 0.0)
    tilts.push(Attitude(t_s=9.0, roll_rad=5.0, pitch_rad=5.0), Lean(), 0.0)
    assert tilts.at(10.0) == pytest.approx((1.0, -0.5))
