"""Polling Modbus sensors: one task per bus, a result for every deadline, whatever the line does.

The only place that uses pymodbus clients. What is worked around here, all of it true of pymodbus 3.16.1:

* its RTU client takes any frame with the right id for the answer, so a late answer is read as the next one; every
  byte received goes through :mod:`heaved.devices.answers` first, and :class:`~heaved.devices.watch.Contact` decides
  when a slave may be asked again;
* a frame that it cannot decode raises inside the event loop; such frames are kept from it;
* it reconnects by itself with delays that double up to minutes, and retries; both are off;
* ``asyncio.wait_for``, which it waits with, can swallow a cancellation (Python 3.11); the poll task looks again.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import termios
import time
from collections.abc import Callable, Sequence
from math import nan
from typing import Any

import msgspec
from pymodbus import ModbusException
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient

from heaved.devices.answers import (
    Request,
    explain_exception,
    explain_rtu_silence,
    explain_tcp_silence,
    find_rtu_answer,
    find_tcp_answer,
    tcp_stream_is_whole,
)
from heaved.devices.line import Link, RtuLink, TcpLink, bus_key, explain_open_failure, parse_link, silence_s
from heaved.devices.polling import PollResult, Reading, Station, resync_counts
from heaved.devices.profile import Block, DeviceSpec, Quantity
from heaved.devices.timer import DeadlineTimer, Pace
from heaved.devices.watch import Ask, Contact
from heaved.samples import Fault

__all__ = ["Answer", "Bus", "Connection", "PollResult"]

CONNECT_TIMEOUT_S = 0.5
RETRY_S = 0.25
"""Between attempts to open a line; with the timeout, a device is back within a second of its return."""
HANGING_AFTER_POLLS = 4
"""Unanswered requests in a row after which a TCP connection is made anew: over a cable that was pulled, the old one
would recover only when TCP resends, which it does ever more rarely."""


class Answer(msgspec.Struct, frozen=True):
    """What came of one read."""

    sent_s: float
    registers: list[int]
    fault: Fault = Fault.NONE
    detail: str = ""
    answered: bool = True
    """The slave answered this very request, if only with an exception."""


class Connection:
    """One open socket or serial port; one read at a time, never cancelled by its caller."""

    def __init__(self, link: Link, timer: DeadlineTimer, clock: Callable[[], float], lost: Callable[[], None]) -> None:
        self.link = link
        self._timer = timer
        self._clock = clock
        self._lost = lost
        self.whole = True
        """False once a TCP stream was left within a frame: what follows cannot be read, so connect anew."""
        self._request: Request | None = None
        self._transaction = 0
        self._heard = b""
        self._heard_s = 0.0
        self._client: AsyncModbusTcpClient | AsyncModbusSerialClient | None = None

    async def open(self) -> str:
        """Returns why it failed and what to do; empty when open. Opening a serial port keeps the loop for a moment."""
        _quieten_pymodbus()
        client = self._client = self._make_client()
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
        if isinstance(self.link, RtuLink):
            with contextlib.suppress(OSError, ValueError, NotImplementedError, AttributeError):
                # USB adapters otherwise hold bytes back for up to 16 ms. Only real ports know this.
                client.ctx.transport.sync_serial.set_low_latency_mode(True)  # type: ignore[attr-defined]
        self._heard_s = self._clock()
        return ""

    def _make_client(self) -> AsyncModbusTcpClient | AsyncModbusSerialClient:
        common: dict[str, Any] = {
            "timeout": CONNECT_TIMEOUT_S,
            "retries": 0,
            "reconnect_delay": 0,
            "trace_packet": self._trace_packet,
            "trace_connect": self._trace_connect,
        }
        client: AsyncModbusTcpClient | AsyncModbusSerialClient
        if isinstance(self.link, TcpLink):
            client = AsyncModbusTcpClient(self.link.host, port=self.link.port, **common)
        else:
            line = msgspec.structs.asdict(self.link)
            client = AsyncModbusSerialClient(line.pop("path"), **line, **common)
        client.set_max_no_responses(2**31)
        return client

    def close(self) -> None:
        if self._client is not None:
            self._client.close()

    async def read(self, device_id: int, block: Block, count: int, timeout_s: float) -> Answer:
        """Read the first ``count`` registers of a block."""
        client = self._client
        if client is None or not client.connected:
            return Answer(nan, [], Fault.DISCONNECTED, "the connection is lost", False)
        if isinstance(self.link, RtuLink) and (free_s := self._heard_s + silence_s(self.link)) > self._clock():
            await self._timer.wait_until(free_s)
        self._request = request = Request(device_id, 3 if block.function == "holding" else 4, count)
        self._heard = b""
        client.ctx.comm_params.timeout_connect = timeout_s
        sent_s = self._clock()
        try:
            if block.function == "holding":
                response = await client.read_holding_registers(block.start, count=count, device_id=device_id)
            else:
                response = await client.read_input_registers(block.start, count=count, device_id=device_id)
        except ModbusException:
            return self._unanswered(client.connected, sent_s, request, timeout_s)
        finally:
            self._request = None
        if response.isError():
            return Answer(sent_s, [], Fault.EXCEPTION, explain_exception(response.exception_code))
        registers = list(response.registers)
        if len(registers) != count:
            detail = f"{len(registers)} registers instead of {count}: the profile's block does not fit the device"
            return Answer(sent_s, [], Fault.LENGTH, detail)
        return Answer(sent_s, registers)

    def _unanswered(self, connected: bool, sent_s: float, request: Request, timeout_s: float) -> Answer:
        if not connected:
            return Answer(sent_s, [], Fault.DISCONNECTED, "the connection was lost: trying to reconnect", False)
        if isinstance(self.link, RtuLink):
            why = explain_rtu_silence(self._heard, request)
        else:
            why = explain_tcp_silence(self._heard, self._transaction, request)
            self.whole = tcp_stream_is_whole(self._heard)
        return Answer(sent_s, [], why.fault, f"{why.detail} (waited {timeout_s * 1e3:g} ms)", False)

    def _trace_packet(self, sending: bool, data: bytes) -> bytes:
        """pymodbus shows every packet here, and takes what is returned: all that came since the request was sent, of
        which only the answer is let through."""
        if sending:
            self._transaction = int.from_bytes(data[:2])
            return data
        self._heard = data
        self._heard_s = self._clock()
        if self._request is None:
            return b""
        if isinstance(self.link, RtuLink):
            return find_rtu_answer(data, self._request)
        return find_tcp_answer(data, self._transaction, self._request)

    def _trace_connect(self, connected: bool) -> None:
        if not connected:
            self._lost()


def _raise_if_cancelled() -> None:
    """After whatever waits within pymodbus: its ``wait_for`` may have swallowed the cancellation (Python 3.11)."""
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


def _quieten_pymodbus() -> None:
    """Its errors reach the daemon as results; as log lines they would come with every poll of an absent device. A level
    that somebody set on purpose stays."""
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
        self._stations = self._make_stations(devices, clock())
        self._connection: Connection | None = None
        self._connection_number = 0
        self._down = Reading(fault=Fault.DISCONNECTED, detail="not connected yet")
        """What every poll gives while there is no connection."""
        self._lost = asyncio.Event()
        self._tried = asyncio.Event()
        self._unanswered = 0

    def _make_stations(self, devices: Sequence[DeviceSpec], now_s: float) -> list[Station]:
        slaves: dict[int, list[DeviceSpec]] = {}
        for device in devices:
            slaves.setdefault(device.device_id, []).append(device)
        contacts = {
            device_id: Contact(
                numbered=isinstance(self.link, TcpLink),
                resync_counts=resync_counts(specs),
                alone=len(slaves) == 1,
                timeout_s=max(spec.timeout_ms for spec in specs) * 1e-3,
                opened_s=now_s,
            )
            for device_id, specs in slaves.items()
        }
        return [Station(device, self.link, contacts[device.device_id], now_s) for device in devices]

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
        while True:
            self._lost.clear()
            connection = Connection(self.link, timer, self._clock, self._lost.set)
            try:
                failure = await connection.open()
                detail = failure or "the connection was lost: trying to reconnect"
                self._down = Reading(fault=Fault.DISCONNECTED, detail=detail)
                if not failure:
                    self._opened(connection)
                    await self._lost.wait()
                self._tried.set()
            finally:
                self._connection = None
                connection.close()
            await asyncio.sleep(RETRY_S)

    def _opened(self, connection: Connection) -> None:
        self._connection_number += 1
        self._unanswered = 0
        for station in self._stations:
            station.contact.reopened(self._clock())
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
        connection = self._connection
        if connection is None:
            return self._down
        ask = station.contact.ask(self._clock())
        if ask is Ask.NOTHING:
            return Reading(fault=station.last_fault, detail=station.last_detail)
        if ask is Ask.RESYNC:
            answer = await self._transfer(connection, station, 0, station.contact.resync_count())
            if answer.fault is Fault.EXCEPTION:  # says nothing of the registers that are wanted
                return Reading(answer.sent_s, fault=station.last_fault, detail=station.last_detail)
            if answer.fault is not Fault.NONE:
                return station.failed(answer.sent_s, answer.fault, answer.detail)
        values: dict[Quantity, float] = {}
        sent_s = nan
        for number, codec in enumerate(station.codecs):
            answer = await self._transfer(connection, station, number, codec.registers)
            if number == station.main or sent_s != sent_s:
                sent_s = answer.sent_s
            if answer.fault is not Fault.NONE:
                return station.failed(sent_s, answer.fault, answer.detail)
            decoded = codec.decode(answer.registers)
            if decoded.fault is not Fault.NONE:
                return Reading(sent_s, fault=decoded.fault, detail=decoded.detail)
            values.update(decoded.values)
        return Reading(sent_s, values)

    async def _transfer(self, connection: Connection, station: Station, number: int, count: int) -> Answer:
        """One read, and what it says of the slave and of the line."""
        block = station.codecs[number].block
        answer = await connection.read(station.spec.device_id, block, count, station.timeout_s)
        _raise_if_cancelled()
        now_s = self._clock()
        if answer.answered:
            self._unanswered = 0
            if answer.fault is Fault.EXCEPTION:
                station.contact.refused(now_s, count)
            else:
                station.contact.answered(now_s)
            return answer
        station.contact.missed(now_s, count)
        self._unanswered += 1
        hanging = isinstance(self.link, TcpLink) and self._unanswered >= HANGING_AFTER_POLLS
        if hanging or not connection.whole:
            # Meanwhile the device has the fault that it had: a device that is merely mute does not flicker.
            self._down = Reading(fault=answer.fault, detail=f"{answer.detail}; connecting anew")
        if hanging or not connection.whole or answer.fault is Fault.DISCONNECTED:
            self._lost.set()
        return answer
