"""What the vessel does at any moment of a campaign, and what honest sensors would have in their registers then.

The motion is one of the simulator's seas, in a table of 100 rows a second with straight lines between them (1e-5 m).
The registers are made from the makers' manuals alone; nothing of the daemon's own decoding is used.
"""

from __future__ import annotations

import math
import random
from typing import Final, NamedTuple

import numpy as np

from heaved.simulate.seaway import seaway
from heaved.simulate.vessel import body_rates, specific_force

STEP_S: Final = 0.01

G_MPS2: Final = 9.80665
NOISE_LSB: Final = 6.0
"""Of accelerations and rates, standard deviation in steps of the registers (0.03 m/s2, 0.4 deg/s)."""
ANGLE_NOISE_LSB: Final = 4.0
"""0.02 degrees."""
LASER_MM: Final = 5000.0
LASER_NOISE_MM: Final = 2.0
_ACCELERATION: Final = 32768.0 / (16.0 * G_MPS2)
_RATE: Final = 32768.0 / math.radians(2000.0)
_ANGLE: Final = 32768.0 / math.pi


class Moment(NamedTuple):
    """What is true at one moment: m, degrees."""

    heave_m: float
    roll_deg: float
    pitch_deg: float


class Truth:
    """The vessel from ``begin_s`` of the monotonic clock on, for ``duration_s``; then it starts over."""

    def __init__(self, sea: str, seed: int, begin_s: float, duration_s: float) -> None:
        self._begin_s, self._duration_s = begin_s, duration_s
        self._chance = random.Random(f"readings {seed}")  # noqa: S311  # Seeded.
        t_s = np.arange(0.0, duration_s + 2.0 * STEP_S, STEP_S)
        motion = seaway(sea, seed).motion(t_s)
        force, rates = specific_force(motion), body_rates(motion)
        # As the WT901C485 counts them: x forward, y to port, z up, all right-handed; pitch and yaw are then reversed.
        self._registers = np.stack(
            [
                force.x * _ACCELERATION, force.y * _ACCELERATION, force.z * _ACCELERATION,
                rates.x * _RATE, rates.y * _RATE, rates.z * _RATE,
                0.0 * t_s, 0.0 * t_s, 0.0 * t_s,
                motion.roll_rad * _ANGLE, -motion.pitch_rad * _ANGLE, -motion.yaw_rad * _ANGLE,
            ]
        )  # fmt: skip
        self._registers = np.ascontiguousarray(self._registers.T)
        self._moments = np.ascontiguousarray(
            np.stack([motion.heave_m, np.degrees(motion.roll_rad), np.degrees(motion.pitch_rad)]).T
        )

    def _at(self, table: np.ndarray[tuple[int, int], np.dtype[np.float64]], t_s: float) -> list[float]:
        place = ((t_s - self._begin_s) % self._duration_s) / STEP_S
        row = int(place)
        share = place - row
        values: list[float] = (table[row] * (1.0 - share) + table[row + 1] * share).tolist()
        return values

    def at(self, t_s: float) -> Moment:
        """At a moment of the monotonic clock."""
        return Moment(*self._at(self._moments, t_s))

    def imu(self, t_s: float) -> list[int]:
        """(12,) registers 0x34 to 0x3F of a WT901C485 that is read at ``t_s``."""
        values = self._at(self._registers, t_s)
        noise = self._chance.gauss
        spread = [NOISE_LSB] * 6 + [0.0] * 3 + [ANGLE_NOISE_LSB] * 3
        return [_word(round(value + noise(0.0, std))) for value, std in zip(values, spread, strict=True)]

    def laser(self, t_s: float) -> list[int]:
        """(1,) register 0x34 of a WT53R-485, millimetres."""
        distance = LASER_MM + 1000.0 * self.at(t_s).heave_m + self._chance.gauss(0.0, LASER_NOISE_MM)
        return [min(max(round(distance), 0), 0xFFFF)]


def _word(value: int) -> int:
    """Two's complement; a maker's registers saturate."""
    return min(max(value, -32768), 32767) & 0xFFFF


class ClockRegisters:
    """A device whose only reading is when it was read: milliseconds since ``begin_s`` as int32. A reading that is not
    of its own moment, or is put together from two, is found in the recording.
    """

    def __init__(self, begin_s: float) -> None:
        self._begin_s = begin_s

    def at(self, t_s: float) -> list[int]:
        """(2,) registers."""
        now_ms = int((t_s - self._begin_s) * 1e3)
        return [now_ms >> 16 & 0x7FFF, now_ms & 0xFFFF]
