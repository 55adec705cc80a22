"""From one model to the next without a jump: the difference between the two at the change is faded out.

Heave and velocity differ by h and v at the change; with e the time since,

    d(e) = (h + (v + h/T) e) exp(-e/T),

critically damped, takes both to zero without an edge in either.
"""

from __future__ import annotations

from math import exp, inf, log
from typing import Final

TIME_S: Final = 1.5
"""Time constant T."""
LEAST_M: Final = 1e-5
"""It is over when less than that is left."""


class Splice:
    """A difference of heave (m) and velocity (m/s) at ``since_s``.

    Attributes:
        until_s: from then on it is nothing.
    """

    def __init__(self, heave_m: float, velocity_mps: float, since_s: float) -> None:
        self._heave_m, self._slope_mps = heave_m, velocity_mps + heave_m / TIME_S
        self._since_s = since_s
        lasts = 1.0  # time constants, from (|h| + |v + h/T| e) exp(-e/T) = LEAST_M
        for _ in range(20):
            most_m = abs(heave_m) + abs(self._slope_mps) * TIME_S * lasts
            lasts = log(max(most_m / LEAST_M, 1.0)) if most_m < inf else 0.0
        self.until_s = since_s + lasts * TIME_S

    def at(self, t_s: float) -> tuple[float, float]:
        """What is left at ``t_s``: heave and velocity."""
        if not t_s < self.until_s:
            return 0.0, 0.0
        linear, slope, elapsed = self.state(t_s)
        fade = exp(-elapsed / TIME_S)
        return linear * fade, (slope - linear / TIME_S) * fade

    def state(self, t_s: float) -> tuple[float, float, float]:
        """h + (v + h/T) e, v + h/T and e at ``t_s``: later moments follow from them."""
        elapsed = max(t_s - self._since_s, 0.0)
        return self._heave_m + self._slope_mps * elapsed, self._slope_mps, elapsed


NO_SPLICE: Final = Splice(0.0, 0.0, -inf)
