"""Two gyro streams on one time base: each with its own rate, jitter, latency and gaps.

At every instant of a common grid a cubic is fitted by least squares to the readings around it. Through a slow IMU that
is interpolation; of a fast one it averages what lies within a grid step and a half on either side, which keeps
vibration from folding into the wave band; and in the wave band it is flat to some parts in a million, so that two IMUs
of unlike rates still agree. Repeated readings, which a slave gives when it is asked faster than it samples, are
dropped: they would look like a delay.
"""

from __future__ import annotations

from math import inf, isfinite, nan
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.ring import Ring

Array = NDArray[np.float64]

REACH_STEPS: Final = 1.5
"""Half width of the fit in grid steps."""
NEIGHBOURS: Final = 2
"""Readings on either side that it takes at the least."""
HOLE: Final = 2.5
"""Readings further apart than so many of their steps are not joined."""
SLOWEST: Final = 4.0
"""A stream slower than the grid by more than this is not interpolated: its readings count as missing."""
WAIT_S: Final = 1.0
"""How long a grid instant waits for the slower stream."""
STUCK_S: Final = 1.0
KEPT_S: Final = 8.0
LONGEST_JUMP_S: Final = 10.0
"""A stream that is further ahead than this of the grid moves the grid."""


class Pair(msgspec.Struct, frozen=True, eq=False, gc=False):
    """Both rates (3,), rad/s, at ``t_s``; nan where a stream had nothing."""

    t_s: float
    midships_radps: Array
    local_radps: Array


class Stream:
    """The recent readings of one IMU."""

    def __init__(self, grid_step_s: float, max_rate_hz: float) -> None:
        self._grid_step_s = grid_step_s
        self._max_rate_hz = max_rate_hz
        self._ring = Ring(int(KEPT_S * max_rate_hz), 4)
        self._last: tuple[float, float, float] | None = None
        self.t_s = -inf
        """Stamp of the newest reading, repeated ones included."""
        self.period_s = nan
        """Slow mean of the time between different readings; nan before there are two."""
        self.repeated = 0
        """Successive readings that were exactly the one before."""
        self._fresh_t_s = -inf

    def give(self, t_s: float, rates_radps: Array) -> None:
        """Take a reading (3,); out of order or not finite ones are dropped, and those above the largest rate.

        A stamp far in the past is a clock that has stepped: the stream begins anew.
        """
        x, y, z = rates_radps.tolist()
        if not (isfinite(t_s) and isfinite(x) and isfinite(y) and isfinite(z)):
            return
        if t_s < self.t_s - LONGEST_JUMP_S:
            self.clear()
        if t_s <= self.t_s:
            return
        self.t_s = t_s
        if (x, y, z) == self._last:
            self.repeated += 1
            return
        self.repeated = 0
        self._last = (x, y, z)
        since = t_s - self._fresh_t_s
        if since < 0.5 / self._max_rate_hz:
            return
        if since < 1.0:
            self.period_s = since if not isfinite(self.period_s) else self.period_s + 0.05 * (since - self.period_s)
        self._fresh_t_s = t_s
        self._ring.push((t_s, x, y, z))

    def clear(self) -> None:
        self._ring.clear()
        self._last, self.t_s, self._fresh_t_s, self.period_s, self.repeated = None, -inf, -inf, nan, 0

    @property
    def stuck(self) -> bool:
        """Nothing but repetitions for a second."""
        return self.repeated > 0 and self.t_s - self._fresh_t_s >= STUCK_S

    @property
    def covered_s(self) -> float:
        """Up to here :meth:`at` has all that it wants: two readings later, and half the width of the fit."""
        if len(self._ring) < 2:
            return -inf
        before, newest = self._ring.last(2)[:, 0].tolist()
        return float(min(before, newest - REACH_STEPS * self._grid_step_s))

    def at(self, t_s: float) -> Array:
        """(3,) the fitted rate; nan without two readings on either side, or where they lie too far apart."""
        rows = self._ring.last(len(self._ring))
        times = rows[:, 0]
        reach = REACH_STEPS * self._grid_step_s
        middle = int(np.searchsorted(times, t_s))
        first = min(int(np.searchsorted(times, t_s - reach)), middle - NEIGHBOURS)
        end = max(int(np.searchsorted(times, t_s + reach, side="right")), middle + NEIGHBOURS)
        if first < 0 or end > len(times):
            return np.full(3, nan)
        own = self.period_s if isfinite(self.period_s) else self._grid_step_s
        rows = rows[first:end]
        if float(np.max(np.diff(rows[:, 0]))) > HOLE * min(max(own, self._grid_step_s), SLOWEST * self._grid_step_s):
            return np.full(3, nan)
        V = ((rows[:, 0] - t_s) / reach)[:, None] ** np.arange(4)
        # The normal equations: four columns of order one, and several times faster than a decomposition.
        fitted = np.linalg.solve(V.T @ V, V.T @ rows[:, 1:])
        return np.asarray(fitted[0])


class TwoStreams:
    """Give it both streams as they come; it hands out the pairs of the grid that are due."""

    def __init__(self, rate_hz: float, max_rate_hz: float = 250.0) -> None:
        self._step_s = 1.0 / rate_hz
        self.midships = Stream(self._step_s, max_rate_hz)
        self.local = Stream(self._step_s, max_rate_hz)
        self._next = -1
        """Number of the next grid instant: it falls on next * step."""

    def due(self) -> list[Pair]:
        """The pairs that both streams reach past, or that have waited long enough."""
        newest = max(self.midships.t_s, self.local.t_s)
        if not isfinite(newest):
            return []
        if self._next < 0 or not -LONGEST_JUMP_S < newest - self._next * self._step_s < LONGEST_JUMP_S:
            self._next = int(np.ceil(newest / self._step_s))
        pairs: list[Pair] = []
        while True:
            t = self._next * self._step_s
            covered = min(self.midships.covered_s, self.local.covered_s)
            if t > max(covered, newest - WAIT_S):
                return pairs
            pairs.append(Pair(t, self.midships.at(t), self.local.at(t)))
            self._next += 1
