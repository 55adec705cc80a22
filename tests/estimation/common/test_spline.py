"""Oracle: scipy's cubic spline, and polynomials, which a spline of enough points goes along."""

import numpy as np
import pytest
from scipy import interpolate

from heaved.estimation.common.spline import CubicSpline


@pytest.mark.parametrize("shape", [(), (3,), (2, 2)])
@pytest.mark.parametrize("count", [2, 3, 4, 5, 8, 3000])
def test_is_that_of_scipy(count: int, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(count)
    x, y = np.cumsum(rng.uniform(0.01, 2.0, count)), rng.standard_normal((count, *shape))
    at = np.concatenate((x, rng.uniform(x[0] - 0.1, x[-1] + 0.1, 500)))
    ours, theirs = CubicSpline(x, y), interpolate.CubicSpline(x, y)
    scale = np.abs(theirs(at)).max()
    np.testing.assert_allclose(ours(at), theirs(at), rtol=0.0, atol=1e-12 * scale)
    np.testing.assert_allclose(ours.slope(at), theirs(at, 1), rtol=0.0, atol=1e-12 * np.abs(theirs(at, 1)).max())


@pytest.mark.parametrize("count", [2, 3, 4, 9])
def test_goes_along_a_polynomial_of_as_many_coefficients(count: int) -> None:
    polynomial = np.polynomial.Polynomial([0.5, -2.0, 0.75, 0.25][:count])
    x, at = np.geomspace(0.05, 5.0, count), np.linspace(0.0, 6.0, 100)
    spline = CubicSpline(x, polynomial(x))
    np.testing.assert_allclose(spline(at), polynomial(at), atol=1e-11)
    np.testing.assert_allclose(spline.slope(at), polynomial.deriv()(at), atol=1e-10)
