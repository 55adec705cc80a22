"""The craft's stage: heave and pitch from the samples of its sensors, or from our own."""

from __future__ import annotations

from math import inf, isfinite, nan
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.estimation.craft.fusion import AttitudeFusion, Params, ResetReason, Source
from heaved.estimation.craft.inputs import MISSING
from heaved.estimation.craft.tuning import TUNING
from heaved.samples import CraftMotion, CraftSample, Fault, MotionFrame

if TYPE_CHECKING:
    from collections import Counter

UNKNOWN: Final = (nan, nan, nan)


class AttitudeStage:
    """Heave and pitch of a craft from what its sensors say, in whatever devices they are.

    One device that gives heave and pitch together gives both for one moment. Two devices take turns: each heave
    reading is a step and takes the newest pitch reading along, once; without heave for ``serves_s``, pitch
    readings are.

    Attributes:
        motion: the newest, or None before the first.
    """

    def __init__(self, params: Params) -> None:
        """
        Raises:
            ArithmeticError: as :class:`AttitudeFusion`.
        """
        self._own = params.source == Source.OWN
        self._estimator = AttitudeFusion(params)
        self._heave_t_s = self._own_t_s = -inf
        self._pitch_rad, self._pitch_t_s, self._pitch_used = nan, -inf, True
        self._drive, self._drive_t_s = UNKNOWN, -inf
        self.motion: CraftMotion | None = None

    def push(self, sample: CraftSample) -> None:
        """Take what one device says."""
        if sample.fault is not Fault.NONE:
            return
        if isfinite(sample.speed_mps) or isfinite(sample.flap_fore_rad) or isfinite(sample.flap_aft_rad):
            self._drive = (sample.speed_mps, sample.flap_fore_rad, sample.flap_aft_rad)
            self._drive_t_s = sample.t_s
        if self._own:
            return
        if isfinite(sample.pitch_rad):
            self._pitch_rad, self._pitch_t_s, self._pitch_used = sample.pitch_rad, sample.t_s, False
        if isfinite(sample.heave_m):
            self._heave_t_s = sample.t_s
        elif not (isfinite(sample.pitch_rad) and sample.t_s - self._heave_t_s > TUNING.serves_s):
            return
        fresh = not self._pitch_used and abs(sample.t_s - self._pitch_t_s) <= TUNING.serves_s
        self._pitch_used = True
        self._step(sample.t_s, sample.heave_m, self._pitch_rad if fresh else nan)

    def push_frame(self, frame: MotionFrame) -> None:
        """Our heave and pitch, for the moment of the frame: a heave that is published ahead is taken back by it."""
        if not self._own or frame.t_s - self._own_t_s < TUNING.own_step_s - 1e-6:
            return
        self._own_t_s = frame.t_s
        heave_m = frame.heave_m - frame.compensation_lead_s * frame.heave_velocity_mps
        if isfinite(heave_m):
            self._heave_t_s = frame.t_s
        if isfinite(frame.pitch_rad):
            self._pitch_t_s = frame.t_s
        self._step(frame.t_s, heave_m, frame.pitch_rad)

    def _step(self, t_s: float, heave_m: float, pitch_rad: float) -> None:
        drive = self._drive if abs(t_s - self._drive_t_s) <= TUNING.serves_s else UNKNOWN
        motion = self._estimator.step(t_s, heave_m, pitch_rad, *drive)
        if motion is not None:
            # A channel that is read at other moments, or less often, is not missing.
            here_s = (self._heave_t_s, self._pitch_t_s)
            there = {name for name, at_s in zip(MISSING, here_s, strict=True) if motion.t_s - at_s <= TUNING.serves_s}
            cautions = tuple([caution for caution in motion.cautions if caution not in there])
            self.motion = msgspec.structs.replace(motion, cautions=cautions)

    @property
    def resets(self) -> Counter[ResetReason]:
        """By reason."""
        return self._estimator.resets
