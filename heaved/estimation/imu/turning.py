"""Angles that do not turn as the body rates do: roll and pitch exchanged, a solution that has lost its way.

Angles by themselves are believed once several of them agree, wherever they are: a vessel may have been anywhere while
nothing was heard. Gyroscopes know better. Where they have led from angle to angle for a while, a reading is expected
where the last one that was believed and the rates since then have led. One that is elsewhere is refused; those after it
are, too, until they turn again as the rates say: an attitude solution that has levelled itself anew does at once, roll
that is read in the place of pitch never does.
"""

from __future__ import annotations

from collections import deque
from math import isfinite, isnan, nan, radians, sqrt
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.estimation.imu.attitude import angle_rates
from heaved.estimation.imu.gates import wrapped

if TYPE_CHECKING:
    from heaved.samples import ImuSample


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of :class:`TurnCheck`. Without a source: chosen, and held by the tests of exchanged angles."""

    apart_s: float = 0.25
    """Body rates further apart do not show how the vessel has turned in between."""
    compared_s: float = 1.0
    """Angles so far apart are held against the rates: the motion shows over the noise, and roll and pitch that turn
    alike for a moment do not for long."""
    enough: int = 15
    """Comparisons before anything is concluded,"""
    memory: float = 60.0
    """those that are remembered,"""
    agreed: float = 0.3
    """and how far off, of the motion, the angles may be to which rates lead that are to be believed."""
    width: float = 5.5
    """A reading further off than so many times the usual is refused,"""
    surprises: float = 3.0
    """and counts in what is usual as one that is so many times as far off at most: what is wrong does not become it."""
    floor_rad: float = radians(0.1)
    """but not one that is less far off than this,"""
    drifts_radps: float = radians(0.05)
    """and what the bias of a gyroscope makes of the time since the last that was believed."""
    back_s: float = 1.0
    """Readings where they are expected, after others, are believed when they have been there for so long: roll and
    pitch pass each other twice in a wave."""
    proven_s: float = 4.0
    """Readings elsewhere that turn as the rates do for so long, half a wave, are believed,"""
    turned_rad: float = radians(0.5)
    """where the vessel has turned by so much, up and down, meanwhile: one at rest shows nothing,"""
    at_rest_s: float = 10.0
    """and is believed after so long."""
    longest_s: float = 120.0
    """After so long the rates are those that are not believed."""


TUNING: Final = Tuning()


class TurnCheck:
    """Feed it every sample of the IMU in order of time.

    Attributes:
        is_refusing: whether the last angles are not where the rates have led.
    """

    def __init__(self) -> None:
        self._begin()

    def _begin(self) -> None:
        self.is_refusing = False
        self._rated_s = self._roll_rate = self._pitch_rate = nan
        """The latest rates."""
        self._roll = self._pitch = nan
        """Where the rates have led since the last reading that was believed."""
        self._believed_s = nan
        self._amended_roll = self._amended_pitch = 0.0
        """By how much readings have been off that, all together."""
        self._lately: deque[tuple[float, float, float]] = deque()
        """Times and those sums, of the last second;"""
        self._row: deque[tuple[float, float, float]] = deque()
        """of readings that are refused: how far each is off."""
        self._agrees_since_s = self._there_since_s = nan
        self._turned = 0.0
        self._compared, self._compared_s = 0.0, nan
        self._off_square = self._moved_square = 0.0
        """Over a second: of what the angles are off, and of how far they have moved."""
        self._usual_square = 0.0
        """Of what a reading is off."""
        self._angles: deque[tuple[float, float]] = deque()

    def step(self, sample: ImuSample, roll_rad: float, pitch_rad: float, *, are_rates_there: bool) -> bool:
        """Whether the angles of a sample, as they have been judged (nan: there are none), may be believed;
        ``are_rates_there``: likewise of its body rates. One angle alone is as the last two were.
        """
        t_s, is_there = sample.t_s, isfinite(roll_rad + pitch_rad)
        if not self._turn(sample, roll_rad, pitch_rad, are_rates_there=are_rates_there) or isnan(self._believed_s):
            if not is_there or (self.is_refusing and t_s - self._believed_s <= TUNING.longest_s):
                return not self.is_refusing
            self._believe(t_s, roll_rad, pitch_rad)
            return True
        if not is_there:
            return not self.is_refusing
        off_roll, off_pitch = wrapped(roll_rad - self._roll), wrapped(pitch_rad - self._pitch)
        amended = t_s, self._amended_roll + off_roll, self._amended_pitch + off_pitch
        if self._are_rates_known and not self._is_expected(off_roll, off_pitch, amended):
            if not self._is_proven(t_s, off_roll, off_pitch):
                if t_s - self._believed_s <= TUNING.longest_s:
                    self.is_refusing = True
                    return False
                self._begin()
            self._lately.clear()
            amended = t_s, 0.0, 0.0
        self._learn(amended, off_roll, off_pitch, roll_rad, pitch_rad)
        self._believe(t_s, roll_rad, pitch_rad)
        return True

    @property
    def _are_rates_known(self) -> bool:
        """Whether the body rates have led from angle to angle."""
        return self._compared >= TUNING.enough and self._off_square < TUNING.agreed**2 * self._moved_square

    def _is_expected(self, off_roll: float, off_pitch: float, amended: tuple[float, float, float]) -> bool:
        """Whether a reading is where the rates have led since the last one, and in the last second."""
        t_s = amended[0]
        limit = _limit_rad(self._usual_square) + TUNING.drifts_radps * (t_s - self._believed_s)
        is_there = abs(off_roll) <= limit and abs(off_pitch) <= limit
        if self.is_refusing:
            if not is_there:
                self._there_since_s = nan
            elif isnan(self._there_since_s):
                self._there_since_s = t_s
            return is_there and t_s - self._there_since_s >= TUNING.back_s
        if is_there and self._lately:
            _, roll, pitch = self._lately[0]
            limit = _limit_rad(self._off_square)
            is_there = abs(amended[1] - roll) <= limit and abs(amended[2] - pitch) <= limit
        return is_there

    def _turn(self, sample: ImuSample, roll_rad: float, pitch_rad: float, *, are_rates_there: bool) -> bool:
        """Move on by the rates; whether they are known since the last sample."""
        if not are_rates_there:
            self._rated_s = nan
            self._lately.clear()
            return False
        roll_rate, pitch_rate, elapsed_s = self._roll_rate, self._pitch_rate, sample.t_s - self._rated_s
        self._rated_s = sample.t_s
        roll, pitch = (self._roll, self._pitch) if isfinite(self._roll) else (roll_rad, pitch_rad)
        self._roll_rate, self._pitch_rate, _ = angle_rates(sample, roll, pitch)
        turned_roll = 0.5 * elapsed_s * (roll_rate + self._roll_rate)
        turned_pitch = 0.5 * elapsed_s * (pitch_rate + self._pitch_rate)
        if not elapsed_s <= TUNING.apart_s or not isfinite(turned_roll + turned_pitch):
            self._lately.clear()
            return False
        self._roll += turned_roll
        self._pitch += turned_pitch
        self._turned += abs(turned_roll) + abs(turned_pitch)
        return True

    def _believe(self, t_s: float, roll_rad: float, pitch_rad: float) -> None:
        self._believed_s, self._roll, self._pitch = t_s, roll_rad, pitch_rad
        self.is_refusing, self._there_since_s = False, nan
        self._row.clear()

    def _is_proven(self, t_s: float, off_roll: float, off_pitch: float) -> bool:
        """Whether readings elsewhere have turned as the rates do for long enough."""
        row = self._row
        if not row:
            self._agrees_since_s, self._turned = t_s, 0.0
        row.append((t_s, off_roll, off_pitch))
        while t_s - row[0][0] > TUNING.compared_s and t_s - row[1][0] >= TUNING.compared_s:
            row.popleft()
        _, roll, pitch = row[0]
        if max(abs(off_roll - roll), abs(off_pitch - pitch)) > _limit_rad(self._off_square):
            self._agrees_since_s, self._turned = t_s, 0.0
        since_s = t_s - self._agrees_since_s
        return since_s > TUNING.at_rest_s or (since_s > TUNING.proven_s and self._turned > TUNING.turned_rad)

    def _learn(
        self, amended: tuple[float, float, float], off_roll: float, off_pitch: float, roll_rad: float, pitch_rad: float
    ) -> None:
        """How far readings are off usually, and whether the rates lead from angle to angle."""
        t_s, self._amended_roll, self._amended_pitch = amended
        square, surprising = max(off_roll * off_roll, off_pitch * off_pitch), TUNING.surprises**2
        if self._are_rates_known and square > surprising * self._usual_square:
            square = surprising * self._usual_square
        self._usual_square += (square - self._usual_square) / (1.0 + min(self._compared * 10.0, 10.0 * TUNING.memory))
        lately, angles = self._lately, self._angles
        if not lately:
            angles.clear()
        lately.append(amended)
        angles.append((roll_rad, pitch_rad))
        while t_s - lately[1 if len(lately) > 1 else 0][0] >= TUNING.compared_s:
            lately.popleft()
            angles.popleft()
        since_s = t_s - lately[0][0]
        if since_s < TUNING.compared_s or t_s - self._compared_s < TUNING.compared_s:
            return
        self._compared_s = t_s
        off_roll, off_pitch = amended[1] - lately[0][1], amended[2] - lately[0][2]
        moved_roll, moved_pitch = wrapped(roll_rad - angles[0][0]), wrapped(pitch_rad - angles[0][1])
        self._compared = min(self._compared + 1.0, TUNING.memory)
        share, square = 1.0 / self._compared, off_roll * off_roll + off_pitch * off_pitch
        if self._are_rates_known and square > surprising * self._off_square:
            square = surprising * self._off_square
        self._off_square += share * (square - self._off_square)
        self._moved_square += share * (moved_roll * moved_roll + moved_pitch * moved_pitch - self._moved_square)


def _limit_rad(square: float) -> float:
    """Readings further off than the root of that mean ``square`` by far are unusual."""
    usual = TUNING.width * sqrt(square)
    return usual if usual > TUNING.floor_rad else TUNING.floor_rad
