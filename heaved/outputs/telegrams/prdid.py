"""``$PRDID``: pitch, roll and heading for the current profilers of Teledyne RD Instruments.

    $PRDID,±ppp.pp,±rrr.rr,hhh.hh*CS

Pitch (bow up), roll (port side up) and heading in degrees to 0.01, of fixed width, pitch and roll always with their
sign. What is not known, or beyond 90 degrees of pitch and 180 of roll, is empty. It tells no heave, no time and no
quality.

Makers differ: Applanix writes the numbers without leading zeros, Norwegian Subsea leaves the checksum out; readers of
numbers and of NMEA take them as they are here. Two strings are in use that differ in nothing but what roll is
(Applanix, POS MV): ``roll_convention`` tells which.

Sources: Applanix POS MV V5, table 21; Norwegian Subsea, "RDI ADCP" (its example is in the tests).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from heaved.outputs.motion import Lead
from heaved.outputs.telegrams.known import DEGREES
from heaved.outputs.telegrams.nmea import PITCH_DEG, ROLL_DEG, heading, number, sentence
from heaved.outputs.telegrams.spec import Format

if TYPE_CHECKING:
    from heaved.outputs.motion import Motion
    from heaved.outputs.telegrams.spec import OutputSpec

_SIGNED: Final = "+z07.2f"


def encode(motion: Motion, _spec: OutputSpec) -> bytes:
    """The sentence of a motion."""
    pitch = number(motion.pitch_rad * DEGREES, _SIGNED, PITCH_DEG)
    roll = number(motion.roll_rad * DEGREES, _SIGNED, ROLL_DEG)
    return sentence(f"PRDID,{pitch},{roll},{heading(motion.yaw_rad, 'z06.2f')}")


FORMAT: Final = Format(title="PRDID", encode=encode, longest_bytes=34, lead=Lead.TRANSMISSION)
