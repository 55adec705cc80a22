"""Oracle: averages by hand; and that means never cease, whatever the machine does to the times."""

import numpy as np
import pytest

from heaved.estimation.common.down_sampler import DownSampler, passed


def means(times: list[float], values: list[float]) -> list[tuple[float, float]]:
    down_sampler = DownSampler()
    return [done for t, a in zip(times, values, strict=True) if (done := down_sampler.step(t, a)) is not None]


@pytest.mark.parametrize(("rate_hz", "size"), [(5.0, 1), (20.0, 1), (50.0, 2), (100.0, 5), (200.0, 10)])
def test_each_is_the_mean_of_its_samples(rate_hz: float, size: int) -> None:
    times = [k / rate_hz for k in range(200)]
    done = means(times, [2.0 * t for t in times])
    assert len(done) == pytest.approx(200 / size, abs=8 / size + 1)
    assert all(a == pytest.approx(2.0 * t) for t, a in done)  # the mean of a line is the line at the mean time
    assert np.diff([t for t, _ in done[2:]]) == pytest.approx(size / rate_hz)


def test_a_hiccup_of_the_machine_does_not_stop_them() -> None:
    times = [0.01 * k for k in range(3000)]
    for k in range(100, 3000, 173):
        times[k] = times[k + 1] - 0.0004 if k + 1 < 3000 else times[k]  # late, and its successor in time
    done = means(times, [0.0] * 3000)
    assert len(done) > 0.97 * 3000 / 5


def test_lost_samples_make_it_a_mean_of_fewer() -> None:
    """A third of them at random: the means go on at about their pace, each on the line at its own time."""
    kept = np.random.default_rng(2).random(3000) > 1 / 3
    times = (0.01 * np.arange(3000))[kept].tolist()
    done = means(times, [2.0 * t for t in times])
    steps = np.diff([t for t, _ in done[2:]])
    assert all(a == pytest.approx(2.0 * t) for t, a in done)
    assert np.max(steps) < 0.2
    assert np.mean(steps) < 0.07


def test_what_was_begun_before_a_gap_is_dropped() -> None:
    times = [0.01 * k for k in range(103)] + [5.0 + 0.01 * k for k in range(20)]
    done = means(times, [0.0] * 103 + [1.0] * 20)
    assert {a for _, a in done} == {0.0, 1.0}
    assert all(t < 1.03 or t >= 5.0 for t, _ in done)


def test_the_usual_interval_may_be_known_from_before() -> None:
    down_sampler = DownSampler(0.01)
    assert [down_sampler.step(0.01 * k, 1.0) for k in range(5)][:4] == [None] * 4


@pytest.mark.parametrize(("rate_hz", "f_hz"), [(100.0, 20.03), (100.0, 39.9), (200.0, 20.1), (50.0, 25.05)])
def test_what_would_fold_into_the_waves_is_left_out(rate_hz: float, f_hz: float) -> None:
    """A generator near a multiple of the means' rate: a plain mean of each lets 0.1 to 0.5 % through."""
    times = np.arange(round(60.0 * rate_hz)) / rate_hz
    done = means(times.tolist(), np.sin(2 * np.pi * f_hz * times).tolist())[3:]
    assert max(abs(a) for _, a in done) < 6e-5


@pytest.mark.parametrize(("rate_hz", "averaged"), [(50.0, 2), (100.0, 5), (200.0, 10)])
def test_share_of_a_frequency_that_is_let_through(rate_hz: float, averaged: int) -> None:
    times = np.arange(round(60.0 * rate_hz)) / rate_hz
    for f_hz in (0.5, 3.0, 7.0):
        done = np.array(means(times.tolist(), np.sin(2 * np.pi * f_hz * times).tolist())[3:])
        level = np.sqrt(2.0 * np.mean(done[:, 1] ** 2))
        assert level**2 == pytest.approx(float(passed(np.array([f_hz]), 1.0 / rate_hz, averaged)[0]), rel=0.02)
