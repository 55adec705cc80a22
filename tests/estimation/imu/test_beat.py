"""How old the readings of a sensor are that is a little slower than its polls. Oracle: the ticks of its clock."""

from __future__ import annotations

import numpy as np
import pytest

from heaved.estimation.imu.beat import Beat

POLL_S = 0.05
Array = np.ndarray


def slower(ppm: float, seconds: float, phase: float) -> tuple[Array, Array, Array]:
    """Times of the polls, ages of what they show, and whether that is what the one before has shown."""
    t = POLL_S * np.arange(round(seconds / POLL_S))
    period_s = POLL_S * (1.0 + 1e-6 * ppm)
    tick = np.floor(t / period_s - phase + 1e-9)
    return t, t - (tick + phase) * period_s, np.diff(tick, prepend=-2.0) == 0.0


def followed(t: Array, is_repeated: Array) -> tuple[Array, Array]:
    beat, found = Beat(), []
    for t_s, repeated in zip(t.tolist(), is_repeated.tolist(), strict=True):
        beat.step(t_s, is_repeated=repeated)
        found.append((beat.age_s, beat.std_s))
    age_s, std_s = np.array(found).T
    return age_s, std_s


@pytest.mark.parametrize("ppm", [100.0, 500.0, 5000.0])
@pytest.mark.parametrize("phase", [0.1, 0.6])
def test_the_age_is_known_once_repetitions_are_even(ppm: float, phase: float) -> None:
    beat_s = POLL_S / (1e-6 * ppm)
    t, age_s, is_repeated = slower(ppm, 5.5 * beat_s, phase)
    found_s, std_s = followed(t, is_repeated)
    later = (t > 3.1 * beat_s) & ~is_repeated
    assert np.abs(found_s - age_s)[later].max() < 0.1 * POLL_S
    assert np.all(std_s[later] < 0.1 * POLL_S)


@pytest.mark.parametrize("phase", [0.1, 0.6])
def test_between_the_first_repetitions_nothing_is_moved_and_the_age_is_in_the_deviation(phase: float) -> None:
    t, age_s, is_repeated = slower(200.0, 700.0, phase)
    found_s, std_s = followed(t, is_repeated)
    first, second = t[is_repeated][:2]
    between = (t > first) & (t < second)
    assert np.all(found_s[between] == 0.0)
    assert np.all(age_s[between] < 4.0 * std_s[between])


def test_one_repetition_alone_is_forgotten() -> None:
    t = POLL_S * np.arange(40_000)
    found_s, std_s = followed(t, np.arange(len(t)) == 4_000)
    assert np.all(found_s == 0.0)
    assert std_s[4_001] > 0.5 * POLL_S
    assert std_s[-1] < 0.2 * POLL_S


def test_repetitions_by_chance_move_nothing() -> None:
    rng = np.random.default_rng(4)
    t = POLL_S * np.arange(40_000)
    found_s, std_s = followed(t, rng.random(len(t)) < 0.0005)
    assert np.mean(found_s > 0.0) < 0.02
    assert np.mean(std_s[20_000:] > 0.0) < 0.1
