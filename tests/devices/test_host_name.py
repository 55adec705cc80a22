"""Host names: looked up without holding anything up, whatever the name server does."""

from __future__ import annotations

import asyncio
import socket

import pytest

from heaved.host_name import MOST_ADDRESSES, HostName


class NameServer:
    """In place of the system's: answers when told to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked = 0
        self.answers = asyncio.Event()
        self.found: list[str] | OSError = []
        monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", self.look_up)

    async def look_up(self, host: str, port: object, **kwargs: object) -> list[tuple[object, ...]]:
        self.asked += 1
        await self.answers.wait()
        if isinstance(self.found, OSError):
            raise self.found
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, 0)) for address in self.found]


@pytest.mark.parametrize("host", ["10.0.0.7", "::1", "fd00::7"])
async def test_an_address_is_not_looked_up(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    server = NameServer(monkeypatch)
    assert await HostName(host).addresses(0.0) == [host]
    assert server.asked == 0


async def test_a_name_is_looked_up_once_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """A name server that is away would take a thread for every attempt to connect."""
    server = NameServer(monkeypatch)
    name = HostName("plc.ship")
    for _ in range(3):
        with pytest.raises(socket.gaierror) as caught:
            await name.addresses(0.01)
        assert caught.value.errno == socket.EAI_AGAIN
    assert server.asked == 1
    server.found = ["10.0.0.7", "10.0.0.8", "10.0.0.7", *(f"10.0.1.{i}" for i in range(9))]
    server.answers.set()
    addresses = await name.addresses(1.0)
    assert addresses[:2] == ["10.0.0.7", "10.0.0.8"]
    assert len(addresses) == MOST_ADDRESSES
    assert await name.addresses(1.0) == addresses
    assert server.asked == 2


async def test_a_name_that_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    server = NameServer(monkeypatch)
    server.found = socket.gaierror(socket.EAI_NONAME, "Name or service not known")
    server.answers.set()
    with pytest.raises(socket.gaierror, match="not known"):
        await HostName("plc.shop").addresses(1.0)
