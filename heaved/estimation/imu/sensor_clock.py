"""Sensors that measure more slowly than they are asked: which readings are new, and when each was measured.

A slave answers with what it measured last. Asked 100 times a second, one that measures 30 times gives each reading
three or four times over: repetitions, taken for readings, make the motion a staircase that is late by up to a period,
and no filter knows. Such repetitions are as regular as two clocks: a poll shows a new reading when a tick of the
device's own clock, phase + n period, lies between it and the poll before. Coarse registers repeat themselves too, but
by chance, and those readings are as good as any.

So, when readings repeat, the polls of some seconds are held against the clock that explains them best. While that holds
each new reading says that a tick lies between two polls, and the phase is what is in all these intervals: it is known
much better than a poll is long, unless the clocks run locked.
"""

from __future__ import annotations

from math import floor, inf, nan, sqrt
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.sample_rate import Clock

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """When polls are looked at, what a clock must explain of them, and how it is followed.

    Without a source: chosen, and held by the tests over devices and polls of many rates.
    """

    few: int = 24
    """New readings, and repetitions, that are looked at together, at least;"""
    few_runs: int = 12
    """so few new ones do where each is followed by several repetitions."""
    many: float = 4.0
    """Polls per reading from which that is so, and the number of a reading is clear from its time."""
    all_new: int = 50
    """Readings without a repetition after which the sensor keeps up with its polls: later ones are something else."""
    look_s: float = 30.0
    """Whatever has been found in so long a time is all there is."""
    longest_look: int = 3000
    """Likewise in so many polls."""
    rest_s: float = 20.0
    """Repetitions that no clock explains are not looked at again before, and then twice that, up to ..."""
    longest_rest_s: float = 600.0
    """... so long."""
    unexplained: float = 0.3
    """Share of the repetitions (or new readings, whichever are fewer) that a clock may fail to explain: devices are
    held up, too. Of repetitions by chance it fails to explain half and more."""
    least_share: float = 0.045
    """Of repetitions, or of new readings, for which a clock is sought among all there can be."""
    uneven: float = 0.3
    """Runs of repetitions are even whose lengths are off the usual one by less than this share of it,"""
    even_runs: float = 0.8
    """so many of them. Of runs by chance, a fifth is."""
    whole: float = 0.4
    """Of the new readings so many are new in all channels: coarse registers of a smooth motion change evenly, too, but
    one after the other."""
    held_up: float = 1.5
    """A poll later than so many median intervals may have missed readings."""
    longest: int = 60
    """Readings by which phase and period are known: the quartzes of device and poller drift by some ppm meanwhile."""
    scatter_memory: float = 30.0
    """Readings by which the scatter about the clock is known."""
    surprises: float = 8.0
    """New readings that no tick explains, in excess of ..."""
    surprising: float = 0.1
    """... this share of all, after which the clock is another."""
    lost_ticks: float = 4.0
    """Without a new reading for so many periods the sensor hangs."""


TUNING: Final = Tuning()


class SensorClock:
    """Feed it every poll of some channels that are measured together.

    Attributes:
        poll_s: usual interval of the polls at which a slower clock was found.
        is_slow: whether there is one; otherwise each poll is a reading.
    """

    def __init__(self) -> None:
        self._begin()

    def _begin(self) -> None:
        self.is_slow = False
        self.poll_s = nan
        self._clock = Clock(TUNING.longest)
        self._t_s = nan
        self._undecided = True
        """Nothing has been judged yet: repetitions are not taken for readings until it has."""
        self._looking, self._rests_until_s, self._rest_s = False, -inf, TUNING.rest_s
        self._polls: list[tuple[float, bool]] = []
        self._repeats = self._new = self._whole = 0
        self._scatter_s2 = 0.0
        self._surprises = 0.0

    @property
    def period_s(self) -> float:
        """Of the device's own measurements where it is slower than the polls; nan: it is not."""
        return self._clock.period_s

    def step(self, t_s: float, is_new: bool, is_whole: bool = True) -> float:
        """Time at which the reading of the poll at ``t_s`` was measured; nan where it is no new one.

        ``is_new``: it differs from the one before; a first reading does. ``is_whole``: in all its channels.
        """
        before_s, self._t_s = self._t_s, t_s
        if self.is_slow:
            if is_new:
                return self._measured(before_s, t_s)
            overdue_s = t_s - self._clock.tick_s - self._clock.period_s
            if 0.0 < overdue_s <= t_s - before_s:  # The first poll without a reading that was expected.
                self._clock.correct(overdue_s)
            return nan
        if self._looking:
            self._polls.append((t_s, is_new))
            self._repeats += not is_new
            self._whole += is_new and is_whole
            if self._is_enough(t_s):
                self._judge()
        elif is_new:
            self._new += 1
            if self._new == TUNING.all_new:
                self._undecided = False
        elif t_s >= self._rests_until_s:
            self._looking, self._polls, self._repeats = True, [(before_s, True), (t_s, False)], 1
            self._whole = 0
        return t_s if is_new or not self._undecided else nan

    @property
    def hangs(self) -> bool:
        """The sensor's clock has stood still for several of its periods."""
        return self._t_s - self._clock.tick_s > TUNING.lost_ticks * self._clock.period_s

    @property
    def uncertainty_s(self) -> float:
        """Standard deviation of the times that are given: what the ticks' intervals do not tell of the phase.

        A tick lies anywhere between two polls, a variance of a twelfth of their square: it shows as scatter about the
        clock, and averages out, unless the two clocks run locked.
        """
        if not self.is_slow:
            return 0.0
        whole = self.poll_s**2 / 12.0
        return sqrt(max(whole - self._scatter_s2, 0.0) + 4.0 * whole / self._clock.ticks)

    # --- the phase ---------------------------------------------------------------------------------------------------

    def _measured(self, before_s: float, t_s: float) -> float:
        """A tick lies between two polls, the newest before the later: where, from all the ticks so far."""
        clock, poll_s = self._clock, self.poll_s
        period_s = clock.period_s
        # The reading is the newest there is, of the latest tick before the poll, or of one that seems to be just after.
        before_s = max(before_s + 0.01 * (t_s - before_s), t_s - period_s)  # Later than any tick before.
        steps = max(floor((t_s - clock.tick_s) / period_s), 1)
        if before_s - (clock.tick_s + steps * period_s) > clock.tick_s + (steps + 1) * period_s - t_s:
            steps += 1
        expected_s = clock.tick_s + steps * period_s
        outside_s = max(before_s - expected_s, expected_s - t_s)
        is_surprise = outside_s > max(0.5 * poll_s, TUNING.uneven * period_s)
        self._surprises = max(self._surprises + is_surprise - TUNING.surprising, 0.0)
        if self._surprises > TUNING.surprises:
            self._begin()
            return t_s
        clock.advance(steps)
        gap_s = t_s - before_s
        off_s = before_s + 0.5 * gap_s - expected_s
        weight = min((poll_s / gap_s) ** 2, 1.0)  # An interval that is longer says less.
        share = weight / min(clock.ticks, TUNING.scatter_memory)
        self._scatter_s2 += share * (min(off_s * off_s, gap_s * gap_s) - self._scatter_s2)
        clock.correct(weight * off_s, steps)
        clock.tick_s = min(max(clock.tick_s, before_s), t_s)
        return clock.tick_s

    # --- whether there is a clock at all -----------------------------------------------------------------------------

    def _is_enough(self, t_s: float) -> bool:
        count = len(self._polls)
        news = count - self._repeats
        few = TUNING.few_runs if count > TUNING.many * news else TUNING.few
        enough = news >= few and self._repeats >= TUNING.few
        return enough or count >= TUNING.longest_look or t_s - self._polls[0][0] > TUNING.look_s

    def _judge(self) -> None:
        polls, repeats = self._polls, self._repeats
        self._looking, self._polls = False, []
        self._rests_until_s = self._t_s + self._rest_s
        self._rest_s = min(2.0 * self._rest_s, TUNING.longest_rest_s)
        self._undecided = False
        readings = len(polls) - repeats
        if repeats < TUNING.few or readings < TUNING.few_runs or self._whole < TUNING.whole * readings:
            return
        t_s = np.array([t for t, _ in polls])
        found = _find_clock(t_s, np.array([new for _, new in polls]))
        if found is None:
            return
        period_s, tick_s, self.poll_s = found
        tick_s += floor((self._t_s - tick_s) / period_s) * period_s
        self._clock.set(period_s, tick_s, min(readings, TUNING.longest))
        self._scatter_s2 = self.poll_s**2 / 12.0
        self.is_slow = True


def _find_clock(t_s: Array, is_new: NDArray[np.bool_]) -> tuple[float, float, float] | None:
    """Period and a tick of a clock that explains which polls (n,) have shown a new reading, and the usual interval of
    the polls; None: there is none.
    """
    gaps = np.diff(t_s)
    new = is_new[1:]
    poll_s = float(np.median(gaps))
    usual = gaps < TUNING.held_up * poll_s
    shown = int(np.sum(new & usual))
    if shown == 0:
        return None
    period_s = float(np.sum(gaps[usual])) / shown
    found = _even(t_s, new, poll_s) if period_s >= TUNING.many * poll_s else _explaining(t_s, new, period_s, poll_s)
    return (float(found[0]), float(found[1]), poll_s) if found is not None else None


def _even(t_s: Array, new: NDArray[np.bool_], poll_s: float) -> tuple[float, float] | None:
    """Period and a tick from readings whose numbers are clear, if they come evenly: the least-squares line."""
    middles_s = (0.5 * (t_s[1:] + t_s[:-1]))[new]
    runs_s = np.diff(middles_s)
    usual_s = float(np.median(runs_s))
    if (
        usual_s < 0.5 * TUNING.many * poll_s
        or np.mean(np.abs(runs_s - usual_s) < TUNING.uneven * usual_s) < TUNING.even_runs
    ):
        return None
    numbers = np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(runs_s / usual_s), 1.0))])
    period_s, first_s = np.polyfit(numbers, middles_s, 1)
    return float(period_s), float(first_s)


def _explaining(t_s: Array, new: NDArray[np.bool_], period_s: float, poll_s: float) -> tuple[float, float] | None:
    """Period and a tick of the clock that explains most, if it explains enough.

    Of new readings and repetitions, those that are fewer tell more. All phases are tried, and all periods that could
    have given as many readings, in steps of a part of what a poll and a tick may be apart.
    """
    share = min(poll_s, period_s - poll_s) / period_s
    if share < TUNING.least_share:
        return None
    count, repeats = int(new.sum()), int((~new).sum())
    telling = np.flatnonzero(new if count <= repeats else ~new)
    before_s, after_s, expected = t_s[telling], t_s[telling + 1], bool(count <= repeats)
    best = (inf, nan, nan)
    for part in (1.0 + np.arange(-1.5, 1.5001, 0.25 * share) / count).tolist():
        candidate_s = period_s * part
        ticks_s = t_s[0] + candidate_s * np.arange(0.0, 1.0, 0.12 * share)[:, None]
        after, before = (np.floor((t - ticks_s) / candidate_s + 1e-9) for t in (after_s, before_s))
        wrong = np.sum((after > before) != expected, axis=1)
        least = float(wrong.min())
        if least < best[0]:
            turns = np.exp(2j * np.pi / candidate_s * (ticks_s[wrong == least] - t_s[0]))
            best = least, candidate_s, t_s[0] + float(np.angle(turns.mean())) / (2.0 * np.pi) * candidate_s
    _, period_s, tick_s = best
    ticked = np.diff(np.floor((t_s - tick_s) / period_s + 1e-9)) > 0.0
    # A new reading that comes a poll late is two polls that are not as expected.
    unexplained = float(np.sum(ticked != new))
    return (period_s, tick_s) if unexplained <= 2.0 * TUNING.unexplained * min(count, repeats) else None
