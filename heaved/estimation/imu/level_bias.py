"""The bias of the horizontal accelerometers, as far as it can be told without another reference.

Tilt is removed with the measured attitude: a_up = sin(pitch) fx + sin(roll) cos(pitch) fy + ... A bias b of fx or fy
comes through as b sin(tilt), at the very frequencies of the waves: 3 mg at five degrees of roll are 7 mm of heave at
10 s. A vessel does not run away: the mean of its horizontal acceleration in the level frame is nothing. What is found
instead is

    m = b + g d,     b bias of the accelerometer,  d error of the attitude against the accelerometers' axes,

and the two call for opposite things: b is to be taken out, while d is harmless as it is (gravity that is removed along
axes turned by a constant d is wrong in the second order only). So m is weighed by what such sensors have: small means
are more likely bias, large ones, of a unit that was screwed on askew, are certainly not. The mean of a normal b given
m, where the attitude is either true to ALIGNED or askew by ASKEW, with even odds:

    b = m B / (B + A + V) / (1 + l),   B = BIAS^2, A = (g ALIGNED)^2, V variance of m,
    l = ratio of the normal densities of m with the attitude askew and aligned.

It never exceeds 0.03 m/s2, so that, when it is wrong, it costs no more than a common bias costs.
"""

from __future__ import annotations

from math import exp, inf, sqrt
from typing import Final

import msgspec

from heaved.estimation.imu.attitude import level_acceleration
from heaved.samples import GRAVITY_MPS2


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What is held of such sensors, and how the mean is taken."""

    bias_mps2: float = 0.03
    """BIAS, standard deviation of the biases of the accelerometers in question: 3 mg."""
    aligned_rad: float = 0.001
    """ALIGNED, of the attitude against the accelerometers of one calibrated unit: 0.06 degrees."""
    askew_rad: float = 0.0175
    """ASKEW, of units that were mounted by hand: a degree."""
    memory_s: float = 600.0
    """Of the mean; until then, all there is."""
    first_s: float = 30.0
    """Nothing is said before."""
    every_s: float = 0.1
    """Samples closer together than this are left out."""
    longest_s: float = 1.0
    """A sample after a gap stands for at most this long."""
    wave_s: float = 3.0
    """The mean of a wave over T has a standard deviation of this over T times its own: a period over pi."""
    plausible_mps2: float = 8.0
    """No vessel is pushed sideways harder: what shows more is a fault, and counts as this."""


TUNING: Final = Tuning()


class LevelBias:
    """Feed it specific force and attitude; take what it has found from the specific force.

    Attributes:
        x_mps2, y_mps2: bias of the forward and of the port accelerometer.
    """

    def __init__(self) -> None:
        self.x_mps2 = self.y_mps2 = 0.0
        self._x, self._y = _Mean(), _Mean()
        self._t_s = -inf

    def step(self, t_s: float, fx: float, fy: float, fz: float, roll_rad: float, pitch_rad: float) -> None:
        """Specific force in m/s2 (body axes, as measured) and attitude at ``t_s``."""
        since_s = t_s - self._t_s
        if 0.0 <= since_s < TUNING.every_s:
            return
        self._t_s = t_s
        along_s = min(since_s, TUNING.longest_s) if since_s > 0.0 else TUNING.every_s
        x, y, _ = level_acceleration(fx, fy, fz, roll_rad, pitch_rad)
        self.x_mps2, self.y_mps2 = self._x.step(x, along_s), self._y.step(y, along_s)


class _Mean:
    """Of one horizontal acceleration, and the bias that it tells of."""

    def __init__(self) -> None:
        self._seconds = self._mean = self._variance = 0.0

    def step(self, value: float, along_s: float) -> float:
        """Bias after another value, which stands for so long."""
        self._seconds = min(self._seconds + along_s, TUNING.memory_s)
        share = along_s / self._seconds
        off = min(max(value, -TUNING.plausible_mps2), TUNING.plausible_mps2) - self._mean
        self._mean += share * off
        self._variance += share * (off * off - self._variance)
        if self._seconds < TUNING.first_s:
            return 0.0
        return bias_of_mean(self._mean, self._variance * (TUNING.wave_s / self._seconds) ** 2)


def bias_of_mean(mean_mps2: float, variance: float) -> float:
    """Expected bias (m/s2) of an accelerometer in the level plane that shows ``mean_mps2``, known to ``variance``."""
    bias, square = TUNING.bias_mps2**2, mean_mps2 * mean_mps2
    aligned = bias + (GRAVITY_MPS2 * TUNING.aligned_rad) ** 2 + variance
    askew = aligned + (GRAVITY_MPS2 * TUNING.askew_rad) ** 2
    likelier = sqrt(aligned / askew) * exp(min(0.5 * square * (1.0 / aligned - 1.0 / askew), 700.0))
    return mean_mps2 * bias / aligned / (1.0 + likelier)
