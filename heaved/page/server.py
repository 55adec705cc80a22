"""The web server of the page: a handful of files and one stream of events, GET and HEAD, nothing that can be changed.

The page needs nothing from elsewhere: a ship has no internet.
"""

from __future__ import annotations

import asyncio
import hashlib
import ipaddress
import signal
import socket
import time
from contextlib import suppress
from importlib.resources import files
from typing import TYPE_CHECKING, Final

import structlog
from aiohttp import web

from heaved.networks import EVERYWHERE, is_loopback_host, parse_networks
from heaved.outputs.http_listener import HttpListener
from heaved.outputs.listen import ListenError, alike
from heaved.outputs.shares import TOO_MANY, Shares
from heaved.outputs.tls import Certificates
from heaved.page.follower import Follower
from heaved.page.hub import Hub
from heaved.text import printable

if TYPE_CHECKING:
    import ssl
    from collections.abc import Callable, Iterable

    from heaved.outputs.tls import TlsParams

PORT: Final = 8570
MOST_VIEWERS: Final = 24
"""Browsers that are told at once, of one address a quarter."""
_MOST_CONNECTIONS: Final = 64
"""A browser has up to six."""
_BATCH_S: Final = 0.1
"""Events are sent so often."""
_HEARTBEAT_S: Final = 0.5
"""And so often when there is nothing to say, so that a browser knows that it is still told."""
STUCK_S: Final = 10.0
"""A browser that takes nothing for so long is disconnected."""
_SEND_BUFFER_BYTES: Final = 32 * 1024
"""Small, so that what a sleeping browser will find is seconds old, not minutes. Linux doubles it."""
_METHODS: Final = ("GET", "HEAD")

_TYPES: Final = {
    "html": "text/html",
    "css": "text/css",
    "js": "text/javascript",
    "txt": "text/plain",
    "svg": "image/svg+xml",
}
_HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Server": "heaved",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
}

_log = structlog.get_logger(__name__)


class PageError(Exception):
    """The page cannot be served; the message says why and what to do."""


def static_files() -> dict[str, tuple[bytes, str]]:
    """The files of the page by their path: content and type."""
    found = {}
    for entry in files("heaved.page").joinpath("static").iterdir():
        kind = _TYPES.get(entry.name.rpartition(".")[2])
        if kind is not None:
            path = "/" if entry.name == "index.html" else f"/{entry.name}"
            found[path] = (entry.read_bytes(), kind)
    return found


def is_own_host(header: str, names: Iterable[str]) -> bool:
    """Whether the ``Host`` of a request names this machine: by an address, as localhost, or by one of ``names``.

    A page elsewhere whose name its owner lets point to our address (DNS rebinding) comes with that name; an address
    cannot be pointed elsewhere.
    """
    host, colon, port = header.rpartition(":")
    if not colon or "]" in port:
        host = header
    elif not port.isdecimal():
        return False
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    with suppress(ValueError):
        ipaddress.ip_address(host)
        return True
    return host.lower().rstrip(".") in {"localhost", *(name.lower() for name in names)}


class PageServer:
    """Serves the page of one daemon; everything runs on the event loop.

    Attributes:
        hub: what it knows.
    """

    def __init__(
        self,
        *,
        host: str,
        port: int,
        allow: Iterable[str],
        stream_host: str,
        stream_port: int,
        stream_tls: ssl.SSLContext | None = None,
        files: TlsParams | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """``allow``: networks that may connect, besides this machine. ``stream_tls``: None where the stream has none.
        With ``files`` the page is served as https, and to browsers with a certificate alone.

        Raises:
            PageError: ``host`` reaches beyond this machine, ``allow`` names no network and there are no ``files``, an
                entry is none, or a file cannot be used.
        """
        try:
            networks = parse_networks(allow)
        except ValueError as error:
            raise PageError(f"--{error}") from error
        self._given = files
        try:
            self._certificates = Certificates(files) if files is not None else None
        except ValueError as error:
            raise PageError(f"--cert, --key, --client-ca: {error}") from error
        if not networks and files is not None:
            networks = EVERYWHERE
        if not networks and not is_loopback_host(host):
            raise PageError(
                f"--host {host} can be reached from other machines: name the networks that may look, "
                "for example --allow 192.168.10.0/24, or want certificates of them (--cert, --key, --client-ca)"
            )
        self._host, self._port = host, port
        self._clock = clock
        self._files = static_files()
        self.hub = Hub(_digest(self._files), clock)
        self._shares = Shares(MOST_VIEWERS)
        self._follower = Follower(stream_host, stream_port, self.hub, clock, stream_tls)
        self._listener = HttpListener(
            "page",
            host,
            port,
            networks=networks,
            refusal="is in no network that heaved page was started with (--allow)",
            most=_MOST_CONNECTIONS,
            answer=self._answer,
            complain=self._complain,
            certificates=self._certificates,
        )
        machine = socket.gethostname()
        self._names = (host, machine, f"{machine}.local")
        self._following: asyncio.Task[None] | None = None
        self._warning: asyncio.Task[None] | None = None

    @property
    def scheme(self) -> str:
        """Of its address."""
        return "http" if self._certificates is None else "https"

    def renew_certificates(self) -> None:
        """Read the files again, for connections to come; with one that cannot be used those of before stay."""
        if self._certificates is None or self._given is None:
            return
        try:
            self._certificates.renew(self._given)
        except ValueError as error:
            _log.error("new certificates refused, the old ones stay", fault=str(error))
        else:
            _log.info("certificates read again")

    async def start(self) -> tuple[str, int]:
        """Listen, and follow the daemon; returns the address that was bound (port 0 lets the system choose one).

        Raises:
            PageError: the address cannot be bound; says what to do.
        """
        try:
            address = await self._listener.start()
        except ListenError as error:
            reason = error.__cause__ if isinstance(error.__cause__, OSError) else error
            raise PageError(
                f"cannot listen on {self._host}:{self._port}: {reason.strerror or reason}: stop the program that has "
                "the port, or give another --port or --host"
            ) from error
        self._following = asyncio.create_task(self._follower.run(), name="follow the stream")
        if self._certificates is not None:
            self._warning = asyncio.create_task(self._certificates.keep_warning(), name="certificates")
        return address

    async def close(self) -> None:
        """Stop listening and following, and end every connection."""
        tasks = [task for task in (self._following, self._warning) if task is not None]
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks)
        self._following = self._warning = None
        await self._listener.close()

    async def failed(self) -> None:
        """Wait for what should never be: raises what the follower has ended with."""
        assert self._following is not None
        await self._following

    def _complain(self, reason: str, message: str) -> None:
        _log.warning("page client error", reason=reason, error=message, alike=alike(reason, message))

    async def _answer(self, request: web.BaseRequest) -> web.StreamResponse:
        if not is_own_host(request.headers.get("Host", ""), self._names):
            return _text(
                421, f"this is {self._names[1]}: ask for it by that name or by its address, not as {request.host!r}"
            )
        if request.method not in _METHODS:
            methods = ", ".join(_METHODS)
            return _text(405, f"{request.method} is not served, only {methods}", {"Allow": methods})
        if request.path == "/events":
            return await self._events(request)
        if request.path == "/clock":
            body = b'{"mono_s":%.6f,"viewers":%d,"most_viewers":%d}' % (
                self._clock(), len(self.hub.viewers), MOST_VIEWERS,
            )  # fmt: skip
            return _response(body, "application/json", "no-store")
        found = self._files.get(request.path)
        if found is None:
            return _text(404, f"no {request.path} here, only the page at /")
        return _response(*found, "no-cache")

    async def _events(self, request: web.BaseRequest) -> web.StreamResponse:
        if len(self.hub.viewers) >= MOST_VIEWERS:
            return _text(503, f"{MOST_VIEWERS} browsers show the page already, and no more are served: close one")
        address = request.remote or ""
        if not self._shares.take(address):
            self._complain(TOO_MANY, self._shares.refusal(address))
            return _text(503, f"{self._shares.each} browsers of this machine show the page already: close one")
        try:
            return await self._events_of(request)
        finally:
            self._shares.give_back(address)

    async def _events_of(self, request: web.BaseRequest) -> web.StreamResponse:
        headers = {**_HEADERS, "Content-Type": "text/event-stream; charset=utf-8", "Cache-Control": "no-store"}
        response = web.StreamResponse(headers=headers)
        await response.prepare(request)
        if request.method == "HEAD":
            return response
        response.force_close()
        await self._feed(request, response)
        return response

    async def _feed(self, request: web.BaseRequest, response: web.StreamResponse) -> None:
        """Send what is told until the browser goes; one that takes nothing is let go."""
        if (connection := request.get_extra_info("socket")) is not None:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        viewer = self.hub.join()
        taken_s = self._clock()
        try:
            while (transport := request.transport) is not None and not transport.is_closing():
                await viewer.wait(_HEARTBEAT_S)
                now_s = self._clock()
                if transport.get_write_buffer_size() == 0:  # What was sent before, it has taken.
                    taken_s = now_s
                    async with asyncio.timeout(STUCK_S):
                        await response.write(viewer.take(now_s))
                elif now_s - taken_s > STUCK_S:
                    raise TimeoutError
                await asyncio.sleep(_BATCH_S)
        except TimeoutError:
            self._complain("stuck", f"{request.remote} has taken nothing for {STUCK_S:g} s: disconnected")
            if request.transport is not None:
                request.transport.abort()
        except ConnectionError:
            return
        finally:
            self.hub.leave(viewer)


async def serve(server: PageServer, ready: Callable[[str], None], ended: asyncio.Event | None = None) -> None:
    """Serve until SIGINT or SIGTERM, or until ``ended`` is set; ``ready`` is told the address for a browser. With
    https, SIGHUP has the certificates read again.

    Raises:
        PageError: the address cannot be bound.
    """
    ended = ended or asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, ended.set)
    if server.scheme == "https":
        asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, server.renew_certificates)
    host, port = await server.start()
    try:
        ready(f"{server.scheme}://{f'[{host}]' if ':' in host else host}:{port}/")
        tasks = [asyncio.create_task(ended.wait()), asyncio.create_task(server.failed())]
        done, waiting = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in waiting:
            task.cancel()
        for task in done:
            task.result()
    finally:
        await server.close()


def _digest(contents: dict[str, tuple[bytes, str]]) -> str:
    digest = hashlib.sha256()
    for path in sorted(contents):
        digest.update(contents[path][0])
    return digest.hexdigest()[:16]


def _response(body: bytes, kind: str, cache: str) -> web.Response:
    return web.Response(body=body, content_type=kind, charset="utf-8", headers={**_HEADERS, "Cache-Control": cache})


def _text(status: int, message: str, headers: dict[str, str] | None = None) -> web.Response:
    text = f"{printable(message)}\n"
    return web.Response(status=status, text=text, headers={**_HEADERS, "Cache-Control": "no-store", **(headers or {})})
