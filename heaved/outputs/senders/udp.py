"""Telegrams as UDP datagrams, each in one: to a machine, a broadcast address or a multicast group.

Nobody need be there. That nobody is, shows only where the machine says so (ICMP), a while after; it is told, and
sending goes on.
"""

from __future__ import annotations

import asyncio
import errno
import socket
import time
from math import inf
from typing import TYPE_CHECKING, Final

from heaved.host_name import HostName
from heaved.outputs.senders.sender import DOWN, FIRST_PAUSE_S, LOOK_UP_S, SLOW, explain, longer

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.links import UdpLink
    from heaved.outputs.output import OutputHealth

_UNHEARD: Final = (errno.ECONNREFUSED, errno.EHOSTUNREACH)
"""What is told of an earlier datagram; the socket is as good as before."""
_FULL: Final = (errno.EAGAIN, errno.ENOBUFS)
_SEND_BUFFER_BYTES: Final = 4096
"""Of the system, which doubles it: some ten datagrams. Its own would hold those of minutes for a slow radio link."""
_BELIEVED_S: Final = 10.0
"""After so long without a complaint it is well again: the system complains at most once a second, of a machine that is
not there every three."""
_LOOKED_UP_AGAIN_S: Final = 60.0
"""A name may come to mean another machine."""
_MOST_HEARD: Final = 64
"""Datagrams and complaints that are taken at a time."""


class UdpSender:
    """See :class:`heaved.outputs.senders.sender.Sender`."""

    def __init__(self, link: UdpLink, health: OutputHealth, clock: Callable[[], float] = time.monotonic) -> None:
        self._link, self._health, self._clock = link, health, clock
        self._name = HostName(link.host)
        self._socket: socket.socket | None = None
        self._address = ""
        self._complaint_s = -inf
        self._broken = asyncio.Event()

    @property
    def has_reader(self) -> bool:
        """Whether there is a way to send."""
        return self._socket is not None

    def send(self, data: bytes) -> None:
        """Send one datagram."""
        error = self._try(data)
        if error is not None and error.errno in _UNHEARD:
            self._complain(error)  # Of an earlier one: it has kept this one back.
            error = self._try(data)
        if error is None:
            self._health.sent += 1
            if not self._health.is_up and self._clock() - self._complaint_s > _BELIEVED_S:
                self._health.up()
        elif error.errno in _FULL:
            self._health.lost[SLOW] += 1
        else:
            self._health.lost[DOWN] += 1
            self._complain(error)

    def _try(self, data: bytes) -> OSError | None:
        if self._socket is None:
            return OSError(errno.ENOTCONN, "not open")
        try:
            self._socket.send(data)
        except OSError as error:
            return error
        return None

    async def run(self) -> None:
        """Keep a socket open that knows where to send, also when its name changes its address."""
        pause_s = FIRST_PAUSE_S
        try:
            while True:
                wait_s = pause_s
                try:
                    addresses = await self._name.addresses(LOOK_UP_S)
                    if self._socket is None or self._address not in addresses:
                        self._open(addresses[0])
                    wait_s = _LOOKED_UP_AGAIN_S
                except OSError as error:
                    if self._socket is None:  # Else the address is still good.
                        self._health.down(explain(self._link, error))
                    pause_s = longer(pause_s)
                self._broken.clear()
                try:
                    async with asyncio.timeout(wait_s):
                        await self._broken.wait()
                except TimeoutError:
                    if self._socket is not None:
                        pause_s = FIRST_PAUSE_S
                    continue
                await asyncio.sleep(pause_s)
                pause_s = longer(pause_s)
        finally:
            self._close()

    def _open(self, address: str) -> None:
        self._close()
        # Of an address as text this asks nobody; it knows what "%eth0" is.
        (family, kind, _, _, where), *_ = socket.getaddrinfo(
            address, self._link.port, type=socket.SOCK_DGRAM, flags=socket.AI_NUMERICHOST
        )
        opened = socket.socket(family, kind)
        try:
            opened.setblocking(False)
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            opened.connect(where)  # So that complaints come here, and nobody else's datagrams.
        except OSError:
            opened.close()
            raise
        self._socket, self._address = opened, address
        asyncio.get_running_loop().add_reader(opened, self._hear)

    def _close(self) -> None:
        if self._socket is not None:
            asyncio.get_running_loop().remove_reader(self._socket)
            self._socket.close()
            self._socket = None

    def _hear(self) -> None:
        """Throw away what comes, and take the complaints."""
        for _ in range(_MOST_HEARD):
            try:
                if self._socket is None:
                    return
                self._socket.recv(1)
            except (BlockingIOError, InterruptedError):
                return
            except OSError as error:
                self._complain(error)

    def _complain(self, error: OSError) -> None:
        if self._socket is None:
            return  # That is told already.
        self._complaint_s = self._clock()
        self._health.down(explain(self._link, error))
        if error.errno not in _UNHEARD:
            self._close()
            self._broken.set()
