"""The sea as a state space: against integrals of its spectrum, general matrix equations, and a realisation."""

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are
from scipy.signal import welch
from seas import model, simulated, stationary, whole

from heaved.estimation.heave.sea.model import SeaSystem, heave_std, measurement_variance

SIZES = [(4, 1), (5, 1), (6, 2), (8, 3)]


@pytest.mark.parametrize(("stages", "chains"), SIZES)
def test_variances_are_the_integrals_of_the_spectrum(stages: int, chains: int) -> None:
    m = model(stages, chains)
    system = SeaSystem(m)
    f = np.geomspace(1e-3, 100.0, 200_001)
    S = m.heave_spectrum(f)
    P = system.stationary
    assert system.heave @ P @ system.heave == pytest.approx(np.trapezoid(S, f), rel=1e-4)
    assert heave_std(m) ** 2 == pytest.approx(np.trapezoid(S, f), rel=1e-4)
    assert system.velocity @ P @ system.velocity == pytest.approx(np.trapezoid((2 * np.pi * f) ** 2 * S, f), rel=1e-4)
    waves = system.H.copy()
    waves[-1] = 0.0
    found = float(waves @ P @ waves)
    assert found == pytest.approx(np.trapezoid((2 * np.pi * f) ** 4 * S, f), rel=1e-3)


def test_the_spectrum_is_that_of_the_formula_at_its_peak_and_far_from_it() -> None:
    m = model(6, 1)
    assert m.heave_spectrum(np.array([0.15]))[0] == pytest.approx(3.0)
    low, high = m.heave_spectrum(np.array([0.0015, 15.0]))
    c = (2 * 0.3) ** 12 * 3.0
    assert low == pytest.approx(c * 0.01**12, rel=0.01, abs=0.0)
    assert high == pytest.approx(c * 100.0**-12, rel=0.01, abs=0.0)
    noise = m.acceleration_spectrum(np.array([1e-4, 40.0]), 0.01)
    assert noise[0] == pytest.approx(1e-6 + 2 * 9e-10 / (2 * np.pi * 1e-4) ** 2, rel=1e-6)
    assert noise[1] == pytest.approx(1e-6, rel=1e-3)


@pytest.mark.parametrize("stages", [4, 7])
def test_the_state_space_has_the_spectrum_of_the_formula(stages: int) -> None:
    """|c (i w - A)^-1 g|^2, the textbook's transfer function, from far below the peak to far above."""
    m = model(stages, 1)
    system = SeaSystem(m)
    A, g, c = system.A[:-1, :-1], np.sqrt(system.diffusion[:-1]), system.heave[:-1]
    f = np.geomspace(0.03, 1.5, 30)
    transfer = np.array([c @ np.linalg.solve(2j * np.pi * w * np.eye(len(A)) - A, g) for w in f])
    assert 2.0 * np.abs(transfer) ** 2 == pytest.approx(m.heave_spectrum(f), rel=1e-6, abs=0.0)


@pytest.mark.parametrize(("stages", "chains"), SIZES)
def test_the_stationary_covariance_solves_lyapunovs_equation(stages: int, chains: int) -> None:
    system = SeaSystem(model(stages, chains))
    P, expected = system.stationary[:-1, :-1], stationary(system)
    assert np.max(np.abs(P - expected)) < 1e-9 * np.max(expected)


@pytest.mark.parametrize("dt_s", [0.01, 0.05, 0.3, 2.0, 10.0, 60.0])
@pytest.mark.parametrize(("stages", "chains"), [(4, 1), (8, 3)])
def test_a_step_is_the_exponential_of_the_whole(stages: int, chains: int, dt_s: float) -> None:
    system = SeaSystem(model(stages, chains))
    F, Q = system.transition(dt_s)
    expected_F, expected_Q = whole(system, dt_s)
    assert np.max(np.abs(F - expected_F)) < 1e-10 * np.max(np.abs(expected_F))
    scale = np.sqrt(np.outer(np.diag(expected_Q), np.diag(expected_Q)))
    assert np.max(np.abs(Q - expected_Q)) < 1e-9 * np.max(np.diag(expected_Q))
    if dt_s >= 0.3:  # below, the far ends of a chain have hardly heard of the noise
        assert np.max(np.abs(Q - expected_Q) / scale) < 1e-4
    P = system.stationary[:-1, :-1]
    assert np.max(np.abs((F[:-1, :-1] @ P @ F[:-1, :-1].T + Q[:-1, :-1]) - P)) < 1e-9 * np.max(P)


@pytest.mark.parametrize("dt_s", [0.05, 8.0, 10.0, 20.0, 60.0, 600.0])
def test_the_noise_of_any_step_is_a_covariance(dt_s: float) -> None:
    """A chain as damped as a fit may make it, and a step as long as a gap may be."""
    m = model(8, 3)
    damped = type(m)(**{**{f: getattr(m, f) for f in m.__struct_fields__}, "damping": (1.0, 1.0, 1.0)})
    system = SeaSystem(damped)
    _, Q = system.transition(dt_s)
    assert np.all(np.diag(Q) >= 0.0)
    assert np.min(np.linalg.eigvalsh(Q)) > -1e-12 * np.max(Q)
    assert np.all(np.diag(Q)[:-1] <= np.diag(system.stationary)[:-1] * (1 + 1e-9))


@pytest.mark.parametrize("tau_s", [-2.0, -0.05, 0.7, 5.0])
def test_moved_is_the_exponential_for_either_sign(tau_s: float) -> None:
    system = SeaSystem(model(6, 2))
    expected = expm(system.A * tau_s)
    assert np.max(np.abs(system.moved(tau_s) - expected)) < 1e-10 * np.max(np.abs(expected))


@pytest.mark.parametrize("dt_s", [0.05, 0.1])
@pytest.mark.parametrize(("stages", "chains"), [(4, 1), (5, 1), (4, 2)])
def test_the_steady_filter_solves_the_riccati_equation(stages: int, chains: int, dt_s: float) -> None:
    system = SeaSystem(model(stages, chains))
    steady = system.steady(dt_s)
    assert steady is not None
    F, Q = system.transition(dt_s)
    R = measurement_variance(system.model.noise_psd, dt_s)
    assert pytest.approx(system.model.noise_psd / (2 * dt_s)) == R
    P = solve_discrete_are(F.T, system.H[:, None], Q, np.array([[R]]))
    assert np.max(np.abs(steady.P - P)) < 1e-5 * np.max(np.abs(P))
    assert pytest.approx(system.H @ P @ system.H + R, rel=1e-6) == steady.S
    assert system.heave @ steady.P @ system.heave == pytest.approx(system.heave @ P @ system.heave, rel=1e-4)


def test_the_steady_covariance_of_a_large_model_is_a_fixed_point() -> None:
    """The general solver loses its digits at 49 states; the equation itself does not."""
    system = SeaSystem(model(8, 3))
    steady = system.steady(0.05)
    assert steady is not None
    after = steady.P - np.outer(steady.K, steady.K) * steady.S
    again = steady.F @ after @ steady.F.T + steady.Q
    assert np.max(np.abs(again - steady.P)) < 1e-9 * np.max(np.abs(steady.P))
    assert pytest.approx(steady.P @ system.H / steady.S, rel=1e-9) == steady.K
    same = system.steady_of(0.05, steady.P)
    for ours, theirs in ((same.F, steady.F), (same.Q, steady.Q), (same.P, steady.P), (same.K, steady.K)):
        np.testing.assert_array_equal(ours, theirs)
    assert (same.dt_s, same.S) == (0.05, steady.S)


def test_a_realisation_has_the_spectrum() -> None:
    """Welch over 10 000 s in bands: some 200 independent ordinates each give it to a tenth."""
    system = SeaSystem(model(6, 2))
    states, _ = simulated(system, 0.1, 100_000, seed=3)
    f, S = welch(states @ system.heave, 10.0, nperseg=2000)
    expected = system.model.heave_spectrum(np.maximum(f, 1e-9))
    for low, high in ((0.07, 0.11), (0.11, 0.14), (0.14, 0.18), (0.18, 0.25)):
        band = (f >= low) & (f < high)
        assert np.mean(S[band]) == pytest.approx(np.mean(expected[band]), rel=0.25)


def test_acceleration_and_velocity_are_derivatives_along_a_path() -> None:
    """Without noise: second differences of heave over 1 ms, against the rows."""
    system = SeaSystem(model(6, 2))
    x = np.random.default_rng(4).standard_normal(len(system.H))
    x[-1] = 0.0
    h = 1e-3
    before, now, after = (float(system.heave @ expm(system.A * tau) @ x) for tau in (-h, 0.0, h))
    assert (after - before) / (2 * h) == pytest.approx(system.velocity @ x, rel=1e-4)
    assert (after - 2 * now + before) / h**2 == pytest.approx(system.H @ x, rel=1e-4)
    bias = np.zeros(len(x))
    bias[-1] = 1.0
    assert [float(row @ bias) for row in (system.H, system.heave, system.velocity)] == [1.0, 0.0, 0.0]
