"""The client side, against a publisher and against everything that is none."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from typing import TYPE_CHECKING

import pytest
from stream_peers import Connect, Serve, make_frame, make_status

from heaved.client.stream_client import Trouble, UnreachableError, fetch_status, is_ready, wait_until_ready
from heaved.outputs import wire
from heaved.outputs.records import MotionRecord, VersionRecord
from heaved.samples import CorrectionState, HeaveState, LaserState, Quality

if TYPE_CHECKING:
    from heaved.outputs.stream import Publisher

Play = Callable[[Callable[[socket.socket], None]], int]

VERSION = wire.encode_record(VersionRecord(release="9"))
STATUS = wire.encode_record(make_status())


@pytest.fixture
def play() -> Iterator[Play]:
    """Starts servers that do to each connection what they are told; returns their port."""
    listeners: list[socket.socket] = []
    threads: list[threading.Thread] = []
    connections: list[socket.socket] = []

    def serve(listener: socket.socket, behave: Callable[[socket.socket], None]) -> None:
        with contextlib.suppress(OSError):  # The listener is shut down at the end of the test.
            while True:
                connection, _ = listener.accept()
                connections.append(connection)
                with contextlib.suppress(OSError):
                    behave(connection)

    def start(behave: Callable[[socket.socket], None]) -> int:
        listener = socket.create_server(("127.0.0.1", 0))
        listeners.append(listener)
        threads.append(threading.Thread(target=serve, args=(listener, behave)))
        threads[-1].start()
        return int(listener.getsockname()[1])

    yield start
    for listener in listeners:
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()
    for connection in connections:
        connection.close()
    for thread in threads:
        thread.join()


def refused_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


def endless(piece: bytes) -> Callable[[socket.socket], None]:
    def behave(connection: socket.socket) -> None:
        while True:
            connection.sendall(piece)

    return behave


@contextlib.asynccontextmanager
async def frames(publisher: Publisher, heave: HeaveState = HeaveState.VALID) -> AsyncIterator[None]:
    """Publishes until left."""

    async def publish() -> None:
        while True:
            publisher.publish(make_frame(publisher.clock(), heave))
            await asyncio.sleep(0.005)

    task = asyncio.create_task(publish())
    yield
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task


async def test_status_of_a_daemon(serve: Serve) -> None:
    served = await serve(status=lambda: make_status(frames=321))
    async with frames(served.publisher):
        snapshot = await asyncio.to_thread(fetch_status, served.host, served.port, 10.0)
    assert snapshot.version == VersionRecord(release="1.2.3")
    assert snapshot.status == make_status(frames=321)
    assert snapshot.motion is not None
    assert (snapshot.motion.heave_m, snapshot.motion.quality.heave) == (1.25, HeaveState.VALID)
    assert len(snapshot.motion.rock) == 7


async def test_status_when_no_frame_flows(serve: Serve) -> None:
    served = await serve()
    snapshot = await asyncio.to_thread(fetch_status, served.host, served.port, 1.0)
    assert snapshot.status == make_status()
    assert snapshot.motion is None


async def test_status_when_there_is_no_room(serve: Serve, connect: Connect) -> None:
    served = await serve(max_clients=1)
    await connect(served)
    with pytest.raises(UnreachableError, match="no more are served") as raised:
        await asyncio.to_thread(fetch_status, served.host, served.port, 10.0)
    assert raised.value.trouble is Trouble.TURNED_AWAY


@pytest.mark.parametrize(
    ("behave", "trouble", "said"),
    [
        (lambda _connection: None, Trouble.SILENT, "nothing is said"),
        (lambda connection: connection.sendall(VERSION), Trouble.SILENT, "?STATUS is not answered"),
        (lambda connection: connection.sendall(VERSION[:20]), Trouble.SILENT, "nothing is said"),
        (lambda connection: connection.close(), Trouble.CLOSED, "connection"),
        (lambda connection: connection.sendall(b"220 smtp\r\n"), Trouble.NOT_HEAVED, "220 smtp"),
        (lambda connection: connection.sendall(b"\x00\xff\n"), Trouble.NOT_HEAVED, "not a heaved daemon"),
        (lambda connection: connection.sendall(b'{"a":1}\n'), Trouble.NOT_HEAVED, "no class"),
        (lambda connection: connection.sendall(b'{"class":"VERSION"}\n'), Trouble.NOT_HEAVED, "release"),
        (lambda connection: connection.sendall(STATUS), Trouble.NOT_HEAVED, "no VERSION"),
        (lambda connection: connection.sendall(VERSION + b'{"class":"STATUS"}\n'), Trouble.NOT_HEAVED, "release"),
        (
            lambda connection: connection.sendall(VERSION.replace(b'"proto_major":1', b'"proto_major":2')),
            Trouble.NOT_HEAVED,
            "speaks protocol 2",
        ),
        (endless(b"x" * 4096), Trouble.NOT_HEAVED, "without end"),
    ],
)
def test_status_of_anything_else(
    play: Play, behave: Callable[[socket.socket], None], trouble: Trouble, said: str
) -> None:
    port = play(behave)
    with pytest.raises(UnreachableError) as raised:
        fetch_status("127.0.0.1", port, 0.3 if trouble is Trouble.SILENT else 10.0)
    assert raised.value.trouble is trouble
    assert said in str(raised.value)
    assert f"127.0.0.1:{port}" in str(raised.value)


def test_a_flood_of_other_lines_does_not_hold_status_up(play: Play) -> None:
    def behave(connection: socket.socket) -> None:
        connection.sendall(VERSION)
        endless(b'{"class":"SEA"}\n' * 100)(connection)

    with pytest.raises(UnreachableError, match="not answered"):
        fetch_status("127.0.0.1", play(behave), 0.3)


def test_nobody_listens() -> None:
    port = refused_port()
    message = rf"127\.0\.0\.1:{port}: Connection refused: is heaved running"
    with pytest.raises(UnreachableError, match=message) as raised:
        fetch_status("127.0.0.1", port)
    assert raised.value.trouble is Trouble.REFUSED


@pytest.mark.parametrize(
    "error", [socket.gaierror(socket.EAI_NONAME, "Name or service not known"), UnicodeError("label too long")]
)
def test_no_such_host(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(socket, "getaddrinfo", fail)
    with pytest.raises(UnreachableError, match="crane:5570: no such host") as raised:
        fetch_status("crane", 5570)
    assert raised.value.trouble is Trouble.NO_ADDRESS


@pytest.mark.parametrize(
    ("heave", "heave_m", "age_s", "ready"),
    [
        (HeaveState.VALID, 1.0, 0.002, True),
        (HeaveState.DEGRADED, 1.0, 0.002, True),
        (HeaveState.SETTLING, 1.0, 0.002, False),
        (HeaveState.INVALID, 1.0, 0.002, False),
        (HeaveState.VALID, None, 0.002, False),
        (HeaveState.VALID, 1.0, 1.5, False),
        (HeaveState.VALID, 1.0, None, False),
    ],
)
def test_what_a_compensator_may_start_on(
    heave: HeaveState, heave_m: float | None, age_s: float | None, ready: bool
) -> None:
    quality = Quality(heave=heave, laser=LaserState.OFF, correction=CorrectionState.OFF, reasons=())
    motion = MotionRecord(seq=1, time="", mono_s=0.0, heave_m=heave_m, quality=quality, age_s=age_s)
    assert is_ready(motion) is ready


async def test_wait_goes_on_through_settling_and_a_restart(serve: Serve) -> None:
    served = await serve()
    waiting = asyncio.create_task(asyncio.to_thread(wait_until_ready, served.host, served.port, 60.0))
    async with frames(served.publisher, HeaveState.SETTLING):
        while served.publisher.clients == 0:  # noqa: ASYNC110 - it has no event to wait for
            await asyncio.sleep(0)
    await served.publisher.close(0.0)
    again = await serve(port=served.port)
    assert not waiting.done()
    async with frames(again.publisher, HeaveState.VALID):
        assert await waiting


async def test_wait_ends_without_a_usable_heave(serve: Serve) -> None:
    served = await serve()
    async with frames(served.publisher, HeaveState.INVALID):
        assert not await asyncio.to_thread(wait_until_ready, served.host, served.port, 0.2)


def test_wait_ends_without_a_daemon(play: Play) -> None:
    assert not wait_until_ready("127.0.0.1", refused_port(), 0.05)
    assert not wait_until_ready("127.0.0.1", play(lambda _connection: None), 0.05)
    assert not wait_until_ready("127.0.0.1", play(endless(b"\x00" * 4096)), 0.05)
