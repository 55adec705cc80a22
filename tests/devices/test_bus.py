"""The bus against raw slaves: what may go wrong on a line, and what must come of it."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import itertools
import logging
import random
import resource
import socket
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import serial
from modbus_slaves import (
    Results,
    RtuSlave,
    TcpSlave,
    count_of,
    counter_profile,
    device,
    mbap_answer,
    rtu,
    rtu_answer,
    running,
    tcp_answer,
)
from waiting import holds

from heaved.daemon.supervise import cancelled
from heaved.devices import bus as modbus
from heaved.devices.bus import CONNECT_TIMEOUT_S, RETRY_S, Bus, OpenLink, PollResult
from heaved.devices.frames import find_tcp_answer
from heaved.devices.liveness import PROBE_S
from heaved.devices.profile import Block, Field, Profile
from heaved.host_name import HostName
from heaved.samples import Fault, ImuSample, LaserSample

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.links import SerialLink


def well(result: object) -> bool:
    return result.fault is Fault.NONE  # type: ignore[attr-defined]


class CountingSlave:
    """Answers every register with the number of the request, so that the age of an answer shows in its value."""

    def __init__(self) -> None:
        self.requests = 0

    def __call__(self, request: bytes) -> bytes:
        self.requests += 1
        return rtu_answer(request, [self.requests] * count_of(request))


# ---- the everyday ----------------------------------------------------------------------------------------------------


async def test_rtu_poll_gives_samples_with_times() -> None:
    slave = RtuSlave(CountingSlave())
    link = f"rtu://{slave.path}?baudrate=115200"
    results = Results()
    async with running([device(link, latency_ms=-2.0)], results):
        await results.number(20)
    slave.close()
    good = [result for result in results.all if well(result)]
    assert len(good) == len(results.all)
    for result in good:
        assert isinstance(result.sample, ImuSample)
        # 8 bytes of 10 bits at 115200 baud before the slave has heard the request; then its latency.
        assert result.sample.t_s == pytest.approx(result.sent_s + 8 * 10 / 115200 - 0.002, abs=1e-9)
        assert isnan(result.sample.roll_rad)
        assert result.detail == ""
    dues = [result.due_s for result in results.all]
    periods = [(due - dues[0]) * 200.0 for due in dues]
    assert periods == pytest.approx([round(number) for number in periods], abs=1e-6)
    # Every deadline that is missing between two results is counted as skipped.
    for number in range(1, len(periods)):
        assert round(periods[number] - periods[number - 1]) == 1 + results.all[number].skipped


async def test_tcp_poll_of_two_devices_on_one_connection() -> None:
    slave = TcpSlave(lambda request: tcp_answer(request, [request[6]] * int.from_bytes(request[10:12])))
    await slave.start()
    link = f"tcp://127.0.0.1:{slave.port}"
    laser = Profile(name="laser", blocks=(Block(
        function="input", start=0, fields=(
            Field(quantity="laser_m", offset=0, unit="mm"), Field(quantity="temperature_c", offset=1, unit="degC"),
        ),
    ),))  # fmt: skip
    results = Results()
    imu_spec = device(link, device_id=7, latency_ms=3.0)
    laser_spec = device(link, name="gauge", role="laser", device_id=9, profile=laser, rate_hz=100.0)
    async with running([imu_spec, laser_spec], results):
        await results.number(12)
    await slave.stop()
    assert {request[7] for request in slave.requests if request[6] == 7} == {3}
    assert {request[7] for request in slave.requests if request[6] == 9} == {4}
    for result in results.all:
        assert result.fault is Fault.NONE
        if result.device == "gauge":
            assert isinstance(result.sample, LaserSample)
            assert result.sample.laser_m == pytest.approx(0.009)
            assert result.extra == {"temperature_c": 9.0}
        else:
            assert isinstance(result.sample, ImuSample)
            assert result.sample.az_mps2 == 7.0
            assert result.sample.t_s == pytest.approx(result.sent_s + 0.003, abs=1e-9)


async def test_sample_is_dated_by_the_block_with_the_vertical_acceleration() -> None:
    slave = TcpSlave(lambda request: tcp_answer(request, [1] * int.from_bytes(request[10:12])))
    await slave.start()
    blocks = (
        Block(start=0x40, fields=(Field(quantity="roll_rad", offset=0, unit="rad"),)),
        Block(start=0x34, fields=(Field(quantity="az_mps2", offset=0, unit="m/s2"),)),
    )
    results = Results()
    spec = device(f"tcp://127.0.0.1:{slave.port}", profile=Profile(name="two", blocks=blocks))
    asked: list[float] = []
    answer = slave.answer

    def note(request: bytes) -> bytes | None:
        if request[9] == 0x34:
            asked.append(asyncio.get_running_loop().time())
        return answer(request)

    slave.answer = note
    async with running([spec], results):
        await results.number(3)
    await slave.stop()
    first = results.all[0]
    assert isinstance(first.sample, ImuSample)
    assert (first.sample.roll_rad, first.sample.az_mps2) == (1.0, 1.0)
    # Sent after the first block was done, and before the slave saw it.
    assert first.due_s + first.lateness_s < first.sample.t_s < asked[0]


# ---- late answers ----------------------------------------------------------------------------------------------------


class LateSlave:
    """Keeps the answer to one request back until it hears another, then sends both: the worst moment for it. Every
    register carries the number of the request that it answers.
    """

    def __init__(self, keep_back: set[int]) -> None:
        self.keep_back = keep_back
        self.asked = 0
        self.kept = b""

    def __call__(self, request: bytes) -> bytes:
        self.asked += 1
        answer = rtu_answer(request, [self.asked] * count_of(request))
        if self.asked in self.keep_back:
            self.kept += answer
            return b""
        late, self.kept = self.kept, b""
        return late + answer


class Fresh(Results):
    """Collects results, and the good ones with a value that does not answer a request of their own poll."""

    def __init__(self, asked: Callable[[], int]) -> None:
        super().__init__()
        self.stale: list[tuple[float, int]] = []
        self._asked = asked
        self._asked_before = 0

    def __call__(self, result: PollResult) -> None:
        asked = self._asked()
        if well(result):
            sample = result.sample
            numbers = (sample.az_mps2, sample.ax_mps2, sample.ay_mps2)  # type: ignore[union-attr]
            self.stale += [(n, asked) for n in numbers if not isnan(n) and not self._asked_before < n <= asked]
        self._asked_before = asked
        super().__call__(result)


async def test_late_rtu_answer_is_never_taken_for_the_next_one() -> None:
    late = LateSlave({5, 9, 10, 14})
    slave = RtuSlave(late)
    results = Fresh(lambda: late.asked)
    async with running([device(f"rtu://{slave.path}?baudrate=115200", timeout_ms=30.0)], results):
        await results.until(lambda result: well(result) and result.sample.az_mps2 >= 25)  # type: ignore[union-attr]
    slave.close()
    assert results.stale == []
    assert [result.fault for result in results.all].count(Fault.TIMEOUT) >= 4


async def test_answer_to_a_cancelled_read_is_never_taken_by_the_next_bus() -> None:
    late = LateSlave({4})
    slave = RtuSlave(late)
    spec = device(f"rtu://{slave.path}?baudrate=115200", timeout_ms=2000.0)
    results = Results()
    heard = asyncio.Event()

    def answer(request: bytes) -> bytes:
        data = late(request)
        if not data:
            heard.set()
        return data

    slave.answer = answer
    async with running([spec], results):
        async with asyncio.timeout(10):
            await heard.wait()  # request 4 is under way: now the task is cancelled
    assert late.kept
    again = Results()
    async with running([spec], again):
        first = await again.until(well)
        values = {round(result.sample.az_mps2) for result in again.all if well(result)}  # type: ignore[union-attr]
    slave.close()
    assert round(first.sample.az_mps2) == 5  # type: ignore[union-attr]
    assert 4 not in values


async def test_one_register_device_rests_until_no_late_answer_can_come() -> None:
    """Nothing tells its answers apart, so it must not be asked while one may be under way."""
    silent = {3}
    count = 0
    times: list[float] = []

    def answer(request: bytes) -> bytes:
        nonlocal count
        if count_of(request) > 1:
            return rtu(bytes((request[0], 0x83, 2)))
        count += 1
        times.append(asyncio.get_running_loop().time())
        return b"" if count in silent else rtu_answer(request, [count])

    slave = RtuSlave(answer)
    results = Results()
    spec = device(f"rtu://{slave.path}", profile=counter_profile(1), timeout_ms=20.0)
    async with running([spec], results):
        await results.until(lambda result: well(result) and result.sample.az_mps2 >= 4.0)  # type: ignore[union-attr]
    slave.close()
    assert times[3] - times[2] >= 0.5
    resting = [result for result in results.all if result.fault is Fault.TIMEOUT and isnan(result.sent_s)]
    assert resting
    assert all(result.sample.t_s == result.due_s for result in resting)


async def test_device_that_answers_only_its_usual_length_comes_back() -> None:
    count = 0

    def answer(request: bytes) -> bytes:
        nonlocal count
        count += 1
        return rtu_answer(request, [count] * 3)

    slave = RtuSlave(answer)
    results = Results()
    async with running([device(f"rtu://{slave.path}", timeout_ms=20.0)], results):
        await results.until(well)
    slave.close()
    assert results.all[0].fault is Fault.LENGTH


async def test_device_that_refuses_other_lengths_is_read_after_a_rest() -> None:
    slave = RtuSlave(
        lambda asked: rtu_answer(asked, [7] * 3) if count_of(asked) == 3 else rtu(bytes((asked[0], 0x83, 2)))
    )
    results = Results()
    async with running([device(f"rtu://{slave.path}", timeout_ms=100.0)], results):
        await results.until(well)
    slave.close()
    # The refusal is of our own making: it is not reported as one of the profile's registers.
    assert {result.fault for result in results.all} == {Fault.TIMEOUT, Fault.NONE}
    longer, part, plain = [count_of(request) for request in slave.requests[:3]]
    assert longer > plain == 3 > part


ERRATIC = {
    "in order": {"latest_s": 0.1},
    "in order, very late": {"latest_s": 0.4},
    "in order, one register": {"latest_s": 0.3, "registers": 1},
    "out of order": {"latest_s": 0.1, "in_order": False},
    "out of order, very late": {"latest_s": 0.4, "in_order": False},
    "out of order, no longer reads": {"latest_s": 0.3, "in_order": False, "most": 3},
    "out of order, one register alone": {"latest_s": 0.3, "in_order": False, "registers": 1, "most": 1},
    "each answer twice": {"latest_s": 0.0, "twice": True},
}
"""Slaves that answer up to twenty timeouts late, and sometimes never."""


@pytest.mark.parametrize("name", ERRATIC)
async def test_no_late_answer_is_taken_from_an_erratic_slave(name: str) -> None:
    kind: dict[str, object] = {"registers": 3, "most": 125, "in_order": True, "twice": False, **ERRATIC[name]}
    chance, loop = random.Random(name), asyncio.get_running_loop()
    asked, busy_until_s = 0, 0.0
    underway: list[asyncio.TimerHandle] = []

    def answer(request: bytes) -> bytes:
        nonlocal asked, busy_until_s
        asked += 1
        if count_of(request) > kind["most"]:  # type: ignore[operator]
            return rtu(bytes((request[0], 0x83, 2)))
        data = rtu_answer(request, [asked] * count_of(request))
        if chance.random() < 0.05:
            return b""
        thinking_s = chance.random() * kind["latest_s"] if chance.random() < 0.2 else 0.0  # type: ignore[operator]
        busy_until_s = max(busy_until_s, loop.time()) + thinking_s
        at_s = busy_until_s if kind["in_order"] else loop.time() + thinking_s
        underway.append(loop.call_at(at_s, slave.say, data * (2 if kind["twice"] else 1)))
        return b""

    slave = RtuSlave(answer)
    results = Fresh(lambda: asked)
    profile = counter_profile(kind["registers"])  # type: ignore[arg-type]
    async with running([device(f"rtu://{slave.path}", timeout_ms=20.0, rate_hz=100.0, profile=profile)], results):
        await results.number(120)
        await results.until(lambda _result: sum(map(well, results.all)) >= 5)  # Or the test shows nothing.
    for handle in underway:
        handle.cancel()
    slave.close()
    assert results.stale == []


def refuse(request: bytes) -> bytes:
    return rtu(bytes((request[0], 0x83, 2)))


@pytest.mark.parametrize(
    ("most", "refuse", "lost"),
    [(125, refuse, 3), (3, refuse, 1), (3, lambda _request: b"", 1)],
    ids=["longer reads", "in parts", "in parts when longer reads are ignored"],
)
async def test_a_lost_answer_costs_one_poll_and_no_more(most: int, refuse: Callable[[bytes], bytes], lost: int) -> None:
    """The next ones are told from it by their length, in whatever order answers come: no need for a rest."""
    plain = missing = 0

    def answer(request: bytes) -> bytes:
        nonlocal plain, missing
        if count_of(request) > most:
            return refuse(request)
        plain += count_of(request) == 3
        if plain >= 5 and missing < lost:
            missing += 1
            return b""
        return rtu_answer(request, [plain] * count_of(request))

    slave = RtuSlave(answer)
    results = Results()
    async with running([device(f"rtu://{slave.path}?baudrate=115200", timeout_ms=60.0)], results):
        first = await results.until(well)
        await results.until(lambda result: well(result) and result.sample.az_mps2 >= 8)  # type: ignore[union-attr]
    slave.close()
    after = results.all[results.all.index(first) :]
    # One more for the longer read that is refused or ignored.
    assert sum(result.fault is not Fault.NONE for result in after) <= lost + (most == 3)


async def test_a_tcp_slave_that_is_always_late_keeps_its_connection_and_is_told_the_timeout() -> None:
    loop = asyncio.get_running_loop()
    underway: list[asyncio.TimerHandle] = []

    def answer(request: bytes) -> bytes:
        underway.append(loop.call_later(0.03, slave.say_to_all, tcp_answer(request, [1] * 3)))
        return b""

    slave = TcpSlave(answer)
    await slave.start()
    results = Results()
    async with running([device(f"tcp://127.0.0.1:{slave.port}", timeout_ms=20.0, rate_hz=50.0)], results):
        await results.number(20)
    for handle in underway:
        handle.cancel()
    await slave.stop()
    assert slave.connections == 1
    assert {result.fault for result in results.all} == {Fault.TIMEOUT}
    assert all("raise timeout_ms" in result.detail for result in results.all[2:])


async def test_late_tcp_answers_are_told_apart_by_their_number() -> None:
    count = 0
    kept = b""

    def answer(request: bytes) -> bytes:
        nonlocal count, kept
        count += 1
        frame = tcp_answer(request, [count] * 3)
        if count % 3 == 0:
            kept = frame
            return b""
        late, kept = kept, b""
        return late + frame

    slave = TcpSlave(answer)
    await slave.start()
    ages: list[int] = []
    results = Results()

    def note(result: object) -> None:
        if well(result):
            ages.append(count - round(result.sample.az_mps2))  # type: ignore[attr-defined]
        results(result)  # type: ignore[arg-type]

    task = asyncio.create_task(Bus([device(f"tcp://127.0.0.1:{slave.port}", timeout_ms=20.0)], note).run())
    await results.until(lambda _result: len(ages) >= 8)
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task
    await slave.stop()
    assert Fault.TIMEOUT in {result.fault for result in results.all}
    assert set(ages) == {0}


# ---- bad answers -----------------------------------------------------------------------------------------------------


def damaged(request: bytes) -> bytes:
    frame = bytearray(rtu_answer(request, [1] * count_of(request)))
    frame[4] ^= 0x10
    return bytes(frame)


RTU_FAULTS = [
    ("mute", lambda _request: b"", Fault.TIMEOUT, "no answer"),
    ("damaged", damaged, Fault.CRC, "no valid frame"),
    ("noise", lambda _request: bytes(range(0x80, 0xA0)), Fault.CRC, "baudrate"),
    ("diagnostics noise", lambda _request: b"\x50\x08\x00", Fault.CRC, "no valid frame"),
    ("other slave", lambda request: rtu_answer(b"\x07" + request[1:], [1] * 3), Fault.TIMEOUT, "device id 7"),
    ("too short", lambda request: rtu_answer(request, [1] * 2), Fault.LENGTH, "2 registers instead of 3"),
    ("busy", lambda request: rtu(bytes((request[0], request[1] | 0x80, 6))), Fault.EXCEPTION, "device busy"),
    ("bad map", lambda request: rtu(bytes((request[0], 0x83, 2))), Fault.EXCEPTION, "illegal data address"),
    ("echo", lambda request: request, Fault.TIMEOUT, "only the own request came back"),
    ("echo of another id", lambda request: rtu(b"\x07" + request[1:6]), Fault.CRC, "no valid frame"),
    ("begun", lambda request: rtu_answer(request, [1] * 3)[:7], Fault.TIMEOUT, "7 of 11 bytes): raise timeout_ms"),
    ("echo, begun", lambda request: request + request[:2], Fault.TIMEOUT, "begun (2 of 11 bytes): raise timeout_ms"),
    ("noise, begun", lambda request: b"\0\xff" + request[:2] + b"\x06\0", Fault.TIMEOUT, "begun (4 of 11 bytes)"),
    ("wrong byte count", lambda request: rtu(request[:2] + b"\x08" + bytes(6)), Fault.CRC, "no valid frame"),
    ("other function", lambda request: rtu_answer(request[:1] + b"\4", [1] * 3), Fault.TIMEOUT, "another function (4)"),
]


@pytest.mark.parametrize(("name", "bad", "fault", "words"), RTU_FAULTS, ids=[row[0] for row in RTU_FAULTS])
async def test_rtu_fault_is_named_and_passes(
    name: str, bad: Callable[[bytes], bytes], fault: Fault, words: str
) -> None:
    broken = True
    count = CountingSlave()
    # While broken, short reads (that resynchronise) are answered well, so that the bad answer meets the data read.
    slave = RtuSlave(lambda request: bad(request) if broken and count_of(request) == 3 else count(request))
    results = Results()
    async with running([device(f"rtu://{slave.path}?baudrate=115200", timeout_ms=30.0)], results):
        faulty = await results.until(lambda result: result.fault is fault)
        broken = False
        await results.until(well)
    slave.close()
    assert faulty.fault is fault
    assert faulty.sample.fault is fault
    assert isnan(faulty.sample.az_mps2)  # type: ignore[union-attr]
    assert words in faulty.detail
    assert slave.path in faulty.detail
    assert "id 80" in faulty.detail


async def test_an_answer_that_comes_after_its_time_names_the_timeout() -> None:
    """It comes while nobody waits: nothing is heard during the poll, but why is known."""
    loop = asyncio.get_running_loop()
    underway: list[asyncio.TimerHandle] = []

    def answer(request: bytes) -> bytes:
        underway.append(loop.call_later(0.06, slave.say, rtu_answer(request, [1] * count_of(request))))
        return b""

    slave = RtuSlave(answer)
    results = Results()
    async with running([device(f"rtu://{slave.path}", timeout_ms=20.0, rate_hz=5.0)], results):
        late = await results.until(lambda result: "in time" in result.detail)
    for handle in underway:
        handle.cancel()
    slave.close()
    assert late.fault is Fault.TIMEOUT
    assert float(late.detail.split("the latest came ")[1].split(" ms after its request: raise timeout_ms")[0]) >= 60


async def test_an_echo_before_the_answer_does_no_harm() -> None:
    count = CountingSlave()
    slave = RtuSlave(lambda request: request + count(request))
    results = Results()
    async with running([device(f"rtu://{slave.path}?baudrate=115200")], results):
        await results.number(20)
    slave.close()
    assert all(map(well, results.all))


async def test_answer_is_found_between_noise() -> None:
    count = CountingSlave()
    slave = RtuSlave(lambda request: b"\x00\x50\x03" + count(request) + b"\xff")
    results = Results()
    async with running([device(f"rtu://{slave.path}?baudrate=115200")], results):
        await results.number(5)
    slave.close()
    assert all(well(result) for result in results.all)


def mbap(request: bytes, pdu: bytes) -> bytes:
    return mbap_answer(int.from_bytes(request[:2]), request[6], pdu)


TCP_FAULTS = [
    ("mute", lambda _request: b"", Fault.TIMEOUT, "no answer"),
    ("too short", lambda request: tcp_answer(request, [1] * 2), Fault.LENGTH, "2 registers instead of 3"),
    ("busy", lambda request: mbap(request, b"\x83\x06"), Fault.EXCEPTION, "device busy"),
    ("not Modbus", lambda _request: b"SSH-2.0-OpenSSH_9.6\r\n", Fault.CRC, "check the port"),
    ("other function", lambda request: mbap(request, b"\x63\x06"), Fault.EXCEPTION, "function"),
    ("half a frame", lambda request: tcp_answer(request, [1] * 3)[:10], Fault.CRC, "no whole Modbus TCP frame"),
    ("a whole page", lambda _request: b"HTTP/1.1 400 Bad Request\r\n" * 100, Fault.CRC, "check the port"),
    ("half a header", lambda request: request[:5], Fault.CRC, "no whole Modbus TCP frame"),
    ("byte count too great", lambda request: mbap(request, b"\x03\x08" + bytes(6)), Fault.LENGTH, "byte count says 8"),
    ("byte count too small", lambda request: mbap(request, b"\x03\x04" + bytes(6)), Fault.LENGTH, "byte count says 4"),
    ("odd byte count", lambda request: mbap(request, b"\x03\x05" + bytes(5)), Fault.LENGTH, "byte count says 5"),
    ("no registers", lambda request: mbap(request, b"\x03\x00"), Fault.LENGTH, "0 registers instead of 3"),
    ("too long", lambda request: tcp_answer(request, [1] * 4), Fault.LENGTH, "4 registers instead of 3"),
    ("other unit", lambda request: tcp_answer(request[:6] + b"\x07" + request[7:], [1] * 3), Fault.EXCEPTION, "(7, 3)"),
    ("own number", lambda request: tcp_answer(b"\x00\x00" + request[2:], [1] * 3), Fault.EXCEPTION, "number (0)"),
    ("other protocol", lambda request: request[:2] + b"\0\1" + tcp_answer(request, [1] * 3)[4:], Fault.CRC, "the port"),
]
MADE_ANEW = {"mute", "not Modbus", "a whole page", "half a frame", "half a header", "other protocol"}
"""Faults over which a connection is made anew: it may hang, or what follows cannot be read."""


@pytest.mark.parametrize(("name", "bad", "fault", "words"), TCP_FAULTS, ids=[row[0] for row in TCP_FAULTS])
async def test_tcp_fault_is_named_and_passes(
    name: str, bad: Callable[[bytes], bytes], fault: Fault, words: str
) -> None:
    broken = True
    slave = TcpSlave(lambda request: bad(request) if broken else tcp_answer(request, [5] * 3))
    await slave.start()
    results = Results()
    async with running([device(f"tcp://127.0.0.1:{slave.port}", timeout_ms=60.0)], results):
        faulty = (await results.number(6))[0]
        broken = False
        await results.until(well)
    await slave.stop()
    assert faulty.fault is fault
    assert words in faulty.detail
    assert (slave.connections > 1) == (name in MADE_ANEW)
    # Even while the connection is made anew, the fault stays what it is: one transition, one line in the log.
    assert {result.fault for result in results.all} == {fault, Fault.NONE}


async def test_not_a_number_and_out_of_range_are_faults() -> None:
    fields = (Field(quantity="laser_m", offset=0, type="float32", unit="m", min=0.1, max=30.0),)
    profile = Profile(name="float", blocks=(Block(start=0, fields=fields),))
    words = [0x7FC0, 0x0000]
    slave = TcpSlave(lambda request: tcp_answer(request, words))
    await slave.start()
    results = Results()
    spec = device(f"tcp://127.0.0.1:{slave.port}", role="laser", profile=profile)
    async with running([spec], results):
        nan_result = (await results.number(1))[0]
        words[:] = [0x4248, 0x0000]  # 50.0
        far = await results.until(lambda result: result.fault is Fault.OUT_OF_RANGE)
        words[:] = [0x4148, 0x0000]  # 12.5
        good = await results.until(well)
    await slave.stop()
    assert nan_result.fault is Fault.NOT_FINITE
    assert "50" in far.detail
    assert isinstance(far.sample, LaserSample)
    assert isnan(far.sample.laser_m)
    assert good.sample == LaserSample(t_s=good.sample.t_s, laser_m=12.5)


async def test_frozen_registers_become_stuck() -> None:
    slave = TcpSlave(lambda request: tcp_answer(request, [9] * 3))
    await slave.start()
    results = Results()
    async with running([device(f"tcp://127.0.0.1:{slave.port}", stuck_after_s=0.05)], results):
        stuck = await results.until(lambda result: result.fault is Fault.STUCK)
    await slave.stop()
    assert results.all[0].fault is Fault.NONE
    assert isnan(stuck.sample.az_mps2)  # type: ignore[union-attr]


# ---- lines that go away ----------------------------------------------------------------------------------------------


async def test_tcp_server_goes_away_and_returns() -> None:
    count = 0

    def answer(request: bytes) -> bytes:
        nonlocal count
        count += 1
        return tcp_answer(request, [count] * 3)

    slave = TcpSlave(answer)
    await slave.start()
    port = slave.port
    results = Results()
    async with running([device(f"tcp://127.0.0.1:{port}", timeout_ms=30.0)], results):
        first = await results.until(well)
        for _ in range(2):
            await slave.stop()
            away = await results.until(
                lambda result: result.fault is Fault.DISCONNECTED and "refused" in result.detail, since=len(results.all)
            )
            before = count
            await slave.start(port)
            back = await results.until(well, since=len(results.all))
            assert back.reconnected
            assert round(back.sample.az_mps2) > before  # type: ignore[union-attr]
            assert f"127.0.0.1:{port}" in away.detail
    await slave.stop()
    assert not first.reconnected


async def test_slave_that_closes_after_each_answer_is_read_at_every_poll() -> None:
    slave = TcpSlave(lambda request: tcp_answer(request, [len(slave.requests)] * 3), idle_s=0.0)
    await slave.start()
    results = Results()
    async with running([device(f"tcp://127.0.0.1:{slave.port}", rate_hz=50.0)], results):
        await results.number(25)
    await slave.stop()
    assert all(map(well, results.all))
    assert slave.connections >= 25


async def test_slave_that_closes_on_the_next_request_is_asked_once_more() -> None:
    """As one does that gives up idle connections just when the request is under way."""

    def answer(request: bytes) -> bytes | None:
        return None if len(slave.requests) % 2 == 0 else tcp_answer(request, [len(slave.requests)] * 3)

    slave = TcpSlave(answer)
    await slave.start()
    results = Results()
    # Did each cost its timeout, the test would not end.
    async with running([device(f"tcp://127.0.0.1:{slave.port}", rate_hz=50.0, timeout_ms=10_000.0)], results):
        await results.number(20)
    await slave.stop()
    assert all(map(well, results.all))


async def test_slave_that_closes_idle_connections_is_read_at_every_poll() -> None:
    slave = TcpSlave(lambda request: tcp_answer(request, [len(slave.requests)] * 3), idle_s=0.02)
    await slave.start()
    results = Results()
    async with running([device(f"tcp://127.0.0.1:{slave.port}", rate_hz=10.0)], results):
        await results.number(8)
    await slave.stop()
    assert all(map(well, results.all))
    assert slave.connections <= 2 * 8 + 1  # And not again and again while nobody asks.


async def test_a_connection_that_is_lost_while_it_is_made_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    slave, results = TcpSlave(lambda request: tcp_answer(request, [1, 2, 3])), Results()
    await slave.start()
    opens = 0
    honest = OpenLink.open

    async def open_(self: OpenLink) -> str:
        """The second time, while a poll waits for it, the slave resets it before we are told that it is open."""
        nonlocal opens
        failure = await honest(self)
        opens += 1
        if opens == 2:
            await holds(lambda: slave.connections == 2 and bus._wanted.is_set())
            for writer in slave._writers:
                writer.transport.abort()
            await bus._lost.wait()
        return failure

    monkeypatch.setattr(OpenLink, "open", open_)
    async with running([device(f"tcp://127.0.0.1:{slave.port}", stuck_after_s=0.0)], results) as bus:
        await results.until(lambda result: result.fault is Fault.NONE)
        for writer in slave._writers:
            writer.transport.abort()
        await holds(lambda: opens > 1)
        await results.until(lambda result: result.fault is Fault.NONE, len(results.all) + 1)
    assert opens > 2
    await slave.stop()


async def test_slave_that_closes_without_an_answer_is_not_stormed() -> None:
    slave = TcpSlave(lambda _request: None)
    await slave.start()
    results = Results()
    async with running([device(f"tcp://127.0.0.1:{slave.port}", rate_hz=200.0)], results):
        last = (await results.number(150))[-1]
    await slave.stop()
    assert {result.fault for result in results.all} == {Fault.DISCONNECTED}
    span_s = last.due_s - results.all[0].due_s
    assert slave.connections <= span_s / RETRY_S + 2


async def test_tcp_server_that_is_not_there_at_first() -> None:
    reserved = TcpSlave(lambda request: tcp_answer(request, [1] * 3))
    await reserved.start()
    port = reserved.port
    await reserved.stop()
    results = Results()
    async with running([device(f"tcp://127.0.0.1:{port}")], results):
        first = (await results.number(1))[0]
        await reserved.start(port)
        back = await results.until(well)
    await reserved.stop()
    assert first.fault is Fault.DISCONNECTED
    assert isnan(first.sent_s)
    assert not back.reconnected


def test_a_line_that_is_back_is_open_within_a_second() -> None:
    """At worst it returns just after an attempt has begun, which then waits in vain; the next one follows the pause."""
    assert CONNECT_TIMEOUT_S + RETRY_S < 1.0
    assert PROBE_S < 1.0  # And a silent one, whose line is open, is asked again by then.


async def test_a_port_that_vanishes_while_its_silence_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    slave = RtuSlave(CountingSlave())
    results = Results()
    wait = OpenLink._wait_for_silence
    vanishes = True

    async def then_gone(self: OpenLink, link: SerialLink, most_s: float) -> None:
        nonlocal vanishes
        await wait(self, link, most_s)
        if vanishes:
            vanishes = False
            assert self._client is not None
            self._client.close()

    monkeypatch.setattr(OpenLink, "_wait_for_silence", then_gone)
    async with running([device(f"rtu://{slave.path}?baudrate=115200")], results):
        lost = await results.until(lambda result: result.fault is Fault.DISCONNECTED and "lost" in result.detail)
        assert isnan(lost.sent_s)


async def test_serial_port_vanishes_and_returns(tmp_path: Path) -> None:
    port = tmp_path / "ttyUSB0"
    slave = RtuSlave(CountingSlave())
    port.symlink_to(slave.path)
    results = Results()
    async with running([device(f"rtu://{port}?baudrate=115200", timeout_ms=30.0)], results):
        await results.until(well)
        port.unlink()
        slave.close()
        gone = await results.until(lambda result: result.fault is Fault.DISCONNECTED and "not there" in result.detail)
        slave = RtuSlave(CountingSlave())
        port.symlink_to(slave.path)
        back = await results.until(well, since=len(results.all))
    slave.close()
    assert str(port) in gone.detail
    assert back.reconnected


async def test_no_permission_on_the_port_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> None:
        raise serial.SerialException(errno.EACCES, "could not open port /dev/ttyUSB7: Permission denied")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    results = Results()
    async with running([device("rtu:///dev/ttyUSB7")], results):
        first = (await results.number(1))[0]
    assert first.fault is Fault.DISCONNECTED
    assert "no permission to open /dev/ttyUSB7" in first.detail
    assert "dialout" in first.detail


async def test_out_of_descriptors_is_a_fault_and_no_flood(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    slave = TcpSlave(lambda request: tcp_answer(request, [1, 2, 3]))
    await slave.start()
    pty = RtuSlave(CountingSlave())
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    for link in (f"tcp://127.0.0.1:{slave.port}", f"rtu://{pty.path}"):
        results = Results()
        async with running([device(link)], results):
            resource.setrlimit(resource.RLIMIT_NOFILE, (3, limits[1]))
            try:
                first = await results.until(lambda _result: True)
            finally:
                resource.setrlimit(resource.RLIMIT_NOFILE, limits)
            back = await results.until(well)
        assert first.fault is Fault.DISCONNECTED
        assert "no file descriptor is left for the line" in first.detail
        assert back.device == "imu"
    pty.close()
    await slave.stop()
    assert [record.getMessage() for record in caplog.records] == []


async def test_a_name_with_several_addresses_is_tried_at_each(monkeypatch: pytest.MonkeyPatch) -> None:
    slave = TcpSlave(lambda request: tcp_answer(request, [1, 2, 3]))
    await slave.start()

    async def addresses(name: HostName, timeout_s: float) -> list[str]:
        return ["127.0.0.9", "127.0.0.1"]  # Nobody listens at the first.

    monkeypatch.setattr(HostName, "addresses", addresses)
    results = Results()
    async with running([device(f"tcp://plc.ship:{slave.port}")], results):
        first = (await results.number(1))[0]
    await slave.stop()
    assert well(first)


async def test_a_name_that_is_not_known_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    async def addresses(name: HostName, timeout_s: float) -> list[str]:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(HostName, "addresses", addresses)
    results = Results()
    async with running([device("tcp://plc.ship:502")], results):
        first = (await results.number(1))[0]
    assert first.fault is Fault.DISCONNECTED
    assert "host name plc.ship is unknown (Name or service not known): check it, or write the IP" in first.detail


async def test_port_is_opened_for_us_alone() -> None:
    slave = RtuSlave(CountingSlave())
    results, second = Results(), Results()
    async with running([device(f"rtu://{slave.path}")], results):
        await results.until(well)
        async with running([device(f"rtu://{slave.path}")], second):
            refused = (await second.number(1))[0]
    slave.close()
    assert "in use by another program" in refused.detail


async def test_nothing_floods_the_log(caplog: pytest.LogCaptureFixture) -> None:
    """Neither pymodbus, which logs every timeout, nor the loop, in which pymodbus raises for a frame that it does not
    know: what is wrong stands in the results.
    """
    caplog.set_level(logging.INFO)
    serial_slave = RtuSlave(lambda _request: b"\x50\x08\x00")
    bad = itertools.cycle((b"\x63\x06", b"\x03\x08" + bytes(6), b"\x03\x05" + bytes(5), b"\x03\x02", b"\x83\x02\x02"))
    tcp_slave = TcpSlave(lambda request: mbap(request, next(bad)))
    await tcp_slave.start()
    results = Results()
    async with running([device(f"rtu://{serial_slave.path}", timeout_ms=10.0)], results):
        await results.number(8)
    async with running([device(f"tcp://127.0.0.1:{tcp_slave.port}", timeout_ms=10.0)], results):
        await results.number(16)
    serial_slave.close()
    await tcp_slave.stop()
    assert [record.getMessage() for record in caplog.records] == []


# ---- neighbours ------------------------------------------------------------------------------------------------------


async def test_dead_slave_does_not_starve_its_neighbour() -> None:
    count = CountingSlave()
    asked_dead = 0

    def answer(request: bytes) -> bytes:
        nonlocal asked_dead
        if request[0] == 1:
            asked_dead += 1
            return b""
        return count(request)

    slave = RtuSlave(answer)
    link = f"rtu://{slave.path}?baudrate=115200"
    dead = device(link, name="dead", device_id=1, rate_hz=100.0, timeout_ms=20.0)
    alive = device(link, name="alive", device_id=2, rate_hz=100.0, timeout_ms=500.0)
    results = Results()
    async with running([dead, alive], results):
        await results.until(lambda result: result.device == "dead" and isnan(result.sent_s))
        start = len(results.all)
        asked_before, count_before = asked_dead, count.requests
        await results.number(start + 200)
    slave.close()
    after = results.all[start:]
    span_s = after[-1].due_s - after[0].due_s
    neighbour = [result for result in after if result.device == "alive"]
    assert all(result.fault is Fault.NONE for result in neighbour)
    assert all(result.fault is Fault.TIMEOUT for result in after if result.device == "dead")
    # At most two probes a second; the neighbour has the line for itself but for those.
    assert asked_dead - asked_before <= 2 * span_s + 1
    assert count.requests - count_before >= len(neighbour)
    assert len(neighbour) + sum(result.skipped for result in neighbour) >= 0.95 * 100 * span_s


async def test_slave_back_from_the_dead_is_polled_at_full_rate_again() -> None:
    count = CountingSlave()
    dead = True
    slave = RtuSlave(lambda request: b"" if dead and request[0] == 1 else count(request))
    link = f"rtu://{slave.path}?baudrate=115200"
    one = device(link, name="one", device_id=1, rate_hz=50.0, timeout_ms=60.0)
    two = device(link, name="two", device_id=2, rate_hz=50.0, timeout_ms=500.0)
    results = Results()
    async with running([one, two], results):
        await results.until(lambda result: result.device == "one" and isnan(result.sent_s))
        dead = False
        await results.until(lambda result: result.device == "one" and well(result))
        start = len(results.all)
        await results.number(start + 20)
    slave.close()
    # Asked every time; whether the answer comes in time is the machine's affair.
    assert not any(isnan(result.sent_s) for result in results.all[start:])


# ---- the bus itself --------------------------------------------------------------------------------------------------


def test_bus_wants_devices_on_one_line() -> None:
    with pytest.raises(ValueError, match="one line, not on 2"):
        Bus([device("tcp://a:1"), device("tcp://b:1")], print)
    with pytest.raises(ValueError, match="not on 0"):
        Bus([], print)


async def test_a_failing_consumer_is_a_bug_and_ends_the_task() -> None:
    slave = RtuSlave(CountingSlave())

    def fail(result: object) -> None:
        raise KeyError("consumer")

    with pytest.raises(ExceptionGroup) as caught:
        await Bus([device(f"rtu://{slave.path}")], fail).run()
    slave.close()
    assert isinstance(caught.value.exceptions[0], KeyError)


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


async def test_cancelling_closes_the_line() -> None:
    before = open_files()
    slave = RtuSlave(CountingSlave())
    results = Results()
    async with running([device(f"rtu://{slave.path}")], results):
        await results.until(well)
    slave.close()
    assert open_files() == before


@pytest.mark.parametrize("order", ["before the answer", "after the answer"])
async def test_a_cancellation_in_the_same_round_as_the_answer_ends_the_task(
    order: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``asyncio.wait_for`` of Python 3.11 swallows such a one."""
    polls: list[asyncio.Task[None]] = []
    answered = asyncio.Event()
    find = find_tcp_answer

    def cancel_and_find(*arguments: Any) -> bytes:
        polls.extend(task for task in asyncio.all_tasks() if task.get_name().startswith("poll"))
        answered.set()
        if order == "before the answer":
            polls[0].cancel()
        else:
            asyncio.get_running_loop().call_soon(polls[0].cancel)
        return find(*arguments)

    monkeypatch.setattr(modbus, "find_tcp_answer", cancel_and_find)
    slave = TcpSlave(lambda request: tcp_answer(request, [1, 2, 3]))
    await slave.start()
    results = Results()
    bus = asyncio.create_task(Bus([device(f"tcp://127.0.0.1:{slave.port}")], results).run())
    async with asyncio.timeout(10):
        await answered.wait()
        await asyncio.wait(polls)
    assert polls[0].cancelled()
    assert results.all == []
    await cancelled([bus], 10.0)
    await slave.stop()
