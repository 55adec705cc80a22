"""Oracle: the conditional mean of a Gaussian process from its whole covariance matrix, and a simulated sea."""

from __future__ import annotations

import numpy as np
import pytest
from seas import model, simulated, stationary, whole

from heaved.estimation.heave.sea.gap_bridge import TUNING, bridged, closed
from heaved.estimation.heave.sea.model import SeaSystem

DT_S, COUNT = 0.05, 900
Array = np.ndarray


def covariance(lags: int) -> Array:
    """Of samples of the model, lag by lag, from its state space: H F^k P H', and the noise."""
    system = SeaSystem(model())
    F, H = whole(system, DT_S)[0][:-1, :-1], system.H[:-1]
    found, row = [], stationary(system) @ H
    for _ in range(lags):
        found.append(H @ row)
        row = F @ row
    found[0] += 0.5 * model().noise_psd / DT_S
    return np.array(found)


@pytest.mark.parametrize("length", [1, 8, 20])
def test_holes_hold_the_conditional_mean_of_all_the_rest(length: int) -> None:
    """As near to the samples that are missing as the best that can be said of them, and nearer to that than to them."""
    _, a = simulated(SeaSystem(model()), DT_S, COUNT, seed=3)
    known = (np.arange(COUNT) + 60) % 120 >= length
    filled, known_then = bridged(np.where(known, a, 99.0), known, DT_S, model(), None)
    r = covariance(COUNT)
    K = r[np.abs(np.subtract.outer(np.arange(COUNT), np.arange(COUNT)))]
    expected = K[np.ix_(~known, known)] @ np.linalg.solve(K[np.ix_(known, known)], a[known])
    inner = (np.arange(COUNT) > 110) & (np.arange(COUNT) < COUNT - 110)
    best, ours = (expected - a[~known])[inner[~known]], (filled - a)[~known & inner]
    assert known_then.all()
    assert np.array_equal(filled[known], a[known])
    assert np.std(ours) < 1.2 * np.std(best)
    assert np.std(ours - best) < 0.6 * np.std(best)


def test_a_long_hole_is_left_as_it_is() -> None:
    known = np.ones(1000, dtype=bool)
    longest = round(TUNING.longest_s / DT_S)
    known[200 : 200 + longest] = known[500 : 500 + longest + 1] = False
    a = np.random.default_rng(1).standard_normal(1000)
    filled, known_then = bridged(a, known, DT_S, model(), None)
    assert np.array_equal(known_then, closed(known, DT_S))
    assert np.flatnonzero(~known_then).tolist() == list(range(500, 500 + longest + 1))
    assert np.array_equal(filled[known | ~known_then], a[known | ~known_then])
    every = np.ones(1000, dtype=bool)
    assert bridged(a, every, DT_S, model(), None)[0] is a


def test_what_is_missing_at_random_is_found_to_the_noise() -> None:
    """Three quarters of the samples lost: what is left shows waves of 4 s and more as well as ever."""
    system = SeaSystem(model())
    states, a = simulated(system, DT_S, 4000, seed=5)
    known = np.random.default_rng(2).random(4000) > 0.75
    known[[0, -1]] = True
    filled, _ = bridged(a, known, DT_S, model(), None)
    inner = ~known & (np.arange(4000) > 200) & (np.arange(4000) < 3800)
    error = filled - states @ system.H
    assert np.sqrt(np.mean(error[inner] ** 2)) < 0.03 * np.std(a)


def test_what_is_drawn_keeps_the_waves_as_high_as_the_model_has_them() -> None:
    """In holes of four seconds most of it is drawn; the same record has the same filling every time."""
    _, a = simulated(SeaSystem(model()), DT_S, 12_000, seed=6)
    known = np.arange(12_000) % 200 >= 80
    mean, _ = bridged(a, known, DT_S, model(), None)
    one, other = (bridged(a, known, DT_S, model(), np.random.default_rng(4))[0] for _ in range(2))
    assert np.array_equal(one, other)
    assert np.array_equal(one[known], a[known])
    middle = (np.arange(12_000) % 200 >= 30) & (np.arange(12_000) % 200 < 50)
    assert np.std(one[middle]) == pytest.approx(np.sqrt(covariance(1)[0]), rel=0.2)
    assert np.std(one[middle] - a[middle]) > 1.2 * np.std(mean[middle] - a[middle])
