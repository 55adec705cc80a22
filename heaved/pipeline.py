"""The block diagram, top to bottom: samples in, one :class:`MotionFrame` out. Pure: time comes with the samples.

    IMU --- tilt removed --- harmonic observer (UKF, F^m) --(+)--- heave, velocity, standard deviation
                                 ^               |           ^
                               lead         X* at laser      '--- residual network <--- trained outside, guarded
                                 '---- laser ----'
    roll, pitch, yaw --- rock predictor --- 50/100/150 ms
"""

from __future__ import annotations

from collections import Counter
from math import isfinite, nan
from typing import Final

import msgspec

from heaved.estimation.correction import Params as CorrectionParams
from heaved.estimation.correction import ResidualCorrection, Saved
from heaved.estimation.frames import up_acceleration
from heaved.estimation.heave import HarmonicObserver
from heaved.estimation.heave import Params as HeaveParams
from heaved.estimation.laser import LaserTeacher
from heaved.estimation.quality import COAST_S, Facts, judge
from heaved.estimation.reference import Params as LaserParams
from heaved.estimation.rock import Params as RockParams
from heaved.estimation.rock import RockPredictor, carried
from heaved.estimation.spikes import SpikeGate
from heaved.samples import (
    GRAVITY_MPS2,
    CorrectionState,
    Fault,
    HeaveForecast,
    ImuSample,
    LaserSample,
    LaserState,
    MotionFrame,
    Quality,
    RockPrediction,
    TrainedNetwork,
    TrainingWindow,
)

ATTITUDE_HOLD_S: Final = 0.5
"""The last attitude serves this long; then the tilt is unknown."""
MAX_RATE_HZ: Final = 250.0
"""Sizes the rings; a faster sensor is served too, with a shorter memory of late lasers."""


class PipelineState(msgspec.Struct, frozen=True, kw_only=True):
    """What a restart remembers."""

    frequencies_hz: tuple[float, ...]
    lead_learned_s: float | None = None
    correction: Saved | None = None


class PipelineSummary(msgspec.Struct, frozen=True, kw_only=True):
    """What a person wants to know of the estimators beside the frame; nan: not known."""

    frequencies_hz: tuple[float, ...]
    lead_s: float
    lead_learned_s: float
    lead_comparisons: int
    laser_constant_m: float
    laser_error_rms_m: float
    training_windows: int
    trained_accepted: int
    trained_rejected: int
    trained_failed: int
    last_accepted_t_s: float
    out_of_order: int
    spikes: int


class Pipeline:
    """Estimators wired together: one instance for one vessel."""

    def __init__(
        self,
        *,
        heave: HeaveParams,
        laser: LaserParams,
        correction: CorrectionParams,
        rock: RockParams,
        has_laser: bool,
    ) -> None:
        self._params = heave
        self._has_laser = has_laser
        self._spikes = SpikeGate()
        self._observer = HarmonicObserver(heave, MAX_RATE_HZ)
        self._correction = ResidualCorrection(correction, MAX_RATE_HZ)
        self._laser = LaserTeacher(laser, heave.lead, self._correction, MAX_RATE_HZ)
        self._rock = RockPredictor(rock)
        self._predicted = tuple(RockPrediction(horizon_s=h) for h in self._rock.horizons_s)
        self._imu_t_s = self._good_t_s = self._period_s = nan
        self._accepted_t_s = nan
        self._attitude, self._attitude_t_s = (nan, nan, nan), nan
        self._tilt_removed = False
        self._imu_fault = Fault.NONE
        self._trained: Counter[str] = Counter()
        self._out_of_order = 0
        self.resets: Counter[tuple[str, str]] = Counter()

    # --- samples in, frames out --------------------------------------------------------------------------------------

    def step(self, sample: ImuSample | LaserSample) -> MotionFrame | None:
        """Take one sample; a frame for each IMU sample, faulted ones too. One older than the last is counted."""
        if isinstance(sample, LaserSample):
            self._laser.give(sample)
            return None
        t = sample.t_s
        if t <= self._imu_t_s:
            self._out_of_order += 1
            return None
        self._imu_t_s, self._imu_fault = t, sample.fault
        good = sample.fault is Fault.NONE
        if good:
            self._take_attitude(sample)
            self._observe(sample)
        attitude = (sample.roll_rad, sample.pitch_rad, sample.yaw_rad) if good else (nan, nan, nan)
        self._predicted = self._rock.step(t, *attitude)
        self._laser.teach(t, self._observer)
        return self._frame(t, self._predicted)

    def coast(self, t_s: float) -> MotionFrame:
        """A frame for a moment without a sample: extrapolated, nothing is advanced."""
        return self._frame(t_s, carried(self._predicted, t_s - self._imu_t_s))

    def _take_attitude(self, sample: ImuSample) -> None:
        if isfinite(sample.roll_rad) and isfinite(sample.pitch_rad):
            self._attitude, self._attitude_t_s = (sample.roll_rad, sample.pitch_rad, sample.yaw_rad), sample.t_s

    def _tilt_known(self, t_s: float) -> bool:
        return t_s - self._attitude_t_s <= ATTITUDE_HOLD_S

    def _observe(self, sample: ImuSample) -> None:
        """Tilt out, spikes out, observer, correction."""
        t, up = sample.t_s, sample.az_mps2 - GRAVITY_MPS2
        self._tilt_removed = self._tilt_known(t) and isfinite(sample.ax_mps2 + sample.ay_mps2)
        if self._tilt_removed:
            roll, pitch, _ = self._attitude
            up = up_acceleration(sample.ax_mps2, sample.ay_mps2, sample.az_mps2, roll, pitch)
        up = self._spikes(t, up)
        if not isfinite(up):
            self._imu_fault = Fault.OUT_OF_RANGE if isfinite(sample.az_mps2) else Fault.NOT_FINITE
            return
        if isfinite(self._good_t_s):
            step = min(t - self._good_t_s, COAST_S)
            self._period_s = step if not isfinite(self._period_s) else self._period_s + 0.02 * (step - self._period_s)
        self._good_t_s = t
        before = self._observer.resets.total()
        self._observer.step(t, up)
        if self._observer.resets.total() != before:
            self.resets = Counter({("heave", reason): count for reason, count in self._observer.resets.items()})
            self._laser.forget()
        observer, unshifted = self._observer.at(0.0, self._laser.lead.learned_s), self._observer.unshifted()
        corrected = observer.heave_m + self._correction.step(t, observer.heave_m, self._observer.omega_radps)
        self._laser.note(t, observer.heave_m, corrected, unshifted)

    # --- what is learned ---------------------------------------------------------------------------------------------

    def training_due(self) -> TrainingWindow | None:
        """A window for the trainer, when it is time for one; each is given out once."""
        if self._params.lead.enabled and self._laser.lead.last is None:
            return None  # The first comparison moves the observer, and with it everything there is to learn.
        return self._correction.due(self._good_t_s, self._observer.omega_radps)

    def accept(self, network: TrainedNetwork) -> str:
        """Judge what the trainer made of a window: "accepted", "rejected" or "failed"."""
        result = self._correction.accept(network)
        self._trained[result] += 1
        if result == "accepted":
            self._accepted_t_s = self._good_t_s
        return result

    # --- the frame ---------------------------------------------------------------------------------------------------

    def _frame(self, t_s: float, rock: tuple[RockPrediction, ...]) -> MotionFrame:
        observer, p, learned_s = self._observer, self._params, self._laser.lead.learned_s
        scale = self._laser.reference.std_scale
        shift = t_s - observer.t_s
        error_std_m = observer.error_std_m(shift, scale) if shift <= COAST_S else nan
        fresh = self._laser.reference.fresh(t_s)
        state, reasons = judge(
            Facts(
                imu_fault=self._imu_fault,
                since_sample_s=t_s - self._good_t_s,
                period_s=self._period_s,
                settled_s=observer.settled_s,
                needed_s=p.window_s,
                error_std_m=error_std_m,
                heave_std_m=observer.heave_std_m(),
                tilt_removed=self._tilt_removed and self._tilt_known(t_s),
                std_scale=scale,
                laser_fault=self._laser.fault,
                laser_configured=self._has_laser,
                laser_fresh=fresh,
            )
        )
        quality = Quality(
            heave=state,
            laser=LaserState.OFF if not self._has_laser else LaserState.VALID if fresh else LaserState.STALE,
            correction=self._correction.state(fresh) if self._has_laser else CorrectionState.OFF,
            reasons=reasons,
        )
        roll, pitch, yaw = self._attitude if self._tilt_known(t_s) else (nan, nan, nan)
        if not isfinite(error_std_m):
            # No number without its uncertainty: before the first look at the sea, and after too long a gap.
            return MotionFrame(t_s=t_s, quality=quality, roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw, rock=rock)
        motion, correction_m = observer.at(shift, learned_s), self._correction.value_m
        return MotionFrame(
            t_s=t_s,
            quality=quality,
            heave_m=motion.heave_m + correction_m,
            heave_std_m=error_std_m,
            heave_velocity_mps=motion.velocity_mps,
            heave_acceleration_mps2=observer.acceleration_mps2 if shift == 0.0 else nan,
            observer_m=motion.heave_m,
            correction_m=correction_m,
            lead_s=observer.design_lead_s + learned_s,
            reference_m=self._laser.reference.value_m if fresh else nan,
            roll_rad=roll,
            pitch_rad=pitch,
            yaw_rad=yaw,
            rock=rock,
            forecast=tuple(
                HeaveForecast(
                    horizon_s=h,
                    heave_m=observer.at(shift + h, learned_s).heave_m,
                    std_m=observer.error_std_m(shift + h, max(scale, 1.0)),
                )
                for h in p.forecast_horizons_s
            ),
        )

    # --- memory ------------------------------------------------------------------------------------------------------

    def state(self) -> PipelineState:
        """What a restart shall remember."""
        return PipelineState(
            frequencies_hz=self._observer.frequencies_hz,
            lead_learned_s=self._laser.lead.learned_s if self._laser.lead.updates else None,
            correction=self._correction.saved(),
        )

    def restore(self, state: PipelineState) -> None:
        """Start from what an earlier run has learned; call before the first sample.

        Raises:
            ValueError: the state does not fit the configuration; says what does not, and nothing was taken over.
        """
        self._observer.restore(state.frequencies_hz)
        if state.correction is not None:
            try:
                self._correction.restore(state.correction)
            except ValueError:
                self._observer = HarmonicObserver(self._params, MAX_RATE_HZ)
                raise
        if state.lead_learned_s is not None:
            self._laser.lead.restore(state.lead_learned_s)

    def summary(self) -> PipelineSummary:
        return PipelineSummary(
            frequencies_hz=self._observer.frequencies_hz,
            lead_s=self._observer.design_lead_s + self._laser.lead.learned_s,
            lead_learned_s=self._laser.lead.learned_s if self._laser.lead.updates else nan,
            lead_comparisons=self._laser.lead.updates,
            laser_constant_m=self._laser.reference.constant_m,
            laser_error_rms_m=self._laser.reference.error_rms_m(),
            training_windows=self._correction.windows,
            trained_accepted=self._trained["accepted"],
            trained_rejected=self._trained["rejected"],
            trained_failed=self._trained["failed"],
            last_accepted_t_s=self._accepted_t_s,
            out_of_order=self._out_of_order,
            spikes=self._spikes.rejected,
        )
