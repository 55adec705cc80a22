"""What of the craft's sensors can be believed: heave, pitch, speed and flaps, each with what is wrong with it."""

from __future__ import annotations

from enum import IntEnum, StrEnum
from math import isfinite, nan
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from heaved.estimation.craft.tuning import TUNING
from heaved.unchanged import Unchanged

if TYPE_CHECKING:
    from heaved.estimation.craft.dynamics import Vessel

Array = NDArray[np.float64]


class Channel(IntEnum):
    """What is measured."""

    HEAVE = 0
    PITCH = 1


class Caution(StrEnum):
    """What was wrong with the input, or why the estimate is worth less than usual."""

    SETTLING = "settling"
    HEAVE_MISSING = "heave_missing"
    PITCH_MISSING = "pitch_missing"
    HEAVE_STUCK = "heave_stuck"
    PITCH_STUCK = "pitch_stuck"
    HEAVE_REJECTED = "heave_rejected"
    PITCH_REJECTED = "pitch_rejected"
    SPEED_ASSUMED = "speed_assumed"
    FLAP_ASSUMED = "flap_assumed"
    RESET = "reset"


MISSING: Final = (Caution.HEAVE_MISSING, Caution.PITCH_MISSING)
STUCK: Final = (Caution.HEAVE_STUCK, Caution.PITCH_STUCK)
REJECTED: Final = (Caution.HEAVE_REJECTED, Caution.PITCH_REJECTED)


class CraftInputs:
    """Keeps the last values that could be.

    Attributes:
        speed_mps: to be reckoned with; astern counts as stopped.
        flaps_rad: (2, 1), fore and aft.
        impossible: readings that no craft can have, heave and pitch.
    """

    def __init__(self, vessel: Vessel, stuck_after_s: float) -> None:
        self._vessel = vessel
        self._stuck_after_s = stuck_after_s
        self._foils = tuple(foil.area_m2 > 0.0 for foil in (vessel.fore_foil, vessel.aft_foil))
        self._unchanged = (Unchanged(), Unchanged())
        self.impossible = [0, 0]
        self.speed_mps = vessel.service_speed_mps
        self.flaps_rad = np.zeros((2, 1))

    def readings(self, t_s: float, heave_m: float, pitch_rad: float, cautions: list[Caution]) -> tuple[float, float]:
        """Heave and pitch, nan where there is none that can be one; what is wrong is added to the cautions."""
        heave = self._reading(Channel.HEAVE, t_s, heave_m, TUNING.most_heave_m, cautions)
        return heave, self._reading(Channel.PITCH, t_s, pitch_rad, TUNING.most_pitch_rad, cautions)

    def _reading(self, channel: Channel, t_s: float, value: float, most: float, cautions: list[Caution]) -> float:
        same_s = self._unchanged[channel].push(t_s, value)
        if not isfinite(value):
            cautions.append(MISSING[channel])
        elif abs(value) > most:
            cautions.append(REJECTED[channel])
            self.impossible[channel] += 1
        elif 0.0 < self._stuck_after_s <= same_s:
            cautions.append(STUCK[channel])
        else:
            return value
        return nan

    def drive(self, speed_mps: float, flap_fore_rad: float, flap_aft_rad: float, cautions: list[Caution]) -> None:
        """Take speed and flaps; one that is missing or cannot be is replaced by the last that could."""
        if abs(speed_mps) <= self._vessel.max_speed_mps:
            self.speed_mps = max(speed_mps, 0.0)
        elif any(self._foils):
            cautions.append(Caution.SPEED_ASSUMED)
        assumed = False
        for i, flap in enumerate((flap_fore_rad, flap_aft_rad)):
            if abs(flap) <= self._vessel.max_flap_rad:
                self.flaps_rad[i, 0] = flap
            else:
                assumed |= self._foils[i]
        if assumed:
            cautions.append(Caution.FLAP_ASSUMED)

    def forget_times(self) -> None:
        """Time has been set: since when a reading has not changed is not known."""
        for unchanged in self._unchanged:
            unchanged.clear()
