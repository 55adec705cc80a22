"""Nothing that a client can ask changes anything: all requests that each server takes, and those that one might try."""

from __future__ import annotations

import asyncio
import json
import struct
from contextlib import suppress
from http import HTTPMethod
from typing import TYPE_CHECKING, Any, get_args

import msgspec
from modbus_slaves import mbap_answer
from output_peers import free_port
from running import PATIENCE_S, demo_config, running
from running_outputs import until

from heaved.outputs.register_map import RegistersParams
from heaved.outputs.requests import BadRequest, Request, StatusQuery, Subscription, VersionQuery
from heaved.outputs.telegrams.spec import OutputSpec
from heaved.page.server import PageServer, static_files

if TYPE_CHECKING:
    from pathlib import Path

    from heaved.daemon.daemon import Daemon

METHODS = (*HTTPMethod, "PROPPATCH", "MKCOL", "PURGE")
PATHS = ("/", "/metrics", "/readyz", "/config", "/-/reload", "/events")
WISHES = (
    '?WATCH={"classes":["MOTION"],"rate_hz":1}', "?STATUS", "?VERSION", '?SET={"lead_s":1}', "?RELOAD", "?STOP",
    '?WATCH={"classes":["MOTION"],"lead_s":1}', '?CONFIG={"heave":{"observer":"harmonic"}}', "?STATUS=1", "?VERSION=2",
    "!RESET", "$PMTK314,0*28", "PUT /config", '{"class":"STATUS"}',
)  # fmt: skip


def everything(daemon: Daemon, place: Path) -> tuple[Any, ...]:
    """What a client could have changed: what was learned, what is in force, what is on the disk."""
    files = {path: path.read_bytes() for path in sorted(place.rglob("*")) if path.is_file()}
    learned = msgspec.json.encode(daemon.acquisition.pipeline.state())
    return learned, daemon.config, files, tuple(daemon.acquisition.pipeline.resets.items())


async def answered(address: tuple[str, int], said: bytes) -> bytes:
    """All that comes until the other side closes, or nothing more does."""
    reader, writer = await asyncio.open_connection(*address)
    writer.write(said)
    heard = b""
    with suppress(TimeoutError, ConnectionError):
        async with asyncio.timeout(PATIENCE_S):
            heard = await reader.read()
    writer.transport.abort()
    return heard


def test_a_request_of_the_stream_asks_and_chooses_nothing_but_what_is_sent() -> None:
    """Whoever adds one has to think about this."""
    assert get_args(Request) == (Subscription, StatusQuery, VersionQuery, BadRequest)
    assert {field.name for field in msgspec.structs.fields(Subscription)} == {"classes", "rate_hz"}


async def test_no_request_changes_anything(tmp_path: Path) -> None:
    readers, modbus = ("127.0.0.1", free_port()), ("127.0.0.1", free_port())
    config = demo_config(
        tmp_path,
        device=(),
        registers=RegistersParams(enabled=True, link=f"tcp://127.0.0.1:{modbus[1]}"),
        output=(OutputSpec(name="plc", telegram="tss1", link=f"tcp-listen://127.0.0.1:{readers[1]}"),),  # type: ignore[arg-type]
    )
    path = tmp_path / "heaved.toml"
    path.write_text("[stream]\nport = 0\n")
    async with running(config, path) as daemon:
        await until(lambda: all(health.is_up for health in daemon._outputs.health))
        stream, http = daemon.addresses["stream"], daemon.addresses["http"]
        page = PageServer(host="127.0.0.1", port=0, allow=(), stream_host=stream[0], stream_port=stream[1])
        shown = await page.start()
        await daemon.memory.save()
        before = everything(daemon, tmp_path)
        told = [await asked_of_the_stream(stream, wish) for wish in WISHES]
        assert [kind == "ERROR" for kind in told] == [i > 2 for i in range(len(WISHES))]
        await asked_over_http(http, {"/metrics", "/healthz", "/readyz"})
        await asked_over_http(shown, {*static_files(), "/clock", "/events"})
        await asked_of_registers(modbus)
        _, writer = await asyncio.open_connection(*readers)
        writer.write("".join(f"{wish}\r\n" for wish in WISHES).encode())
        await writer.drain()
        writer.transport.abort()
        await page.close()
        assert everything(daemon, tmp_path) == before


async def asked_of_the_stream(address: tuple[str, int], wish: str) -> str:
    """The class of what comes of it."""
    reader, writer = await asyncio.open_connection(*address)
    writer.write(f"{wish}\n?VERSION\n".encode())
    kinds: list[str] = []
    async with asyncio.timeout(PATIENCE_S):
        while kinds.count("VERSION") < (3 if wish == "?VERSION" else 2):
            kinds.append(json.loads(await reader.readline())["class"])
    writer.transport.abort()
    return next((kind for kind in kinds if kind in ("ERROR", "STATUS")), "")


async def asked_over_http(address: tuple[str, int], served: set[str]) -> None:
    """GET and HEAD of what is there, and nothing else."""
    for method in METHODS:
        for path in PATHS:
            if path == "/events" and method == "GET":
                continue  # Has no end.
            head = f"{method} {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Length: 2\r\n\r\n{{}}"
            status = int((await answered(address, head.encode())).split(b" ")[1])
            expected = {200, 503} if path in served and method in ("GET", "HEAD") else {400, 404, 405}
            assert status in expected, f"{method} {path}: {status}"


async def asked_of_registers(address: tuple[str, int]) -> None:
    """All 256 functions, with a body that writes where there is something to be written."""
    body = struct.pack(">HHB", 3, 1, 2) + struct.pack(">H", 4711)
    reader, writer = await asyncio.open_connection(*address)
    for function in range(256):
        wished = bytes([function]) + (struct.pack(">HH", 3, 1) if function in (3, 4) else body)
        writer.write(mbap_answer(function, 1, wished))
        async with asyncio.timeout(PATIENCE_S):
            number, _, length, _ = struct.unpack(">HHHB", await reader.readexactly(7))
            answer = await reader.readexactly(length - 1)
        assert number == function
        if function in (3, 4):
            assert answer[:2] == bytes([function, 2])
            assert answer[2:] != struct.pack(">H", 4711)
        else:
            assert answer == bytes([function | 0x80, 1]), f"function {function}"
    writer.transport.abort()
