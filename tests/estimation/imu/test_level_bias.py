"""Horizontal bias: against the posterior by summation over a grid, and by what it does to the vertical acceleration."""

from __future__ import annotations

from math import radians

import numpy as np
import pytest

from heaved.estimation.imu.attitude import up_acceleration
from heaved.estimation.imu.level_bias import LevelBias, bias_of_mean

G = 9.80665
T_S = 0.05 * np.arange(20_000)


def motion(seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Roll and pitch (rad) of a few degrees, and sway acceleration (m/s2), of several waves each."""
    rng = np.random.default_rng(seed)
    omega, phase = rng.uniform(0.4, 1.1, (3, 12)), rng.uniform(0.0, 2.0 * np.pi, (3, 12))
    size = np.array([radians(1.0), radians(0.6), 0.15])[:, None]
    roll, pitch, sway = np.sum(size[..., None] * np.sin(omega[..., None] * T_S + phase[..., None]), axis=1)
    return roll, pitch, sway


def force(bias: tuple[float, float], askew_rad: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Specific force (3, n), in axes turned by ``askew_rad`` about x against those of the attitude; roll, pitch."""
    roll, pitch, sway = motion()
    turned = roll + askew_rad
    level = np.array([np.zeros_like(sway), sway, np.full_like(sway, G)])
    fx = np.cos(pitch) * level[0] + np.sin(pitch) * level[2]
    fz = -np.sin(pitch) * level[0] + np.cos(pitch) * level[2]
    fy, fz = np.cos(turned) * level[1] + np.sin(turned) * fz, -np.sin(turned) * level[1] + np.cos(turned) * fz
    return np.array([fx + bias[0], fy + bias[1], fz]), roll, pitch


def errors(bias: tuple[float, float], askew_rad: float = 0.0) -> tuple[float, float, LevelBias]:
    """RMS of the wrong vertical acceleration in the second half, m/s2: with the bias left in, with it taken out."""
    f, roll, pitch = force(bias, askew_rad)
    found = LevelBias()
    plain, mended = [], []
    for t, fx, fy, fz, r, p in zip(T_S, *f, roll, pitch, strict=True):
        plain.append(up_acceleration(fx, fy, fz, r, p))
        mended.append(up_acceleration(fx - found.x_mps2, fy - found.y_mps2, fz, r, p))
        found.step(t, fx, fy, fz, r, p)
    half = len(T_S) // 2
    return float(np.std(plain[half:])), float(np.std(mended[half:])), found


@pytest.mark.parametrize("std", [0.0, 0.02])
@pytest.mark.parametrize("mean", [-0.1, -0.03, 0.0, 0.01, 0.05, 0.2])
def test_the_bias_is_the_mean_of_the_posterior(mean: float, std: float) -> None:
    """Bayes by summation: bias normal (0.03), attitude error normal, 0.001 or 0.0175 rad with even odds."""
    b = np.linspace(-0.3, 0.3, 60_001)
    joint = np.zeros_like(b)
    for attitude in (0.001, 0.0175**2 + 0.001**2):
        spread = G**2 * (attitude**2 if attitude == 0.001 else attitude) + std**2
        joint += np.exp(-0.5 * (mean - b) ** 2 / spread) / np.sqrt(spread) * np.exp(-0.5 * (b / 0.03) ** 2)
    expected = float(np.sum(b * joint) / np.sum(joint))
    # When askew, a little of the mean is bias all the same, which is left out.
    assert bias_of_mean(mean, std**2) == pytest.approx(expected, abs=0.1 * abs(mean) + 1e-9)


def test_most_of_a_bias_is_taken_out() -> None:
    before, after, found = errors((0.03, -0.03))
    assert found.x_mps2 == pytest.approx(0.022, abs=0.004)
    assert found.y_mps2 == pytest.approx(-0.022, abs=0.004)
    assert after < 0.45 * before


def test_a_unit_that_is_screwed_on_askew_is_left_alone() -> None:
    before, after, found = errors((0.0, 0.0), radians(1.0))
    assert abs(found.y_mps2) < 1e-3
    assert after == pytest.approx(before, rel=0.1, abs=1e-4)


def test_nothing_is_found_where_there_is_nothing() -> None:
    _, after, found = errors((0.0, 0.0))
    assert max(abs(found.x_mps2), abs(found.y_mps2)) < 2e-3
    assert after < 1e-4


@pytest.mark.parametrize("mean", [0.02, 0.045, 0.1, 1.0, 50.0])
def test_it_is_bounded_whatever_it_is_given(mean: float) -> None:
    assert abs(bias_of_mean(mean, 0.0)) < 0.03
    found = LevelBias()
    for i in range(2000):
        found.step(0.1 * i, mean, -mean, G, 0.0, 0.0)
    assert max(abs(found.x_mps2), abs(found.y_mps2)) < 0.03


def test_time_that_goes_back_or_stands_still_does_no_harm() -> None:
    found = LevelBias()
    for t in (0.0, 0.0, 100.0, 50.0, 50.05, 200.0):
        found.step(t, 0.03, 0.0, G, 0.0, 0.0)
    assert abs(found.x_mps2) < 0.03
