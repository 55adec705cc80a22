"""Where the state leads: heave, velocity and their uncertainty at any moment near the last sample, F^m X.

Everything that is published is the state moved in time: by the age of the last measurement, by the lead or lag of the
sensor chain, by the reaction time of a compensator, by the horizon of a forecast. The rows that do it, heave expm(A
tau), are kept on a grid of tau, with the derivatives that reach from there to any tau: d/dtau is a multiplication by A.
"""

from __future__ import annotations

from math import factorial
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.observer import Motion

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.estimation.heave.sea.model import SeaSystem

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of the grid of rows."""

    step_s: float = 0.05
    """Of tau."""
    back_s: float = 3.0
    """How far back the rows reach: the most that a sensor may be late, twice over."""


TUNING: Final = Tuning()
TAYLOR_TERMS: Final = 6
"""From the grid to a moment of its own, half a step away at most."""
ORDER: Final = 6
"""Derivatives used: at 0.1 s and 0.6 Hz the next one is 1e-7."""


class Propagation:
    """Rows of one model over tau from -``back_s`` to ``ahead_s``."""

    def __init__(self, system: SeaSystem, ahead_s: float) -> None:
        self._A, self._diffusion = system.A, system.diffusion
        count = round((TUNING.back_s + ahead_s) / TUNING.step_s) + 1
        self._first_s = -TUNING.back_s
        zero = round(TUNING.back_s / TUNING.step_s)
        self._rows = np.empty((count, len(system.H)))
        self._rows[zero] = system.heave
        # Outwards from zero: errors grow backwards, where the chains are damped, and must not come forward again.
        for F, places, step in (
            (system.moved(TUNING.step_s), range(zero + 1, count), 1),
            (system.moved(-TUNING.step_s), range(zero - 1, -1, -1), -1),
        ):
            for j in places:
                self._rows[j] = self._rows[j - step] @ F
        # Variance that the waves to come add: integral of (row(s) g)^2 from 0 to tau.
        density = self._rows**2 @ system.diffusion
        self._added = np.zeros(count)
        self._added[zero + 1 :] = np.cumsum(0.5 * TUNING.step_s * (density[zero + 1 :] + density[zero:-1]))

    def derivatives(self, taus_s: Sequence[float]) -> Array:
        """(len(taus), ORDER, n): heave at each tau and its derivatives over factorials, as rows on the state."""
        nearest = [self._nearest(tau) for tau in taus_s]
        chain, rest_s = [np.array([row for row, _ in nearest])], np.array([[rest] for _, rest in nearest])
        for _ in range(ORDER + TAYLOR_TERMS - 1):
            chain.append(chain[-1] @ self._A)
        # Taylor from the grid to tau, for each derivative.
        scales = [rest_s**k / factorial(k) for k in range(TAYLOR_TERMS)]
        found = [
            sum([scale * chain[order + k] for k, scale in enumerate(scales)], np.zeros_like(chain[0]))
            / factorial(order)
            for order in range(ORDER)
        ]
        return np.stack(found, axis=1)

    def row(self, tau_s: float) -> Array:
        """(n,) heave at ``tau_s``, as a row on the state."""
        row, rest_s = self._nearest(tau_s)
        total, term = row, row
        for k in range(1, ORDER):
            term = term @ self._A * (rest_s / k)
            total = total + term
        return total

    def missed(self, tau_s: float) -> float:
        """Variance (m2) that :meth:`row` misses for a moment ``tau_s`` < 0: what the waves have added since."""
        if tau_s >= 0.0:
            return 0.0
        zero = round(TUNING.back_s / TUNING.step_s)
        first = max(zero + round(tau_s / TUNING.step_s), 0)
        return TUNING.step_s * float(np.sum(self._rows[first:zero] ** 2 @ self._diffusion))

    def series(self, x: Array) -> Array:
        """(n, ORDER): the state ``x`` (n,) and its derivatives over factorials, for :meth:`along`."""
        columns = np.empty((len(x), ORDER))
        columns[:, 0] = x
        for k in range(1, ORDER):
            columns[:, k] = self._A @ columns[:, k - 1] / k
        return columns

    def along(self, series: Array, tau_s: float) -> Motion:
        """Heave ``tau_s`` after the state of which this is the :meth:`series`."""
        row, rest_s = self._nearest(tau_s)
        return along((row @ series).tolist(), rest_s)

    def _nearest(self, tau_s: float) -> tuple[Array, float]:
        """The row of the grid that is nearest, and the time from there."""
        j = min(max(round((tau_s - self._first_s) / TUNING.step_s), 0), len(self._rows) - 1)
        return self._rows[j], tau_s - self._first_s - j * TUNING.step_s

    def stds(self, P: Array) -> Array:
        """Standard deviation of the heave error at every tau of the grid, for a state of covariance ``P`` (n, n)."""
        return self._stds(P, slice(None))

    def stds_at(self, P: Array, taus_s: Sequence[float]) -> list[float]:
        """The same at some moments only, linear between those of the grid."""
        places = self._places(taus_s)
        stds = self._stds(P, np.array([(i, i + 1) for i, _ in places]).ravel()).tolist()
        return [
            (1.0 - share) * low + share * high
            for low, high, (_, share) in zip(stds[::2], stds[1::2], places, strict=True)
        ]

    def _stds(self, P: Array, which: slice | NDArray[np.int64]) -> Array:
        rows = self._rows[which]
        variances = np.einsum("ji,ji->j", rows @ P, rows) + self._added[which]
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)))

    def between(self, values: Sequence[float], taus_s: Sequence[float]) -> list[float]:
        """``values`` of the whole grid, such as :meth:`stds`, at any moments: linear; the ends hold beyond them."""
        return [(1.0 - share) * values[i] + share * values[i + 1] for i, share in self._places(taus_s)]

    def _places(self, taus_s: Sequence[float]) -> list[tuple[int, float]]:
        """Moments on the grid, within its ends: the place before each, and the share of the step from there."""
        first_s, last, before_last = self._first_s, len(self._rows) - 1.0, len(self._rows) - 2
        found = []
        for tau in taus_s:
            place = (tau - first_s) / TUNING.step_s
            place = 0.0 if place < 0.0 else place if place < last else last
            i = int(place) if place < last else before_last
            found.append((i, place - i))
        return found


def along(series: Sequence[float], d: float) -> Motion:
    """Heave and velocity ``d`` seconds on, from heave and its derivatives over factorials."""
    c0, c1, c2, c3, c4, c5 = series
    heave = ((((c5 * d + c4) * d + c3) * d + c2) * d + c1) * d + c0
    return Motion(heave, (((5.0 * c5 * d + 4.0 * c4) * d + 3.0 * c3) * d + 2.0 * c2) * d + c1)
