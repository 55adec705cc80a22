"""The block diagram, top to bottom: samples in, one :class:`MotionFrame` out. Pure: time comes with the samples.

    IMU --- conditioner: every reading judged
              |
              |--- rock: roll, pitch, yaw --- 50 ms ... 5 s ahead ------------------------.
              |                                                                           |
              '--- vertical: tilt, bias out --- heave: observer, gain, network --- heave, std, forecasts, delayed
                                                  ^                                       |
    laser gauge --- laser: lag, scale, residual --'                              motion frame, quality
                                                                                          |
    Beside it: stages (hull between two IMUs, attitude of a craft,        forecast check, quiet windows
               the moving crane: where the points on it are)

:meth:`Pipeline.step` is the only way through it.
"""

from __future__ import annotations

from collections import Counter
from math import nan
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.estimation.heave import saved_state
from heaved.estimation.heave.estimator import HeaveEstimator
from heaved.estimation.heave.forecast_check import ForecastCheck
from heaved.estimation.heave.laser.placement import LaserPlace
from heaved.estimation.heave.observer import RollPitch, SavedObserver, Verdict
from heaved.estimation.heave.saved_state import SavedState
from heaved.estimation.imu.conditioning import Conditioner
from heaved.estimation.imu.vertical import Vertical
from heaved.estimation.motion_frame import LEFT_OUT, MotionFrames
from heaved.estimation.quiescence import PointQuiescence
from heaved.estimation.rock.estimator import RockEstimator
from heaved.estimation.stages import Stages
from heaved.samples import (
    ImuSample,
    LaserSample,
    MotionFrame,
    RockPrediction,
    RockScore,
    Sample,
    TrainedNetwork,
    TrainingWindow,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.estimation import quiescence
    from heaved.estimation.heave.laser.correction import Params as CorrectionParams
    from heaved.estimation.heave.laser.reference import Params as LaserParams
    from heaved.estimation.heave.params import Params as HeaveParams
    from heaved.estimation.heave.sea.refit import SeaFit, SeaWindow
    from heaved.estimation.lever_arm import Point
    from heaved.estimation.rock.params import Params as RockParams

MAX_RATE_HZ: Final = 250.0
"""Sizes the buffers; a faster sensor is served too, with a shorter memory of late lasers."""


class Pipeline:
    """Estimators of one vessel, one after the other."""

    def __init__(
        self,
        *,
        conditioner: Conditioner,
        rock: RockEstimator,
        vertical: Vertical,
        heave: HeaveEstimator,
        stages: Stages,
        frames: MotionFrames,
        check: ForecastCheck | None = None,
        quiet: PointQuiescence | None = None,
    ) -> None:
        """``stages`` may be handed on to another pipeline. ``frames`` makes frames of these very estimators."""
        self.conditioner = conditioner
        self.rock = rock
        self.vertical = vertical
        self.heave = heave
        self.laser = heave.laser
        self.stages = stages
        self.frames = frames
        self.check = check
        self.quiet = quiet
        self._t_s = nan
        self._is_relieved = self._leaves_out = False
        self._out_of_order = 0
        self._trained: Counter[Verdict] = Counter()
        self._fitted: Counter[Verdict] = Counter()

    # --- samples in, frames out --------------------------------------------------------------------------------------

    def step(self, sample: Sample) -> MotionFrame | None:
        """Take one sample; a frame for each IMU sample, faulted ones too. One older than the last is counted."""
        if isinstance(sample, LaserSample):
            self.laser.push(sample)
            return None
        if not isinstance(sample, ImuSample):
            self.stages.push(sample)
            return None
        if sample.t_s <= self._t_s:
            self._out_of_order += 1
            return None
        t_s = self._t_s = sample.t_s
        readings = self.conditioner.step(sample)
        # Of a sensor that measures angles more slowly than it is polled, tilt is carried on by what is predicted.
        self._leave_out(self._is_relieved and not readings.attitude_is_slow)
        rock = self.rock.unknown if self._leaves_out else self.rock.step(readings)
        axes = self.laser.axes
        if axes.amendment is not None:
            self.vertical.amend(axes.amendment)
        up = self.vertical.step(
            readings,
            rock,
            lag_s=self.laser.lag_s,
            bias_mps2=self.heave.observer.bias_mps2,
            leaking=axes.taken,
        )
        if up is not None:
            self.heave.step(up)
        if self.heave.has_laser:
            vertical, observer = self.vertical, self.heave.observer
            self.laser.tilts.push(vertical.attitude, vertical.lean(t_s, observer.omega_radps), vertical.late_s)
            self.laser.step(t_s, observer)
        self.stages.push(readings.sample)
        frame = self._frame(t_s, rock)
        if self.check is not None:
            self.check.step(t_s, frame.observer_m, frame.forecast)
        if self.quiet is not None and not self._leaves_out:
            self.quiet.step(readings.sample, frame)
        self.stages.push_frame(frame)
        return frame

    def coast(self, t_s: float) -> MotionFrame:
        """A frame for a moment without a sample: extrapolated, nothing is advanced."""
        return self._frame(t_s, self.rock.unknown if self._leaves_out else self.rock.at(t_s))

    def relieve(self, *, is_relieved: bool) -> None:
        """Do without what the heave does without, rock predictions and quiet windows, or no longer: for a machine that
        cannot do all. Not where points are published ahead of time: it takes the predictions.
        """
        needs_rock = self.heave.lead_s > 0.0 and self.frames.has_points
        self._is_relieved = is_relieved and not needs_rock

    def _leave_out(self, leaves_out: bool) -> None:
        if leaves_out is not self._leaves_out:
            self._leaves_out = leaves_out
            self.frames.remarks = LEFT_OUT if leaves_out else ()

    def _frame(self, t_s: float, rock: Sequence[RockPrediction]) -> MotionFrame:
        quiet = None if self.quiet is None else self.quiet.at(t_s)
        return self.frames.at(t_s, rock, quiet, () if self.check is None else self.check.doubts)

    # --- what is learned ---------------------------------------------------------------------------------------------

    def training_due(self) -> TrainingWindow | None:
        """A window for the trainer, when it is time for one that a network may gain by; each is given out once."""
        return self.heave.training_due()

    def accept(self, network: TrainedNetwork) -> Verdict:
        """Judge what the trainer made of a window."""
        verdict = self.heave.correction.accept(network)
        self._trained[verdict] += 1
        return verdict

    def fit_due(self) -> SeaWindow | None:
        """The past, when it is time to fit the sea again; each is given out once."""
        return self.heave.observer.due()

    def accept_fit(self, fit: SeaFit) -> Verdict:
        """Change over to a fitted sea; one that comes too late is rejected."""
        verdict = self.heave.observer.accept(fit)
        self._fitted[verdict] += 1
        return verdict

    def rock_scores(self) -> tuple[RockScore, ...]:
        """How the predictions of roll, pitch and yaw have fared, by axis and horizon."""
        return self.rock.scores()

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """Of the estimators, by (filter, reason)."""
        return self.heave.resets + self.rock.resets + self.stages.resets + self.frames.resets

    # --- memory ------------------------------------------------------------------------------------------------------

    def state(self) -> SavedState:
        """What a restart shall remember."""
        observer, lead = self.heave.observer.saved(), self.laser.lead
        return SavedState(
            frequencies_hz=observer.frequencies_hz,
            sea=observer.sea,
            bias_mps2=observer.bias_mps2,
            bias_std_mps2=observer.bias_std_mps2,
            lead_learned_s=lead.learned_s if lead.updates else None,
            gain_learned=lead.gain,
            correction=self.heave.correction.saved(),
            hull=self.stages.saved_hull(),
            attitude_error=self.vertical.saved(),
            laser_place=self.laser.placement.saved(),
            axes=self.laser.axes.saved(),
        )

    def restore(self, state: SavedState, age_s: float = nan) -> None:
        """Start from what an earlier run has learned ``age_s`` ago (nan: not known); call before the first sample.

        Raises:
            ValueError: the state does not fit the configuration; says what does not, and nothing was taken over.
        """
        saved_state.check(state)
        observer = SavedObserver(
            frequencies_hz=state.frequencies_hz,
            sea=state.sea,
            bias_mps2=state.bias_mps2,
            bias_std_mps2=state.bias_std_mps2,
        )
        self.heave.restore(observer, state.correction, age_s)
        if state.lead_learned_s is not None:
            self.laser.lead.restore(state.lead_learned_s, state.gain_learned)
        if state.laser_place is not None and self.heave.has_laser:
            self.laser.restore_place(state.laser_place, age_s)
        if state.axes is not None and self.heave.has_laser:
            self.laser.axes.restore(state.axes, age_s)
        if state.attitude_error is not None:
            self.vertical.restore(state.attitude_error, age_s)
        if state.hull is not None:
            self.stages.restore_hull(state.hull, age_s)

    def summary(self) -> PipelineSummary:
        """What a person wants to know beside the frame."""
        observer, lead, correction = self.heave.observer, self.laser.lead, self.heave.correction
        return PipelineSummary(
            frequencies_hz=observer.frequencies_hz,
            refreshes=observer.refreshes,
            lead_s=observer.design_lead_s + lead.learned_s,
            lead_learned_s=lead.learned_s if lead.updates else nan,
            gain_learned=lead.gain,
            lead_comparisons=lead.updates,
            laser_constant_m=self.laser.reference.constant_m,
            laser_error_rms_m=self.laser.reference.error_rms_m(),
            laser_place=self.laser.placement.shown,
            training_windows=correction.windows,
            windows_with_nothing_to_learn=correction.nothing_to_learn,
            trained_accepted=self._trained[Verdict.ACCEPTED],
            trained_rejected=self._trained[Verdict.REJECTED],
            trained_failed=self._trained[Verdict.FAILED],
            fitted={verdict.value: count for verdict, count in self._fitted.items()},
            out_of_order=self._out_of_order,
            spikes=self.conditioner.spikes,
            rejected=observer.rejected,
            roll_pitch=observer.roll_pitch,
            rock=self.rock_scores(),
        )


def assemble(
    *,
    heave: HeaveParams,
    laser: LaserParams,
    correction: CorrectionParams,
    rock: RockParams | RockEstimator,
    has_laser: bool,
    point: tuple[Point, ...] = (),
    lead_s: float = 0.0,
    stages: Stages | None = None,
    quiet: quiescence.Params | None = None,
    attitude_late_s: float = 0.0,
) -> Pipeline:
    """The pipeline of a configuration.

    ``lead_s``: the heave is published for this long after each sample (the consumer's reaction time). ``stages``: what
    lives beside the heave; none by default. ``rock``: its parameters, or an estimator that is there already.
    ``attitude_late_s``: see :class:`Vertical`.
    """
    stages = stages or Stages()
    vertical = Vertical(MAX_RATE_HZ, attitude_late_s)
    rocking = rock if isinstance(rock, RockEstimator) else RockEstimator(rock)
    heaving = HeaveEstimator(heave, laser, correction, has_laser=has_laser, lead_s=lead_s, max_rate_hz=MAX_RATE_HZ)
    return Pipeline(
        conditioner=Conditioner(),
        rock=rocking,
        vertical=vertical,
        heave=heaving,
        stages=stages,
        frames=MotionFrames(vertical, heaving, stages, point=point, rock_horizons_s=rocking.horizons_s),
        check=ForecastCheck.of(heave.forecast_horizons_s, lead_s),
        quiet=PointQuiescence.of(quiet, point),
    )


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
    laser_place: LaserPlace
    training_windows: int
    """That were handed out to be trained on."""
    windows_with_nothing_to_learn: int
    """That were not: a regression has shown that no network would be accepted."""
    trained_accepted: int
    trained_rejected: int
    trained_failed: int
    fitted: dict[str, int]
    """Fits of the sea by what became of them."""
    out_of_order: int
    spikes: int
    rejected: int
    """Means of 50 ms that the observer's own gate has kept out."""
    roll_pitch: RollPitch
    rock: tuple[RockScore, ...]
