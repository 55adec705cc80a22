"""Which of several filters serves each channel: the one that has lately predicted its readings best. Pure.

Source: CN 104787260 A, where the filter with the smaller evaluation wins at every instant: that is ``memory_s = 0``.
The evaluation is the squared innovation before the update, which needs no truth.
"""

from __future__ import annotations

from math import exp

import numpy as np
from numpy.typing import NDArray

from heaved.estimation.craft.inputs import Channel

Array = NDArray[np.float64]


class Choice:
    """Keeps the evaluations.

    Attributes:
        serving: the filter that serves each channel.
        switches: changes so far, all channels together.
    """

    def __init__(self, filters: int, memory_s: float, margin: float) -> None:
        """``memory_s``: of the averaged evaluation. ``margin``: share by which another must be better to take over."""
        self._filters, self._memory_s, self._margin = filters, memory_s, margin
        self.switches = 0
        self.forget()

    def forget(self) -> None:
        """No evaluation yet; the last filter serves."""
        self._scores = np.zeros((len(Channel), self._filters))
        self._scored_s = [0.0] * len(Channel)
        self.serving = [self._filters - 1] * len(Channel)

    def evaluate(self, channel: Channel, dt_s: float, innovations: Array) -> None:
        """Take the innovations (filters,) of one reading; sooner averaged while little has been seen."""
        self._scored_s[channel] = min(self._scored_s[channel] + dt_s, self._memory_s)
        share = 1.0 - exp(-dt_s / self._scored_s[channel]) if self._memory_s > 0.0 else 1.0
        self._scores[channel] += share * (innovations**2 - self._scores[channel])
        scores, serving = self._scores[channel], self.serving[channel]
        best = int(scores.argmin())
        if scores[best] < (1.0 - self._margin) * scores[serving]:
            self.switches += 1
            self.serving[channel] = best

    def serve_all(self, chosen: int) -> None:
        """One filter, found otherwise, serves every channel: that is one change."""
        if self.serving != [chosen] * len(Channel):
            self.switches += 1
        self.serving = [chosen] * len(Channel)
