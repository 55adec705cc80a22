"""Polling Modbus sensors: one task per bus, a result for every deadline, whatever the line does.

The only place that uses pymodbus clients. They open and close lines; requests are made and answers found here: its RTU
client takes any frame with the right id for the answer, so that a late answer is read as the next one, a frame
that it cannot decode raises inside the event loop, and it waits to the end of the timeout although the connection is
lost. Every byte received goes through :mod:`heaved.devices.frames`, and :class:`~heaved.devices.liveness.Contact`
decides when and how a slave may be asked again. What else is worked around, all of it true of pymodbus 3.16.1:

* it reconnects by itself with delays that double up to minutes; that is off;
* ``asyncio.wait_for``, which it connects with, can swallow a cancellation (Python 3.11); whoever opens looks again.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import struct
import termios
import time
from math import isnan, nan
from typing import TYPE_CHECKING, Any, Final

import msgspec
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient

from heaved.devices.frames import (
    MOST_RTU_BYTES,
    Request,
    Sender,
    crc16,
    explain_exception,
    explain_rtu_silence,
    explain_tcp_silence,
    find_rtu_answer,
    find_tcp_answer,
    find_tcp_contradiction,
    rtu_senders,
    tcp_senders,
    tcp_stream_is_whole,
)
from heaved.devices.link import bus_key
from heaved.devices.liveness import Contact
from heaved.devices.profile import Block, DeviceSpec, Quantity, block_registers
from heaved.devices.station import PollResult, Reading, Station
from heaved.devices.timer import DeadlineTimer, Pace, TimeLimit
from heaved.host_name import HostName
from heaved.links import Link, SerialLink, TcpLink, explain_open_failure, parse_link, silence_s
from heaved.samples import Fault

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

__all__ = ["Answer", "Bus", "OpenLink", "PollResult"]

CONNECT_TIMEOUT_S = 0.5
RETRY_S = 0.25
"""Between attempts to open a line; with the timeout, a device is back within a second of its return."""
_MOST_SPARE_BYTES: Final = 512
"""Of what nobody asked for: two frames of the greatest length."""
_MOST_HEARD_BYTES: Final = 8192
"""While an answer is waited for on TCP: the first ones, room for 31 of the greatest length. More is thrown away."""
_MOST_HEARD_SERIAL_BYTES: Final = 1024
"""On a serial line: the last ones, four of the greatest length. To look for an answer in a babble that looks like the
beginning of one at every byte takes 5 ms with so many, and 1.5 s with 2^18."""
_MOST_TRANSACTIONS: Final = 0xFFFF
_HEADER: Final = struct.Struct(">HHH")
"""Of a TCP frame: transaction, protocol, bytes that follow."""
_READ: Final = struct.Struct(">BBHH")
"""Device or unit id, function, first register, number of registers."""
_MOST_IN_VAIN: Final = 64
"""Unanswered requests that are remembered, to tell how late their answers come."""
HANGING_AFTER_POLLS = 4
"""Requests in a row without a byte after which a TCP connection is made anew: over a cable that was pulled, the old one
would recover only when TCP resends, which it does ever more rarely."""


class Answer(msgspec.Struct, frozen=True):
    """What came of one read."""

    sent_s: float
    registers: list[int]
    fault: Fault = Fault.NONE
    detail: str = ""
    answered: bool = True
    """The slave answered this very request, if only with an exception."""
    exception: int = 0
    """Its code."""


class OpenLink:
    """One open socket or serial port; one read at a time, never cancelled by its caller."""

    def __init__(
        self,
        link: Link,
        timer: DeadlineTimer,
        clock: Callable[[], float],
        lost: Callable[[], None],
        name: HostName | None = None,
    ) -> None:
        """``lost`` is called when the other side closes; ``name`` is the host's, if others look it up, too."""
        self.link = link
        self._name = name or HostName(link.host if isinstance(link, TcpLink) else "")
        self._timer = timer
        self._clock = clock
        self._lost = lost
        self.whole = True
        """False once a TCP stream was left within a frame: what follows cannot be read, so connect anew."""
        self.has_answered = False
        """Any request, since it was opened."""
        self.late_s: dict[int, float] = {}
        """By id, how long after its request the latest answer came that was too late."""
        self._request: Request | None = None
        self._done: asyncio.Future[None] | None = None
        """When the waiting for an answer is over."""
        self._limit = TimeLimit(self._stop_waiting)
        self._found = b""
        """The answer to the latest request, once it has come."""
        self._transaction = 0
        self._sent = b""
        self._heard = b""
        self._heard_s = 0.0
        self._spare = b""
        """What came beside the last answer, and since the last read."""
        self._in_vain: dict[Sender, float] = {}
        """The latest requests without an answer, as the sender of one would be known, with their times."""
        self._client: AsyncModbusTcpClient | AsyncModbusSerialClient | None = None

    async def open(self) -> str:
        """Returns why it failed and what to do; empty when open. Opening a serial port keeps the loop for a moment."""
        _quieten_pymodbus()
        if isinstance(self.link, SerialLink):
            return await self._open(self.link.path)
        failure = ""
        try:
            for address in await self._name.addresses(CONNECT_TIMEOUT_S):
                failure = await self._open(address)
                if not failure:
                    break
        except OSError as error:
            failure = explain_open_failure(self.link, error)
        return failure

    async def _open(self, place: str) -> str:
        client = self._client = self._make_client(place)
        create = client.ctx.call_create
        cause: list[BaseException] = []

        async def create_or_note() -> object:
            try:
                return await create()
            except OSError as error:
                cause.append(error)
                raise

        client.ctx.call_create = create_or_note
        try:
            opened = await client.connect()
            _raise_if_cancelled()
            if not opened:
                return explain_open_failure(self.link, cause[0] if cause else TimeoutError())
        except (termios.error, ValueError) as error:  # the port refuses its settings
            return explain_open_failure(self.link, error)
        if isinstance(self.link, SerialLink):
            with contextlib.suppress(ValueError):  # what pyserial raises where the port has no such mode
                # USB adapters otherwise hold bytes back for up to 16 ms. Only real ports know this.
                client.ctx.transport.sync_serial.set_low_latency_mode(True)  # type: ignore[attr-defined]
        self._heard_s = self._clock()
        return ""

    def _make_client(self, place: str) -> AsyncModbusTcpClient | AsyncModbusSerialClient:
        common: dict[str, Any] = {
            "timeout": CONNECT_TIMEOUT_S,
            "retries": 0,
            "reconnect_delay": 0,
            "trace_connect": self._trace_connect,
        }
        client: AsyncModbusTcpClient | AsyncModbusSerialClient
        if isinstance(self.link, TcpLink):
            client = AsyncModbusTcpClient(place, port=self.link.port, **common)
        else:
            settings = msgspec.structs.asdict(self.link)
            del settings["path"]
            client = AsyncModbusSerialClient(place, **settings, **common)
        client.ctx.data_received = self._on_bytes  # type: ignore[method-assign]  # None for pymodbus itself.
        return client

    def close(self) -> None:
        """Close the line."""
        self._limit.close()
        if self._client is not None:
            self._client.close()

    async def read(self, device_id: int, block: Block, count: int, timeout_s: float, *, first: int = 0) -> Answer:
        """Read ``count`` registers of a block, from its register ``first`` on."""
        client = self._client
        if isinstance(self.link, SerialLink):
            await self._wait_for_silence(self.link, timeout_s)
        if client is None or not client.connected:  # Perhaps just now, while it was silent.
            return Answer(nan, [], Fault.DISCONNECTED, "the connection is lost", False)
        request = Request(device_id, 3 if block.function == "holding" else 4, count)
        self._heard, self._found = b"", b""
        sent_s = self._clock()
        self._request = request
        self._done = asyncio.get_running_loop().create_future()
        self._limit.set(timeout_s)
        self._sent = self._request_frame(request, block.start + first)
        client.ctx.transport.write(self._sent)  # type: ignore[attr-defined]
        try:
            await self._done
        finally:
            self._limit.lift()
            self._request = None
        if not self._found:
            return self._unanswered(client.connected, sent_s, request, timeout_s)
        self.has_answered = True
        if self._in_vain or self.late_s:
            self.late_s.pop(device_id, None)
            self._in_vain = {asked: t_s for asked, t_s in self._in_vain.items() if asked.device_id != device_id}
        answer = self._found if isinstance(self.link, SerialLink) else self._found[6:]
        if answer[1] & 0x80:
            code = answer[2]
            return Answer(sent_s, [], Fault.EXCEPTION, explain_exception(code), exception=code)
        registers = list(struct.unpack_from(f">{answer[2] // 2}H", answer, 3))
        if len(registers) != count:
            detail = f"{len(registers)} registers instead of {count}: the profile's block does not fit the device"
            return Answer(sent_s, [], Fault.LENGTH, detail)
        return Answer(sent_s, registers)

    async def _wait_for_silence(self, link: SerialLink, most_s: float) -> None:
        """A late answer that is coming in would collide with the request."""
        latest_s = self._clock() + most_s
        while self._clock() < (free_s := min(self._heard_s + silence_s(link), latest_s)):
            await self._timer.wait_until(free_s)

    def _unanswered(self, connected: bool, sent_s: float, request: Request, timeout_s: float) -> Answer:
        if not connected:
            return Answer(sent_s, [], Fault.DISCONNECTED, "the connection was lost: trying to reconnect", False)
        self._note_late(self._senders(self._heard))
        number = self._transaction if isinstance(self.link, TcpLink) else 0
        self._in_vain[Sender(request.device_id, request.count, number)] = sent_s
        if len(self._in_vain) > _MOST_IN_VAIN:
            del self._in_vain[next(iter(self._in_vain))]
        self._spare = b""
        late_s = self.late_s.get(request.device_id, 0.0)
        if isinstance(self.link, SerialLink):
            why = explain_rtu_silence(self._heard, request, sent=self._sent, late_s=late_s)
        else:
            why = explain_tcp_silence(self._heard, self._transaction, request, late_s=late_s)
            self.whole = tcp_stream_is_whole(self._heard)
        waited = f" (waited {timeout_s * 1e3:g} ms)" if why.fault is Fault.TIMEOUT else ""
        return Answer(sent_s, [], why.fault, why.detail + waited, False)

    @property
    def has_heard(self) -> bool:
        """Whether anything came since the latest request was sent."""
        return bool(self._heard)

    def unasked(self) -> list[Sender]:
        """Who has sent something beside the last answer, or since; each is told once. The same answer once more is
        none: some devices repeat each, at once.
        """
        if not self._spare:
            return []
        spare = self._spare.replace(self._found, b"") if self._found else self._spare
        senders, self._spare = self._senders(spare), b""
        self._note_late(senders)
        return senders

    def _note_late(self, senders: Iterable[Sender]) -> None:
        for sender in senders:
            # An exception on a serial line does not say to which request: the latest is meant.
            asked = [
                t_s
                for request, t_s in self._in_vain.items()
                if request == sender or (request.device_id == sender.device_id and not sender.count)
            ]
            if asked:
                self.late_s[sender.device_id] = self._heard_s - asked[-1]

    def _senders(self, heard: bytes) -> list[Sender]:
        return rtu_senders(heard) if isinstance(self.link, SerialLink) else tcp_senders(heard)

    def _request_frame(self, request: Request, start: int) -> bytes:
        body = _READ.pack(request.device_id, request.function, start, request.count)
        if isinstance(self.link, SerialLink):
            return body + crc16(body).to_bytes(2, "little")
        self._transaction = self._transaction % _MOST_TRANSACTIONS + 1
        return _HEADER.pack(self._transaction, 0, len(body)) + body

    def _on_bytes(self, data: bytes) -> None:
        """What comes in, in whatever pieces."""
        self._heard_s = self._clock()
        request = self._request
        if request is None or self._found:
            self._spare = (self._spare + data)[-_MOST_SPARE_BYTES:]
            return
        heard = self._heard + data
        if isinstance(self.link, SerialLink):
            self._heard = heard = heard[-_MOST_HEARD_SERIAL_BYTES:]
            answer = find_rtu_answer(heard[-MOST_RTU_BYTES - len(data) :], request)  # It ends in what is new.
        else:
            if len(self._heard) == _MOST_HEARD_BYTES:
                return
            self._heard = heard = heard[:_MOST_HEARD_BYTES]
            answer = find_tcp_answer(heard, self._transaction, request)
            if not answer and find_tcp_contradiction(heard, self._transaction, request):
                self._stop_waiting()
        if answer:
            self._found = answer
            before, _, after = heard.partition(answer)
            self._spare = before + after
            self._stop_waiting()

    def _stop_waiting(self) -> None:
        """The answer to the request that is outstanding is there, or none can come any more."""
        if self._done is not None and not self._done.done():
            self._done.set_result(None)

    def _trace_connect(self, connected: bool) -> None:
        if not connected:
            self._stop_waiting()
            self._lost()


def _raise_if_cancelled() -> None:
    """After whatever waits within pymodbus: its ``wait_for`` may have swallowed the cancellation (Python 3.11)."""
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


def _quieten_pymodbus() -> None:
    """Its errors reach the daemon as results; as log lines they would come with every poll of an absent device. A level
    that somebody set on purpose stays.
    """
    logger = logging.getLogger("pymodbus.logging")
    if logger.level == logging.NOTSET:
        logger.setLevel(logging.CRITICAL)


class Bus:
    """All devices on one line, each polled at its own rate against absolute deadlines, one request at a time.

    Every deadline gives one :class:`PollResult`, also while the device or the line is away; ``on_poll`` is called on
    the loop and must be quick. The earliest deadline goes first. Lines are reopened for ever.

    Raises:
        ValueError: no devices, devices on different buses, a link that cannot be parsed, or a profile that carries
            nothing for its device's role.
    """

    def __init__(
        self,
        devices: Sequence[DeviceSpec],
        on_poll: Callable[[PollResult], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        links = {bus_key(parse_link(device.link)) for device in devices}
        if len(links) != 1:
            raise ValueError(f"a bus needs devices on one line, not on {len(links)}: {', '.join(sorted(links))}")
        self.link = parse_link(devices[0].link)
        self._on_poll = on_poll
        self._clock = clock
        self._contacts = self._make_contacts(devices, clock())
        self._stations = [Station(device, self.link, self._contacts[device.device_id], clock()) for device in devices]
        self._connection: OpenLink | None = None
        self._connection_number = 0
        self._down = Reading(fault=Fault.DISCONNECTED, detail="not connected yet")
        """What every poll gives while there is no connection."""
        self._lost = asyncio.Event()
        self._tried = asyncio.Event()
        """Cleared while a first connection, or one in place of a good one, is being made: a poll waits for it."""
        self._wanted = asyncio.Event()
        """A poll waits for a connection."""
        self._is_good = False
        """The last poll was answered (TCP). Some slaves close after every answer, or soon when they are not asked: then
        a connection is made anew without a pause, and the next poll succeeds."""
        self._unanswered = 0

    def _make_contacts(self, devices: Sequence[DeviceSpec], now_s: float) -> dict[int, Contact]:
        """By device id."""
        slaves: dict[int, list[DeviceSpec]] = {}
        for device in devices:
            slaves.setdefault(device.device_id, []).append(device)
        return {
            device_id: Contact(
                numbered=isinstance(self.link, TcpLink),
                lengths={block_registers(block) for spec in specs for block in spec.profile.blocks},
                alone=len(slaves) == 1,
                timeout_s=max(spec.timeout_ms for spec in specs) * 1e-3,
                opened_s=now_s,
            )
            for device_id, specs in slaves.items()
        }

    async def run(self) -> None:
        """Polls until cancelled; then the line is closed.

        Raises:
            ExceptionGroup: ``on_poll`` raised.
        """
        with DeadlineTimer() as timer:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._keep_open(timer), name=f"connect {self.link}")
                tasks.create_task(self._keep_polling(timer), name=f"poll {self.link}")

    # ---- connection --------------------------------------------------------------------------------------------------

    async def _keep_open(self, timer: DeadlineTimer) -> None:
        name = HostName(self.link.host if isinstance(self.link, TcpLink) else "")
        while True:
            self._lost.clear()
            connection = OpenLink(self.link, timer, self._clock, self._on_loss, name)
            try:
                failure = await connection.open()
                detail = failure or "the connection was lost: trying to reconnect"
                self._down = Reading(fault=Fault.DISCONNECTED, detail=detail)
                if not failure and isinstance(self.link, SerialLink):  # Somebody else's answers may be under way.
                    await asyncio.sleep(max(contact.quiet_s for contact in self._contacts.values()))
                # One that is lost again by now was none: taken for one, it would leave nobody to want another.
                if failure or self._lost.is_set():
                    self._is_good = False
                    self._tried.set()
                else:
                    self._opened(connection)
                    await self._lost.wait()
            finally:
                self._connection = None
                connection.close()
            if not self._is_good:
                await asyncio.sleep(RETRY_S)
            elif not connection.has_answered:  # closed while it was idle: there is no use for one before the next poll
                await self._wanted.wait()

    def _on_loss(self) -> None:
        self._connection = None
        if self._is_good:
            self._wanted.clear()
            self._tried.clear()
        self._lost.set()

    def _opened(self, connection: OpenLink) -> None:
        self._connection_number += 1
        self._unanswered = 0
        for contact in self._contacts.values():
            contact.reopened(self._clock())
        for station in self._stations:
            station.reopened()
        self._connection = connection
        self._tried.set()

    # ---- polling -----------------------------------------------------------------------------------------------------

    async def _keep_polling(self, timer: DeadlineTimer) -> None:
        await self._tried.wait()
        start_s = self._clock()
        for station in self._stations:
            station.pace = Pace(station.pace.period_s, start_s)
        while True:
            station = min(self._stations, key=lambda candidate: candidate.pace.due_s)
            await timer.wait_until(station.pace.due_s)
            self._on_poll(await self._poll(station))

    async def _poll(self, station: Station) -> PollResult:
        due_s = station.pace.due_s
        turned_s = self._clock()
        reading = await self._read(station)
        return station.result(reading, due_s, turned_s, self._clock(), self._connection_number)

    async def _read(self, station: Station) -> Reading:
        reading = await self._read_once(station)
        if reading.fault is Fault.DISCONNECTED and self._is_good:
            # It was good and is lost now: the slave had closed it when the request came. Another is being made.
            reading = await self._read_once(station)
            self._is_good = reading.fault is not Fault.DISCONNECTED
        return reading

    async def _read_once(self, station: Station) -> Reading:
        if not self._tried.is_set():
            self._wanted.set()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(station.timeout_s):
                    await self._tried.wait()
        connection = self._connection
        if connection is None:
            return self._down
        values: dict[Quantity, float] = {}
        sent_s = nan
        for number, codec in enumerate(station.codecs):
            answer = await self._read_block(connection, station, number)
            if number == station.main or isnan(sent_s):
                sent_s = answer.sent_s
            if answer.fault is Fault.EXCEPTION and not station.contact.is_plain:
                # Of our own making: it says nothing of the registers that are wanted.
                return Reading(sent_s, fault=station.last_fault, detail=station.last_detail)
            if answer.fault is not Fault.NONE:
                return station.failed(sent_s, answer.fault, answer.detail)
            decoded = codec.decode(answer.registers)
            if decoded.fault is not Fault.NONE:
                return Reading(sent_s, fault=decoded.fault, detail=decoded.detail)
            values.update(decoded.values)
        return Reading(sent_s, values)

    async def _read_block(self, connection: OpenLink, station: Station, number: int) -> Answer:
        """All registers of a block, in one read or in as many as it takes to know the answers from late ones. Its time
        is that of the read with what dates the sample.
        """
        codec = station.codecs[number]
        for sender in connection.unasked():
            if (contact := self._contacts.get(sender.device_id)) is not None and sender.count:
                contact.heard(self._clock(), sender.count)
        lengths = station.contact.plan(self._clock(), codec.registers, station.cuts[number], 65536 - codec.block.start)
        if not lengths:
            return Answer(nan, [], station.last_fault, station.last_detail, False)
        registers: list[int] = []
        sent_s = nan
        for count in lengths:
            answer = await self._transfer(connection, station, codec.block, len(registers), count)
            if isnan(sent_s) or len(registers) <= station.dating:
                sent_s = answer.sent_s
            if answer.fault is not Fault.NONE:
                return msgspec.structs.replace(answer, sent_s=sent_s)
            registers += answer.registers
        return Answer(sent_s, registers[: codec.registers])

    async def _transfer(self, connection: OpenLink, station: Station, block: Block, first: int, count: int) -> Answer:
        """One read, and what it says of the slave and of the line."""
        answer = await connection.read(station.spec.device_id, block, count, station.timeout_s, first=first)
        now_s = self._clock()
        if answer.fault is not Fault.DISCONNECTED:
            self._is_good = answer.answered and isinstance(self.link, TcpLink)
        if answer.answered:
            self._unanswered = 0
            if answer.fault is Fault.EXCEPTION:
                station.contact.refused(now_s, count, answer.exception)
            else:
                station.contact.answered(now_s)
            return answer
        station.contact.missed(now_s, count)
        self._unanswered = 0 if connection.has_heard else self._unanswered + 1
        hanging = isinstance(self.link, TcpLink) and self._unanswered >= HANGING_AFTER_POLLS
        if hanging or not connection.whole:
            # Meanwhile the device has the fault that it had: a device that is merely mute does not flicker.
            self._down = Reading(fault=answer.fault, detail=f"{answer.detail}; connecting anew")
        is_lost = hanging or not connection.whole or answer.fault is Fault.DISCONNECTED
        if is_lost and connection is self._connection:
            self._on_loss()
        return answer
