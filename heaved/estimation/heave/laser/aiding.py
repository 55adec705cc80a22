"""Whether a laser may aid the sea observer: it is checked before, watched while it does, and left when it is not right.

What the accelerometer knows is worth more than the laser on the scale of seconds, and the laser more on that of
minutes. A laser that left its target is therefore seen at once by the filter that it aids, and is never allowed to drag
the heave: each reading is held against what is expected of it, with the standard deviation of that difference. When
most of them are refused for some seconds the aid ends: the filter that has gone on beside it, without the laser, takes
over, with its own standard deviation, and all that the laser taught is forgotten. It begins again, with a new constant,
as soon as the readings follow that filter's heave with the slope, the moment and the scatter that are due.
"""

from __future__ import annotations

from collections import deque
from math import hypot, inf, isfinite, nan, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.laser import lead
from heaved.estimation.heave.sea.filter import TUNING as FILTER
from heaved.estimation.heave.sea.filter import GaugeError, SeaFilter

if TYPE_CHECKING:
    from heaved.estimation.heave.sea.output import SeaHeave

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """When a reading is taken in, when the aid begins and when it ends."""

    gate: float = 4.5
    """Readings further off than this many standard deviations are not used: by chance one of 150 000, and nothing is
    lost with it."""
    late_s: float = 1.0
    """A reading that comes later than this is not worth the process noise that it would miss."""
    stop_s: float = 3.0
    """Refused for so much longer than taken, the readings are of another target."""
    silent_s: float = 1.0
    """One reading counts for at most so long."""
    every_s: float = 0.05
    """Readings closer together are left out of the check."""
    check_s: tuple[float, float] = (15.0, 60.0)
    """Length of the check: two waves at least; longer where the accelerometer needs it."""
    checked_every_s: float = 1.0
    """Interval at which the readings collected so far are looked at."""
    check_readings: int = 12
    """Of four unknowns."""
    check_std: float = 0.05
    """Standard error of the slope up to which a check says anything."""
    surely: float = 2.0
    """Standard errors that are in favour of a laser before it aids."""
    scatter: float = 3.0
    """The readings may be off by that many times what is due to accelerometer and noise."""
    moved: float = 2.0
    """The target moves when the trend of the readings, from end to end, is that many times it."""
    wander_s: float = 60.0
    """The constant of the laser goes on wandering as it did for so long."""
    wander_every_s: float = 5.0
    """Spacing of the constants that this is told from,"""
    wander_chance: float = 2.0
    """and how many standard deviations of both a difference of two of them may be by chance: what is left open is taken
    by the next, and would be opened further for it."""
    drift: tuple[float, float] = (1.0, 0.1)
    """Innovations are averaged over so many seconds, and no fewer readings than one over the second number: noise
    cancels, a target that moves stays."""
    surprise: tuple[float, float] = (3.0, 1.0 / 30.0)
    """Memory of how far that average is off, likewise."""
    surprised: tuple[float, float] = (4.0, 8.0)
    """Variance of the average over what is due. Beyond the first the target may be moving, and the constant is left
    more open (2.4 at most while it does not, and the model is right); beyond the second it does."""
    apart_s: float = 30.0
    """Memory of how far the aided heave is from the other; nothing is said of it before."""
    apart: float = 3.0
    """RMS of that, in the standard deviations that are due, from which the laser is not on a fixed target."""
    apart_at_once: float = 6.0
    """The same for one moment."""


TUNING: Final = Tuning()
MOVES: Final = "its target moves"


class Aiding:
    """Decides on every reading of an aiding laser, and holds the filter that goes on without it.

    Attributes:
        unaided: the filter without the laser while that aids, else None: the aided one is the same.
        doubt: why the laser does not aid, for people; empty while it does, or while nothing is known against it.
        since_s: since when.
    """

    def __init__(self) -> None:
        self.doubt, self.since_s = "", nan
        self.reset()

    def reset(self) -> None:
        """The filters are new, and the laser has to be checked again."""
        self.unaided: SeaFilter | None = None
        self._read_s = nan
        self._refused_s = 0.0
        self._reset_comparison()
        self._constants: deque[tuple[float, float, float]] = deque()
        self._rows: deque[tuple[float, float, float, float]] = deque()
        self._checked_s = -inf

    def _reset_comparison(self) -> None:
        self._apart, self._apart_s = 1.0, 0.0
        self._drift_m = self._surprise = 0.0

    def renew(self, unaided: SeaFilter) -> None:
        """Another model is in use, and the filters have to find each other again: that is nothing against the laser."""
        self.unaided = unaided
        self._reset_comparison()

    @property
    def is_active(self) -> bool:
        """Whether the laser is in the heave."""
        return self.unaided is not None

    # --- readings ----------------------------------------------------------------------------------------------------

    def step(self, heave: SeaHeave, t_s: float, laser_m: float, noise_std_m: float) -> bool:
        """A reading with the sign of heave; True when the filter of ``heave`` has taken it in.

        False while it is checked or when it is refused; then :attr:`doubt` may have changed, and the aid be over.
        """
        if abs(t_s - heave.filter.t_s) > TUNING.late_s:
            return False
        elapsed_s = min(max(t_s - self._read_s, 0.0), 60.0) if isfinite(self._read_s) else 0.0
        self._read_s = t_s
        if self.unaided is None:
            return self._check(heave, t_s, laser_m, noise_std_m)
        return self._aid(heave, self.unaided, t_s, laser_m, noise_std_m, elapsed_s)

    def _aid(
        self, heave: SeaHeave, unaided: SeaFilter, t_s: float, laser_m: float, noise_std_m: float, elapsed_s: float
    ) -> bool:
        f, gauge = heave.filter, heave.filter.gauge
        assert gauge is not None
        # By no more than the readings are off: what the model of the sea has wrong would go into the constant.
        is_opened = self._surprise > TUNING.surprised[0] and gauge.V[0, 0] < self._drift_m**2
        opened_m = FILTER.wanders[0] * self._surprise**2 if is_opened else 0.0
        gauge.wander(elapsed_s, max(self._wandered_m(t_s, gauge), opened_m))
        (row, missed_m2), counts_s = heave.row(t_s), min(elapsed_s, TUNING.silent_s)
        noise_m2 = noise_std_m**2 + missed_m2
        y, variance = f.laser_innovation(row, laser_m)
        if y * y > TUNING.gate**2 * (variance + noise_m2):
            self._refused_s += counts_s
            if self._refused_s >= TUNING.stop_s:
                self.stop(heave, t_s, f"it is {abs(y):.3g} m off the heave")
            return False
        self._refused_s = max(self._refused_s - counts_s, 0.0)
        f.aid(row, laser_m, noise_m2)
        self._compare(y, variance * heave.scale**2 + noise_m2, counts_s)
        if why := self._contradicts(heave, f, unaided, gauge, counts_s):
            self.stop(heave, t_s, why)
            return False
        return True

    def _compare(self, y: float, S: float, counts_s: float) -> None:
        """Hold an innovation of variance ``S`` against chance."""
        weight, memory = (min(counts_s / memory_s, most) for memory_s, most in (TUNING.drift, TUNING.surprise))
        if weight > 0.0:
            self._drift_m += weight * (y - self._drift_m)
            ratio = self._drift_m**2 / (S * weight / (2.0 - weight))
            self._surprise += memory * (ratio - self._surprise)

    def _wandered_m(self, t_s: float, gauge: GaugeError) -> float:
        """How the constant has wandered lately, beyond what is not known of it, in m per root of a minute."""
        past, constant_m, variance_m2 = self._constants, float(gauge.value[0]), float(gauge.V[0, 0])
        if not past or t_s - past[-1][0] >= TUNING.wander_every_s:
            past.append((t_s, constant_m, variance_m2))
            while t_s - past[0][0] > TUNING.wander_s:
                past.popleft()
        most_m2 = 0.0
        for then_s, then_m, then_m2 in past:
            if t_s - then_s >= TUNING.wander_every_s:
                moved_m2 = (constant_m - then_m) ** 2 - TUNING.wander_chance**2 * (variance_m2 + then_m2)
                most_m2 = max(most_m2, moved_m2 * 60.0 / (t_s - then_s))
        return sqrt(most_m2)

    def _contradicts(
        self, heave: SeaHeave, f: SeaFilter, unaided: SeaFilter, gauge: GaugeError, counts_s: float
    ) -> str:
        """What the aided filter has found that speaks against the laser, or nothing."""
        row = f.system.heave
        with_m2, without_m2 = _variance(row, f.covariance), _variance(row, unaided.covariance) * heave.scale**2
        square = float(row.dot(f.x - unaided.x)) ** 2 / max(without_m2, with_m2)
        self._apart_s = min(self._apart_s + counts_s, TUNING.apart_s)
        if self._apart_s > 0.0:
            self._apart += counts_s / self._apart_s * (square - self._apart)
        if square > TUNING.apart_at_once**2 or (self._apart_s >= TUNING.apart_s and self._apart > TUNING.apart**2):
            return MOVES
        if self._surprise > TUNING.surprised[1]:
            return MOVES
        # The laser serves while it makes the heave surer, what it and the accelerometer differ by taken into account.
        sea_m, moves_mps = heave.sea_std_m, heave.omega_radps * heave.sea_std_m
        scale, early_s = gauge.value[1:].tolist()
        scale_std, early_std_s = np.sqrt(np.maximum(np.diag(gauge.V)[1:], 0.0)).tolist()
        if (abs(scale) - TUNING.surely * scale_std) * sea_m > sqrt(without_m2):
            return lead.of_gain(1.0 + scale)
        if (abs(early_s) - TUNING.surely * early_std_s) * moves_mps > sqrt(without_m2):
            return lead.of_lead(-early_s)
        return ""

    # --- beginning and end -------------------------------------------------------------------------------------------

    def _check(self, heave: SeaHeave, t_s: float, laser_m: float, noise_std_m: float) -> bool:
        """Collect a reading, look at them all from time to time, and begin when they are those of a fixed target."""
        rows, f = self._rows, heave.filter
        if rows and t_s - rows[-1][0] < TUNING.every_s - 1e-6:
            return False
        row, missed_m2 = heave.row(t_s)
        rows.append((t_s, float(row.dot(f.x)), float(row.dot(f.system.A).dot(f.x)), laser_m))
        while t_s - rows[0][0] > TUNING.check_s[1]:
            rows.popleft()
        is_enough = t_s - rows[0][0] >= TUNING.check_s[0] and len(rows) >= TUNING.check_readings
        if not is_enough or t_s - self._checked_s < TUNING.checked_every_s:
            return False
        self._checked_s = t_s
        found = np.array(rows)
        why = self._misfit(heave, found, noise_std_m)
        if why:
            # What the laser looked at before is no matter when the newest readings are right.
            newest = found[found[:, 0] >= t_s - TUNING.check_s[0] - TUNING.checked_every_s]
            if len(newest) >= TUNING.check_readings and self._misfit(heave, newest, noise_std_m) == "":
                found, why = newest, ""
        if why is None:
            return False
        self._say(why, t_s)
        if why:
            return False
        constant_m = float(np.mean(found[:, 3] - found[:, 1]))
        self.unaided = SeaFilter(f.system, f.steady, f.t_s, f.x, None if f.P is None else f.P.copy())
        f.P, f.gauge = f.covariance.copy(), GaugeError.at_first(constant_m, len(f.x))
        rows.clear()
        self._constants.clear()
        self._refused_s = 0.0
        self._reset_comparison()
        f.aid(row, laser_m, noise_std_m**2 + missed_m2)
        return True

    def _misfit(self, heave: SeaHeave, rows: Array, noise_std_m: float) -> str | None:
        """What is wrong with readings ``rows`` (n, 4: time, heave, velocity, reading); None: they say nothing yet."""
        shown = lead.compare(rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3], heave.omega_radps)
        sea_m = float(np.std(rows[:, 1]))
        if shown is None or not sea_m > 0.0:
            return None
        error_m = sqrt(_variance(heave.filter.system.heave, heave.filter.covariance)) * heave.scale
        due_m = TUNING.scatter * hypot(error_m, noise_std_m)
        if sea_m > due_m and shown.coherence < 0.5:
            return "it does not follow the heave"
        if not shown.gain_std <= TUNING.check_std * max(shown.gain, 1.0):
            return None
        return _of_another(shown, error_m / sea_m, heave.omega_radps) or self._unfixed(rows, due_m)

    def _unfixed(self, rows: Array, due_m: float) -> str:
        """What readings ``rows`` have of no fixed target, ``due_m`` being due to heave and noise; or nothing."""
        constants_m = rows[:, 3] - rows[:, 1]
        since_s = rows[:, 0] - rows[0, 0]
        moved_m = abs(float(np.polyfit(since_s, constants_m, 1)[0])) * float(since_s[-1])
        if self.doubt == MOVES and moved_m > TUNING.moved * due_m:
            return MOVES  # Still: it takes a suspicion, for the error of the heave looks like a trend on its own.
        off_m = float(np.std(constants_m))
        return f"it is {off_m:.2g} m off the heave" if off_m > due_m else ""

    def stop(self, heave: SeaHeave, t_s: float, why: str) -> None:
        """Forget all that the laser taught: the filter that went on without it takes over."""
        if self.unaided is not None:
            heave.filter.x, heave.filter.P, heave.filter.gauge = self.unaided.x, self.unaided.P, None
        self.reset()
        self._say(why, t_s)

    def _say(self, why: str, t_s: float) -> None:
        if not why:
            self.since_s = nan
        elif not self.doubt:
            self.since_s = t_s
        self.doubt = why

    def remark(self, t_s: float) -> str:
        """For people, at ``t_s``; nothing while the laser aids or is looked at for the first time."""
        return f"laser: no aid for {max(t_s - self.since_s, 0.0):.0f} s: {self.doubt}" if self.doubt else ""


def _of_another(shown: lead.Comparison, unsure: float, omega_radps: float) -> str:
    """What readings have of another motion than the heave, of which that share is unsure; or nothing."""
    if shown.is_opposed():
        return lead.OPPOSED
    if abs(shown.gain - 1.0) > unsure + TUNING.surely * shown.gain_std:
        return lead.of_gain(shown.gain)
    if abs(shown.lead_s) > unsure / omega_radps + TUNING.surely * shown.lead_std_s:
        return lead.of_lead(shown.lead_s)
    return ""


def _variance(row: Array, P: Array) -> float:
    return max(float(row.dot(P).dot(row)), 0.0)
