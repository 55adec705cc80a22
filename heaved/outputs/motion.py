"""What an output tells of the motion: one place of the vessel at one moment, taken from the newest frame. Pure.

A frame is for the moment of its sample. What leaves a while later, in a format that knows no time of its own, counts
for its reader as of the moment at which it comes: so the motion is moved on to that moment, by the few milliseconds
that a frame is old, along its velocity and acceleration, the angles along their predictions.
"""

from __future__ import annotations

from enum import StrEnum
from math import hypot, isfinite, nan
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.samples import DelayedHeave, HeaveForecast, HeaveState, MotionFrame, PointMotion, RockPrediction

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

LONGEST_S: Final = 0.5
"""Nothing is moved further on than that: a frame that is older says nothing of the moment."""
_NEAR_S: Final = 0.02
"""An angle that nothing is predicted of is that of its reading for so long: at 10 degrees/s it is 0.2 degrees off."""
_WORTH: Final = (HeaveState.INVALID, HeaveState.SETTLING, HeaveState.DEGRADED, HeaveState.VALID)


class Lead(StrEnum):
    """For which moment the values of an output are."""

    NONE = "none"
    """That of the sample: for a format that tells it."""
    TRANSMISSION = "transmission"
    """That at which they are sent."""
    COMPENSATION = "compensation"
    """``[compensation] lead_s`` after that at which they are sent."""


class Motion(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """Motion of one place at one moment; units and signs of :mod:`heaved.samples`, nan: not known."""

    utc_s: float
    """Of its validity, seconds since 1970."""
    age_s: float
    """From the sample that it is taken from to the moment at which it was asked for."""
    state: HeaveState
    """What the heave here is worth; with anything but INVALID it is finite."""
    reasons: tuple[str, ...] = ()
    heave_m: float = nan
    heave_std_m: float = nan
    heave_velocity_mps: float = nan
    heave_acceleration_mps2: float = nan
    surge_acceleration_mps2: float = nan
    sway_acceleration_mps2: float = nan
    roll_rad: float = nan
    pitch_rad: float = nan
    yaw_rad: float = nan
    roll_std_rad: float = nan
    pitch_std_rad: float = nan
    yaw_std_rad: float = nan
    roll_rate_radps: float = nan
    pitch_rate_radps: float = nan
    yaw_rate_radps: float = nan
    forecast: tuple[tuple[float, float, float], ...] = ()
    """Seconds after the sample, heave and its standard deviation."""
    delayed: DelayedHeave | None = None
    """Of the IMU: None for any other place."""
    delayed_utc_s: float = nan

    @property
    def has_attitude(self) -> bool:
        """Whether roll and pitch are known."""
        return isfinite(self.roll_rad + self.pitch_rad)


_NO_ANGLES: Final = (nan, nan, nan)


def motion_at(frame: MotionFrame, point: str, lead: Lead, now_s: float, utc_s: Callable[[float], float]) -> Motion:
    """The motion of a place as an output tells it at ``now_s``, on the clock of ``frame.t_s``.

    ``point``: name of a monitoring point; empty: the IMU. ``utc_s``: UTC, seconds since 1970, of a time on that clock.
    One that the frame does not have is invalid.
    """
    age_s = now_s - frame.t_s
    on_s = 0.0 if lead is Lead.NONE else age_s
    ahead_s = frame.compensation_lead_s if lead is Lead.COMPENSATION else 0.0
    at = frame if ahead_s == frame.compensation_lead_s or frame.now is None else frame.now
    state, reasons, delayed = frame.quality.heave, frame.quality.reasons, frame.delayed
    acceleration_mps2, forecast = frame.heave_acceleration_mps2, frame.forecast
    heave_m, std_m, velocity_mps = at.heave_m, at.heave_std_m, at.heave_velocity_mps
    if point:
        place = _named(at.points, point)
        heave_m, std_m, velocity_mps = place.heave_m, place.heave_std_m, place.heave_velocity_mps
        acceleration_mps2, forecast, delayed = place.heave_acceleration_mps2, place.forecast, None
        if place.state is not None and _WORTH.index(place.state) < _WORTH.index(state):
            state = place.state
        reasons += place.reasons
    if on_s != 0.0:
        heave_m += on_s * velocity_mps
        # The acceleration is that of the sample, some time before the moment that a lead is for.
        if ahead_s == 0.0 and isfinite(acceleration_mps2):
            heave_m += 0.5 * on_s * on_s * acceleration_mps2
            velocity_mps += on_s * acceleration_mps2
    if not abs(on_s) <= LONGEST_S:
        heave_m, reasons = nan, (*reasons, f"the newest frame is {age_s:.1f} s old")
    if not isfinite(heave_m):
        state, heave_m, std_m, velocity_mps, acceleration_mps2 = HeaveState.INVALID, nan, nan, nan, nan
    angles, stds = _angles(frame, ahead_s + on_s) if abs(on_s) <= LONGEST_S else (_NO_ANGLES, _NO_ANGLES)
    return Motion(
        utc_s=utc_s(frame.t_s + ahead_s + on_s),
        age_s=age_s,
        state=state,
        reasons=reasons,
        heave_m=heave_m,
        heave_std_m=_later_std(std_m, forecast, on_s) if ahead_s == 0.0 else std_m,
        heave_velocity_mps=velocity_mps,
        heave_acceleration_mps2=acceleration_mps2,
        surge_acceleration_mps2=frame.surge_acceleration_mps2,
        sway_acceleration_mps2=frame.sway_acceleration_mps2,
        roll_rad=angles[0],
        pitch_rad=angles[1],
        yaw_rad=angles[2],
        roll_std_rad=stds[0],
        pitch_std_rad=stds[1],
        yaw_std_rad=stds[2],
        roll_rate_radps=frame.roll_rate_radps,
        pitch_rate_radps=frame.pitch_rate_radps,
        yaw_rate_radps=frame.yaw_rate_radps,
        forecast=tuple([(one.horizon_s, one.heave_m, one.std_m) for one in forecast]),
        delayed=delayed,
        delayed_utc_s=utc_s(delayed.t_s) if delayed is not None else nan,
    )


def _named(points: Sequence[PointMotion], name: str) -> PointMotion:
    return next((point for point in points if point.name == name), PointMotion(name=name))


def _later_std(std_m: float, forecast: Sequence[HeaveForecast], on_s: float) -> float:
    """Standard deviation of the heave a little after the sample: its variance grows towards that of the next forecast,
    and is at least that of now.
    """
    first = next((one for one in forecast if one.horizon_s >= on_s), None)
    if first is None or not first.std_m > std_m or on_s <= 0.0:
        return std_m
    share = on_s / first.horizon_s
    return hypot(std_m * (1.0 - share) ** 0.5, first.std_m * share**0.5)


def _angles(frame: MotionFrame, ahead_s: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Roll, pitch and yaw ``ahead_s`` after the sample, between those of now and those that are predicted, and their
    standard deviations: those of the next prediction.
    """
    now = (frame.roll_rad, frame.pitch_rad, frame.yaw_rad)
    if ahead_s <= 0.0:
        return now, _NO_ANGLES if not frame.rock else _stds(frame.rock[0])
    at_s, later = 0.0, now
    for prediction in frame.rock:
        before_s, before = at_s, later
        at_s, later = prediction.horizon_s, (prediction.roll_rad, prediction.pitch_rad, prediction.yaw_rad)
        if at_s >= ahead_s:
            share = (ahead_s - before_s) / (at_s - before_s)
            angles = [first + share * (second - first) for first, second in zip(before, later, strict=True)]
            if ahead_s <= _NEAR_S:
                angles = [angle if isfinite(angle) else first for angle, first in zip(angles, now, strict=True)]
            return tuple(angles), _stds(prediction)
    return now if ahead_s <= _NEAR_S else _NO_ANGLES, _NO_ANGLES


def _stds(prediction: RockPrediction) -> tuple[float, float, float]:
    return prediction.roll_std_rad, prediction.pitch_std_rad, prediction.yaw_std_rad
