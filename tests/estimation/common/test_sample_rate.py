"""How often samples come and how many are lost, against what was done to the stamps."""

from __future__ import annotations

from math import isnan

import numpy as np
import pytest

from heaved.estimation.common.sample_rate import TUNING, Arrivals, Clock, usual_interval

PERIOD_S = 0.01


def stamps(seconds: float, *, lost: float = 0.0, jitter_s: float = 0.0, seed: int = 1) -> np.ndarray:
    """Every 10 ms, off by up to ``jitter_s`` either way, some not there."""
    rng = np.random.default_rng(seed)
    t = PERIOD_S * np.arange(round(seconds / PERIOD_S))
    t = t + rng.uniform(-jitter_s, jitter_s, len(t))
    return t[rng.random(len(t)) >= lost]


def fed(*parts: np.ndarray) -> Arrivals:
    arrivals, end_s = Arrivals(), 0.0
    for t in parts:
        for moment in (end_s + t - t[0]).tolist():
            arrivals.step(moment)
        end_s += t[-1] - t[0] + PERIOD_S
    return arrivals


@pytest.mark.parametrize("jitter", [0.0, 0.1, 0.3, 0.49])
def test_the_usual_interval_under_jitter(jitter: float) -> None:
    """A percent in 2 s of 100 Hz."""
    for seed in range(20):
        t = np.arange(200) + np.random.default_rng(seed).uniform(-jitter, jitter, 200)
        assert usual_interval(t) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_the_usual_interval_among_lost_polls(seed: int) -> None:
    t = (np.arange(3000) / 100.0)[np.random.default_rng(seed).random(3000) > 0.2]
    for begin in range(0, len(t) - 80, 40):
        assert usual_interval(t[begin : begin + 76]) == pytest.approx(0.01, rel=1e-9), begin


@pytest.mark.parametrize("lost", [0.6, 0.75])
@pytest.mark.parametrize("jitter_s", [0.0, 0.0003])
def test_the_usual_interval_where_most_polls_are_lost(lost: float, jitter_s: float) -> None:
    """Of 6 s of 20 Hz; not with every draw does one interval in ten hold no loss, but with most."""
    right = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        t = 0.05 * np.arange(120) + rng.uniform(-jitter_s, jitter_s, 120)
        right += usual_interval(t[rng.random(120) >= lost]) == pytest.approx(0.05, rel=2e-3)
    assert right >= 34


@pytest.mark.parametrize("apart_s", [1e-6, 1e-3, 5e-3])
def test_bursts_are_no_line_that_loses_polls(apart_s: float) -> None:
    t = np.add.outer(0.1 * np.arange(40), apart_s * np.arange(4)).ravel()
    assert usual_interval(t) > 2.0 * apart_s


@pytest.mark.parametrize("lost", [0.0, 0.1, 0.3, 0.5])
def test_the_share_of_lost_samples(lost: float) -> None:
    arrivals = fed(stamps(10.0), stamps(400.0, lost=lost))
    assert arrivals.period_s == pytest.approx(PERIOD_S, rel=1e-6)
    assert arrivals.missing == pytest.approx(lost, abs=0.02)


@pytest.mark.parametrize("jitter_s", [0.002, 0.004, 0.0049])
def test_jitter_is_no_loss(jitter_s: float) -> None:
    arrivals = fed(stamps(120.0, jitter_s=jitter_s))
    assert arrivals.period_s == pytest.approx(PERIOD_S, rel=0.01)
    assert arrivals.missing < 0.01


def test_what_is_lost_does_not_become_what_is_usual() -> None:
    """Three of five at a time, whose intervals alone might be those of a slower sensor; four of five at random."""
    t = stamps(400.0)
    three_of_five = t[np.isin(np.arange(len(t)) % 5, (0, 1))]
    for then, lost in ((three_of_five, 0.6), (stamps(400.0, lost=0.8), 0.8)):
        arrivals = fed(stamps(60.0), then)
        assert arrivals.period_s == pytest.approx(PERIOD_S, rel=1e-6)
        assert arrivals.missing == pytest.approx(lost, abs=0.03)


@pytest.mark.parametrize("factor", [0.2, 0.5, 2.0, 5.0])
def test_another_rate_is_no_loss(factor: float) -> None:
    arrivals = fed(stamps(60.0), factor * stamps(60.0))
    assert arrivals.period_s == pytest.approx(factor * PERIOD_S, rel=1e-6)
    assert arrivals.missing < 0.03


def test_a_gap_is_a_loss_that_is_forgotten() -> None:
    """Ten seconds in a memory of sixty."""
    arrivals = fed(stamps(60.0), 10.0 + stamps(4.0))
    assert arrivals.missing < 0.01
    for t_s in np.arange(74.0, 78.0, PERIOD_S).tolist():
        arrivals.step(t_s)
    assert arrivals.missing == pytest.approx(10.0 / 60.0, abs=0.03)
    for t_s in np.arange(78.0, 198.0, PERIOD_S).tolist():
        arrivals.step(t_s)
    assert arrivals.missing < 0.03


def test_nothing_is_known_at_first() -> None:
    arrivals = fed(stamps(0.9 * TUNING.window_s))
    assert isnan(arrivals.period_s)
    assert arrivals.missing == 0.0
    assert fed(100.0 * stamps(PERIOD_S * TUNING.first)).period_s == pytest.approx(1.0)


def test_a_clock_is_the_least_squares_line_through_its_ticks() -> None:
    rng = np.random.default_rng(5)
    clock, seen = Clock(longest=10_000), 3.0 + 0.2 * np.arange(60) + 0.01 * rng.standard_normal(60)
    clock.set(0.2, seen[0], 1)
    for t_s in seen[1:].tolist():
        clock.advance(1)
        clock.correct(t_s - clock.tick_s)
    slope, first = np.polyfit(np.arange(60), seen, 1)
    assert clock.period_s == pytest.approx(slope, abs=1e-12)
    assert clock.tick_s == pytest.approx(first + 59 * slope, abs=1e-12)


def test_a_clock_follows_one_that_drifts() -> None:
    clock = Clock(longest=60)
    clock.set(0.1, 0.0, 60)
    for k in range(1, 2000):
        clock.advance(1)
        clock.correct(0.1001 * k - clock.tick_s)
    assert clock.period_s == pytest.approx(0.1001, rel=1e-6)


def test_an_outage_that_is_over_is_no_share_of_lost_samples() -> None:
    """A minute without samples, between two of a line that loses none."""
    arrivals = Arrivals()
    for k in range(2000):
        arrivals.step(0.05 * k + (60.0 if k >= 1000 else 0.0))
        assert arrivals.missing < 0.01
    assert arrivals.period_s == pytest.approx(0.05)
