"""``$PSXN`` 20, 23 and 24 of Kongsberg's Seapath, one after the other: quality, motion and rates of one moment.

    $PSXN,20,horizontal,height,heading,roll and pitch*CS
    $PSXN,23,roll,pitch,heading,heave*CS
    $PSXN,24,roll rate,pitch rate,yaw rate,vertical velocity*CS

Roll (port side up), pitch (bow up) and heading in degrees, their rates in degrees per second (yaw: bow to starboard),
heave and vertical velocity in metres and m/s, **positive down**; all of them to 0.01. What is not known, or beyond 180
degrees of roll, 90 of pitch, 999 degrees per second, 99 m and 99 m/s, is empty.

Quality is 0 normal, 1 reduced performance, 2 invalid:

* horizontal position and velocity: 2 at all times, there are none;
* height, that is heave and vertical velocity: 0 while the heave is valid, 1 while it is degraded or settles, or its
  velocity is not known, 2 while it is invalid. The scale has no step for settling: ``settling = "error"`` makes it 2,
  and leaves heave and velocity empty until it has settled.
* heading, and roll with pitch: 0, or 2 when one of them is not known.

20 comes first: a reader knows what the values are worth before it has them. None of the three tells a time.

Sources: Simrad HS52, appendix A (20); the description of Seapath that pynmea2 quotes (20, 23, 24); recordings of a
Seapath 320+ (NOAA NCEI 0086548).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from heaved.outputs.motion import Lead
from heaved.outputs.telegrams.known import DEGREES, tells_heave
from heaved.outputs.telegrams.nmea import HEAVE_M, PITCH_DEG, RATE_DEGPS, ROLL_DEG, heading, number, sentence
from heaved.outputs.telegrams.spec import Format, HeavePositive, Signs
from heaved.samples import HeaveState

if TYPE_CHECKING:
    from heaved.outputs.motion import Motion
    from heaved.outputs.telegrams.spec import OutputSpec

_NORMAL: Final = 0
_REDUCED: Final = 1
_INVALID: Final = 2
_PLAIN: Final = "z.2f"


def encode(motion: Motion, spec: OutputSpec) -> bytes:
    """The three sentences of a motion."""
    tells = tells_heave(motion, spec)
    roll = number(motion.roll_rad * DEGREES, _PLAIN, ROLL_DEG)
    pitch = number(motion.pitch_rad * DEGREES, _PLAIN, PITCH_DEG)
    yaw = heading(motion.yaw_rad, _PLAIN)
    heave = number(motion.heave_m, _PLAIN, HEAVE_M) if tells else ""
    velocity = number(motion.heave_velocity_mps, _PLAIN, HEAVE_M) if tells else ""
    height = _INVALID if not heave else _NORMAL if velocity and motion.state is HeaveState.VALID else _REDUCED
    rates = [
        number(rate * DEGREES, _PLAIN, RATE_DEGPS)
        for rate in (motion.roll_rate_radps, motion.pitch_rate_radps, motion.yaw_rate_radps)
    ]
    return (
        sentence(
            f"PSXN,20,{_INVALID},{height},{_NORMAL if yaw else _INVALID},{_NORMAL if roll and pitch else _INVALID}"
        )
        + sentence(f"PSXN,23,{roll},{pitch},{yaw},{heave}")
        + sentence(f"PSXN,24,{rates[0]},{rates[1]},{rates[2]},{velocity}")
    )


FORMAT: Final = Format(
    title="PSXN 20, 23, 24",
    encode=encode,
    longest_bytes=21 + 41 + 45,
    lead=Lead.TRANSMISSION,
    signs=Signs(heave=HeavePositive.DOWN),
    options=("settling",),
)
