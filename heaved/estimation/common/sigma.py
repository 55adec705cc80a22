"""Sigma-point filtering: one predict/update pair over any set of sigma points.

Sources: Zhang et al. 2022 (UKF multi-step + BP), eq. (4)-(10), with two misprints corrected: in (9) the covariance
update reads ``P = P- - K S K'`` (the print has a plus, which grows P without bound), and in (5) the centre point
``i = 0`` is propagated too. Point sets: Julier & Uhlmann 2004 (symmetric), Arasaratnam & Haykin 2009 (cubature),
Julier 2003 (spherical simplex), Julier & Uhlmann 2002 (minimal skew).

The points are redrawn from the predicted covariance *after* Q has been added, so the measurement sees the process noise
of the step. (Pushing the propagated points on into the measurement loses Q from S and C and leaves P too large.)

On a linear model every set reproduces the Kalman filter to rounding: each matches mean and covariance exactly.

Written for a 10 ms tick: ``a.dot(b)`` costs half of ``a @ b`` at these sizes, and LAPACK is called without a wrapper.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, isfinite, sqrt

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dpotrf

Array = NDArray[np.float64]
Model = Array | Callable[[Array], Array]
"""A matrix (m, n), or a function of all points at once: rows (k, n) -> rows (k, m)."""


class PointSet(msgspec.Struct, frozen=True, eq=False, gc=False):
    """k unit points of a zero-mean, unit-covariance variable of n dimensions, and their weights."""

    name: str
    points: Array
    """(k, n), dimensionless: multiples of the standard deviation."""
    mean_weights: Array
    """(k,); they sum to 1."""
    cov_weights: Array
    """(k,); equal to the mean weights but for the centre of the scaled symmetric set."""


class Gaussian(msgspec.Struct, frozen=True, eq=False, gc=False):
    """Mean x (n,) and symmetric covariance P (n, n)."""

    x: Array
    P: Array


class Update(msgspec.Struct, frozen=True, eq=False, gc=False):
    """The state after a measurement, and what the measurement looked like. Rejected: x and P are the predicted ones."""

    x: Array
    P: Array
    y: Array
    """(m,) innovation z - E[h(x)]."""
    S: Array
    """(m, m) covariance of the innovation."""
    nis: float
    """Normalised innovation squared y' inv(S) y; chi-square with m degrees of freedom when the model is right."""
    accepted: bool


def symmetric(n: int, alpha: float = 1.0, beta: float = 2.0, kappa: float = 0.0) -> PointSet:
    """The 2n + 1 points of the unscented transform, eq. (4), (7), (10), with lambda = alpha^2 (n + kappa) - n.

    The defaults give lambda = 0: points at sqrt(n) standard deviations and no negative weight, so that P stays positive
    for any n and any nonlinearity. At n = 3 that is the classic kappa = 3 - n. For n > 3 the classic choice makes the
    centre weight negative (for n > 9 even with beta = 2), and a small alpha makes it about -n / (n alpha^2): -1e6 for
    alpha = 1e-3, which costs six digits; both are accepted, neither is advisable.

    Raises:
        ValueError: n < 1, alpha outside (0, 1], or n + kappa not positive.
    """
    _require_dimension(n)
    if not 0.0 < alpha <= 1.0:
        raise ValueError(f"symmetric points: alpha = {alpha} must lie in (0, 1]")
    if not n + kappa > 0.0:
        raise ValueError(f"symmetric points: n + kappa = {n + kappa} must be positive")
    spread = alpha**2 * (n + kappa)
    step = sqrt(spread) * np.eye(n)
    points = np.vstack((np.zeros((1, n)), step, -step))
    mean_weights = np.full(2 * n + 1, 0.5 / spread)
    mean_weights[0] = (spread - n) / spread
    cov_weights = mean_weights.copy()
    cov_weights[0] += 1.0 - alpha**2 + beta
    return _frozen("symmetric", points, mean_weights, cov_weights)


def cubature(n: int) -> PointSet:
    """The 2n equally weighted points of the third-degree spherical-radial rule (Arasaratnam & Haykin 2009).

    Raises:
        ValueError: n < 1.
    """
    _require_dimension(n)
    step = sqrt(n) * np.eye(n)
    weights = np.full(2 * n, 0.5 / n)
    return _frozen("cubature", np.vstack((step, -step)), weights, weights)


def spherical_simplex(n: int, centre_weight: float | None = None) -> PointSet:
    """n + 2 points: the centre and a regular simplex on a sphere (Julier 2003). Default: all weights equal.

    Raises:
        ValueError: n < 1, or the centre weight outside [0, 1).
    """
    _require_dimension(n)
    centre = 1.0 / (n + 2) if centre_weight is None else _checked_centre(centre_weight)
    weight = (1.0 - centre) / (n + 1)
    points = np.zeros((n + 2, n))
    for j in range(1, n + 1):
        side = 1.0 / sqrt(j * (j + 1) * weight)
        points[1 : j + 1, j - 1] = -side
        points[j + 1, j - 1] = j * side
    weights = np.full(n + 2, weight)
    weights[0] = centre
    return _frozen("spherical simplex", points, weights, weights)


def minimal_skew_simplex(n: int, centre_weight: float | None = None) -> PointSet:
    """n + 2 points of least third moment (Julier & Uhlmann 2002). Default centre weight: 1 / (n + 2).

    The outermost points lie 2^(n/2) standard deviations away: sound on a linear model, local only for small n.

    Raises:
        ValueError: n < 1, or the centre weight outside [0, 1).
    """
    _require_dimension(n)
    centre = 1.0 / (n + 2) if centre_weight is None else _checked_centre(centre_weight)
    weights = np.empty(n + 2)
    weights[0] = centre
    weights[1] = (1.0 - centre) / 2.0**n
    weights[2:] = weights[1] * 2.0 ** np.arange(n)
    points = np.zeros((n + 2, n))
    for j in range(1, n + 1):
        side = 1.0 / sqrt(2.0 * weights[j + 1])
        points[1 : j + 1, j - 1] = -side
        points[j + 1, j - 1] = side
    return _frozen("minimal-skew simplex", points, weights, weights)


def predict(points: PointSet, x: Array, P: Array, f: Model, Q: Array) -> Gaussian | None:
    """Time update, eq. (5) and the first line of (9).

    x (n,), P and Q (n, n). f: the transition matrix (n, n), or a function of the points, (k, n) -> (k, n).
    None: P is not positive definite, or f left the finite numbers; the caller resets and counts.
    """
    spread = _spread(points, P)
    if spread is None:
        return None
    spread += x
    moved = spread.dot(f.T) if isinstance(f, np.ndarray) else f(spread)
    mean = points.mean_weights.dot(moved)
    deviation = moved - mean
    predicted = (deviation.T * points.cov_weights).dot(deviation)
    predicted += Q
    if not isfinite(mean.dot(mean)):
        return None
    return Gaussian(mean, 0.5 * (predicted + predicted.T))


def update(points: PointSet, x: Array, P: Array, z: Array, h: Model, R: Array, gate: float = inf) -> Update | None:
    """Measurement update, eq. (6), (8), (9), with points redrawn from P (which includes Q).

    x (n,), P (n, n), z (m,), R (m, m). h: the measurement matrix (m, n), or a function of the points, (k, n) -> (k, m).
    A measurement whose nis exceeds the gate (a chi-square quantile for m degrees of freedom), or that is not finite,
    is rejected: ``accepted`` is False, x and P pass through.
    None: P or S is not positive definite or not finite; the caller resets and counts.

    Raises:
        ValueError: h is a vector or gives one (write a single row as (1, n)); it would broadcast to a wrong covariance.
    """
    spread = _spread(points, P)
    if spread is None:
        return None
    measured = (spread + x).dot(h.T) if isinstance(h, np.ndarray) else h(spread + x)
    if measured.ndim != 2:
        raise ValueError(f"sigma points: h must give rows (k, m) of measurements, not shape {measured.shape}")
    expected = points.mean_weights.dot(measured)
    weighted = (measured - expected).T * points.cov_weights
    S = weighted.dot(measured - expected) + R
    CT = weighted.dot(spread)  # (m, n): C' of eq. (8); the points are centred on x, so the spread is the deviation.
    y = z - expected
    # With S = U'U and V = U'^-1 C', v = U'^-1 y: K y = V'v, K S K' = V'V, nis = v'v.
    if y.shape[0] == 1:
        variance = S.item()
        if not 0.0 < variance < inf:
            return None
        root = sqrt(variance)
        V, v = CT / root, y / root
    else:
        factor, info = dpotrf(S.T, 0, 1)
        if info != 0 or not isfinite(np.vdot(factor, factor)):
            return None
        # Not LAPACK's trtrs: OpenBLAS splits that over threads at any size, 20 ms on a busy machine.
        V, v = dtrsm(1.0, factor, CT, 0, 0, 1), dtrsm(1.0, factor, y[:, None], 0, 0, 1)[:, 0]
    nis = float(v.dot(v))
    if not nis <= gate or not isfinite(nis):
        return Update(x, P, y, S, nis, False)
    corrected = x + v.dot(V)
    if not isfinite(corrected.dot(corrected)):
        return None
    corrected_P = P - V.T.dot(V)
    return Update(corrected, 0.5 * (corrected_P + corrected_P.T), y, S, nis, True)


def _spread(points: PointSet, P: Array) -> Array | None:
    """Deviations (k, n) of the points from the mean: unit points times the upper Cholesky factor, or None."""
    # P.T is P, in the order that LAPACK takes without a strided copy.
    factor, info = dpotrf(P.T, 0, 1)
    if info != 0 or not isfinite(np.vdot(factor, factor)):  # OpenBLAS takes nan for a positive pivot
        return None
    return points.points.dot(factor)


def _frozen(name: str, points: Array, mean_weights: Array, cov_weights: Array) -> PointSet:
    for array in (points, mean_weights, cov_weights):
        array.setflags(write=False)
    return PointSet(name, points, mean_weights, cov_weights)


def _require_dimension(n: int) -> None:
    if n < 1:
        raise ValueError(f"sigma points: a state of dimension {n} has no points; n must be at least 1")


def _checked_centre(weight: float) -> float:
    if not 0.0 <= weight < 1.0:
        raise ValueError(f"simplex points: the centre weight {weight} must lie in [0, 1)")
    return weight
