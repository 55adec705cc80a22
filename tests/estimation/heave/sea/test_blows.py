"""Blows in noise and in steady vibration: when they are known to have been struck."""

from __future__ import annotations

import numpy as np
import pytest

from heaved.estimation.heave.sea.blows import BlowDetector
from heaved.simulate.seaway import seaway

DT_S, COUNT = 0.05, 6000
T = DT_S * np.arange(COUNT, dtype=np.float64)
Array = np.ndarray


def ringing(at_s: float, size_mps2: float, f_hz: float = 2.2, tau_s: float = 1.0) -> Array:
    since = np.maximum(T - at_s, 0.0)
    return np.asarray(size_mps2 * np.exp(-since / tau_s) * np.sin(2 * np.pi * f_hz * since))


def struck(added: Array, seed: int = 1) -> list[float]:
    noise = 3e-3 * np.random.default_rng(seed).standard_normal(COUNT)
    waves = seaway("S6", seed, attitude=False).motion(T).heave_acceleration_mps2
    blows, found = BlowDetector(), []
    for t_s, a in zip(T.tolist(), (waves + noise + added).tolist(), strict=True):
        if blows.step(t_s, a) > 0.0:
            found.append(t_s)
    return found


@pytest.mark.parametrize("size_mps2", [0.3, 2.0, 10.0])
@pytest.mark.parametrize("f_hz", [1.2, 2.2, 6.0])
def test_a_blow_is_known_with_its_first_beat(size_mps2: float, f_hz: float) -> None:
    assert struck(ringing(100.0 - 0.01, size_mps2, f_hz)) == [pytest.approx(100.0, abs=DT_S + 1e-9)]


def test_one_while_the_hull_still_rings_is_another() -> None:
    found = struck(ringing(99.99, 2.0) + ringing(101.49, 2.0))
    assert found == [pytest.approx(100.0, abs=0.06), pytest.approx(101.5, abs=0.06)]


def test_a_train_of_them_does_not_hide_the_last() -> None:
    """Three seconds apart, for half a minute: what rings between them is not usual."""
    at_s = np.arange(100.0, 125.0, 3.0) - 0.01
    found = struck(np.sum([ringing(one, 2.0) for one in at_s], axis=0))
    assert len(found) == len(at_s)
    assert found == pytest.approx((at_s + 0.01).tolist(), abs=0.06)


@pytest.mark.parametrize(
    "added",
    [
        0.0 * T,
        0.5 * np.sin(2 * np.pi * 3.1 * T),
        0.3 * np.random.default_rng(2).standard_normal(COUNT),
        0.5 * np.sin(2 * np.pi * 9.0 * T + 3.0 * np.sin(0.2 * T)),
    ],
    ids=["quiet", "line", "noise", "wandering line"],
)
def test_what_is_steady_is_no_blow(added: Array) -> None:
    assert struck(added) == []


def test_neither_is_what_follows_a_gap() -> None:
    blows = BlowDetector()
    noise = 1e-3 * np.random.default_rng(3).standard_normal(COUNT)
    later = T > 100.0
    taken = [blows.step(t, a) for t, a in zip((T + 5.0 * later).tolist(), (noise + 2.0 * later).tolist(), strict=True)]
    assert not any(taken)


@pytest.mark.parametrize("lost", [0.3, 0.6, 0.75, 0.88])
def test_what_the_waves_do_in_a_hole_is_no_blow(lost: float) -> None:
    """From a moment on most of the readings are lost, at random: from two that are far apart nothing leads on."""
    rng = np.random.default_rng(4)
    waves = seaway("S6", 1, attitude=False).motion(T).heave_acceleration_mps2 + 3e-3 * rng.standard_normal(COUNT)
    is_there = (T < 100.0) | (rng.random(COUNT) > lost)
    blows = BlowDetector()
    assert not any(
        blows.step(t_s, a) > 0.0 for t_s, a in zip(T[is_there].tolist(), waves[is_there].tolist(), strict=True)
    )


def test_a_sensor_that_comes_more_slowly_is_learned_anew() -> None:
    """Twenty readings a second, then two: what the waves do between two of those is none either."""
    waves = seaway("S6", 1, attitude=False).motion(T).heave_acceleration_mps2
    kept = (T < 100.0) | (np.arange(COUNT) % 10 == 0)
    blows = BlowDetector()
    assert not any(blows.step(t_s, a) > 0.0 for t_s, a in zip(T[kept].tolist(), waves[kept].tolist(), strict=True))
