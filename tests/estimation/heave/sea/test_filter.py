"""The live filter against the textbook's and the sigma-point core's, on samples that come as they please."""

from __future__ import annotations

import numpy as np
import pytest
from seas import Kalman, model, simulated

from heaved.estimation.heave.sea.filter import TUNING, GaugeError, SeaFilter
from heaved.estimation.heave.sea.model import SeaSystem, measurement_variance

DT_S = 0.05
Array = np.ndarray


@pytest.fixture(scope="module")
def system() -> SeaSystem:
    return SeaSystem(model(4, 2))


@pytest.fixture(scope="module")
def sea(system: SeaSystem) -> tuple[Array, Array, Array]:
    """Times (n,), heave (n,) and samples (n,) of 300 s at 20 Hz."""
    states, a = simulated(system, DT_S, 6000, seed=11)
    return DT_S * np.arange(1, 6001), states @ system.heave, a


def cold(system: SeaSystem) -> SeaFilter:
    steady = system.steady(DT_S)
    assert steady is not None
    return SeaFilter(system, steady, 0.0, np.zeros(len(system.H)), system.stationary.copy())


def heave_std(system: SeaSystem) -> float:
    return float(np.sqrt(system.heave @ system.stationary @ system.heave))


def irregular(seed: int = 1) -> Array:
    """Indices into the record: a tenth is missing, a hole of 4 s, one of 0.3 s."""
    rng = np.random.default_rng(seed)
    kept = rng.random(1200) > 0.1
    kept[400:480] = False
    kept[700:706] = False
    return np.flatnonzero(kept)


def test_it_is_the_textbooks_kalman_filter(system: SeaSystem, sea: tuple[Array, Array, Array]) -> None:
    """With missing samples and gaps, to rounding: heave, innovation and covariance at every sample."""
    t, _, a = sea
    ours = cold(system)
    theirs = Kalman(system, ours.x, system.stationary, measurement_variance(1e-6, DT_S))
    sigma_m, last = heave_std(system), 0.0
    cache: dict[int, tuple[Array, Array]] = {}
    for i in irregular().tolist():
        steps = round((t[i] - last) / DT_S)
        if steps not in cache:
            cache[steps] = system.transition(steps * DT_S)
        F, Q = cache[steps]
        theirs.x, theirs.P = F @ theirs.x, F @ theirs.P @ F.T + Q
        last = t[i]
        before, y = theirs.update(a[i])
        predicted, innovation = ours.step(t[i], a[i])
        assert abs(predicted - before) < 1e-7 * sigma_m
        assert abs(innovation - y) < 1e-7
        assert abs(system.heave @ (ours.x - theirs.x)) < 1e-7 * sigma_m
        assert np.max(np.abs(ours.covariance - theirs.P)) < 1e-7 * np.max(theirs.P)


def test_the_steady_gain_is_used_when_it_makes_no_difference(
    system: SeaSystem, sea: tuple[Array, Array, Array]
) -> None:
    t, _, a = sea
    ours = cold(system)
    theirs = Kalman(system, ours.x, system.stationary, measurement_variance(1e-6, DT_S))
    F, Q = system.transition(DT_S)
    sigma_m = heave_std(system)
    entered = 0
    for i in range(6000):
        was = ours.covariance.copy()
        predicted, _ = ours.step(t[i], a[i])
        theirs.x, theirs.P = F @ theirs.x, F @ theirs.P @ F.T + Q
        before, _ = theirs.update(a[i])
        if ours.is_steady and not entered:
            entered = i
            assert np.max(np.abs(np.diag(theirs.P) / np.diag(ours.covariance) - 1.0)) < 1e-6
            assert np.max(np.abs(np.diag(was) / np.diag(ours.covariance) - 1.0)) < 1e-6
        if entered:
            assert ours.is_steady
            assert abs(predicted - before) < 1e-9 * sigma_m
    assert 200 < entered < 5900


def test_a_start_at_another_rate_than_that_of_the_model_knows_what_it_says() -> None:
    """Samples 40 ms apart for a filter made for 50: as near to the exact filter as it says, while its deviations fall
    by a thousand. (With the covariance moved on by 50 ms the bias was off by ten of them.)
    """
    rng = np.random.default_rng(8)
    system, dt_s = SeaSystem(model(7, 1)), 0.04
    F, Q = system.transition(dt_s)
    drive = np.linalg.cholesky(Q + 1e-18 * np.eye(len(Q)))
    R = measurement_variance(1e-6, DT_S)
    roots, turned = np.linalg.eigh(system.stationary)
    state = turned @ (np.sqrt(np.maximum(roots, 0.0)) * rng.standard_normal(len(roots)))
    state[-1] = 0.03
    ours = cold(system)
    theirs = Kalman(system, ours.x, system.stationary, R)
    worst = 0.0
    for i in range(1, 750):
        state = F @ state + drive @ rng.standard_normal(len(state))
        a = float(system.H @ state + np.sqrt(R) * rng.standard_normal())
        theirs.x, theirs.P = F @ theirs.x, F @ theirs.P @ F.T + Q
        theirs.update(a)
        ours.step(i * dt_s, a)
        if i * dt_s > 8.0:
            for row in (system.heave, np.eye(len(state))[-1]):
                std = float(np.sqrt(row @ theirs.P @ row))
                worst = max(worst, abs(float(row @ (ours.x - theirs.x))) / std)
                assert 0.95 < float(np.sqrt(row @ ours.covariance @ row)) / std < 1.3
    assert worst < 0.5


def test_jitter_of_the_sampling_is_far_below_what_is_not_known(system: SeaSystem) -> None:
    """Times off by up to 5 % of the interval, on a path known in between: the exact steps against ours."""
    rng = np.random.default_rng(5)
    even, count = 6000, 400
    late = np.where(np.arange(even + count) < even, 0.0, rng.uniform(-0.05, 0.05, even + count))
    t = DT_S * (np.arange(1, even + count + 1) + late)
    a = 0.5 * np.sin(0.9 * t) + 0.2 * np.sin(1.3 * t + 1.0) + 5e-3 * rng.standard_normal(len(t))
    ours = cold(system)
    for i in range(even):
        ours.step(t[i], a[i])
    assert ours.is_steady
    theirs = Kalman(system, ours.x, ours.covariance, measurement_variance(1e-6, DT_S))
    worst = 0.0
    for i in range(even, even + count):
        F, Q = system.transition(t[i] - t[i - 1])
        theirs.x, theirs.P = F @ theirs.x, F @ theirs.P @ F.T + Q
        theirs.update(a[i])
        ours.step(t[i], a[i])
        worst = max(worst, abs(float(system.heave @ (ours.x - theirs.x))))
    assert ours.rejected == 0
    known_m = float(np.sqrt(system.heave @ theirs.P @ system.heave))
    assert worst < 1e-3 * heave_std(system)
    assert worst < 0.1 * known_m


@pytest.mark.parametrize("gap_s", [0.3, 2.0, 10.0, 40.0, 300.0])
def test_in_a_gap_the_covariance_grows_as_the_waves_forget(
    gap_s: float, system: SeaSystem, sea: tuple[Array, Array, Array]
) -> None:
    """F P F' + Q after the gap, less one measurement; at its end no more is unknown than at the very start."""
    t, _, a = sea
    ours = SeaFilter(system, system.steady(DT_S), 0.0, np.zeros(len(system.H)), None)  # type: ignore[arg-type]
    for i in range(400):
        ours.step(t[i], a[i])
    theirs = Kalman(system, ours.x, ours.covariance, measurement_variance(1e-6, DT_S))
    theirs.predict(gap_s)
    P = theirs.P.copy()
    expected = float(system.H @ theirs.x)
    theirs.update(expected)
    ours.step(t[399] + gap_s, expected)
    assert np.max(np.abs(ours.covariance - theirs.P)) < 1e-7 * np.max(P)
    assert np.all(np.diag(P)[:-1] <= 1.0001 * np.diag(system.stationary)[:-1])
    assert ours.is_sound()


def test_after_a_long_gap_it_stays_sound() -> None:
    """The default size of the model, and a chain that is damped as much as a fit may say."""
    m = model(8, 3)
    damped = type(m)(**{**{f: getattr(m, f) for f in m.__struct_fields__}, "damping": (0.3, 0.2, 1.0)})
    system = SeaSystem(damped)
    steady = system.steady(DT_S)
    assert steady is not None
    states, a = simulated(system, DT_S, 2400, seed=2)
    for gap_s in (10.0, 20.0, 59.0):
        ours = SeaFilter(system, steady, 0.0, np.zeros(49), None)
        for i in range(2400):
            if i * DT_S <= 20.0 or i * DT_S > 20.0 + gap_s:
                ours.step((i + 1) * DT_S, a[i])
                assert ours.is_sound()
        assert abs(system.heave @ (ours.x - states[-1])) < 0.6 * heave_std(system)


def test_a_spike_is_kept_out_and_costs_its_own_sample(system: SeaSystem, sea: tuple[Array, Array, Array]) -> None:
    t, _, a = sea
    with_spike, without = cold(system), cold(system)
    for i in range(2000):
        predicted, _ = with_spike.step(t[i], a[i] + (2.0 if i == 1500 else 0.0))
        if i == 1500:
            kept_out = with_spike.rejected
            assert kept_out == 1
            continue
        before, _ = without.step(t[i], a[i])
        assert predicted == pytest.approx(before, abs=1e-7)
    assert (with_spike.rejected, without.rejected) == (1, 0)


def test_what_lasts_is_taken_after_ten_samples_and_nothing_is_thought_known(
    system: SeaSystem, sea: tuple[Array, Array, Array]
) -> None:
    t, _, a = sea
    ours = cold(system)
    for i in range(2000):
        ours.step(t[i], a[i])
    trusted = float(system.heave @ ours.covariance @ system.heave)
    for i in range(2000, 2000 + TUNING.gate_lasts):
        assert ours.step(t[i], a[i] + 3.0)[1] == 0.0
    assert ours.rejected == TUNING.gate_lasts
    assert ours.step(t[2010], a[2010] + 3.0)[1] != 0.0
    assert ours.rejected == TUNING.gate_lasts
    assert float(system.heave @ ours.covariance @ system.heave) > 100.0 * trusted
    assert ours.surprise > 9.0
    for i in range(2011, 6000):
        ours.step(t[i], a[i] + 3.0)
    assert ours.rejected < 2 * TUNING.gate_lasts
    assert ours.x[-1] == pytest.approx(3.0, abs=0.01)
    assert ours.surprise < 3.0


def test_innovations_are_as_large_as_they_are_said_to_be(system: SeaSystem, sea: tuple[Array, Array, Array]) -> None:
    t, heave, a = sea
    ours = cold(system)
    errors, innovations, surprises = [], [], []
    for i in range(6000):
        _, y = ours.step(t[i], a[i])
        if i > 2400:
            errors.append(float(system.heave @ ours.x) - heave[i])
            innovations.append(y)
            surprises.append(ours.surprise)
    steady = ours.steady
    assert np.var(innovations) == pytest.approx(steady.S, rel=0.15)
    std = float(np.sqrt(system.heave @ ours.covariance @ system.heave))
    assert 0.5 * std < np.std(errors) < 1.6 * std
    assert max(surprises) < 9.0
    assert ours.rejected == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_what_is_no_number_never_gets_in(bad: float, system: SeaSystem, sea: tuple[Array, Array, Array]) -> None:
    t, _, a = sea
    ours = cold(system)
    for i in range(600):
        ours.step(t[i], bad if 300 <= i < 305 else a[i])
    assert ours.is_sound()
    assert ours.rejected == 5


def test_the_error_of_a_gauge_is_estimated_as_by_the_textbooks_augmented_filter(
    system: SeaSystem, sea: tuple[Array, Array, Array]
) -> None:
    """One state of sea, constant, scale and time with one covariance matrix; readings between and at the samples."""
    t, heave_m, a = sea
    n, rng, R = len(system.H), np.random.default_rng(5), measurement_variance(1e-6, DT_S)
    ours = cold(system)
    ours.gauge = GaugeError.at_first(12.1, n)
    x = np.concatenate((ours.x, ours.gauge.value))
    P = np.zeros((n + 3, n + 3))
    P[:n, :n], P[n:, n:] = system.stationary, ours.gauge.V

    def update(y: float, row: Array, noise2: float) -> tuple[Array, Array]:
        K = P @ row / (row @ P @ row + noise2)
        I_KH = np.eye(n + 3) - np.outer(K, row)
        return x + K * y, I_KH @ P @ I_KH.T + noise2 * np.outer(K, K)

    F, Q = np.eye(n + 3), np.zeros((n + 3, n + 3))
    F[:n, :n], Q[:n, :n] = system.transition(DT_S)
    sample = np.concatenate((system.H, np.zeros(3)))
    back, _ = system.transition(0.02)
    rows = (system.heave, system.heave @ np.linalg.inv(back))
    for i in range(1200):
        ours.step(t[i], a[i])
        x, P = F @ x, F @ P @ F.T + Q
        x, P = update(a[i] - sample @ x, sample, R)
        if i % 3 == 0:
            row = rows[i % 2]
            laser_m = 12.0 + 1.02 * heave_m[i] + 0.002 * rng.standard_normal()
            ours.gauge.wander(3.0 * DT_S)
            P[n:, n:] += np.diag(np.square(TUNING.wanders)) * 3.0 * DT_S / 60.0
            moving = row @ system.A
            expected_m = x[n] + (1.0 + x[n + 1]) * (row @ x[:n]) + x[n + 2] * (moving @ x[:n])
            jacobian = np.append((1.0 + x[n + 1]) * row + x[n + 2] * moving, [1.0, row @ x[:n], moving @ x[:n]])
            y, variance = ours.laser_innovation(row, laser_m)
            assert (y, variance) == pytest.approx((laser_m - expected_m, jacobian @ P @ jacobian), rel=1e-6, abs=1e-9)
            ours.aid(row, laser_m, 4e-6)
            x, P = update(laser_m - expected_m, jacobian, 4e-6)
        assert ours.x == pytest.approx(x[:n], rel=1e-6, abs=1e-7)
        assert ours.gauge.value == pytest.approx(x[n:], rel=1e-6, abs=1e-7)
    assert ours.rejected == 0
    assert ours.gauge.value[1] == pytest.approx(0.02, abs=3.0 * float(np.sqrt(P[n + 1, n + 1])))
    joint = np.block([[ours.covariance, ours.gauge.c], [ours.gauge.c.T, ours.gauge.V]])
    assert joint == pytest.approx(P, rel=1e-5, abs=1e-9)
