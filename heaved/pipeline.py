"""The block diagram, top to bottom: samples in, one :class:`MotionFrame` out. Pure: time comes with the samples.

    IMU --- tilt removed --- heave chain: observer (F^m), gain, residual network --- heave, velocity, standard deviation
                                  ^                                                    '--- points, forecasts, delayed
    laser ------------------------'
    roll, pitch, yaw, rates --- rock predictor --- 50 ms ... 5 s --- quiet windows

Beside it, and never in it, the stages for the hull's deformation (second IMU) and for the attitude of a craft.
"""

from __future__ import annotations

from collections import Counter
from math import isfinite, nan
from typing import Final

import msgspec

from heaved.estimation import points, quiescence
from heaved.estimation.chain import Heave, HeaveChain
from heaved.estimation.correction import Params as CorrectionParams
from heaved.estimation.correction import Saved
from heaved.estimation.forecast_check import ForecastCheck
from heaved.estimation.frames import up_acceleration
from heaved.estimation.heave import HarmonicObserver
from heaved.estimation.heave import Params as HeaveParams
from heaved.estimation.points import Attitude, Point
from heaved.estimation.quality import COAST_S, Facts, judge
from heaved.estimation.quiet_watch import QuietWatch
from heaved.estimation.reference import Params as LaserParams
from heaved.estimation.rock import STANDARD_HORIZONS_S
from heaved.estimation.rock import Params as RockParams
from heaved.estimation.rock_chain import RockChain
from heaved.estimation.sea import SeaObserver
from heaved.estimation.sea_model import SeaModel
from heaved.estimation.sea_window import SeaFit, SeaWindow
from heaved.estimation.spikes import PLAUSIBLE_MPS2
from heaved.estimation.stages import Stages
from heaved.estimation.trail import Trail
from heaved.samples import (
    GRAVITY_MPS2,
    CorrectionState,
    Fault,
    ImuSample,
    LaserSample,
    LaserState,
    MotionFrame,
    PointMotion,
    Quality,
    RockPrediction,
    RockScore,
    Sample,
    TrainedNetwork,
    TrainingWindow,
)

ATTITUDE_HOLD_S: Final = 0.5
"""The last attitude serves this long; then the tilt is unknown."""
MAX_RATE_HZ: Final = 250.0
"""Sizes the rings; a faster sensor is served too, with a shorter memory of late lasers."""
TILT_LASTS_S: Final = 5.0
"""With the tilt removed for that long, or not removed, the record is of one kind."""
LAG_S: Final = 0.005
"""A smaller lag of the accelerometers than this is not worth going back for."""
CHECKED_S: Final = (0.5, 2.0)
"""The forecast of a horizon between these, the one nearest to 1 s, is compared with a plain regression's."""
MISSING_MEMORY_S: Final = 60.0
"""Of the share of lost samples."""
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


class PipelineState(msgspec.Struct, frozen=True, kw_only=True):
    """What a restart remembers."""

    frequencies_hz: tuple[float, ...] = ()
    """Of the harmonic observer."""
    sea: SeaModel | None = None
    lead_learned_s: float | None = None
    gain_learned: float = 1.0
    correction: Saved | None = None


class PipelineSummary(msgspec.Struct, frozen=True, kw_only=True):
    """What a person wants to know of the estimators beside the frame; nan: not known."""

    frequencies_hz: tuple[float, ...]
    refreshes: int
    lead_s: float
    lead_learned_s: float
    gain_learned: float
    lead_comparisons: int
    laser_constant_m: float
    laser_error_rms_m: float
    training_windows: int
    trained_accepted: int
    trained_rejected: int
    trained_failed: int
    last_accepted_t_s: float
    fitted: dict[str, int]
    """Fits of the sea by what became of them."""
    last_fitted_t_s: float
    out_of_order: int
    spikes: int
    rejected: int
    """Beats that the observer's own gate has kept out."""
    rock: tuple[RockScore, ...]


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
        point: tuple[Point, ...] = (),
        lead_s: float = 0.0,
        stages: Stages | None = None,
        quiet: quiescence.Params | None = None,
    ) -> None:
        """``lead_s``: the heave is published for this long after each sample (the consumer's reaction time).

        ``stages``: what lives beside the heave; none by default. It may be handed on to another pipeline.
        """
        self.stages = stages or Stages()
        self._params = heave
        self._has_laser = has_laser
        self._points = point
        self._lead_s = lead_s
        self._chain = HeaveChain(
            heave, laser, correction, has_laser=has_laser, lead_s=self._lead_s, max_rate_hz=MAX_RATE_HZ
        )
        self._rock = RockChain(rock)
        self._quiet: QuietWatch | None = None
        if quiet is not None and quiet.enabled:
            self._quiet = QuietWatch(quiet, next((p for p in point if p.name == quiet.point), None))
        checked_s = min(heave.forecast_horizons_s, key=lambda h: abs(h - 1.0), default=nan)
        self._checked = heave.forecast_horizons_s.index(checked_s) if checked_s == checked_s else 0
        is_checked = CHECKED_S[0] <= checked_s <= CHECKED_S[1] and lead_s < 0.5 * checked_s
        self._check = ForecastCheck(checked_s, lead_s) if is_checked else None
        self._rate_between = tuple(self._rock.horizons_s.index(h) for h in STANDARD_HORIZONS_S[:2])
        self._imu_t_s = self._period_s = nan
        self._missing = 0.0
        self._accepted_t_s = self._fitted_t_s = nan
        self._attitude, self._attitude_t_s = (nan, nan, nan), nan
        self._attitudes = Trail(int(MAX_RATE_HZ))
        self._tilt_removed, self._tilt_since_s = False, nan
        self._imu_fault = Fault.NONE
        self._trained: Counter[str] = Counter()
        self._fitted: Counter[str] = Counter()
        self._out_of_order = 0

    # --- samples in, frames out --------------------------------------------------------------------------------------

    def step(self, sample: Sample) -> MotionFrame | None:
        """Take one sample; a frame for each IMU sample, faulted ones too. One older than the last is counted."""
        if isinstance(sample, LaserSample):
            self._chain.laser.give(sample)
            return None
        if not isinstance(sample, ImuSample):
            self.stages.take(sample)
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
        predicted = self._rock.step(sample, good=good)
        if self._has_laser:
            self._chain.laser.teach(t, self._chain.observer)
        self.stages.take(sample)
        frame = self._frame(t, predicted)
        if self._check is not None:
            forecast_m = frame.forecast[self._checked].heave_m if frame.forecast else nan
            self._check.step(t, frame.observer_m, forecast_m)
        if self._quiet is not None:
            angles = (sample.roll_rad, sample.pitch_rad) if good else (nan, nan)
            self._quiet.step(t, *angles, frame.heave_m, predicted, frame.forecast)
        self.stages.take_frame(frame)
        return frame

    def coast(self, t_s: float) -> MotionFrame:
        """A frame for a moment without a sample: extrapolated, nothing is advanced."""
        return self._frame(t_s, self._rock.at(t_s))

    def _take_attitude(self, sample: ImuSample) -> None:
        if isfinite(sample.roll_rad) and isfinite(sample.pitch_rad):
            self._attitude, self._attitude_t_s = (sample.roll_rad, sample.pitch_rad, sample.yaw_rad), sample.t_s
            self._attitudes.push((sample.t_s, sample.roll_rad, sample.pitch_rad))

    def _attitude_of_acceleration(self, t_s: float) -> tuple[float, float]:
        """Roll and pitch for the moment that the accelerometers show: their own low-pass makes them late, as far as the
        laser has shown, and gravity removed with a later attitude leaves g (rate x lag)^2 / 2, slow and rectified."""
        lag_s = -self._chain.lead.learned_s
        if lag_s > LAG_S:
            then = self._attitudes.at(t_s - lag_s)
            if then is not None:
                return then[1], then[2]
        return self._attitude[0], self._attitude[1]

    def _tilt_known(self, t_s: float) -> bool:
        return t_s - self._attitude_t_s <= ATTITUDE_HOLD_S

    def _observe(self, sample: ImuSample) -> None:
        """Tilt out, then through the heave chain."""
        t, up, before_s = sample.t_s, sample.az_mps2 - GRAVITY_MPS2, self._chain.good_t_s
        self._note_tilt(t, self._tilt_known(t) and isfinite(sample.ax_mps2 + sample.ay_mps2))
        if self._tilt_removed:
            roll, pitch = self._attitude_of_acceleration(t)
            force = (sample.ax_mps2, sample.ay_mps2, sample.az_mps2)
            up = up_acceleration(*force, roll, pitch)
        if isfinite(self._chain.observe(t, up, sample.az_mps2)):
            self._note_interval(t - before_s)
        elif self._chain.stuck.is_stuck and abs(up) <= PLAUSIBLE_MPS2:
            self._imu_fault = Fault.STUCK
        else:
            self._imu_fault = Fault.OUT_OF_RANGE if isfinite(sample.az_mps2) else Fault.NOT_FINITE

    def _note_tilt(self, t_s: float, is_removed: bool) -> None:
        """Whether the tilt is removed; one that comes and goes with a slow attitude sensor is one state, not two."""
        if is_removed != self._tilt_removed:
            if t_s - self._tilt_since_s > TILT_LASTS_S:
                self._chain.interrupt()
            self._tilt_removed, self._tilt_since_s = is_removed, t_s

    def _note_interval(self, interval_s: float) -> None:
        """The usual interval of good samples, and the share of those that are missing."""
        if not isfinite(interval_s):
            return
        step = min(interval_s, COAST_S)
        if not isfinite(self._period_s) or step < 0.5 * self._period_s:
            self._period_s = step
        else:
            # What is lost must not become what is usual, but for a sensor that has become slower for good.
            weight = 0.02 if step < 1.5 * self._period_s else 0.002
            self._period_s += weight * (step - self._period_s)
        usual = min(step, self._period_s) if isfinite(self._period_s) else step
        lost = max(0.0, interval_s - 1.5 * usual)
        weight = min(1.0, interval_s / MISSING_MEMORY_S)
        self._missing += weight * (lost / interval_s - self._missing)

    # --- what is learned ---------------------------------------------------------------------------------------------

    def training_due(self) -> TrainingWindow | None:
        """A window for the trainer, when it is time for one; each is given out once."""
        if not self._has_laser or (self._params.lead.enabled and self._chain.lead.last is None):
            return None  # The first comparison moves the observer, and with it everything there is to learn.
        return self._chain.correction.due(self._chain.good_t_s, self._chain.observer.omega_radps)

    def accept(self, network: TrainedNetwork) -> str:
        """Judge what the trainer made of a window: "accepted", "rejected" or "failed"."""
        result = self._chain.correction.accept(network)
        self._trained[result] += 1
        if result == "accepted":
            self._accepted_t_s = self._chain.good_t_s
        return result

    def fit_due(self) -> SeaWindow | None:
        """The past, when it is time to fit the sea again; each is given out once."""
        return self._chain.observer.due()

    def accept_fit(self, fit: SeaFit) -> str:
        """Change over to a fitted sea: "accepted", "rejected" (it comes too late) or "failed"."""
        result = self._chain.observer.accept(fit)
        self._fitted[result] += 1
        if result == "accepted":
            self._fitted_t_s = fit.t_s
        return result

    def rock_scores(self) -> tuple[RockScore, ...]:
        """How the predictions of roll, pitch and yaw have fared, by axis and horizon."""
        return self._rock.scores()

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """Of the estimators, by (filter, reason)."""
        return self._chain.resets + self._rock.resets + self.stages.resets

    # --- the frame ---------------------------------------------------------------------------------------------------

    def _frame(self, t_s: float, rock: tuple[RockPrediction, ...]) -> MotionFrame:
        observer, reference = self._chain.observer, self._chain.laser.reference
        shift_s = t_s - observer.t_s
        heave = self._chain.at(shift_s) if shift_s <= COAST_S else None
        roll, pitch, yaw = self._attitude if self._tilt_known(t_s) else (nan, nan, nan)
        fresh = self._has_laser and reference.fresh(t_s)
        quality = self._quality(t_s, heave, fresh)
        crane_roll, crane_pitch, crane_yaw = self.stages.crane_attitude(roll, pitch, yaw)
        if heave is None:
            # No number without its uncertainty: before the first look at the sea, and after too long a gap.
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
            quiet=self._quiet.at(t_s) if self._quiet is not None else None,
            forecast=heave.forecast,
            compensation_lead_s=self._lead_s,
            delayed=self._chain.delayed(),
            sea=observer.sea,
            crane_roll_rad=crane_roll,
            crane_pitch_rad=crane_pitch,
            crane_yaw_rad=crane_yaw,
            hull=self.stages.angles,
            attitude=self.stages.motion,
        )

    def _point_motions(
        self, heave: Heave, roll_rad: float, pitch_rad: float, rock: tuple[RockPrediction, ...]
    ) -> tuple[PointMotion, ...]:
        """Each point, for the moment that the heave is for: the attitude moves on with its present rates."""
        # Between two predictions: the noise of the measured attitude, over 50 ms, would be most of the rate.
        soon, later = (rock[i] for i in self._rate_between)
        apart_s = later.horizon_s - soon.horizon_s
        roll_rate = (later.roll_rad - soon.roll_rad) / apart_s
        pitch_rate = (later.pitch_rad - soon.pitch_rad) / apart_s
        attitude = Attitude(
            roll_rad=roll_rad + self._lead_s * roll_rate,
            pitch_rad=pitch_rad + self._lead_s * pitch_rate,
            roll_rate_radps=roll_rate,
            pitch_rate_radps=pitch_rate,
        )
        h, v, crane = heave.heave_m, heave.velocity_mps, self.stages.crane
        return tuple([
            points.crane_motion(point, h, v, attitude, crane)
            if point.frame == "crane"
            else points.motion(point, h, v, attitude)
            for point in self._points
        ])  # fmt: skip

    def _quality(self, t_s: float, heave: Heave | None, fresh: bool) -> Quality:
        chain, observer = self._chain, self._chain.observer
        state, reasons = judge(
            Facts(
                imu_fault=self._imu_fault,
                since_sample_s=t_s - chain.good_t_s,
                period_s=self._period_s,
                settled_s=observer.settled_s,
                needed_s=observer.needed_s,
                error_std_m=nan if heave is None else heave.std_m,
                heave_std_m=observer.heave_std_m(),
                missing=self._missing,
                doubts=(*observer.doubts, *self._check.doubts) if self._check is not None else observer.doubts,
                notes=observer.notes,
                tilt_removed=self._tilt_removed and self._tilt_known(t_s),
                std_scale=chain.laser.reference.std_scale,
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

    # --- memory ------------------------------------------------------------------------------------------------------

    def state(self) -> PipelineState:
        """What a restart shall remember."""
        observer, taught = self._chain.observer, self._chain.lead
        return PipelineState(
            frequencies_hz=observer.frequencies_hz if isinstance(observer, HarmonicObserver) else (),
            sea=observer.model if isinstance(observer, SeaObserver) else None,
            lead_learned_s=taught.learned_s if taught.updates else None,
            gain_learned=taught.gain,
            correction=self._chain.correction.saved(),
        )

    def restore(self, state: PipelineState) -> None:
        """Start from what an earlier run has learned; call before the first sample.

        Raises:
            ValueError: the state does not fit the configuration; says what does not, and nothing was taken over.
        """
        observer = self._chain.observer
        if isinstance(observer, HarmonicObserver) and state.frequencies_hz:
            observer.restore(state.frequencies_hz)
        if isinstance(observer, SeaObserver) and state.sea is not None:
            observer.restore(state.sea)
        if state.correction is not None:
            try:
                self._chain.correction.restore(state.correction)
            except ValueError:
                self._chain.start_over()
                raise
        if state.lead_learned_s is not None:
            self._chain.lead.restore(state.lead_learned_s, state.gain_learned)

    def summary(self) -> PipelineSummary:
        chain, taught = self._chain, self._chain.lead
        return PipelineSummary(
            frequencies_hz=chain.observer.frequencies_hz,
            refreshes=chain.observer.refreshes,
            lead_s=chain.observer.design_lead_s + taught.learned_s,
            lead_learned_s=taught.learned_s if taught.updates else nan,
            gain_learned=taught.gain,
            lead_comparisons=taught.updates,
            laser_constant_m=chain.laser.reference.constant_m,
            laser_error_rms_m=chain.laser.reference.error_rms_m(),
            training_windows=chain.correction.windows,
            trained_accepted=self._trained["accepted"],
            trained_rejected=self._trained["rejected"],
            trained_failed=self._trained["failed"],
            last_accepted_t_s=self._accepted_t_s,
            fitted=dict(self._fitted),
            last_fitted_t_s=self._fitted_t_s,
            out_of_order=self._out_of_order,
            spikes=chain.spikes.rejected,
            rejected=chain.observer.rejected,
            rock=self.rock_scores(),
        )
