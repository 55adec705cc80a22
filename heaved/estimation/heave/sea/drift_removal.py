"""A drift of the bias taken out of a record: what it leaves in the innovations of a filter that is not told of it.

The rate is constant over quarters of a minute, counted back from the end of the record, and walks from one to the next.
Each of these leaves a known answer in the innovations (:class:`heaved.estimation.heave.sea.drift.RampResponse`), which
are white beside it: a linear regression, with the walk as its prior. It looks both ways, and knows the past of the
level several times better than the filter had known it then.
"""

from __future__ import annotations

from math import ceil, inf, sqrt
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.sea import batch_filter
from heaved.estimation.heave.sea.drift import TUNING, RampResponse, walk_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.estimation.heave.sea.model import SeaSystem, Steady
    from heaved.estimation.heave.sea.record import EvenRecord

Array = NDArray[np.float64]


class Level(msgspec.Struct, frozen=True, eq=False):
    """Of the bias, as far as it has drifted."""

    a_mps2: Array
    """(n,) at every sample of the record, from 0 before the first drift."""
    edges: tuple[tuple[int, int], ...]
    """First and last edge of each piece of constant rate, in blocks before the end of the record."""
    rates_mps3: Array
    """(k,) of each piece."""
    C: Array
    """(k, k) covariance of these."""
    is_going_on: bool
    """Whether the last piece ends with the record."""

    def missing(self, system: SeaSystem, steady: Steady) -> Array:
        """(n + 1, n + 1) covariance of what the state at the end lacks and of the rate, the last element, of a filter
        that has seen the record with this level taken out.
        """
        blocks = sorted({edge for edges in self.edges for edge in edges})
        states = dict(zip(blocks, RampResponse(system, steady, blocks[-1]).states(blocks), strict=True))
        rows = np.zeros((len(self.edges), len(system.H) + 1))
        rows[:, :-1] = [states[first] - states[last] for first, last in self.edges]
        rows[-1, -1] = 1.0
        return np.asarray(rows.T @ self.C @ rows)


def level(
    record: EvenRecord, system: SeaSystem, steady: Steady, spans_s: Sequence[tuple[float, float]]
) -> Level | None:
    """How the bias has drifted within ``spans_s``, from when until when in s, inf: until the end; None: there is none
    in the ``record``.
    """
    count, dt = len(record.a_mps2), record.dt_s
    block = max(round(TUNING.block_s / dt), 1)
    ages = [
        (np.array((record.end_s - first_s, max(record.end_s - last_s, 0.0))) / dt / block).tolist()
        for first_s, last_s in spans_s
    ]
    edges: list[tuple[int, int]] = []
    begins = set[int]()
    for first, last in ages:
        newest = int(max(last, 0.0) / TUNING.knot) * TUNING.knot
        oldest = min(ceil(first / TUNING.knot) * TUNING.knot, count // block)
        inside = list(range(oldest, newest, -TUNING.knot))
        if inside:
            begins.add(len(edges))
            edges += [(age, max(age - TUNING.knot, newest)) for age in inside]
    if not edges:
        return None
    response = RampResponse(system, steady, edges[0][0])
    longest = edges[0][0] * block
    done = batch_filter.run(system, steady, record)
    y, seen = done.innovation[-longest:], record.is_known[-longest:]
    X, levels = np.zeros((longest, len(edges))), np.zeros((count, len(edges)))
    cuts = [cut - (count - longest) for cut in record.cuts]
    for j, (first, last) in enumerate(edges):
        begin, end = longest - first * block, longest - last * block
        X[begin:, j] = response.innovation[: longest - begin]
        if end < longest:
            X[end:, j] -= response.innovation[: longest - end]
        for cut in cuts:
            if cut >= end:
                X[cut:, j] = 0.0  # The filter knows nothing of the bias there.
        levels[:, j] = dt * np.clip(np.arange(count) + 1 - (count - longest) - begin, 0, end - begin)
    told = seen & np.isfinite(y)
    shown, answer = X[told].T @ X[told] / steady.S, X[told].T @ y[told] / steady.S
    # A rate walks from piece to piece, from any at the first; how far, by how large it is.
    D = np.eye(len(edges)) - np.eye(len(edges), k=-1)
    D[sorted(begins), :] = np.eye(len(edges))[sorted(begins)]
    piece_s = TUNING.knot * block * dt
    rates, C = np.full(len(edges), TUNING.rates_mps3[0]), np.empty(0)
    for _ in range(2):
        spread = np.full(len(edges), TUNING.kinks * walk_of(float(np.max(np.abs(rates)))) * sqrt(piece_s))
        spread[sorted(begins)] = TUNING.rates_mps3[1]
        C = np.linalg.solve(shown + D.T @ (D / spread[:, None] ** 2), np.eye(len(edges)))
        rates = C @ answer
    is_going_on = edges[-1][1] == 0 and spans_s[-1][1] == inf
    return Level(levels @ rates, tuple(edges), rates, 0.5 * (C + C.T), is_going_on)
