"""Host names: looked up without holding anything up, whatever the name server does."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
import threading

import pytest
from running import PATIENCE_S

from heaved.host_name import MOST_ADDRESSES, HostName


class NameServer:
    """In place of the system's: answers when told to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked = 0
        self.answers = threading.Event()
        self.found: list[str] | OSError = []
        monkeypatch.setattr(socket, "getaddrinfo", self.look_up)

    def look_up(self, host: str, port: object, **kwargs: object) -> list[tuple[object, ...]]:
        self.asked += 1
        assert self.answers.wait(PATIENCE_S)
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


async def test_names_that_nobody_knows_leave_the_others_their_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """The event loop has no more than six on a small machine: the state file and the configuration need them."""
    server = NameServer(monkeypatch)
    names = [HostName(f"plc{i}.ship") for i in range(40)]
    found = await asyncio.gather(*(name.addresses(0.01) for name in names), return_exceptions=True)
    assert {type(error) for error in found} == {socket.gaierror}
    assert await asyncio.wait_for(asyncio.to_thread(lambda: "well"), PATIENCE_S) == "well"
    server.found = ["10.0.0.7"]
    server.answers.set()
    assert await names[-1].addresses(PATIENCE_S) == ["10.0.0.7"]
    await asyncio.gather(*(name.addresses(PATIENCE_S) for name in names))


@pytest.mark.parametrize("host", ["a" * 64, "a..b", "." * 300])
async def test_what_no_host_can_be_called_is_unknown(host: str) -> None:
    with pytest.raises(socket.gaierror):
        await HostName(host).addresses(PATIENCE_S)


ENDS = """
import asyncio, socket, time
from heaved.host_name import HostName
socket.getaddrinfo = lambda *_, **__: time.sleep(3600)
async def main():
    try:
        await HostName("plc.ship").addresses(0.1)
    except socket.gaierror:
        print("not known")
asyncio.run(main())
"""


def test_a_name_server_that_is_away_does_not_hold_the_end_of_the_process() -> None:
    ended = subprocess.run([sys.executable, "-c", ENDS], capture_output=True, timeout=60, check=True)
    assert ended.stdout == b"not known\n"
