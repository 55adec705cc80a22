"""Readings that cannot be true: accelerations that jump, angles beyond what ships do or not where the motion has led.

A ship's roll and pitch are as smooth as anything gets: what comes next is known to a few hundredths of a degree. Bytes
from another register, a wrapped angle or bits turned over are tens of degrees off. A reading alone proves nothing, not
even the first: after whatever has been refused, and after a gap, several that agree with each other must come in a row.
Accelerations are less smooth, slams and engine vibration are real; there only what is over after a reading or two is
told from the motion. Readings that no longer change are those of :mod:`heaved.unchanged`.
"""

from __future__ import annotations

from math import exp, inf, isfinite, nan, pi, radians
from typing import Final

import msgspec

from heaved.estimation.common.bounds import ANGLE_RAD, HEAVE_ACCELERATION_MPS2

TURN: Final = 2.0 * pi
RMS_OF_MEDIAN: Final = 1.483
"""RMS over the median size of normal deviations."""


class SpikeTuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of a :class:`SpikeGate`."""

    width: float = 8.0
    """Steps beyond this many RMS steps are suspect; a Gaussian gives one in 1e15."""
    floor_mps2: float = 4.0
    """Steps below this are never suspect: slams and engine vibration are real, and what is not is found by what it
    does."""
    lasting_s: float = 0.15
    """A level that lasts is real; a spike is over after a reading or two."""
    memory: float = 0.005
    """Weight of one step in the mean square (the last 200 steps)."""
    learned: int = 100
    """Steps from which that is known."""
    stale_s: float = 0.5
    """After a gap this long the last reading says nothing about the next."""


class AngleTuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of an :class:`AngleGate`."""

    width: float = 8.0
    """Readings further off than so many times the usual are refused."""
    floor_rad: float = radians(0.5)
    """Readings less far off never are: coarse registers, knocks at the quay."""
    unknown_rad: float = radians(2.0)
    """The same while nothing is known of the motion, and between readings that are to agree with each other,"""
    unknown_rate_radps: float = radians(20.0)
    """and so much more for each second between them: a tug that rolls 15 degrees in four seconds."""
    agreeing: int = 4
    """So many readings in a row, and"""
    agreeing_s: float = 0.1
    """so long a row of them prove what they show;"""
    elsewhere_s: float = 0.5
    """so long a one where the motion was known to be elsewhere."""
    slope_s: float = 0.1
    """Time constant of the rate: long against the noise of readings, short against the motion."""
    stale_s: float = 2.0
    """After a gap this long the motion is unknown."""
    first: int = 20
    """Readings by which the usual one is first known; until then it is their mean."""
    adjusted: float = 0.01
    """By so much of itself the usual one goes up with a reading that is further off and down with one that is not: it
    is the median of a hundred or so, and a quarter of wrong readings, none so far off that it is refused, moves it
    little."""
    least_rad: float = 1e-6
    """The usual one is never less than this."""


SPIKES: Final = SpikeTuning()
ANGLES: Final = AngleTuning()


class SpikeGate:
    """Passes an acceleration, or withholds it (nan) while it stands out of the steps seen so far.

    Attributes:
        rejected: readings withheld so far.
    """

    def __init__(self, most_mps2: float = HEAVE_ACCELERATION_MPS2) -> None:
        """``most_mps2``: beyond it, either way, nothing is passed."""
        self.rejected = 0
        self._most = most_mps2
        self._t_s = self._value = nan
        self._mean_square = 0.0
        self._steps = 0

    def step(self, t_s: float, value: float) -> float:
        """The value, or nan for a spike. Not finite: nan. The first steps are only learned from."""
        if not isfinite(value):
            return nan
        if abs(value) > self._most:
            self.rejected += 1
            return nan
        step, elapsed_s = value - self._value, t_s - self._t_s
        if elapsed_s <= SPIKES.stale_s:
            square, usual = step * step, SPIKES.width**2 * self._mean_square
            limit = usual if usual > SPIKES.floor_mps2**2 else SPIKES.floor_mps2**2
            if square > limit and self._steps >= SPIKES.learned and elapsed_s < SPIKES.lasting_s:
                self.rejected += 1
                return nan
            self._steps += 1
            weight = SPIKES.memory if self._steps * SPIKES.memory > 1.0 else 1.0 / self._steps
            self._mean_square += weight * ((square if square < 4.0 * limit else 4.0 * limit) - self._mean_square)
        self._t_s, self._value = t_s, value
        return value


def wrapped(angle_rad: float) -> float:
    """The same angle, -pi < angle <= pi."""
    return angle_rad if -pi < angle_rad <= pi else pi - (pi - angle_rad) % TURN


class AngleGate:
    """Judges one angle, whose differences are taken the short way round.

    Attributes:
        rate_radps: its derivative, as the last readings that were believed have shown it.
    """

    def __init__(self, most_rad: float = ANGLE_RAD) -> None:
        """``most_rad``: beyond it, either way, nothing is believed."""
        self._most = most_rad
        self._t_s = -inf
        self._angle, self.rate_radps = nan, 0.0
        self._usual_s = self._usual_off = 0.0
        self._count = 0
        self._row: list[tuple[float, float]] = []
        """Of readings that agree with each other while they are not believed yet."""

    @property
    def std_rad(self) -> float:
        """RMS of how far a usual reading is off where the ones before have led; nan: not known yet."""
        return RMS_OF_MEDIAN * self._usual_off if self._count >= ANGLES.first else nan

    def step(self, t_s: float, angle_rad: float, *, is_confirmed: bool = False) -> bool:
        """Whether the reading at ``t_s``, later than the last one, may be believed; one that is nan never.

        ``is_confirmed``: something else shows the same, roughly, which will do where the motion is not known.
        """
        if not abs(angle_rad) <= self._most:
            self._row.clear()
            return False
        elapsed_s = t_s - self._t_s
        if elapsed_s > ANGLES.stale_s:
            if is_confirmed:
                self._begin(t_s, angle_rad, 0.0)
                return True
            return self._is_proven(t_s, angle_rad, ANGLES.agreeing_s)
        off = wrapped(angle_rad - self._angle - self.rate_radps * elapsed_s)
        # The motion is not straight: over several intervals it leads astray by as many times more.
        longer = elapsed_s / self._usual_s if elapsed_s > self._usual_s > 0.0 else 1.0
        if self._count >= ANGLES.first:
            limit = ANGLES.floor_rad + ANGLES.width * RMS_OF_MEDIAN * self._usual_off * longer
        else:
            limit = ANGLES.unknown_rad + ANGLES.unknown_rate_radps * elapsed_s
        if abs(off) > limit:
            return self._is_proven(t_s, angle_rad, ANGLES.elsewhere_s)
        self._count += 1
        far = abs(off) / longer
        if self._count <= ANGLES.first:
            self._usual_off += (far - self._usual_off) / self._count
            self._usual_s += (elapsed_s - self._usual_s) / self._count
        else:
            adjusted = 1.0 + ANGLES.adjusted if far > self._usual_off else 1.0 - ANGLES.adjusted
            self._usual_off = max(adjusted * self._usual_off, ANGLES.least_rad)
            self._usual_s += ANGLES.adjusted * (elapsed_s - self._usual_s)
        self.rate_radps += off * (1.0 - exp(-elapsed_s / ANGLES.slope_s)) / elapsed_s
        self._t_s, self._angle = t_s, angle_rad
        if self._row:
            self._row.clear()
        return True

    def _is_proven(self, t_s: float, angle_rad: float, lasting_s: float) -> bool:
        """Whether this reading is the last of a row that proves itself."""
        row = self._row
        if row:
            since_s, step = t_s - row[-1][0], wrapped(angle_rad - row[-1][1])
            if since_s > ANGLES.stale_s or abs(step) > ANGLES.unknown_rad + ANGLES.unknown_rate_radps * since_s:
                row.clear()
        row.append((t_s, angle_rad))
        elapsed_s = t_s - row[0][0]
        if len(row) < ANGLES.agreeing or elapsed_s < lasting_s:
            return False
        self._begin(t_s, angle_rad, wrapped(angle_rad - row[0][1]) / elapsed_s)
        return True

    def _begin(self, t_s: float, angle_rad: float, rate_radps: float) -> None:
        self._t_s, self._angle, self.rate_radps = t_s, angle_rad, rate_radps
        self._count = 0
        self._row.clear()
