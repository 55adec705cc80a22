"""Sigma-point core against textbook Kalman algebra, analytic moments and chi-square bands."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from point_sets import SETS
from scipy.stats import chi2

from heaved.estimation.common import sigma

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.estimation.common.sigma import Array, PointSet

every_set = pytest.mark.parametrize("make", SETS.values(), ids=SETS.keys())


class LinearModel:
    """A stable random model with correlated noises; m measurements of n states."""

    def __init__(self, n: int, m: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        rotation, _ = np.linalg.qr(rng.normal(size=(n, n)))
        self.F = rotation @ np.diag(rng.uniform(0.7, 0.99, n))
        q, r = rng.normal(size=(n, n)), rng.normal(size=(m, m))
        self.Q = 0.05 * (q @ q.T / n + 0.1 * np.eye(n))
        self.R = 0.2 * (r @ r.T / m + 0.5 * np.eye(m))
        self.Q, self.R = 0.5 * (self.Q + self.Q.T), 0.5 * (self.R + self.R.T)
        self.H = rng.normal(size=(m, n))


@every_set
def test_a_function_and_its_matrix_are_the_same_model(make: Callable[[int], PointSet]) -> None:
    model, points = LinearModel(4, 2, seed=3), make(4)
    x, P, z = np.arange(4.0), np.eye(4), np.array([0.3, -0.2])
    by_matrix = sigma.predict(points, x, P, model.F, model.Q)
    by_function = sigma.predict(points, x, P, lambda rows: np.array([model.F @ row for row in rows]), model.Q)
    assert by_matrix is not None
    assert by_function is not None
    np.testing.assert_allclose(by_function.P, by_matrix.P, rtol=0, atol=1e-13)
    first = sigma.update(points, x, P, z, model.H, model.R)
    second = sigma.update(points, x, P, z, lambda rows: np.array([model.H @ row for row in rows]), model.R)
    assert first is not None
    assert second is not None
    np.testing.assert_allclose(second.x, first.x, rtol=0, atol=1e-13)
    np.testing.assert_allclose(second.P, first.P, rtol=0, atol=1e-13)


@every_set
@pytest.mark.parametrize("n", [1, 2, 3, 12, 25])
def test_points_have_zero_mean_and_unit_covariance(make: Callable[[int], PointSet], n: int) -> None:
    points = make(n)
    assert points.mean_weights.sum() == pytest.approx(1.0, abs=1e-13)
    np.testing.assert_allclose(points.mean_weights @ points.points, np.zeros(n), atol=1e-12)
    for weights in (points.mean_weights, points.cov_weights):
        np.testing.assert_allclose((points.points.T * weights) @ points.points, np.eye(n), atol=1e-12)


@pytest.mark.parametrize("n", range(1, 26))
def test_default_weights_are_never_negative(n: int) -> None:
    for make in (sigma.symmetric, sigma.cubature, sigma.spherical_simplex, sigma.minimal_skew_simplex):
        points = make(n)
        assert points.mean_weights.min() >= 0.0
        assert points.cov_weights.min() >= 0.0


def test_the_simplex_is_regular() -> None:
    corners = sigma.spherical_simplex(7).points[1:]
    radii = np.linalg.norm(corners, axis=1)
    np.testing.assert_allclose(radii, radii[0], rtol=1e-12)
    sides = [np.linalg.norm(a - b) for i, a in enumerate(corners) for b in corners[:i]]
    np.testing.assert_allclose(sides, sides[0], rtol=1e-12)


@every_set
def test_the_mean_of_a_quadratic_is_exact(make: Callable[[int], PointSet]) -> None:
    """E[x'Ax] = tr(AP) + m'Am, which the linearisation of an extended filter misses by tr(AP)."""
    rng = np.random.default_rng(7)
    A, root, m = rng.normal(size=(4, 4)), rng.normal(size=(4, 4)), rng.normal(size=4)
    P = root @ root.T + np.eye(4)
    result = sigma.predict(make(4), m, 0.5 * (P + P.T), quadratic(A), np.eye(4))
    assert result is not None
    assert result.x[0] == pytest.approx(np.trace(A @ P) + m @ A @ m, rel=1e-12)


def quadratic(A: Array) -> Callable[[Array], Array]:
    return lambda rows: np.repeat(np.einsum("ki,ij,kj->k", rows, A, rows)[:, None], rows.shape[1], axis=1)


@pytest.mark.parametrize(("alpha", "beta", "kappa"), [(1.0, 2.0, 0.0), (1.0, 0.0, 2.0), (1e-2, 2.0, 0.0)])
def test_the_variance_of_a_square_is_exact(alpha: float, beta: float, kappa: float) -> None:
    """Var[x^2] = 2 P^2 + 4 m^2 P for a scalar Gaussian: beta = 2 is right where alpha^2 (n + kappa) = alpha^2."""
    m, p = 0.7, 1.3
    points = sigma.symmetric(1, alpha, beta, kappa)
    result = sigma.predict(points, np.array([m]), np.array([[p]]), lambda rows: rows**2, np.array([[0.0]]))
    assert result is not None
    tolerance = 1e-9 if alpha == 1.0 else 2e-4  # a small alpha leaves a term of alpha^2
    assert result.P[0, 0] == pytest.approx(2 * p**2 + 4 * m**2 * p, rel=tolerance)


@pytest.mark.parametrize("n", [3, 4, 11])
def test_the_symmetric_variance_of_a_quadratic_follows_its_formula(n: int) -> None:
    """Worked out by hand for P = I, mean 0: c sum a_ii^2 + (beta - alpha^2) tr(A)^2 with c = alpha^2 (n + kappa)."""
    A = np.diag(np.linspace(-1.0, 2.0, n))
    alpha, beta, kappa = 0.5, 2.0, 1.0
    points = sigma.symmetric(n, alpha, beta, kappa)
    result = sigma.predict(points, np.zeros(n), np.eye(n), quadratic(A), np.zeros((n, n)))
    assert result is not None
    expected = alpha**2 * (n + kappa) * np.sum(np.diag(A) ** 2) + (beta - alpha**2) * np.trace(A) ** 2
    assert result.P[0, 0] == pytest.approx(expected, rel=1e-10)


@every_set
def test_linear_consistency(make: Callable[[int], PointSet]) -> None:
    """NEES per step and the (white) NIS over all steps and runs lie in their 95 % chi-square bands."""
    runs, steps, n, m = 50, 60, 3, 2
    model, rng, points = LinearModel(n, m, seed=11), np.random.default_rng(12), make(n)
    root_q, root_r = np.linalg.cholesky(model.Q), np.linalg.cholesky(model.R)
    nees, nis = np.zeros(steps), 0.0
    for _ in range(runs):
        truth, x, P = rng.normal(size=n), np.zeros(n), np.eye(n)
        for k in range(steps):
            truth = model.F @ truth + root_q @ rng.normal(size=n)
            z = model.H @ truth + root_r @ rng.normal(size=m)
            predicted = sigma.predict(points, x, P, model.F, model.Q)
            assert predicted is not None
            result = sigma.update(points, predicted.x, predicted.P, z, model.H, model.R)
            assert result is not None
            x, P = result.x, result.P
            nees[k] += (truth - x) @ np.linalg.solve(P, truth - x)
            nis += result.nis
    low, high = (chi2.ppf(level, runs * n) for level in (0.025, 0.975))
    assert np.mean((nees > low) & (nees < high)) >= 0.85
    low, high = (chi2.ppf(level, runs * steps * m) for level in (0.025, 0.975))
    assert low < nis < high


@every_set
def test_nonlinear_consistency(make: Callable[[int], PointSet]) -> None:
    """A pendulum swinging through +-1.5 rad, seen by its horizontal and vertical deflection."""
    dt, runs, steps, rng, points = 0.02, 10, 200, np.random.default_rng(21), make(2)
    Q, R, P0 = np.diag([1e-7, 1e-3]), np.diag([0.05**2, 0.05**2]), np.diag([0.1**2, 0.1**2])

    def swing(rows: Array) -> Array:
        rate = rows[:, 1] - dt * 9.81 * np.sin(rows[:, 0])
        return np.stack((rows[:, 0] + dt * rate, rate), axis=1)

    def see(rows: Array) -> Array:
        return np.stack((np.sin(rows[:, 0]), np.cos(rows[:, 0])), axis=1)

    nees, nis = 0.0, 0.0
    for _ in range(runs):
        x, P = np.array([1.5, 0.0]), P0
        truth = x + np.sqrt(np.diag(P0)) * rng.normal(size=2)
        for _ in range(steps):
            truth = swing(truth[None])[0] + np.sqrt(np.diag(Q)) * rng.normal(size=2)
            z = see(truth[None])[0] + np.sqrt(np.diag(R)) * rng.normal(size=2)
            predicted = sigma.predict(points, x, P, swing, Q)
            assert predicted is not None
            result = sigma.update(points, predicted.x, predicted.P, z, see, R)
            assert result is not None
            x, P = result.x, result.P
            nees += (truth - x) @ np.linalg.solve(P, truth - x)
            nis += result.nis
    assert 0.7 < nees / (2 * runs * steps) < 1.35
    assert 0.93 < nis / (2 * runs * steps) < 1.07


BAD_COVARIANCES = {
    "indefinite": np.diag([1.0, -1e-9]),
    "singular": np.ones((2, 2)),
    "nan": np.full((2, 2), np.nan),
    "infinite": np.diag([np.inf, np.inf]),
}


@pytest.mark.parametrize("P", BAD_COVARIANCES.values(), ids=BAD_COVARIANCES.keys())
@pytest.mark.parametrize("rows", [1, 2])
def test_a_lost_covariance_is_a_value(P: Array, rows: int) -> None:
    points, x = sigma.symmetric(2), np.zeros(2)
    with np.errstate(invalid="ignore"):
        assert sigma.predict(points, x, P, np.eye(2), np.eye(2)) is None
        assert sigma.update(points, x, P, np.zeros(rows), np.eye(rows, 2), np.eye(rows)) is None


@pytest.mark.parametrize("rows", [1, 2])
def test_an_impossible_innovation_covariance_is_a_value(rows: int) -> None:
    points = sigma.cubature(2)
    assert sigma.update(points, np.zeros(2), np.eye(2), np.zeros(rows), np.eye(rows, 2), -9.0 * np.eye(rows)) is None


@pytest.mark.parametrize("poison", [np.nan, np.inf])
def test_a_model_that_leaves_the_numbers_is_a_value(poison: float) -> None:
    points, x, P = sigma.cubature(2), np.zeros(2), np.eye(2)
    with np.errstate(invalid="ignore"):
        assert sigma.predict(points, x, P, lambda rows: rows * poison, P) is None
        assert sigma.update(points, x, P, np.zeros(1), lambda rows: rows[:, :1] + poison, np.eye(1)) is None
        assert sigma.update(points, x, P, np.zeros(2), lambda rows: rows + poison, P) is None


@pytest.mark.parametrize("rows", [1, 2])
@pytest.mark.parametrize("value", [np.nan, np.inf, 50.0])
def test_a_bad_measurement_is_rejected(rows: int, value: float) -> None:
    x, P = np.array([0.1, -0.2]), np.diag([1.0, 2.0])
    result = sigma.update(sigma.symmetric(2), x, P, np.full(rows, value), np.eye(rows, 2), np.eye(rows), gate=9.0)
    assert result is not None
    assert not result.accepted
    np.testing.assert_array_equal(result.x, x)
    np.testing.assert_array_equal(result.P, P)


def test_the_gate_is_the_innovation_squared_over_its_variance() -> None:
    arguments = (sigma.symmetric(1), np.zeros(1), np.array([[1.0]]), np.array([4.0]), np.eye(1), np.array([[3.0]]))
    accepted, rejected = sigma.update(*arguments, gate=4.001), sigma.update(*arguments, gate=3.999)
    assert accepted is not None
    assert rejected is not None
    assert accepted.nis == rejected.nis == pytest.approx(4.0)
    assert accepted.accepted
    assert not rejected.accepted


@pytest.mark.parametrize(
    "build",
    [
        lambda: sigma.symmetric(0),
        lambda: sigma.cubature(0),
        lambda: sigma.spherical_simplex(0),
        lambda: sigma.minimal_skew_simplex(-1),
        lambda: sigma.symmetric(3, alpha=0.0),
        lambda: sigma.symmetric(3, alpha=1.5),
        lambda: sigma.symmetric(3, kappa=-3.0),
        lambda: sigma.spherical_simplex(3, centre_weight=1.0),
        lambda: sigma.minimal_skew_simplex(3, centre_weight=-0.1),
    ],
)
def test_impossible_sets_are_refused(build: Callable[[], PointSet]) -> None:
    with pytest.raises(ValueError, match="points"):
        build()


def test_a_vector_for_h_is_refused() -> None:
    with pytest.raises(ValueError, match="rows"):
        sigma.update(sigma.cubature(2), np.zeros(2), np.eye(2), np.zeros(1), np.ones(2), np.eye(1))
