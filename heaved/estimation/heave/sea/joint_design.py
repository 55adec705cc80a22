"""What roll and pitch tell of the heave beside the vertical acceleration, as weights on their past. Runs beside the
event loop, with the fit of the sea (:mod:`heaved.estimation.heave.sea.refit`).

Heave, roll and pitch are driven by the same waves. Where the accelerometer's noise hides the heave, at the lower end of
the waves, the angles still show it, as far as they are coherent with it
(:mod:`heaved.estimation.heave.sea.joint_learning`). With the spectrum S of the fitted sea, beyond the band where heave
is known as they are at its ends, what they have in common makes the matrix of spectra of what is there live: the
innovations y of the filter of the acceleration (white, and all that is to be known of its past) and both angles. Its
causal factor (Wilson 1972) gives Wiener's filter of the three for the heave of any moment. Less what the filter of the
acceleration makes of y, this is a correction to its heave: weights on the last four minutes of y, roll and pitch. Old
ones are small and smooth, and are weights of means.
"""

from __future__ import annotations

from math import nan, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from heaved.estimation.heave.sea.joint_learning import CHANNELS, Learned, frequencies, learned
from heaved.estimation.heave.sea.joint_learning import TUNING as LEARNING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.estimation.heave.sea.model import SeaModel, SeaSystem, Steady

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """How long the filter is, and what it must be able to bear."""

    least_wander: float = 1e-11
    """rad2 Hz, over the square of the frequency: list and trim may always wander by this, a hundredth of a degree in
    two minutes (a ship under way: 1e-10 to 5e-8). Without it weights do not add up to nothing, and a list of 0.1
    degrees makes half a metre of heave that stays."""
    design_s: float = 1024.0
    """Period of the grid on which the filter is designed: four times its memory (with 512 s, what list and trim may do
    comes round again, and the heave of S6S with a coherence of 0.95 is 1.46 instead of 1.21 times the limit)."""
    fine_s: float = 6.4
    """So new samples have weights of their own;"""
    mean_s: float = 0.5
    """older ones have those of means over this,"""
    filter_s: float = 256.4
    """until here."""
    apart_s: float = 0.4
    """Horizons closer than this to another are interpolated."""
    greatest: float = 1e3
    """A weight that is greater is of an angle that hardly moves (in half precision it would be coarse, too)."""
    least_ratio: float = 0.1
    """Of standard deviations with the angles and without, that anything may be said to have."""
    close: float = 1e-5
    """So far may the product of the factor with itself be from the matrix of coherences."""
    iterations: int = 25


TUNING: Final = Tuning()


class Joint(msgspec.Struct, frozen=True, kw_only=True):
    """Weights on the last innovations and angles: what they add to the heave of the filter of the acceleration."""

    nodes_s: tuple[float, ...]
    """(k,) how long after the last sample, 0 first."""
    ratios: tuple[float, ...]
    """(k,) standard deviation of the heave's error with the angles, over that without, by the model."""
    stds_m: tuple[float, ...]
    """(k,) standard deviations of what is added to the heave, by the model."""
    coherence: float
    """Squared, of heave with both angles together, each frequency weighing as much as its heave."""
    dt_s: float
    group: int
    """Samples in each of the means."""
    offsets_rad: tuple[float, float]
    """List and trim, which are no part of the waves."""
    heading_rad: float
    """For which they are; nan: not known."""
    fine: bytes
    """(2 k, m, 3) weights, float16, of the last m samples, the newest last: heave of each node, then its velocity."""
    coarse: bytes
    """(2 k, l, 3) weights of the means of those before."""


def joint(
    system: SeaSystem,
    steady: Steady,
    a_mps2: Array,
    angles_rad: Array,
    horizons_s: Sequence[float],
    heading_rad: float = nan,
) -> Joint | None:
    """Learn and design. ``a_mps2`` (n,), ``angles_rad`` (n, 2): the past, every ``steady.dt_s``, in which the vessel
    kept to ``heading_rad``; a nan is not known.

    None: there is too little of it, or nothing to be gained.

    Raises:
        LinAlgError: the spectra cannot be factored.
    """
    found = learned(system.model, a_mps2, angles_rad, steady.dt_s)
    return None if found is None else designed(system, steady, found, nodes(horizons_s), heading_rad)


def nodes(horizons_s: Sequence[float]) -> tuple[float, ...]:
    """Moments for which there are weights: now, and those horizons that are not close to another."""
    found = [0.0]
    for horizon_s in sorted(horizons_s):
        if horizon_s - found[-1] >= TUNING.apart_s:
            found.append(horizon_s)
    return tuple(found)


def designed(
    system: SeaSystem, steady: Steady, found: Learned, nodes_s: tuple[float, ...], heading_rad: float = nan
) -> Joint | None:
    """Weights for each of ``nodes_s``; None: nothing is to be gained.

    Raises:
        LinAlgError: the spectra cannot be factored.
    """
    dt = steady.dt_s
    size = next_fast_len(2 * round(0.5 * TUNING.design_s / dt), real=True)
    size += size % 2
    f = frequencies(size, dt)
    w = 2.0 * np.pi * f
    sea, transfer, rest = _on_grid(system.model, found, f)
    white = _whitening(system, steady, size)
    seen = np.column_stack((-(w**2) * white, np.ones_like(f), np.ones_like(f)))
    follows = np.column_stack((np.ones_like(f), transfer))
    motion = sea[:, None, None] * follows[:, :, None] * follows[:, None, :].conj()
    motion[:, 1:, 1:] += sea[:, None, None] * rest
    measured = motion * seen[:, :, None] * seen[:, None, :].conj()
    level = 2.0 * dt * steady.S
    measured[:, 0, 0] = np.maximum(level, measured[:, 0, 0].real * (1.0 + 1e-4))
    for k in range(2):
        measured[:, 1 + k, 1 + k] += found.noise_psd[k]
        measured[:, 1 + k, 1 + k] += found.wander_psd[k] / (1.0 + (f / found.wander_hz) ** 4)
        measured[:, 1 + k, 1 + k] += TUNING.least_wander / np.maximum(f, f[1] / 2.0) ** 2
    cross = motion[:, 0, :] * seen.conj()
    factor = _factor(np.asarray(measured / 2.0, dtype=np.complex128))
    whitened = np.linalg.solve(factor, np.conj(cross / 2.0)[:, :, None])[:, :, 0].conj()
    alone = cross[:, 0] / 2.0 / sqrt(level / 2.0)
    variance = float(np.sum(sea)) * f[1]
    rows, ratios, stds_m = [], [], []
    for tau_s in nodes_s:
        turn = np.exp(1j * w * tau_s)
        for is_velocity in (False, True):
            wanted = turn * 1j * w if is_velocity else turn
            told = np.fft.irfft(whitened * wanted[:, None], size, axis=0)
            told_alone = np.fft.irfft(alone * wanted, size)
            told[size // 2 :], told_alone[size // 2 :] = 0.0, 0.0
            response = np.linalg.solve(factor.transpose(0, 2, 1), np.fft.rfft(told, axis=0)[:, :, None])[:, :, 0]
            weights = np.fft.irfft(response, size, axis=0)
            weights[:, 0] -= told_alone / sqrt(level / 2.0)
            rows.append(weights)
            if not is_velocity:
                by = np.fft.rfft(weights, axis=0)
                added = f[1] * float(np.einsum("fi,fij,fj", by, measured, by.conj()).real)
                alone_left = max(variance - float(np.sum(told_alone**2)) / dt, added)
                ratios.append(sqrt(max(1.0 - added / alone_left, TUNING.least_ratio**2)) if added > 0.0 else 1.0)
                stds_m.append(sqrt(max(added, 0.0)))
    group = max(round(TUNING.mean_s / dt), 1)
    fine = round(TUNING.fine_s / dt)
    coarse = max(round((TUNING.filter_s - TUNING.fine_s) / dt) // group, 1)
    every = np.stack(rows)[:, : fine + group * coarse]
    if not np.max(np.abs(every)) < TUNING.greatest:
        return None
    means = every[:, fine:].reshape(len(rows), coarse, group, CHANNELS).sum(axis=2)
    return Joint(
        nodes_s=nodes_s,
        ratios=tuple(ratios),
        stds_m=tuple(stds_m),
        coherence=found.coherence,
        dt_s=dt,
        group=group,
        offsets_rad=found.offsets_rad,
        heading_rad=heading_rad,
        fine=every[:, :fine][:, ::-1].astype(np.float16).tobytes(),
        coarse=means[:, ::-1].astype(np.float16).tobytes(),
    )


def _on_grid(model: SeaModel, found: Learned, f_hz: Array) -> tuple[Array, Complex, Complex]:
    """Spectrum of heave (n,), transfer (n, 2) and rest (n, 2, 2) at ``f_hz`` (n,), held beyond the ends."""
    is_heave = f_hz >= LEARNING.lowest_hz
    sea = np.zeros(len(f_hz))
    sea[is_heave] = model.wave_spectrum(f_hz[is_heave])
    flat = np.column_stack((found.transfer, found.rest.reshape(-1, 4)))
    parts = [np.interp(f_hz, found.f_hz, one.real) + 1j * np.interp(f_hz, found.f_hz, one.imag) for one in flat.T]
    made = np.stack(parts, axis=1)
    return sea, made[:, :2], made[:, 2:].reshape(-1, 2, 2)


def _whitening(system: SeaSystem, steady: Steady, size: int) -> Complex:
    """(n,) innovation over acceleration of the steady filter: the transform of 1, -H F K, -H F (I - K H) F K, ..."""
    block = 64
    F, K, H = steady.F, steady.K, system.H
    loop = F - np.outer(F @ K, H)
    within = np.empty((len(H), block))
    within[:, 0] = F @ K
    for j in range(1, block):
        within[:, j] = loop @ within[:, j - 1]
    jump, row, found = np.linalg.matrix_power(loop, block), H, [np.ones(1)]
    for _ in range(0, size, block):
        found.append(-row @ within)
        row = row @ jump
    return np.asarray(np.fft.rfft(np.concatenate(found)[:size]), dtype=np.complex128)


def _factor(measured: Complex) -> Complex:
    """The causal and causally invertible G (n, k, k) with G G* = ``measured`` (n, k, k), two-sided (Wilson 1972), each
    channel whitened by its own minimum-phase factor first.

    Raises:
        LinAlgError: it does not exist, or the iteration does not end.
    """
    own = np.stack([_minimum_phase(measured[:, k, k].real) for k in range(measured.shape[1])], axis=1)
    coherence = measured / (own[:, :, None] * own[:, None, :].conj())
    unit = np.eye(measured.shape[1])
    factor = np.tile(unit.astype(np.complex128), (len(coherence), 1, 1))
    for _ in range(TUNING.iterations):
        half = np.linalg.solve(factor, coherence)
        ratio = np.linalg.solve(factor, half.conj().transpose(0, 2, 1))
        response = np.fft.irfft(ratio + unit, axis=0)
        middle = len(response) // 2
        response[[0, middle]] /= 2.0
        response[middle + 1 :] = 0.0
        factor = np.asarray(factor @ np.fft.rfft(response, axis=0), dtype=np.complex128)
        if np.max(np.abs(factor @ factor.conj().transpose(0, 2, 1) - coherence)) < TUNING.close:
            return np.asarray(own[:, :, None] * factor, dtype=np.complex128)
    raise np.linalg.LinAlgError("the spectra of acceleration, roll and pitch cannot be factored")


def _minimum_phase(power: Array) -> Complex:
    """The causal response (n,) with that square and a causal inverse, by its cepstrum."""
    cepstrum = np.fft.irfft(0.5 * np.log(power))
    middle = len(cepstrum) // 2
    cepstrum[1:middle] *= 2.0
    cepstrum[middle + 1 :] = 0.0
    return np.asarray(np.exp(np.fft.rfft(cepstrum)), dtype=np.complex128)
