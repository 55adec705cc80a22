"""A bank of sigma-point filters on one model, all at once, and the mixing that makes an interacting multiple model.

Sources: the filter is that of :mod:`heaved.estimation.common.sigma`, which it equals to rounding; the mixing is that
of Blom & Bar-Shalom 1988. B filters of n states share the transition, so that it is worked out once for all of their
points: at 3 x 16 points of 8 states a call costs what it costs at 16. Their point sets and process noises may differ.

The measurements are states, one at a time: with independent noises that is exact, takes no factorisation, and a channel
that is missing or not believed is simply left out. Every symmetric point set gives a linear measurement its exact
moments, so no points are drawn for it.

Arrays: x (B, n), P (B, n, n), probabilities (B,).
"""

from __future__ import annotations

from math import exp, isfinite
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from heaved.estimation.common.sigma import PointSet

Array = NDArray[np.float64]


class Points(msgspec.Struct, frozen=True, eq=False, gc=False):
    """The point sets of B filters, as columns."""

    columns: Array
    """(B, n, k): unit points; a set of fewer has points of no weight at the mean."""
    mean_weights: Array
    """(B, k, 1)."""
    cov_weights: Array
    """(B, 1, k)."""


class Bank(msgspec.Struct, frozen=True, eq=False, gc=False):
    """Means and covariances of B filters."""

    x: Array
    P: Array


def stack(sets: Sequence[PointSet]) -> Points:
    """The point sets of a bank, one per filter."""
    k, n = max(len(points.points) for points in sets), sets[0].points.shape[1]
    columns, mean, cov = np.zeros((len(sets), n, k)), np.zeros((len(sets), k, 1)), np.zeros((len(sets), 1, k))
    for i, points in enumerate(sets):
        own = len(points.points)
        columns[i, :, :own] = points.points.T
        mean[i, :own, 0], cov[i, 0, :own] = points.mean_weights, points.cov_weights
    return Points(columns, mean, cov)


def predict(points: Points, bank: Bank, f: Callable[[Array], Array], Q: Array) -> Bank | None:
    """Time update of every filter; Q (B, n, n).

    f: all points at once, columns (n, B k) -> (n, B k). None: some P is not positive definite, or f left the finite
    numbers; the caller resets and counts.
    """
    count, n, k = points.columns.shape
    root = np.empty((count, n, n))
    for i in range(count):
        # P is symmetric: its upper factor in the order of LAPACK is the lower one in ours, transposed.
        factor, info = dpotrf(bank.P[i].T, 1, 1)
        if info != 0:
            return None
        root[i] = factor
    spread = root @ points.columns
    spread += bank.x[:, :, None]
    moved = f(spread.transpose(1, 0, 2).reshape(n, count * k)).reshape(n, count, k).transpose(1, 0, 2)
    mean = moved @ points.mean_weights
    deviation = moved - mean
    P = (deviation * points.cov_weights) @ deviation.transpose(0, 2, 1)
    P += Q
    if not isfinite(float(np.vdot(P, P)) + float(np.vdot(mean, mean))):
        return None
    return Bank(mean[:, :, 0], 0.5 * (P + P.transpose(0, 2, 1)))


def update(bank: Bank, state: int, innovation: Array, variance: Array) -> Bank:
    """Measurement update with the reading of one state: innovation (B,) and its variance (B,)."""
    column = bank.P[:, :, state]
    gain = column / variance[:, None]
    x = bank.x + gain * innovation[:, None]
    P = bank.P - gain[:, :, None] * column[:, None, :]
    return Bank(x, P)


def place(bank: Bank, state: int, value: float, variance: float) -> Bank:
    """One state of every filter set anew, and known apart from the others."""
    x, P = bank.x.copy(), bank.P.copy()
    x[:, state] = value
    P[:, state, :] = P[:, :, state] = 0.0
    P[:, state, state] = variance
    return Bank(x, P)


def stay(count: int, dt_s: float, mean_stay_s: float) -> tuple[float, float]:
    """Probabilities to keep a mode over dt, and to go to a given other one.

    Of the Markov chain in continuous time that leaves each mode at the rate 1 / mean_stay_s, to any other alike.
    """
    if count == 1:
        return 1.0, 0.0
    other = (1.0 - exp(-dt_s * count / ((count - 1) * mean_stay_s))) / count
    return 1.0 - (count - 1) * other, other


def mix(bank: Bank, probabilities: Array, keep: float, move: float) -> tuple[Bank, Array]:
    """The first half of the cycle: each filter starts from all of them. Also the predicted probabilities (B,)."""
    count = len(probabilities)
    joint = np.full((count, count), move)
    joint.flat[:: count + 1] = keep
    joint *= probabilities  # row j: from every i to mode j
    predicted = joint.sum(axis=1)
    joint /= predicted[:, None]
    x = joint.dot(bank.x)
    apart = bank.x - x[:, None, :]  # (j, i, n)
    P = (apart * joint[:, :, None]).transpose(0, 2, 1) @ apart
    P += joint.dot(bank.P.reshape(count, -1)).reshape(bank.P.shape)
    return Bank(x, P), predicted


def combine(bank: Bank, probabilities: Array) -> tuple[Array, Array]:
    """Mean (n,) and covariance (n, n) of the mixture."""
    x = probabilities.dot(bank.x)
    apart = bank.x - x
    P = (apart.T * probabilities).dot(apart)
    P += probabilities.dot(bank.P.reshape(len(probabilities), -1)).reshape(P.shape)
    return x, P


def reweigh(probabilities: Array, log_likelihood: Array, least: float) -> Array:
    """Bayes' rule; no probability falls below ``least``: a mode once ruled out would need long to return."""
    weight = probabilities * np.exp(log_likelihood - log_likelihood.max())
    weight = np.maximum(weight / weight.sum(), least)
    result: Array = weight / weight.sum()
    return result
