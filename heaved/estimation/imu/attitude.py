"""Roll and pitch between the readings of an attitude sensor: turned on with the body rates, or as they are predicted.

A roll of ten degrees within eight seconds moves by four degrees in half a second: a reading that is held for so long is
none. Where the sensor gives body rates, and these have agreed with its angles, the angles follow from them with an
error that grows by their bias alone. Without rates the rock predictor knows where the angles are now, and how well; it
serves while it knows them well, since angles are published without a standard deviation. Before it knows anything, and
for a moment, a straight line does.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, isfinite, nan, radians, sin, sqrt, tan
from typing import Final

import msgspec

from heaved.samples import ImuSample, RockPrediction

CARRIED_S: Final = 2.0
"""Angles serve for so long after they were read; the bias of a cheap gyroscope makes 0.2 degrees of it."""
LINE_S: Final = 0.2
"""On a straight line, before it is known how far the motion bends away from one: half of an angular acceleration of
6 degrees/s2 times its square is 0.1 degrees,"""
LONGEST_LINE_S: Final = 0.5
"""and later, at most."""
KNOWN_RAD: Final = radians(0.25)
"""Angles serve that are known to this standard deviation or better."""
RATED_S: Final = 0.25
"""Body rates further apart do not show how the vessel has turned in between."""
COMPARED_S: Final = 0.25
"""Rates and straight lines are held against angles that lie so far apart: the motion shows over the noise,"""
TOGETHER_S: Final = 1.0
"""and lines no further than this: the bend of a wave shows."""
COMPARED: Final = 8
"""Comparisons before anything is concluded,"""
COMPARED_MEMORY: Final = 40.0
"""those that are remembered,"""
AGREED: Final = 0.3
"""and how far off, of the motion, the angles may be to which they lead. With a wrong sign or unit it is more."""


class Attitude(msgspec.Struct, frozen=True, gc=False):
    """Roll and pitch of a moment, rad, and what is known of them a little later."""

    t_s: float = nan
    """Their moment; nan: there are none."""
    roll_rad: float = nan
    pitch_rad: float = nan
    yaw_rad: float = nan
    roll_rate_radps: float = nan
    pitch_rate_radps: float = nan
    roll_std_rad: float = nan
    """RMS of how far off a reading was where the ones before had led: more than its own error."""
    pitch_std_rad: float = nan
    measured_s: float = nan
    """When the sensor last showed them."""
    line_s: float = LINE_S
    """For so long a straight line is as good as it has to be."""

    def at(self, t_s: float) -> tuple[float, float]:
        """Roll and pitch a little later, moved on with their rates."""
        since_s = t_s - self.t_s
        if since_s == 0.0:
            return self.roll_rad, self.pitch_rad
        return self.roll_rad + since_s * self.roll_rate_radps, self.pitch_rad + since_s * self.pitch_rate_radps

    def serves(self, t_s: float) -> bool:
        """Whether it may be published for a moment, on a straight line."""
        return t_s - self.t_s <= self.line_s and t_s - self.measured_s <= CARRIED_S


UNKNOWN: Final = Attitude()


def angle_rates(sample: ImuSample, roll_rad: float, pitch_rad: float) -> tuple[float, float, float]:
    """Derivatives of roll, pitch and yaw from the body rates of a sample, rad/s; nan where they are not known.

    The z-y-x Euler rates, with pitch and yaw turned round as :mod:`heaved.samples` counts them (bow up, clockwise).
    """
    if not (abs(pitch_rad) < 1.5 and isfinite(roll_rad)):
        return nan, nan, nan
    s, c = sin(roll_rad), cos(roll_rad)
    across = sample.gy_radps * s + sample.gz_radps * c
    along = sample.gy_radps * c - sample.gz_radps * s
    return sample.gx_radps - across * tan(pitch_rad), -along, -across / cos(pitch_rad)


class CarriedAttitude:
    """Feed it every sample in order of time.

    Attributes:
        latest: roll and pitch of the last sample, or of when they were last known.
    """

    def __init__(self) -> None:
        self.latest = UNKNOWN
        self._line_s = LINE_S
        self._t_s = self._roll_rate = self._pitch_rate = nan
        """The latest body rates."""
        self._from: Attitude | None = None
        """What the next comparison begins with,"""
        self._turned_roll = self._turned_pitch = 0.0
        """and what the rates have made of it since."""
        self._rated = self._lined = 0.0
        """Comparisons with rates and with lines,"""
        self._off_square = self._moved_square = self._bend_square = 0.0
        """and what they have shown: off the rates, between the readings; off the line, per second squared."""

    @property
    def are_rates_believed(self) -> bool:
        """Whether the body rates have led from angle to angle."""
        return self._rated >= COMPARED and self._off_square < AGREED**2 * self._moved_square

    @property
    def are_rates_measured(self) -> bool:
        """Whether body rates that are believed came with the last sample."""
        return self.latest.t_s == self._t_s and self.are_rates_believed and isfinite(self._roll_rate + self._pitch_rate)

    @property
    def rates(self) -> tuple[float, float]:
        """Derivatives of roll and pitch at the last sample, rad/s."""
        if self.are_rates_measured:
            return self._roll_rate, self._pitch_rate
        return self.latest.roll_rate_radps, self.latest.pitch_rate_radps

    def take(self, sample: ImuSample, measured: Attitude | None, rock: Sequence[RockPrediction]) -> None:
        """Take a sample, the angles that were read with it (None: no new ones) and the predictions from it."""
        t_s, before_s, now = sample.t_s, self._t_s, measured if measured is not None else self.latest
        steps = None
        if isfinite(sample.gx_radps + sample.gy_radps + sample.gz_radps):
            steps = self._step(sample, *now.at(t_s))
        self._turn(steps)
        if measured is not None and not (self._from and measured.t_s - self._from.t_s < COMPARED_S):
            self._compare(measured, t_s)
            self._line_s = self._straight_s()
        if now.t_s < t_s <= now.measured_s + CARRIED_S:
            later = None
            if steps is not None and self.are_rates_believed and now.t_s >= before_s:
                share = (t_s - now.t_s) / (t_s - before_s)
                later = msgspec.structs.replace(
                    now,
                    t_s=t_s,
                    roll_rad=now.roll_rad + share * steps[0],
                    pitch_rad=now.pitch_rad + share * steps[1],
                    roll_rate_radps=self._roll_rate,
                    pitch_rate_radps=self._pitch_rate,
                )
            now = later or predicted(t_s, now, rock) or now
        self.latest = now
        if now.line_s != self._line_s:
            self.latest = msgspec.structs.replace(now, line_s=self._line_s)

    def _straight_s(self) -> float:
        """For how long the motion does not bend away from a line by more than KNOWN_RAD, usually."""
        if self._lined < COMPARED:
            return LINE_S
        bend = sqrt(self._bend_square)
        return min(sqrt(KNOWN_RAD / bend), LONGEST_LINE_S) if bend > 0.0 else LONGEST_LINE_S

    def _step(self, sample: ImuSample, roll_rad: float, pitch_rad: float) -> tuple[float, float] | None:
        """What the angles have turned by since the last rates; None: too long, or they were not known."""
        t_s, before_s, roll_rate, pitch_rate = sample.t_s, self._t_s, self._roll_rate, self._pitch_rate
        self._roll_rate, self._pitch_rate, _ = angle_rates(sample, roll_rad, pitch_rad)
        self._t_s = t_s
        half_s = 0.5 * (t_s - before_s)
        if not 2.0 * half_s <= RATED_S or not isfinite(roll_rate + self._roll_rate):
            return None
        return half_s * (roll_rate + self._roll_rate), half_s * (pitch_rate + self._pitch_rate)

    def _turn(self, steps: tuple[float, float] | None) -> None:
        """Add up what the rates make of the angles since the last comparison; nan from where they are not known on."""
        roll, pitch = steps if steps is not None else (nan, nan)
        self._turned_roll += roll
        self._turned_pitch += pitch

    def _compare(self, measured: Attitude, t_s: float) -> None:
        """Hold the angles against what the rates, and a straight line, have made of earlier ones."""
        # The rates are those of the sample, the angles may be older.
        late_s, first = t_s - measured.t_s, self._from
        late_roll, late_pitch = (late_s * self._roll_rate, late_s * self._pitch_rate) if late_s > 0.0 else (0.0, 0.0)
        if first is not None:
            roll, pitch = measured.roll_rad - first.roll_rad, measured.pitch_rad - first.pitch_rad
            off_roll, off_pitch = roll - self._turned_roll + late_roll, pitch - self._turned_pitch + late_pitch
            if isfinite(off_roll + off_pitch):
                self._rated = min(self._rated + 1.0, COMPARED_MEMORY)
                share = 1.0 / self._rated
                self._off_square += share * (off_roll * off_roll + off_pitch * off_pitch - self._off_square)
                self._moved_square += share * (roll * roll + pitch * pitch - self._moved_square)
            if (elapsed_s := measured.t_s - first.t_s) <= TOGETHER_S:
                line_roll, line_pitch = first.at(measured.t_s)
                off = max(abs(measured.roll_rad - line_roll), abs(measured.pitch_rad - line_pitch)) / elapsed_s**2
                self._lined = min(self._lined + 1.0, COMPARED_MEMORY)
                self._bend_square += (off * off - self._bend_square) / self._lined
        self._from = measured
        self._turned_roll, self._turned_pitch = late_roll, late_pitch


def predicted(t_s: float, last: Attitude, rock: Sequence[RockPrediction]) -> Attitude | None:
    """The angles of a moment from what was predicted from it, if they are known well: back along the line of the first
    two horizons, by less than they are apart."""
    soon, later, *_ = rock
    if not max(soon.roll_std_rad, soon.pitch_std_rad) <= KNOWN_RAD or not t_s - last.measured_s <= CARRIED_S:
        return None
    apart_s = later.horizon_s - soon.horizon_s
    roll_rate = (later.roll_rad - soon.roll_rad) / apart_s
    pitch_rate = (later.pitch_rad - soon.pitch_rad) / apart_s
    if not isfinite(roll_rate + pitch_rate):
        return None
    return msgspec.structs.replace(
        last,
        t_s=t_s,
        roll_rad=soon.roll_rad - soon.horizon_s * roll_rate,
        pitch_rad=soon.pitch_rad - soon.horizon_s * pitch_rate,
        roll_rate_radps=roll_rate,
        pitch_rate_radps=pitch_rate,
    )
