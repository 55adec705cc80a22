"""The server of the page: who may ask, what is answered, and that no browser costs another anything."""

from __future__ import annotations

import asyncio
import json
import re
import socket
import time
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

import aiohttp
import pytest
from far_ends import needs_openssl
from stream_peers import Serve, make_frame, make_status
from structlog.testing import capture_logs
from tls_keys import client_context, make_keys, params
from waiting import PATIENCE_S, holds

from heaved.outputs import http_listener, wire
from heaved.outputs.tls import Certificates
from heaved.page import server as server_module
from heaved.page.server import PageError, PageServer, is_own_host, static_files

if TYPE_CHECKING:
    from collections.abc import AsyncIterator
    from pathlib import Path


@asynccontextmanager
async def page_of(stream_port: int = 1, **changes: Any) -> AsyncIterator[tuple[PageServer, str, int]]:
    """(server, host, port) of a page; nobody is at the stream unless a port is given."""
    options: dict[str, Any] = {
        "host": "127.0.0.1", "port": 0, "allow": (), "stream_host": "127.0.0.1", "stream_port": stream_port,
    }  # fmt: skip
    server = PageServer(**{**options, **changes})
    host, port = await server.start()
    try:
        yield server, host, port
    finally:
        await server.close()


async def asked(host: str, port: int, request: str) -> tuple[int, dict[str, str], bytes]:
    """(status, headers, body) of a request that is written by hand."""
    reader, writer = await asyncio.open_connection(host, port)
    writer.write(request.replace("\n", "\r\n").encode())
    async with asyncio.timeout(PATIENCE_S):
        head, _, body = (await reader.read()).partition(b"\r\n\r\n")
    writer.close()
    status, *lines = head.decode().split("\r\n")
    return int(status.split()[1]), dict(line.split(": ", 1) for line in lines), body


async def get(host: str, port: int, path: str, method: str = "GET") -> tuple[int, dict[str, str], bytes]:
    return await asked(host, port, f"{method} {path} HTTP/1.1\nHost: {host}:{port}\nConnection: close\n\n")


class Events:
    """The events of one connection, as a browser reads them."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def until(self, name: str, **wanted: Any) -> Any:
        """The next event of this name that has these fields."""
        async with asyncio.timeout(PATIENCE_S):
            while True:
                line = await self.reader.readline()
                assert line, "closed"
                if line == f"event: {name}\n".encode():
                    told = json.loads((await self.reader.readline()).removeprefix(b"data: "))
                    if told.items() >= wanted.items():
                        return told


@asynccontextmanager
async def events_of(host: str, port: int) -> AsyncIterator[Events]:
    reader, writer = await asyncio.open_connection(host, port, limit=1 << 22)
    # HTTP/1.0: the events come as they are, without the lengths of chunks.
    writer.write(f"GET /events HTTP/1.0\r\nHost: {host}:{port}\r\n\r\n".encode())
    try:
        yield Events(reader, writer)
    finally:
        writer.transport.abort()


# ---- TLS -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("keys")
    make_keys(directory)
    return directory


@needs_openssl
async def test_with_tls_on_both_sides(serve: Serve, keys: Path) -> None:
    """The stream is followed with a certificate, and the page shown to who has one, on which network ever."""
    served = await serve(certificates=Certificates(params(keys)))
    options = {"host": "0.0.0.0", "files": params(keys), "stream_tls": client_context(keys), "stream_host": "localhost"}
    async with page_of(served.port, **options) as (page, _, port):
        assert page.scheme == "https"
        url = f"https://localhost:{port}"
        connector = aiohttp.TCPConnector(ssl=client_context(keys), family=socket.AF_INET)
        async with aiohttp.ClientSession(connector=connector) as browser:
            async with browser.get(f"{url}/") as response:
                assert (response.status, await response.read()) == (200, static_files()["/"][0])
            async with asyncio.timeout(PATIENCE_S), browser.get(f"{url}/events") as response:
                while b'"is_up":true' not in await response.content.readline():
                    pass
        with capture_logs() as logs:
            page.renew_certificates()
        assert [line["event"] for line in logs] == ["certificates read again"]


@needs_openssl
async def test_a_renewed_certificate_that_cannot_be_used_is_refused(keys: Path, tmp_path: Path) -> None:
    mine = tmp_path / "server.key"
    mine.write_bytes((keys / "server.key").read_bytes())
    async with page_of(files=params(keys, key=str(tmp_path / "server"))) as (page, _, _port):
        mine.write_text("nothing")
        with capture_logs() as logs:
            page.renew_certificates()
    assert [line["event"] for line in logs] == ["new certificates refused, the old ones stay"]
    files = params(keys, key=str(tmp_path / "server"))
    with pytest.raises(PageError, match=r"--cert, --key, --client-ca: .* cannot be used"):
        PageServer(host="127.0.0.1", port=0, allow=(), stream_host="h", stream_port=1, files=files)


# ---- what is answered ------------------------------------------------------------------------------------------------


async def test_every_file_is_served_with_its_type_and_its_guards() -> None:
    async with page_of() as (_, host, port):
        for path, (content, kind) in static_files().items():
            status, headers, body = await get(host, port, path)
            assert (status, body) == (200, content)
            assert headers["Content-Type"] == f"{kind}; charset=utf-8"
            assert headers["X-Content-Type-Options"] == "nosniff"
            assert headers["Referrer-Policy"] == "no-referrer"
            assert "default-src 'self'" in headers["Content-Security-Policy"]
            assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
            assert "unsafe" not in headers["Content-Security-Policy"]
            assert "Access-Control-Allow-Origin" not in headers
            status, head, body = await get(host, port, path, "HEAD")
            assert (status, head["Content-Length"], body) == (200, str(len(content)), b"")


def test_the_page_needs_nothing_from_elsewhere_and_names_what_is_there() -> None:
    files = static_files()
    own = {path: content.decode() for path, (content, _) in files.items() if "uPlot" not in path}
    for path, text in own.items():
        urls = set(re.findall(r"(?:https?:)?//[\w.]+\.\w+[^\s\"']*", re.sub(r"(?m)^\s*//.*$", "", text)))
        assert urls <= {"http://www.w3.org/2000/svg"}, path
        assert "innerHTML" not in text, path
    for reference in re.findall(r'(?:href|src)="([^"]+)"', own["/"]):
        assert f"/{reference}" in files
    assert not re.search(r"<script(?![^>]*\bsrc=)|\son\w+=|\sstyle=", own["/"])
    assert b"MIT License" in files["/uPlot.LICENSE.txt"][0]
    ids = set(re.findall(r'id="([\w-]+)"', own["/"]))
    used = set(re.findall(r'\bat\("([\w-]+)"\)', own["/page.js"]))
    assert used <= ids


def _luminance(colour: str) -> float:
    """Relative luminance (WCAG 2.2)."""
    digits = colour.removeprefix("#")
    digits = digits if len(digits) >= 6 else "".join(2 * digit for digit in digits)
    levels = [int(digits[k : k + 2], 16) / 255.0 for k in (0, 2, 4)]
    red, green, blue = (x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in levels)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def _contrast(one: str, other: str) -> float:
    darker, lighter = sorted((_luminance(one), _luminance(other)))
    return (lighter + 0.05) / (darker + 0.05)


@pytest.mark.parametrize(
    ("theme", "least"), [("", 4.5), ('[data-theme="night"]', 4.5), ('[data-theme="contrast"]', 7.0)]
)
def test_every_text_stands_out_from_what_is_behind_it(theme: str, least: float) -> None:
    css = static_files()["/page.css"][0].decode()
    found = re.search(rf":root{re.escape(theme)} {{(.*?)}}", css, re.DOTALL)
    assert found
    colours = dict(re.findall(r"--([\w-]+): (#\w+);", found[1]))
    pairs = [("fg", "panel"), ("fg", "bg"), ("dim", "panel"), ("dim", "bg"), ("up", "panel"), ("bg", "fg")]
    pairs += [(f"{level}-fg", f"{level}-bg") for level in ("good", "caution", "settling", "alarm")]
    ratios = {pair: _contrast(*(colours[name] for name in pair)) for pair in pairs}
    assert not {pair: round(ratio, 1) for pair, ratio in ratios.items() if ratio < least}
    # Lines: 3 is what WCAG asks of what is not text.
    lines = {
        name: _contrast(colours[name], colours["panel"]) for name in ("heave", "forecast", "laser", "roll", "pitch")
    }
    assert not {name: round(ratio, 1) for name, ratio in lines.items() if ratio < 3.0}


@pytest.mark.parametrize(
    ("request_", "status", "said"),
    [
        ("GET /../../etc/passwd HTTP/1.1\nHost: localhost\nConnection: close\n\n", 404, b"only the page"),
        ("GET /%2e%2e/server.py HTTP/1.1\nHost: localhost\nConnection: close\n\n", 404, b"only the page"),
        ("GET /nothing%1b[31m HTTP/1.1\nHost: localhost\nConnection: close\n\n", 404, b"/nothing\\x1b[31m"),
        ("POST / HTTP/1.1\nHost: localhost\nConnection: close\nContent-Length: 3\n\nabc", 405, b"only GET, HEAD"),
        ("PUT /page.js HTTP/1.1\nHost: localhost\nConnection: close\nContent-Length: 0\n\n", 405, b"only GET, HEAD"),
        ("DELETE /events HTTP/1.1\nHost: localhost\nConnection: close\n\n", 405, b"only GET, HEAD"),
        ("OPTIONS / HTTP/1.1\nHost: localhost\nConnection: close\n\n", 405, b"only GET, HEAD"),
        ("GET / HTTP/1.1\nHost: evil.example:8570\nConnection: close\n\n", 421, b"not as 'evil.example:8570'"),
        ("GET /events HTTP/1.1\nHost: evil.example\nConnection: close\n\n", 421, b"not as"),
        ("GET /events HTTP/1.0\n\n", 421, b"ask for it by that name"),
        ("nonsense\n\n", 400, b""),
    ],
    ids=lambda value: value.split("\n")[0] if isinstance(value, str) else None,
)
async def test_what_is_not_served_is_told(request_: str, status: int, said: bytes) -> None:
    async with page_of() as (_, host, port):
        found, headers, body = await asked(host, port, request_)
        assert found == status
        assert said in body
        if status == 405:
            assert headers["Allow"] == "GET, HEAD"


@pytest.mark.parametrize(
    ("header", "own"),
    [
        ("127.0.0.1:8570", True),
        ("localhost", True),
        ("LocalHost.:8570", True),
        ("[::1]:8570", True),
        ("[fe80::1]", True),
        ("192.168.10.4:8570", True),
        ("bridge", True),
        ("bridge.local:80", True),
        ("bridge.evil.example", False),
        ("evil.example:8570", False),
        ("127.0.0.1.evil.example", False),
        ("localhost.evil.example", False),
        ("localhost:8570:1", False),
        ("localhost:x", False),
        ("", False),
        ("[::1", False),
    ],
)
def test_a_name_that_is_not_ours_is_refused(header: str, own: bool) -> None:
    assert is_own_host(header, ("bridge", "bridge.local")) is own


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"host": "0.0.0.0"}, "name the networks that may look, for example --allow 192.168.10.0/24"),
        ({"allow": ("10.0.0.1/8",)}, "--allow: '10.0.0.1/8' is not a network"),
        ({"host": "no.such.invalid", "allow": ("10.0.0.0/8",)}, "cannot listen on no.such.invalid:0"),
    ],
)
async def test_where_it_must_not_or_cannot_listen_it_says_what_to_do(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(PageError, match=re.escape(said)):
        async with page_of(**changes):
            pass


async def test_a_port_that_is_taken_is_said() -> None:
    async with page_of() as (_, host, port):
        with pytest.raises(PageError, match=f"cannot listen on {host}:{port}: .*give another --port"):
            async with page_of(port=port):
                pass


async def test_who_is_in_no_allowed_network_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_listener, "is_allowed", lambda address, networks: False)
    async with page_of() as (_, host, port):
        status, _, body = await get(host, port, "/")
        assert status == 403
        assert f"{host} is in no network" in json.loads(body)["error"]


# ---- events ----------------------------------------------------------------------------------------------------------


async def test_what_the_stream_says_reaches_the_browser_through_a_restart(serve: Serve) -> None:
    served = await serve(clock=time.monotonic)
    running = True

    async def publish() -> None:
        while running:
            served.publisher.publish(make_frame(time.monotonic()))
            await asyncio.sleep(0.01)

    publishing = asyncio.create_task(publish())
    async with page_of(served.port) as (_, host, port), events_of(host, port) as events:
        told = await events.until("motion")
        assert told["frames"][0]["record"]["heave_m"] == 1.25
        now_s = json.loads((await get(host, port, "/clock"))[2])["mono_s"]
        assert now_s - PATIENCE_S < told["frames"][0]["at_s"] <= now_s
        await served.publisher.close(0.0)
        lost = await events.until("link", is_up=False)
        assert "connection" in lost["trouble"].lower()
        await events.until("clock")  # The page itself lives, and says so.
        served = await serve(port=served.port, clock=time.monotonic)
        again = await events.until("link", is_up=True)
        assert again["connections"] == 2
        assert (await events.until("motion"))["frames"]
        async with events_of(host, port) as newcomer:
            history = await newcomer.until("history")
            assert history["heave_m"][0] == 1.25
            assert (await newcomer.until("status"))["record"]["release"] == "1.2.3"
    running = False
    await publishing


async def test_heads_of_events_end_at_once_and_nobody_is_counted() -> None:
    async with page_of() as (server, host, port):
        status, headers, body = await get(host, port, "/events", "HEAD")
        assert (status, body) == (200, b"")
        assert headers["Content-Type"].startswith("text/event-stream")
        assert server.hub.viewers == set()


async def test_so_many_browsers_are_served_and_the_next_is_told() -> None:
    async with page_of() as (server, host, port), aiohttp.ClientSession(f"http://{host}:{port}") as session:
        open_ = [await session.get("/events") for _ in range(server_module.MOST_VIEWERS)]
        assert all(answer.status == 200 for answer in open_)
        async with session.get("/events") as answer:
            assert answer.status == 503
            assert "close one" in await answer.text()
        async with session.get("/clock") as answer:
            told = await answer.json()
            assert told["viewers"] == told["most_viewers"] == server_module.MOST_VIEWERS
        open_.pop().close()
        await holds(lambda: len(server.hub.viewers) < server_module.MOST_VIEWERS)
        async with session.get("/events") as answer:
            assert answer.status == 200
        for other in open_:
            other.close()


async def test_a_browser_that_takes_nothing_is_let_go_and_costs_the_others_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(server_module, "STUCK_S", 0.3)
    async with page_of() as (server, host, port), events_of(host, port) as good:
        await good.until("clock")
        with socket.socket() as stuck:
            stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            stuck.connect((host, port))
            stuck.sendall(f"GET /events HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
            big = make_status(config_file="x" * 200_000)
            line = wire.encode_record(big).strip()
            async with asyncio.timeout(PATIENCE_S):
                await holds(lambda: len(server.hub.viewers) == 2)
                while len(server.hub.viewers) == 2:
                    server.hub.hear(big, line, time.monotonic())
                    assert (await good.until("status"))["record"]["release"] == "1.2.3"
            (left,) = server.hub.viewers
            server.hub.hear(make_status(), wire.encode_record(make_status(frames=7)).strip(), 0.0)
            assert (await good.until("status", read_s=0.0))["record"]["frames"] == 7
            assert server.hub.viewers == {left}


async def test_it_serves_until_it_is_told_to_end() -> None:
    ended = asyncio.Event()
    said: list[str] = []
    server = PageServer(host="127.0.0.1", port=0, allow=(), stream_host="127.0.0.1", stream_port=1)

    def ready(address: str) -> None:
        said.append(address)
        ended.set()

    async with asyncio.timeout(PATIENCE_S):
        await server_module.serve(server, ready, ended)
    (address,) = said
    port = int(address.rstrip("/").rpartition(":")[2])
    with pytest.raises(ConnectionRefusedError):
        await asyncio.open_connection("127.0.0.1", port)
