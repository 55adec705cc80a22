"""``$--XDR``: heave, pitch and roll as transducers, for plotters and loggers that read NMEA 0183 (OpenCPN, Signal K).

    $IIXDR,D,h.hhh,M,HEAVE,A,p.pp,D,PTCH,A,r.rr,D,ROLL*CS

Heave as a displacement (up) in metres to 0.001, pitch (bow up) and roll (port side up) as angles in degrees to 0.01.
``talker`` stands before XDR, ``transducers`` names the three; OpenCPN knows PTCH and PITCH.

It tells no time and no quality. A transducer that is not known, or beyond 99 m, 90 degrees of pitch and 180 of roll, is
left out with all of its four fields: many readers take an empty number for 0. When none is known, **nothing is sent**.
A degraded heave is sent like a valid one, and so is one that settles, unless ``settling = "error"``.

With names so long that the three would go beyond the 82 characters of a sentence, each has one of its own.

Sources: NMEA 0183, XDR, as told in gpsd's "NMEA Revealed"; OpenCPN's reader (``xdr.cpp``) and its issue 5211.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from heaved.outputs.motion import Lead
from heaved.outputs.telegrams.known import DEGREES, tells_heave
from heaved.outputs.telegrams.nmea import HEAVE_M, LONGEST_BYTES, PITCH_DEG, ROLL_DEG, number, sentence
from heaved.outputs.telegrams.spec import TRANSDUCER_LETTERS, Format

if TYPE_CHECKING:
    from heaved.outputs.motion import Motion
    from heaved.outputs.telegrams.spec import OutputSpec

_FRAME: Final = len("$IIXDR*CS\r\n")
_GROUPS: Final = (len(",D,-99.000,M,"), len(",A,-90.00,D,"), len(",A,-180.00,D,"))
"""Longest groups, their names apart."""
_NAMES: Final = LONGEST_BYTES - _FRAME - sum(_GROUPS)
"""Letters that the three names may have together in one sentence."""


def encode(motion: Motion, spec: OutputSpec) -> bytes:
    """The sentence, or sentences, of a motion; empty when nothing is known."""
    heave_name, pitch_name, roll_name = spec.transducers
    groups = []
    if tells_heave(motion, spec) and (heave := number(motion.heave_m, "z.3f", HEAVE_M)):
        groups.append(f",D,{heave},M,{heave_name}")
    if pitch := number(motion.pitch_rad * DEGREES, "z.2f", PITCH_DEG):
        groups.append(f",A,{pitch},D,{pitch_name}")
    if roll := number(motion.roll_rad * DEGREES, "z.2f", ROLL_DEG):
        groups.append(f",A,{roll},D,{roll_name}")
    # By the names alone, so that a reader never sees the one kind and then the other.
    if len(heave_name) + len(pitch_name) + len(roll_name) <= _NAMES:
        groups = ["".join(groups)] if groups else []
    return b"".join([sentence(f"{spec.talker}XDR{group}") for group in groups])


FORMAT: Final = Format(
    title="XDR",
    encode=encode,
    longest_bytes=3 * (_FRAME + TRANSDUCER_LETTERS) + sum(_GROUPS),
    lead=Lead.TRANSMISSION,
    options=("talker", "transducers", "settling"),
)
