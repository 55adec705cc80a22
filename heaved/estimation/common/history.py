"""The recent past of a few numbers that are kept often and asked for seldom."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from operator import itemgetter


class Trail:
    """The last rows (time, values...), in order of time. Keeping one costs next to nothing: no array is written to,
    and none can be had; where the past is read as one, :class:`heaved.estimation.common.ring.Ring` is the place."""

    def __init__(self, capacity: int) -> None:
        self._rows: deque[tuple[float, ...]] = deque(maxlen=capacity)

    def push(self, row: tuple[float, ...]) -> None:
        """Append a row, whose time is later than that of the last one, dropping the oldest when full."""
        self._rows.append(row)

    def at(self, t_s: float) -> tuple[float, ...] | None:
        """The row at ``t_s``, linear between its neighbours; None outside of what is kept."""
        rows = self._rows
        if not rows or not rows[0][0] <= t_s <= rows[-1][0]:
            return None
        place = bisect_left(rows, t_s, key=itemgetter(0))
        after = rows[place]
        if after[0] == t_s:
            return after
        before = rows[place - 1]
        share = (t_s - before[0]) / (after[0] - before[0])
        return (t_s, *[(1.0 - share) * a + share * b for a, b in zip(before[1:], after[1:], strict=True)])
