"""IMU samples on their way into the heave chain: bias and tilt come out, and account is kept of the line.

The attitude of an earlier sample serves while it is fresh; the accelerometers may show an earlier moment than the
attitude does. What a frame says of the samples is known here: what was wrong with the last one, how often they come,
how many are lost.
"""

from __future__ import annotations

from math import isfinite, nan
from typing import Final

from heaved.estimation.arrivals import Arrivals
from heaved.estimation.chain import HeaveChain
from heaved.estimation.frames import up_acceleration
from heaved.estimation.level_bias import LevelBias
from heaved.estimation.spikes import PLAUSIBLE_MPS2
from heaved.estimation.trail import Trail
from heaved.samples import GRAVITY_MPS2, Fault, ImuSample

ATTITUDE_HOLD_S: Final = 0.5
"""The last attitude serves this long; then the tilt is unknown."""
TILT_LASTS_S: Final = 5.0
"""With the tilt removed for that long, or not removed, the record is of one kind."""
LAG_S: Final = 0.005
"""A smaller lag of the accelerometers than this is not worth going back for."""
UNKNOWN: Final = (nan, nan, nan)


class Intake:
    """Feeds a heave chain with samples in order of time.

    Attributes:
        fault: of the last sample; OUT_OF_RANGE, STUCK or NOT_FINITE where the chain has found that out.
        arrivals: of good samples: how often they come, and how many are lost.
    """

    def __init__(self, chain: HeaveChain, max_rate_hz: float) -> None:
        self._chain = chain
        self.fault = Fault.NONE
        self.arrivals = Arrivals()
        self._attitude, self._attitude_t_s = UNKNOWN, nan
        self._attitudes = Trail(int(max_rate_hz))
        self._tilt_removed, self._tilt_since_s = False, nan
        self._level_bias = LevelBias()

    def take(self, sample: ImuSample) -> None:
        """Take one sample in, unless it carries a fault."""
        self.fault = sample.fault
        if sample.fault is not Fault.NONE:
            return
        t_s, roll_rad, pitch_rad = sample.t_s, sample.roll_rad, sample.pitch_rad
        if isfinite(roll_rad) and isfinite(pitch_rad):
            self._attitude, self._attitude_t_s = (roll_rad, pitch_rad, sample.yaw_rad), t_s
            self._attitudes.push((t_s, roll_rad, pitch_rad))
        ax, ay, az = sample.ax_mps2, sample.ay_mps2, sample.az_mps2
        up = az - GRAVITY_MPS2
        self._note_tilt(t_s, t_s - self._attitude_t_s <= ATTITUDE_HOLD_S and isfinite(ax + ay))
        bias, tilt = self._level_bias, None
        if self._tilt_removed:
            tilt = self._attitude_of_acceleration(t_s)
            up = up_acceleration(ax - bias.x_mps2, ay - bias.y_mps2, az, *tilt)
        if isfinite(self._chain.observe(t_s, up, az)):
            self.arrivals.take(t_s)
            if tilt is not None:
                bias.take(t_s, ax, ay, az, *tilt)
        elif self._chain.stuck.is_stuck and abs(up) <= PLAUSIBLE_MPS2:
            self.fault = Fault.STUCK
        else:
            self.fault = Fault.OUT_OF_RANGE if isfinite(az) else Fault.NOT_FINITE

    def attitude(self, t_s: float) -> tuple[float, float, float]:
        """Roll, pitch and yaw that serve at ``t_s``; nan when they are too old."""
        return self._attitude if t_s - self._attitude_t_s <= ATTITUDE_HOLD_S else UNKNOWN

    def is_tilt_removed(self, t_s: float) -> bool:
        """Whether the vertical acceleration is free of the tilt, and the attitude known at ``t_s``."""
        return self._tilt_removed and t_s - self._attitude_t_s <= ATTITUDE_HOLD_S

    def _attitude_of_acceleration(self, t_s: float) -> tuple[float, float]:
        """Roll and pitch for the moment that the accelerometers show: their own low-pass makes them late, as far as the
        laser has shown, and gravity removed with a later attitude leaves g (rate x lag)^2 / 2, slow and rectified."""
        lag_s = -self._chain.lead.learned_s
        if lag_s > LAG_S:
            then = self._attitudes.at(t_s - lag_s)
            if then is not None:
                return then[1], then[2]
        return self._attitude[0], self._attitude[1]

    def _note_tilt(self, t_s: float, is_removed: bool) -> None:
        """Whether the tilt is removed; one that comes and goes with a slow attitude sensor is one state, not two."""
        if is_removed != self._tilt_removed:
            if t_s - self._tilt_since_s > TILT_LASTS_S:
                self._chain.interrupt()
            self._tilt_removed, self._tilt_since_s = is_removed, t_s
