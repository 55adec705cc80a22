"""Who may connect, and letting connections in: also when there is no descriptor for one."""

from __future__ import annotations

import asyncio
import errno
import os
import resource
import socket
import sys
from typing import TYPE_CHECKING

import pytest
from structlog.testing import capture_logs

from heaved.networks import checked_networks, is_allowed, is_loopback_host, parse_networks
from heaved.outputs import listen as listen_module
from heaved.outputs.listen import Listener, ListenError

if TYPE_CHECKING:
    from collections.abc import AsyncIterator


@pytest.mark.parametrize(
    ("address", "allow", "allowed"),
    [
        ("127.0.0.1", (), True),
        ("127.1.2.3", (), True),
        ("::1", (), True),
        ("::ffff:127.0.0.1", (), True),
        ("192.168.10.7", (), False),
        ("192.168.10.7", ("192.168.10.0/24",), True),
        ("192.168.11.7", ("192.168.10.0/24",), False),
        ("192.168.11.7", ("192.168.10.0/24", "192.168.11.7"), True),
        ("::ffff:192.168.10.7", ("192.168.10.0/24",), True),
        ("::ffff:192.168.11.7", ("192.168.10.0/24",), False),
        ("10.1.2.3", ("::ffff:10.0.0.0/104",), True),
        ("::ffff:10.1.2.3", ("::ffff:10.0.0.0/104",), True),
        ("11.1.2.3", ("::ffff:10.0.0.0/104",), False),
        ("192.168.10.7", ("::ffff:192.168.10.7",), True),
        ("8.8.8.8", ("::ffff:0:0/96",), True),
        ("8.8.8.8", ("fd00::/8",), False),
        ("fd00::1", ("fd00::/8",), True),
        ("fe80::1%eth0", ("fe80::/10",), True),
        ("fe80::1", ("192.168.10.0/24",), False),
        ("8.8.8.8", ("0.0.0.0/0",), True),
        ("", ("0.0.0.0/0",), False),
        ("/run/socket", ("0.0.0.0/0",), False),
    ],
)
def test_is_allowed(address: str, allow: tuple[str, ...], allowed: bool) -> None:
    assert is_allowed(address, parse_networks(allow)) is allowed


@pytest.mark.parametrize("entry", ["192.168.10.1/24", "crane", "", "10.0.0.0/33", "10.0.0"])
def test_an_entry_that_is_no_network_is_named(entry: str) -> None:
    with pytest.raises(ValueError, match=r"\[http\] allow: ") as raised:
        checked_networks("http", "127.0.0.1", ("10.0.0.0/8", entry))
    assert repr(entry) in str(raised.value)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.2", "::1", "localhost"])
def test_loopback_needs_no_list(host: str) -> None:
    assert is_loopback_host(host)
    assert checked_networks("stream", host, ()) == ()


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.10.2", "crane-pc"])
def test_other_hosts_need_one(host: str) -> None:
    with pytest.raises(ValueError, match="name the networks that may connect"):
        checked_networks("stream", host, ())
    assert len(checked_networks("stream", host, ("192.168.10.0/24",))) == 1


# ---- letting them in -------------------------------------------------------------------------------------------------


class Greeter(asyncio.Protocol):
    """Says the address of its peer, and nothing else."""

    def __init__(self, address: str) -> None:
        self._address = address

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        transport.write(self._address.encode())
        transport.close()


def never(_reason: str, _address: str, message: str) -> None:
    pytest.fail(message)


@pytest.fixture
async def address() -> AsyncIterator[tuple[str, int]]:
    listener = Listener("stream", "127.0.0.1", 0, Greeter, never)
    yield await listener.start()
    listener.close()


async def said(address: tuple[str, int]) -> bytes:
    reader, writer = await asyncio.open_connection(*address)
    try:
        return await reader.read()
    except ConnectionResetError:
        return b""
    finally:
        writer.close()


async def test_who_comes_is_let_in(address: tuple[str, int]) -> None:
    assert await asyncio.gather(*(said(address) for _ in range(90))) == [b"127.0.0.1"] * 90


async def test_the_last_descriptors_are_kept_for_others(
    address: tuple[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listen_module, "_highest_descriptor", lambda: 3)
    with capture_logs() as logs:
        assert await said(address) == b""
    monkeypatch.undo()
    assert await said(address) == b"127.0.0.1"
    assert [line["reason"] for line in logs] == ["no descriptor to spare"]
    assert "ulimit -n" in logs[0]["hint"]


@pytest.mark.parametrize(
    ("limit", "highest"), [(32, 24), (64, 48), (1024, 1008), (resource.RLIM_INFINITY, sys.maxsize)]
)
def test_how_many_descriptors_there_are(monkeypatch: pytest.MonkeyPatch, limit: int, highest: int) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _kind: (limit, limit))
    assert listen_module._highest_descriptor() == highest


@pytest.mark.parametrize("number", [errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EPROTO])
async def test_what_cannot_be_accepted_waits(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """One line for each attempt, not one for each that waits, and nobody is lost."""
    faults = [OSError(number, os.strerror(number))] * 2

    ordinary = socket.socket

    class Exhausted(socket.socket):
        def accept(self) -> tuple[socket.socket, object]:
            if faults:
                raise faults.pop()
            return super().accept()

    monkeypatch.setattr(listen_module, "_PAUSE_S", 0.0)
    monkeypatch.setattr(socket, "socket", Exhausted)
    listener = Listener("http", "127.0.0.1", 0, Greeter, never)
    address = await listener.start()
    monkeypatch.setattr(socket, "socket", ordinary)
    with capture_logs() as logs:
        assert await asyncio.gather(*(said(address) for _ in range(20))) == [b"127.0.0.1"] * 20
    listener.close()
    assert [line["reason"] for line in logs] == [os.strerror(number)] * 2
    assert {line["server"] for line in logs} == {"http"}


async def test_closed_while_it_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    listener = Listener("stream", "127.0.0.1", 0, Greeter, never)
    address = await listener.start()
    listener._pause(listener._sockets[0], OSError(errno.EMFILE, "none left"))
    listener.close()
    listener.close()
    with pytest.raises(ConnectionRefusedError):
        await said(address)


@pytest.mark.parametrize("host", ["nowhere.invalid", "a" * 300, "192.0.2.1"])
async def test_where_it_cannot_listen(host: str) -> None:
    with pytest.raises(ListenError, match=r"\[stream\] cannot listen on .*: change \[stream\] host"):
        await Listener("stream", host, 0, Greeter, never).start()
