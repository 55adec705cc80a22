"""Metrics and health over HTTP: ``/metrics``, ``/healthz``, ``/readyz``; GET and HEAD, JSON but for the metrics.

Who may ask is decided before a byte of what is asked is looked at.
"""

from __future__ import annotations

import asyncio
import logging
from http import HTTPStatus
from math import isfinite
from typing import TYPE_CHECKING, Any, Final, cast

import msgspec
import structlog
from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

from heaved.networks import checked_networks, is_allowed
from heaved.outputs.listen import Listener
from heaved.samples import HeaveState, MotionFrame
from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Callable

_METRICS_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
_SHUTDOWN_S: Final = 0.2
"""Open requests are given this long at the end; ten times what any answer takes."""
_MAX_CONNECTIONS: Final = 32
"""More are closed at once. Without a limit whoever opens many leaves no file descriptor for a client of the stream or
for a sensor that comes back. A connection that asks nothing is closed after :data:`_IDLE_S`."""
_IDLE_S: Final = 15.0
_REFUSAL_S: Final = 1.0
"""How long a peer that may not connect may take to ask and to read why."""
_PATHS: Final = ("/metrics", "/healthz", "/readyz")
_METHODS: Final = ("GET", "HEAD")

_log = structlog.get_logger(__name__)


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """Answer of a health check: well when there is no reason against it."""

    reasons: tuple[str, ...] = ()
    details: dict[str, float | int | str] = {}
    """Goes into the body as it is. Finite numbers only."""


def liveness(last_frame: MotionFrame | None, *, now_s: float, started_s: float, patience_s: float = 5.0) -> Verdict:
    """Whether the pipeline makes frames, of whatever quality. (That the event loop turns is shown by the answer.)

    Times on the clock of ``MotionFrame.t_s``. ``patience_s`` is also granted to the first frame after the start.
    """
    since_s = now_s - (started_s if last_frame is None else last_frame.t_s)
    reasons = (f"no frame for {since_s:.1f} s: the pipeline has stopped",) if since_s > patience_s else ()
    return Verdict(reasons=reasons, details={"uptime_s": round(now_s - started_s, 3)})


def readiness(last_frame: MotionFrame | None, *, now_s: float, fresh_s: float = 1.0) -> Verdict:
    """Whether frames flow and their heave means something. Times on the clock of ``MotionFrame.t_s``."""
    if last_frame is None:
        return Verdict(reasons=("no frame yet",))
    age_s = now_s - last_frame.t_s
    reasons = [] if age_s <= fresh_s else [f"last frame is {age_s:.1f} s old"]
    if last_frame.quality.heave is HeaveState.INVALID:
        reasons += ["heave is invalid", *last_frame.quality.reasons]
    elif not isfinite(last_frame.heave_m):
        reasons += ["no heave yet", *last_frame.quality.reasons]
    details = {"heave": last_frame.quality.heave.value, "age_s": round(age_s, 6)}
    return Verdict(reasons=tuple(reasons), details=details)


class BoundedServer(web.Server):
    """Serves so many connections at once; more are closed as they come."""

    def __init__(self, *arguments: Any, most: int, turned_away: Callable[[], None], **options: Any) -> None:
        """``most`` connections; ``turned_away`` is called for each that is closed."""
        super().__init__(*arguments, **options)
        self._most = most
        self._turned_away = turned_away

    def connection_made(self, handler: web.RequestHandler, transport: asyncio.Transport) -> None:
        """Serve it, or close it."""
        super().connection_made(handler, transport)
        if len(self.connections) > self._most:
            self._turned_away()
            asyncio.get_running_loop().call_soon(transport.abort)  # The handler's task wants to have begun by then.


class Refusal(asyncio.Protocol):
    """Serves a peer that may not connect: what it says is thrown away, and the first of it answered."""

    def __init__(self, refused: set[Refusal], answer: bytes) -> None:
        """``refused``: all that are served so."""
        self._refused = refused
        self._answer = answer

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """It may stay for a moment."""
        self._transport = cast("asyncio.Transport", transport)
        self._refused.add(self)
        # Closing at once would reset the connection of a client that is still sending: it would not read the answer.
        patience_s = _REFUSAL_S if len(self._refused) <= _MAX_CONNECTIONS else 0.0
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


def log_of_faults(complain: Callable[[str, str], None]) -> logging.Logger:
    """Takes what the HTTP library has to say: what clients do wrong is told to ``complain``, by a reason and in short,
    what is wrong here is logged.
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


class HttpServer:
    """Serves the three paths; everything runs on the event loop."""

    def __init__(
        self,
        *,
        host: str,
        port: int,
        allow: tuple[str, ...],
        metrics: Callable[[], bytes],
        alive: Callable[[], Verdict],
        ready: Callable[[], Verdict],
        count_client_error: Callable[[str], None],
    ) -> None:
        """``metrics``: the text of ``/metrics``.

        Raises:
            ValueError: ``host`` reaches beyond this machine and ``allow`` names no network, or an entry is none.
        """
        self._networks = checked_networks("http", host, allow)
        self._listener = Listener("http", host, port, self._admit)
        self._metrics = metrics
        self._alive = alive
        self._ready = ready
        self._count_client_error = count_client_error
        self._server: BoundedServer | None = None
        self._refused: set[Refusal] = set()

    async def start(self) -> tuple[str, int]:
        """Listen; returns the address that was bound (port 0 lets the system choose one).

        Raises:
            ListenError: the address cannot be bound; says what to do.
        """
        self._server = BoundedServer(
            self._answer,
            most=_MAX_CONNECTIONS,
            turned_away=lambda: self._complain("too_many_clients", f"{_MAX_CONNECTIONS} connections are open"),
            access_log=None,
            logger=log_of_faults(self._complain),
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
        message = f"{address} is not in a network of [http] allow"
        self._complain("not_allowed", message)
        return Refusal(self._refused, forbidden(message))

    def _complain(self, reason: str, message: str) -> None:
        self._count_client_error(reason)
        _log.warning("http client error", reason=reason, error=message, alike=reason)

    async def _answer(self, request: web.BaseRequest) -> web.Response:
        if request.path not in _PATHS:
            return _json(404, {"error": f"no {printable(request.path)} here, only {', '.join(_PATHS)}"})
        if request.method not in _METHODS:
            methods = ", ".join(_METHODS)
            error = f"{printable(request.method)} is not served, only {methods}"
            return _json(405, {"error": error}, {"Allow": methods})
        if request.path == "/metrics":
            return web.Response(body=self._metrics(), headers={"Content-Type": _METRICS_TYPE})
        if request.path == "/healthz":
            return _verdict("alive", self._alive())
        return _verdict("ready", self._ready())


def _verdict(word: str, verdict: Verdict) -> web.Response:
    well = not verdict.reasons
    return _json(200 if well else 503, {word: well, "reasons": verdict.reasons, **verdict.details})


def _json(status: int, body: dict[str, Any], headers: dict[str, str] | None = None) -> web.Response:
    content = msgspec.json.encode(body) + b"\n"
    return web.Response(status=status, body=content, content_type="application/json", headers=headers)


def forbidden(message: str) -> bytes:
    """A whole response, for who is not listened to."""
    body = msgspec.json.encode({"error": message}) + b"\n"
    head = (
        f"HTTP/1.1 {HTTPStatus.FORBIDDEN.value} {HTTPStatus.FORBIDDEN.phrase}\r\n"
        f"Content-Type: application/json\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    )
    return head.encode() + body
