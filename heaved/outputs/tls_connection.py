"""TLS on one connection that was made to us.

Between the plain connection and what serves it, so that the latter meets what it meets without TLS: it is told at once
when the peer takes nothing more, knows how much waits for it, and may end its own side and still be heard. asyncio's
own transport for TLS has buffers between the two, in which that is lost, and closes both sides at once.
"""

from __future__ import annotations

import asyncio
import ssl
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, cast

if TYPE_CHECKING:
    from collections.abc import Callable

HANDSHAKE_S: Final = 5.0
"""A handshake takes three ways through the network and some milliseconds."""
_CHUNK_BYTES: Final = 65536

_FAULTS: Final = {
    "PEER_DID_NOT_RETURN_A_CERTIFICATE": "it shows no certificate: give it one, which [tls] client_ca_file has signed",
    "HTTP_REQUEST": "it speaks HTTP without TLS: let it ask for https://",
    "WRONG_VERSION_NUMBER": "it speaks without TLS, which is wanted here",
    "UNSUPPORTED_PROTOCOL": "its TLS is older than 1.2",
    "VERSION_TOO_LOW": "its TLS is older than 1.2",
    "NO_SHARED_CIPHER": "it has no cipher that is safe today",
}
"""What OpenSSL calls what clients do wrong."""
_OURS: Final = (
    "it does not accept our certificate ({said}): give it the authority that has signed [tls] certificate_file, and "
    "let it connect to a name or an address that this is for"
)
_THEIRS: Final = (
    "its certificate is not accepted ({said}): it must be signed by [tls] client_ca_file, for a client, and the clock "
    "of this machine be right"
)


class TlsConnection(asyncio.Protocol, asyncio.Transport):
    """To the plain connection, what serves it; to what serves the peer, its connection."""

    def __init__(
        self, context: ssl.SSLContext, make: Callable[[], asyncio.BaseProtocol], over: Callable[[str], object]
    ) -> None:
        """``make`` what serves the peer, once it has shown who it is. ``over`` is told once when the handshake is: with
        nothing, or what went wrong.
        """
        super().__init__()
        self._make, self._over = make, over
        self._context = context
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._incoming, self._outgoing, server_side=True)
        self._plain: asyncio.Transport
        self._server: asyncio.Protocol | None = None
        """What serves the peer."""
        self._is_over = False
        """The handshake."""
        self._has_heard_end = self._has_said_end = False
        self._late: asyncio.TimerHandle | None = None

    @property
    def is_under_way(self) -> bool:
        """Whether the handshake is."""
        return not self._is_over

    # ---- to the plain connection -------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The client begins."""
        self._plain = cast("asyncio.Transport", transport)
        self._late = asyncio.get_running_loop().call_later(
            HANDSHAKE_S, self._give_up, f"it has not agreed on TLS in {HANDSHAKE_S:g} s: does it speak TLS?"
        )

    def data_received(self, data: bytes) -> None:
        """A part of the handshake, or of what is said."""
        if self._has_said_end or (self._server is None and self._is_over):
            return  # Whoever has ended his side only waits for the peer to go.
        self._incoming.write(data)
        if self._server is None and not self._agree():
            return
        self._hear()

    def eof_received(self) -> bool:
        """The peer has ended its side, with TLS's own word for it or without."""
        if self._server is None:
            self._give_up("it has gone before TLS was agreed on")
            return False
        return self._end_heard()

    def connection_lost(self, error: Exception | None) -> None:
        """It is gone."""
        self._finish_handshake("it has gone before TLS was agreed on")
        if self._server is not None:
            self._server.connection_lost(error)

    def pause_writing(self) -> None:
        """The peer does not keep up."""
        if self._server is not None:
            self._server.pause_writing()

    def resume_writing(self) -> None:
        """It does again."""
        if self._server is not None:
            self._server.resume_writing()

    def _agree(self) -> bool:
        """Go on with the handshake; whether it is done."""
        try:
            self._tls.do_handshake()
        except ssl.SSLWantReadError:
            self._send()
            return False
        except OSError as error:
            self._send()  # It is told why, too, as far as TLS has a word for it.
            self._give_up(_explain(error))
            return False
        self._send()
        self._finish_handshake("")
        self._server = cast("asyncio.Protocol", self._make())
        self._server.connection_made(self)
        return True

    def _hear(self) -> None:
        assert self._server is not None
        while not (self._plain.is_closing() or self._has_said_end or self._has_heard_end):
            try:
                data = self._read()
            except ssl.SSLWantReadError:
                break
            except OSError:  # What is no TLS, or was changed on its way.
                self._plain.abort()
                return
            if data:
                self._server.data_received(data)
            elif not self._end_heard():
                return
        self._send()

    def _read(self) -> bytes:
        """What is said next; empty: the end.

        Raises:
            OSError: nothing is, yet or for ever.
        """
        try:
            return self._tls.read(_CHUNK_BYTES)
        except ssl.SSLZeroReturnError:
            return b""
        except ssl.SSLWantReadError:
            raise
        except ssl.SSLError:
            # OpenSSL has one list of errors for a thread, and the ssl module may leave in it what another connection
            # has met as it was closed (an alert): the list is empty by now, and a fault of this connection stays.
            return self._tls.read(_CHUNK_BYTES)

    def _end_heard(self) -> bool:
        """The peer says no more; whether what serves it wants to go on."""
        assert self._server is not None
        if not self._has_heard_end:
            self._has_heard_end = True
            if not self._server.eof_received():
                self.close()
        return not self._plain.is_closing()

    def _give_up(self, fault: str) -> None:
        if not self._is_over:
            self._finish_handshake(fault)
            self._plain.close()

    def _finish_handshake(self, fault: str) -> None:
        if not self._is_over:
            self._is_over = True
            if self._late is not None:
                self._late.cancel()
            self._over(fault)

    def _send(self) -> None:
        if self._outgoing.pending:
            self._plain.write(self._outgoing.read())

    # ---- to what serves the peer: see asyncio.Transport --------------------------------------------------------------

    def write(self, data: bytes | bytearray | memoryview[Any]) -> None:
        """Encrypt and send; nothing after the end."""
        if self._has_said_end or self._plain.is_closing():
            return
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._tls.write(rest) :]
        except ssl.SSLError:
            self._plain.abort()
            return
        self._send()

    def can_write_eof(self) -> bool:
        """As without TLS."""
        return True

    def write_eof(self) -> None:
        """Say that nothing more will come; what the peer says from now on is thrown away."""
        self._say_end()
        self._plain.write_eof()

    def close(self) -> None:
        """Close when all is sent."""
        if not self._plain.is_closing():
            self._say_end()
        self._plain.close()

    def abort(self) -> None:
        """Close at once."""
        self._plain.abort()

    def _say_end(self) -> None:
        if not self._has_said_end:
            self._has_said_end = True
            self._incoming.read()  # Of an alert in it the ssl module would leave a trace: see _read.
            with suppress(ssl.SSLError):  # It would wait for that of the peer.
                self._tls.unwrap()
            self._send()

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """What the plain connection knows, and ``sslcontext``, by which the HTTP library tells https."""
        return self._context if name == "sslcontext" else self._plain.get_extra_info(name, default)

    def is_closing(self) -> bool:
        """Whether it is."""
        return self._plain.is_closing()

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        """Have another serve the peer."""
        self._server = cast("asyncio.Protocol", protocol)

    def get_protocol(self) -> asyncio.BaseProtocol:
        """What serves the peer."""
        assert self._server is not None
        return self._server

    def is_reading(self) -> bool:
        """Whether it is read from."""
        return self._plain.is_reading()

    def pause_reading(self) -> None:
        """Leave what comes to the system."""
        self._plain.pause_reading()

    def resume_reading(self) -> None:
        """Take it again."""
        self._plain.resume_reading()

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """Of the plain connection: nothing waits here."""
        self._plain.set_write_buffer_limits(high, low)

    def get_write_buffer_limits(self) -> tuple[int, int]:
        """Those."""
        return self._plain.get_write_buffer_limits()

    def get_write_buffer_size(self) -> int:
        """Bytes that the system has not taken."""
        return self._plain.get_write_buffer_size()


def _explain(error: OSError) -> str:
    """What went wrong in a handshake, for the person who looks after both ends."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return _THEIRS.format(said=error.verify_message)
    reason = (error.reason if isinstance(error, ssl.SSLError) else "") or ""
    if reason in _FAULTS:
        return _FAULTS[reason]
    said = reason.lower().replace("_", " ") or str(error)
    if "ALERT" in reason and ("CERTIFICATE" in reason or "_CA" in reason):
        return _OURS.format(said=said)
    return f"TLS: {said}"
