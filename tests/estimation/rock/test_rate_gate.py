"""Wrong readings of a gyroscope: taken out one by one, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from heaved.estimation.rock.rate_gate import TUNING, RateGate

Array = NDArray[np.float64]

TURN = 2.0 * np.pi


def roll_rate(t: Array) -> Array:
    """Of a roll of 3 degrees in 8 s."""
    return np.asarray(np.radians(3.0) * TURN / 8.0 * np.cos(TURN * t / 8.0))


def taken(t: Array, rates: Array) -> tuple[Array, RateGate]:
    gate = RateGate(1)
    found = [gate.step(moment, [rate])[0] for moment, rate in zip(t.tolist(), rates.tolist(), strict=True)]
    return np.array(found), gate


HONEST = {
    "noise": lambda t, rng: 1e-4 * rng.standard_normal(len(t)),
    "no noise at all": lambda t, rng: 0.0 * t,
    "a line of 3.1 Hz": lambda t, rng: 4e-3 * np.sin(TURN * 3.1 * t) + 1e-4 * rng.standard_normal(len(t)),
    "white shaking": lambda t, rng: 2e-2 * rng.standard_normal(len(t)),
}


@pytest.mark.parametrize("rate_hz", [5.0, 20.0, 100.0])
@pytest.mark.parametrize("name", HONEST)
def test_what_shakes_is_taken(name: str, rate_hz: float) -> None:
    t = np.arange(round(60.0 * rate_hz)) / rate_hz
    rates = roll_rate(t) + HONEST[name](t, np.random.default_rng(1))
    found, gate = taken(t, rates)
    np.testing.assert_array_equal(found, rates)
    assert not gate.refused


@pytest.mark.parametrize("step_radps", [1e-3, 2e-2])
def test_coarse_registers_are_taken(step_radps: float) -> None:
    t = np.arange(2000) / 20.0
    rates = step_radps * np.round((roll_rate(t) + 1e-4 * np.random.default_rng(1).standard_normal(len(t))) / step_radps)
    found, _ = taken(t, rates)
    assert np.mean(found != rates) < 0.01
    assert np.max(np.abs(found - rates)) < 2.0 * step_radps


@pytest.mark.parametrize("rate_hz", [5.0, 20.0, 100.0])
@pytest.mark.parametrize("share", [0.005, 0.1])
@pytest.mark.parametrize("size_radps", [0.05, 10.0])
def test_spikes_are_replaced_by_the_line_through_what_was_before(
    rate_hz: float, share: float, size_radps: float
) -> None:
    rng = np.random.default_rng(2)
    t = np.arange(round(120.0 * rate_hz)) / rate_hz
    true = roll_rate(t)
    rates = true + 1e-4 * rng.standard_normal(len(t))
    hit = (rng.random(len(t)) < share) & (t > 5.0)
    rates[hit] += size_radps * rng.choice([-1.0, 1.0], hit.sum())
    found, gate = taken(t, rates)
    assert gate.refused == hit.sum()
    known = np.isfinite(found)
    assert known[~hit].all()
    assert np.max(np.abs(found - true)[known]) < 0.1 * np.max(np.abs(true))


def test_a_new_offset_is_believed_after_a_moment() -> None:
    t = np.arange(400) / 20.0
    rates = roll_rate(t) + np.where(t >= 10.0, 0.1, 0.0)
    found, _ = taken(t, rates)
    late = t >= 10.0 + TUNING.lasting_s + 0.05
    np.testing.assert_array_equal(found[late], rates[late])


def test_missing_readings_are_bridged_for_a_moment_only() -> None:
    t = np.arange(400) / 20.0
    rates = roll_rate(t)
    rates[(t > 9.99) & (t < 10.51)] = np.nan
    found, _ = taken(t, rates)
    assert np.isfinite(found[(t > 9.99) & (t < 10.06)]).all()
    assert np.isnan(found[(t > 10.2) & (t < 10.51)]).all()
    np.testing.assert_array_equal(found[t > 10.51], rates[t > 10.51])
