"""The least errors from several channels, by other roads: normal equations of a finite past, a Riccati equation, a
polynomial whose factor is known, and the limit of one channel.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from math import radians, sqrt

import numpy as np
import pytest
from evidence import scenarios
from evidence.channel_limits import (
    PITCH,
    ROLL,
    Spectra,
    causal_filters,
    causal_limits,
    error_of,
    measured_spectra,
    multiple_coherence,
    spectral_factor,
)
from evidence.limits import causal_heave_limit
from scipy.linalg import solve, solve_discrete_are

from heaved.simulate.seaway import wave_spectrum
from heaved.simulate.vessel import CRANE_VESSEL

RATE_HZ = 3.0
ACCELERATION_PSD = 4e-5
ANGLE_PSD = radians(0.05) ** 2 / (RATE_HZ / 2.0)
MEMORY_S = 120.0


@cache
def motion(sea: str, coherence: float) -> tuple[np.ndarray, np.ndarray]:
    """A vessel whose every pair of freedoms has this squared coherence."""
    f = np.linspace(0.0, RATE_HZ / 2.0, 2**12 + 1)
    waves = np.where(f <= 1.2, wave_spectrum(sea, f), 0.0)
    transfer = CRANE_VESSEL.transfers(f)[[0, 3, 4]].T
    matrix = waves[:, None, None] * transfer[:, :, None] * transfer[:, None, :].conj()
    return f, matrix * np.where(np.eye(3), 1.0, sqrt(coherence))


def best_of_the_samples(sea: str, coherence: float, angles: tuple[int, ...], ahead_s: float) -> float:
    """RMS error of the best weights on the last 120 s of samples of all channels: the normal equations R w = r of the
    block-Toeplitz covariance, summed over the spectrum at each lag and solved as they stand.
    """
    f, matrix = motion(sea, coherence)
    weight = np.full(f.size, f[1])
    weight[[0, -1]] /= 2.0
    seen = [0, *angles]
    gain = np.ones((len(seen), f.size))
    gain[0] = -((2.0 * np.pi * f) ** 2)
    count = round(MEMORY_S * RATE_HZ)

    steps = np.arange(-count + 1, 2 * count)  # lags on beyond the memory: what is wanted may be ahead
    turn = np.outer(steps / RATE_HZ, 2.0 * np.pi * f)
    cosine, sine = np.cos(turn) * weight, np.sin(turn) * weight

    def covariance(spectrum: np.ndarray) -> np.ndarray:
        """E x(t + lag) y(t) of a cross-spectrum of x and y, at all the lags."""
        return np.asarray(cosine @ spectrum.real - sine @ spectrum.imag)

    place = np.arange(count)
    later = place[None, :] - place[:, None] + count - 1  # a row's sample is older by its place
    noise = [ACCELERATION_PSD * RATE_HZ / 2.0, *[ANGLE_PSD * RATE_HZ / 2.0] * len(angles)]
    blocks = [
        [covariance(gain[j] * gain[k] * matrix[:, a, b])[later] for k, b in enumerate(seen)] for j, a in enumerate(seen)
    ]
    for j, variance in enumerate(noise):
        blocks[j][j] = blocks[j][j] + variance * np.eye(count)
    wanted = np.concatenate(
        [
            covariance(gain[k] * matrix[:, 0, b])[place + count - 1 + round(ahead_s * RATE_HZ)]
            for k, b in enumerate(seen)
        ]
    )
    weights = solve(np.block(blocks), wanted, assume_a="pos")
    return sqrt(np.sum(matrix[:, 0, 0].real * weight) - wanted @ weights)


@pytest.mark.parametrize(
    ("sea", "coherence", "angles", "ahead_s"),
    [
        ("S6S", 0.0, (PITCH,), 0.0),
        ("S6S", 0.8, (PITCH,), 0.0),
        ("S6S", 0.95, (ROLL,), 2.0),
        ("S4", 0.9, (ROLL, PITCH), 0.0),
        ("S6", 0.9, (ROLL, PITCH), -2.0),
        ("S6", 0.9, (ROLL, PITCH), 5.0),
        ("S6S", 0.9, (ROLL, PITCH), 1.0),
    ],
)
def test_limits_are_those_of_the_normal_equations(
    sea: str, coherence: float, angles: tuple[int, ...], ahead_s: float
) -> None:
    spectra = measured_spectra(*motion(sea, coherence), ACCELERATION_PSD, ANGLE_PSD, angles)
    (found,) = causal_limits(spectra, [ahead_s])
    assert found == pytest.approx(best_of_the_samples(sea, coherence, angles, ahead_s), rel=0.02)


@pytest.mark.parametrize("angles", [(), (ROLL,), (ROLL, PITCH)])
@pytest.mark.parametrize("horizon_s", [0.0, 2.0])
def test_angles_that_are_not_coherent_tell_nothing(angles: tuple[int, ...], horizon_s: float) -> None:
    """With the coloured noise of a real sensor, against the limit of one channel."""
    f, matrix = motion("S6S", 0.0)
    noise = scenarios.accelerometer_noise(f, "A", RATE_HZ)
    alone = causal_heave_limit(f, matrix[:, 0, 0].real, noise, -horizon_s)
    (found,) = causal_limits(measured_spectra(f, matrix, noise, ANGLE_PSD, angles), [horizon_s])
    assert found == pytest.approx(alone, rel=1e-6)


def test_more_channels_and_more_coherence_never_hurt_and_further_ahead_is_never_easier() -> None:
    horizons = (-5.0, 0.0, 0.5, 1.0, 2.0, 5.0)
    found = {
        (coherence, angles): causal_limits(
            measured_spectra(*motion("S6S", coherence), ACCELERATION_PSD, ANGLE_PSD, angles), horizons
        )
        for coherence in (0.5, 0.8, 0.95, 1.0)
        for angles in ((), (ROLL,), (PITCH,), (ROLL, PITCH))
    }
    for limits in found.values():
        assert limits == sorted(limits)
    for less, more in pairwise((0.5, 0.8, 0.95)):
        assert found[more, (PITCH,)][1] < 0.97 * found[less, (PITCH,)][1]
    for coherence in (0.5, 0.8, 0.95, 1.0):
        for angle in (ROLL, PITCH):
            both, one, none = (found[coherence, angles][1] for angles in ((ROLL, PITCH), (angle,), ()))
            assert both <= one * (1.0 + 1e-9)
            assert one <= none * (1.0 + 1e-9)


def test_a_filter_reaches_the_limit_where_it_belongs_and_nowhere_is_below_it() -> None:
    """By the formula for any filter's error, which knows of no factor; and the filter is causal."""
    horizons = (0.0, 2.0)
    here, there = (
        measured_spectra(*motion("S6S", coherence), ACCELERATION_PSD, ANGLE_PSD, (ROLL, PITCH))
        for coherence in (0.95, 0.5)
    )
    for k, filter_ in enumerate(causal_filters(here, horizons)):
        own, other = (causal_limits(spectra, horizons)[k] for spectra in (here, there))
        assert error_of(filter_, here, horizons[k]) == pytest.approx(own, rel=1e-6)
        assert error_of(filter_, there, horizons[k]) > 1.05 * other
        response = np.fft.irfft(filter_, axis=0)
        later, earlier = np.split(response, 2)
        assert np.sum(earlier**2) < 1e-6 * np.sum(later**2)


def test_two_sensors_of_one_random_process_reach_what_the_riccati_equation_says() -> None:
    """x' = a x + w, seen by two sensors, the noise of one of them coloured: a Kalman filter."""
    a, driven, first, second, coloured, keeps = 0.95, 0.3, 0.5, 0.8, 0.6, 0.7
    f = np.linspace(0.0, 0.5, 2**11 + 1)
    turn = np.exp(-2j * np.pi * f)
    process = 2.0 * driven / np.abs(1.0 - a * turn) ** 2
    noise = 2.0 * (second + coloured / np.abs(1.0 - keeps * turn) ** 2)
    measured = np.repeat(process[:, None, None], 4, axis=1).reshape(-1, 2, 2).astype(np.complex128)
    measured[:, 0, 0] += 2.0 * first
    measured[:, 1, 1] += noise
    cross = np.stack([process, process], axis=1).astype(np.complex128)
    found = causal_limits(Spectra(f, process, cross, measured), [0.0, 1.0, 3.0])

    F, H = np.diag([a, keeps]), np.array([[1.0, 0.0], [1.0, 1.0]])
    Q, R = np.diag([driven, coloured]), np.diag([first, second])
    ahead = solve_discrete_are(F.T, H.T, Q, R)
    now = ahead - ahead @ H.T @ np.linalg.solve(H @ ahead @ H.T + R, H @ ahead)
    later = F @ (F @ ahead @ F.T + Q) @ F.T + Q
    assert found == pytest.approx([sqrt(now[0, 0]), sqrt(ahead[0, 0]), sqrt(later[0, 0])], rel=1e-6)


def test_the_factor_of_a_moving_average_is_its_own_polynomial_but_for_a_rotation() -> None:
    """Both zeros are inside the circle, so that the polynomial is the causal and invertible factor."""
    f = np.linspace(0.0, 0.5, 513)
    now, before = np.array([[2.0, 0.3], [-0.4, 1.0]]), np.array([[0.5, 0.6], [0.2, -0.5]])
    assert np.max(np.abs(np.linalg.eigvals(np.linalg.solve(now, before)))) < 0.9
    made = now + before * np.exp(-2j * np.pi * f)[:, None, None]
    found = spectral_factor(made @ made.conj().transpose(0, 2, 1))
    rotation = np.linalg.solve(made, found)
    np.testing.assert_allclose(rotation, np.broadcast_to(rotation[0], rotation.shape), atol=1e-7)
    np.testing.assert_allclose(rotation[0] @ rotation[0].conj().T, np.eye(2), atol=1e-7)


def test_what_cannot_be_factored_is_refused() -> None:
    f = np.linspace(0.0, 0.5, 65)
    same = np.ones((65, 2, 2), dtype=np.complex128)
    with pytest.raises(ValueError, match="positive definite"):
        spectral_factor(same)
    for acceleration_psd, angle_psd in ((0.0, 1.0), (1.0, 0.0)):
        with pytest.raises(ValueError, match="must be positive"):
            measured_spectra(f, np.zeros((65, 3, 3), dtype=np.complex128), acceleration_psd, angle_psd)
    with pytest.raises(ValueError, match="uniform"):
        measured_spectra(f + 1.0, np.zeros((65, 3, 3), dtype=np.complex128), 1.0, 1.0)


def test_multiple_coherence_is_what_the_matrix_was_made_with() -> None:
    _, matrix = motion("S6", 0.8)
    share = multiple_coherence(matrix, (PITCH,))
    assert np.nanmax(np.abs(share - 0.8)) < 1e-9
    assert np.isnan(share[0])
