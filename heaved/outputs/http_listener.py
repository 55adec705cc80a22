"""HTTP for those who may ask: who that is, is decided before a byte of what is asked is looked at; so many connections
at once, and not one that asks nothing for long. What the answers are is up to whoever listens.
"""

from __future__ import annotations

import asyncio
import logging
from http import HTTPStatus
from typing import TYPE_CHECKING, Any, Final, cast

import msgspec
from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

from heaved.networks import is_allowed
from heaved.outputs.listen import Listener

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from heaved.networks import Network

_SHUTDOWN_S: Final = 0.2
"""Open requests are given this long at the end; ten times what any answer takes."""
_IDLE_S: Final = 15.0
"""A connection that asks nothing is closed after this."""
_REFUSAL_S: Final = 1.0
"""How long a peer that may not connect may take to ask and to read why."""


class HttpListener:
    """Everything runs on the event loop."""

    def __init__(
        self,
        section: str,
        host: str,
        port: int,
        *,
        networks: tuple[Network, ...],
        refusal: str,
        most: int,
        answer: Callable[[web.BaseRequest], Awaitable[web.StreamResponse]],
        complain: Callable[[str, str], None],
    ) -> None:
        """``section`` of the configuration, for messages. ``networks`` may ask, and this machine; others are told that
        their address ``refusal``. ``most`` connections at once: without a limit whoever opens many leaves no file
        descriptor for others. ``complain`` is told what peers do wrong, by a reason and in short.
        """
        self._networks, self._refusal = networks, refusal
        self._most, self._answer, self._complain = most, answer, complain
        self._listener = Listener(section, host, port, self._admit)
        self._server: _BoundedServer | None = None
        self._refused: set[_Refusal] = set()

    async def start(self) -> tuple[str, int]:
        """Listen; returns the address that was bound (port 0 lets the system choose one).

        Raises:
            ListenError: the address cannot be bound; says what to do.
        """
        self._server = _BoundedServer(
            self._answer,
            most=self._most,
            complain=self._complain,
            access_log=None,
            logger=_log_of_faults(self._complain),
            keepalive_timeout=_IDLE_S,
        )
        return await self._listener.start()

    async def close(self) -> None:
        """Stop listening, and end every connection."""
        self._listener.close()
        for peer in tuple(self._refused):
            peer.abort()
        if self._server is not None:
            self._server.pre_shutdown()
            await self._server.shutdown(_SHUTDOWN_S)
            self._server = None

    def _admit(self, address: str) -> asyncio.Protocol:
        """What serves a peer that has just connected."""
        assert self._server is not None
        if is_allowed(address, self._networks):
            return self._server()
        message = f"{address} {self._refusal}"
        self._complain("not_allowed", message)
        return _Refusal(self._refused, self._most, _forbidden(message))


class _BoundedServer(web.Server):
    """Serves so many connections at once; more are closed as they come."""

    def __init__(self, *arguments: Any, most: int, complain: Callable[[str, str], None], **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._most = most
        self._complain = complain

    def connection_made(self, handler: web.RequestHandler, transport: asyncio.Transport) -> None:
        """Serve it, or close it."""
        super().connection_made(handler, transport)
        if len(self.connections) > self._most:
            self._complain("too_many_clients", f"{self._most} connections are open")
            asyncio.get_running_loop().call_soon(transport.abort)  # The handler's task wants to have begun by then.


class _Refusal(asyncio.Protocol):
    """Serves a peer that may not connect: what it says is thrown away, and the first of it answered."""

    def __init__(self, refused: set[_Refusal], most: int, answer: bytes) -> None:
        """``refused``: all that are served so; of more than ``most`` none is waited for."""
        self._refused, self._most = refused, most
        self._answer = answer

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """It may stay for a moment."""
        self._transport = cast("asyncio.Transport", transport)
        self._refused.add(self)
        # Closing at once would reset the connection of a client that is still sending: it would not read the answer.
        patience_s = _REFUSAL_S if len(self._refused) <= self._most else 0.0
        self._end = asyncio.get_running_loop().call_later(patience_s, self.abort)

    def data_received(self, _data: bytes) -> None:
        """Answer the first of it."""
        if self._answer:
            self._transport.write(self._answer)
            self._transport.write_eof()
            self._answer = b""

    def connection_lost(self, _error: Exception | None) -> None:
        """It is gone."""
        self._refused.discard(self)
        self._end.cancel()

    def abort(self) -> None:
        """End it at once."""
        self._transport.abort()


def _log_of_faults(complain: Callable[[str, str], None]) -> logging.Logger:
    """Takes what the HTTP library has to say: what clients do wrong is told to ``complain``, what is wrong here is
    logged.
    """

    def is_ours(record: logging.LogRecord) -> bool:
        error = record.exc_info[1] if record.exc_info else None
        if isinstance(error, HttpProcessingError):
            complain("bad_request", f"not HTTP: {error.message.partition(chr(10))[0].rstrip(': ')}")
            return False
        return record.levelno >= logging.WARNING

    log = logging.Logger(__name__, logging.DEBUG)
    log.parent = logging.getLogger()
    log.addFilter(is_ours)
    return log


def _forbidden(message: str) -> bytes:
    """A whole response, for who is not listened to."""
    body = msgspec.json.encode({"error": message}) + b"\n"
    head = (
        f"HTTP/1.1 {HTTPStatus.FORBIDDEN.value} {HTTPStatus.FORBIDDEN.phrase}\r\n"
        f"Content-Type: application/json\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    )
    return head.encode() + body
