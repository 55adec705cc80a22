#!/usr/bin/env python
"""The daemon for hours under all that it can be asked for: does memory, or anything else, grow?

    python tools/soak.py --hours 24 --out soak/
    python tools/soak.py --hours 1 --rate 100 --clients 10
    python tools/soak.py --again soak/          # the table of what is there, while it runs or later

Processes of their own: the simulated slaves (IMU at --rate, laser at 20 Hz, Modbus TCP on loopback), ``python -m heaved
run`` with the recorder, every telegram, registers that a PLC reads, lines for a database, points and quiet windows; the
clients of its stream; the page with a browser on it; a scrape of the metrics every 15 s. Each ten seconds are a line of
``samples.jsonl`` in DIR, where configuration, log and recording are too. At the end, or on Ctrl-C with what there is:
a table, and ``soak.png`` (with matplotlib). Exit code 1: something grows, or the time was too short to say.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import signal
import sys
import tempfile
import time
from contextlib import AsyncExitStack, suppress
from importlib.util import find_spec
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from evidence import results
from evidence.commands import count, positive
from evidence.daemon import Running, running_daemon
from evidence.processes import child, free_port, page
from evidence.results import Report
from evidence.soak import load
from evidence.soak.judge import Sample, is_flat, judge, table
from evidence.soak.use import LATENESS, Use, grown, metrics, percentile_s, use

from heaved.config.read import data_directory
from heaved.config.read import load as read_configuration
from heaved.outputs.telegram_output import NOT_KNOWN

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

SAMPLE_S = 10.0
SCRAPE_S = 15.0
LINES = "samples.jsonl"
LEAST_SAMPLES = 40
"""For a table."""
UNSAID = f'reason="{NOT_KNOWN}"'
"""Not lost: a telegram that has no words for a heave that is not known yet is not sent."""


class Probe:
    """Samples of one daemon, each of what happened since the one before."""

    def __init__(self, daemon: Running, clients: Connection, begun_s: float) -> None:
        self._daemon, self._clients, self._begun_s = daemon, clients, begun_s
        self._at_s = time.monotonic()
        self._use = use(daemon.pid)
        self._metrics = metrics(daemon.addresses["http"])
        self._ask()

    def _ask(self) -> load.Heard:
        self._clients.send(True)
        heard: load.Heard = self._clients.recv()
        return heard

    def sample(self) -> Sample:
        """Blocks for some milliseconds, never the daemon.

        Raises:
            OSError, EOFError: the daemon or the clients are gone.
        """
        heard, now, read = self._ask(), use(self._daemon.pid), metrics(self._daemon.addresses["http"])
        at_s = time.monotonic()
        seconds = at_s - self._at_s
        before, was = self._metrics, self._use
        self._at_s, self._metrics, self._use = at_s, read, now
        p50, p99, p999 = (1e3 * percentile_s(before, read, LATENESS, share) for share in (0.5, 0.99, 0.999))
        polls = grown(before, read, "heaved_polls_total")
        return Sample(
            t_s=at_s - self._begun_s,
            rss_mb=now.rss_mb,
            workers_pss_mb=now.workers_pss_mb,
            descriptors=now.descriptors,
            threads=now.threads,
            cpu_percent=100.0 * (now.cpu_s - was.cpu_s) / seconds,
            workers_cpu_percent=_workers_percent(was, now, seconds),
            ages_ms=heard.ages_ms[:3],
            lateness_ms=(p50, p99, p999),
            frames_per_s=heard.frames / heard.seconds,
            lost=heard.lost,
            valid=heard.valid,
            missed_polls=polls - grown(before, read, "heaved_polls_total", 'result="none"'),
            output_lost=grown(before, read, "heaved_output_lost_total")
            - grown(before, read, "heaved_output_lost_total", UNSAID),
        )


def _workers_percent(was: Use, now: Use, seconds: float) -> float:
    """nan: one of them is another now."""
    used_s = now.workers_cpu_s - was.workers_cpu_s
    return 100.0 * used_s / seconds if used_s >= 0.0 and len(was.workers_pss_mb) == len(now.workers_pss_mb) else nan


async def scrape(address: tuple[str, int]) -> None:
    """As Prometheus does."""
    while True:
        with suppress(OSError):
            await asyncio.to_thread(metrics, address)
        await asyncio.sleep(SCRAPE_S)


async def soak(options: argparse.Namespace, folder: Path) -> list[Sample]:
    """Until the time is over, Ctrl-C, or the daemon's end."""
    ended = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, ended.set)
    samples: list[Sample] = []
    async with AsyncExitStack() as stack:
        plant = stack.enter_context(child(load.serve_plant, options.sea, options.rate))
        consumers = stack.enter_context(child(load.consume))
        registers, links = free_port(), dict(plant.recv())
        devices = [
            msgspec.structs.replace(
                device, link=links[device.name], rate_hz=options.rate if device.role == "imu" else device.rate_hz
            )
            for device in read_configuration(data_directory() / "sensors.toml").device
        ]
        udp, tcp = consumers.recv()
        settings = load.tables(udp, tcp, registers)
        daemon = await stack.enter_async_context(running_daemon(devices, folder, settings, http=True))
        stream = daemon.addresses["stream"]
        begun_s = time.monotonic()
        stack.enter_context(child(load.read_registers, registers))
        stack.enter_context(child(load.watch_page, stack.enter_context(page(stream[1], folder))))
        clients = stack.enter_context(child(load.listen, *stream, options.clients, 0, 0))
        scraping = asyncio.create_task(scrape(daemon.addresses["http"]))
        file = stack.enter_context((folder / LINES).open("ab"))
        probe = await asyncio.to_thread(Probe, daemon, clients, begun_s)
        while (now_s := time.monotonic()) < begun_s + 3600.0 * options.hours and not ended.is_set():
            with suppress(TimeoutError):
                await asyncio.wait_for(ended.wait(), SAMPLE_S - (now_s - begun_s) % SAMPLE_S)
            try:
                samples.append(await asyncio.to_thread(probe.sample))
            except (OSError, EOFError) as error:
                print(f"the daemon or its clients do not answer any more: {error!r}", file=sys.stderr)
                break
            file.write(msgspec.json.encode(samples[-1]) + b"\n")
            file.flush()
        scraping.cancel()
    return samples


def samples_of(folder: Path) -> list[Sample]:
    """Those of an earlier run.

    Raises:
        OSError, msgspec.MsgspecError: there are none.
    """
    return [msgspec.convert(_known(msgspec.json.decode(line)), Sample) for line in (folder / LINES).open("rb")]


def _known(said: object) -> object:
    """JSON has no word for what is not known but null."""
    if isinstance(said, dict):
        return {name: _known(value) for name, value in said.items()}
    if isinstance(said, list):
        return [_known(value) for value in said]
    return nan if said is None else said


def told(options: argparse.Namespace, samples: list[Sample], folder: Path) -> tuple[Report, bool]:
    """What came of it, and whether all is flat."""
    end_s = samples[-1].t_s if samples else 0.0
    what = (
        f"{end_s / 3600.0:.2f} h, sea {options.sea}, IMU {options.rate:g} Hz, laser 20 Hz, {options.clients} clients, "
        f"all outputs but MQTT, recorder, page; {os.cpu_count()} cores, niceness {os.nice(0)}"
    )
    if len(samples) < LEAST_SAMPLES:
        return Report(f"{what}\n\nToo short for a table: {len(samples)} samples.", (1,)), False
    found = judge(samples)
    if find_spec("matplotlib") is not None:
        from evidence.soak.figure import draw  # matplotlib only where it is installed

        draw(samples, folder / "soak.png", what)
    said = "flat: nothing grows" if is_flat(found) else "**not shown to be flat**"
    return Report(f"{what}\n\n{table(found, end_s)}\n\nVerdict: {said}.", (1,)), is_flat(found)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=positive, default=1.0)
    parser.add_argument("--rate", type=positive, default=100.0, metavar="HZ", help="of the IMU (default 100)")
    parser.add_argument("--clients", type=count, default=10)
    parser.add_argument("--sea", default="S4")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep everything there")
    parser.add_argument("--again", type=Path, metavar="DIR", help="measure nothing: the table of an earlier run")
    parser.add_argument("--record", action="store_true", help="put the table into tools/RESULTS.md")
    options = parser.parse_args()
    made_with, begun_s = results.provenance(), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="heaved-soak-") as made:
        folder = options.again or options.out or Path(made)
        folder.mkdir(parents=True, exist_ok=True)
        samples = samples_of(folder) if options.again else asyncio.run(soak(options, folder.absolute()))
        report, all_flat = told(options, samples, folder)
        print(report.text)
        if options.record:
            results.record(__file__, sys.argv[1:], report, made_with, time.monotonic() - begun_s)
    return 0 if all_flat else 1


if __name__ == "__main__":
    raise SystemExit(main())
