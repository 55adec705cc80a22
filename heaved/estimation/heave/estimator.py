"""The heave: vertical acceleration in, heave out, with what the laser has taught taken into account.

acceleration ------------------ observer (F^m) --- gain ---(+)--- heave, velocity, standard deviation
                                    ^      |                ^
                           lead, gain      X* at laser      '--- residual network <--- trained outside, guarded
                                    '---- laser ----'
"""

from __future__ import annotations

from collections import Counter
from math import hypot, isfinite, nan
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.harmonic.observer import HarmonicObserver
from heaved.estimation.heave.laser.learning import LaserLearning
from heaved.estimation.heave.sea.observer import SeaObserver
from heaved.samples import GRAVITY_MPS2, CorrectionState, DelayedHeave, HeaveForecast, TrainingWindow

if TYPE_CHECKING:
    from heaved.estimation.heave.laser.correction import Params as CorrectionParams
    from heaved.estimation.heave.laser.correction import SavedNetwork
    from heaved.estimation.heave.laser.reference import Params as LaserParams
    from heaved.estimation.heave.observer import HeaveObserver, SavedObserver
    from heaved.estimation.heave.params import Params as HeaveParams
    from heaved.estimation.imu.vertical import VerticalAcceleration

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What is set by us, not by the user."""

    level_mps2: float = 0.15
    """Levels of accelerometers are off by less (data sheets: 0.02 to 0.1, over all temperatures). What is more than
    that may as well be a wrong scale, of gravity and of the heave alike."""
    said: float = 0.01
    """People are told of a scale that may be off by so much."""


TUNING: Final = Tuning()


class Heave(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """What is known of the heave for one moment."""

    heave_m: float
    std_m: float
    velocity_mps: float
    acceleration_mps2: float
    observer_m: float
    correction_m: float
    lead_s: float
    forecast: tuple[HeaveForecast, ...]


class HeaveEstimator:
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
        has_laser: bool,
        lead_s: float,
        max_rate_hz: float,
    ) -> None:
        """``lead_s``: how long after the last sample the published heave is for."""
        self._params, self.has_laser, self.lead_s = heave, has_laser, lead_s
        self._max_rate_hz = max_rate_hz
        self.observer: HeaveObserver = self._new_observer()
        self.laser = LaserLearning(laser, heave.lead, correction, max_rate_hz)
        self.correction = self.laser.correction
        self.t_s = nan

    def _new_observer(self) -> HeaveObserver:
        p = self._params
        if p.observer == "harmonic":
            return HarmonicObserver(p, self._max_rate_hz)
        return SeaObserver(p.sea, p.forecast_horizons_s, self.lead_s)

    def step(self, up: VerticalAcceleration) -> None:
        """Take the vertical acceleration, and what else has become known of it."""
        observer, t_s = self.observer, up.t_s
        self.t_s = t_s
        axes = self.laser.axes
        if up.is_of_another_kind:
            observer.cut()
            axes.cut()
        observer.step(t_s, axes.step(up) if self.has_laser else up.up_mps2, up.roll_rad, up.pitch_rad, up.yaw_rad)
        if axes.amendment is not None:
            observer.amend(axes.amendment.t_s, axes.amendment.more_mps2)
            axes.amendment = None
        if up.amendment is not None:
            observer.amend(up.amendment.t_s, up.amendment.more_mps2)
        if up.noise is not None:
            observer.disturb(up.noise.f_hz, up.noise.psd)
        if (one := up.unsized) is not None:
            observer.mistake(one.t_s, (one.by_lean, one.by_lateness), one.covariance)

    def at(self, shift_s: float) -> Heave | None:
        """What is known for ``shift_s`` after the last sample, the configured lead added; None: nothing yet."""
        return self._at(shift_s, self.lead_s)

    def now(self, shift_s: float) -> Heave | None:
        """The same without the lead, and without forecasts."""
        return self._at(shift_s, 0.0, are_forecasts_wanted=False)

    def _at(self, shift_s: float, lead_s: float, *, are_forecasts_wanted: bool = True) -> Heave | None:
        observer, taught = self.observer, self.laser.lead
        scale = self.laser.std_scale(self.t_s + shift_s)
        moment_s = shift_s + lead_s
        gain, no_less = taught.gain, scale if scale > 1.0 else 1.0
        std_m = gain * observer.error_std_m(moment_s, scale if lead_s == 0.0 else no_less)
        if not isfinite(std_m):
            return None
        motion = observer.at(moment_s, taught.learned_s)
        std_m = hypot(std_m, taught.error_std_m(motion.heave_m, motion.velocity_mps))
        if (doubt := self._scale_doubt) > 0.0:
            std_m = hypot(std_m, doubt * motion.heave_m)
        observer_m, correction_m = gain * motion.heave_m, self.correction.value_m
        return Heave(
            heave_m=observer_m + correction_m,
            std_m=std_m,
            velocity_mps=gain * motion.velocity_mps,
            acceleration_mps2=gain * observer.acceleration_mps2 if shift_s == 0.0 else nan,
            observer_m=observer_m,
            correction_m=correction_m,
            lead_s=observer.design_lead_s + taught.learned_s,
            forecast=self._forecast(shift_s, no_less, motion.velocity_mps) if are_forecasts_wanted else (),
        )

    def _forecast(self, shift_s: float, scale: float, velocity_mps: float) -> tuple[HeaveForecast, ...]:
        """For each horizon, with what gain and lead may be off by: as fast as the wave is now at its fastest."""
        observer, taught = self.observer, self.laser.lead
        found = observer.forecast(shift_s, taught.learned_s, scale, taught.gain)
        if (doubt := self._scale_doubt) > 0.0:
            return tuple([msgspec.structs.replace(one, std_m=hypot(one.std_m, doubt * one.heave_m)) for one in found])
        if not taught.updates:
            return found
        omega_radps = observer.omega_radps
        return tuple(
            [
                HeaveForecast(
                    horizon_s=one.horizon_s,
                    heave_m=one.heave_m,
                    std_m=hypot(
                        one.std_m, taught.error_std_m(one.heave_m, hypot(velocity_mps, omega_radps * one.heave_m))
                    ),
                )
                for one in found
            ]
        )

    def delayed(self) -> DelayedHeave | None:
        """The newest delayed heave, with what the laser has taught."""
        found, doubt = self.laser.delayed.step(self.observer.delayed, self.laser.lead), self._scale_doubt
        if found is None or not doubt > 0.0:
            return found
        return msgspec.structs.replace(found, std_m=hypot(found.std_m, doubt * found.heave_m))

    @property
    def _scale_doubt(self) -> float:
        """By how much of itself the heave may be off for the scale of the accelerometer: gravity is measured with it,
        so that a level that no sensor has may be that. Where a laser has shown the scale it is known.
        """
        off_mps2 = abs(self.observer.bias_mps2)
        if not off_mps2 > TUNING.level_mps2 or self.laser.lead.updates:
            return 0.0
        return off_mps2 / GRAVITY_MPS2

    @property
    def notes(self) -> tuple[str, ...]:
        """What people should know, and no reason to trust the heave less than its deviation says."""
        notes, doubt = self.observer.notes, self._scale_doubt
        if not doubt > TUNING.said:
            return notes
        off, share = self.observer.bias_mps2, 100.0 * doubt
        told = f"az is off by {off:.2f} m/s2: its level, or its scale and with that the heave by {share:.0f} %"
        return (*notes, told)

    def training_due(self) -> TrainingWindow | None:
        """A window for the trainer, when it is time for one; each is given out once."""
        if not self.has_laser or (self._params.lead.enabled and self.laser.lead.last is None):
            return None  # The first comparison moves the observer, and with it everything there is to learn.
        if self.laser.placement.is_open(self.t_s):
            return None
        return self.correction.due(self.t_s, self.observer.omega_radps)

    def correction_state(self, *, laser_is_fresh: bool) -> CorrectionState:
        """What people should know of what is learned beside lead and gain: of the axes, and by the network."""
        state = self.correction.state(laser_is_fresh=laser_is_fresh)
        if state is CorrectionState.OFF or not self.laser.axes.is_in_use:
            return state
        if laser_is_fresh and self.laser.axes.is_applied:
            return CorrectionState.ACTIVE
        return CorrectionState.HOLDING

    def restore(self, observer: SavedObserver, correction: SavedNetwork | None, age_s: float) -> None:
        """Start from what an earlier run has learned ``age_s`` ago (nan: not known); call before the first sample.

        Raises:
            ValueError: it does not fit the configuration; nothing was taken over.
        """
        self.observer.restore(observer, age_s)
        if correction is not None:
            try:
                self.correction.restore(correction)
            except ValueError:
                self.observer = self._new_observer()
                raise

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """Of the observer, by (filter, reason), and steps of the level that it has found."""
        observer = self.observer
        found = Counter({("heave", reason): count for reason, count in observer.resets.items()})
        if observer.steps:
            found["heave", "step of the level"] = observer.steps
        return found
