"""Heave at any moment near the last sample: against the exponential of the whole matrix, and F P F' + Q."""

import numpy as np
import pytest
from scipy.linalg import expm
from seas import model, whole

from heaved.estimation.heave.sea.model import SeaSystem
from heaved.estimation.heave.sea.propagate import ORDER, TUNING, Propagation

AHEAD_S = 8.0


@pytest.fixture(scope="module", params=[(4, 2), (8, 3)], ids=str)
def system(request: pytest.FixtureRequest) -> SeaSystem:
    return SeaSystem(model(*request.param))


@pytest.fixture(scope="module")
def propagation(system: SeaSystem) -> Propagation:
    return Propagation(system, AHEAD_S)


def test_rows_are_those_of_the_exponential(system: SeaSystem, propagation: Propagation) -> None:
    """Heave and its first three derivatives at random moments of either sign, for states of the sea itself."""
    rng = np.random.default_rng(1)
    taus = [*rng.uniform(-TUNING.back_s, AHEAD_S, 12).tolist(), 0.0, -TUNING.back_s, AHEAD_S]
    found = propagation.derivatives(taus)
    assert found.shape == (len(taus), ORDER, len(system.H))
    spread = np.sqrt(np.diag(system.stationary))
    for rows, tau in zip(found, taus, strict=True):
        F = expm(system.A * tau)
        factorial, row = 1.0, system.heave @ F
        for order in range(4):
            factorial *= max(order, 1)
            scale = np.linalg.norm(row * spread)
            assert np.linalg.norm((rows[order] * factorial - row) * spread) < 2e-6 * scale
            row = row @ system.A


def test_any_moment_from_the_state_is_that_of_the_exponential(system: SeaSystem, propagation: Propagation) -> None:
    """Heave and velocity from the series of one state, and heave as a row."""
    rng = np.random.default_rng(2)
    spread = np.sqrt(np.diag(system.stationary))
    x = spread * rng.standard_normal(len(spread))
    series = propagation.series(x)
    for tau in (*rng.uniform(-0.5, AHEAD_S, 12).tolist(), 0.0, 0.025, AHEAD_S):
        F = expm(system.A * tau)
        found = propagation.along(series, tau)
        heave, velocity = system.heave @ F, system.velocity @ F
        assert found.heave_m == pytest.approx(heave @ x, abs=1e-5 * float(np.linalg.norm(heave * spread)))
        assert found.velocity_mps == pytest.approx(velocity @ x, abs=1e-5 * float(np.linalg.norm(velocity * spread)))
        assert propagation.row(tau) @ x == pytest.approx(
            found.heave_m, abs=1e-9 * float(np.linalg.norm(heave * spread))
        )


def test_heave_between_beats_is_carried_on(system: SeaSystem, propagation: Propagation) -> None:
    """The series of derivatives over factorials reaches 60 ms on."""
    rows = propagation.derivatives([0.5])[0]
    d = 0.06
    carried = sum(rows[k] * d**k for k in range(ORDER))
    expected = system.heave @ expm(system.A * (0.5 + d))
    spread = np.sqrt(np.diag(system.stationary))
    assert np.linalg.norm((carried - expected) * spread) < 1e-5 * np.linalg.norm(expected * spread)


def test_what_is_unknown_ahead_is_the_brute_force_covariance(system: SeaSystem, propagation: Propagation) -> None:
    steady = system.steady(0.05)
    assert steady is not None
    P = steady.P - np.outer(steady.K, steady.K) * steady.S
    stds = propagation.stds(P)
    for tau in (0.0, 0.05, 0.15, 0.5, 1.0, 2.0, 5.0, 7.5):
        F, Q = (np.eye(len(P)), np.zeros_like(P)) if tau == 0.0 else whole(system, tau)
        expected = np.sqrt(system.heave @ (F @ P @ F.T + Q) @ system.heave)
        assert propagation.between(stds.tolist(), (tau,))[0] == pytest.approx(expected, rel=3e-3)
    taus = (-TUNING.back_s, -0.02, 0.0, 0.777, AHEAD_S)
    assert propagation.stds_at(P, taus) == pytest.approx(propagation.between(stds.tolist(), taus))
    sigma = np.sqrt(system.heave @ system.stationary @ system.heave)
    assert propagation.between(stds.tolist(), (AHEAD_S,))[0] < sigma


def test_a_place_between_two_is_on_the_line_and_ends_are_ends(propagation: Propagation) -> None:
    count = len(propagation.stds(np.zeros((len(propagation.row(0.0)),) * 2)))
    moments = (-TUNING.back_s + TUNING.step_s * np.arange(count)).tolist()
    within = (-TUNING.back_s, -0.02, 0.0, 0.0125, 0.777, moments[-2] + 0.3 * TUNING.step_s, moments[-1])
    assert propagation.between(moments, within) == pytest.approx(within, abs=1e-12)
    assert propagation.between(moments, (-100.0, 1e9)) == [moments[0], moments[-1]]
    squares = [moment**2 for moment in moments]
    assert propagation.between(squares, (0.25 * TUNING.step_s,)) == pytest.approx([0.25 * TUNING.step_s**2], abs=1e-12)
