"""A daemon and its simulated plant within one test, on ephemeral loopback ports."""

from __future__ import annotations

import asyncio
import itertools
import statistics
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

import msgspec

from heaved.config import Config, HttpParams, StateParams, StreamParams
from heaved.config.read import data_directory, load
from heaved.daemon.daemon import Daemon
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.params import SeaParams
from heaved.estimation.heave.saved_state import SavedState
from heaved.estimation.heave.sea.model import SeaModel
from heaved.outputs import wire
from heaved.simulate.instruments import Instruments
from heaved.simulate.plant import SimulatedPlant
from heaved.simulate.seaway import seaway

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from pathlib import Path

    from heaved.simulate.vessel import MotionSource

Record = dict[str, Any]
"""One record of the stream."""

SWELL = SeaModel(stages=7, frequency_hz=(0.2,), damping=(0.3,), level_m2phz=(4.0,), noise_psd=4e-6, bias_walk_psd=9e-10)
"""Broad about 5 s, of the size that the default sea observer takes: what an earlier run may have left behind."""
PATIENCE_S = 20.0
"""For what normally takes a fraction of a second, on a machine that has other things to do."""


# For each observer: [heave], what it may have learned with it, and [heave] which that does not fit.
HARMONIC = heave.Params(observer="harmonic"), SavedState(frequencies_hz=(0.0987,)), {"components": 2}
SEA = heave.Params(), SavedState(sea=SWELL), {"sea": SeaParams(stages=4)}


def demo_config(directory: Path, **changes: Any) -> Config:
    """The demo's devices; ephemeral ports; the state in ``directory``; no trainer unless ``changes`` say so."""
    config = load(data_directory() / "sensors.toml")
    defaults = {
        "stream": StreamParams(port=0),
        "http": HttpParams(port=0),
        "state": StateParams(directory=str(directory / "state")),
        "correction": msgspec.structs.replace(config.correction, enabled=False),
    }
    return msgspec.structs.replace(config, **(defaults | changes))


@asynccontextmanager
async def plant_of(
    config: Config, *, sea: str | MotionSource = "T2", seed: int = 1
) -> AsyncIterator[tuple[SimulatedPlant, Config]]:
    """Simulated slaves for the devices of ``config``: (plant, ``config`` with the links where they are).

    ``sea``: a name, or what moves the ship.
    """
    moves = seaway(sea, seed) if isinstance(sea, str) else sea
    plant = SimulatedPlant(config.device, Instruments(moves, seed=seed), any_port=True, seed=seed)
    await plant.start()
    try:
        yield plant, msgspec.structs.replace(config, device=plant.devices)
    finally:
        await plant.stop()


@asynccontextmanager
async def running(config: Config, *args: Any, **kwargs: Any) -> AsyncIterator[Daemon]:
    daemon = Daemon(config, *args, **kwargs)
    await daemon.start()
    try:
        yield daemon
    finally:
        await daemon.stop()


@asynccontextmanager
async def stream_of(daemon: Daemon) -> AsyncIterator[AsyncIterator[Record]]:
    """The records of the daemon's stream, VERSION first."""
    reader, writer = await asyncio.open_connection(*daemon.addresses["stream"])

    async def records() -> AsyncIterator[Record]:
        while line := await reader.readline():
            yield wire.decode(line)

    try:
        yield records()
    finally:
        writer.close()


async def frames_of(daemon: Daemon, count: int) -> list[Record]:
    """The next ``count`` MOTION records."""
    frames = []
    async with asyncio.timeout(PATIENCE_S), stream_of(daemon) as records:
        async for record in records:
            if record["class"] == "MOTION":
                frames.append(record)
            if len(frames) == count:
                return frames
    raise AssertionError("the stream has ended")


def median_period_s(frames: list[Record]) -> float:
    """Between times of validity. Half of them must be right: a busy machine makes some frames late or skips them."""
    times_s = [float(frame["mono_s"]) for frame in frames]
    return statistics.median(after - before for before, after in itertools.pairwise(times_s))


async def until(daemon: Daemon, condition: Callable[[Record], object]) -> Record:
    """Follow the stream until ``condition(MOTION record)`` holds; returns that record."""
    async with asyncio.timeout(PATIENCE_S), stream_of(daemon) as records:
        async for record in records:
            if record["class"] == "MOTION" and condition(record):
                return record
    raise AssertionError("the stream has ended")


async def get(daemon: Daemon, path: str) -> tuple[int, str]:
    """(status, body) of a GET on the HTTP server."""
    reader, writer = await asyncio.open_connection(*daemon.addresses["http"])
    writer.write(f"GET {path} HTTP/1.1\r\nHost: test\r\nConnection: close\r\n\r\n".encode())
    answer = await asyncio.wait_for(reader.read(), PATIENCE_S)
    writer.close()
    head, _, body = answer.partition(b"\r\n\r\n")
    return int(head.split()[1]), body.decode()


def metric(daemon: Daemon, name: str) -> float:
    """Sum over the samples whose name and labels begin with ``name``."""
    lines = daemon.metrics.render().decode().splitlines()
    return sum(float(line.split()[-1]) for line in lines if line.startswith(name))
