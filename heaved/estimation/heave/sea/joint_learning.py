"""What roll and pitch have in common with the heave, learned of the recent past.

Of the heave in hindsight (which knows the future of the acceleration, but not the angles) and the measured angles,
pieces of a minute of the past give, with what is older counting less,

    T = S_angle,heave / S_heave       and the rest of the angles      R = S_angles / S_heave - T T*,

both less what so few pieces show by chance. Coherence is measured, never assumed. What lies on both sides of a hole is
looked at, and no piece goes over one.

Spectra are one-sided; the one of x and y is that of X conj(Y), for amplitudes of exp(+i w t).
"""

from __future__ import annotations

import itertools
from math import inf, nan, radians, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.estimation.heave.sea.model import SeaModel

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

CHANNELS: Final = 3
"""Innovations of the acceleration, roll, pitch."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What is looked at, and how much of it is believed."""

    learned_s: float = 600.0
    """Most of the past that is looked at,"""
    least_s: float = 120.0
    """and least that may be used: what is known is looked at in pieces, on both sides of a hole;"""
    memory_s: float = 400.0
    """what is older counts less: the vessel turns, the sea changes."""
    piece_s: float = 80.0
    """Of the spectra: the resolution, 1/80 Hz, is that of a hull's own resonance."""
    edge_s: float = 15.0
    """At the ends of what is known of the acceleration heave is not known in hindsight."""
    fade_s: float = 10.0
    """There the acceleration is faded out."""
    in_band: float = 3e-3
    """Where the sea has less than this of its largest density, what roll and pitch make of it is not looked at,"""
    above_noise: float = 3.0
    """nor where its acceleration is less than that of the noise times this."""
    lowest_hz: float = 0.01
    """Nothing below is heave: what the angles do there is trim and list."""
    below_waves: float = 3e-4
    """Where the sea has less than that, below its peak, the angles show how list and trim wander."""
    clear_of_waves: float = 0.8
    """So far below, as a share of that frequency."""
    noise_band_hz: tuple[float, float] = (1.5, 6.0)
    """Where they show their noise."""
    never_known: float = 0.01
    """This share of each angle is never taken to follow from the heave."""
    doubt: float = 1.0
    """Times that the square of the transfer function is less than what shows, by what few pieces show by chance."""
    least_noise_rad: float = 5e-5
    """That they have at least, rounded and smoothed as they may be: standard deviation of a sample at 20 Hz."""
    turned_rad: float = radians(20.0)
    """What was measured before the vessel turned by more than that is of other waves,"""
    heading_s: float = 20.0
    """from how it has headed on average for so long."""
    hole: float = 5.5
    """Angles further apart than this many samples are not interpolated."""
    long_hole_s: float = 3.0
    """No piece goes over a longer one in them,"""
    known: float = 0.9
    """and of each piece both must be known for that share."""
    answer_s: float = 1024.0
    """Longest that the filter of hindsight may look ahead and back."""


TUNING: Final = Tuning()


class Learned(msgspec.Struct, frozen=True, eq=False):
    """What the angles have in common with the heave, at ``f_hz`` (n,)."""

    f_hz: Array
    transfer: Complex
    """(n, 2) roll and pitch over heave, rad/m."""
    rest: Complex
    """(n, 2, 2) spectra of what does not follow from the heave, over that of heave, rad2/m2."""
    noise_psd: tuple[float, float]
    """Of their white noise, rad2/Hz,"""
    wander_psd: tuple[float, float]
    """and of what they do besides below the waves,"""
    wander_hz: float
    """up to about here."""
    offsets_rad: tuple[float, float]
    coherence: float


def heading(t_s: Array, yaw_rad: Array) -> tuple[float, float]:
    """How the vessel heads at the end of ``t_s`` (n,), nan where that is not known, and since when about so."""
    newest = yaw_rad[t_s > t_s[-1] - TUNING.heading_s] if len(t_s) else yaw_rad
    newest = newest[np.isfinite(newest)]
    if not len(newest):
        return nan, -inf
    now = np.exp(1j * newest).sum()
    turned = np.abs(np.angle(np.exp(1j * yaw_rad) * np.conj(now)))
    elsewhere = np.flatnonzero(turned > TUNING.turned_rad)  # What is not known has not turned.
    return float(np.angle(now)), float(t_s[elsewhere[-1]]) if len(elsewhere) else -inf


def even_angles(rows: Array, end_s: float, dt_s: float, count: int) -> Array:
    """(count, 2) roll and pitch every ``dt_s`` up to ``end_s``, of ``rows`` (n, 3) with their times first; nan where
    they are not known.
    """
    known = rows[np.isfinite(rows).all(axis=1)]
    if len(known) < 2:
        return np.full((count, 2), np.nan)
    t_s = end_s - dt_s * np.arange(count - 1, -1, -1.0)
    after = np.clip(np.searchsorted(known[:, 0], t_s), 1, len(known) - 1)
    is_near = known[after, 0] - known[after - 1, 0] < TUNING.hole * dt_s
    is_near &= (t_s > known[0, 0] - dt_s) & (t_s < known[-1, 0] + dt_s)
    return np.column_stack([np.where(is_near, np.interp(t_s, known[:, 0], known[:, k]), np.nan) for k in (1, 2)])


def learned(model: SeaModel, a_mps2: Array, angles_rad: Array, dt_s: float) -> Learned | None:
    """Of the past, evenly sampled: ``a_mps2`` (n,) and ``angles_rad`` (n, 2), nan where they are not known.

    None: too little of it is known, or the sea is hidden in noise.
    """
    count = min(len(a_mps2), round(TUNING.learned_s / dt_s))
    piece = round(TUNING.piece_s / dt_s)
    is_measured: NDArray[np.bool_] = np.all(np.isfinite(angles_rad[-count:]), axis=1)
    angles = _filled(angles_rad[-count:], is_measured, round(TUNING.long_hole_s / dt_s))
    heave = _heave(model, a_mps2[-count:], dt_s)
    series = np.column_stack((heave, angles))
    ends = _pieces(series, is_measured, piece)
    if piece < CHANNELS or _covered(ends, piece) * dt_s < TUNING.least_s:
        return None
    stretches = runs(np.isfinite(angles[:, 0]))
    first, end = stretches[-1]
    # Trim and list may be others since a hole.
    since = first if (end - first) * dt_s >= TUNING.least_s else 0
    offsets = _mean(angles[since:])
    f_hz, spectra, pieces = _spectra(series, ends, piece, dt_s)
    sea = model.wave_spectrum(np.maximum(f_hz, 1e-6))
    w4 = (2.0 * np.pi * f_hz) ** 4
    in_band = (f_hz >= 1.5 / TUNING.piece_s) & (sea > TUNING.in_band * np.max(sea[1:]))
    in_band &= w4 * sea > TUNING.above_noise * model.noise_psd
    if np.count_nonzero(in_band) < CHANNELS:
        return None
    at = spectra[in_band]
    own = at[:, 0, 0].real
    transfer = at[:, 1:, 0] / own[:, None]
    rest = at[:, 1:, 1:] / own[:, None, None] - transfer[:, :, None] * transfer[:, None, :].conj()
    # Few pieces show a coherence even of what has nothing in common: 1 / pieces of the rest.
    rest = rest * (pieces / (pieces - 1.0))
    for k in range(2):
        rest[:, k, k] += TUNING.never_known * at[:, 1 + k, 1 + k].real / own
        by_chance = TUNING.doubt * rest[:, k, k].real / pieces
        transfer[:, k] *= np.maximum(1.0 - by_chance / np.maximum(np.abs(transfer[:, k]) ** 2, 1e-30), 0.0)
    noisy = (f_hz > TUNING.noise_band_hz[0]) & (f_hz < TUNING.noise_band_hz[1])
    least = 2.0 * 0.05 * TUNING.least_noise_rad**2
    floor = [max(float(np.median(spectra[noisy, k, k].real)) if noisy.any() else 0.0, least) for k in (1, 2)]
    share, wander_hz = _coherence(transfer, rest), lower_end_hz(model)
    first, end = max(stretches, key=lambda run: run[1] - run[0])
    wander = _wander(angles[first:end] - offsets, dt_s, wander_hz)
    return Learned(
        f_hz=f_hz[in_band],
        transfer=transfer,
        rest=rest,
        noise_psd=(floor[0], floor[1]),
        wander_psd=(max(wander[0] - floor[0], 0.0), max(wander[1] - floor[1], 0.0)),
        wander_hz=wander_hz,
        offsets_rad=(float(offsets[0]), float(offsets[1])),
        coherence=float(share @ own / np.sum(own)),
    )


def lower_end_hz(model: SeaModel) -> float:
    """Where the waves begin."""
    f_hz = np.arange(TUNING.lowest_hz, max(model.frequency_hz) + 1e-3, 1e-3)
    sea = model.wave_spectrum(f_hz)
    return float(f_hz[np.argmax(sea > TUNING.below_waves * np.max(sea))])


def _mean(angles_rad: Array) -> Array:
    """(2,) of angles (n, 2) that are nan where they are not known: smooth, so that no wave is in it."""
    smooth = np.where(np.isfinite(angles_rad), np.hanning(len(angles_rad) + 2)[1:-1, None], 0.0)
    return np.asarray(np.sum(smooth * np.nan_to_num(angles_rad), axis=0) / np.sum(smooth, axis=0))


def _wander(angles_rad: Array, dt_s: float, below_hz: float) -> tuple[float, float]:
    """Mean spectra (rad2/Hz) below the waves of angles (n, 2)."""
    window = np.hanning(len(angles_rad) + 2)[1:-1]
    transforms = np.fft.rfft(angles_rad * window[:, None], axis=0)
    # The first three are the mean itself, as the window has it.
    first, end = 3, int(TUNING.clear_of_waves * below_hz * len(angles_rad) * dt_s)
    if end <= first:
        return 0.0, 0.0
    psd = 2.0 * dt_s * np.mean(np.abs(transforms[first:end]) ** 2, axis=0) / float(window @ window)
    return float(psd[0]), float(psd[1])


def _coherence(transfer: Complex, rest: Complex) -> Array:
    """(n,) share of the heave that follows from both angles: c / (1 + c), c = T* R^-1 T."""
    small = 1e-9 * (np.trace(rest, axis1=1, axis2=2).real + 1e-30)
    told = np.linalg.solve(rest + small[:, None, None] * np.eye(2), transfer[:, :, None])[:, :, 0]
    c = np.maximum(np.sum(transfer.conj() * told, axis=1).real, 0.0)
    return np.asarray(c / (1.0 + c))


def runs(is_known: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and end of each stretch that is known, of (n,), oldest first."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], is_known, [False]))))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _filled(angles_rad: Array, is_measured: NDArray[np.bool_], longest: int) -> Array:
    """Angles (n, 2) with straight lines over holes of up to ``longest`` samples; nan in others and at the ends."""
    found = np.where(is_measured[:, None], angles_rad, np.nan)
    places = np.flatnonzero(is_measured)
    for first, end in runs(~is_measured):
        if first > 0 and end < len(found) and end - first <= longest:
            for k in range(2):
                found[first:end, k] = np.interp(np.arange(first, end), places, angles_rad[places, k])
    return found


def _heave(model: SeaModel, a_mps2: Array, dt_s: float) -> Array:
    """(n,) heave in hindsight; nan where the acceleration (n,) around is not known."""
    found = np.full(len(a_mps2), np.nan)
    edge = round(TUNING.edge_s / dt_s)
    is_known: NDArray[np.bool_] = np.isfinite(a_mps2)
    for first, end in runs(is_known):
        if end - first > 2 * edge:
            found[first + edge : end - edge] = in_hindsight(model, a_mps2[first:end], dt_s)[edge:-edge]
    return found


def _pieces(series: Array, is_measured: NDArray[np.bool_], piece: int) -> list[int]:
    """Ends of the pieces of ``series`` (n, k) that are known, the newest first, each a quarter on from the one before;
    ``is_measured`` (n,): where the angles are not drawn.
    """
    step = max(piece // 4, 1)
    is_known: NDArray[np.bool_] = np.all(np.isfinite(series), axis=1)
    ends = [end for first, last in reversed(runs(is_known)) for end in range(last, first + piece - 1, -step)]
    return [end for end in ends if np.mean(is_measured[end - piece : end]) >= TUNING.known]


def _covered(ends: Sequence[int], piece: int) -> int:
    """Samples that are in any of the pieces, the newest first."""
    return sum(min(piece, newer - end) for newer, end in itertools.pairwise(ends)) + piece if ends else 0


def in_hindsight(model: SeaModel, a_mps2: Array, dt_s: float) -> Array:
    """(n,) heave that the whole record of the acceleration (n,) shows: Wiener's filter that waits for ever. Not to be
    used near its ends.
    """
    count, fade = len(a_mps2), round(TUNING.fade_s / dt_s)
    faded = a_mps2 - np.mean(a_mps2)
    edge = np.sin(np.linspace(0.0, np.pi / 2.0, fade)) ** 2
    faded[:fade] *= edge
    faded[-fade:] *= edge[::-1]
    size = next_fast_len(count + round(TUNING.answer_s / dt_s), real=True)
    f_hz = frequencies(size, dt_s)
    is_heave = f_hz >= TUNING.lowest_hz
    f = f_hz[is_heave]
    w2 = (2.0 * np.pi * f) ** 2
    response = np.zeros(len(f_hz))
    response[is_heave] = -w2 * model.wave_spectrum(f) / model.acceleration_spectrum(f, dt_s)
    return np.asarray(np.fft.irfft(np.fft.rfft(faded, size) * response, size)[:count])


def _spectra(series: Array, ends: Sequence[int], piece: int, dt_s: float) -> tuple[Array, Complex, float]:
    """Frequencies (n,), spectra (n, k, k) of the pieces of ``series`` (m, k) that end there, the newest first, and of
    how many these are.
    """
    window = np.hanning(piece + 2)[1:-1]
    window /= sqrt(float(window @ window))
    parts = [series[end - piece : end] for end in ends]
    transforms = np.fft.rfft(np.stack([(part - part.mean(axis=0)) * window[:, None] for part in parts]), axis=1)
    weights = np.exp((np.array(ends) - ends[0]) * dt_s / TUNING.memory_s)
    weights /= np.sum(weights)
    spectra = 2.0 * dt_s * np.einsum("p,pfi,pfj->fij", weights, transforms, transforms.conj())
    # Three quarters of each piece are the next one's too.
    pieces = max(0.5 / float(weights @ weights), 1.5)
    return frequencies(piece, dt_s), spectra, pieces


def frequencies(size: int, dt_s: float) -> Array:
    """(n,) of the transform of so many samples, Hz."""
    return np.asarray(np.fft.rfftfreq(size, dt_s), dtype=np.float64)
