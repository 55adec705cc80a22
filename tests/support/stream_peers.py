"""Frames to publish, a publisher that listens on loopback, and clients of it."""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import pytest

from heaved.outputs.records import DeviceStatus, HeaveStatus, StatusRecord
from heaved.outputs.stream import Publisher
from heaved.samples import (
    CorrectionState,
    HeaveForecast,
    HeaveState,
    LaserState,
    MotionFrame,
    Quality,
    RockPrediction,
)


class Counts:
    """Counts what the publisher counts for monitoring."""

    def __init__(self) -> None:
        self.clients = 0
        self.sent = 0
        self.dropped: Counter[str] = Counter()
        self.errors: Counter[str] = Counter()

    def set_clients(self, clients: int) -> None:
        self.clients = clients

    def count_sent(self, frames: int) -> None:
        self.sent += frames

    def count_dropped(self, reason: str) -> None:
        self.dropped[reason] += 1

    def count_client_error(self, reason: str) -> None:
        self.errors[reason] += 1


class Clock:
    """A monotonic clock that stands still until it is set."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def make_frame(t_s: float, heave: HeaveState = HeaveState.VALID) -> MotionFrame:
    """A frame of usual size: seven rock horizons, four heave forecasts."""
    return MotionFrame(
        t_s=t_s,
        quality=Quality(heave=heave, laser=LaserState.VALID, correction=CorrectionState.ACTIVE),
        heave_m=1.25,
        heave_std_m=0.02,
        heave_velocity_mps=-0.5,
        roll_rad=0.1,
        pitch_rad=-0.05,
        rock=tuple(
            RockPrediction(horizon_s=h, roll_rad=0.1, pitch_rad=-0.05, roll_std_rad=0.001, pitch_std_rad=0.001)
            for h in (0.05, 0.1, 0.15, 0.5, 1.0, 2.0, 5.0)
        ),
        forecast=tuple(HeaveForecast(horizon_s=h, heave_m=1.0, std_m=0.1) for h in (0.5, 1.0, 2.0, 5.0)),
    )


def make_status(**changes: Any) -> StatusRecord:
    fields: dict[str, Any] = {
        "release": "1.2.3",
        "uptime_s": 60.0,
        "frames": 6000,
        "rate_hz": 100.0,
        "heave": HeaveStatus(heave_m=1.25, heave_std_m=0.02, age_s=0.002),
        "quality": Quality(
            heave=HeaveState.VALID, laser=LaserState.VALID, correction=CorrectionState.ACTIVE, reasons=()
        ),
        "devices": (DeviceStatus(name="imu", role="imu", up=True, rate_hz=99.5, results={"none": 6000, "crc": 2}),),
        "clients": 1,
        "dropped": 0,
    }
    return StatusRecord(**{**fields, **changes})


class Served:
    """A publisher that listens, with its counts and its clock."""

    def __init__(self, publisher: Publisher, counts: Counts, clock: Clock, host: str, port: int) -> None:
        self.publisher, self.counts, self.clock, self.host, self.port = publisher, counts, clock, host, port

    def publish(self, count: int = 1, period_s: float = 0.01) -> None:
        """Publish frames whose times follow the clock, which goes on with them."""
        for _ in range(count):
            self.clock.now_s += period_s
            self.publisher.publish(make_frame(self.clock.now_s))


class Peer:
    """A client of the stream that reads what it is sent, one record at a time."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def record(self) -> dict[str, Any]:
        line = await self.reader.readline()
        assert line.endswith(b"\n"), f"no whole line: {line!r}"
        return dict(json.loads(line))

    async def records(self, count: int) -> list[dict[str, Any]]:
        return [await self.record() for _ in range(count)]

    async def rest(self) -> list[dict[str, Any]]:
        """Everything until the other side closes."""
        return [json.loads(line) for line in (await self.reader.read()).splitlines()]

    async def ask(self, *lines: str) -> None:
        self.writer.write("".join(f"{line}\n" for line in lines).encode())
        await self.writer.drain()

    async def settle(self) -> list[dict[str, Any]]:
        """What comes until the daemon has dealt with all that was asked before."""
        await self.ask("?VERSION")
        seen: list[dict[str, Any]] = []
        while not seen or seen[-1]["class"] != "VERSION":
            seen.append(await self.record())
        return seen[:-1]

    async def close(self) -> None:
        self.writer.transport.abort()


Serve = Callable[..., Awaitable[Served]]
Connect = Callable[[Served], Awaitable[Peer]]


@pytest.fixture
async def serve() -> AsyncIterator[Serve]:
    """Starts publishers: ``await serve(max_clients=2)``; closes them at the end."""
    started: list[Publisher] = []

    async def start(**changes: Any) -> Served:
        counts, clock = Counts(), Clock()
        options: dict[str, Any] = {
            "host": "127.0.0.1",
            "port": 0,
            "max_clients": 64,
            "queue_frames": 256,
            "allow": (),
            "version": "1.2.3",
            "status": make_status,
            "metrics": counts,
            "utc_s": lambda t_s: 1.7e9 + t_s,
            "clock": clock,
        }
        publisher = Publisher(**{**options, **changes})
        started.append(publisher)
        return Served(publisher, counts, publisher.clock, *await publisher.start())  # type: ignore[arg-type]

    yield start
    for publisher in started:
        await publisher.close(drain_s=0.0)


@pytest.fixture
async def connect() -> AsyncIterator[Connect]:
    """Connects peers that have read their VERSION."""
    peers: list[Peer] = []

    async def open_peer(served: Served) -> Peer:
        peer = Peer(*await asyncio.open_connection(served.host, served.port, limit=1 << 22))
        peers.append(peer)
        assert (await peer.record())["class"] in ("VERSION", "ERROR")
        return peer

    yield open_peer
    for peer in peers:
        await peer.close()
