"""Sums that see a drift and no waves; the walk that a fit takes from them."""

from __future__ import annotations

import numpy as np
import pytest
from seas import model, simulated

from heaved.estimation.heave.sea import drift_removal, whittle_fit
from heaved.estimation.heave.sea.drift import (
    TUNING,
    DriftDetector,
    RampResponse,
    drift_variances,
    drift_weights,
    walk_of,
)
from heaved.estimation.heave.sea.filter import SeaFilter
from heaved.estimation.heave.sea.model import SeaSystem, Steady
from heaved.estimation.heave.sea.record import EvenRecord

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


@pytest.fixture(scope="module")
def steady() -> tuple[SeaSystem, Steady]:
    system = SeaSystem(model())
    found = system.steady(DT_S)
    assert found is not None
    return system, found


def filtered(system: SeaSystem, steady: Steady, a: Array, x: Array | None = None) -> tuple[Array, SeaFilter]:
    """Innovations over their deviation (k,) of the steady filter, and the filter after them."""
    f = SeaFilter(system, steady, -DT_S, np.zeros(len(system.H)) if x is None else x, None)
    told = []
    for i, value in enumerate(a.tolist()):
        f.step(i * DT_S, value)
        told.append(f.innovation / np.sqrt(f.innovation_variance))
    return np.array(told), f


def test_what_a_ramp_leaves_is_what_the_filter_makes_of_one(steady: tuple[SeaSystem, Steady]) -> None:
    system, of = steady
    response = RampResponse(system, of, 8)
    count = 8 * response.block
    ramp = 1e-3 * DT_S * np.arange(1.0, count + 1.0)
    told, f = filtered(system, of, ramp)
    assert told * np.sqrt(of.S) == pytest.approx(1e-3 * response.innovation, abs=1e-9)
    lacks = -f.x
    lacks[-1] += ramp[-1]
    assert lacks == pytest.approx(1e-3 * response.states([3, 8])[1], rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("rate", [0.0, 3e-4, -1e-3])
def test_a_drift_is_found_in_time_and_none_is_not(rate: float, steady: tuple[SeaSystem, Steady], sea: Array) -> None:
    system, of = steady
    begin = 8000
    told, _ = filtered(system, of, sea + rate * np.maximum(T - T[begin], 0.0))
    detector, found = DriftDetector(system, of), None
    for i, scaled in enumerate(told[2400:].tolist(), start=2400):
        detector.push(scaled)
        if i > 2400 + 1700 and detector.look(T[i]):
            found = i
            break
    if rate == 0.0:
        assert found is None
        return
    assert found is not None
    since_s = (found - begin) * DT_S
    assert 0.0 < since_s < 30.0
    mean, covariance = detector.mixture()
    assert abs(mean[-1] - rate) < 3.0 * np.sqrt(covariance[-1, -1])
    assert abs(mean[-1]) > 0.3 * abs(rate)
    assert detector.began_s == pytest.approx(since_s, abs=12.0)


def test_what_is_filled_in_at_once_is_what_is_pushed(steady: tuple[SeaSystem, Steady]) -> None:
    rng, one, other = np.random.default_rng(3), DriftDetector(*steady), DriftDetector(*steady)
    past = 2.0 * rng.standard_normal(3000)
    one.fill(past[:2400])
    for scaled in past.tolist():
        other.push(scaled)
    for scaled in past[2400:].tolist():
        one.push(scaled)
    one.look(0.0)
    other.look(0.0)
    assert one.probability == pytest.approx(other.probability, rel=1e-9)
    assert one.mixture().mean == pytest.approx(other.mixture().mean, rel=1e-9)


def test_a_filter_that_follows_the_rate_is_right_within_its_deviation(steady: tuple[SeaSystem, Steady]) -> None:
    """From all that may have begun, through two minutes of drift to its end; scattered as it says over all of it."""
    system, of = steady
    states, a = simulated(system, DT_S, 7200, seed=11)
    begin, end = 3000, 5400
    drifted = a + 4e-4 * np.clip(T[:7200] - T[begin], 0.0, T[end] - T[begin])
    _, f = filtered(system, of, drifted[:begin])
    detector, errors = DriftDetector(system, of), []
    for i in range(begin, 7200):
        f.step(i * DT_S, drifted[i])
        if f.rate is None:
            detector.push(f.innovation / np.sqrt(f.innovation_variance))
            if detector.look(i * DT_S):
                mean, covariance = detector.mixture()
                f.open_rate(mean, covariance, walk_of(float(mean[-1])))
        else:
            error_m = float(system.heave @ (f.x - states[i]))
            errors.append(error_m / np.sqrt(float(system.heave @ f.covariance @ system.heave)))
    assert f.rate is not None
    assert len(errors) > 3400
    assert abs(f.rate.value) < 3.0 * np.sqrt(f.rate.V)
    assert np.sqrt(np.mean(np.square(errors))) < 1.5
    assert np.max(np.abs(errors)) < 4.0 * TUNING.changes


@pytest.mark.parametrize("is_over", [False, True])
def test_the_level_of_a_record_is_found(is_over: bool, steady: tuple[SeaSystem, Steady], sea: Array) -> None:
    """A drift of two minutes, to a millimetre or two per second squared; one that lasts also at the end, within what is
    said of it.
    """
    system, of = steady
    began_s, ended_s = (300.0, 420.0) if is_over else (500.0, np.inf)
    true = 4e-4 * np.clip(T - began_s, 0.0, 120.0)
    record = EvenRecord(float(T[-1]), DT_S, sea + 0.02 + true, np.ones(COUNT, dtype=bool))
    found = drift_removal.level(record, system, of, [(began_s - 20.0, ended_s + 20.0)])
    assert found is not None
    assert found.is_going_on != is_over
    assert np.max(np.abs(found.a_mps2 - true)[: COUNT if is_over else -400]) < 2.5e-3
    if not is_over:
        missing = found.missing(system, of)
        assert abs(found.rates_mps3[-1] - 4e-4) < 3.0 * np.sqrt(missing[-1, -1])
        assert abs(found.a_mps2[-1] - true[-1]) < 4.0 * np.sqrt(missing[-2, -2])


def test_nothing_is_found_of_a_drift_that_is_past(steady: tuple[SeaSystem, Steady], sea: Array) -> None:
    record = EvenRecord(float(T[-1]), DT_S, sea, np.ones(COUNT, dtype=bool))
    assert drift_removal.level(record, *steady, [(-300.0, -20.0)]) is None


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
