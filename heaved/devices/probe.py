"""Which sensor hangs on this line? Reads only, one request at a time, and compares what comes with known profiles.

The usual mistakes are tried too: addresses counted from one (shifted by one either way), holding for input registers,
and the other byte orders. What fits is judged by physics: the accelerations of a sensor that lies somewhere have the
size of gravity, a ship does not lie on her side, a distance is within a laser's reach.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from math import sqrt
from typing import Final, Protocol, get_args

import msgspec

from heaved.devices.answers import explain_exception
from heaved.devices.line import Link
from heaved.devices.modbus import Answer, Connection
from heaved.devices.profile import Block, ByteOrder, Field, Profile, Quantity, block_registers, decode
from heaved.devices.timer import DeadlineTimer
from heaved.samples import GRAVITY_MPS2, Fault

MOST_SHOWN: Final = 4
"""Findings printed for one device."""
SHIFTS: Final = (0, 1, -1)
FITS: Final = 0.7
"""Score from which a profile is worth naming."""
_ANYTHING: Final = Block(start=0, fields=(Field(quantity="signal", offset=0),))
"""One register: asked of an id to see whether there is anybody."""

_NOBODY: Final = (explain_exception(10), explain_exception(11))
"""A gateway's answer for an id behind which there is no device."""

Progress = Callable[[int], None]
"""Told the id that is being asked."""


class Reader(Protocol):
    """An open line; see :class:`heaved.devices.modbus.Connection`."""

    async def read(self, device_id: int, block: Block, count: int, timeout_s: float) -> Answer: ...


class Variant(msgspec.Struct, frozen=True, kw_only=True):
    """A profile as it stands, or with one of the usual mistakes undone."""

    profile: Profile
    shift: int = 0
    """Added to every address."""
    other_function: bool = False
    """Input registers for holding registers, and the other way round."""
    byte_order: ByteOrder | None = None
    """Of every field; None: the profile's own."""

    @property
    def changes(self) -> int:
        return (self.shift != 0) + self.other_function + (self.byte_order is not None)

    def describe(self) -> str:
        notes = [f"addresses {self.shift:+d}"] if self.shift else []
        notes += ["the other function (input/holding)"] if self.other_function else []
        notes += [f"byte order {self.byte_order}"] if self.byte_order is not None else []
        return self.profile.name + (f" with {', '.join(notes)}" if notes else "")


class Finding(msgspec.Struct, frozen=True, kw_only=True):
    """What a variant makes of the registers of a device."""

    variant: Variant
    score: float
    """0..1; see :func:`plausibility`."""
    values: dict[Quantity, float]
    registers: list[int]


def plausibility(values: Mapping[Quantity, float], registers: Sequence[int]) -> float:
    """How far ``values`` look like those of a sensor on a ship: 0 not at all, 1 entirely. Gravity weighs most."""
    if len(set(registers)) == 1 and len(registers) > 1:
        return 0.0  # All alike: memory that nothing is written to.
    marks: list[tuple[float, bool]] = []
    forces = [values[axis] for axis in ("ax_mps2", "ay_mps2", "az_mps2") if axis in values]
    if len(forces) == 3:
        marks.append((4.0, abs(sqrt(sum(force**2 for force in forces)) - GRAVITY_MPS2) < 1.5))
    elif forces:
        marks.append((2.0, any(abs(abs(force) - GRAVITY_MPS2) < 1.5 for force in forces)))
    marks += [(1.0, abs(values[angle]) < 0.8) for angle in ("roll_rad", "pitch_rad") if angle in values]
    marks += [(0.5, abs(values[rate]) < 1.0) for rate in ("gx_radps", "gy_radps", "gz_radps") if rate in values]
    if "laser_m" in values:
        marks.append((2.0, 0.02 < values["laser_m"] < 300.0))
    if "temperature_c" in values:
        marks.append((0.5, -40.0 < values["temperature_c"] < 90.0))
    total = sum(weight for weight, _ in marks)
    return sum(weight for weight, good in marks if good) / total if total else 0.0


def parse_ids(text: str) -> tuple[int, ...]:
    """``1-16,80`` as ids, each once, in order.

    Raises:
        ValueError: says what is wrong.
    """
    found: dict[int, None] = {}
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise ValueError(f"ids {text!r}: write numbers and ranges, such as 1-16,80")
        low, high = int(first), int(last or first)
        if not 1 <= low <= high <= 247:
            raise ValueError(f"ids {text!r}: {part.strip()!r} is not within 1-247, from low to high")
        found |= dict.fromkeys(range(low, high + 1))
    return tuple(found)


async def probe(
    link: Link, ids: Sequence[int], profiles: Sequence[Profile], timeout_s: float, progress: Progress
) -> list[str]:
    """Lines to print: each device that answers, and what fits it; empty when nobody answers.

    Raises:
        ConnectionError: the line cannot be opened; says why and what to do.
    """
    lines: list[str] = []
    with DeadlineTimer() as timer:
        connection = Connection(link, timer, time.monotonic, lambda: None)
        try:
            if failure := await connection.open():
                raise ConnectionError(failure)
            for device_id in await find_ids(connection, ids, timeout_s, progress):
                findings = await examine(connection, device_id, profiles, timeout_s)
                lines += _device_lines(device_id, findings)
        finally:
            connection.close()
    return lines


def _device_lines(device_id: int, findings: Sequence[Finding]) -> Iterator[str]:
    yield f"id {device_id}: " + ("answers, but no known profile fits" if not findings else "fits")
    for finding in findings[:MOST_SHOWN]:
        yield f"  {finding.score:4.0%}  {finding.variant.describe()}"
        yield "        " + ", ".join(f"{quantity} {value:.4g}" for quantity, value in finding.values.items())
        yield "        registers " + " ".join(f"{register:04X}" for register in finding.registers)


async def find_ids(line: Reader, ids: Sequence[int], timeout_s: float, progress: Progress) -> list[int]:
    """The ids that answer at all; an exception is an answer too."""
    found = []
    for device_id in ids:
        progress(device_id)
        answer = await line.read(device_id, _ANYTHING, 1, timeout_s)
        if answer.answered and answer.detail not in _NOBODY:
            found.append(device_id)
    return found


async def examine(line: Reader, device_id: int, profiles: Sequence[Profile], timeout_s: float) -> list[Finding]:
    """What fits the device, best first: the least changed profile comes before its variants, the richer before the
    poorer."""
    cache: dict[tuple[str, int, int], Answer] = {}
    findings: dict[tuple[object, ...], Finding] = {}
    for variant in _variants(profiles):
        finding = await _try(line, device_id, variant, timeout_s, cache)
        if finding is not None and finding.score >= FITS:
            # Variants that read the same values from the same registers say nothing new.
            findings.setdefault((variant.profile.name, variant.shift, *finding.values.values()), finding)
    return sorted(
        findings.values(), key=lambda finding: (-finding.score, finding.variant.changes, -len(finding.values))
    )


def _variants(profiles: Sequence[Profile]) -> Iterator[Variant]:
    orders: tuple[ByteOrder, ...] = get_args(ByteOrder)
    for profile in profiles:
        own = {field.byte_order for block in profile.blocks for field in block.fields}
        for shift in SHIFTS:
            if any(not 0 <= block.start + shift <= 65536 - block_registers(block) for block in profile.blocks):
                continue
            for other_function in (False, True):
                for order in (None, *(order for order in orders if own != {order})):
                    yield Variant(profile=profile, shift=shift, other_function=other_function, byte_order=order)


async def _try(
    line: Reader,
    device_id: int,
    variant: Variant,
    timeout_s: float,
    cache: dict[tuple[str, int, int], Answer],
) -> Finding | None:
    values: dict[Quantity, float] = {}
    registers: list[int] = []
    for block in variant.profile.blocks:
        asked = _changed(block, variant)
        key = (asked.function, asked.start, block_registers(asked))
        if key not in cache:
            cache[key] = await line.read(device_id, asked, key[2], timeout_s)
            if not cache[key].answered:
                await asyncio.sleep(timeout_s)  # A late answer must not be taken for the next.
        if cache[key].fault is not Fault.NONE:
            return None
        decoded = decode(asked, cache[key].registers)
        if decoded.fault is not Fault.NONE:
            return None
        values |= decoded.values
        registers += cache[key].registers
    return Finding(variant=variant, score=plausibility(values, registers), values=values, registers=registers)


def _changed(block: Block, variant: Variant) -> Block:
    is_holding = (block.function == "holding") is not variant.other_function
    fields = block.fields
    if variant.byte_order is not None:
        fields = tuple(msgspec.structs.replace(field, byte_order=variant.byte_order) for field in fields)
    return Block(
        function="holding" if is_holding else "input",
        start=block.start + variant.shift,
        fields=fields,
    )
