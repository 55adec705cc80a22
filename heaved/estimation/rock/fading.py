"""The fading-memory polynomial filter: discounted least squares of a degree-m polynomial, as a short recursion.

Wei et al. 2019 (ship rock prediction), eq. (7), (8) print the five-point form and leave its weights "given in advance".
They follow from the fit itself: minimise sum_k theta^k (x[n-k] - p(-k))^2. With q = z^-1 and u = 1 - q every estimate
derived from p has the denominator (1 - theta q)^(m+1); the k-th derivative, h steps ahead, has the numerator

    [ (1 - theta + theta u)^(m+1) * (-ln(1-u))^k * (1-u)^(-h) ]  truncated after u^m, times step^-k.

Degree 4 is the five-point filter. Two equivalent forms are offered: ``taps`` (past outputs and inputs, a fixed step)
and ``gains`` (a state of Taylor coefficients moved by the true time step, hence usable at any rate and with jitter).
A third, ``finite_taps``, is the same fit with its memory cut off, as plain weights on the last samples.
"""

from __future__ import annotations

from functools import cache
from math import comb
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Taps(msgspec.Struct, frozen=True, kw_only=True):
    """y[n] = sum_j feedback[j] y[n-1-j] + sum_j numerator[j] x[n-j], j = 0..degree."""

    feedback: tuple[float, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    """Per second: the step is divided out."""


def taps(degree: int, theta: float, step_s: float, ahead_steps: float = 0.0) -> Taps:
    """Weights of the filter, extrapolated by ``ahead_steps`` steps (real, either sign).

    Raises:
        ValueError: degree < 1, theta outside (0, 1) or step_s not positive.
    """
    if degree < 1 or not 0.0 < theta < 1.0 or step_s <= 0.0:
        raise ValueError(f"need degree >= 1, 0 < theta < 1, step_s > 0; got {degree}, {theta}, {step_s}")
    feedback = tuple(-comb(degree + 1, j) * (-theta) ** j for j in range(1, degree + 2))
    advance = np.ones(degree + 1)  # (1-u)^-h
    for i in range(1, degree + 1):
        advance[i] = advance[i - 1] * (ahead_steps + i - 1) / i
    position, velocity = (
        _in_powers_of_q(_product(_product(_denominator(degree, theta), _log_power(degree, k)), advance)) for k in (0, 1)
    )
    return Taps(
        feedback=feedback,
        position=tuple(position.tolist()),
        velocity=tuple((velocity / step_s).tolist()),
    )


def gain_table(degree: int) -> Array:
    """(degree + 2, degree + 1) table that ``gains`` multiplies; row i belongs to (1-theta)^(m+1-i) theta^i."""
    table = np.zeros((degree + 2, degree + 1))
    factorial = 1.0
    for k in range(degree + 1):
        factorial *= max(k, 1)
        # The weight of the newest input is the numerator at q = 0, that is u = 1: the sum of its coefficients.
        partial_sums = np.cumsum(_log_power(degree, k)) / factorial
        for i in range(degree + 1):
            table[i, k] = comb(degree + 1, i) * partial_sums[degree - i]
    return table


def gains(table: Array, theta: Array) -> Array:
    """Gain of each Taylor coefficient (unit: per step^k) for a new sample, shape (..., degree + 1).

    ``theta`` (...,) discount over this step. The recursion is z <- F z, z <- z + gain (x - z[0]), with F the Taylor
    shift over the step; for equal steps it is the filter of ``taps``, coefficient for coefficient.
    """
    order = table.shape[1]
    powers = np.arange(order + 1)
    theta = np.asarray(theta)[..., None]
    result: Array = ((1.0 - theta) ** (order - powers) * theta**powers) @ table
    return result


def shift(degree: int, steps: float) -> Array:
    """(degree + 1, degree + 1) matrix that moves Taylor coefficients z_k = x^(k) step^k / k! on by ``steps``."""
    binomial, exponent = pascal(degree)
    result: Array = binomial * steps**exponent
    return result


@cache
def pascal(degree: int) -> tuple[Array, Array]:
    """Upper-triangular binomials C(j, i) and the powers j - i that go with them in ``shift``; (m+1, m+1) each."""
    i, j = np.indices((degree + 1, degree + 1))
    binomial = np.array([[comb(column, row) for column in range(degree + 1)] for row in range(degree + 1)], np.float64)
    return binomial, np.maximum(j - i, 0).astype(np.float64)


DEGREE: Final = 3
"""Of :func:`finite_taps`."""
MEAN_AGE_S: Final = 0.15
"""Its fading memory: theta / (1 - theta) steps, i.e. theta = 0.75 at 20 Hz;"""
SPAN_S: Final = 2.0
"""and where that is cut off: 0.75^40 = 1e-5."""


def finite_taps(interval_s: float, ahead_s: Array) -> Array:
    """Weights (H, W) on the last W samples, oldest first, of the discounted polynomial fit extrapolated by ``ahead_s``.

    The memory is cut off, and what is left fitted so that it reproduces polynomials of its degree exactly.
    """
    count = max(round(SPAN_S / interval_s), 12)
    age = np.arange(count - 1, -1, -1.0)
    mean_age = max(MEAN_AGE_S / interval_s, 1.0)
    theta = mean_age / (1.0 + mean_age)
    powers = np.arange(DEGREE + 1)
    root = theta ** (age / 2.0)
    scale = 4.0 * mean_age
    fit = np.linalg.pinv(root[:, None] * (-age[:, None] / scale) ** powers) * root
    result: Array = (np.asarray(ahead_s)[:, None] / interval_s / scale) ** powers @ fit
    return result


def _denominator(degree: int, theta: float) -> Array:
    """(1 - theta + theta u)^(m+1) in powers of u, truncated after u^m."""
    n = degree + 1
    return np.array([comb(n, i) * (1 - theta) ** (n - i) * theta**i for i in range(n)])


def _log_power(degree: int, k: int) -> Array:
    """(-ln(1-u))^k = (u + u^2/2 + ...)^k, truncated after u^m."""
    log = np.array([0.0, *(1.0 / i for i in range(1, degree + 1))])
    result: Array = np.eye(1, degree + 1)[0]
    for _ in range(k):
        result = _product(result, log)
    return result


def _product(a: Array, b: Array) -> Array:
    return np.asarray(np.convolve(a, b)[: len(a)], dtype=np.float64)


def _in_powers_of_q(in_u: Array) -> Array:
    """Substitute u = 1 - q."""
    n = len(in_u)
    return np.array([[comb(i, j) * (-1.0) ** j for i in range(n)] for j in range(n)]) @ in_u
