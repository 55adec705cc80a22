"""Roll and pitch, what they make of body axes, and where they are between the readings of an attitude sensor.

A roll of ten degrees within eight seconds moves by four degrees in half a second: a reading that is held for so long is
none. Where the sensor gives body rates, and these have agreed with its angles, the angles follow from them with an
error that grows by their bias alone. Without rates the rock predictor knows where the angles are now, and how well; it
serves while it knows them well, since angles are published without a standard deviation. Before it knows anything, and
for a moment, a straight line does.

Axes x forward, y port, z up; roll port up, pitch bow up (see :mod:`heaved.samples`).
"""

from __future__ import annotations

from math import cos, isfinite, nan, radians, sin, sqrt, tan
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.samples import GRAVITY_MPS2, ImuSample, RockPrediction

if TYPE_CHECKING:
    from collections.abc import Sequence


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """For how long, and by what, angles are propagated."""

    longest_s: float = 2.0
    """Angles serve for so long after they were read; the bias of a cheap gyroscope makes 0.2 degrees of it."""
    line_s: float = 0.2
    """On a straight line, before it is known how far the motion bends away from one: half of an angular acceleration of
    6 degrees/s2 times its square is 0.1 degrees,"""
    longest_line_s: float = 0.5
    """and later, at most."""
    known_rad: float = radians(0.25)
    """Angles serve that are known to this standard deviation or better."""
    rates_apart_s: float = 0.25
    """Body rates further apart do not show how the vessel has turned in between."""
    compared_s: float = 0.25
    """Rates and straight lines are held against angles that lie so far apart: the motion shows over the noise,"""
    together_s: float = 1.0
    """and lines no further than this: the bend of a wave shows."""
    compared: int = 8
    """Comparisons before anything is concluded,"""
    compared_memory: float = 40.0
    """those that are remembered,"""
    agreed: float = 0.3
    """and how far off, of the motion, the angles may be to which they lead. With a wrong sign or unit it is more."""
    steepest_rad: float = 1.5
    """Pitch at which roll and yaw are hardly told apart: no angle rates from body rates beyond."""


TUNING: Final = Tuning()


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

    def at(self, t_s: float) -> tuple[float, float]:
        """Roll and pitch a little later, moved on with their rates."""
        since_s = t_s - self.t_s
        if since_s == 0.0:
            return self.roll_rad, self.pitch_rad
        return self.roll_rad + since_s * self.roll_rate_radps, self.pitch_rad + since_s * self.pitch_rate_radps


UNKNOWN: Final = Attitude()


def angle_rates(sample: ImuSample, roll_rad: float, pitch_rad: float) -> tuple[float, float, float]:
    """Derivatives of roll, pitch and yaw from the body rates of a sample, rad/s; nan where they are not known.

    The z-y-x Euler rates, with pitch and yaw turned round as :mod:`heaved.samples` counts them (bow up, clockwise).
    """
    if not (abs(pitch_rad) < TUNING.steepest_rad and isfinite(roll_rad)):
        return nan, nan, nan
    s, c = sin(roll_rad), cos(roll_rad)
    across = sample.gy_radps * s + sample.gz_radps * c
    along = sample.gy_radps * c - sample.gz_radps * s
    return sample.gx_radps - across * tan(pitch_rad), -along, -across / cos(pitch_rad)


def up_acceleration(fx: float, fy: float, fz: float, roll_rad: float, pitch_rad: float) -> float:
    """Vertical acceleration in m/s2, positive up, from the specific force (m/s2, body axes) and the attitude.

    The third row of the rotation from body to level axes, applied to the specific force, less gravity:
    sin(pitch) fx + sin(roll) cos(pitch) fy + cos(roll) cos(pitch) fz - g. It is zero at rest for any attitude.
    A wrong sign of roll or pitch shows as an error of 2 g sin^2(tilt) and as cross-talk from sway and surge.
    """
    return level_acceleration(fx, fy, fz, roll_rad, pitch_rad)[2]


def level_acceleration(
    fx: float, fy: float, fz: float, roll_rad: float, pitch_rad: float
) -> tuple[float, float, float]:
    """Acceleration forward, to port and up, m/s2, in the level frame that turns with the heading, likewise."""
    sr, cr, sp, cp = sin(roll_rad), cos(roll_rad), sin(pitch_rad), cos(pitch_rad)
    mast = sr * fy + cr * fz  # along the z axis of the hull before it rolls
    return cp * fx - sp * mast, cr * fy - sr * fz, sp * fx + cp * mast - GRAVITY_MPS2


class AttitudePropagator:
    """Feed it every sample in order of time.

    Attributes:
        latest: roll and pitch of the last sample, or of when they were last known.
        are_rates_measured: whether body rates that are believed came with the last sample.
        rates: derivatives of roll and pitch at the last sample, rad/s.
    """

    def __init__(self) -> None:
        self.latest = UNKNOWN
        self.are_rates_measured = False
        self.rates = (nan, nan)
        self._line_s = TUNING.line_s
        """For so long a straight line is as good as it has to be."""
        self._t_s = self._roll_rate = self._pitch_rate = self._yaw_rate = nan
        """The latest body rates."""
        self._from: Attitude | None = None
        """What the next comparison begins with,"""
        self._turned_roll = self._turned_pitch = 0.0
        """and what the rates have made of it since; nan: not known."""
        self._rated = self._lined = 0.0
        """Comparisons with rates and with lines,"""
        self._off_square = self._moved_square = self._bend_square = 0.0
        """and what they have shown: off the rates, between the readings; off the line, per second squared."""

    def serves(self, t_s: float) -> bool:
        """Whether the latest attitude may be published for a moment, on a straight line."""
        return t_s - self.latest.t_s <= self._line_s and t_s - self.latest.measured_s <= TUNING.longest_s

    @property
    def are_rates_believed(self) -> bool:
        """Whether the body rates have led from angle to angle."""
        return self._rated >= TUNING.compared and self._off_square < TUNING.agreed**2 * self._moved_square

    @property
    def yaw_rate_radps(self) -> float:
        """The same of the heading, from body rates that are believed; nan: there are none."""
        return self._yaw_rate if self.are_rates_measured else nan

    def step(self, sample: ImuSample, measured: Attitude | None, rock: Sequence[RockPrediction]) -> None:
        """Take a sample, the angles that were read with it (None: no new ones) and the predictions from it."""
        t_s, before_s, now = sample.t_s, self._t_s, measured if measured is not None else self.latest
        roll, pitch = self._turn(sample, *now.at(t_s))
        self._turned_roll += roll
        self._turned_pitch += pitch
        if measured is not None and not (self._from and measured.t_s - self._from.t_s < TUNING.compared_s):
            self._compare(measured, t_s)
            self._line_s = self._straight_s()
        if now.t_s < t_s <= now.measured_s + TUNING.longest_s:
            later = None
            if isfinite(roll + pitch) and self.are_rates_believed and now.t_s >= before_s:
                share = (t_s - now.t_s) / (t_s - before_s)
                later = msgspec.structs.replace(
                    now,
                    t_s=t_s,
                    roll_rad=now.roll_rad + share * roll,
                    pitch_rad=now.pitch_rad + share * pitch,
                    roll_rate_radps=self._roll_rate,
                    pitch_rate_radps=self._pitch_rate,
                )
            now = later or predicted(t_s, now, rock) or now
        self.latest = now
        self.rates = self._roll_rate, self._pitch_rate
        self.are_rates_measured = now.t_s == self._t_s and self.are_rates_believed and isfinite(sum(self.rates))
        if not self.are_rates_measured:
            self.rates = now.roll_rate_radps, now.pitch_rate_radps

    def _turn(self, sample: ImuSample, roll_rad: float, pitch_rad: float) -> tuple[float, float]:
        """What the angles have turned by since the last rates; nan: too long ago, or they were not known."""
        if not isfinite(sample.gx_radps + sample.gy_radps + sample.gz_radps):
            return nan, nan
        t_s, before_s, roll_rate, pitch_rate = sample.t_s, self._t_s, self._roll_rate, self._pitch_rate
        self._roll_rate, self._pitch_rate, self._yaw_rate = angle_rates(sample, roll_rad, pitch_rad)
        self._t_s = t_s
        if not t_s - before_s <= TUNING.rates_apart_s:
            return nan, nan
        half_s = 0.5 * (t_s - before_s)
        return half_s * (roll_rate + self._roll_rate), half_s * (pitch_rate + self._pitch_rate)

    def _straight_s(self) -> float:
        """For how long the motion does not bend away from a line by more than is known, usually."""
        if self._lined < TUNING.compared:
            return TUNING.line_s
        bend = sqrt(self._bend_square)
        return min(sqrt(TUNING.known_rad / bend), TUNING.longest_line_s) if bend > 0.0 else TUNING.longest_line_s

    def _compare(self, measured: Attitude, t_s: float) -> None:
        """Hold the angles against what the rates, and a straight line, have made of earlier ones."""
        # The rates are those of the sample, the angles may be older.
        late_s, first = t_s - measured.t_s, self._from
        late_roll, late_pitch = (late_s * self._roll_rate, late_s * self._pitch_rate) if late_s > 0.0 else (0.0, 0.0)
        if first is not None:
            roll, pitch = measured.roll_rad - first.roll_rad, measured.pitch_rad - first.pitch_rad
            off_roll, off_pitch = roll - self._turned_roll + late_roll, pitch - self._turned_pitch + late_pitch
            if isfinite(off_roll + off_pitch):
                self._rated = min(self._rated + 1.0, TUNING.compared_memory)
                share = 1.0 / self._rated
                self._off_square += share * (off_roll * off_roll + off_pitch * off_pitch - self._off_square)
                self._moved_square += share * (roll * roll + pitch * pitch - self._moved_square)
            if (elapsed_s := measured.t_s - first.t_s) <= TUNING.together_s:
                line_roll, line_pitch = first.at(measured.t_s)
                off = max(abs(measured.roll_rad - line_roll), abs(measured.pitch_rad - line_pitch)) / elapsed_s**2
                self._lined = min(self._lined + 1.0, TUNING.compared_memory)
                self._bend_square += (off * off - self._bend_square) / self._lined
        self._from = measured
        self._turned_roll, self._turned_pitch = late_roll, late_pitch


def predicted(t_s: float, last: Attitude, rock: Sequence[RockPrediction]) -> Attitude | None:
    """The angles of a moment from what was predicted from it, if they are known well: back along the parabola of the
    first three horizons, by less than they are apart. (A line would be off by a share of the angle's acceleration,
    always to the same side, and gravity that is taken out with it by what varies with the groups of waves.)
    """
    soon, later, last_one, *_ = rock
    are_known = max(soon.roll_std_rad, soon.pitch_std_rad) <= TUNING.known_rad
    if not (are_known and t_s - last.measured_s <= TUNING.longest_s):
        return None
    h_s = soon.horizon_s, later.horizon_s, last_one.horizon_s
    roll, roll_rate = _back(h_s, soon.roll_rad, later.roll_rad, last_one.roll_rad)
    pitch, pitch_rate = _back(h_s, soon.pitch_rad, later.pitch_rad, last_one.pitch_rad)
    if not isfinite(roll_rate + pitch_rate):
        return None
    return msgspec.structs.replace(
        last,
        t_s=t_s,
        roll_rad=roll,
        pitch_rad=pitch,
        roll_rate_radps=roll_rate,
        pitch_rate_radps=pitch_rate,
    )


def _back(at_s: tuple[float, float, float], first: float, second: float, third: float) -> tuple[float, float]:
    """Value and slope at 0 of the parabola through three values (Newton's divided differences)."""
    a_s, b_s, c_s = at_s
    slope = (second - first) / (b_s - a_s)
    bend = ((third - second) / (c_s - b_s) - slope) / (c_s - a_s)
    return first - a_s * (slope - b_s * bend), slope - (a_s + b_s) * bend
