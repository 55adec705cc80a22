"""What the direct predictor sees of the past: of each channel one vector of sums and samples, and linear maps of it.

The past is seen through means about knots whose lags grow geometrically: fine where phase is decided, coarse where only
the slow motion matters. Each is a weighted mean that falls linearly to zero at the neighbouring knots, so a regression
on them is a response that is piecewise linear in the lag. (Plain means over the blocks between the knots make it
piecewise constant: with growth 1.2 the best that can be reached 2 s ahead is then 1.70 instead of 1.42 times the bound
for a lightly damped roll.) Differences of running sums give all of them, at any sample rate, for a lookup.

Features, extrapolation and the latest mean are linear in those sums and samples, and a prediction is linear in them. So
one matrix leads from what is gathered to what is published, made when the coefficients are; features are made of many
rows at once, when they are learned from.
"""

from __future__ import annotations

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.spline import CubicSpline

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What this file is set to."""

    grid_s: float = 0.05
    """Least distance of knots (the 20 Hz of Wei et al. 2019); at faster rates it is several samples."""
    exact: int = 8
    growth: float = 1.15
    """Knots 0..exact are a grid step apart; each after them lies so many times as far back as the one before."""
    rate_lags: int = 4
    """Knots whose means of the rates are features."""
    rate_scale_s: float = 0.1
    """Makes an angular rate commensurate with differences of angles over a step or two."""
    whole: float = 0.02
    """Part of a sample, off a whole number of them, that makes no difference."""


TUNING: Final = Tuning()


def lag_knots(interval_s: float, span_s: float) -> Indices:
    """Lags in samples from 0 to ``span_s``, increasing."""
    unit, exact_knots = samples_per_step(interval_s), TUNING.exact
    knots = [unit * i for i in range(exact_knots + 1)]
    end = max(round(span_s / interval_s), knots[-1] + 1)
    exact = float(knots[-1])
    while knots[-1] < end:
        exact *= TUNING.growth
        knots.append(max(round(exact), knots[-1] + 1))
    # The last knot is at the span, unless that is very near to the one before: then it takes its place.
    if end - knots[-2] < 0.5 * (knots[-1] - knots[-2]) and len(knots) > exact_knots + 2:
        knots.pop()
    knots[-1] = end
    return np.array(knots, dtype=np.intp)


def samples_per_step(interval_s: float) -> int:
    """Samples between the first knots."""
    return max(1, round(TUNING.grid_s / interval_s))


class Around(msgspec.Struct, frozen=True):
    """Where times lie on the grid of samples, and what was there: the cubic fitted to the samples around each."""

    first: Indices
    """(H,) offset of the first of W samples."""
    weights: Array
    """(H, W)"""

    @property
    def last(self) -> Indices:
        """(H,) offset of the last of them."""
        last: Indices = self.first + (self.weights.shape[1] - 1)
        return last


def around(ahead: Array, half: int) -> Around:
    """For times ``ahead`` (H,) in samples: ``half`` samples on either side.

    With one on either side it is interpolation through four (Lagrange), or the very sample at a whole number of them.
    """
    whole = np.rint(ahead)
    ahead = np.where(np.abs(ahead - whole) < TUNING.whole, whole, ahead)
    first = (np.floor(ahead) if half <= 1 else np.rint(ahead)).astype(np.intp) - half
    count = 4 if half <= 1 else 2 * half + 1
    place = (first[:, None] + np.arange(count) - ahead[:, None]) / (half + 1.0)
    weights = np.linalg.pinv(place[:, :, None] ** np.arange(4))[:, 0]
    if half <= 1:  # exact but for rounding, which would make other samples matter where there is one
        weights = np.round(weights, 12)
    return Around(np.asarray(first, dtype=np.intp), np.asarray(weights, dtype=np.float64))


def curve_spline(horizons_s: Array) -> CubicSpline:
    """Weights (..., H + 1) on a predicted curve, given now and at each horizon, of its value at a time up to the last.

    A cubic spline through unit vectors: it is linear in the curve.
    """
    nodes = np.concatenate([[0.0], horizons_s])
    return CubicSpline(nodes, np.eye(len(nodes)))


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

    @property
    def x(self) -> Array:
        """The samples, (capacity, columns): a view, made when it is asked for; one that is kept would stay with the
        original when a window is copied.
        """
        return self._rows[:-1, : self._columns]

    def push(self, values: list[float], known: list[bool]) -> None:
        """A sample of all columns; ``known``: of the first ones, whether it was measured."""
        if self.end == len(self.known):
            start, x = self.end - self._keep, self.x
            x[: self._keep] = x[start:]
            self.known[: self._keep] = self.known[start:]
            self.known[self._keep :] = True
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


class Regressors:
    """Of n channels, from a window with the columns [channels | their rates, if there are any | their slow means].

    The vector of a channel is [sums | those of its rate | slow mean | samples, latest first]; maps are matrices on it.
    """

    def __init__(self, window: SampleWindow, channels: int, taps: Array, *, rates: bool) -> None:
        """``taps`` (m, W): weights on the last W samples, oldest first."""
        self._window = window
        lags, sums = window.weights.shape
        rate_lags = TUNING.rate_lags if rates else 0
        rate_sums = rate_lags + 2 if rates else 0
        mean, sample = sums + rate_sums, sums + rate_sums + 1
        self.width = sample + taps.shape[1]
        self._places: Indices = np.array(
            [
                np.concatenate(
                    [
                        window.sums_at(c),
                        window.sums_at(channels + c)[:rate_sums] if rates else [],
                        window.samples_at((2 if rates else 1) * channels + c, 1),
                        window.samples_at(c, taps.shape[1]),
                    ]
                )
                for c in range(channels)
            ],
            dtype=np.intp,
        )
        self._reach = -(int(self._places.min()) // window.width)
        self._recent = self._places + self._reach * window.width
        self.sample = np.zeros(self.width)
        """The latest sample itself."""
        self.sample[sample] = 1.0
        self.newest = np.zeros(self.width)
        """The mean about the first knot."""
        self.newest[:sums] = window.weights[0]
        self.taps = np.zeros((len(taps), self.width))
        self.taps[:, sample:] = taps[:, ::-1]
        self.fronts = fronts = 1 + rate_lags
        self.rate_features = slice(1, fronts)
        """Those of them that are rates."""
        self.features = np.zeros((fronts + lags - 1, self.width))
        """(p, width): the slow mean, the rates, the means about the other knots, all but the rates less the newest."""
        self.features[0, mean] = 1.0
        self.features[1:fronts, sums:mean] = TUNING.rate_scale_s * window.weights[:rate_lags, :rate_sums]
        self.features[fronts:, :sums] = window.weights[1:]
        self.features[0] -= self.newest
        self.features[fronts:] -= self.newest

    def now(self) -> Array:
        """The vectors, (n, width)."""
        return self._window.latest(self._recent, self._reach)

    def at(self, ends: Indices) -> Array:
        """The vectors as they were before the rows ``ends`` (R,), (R, n, width)."""
        return self._window.gather(self._places, ends[:, None, None])
