"""HTTP for those who may ask: who that is, is decided before a byte of what is asked is looked at; so many connections
at once, of one address a part of them, and not one that asks nothing for long, or byte by byte, or without end. What
the answers are is up to whoever listens.
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
from heaved.outputs.shares import TOO_MANY, Shares

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from heaved.networks import Network
    from heaved.outputs.tls import Certificates

_SHUTDOWN_S: Final = 0.2
"""Open requests are given this long at the end; ten times what any answer takes."""
_IDLE_S: Final = 15.0
"""A connection that asks nothing is closed after this."""
_REQUEST_S: Final = 10.0
"""A request that has begun has to be whole in that time, and an answer taken."""
_MOST_REQUEST_BYTES: Final = 64 * 1024
"""Of a request, head and all, where the limits of the HTTP library add up to more; a browser's has some 600."""
_LIMITS: Final = {"max_line_size": 2048, "max_field_size": 4096, "max_headers": 64}
"""Of the HTTP library, bytes and number."""
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
        certificates: Certificates | None = None,
    ) -> None:
        """``section`` of the configuration, for messages. ``networks`` may ask, and this machine; others are told that
        their address ``refusal``. ``most`` connections at once: without a limit whoever opens many leaves no file
        descriptor for others. ``complain`` is told what peers do wrong, by a reason and in short. With ``certificates``
        it is HTTPS.
        """
        self._networks, self._refusal = networks, refusal
        self._most, self._answer, self._complain = most, answer, complain
        self._listener = Listener(
            section, host, port, self._admit, lambda reason, _address, message: complain(reason, message),
            certificates=certificates, networks=networks, outsider=refusal,
        )  # fmt: skip
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
            **_LIMITS,
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
            return self._server.handler(address)
        message = f"{address} {self._refusal}"
        self._complain("not_allowed", message)
        return _Refusal(self._refused, self._most, _forbidden(message))


class _BoundedServer(web.Server):
    """Serves so many connections at once; more are closed as they come."""

    def __init__(
        self,
        answer: Callable[[web.BaseRequest], Awaitable[web.StreamResponse]],
        *,
        most: int,
        complain: Callable[[str, str], None],
        **options: Any,
    ) -> None:
        super().__init__(self._answered)
        self._options = options
        self._answer = answer
        self._most = most
        self._shares = Shares(most)
        self.complain = complain

    def handler(self, address: str) -> _Handler:
        """What serves a peer at ``address``."""
        return _Handler(self, address, **self._options)

    def admit(self, address: str) -> bool:
        """Whether a connection that has just been made is served; then it gives its place back."""
        if len(self.connections) > self._most:
            self.complain("too_many_clients", f"{self._most} connections are open")
            return False
        if not self._shares.take(address):
            self.complain(TOO_MANY, self._shares.refusal(address))
            return False
        return True

    def give_back(self, address: str) -> None:
        """A connection that was served is gone."""
        self._shares.give_back(address)

    async def _answered(self, request: web.BaseRequest) -> web.StreamResponse:
        handler = cast("_Handler", request.protocol)
        handler.asked()
        is_whole = False
        try:
            response = await self._answer(request)
            is_whole = request.content.is_eof()
            if not is_whole:  # Nothing that is asked has a body: what comes of it is not waited for.
                response.force_close()
            return response
        finally:
            handler.answered(is_last=not is_whole)


class _Handler(web.RequestHandler):
    """One connection, which must get on: with its request, and with taking the answer."""

    def __init__(self, server: _BoundedServer, address: str, **options: Any) -> None:
        loop = asyncio.get_running_loop()
        super().__init__(server, loop=loop, **options)
        self._server = server
        self._address = address
        self._clock = loop
        self._has_place = False
        self._heard_bytes = 0
        """Of a request that is not whole yet."""
        self._is_asking = True
        """What comes is of a request; else an answer is being made, or nothing more is served."""
        self._late: asyncio.TimerHandle | None = None
        """Until a request that has begun must be whole, or an answer be taken."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Serve it, or close it."""
        super().connection_made(transport)
        self._has_place = self._server.admit(self._address)
        if not self._has_place:
            self._clock.call_soon(self._abort)  # The handler's task wants to have begun by then.

    def connection_lost(self, error: BaseException | None) -> None:
        """It is gone."""
        super().connection_lost(error)
        self.asked()
        if self._has_place:
            self._has_place = False
            self._server.give_back(self._address)

    def data_received(self, data: bytes) -> None:
        """A part of a request, or of a body that nobody wants."""
        if self._is_asking and self._has_place:
            if not self._heard_bytes:
                self._wait()
            self._heard_bytes += len(data)
            if self._heard_bytes > _MOST_REQUEST_BYTES:
                most = f"a request of more than {_MOST_REQUEST_BYTES} bytes"
                self._server.complain("line_too_long", f"{self._address}: {most}: disconnected")
                self._abort()
                return
        super().data_received(data)

    def asked(self) -> None:
        """A whole request is there: whoever answers it takes care of the time."""
        self._is_asking = False
        if self._late is not None:
            self._late.cancel()
            self._late = None

    def answered(self, *, is_last: bool) -> None:
        """The answer is made: it has to be taken; unless it was the last one, another request may be made."""
        self._heard_bytes, self._is_asking = 0, not is_last
        if self._has_place:
            self._wait()

    def _wait(self) -> None:
        if self._late is not None:
            self._late.cancel()
        self._late = self._clock.call_later(_REQUEST_S, self._judge)

    def _judge(self) -> None:
        self._late = None
        is_taken = self.transport is None or not self.transport.get_write_buffer_size()
        if self._heard_bytes or not is_taken:
            what = "asked a whole request" if is_taken else "taken its answer"
            self._server.complain(
                "request_too_slow", f"{self._address} has not {what} in {_REQUEST_S:g} s: disconnected"
            )
            self._abort()

    def _abort(self) -> None:
        if self.transport is not None:
            self.transport.abort()


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
