"""The laser as heave reference: constant, gate, and what it says about the error of the published heave.

A reading is a heave and a constant, once its sign, the lever arm and the tilt of the beam are taken out of it
(:mod:`heaved.estimation.heave.laser.placement`). The constant (mounting height, tide, target) is unknown and slow;
heave has no mean, so the constant is the mean of (signed reading - heave estimate) over the recent past.
"""

from __future__ import annotations

from enum import Enum
from math import exp, inf, isfinite, nan, sqrt
from typing import Annotated, Final, Literal

import msgspec

from heaved.estimation.common import bounds
from heaved.estimation.heave.laser.error_scale import PublishedScale
from heaved.estimation.heave.laser.geometry import DOWN, Geometry, Vector

Length = Annotated[float, msgspec.Meta(ge=-500, le=500)]


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[laser]``: how the gauge's reading becomes a heave reference: its place taken out, less a slow constant."""

    role: Literal["reference", "aiding"] = "reference"
    """"reference": lead, gain and network are learned from it; "aiding": it is a measurement in the sea observer."""
    sign: Literal[1, -1] = 1
    """+1: the reading grows as the ship heaves up."""
    forward_m: Length = 0.0
    """Where the gauge is, from the IMU; of one that stands on something fixed: where its beam meets the ship."""
    port_m: Length = 0.0
    up_m: Length = 0.0
    beam: Vector = DOWN
    """Where its beam points, in vessel axes x forward, y port, z up; of any length."""
    max_age_s: Annotated[float, msgspec.Meta(gt=0, le=60)] = 0.5
    """Older than this, the reference is stale: not published, not learned from."""
    noise_std_m: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.002
    """Standard deviation of one reading, from the maker's data sheet."""
    constant_time_s: Annotated[float, msgspec.Meta(gt=0, le=36000)] = 60.0
    """Time constant with which the unknown constant is followed, in seconds of laser."""

    @property
    def geometry(self) -> Geometry:
        """Where the gauge is."""
        return Geometry(forward_m=self.forward_m, port_m=self.port_m, up_m=self.up_m, beam=self.beam, sign=self.sign)


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """How the constant is followed, and how a reading is told that is not of this target."""

    constant_min_s: float = 15.0
    """Seconds of laser before the constant counts as known: two wave periods."""
    proven_s: float = 30.0
    """The same before the readings say anything about the error of the heave."""
    least_s: float = 0.05
    """What the first reading counts for."""
    error_time_s: float = 60.0
    """Memory of the error statistics: several wave periods."""
    gate: float = 8.0
    """Readings further off than this many RMS residuals are not of this target (spray, a passing boat)."""
    least_error: float = 4.0
    """RMS residual, in standard deviations of a reading, that the gate is not narrower for."""
    leap_s: float = 1.0
    """Between readings no further apart a leap is seen as one, however far the heave itself is off."""
    rebased_s: float = 0.25
    """Between samples no further apart the heave moves over to another lead."""
    back: float = 0.5
    """It has come back when less than that share of a leap is left: in between, noise would bring it back now and
    then."""
    leap_readings: int = 20
    """Steps from reading to reading from which the usual one is known."""
    learned: float = 0.02
    """By that share a step moves what is known of the usual one: five times the noise is learned in eighty readings."""
    least_noise_m: float = 1e-4
    """No laser repeats better at such distances, whatever is configured."""
    most_noise_m: float = 0.1
    """What scatters more, and is not configured to, is no distance."""
    step_s: float = 3.0
    """Outliers that go on for this long are a new constant, not outliers."""


TUNING: Final = Tuning()
STEP: Final = 0.6745 * sqrt(2.0)
"""Median size of the difference of two Gaussian numbers, over their standard deviation."""


class Reading(Enum):
    """What became of a reading."""

    ACCEPTED = "accepted"
    OUTLIER = "outlier"
    NEW_TARGET = "new target"
    """The constant was given up: the readings agree among themselves on another one."""


class Reference:
    """Follows the constant and the size of the residuals; readings come in order of time.

    Attributes:
        value_m, value_t_s: the last accepted reading, as heave, and its time.
        scale: what the readings say about the standard deviation of the published heave.
        restarts: times that another target was found.
    """

    def __init__(self, params: Params) -> None:
        self._params = params
        self.restarts = 0
        self._rebased_s = -inf
        self.scale = PublishedScale(params.noise_std_m)
        self._reset()

    def _reset(self) -> None:
        """Start the constant again: the target has changed.

        What is known of the standard deviation stays: half a minute after a restart knows less.
        """
        self._constant_m = 0.0
        self._seconds = 0.0
        self._mean_square = 0.0
        self._t_s = nan
        self._outlier_since_s = nan
        self._residual_m, self._leapt_m = nan, 0.0
        self._step_m, self._steps = STEP * max(self._params.noise_std_m, TUNING.least_noise_m), 0
        """Median of the steps from reading to reading: leaps do not move it, however many there are."""
        self.value_m = nan
        self.value_t_s = nan

    @property
    def is_known(self) -> bool:
        """Whether the constant has been averaged long enough for the reference to mean something."""
        return self._seconds >= TUNING.constant_min_s

    @property
    def is_proven(self) -> bool:
        """Whether the readings may judge the heave: after another target, when they have agreed on it for so long that
        a boat is gone.
        """
        return self.restarts == 0 or self._seconds >= TUNING.proven_s

    @property
    def constant_m(self) -> float:
        """The constant in the signed readings; nan before it is known."""
        return self._constant_m if self.is_known else nan

    def step(self, t_s: float, signed_m: float, estimate_m: float, modelled_std_m: float) -> Reading:
        """Compare a reading, as heave and a constant, with the published heave at its own time.

        modelled_std_m: standard deviation that the observer's model gives for that heave (nan: not known yet, or the
        reading is not to judge it).
        """
        residual_m = signed_m - estimate_m
        if self._seconds == 0.0:
            self._constant_m = residual_m
        deviation_m = residual_m - self._constant_m
        since_s = t_s - self._t_s
        dt = min(since_s, 1.0) if isfinite(since_s) else TUNING.least_s
        self._t_s = t_s
        if self._has_leapt(t_s, since_s, residual_m) or self._is_far(deviation_m):
            if not isfinite(self._outlier_since_s):
                self._outlier_since_s = t_s
            if not self.is_known:  # Readings most of which are refused never add up to a constant.
                self._seconds = max(self._seconds - dt, TUNING.least_s)
            if t_s - self._outlier_since_s < TUNING.step_s:
                return Reading.OUTLIER
            self._reset()
            self.restarts += 1
            return Reading.NEW_TARGET
        self._outlier_since_s = nan
        self._seconds += dt
        # Twice the weight of a plain mean while there is little: the start is forgotten with the square of time.
        weight = min(1.0, dt / min(0.5 * self._seconds, self._params.constant_time_s))
        self._constant_m += weight * deviation_m
        memory = min(1.0, dt / min(0.5 * self._seconds, TUNING.error_time_s))
        self._mean_square += memory * (deviation_m**2 - self._mean_square)
        self.value_m, self.value_t_s = signed_m - self._constant_m, t_s
        if isfinite(modelled_std_m) and modelled_std_m > 0.0 and self.is_proven:
            may_judge = self._seconds >= TUNING.proven_s
            self.scale.step(t_s, dt, deviation_m, modelled_std_m, may_judge=may_judge)
        return Reading.ACCEPTED

    def _is_far(self, deviation_m: float) -> bool:
        """Whether a reading is further off than any of this target is."""
        floor_m = TUNING.least_error * self._params.noise_std_m
        is_far = self.is_known and deviation_m**2 > TUNING.gate**2 * max(self._mean_square, floor_m**2)
        return is_far or abs(deviation_m) > bounds.HEAVE_M

    def rebase(self, t_s: float) -> None:
        """The heave that the readings are compared with is made otherwise after ``t_s``: it leaps, not the laser."""
        self._rebased_s = t_s

    def move(self, t_s: float, by_m: float, *, is_elsewhere: bool) -> None:
        """The gauge is taken to be at another place after ``t_s``: readings are ``by_m`` more in the mean.

        is_elsewhere: and not just a little off, so that what they said of the error of the heave is void.
        """
        self.rebase(t_s)
        self._constant_m += by_m
        if not is_elsewhere:
            return
        self._mean_square = 0.0
        self._seconds = min(self._seconds, TUNING.constant_min_s)
        self.scale = PublishedScale(self._params.noise_std_m)

    def _has_leapt(self, t_s: float, since_s: float, residual_m: float) -> bool:
        """Whether the readings have leapt away from the target that they were on, and not come back.

        From one reading to the next only the noise and the movement of the error come in, which are far smaller than
        the error itself; what leaps add up to is where the target is now.
        """
        step = residual_m - self._residual_m
        self._residual_m = residual_m
        if not since_s <= TUNING.leap_s:  # The first, or the first after a pause: nothing to compare with.
            self._leapt_m = 0.0
            return False
        if t_s - since_s <= self._rebased_s + TUNING.rebased_s:
            return self._leapt_m != 0.0
        usual2 = 2.0 * self.reading_std_m**2 + self._mean_square * since_s**2
        self._steps += 1
        learned = max(TUNING.learned, 2.0 / self._steps)
        self._step_m *= exp(learned if abs(step) > self._step_m else -learned)
        most_m = max(self._params.noise_std_m, TUNING.most_noise_m)
        self._step_m = min(max(self._step_m, STEP * TUNING.least_noise_m), STEP * most_m)
        if self._steps <= TUNING.leap_readings:
            return False
        if self._leapt_m == 0.0 and step * step <= TUNING.gate**2 * usual2:
            return False
        self._leapt_m += step
        if self._leapt_m**2 > (TUNING.back * TUNING.gate) ** 2 * usual2:
            return True
        self._leapt_m = 0.0
        return False

    @property
    def reading_std_m(self) -> float:
        """Standard deviation of one reading: as configured, or as the steps between readings show it to be."""
        return max(self._params.noise_std_m, self._step_m / STEP)

    def error_rms_m(self) -> float:
        """RMS of (reference - published heave) over the last minute of laser; nan before the constant is known."""
        return sqrt(self._mean_square) if self.is_known else nan

    def is_fresh(self, t_s: float) -> bool:
        """Whether the last accepted reading is young enough, and its constant known."""
        return self.is_known and t_s - self.value_t_s <= self._params.max_age_s
