"""Exponentially weighted normal equations of the direct predictor: every horizon of an expert from one matrix."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

ROUNDING: Final = 1e-12
"""Least ridge, over the mean diagonal: what double precision leaves of a motion without noise."""
OVERDETERMINED: Final = 1.5
"""Equations per unknown before they are solved."""


def moments_of(rows: Array, used: NDArray[np.bool_]) -> Array:
    """Sums of products (n, w, w) over those of R equations (n, R, w) that are ``used`` (R, n); others may hold nan."""
    if not used.all():
        rows = np.where(used.T[:, :, None], rows, 0.0)
    moments: Array = rows.transpose(0, 2, 1) @ rows
    return moments


class NormalEquations:
    """Moments of [targets | features] per channel, (n, H + p, H + p): the Gram matrix and the right sides in one."""

    def __init__(self, channels: int, targets: int, features: int, memory: float) -> None:
        """``memory``: of how many equations the weight falls to 1/e."""
        self._targets, self._features = targets, features
        self._memory = memory
        self._moments = np.zeros((channels, targets + features, targets + features))
        self._count = np.zeros(channels)

    def add(self, moments: Array, count: Array) -> None:
        """Moments of :func:`moments_of`, or their leading part, and of how many equations, (n,).

        Nothing is forgotten where nothing is learned.
        """
        keep = np.exp(-count / self._memory)
        self._moments *= keep[:, None, None]
        self._moments += moments
        self._count *= keep
        self._count += count

    def solve(self, channel: int, ridge: float, features: Indices | None = None) -> Array | None:
        """Coefficients (H, p) with ``ridge`` per equation added to the diagonal, on these ``features`` alone or on all;
        None: not enough, or not definite."""
        count = float(self._count[channel])
        if features is None:
            features = np.arange(self._features)
        if count < OVERDETERMINED * len(features):
            return None
        h = self._targets
        moments = self._moments[channel]
        there = h + features
        gram = moments[np.ix_(there, there)]
        diagonal = gram.ravel()[:: len(features) + 1]
        diagonal += count * ridge + ROUNDING * float(diagonal.sum()) / len(features) + 1e-300
        _, solution, failed = dposv(gram, moments[there, :h], lower=1)
        if failed:
            return None
        coefficients: Array = solution.T
        return coefficients
