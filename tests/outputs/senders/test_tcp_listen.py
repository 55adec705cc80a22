"""Connections that readers make: several, slow ones, strangers, too many."""

from __future__ import annotations

import asyncio
import socket
import struct
from typing import TYPE_CHECKING

from output_peers import LINE, free_port, heard, kept, make_health, refuse_to_read, until, until_gone
from stream_peers import Clock
from structlog.testing import capture_logs

from heaved.links import TcpListenLink
from heaved.outputs.senders.sender import STUCK_S
from heaved.outputs.senders.tcp_listen import MOST_READERS, TcpListenSender
from heaved.outputs.senders.tcp_peer import TcpPeer

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.outputs.output import OutputHealth


def make_sender(health: OutputHealth, clock: Callable[[], float] | None = None) -> tuple[TcpListenSender, int]:
    port = free_port()
    return TcpListenSender(TcpListenLink("127.0.0.1", port), health, (), clock or Clock()), port


async def connected(port: int) -> socket.socket:
    found = socket.socket()
    found.setblocking(False)
    refuse_to_read(found)
    await asyncio.get_running_loop().sock_connect(found, ("127.0.0.1", port))
    return found


async def test_every_reader_has_every_telegram_and_one_that_does_not_read_costs_nobody_anything() -> None:
    health, clock = make_health(), Clock()
    sender, port = make_sender(health, clock)
    async with kept(sender):
        await until(lambda: health.is_up)
        assert health.detail == "listening, nobody is connected"
        assert not sender.has_reader
        with await connected(port) as one, await connected(port) as other, await connected(port) as stuck:
            await until(lambda: len(sender._readers) == 3)
            assert health.detail == ""
            count = 0
            with capture_logs() as logs:
                while not health.lost["slow"] or count % 500:
                    sender.send(LINE % count)
                    assert await heard(one, 100) == await heard(other, 100) == LINE % count
                    count += 1
                assert len(sender._readers) == 3
                clock.now_s += 1.1 * STUCK_S
                sender.send(LINE % count)
                await until(lambda: len(sender._readers) == 2)
            (line,) = logs
            assert line["event"] == "reader of an output disconnected"
            assert "has taken nothing for 10 s" in line["reason"]
            assert health.is_up
            sender.send(LINE % 7)
            for reads in (one, other):
                assert await heard(reads, 200) == LINE % count + LINE % 7
            assert stuck.fileno() >= 0
    assert health.connections == 4  # Listening is one.


async def test_a_reader_that_has_gone_before_it_is_met_is_no_error() -> None:
    sender, port = make_sender(make_health())
    errors: list[dict[str, object]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _loop, context: errors.append(context))
    async with kept(sender):
        await until(lambda: sender._is_listening)
        for _ in range(10):
            # The system takes it in our place and gives it up again, all before the loop looks: accept() still has it.
            gone = socket.create_connection(("127.0.0.1", port))
            gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            gone.close()
        await until(lambda: sender._health.connections == 11)
        with await connected(port) as client:
            await until(lambda: sender.has_reader and len(sender._readers) == 1)
            sender.send(LINE % 1)
            assert await heard(client, 100) == LINE % 1
        await until_gone(sender)
    assert errors == []


async def test_garbage_and_a_closed_side_are_no_reason_to_stop() -> None:
    sender, port = make_sender(make_health())
    async with kept(sender):
        await until(lambda: sender._is_listening)
        with await connected(port) as client:
            await until(lambda: sender.has_reader)
            await asyncio.get_running_loop().sock_sendall(client, b"\x00\xff?WATCH" * 5000)
            client.shutdown(socket.SHUT_WR)
            for i in range(20):
                sender.send(LINE % i)
                assert await asyncio.get_running_loop().sock_recv(client, 100) == LINE % i
        await until_gone(sender)


async def test_no_more_than_sixteen() -> None:
    health = make_health()
    sender, port = make_sender(health)
    async with kept(sender):
        await until(lambda: sender._is_listening)
        readers = [await connected(port) for _ in range(MOST_READERS)]
        await until(lambda: len(sender._readers) == MOST_READERS)
        with capture_logs() as logs, await connected(port) as extra:
            assert await asyncio.wait_for(asyncio.get_running_loop().sock_recv(extra, 1), 10.0) == b""
        assert [line["event"] for line in logs] == ["reader of an output refused"]
        assert "16 are connected" in logs[0]["reason"]
        readers.pop().close()
        await until_gone(sender, MOST_READERS - 1)
        readers.append(await connected(port))
        await until(lambda: len(sender._readers) == MOST_READERS)
        for connection in readers:
            connection.close()


async def test_only_from_networks_that_are_allowed() -> None:
    port = free_port()
    sender = TcpListenSender(TcpListenLink("127.0.0.1", port), make_health(), ("10.1.0.0/16",))
    async with kept(sender):
        await until(lambda: sender._is_listening)
        peer = TcpPeer(TcpListenLink("127.0.0.1", port), make_health(), Clock())
        assert sender._admit("10.2.0.1", peer) == "10.2.0.1 is not in a network of allow"
        assert not sender.has_reader
        assert sender._admit("10.1.0.1", peer) == ""
        assert sender.has_reader


async def test_a_port_that_is_in_use_is_waited_for() -> None:
    health = make_health()
    sender, port = make_sender(health)
    with capture_logs() as logs:
        with socket.socket() as other:
            other.bind(("127.0.0.1", port))
            other.listen()
            task = asyncio.create_task(sender.run())
            await until(lambda: "the port is in use: stop the other program" in health.detail)
        await until(lambda: health.is_up)
        task.cancel()
        await asyncio.wait([task])
    assert [line["event"] for line in logs] == ["output down", "output up"]


async def test_at_the_end_everything_is_given_back() -> None:
    health = make_health()
    sender, port = make_sender(health)
    for _ in range(3):
        async with kept(sender):
            await until(lambda: sender._is_listening)
            client = await connected(port)
            await until(lambda: sender.has_reader)
        assert not sender.has_reader
        assert await asyncio.wait_for(asyncio.get_running_loop().sock_recv(client, 1), 10.0) == b""
        client.close()
