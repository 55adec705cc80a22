"""The vertical acceleration: bias, tilt and the attitude's own errors taken out of the specific force.

Between readings of the attitude it is carried on (:mod:`heaved.estimation.imu.attitude`); the accelerometers may show
another moment than it does. What a frame says of the samples is known here: what was wrong with the last one, how often
they come, how many are lost.
"""

from __future__ import annotations

from math import cos, inf, isfinite, nan
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.estimation.common.ring import History
from heaved.estimation.common.sample_rate import Arrivals
from heaved.estimation.imu.attitude import UNKNOWN, AttitudePropagator, level_acceleration
from heaved.estimation.imu.attitude_error import Amendment, AttitudeError, Lean
from heaved.estimation.imu.attitude_fit import Noise, Unsized
from heaved.estimation.imu.conditioning import NOTHING, Conditioned
from heaved.estimation.imu.leaks import Leaks, leaks_mps2
from heaved.estimation.imu.level_bias import LevelBias
from heaved.estimation.imu.tilt_left import TILT_HZ, TILT_SHAPE, TiltLeft
from heaved.samples import GRAVITY_MPS2, Fault, RockPrediction

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.estimation.imu.attitude_memory import SavedAttitudeError
NO_LEVEL: Final = (nan, nan)
NO_RATES: Final = (nan, nan, nan)
TOO_TILTED: Final = "no attitude or no horizontal acceleration: too much tilt in the acceleration to use it"


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What is set by us, not by the user."""

    attitude_hold_s: float = 0.5
    """What is known of the attitude serves this long on a straight line; then the tilt is unknown."""
    tilt_lasts_s: float = 5.0
    """With the tilt removed for that long, or not removed, the record is of one kind."""
    lag_s: float = 0.005
    """A smaller lag of the accelerometers than this is not worth going back for."""
    tilt_matters_mps2: float = 0.01
    """RMS of what the tilt makes of the vertical acceleration from which there is more of it than of heave at the low
    end of the waves: the acceleration had better be missing than be taken with the tilt in it."""
    tilt_memory_s: float = 60.0
    """Of that RMS."""
    tilt_mean_s: float = 10.0
    """Of its mean, that of a list, which is taken out where no attitude is: it would be a step of the level."""
    tilt_seen_s: float = 20.0
    """Without an attitude, and with no memory of one, so much of a record shows how large it is."""
    tilt_said_s: float = 10.0
    """So often it is said what noise that is."""
    tilt_lingers: float = 3.0
    """What tilt has done to the heave is gone after so many times as long as it was in the acceleration."""


TUNING: Final = Tuning()


class VerticalAcceleration(msgspec.Struct, frozen=True, gc=False):
    """What the accelerometers say of the heave at one moment, and what else has become known of it."""

    t_s: float
    up_mps2: float
    """Positive up, at rest zero but for the bias that is left."""
    is_of_another_kind: bool = False
    """From here on the tilt is removed and was not before, or the other way round."""
    amendment: Amendment | None = None
    """What the past was measured too little by."""
    noise: Noise | None = None
    """Noise that the acceleration has and does not show."""
    unsized: Unsized | None = None
    """The same of the last quarter of a second, as it came."""
    roll_rad: float = nan
    pitch_rad: float = nan
    """Of that moment, as measured; nan: the tilt is not removed."""
    yaw_rad: float = nan
    """About then; nan: not known."""
    leaks_mps2: Leaks | None = None
    """What an IMU that is not as it is held to be would put into it; None: without an attitude nobody knows."""


class Vertical:
    """Feed it judged samples in order of time; it gives the vertical acceleration of each that has one.

    Attributes:
        fault: of the last sample, or of the accelerations in it.
        arrivals: of good samples: how often they come, and how many are lost.
        notes: what there is to say of the IMU beside that.
        withheld: why accelerations that are there are not given; empty: they are.
        force_std_s: how well the time is known at which the accelerations were measured.
        attitude: roll, pitch and yaw of the last sample, or of when they were last known.
        level_mps2: acceleration forward and to port in the level frame, of the last sample; nan: not known.
    """

    def __init__(self, max_rate_hz: float, attitude_late_s: float = 0.0) -> None:
        """``attitude_late_s``: how much older the angles are than the accelerations, as was measured; 0: nobody has."""
        self.fault = Fault.NONE
        self.arrivals = Arrivals()
        self.notes = NOTHING
        self.withheld = ""
        self.force_std_s = 0.0
        self.level_mps2 = NO_LEVEL
        self.attitude = UNKNOWN
        self._propagator = AttitudePropagator()
        self._attitudes = History(int(max_rate_hz))
        self._rates = History(int(max_rate_hz))
        self._t_s = nan
        self._tilt_removed, self._tilt_since_s = False, nan
        self._tilted_s = nan
        self._lingers_until_s = -inf
        self._tilt_mean, self._tilt_square = 0.0, 0.0
        """Of what the tilt makes of the vertical acceleration: its mean of late, and its mean square."""
        self._tilt_said_s = -inf
        self._left = TiltLeft()
        self._level_bias = LevelBias()
        self._attitude_error = AttitudeError(attitude_late_s)

    def step(
        self,
        readings: Conditioned,
        rock: Sequence[RockPrediction],
        *,
        lag_s: float,
        bias_mps2: float,
        leaking: Sequence[float] = (),
    ) -> VerticalAcceleration | None:
        """Take one sample; None: there is no vertical acceleration in it that can be used.

        ``rock``: the predictions from it. ``lag_s``: of the accelerometers after the attitude, as far as is known.
        ``bias_mps2``: of the vertical accelerometer, likewise. ``leaking``: shares of the leaks that a laser has shown;
        these stay in what is returned, but are not to be taken for errors of the attitude, whose marks are like theirs.
        """
        self.fault, self.notes, self.force_std_s = readings.fault, readings.notes, readings.force_std_s
        self.level_mps2 = NO_LEVEL
        if (attitude := readings.attitude) is not None:
            self._attitudes.push((attitude.t_s, attitude.roll_rad, attitude.pitch_rad))
        self._propagator.step(readings.sample, attitude, rock)
        self.attitude = self._propagator.latest
        if self._propagator.are_rates_measured:
            self._rates.push((readings.sample.t_s, *self._propagator.rates))
        t_s, sample = readings.force_t_s, readings.sample
        if not isfinite(t_s):
            return None
        ax, ay, az = sample.ax_mps2, sample.ay_mps2, sample.az_mps2
        has_tilt = t_s - self.attitude.t_s <= TUNING.attitude_hold_s and isfinite(ax + ay)
        if not has_tilt:
            self._left.step(t_s, ax, ay, az)
        is_of_another_kind = self._is_of_another_kind(t_s, has_tilt)
        if self.withheld:
            return None
        self.arrivals.step(t_s)
        if not self._tilt_removed:
            self._t_s = t_s
            up = az - GRAVITY_MPS2 + self._tilt_mean
            return VerticalAcceleration(t_s, up, is_of_another_kind, noise=self._noise_of_tilt(t_s))
        lag_s = lag_s if lag_s >= TUNING.lag_s else 0.0
        roll, pitch = self._attitude_of_acceleration(t_s - lag_s)
        level_bias, propagator, error = self._level_bias, self._propagator, self._attitude_error
        fx, fy = ax - level_bias.x_mps2, ay - level_bias.y_mps2
        x, y, up = level_acceleration(fx, fy, az, roll, pitch)
        self.level_mps2 = x, y
        # Angles moved back to where the accelerometers are would seem late against the gyroscopes.
        are_of_gyros = propagator.are_rates_measured and lag_s == 0.0
        leaks = leaks_mps2(fx, fy, az, roll, pitch)
        leaked = sum([w * leak for w, leak in zip(leaking, leaks, strict=True)]) if leaking else 0.0
        up = leaked + error.step(
            t_s, x, y, up - leaked, roll, pitch, *propagator.rates, are_rates_measured=are_of_gyros
        )
        # A bias across the deck is not all vertical on a vessel that rolls; what is left of it is the observer's.
        up += bias_mps2 * (1.0 - cos(roll) * cos(pitch))
        self._note_tilt(t_s, up - (az - GRAVITY_MPS2))
        level_bias.step(t_s, ax, ay, az, roll, pitch)
        amendment, noise, unsized = error.amendment, error.noise, error.unsized
        error.amendment = error.noise = error.unsized = None
        yaw = self.attitude.yaw_rad
        return VerticalAcceleration(t_s, up, is_of_another_kind, amendment, noise, unsized, roll, pitch, yaw, leaks)

    def amend(self, more: Amendment) -> None:
        """What is leaking has been found to be something else: in the past, too, from which errors of the attitude are
        told.
        """
        self._attitude_error.amend(more)

    def _is_of_another_kind(self, t_s: float, has_tilt: bool) -> bool:
        """Whether the tilt is removed from now on and was not, or the other way round; and whether the acceleration had
        better be withheld.
        """
        self.withheld = ""
        if has_tilt:
            self._tilted_s = t_s
        else:
            square, is_measured = self._tilt_now(t_s)
            if is_measured and square > TUNING.tilt_matters_mps2**2:
                self.withheld = TOO_TILTED
                return False
        is_other = has_tilt != self._tilt_removed
        # One that comes and goes with a slow attitude sensor is one state, not two.
        has_lasted = is_other and t_s - self._tilt_since_s > TUNING.tilt_lasts_s
        if is_other:
            self._tilt_removed, self._tilt_since_s = has_tilt, t_s
        if not has_tilt and isfinite(self._tilted_s):
            lasted_s = min(t_s - self._tilted_s, TUNING.tilt_lasts_s)
            self._lingers_until_s = t_s + TUNING.tilt_lingers * lasted_s
        return has_lasted

    def _tilt_now(self, t_s: float) -> tuple[float, bool]:
        """Mean square of what a tilt that is not removed makes of the vertical acceleration, and whether it has been
        measured: as it was while the attitude was known, until the accelerations have shown it since; 0: nothing is
        known of it.
        """
        if self._shows_tilt(t_s):
            return self._left.square, self._left.is_measured
        return self._tilt_square, True

    def _shows_tilt(self, t_s: float) -> bool:
        """Whether the accelerations tell more of it than the attitude of before."""
        return self._left.seconds(t_s) >= TUNING.tilt_seen_s and not t_s - self._tilted_s < TUNING.tilt_memory_s

    def _noise_of_tilt(self, t_s: float) -> Noise | None:
        """What a tilt that is not removed makes of the acceleration, when it is time to say so."""
        if t_s - self._tilt_said_s < TUNING.tilt_said_s:
            return None
        self._tilt_said_s = t_s
        return Noise(TILT_HZ, self._left.density if self._shows_tilt(t_s) else self._tilt_square * TILT_SHAPE)

    def _note_tilt(self, t_s: float, tilt_mps2: float) -> None:
        """Keep what the tilt makes of the vertical acceleration."""
        elapsed_s = t_s - self._t_s
        self._t_s = t_s
        if elapsed_s > 0.0:
            self._tilt_mean += min(elapsed_s / TUNING.tilt_mean_s, 1.0) * (tilt_mps2 - self._tilt_mean)
            share = min(elapsed_s / TUNING.tilt_memory_s, 1.0)
            self._tilt_square += share * (tilt_mps2**2 - self._tilt_square)

    @property
    def rates_radps(self) -> tuple[float, float, float]:
        """Derivatives of roll, pitch and yaw at the last sample, from its body rates; nan: it has none to believe."""
        propagator = self._propagator
        return (*propagator.rates, propagator.yaw_rate_radps) if propagator.are_rates_measured else NO_RATES

    def rates_before(self, t_s: float) -> tuple[float, float]:
        """The first two at an earlier moment, within a second or so."""
        found = self._rates.at(t_s)
        return (nan, nan) if found is None else (found[1], found[2])

    def lean(self, t_s: float, omega_radps: float) -> Lean:
        """What the measured angles of a moment are off by, see :meth:`AttitudeError.lean`."""
        return self._attitude_error.lean(t_s, omega_radps)

    def restore(self, saved: SavedAttitudeError, age_s: float) -> None:
        """Begin with what an earlier run has found of the attitude's errors, see :meth:`AttitudeError.restore`."""
        self._attitude_error.restore(saved, age_s)

    def saved(self) -> SavedAttitudeError | None:
        """What a restart shall remember of them."""
        return self._attitude_error.saved()

    @property
    def late_s(self) -> float:
        """By which the measured angles are late."""
        return self._attitude_error.angles_late_s

    def serves(self, t_s: float) -> bool:
        """Whether that attitude may be published for a moment, on a straight line."""
        return self._propagator.serves(t_s)

    def is_tilt_removed(self, t_s: float) -> bool:
        """Whether the vertical acceleration is free of the tilt, and the attitude known at ``t_s``."""
        return self._tilt_removed and t_s - self.attitude.t_s <= TUNING.attitude_hold_s

    def is_recovering(self, t_s: float) -> bool:
        """Whether the heave still suffers from tilt that was not removed a moment ago."""
        return self._tilt_removed and t_s < self._lingers_until_s

    def _attitude_of_acceleration(self, t_s: float) -> tuple[float, float]:
        """Roll and pitch for the moment that the accelerometers show: their own low-pass makes them late, as far as the
        laser has shown, and gravity removed with a later attitude leaves g (rate x lag)^2 / 2, slow and rectified.
        """
        if t_s < self.attitude.t_s:
            then = self._attitudes.at(t_s)
            if then is not None:
                return then[1], then[2]
        return self.attitude.at(t_s)
