"""Axes of the accelerometers out of readings of a laser, against IMUs whose faults are known because we made them."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest

from heaved.estimation.heave.laser.axes import TUNING, AxisErrors, SavedAxes
from heaved.estimation.heave.laser.geometry import Geometry
from heaved.estimation.heave.laser.tilts import Tilt
from heaved.estimation.imu.attitude import up_acceleration
from heaved.estimation.imu.leaks import leaks_mps2
from heaved.estimation.imu.vertical import VerticalAcceleration
from heaved.simulate.gauge import AT_THE_IMU, Gauge
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import SENSORS, ImuModel, Recording, record
from heaved.simulate.wrong_physics import RIGHT, Wrong, crooked

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from heaved.simulate.vessel import Array

RATE_HZ = 10.0
ASKEW = Wrong(askew_roll_rad=math.radians(2.5), askew_pitch_rad=math.radians(-2.0))
CONFIGURED = Geometry()
UNBIASED = msgspec.structs.replace(SENSORS["A"], bias_mps2=0.0)
"""A bias across the deck shows as a leak of gravity, rightly; before the axes are looked at it has been taken out."""


@cache
def right(gauge: Gauge = AT_THE_IMU, duration_s: float = 200.0, sensor: ImuModel = UNBIASED) -> Recording:
    return record(seaway("S6-bow-0.8", 4), duration_s, imu_rate_hz=RATE_HZ, sensor=sensor, gauge=gauge, seed=7)


def readings(made: Recording) -> Iterator[tuple[VerticalAcceleration, float, Tilt]]:
    columns = (made.t_s, made.ax_mps2, made.ay_mps2, made.az_mps2, made.roll_rad, made.pitch_rad, made.laser_m)
    for t, ax, ay, az, roll, pitch, laser in zip(*(column.tolist() for column in columns), strict=True):
        up = up_acceleration(ax, ay, az, roll, pitch)
        leaks = leaks_mps2(ax, ay, az, roll, pitch)
        yield VerticalAcceleration(t, up, leaks_mps2=leaks), laser, Tilt(roll, pitch)


def shown(made: Recording, axes: AxisErrors | None = None) -> tuple[AxisErrors, list[float]]:
    """What has been found, and what the acceleration was without it."""
    axes = axes or AxisErrors(RATE_HZ, 0.002, enabled=True)
    left = []
    for up, laser, tilt in readings(made):
        left.append(axes.step(up))
        axes.push(up.t_s, laser, tilt, CONFIGURED)
    return axes, left


def test_an_imu_askew_is_found_and_taken_out() -> None:
    axes, left = shown(crooked(right(), ASKEW))
    forward_up, port_up, up_forward, up_port, crossed, more = axes.weights.tolist()
    # The triad is M = 1 + the cross product with the small rotation: its skew parts are the two angles.
    assert forward_up == pytest.approx(-ASKEW.askew_pitch_rad, abs=0.005)
    assert port_up == pytest.approx(-ASKEW.askew_roll_rad, abs=0.005)
    assert (up_forward, up_port) == pytest.approx((-forward_up, -port_up), abs=0.01)
    assert abs(crossed) + abs(more) < 0.01
    late = right().t_s > 150.0
    truth = right().truth.heave_acceleration_mps2[late]
    wrong = np.array([up.up_mps2 for up, _, _ in readings(crooked(right(), ASKEW))])[late]
    noise = np.array([up.up_mps2 for up, _, _ in readings(right())])[late]
    assert np.std(np.array(left)[late] - truth) < 1.3 * np.std(noise - truth)
    assert np.std(wrong - truth) > 3.0 * np.std(noise - truth)


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        (Wrong(cross_axis=0.02), (0.02, 0.02, 0.02, 0.02, 0.02, 0.0)),
        (Wrong(bent_per_g=0.01), (0.0, 0.0, 0.0, 0.0, 0.0, 0.01)),
    ],
)
def test_leaks_and_bends_are_told_apart(wrong: Wrong, expected: tuple[float, ...]) -> None:
    axes, _ = shown(crooked(right(duration_s=320.0, sensor=SENSORS["ideal"]), wrong))
    np.testing.assert_allclose(axes.weights, expected, atol=0.004)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_one_wild_piece_does_not_take_away_what_was_found(seed: int) -> None:
    made = record(seaway("S6-bow-0.8", seed), 500.0, imu_rate_hz=RATE_HZ, sensor=UNBIASED, seed=seed)
    axes = AxisErrors(RATE_HZ, 0.002, enabled=True)
    was_in_use = False
    for up, laser, tilt in readings(crooked(made, Wrong(bent_per_g=0.01))):
        bump_mps2 = 0.003 * math.sin(0.35 * up.t_s) if 400.0 < up.t_s < 415.0 else 0.0
        axes.step(msgspec.structs.replace(up, up_mps2=up.up_mps2 + bump_mps2))
        axes.push(up.t_s, laser, tilt, CONFIGURED)
        assert axes.is_in_use or not was_in_use
        was_in_use = was_in_use or axes.is_in_use
    np.testing.assert_allclose(axes.weights, (0.0, 0.0, 0.0, 0.0, 0.0, 0.01), atol=0.005)


@pytest.mark.parametrize("gauge", [AT_THE_IMU, Gauge(at_m=(12.0, 4.0, 2.0))])
def test_right_physics_has_nothing_to_take_out_wherever_the_gauge_is(gauge: Gauge) -> None:
    axes, left = shown(right(gauge))
    assert not axes.is_in_use
    assert axes.amendment is None
    assert left == [up.up_mps2 for up, _, _ in readings(right(gauge))]


def test_what_is_found_is_taken_out_of_the_past_too() -> None:
    made = crooked(right(), ASKEW)
    axes = AxisErrors(RATE_HZ, 0.002, enabled=True)
    past = []
    for up, laser, tilt in readings(made):
        axes.step(up)
        past.append((up.t_s, up.leaks_mps2))
        axes.push(up.t_s, laser, tilt, CONFIGURED)
        if axes.is_in_use:
            break
    assert axes.amendment is not None
    by_time = dict(past)
    found = [-float(np.dot(axes.weights, by_time[t] or ())) for t in axes.amendment.t_s.tolist()]
    np.testing.assert_allclose(axes.amendment.more_mps2, found)
    assert axes.amendment.t_s[0] == 0.0
    assert np.diff(axes.amendment.t_s) == pytest.approx(TUNING.past_every_s, abs=1e-6)


def test_without_roll_and_pitch_nothing_is_learned_and_nothing_taken_out() -> None:
    axes, _ = shown(crooked(right(), ASKEW))
    assert axes.is_applied
    blind = VerticalAcceleration(1000.0, 0.3)
    assert axes.step(blind) == 0.3
    assert axes.is_in_use
    assert not axes.is_applied
    assert not axes.push(1000.0, 12.0, None, CONFIGURED)
    fresh = AxisErrors(RATE_HZ, 0.002, enabled=True)
    for up, laser, _ in readings(crooked(right(), ASKEW)):
        fresh.step(VerticalAcceleration(up.t_s, up.up_mps2))
        fresh.push(up.t_s, laser, Tilt(0.0, 0.0), CONFIGURED)
    assert not fresh.is_in_use


def test_another_target_between_pieces_and_holes_in_the_laser_do_no_harm() -> None:
    made = crooked(right(duration_s=320.0), ASKEW)
    laser = made.laser_m.copy()
    axes = AxisErrors(RATE_HZ, 0.002, enabled=True)
    for number, (up, reading, tilt) in enumerate(readings(msgspec.structs.replace(made, laser_m=laser))):
        axes.step(up)
        if number == 1700:
            axes.retarget()
        if number % 100 < 60:  # Four of ten seconds are spray.
            axes.push(up.t_s, reading + (3.0 if number >= 1700 else 0.0), tilt, CONFIGURED)
    assert axes.weights[1] == pytest.approx(-ASKEW.askew_roll_rad, abs=0.006)


def test_an_imu_that_is_put_right_is_let_go() -> None:
    axes, _ = shown(crooked(right(), ASKEW))
    assert axes.is_in_use
    later = right(duration_s=500.0)
    after = {name: getattr(later, name) + (1000.0 if name == "t_s" else 0.0) for name in later.__struct_fields__[:-1]}
    axes, _ = shown(crooked(Recording(**after, truth=later.truth), RIGHT), axes)
    assert not axes.is_in_use
    assert not axes.weights.any()


def stuck(laser_m: Array, rng: np.random.Generator) -> Array:
    return np.full_like(laser_m, 12.0) + 0.002 * rng.standard_normal(laser_m.size)


def of_another_ship(laser_m: Array, rng: np.random.Generator) -> Array:
    return 12.0 + np.roll(laser_m - 12.0, 777)


LASERS_THAT_LIE: dict[str, Callable[[Array, np.random.Generator], Array]] = {
    "wrong sign": lambda laser_m, _: 24.0 - laser_m,
    "feet": lambda laser_m, _: 3.281 * laser_m,
    "nothing moves": stuck,
    "another ship": of_another_ship,
    "a metre of noise": lambda laser_m, rng: laser_m + rng.standard_normal(laser_m.size),
}


@pytest.mark.parametrize("lie", LASERS_THAT_LIE)
def test_no_laser_that_lies_makes_leaks(lie: str) -> None:
    # One direction of the waves: all motions go with the heave, and a leak could be made of any of it.
    made = record(seaway("S6", 4), 200.0, imu_rate_hz=RATE_HZ, sensor=UNBIASED, seed=7)
    laser_m = LASERS_THAT_LIE[lie](made.laser_m, np.random.default_rng(3))
    axes, _ = shown(msgspec.structs.replace(made, laser_m=laser_m))
    assert not axes.is_in_use


def test_a_step_of_the_level_spoils_no_more_than_its_piece() -> None:
    made = crooked(right(duration_s=260.0), ASKEW)
    up = made.az_mps2 + np.where(made.t_s > 105.0, 1.0, 0.0)
    axes, _ = shown(msgspec.structs.replace(made, az_mps2=up))
    assert axes.weights[1] == pytest.approx(-ASKEW.askew_roll_rad, abs=0.006)


def test_a_restart_remembers_for_a_week_and_the_laser_judges() -> None:
    saved = shown(crooked(right(), ASKEW))[0].saved()
    assert saved is not None
    assert 0.0 <= saved.unconfirmed_s < 2.0 * TUNING.piece_s
    later = AxisErrors(RATE_HZ, 0.002, enabled=True)
    later.restore(saved, TUNING.remembered_s / 2.0)
    up, _, _ = next(readings(crooked(right(), ASKEW)))
    assert later.step(up) != up.up_mps2
    assert later.saved() == SavedAxes(
        weights=saved.weights, unconfirmed_s=saved.unconfirmed_s + TUNING.remembered_s / 2.0
    )
    shown(crooked(right(), ASKEW), later)
    again = later.saved()
    assert again is not None
    assert again.unconfirmed_s < 2.0 * TUNING.piece_s
    old = AxisErrors(RATE_HZ, 0.002, enabled=True)
    old.restore(saved, 1.1 * TUNING.remembered_s)
    assert not old.is_in_use
    wrong = AxisErrors(RATE_HZ, 0.002, enabled=True)
    wrong.restore(saved, 60.0)
    shown(right(), wrong)
    assert not wrong.is_in_use


def test_what_is_not_enabled_touches_nothing() -> None:
    axes, left = shown(crooked(right(), ASKEW), AxisErrors(RATE_HZ, 0.002, enabled=False))
    assert not axes.is_in_use
    assert left == [up.up_mps2 for up, _, _ in readings(crooked(right(), ASKEW))]
