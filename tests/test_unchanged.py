"""Oracle: readings of a roll through a register, frozen or resting at known times."""

import numpy as np
import pytest

from heaved.unchanged import OldReadings, StuckDetector, Unchanged


def test_what_is_the_same_is_counted_from_when_it_first_came() -> None:
    unchanged = Unchanged()
    readings = [(0.0, 1.0), (0.5, 1.0), (1.0, 2.0), (1.25, 2.0), (9.0, 2.0), (9.5, float("nan")), (9.75, float("nan"))]
    assert [unchanged.push(t_s, value) for t_s, value in readings] == [0.0, 0.5, 0.0, 0.25, 8.0, 0.0, 0.0]
    assert unchanged.push(10.0, (1, 2)) == 0.0
    assert unchanged.push(10.5, (1, 2)) == 0.5
    assert (unchanged.since_s, unchanged.t_s, unchanged.repeats) == (10.0, 10.5, 1)
    unchanged.clear()
    assert unchanged.push(11.0, (1, 2)) == 0.0


def rolling(rate_hz: float, step_deg: float, noise_deg: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Two minutes of roll through a register with steps of ``step_deg`` (0: none)."""
    t = np.arange(0.0, 120.0, 1.0 / rate_hz)
    roll = 3.0 * np.sin(0.6 * t) + np.sin(0.9 * t) + noise_deg * np.random.default_rng(2).standard_normal(len(t))
    return t, np.radians(np.round(roll / step_deg) * step_deg if step_deg else roll)


def stands(detector: StuckDetector, t: np.ndarray, values: np.ndarray, moves: bool = True) -> np.ndarray:
    return np.array([detector.step(*pair, moves=moves) for pair in zip(t.tolist(), values.tolist(), strict=True)])


@pytest.mark.parametrize("rate_hz", [5.0, 20.0, 100.0])
@pytest.mark.parametrize(("step_deg", "noise_deg", "found_s"), [(0.0, 0.02, 0.0), (0.0055, 0.02, 0.9), (0.1, 0.0, 2.5)])
def test_an_angle_that_freezes_is_found_and_one_that_rests_is_not(
    rate_hz: float, step_deg: float, noise_deg: float, found_s: float
) -> None:
    t, roll = rolling(rate_hz, step_deg, noise_deg)
    assert stands(StuckDetector(rests=True), t, roll)[t > 30.0].mean() < 0.01
    frozen = (t >= 60.3) & (t < 80.0)
    roll[frozen] = roll[frozen][0]
    found = stands(StuckDetector(rests=True), t, roll)
    assert t[frozen & ~found].max() <= 60.3 + found_s + 2.0 / rate_hz
    assert not found[t >= 80.0][0]


@pytest.mark.parametrize("rate_hz", [20.0, 100.0])
def test_two_readings_that_are_the_same_by_chance_are_no_fault(rate_hz: float) -> None:
    t, roll = rolling(rate_hz, 0.0, 0.02)
    at = int(60.0 * rate_hz)
    roll[at + 1] = roll[at]
    assert not stands(StuckDetector(rests=True, by_chance=True), t, roll).any()


def test_on_a_still_ship_nothing_stands_and_a_constant_is_none() -> None:
    t = np.arange(0.0, 60.0, 0.05)
    assert not stands(StuckDetector(rests=True), t, np.where(t > 30.0, 0.001, 0.0), moves=False).any()
    assert not stands(StuckDetector(rests=True), t, np.zeros(len(t)), moves=False).any()
    assert stands(StuckDetector(must_live=True), t, np.full(len(t), 9.8))[t > 5.1].all()


def forces(rate_hz: float, step: float, noise: float, until_s: float, seconds: float = 240.0) -> np.ndarray:
    """Accelerations through registers with steps of ``step``, shape (n, 3), m/s²; it moves until ``until_s``."""
    t = np.arange(0.0, seconds, 1.0 / rate_hz)
    waves = [size * np.sin(2.0 * np.pi * t / period) for size, period in ((0.3, 9.1), (0.4, 8.3), (1.0, 7.7))]
    noises = noise * np.random.default_rng(4).standard_normal((len(t), 3))
    return np.round((np.column_stack(waves) * (t < until_s)[:, None] + noises) / step) * step


def old(readings: np.ndarray, rate_hz: float) -> np.ndarray:
    detector = OldReadings()
    return np.array([detector.step(n / rate_hz, tuple(row), row[2]) for n, row in enumerate(readings.tolist())])


@pytest.mark.parametrize("rate_hz", [20.0, 100.0])
@pytest.mark.parametrize(("step", "noise", "by_chance"), [(1e-7, 1e-3, 0.0), (4.8e-3, 5e-3, 0.03)])
def test_a_reading_of_before_that_stands_between_new_ones_is_old(
    rate_hz: float, step: float, noise: float, by_chance: float
) -> None:
    readings = forces(rate_hz, step, noise, until_s=240.0)
    t = np.arange(len(readings)) / rate_hz
    assert old(readings, rate_hz).mean() <= by_chance
    begun = 120.0 + 5.0 * np.floor((t - 120.0) / 5.0)
    served = (
        (t >= 120.0) & (t < 180.0) & (t - begun < 1.5) & (t > begun) & (np.random.default_rng(5).random(len(t)) < 0.5)
    )
    readings[served] = readings[np.searchsorted(t, begun[served])]
    found = old(readings, rate_hz)
    leaping = served & (np.abs(readings[:, 2] - forces(rate_hz, step, noise, 240.0)[:, 2]) > 0.3)
    assert found[leaping].all()
    assert found[served].mean() > 0.8
    assert found[~served].mean() <= by_chance


@pytest.mark.parametrize("rate_hz", [20.0, 100.0])
def test_a_vessel_that_comes_to_rest_on_coarse_registers_is_heard_again(rate_hz: float) -> None:
    found = old(forces(rate_hz, 4.8e-3, 4e-3, until_s=120.0), rate_hz)
    assert found[int(180.0 * rate_hz) :].mean() < 0.1


def test_a_sensor_that_repeats_itself_is_slow_and_not_old() -> None:
    readings = forces(20.0, 1e-7, 1e-3, until_s=240.0)[np.arange(4800) // 5 * 5]
    assert old(readings, 20.0)[100:].mean() < 0.01
    assert not old(np.tile(readings[:1], (400, 1)), 20.0).any()
