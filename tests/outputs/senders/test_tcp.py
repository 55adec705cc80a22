"""Connections that we make: to readers that are not there, that come and go, that do not read, that talk."""

from __future__ import annotations

import asyncio
import socket
import struct
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING

import pytest
from output_peers import LINE, free_port, heard, kept, make_health, refuse_to_read, until, until_gone
from stream_peers import Clock
from structlog.testing import capture_logs

from heaved.links import TcpLink
from heaved.outputs.senders import tcp as tcp_module
from heaved.outputs.senders.sender import STUCK_S
from heaved.outputs.senders.tcp import TcpSender
from heaved.outputs.senders.tcp_peer import TcpPeer

if TYPE_CHECKING:
    from collections.abc import AsyncIterator


class Reader:
    """A machine that listens; it takes connections when told to."""

    def __init__(self, listening: socket.socket) -> None:
        self.listening = listening
        self.link = TcpLink("127.0.0.1", listening.getsockname()[1])

    async def accept(self) -> socket.socket:
        async with asyncio.timeout(10.0):
            connection, _ = await asyncio.get_running_loop().sock_accept(self.listening)
        return connection


@asynccontextmanager
async def reader(port: int = 0, backlog: int = 8) -> AsyncIterator[Reader]:
    with socket.socket() as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        refuse_to_read(listening)
        listening.bind(("127.0.0.1", port))
        listening.listen(backlog)
        listening.setblocking(False)
        yield Reader(listening)


async def test_telegrams_arrive_and_what_the_peer_says_is_thrown_away() -> None:
    health = make_health()
    async with reader() as machine:
        sender = TcpSender(machine.link, health)
        assert not sender.has_reader
        async with kept(sender):
            with await machine.accept() as connection:
                await until(lambda: sender.has_reader)
                for _ in range(50):
                    await asyncio.get_running_loop().sock_sendall(connection, b"GET / HTTP/1.1\r\n\r\n" * 50)
                sender.send(b"one\r\n")
                sender.send(b"two\r\n")
                assert await heard(connection, 10) == b"one\r\ntwo\r\n"
                await until(lambda: health.is_up)
    assert (health.sent, health.connections, health.detail) == (2, 1, "")


async def test_one_that_has_said_all_it_has_to_say_is_served_on() -> None:
    async with reader() as machine:
        sender = TcpSender(machine.link, make_health())
        async with kept(sender):
            with await machine.accept() as connection:
                connection.shutdown(socket.SHUT_WR)
                for i in range(20):
                    await until(lambda: sender.has_reader)
                    sender.send(LINE % i)
                    assert await heard(connection, 100) == LINE % i


async def test_refused_until_somebody_listens() -> None:
    health, port = make_health(), free_port()
    sender = TcpSender(TcpLink("127.0.0.1", port), health)
    with capture_logs() as logs:
        async with kept(sender):
            await until(lambda: "nobody reads tcp://127.0.0.1" in health.detail)
            sender.send(b"nobody takes this")
            async with reader(port) as machine:
                with await machine.accept() as connection:
                    await until(lambda: health.is_up)
                    sender.send(b"well")
                    assert await heard(connection, 4) == b"well"
    assert [line["event"] for line in logs] == ["output down", "output up"]


@pytest.mark.parametrize("is_reset", [False, True], ids=["closed", "reset"])
async def test_a_reader_that_goes_and_comes_back(is_reset: bool) -> None:
    health = make_health()
    async with reader() as machine:
        sender = TcpSender(machine.link, health)
        async with kept(sender):
            first = await machine.accept()
            await until(lambda: health.is_up)
            if is_reset:
                first.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            first.close()
            await until_gone(sender)
            assert not health.is_up
            assert "has ended the connection" in health.detail
            with await machine.accept() as again:
                await until(lambda: health.is_up)
                sender.send(b"well")
                assert await heard(again, 4) == b"well"
    assert health.connections == 2


async def test_one_that_ends_every_connection_at_once_is_never_up() -> None:
    """Some devices do so while another reader is connected."""
    health = make_health()
    with capture_logs() as logs:
        async with reader() as machine:
            sender = TcpSender(machine.link, health)
            async with kept(sender):
                for _ in range(3):
                    connection = await machine.accept()
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                    connection.close()
                await until(lambda: not sender.has_reader)
    assert [line["event"] for line in logs] == ["output down"]
    assert health.connections == 0


async def test_one_that_never_reads_loses_the_oldest_then_its_connection() -> None:
    health, clock = make_health(), Clock()
    async with reader() as machine:
        sender = TcpSender(machine.link, health, clock)
        async with kept(sender):
            with await machine.accept() as connection:
                await until(lambda: health.is_up)
                count = 0
                while not health.lost["slow"]:
                    sender.send(LINE % count)
                    count += 1
                    await asyncio.sleep(0)
                clock.now_s += 0.9 * STUCK_S
                sender.send(LINE % count)
                assert sender.has_reader
                # It reads on: whole telegrams, a gap of exactly what was counted, the newest at the end.
                found = b""
                while not found.endswith(LINE % count):
                    count += 1
                    sender.send(LINE % count)
                    await asyncio.sleep(0)
                    with suppress(BlockingIOError):
                        found += connection.recv(1 << 20)
                numbers = [int(found[i : i + 6]) for i in range(0, len(found), 100)]
                assert found == b"".join(LINE % number for number in numbers)
                assert numbers == sorted(set(numbers))
                assert count + 1 - len(numbers) == health.lost["slow"]
                assert health.sent == len(numbers)
                # It stops again, for good.
                before = health.lost["slow"]
                while health.lost["slow"] == before:
                    sender.send(LINE % 0)
                    await asyncio.sleep(0)
                assert sender.has_reader
                clock.now_s += 1.1 * STUCK_S
                sender.send(LINE % 0)
                await until(lambda: not health.is_up)
                assert "has taken nothing for 10 s" in health.detail
            with await machine.accept():
                await until(lambda: health.is_up)


async def test_nothing_is_sent_after_what_has_been_under_way_for_long() -> None:
    """As while a cable is out: when it is in again, a burst of old telegrams would be taken for the present."""
    health, clock = make_health(), Clock()
    async with reader() as machine:
        sender = TcpSender(machine.link, health, clock)
        async with kept(sender):
            with await machine.accept() as connection:
                await until(lambda: sender.has_reader)
                assert sender._peer is not None
                while not sender._peer._under_way:  # Until its system takes no more.
                    for _ in range(10):
                        sender.send(LINE % 0)
                    await asyncio.sleep(0)
                    sender._peer._is_behind(sender._peer._transport)  # type: ignore[arg-type]
                taken = health.sent
                clock.now_s += 1.1
                for i in range(1, 20):
                    sender.send(LINE % i)
                assert health.sent == taken
                assert health.lost["slow"] == 11  # Eight wait.
                await heard(connection, 100 * taken)

                def goes_on() -> bool:
                    sender.send(LINE % 99)
                    return health.sent > taken

                await until(goes_on)
                assert await heard(connection, 100) > LINE % 11


async def test_a_black_hole_is_given_up_and_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine whose queue of connections is full does not answer, as one behind a firewall that drops."""
    monkeypatch.setattr(tcp_module, "CONNECT_S", 0.05)
    health = make_health()
    async with reader(backlog=0) as machine:
        fillers = []
        for _ in range(4):
            filler = socket.socket()
            filler.setblocking(False)
            filler.connect_ex(("127.0.0.1", machine.link.port))
            fillers.append(filler)
        sender = TcpSender(machine.link, health)
        with capture_logs() as logs:
            async with kept(sender):
                await until(lambda: "nobody answers at tcp://127.0.0.1" in health.detail)
                assert not sender.has_reader
                monkeypatch.setattr(tcp_module, "CONNECT_S", 5.0)  # The system repeats what was lost after a second.
                taking = asyncio.create_task(take_all(machine.listening))
                await until(lambda: health.is_up)
                taking.cancel()
                await asyncio.wait([taking])
        for filler in fillers:
            filler.close()
    assert [line["event"] for line in logs] == ["output down", "output up"]


async def take_all(listening: socket.socket) -> None:
    connections = []
    try:
        while True:
            connections.append((await asyncio.get_running_loop().sock_accept(listening))[0])
    finally:
        for connection in connections:
            connection.close()


async def test_a_flood_ends_the_connection() -> None:
    health = make_health()
    async with reader() as machine:
        sender = TcpSender(machine.link, health, Clock())
        async with kept(sender):
            # So much of it is not read; what is left is answered with a reset.
            with await machine.accept() as connection, pytest.raises(ConnectionError):
                await asyncio.get_running_loop().sock_sendall(connection, bytes(100_000_000))
            await until(lambda: "more than a megabyte a second" in health.detail)


async def test_our_own_end_is_no_reader() -> None:
    """While nobody listens, the system may give our end the very port that is tried: it is then connected to itself."""
    with socket.socket() as circle:
        circle.setblocking(False)
        circle.bind(("127.0.0.1", 0))
        await asyncio.get_running_loop().sock_connect(circle, circle.getsockname())
        link = TcpLink("127.0.0.1", circle.getsockname()[1])
        _, peer = await asyncio.get_running_loop().create_connection(
            lambda: TcpPeer(link, make_health(), Clock()), sock=circle
        )
        assert "nobody reads" in await asyncio.wait_for(peer.closed, 10.0)


async def test_a_name_server_that_is_away(monkeypatch: pytest.MonkeyPatch) -> None:
    def away(*_args: object, **_kwargs: object) -> None:
        raise socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution")

    monkeypatch.setattr(socket, "getaddrinfo", away)
    health = make_health()
    async with kept(TcpSender(TcpLink("plc.ship", 10110), health)):
        await until(lambda: "no name server answers" in health.detail)


async def test_the_second_address_of_a_name_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    health = make_health()
    async with reader() as machine:
        found = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (host, 0)) for host in ("127.0.0.9", "127.0.0.1")]
        with monkeypatch.context() as patch:
            patch.setattr(socket, "getaddrinfo", lambda *_args, **_kwargs: found)
            async with kept(TcpSender(TcpLink("plc.ship", machine.link.port), health)):
                with await machine.accept():
                    await until(lambda: health.is_up)


async def test_a_silent_death_is_found_by_the_system() -> None:
    """A cable that is pulled cannot be tried here: the socket is asked what it would do."""
    async with reader() as machine:
        sender = TcpSender(machine.link, make_health())
        async with kept(sender):
            with await machine.accept():
                await until(lambda: sender.has_reader)
                assert sender._peer is not None
                assert sender._peer._transport is not None
                ours = sender._peer._transport.get_extra_info("socket")
                assert ours.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) <= 10_000
                assert ours.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
                idle, interval, count = (
                    ours.getsockopt(socket.IPPROTO_TCP, option)
                    for option in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT)
                )
                assert idle + interval * count <= 30
                assert ours.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF) <= 64 * 1024
