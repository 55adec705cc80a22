"""The heave chain: vertical acceleration in, heave out, with what the laser has taught taken into account.

acceleration ------------------ observer (F^m) --- gain ---(+)--- heave, velocity, standard deviation
                                    ^      |                ^
                           lead, gain      X* at laser      '--- residual network <--- trained outside, guarded
                                    '---- laser ----'
"""

from __future__ import annotations

from collections import Counter
from math import hypot, isfinite, nan

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.harmonic.observer import HarmonicObserver
from heaved.estimation.heave.laser import lead
from heaved.estimation.heave.laser.correction import Params as CorrectionParams
from heaved.estimation.heave.laser.learning import LaserLearning
from heaved.estimation.heave.laser.reference import Params as LaserParams
from heaved.estimation.heave.observer import HeaveObserver
from heaved.estimation.heave.params import Params as HeaveParams
from heaved.estimation.heave.sea.observer import SeaObserver
from heaved.predictions import HeaveForecasts
from heaved.samples import DelayedHeave

Array = NDArray[np.float64]


class Heave(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """What is known of the heave for one moment."""

    heave_m: float
    std_m: float
    velocity_mps: float
    acceleration_mps2: float
    observer_m: float
    correction_m: float
    lead_s: float
    forecast: HeaveForecasts


class HeaveChain:
    """Observer, laser and correction of one sensor.

    Attributes:
        observer: the harmonic or the sea observer, as configured.
        laser: what the laser has taught.
        correction: the residual network.
    """

    def __init__(
        self,
        heave: HeaveParams,
        laser: LaserParams,
        correction: CorrectionParams,
        *,
        lead_s: float,
        max_rate_hz: float,
    ) -> None:
        """``lead_s``: how long after the last sample the published heave is for."""
        self._params, self._lead_s = heave, lead_s
        self._max_rate_hz = max_rate_hz
        self.observer: HeaveObserver = self._new_observer()
        self.laser = LaserLearning(laser, heave.lead, correction, max_rate_hz)
        self.correction = self.laser.correction
        self.good_t_s = nan

    def _new_observer(self) -> HeaveObserver:
        p = self._params
        if p.observer == "harmonic":
            return HarmonicObserver(p, self._max_rate_hz)
        return SeaObserver(p.sea, p.forecast_horizons_s, self._lead_s)

    def observe(self, t_s: float, up_mps2: float) -> None:
        """Take the vertical acceleration."""
        self.good_t_s = t_s
        self.observer.step(t_s, up_mps2)

    def interrupt(self) -> None:
        """The vertical acceleration is made otherwise from now on: with the tilt removed, or without."""
        self.observer.cut()

    def amend(self, t_s: Array, more_mps2: Array) -> None:
        """The vertical accelerations of the past at ``t_s`` (n,) were too little by ``more_mps2`` (n,)."""
        self.observer.amend(t_s, more_mps2)

    def disturb(self, f_hz: Array, psd: Array) -> None:
        """The vertical acceleration has noise of one-sided density ``psd`` (n,), (m/s2)2/Hz, that it does not show."""
        self.observer.disturb(f_hz, psd)

    def at(self, shift_s: float) -> Heave | None:
        """What is known for ``shift_s`` after the last sample, the configured lead added; None: nothing yet."""
        observer, taught = self.observer, self.laser.lead
        scale = self.laser.std_scale(self.good_t_s + shift_s)
        moment_s = shift_s + self._lead_s
        gain, no_less = taught.gain, scale if scale > 1.0 else 1.0
        std_m = gain * observer.error_std_m(moment_s, scale if self._lead_s == 0.0 else no_less)
        if not isfinite(std_m):
            return None
        motion = observer.at(moment_s, taught.learned_s)
        std_m = hypot(std_m, taught.error_std_m(motion.heave_m, motion.velocity_mps))
        observer_m, correction_m = gain * motion.heave_m, self.correction.value_m
        return Heave(
            heave_m=observer_m + correction_m,
            std_m=std_m,
            velocity_mps=gain * motion.velocity_mps,
            acceleration_mps2=gain * observer.acceleration_mps2 if shift_s == 0.0 else nan,
            observer_m=observer_m,
            correction_m=correction_m,
            lead_s=observer.design_lead_s + taught.learned_s,
            forecast=observer.forecast(shift_s, taught.learned_s, no_less, gain),
        )

    def delayed(self) -> DelayedHeave | None:
        """The newest delayed heave, with what the laser has taught."""
        return self.laser.delayed.step(self.observer.delayed, self.laser.lead)

    def start_over(self) -> None:
        """An observer that knows nothing, after a restoration that failed."""
        self.observer = self._new_observer()

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """Of the observer, by (filter, reason), and steps of the level that it has found."""
        observer = self.observer
        found = Counter({("heave", reason): count for reason, count in observer.resets.items()})
        if observer.steps:
            found["heave", "step of the level"] = observer.steps
        return found

    @property
    def lead(self) -> lead.LeadTracker:
        return self.laser.lead
