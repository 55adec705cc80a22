"""What the rock predictor remembers: its recent samples and predictions, and how far those were off."""

from __future__ import annotations

from math import inf, nan

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class History:
    """The last ``keep_s`` of samples and predictions: contiguous rows ``first..end``, moved to the front when full."""

    def __init__(self, rows: tuple[int, int], curve: tuple[int, ...], keep_s: float) -> None:
        capacity = 256
        self.keep_s = keep_s
        self.first = self.end = self._window = 0
        self.t_s = np.zeros(capacity)
        self.measured = np.full((capacity, rows[1]), nan)
        self.pairs = np.zeros((*rows, 4, capacity))
        """(B, 3, 4, row): position and velocity one step before, 1, measured angle; zero where there is none."""
        self.curves = np.full((capacity, *curve), nan)
        """(row, H, B, 3, m+3): the states predicted at that row."""

    def append(self, t_s: float, measured: Array) -> int:
        """A row for the sample at t_s; no regressors yet."""
        while self.t_s[self.first] < t_s - self.keep_s and self.first < self.end:
            self.first += 1
        if self.end == len(self.t_s):
            self._move_to_front()
        row = self.end
        self.t_s[row] = t_s
        self.measured[row] = measured
        self.pairs[..., row] = 0.0
        self.end += 1
        return row

    def window(self, since_s: float) -> Array:
        self._window = max(self._window, self.first)
        while self.t_s[self._window] < since_s:
            self._window += 1
        return self.pairs[..., self._window : self.end]

    def _move_to_front(self) -> None:
        live = slice(self.first, self.end)
        count = self.end - self.first
        capacity = len(self.t_s) * (2 if 2 * count > len(self.t_s) else 1)
        for name, axis in (("t_s", 0), ("measured", 0), ("pairs", 3), ("curves", 0)):
            old: Array = getattr(self, name)
            shape = list(old.shape)
            shape[axis] = capacity
            new = np.empty(shape)
            np.moveaxis(new, axis, 0)[:count] = np.moveaxis(old, axis, 0)[live]
            setattr(self, name, new)
        self._window = max(self._window - self.first, 0)
        self.first, self.end = 0, count


class RealisedErrors:
    """Exponentially weighted mean square of realised errors, shape (H, B, 3), and the memory that has the least."""

    EARLY = 2.0
    """While young the mean square is that of the last half or so: what the start cost fades as 1/t^2."""
    ENOUGH_S = 5.0
    """Errors known for so long before their RMS is given out."""
    CHOICE_S = 0.4
    """Errors known for so long, and renewed so often, to choose by them."""

    def __init__(self, shape: tuple[int, int, int], memory_s: float) -> None:
        self._memory_s = memory_s
        self._seconds = np.zeros(shape)
        self._mean_square = np.zeros(shape)
        self._chosen_s = -inf
        horizon, axis = np.ogrid[: shape[0], : shape[2]]
        self._best: tuple[NDArray[np.intp], ...] = (horizon, np.full((shape[0], shape[2]), shape[1] // 2), axis)
        self._floor = np.full((shape[0], shape[2]), nan)

    def forget(self, axis: int) -> None:
        """Nothing is known of the errors of an axis."""
        self._seconds[:, :, axis] = 0.0
        self._floor[:, axis] = nan

    def update(self, t_s: float, elapsed_s: float, error: Array) -> None:
        """Errors that are not known are nan."""
        known = np.isfinite(error)
        self._seconds += elapsed_s * known
        memory_s = np.minimum(np.maximum(self._seconds, elapsed_s) / self.EARLY, self._memory_s)
        square = np.where(known, error * error, self._mean_square)
        self._mean_square += np.minimum(elapsed_s / memory_s, 1.0) * (square - self._mean_square)
        if t_s - self._chosen_s >= self.CHOICE_S:
            self._chosen_s = t_s
            seconds, middle = self._seconds[:, 0], self._seconds.shape[1] // 2
            best = np.where(seconds >= self.CHOICE_S, np.argmin(self._mean_square, axis=1), middle)
            self._best = (self._best[0], best, self._best[2])
            self._floor = np.where(seconds >= self.ENOUGH_S, 0.0, nan)

    def of_best(self, values: Array) -> tuple[Array, Array]:
        """From ``values`` (H, B, 3, ...) the chosen memory's (H, 3, ...), and the RMS of its errors (H, 3).

        Until enough is known the memory is the middle one and the RMS nan.
        """
        return values[self._best], np.sqrt(self._mean_square[self._best]) + self._floor
