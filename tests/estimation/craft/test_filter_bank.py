"""The bank of filters: against its filters one by one, and on a linear model against a textbook IMM."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.stats import multivariate_normal

from heaved.estimation.common import sigma
from heaved.estimation.craft import filter_bank as bank
from heaved.estimation.craft.dynamics import Vessel
from heaved.estimation.craft.filter_bank import Bank
from heaved.estimation.craft.model import CraftModel, State
from heaved.estimation.craft.wave_force import Sea, WaveShape, propagation

Array = NDArray[np.float64]
N, OBSERVED = 5, (0, 2)
SETS = [sigma.cubature(N), sigma.spherical_simplex(N), sigma.symmetric(N)]


def covariance(n: int, rng: np.random.Generator, scale: float = 1.0) -> Array:
    root = rng.normal(size=(n, n))
    return scale * (root @ root.T / n + 0.2 * np.eye(n))


def swing(rows: Array) -> Array:
    """A nonlinear model, rows (k, N) -> (k, N)."""
    return np.stack([np.sin(rows[:, i]) + 0.3 * rows[:, (i + 1) % N] * rows[:, (i + 2) % N] for i in range(N)], axis=1)


def symmetric(bank_P: Array) -> Array:
    return 0.5 * (bank_P + bank_P.transpose(0, 2, 1))


def test_the_bank_is_its_filters_one_by_one() -> None:
    """Different point sets, different noises, a nonlinear model; two readings taken one by one are the pair."""
    rng = np.random.default_rng(1)
    start = Bank(rng.normal(size=(3, N)), symmetric(np.array([covariance(N, rng, 0.2) for _ in SETS])))
    Q = symmetric(np.array([covariance(N, rng, 0.05) for _ in SETS]))
    R, H = np.array([0.1, 0.3]), np.eye(N)[list(OBSERVED)]
    points = bank.stack(SETS)
    together, alone = start, [(start.x[i], start.P[i]) for i in range(3)]
    for _ in range(30):
        reading = rng.normal(size=2)
        moved = bank.predict(points, together, lambda columns: swing(columns.T).T, Q)
        assert moved is not None
        for i, state in enumerate(OBSERVED):
            moved = bank.update(moved, state, reading[i] - moved.x[:, state], moved.P[:, state, state] + R[i])
        together = moved
        for i, (x, P) in enumerate(alone):
            predicted = sigma.predict(SETS[i], x, P, swing, Q[i])
            assert predicted is not None
            updated = sigma.update(SETS[i], predicted.x, predicted.P, reading, H, np.diag(R))
            assert updated is not None
            alone[i] = (updated.x, updated.P)
            np.testing.assert_allclose(together.x[i], updated.x, rtol=0, atol=1e-11)
            np.testing.assert_allclose(together.P[i], updated.P, rtol=0, atol=1e-11)


def test_the_craft_alone_is_the_craft_in_a_bank() -> None:
    """The model that is really used: three seas at once, and each by the sigma-point core."""
    seas = [Sea(heave_rms_mps2=rms, pitch_rms_radps2=0.1 * rms) for rms in (0.3, 0.9, 2.5)]
    points, flaps = sigma.cubature(len(State)), np.array([[0.05], [-0.03]])
    model = CraftModel(Vessel(), WaveShape(), seas, (0.02, 0.002))
    together = model.start((0.2, 0.02), (0.01, 1e-4), 18.0)
    singles = [CraftModel(Vessel(), WaveShape(), [sea], (0.02, 0.002)) for sea in seas]
    alone = [Bank(together.x[i : i + 1], together.P[i : i + 1]) for i in range(3)]
    for _ in range(40):
        moved = model.predict(bank.stack([points] * 3), together, 0.05, 18.0, flaps)
        assert moved is not None
        together = moved
        for i, single in enumerate(singles):
            own = single.predict(bank.stack([points]), alone[i], 0.05, 18.0, flaps)
            assert own is not None
            alone[i] = own
            np.testing.assert_allclose(together.x[i], own.x[0], rtol=0, atol=1e-12)
            np.testing.assert_allclose(together.P[i], own.P[0], rtol=1e-10, atol=1e-12)


class LinearModes:
    """One transition, modes that differ in their process noise."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        rotation, _ = np.linalg.qr(rng.normal(size=(N, N)))
        self.F = 0.95 * rotation
        self.Q = symmetric(np.array([covariance(N, rng, scale) for scale in (0.01, 0.1, 1.0)]))
        self.R = np.array([0.2, 0.5])
        self.H = np.eye(N)[list(OBSERVED)]


def textbook_imm(
    model: LinearModes, x: list[Array], P: list[Array], mu: Array, Pi: Array, z: Array
) -> tuple[list[Array], list[Array], Array]:
    """Bar-Shalom, Li & Kirubarajan 2001, 11.6.6, loop by loop, with inverses and a density from scipy."""
    predicted = [sum(Pi[i, j] * mu[i] for i in range(3)) for j in range(3)]
    new_x, new_P, weight = [], [], []
    for j in range(3):
        share = [Pi[i, j] * mu[i] / predicted[j] for i in range(3)]
        x0 = sum(share[i] * x[i] for i in range(3))
        P0 = sum(share[i] * (P[i] + np.outer(x[i] - x0, x[i] - x0)) for i in range(3))
        xp, Pp = model.F @ x0, model.F @ P0 @ model.F.T + model.Q[j]
        S = model.H @ Pp @ model.H.T + np.diag(model.R)
        K = Pp @ model.H.T @ np.linalg.inv(S)
        new_x.append(xp + K @ (z - model.H @ xp))
        new_P.append(Pp - K @ S @ K.T)
        weight.append(predicted[j] * multivariate_normal(model.H @ xp, S).pdf(z))
    return new_x, new_P, np.array(weight) / sum(weight)


def test_on_a_linear_model_the_bank_is_the_textbook_imm() -> None:
    model, rng = LinearModes(2), np.random.default_rng(3)
    keep, move = bank.stay(3, 0.1, 2.0)
    Pi = np.full((3, 3), move) + (keep - move) * np.eye(3)
    points = bank.stack([sigma.cubature(N)] * 3)
    ours, mu = Bank(np.zeros((3, N)), np.tile(np.eye(N), (3, 1, 1))), np.full(3, 1 / 3)
    x: list[Array] = [np.zeros(N)] * 3
    P: list[Array] = [np.eye(N)] * 3
    oracle_mu = mu
    for _ in range(100):
        z = 2.0 * rng.normal(size=2)
        mixed, mu = bank.mix(ours, mu, keep, move)
        moved = bank.predict(points, mixed, model.F.dot, model.Q)
        assert moved is not None
        log_likelihood = np.zeros(3)
        for i, state in enumerate(OBSERVED):
            y, S = z[i] - moved.x[:, state], moved.P[:, state, state] + model.R[i]
            log_likelihood -= 0.5 * (y * y / S + np.log(S))
            moved = bank.update(moved, state, y, S)
        ours, mu = moved, bank.reweigh(mu, log_likelihood, 0.0)
        x, P, oracle_mu = textbook_imm(model, x, P, oracle_mu, Pi, z)
        np.testing.assert_allclose(mu, oracle_mu, rtol=0, atol=1e-9)
        np.testing.assert_allclose(ours.x, x, rtol=0, atol=1e-9)
        np.testing.assert_allclose(ours.P, P, rtol=0, atol=1e-9)
    mean, P_all = bank.combine(ours, mu)
    np.testing.assert_allclose(mean, sum(m * xi for m, xi in zip(mu, x, strict=True)), atol=1e-9)
    spread = sum(m * (Pi + np.outer(xi - mean, xi - mean)) for m, xi, Pi in zip(mu, x, P, strict=True))
    np.testing.assert_allclose(P_all, spread, atol=1e-9)


@pytest.mark.parametrize("count", [2, 3, 5])
@pytest.mark.parametrize("dt_s", [0.01, 0.5, 7.0])
def test_the_chain_of_seas_is_that_of_its_generator(count: int, dt_s: float) -> None:
    """Leaving at the rate 1/10 s, to any other alike: expm(G dt)."""
    G = np.full((count, count), 0.1 / (count - 1)) - (0.1 + 0.1 / (count - 1)) * np.eye(count)
    keep, move = bank.stay(count, dt_s, 10.0)
    np.testing.assert_allclose(
        np.full((count, count), move) + (keep - move) * np.eye(count), expm(G * dt_s), atol=1e-12
    )


def test_one_filter_alone_stays() -> None:
    assert bank.stay(1, 0.1, 10.0) == (1.0, 0.0)


@pytest.mark.parametrize("poison", ["indefinite", "nan", "model"])
def test_a_lost_filter_is_a_value(poison: str) -> None:
    P = np.tile(np.eye(N), (3, 1, 1))
    if poison != "model":
        P[1, 2, 2] = -1e-9 if poison == "indefinite" else np.nan
    with np.errstate(invalid="ignore"):
        factor = np.inf if poison == "model" else 1.0
        lost = bank.predict(bank.stack(SETS), Bank(np.zeros((3, N)), P), lambda rows: rows * factor, P)
    assert lost is None


def test_no_sea_is_ruled_out_for_good() -> None:
    weights = bank.reweigh(np.full(3, 1 / 3), np.array([0.0, -1e4, -1e6]), 1e-4)
    assert weights.sum() == pytest.approx(1.0)
    assert weights.min() == pytest.approx(1e-4, rel=1e-3)


@pytest.mark.parametrize("dt_s", [0.01, 0.05, 0.5])
def test_the_wave_moves_as_its_equation_says(dt_s: float) -> None:
    """Van Loan 1978 on f'' + 2 beta f' + omega^2 f = w with w of density 4 beta omega^2, which makes Var f = 1."""
    shape = WaveShape()
    moved = propagation(shape, dt_s)
    for axis, (omega, beta) in enumerate(
        ((shape.heave_peak_radps, shape.heave_decay_radps), (shape.pitch_peak_radps, shape.pitch_decay_radps))
    ):
        A = np.array([[0.0, 1.0], [-(omega**2), -2.0 * beta]])
        noise = np.diag([0.0, 4.0 * beta * omega**2])
        block = expm(np.block([[-A, noise], [np.zeros((2, 2)), A.T]]) * dt_s)
        F = block[2:, 2:].T
        own = [axis, axis + 2]
        np.testing.assert_allclose(moved.rows[np.ix_([axis + 2, axis + 4], own)], F, atol=1e-12)
        np.testing.assert_allclose(moved.rows[axis, own], expm(A * dt_s / 2)[0], atol=1e-12)
        np.testing.assert_allclose(moved.Q[axis], F @ block[:2, 2:], rtol=1e-6, atol=1e-13)
        other = [1 - axis, 3 - axis]
        assert not np.any(moved.rows[np.ix_([axis, axis + 2, axis + 4], other)])


def test_a_wave_that_does_not_oscillate_is_refused() -> None:
    with pytest.raises(ValueError, match="oscillate"):
        WaveShape(heave_peak_radps=0.5, heave_decay_radps=0.7)
