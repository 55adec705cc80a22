"""Where the servers listen, and for whom: loopback always, other machines only from networks that the configuration
names, or with a certificate. Connections are let in one by one, and only while there is room for them.
"""

from __future__ import annotations

import asyncio
import errno
import resource
import socket
import sys
from typing import TYPE_CHECKING, Final

import structlog

from heaved.networks import is_allowed
from heaved.outputs.shares import TOO_FAST, TOO_MANY, Arrivals, Shares
from heaved.outputs.tls_connection import TlsConnection

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.networks import Network
    from heaved.outputs.tls import Certificates

_BACKLOG: Final = 100
"""Connections that may wait to be let in; as many are let in at once."""
_PAUSE_S: Final = 1.0
"""Without a descriptor for the next connection it waits so long: it would make the loop spin."""
_RESERVED: Final = 16
"""Descriptors that no connection gets: for sensors that come back, worker processes, the state file. (A quarter of a
small number.)"""
MOST_HANDSHAKES: Final = 64
"""Clients that may be about to show who they are at once, of one address a part of them: until then each holds a
descriptor, and nothing else."""
TLS: Final = "tls"
"""Reason under which handshakes are counted that come to nothing."""
_EXHAUSTED: Final = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)

_log = structlog.get_logger(__name__)


def alike(reason: str, message: str) -> str:
    """By what two refusals are one line of the log and a count: of a handshake, whose and why."""
    return message if reason == TLS else reason


class ListenError(OSError):
    """A server cannot listen where it was told to; the message says where and what to do."""


# ---- sockets ---------------------------------------------------------------------------------------------------------


class Listener:
    """Accepts connections on one address. (asyncio's own server, at a loss for a descriptor, logs a traceback for each
    connection that waits, and again a second later, twice as often.)
    """

    def __init__(
        self,
        section: str,
        host: str,
        port: int,
        protocol: Callable[[str], asyncio.BaseProtocol],
        refuse: Callable[[str, str, str], object],
        *,
        certificates: Certificates | None = None,
        networks: tuple[Network, ...] = (),
        outsider: str = "",
    ) -> None:
        """``section`` of the configuration, for messages; ``protocol``: makes what serves a peer, told its address;
        ``refuse``: told of one that is not let in, a reason for statistics, its address, and why in words.
        With ``certificates`` TLS is spoken, and only with who is in one of ``networks`` or on this machine; of others
        it is said that their address ``outsider``. Without, it is up to what serves them.
        """
        self._section = section
        self._host = host
        self._port = port
        self._protocol = protocol
        self._arrivals = Arrivals()
        self._refuse = refuse
        self._certificates, self._networks, self._outsider = certificates, networks, outsider
        self._handshakes = Shares(MOST_HANDSHAKES)
        self._under_way = 0
        self._shaking: set[TlsConnection] = set()
        self._sockets: list[socket.socket] = []
        self._pauses: dict[socket.socket, asyncio.TimerHandle] = {}
        self._joining: set[asyncio.Task[None]] = set()

    async def start(self) -> tuple[str, int]:
        """Listen; returns the address that was bound (port 0 lets the system choose one).

        Raises:
            ListenError: the address cannot be bound; says what to do.
        """
        loop = asyncio.get_running_loop()
        try:
            found = await loop.getaddrinfo(self._host, self._port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
            for family, _, _, _, address in dict.fromkeys(found):
                self._sockets.append(_listening(family, address))
        except (OSError, UnicodeError) as error:  # The latter for what no host can be called.
            self.close()
            reason = error if isinstance(error, OSError) else OSError(errno.EINVAL, f"no such host: {error}")
            raise _listen_error(self._section, self._host, self._port, reason) from error
        for listening in self._sockets:
            loop.add_reader(listening, self._accept, listening)
        host, port, *_ = self._sockets[0].getsockname()
        return host, port

    def close(self) -> None:
        """No more connections; those that there are go on."""
        for pause in self._pauses.values():
            pause.cancel()
        for joining in self._joining:
            joining.cancel()
        for shaking in tuple(self._shaking):
            shaking.abort()
        self._pauses.clear()
        for listening in self._sockets:
            asyncio.get_running_loop().remove_reader(listening)
            listening.close()
        self._sockets.clear()

    def _accept(self, listening: socket.socket) -> None:
        for _ in range(_BACKLOG):
            try:
                connection, address = listening.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                self._pause(listening, error)
                return
            if connection.fileno() >= _highest_descriptor():
                connection.close()
                self._complain("no descriptor to spare")
                continue
            peer = str(address[0])
            if not self._arrivals.admits(peer, asyncio.get_running_loop().time()):
                connection.close()
                self._refuse(TOO_FAST, peer, self._arrivals.refusal(peer))
                continue
            if self._certificates is not None and not self._may_shake_hands(peer):
                connection.close()
                continue
            self._let_in(connection, peer)

    def _may_shake_hands(self, address: str) -> bool:
        """Whether a handshake is begun with ``address``; then it has a place, to be given back."""
        if not is_allowed(address, self._networks):
            self._refuse("not_allowed", address, f"{address} {self._outsider}")
            return False
        if self._under_way >= MOST_HANDSHAKES:
            self._refuse("too_many_clients", address, f"{MOST_HANDSHAKES} connections are about to agree on TLS")
            return False
        if not self._handshakes.take(address):
            self._refuse(TOO_MANY, address, f"{self._handshakes.refusal(address)} until they agree on TLS")
            return False
        self._under_way += 1
        return True

    def _let_in(self, connection: socket.socket, address: str) -> None:
        connection.setblocking(False)
        loop = asyncio.get_running_loop()
        joining = loop.create_task(self._join(connection, address))
        self._joining.add(joining)
        joining.add_done_callback(self._joining.discard)

    async def _join(self, connection: socket.socket, address: str) -> None:
        handshake = None if self._certificates is None else self._handshake(self._certificates, address)
        try:
            await asyncio.get_running_loop().connect_accepted_socket(
                lambda: handshake or self._protocol(address), connection
            )
        except OSError:  # It has gone again.
            connection.close()
            if handshake is not None:
                handshake.connection_lost(None)
        else:
            if handshake is not None and handshake.is_under_way:
                self._shaking.add(handshake)

    def _handshake(self, certificates: Certificates, address: str) -> TlsConnection:
        def over(fault: str) -> None:
            self._shaking.discard(made)
            self._under_way -= 1
            self._handshakes.give_back(address)
            if fault:
                self._refuse(TLS, address, f"{address}: {fault}")

        made = TlsConnection(certificates.context, lambda: self._protocol(address), over)
        return made

    def _pause(self, listening: socket.socket, error: OSError) -> None:
        loop = asyncio.get_running_loop()
        loop.remove_reader(listening)
        self._pauses[listening] = loop.call_later(_PAUSE_S, self._go_on, listening)
        self._complain(str(error.strerror or error), is_expected=error.errno in _EXHAUSTED)

    def _go_on(self, listening: socket.socket) -> None:
        del self._pauses[listening]
        asyncio.get_running_loop().add_reader(listening, self._accept, listening)

    def _complain(self, reason: str, *, is_expected: bool = True) -> None:
        hint = "raise the limit on open files (ulimit -n, LimitNOFILE), or let fewer clients connect"
        _log.warning(
            "a connection cannot be let in", server=self._section, reason=reason, hint=hint if is_expected else ""
        )


def _listening(family: int, address: tuple[object, ...]) -> socket.socket:
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            listening.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        listening.bind(address)
        listening.listen(_BACKLOG)
        listening.setblocking(False)
    except OSError:
        listening.close()
        raise
    return listening


def _highest_descriptor() -> int:
    """A connection's descriptor is below this. The system gives the lowest that is free, so it tells how many are."""
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return sys.maxsize if most == resource.RLIM_INFINITY else most - min(_RESERVED, most // 4)


def _listen_error(section: str, host: str, port: int, error: OSError) -> ListenError:
    """What a failed bind means for the person at the machine."""
    if error.errno == errno.EADDRINUSE:
        advice = f"the port is in use: stop the other program or change [{section}] port"
    elif error.errno in (errno.EACCES, errno.EPERM):
        advice = f"not permitted: choose a [{section}] port above 1023"
    else:
        advice = f"{error.strerror or error}: change [{section}] host"
    return ListenError(f"[{section}] cannot listen on {host}:{port}: {advice}")
