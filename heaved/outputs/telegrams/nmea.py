"""What the sentences have in common: frame and checksum, and how a number, a heading and a time are written. Pure.

A field whose number is not known, or has no place in it, is empty, as NMEA 0183 has it: never zero, and never so long
that the ones after it move. The signs that the modules of the sentences name are the usual ones of each; an encoder is
given a motion that is turned already to those of its reader.
"""

from __future__ import annotations

from functools import reduce
from math import isfinite
from operator import xor
from typing import Final

from heaved.outputs.telegrams.known import heading_deg

LONGEST_BYTES: Final = 82
"""Of a sentence, from ``$`` to the line feed (NMEA 0183, section 5.3)."""
ROLL_DEG: Final = 180.0
"""Largest angle of its kind, here and below; what is beyond is no angle of a vessel."""
PITCH_DEG: Final = 90.0
HEAVE_M: Final = 99.0
"""Largest heave and, in m/s, velocity of it that is told: two digits before the point."""
RATE_DEGPS: Final = 999.0
_DAY_MS: Final = 86_400_000
LAST_UTC_S: Final = 253_402_300_800.0
"""End of the year 9999."""


def sentence(body: str) -> bytes:
    """The sentence of what stands between its ``$`` and its ``*``: with its checksum and the end of the line."""
    return b"$%b*%02X\r\n" % (text := body.encode("ascii"), checksum(text))


def checksum(text: bytes) -> int:
    """Exclusive or of all that stands between ``$`` and ``*``."""
    return reduce(xor, text, 0)


def number(value: float, form: str, largest: float) -> str:
    """A number as ``form`` writes it; empty when it is not known or larger either way than ``largest``.

    ``form`` is Python's, with its ``z``: what is rounded to nothing has no minus before it.
    """
    return format(value, form) if -largest <= value <= largest else ""


def heading(yaw_rad: float, form: str) -> str:
    """A compass angle in degrees, from 0 up to but not including 360, as ``form`` writes it; empty: not known."""
    yaw_deg = heading_deg(yaw_rad)
    if not isfinite(yaw_deg):
        return ""
    text = format(yaw_deg, form)
    return format(0.0, form) if text.startswith("360") else text  # Rounded up, it has come full circle.


def time_of_day(utc_s: float) -> str:
    """``hhmmss.sss``, rounded as a whole: the last half millisecond of a minute, or of a day, is of the next one."""
    if not 0.0 <= utc_s < LAST_UTC_S:
        return ""
    seconds, ms = divmod(round(utc_s * 1e3) % _DAY_MS, 1000)
    minutes, second = divmod(seconds, 60)
    hour, minute = divmod(minutes, 60)
    return f"{hour:02d}{minute:02d}{second:02d}.{ms:03d}"
