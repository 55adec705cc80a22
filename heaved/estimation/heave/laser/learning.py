"""What the laser teaches: each reading, compared with the heave of its own time, shows constant, lead and residual."""

from __future__ import annotations

from collections import deque
from math import inf, isfinite, nan
from typing import Final

import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.ring import RingBuffer
from heaved.estimation.heave.laser import lead, reference
from heaved.estimation.heave.laser.correction import ResidualCorrection
from heaved.estimation.heave.laser.delayed_scale import DelayedOutput
from heaved.estimation.heave.observer import HeaveObserver, LaserAided, Motion
from heaved.samples import Fault, LaserSample
from heaved.unchanged import StuckDetector

Array = NDArray[np.float64]

LATE_S: Final = 4.0
"""A reading may come this late and still be compared with the heave of its own time."""
REFERENCE_AFTER_S: Final = 30.0
"""The observer's start is not compared with the laser before this."""
MOVING: Final = 3.0
"""The heave must be larger than what is not known of it by that for a laser to be told not to follow it."""
LEARN_AFTER_S: Final = 60.0
"""Nor is a network trained on it before this: it would learn the transient."""


class LaserTeacher:
    """Holds the reference and the lead, and feeds the correction with residuals.

    Attributes:
        reference: the laser as heave reference.
        lead: what it has shown beyond the lead of the chain's own design.
        delayed: the delayed heave with both.
        fault: of the last reading that was looked at; STUCK where the readings stand still.
    """

    def __init__(
        self, laser: reference.Params, comparison: lead.Params, correction: ResidualCorrection, max_rate_hz: float
    ) -> None:
        self._params = comparison
        self._is_aiding = laser.role == "aiding"
        self._correction = correction
        self.reference = reference.Reference(laser)
        self.lead = lead.LeadTracker(comparison)
        self.delayed = DelayedOutput(laser.noise_std_m)
        self.fault = Fault.NONE
        self._stuck = StuckDetector(must_live=True)
        self._waiting: deque[LaserSample] = deque(maxlen=1024)
        self._outputs = RingBuffer(int(LATE_S * max_rate_hz), 5)
        """Time, observer output X*, published heave, and the unshifted observer's heave and velocity."""
        self._compared = RingBuffer(int(comparison.window_s * max_rate_hz), 4)
        """Time of a reading, the unshifted observer's heave and velocity then, the signed reading."""
        self._output_t_s = nan
        self._read_t_s = self._taken_t_s = -inf
        self._lead_t_s = nan
        self._remark = ""

    @property
    def lag_s(self) -> float:
        """By which the accelerometers are later than the truth, as far as the laser has shown."""
        return -self.lead.learned_s

    def std_scale(self, t_s: float) -> float:
        """What the laser says about the observer's standard deviation; nothing where that is made from it."""
        return 1.0 if self._is_aiding else self.reference.std_scale_at(t_s)

    def is_fresh(self, t_s: float) -> bool:
        """Whether there is a reading young enough to be published, of a laser that shows the heave."""
        return self.reference.fresh(t_s) and not self._remark

    def remarks(self) -> tuple[str, ...]:
        """What people should know of the laser."""
        remark = self._remark or self.lead.remark
        return (remark,) if remark else ()

    def push(self, sample: LaserSample) -> None:
        """A reading, which waits until the heave of its time is known."""
        self._waiting.append(sample)

    def note(self, t_s: float, observer_m: float, published_m: float, unshifted: Motion) -> None:
        """What the observer said at ``t_s``."""
        self._output_t_s = t_s
        self._outputs.push((t_s, observer_m, published_m, unshifted.heave_m, unshifted.velocity_mps))

    def forget(self) -> None:
        """The observer was restarted: nothing that it said before can be compared."""
        self._outputs.clear()
        self._compared.clear()
        self._correction.forget_outputs()

    def step(self, t_s: float, observer: HeaveObserver) -> None:
        """Take the readings whose heave is known by now; every refresh, compare the lead."""
        while self._waiting and not self._waiting[0].t_s > self._output_t_s:
            self._take(self._waiting.popleft(), observer)
        if (aided := self._aided(observer)) is not None:
            self._remark = aided.aiding_remark(t_s)
        elif self._params.enabled and not t_s - self._lead_t_s < self._params.refresh_s:
            self._lead_t_s = t_s
            self._learn_lead(t_s, observer)

    def _aided(self, observer: HeaveObserver) -> LaserAided | None:
        """The observer that readings go into as measurements; None: they are compared with it."""
        return observer.laser_aided if self._is_aiding else None

    def _take(self, sample: LaserSample, observer: HeaveObserver) -> None:
        self.fault = sample.fault
        if not sample.t_s > self._read_t_s:
            return
        self._read_t_s = sample.t_s
        if self._stuck.step(sample.t_s, sample.laser_m) and sample.fault is Fault.NONE:
            self.fault = Fault.STUCK
        row = self._outputs.at(sample.t_s)
        settled = observer.settled_s >= REFERENCE_AFTER_S and observer.refreshes > 0
        usable = settled and isfinite(row[1] + sample.laser_m) and sample.t_s > self._taken_t_s
        if self.fault is not Fault.NONE or not usable:
            return
        self._taken_t_s = sample.t_s
        _, observer_m, published_m, heave_m, velocity_mps = row.tolist()
        aided = self._aided(observer)
        verdict = self.reference.take(sample.t_s, sample.laser_m, published_m, observer.error_std_m(0.0))
        if verdict is reference.Verdict.RESTARTED:
            self._compared.clear()
            self._correction.forget_rows()
            if aided is not None:
                aided.stop_aiding(sample.t_s, "it is on another target")
        is_sound = self.reference.known and self.reference.is_proven and not self._remark
        if verdict is reference.Verdict.ACCEPTED and is_sound:
            self.delayed.give(sample.t_s, self.reference.value_m)
        if verdict is reference.Verdict.ACCEPTED and aided is not None:
            aided.aid(sample.t_s, self.reference.signed(sample.laser_m), self.reference.reading_std_m)
        elif verdict is reference.Verdict.ACCEPTED:
            signed = self.reference.signed(sample.laser_m)
            self._compared.push((sample.t_s, heave_m, velocity_mps, signed))
            if observer.settled_s >= LEARN_AFTER_S and not self._remark:
                self._correction.learn(sample.t_s, signed - observer_m, self.reference.constant_m)

    def _learn_lead(self, t_s: float, observer: HeaveObserver) -> None:
        """The lead that the laser shows beyond that of the chain's own design."""
        rows = self._compared.since(t_s - self._params.window_s)
        if float(np.minimum(np.diff(rows[:, 0]), 0.5).sum()) < self._params.min_laser_s:
            return
        first = self.lead.updates == 0
        shown = lead.compare(rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3], observer.omega_radps)
        is_learned = self.lead.update(shown, observer.design_lead_s, has_true_gain=observer.has_true_gain)
        if is_learned:
            self.reference.rebase(self._output_t_s)
        was_doubted, self._remark = bool(self._remark), self._doubt(shown, rows[:, 1], observer)
        if (is_learned and first) or (self._remark and not was_doubted):
            self._correction.forget_rows()

    def _doubt(self, shown: lead.Comparison | None, heave_m: Array, observer: HeaveObserver) -> str:
        """Why the laser is not to be believed, for people; or nothing."""
        if self.lead.refused:
            return f"laser: {self.lead.refused}"
        error_m = self.lead.gain * observer.error_std_m(0.0)
        is_moving = float(np.std(heave_m)) > MOVING * max(self.reference.reading_std_m, error_m)
        if shown is not None and is_moving and shown.coherence < self._params.min_coherence:
            return "laser: it does not follow the heave"
        return ""
