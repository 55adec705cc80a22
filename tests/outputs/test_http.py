"""Metrics and health over HTTP."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import itertools
import json
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import aiohttp
import pytest
from aiohttp import web
from stream_peers import make_frame
from structlog.testing import capture_logs

from heaved.outputs import http as http_module
from heaved.outputs import http_listener
from heaved.outputs.http import HttpServer, Verdict, liveness, readiness
from heaved.outputs.listen import ListenError
from heaved.samples import HeaveState

Get = Callable[..., Awaitable[tuple[int, str, str]]]


class Health:
    """What the server is told to answer."""

    def __init__(self) -> None:
        self.alive = Verdict(details={"uptime_s": 12.5})
        self.ready = Verdict()
        self.errors: Counter[str] = Counter()


@pytest.fixture
def health() -> Health:
    return Health()


@pytest.fixture
async def server(health: Health) -> AsyncIterator[tuple[str, int]]:
    server = make_server(health)
    yield await server.start()
    await server.close()


def make_server(health: Health, **changes: Any) -> HttpServer:
    options: dict[str, Any] = {
        "host": "127.0.0.1",
        "port": 0,
        "allow": (),
        "metrics": lambda: b"heaved_clients 3.0\n",
        "alive": lambda: health.alive,
        "ready": lambda: health.ready,
        "count_client_error": lambda reason: health.errors.update([reason]),
    }
    return HttpServer(**{**options, **changes})


async def fetch(address: tuple[str, int], path: str, method: str = "GET") -> tuple[int, str, str]:
    """Status, content type, body."""
    url = f"http://{address[0]}:{address[1]}{path}"
    async with aiohttp.ClientSession() as session, session.request(method, url) as response:
        return response.status, response.headers["Content-Type"], await response.text()


async def test_metrics(server: tuple[str, int]) -> None:
    assert await fetch(server, "/metrics") == (
        200, "text/plain; version=0.0.4; charset=utf-8", "heaved_clients 3.0\n"
    )  # fmt: skip


async def test_no_more_connections_than_the_process_can_spare(
    server: tuple[str, int], health: Health, caplog: pytest.LogCaptureFixture
) -> None:
    """Whoever opens many and asks nothing costs the others nothing, and room is made when they go."""
    idle = [await asyncio.open_connection(*server) for _ in range(http_module._MAX_CONNECTIONS + 20)]
    closed = 0
    async with asyncio.timeout(20.0):
        for reader, _ in idle[http_module._MAX_CONNECTIONS :]:
            with contextlib.suppress(ConnectionResetError):
                assert await reader.read() == b""
            closed += 1
    assert closed == health.errors["too_many_clients"] == 20
    for _, writer in idle:
        writer.transport.abort()
    for attempt in itertools.count():  # That they have gone shows to the server a little later.
        try:
            assert (await fetch(server, "/healthz"))[0] == 200
            break
        except aiohttp.ClientError:
            assert attempt < 1000
    gc.collect()
    assert [record.getMessage() for record in caplog.records] == []


async def test_health(server: tuple[str, int], health: Health) -> None:
    status, content_type, body = await fetch(server, "/healthz")
    assert (status, content_type.split(";")[0]) == (200, "application/json")
    assert json.loads(body) == {"alive": True, "reasons": [], "uptime_s": 12.5}
    health.alive = Verdict(reasons=("no frame for 7.0 s",))
    status, _, body = await fetch(server, "/healthz")
    assert (status, json.loads(body)) == (503, {"alive": False, "reasons": ["no frame for 7.0 s"]})


async def test_ready(server: tuple[str, int], health: Health) -> None:
    status, _, body = await fetch(server, "/readyz")
    assert (status, json.loads(body)) == (200, {"ready": True, "reasons": []})
    health.ready = Verdict(reasons=("heave is invalid",))
    status, _, body = await fetch(server, "/readyz")
    assert (status, json.loads(body)) == (503, {"ready": False, "reasons": ["heave is invalid"]})


async def test_other_paths_and_methods(server: tuple[str, int]) -> None:
    status, content_type, body = await fetch(server, "/admin?x=1")
    assert (status, content_type.split(";")[0]) == (404, "application/json")
    assert "/admin" in json.loads(body)["error"]
    for method in ("POST", "PUT", "DELETE", "OPTIONS", "TRACE"):
        status, _, body = await fetch(server, "/metrics", method)
        assert status == 405
        assert method in json.loads(body)["error"]


async def test_a_peer_outside_the_list(
    server: tuple[str, int], health: Health, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(http_listener, "is_allowed", lambda _address, _networks: False)
    status, _, body = await fetch(server, "/metrics")
    assert status == 403
    assert json.loads(body) == {"error": "127.0.0.1 is not in a network of [http] allow"}
    assert health.errors == {"not_allowed": 1}


@pytest.mark.parametrize("said", [b"GET /metrics HTTP/1.1\r\n\r\n", b"\x16\x03\x01", b"x" * 100_000])
async def test_what_a_peer_outside_the_list_says_is_not_looked_at(
    server: tuple[str, int], health: Health, monkeypatch: pytest.MonkeyPatch, said: bytes
) -> None:
    monkeypatch.setattr(http_listener, "is_allowed", lambda _address, _networks: False)
    monkeypatch.setattr(web.Server, "__call__", lambda _self: pytest.fail("HTTP is spoken"))
    reader, writer = await asyncio.open_connection(*server)
    writer.write(said)
    head, _, body = (await reader.read()).partition(b"\r\n\r\n")
    writer.close()
    assert head.startswith(b"HTTP/1.1 403 Forbidden\r\n")
    assert f"Content-Length: {len(body)}".encode() in head
    assert json.loads(body) == {"error": "127.0.0.1 is not in a network of [http] allow"}
    assert health.errors == {"not_allowed": 1}


@pytest.mark.parametrize("path", ["/metrics", "/healthz", "/readyz"])
async def test_head_is_get_without_a_body(server: tuple[str, int], path: str) -> None:
    heads = []
    for method in ("GET", "HEAD"):
        reader, writer = await asyncio.open_connection(*server)
        writer.write(f"{method} {path} HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n".encode())
        head, _, body = (await reader.read()).partition(b"\r\n\r\n")
        writer.close()
        heads.append([line for line in head.split(b"\r\n") if not line.startswith(b"Date")])
        assert bool(body) is (method == "GET")
    assert heads[0] == heads[1]
    assert heads[0][0] == b"HTTP/1.1 200 OK"


NO_HTTP = {
    "TLS": b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
    "a version that there is not": b"GET / HTTP/9.9\r\n\r\n",
    "no header": b"GET / HTTP/1.1\r\nno colon\r\n\r\n",
    "two lengths": b"GET / HTTP/1.1\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n",
    "an endless line": b"GET /" + b"x" * 20_000,
    "control characters": b"GET /\x1b[31m HTTP/1.1\r\n\r\n",
}


@pytest.mark.parametrize("name", NO_HTTP)
async def test_what_is_no_http_is_counted_and_no_traceback(
    server: tuple[str, int], health: Health, caplog: pytest.LogCaptureFixture, name: str
) -> None:
    with capture_logs() as logs:
        reader, writer = await asyncio.open_connection(*server)
        writer.write(NO_HTTP[name])
        assert (await reader.read()).split(b" ")[1] == b"400"
        writer.close()
    assert health.errors == {"bad_request": 1}
    assert [(line["event"], line["alike"]) for line in logs] == [("http client error", "bad_request")]
    assert caplog.records == []


async def test_a_fault_of_ours_is_logged(health: Health, caplog: pytest.LogCaptureFixture) -> None:
    def fail() -> bytes:
        raise ZeroDivisionError("float division by zero")

    server = make_server(health, metrics=fail)
    assert (await fetch(await server.start(), "/metrics"))[0] == 500
    await server.close()
    (record,) = caplog.records
    assert record.exc_info is not None
    assert health.errors == {}


async def test_port_in_use(server: tuple[str, int], health: Health) -> None:
    with pytest.raises(ListenError, match=rf"127\.0\.0\.1:{server[1]}: the port is in use.*\[http\] port"):
        await make_server(health, port=server[1]).start()


async def test_beyond_this_machine_only_with_a_list(health: Health) -> None:
    with pytest.raises(ValueError, match=r"\[http\] host 0\.0\.0\.0"):
        make_server(health, host="0.0.0.0")


async def test_close_again_and_without_start(health: Health) -> None:
    server = make_server(health)
    await server.close()
    address = await server.start()
    await fetch(address, "/healthz")
    await server.close()
    await server.close()
    with pytest.raises(aiohttp.ClientConnectorError):
        await fetch(address, "/healthz")


@pytest.mark.parametrize(
    ("last_s", "now_s", "alive"),
    [(None, 104.0, True), (None, 106.0, False), (200.0, 204.0, True), (200.0, 206.0, False)]
)  # fmt: skip
def test_liveness(last_s: float | None, now_s: float, alive: bool) -> None:
    frame = None if last_s is None else make_frame(last_s, HeaveState.INVALID)
    verdict = liveness(frame, now_s=now_s, started_s=100.0)
    assert (not verdict.reasons) is alive
    assert verdict.details["uptime_s"] == now_s - 100.0


@pytest.mark.parametrize(
    ("heave", "age_s", "reasons"),
    [
        (HeaveState.VALID, 0.5, ()),
        (HeaveState.SETTLING, 0.5, ()),
        (HeaveState.DEGRADED, 0.5, ()),
        (HeaveState.INVALID, 0.5, ("heave is invalid",)),
        (HeaveState.VALID, 1.5, ("last frame is 1.5 s old",)),
        (HeaveState.INVALID, 1.5, ("last frame is 1.5 s old", "heave is invalid")),
    ],
)
def test_readiness(heave: HeaveState, age_s: float, reasons: tuple[str, ...]) -> None:
    assert readiness(make_frame(10.0, heave), now_s=10.0 + age_s).reasons == reasons
    assert readiness(None, now_s=10.0).reasons == ("no frame yet",)
