"""The frame of a moment: what the chain, the rock predictions and the stages know then, put into one record.

Nothing is advanced here: a moment without a sample is framed like any other, from the same state moved further on.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from typing import Final

from heaved.estimation import points
from heaved.estimation.chain import Heave, HeaveChain
from heaved.estimation.intake import Intake
from heaved.estimation.points import Attitude, Point
from heaved.estimation.quality import COAST_S, Facts, judge
from heaved.estimation.rock import STANDARD_HORIZONS_S
from heaved.estimation.stages import Stages
from heaved.predictions import PlainForecasts
from heaved.samples import (
    CorrectionState,
    HeaveState,
    LaserState,
    MotionFrame,
    PointMotion,
    Quality,
    QuietForecast,
    RockPrediction,
)

NOTHING: Final = Heave(
    heave_m=nan,
    std_m=nan,
    velocity_mps=nan,
    acceleration_mps2=nan,
    observer_m=nan,
    correction_m=nan,
    lead_s=nan,
    forecast=PlainForecasts((), (), ()),
)
"""While nothing is known of the heave."""


class Framer:
    """Makes the frames of one pipeline."""

    def __init__(
        self,
        intake: Intake,
        chain: HeaveChain,
        stages: Stages,
        *,
        has_laser: bool,
        point: tuple[Point, ...],
        lead_s: float,
        rock_horizons_s: tuple[float, ...],
    ) -> None:
        """``lead_s``: the heave is for this long after each moment. ``rock_horizons_s``: of the predictions."""
        self._intake, self._chain, self._stages = intake, chain, stages
        self._has_laser, self._points, self._lead_s = has_laser, point, lead_s
        # Between two predictions: the noise of the measured attitude, over 50 ms, would be most of the rate.
        self._rate_between = tuple(rock_horizons_s.index(h) for h in STANDARD_HORIZONS_S[:2])

    def frame(
        self,
        t_s: float,
        rock: Sequence[RockPrediction],
        quiet: QuietForecast | None,
        doubts: tuple[str, ...],
    ) -> MotionFrame:
        """All that is known at ``t_s``; ``doubts``: what others than the observer hold against the heave."""
        chain, stages = self._chain, self._stages
        reference = chain.laser.reference
        shift_s = t_s - chain.observer.t_s
        heave = chain.at(shift_s) if shift_s <= COAST_S else None
        roll, pitch, yaw = self._intake.attitude(t_s)
        fresh = self._has_laser and chain.laser.is_fresh(t_s)
        quality = self._quality(t_s, heave, fresh, doubts)
        crane_roll, crane_pitch, crane_yaw = stages.crane_attitude(roll, pitch, yaw)
        if heave is None or quality.heave is HeaveState.INVALID:
            # No number without its uncertainty, and none that is not worth sending.
            heave = NOTHING
        return MotionFrame(
            t_s=t_s,
            quality=quality,
            heave_m=heave.heave_m,
            heave_std_m=heave.std_m,
            heave_velocity_mps=heave.velocity_mps,
            heave_acceleration_mps2=heave.acceleration_mps2,
            observer_m=heave.observer_m,
            correction_m=heave.correction_m,
            lead_s=heave.lead_s,
            reference_m=reference.value_m if fresh else nan,
            roll_rad=roll,
            pitch_rad=pitch,
            yaw_rad=yaw,
            points=self._point_motions(heave, roll, pitch, rock) if self._points else (),
            rock=rock,
            quiet=quiet,
            forecast=heave.forecast,
            compensation_lead_s=self._lead_s,
            delayed=chain.delayed(),
            sea=chain.observer.sea,
            crane_roll_rad=crane_roll,
            crane_pitch_rad=crane_pitch,
            crane_yaw_rad=crane_yaw,
            hull=stages.angles,
            attitude=stages.motion,
        )

    def _point_motions(
        self, heave: Heave, roll_rad: float, pitch_rad: float, rock: Sequence[RockPrediction]
    ) -> tuple[PointMotion, ...]:
        """Each point, for the moment that the heave is for: the attitude moves on with its present rates."""
        predictions = tuple(rock)
        soon, later = (predictions[i] for i in self._rate_between)
        apart_s = later.horizon_s - soon.horizon_s
        roll_rate = (later.roll_rad - soon.roll_rad) / apart_s
        pitch_rate = (later.pitch_rad - soon.pitch_rad) / apart_s
        attitude = Attitude(
            roll_rad=roll_rad + self._lead_s * roll_rate,
            pitch_rad=pitch_rad + self._lead_s * pitch_rate,
            roll_rate_radps=roll_rate,
            pitch_rate_radps=pitch_rate,
        )
        h, v, crane = heave.heave_m, heave.velocity_mps, self._stages.crane
        return tuple([
            points.crane_motion(point, h, v, attitude, crane)
            if point.frame == "crane"
            else points.motion(point, h, v, attitude)
            for point in self._points
        ])  # fmt: skip

    def _quality(self, t_s: float, heave: Heave | None, fresh: bool, doubts: tuple[str, ...]) -> Quality:
        intake, chain, observer = self._intake, self._chain, self._chain.observer
        state, reasons = judge(
            Facts(
                imu_fault=intake.fault,
                since_sample_s=t_s - chain.good_t_s,
                period_s=intake.arrivals.period_s,
                settled_s=observer.settled_s,
                needed_s=observer.needed_s,
                error_std_m=nan if heave is None else heave.std_m,
                heave_std_m=observer.heave_std_m(),
                missing=intake.arrivals.missing,
                doubts=observer.doubts + doubts,
                notes=observer.notes,
                remarks=chain.laser.remarks() if self._has_laser else (),
                tilt_removed=intake.is_tilt_removed(t_s),
                std_scale=chain.laser.std_scale,
                laser_fault=chain.laser.fault,
                laser_configured=self._has_laser,
                laser_fresh=fresh,
            )
        )
        return Quality(
            heave=state,
            laser=LaserState.OFF if not self._has_laser else LaserState.VALID if fresh else LaserState.STALE,
            correction=chain.correction.state(fresh) if self._has_laser else CorrectionState.OFF,
            reasons=reasons,
        )
