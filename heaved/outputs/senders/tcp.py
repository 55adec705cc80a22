"""Telegrams over a TCP connection that we make, for ever anew."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Final

from heaved.host_name import HostName
from heaved.outputs.senders.sender import FIRST_PAUSE_S, LOOK_UP_S, explain, longer
from heaved.outputs.senders.tcp_peer import TcpPeer

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.links import TcpLink
    from heaved.outputs.output import OutputHealth

CONNECT_S: Final = 2.0
"""What one attempt may take, for each address."""
_SETTLED_S: Final = 1.0
"""A connection counts as up once it has lasted so long: some devices take one and end it at once, when another reader
has come first."""


class TcpSender:
    """See :class:`heaved.outputs.senders.sender.Sender`."""

    def __init__(self, link: TcpLink, health: OutputHealth, clock: Callable[[], float] = time.monotonic) -> None:
        self._link, self._health, self._clock = link, health, clock
        self._name = HostName(link.host)
        self._peer: TcpPeer | None = None

    @property
    def has_reader(self) -> bool:
        """Whether it is connected."""
        return self._peer is not None

    def send(self, data: bytes) -> None:
        """Send a telegram, or have it wait in place of the oldest one."""
        if self._peer is not None:
            self._peer.send(data)

    async def run(self) -> None:
        """Connect; when the connection is lost, connect anew."""
        pause_s = FIRST_PAUSE_S
        try:
            while True:
                if await self._connect():
                    pause_s = FIRST_PAUSE_S
                await asyncio.sleep(pause_s)
                pause_s = longer(pause_s)
        finally:
            if self._peer is not None:
                self._peer.close()

    async def _connect(self) -> bool:
        """Whether it was connected for a while."""
        try:
            peer = self._peer = await self._open()
        except OSError as error:  # TimeoutError is one.
            self._health.down(explain(self._link, error))
            return False
        await asyncio.wait([peer.closed], timeout=_SETTLED_S)
        is_settled = not peer.closed.done()
        if is_settled:
            self._health.up()
            await asyncio.wait([peer.closed])
        self._peer = None
        self._health.down(peer.closed.result())
        return is_settled

    async def _open(self) -> TcpPeer:
        """A connection to the first of its addresses that answers.

        Raises:
            OSError: none does; why the last one does not.
        """
        loop = asyncio.get_running_loop()
        failure: OSError = TimeoutError()
        for address in await self._name.addresses(LOOK_UP_S):
            try:
                async with asyncio.timeout(CONNECT_S):
                    _, peer = await loop.create_connection(
                        lambda: TcpPeer(self._link, self._health, self._clock), address, self._link.port
                    )
            except OSError as error:
                failure = error
            else:
                return peer
        raise failure
