"""Starts publishers and clients, on loopback and on ports that the system chooses, and ends them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest
from stream_peers import Clock, Connect, Counts, Peer, Serve, Served, make_status

from heaved.outputs.stream import Publisher


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
