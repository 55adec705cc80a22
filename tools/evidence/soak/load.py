"""What is put on a daemon: clients of its stream, quick and slow, and whoever takes what its outputs say. Processes of
their own, started and ended with the measurement.
"""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

from heaved.config.read import data_directory, load
from heaved.simulate.instruments import Instruments
from heaved.simulate.plant import SimulatedPlant
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import SENSORS

if TYPE_CHECKING:
    from collections.abc import Callable
    from multiprocessing.connection import Connection

TELEGRAMS: Final = {
    "tss1": 25.0, "em1000": 50.0, "em3000": 50.0, "smc_hex": 50.0, "kmb": 50.0, "pashr": 50.0, "psxn": 50.0,
    "prdid": 50.0, "xdr": 50.0, "pnorsub2": 50.0, "pnorsub7b": 50.0,
}  # fmt: skip
"""All there are, and how often each goes out."""
SLOW_BYTES_PER_S: Final = 2000.0
"""What a slow client takes: a line or so a second."""
PLC_PERIOD_S: Final = 0.05
_PATIENCE_S: Final = 30.0


class _Quality(msgspec.Struct):
    heave: str


class _Line(msgspec.Struct):
    """What is needed of a MOTION line."""

    seq: int
    mono_s: float
    quality: _Quality


class Heard(msgspec.Struct, frozen=True):
    """What the quick clients got between two questions, all together.

    Percentiles in ms, of the age at the client: 50, 99, 99.9 and the highest.
    """

    frames: int
    """A client, on the average."""
    lost: int
    ages_ms: tuple[float, float, float, float]
    valid: float
    """Share of the frames."""
    seconds: float


def leave_signals_to_the_tool() -> None:
    """Ctrl-C goes to all processes of a terminal: the tool ends, and ends us."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def serve_plant(sea: str, rate_hz: float, pipe: Connection, bandwidth_hz: float | None = None) -> None:
    """The simulated slaves of ``config/sensors.toml``, the IMU at ``rate_hz``: says their links. ``bandwidth_hz``: of a
    sensor that is late by more than a lead can take out, so that a network has something to learn.
    """
    leave_signals_to_the_tool()

    async def run() -> None:
        devices = tuple(
            msgspec.structs.replace(device, rate_hz=rate_hz) if device.role == "imu" else device
            for device in load(data_directory() / "sensors.toml").device
        )
        sensor = "A" if bandwidth_hz is None else msgspec.structs.replace(SENSORS["B"], bandwidth_hz=bandwidth_hz)
        plant = SimulatedPlant(devices, Instruments(seaway(sea, 1), sensor=sensor, seed=1), any_port=True)
        await plant.start()
        pipe.send([(device.name, device.link) for device in plant.devices])
        await asyncio.to_thread(pipe.poll, None)
        await plant.stop()

    asyncio.run(run())


class _Quick:
    """Clients that keep the ages of what reaches them."""

    def __init__(self) -> None:
        self.ages_s: list[float] = []
        self.lost = self.valid = 0
        self._decoder = msgspec.json.Decoder(_Line)

    async def follow(self, host: str, port: int) -> None:
        """One of them, until cancelled; a connection that ends is made anew, and what was missed is lost."""
        last = 0
        while True:
            with suppress(OSError, asyncio.IncompleteReadError, ValueError):
                reader, writer = await asyncio.open_connection(host, port, limit=1 << 18)
                while line := await reader.readline():
                    now_s = time.monotonic()
                    if not line.startswith(b'{"class":"MOTION"'):
                        continue
                    said = self._decoder.decode(line)
                    self.ages_s.append(now_s - said.mono_s)
                    self.lost += max(0, said.seq - last - 1) if last else 0
                    self.valid += said.quality.heave == "valid"
                    last = said.seq
                writer.close()
            await asyncio.sleep(0.2)

    def heard(self, clients: int, seconds: float) -> Heard:
        """Since the last call."""
        ages_ms = 1e3 * np.array(self.ages_s or [float("nan")])
        shares = np.percentile(ages_ms, (50.0, 99.0, 99.9, 100.0))
        number = len(self.ages_s)
        found = Heard(
            frames=round(number / clients),
            lost=self.lost,
            ages_ms=(float(shares[0]), float(shares[1]), float(shares[2]), float(shares[3])),
            valid=self.valid / number if number else 0.0,
            seconds=seconds,
        )
        self.ages_s.clear()
        self.lost = self.valid = 0
        return found


class _Taking(asyncio.Protocol):
    """A client that takes all and looks at nothing: what it would cost to look is not the daemon's."""

    def __init__(self) -> None:
        self.gone = asyncio.get_running_loop().create_future()

    def connection_lost(self, _error: Exception | None) -> None:
        self.gone.set_result(None)


async def _take(host: str, port: int) -> None:
    while True:
        with suppress(OSError):
            _, client = await asyncio.get_running_loop().create_connection(_Taking, host, port)
            await client.gone
        await asyncio.sleep(0.2)


async def _dawdle(host: str, port: int) -> None:
    """A client that takes :data:`SLOW_BYTES_PER_S`; one that is disconnected comes again."""
    while True:
        with suppress(OSError):
            reader, writer = await asyncio.open_connection(host, port, limit=1024)
            writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            while await reader.read(int(SLOW_BYTES_PER_S / 4.0)):  # noqa: ASYNC110  # It is no waiting: it is slow.
                await asyncio.sleep(0.25)
            writer.close()
        await asyncio.sleep(0.5)


def listen(host: str, port: int, quick: int, slow: int, taking: int, pipe: Connection) -> None:
    """Clients of the stream: ``quick`` that look at each line, ``slow`` ones, and ``taking`` that take all. Answers
    each question with a :class:`Heard`, of those that look, and ends with the pipe.
    """
    leave_signals_to_the_tool()

    async def run() -> None:
        clients = _Quick()
        tasks = [asyncio.create_task(clients.follow(host, port)) for _ in range(quick)]
        tasks += [asyncio.create_task(_dawdle(host, port)) for _ in range(slow)]
        tasks += [asyncio.create_task(_take(host, port)) for _ in range(taking)]
        since_s = time.monotonic()
        with suppress(EOFError):
            while await asyncio.to_thread(pipe.recv):
                now_s = time.monotonic()
                pipe.send(clients.heard(quick, now_s - since_s))
                since_s = now_s
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)

    asyncio.run(run())


def consume(pipe: Connection) -> None:
    """Whoever takes telegrams and lines for a database: a UDP port and a TCP port; says both."""
    leave_signals_to_the_tool()

    async def run() -> None:
        loop = asyncio.get_running_loop()

        async def take(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            while await reader.read(65536):
                pass
            writer.close()

        udp, _ = await loop.create_datagram_endpoint(asyncio.DatagramProtocol, local_addr=("127.0.0.1", 0))
        server = await asyncio.start_server(take, "127.0.0.1", 0)
        pipe.send((udp.get_extra_info("sockname")[1], server.sockets[0].getsockname()[1]))
        await asyncio.to_thread(pipe.poll, None)
        udp.close()
        server.close()

    asyncio.run(run())


def read_registers(port: int, pipe: Connection) -> None:
    """A PLC that reads the common map 20 times a second."""
    leave_signals_to_the_tool()
    request = bytes.fromhex("000100000006010300030006")
    while not pipe.poll():
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), 5.0) as plc:
            due_s = time.monotonic()
            while not pipe.poll(max(0.0, due_s - time.monotonic())):
                plc.sendall(request)
                if not plc.recv(256):
                    break
                due_s += PLC_PERIOD_S
        time.sleep(0.1)


def watch_page(port: int, pipe: Connection) -> None:
    """A browser that has the page open."""
    leave_signals_to_the_tool()
    until_s = time.monotonic() + _PATIENCE_S
    while not pipe.poll():
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), 5.0) as browser:
            browser.settimeout(1.0)
            browser.sendall(b"GET /events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            while not pipe.poll():
                with suppress(TimeoutError):
                    if not browser.recv(65536):
                        break
            until_s = time.monotonic() + _PATIENCE_S
        if time.monotonic() > until_s:
            raise SystemExit("the page cannot be reached")
        time.sleep(0.2)


def tables(udp: int, tcp: int, registers: int, broker: int = 0) -> str:
    """The daemon's configuration of all outputs. ``broker``: port of an MQTT broker, 0: none."""
    made = [
        f'[[output]]\nname = "{name}"\ntelegram = "{name}"\nrate_hz = {rate_hz}\n'
        f'link = "{f"udp://127.0.0.1:{udp}" if i % 2 else f"tcp://127.0.0.1:{tcp}"}"\n'
        for i, (name, rate_hz) in enumerate(TELEGRAMS.items())
    ]
    made += [
        f'[registers]\nenabled = true\nlink = "tcp://127.0.0.1:{registers}"\n',
        f'[influx]\nenabled = true\nlink = "udp://127.0.0.1:{udp}"\nrate_hz = 10.0\n',
        "[recording]\nenabled = true\n",
        '[[point]]\nname = "tip"\nforward_m = 12.0\nport_m = -8.5\nup_m = 30.0\n',
        '[[point]]\nname = "deck"\nforward_m = -20.0\nport_m = 4.0\nup_m = 1.0\n',
        '[quiet]\nenabled = true\npoint = "tip"\n',
    ]
    if broker:
        made.append(f'[mqtt]\nenabled = true\nlink = "mqtt://127.0.0.1:{broker}"\n')
    return "".join(made)


def count_for_ever(core: int, pipe: Connection) -> None:
    """Another program that wants all of a core."""
    leave_signals_to_the_tool()
    os.sched_setaffinity(0, {core})
    number = 0
    while number % 1_000_000 or not pipe.poll():
        number += 1


def as_if_elsewhere(target: Callable[..., None], *arguments: object) -> None:
    """``target`` at a priority that no program of this machine disturbs, where that is allowed."""
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    target(*arguments)
