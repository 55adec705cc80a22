"""Sums that see a drift and no waves; the walk that a fit takes from them."""

from __future__ import annotations

import numpy as np
import pytest
from seas import model, simulated

from heaved.estimation.heave.sea import whittle_fit
from heaved.estimation.heave.sea.drift import TUNING, DriftDetector, drift_variances, drift_weights
from heaved.estimation.heave.sea.model import SeaSystem
from heaved.estimation.heave.sea.record import SeaRecord

DT_S, COUNT = 0.05, 12_000
T = DT_S * np.arange(COUNT)
Array = np.ndarray


@pytest.fixture(scope="module")
def sea() -> Array:
    return simulated(SeaSystem(model()), DT_S, COUNT, seed=5)[1]


@pytest.mark.parametrize("seconds", TUNING.drifts_s)
def test_the_sum_of_a_model_has_the_variance_that_it_is_said_to_have(seconds: float, sea: Array) -> None:
    weights = drift_weights(round(seconds / DT_S))
    sums = np.correlate(sea, weights, mode="valid")[:: round(5.0 / DT_S)]
    rest, _ = drift_variances(weights, DT_S, model())
    assert np.sqrt(np.mean(sums**2)) == pytest.approx(np.sqrt(rest), rel=0.35)
    assert np.sqrt(rest) < 0.05 * np.std(sea)


def test_a_step_of_the_level_is_one_and_a_line_half_its_length() -> None:
    weights = drift_weights(400)
    assert weights @ np.repeat([0.0, 1.0], 200) == pytest.approx(1.0)
    assert weights @ np.ones(400) == pytest.approx(0.0, abs=1e-12)
    assert 0.3 < weights @ np.linspace(0.0, 1.0, 400) < 0.5


@pytest.mark.parametrize("slope", [0.0, 1e-4, -3e-4])
def test_a_warm_up_is_seen_within_half_a_minute(slope: float, sea: Array) -> None:
    begin = 8000
    a = sea + slope * np.maximum(T - T[begin], 0.0)
    detector = DriftDetector(model(), DT_S)
    record, seen = SeaRecord(130.0, 40.0, 30.0), []
    for k in range(1500, COUNT, 20):
        for i in range(k - 20, k):
            record.push(T[i], a[i])
        detector.step(T[k - 1], record)
        seen.append(detector.is_drifting)
    assert not any(seen[: (begin - 1500) // 20])
    if slope == 0.0:
        assert not any(seen)
    else:
        assert any(seen[(begin - 1500) // 20 : (begin - 1500) // 20 + 40])
        assert detector.factor > 3.0


@pytest.mark.parametrize("walk", [3e-5, 2e-4, 1e-3])
def test_the_walk_of_the_bias_is_learned(walk: float, sea: Array) -> None:
    """In the mean over some records, to a factor of two; from what a data sheet says it is, ten times less."""
    rng, found = np.random.default_rng(8), []
    for _ in range(6):
        bias = walk * np.sqrt(DT_S) * np.cumsum(rng.standard_normal(COUNT))
        found.append(whittle_fit.bias_walk(sea + bias, 1.0 / DT_S, model(), 3e-5**2))
    assert 0.5 * walk < np.sqrt(np.exp(np.mean(np.log(found)))) < 2.0 * walk


def test_a_straight_drift_opens_the_walk(sea: Array) -> None:
    drifting = sea + 3e-4 * np.maximum(T - T[-1200], 0.0)
    assert whittle_fit.bias_walk(drifting, 1.0 / DT_S, model(), 3e-5**2) > 10.0 * whittle_fit.bias_walk(
        sea, 1.0 / DT_S, model(), 3e-5**2
    )
