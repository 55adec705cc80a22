"""Two gyro streams on one time base: each with its own rate, jitter, latency and gaps.

At every instant of a common grid a cubic is fitted by least squares to the readings around it. A slow IMU, of about the
grid's own rate, is interpolated; where its readings fall on the grid they are taken as they are, and one that is lost
is missing. Of a fast IMU what lies within three grid steps on either side is averaged under a taper, each reading with
the time that it stands for, so that a lost one makes no wrong mean: what vibrates at or above the grid's rate and would
fold into the wave band is weakened a thousandfold, and in the wave band the fit is flat to some parts in a million,
so that two IMUs of unlike rates still agree. A reading far from what the others around it say is left out of the mean.
Repeated readings, which a slave gives when it is asked faster than it samples, are dropped: they would look like a
delay.
"""

from __future__ import annotations

from math import inf, isfinite, nan
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.ring import RingBuffer

Array = NDArray[np.float64]

REACH_STEPS: Final = 1.5
"""Half width of the fit in grid steps, to a slow stream ..."""
AVERAGED_STEPS: Final = 3.0
"""... and to a fast one."""
FAST: Final = 0.75
"""Grid steps between readings below which a stream is one."""
TAPER: Final = 4
"""(1 - u^2) to this power: with the cubic, at least 60 dB down from the grid's rate on."""
ON_GRID: Final = 1e-5
"""Part of a grid step by which a reading may be off it."""
FEWEST: Final = 6
"""Readings that an average is made of."""
GATE_STD: Final = 8.0
"""A reading of a fast stream further than this from the middle of its neighbours, in its usual distances, is none."""
BENDS: Final = 30
"""Readings that these are taken from at the least, and ..."""
BENDS_MEMORY: Final = 0.02
"""... the weight of one."""
SHORTER: Final = 0.1
"""Weight of an interval in the period when it is shorter, and ..."""
LONGER: Final = 0.01
"""... when it is longer: one with a lost reading in it is no period."""
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
        self._ring = RingBuffer(int(KEPT_S * max_rate_hz), 4)
        self._last: tuple[float, float, float] | None = None
        self.t_s = -inf
        """Stamp of the newest reading, repeated ones included."""
        self.period_s = nan
        """Usual time between different readings; nan before there are two."""
        self.repeated = 0
        """Successive readings that were exactly the one before."""
        self._fresh_t_s = -inf
        self._bends, self._bent = np.zeros(3), 0

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
            longer = since - self.period_s if isfinite(self.period_s) else since
            if longer == since:
                self.period_s = since
            self.period_s += (SHORTER if longer < 0.0 else LONGER) * (since - self.period_s)
        self._fresh_t_s = t_s
        self._ring.push((t_s, x, y, z))
        if self._is_fast:
            self._gate()

    def clear(self) -> None:
        self._ring.clear()
        self._last, self.t_s, self._fresh_t_s, self.period_s, self.repeated = None, -inf, -inf, nan, 0
        self._bent = 0

    @property
    def stuck(self) -> bool:
        """Nothing but repetitions for a second."""
        return self.repeated > 0 and self.t_s - self._fresh_t_s >= STUCK_S

    @property
    def _is_fast(self) -> bool:
        return self.period_s < FAST * self._grid_step_s

    @property
    def _reach_s(self) -> float:
        return (AVERAGED_STEPS if self._is_fast else REACH_STEPS) * self._grid_step_s

    @property
    def covered_s(self) -> float:
        """Up to here :meth:`at` has all that it wants: two readings later, and half the width of the fit."""
        if len(self._ring) < 2:
            return -inf
        before, newest = self._ring.last(2)[:, 0].tolist()
        return float(min(before, newest - self._reach_s))

    def at(self, t_s: float) -> Array:
        """(3,) the fitted rate; nan without two readings on either side, or where they lie too far apart."""
        rows = self._ring.last(len(self._ring))
        times, reach = rows[:, 0], self._reach_s
        middle = int(np.searchsorted(times, t_s))
        first = min(int(np.searchsorted(times, t_s - reach)), middle - NEIGHBOURS)
        end = max(int(np.searchsorted(times, t_s + reach, side="right")), middle + NEIGHBOURS)
        if first < 0 or end > len(times):
            return np.full(3, nan)
        own = self.period_s if isfinite(self.period_s) else self._grid_step_s
        longest = HOLE * min(max(own, self._grid_step_s), SLOWEST * self._grid_step_s)
        if self._is_fast:
            rows = rows[first:end]
            rows = rows[np.isfinite(rows[:, 1])]
            if len(rows) < FEWEST or float(np.max(np.diff(rows[:, 0]))) > longest:
                return np.full(3, nan)
            u = (rows[:, 0] - t_s) / reach
            # Each with the time that it stands for, half the way to either neighbour.
            weights = np.maximum(1.0 - u * u, 0.0) ** TAPER * np.gradient(u)
            V = u[:, None] ** np.arange(4)
            return np.asarray(np.linalg.solve(V.T @ (weights[:, None] * V), V.T @ (weights[:, None] * rows[:, 1:]))[0])
        off = (times[middle - 1 : middle + 1] - t_s) / self._grid_step_s
        if np.min(np.abs(off)) < ON_GRID:
            return np.array(rows[middle - 1 + int(np.argmin(np.abs(off))), 1:])
        rows = rows[first:end]
        is_lost = own < 1.5 * self._grid_step_s and float(np.max(np.abs(off - np.round(off)))) < ON_GRID
        if is_lost or float(np.max(np.diff(rows[:, 0]))) > longest:
            return np.full(3, nan)
        V = ((rows[:, 0] - t_s) / reach)[:, None] ** np.arange(4)
        # The normal equations: four columns of order one, and several times faster than a decomposition.
        return np.asarray(np.linalg.solve(V.T @ V, V.T @ rows[:, 1:])[0])

    def _gate(self) -> None:
        """Strike out the middle one of the last five readings when it is far from the middle of its neighbours.

        So are both its neighbours then, but by half as much.
        """
        rates = self._ring.last(5)[:, 1:]
        if len(rates) < 5:
            return
        square = (rates[1:-1] - 0.5 * (rates[:-2] + rates[2:])) ** 2
        here = square[1]
        if not np.isfinite(here).all():
            return
        if self._bent == 0:
            self._bends = here
        self._bent += 1
        # A jump that is there to stay is let in by and by: each that is refused makes the scale twice as wide.
        usual = self._bends
        self._bends = usual + BENDS_MEMORY * (np.minimum(here, GATE_STD**2 * usual) - usual)
        is_far = (here > GATE_STD**2 * usual) & ~(here < np.maximum(square[0], square[2]))
        if self._bent > BENDS and bool(is_far.any()):
            self._ring.strike(float(self._ring.last(3)[0, 0]), slice(1, 4))


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
