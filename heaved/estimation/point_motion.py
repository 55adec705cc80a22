"""The points of a frame: heave, velocity, acceleration and forecasts of each, on the hull or on the moving crane."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import isfinite, nan
from typing import Final

import msgspec

from heaved.estimation.common.bounds import HEAVE_ACCELERATION_MPS2, POINT_HEAVE_M
from heaved.estimation.crane.estimator import GOOD, Worth
from heaved.estimation.lever_arm import (
    Arm,
    AttitudeMotion,
    Point,
    arm_motion,
    crane_base_arm,
    fixed_arm,
    lever_acceleration,
    moving_arm,
)
from heaved.estimation.stages import FAILED, Stages
from heaved.samples import HeaveForecast, HeaveState, PointMotion, RockPrediction

NO_BASE: Final = Worth(HeaveState.INVALID, ("it is not known yet how the crane base stands",))
MOST_ACCELERATION_MPS2: Final = 2.0 * HEAVE_ACCELERATION_MPS2
"""At the end of a long boom, that of the vessel included."""


class Moment(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """Heave and attitude of one moment, as they are known at ``from_s``."""

    from_s: float
    t_s: float
    heave_m: float
    std_m: float
    velocity_mps: float
    attitude: AttitudeMotion


class Ahead(msgspec.Struct, frozen=True, gc=False):
    """What is known beside the moment itself."""

    acceleration_mps2: float
    """Of the heave, at ``from_s``,"""
    attitude: AttitudeMotion
    """and the attitude then."""
    heave: Sequence[HeaveForecast]
    rock: Sequence[RockPrediction]
    """Both ahead of ``from_s``."""
    late_std_s: float = 0.0
    """How well the moment of the attitude is known."""


class PointMotions:
    """Makes the points of one pipeline's frames."""

    def __init__(self, points: tuple[Point, ...], stages: Stages) -> None:
        self._points, self._stages = points, stages
        self._riding = tuple(
            [((point.forward_m, point.port_m, point.up_m), point.frame == "hook") for point in points if point.rides]
        )
        """(outward, left, up) of those on the crane, and which are of the hook."""
        self._fixed = {point.name: fixed_arm(point) for point in points if point.frame == "hull"}

    def at(
        self, moment: Moment, ahead: Ahead, foretold: Sequence[tuple[HeaveForecast, ...]]
    ) -> tuple[PointMotion, ...]:
        """Every point at a moment, with its acceleration now and its forecasts as of :meth:`foretold`."""
        stages, from_s = self._stages, moment.from_s
        worth = {hook: stages.crane_worth(from_s, hook=hook) for hook in {hook for _, hook in self._riding}}
        # Accelerations are those of the sample: the arm may be that of a moment later, which is nearly the same.
        arms = self._arms(moment.t_s)
        found = []
        for point, arm, forecast in zip(self._points, arms, foretold, strict=True):
            trust = worth[point.frame == "hook"] if point.rides else GOOD
            if trust.state is HeaveState.INVALID:
                found.append(PointMotion(name=point.name, state=trust.state, reasons=trust.reasons))
            elif isinstance(arm, Worth):
                found.append(PointMotion(name=point.name, state=arm.state, reasons=arm.reasons))
            else:
                found.append(_motion(point.name, arm, moment, ahead, forecast, trust))
        return tuple(found)

    def foretold(self, from_s: float, ahead: Ahead) -> list[tuple[HeaveForecast, ...]]:
        """Forecasts of each point, for the horizons that heave and attitude have in common.

        Their errors are taken as independent, as those of heave and attitude of now are.
        """
        found: list[list[HeaveForecast]] = [[] for _ in self._points]
        turning = zip(ahead.rock, slopes(ahead.rock), strict=True) if ahead.heave else ()
        by_horizon = {one.horizon_s: (one, rates) for one, rates in turning}
        arms: Sequence[Arm | Worth] = () if self._riding else self._arms(from_s)
        for heave in ahead.heave:
            horizon_s = heave.horizon_s
            angles, rates = by_horizon.get(horizon_s, (None, (0.0, 0.0)))
            if angles is None or not isfinite(heave.heave_m + heave.std_m + angles.roll_std_rad + angles.pitch_std_rad):
                continue
            attitude = AttitudeMotion(
                angles.roll_rad,
                angles.pitch_rad,
                *rates,
                angles.roll_std_rad,
                angles.pitch_std_rad,
                late_std_s=ahead.late_std_s,
            )
            then = self._arms(from_s + horizon_s) if self._riding else arms
            for forecast, point, arm in zip(found, self._points, then, strict=True):
                if isinstance(arm, Worth):
                    continue
                made = arm_motion(point.name, arm, heave.heave_m, 0.0, attitude, heave.std_m)
                if _is_possible(made):
                    one = HeaveForecast(horizon_s=horizon_s, heave_m=made.heave_m, std_m=made.heave_std_m)
                    forecast.append(one)
        return [tuple(forecast) for forecast in found]

    def _arms(self, t_s: float) -> list[Arm | Worth]:
        """Of each point at any moment, or why it is not known where the point is."""
        stages = self._stages
        base, is_on_base = stages.crane, stages.crane_is_on_base
        places = iter(stages.crane_places(t_s, self._riding) if self._riding else ())
        found: list[Arm | Worth] = []
        for point in self._points:
            if point.frame == "hull":
                found.append(self._fixed[point.name])
                continue
            place = next(places, None) if point.rides else None
            if base is None and (is_on_base or not point.rides):
                found.append(NO_BASE)
            elif not point.rides:
                found.append(FAILED if base is None else crane_base_arm(point, base))
            else:
                found.append(FAILED if place is None else moving_arm(place, base if is_on_base else None))
        return found


def slopes(predictions: Sequence[RockPrediction]) -> list[tuple[float, float]]:
    """Rates of roll and pitch, rad/s, from each horizon to the next; of the last that is known, what leads to it."""
    found: list[tuple[float, float]] = []
    last = (0.0, 0.0)
    for soon, later in pairwise(predictions):
        apart_s = later.horizon_s - soon.horizon_s
        rates = (later.roll_rad - soon.roll_rad) / apart_s, (later.pitch_rad - soon.pitch_rad) / apart_s
        last = rates if isfinite(sum(rates)) else last
        found.append(last)
    return [*found, last] if predictions else []


def _motion(
    name: str, arm: Arm, moment: Moment, ahead: Ahead, forecast: tuple[HeaveForecast, ...], trust: Worth
) -> PointMotion:
    """One that knows where it is to some standard deviation and within its bounds; else its own motion alone."""
    made = arm_motion(name, arm, moment.heave_m, moment.velocity_mps, moment.attitude, moment.std_m)
    if not _is_possible(made):
        return PointMotion(
            name=name,
            own_height_m=made.own_height_m,
            own_velocity_mps=made.own_velocity_mps,
            state=trust.state,
            reasons=trust.reasons,
        )
    acceleration_mps2 = ahead.acceleration_mps2 + lever_acceleration(arm, ahead.attitude)
    return msgspec.structs.replace(
        made,
        heave_acceleration_mps2=acceleration_mps2 if abs(acceleration_mps2) <= MOST_ACCELERATION_MPS2 else nan,
        forecast=forecast,
        state=trust.state,
        reasons=trust.reasons,
    )


def _is_possible(made: PointMotion) -> bool:
    return abs(made.heave_m) <= POINT_HEAVE_M and isfinite(made.heave_std_m)
