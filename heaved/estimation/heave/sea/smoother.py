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

from heaved.estimation.common.ring import History
from heaved.estimation.heave.sea.model import SeaSystem, Steady
from heaved.samples import DelayedHeave

Array = NDArray[np.float64]

WEIGHTS_BLOCK: Final = 64
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
        self._predicted: deque[tuple[float, float]] = deque(maxlen=count + 1)
        """Time, and heave before the sample was taken in."""
        self._innovations = np.zeros(2 * (count + 1))
        """Each is written twice, so that the last count + 1 always lie in one piece."""
        self._next = 0
        self._whole = 0
        """Samples on end, up to the last one, of which none is missing."""

    def fill(self, end_s: float, predicted_m: Array, innovation: Array) -> None:
        """Start with what the filter of this model would have said at samples up to ``end_s``."""
        size, count = len(self._weights), min(len(predicted_m), len(self._weights))
        times = end_s - self._dt_s * np.arange(count - 1, -1, -1)
        self._predicted.extend(zip(times.tolist(), predicted_m[-count:].tolist(), strict=True))
        self._innovations[:count] = self._innovations[size : size + count] = innovation[-count:]
        self._next = count % size
        missing = np.flatnonzero(np.isnan(predicted_m[-count:]))
        self._whole = count - 1 - int(missing[-1]) if len(missing) else count

    def push(self, t_s: float, predicted_m: float, innovation: float) -> None:
        """One sample more, one interval after the last; innovation 0 where there was none to take in.

        predicted_m: nan where there was none, or where it was predicted with another gain than the steady one.
        """
        at, size = self._next, len(self._weights)
        self._innovations[at] = self._innovations[at + size] = innovation
        self._next = at + 1 if at + 1 < size else 0
        self._predicted.append((t_s, predicted_m))
        self._whole = self._whole + 1 if predicted_m == predicted_m else 0

    def value(self) -> DelayedHeave | None:
        """The newest delayed heave; None while the past is too short, or a sample in it is missing."""
        if self._whole < len(self._weights):
            return None
        t_s, predicted_m = self._predicted[0]
        after = self._innovations[self._next : self._next + len(self._weights)]
        heave_m = predicted_m + float(self._weights.dot(after))
        return DelayedHeave(t_s=t_s, heave_m=heave_m, std_m=self.std_m) if isfinite(heave_m) else None


def _weights(system: SeaSystem, steady: Steady, count: int) -> Array:
    """g_j of the module's formula, j = 0 .. count."""
    # WEIGHTS_BLOCK of them from one row: H' of as many samples on, in columns.
    step = (steady.F @ (np.eye(len(system.H)) - np.outer(steady.K, system.H))).T
    ahead = np.empty((len(system.H), WEIGHTS_BLOCK))
    ahead[:, 0] = system.H / steady.S
    for j in range(1, WEIGHTS_BLOCK):
        ahead[:, j] = step @ ahead[:, j - 1]
    block = np.linalg.matrix_power(step, WEIGHTS_BLOCK)
    row, found = system.heave @ steady.P, []
    for _ in range(0, count + 1, WEIGHTS_BLOCK):
        found.append(row @ ahead)
        row = row @ block
    return np.concatenate(found)[: count + 1]


class Divergence:
    """RMS difference of real-time and delayed heave, over the modelled standard deviation; 1 when that was right."""

    def __init__(self, capacity: int = 1) -> None:
        """``capacity``: how much that was said is kept until the delayed heave of its time is known."""
        self._square, self._seconds, self._t_s = 1.0, 0.0, nan
        self._square_m2 = 0.0
        self._said = History(capacity)

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
        self._said.push((t_s, realtime_m, modelled_std_m))

    def check(self, delayed: DelayedHeave) -> None:
        """:meth:`compare` with what was said for that moment, as far as it is known."""
        _, realtime_m, modelled_std_m = self._said.at(delayed.t_s) or (delayed.t_s, nan, nan)
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
