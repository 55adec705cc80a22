"""Signs and units of a simulated IMU, turned round and converted."""

from __future__ import annotations

from math import cos, sin
from typing import TYPE_CHECKING

import numpy as np
import pytest

from heaved.estimation.imu.mounting import SignCheck, UnitsCheck
from heaved.samples import GRAVITY_MPS2
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import Recording, record

if TYPE_CHECKING:
    from collections.abc import Callable

Rows = list[tuple[float, ...]]


def sea(name: str, duration_s: float = 120.0, sensor: str = "A", seed: int = 3) -> Recording:
    return record(seaway(name, seed), duration_s, imu_rate_hz=20.0, sensor=sensor, laser="off", seed=seed)


def rows(made: Recording) -> Rows:
    columns = (made.t_s, made.ax_mps2, made.ay_mps2, made.az_mps2, made.roll_rad, made.pitch_rad)
    return list(zip(*(column.tolist() for column in columns), strict=True))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda ax, ay, az: (ax, ay, -az), "az about -9.8"),
        (lambda ax, ay, az: (ax / 9.80665, ay / 9.80665, az / 9.80665), "in g?"),
        (lambda ax, ay, az: (ax / 9.80665, ay / 9.80665, -az / 9.80665), "in g, and upside down"),
        (lambda ax, ay, az: (ax, ay, az - 9.80665), "gravity removed"),
        (lambda ax, ay, az: (ax * 1e3, ay * 1e3, az * 1e3), "mm/s2"),
        (lambda ax, ay, az: (ax * 1e2, ay * 1e2, az * 1e2), "cm/s2"),
        (lambda ax, ay, az: (ax * 3.28, ay * 3.28, az * 3.28), "ft/s2"),
        (lambda ax, ay, az: (ax, az, ay), "mounted on its side"),
    ],
)
@pytest.mark.parametrize("name", ["S0", "S4", "S6"])
def test_units_and_signs_are_named_within_seconds(
    name: str, change: Callable[[float, float, float], tuple[float, float, float]], words: str
) -> None:
    watch, told_s = UnitsCheck(), float("nan")
    for t, ax, ay, az, *_ in rows(sea(name, 30.0)):
        watch.step(t, *change(ax, ay, az))
        if watch.reason and np.isnan(told_s):
            told_s = t
    assert words in watch.reason
    assert told_s < 6.0
    for t, ax, ay, az, *_ in rows(sea(name, 3.0)):
        watch.step(30.0 + t, ax, ay, az)
    assert watch.reason == ""


def test_what_is_right_or_random_is_not_named() -> None:
    watch, rng = UnitsCheck(), np.random.default_rng(1)
    for t, ax, ay, az, *_ in rows(sea("S6")):
        wrong = t > 60.0 and rng.random() < 0.3
        watch.step(t, *(rng.uniform(-157.0, 157.0, 3).tolist() if wrong else (ax, ay, az)))
        assert watch.reason == ""
    for i in range(400):
        watch.step(121.0 + 0.05 * i, *rng.uniform(-157.0, 157.0, 3).tolist())
        assert watch.reason == ""


@pytest.mark.parametrize(("roll", "pitch"), [(1, 1), (-1, 1), (1, -1), (-1, -1)])
@pytest.mark.parametrize("name", ["S4", "S6", "SL", "T1"])
def test_wrong_signs_of_angles_are_suspected_within_a_minute_and_right_ones_never(
    name: str, roll: int, pitch: int
) -> None:
    watch = SignCheck()
    for t, ax, ay, az, r, p in rows(sea(name)):
        watch.step(t, ax, ay, az, roll * r, pitch * p)
        if t > 59.0 or (roll > 0 and pitch > 0):
            assert ("roll and ay" in watch.suspicion) == (roll < 0)
            assert ("pitch and ax" in watch.suspicion) == (pitch < 0)


def test_in_a_rough_sea_a_wrong_sign_of_roll_is_certain() -> None:
    watch = SignCheck()
    for t, ax, ay, az, r, p in rows(sea("S6", 200.0, seed=1)):
        watch.step(t, ax, ay, az, -r, p)
    assert watch.certain


def test_a_barge_that_leans_less_than_the_waves_is_only_suspected() -> None:
    """Apparent gravity stands square on the wave; the deck follows a third of its slope: ay = g (roll - slope)."""
    watch = SignCheck()
    for i in range(4000):
        t = 0.05 * i
        slope, heave = 0.06 * sin(0.7 * t), 0.06 * GRAVITY_MPS2 * cos(0.7 * t)
        roll = slope / 3.0
        watch.step(t, 0.0, GRAVITY_MPS2 * (roll - slope), GRAVITY_MPS2 + heave, roll, 0.001 * sin(0.9 * t))
    assert "roll and ay" in watch.suspicion
    assert watch.certain == ""
