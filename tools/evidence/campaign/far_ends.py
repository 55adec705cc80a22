"""Those to whom the daemon connects: a reader of telegrams, a database, a broker, a PLC. None does what it should for
long.
"""

from __future__ import annotations

import asyncio
import socket
import struct
from contextlib import suppress
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import random
    from collections.abc import Awaitable, Callable

_CHUNK: Final = 1 << 16


class FarEnd:
    """One that listens at a port that stays the same, and behaves as it is told to.

    Attributes:
        behaviour: name of one of :data:`BEHAVIOURS`; empty: all is taken, and nothing said.
        connections: so far.
        bytes_taken: likewise.
    """

    def __init__(self, port: int, chance: random.Random) -> None:
        self.port, self._chance = port, chance
        self.behaviour = ""
        self.connections = self.bytes_taken = 0
        self._server: asyncio.Server | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    async def open(self) -> None:
        """Listen."""
        if self._server is None:
            self._server = await asyncio.start_server(self._met, "127.0.0.1", self.port, limit=_CHUNK)

    def refuse(self) -> None:
        """Listen no longer."""
        if self._server is not None:
            self._server.close()
            self._server = None

    def part(self) -> int:
        """End all connections; how many there were."""
        for task in self._tasks:
            task.cancel()
        return len(self._tasks)

    async def close(self) -> None:
        """Be gone."""
        self.refuse()
        self.part()
        if self._tasks:
            await asyncio.wait(self._tasks)

    def _met(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        task = asyncio.create_task(self._serve(reader, writer))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            with suppress(OSError):
                if self.behaviour:
                    await BEHAVIOURS[self.behaviour](reader, writer, self._chance)
                while data := await reader.read(_CHUNK):
                    self.bytes_taken += len(data)
        finally:
            writer.transport.abort()


async def _resets(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter, _chance: random.Random) -> None:
    linger = struct.pack("ii", 1, 0)
    writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
    writer.transport.abort()


async def _stuck(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter, _chance: random.Random) -> None:
    """Never takes anything: until it is parted."""
    writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    writer.transport.pause_reading()  # type: ignore[attr-defined]
    await asyncio.Event().wait()


async def _slow(reader: asyncio.StreamReader, _writer: asyncio.StreamWriter, _chance: random.Random) -> None:
    while await reader.read(16):  # noqa: ASYNC110  # It is no waiting: it is slow.
        await asyncio.sleep(0.02)


async def _floods(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter, chance: random.Random) -> None:
    """Says some megabytes, of what nobody has asked for."""
    for _ in range(64):
        writer.write(chance.randbytes(_CHUNK))
        await writer.drain()


async def _answers_nonsense(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, chance: random.Random) -> None:
    """To whatever it is told: half of an answer of HTTP, MQTT or Modbus, or noise."""
    answers = (
        b"HTTP/1.1 204 No Con",
        b"HTTP/1.1 999 \r\n\r\n",
        b"\x20\x02\x00",
        b"\x20\xff\xff\xff\xff\x7f",
        b"\0\1\0\0\xff\xff",
    )
    while await reader.read(_CHUNK):
        writer.write(chance.choice((*answers, chance.randbytes(40))))


async def _half_closes(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter, _chance: random.Random) -> None:
    writer.write_eof()


BEHAVIOURS: Final[dict[str, Callable[[asyncio.StreamReader, asyncio.StreamWriter, random.Random], Awaitable[None]]]] = {
    "resets": _resets,
    "stuck": _stuck,
    "slow": _slow,
    "floods": _floods,
    "answers nonsense": _answers_nonsense,
    "half-closes": _half_closes,
}
"""What it does with a connection before it takes what comes."""
