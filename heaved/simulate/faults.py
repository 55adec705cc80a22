"""Faults that simulated devices commit, by schedule or on demand. Pure.

Text form, several with commas between them: ``DEVICE:KIND@START+DURATION`` or ``DEVICE:KIND@START+DURATION=AMOUNT``,
times in seconds from the start of the plant: ``laser:dropout@60+30,imu:late@10+5=120``.

======================  =======================================================================  ================
kind                    what the device does                                                     amount (default)
======================  =======================================================================  ================
``dropout``             does not answer                                                          none
``late``                answers late, perhaps after the next request                             ms (200)
``exception``           refuses with a Modbus exception                                          its code (4)
``frozen``              repeats the values of the first request under the fault                  none
``spike``               adds to its vertical acceleration (m/s2) or its distance (m)             m/s2 or m (5)
``disconnect``          its whole line goes: connections close, the port or pty is gone          none
``nan``                 float registers hold nan, integers stand at the end of their range       none
``garbage``             answers random bytes of the right length                                 none
======================  =======================================================================  ================
"""

from __future__ import annotations

import re
from enum import Enum

import msgspec


class FaultKind(Enum):
    """How a device misbehaves: see the table of this module."""

    DROPOUT = "dropout"
    LATE = "late"
    EXCEPTION = "exception"
    FROZEN = "frozen"
    SPIKE = "spike"
    DISCONNECT = "disconnect"
    NAN = "nan"
    GARBAGE = "garbage"


_DEFAULT_AMOUNT = {FaultKind.LATE: 200.0, FaultKind.EXCEPTION: 4.0, FaultKind.SPIKE: 5.0}
_ENTRY = re.compile(r"([A-Za-z0-9_.-]+):([a-z]+)@(\d+(?:\.\d+)?)\+(\d+(?:\.\d+)?)(?:=(-?\d+(?:\.\d+)?))?")


class PlannedFault(msgspec.Struct, frozen=True, kw_only=True):
    """One device misbehaves in one way from ``start_s`` for ``duration_s``, counted from the start of the plant."""

    device: str
    kind: FaultKind
    start_s: float
    duration_s: float
    amount: float = 0.0
    """Unit by kind: see the table of this module."""

    @property
    def end_s(self) -> float:
        """When it is over."""
        return self.start_s + self.duration_s

    def active(self, t_s: float) -> bool:
        """Whether it is going on."""
        return self.start_s <= t_s < self.end_s


def parse_faults(text: str) -> tuple[PlannedFault, ...]:
    """Read a plan in the text form above; an empty text is an empty plan.

    Raises:
        ValueError: names the entry that is wrong, and what it should be.
    """
    return tuple(_parse_entry(entry.strip()) for entry in text.split(",") if entry.strip())


def _parse_entry(entry: str) -> PlannedFault:
    match = _ENTRY.fullmatch(entry)
    if match is None:
        raise ValueError(
            f"fault {entry!r} is not understood: write DEVICE:KIND@START+DURATION[=AMOUNT] with times in seconds, "
            "such as laser:dropout@60+30 or imu:late@10+5=120"
        )
    device, word, start, duration, amount = match.groups()
    kinds = {kind.value: kind for kind in FaultKind}
    if word not in kinds:
        raise ValueError(f"fault {entry!r}: unknown kind {word!r}; choose one of {', '.join(kinds)}")
    kind = kinds[word]
    if amount is not None and kind not in _DEFAULT_AMOUNT:
        raise ValueError(f"fault {entry!r}: {word} takes no amount; drop '={amount}'")
    value = _DEFAULT_AMOUNT.get(kind, 0.0) if amount is None else float(amount)
    if kind is FaultKind.LATE and value < 0.0:
        raise ValueError(f"fault {entry!r}: an answer cannot come {-value:g} ms early; give 0 or more")
    if kind is FaultKind.EXCEPTION and (value != int(value) or not 1 <= value <= 255):
        raise ValueError(f"fault {entry!r}: a Modbus exception code is a whole number from 1 to 255, not {value:g}")
    return PlannedFault(device=device, kind=kind, start_s=float(start), duration_s=float(duration), amount=value)
