"""One address does not shut out the others, whatever it does on whichever port."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from output_peers import free_port
from running_outputs import output_running, until
from structlog.testing import capture_logs

from heaved.links import TcpLink, TcpListenLink
from heaved.networks import neighbourhood
from heaved.outputs import http_listener, shares
from heaved.outputs.http import HttpServer, Verdict
from heaved.outputs.output import OutputHealth
from heaved.outputs.register_map import RegisterMap, RegistersParams
from heaved.outputs.registers import MAX_CONNECTIONS, TcpRegisters
from heaved.outputs.senders.tcp_listen import MOST_READERS, TcpListenSender
from heaved.outputs.shares import BURST, TOO_FAST, TOO_MANY, Arrivals, Shares
from heaved.page.server import MOST_VIEWERS, PageServer

if TYPE_CHECKING:
    from stream_peers import Serve

HOG, OTHER = "127.0.0.2", "127.0.0.3"


@pytest.fixture
def loopback_is_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Addresses of this machine are counted as those of others are."""
    monkeypatch.setattr(shares, "neighbourhood", lambda address: address)


@pytest.mark.parametrize(
    ("address", "whose"),
    [
        ("192.168.10.7", "192.168.10.7"),
        ("::ffff:192.168.10.7", "192.168.10.7"),
        ("fd00:1:2:3::1", "fd00:1:2:3::/64"),
        ("fd00:1:2:3:ffff:ffff:ffff:ffff", "fd00:1:2:3::/64"),
        ("fe80::1%eth0", "fe80::1%eth0"),
        ("127.0.0.1", ""),
        ("::1", ""),
        ("::ffff:127.0.0.1", ""),
        ("/run/socket", ""),
    ],
)
def test_under_what_a_peer_is_counted(address: str, whose: str) -> None:
    assert neighbourhood(address) == whose


@pytest.mark.parametrize(("most", "each"), [(1, 1), (3, 3), (8, 4), (16, 4), (32, 8), (64, 16), (1024, 256)])
def test_one_address_has_a_quarter_and_this_machine_all(most: int, each: int) -> None:
    parts = Shares(most)
    assert [parts.take("10.0.0.1") for _ in range(most + 1)] == [True] * each + [False] * (most + 1 - each)
    assert parts.take("10.0.0.2")
    assert all(parts.take("127.0.0.1") for _ in range(most))
    parts.give_back("10.0.0.1")
    assert parts.take("10.0.0.1")
    assert not parts.take("10.0.0.1")


def test_what_was_given_back_is_forgotten() -> None:
    parts = Shares(64)
    for number in range(1000):
        parts.take(f"10.0.{number // 250}.{number % 250}")
        parts.give_back(f"10.0.{number // 250}.{number % 250}")
    assert not parts._taken


def test_how_fast_one_address_may_connect() -> None:
    arrivals = Arrivals()
    assert [arrivals.admits("10.0.0.1", 5.0) for _ in range(60)] == [True] * 40 + [False] * 20
    assert arrivals.admits("10.0.0.2", 5.0)
    assert all(arrivals.admits("127.0.0.1", 5.0) for _ in range(1000))
    # For long: ten a second, however often it is tried.
    assert 99 <= sum(arrivals.admits("10.0.0.1", 5.0 + 0.01 * k) for k in range(1, 1001)) <= 101
    assert [arrivals.admits("10.0.0.1", 100.0) for _ in range(41)] == [True] * 40 + [False]


def test_of_who_connects_little_is_kept() -> None:
    arrivals = Arrivals()
    for number in range(10_000):
        assert arrivals.admits(f"10.0.{number >> 8}.{number & 255}", 0.0)
    assert len(arrivals._full_s) == 1024


# ---- on each port ----------------------------------------------------------------------------------------------------


Connection = tuple[asyncio.StreamReader, asyncio.StreamWriter]
Reach = Callable[..., Awaitable[Connection]]


@pytest.fixture
async def reach() -> AsyncIterator[Reach]:
    """Connects, from an address; ends all connections at the end."""
    made = list[asyncio.StreamWriter]()

    async def connect(address: tuple[str, int], own: str = HOG) -> Connection:
        reader, writer = await asyncio.open_connection(*address, local_addr=(own, 0), limit=1024)
        made.append(writer)
        return reader, writer

    yield connect
    for writer in made:
        writer.transport.abort()
    await asyncio.gather(*(writer.wait_closed() for writer in made), return_exceptions=True)


async def ended(reader: asyncio.StreamReader) -> bytes:
    """All that is said until the connection ends."""
    with suppress(ConnectionResetError):
        return await reader.read()
    return b""


@pytest.mark.usefixtures("loopback_is_elsewhere")
async def test_the_stream(serve: Serve, reach: Reach) -> None:
    served = await serve(max_clients=16)
    address = (served.host, served.port)
    hogs = [await reach(address, HOG) for _ in range(4)]
    with capture_logs() as logs:
        refused, _ = await reach(address, HOG)
        said = await ended(refused)
    assert b"127.0.0.2 has 4 connections" in said
    assert b"[stream] max_clients" in said
    assert served.counts.errors == {TOO_MANY: 1}
    assert [line["alike"] for line in logs if line["log_level"] == "warning"] == [TOO_MANY]
    other, _ = await reach(address, OTHER)
    assert b"VERSION" in await other.readline()
    hogs[0][1].close()
    await until(lambda: served.publisher.clients == 4)
    again, _ = await reach(address, HOG)
    assert b"VERSION" in await again.readline()


@pytest.mark.usefixtures("loopback_is_elsewhere")
async def test_who_connects_again_and_again_is_not_let_in_and_others_are(
    serve: Serve, reach: Reach, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shares, "RATE_HZ", 1e-3)  # On however slow a machine.
    served = await serve(max_clients=1024)
    address = (served.host, served.port)
    with capture_logs() as logs:
        while not served.counts.errors[TOO_FAST]:
            await reach(address)
    assert served.publisher.clients == BURST
    assert {line["alike"] for line in logs if line["log_level"] == "warning"} == {TOO_FAST}
    other, _ = await reach(address, OTHER)
    assert b"VERSION" in await other.readline()


@asynccontextmanager
async def metrics_of(errors: Counter[str]) -> AsyncIterator[tuple[str, int]]:
    server = HttpServer(
        host="127.0.0.1", port=0, allow=(), metrics=lambda: b"x" * 4_000_000, alive=Verdict, ready=Verdict,
        count_client_error=lambda reason: errors.update([reason]),
    )  # fmt: skip
    yield await server.start()
    await server.close()


ASKED = b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n"


@pytest.mark.usefixtures("loopback_is_elsewhere")
async def test_http(reach: Reach) -> None:
    errors = Counter[str]()
    async with metrics_of(errors) as address:
        hogs = [await reach(address, HOG) for _ in range(8)]
        refused, _ = await reach(address, HOG)
        assert await ended(refused) == b""
        assert errors == {TOO_MANY: 1}
        reader, writer = await reach(address, OTHER)
        writer.write(ASKED)
        assert b"200 OK" in await reader.readline()
        hogs[0][1].write(ASKED)
        assert b"200 OK" in await hogs[0][0].readline()
        for _, one in hogs:
            one.close()


@pytest.mark.usefixtures("loopback_is_elsewhere")
async def test_the_registers(reach: Reach) -> None:
    params = RegistersParams(enabled=True)
    server = TcpRegisters(params, TcpLink("127.0.0.1", 0), RegisterMap(params, (), lambda t_s: t_s))
    ask = struct.pack(">HHHBBHH", 1, 0, 6, params.device_id, 3, params.start, 1)
    async with output_running(server):
        await until(lambda: server.address is not None)
        assert server.address is not None
        hogs = [await reach(server.address, HOG) for _ in range(MAX_CONNECTIONS // 4)]
        refused, _ = await reach(server.address, HOG)
        assert await ended(refused) == b""
        assert server.health.lost[TOO_MANY] == 1
        for reader, writer in (await reach(server.address, OTHER), hogs[0]):
            writer.write(ask)
            assert (await reader.readexactly(11))[:2] == b"\0\1"
        for _, writer in hogs:
            writer.close()
        await until(lambda: len(server._served) == 1)
        assert server._shares.take(HOG)


@pytest.mark.usefixtures("loopback_is_elsewhere")
async def test_readers_of_telegrams(reach: Reach) -> None:
    health = OutputHealth("tss1", "TSS1", "tcp-listen://127.0.0.1:0")
    sender = TcpListenSender(TcpListenLink("127.0.0.1", free_port()), health)
    running = asyncio.create_task(sender.run())
    await until(lambda: health.is_up)
    address = ("127.0.0.1", sender._link.port)
    hogs = [await reach(address, HOG) for _ in range(MOST_READERS // 4)]
    with capture_logs() as logs:
        refused, _ = await reach(address, HOG)
        assert await ended(refused) == b""
    assert "127.0.0.2 has 4 connections" in logs[0]["reason"]
    other, _ = await reach(address, OTHER)
    await until(lambda: len(sender._readers) == 5)
    sender.send(b"one")
    assert await other.readexactly(3) == b"one"
    hogs[0][1].close()
    running.cancel()
    await asyncio.wait([running])


@pytest.mark.usefixtures("loopback_is_elsewhere")
async def test_browsers(reach: Reach) -> None:
    server = PageServer(host="127.0.0.1", port=0, allow=(), stream_host="127.0.0.1", stream_port=1)
    address = await server.start()
    asked = b"GET /events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"

    opened = list[asyncio.StreamWriter]()

    async def events(own: str) -> bytes:
        reader, writer = await reach(address, own)
        opened.append(writer)
        writer.write(asked)
        return await reader.readline()

    assert [b" 200 " in await events(HOG) for _ in range(MOST_VIEWERS // 4 + 1)] == [True] * 6 + [False]
    assert b" 200 " in await events(OTHER)
    for writer in opened:
        writer.transport.abort()
    await until(lambda: not server.hub.viewers)
    assert not server._shares._taken
    await server.close()


# ---- who has gone again before it is looked at -----------------------------------------------------------------------


def come_and_gone(address: tuple[str, int], times: int = 20) -> None:
    """Connections that are reset while they wait to be let in: the loop does not run meanwhile."""
    for _ in range(times):
        with socket.create_connection(address) as one:
            one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


@asynccontextmanager
async def nothing_lost() -> AsyncIterator[None]:
    """No exception that nobody takes, and as many descriptors as before."""
    faults = list[dict[str, Any]]()
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _loop, context: faults.append(context))
    before = descriptors()
    yield
    await until(lambda: descriptors() <= before)
    assert not faults


@pytest.mark.parametrize("max_clients", [1, 64])
async def test_the_stream_forgets_them(serve: Serve, reach: Reach, max_clients: int) -> None:
    """Also where there is no room: they would be told so."""
    served = await serve(max_clients=max_clients)
    address = (served.host, served.port)
    reader, _ = await reach(address)
    assert b"VERSION" in await reader.readline()
    async with nothing_lost():
        come_and_gone(address)
        last, writer = await reach(address)  # Comes after them.
        await last.readline()
        assert max_clients > 1 or served.counts.errors["too_many_clients"] == 21
        writer.transport.abort()
    await until(lambda: served.publisher.clients == 1 and not served.publisher._lingering)


@pytest.mark.parametrize("is_allowed", [True, False])
async def test_http_forgets_them(reach: Reach, monkeypatch: pytest.MonkeyPatch, is_allowed: bool) -> None:
    monkeypatch.setattr(http_listener, "is_allowed", lambda _address, _networks: is_allowed)
    async with metrics_of(Counter()) as address, nothing_lost():
        come_and_gone(address)
        reader, writer = await reach(address)  # Comes after them.
        writer.write(ASKED)
        assert (b" 200 " if is_allowed else b" 403 ") in await reader.readline()
        writer.close()


async def test_readers_of_telegrams_are_forgotten() -> None:
    health = OutputHealth("tss1", "TSS1", "tcp-listen://127.0.0.1:0")
    sender = TcpListenSender(TcpListenLink("127.0.0.1", free_port()), health)
    running = asyncio.create_task(sender.run())
    await until(lambda: health.is_up)
    async with nothing_lost():
        come_and_gone(("127.0.0.1", sender._link.port))
        await until(lambda: health.connections >= MOST_READERS)
    await until(lambda: not sender._readers)
    running.cancel()
    await asyncio.wait([running])


# ---- HTTP that gets nowhere ------------------------------------------------------------------------------------------

SLOW: dict[str, tuple[bytes, str]] = {
    "a request that never ends": (b"GET /healthz HTTP/1.1\r\nX: ", "request_too_slow"),
    "an answer that is not taken": (b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n", "request_too_slow"),
    "a second request that never ends": (ASKED + b"GET /hea", "request_too_slow"),
}


@pytest.mark.parametrize("name", SLOW)
async def test_who_gets_nowhere_is_let_go(reach: Reach, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    said, reason = SLOW[name]
    monkeypatch.setattr(http_listener, "_REQUEST_S", 0.1)
    errors = Counter[str]()
    async with metrics_of(errors) as address:
        reader, writer = await reach(address)
        writer.write(said[: len(ASKED)])
        if said.startswith(ASKED):
            assert b" 200 " in await reader.readline()
        writer.write(said[len(ASKED) :])
        await until(lambda: errors[reason] == 1)
        await ended(reader)
    assert errors == {reason: 1}


async def test_who_keeps_a_connection_is_not_blamed(reach: Reach, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_listener, "_REQUEST_S", 0.05)
    monkeypatch.setattr(http_listener, "_IDLE_S", 0.3)
    errors = Counter[str]()
    async with metrics_of(errors) as address:
        for said in (b"", ASKED):
            reader, writer = await reach(address)
            writer.write(said)
            assert (b" 200 " in await ended(reader)) is bool(said)
    assert not errors


@pytest.mark.parametrize(
    "said",
    [
        b"GET /healthz HTTP/1.1\r\n" + b"".join(b"X%d: %b\r\n" % (i, b"y" * 3000) for i in range(60)),
        b"GET /healthz HTTP/1.1\r\n" + b"".join(b"X%d: y\r\n" % i for i in range(5000)),
        b"GET /" + b"x" * 100_000,
        b"GET /healthz HTTP/1.1\r\nX: " + b"y" * 100_000,
    ],
    ids=["long headers", "many headers", "a long path", "a long header"],
)
async def test_a_request_without_end_costs_no_memory(reach: Reach, said: bytes) -> None:
    errors = Counter[str]()
    async with metrics_of(errors) as address:
        reader, writer = await reach(address)
        writer.write(said)
        answer = await ended(reader)
        writer.close()
    assert b" 200 " not in answer
    assert sum(errors.values()) == 1
    assert set(errors) <= {"bad_request", "line_too_long"}


async def test_a_body_that_nobody_wants_is_no_fault(reach: Reach) -> None:
    errors = Counter[str]()
    async with metrics_of(errors) as address:
        reader, writer = await reach(address)
        writer.write(b"POST /metrics HTTP/1.1\r\nHost: x\r\nConnection: close\r\nContent-Length: 300000\r\n\r\n")
        assert b" 405 " in await reader.readline()
        writer.write(b"x" * 300_000)
        await ended(reader)
        writer.close()
    assert not errors


def test_limits_of_the_library_are_known_to_it() -> None:
    """It takes unknown options for a reason to ignore all of them."""
    import inspect

    from aiohttp import web

    known = inspect.signature(web.RequestHandler.__init__).parameters
    limits: dict[str, Any] = http_listener._LIMITS
    assert set(limits) <= set(known)
