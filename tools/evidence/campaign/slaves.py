"""Slaves of sockets and pseudo-terminals that answer from the truth and deviate as they are told; links that break."""

from __future__ import annotations

import asyncio
import os
import socket
import struct
import tty
from collections import Counter
from contextlib import suppress
from typing import TYPE_CHECKING, Final, cast

from evidence.campaign import deviations
from evidence.campaign.deviations import Asked, Sent

if TYPE_CHECKING:
    import random
    from collections.abc import Callable
    from pathlib import Path

_RTU_REQUEST: Final = 8
_MBAP: Final = struct.Struct(">HHH")
_READ: Final = struct.Struct(">BBHH")


class Slave:
    """One device: which deviations it has now, and how often each has been injected.

    Attributes:
        kinds: names of :data:`deviations.BYTES` and :data:`deviations.VALUES`, from which one or more are drawn.
        share: of the answers that deviate.
        most: deviations of one answer.
        events: deviations injected, by name.
        requests: whole read requests that came.
        bad_answers: answers that deviated, each in one way or several.
    """

    def __init__(
        self,
        name: str,
        registers: Callable[[float], list[int]],
        first: int,
        device_id: int,
        timeout_s: float,
        chance: random.Random,
        count_event: Callable[[str], None],
    ) -> None:
        """``registers``: by monotonic time, from register ``first`` on."""
        self.name, self._registers, self._first, self._device_id = name, registers, first, device_id
        self._timeout_s, self._chance, self._count_event = timeout_s, chance, count_event
        self.kinds: tuple[str, ...] = ()
        self.share, self.most = 0.0, 1
        self.events: Counter[str] = Counter()
        self.requests = self.bad_answers = 0
        self.is_mute = False
        self._values = deviations.Values()

    def behave(self, *kinds: str, share: float = 1.0, most: int = 1) -> None:
        """Deviate like this from now on; without ``kinds``: not at all."""
        self.kinds, self.share, self.most = kinds, share, most
        self._values.thawed()

    def __str__(self) -> str:
        return f"{self.name}: {', '.join(self.kinds)}; {self.share:g} of the answers"

    def answer(self, asked: Asked, now_s: float) -> Sent:
        """What goes out on a read request."""
        self.requests += 1
        if self.is_mute or asked.device_id != self._device_id:
            return []
        held = self._registers(now_s)
        offset = asked.start - self._first
        if asked.function != 3 or offset < 0 or not 0 < asked.number <= 125:
            return [(0.0, asked.frame(bytes((asked.function | 0x80, 1 if asked.function != 3 else 2))))]
        # Beside its readings a register holds nothing: some more are asked for after an answer was lost.
        registers = (held + [0] * 125)[offset : offset + asked.number]
        chosen = self._chosen()
        self.bad_answers += bool(chosen)
        for kind in chosen:
            if kind in deviations.VALUES:
                registers = self._values.turned(kind, registers, self._chance)
        sent: Sent = [(0.0, asked.frame(asked.read(registers)))]
        for kind in chosen:
            if kind in deviations.BYTES:
                sent = deviations.BYTES[kind](asked, registers, sent, self._chance, self._timeout_s)
            self.events[kind] += 1
            self._count_event(kind)
        return sent

    def _chosen(self) -> list[str]:
        if not self.kinds or self._chance.random() >= self.share:
            return []
        number = self._chance.randint(1, min(self.most, len(self.kinds)))
        return deviations.together(self._chance.sample(self.kinds, number))


class TcpSlave:
    """A slave behind a port that stays the same over all breaks."""

    def __init__(self, slave: Slave) -> None:
        self.slave = slave
        self.port = 0
        self.closes_after_each = self.swallows = False
        self._server: asyncio.Server | None = None
        self.connections: set[_Connection] = set()

    @property
    def link(self) -> str:
        """As the daemon's configuration names it."""
        return f"tcp://127.0.0.1:{self.port}"

    async def open(self) -> None:
        """Listen, from the second time on at the same port."""
        if self._server is None:
            loop = asyncio.get_running_loop()
            self._server = await loop.create_server(lambda: _Connection(self), "127.0.0.1", self.port)
            self.port = self._server.sockets[0].getsockname()[1]

    def refuse(self) -> None:
        """Listen no longer; the connections stay."""
        if self._server is not None:
            self._server.close()
            self._server = None

    def reset(self) -> int:
        """Break all connections off with RST; how many there were."""
        broken = list(self.connections)
        for connection in broken:
            connection.reset()
        return len(broken)

    def close(self) -> None:
        """Be gone."""
        self.refuse()
        self.reset()


class _Connection(asyncio.Protocol):
    def __init__(self, owner: TcpSlave) -> None:
        self._owner = owner
        self._heard = b""
        self._transport: asyncio.Transport
        self._loop = asyncio.get_running_loop()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self._owner.connections.add(self)

    def connection_lost(self, _error: Exception | None) -> None:
        self._owner.connections.discard(self)

    def reset(self) -> None:
        sock = self._transport.get_extra_info("socket")
        with suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._transport.abort()

    def data_received(self, data: bytes) -> None:
        if self._owner.swallows:
            return
        self._heard += data
        while len(self._heard) >= 12:
            transaction, _, length = _MBAP.unpack_from(self._heard)
            raw, self._heard = self._heard[: 6 + length], self._heard[6 + length :]
            asked = Asked(raw, True, transaction, *_READ.unpack_from(raw, 6))
            for after_s, out in self._owner.slave.answer(asked, self._loop.time()):
                if after_s:
                    self._loop.call_later(after_s, self._say, out)
                else:
                    self._say(out)
            if self._owner.closes_after_each:
                self._transport.close()
                return

    def _say(self, data: bytes) -> None:
        if not self._transport.is_closing() and data:
            self._transport.write(data)


class SerialSlave:
    """A slave on a pseudo-terminal, behind a name that goes when it is unplugged."""

    def __init__(self, slave: Slave, path: Path) -> None:
        self.slave, self.path = slave, path
        self._ends: tuple[int, int] | None = None
        self._heard = b""

    @property
    def link(self) -> str:
        """As the daemon's configuration names it."""
        return f"rtu://{self.path}?baudrate=230400"

    async def open(self) -> None:
        """Plug it in."""
        if self._ends is not None:
            return
        line, device = os.openpty()
        tty.setraw(device)
        os.set_blocking(line, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(device))
        self._ends, self._heard = (line, device), b""
        asyncio.get_running_loop().add_reader(line, self._readable, line)

    def close(self) -> None:
        """Unplug it: whoever has it open is hung up on."""
        if self._ends is None:
            return
        asyncio.get_running_loop().remove_reader(self._ends[0])
        for end in self._ends:
            os.close(end)
        self._ends = None
        self.path.unlink(missing_ok=True)

    def babble(self, data: bytes) -> None:
        """Bytes that nobody has asked for."""
        if self._ends is not None:
            self._say(self._ends[0], data)

    def _readable(self, line: int) -> None:
        with suppress(OSError):
            self._heard += os.read(line, 4096)
        loop = asyncio.get_running_loop()
        while len(self._heard) >= _RTU_REQUEST:
            raw = self._heard[:_RTU_REQUEST]
            if deviations.crc(raw[:-2]) != raw[-2:]:
                self._heard = self._heard[1:]
                continue
            self._heard = self._heard[_RTU_REQUEST:]
            asked = Asked(raw, False, 0, *_READ.unpack_from(raw))
            for after_s, out in self.slave.answer(asked, loop.time()):
                if after_s:
                    loop.call_later(after_s, self._say, line, out)
                else:
                    self._say(line, out)

    def _say(self, line: int, data: bytes) -> None:
        # A line does not wait for its master: what nobody reads is lost. After unplugging the number may be another's.
        if self._ends is not None and self._ends[0] == line:
            with suppress(OSError):
                os.write(line, data)
