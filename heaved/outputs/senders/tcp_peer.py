"""One peer on TCP that reads telegrams: what waits for it, what is too late for it, and when it is given up."""

from __future__ import annotations

import asyncio
import socket
import sys
import termios
from collections import deque
from fcntl import ioctl
from math import inf
from typing import TYPE_CHECKING, Final, cast

from heaved.keep_alive import keep_alive
from heaved.outputs.senders.sender import DOWN, SLOW, STUCK_S, explain

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.links import AnyLink
    from heaved.outputs.output import OutputHealth

_MOST_WAITING: Final = 8
"""Telegrams that wait for a peer which does not keep up: what is older is of no use to it."""
_SEND_BUFFER_BYTES: Final = 16 * 1024
"""Of the system, which doubles it: for what is under way, 100 telegrams a second over a satellite."""
_UNSENT_BYTES: Final = 512
"""Of the system, for what cannot be on its way yet, since who reads does not keep up: it would come seconds too late,
and many formats tell no time."""
_MOST_BEHIND_S: Final = 1.0
"""With a telegram that has been under way for so long, none is sent after it: when a cable is in again, or a radio link
has emptied its buffers, all would come at once. More than the way over a satellite and back."""
_UNACKNOWLEDGED_MS: Final = 5000
"""A peer that is not there any more (cable, power) does not acknowledge what is sent."""
_MOST_HEARD_BYTES: Final = 1 << 20
"""In a second. Whatever a peer says is thrown away; one that says more costs the others time."""


class TcpPeer(asyncio.Protocol):
    """Made by the event loop; the transport's own buffer is limited to nothing, so that it asks for a pause as soon as
    the system has not taken a whole telegram, and what is old can still be dropped.

    Attributes:
        closed: done once the connection is no more; why, and what to do.
    """

    def __init__(
        self,
        link: AnyLink,
        health: OutputHealth,
        clock: Callable[[], float],
        admit: Callable[[TcpPeer], str] = lambda _: "",
    ) -> None:
        """``admit``: asked once it is there; why it is not served, if it is not."""
        self.closed: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._link, self._health, self._clock = link, health, clock
        self._transport: asyncio.Transport | None = None
        self._queue: deque[bytes] = deque()
        self._given_bytes = 0
        self._under_way: deque[tuple[int, float]] = deque()
        """Telegrams that are not acknowledged: where each ends in what was given to the system, and when that was."""
        self._is_paused = False
        self._full_since_s = inf
        self._admit = admit
        self._why = ""
        self._heard_bytes = 0
        self._heard_since_s = -inf

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """It is there."""
        self._transport = cast("asyncio.Transport", transport)
        connection = transport.get_extra_info("socket")
        _set_options(connection)
        self._transport.set_write_buffer_limits(high=0)
        if _is_to_itself(connection):
            # The system has given our end the very port that is tried, on which nobody listens.
            self.close(explain(self._link, ConnectionRefusedError()))
        elif why := self._admit(self):
            self.close(why)

    @property
    def is_given_up(self) -> bool:
        """Whether we, not it, have ended the connection."""
        return bool(self._why)

    def connection_lost(self, error: Exception | None) -> None:
        """It is gone."""
        self._transport = None
        if self._queue:
            self._health.lost[DOWN] += len(self._queue)
            self._queue.clear()
        if not self.closed.done():
            self.closed.set_result(self._why or explain(self._link, error or ConnectionResetError("closed")))

    def eof_received(self) -> bool:
        """It will say no more, which is no reason to say no more to it; that it has gone shows on sending."""
        return True

    def close(self, why: str = "") -> None:
        """End the connection at once."""
        self._why = self._why or why
        if self._transport is not None:
            self._transport.abort()
            self._transport = None

    def send(self, data: bytes) -> None:
        """Send a telegram, or have it wait in place of the oldest one."""
        if self._transport is None:
            self._health.lost[DOWN] += 1
            return
        self._queue.append(data)
        self._go_on(self._transport)
        if len(self._queue) <= _MOST_WAITING:
            return
        self._queue.popleft()
        self._health.lost[SLOW] += 1
        now_s = self._clock()
        self._full_since_s = min(self._full_since_s, now_s)
        if now_s - self._full_since_s > STUCK_S:
            self.close(f"{self._link} has taken nothing for {STUCK_S:g} s: look at the program that reads there")

    def _go_on(self, transport: asyncio.Transport) -> None:
        while self._queue and not self._is_paused and not self._is_behind(transport):
            telegram = self._queue.popleft()
            transport.write(telegram)
            self._given_bytes += len(telegram)
            self._under_way.append((self._given_bytes, self._clock()))
            self._full_since_s = inf
            self._health.sent += 1

    def _is_behind(self, transport: asyncio.Transport) -> bool:
        """Whether the oldest telegram that the peer's system has not acknowledged is too old to send more after it."""
        if not self._under_way:
            return False
        waiting = ioctl(transport.get_extra_info("socket").fileno(), termios.TIOCOUTQ, bytes(4))
        taken_bytes = self._given_bytes - transport.get_write_buffer_size() - int.from_bytes(waiting, sys.byteorder)
        while self._under_way and self._under_way[0][0] <= taken_bytes:
            self._under_way.popleft()
        return bool(self._under_way) and self._clock() - self._under_way[0][1] > _MOST_BEHIND_S

    def pause_writing(self) -> None:
        """It does not keep up."""
        self._is_paused = True

    def resume_writing(self) -> None:
        """It does again."""
        self._is_paused = False
        if self._transport is not None:
            self._go_on(self._transport)

    def data_received(self, data: bytes) -> None:
        """Throw away what it says."""
        now_s = self._clock()
        if now_s - self._heard_since_s >= 1.0:
            self._heard_since_s, self._heard_bytes = now_s, 0
        self._heard_bytes += len(data)
        if self._heard_bytes > _MOST_HEARD_BYTES:
            self.close(f"{self._link} sends more than a megabyte a second: it is the wrong program, or the wrong port")


def _is_to_itself(connection: socket.socket) -> bool:
    try:
        return bool(connection.getsockname() == connection.getpeername())
    except OSError:  # It has gone again already, which the transport is about to find out.
        return False


def _set_options(connection: socket.socket) -> None:
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, _UNSENT_BYTES)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNACKNOWLEDGED_MS)
    # Found within half a minute while nothing is sent.
    keep_alive(connection, idle_s=10, probe_s=5)
