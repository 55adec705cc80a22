"""The first samples of a stream, kept until they have shown at which rate samples, and readings, come.

Nobody tells the predictor the rate, and everything that it is made of has a length in samples. Two seconds of stamps
show it mostly; where many of them were late it may be some percent off, so they are looked at twice more. Samples may
come in bursts, and readings seldomer than samples: those are then a stream of their own rate.
"""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING, Final, NamedTuple

import msgspec
import numpy as np

from heaved.estimation.common.sample_rate import are_still_apart, usual_interval
from heaved.estimation.rock import sample_clock
from heaved.estimation.rock.sample_clock import SampleClock

if TYPE_CHECKING:
    from collections.abc import Sequence


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What this file is set to."""

    first: int = 11
    """Stamps before the interval is known,"""
    first_s: float = 2.0
    """and so much time: the polls of a start are held up by 20-50 ms now and then, and jitter has to average out.
    Nothing is lost, for nothing is published before 2 s are there."""
    looked_at_s: tuple[float, ...] = (3.5, 6.0)
    """So long after the first sample the stamps are looked at once more: what 2 s of late ones have shown may be some
    percent off;"""
    looked: int = 256
    """the last so many of them."""
    same_s: float = 1e-4
    """Samples closer together are one; where they come in bursts, those closer than the shortest interval."""
    bursts: float = 0.7
    """Share of the samples that are farther apart than that, below which they come in bursts."""
    wait_s: float = 8.0
    """For so long readings are waited for to show their rate: a sensor of 1.4 Hz does."""
    slower: float = 1.5
    """Intervals of samples to one of readings, at least, that make them a stream of their own,"""
    regular: float = 0.7
    """and share of their intervals that are the usual one,"""
    usual: float = 0.2
    """within so much of it."""


TUNING: Final = Tuning()


class Sample(NamedTuple):
    """One of all channels."""

    t_s: float
    values: Sequence[float]
    """nan: not known."""
    rates: Sequence[float]

    @property
    def is_reading(self) -> bool:
        """Whether any value of it is known."""
        return any(value == value for value in self.values)


class FirstSamples:
    """Push it samples in order of time while it :attr:`wants` them.

    Attributes:
        samples: so far; none any more after the last look at them.
        same_s: samples closer together are one.
        is_sparse: readings come at their own rate: samples without any are not taken.
    """

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.same_s = TUNING.same_s
        self.is_sparse = False
        self._looks = list(TUNING.looked_at_s)
        """When they are to be looked at again, after the first."""

    @property
    def stamps_s(self) -> list[float]:
        """Of the samples."""
        return [sample.t_s for sample in self.samples]

    def find_clock(self) -> SampleClock | None:
        """The grid that the samples are on, once they show it; None: not yet."""
        first, least_s = self.samples, sample_clock.TUNING.least_s
        if len(first) < TUNING.first or first[-1].t_s - first[0].t_s < TUNING.first_s:
            return None
        stamps_s = self.stamps_s
        apart = np.diff(stamps_s, prepend=-np.inf) >= least_s
        if np.mean(apart) < TUNING.bursts and self.same_s < least_s:
            self.same_s = least_s
            self.samples = [one for one, is_apart in zip(first, apart.tolist(), strict=True) if is_apart]
            return self.find_clock()
        readings = [one for one in first if one.is_reading]
        if len(readings) < len(first):
            if len(readings) < TUNING.first and first[-1].t_s - first[0].t_s < TUNING.wait_s:
                return None
            interval_s = max(usual_interval(np.array(stamps_s)), least_s)
            if _own_interval([one.t_s for one in readings]) > TUNING.slower * interval_s:
                self.is_sparse = True
                self.samples = readings
        return SampleClock(self.stamps_s)

    def is_look_due(self, clock: SampleClock) -> bool:
        """Whether it is time to look at the samples again, that were on the grid of ``clock``."""
        first = self.samples
        return bool(first) and (clock.is_other or first[-1].t_s - first[0].t_s >= self._looks[0])

    def look_again(self, clock: SampleClock) -> SampleClock:
        """The grid of all the samples so far, which more of them may show to be another."""
        stamps_s = np.array(self.stamps_s[-TUNING.looked :])
        known_s = nan
        if clock.is_other:
            recent = int(np.count_nonzero(stamps_s >= stamps_s[-1] - sample_clock.TUNING.judged_s))
            stamps_s = stamps_s[-max(recent, TUNING.first) :]
        elif are_still_apart(stamps_s - stamps_s[0], clock.interval_s):
            known_s = clock.interval_s
        return SampleClock(stamps_s.tolist(), known_s)

    def looked(self) -> None:
        """What the look has shown has been taken up: on to the next, or to the end."""
        first = self.samples
        while self._looks and first[-1].t_s - first[0].t_s >= self._looks[0]:
            del self._looks[0]
        if not self._looks:
            first.clear()


def _own_interval(stamps_s: Sequence[float]) -> float:
    """Of readings that come regularly; nan: they do not."""
    if len(stamps_s) < TUNING.first:
        return nan
    stamps = np.array(stamps_s)
    interval_s = usual_interval(stamps)
    usual = np.abs(np.diff(stamps) - interval_s) < TUNING.usual * interval_s
    return interval_s if np.mean(usual) >= TUNING.regular else nan
