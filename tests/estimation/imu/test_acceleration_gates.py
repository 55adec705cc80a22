"""Oracle: readings made of a sea plus spikes at known places."""

import numpy as np
import pytest

from heaved.estimation.imu.acceleration_gates import SpikeGate, StuckGate


def sea(rate_hz: float, duration_s: float = 60.0) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(0.0, duration_s, 1.0 / rate_hz)
    noise = 0.02 * np.random.default_rng(1).standard_normal(len(t))
    return t, 1.5 * np.sin(0.9 * t) + 0.5 * np.sin(2.1 * t) + noise


def passed(gate: SpikeGate, t: np.ndarray, a: np.ndarray) -> np.ndarray:
    return np.array([gate(*pair) for pair in zip(t.tolist(), a.tolist(), strict=True)])


@pytest.mark.parametrize("rate_hz", [10.0, 20.0, 100.0])
def test_a_sea_passes_untouched_and_spikes_do_not(rate_hz: float) -> None:
    t, a = sea(rate_hz)
    gate = SpikeGate()
    assert (passed(gate, t, a) == a).all()
    assert gate.rejected == 0
    at = [len(t) // 2, len(t) // 2 + 40, len(t) - 5]
    a[at] += [20.0, -5.0, 4.5]
    out = passed(gate := SpikeGate(), t, a)
    assert np.flatnonzero(np.isnan(out)).tolist() == at
    assert gate.rejected == 3


def test_a_level_that_lasts_is_let_through() -> None:
    t, a = sea(50.0)
    a[t >= 30.0] += 5.0
    out = passed(SpikeGate(), t, a)
    withheld = t[np.isnan(out)]
    assert withheld.min() == pytest.approx(30.0)
    assert withheld.max() < 30.2


@pytest.mark.parametrize("value", [20.0, -9.80665, 156.0, 3e38, -3e38])
def test_what_no_vessel_does_is_withheld_however_long_it_lasts(value: float) -> None:
    """-9.8 is a register that reads zero, 156 one at the end of its range."""
    t, a = sea(20.0)
    bad = (t >= 30.0) & (t < 40.0)
    a[bad] = value
    gate = SpikeGate()
    out = passed(gate, t, a)
    assert np.isnan(out[bad]).all()
    assert (out[~bad] == a[~bad]).all()
    assert np.isnan(SpikeGate()(0.0, value))  # the very first reading too


def test_missing_values_are_missing_and_change_nothing() -> None:
    t, a = sea(20.0)
    holes = np.random.default_rng(2).random(len(t)) < 0.3
    out = passed(SpikeGate(), t, np.where(holes, np.nan, a))
    assert np.isnan(out[holes]).all()
    assert (out[~holes] == a[~holes]).all()
    assert np.isnan(SpikeGate()(0.0, float("inf")))


def test_after_a_gap_any_level_is_a_new_beginning() -> None:
    t, a = sea(20.0)
    out = passed(gate := SpikeGate(), t[:400], a[:400])
    assert np.isfinite(out).all()
    assert gate(t[399] + 0.6, a[399] + 4.0) == a[399] + 4.0


# ---- channels that stand --------------------------------------------------------------------------------------------


def rolling(rate_hz: float, step_deg: float, noise_deg: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Two minutes of roll through a register with steps of ``step_deg`` (0: none)."""
    t = np.arange(0.0, 120.0, 1.0 / rate_hz)
    roll = 3.0 * np.sin(0.6 * t) + np.sin(0.9 * t) + noise_deg * np.random.default_rng(2).standard_normal(len(t))
    return t, np.radians(np.round(roll / step_deg) * step_deg if step_deg else roll)


def stands(gate: StuckGate, t: np.ndarray, values: np.ndarray, moves: bool = True) -> np.ndarray:
    return np.array([gate(*pair, moves=moves) for pair in zip(t.tolist(), values.tolist(), strict=True)])


@pytest.mark.parametrize("rate_hz", [5.0, 20.0, 100.0])
@pytest.mark.parametrize(("step_deg", "noise_deg", "found_s"), [(0.0, 0.02, 0.0), (0.0055, 0.02, 0.9), (0.1, 0.0, 2.5)])
def test_an_angle_that_freezes_is_found_and_one_that_rests_is_not(
    rate_hz: float, step_deg: float, noise_deg: float, found_s: float
) -> None:
    t, roll = rolling(rate_hz, step_deg, noise_deg)
    assert stands(StuckGate(rests=True), t, roll)[t > 30.0].mean() < 0.01
    frozen = (t >= 60.3) & (t < 80.0)
    roll[frozen] = roll[frozen][0]
    found = stands(StuckGate(rests=True), t, roll)
    assert t[frozen & ~found].max() <= 60.3 + found_s + 2.0 / rate_hz
    assert not found[t >= 80.0][0]


@pytest.mark.parametrize("rate_hz", [20.0, 100.0])
def test_two_readings_that_are_the_same_by_chance_are_no_fault(rate_hz: float) -> None:
    t, roll = rolling(rate_hz, 0.0, 0.02)
    at = int(60.0 * rate_hz)
    roll[at + 1] = roll[at]
    assert not stands(StuckGate(rests=True, by_chance=True), t, roll).any()


def test_on_a_still_ship_nothing_stands_and_a_constant_is_none() -> None:
    t = np.arange(0.0, 60.0, 0.05)
    assert not stands(StuckGate(rests=True), t, np.where(t > 30.0, 0.001, 0.0), moves=False).any()
    assert not stands(StuckGate(rests=True), t, np.zeros(len(t)), moves=False).any()
    assert stands(StuckGate(must_live=True), t, np.full(len(t), 9.8))[t > 5.1].all()
