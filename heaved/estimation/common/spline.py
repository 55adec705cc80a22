"""Cubic spline through points. (Ours, since scipy.interpolate would cost the daemon 20 MB of memory.)

Source: de Boor 1978, A Practical Guide to Splines, chapter IV: slopes at the knots from a tridiagonal system; "not a
knot" at the ends, where the third derivative does not jump at the last knot but one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

Array = NDArray[np.float64]


class CubicSpline:
    """Through the values ``y`` (n, ...) at the knots ``x`` (n,), n >= 2, increasing.

    The line or parabola through all of two or three; beyond the ends the outermost cubics go on.
    """

    def __init__(self, x: Array, y: Array) -> None:
        columns = y.reshape(len(x), -1)
        dx = np.diff(x)[:, None]
        rise = np.diff(columns, axis=0) / dx
        slopes = _slopes(x, dx, rise)
        bend = (slopes[:-1] + slopes[1:] - 2.0 * rise) / dx
        self._x, self._shape = x, y.shape[1:]
        self._powers = columns[:-1], slopes[:-1], (rise - slopes[:-1]) / dx - bend, bend / dx
        """Each (n - 1, columns): what stands before the powers 0 to 3 of the distance from the knot before."""

    def __call__(self, at: Array) -> Array:
        """Values (m, ...) at ``at`` (m,)."""
        before, s = self._place(at)
        c0, c1, c2, c3 = (power[before] for power in self._powers)
        return self._shaped(c0 + c1 * s + c2 * (s * s) + c3 * (s * s * s))

    def slope(self, at: Array) -> Array:
        """Derivatives (m, ...) at ``at`` (m,)."""
        before, s = self._place(at)
        _, c1, c2, c3 = (power[before] for power in self._powers)
        return self._shaped(c1 + 2.0 * c2 * s + 3.0 * c3 * (s * s))

    def _place(self, at: Array) -> tuple[NDArray[np.intp], Array]:
        """Index (m,) of the knot before, and the distance (m, 1) from it."""
        before = np.searchsorted(self._x[1:-1], at, side="right")
        return before, (at - self._x[before])[:, None]

    def _shaped(self, values: Array) -> Array:
        return values.reshape(len(values), *self._shape)


def _slopes(x: Array, dx: Array, rise: Array) -> Array:
    """(n, columns) at the knots, from the distances (n - 1, 1) and the mean slopes (n - 1, columns) between them."""
    if len(dx) == 1:
        return np.repeat(rise, 2, axis=0)
    first, last = x[2] - x[0], x[-1] - x[-3]
    inner = 3.0 * (dx[1:] * rise[:-1] + dx[:-1] * rise[1:])
    if len(dx) == 2:  # The conditions of both ends are the same one: the parabola.
        middle = inner[0] / (3.0 * first)
        return np.array([2.0 * rise[0] - middle, middle, 2.0 * rise[1] - middle])
    bands = np.zeros((3, len(x)))
    bands[0, 1], bands[0, 2:] = first, dx[:-1, 0]
    bands[1, 0], bands[1, 1:-1], bands[1, -1] = dx[1, 0], 2.0 * (dx[:-1, 0] + dx[1:, 0]), dx[-2, 0]
    bands[2, :-2], bands[2, -2] = dx[1:, 0], last
    start = ((dx[0] + 2.0 * first) * dx[1] * rise[0] + dx[0] ** 2 * rise[1]) / first
    end = (dx[-1] ** 2 * rise[-2] + (2.0 * last + dx[-1]) * dx[-2] * rise[-1]) / last
    slopes: Array = solve_banded((1, 1), bands, np.vstack((start, inner, end)))
    return slopes
