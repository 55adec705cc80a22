"""Gates for readings of the accelerometer that cannot be true: wild ones, and ones that no longer change."""

from __future__ import annotations

from math import exp, inf, isfinite, nan, sqrt
from typing import Final

from heaved.estimation.common.bounds import HEAVE_ACCELERATION_MPS2

WIDTH: Final = 8.0
"""Steps beyond this many RMS steps are suspect; a Gaussian gives one in 1e15."""
FLOOR_MPS2: Final = 4.0
"""Steps below this are never suspect: slams and engine vibration are real, and what is not is found by what it does."""
LASTING_S: Final = 0.15
"""A level that lasts is real; a spike is over after a reading or two."""
MEMORY: Final = 0.005
"""Weight of one step in the mean square (the last 200 steps)."""
STALE_S: Final = 0.5
"""After a gap this long the last reading says nothing about the next."""


class SpikeGate:
    """Passes a reading, or withholds it (nan) while it stands out of the steps seen so far."""

    def __init__(self, most: float = HEAVE_ACCELERATION_MPS2) -> None:
        """``most``: beyond it, either way, nothing is passed."""
        self.rejected = 0
        self._most = most
        self._t_s = self._value = nan
        self._mean_square = 0.0
        self._steps = 0

    def __call__(self, t_s: float, value: float) -> float:
        """The value, or nan for a spike. Not finite: nan. The first 100 steps are only learned from."""
        if not isfinite(value):
            return nan
        if abs(value) > self._most:
            self.rejected += 1
            return nan
        step = value - self._value
        elapsed = t_s - self._t_s
        if not isfinite(step) or elapsed > STALE_S:
            self._t_s, self._value = t_s, value
            return value
        width = WIDTH * sqrt(self._mean_square)
        limit = width if width > FLOOR_MPS2 else FLOOR_MPS2
        if self._steps >= 100 and abs(step) > limit and elapsed < LASTING_S:
            self.rejected += 1
            return nan
        self._steps += 1
        weight = MEMORY if self._steps > 1.0 / MEMORY else 1.0 / self._steps
        square, most = step * step, 4.0 * limit * limit
        self._mean_square += weight * ((square if square < most else most) - self._mean_square)
        self._t_s, self._value = t_s, value
        return value


STUCK_S: Final = 5.0
"""The very same reading for this long is no measurement. A ship in dock shakes a sensor more than that; a device that
knows its own resolution says so sooner (``stuck_after_s``)."""
SOON_S: Final = 0.1
"""While the vessel moves, a reading that repeats for this long stands still, and so does one of RUNS usual runs."""
RUNS: Final = 3.0
RESTS: Final = 1.5
"""The same for one that rests at the crests of the motion: those of a minute have shown the longest."""
LONGEST_RUN_S: Final = 0.5
"""A device that measures less often is of no use for waves."""
RUN_MEMORY_S: Final = 60.0
MOVES: Final = 20.0
"""The vessel moves when the RMS of the readings about their mean is that many steps of the resolution."""
SPREAD_TIME_S: Final = 10.0
LEARNT_S: Final = 0.04
"""From readings that change, nothing is learned more often."""
STOP_MEMORY_S: Final = 60.0
MANY_STOPS: Final = 4
WELL_KNOWN: Final = 100
"""Changes from which a channel that has not repeated itself never does,"""
FEW_CHANGES: Final = 10
"""Before, the resolution is not known."""
USUAL_STEPS: Final = 3.0
"""A run of repetitions that ends with a larger step than so many usual ones was no rest of the motion."""
STEP_MEMORY: Final = 0.05
"""Weight of one step in the usual one."""
LONGEST_REST_S: Final = 20.0
"""An angle that rests longer within one step of its resolution is of a ship that does not move."""


class StuckGate:
    """Tells when the readings of one channel repeat and are no measurement: a sensor that hangs, or that is at the end
    of its range.

    Coarse registers and devices that are asked more often than they measure repeat themselves too; the longest such run
    is the patience. Of a vertical acceleration it is one after which the readings go on in the same direction: the end
    of a range is turned back from, and is reached again and again; what was a stop is one from its first reading on. An
    angle has no such end, and rests at the crests of the motion: there a run is honest that is left by a usual step.
    """

    def __init__(self, *, rests: bool = False, must_live: bool = False, by_chance: bool = False) -> None:
        """``rests``: the range has no end that the motion may reach, as with angles and the smaller accelerations.
        ``must_live``: a value that has never been another is stuck, too; no vessel has nothing of this.
        ``by_chance``: a repetition alone may be chance, and to lose a reading would cost more.
        """
        self.is_stuck = False
        self.spread = 0.0
        """RMS of the readings about their mean of some seconds."""
        self._rests, self._must_live, self._by_chance = rests, must_live, by_chance
        self._value = self._before = self._since_s = self._t_s = nan
        self._run_s = 0.0
        self._changes = -1  # The first reading is none.
        self._learnt_s = -inf
        self._resolution, self._step = inf, 0.0
        self._mean = self._mean_square = 0.0
        self._stops: dict[float, float] = {}

    def __call__(self, t_s: float, value: float, *, moves: bool = True) -> bool:
        """Whether ``value`` is a repetition that must not be used any more. ``moves``: the vessel does, others know."""
        if value != self._value:
            if not isfinite(value):
                self.is_stuck = False
                return False
            if self._since_s == self._t_s and t_s - self._learnt_s < LEARNT_S:
                self._before, self._value, self._since_s = self._value, value, t_s
            else:
                self._changed(t_s, value)
                self._learnt_s = t_s
            self._changes += 1
            self._t_s = t_s
            # A reading that has just come is not one that repeats, but it may be a stop that is known.
            self.is_stuck = bool(self._stops) and t_s - self._stops.get(value, -inf) < STOP_MEMORY_S
            return self.is_stuck
        is_first = self._t_s == self._since_s
        self._t_s = t_s
        held_s = t_s - self._since_s
        self.is_stuck = held_s >= self._patience_s(moves, is_first) - 1e-6
        if self._rests:
            return self.is_stuck
        if self.is_stuck:
            self._stops[value] = t_s
            if len(self._stops) > MANY_STOPS:
                del self._stops[min(self._stops, key=lambda stop: self._stops[stop])]
        elif t_s - self._stops.get(value, -inf) < STOP_MEMORY_S:
            self.is_stuck = True
        return self.is_stuck

    def _patience_s(self, moves: bool, is_first: bool) -> float:
        """For how long a reading may repeat, this being its first repetition or not."""
        runs_s = (RESTS if self._rests else RUNS) * self._run_s
        if self.spread > MOVES * self._resolution:
            never_repeats = self._rests and self._run_s == 0.0 and self._changes >= WELL_KNOWN
            if never_repeats:
                return inf if is_first and self._by_chance else 0.0
            return SOON_S + runs_s
        if not self._rests:
            return STUCK_S if self._changes > 0 or self._must_live else inf
        if not moves:
            return inf
        return SOON_S + runs_s if self._run_s > 0.0 else STUCK_S

    def _changed(self, t_s: float, value: float) -> None:
        """A new reading: what the last one and its run say."""
        elapsed = t_s - self._since_s
        if isfinite(elapsed):
            if self._run_s > 0.0:
                self._run_s *= exp(-elapsed / RUN_MEMORY_S)
            run_s, step = self._t_s - self._since_s, value - self._value
            size = abs(step)
            if size < self._resolution:
                self._resolution = size
            if run_s > self._run_s and self._is_honest(run_s, elapsed, step):
                self._run_s = run_s
            self._step += STEP_MEMORY * (size - self._step)
            weight = min(1.0, (t_s - self._learnt_s) / SPREAD_TIME_S)
            self._mean += weight * (value - self._mean)
            off = value - self._mean
            self._mean_square += weight * (off * off - self._mean_square)
            self.spread = sqrt(self._mean_square)
        else:
            self._mean = value
        self._before, self._value, self._since_s = self._value, value, t_s

    def _is_honest(self, run_s: float, elapsed_s: float, step: float) -> bool:
        """Whether a run of repetitions that has just ended was the motion seen through a coarse register."""
        if elapsed_s >= 2.0 * run_s + SOON_S:
            return False
        if self._rests:
            is_usual = abs(step) < USUAL_STEPS * max(self._step, self._resolution)
            return self._changes >= FEW_CHANGES and run_s < LONGEST_REST_S and is_usual
        return run_s < LONGEST_RUN_S and step * (self._value - self._before) > 0.0
