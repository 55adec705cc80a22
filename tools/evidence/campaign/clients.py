"""Clients that no server wants: slow, stuck, flooding, half-closing, malicious. Each says how many it has been."""

from __future__ import annotations

import asyncio
import socket
import struct
from contextlib import suppress
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import random

FLOOD_BYTES: Final = 1 << 20
_STREAM: Final = (
    b'?WATCH={"classes":["MOTION","SEA"]}\n',
    b'?WATCH={"classes"' + b":" * 70_000,
    b"?" * 200_000,
    b"\0" * 4096 + b"\n",
    b"?VERSION;\n" * 500,
    b'?WATCH={"a":' + b"[" * 20_000 + b"\n",
    "?WÄTCH\n".encode("utf-16"),
)
_HTTP: Final = (
    b"GET / HTTP/1.1\r\n",
    b"GET /metrics HTTP/1.1\r\nHost: a\r\nContent-Length: 99999999999\r\n\r\n",
    b"GET /" + b"a" * 100_000 + b" HTTP/1.1\r\n\r\n",
    b"GET /metrics HTTP/1.1\r\n" + b"X: y\r\n" * 5000,
    b"POST /metrics HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\nFFFFFFFFFFFFFFFF\r\n",
    b"GET /../../etc/passwd HTTP/1.1\r\nHost: a\r\n\r\n",
    b"\x16\x03\x01\x02\0\x01\0\x01\xfc\x03\x03" + b"\xa5" * 500,
    b"GET /healthz HTTP/1.1\r\nHost: a\r\n\r\n" * 200,
)
_REGISTERS: Final = (
    b"\0\1\0\0\0\6\1\3\0\3\0\x7d",
    b"\0\1\0\0\xff\xff\1\3",
    b"\0\1\0\0\0\0",
    b"\0\1\0\7\0\6\1\3\0\3\0\6",
    b"\0\1\0\0\0\6\1\6\0\3\x12\x34",
    b"\0\1\0\0\0\6\1\x10\0\3\0\x7f",
    b"\0\1\0\0\0\6\1\3\xff\xff\0\x7d",
    b"\0\1\0\0\0\6\1\3\0\3\0\6" * 400,
    b"\0\1\0\0\0\5\1\x2b\x0e\1\0",
)
PAYLOADS: Final = {
    "stream": _STREAM,
    "http": _HTTP,
    "registers": _REGISTERS,
    "telegram": _REGISTERS + _HTTP[:2],
    "page": _HTTP,
}
"""What is sent, by what listens."""


async def _connected(port: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter] | None:
    with suppress(OSError, TimeoutError):
        return await asyncio.wait_for(asyncio.open_connection("127.0.0.1", port, limit=4096), 5.0)
    return None


def _abort(writer: asyncio.StreamWriter) -> None:
    """With RST."""
    with suppress(OSError):
        linger = struct.pack("ii", 1, 0)
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
    writer.transport.abort()


async def resetting(port: int, payloads: tuple[bytes, ...], chance: random.Random, _lasts_s: float) -> int:
    """Say something and be gone at once, some forty times."""
    done = 0
    for _ in range(40):
        if (opened := await _connected(port)) is None:
            continue
        _, writer = opened
        with suppress(OSError):
            writer.write(chance.choice(payloads)[:2000])
        _abort(writer)
        done += 1
    return done


async def malicious(port: int, payloads: tuple[bytes, ...], chance: random.Random, lasts_s: float) -> int:
    """Say what nobody should, one connection after the other, reading what comes for a moment."""
    done, loop = 0, asyncio.get_running_loop()
    until_s = loop.time() + lasts_s
    while loop.time() < until_s:
        if (opened := await _connected(port)) is None:
            await asyncio.sleep(0.05)
            continue
        reader, writer = opened
        payload = bytearray(chance.choice(payloads))
        for _ in range(chance.choice((0, 0, 1, 3))):
            payload[chance.randrange(len(payload))] = chance.randrange(256)
        with suppress(OSError, TimeoutError, ValueError):
            writer.write(bytes(payload))
            await asyncio.wait_for(reader.read(4096), 0.05)
        _abort(writer)
        done += 1
    return done


async def flooding(port: int, payloads: tuple[bytes, ...], chance: random.Random, lasts_s: float) -> int:
    """A megabyte and more of what is no request, and never a byte read."""
    if (opened := await _connected(port)) is None:
        return 0
    _, writer = opened
    with suppress(OSError, TimeoutError):
        async with asyncio.timeout(lasts_s):
            for _ in range(16):
                writer.write(chance.choice((chance.randbytes(1 << 16), payloads[0] * ((1 << 16) // len(payloads[0])))))
                await writer.drain()
    _abort(writer)
    return 1


async def stuck(port: int, payloads: tuple[bytes, ...], _chance: random.Random, lasts_s: float) -> int:
    """Ask, and never read; several at a time."""
    writers = []
    for _ in range(8):
        if (opened := await _connected(port)) is not None:
            _, writer = opened
            with suppress(OSError):
                writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
                writer.write(payloads[0])
            writer.transport.pause_reading()  # type: ignore[attr-defined]
            writers.append(writer)
    await asyncio.sleep(lasts_s)
    for writer in writers:
        _abort(writer)
    return len(writers)


async def slow(port: int, payloads: tuple[bytes, ...], _chance: random.Random, lasts_s: float) -> int:
    """Ask byte by byte, and read as slowly."""
    if (opened := await _connected(port)) is None:
        return 0
    reader, writer = opened
    loop = asyncio.get_running_loop()
    until_s, place = loop.time() + lasts_s, 0
    with suppress(OSError):
        while loop.time() < until_s:
            writer.write(payloads[0][place % len(payloads[0])].to_bytes())
            place += 1
            with suppress(TimeoutError):
                await asyncio.wait_for(reader.read(16), 0.02)
    _abort(writer)
    return 1


async def half_closing(port: int, payloads: tuple[bytes, ...], chance: random.Random, lasts_s: float) -> int:
    """Ask, and close our own direction; read on, or not."""
    done = 0
    writers = []
    for _ in range(10):
        if (opened := await _connected(port)) is None:
            continue
        reader, writer = opened
        with suppress(OSError, TimeoutError):
            writer.write(payloads[0])
            writer.write_eof()
            if chance.random() < 0.5:
                await asyncio.wait_for(reader.read(100), 0.05)
        writers.append(writer)
        done += 1
    await asyncio.sleep(0.2 * lasts_s)
    for writer in writers:
        _abort(writer)
    return done


Client = "Callable[[int, tuple[bytes, ...], random.Random, float], Awaitable[int]]"
CLIENTS: Final = {
    "resetting": resetting,
    "malicious": malicious,
    "flooding": flooding,
    "stuck": stuck,
    "slow": slow,
    "half-closing": half_closing,
}
