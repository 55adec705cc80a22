"""Angles and accelerations of a known motion, and what is put among them at known places."""

from __future__ import annotations

from math import pi, radians

import numpy as np
import pytest

from heaved.estimation.imu.gates import AngleGate, SpikeGate, wrapped

RATES_HZ = [5.0, 20.0, 100.0, 200.0]


def motion(rate_hz: float, duration_s: float = 60.0, degrees: float = 6.0) -> tuple[np.ndarray, np.ndarray]:
    """Roll of 12 s and 5 s together, with the noise of an attitude sensor."""
    t = np.arange(round(duration_s * rate_hz)) / rate_hz
    noise = 0.02 * np.random.default_rng(1).standard_normal(t.size)
    return t, np.radians(degrees * (0.8 * np.sin(0.52 * t) + 0.2 * np.sin(1.26 * t)) + noise)


def passed(gate: AngleGate, t: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return np.array([gate.step(*pair) for pair in zip(t.tolist(), angle.tolist(), strict=True)])


@pytest.mark.parametrize(
    ("angle", "same"), [(0.0, 0.0), (2 * pi - 0.1, -0.1), (-pi, pi), (pi, pi), (3.5, 3.5 - 2 * pi)]
)
def test_wrapped(angle: float, same: float) -> None:
    assert wrapped(angle) == pytest.approx(same, abs=1e-12)


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("degrees", [0.0, 1.0, 20.0])
def test_a_motion_passes_but_for_the_first_readings(rate_hz: float, degrees: float) -> None:
    t, angle = motion(rate_hz, degrees=degrees)
    ok = passed(AngleGate(), t, angle)
    assert ok[t >= 0.8].all()
    assert not ok[0]
    confirmed = AngleGate()
    assert all(confirmed.step(*pair, is_confirmed=True) for pair in zip(t.tolist(), angle.tolist(), strict=True))


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("share", [0.05, 0.3, 0.6])
def test_what_is_not_the_motion_is_refused_whatever_its_share(rate_hz: float, share: float) -> None:
    t, angle = motion(rate_hz)
    rng = np.random.default_rng(2)
    wrong = (t > 20.0) & (t < 40.0) & (rng.random(t.size) < share)
    given = np.where(wrong, rng.uniform(-pi, pi, t.size), angle)
    ok = passed(AngleGate(), t, given)
    assert np.abs(given - angle)[ok].max() < radians(2.5)
    assert ok[(t > 20.0) & ~wrong].mean() > 0.9
    assert ok[t > 40.0].mean() > 0.97


def test_random_readings_alone_are_never_believed() -> None:
    t = np.arange(2000) / 50.0
    ok = passed(AngleGate(), t, np.random.default_rng(4).uniform(-pi, pi, t.size))
    assert not ok.any()


@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_a_step_that_lasts_is_the_new_level(rate_hz: float) -> None:
    t, angle = motion(rate_hz)
    angle[t >= 30.0] += radians(8.0)
    ok = passed(AngleGate(), t, angle)
    refused = t[(t > 1.0) & ~ok]
    assert refused.min() == pytest.approx(30.0, abs=1e-6)
    assert refused.max() < 31.0


def test_a_list_that_a_crane_makes_in_two_seconds_passes() -> None:
    t, angle = motion(20.0, degrees=1.0)
    angle += radians(3.0) * np.clip((t - 30.0) / 2.0, 0.0, 1.0)
    assert passed(AngleGate(), t, angle)[t > 1.0].all()


def test_a_heading_turns_round() -> None:
    t = np.arange(1200) / 20.0
    heading = np.radians(2.0 * t + 300.0)
    for turned in (heading % (2 * pi), (heading + pi) % (2 * pi) - pi):
        assert passed(AngleGate(most_rad=np.inf), t, turned)[t > 0.5].all()


# ---- accelerations ---------------------------------------------------------------------------------------------------


def sea(rate_hz: float, duration_s: float = 60.0) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(0.0, duration_s, 1.0 / rate_hz)
    noise = 0.02 * np.random.default_rng(1).standard_normal(len(t))
    return t, 1.5 * np.sin(0.9 * t) + 0.5 * np.sin(2.1 * t) + noise


def let_through(gate: SpikeGate, t: np.ndarray, a: np.ndarray) -> np.ndarray:
    return np.array([gate.step(*pair) for pair in zip(t.tolist(), a.tolist(), strict=True)])


@pytest.mark.parametrize("rate_hz", [10.0, 20.0, 100.0])
def test_a_sea_passes_untouched_and_spikes_do_not(rate_hz: float) -> None:
    t, a = sea(rate_hz)
    gate = SpikeGate()
    assert (let_through(gate, t, a) == a).all()
    assert gate.rejected == 0
    at = [len(t) // 2, len(t) // 2 + 40, len(t) - 5]
    a[at] += [20.0, -5.0, 4.5]
    out = let_through(gate := SpikeGate(), t, a)
    assert np.flatnonzero(np.isnan(out)).tolist() == at
    assert gate.rejected == 3


def test_a_level_that_lasts_is_let_through() -> None:
    t, a = sea(50.0)
    a[t >= 30.0] += 5.0
    out = let_through(SpikeGate(), t, a)
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
    out = let_through(gate, t, a)
    assert np.isnan(out[bad]).all()
    assert (out[~bad] == a[~bad]).all()
    assert np.isnan(SpikeGate().step(0.0, value))  # the very first reading too


def test_missing_values_are_missing_and_change_nothing() -> None:
    t, a = sea(20.0)
    holes = np.random.default_rng(2).random(len(t)) < 0.3
    out = let_through(SpikeGate(), t, np.where(holes, np.nan, a))
    assert np.isnan(out[holes]).all()
    assert (out[~holes] == a[~holes]).all()
    assert np.isnan(SpikeGate().step(0.0, float("inf")))


def test_after_a_gap_any_level_is_a_new_beginning() -> None:
    t, a = sea(20.0)
    out = let_through(gate := SpikeGate(), t[:400], a[:400])
    assert np.isfinite(out).all()
    assert gate.step(t[399] + 0.6, a[399] + 4.0) == a[399] + 4.0
