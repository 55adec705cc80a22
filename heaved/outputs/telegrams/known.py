"""What is known of a motion, in the units of a telegram. Pure.

One rule for all formats: a quantity is told as it is, to half a unit, or it is told to be *not known*. It is not known
when it is not a number, when it does not fit into the range of the format (the end of the range would be as wrong as
zero), and, for what is vertical, when the heave is not worth telling. How that is said is the format's; one that has no
way to say it is silent instead, ``b""``, so that the reader's own time-out acts.
"""

from __future__ import annotations

from math import degrees, nan, pi
from typing import TYPE_CHECKING, Final

from heaved.outputs.telegrams.spec import Settling
from heaved.samples import HeaveState

if TYPE_CHECKING:
    from heaved.outputs.motion import Motion
    from heaved.outputs.telegrams.spec import OutputSpec

CENTIDEGREES: Final = 100.0 * 180.0 / pi
"""Per radian."""
DEGREES: Final = 180.0 / pi
"""Per radian."""
_MOST_TURNS_DEG: Final = 1e6
"""A heading may have been counted over many turns; what is beyond this is none."""
_UNKNOWN: Final = (nan, nan, nan)


def vertical(motion: Motion, spec: OutputSpec) -> tuple[float, float, float]:
    """Heave, its velocity and its acceleration, m, m/s and m/s2; all nan while the heave is not worth telling: it is
    invalid, or it settles and the output counts that as an error.
    """
    if not tells_heave(motion, spec):
        return _UNKNOWN
    return motion.heave_m, motion.heave_velocity_mps, motion.heave_acceleration_mps2


def tells_heave(motion: Motion, spec: OutputSpec) -> bool:
    """Whether heave, its velocity and its acceleration are told: not while they are invalid, nor while they settle and
    the reader is to take that for an error.
    """
    if motion.state is HeaveState.SETTLING:
        return spec.settling is not Settling.ERROR
    return motion.state is not HeaveState.INVALID


def whole(value: float, units: float, most: int) -> int | None:
    """``value`` in whole units, of which ``units`` make one; None: not known, or beyond +-``most`` units."""
    scaled = value * units
    return round(scaled) if -most - 0.5 < scaled < most + 0.5 else None


def heading_deg(yaw_rad: float) -> float:
    """The heading, from 0 to 360 degrees, where rounding makes 360.0 of what is a hair below it; nan: not known."""
    heading = degrees(yaw_rad)
    return heading % 360.0 if -_MOST_TURNS_DEG < heading < _MOST_TURNS_DEG else nan
