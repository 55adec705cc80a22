"""What it costs to learn the spectrum of a sea: the limit knows it, an observer has some minutes of one record.

Periodograms of such a record are drawn (independent exponential ordinates: Whittle), the product's family of models is
fitted to each as the product fits it, and the filter that is best for what was found meets the true spectra. Of an
endless record what is left is what no member of the family can follow.
"""

from __future__ import annotations

from math import inf, isfinite, sqrt
from typing import TYPE_CHECKING, Final

import numpy as np

from evidence.channel_limits import HEAVE, Spectra, causal_filters, error_of, measured_spectra
from heaved.estimation.heave.params import SeaParams
from heaved.estimation.heave.sea import whittle_fit
from heaved.estimation.heave.sea.noise import Above

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

DRAWS: Final = 8
ENDLESS_GRID_S: Final = 600.0
"""Ordinates of the spectrum of an endless record, as far apart as in a record of that length."""
_LOWEST_HZ: Final = 1e-4


def learned_heave_limit(
    f_hz: Array, s_heave: Array, noise_psd: Array, seconds: float, draws: int = DRAWS, seed: int = 1
) -> float:
    """RMS error in metres of the causal filter for a spectrum of heave that was learned of a record of ``seconds``
    (inf: of one without end) of its noisy acceleration; the noise is known. Over ``draws`` records.

    Spectra as for :func:`evidence.limits.causal_heave_limit`.
    """
    rng = np.random.default_rng(seed)
    length_s = seconds if isfinite(seconds) else ENDLESS_GRID_S
    low_hz, high_hz = whittle_fit.TUNING.band_hz
    ordinates = np.arange(1, int(f_hz[-1] * length_s)) / length_s
    inside = (ordinates > low_hz) & (ordinates < high_hz)
    f = ordinates[inside]
    power = np.interp(f, f_hz, (2.0 * np.pi * f_hz) ** 4 * s_heave + noise_psd)
    drawn = [power] if seconds == inf else [power * rng.exponential(size=f.size) for _ in range(draws)]
    # White and a walk of the bias: what the fit takes to be known.
    white = float(np.min(noise_psd))
    walk = max(float(np.interp(low_hz, f_hz, noise_psd)) - white, 0.0) * (2.0 * np.pi * low_hz) ** 2 / 2.0
    above = Above(ordinates[-10:], np.ones(10), np.ones(10), 1.0, 0.5 / float(f_hz[-1]))
    params = SeaParams()
    squares, truth = [], _alone(f_hz, s_heave, noise_psd)
    for periodogram in drawn:
        sp = whittle_fit.Spectrum(f, periodogram, white, above, is_noise_known=True)
        model = whittle_fit.fit([sp], params.stages, params.components, walk)[0].model
        found = model.wave_spectrum(np.maximum(f_hz, _LOWEST_HZ))
        (filter_,) = causal_filters(_alone(f_hz, found, noise_psd))
        squares.append(error_of(filter_, truth) ** 2)
    return sqrt(float(np.mean(squares)))


def _alone(f_hz: Array, s_heave: Array, noise_psd: Array) -> Spectra:
    """Who sees the vertical acceleration and nothing else."""
    motion = np.zeros((f_hz.size, 3, 3), dtype=np.complex128)
    motion[:, HEAVE, HEAVE] = s_heave
    return measured_spectra(f_hz, motion, noise_psd, 1.0)
