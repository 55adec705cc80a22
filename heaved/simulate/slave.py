"""Simulated Modbus slaves: what they answer, and the lines (TCP, RTU on a pseudo-terminal) on which they listen.

Values are those of the moment at which the slave has heard the request, encoded through the device's own profile.
Framing is pymodbus's, so that the daemon's own framing meets an independent one.
"""

from __future__ import annotations

import asyncio
import os
import pty
import struct
import tty
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from math import inf, isnan, nan
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast, get_args

import msgspec
from pymodbus.constants import ExcCodes
from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU

from heaved.devices.profile import DeviceSpec, Quantity, block_registers, encode, role_needs, role_quantities
from heaved.links import SerialLink, TcpLink, character_s, silence_s
from heaved.simulate.faults import FaultKind, PlannedFault

if TYPE_CHECKING:
    import numpy as np

    from heaved.samples import Sample

_QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
_FUNCTIONS = {3: "holding", 4: "input"}
_READ_REQUEST = 5
"""Function, start, count, bytes."""
_MOST_REGISTERS = 125
_LONGEST_FRAME = 260
_RTU_OVERHEAD = 3
"""Device id and CRC, bytes."""
_FRAGMENT_S = 0.05
"""A rest of a frame older than this is thrown away before the next bytes. The standard says 1.5 characters, which the
scheduling of a pty cannot promise."""
_TEMPERATURE_C = 20.0
_SIGNAL = 1000.0
"""What every simulated device says of its temperature and signal strength."""


class Source(Protocol):
    """Where the values come from: a simulated sea (``Instruments``) or a recording (``Player``)."""

    def read(self, device: DeviceSpec, t_s: float) -> Sample:
        """What ``device`` measures at ``t_s`` seconds from the start; nan is a value that it has not got."""
        ...


class Answer(msgspec.Struct, frozen=True):
    """What a slave says: ``pdu`` is empty when it stays silent."""

    pdu: bytes = b""
    late_s: float = 0.0
    garbled: bool = False


class Slave:
    """One device: read requests to answers. No IO."""

    def __init__(self, device: DeviceSpec, source: Source) -> None:
        self.device = device
        self._source = source
        self._blocks = [
            (range(block.start, block.start + block_registers(block)), block) for block in device.profile.blocks
        ]
        self._frozen: Sample | None = None

    def answer(self, request: bytes, t_s: float, faults: Sequence[PlannedFault]) -> Answer:
        """Answer a request PDU (not empty) that was heard at ``t_s`` while ``faults`` of this device are active."""
        amounts = {fault.kind: fault.amount for fault in faults}
        if FaultKind.DROPOUT in amounts:
            return Answer()
        late_s = amounts.get(FaultKind.LATE, 0.0) / 1000.0
        if FaultKind.EXCEPTION in amounts:
            return Answer(_refusal(request, int(amounts[FaultKind.EXCEPTION])), late_s)
        return Answer(self._read(request, t_s, amounts), late_s, FaultKind.GARBAGE in amounts)

    def _read(self, request: bytes, t_s: float, amounts: Mapping[FaultKind, float]) -> bytes:
        if request[0] not in _FUNCTIONS:
            return _refusal(request, ExcCodes.ILLEGAL_FUNCTION)
        if len(request) != _READ_REQUEST:
            return _refusal(request, ExcCodes.ILLEGAL_VALUE)
        start, count = struct.unpack(">HH", request[1:])
        if not 1 <= count <= _MOST_REGISTERS:
            return _refusal(request, ExcCodes.ILLEGAL_VALUE)
        end = start + count
        blocks = [
            (addresses, block)
            for addresses, block in self._blocks
            if block.function == _FUNCTIONS[request[0]] and addresses.start < end and start < addresses.stop
        ]
        if not all(any(address in addresses for addresses, _ in blocks) for address in range(start, end)):
            return _refusal(request, ExcCodes.ILLEGAL_ADDRESS)
        values = self._values(t_s, amounts)
        fields = [field for _, block in blocks for field in block.fields]
        if FaultKind.NAN in amounts:
            values |= {field.quantity: nan if field.type == "float32" else inf for field in fields}
        elif any(isnan(values[field.quantity]) for field in fields):
            return _refusal(request, ExcCodes.DEVICE_FAILURE)
        image: dict[int, int] = {}
        for addresses, block in blocks:
            image.update(zip(addresses, encode(block, values), strict=True))
        return struct.pack(f">BB{count}H", request[0], 2 * count, *(image[address] for address in range(start, end)))

    def _values(self, t_s: float, amounts: Mapping[FaultKind, float]) -> dict[Quantity, float]:
        """Every quantity a profile may name, nan where this device has none."""
        if FaultKind.FROZEN not in amounts:
            self._frozen = None
            sample = self._source.read(self.device, t_s)
        else:
            if self._frozen is None:
                self._frozen = self._source.read(self.device, t_s)
            sample = self._frozen
        measured = cast("dict[Quantity, float]", msgspec.structs.asdict(sample))
        values = dict.fromkeys(_QUANTITIES, nan) | {name: measured[name] for name in _QUANTITIES if name in measured}
        values |= {"temperature_c": _TEMPERATURE_C, "signal": _SIGNAL, "device_time_s": sample.t_s}
        values[(role_needs(self.device.role) or role_quantities(self.device.role))[0]] += amounts.get(
            FaultKind.SPIKE, 0.0
        )
        return values


class RtuPace:
    """When a slave on a serial line has heard a request and when its answer has been sent: a pty takes no time, a line
    does. Silences of 3.5 characters stand before the answer and before the next request.
    """

    def __init__(self, link: SerialLink) -> None:
        self._character_s, self._silence_s = character_s(link), silence_s(link)
        self._free_at_s = -inf

    def heard_at(self, arrival_s: float, request_bytes: int) -> float:
        """The moment at which a request handed over at ``arrival_s`` has been heard to its last bit."""
        return max(arrival_s, self._free_at_s) + request_bytes * self._character_s

    def answered_at(self, heard_s: float, answer_bytes: int) -> float:
        """The moment at which the last bit of the answer has been sent; the line is taken until a silence later."""
        done = heard_s + self._silence_s + answer_bytes * self._character_s
        self._free_at_s = done + self._silence_s
        return done


Ask = Callable[[int, bytes, float], Answer | None]
"""(device id, request PDU, seconds by the loop's clock at which it was heard) to the answer; None: no such device."""


class TcpLine:
    """Slaves behind one TCP port."""

    def __init__(self, link: TcpLink, ask: Ask, rng: np.random.Generator) -> None:
        """A port of 0 is chosen by the system at the first :meth:`open` and kept from then on (``port``)."""
        self.host, self.port = link.host, link.port
        self.is_open = False
        self._ask, self._rng = ask, rng
        self._server: asyncio.Server | None = None
        self._connections: set[_TcpConnection] = set()

    async def open(self) -> None:
        """Raises:
        OSError: the address cannot be listened on.
        """
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(
            lambda: _TcpConnection(self._connections, self._ask, self._rng), self.host, self.port
        )
        self.port = self._server.sockets[0].getsockname()[1]
        self.is_open = True

    async def close(self) -> None:
        """Refuse new connections and break those that there are."""
        self.is_open = False
        if self._server is None:
            return
        self._server.close()
        for connection in tuple(self._connections):
            connection.abort()
        await self._server.wait_closed()


class _TcpConnection(asyncio.Protocol):
    def __init__(self, siblings: set[_TcpConnection], ask: Ask, rng: np.random.Generator) -> None:
        self._siblings, self._ask, self._rng = siblings, ask, rng
        self._framer = FramerSocket(DecodePDU(True))
        self._heard = b""
        self._transport: asyncio.Transport | None = None
        self._loop = asyncio.get_running_loop()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self._siblings.add(self)

    def connection_lost(self, _error: Exception | None) -> None:
        self._siblings.discard(self)

    def abort(self) -> None:
        if self._transport is not None:
            self._transport.abort()

    def data_received(self, data: bytes) -> None:
        self._heard += data
        while True:
            used, device_id, transaction, request = self._framer.decode(self._heard)
            if not used:
                break
            self._heard = self._heard[used:]
            if not request:
                self.abort()
                return
            # A gateway answers for a device that it cannot reach.
            answer = self._ask(device_id, request, self._loop.time()) or Answer(
                _refusal(request, ExcCodes.GATEWAY_NO_RESPONSE)
            )
            if answer.pdu:
                frame = _garble(self._framer.encode(answer.pdu, device_id, transaction), answer, self._rng)
                self._loop.call_later(answer.late_s, self._send, frame)
        if len(self._heard) > _LONGEST_FRAME:  # no Modbus: it can only be broken off
            self.abort()

    def _send(self, frame: bytes) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(frame)


class RtuLine:
    """Slaves on one serial line, which is a pseudo-terminal reached through a symbolic link at the line's path."""

    def __init__(self, link: SerialLink, ask: Ask, rng: np.random.Generator) -> None:
        self.path = Path(link.path)
        self.is_open = False
        self._ask, self._rng = ask, rng
        self._pace = RtuPace(link)
        self._framer = FramerRTU(DecodePDU(True))
        self._heard = b""
        self._last_arrival_s = -inf
        self._pending: set[asyncio.TimerHandle] = set()
        self._ends: tuple[int, int] = (-1, -1)

    async def open(self) -> None:
        """Raises:
        FileExistsError: something other than a symbolic link stands at the path.
        OSError: no pseudo-terminal can be had, or the link cannot be made.
        """
        if self.path.exists() and not self.path.is_symlink():
            raise FileExistsError(
                f"{self.path} exists and is not a symbolic link: a simulated line would replace it; give another path"
            )
        line, device = pty.openpty()
        tty.setraw(device)
        os.set_blocking(line, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(device))
        # Our hold on the device's end keeps the line up while no master has opened it.
        self._ends = line, device
        asyncio.get_running_loop().add_reader(line, self._on_bytes)
        self.is_open = True

    async def close(self) -> None:
        """Unplug: the path goes, and whoever has it open is hung up on."""
        if not self.is_open:
            return
        self.is_open = False
        asyncio.get_running_loop().remove_reader(self._ends[0])
        for handle in self._pending:
            handle.cancel()
        self._pending.clear()
        self._heard = b""
        ours = os.ttyname(self._ends[1])
        for end in self._ends:
            os.close(end)
        if self.path.is_symlink() and str(self.path.readlink()) == ours:
            self.path.unlink()

    def _on_bytes(self) -> None:
        loop = asyncio.get_running_loop()
        arrival = loop.time()
        if arrival - self._last_arrival_s > _FRAGMENT_S:
            self._heard = b""
        self._last_arrival_s = arrival
        self._heard += os.read(self._ends[0], 4096)
        used, device_id, _, request = self._framer.decode(self._heard)
        self._heard = self._heard[used:]
        if not request:
            return
        heard = self._pace.heard_at(arrival, len(request) + _RTU_OVERHEAD)
        answer = self._ask(device_id, request, heard)
        if answer is None or not answer.pdu:  # nobody of that id on this line, or it stays silent
            return
        frame = _garble(self._framer.encode(answer.pdu, device_id, 0), answer, self._rng)
        done = self._pace.answered_at(heard + answer.late_s, len(frame))
        handle: asyncio.TimerHandle = loop.call_at(done, lambda: self._send(handle, frame))
        self._pending.add(handle)

    def _send(self, handle: asyncio.TimerHandle, frame: bytes) -> None:
        self._pending.discard(handle)
        # A line does not wait for its master: what nobody reads is lost.
        with suppress(BlockingIOError):
            os.write(self._ends[0], frame)


def _refusal(request: bytes, code: int) -> bytes:
    return bytes([request[0] | 0x80, code])


def _garble(frame: bytes, answer: Answer, rng: np.random.Generator) -> bytes:
    return rng.bytes(len(frame)) if answer.garbled else frame
