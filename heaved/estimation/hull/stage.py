"""The hull's stage: deformation from the samples of both IMUs, how the crane base stands, its attitude."""

from __future__ import annotations

from math import isfinite, nan, radians
from typing import TYPE_CHECKING, Final

import numpy as np

from heaved.estimation.common.rotations import ARCSEC, AttitudeAngles, crane_base_attitude, from_euler
from heaved.estimation.hull.estimate import HullEstimate, HullState, Params, ResetReason
from heaved.estimation.hull.estimator import HullDeformation
from heaved.estimation.lever_arm import Crane
from heaved.samples import HullAngles, ImuSample, RatesSample

if TYPE_CHECKING:
    from collections import Counter

    from heaved.estimation.hull.refit import RefitJob, RefitResult
    from heaved.estimation.hull.remembered import SavedHull

UNKNOWN: Final = (nan, nan, nan)


class HullStage:
    """Deformation of the hull from the rates of both IMUs, as they come.

    Attributes:
        crane: how the crane base stands; before the first estimate as the configured mounting says, or None.
    """

    def __init__(self, params: Params, refit_inline: bool) -> None:
        """
        Raises:
            ValueError: as :class:`HullDeformation`.
        """
        self._params = params
        self._estimator = HullDeformation(params, refit_inline)
        self._estimate: HullEstimate | None = None
        self.crane: Crane | None = None
        if params.mount_deg is not None:
            mount = from_euler(*map(radians, params.mount_deg))
            self.crane = Crane(params.base_m, mount, mount)

    def push(self, sample: ImuSample | RatesSample) -> None:
        """Take the rates of either IMU; without any the sample says nothing."""
        rates = np.array([sample.gx_radps, sample.gy_radps, sample.gz_radps])
        push = self._estimator.push_midships if isinstance(sample, ImuSample) else self._estimator.push_local
        estimate = push(sample.t_s, rates)
        if estimate is not None and estimate is not self._estimate:
            self._estimate = estimate
            if self._is_known(estimate):
                self.crane = Crane(self._params.base_m, estimate.local_from_midships, estimate.static)

    def _is_known(self, estimate: HullEstimate) -> bool:
        """Converged, or holding what had converged: crane-base attitude and points may use it."""
        known = estimate.angles.state in (HullState.CONVERGED, HullState.HOLDING)
        return known and max(estimate.angles.std_rad) <= self._params.converged_arcsec * ARCSEC

    def crane_attitude(self, roll_rad: float, pitch_rad: float, yaw_rad: float) -> tuple[float, float, float]:
        """Roll, pitch and yaw of the crane base: the midships ones composed with the newest deformation.

        That is a good second older and changes by arcseconds in it. nan while it is not known; yaw is nan where it is
        midships.
        """
        estimate = self._estimate
        if estimate is None or not self._is_known(estimate) or not isfinite(roll_rad + pitch_rad):
            return UNKNOWN
        heading = yaw_rad if isfinite(yaw_rad) else 0.0
        base = crane_base_attitude(AttitudeAngles(roll_rad, pitch_rad, heading), estimate.local_from_midships)
        return base.roll_rad, base.pitch_rad, base.yaw_rad if isfinite(yaw_rad) else nan

    def restore(self, remembered: SavedHull, age_s: float) -> None:
        """As :meth:`HullDeformation.restore`."""
        self._estimator.restore(remembered, age_s)

    def saved(self) -> SavedHull | None:
        """What a restart shall remember; None: nothing is known that is worth it."""
        return self._estimator.saved()

    @property
    def angles(self) -> HullAngles | None:
        """The newest; None before the first."""
        return None if self._estimate is None else self._estimate.angles

    @property
    def due_refit(self) -> RefitJob | None:
        """To be computed elsewhere; None: nothing is due."""
        return self._estimator.due_refit

    def accept(self, result: RefitResult | None) -> bool:
        """Take a refit that was computed elsewhere; False: it was of no use."""
        return self._estimator.accept(result)

    @property
    def resets(self) -> Counter[ResetReason]:
        """By reason."""
        return self._estimator.resets
