"""How fast ``heaved replay`` is: simulated recordings of one sea, files in and out, one process, one BLAS thread.

    python tools/bench_replay.py [--seconds 600] [--sea S6] [--rates 100 20]

The whole command is timed by its own clock (the start of the interpreter is not in it), a row for each rate and for
what is in the recording: attitude and gyros, attitude alone, the vertical accelerometer alone. Ratios to real time
depend on the machine; rows of one run may be compared.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
import tempfile
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"

from heaved.config import Config
from heaved.replay.replay import Summary, replay
from heaved.simulate.play import write_recording
from heaved.simulate.seaway import SEAS, seaway
from heaved.simulate.sensors import record

CONTENTS = {
    "acceleration, attitude, gyros": (),
    "acceleration, attitude": ("gx_radps", "gy_radps", "gz_radps"),
    "vertical acceleration": (
        *("gx_radps", "gy_radps", "gz_radps", "ax_mps2", "ay_mps2", "roll_deg", "pitch_deg", "yaw_deg"),
    ),
}
"""What is in a recording -> columns that are left out of it."""


def without(source: Path, target: Path, columns: tuple[str, ...]) -> None:
    """Copy a recording but for some columns."""
    with source.open(newline="") as given, target.open("w", newline="") as made:
        rows = csv.reader(given)
        names = next(rows)
        kept = [i for i, name in enumerate(names) if name not in columns]
        writer = csv.writer(made, lineterminator="\n")
        writer.writerow([names[i] for i in kept])
        writer.writerows([row[i] for i in kept] for row in rows)


def measure(folder: Path, sea: str, rate_hz: float, seconds: float) -> None:
    """Make a recording, replay it with each content, print a row for each."""
    whole = folder / "whole.csv"
    write_recording(whole, record(seaway(sea, 1), seconds, imu_rate_hz=rate_hz, sensor="A", laser="off", seed=1001))
    for content, columns in CONTENTS.items():
        source = folder / "part.csv"
        without(whole, source, columns)
        done: Summary = replay(source, folder / "out.csv", Config())
        speed, cost_us = done.duration_s / done.elapsed_s, 1e6 * done.elapsed_s / done.rows
        print(f"| {rate_hz:g} Hz | {content} | {done.elapsed_s:.2f} | {speed:.0f} | {cost_us:.1f} |", flush=True)


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=600.0, help="length of the recording (default 600)")
    parser.add_argument("--sea", default="S6", choices=sorted(SEAS))
    parser.add_argument("--rates", type=float, nargs="+", default=[100.0, 20.0], metavar="HZ")
    options = parser.parse_args(words)
    print(f"{options.seconds:g} s of {options.sea}\n")
    print("| rate | recording | s | times real time | µs per row |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for rate_hz in options.rates:
            measure(Path(folder), options.sea, rate_hz, options.seconds)
    return 0


if __name__ == "__main__":
    sys.exit(main())
