"""Metrics and health over HTTP: ``/metrics``, ``/healthz``, ``/readyz``; GET alone, JSON but for the metrics."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from math import isfinite
from typing import Any, Final

import msgspec
from aiohttp import web

from heaved.outputs.access import checked_networks, is_allowed, listen_error
from heaved.samples import HeaveState, MotionFrame

_METRICS_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
_SHUTDOWN_S: Final = 0.2
"""Open requests are given this long at the end; ten times what any answer takes."""
_MAX_CONNECTIONS: Final = 32
"""More are closed at once. Without a limit whoever opens many leaves no file descriptor for a client of the stream or
for a sensor that comes back. A connection that asks nothing is closed after :data:`_IDLE_S`."""
_IDLE_S: Final = 15.0
_PATHS: Final = ("/metrics", "/healthz", "/readyz")


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
    reasons = [f"last frame is {age_s:.1f} s old"] if age_s > fresh_s else []
    if last_frame.quality.heave is HeaveState.INVALID:
        reasons += ["heave is invalid", *last_frame.quality.reasons]
    elif not isfinite(last_frame.heave_m):
        reasons += ["no heave yet", *last_frame.quality.reasons]
    details = {"heave": last_frame.quality.heave.value, "age_s": round(age_s, 6)}
    return Verdict(reasons=tuple(reasons), details=details)


class _BoundedServer(web.Server):
    def __init__(self, *arguments: Any, turned_away: Callable[[], None], **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._turned_away = turned_away

    def connection_made(self, handler: web.RequestHandler, transport: asyncio.Transport) -> None:
        super().connection_made(handler, transport)
        if len(self.connections) > _MAX_CONNECTIONS:
            self._turned_away()
            asyncio.get_running_loop().call_soon(transport.abort)  # The handler's task wants to have begun by then.


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
        self._host = host
        self._port = port
        self._metrics = metrics
        self._alive = alive
        self._ready = ready
        self._count_client_error = count_client_error
        self._runner: web.ServerRunner | None = None

    async def start(self) -> tuple[str, int]:
        """Listen; returns the address that was bound (port 0 lets the system choose one).

        Raises:
            ListenError: the address cannot be bound; says what to do.
        """
        server = _BoundedServer(
            self._answer,
            turned_away=lambda: self._count_client_error("too_many_clients"),
            access_log=None,
            keepalive_timeout=_IDLE_S,
        )
        runner = web.ServerRunner(server, shutdown_timeout=_SHUTDOWN_S)
        await runner.setup()
        try:
            await web.TCPSite(runner, self._host, self._port).start()
        except OSError as error:
            await runner.cleanup()
            raise listen_error("http", self._host, self._port, error) from error
        self._runner = runner
        host, port, *_ = runner.addresses[0]
        return host, port

    async def close(self) -> None:
        if self._runner is not None:
            await self._runner.cleanup()
            self._runner = None

    async def _answer(self, request: web.BaseRequest) -> web.Response:
        if not is_allowed(request.remote or "", self._networks):
            self._count_client_error("not_allowed")
            return _json(403, {"error": f"{request.remote} is not in a network of [http] allow"})
        if request.path not in _PATHS:
            return _json(404, {"error": f"no {request.path} here, only {', '.join(_PATHS)}"})
        if request.method != "GET":
            return _json(405, {"error": f"{request.method} is not served, only GET"}, {"Allow": "GET"})
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
