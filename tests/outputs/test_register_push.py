"""Writing into a PLC: pymodbus' own server, and PLCs that refuse, are silent, answer late, close, talk nonsense."""

from __future__ import annotations

import asyncio
import logging
import re
import struct
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

import pytest
from modbus_slaves import TcpSlave, mbap_answer, rtu
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice
from running_outputs import golden_frame, output_running, until
from serial_lines import NullModem
from structlog.testing import capture_logs

from heaved.links import SerialLink, TcpLink
from heaved.outputs import register_push as module
from heaved.outputs.register_map import RegisterMap, RegistersParams, write_time_s
from heaved.outputs.register_push import RegisterPush

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from pathlib import Path

    from heaved.links import Link

T_S = 1000.0
GOLDEN = [0x0131, 0xFFA8, 0xFFBA, 0x0010, 0xFFC1]
DONE = struct.pack(">BHH", 16, 3, 6)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RETRY_S", 0.01)


def push_to(link: Link, clock: Callable[[], float] = lambda: T_S, **params: Any) -> RegisterPush:
    settings = RegistersParams(**({"rate_hz": 100.0} | params))
    output = RegisterPush(settings, link, RegisterMap(settings, (), lambda t_s: t_s), clock)
    output.publish(golden_frame(T_S))
    return output


# ---- pymodbus' server ------------------------------------------------------------------------------------------------


def plc_memory(device_id: int) -> SimDevice:
    return SimDevice(device_id, simdata=[SimData(0, count=50, values=0, datatype=DataType.REGISTERS)])


@asynccontextmanager
async def pymodbus_server(server: Any) -> AsyncIterator[Any]:
    logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)
    await server.serve_forever(background=True)
    try:
        yield server
    finally:
        await server.shutdown()


async def memory_of(server: Any, device_id: int, first: int, count: int) -> list[int]:
    words: list[int] = await server.async_getValues(device_id, 3, first, count)
    return words


async def check_pushing(server: Any, output: RegisterPush, device_id: int) -> None:
    async with output_running(output):
        await until(lambda: output.health.sent > 0)
        assert output.health.is_up
        assert await memory_of(server, device_id, 0, 12) == [0, 0, 0, *GOLDEN, 1, 0, 0, 0]
        output.publish(golden_frame(T_S))
        sent = output.health.sent
        await until(lambda: output.health.sent > sent + 1)
        assert (await memory_of(server, device_id, 8, 1)) == [2]
        assert not output.health.lost
    # It has ended: the PLC's copy of the counter stands.
    output.publish(golden_frame(T_S))
    assert (await memory_of(server, device_id, 8, 1)) == [2]


async def test_a_pymodbus_server_on_tcp(unused_tcp_port: int) -> None:
    async with pymodbus_server(ModbusTcpServer(plc_memory(5), address=("127.0.0.1", unused_tcp_port))) as server:
        await check_pushing(server, push_to(TcpLink("127.0.0.1", unused_tcp_port), device_id=5), 5)


async def test_a_pymodbus_server_that_has_too_few_registers(unused_tcp_port: int) -> None:
    """The fault is said once, and writing goes on."""
    async with pymodbus_server(ModbusTcpServer(plc_memory(1), address=("127.0.0.1", unused_tcp_port))):
        output = push_to(TcpLink("127.0.0.1", unused_tcp_port), start=60000)
        with capture_logs() as logs:
            async with output_running(output):
                await until(lambda: output.health.lost["refused"] > 3)
        assert "exception 2, illegal data address" in output.health.detail
        assert "correct [registers] start and count" in output.health.detail
        assert [line["event"] for line in logs] == ["output down"]


async def test_a_pymodbus_server_on_a_serial_line(line: NullModem, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_LATEST_S", 0.05)
    async with pymodbus_server(ModbusSerialServer(plc_memory(5), port=str(line.theirs), baudrate=115200)) as server:
        await check_pushing(server, push_to(SerialLink(str(line.ours), baudrate=115200), device_id=5), 5)


# ---- PLCs on TCP that are not so well --------------------------------------------------------------------------------


def number_of(request: bytes) -> int:
    return int.from_bytes(request[:2])


def done(request: bytes) -> bytes:
    return mbap_answer(number_of(request), request[6], DONE)


@asynccontextmanager
async def plc(answer: Callable[[bytes], bytes | None], idle_s: float | None = None) -> AsyncIterator[TcpSlave]:
    slave = TcpSlave(answer, idle_s)
    await slave.start()
    try:
        yield slave
    finally:
        await slave.stop()


def to(slave: TcpSlave, **params: Any) -> RegisterPush:
    return push_to(TcpLink("127.0.0.1", slave.port), **params)


async def test_what_is_written() -> None:
    async with plc(done) as slave:
        output = to(slave, device_id=255, start=1000, count=7)
        async with output_running(output):
            await until(lambda: slave.requests)
    head = bytes.fromhex("0001 0000 0015 FF 10 03E8 0007 0E")
    assert slave.requests[0] == head + b"".join(word.to_bytes(2) for word in (*GOLDEN, 1, 3))


async def test_one_write_is_outstanding_and_a_plc_without_frames_is_told_that_nothing_is_known() -> None:
    clock = iter([T_S + 1.0] * 1000)
    async with plc(done) as slave:
        output = to(slave, clock=lambda: next(clock))
        async with output_running(output):
            await until(lambda: output.health.sent > 2)
        for request in slave.requests:
            assert request[13:] == b"\x80\x00" * 5 + b"\x00\x01"
        assert len(slave.requests) <= output.health.sent + 1


async def test_a_refusal_is_said_once_and_the_plc_may_change_its_mind() -> None:
    refuses = True

    def answer(request: bytes) -> bytes:
        return mbap_answer(number_of(request), request[6], b"\x90\x01") if refuses else done(request)

    async with plc(answer) as slave:
        with capture_logs() as logs:
            output = to(slave)
            async with output_running(output):
                await until(lambda: output.health.lost["refused"] > 3)
                assert "exception 1, illegal function: the PLC does not take function 16" in output.health.detail
                refuses = False
                await until(lambda: output.health.is_up)
        assert [line["event"] for line in logs] == ["output down", "output up"]
        assert slave.connections == 1


@pytest.mark.parametrize("late", [False, True], ids=["silent", "answers the request before"])
async def test_a_plc_without_answers_in_time(late: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A late answer is never taken for that of the next write. In place of a connection that is mute comes another."""
    monkeypatch.setattr(module, "ANSWER_S", 0.02)
    before: list[bytes] = []

    def answer(request: bytes) -> bytes:
        before.append(request)
        return done(before[-2]) if late and len(before) > 1 else b""

    async with plc(answer) as slave:
        with capture_logs() as logs:
            output = to(slave)
            async with output_running(output):
                await until(lambda: output.health.lost["timeout"] > 7)
        assert output.health.sent == 0
        assert "no answer within 20 ms: check that the PLC runs" in output.health.detail
        assert [line["event"] for line in logs] == ["output down"]
        assert (slave.connections == 1) == late


async def test_an_answer_that_is_missed_now_and_then_is_counted_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "ANSWER_S", 0.3)

    def answer(request: bytes) -> bytes:
        return b"" if number_of(request) % 4 == 0 else done(request)

    async with plc(answer) as slave:
        with capture_logs() as logs:
            output = to(slave)
            async with output_running(output):
                await until(lambda: output.health.lost["timeout"] > 2)
        assert [line["event"] for line in logs] == ["output up"]
        assert output.health.sent > 2 * output.health.lost["timeout"]


async def test_a_plc_that_closes_after_each_answer() -> None:
    async with plc(done, idle_s=0.0) as slave:
        with capture_logs() as logs:
            output = to(slave)
            async with output_running(output):
                await until(lambda: output.health.sent > 10)
        assert slave.connections > 9
        assert [line["event"] for line in logs] == ["output up"]
        assert not output.health.lost


async def test_a_plc_that_closes_instead_of_answering() -> None:
    async with plc(lambda request: None) as slave:
        output = to(slave)
        async with output_running(output):
            await until(lambda: output.health.lost["lost"] > 2)
        assert "closes the connection without an answer" in output.health.detail
        assert output.health.sent == 0


@pytest.mark.parametrize(
    ("nonsense", "detail"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n", "no Modbus TCP: 48 54 54 50"),
        (bytes(2000), "bytes where an answer has twelve"),
    ],
)
async def test_what_is_no_plc(nonsense: bytes, detail: str) -> None:
    async with plc(lambda request: nonsense) as slave:
        output = to(slave)
        async with output_running(output):
            await until(lambda: output.health.lost["lost"] > 2)
        assert detail in output.health.detail


@pytest.mark.parametrize("answer", [b"\x10\x00\x03\x00\x05", b"\x03\x02\x00\x00", b"\x83\x02", b"\x90"])
async def test_an_answer_to_something_else_is_none(answer: bytes) -> None:
    async with plc(lambda request: mbap_answer(number_of(request), request[6], answer)) as slave:
        output = to(slave)
        async with output_running(output):
            await until(lambda: output.health.lost["lost"] > 2)
        assert (output.health.sent, output.health.is_up) == (0, False)


@pytest.mark.parametrize("host", ["nowhere.invalid", "a" * 300])
async def test_a_host_that_has_no_address(host: str) -> None:
    output = push_to(TcpLink(host, 502))
    async with output_running(output):
        await until(lambda: output.health.lost["not_connected"] > 1)
    assert re.search("check it, or write the IP address|check network and address|no name server", output.health.detail)


async def test_a_plc_that_is_switched_on_later_and_off_again(unused_tcp_port: int) -> None:
    output = push_to(TcpLink("127.0.0.1", unused_tcp_port))
    slave = TcpSlave(done)
    with capture_logs() as logs:
        async with output_running(output):
            await until(lambda: output.health.lost["not_connected"] > 2)
            assert "connection refused: check that the device serves Modbus TCP" in output.health.detail
            await slave.start(unused_tcp_port)
            await until(lambda: output.health.is_up)
            await slave.stop()
            await until(lambda: not output.health.is_up)
            await slave.start(unused_tcp_port)
            await until(lambda: output.health.is_up)
    await slave.stop()
    assert [line["event"] for line in logs if line["event"] == "output up"] == ["output up"] * 2


# ---- serial lines ----------------------------------------------------------------------------------------------------


@pytest.fixture
async def line(tmp_path: Path) -> AsyncIterator[NullModem]:
    modem = NullModem(tmp_path)
    modem.plug_in()
    yield modem
    modem.unplug()


class SerialPlc:
    """Hears whole writes of six registers at the other end; ``answer`` says what to say, and how much later."""

    def __init__(self, line: NullModem, answer: Callable[[bytes], tuple[bytes, float]]) -> None:
        self.requests: list[bytes] = []
        self.said = 0
        self._answer, self._heard = answer, b""
        self._port = open(line.theirs, "rb+", buffering=0)  # noqa: SIM115, PTH123
        asyncio.get_running_loop().add_reader(self._port, self._readable)

    def _readable(self) -> None:
        self._heard += self._port.read(4096)
        while len(self._heard) >= 21:
            request, self._heard = self._heard[:21], self._heard[21:]
            assert rtu(request[:-2]) == request
            self.requests.append(request)
            words, late_s = self._answer(request)
            asyncio.get_running_loop().call_later(late_s, self._say, words)

    def _say(self, words: bytes) -> None:
        if not self._port.closed:
            self.said += 1
            self._port.write(words)

    def close(self) -> None:
        if not self._port.closed:
            asyncio.get_running_loop().remove_reader(self._port)
            self._port.close()


SERIAL_DONE = rtu(b"\x01" + DONE)


@asynccontextmanager
async def pushing_into(
    line: NullModem, answer: Callable[[bytes], tuple[bytes, float]], **params: Any
) -> AsyncIterator[tuple[RegisterPush, SerialPlc]]:
    far = SerialPlc(line, answer)
    try:
        async with output_running(push_to(SerialLink(str(line.ours), baudrate=115200), **params)) as output:
            yield output, far
    finally:
        far.close()


@pytest.mark.parametrize(
    ("around", "counted"),
    [
        (lambda request: SERIAL_DONE, "sent"),
        (lambda request: request + SERIAL_DONE, "sent"),
        (lambda request: b"\xff\x00" + SERIAL_DONE + b"\x00", "sent"),
        (lambda request: rtu(b"\x01\x90\x03"), "refused"),
        (lambda request: rtu(b"\x02" + DONE), "timeout"),
        (lambda request: SERIAL_DONE[:-1] + b"\x00", "timeout"),
        (lambda request: b"", "timeout"),
        (lambda request: request, "timeout"),
        (lambda request: b"\x55" * 3000, "timeout"),
    ],
    ids=["well", "echo", "noise", "refusal", "another id", "checksum", "silence", "echo alone", "flood"],
)
async def test_answers_on_a_serial_line(
    line: NullModem, around: Callable[[bytes], bytes], counted: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_LATEST_S", 0.05)
    if counted == "timeout":
        monkeypatch.setattr(module, "ANSWER_S", 0.05)
    async with pushing_into(line, lambda request: (around(request), 0.0)) as (output, _):
        await until(lambda: (output.health.sent if counted == "sent" else output.health.lost[counted]) > 1)
        assert set(output.health.lost) == ({counted} - {"sent"})
        assert (output.health.sent > 0) == (counted == "sent")


async def test_a_late_answer_on_a_serial_line_is_waited_for_and_thrown_away(
    line: NullModem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All of them look alike: so none may be under way when the next write goes out."""
    monkeypatch.setattr(module, "ANSWER_S", 0.02)
    monkeypatch.setattr(module, "_LATEST_S", 0.5)
    far: list[SerialPlc] = []
    under_way: list[int] = []

    def answer(request: bytes) -> tuple[bytes, float]:
        under_way.append(len(far[0].requests) - 1 - far[0].said if far else 0)
        return SERIAL_DONE, 0.1

    async with pushing_into(line, answer) as (output, plc_there):
        far.append(plc_there)
        await until(lambda: output.health.lost["timeout"] > 2)
        assert output.health.sent == 0
        assert under_way == [0] * len(under_way)


async def test_a_serial_line_that_goes_and_comes_back(line: NullModem, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_LATEST_S", 0.05)
    async with pushing_into(line, lambda request: (SERIAL_DONE, 0.0)) as (output, far):
        await until(lambda: output.health.is_up)
        far.close()
        line.unplug()
        await until(lambda: "is not there: plug the adapter in" in output.health.detail)
        line.plug_in()
        again = SerialPlc(line, lambda request: (SERIAL_DONE, 0.0))
        await until(lambda: output.health.is_up)
        again.close()


@pytest.mark.parametrize(
    ("link", "count", "milliseconds"),
    [
        (TcpLink("10.0.0.1", 502), 6, 0.0),
        # 21 + 8 characters of 10 bits, and two silences of 3.5.
        (SerialLink("/dev/ttyS0", baudrate=9600), 6, 1e3 * (29 + 7) * 10 / 9600),
        # Of 11 bits; silences of 1.75 ms.
        (SerialLink("/dev/ttyS0", baudrate=115200, parity="E"), 66, 1e3 * 149 * 11 / 115200 + 3.5),
    ],
)
def test_how_long_a_write_takes(link: Link, count: int, milliseconds: float) -> None:
    assert 1e3 * write_time_s(link, count) == pytest.approx(milliseconds)
