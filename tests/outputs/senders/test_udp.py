"""Datagrams: to a machine, a broadcast address, a multicast group; and to nobody."""

from __future__ import annotations

import asyncio
import errno
import socket
import struct
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest
from output_peers import free_port, kept, make_health, until
from stream_peers import Clock
from structlog.testing import capture_logs

from heaved.links import UdpLink
from heaved.outputs.senders.udp import UdpSender

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence


@contextmanager
def receiver(host: str = "127.0.0.1", port: int = 0) -> Iterator[socket.socket]:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as found:
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.setblocking(False)
        found.bind((host, port))
        yield found


async def received(place: socket.socket, count: int) -> list[bytes]:
    async with asyncio.timeout(10.0):
        return [await asyncio.get_running_loop().sock_recv(place, 2048) for _ in range(count)]


@pytest.mark.parametrize(
    ("bound", "target"), [("127.0.0.1", "127.0.0.1"), ("::1", "::1"), ("0.0.0.0", "127.255.255.255")]
)
async def test_each_telegram_is_one_datagram(bound: str, target: str) -> None:
    health = make_health()
    with receiver(bound) as place:
        sender = UdpSender(UdpLink(target, place.getsockname()[1]), health)
        async with kept(sender):
            await until(lambda: sender.has_reader)
            for telegram in (b"one\r\n", b"two\r\n", b"\x00" * 132):
                sender.send(telegram)
            assert await received(place, 3) == [b"one\r\n", b"two\r\n", b"\x00" * 132]
    assert (health.is_up, health.detail, health.sent, health.connections) == (True, "", 3, 1)
    assert not health.lost


async def test_a_multicast_group() -> None:
    group = "239.255.17.4"
    with receiver("0.0.0.0") as place:
        try:
            place.setsockopt(
                socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, struct.pack("4s4s", socket.inet_aton(group), bytes(4))
            )
        except OSError as error:
            pytest.skip(f"this machine has no interface for multicast: {error}")
        sender = UdpSender(UdpLink(group, place.getsockname()[1]), make_health())
        async with kept(sender):
            await until(lambda: sender.has_reader)
            sender.send(b"to all\r\n")
            assert await received(place, 1) == [b"to all\r\n"]


async def test_nobody_listens_then_somebody() -> None:
    """Every datagram is answered by a refusal, about which nothing is raised, and one line is logged."""
    health, clock, port = make_health(), Clock(), free_port(socket.SOCK_DGRAM)
    sender = UdpSender(UdpLink("127.0.0.1", port), health, clock)
    with capture_logs() as logs:
        async with kept(sender):
            await until(lambda: sender.has_reader)
            for _ in range(300):
                sender.send(b"anybody?")
                await asyncio.sleep(0)
            await until(lambda: not health.is_up)
            assert "nobody reads udp://127.0.0.1" in health.detail
            assert health.sent == 300  # None is held back by the refusal of the one before.
            for _ in range(20):
                sender.send(b"anybody?")
                sender.send(b"and at once again")
                await asyncio.sleep(0)
            with receiver(port=port) as place:
                sender.send(b"hello")
                assert await received(place, 1) == [b"hello"]
                assert not health.is_up  # It may have been lucky.
                clock.now_s += 11.0
                sender.send(b"again")
                assert await received(place, 1) == [b"again"]
                assert health.is_up
    assert [line["event"] for line in logs] == ["output up", "output down", "output up"]


async def test_an_answer_is_thrown_away() -> None:
    with receiver() as place:
        sender = UdpSender(UdpLink("127.0.0.1", place.getsockname()[1]), make_health())
        async with kept(sender):
            await until(lambda: sender.has_reader)
            sender.send(b"telegram")
            _, near = place.recvfrom(100)
            for _ in range(500):
                place.sendto(b"garbage" * 100, near)
            sender.send(b"the next")
            assert await received(place, 1) == [b"the next"]


async def test_what_the_system_will_not_send_is_said_and_tried_again() -> None:
    health = make_health()
    with receiver() as place:
        sender = UdpSender(UdpLink("127.0.0.1", place.getsockname()[1]), health)
        async with kept(sender):
            await until(lambda: sender.has_reader)
            sender.send(bytes(70_000))  # Longer than any datagram.
            assert not health.is_up
            assert "Message too long" in health.detail
            assert not sender.has_reader
            sender.send(b"meanwhile")
            assert dict(health.lost) == {"down": 2}
            await until(lambda: sender.has_reader)
            sender.send(b"well")
            assert await received(place, 1) == [b"well"]


class Names:
    """In place of the name server."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.address = ""
        self._addresses = socket.getaddrinfo
        monkeypatch.setattr(socket, "getaddrinfo", self.look_up)

    def look_up(self, host: str, *args: Any, **kwargs: Any) -> Sequence[tuple[object, ...]]:
        if host != "plc.ship":
            return self._addresses(host, *args, **kwargs)
        if not self.address:
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (self.address, 0))]


async def test_a_name_that_comes_to_be_known(monkeypatch: pytest.MonkeyPatch) -> None:
    names, health = Names(monkeypatch), make_health()
    with receiver() as place, capture_logs() as logs:
        sender = UdpSender(UdpLink("plc.ship", place.getsockname()[1]), health)
        async with kept(sender):
            await until(lambda: "is unknown" in health.detail)
            assert "write the IP address into the link" in health.detail
            sender.send(b"lost")
            names.address = "127.0.0.1"
            await until(lambda: sender.has_reader)
            sender.send(b"well")
            assert await received(place, 1) == [b"well"]
    assert dict(health.lost) == {"down": 1}
    assert [line["event"] for line in logs] == ["output down", "output up"]


async def test_a_name_that_moves_to_another_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heaved.outputs.senders.udp._LOOKED_UP_AGAIN_S", 0.01)
    names = Names(monkeypatch)
    names.address = "127.0.0.1"
    with receiver() as old, receiver("127.0.0.2", old.getsockname()[1]) as new:
        sender = UdpSender(UdpLink("plc.ship", old.getsockname()[1]), make_health())
        async with kept(sender):
            await until(lambda: sender.has_reader)
            sender.send(b"here")
            assert await received(old, 1) == [b"here"]
            names.address = "127.0.0.2"
            await until(lambda: sender._address == "127.0.0.2")
            sender.send(b"there")
            assert await received(new, 1) == [b"there"]
            names.address = ""  # The name server is away: what is known is still good.
            sender.send(b"still")
            assert await received(new, 1) == [b"still"]


async def test_a_full_buffer_costs_the_telegram_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    health = make_health()
    with receiver() as place:
        sender = UdpSender(UdpLink("127.0.0.1", place.getsockname()[1]), health)
        async with kept(sender):
            await until(lambda: sender.has_reader)
            full = OSError(errno.ENOBUFS, "No buffer space available")
            with monkeypatch.context() as patch:
                patch.setattr(sender, "_try", lambda _: full)
                sender.send(b"lost")
            sender.send(b"well")
            assert await received(place, 1) == [b"well"]
    assert (dict(health.lost), health.is_up) == ({"slow": 1}, True)
