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
from heaved.estimation.hull.tuning import TUNING
from heaved.unchanged import Unchanged

Array = NDArray[np.float64]

_NOTHING: Final = np.full(3, nan)
_NOTHING.setflags(write=False)


class RatePair(msgspec.Struct, frozen=True, eq=False, gc=False):
    """Both rates (3,), rad/s, at ``t_s``; nan where a stream had nothing."""

    t_s: float
    midships_radps: Array
    local_radps: Array


class Stream:
    """The recent readings of one IMU."""

    def __init__(self, grid_step_s: float, max_rate_hz: float) -> None:
        self._grid_step_s = grid_step_s
        self._max_rate_hz = max_rate_hz
        self._ring = RingBuffer(int(TUNING.kept_s * max_rate_hz), 4)
        self._unchanged = Unchanged()
        self.clear()

    def clear(self) -> None:
        """Begin anew."""
        self._ring.clear()
        self._unchanged.clear()
        self.t_s = -inf
        """Stamp of the newest reading, repeated ones included."""
        self.period_s = nan
        """Usual time between different readings; nan before there are two."""
        self._kept_t_s = -inf
        self._usual_square, self._squares = np.zeros(3), 0

    def push(self, t_s: float, rates_radps: Array) -> None:
        """Take a reading (3,); out of order or not finite ones are dropped, and those above the largest rate.

        A stamp far in the past is a clock that has stepped: the stream begins anew.
        """
        x, y, z = rates_radps.tolist()
        if not (isfinite(t_s) and isfinite(x) and isfinite(y) and isfinite(z)):
            return
        if t_s < self.t_s - TUNING.longest_jump_s:
            self.clear()
        if t_s <= self.t_s:
            return
        self.t_s = t_s
        self._unchanged.push(t_s, (x, y, z))
        since_s = t_s - self._kept_t_s
        if self._unchanged.repeats or since_s < 0.5 / self._max_rate_hz:
            return
        self._kept_t_s = t_s
        if since_s < 1.0:
            longer_s = since_s - self.period_s if isfinite(self.period_s) else 0.0
            weight = TUNING.shorter_period_weight if longer_s < 0.0 else TUNING.longer_period_weight
            self.period_s = since_s - (1.0 - weight) * longer_s
        self._ring.push((t_s, x, y, z))
        if self._is_fast:
            self._gate()

    @property
    def stuck(self) -> bool:
        """Nothing but repetitions for a second."""
        return _is_stuck(self._unchanged)

    @property
    def _is_fast(self) -> bool:
        return self.period_s < TUNING.averaged_below * self._grid_step_s

    @property
    def _reach_s(self) -> float:
        return (TUNING.averaged_reach if self._is_fast else TUNING.interpolated_reach) * self._grid_step_s

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
        first = min(int(np.searchsorted(times, t_s - reach)), middle - TUNING.neighbours)
        end = max(int(np.searchsorted(times, t_s + reach, side="right")), middle + TUNING.neighbours)
        if first < 0 or end > len(times):
            return _NOTHING
        own = self.period_s if isfinite(self.period_s) else self._grid_step_s
        longest = TUNING.longest_join * min(max(own, self._grid_step_s), TUNING.slowest_joined * self._grid_step_s)
        if self._is_fast:
            rows = rows[first:end]
            rows = rows[np.isfinite(rows[:, 1])]
            if len(rows) < TUNING.fewest_averaged or float(np.max(np.diff(rows[:, 0]))) > longest:
                return _NOTHING
            u = (rows[:, 0] - t_s) / reach
            # Each with the time that it stands for, half the way to either neighbour.
            weights = np.maximum(1.0 - u * u, 0.0) ** TUNING.taper_power * np.gradient(u)
            V = u[:, None] ** np.arange(4)
            return np.asarray(np.linalg.solve(V.T @ (weights[:, None] * V), V.T @ (weights[:, None] * rows[:, 1:]))[0])
        off = (times[middle - 1 : middle + 1] - t_s) / self._grid_step_s
        if np.min(np.abs(off)) < TUNING.on_grid:
            return np.array(rows[middle - 1 + int(np.argmin(np.abs(off))), 1:])
        rows = rows[first:end]
        is_lost = own < 1.5 * self._grid_step_s and float(np.max(np.abs(off - np.round(off)))) < TUNING.on_grid
        if is_lost or float(np.max(np.diff(rows[:, 0]))) > longest:
            return _NOTHING
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
        if self._squares == 0:
            self._usual_square = here
        self._squares += 1
        # A jump that is there to stay is let in by and by: each that is refused makes the scale twice as wide.
        usual = self._usual_square
        self._usual_square = usual + TUNING.usual_distance_weight * (
            np.minimum(here, TUNING.stream_gate_std**2 * usual) - usual
        )
        is_far = (here > TUNING.stream_gate_std**2 * usual) & ~(here < np.maximum(square[0], square[2]))
        if self._squares > TUNING.usual_distance_from and bool(is_far.any()):
            self._ring.strike(float(self._ring.last(3)[0, 0]), slice(1, 4))


class TwoStreams:
    """Push both streams as they come; it hands out the pairs of the grid that are due."""

    def __init__(self, rate_hz: float, max_rate_hz: float = 250.0) -> None:
        self._step_s = 1.0 / rate_hz
        self.midships = Stream(self._step_s, max_rate_hz)
        self.local = Stream(self._step_s, max_rate_hz)
        self._next = -1
        """Number of the next grid instant: it falls on next * step."""

    def due(self) -> list[RatePair]:
        """The pairs that both streams reach past, or that have waited long enough."""
        newest = max(self.midships.t_s, self.local.t_s)
        if not isfinite(newest):
            return []
        if self._next < 0 or not -TUNING.longest_jump_s < newest - self._next * self._step_s < TUNING.longest_jump_s:
            self._next = int(np.ceil(newest / self._step_s))
        pairs: list[RatePair] = []
        while True:
            t = self._next * self._step_s
            covered = min(self.midships.covered_s, self.local.covered_s)
            if t > max(covered, newest - TUNING.wait_s):
                return pairs
            pairs.append(RatePair(t, self.midships.at(t), self.local.at(t)))
            self._next += 1


class RateCheck:
    """What is wrong with an IMU, seen in its rates on the common time base alone: missing, stuck, slower than asked."""

    def __init__(self) -> None:
        self._unchanged = Unchanged()
        self._missing = self._repeated = 0.0

    def checked(self, t_s: float, rates_radps: Array) -> Array:
        """The reading (3,), or nan where it says nothing: not finite, beyond any ship, or exactly the one before.

        A gyro with noise does not repeat itself; a slave that is asked faster than it samples does, and a repeated
        value is late by an unknown time.
        """
        values = rates_radps.tolist()
        missing = not all(abs(rate) <= TUNING.largest_radps for rate in values)
        self._missing += TUNING.share_weight * (missing - self._missing)
        if missing:
            return _NOTHING
        self._unchanged.push(t_s, tuple(values))
        repeated = self._unchanged.repeats > 0
        self._repeated += TUNING.share_weight * (repeated - self._repeated)
        return _NOTHING if repeated else rates_radps

    @property
    def stuck(self) -> bool:
        """Nothing but repetitions for a second."""
        return _is_stuck(self._unchanged)

    @property
    def missing(self) -> bool:
        """Too many readings say nothing."""
        return self._missing > TUNING.missing_share

    @property
    def slow(self) -> bool:
        """Too many readings are repeated ones."""
        return self._repeated > TUNING.repeated_share and not self.stuck


def _is_stuck(unchanged: Unchanged) -> bool:
    """Nothing but repetitions for a second."""
    return unchanged.repeats > 0 and unchanged.t_s - unchanged.since_s >= TUNING.stuck_s - 1e-6
