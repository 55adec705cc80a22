"""The heave chain: vertical acceleration in, heave out, with what the laser has taught taken into account.

    acceleration --- spikes out --- observer (F^m) --- gain ---(+)--- heave, velocity, standard deviation
                                        ^      |                ^
                               lead, gain      X* at laser      '--- residual network <--- trained outside, guarded
                                        '---- laser ----'
"""

from __future__ import annotations

from collections import Counter
from math import isfinite, nan
from typing import Final

import msgspec

from heaved.estimation import lead
from heaved.estimation.correction import Params as CorrectionParams
from heaved.estimation.correction import ResidualCorrection
from heaved.estimation.heave import HarmonicObserver
from heaved.estimation.heave import Params as HeaveParams
from heaved.estimation.laser import LaserTeacher
from heaved.estimation.reference import Params as LaserParams
from heaved.estimation.sea import SeaObserver
from heaved.estimation.spikes import SpikeGate, StuckGate
from heaved.predictions import HeaveForecasts
from heaved.samples import DelayedHeave

DELAYED_OVERCONFIDENCE: Final = 1.5
"""Published over modelled standard deviation of the delayed heave: the fitted spectrum is an estimate, and the smoothed
value is so good that this shows (coverage: tools/accuracy.py heave)."""


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
        resets: of the observer, by (filter, reason).
    """

    def __init__(
        self,
        heave: HeaveParams,
        laser: LaserParams,
        correction: CorrectionParams,
        *,
        has_laser: bool,
        lead_s: float,
        max_rate_hz: float,
    ) -> None:
        """``lead_s``: how long after the last sample the published heave is for."""
        self._params, self._has_laser, self._lead_s = heave, has_laser, lead_s
        self._max_rate_hz = max_rate_hz
        self.spikes, self.stuck = SpikeGate(), StuckGate()
        self.observer: HarmonicObserver | SeaObserver = self._new_observer()
        self.correction = ResidualCorrection(correction, max_rate_hz)
        self.laser = LaserTeacher(laser, heave.lead, self.correction, max_rate_hz)
        self.good_t_s = nan
        self._delayed_of: DelayedHeave | None = None
        self._delayed: DelayedHeave | None = None
        self.resets: Counter[tuple[str, str]] = Counter()
        self._resets_seen = 0

    def _new_observer(self) -> HarmonicObserver | SeaObserver:
        p = self._params
        if p.observer == "harmonic":
            return HarmonicObserver(p, self._max_rate_hz)
        return SeaObserver(p.sea, p.forecast_horizons_s, self._lead_s)

    def observe(self, t_s: float, up_mps2: float, raw_mps2: float) -> float:
        """Take the vertical acceleration; gives what was used of it, nan when it was withheld.

        raw_mps2: as the sensor gave it, tilt not removed: a sensor that is stuck repeats that.
        """
        up = self.spikes(t_s, up_mps2) if not self.stuck(t_s, raw_mps2) else nan
        if not isfinite(up):
            return nan
        self.good_t_s = t_s
        self.observer.step(t_s, up)
        if (resets := self.observer.resets.total()) != self._resets_seen:
            self._resets_seen = resets
            self.resets = Counter({("heave", reason): count for reason, count in self.observer.resets.items()})
            self.laser.forget()
        if self._has_laser:
            self._note(t_s)
        return up

    def interrupt(self) -> None:
        """The vertical acceleration is made otherwise from now on: with the tilt removed, or without."""
        if isinstance(self.observer, SeaObserver):
            self.observer.cut()

    def _note(self, t_s: float) -> None:
        observer, taught = self.observer, self.laser.lead
        now, unshifted = observer.at(0.0, taught.learned_s), observer.unshifted()
        if not isfinite(now.heave_m):
            return  # There is no model of the sea yet, and nothing to compare.
        observer_m = taught.gain * now.heave_m
        corrected_m = observer_m + self.correction.step(t_s, observer_m, observer.omega_radps)
        self.laser.note(t_s, observer_m, corrected_m, unshifted)

    def at(self, shift_s: float) -> Heave | None:
        """What is known for ``shift_s`` after the last sample, the configured lead added; None: nothing yet."""
        observer, taught = self.observer, self.laser.lead
        scale = self.laser.reference.std_scale
        moment_s = shift_s + self._lead_s
        std_m = taught.gain * observer.error_std_m(moment_s, scale if self._lead_s == 0.0 else max(scale, 1.0))
        if not isfinite(std_m):
            return None
        gain = taught.gain
        motion = observer.at(moment_s, taught.learned_s)
        heaves, stds = observer.forecast(shift_s, taught.learned_s, max(scale, 1.0))
        if gain != 1.0:
            heaves, stds = [gain * heave_m for heave_m in heaves], [gain * std_m for std_m in stds]
        observer_m, correction_m = gain * motion.heave_m, self.correction.value_m
        return Heave(
            heave_m=observer_m + correction_m,
            std_m=std_m,
            velocity_mps=gain * motion.velocity_mps,
            acceleration_mps2=gain * observer.acceleration_mps2 if shift_s == 0.0 else nan,
            observer_m=observer_m,
            correction_m=correction_m,
            lead_s=observer.design_lead_s + taught.learned_s,
            forecast=HeaveForecasts(self._params.forecast_horizons_s, heaves, stds),
        )

    def delayed(self) -> DelayedHeave | None:
        """The newest delayed heave, with what the laser has taught: the sensor's lag and its scale."""
        newest = self.observer.delayed
        if newest is not self._delayed_of:
            self._delayed_of, self._delayed = newest, None
            if newest is not None:
                taught = self.laser.lead
                self._delayed = DelayedHeave(
                    t_s=newest.t_s + taught.learned_s,
                    heave_m=taught.gain * newest.heave_m,
                    std_m=DELAYED_OVERCONFIDENCE * taught.gain * newest.std_m,
                )
        return self._delayed

    def start_over(self) -> None:
        """An observer that knows nothing, after a restoration that failed."""
        self.observer = self._new_observer()
        self._resets_seen = 0

    @property
    def lead(self) -> lead.LeadTracker:
        return self.laser.lead
