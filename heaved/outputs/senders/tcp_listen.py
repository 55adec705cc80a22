"""Telegrams over TCP connections that those who read them make."""

from __future__ import annotations

import asyncio
import errno
import time
from functools import partial
from typing import TYPE_CHECKING, Final

import structlog

from heaved.networks import is_allowed, parse_networks
from heaved.outputs.listen import Listener, ListenError
from heaved.outputs.senders.sender import FIRST_PAUSE_S, longer
from heaved.outputs.senders.tcp_peer import TcpPeer
from heaved.outputs.shares import Shares

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.links import TcpListenLink
    from heaved.outputs.output import OutputHealth

MOST_READERS: Final = 16
_NOBODY: Final = "listening, nobody is connected"

_log = structlog.get_logger(__name__)


class TcpListenSender:
    """See :class:`heaved.outputs.senders.sender.Sender`. It is up while it listens, whether somebody reads or not."""

    def __init__(
        self,
        link: TcpListenLink,
        health: OutputHealth,
        allow: tuple[str, ...] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """``allow``: networks that may connect, besides loopback.

        Raises:
            ValueError: one of them is none.
        """
        self._link, self._health, self._clock = link, health, clock
        self._networks = parse_networks(allow)
        self._readers: dict[TcpPeer, None] = {}  # A set that keeps the order of arrival.
        self._shares = Shares(MOST_READERS)
        self._is_listening = False

    @property
    def has_reader(self) -> bool:
        """Whether anybody is connected."""
        return bool(self._readers)

    def send(self, data: bytes) -> None:
        """Send a telegram to each reader, or have it wait in place of the oldest one."""
        for reader in tuple(self._readers):
            reader.send(data)

    async def run(self) -> None:
        """Listen; as long as that fails, try again."""
        pause_s = FIRST_PAUSE_S
        listener = Listener(
            f"output {self._health.name}", self._link.host, self._link.port, self._make_reader,
            lambda _reason, address, why: self._say("reader of an output refused", address, why),
        )  # fmt: skip
        try:
            while True:
                try:
                    await listener.start()
                except ListenError as error:
                    self._health.down(_explain(self._link, error.__cause__))
                    await asyncio.sleep(pause_s)
                    pause_s = longer(pause_s)
                    continue
                self._is_listening = True
                self._health.up()
                self._tell_readers()
                await asyncio.get_running_loop().create_future()  # Until it is cancelled.
        finally:
            self._is_listening = False
            listener.close()
            for reader in tuple(self._readers):
                reader.close()
            self._readers.clear()

    def _make_reader(self, address: str) -> TcpPeer:
        return TcpPeer(self._link, self._health, self._clock, partial(self._admit, address))

    def _admit(self, address: str, reader: TcpPeer) -> str:
        """Serve ``reader``, or say why not."""
        if not self._is_listening:
            return "ending"
        if not is_allowed(address, self._networks):
            why = f"{address} is not in a network of allow"
        elif len(self._readers) >= MOST_READERS:
            why = f"{MOST_READERS} are connected, no more are served"
        elif not self._shares.take(address):
            why = self._shares.refusal(address)
        else:
            self._readers[reader] = None
            self._health.connections += 1
            self._tell_readers()
            reader.closed.add_done_callback(partial(self._forget, address, reader))
            return ""
        self._say("reader of an output refused", address, why)
        return why

    def _forget(self, address: str, reader: TcpPeer, closed: asyncio.Future[str]) -> None:
        self._readers.pop(reader, None)
        self._shares.give_back(address)
        self._tell_readers()
        if reader.is_given_up and self._is_listening:
            self._say("reader of an output disconnected", address, closed.result())

    def _say(self, event: str, address: str, why: str) -> None:
        name = self._health.name
        _log.warning(event, output=name, peer=address, reason=why, alike=f"{name} {event}")

    def _tell_readers(self) -> None:
        if self._health.is_up:
            self._health.detail = "" if self._readers else _NOBODY


def _explain(link: TcpListenLink, cause: BaseException | None) -> str:
    number = cause.errno if isinstance(cause, OSError) else None
    if number == errno.EADDRINUSE:
        advice = "the port is in use: stop the other program, or choose another port"
    elif number in (errno.EACCES, errno.EPERM):
        advice = "not permitted: choose a port above 1023"
    elif number == errno.EADDRNOTAVAIL:
        advice = f"this machine has no address {link.host} at the moment: correct it, or write 0.0.0.0 with allow"
    else:
        advice = f"{cause}: correct the link"
    return f"cannot listen at {link}: {advice}"
