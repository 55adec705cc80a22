"""How fast an attitude leans and how late it is, from a record.

The equations are those of :mod:`heaved.estimation.imu.attitude_error`.

The two unknowns stand in this order everywhere: lean k (1/s) and lateness (s). What is said of them is an information
matrix (2, 2), the inverse of a covariance, and that times their mean (2,); what several sources say is added up.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.samples import GRAVITY_MPS2

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

NUMBER, UP, LEVEL, ANGLE, RATE, MEANS = 0, 1, slice(2, 4), slice(4, 6), slice(6, 8), 8
"""Columns of a record: number of a row (its time over that between rows), and its means: acceleration up, to port and
forward in the measured level frame, roll, pitch and their rates; and how many that are."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What is held of attitude sensors, and how the record is made and looked at."""

    usual: tuple[float, float] = (0.15, 0.1)
    """Standard deviations of the two (1/s, s) before anything is known, where they are not nothing: most that lean do
    within 5 to 20 s; solutions take tens of milliseconds, accelerometers with a low-pass of 2 Hz a tenth
    of a second."""
    low_pass_s: float = 0.02
    """The same of how late accelerometers are against gyroscopes, where their low-passes are not the same."""
    record_s: float = 600.0
    """What an attitude sensor does in other seas, where it weighs its accelerometers otherwise, is forgotten."""
    every_s: float = 10.0
    """Time between two looks."""
    first_s: float = 20.0
    """Record before the first."""
    row_s: float = 0.25
    """The record is of means over this: waves lose nothing in them, vibration is averaged out. (Not of the down-sampler
    of the heave, whose means lie where the samples do, and overlap: ten columns of a row are of one moment here, and
    rows lie on one even grid, across holes too, for spectra are taken of them.)"""
    hole_s: float = 1.0
    """Longer without a sample the vessel may have done anything; the record is in runs between such holes."""
    line_s: float = 20.0
    """How the integral of a shorter run rises is not known: a level bias makes some hundredths of a radian second."""
    piece_s: float = 128.0
    """Length of the pieces of which spectra are made: 8 mHz, by which waves of 12 s are told from what is below."""
    overlap: int = 4
    """Pieces begin so many times as often as they are long."""
    pieces: int = 3
    """Before anything is concluded: of fewer, noise is not known well enough to weigh by it."""
    lowest: int = 2
    """First frequency of a piece that is free of its mean: its window has the width of two."""
    waves_hz: tuple[float, float] = (0.03, 0.8)
    """Where the peak of the acceleration is looked for, above which nothing is: noise of the angles is in both sides of
    the equation there."""
    correlated: float = 3.7
    """Pieces that overlap by three quarters, and neighbouring frequencies under a Hann window, tell by so much less
    than independent ones: the sums of the squares of their correlations, 1 + 2 (0.66^2 + 0.17^2) and
    1 + 2 (0.67^2 + 0.17^2)."""
    rounds: int = 3
    """The products are not quite linear in the two, and noise is what the last solution leaves."""
    turns: int = 80
    """Rows in which gyroscopes say what the two are, at least: two waves or three."""
    turned_per_s: float = 0.003
    """Standard deviation of the k that they show, for what they do not fit otherwise."""


TUNING: Final = Tuning()


class Belief(msgspec.Struct, frozen=True, eq=False):
    """What is held of the two before the acceleration below the waves is looked at."""

    information: Array
    """(2, 2)"""
    right: Array
    """(2,) that times the mean of what it comes from."""
    null: tuple[float, float] = (0.0, 0.0)
    """What they may as well be, and by which standard deviations they are else off that."""
    spread: tuple[float, float] = TUNING.usual


NOTHING: Final = Belief(np.zeros((2, 2)), np.zeros(2))
"""There are no gyroscopes."""


def told(late_s: float) -> Belief:
    """There are none, and somebody has measured the lateness: it is that, or off it as by another low-pass."""
    if late_s == 0.0:
        return NOTHING
    return Belief(NOTHING.information, NOTHING.right, (0.0, late_s), (TUNING.usual[0], TUNING.low_pass_s))


class Run(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """A stretch of the record without a hole, evenly spaced; arrays (n,), rad, of roll and of pitch (n, 2)."""

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


class Unsized(msgspec.Struct, frozen=True, eq=False):
    """What lean and lateness that are not known make of the vertical acceleration: known in shape, not in size."""

    t_s: float
    """The middle of a row."""
    by_lean: float
    """m/s2 for each unit of k,"""
    by_lateness: float
    """and of lateness, at their present values."""
    covariance: Array
    """(2, 2) of the two."""


def runs(rows: Array) -> list[Run]:
    """The record, rows (n, MEANS) of columns as named above and any more, in runs."""
    ends = np.flatnonzero(np.diff(rows[:, NUMBER]) > TUNING.hole_s / TUNING.row_s) + 1
    return [_run(part) for part in np.split(rows[:, :MEANS], ends) if len(part) > 1]


def _run(part: Array) -> Run:
    number = np.arange(part[0, NUMBER], part[-1, NUMBER] + 0.5)
    if len(number) > len(part):
        part = np.column_stack([number] + [np.interp(number, part[:, NUMBER], column) for column in part[:, UP:].T])
    up, level, angle, rate = part[:, UP], part[:, LEVEL], part[:, ANGLE], part[:, RATE]
    weight = GRAVITY_MPS2 + up
    off = level / weight[:, None]
    apart = np.zeros_like(off)
    np.cumsum(0.5 * TUNING.row_s * (off[1:] + off[:-1]), axis=0, out=apart[1:])
    middle_s, rise = TUNING.row_s * (number - number.mean()), np.zeros(2)
    if len(part) * TUNING.row_s > TUNING.line_s:
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


def spectra(record: Sequence[Run], size: int = round(TUNING.piece_s / TUNING.row_s)) -> Complex | None:
    """(pieces, frequencies, 6) of what is made in every piece of ``size`` rows, a frequency for each of their
    length; None: there is no run that long.
    """
    window = np.hanning(size + 1)[:-1, None]
    pieces = []
    for run in record:
        for first in range(len(run.made) - size, -1, -max(size // TUNING.overlap, 1)):
            piece = run.made[first : first + size]
            pieces.append(window * (piece - piece.mean(axis=0)))
    # Waves and all that matters here are below an eighth of the rate of the rows.
    return np.fft.rfft(np.array(pieces), axis=1)[:, : size // 4] if pieces else None


def below_waves(found: Complex, belief: Belief) -> tuple[Array, Array]:
    """What the vertical acceleration below the waves says of the two, from the :func:`spectra`: information, and that
    times its mean. The products are made linear about what it comes to with the ``belief``.
    """
    information, right = np.zeros((2, 2)), np.zeros(2)
    if len(found) < TUNING.pieces:
        return information, right
    low, high = (round(f * TUNING.piece_s) for f in TUNING.waves_hz)
    peak = low + int(np.argmax(np.mean(np.abs(found[:, low:high, 0]) ** 2, axis=0)))
    below, solution = found[:, TUNING.lowest : peak + 1], np.array(belief.null)
    usual = np.diag(np.array(belief.spread) ** -2.0)
    for _ in range(TUNING.rounds):
        left = below[..., 0] - error(below, solution)
        slopes = sensitivity(below, solution)
        weighed = slopes.conj() * (2.0 / (TUNING.correlated * _smoothed(np.mean(np.abs(left) ** 2, axis=0))))[:, None]
        information = np.einsum("pfi,pfj->ij", weighed, slopes).real
        right = np.einsum("pfi,pf->i", weighed, left + slopes @ solution).real
        all_right = right + belief.right + usual @ belief.null
        solution = np.linalg.solve(information + belief.information + usual, all_right)
    return information, right


def error(made: Array | Complex, solution: Array) -> Array:
    """What the two have made of the vertical acceleration; ``made`` (..., 6)."""
    k, late_s = solution
    return np.asarray(made[..., 1:] @ (k, late_s, k * k, k * late_s, late_s * late_s))


def unsized(row: Array, solution: tuple[float, float], covariance: Array) -> Unsized:
    """Of one row of the record, the integrals of the lean as it has them (columns after the others, of roll first)."""
    number, up, left, ahead, roll, pitch, roll_rate, pitch_rate, across, along = row[: MEANS + 2].tolist()
    k, late_s = solution
    weight = GRAVITY_MPS2 + up
    roll_off, pitch_off = k * across - late_s * roll_rate, k * along - late_s * pitch_rate
    turned_roll, turned_pitch = roll + left / weight, pitch + ahead / weight
    by_lean = (
        (left + weight * roll_off) * (across - late_s * turned_roll)
        + (ahead + weight * pitch_off) * (along - late_s * turned_pitch)
    )  # fmt: skip
    by_lateness = (
        -(left + weight * roll_off) * (roll_rate + k * turned_roll)
        - (ahead + weight * pitch_off) * (pitch_rate + k * turned_pitch)
    )  # fmt: skip
    return Unsized(TUNING.row_s * (number + 0.5), by_lean, by_lateness, covariance)


def sensitivity(made: Complex, solution: Array) -> Complex:
    """(..., 2) of the vertical acceleration to the two; ``made`` (..., 6)."""
    k, late_s = solution
    by_k = made[..., 1] + 2.0 * k * made[..., 3] + late_s * made[..., 4]
    return np.stack((by_k, made[..., 2] + k * made[..., 4] + 2.0 * late_s * made[..., 5]), axis=-1)


def noise(record: Sequence[Run], solution: Array, covariance: Array) -> Noise | None:
    """What the ``covariance`` of the two leaves open in the vertical acceleration, from whatever record there is."""
    size = min(round(TUNING.piece_s / TUNING.row_s), max((len(run.made) for run in record), default=0))
    found = spectra(record, size) if size else None
    if found is None or found.shape[1] < TUNING.lowest + 2:
        return None
    slopes = sensitivity(found[:, TUNING.lowest :], solution)
    power = np.einsum("pfi,ij,pfj->f", slopes.conj(), covariance, slopes).real / len(found)
    # Of a Hann window the mean square is 3/8.
    return Noise(
        np.arange(TUNING.lowest, found.shape[1]) / (size * TUNING.row_s), 2.0 * TUNING.row_s / (0.375 * size) * power
    )


def turned(record: Sequence[Run], otherwise: Belief = NOTHING) -> Belief:
    """What gyroscopes say of the two; the rates of the ``record`` are theirs. ``otherwise``: while they say nothing.

    The angle less what they have made of it is k times the integral, less lateness times the rate: its changes from row
    to row are fitted with the changes of these. Scales and axes of gyroscopes are not those of the angles, so a part of
    both angles, and a bias, are left open. The lateness is that against the gyroscopes: it is the one against the
    accelerometers, too, unless these have another low-pass.
    """
    if sum(len(run.angle) for run in record) < TUNING.turns:
        return otherwise
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
    left = (angle - 0.5 * TUNING.row_s * twice).T.ravel()
    # The normal equations, singular where the vessel lies still, for the solution and for the scatter of k.
    sides = np.column_stack((terms.T @ left, np.eye(len(terms.T))[0]))
    solution, of_k = np.linalg.lstsq(terms.T @ terms, sides)[0].T
    variance = float(np.mean((left - terms @ solution) ** 2))
    k = 1.0 / (variance * float(of_k[0]) + TUNING.turned_per_s**2)
    return Belief(
        np.diag([k, 0.0]),
        np.array([k * solution[0], 0.0]),
        null=(0.0, float(solution[1])),
        spread=(TUNING.usual[0], TUNING.low_pass_s),
    )


class Average(NamedTuple):
    """Of the four cases, in which either of the two is what it may as well be, or not."""

    mean: Array
    """(2,)"""
    covariance: Array
    """(2, 2)"""
    if_any: Array
    """(2,) root of the mean square of each, where it is not what it may as well be."""


def averaged(belief: Belief, information: Array, right: Array) -> Average:
    """The two from a belief and more information, when either may as well be what it is by the belief: each case is
    weighed by how likely it makes the record (Bayes).
    """
    null = np.array(belief.null)
    information = belief.information + information
    right = belief.right + right - information @ null
    means, covariances, logs = np.zeros((4, 2)), np.zeros((4, 2, 2)), np.zeros(4)
    for i, case in enumerate(([0], [1], [0, 1]), start=1):
        usual, told = np.square(belief.spread)[case], information[np.ix_(case, case)]
        covariances[i][np.ix_(case, case)] = np.linalg.solve(told + np.diag(1.0 / usual), np.eye(len(case)))
        means[i] = covariances[i] @ right
        logs[i] = 0.5 * right @ means[i] - 0.5 * np.linalg.slogdet(np.eye(len(case)) + usual[:, None] * told)[1]
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    mean = weights @ means
    off = means - mean
    covariance = np.einsum("c,cij->ij", weights, covariances + off[:, :, None] * off[:, None, :])
    squares = np.square(null + means) + np.einsum("cii->ci", covariances)
    if_any = [float(weights[of] @ squares[of, i] / weights[of].sum()) for i, of in enumerate(([1, 3], [2, 3]))]
    return Average(null + mean, covariance, np.sqrt(if_any))


def _smoothed(power: Array) -> Array:
    """Geometric mean of each and its neighbours."""
    log = np.log(np.pad(power, 1, mode="edge") + 1e-300)
    return np.asarray(np.exp((log[:-2] + log[1:-1] + log[2:]) / 3.0))
