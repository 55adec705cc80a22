"""Polls of a simulated device with its own clock: the oracle is when that clock ticked."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from heaved.estimation.imu.sensor_clock import SensorClock


class Case(NamedTuple):
    poll_hz: float
    device_hz: float
    late_s: float
    """RMS error that the times may have from 15 s on."""
    jitter: float = 0.0
    """Polls come up to so many intervals late."""
    lost: float = 0.0
    held_up: float = 0.0
    """The device measures up to so many of its own periods late."""


CASES = [
    Case(100, 30, 0.001),
    Case(100, 30, 0.001, 0.5, 0.05),
    Case(100, 30, 0.001, 0.1, 0.3),
    Case(100, 30, 0.003, 0.2, 0.02, 0.1),
    Case(100, 10, 0.005),
    Case(100, 10, 0.002, 0.5, 0.05),
    Case(100, 5, 0.006, 0.2, 0.02, 0.1),
    Case(100, 2, 0.005),
    Case(200, 100, 0.0025),
    Case(200, 2, 0.006, 0.5, 0.05),
    Case(20, 16, 0.006),
    Case(20, 16, 0.013, 0.2, 0.02),
    Case(20, 10, 0.015),
    Case(20, 10, 0.005, 0.5, 0.05),
    Case(20, 5, 0.012, 0.5, 0.05),
    Case(10, 4, 0.025),
    Case(5, 2, 0.06),
]


def polls(case: Case, duration_s: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Times of the polls and of what each of them shows."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration_s * case.poll_hz)) / case.poll_hz
    t += case.jitter / case.poll_hz * rng.random(t.size)
    t = t[rng.random(t.size) >= case.lost]
    ticks = (np.arange(-2, round(duration_s * case.device_hz) + 3) + 0.37) / case.device_hz
    ticks += case.held_up / case.device_hz * rng.random(ticks.size)
    return t, ticks[np.searchsorted(ticks, t + 1e-9) - 1]


def taken(clock: SensorClock, t: np.ndarray, shown: np.ndarray) -> np.ndarray:
    new = np.append(True, np.diff(shown) != 0.0)
    return np.array([clock.step(*pair) for pair in zip(t.tolist(), new.tolist(), strict=True)])


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_slower_device_is_found_and_its_readings_are_given_their_times(case: Case) -> None:
    t, shown = polls(case, 60.0)
    clock = SensorClock()
    times = taken(clock, t, shown)
    assert 1.0 / clock.period_s == pytest.approx(case.device_hz, rel=0.02)
    assert 1.0 / clock.poll_s == pytest.approx(case.poll_hz, rel=0.1)
    late = t > 15.0
    known = late & np.isfinite(times)
    assert known.sum() == (np.diff(shown[late]) != 0.0).sum() + (np.diff(shown)[t[1:] > 15.0][0] != 0.0)
    error = (times - shown)[known]
    assert np.sqrt(np.mean(error**2)) < case.late_s
    assert (np.diff(times[np.isfinite(times)]) > 0.0).all()
    assert (times <= t)[known].all()


@pytest.mark.parametrize("share", [0.0, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95])
@pytest.mark.parametrize("poll_hz", [20.0, 100.0])
def test_coarse_registers_that_repeat_by_chance_are_left_as_they_are(poll_hz: float, share: float) -> None:
    rng = np.random.default_rng(3)
    t = np.arange(round(120.0 * poll_hz)) / poll_hz
    clock = SensorClock()
    times = taken(clock, t, np.cumsum(rng.random(t.size) >= share).astype(float))
    assert np.isnan(clock.period_s)
    assert (times[t > 31.0] == t[t > 31.0]).all()
    if share == 0.0:
        assert (times == t).all()


def test_a_device_that_becomes_faster_is_followed() -> None:
    slow, fast = polls(Case(100, 5, 0.0), 30.0), polls(Case(100, 20, 0.0), 60.0)
    clock = SensorClock()
    taken(clock, *slow)
    assert 1.0 / clock.period_s == pytest.approx(5.0, rel=0.01)
    taken(clock, fast[0] + 30.0, fast[1] + 30.0)
    assert 1.0 / clock.period_s == pytest.approx(20.0, rel=0.01)


def test_a_slow_device_that_hangs_says_so() -> None:
    t, shown = polls(Case(100, 10, 0.0), 20.0)
    clock = SensorClock()
    taken(clock, t, shown)
    assert not clock.hangs
    taken(clock, t[:60] + 20.0, np.full(60, shown[-1]))
    assert clock.hangs
