"""What is never published of a predicted motion: what no ship does."""

from __future__ import annotations

from functools import cache
from math import inf, nan
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.bounds import ANGLE_RAD, ANGLE_RATE_RADPS

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]


class Limits(msgspec.Struct, frozen=True):
    """What channels that are predicted never do."""

    largest: tuple[float, ...]
    """Magnitude of each of n channels."""
    rate: float
    """Of all of them, per second."""

    def left_by(self, curves: Array, at_s: tuple[float, ...]) -> NDArray[np.bool_]:
        """Which of the values (..., H, n) at H moments lie beyond the limits, or cannot follow the one before; what is
        not known does neither.
        """
        largest, steps = _largest(self, at_s)
        beyond: NDArray[np.bool_] = np.abs(curves) > largest
        beyond[..., 1:, :] |= np.abs(curves[..., 1:, :] - curves[..., :-1, :]) > steps
        return beyond

    def hold(self, rows: Sequence[Sequence[float]], at_s: tuple[float, ...]) -> bool:
        """Whether none of the values (H rows of n) is beyond them."""
        before, before_s, rate = rows[0], at_s[0], self.rate
        for row, now_s in zip(rows, at_s, strict=True):
            step = rate * (now_s - before_s)
            for x, last, largest in zip(row, before, self.largest, strict=True):
                if x > largest or x < -largest or x - last > step or last - x > step:
                    return False
            before, before_s = row, now_s
        return True

    def kept(self, curves: Array, at_s: tuple[float, ...]) -> Array:
        """The same values; nan from where on the limits are left."""
        beyond = self.left_by(curves, at_s)
        return np.where(np.logical_or.accumulate(beyond, axis=-2), nan, curves) if beyond.any() else curves


USELESS_RAD: Final = ANGLE_RAD
"""A prediction that may be off by all that a ship does is none."""

LIMITS: Final = Limits((ANGLE_RAD, ANGLE_RAD, inf), ANGLE_RATE_RADPS)
"""Of roll, pitch and yaw."""


def possible(angle_rad: float) -> float:
    """Roll or pitch; nan if no ship has it."""
    return angle_rad if -ANGLE_RAD <= angle_rad <= ANGLE_RAD else nan


@cache
def _largest(limits: Limits, at_s: tuple[float, ...]) -> tuple[Array, Array]:
    """Values, and changes from one moment to the next."""
    return np.array(limits.largest), limits.rate * np.diff(at_s)[:, None]
