"""Simulated sensors for ``heaved sim``, and the whole chain on one machine for ``heaved demo``."""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import contextmanager
from importlib.util import find_spec
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.config.read import data_directory, load
from heaved.daemon import daemon
from heaved.demo import hook
from heaved.demo.craft_at_sea import voyages
from heaved.devices.profile import DeviceSpec
from heaved.estimation.craft.dynamics import Vessel
from heaved.networks import is_loopback_host
from heaved.outputs.telegrams.formats import FORMATS
from heaved.page.server import PageError, PageServer
from heaved.page.server import serve as serve_page
from heaved.simulate.gauge import AT_THE_IMU, Gauge
from heaved.simulate.hydrofoil import Passage
from heaved.simulate.instruments import Instruments
from heaved.simulate.mounted import Mounted
from heaved.simulate.plant import SimulatedPlant
from heaved.simulate.seaway import seaway
from heaved.simulate.shaking import NONE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from multiprocessing.connection import Connection

    from heaved.config import Config
    from heaved.simulate.faults import PlannedFault
    from heaved.simulate.mru import MruModel
    from heaved.simulate.slave import Source

SERIAL_BAUDRATE: Final = 230_400
"""Of the simulated serial line: it carries the demo's IMU at 100 Hz and its laser at 20 Hz with a third to spare."""
SEED: Final = 1
"""Of the sea and of the sensors' errors."""
_MQTT_PORT: Final = 1883
_PAGE_HOST: Final = "127.0.0.1"
_PAGE_PORT: Final = 8570
_CHILD_STOPS_S: Final = 2.0


class _Served(msgspec.Struct, frozen=True):
    """What the process of the sensors says once it serves them."""

    devices: tuple[DeviceSpec, ...]
    """With the links at which they are reached."""
    epoch_s: float
    """Time 0 of the sea on the machine's monotonic clock."""


class DemoError(Exception):
    """The simulated sensors cannot be served; the message says why."""


def demo_config() -> Config:
    """The packaged ``demo.toml``."""
    return load(data_directory() / "demo.toml")


def on_serial_line(devices: Sequence[DeviceSpec], directory: Path) -> tuple[DeviceSpec, ...]:
    """The devices on one simulated serial line, a pseudo-terminal that appears as ``directory/bus``; those that
    speak by themselves stay where they are.
    """
    link = f"rtu://{directory}/bus?baudrate={SERIAL_BAUDRATE}"
    return tuple(msgspec.structs.replace(device, link=link) if device.is_asked else device for device in devices)


def how_to_look(config: Config) -> list[str]:
    """At each output beside the stream: a line for people, with the command that shows it."""
    lines = []
    for output in config.output:
        _, _, address = output.link.partition("tcp-listen://")
        host, _, port = address.rpartition(":")
        of = output.point or "the IMU"
        look = f"nc {host} {port}" if host else output.link
        lines.append(f"{FORMATS[output.telegram].title} of {of}, {output.rate_hz:g} Hz: {look}")
    registers = config.registers
    if registers.enabled and registers.link.startswith("tcp://"):
        host, _, port = registers.link.removeprefix("tcp://").rpartition(":")
        asked = f"mbpoll -0 -r {registers.start} -c 7 -t 4 -a {registers.device_id} -p {port} {host}"
        lines.append(f"registers for a PLC (heave mm, mm/s, mm/s2, roll, pitch, counter, quality): {asked}")
    if config.mqtt.enabled:
        _, _, port = config.mqtt.link.rpartition(":")
        lines.append(f"MQTT: mosquitto_sub -p {port} -v -t '{config.mqtt.topic}/#'")
    return lines


def instruments(
    sea: str,
    devices: Sequence[DeviceSpec] = (),
    *,
    sensor: str = "A",
    laser: str = "on",
    gauge: Gauge = AT_THE_IMU,
    shake: str = NONE,
    seed: int = SEED,
    mru: MruModel | None = None,
) -> Instruments:
    """Sensors in a sea, shaken by what that name says. With sensors of a craft among the ``devices``, the default craft
    makes a voyage of its own.

    Raises:
        ValueError: there is no such sea, sensor, laser pattern or shake; the message names those that there are.
    """
    at_sea = any(device.role in ("craft", "heave_sensor", "pitch_sensor") for device in devices)
    voyage = voyages(Vessel(), [seed], Passage())[0] if at_sea else None
    return Instruments(
        seaway(sea, seed), sensor=sensor, laser=laser, gauge=gauge, shake=shake, seed=seed, voyage=voyage, mru=mru
    )


def serve(
    devices: Sequence[DeviceSpec],
    source: Source,
    faults: Sequence[PlannedFault],
    *,
    seed: int,
    ready: Callable[[tuple[DeviceSpec, ...]], None],
) -> None:
    """Serve simulated devices until SIGINT or SIGTERM; ``ready`` is told where.

    Raises:
        ValueError: the devices or faults do not go together.
        OSError: a port or path cannot be had.
    """

    async def run() -> None:
        stop = asyncio.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        plant = SimulatedPlant(devices, source, faults=faults, seed=seed)
        await plant.start()
        ready(plant.devices)
        await stop.wait()
        await plant.stop()

    asyncio.run(run())


def run(
    sea: str,
    *,
    serial: bool,
    duration_s: float | None,
    log_format: str,
    announce: Callable[[Config], None],
    config: Config | None = None,
    shake: str = NONE,
) -> int:
    """Serve the sensors of ``config``, by default ``demo.toml``, in a process of their own and run the daemon on them;
    returns its exit code. ``shake`` names what shakes them.

    A third process serves the page, and a fourth is a consumer: a simulated winch on the stream, which says on standard
    output now and then how the hook below it moves. Without a ``config``, and where there is a mosquitto on this
    machine, another is its broker.

    What is learned goes to a temporary directory. Ports of the default configuration that are taken are replaced by
    free ones; ``announce`` is told the configuration just before the daemon starts.

    Raises:
        DemoError: the sensors cannot be simulated.
    """
    # Until the daemon has its own handler, and after it, a signal still leaves nothing behind.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    with tempfile.TemporaryDirectory(prefix="heaved-demo-") as name:
        directory = Path(name)
        is_own, config = config is None, config or demo_config()
        wanted = on_serial_line(config.device, directory) if serial else config.device
        with _sensors(wanted, sea, shake) as served, _broker(directory, wanted=is_own) as broker:
            config = msgspec.structs.replace(
                config,
                device=served.devices,
                stream=msgspec.structs.replace(config.stream, port=_free_port(config.stream.host, config.stream.port)),
                http=msgspec.structs.replace(config.http, port=_free_port(config.http.host, config.http.port)),
                output=tuple(msgspec.structs.replace(one, link=_free_link(one.link)) for one in config.output),
                registers=msgspec.structs.replace(config.registers, link=_free_link(config.registers.link)),
                mqtt=msgspec.structs.replace(config.mqtt, enabled=bool(broker), link=broker) if is_own else config.mqtt,
                state=msgspec.structs.replace(config.state, directory=str(directory / "state")),
            )
            announce(config)
            # The daemon ends by signal, whoever wants it to end.
            end = threading.Timer(duration_s or 0.0, os.kill, (os.getpid(), signal.SIGTERM))
            end.daemon = True
            if duration_s is not None:
                end.start()
            try:
                heaves = any(device.role == "imu" for device in config.device)
                stream = config.stream.host, config.stream.port
                winch = _child(_winch_process, *stream, sea, served.epoch_s)
                page = _child(_page_process, *stream, _free_port(_PAGE_HOST, _PAGE_PORT), log_format)
                with winch if heaves else contextlib.nullcontext(), page:
                    return daemon.run(config, None, log_format=log_format)
            finally:
                end.cancel()


@contextmanager
def _child(target: Callable[..., None], *arguments: object) -> Iterator[Connection]:
    """A process that runs ``target(far end of a connection, *arguments)``.

    It shall end when the connection is closed, so also when this process is killed.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    child = context.Process(target=target, args=(theirs, *arguments), daemon=True)
    # Ctrl-C reaches the whole group; the parent decides the order. The child has it blocked from its first instruction
    # (which the start of multiprocessing's own helper, with the first child, would undo).
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
    try:
        child.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    theirs.close()
    try:
        yield ours
    finally:
        ours.close()
        child.join(_CHILD_STOPS_S)
        if child.is_alive():
            child.kill()
            child.join()


@contextmanager
def _sensors(devices: Sequence[DeviceSpec], sea: str, shake: str) -> Iterator[_Served]:
    """The devices, served by another process as a real sensor is by another machine."""
    with _child(_sensor_process, tuple(devices), sea, shake) as connection:
        try:
            answer = connection.recv()
        except EOFError:
            answer = "the process of the simulated sensors ended at once"
        if isinstance(answer, str):
            raise DemoError(answer)
        yield answer


def _sensor_process(connection: Connection, devices: tuple[DeviceSpec, ...], sea: str, shake: str) -> None:
    async def run() -> None:
        closed = asyncio.Event()
        asyncio.get_running_loop().add_reader(connection.fileno(), closed.set)
        plant = SimulatedPlant(devices, Mounted(instruments(sea, devices, shake=shake), {}), any_port=True)
        await plant.start()
        connection.send(_Served(plant.devices, time.monotonic() - plant.time_s()))
        await closed.wait()
        await plant.stop()

    try:
        asyncio.run(run())
    except (OSError, ValueError) as error:
        with contextlib.suppress(BrokenPipeError):  # Whoever wanted to know has gone.
            connection.send(str(error))


def _winch_process(connection: Connection, host: str, port: int, sea: str, epoch_s: float) -> None:
    # Whoever reads the demo's output may have gone: no reason to say more, nor to complain.
    with contextlib.suppress(BrokenPipeError):
        hook.follow(host, port, seaway(sea, SEED), epoch_s, _say, connection.poll)


def _page_process(connection: Connection, host: str, port: int, page_port: int, log_format: str) -> None:
    daemon.configure_logging(log_format)

    async def run() -> None:
        ended = asyncio.Event()
        asyncio.get_running_loop().add_reader(connection.fileno(), ended.set)
        page = PageServer(host=_PAGE_HOST, port=page_port, allow=(), stream_host=host, stream_port=port)
        try:
            await serve_page(page, lambda url: _say(f"in a browser: {url}"), ended)
        except PageError as error:  # Somebody was quicker: the rest of the demo does not need it.
            _say(f"no page: {error}")

    with contextlib.suppress(BrokenPipeError):
        asyncio.run(run())


def _say(line: str) -> None:
    os.write(sys.stdout.fileno(), f"{line}\n".encode())  # Whole or not at all, beside what the daemon prints.


@contextmanager
def _broker(directory: Path, *, wanted: bool) -> Iterator[str]:
    """A broker on loopback, and its link; empty: it is not wanted, or there is none on this machine."""
    program = shutil.which("mosquitto", path=f"{os.environ.get('PATH', os.defpath)}{os.pathsep}/usr/sbin")
    if not wanted or program is None or find_spec("aiomqtt") is None:
        yield ""
        return
    host, port = "127.0.0.1", _free_port("127.0.0.1", _MQTT_PORT)
    file = directory / "mosquitto.conf"
    file.write_text(f"listener {port} {host}\nallow_anonymous true\n", encoding="utf-8")
    quiet = subprocess.DEVNULL
    # Not of the terminal's group: Ctrl-C is for the daemon, which says good-bye to its broker.
    broker = subprocess.Popen([program, "-c", str(file)], stdout=quiet, stderr=quiet, start_new_session=True)  # noqa: S603
    try:
        yield f"mqtt://{host}:{port}"
    finally:
        broker.terminate()
        broker.wait()


def _free_link(text: str) -> str:
    """The same link with a port that is free, if it is one at which we listen."""
    scheme, _, address = text.partition("://")
    host, _, port = address.rpartition(":")
    if scheme not in ("tcp-listen", "tcp") or not is_loopback_host(host):
        return text
    return f"{scheme}://{host}:{_free_port(host, int(port))}"


def _free_port(host: str, port: int) -> int:
    """``port`` if it can be had, else one that can."""
    for candidate in (port, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, candidate))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise DemoError(f"no port can be had on {host}")
