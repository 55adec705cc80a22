"""The whole chain against a known truth, live: a recording through Modbus registers, the daemon, a TCP client.

    python tools/live.py hebrides buoy_2005-07-01T00h00Z.raw [--duration 300]
    python tools/live.py sea S4 --laser 50%

The recording is served by simulated slaves (IMU at 100 Hz, laser at 20 Hz, Modbus TCP on loopback) from this process;
``python -m heaved run`` polls them; each MOTION line is compared with the truth at its own time of validity, which both
sides read from one monotonic clock. Prints RMS errors by interval; what a client would have believed, and for how long.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from evidence import results
from evidence.daemon import running_daemon
from evidence.results import Report
from numpy.typing import NDArray
from recordings import FADE_S, hebrides, sea

from heaved.config.read import data_directory, load
from heaved.simulate.plant import SimulatedPlant
from heaved.simulate.play import Player, read_recording, write_recording

if TYPE_CHECKING:
    from heaved.simulate.sensors import Recording

Array = NDArray[np.float64]
INTERVAL_S = 60.0


class Quality(msgspec.Struct):
    heave: str
    correction: str


class Line(msgspec.Struct):
    """What is needed of a MOTION line; nan: left out by the daemon."""

    seq: int
    mono_s: float
    quality: Quality
    heave_m: float = float("nan")
    heave_std_m: float = float("nan")
    observer_m: float = float("nan")
    reference_m: float = float("nan")


def make(options: argparse.Namespace) -> Recording:
    if options.kind == "hebrides":
        path = Path(options.name)
        return hebrides(path, rate_hz=100.0, sensor=options.sensor, laser=options.laser, seed=options.seed)
    duration_s = options.duration + 60.0
    return sea(options.name, duration_s=duration_s, rate_hz=100.0, sensor=options.sensor, laser=options.laser)


async def listen(host: str, port: int, until_s: float) -> list[Line]:
    """MOTION lines until a moment of the monotonic clock."""
    reader, writer = await asyncio.open_connection(host, port)
    decoder = msgspec.json.Decoder(Line)
    lines = []
    while time.monotonic() < until_s:
        text = await asyncio.wait_for(reader.readline(), 10.0)
        if text.startswith(b'{"class":"MOTION"'):
            lines.append(decoder.decode(text))
        elif not text:
            raise ConnectionError("the daemon closed the stream")
    writer.close()
    return lines


async def run(options: argparse.Namespace, folder: Path) -> tuple[list[Line], float, Recording]:
    """The lines, the recording's time at monotonic 0, and the recording (truth included)."""
    recording = make(options)
    # A real record fades in and out at its ends; the part between is what the sea did.
    lead_in_s = FADE_S if options.kind == "hebrides" else 0.0
    file = folder / "played.csv"
    write_recording(file, recording)
    columns = read_recording(file)
    from_start = columns["t_s"] - columns["t_s"][0] >= lead_in_s
    player = Player({name: column[from_start] for name, column in columns.items()})
    plant = SimulatedPlant(load(data_directory() / "sensors.toml").device, player, any_port=True)
    await plant.start()
    zero_s = float(columns["t_s"][from_start][0]) + plant.time_s() - time.monotonic()
    try:
        async with running_daemon(plant.devices, folder) as daemon:
            lines = await listen(*daemon.addresses["stream"], time.monotonic() + options.duration)
    finally:
        await plant.stop()
    return lines, zero_s, recording


def report(lines: list[Line], zero_s: float, recording: Recording) -> str:
    t = np.array([line.mono_s for line in lines]) + zero_s
    truth = np.interp(t, recording.truth.t_s, recording.truth.heave_m)
    heave, std, observer = (
        np.array([getattr(line, name) for line in lines]) for name in ("heave_m", "heave_std_m", "observer_m")
    )
    states = np.array([line.quality.heave for line in lines])
    rows = [
        f"{len(lines)} frames in {t[-1] - t[0]:.0f} s, {lines[-1].seq - lines[0].seq + 1 - len(lines)} lost; "
        f"heave sigma {np.std(truth):.3f} m",
        f"{'interval':>14} {'RMS m':>8} {'% sigma':>8} {'no BP m':>8} {'std m':>8} {'covered':>8}  quality",
    ]
    for start in np.arange(0.0, t[-1] - t[0], INTERVAL_S):
        inside = (t - t[0] >= start) & (t - t[0] < start + INTERVAL_S)
        known = inside & np.isfinite(heave)
        counts = Counter(states[inside].tolist()).most_common()
        shares = ", ".join(f"{state} {count / inside.sum():.0%}" for state, count in counts)
        name = f"{start:.0f}-{min(start + INTERVAL_S, t[-1] - t[0]):.0f} s"
        if not known.any():
            rows.append(f"{name:>14} {'-':>8} {'-':>8} {'-':>8} {'-':>8} {'-':>8}  {shares}")
            continue
        error = heave[known] - truth[known]
        rms = float(np.sqrt(np.mean(error**2)))
        without = float(np.sqrt(np.mean((observer[known] - truth[known]) ** 2)))
        covered = float(np.mean(np.abs(error) < 1.96 * std[known]))
        rows.append(
            f"{name:>14} {rms:8.4f} {100 * rms / np.std(truth):8.1f} {without:8.4f} {np.mean(std[known]):8.4f} "
            f"{covered:8.1%}  {shares}"
        )
    return "\n".join(rows)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("hebrides", "sea"))
    parser.add_argument("name", help="a buoy file, or the name of a sea")
    parser.add_argument("--duration", type=float, default=300.0, metavar="S")
    parser.add_argument("--sensor", default="A", metavar="A|B|ideal")
    parser.add_argument("--laser", default="50%", metavar="PATTERN")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--record", action="store_true", help="put the table into tools/RESULTS.md")
    options = parser.parse_args()
    made_with, started = results.provenance(), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="heaved-live-") as folder:
        lines, zero_s, recording = asyncio.run(run(options, Path(folder)))
        found = Report(f"```\n{report(lines, zero_s, recording)}\n```", (options.seed,))
        print(found.text)
        if options.record:
            results.record(__file__, sys.argv[1:], found, made_with, time.monotonic() - started)
        print((Path(folder) / "log").read_text(), file=sys.stderr)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
