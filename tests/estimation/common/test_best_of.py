"""The choice between filters, against averages worked out by hand."""

from __future__ import annotations

from math import exp, log

import numpy as np
import pytest

from heaved.estimation.common.best_of import BestOf


def test_without_memory_the_smaller_innovation_wins_at_every_instant() -> None:
    rng, best_of = np.random.default_rng(1), BestOf(3, 2, 0.0, 0.0)
    before, changes = 2, 0
    for _ in range(100):
        innovations = rng.normal(size=3)
        best_of.step(0, 0.05, innovations)
        best = int(np.argmin(np.abs(innovations)))
        changes += best != before
        before = best
        assert best_of.serving == [best, 2]
    assert best_of.switches == changes > 30


@pytest.mark.parametrize("margin", [0.0, 0.05, 0.3])
def test_with_memory_it_takes_as_long_as_the_average_does(margin: float) -> None:
    """For long the filters err by (3, 1), then by (1, 3) squared: the averages are 2 -+ (2 exp(-t / T) - 1)."""
    memory_s, dt_s = 2.0, 0.01
    best_of = BestOf(2, 2, memory_s, margin)
    for _ in range(2000):
        best_of.step(1, dt_s, np.sqrt([3.0, 1.0]))
    assert best_of.serving == [1, 1]
    steps = 0
    while best_of.serving[1] == 1:
        best_of.step(1, dt_s, np.sqrt([1.0, 3.0]))
        steps += 1
        assert steps < 1000
    # 1 + 2 e = (1 - margin) (3 - 2 e)
    share = (3.0 * (1.0 - margin) - 1.0) / (2.0 + 2.0 * (1.0 - margin))
    assert exp(-steps * dt_s / memory_s) == pytest.approx(share, rel=0.02)
    assert margin > 0.0 or steps * dt_s == pytest.approx(memory_s * log(2.0), abs=0.03)
    assert best_of.switches == 1


def test_a_filter_that_is_hardly_better_does_not_take_over() -> None:
    best_of = BestOf(2, 2, 2.0, 0.05)
    for _ in range(500):
        best_of.step(0, 0.05, np.array([0.98, 1.0]))
    assert (best_of.serving, best_of.switches) == ([1, 1], 0)


def test_one_filter_for_all_is_one_change() -> None:
    best_of = BestOf(3, 2, 0.0, 0.0)
    for chosen in (2, 2, 0, 0, 1):
        best_of.serve_all(chosen)
    assert (best_of.serving, best_of.switches) == ([1, 1], 2)
    best_of.reset()
    assert (best_of.serving, best_of.switches) == ([2, 2], 2)
