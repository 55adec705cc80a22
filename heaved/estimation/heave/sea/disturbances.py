"""What is not of the sea in the acceleration: steps of its level, bursts of noise, single wild readings.

The filter explains everything it is given as waves, noise and a bias that wanders slowly. A sensor that is knocked,
loses a wire or is read wrongly gives it what is none of these, and the heave runs away by metres at a standard
deviation of millimetres. The innovations tell: white, of unit variance over what the model has for them, as long as
all is well. A step of the level leaves a pattern in them that follows from the gain: they are held against it for every
moment at which it may have been (generalised likelihood ratio: Willsky & Jones 1976). When it is found, the readings
since are gone through again with a bias of which nothing is known. If that explains them, it was a step. Else it is
noise: its variance is taken from the innovations and added to the sensor's own for as long as it lasts, so that the
state is known only as well as it then can be.

A blow (:mod:`heaved.estimation.heave.sea.blows`) is a burst at first, from its first reading on. The hull rings, and
the model may have resonances for that: as soon as the readings since then are explained by the filter as it was before,
but with nothing known of what rings, it goes on from there, as if there had been no burst.
"""

from __future__ import annotations

from collections import deque
from enum import Enum, auto
from math import inf, sqrt
from typing import TYPE_CHECKING, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from heaved.estimation.heave.sea.filter import SeaFilter, State
    from heaved.estimation.heave.sea.model import Steady

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What counts as a step, a burst or a blow, in the innovations of the filter."""

    soon: tuple[int, ...] = tuple(range(5, 25))
    """Readings since a step that is looked for at once;"""
    late: tuple[int, ...] = tuple(range(40, 241, 20))
    """since one that is small and shows only in where it leads."""
    too_large: float = 5.5
    """A pattern over its usual RMS; by chance that is so every few days, and costs a little for half a minute."""
    usual_s: float = 60.0
    """Memory of what is usual: a sea that is not quite the model's, a hull that shakes."""
    patience: int = 5
    """Readings that are withheld one after the other before they are judged."""
    explained: float = 5.0
    """Deviations of their mean square from 1 up to which a step explains the innovations since it."""
    first: int = 2
    """Innovations that are left out of that: what the bias is found from."""
    left: float = 0.1
    """Share of the variance of a burst that may be left of it when it was a step."""
    noise_s: float = 1.0
    """Memory of the variance of a burst."""
    quiet: float = 1.0
    """Share of the sensor's own noise that is left of a burst when it is over."""
    burst_s: float = 16.0
    """Noise that lasts longer may be none: what shakes the sensor has changed. From then on the record of it counts,
    and the next fit, which is made at once, learns it. If no fit does, as of stamps that are wrong for a while, it was
    a burst all the same: the record of it is spoilt when it is over."""
    smooth: float = 0.9
    """Most that neighbouring innovations of a burst are alike: noise that is smooth is heavier than its variance
    says."""
    bounded: float = 1.0
    """Innovations count no more than so many deviations in that."""
    mixed: int = 2
    """Readings about a step that may be of both levels: the first that shows it, and the one before."""
    ringing: int = 5
    """Innovations that are left out after a blow: what rings is found from them."""
    rings: int = 14
    """Readings after a blow before it is looked for what rings,"""
    rings_unknown: int = 28
    """and after which the model, that has not explained it yet, does not know what it is,"""
    rings_still: int = 60
    """and after which it has died away."""
    ringing_left: float = 0.2
    """Share of what the readings after a blow have left that their two predecessors do not explain, of a ringing."""
    likelier: float = 0.5
    """A blow has to leave that share of the squares at most of what a step leaves,"""
    surely: int = 24
    """and a step is not told from what rings slowly by fewer."""
    retried: int = 10
    """In a burst, so many readings are tried as those after a step,"""
    retry_s: float = 0.5
    """In a burst, so many readings are tried as those after a step, so often."""


TUNING: Final = Tuning()


class After(Enum):
    """What readings may come after."""

    STEP = auto()
    """Of the level: nothing is known of the bias."""
    BLOW = auto()
    """Nothing is known of what rings."""
    BURST = auto()
    """All is as before."""


class Explanation(NamedTuple):
    """Of the readings since something happened."""

    square: float
    """Mean of the squared innovations over their variances."""
    state: State
    """Of the filter after the last of them."""
    from_s: float
    """Time of the first that counts."""


class DisturbanceDetector:
    """Steps a filter, and takes it back to where it was before what has turned out not to be of the sea.

    Attributes:
        step_s: from the first reading that may be of two levels to the first after a step, when the last reading has
            shown one; None: it has not.
        explained: (time, value) of the readings since either, some of which had been withheld.
        blow_s: from when on the hull rings, when the last reading has shown that; None: it has not.
        held: (time, value) of the readings of the burst that lasts, as long as it may be one.
        is_burst: whether the last reading is of a burst, and not fit to be learned from.
        spoilt_s: the readings since when a burst that the last reading has shown began: they are neither; None: none.
    """

    def __init__(self) -> None:
        self._past: deque[tuple[float, float, State]] = deque(maxlen=TUNING.late[-1])
        """Of each reading: its time and value, and the filter before it."""
        self._scaled = np.zeros(2 * TUNING.late[-1])
        """Their innovations over their deviations; each is written twice, so that all lie in one piece."""
        self._next = 0
        self._of: SeaFilter | None = None
        self._patterns: Array | None = None
        self._steady: Steady | None = None
        self._usual = [1.0, 1.0]
        self._burst_s = self._retry_s = -inf
        self._alike = self._before = 0.0
        self.step_s: tuple[float, float] | None = None
        self.blow_s: float | None = None
        self.explained: tuple[tuple[float, float], ...] = ()
        self._is_struck = False
        """Whether the readings that are kept begin with a blow."""
        self._is_ringing = False
        """Whether the burst is what a blow has left, and is known to be no more."""
        self.is_burst = False
        self.held: list[tuple[float, float]] = []
        self.spoilt_s: tuple[float, float] | None = None

    def step(self, f: SeaFilter, t_s: float, a_mps2: float) -> tuple[float, float]:
        """As :meth:`SeaFilter.step`."""
        self._forget_events()
        if f is not self._of:
            self._of = f
            self.restart()
        self._past.append((t_s, a_mps2, f.state()))
        said = f.step(t_s, a_mps2)
        self._keep(f.innovation / sqrt(f.innovation_variance))
        if f.burst_variance > 0.0:
            self._in_burst(f, t_s)
            if not f.burst_variance > 0.0 and t_s - self._burst_s >= TUNING.burst_s and self.step_s is None:
                self.spoilt_s = self._burst_s, t_s
        elif count := self._suspects(f):
            self._judge(f, count)
        if not f.burst_variance > 0.0:
            f.maybe_off = None
        # What rings after a blow is taken out of the record: the waves are there, beneath.
        self._is_ringing = self._is_ringing and f.burst_variance > 0.0
        self.is_burst = f.burst_variance > 0.0 and t_s - self._burst_s < TUNING.burst_s and not self._is_ringing
        if self.is_burst:
            self.held.append((t_s, a_mps2))
        elif self.held and not f.burst_variance > 0.0:
            self.held = []
        return said

    def strike(self, f: SeaFilter, t_s: float, a_mps2: float, variance: float) -> None:
        """Something has struck the hull since the last reading, and this one is in part of before; ``variance``
        (m/s2)2: what may ring at first. From here on :meth:`step` it, until it is no :attr:`is_guarding` any more, even
        where the model is not good enough to be guarded by.
        """
        self._forget_events()
        self._of = f
        self.restart()
        self._is_struck = self.is_burst = True
        self._is_ringing = False
        self.held = []
        self._past.append((t_s, a_mps2, f.state()))
        f.burst_variance = max(f.burst_variance, variance)
        self._burst_s, self._alike, self._before = t_s, 0.0, 0.0
        self._retry_s = t_s + TUNING.rings * f.steady.dt_s

    @property
    def is_guarding(self) -> bool:
        """Whether something is under way that is not of the sea."""
        return self._of is not None and self._of.burst_variance > 0.0

    def lasting(self) -> list[tuple[float, float]]:
        """The readings that had been held, once, when what was taken for a burst is none."""
        if self.is_burst:
            return []
        held, self.held = self.held, []
        return held

    def rest(self, f: SeaFilter) -> None:
        """The filter goes on unguarded."""
        f.burst_variance, f.maybe_off, self.is_burst = 0.0, None, False
        self.held = []
        self._forget_events()
        self._of = None

    def _forget_events(self) -> None:
        self.step_s = self.spoilt_s = self.blow_s = None
        self.explained = ()

    def restart(self) -> None:
        """Another filter, or a gap: what was seen is not of it."""
        self._past.clear()
        self._scaled[:] = 0.0
        self._is_struck = False

    def _keep(self, scaled: float) -> None:
        at, size = self._next, TUNING.late[-1]
        self._scaled[at] = self._scaled[at + size] = scaled
        self._next = at + 1 if at + 1 < size else 0

    def _suspects(self, f: SeaFilter) -> int:
        """How many of the last readings are to be judged: 0 while all is well, or they are too few to be."""
        patterns = self._patterns
        if patterns is None or self._steady is not f.steady:
            self._steady, self._patterns = f.steady, (patterns := _patterns(f))
        looked = patterns.dot(self._scaled[self._next : self._next + TUNING.late[-1]])
        share = f.steady.dt_s / TUNING.usual_s
        found = 0
        for i, (part, counts) in enumerate(
            ((looked[: len(TUNING.soon)], TUNING.soon), (looked[len(TUNING.soon) :], TUNING.late))
        ):
            limit, total = TUNING.too_large**2 * max(self._usual[i], 1.0), float(part.dot(part))
            if not found and total > limit:  # Else none of them is.
                k = int(abs(part).argmax())
                if part[k] ** 2 > limit:
                    found = counts[k]
            self._usual[i] += share * (min(total / len(counts), limit) - self._usual[i])
        if f.withheld:
            return f.withheld if f.withheld >= TUNING.patience else 0
        return found if found <= len(self._past) else 0

    def _judge(self, f: SeaFilter, count: int) -> None:
        """What are the last ``count`` readings? After a step the filter goes on from it, else in a burst."""
        if count >= len(self._past) or self._is_step(f, count):
            return
        last = min(count, TUNING.soon[-1])
        scaled = self._scaled[self._next + TUNING.late[-1] - last : self._next + TUNING.late[-1]]
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
        found = self._explanation(f, count, After.STEP)
        if found is not None:
            self.step_s = self._past[-count - 1][0], found.from_s
            self._go_on(f, found)
        return found is not None

    def _go_on(self, f: SeaFilter, found: Explanation) -> None:
        """From there."""
        f.restore(found.state)
        self.explained = tuple([(t_s, a_mps2) for t_s, a_mps2, _ in self._past if t_s >= found.from_s])
        self.restart()

    def _explanation(self, f: SeaFilter, count: int, after: After) -> Explanation | None:
        """What the filter makes of the last ``count`` readings from where it was before, if it explains them without
        more noise than its own; it is left as it was. After a step nothing is known of the bias, after a blow nothing
        of what rings, and the readings about it are left out: the mean of some before and some after it is neither.
        """
        count += after is After.STEP
        if count > len(self._past):
            return None
        readings = list(self._past)[-count:]
        now = f.state()
        f.restore(readings[0][2])
        f.withheld, f.burst_variance = 0, 0.0
        first = TUNING.first
        if after is After.STEP:
            f.open_bias()
            readings = readings[TUNING.mixed :]
        elif after is After.BLOW:
            f.open_resonances()
            readings, first = readings[1:], TUNING.ringing
        square = left = told = 0.0
        for i, (t_s, a_mps2, _) in enumerate(readings):
            f.step(t_s, a_mps2)
            if i >= first:
                told += 1.0
                square += f.innovation**2 / f.innovation_variance
                left += f.innovation**2
        is_left = 0.0 < TUNING.left * now.burst_variance * told < left
        is_well = not f.withheld and square <= (told + TUNING.explained * sqrt(2.0 * told)) * max(*self._usual, 1.0)
        found = Explanation(square / max(told, 1.0), f.state(), readings[0][0])
        f.restore(now)
        return found if is_well and not is_left else None

    def _resolve(self, f: SeaFilter) -> None:
        """What the burst is that lasts still: a blow, or a step, if either explains all of it; or it is over."""
        count = len(self._past)
        f.maybe_off = None
        if self._is_struck and count <= TUNING.rings_still:
            blow = self._explanation(f, count, After.BLOW) if f.system.model.resonances else None
            step = self._explanation(f, count - 1, After.STEP)
            if blow is not None and (step is None or blow.square < TUNING.likelier * step.square):
                self.blow_s = self._past[0][0]  # What stands there is in part of after it.
                self._go_on(f, blow)
                # Nothing rings just as the model has it: what that has left in the readings, it has in the state.
                f.P = f.covariance * max(blow.square, 1.0)
                return
            is_sure = count >= TUNING.surely or not f.system.model.resonances
            if step is not None and is_sure:
                self.step_s = self._past[0][0], step.from_s
                self._go_on(f, step)
                return
            if step is not None:
                f.maybe_off = step.state.x - f.x
                return
            if count >= TUNING.rings_unknown:
                self._learn_ringing()
        else:
            self._learn_ringing()
        since = sum(1 for at_s, _, _ in self._past if at_s >= self._burst_s)
        is_blow = self._is_struck or self._is_ringing
        # What is left of a blow rings on, and may do so for long.
        count, after = (TUNING.retried + TUNING.ringing, After.BLOW) if is_blow else (TUNING.retried, After.BURST)
        over = self._explanation(f, count, after)
        if over is not None:
            f.restore(over.state)
            self._doubt_what_rang(f)
            self._learn_ringing()
            self.restart()
        elif not (self._is_ringing or self._is_struck) and not (
            TUNING.retried < since < len(self._past) and self._is_step(f, since)
        ):
            self._is_step(f, TUNING.retried)

    def _doubt_what_rang(self, f: SeaFilter) -> None:
        """What rang was no white noise, as it was taken for, and has left more in the state: as much, perhaps, as the
        state is off that of a filter that was given nothing of it.
        """
        if not (self._is_struck or self._is_ringing) or len(self._past) == TUNING.late[-1]:
            return
        now = f.state()
        f.restore(self._past[0][2])
        f.withheld, f.burst_variance = 0, 0.0
        f.open_resonances()
        for t_s, a_mps2, _ in list(self._past)[1 - TUNING.retried - TUNING.ringing :]:
            f.step(t_s, a_mps2)
        apart = now.x - f.x
        f.restore(now)
        f.P = f.covariance + np.outer(apart, apart)

    def _learn_ringing(self) -> None:
        """A blow that sets something ringing of which the model knows nothing yet: the next fit shall see it."""
        count = len(self._past)
        if not self._is_struck or count < TUNING.rings:
            return
        self._is_struck = False
        y = self._scaled[self._next + TUNING.late[-1] - count + 1 : self._next + TUNING.late[-1]]
        before = np.column_stack((y[1:-1], y[:-2]))
        told = before @ np.linalg.lstsq(before, y[2:], rcond=None)[0]
        if float(np.sum((y[2:] - told) ** 2)) < TUNING.ringing_left * float(np.sum(y[2:] ** 2)):
            self.blow_s = self._past[0][0]
            self.explained = tuple([(t_s, a_mps2) for t_s, a_mps2, _ in self._past])[1:]
            self._is_ringing = True

    def _in_burst(self, f: SeaFilter, t_s: float) -> None:
        """Follow the variance of the noise; see whether it is over, or was a step."""
        share, scaled = f.steady.dt_s / TUNING.noise_s, f.innovation / sqrt(f.innovation_variance)
        bounded = min(max(scaled, -TUNING.bounded), TUNING.bounded)
        self._alike += share * (bounded * self._before - self._alike)
        self._before = bounded
        excess = max(f.innovation**2 - (f.innovation_variance - f.burst_variance), 0.0)
        smooth = min(max(self._alike, 0.0), TUNING.smooth)
        heavier = (1.0 + smooth) / (1.0 - smooth)
        f.burst_variance += share * (heavier * excess - f.burst_variance)
        if f.burst_variance < TUNING.quiet * f.noise_variance:
            f.burst_variance = 0.0
            self._learn_ringing()
            self.restart()
        elif len(self._past) > TUNING.retried and t_s >= self._retry_s:
            self._retry_s = t_s + TUNING.retry_s
            self._resolve(f)


def _patterns(f: SeaFilter) -> Array:
    """(SOON + LATE, LATE[-1]) what a step of the level leaves in the last innovations of the steady filter, by how many
    readings ago it was; of unit length each.
    """
    steady, H = f.steady, f.system.H
    closed = steady.F - np.outer(steady.F @ steady.K, H)
    error, seen = np.zeros(len(H)), np.empty(TUNING.late[-1])
    error[-1] = 1.0
    for k in range(TUNING.late[-1]):
        seen[k] = H @ error
        error = closed @ error
    rows = np.zeros((len(TUNING.soon) + len(TUNING.late), TUNING.late[-1]))
    for row, count in zip(rows, (*TUNING.soon, *TUNING.late), strict=True):
        row[-count:] = seen[:count] / np.linalg.norm(seen[:count])
    return rows
