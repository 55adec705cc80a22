"""Oracles: least squares on the same rows, and residuals that are a known function of the inputs."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from training_windows import delayed_residual, sea

from heaved.estimation.heave.laser.ridge import TUNING, Rows, can_gain

Array = NDArray[np.float64]
TRAINING, HELD = slice(0, 1400), slice(1450, 2000)


def gains(inputs: Array, residuals: Array, bar_m2: float, limit_m: float = 10.0) -> bool:
    training, held = (Rows(inputs=inputs[part], residuals=residuals[part]) for part in (TRAINING, HELD))
    return can_gain(training, held, limit_m=limit_m, bar_m2=bar_m2)


def mean_square(values: Array) -> float:
    return float(np.mean(values**2))


def windows(seed: int = 5) -> Array:
    return np.ascontiguousarray(np.lib.stride_tricks.sliding_window_view(sea(2049, seed), 50))


def test_it_gains_what_least_squares_gains_and_no_more() -> None:
    inputs, residuals = delayed_residual(2000)
    design = np.hstack((inputs, np.ones((2000, 1))))
    coefficients, *_ = np.linalg.lstsq(design[TRAINING], residuals[TRAINING], rcond=None)
    best = mean_square(residuals[HELD] - design[HELD] @ coefficients)
    assert mean_square(residuals[HELD]) > 10.0 * best
    assert gains(inputs, residuals, 1.05 * best / TUNING.linear)
    assert not gains(inputs, residuals, 0.95 * best / TUNING.linear)


@pytest.mark.parametrize("seed", range(5))
def test_there_is_nothing_to_gain_in_noise(seed: int) -> None:
    noise = np.random.default_rng(seed).standard_normal(2000)
    assert not gains(windows(), noise, mean_square(noise[HELD]))


@pytest.mark.parametrize("seed", [5, 6, 7])
@pytest.mark.parametrize("shape", ["a square", "a cube", "a range with an end"])
def test_what_is_not_linear_is_found_too(shape: str, seed: int) -> None:
    """Of the input in the middle, when a linear regression has taken its part."""
    inputs = windows(seed)
    x = inputs[:, 25]
    residuals = 0.1 * {"a square": x**2, "a cube": x**3, "a range with an end": np.maximum(x - 0.5, 0.0)}[shape]
    design = np.hstack((inputs, np.ones((2000, 1))))
    residuals = residuals - design @ np.linalg.lstsq(design, residuals, rcond=None)[0]
    assert gains(inputs, residuals, mean_square(residuals[HELD]))


def test_a_correction_is_bounded_as_it_will_be_in_use() -> None:
    inputs, residuals = delayed_residual(2000, noise=0.0)
    bounded = mean_square(residuals[HELD] - np.clip(residuals[HELD], -0.05, 0.05))
    assert gains(inputs, residuals, 1.01 * bounded / TUNING.linear, limit_m=0.05)
    assert not gains(inputs, residuals, 0.99 * bounded / TUNING.linear, limit_m=0.05)


def test_inputs_that_stand_still_teach_nothing() -> None:
    assert not gains(np.ones((2000, 50)), windows()[:, 0], np.inf)
