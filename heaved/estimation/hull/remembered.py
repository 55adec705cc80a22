"""What a restart remembers of the hull, and how it is judged before it is believed.

Between two runs of the program an IMU may have been moved, turned or replaced, or the vessel loaded. So the filter that
begins with the deformation of before runs beside the one that begins cold, which knows nothing of it: where the two
differ by more than both can be off, the old one is set aside, and what goes on is the cold one, as if nothing had been
remembered. Until the cold one is nearly as good the old one is published, which is right from the first alignment on
where nothing has changed, but with half of what the two differ by, and of what the cold one cannot tell, in its
deviations.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.rotations import ARCSEC, passive, rotation_vector
from heaved.estimation.hull.markov import Flexure
from heaved.estimation.hull.refit import advance, run
from heaved.estimation.hull.so3 import At, So3Filter
from heaved.estimation.hull.tuning import TUNING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.estimation.hull.slow_motion import SlowReading

Array = NDArray[np.float64]
Three = tuple[float, float, float]

KEPT = np.r_[At.PSI : At.THETA, At.SCALE : At.DELAY]
"""Elements of the state that outlast a restart: the static deformation and the scales of the gyros. The flexure is
another one, the biases are another switch-on's, and the delay may be another polling's: all three show in seconds."""
HALF = np.triu_indices(len(KEPT))


class SavedFlexure(msgspec.Struct, frozen=True, kw_only=True):
    """The flexure as it was fitted last, about the hull's x, y, z."""

    std_rad: Three
    mu_radps: Three
    lambda_radps: Three
    noise_radps: Three
    """White noise of one slow reading of the rate difference."""


class SavedHull(msgspec.Struct, frozen=True, kw_only=True):
    """The static deformation, mounting included, and how well it was known."""

    rotation_rad: Three
    """Rotation vector of local from midships."""
    scale: Three
    """Of the local gyros against the midships ones."""
    covariance: tuple[float, ...]
    """(21,) of the errors of both, rotation about the hull's axes first: the upper triangle, row by row."""
    flexure: SavedFlexure | None = None
    """None: it was not fitted yet."""
    unconfirmed_s: float = 0.0
    """For so long the run that saved it had not found out whether it is still so."""


def square(covariance: Sequence[float]) -> Array:
    """(6, 6) of the upper triangle (21,).

    Raises:
        ValueError: these are not so many.
    """
    n = len(KEPT)
    if len(covariance) != len(HALF[0]):
        raise ValueError(f"{len(covariance)} values for the covariance of the hull")
    P = np.zeros((n, n))
    P[HALF] = covariance
    return P + np.triu(P, 1).T


def saved(filter: So3Filter, flexure: Flexure | None) -> SavedHull:
    """What is to be remembered of a filter; ``flexure``: when it was fitted."""
    noise = filter.noise.sample_radps
    return SavedHull(
        rotation_rad=three(rotation_vector(filter.static)),
        scale=three(filter.x[At.SCALE : At.DELAY]),
        covariance=tuple(filter.P[np.ix_(KEPT, KEPT)][HALF].tolist()),
        flexure=None
        if flexure is None
        else SavedFlexure(
            std_rad=three(flexure.std_rad),
            mu_radps=three(flexure.mu_radps),
            lambda_radps=three(flexure.lambda_radps),
            noise_radps=three(noise),
        ),
    )


class Verdict(NamedTuple):
    """What came of weighing: it still holds, it is not so any more, or neither is known yet (both False)."""

    is_confirmed: bool
    is_refuted: bool


class Trial:
    """The filter that begins with the deformation of before.

    Attributes:
        filter: it.
        doubt_rad2: (3, 3) what is to be added to its covariance.
    """

    def __init__(self, remembered: SavedHull, age_s: float, cold: So3Filter, record: Sequence[SlowReading]) -> None:
        """``age_s``: of what is remembered. ``cold``: the filter that has begun without it, and has gone through the
        ``record``.
        """
        noise, flexure = cold.noise, cold.flexure
        if (fitted := remembered.flexure) is not None:
            flexure = Flexure(*map(np.array, (fitted.std_rad, fitted.mu_radps, fitted.lambda_radps)))
            noise = msgspec.structs.replace(noise, sample_radps=np.array(fitted.noise_radps))
        self._static = passive(np.array(remembered.rotation_rad))
        P = square(remembered.covariance)
        self._walk_rad2ps = max(noise.static_walk_rad_rts, TUNING.away_walk_arcsec_rth * ARCSEC / 60.0) ** 2
        grown = [self._walk_rad2ps * age_s] * 3 + [(TUNING.away_scale_rth / 60.0) ** 2 * age_s] * 3
        P += np.diag(grown)
        self._covariance = P[:3, :3]
        self.filter = So3Filter(self._static, cold.delay_s, flexure, noise)
        self.filter.x = self.filter.x.copy()
        self.filter.x[At.SCALE : At.DELAY] = remembered.scale
        self.filter.P[np.ix_(KEPT, KEPT)] = P
        self._mean_nis = 1.0
        self._is_sound = run(self.filter, record, record[0][0], -np.inf)
        self._began_s = record[0][0]
        self.doubt_rad2: Array = np.zeros((3, 3))
        self._compare(cold)

    def step(self, dt_s: float, reading: SlowReading) -> None:
        """As the cold filter steps."""
        nis = advance(self.filter, dt_s, reading, reading[0] - self._began_s)
        self._covariance = self._covariance + self._walk_rad2ps * max(dt_s, 0.0) * np.eye(3)
        if nis is None:
            return
        # A filter that has broken down gives nan.
        self._is_sound = self._is_sound and nis < inf
        self._mean_nis += TUNING.nis_weight * (min(nis, TUNING.gate_nis) / 3.0 - self._mean_nis)

    def weigh(self, cold: So3Filter) -> Verdict:
        """Whether it holds, beside the filter that has seen the same and knows nothing of before."""
        apart_nis = self._compare(cold)
        is_unlike = not apart_nis <= TUNING.unlike_nis or self._mean_nis > TUNING.worst_nis
        if not self._is_sound or is_unlike:
            return Verdict(is_confirmed=False, is_refuted=True)
        own = sqrt(float(np.linalg.eigvalsh(cold.P[:3, :3])[-1]))
        known = sqrt(float(np.linalg.eigvalsh(self.filter.P[:3, :3])[-1]))
        return Verdict(is_confirmed=own <= TUNING.as_good * known, is_refuted=False)

    def settled(self) -> So3Filter:
        """The filter that goes on alone. What is in doubt at the end stays so until later readings show it."""
        P = self.filter.P.copy()
        P[:3, :3] += self.doubt_rad2
        self.filter.P = P
        return self.filter

    def _compare(self, cold: So3Filter) -> float:
        """Normalised square (3 degrees of freedom) of what the cold filter is off what was remembered."""
        own = cold.P[: At.THETA, : At.THETA]
        apart = rotation_vector(self.filter.static.T @ cold.static)
        self.doubt_rad2 = TUNING.in_doubt**2 * (np.outer(apart, apart) + own)
        off = rotation_vector(self._static.T @ cold.static)
        spread = self._covariance + own + 2.0 * (TUNING.coherent_arcsec * ARCSEC) ** 2 * np.eye(3)
        return float(off @ np.linalg.solve(spread, off)) if np.isfinite(spread).all() else inf


def three(values: Array) -> Three:
    """An array (3,) as what a record keeps."""
    x, y, z = values.tolist()
    return x, y, z
