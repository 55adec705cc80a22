"""What is not of the sea in the acceleration: steps of its level, bursts of noise, single wild readings.

The filter explains everything it is given as waves, noise and a bias that wanders slowly. A sensor that is knocked,
loses a wire or is read wrongly gives it what is none of these, and the heave runs away by metres at a standard
deviation of millimetres. The innovations tell: white, of unit variance over what the model has for them, as long as
all is well. A step of the level leaves a pattern in them that follows from the gain: they are held against it for every
moment at which it may have been (generalised likelihood ratio: Willsky & Jones 1976). When it is found, the readings
since are gone through again with a bias of which nothing is known. If that explains them, it was a step. Else it is
noise: its variance is taken from the innovations and added to the sensor's own for as long as it lasts, so that the
state is known only as well as it then can be.

A blow (:mod:`sea_blows`) sets the hull ringing. The model has resonances for that, and of what they do nothing is known
from then on; the reading in which it falls is left out. Some readings later it is seen whether a step of the level
explains them better.
"""

from __future__ import annotations

from collections import deque
from math import inf, nan, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from heaved.estimation.sea_filter import SeaFilter, State
from heaved.estimation.sea_model import Steady

Array = NDArray[np.float64]

SOON: Final = tuple(range(5, 25))
"""Readings since a step that is looked for at once;"""
LATE: Final = tuple(range(40, 241, 20))
"""since one that is small and shows only in where it leads."""
TOO_LARGE: Final = 5.5
"""A pattern over its usual RMS; by chance that is so every few days, and costs a little for half a minute."""
USUAL_S: Final = 60.0
"""Memory of what is usual: a sea that is not quite the model's, a hull that shakes."""
PATIENCE: Final = 5
"""Readings that are withheld one after the other before they are judged."""
EXPLAINED: Final = 5.0
"""Deviations of their mean square from 1 up to which a step explains the innovations since it."""
FIRST: Final = 2
"""Innovations that are left out of that: what the bias is found from."""
LEFT: Final = 0.1
"""Share of the variance of a burst that may be left of it when it was a step."""
NOISE_S: Final = 1.0
"""Memory of the variance of a burst."""
QUIET: Final = 1.0
"""Share of the sensor's own noise that is left of a burst when it is over."""
BURST_S: Final = 20.0
"""Noise that lasts longer is no burst: from then on the record of it counts, and the next fit learns it."""
SMOOTH: Final = 0.9
"""Most that neighbouring innovations of a burst are alike: noise that is smooth is heavier than its variance says."""
BOUNDED: Final = 1.0
"""Innovations count no more than so many deviations in that."""
MIXED: Final = 2
"""Readings about a step that may be of both levels: the first that shows it, and the one before."""
RINGING: Final = 5
"""Innovations that are left out after a blow: what rings is found from them."""
RINGS: Final = 14
"""Readings after a blow when it is told from a step."""
LIKELIER: Final = 0.5
"""A step has to leave that share of the squares at most of what a blow leaves."""
RETRIED: Final = 10
RETRY_S: Final = 0.5
"""In a burst, so many readings are tried as those after a step, so often."""


class Guard:
    """Steps a filter.

    Attributes:
        step_s: from the first reading that may be of two levels to the first after a step, when the last reading has
            shown one; None: it has not.
        since_step: (time, value) of the readings since then, some of which had been withheld.
        blow_s: of the first reading after a blow, and
        no_blow_s: of one that has turned out to be a step; None: there was none.
        is_burst: whether the last reading is of a burst, and not fit to be learned from.
        spoilt_s: the readings since when a burst that the last reading has shown began: they are neither; None: none.
    """

    def __init__(self) -> None:
        self._past: deque[tuple[float, float, State]] = deque(maxlen=LATE[-1])
        """Of each reading: its time and value, and the filter before it."""
        self._scaled = np.zeros(2 * LATE[-1])
        """Their innovations over their deviations; each is written twice, so that all lie in one piece."""
        self._next = 0
        self._of: SeaFilter | None = None
        self._patterns: Array | None = None
        self._steady: Steady | None = None
        self._usual = [1.0, 1.0]
        self._burst_s = self._retry_s = -inf
        self._alike = self._before = 0.0
        self.step_s: tuple[float, float] | None = None
        self.since_step: tuple[tuple[float, float], ...] = ()
        self.blow_s: float | None = None
        self.no_blow_s: float | None = None
        self._struck: list[float] | None = None
        """Squares of the scaled innovations since a blow, until it is known to be one."""
        self._at_s = self._square = nan
        self.is_burst = False
        self.spoilt_s: tuple[float, float] | None = None

    def step(self, f: SeaFilter, t_s: float, a_mps2: float) -> tuple[float, float]:
        """As :meth:`SeaFilter.step`."""
        self._forget_events()
        if f is not self._of:
            self._of = f
            self.restart()
        self._past.append((t_s, a_mps2, f.state()))
        said = f.step(t_s, a_mps2)
        scaled = f.innovation / sqrt(f.innovation_variance)
        if self._struck is not None:
            self._struck.append(scaled**2)
            self._keep(0.0)
            if len(self._struck) == RINGS:
                self._tell(f)
            return said
        self._keep(scaled)
        if f.burst_variance > 0.0:
            self._in_burst(f, t_s)
        elif count := self._suspects(f):
            self._judge(f, count)
        self.is_burst = f.burst_variance > 0.0 and t_s - self._burst_s < BURST_S
        return said

    def strike(self, f: SeaFilter, t_s: float, a_mps2: float) -> None:
        """Something has struck the hull since the last reading, and this one is in part of before."""
        self._forget_events()
        f.burst_variance, self.is_burst = 0.0, False
        if f is self._of:
            self.restart()
            self._past.append((t_s, a_mps2, f.state()))
            self._struck = []
        f.open_resonances()
        self.blow_s = t_s

    def _tell(self, f: SeaFilter) -> None:
        """Whether what began as a blow was a step of the level."""
        assert self._struck is not None
        blow = float(np.mean(self._struck[RINGING:]))
        self._struck = None
        count = RINGS
        now = f.state()
        at_s = self._past[-count - 1][0] if count < len(self._past) else nan
        if count < len(self._past) and self._goes_through(f, count, is_step=True):
            if self._square < LIKELIER * blow:
                self.since_step = tuple([(t_s, a_mps2) for t_s, a_mps2, _ in self._past if t_s >= self._at_s])
                self.step_s, self.no_blow_s = (at_s, self._at_s), at_s
                self.restart()
            else:
                f.restore(now)

    def rest(self, f: SeaFilter) -> None:
        """The filter goes on unguarded."""
        f.burst_variance, self.is_burst = 0.0, False
        self._forget_events()
        self._of = self._struck = None

    def _forget_events(self) -> None:
        self.step_s = self.spoilt_s = self.blow_s = self.no_blow_s = None

    def restart(self) -> None:
        """Another filter, or a gap: what was seen is not of it."""
        self._past.clear()
        self._scaled[:] = 0.0
        self._struck = None

    def _keep(self, scaled: float) -> None:
        at, size = self._next, LATE[-1]
        self._scaled[at] = self._scaled[at + size] = scaled
        self._next = at + 1 if at + 1 < size else 0

    def _suspects(self, f: SeaFilter) -> int:
        """How many of the last readings are to be judged: 0 while all is well, or they are too few to be."""
        patterns = self._patterns
        if patterns is None or self._steady is not f.steady:
            self._steady, self._patterns = f.steady, (patterns := _patterns(f))
        squares = patterns.dot(self._scaled[self._next : self._next + LATE[-1]]) ** 2
        share = f.steady.dt_s / USUAL_S
        found = 0
        for i, part in enumerate((squares[: len(SOON)], squares[len(SOON) :])):
            limit = TOO_LARGE**2 * max(self._usual[i], 1.0)
            k = int(part.argmax())
            if not found and part[k] > limit:
                found = (SOON, LATE)[i][k]
            self._usual[i] += share * (min(float(part.mean()), limit) - self._usual[i])
        if f.withheld:
            return f.withheld if f.withheld >= PATIENCE else 0
        return found if found <= len(self._past) else 0

    def _judge(self, f: SeaFilter, count: int) -> None:
        """What are the last ``count`` readings? After a step the filter goes on from it, else in a burst."""
        if count >= len(self._past) or self._is_step(f, count):
            return
        last = min(count, SOON[-1])
        scaled = self._scaled[self._next + LATE[-1] - last : self._next + LATE[-1]]
        variance = float(np.mean(scaled**2)) * f.innovation_variance
        suspects = list(self._past)[-last:]
        f.restore(suspects[0][2])
        f.withheld, f.burst_variance = 0, variance
        for t_s, a_mps2, _ in suspects:
            f.step(t_s, a_mps2)
        self._burst_s, self._alike, self._before = suspects[0][0], 0.0, 0.0
        self.spoilt_s = suspects[0][0], suspects[-1][0]

    def _is_step(self, f: SeaFilter, count: int) -> bool:
        """Whether a step explains the last ``count`` readings; if it does, the filter has gone through them again."""
        skipped = self._past[-count - 1][0]
        if not self._goes_through(f, count, is_step=True):
            return False
        self.since_step = tuple([(t_s, a_mps2) for t_s, a_mps2, _ in self._past if t_s >= self._at_s])
        self.restart()
        self.step_s = skipped, self._at_s
        return True

    def _goes_through(self, f: SeaFilter, count: int, *, is_step: bool) -> bool:
        """Whether the filter explains the last ``count`` readings from where it was before, without more noise than its
        own; if it does not, it is left as it was. After a step nothing is known of the bias, and the readings about it
        are left out: the mean of some before and some after it is neither."""
        readings = list(self._past)[-count - is_step :]
        now = f.state()
        f.restore(readings[0][2])
        f.withheld, f.burst_variance = 0, 0.0
        if is_step:
            f.open_bias()
            readings = readings[MIXED:]
        self._at_s = readings[0][0]
        square = left = told = 0.0
        for i, (t_s, a_mps2, _) in enumerate(readings):
            f.step(t_s, a_mps2)
            if i >= FIRST:
                told += 1.0
                square += f.innovation**2 / f.innovation_variance
                left += f.innovation**2
        self._square = square / max(told, 1.0)
        is_left = 0.0 < LEFT * now.burst_variance * told < left
        if f.withheld or square > (told + EXPLAINED * sqrt(2.0 * told)) * max(*self._usual, 1.0) or is_left:
            f.restore(now)
            return False
        return True

    def _in_burst(self, f: SeaFilter, t_s: float) -> None:
        """Follow the variance of the noise; see whether it is over, or was a step."""
        share, scaled = f.steady.dt_s / NOISE_S, f.innovation / sqrt(f.innovation_variance)
        bounded = min(max(scaled, -BOUNDED), BOUNDED)
        self._alike += share * (bounded * self._before - self._alike)
        self._before = bounded
        excess = max(f.innovation**2 - (f.innovation_variance - f.burst_variance), 0.0)
        smooth = min(max(self._alike, 0.0), SMOOTH)
        heavier = (1.0 + smooth) / (1.0 - smooth)
        f.burst_variance += share * (heavier * excess - f.burst_variance)
        if f.burst_variance < QUIET * f.noise_variance:
            f.burst_variance = 0.0
            self.restart()
        elif len(self._past) > RETRIED and t_s >= self._retry_s:
            self._retry_s = t_s + RETRY_S
            since = sum(1 for at_s, _, _ in self._past if at_s >= self._burst_s)
            if self._goes_through(f, RETRIED, is_step=False):
                self.restart()
            elif not (RETRIED < since < len(self._past) and self._is_step(f, since)):
                self._is_step(f, RETRIED)


def _patterns(f: SeaFilter) -> Array:
    """(SOON + LATE, LATE[-1]) what a step of the level leaves in the last innovations of the steady filter, by how many
    readings ago it was; of unit length each."""
    steady, H = f.steady, f.system.H
    closed = steady.F - np.outer(steady.F @ steady.K, H)
    error, seen = np.zeros(len(H)), np.empty(LATE[-1])
    error[-1] = 1.0
    for k in range(LATE[-1]):
        seen[k] = H @ error
        error = closed @ error
    rows = np.zeros((len(SOON) + len(LATE), LATE[-1]))
    for row, count in zip(rows, (*SOON, *LATE), strict=True):
        row[-count:] = seen[:count] / np.linalg.norm(seen[:count])
    return rows
