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

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEW: Final = 24
"""New readings, and repetitions, that are looked at together, at least;"""
FEW_RUNS: Final = 12
"""so few new ones do where each is followed by several repetitions."""
MANY: Final = 4.0
"""Polls per reading from which that is so, and the number of a reading is clear from its time."""
ALL_NEW: Final = 50
"""Readings without a repetition after which the sensor keeps up with its polls: later ones are something else."""
LOOK_S: Final = 30.0
"""Whatever has been found in so long a time is all there is."""
LONGEST_LOOK: Final = 3000
"""Likewise in so many polls."""
REST_S: Final = 20.0
"""Repetitions that no clock explains are not looked at again before, and then twice that, up to LONGEST_REST_S."""
LONGEST_REST_S: Final = 600.0
UNEXPLAINED: Final = 0.3
"""Share of the repetitions (or new readings, whichever are fewer) that a clock may fail to explain: devices are held
up, too. Of repetitions by chance it fails to explain half and more."""
LEAST_SHARE: Final = 0.045
"""Of repetitions, or of new readings, for which a clock is sought among all there can be."""
UNEVEN: Final = 0.3
"""Runs of repetitions are even whose lengths are off the usual one by less than this share of it,"""
EVEN_RUNS: Final = 0.8
"""so many of them. Of runs by chance, a fifth is."""
WHOLE: Final = 0.4
"""Of the new readings so many are new in all channels: coarse registers of a smooth motion change evenly, too, but one
after the other."""
HELD_UP: Final = 1.5
"""A poll later than so many median intervals may have missed readings."""
LONGEST: Final = 60
"""Readings by which phase and period are known: the quartzes of device and poller drift by some ppm in that time."""
SURPRISES: Final = 8.0
"""New readings that no tick explains, in excess of a tenth of all, after which the clock is another."""
LOST_TICKS: Final = 4.0
"""Without a new reading for so many periods the sensor hangs."""


class MeasuredRate:
    """Feed it every poll of some channels that are measured together.

    Attributes:
        period_s: of the device's own measurements where it is slower than the polls; nan: each poll is a reading.
        poll_s: usual interval of the polls at which that was found.
    """

    def __init__(self) -> None:
        self._begin()

    def _begin(self) -> None:
        self.period_s = self.poll_s = nan
        self._t_s = nan
        self._undecided = True
        """Nothing has been judged yet: repetitions are not taken for readings until it has."""
        self._looking, self._rests_until_s, self._rest_s = False, -inf, REST_S
        self._polls: list[tuple[float, bool]] = []
        self._repeats = self._new = self._whole = 0
        self._tick_s = nan
        self._known = 1.0
        self._scatter_s2 = 0.0
        self._surprises = 0.0

    def take(self, t_s: float, is_new: bool, is_whole: bool = True) -> float:
        """Time at which the reading of the poll at ``t_s`` was measured; nan where it is no new one.

        ``is_new``: it differs from the one before; a first reading does. ``is_whole``: in all its channels.
        """
        before_s, self._t_s = self._t_s, t_s
        if self.period_s == self.period_s:
            if is_new:
                return self._measured(before_s, t_s)
            overdue_s = t_s - self._tick_s - self.period_s
            if 0.0 < overdue_s <= t_s - before_s:  # The first poll without a reading that was expected.
                n = self._known
                self._tick_s += overdue_s * _gain(n)
                self.period_s += overdue_s * 6.0 / (n * (n + 1.0))
            return nan
        if self._looking:
            self._polls.append((t_s, is_new))
            self._repeats += not is_new
            self._whole += is_new and is_whole
            if self._is_enough(t_s):
                self._judge()
        elif is_new:
            self._new += 1
            if self._new == ALL_NEW:
                self._undecided = False
        elif t_s >= self._rests_until_s:
            self._looking, self._polls, self._repeats = True, [(before_s, True), (t_s, False)], 1
            self._whole = 0
        return t_s if is_new or not self._undecided else nan

    @property
    def hangs(self) -> bool:
        """The sensor's clock has stood still for several of its periods."""
        return self._t_s - self._tick_s > LOST_TICKS * self.period_s

    @property
    def uncertainty_s(self) -> float:
        """Standard deviation of the times that are given: what the ticks' intervals do not tell of the phase.

        A tick lies anywhere between two polls, a variance of a twelfth of their square: it shows as scatter about the
        clock, and averages out, unless the two clocks run locked.
        """
        if self.period_s != self.period_s:
            return 0.0
        whole = self.poll_s**2 / 12.0
        return sqrt(max(whole - self._scatter_s2, 0.0) + 4.0 * whole / self._known)

    # --- the phase ---------------------------------------------------------------------------------------------------

    def _measured(self, before_s: float, t_s: float) -> float:
        """A tick lies between two polls, the newest before the later: where, from all the ticks so far."""
        period_s, poll_s = self.period_s, self.poll_s
        # The reading is the newest there is, of the latest tick before the poll, or of one that seems to be just after.
        before_s = max(before_s + 0.01 * (t_s - before_s), t_s - period_s)  # Later than any tick before.
        steps = max(floor((t_s - self._tick_s) / period_s), 1)
        if before_s - (self._tick_s + steps * period_s) > self._tick_s + (steps + 1) * period_s - t_s:
            steps += 1
        expected_s = self._tick_s + steps * period_s
        is_surprise = max(before_s - expected_s, expected_s - t_s) > max(0.5 * poll_s, UNEVEN * period_s)
        self._surprises = max(self._surprises + (0.9 if is_surprise else -0.1), 0.0)
        if self._surprises > SURPRISES:
            self._begin()
            return t_s
        gap_s = t_s - before_s
        off_s = before_s + 0.5 * gap_s - expected_s
        n = self._known = min(self._known + 1.0, LONGEST)
        # Gains of a least-squares line through n points, less for an interval that says less.
        weight = min((poll_s / gap_s) ** 2, 1.0)
        self._scatter_s2 += weight * (min(off_s * off_s, gap_s * gap_s) - self._scatter_s2) / min(n, 30.0)
        self._tick_s = min(max(expected_s + weight * off_s * _gain(n), before_s), t_s)
        self.period_s += weight * off_s * 6.0 / (n * (n + 1.0)) / steps
        return self._tick_s

    # --- whether there is a clock at all -----------------------------------------------------------------------------

    def _is_enough(self, t_s: float) -> bool:
        count = len(self._polls)
        news = count - self._repeats
        few = FEW_RUNS if count > MANY * news else FEW
        enough = news >= few and self._repeats >= FEW
        return enough or count >= LONGEST_LOOK or t_s - self._polls[0][0] > LOOK_S

    def _judge(self) -> None:
        polls, repeats = self._polls, self._repeats
        self._looking, self._polls = False, []
        self._rests_until_s = self._t_s + self._rest_s
        self._rest_s = min(2.0 * self._rest_s, LONGEST_REST_S)
        self._undecided = False
        readings = len(polls) - repeats
        if repeats < FEW or readings < FEW_RUNS or self._whole < WHOLE * readings:
            return
        t_s = np.array([t for t, _ in polls])
        found = _clock(t_s, np.array([new for _, new in polls]))
        if found is None:
            return
        self.period_s, tick_s, self.poll_s = found
        self._tick_s = tick_s + floor((self._t_s - tick_s) / self.period_s) * self.period_s
        self._scatter_s2 = self.poll_s**2 / 12.0
        self._known = min(float(readings), LONGEST)


def _gain(n: float) -> float:
    """Of the position, in a least-squares line through n points, each newer one weighed in as it comes."""
    return 2.0 * (2.0 * n - 1.0) / (n * (n + 1.0))


def _clock(t_s: Array, is_new: NDArray[np.bool_]) -> tuple[float, float, float] | None:
    """Period and a tick of a clock that explains which polls (n,) have shown a new reading, and the usual interval of
    the polls; None: there is none."""
    gaps = np.diff(t_s)
    new = is_new[1:]
    poll_s = float(np.median(gaps))
    usual = gaps < HELD_UP * poll_s
    shown = int(np.sum(new & usual))
    if shown == 0:
        return None
    period_s = float(np.sum(gaps[usual])) / shown
    found = _even(t_s, new, poll_s) if period_s >= MANY * poll_s else _explaining(t_s, new, period_s, poll_s)
    return (float(found[0]), float(found[1]), poll_s) if found is not None else None


def _even(t_s: Array, new: NDArray[np.bool_], poll_s: float) -> tuple[float, float] | None:
    """Period and a tick from readings whose numbers are clear, if they come evenly: the least-squares line."""
    middles_s = (0.5 * (t_s[1:] + t_s[:-1]))[new]
    runs_s = np.diff(middles_s)
    usual_s = float(np.median(runs_s))
    if usual_s < 0.5 * MANY * poll_s or np.mean(np.abs(runs_s - usual_s) < UNEVEN * usual_s) < EVEN_RUNS:
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
    if share < LEAST_SHARE:
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
    return (period_s, tick_s) if unexplained <= 2.0 * UNEXPLAINED * min(count, repeats) else None
