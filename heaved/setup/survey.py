"""A device that no profile knows: which registers it has, which of them move, and what they could be.

Says what was seen, and guesses only at gravity: three neighbours that all move while the length of the vector that they
make stays, or a floating-point number of the right size.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from math import isfinite, sqrt
from statistics import fmean, pstdev
from typing import TYPE_CHECKING, Final, Literal, get_args

import msgspec

from heaved.devices.profile import Block, ByteOrder, Field, Profile, Quantity, RegisterType, Unit
from heaved.samples import GRAVITY_MPS2, Fault

if TYPE_CHECKING:
    from heaved.devices.probe import Reader

Function = Literal["holding", "input"]
FIRST, LAST = 0, 255
"""Registers that are looked for where nobody says which."""
CHUNK: Final = 16
"""Registers asked for at once; a refusal is halved until it is known which."""
READS: Final = 12
PAUSE_S: Final = 0.1
"""Between the reads of all that are there."""
_SHOWN: Final = 40
"""Registers listed."""

GRAVITIES: Final[tuple[tuple[float, float, Unit, str], ...]] = (
    (2048.0, 16.0 / 32768.0, "g", "16 g / 32768"),
    (4096.0, 8.0 / 32768.0, "g", "8 g / 32768"),
    (8192.0, 4.0 / 32768.0, "g", "4 g / 32768"),
    (16384.0, 2.0 / 32768.0, "g", "2 g / 32768"),
    (1000.0, 1e-3, "g", "0.001 g"),
    (981.0, 1e-2, "m/s2", "0.01 m/s2"),
    (9807.0, 1e-3, "m/s2", "0.001 m/s2"),
)
"""What a register shows of gravity at rest, its scale, unit, and the scale in words."""
FLOAT_GRAVITIES: Final[tuple[tuple[float, float, Unit], ...]] = (
    (GRAVITY_MPS2, 1.0, "m/s2"),
    (1.0, 1.0, "g"),
    (1000.0, 1e-3, "g"),
)
_CLOSE: Final = 0.04
"""Relative, of gravity: offset and scale of a cheap sensor, and the waves."""
_STEADY: Final = 0.02
"""Relative scatter of the length of the vector."""

Progress = Callable[[str], None]


class Seen(msgspec.Struct, frozen=True):
    """One register, as often as it was read."""

    function: Function
    address: int
    raw: tuple[int, ...]

    @property
    def moves(self) -> bool:
        """It has not always said the same."""
        return len(set(self.raw)) > 1


class Guess(msgspec.Struct, frozen=True, kw_only=True):
    """Three values that could be the accelerations."""

    function: Function
    address: int
    """Of the first."""
    type: RegisterType
    byte_order: ByteOrder = "ABCD"
    scale: float
    unit: Unit
    told: str
    means: tuple[float, ...]
    """Of each of the three, in registers' own numbers."""

    @property
    def registers(self) -> int:
        """Of one value."""
        return 1 if self.type in ("int16", "uint16") else 2


class Survey(msgspec.Struct, frozen=True):
    """What a device without a profile shows."""

    seen: tuple[Seen, ...]
    guess: Guess | None
    mute: bool = False
    """Requests for what is not there were not refused but ignored: there may be more."""


async def survey(
    line: Reader, device_id: int, timeout_s: float, progress: Progress, *, first: int = FIRST, last: int = LAST
) -> Survey:
    """Look for the registers ``first`` to ``last``, input and holding, and at what they do for a second or two.

    Raises:
        ConnectionError: the line is lost.
    """
    found: dict[tuple[Function, int], list[int]] = {}
    mute = False
    functions: tuple[Function, ...] = get_args(Function)
    for function in functions:
        for start in range(first, last + 1, CHUNK):
            progress(f"id {device_id}: {function} registers from {start}")
            count = min(CHUNK, last + 1 - start)
            mute |= await _look(line, device_id, function, start, count, timeout_s, found)
    for _ in range(READS):
        await asyncio.sleep(PAUSE_S)
        row: dict[tuple[Function, int], int] = {}
        for function, start, count in _runs(found):
            answer = await line.read(device_id, _block(function, start, count), count, timeout_s)
            row.update(((function, start + i), word) for i, word in enumerate(answer.registers))
        if row.keys() == found.keys():  # Of all of them, or of none: they are held against each other.
            for place, word in row.items():
                found[place].append(word)
    seen = tuple(Seen(function, address, tuple(raw)) for (function, address), raw in sorted(found.items()))
    return Survey(seen, guess(seen), mute)


async def _look(
    line: Reader,
    device_id: int,
    function: Function,
    start: int,
    count: int,
    timeout_s: float,
    found: dict[tuple[Function, int], list[int]],
) -> bool:
    """Note those of ``count`` registers that can be read. Returns whether some request was not answered at all."""
    answer = await line.read(device_id, _block(function, start, count), count, timeout_s)
    if answer.fault is Fault.NONE:
        found.update(((function, start + i), [word]) for i, word in enumerate(answer.registers))
        return False
    if not answer.answered:
        await asyncio.sleep(timeout_s)  # It may be late, and would be taken for the next one.
        return True
    if count == 1 or answer.exception == 1:  # Illegal function: none of them can.
        return False
    half = count // 2
    mute = await _look(line, device_id, function, start, half, timeout_s, found)
    return await _look(line, device_id, function, start + half, count - half, timeout_s, found) or mute


def _block(function: Function, start: int, count: int) -> Block:
    return Block(function=function, start=start, fields=(Field(quantity="signal", offset=count - 1),))


def _runs(found: Mapping[tuple[Function, int], object]) -> list[tuple[Function, int, int]]:
    """Neighbours that are read at once: function, first, number."""
    runs: list[tuple[Function, int, int]] = []
    for function, address in sorted(found):
        if runs and runs[-1][0] == function and runs[-1][1] + runs[-1][2] == address and runs[-1][2] < CHUNK:
            runs[-1] = (function, runs[-1][1], runs[-1][2] + 1)
        else:
            runs.append((function, address, 1))
    return runs


# ---- what they could be ----------------------------------------------------------------------------------------------


def guess(seen: Sequence[Seen]) -> Guess | None:
    """Where the accelerations could be; None: nothing looks like gravity."""
    by_place = {(one.function, one.address): one for one in seen}
    for one in seen:
        words = [by_place.get((one.function, one.address + i)) for i in range(6)]
        if (found := _integers(words[:3])) or (found := _floats(words)):
            return found
    return None


def _integers(words: Sequence[Seen | None]) -> Guess | None:
    columns = [[signed_word(word) for word in one.raw] for one in words if one is not None]
    first = words[0]
    if first is None or len(columns) < 3 or not all(one is not None and one.moves for one in words):
        return None
    length = _steady_length(columns)
    for gravity, scale, unit, told in sorted(GRAVITIES, key=lambda known: abs(length - known[0])):
        if abs(length - gravity) < _CLOSE * gravity:
            return Guess(
                function=first.function, address=first.address, type="int16", scale=scale, unit=unit, told=told,
                means=tuple(map(fmean, columns)),
            )  # fmt: skip
    return None


def _floats(words: Sequence[Seen | None]) -> Guess | None:
    known = [one for one in words if one is not None]
    if len(known) < 6:
        return None
    orders: tuple[ByteOrder, ...] = get_args(ByteOrder)
    for order in orders:
        columns = [
            [float32(high, low, order) for high, low in zip(known[i].raw, known[i + 1].raw, strict=True)]
            for i in (0, 2, 4)
        ]
        if not all(isfinite(value) for column in columns for value in column):
            continue
        if not all(len(set(column)) > 1 for column in columns):
            continue
        length = _steady_length(columns)
        for gravity, scale, unit in FLOAT_GRAVITIES:
            if abs(length - gravity) < _CLOSE * gravity:
                return Guess(
                    function=known[0].function, address=known[0].address, type="float32", byte_order=order,
                    scale=scale, unit=unit, told=f"{unit}, as it is" if scale == 1.0 else "0.001 g",
                    means=tuple(map(fmean, columns)),
                )  # fmt: skip
    return None


def _steady_length(columns: Sequence[Sequence[float]]) -> float:
    """Of the vector that the three columns make; 0: it does not stay."""
    lengths = [sqrt(sum(value * value for value in row)) for row in zip(*columns, strict=True)]
    mean = fmean(lengths)
    return mean if pstdev(lengths) < _STEADY * mean else 0.0


def signed_word(word: int) -> int:
    """A register as a number that may be negative."""
    return word - 0x10000 if word & 0x8000 else word


def float32(first: int, second: int, order: ByteOrder) -> float:
    """Two registers as they stand on the line, read in a byte order."""
    data = struct.pack(">HH", first, second)
    a, b, c, d = (data["ABCD".index(letter)] for letter in order)
    return float(struct.unpack(">f", bytes((a, b, c, d)))[0])


# ---- what is written -------------------------------------------------------------------------------------------------


def skeleton(found: Survey, name: str) -> Profile | None:
    """A profile with the accelerations as they were guessed; None: there is nothing to begin with.

    The axis with gravity on it is z; whether it points up shows its sign. Which of the others is x is not known.
    """
    at = found.guess
    if at is None:
        return None
    upright = max(range(3), key=lambda i: abs(at.means[i]))
    others: list[Quantity] = ["ax_mps2", "ay_mps2"]
    fields = [
        Field(
            quantity="az_mps2" if i == upright else others.pop(0),
            offset=i * at.registers,
            type=at.type,
            byte_order=at.byte_order,
            scale=at.scale,
            unit=at.unit,
            sign=-1 if i == upright and at.means[i] < 0.0 else 1,
        )
        for i in range(3)
    ]
    description = "guessed by heaved probe from gravity: check axes and signs"
    blocks = (Block(function=at.function, start=at.address, fields=tuple(fields)),)
    return Profile(name=name, description=description, blocks=blocks)


def notes(found: Survey) -> Iterator[str]:
    """What was seen of the registers, for people: beside the skeleton of a profile, or in place of one."""
    if not found.seen:
        yield "no register between those asked for can be read" + (
            ": some requests got no answer" if found.mute else ""
        )
        return
    moving = [one for one in found.seen if one.moves]
    for function, spans in _spans(found.seen).items():
        yield f"{function} registers that can be read: {', '.join(spans)}"
    if found.mute:
        yield "some requests got no answer at all: there may be more"
    if not moving:
        yield "none of them moves: it may be memory, or a sensor that stands; move it and look with --live"
    for one in moving[:_SHOWN]:
        yield _seen_line(one)
    if len(moving) > _SHOWN:
        yield f"and {len(moving) - _SHOWN} more that move"
    yield from _float_lines(found.seen)
    if found.guess is not None:
        at = found.guess
        order = f", byte order {at.byte_order}" if at.type == "float32" else ""
        yield (
            f"{at.function} 0x{at.address:02X}: three {at.type}{order} as long as gravity at a scale of "
            f"{at.told}: likely the accelerations. Which is x, which y, and their signs: lift a side and look at --live"
        )
    else:
        yield "none of it looks like gravity: a profile needs its manual (see the end of heaved.toml)"


def _seen_line(one: Seen) -> str:
    low, high = min(one.raw), max(one.raw)
    signed = [signed_word(word) for word in one.raw]
    as_signed = f" (as int16 {min(signed)} to {max(signed)})" if high & 0x8000 else ""
    return f"{one.function} 0x{one.address:02X} moves: {low} to {high}{as_signed}"


def _float_lines(seen: Sequence[Seen]) -> Iterator[str]:
    """Pairs that would be a floating-point number of everyday size, near to itself at each reading."""
    orders: tuple[ByteOrder, ...] = get_args(ByteOrder)
    shown = 0
    for one, next_ in pairwise(seen):
        together = one.function == next_.function and one.address + 1 == next_.address
        if not together or not (one.moves or next_.moves) or shown == _SHOWN // 4:
            continue
        for order in orders:
            values = [float32(high, low, order) for high, low in zip(one.raw, next_.raw, strict=True)]
            if all(isfinite(value) and 1e-3 < abs(value) < 1e6 for value in values):
                scatter = pstdev(values)
                if 0.0 < scatter < 0.2 * abs(fmean(values)):
                    yield (
                        f"{one.function} 0x{one.address:02X} as float32 {order}: {min(values):.6g} to {max(values):.6g}"
                    )
                    shown += 1


def _spans(seen: Sequence[Seen]) -> dict[str, list[str]]:
    spans: dict[str, list[str]] = {}
    for function, start, count in _merged(seen):
        text = f"0x{start:02X}" + (f"..0x{start + count - 1:02X}" if count > 1 else "")
        spans.setdefault(function, []).append(text)
    return spans


def _merged(seen: Sequence[Seen]) -> list[tuple[Function, int, int]]:
    merged: list[tuple[Function, int, int]] = []
    for one in seen:
        if merged and merged[-1][0] == one.function and sum(merged[-1][1:]) == one.address:
            merged[-1] = (one.function, merged[-1][1], merged[-1][2] + 1)
        else:
            merged.append((one.function, one.address, 1))
    return merged
