"""Inference of the residual network: d inputs, one hidden sigmoid layer, one output.

Source: Zhang et al. 2022 (UKF multi-step + BP), eq. (15), (16): thresholds are subtracted. The input is the last d
observer outputs, the output the residual laser - observer that is added to the observer, eq. (17). The source has a
sigmoid on the output as well, which can only yield 0..1; the default here is a linear output.

Inputs and target are standardised with the statistics of the training window: one mean and one deviation for all
inputs, because they are one signal at d times. Training itself is torch and lives elsewhere; this is numpy.
"""

from __future__ import annotations

from enum import Enum

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIGMOID_PER_STD = 0.1
"""Sigmoid output only: 0.5 is the mean target, and 0.1 one standard deviation, so that 0.1..0.9 holds +-4 of them."""


class Output(Enum):
    """What the output of a network is made with."""

    LINEAR = "linear"
    SIGMOID = "sigmoid"


class Network(msgspec.Struct, frozen=True, eq=False, gc=False, kw_only=True):
    """Weights in standardised units, and the statistics (metres) that lead there and back."""

    W1: Array
    """(hidden, width)."""
    b1: Array
    """(hidden,) thresholds, subtracted."""
    w2: Array
    """(hidden,)."""
    b2: float
    """Threshold of the output, subtracted."""
    input_mean_m: float
    input_std_m: float
    target_mean_m: float
    target_std_m: float
    output: Output

    @property
    def hidden(self) -> int:
        """Units in the hidden layer."""
        return int(self.W1.shape[0])

    @property
    def width(self) -> int:
        """Inputs."""
        return int(self.W1.shape[1])

    def predict(self, window: Array) -> float:
        """Residual (m) for one window (width,) of observer outputs (m), oldest first."""
        net = self.W1.dot((window - self.input_mean_m) / self.input_std_m) - self.b1
        return float(self._unstandardised(self.w2.dot(_sigmoid(net)) - self.b2))

    def predict_many(self, windows: Array) -> Array:
        """Residuals (n,) for windows (n, width)."""
        net = ((windows - self.input_mean_m) / self.input_std_m).dot(self.W1.T) - self.b1
        return np.asarray(self._unstandardised(_sigmoid(net).dot(self.w2) - self.b2))

    def to_bytes(self) -> bytes:
        """The flat little-endian float64 layout of ``TrainedNetwork.weights``."""
        scalars = (self.b2, self.input_mean_m, self.input_std_m, self.target_mean_m, self.target_std_m)
        return np.concatenate((self.W1.ravel(), self.b1, self.w2, scalars)).astype("<f8").tobytes()

    @classmethod
    def from_bytes(cls, weights: bytes, width: int, hidden: int, output: str) -> Network:
        """The inverse of ``to_bytes``; the bytes may come from another process or an old file, so they are checked.

        Raises:
            ValueError: a size that does not fit, a value that is not finite, a deviation that is not positive, or an
                unknown kind of output.
        """
        kinds = [kind.value for kind in Output]
        if output not in kinds:
            raise ValueError(f"network: output {output!r} is none of {', '.join(kinds)}")
        if width < 1 or hidden < 1:
            raise ValueError(f"network: {width} inputs and {hidden} hidden units; both must be at least 1")
        expected = 8 * (hidden * width + 2 * hidden + 5)
        if len(weights) != expected:
            raise ValueError(f"network: {len(weights)} bytes of weights, but {width}-{hidden}-1 takes {expected}")
        values = np.frombuffer(weights, "<f8").astype(np.float64)
        if not np.isfinite(values).all():
            raise ValueError("network: weights are not finite")
        W1, b1, w2, scalars = np.split(values, np.cumsum((hidden * width, hidden, hidden)))
        b2, input_mean, input_std, target_mean, target_std = scalars.tolist()
        if input_std <= 0.0 or target_std <= 0.0:
            raise ValueError(f"network: standard deviations {input_std} and {target_std} m must be positive")
        return cls(
            W1=W1.reshape(hidden, width),
            b1=b1,
            w2=w2,
            b2=b2,
            input_mean_m=input_mean,
            input_std_m=input_std,
            target_mean_m=target_mean,
            target_std_m=target_std,
            output=Output(output),
        )

    def _unstandardised(self, net: Array) -> Array:
        if self.output is Output.SIGMOID:
            net = (_sigmoid(net) - 0.5) / SIGMOID_PER_STD
        return net * self.target_std_m + self.target_mean_m


def _sigmoid(net: Array) -> Array:
    """1 / (1 + exp(-net)), written so that no input overflows."""
    return 0.5 + 0.5 * np.tanh(0.5 * net)
