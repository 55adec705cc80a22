"""Delayed heave against a textbook Rauch-Tung-Striebel smoother, and its own standard deviation."""

from math import nan

import numpy as np
import pytest
from seas import model, simulated

from heaved.estimation.heave.sea.filter import SeaFilter
from heaved.estimation.heave.sea.model import SeaSystem, Steady, measurement_variance
from heaved.estimation.heave.sea.record import EvenRecord
from heaved.estimation.heave.sea.smoother import TUNING, FixedLagSmoother, smoothed

DT_S = 0.1
LAG_S = 12.0
Array = np.ndarray


@pytest.fixture(scope="module")
def system() -> SeaSystem:
    return SeaSystem(model(4, 1, noise_psd=1e-4))


@pytest.fixture(scope="module")
def steady(system: SeaSystem) -> Steady:
    found = system.steady(DT_S)
    assert found is not None
    return found


def rauch_tung_striebel(system: SeaSystem, steady: Steady, x: Array, a: Array) -> tuple[Array, float]:
    """Forwards and backwards over the whole of ``a``: heave (k,), and the variance of the first one.

    x_k|N = x_k + C (x_k+1|N - x_k+1|k), C = P F' inv(P-).
    """
    F, Q, H = steady.F, steady.Q, system.H
    R = steady.S - float(H @ steady.P @ H)
    n, count = len(H), len(a)
    x_before, x_after = np.empty((count, n)), np.empty((count, n))
    P_before, P_after = np.empty((count, n, n)), np.empty((count, n, n))
    P = steady.P
    for k in range(count):
        x_before[k], P_before[k] = x, P
        S = float(H @ P @ H) + R
        K = P @ H / S
        x_after[k], P_after[k] = x + K * (a[k] - H @ x), P - np.outer(K, K) * S
        x, P = F @ x_after[k], F @ P_after[k] @ F.T + Q
    xs, Ps = x_after[-1], P_after[-1]
    heave = np.empty(count)
    heave[-1] = system.heave @ xs
    for k in range(count - 2, -1, -1):
        C = np.linalg.solve(P_before[k + 1], F @ P_after[k]).T
        xs = x_after[k] + C @ (xs - x_before[k + 1])
        Ps = P_after[k] + C @ (Ps - P_before[k + 1]) @ C.T
        heave[k] = system.heave @ xs
    return heave, float(system.heave @ Ps @ system.heave)


def filtered(system: SeaSystem, steady: Steady, a: Array) -> tuple[Array, Array, Array]:
    """States before each sample (k, n), predicted heave (k,), innovations (k,)."""
    x, before, innovations = np.zeros(len(system.H)), [], []
    for z in a.tolist():
        before.append(x)
        innovations.append(z - float(system.H @ x))
        x = steady.F @ (x + steady.K * innovations[-1])
    return np.array(before), np.array(before) @ system.heave, np.array(innovations)


def test_it_is_the_textbooks_smoother(system: SeaSystem, steady: Steady) -> None:
    _, a = simulated(system, DT_S, 1200, seed=3)
    before, predicted, innovations = filtered(system, steady, a)
    smoother = FixedLagSmoother(system, steady, LAG_S)
    lag = round(LAG_S / DT_S)
    sigma = float(np.sqrt(system.heave @ system.stationary @ system.heave))
    for k in range(len(a)):
        smoother.push(k * DT_S, predicted[k], innovations[k])
        delayed = smoother.value()
        assert (delayed is None) == (k < lag)
        if delayed is not None and k % 97 == 0:
            first = k - lag
            heave, variance = rauch_tung_striebel(system, steady, before[first], a[first : k + 1])
            assert delayed.t_s == pytest.approx(first * DT_S)
            assert delayed.heave_m == pytest.approx(heave[0], abs=1e-8 * sigma)
            assert delayed.std_m == pytest.approx(np.sqrt(variance), rel=1e-5)


def test_its_errors_are_as_large_as_it_says_and_smaller_than_in_real_time(system: SeaSystem, steady: Steady) -> None:
    states, a = simulated(system, DT_S, 20_000, seed=4)
    live = SeaFilter(system, steady, 0.0, states[0], None)
    smoother = FixedLagSmoother(system, steady, LAG_S)
    errors, realtime = [], []
    for k in range(1, len(a)):
        smoother.push(k * DT_S, *live.step(k * DT_S, a[k]))
        realtime.append(float(system.heave @ (live.x - states[k])))
        if k > 600 and (delayed := smoother.value()) is not None:
            errors.append(delayed.heave_m - float(system.heave @ states[round(delayed.t_s / DT_S)]))
    assert np.std(errors) == pytest.approx(smoother.std_m, rel=0.15)
    assert np.std(errors) < 0.7 * np.std(realtime[600:])


def test_while_a_hole_is_felt_nothing_is_said(system: SeaSystem, steady: Steady) -> None:
    """Neither in the hole nor before it, for as long as the weights reach into it by more than a short hole."""
    _, a = simulated(system, DT_S, 500, seed=5)
    _, predicted, innovations = filtered(system, steady, a)
    smoother, whole = (FixedLagSmoother(system, steady, LAG_S) for _ in range(2))
    lag, short = round(LAG_S / DT_S), round(TUNING.short_s / DT_S)
    hole = range(250, 270)
    said = set()
    for k in range(500):
        whole.push(k * DT_S, predicted[k], innovations[k])
        smoother.push(k * DT_S, *((nan, 0.0) if k in hole else (predicted[k], innovations[k])))
        if (delayed := smoother.value()) is not None:
            said.add(round(delayed.t_s / DT_S))
            assert delayed == whole.value() or k in hole[:short]
    assert set(range(500 - lag)) - said == set(range(hole[0] + short - lag, hole[-1] + 1))


@pytest.mark.parametrize("nth", [100, 40])
def test_readings_that_are_missing_now_and_then_are_hardly_felt(system: SeaSystem, steady: Steady, nth: int) -> None:
    """As the filter takes the others; there is a delayed heave for nearly all of them, and it is as good as it says."""
    states, a = simulated(system, DT_S, 20_000, seed=4)
    live, smoother = SeaFilter(system, steady, 0.0, states[0], None), FixedLagSmoother(system, steady, LAG_S)
    errors = []
    for k in range(1, len(a)):
        if k % nth:
            predicted_m, innovation = live.step(k * DT_S, a[k])
            is_usual = live.innovation_variance < 1.2 * steady.S
            smoother.push(k * DT_S, predicted_m if is_usual else nan, innovation)
        else:
            smoother.push(k * DT_S, nan, 0.0)
        if k > 600 and (delayed := smoother.value()) is not None:
            errors.append(delayed.heave_m - float(system.heave @ states[round(delayed.t_s / DT_S)]))
    assert len(errors) > 0.9 * (len(a) - 600)
    assert np.std(errors) == pytest.approx(smoother.std_m, rel=0.15)


def test_a_record_fills_it_as_samples_would(system: SeaSystem, steady: Steady) -> None:
    _, a = simulated(system, DT_S, 400, seed=6)
    _, predicted, innovations = filtered(system, steady, a)
    one, other = (FixedLagSmoother(system, steady, LAG_S) for _ in range(2))
    for k in range(400):
        one.push(k * DT_S, predicted[k], innovations[k])
    other.fill(399 * DT_S, predicted, innovations)
    a_value, b_value = one.value(), other.value()
    assert a_value is not None
    assert b_value is not None
    assert a_value.heave_m == pytest.approx(b_value.heave_m, abs=1e-12)
    assert a_value.t_s == pytest.approx(b_value.t_s)
    assert FixedLagSmoother(system, steady, LAG_S).value() is None


COARSE_S = 0.2
HOLES = {"none": (), "one": ((20, 30),), "many": ((3, 4), (10, 13), (25, 40), (52, 53))}


@pytest.mark.parametrize("name", HOLES)
def test_across_holes_it_is_the_conditional_mean_given_all_samples(name: str) -> None:
    system = SeaSystem(model(stages=4))
    steady = system.steady(COARSE_S)
    assert steady is not None
    count, n = 60, len(system.H)
    _, a = simulated(system, COARSE_S, count, seed=9)
    known = np.ones(count, dtype=bool)
    for first, end in HOLES[name]:
        known[first:end] = False
    f = SeaFilter(system, steady, 0.0, np.zeros(n), system.stationary.copy())
    found = smoothed(f, EvenRecord(COARSE_S * count, COARSE_S, a, known), count)
    # cov(x_i, x_j) = F^(i-j) P_j; all states side by side.
    F, Q = system.transition(COARSE_S)
    P, powers = [F @ system.stationary @ F.T + Q], [np.eye(n)]
    for _ in range(count - 1):
        P.append(F @ P[-1] @ F.T + Q)
        powers.append(F @ powers[-1])
    H, heave, R = system.H, system.heave, measurement_variance(system.model.noise_psd, COARSE_S)
    zz, hz = np.empty((count, count)), np.empty((count, count))
    for i in range(count):
        for j in range(count):
            joint = powers[i - j] @ P[j] if i >= j else P[i] @ powers[j - i].T
            zz[i, j], hz[i, j] = H @ joint @ H, heave @ joint @ H
    zz = zz[np.ix_(known, known)] + R * np.eye(int(known.sum()))
    hz = hz[np.ix_(known, known)]
    mean = hz @ np.linalg.solve(zz, a[known])
    variance = np.array([heave @ P[i] @ heave for i in np.flatnonzero(known)])
    variance -= np.sum(hz * np.linalg.solve(zz, hz.T).T, axis=1)
    assert found[:, 0] == pytest.approx(COARSE_S * (1.0 + np.flatnonzero(known)))
    np.testing.assert_allclose(found[:, 1], mean, atol=1e-5)
    np.testing.assert_allclose(found[:, 2], np.sqrt(variance), rtol=1e-3)
    assert len(smoothed(f, EvenRecord(COARSE_S * count, COARSE_S, a, known), 10)) == known[:10].sum()
