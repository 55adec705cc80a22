"""Oracle: brute-force discounted least squares over a long record, solved as a polynomial fit."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray

from heaved.estimation.rock.fading import Taps, gain_table, gains, shift, taps

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]


def brute_force(x: Array, degree: int, theta: float, step_s: float, ahead_steps: float) -> tuple[float, float]:
    """Value and slope, ``ahead_steps`` after the last sample, of the polynomial least in sum theta^k (x - p)^2."""
    count = min(len(x), int(np.log(1e-22) / np.log(theta)))
    age = np.arange(count)
    # Orthonormal basis for the weights (Cholesky-free, by QR), so that the normal equations do not spoil the oracle.
    root = np.sqrt(theta) ** age
    scaled = -age / count
    q, r = np.linalg.qr(root[:, None] * scaled[:, None] ** np.arange(degree + 1))
    c = np.linalg.solve(r, q.T @ (root * x[::-1][:count]))
    s = ahead_steps / count
    value = sum(c[k] * s**k for k in range(degree + 1))
    slope = sum(k * c[k] * s ** (k - 1) for k in range(1, degree + 1)) / (count * step_s)
    return value, slope


def run_taps(weights: Taps, numerator: Sequence[float], x: Array) -> float:
    y = np.zeros(len(x) + len(weights.feedback))
    x = np.concatenate([np.zeros(len(weights.feedback)), x])
    for n in range(len(weights.feedback), len(x)):
        y[n] = sum(f * y[n - 1 - j] for j, f in enumerate(weights.feedback))
        y[n] += sum(g * x[n - j] for j, g in enumerate(numerator))
    return float(y[-1])


@pytest.mark.parametrize(
    ("degree", "theta", "step_s", "ahead"),
    [(1, 0.5, 0.05, 0.0), (2, 0.6, 0.1, 1.0), (3, 0.75, 0.05, 0.0), (3, 0.75, 0.01, 2.5), (4, 0.7, 0.05, 3.0),
     (4, 0.7, 0.05, -1.5), (5, 0.6, 1.0, 0.0)],
)  # fmt: skip
def test_taps_are_discounted_least_squares(degree: int, theta: float, step_s: float, ahead: float) -> None:
    x = np.cumsum(np.random.default_rng(degree).standard_normal(600))
    weights = taps(degree, theta, step_s, ahead)
    value, slope = brute_force(x, degree, theta, step_s, ahead)
    assert run_taps(weights, weights.position, x) == pytest.approx(value, abs=1e-10 * np.abs(x).max() * (1 + ahead**2))
    assert run_taps(weights, weights.velocity, x) * step_s == pytest.approx(
        slope * step_s, abs=1e-10 * np.abs(x).max() * (1 + ahead**2)
    )


def test_published_weights_of_the_five_point_filter() -> None:
    weights = taps(4, 0.7, 0.05)
    assert weights.feedback == pytest.approx((3.5, -4.9, 3.43, -1.2005, 0.16807), abs=1e-12)
    assert weights.position == pytest.approx((0.83193, -2.65965, 3.2193, -1.7493, 0.36015), abs=1e-9)
    assert np.array(weights.velocity) * 0.05 == pytest.approx(
        (0.564188, -2.043045, 2.780865, -1.686915, 0.384908), abs=1e-6
    )


@pytest.mark.parametrize(("degree", "theta"), [(1, 0.8), (3, 0.75), (4, 0.7), (6, 0.5)])
def test_the_recursion_on_taylor_coefficients_is_the_same_filter(degree: int, theta: float) -> None:
    x = np.cumsum(np.random.default_rng(7).standard_normal(500))
    gain = gains(gain_table(degree), np.array(theta))
    z = np.zeros(degree + 1)
    for sample in x:
        z = shift(degree, 1.0) @ z
        z = z + gain * (sample - z[0])
    value, slope = brute_force(x, degree, theta, 1.0, 0.0)
    assert z[0] == pytest.approx(value, abs=1e-9 * np.abs(x).max())
    assert z[1] == pytest.approx(slope, abs=1e-9 * np.abs(x).max())


def test_a_polynomial_of_its_degree_passes_unchanged_at_uneven_times() -> None:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.3, 1.7, 300))
    polynomial = np.polynomial.Polynomial([1.0, -0.2, 3e-3, -1e-5])
    table = gain_table(3)
    z = np.zeros(4)
    for before, now in pairwise(t):
        z = shift(3, now - before) @ z
        z = z + gains(table, np.array(0.7)) * (polynomial(now) - z[0])
    assert z[0] == pytest.approx(polynomial(t[-1]), abs=1e-6)
    assert z[1] == pytest.approx(polynomial.deriv()(t[-1]), abs=1e-6)


@pytest.mark.parametrize("wrong", [(0, 0.7, 0.05), (3, 1.0, 0.05), (3, 0.0, 0.05), (3, 0.7, 0.0)])
def test_impossible_filters_are_refused(wrong: tuple[int, float, float]) -> None:
    with pytest.raises(ValueError, match="degree >= 1"):
        taps(*wrong)
