"""What errors of the acceleration that are known in shape, but not in size, do to the heave: at each moment by itself.

An attitude that is late by an unknown time makes the vertical acceleration wrong by that time, times products of waves.
How large these are follows the groups of the waves: what the error is on average, from its spectrum, it is three times
over in a high group, and hardly at all between two. The shape is known as it comes. So the same filter that makes heave
of the acceleration is applied to the shape, as its answer to a row of it so long ago; what the size is not known by,
times that, is the standard deviation of the moment (a consider covariance; Schmidt 1966).
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.ring import RingBuffer

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]

SIZES: Final = 2
"""Errors whose size is not known."""
LACKING: Final = 1 + SIZES
"""Columns of the record: time, the shapes, and what the acceleration was measured too little by, as is known by now."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of the record."""

    row_s: float = 0.25
    """Of the rows that come: waves lose nothing in their means."""
    reach_s: float = 400.0
    """Nothing of what was so long ago is left in the heave."""
    lasts_s: float = 30.0
    """Where no rows come any more, what there was counts for so long."""
    held_s: float = 6.0
    """The largest of so long a time counts: the answer goes through zero twice in each of its long periods."""


TUNING: Final = Tuning()


class Mistakes:
    """Feed it every row; the answer of the filter is an argument."""

    def __init__(self) -> None:
        self._rows = RingBuffer(round(TUNING.reach_s / TUNING.row_s), LACKING + 1)
        self._covariance = np.zeros((SIZES, SIZES))
        self._squares: deque[float] = deque(maxlen=round(TUNING.held_s / TUNING.row_s))

    def are_over(self, t_s: float) -> bool:
        """Whether none have come for so long that nothing is left of them, or there were none."""
        return not len(self._rows) or t_s - float(self._rows.last(1)[0, 0]) > TUNING.lasts_s

    def clear(self) -> None:
        """The heave begins anew, and forgets them."""
        self._rows.clear()
        self._squares.clear()

    def push(self, t_s: float, shapes: Sequence[float], covariance: Array) -> None:
        """A row, later than the last: what the errors (2,) make of the acceleration for each unit of their size, and
        how well that is known now (2, 2).
        """
        self._rows.push((t_s, *shapes, 0.0))
        self._covariance = covariance

    def amend(self, t_s: Array, more_mps2: Array) -> None:
        """The past at ``t_s`` (n,) was measured too little by so much (n,), and the filter does not know yet."""
        self._rows.add(LACKING, t_s, more_mps2)

    def known_until(self, t_s: float) -> None:
        """The filter has been through the past once more, as it is known by now."""
        if not len(self._rows):
            return
        rows = self._rows.last(len(self._rows))
        self._rows.add(LACKING, rows[:, 0], np.where(rows[:, 0] <= t_s, -rows[:, LACKING], 0.0))

    def square_m2(self, answer: Array) -> float:
        """Mean square of what they make of the heave now. ``answer`` (n,): heave for an acceleration of 1 m/s2 that
        lasted for a row, so many rows ago.
        """
        rows = self._rows.last(len(self._rows))
        ago = np.rint((rows[-1, 0] - rows[:, 0]) / TUNING.row_s).astype(np.intp)
        first = int(np.searchsorted(-ago, 1 - len(answer)))
        made = answer[ago[first:]] @ rows[first:, 1:]
        of_size, lacking = made[:SIZES], made[SIZES]
        self._squares.append(float(of_size @ self._covariance @ of_size + lacking * lacking))
        return max(self._squares)
