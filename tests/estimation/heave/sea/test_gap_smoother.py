"""Oracle: the conditional mean and variance of every state at once, from one large Gaussian."""

from __future__ import annotations

import numpy as np
import pytest
from seas import model, simulated

from heaved.estimation.heave.sea.batch_filter import Record
from heaved.estimation.heave.sea.filter import SeaFilter
from heaved.estimation.heave.sea.gap_smoother import smoothed
from heaved.estimation.heave.sea.model import SeaSystem, measurement_variance

DT_S = 0.2
HOLES = {"none": (), "one": ((20, 30),), "many": ((3, 4), (10, 13), (25, 40), (52, 53))}


@pytest.mark.parametrize("name", HOLES)
def test_it_is_the_conditional_mean_given_all_samples(name: str) -> None:
    system = SeaSystem(model(stages=4))
    steady = system.steady(DT_S)
    assert steady is not None
    count, n = 60, len(system.H)
    _, a = simulated(system, DT_S, count, seed=9)
    known = np.ones(count, dtype=bool)
    for first, end in HOLES[name]:
        known[first:end] = False
    f = SeaFilter(system, steady, 0.0, np.zeros(n), system.stationary.copy())
    found = smoothed(f, Record(DT_S * count, DT_S, a, known), count)
    # cov(x_i, x_j) = F^(i-j) P_j; all states side by side.
    F, Q = system.transition(DT_S)
    P, powers = [F @ system.stationary @ F.T + Q], [np.eye(n)]
    for _ in range(count - 1):
        P.append(F @ P[-1] @ F.T + Q)
        powers.append(F @ powers[-1])
    H, heave, R = system.H, system.heave, measurement_variance(system.model.noise_psd, DT_S)
    zz, hz = np.empty((count, count)), np.empty((count, count))
    for i in range(count):
        for j in range(count):
            joint = powers[i - j] @ P[j] if i >= j else P[i] @ powers[j - i].T
            zz[i, j], hz[i, j] = H @ joint @ H, heave @ joint @ H
    zz = zz[np.ix_(known, known)] + R * np.eye(int(known.sum()))
    hz = hz[np.ix_(known, known)]
    mean = hz @ np.linalg.solve(zz, a[known])
    variance = np.array([heave @ P[i] @ heave for i in np.flatnonzero(known)])
    variance -= np.sum(hz * np.linalg.solve(zz, hz.T).T, axis=1)
    assert found[:, 0] == pytest.approx(DT_S * (1.0 + np.flatnonzero(known)))
    np.testing.assert_allclose(found[:, 1], mean, atol=1e-5)
    np.testing.assert_allclose(found[:, 2], np.sqrt(variance), rtol=1e-3)
    assert len(smoothed(f, Record(DT_S * count, DT_S, a, known), 10)) == known[:10].sum()
