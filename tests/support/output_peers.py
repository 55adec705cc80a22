"""What outputs are tested with: a link that runs within a test, and who is at its far end."""

from __future__ import annotations

import asyncio
import os
import socket
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING

from running import PATIENCE_S

from heaved.outputs.output import OutputHealth

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from pathlib import Path

    from heaved.outputs.output import Output
    from heaved.outputs.records import StatusRecord
    from heaved.outputs.senders.sender import Sender

LINE = b"%06d" + b"." * 92 + b"\r\n"
"""A telegram of 100 bytes that is known by its number."""


def make_health(name: str = "plc") -> OutputHealth:
    return OutputHealth(name, "test", "somewhere")


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    """A port of loopback on which nobody listens."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


async def until(condition: Callable[[], object]) -> None:
    """Let the event loop go on until it is so."""
    async with asyncio.timeout(PATIENCE_S):
        while not condition():  # noqa: ASYNC110 - what is waited for has no event
            await asyncio.sleep(0.002)


async def until_gone(sender: Sender, left: int = 0) -> None:
    """That a reader has gone shows on sending: until no more than ``left`` are there."""

    def gone() -> bool:
        sender.send(b"is anybody there?\r\n")
        return len(getattr(sender, "_readers", ())) <= left if left else not sender.has_reader

    await until(gone)


@asynccontextmanager
async def kept(runs: Sender | Output) -> AsyncIterator[None]:
    """``run()`` in a task of its own; cancelled at the end, which must not raise."""
    task = asyncio.create_task(runs.run())
    try:
        yield
        assert not task.done(), task.exception()
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        await asyncio.sleep(0)  # What was closed is told so.


class SerialPort:
    """A serial port with its far end, under a name that stays when it is unplugged and comes back as another device."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.far = -1
        self.plug_in()

    def plug_in(self) -> None:
        self.far, near = os.openpty()
        os.set_blocking(self.far, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(near))
        self._near = near  # Kept open, so that what is written before anybody opens the port is not lost.

    def let_go(self) -> None:
        """Only who uses the port has it open now."""
        os.close(self._near)
        self._near = -1

    def unplug(self) -> None:
        if self._near >= 0:
            os.close(self._near)
        if self.far >= 0:
            os.close(self.far)
        self._near = self.far = -1

    def heard(self) -> bytes:
        """What has come out of it since."""
        found = b""
        with suppress(BlockingIOError, OSError):
            while data := os.read(self.far, 65536):
                found += data
        return found


def refuse_to_read(connection: socket.socket) -> None:
    """Before it connects: the system shall not read ahead for it."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)


async def heard(connection: socket.socket, size: int) -> bytes:
    found = b""
    async with asyncio.timeout(10.0):
        while len(found) < size:
            data = await asyncio.get_running_loop().sock_recv(connection, size - len(found))
            assert data, f"ended after {found!r}"
            found += data
    return found


def nobody_asks() -> StatusRecord:
    """The status of a daemon none of whose outputs tells it."""
    raise AssertionError
