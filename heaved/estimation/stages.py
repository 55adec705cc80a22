"""The room of the two stages that live beside the heave: the hull's deformation, and the attitude of a craft.

Both are off unless configured. They are given copies of what the pipeline is given and nothing of theirs goes back, so
whatever befalls them the heave is the same to the bit. An exception in one of them, which is a bug, is caught here and
nowhere else: it is counted as a reset, and the stage starts anew.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from math import inf, isfinite, nan, radians
from typing import Final, TypeVar

import numpy as np

from heaved.estimation.common.rotations import ARCSEC, Attitude, crane_base_attitude, from_euler
from heaved.estimation.craft import fusion
from heaved.estimation.craft.fusion import AttitudeEstimate, AttitudeFusion
from heaved.estimation.hull import stage as hull
from heaved.estimation.hull.stage import HullDeformation, HullEstimate, HullState, RefitJob, RefitResult
from heaved.estimation.lever_arm import Crane
from heaved.samples import CraftMotion, CraftSample, Fault, HullAngles, ImuSample, MotionFrame, RatesSample

Result = TypeVar("Result")

UNKNOWN: Final = (nan, nan, nan)


class HullStage:
    """Deformation of the hull from the rates of both IMUs, as they come.

    Attributes:
        angles: the newest, or None before the first.
    """

    def __init__(self, params: hull.Params, refit_inline: bool) -> None:
        """
        Raises:
            ValueError: as :class:`HullDeformation`.
        """
        self._params = params
        self._estimator = HullDeformation(params, refit_inline)
        self._estimate: HullEstimate | None = None
        self.angles: HullAngles | None = None
        self.crane: Crane | None = None
        if params.mount_deg is not None:
            mount = from_euler(*map(radians, params.mount_deg))
            self.crane = Crane(params.base_m, mount, mount)

    def take(self, sample: ImuSample | RatesSample) -> None:
        """The rates of either IMU; without any the sample says nothing."""
        rates = np.array([sample.gx_radps, sample.gy_radps, sample.gz_radps])
        give = self._estimator.give_midships if isinstance(sample, ImuSample) else self._estimator.give_local
        estimate = give(sample.t_s, rates)
        if estimate is not None and estimate is not self._estimate:
            self._estimate = estimate
            self.angles = _angles(estimate)
            if self._is_known(estimate):
                static = from_euler(estimate.static_x_rad, estimate.static_y_rad, estimate.static_z_rad)
                self.crane = Crane(self._params.base_m, estimate.local_from_midships, static)

    def _is_known(self, estimate: HullEstimate) -> bool:
        """Converged, or holding what had converged: crane-base attitude and points may use it."""
        known = estimate.state in (HullState.CONVERGED, HullState.HOLDING)
        return known and max(estimate.std_rad) <= self._params.converged_arcsec * ARCSEC

    def crane_attitude(self, roll_rad: float, pitch_rad: float, yaw_rad: float) -> tuple[float, float, float]:
        """Roll, pitch and yaw of the crane base: the midships ones composed with the newest deformation, which is a
        good second older and changes by arcseconds in it. nan while that is not known; yaw is nan where it is
        midships."""
        estimate = self._estimate
        if estimate is None or not self._is_known(estimate) or not isfinite(roll_rad + pitch_rad):
            return UNKNOWN
        heading = yaw_rad if isfinite(yaw_rad) else 0.0
        base = crane_base_attitude(Attitude(roll_rad, pitch_rad, heading), estimate.local_from_midships)
        return base.roll_rad, base.pitch_rad, base.yaw_rad if isfinite(yaw_rad) else nan

    @property
    def due_refit(self) -> RefitJob | None:
        return self._estimator.due_refit

    def accept(self, result: RefitResult | None) -> bool:
        return self._estimator.accept(result)

    @property
    def resets(self) -> Counter[str]:
        return self._estimator.resets


def _angles(estimate: HullEstimate) -> HullAngles:
    return HullAngles(
        t_s=estimate.t_s,
        state=estimate.state.value,
        warnings=tuple([warning.value for warning in estimate.warnings]),
        total_rad=(estimate.x_rad, estimate.y_rad, estimate.z_rad),
        static_rad=(estimate.static_x_rad, estimate.static_y_rad, estimate.static_z_rad),
        dynamic_rad=estimate.dynamic_rad,
        std_rad=estimate.std_rad,
        reachable_std_rad=estimate.reachable_std_rad,
        delay_s=estimate.delay_s,
        delay_std_s=estimate.delay_std_s,
        refits=estimate.refits,
        resets=estimate.resets,
    )


OWN_STEP_S: Final = 0.05
"""Our own heave is read this often: its errors linger, so more readings tell no more."""
SERVES_S: Final = 0.5
"""A reading of another sensor, and a speed or flap angle, is used for so long; then it is missing."""
CHANNEL_CAUTIONS: Final = {"heave_missing": 0, "pitch_missing": 1}


class AttitudeStage:
    """Heave and pitch of a craft from what its sensors say, in whatever devices they are.

    One device that gives heave and pitch together gives both for one moment. Two devices take turns: each heave
    reading is a step and takes the newest pitch reading along, once; without heave for SERVES_S, pitch readings are.

    Attributes:
        motion: the newest, or None before the first.
    """

    def __init__(self, params: fusion.Params) -> None:
        """
        Raises:
            ArithmeticError: as :class:`AttitudeFusion`.
        """
        self._own = params.source == "own"
        self._estimator = AttitudeFusion(params)
        self._heave_t_s = self._own_t_s = -inf
        self._pitch_rad, self._pitch_t_s, self._pitch_used = nan, -inf, True
        self._drive, self._drive_t_s = (nan, nan, nan), -inf
        self.motion: CraftMotion | None = None

    def take(self, sample: CraftSample) -> None:
        if sample.fault is not Fault.NONE:
            return
        if isfinite(sample.speed_mps) or isfinite(sample.flap_fore_rad) or isfinite(sample.flap_aft_rad):
            self._drive = (sample.speed_mps, sample.flap_fore_rad, sample.flap_aft_rad)
            self._drive_t_s = sample.t_s
        if self._own:
            return
        if isfinite(sample.pitch_rad):
            self._pitch_rad, self._pitch_t_s, self._pitch_used = sample.pitch_rad, sample.t_s, False
        if isfinite(sample.heave_m):
            self._heave_t_s = sample.t_s
        elif not (isfinite(sample.pitch_rad) and sample.t_s - self._heave_t_s > SERVES_S):
            return
        fresh = not self._pitch_used and abs(sample.t_s - self._pitch_t_s) <= SERVES_S
        self._pitch_used = True
        self._step(sample.t_s, sample.heave_m, self._pitch_rad if fresh else nan)

    def take_own(self, frame: MotionFrame) -> None:
        """Our heave and pitch, for the moment of the frame: a heave that is published ahead is taken back by it."""
        if not self._own or frame.t_s - self._own_t_s < OWN_STEP_S - 1e-6:
            return
        self._own_t_s = frame.t_s
        heave_m = frame.heave_m - frame.compensation_lead_s * frame.heave_velocity_mps
        if isfinite(heave_m):
            self._heave_t_s = frame.t_s
        if isfinite(frame.pitch_rad):
            self._pitch_t_s = frame.t_s
        self._step(frame.t_s, heave_m, frame.pitch_rad)

    def _step(self, t_s: float, heave_m: float, pitch_rad: float) -> None:
        drive = self._drive if abs(t_s - self._drive_t_s) <= SERVES_S else UNKNOWN
        estimate = self._estimator.step(t_s, heave_m, pitch_rad, *drive)
        if estimate is not None:
            self.motion = self._motion(estimate)

    def _motion(self, estimate: AttitudeEstimate) -> CraftMotion:
        # A channel that is read at other moments, or less often, is not missing.
        there = [estimate.t_s - t_s <= SERVES_S for t_s in (self._heave_t_s, self._pitch_t_s)]
        cautions = [
            name
            for caution in estimate.cautions
            if not ((name := caution.value) in CHANNEL_CAUTIONS and there[CHANNEL_CAUTIONS[name]])
        ]
        return CraftMotion(
            t_s=estimate.t_s,
            heave_m=estimate.heave_m,
            heave_velocity_mps=estimate.heave_velocity_mps,
            pitch_rad=estimate.pitch_rad,
            pitch_rate_radps=estimate.pitch_rate_radps,
            heave_std_m=estimate.heave_std_m,
            heave_velocity_std_mps=estimate.heave_velocity_std_mps,
            pitch_std_rad=estimate.pitch_std_rad,
            pitch_rate_std_radps=estimate.pitch_rate_std_radps,
            probabilities=estimate.probabilities,
            switches=estimate.switches,
            resets=estimate.resets,
            cautions=tuple(cautions),
        )

    @property
    def resets(self) -> Counter[str]:
        return self._estimator.resets


class Stages:
    """The stages that are switched on, and what befell them.

    Attributes:
        failure: the last exception of a stage, for the log; None when there was none since it was looked at.
    """

    def __init__(
        self,
        hull_params: hull.Params | None = None,
        attitude_params: fusion.Params | None = None,
        *,
        refit_inline: bool = True,
    ) -> None:
        """``refit_inline``: the hull's flexure is fitted where it is due, which takes some tenths of a second.

        Raises:
            ValueError, ArithmeticError: parameters that do not go together.
        """
        self.failure: Exception | None = None
        self._refit_inline = refit_inline
        self._counted: Counter[tuple[str, str]] = Counter()
        self.configure_hull(hull_params or hull.Params())
        self.configure_attitude(attitude_params or fusion.Params())

    def configure_hull(self, params: hull.Params) -> None:
        """Start the hull stage with these parameters, or end it."""
        self._hull_params = params
        self.hull = HullStage(params, self._refit_inline) if params.enabled else None

    def configure_attitude(self, params: fusion.Params) -> None:
        """Start the attitude stage with these parameters, or end it."""
        self._attitude_params = params
        self.attitude = AttitudeStage(params) if params.enabled else None

    # --- input -------------------------------------------------------------------------------------------------------

    def step(self, sample: ImuSample | RatesSample | CraftSample) -> None:
        """Take what may concern a stage."""
        if isinstance(sample, CraftSample):
            if (attitude := self.attitude) is not None:
                self._guarded("attitude", lambda: attitude.take(sample), None)
        elif (deformation := self.hull) is not None and sample.fault is Fault.NONE:
            self._guarded("hull", lambda: deformation.take(sample), None)

    def push_own(self, frame: MotionFrame) -> None:
        """Take our own heave and pitch; what comes of them is in the next frame."""
        if (attitude := self.attitude) is not None:
            self._guarded("attitude", lambda: attitude.take_own(frame), None)

    def accept(self, result: RefitResult | None) -> bool:
        """Take a refit that was computed elsewhere; False: it was of no use."""
        deformation = self.hull
        return deformation is not None and self._guarded("hull", lambda: deformation.accept(result), False)

    # --- output ------------------------------------------------------------------------------------------------------

    @property
    def due_refit(self) -> RefitJob | None:
        return None if self.hull is None else self.hull.due_refit

    @property
    def angles(self) -> HullAngles | None:
        return None if self.hull is None else self.hull.angles

    @property
    def motion(self) -> CraftMotion | None:
        return None if self.attitude is None else self.attitude.motion

    @property
    def crane(self) -> Crane | None:
        """How the crane base stands; None while it is not known."""
        return None if self.hull is None else self.hull.crane

    def crane_attitude(self, roll_rad: float, pitch_rad: float, yaw_rad: float) -> tuple[float, float, float]:
        """Of the crane base, from the midships one; nan while it is not known."""
        deformation = self.hull
        if deformation is None:
            return UNKNOWN
        return self._guarded("hull", lambda: deformation.crane_attitude(roll_rad, pitch_rad, yaw_rad), UNKNOWN)

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """By (filter, reason); an exception's reason is its name."""
        found = Counter(self._counted)
        for name, stage in (("hull", self.hull), ("attitude", self.attitude)):
            if stage is not None:
                found.update({(name, reason): count for reason, count in stage.resets.items()})
        return found

    def _guarded(self, name: str, call: Callable[[], Result], otherwise: Result) -> Result:
        """The one place where a stage may fail."""
        try:
            return call()
        except Exception as error:
            self.failure = error
            stage = self.hull if name == "hull" else self.attitude
            if stage is not None:
                self._counted.update({(name, reason): count for reason, count in stage.resets.items()})
            self._counted[name, type(error).__name__] += 1
            if name == "hull":
                self.configure_hull(self._hull_params)
            else:
                self.configure_attitude(self._attitude_params)
            return otherwise
