"""The block diagram, top to bottom: samples in, one :class:`MotionFrame` out. Pure: time comes with the samples.

    IMU, its readings judged --- tilt removed --- heave chain: observer (F^m), gain, residual network --- heave, std
      |                                               ^                                  '--- points, forecasts, delayed
      |                              laser ------------'
      '--- roll, pitch, yaw, rates --- rock predictor --- 50 ms ... 5 s --- quiet windows

Beside it, and never in it, the stages for the hull's deformation (second IMU) and for the attitude of a craft.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from math import nan
from typing import Final

import msgspec

from heaved.estimation import quiescence
from heaved.estimation.heave import saved_state as remembered
from heaved.estimation.heave.estimator import HeaveChain
from heaved.estimation.heave.forecast_check import ForecastCheck
from heaved.estimation.heave.laser.correction import Params as CorrectionParams
from heaved.estimation.heave.laser.correction import Saved
from heaved.estimation.heave.laser.reference import Params as LaserParams
from heaved.estimation.heave.observer import SavedObserver, Verdict
from heaved.estimation.heave.params import Params as HeaveParams
from heaved.estimation.heave.sea.model import SeaModel
from heaved.estimation.heave.sea.refit import SeaFit, SeaWindow
from heaved.estimation.imu.conditioning import Conditioned, Conditioner
from heaved.estimation.imu.vertical import Intake
from heaved.estimation.lever_arm import Point
from heaved.estimation.motion_frame import Framer
from heaved.estimation.quiet_windows import QuietWatch
from heaved.estimation.rock.estimator import RockChain
from heaved.estimation.rock.maximum_likelihood import Params as RockParams
from heaved.estimation.stages import Stages
from heaved.samples import (
    Fault,
    ImuSample,
    LaserSample,
    MotionFrame,
    RockPrediction,
    RockScore,
    Sample,
    TrainedNetwork,
    TrainingWindow,
)

MAX_RATE_HZ: Final = 250.0
"""Sizes the rings; a faster sensor is served too, with a shorter memory of late lasers."""


class PipelineState(msgspec.Struct, frozen=True, kw_only=True):
    """What a restart remembers."""

    frequencies_hz: tuple[float, ...] = ()
    """Of the harmonic observer."""
    sea: SeaModel | None = None
    lead_learned_s: float | None = None
    gain_learned: float = 1.0
    correction: Saved | None = None


def check_state(state: PipelineState) -> None:
    """Whether a saved state holds numbers such as a pipeline has learned; that they fit one is seen when it takes them.

    Raises:
        ValueError: they are not; says which.
    """
    remembered.check(
        frequencies_hz=state.frequencies_hz,
        sea=state.sea,
        lead_s=state.lead_learned_s,
        gain=state.gain_learned,
        correction=state.correction,
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
    training_windows: int
    """That were handed out to be trained on."""
    windows_with_nothing_to_learn: int
    """That were not: a regression has shown that no network would be accepted."""
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
        self._chain = HeaveChain(heave, laser, correction, lead_s=lead_s, max_rate_hz=MAX_RATE_HZ)
        self._conditioner = Conditioner()
        self._intake = Intake(self._chain, MAX_RATE_HZ)
        self._rock = RockChain(rock)
        self._framer = Framer(
            self._intake,
            self._chain,
            self.stages,
            has_laser=has_laser,
            point=point,
            lead_s=lead_s,
            rock_horizons_s=self._rock.horizons_s,
        )
        self._quiet: QuietWatch | None = None
        if quiet is not None and quiet.enabled:
            self._quiet = QuietWatch(quiet, next((p for p in point if p.name == quiet.point), None))
        self._check = ForecastCheck.of(heave.forecast_horizons_s, lead_s)
        self._imu_t_s = nan
        self._accepted_t_s = self._fitted_t_s = nan
        self._trained: Counter[Verdict] = Counter()
        self._fitted: Counter[str] = Counter()
        self._out_of_order = 0

    # --- samples in, frames out --------------------------------------------------------------------------------------

    def step(self, sample: Sample) -> MotionFrame | None:
        """Take one sample; a frame for each IMU sample, faulted ones too. One older than the last is counted."""
        return self._step(sample, self._first(sample))

    def run(self, samples: Sequence[Sample]) -> Iterator[MotionFrame | None]:
        """What :meth:`step` gives for one sample after the other; fits and networks may be accepted in between.

        The rock predictor, into which nothing else goes, takes all of them first: a processor is a good part faster
        with many rounds of one thing than with one round of many. So go on to the end before anything else is given.
        """
        for sample, first in [(sample, self._first(sample)) for sample in samples]:
            yield self._step(sample, first)

    def _first(self, sample: Sample) -> tuple[Conditioned, Sequence[RockPrediction]] | None:
        """A sample of the IMU after its readings have been judged, and the rock predictions from there; None for
        others, and for one that is out of order."""
        if not isinstance(sample, ImuSample):
            return None
        if sample.t_s <= self._imu_t_s:
            self._out_of_order += 1
            return None
        self._imu_t_s = sample.t_s
        conditioned = self._conditioner.take(sample)
        return conditioned, self._foresee(conditioned)

    def _foresee(self, conditioned: Conditioned) -> Sequence[RockPrediction]:
        """Predictions for the time of the sample, from when its angles were measured: earlier, with a slow sensor."""
        sample, attitude = conditioned.sample, conditioned.attitude
        self._rock.time_std_s = conditioned.attitude_std_s
        if attitude is None or attitude.t_s == sample.t_s:
            if attitude is None and conditioned.attitude_is_slow:
                return self._rock.at(sample.t_s)
            return self._rock.step(sample, good=sample.fault is Fault.NONE)
        self._rock.step(msgspec.structs.replace(sample, t_s=attitude.t_s), good=True)
        return self._rock.at(sample.t_s)

    def _step(self, sample: Sample, first: tuple[Conditioned, Sequence[RockPrediction]] | None) -> MotionFrame | None:
        """All the rest."""
        if isinstance(sample, LaserSample):
            self._chain.laser.push(sample)
            return None
        if not isinstance(sample, ImuSample):
            self.stages.take(sample)
            return None
        if first is None:
            return None
        conditioned, rock = first
        sample, t = conditioned.sample, sample.t_s
        self._intake.take(conditioned, rock)
        if self._has_laser:
            self._chain.laser.step(t, self._chain.observer)
        self.stages.take(sample)
        frame = self._frame(t, rock)
        if self._check is not None:
            self._check.step(t, frame.observer_m, frame.forecast)
        if self._quiet is not None:
            self._quiet.step(t, sample.roll_rad, sample.pitch_rad, frame.heave_m, rock, frame.forecast)
        self.stages.take_frame(frame)
        return frame

    def coast(self, t_s: float) -> MotionFrame:
        """A frame for a moment without a sample: extrapolated, nothing is advanced."""
        return self._frame(t_s, self._rock.at(t_s))

    def _frame(self, t_s: float, rock: Sequence[RockPrediction]) -> MotionFrame:
        quiet = self._quiet.at(t_s) if self._quiet is not None else None
        return self._framer.frame(t_s, rock, quiet, self._check.doubts if self._check is not None else ())

    # --- what is learned ---------------------------------------------------------------------------------------------

    def training_due(self) -> TrainingWindow | None:
        """A window for the trainer, when it is time for one that a network may gain by; each is given out once."""
        if not self._has_laser or (self._params.lead.enabled and self._chain.lead.last is None):
            return None  # The first comparison moves the observer, and with it everything there is to learn.
        return self._chain.correction.due(self._chain.good_t_s, self._chain.observer.omega_radps)

    def accept(self, network: TrainedNetwork) -> Verdict:
        """Judge what the trainer made of a window."""
        result = self._chain.correction.accept(network)
        self._trained[result] += 1
        if result is Verdict.ACCEPTED:
            self._accepted_t_s = self._chain.good_t_s
        return result

    def fit_due(self) -> SeaWindow | None:
        """The past, when it is time to fit the sea again; each is given out once."""
        return self._chain.observer.due()

    def accept_fit(self, fit: SeaFit) -> Verdict:
        """Change over to a fitted sea; rejected: it comes too late."""
        result = self._chain.observer.accept(fit)
        self._fitted[result] += 1
        if result is Verdict.ACCEPTED:
            self._fitted_t_s = fit.t_s
        return result

    def rock_scores(self) -> tuple[RockScore, ...]:
        """How the predictions of roll, pitch and yaw have fared, by axis and horizon."""
        return self._rock.scores()

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """Of the estimators, by (filter, reason)."""
        return self._chain.resets + self._rock.resets + self.stages.resets + self._framer.resets

    # --- memory ------------------------------------------------------------------------------------------------------

    def state(self) -> PipelineState:
        """What a restart shall remember."""
        learned, taught = self._chain.observer.saved(), self._chain.lead
        return PipelineState(
            frequencies_hz=learned.frequencies_hz,
            sea=learned.sea,
            lead_learned_s=taught.learned_s if taught.updates else None,
            gain_learned=taught.gain,
            correction=self._chain.correction.saved(),
        )

    def restore(self, state: PipelineState, age_s: float = nan) -> None:
        """Start from what an earlier run has learned ``age_s`` ago (nan: not known); call before the first sample.

        Raises:
            ValueError: the state does not fit the configuration; says what does not, and nothing was taken over.
        """
        check_state(state)
        self._chain.observer.restore(SavedObserver(frequencies_hz=state.frequencies_hz, sea=state.sea), age_s)
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
            windows_with_nothing_to_learn=chain.correction.nothing_to_learn,
            trained_accepted=self._trained[Verdict.ACCEPTED],
            trained_rejected=self._trained[Verdict.REJECTED],
            trained_failed=self._trained[Verdict.FAILED],
            last_accepted_t_s=self._accepted_t_s,
            fitted=dict(self._fitted),
            last_fitted_t_s=self._fitted_t_s,
            out_of_order=self._out_of_order,
            spikes=self._conditioner.spikes,
            rejected=chain.observer.rejected,
            rock=self.rock_scores(),
        )
