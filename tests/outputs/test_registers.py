"""The registers as PLCs read them: pymodbus' own client and mbpoll, on TCP and on a serial line, and what else there is
on a line: writes, other slaves, garbage, floods, a client that never reads.
"""

from __future__ import annotations

import asyncio
import re
import shutil
import signal
import socket
import struct
import sys
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

import pytest
from modbus_slaves import mbap_answer, pdu_answer, rtu
from output_peers import nobody_asks
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from running_outputs import PATIENCE_S, golden_frame, output_running, until
from serial_lines import NullModem
from structlog.testing import capture_logs

from heaved.config import Config
from heaved.daemon.outputs import Outputs
from heaved.links import SerialLink, TcpLink, parse_link
from heaved.outputs import registers as module
from heaved.outputs.register_map import Mode, RegisterMap, RegistersParams
from heaved.outputs.register_push import RegisterPush
from heaved.outputs.registers import MAX_CONNECTIONS, RtuRegisters, TcpRegisters, register_output

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from pathlib import Path

    from pymodbus.client.base import ModbusBaseClient

GOLDEN = [0x0131, 0xFFA8, 0xFFBA, 0x0010, 0xFFC1]
T_S = 1000.0
ASK = struct.pack(">BHH", 3, 3, 6)
mbpoll = pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll (Debian) is not installed")


class Clock:
    """Stands still until it is set, so that the words are those of the frame."""

    def __init__(self) -> None:
        self.now_s = T_S

    def __call__(self) -> float:
        return self.now_s


def tcp_server(clock: Callable[[], float], port: int = 0, **params: Any) -> TcpRegisters:
    settings = RegistersParams(**params)
    registers = RegisterMap(settings, (), lambda t_s: t_s)
    return TcpRegisters(settings, TcpLink("127.0.0.1", port), registers, clock)


@asynccontextmanager
async def serving(clock: Clock | None = None, **params: Any) -> AsyncIterator[TcpRegisters]:
    """A server that tells the golden frame."""
    server = tcp_server(clock or Clock(), **params)
    server.publish(golden_frame(T_S))
    async with output_running(server):
        await until(lambda: server.address is not None)
        yield server


def address(server: TcpRegisters) -> tuple[str, int]:
    assert server.address is not None
    return server.address


class Master:
    """A raw client on TCP."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self._transaction = 0

    async def ask(self, pdu: bytes = ASK, unit: int = 1) -> bytes:
        """The answer's frame without its header; checks that."""
        self._transaction += 1
        self.writer.write(mbap_answer(self._transaction, unit, pdu))
        return await self.answer(self._transaction, unit)

    async def answer(self, transaction: int, unit: int = 1) -> bytes:
        async with asyncio.timeout(PATIENCE_S):
            head = await self.reader.readexactly(7)
            number, protocol, length, answered = struct.unpack(">HHHB", head)
            assert (number, protocol, answered) == (transaction, 0, unit)
            return await self.reader.readexactly(length - 1)

    async def is_closed(self) -> bool:
        """Whether the server closes the connection, before a byte."""
        async with asyncio.timeout(PATIENCE_S):
            try:
                return await self.reader.read(1) == b""
            except ConnectionError:
                return True


@asynccontextmanager
async def master(server: TcpRegisters) -> AsyncIterator[Master]:
    reader, writer = await asyncio.open_connection(*address(server))
    try:
        yield Master(reader, writer)
    finally:
        writer.transport.abort()


WELL = pdu_answer(3, [*GOLDEN, 1])

# ---- masters of other makers -----------------------------------------------------------------------------------------


@asynccontextmanager
async def pymodbus_client(client: ModbusBaseClient) -> AsyncIterator[Any]:
    assert await client.connect()
    try:
        yield client
    finally:
        client.close()


def tcp_client(server: TcpRegisters) -> ModbusBaseClient:
    host, port = address(server)
    return AsyncModbusTcpClient(host, port=port, timeout=PATIENCE_S, retries=0)


async def check_with_pymodbus(client: Any, device_id: int) -> None:
    """Reads, refused writes, refused addresses, as pymodbus sees them."""
    for read in (client.read_holding_registers, client.read_input_registers):
        answer = await read(3, count=6, device_id=device_id)
        assert answer.registers == [*GOLDEN, 1]
    whole = await client.read_holding_registers(3, count=66, device_id=device_id)
    assert whole.registers[6:9] == [3, 0, 20]
    one = await client.read_input_registers(8, count=1, device_id=device_id)
    assert one.registers == [1]
    assert (await client.read_holding_registers(2, count=1, device_id=device_id)).exception_code == 2
    assert (await client.read_holding_registers(3, count=67, device_id=device_id)).exception_code == 2
    for write in (
        client.write_register(3, 7, device_id=device_id),
        client.write_registers(3, [7, 8], device_id=device_id),
        client.write_coil(3, True, device_id=device_id),
        client.write_coils(3, [True] * 9, device_id=device_id),
        client.mask_write_register(address=3, and_mask=1, or_mask=2, device_id=device_id),
        client.readwrite_registers(read_address=3, read_count=1, write_address=3, values=[7], device_id=device_id),
        client.read_coils(3, count=1, device_id=device_id),
    ):
        assert (await write).exception_code == 1
    assert (await client.read_holding_registers(3, count=6, device_id=device_id)).registers == [*GOLDEN, 1]


async def test_pymodbus_on_tcp() -> None:
    async with serving() as server, pymodbus_client(tcp_client(server)) as client:
        await check_with_pymodbus(client, 1)
        assert server.health.lost == {"write": 6, "illegal_function": 1, "illegal_address": 2}
        assert server.health.sent == 5
        assert (await client.read_holding_registers(3, count=6, device_id=9)).exception_code == 11


async def poll(*arguments: str) -> tuple[int, str]:
    """(exit code, what mbpoll prints)."""
    process = await asyncio.create_subprocess_exec(
        "mbpoll", "-0", "-1", "-o", "10", *arguments, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
    )
    try:
        output, _ = await asyncio.wait_for(process.communicate(), PATIENCE_S)
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    assert process.returncode is not None
    return process.returncode, output.decode()


def words_in(output: str) -> list[int]:
    return [int(word, 16) for word in re.findall(r"(?m)^\[\d+\]:\s+0x([0-9A-F]{4})", output)]


@mbpoll
@pytest.mark.parametrize("kind", ["4:hex", "3:hex"])
async def test_mbpoll_on_tcp(kind: str) -> None:
    async with serving() as server:
        line = ("-m", "tcp", "-p", str(address(server)[1]), "-a", "1", "-r", "3")
        code, output = await poll(*line, "-c", "6", "-t", kind, "127.0.0.1")
        assert (code, words_in(output)) == (0, [*GOLDEN, 1]), output
        code, output = await poll(*line, "-t", "4", "127.0.0.1", "17", "18")
        assert "Illegal function" in output
        assert server.health.lost["write"] == 1


# ---- what a request gets on TCP --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("unit", "is_meant"), [(1, True), (0, True), (255, True), (2, False), (247, False)])
async def test_which_ids_are_meant(unit: int, is_meant: bool) -> None:
    async with serving() as server, master(server) as plc:
        assert await plc.ask(unit=unit) == (WELL if is_meant else b"\x83\x0b")
        assert server.health.lost == ({} if is_meant else {"wrong_device_id": 1})


async def test_the_configured_id_and_start() -> None:
    async with serving(device_id=17, start=1000) as server, master(server) as plc:
        assert await plc.ask(struct.pack(">BHH", 4, 1000, 2), unit=17) == pdu_answer(4, GOLDEN[:2])
        assert await plc.ask(struct.pack(">BHH", 4, 999, 2), unit=17) == b"\x84\x02"


async def test_the_words_are_of_the_moment_of_the_answer_and_stand_when_frames_stop() -> None:
    clock = Clock()
    async with serving(clock) as server, master(server) as plc:
        clock.now_s += 0.1
        heave, velocity, *_, counter = struct.unpack(">hhhhhH", (await plc.ask())[2:])
        assert (heave, velocity, counter) == (296, -95, 1)  # 305 - 8.8 - 0.35, -88 - 7
        for _ in range(3):
            clock.now_s += 1.0
            words = struct.unpack(">8H", (await plc.ask(struct.pack(">BHH", 3, 3, 8)))[2:])
            assert words[:5] == (0x8000,) * 5
            assert words[5:7] == (1, 0)
        server.publish(golden_frame(clock.now_s))
        assert await plc.ask() == pdu_answer(3, [*GOLDEN, 2])


# ---- disasters on TCP ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "garbage",
    [b"GET / HTTP/1.1\r\n\r\n", b"\0\1\0\0\0\1\1", b"\0\1\0\0\xff\xff\1\3", rtu(b"\1" + ASK), b"\xff" * 100_000],
    ids=["http", "too short", "too long", "rtu", "a flood"],
)
async def test_garbage_ends_its_connection_and_no_other(garbage: bytes) -> None:
    async with serving() as server, master(server) as plc, master(server) as other:
        assert await plc.ask() == WELL
        other.writer.write(garbage)
        assert await other.is_closed()
        assert server.health.lost == {"no_modbus": 1}
        assert await plc.ask() == WELL


async def test_a_request_in_pieces_is_answered_when_it_is_whole() -> None:
    async with serving() as server, master(server) as plc, master(server) as other:
        request = mbap_answer(1, 1, ASK)
        for i in range(len(request)):
            plc.writer.write(request[i : i + 1])
            assert await other.ask() == WELL
        assert await plc.answer(1) == WELL


async def test_many_requests_at_once_are_answered_in_order_and_hold_nobody_up() -> None:
    async with serving() as server, master(server) as hasty, master(server) as plc:
        hasty.writer.write(b"".join(mbap_answer(number, 1, ASK) for number in range(300)))
        assert await hasty.answer(0) == WELL
        assert await plc.ask() == WELL
        assert server.health.sent < 300
        for number in range(1, 300):
            assert await hasty.answer(number) == WELL


async def test_a_client_that_never_reads_is_disconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_STUCK_S", 0.05)
    monkeypatch.setattr(module, "_BURST_S", 0.0)
    request = mbap_answer(1, 1, struct.pack(">BHH", 3, 3, 66))
    async with serving() as server, master(server) as plc:
        with socket.socket() as deaf:
            deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            deaf.connect(address(server))
            deaf.setblocking(False)

            def is_out() -> bool:
                try:
                    deaf.send(request * 100)
                except BlockingIOError:
                    pass
                except ConnectionError:
                    return True
                return False

            await until(is_out)
        assert server.health.lost["stuck"] == 1
        assert await plc.ask() == WELL


async def test_of_two_hundred_connections_those_are_served_for_which_there_is_room() -> None:
    clock = Clock()
    async with serving(clock) as server, master(server) as plc:
        assert await plc.ask() == WELL
        crowd = [await asyncio.open_connection(*address(server)) for _ in range(200)]
        refused = 200 - (MAX_CONNECTIONS - 1)
        await until(lambda: server.health.lost["too_many_clients"] == refused)
        assert await plc.ask() == WELL
        clock.now_s += 11.0
        server.publish(golden_frame(clock.now_s))
        assert await plc.ask() == pdu_answer(3, [*GOLDEN, 2])
        # Now those that have never asked give way, and the one that asks does not.
        async with master(server) as late:
            assert await late.ask() == pdu_answer(3, [*GOLDEN, 2])
            assert await plc.ask() == pdu_answer(3, [*GOLDEN, 2])
        assert server.health.lost["too_many_clients"] == refused
        for _, writer in crowd:
            writer.transport.abort()


async def test_who_is_not_allowed_is_turned_away(monkeypatch: pytest.MonkeyPatch) -> None:
    async with serving() as server:
        monkeypatch.setattr(module, "is_allowed", lambda peer, networks: False)
        async with master(server) as stranger:
            assert await stranger.is_closed()
        assert server.health.lost == {"not_allowed": 1}


async def test_a_port_in_use_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RETRY_S", 0.01)
    with socket.create_server(("127.0.0.1", 0)) as taken, capture_logs() as logs:
        port = taken.getsockname()[1]
        server = tcp_server(Clock(), port)
        server.publish(golden_frame(T_S))
        async with output_running(server):
            await until(lambda: "in use" in server.health.detail)
            assert f"port {port} is in use: stop the other program, or give [registers] link" in server.health.detail
            taken.close()
            await until(lambda: server.health.is_up)
            async with master(server) as plc:
                assert await plc.ask() == WELL
    assert [line["event"] for line in logs] == ["output down", "output up"]


@pytest.mark.parametrize(
    ("host", "advice"), [("192.0.2.1", "an address of this machine"), ("a.invalid", "[registers]")]
)
async def test_an_address_that_is_not_ours(host: str, advice: str) -> None:
    settings = RegistersParams(allow=("192.0.2.0/24",))
    server = TcpRegisters(settings, TcpLink(host, 5502), RegisterMap(settings, (), float), Clock())
    async with output_running(server):
        await until(lambda: advice in server.health.detail)


async def test_writes_are_logged_once_for_all_alike() -> None:
    with capture_logs() as logs:
        async with serving() as server, master(server) as plc:
            for _ in range(3):
                assert await plc.ask(struct.pack(">BHH", 6, 3, 17)) == b"\x86\x01"
    refused = [line for line in logs if line["event"] == "registers: request refused"]
    assert {(line["reason"], line["alike"], line["peer"]) for line in refused} == {("write", "write", "127.0.0.1")}


async def test_when_it_ends_everything_is_given_back() -> None:
    async with serving() as server, master(server) as plc:
        assert await plc.ask() == WELL
        where = address(server)
        async with asyncio.timeout(PATIENCE_S):
            task = next(task for task in asyncio.all_tasks() if "TcpRegisters.run" in repr(task))
            task.cancel()
            await asyncio.wait([task])
        assert await plc.is_closed()
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection(*where)


# ---- a serial line ---------------------------------------------------------------------------------------------------


@pytest.fixture
async def line(tmp_path: Path) -> AsyncIterator[NullModem]:
    modem = NullModem(tmp_path)
    modem.plug_in()
    yield modem
    modem.unplug()


def rtu_server(line: NullModem, device_id: int = 1) -> RtuRegisters:
    settings = RegistersParams(device_id=device_id)
    server = RtuRegisters(
        settings, SerialLink(str(line.ours), baudrate=115200), RegisterMap(settings, (), float), Clock()
    )
    server.publish(golden_frame(T_S))
    return server


@asynccontextmanager
async def wire(line: NullModem) -> AsyncIterator[tuple[asyncio.StreamReader, Callable[[bytes], int]]]:
    """The other end: what is heard there, and how to speak."""
    loop = asyncio.get_running_loop()
    reader = asyncio.StreamReader()
    with open(line.theirs, "rb+", buffering=0) as port:  # noqa: ASYNC230, PTH123  # A pty opens at once.
        transport, _ = await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), port)
        yield reader, port.write
        transport.close()


async def test_pymodbus_on_a_serial_line(line: NullModem) -> None:
    async with output_running(rtu_server(line, 7)) as server:
        await until(lambda: server.health.is_up)
        client = AsyncModbusSerialClient(str(line.theirs), baudrate=115200, timeout=PATIENCE_S, retries=0)
        async with pymodbus_client(client) as client:
            await check_with_pymodbus(client, 7)
        assert server.health.lost == {"write": 6, "illegal_function": 1, "illegal_address": 2}


@mbpoll
async def test_mbpoll_on_a_serial_line(line: NullModem) -> None:
    async with output_running(rtu_server(line, 7)) as server:
        await until(lambda: server.health.is_up)
        bus = ("-m", "rtu", "-b", "115200", "-P", "none", "-a", "7", "-r", "3")
        code, output = await poll(*bus, "-c", "6", "-t", "4:hex", str(line.theirs))
        assert (code, words_in(output)) == (0, [*GOLDEN, 1]), output
        _, output = await poll(*bus, "-t", "4", str(line.theirs), "17", "18")
        assert "Illegal function" in output


OURS = rtu(b"\x07" + ASK)
ANSWER = rtu(b"\x07" + WELL)


@pytest.mark.parametrize(
    "before",
    [
        b"",
        b"\x00\xff\x07\x03",
        OURS[:5],
        rtu(b"\x09" + ASK),
        rtu(b"\x09" + ASK) + rtu(b"\x09" + pdu_answer(3, [7, 3, 3, 6])),
        rtu(b"\x09\x83\x02"),
        rtu(b"\x00" + struct.pack(">BHH", 6, 3, 17)),
        b"\x07" * 5000,
    ],
)
async def test_a_request_is_answered_whatever_was_on_the_line_before(line: NullModem, before: bytes) -> None:
    async with output_running(rtu_server(line, 7)) as server, wire(line) as (reader, say):
        await until(lambda: server.health.is_up)
        say(before + OURS)
        async with asyncio.timeout(PATIENCE_S):
            assert await reader.readexactly(len(ANSWER)) == ANSWER
        assert server.health.lost == {}


async def test_what_is_for_others_is_not_answered(line: NullModem) -> None:
    async with output_running(rtu_server(line, 7)) as server, wire(line) as (reader, say):
        await until(lambda: server.health.is_up)
        for foreign in (
            rtu(b"\x09" + ASK),
            rtu(b"\x09" + pdu_answer(3, [1, 2])),
            rtu(b"\x00" + struct.pack(">BHH", 6, 3, 17)),
            OURS[:-1] + b"\x00",
            OURS + rtu(b"\x09" + ASK),
        ):
            say(foreign)
        say(OURS)  # After all of them: its answer is the only one.
        async with asyncio.timeout(PATIENCE_S):
            assert await reader.readexactly(len(ANSWER)) == ANSWER
        assert (server.health.sent, server.health.lost) == (1, {})


async def test_what_only_looked_like_a_request_is_not_answered(line: NullModem) -> None:
    """Somebody speaks on before the silence that ends a frame: it was a part of something else."""
    async with output_running(rtu_server(line, 7)) as server, wire(line) as (reader, say):
        await until(lambda: server.health.is_up)
        server._hear(OURS)
        server._hear(b"\x00")
        say(OURS)
        async with asyncio.timeout(PATIENCE_S):
            assert await reader.readexactly(len(ANSWER)) == ANSWER
        assert server.health.sent == 1


async def test_a_line_that_goes_and_comes_back(line: NullModem, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RETRY_S", 0.01)
    with capture_logs() as logs:
        async with output_running(rtu_server(line, 7)) as server:
            await until(lambda: server.health.is_up)
            line.unplug()
            await until(lambda: "is not there: plug the adapter in" in server.health.detail)
            line.plug_in()
            await until(lambda: server.health.is_up)
            async with wire(line) as (reader, say):
                say(OURS)
                async with asyncio.timeout(PATIENCE_S):
                    assert await reader.readexactly(len(ANSWER)) == ANSWER
    assert [line["event"] for line in logs] == ["output up", "output down", "output down", "output up"]


async def test_a_port_that_another_program_has(line: NullModem, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RETRY_S", 0.01)
    async with output_running(rtu_server(line)) as first:
        await until(lambda: first.health.is_up)
        async with output_running(rtu_server(line)) as second:
            await until(lambda: "is in use by another program" in second.health.detail)
        assert first.health.is_up


# ---- in the daemon ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mode", "link", "kind"),
    [
        (Mode.SERVE, "tcp://127.0.0.1:5502", TcpRegisters),
        (Mode.SERVE, "rtu:///dev/ttyUSB9", RtuRegisters),
        (Mode.PUSH, "tcp://192.0.2.1:502", RegisterPush),
        (Mode.PUSH, "rtu:///dev/ttyUSB9", RegisterPush),
    ],
)
def test_which_output_is_made(mode: Mode, link: str, kind: type) -> None:
    output = register_output(RegistersParams(mode=mode, link=link), (), float)
    assert type(output) is kind
    assert output.health.where == str(parse_link(link))


def test_beyond_this_machine_it_needs_networks() -> None:
    with pytest.raises(ValueError, match=r"\[registers\] host 0.0.0.0 can be reached from other machines"):
        register_output(RegistersParams(link="tcp://0.0.0.0:5502"), (), float)


async def test_the_daemon_runs_it_when_it_is_enabled() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    outputs = Outputs(float, Clock(), nobody_asks)
    enabled = Config(registers=RegistersParams(enabled=True, link=f"tcp://127.0.0.1:{port}"))
    await outputs.have(Config(), PATIENCE_S)
    assert outputs.health == []
    await outputs.have(enabled, PATIENCE_S)
    (health,) = outputs.health
    await until(lambda: health.is_up)
    outputs.publish(golden_frame(T_S))
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    assert await Master(reader, writer).ask() == WELL
    await outputs.have(enabled, PATIENCE_S)
    assert outputs.health[0] is health
    await outputs.have(Config(), PATIENCE_S)
    assert outputs.health == []
    assert await reader.read() == b""
    writer.close()
    assert await outputs.stop(PATIENCE_S)


async def counter(port: int) -> int | None:
    """What a PLC reads as the watchdog counter; None: no answer within a second."""
    try:
        async with asyncio.timeout(1.0):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            try:
                writer.write(mbap_answer(1, 1, struct.pack(">BHH", 3, 8, 1)))
                return int.from_bytes((await reader.readexactly(11))[9:])
            finally:
                writer.transport.abort()
    except (TimeoutError, ConnectionError, asyncio.IncompleteReadError):
        return None


async def test_a_dead_daemon_is_seen(tmp_path: Path) -> None:
    """The program itself, without a sensor: its counter goes on, until it hangs, and until it is killed."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    (tmp_path / "heaved.toml").write_text(
        f'[stream]\nport = 0\n[http]\nenabled = false\n[state]\ndirectory = "{tmp_path}/state"\n'
        f'[registers]\nenabled = true\nlink = "tcp://127.0.0.1:{port}"\n'
    )
    daemon = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "heaved", "run", "--config", str(tmp_path / "heaved.toml"),
        stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.DEVNULL,
    )  # fmt: skip

    async def next_counter(than: int | None) -> int:
        async with asyncio.timeout(60.0):
            while (now := await counter(port)) is None or now == than:  # noqa: ASYNC110  # Another process counts.
                await asyncio.sleep(0.01)
            return now

    try:
        assert await next_counter(await next_counter(0)) > 0
        daemon.send_signal(signal.SIGSTOP)
        assert await counter(port) is None
        daemon.send_signal(signal.SIGCONT)
        last = await next_counter(None)
        await next_counter(last)
        daemon.kill()
        await daemon.wait()
        assert await counter(port) is None
    finally:
        if daemon.returncode is None:
            daemon.kill()
            await daemon.wait()
