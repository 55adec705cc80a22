"""Which of several filters serves each channel: the one that has lately predicted its readings best.

Source: CN 104787260 A, where the filter with the smaller evaluation wins at every instant: that is ``memory_s = 0``.
The evaluation is the squared innovation before the update, which needs no truth.

Among predictions it is another question (:class:`heaved.estimation.rock.experts.Switch`): their errors are known a
horizon later, an expert may be unavailable, and what is wanted is how far off the chosen one will be, too.
"""

from __future__ import annotations

from math import exp

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class BestOf:
    """Averages the squared errors of every candidate, per channel, and says which is best.

    Attributes:
        serving: the candidate that serves each channel.
        switches: changes so far, all channels together.
    """

    def __init__(self, candidates: int, channels: int, memory_s: float, margin: float) -> None:
        """``memory_s``: of the average. ``margin``: share by which another must be better to take over."""
        self._candidates, self._channels = candidates, channels
        self._memory_s, self._margin = memory_s, margin
        self.switches = 0
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen; the last candidate serves."""
        self._mean_squares = np.zeros((self._channels, self._candidates))
        self._seen_s = [0.0] * self._channels
        self.serving = [self._candidates - 1] * self._channels

    def step(self, channel: int, dt_s: float, errors: Array) -> None:
        """Take the errors (candidates,) of one reading; sooner averaged while little has been seen."""
        self._seen_s[channel] = min(self._seen_s[channel] + dt_s, self._memory_s)
        share = 1.0 - exp(-dt_s / self._seen_s[channel]) if self._memory_s > 0.0 else 1.0
        mean_squares, serving = self._mean_squares[channel], self.serving[channel]
        mean_squares += share * (errors**2 - mean_squares)
        best = int(mean_squares.argmin())
        if mean_squares[best] < (1.0 - self._margin) * mean_squares[serving]:
            self.switches += 1
            self.serving[channel] = best

    def serve_all(self, chosen: int) -> None:
        """One candidate, found otherwise, serves every channel: that is one change."""
        serving = [chosen] * self._channels
        self.switches += serving != self.serving
        self.serving = serving
