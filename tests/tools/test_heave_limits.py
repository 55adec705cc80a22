"""The least errors that heave is held against, by another road: normal equations of the sampled record."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
import pytest
from evidence import scenarios
from evidence.limits import causal_heave_filter, causal_heave_limit, drift_limit, noncausal_heave_limit
from scipy.linalg import solve_toeplitz
from scipy.signal import fftconvolve

from heaved.samples import GRAVITY_MPS2
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import SENSORS, ImuModel, record

RATE_HZ = 4.0
NOISE_PSD = 4e-5
MEMORY_S = 250.0


@cache
def grid(sea: str) -> tuple[np.ndarray, np.ndarray]:
    f = np.linspace(0.0, RATE_HZ / 2, 2**13 + 1)
    return f, scenarios.simulated_spectrum(sea, f)


def optimal(sea: str, ahead_s: float, noise_psd: float = NOISE_PSD) -> tuple[np.ndarray, float]:
    """Optimal weights on the last 250 s of noisy samples of acceleration, newest first, for heave ``ahead_s`` later,
    and their RMS error.

    Toeplitz normal equations R w = r, error^2 = r_hh(0) - r' w, with the covariances summed over the spectrum.
    """
    f, heave = grid(sea)
    omega, weight = 2 * np.pi * f, np.full(f.size, f[1])
    weight[[0, -1]] /= 2
    lags = np.arange(round(MEMORY_S * RATE_HZ)) / RATE_HZ
    waves = np.cos(np.outer(lags, omega))
    measured = waves @ (omega**4 * heave * weight)
    measured[0] += noise_psd * RATE_HZ / 2
    wanted = np.cos(np.outer(lags + ahead_s, omega)) @ (-(omega**2) * heave * weight)
    weights = solve_toeplitz(measured, wanted)
    return weights, float(np.sqrt(np.sum(heave * weight) - wanted @ weights))


def best_of_the_samples(sea: str, ahead_s: float) -> float:
    return optimal(sea, ahead_s)[1]


@pytest.mark.parametrize("sea", ["S4", "S6"])
@pytest.mark.parametrize("ahead_s", [-60.0, -1.5, 0.0, 0.5, 2.0, 5.0])
def test_limit_now_ahead_and_delayed_is_that_of_the_normal_equations(sea: str, ahead_s: float) -> None:
    found = causal_heave_limit(*grid(sea), NOISE_PSD, delay_s=-ahead_s)
    assert found == pytest.approx(best_of_the_samples(sea, ahead_s), rel=0.02)


@pytest.mark.parametrize("ahead_s", [0.0, 1.0, -20.0])
def test_the_optimal_filter_reaches_the_limit_on_a_record(ahead_s: float) -> None:
    """Simulator, sensor noise and limit agree: 5000 s of S4 through the weights above, some 500 independent errors."""
    noise = 1e-5
    sensor = ImuModel(noise_mps2_rthz=float(np.sqrt(noise)))
    made = record(seaway("S4", 5, attitude=False), 5000.0, imu_rate_hz=RATE_HZ, sensor=sensor, laser="off", seed=6)
    weights, _ = optimal("S4", ahead_s, noise)
    estimate = fftconvolve(made.az_mps2 - GRAVITY_MPS2, weights)[: made.t_s.size]
    shift = round(ahead_s * RATE_HZ)
    error = (np.roll(made.truth.heave_m, -shift) - estimate)[weights.size : made.t_s.size - max(shift, 0)]
    limit = causal_heave_limit(*grid("S4"), noise, delay_s=-ahead_s)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(limit, rel=0.12)


@pytest.mark.parametrize("sea", ["S4", "S6"])
def test_past_and_future_are_an_endless_delay(sea: str) -> None:
    found = noncausal_heave_limit(*grid(sea), NOISE_PSD)
    assert found == pytest.approx(best_of_the_samples(sea, -100.0), rel=0.02)
    assert found < 0.5 * causal_heave_limit(*grid(sea), NOISE_PSD)


def test_without_knowing_anything_the_best_forecast_is_no_motion() -> None:
    f, heave = grid("S4")
    sigma = np.sqrt(np.trapezoid(heave, f))
    assert causal_heave_limit(f, heave, 1e4) == pytest.approx(sigma, rel=0.01)
    assert causal_heave_limit(f, heave, NOISE_PSD, delay_s=-120.0) == pytest.approx(sigma, rel=0.01)


def test_limits_of_the_standard_seas_are_what_was_found_elsewhere() -> None:
    """Shares of the standard deviation found on seas that end at 0.6 Hz; ours end at 1.2 Hz and tell less ahead."""
    f = np.linspace(0.0, 2.0, 4001)
    for sea, causal, delayed in (("S4", 0.017, 0.0018), ("S6", 0.008, 0.0006)):
        sigma = np.sqrt(np.trapezoid(scenarios.simulated_spectrum(sea, f), f))
        shown = scenarios.limits_of(partial(scenarios.simulated_spectrum, sea), "A", 20.0)
        assert shown.causal_m / sigma == pytest.approx(causal, rel=0.15)
        assert shown.noncausal_m / sigma == pytest.approx(delayed, rel=0.15)
        assert list(shown.forecast_m.values()) == sorted(shown.forecast_m.values())
        worse = scenarios.limits_of(partial(scenarios.simulated_spectrum, sea), "B", 20.0)
        assert 1.3 * shown.causal_m < worse.causal_m < 4.0 * shown.causal_m


def test_the_noise_of_a_sensor_is_what_its_records_have() -> None:
    """Periodogram of what a still sensor reads, against the density that the limits are made with."""
    still = record(seaway("S0"), 4000.0, imu_rate_hz=10.0, sensor="B", laser="off", seed=5)
    noise = still.az_mps2 - np.mean(still.az_mps2)
    n = noise.size
    periodogram = 2.0 * np.abs(np.fft.rfft(noise)) ** 2 / (n * 10.0)
    f = np.asarray(np.fft.rfftfreq(n, 0.1), dtype=np.float64)
    expected = scenarios.accelerometer_noise(f, SENSORS["B"], 10.0)
    model = SENSORS["B"]
    undone = model.scale**2 / (1.0 + (f / model.bandwidth_hz) ** 4)  # noise is added behind scale and low-pass
    for low, high in ((0.01, 0.05), (0.5, 1.0), (2.0, 4.0)):
        band = (f >= low) & (f < high)
        found = np.mean(periodogram[band]) / np.mean(expected[band] * undone[band])
        assert found == pytest.approx(1.0, abs=4.0 / np.sqrt(np.sum(band)))


def added_when_the_beginning_is_known(sea: str, rate_mps3: float) -> float:
    """Integral of the mean square error that a drift adds, m2 s, for whoever knows its beginning: the conditional
    variance of heave, with the ramp as one more column of unknown size in the covariance of the last 120 s of samples.
    """
    f, heave = grid(sea)
    omega, weight = 2 * np.pi * f, np.full(f.size, f[1])
    weight[[0, -1]] /= 2
    count = round(120.0 * RATE_HZ)
    waves = np.cos(np.outer(np.arange(count) / RATE_HZ, omega))
    measured = waves @ (omega**4 * heave * weight)
    measured[0] += NOISE_PSD * RATE_HZ / 2
    wanted = waves @ (-(omega**2) * heave * weight)
    best = solve_toeplitz(measured, wanted)
    total = 0.0
    for seconds in range(2, 100, 3):
        ramp = np.maximum(seconds - np.arange(count) / RATE_HZ, 0.0)  # newest first
        seen = float(ramp @ best)
        total += 3.0 * seen**2 / (rate_mps3**-2 + float(ramp @ solve_toeplitz(measured, ramp)))
    return total


@pytest.mark.parametrize("sea", ["S4", "S6"])
def test_a_drift_costs_more_when_nobody_knows_when_it_began(sea: str) -> None:
    rate = 0.05 / 180.0
    found, known = drift_limit(*grid(sea), NOISE_PSD, rate), added_when_the_beginning_is_known(sea, rate)
    assert known < found.added_m2s < 8.0 * known
    assert 0.0 < found.lies_s < 10.0
    assert drift_limit(*grid(sea), NOISE_PSD, 1e-3 * rate).lies_s < 0.05


def test_the_filter_that_reaches_the_limit_is_the_one_of_the_normal_equations() -> None:
    """And makes that error of the acceleration's own spectra: by Parseval, of its response."""
    f, heave = grid("S4")
    weights = causal_heave_filter(f, heave, NOISE_PSD)
    expected, error_m = optimal("S4", 0.0)
    assert weights[: expected.size] == pytest.approx(expected, abs=2e-3 * float(np.max(np.abs(expected))))
    response = np.fft.rfft(weights, 2 * (f.size - 1))
    omega2 = (2 * np.pi * f) ** 2
    left = heave * np.abs(1.0 + omega2 * response) ** 2 + NOISE_PSD * np.abs(response) ** 2
    assert np.sqrt(np.trapezoid(left, f)) == pytest.approx(error_m, rel=0.01)


def test_on_a_record_it_errs_about_as_much() -> None:
    """Ten minutes hold some tens of the waves that the error consists of: by chance it is a fifth more or less."""
    setting = scenarios.Setting(tilt="none", rate_hz=10.0, duration_s=600.0, scored_from_s=200.0)
    cases = [scenarios.build("S4", scenarios.triplet(number), setting) for number in (1, 2, 3, 4)]
    ratios = np.array([scenarios.limit_here_m(case) / case.limits.causal_m for case in cases])
    assert np.sqrt(np.mean(ratios**2)) == pytest.approx(1.0, abs=0.15)
    drifting = scenarios.build("S4", scenarios.triplet(1), scenarios.Setting(shake="warm-up", tilt="none"))
    assert np.isnan(scenarios.limit_here_m(drifting))
