"""``[registers] mode = "push"``: the same words, written into a PLC that wants the sensor to be the master.

One write is outstanding, and each is made of the moment at which it goes out. Whatever the PLC does, refuse, be silent,
answer late, close: it is written to again, and nobody else waits for it.
"""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Final, cast

from heaved.host_name import HostName
from heaved.links import SerialLink, TcpLink, explain_open_failure, silence_s
from heaved.outputs.modbus_frames import (
    NotModbusError,
    TcpFrames,
    explain_refusal,
    find_write_result,
    rtu_frame,
    tcp_frame,
    write_request,
    write_result,
)
from heaved.outputs.output import OutputHealth
from heaved.outputs.register_map import write_time_s
from heaved.serial_port import SerialPort
from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.links import Link
    from heaved.outputs.register_map import RegisterMap, RegistersParams
    from heaved.samples import MotionFrame

RETRY_S: Final = 1.0
"""Between attempts to reach a PLC, or to write into one that refuses."""
CONNECT_S: Final = 2.0
ANSWER_S: Final = 0.5
"""A PLC answers within its cycle, tens of milliseconds."""
_HANGING_AFTER: Final = 3
"""Writes in a row without a byte after which a TCP connection is made anew: over a cable that was pulled, the old one
would recover only when TCP resends, which it does ever more rarely."""
_SILENT_AFTER: Final = 3
"""Writes in a row without an answer after which the PLC is said to be silent; one now and then is counted."""
_MOST_HEARD_BYTES: Final = 1024
"""While an answer of some ten bytes is waited for. A flood is no answer."""
_LATEST_S: Final = 1.0
"""An answer that comes later than that after its request, or after the last that was heard, is not expected any more.
On a serial line all answers to writes look alike: so after one that was missed nothing is written before."""
_LONGEST_DRAIN_S: Final = 5.0
"""A line that is never silent is noise."""


class RegisterPush:
    """Writes into a PLC; told every frame.

    Attributes:
        health: how it fares; ``sent`` counts what the PLC has acknowledged.
    """

    def __init__(
        self,
        params: RegistersParams,
        link: Link,
        registers: RegisterMap,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """``clock``: of the frames."""
        kind = "Modbus RTU" if isinstance(link, SerialLink) else "Modbus TCP"
        self.health = OutputHealth("registers", f"{kind} writes", str(link))
        self._link, self._params, self._registers, self._clock = link, params, registers, clock
        self._name = HostName(link.host if isinstance(link, TcpLink) else "")
        self._line: _TcpLine | _SerialLine | None = None
        self._missed = 0

    def publish(self, frame: MotionFrame) -> None:
        """The newest frame, for the next write."""
        self._registers.push(frame)

    async def run(self) -> None:
        """Write at the rate, for ever; never twice in a hurry for what was missed."""
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        try:
            while True:
                pause_s = await self._write()
                now_s = loop.time()
                due_s = max(due_s + 1.0 / self._params.rate_hz, now_s + pause_s)
                await asyncio.sleep(due_s - now_s)
        finally:
            self._hang_up()

    async def _write(self) -> float:
        """Write once; returns for how long the PLC is better left alone."""
        while True:
            had_line = self._line is not None and self._line.is_open
            try:
                line = await self._reach()
            except (OSError, UnicodeError) as error:  # The latter for what no host can be called.
                self._fail("not_connected", explain_open_failure(self._link, error))
                return RETRY_S
            try:
                result = await self._ask(line)
            except OSError as error:
                self._hang_up()
                if had_line:  # Some PLCs close after each answer, or soon: this one had done so when the write came.
                    continue
                self._fail("lost", f"{error.strerror or error}: check the PLC's Modbus settings; trying again")
                return RETRY_S
            return await self._judge(line, result)

    async def _reach(self) -> _TcpLine | _SerialLine:
        """The connection; a new one where there is none.

        Raises:
            OSError: there is none to be had.
        """
        if self._line is not None and self._line.is_open:
            return self._line
        self._hang_up()
        self._line = line = (
            _SerialLine(self._link) if isinstance(self._link, SerialLink) else _TcpLine(self._link, self._name)
        )
        await line.open()
        return line

    async def _ask(self, line: _TcpLine | _SerialLine) -> int | None:
        """Write the words of now; returns the result, None: there was none in time.

        Raises:
            OSError: the connection was lost.
        """
        params = self._params
        await line.make_ready()
        words = self._registers.at(self._clock())[: 2 * params.count]
        return await line.write(params.device_id, params.start, words)

    async def _judge(self, line: _TcpLine | _SerialLine, result: int | None) -> float:
        """Say what came of a write; returns for how long the PLC is better left alone."""
        if result == 0:
            self._missed = 0
            self.health.sent += 1
            self.health.up()
            return 0.0
        if result is not None:
            self._fail("refused", explain_refusal(result))
            return RETRY_S
        self._missed += 1
        self.health.lost["timeout"] += 1
        if self._missed >= _SILENT_AFTER or not self.health.is_up:
            waited_ms = 1e3 * _patience_s(self._link, self._params.count)
            self.health.down(f"no answer within {waited_ms:.0f} ms: {line.advice}")
        if line.is_hanging:
            self._hang_up()
        else:
            await line.drain()
        return 0.0

    def _fail(self, reason: str, detail: str) -> None:
        self.health.lost[reason] += 1
        self.health.down(detail)

    def _hang_up(self) -> None:
        if self._line is not None:
            self._line.close()
            self._line = None


def _patience_s(link: Link, count: int) -> float:
    """How long an answer is waited for."""
    return ANSWER_S + write_time_s(link, count)


class _Waiting:
    """For the one answer that is outstanding, or the end of the connection."""

    def __init__(self) -> None:
        self._result: asyncio.Future[int] | None = None

    async def result(self, patience_s: float) -> int | None:
        """None: it did not come in time.

        Raises:
            OSError: the connection was lost.
        """
        self._result = asyncio.get_running_loop().create_future()
        try:
            async with asyncio.timeout(patience_s):
                return await self._result
        except TimeoutError:
            return None
        finally:
            self._result = None

    @property
    def is_on(self) -> bool:
        """Whether an answer is wanted."""
        return self._result is not None and not self._result.done()

    def answered(self, result: int) -> None:
        """It has come."""
        if self._result is not None and not self._result.done():
            self._result.set_result(result)

    def failed(self, reason: str) -> None:
        """It cannot come any more."""
        if self._result is not None and not self._result.done():
            self._result.set_exception(ConnectionError(reason))


class _TcpLine(asyncio.Protocol):
    """A connection to a PLC. Answers carry the number of their request: late ones are known, and passed over."""

    advice = "check that the PLC runs, and [registers] device_id"

    def __init__(self, link: TcpLink, name: HostName) -> None:
        self.is_open = False
        self._link, self._name = link, name
        self._transport: asyncio.Transport | None = None
        self._frames = TcpFrames()
        self._waiting = _Waiting()
        self._transaction = 0
        self._unit, self._start, self._words = 0, 0, b""
        self._heard_bytes = 0
        self._unheard = 0

    @property
    def is_hanging(self) -> bool:
        """Whether it is better made anew."""
        return self._unheard >= _HANGING_AFTER

    async def open(self) -> None:
        """Raises:
        OSError: the PLC cannot be reached.
        """
        failure = OSError(f"{self._link.host} has no address")
        for address in await self._name.addresses(CONNECT_S):
            try:
                async with asyncio.timeout(CONNECT_S):
                    await asyncio.get_running_loop().create_connection(lambda: self, address, self._link.port)
            except OSError as error:
                failure = error
            else:
                return
        raise failure

    async def make_ready(self) -> None:
        """It always is."""

    async def write(self, device_id: int, start: int, words: bytes) -> int | None:
        """Returns 0 or the code of the exception; None: no answer in time.

        Raises:
            OSError: the connection was lost.
        """
        if self._transport is None or not self.is_open:
            raise ConnectionError("the connection was closed")
        self._transaction = self._transaction % 0xFFFF + 1
        self._unit, self._start, self._words = device_id, start, words
        self._heard_bytes = 0
        self._transport.write(tcp_frame(self._transaction, device_id, write_request(start, words)))
        result = await self._waiting.result(_patience_s(self._link, len(words) // 2))
        self._unheard = 0 if self._heard_bytes else self._unheard + 1
        return result

    async def drain(self) -> None:
        """A late answer does no harm."""

    def close(self) -> None:
        """At once."""
        self.is_open = False
        if self._transport is not None:
            self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self.is_open = True

    def connection_lost(self, error: Exception | None) -> None:
        self.is_open = False
        self._waiting.failed(f"the PLC closes the connection without an answer{f' ({error})' if error else ''}")

    def data_received(self, data: bytes) -> None:
        self._heard_bytes += len(data)
        if self._heard_bytes > _MOST_HEARD_BYTES:
            self._break_off(f"more than {_MOST_HEARD_BYTES} bytes where an answer has twelve: no PLC listens there")
            return
        self._frames.feed(data)
        try:
            while (frame := self._frames.next()) is not None:
                if frame.transaction == self._transaction and self._waiting.is_on:
                    self._take(frame.pdu)
        except NotModbusError as error:
            self._break_off(printable(str(error)))

    def _take(self, pdu: bytes) -> None:
        result = write_result(pdu, self._start, self._words)
        if result is None:
            self._break_off(f"an answer to something else than was asked ({pdu[:8].hex(' ')})")
        else:
            self._waiting.answered(result)

    def _break_off(self, reason: str) -> None:
        self._waiting.failed(reason)
        self.close()


class _SerialLine:
    """A serial line to a PLC. Its answers to writes all look alike: after one that did not come in time, nothing is
    written before the line has been silent for as long as a late one may take.
    """

    advice = "check power, wiring (A/B), [registers] device_id, baudrate and parity"
    is_hanging = False

    def __init__(self, link: SerialLink) -> None:
        self._link = link
        self._port = SerialPort(link, self._hear, self._gone)
        self._waiting = _Waiting()
        self._device_id, self._start, self._words, self._sent, self._heard = 0, 0, b"", b"", b""
        self._used_s = 0.0
        self.is_open = False

    async def open(self) -> None:
        """Raises:
        OSError: the port cannot be had.
        """
        self._port.open()
        self.is_open = True
        # Somebody else's answer may be under way.
        self._used_s = asyncio.get_running_loop().time()
        await self.drain()

    async def make_ready(self) -> None:
        """Keep the silence between two frames."""
        wait_s = self._used_s + silence_s(self._link) - asyncio.get_running_loop().time()
        if wait_s > 0.0:
            await asyncio.sleep(wait_s)

    async def write(self, device_id: int, start: int, words: bytes) -> int | None:
        """As that of a TCP connection."""
        if not self.is_open:
            raise ConnectionError("the port was lost")
        self._device_id, self._start, self._words, self._heard = device_id, start, words, b""
        self._sent = rtu_frame(device_id, write_request(start, words))
        if not self._port.write(self._sent):
            raise ConnectionError("the port takes nothing")
        self._used_s = asyncio.get_running_loop().time()
        return await self._waiting.result(_patience_s(self._link, len(words) // 2))

    async def drain(self) -> None:
        """Until nothing more is to be expected."""
        loop = asyncio.get_running_loop()
        most_s = loop.time() + _LONGEST_DRAIN_S
        # Every byte begins the silence anew.
        while self.is_open and (now_s := loop.time()) < (until_s := min(self._used_s + _LATEST_S, most_s)):  # noqa: ASYNC110
            await asyncio.sleep(until_s - now_s)

    def close(self) -> None:
        """Give the port back."""
        self.is_open = False
        self._port.close()

    def _hear(self, data: bytes) -> None:
        self._used_s = asyncio.get_running_loop().time()
        self._heard = heard = (self._heard + data)[-_MOST_HEARD_BYTES:]
        if self._waiting.is_on and not self._sent.startswith(heard):  # An adapter may echo.
            result = find_write_result(heard.removeprefix(self._sent), self._device_id, self._start, self._words)
            if result is not None:
                self._waiting.answered(result)

    def _gone(self, reason: str) -> None:
        self.is_open = False
        self._waiting.failed(f"{self._link.path} was lost ({reason})")
