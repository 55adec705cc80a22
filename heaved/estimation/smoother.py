"""Delayed heave: the fixed-lag smoother of the sea model, as weights on the innovations that came after.

Real-time heave can only use the past. What is known some time later is ten times better (a few thousandths of the
heave), and it is a check on the real-time value that needs no laser.

Rauch, Tung & Striebel 1965 in the form of Bryson & Frazier: with the steady gain, L = F (I - K H), y the innovations,

    h(k | k + J) = h(k | k - 1) + sum_j g_j y(k + j),   g_j = c P (L')^j H' / S,   variance  c P c' - S sum_j g_j^2.
"""

from __future__ import annotations

from collections import deque
from math import isfinite, nan, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from heaved.estimation.ring import Ring
from heaved.estimation.sea_model import SeaSystem, Steady
from heaved.samples import DelayedHeave

Array = NDArray[np.float64]

CHECK_TIME_S: Final = 60.0
"""Memory of the comparison with what was published."""
CHECK_MIN_S: Final = 20.0
"""Seconds of it before it says anything: several waves."""


class FixedLagSmoother:
    """Feed it what the filter said at each sample; it gives the heave of ``delay_s`` ago."""

    def __init__(self, system: SeaSystem, steady: Steady, delay_s: float) -> None:
        self._dt_s = steady.dt_s
        count = max(1, round(delay_s / steady.dt_s))
        self._weights = _weights(system, steady, count)
        variance = float(system.heave @ steady.P @ system.heave) - steady.S * float(self._weights @ self._weights)
        self.std_m = sqrt(max(variance, 0.0))
        self._ring = Ring(count + 1, 3)

    def fill(self, end_s: float, predicted_m: Array, innovation: Array) -> None:
        """Start with what the filter of this model would have said at samples up to ``end_s``."""
        count = len(predicted_m)
        for i in range(max(0, count - len(self._weights)), count):
            self._ring.push((end_s - (count - 1 - i) * self._dt_s, predicted_m[i], innovation[i]))

    def push(self, t_s: float, predicted_m: float, innovation: float) -> None:
        """One sample more, one interval after the last; innovation 0 where there was none to take in."""
        self._ring.push((t_s, predicted_m, innovation))

    def value(self) -> DelayedHeave | None:
        """The newest delayed heave; None while the past is too short."""
        rows = self._ring.last(len(self._weights))
        if len(rows) < len(self._weights):
            return None
        heave = float(rows[0, 1] + self._weights.dot(rows[:, 2]))
        if not isfinite(heave):
            return None
        return DelayedHeave(t_s=float(rows[0, 0]), heave_m=heave, std_m=self.std_m)


def _weights(system: SeaSystem, steady: Steady, count: int) -> Array:
    """g_j of the module's formula, j = 0 .. count."""
    L = steady.F @ (np.eye(len(system.H)) - np.outer(steady.K, system.H))
    g = np.empty(count + 1)
    row = system.heave @ steady.P
    for j in range(count + 1):
        g[j] = row @ system.H / steady.S
        row = row @ L.T
    return g


class Divergence:
    """RMS difference of real-time and delayed heave, over the modelled standard deviation; 1 when that was right."""

    def __init__(self, capacity: int = 1) -> None:
        """``capacity``: how much that was said is kept until the delayed heave of its time is known."""
        self._square, self._seconds, self._t_s = 1.0, 0.0, nan
        self._square_m2 = 0.0
        self._said: deque[tuple[float, float, float]] = deque(maxlen=capacity)

    @property
    def ratio(self) -> float:
        """1 until enough has been compared."""
        return sqrt(self._square) if self._seconds >= CHECK_MIN_S else 1.0

    @property
    def rms_m(self) -> float:
        """The same difference in metres."""
        return sqrt(self._square_m2)

    def say(self, t_s: float, realtime_m: float, modelled_std_m: float) -> None:
        """What is said in real time for ``t_s``, later than the last one."""
        self._said.append((t_s, realtime_m, modelled_std_m))

    def check(self, delayed: DelayedHeave) -> None:
        """:meth:`compare` with what was said for that moment, linear between neighbours; nan outside."""
        said, t_s = self._said, delayed.t_s
        while len(said) > 1 and said[1][0] <= t_s:
            said.popleft()
        if not said or not (said[0][0] == t_s or (said[0][0] < t_s and len(said) > 1)):
            self.compare(delayed, nan, nan)
            return
        before_s, realtime_m, modelled_std_m = said[0]
        if before_s < t_s:
            after_s, after_m, after_std_m = said[1]
            share = (t_s - before_s) / (after_s - before_s)
            realtime_m = (1.0 - share) * realtime_m + share * after_m
            modelled_std_m = (1.0 - share) * modelled_std_m + share * after_std_m
        self.compare(delayed, realtime_m, modelled_std_m)

    def compare(self, delayed: DelayedHeave, realtime_m: float, modelled_std_m: float) -> None:
        """``realtime_m``: what was said in real time for the very moment of ``delayed``."""
        dt = min(delayed.t_s - self._t_s, 1.0) if isfinite(self._t_s) else 0.0
        self._t_s = delayed.t_s
        if not (isfinite(realtime_m) and modelled_std_m > 0.0 and dt > 0.0):
            return
        self._seconds = min(self._seconds + dt, CHECK_TIME_S)
        square = (realtime_m - delayed.heave_m) ** 2 / modelled_std_m**2
        self._square += dt / self._seconds * (square - self._square)
        self._square_m2 += dt / self._seconds * ((realtime_m - delayed.heave_m) ** 2 - self._square_m2)
