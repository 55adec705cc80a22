"""An autoregression of nodes of one channel, learned of what is known of them.

Nodes are 0.2 s apart, and each is told from the 50 before it. It is learned by exponentially forgetting least squares,
from one matrix of moments that is looked at only when it is wanted; of nodes that are themselves estimates each product
counts with its covariance: the expectation step of the EM algorithm for a state-space model (Shumway and Stoffer 1982),
with the smoothing that a state of 11 s brings with it. Moments over their number are the covariance that a filter
begins with.
"""

from __future__ import annotations

from math import exp, nan
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular, toeplitz

Array = NDArray[np.float64]

ORDER: Final = 50
"""Of the autoregression: 10 s."""
SMOOTHED: Final = 5
"""Older nodes beside those: what is learned in holes is learned from nodes that so many later ones have shown, too. Of
the newest an estimate that goes by the model says little but the model."""
NODES: Final = ORDER + 1 + SMOOTHED
NEWEST, OLDEST = slice(0, ORDER + 1), slice(SMOOTHED, NODES)
"""The nodes that are predicted from, and those that the model is learned from."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """How it is learned."""

    node_s: float = 0.2
    """Distance of nodes: a third of the shortest motion that is told from noise."""
    memory_s: float = 300.0
    """Of the model."""
    ridge: float = 0.1
    """Over the noise variance, as in :mod:`heaved.estimation.rock.learner`."""
    least_ridge: float = 1e-9
    """Over the mean diagonal: what rounding leaves."""
    prior_rows: float = 25.0
    """Weight of what is assumed before anything is known: 5 s of motion anywhere between..."""
    prior_hz: tuple[float, float] = (0.03, 0.35)
    learned_rows: int = 100
    """Nodes seen (20 s) before anything is published."""


TUNING: Final = Tuning()


class Autoregression:
    """Second moments of 56 nodes of one channel about its slow mean, newest first, and the model that follows."""

    def __init__(self, spacing_s: float, reach_s: float) -> None:
        """``spacing_s``: of the nodes; ``reach_s``: how far ahead is predicted, at most."""
        self._keep = exp(-spacing_s / TUNING.memory_s)
        self._ahead = int(reach_s / spacing_s) + 3
        self._moments = np.zeros((NODES, NODES))
        self._count = 0.0
        self.rows = 0
        """Sets of nodes that were learned from."""
        self.step = np.zeros(ORDER + 1)
        """From the nodes to the next one."""
        self.square = nan
        """Of the innovations."""
        self.ahead = np.zeros((self._ahead + 3, ORDER + 1))
        """From the nodes to themselves and those to come: the last three, then the next, and so on."""
        self._usual: Array = np.eye(ORDER + 1)
        """Cholesky's factor of the covariance of the newest nodes."""
        self.grown = np.zeros(self._ahead + 3)
        """Variance of those, of known nodes, over that of the innovations."""

    def learn(self, moments: Array, count: int) -> None:
        """Take sums of products over so many sets of nodes."""
        keep = self._keep**count
        self._moments *= keep
        self._moments += moments
        self._count = keep * self._count + count
        self.rows += count

    def assume(self, square: float) -> None:
        """Before anything is known: any wave motion, of that mean square."""
        f = np.linspace(*TUNING.prior_hz, 80)
        lags = TUNING.node_s * np.arange(NODES)
        shape = np.cos(2.0 * np.pi * np.multiply.outer(lags, f)).mean(axis=1)
        self._moments = TUNING.prior_rows * square * toeplitz(shape)
        self._count = TUNING.prior_rows

    @property
    def covariance(self) -> Array:
        """Of the nodes."""
        covariance: Array = self._moments / self._count
        return covariance

    @property
    def variance(self) -> float:
        """Of the motion."""
        return float(self._moments[0, 0]) / self._count

    def solve(self, noise_square: float) -> bool:
        """Find the model; False: there is none."""
        moments, count = self._moments[OLDEST, OLDEST], self._count
        if not count:
            return False
        gram, aim = moments[1:, 1:].copy(), moments[1:, 0]
        ridge = count * TUNING.ridge * noise_square + TUNING.least_ridge * float(np.trace(gram)) / ORDER
        gram[np.diag_indices(ORDER)] += ridge + 1e-300
        try:
            found = np.linalg.solve(gram, aim)
        except np.linalg.LinAlgError:
            return False
        square = float(moments[0, 0] - 2.0 * found @ aim + found @ moments[1:, 1:] @ found) / count
        self.square = max(square, TUNING.least_ridge * float(moments[0, 0]) / count, 1e-24)
        self.step[:ORDER] = found
        self._look_ahead()
        usual = self._moments[NEWEST, NEWEST] / count
        usual[np.diag_indices(ORDER + 1)] += ridge / count + 1e-300
        self._usual = np.asarray(np.linalg.cholesky(usual), dtype=np.float64)
        return True

    @property
    def few(self) -> float:
        """How much worse it predicts than it fits: more, the fewer rows it is fitted to (Akaike 1970: final prediction
        error).
        """
        rows = min(self.rows, TUNING.memory_s / TUNING.node_s)
        sets = max(0.5 * rows, TUNING.learned_rows)  # neighbours are half the same
        return (sets + ORDER) / (sets - ORDER)

    def oddness(self, nodes: Array) -> float:
        """How far the newest nodes (51,) are from any motion that it has seen: mean square of what they are made of,
        over what that is usually.
        """
        white = solve_triangular(self._usual, nodes, lower=True, check_finite=False)
        return float(white @ white) / len(nodes) / self.few

    def _look_ahead(self) -> None:
        ahead, grown = self.ahead, self.grown
        ahead[:] = 0.0
        ahead[[0, 1, 2], [2, 1, 0]] = 1.0
        echo = np.zeros(self._ahead + ORDER)
        echo[ORDER - 1] = 1.0  # of an innovation at the newest node
        for k in range(3, len(ahead)):
            recent = min(k, ORDER)
            ahead[k] = self.step[:recent] @ ahead[k - 1 :: -1][:recent]
            if recent < ORDER:  # older nodes, which are their own
                ahead[k, 3 : ORDER + 3 - k] += self.step[k:ORDER]
            echo[ORDER + k - 3] = self.step[:ORDER] @ echo[k - 3 : ORDER + k - 3][::-1]
            grown[k] = grown[k - 1] + echo[ORDER + k - 4] ** 2
