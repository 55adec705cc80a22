"""Metrics and health over HTTP: ``/metrics``, ``/healthz``, ``/readyz``; GET and HEAD, JSON but for the metrics."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any, Final

import msgspec
import structlog
from aiohttp import web

from heaved.networks import checked_networks
from heaved.outputs.http_listener import HttpListener
from heaved.outputs.listen import alike
from heaved.samples import HeaveState, MotionFrame
from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.outputs.tls import Certificates

_METRICS_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
_MAX_CONNECTIONS: Final = 32
"""More would leave no file descriptor for a client of the stream or for a sensor that comes back."""
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
        certificates: Certificates | None = None,
    ) -> None:
        """``metrics``: the text of ``/metrics``. With ``certificates`` it is HTTPS.

        Raises:
            ValueError: ``host`` reaches beyond this machine, ``allow`` names no network and there are no
                ``certificates``, or an entry is none.
        """
        self._listener = HttpListener(
            "http",
            host,
            port,
            networks=checked_networks("http", host, allow, wants_certificates=certificates is not None),
            refusal="is not in a network of [http] allow",
            most=_MAX_CONNECTIONS,
            answer=self._answer,
            complain=self._complain,
            certificates=certificates,
        )
        self._metrics = metrics
        self._alive = alive
        self._ready = ready
        self._count_client_error = count_client_error

    async def start(self) -> tuple[str, int]:
        """Listen; returns the address that was bound (port 0 lets the system choose one).

        Raises:
            ListenError: the address cannot be bound; says what to do.
        """
        return await self._listener.start()

    async def close(self) -> None:
        """Stop listening, and end every connection."""
        await self._listener.close()

    def _complain(self, reason: str, message: str) -> None:
        self._count_client_error(reason)
        _log.warning("http client error", reason=reason, error=message, alike=alike(reason, message))

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
