"""A model's filter over stored samples: against a recursion sample by sample, and signals known in between."""

from __future__ import annotations

import numpy as np
import pytest
from seas import Kalman, model, simulated

from heaved.estimation.heave.sea.batch_filter import BLOCK, TUNING, run
from heaved.estimation.heave.sea.model import SeaSystem, Steady, measurement_variance
from heaved.estimation.heave.sea.record import EvenRecord

DT_S = 0.05
Array = np.ndarray


@pytest.fixture(scope="module")
def system() -> SeaSystem:
    return SeaSystem(model(4, 2))


@pytest.fixture(scope="module")
def steady(system: SeaSystem) -> Steady:
    found = system.steady(DT_S)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def sea(system: SeaSystem) -> tuple[Array, Array]:
    """Heave and samples of 400 s."""
    states, a = simulated(system, DT_S, 8000, seed=21)
    return states @ system.heave, a


def record(a: Array, known: Array | None = None) -> EvenRecord:
    return EvenRecord(DT_S * (len(a) - 1), DT_S, a, np.ones(len(a), dtype=np.bool_) if known is None else known)


@pytest.mark.parametrize("count", [8000, 8000 - 1, 8000 - BLOCK + 1, 5])
def test_blocks_are_the_steady_recursion(
    count: int, system: SeaSystem, steady: Steady, sea: tuple[Array, Array]
) -> None:
    a = sea[1][:count]
    done = run(system, steady, record(a), full_start=False)
    x = np.zeros(len(system.H))
    x[-1] = np.mean(a)
    x = steady.F @ x
    predicted, innovation = np.empty(count), np.empty(count)
    for i, z in enumerate(a.tolist()):
        predicted[i], innovation[i] = system.heave @ x, z - system.H @ x
        after = x + steady.K * innovation[i]
        x = steady.F @ after
    sigma = np.std(sea[0])
    assert np.max(np.abs(done.predicted_m - predicted)) < 1e-9 * sigma
    assert np.max(np.abs(done.innovation - innovation)) < 1e-9
    assert np.max(np.abs(done.x - after)) < 1e-8 * np.max(np.abs(after))
    assert done.P is None


def full(system: SeaSystem, a: Array, known: Array | None = None) -> tuple[Kalman, Array]:
    """The whole filter from the stationary state, sample by sample; heave after each."""
    theirs = Kalman(
        system, np.zeros(len(system.H)), system.stationary, measurement_variance(system.model.noise_psd, DT_S)
    )
    F, Q = system.transition(DT_S)
    after = np.empty(len(a))
    for i, z in enumerate(a.tolist()):
        if i:
            theirs.x, theirs.P = F @ theirs.x, F @ theirs.P @ F.T + Q
        if known is None or known[i]:
            theirs.update(z)
        after[i] = system.heave @ theirs.x
    return theirs, after


@pytest.mark.parametrize("seconds", [40.0, 59.95, 60.05, 100.0, 400.0])
def test_a_careful_start_is_the_whole_filter(
    seconds: float, system: SeaSystem, steady: Steady, sea: tuple[Array, Array]
) -> None:
    """State and covariance to rounding while the covariance is carried, and nothing to speak of is lost afterwards."""
    count = round(seconds / DT_S)
    heave, a = sea[0][:count], sea[1][:count]
    theirs, _ = full(system, a)
    done = run(system, steady, record(a))
    known_m = float(np.sqrt(system.heave @ theirs.P @ system.heave))
    P = steady.P - np.outer(steady.K, steady.K) * steady.S if done.P is None else done.P
    assert (done.P is None) == (seconds > TUNING.full_s)
    closeness = 1e-5 if done.P is not None else 0.05
    assert abs(system.heave @ (done.x - theirs.x)) < closeness * known_m
    assert float(np.sqrt(system.heave @ P @ system.heave)) == pytest.approx(known_m, rel=closeness)
    assert abs(system.heave @ done.x - heave[-1]) < 4.0 * known_m
    started = np.isfinite(done.predicted_m)
    assert started.sum() == max(count - round(TUNING.full_s / DT_S), 0)
    assert np.array_equal(started, np.isfinite(done.innovation))
    assert (
        np.std((done.predicted_m - heave)[started][-200:]) < 5.0 * known_m if seconds > TUNING.full_s + 10.0 else True
    )


@pytest.mark.parametrize("hole_s", [1.0, 10.0, 60.0])
def test_after_a_hole_state_and_covariance_are_those_of_the_whole_filter(
    hole_s: float, system: SeaSystem, steady: Steady, sea: tuple[Array, Array]
) -> None:
    """The record ends 20 s after the hole: the covariance has not converged yet, and is handed over."""
    count, begin = 6000, 6000 - round((20.0 + hole_s) / DT_S)
    known = np.ones(count, dtype=np.bool_)
    known[begin : count - round(20.0 / DT_S)] = False
    a = sea[1][:count]
    done = run(system, steady, record(a, known))
    theirs, _ = full(system, a, known)
    assert done.P is not None
    known_m = float(np.sqrt(system.heave @ theirs.P @ system.heave))
    assert float(np.sqrt(system.heave @ done.P @ system.heave)) == pytest.approx(known_m, rel=1e-3)
    assert np.max(np.abs(np.diag(done.P) / np.diag(theirs.P) - 1.0)) < 0.02
    assert abs(system.heave @ (done.x - theirs.x)) < 0.05 * known_m
    assert np.all(done.innovation[~known] == 0.0)


@pytest.mark.parametrize("hole_s", [0.4, 10.0])
def test_after_a_hole_predictions_and_innovations_are_those_of_the_whole_filter(
    hole_s: float, system: SeaSystem, steady: Steady, sea: tuple[Array, Array]
) -> None:
    """Sample by sample, each from those before it; left out while the heave or the innovation is a tenth less sure."""
    count, begin, end = 7600, 6800, 6800 + round(hole_s / DT_S)
    known = np.ones(count, dtype=np.bool_)
    known[begin:end] = False
    done = run(system, steady, record(sea[1][:count], known))
    theirs = Kalman(
        system, np.zeros(len(system.H)), system.stationary, measurement_variance(system.model.noise_psd, DT_S)
    )
    F, Q = system.transition(DT_S)
    usual_m = float(np.sqrt(system.heave @ steady.P @ system.heave))
    for i, z in enumerate(sea[1][: end + 600].tolist()):
        theirs.x, theirs.P = F @ theirs.x, F @ theirs.P @ F.T + Q
        std_m = float(np.sqrt(system.heave @ theirs.P @ system.heave))
        S = float(system.H @ theirs.P @ system.H) + theirs.R
        if known[i]:
            before, y = theirs.update(z)
        if i >= end:
            assert abs(done.innovation[i] - y * np.sqrt(steady.S / S)) < 1e-3 * np.sqrt(steady.S)
            least = max(std_m / usual_m, float(np.sqrt(S / steady.S)))
            if abs(least / TUNING.unsure - 1.0) > 1e-3:
                assert np.isfinite(done.predicted_m[i]) == (least < TUNING.unsure)
            if np.isfinite(done.predicted_m[i]):
                assert abs(done.predicted_m[i] - before) < 0.01 * usual_m
    assert np.isfinite(done.predicted_m[end + 600 :]).all()


@pytest.mark.parametrize("kept", [100, 1500])
def test_predictions_that_are_not_wanted_change_nothing_else(
    kept: int, system: SeaSystem, steady: Steady, sea: tuple[Array, Array]
) -> None:
    known = np.ones(4000, dtype=np.bool_)
    known[1500:1508] = known[2000:2200] = False
    whole = run(system, steady, record(sea[1][:4000], known))
    short = run(system, steady, record(sea[1][:4000], known), kept=kept)
    np.testing.assert_allclose(short.x, whole.x, rtol=1e-9, atol=1e-12)
    for ours, theirs in ((short.innovation, whole.innovation), (short.predicted_m, whole.predicted_m)):
        np.testing.assert_array_equal(ours[-kept:], theirs[-kept:])
    assert np.isnan(short.innovation[1508:1600]).all()


def test_a_record_that_begins_with_a_hole_begins_after_it(
    system: SeaSystem, steady: Steady, sea: tuple[Array, Array]
) -> None:
    known = np.ones(4000, dtype=np.bool_)
    known[3:60] = False
    done = run(system, steady, record(sea[1][:4000], known))
    theirs, _ = full(system, sea[1][:4000], known)
    assert np.isfinite(done.x).all()
    assert abs(system.heave @ (done.x - theirs.x)) < 0.02 * np.std(sea[0])


def test_a_blow_where_nothing_can_ring_changes_nothing(
    system: SeaSystem, steady: Steady, sea: tuple[Array, Array]
) -> None:
    plain = run(system, steady, record(sea[1]))
    struck = run(system, steady, EvenRecord(DT_S * 7999, DT_S, sea[1], np.ones(8000, dtype=np.bool_), (), (6000, 7990)))
    assert np.max(np.abs(struck.x - plain.x)) < 1e-6 * np.max(np.abs(plain.x))
    assert np.nanmax(np.abs(struck.innovation - plain.innovation)) < 1e-6
