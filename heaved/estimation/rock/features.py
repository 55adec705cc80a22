"""What the direct predictor sees of the past: of each channel one vector of sums and samples, and linear maps of it.

Features, extrapolation and the latest block are linear in the samples and running sums of :class:`SampleWindow`, and a
prediction is linear in those. So one matrix leads from what is gathered to what is published, made when the
coefficients are; features are made of many rows at once, when they are learned from.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from heaved.estimation.rock.lags import Indices, SampleWindow

Array = NDArray[np.float64]

RATE_LAGS: Final = 4
RATE_SCALE_S: Final = 0.1
"""Makes an angular rate commensurate with differences of angles over a step or two."""


class Regressors:
    """Of n channels, from a window with the columns [channels | their rates, if there are any | their slow means].

    The vector of a channel is [sums | those of its rate | slow mean | samples, latest first]; maps are matrices on it.
    """

    def __init__(self, window: SampleWindow, channels: int, taps: Array, *, rates: bool) -> None:
        """``taps`` (m, W): weights on the last W samples, oldest first."""
        self._window = window
        lags, sums = window.weights.shape
        rate_sums = RATE_LAGS + 2 if rates else 0
        mean, sample = sums + rate_sums, sums + rate_sums + 1
        self.width = sample + taps.shape[1]
        self._places: Indices = np.array(
            [
                np.concatenate(
                    [
                        window.sums_at(c),
                        window.sums_at(channels + c)[:rate_sums] if rates else [],
                        window.samples_at((2 if rates else 1) * channels + c, 1),
                        window.samples_at(c, taps.shape[1]),
                    ]
                )
                for c in range(channels)
            ],
            dtype=np.intp,
        )
        self._reach = -(int(self._places.min()) // window.width)
        self._recent = self._places + self._reach * window.width
        self.sample = np.zeros(self.width)
        """The latest sample itself."""
        self.sample[sample] = 1.0
        self.block = np.zeros(self.width)
        """The latest block: the mean about the first knot."""
        self.block[:sums] = window.weights[0]
        self.taps = np.zeros((len(taps), self.width))
        self.taps[:, sample:] = taps[:, ::-1]
        fronts = 1 + (RATE_LAGS if rates else 0)
        self.rate_features = slice(1, fronts)
        """Those of them that are rates."""
        self.features = np.zeros((fronts + lags - 1, self.width))
        """(p, width): the slow mean, the rates, the means about the other knots, all but the rates less the block."""
        self.features[0, mean] = 1.0
        self.features[1:fronts, sums:mean] = RATE_SCALE_S * window.weights[: fronts - 1, :rate_sums]
        self.features[fronts:, :sums] = window.weights[1:]
        self.features[0] -= self.block
        self.features[fronts:] -= self.block

    def now(self) -> Array:
        """The vectors, (n, width)."""
        return self._window.latest(self._recent, self._reach)

    def at(self, ends: Indices) -> Array:
        """The vectors as they were before the rows ``ends`` (R,), (R, n, width)."""
        return self._window.gather(self._places, ends[:, None, None])
