"""The least RMS error that any causal linear estimator can reach, for a known spectrum and sensor noise.

An accuracy figure says little alone: a smooth sea flatters every method. These bounds (Wiener's theory of the
stationary process) are what each table divides by. Spectra are one-sided: variance = integral of S(f) over f > 0.
"""

from __future__ import annotations

from math import log, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.linalg import cho_factor, cho_solve, solve_toeplitz
from scipy.signal import fftconvolve
from scipy.special import ndtr

Array = NDArray[np.float64]


def autocovariance(f_hz: Array, spectrum: Array, lags_s: Array) -> Array:
    """Autocovariance r(lag) = integral of S(f) cos(2 pi f lag) df at each lag.

    ``f_hz`` (n,) is uniform and so fine that 1/df exceeds the longest lag by far; ``spectrum`` (n,) in unit^2/Hz.
    """
    weights = np.asarray(spectrum) * (f_hz[1] - f_hz[0])
    weights[[0, -1]] /= 2  # trapezoid
    chunks = np.array_split(np.asarray(lags_s, dtype=np.float64), max(1, len(lags_s) // 256))
    return np.concatenate([np.cos(2 * np.pi * np.outer(c, f_hz)) @ weights for c in chunks])


def prediction_limit(
    f_hz: Array, spectrum: Array, noise_std: float, rate_hz: float, horizons_s: Array, memory_s: float = 30.0
) -> Array:
    """RMS error of the best linear prediction of the *true* signal from its noisy samples, one per horizon.

    The samples are x(t_k) + white noise of standard deviation ``noise_std``, k = 0, -1, ... over ``memory_s``
    (finite-past Wiener predictor: the Toeplitz normal equations, solved exactly). Against noisy measurements instead
    of the truth the error is sqrt(limit^2 + noise_std^2).

    Raises:
        ValueError: noise_std is not positive (a noiseless band-limited signal is predictable without error).
    """
    if noise_std <= 0.0:
        raise ValueError(f"noise_std must be positive, got {noise_std}")
    count = round(memory_s * rate_hz)
    horizons = np.asarray(horizons_s, dtype=np.float64)
    lags = np.arange(count) / rate_hz
    column = autocovariance(f_hz, spectrum, lags)
    variance = column[0]
    column[0] += noise_std**2
    cross = np.stack([autocovariance(f_hz, spectrum, lags + h) for h in horizons], axis=1)
    taps = solve_toeplitz(column, cross)
    explained = np.sum(cross * taps, axis=0)
    return np.asarray(np.sqrt(np.maximum(variance - explained, 0.0)), dtype=np.float64)


def holed_prediction_limit(
    f_hz: Array, spectrum: Array, noise_std: float, t_s: Array, horizons_s: Array, at_s: Array, memory_s: float = 30.0
) -> Array:
    """RMS error (m, H) of the best linear prediction of the *true* signal at each of m moments and H horizons, from
    noisy samples at the increasing times ``t_s`` (n,) up to that moment, whatever is missing between them.

    The conditional variance of a Gaussian process: its normal equations, solved for the samples of ``memory_s``.

    Raises:
        ValueError: noise_std is not positive.
    """
    if noise_std <= 0.0:
        raise ValueError(f"noise_std must be positive, got {noise_std}")
    horizons = np.asarray(horizons_s, dtype=np.float64)
    fine_s = np.arange(0.0, memory_s + float(horizons.max()) + 0.1, 0.01)
    covariance = CubicSpline(fine_s, autocovariance(f_hz, spectrum, fine_s))
    variance = float(covariance(0.0))
    limits = np.full((len(at_s), len(horizons)), np.sqrt(variance))
    for row, moment in enumerate(np.asarray(at_s).tolist()):
        known = t_s[(t_s > moment - memory_s) & (t_s <= moment + 1e-9)]
        if not known.size:
            continue
        gram = covariance(np.abs(known[:, None] - known)) + noise_std**2 * np.eye(known.size)
        cross = covariance(moment + horizons - known[:, None])
        explained = np.sum(cross * cho_solve(cho_factor(gram), cross), axis=0)
        limits[row] = np.sqrt(np.maximum(variance - explained, 0.0))
    return limits


def causal_heave_limit(f_hz: Array, s_heave: Array, noise_psd: Array | float, delay_s: float = 0.0) -> float:
    """RMS error in metres of the best causal estimate of heave from its noisy vertical acceleration.

    S_y = w^4 S_h + N is factored into its minimum-phase part by the cepstrum; what the causal part of
    -w^2 S_h / conj(S_y^-) explains of the heave is taken from the variance (Wiener-Hopf).

    ``f_hz`` (n,) uniform from 0 to the Nyquist frequency of the grid; ``s_heave`` (n,) m^2/Hz; ``noise_psd`` (n,) or a
    constant, (m/s^2)^2/Hz, both one-sided. ``delay_s``: how long the estimate may wait (0: real time; negative: it is a
    forecast, made so long before). 1 / df has to exceed the delay and the memory of the filter by far.

    Raises:
        ValueError: the grid does not start at 0, is not uniform, or the noise is not positive everywhere.
    """
    f, heave, noise = _checked(f_hz, s_heave, noise_psd)
    _, causal = _factored(f, heave, noise, delay_s)
    residual = 2 * f[1] * (_trapezoid(heave / 2) - _trapezoid(np.abs(causal) ** 2))
    return float(np.sqrt(max(residual, 0.0)))


def causal_heave_filter(f_hz: Array, s_heave: Array, noise_psd: Array | float) -> Array:
    """The filter that reaches :func:`causal_heave_limit`, with its parameters and ``Raises``: weights (m,) of the
    acceleration now, a sample ago, ..., sampled at twice the last frequency.
    """
    f, heave, noise = _checked(f_hz, s_heave, noise_psd)
    factor, causal = _factored(f, heave, noise, 0.0)
    return np.asarray(np.fft.irfft(causal / factor)[: f.size - 1])


def _factored(
    f: Array, heave: Array, noise: Array, delay_s: float
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Minimum-phase factor of the two-sided spectrum of what is measured, and the heave from what it whitens."""
    omega = 2 * np.pi * f
    heave = heave / 2  # two-sided from here on
    measured = omega**4 * heave + noise / 2

    factor = minimum_phase_factor(measured)
    n = 2 * (f.size - 1)

    # The wanted response is shifted by the delay, or ahead by the horizon, before its anticausal half is cut off.
    explained = np.fft.irfft(-(omega**2) * heave / np.conj(factor) * np.exp(-1j * omega * delay_s))
    causal = np.fft.rfft(np.where(np.arange(n) < n // 2, explained, 0.0))
    return factor, causal


def minimum_phase_factor(spectrum: Array) -> NDArray[np.complex128]:
    """The causal and causally invertible response whose squared magnitude is ``spectrum`` (n,), positive and two-sided,
    on a uniform grid from 0 to the Nyquist frequency: by the cepstrum, the half before time 0 folded over.
    """
    cepstrum = np.fft.irfft(np.log(spectrum))
    n = cepstrum.size
    cepstrum[1 : n // 2] *= 2.0
    cepstrum[n // 2 + 1 :] = 0.0
    return np.asarray(np.exp(np.fft.rfft(cepstrum) / 2), dtype=np.complex128)


DRIFT_EVERY_S: Final = 1800.0
"""So often a rate changes, as far as the estimator of :func:`drift_limit` knows: with ten times as often its error is
within a tenth of that."""
DRIFT_SEEN_S: Final = 120.0
"""After that long a change is known to a few per cent."""
DRIFT_BEFORE_S: Final = 60.0
"""And changes are thought of that may have been so long before the true one."""
DRIFT_RECORDS: Final = 300


class DriftLimit(NamedTuple):
    """What one change of the rate at which the bias goes on costs."""

    added_m2s: float
    """Integral of the mean square error that it adds, m2 s."""
    lies_s: float
    """Expected time in which the error is more than 4 of the standard deviations that the estimator itself has."""


def drift_limit(
    f_hz: Array, s_heave: Array, noise_psd: Array | float, rate_mps3: float, lie: float = 4.0, seed: int = 1
) -> DriftLimit:
    """The cost of a change of rate to the best estimator that knows the spectra, that a rate changes now and then (once
    in :data:`DRIFT_EVERY_S`), and by how much in the root of the mean square, but not when, nor by how much this time.

    What the filter of :func:`causal_heave_limit` whitens is white noise and the answer to a ramp that began at some
    second. For each second the posterior of the rate is normal, and its likelihood known; their mixture gives the mean
    and the variance of what the heave is off by, which is taken out of it. The error of the filter itself has nothing
    to do with what it whitens. Averaged over :data:`DRIFT_RECORDS` records of white noise.

    Raises:
        ValueError: as :func:`causal_heave_limit`.
    """
    f, heave, noise = _checked(f_hz, s_heave, noise_psd)
    factor, causal = _factored(f, heave, noise, 0.0)
    base_m2 = causal_heave_limit(f, heave, noise) ** 2
    rate_hz = 2.0 * float(f[-1])
    dt, whole, each = 1.0 / rate_hz, round(DRIFT_SEEN_S * rate_hz), round(rate_hz)
    ramp = dt * np.arange(whole, dtype=np.float64)
    # Of a rate of 1: what is left of it when white noise is of unit variance in a second, and in the heave.
    left = fftconvolve(ramp, np.fft.irfft(1.0 / factor)[:whole])[:whole].reshape(-1, each).mean(axis=1)
    answer = fftconvolve(ramp, np.fft.irfft(causal / factor)[:whole])[:whole].reshape(-1, each)[:, -1]
    before = round(DRIFT_BEFORE_S)
    count = before + len(left)
    rng = np.random.default_rng(seed)
    white = rng.standard_normal((DRIFT_RECORDS, count))
    white[:, before:] += rate_mps3 * left
    energy, added_m2s, lies_s = np.cumsum(left**2), 0.0, 0.0
    for now in range(before, count):
        ages = np.arange(1, min(now + 1, len(left)) + 1)  # seconds since each beginning, this one included
        patterns = np.array([np.pad(left[:age], (now + 1 - age, 0)) for age in ages.tolist()])
        share = rate_mps3**2 / (rate_mps3**2 + 1.0 / energy[ages - 1])
        variance = share / energy[ages - 1]
        mean = white[:, : now + 1] @ patterns.T * variance
        log_odds = 0.5 * mean**2 / variance + 0.5 * np.log1p(-share) - log(DRIFT_EVERY_S)
        most = np.maximum(log_odds.max(axis=1, keepdims=True), 0.0)
        odds = np.exp(log_odds - most)
        weights = odds / (np.exp(-most) + odds.sum(axis=1, keepdims=True))
        off = answer[ages - 1]
        told = (weights * mean * off).sum(axis=1)
        spread = (weights * (mean**2 + variance) * off**2).sum(axis=1) - told**2
        error = rate_mps3 * answer[now - before] - told
        std = np.sqrt(base_m2 + np.maximum(spread, 0.0))
        beyond = ndtr((-lie * std - error) / sqrt(base_m2)) + ndtr((-lie * std + error) / sqrt(base_m2))
        added_m2s += float(np.mean(error**2))
        lies_s += float(np.mean(beyond))
    return DriftLimit(added_m2s, lies_s)


def noncausal_heave_limit(f_hz: Array, s_heave: Array, noise_psd: Array | float) -> float:
    """RMS error in metres of the best estimate from the whole record, past and future (the Wiener smoother):
    its square is the integral of S_h N / (w^4 S_h + N).

    Parameters and ``Raises`` as :func:`causal_heave_limit`, which it is for an endless delay.
    """
    f, heave, noise = _checked(f_hz, s_heave, noise_psd)
    return float(np.sqrt(f[1] * _trapezoid(heave * noise / ((2 * np.pi * f) ** 4 * heave + noise))))


def _checked(f_hz: Array, s_heave: Array, noise_psd: Array | float) -> tuple[Array, Array, Array]:
    """Frequencies, spectrum and noise density on one sound grid; ``Raises`` as :func:`causal_heave_limit`."""
    f = np.asarray(f_hz, dtype=np.float64)
    noise = np.broadcast_to(np.asarray(noise_psd, dtype=np.float64), f.shape)
    if f[0] != 0.0 or not np.allclose(np.diff(f), f[1] - f[0], rtol=1e-6):
        raise ValueError("f_hz must be uniform and start at 0")
    if not np.all(noise > 0.0):
        raise ValueError("noise_psd must be positive at every frequency")
    return f, np.asarray(s_heave, dtype=np.float64), noise


def _trapezoid(values: Array) -> float:
    return float(np.sum(values) - 0.5 * (values[0] + values[-1]))
