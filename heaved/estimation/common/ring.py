"""The recent past of a stream, column 0 or the first number its time: as an array, or as what is seldom asked for."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from math import inf, nan
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]


class RingBuffer:
    """The last ``capacity`` rows in a fixed block of memory; column 0 is time (s), strictly increasing.

    Any run of recent rows is one contiguous array, without a copy: each row is written twice, ``capacity`` rows apart,
    so that the run lies in one piece somewhere in the doubled buffer. Searches take log2(capacity) looks at the time
    column.
    """

    def __init__(self, capacity: int, columns: int) -> None:
        """
        Raises:
            ValueError: capacity or columns below 1.
        """
        if capacity < 1 or columns < 1:
            raise ValueError(f"ring: {capacity} rows of {columns} columns; both must be at least 1")
        self._rows = np.zeros((2 * capacity, columns))
        self._capacity = capacity
        self._next = 0  # where the next row goes, 0 .. capacity - 1
        self._count = 0
        self._latest = -inf

    def __len__(self) -> int:
        return self._count

    def push(self, row: Sequence[float] | Array) -> None:
        """Append a row (columns,), dropping the oldest when full.

        Raises:
            ValueError: the time is not finite or does not increase, or the row has the wrong length. Nothing is stored.
        """
        rows, at = self._rows, self._next
        time = float(row[0])
        if len(row) != rows.shape[1]:
            raise ValueError(f"ring: a row of {len(row)} values, but there are {rows.shape[1]} columns")
        if not self._latest < time < inf:
            raise ValueError(f"ring: time {time} s does not follow {self._latest} s")
        rows[at] = row
        rows[at + self._capacity] = rows[at]
        self._latest = time
        self._next = at + 1 if at + 1 < self._capacity else 0
        if self._count < self._capacity:
            self._count += 1

    def strike(self, t: float, columns: slice) -> None:
        """What the row at time t says in these columns is not to be believed: nan from now on."""
        view = self._rows[self._next + self._capacity - self._count : self._next + self._capacity]
        at = bisect_left(view[:, 0], t)
        if at < self._count and view[at, 0] == t:
            row = (self._next - self._count + at) % self._capacity
            self._rows[[row, row + self._capacity], columns] = nan

    def last(self, n: int) -> Array:
        """The newest n rows (fewer if there are fewer), oldest first: a read-only view, overwritten by later pushes."""
        end = self._next + self._capacity
        view = self._rows[end - max(0, min(n, self._count)) : end]
        view.flags.writeable = False
        return view

    def since(self, t: float) -> Array:
        """The rows with time >= t, oldest first: a view as of ``last``."""
        view = self.last(self._count)
        recent: Array = view[bisect_left(view[:, 0], t) :]
        return recent

    def at(self, t: float) -> Array:
        """The row (columns,) at time t, linear between its neighbours; all nan outside the stored span."""
        view = self.last(self._count)
        times = view[:, 0]
        if not self._count or not times[0] <= t <= times[-1]:
            return np.full(self._rows.shape[1], nan)
        after = bisect_left(times, t)
        row: Array = view[after].copy()
        if row[0] == t:
            return row
        share = (t - times[after - 1]) / (times[after] - times[after - 1])
        row = (1.0 - share) * view[after - 1] + share * view[after]
        row[0] = t
        return row

    def add(self, column: int, times: Array, values: Array) -> None:
        """Add ``values`` (n,) to a column, linear between ``times`` (n,), increasing; outside of them nothing."""
        once, twice = self._rows[: self._capacity], self._rows[self._capacity :]
        once[:, column] += np.interp(once[:, 0], times, values, left=0.0, right=0.0)
        twice[:, column] = once[:, column]

    def clear(self) -> None:
        """Forget every row; the memory stays."""
        self._next = self._count = 0
        self._latest = -inf


class History:
    """The last rows (time, values...), in order of time. Keeping one costs next to nothing: no array is written to,
    and none can be had; where the past is read as one, :class:`RingBuffer` is the place.
    """

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
