"""The laser as heave reference: sign, constant, gate, and what it says about the error of the published heave.

A gauge reads ``constant + sign * heave``. The constant (mounting height, tide, target) is unknown and slow; heave has
no mean, so the constant is the mean of (signed reading - heave estimate) over the recent past.
"""

from __future__ import annotations

from enum import Enum
from math import exp, inf, isfinite, nan, sqrt
from typing import Annotated, Final, Literal

import msgspec

from heaved.estimation.common import bounds

CONSTANT_MIN_S: Final = 15.0
"""Seconds of laser before the constant counts as known: two wave periods."""
LEAST_S: Final = 0.05
"""What the first reading counts for."""
PROVEN_S: Final = 2.0 * CONSTANT_MIN_S
"""The same before the readings say anything about the error of the heave."""
GATE: Final = 8.0
"""Readings further off than this many RMS residuals are not of this target (spray, a passing boat)."""
LEAP_S: Final = 1.0
"""Between readings no further apart a leap is seen as one, however far the heave itself is off."""
REBASED_S: Final = 0.25
"""Between samples no further apart the heave moves over to another lead."""
BACK: Final = 0.5
"""It has come back when less than that share of a leap is left: in between, noise would bring it back now and then."""
LEAP_READINGS: Final = 20
"""Steps from reading to reading from which the usual one is known."""
LEARNED: Final = 0.02
"""By that share a step moves what is known of the usual one: five times the noise is learned in eighty readings."""
STEP: Final = 0.6745 * sqrt(2.0)
"""Median size of the difference of two Gaussian numbers, over their standard deviation."""
LEAST_NOISE_M: Final = 1e-4
"""No laser repeats better at such distances, whatever is configured."""
MOST_NOISE_M: Final = 0.1
"""What scatters more, and is not configured to, is no distance."""
STEP_S: Final = 3.0
"""Outliers that go on for this long are a new constant, not outliers."""
ERROR_TIME_S: Final = 60.0
"""Memory of the error statistics: several wave periods."""
SCALE_TIME_S: Final = 180.0
"""Memory of what the laser says about the standard deviation: the error of a swell grows and fades over 40-80 s, and a
minute of either kind is not the error that an outage will have."""
INDEPENDENT_S: Final = 40.0
"""As long as such an error grows or fades: two numbers of it, amplitude and phase, are independent of the last ones."""
SURELY: Final = 2.0
"""Standard errors by which the laser must have shown a smaller error than the modelled one."""
FOLLOW_S: Final = 60.0
"""Time constant with which the standard deviation takes it over."""
SCALE_LIMITS: Final = (0.2, 10.0)
"""Bounds of what the laser may do to the modelled standard deviation."""


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[laser]``: how the gauge's reading becomes a heave reference: ``sign * reading`` less a slow constant."""

    role: Literal["reference", "aiding"] = "reference"
    """"reference": lead, gain and network are learned from it; "aiding": it is a measurement in the sea observer."""
    sign: Literal[1, -1] = 1
    """+1: the reading grows as the ship heaves up."""
    max_age_s: Annotated[float, msgspec.Meta(gt=0, le=60)] = 0.5
    """Older than this, the reference is stale: not published, not learned from."""
    noise_std_m: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.002
    """Standard deviation of one reading, from the maker's data sheet."""
    constant_time_s: Annotated[float, msgspec.Meta(gt=0, le=36000)] = 60.0
    """Time constant with which the unknown constant is followed, in seconds of laser."""


class Verdict(Enum):
    """What became of a reading."""

    ACCEPTED = "accepted"
    OUTLIER = "outlier"
    RESTARTED = "restarted"
    """The constant was given up: the readings agree among themselves on another one."""


class Reference:
    """Follows the constant and the size of the residuals; readings come in order of time."""

    def __init__(self, params: Params) -> None:
        self._params = params
        self.restarts = 0
        self._rebased_s = -inf
        self._scale2, self._judged_s = 1.0, nan
        self._shown2 = self._modelled2 = self._shown_s = 0.0
        self.forget()

    def forget(self) -> None:
        """Start the constant again (the observer was restarted, or the target has changed).

        What is known of the standard deviation stays: half a minute after a restart knows less.
        """
        self._constant_m = 0.0
        self._seconds = 0.0
        self._mean_square = 0.0
        self._t_s = nan
        self._outlier_since_s = nan
        self._residual_m, self._leapt_m = nan, 0.0
        self._step_m, self._steps = STEP * max(self._params.noise_std_m, LEAST_NOISE_M), 0
        """Median of the steps from reading to reading: leaps do not move it, however many there are."""
        self.value_m = nan
        self.value_t_s = nan

    @property
    def known(self) -> bool:
        """Whether the constant has been averaged long enough for the reference to mean something."""
        return self._seconds >= CONSTANT_MIN_S

    @property
    def is_proven(self) -> bool:
        """Whether the readings may judge the heave: after another target, when they have agreed on it for so long that
        a boat is gone."""
        return self.restarts == 0 or self._seconds >= PROVEN_S

    @property
    def constant_m(self) -> float:
        return self._constant_m if self.known else nan

    @property
    def std_scale(self) -> float:
        """Factor between the error that the laser has shown and the one that was modelled; 1 before any laser."""
        return sqrt(self._scale2)

    def std_scale_at(self, t_s: float) -> float:
        """:attr:`std_scale` for a moment after the last reading: that the heave is better than modelled is of the sea
        of then, that it is worse is of the sensor, and stays."""
        if self._scale2 >= 1.0 or not t_s > self._judged_s:
            return self.std_scale
        return sqrt(1.0 + exp((self._judged_s - t_s) / SCALE_TIME_S) * (self._scale2 - 1.0))

    def signed(self, laser_m: float) -> float:
        """The reading with the sign of heave, constant included (m)."""
        return self._params.sign * laser_m

    def take(self, t_s: float, laser_m: float, estimate_m: float, modelled_std_m: float) -> Verdict:
        """Compare a reading with the published heave at its own time.

        modelled_std_m: standard deviation that the observer's model gives for that heave (nan: not known yet).
        """
        residual = self.signed(laser_m) - estimate_m
        if self._seconds == 0.0:
            self._constant_m = residual
        deviation = residual - self._constant_m
        since_s = t_s - self._t_s
        dt = min(since_s, 1.0) if isfinite(since_s) else 0.05
        self._t_s = t_s
        floor = (4.0 * self._params.noise_std_m) ** 2
        is_far = self.known and deviation**2 > GATE**2 * max(self._mean_square, floor)
        if self._has_leapt(t_s, since_s, residual) or is_far or abs(deviation) > bounds.HEAVE_M:
            if not isfinite(self._outlier_since_s):
                self._outlier_since_s = t_s
            if not self.known:  # Readings most of which are refused never add up to a constant.
                self._seconds = max(self._seconds - dt, LEAST_S)
            if t_s - self._outlier_since_s < STEP_S:
                return Verdict.OUTLIER
            self.forget()
            self.restarts += 1
            return Verdict.RESTARTED
        self._outlier_since_s = nan
        self._seconds += dt
        # Twice the weight of a plain mean while there is little: the start is forgotten with the square of time.
        weight = min(1.0, dt / min(0.5 * self._seconds, self._params.constant_time_s))
        self._constant_m += weight * deviation
        memory = min(1.0, dt / min(0.5 * self._seconds, ERROR_TIME_S))
        self._mean_square += memory * (deviation**2 - self._mean_square)
        self.value_m, self.value_t_s = self.signed(laser_m) - self._constant_m, t_s
        if not (isfinite(modelled_std_m) and modelled_std_m > 0.0):
            return Verdict.ACCEPTED
        if not self.is_proven:
            return Verdict.ACCEPTED
        # Both of the same time: after a gap both are large for a while.
        self._shown_s += dt
        memory = min(1.0, dt / min(0.5 * self._shown_s, SCALE_TIME_S))
        self._shown2 += memory * (deviation**2 - self._shown2)
        memory = memory if self._modelled2 > 0.0 else 1.0
        self._modelled2 += memory * (modelled_std_m**2 - self._modelled2)
        if self._seconds < PROVEN_S:
            return Verdict.ACCEPTED
        shown2 = max(self._shown2 - self._params.noise_std_m**2, (0.25 * self._params.noise_std_m) ** 2)
        low, high = SCALE_LIMITS
        scale2 = min(max(shown2 / self._modelled2, low**2), high**2)
        if scale2 < 1.0:  # To be better than it thinks takes as long to see as its error takes to come and go.
            independent = 2.0 * max(min(self._shown_s, SCALE_TIME_S) / INDEPENDENT_S, 1.0)
            scale2 = min(scale2 * (1.0 + SURELY * sqrt(2.0 / independent)), 1.0)
        self._scale2, self._judged_s = self.std_scale_at(t_s - dt) ** 2, t_s
        self._scale2 += (1.0 - exp(-dt / FOLLOW_S)) * (scale2 - self._scale2)
        return Verdict.ACCEPTED

    def rebase(self, t_s: float) -> None:
        """The heave that the readings are compared with is made otherwise after ``t_s``: it leaps, not the laser."""
        self._rebased_s = t_s

    def _has_leapt(self, t_s: float, since_s: float, residual_m: float) -> bool:
        """Whether the readings have leapt away from the target that they were on, and not come back.

        From one reading to the next only the noise and the movement of the error come in, which are far smaller than
        the error itself; what leaps add up to is where the target is now.
        """
        step = residual_m - self._residual_m
        self._residual_m = residual_m
        if not since_s <= LEAP_S:  # The first, or the first after a pause: nothing to compare with.
            self._leapt_m = 0.0
            return False
        if t_s - since_s <= self._rebased_s + REBASED_S:
            return self._leapt_m != 0.0
        usual2 = 2.0 * self.reading_std_m**2 + self._mean_square * since_s**2
        self._steps += 1
        learned = max(LEARNED, 2.0 / self._steps)
        self._step_m *= exp(learned if abs(step) > self._step_m else -learned)
        most_m = max(self._params.noise_std_m, MOST_NOISE_M)
        self._step_m = min(max(self._step_m, STEP * LEAST_NOISE_M), STEP * most_m)
        if self._steps <= LEAP_READINGS:
            return False
        if self._leapt_m == 0.0 and step * step <= GATE**2 * usual2:
            return False
        self._leapt_m += step
        if self._leapt_m**2 > (BACK * GATE) ** 2 * usual2:
            return True
        self._leapt_m = 0.0
        return False

    @property
    def reading_std_m(self) -> float:
        """Standard deviation of one reading: as configured, or as the steps between readings show it to be."""
        return max(self._params.noise_std_m, self._step_m / STEP)

    def error_rms_m(self) -> float:
        """RMS of (reference - published heave) over the last minute of laser; nan before the constant is known."""
        return sqrt(self._mean_square) if self.known else nan

    def fresh(self, t_s: float) -> bool:
        """Whether the last accepted reading is young enough, and its constant known."""
        return self.known and t_s - self.value_t_s <= self._params.max_age_s
