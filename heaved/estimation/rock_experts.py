"""Which of several predictors to believe, per horizon and channel, and how far: realised errors decide both.

Each expert's mean square error is averaged exponentially; the least one is published. Its root times an adaptive
quantile is the half-width of the 95 % interval: the quantile takes a small step up after a miss and a nineteenth of it
down after a hit (Gibbs and Candes 2021, adaptive conformal inference), so coverage holds whatever the distribution.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MISS_SHARE: Final = 0.05
QUANTILE_STEP: Final = 0.002
"""Per scored prediction."""
QUANTILE_RANGE: Final = (1.0, 5.0)
GAUSSIAN_QUANTILE: Final = 1.96
MEMORY_S: Final = 30.0
PER_HORIZON: Final = 4.0
"""Memory of the errors: so many horizons more, as errors closer together than a horizon are hardly different ones."""
REPORT_MEMORY_S: Final = 300.0
"""Of the error and coverage that are reported."""
EARLY: Final = 2.0
"""While young the mean square is that of the last half or so: what the start cost fades as 1/t^2."""
ENOUGH_S: Final = 1.0
"""Errors of an expert known for so long before it may be chosen by them."""
BETTER: Final = 0.97
"""Mean square below that of the expert in office before it is replaced."""


class Switch:
    """Arrays are (H, E, n): horizons, experts, channels; what is published (H, n). Errors not known are nan."""

    def __init__(self, horizons_s: Array, experts: int, channels: int, first: NDArray[np.intp]) -> None:
        """``first`` (H,): the expert in office while no error of an available one is known."""
        shape = (len(horizons_s), experts, channels)
        self._memory_s = (MEMORY_S + PER_HORIZON * horizons_s)[:, None, None]
        self._seconds = np.zeros(shape)
        self._mean_square = np.zeros(shape)
        self._quantile = np.full((shape[0], channels), GAUSSIAN_QUANTILE)
        self._report = np.zeros((3, shape[0], channels))  # seconds, mean square, coverage of what was published
        self._horizon, self._channel = np.ogrid[: shape[0], :channels]
        self._first = first[:, None]
        self.best: NDArray[np.intp] = np.repeat(self._first, channels, axis=1)
        """The chosen expert, (H, n)."""
        self.std = np.full((shape[0], channels), np.nan)
        self.half_width = np.full((shape[0], channels), np.nan)
        """Deviation of the chosen expert's errors and half-width of the 95 % interval, (H, n)."""

    def score(self, spacing_s: float, error: Array, published: Array, half_width: Array) -> None:
        """Take the errors of R predictions made ``spacing_s`` apart: of the experts (R, H, E, n), of what was published
        (R, H, n), and the half-widths published with it."""
        square = error * error
        mean = square.sum(axis=0) / len(square)
        count: NDArray[np.intp] = np.full(mean.shape, len(square), dtype=np.intp)
        if not np.isfinite(mean).all():
            known = np.isfinite(square)
            count = np.count_nonzero(known, axis=0)
            mean = np.where(known, square, 0.0).sum(axis=0) / np.maximum(count, 1)
        elapsed_s = spacing_s * count
        self._seconds += elapsed_s
        memory_s = np.minimum(np.maximum(self._seconds, elapsed_s) / EARLY, self._memory_s)
        weight = np.minimum(elapsed_s / np.maximum(memory_s, 1e-9), 1.0)
        self._mean_square += weight * (mean - self._mean_square)

        size = np.abs(published)
        judged = half_width == half_width
        judged &= size == size
        count = np.count_nonzero(judged, axis=0)
        misses = np.count_nonzero((size > half_width) & judged, axis=0)
        self._quantile += QUANTILE_STEP * (misses - MISS_SHARE * count)
        np.clip(self._quantile, *QUANTILE_RANGE, out=self._quantile)
        seconds, square_reported, coverage = self._report
        seconds += spacing_s * count
        weight = np.minimum(spacing_s * count / np.clip(seconds, 1e-9, REPORT_MEMORY_S), 1.0)
        per = np.maximum(count, 1)
        square_reported += weight * (np.where(judged, size * size, 0.0).sum(axis=0) / per - square_reported)
        coverage += weight * (1.0 - misses / per - coverage)

    def choose(self, available: NDArray[np.bool_]) -> None:
        """Choose among the ``available`` (E, n) experts."""
        scored = np.where(self._seconds >= ENOUGH_S, self._mean_square, np.inf)
        scored = np.where(available, scored, np.inf)
        h, n = self._horizon, self._channel
        least = np.argmin(scored, axis=1)
        in_office = scored[h, self.best, n]
        best_known = scored[h, least, n]
        self.best = np.where(best_known < BETTER * in_office, least, self.best)
        self.best = np.where(best_known == np.inf, self._first, self.best)
        self.std = np.sqrt(self._mean_square[h, self.best, n])
        self.std[self._seconds[h, self.best, n] < ENOUGH_S] = np.nan
        self.half_width = self._quantile * self.std

    @property
    def rms_error(self) -> Array:
        """Rolling RMS of the published predictions' errors, (H, n); nan until one is known."""
        return np.where(self._report[0] > 0.0, np.sqrt(self._report[1]), np.nan)

    @property
    def coverage(self) -> Array:
        """Rolling share of measured values inside the published 95 % interval, (H, n); nan until one is known."""
        return np.where(self._report[0] > 0.0, self._report[2], np.nan)
