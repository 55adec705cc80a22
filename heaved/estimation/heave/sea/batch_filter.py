"""The filter of a fitted model run over stored samples: how a new model takes over without a start of its own.

A model that was fitted a moment ago knows the sea but not the state. It is therefore run over all that is stored; the
filter's memory of its start is the bias, half a minute, and the noise below the wave band, minutes long: after seven
nothing of the start is left. Where it begins later than that, and after a hole, less is known for a minute than in the
end: what the steady gain, which runs in blocks, makes of that minute is corrected (:func:`_corrected`).
"""

from __future__ import annotations

from math import isnan, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.sea.record import EvenRecord, stretches_of

if TYPE_CHECKING:
    from heaved.estimation.heave.sea.filter import SeaFilter
    from heaved.estimation.heave.sea.model import SeaSystem, Steady

Array = NDArray[np.float64]

BLOCK: Final = 64
"""Samples to a matrix product."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of the batch filter."""

    full_s: float = 60.0
    """Seconds for which the covariance is carried: twice the memory of the bias."""
    telling: float = 1e-14
    """Least variance, over the largest one, of a direction of the state in which less is known than in the end."""
    unsure: float = 1.1
    """Standard deviation of the predicted heave over that of the steady filter, from which its smoother's weights are
    not those of the moment any more (with 1.5 the delayed heave is off by 6 of its standard deviations after a gap of 1
    s)."""


TUNING: Final = Tuning()
CHUNK: Final = 16
"""Samples after a hole whose predictions are corrected together."""


class Run(msgspec.Struct, frozen=True, eq=False):
    """What the filter made of a record."""

    x: Array
    """(n,) state at the end, the last sample taken in."""
    P: Array | None
    """(n, n) its covariance; None: the steady one."""
    predicted_m: Array
    """(k,) heave before each sample was taken in; nan in a hole, and where it is less sure than in the end."""
    innovation: Array
    """(k,) m/s2, as large as in the steady filter where it is less sure; 0 in a hole, nan in the first minute of a full
    start, and after a hole that is not ``kept``."""


def run(
    system: SeaSystem,
    steady: Steady,
    record: EvenRecord,
    *,
    full_start: bool = True,
    full_holes: bool = True,
    kept: int | None = None,
) -> Run:
    """Run the filter over a record, from the stationary state at its first sample.

    full_start, full_holes: whether the covariance is carried there. Without, the run starts with the mean as bias and
    keeps to the steady gain: good enough where nothing is left of the start, and where only innovations are wanted.
    kept: how many of the last predictions and innovations are wanted after a hole too; None: all.
    """
    count, whole = len(record.a_mps2), round(TUNING.full_s / record.dt_s)
    told_from = whole if full_start else 0
    if kept is not None:
        told_from = max(told_from, count - kept)
    predicted, innovation = np.full(count, np.nan), np.full(count, np.nan)
    x = np.zeros(len(system.H))
    P = system.stationary if full_start else None
    if not full_start:
        x[-1] = float(np.mean(record.a_mps2))
    blocks = _Blocks(system, steady)
    for begin, end, is_known in stretches_of(record, record.blows):
        first = begin
        if full_holes and (first in record.cuts or first in record.blows):
            if P is None:
                P = steady.P - np.outer(steady.K, steady.K) * steady.S
            P = record.opened(system, P, first)
        elif first in record.cuts:
            x = x.copy()
            x[-1] = float(np.mean(record.a_mps2[first:end]))
        if not is_known:
            innovation[first:end] = 0.0
            if not full_holes:
                x = system.moved((end - first) * record.dt_s) @ x
                continue
            if P is None:
                P = steady.P - np.outer(steady.K, steady.K) * steady.S
            F, Q = system.transition((end - first) * record.dt_s)
            x, P = F @ x, _symmetric(F @ P @ F.T + Q)
            continue
        if P is not None:
            settled = min(first + whole, end)
            part = slice(first, settled)
            said = (predicted[part], innovation[part])
            x, P = _corrected(blocks, record.a_mps2[part], x, P, *said, is_told=settled > told_from)
            if settled - first == whole:
                P = None
            first = settled
        x = blocks.run(record.a_mps2[first:end], x, predicted[first:end], innovation[first:end])
    if full_start:
        predicted[:whole], innovation[:whole] = np.nan, np.nan
    return Run(x, P, predicted, innovation)


MEDIAN_OF_SQUARES: Final = 0.455
"""Of squared standard normal numbers."""


def one_by_one(f: SeaFilter, record: EvenRecord, judged: int) -> tuple[Run, float]:
    """What :func:`run` gives, for a record of more holes than can be taken as exceptions: by the live filter ``f`` from
    its start; and the variance of the last ``judged`` innovations over the model's, robustly.

    Innovations are scaled to the variance of the steady filter.
    """
    count, steady, heave = len(record.a_mps2), f.steady, f.system.heave
    predicted, innovation = np.full(count, np.nan), np.zeros(count)
    limit_m2 = TUNING.unsure**2 * float(heave @ f.steady_covariance @ heave)
    changes = sorted({*record.cuts, *record.blows})
    for i in np.flatnonzero(record.is_known).tolist():
        if isnan(f.t_s):
            f.t_s = (i - 1) * record.dt_s
        while changes and changes[0] <= i:
            f.P = record.opened(f.system, f.covariance, changes.pop(0))
        predicted_m, y = f.step(i * record.dt_s, float(record.a_mps2[i]))
        innovation[i] = y * sqrt(steady.S / f.innovation_variance)
        if f.innovation_variance < TUNING.unsure**2 * steady.S and (
            f.is_steady or float(heave.dot(f.covariance).dot(heave)) < limit_m2
        ):
            predicted[i] = predicted_m
    told = innovation[-judged:][record.is_known[-judged:]] ** 2 / steady.S
    excess = float(np.median(told)) / MEDIAN_OF_SQUARES if len(told) else 1.0
    return Run(f.x, None if f.P is None else f.P.copy(), predicted, innovation), excess


def whitened(system: SeaSystem, steady: Steady, shapes: Array) -> Array:
    """What the steady filter leaves in its innovations of each of ``shapes`` (n, k) that is added to the samples."""
    blocks, left, ignored = _Blocks(system, steady), np.empty_like(shapes), np.empty(len(shapes))
    column = np.empty(len(shapes))
    for i, shape in enumerate(shapes.T):
        blocks.run(shape, np.zeros(len(system.H)), ignored, column)
        left[:, i] = column
    return left


def _corrected(
    blocks: _Blocks, a: Array, x: Array, P: Array, predicted: Array, innovation: Array, *, is_told: bool
) -> tuple[Array, Array]:
    """As :meth:`_Blocks.run`, from a state ``x`` (n,) of which less is known, ``P`` (n, n), than in the steady filter;
    the state after ``a`` (k,) and its covariance.

    With L L' the difference of the two covariances before the first sample, the true state is off by L u + e, u (r,) of
    unit variance and e as large as in the steady filter. What that leaves of the samples is then H A^i L u + white
    noise of its own variance S, so that u is a regression on it (Friedland 1969, the whole state being the bias).
    Without ``is_told``, predictions and innovations are not corrected but left out.
    """
    steady = blocks.steady
    values, vectors = np.linalg.eigh(_symmetric(steady.F @ P @ steady.F.T + steady.Q) - steady.P)
    less = values > TUNING.telling * max(float(values[-1]), 0.0)
    L = vectors[:, less] * np.sqrt(values[less])
    x = blocks.run(a, x, predicted, innovation)
    if not less.any():
        # As after a blow, where the model has nothing that could ring: no less is known than ever.
        if not is_told:
            predicted[:], innovation[:] = np.nan, np.nan
        return x, _symmetric(steady.P - np.outer(steady.K, steady.K) * steady.S)
    seen, heave, L = blocks.ahead(L, len(a))
    known = np.eye(L.shape[1]) + seen.T @ seen / steady.S
    u = np.linalg.solve(known, np.column_stack((seen.T @ innovation / steady.S, L.T)))
    if is_told:
        _tell(steady.S, float(blocks.heave @ steady.P @ blocks.heave), seen, heave, predicted, innovation)
    else:
        predicted[:], innovation[:] = np.nan, np.nan
    return x + L @ u[:, 0], _symmetric(steady.P - np.outer(steady.K, steady.K) * steady.S + L @ u[:, 1:])


def _tell(S: float, variance_m2: float, seen: Array, heave: Array, predicted: Array, innovation: Array) -> None:
    """Correct what the steady filter predicted and left (k,) by what of u (r,) is known before each sample.

    seen, heave: (k, r) innovation and heave from u. variance_m2: of the heave that the steady filter predicts. What is
    predicted while the heave is much less sure than that is left out: it would be smoothed as if it were as good.
    """
    count, r = seen.shape
    pad = -count % CHUNK
    told = [np.pad(values, ((0, pad), (0, 0))).reshape(-1, CHUNK, r) for values in (seen, heave)]
    seen, heave = told
    y = np.pad(innovation, (0, pad)).reshape(-1, CHUNK, 1)
    # Before each chunk, from all chunks before it: u, and its covariance P times the rows of innovation and heave.
    sums = np.matmul(seen.transpose(0, 2, 1), np.concatenate((seen, y), axis=2)) / S
    sums = np.concatenate((np.zeros_like(sums[:1]), np.cumsum(sums[:-1], axis=0)))
    right = np.concatenate((sums[:, :, r:], seen.transpose(0, 2, 1), heave.transpose(0, 2, 1)), axis=2)
    known = np.linalg.solve(np.eye(r) + sums[:, :, :r], right)
    u, PH, Ph = known[:, :, :1], known[:, :, 1 : 1 + CHUNK], known[:, :, 1 + CHUNK :]
    # Within: the innovations are whitened by Cholesky's factor of their covariance, each by those before it.
    factor = np.linalg.cholesky(S * np.eye(CHUNK) + np.matmul(seen, PH))
    right = np.concatenate((y - np.matmul(seen, u), np.matmul(heave, PH).transpose(0, 2, 1)), axis=2)
    white = np.linalg.solve(factor, right)
    learned = np.tril(white[:, :, 1:].transpose(0, 2, 1), -1)
    stds = np.diagonal(factor, axis1=1, axis2=2)
    innovation[:] = sqrt(S) * white[:, :, 0].ravel()[:count]
    correction = np.matmul(heave, u) + np.matmul(learned, white[:, :, :1])
    more_m2 = np.sum(heave * Ph.transpose(0, 2, 1), axis=2) - np.sum(learned**2, axis=2)
    is_sure = variance_m2 + more_m2.ravel()[:count] < TUNING.unsure**2 * variance_m2
    is_sure &= stds.ravel()[:count] ** 2 < TUNING.unsure**2 * S
    predicted[:] = np.where(is_sure, predicted + correction.ravel()[:count], np.nan)


class _Blocks:
    """The steady filter, BLOCK samples at a time.

    With x the state before a sample is taken in, x' = A x + F K z, A = F (I - K H): the predictions within a block are
    linear in x at its start and in its samples.
    """

    def __init__(self, system: SeaSystem, steady: Steady) -> None:
        self.steady, self.heave, self._H = steady, system.heave, system.H
        FK = steady.F @ steady.K
        rows = np.stack((system.H, system.heave))[:, None, :]  # (2, i, n): H and heave of x, i samples on
        columns = FK[None, :]  # (i, n): of a sample, i + 1 samples on
        self._powers = [steady.F - np.outer(FK, system.H)]
        """A^(2^j), (n, n) each, up to that of a block."""
        while len(columns) < BLOCK:
            power = self._powers[-1]
            rows = np.concatenate((rows, rows @ power), axis=1)
            columns = np.concatenate((columns, columns @ power.T))
            self._powers.append(power @ power)
        gains = rows @ FK  # (2, BLOCK): of a sample, i + 1 samples on
        lower = np.subtract.outer(np.arange(BLOCK), np.arange(BLOCK)) - 1
        self._from_x = rows
        self._from_z = np.where(lower >= 0, gains[:, np.maximum(lower, 0)], 0.0)
        self._into_x = columns[::-1]  # (BLOCK, n)

    def run(self, a: Array, x: Array, predicted: Array, innovation: Array) -> Array:
        """Take ``a`` (k,) in after the state ``x``; fills ``predicted`` and ``innovation`` (k,)."""
        if not len(a):
            return x
        x = self.steady.F @ x
        count = (len(a) - 1) // BLOCK
        rest = len(a) - count * BLOCK
        Z, last = a[: count * BLOCK].reshape(count, BLOCK), a[count * BLOCK :]
        into = Z @ self._into_x
        starts = np.empty((count, len(x)))
        for i in range(count):
            starts[i] = x
            x = self._powers[-1] @ x + into[i]
        for made, from_x, from_z in zip((innovation, predicted), self._from_x, self._from_z, strict=True):
            made[: count * BLOCK] = (starts @ from_x.T + Z @ from_z.T).ravel()
            made[count * BLOCK :] = from_x[:rest] @ x + from_z[:rest, :rest] @ last
        np.subtract(a, innovation, out=innovation)
        x = self._moved(x, rest - 1) + last[:-1] @ self._into_x[BLOCK - rest + 1 :]
        return np.asarray(x + self.steady.K * innovation[-1])

    def ahead(self, L: Array, count: int) -> tuple[Array, Array, Array]:
        """Where errors ``L`` (n, r) of the state before a sample lead to: in the innovation and the heave before it and
        the samples after it, (count, r) each, and in the state after the last of them, (n, r).
        """
        each = [L]
        for _ in range((count - 1) // BLOCK):
            each.append(self._powers[-1] @ each[-1])
        seen, heave = np.matmul(self._from_x[:, None], np.stack(each)).reshape(2, -1, L.shape[1])[:, :count]
        last = self._moved(each[-1], (count - 1) % BLOCK)
        return seen, heave, last - np.outer(self.steady.K, self._H @ last)

    def _moved(self, x: Array, count: int) -> Array:
        """A^count x, ``count`` < BLOCK; x is (n,) or (n, r)."""
        for j, power in enumerate(self._powers):
            if count >> j & 1:
                x = power @ x
        return x


def _symmetric(P: Array) -> Array:
    return np.asarray(0.5 * (P + P.T))
