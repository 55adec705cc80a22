"""The running daemon, measured from outside: how old a frame is when a client has it, and what the daemon costs.

    python tools/latency.py [--duration 60] [--clients 10] [--sea S4] [--fifo 0]
    python tools/latency.py --compare-training [--duration 60]
    python tools/latency.py --compare-outputs [--duration 60]

Three processes besides this one: simulated slaves (IMU at 100 Hz and laser at 20 Hz, Modbus TCP on loopback), the
daemon (``python -m heaved run``), the clients. Ages compare a frame's time of validity with the client's own monotonic
clock. With ``--compare-training`` the daemon is measured twice: without a trainer, and with one that trains every 5 s.
With ``--compare-outputs`` three times: without any output but the stream; with six telegrams at 50 Hz, registers that a
PLC reads 20 times a second, and MQTT (where there is a mosquitto); and with twenty telegrams, one of which goes to
somebody who never takes anything.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from contextlib import ExitStack, contextmanager
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from evidence import results
from evidence.daemon import running_daemon
from evidence.processes import child, free_port
from evidence.results import Report
from numpy.typing import NDArray

from heaved.config.read import data_directory, load
from heaved.simulate.instruments import Instruments
from heaved.simulate.plant import SimulatedPlant
from heaved.simulate.seaway import seaway

if TYPE_CHECKING:
    from collections.abc import Iterator
    from multiprocessing.connection import Connection

WARM_UP_S = 5.0
SAID = {
    "sent": "messages beside the stream",
    "lost": "lost of them",
    "datagrams": "datagrams taken, since the start",
    "bytes": "bytes taken over TCP, since the start",
    "answers": "answers to the PLC, since the start",
}
TELEGRAMS = ("em1000", "em3000", "pashr", "psxn", "smc_hex", "kmb")
MANY = 20
WIDTH = 33
"""Of a column."""
PLC_PERIOD_S, PLC_ANSWER_BYTES = 0.05, 21
TRAINING_PATIENCE_S = 180.0
"""Until the first training, which needs a minute of laser."""


class Outputs(Enum):
    """What the daemon says beside the stream."""

    NONE = "none"
    USUAL = "six telegrams, registers, MQTT"
    MANY = "twenty telegrams, one black-holed"


class Stamp(msgspec.Struct):
    """What is needed of a MOTION line, and quickly."""

    seq: int
    mono_s: float


class Heard(msgspec.Struct):
    """What one client got within the measured time."""

    ages_s: NDArray[np.float64]
    lost: int


class Row(msgspec.Struct):
    """One measured daemon."""

    name: str
    heard: list[Heard]
    first_frame_s: float
    cpu_percent: float
    rss_mb: float
    workers_rss_mb: float
    lateness: dict[float, float]
    """Poll deadlines met within so many seconds of lateness, as a share of all."""
    trainings: float
    said: dict[str, float]
    """Beside the stream: messages and losses of all outputs meanwhile; what others have taken of them."""


# ---- the processes ---------------------------------------------------------------------------------------------------


def serve_plant(sea: str, pipe: Connection) -> None:
    async def run() -> None:
        devices = load(data_directory() / "sensors.toml").device
        plant = SimulatedPlant(devices, Instruments(seaway(sea, 1), seed=1), any_port=True)
        await plant.start()
        pipe.send([device.link for device in plant.devices])
        await asyncio.to_thread(pipe.poll, None)
        await plant.stop()

    asyncio.run(run())


def listen(host: str, port: int, clients: int, duration_s: float, pipe: Connection) -> None:
    """Clients that keep the ages of the frames that reach them, once all are connected and settled."""
    decoder = msgspec.json.Decoder(Stamp)

    async def connect() -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        reader, writer = await asyncio.open_connection(host, port)
        await reader.readline()
        return reader, writer  # Without its writer a reader is at its end.

    async def follow(reader: asyncio.StreamReader, from_s: float) -> tuple[list[float], list[int]]:
        ages_s, numbers = [], []
        while (now_s := time.monotonic()) < from_s + duration_s:
            line = await reader.readline()
            now_s = time.monotonic()
            if now_s >= from_s:
                stamp = decoder.decode(line)
                ages_s.append(now_s - stamp.mono_s)
                numbers.append(stamp.seq)
        return ages_s, numbers

    async def run() -> None:
        connections = [await connect() for _ in range(clients)]
        from_s = time.monotonic() + WARM_UP_S
        pipe.send(from_s)
        heard = await asyncio.gather(*(follow(reader, from_s) for reader, _ in connections))
        pipe.send([(ages_s, numbers[-1] - numbers[0] + 1 - len(numbers)) for ages_s, numbers in heard])

    asyncio.run(run())


def consume(pipe: Connection) -> None:
    """Whoever takes what the outputs say: a UDP port, a TCP port that takes all, and one that never takes anything."""

    async def run() -> None:
        loop = asyncio.get_running_loop()
        counted = {"datagrams": 0, "bytes": 0}

        class Datagrams(asyncio.DatagramProtocol):
            def datagram_received(self, _data: bytes, _address: object) -> None:
                counted["datagrams"] += 1

        async def take(reader: asyncio.StreamReader, _writer: asyncio.StreamWriter) -> None:
            while data := await reader.read(65536):
                counted["bytes"] += len(data)

        udp, _ = await loop.create_datagram_endpoint(Datagrams, local_addr=("127.0.0.1", 0))
        server = await asyncio.start_server(take, "127.0.0.1", 0)
        with socket.socket() as hole:  # Connections that wait to be accepted take what fits into the kernel's buffers.
            hole.bind(("127.0.0.1", 0))
            hole.listen(1)
            ports = (udp.get_extra_info("sockname")[1], server.sockets[0].getsockname()[1], hole.getsockname()[1])
            pipe.send(ports)
            pipe.send(await asyncio.to_thread(pipe.recv) and counted)
        server.close()

    asyncio.run(run())


def read_registers(port: int, pipe: Connection) -> None:
    """A PLC that reads the common map 20 times a second."""
    request = bytes.fromhex("000100000006010300030006")
    with socket.create_connection(("127.0.0.1", port), 5.0) as plc:
        answers, due_s = 0, time.monotonic()
        while not pipe.poll(max(0.0, due_s - time.monotonic())):
            plc.sendall(request)
            answers += len(plc.recv(256)) == PLC_ANSWER_BYTES
            due_s += PLC_PERIOD_S
        pipe.recv()
        pipe.send(answers)


@contextmanager
def mosquitto(directory: Path) -> Iterator[int]:
    """A broker, and its port; 0: there is none on this machine."""
    program = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
    if program is None:
        yield 0
        return
    port = free_port()
    (directory / "mosquitto.conf").write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
    broker = subprocess.Popen([program, "-c", directory / "mosquitto.conf"], stderr=subprocess.DEVNULL)
    try:
        yield port
    finally:
        broker.terminate()
        broker.wait(5.0)


def outputs(kind: Outputs, ports: tuple[int, int, int], registers: int, broker: int) -> str:
    """Tables of the daemon's configuration. ``ports``: UDP, TCP, and TCP that takes nothing."""
    udp, tcp, hole = ports
    if kind is Outputs.NONE:
        return ""
    count = len(TELEGRAMS) if kind is Outputs.USUAL else MANY
    links = [f"udp://127.0.0.1:{udp}" if i % 2 else f"tcp://127.0.0.1:{tcp}" for i in range(count)]
    if kind is Outputs.MANY:
        links[0] = f"tcp://127.0.0.1:{hole}"
    tables = [
        f'[[output]]\nname = "o{i}"\ntelegram = "{TELEGRAMS[i % len(TELEGRAMS)]}"\nlink = "{link}"\nrate_hz = 50.0\n'
        for i, link in enumerate(links)
    ]
    tables.append(f'[registers]\nenabled = true\nlink = "tcp://127.0.0.1:{registers}"\n')
    if broker:
        tables.append(f'[mqtt]\nenabled = true\nlink = "mqtt://127.0.0.1:{broker}"\n')
    return "".join(tables)


def settings(*, training: bool, fifo: int) -> str:
    """Tables of the daemon's configuration."""
    correction = f"[correction]\nenabled = {str(training).lower()}\nmin_laser_s = 20\nperiod_s = 5\n"
    return f"{correction}[runtime]\nfifo_priority = {fifo}\n"


# ---- what the system and the daemon say ------------------------------------------------------------------------------


def cpu_s(pid: int) -> float:
    """Processor time that a process has used (its children not counted)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def rss_mb(pid: int) -> float:
    found = re.search(r"VmRSS:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    return int(found[1]) / 1024.0 if found else 0.0


def children(pid: int) -> list[int]:
    listed = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(number) for path in listed for number in path.read_text().split()]


def metrics(address: tuple[str, int]) -> dict[str, float]:
    with urllib.request.urlopen(f"http://{address[0]}:{address[1]}/metrics", timeout=5.0) as answer:
        text = answer.read().decode()
    pairs = (line.rpartition(" ") for line in text.splitlines() if not line.startswith("#"))
    return {name: float(value) for name, _, value in pairs}


def lateness_shares(before: dict[str, float], after: dict[str, float]) -> dict[float, float]:
    """Shares of the poll deadlines between two readings of the metrics that were met within each bucket's bound."""
    bucket = re.compile(r'heaved_tick_lateness_seconds_bucket\{le="([^"]+)"\}')
    met = {float(found[1]): after[name] - before[name] for name in after if (found := bucket.fullmatch(name))}
    return {bound_s: count / max(met.values()) for bound_s, count in sorted(met.items())}


def trainings(read: dict[str, float]) -> float:
    return sum(value for name, value in read.items() if name.startswith("heaved_training_runs_total"))


def said(before: dict[str, float], after: dict[str, float], taken: dict[str, int]) -> dict[str, float]:
    """What the outputs have said between two readings of the metrics, and what has been taken since the start."""

    def grown(prefix: str) -> float:
        return sum(value - before.get(name, 0.0) for name, value in after.items() if name.startswith(prefix))

    return {"sent": grown("heaved_output_messages_total"), "lost": grown("heaved_output_lost_total"), **taken}


# ---- measuring -------------------------------------------------------------------------------------------------------


async def first_frame(host: str, port: int) -> None:
    """Wait for the first frame that a client can have."""
    reader, writer = await asyncio.open_connection(host, port)
    while b'"MOTION"' not in await reader.readline():
        pass
    writer.close()


def wait_for_training(address: tuple[str, int]) -> None:
    deadline_s = time.monotonic() + TRAINING_PATIENCE_S
    while trainings(metrics(address)) == 0.0:
        if time.monotonic() > deadline_s:
            raise SystemExit(f"no training within {TRAINING_PATIENCE_S:g} s: is torch installed?")
        time.sleep(1.0)


async def measure(
    name: str, arguments: argparse.Namespace, *, training: bool, wait_training: bool, kind: Outputs = Outputs.NONE
) -> Row:
    """Run one daemon and its clients; nothing else runs on this loop, so that it may block."""
    with ExitStack() as stack:
        plant = stack.enter_context(child(serve_plant, arguments.sea))
        directory = stack.enter_context(tempfile.TemporaryDirectory())
        consumers = stack.enter_context(child(consume))
        ports, registers = consumers.recv(), free_port()
        broker = stack.enter_context(mosquitto(Path(directory))) if kind is not Outputs.NONE else 0
        demo = load(data_directory() / "sensors.toml").device
        devices = [msgspec.structs.replace(device, link=link) for device, link in zip(demo, plant.recv(), strict=True)]
        tables = settings(training=training, fifo=arguments.fifo) + outputs(kind, ports, registers, broker)
        started_s = time.monotonic()
        async with running_daemon(devices, Path(directory), tables, http=True) as daemon:
            await first_frame(*daemon.addresses["stream"])
            first_s = time.monotonic() - started_s
            http = daemon.addresses["http"]
            if wait_training:
                wait_for_training(http)
            plc = stack.enter_context(child(read_registers, registers)) if kind is not Outputs.NONE else None
            with child(listen, *daemon.addresses["stream"], arguments.clients, arguments.duration) as clients:
                await asyncio.sleep(max(0.0, clients.recv() - time.monotonic()))
                before, cpu_before_s, at_s = metrics(http), cpu_s(daemon.pid), time.monotonic()
                heard = [Heard(np.array(ages_s), lost) for ages_s, lost in clients.recv()]
                cpu_percent = 100.0 * (cpu_s(daemon.pid) - cpu_before_s) / (time.monotonic() - at_s)
            after = metrics(http)
            consumers.send("end")
            taken = consumers.recv()
            if plc is not None:
                plc.send("end")
                taken["answers"] = plc.recv()
            return Row(
                name=name,
                said=said(before, after, taken),
                heard=heard,
                first_frame_s=first_s,
                cpu_percent=cpu_percent,
                rss_mb=rss_mb(daemon.pid),
                workers_rss_mb=sum(rss_mb(pid) for pid in children(daemon.pid)),
                lateness=lateness_shares(before, after),
                trainings=trainings(after) - trainings(before),
            )


def table(rows: list[Row]) -> str:
    def line(title: str, values: list[str]) -> str:
        return f"| {title:<42} |" + "".join(f" {value:>{WIDTH}} |" for value in values)

    ages = [np.concatenate([heard.ages_s for heard in row.heard]) * 1e3 for row in rows]
    lines = [line("", [row.name for row in rows]), "|" + "-" * 44 + "|" + ("-" * (WIDTH + 2) + "|") * len(rows)]
    for share in (50, 99, 99.9, 100):
        title = "age at the client, max" if share == 100 else f"age at the client, p{share:g}"
        lines.append(line(f"{title} (ms)", [f"{np.percentile(age, share):.2f}" for age in ages]))
    lines.append(line("frames, all clients", [str(age.size) for age in ages]))
    lines.append(line("frames lost", [str(sum(heard.lost for heard in row.heard)) for row in rows]))
    for bound_s in (0.001, 0.0025, 0.005, 0.01):
        shares = [f"{100.0 * row.lateness[bound_s]:.3f}" for row in rows]
        lines.append(line(f"poll deadlines met within {bound_s * 1e3:g} ms (%)", shares))
    lines.append(line("daemon: processor, % of a core", [f"{row.cpu_percent:.1f}" for row in rows]))
    lines.append(line("daemon: resident memory (MB)", [f"{row.rss_mb:.0f}" for row in rows]))
    lines.append(line("its workers: resident memory (MB)", [f"{row.workers_rss_mb:.0f}" for row in rows]))
    lines.append(line("trainings meanwhile", [f"{row.trainings:.0f}" for row in rows]))
    if any(row.said["sent"] for row in rows):
        for key, title in SAID.items():
            lines.append(line(title, [f"{row.said.get(key, 0):.0f}" for row in rows]))
    lines.append(line("start to first frame (s)", [f"{row.first_frame_s:.2f}" for row in rows]))
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--duration", type=float, default=60.0, help="measured seconds, after the warm-up")
    parser.add_argument("--clients", type=int, default=10)
    parser.add_argument("--sea", default="S4")
    parser.add_argument("--fifo", type=int, default=0, help="real-time priority of the daemon")
    parser.add_argument("--compare-training", action="store_true")
    parser.add_argument("--record", action="store_true", help="put the table into tools/RESULTS.md")
    parser.add_argument("--compare-outputs", action="store_true")
    arguments = parser.parse_args()
    made_with, begun_s = results.provenance(), time.monotonic()
    named = {f"{arguments.clients} clients": (True, False)}
    if arguments.compare_training:
        named = {"no training": (False, False), "training": (True, True)}
    if arguments.compare_outputs:
        rows = [
            asyncio.run(measure(kind.value, arguments, training=False, wait_training=False, kind=kind))
            for kind in Outputs
        ]
    else:
        rows = [
            asyncio.run(measure(name, arguments, training=training, wait_training=wait_training))
            for name, (training, wait_training) in named.items()
        ]
    what = f"{arguments.duration:g} s, sea {arguments.sea}, IMU 100 Hz, laser 20 Hz, {arguments.clients} clients"
    report = Report(f"{what}\n\n{table(rows)}", (1,))
    print(report.text)
    if arguments.record:
        results.record(__file__, sys.argv[1:], report, made_with, time.monotonic() - begun_s)


if __name__ == "__main__":
    main()
