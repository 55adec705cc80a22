"""Readers of the telegrams for which none is packaged, written from the makers' descriptions, as a reader is.

What a telegram says is not known, by its status or by a value outside the range that the maker gives, is None.
"""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Tss1:
    """Teledyne TSS: 27 characters; capital letters settled, lower case settling, ``?`` heave bad."""

    letter: str
    level_mps2: float | None
    up_mps2: float | None
    heave_m: float | None
    roll_deg: float | None
    pitch_deg: float | None


_TSS1 = re.compile(
    rb":(?P<level>[0-9A-F]{2})(?P<up>[0-9A-F]{4}) (?P<heave>[ -]\d{4})(?P<letter>[UuGgHhFf?])"
    rb"(?P<roll>[ -]\d{4}) (?P<pitch>[ -]\d{4})\r\n"
)


def parse_tss1(telegram: bytes) -> Tss1:
    """Raises:
    ValueError: it is no such telegram.
    """
    if (match := _TSS1.fullmatch(telegram)) is None:
        raise ValueError(telegram)
    heave_m, roll_deg, pitch_deg = (int(match[name]) / 100.0 for name in ("heave", "roll", "pitch"))
    up = int.from_bytes(bytes.fromhex(match["up"].decode()), "big", signed=True)
    return Tss1(
        letter=match["letter"].decode(),
        level_mps2=None if match["level"] == b"FF" else 3.83e-2 * int(match["level"], 16),
        up_mps2=None if up == -32768 else 6.25e-4 * up,
        heave_m=heave_m if abs(heave_m) < 99.99 else None,
        roll_deg=roll_deg if abs(roll_deg) <= 90.0 else None,
        pitch_deg=pitch_deg if abs(pitch_deg) <= 90.0 else None,
    )


@dataclass(frozen=True)
class Em:
    """Kongsberg EM Attitude: 10 bytes; a value outside its range is rejected."""

    status: int
    roll_deg: float | None
    pitch_deg: float | None
    heave_m: float | None
    heading_deg: float | None


def parse_em(telegram: bytes) -> Em:
    """Raises:
    ValueError: it is no such telegram.
    """
    if len(telegram) != 10 or telegram[1] != 0x90 or not (telegram[0] == 0 or 0x90 <= telegram[0] <= 0xAF):
        raise ValueError(telegram)

    def word(at: int) -> int:
        return telegram[at] + 256 * telegram[at + 1]

    def signed(at: int, most: int) -> float | None:
        number = word(at) if word(at) < 0x8000 else word(at) - 0x10000
        return number / 100.0 if abs(number) <= most else None

    return Em(
        status=telegram[0],
        roll_deg=signed(2, 17999),
        pitch_deg=signed(4, 17999),
        heave_m=signed(6, 999),
        heading_deg=word(8) / 100.0 if word(8) <= 35999 else None,
    )


@dataclass(frozen=True)
class SmcHex:
    """SMC's hexadecimal heave for drives: mm, mm/s and mm/s2, -32767 to 32766. What it says is known."""

    heave_m: float
    velocity_mps: float
    acceleration_mps2: float


def parse_smc_hex(telegram: bytes) -> SmcHex:
    """Raises:
    ValueError: it is no such telegram, or tells what no sensor may.
    """
    text = telegram.decode("ascii")
    if len(text) != 18 or not text.startswith("$SMC") or not text.endswith("\r\n") or text != text.upper():
        raise ValueError(telegram)
    numbers = [int(text[at : at + 4], 16) for at in (4, 8, 12)]
    signed = [number - 65536 if number >> 15 else number for number in numbers]
    if min(signed) < -32767 or max(signed) > 32766:
        raise ValueError(telegram)
    heave_mm, velocity_mmps, acceleration_mmps2 = signed
    return SmcHex(heave_mm / 1000.0, velocity_mmps / 1000.0, acceleration_mmps2 / 1000.0)
