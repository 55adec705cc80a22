"""The limits of heave on a hull that shakes, by another road: normal equations of the sampled record."""

from __future__ import annotations

import numpy as np
import pytest
from evidence import scenarios
from evidence.limits import causal_heave_limit
from scipy.linalg import solve_toeplitz
from scipy.signal import fftconvolve

from heaved.samples import GRAVITY_MPS2
from heaved.simulate import shaking
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import ImuModel, record

SENSOR = ImuModel(noise_mps2_rthz=1e-3)
MEMORY_S = 150.0


def optimal(sea: str, shake: str, rate_hz: float) -> tuple[np.ndarray, float]:
    """Optimal weights on the last 150 s of samples, newest first, and their RMS error: R w = r, with the covariances
    as Fourier sums of the densities."""
    f = scenarios.grid(rate_hz)
    heave, omega = scenarios.simulated_spectrum(sea, f), 2.0 * np.pi * f
    noise = scenarios.accelerometer_noise(f, SENSOR, rate_hz, shake)
    count = round(MEMORY_S * rate_hz)
    to_variance = rate_hz / 2.0
    measured = np.fft.irfft(omega**4 * heave + noise)[:count] * to_variance
    wanted = np.fft.irfft(-(omega**2) * heave)[:count] * to_variance
    weights = solve_toeplitz(measured, wanted)
    variance = np.fft.irfft(heave)[0] * to_variance
    return weights, float(np.sqrt(variance - wanted @ weights))


@pytest.mark.parametrize(
    ("sea", "shake", "rate_hz"),
    [
        ("S4", "line-1.3", 20.0),
        ("S6", "line-3.1", 10.0),
        ("S4", "engines", 20.0),
        ("S6", "broadband", 20.0),
        ("S6", "broadband", 10.0),
        ("S4", "whipping", 10.0),
        ("S6", "slams", 10.0),
        ("CRAFT", "engine-room", 20.0),
    ],
)
def test_limit_under_vibration_is_that_of_the_normal_equations(sea: str, shake: str, rate_hz: float) -> None:
    f = scenarios.grid(rate_hz)
    noise = scenarios.accelerometer_noise(f, SENSOR, rate_hz, shake)
    found = causal_heave_limit(f, scenarios.simulated_spectrum(sea, f), noise)
    assert found == pytest.approx(optimal(sea, shake, rate_hz)[1], rel=0.02)


@pytest.mark.parametrize("shake", ["line-3.1", "whipping", "broadband", "slams"])
def test_the_optimal_filter_reaches_the_limit_on_a_shaken_record(shake: str) -> None:
    """Simulator, density and limit agree: 3000 s of S4 through the weights above."""
    rate_hz = 10.0
    made = record(
        seaway("S4", 5, attitude=False), 3000.0, imu_rate_hz=rate_hz, sensor=SENSOR, laser="off", shake=shake, seed=6
    )
    weights, limit = optimal("S4", shake, rate_hz)
    reading = made.az_mps2 - GRAVITY_MPS2
    estimate = fftconvolve(reading - np.mean(reading), weights)[: reading.size]
    error = (made.truth.heave_m - estimate)[weights.size :]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(limit, rel=0.15)


@pytest.mark.parametrize(("sea", "shake"), [("S4", "line-1.3"), ("S6", "line-3.1"), ("S6", "line-25.1")])
def test_the_width_that_stands_for_a_line_hardly_matters(
    sea: str, shake: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenarios.sea_limits.cache_clear()
    clean = scenarios.sea_limits(sea, "A", 20.0).causal_m
    limits = []
    for width_hz in (0.01, 0.02, 0.04):
        monkeypatch.setattr(shaking, "LINE_WIDTH_HZ", width_hz)
        scenarios.sea_limits.cache_clear()
        limits.append(scenarios.sea_limits(sea, "A", 20.0, shake).causal_m)
    scenarios.sea_limits.cache_clear()
    assert clean < limits[0] < limits[1] < limits[2] < 1.05 * clean


def test_what_is_no_vibration_leaves_the_limit_alone() -> None:
    clean = scenarios.sea_limits("S6", "A", 20.0)
    for name in ("warm-up", "turn", "list-step"):
        assert scenarios.sea_limits("S6", "A", 20.0, name) == clean


def test_a_finer_grid_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    found = scenarios.sea_limits("S4", "A", 20.0, "engine-room")
    monkeypatch.setattr(scenarios, "GRID_STEP_HZ", scenarios.GRID_STEP_HZ / 4.0)
    scenarios.sea_limits.cache_clear()
    finer = scenarios.sea_limits("S4", "A", 20.0, "engine-room")
    scenarios.sea_limits.cache_clear()
    assert finer.causal_m == pytest.approx(found.causal_m, rel=0.01)
    assert finer.noncausal_m == pytest.approx(found.noncausal_m, rel=0.01)
