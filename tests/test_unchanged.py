"""Oracle: readings of a roll through a register, frozen or resting at known times."""

import numpy as np
import pytest

from heaved.unchanged import StuckDetector, Unchanged


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
