"""Raw Modbus slaves for the tests: a serial one on a pty, and a TCP one, that answer whatever the test says.

Written from the Modbus documents alone, sharing nothing with the code under test: frames, and a bitwise CRC.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import tty
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from heaved.devices.bus import Bus, PollResult
from heaved.devices.profile import Block, DeviceSpec, Field, Profile, Quantity

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

PATIENCE_S = 20.0
"""No test measures time: this only ends one that hangs."""


def crc(data: bytes) -> bytes:
    """CRC-16/MODBUS, bit by bit, low byte first as on the line."""
    register = 0xFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            carry = register & 1
            register >>= 1
            if carry:
                register ^= 0xA001
    return bytes((register & 0xFF, register >> 8))


def rtu(body: bytes) -> bytes:
    return body + crc(body)


def pdu_answer(function: int, registers: list[int]) -> bytes:
    return bytes((function, 2 * len(registers))) + b"".join(word.to_bytes(2) for word in registers)


def rtu_answer(request: bytes, registers: list[int]) -> bytes:
    return rtu(request[:1] + pdu_answer(request[1], registers))


def count_of(request: bytes) -> int:
    """Registers asked for by a serial read request."""
    return int.from_bytes(request[4:6])


class RtuSlave:
    """Listens on the master side of a pty; ``answer`` gets every request and returns the bytes to send at once."""

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        self.answer = answer
        self.requests: list[bytes] = []
        self._heard = b""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        asyncio.get_running_loop().add_reader(self._master, self._readable)

    def _readable(self) -> None:
        self._heard += os.read(self._master, 4096)
        while len(self._heard) >= 8:
            request, self._heard = self._heard[:8], self._heard[8:]
            assert crc(request[:6]) == request[6:]
            self.requests.append(request)
            self.say(self.answer(request))

    def say(self, data: bytes) -> None:
        if data:
            os.write(self._master, data)

    def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self._master)
        os.close(self._master)
        os.close(self._slave)


class TcpSlave:
    """``answer`` gets every request frame and returns the bytes to send at once; None: close instead.

    ``idle_s``: close when nothing is asked for so long; 0: right after an answer.
    """

    def __init__(self, answer: Callable[[bytes], bytes | None], idle_s: float | None = None) -> None:
        self.answer = answer
        self.idle_s = idle_s
        self.requests: list[bytes] = []
        self.port = 0
        self.connections = 0
        self._server: asyncio.Server | None = None
        self._writers: set[asyncio.StreamWriter] = set()

    async def start(self, port: int = 0) -> None:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", port, reuse_address=True)
        self.port = self._server.sockets[0].getsockname()[1]

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        self.connections += 1
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError, TimeoutError):
            while True:
                async with asyncio.timeout(self.idle_s or None):
                    head = await reader.readexactly(6)
                request = head + await reader.readexactly(int.from_bytes(head[4:6]))
                self.requests.append(request)
                if (answer := self.answer(request)) is None:
                    break
                writer.write(answer)
                if self.idle_s == 0.0:
                    break
        self._writers.discard(writer)
        writer.close()

    def say_to_all(self, data: bytes) -> None:
        for writer in self._writers:
            writer.write(data)

    async def stop(self) -> None:
        """Resets the connections and stops listening."""
        if self._server is not None:
            self._server.close()
        for writer in self._writers:
            writer.transport.abort()
        if self._server is not None:
            await self._server.wait_closed()


def mbap_answer(transaction: int, unit: int, pdu: bytes) -> bytes:
    return transaction.to_bytes(2) + b"\x00\x00" + (len(pdu) + 1).to_bytes(2) + bytes((unit,)) + pdu


def tcp_answer(request: bytes, registers: list[int]) -> bytes:
    return mbap_answer(int.from_bytes(request[:2]), request[6], pdu_answer(request[7], registers))


class Results:
    """Collects poll results, and waits for what the test expects of them."""

    def __init__(self) -> None:
        self.all: list[PollResult] = []
        self._changed = asyncio.Event()

    def __call__(self, result: PollResult) -> None:
        self.all.append(result)
        self._changed.set()

    async def until(self, expected: Callable[[PollResult], bool], since: int = 0) -> PollResult:
        """The first result, of those from number ``since`` on, that is as expected."""
        async with asyncio.timeout(PATIENCE_S):
            while True:
                for result in self.all[since:]:
                    if expected(result):
                        return result
                since = len(self.all)
                self._changed.clear()
                await self._changed.wait()

    async def number(self, count: int) -> list[PollResult]:
        """The first ``count`` results."""
        async with asyncio.timeout(PATIENCE_S):
            while len(self.all) < count:
                self._changed.clear()
                await self._changed.wait()
        return self.all[:count]


@asynccontextmanager
async def running(devices: list[DeviceSpec], results: Results) -> AsyncIterator[Bus]:
    bus = Bus(devices, results)
    task = asyncio.create_task(bus.run())
    try:
        yield bus
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


def counter_profile(registers: int = 3) -> Profile:
    """Every register is an acceleration in m/s2, unscaled: a slave that counts is seen to count."""
    quantities: tuple[Quantity, ...] = ("az_mps2", "ax_mps2", "ay_mps2")
    fields = tuple(
        Field(quantity=name, offset=i, type="uint16", unit="m/s2") for i, name in enumerate(quantities[:registers])
    )
    return Profile(name="counter", blocks=(Block(start=0x34, fields=fields),))


def device(link: str, **changes: object) -> DeviceSpec:
    settings: dict[str, object] = {
        "name": "imu", "role": "imu", "link": link, "device_id": 80, "profile": counter_profile(),
        "rate_hz": 200.0, "timeout_ms": 500.0,
    }  # fmt: skip
    return DeviceSpec(**{**settings, **changes})  # type: ignore[arg-type]
