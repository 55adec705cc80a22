"""``[registers]`` as a Modbus server that can only be read: on TCP and on a serial line.

Every answer is made of one moment, the one at which it is given; see :mod:`heaved.outputs.register_map` for what it
holds. Two reads tell of two moments: what belongs together is read at once, in up to 125 registers.

A PLC may ask as seldom as it likes: a connection is kept while there is room. Where there is none, the one that has
said nothing for longest gives way, as the guide to Modbus on TCP has it.
"""

from __future__ import annotations

import asyncio
import errno
import socket
import time
from math import inf
from typing import TYPE_CHECKING, Final, cast

import structlog

from heaved.keep_alive import keep_alive
from heaved.links import SerialLink, TcpLink, explain_open_failure, parse_link, silence_s
from heaved.networks import checked_networks, is_allowed
from heaved.outputs.listen import Listener, ListenError
from heaved.outputs.modbus_frames import (
    NO_SUCH_DEVICE,
    REFUSALS,
    WRITES,
    NotModbusError,
    RtuRequests,
    TcpFrames,
    asked,
    read_answer,
    refusal,
    rtu_frame,
    tcp_frame,
)
from heaved.outputs.output import OutputHealth
from heaved.outputs.register_map import Mode, RegisterMap, RegistersParams
from heaved.outputs.register_push import RegisterPush
from heaved.outputs.shares import TOO_MANY, Shares
from heaved.serial_port import SerialPort
from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from heaved.outputs.output import Output
    from heaved.samples import MotionFrame

RETRY_S: Final = 1.0
"""Between attempts to have the port: an adapter that was plugged in again, an address that has become free."""
MAX_CONNECTIONS: Final = 32
_QUIET_S: Final = 10.0
"""Where there is no room, a connection gives way that has asked nothing for so long. No PLC that runs is so slow while
32 others ask, and it may come again."""
_ANY_UNIT: Final = (0, 255)
"""Unit ids by which masters on TCP mean the device itself, whatever its id (messaging guide, 4.4.2)."""
_READ_BYTES: Final = 512
"""Taken from a connection at a time: whoever floods it has the loop for some forty answers and no longer."""
_BURST: Final = 8
_BURST_S: Final = 0.01
"""A connection gets so many answers in that time; what it asks beyond waits. No PLC has a cycle that is so short."""
_STUCK_S: Final = 10.0
"""A client that does not take its answers for so long is disconnected."""
_SEND_BUFFER_BYTES: Final = 4096

_log = structlog.get_logger(__name__)


def register_output(
    params: RegistersParams,
    points: Sequence[str],
    utc_s: Callable[[float], float],
    clock: Callable[[], float] = time.monotonic,
) -> Output:
    """What ``[registers]`` asks for. ``points``: names of all monitoring points, in their order. ``utc_s``: UTC,
    seconds since 1970, of a time on ``clock``, the monotonic clock of the frames.

    Raises:
        ValueError: the link cannot be read, or reaches beyond this machine and no network is allowed.
    """
    link, registers = parse_link(params.link), RegisterMap(params, points, utc_s)
    if params.mode is Mode.PUSH:
        return RegisterPush(params, link, registers, clock)
    if isinstance(link, TcpLink):
        return TcpRegisters(params, link, registers, clock)
    return RtuRegisters(params, link, registers, clock)


class _Answers:
    """Requests to answers, the same on every line; says and counts what is not answered as it was meant."""

    def __init__(
        self, params: RegistersParams, registers: RegisterMap, clock: Callable[[], float], health: OutputHealth
    ) -> None:
        self._start, self._registers, self._clock, self._health = params.start, registers, clock, health

    def to(self, request: bytes, peer: str) -> bytes:
        """Of this moment; without id and checksum. ``peer``: who asks, for people."""
        code, wanted = asked(request, self._start, self._registers.words)
        if code:
            return self.refuse(request, code, peer)
        self._health.sent += 1
        return read_answer(request, self._registers.at(self._clock()), wanted)

    def refuse(self, request: bytes, code: int, peer: str) -> bytes:
        """The exception."""
        reason = "write" if request[0] in WRITES else REFUSALS[code]
        self._health.lost[reason] += 1
        _log.warning(
            "registers: request refused", reason=reason, peer=peer, request=request[:16].hex(" "), alike=reason
        )
        return refusal(request, code)


# ---- TCP -------------------------------------------------------------------------------------------------------------


class TcpRegisters:
    """The server on TCP.

    Attributes:
        health: how it fares; ``lost`` counts what was refused, by reason.
        address: that was bound; None while it does not listen.
    """

    def __init__(
        self,
        params: RegistersParams,
        link: TcpLink,
        registers: RegisterMap,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """``link``: the address to listen on; ``clock``: of the frames.

        Raises:
            ValueError: it reaches beyond this machine and ``allow`` names no network, or an entry is none.
        """
        self.health = OutputHealth("registers", "Modbus TCP server", str(link))
        self.address: tuple[str, int] | None = None
        self.device_id = params.device_id
        self.clock = clock
        self.answers = _Answers(params, registers, clock, self.health)
        self._link, self._registers = link, registers
        self._networks = checked_networks("registers", link.host, params.allow)
        self._served: dict[_Connection, None] = {}
        self._shares = Shares(MAX_CONNECTIONS)

    def publish(self, frame: MotionFrame) -> None:
        """The newest frame, for whoever asks."""
        self._registers.push(frame)

    async def run(self) -> None:
        """Listen, for ever: again when the address could not be had."""
        while True:
            listener = Listener(
                "registers", self._link.host, self._link.port, lambda peer: _Connection(self, peer),
                self.complain,
            )  # fmt: skip
            try:
                self.address = await listener.start()
                self.health.up()
                await asyncio.get_running_loop().create_future()  # Connections serve themselves.
            except ListenError as error:
                self.health.down(_explain_listen(self._link, error))
            finally:
                self.address = None
                listener.close()
                for connection in tuple(self._served):
                    connection.abort()
            await asyncio.sleep(RETRY_S)

    # What follows is for the connections.

    def admit(self, connection: _Connection) -> bool:
        """Whether it is served."""
        if not is_allowed(connection.peer, self._networks):
            self.complain("not_allowed", connection.peer, "is not in a network of [registers] allow")
            return False
        if not self._shares.take(connection.peer):
            self.complain(TOO_MANY, connection.peer, self._shares.refusal(connection.peer))
            return False
        if len(self._served) >= MAX_CONNECTIONS:
            quietest = min(self._served, key=lambda one: one.heard_s)
            if self.clock() - quietest.heard_s < _QUIET_S:
                self._shares.give_back(connection.peer)
                self.complain("too_many_clients", connection.peer, f"{MAX_CONNECTIONS} connections are open")
                return False
            quietest.abort()
        self._served[connection] = None
        return True

    def forget(self, connection: _Connection) -> None:
        """It is served no more."""
        if connection in self._served:
            del self._served[connection]
            self._shares.give_back(connection.peer)

    def complain(self, reason: str, peer: str, detail: str) -> None:
        """Somebody is not served."""
        self.health.lost[reason] += 1
        _log.warning("registers: client error", reason=reason, peer=peer, error=detail, alike=reason)


class _Connection(asyncio.BufferedProtocol):
    """One client. It is read no faster than it takes its answers, and no faster than a PLC may ask."""

    def __init__(self, server: TcpRegisters, peer: str) -> None:
        self.peer = peer
        self.heard_s = server.clock()
        """When it asked something last: whole requests count."""
        self._server = server
        self._frames = TcpFrames()
        self._buffer = bytearray(_READ_BYTES)
        self._loop = asyncio.get_running_loop()
        self._answered, self._since_s = 0, -inf
        self._transport: asyncio.Transport
        self._is_full = False
        self._go_on: asyncio.TimerHandle | None = None
        self._stuck: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        if not self._server.admit(self):
            self.abort()
            return
        connection: socket.socket = transport.get_extra_info("socket")
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        # A PLC that has lost its power is noticed within a minute, so that those that remain have the room.
        keep_alive(connection, idle_s=30, probe_s=10)
        self._transport.set_write_buffer_limits(high=0)

    def connection_lost(self, _error: Exception | None) -> None:
        for timer in (self._go_on, self._stuck):
            if timer is not None:
                timer.cancel()
        self._go_on = self._stuck = None
        self._server.forget(self)

    def abort(self) -> None:
        """Close at once."""
        self._server.forget(self)
        self._transport.abort()

    def get_buffer(self, _sizehint: int) -> bytearray:
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        self._frames.feed(bytes(self._buffer[:nbytes]))
        self._serve()

    def pause_writing(self) -> None:
        self._is_full = True
        self._transport.pause_reading()
        self._stuck = self._loop.call_later(_STUCK_S, self._give_up)

    def resume_writing(self) -> None:
        self._is_full = False
        if self._stuck is not None:
            self._stuck.cancel()
            self._stuck = None
        # From the loop, not from within the transport's own writing.
        self._continue_in(0.0)

    def _give_up(self) -> None:
        self._server.complain("stuck", self.peer, f"has not taken its answers for {_STUCK_S:g} s: disconnected")
        self.abort()

    def _continue_in(self, delay_s: float) -> None:
        self._transport.pause_reading()
        if self._go_on is None:
            self._go_on = self._loop.call_later(delay_s, self._continue)

    def _continue(self) -> None:
        self._go_on = None
        if not self._is_full and not self._transport.is_closing():
            self._transport.resume_reading()
            self._serve()

    def _serve(self) -> None:
        """Answer what has been asked, as far as it may be now."""
        server = self._server
        while not self._is_full and self._go_on is None and not self._transport.is_closing():
            now_s = self._loop.time()
            if now_s - self._since_s >= _BURST_S:
                self._answered, self._since_s = 0, now_s
            if self._answered >= _BURST:
                self._continue_in(_BURST_S)
                return
            try:
                request = self._frames.next()
            except NotModbusError as error:
                server.complain("no_modbus", self.peer, f"{printable(str(error))}: disconnected")
                self.abort()
                return
            if request is None:
                return
            self.heard_s = server.clock()
            self._answered += 1
            if request.unit == server.device_id or request.unit in _ANY_UNIT:
                pdu = server.answers.to(request.pdu, self.peer)
            else:
                # At once, and named: who waits for a timeout does not learn which of the two is wrong.
                pdu = server.answers.refuse(request.pdu, NO_SUCH_DEVICE, self.peer)
            self._transport.write(tcp_frame(request.transaction, request.unit, pdu))


def _explain_listen(link: TcpLink, error: ListenError) -> str:
    cause = error.__cause__
    number = cause.errno if isinstance(cause, OSError) else None
    if number == errno.EADDRINUSE:
        return f"port {link.port} is in use: stop the other program, or give [registers] link another port"
    if number in (errno.EACCES, errno.EPERM):
        return (
            f"not permitted to listen on port {link.port}: give [registers] link a port above 1023, or the service the "
            "right to it (CAP_NET_BIND_SERVICE)"
        )
    reason = (cause.strerror if isinstance(cause, OSError) else None) or str(error)
    return f"cannot listen on {link.host}: {reason}: give [registers] link an address of this machine"


# ---- RTU -------------------------------------------------------------------------------------------------------------


class RtuRegisters:
    """The server on a serial line, alone or beside other slaves.

    Attributes:
        health: how it fares; ``lost`` counts what was refused, by reason.
    """

    def __init__(
        self,
        params: RegistersParams,
        link: SerialLink,
        registers: RegisterMap,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.health = OutputHealth("registers", "Modbus RTU server", str(link))
        self._answers = _Answers(params, registers, clock, self.health)
        self._link, self._registers, self._device_id = link, registers, params.device_id
        self._requests = RtuRequests(params.device_id)
        self._port: SerialPort | None = None
        self._answering: asyncio.TimerHandle | None = None
        self._lost: asyncio.Future[str] | None = None

    def publish(self, frame: MotionFrame) -> None:
        """The newest frame, for whoever asks."""
        self._registers.push(frame)

    async def run(self) -> None:
        """Serve the line, for ever: again when the port has gone."""
        while True:
            self._lost = asyncio.get_running_loop().create_future()
            self._requests = RtuRequests(self._device_id)
            self._port = port = SerialPort(self._link, self._hear, self._lost.set_result)
            try:
                port.open()
                self.health.up()
                reason = await self._lost
                self.health.down(f"{self._link.path} was lost ({reason}): waiting for it to return")
            except OSError as error:
                self.health.down(explain_open_failure(self._link, error))
            finally:
                self._call_off()
                port.close()
                self._port = None
            await asyncio.sleep(RETRY_S)

    def _hear(self, data: bytes) -> None:
        self._call_off()  # Something follows: what looked like a request to us was not the last that was said.
        loop = asyncio.get_running_loop()
        request = self._requests.feed(data, loop.time())
        if request:
            self._answering = loop.call_later(silence_s(self._link), self._answer, request)

    def _answer(self, request: bytes) -> None:
        self._answering = None
        if self._port is None:
            return
        frame = rtu_frame(self._device_id, self._answers.to(request, self._link.path))
        self._requests.said(frame)
        if not self._port.write(frame):
            self.health.lost["not_taken"] += 1

    def _call_off(self) -> None:
        if self._answering is not None:
            self._answering.cancel()
            self._answering = None
