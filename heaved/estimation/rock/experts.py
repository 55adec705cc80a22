"""Which of several predictors to believe, per horizon and channel, and how far: realised errors decide both.

Each expert's mean square error is averaged exponentially; the least one is published. Its root times an adaptive
quantile is the half-width of the 95 % interval: the quantile takes a small step up after a miss and a nineteenth of it
down after a hit (Gibbs and Candes 2021, adaptive conformal inference), so coverage holds whatever the distribution.
"""

from __future__ import annotations

from math import isfinite
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What this file is set to."""

    miss_share: float = 0.05
    """Of the interval."""
    quantile_step: float = 0.002
    """Per scored prediction (Gibbs and Candes 2021: the step size gamma, small for a stream without end)."""
    quantile_range: tuple[float, float] = (1.0, 5.0)
    gaussian_quantile: float = 1.96
    memory_s: float = 30.0
    per_horizon: float = 4.0
    """Memory of the errors: so many horizons more, as errors closer together than one are hardly different ones."""
    longer: float = 3.0
    """So many times that memory: what is small lately may be so by chance, and mostly is."""
    sure: float = 1.2
    """Deviations of the motion's part of what errors have been for so long, that are published: of Gaussian ones of
    known size, one in 16 000 is beyond four of them, which is one in every record of ten minutes; beyond 4.8, one in
    600 000."""
    report_memory_s: float = 300.0
    """Of the error and coverage that are reported."""
    early: float = 2.0
    """While young the mean square is that of the last half or so: what the start cost fades as 1/t^2."""
    enough_s: float = 1.0
    """Errors of an expert known for so long before it may be chosen by them."""
    apart_s: float = 0.2
    """Errors are different ones when they lie further apart than their horizon and so much."""
    few: float = 2.0
    """Of N different errors the mean square of those to come is expected to be 1 + few / N times theirs, on average;"""
    rare: float = 12.5
    rare_power: float = 1.5
    """and 4 deviations are exceeded once in ten thousand, as they are by Gaussian errors of known size, with a mean
    square 1 + (rare / N)^rare_power times theirs: Student's t with N degrees of freedom, within some percent from N = 5
    on."""
    better: float = 0.97
    """Mean square below that of the expert in office before it is replaced."""


TUNING: Final = Tuning()


class Switch:
    """For H horizons, E experts, n channels; what is published is (H, n). Errors not known are nan."""

    def __init__(self, horizons_s: Array, experts: int, channels: int, first: NDArray[np.intp]) -> None:
        """``first`` (H,): the expert in office while no error of an available one is known."""
        count = len(horizons_s)
        self.experts = experts
        # Last what was published, of which nothing is hastened and which is reported over another time.
        memory_s = TUNING.memory_s + TUNING.per_horizon * horizons_s
        self._memory_s = np.repeat(memory_s[:, None, None], experts + 1, axis=1)
        self._memory_s[:, -1] = TUNING.report_memory_s
        self._apart_s = (TUNING.apart_s + horizons_s)[:, None, None]
        self._early = np.array([[TUNING.early]] * experts + [[1.0]])
        self._seconds = np.zeros((count, experts + 1, channels))
        self._mean_square = np.zeros((count, experts + 1, channels))
        self._longer_square = np.zeros((count, experts, channels))
        self._coverage = np.zeros((count, channels))
        self._quantile = np.full((count, channels), TUNING.gaussian_quantile)
        self._horizon, self._channel = np.ogrid[:count, :channels]
        self._first = first[:, None]
        self.best: NDArray[np.intp] = np.repeat(self._first, channels, axis=1)
        """The chosen expert, (H, n)."""
        self.least_square = np.zeros((count, channels))
        """No mean square is published that is less."""
        self.std = np.full((count, channels), np.nan)
        self.half_width = np.full((count, channels), np.nan)
        """Deviation of the chosen expert's errors and half-width of the 95 % interval, (H, n)."""

    def score(self, spacing_s: float, error: Array, half_width: Array) -> None:
        """Take the errors (R, H, E + 1, n) of R predictions made ``spacing_s`` apart, of the experts and last of what
        was published (which is overwritten where it had no interval), and the half-widths published with it.
        """
        published = error[:, :, -1]
        if not isfinite(half_width.sum()):
            published[np.isnan(half_width)] = np.nan
        misses = (np.abs(published) > half_width).sum(axis=0)
        mean, count = _mean_square(error)
        elapsed_s = spacing_s * count
        self._seconds += elapsed_s
        memory_s = np.minimum(self._seconds / self._early, self._memory_s)
        share = np.minimum(elapsed_s / np.maximum(memory_s, 1e-9), 1.0)
        self._mean_square += share * (mean - self._mean_square)
        memory_s = np.minimum(self._seconds / self._early, TUNING.longer * self._memory_s)[:, :-1]
        of_experts = elapsed_s if isinstance(elapsed_s, float) else elapsed_s[:, :-1]
        longer = np.minimum(of_experts / np.maximum(memory_s, 1e-9), 1.0)
        self._longer_square += longer * (mean[:, :-1] - self._longer_square)

        scored = count if isinstance(count, float) else count[:, -1]
        quantile = self._quantile + TUNING.quantile_step * (misses - TUNING.miss_share * scored)
        self._quantile = np.minimum(np.maximum(quantile, TUNING.quantile_range[0]), TUNING.quantile_range[1])
        self._coverage += share[:, -1] * (1.0 - misses / np.maximum(scored, 1.0) - self._coverage)

    def doubt(self, channel: int, experts: NDArray[np.bool_]) -> None:
        """What is known of these experts (E,) is of another motion: they are chosen by errors that are to come."""
        self._seconds[:, np.flatnonzero(experts), channel] = 0.0

    def choose(self, available: NDArray[np.bool_]) -> None:
        """Choose among the ``available`` (E, n) experts."""
        seconds = self._seconds[:, :-1]
        share = self._apart_s / np.maximum(seconds, TUNING.enough_s)
        expected = (1.0 + TUNING.few * share) * self._mean_square[:, :-1]
        expected = np.where(available & (seconds >= TUNING.enough_s), expected, np.inf)
        square = expected[self._horizon, self.best, self._channel]
        least = expected.min(axis=1)
        better = least < TUNING.better * square
        if better.any():
            self.best = np.where(better, expected.argmin(axis=1), self.best)
            square = np.where(better, least, square)
        unknown = square == np.inf
        if unknown.any():
            self.best = np.where(unknown, self._first, self.best)
        office = self._horizon, self.best, self._channel
        square = (1.0 + (TUNING.rare * share[office]) ** TUNING.rare_power) * self._mean_square[office]
        square = np.where(unknown, np.nan, square)
        longer = np.where(unknown, np.nan, self._longer_square[office])
        longer += (TUNING.sure**2 - 1.0) * np.maximum(longer - self.least_square, 0.0)
        self.std = np.sqrt(np.maximum(np.maximum(square, longer), self.least_square))
        least = TUNING.gaussian_quantile * np.sqrt(self.least_square)
        self.half_width = np.maximum(self._quantile * np.sqrt(square), least)

    def rms_of(self, expert: int) -> Array:
        """Errors of an expert, (H, n), lately or for longer, whichever is more; 0 until one is known."""
        errors: Array = np.sqrt(np.maximum(self._mean_square[:, expert], self._longer_square[:, expert]))
        return errors

    @property
    def rms_error(self) -> Array:
        """Rolling RMS of the published predictions' errors, (H, n); nan until one is known."""
        return np.where(self._seconds[:, -1] > 0.0, np.sqrt(self._mean_square[:, -1]), np.nan)

    @property
    def coverage(self) -> Array:
        """Rolling share of measured values inside the published 95 % interval, (H, n); nan until one is known."""
        return np.where(self._seconds[:, -1] > 0.0, self._coverage, np.nan)


def _mean_square(error: Array) -> tuple[Array, Array | float]:
    """Of those (R, ...) that are known, and how many they are."""
    square = error * error
    total: Array = square.sum(axis=0)
    if isfinite(total.sum()):
        return total / len(error), float(len(error))
    known = np.isfinite(square)
    count: Array = known.sum(axis=0, dtype=np.float64)
    mean: Array = np.where(known, square, 0.0).sum(axis=0) / np.maximum(count, 1)
    return mean, count
