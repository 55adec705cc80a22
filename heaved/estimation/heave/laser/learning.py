"""What the laser teaches: each reading, compared with the heave of its own time, shows constant, lead and residual.

Source of the comparison: Zhang et al. 2022 (UKF multi-step + BP), section 3.2 and 3.3. A reading may come later than
the heave of its time, and between two samples: what the observer said lately is kept, and read at the reading's time.
"""

from __future__ import annotations

from collections import deque
from math import inf, isfinite, nan
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.ring import RingBuffer
from heaved.estimation.heave.laser import correction, lead, reference
from heaved.estimation.heave.laser.axes import AxisErrors
from heaved.estimation.heave.laser.correction import ResidualCorrection
from heaved.estimation.heave.laser.error_scale import DelayedScale
from heaved.estimation.heave.laser.lead import LeadTracker
from heaved.estimation.heave.laser.placement import Placement, heaves_m
from heaved.estimation.heave.laser.reference import Reference
from heaved.estimation.heave.laser.tilts import Tilts
from heaved.samples import Fault, LaserSample
from heaved.unchanged import StuckDetector

if TYPE_CHECKING:
    from heaved.estimation.heave.laser.placement import SavedPlace
    from heaved.estimation.heave.observer import HeaveObserver, LaserAided

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """When a reading is compared with what."""

    late_s: float = 4.0
    """A reading may come this late and still be compared with the heave of its own time."""
    most_waiting: int = 1024
    """Readings that wait for the heave of their time; beyond, the oldest are let go."""
    reference_after_s: float = 30.0
    """The observer's start is not compared with the laser before this."""
    learn_after_s: float = 60.0
    """Nor is a network trained on it before this: it would learn the transient."""
    moving: float = 3.0
    """The heave must be larger than what is not known of it by that for a laser to be told not to follow it."""
    elsewhere: float = 3.0
    """A gauge that is found elsewhere moves its readings by that many standard deviations of one."""
    straightened: float = 0.3
    """What is learned of what is left is begun anew when the axes have moved the heave by that share of it."""
    longest_pause_s: float = 0.5
    """Between readings further apart than this there was no laser."""


TUNING: Final = Tuning()
UNTOLD: Final = (nan, nan)
NO_TILT: Final = "laser: without roll and pitch nothing is known of the heave from where it is"
UNPLACED: Final = "laser: without roll and pitch it is believed to stand at the IMU"


class LaserLearning:
    """Push it every reading of the laser, and step it once for every sample of the IMU, after the observer.

    Attributes:
        placement: where the gauge is.
        tilts: how the vessel stood; whoever steps this tells it first.
        reference: the laser as heave reference.
        axes: what it has shown of the axes of the accelerometers.
        lead: what it has shown beyond the lead of the chain's own design.
        correction: the residual network, which learns from it.
        delayed: how sure the delayed heave is by it.
        fault: of the last reading that was looked at; STUCK where the readings stand still.
    """

    def __init__(
        self,
        laser: reference.Params,
        comparison: lead.Params,
        network: correction.Params,
        max_rate_hz: float = 250.0,
    ) -> None:
        """``max_rate_hz``: of the IMU; a faster one is served too, with a shorter memory of late readings."""
        self._params = comparison
        self._is_aiding = laser.role == "aiding"
        kept_s = max(TUNING.late_s, float(correction.lags_s(network)[0]) + 5.0)
        self._outputs = RingBuffer(int(kept_s * max_rate_hz), 6)
        """Time, observer output X*, published heave, the unshifted observer's heave and velocity, raw correction."""
        self.placement = Placement(laser.geometry, laser.noise_std_m)
        self.tilts = Tilts(int((TUNING.late_s + 1.0) * max_rate_hz))
        self.reference = Reference(laser)
        self.axes = AxisErrors(max_rate_hz, laser.noise_std_m, enabled=network.enabled)
        self.lead = LeadTracker(comparison)
        self.correction = ResidualCorrection(network, self._outputs)
        self.delayed = DelayedScale(laser.noise_std_m)
        self.fault = Fault.NONE
        self._stuck = StuckDetector(must_live=True)
        self._waiting: deque[LaserSample] = deque(maxlen=TUNING.most_waiting)
        self._compared = RingBuffer(int(comparison.window_s * max_rate_hz), 6)
        """Time of a reading, the unshifted observer's heave and velocity then, the reading, roll and pitch or nan."""
        self._geometry = self.placement.geometry
        """Of the gauge, as its readings have been taken until now."""
        self._is_tilt_missing = False
        self._is_unplaced = False
        """Whether roll and pitch, which would show where it is, are missing, and nothing has shown it before: metres
        ahead of the IMU it looks like an accelerometer that is late, with no more left over.
        """
        self._begun = 0
        """Axes that were found, as often as has been heeded."""
        self._output_t_s = nan
        self._read_t_s = self._used_t_s = -inf
        self._lead_t_s = nan
        self._remark = ""
        self._resets = 0

    # --- what it says ------------------------------------------------------------------------------------------------

    @property
    def lag_s(self) -> float:
        """By which the accelerometers are later than the truth, as far as the laser has shown."""
        return -self.lead.learned_s

    def std_scale(self, t_s: float) -> float:
        """What the laser says about the observer's standard deviation; nothing where that is made from it."""
        if self._is_aiding:
            return 1.0
        scale = self.reference.scale.at(t_s)
        # What agrees with it is right wherever the gauge is; what does not may be so by the gauge's place, which a
        # network that is in use believes in.
        is_doubtful = self.placement.is_open(t_s) and not self.correction.is_applied
        return 1.0 if scale > 1.0 and is_doubtful else scale

    def is_fresh(self, t_s: float) -> bool:
        """Whether there is a reading young enough to be published, of a laser that shows the heave."""
        return self.reference.is_fresh(t_s) and not self._is_doubted

    @property
    def _is_doubted(self) -> bool:
        """Whether the readings are those of something else."""
        return bool(self._remark) or self.placement.is_lost

    def remarks(self) -> tuple[str, ...]:
        """What people should know of the laser."""
        remarks = (
            NO_TILT if self._is_tilt_missing else UNPLACED if self._is_unplaced and not self._is_aiding else "",
            self.placement.remark,
            "" if self.placement.is_lost else self._remark or self.lead.remark,
        )
        return tuple([remark for remark in remarks if remark])

    # --- memory ------------------------------------------------------------------------------------------------------

    def restore_place(self, saved: SavedPlace, age_s: float) -> None:
        """Begin where an earlier run has found the gauge, see :meth:`Placement.restore`."""
        self.placement.restore(saved, age_s)
        self._geometry = self.placement.geometry

    # --- input -------------------------------------------------------------------------------------------------------

    def push(self, sample: LaserSample) -> None:
        """A reading, which waits until the heave of its time is known."""
        self._waiting.append(sample)

    def step(self, t_s: float, observer: HeaveObserver) -> None:
        """After a sample of the IMU at ``t_s``: take the readings whose heave is known by now; now and then, compare
        the lead.
        """
        self._keep_output(observer)
        while self._waiting and not self._waiting[0].t_s > self._output_t_s:
            self._read(self._waiting.popleft(), observer)
        self.placement.trust(self.tilts.std_rad)
        self.placement.push_delayed(observer.delayed)
        self.placement.look(t_s)
        if self.placement.geometry is not self._geometry:
            self._move()
        if (aided := self._aided(observer)) is not None:
            self._remark = aided.aiding_remark(t_s)
        elif self._params.enabled and not t_s - self._lead_t_s < self._params.refresh_s:
            self._lead_t_s = t_s
            self._learn_lead(t_s, observer)

    def _keep_output(self, observer: HeaveObserver) -> None:
        """What the observer says at its last sample, and the correction on top of it."""
        if (resets := observer.resets.total()) != self._resets:
            self._resets = resets
            self._reset()
        t_s = observer.t_s
        if t_s == self._output_t_s or not isfinite(t_s):
            return  # The sample had no acceleration; nor has there been any, perhaps.
        now = observer.at(0.0, self.lead.learned_s)
        if not isfinite(now.heave_m):
            return  # There is no model of the sea yet, and nothing to compare.
        unshifted = observer.unshifted()
        observer_m = self.lead.gain * now.heave_m
        published_m = observer_m + self.correction.step(t_s, observer_m, observer.omega_radps)
        self._output_t_s = t_s
        self._outputs.push(
            (t_s, observer_m, published_m, unshifted.heave_m, unshifted.velocity_mps, self.correction.raw_m)
        )

    def _reset(self) -> None:
        """The observer was restarted: nothing that it said before can be compared."""
        self._outputs.clear()
        self._compared.clear()
        self.placement.restart()
        self.correction.reset()

    def _move(self) -> None:
        """The gauge is taken to be elsewhere: its readings are others, as far back as they are kept."""
        before, now = self._geometry, self.placement.geometry
        self._geometry = now
        rows = self._compared.last(len(self._compared))[:, 3:]
        more_m = heaves_m(now, *rows.T) - heaves_m(before, *rows.T)
        known_m = more_m[np.isfinite(more_m)]
        by_m, spread_m = (float(np.mean(known_m)), float(np.std(known_m))) if len(known_m) else (0.0, 0.0)
        is_elsewhere = spread_m > TUNING.elsewhere * self.reference.reading_std_m
        self.reference.move(self._output_t_s, by_m, is_elsewhere=is_elsewhere)
        self.correction.reset_rows()

    def _straighten(self) -> None:
        """What the axes are taken to put into the acceleration has changed, and the heave with it."""
        self.reference.rebase(self._output_t_s)
        is_much = self.axes.moved_m > TUNING.straightened * self.reference.error_rms_m()
        self.correction.move(by_m=self.axes.moved_m)
        if is_much:
            self.correction.reset_rows()
        if self.axes.begun == self._begun or not is_much:
            return
        self._begun = self.axes.begun
        self._compared.clear()
        self.reference.move(self._output_t_s, 0.0, is_elsewhere=True)
        if self.placement.is_off or not self.placement.is_known:
            # What a heave with leaks in it shows of the gauge's place is some of them.
            self.placement.restart()

    def _aided(self, observer: HeaveObserver) -> LaserAided | None:
        """The observer that readings go into as measurements; None: they are compared with it."""
        return observer.laser_aided if self._is_aiding else None

    def _read(self, sample: LaserSample, observer: HeaveObserver) -> None:
        self.fault = sample.fault
        t_s = sample.t_s
        if not t_s > self._read_t_s:
            return
        self._read_t_s = t_s
        if self._stuck.step(t_s, sample.laser_m) and sample.fault is Fault.NONE:
            self.fault = Fault.STUCK
        if self.fault is not Fault.NONE or not isfinite(sample.laser_m) or not t_s > self._used_t_s:
            return
        settled_s = observer.settled_s
        if not settled_s >= TUNING.reference_after_s or observer.refreshes == 0:
            return
        _, observer_m, published_m, heave_m, velocity_mps, raw_m = self._outputs.at(t_s).tolist()
        tilt = self.tilts.at(t_s)
        signed_m = self.placement.heave_m(sample.laser_m, tilt)
        self._is_tilt_missing = not isfinite(signed_m)
        self._is_unplaced = tilt is None and not self.placement.is_known
        if not isfinite(observer_m + signed_m):
            return
        self._used_t_s = t_s
        aided = self._aided(observer)
        verdict = self.reference.step(t_s, signed_m, published_m, observer.error_std_m(0.0))
        if verdict is reference.Reading.NEW_TARGET:
            self._compared.clear()
            self.placement.retarget()
            self.axes.retarget()
            self.correction.reset_rows()
            if aided is not None:
                aided.stop_aiding(t_s, "it is on another target")
        if verdict is not reference.Reading.ACCEPTED:
            return
        if self.axes.push(t_s, sample.laser_m, tilt, self.placement.configured):
            self._straighten()
        self.placement.push(t_s, sample.laser_m, heave_m, velocity_mps, tilt)
        self._compared.push((t_s, heave_m, velocity_mps, sample.laser_m, *(tilt or UNTOLD)))
        if self.reference.is_known and self.reference.is_proven and not self._is_doubted:
            self.delayed.push(t_s, self.reference.value_m)
        if aided is not None:
            if not self.placement.is_lost:
                aided.aid(t_s, signed_m, self.reference.reading_std_m)
            return
        if settled_s >= TUNING.learn_after_s and not self._is_doubted:
            self.correction.learn(t_s, signed_m - observer_m, self.reference.constant_m, observer_m, raw_m)

    # --- lead and gain -----------------------------------------------------------------------------------------------

    def _learn_lead(self, t_s: float, observer: HeaveObserver) -> None:
        """The lead that the laser shows beyond that of the chain's own design."""
        rows = self._compared.since(t_s - self._params.window_s)
        if float(np.minimum(np.diff(rows[:, 0]), TUNING.longest_pause_s).sum()) < self._params.min_laser_s:
            return
        is_first, lead_s, gain = self.lead.updates == 0, self.lead.learned_s, self.lead.gain
        signed_m = heaves_m(self.placement.geometry, *rows[:, 3:].T)
        shown = lead.compare(rows[:, 0], rows[:, 1], rows[:, 2], signed_m, observer.omega_radps)
        is_learned = self.lead.update(
            shown,
            observer.design_lead_s,
            has_true_gain=observer.has_true_gain,
            may_learn=not self.placement.is_open(t_s),
            unsure=self.placement.unsure,
        )
        if is_learned:
            self.reference.rebase(self._output_t_s)
            turned = (self.lead.learned_s - lead_s) * observer.omega_radps
            self.correction.move(gain=self.lead.gain / gain - 1.0, phase_rad=turned)
        was_doubted, self._remark = bool(self._remark), self._doubt(shown, rows[:, 1], observer)
        if (is_learned and is_first) or (self._remark and not was_doubted):
            self.correction.reset_rows()

    def _doubt(self, shown: lead.Comparison | None, heave_m: Array, observer: HeaveObserver) -> str:
        """Why the laser is not to be believed, for people; or nothing."""
        if self.lead.refused:
            return f"laser: {self.lead.refused}"
        error_m = self.lead.gain * observer.error_std_m(0.0)
        is_moving = float(np.std(heave_m)) > TUNING.moving * max(self.reference.reading_std_m, error_m)
        if shown is not None and is_moving and shown.coherence < self._params.min_coherence:
            return "laser: it does not follow the heave"
        return ""
