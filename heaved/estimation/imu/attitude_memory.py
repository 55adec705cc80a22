"""What a restart remembers of the attitude's own errors, lean and lateness, and how far it is believed.

Without gyroscopes it takes minutes of record to show them anew. Until then the remembered ones serve, less sure than
they were: meanwhile the sensor may have been replaced, or another sea makes it weigh its accelerometers otherwise. What
the new record shows by itself is held against them: where both cannot be true, the remembered ones are dropped. They
fade as the record fills in which they have been found, as they would have had the program never stopped.
"""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.imu import attitude_fit

if TYPE_CHECKING:
    from heaved.estimation.imu.attitude_fit import Belief

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Lean (1/s) and lateness (s), in this order."""

    serves_s: float = 3600.0
    """What is older is not taken; what is of unknown age is held to be as old as this."""
    walk_rth: tuple[float, float] = (0.03, 0.015)
    """Standard deviations by which they are others after an hour: of a sensor that weighs its accelerometers by how
    rough it is, a fifth of what is usual."""
    repeats: tuple[float, float] = (0.005, 0.003)
    """The same however short it was: what one record differs by from another."""
    doubt: tuple[float, float] = (0.05, 0.033)
    """The same of another sensor, a third of what is usual, while the new record shows nothing, and later"""
    in_doubt: float = 0.5
    """that share of what the new record leaves open, and of what it is off the remembered ones."""
    unlike_nis: float = 16.0
    """Normalised square (2 degrees of freedom) of the difference from the new record from which it is another sensor:
    less than a thousandth by chance."""


TUNING: Final = Tuning()


class SavedAttitudeError(msgspec.Struct, frozen=True, kw_only=True):
    """Lean and lateness as they were found."""

    lean_per_s: float
    late_s: float
    covariance: tuple[float, float, float]
    """Variance of the lean, covariance, variance of the lateness."""
    unconfirmed_s: float = 0.0
    """For so long the run that saved it had not found out whether it is still so."""


class Memory:
    """What is remembered, until the record has taken its place.

    Attributes:
        saved: what an earlier run has found.
        is_confirmed: whether the new record has shown the same, and well enough to be saved.
    """

    def __init__(self, saved: SavedAttitudeError, age_s: float) -> None:
        """``age_s``: since it was saved; nan: not known."""
        self.saved = saved
        self.is_confirmed = False
        self._age_s = saved.unconfirmed_s + (age_s if isfinite(age_s) else 0.0)
        old_s = saved.unconfirmed_s + age_s if isfinite(age_s) else TUNING.serves_s
        self._began_s: float | None = None
        self._t_s = 0.0
        self.mean: Array = np.array([saved.lean_per_s, saved.late_s])
        of_lean, of_both, of_lateness = saved.covariance
        walked = np.square(TUNING.walk_rth) * (old_s / 3600.0) + np.square(TUNING.repeats)
        self._doubt_square: Array = np.square(TUNING.doubt)
        self._covariance: Array = np.array([[of_lean, of_both], [of_both, of_lateness]]) + np.diag(walked)

    @property
    def covariance(self) -> Array:
        """(2, 2) of the two, what may have befallen them included."""
        return np.asarray(self._covariance + np.diag(self._doubt_square))

    @property
    def unconfirmed(self) -> SavedAttitudeError:
        """What is remembered, with its age by now."""
        since_s = 0.0 if self._began_s is None else self._t_s - self._began_s
        return msgspec.structs.replace(self.saved, unconfirmed_s=self._age_s + since_s)

    def joined(self, t_s: float, belief: Belief, information: Array, right: Array) -> tuple[Array, Array] | None:
        """Mean (2,) and covariance (2, 2) of the two, with what the record since the restart says: what gyroscopes show
        or somebody has measured (``belief``), and the ``information`` (2, 2), and that times its mean (2,), of what is
        below the waves. None: the record shows others, or has taken their place.
        """
        if self._began_s is None:
            self._began_s = t_s
        self._t_s = t_s
        left = 1.0 - (t_s - self._began_s) / attitude_fit.TUNING.record_s
        information, right = belief.information + information, belief.right + right
        if belief.spread != attitude_fit.NOTHING.spread:  # Of the lateness they say what it is likely to be.
            of_lateness = belief.spread[1] ** -2.0
            information = information + np.diag([0.0, of_lateness])
            right = right + np.array([0.0, of_lateness * belief.null[1]])
        off = right - information @ self.mean
        spread = information + information @ self._covariance @ information
        unlike = float(off @ np.linalg.lstsq(spread, off)[0])
        if not left > 0.0 or not unlike <= TUNING.unlike_nis:
            return None
        usual = np.diag(np.square(attitude_fit.TUNING.usual) ** -1.0)
        own = np.linalg.solve(information + usual, np.eye(len(usual)))
        open_square = np.diag(own) + np.square(own @ off)
        self._doubt_square = np.minimum(np.square(TUNING.doubt), TUNING.in_doubt**2 * open_square)
        self.is_confirmed = self.is_confirmed or bool(np.all(np.diag(own) <= np.square(TUNING.doubt)))
        remembered = self.covariance / left
        known = np.linalg.solve(np.eye(len(remembered)) + remembered @ information, remembered)
        covariance = np.asarray(0.5 * (known + known.T), dtype=np.float64)
        return self.mean + covariance @ off, covariance
