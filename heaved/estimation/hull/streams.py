"""Two gyro streams on one grid: each with its own rate, jitter, latency and gaps.

The grid has the rate of the slower stream, within limits, and each of its instants takes a reading with the time that
this was taken at: nothing is interpolated, a reading that is lost is missing. Of a stream that is faster than the grid
what lies within three grid steps on either side is averaged: a cubic is fitted by least squares under a taper, each
reading with the time that it stands for, so that a lost one makes no wrong mean. What vibrates at or above the grid's
rate and would fold into the wave band is weakened a thousandfold, and in the wave band the fit is flat to some parts in
a million, so that two IMUs of unlike rates still agree. A reading far from what the others around it say is left out of
the mean. Repeated readings, which a slave gives when it is asked faster than it samples, are dropped: they would look
like a delay.
"""

from __future__ import annotations

from math import inf, isfinite, isnan, nan
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
    """Both rates (3,), rad/s, about ``t_s``; nan where a stream had nothing."""

    t_s: float
    midships_radps: Array
    local_radps: Array
    midships_after_s: float = 0.0
    """By how much later than ``t_s`` the reading was taken, and ..."""
    local_after_s: float = 0.0
    """... that of the other."""


class Stream:
    """The recent readings of one IMU."""

    def __init__(self, max_rate_hz: float) -> None:
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
        self._kept_t_s = self._handed_t_s = -inf
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
        if self._is_fast(1.0 / TUNING.most_grid_hz):
            self._gate()

    @property
    def stuck(self) -> bool:
        """Nothing but repetitions for a second."""
        return _is_stuck(self._unchanged)

    def rate_hz(self) -> float:
        """Of most readings of late, lost ones or not; nan with too few."""
        t_s = self._ring.last(TUNING.rate_from)[:, 0]
        return 1.0 / float(np.median(np.diff(t_s))) if len(t_s) >= TUNING.fewest_averaged else nan

    def _is_fast(self, step_s: float) -> bool:
        return self.period_s < TUNING.averaged_below * step_s

    def covered_s(self, step_s: float) -> float:
        """Up to here :meth:`at` has all that it wants."""
        newest_s = float(self._ring.last(1)[0, 0]) if len(self._ring) else -inf
        return newest_s - (TUNING.averaged_reach if self._is_fast(step_s) else 0.5) * step_s

    def at(self, t_s: float, step_s: float) -> tuple[Array, float]:
        """The rate (3,) of the grid's instant ``t_s``, and how much later it was taken; nan: there is none.

        A reading is handed out once: at the instant nearest to it, or the next one where that has another.
        """
        rows = self._ring.last(len(self._ring))
        if not self._is_fast(step_s):
            least_s = max(self._handed_t_s, t_s - TUNING.latest_handed * step_s)
            first, end = np.searchsorted(rows[:, 0], (least_s, t_s + 0.5 * step_s), "right")
            if first == end:
                return _NOTHING, 0.0
            self._handed_t_s = float(rows[first, 0])
            return rows[first, 1:].copy(), self._handed_t_s - t_s
        reach_s = TUNING.averaged_reach * step_s
        first, end = np.searchsorted(rows[:, 0], (t_s - reach_s, t_s + reach_s))
        rows = rows[first:end]
        rows = rows[np.isfinite(rows[:, 1])]
        if len(rows) < TUNING.fewest_averaged or float(np.max(np.diff(rows[:, 0]))) > TUNING.longest_join * step_s:
            return _NOTHING, 0.0
        u = (rows[:, 0] - t_s) / reach_s
        # Each with the time that it stands for, half the way to either neighbour.
        weights = np.maximum(1.0 - u * u, 0.0) ** TUNING.taper_power * np.gradient(u)
        V = u[:, None] ** np.arange(4)
        # The normal equations: four columns of order one, and several times faster than a decomposition.
        return np.linalg.solve(V.T @ (weights[:, None] * V), V.T @ (weights[:, None] * rows[:, 1:]))[0], 0.0

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
    """Push both streams as they come; it hands out the pairs of the grid that are due.

    Attributes:
        rate_hz: of the grid; nan before it is known.
    """

    def __init__(self, least_hz: float, max_rate_hz: float = 250.0) -> None:
        """``least_hz``: the grid is no slower, though the streams may be."""
        self._least_hz = least_hz
        self.rate_hz = nan
        self.midships = Stream(max_rate_hz)
        self.local = Stream(max_rate_hz)
        self._first_s = nan
        self._next = -1
        """Number of the next grid instant: it falls on next / rate_hz."""

    def due(self) -> list[RatePair]:
        """The pairs that both streams reach past, or that have waited long enough."""
        newest_s = max(self.midships.t_s, self.local.t_s)
        if not isfinite(newest_s) or (isnan(self.rate_hz) and not self._begin(newest_s)):
            return []
        step_s = 1.0 / self.rate_hz
        if not -TUNING.longest_jump_s < newest_s - self._next * step_s < TUNING.longest_jump_s:
            self._next = int(np.ceil(newest_s * self.rate_hz))
        pairs: list[RatePair] = []
        while True:
            t_s = self._next / self.rate_hz
            covered_s = min(self.midships.covered_s(step_s), self.local.covered_s(step_s))
            if t_s > max(covered_s, newest_s - TUNING.wait_s):
                return pairs
            (midships, midships_after_s), (local, local_after_s) = (
                stream.at(t_s, step_s) for stream in (self.midships, self.local)
            )
            pairs.append(RatePair(t_s, midships, local, midships_after_s, local_after_s))
            self._next += 1

    def _begin(self, newest_s: float) -> bool:
        """When the streams have been heard for long enough, the grid takes their rate and begins with them."""
        if not 0.0 <= newest_s - self._first_s <= TUNING.longest_jump_s:
            self._first_s = newest_s
        if newest_s - self._first_s < TUNING.heard_s:
            return False
        slower_hz = np.fmin(self.midships.rate_hz(), self.local.rate_hz())
        self.rate_hz = float(np.fmin(np.fmax(self._least_hz, slower_hz), max(self._least_hz, TUNING.most_grid_hz)))
        self._next = int(np.ceil(self._first_s * self.rate_hz))
        return True


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
