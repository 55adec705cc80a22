"""From one model to the next without a jump: the difference between the two at the change is faded out.

Heave and velocity differ by h and v at the change; with e the time since,

    d(e) = (h + (v + h/T) e) exp(-e/T),

critically damped, takes both to zero without an edge in either.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, inf
from typing import Final

TIME_S: Final = 1.5
"""Time constant T."""
LASTS: Final = 12.0
"""Time constants after which it is over: a ten-thousandth is left."""


class Splice:
    """A difference of heave (m) and velocity (m/s) at ``since_s``.

    Attributes:
        until_s: from then on it is nothing.
    """

    def __init__(self, heave_m: float, velocity_mps: float, since_s: float) -> None:
        self._heave_m, self._slope_mps = heave_m, velocity_mps + heave_m / TIME_S
        self._since_s, self.until_s = since_s, since_s + LASTS * TIME_S

    def at(self, t_s: float) -> tuple[float, float]:
        """What is left at ``t_s``: heave and velocity."""
        if not t_s < self.until_s:
            return 0.0, 0.0
        elapsed = max(t_s - self._since_s, 0.0)
        fade, linear = exp(-elapsed / TIME_S), self._heave_m + self._slope_mps * elapsed
        return linear * fade, (self._slope_mps - linear / TIME_S) * fade

    def heaves(self, t_s: float, ahead: Sequence[tuple[float, float]]) -> list[float]:
        """What is left of the heave at several moments after ``t_s``, which is before the end and after the change.

        ahead: seconds on, and :func:`fade` of them, which costs more than all the rest.
        """
        elapsed, until_s = max(t_s - self._since_s, 0.0), self.until_s
        now, heave_m, slope = exp(-elapsed / TIME_S), self._heave_m, self._slope_mps
        return [(heave_m + slope * (elapsed + s)) * (now * faded) if t_s + s < until_s else 0.0 for s, faded in ahead]


def fade(seconds: float) -> float:
    """exp(-s/T)."""
    return exp(-seconds / TIME_S)


NO_SPLICE: Final = Splice(0.0, 0.0, -inf)
