"""Readings that no longer change: the one place where it is told whether a sensor that repeats itself hangs.

:class:`Unchanged` counts for how long anything, one number or a whole block of registers, has been the same; whoever
knows how long that may be needs no more. :class:`StuckDetector` finds out for itself how long it may be: from the
resolution of the readings, from how often they are the same when all is well, and from whether the vessel moves.
:class:`OldReadings` knows those of before that stand between new ones. Pure.
"""

from __future__ import annotations

from collections import OrderedDict
from math import exp, inf, isfinite, nan, sqrt
from typing import TYPE_CHECKING, Final

import msgspec

if TYPE_CHECKING:
    from collections.abc import Hashable


class Unchanged:
    """For how long a reading has been the same.

    Attributes:
        since_s: when the latest reading first came.
        t_s: when it last did.
        repeats: how often it has come again.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Whatever comes next is new."""
        self._content: Hashable = nan
        self.since_s = self.t_s = nan
        self.repeats = 0

    def push(self, t_s: float, content: Hashable) -> float:
        """Take the reading at ``t_s``; seconds for which it has been the same, 0 for a new one. nan is always new."""
        if content != self._content:
            self._content, self.since_s, self.repeats = content, t_s, 0
        else:
            self.repeats += 1
        self.t_s = t_s
        return t_s - self.since_s


class OldTuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of :class:`OldReadings`."""

    memory_s: float = 5.0
    """A reading that is not heard again for so long is forgotten: a gateway that serves its memory serves it sooner."""
    chance: float = 0.004
    """Where fewer readings than that are by chance the same in all as one of before, one that is was not measured."""
    repeating: float = 0.02
    """Nor has one that repeats the last, where fewer than that do."""
    weight: float = 0.0005
    """Of one reading in either share (the last 2000)."""
    refused_weight: float = 1e-5
    """Of one that was refused and does not leap: a memory that is served for a minute does not become usual."""
    refused: float = 0.002
    """Weight of one reading in the share that is refused (the last 500)."""
    width: float = 4.0
    """Where more are, in coarse registers, or not all is the same, it must also leap by so many RMS steps."""
    step_weight: float = 0.005
    """Of one step in their mean square (the last 200)."""
    learned: int = 50
    """Steps from which that is known."""
    stale_s: float = 0.5
    """After a gap this long the last reading says nothing about the next."""


OLD: Final = OldTuning()


class OldReadings:
    """Tells a reading of before that comes again between new ones: of a gateway, or a device, that serves its memory.

    A sensor has noise: what is the same to the last bit in several numbers is the same reading, unless its registers
    are coarse and it hardly moves, which the readings themselves show. So is one that repeats the last, unless that is
    usual: then the sensor is slow, or hangs.
    """

    def __init__(self) -> None:
        self._heard_s: OrderedDict[Hashable, tuple[float, Hashable]] = OrderedDict()
        """When each of the last readings was heard last, the oldest first, and with what."""
        self._last: Hashable = nan
        self._is_old = False
        self._heard, self._new = 0, 0
        self._repeating = self._chance = 1.0
        """Shares of readings that repeat the last, and, of the others, that are the same as one of before."""
        self._t_s = self._value = nan
        self._steps, self._mean_square = 0, 0.0
        self.share = 0.0
        """Of the last readings that were old ones."""

    def step(self, t_s: float, content: Hashable, value: float, beside: Hashable = ()) -> bool:
        """Whether the reading at ``t_s`` is an old one. ``value``: what leaps of its ``content``; ``beside``: what else
        was read with it.
        """
        is_old = self._is_one(t_s, content, value, beside)
        self.share += OLD.refused * (is_old - self.share)
        return is_old

    def _is_one(self, t_s: float, content: Hashable, value: float, beside: Hashable) -> bool:
        heard_s = self._heard_s
        while heard_s and t_s - next(iter(heard_s.values()))[0] > OLD.memory_s:
            heard_s.popitem(last=False)
        was_heard = content in heard_s
        is_same = was_heard and heard_s[content][1] == beside
        repeats = is_same and content == self._last
        heard_s[content] = t_s, beside
        heard_s.move_to_end(content)
        self._last = content
        usually, self._heard = self._repeating, self._heard + 1
        self._repeating += max(OLD.weight, 1.0 / (self._heard + 1)) * (repeats - usually)
        if repeats:
            return self._is_old or usually < OLD.repeating
        leaps = self._leaps(t_s, value)
        self._is_old = was_heard and (leaps or (is_same and self._chance < OLD.chance))
        if not self._is_old:
            self._new += 1
            self._chance += max(OLD.weight, 1.0 / (self._new + 1)) * (is_same - self._chance)
            self._t_s, self._value = t_s, value
        elif not leaps:
            # Where the vessel has come to rest on coarse registers, all are as one of before: for 400 readings.
            self._chance += OLD.refused_weight * (1.0 - self._chance)
        return self._is_old

    def _leaps(self, t_s: float, value: float) -> bool:
        """Whether the step from the last reading that was believed is none of the usual ones."""
        if not t_s - self._t_s <= OLD.stale_s:
            return False
        square, most = (value - self._value) ** 2, OLD.width**2 * self._mean_square
        leaps = self._steps >= OLD.learned and square > most
        if not leaps:
            self._steps += 1
            self._mean_square += max(OLD.step_weight, 1.0 / self._steps) * (square - self._mean_square)
        return leaps


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of a :class:`StuckDetector`. Without a source: chosen, and held by the tests of readings that freeze or rest."""

    longest_s: float = 5.0
    """The very same reading for this long is no measurement. A ship in dock shakes a sensor more than that; a device
    that knows its own resolution says so sooner (``stuck_after_s``)."""
    soon_s: float = 0.1
    """While the vessel moves, a reading that repeats for this long stands still, and so does one of ..."""
    runs: float = 3.0
    """... so many usual runs of repetitions."""
    rests: float = 1.5
    """The same for a channel that rests at the crests of the motion: those of a minute have shown the longest."""
    longest_run_s: float = 0.5
    """A longer run is no usual one: a device that measures less often is of no use for waves."""
    run_memory_s: float = 60.0
    """Of the longest usual run."""
    moves: float = 20.0
    """The vessel moves when the RMS of the readings about their mean is that many steps of the resolution."""
    spread_time_s: float = 10.0
    """Time constant of that mean and RMS."""
    learns_every_s: float = 0.04
    """From readings that change, nothing is learned more often."""
    stop_memory_s: float = 60.0
    """For so long a value at which the readings have stood is known as an end of the range."""
    most_stops: int = 4
    """So many such values are known at once."""
    well_known: int = 100
    """Changes from which a channel that has not repeated itself never does."""
    known: int = 10
    """Changes before which the resolution is not known."""
    usual_steps: float = 3.0
    """A run of repetitions that ends with a larger step than so many usual ones was no rest of the motion."""
    step_memory: float = 0.05
    """Weight of one step in the usual one."""
    longest_rest_s: float = 20.0
    """An angle that rests longer within one step of its resolution is of a ship that does not move."""


TUNING: Final = Tuning()


class StuckDetector:
    """Tells when the readings of one channel repeat and are no measurement: a sensor that hangs, or that is at the end
    of its range.

    Coarse registers and devices that are asked more often than they measure repeat themselves too; the longest such run
    is the patience. Of a vertical acceleration it is one after which the readings go on in the same direction: the end
    of a range is turned back from, and is reached again and again; what was a stop is one from its first reading on. An
    angle has no such end, and rests at the crests of the motion: there a run is honest that is left by a usual step.

    Attributes:
        is_stuck: whether the latest reading must not be used.
        spread: RMS of the readings about their mean of some seconds.
    """

    def __init__(self, *, rests: bool = False, must_live: bool = False, by_chance: bool = False) -> None:
        """``rests``: the range has no end that the motion may reach, as with angles and the smaller accelerations.
        ``must_live``: a value that has never been another is stuck, too; no vessel has nothing of this.
        ``by_chance``: a repetition alone may be chance, and to lose a reading would cost more.
        """
        self.is_stuck = False
        self.spread = 0.0
        self._rests, self._must_live, self._by_chance = rests, must_live, by_chance
        self._run = Unchanged()
        self._value = self._before = nan
        """The latest reading, and the one before that was another."""
        self._run_s = 0.0
        """The longest usual run of repetitions."""
        self._changes = -1  # The first reading is none.
        self._learnt_s = -inf
        self._resolution, self._step = inf, 0.0
        """The least step between readings, and the usual one."""
        self._mean = self._mean_square = 0.0
        self._stops: dict[float, float] = {}
        """Values at which the readings have stood, and when they last did."""

    def step(self, t_s: float, value: float, *, moves: bool = True) -> bool:
        """Whether ``value`` is a repetition that must not be used any more. ``moves``: the vessel does, others know."""
        run = self._run
        if value != self._value:
            if not isfinite(value):
                self.is_stuck = False
                return False
            if run.repeats or t_s - self._learnt_s >= TUNING.learns_every_s:
                self._learn(t_s, value)
            self._before, self._value = self._value, value
            run.push(t_s, value)
            self._changes += 1
            # A reading that has just come is not one that repeats, but it may be a stop that is known.
            self.is_stuck = bool(self._stops) and self._is_known_stop(t_s, value)
            return self.is_stuck
        is_first = not run.repeats
        self.is_stuck = run.push(t_s, value) >= self._patience_s(moves, is_first) - 1e-6
        if self._rests:
            return self.is_stuck
        if self.is_stuck:
            self._stops[value] = t_s
            if len(self._stops) > TUNING.most_stops:
                del self._stops[min(self._stops, key=lambda stop: self._stops[stop])]
        elif self._is_known_stop(t_s, value):
            self.is_stuck = True
        return self.is_stuck

    def _is_known_stop(self, t_s: float, value: float) -> bool:
        return t_s - self._stops.get(value, -inf) < TUNING.stop_memory_s

    def _patience_s(self, moves: bool, is_first: bool) -> float:
        """For how long a reading may repeat, this being its first repetition or not."""
        runs_s = (TUNING.rests if self._rests else TUNING.runs) * self._run_s
        if self.spread > TUNING.moves * self._resolution:
            never_repeats = self._rests and self._run_s == 0.0 and self._changes >= TUNING.well_known
            if never_repeats:
                return inf if is_first and self._by_chance else 0.0
            return TUNING.soon_s + runs_s
        if not self._rests:
            return TUNING.longest_s if self._changes > 0 or self._must_live else inf
        if not moves:
            return inf
        return TUNING.soon_s + runs_s if self._run_s > 0.0 else TUNING.longest_s

    def _learn(self, t_s: float, value: float) -> None:
        """From a new reading: what the last one and its run say."""
        run = self._run
        since_last_s, self._learnt_s = t_s - self._learnt_s, t_s
        elapsed_s = t_s - run.since_s
        if not isfinite(elapsed_s):
            self._mean = value
            return
        if self._run_s > 0.0:
            self._run_s *= exp(-elapsed_s / TUNING.run_memory_s)
        run_s, step = run.t_s - run.since_s, value - self._value
        size = abs(step)
        self._resolution = min(self._resolution, size)
        if run_s > self._run_s and self._is_honest(run_s, elapsed_s, step):
            self._run_s = run_s
        self._step += TUNING.step_memory * (size - self._step)
        weight = min(1.0, since_last_s / TUNING.spread_time_s)
        self._mean += weight * (value - self._mean)
        off = value - self._mean
        self._mean_square += weight * (off * off - self._mean_square)
        self.spread = sqrt(self._mean_square)

    def _is_honest(self, run_s: float, elapsed_s: float, step: float) -> bool:
        """Whether a run of repetitions that has just ended was the motion seen through a coarse register."""
        if elapsed_s >= 2.0 * run_s + TUNING.soon_s:
            return False
        if self._rests:
            is_usual = abs(step) < TUNING.usual_steps * max(self._step, self._resolution)
            return self._changes >= TUNING.known and run_s < TUNING.longest_rest_s and is_usual
        return run_s < TUNING.longest_run_s and step * (self._value - self._before) > 0.0
