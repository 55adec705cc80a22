"""The bounds that accuracy tables divide by, against closed forms and Riccati equations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from evidence.limits import autocovariance, causal_heave_limit, holed_prediction_limit, prediction_limit
from numpy.typing import NDArray
from scipy.linalg import expm, solve_continuous_are, solve_discrete_are

if TYPE_CHECKING:
    from collections.abc import Callable

Array = NDArray[np.float64]


def test_autocovariance_of_an_exponentially_correlated_process() -> None:
    f = np.arange(0.0, 400.0, 1 / 200)
    rate = 2.0
    spectrum = 4 * rate / (rate**2 + (2 * np.pi * f) ** 2)  # variance 1
    lags = np.array([0.0, 0.1, 0.5, 1.0])
    assert autocovariance(f, spectrum, lags) == pytest.approx(np.exp(-rate * lags), abs=2e-3)


def resonator(omega: float, damping: float) -> tuple[Array, Callable[[Array], Array]]:
    """x'' = -w^2 x - 2 z w x' + unit white noise: transition matrix and displacement spectrum (one-sided)."""
    a = np.array([[0.0, 1.0], [-(omega**2), -2 * damping * omega]])

    def spectrum(f: Array) -> Array:
        w = 2 * np.pi * f
        return 2 / ((omega**2 - w**2) ** 2 + (2 * damping * omega * w) ** 2)

    return a, spectrum


@pytest.mark.parametrize("noise_std", [0.02, 0.3])
def test_prediction_limit_is_the_kalman_predictor_of_a_resonator(noise_std: float) -> None:
    omega, damping, rate = 2 * np.pi / 5, 0.1, 20.0
    a, spectrum = resonator(omega, damping)
    horizons = np.array([0.05, 0.15, 1.0])

    def noise_over(dt: float) -> Array:
        block = expm(np.block([[-a, np.diag([0.0, 1.0])], [np.zeros((2, 2)), a.T]]) * dt)
        return block[2:, 2:].T @ block[:2, 2:]

    f_step = expm(a / rate)
    prior = solve_discrete_are(f_step.T, np.array([[1.0], [0.0]]), noise_over(1 / rate), np.array([[noise_std**2]]))
    gain = prior[:, :1] / (prior[0, 0] + noise_std**2)
    posterior = prior - gain @ prior[:1]
    expected = [np.sqrt((expm(a * h) @ posterior @ expm(a * h).T + noise_over(h))[0, 0]) for h in horizons]

    f = np.arange(0.0, 25.0, 1 / 200)
    found = prediction_limit(f, spectrum(f), noise_std, rate, horizons, memory_s=20.0)
    assert found == pytest.approx(expected, rel=2e-3)


def test_prediction_limit_needs_noise() -> None:
    f = np.arange(0.0, 1.0, 0.01)
    with pytest.raises(ValueError, match="noise_std"):
        prediction_limit(f, np.ones_like(f), 0.0, 20.0, np.array([0.05]))


def test_the_limit_in_holes_is_that_of_whole_records_without_any_and_grows_with_the_age_of_the_last_sample() -> None:
    _, spectrum = resonator(2 * np.pi / 8.0, 0.1)
    f = np.arange(0.0, 20.0, 1 / 400)
    density, horizons = spectrum(f), np.array([0.1, 0.5, 1.0])
    noise = 0.02 * np.sqrt(np.trapezoid(density, f))
    t = np.arange(0.0, 30.0, 0.1)
    whole = prediction_limit(f, density, noise, 10.0, horizons, memory_s=20.0)
    found = holed_prediction_limit(f, density, noise, t, horizons, t[-1:], memory_s=20.0)
    assert found[0] == pytest.approx(whole, rel=1e-3)
    holed = t[(t < 25.0) | (t > 27.05)]
    ages = holed_prediction_limit(f, density, noise, holed, horizons, np.array([24.9, 25.5, 26.5, 27.1, 29.9]))
    assert np.all(np.diff(ages[:3], axis=0) > 0.0)
    assert np.all(ages[3] < ages[2])
    assert ages[4] == pytest.approx(ages[0], rel=0.05)
    with pytest.raises(ValueError, match="positive"):
        holed_prediction_limit(f, density, 0.0, t, horizons, t[-1:])


@pytest.mark.parametrize("noise_psd", [1e-4, 1e-2])
def test_causal_heave_limit_is_the_kalman_bucy_filter(noise_psd: float) -> None:
    """A resonator driven by a slowly forgetting force: its acceleration holds no white noise of its own."""
    omega, damping, forget = 2 * np.pi / 8, 0.2, 1.0
    a = np.array([[0.0, 1.0, 0.0], [-(omega**2), -2 * damping * omega, 1.0], [0.0, 0.0, -forget]])
    h = a[1:2]
    p = solve_continuous_are(a.T, h.T, np.diag([0.0, 0.0, 1.0]), np.array([[noise_psd / 2]]))

    f = np.arange(0.0, 40.0, 1 / 800)
    w = 2 * np.pi * f
    force = 2 / (forget**2 + w**2)
    heave = force / ((omega**2 - w**2) ** 2 + (2 * damping * omega * w) ** 2)
    assert causal_heave_limit(f, heave, noise_psd) == pytest.approx(np.sqrt(p[0, 0]), rel=5e-3)


def test_waiting_lowers_the_limit_down_to_the_two_sided_wiener_filter() -> None:
    f = np.arange(0.0, 10.0, 1 / 800)
    ratio = f * 8.0
    heave = 1e-2 / ((1 - ratio**2) ** 2 + (0.4 * ratio) ** 2)
    signal, noise = (2 * np.pi * f) ** 4 * heave, 1e-4
    two_sided = np.sqrt(np.trapezoid(heave * noise / (signal + noise), f))
    limits = [causal_heave_limit(f, heave, noise, delay_s) for delay_s in (0.0, 2.0, 60.0)]
    assert limits[0] > limits[1] > limits[2]
    assert limits[2] == pytest.approx(two_sided, rel=1e-2)


@pytest.mark.parametrize(
    ("f", "noise", "message"),
    [
        (np.array([0.1, 0.2, 0.3]), 1.0, "uniform"),
        (np.array([0.0, 0.1, 0.3]), 1.0, "uniform"),
        (np.array([0.0, 0.1, 0.2]), 0.0, "positive"),
    ],
)
def test_bad_grids_are_refused(f: Array, noise: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        causal_heave_limit(f, np.ones(3), noise)
