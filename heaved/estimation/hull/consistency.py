"""Whether the hull-deformation estimate can be trusted: the motion, the innovations, the clocks, the mounting."""

from __future__ import annotations

from collections import deque
from math import hypot, nan, radians, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.rotations import ARCSEC, from_euler, rotation_vector
from heaved.estimation.hull.estimate import HullWarning, Params
from heaved.estimation.hull.markov import Flexure, information
from heaved.estimation.hull.tuning import TUNING

if TYPE_CHECKING:
    from heaved.estimation.hull.streams import RateCheck, TwoStreams

Array = NDArray[np.float64]


class Consistency:
    """Fed by the estimator with what it sees; asked for the warnings."""

    def __init__(self, params: Params) -> None:
        self._params = params
        self._expected = None if params.mount_deg is None else from_euler(*(radians(a) for a in params.mount_deg))
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen."""
        self.reachable_rad: tuple[float, float, float] = (nan, nan, nan)
        """Forecast of the standard deviation about x, y, z, the floor included."""
        self.weak = self.single = False
        self.misfit = 0.0
        """Of the alignment, where the motion would have sufficed for one."""
        self._nis, self._gated = 1.0, 0
        self._delays: deque[tuple[float, float, float]] = deque(
            maxlen=int(TUNING.drift_s / TUNING.forecast_every_s) + 1
        )
        self._drifting = False

    def began(self) -> None:
        """A filter starts, or goes on with new parameters: what the last one showed does not count."""
        self.misfit, self._nis, self._gated = 0.0, 1.0, 0

    def judge(self, nis: float) -> bool:
        """Take a normalised innovation squared; False: nothing has been explained for too long."""
        self._nis += TUNING.nis_weight * (min(nis, TUNING.gate_nis) / 3.0 - self._nis)
        self._gated = self._gated + 1 if nis > TUNING.gate_nis else 0
        return self._gated < TUNING.unexplained

    def forecast(self, rates: Array, rate_hz: float, flexure: Flexure, sample_radps: Array) -> None:
        """What the motion of late allows (``markov.information``), and whether it is too weak or one-sided.

        rates (n, 3) at ``rate_hz``: the slow ones midships, nan where missing.
        """
        p = self._params
        known: NDArray[np.bool_] = np.asarray(np.isfinite(rates).all(axis=1))
        if len(rates) < TUNING.forecast_from or known.mean() < 0.8:
            return
        rates = np.where(known[:, None], rates, np.nanmean(rates, axis=0))
        J = information(rates, rate_hz, flexure, sample_radps) * (p.forecast_s * rate_hz / len(rates))
        values, vectors = np.linalg.eigh(J)
        values = np.maximum(values, 1e-30)
        x, y, z = np.hypot(np.sqrt((vectors**2 / values).sum(axis=1)), p.coherent_floor_arcsec * ARCSEC).tolist()
        self.reachable_rad = (x, y, z)
        least = 1.0 / (p.weak_arcsec * ARCSEC) ** 2
        one_sided = float(values[0]) < TUNING.one_axis_information * float(values[1])
        self.single = one_sided and float(values[1]) >= least
        self.weak = float(values[0]) < least and not self.single

    def delay(self, t_s: float, delay_s: float, std_s: float) -> bool:
        """Does the delay move? Slaves are stamped by one clock, so it should not; a recording of two clocks may."""
        self._delays.append((t_s, delay_s, std_s))
        then_s, before_s, before_std_s = self._delays[0]
        moved, over = abs(delay_s - before_s), t_s - then_s
        surely = moved > 6.0 * hypot(before_std_s, std_s) and moved > TUNING.drift_ppm * 1e-6 * over
        self._drifting = over >= 0.9 * TUNING.drift_s and surely
        return self._drifting

    def warnings(
        self, C: Array | None, delay_s: float, checks: tuple[RateCheck, RateCheck], streams: TwoStreams
    ) -> tuple[HullWarning, ...]:
        """All that holds now. C (3, 3): the estimate, when there is one."""
        pair = (streams.midships, streams.local)
        longest_s = TUNING.slow_period / self._params.rate_hz
        stuck = [check.stuck or stream.stuck for check, stream in zip(checks, pair, strict=True)]
        slow = [check.slow or stream.period_s > longest_s for check, stream in zip(checks, pair, strict=True)]
        found = (
            (HullWarning.WEAK_MOTION, self.weak),
            (HullWarning.SINGLE_AXIS, self.single),
            # Both at once is a ship at rest under coarse registers.
            (HullWarning.STUCK_MIDSHIPS, stuck[0] and not stuck[1]),
            (HullWarning.STUCK_LOCAL, stuck[1] and not stuck[0]),
            (HullWarning.MISSING_MIDSHIPS, checks[0].missing and not slow[0]),
            (HullWarning.MISSING_LOCAL, checks[1].missing and not slow[1]),
            (HullWarning.LOW_RATE_MIDSHIPS, slow[0]),
            (HullWarning.LOW_RATE_LOCAL, slow[1]),
            (HullWarning.DELAY, abs(delay_s) > self._params.delay_warning_ms * 1e-3),
            (HullWarning.CLOCK_DRIFT, self._drifting),
            (HullWarning.INCONSISTENT, self.misfit > TUNING.worst_misfit or self._nis > TUNING.worst_nis),
            (HullWarning.GIMBAL, C is not None and hypot(float(C[0, 0]), float(C[1, 0])) < TUNING.gimbal_cos),
        )
        return (*(warning for warning, is_on in found if is_on), *self._mounting(C))

    def _mounting(self, C: Array | None) -> tuple[HullWarning, ...]:
        """Is it mounted as expected? The other way round is what a swapped pair looks like."""
        if C is None or self._expected is None:
            return ()
        tolerance = radians(self._params.mount_tolerance_deg)
        if _angle_between(C, self._expected) <= tolerance:
            return ()
        return (HullWarning.SWAPPED if _angle_between(C.T, self._expected) <= tolerance else HullWarning.MOUNT,)


def _angle_between(A: Array, B: Array) -> float:
    r = rotation_vector(A.T.dot(B))
    return sqrt(float(r.dot(r)))
