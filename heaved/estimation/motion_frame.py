"""The frame of a moment: what the estimators know then, put into one record.

Nothing is advanced here: a moment without a sample is framed like any other, from the same state moved further on.
"""

from __future__ import annotations

from collections import Counter
from math import hypot, inf, isfinite, nan, pi, remainder
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

from heaved.estimation.common.bounds import HEAVE_ACCELERATION_MPS2, HEAVE_M, HEAVE_VELOCITY_MPS
from heaved.estimation.heave.estimator import Heave, HeaveEstimator
from heaved.estimation.heave.quality import TUNING as QUALITY
from heaved.estimation.heave.quality import Facts, judge
from heaved.estimation.imu.attitude import UNKNOWN, Attitude, predicted
from heaved.estimation.imu.vertical import NO_LEVEL, NO_RATES
from heaved.estimation.lever_arm import AttitudeMotion, Point
from heaved.estimation.point_motion import Ahead, Moment, PointMotions, slopes
from heaved.estimation.rock.params import STANDARD_HORIZONS_S
from heaved.samples import (
    CorrectionState,
    DelayedHeave,
    HeaveState,
    LaserState,
    MotionFrame,
    MotionNow,
    PointMotion,
    Quality,
    QuietForecast,
    RockPrediction,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.estimation.imu.attitude_error import Lean
    from heaved.estimation.imu.vertical import Vertical
    from heaved.estimation.stages import Stages

NOTHING: Final = Heave(
    heave_m=nan,
    std_m=nan,
    velocity_mps=nan,
    acceleration_mps2=nan,
    observer_m=nan,
    correction_m=nan,
    lead_s=nan,
    forecast=(),
)
"""While nothing is known of the heave."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What is set by us, not by the user."""

    carried: float = 1.5
    """Where readings are missing there was mostly something wrong with the last ones too: so much less is known at
    once."""
    line_per_s: float = 4.0
    """A straight line of a rolling vessel's angles is worse than a prediction by so much of it for each second: half of
    the angle's acceleration times the square of half a second is some three times what predictions are off by then."""
    behind_s: float = 0.3
    """Angular accelerations: between the body rates of so long ago and those that are predicted for ..."""
    ahead_s: tuple[float, float] = (0.3, 0.6)
    """... as long ahead, on the way to the first horizon in there. In sea S6 that is off by 0.05 of the roll's and by
    0.1 of the pitch's; without body rates by 0.2 to 0.5."""
    longest_step_s: float = 0.5
    """Delayed heaves further apart show no velocity."""
    runs_away_within_s: float = 600.0
    """What leaves physics twice within that is not fed with what it takes for a sea (an acceleration with a roll in it
    that nothing shows): it will again, and is wrong before it does."""
    not_believed_s: float = 300.0
    """It is not believed for so long."""


TUNING: Final = Tuning()
LEFT_OUT: Final = ("overloaded: rock predictions and quiet windows left out",)
BEYOND: Final = "beyond physics"
"""Why an estimator begins anew."""
ORDER: Final = 3
"""Coefficients of a parabola."""


class _RunAway:
    """Whether an estimator that leaves physics does so again and again.

    Attributes:
        until_s: it is not believed before then.
    """

    def __init__(self) -> None:
        self.until_s = self._last_s = -inf
        self._count = 0

    def is_believed(self, t_s: float, count: int) -> bool:
        """``count``: times that it has left physics."""
        if count > self._count:
            if t_s - self._last_s < TUNING.runs_away_within_s:
                self.until_s = t_s + TUNING.not_believed_s
            self._last_s = t_s
        self._count = count
        return t_s >= self.until_s


class MotionFrames:
    """Makes the frames of one pipeline; the last gate that a value passes.

    Attributes:
        resets: of what was found beyond physics, times that it began.
        remarks: to be added to the reasons; they change no state.
    """

    def __init__(
        self,
        vertical: Vertical,
        heave: HeaveEstimator,
        stages: Stages,
        *,
        point: tuple[Point, ...],
        rock_horizons_s: tuple[float, ...],
    ) -> None:
        """``rock_horizons_s``: of the predictions."""
        self._vertical, self._heave, self._stages = vertical, heave, stages
        self._points = PointMotions(point, stages) if point else None
        self.resets: Counter[tuple[str, str]] = Counter()
        self.remarks: tuple[str, ...] = ()
        self._is_beyond = False
        self._ran_away = _RunAway()
        self._delayed: tuple[DelayedHeave, DelayedHeave | None] | None = None
        """The newest of the estimator, and what is published of it."""
        # Between two predictions: the noise of the measured attitude, over 50 ms, would be most of the rate.
        self._rate_between = tuple(rock_horizons_s.index(h) for h in STANDARD_HORIZONS_S[:2])
        self._bend = _Bend.of(rock_horizons_s)
        self._parabola = _Parabola.of(rock_horizons_s, heave.lead_s)

    @property
    def has_points(self) -> bool:
        """Whether points are published."""
        return self._points is not None

    def at(
        self,
        t_s: float,
        rock: Sequence[RockPrediction],
        quiet: QuietForecast | None,
        doubts: tuple[str, ...],
    ) -> MotionFrame:
        """All that is known at ``t_s``; ``doubts``: what others than the observer hold against the heave."""
        estimator, stages = self._heave, self._stages
        observer, laser = estimator.observer, estimator.laser
        shift_s = t_s - observer.t_s
        heave = estimator.at(shift_s) if shift_s <= QUALITY.coast_s else None
        if heave is not None:
            heave = self._possible(heave)
        beyond = observer.resets.get(BEYOND, 0) + self.resets.get(("frame", BEYOND), 0)
        if not self._ran_away.is_believed(t_s, beyond):
            heave = None
        now = None
        if estimator.lead_s > 0.0 and heave is not None and (now := estimator.now(shift_s)) is not None:
            now = self._of_uncertain_time(now) if _is_possible(now) else None
        attitude = self._serving(t_s, rock)
        roll, pitch, yaw = attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad
        fresh = estimator.has_laser and laser.is_fresh(t_s)
        quality = self._quality(t_s, heave, fresh, doubts)
        crane_roll, crane_pitch, crane_yaw = stages.crane_attitude(roll, pitch, yaw)
        if heave is None or quality.heave is HeaveState.INVALID:
            # No number without its uncertainty, and none that is not worth sending.
            heave, now = NOTHING, None
        points: tuple[PointMotion, ...] = ()
        points_now: tuple[PointMotion, ...] = ()
        if self._points is not None:
            points, points_now = self._point_motions(t_s, heave, now, attitude, rock)
        is_of_sample = self._vertical.attitude.t_s == t_s
        surge_mps2, sway_mps2 = self._vertical.level_mps2 if is_of_sample else NO_LEVEL
        roll_rate, pitch_rate, yaw_rate = self._rates(is_of_sample, rock)
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
            reference_m=laser.reference.value_m if fresh else nan,
            roll_rad=roll,
            pitch_rad=pitch,
            yaw_rad=yaw,
            surge_acceleration_mps2=surge_mps2,
            sway_acceleration_mps2=sway_mps2,
            roll_rate_radps=roll_rate,
            pitch_rate_radps=pitch_rate,
            yaw_rate_radps=yaw_rate,
            points=points,
            rock=rock,
            quiet=quiet,
            forecast=heave.forecast,
            compensation_lead_s=estimator.lead_s,
            now=MotionNow(
                heave_m=now.heave_m, heave_std_m=now.std_m, heave_velocity_mps=now.velocity_mps, points=points_now
            )
            if now is not None
            else None,
            delayed=self._possible_delayed(),
            sea=observer.sea,
            crane_roll_rad=crane_roll,
            crane_pitch_rad=crane_pitch,
            crane_yaw_rad=crane_yaw,
            hull=stages.angles,
            reference_mru=stages.reference_mru,
            attitude=stages.motion,
        )

    def _possible(self, heave: Heave) -> Heave | None:
        """A heave that a vessel can have, with what its velocity makes of the time to which the accelerations are known
        in its standard deviation; None: no vessel does that, so nothing is known.
        """
        is_beyond = not _is_possible(heave)
        if is_beyond and not self._is_beyond:
            self.resets["frame", BEYOND] += 1
        self._is_beyond = is_beyond
        return None if is_beyond else self._of_uncertain_time(heave)

    def _of_uncertain_time(self, heave: Heave) -> Heave:
        """With what its velocity makes of the time to which the accelerations are known in its standard deviation."""
        if not self._vertical.force_std_s > 0.0:
            return heave
        late_s, forecast = self._vertical.force_std_s, heave.forecast
        # Of later moments: as fast as the wave is now at its fastest.
        fastest_mps = hypot(heave.velocity_mps, self._heave.observer.omega_radps * heave.observer_m)
        return msgspec.structs.replace(
            heave,
            std_m=hypot(heave.std_m, late_s * heave.velocity_mps),
            forecast=tuple(
                [msgspec.structs.replace(one, std_m=hypot(one.std_m, late_s * fastest_mps)) for one in forecast]
            ),
        )

    def _possible_delayed(self) -> DelayedHeave | None:
        """The delayed heave likewise, its velocity that since the one before."""
        found, before = self._heave.delayed(), self._delayed
        if found is None or abs(found.heave_m) > HEAVE_M:
            return None
        if not self._vertical.force_std_s > 0.0:
            self._delayed = found, found
        elif before is None or found is not before[0]:
            elapsed_s = found.t_s - before[0].t_s if before is not None else nan
            # Of the first one, and of one after a pause, it is not known.
            is_next = before is not None and 0.0 < elapsed_s <= TUNING.longest_step_s
            velocity_mps = (found.heave_m - before[0].heave_m) / elapsed_s if before is not None and is_next else nan
            std_m = hypot(found.std_m, self._vertical.force_std_s * velocity_mps)
            self._delayed = found, msgspec.structs.replace(found, std_m=std_m) if isfinite(std_m) else None
        return self._delayed[1] if self._delayed is not None else None

    def _serving(self, t_s: float, rock: Sequence[RockPrediction]) -> Attitude:
        """Roll and pitch of a moment: as of the last sample, or moved on as predicted or for an instant in line."""
        last = self._vertical.attitude
        if last.t_s == t_s:
            return last
        if (now := predicted(t_s, last, rock)) is not None:
            return now
        if not self._vertical.serves(t_s):
            return UNKNOWN
        roll, pitch = last.at(t_s)
        return msgspec.structs.replace(last, roll_rad=roll, pitch_rad=pitch)

    def _moving(
        self, serving: Attitude, t_s: float, predictions: tuple[RockPrediction, ...], lead_s: float
    ) -> AttitudeMotion:
        """The same for ``lead_s`` later, with rates and standard deviations.

        How well an angle is known is what the predictions for as long ahead are worth: too much for a measured one,
        since it is the whole of what the sensor adds and of what a prediction does.
        """
        roll, pitch = serving.roll_rad, serving.pitch_rad
        soon, later = (predictions[i] for i in self._rate_between)
        apart_s = later.horizon_s - soon.horizon_s
        roll_rate = (later.roll_rad - soon.roll_rad) / apart_s
        pitch_rate = (later.pitch_rad - soon.pitch_rad) / apart_s
        if lead_s == 0.0 and self._vertical.attitude.t_s == t_s:
            # Of the sample itself a gyroscope knows more, by ten times.
            measured = self._vertical.rates_radps
            if isfinite(measured[0] + measured[1]):
                roll_rate, pitch_rate, _ = measured
        roll_std, pitch_std = _stds(predictions, lead_s + t_s - serving.measured_s)
        if (line_s := t_s - serving.t_s) > 0.0:
            factor = TUNING.carried * (1.0 + TUNING.line_per_s * line_s)
            roll_std, pitch_std = factor * roll_std, factor * pitch_std
        if lead_s > 0.0:
            if self._parabola is None:
                return AttitudeMotion(nan, nan, nan, nan)
            roll, roll_rate = self._parabola.at([p.roll_rad for p in predictions])
            pitch, pitch_rate = self._parabola.at([p.pitch_rad for p in predictions])
            return AttitudeMotion(roll, pitch, roll_rate, pitch_rate, roll_std, pitch_std)
        return AttitudeMotion(
            roll,
            pitch,
            roll_rate,
            pitch_rate,
            roll_std if isfinite(roll_std) else serving.roll_std_rad,
            pitch_std if isfinite(pitch_std) else serving.pitch_std_rad,
        )

    def _point_motions(
        self, t_s: float, heave: Heave, now: Heave | None, serving: Attitude, rock: Sequence[RockPrediction]
    ) -> tuple[tuple[PointMotion, ...], tuple[PointMotion, ...]]:
        """Each point, for the moment that the heave is for, and for ``t_s`` itself where that is another."""
        assert self._points is not None
        predictions, lead_s = tuple(rock), self._heave.lead_s
        upright = self._upright_ahead(t_s, predictions)
        present = self._upright(self._moving(serving, t_s, upright, 0.0), t_s)
        led = present
        if lead_s > 0.0:
            led = _of_uncertain_moment(self._moving(serving, t_s, upright, lead_s), self._lean(t_s))
        roll_bend, pitch_bend = self._angular_accelerations(t_s, upright)
        bent = msgspec.structs.replace(
            present, roll_acceleration_radps2=roll_bend, pitch_acceleration_radps2=pitch_bend
        )
        ahead = Ahead(heave.acceleration_mps2, bent, heave.forecast, upright, present.late_std_s)
        foretold = self._points.foretold(t_s, ahead)
        points = self._points.at(
            Moment(
                from_s=t_s,
                t_s=t_s + lead_s,
                heave_m=heave.heave_m,
                std_m=heave.std_m,
                velocity_mps=heave.velocity_mps,
                attitude=led,
            ),
            ahead,
            foretold,
        )
        if now is None:
            return points, ()
        return points, self._points.at(
            Moment(
                from_s=t_s,
                t_s=t_s,
                heave_m=now.heave_m,
                std_m=now.std_m,
                velocity_mps=now.velocity_mps,
                attitude=present,
            ),
            ahead,
            foretold,
        )

    def _upright(self, attitude: AttitudeMotion, t_s: float) -> AttitudeMotion:
        """The attitude of a moment without what the sensor's leans and is late. (How well it is known then is known of
        the predictions.)
        """
        lean, late_s = self._lean(t_s), self._vertical.late_s
        roll, pitch = attitude.roll_rad - lean.roll_rad, attitude.pitch_rad - lean.pitch_rad
        if late_s > 0.0 and isfinite(attitude.roll_rate_radps + attitude.pitch_rate_radps):
            roll, pitch = roll + late_s * attitude.roll_rate_radps, pitch + late_s * attitude.pitch_rate_radps
        return _of_uncertain_moment(msgspec.structs.replace(attitude, roll_rad=roll, pitch_rad=pitch), lean)

    def _lean(self, t_s: float) -> Lean:
        return self._vertical.lean(t_s, self._heave.observer.omega_radps)

    def _upright_ahead(self, t_s: float, predictions: tuple[RockPrediction, ...]) -> tuple[RockPrediction, ...]:
        """The same of what is predicted of the measured roll and pitch."""
        late_s = self._vertical.late_s
        found = []
        for one, (roll_rate, pitch_rate) in zip(predictions, slopes(predictions), strict=True):
            lean = self._lean(t_s + one.horizon_s)
            found.append(
                RockPrediction(
                    horizon_s=one.horizon_s,
                    roll_rad=one.roll_rad - lean.roll_rad + late_s * roll_rate,
                    pitch_rad=one.pitch_rad - lean.pitch_rad + late_s * pitch_rate,
                    roll_std_rad=hypot(one.roll_std_rad, lean.roll_std_rad),
                    pitch_std_rad=hypot(one.pitch_std_rad, lean.pitch_std_rad),
                )
            )
        return tuple(found)

    def _rates(self, is_of_sample: bool, rock: Sequence[RockPrediction]) -> tuple[float, float, float]:
        """Of roll, pitch and yaw: measured with the sample, else between two predictions."""
        roll, pitch, yaw = self._vertical.rates_radps if is_of_sample else NO_RATES
        if isfinite(roll + pitch + yaw):
            return roll, pitch, yaw
        soon, later = (rock[i] for i in self._rate_between)
        apart_s = later.horizon_s - soon.horizon_s
        turned = later.yaw_rad - soon.yaw_rad
        return (
            roll if isfinite(roll) else (later.roll_rad - soon.roll_rad) / apart_s,
            pitch if isfinite(pitch) else (later.pitch_rad - soon.pitch_rad) / apart_s,
            yaw if isfinite(yaw) else remainder(turned, 2.0 * pi) / apart_s if isfinite(turned) else nan,
        )

    def _angular_accelerations(self, t_s: float, predictions: tuple[RockPrediction, ...]) -> tuple[float, float]:
        """Of roll and pitch at a sample; nan: nothing shows them."""
        bend = self._bend
        if bend is None or self._vertical.attitude.t_s != t_s:
            return nan, nan
        roll_before, pitch_before = self._vertical.rates_before(t_s - TUNING.behind_s)
        roll, pitch, _ = self._vertical.rates_radps
        if not isfinite(roll_before + pitch_before + roll + pitch):
            return bend.alone([p.roll_rad for p in predictions]), bend.alone([p.pitch_rad for p in predictions])
        return (
            bend.from_rate([p.roll_rad for p in predictions], roll_before),
            bend.from_rate([p.pitch_rad for p in predictions], pitch_before),
        )

    def _quality(self, t_s: float, heave: Heave | None, fresh: bool, doubts: tuple[str, ...]) -> Quality:
        vertical, estimator = self._vertical, self._heave
        observer, laser, has_laser = estimator.observer, estimator.laser, estimator.has_laser
        state, reasons = judge(
            Facts(
                imu_fault=vertical.fault,
                since_sample_s=t_s - estimator.t_s,
                period_s=vertical.arrivals.period_s,
                settled_s=observer.settled_s,
                needed_s=observer.needed_s,
                error_std_m=nan if heave is None else heave.std_m,
                heave_std_m=observer.heave_std_m(),
                missing=vertical.arrivals.missing,
                doubts=observer.doubts + doubts,
                notes=observer.notes,
                is_still=observer.sea is not None and observer.sea.is_still,
                remarks=laser.remarks() if has_laser else (),
                tilt_removed=vertical.is_tilt_removed(t_s),
                std_scale=laser.std_scale(t_s),
                laser_fault=laser.fault,
                laser_configured=has_laser,
                laser_fresh=fresh,
                imu=vertical.notes,
                withheld=vertical.withheld,
                is_beyond_physics=self._is_beyond or t_s < self._ran_away.until_s,
                is_recovering=vertical.is_recovering(t_s),
            )
        )
        return Quality(
            heave=state,
            laser=LaserState.OFF if not has_laser else LaserState.VALID if fresh else LaserState.STALE,
            correction=estimator.correction_state(laser_is_fresh=fresh) if has_laser else CorrectionState.OFF,
            reasons=(*reasons, *self.remarks) if self.remarks else reasons,
        )


def _is_possible(heave: Heave) -> bool:
    """Whether a vessel does that; what is not known is possible."""
    return not (
        abs(heave.heave_m) > HEAVE_M
        or abs(heave.velocity_mps) > HEAVE_VELOCITY_MPS
        or abs(heave.acceleration_mps2) > HEAVE_ACCELERATION_MPS2
    )


class _Bend(msgspec.Struct, frozen=True):
    """The second derivative of an angle from what is predicted of it."""

    soon: int
    """Horizons among the predictions, by index: the longest of those that there always are, and one that is longer."""
    later: int
    apart_s: float
    between_s: float
    """From now to the middle of the two."""
    nodes: tuple[int, ...]
    weights: tuple[float, ...]
    """Of the second derivative of the parabola that fits them best."""

    @classmethod
    def of(cls, horizons_s: tuple[float, ...]) -> _Bend | None:
        """None: there is no horizon that suits."""
        low_s, high_s = TUNING.ahead_s
        later_s = next((h for h in horizons_s if low_s <= h <= high_s), None)
        if later_s is None:
            return None
        soon_s = STANDARD_HORIZONS_S[-1]
        fitted_s = (*STANDARD_HORIZONS_S, later_s)
        curvature = 2.0 * np.linalg.pinv(np.vander(fitted_s, 3, increasing=True))[2]
        return cls(
            soon=horizons_s.index(soon_s),
            later=horizons_s.index(later_s),
            apart_s=later_s - soon_s,
            between_s=0.5 * (later_s + soon_s),
            nodes=tuple(map(horizons_s.index, fitted_s)),
            weights=tuple(curvature.tolist()),
        )

    def from_rate(self, angles_rad: Sequence[float], before_radps: float) -> float:
        """From the rate of a while ago to that which is predicted."""
        rate = (angles_rad[self.later] - angles_rad[self.soon]) / self.apart_s
        return (rate - before_radps) / (self.between_s + TUNING.behind_s)

    def alone(self, angles_rad: Sequence[float]) -> float:
        """Of a sensor without rates."""
        return sum(weight * angles_rad[i] for i, weight in zip(self.nodes, self.weights, strict=True))


class _Parabola(msgspec.Struct, frozen=True):
    """An angle and its rate between the horizons of predictions: on the parabola through three of them."""

    nodes: tuple[int, ...]
    """Of the predictions, by index."""
    values: tuple[float, ...]
    """Weights of the angle,"""
    slopes: tuple[float, ...]
    """and of its rate."""

    @classmethod
    def of(cls, horizons_s: tuple[float, ...], at_s: float) -> _Parabola | None:
        """None: no horizon is as long."""
        # The middle one of the three that there always are is too near the others: their noise would be the rate.
        spread = [h for h in horizons_s if h not in STANDARD_HORIZONS_S[1:-1]]
        if len(spread) < ORDER:
            spread = list(horizons_s)
        first = next((i for i in range(len(spread) - ORDER + 1) if spread[i + ORDER - 1] >= at_s), None)
        if first is None:
            return None
        nodes_s = spread[first : first + ORDER]
        # Weights w with w . (1, t, t^2) at the nodes = (1, t, t^2) here, and its derivative.
        wanted = np.array([[1.0, 0.0], [at_s, 1.0], [at_s * at_s, 2.0 * at_s]])
        values, slopes = np.linalg.solve(np.vander(nodes_s, increasing=True).T, wanted).T.tolist()
        return cls(tuple(map(horizons_s.index, nodes_s)), tuple(values), tuple(slopes))

    def at(self, angles_rad: Sequence[float]) -> tuple[float, float]:
        """Angle and rate."""
        found = [angles_rad[i] for i in self.nodes]
        return (
            sum(weight * angle for weight, angle in zip(self.values, found, strict=True)),
            sum(weight * angle for weight, angle in zip(self.slopes, found, strict=True)),
        )


def _of_uncertain_moment(attitude: AttitudeMotion, lean: Lean) -> AttitudeMotion:
    """With how well its moment is known; where no rates are, with what that comes to on average."""
    if isfinite(attitude.roll_rate_radps + attitude.pitch_rate_radps):
        return msgspec.structs.replace(attitude, late_std_s=lean.late_std_s)
    return msgspec.structs.replace(
        attitude,
        roll_std_rad=hypot(attitude.roll_std_rad, lean.late_roll_std_rad),
        pitch_std_rad=hypot(attitude.pitch_std_rad, lean.late_pitch_std_rad),
    )


def _stds(predictions: Sequence[RockPrediction], ahead_s: float) -> tuple[float, float]:
    """Standard deviations of roll and pitch predicted that far ahead: those of the first horizon as long."""
    for prediction in predictions:
        if prediction.horizon_s >= ahead_s:
            return prediction.roll_std_rad, prediction.pitch_std_rad
    return nan, nan
