#!/usr/bin/env python
"""More than one core can do: what gives way first, and what never does.

    python tools/overload.py [--seconds 60] [--rate 200] [--clients 64] [--slow 8] [--hogs 0 2 5 0]

The daemon and all its processes have one core: two devices (IMU and laser) at --rate, every telegram, registers that
a PLC reads, lines for a database, points, quiet windows, the recorder, fits of the sea and trainings as often as can
be, and --clients clients of the stream, --slow of which take a line a second. Slaves, clients and consumers run on the
other cores, as root at a priority that no other program disturbs: in the field they are other machines. In each phase
so many other programs, which do nothing but count, are on the daemon's core with it, at the same priority: with two of
them it has a third, unless --fifo puts it above them. Each phase is a column.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
import tempfile
import time
from contextlib import AsyncExitStack, ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec
from evidence import results
from evidence.commands import count, positive
from evidence.daemon import running_daemon
from evidence.processes import child, free_port
from evidence.results import Report
from evidence.soak import load
from evidence.soak.use import LATENESS, grown, metrics, percentile_s, use

from heaved.config.read import data_directory
from heaved.config.read import load as read_configuration

if TYPE_CHECKING:
    from collections.abc import Callable
    from multiprocessing.connection import Connection

CORE: Final = 0
LOOKING: Final = 4
"""Clients that look at what they get."""
LEARNING: Final = "[heave.sea]\nrefresh_s = 5\n[correction]\nmin_laser_s = 20\nperiod_s = 5\n"
WARM_UP_S: Final = 75.0
"""The first fit needs 40 s of samples, the first training as much."""
SETTLES_S: Final = 5.0
"""Of each phase, before it is measured."""


class Phase(msgspec.Struct, frozen=True):
    """What was measured while so many others were on the core."""

    hogs: int
    seconds: float
    heard: load.Heard
    read: dict[str, float]
    """The metrics' counters, by how much they grew."""
    lateness_ms: tuple[float, float]
    """Of polls, 50 and 99 %."""
    cpu_percent: float
    workers_percent: float


def measure(daemon_pid: int, http: tuple[str, int], clients: Connection, hogs: int, seconds: float) -> Phase:
    """Blocks until it is over."""
    with ExitStack() as stack:
        for _ in range(hogs):
            stack.enter_context(child(load.count_for_ever, CORE))
        time.sleep(SETTLES_S)
        clients.send(True)
        clients.recv()
        before, was, at_s = metrics(http), use(daemon_pid), time.monotonic()
        time.sleep(seconds)
        clients.send(True)
        heard, read, now, passed_s = clients.recv(), metrics(http), use(daemon_pid), time.monotonic() - at_s
    p50, p99 = (1e3 * percentile_s(before, read, LATENESS, share) for share in (0.5, 0.99))
    return Phase(
        hogs=hogs,
        seconds=passed_s,
        heard=heard,
        read={name: value - before.get(name, 0.0) for name, value in read.items()},
        lateness_ms=(p50, p99),
        cpu_percent=_percent(was.cpu_s, now.cpu_s, passed_s),
        workers_percent=_percent(was.workers_cpu_s, now.workers_cpu_s, passed_s),
    )


def _percent(before_s: float, after_s: float, passed_s: float) -> float:
    return 100.0 * (after_s - before_s) / passed_s


async def run(options: argparse.Namespace, folder: Path) -> list[Phase]:
    os.sched_setaffinity(0, set(range(os.cpu_count() or 1)) - {CORE} or {CORE})
    async with AsyncExitStack() as stack:
        serving = partial(load.as_if_elsewhere, partial(load.serve_plant, bandwidth_hz=options.bandwidth))
        plant = stack.enter_context(child(serving, options.sea, options.rate))
        consumers = stack.enter_context(child(partial(load.as_if_elsewhere, load.consume)))
        registers, links = free_port(), dict(plant.recv())
        devices = [
            msgspec.structs.replace(device, link=links[device.name], rate_hz=options.rate)
            for device in read_configuration(data_directory() / "sensors.toml").device
        ]
        udp, tcp = consumers.recv()
        tables = load.tables(udp, tcp, registers) + LEARNING + f"[runtime]\nfifo_priority = {options.fifo}\n"
        daemon = await stack.enter_async_context(running_daemon(devices, folder, tables, http=True, cores={CORE}))
        http, stream = daemon.addresses["http"], daemon.addresses["stream"]
        stack.enter_context(child(load.read_registers, registers))
        listening = partial(load.as_if_elsewhere, load.listen)
        counts = (LOOKING, options.slow, options.clients - options.slow - LOOKING)
        clients = stack.enter_context(child(listening, *stream, *counts))
        await asyncio.sleep(WARM_UP_S)
        return [
            await asyncio.to_thread(measure, daemon.pid, http, clients, hogs, options.seconds) for hogs in options.hogs
        ]


def table(phases: list[Phase]) -> str:
    """Markdown, a column for each phase."""

    def of(phase: Phase, prefix: str, *parts: str) -> float:
        return grown({}, phase.read, prefix, *parts)

    def polls(phase: Phase, device: str) -> str:
        part = f'device="{device}"'
        all_, good = of(phase, "heaved_polls_total", part), of(phase, "heaved_polls_total", part, 'result="none"')
        return f"{good / phase.seconds:.1f} ({all_ - good:.0f})"

    rows: list[tuple[str, Callable[[Phase], str]]] = [
        ("polls of the IMU with an answer, per second (missed)", lambda p: polls(p, "imu")),
        ("polls of the laser, likewise", lambda p: polls(p, "laser")),
        ("lateness of polls, p50 / p99 (ms)", lambda p: f"{p.lateness_ms[0]:.2g} / {p.lateness_ms[1]:.3g}"),
        (f"frames per second at clients that look ({LOOKING})", lambda p: f"{p.heard.frames / p.heard.seconds:.1f}"),
        ("age there, p50 / p99 / p99.9 (ms)", lambda p: " / ".join(f"{age:.3g}" for age in p.heard.ages_ms[:3])),
        ("frames that they lost", lambda p: f"{p.heard.lost}"),
        ("lines dropped for slow clients, per second", lambda p: f"{of(p, 'heaved_frames_dropped') / p.seconds:.0f}"),
        ("heave valid (% of the frames)", lambda p: f"{100.0 * p.heard.valid:.1f}"),
        ("telegrams and the like, per second", lambda p: f"{of(p, 'heaved_output_messages') / p.seconds:.0f}"),
        ("of them lost, and rows not recorded", lambda p: f"{of(p, 'heaved_output_lost'):.0f}"),
        ("fits, trainings", lambda p: f"{of(p, 'heaved_sea_fits'):.0f}, {of(p, 'heaved_training_runs'):.0f}"),
        ("processor: daemon / its processes (%)", lambda p: f"{p.cpu_percent:.0f} / {p.workers_percent:.0f}"),
        ("frames gathered, s", lambda p: f"{of(p, 'heaved_overloaded_seconds', 'gathered'):.0f}"),
        ("and predictions left out, s", lambda p: f"{of(p, 'heaved_overloaded_seconds', 'left_out'):.0f}"),
    ]  # fmt: skip
    lines = [
        f"| others on the core | {' | '.join(str(phase.hogs) for phase in phases)} |",
        "|---" * (len(phases) + 1) + "|",
    ]
    lines += [f"| {title} | {' | '.join(told(phase) for phase in phases)} |" for title, told in rows]
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=positive, default=60.0, help="of each phase (default 60)")
    parser.add_argument("--rate", type=positive, default=200.0, metavar="HZ", help="of both devices (default 200)")
    parser.add_argument("--clients", type=count, default=64)
    parser.add_argument("--slow", type=int, default=8)
    parser.add_argument("--hogs", type=int, nargs="+", default=[0, 2, 5, 0], metavar="N", help="default 0 2 5 0")
    parser.add_argument("--fifo", type=int, default=0, help="real-time priority of the daemon's loop (default 0: none)")
    parser.add_argument("--sea", default="S4")
    parser.add_argument(
        "--bandwidth",
        type=positive,
        metavar="HZ",
        help="of the accelerometer: with 0.5 in T3 a network has something to learn, and is trained",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep everything there")
    parser.add_argument("--record", action="store_true", help="put the table into tools/RESULTS.md")
    options = parser.parse_args()
    if options.slow + LOOKING > options.clients:
        parser.error(f"--clients has room for the slow ones and {LOOKING} more")
    made_with, begun_s = results.provenance(), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="heaved-overload-") as made:
        folder = options.out or Path(made)
        folder.mkdir(parents=True, exist_ok=True)
        phases = asyncio.run(run(options, folder.absolute()))
    what = (
        f"One core; IMU and laser at {options.rate:g} Hz, {options.clients} clients ({options.slow} slow), all outputs "
        f"but MQTT, recorder, fits and trainings; real-time priority {options.fifo}; {options.seconds:g} s each."
    )
    report = Report(f"{what}\n\n{table(phases)}", (1,))
    print(report.text)
    if options.record:
        results.record(__file__, sys.argv[1:], report, made_with, time.monotonic() - begun_s)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
