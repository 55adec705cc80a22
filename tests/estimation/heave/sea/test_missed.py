"""What is told of samples that were missed, against the conditional mean of all of them at once."""

from __future__ import annotations

from math import nan

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from heaved.estimation.heave.sea.missed import MissedInnovations
from heaved.estimation.heave.sea.model import Steady

Array = np.ndarray

F = np.array([[0.99, 0.1, 0.0], [-0.3, 0.95, 0.0], [0.0, 0.0, 0.999]])
Q = np.diag([1e-4, 4e-3, 1e-6])
H = np.array([-0.8, 0.3, 1.0])
R = 0.01
P = solve_discrete_are(F.T, H[:, None], Q, np.array([[R]]))
S = float(H @ P @ H) + R
STEADY = Steady(dt_s=0.1, F=F, Q=Q, P=P, K=P @ H / S, S=S)


def missed_of(is_there: Array, seed: int) -> tuple[Array, list[Array]]:
    """Samples (n,), and what is told after each, of a filter that is steady at the first."""
    rng = np.random.default_rng(seed)
    white = np.sqrt(S) * rng.normal(size=len(is_there))
    x, samples = np.zeros(3), []
    for e in white:
        samples.append(float(H @ x) + e)
        x = F @ (x + STEADY.K * e)
    missed, told = MissedInnovations(STEADY, H, 1000), []
    x, covariance = np.zeros(3), P
    for z, there in zip(samples, is_there, strict=True):
        y = float(z - H @ x) if there else nan
        told.append(missed.step(y))
        if there:
            gain = covariance @ H / float(H @ covariance @ H + R)
            x, covariance = x + gain * y, covariance - np.outer(gain, H @ covariance)
        x, covariance = F @ x, F @ covariance @ F.T + Q
    return np.array(samples), told


def conditional_mean(samples: Array, is_there: Array) -> Array:
    """Of the innovations (n,), given the samples that are there: they are a moving average of white noise."""
    n = len(samples)
    each = [1.0, *(float(H @ np.linalg.matrix_power(F, k) @ STEADY.K) for k in range(1, n))]
    made = np.array([[each[i - j] if i >= j else 0.0 for j in range(n)] for i in range(n)])[is_there]
    return np.asarray(made.T @ np.linalg.solve(made @ made.T, samples[is_there]))


@pytest.mark.parametrize("hole", [1, 4, 12])
def test_they_are_what_all_samples_together_tell(hole: int) -> None:
    is_there = np.ones(40, bool)
    is_there[10 : 10 + hole] = False
    is_there[30] = False
    samples, told = missed_of(is_there, hole)
    for end in (10 + hole, 12 + hole, 31, 40):
        expected = conditional_mean(samples[:end], is_there[:end])
        assert len(told[end - 1]) == end - 10
        assert told[end - 1] == pytest.approx(expected[10:], abs=1e-7)


def test_nothing_is_told_where_nothing_is_missed_nor_of_what_is_long_past() -> None:
    missed = MissedInnovations(STEADY, H, 5)
    lengths = [len(missed.step(y)) for y in (0.1, -0.2, 0.0, nan, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1)]
    assert lengths == [0, 0, 1, 2, 3, 4, 5, 5, 5, 0, 0]
    missed.miss(3)
    assert len(missed.step(0.1)) == 4
    missed.miss(6)
    assert len(missed.step(0.1)) == 0
