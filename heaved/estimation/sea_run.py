"""The filter of a fitted model run over stored samples: how a new model takes over without a start of its own.

A model that was fitted a moment ago knows the sea but not the state. It is therefore run over all that is stored; the
filter's memory of its start is the bias, half a minute, and the noise below the wave band, minutes long: after seven
nothing of the start is left. Where it begins later than that, and after a hole, the full covariance is carried for a
minute, so that the gain is what little is known, not what would be known in the end; then the steady gain runs in
blocks, which costs a matrix product for every BLOCK samples.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from heaved.estimation.sea_model import SeaSystem, Steady, measurement_variance

Array = NDArray[np.float64]

BLOCK: Final = 32
FULL_S: Final = 60.0
"""Seconds for which the covariance is carried: twice the memory of the bias."""
COARSE_S: Final = 0.2
"""Samples are averaged over this at the very start: what is lost there is above the waves."""
UNSURE: Final = 1.5
"""Standard deviation of the predicted heave over that of the steady filter."""
HOLE: Final = 3.5
"""Neighbours further apart than this many intervals have a hole between them; closer ones are interpolated."""
BRIDGED_S: Final = 0.3
"""So are those closer than this: a quarter of the shortest wave that is fitted."""
ON_THE_GRID: Final = 1e-3
"""Deviation, in intervals, up to which a sample is taken as it is."""


class Record(msgspec.Struct, frozen=True, eq=False):
    """Vertical acceleration on an even grid that ends at the last sample."""

    end_s: float
    """Time of the last value."""
    dt_s: float
    a_mps2: Array
    """(n,); in a hole, a straight line."""
    is_known: NDArray[np.bool_]
    """(n,); False in a hole."""


def even(t_s: Array, a_mps2: Array) -> Record:
    """Samples at increasing, not quite even times (n,), n >= 8, on an even grid of their own usual interval.

    A cubic spline through neighbours: at ten samples to a wave its error is 1e-4 of the wave.
    """
    gaps = np.diff(t_s)
    usual = float(np.median(gaps))
    dt = float(np.mean(gaps[gaps < 1.5 * usual]))
    steps, longest = np.rint(gaps / dt), max(HOLE, BRIDGED_S / dt)
    is_even = bool(np.all(np.abs(gaps - dt * steps) < ON_THE_GRID * dt)) and bool(np.all(steps >= 1.0))
    if is_even and abs((t_s[-1] - t_s[0]) / np.sum(steps) - dt) * np.sum(steps) < 0.1 * dt:
        index = np.concatenate(([0.0], np.cumsum(steps))).astype(np.int64)
        grid = np.arange(index[-1] + 1)
        values, known = np.interp(grid, index, a_mps2), np.zeros(len(grid), dtype=np.bool_)
        known[index] = True
        near = np.repeat(steps <= longest, steps.astype(np.int64))
        known[1:] |= near
        if not known[index].all() or len(index) < len(grid):
            values = _filled(grid.astype(np.float64), values, known, index.astype(np.float64), a_mps2)
        return Record(float(t_s[-1]), dt, values, known)
    count = int((t_s[-1] - t_s[0]) / dt) + 1
    times = t_s[-1] - dt * np.arange(count - 1, -1, -1.0)
    after = np.clip(np.searchsorted(t_s, times - 1e-9), 1, len(t_s) - 1)
    known = gaps[after - 1] <= longest * dt
    return Record(float(t_s[-1]), dt, _filled(times, np.interp(times, t_s, a_mps2), known, t_s, a_mps2), known)


def _filled(times: Array, line: Array, known: NDArray[np.bool_], t_s: Array, a_mps2: Array) -> Array:
    """The spline where it is ``known``, the straight ``line`` in the holes."""
    return np.where(known, CubicSpline(t_s, a_mps2)(times), line)


class Run(msgspec.Struct, frozen=True, eq=False):
    """What the filter made of a record."""

    x: Array
    """(n,) state at the end, the last sample taken in."""
    P: Array | None
    """(n, n) its covariance; None: the steady one."""
    predicted_m: Array
    """(k,) heave before each sample was taken in; nan where that is not as sure as in the steady filter."""
    innovation: Array
    """(k,) m/s2; 0 in a hole, nan where the start was averaged."""


def run(
    system: SeaSystem, steady: Steady, record: Record, *, full_start: bool = True, full_holes: bool = True
) -> Run:
    """Run the filter over a record, from the stationary state at its first sample.

    full_start, full_holes: whether the covariance is carried there. Without, the run starts with the mean as bias and
    keeps to the steady gain: good enough where nothing is left of the start, and where only innovations are wanted.
    """
    n, count = len(system.H), len(record.a_mps2)
    predicted, innovation = np.full(count, np.nan), np.full(count, np.nan)
    x, P, begin = np.zeros(n), None, 0
    if full_start:
        coarse = max(1, round(COARSE_S / record.dt_s))
        begin = min(count, round(FULL_S / record.dt_s)) // coarse * coarse
        begin = _first_hole(record.is_known, begin) // coarse * coarse
        x, P = _coarse_start(system, record, begin, coarse)
        if begin * record.dt_s >= FULL_S - coarse * record.dt_s:
            P = None
    else:
        x[-1] = float(np.mean(record.a_mps2))
    blocks = _Blocks(system, steady)
    for first, end, is_known in _stretches(record.is_known, begin):
        a = record.a_mps2[first:end]
        if not is_known:
            predicted[first:end], innovation[first:end] = system.heave @ x, 0.0
            if not full_holes:
                x = system.moved((end - first) * record.dt_s) @ x
                continue
            if P is None:
                P = steady.P - np.outer(steady.K, steady.K) * steady.S
            F, Q = system.transition((end - first) * record.dt_s)
            x, P = F @ x, _symmetric(F @ P @ F.T + Q)
            continue
        done = 0
        if P is not None:
            done = min(len(a), round(FULL_S / record.dt_s))
            x, P = _full(system, steady, a[:done], x, P, predicted[first:], innovation[first:])
            if done == round(FULL_S / record.dt_s):
                P = None
        x = blocks.run(a[done:], x, predicted[first + done : end], innovation[first + done : end])
    return Run(x, P, predicted, innovation)


def _first_hole(is_known: NDArray[np.bool_], within: int) -> int:
    holes = np.flatnonzero(~is_known[:within])
    return int(holes[0]) if len(holes) else within


def _stretches(is_known: NDArray[np.bool_], begin: int) -> Iterator[tuple[int, int, bool]]:
    """(first, end, is_known) of each stretch that is all known or all unknown."""
    edges = begin + 1 + np.flatnonzero(np.diff(is_known[begin:].astype(np.int8)))
    bounds = [begin, *edges.tolist(), len(is_known)]
    for first, end in itertools.pairwise(bounds):
        if end > first:
            yield first, end, bool(is_known[first])


def _coarse_start(system: SeaSystem, record: Record, count: int, coarse: int) -> tuple[Array, Array]:
    """x and P, the last of ``count`` samples taken in, from nothing but the spectrum; ``coarse`` samples at a time."""
    dt = coarse * record.dt_s
    F, Q = system.transition(dt)
    R = measurement_variance(system.model.noise_psd, dt)
    x, P = np.zeros(len(system.H)), system.stationary
    for i, z in enumerate(np.mean(record.a_mps2[:count].reshape(-1, coarse), axis=1).tolist()):
        if i:
            x, P = F @ x, _symmetric(F @ P @ F.T + Q)
        PH = P @ system.H
        S = float(system.H @ PH) + R
        x, P = x + PH * ((z - float(system.H @ x)) / S), P - np.outer(PH, PH) / S
    if count and coarse > 1:
        # The last mean stands for the middle of its samples.
        forward, noise = system.transition(0.5 * (coarse - 1) * record.dt_s)
        x, P = forward @ x, _symmetric(forward @ P @ forward.T + noise)
    return x, P


def _full(
    system: SeaSystem, steady: Steady, a: Array, x: Array, P: Array, predicted: Array, innovation: Array
) -> tuple[Array, Array]:
    """One sample at a time with the covariance; x and P are those of the sample before.

    What is predicted while the heave is much less sure than in the steady filter is left out: it would be smoothed as
    if it were as good.
    """
    R = measurement_variance(system.model.noise_psd, steady.dt_s)
    sure = UNSURE**2 * float(system.heave @ steady.P @ system.heave)
    for i, z in enumerate(a.tolist()):
        x, P = steady.F @ x, _symmetric(steady.F @ P @ steady.F.T + steady.Q)
        PH = P @ system.H
        S = float(system.H @ PH) + R
        y = z - float(system.H @ x)
        innovation[i] = y
        if float(system.heave @ P @ system.heave) < sure:
            predicted[i] = system.heave @ x
        x, P = x + PH * (y / S), P - np.outer(PH, PH) / S
    return x, P


class _Blocks:
    """The steady filter, BLOCK samples at a time.

    With x the state before a sample is taken in, x' = A x + F K z, A = F (I - K H): the predictions within a block are
    linear in x at its start and in its samples.
    """

    def __init__(self, system: SeaSystem, steady: Steady) -> None:
        n = len(system.H)
        self._system, self._steady = system, steady
        A = steady.F @ (np.eye(n) - np.outer(steady.K, system.H))
        self._A, self._FK = A, steady.F @ steady.K
        rows = np.empty((2, BLOCK, n))  # H and heave of x, i samples on
        rows[:, 0] = system.H, system.heave
        for i in range(1, BLOCK):
            rows[:, i] = rows[:, i - 1] @ A
        gains = rows @ self._FK  # (2, BLOCK): of a sample, i + 1 samples on
        lower = np.subtract.outer(np.arange(BLOCK), np.arange(BLOCK)) - 1
        self._from_x = rows
        self._from_z = np.where(lower >= 0, gains[:, np.maximum(lower, 0)], 0.0)
        columns = [self._FK]
        for _ in range(BLOCK - 1):
            columns.append(A @ columns[-1])
        self._into_x = np.stack(columns[::-1])  # (BLOCK, n)
        self._A_block = np.linalg.matrix_power(A, BLOCK)

    def run(self, a: Array, x: Array, predicted: Array, innovation: Array) -> Array:
        """Take ``a`` (k,) in after the state ``x``; fills ``predicted`` and ``innovation`` (k,)."""
        system, steady = self._system, self._steady
        x = steady.F @ x if len(a) else x
        count = len(a) // BLOCK
        Z = a[: count * BLOCK].reshape(count, BLOCK)
        into = Z @ self._into_x
        starts = np.empty((count, len(x)))
        for i in range(count):
            starts[i] = x
            x = self._A_block @ x + into[i]
        z_of = starts @ self._from_x[0].T + Z @ self._from_z[0].T
        innovation[: count * BLOCK] = (Z - z_of).ravel()
        predicted[: count * BLOCK] = (starts @ self._from_x[1].T + Z @ self._from_z[1].T).ravel()
        for i in range(count * BLOCK, len(a)):
            innovation[i] = a[i] - system.H @ x
            predicted[i] = system.heave @ x
            x = self._A @ x + self._FK * a[i]
        if not len(a):
            return x
        # Back before the last prediction: x = F (x- + K y), and the state that is wanted is the bracket.
        return np.asarray(np.linalg.solve(steady.F, x))


def _symmetric(P: Array) -> Array:
    return np.asarray(0.5 * (P + P.T))
