"""The least RMS error of heave for whoever looks at roll and pitch besides the vertical acceleration.

The limit of :mod:`evidence.limits` binds an estimator that sees one channel. Roll and pitch come of the same waves: as
far as they are coherent with heave they tell what the acceleration hides in its noise. The bound is Wiener's again; the
matrix of spectra of what is measured is factored by Wilson's method (SIAM J. Appl. Math. 23, 1972), after each channel
has been whitened by its own minimum-phase factor, so that what is left to factor is the matrix of coherences.

Spectra are one-sided, variance = integral over f > 0. A cross-spectrum of x and y is that of X times conj(Y), where
X and Y are complex amplitudes of ``exp(+i w t)``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from evidence.limits import minimum_phase_factor

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

HEAVE: Final = 0
ROLL: Final = 1
PITCH: Final = 2
"""Places in a matrix of the spectra of motion."""
_CLOSE: Final = 1e-9
"""So far may the product of the factor with itself be from a matrix with ones on its diagonal."""
_ITERATIONS: Final = 200


class Spectra(NamedTuple):
    """What is wanted and what is measured, on one grid of n frequencies from 0 to half the sampling rate."""

    f_hz: Array
    wanted: Array
    """(n,) of the true heave, m2/Hz."""
    cross: Complex
    """(n, k) of heave and each of the k measured channels."""
    measured: Complex
    """(n, k, k) of the channels, their noise included."""


def measured_spectra(
    f_hz: Array, motion: Complex, acceleration_psd: Array | float, angle_psd: Array | float, angles: Sequence[int] = ()
) -> Spectra:
    """What a sensor shows of a motion: its vertical acceleration, and these of :data:`ROLL` and :data:`PITCH`.

    ``motion`` (n, 3, 3): spectra of true heave, roll and pitch (m, rad). ``acceleration_psd`` (n,) or a constant,
    (m/s2)2/Hz; ``angle_psd`` (n, 2) of roll and of pitch, or one constant for both, rad2/Hz; the noises have nothing to
    do with each other.

    Raises:
        ValueError: the grid does not start at 0 or is not uniform, or a noise is not positive.
    """
    f = np.asarray(f_hz, dtype=np.float64)
    noise = np.broadcast_to(np.asarray(acceleration_psd, dtype=np.float64), f.shape)
    if f[0] != 0.0 or not np.allclose(np.diff(f), f[1], rtol=1e-6):
        raise ValueError("f_hz must be uniform and start at 0")
    of_angles = np.broadcast_to(np.asarray(angle_psd, dtype=np.float64), (f.size, 2))
    if not (np.all(noise > 0.0) and np.all(of_angles > 0.0)):
        raise ValueError("the noise of the acceleration and of the angles must be positive at every frequency")
    seen = [HEAVE, *angles]
    shown = np.ones((f.size, len(seen)))
    shown[:, 0] = -((2.0 * np.pi * f) ** 2)
    measured = motion[:, seen][:, :, seen] * shown[:, :, None] * shown[:, None, :]
    measured[:, 0, 0] += noise
    for place, angle in enumerate(angles, 1):
        measured[:, place, place] += of_angles[:, angle - ROLL]
    return Spectra(f, motion[:, HEAVE, HEAVE].real.copy(), motion[:, HEAVE, seen] * shown, measured)


def causal_limits(spectra: Spectra, horizons_s: Sequence[float] = (0.0,)) -> list[float]:
    """RMS error in metres of the best causal estimate of heave so many seconds ahead, one per horizon (0: now;
    negative: the estimate may wait so long).

    1 / df has to exceed the horizons and the memory of the filter by far.

    Raises:
        ValueError: as :func:`spectral_factor`.
    """
    weights = _weights(spectra.f_hz)
    variance = float(np.sum(weights * spectra.wanted / 2.0))
    limits = []
    for response in _of_innovations(spectra, spectral_factor(spectra.measured / 2.0), horizons_s):
        # By Parseval: what the innovations up to now explain of the heave.
        explained = 2.0 * spectra.f_hz[-1] * float(np.sum(response**2))
        limits.append(float(np.sqrt(max(variance - explained, 0.0))))
    return limits


def causal_filters(spectra: Spectra, horizons_s: Sequence[float] = (0.0,)) -> list[Complex]:
    """The filters (n, k) that reach :func:`causal_limits`, as responses to each channel.

    Raises:
        ValueError: as :func:`spectral_factor`.
    """
    factor = spectral_factor(spectra.measured / 2.0)
    transposed = factor.transpose(0, 2, 1)
    count = 2 * (spectra.f_hz.size - 1)
    filters: list[Complex] = []
    for response in _of_innovations(spectra, factor, horizons_s):
        whitened = np.asarray(np.fft.rfft(response, count, axis=0), dtype=np.complex128)
        filter_ = np.linalg.solve(transposed, whitened[:, :, None])[:, :, 0]
        filters.append(np.asarray(filter_, dtype=np.complex128))
    return filters


def error_of(filter_: Complex, spectra: Spectra, horizon_s: float = 0.0) -> float:
    """RMS error in metres of such a filter where these are the spectra, be they others than it was made for."""
    ahead = np.exp(2j * np.pi * spectra.f_hz * horizon_s)
    told = np.sum(filter_ * np.conj(spectra.cross * ahead[:, None]), axis=1).real
    power = np.sum(np.conj(filter_) * (filter_[:, None, :] @ spectra.measured)[:, 0], axis=1).real
    return float(np.sqrt(np.sum(_weights(spectra.f_hz) * (spectra.wanted - 2.0 * told + power) / 2.0)))


def _weights(f_hz: Array) -> Array:
    """Of each frequency in an integral over those above and below 0."""
    weights = np.full(f_hz.size, 2.0 * f_hz[1])
    weights[[0, -1]] /= 2.0
    return weights


def _of_innovations(spectra: Spectra, factor: Complex, horizons_s: Sequence[float]) -> list[Array]:
    """The responses (n - 1, k), over time from 0 on, that make the best estimate of the white innovations."""
    # cross = response to the innovations times the factor's adjoint; solved for the conjugate of the former.
    whitened = np.linalg.solve(factor, np.conj(spectra.cross / 2.0)[:, :, None])[:, :, 0].conj()
    turns = [np.exp(2j * np.pi * spectra.f_hz * horizon_s)[:, None] for horizon_s in horizons_s]
    return [np.fft.irfft(whitened * turn, axis=0)[: spectra.f_hz.size - 1] for turn in turns]


def spectral_factor(measured: Complex) -> Complex:
    """The causal and causally invertible response G (n, k, k) with G G* = ``measured`` (n, k, k), two-sided, Hermitian
    and positive definite on a uniform grid from 0 to the Nyquist frequency. It is unique but for a rotation.

    Raises:
        ValueError: some matrix is not positive definite, or so nearly singular that the iteration does not end.
    """
    channels = measured.shape[1]
    own = np.stack([minimum_phase_factor(measured[:, k, k].real) for k in range(channels)], axis=1)
    coherence = measured / (own[:, :, None] * own[:, None, :].conj())
    if np.min(np.linalg.eigvalsh(coherence)) <= 0.0:
        raise ValueError("the matrix of spectra is not positive definite at every frequency")
    unit = np.eye(channels)
    factor: Complex = np.tile(unit.astype(np.complex128), (len(coherence), 1, 1))
    for _ in range(_ITERATIONS):
        half = np.linalg.solve(factor, coherence)
        ratio = np.linalg.solve(factor, half.conj().transpose(0, 2, 1))  # factor^-1 coherence factor^-*
        factor = factor @ _causal_half(np.asarray(ratio + unit, dtype=np.complex128))
        if np.max(np.abs(factor @ factor.conj().transpose(0, 2, 1) - coherence)) < _CLOSE:
            return np.asarray(own[:, :, None] * factor, dtype=np.complex128)
    raise ValueError("the channels are so coherent, beside so little noise, that their spectra cannot be factored")


def _causal_half(hermitian: Complex) -> Complex:
    """The causal response whose sum with its adjoint is ``hermitian`` (n, k, k)."""
    response = np.fft.irfft(hermitian, axis=0)
    middle = response.shape[0] // 2
    response[[0, middle]] /= 2.0
    response[middle + 1 :] = 0.0
    return np.asarray(np.fft.rfft(response, axis=0), dtype=np.complex128)


def multiple_coherence(motion: Complex, angles: Sequence[int] = (ROLL, PITCH)) -> Array:
    """Share (n,) of the true heave at each frequency that follows from these angles; nan where there is no motion.

    ``motion`` as in :func:`measured_spectra`.
    """
    heave = motion[:, HEAVE, HEAVE].real
    cross = motion[:, HEAVE, list(angles)]
    among = motion[:, list(angles)][:, :, list(angles)]
    there = (heave > 0.0) & (np.linalg.det(among).real > 0.0)
    share = np.full(heave.shape, np.nan)
    told = np.linalg.solve(among[there], cross[there].conj()[:, :, None])[:, :, 0]
    share[there] = np.sum(cross[there] * told, axis=1).real / heave[there]
    return share
