"""The innovations of samples that were missed, as far as those after them tell.

With the state x that the filter predicts when nothing is missed, its gain K and its innovations e, white and of
variance S, the samples are

    z = H x + e,    x' = F (x + K e).

Of a sample that is not there e is not known, and what the filter left of the next one, the only one that is known, is
made of all of these: after half a second it is ten times as large as one that weights for the steady filter are meant
for. Each of them follows from what came after (fixed-point smoothing: Anderson and Moore 1979, section 7.2).
"""

from __future__ import annotations

from math import isfinite, nan
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from heaved.estimation.heave.sea.model import Steady

Array = NDArray[np.float64]


class MissedInnovations:
    """Feed it every sample of one filter."""

    def __init__(self, steady: Steady, H: Array, most: int) -> None:
        """``H`` (n,): acceleration of the state. ``most``: of how many of the last samples that is asked."""
        self._F, self._FK, self._S, self._H = steady.F, steady.F @ steady.K, steady.S, H
        self._most = most
        self._forget()

    def _forget(self) -> None:
        n = len(self._H)
        self._since = 0
        self._innovations = np.empty(0)
        self._with_state = np.empty((0, n))
        """(m, n) covariance of each with the state before the next sample,"""
        self._P = np.zeros((n, n))
        """and that of the state itself."""

    def miss(self, count: int) -> None:
        """So many samples were not there; of more than it is asked for nothing is told."""
        if count > self._most:
            self._forget()
            return
        for _ in range(count):
            self.step(nan)

    def step(self, innovation: float) -> Array:
        """One sample more: its ``innovation``, m/s2, 0 or nan where there was none to take in.

        (m,) innovations of the last samples, the newest last, as they are known by now; empty where nothing was missed.
        """
        is_missed = innovation == 0.0 or not isfinite(innovation)
        self._since = 0 if is_missed else self._since + 1
        if not is_missed and (not len(self._innovations) or self._since > self._most):
            if len(self._innovations):
                self._forget()
            return self._innovations
        F, FK, S = self._F, self._FK, self._S
        with_state = np.concatenate((self._with_state @ F.T, [S * FK]))
        P = F @ self._P @ F.T + S * np.outer(FK, FK)
        innovations = np.append(self._innovations, 0.0)
        if not is_missed:
            PH = self._P @ self._H
            variance = float(self._H @ PH) + S
            into = (F @ PH + S * FK) / variance
            seen = np.append(self._with_state @ self._H, S)
            innovations += seen * (innovation / variance)
            with_state -= np.outer(seen, into)
            P -= variance * np.outer(into, into)
        self._innovations, self._with_state = innovations[-self._most :], with_state[-self._most :]
        self._P = 0.5 * (P + P.T)
        return self._innovations
