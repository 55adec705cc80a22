"""Simulated slaves as an independent Modbus client (pymodbus) sees them, over TCP and over a pseudo-terminal."""

from __future__ import annotations

import asyncio
import math
import os
import struct
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Literal

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerType

from heaved.devices.profile import Block, DeviceSpec, Field, Profile, Quantity
from heaved.links import SerialLink, TcpLink, parse_link
from heaved.samples import GRAVITY_MPS2, ImuSample, LaserSample, Sample
from heaved.simulate.faults import parse_faults
from heaved.simulate.gauge import LASER_DISTANCE_M
from heaved.simulate.instruments import Instruments
from heaved.simulate.plant import SimulatedPlant
from heaved.simulate.play import Player, read_recording
from heaved.simulate.seaway import seaway
from heaved.simulate.slave import RtuPace, Slave

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
    from pathlib import Path

    from pymodbus.pdu import ModbusPDU

    from heaved.simulate.vessel import Motion

Client = AsyncModbusTcpClient | AsyncModbusSerialClient

ACCELERATIONS: tuple[Quantity, ...] = ("ax_mps2", "ay_mps2", "az_mps2")
# A WitMotion-like map: accelerations and angles as int16.
IMU_PROFILE = Profile(
    name="imu",
    blocks=(
        Block(
            start=0x34,
            fields=tuple(
                Field(quantity=quantity, offset=offset, scale=16.0 / 32768, unit="g")
                for offset, quantity in enumerate(ACCELERATIONS)
            ),
        ),
        Block(
            start=0x3D,
            fields=(
                Field(quantity="roll_rad", offset=0, scale=180.0 / 32768, unit="deg"),
                Field(quantity="pitch_rad", offset=1, scale=180.0 / 32768, unit="deg", sign=-1),
            ),
        ),
    ),
)
# A Baumer-like map: float32 millimetres, low word first, in input registers.
LASER_PROFILE = Profile(
    name="laser",
    blocks=(
        Block(
            function="input",
            start=200,
            fields=(
                Field(quantity="signal", offset=0, type="uint16"),
                Field(quantity="laser_m", offset=2, type="float32", byte_order="CDAB", unit="mm"),
            ),
        ),
    ),
)


def specs(imu_link: str = "tcp://127.0.0.1:1", laser_link: str = "tcp://127.0.0.1:2") -> list[DeviceSpec]:
    return [
        DeviceSpec(name="imu", role="imu", link=imu_link, device_id=0x50, profile=IMU_PROFILE, rate_hz=100.0),
        DeviceSpec(name="laser", role="laser", link=laser_link, device_id=7, profile=LASER_PROFILE, rate_hz=20.0),
    ]


class Clock:
    """Time that moves when the test says so."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


class Fixed:
    """A source that always says the same, and remembers when it was asked."""

    def __init__(self, laser_m: float = 1.8035) -> None:
        self.asked: list[tuple[str, float]] = []
        self.heard = asyncio.Event()
        self.laser_m = laser_m

    def read(self, device: DeviceSpec, t_s: float) -> Sample:
        self.asked.append((device.name, t_s))
        self.heard.set()
        if device.role == "laser":
            return LaserSample(t_s=t_s, laser_m=self.laser_m)
        return ImuSample(
            t_s=t_s, ax_mps2=-GRAVITY_MPS2, ay_mps2=0.0, az_mps2=GRAVITY_MPS2,
            roll_rad=math.radians(90.0), pitch_rad=math.radians(45.0),
        )  # fmt: skip


@asynccontextmanager
async def running(plant: SimulatedPlant) -> AsyncIterator[SimulatedPlant]:
    await plant.start()
    try:
        yield plant
    finally:
        await plant.stop()


@asynccontextmanager
async def connected(plant: SimulatedPlant, name: str, timeout_s: float = 1.0) -> AsyncIterator[Client]:
    link = parse_link(next(device.link for device in plant.devices if device.name == name))
    if isinstance(link, TcpLink):
        client: Client = AsyncModbusTcpClient(
            link.host, port=link.port, timeout=timeout_s, retries=0, reconnect_delay=0
        )
    else:
        client = AsyncModbusSerialClient(
            link.path, framer=FramerType.RTU, baudrate=link.baudrate, timeout=timeout_s, retries=0, reconnect_delay=0
        )
    assert await client.connect()
    try:
        yield client
    finally:
        client.close()


def stands_at(path: str | Path) -> bool:
    return os.path.lexists(path)


def signed(registers: Sequence[int]) -> list[int]:
    return [register - 65536 * (register >> 15) for register in registers]


async def imu_registers(client: Client) -> list[int]:
    answer = await client.read_holding_registers(0x34, count=3, device_id=0x50)
    assert not answer.isError()
    return signed(answer.registers)


async def laser_m(client: Client) -> float:
    answer = await client.read_input_registers(200, count=4, device_id=7)
    assert not answer.isError(), answer
    (millimetres,) = struct.unpack(">f", struct.pack(">HH", answer.registers[3], answer.registers[2]))
    return float(millimetres) / 1000.0


@pytest.fixture(params=["tcp", "rtu"])
def links(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[str, str]:
    if request.param == "tcp":
        return "tcp://127.0.0.1:1", "tcp://127.0.0.1:1"
    line = f"rtu://{tmp_path}/line?baudrate=115200"
    return line, line


async def test_registers_hold_the_values_of_the_map(links: tuple[str, str]) -> None:
    async with running(SimulatedPlant(specs(*links), Fixed(), any_port=True)) as plant, connected(plant, "imu") as bus:
        assert await imu_registers(bus) == [-2048, 0, 2048]  # 1 g of 16 g in 15 bits
        answer = await bus.read_holding_registers(0x3D, count=2, device_id=0x50)
        assert signed(answer.registers) == [16384, -8192]  # 90 degrees, and 45 against the sign
        assert await laser_m(bus) == pytest.approx(1.8035, abs=1e-6)  # second unit on the same line
        part = await bus.read_holding_registers(0x36, count=1, device_id=0x50)
        assert part.registers == [2048]


def distance_m(motion: Motion[float]) -> float:
    """Of a laser that looks straight down from the vessel on a level target."""
    return (LASER_DISTANCE_M + motion.heave_m) / math.cos(motion.roll_rad) / math.cos(motion.pitch_rad)


async def test_a_sea_read_live_is_the_truth_of_the_moment_of_the_request() -> None:
    sea, clock = seaway("S6", seed=3), Clock()
    plant = SimulatedPlant(
        specs(), Instruments(sea, sensor="ideal", seed=1), clock=clock, any_port=True
    )  # fmt: skip
    async with running(plant), connected(plant, "laser") as laser, connected(plant, "imu") as imu:
        for _ in range(20):
            clock.now += 0.7
            t = plant.time_s()
            # 5 sigma of the laser's 2 mm; the loop's own clock moves by microseconds meanwhile.
            assert await laser_m(laser) == pytest.approx(distance_m(sea.at(t)), abs=0.011)
            answer = await imu.read_holding_registers(0x3D, count=1, device_id=0x50)
            roll_deg = signed(answer.registers)[0] * 180.0 / 32768
            assert roll_deg == pytest.approx(math.degrees(sea.at(t).roll_rad), abs=0.02)


@pytest.mark.parametrize(
    ("read", "code"),
    [
        (lambda bus: bus.read_holding_registers(0x33, count=3, device_id=0x50), 2),
        (lambda bus: bus.read_holding_registers(0x34, count=4, device_id=0x50), 2),
        (lambda bus: bus.read_input_registers(0x34, count=3, device_id=0x50), 2),
        (lambda bus: bus.read_coils(0, count=1, device_id=0x50), 1),
        (lambda bus: bus.write_register(0x34, 1, device_id=0x50), 1),
        (lambda bus: bus.read_holding_registers(0x34, count=3, device_id=9), 0x0B),
    ],
)
async def test_what_a_slave_refuses(read: Callable[[Client], Awaitable[ModbusPDU]], code: int) -> None:
    async with running(SimulatedPlant(specs(), Fixed(), any_port=True)) as plant, connected(plant, "imu") as bus:
        answer = await read(bus)
        assert answer.isError()
        assert answer.exception_code == code


async def test_nobody_of_that_id_on_a_serial_line_is_silence(tmp_path: Path) -> None:
    line = f"rtu://{tmp_path}/line?baudrate=115200"
    async with (
        running(SimulatedPlant(specs(line, line), Fixed())) as plant,
        connected(plant, "imu", timeout_s=0.05) as bus,
    ):
        with pytest.raises(ModbusException):
            await bus.read_holding_registers(0x34, count=3, device_id=9)


async def test_a_missing_value_is_refused_as_a_device_failure() -> None:
    plant = SimulatedPlant(specs(), Fixed(laser_m=math.nan), any_port=True)
    async with running(plant), connected(plant, "laser") as bus:
        answer = await bus.read_input_registers(200, count=4, device_id=7)
        assert answer.exception_code == 4


async def test_a_recording_is_played_through_the_registers(tmp_path: Path) -> None:
    path, clock = tmp_path / "r.csv", Clock()
    header = "t_s,ax_mps2,ay_mps2,az_mps2,laser_m"
    path.write_text(f"{header}\n7.0,0.0,1.0,9.6,12.0\n7.2,0.0,1.0,10.0,\n7.4,0.0,1.0,9.8,12.4\n")
    plant = SimulatedPlant(specs(), Player(read_recording(path)), clock=clock, any_port=True)
    async with running(plant), connected(plant, "imu") as imu, connected(plant, "laser") as laser:
        clock.now += 0.1
        step = 16.0 * GRAVITY_MPS2 / 32768
        assert [value * step for value in await imu_registers(imu)] == pytest.approx([0.0, 1.0, 9.8], abs=step)
        assert await laser_m(laser) == pytest.approx(12.1, abs=0.01)
        angles = await imu.read_holding_registers(0x3D, count=2, device_id=0x50)
        assert angles.exception_code == 4  # the recording has no angles
        clock.now += 5.0
        assert (await imu.read_holding_registers(0x34, count=3, device_id=0x50)).exception_code == 4  # it is over


async def test_dropout_then_well_again(links: tuple[str, str]) -> None:
    clock = Clock()
    plant = SimulatedPlant(
        specs(*links), Fixed(), faults=parse_faults("imu:dropout@10+5"), clock=clock, any_port=True
    )  # fmt: skip
    async with running(plant), connected(plant, "imu", timeout_s=0.05) as bus:
        assert await imu_registers(bus) == [-2048, 0, 2048]
        clock.now += 12.0
        with pytest.raises(ModbusException):
            await imu_registers(bus)
        clock.now += 4.0
    async with running(plant), connected(plant, "imu") as bus:
        assert await imu_registers(bus) == [-2048, 0, 2048]


async def test_exception_frozen_spike_and_nan() -> None:
    clock, sea = Clock(), seaway("S6", seed=1)
    plan = "imu:exception@10+10=6,laser:frozen@10+10,imu:spike@30+10=-3,laser:spike@30+10=2"
    plan += ",imu:nan@50+10,laser:nan@50+10"
    plant = SimulatedPlant(
        specs(), Instruments(sea, sensor="ideal"), faults=parse_faults(plan), clock=clock, any_port=True
    )  # fmt: skip
    async with running(plant), connected(plant, "imu") as imu, connected(plant, "laser") as laser:
        clock.now += 11.0
        answer = await imu.read_holding_registers(0x34, count=3, device_id=0x50)
        assert answer.exception_code == 6
        first = await laser_m(laser)
        clock.now += 3.0
        assert await laser_m(laser) == first
        clock.now += 7.0
        assert await laser_m(laser) != first
        clock.now += 10.0
        t = plant.time_s()
        assert await laser_m(laser) == pytest.approx(distance_m(sea.at(t)) + 2.0, abs=0.011)
        ideal = Instruments(sea, sensor="ideal").read(plant.devices[0], t)
        assert isinstance(ideal, ImuSample)
        spiked = (await imu_registers(imu))[2] * 16.0 * GRAVITY_MPS2 / 32768
        assert spiked == pytest.approx(ideal.az_mps2 - 3.0, abs=0.01)
        clock.now += 20.0
        assert math.isnan(await laser_m(laser))
        assert await imu_registers(imu) == [32767, 32767, 32767]


async def test_late_answers_come_late_with_their_own_transaction() -> None:
    source = Fixed()
    plant = SimulatedPlant(specs(), source, any_port=True)
    async with running(plant):
        link = parse_link(plant.devices[0].link)
        assert isinstance(link, TcpLink)
        reader, writer = await asyncio.open_connection(link.host, link.port)
        plant.inject(*parse_faults("imu:late@0+1000=300"))
        writer.write(bytes.fromhex("0001 0000 0006 50 03 0034 0001"))
        await source.heard.wait()
        plant.clear()
        writer.write(bytes.fromhex("0002 0000 0006 50 03 0035 0001"))
        answers = [await reader.readexactly(11) for _ in range(2)]
        writer.close()
    assert [answer[:2] for answer in answers] == [b"\x00\x02", b"\x00\x01"]
    assert answers[1][9:] == struct.pack(">h", -2048)


async def test_a_late_answer_on_a_serial_line_meets_the_next_request(tmp_path: Path) -> None:
    line = f"rtu://{tmp_path}/line?baudrate=115200"
    plant = SimulatedPlant(specs(line, line), Fixed(), faults=parse_faults("laser:late@0+1000=30"))
    async with running(plant):
        port = os.open(tmp_path / "line", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            os.write(port, bytes.fromhex("07 04 00c8 0004 7051"))
            heard = await bytes_from(port, 13)
            os.write(port, bytes.fromhex("50 03 0036 0001 6985"))
            heard += await bytes_from(port, 7)
        finally:
            os.close(port)
    assert heard[:3] == bytes([7, 4, 8])
    assert heard[13:18] == bytes.fromhex("50 03 02 0800")


async def bytes_from(port: int, count: int) -> bytes:
    """Read ``count`` bytes from a file descriptor as they come."""
    heard, loop, done = b"", asyncio.get_running_loop(), asyncio.Event()

    def on_bytes() -> None:
        nonlocal heard
        heard += os.read(port, 256)
        if len(heard) >= count:
            done.set()

    loop.add_reader(port, on_bytes)
    try:
        async with asyncio.timeout(5.0):
            await done.wait()
    finally:
        loop.remove_reader(port)
    return heard


async def test_garbage_has_no_valid_frame_in_it(tmp_path: Path) -> None:
    line = f"rtu://{tmp_path}/line?baudrate=115200"
    plant = SimulatedPlant(specs(line, line), Fixed(), faults=parse_faults("laser:garbage@0+1000"))
    async with running(plant):
        port = os.open(tmp_path / "line", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            os.write(port, bytes.fromhex("07 04 00c8 0004 7051"))
            heard = await bytes_from(port, 13)
        finally:
            os.close(port)
    assert len(heard) == 13
    assert heard[:2] != bytes([7, 4])


async def test_disconnect_takes_the_line_away_and_brings_it_back(links: tuple[str, str]) -> None:
    plant = SimulatedPlant(specs(*links), Fixed(), any_port=True)
    async with running(plant):
        async with connected(plant, "imu", timeout_s=0.2) as bus:
            assert await imu_registers(bus) == [-2048, 0, 2048]
            plant.inject(*parse_faults("laser:disconnect@0+1000"))  # the other device on the same line
            await plant.settled()
            with pytest.raises(ModbusException):
                await imu_registers(bus)
        link = parse_link(plant.devices[0].link)
        if isinstance(link, TcpLink):
            with pytest.raises(OSError):  # noqa: PT011
                await asyncio.open_connection(link.host, link.port)
        else:
            assert not stands_at(link.path)
        plant.clear()
        await plant.settled()
        async with connected(plant, "imu") as bus:
            assert await imu_registers(bus) == [-2048, 0, 2048]


async def test_the_path_of_a_serial_line_is_ours_or_left_alone(tmp_path: Path) -> None:
    line = f"rtu://{tmp_path}/line?baudrate=115200"
    (tmp_path / "line").symlink_to("/nowhere")  # left behind by a plant that was killed
    async with running(SimulatedPlant(specs(line, line), Fixed())):
        assert (tmp_path / "line").is_char_device()
    assert not stands_at(tmp_path / "line")
    (tmp_path / "line").write_text("a file of somebody")
    with pytest.raises(FileExistsError, match="not a symbolic link"):
        await SimulatedPlant(specs(line, line), Fixed()).start()
    assert (tmp_path / "line").read_text() == "a file of somebody"


@pytest.mark.parametrize(
    ("baudrate", "parity", "character_s", "silence_s", "poll_s"),
    [
        # 12 registers: 8 + 29 characters and two silences. 45.8 ms and 6.7 ms are the field's figures.
        (9600, "N", 10 / 9600, 3.5 * 10 / 9600, 45.8e-3),
        (115200, "N", 10 / 115200, 1.75e-3, 6.7e-3),
        (9600, "E", 11 / 9600, 3.5 * 11 / 9600, 50.4e-3),
    ],
)
def test_a_serial_line_takes_its_time(
    baudrate: int, parity: Literal["N", "E", "O"], character_s: float, silence_s: float, poll_s: float
) -> None:
    pace = RtuPace(SerialLink("/dev/x", baudrate=baudrate, parity=parity))
    heard = pace.heard_at(100.0, 8)
    assert heard - 100.0 == pytest.approx(8 * character_s)
    done = pace.answered_at(heard, 29)
    assert done - heard == pytest.approx(silence_s + 29 * character_s)
    # A master that asks again at once is heard only after the silence that it should have kept.
    again = pace.heard_at(done, 8)
    assert again - heard == pytest.approx(poll_s, abs=0.05e-3)
    # One that asks much later is not held up.
    assert pace.heard_at(done + 5.0, 8) - done - 5.0 == pytest.approx(8 * character_s)


async def test_the_sample_is_of_the_moment_at_which_the_request_was_heard(tmp_path: Path) -> None:
    """On a line of 1200 baud a request of 8 characters takes 66.7 ms."""
    source, clock = Fixed(), Clock()
    line = f"rtu://{tmp_path}/line?baudrate=1200"
    plant = SimulatedPlant(specs(line, line), source, clock=clock)
    async with running(plant), connected(plant, "imu") as bus:
        clock.now += 5.0
        await imu_registers(bus)
    ((name, asked_s),) = source.asked
    assert name == "imu"
    assert asked_s == pytest.approx(5.0 + 0.0667, abs=0.02)


def test_a_slave_answers_without_any_line() -> None:
    slave = Slave(specs()[0], Fixed())
    assert slave.answer(bytes.fromhex("03 0036 0001"), 1.0, ()).pdu == bytes.fromhex("03 02 0800")
    assert slave.answer(bytes.fromhex("03 0036 0000"), 1.0, ()).pdu == bytes.fromhex("83 03")


@given(st.binary(min_size=1, max_size=12))
def test_any_request_has_an_answer_of_its_own_function(request: bytes) -> None:
    answer = Slave(specs()[0], Fixed()).answer(request, 1.0, ()).pdu
    assert answer[0] | 0x80 == request[0] | 0x80
    assert len(answer) == (2 if answer[0] & 0x80 else 2 + answer[1])


@pytest.mark.parametrize(
    ("devices", "message"),
    [
        ([specs()[0], specs()[0]], "two devices are called 'imu'"),
        ([specs()[0], msgspec.structs.replace(specs()[0], name="b")], "b and imu have the same device_id 80"),
        (specs("tcp://h:1", "udp://h:1"), "unknown scheme"),
        (specs("rtu:///tmp/x?baudrate=9600", "rtu:///tmp/x?baudrate=19200"), "make them alike"),
    ],
)
def test_plants_that_cannot_be(devices: list[DeviceSpec], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SimulatedPlant(devices, Fixed())


def test_faults_of_unknown_devices_are_refused() -> None:
    with pytest.raises(ValueError, match=r"no device 'imo'; there are imu, laser"):
        SimulatedPlant(specs(), Fixed(), faults=parse_faults("imo:dropout@0+1"))
