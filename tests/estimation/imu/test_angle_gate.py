"""Angles of a known motion, and what is put among them."""

from __future__ import annotations

from math import pi, radians

import numpy as np
import pytest

from heaved.estimation.imu.angle_gate import AngleGate, wrapped

RATES_HZ = [5.0, 20.0, 100.0, 200.0]


def motion(rate_hz: float, duration_s: float = 60.0, degrees: float = 6.0) -> tuple[np.ndarray, np.ndarray]:
    """Roll of 12 s and 5 s together, with the noise of an attitude sensor."""
    t = np.arange(round(duration_s * rate_hz)) / rate_hz
    noise = 0.02 * np.random.default_rng(1).standard_normal(t.size)
    return t, np.radians(degrees * (0.8 * np.sin(0.52 * t) + 0.2 * np.sin(1.26 * t)) + noise)


def passed(gate: AngleGate, t: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return np.array([gate(*pair) for pair in zip(t.tolist(), angle.tolist(), strict=True)])


@pytest.mark.parametrize(
    ("angle", "same"), [(0.0, 0.0), (2 * pi - 0.1, -0.1), (-pi, pi), (pi, pi), (3.5, 3.5 - 2 * pi)]
)
def test_wrapped(angle: float, same: float) -> None:
    assert wrapped(angle) == pytest.approx(same, abs=1e-12)


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("degrees", [0.0, 1.0, 20.0])
def test_a_motion_passes_but_for_the_first_readings(rate_hz: float, degrees: float) -> None:
    t, angle = motion(rate_hz, degrees=degrees)
    ok = passed(gate := AngleGate(), t, angle)
    assert ok[t >= 0.8].all()
    assert not ok[0]
    assert gate.rejected == 0
    confirmed = AngleGate()
    assert all(confirmed(*pair, is_confirmed=True) for pair in zip(t.tolist(), angle.tolist(), strict=True))


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
