"""Exponentially weighted normal equations of the direct predictor: every horizon of an expert from one matrix."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

Array = NDArray[np.float64]

ROUNDING: Final = 1e-12
"""Least ridge, over the mean diagonal: what double precision leaves of a motion without noise."""
OVERDETERMINED: Final = 1.5
"""Equations per unknown before they are solved."""


class NormalEquations:
    """Moments of [targets | features] per channel, (n, H + p, H + p): the Gram matrix and the right sides in one."""

    def __init__(self, channels: int, targets: int, features: int, memory: float) -> None:
        """``memory``: of how many equations the weight falls to 1/e."""
        self._targets, self._features = targets, features
        self._memory = memory
        self._moments = np.zeros((channels, targets + features, targets + features))
        self._count = np.zeros(channels)

    def add(self, rows: Array, used: Array) -> None:
        """R equations, (n, R, H + p); ``used`` (R, n) 1 or 0. Nothing is forgotten where nothing is learned."""
        count = used.sum(axis=0)
        keep = np.exp(-count / self._memory)
        self._moments *= keep[:, None, None]
        if count.min() == len(used):
            self._moments += rows.transpose(0, 2, 1) @ rows
        else:
            kept = np.where(used.T[:, :, None] > 0.0, rows, 0.0)
            self._moments += kept.transpose(0, 2, 1) @ kept
        self._count *= keep
        self._count += count

    def forget(self, channel: int) -> None:
        self._moments[channel] = 0.0
        self._count[channel] = 0.0

    def solve(self, channel: int, ridge: float) -> Array | None:
        """Coefficients (H, p) with ``ridge`` per equation added to the diagonal; None: not enough, or not definite."""
        count = float(self._count[channel])
        if count < OVERDETERMINED * self._features:
            return None
        h = self._targets
        moments = self._moments[channel]
        gram = moments[h:, h:].copy()
        diagonal = gram.ravel()[:: self._features + 1]
        diagonal += count * ridge + ROUNDING * float(diagonal.sum()) / self._features + 1e-300
        _, solution, failed = dposv(gram, moments[h:, :h], lower=1)
        if failed:
            return None
        coefficients: Array = solution.T
        return coefficients
