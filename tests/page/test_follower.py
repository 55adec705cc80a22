"""The stream is followed through whatever its other end does."""

from __future__ import annotations

import asyncio
import json
import socket
import time
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

import msgspec
import pytest
from far_ends import needs_openssl
from stream_peers import Serve, make_frame
from tls_keys import client_context, make_keys, params

from heaved.outputs import wire
from heaved.outputs.credentials import tls_context
from heaved.outputs.records import MotionRecord
from heaved.outputs.tls import Certificates
from heaved.page import follower
from heaved.page.follower import DaemonClock, Follower, Known, Link

if TYPE_CHECKING:
    import ssl
    from collections.abc import AsyncIterator, Callable
    from pathlib import Path


class Ear:
    """Keeps all that it is told, and wakes who waits for it."""

    def __init__(self) -> None:
        self.links: list[Link] = []
        self.heard: list[tuple[Known, bytes, float]] = []
        self._news = asyncio.Condition()
        self._telling: set[asyncio.Task[None]] = set()

    def link(self, link: Link) -> None:
        self.links.append(link)
        self._tell()

    def hear(self, record: Known, line: bytes, at_s: float) -> None:
        self.heard.append((record, line, at_s))
        self._tell()

    async def until(self, condition: Callable[[], object]) -> None:
        async with asyncio.timeout(20.0), self._news:
            await self._news.wait_for(condition)

    @property
    def trouble(self) -> str:
        return self.links[-1].trouble if self.links else ""

    def kinds(self) -> set[str]:
        return {type(record).__name__ for record, _, _ in self.heard}

    def _tell(self) -> None:
        async def notify() -> None:
            async with self._news:
                self._news.notify_all()

        task = asyncio.ensure_future(notify())
        self._telling.add(task)
        task.add_done_callback(self._telling.discard)


@asynccontextmanager
async def following(host: str, port: int, tls: ssl.SSLContext | None = None) -> AsyncIterator[Ear]:
    ear = Ear()
    task = asyncio.create_task(Follower(host, port, ear, tls=tls).run())
    try:
        yield ear
    finally:
        task.cancel()
        await asyncio.wait([task])


@asynccontextmanager
async def saying(text: bytes) -> AsyncIterator[int]:
    """A server that says this to whoever comes, and then no more."""
    writers: list[asyncio.StreamWriter] = []

    async def serve(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writers.append(writer)
        writer.write(text)

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        for writer in writers:
            writer.transport.abort()


def motion(mono_s: float, age_s: float = 0.0) -> MotionRecord:
    line = wire.encode_motion(make_frame(mono_s), seq=1, utc_s=0.0, sent_mono_s=mono_s + age_s)
    return msgspec.json.decode(line, type=MotionRecord)


@needs_openssl
async def test_a_daemon_with_tls(serve: Serve, tmp_path: Path) -> None:
    make_keys(tmp_path)
    served = await serve(certificates=Certificates(params(tmp_path)))
    async with following("localhost", served.port, client_context(tmp_path)) as ear:
        await ear.until(lambda: ear.links and ear.links[-1].is_up)
    async with following("localhost", served.port, tls_context(str(tmp_path / "foreign.pem"))) as ear:
        await ear.until(lambda: "its certificate is not accepted" in ear.trouble)
    async with following("localhost", served.port, client_context(tmp_path, "")) as ear:
        await ear.until(lambda: "it does not accept our certificate" in ear.trouble)


async def test_it_hears_all_classes_and_lives_through_a_restart(serve: Serve) -> None:
    served = await serve(clock=time.monotonic)

    async def publish() -> None:
        while True:
            served.publisher.publish(make_frame(time.monotonic()))
            await asyncio.sleep(0.01)

    async with following(served.host, served.port) as ear:
        publishing = asyncio.create_task(publish())
        await ear.until(lambda: ear.kinds() >= {"MotionRecord", "StatusRecord"})
        record, line, at_s = next(heard for heard in ear.heard if isinstance(heard[0], MotionRecord))
        assert isinstance(record, MotionRecord)
        assert json.loads(line)["heave_m"] == record.heave_m == 1.25
        assert at_s == pytest.approx(record.mono_s, abs=1.0)  # One machine, one clock.
        await served.publisher.close(0.0)
        await ear.until(lambda: ear.trouble)
        lost = len(ear.heard)
        served = await serve(port=served.port, clock=time.monotonic)
        await ear.until(lambda: len(ear.heard) > lost + 2)
        publishing.cancel()
    assert [(link.is_up, link.connections) for link in ear.links if link.is_up] == [(True, 1), (True, 2)]
    assert ear.links[0].trouble == "connecting"
    assert all(link.is_up or link.trouble for link in ear.links)


VERSION = b'{"class":"VERSION","release":"9","proto_major":1,"proto_minor":9}\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"SSH-2.0-OpenSSH_9.9\r\n", "not a heaved daemon"),
        (b'{"class":"STATUS"}\n', "not a heaved daemon"),
        (b'{"class":"SEA","time":"x"}\n', "not a heaved daemon"),
        (b'{"class":"VERSION","release":"9","proto_major":2,"proto_minor":0}\n', "update the older one"),
        (b"x" * (1 << 21), "a line without end"),
        (b'{"class":"ERROR","message":"64 clients are connected"}\n', "the daemon says: 64 clients are connected"),
        (VERSION + b'{"class":"ERROR","message":"64 clients are connected"}\n', "64 clients are connected"),
        (VERSION + b'{"class":"MOTION","seq":"no"}\n', "not a heaved daemon"),
        (VERSION + b'{"class":"MOTION"' + b"\n", "not a heaved daemon"),
    ],
)
async def test_what_is_no_daemon_is_told_in_words(text: bytes, said: str) -> None:
    async with saying(text) as port, following("127.0.0.1", port) as ear:
        await ear.until(lambda: said in ear.trouble)
        assert not ear.links[-1].is_up


async def test_a_daemon_that_says_nothing_more_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(follower, "SILENCE_S", 0.1)
    async with saying(VERSION) as port, following("127.0.0.1", port) as ear:
        await ear.until(lambda: "nothing said for 0.1 s" in ear.trouble)
        assert [link.is_up for link in ear.links[:3]] == [False, True, False]


@pytest.mark.parametrize(
    ("host", "said"), [("127.0.0.1", "Connection refused: is heaved running"), ("no.such.invalid", "no such host")]
)
async def test_where_nobody_is_it_says_so_once(host: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(follower, "_RETRY_S", 0.01)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    async with following(host, port) as ear:
        await ear.until(lambda: said in ear.trouble)
        assert len(ear.links) == 2


async def test_it_ends_when_it_is_told_to_at_whatever_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    """In Python 3.11 ``asyncio.wait_for`` forgets that it was cancelled when what it waits for ends just then."""
    monkeypatch.setattr(follower, "_RETRY_S", 0.0)
    for turns in [*range(40)] * 5:
        task = asyncio.create_task(Follower("127.0.0.1", 1, Ear()).run())
        for _ in range(turns):
            await asyncio.sleep(0.0)
        task.cancel()
        done, _ = await asyncio.wait([task], timeout=20.0)
        assert task in done
        assert task.cancelled()


async def test_a_class_of_a_newer_daemon_is_passed_over_and_a_line_stays_one_line() -> None:
    status = (
        b'{"class":"STATUS",\r"release":"9","uptime_s":1.0,"frames":1,"heave":{},"devices":[],"clients":1,"dropped":0,'
        b'"quality":{"heave":"valid","laser":"off","correction":"off"},"tomorrow":{"of":"unknown use"}}\r\n'
    )
    async with saying(VERSION + b'{"class":"TOMORROW"}\n' + status) as port, following("127.0.0.1", port) as ear:
        await ear.until(lambda: ear.heard)
        _, line, _ = ear.heard[0]
        assert b"\r" not in line
        assert json.loads(line)["tomorrow"] == {"of": "unknown use"}
        assert ear.links[-1].is_up


def test_what_was_held_up_is_as_old_as_it_is() -> None:
    clock = DaemonClock()
    for step in range(100):  # The daemon's clock is 1000 s behind ours, each line 3 ms old when sent, 1 ms on its way.
        assert clock.offset_s(motion(step * 0.05, 0.003), 1000.004 + step * 0.05) == pytest.approx(1000.001)
    for late_s in (0.5, 2.0, 5.0):
        assert clock.offset_s(motion(5.0, 0.003), 1005.004 + late_s) == pytest.approx(1000.001)


@pytest.mark.parametrize("drift", [5e-5, -5e-5])
def test_clocks_that_part_are_followed(drift: float) -> None:
    clock = DaemonClock()
    errors_s = []
    for step in range(0, 24 * 3600 * 4, 7):
        mono_s = step * 0.25
        ours_s = mono_s * (1.0 + drift) + 77.0
        errors_s.append(clock.offset_s(motion(mono_s), ours_s) - (ours_s - mono_s))
    assert max(map(abs, errors_s)) < 2 * 30.0 * 5e-5 + 1e-3  # In a day they part by 4 s.
