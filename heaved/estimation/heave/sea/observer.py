"""The sea observer, the default: heave straight from the vertical acceleration, by a model of the sea's spectrum.

Same idea as the harmonic observer (the spectrum of the recent past keeps updating the transition matrix, F^m moves the
estimate in time) with three changes: the model is a spectrum instead of a few lines
(:mod:`heaved.estimation.heave.sea.model`), the measurement is the acceleration itself, so that no integrator can drift,
and what the model leaves open is known, so that every number has a standard deviation. Fitting is done beside the event
loop (:mod:`heaved.estimation.heave.sea.refit`): :meth:`SeaObserver.due` hands out the past, :meth:`SeaObserver.accept`
takes what came of it and changes over without a jump.

Samples are averaged into means over about 50 ms, far below the waves: the filter steps once per mean, whatever the rate
of the sensor, and every sample gets its own output, moved from there.
"""

from __future__ import annotations

from collections import Counter, deque
from math import hypot, inf, isfinite, nan, pi, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common import down_sampler
from heaved.estimation.common.bounds import HEAVE_M
from heaved.estimation.common.down_sampler import DownSampler
from heaved.estimation.common.ring import RingBuffer
from heaved.estimation.heave.laser.aiding import Aiding
from heaved.estimation.heave.observer import (
    UNKNOWN,
    LaserAided,
    Motion,
    RollPitch,
    SavedObserver,
    Verdict,
    foretold,
    nothing_foretold,
)
from heaved.estimation.heave.sea.after_gap import TUNING as GAP
from heaved.estimation.heave.sea.after_gap import AfterGap, Finding
from heaved.estimation.heave.sea.blows import BlowDetector
from heaved.estimation.heave.sea.consistency import TUNING as TRUST
from heaved.estimation.heave.sea.consistency import Consistency, Trial
from heaved.estimation.heave.sea.disturbances import DisturbanceDetector
from heaved.estimation.heave.sea.drift import TUNING as DRIFT
from heaved.estimation.heave.sea.drift import DriftDetector, walk_of
from heaved.estimation.heave.sea.filter import BiasRate, GaugeError, SeaFilter
from heaved.estimation.heave.sea.joint import Experience, JointCorrection
from heaved.estimation.heave.sea.joint_design import TUNING as JOINT
from heaved.estimation.heave.sea.joint_learning import TUNING as JOINT_LEARNING
from heaved.estimation.heave.sea.joint_learning import even_angles
from heaved.estimation.heave.sea.mistakes import Mistakes
from heaved.estimation.heave.sea.model import SeaModel, SeaSystem, Steady, heave_std
from heaved.estimation.heave.sea.output import BumplessTransfer, SeaHeave
from heaved.estimation.heave.sea.record import SeaRecord
from heaved.estimation.heave.sea.refit import Candidate, SeaFit, SeaWindow
from heaved.estimation.heave.sea.smoother import FixedLagSmoother
from heaved.samples import DelayedHeave, HeaveForecast, SeaState

if TYPE_CHECKING:
    from heaved.estimation.heave.params import SeaParams

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of the observer as a whole."""

    overconfidence: float = 1.12
    """Published over modelled standard deviation: the fitted spectrum is an estimate too (see tools/accuracy.py
    heave)."""
    cut_s: float = 0.2
    """Where what is measured changes, a few means are of both kinds."""
    unsure_s: float = 60.0
    """Roll and pitch do not correct the heave for so long after the filter was unsure, or they did what no waves do."""
    most_missed: int = 1000
    """Steps that were missed and are made up for."""


TUNING: Final = Tuning()
DRIFTS: Final = "the level of the accelerometer drifts, as that of a sensor that warms up"


class SeaObserver:
    """The :class:`heaved.estimation.heave.observer.HeaveObserver` of a whole spectrum.

    Attributes:
        t_s: time of the last sample.
        resets: by reason.
        steps: of the accelerometer's level that were found; the past stays.
        sea: the newest sea state, or None.
        delayed: the newest delayed heave, or None.
    """

    design_lead_s: Final = 0.0
    """There is no integrator whose phase had to be undone,"""
    has_true_gain: Final = True
    """nor whose gain."""

    def __init__(self, params: SeaParams, horizons_s: tuple[float, ...], lead_s: float = 0.0) -> None:
        """``horizons_s``: of the forecasts. ``lead_s``: what :meth:`at` is mostly asked for, after the last sample."""
        self._params = params
        self._horizons_s, self._lead_s = horizons_s, lead_s
        self._record = SeaRecord(max(params.windows_s), params.first_fit_s, params.refresh_s)
        self.resets: Counter[str] = Counter()
        self.steps = 0
        self._heave: SeaHeave | None = None
        self._aiding = Aiding()
        """Holds the same without the laser, when that is aiding: the smoother's weights are those without it."""
        self._candidates: tuple[Candidate, ...] = ()
        self._trial: Trial | None = None
        self._before = SavedObserver()
        """What the trial began with."""
        self._down_sampler = DownSampler()
        self._angle_samplers: tuple[DownSampler, ...] = ()
        """Of roll and pitch; none: they are not looked at."""
        self._angles = RingBuffer(int(JOINT_LEARNING.learned_s / down_sampler.TUNING.least_s), 4)
        """Time, means of roll and pitch, and yaw."""
        self._experience = Experience(self._late_steps)
        self._disturbance: tuple[Array, Array] | None = None
        self._mistakes = Mistakes()
        self._after_gap: AfterGap | None = None
        """While it is asked whether the sensor has another bias than before a gap."""
        self._start_over()

    def _start_over(self) -> None:
        """Forget the past; a model that is there stays in use, with a state that knows nothing but its spectrum."""
        self.t_s = nan
        self.acceleration_mps2 = nan
        self._bias_mps2 = nan
        self._is_warm = False
        self._after_gap = None
        period_s = self._down_sampler.period_s
        self._down_sampler = DownSampler(period_s)
        if self._params.channels == "auto":
            self._angle_samplers = DownSampler(period_s), DownSampler(period_s)
        self._angles.clear()
        self._angle, self._yaw_rad, self._angles_s = (nan, nan), nan, -inf
        self._experience.reset()
        self._unsure_s = self._missed_s = -inf
        self._record.clear()
        self._looked_s = nan
        self.refreshes = 0
        self.sea: SeaState | None = None
        self.delayed: DelayedHeave | None = None
        self._consistency = Consistency(self._late_steps)
        self._smoother: FixedLagSmoother | None = None
        self._ripening: deque[DelayedHeave] = deque()
        """Delayed heave of a past with holes, not yet as old as it shall be."""
        self._drift: DriftDetector | None = None
        self._drifted_s = nan
        """When the rate of its drift was last one."""
        self._blows = BlowDetector()
        self._straddling = 0
        """Means, with this one, that are in part of before a blow."""
        self._disturbances = DisturbanceDetector()
        self._unaided_disturbances = DisturbanceDetector()
        self._aiding.reset()
        self._mistakes.clear()
        if self._heave is not None:
            kept = self._heave.filter
            self._install(kept.system, kept.steady, nan, np.zeros(len(kept.x)), kept.system.stationary.copy())

    @property
    def _late_steps(self) -> int:
        """Steps of the filter that the delayed heave is late, at most."""
        return int((self._params.delay_s + 5.0) / down_sampler.TUNING.least_s)

    # --- input -------------------------------------------------------------------------------------------------------

    def step(
        self, t_s: float, a_up_mps2: float, roll_rad: float = nan, pitch_rad: float = nan, yaw_rad: float = nan, /
    ) -> None:
        """Take the vertical acceleration at ``t_s`` (later than the last one; nan: missing, nothing happens), with the
        angles of that moment (nan: not known).
        """
        if not isfinite(a_up_mps2):
            return
        self._begin(t_s)
        self.t_s, self.acceleration_mps2 = t_s, a_up_mps2 - self._bias_mps2
        mean = self._down_sampler.step(t_s, a_up_mps2)
        if self._angle_samplers:
            self._keep_angles(t_s, roll_rad, pitch_rad, yaw_rad)
        if mean is None or not self._record.follows(mean[0]) or self._is_blow(*mean):
            return
        heave = self._heave
        if heave is None:
            self._record.push(*mean)
            return
        if not isfinite(heave.filter.t_s):
            heave.filter.t_s = mean[0] - heave.filter.steady.dt_s
        if self._trial is not None:
            self._step_on_trial(heave, self._trial, *mean)
            return
        missed_s = mean[0] - heave.filter.t_s - heave.filter.steady.dt_s
        self._begin_after_gap(heave.filter, mean[0], missed_s)
        predicted_m, innovation = self._filter(heave.filter, *mean)
        self._ask_after_gap(heave.filter, *mean)
        if self._is_sound(heave.filter):
            if self._drift is not None:
                self._follow_drift(heave, self._drift, mean[0], missed_s)
            if self._smoother is not None:
                self._smooth(heave, self._smoother, mean[0], missed_s, predicted_m, innovation)
            if heave.joint is not None:
                self._join(heave, heave.joint, mean[0], missed_s, innovation)
            self._moved(heave)

    def _keep_angles(self, t_s: float, roll_rad: float, pitch_rad: float, yaw_rad: float) -> None:
        """Means of roll and pitch, of the very samples that those of the acceleration are of, and the heading then."""
        samplers = self._angle_samplers
        roll, pitch = samplers[0].step(t_s, roll_rad), samplers[1].step(t_s, pitch_rad)
        if roll is not None and pitch is not None:
            self._angle, self._yaw_rad = (roll[1], pitch[1]), yaw_rad
            if not roll[0] <= self._angles_s:
                self._angles_s = roll[0]
                self._angles.push((roll[0], *self._angle, yaw_rad))

    def _join(self, heave: SeaHeave, joint: JointCorrection, t_s: float, missed_s: float, innovation: float) -> None:
        """What roll and pitch add to the heave, and how that has fared."""
        f, dt_s = heave.filter, heave.filter.steady.dt_s
        missed = min(round(missed_s / dt_s), TUNING.most_missed)
        heave.push_joint(t_s, missed, innovation, self._angle)
        more_m = joint.nodes()[0][0]
        if missed or innovation == 0.0:
            self._missed_s = t_s
        # What a hole leaves open it knows of; what opens the covariance otherwise it does not.
        is_odd = f.burst_variance > 0.0 or f.withheld > 0 or self._disturbances.step_s is not None
        is_open = not heave.is_sure and t_s - self._missed_s > TUNING.unsure_s
        if is_odd or is_open or joint.is_too_much:
            self._unsure_s = t_s
        may_be_used = t_s - self._unsure_s > TUNING.unsure_s and joint.is_known(t_s) and joint.heads(self._yaw_rad)
        may_be_used = may_be_used and f.gauge is None and f.rate is None
        if may_be_used:
            self._experience.say(t_s, float(f.system.heave.dot(f.x)), more_m)
        heave.joint_weight = self._experience.step((1 + missed) * dt_s, may_be_used=may_be_used)
        heave.joint_shown = self._experience.shown

    def _begin(self, t_s: float) -> None:
        """After a gap in which the past was lost, and at the very first sample."""
        if (gap_s := t_s - self.t_s) > self._params.max_gap_s:
            before = self.saved()
            self._reset("gap")
            self._try(before, gap_s)
        if not isfinite(self.t_s):
            self._record.start(t_s)

    def _begin_after_gap(self, f: SeaFilter, t_s: float, missed_s: float) -> None:
        """After a gap the sensor may have another bias; with a laser that aids that is known otherwise."""
        if missed_s > GAP.gap_s and f.gauge is None and self._consistency.is_model_known:
            if f.rate is not None:
                # One that has been off drifts otherwise; one that goes on drifting is found again.
                f.rate = None
                self._record.end_drift(f.t_s)
            self._after_gap = AfterGap(f, t_s)

    def _ask_after_gap(self, f: SeaFilter, t_s: float, a_mps2: float) -> None:
        """Whether it has; then all goes on as after a step of the level."""
        if (asked := self._after_gap) is None:
            return
        if self._disturbances.step_s is not None or f.rate is not None:
            self._after_gap = None
            return
        found = asked.step(f, t_s, a_mps2)
        if found is Finding.ANOTHER:
            f.restore(asked.other.state())
            self._disturbances.restart()
            self._record.cut(*asked.silent_s)
            self.steps += 1
        if found is not Finding.OPEN:
            self._after_gap = None

    def _is_blow(self, t_s: float, a_mps2: float) -> bool:
        """Whether something strikes the hull in this mean, which is then of no use."""
        self._straddling -= 1
        size_mps2 = self._blows.step(t_s, a_mps2)
        if size_mps2 > 0.0:
            self._straddling = 2 if self._down_sampler.averaged > 1 else 1
            if self._heave is None:
                self._record.mark_blow(t_s)
            elif isfinite(self._heave.filter.t_s):
                self._disturbances.strike(self._heave.filter, t_s, a_mps2, size_mps2**2)
                if self._aiding.unaided is not None:
                    self._unaided_disturbances.strike(self._aiding.unaided, t_s, a_mps2, size_mps2**2)
        return self._straddling > 0

    def _filter(self, f: SeaFilter, t_s: float, a_mps2: float) -> tuple[float, float]:
        """Step the filter, and the one without the laser, and keep what is of the sea for the fits; heave before and
        innovation, without the laser.
        """
        rejected = f.rejected
        said = self._guarded_step(self._disturbances, f, t_s, a_mps2)
        self._keep_what_is_of_the_sea(t_s, a_mps2, is_rejected=f.rejected != rejected)
        if self._aiding.unaided is not None:
            said = self._guarded_step(self._unaided_disturbances, self._aiding.unaided, t_s, a_mps2)
        return said

    def _guarded_step(
        self, disturbances: DisturbanceDetector, f: SeaFilter, t_s: float, a_mps2: float
    ) -> tuple[float, float]:
        """Step a filter, guarded where its model is good enough to say what is not of the sea, and after a blow."""
        if self._consistency.is_model_known or disturbances.is_guarding:
            return disturbances.step(f, t_s, a_mps2)
        disturbances.rest(f)
        return f.step(t_s, a_mps2)

    def _follow_drift(self, heave: SeaHeave, drift: DriftDetector, t_s: float, missed_s: float) -> None:
        """Whether the bias goes on in one direction, and the rate of that has to be a state; or is none any more."""
        f = heave.filter
        if self._disturbances.step_s is not None:
            # The record is cut there: what drifts on is another drift.
            f.rate = None
            drift.restart()
        if f.rate is not None:
            if f.gauge is None and abs(f.rate.value) > DRIFT.none_within * sqrt(f.rate.V):
                self._drifted_s = t_s
            elif f.gauge is not None or t_s - self._drifted_s > DRIFT.none_for_s:
                f.rate = None  # A laser that aids holds the bias by itself.
                self._record.end_drift(t_s)
                self._disturbances.restart()
            return
        for _ in range(min(round(missed_s / f.steady.dt_s), DRIFT.most_missed)):
            drift.push(0.0)
        drift.push(f.innovation / sqrt(f.innovation_variance) if heave.is_converged and not f.withheld else 0.0)
        is_one = self._consistency.is_model_known and not self._aiding.is_active and drift.look(t_s)
        if is_one and not self._disturbances.is_burst:
            mean, covariance = drift.mixture()
            f.open_rate(mean, covariance, walk_of(float(mean[-1])))
            self._drifted_s = t_s
            self._record.begin_drift(t_s - drift.began_s - DRIFT.sooner_s)
            self._disturbances.restart()
            drift.restart()

    def _keep_what_is_of_the_sea(self, t_s: float, a_mps2: float, *, is_rejected: bool) -> None:
        """What the filter's step has shown of this mean and of those before it, for the fits."""
        found, record = self._disturbances, self._record
        if found.step_s is not None:
            record.cut(*found.step_s)
            self.steps += 1
        if found.blow_s is not None:
            record.mark_blow(found.blow_s)
        lasting = found.lasting()
        if lasting:
            record.ask_again()
        for at_s, value in (*found.explained[:-1], *lasting):
            if record.follows(at_s):
                record.push(at_s, value)
        if found.spoilt_s is not None:
            record.spoil(*found.spoilt_s)
        if not is_rejected and not found.is_burst:
            # What the gate has kept out is missing for the fits too: half a second of it would spoil minutes.
            record.push(t_s, a_mps2)

    def _is_sound(self, f: SeaFilter) -> bool:
        """Whether the filter has not lost its way; if it has, all begins anew, without a model."""
        if not f.is_sound():
            reason = "not finite"
        elif abs(float(f.system.heave.dot(f.x))) > HEAVE_M:
            reason = "beyond physics"
        else:
            return True
        self._heave = self._trial = None
        self._reset(reason)
        return False

    def _try(self, saved: SavedObserver, age_s: float) -> None:
        """A model that is in use was not fitted to what comes now: it serves when it is found to suit."""
        if self._heave is None:
            self._trial = None
            return
        self._before = msgspec.structs.replace(saved, sea=self.model)
        f, known = self._heave.filter, None
        if saved.bias_mps2 is not None and age_s <= TRUST.bias_serves_s:
            walked = f.system.model.bias_walk_psd * age_s
            x, P = np.zeros(len(f.x)), f.system.stationary.copy()
            x[-1], P[-1, -1] = saved.bias_mps2, saved.bias_std_mps2**2 + walked + TRUST.bias_repeats_mps2**2
            known = SeaFilter(f.system, f.steady, nan, x, P)
        self._trial = Trial(f.system, age_s, known)

    def _step_on_trial(self, heave: SeaHeave, trial: Trial, t_s: float, a_mps2: float) -> None:
        """While it is not known yet whether the model is of this sea, it judges nothing."""
        f, known = heave.filter, trial.known
        if known is not None:
            known.t_s = known.t_s if isfinite(known.t_s) else f.t_s
            known.burst_variance = f.burst_variance
            known.step(t_s, a_mps2)
        self._guarded_step(self._disturbances, f, t_s, a_mps2)
        self._keep_what_is_of_the_sea(t_s, a_mps2, is_rejected=False)
        trial.step(t_s, a_mps2, f.innovation / sqrt(f.innovation_variance))
        if trial.is_told and known is not None:
            self._is_warm = trial.weigh(f, known)
        if trial.is_another:
            self._heave = self._trial = None
            self._is_warm = False
            self.resets["another sea"] += 1
        elif self._is_sound(f):
            self._moved(heave)

    def _smooth(
        self,
        heave: SeaHeave,
        smoother: FixedLagSmoother,
        t_s: float,
        missed_s: float,
        predicted_m: float,
        innovation: float,
    ) -> None:
        dt = heave.filter.steady.dt_s
        for i in range(min(round(missed_s / dt), 1000), 0, -1):
            smoother.push(t_s - i * dt, nan, 0.0)
        # The weights are those of the steady filter: what an unsure one predicted has no place among them.
        smoother.push(t_s, predicted_m if heave.is_converged else nan, innovation)
        left_m = heave.transfer.at(t_s)[0]
        said_m = float(heave.filter.system.heave.dot(heave.filter.x)) + left_m
        self._consistency.divergence.say(t_s, said_m, hypot(heave.state_std_m, left_m))
        delayed = smoother.value()
        while self._ripening and self._ripening[0].t_s <= t_s - self._params.delay_s:
            ripe = self._ripening.popleft()
            delayed = delayed or ripe
        if delayed is not None and (self.delayed is None or delayed.t_s > self.delayed.t_s):
            self._consistency.divergence.check(delayed)
            self._experience.check(delayed, dt)
            # What a disturbance does is the same in hindsight.
            std_m = hypot(delayed.std_m, heave.disturbed_m)
            self.delayed = msgspec.structs.replace(delayed, std_m=std_m) if heave.disturbed_m else delayed

    @property
    def laser_aided(self) -> LaserAided:
        """The filter takes a laser in as it does the acceleration."""
        return self

    def aid(self, t_s: float, laser_m: float, std_m: float) -> None:
        """Take a laser as a measurement of the heave at ``t_s``, its sign applied; what it is off by is found too."""
        if self._heave is None or not isfinite(self._heave.filter.t_s) or not self.is_settled:
            return
        before, was_active = self.at(0.0), self._aiding.is_active
        if self._aiding.step(self._heave, t_s, laser_m, std_m) or self._aiding.is_active != was_active:
            self._moved(self._heave)
        if self._aiding.is_active != was_active:
            self._heave.joint_weight = self._experience.weight = 0.0
            self._transfer(self._heave, before)

    def stop_aiding(self, t_s: float, why: str) -> None:
        """The readings are of another target from ``t_s`` on."""
        if self._heave is not None:
            before = self.at(0.0)
            self._aiding.stop(self._heave, t_s, why)
            self._moved(self._heave)
            self._transfer(self._heave, before)

    def aiding_remark(self, t_s: float) -> str:
        """Why a laser does not aid, for people; or nothing."""
        return self._aiding.remark(t_s)

    def _transfer(self, heave: SeaHeave, before: Motion) -> None:
        """Go over from what was said ``before`` without a jump."""
        if isfinite(before.heave_m):
            after = self.at(0.0)
            dh, dv = before.heave_m - after.heave_m, before.velocity_mps - after.velocity_mps
            left_m, left_mps = heave.transfer.at(self.t_s)
            heave.transfer = BumplessTransfer(dh + left_m, dv + left_mps, self.t_s)

    def _moved(self, heave: SeaHeave) -> None:
        """The state has changed: what follows from it."""
        self._bias_mps2 = float(heave.filter.x[-1])
        if heave.mistaken_m2 and self._mistakes.are_over(self.t_s):
            heave.mistaken_m2 = 0.0
        heave.moved()
        self._consistency.step(heave.filter.surprise, heave.is_recovering, self.sea, heave.state_std_m)
        factor = self._consistency.factor
        if heave.filter.rate is not None:
            factor = max(factor, DRIFT.changes)
        elif self._drift is not None and self._drift.doubt_m > 0.0:
            factor = hypot(factor, self._drift.doubt_m / heave.state_std_m)
        if self._after_gap is not None:
            factor = hypot(factor, self._after_gap.apart_m / heave.state_std_m)
        if (trial := self._trial) is not None:
            factor = max(factor, trial.factor)
            if trial.apart_m > 0.0:
                factor = hypot(factor, trial.apart_m / heave.state_std_m)
        heave.scale = TUNING.overconfidence * factor

    @property
    def is_settled(self) -> bool:
        """Whether the covariance says what is known, so that a laser may be weighed against it."""
        return self.settled_s >= TRUST.needed_s

    def cut(self) -> None:
        """What comes is measured otherwise than what was: no spectrum is taken across."""
        if isfinite(self.t_s):
            self._record.cut(self.t_s, self.t_s + TUNING.cut_s)
            if self._heave is not None:
                self._heave.filter.open_bias()
                self._heave.filter.rate = None

    def amend(self, t_s: Array, more_mps2: Array) -> None:
        """The past at ``t_s`` (n,) was measured too little by ``more_mps2`` (n,): it is looked at anew, soon."""
        self._record.amend(t_s, more_mps2)
        self._mistakes.amend(t_s, more_mps2)

    def disturb(self, f_hz: Array, psd: Array) -> None:
        """What comes, and what came, has noise that no spectrum of it shows (:meth:`SeaHeave.disturb`)."""
        self._disturbance = f_hz, psd
        if self._heave is not None:
            self._heave.disturb(f_hz, psd)

    def mistake(self, t_s: float, shapes: tuple[float, float], covariance: Array) -> None:
        """What :meth:`disturb` says on average, at its moment (:mod:`heaved.estimation.heave.sea.mistakes`)."""
        self._mistakes.push(t_s, shapes, covariance)
        if self._heave is not None:
            self._heave.mistaken_m2 = self._mistakes.square_m2(self._heave.answer)

    def _reset(self, reason: str) -> None:
        self.resets[reason] += 1
        self._start_over()

    # --- fits --------------------------------------------------------------------------------------------------------

    def due(self) -> SeaWindow | None:
        """The past, when it is time for another look at it; each is given out once."""
        # What a burst is will be known soon, and a filter that does not know of it is of no use.
        is_in_burst = self._heave is not None and self._heave.filter.burst_variance > 0.0
        is_changing = self._consistency.is_changing or is_in_burst
        if self._after_gap is not None:
            return None  # Whether it is one record will be known soon.
        if self._disturbances.is_burst or not self._record.is_due(self.t_s, is_changing=is_changing):
            return None
        p = self._params
        number, rows = self._record.ask(self.t_s)
        return SeaWindow(
            number=number,
            t_s=np.ascontiguousarray(rows[:, 0]).tobytes(),
            a_mps2=np.ascontiguousarray(rows[:, 1]).tobytes(),
            stages=p.stages,
            components=p.components,
            windows_s=p.windows_s,
            bias_walk_psd=p.bias_walk_mps2_rts**2,
            delay_s=p.delay_s,
            looked_s=self._looked_s,
            candidates=self._candidates,
            period_s=self._down_sampler.period_s,
            averaged=self._down_sampler.averaged,
            cuts_s=self._record.cuts_s,
            spoilt_s=self._record.spoilt_s,
            blows_s=self._record.blows_s,
            drifts_s=self._record.drifts_s,
            angles=np.ascontiguousarray(self._angles.since(-inf)).tobytes(),
            horizons_s=(*self._horizons_s, self._lead_s),
        )

    def accept(self, fit: SeaFit) -> Verdict:
        """Change over to what was fitted; rejected: it is late, or at the wrong moment."""
        if fit.message or fit.model is None:
            return Verdict.FAILED
        if not self._record.answered(fit.number):
            return Verdict.REJECTED
        if self._heave is not None and self._heave.filter.withheld:
            # Readings are withheld that the next ones will judge: another filter would not know of them.
            self._record.ask_again()
            return Verdict.REJECTED
        if self._heave is not None and self._heave.filter.rate is not None and fit.rate is None:
            # It was looked at before the drift was found.
            self._record.ask_again()
            return Verdict.REJECTED
        if self._heave is not None and self._heave.filter.burst_variance > 0.0 and fit.newest > TRUST.changed:
            # Noise has begun that the new model does not know of, while the old one's filter does.
            return Verdict.REJECTED
        system = SeaSystem(fit.model)
        n = len(system.H)
        steady = system.steady_of(fit.dt_s, np.frombuffer(fit.steady_covariance).reshape(n, n))
        old, before = self._heave, self.at(0.0)
        self._trial = None
        aided = None if old is None else old.filter.gauge
        P = np.frombuffer(fit.P).reshape(n, n).copy() if fit.P else None
        rate = None
        if fit.rate is not None and old is not None and old.filter.rate is not None and aided is None:
            walk_psd = walk_of(fit.rate[0]) ** 2
            rate = BiasRate(*fit.rate, np.frombuffer(fit.rate_covariance), walk_psd)
        heave = self._install(system, steady, fit.t_s, np.frombuffer(fit.x).copy(), P)
        heave.filter.rate = rate
        if aided is not None:
            # What the laser taught is in the old model's state; its constant stays, and brings the new state back.
            heave.filter.gauge = GaugeError(aided.value, aided.V, n)
            heave.filter.P = heave.filter.covariance.copy()
            unaided_P = None if P is None else P.copy()
            self._aiding.renew(SeaFilter(system, steady, fit.t_s, np.frombuffer(fit.x).copy(), unaided_P))
        self._mistakes.known_until(fit.t_s)
        self._disturbances.restart()
        self._unaided_disturbances.restart()
        self._drift = DriftDetector(system, steady, self._drift)
        self._drift.fill(np.nan_to_num(np.frombuffer(fit.innovation)) / sqrt(steady.S))
        self._candidates, self._looked_s = fit.candidates, fit.t_s
        self._consistency.fitted(fit.whiteness, fit.waves, heave.steady_std_m, heave.sea_std_m, fit.waves_seen)
        self.refreshes += 1
        self._smoother = FixedLagSmoother(system, steady, self._params.delay_s)
        self._smoother.fill(fit.t_s, np.frombuffer(fit.predicted_m), np.frombuffer(fit.innovation))
        rows = np.frombuffer(fit.delayed).reshape(-1, 3).tolist()
        youth = self._consistency.youth
        self._ripening = deque([DelayedHeave(t_s=t, heave_m=h, std_m=youth * std) for t, h, std in rows])
        if fit.joint is not None:
            self._take_joint(heave, JointCorrection(fit.joint), fit)
        self._catch_up(heave, self._smoother, fit.t_s)
        if old is not None and aided is not None:
            # The laser's knowledge of the heave itself comes over; the rest of the state it teaches again.
            said_m = float(aided.value.dot((1.0, before.heave_m, before.velocity_mps))) + before.heave_m
            heave.filter.aid(heave.row(self.t_s)[0], said_m, old.state_std_m**2)
            heave.moved()
        self._transfer(heave, before)
        if fit.sea is not None:
            self.sea = msgspec.structs.replace(
                fit.sea,
                t_s=fit.t_s,
                window_s=min(fit.window_s, fit.record_s),
                model=f"{len(fit.model.damping)} chains of {fit.model.stages} resonators",
                is_still=self._consistency.is_still,
            )
        self._moved(heave)
        return Verdict.ACCEPTED

    def _take_joint(self, heave: SeaHeave, joint: JointCorrection, fit: SeaFit) -> None:
        """With the innovations of the new model's filter, and the angles as they were."""
        rows = self._angles.since(-inf)
        known = even_angles(rows[:, :3], fit.t_s, fit.dt_s, round(JOINT.filter_s / fit.dt_s))
        innovations = np.nan_to_num(np.frombuffer(fit.innovation))[-len(known) :]
        before = np.zeros(len(known) - len(innovations))
        joint.fill(fit.t_s, np.column_stack((np.concatenate((before, innovations)), known)))
        heave.join(joint)
        heave.joint_weight, heave.joint_shown = self._experience.weight, self._experience.shown

    def _catch_up(self, heave: SeaHeave, smoother: FixedLagSmoother, from_s: float) -> None:
        """Through the means that came while the fit was under way."""
        filters = [f for f in (heave.filter, self._aiding.unaided) if f is not None]
        cuts = deque(cut[1] for cut in self._record.cuts_s if cut[1] > from_s)
        blows = deque(blow_s for blow_s in self._record.blows_s if blow_s > from_s)
        angles = self._angles.since(from_s)[:, :3]
        for t_s, a_mps2 in self._record.since(from_s).tolist():
            if t_s > heave.filter.t_s:
                while cuts and cuts[0] <= t_s:
                    cuts.popleft()
                    for f in filters:
                        f.open_bias()
                while blows and blows[0] <= t_s:
                    blows.popleft()
                    for f in filters:
                        f.open_resonances()
                # The weights of the smoother are those without the laser.
                missed_s = t_s - heave.filter.t_s - heave.filter.steady.dt_s
                predicted_m, innovation = [f.step(t_s, a_mps2) for f in filters][-1]
                smoother.push(t_s, predicted_m, innovation)
                if heave.joint is not None:
                    at = even_angles(angles, t_s, heave.filter.steady.dt_s, 1)[0].tolist()
                    missed = min(round(missed_s / heave.filter.steady.dt_s), TUNING.most_missed)
                    heave.push_joint(t_s, missed, innovation, at)
                if self._drift is not None and heave.filter.rate is None:
                    self._drift.push(heave.filter.innovation / sqrt(heave.filter.innovation_variance))
        if cuts:
            for f in filters:
                f.open_bias()
        heave.moved()

    def _install(self, system: SeaSystem, steady: Steady, t_s: float, x: Array, P: Array | None) -> SeaHeave:
        rejected = self.rejected
        self._after_gap = None
        self._heave = SeaHeave(SeaFilter(system, steady, t_s, x, P), self._horizons_s, self._lead_s)
        self._heave.filter.rejected = rejected
        if self._disturbance is not None:
            self._heave.disturb(*self._disturbance)
        self._moved(self._heave)
        return self._heave

    # --- output ------------------------------------------------------------------------------------------------------

    def at(self, shift_s: float, learned_lead_s: float = 0.0) -> Motion:
        """Heave ``shift_s`` after the last sample, X* = F^m X; ``learned_lead_s``: how early the sensor is.

        nan before the first fit. Cheap for zero, and for the lead and the horizons of the constructor.
        """
        if self._heave is None or not self._is_told:
            return UNKNOWN
        self._heave.set_lead(learned_lead_s)
        return self._heave.at(self.t_s, shift_s)

    def forecast(
        self, shift_s: float, learned_lead_s: float = 0.0, scale: float = 1.0, gain: float = 1.0
    ) -> tuple[HeaveForecast, ...]:
        """Heave and :meth:`error_std_m` for each horizon of the constructor after a moment ``shift_s`` after the last
        sample, both times ``gain``: what the laser has shown of the sensor's scale.
        """
        horizons_s = self._horizons_s
        if self._heave is None or not self._is_told:
            return nothing_foretold(horizons_s)
        self._heave.set_lead(learned_lead_s)
        if shift_s == 0.0:
            return self._heave.forecast(self.t_s, scale, gain)
        found = []
        for h in horizons_s:
            heave_m, std_m = self._heave.at(self.t_s, shift_s + h).heave_m, self.error_std_m(shift_s + h, scale)
            found.append(foretold(h, gain * heave_m, gain * std_m))
        return tuple(found)

    def unshifted(self) -> Motion:
        """What the laser is compared with: nothing learned taken out."""
        if self._heave is None or not self._is_told:
            return UNKNOWN
        return self._heave.unshifted(self.t_s, self._aiding.unaided)

    @property
    def _is_told(self) -> bool:
        """Whether the model may be spoken from."""
        return self._trial is None or self._trial.is_told

    def error_std_m(self, shift_s: float, scale: float = 1.0) -> float:
        """Standard deviation of the error of :meth:`at`; nan before the first fit.

        From the covariance of the filter, times what recent innovations and the delayed heave have shown, times
        ``scale``: what the laser has shown.
        """
        if self._heave is None or not self._is_told:
            return nan
        return self._heave.std_m(self.t_s, shift_s) * scale

    @property
    def bias_mps2(self) -> float:
        """Of the accelerometer, as the filter has it; 0 before the first fit."""
        return self._bias_mps2 if isfinite(self._bias_mps2) else 0.0

    # --- what it knows of the sea ------------------------------------------------------------------------------------

    def heave_std_m(self) -> float:
        """Standard deviation of the heave of the fitted sea; nan before the first fit."""
        return nan if self._heave is None else self._heave.sea_std_m

    @property
    def omega_radps(self) -> float:
        """Mean frequency of the heave: standard deviation of its velocity over that of itself."""
        return 2.0 * pi / 8.0 if self._heave is None else self._heave.omega_radps

    @property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Centre frequencies of the chains."""
        return () if self.model is None else self.model.frequency_hz

    @property
    def settled_s(self) -> float:
        """Seconds of record since the start or the last reset; nan before the first sample."""
        return self.t_s - self._record.started_s

    @property
    def needed_s(self) -> float:
        """Seconds of record from which it counts as settled: fewer with the model and the bias of before."""
        return TRUST.told_s if self._is_warm else TRUST.needed_s

    @property
    def doubts(self) -> tuple[str, ...]:
        """What is held against the output, for people."""
        return self._consistency.doubts(self.settled_s)

    @property
    def notes(self) -> tuple[str, ...]:
        """What people should know, and no reason to trust the output less."""
        is_drifting = self._heave is not None and self._heave.filter.rate is not None
        return (*self._consistency.notes, DRIFTS) if is_drifting else self._consistency.notes

    @property
    def rejected(self) -> int:
        """Samples that the gate has kept out, since the start or the last reset."""
        return 0 if self._heave is None else self._heave.filter.rejected

    @property
    def roll_pitch(self) -> RollPitch:
        """What roll and pitch have to do with the heave, as the last fit has it."""
        if self._heave is None or self._heave.joint is None:
            return RollPitch()
        return RollPitch(self._heave.joint.design.coherence, self._heave.joint_weight)

    # --- memory ------------------------------------------------------------------------------------------------------

    @property
    def model(self) -> SeaModel | None:
        """The model in use."""
        return None if self._heave is None else self._heave.filter.system.model

    def saved(self) -> SavedObserver:
        """The model in use and the bias that was found with it, for a restart to begin with."""
        heave = self._heave
        if self._trial is not None:
            return self._before
        if heave is None or not heave.is_converged or heave.filter.rate is not None:
            return SavedObserver(sea=self.model)  # A bias that goes on drifting will be another.
        return SavedObserver(
            sea=self.model,
            bias_mps2=float(heave.filter.x[-1]),
            bias_std_mps2=sqrt(max(float(heave.filter.covariance[-1, -1]), 0.0)),
        )

    def restore(self, saved: SavedObserver, age_s: float = nan, /) -> None:
        """Begin with the model of an earlier run, ``age_s`` old; call before the first sample.

        Raises:
            ValueError: it is no model of this configuration, or its filter does not converge.
        """
        if (model := saved.sea) is None:
            return
        p = self._params
        if model.stages != p.stages or not 0 < len(model.damping) <= p.components:
            found = f"{len(model.damping)} chains of {model.stages}"
            raise ValueError(f"saved sea of {found} does not fit the configured {p.components} of {p.stages}")
        system = SeaSystem(model)
        steady = system.steady(down_sampler.TUNING.length_s) if isfinite(heave_std(model)) else None
        if steady is None:
            raise ValueError("the filter of the saved sea does not converge")
        self._install(system, steady, nan, np.zeros(len(system.H)), system.stationary.copy())
        self._try(saved, age_s)
