"""Whether a training can gain anything: ridge regressions on the very rows that it would be given, in closed form.

A training costs half a second of a core, and a process with torch in it; a regression of the same rows costs a
millisecond. What a network finds is for the most part linear, and a thousand steps of gradient descent leave the small
directions of the inputs alone, as a penalty does: a linear ridge regression (Hoerl and Kennard 1970) tells what that
is worth. What it cannot show, a second one looks for, with the squares and cubes of the two strongest directions of the
inputs beside them: the sea is narrow-banded, so that these are heave and its slope, and a scale that is not linear, a
range that ends or a leaning sensor all curve them. Gradient descent finds little of it, so there must be much.

Several penalties are tried, and each is judged as a network is, on rows that were held out. The best counts: a doubtful
window is trained.
"""

from __future__ import annotations

from itertools import chain, combinations_with_replacement
from math import inf
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Shares of the mean square of held-out residuals; penalties are shares of the variance of one input.

    So set that every network which passes the guard passes here, on seas, wave trains, slow sensors and such as are not
    linear, and a window of a sensor that has nothing to teach does not.
    """

    linear: float = 0.95
    """A window is worth its training when the linear regression leaves less than that."""
    curved: float = 0.75
    """The same of the other one, stricter: gradient descent finds little of what is not linear."""
    penalties: tuple[float, ...] = (1e-1, 1e-2, 1.0, 1e-3, 1e-4)
    """From what gradient descent finds in a thousand steps to nearly plain least squares."""
    curved_penalty: float = 0.3
    """Least one of squares and cubes, which fit noise sooner than the inputs do."""
    directions: int = 2
    """Of the inputs whose squares and cubes, products included, are regressed on."""


TUNING: Final = Tuning()


class Rows(msgspec.Struct, frozen=True, eq=False):
    """What a network is trained with, or judged on, in metres."""

    inputs: Array
    """(n, d) outputs of the observer, oldest first."""
    residuals: Array
    """(n,) laser less observer."""


def can_gain(training: Rows, held: Rows, *, limit_m: float, bar_m2: float) -> bool:
    """Whether a network that is trained on the one may do better on the other than what there is.

    limit_m: bound of a correction, either way. bar_m2: mean square of the held-out residuals that is to be beaten.
    """
    std_m = float(np.std(training.inputs))
    if not std_m > 0.0:
        return False
    mean_m = float(np.mean(training.inputs))
    x, z = ((rows.inputs - mean_m) / std_m for rows in (training, held))
    y, d = training.residuals, x.shape[1]
    plain = np.outer(TUNING.penalties, np.ones(d))
    if _left_m2(held.residuals, _regressed(x, y, z, plain), limit_m) < TUNING.linear * bar_m2:
        return True
    squares, directions = np.linalg.eigh(x.T @ x / len(x))
    strongest = slice(max(d - TUNING.directions, 0), d)
    axes = directions[:, strongest] / np.sqrt(squares[strongest])
    bent, held_bent = _powers(x @ axes), _powers(z @ axes)
    offsets, scales = np.mean(bent, axis=0), np.std(bent, axis=0)
    x, z = np.hstack((x, (bent - offsets) / scales)), np.hstack((z, (held_bent - offsets) / scales))
    more = np.outer(np.maximum(TUNING.penalties, TUNING.curved_penalty), np.ones(len(scales)))
    left_m2 = _left_m2(held.residuals, _regressed(x, y, z, np.hstack((plain, more))), limit_m)
    return left_m2 < TUNING.curved * bar_m2


def _regressed(x: Array, y: Array, z: Array, penalties: Array) -> Array:
    """y (n,) regressed on x (n, d) with each of the penalties (p, d), and what that says for z (m, d): (m, p)."""
    normal, moments = x.T @ x / len(y), x.T @ y / len(y)
    return z @ np.column_stack([np.linalg.solve(normal + np.diag(penalty), moments) for penalty in penalties])


def _powers(v: Array) -> Array:
    """All products of two and of three columns."""
    columns = range(v.shape[1])
    factors = chain(*(combinations_with_replacement(columns, degree) for degree in (2, 3)))
    return np.column_stack([np.prod(v[:, list(each)], axis=1) for each in factors])


def _left_m2(residuals: Array, corrections: Array, limit_m: float) -> float:
    """Mean square of what the best of the corrections (m, p) leaves of the residuals (m,)."""
    left = residuals[:, None] - np.clip(corrections, -limit_m, limit_m)
    return float(np.min(np.mean(left**2, axis=0), initial=inf))
