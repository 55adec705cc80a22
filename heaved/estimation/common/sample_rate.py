"""How often samples come, and how many of them are lost, from their stamps alone.

Nobody tells an estimator the rate; polls come early and late, are held up, and get lost.
"""

from __future__ import annotations

from math import isnan, nan
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """How a rate is found among stamps. Without a source: chosen, and held by the tests over late and lost polls."""

    pairs: float = 0.4
    """Quantile of the length of two intervals together to begin with: below the median, for polls get lost and none are
    added."""
    span: int = 3
    """Intervals whose steps are counted together."""
    rounds: int = 5
    """Most divisions of time by steps."""
    hidden: float = 0.1
    """Median deviation of the intervals, relative, from which jitter hides how many steps they are."""
    long: float = 0.02
    """Share of intervals longer than two in the mean from which stamps are missing."""
    grid: tuple[float, float] = (0.6, 1.3)
    """Rates that stamps are held against: from so much of their own mean one to so much of the counted one,"""
    finest: float = 10.0
    """or to so much of the mean one, if that is less."""
    bins: float = 8.0
    """In the shortest interval: what is counted into them loses 3 % of its phase."""
    on_grid: float = 0.35
    """Length of the mean of the stamps' phases, at the right rate, from which they are on a grid: 1 without jitter, 0
    where it hides the rate. At any wrong rate that of N stamps stays below..."""
    by_chance: float = 4.0
    """...so much over the root of N, at all rates that are looked at."""
    other: float = 1.5
    """Stamps on a grid are on one of twice the rate, too, and late ones may be so even more: rates further apart than
    this are other grids."""
    on_time: float = 0.25
    """Stamps that are so near to the grid, in intervals, tell the interval exactly."""
    surely: float = 2.5
    """Over the root of N: the agreement of N stamps with a given grid that is no chance."""
    singles: float = 0.25
    """Share of the intervals that are single ones, at least, on a grid that still is the right one."""
    sparse: float = 1.5
    """Intervals between stamps that are whole multiples of one, this many times it in the mean or more, are those of a
    line that loses most polls: of their own mean there is nothing to be learned."""
    shortest: float = 0.1
    """Quantile of the intervals that is held to be that one;"""
    mostly: float = 0.95
    """this share of them are multiples,"""
    nearly: float = 0.1
    """by so much of it."""
    at_least: int = 10
    """Intervals that show it."""
    singles_most: float = 2.5
    """Share of single ones, over that of polls that are lost by chance: where samples come in bursts it is larger."""
    many: int = 150
    """So many stamps that are on no grid are counted as they are."""
    first: int = 12
    """Stamps of arrivals that are looked at together, at least,"""
    window_s: float = 2.0
    """and so much time."""
    memory_s: float = 60.0
    """Of the share of lost samples."""
    outage_s: float = 20.0
    """Without any for so long there were none to be lost: once it is over, it says nothing of the line."""
    whole: float = 0.1
    """Intervals are whole numbers of the usual one when that is, in the mean, how far off they are."""


TUNING: Final = Tuning()


def usual_interval(stamps_s: Array) -> float:
    """Interval at which increasing stamps (n,), n > 3, are meant to come, whatever befell some of them.

    On a busy line or machine a third of the polls come late, by part of an interval or by some, and those after them
    are late as well, or skipped: the intervals say little. But the polls that are on time lie on a grid. So the rate is
    the one at which the phases of the stamps agree (the periodogram of a point process, Bartlett 1963). Where jitter of
    half an interval hides it, lateness still cancels in the sum of neighbours: see :func:`_counted_interval`.
    """
    sparse_s = _sparse_interval(np.diff(stamps_s))
    if not isnan(sparse_s):
        return sparse_s
    counted_s = _counted_interval(stamps_s)
    interval_s = _grid_interval(stamps_s, counted_s)
    if not isnan(interval_s):
        return interval_s
    return counted_s if len(stamps_s) < TUNING.many else float(stamps_s[-1] - stamps_s[0]) / (len(stamps_s) - 1)


def are_still_apart(stamps_s: Array, interval_s: float) -> bool:
    """Whether stamps (n,) lie on a grid of this interval, and some of them a single interval apart: where all have
    others between them it is another sensor, where some have, polls are late or lost.
    """
    agreement = abs(np.exp(2j * np.pi * stamps_s / interval_s).mean())
    singles = np.abs(np.diff(stamps_s) / interval_s - 1.0) < TUNING.on_time
    return bool(agreement > TUNING.surely / len(stamps_s) ** 0.5 and np.mean(singles) > TUNING.singles)


def are_on_grid(stamps_s: Array, interval_s: float) -> bool:
    """Whether stamps (n,) lie on a grid of this interval, which was found among them, and not by chance."""
    agreement = abs(np.exp(2j * np.pi * stamps_s / interval_s).mean())
    return bool(agreement >= _least_agreement(len(stamps_s)))


def _least_agreement(count: int) -> float:
    return float(max(TUNING.on_grid, TUNING.by_chance / count**0.5))


def _sparse_interval(gaps_s: Array) -> float:
    """That of which intervals (n,) are whole multiples, where most stamps are missing; nan: they are not."""
    if len(gaps_s) < TUNING.at_least:
        return nan
    steps = np.rint(gaps_s / max(float(np.quantile(gaps_s, TUNING.shortest)), 1e-9))
    if not (steps.min() >= 1.0 and steps.mean() >= TUNING.sparse):
        return nan
    if np.mean(steps == 1.0) * steps.mean() > TUNING.singles_most:
        return nan
    interval_s = float(gaps_s.sum() / steps.sum())
    near = np.abs(gaps_s / interval_s - steps) < TUNING.nearly
    return interval_s if near.mean() >= TUNING.mostly else nan


def _grid_interval(stamps_s: Array, counted_s: float) -> float:
    """That of the coarsest grid on which stamps lie; nan: on none."""
    since_s = stamps_s - stamps_s[0]
    span_s = float(since_s[-1])
    mean_hz = (len(since_s) - 1) / span_s
    most_hz = min(TUNING.grid[1] / counted_s, TUNING.finest * mean_hz)
    bins = np.bincount((TUNING.bins * most_hz * since_s).astype(np.intp))
    rates_hz = np.fft.rfftfreq(4 * len(bins), 1.0 / (TUNING.bins * most_hz))
    length = np.abs(np.fft.rfft(bins, 4 * len(bins))) / len(since_s)
    looked_at = (rates_hz >= TUNING.grid[0] * mean_hz) & (rates_hz <= most_hz)
    on_grid = looked_at & (length >= _least_agreement(len(since_s)))
    if not on_grid.any():
        return nan
    coarsest_hz = rates_hz[int(np.argmax(on_grid))]
    best_hz = rates_hz[int(np.argmax(np.where(on_grid & (rates_hz < TUNING.other * coarsest_hz), length, 0.0)))]
    near_hz = best_hz + np.linspace(-0.25, 0.25, 11) / span_s
    phasors = np.exp(2j * np.pi * np.multiply.outer(near_hz, since_s)).sum(axis=1)
    best = int(np.argmax(np.abs(phasors)))
    place = since_s * near_hz[best] - float(np.angle(phasors[best])) / (2.0 * np.pi)
    steps = np.rint(place)
    on_time = np.abs(place - steps) < TUNING.on_time
    return float(np.polyfit(steps[on_time], since_s[on_time], 1)[0])


def _counted_interval(stamps_s: Array) -> float:
    """The same from how many steps there are in spans of three intervals, rounded to whole ones.

    Time is divided by steps, as often as it takes to agree with itself; a lost poll shows in every sum across it.
    Jitter of half an interval makes anything agree with itself; then, if none are missing, the stamps themselves are
    counted.
    """
    pairs = stamps_s[2:] - stamps_s[:-2]
    interval_s = 0.5 * float(np.quantile(pairs, TUNING.pairs))
    spans = stamps_s[TUNING.span :] - stamps_s[: -TUNING.span]
    total_s = float(spans.sum())
    for _ in range(TUNING.rounds):
        steps = float(np.rint(spans / interval_s).sum())
        if steps <= 0.0 or total_s / steps == interval_s:
            break
        interval_s = total_s / steps
    gaps = np.diff(stamps_s)
    mean_s = float(gaps.mean())
    if (
        float(np.median(np.abs(gaps - interval_s))) > TUNING.hidden * interval_s
        and np.mean(gaps > 2.0 * mean_s) < TUNING.long
    ):
        return mean_s
    return interval_s


class Clock:
    """Phase and period of a clock whose ticks are seen one after the other: a least-squares line through the latest.

    In a line through n points the newest moves the place by 2 (2 n - 1) / (n (n + 1)) of how far it is off, and the
    slope by 6 / (n (n + 1)) of that for each step since the point before.

    Attributes:
        period_s: nan until it is set.
        tick_s: the latest tick.
        ticks: n.
    """

    def __init__(self, longest: int) -> None:
        """``longest``: most ticks that count; drifts over that time are followed."""
        self._longest = longest
        self.set(nan, nan, 1)

    def set(self, period_s: float, tick_s: float, ticks: int) -> None:
        """Begin with what ``ticks`` ticks have shown otherwise."""
        self.period_s, self.tick_s, self.ticks = period_s, tick_s, ticks

    def advance(self, steps: int) -> None:
        """Go on to another tick, so many periods later, that has been seen."""
        self.tick_s += steps * self.period_s
        self.ticks = min(self.ticks + 1, self._longest)

    def correct(self, off_s: float, steps: int = 1) -> None:
        """The latest tick, ``steps`` after the one before, was seen so much later than where it was expected."""
        share = 2.0 * off_s / (self.ticks * (self.ticks + 1.0))
        self.tick_s += (2.0 * self.ticks - 1.0) * share
        self.period_s += 3.0 * share / steps


class Arrivals:
    """Feed it stamps in order of time.

    Attributes:
        period_s: usual interval; nan: not known yet.
        missing: share of the samples that were lost in the last minute.
    """

    def __init__(self) -> None:
        self.period_s = nan
        self.missing = 0.0
        self._stamps: list[float] = []

    def step(self, t_s: float) -> None:
        """A sample at ``t_s``, later than the last one."""
        stamps = self._stamps
        if stamps and t_s - stamps[-1] > TUNING.outage_s:
            stamps.clear()
        stamps.append(t_s)
        if t_s - stamps[0] >= TUNING.window_s and len(stamps) >= TUNING.first:
            self._judge(np.array(stamps))
            self._stamps = [t_s]

    def _judge(self, stamps_s: Array) -> None:
        gaps, seconds = np.diff(stamps_s), float(stamps_s[-1] - stamps_s[0])
        if not self._still_holds(gaps):
            self.period_s = usual_interval(stamps_s)
        lost = max(1.0 - len(gaps) * self.period_s / seconds, 0.0)
        self.missing += min(seconds / TUNING.memory_s, 1.0) * (lost - self.missing)

    def _still_holds(self, gaps: Array) -> bool:
        """What is lost must not become what is usual: whether the intervals are the usual one so far, and gaps. With
        no interval among them that is the usual one itself it is a slower sensor.
        """
        steps = gaps / self.period_s
        whole = np.rint(steps)
        return bool(np.mean(np.abs(steps - whole)) < TUNING.whole and np.any(whole == 1.0))
