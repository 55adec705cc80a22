"""Geometry of the direct predictor: lag knots, the fading-memory extrapolation as taps, interpolation between samples.

The past is seen through means about knots whose lags grow geometrically: fine where phase is decided, coarse where only
the slow motion matters. Each is a weighted mean that falls linearly to zero at the neighbouring knots, so a regression
on them is a response that is piecewise linear in the lag. (Plain means over the blocks between the knots make it
piecewise constant: with growth 1.2 the best that can be reached 2 s ahead is then 1.70 instead of 1.42 times the bound
for a lightly damped roll.) Differences of running sums give all of them, at any sample rate, for a lookup.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

GRID_S: Final = 0.05
"""Least distance of knots; at faster rates it is several samples."""
EXACT: Final = 8
GROWTH: Final = 1.15
"""Knots 0..8 are a grid step apart; each after them lies 1.15 times as far back as the one before."""
DEGREE: Final = 3
MEAN_AGE_S: Final = 0.15
"""Of the fading memory: theta / (1 - theta) steps, i.e. theta = 0.75 at 20 Hz."""
SMOOTHED_S: Final = 0.6
SMOOTHED_DEGREE: Final = 4
"""Of the fit that tells the motion from what shakes it, on either side; odd powers make no difference."""
FADING_SPAN_S: Final = 2.0
"""Where the fading memory is cut off: 0.75^40 = 1e-5."""


def lag_knots(interval_s: float, span_s: float) -> Indices:
    """Lags in samples from 0 to ``span_s``, increasing."""
    unit = samples_per_step(interval_s)
    knots = [unit * i for i in range(EXACT + 1)]
    end = max(round(span_s / interval_s), knots[-1] + 1)
    exact = float(knots[-1])
    while knots[-1] < end:
        exact *= GROWTH
        knots.append(max(round(exact), knots[-1] + 1))
    # The last knot is at the span, unless that is very near to the one before: then it takes its place.
    if end - knots[-2] < 0.5 * (knots[-1] - knots[-2]) and len(knots) > EXACT + 2:
        knots.pop()
    knots[-1] = end
    return np.array(knots, dtype=np.intp)


def samples_per_step(interval_s: float) -> int:
    """Samples between the first knots, and between two equations of the regression."""
    return max(1, round(GRID_S / interval_s))


def fading_taps(interval_s: float, ahead_s: Array) -> Array:
    """Weights (H, W) on the last W samples, oldest first, of the discounted polynomial fit extrapolated by ``ahead_s``.

    The filter of :mod:`heaved.estimation.rock.fading` with its memory cut off, fitted to what is left so that it
    reproduces polynomials of its degree exactly.
    """
    count = max(round(FADING_SPAN_S / interval_s), 12)
    age = np.arange(count - 1, -1, -1.0)
    mean_age = max(MEAN_AGE_S / interval_s, 1.0)
    theta = mean_age / (1.0 + mean_age)
    powers = np.arange(DEGREE + 1)
    root = theta ** (age / 2.0)
    scale = 4.0 * mean_age
    fit = np.linalg.pinv(root[:, None] * (-age[:, None] / scale) ** powers) * root
    taps: Array = (np.asarray(ahead_s)[:, None] / interval_s / scale) ** powers @ fit
    return taps


class Between(msgspec.Struct, frozen=True):
    """Where a time a fraction of samples ahead lies on the grid: four-point interpolation (Lagrange, cubic)."""

    first: Indices
    """(H,) offset of the first of four samples."""
    weights: Array
    """(H, 4); (0, 1, 0, 0) for whole samples."""


def between(ahead: Array) -> Between:
    """Interpolation for times ``ahead`` (H,) in samples."""
    whole = np.rint(ahead)
    ahead = np.where(np.abs(ahead - whole) < 0.02, whole, ahead)
    base = np.floor(ahead)
    u = ahead - base
    weights = np.stack(
        [
            -u * (u - 1.0) * (u - 2.0) / 6.0,
            (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0,
            -(u + 1.0) * u * (u - 2.0) / 2.0,
            (u + 1.0) * u * (u - 1.0) / 6.0,
        ],
        axis=1,
    )
    return Between(base.astype(np.intp) - 1, weights)


def shaking_taps(interval_s: float) -> Array:
    """Weights (2 L + 1,) on the samples about one of them: what of it is no wave motion, but vibration and noise.

    What is left by a polynomial fitted with weights that fall to zero: 1e-6 of a motion of 5 s period, 3 % of one of
    1 s, half at 0.5 s, and all that is faster than 2.5 Hz.
    """
    half = round(SMOOTHED_S / interval_s)
    place = np.arange(-half, half + 1) / (half + 1)
    powers = place[:, None] ** np.arange(0, SMOOTHED_DEGREE + 1, 2)
    root = np.cos(0.5 * np.pi * place)
    smooth = (np.linalg.pinv(root[:, None] * powers) * root)[0]
    return np.asarray((place == 0.0) - smooth, dtype=np.float64)


def curve_weights(horizons_s: Array, at_s: Array, derivative: int = 0) -> Array:
    """(len(at_s), H + 1) weights that interpolate a predicted curve, given now and at each horizon, at times ``at_s``.

    A cubic spline; beyond the last horizon its value there is kept.
    """
    nodes = np.concatenate([[0.0], horizons_s])
    spline = CubicSpline(nodes, np.eye(len(nodes)), axis=0)
    weights: Array = spline(np.minimum(at_s, nodes[-1]), derivative)
    return weights


class SampleWindow:
    """The last samples of some columns and their running sums: contiguous rows, moved to the front when full."""

    def __init__(self, knots: Indices, columns: int, keep: int) -> None:
        """``knots`` of :func:`lag_knots`; ``keep``: samples to keep at least, more than the last knot."""
        self._keep, self._columns, self.width = keep, columns, 3 * columns
        capacity = 2 * keep + 1024
        # Row k: sample k, the sum of those before it, the sum of the sums before that. So the last two of a row are
        # those of the row before plus the first two of it.
        self._rows = np.zeros((capacity + 1, self.width))
        self.known = np.zeros((capacity, columns), dtype=bool)
        self.known[keep:] = True  # until one comes that is not
        self._knots = knots
        # The mean of the running sum between two knots is what all samples up to there add, those in between in part: a
        # ramp. The difference of two ramps is the mean about a knot. All of it on [sum at the end, sum2 at the knots].
        count = len(knots)
        ramp = np.zeros((count, count + 1))
        ramp[0, 0] = 1.0
        for j, length in enumerate(np.diff(knots).tolist(), start=1):
            ramp[j, j : j + 2] = 1.0 / length, -1.0 / length
        weights = ramp[:-1] - ramp[1:]
        length = np.diff(knots, prepend=knots[:1])
        total = (length[:-1] + length[1:]) / 2.0  # of 1 - s / length on either side; before the first there is nothing
        total[0] = (length[1] + 1.0) / 2.0
        self.weights: Array = weights / total[:, None]
        """(knots - 1, knots + 1): means about the knots but the last, latest first, on the sums of :meth:`sums_at`."""
        self.end = keep
        self.moved = 0
        """How far rows have been moved to the front in all: row + moved never changes."""

    @property
    def x(self) -> Array:
        """The samples, (capacity, columns): a view, made when it is asked for; one that is kept would stay with the
        original when a window is copied."""
        return self._rows[:-1, : self._columns]

    def append(self, values: list[float], known: list[bool]) -> None:
        """A sample of all columns; ``known``: of the first ones, whether it was measured."""
        if self.end == len(self.known):
            start, x = self.end - self._keep, self.x
            x[: self._keep] = x[start:]
            self.known[: self._keep] = self.known[start:]
            self.known[self._keep :] = True
            self.moved += start
            self.end = self._keep
            self._sum_from(0)
        end, columns = self.end, self._columns
        row = self._rows[end]
        row[:columns] = values
        if not all(known):
            self.known[end, : len(known)] = known
        np.add(row[columns:], row[:-columns], out=self._rows[end + 1, columns:])
        self.end = end + 1

    def replace(self, column: int, values: Array) -> None:
        """Put ``values`` in the place of the latest samples of a column and call them known, where they are finite."""
        rows = np.arange(self.end - len(values), self.end)[np.isfinite(values)]
        if len(rows):
            self.x[rows, column] = values[np.isfinite(values)]
            self.known[rows, column] = True
            self._sum_from(int(rows[0]))

    def fill(self, column: int, values: Array) -> None:
        """Put ``values`` in the place of the latest samples of a column where they were not measured."""
        rows = np.arange(self.end - len(values), self.end)
        unknown = ~self.known[rows, column]
        if unknown.any():
            self.x[rows[unknown], column] = values[unknown]
            self._sum_from(int(rows[unknown][0]))

    def flatten(self, column: int, value: float) -> None:
        """A column that begins anew: its past is ``value``."""
        self.x[: self.end, column] = value
        self.known[: self.end, column] = False
        self._sum_from(0)

    def samples_at(self, column: int, count: int) -> Indices:
        """Places of the latest samples of a column, latest first."""
        return column - self.width * np.arange(1, count + 1)

    def sums_at(self, column: int) -> Indices:
        """Places of what :attr:`weights` apply to."""
        back = 2 * self._columns + column - self.width * self._knots
        return np.concatenate([[self._columns + column], back])

    def gather(self, places: Indices, ends: int | Indices) -> Array:
        """What is at ``places``, as seen from before the rows ``ends``, which broadcast."""
        return self._rows.take(places + self.width * ends)

    def latest(self, places: Indices, reach: int) -> Array:
        """What is at ``places``, counted from ``reach`` rows before the end of the window."""
        return self._rows[self.end - reach :].take(places)

    def means(self) -> Array:
        """Means about the knots but the last, latest first, (knots - 1, n)."""
        places = np.stack([self.sums_at(column) for column in range(self._columns)], axis=1)
        means: Array = self.weights @ self.gather(places, self.end)
        return means

    def _sum_from(self, row: int) -> None:
        columns, end = self._columns, self.end
        total, twice = self._rows[:, columns : 2 * columns], self._rows[:, 2 * columns :]
        if row == 0:
            total[0] = twice[0] = 0.0
        total[row + 1 : end + 1] = total[row] + np.cumsum(self.x[row:end], axis=0)
        twice[row + 1 : end + 1] = twice[row] + np.cumsum(total[row:end], axis=0)
