"""A line of which nothing is known: its settings and ids are found, and what is no answer is told for what it is."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest
from modbus_slaves import rtu, rtu_answer
from picky_slaves import PickySlave

from heaved.config.read import packaged_profiles
from heaved.devices.frames import Request
from heaved.links import SerialLink
from heaved.setup import scan as scanning
from heaved.setup.scan import ALL_IDS, SETTINGS, USUAL_IDS, Heard, Plan, judge, plan, scan, wait_s

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from heaved.links import Parity

NOBODY = (1, 2)
ASKED = rtu(bytes((7, 3, 0, 0, 0, 1)))


@pytest.fixture(autouse=True)
def quick_ears(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scanning, "LISTEN_S", 0.005)


def short(ids: tuple[int, ...], *settings: tuple[int, Parity], timeout_s: float = 0.06) -> Plan:
    return Plan((ids,), settings or ((9600, "N"), (115200, "N"), (19200, "O")), timeout_s)


def only(*ids: int) -> Callable[[bytes], bytes]:
    return lambda request: rtu_answer(request, [0x1234]) if request[0] in ids else b""


async def told(slave: PickySlave, asked: Plan) -> scanning.Scan:
    try:
        return await scan(slave.path, asked, lambda done, total, what: None)
    finally:
        slave.close()


@pytest.mark.parametrize(("baudrate", "odd", "parity"), [(9600, False, "N"), (115200, False, "N"), (19200, True, "O")])
async def test_the_setting_and_all_who_have_it_are_found(baudrate: int, odd: bool, parity: Parity) -> None:
    slave = PickySlave(baudrate, only(7, 80), odd=odd)
    found = await told(slave, short((80, 1, 7)))
    assert found == scanning.Scan(SerialLink(slave.path, baudrate, parity), (80, 7), ())


async def test_a_refusal_is_an_answer() -> None:
    slave = PickySlave(9600, lambda request: rtu(bytes((request[0], 0x83, 2))) if request[0] == 7 else b"")
    assert (await told(slave, short((7,)))).ids == (7,)


async def test_nothing_is_ever_written_but_reads_of_one_register() -> None:
    slave = PickySlave(2400, only(9))
    await told(slave, short((80, 1, 9)))
    frames = [slave.all_heard[i : i + 8] for i in range(0, len(slave.all_heard), 8)]
    assert frames
    assert {frame[1:6] for frame in frames} == {bytes((3, 0, 0, 0, 1))}


def choosy(request: bytes) -> bytes:
    """Ignores whatever it has not got: it has holding register 0x34 alone."""
    return rtu_answer(request, [7]) if request[:6] == bytes((80, 3, 0, 0x34, 0, 1)) else b""


async def test_a_device_that_ignores_what_it_has_not_got_is_found_by_what_the_profiles_have() -> None:
    asked = plan(None, 0.06, packaged_profiles())
    # A Baumer's and a WitMotion's among them, and not what everybody is asked for.
    assert {(4, 200), (3, 0x34)} <= set(asked.places)
    assert (3, 0) not in asked.places
    # Two of the usual ids are likely enough for more requests.
    assert asked.requests == (247 + 2 * len(asked.places)) * len(SETTINGS)
    slave = PickySlave(115200, choosy)
    few = Plan(((80, 81, 82),), ((9600, "N"), (115200, "N")), 0.06, asked.places)
    assert (await told(slave, few)).ids == (80,)
    assert [request[:6] for request in slave.requests if request[0] != 80] == [
        bytes((i, 3, 0, 0, 0, 1)) for i in (81, 82)
    ]
    assert few.requests == 2 * (3 + len(asked.places))


async def test_a_line_on_which_nobody_answers() -> None:
    progress: list[tuple[int, int]] = []
    slave = PickySlave(9600, lambda request: b"")
    try:
        found = await scan(slave.path, short(NOBODY), lambda done, total, what: progress.append((done, total)))
    finally:
        slave.close()
    assert found == scanning.Scan(None, (), ())
    assert progress == [(k, 6) for k in range(6)]


async def test_garbage_is_a_hint_whom_to_ask_first_and_is_told() -> None:
    order: list[int] = []

    def babble(data: bytes) -> bytes:
        order.append(data[0])
        return b"\xf1\xe0\x87" if data[0] == 5 else b""

    slave = PickySlave(2400, lambda request: b"", babble)
    found = await told(slave, short((1, 2, 5)))
    assert order[3] == order[6] == 5
    (note,) = found.notes
    assert "id 5 was asked at 9600 8N1 (f1 e0 87)" in note
    assert "something is there" in note
    # Once it is found, the garbage of the other settings was theirs, and is not spoken of.
    slave = PickySlave(115200, only(5), babble)
    assert (await told(slave, short((1, 2, 5)))).notes == ()


async def test_an_echo_is_no_answer_but_an_answer_after_it_is() -> None:
    slave = PickySlave(9600, lambda request: request, lambda data: data)
    found = await told(slave, short(NOBODY))
    assert found.link is None
    assert "hears its own requests" in found.notes[0]
    slave = PickySlave(
        115200, lambda request: request + (rtu_answer(request, [1]) if request[0] == 2 else b""), lambda data: data
    )
    found = await told(slave, short(NOBODY))
    assert found.link == SerialLink(slave.path, 115200)
    assert found.ids == (2,)


async def test_somebody_who_speaks_by_itself_is_named_with_what_it_says() -> None:
    slave = PickySlave(9600, lambda request: b"$HEHDT,123.4,T*2F\r\n")
    found = await told(slave, short(NOBODY))
    (note,) = found.notes
    assert 'speaks by itself at 9600 8N1 ("$HEHDT,123.4,T*2F")' in note
    assert "sentences" in note


async def test_bytes_that_come_unasked_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scanning, "LISTEN_S", 0.2)
    slave = PickySlave(9600, lambda request: b"")
    talking = asyncio.get_running_loop().call_later(0.05, slave.say, b"\x55\x51\x00\x10")
    found = await told(slave, short(NOBODY, (9600, "N")))
    talking.cancel()
    assert "bytes come unasked at 9600 8N1 (55 51 00 10)" in found.notes[0]


async def test_ctrl_c_ends_it_and_what_was_heard_is_told() -> None:
    slave = PickySlave(2400, lambda request: b"", lambda data: b"\xf0" if data[0] == 5 else b"")

    def progress(done: int, total: int, what: str) -> None:
        if done == 3:
            task.cancel()

    task = asyncio.create_task(scan(slave.path, short((5, 6, 7, 8)), progress))
    try:
        found = await task
    finally:
        slave.close()
    assert found.link is None
    assert "something is there" in found.notes[0]
    assert found.notes[1].startswith("cut short after 4 of 12 requests")


async def test_ctrl_c_does_not_lose_who_has_answered() -> None:
    slave = PickySlave(9600, only(5))

    def progress(done: int, total: int, what: str) -> None:
        if done == 2:
            task.cancel()

    task = asyncio.create_task(scan(slave.path, short((5, 6, 7, 8)), progress))
    try:
        found = await task
    finally:
        slave.close()
    assert found == scanning.Scan(SerialLink(slave.path, 9600), (5,), ())


async def test_a_port_that_vanishes() -> None:
    slave = PickySlave(9600, only(80))
    asyncio.get_running_loop().call_later(0.05, slave.unplug)
    with pytest.raises(ConnectionError, match="has gone while it was asked"):
        await scan(slave.path, short(tuple(range(2, 200))), lambda done, total, what: None)


async def test_a_port_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConnectionError, match="is not there: plug the adapter in"):
        await scan(str(tmp_path / "none"), short(NOBODY), lambda done, total, what: None)


HEARD = {
    "nothing": (b"", Heard.NOTHING),
    "the answer": (rtu_answer(ASKED, [5]), Heard.ANSWER),
    "noise and the answer": (b"\x00\xff" + rtu_answer(ASKED, [5]), Heard.ANSWER),
    "somebody else's answer": (rtu(bytes((9, 3, 4, 0, 1, 0, 2))), Heard.ANSWER),
    "a refusal": (rtu(bytes((7, 0x83, 2))), Heard.ANSWER),
    "the request": (ASKED, Heard.ECHO),
    "the request and a rest": (ASKED + b"\x80", Heard.GARBAGE),
    "an answer with a wrong checksum": (rtu_answer(ASKED, [5])[:-1] + b"\x00", Heard.GARBAGE),
    "a sentence": (b"\x00$GPGGA,1,2,3\r\n", Heard.SENTENCE),
}


@pytest.mark.parametrize("name", HEARD)
def test_what_came_is_known_for_what_it_is(name: str) -> None:
    heard, expected = HEARD[name]
    assert judge(heard, ASKED, Request(7, 3, 1)) is expected


def test_all_ids_and_settings_are_asked_the_usual_first_and_the_time_is_known() -> None:
    assert sorted(ALL_IDS) == list(range(1, 248))
    assert ALL_IDS[:2] == (80, 1)
    assert len(set(SETTINGS)) == len(SETTINGS)
    everything = plan(None, 0.1)
    assert everything.rounds == (USUAL_IDS, ALL_IDS[len(USUAL_IDS) :])
    assert everything.requests == 247 * len(SETTINGS)
    # 8 + 7 characters of 10 bits at 9600 baud.
    assert wait_s(SerialLink("", 9600), 0.1) == pytest.approx(0.1 + 150 / 9600)
    assert 247 * len(SETTINGS) * 0.1 < everything.bound_s() < 247 * len(SETTINGS) * 0.14
    assert everything.bound_s(1) < 0.1 * everything.bound_s()
    assert plan((3, 4), 0.1).rounds == ((3, 4),)
