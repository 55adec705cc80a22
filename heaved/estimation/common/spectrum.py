"""Spectra of the recent past: the dominant frequencies of the motion and the spectrum of the heave."""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """How records are looked at."""

    grid_hz: float = 10.0
    """Rate to which they are brought; waves end an order of magnitude below its Nyquist frequency."""
    fewest: int = 8
    """Of a shorter record, in points of that grid, nothing is said."""
    silence_mps2: float = 1e-9
    """Less than this is the rounding of a constant, not motion: no lead or gain may be fitted to it."""
    padding: int = 4
    """Zero padding: points within each bin of the window, which the parabola through a peak then refines."""


TUNING: Final = Tuning()


def resample(t_s: Array, values: Array) -> Array:
    """Values (n,) at irregular, increasing times (n,), brought to an even grid by linear interpolation."""
    grid = np.arange(t_s[0], t_s[-1], 1.0 / TUNING.grid_hz)
    return np.interp(grid, t_s, values)


def dominant_frequencies(
    t_s: Array, a_mps2: Array, count: int, band_hz: tuple[float, float], highpass_hz: float
) -> Array:
    """Frequencies (Hz) of the ``count`` largest peaks of the heave, ascending; fewer where the record shows fewer.

    t_s, a_mps2 (n,): vertical acceleration over the window (Zhang et al. 2022, section 3.2: 30 s). The peaks are those
    of the acceleration times the integrator's own |1 / (s^2 + sqrt(2) w s + w^2)|, w = 2 pi highpass_hz: the integrated
    displacement itself would show its start for half a minute, and a plain 1 / omega^2 would find the skirt of the
    window at the lower end of the band. The division tilts each line, so that its top lies low by half a bin or so; a
    peak is therefore placed at the top of the acceleration's own line, by the parabola through its logarithm, at most
    half a bin away: for a pure tone under the Hann window within 5 % of a bin when the window holds 3.5 periods of it,
    20 % when it holds less than two. Peaks closer to each other than the resolution of the window (1 / its length) are
    one.
    """
    x = _detrended(resample(t_s, a_mps2))
    n = len(x)
    if n < TUNING.fewest or not x.any():
        return np.empty(0)
    f = np.fft.rfftfreq(TUNING.padding * n, 1.0 / TUNING.grid_hz)
    line = np.abs(np.fft.rfft(x * np.hanning(n), TUNING.padding * n))
    amplitude = line / np.sqrt(f**4 + highpass_hz**4)
    inner = amplitude[1:-1]
    peaks = 1 + np.flatnonzero((inner > amplitude[:-2]) & (inner >= amplitude[2:]) & (f[1:-1] > band_hz[0]))
    peaks = peaks[f[peaks] < band_hz[1]]
    found: list[float] = []
    for k in peaks[np.argsort(-amplitude[peaks], kind="stable")]:
        left, top, right = np.log(line[k - 1 : k + 2] + 1e-300)
        curvature = left - 2.0 * top + right
        away = 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0
        at = f[k] + f[1] * min(max(away, -0.5 * TUNING.padding), 0.5 * TUNING.padding)
        if all(abs(at - other) > TUNING.grid_hz / n for other in found):
            found.append(min(max(float(at), band_hz[0]), band_hz[1]))
        if len(found) == count:
            break
    return np.sort(np.array(found))


def heave_spectrum(t_s: Array, a_mps2: Array, band_hz: tuple[float, float], segment_s: float) -> tuple[Array, Array]:
    """One-sided heave spectrum (m2/Hz) over the wave band from vertical acceleration (m/s2): S_a / omega^4.

    Welch's average of Hann segments with half overlap. Returns frequencies (k,) in Hz and the spectrum (k,); the noise
    of the accelerometer is part of it, so it is an upper estimate where the sea is silent.
    """
    x = _detrended(resample(t_s, a_mps2))
    n = min(len(x), int(segment_s * TUNING.grid_hz))
    if n < TUNING.fewest:
        return np.empty(0), np.empty(0)
    window = np.hanning(n)
    starts = range(0, len(x) - n + 1, max(1, n // 2))
    segments = np.stack([_detrended(x[s : s + n]) for s in starts]) * window
    power = np.mean(np.abs(np.fft.rfft(segments)) ** 2, axis=0) * 2.0 / (TUNING.grid_hz * np.sum(window**2))
    grid_hz = np.fft.rfftfreq(n, 1.0 / TUNING.grid_hz)
    inside = (grid_hz >= band_hz[0]) & (grid_hz <= band_hz[1])
    f: Array = grid_hz[inside].astype(np.float64)
    return f, power[inside] / (2.0 * np.pi * f) ** 4


def _detrended(x: Array) -> Array:
    """x (n,) less its straight line; all zero where only the rounding of that line is left."""
    n = len(x)
    if n < 3:
        return x - np.mean(x) if n else x
    ramp = np.arange(n) - (n - 1) / 2.0
    rest = x - np.mean(x) - ramp * (ramp.dot(x) / ramp.dot(ramp))
    return np.zeros(n) if float(np.max(np.abs(rest))) < TUNING.silence_mps2 else np.asarray(rest)
