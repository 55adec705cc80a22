"""A device that nobody knows: its registers are found, those that move told, and gravity known for what it is."""

from __future__ import annotations

import random
import struct
from math import nan
from typing import TYPE_CHECKING

import pytest

from heaved.devices.bus import Answer
from heaved.devices.frames import explain_exception
from heaved.devices.profile import Block, decode, profile_faults
from heaved.samples import Fault
from heaved.setup import survey as surveying
from heaved.setup.survey import Seen, Survey, float32, guess, notes, skeleton, survey

if TYPE_CHECKING:
    from collections.abc import Callable


class Memory:
    """A device whose holding registers ``row`` gives at each read, from ``start`` on."""

    def __init__(self, start: int, row: Callable[[], list[int]], *, mute: bool = False) -> None:
        self._start, self._row, self._mute = start, row, mute
        self.asked: list[tuple[str, int, int]] = []

    async def read(self, device_id: int, block: Block, count: int, timeout_s: float) -> Answer:
        self.asked.append((block.function, block.start, count))
        row, first = self._row(), block.start - self._start
        if block.function == "holding" and first >= 0 and first + count <= len(row):
            return Answer(0.0, row[first : first + count])
        if self._mute:
            return Answer(0.0, [], Fault.TIMEOUT, "no answer", False)
        code = 2 if block.function == "holding" else 1
        return Answer(nan, [], Fault.EXCEPTION, explain_exception(code), exception=code)


@pytest.fixture(autouse=True)
def without_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surveying, "PAUSE_S", 0.0)


async def look(memory: Memory, last: int = 63) -> Survey:
    return await survey(memory, 5, 0.0, lambda what: None, first=0, last=last)


def noisy(chance: random.Random, means: tuple[float, ...], scatter: float) -> list[float]:
    return [chance.gauss(mean, scatter) for mean in means]


@pytest.mark.parametrize(
    ("gravity", "unit", "scale"),
    [(2048, "g", 16 / 32768), (16384, "g", 2 / 32768), (1000, "g", 1e-3), (981, "m/s2", 0.01), (9807, "m/s2", 0.001)],
)
async def test_integers_as_long_as_gravity_become_a_profile(gravity: int, unit: str, scale: float) -> None:
    chance = random.Random(gravity)
    tilt = (0.1 * gravity, -0.05 * gravity, -0.9937 * gravity)
    memory = Memory(10, lambda: [7, *(round(x) & 0xFFFF for x in noisy(chance, tilt, 0.003 * gravity)), 5])
    found = await look(memory)
    assert [one.address for one in found.seen] == [10, 11, 12, 13, 14]
    assert [one.address for one in found.seen if one.moves] == [11, 12, 13]
    profile = skeleton(found, "unknown")
    assert profile is not None
    assert profile_faults(profile) == []
    (block,) = profile.blocks
    assert (block.start, block.fields[2].unit, block.fields[2].scale) == (11, unit, scale)
    values = decode(block, [round(x) & 0xFFFF for x in tilt]).values
    # Turned over, so that at rest z is up.
    assert values["az_mps2"] == pytest.approx(0.9937 * 9.80665, rel=0.01)
    assert values["ax_mps2"] == pytest.approx(0.1 * 9.80665, rel=0.02)
    assert any("likely the accelerations" in note for note in notes(found))


@pytest.mark.parametrize(("order", "swap"), [("ABCD", False), ("CDAB", True)])
async def test_floating_point_numbers_as_long_as_gravity_are_found_in_their_byte_order(order: str, swap: bool) -> None:
    chance = random.Random(3)

    def row() -> list[int]:
        words: list[int] = []
        for value in noisy(chance, (0.3, -0.2, 9.79), 0.02):
            pair = struct.unpack(">HH", struct.pack(">f", value))
            words += reversed(pair) if swap else pair
        return words

    found = await look(Memory(32, row))
    assert found.guess is not None
    assert (found.guess.address, found.guess.byte_order, found.guess.unit) == (32, order, "m/s2")


async def test_memory_and_random_numbers_are_no_gravity() -> None:
    chance = random.Random(4)
    for row in (lambda: [2048, 5, 7], lambda: [chance.randrange(65536) for _ in range(20)]):
        found = await look(Memory(0, row))
        assert found.guess is None
        assert skeleton(found, "x") is None
        assert list(notes(found))[-1].startswith("none of it looks like gravity")
    assert "none of them moves" in list(notes(await look(Memory(0, lambda: [1, 2]))))[1]


async def test_what_is_not_there_is_asked_for_once_where_nobody_answers() -> None:
    memory = Memory(16, lambda: [1] * 16, mute=True)
    found = await look(memory)
    assert [one.address for one in found.seen] == list(range(16, 32))
    assert found.mute
    assert any("no answer at all" in note for note in notes(found))
    assert memory.asked[: 2 * 64 // 16] == [
        (function, start, 16) for function in ("holding", "input") for start in range(0, 64, 16)
    ]
    assert list(notes(Survey((), None, True))) == [
        "no register between those asked for can be read: some requests got no answer"
    ]


def test_a_row_that_is_on_its_side_has_its_z_where_gravity_is() -> None:
    columns = [[2040 + k % 5 for k in range(12)], [10 + k % 3 for k in range(12)], [k % 4 for k in range(12)]]
    seen = tuple(Seen("holding", 52 + i, tuple(column)) for i, column in enumerate(columns))
    found = guess(seen)
    profile = skeleton(Survey(seen, found), "x")
    assert profile is not None
    assert [field.quantity for field in profile.blocks[0].fields] == ["az_mps2", "ax_mps2", "ay_mps2"]


def test_floating_point_numbers_by_byte_order() -> None:
    # From a maker's manual: 7C37 428B is 69.743, low word first.
    assert float32(0x7C37, 0x428B, "CDAB") == pytest.approx(69.743, abs=5e-4)
    assert float32(0x428B, 0x7C37, "ABCD") == pytest.approx(69.743, abs=5e-4)
    assert float32(0x377C, 0x8B42, "DCBA") == pytest.approx(69.743, abs=5e-4)
    assert float32(0x8B42, 0x377C, "BADC") == pytest.approx(69.743, abs=5e-4)
