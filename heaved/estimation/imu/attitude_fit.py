"""How fast an attitude leans and how late it is, from a record.

The equations are those of :mod:`heaved.estimation.imu.attitude_error`.

The two unknowns stand in this order everywhere: lean k (1/s) and lateness (s). What is said of them is an information
matrix (2, 2), the inverse of a covariance, and that times their mean (2,); what several sources say is added up.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.samples import GRAVITY_MPS2

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

USUAL: Final = (0.15, 0.1)
"""Standard deviations of the two before anything is known, where they are not nothing: most that lean do within 5 to
20 s; solutions take tens of milliseconds, accelerometers with a low-pass of 2 Hz a tenth of a second."""
LOW_PASS_S: Final = 0.02
"""The same of how late accelerometers are against gyroscopes, where their low-passes are not the same."""
ROW_S: Final = 0.25
"""The record is of means over this: waves lose nothing in them, vibration is averaged out."""
HOLE_S: Final = 1.0
"""Longer without a sample the vessel may have done anything; the record is in runs between such holes."""
LINE_S: Final = 20.0
"""How the integral of a shorter run rises is not known: a level bias makes some hundredths of a radian second of it."""
PIECE_S: Final = 128.0
"""Length of the pieces of which spectra are made: 8 mHz, by which waves of 12 s are told from what is below them."""
OVERLAP: Final = 4
"""Pieces begin so many times as often as they are long."""
PIECES: Final = 3
"""Before anything is concluded: of fewer, noise is not known well enough to weigh by it."""
LOWEST: Final = 2
"""First frequency of a piece that is free of its mean: its window has the width of two."""
WAVES_HZ: Final = (0.03, 0.8)
"""Where the peak of the acceleration is looked for, above which nothing is: noise of the angles is in both sides of the
equation there."""
CORRELATED: Final = 3.7
"""Pieces that overlap by three quarters, and neighbouring frequencies under a Hann window, tell by so much less than
independent ones: the sums of the squares of their correlations, 1 + 2 (0.66^2 + 0.17^2) and 1 + 2 (0.67^2 + 0.17^2)."""
ROUNDS: Final = 3
"""The products are not quite linear in the two, and noise is what the last solution leaves."""
TURNS: Final = 80
"""Rows in which gyroscopes say what the two are, at least: two waves or three."""
TURNED_PER_S: Final = 0.003
"""Standard deviation of the k that they show, for what they do not fit otherwise."""


class Belief(msgspec.Struct, frozen=True, eq=False):
    """What is held of the two before the acceleration below the waves is looked at."""

    information: Array
    """(2, 2)"""
    right: Array
    """(2,) that times the mean of what it comes from."""
    null: tuple[float, float] = (0.0, 0.0)
    """What they may as well be, and by which standard deviations they are else off that."""
    spread: tuple[float, float] = USUAL


NOTHING: Final = Belief(np.zeros((2, 2)), np.zeros(2))
"""There are no gyroscopes."""


class Run(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """A stretch of the record without a hole, a row every ROW_S; arrays (n,), rad, of roll and of pitch (n, 2)."""

    number: Array
    made: Array
    """(n, 6) m/s2 up, and what of that is k times, lateness times, k^2, k lateness and lateness^2 times."""
    lean: Array
    """(n, 2) rad s, what k is times: the integral of the apparent vertical against the measured one, less a line."""
    rise: Array
    """(2,) rad, how that line rises: what was taken out."""
    apart: Array
    """(n, 2) the integral with the line."""
    angle: Array
    rate: Array


class Noise(msgspec.Struct, frozen=True, eq=False):
    """Noise of the vertical acceleration that no spectrum of it shows as such."""

    f_hz: Array
    """(n,) evenly spaced,"""
    psd: Array
    """(n,) one-sided, (m/s2)2/Hz."""


def runs(rows: Array) -> list[Run]:
    """The record in runs. ``rows`` (n, 8): number of a row (time over ROW_S) and its means: acceleration up, to port
    and forward in the measured level frame, roll, pitch and their rates.
    """
    ends = np.flatnonzero(np.diff(rows[:, 0]) > HOLE_S / ROW_S) + 1
    return [_run(part) for part in np.split(rows, ends) if len(part) > 1]


def _run(part: Array) -> Run:
    number = np.arange(part[0, 0], part[-1, 0] + 0.5)
    if len(number) > len(part):
        part = np.column_stack([number] + [np.interp(number, part[:, 0], column) for column in part[:, 1:].T])
    up, level, angle, rate = part[:, 1], part[:, 2:4], part[:, 4:6], part[:, 6:8]
    weight = GRAVITY_MPS2 + up
    off = level / weight[:, None]
    apart = np.zeros_like(off)
    np.cumsum(0.5 * ROW_S * (off[1:] + off[:-1]), axis=0, out=apart[1:])
    middle_s, rise = ROW_S * (number - number.mean()), np.zeros(2)
    if len(part) * ROW_S > LINE_S:
        rise = middle_s @ apart / float(middle_s @ middle_s)
    lean = apart - apart.mean(axis=0) - middle_s[:, None] * rise
    made = np.column_stack((
        up,
        np.sum(level * lean, axis=1),
        -np.sum(level * rate, axis=1),
        0.5 * weight * np.sum(lean * lean, axis=1),
        -np.sum(level * (angle + off) + weight[:, None] * lean * rate, axis=1),
        0.5 * weight * np.sum(rate * rate, axis=1),
    ))  # fmt: skip
    return Run(number=number, made=made, lean=lean, rise=rise, apart=apart, angle=angle, rate=rate)


def spectra(record: Sequence[Run], size: int = round(PIECE_S / ROW_S)) -> Complex | None:
    """(pieces, frequencies, 6) of what is made in every piece of ``size`` rows, a frequency for each 1 / (size ROW_S);
    None: there is no run that long.
    """
    window = np.hanning(size + 1)[:-1, None]
    pieces = []
    for run in record:
        for first in range(len(run.made) - size, -1, -max(size // OVERLAP, 1)):
            piece = run.made[first : first + size]
            pieces.append(window * (piece - piece.mean(axis=0)))
    # Waves and all that matters here are below an eighth of the rate of the rows.
    return np.fft.rfft(np.array(pieces), axis=1)[:, : size // 4] if pieces else None


def below_waves(found: Complex, belief: Belief) -> tuple[Array, Array]:
    """What the vertical acceleration below the waves says of the two, from the :func:`spectra`: information, and that
    times its mean. The products are made linear about what it comes to with the ``belief``.
    """
    information, right = np.zeros((2, 2)), np.zeros(2)
    if len(found) < PIECES:
        return information, right
    low, high = (round(f * PIECE_S) for f in WAVES_HZ)
    peak = low + int(np.argmax(np.mean(np.abs(found[:, low:high, 0]) ** 2, axis=0)))
    below, solution = found[:, LOWEST : peak + 1], np.array(belief.null)
    usual = np.diag(np.array(belief.spread) ** -2.0)
    for _ in range(ROUNDS):
        left = below[..., 0] - error(below, solution)
        slopes = sensitivity(below, solution)
        weighed = slopes.conj() * (2.0 / (CORRELATED * _smoothed(np.mean(np.abs(left) ** 2, axis=0))))[:, None]
        information = np.einsum("pfi,pfj->ij", weighed, slopes).real
        right = np.einsum("pfi,pf->i", weighed, left + slopes @ solution).real
        all_right = right + belief.right + usual @ belief.null
        solution = np.linalg.solve(information + belief.information + usual, all_right)
    return information, right


def error(made: Array | Complex, solution: Array) -> Array:
    """What the two have made of the vertical acceleration; ``made`` (..., 6)."""
    k, late_s = solution
    return np.asarray(made[..., 1:] @ (k, late_s, k * k, k * late_s, late_s * late_s))


def sensitivity(made: Complex, solution: Array) -> Complex:
    """(..., 2) of the vertical acceleration to the two; ``made`` (..., 6)."""
    k, late_s = solution
    by_k = made[..., 1] + 2.0 * k * made[..., 3] + late_s * made[..., 4]
    return np.stack((by_k, made[..., 2] + k * made[..., 4] + 2.0 * late_s * made[..., 5]), axis=-1)


def noise(record: Sequence[Run], solution: Array, covariance: Array) -> Noise | None:
    """What the ``covariance`` of the two leaves open in the vertical acceleration, from whatever record there is."""
    size = min(round(PIECE_S / ROW_S), max((len(run.made) for run in record), default=0))
    found = spectra(record, size) if size else None
    if found is None or found.shape[1] < LOWEST + 2:
        return None
    slopes = sensitivity(found[:, LOWEST:], solution)
    power = np.einsum("pfi,ij,pfj->f", slopes.conj(), covariance, slopes).real / len(found)
    # Of a Hann window the mean square is 3/8.
    return Noise(np.arange(LOWEST, found.shape[1]) / (size * ROW_S), 2.0 * ROW_S / (0.375 * size) * power)


def turned(record: Sequence[Run]) -> Belief:
    """What gyroscopes say of the two; the rates of the ``record`` are theirs.

    The angle less what they have made of it is k times the integral, less lateness times the rate: its changes from row
    to row are fitted with the changes of these. Scales and axes of gyroscopes are not those of the angles, so a part of
    both angles, and a bias, are left open. The lateness is that against the gyroscopes: it is the one against the
    accelerometers, too, unless these have another low-pass.
    """
    if sum(len(run.angle) for run in record) < TURNS:
        return NOTHING
    angle, rate, apart = (
        np.concatenate([np.diff(values, axis=0) for values in one])
        for one in zip(*[(run.angle, run.rate, run.apart) for run in record], strict=True)
    )
    twice = np.concatenate([run.rate[1:] + run.rate[:-1] for run in record])
    count = len(angle)
    open_, none = np.column_stack((angle, np.ones(count))), np.zeros((count, 3))
    terms = np.block([
        [apart[:, :1], -rate[:, :1], open_, none],
        [apart[:, 1:], -rate[:, 1:], none, open_],
    ])  # fmt: skip
    left = (angle - 0.5 * ROW_S * twice).T.ravel()
    inverse = np.linalg.pinv(terms.T @ terms, hermitian=True)
    solution = inverse @ (terms.T @ left)
    variance = float(np.mean((left - terms @ solution) ** 2))
    k = 1.0 / (variance * inverse[0, 0] + TURNED_PER_S**2)
    return Belief(
        np.diag([k, 0.0]),
        np.array([k * solution[0], 0.0]),
        null=(0.0, float(solution[1])),
        spread=(USUAL[0], LOW_PASS_S),
    )


def averaged(belief: Belief, information: Array, right: Array) -> tuple[Array, Array]:
    """Mean and covariance of the two from a belief and more information, when either may as well be what it is by the
    belief: the average over the four cases, each weighed by how likely it makes the record (Bayes).
    """
    null = np.array(belief.null)
    information = belief.information + information
    right = belief.right + right - information @ null
    means, covariances, logs = np.zeros((4, 2)), np.zeros((4, 2, 2)), np.zeros(4)
    for i, case in enumerate(([0], [1], [0, 1]), start=1):
        usual, told = np.diag(np.square(belief.spread)[case]), information[np.ix_(case, case)]
        covariances[i][np.ix_(case, case)] = np.linalg.inv(told + np.linalg.inv(usual))
        means[i] = covariances[i] @ right
        logs[i] = 0.5 * right @ means[i] - 0.5 * np.linalg.slogdet(np.eye(len(case)) + usual @ told)[1]
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    mean = weights @ means
    off = means - mean
    covariance = np.einsum("c,cij->ij", weights, covariances + off[:, :, None] * off[:, None, :])
    return null + mean, covariance


def _smoothed(power: Array) -> Array:
    """Geometric mean of each and its neighbours."""
    log = np.log(np.pad(power, 1, mode="edge") + 1e-300)
    return np.asarray(np.exp((log[:-2] + log[1:-1] + log[2:]) / 3.0))
