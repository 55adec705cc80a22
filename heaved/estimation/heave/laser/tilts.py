"""Roll and pitch of the recent past, without what the sensor leans and is late: how a gauge stood when it was read."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from math import hypot, inf, isfinite
from operator import itemgetter
from typing import TYPE_CHECKING, Final, NamedTuple

import msgspec

if TYPE_CHECKING:
    from heaved.estimation.imu.attitude import Attitude
    from heaved.estimation.imu.attitude_error import Lean


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Between what the angles are known."""

    apart_s: float = 0.5
    """Attitudes further apart do not show what the vessel did in between."""
    ahead_s: float = 0.2
    """For so long after the last one its rates lead on."""


TUNING: Final = Tuning()


class Tilt(NamedTuple):
    """Roll (port side up) and pitch (bow up), rad."""

    roll_rad: float
    pitch_rad: float


class Tilts:
    """Push the attitude of every sample; it knows that of readings in between, which may come some seconds later.

    Attributes:
        std_rad: how well it is known what is taken out of roll and of pitch.
    """

    def __init__(self, capacity: int) -> None:
        self._rows: deque[tuple[float, float, float, float, float]] = deque(maxlen=capacity)
        """Time as the sensor has it, roll, pitch and their rates."""
        self._late_s = 0.0
        self.std_rad = (0.0, 0.0)

    def push(self, attitude: Attitude, lean: Lean, late_s: float) -> None:
        """Take what is known after a sample: what the sensor shows, how far that leans, by how much it is late."""
        self._late_s = late_s
        self.std_rad = (
            hypot(lean.roll_std_rad, lean.late_roll_std_rad),
            hypot(lean.pitch_std_rad, lean.late_pitch_std_rad),
        )
        last_s = self._rows[-1][0] if self._rows else -inf
        roll, pitch = attitude.roll_rad - lean.roll_rad, attitude.pitch_rad - lean.pitch_rad
        if attitude.t_s > last_s and isfinite(roll + pitch):
            self._rows.append((attitude.t_s, roll, pitch, attitude.roll_rate_radps, attitude.pitch_rate_radps))

    def at(self, t_s: float) -> Tilt | None:
        """The angles of a moment; None: they are not known."""
        rows, t_s = self._rows, t_s + self._late_s
        if not rows or not rows[0][0] <= t_s:
            return None
        since_s = t_s - rows[-1][0]
        if since_s > 0.0:
            _, roll, pitch, roll_rate, pitch_rate = rows[-1]
            if since_s > TUNING.ahead_s or not isfinite(roll_rate + pitch_rate):
                return None
            return Tilt(roll + since_s * roll_rate, pitch + since_s * pitch_rate)
        place = bisect_left(rows, t_s, key=itemgetter(0))
        after, roll, pitch, *_ = rows[place]
        if after == t_s:
            return Tilt(roll, pitch)
        before, roll_before, pitch_before, *_ = rows[place - 1]
        if after - before > TUNING.apart_s:
            return None
        share = (t_s - before) / (after - before)
        return Tilt(roll_before + share * (roll - roll_before), pitch_before + share * (pitch - pitch_before))
