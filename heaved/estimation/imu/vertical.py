"""IMU samples on their way into the heave chain: bias and tilt come out, and account is kept of the line.

Between readings of the attitude it is carried on (:mod:`heaved.estimation.imu.attitude`); the accelerometers may
show another moment than it does. What a frame says of the samples is known here: what was wrong with the last one, how
often they come, how many are lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, inf, isfinite, nan
from typing import Final

from heaved.estimation.common.ring import History
from heaved.estimation.common.sample_rate import Arrivals
from heaved.estimation.heave.estimator import HeaveChain
from heaved.estimation.imu.attitude import Attitude, AttitudePropagator, level_acceleration
from heaved.estimation.imu.attitude_error import AttitudeError
from heaved.estimation.imu.conditioning import NOTHING, Conditioned
from heaved.estimation.imu.level_bias import LevelBias
from heaved.samples import GRAVITY_MPS2, Fault, RockPrediction

ATTITUDE_HOLD_S: Final = 0.5
"""What is known of the attitude serves this long on a straight line; then the tilt is unknown."""
TILT_LASTS_S: Final = 5.0
"""With the tilt removed for that long, or not removed, the record is of one kind."""
LAG_S: Final = 0.005
"""A smaller lag of the accelerometers than this is not worth going back for."""
TILT_MATTERS_MPS2: Final = 0.01
"""RMS of what the tilt makes of the vertical acceleration from which there is more of it than of heave at the low end
of the waves: where the tilt has been removed, the acceleration had better be missing than be taken with the tilt in it,
for as long as that is remembered."""
TILT_MEMORY_S: Final = 60.0
TOO_TILTED: Final = "no attitude or no horizontal acceleration: too much tilt in the acceleration to use it"
TILT_LINGERS: Final = 3.0
"""What tilt has done to the heave is gone after so many times as long as it was in the acceleration."""


class Intake:
    """Feeds a heave chain with samples in order of time.

    Attributes:
        fault: of the last sample, or of the accelerations in it.
        arrivals: of good samples: how often they come, and how many are lost.
        notes: what there is to say of the IMU beside that.
        withheld: why accelerations that are there are not taken; empty: they are.
        attitude_is_slow: angles come more seldom than samples.
        force_std_s: how well the time is known at which the accelerations were measured.
    """

    def __init__(self, chain: HeaveChain, max_rate_hz: float) -> None:
        self._chain = chain
        self.fault = Fault.NONE
        self.arrivals = Arrivals()
        self.notes = NOTHING
        self.withheld = ""
        self.attitude_is_slow = False
        self.force_std_s = 0.0
        self._carried = AttitudePropagator()
        self._attitudes = History(int(max_rate_hz))
        self._tilt_removed, self._tilt_since_s = False, nan
        self._tilted_s = nan
        self._lingers_until_s = -inf
        self._tilt_square = 0.0
        self._level_bias = LevelBias()
        self._attitude_error = AttitudeError()

    def take(self, conditioned: Conditioned, rock: Sequence[RockPrediction]) -> None:
        """Take one sample in, as far as there are readings in it; ``rock``: the predictions from it."""
        self.fault, self.notes, self.force_std_s = conditioned.fault, conditioned.notes, conditioned.force_std_s
        self.attitude_is_slow = conditioned.attitude_is_slow
        if (attitude := conditioned.attitude) is not None:
            self._attitudes.push((attitude.t_s, attitude.roll_rad, attitude.pitch_rad))
        self._carried.step(conditioned.sample, attitude, rock)
        t_s = conditioned.force_t_s
        if not isfinite(t_s):
            return
        sample = conditioned.sample
        ax, ay, az = sample.ax_mps2, sample.ay_mps2, sample.az_mps2
        up = az - GRAVITY_MPS2
        has_tilt = t_s - self._carried.latest.t_s <= ATTITUDE_HOLD_S and isfinite(ax + ay)
        self.withheld = ""
        if has_tilt:
            self._tilted_s = t_s
        elif t_s - self._tilted_s < TILT_MEMORY_S and self._tilt_square > TILT_MATTERS_MPS2**2:
            self.withheld = TOO_TILTED
            return
        self._note_tilt(t_s, has_tilt)
        if not has_tilt and isfinite(self._tilted_s):
            self._lingers_until_s = t_s + TILT_LINGERS * min(t_s - self._tilted_s, TILT_LASTS_S)
        bias, tilt = self._level_bias, None
        if self._tilt_removed:
            tilt = self._attitude_of_acceleration(t_s)
            x, y, level = level_acceleration(ax - bias.x_mps2, ay - bias.y_mps2, az, *tilt)
            carried = self._carried
            # Angles moved back to where the accelerometers are would seem late against the gyroscopes.
            are_of_gyros = carried.are_rates_measured and self._chain.lead.learned_s > -LAG_S
            level = self._attitude_error.step(t_s, x, y, level, *tilt, *carried.rates, are_rates_measured=are_of_gyros)
            # A bias across the deck is not all vertical on a vessel that rolls; what is left of it is the observer's.
            level += self._chain.observer.bias_mps2 * (1.0 - cos(tilt[0]) * cos(tilt[1]))
            share = min((t_s - self._chain.good_t_s) / TILT_MEMORY_S, 1.0)
            if share > 0.0:
                self._tilt_square += share * ((level - up) ** 2 - self._tilt_square)
            up = level
        self._chain.observe(t_s, up)
        if (amendment := self._attitude_error.amendment) is not None:
            self._attitude_error.amendment = None
            self._chain.amend(amendment.t_s, amendment.more_mps2)
        if (noise := self._attitude_error.noise) is not None:
            self._attitude_error.noise = None
            self._chain.disturb(noise.f_hz, noise.psd)
        self.arrivals.step(t_s)
        if tilt is not None:
            bias.step(t_s, ax, ay, az, *tilt)

    @property
    def attitude(self) -> Attitude:
        """Roll, pitch and yaw of the last sample, or of when they were last known."""
        return self._carried.latest

    def is_tilt_removed(self, t_s: float) -> bool:
        """Whether the vertical acceleration is free of the tilt, and the attitude known at ``t_s``."""
        return self._tilt_removed and t_s - self.attitude.t_s <= ATTITUDE_HOLD_S

    def is_recovering(self, t_s: float) -> bool:
        """Whether the heave still suffers from tilt that was not removed a moment ago."""
        return self._tilt_removed and t_s < self._lingers_until_s

    def _attitude_of_acceleration(self, t_s: float) -> tuple[float, float]:
        """Roll and pitch for the moment that the accelerometers show: their own low-pass makes them late, as far as the
        laser has shown, and gravity removed with a later attitude leaves g (rate x lag)^2 / 2, slow and rectified."""
        lag_s = -self._chain.lead.learned_s
        if lag_s < LAG_S:
            lag_s = 0.0
        if t_s - lag_s < self.attitude.t_s:
            then = self._attitudes.at(t_s - lag_s)
            if then is not None:
                return then[1], then[2]
        return self.attitude.at(t_s - lag_s)

    def _note_tilt(self, t_s: float, is_removed: bool) -> None:
        """Whether the tilt is removed; one that comes and goes with a slow attitude sensor is one state, not two."""
        if is_removed != self._tilt_removed:
            if t_s - self._tilt_since_s > TILT_LASTS_S:
                self._chain.interrupt()
            self._tilt_removed, self._tilt_since_s = is_removed, t_s
