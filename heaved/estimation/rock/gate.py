"""What of one channel goes into the direct predictor's lags: spikes, gaps, level steps, stuck readings, manoeuvres.

The prediction one step ahead is the yardstick. A sample that stands out of it by six of its errors is held back and the
prediction put in its place. If half a second of samples in a row stands out, it is no spike: a step of the level if all
stand off by the same (the level moves, the past with it), a stuck sensor if all are the same (as good as missing), else
the motion itself, which then goes into the lags after all.
"""

from __future__ import annotations

from bisect import insort
from math import inf, isfinite, nan, sqrt
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What this file is set to."""

    mean_memory_s: float = 120.0
    """Of the slow mean (list, trim, heading) and the variance about it."""
    step_error_memory_s: float = 30.0
    gate: float = 6.0
    """One-step errors beyond so many of their RMS are held back."""
    quanta: float = 3.0
    """Steps of a coarse register that never are."""
    first_s: float = 5.0
    first: int = 20
    """One-step errors, for so long and so many, by whose median it is first known how large they are: a spike among
    them does not matter."""
    deviation: float = 1.4826
    """Standard deviation over median magnitude, of a Gaussian."""
    widened: float = 2.0
    """The gate after each half second of motion that it had held back wrongly."""
    judged_s: float = 0.5
    """So long a run of held-back samples is no spike."""
    agreed: float = 0.3
    """Deviations that scatter by less than this share of their median are a step."""
    manoeuvre: float = 8.0
    """Deviations from the slow mean beyond so many standard deviations are no wave motion."""
    manoeuvre_mean_s: float = 10.0
    manoeuvre_lasts_s: float = 60.0
    """After which it is the new sea."""
    farthest: float = 6.0
    """No more standard deviations from the mean is the motion going to be,"""
    farther: float = 3.0
    """unless so many times as far away as it is now: a regression that sees what it has not learned from, as a list
    that has just come about, may say anything."""


TUNING: Final = Tuning()


class Timing(msgspec.Struct, frozen=True, kw_only=True):
    """Lengths of time in samples."""

    interval_s: float
    settling: int
    """Until the shortest memory, that of the extrapolation, holds nothing but the motion."""
    longest_gap: int
    judged: int


class Channel:
    """One channel; values are relative to ``level``."""

    def __init__(self, timing: Timing, gap_weights: Array) -> None:
        """``gap_weights`` (steps, H + 1): of a predicted curve, for the value 1, 2, ... samples on."""
        self._timing = timing
        self._armed = max(TUNING.first_s / timing.interval_s, TUNING.first)
        self._step_share = timing.interval_s / TUNING.step_error_memory_s
        self._mean_memory = TUNING.mean_memory_s / timing.interval_s
        self._gate_square, self._manoeuvre_square = TUNING.gate**2, TUNING.manoeuvre**2
        self._first: list[float] = []
        """Magnitudes of the first one-step errors, in ascending order."""
        self._gap_weights = gap_weights
        self._anchor = np.zeros(gap_weights.shape[1])
        self.level = 0.0
        self.since = 0
        """Samples since it began, or began anew after a long gap; 0: there is nothing."""
        self.calm = 0
        """Samples since a manoeuvre, or other motion that should not be learned from."""
        self.unsettled = 0
        """Samples until predictions are worth scoring again."""
        self.mean = 0.0
        """Slow mean."""
        self.step_square = 0.0
        """Mean square of the one-step errors."""
        self.quantum = inf
        """Least change between readings: the step of the register, where it is coarse."""
        self.spikes = self.level_steps = 0
        self._reading = nan
        self._repeats = 0
        self._frozen = False
        self._absent = 0
        self._held: list[tuple[float, float]] = []
        self._step_count = 0
        self._mean_count = 0.0
        self._square = 0.0
        self._manoeuvre = 0
        self._steady = False
        """Nothing is held back, missing or young, and there is no manoeuvre."""

    @property
    def ready(self) -> bool:
        """Whether there has been enough of the channel to predict from."""
        return self.since >= self._timing.settling

    def reach(self, x: float) -> float:
        """How far from the mean the motion may be soon, from where it is now."""
        if self._mean_count * self._timing.interval_s < TUNING.manoeuvre_mean_s:
            return inf
        return max(TUNING.farthest * sqrt(self._square), TUNING.farther * abs(x - self.mean))

    @property
    def spread(self) -> float:
        """Standard deviation about the slow mean."""
        return sqrt(self._square)

    @property
    def absent(self) -> int:
        """Samples on end that there were none of."""
        return self._absent

    def last_curve(self, at_s: Array) -> Array:
        """The curve of the last sample that there was, seen from now, at times from now on."""
        steps = self._absent + at_s / self._timing.interval_s - 1.0
        low = np.minimum(steps.astype(np.intp), len(self._gap_weights) - 2)
        curve = self._gap_weights @ self._anchor
        values: Array = curve[low] + np.minimum(steps - low, 1.0) * (curve[low + 1] - curve[low])
        return values

    @property
    def noise_square(self) -> float:
        """What stands for the variance of the sensor's noise."""
        return max(self.step_square, self.quantum**2 if self.quantum < inf else 0.0)

    def step(self, value: float, late_s: float, curve: Array, one_step: float, slope: float) -> tuple[float, bool]:
        """What goes into the lags, and whether it was measured.

        ``late_s``: how long after its grid time the sample was read; ``curve`` (H + 1,): the value before it and what
        was predicted from there; ``one_step``, ``slope``: the value expected and how it changes. After the first sample
        ``since`` is 1.
        """
        change = abs(value - self._reading)
        if self._steady and change >= self.quantum:
            # As below, where nothing of it can come otherwise.
            x = value - self.level - slope * late_s
            error, deviation = x - one_step, x - self.mean
            error_square, square = error * error, deviation * deviation
            if error_square <= self._gate_square * self.step_square and square <= self._manoeuvre_square * self._square:
                self._reading = value
                self._repeats = 0
                self.since += 1
                self.calm += 1
                self.step_square += self._step_share * (error_square - self.step_square)
                self.mean += deviation / self._mean_memory
                self._square += (square - self._square) / self._mean_memory
                return x, True
        self._steady = False
        self._repeats = self._repeats + 1 if change == 0.0 else 0
        if 0.0 < change < self.quantum:
            self.quantum = change
        self._reading = value
        if self._frozen and change == 0.0:
            value = nan
        else:
            self._frozen = False
        if self.since == 0:
            if not isfinite(value):
                return 0.0, False
            one_step = self._begin(value)
            slope = 0.0
        self.since += 1
        self.calm += 1
        absent = self._absent
        if absent:
            one_step = float(self._gap_weights[min(absent, len(self._gap_weights) - 1)] @ self._anchor)
        if isfinite(value):
            x = value - self.level - slope * late_s
            if self._passes(x, one_step, absent):
                return x, True
            self._held.append((x, one_step))
        elif self._held:
            self._held.append((nan, one_step))
        if not absent:
            self._anchor[:] = curve
        self._absent = absent + 1
        if absent >= self._timing.longest_gap and not self._held:
            self.since = 0
        return one_step, False

    def lose(self) -> None:
        """After a gap too long to fill: the past is gone, what was learned from it stays."""
        self.since = 0
        self._steady = False

    def step_judged(self, x: float, *, measured: bool) -> bool:
        """As :meth:`step`, where a filter for holes has judged the sample; False: too much is missing for it.

        Nothing is scored, nor learned from, before the extrapolation has seen nothing but samples again.
        """
        self._steady = False
        self._held.clear()
        self._reading, self._repeats = nan, 0
        if not self.since:
            return False
        self.since += 1
        self.calm += 1
        self.unsettled = self._timing.settling
        self._absent = 0 if measured else self._absent + 1
        if measured:
            self._follow(x)
        elif self._absent > self._timing.longest_gap:
            self.since = 0
        return self.since > 0

    def forget(self) -> None:
        """What is read is not what is followed: the past is gone, and so are level and mean."""
        self.lose()
        self.mean = self._mean_count = self._square = 0.0

    def judge(self) -> Array | None:
        """Once samples have been held back for long enough: what should replace the latest of them (nan: nothing)."""
        if len(self._held) < self._timing.judged:
            return None
        measured, filled = np.array(self._held).T
        self._held.clear()
        off = measured - filled
        off = off[np.isfinite(off)]
        step = float(np.median(off))
        if float(np.max(np.abs(off - step))) < TUNING.agreed * abs(step):
            self.level += step
            self.level_steps += 1
            measured = measured - step
        elif self._stuck():
            self._frozen = True  # as good as missing until the reading changes
            return None
        else:
            self.step_square *= TUNING.widened**2
            self.calm = 0
            self.unsettled = self._timing.settling
        self._absent = 0
        return np.asarray(measured, dtype=np.float64)

    def _begin(self, value: float) -> float:
        if self._mean_count == 0.0:
            self.level = value
        self.calm = self._absent = 0
        self.unsettled = self._timing.settling
        self._held.clear()
        return value - self.level

    def _stuck(self) -> bool:
        """The same reading over and over from an axis that has moved. (Whether roll or pitch hang has been told before,
        :mod:`heaved.unchanged`: of readings that are held back, yaw's among them, it is asked here what they are.)
        """
        return self._repeats >= self._timing.judged - 1 and self._square > 9.0 * min(self.quantum, 1.0) ** 2

    def _passes(self, x: float, expected: float, absent: int) -> bool:
        """The gate; a sample that passes is learned from."""
        error = x - expected
        count = self._step_count
        settled = self.since > self._timing.settling  # before, the prediction knows little of the motion
        if settled and count > self._armed:
            limit = TUNING.gate * sqrt(self.step_square)
            if self.quantum < inf:
                limit = max(limit, TUNING.quanta * self.quantum)
            if abs(error) > limit * (1 + absent) > 0.0:
                return False
        if self._held:
            self.spikes += len(self._held)
            self._held.clear()
        self._absent = 0
        if settled and not absent:
            self._learn_step(error)
        self._follow(x)
        is_old = self._mean_count >= self._mean_memory and self._step_count * self._step_share > 2.0
        self._steady = settled and is_old and not self._manoeuvre
        return True

    def _learn_step(self, error: float) -> None:
        """Of the first errors the median counts, of all later ones, which have passed the gate, the square."""
        self._step_count += 1
        if self._step_count > self._armed:
            self.step_square += self._step_share * (error * error - self.step_square)
        else:
            insort(self._first, abs(error))
            self.step_square = (TUNING.deviation * self._first[len(self._first) // 2]) ** 2

    def _follow(self, x: float) -> None:
        """Slow mean and variance; a manoeuvre is motion far outside of them."""
        memory = self._mean_memory
        deviation = x - self.mean
        square = deviation * deviation
        count = self._mean_count
        if count > 0.5 * memory and square > self._manoeuvre_square * self._square > 0.0:
            interval_s = self._timing.interval_s
            self._manoeuvre += 1
            if self._manoeuvre < TUNING.manoeuvre_lasts_s / interval_s:
                self.calm = 0
                self.mean += deviation * interval_s / TUNING.manoeuvre_mean_s
                return
            self._manoeuvre = 0
            count = TUNING.manoeuvre_mean_s / interval_s
        elif self._manoeuvre:
            self._manoeuvre -= 1
        self._mean_count = count = min(count + 1.0, memory)
        self.mean += deviation / count
        self._square += (square - self._square) / count
