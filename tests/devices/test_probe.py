"""Probing: the profile that fits is found, through a shifted address, the other function and another byte order."""

from __future__ import annotations

import asyncio
import math
import random
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from modbus_slaves import RtuSlave, TcpSlave, mbap_answer, rtu, rtu_answer, tcp_answer

from heaved.config.read import packaged_profiles
from heaved.devices.probe import Report, parse_ids, plausibility, probe
from heaved.devices.profile import DeviceSpec, Profile, Quantity
from heaved.links import parse_link
from heaved.samples import ImuSample, LaserSample, Sample
from heaved.simulate.plant import SimulatedPlant

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from pathlib import Path

PROFILES = {profile.name: profile for profile in packaged_profiles()}
IMU, LASER = PROFILES["heaved-sim-imu"], PROFILES["heaved-sim-laser"]


class AtAnchor:
    """A ship that lies still, a little heeled; her sensors are noisy."""

    def read(self, device: DeviceSpec, t_s: float) -> Sample:
        noise = 0.01 * math.sin(1e3 * t_s)
        if device.role == "laser":
            return LaserSample(t_s=t_s, laser_m=11.5 + noise)
        heel = math.radians(3.0)
        return ImuSample(
            t_s=t_s, ax_mps2=noise, ay_mps2=9.81 * math.sin(heel), az_mps2=9.81 * math.cos(heel), roll_rad=heel,
            pitch_rad=0.02, yaw_rad=1.0, gx_radps=0.001, gy_radps=-0.002, gz_radps=0.003,
        )  # fmt: skip


def changed(profile: Profile, change: Callable[[dict], object]) -> Profile:  # type: ignore[type-arg]
    """A device whose registers differ from the profile: ``change`` edits each block."""
    tree = msgspec.to_builtins(profile)
    for block in tree["blocks"]:
        change(block)
    return msgspec.convert(tree, Profile)


def reorder(block: dict[str, Any]) -> None:
    for field in block["fields"]:
        field["byte_order"] = "CDAB"


def move_and_reorder(block: dict[str, Any]) -> None:
    block["start"] = 1
    reorder(block)


@asynccontextmanager
async def served(profile: Profile, role: str, device_id: int) -> AsyncIterator[str]:
    device = msgspec.convert(
        {"name": "it", "role": role, "link": "tcp://127.0.0.1:1", "device_id": device_id, "rate_hz": 10.0,
         "profile": msgspec.to_builtins(profile)},
        DeviceSpec,
    )  # fmt: skip
    plant = SimulatedPlant([device], AtAnchor(), any_port=True)
    await plant.start()
    try:
        yield plant.devices[0].link
    finally:
        await plant.stop()


async def report(line: AbstractAsyncContextManager[str], profiles: tuple[Profile, ...], ids: str = "1-8") -> list[str]:
    async with line as link:
        found = await probe(parse_link(link), parse_ids(ids), profiles, 0.5, lambda device_id: None)
    assert found.hints == []
    return found.lines


async def reported(slave: TcpSlave | RtuSlave, ids: str, timeout_s: float = 0.5) -> Report:
    """What is found on the slave's line among all packaged profiles."""
    if isinstance(slave, TcpSlave):
        await slave.start()
        link = f"tcp://127.0.0.1:{slave.port}"
    else:
        link = f"rtu://{slave.path}?baudrate=115200"
    try:
        return await probe(parse_link(link), parse_ids(ids), packaged_profiles(), timeout_s, lambda device_id: None)
    finally:
        if isinstance(slave, TcpSlave):
            await slave.stop()
        else:
            slave.close()


def wt901(number: int) -> list[int]:
    """Registers 0x34..0x3F of a sensor at rest, by its manual: 2048 per g, 182 per degree; noise of some counts."""
    return [word & 0xFFFF for word in (number % 3, -number % 4, 2048 + number % 5, 1, -1, 2, 0, 0, 0, 364, -182, 91)]


def asked_for(request: bytes, registers: list[int], start: int) -> bytes | None:
    """The answer of a TCP slave that has ``registers`` from ``start`` on in holding registers, None: an exception."""
    first, count = int.from_bytes(request[8:10]) - start, int.from_bytes(request[10:12])
    if request[7] != 3 or first < 0 or first + count > len(registers):
        return mbap_answer(int.from_bytes(request[:2]), request[6], bytes((request[7] | 0x80, 2)))
    return tcp_answer(request, registers[first : first + count])


async def test_a_sensor_comes_before_the_simulator_that_imitates_it() -> None:
    slave = TcpSlave(lambda request: asked_for(request, wt901(len(slave.requests)), 0x34))
    lines = (await reported(slave, "80")).lines
    assert lines[0] == "id 80: fits"
    names = [line.split()[1] for line in lines if "%" in line]
    assert names[0] == "witmotion-wt901c485"
    assert "heaved-sim-imu16" in names[1:]


BANDWIDTHS: dict[str, tuple[int | None, bool, list[str]]] = {
    "as it is set": (3, False, ["bandwidth 42 Hz (register 0x1F is 3): poll at 84 Hz or more"]),
    "on a line that is fast enough": (3, True, ["bandwidth 42 Hz (register 0x1F is 3): poll at 84 Hz or more"]),
    # 37 characters of 10 bits at 115200 baud and twice 1.75 ms: 6.7 ms.
    "on a line that is too slow": (2, True, [
        "bandwidth 98 Hz (register 0x1F is 2): poll at 196 Hz or more",
        "the line carries 148 polls a second: at 148 Hz, less than twice its bandwidth of 98 Hz, vibration of "
        "147.4-148.6 Hz folds into the waves, and nothing can tell it from them",
        "poll at 196 Hz or more (the line carries 148: raise its baud rate first), or set register 0x1F of the sensor "
        "to 3 (42 Hz) and bandwidth_hz to 42; it then lags by about 5 ms instead of 2: take the difference from "
        "latency_ms",
    ]),
    "a register that says something else": (900, False, ["bandwidth 20 Hz (as delivered): poll at 40 Hz or more"]),
    "no such register": (None, False, ["bandwidth 20 Hz (as delivered): poll at 40 Hz or more"]),
}  # fmt: skip


@pytest.mark.parametrize("name", BANDWIDTHS)
async def test_the_bandwidth_of_a_sensor_is_read_and_held_against_its_line(name: str) -> None:
    setting, serial, expected = BANDWIDTHS[name]

    def answer(request: bytes) -> bytes:
        body = request if serial else request[6:]
        first, count = int.from_bytes(body[2:4]), int.from_bytes(body[4:6])
        registers = [0] * 0x34 + wt901(len(slave.requests))
        registers[0x1F] = setting or 0
        if body[1] != 3 or first + count > len(registers) or (first == 0x1F and setting is None):
            refusal = bytes((body[1] | 0x80, 2))
            return rtu(body[:1] + refusal) if serial else mbap_answer(int.from_bytes(request[:2]), body[0], refusal)
        wanted = registers[first : first + count]
        return rtu_answer(request, wanted) if serial else tcp_answer(request, wanted)

    slave = RtuSlave(answer) if serial else TcpSlave(answer)
    lines = [line.strip() for line in (await reported(slave, "80")).lines]
    assert lines[0] == "id 80: fits"
    start = next(i for i, line in enumerate(lines) if line.startswith("bandwidth"))
    assert lines[start:] == expected


def counted(chance: random.Random, memory: list[int]) -> list[int]:
    memory.insert(0, memory[0] + 1)
    return [memory[0], *memory[:-1]]


REGISTERS_OF_ANYTHING: dict[str, Callable[[random.Random, list[int]], list[int]]] = {
    "random, the same for ever": lambda chance, memory: memory,
    "random, each time anew": lambda chance, memory: [chance.randrange(65536) for _ in memory],
    "a counter": counted,
}


@pytest.mark.parametrize("name", REGISTERS_OF_ANYTHING)
@pytest.mark.parametrize("seed", [1, 2])
async def test_registers_of_anything_fit_nothing(name: str, seed: int) -> None:
    chance = random.Random(seed)
    memory = [chance.randrange(60000) for _ in range(256)]

    def answer(request: bytes) -> bytes:
        words = REGISTERS_OF_ANYTHING[name](chance, memory)
        first, count = int.from_bytes(request[8:10]) % 128, int.from_bytes(request[10:12])
        return tcp_answer(request, words[first : first + count])

    lines = (await reported(TcpSlave(answer), "5")).lines
    assert lines[0] in ("id 5: could be", "id 5: answers, but no known profile fits")


@pytest.mark.parametrize(("pace", "verdict"), [(1.0, "id 5: fits"), (0.1, "id 5: could be"), (3.0, "id 5: could be")])
async def test_a_counter_that_does_not_keep_time_is_no_clock(pace: float, verdict: str) -> None:
    def answer(request: bytes) -> bytes:
        # A laser gauge with its time in ms, or a crane that pays out line.
        counted = int(1e3 * pace * asyncio.get_running_loop().time()) & 0xFFFFFFFF
        noise = int(1e3 * asyncio.get_running_loop().time()) % 3
        return asked_for(request, [1200 + noise, 900, 0, counted >> 16, counted & 0xFFFF], 0) or b""

    tf02 = PROFILES["benewake-tf02-i"]
    slave = TcpSlave(answer)
    await slave.start()
    try:
        found = await probe(parse_link(f"tcp://127.0.0.1:{slave.port}"), (5,), (tf02,), 0.5, lambda device_id: None)
    finally:
        await slave.stop()
    assert found.lines[0] == verdict


async def test_a_sensor_that_stands_is_a_mere_possibility() -> None:
    lines = (await reported(TcpSlave(lambda request: asked_for(request, wt901(1), 0x34)), "80")).lines
    assert lines[:2] == ["id 80: could be", "  100%  witmotion-wt901c485"]
    assert "nothing in it changes" in lines[4]


async def test_a_slave_that_closes_after_each_answer_is_examined_all_the_same() -> None:
    slave = TcpSlave(lambda request: asked_for(request, wt901(len(slave.requests)), 0x34), idle_s=0.0)
    lines = (await reported(slave, "1-3")).lines
    assert [line for line in lines if line.startswith("id")] == ["id 1: fits", "id 2: fits", "id 3: fits"]


async def test_probing_goes_on_after_answers_that_are_none() -> None:
    def answer(request: bytes) -> bytes | None:
        number = int.from_bytes(request[:2])
        match request[6]:
            case 1:
                return mbap_answer(number, 1, b"\x03\x08" + bytes(6))
            case 2:
                return b"SSH-2.0-OpenSSH_9.6\r\n"
            case 3:
                return None
            case 4:
                return b""
        return asked_for(request, wt901(len(slave.requests)), 0x34)

    slave = TcpSlave(answer)
    found = await reported(slave, "1-5", timeout_s=0.02)
    assert [line for line in found.lines if line.startswith("id")] == [
        "id 1: answers, but no known profile fits", "id 5: fits",
    ]  # fmt: skip
    hints = "\n".join(found.hints)
    assert "heard of id 1: an answer whose byte count says 8" in hints
    assert "heard of id 2: 21 bytes that are no whole Modbus TCP frame" in hints
    assert "heard of id 3: the connection was lost" in hints
    assert "id 4" not in hints


async def test_a_device_that_ignores_what_it_has_not_got_is_found_all_the_same() -> None:
    def answer(request: bytes) -> bytes:
        first, count = int.from_bytes(request[2:4]) - 0x34, int.from_bytes(request[4:6])
        known = request[:2] == b"\x50\x03" and first >= 0 and first + count <= 12
        return rtu_answer(request, wt901(len(slave.requests))[first : first + count]) if known else b""

    slave = RtuSlave(answer)
    link, known = parse_link(f"rtu://{slave.path}?baudrate=115200"), (PROFILES["witmotion-wt901c485"],)
    try:
        lines = (await probe(link, (79, 80, 81), known, 0.1, lambda device_id: None)).lines
    finally:
        slave.close()
    assert lines[:2] == ["id 80: fits", "  100%  witmotion-wt901c485"]
    assert [line for line in lines if line.startswith("id")] == ["id 80: fits"]


@pytest.mark.parametrize("serial", [True, False])
async def test_a_late_device_is_named_with_the_timeout_that_it_needs(serial: bool) -> None:
    loop = asyncio.get_running_loop()
    underway: list[asyncio.TimerHandle] = []

    def answer(request: bytes) -> bytes:
        if request[0 if serial else 6] == 7:
            data = rtu_answer(request, [1]) if serial else tcp_answer(request, [1])
            say = slave.say if isinstance(slave, RtuSlave) else slave.say_to_all
            underway.append(loop.call_later(0.1, say, data))
        return b""

    slave = RtuSlave(answer) if serial else TcpSlave(answer)
    found = await reported(slave, "6-8", timeout_s=0.03)
    for handle in underway:
        handle.cancel()
    assert found.lines == []
    (hint,) = found.hints
    assert hint.startswith("id 7 answers, but only 0.1")
    assert float(hint.split("--timeout ")[1]) >= 0.2


async def test_wrong_baud_rate_and_echo_are_told_from_silence() -> None:
    slave = RtuSlave(lambda request: bytes(range(0xF0, 0xFA)) if request[0] == 2 else request)
    found = await reported(slave, "1-2", timeout_s=0.05)
    assert found.lines == []
    assert "heard of id 1: only the own request came back" in found.hints[0]
    assert "heard of id 2: 10 bytes that are no valid frame" in found.hints[1]
    assert "baudrate" in found.hints[1]


async def test_an_imu_is_found_among_all_packaged_profiles() -> None:
    lines = await report(served(IMU, "imu", 7), packaged_profiles())
    assert lines[:2] == ["id 7: fits", "  100%  heaved-sim-imu"]
    assert "az_mps2 9.797" in lines[2]
    assert lines[3].split()[0] == "registers"
    assert len(lines[3].split()) == 1 + 18


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda block: block.update(start=1), "heaved-sim-imu with addresses +1"),
        (lambda block: block.update(function="input"), "heaved-sim-imu with the other function (input/holding)"),
        (reorder, "heaved-sim-imu with byte order CDAB"),
        (move_and_reorder, "heaved-sim-imu with addresses +1, byte order CDAB"),
    ],
    ids=["address", "function", "byte order", "both"],
)
async def test_the_usual_mistakes_are_recognised(change: Callable[[dict[str, Any]], object], expected: str) -> None:
    lines = await report(served(changed(IMU, change), "imu", 1), (IMU, LASER), "1")
    assert lines[1] == f"  100%  {expected}"


async def test_a_device_that_nobody_knows_is_named_all_the_same() -> None:
    lines = await report(served(changed(LASER, lambda block: block.update(start=900)), "laser", 3), (IMU, LASER))
    assert lines == ["id 3: answers, but no known profile fits"]


async def test_a_line_that_cannot_be_opened(tmp_path: Path) -> None:
    with pytest.raises(ConnectionError, match="is not there: plug the adapter in"):
        await probe(parse_link(f"rtu://{tmp_path}/none"), (1,), (IMU,), 0.05, lambda device_id: None)


REGISTERS = [1, 2, 3]
MARKS: dict[str, tuple[dict[Quantity, float], list[int], float]] = {
    "gravity on any axis": ({"ax_mps2": -9.8, "ay_mps2": 0.1, "az_mps2": 0.1}, REGISTERS, 1.0),
    "no gravity": ({"ax_mps2": 0.1, "ay_mps2": 0.1, "az_mps2": 0.1}, REGISTERS, 0.0),
    "a distance": ({"laser_m": 12.0}, REGISTERS, 1.0),
    "no distance": ({"laser_m": 1e-38}, REGISTERS, 0.0),
    "capsized": ({"ax_mps2": 0.0, "ay_mps2": 0.0, "az_mps2": 9.8, "roll_rad": 3.0, "pitch_rad": 0.0}, REGISTERS, 5 / 6),
    "empty memory": ({"laser_m": 12.0}, [0, 0, 0], 0.0),
    "nothing to judge": ({"signal": 5.0}, REGISTERS, 0.0),
}


@pytest.mark.parametrize("name", MARKS)
def test_plausibility(name: str) -> None:
    values, registers, expected = MARKS[name]
    assert plausibility(values, registers) == pytest.approx(expected)


def test_ids() -> None:
    assert parse_ids("80, 1-3,2") == (80, 1, 2, 3)
    for text in ("", "0", "248", "3-1", "x", "1-", "-5", "1--2"):
        with pytest.raises(ValueError, match="ids "):
            parse_ids(text)
