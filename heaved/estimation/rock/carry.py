"""Predictions between the samples that a predictor is fed: along the curve of the last one, moved by what came since.

With innovations e_1 ... e_k of the k samples since a block was fed, each prediction up to 0.5 s is moved by
g . (e_1 ... e_k), where g is the linear regression, per phase k, horizon and channel, of what was missing later,
learned with exponential forgetting. Sensor noise makes g small and spread over all k (a mean); a quiet sensor makes it
an extrapolation. Without it a prediction for 50 ms, made 40 ms ago, has the error of one for 90 ms.
"""

from __future__ import annotations

from math import exp, isfinite
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CORRECTED_S: Final = 0.5
"""Up to this horizon; a newer sample changes little of what lies beyond."""
MEMORY_S: Final = 120.0
RIDGE: Final = 1e-3
"""Over the mean square of the innovations."""
LEARNED_S: Final = 5.0
"""Equations before any correction is made."""
GATE: Final = 6.0
"""An innovation of so many deviations is a spike, or a step that the predictor's own gate has to judge."""
SCALE_MEMORY_S: Final = 20.0
"""Of those deviations: medians, which spikes do not move."""
DEVIATION: Final = 1.4826
"""Standard deviation over median magnitude, of a Gaussian."""


class Carry:
    """Regressions of what was missing on the innovations of a block of ``samples``, for n channels."""

    def __init__(self, samples: int, horizons: int, channels: int, block_s: float) -> None:
        """``horizons``: how many are corrected; ``block_s``: length of a block."""
        self._samples, self._block_s = samples, block_s
        self._gram = np.zeros((channels, samples, samples))
        self._cross = np.zeros((samples, channels, samples, horizons))
        self._equations = np.zeros(channels)
        self._scale = np.full((samples, channels), np.nan)
        self.gate = np.full((samples, channels), np.inf)
        """Largest innovation of each sample of a block that is believed."""
        there = np.tri(samples, dtype=bool)[:, None, :, None]  # (k, 1, sample, 1)
        self._there, self._among = there, there & there.transpose(0, 1, 3, 2)
        self.gains: Array = np.zeros((samples, channels, horizons, samples))
        """By samples that are there, less one: weights of the innovations."""

    def learn(self, innovations: Array, missing: Array) -> None:
        """Blocks (B, k, n), and what was later missing from their predictions (B, k, H, n); nan: not known."""
        size = np.abs(innovations)
        self._follow_scale(size)
        believed = size <= self.gate
        count: Array | float = float(len(innovations))
        if not (believed.all() and isfinite(missing.sum())):
            used = np.logical_and(believed.all(axis=1), np.isfinite(missing).all(axis=(1, 2)))  # (B, n)
            innovations = np.where(used[:, None], innovations, 0.0)
            missing = np.where(used[:, None, None], missing, 0.0)
            count = used.sum(axis=0, dtype=np.float64)
        keep = exp(-len(innovations) * self._block_s / MEMORY_S)
        e = np.ascontiguousarray(innovations.transpose(2, 1, 0))  # (n, k, B)
        self._gram = keep * self._gram + e @ e.transpose(0, 2, 1)
        self._cross = keep * self._cross + e @ missing.transpose(1, 3, 0, 2)
        self._equations = keep * self._equations + count
        enough = self._equations * self._block_s >= LEARNED_S
        if enough.any():
            self._solve(enough)

    def _follow_scale(self, size: Array) -> None:
        size = np.sort(size, axis=0)  # what is not known is last
        middle = size[(len(size) - 1) // 2]
        if not isfinite(size[-1].sum()):
            half = np.maximum(np.isfinite(size).sum(axis=0) - 1, 0) // 2
            middle = np.take_along_axis(size, half[None], axis=0)[0]  # nan: nothing is known
        scale = DEVIATION * middle
        share = min(len(size) * self._block_s / SCALE_MEMORY_S, 1.0)
        followed = np.where(np.isnan(self._scale), scale, self._scale + share * (scale - self._scale))
        self._scale = np.where(np.isnan(followed), self._scale, followed)
        self.gate = np.where(np.isnan(self._scale), np.inf, GATE * self._scale)

    def _solve(self, enough: NDArray[np.bool_]) -> None:
        squares = np.einsum("njj->jn", self._gram)
        ridge = RIDGE * squares.mean(axis=0)[:, None, None] + 1e-300
        # All at once: for k samples the leading k equations, the others made to say nothing.
        one = np.eye(self._samples)
        gram = np.where(self._among, self._gram + ridge * one, one)
        found = np.linalg.solve(gram, np.where(self._there, self._cross, 0.0))
        self.gains = np.where(enough[:, None, None], found, 0.0).transpose(0, 1, 3, 2)
