"""Readers of sentences: pynmea2, and one of our own for NMEA 0183 as such and for the sentences of Norwegian Subsea.

The fields of PNORSUB2 and PNORSUB7B are in the order of the tables of support.norwegian-subsea.no (NORSUB2, NORSUB7b),
the bits of the status those of its table "Health monitoring system". (pynmea2 takes PNORSUB2 for one of Nortek's.)
"""

from __future__ import annotations

import re
from typing import Any, Final

import pynmea2

_FRAME: Final = re.compile(rb"\$([A-Z][A-Z0-9]*)((?:,[ -)+-~]*)?)\*([0-9A-F]{2})\r\n")

PNORSUB: Final = {
    "PNORSUB2": "T1 T2 roll pitch heading heave heave_vel status",
    "PNORSUB7B": (
        "T1 T2 roll pitch heading surge sway heave roll_rate pitch_rate yaw_rate surge_vel sway_vel heave_vel "
        "acc_x acc_y acc_z T_x T_y T_z A_x A_y A_z status_A status_B"
    ),
}
HEALTH: Final = {
    0: "MAIN_OK",
    1: "MAIN_HEALTH",
    2: "SYSTEM_OK",
    3: "SYSTEM_HEALTH",
    4: "SYSTEM_TIME_SYNC",
    5: "SYSTEM_CLOCK_SYNC",
    6: "SYSTEM_CPU_OK",
    7: "SENSOR_OK",
    8: "SENSOR_HEALTH",
    9: "SENSOR_LIMITS",
    10: "ENV_VIBRATION",
    11: "ENV_TEMPERATURE",
    12: "ALG_OK",
    13: "ALG_HEALTH",
    14: "ALG_OBS_INIT",
    15: "ALG_HEADING_INIT",
    16: "ALG_ROLLP_OK",
    17: "ALG_ROLLP_HEALTH",
    18: "ALG_HEAD_OK",
    19: "ALG_HEAD_HEALTH",
    20: "ALG_SURGES_OK",
    21: "ALG_SURGES_HEALTH",
    22: "ALG_HEAVE_OK",
    23: "ALG_HEAVE_HEALTH",
    24: "AID_POS_RECEIVED",
    25: "AID_VEL_RECEIVED",
    26: "AID_HEAD_RECEIVED",
    27: "AID_POS_VALID",
    28: "AID_VEL_VALID",
    29: "AID_HEAD_VALID",
    30: "AID_VERTICAL_VALID",
    31: "AID_HORIZONTAL_VALID",
}


def split(data: bytes) -> list[list[str]]:
    """The fields of each sentence, its address first.

    Raises:
        AssertionError: it is not whole sentences of printable ASCII, each with the checksum of what it says.
    """
    sentences = []
    at = 0
    while at < len(data):
        found = _FRAME.match(data, at)
        assert found, data[at:]
        ones = [sum(letter >> bit & 1 for letter in found[1] + found[2]) for bit in range(8)]
        assert int(found[3], 16) == sum((count % 2) << bit for bit, count in enumerate(ones)), data[at:]
        sentences.append((found[1] + found[2]).decode("ascii").split(","))
        at = found.end()
    return sentences


def by_pynmea2(data: bytes) -> list[Any]:
    """Each sentence as pynmea2 reads it.

    Raises:
        pynmea2.ParseError: it does not take it, or its checksum is wrong.
    """
    return [pynmea2.parse(line, check=True) for line in data.decode("ascii").splitlines()]


def only(data: bytes) -> list[str]:
    """The fields of the one sentence that it is."""
    (fields,) = split(data)
    return fields


def pnorsub(data: bytes) -> dict[str, str]:
    """The fields of a sentence of Norwegian Subsea by their names."""
    address, *fields = only(data)
    return dict(zip(PNORSUB[address].split(), fields, strict=True))


def health(fields: dict[str, str]) -> set[str]:
    """What the status of PNORSUB7B says is so."""
    low, high = int(fields["status_A"]), int(fields["status_B"])
    assert 0 <= low < 2**16
    assert 0 <= high < 2**16
    return {name for bit, name in HEALTH.items() if (low + high * 2**16) >> bit & 1}
