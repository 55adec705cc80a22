#!/usr/bin/env python
"""Accuracy in figures, from the very pipeline of the daemon: tables to standard output, results and figures to files.

    tools/accuracy.py heave [T1 T2 T3 S4 S5 S6] [--sensor A|B] [--seeds 3]
    tools/accuracy.py real        real seas (Hebrides wave-rider), where the records are present
    tools/accuracy.py rock [--jobs 2]   roll and pitch ahead: the paper's method, the direct predictor, quiet windows
    tools/accuracy.py all

Beside the tables, OUT/results.jsonl gets one line per result, and OUT a figure per scenario.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from math import inf
from pathlib import Path

# The matrices are small: threads cost more than they give. To be said before numpy is loaded.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["OMP_NUM_THREADS"] = "1"

import msgspec
from evidence import heave, quiescence, rock, rock_direct
from evidence.heave import Setting, Traces

from heaved.simulate.sensors import SENSORS, laser_pattern

CHECKOUT = Path(__file__).resolve().parent.parent
RECORDS = CHECKOUT.parent / "shared" / "data" / "hebrides_waverider"
SHIP_RECORD = CHECKOUT.parent / "shared" / "data" / "palmer" / "NBP1406_2014-08-01_seapath330.csv"
QUIESCENCE_S = 4000.0
PACKAGES = ("heaved", "numpy", "scipy", "torch")


class Provenance(msgspec.Struct, frozen=True):
    """What the figures were made with."""

    commit: str
    """"+" at its end: with changes that are not committed."""
    versions: dict[str, str]


def provenance() -> Provenance:
    versions = {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}
    git = ("git", "--no-optional-locks", "-C", str(CHECKOUT))
    try:
        commit, changes = (
            subprocess.run([*git, *words], check=True, capture_output=True, text=True).stdout.strip()
            for words in (("rev-parse", "HEAD"), ("status", "--porcelain"))
        )
    except (OSError, subprocess.CalledProcessError):
        return Provenance("unknown", versions)
    return Provenance(commit + ("+" if changes else ""), versions)


def json_line(kind: str, result: msgspec.Struct, made_with: Provenance) -> bytes:
    """One result as a line of JSON: its fields, what kind it is, and what it was made with. null: does not apply."""
    fields = {"kind": kind} | msgspec.to_builtins(result) | msgspec.to_builtins(made_with)
    return msgspec.json.encode(fields) + b"\n"


class Output:
    """Tables to standard output, results and figures to a folder."""

    def __init__(self, folder: Path, figures: bool) -> None:
        """
        Raises:
            OSError: the folder cannot be made or written to.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.figures = folder, figures
        self._lines = (folder / "results.jsonl").open("wb")
        self._made_with = provenance()

    def write(self, kind: str, results: Sequence[msgspec.Struct]) -> None:
        self._lines.writelines(json_line(kind, result, self._made_with) for result in results)
        self._lines.flush()

    def watch(self, setting: Setting) -> Callable[[Traces], None]:
        """Draws the first run of each scenario."""
        drawn: set[str] = set()

        def draw(traces: Traces) -> None:
            scenario = traces.case.scenario
            print(f"{scenario}, record {traces.case.seed}: done", file=sys.stderr, flush=True)
            if self.figures and scenario not in drawn:
                from evidence.figures import heave_trial  # matplotlib only when it is wanted

                drawn.add(scenario)
                title = f"{scenario}, sensor {setting.sensor}, {setting.rate_hz:g} Hz, laser {setting.laser}"
                heave_trial(self.folder / f"heave_{scenario}_{setting.sensor}.png", traces, title)

        return draw

    def close(self) -> None:
        self._lines.close()


def run_heave(options: argparse.Namespace, output: Output) -> None:
    setting = _setting(options, 700.0)
    watch = output.watch(setting)
    results: list[heave.Result] = []
    for scenario in options.scenarios or heave.DEFAULT_SCENARIOS:
        cases = (heave.simulated(scenario, seed, setting) for seed in range(1, options.seeds + 1))
        found = heave.evaluate(cases, setting, watch)
        output.write("heave", found)
        results += found
    print(heave.report(results, heave.equal_tuning(msgspec.structs.replace(setting, duration_s=700.0))))


def run_real(options: argparse.Namespace, output: Output) -> None:
    """Every half-hour is a record of its own, so --seeds does not matter here."""
    files = sorted(RECORDS.glob("*.raw"))
    if not files:
        print(f"real: skipped, there are no records (*.raw) in {RECORDS}")
        return
    setting = _setting(options, inf)
    cases = (heave.hebrides(file, number, setting) for number, file in enumerate(files, start=1))
    results = heave.evaluate(cases, setting, output.watch(setting))
    output.write("real", results)
    simulated = msgspec.structs.replace(setting, duration_s=700.0)
    print(heave.report(results, heave.equal_tuning(simulated)))


def run_rock(options: argparse.Namespace, output: Output) -> None:
    duration_s = 240.0 if options.duration is None else options.duration
    rows = rock.table(range(1, options.seeds + 1), duration_s)
    output.write("rock", rows)
    print(rock.report(rows))
    seeds = range(1, options.seeds + 1)
    direct_s = 600.0 if options.duration is None else options.duration
    table = rock_direct.table(seeds, direct_s, options.jobs)
    costs = rock_direct.costs(seeds, direct_s, options.jobs)
    rates = rock_direct.rates_table(seeds, direct_s, options.jobs)
    ship = rock_direct.real(SHIP_RECORD) if SHIP_RECORD.exists() else []
    for found in (table, costs, rates, ship):
        output.write("rock", found)
    print(rock_direct.report(table, costs, rates, ship))
    if not ship:
        print(f"real ship: skipped, there is no {SHIP_RECORD}")
    if options.duration is None or options.duration > quiescence.SCORED_FROM_S + 300.0:
        verdicts = quiescence.table(seeds, options.duration or QUIESCENCE_S, options.jobs)
        output.write("quiescence", verdicts)
        print(quiescence.report(verdicts))
    if output.figures:
        rock.figure(output.folder / "rock.png")
        rock_direct.figure(output.folder / "rock_direct.png", table)


def run_all(options: argparse.Namespace, output: Output) -> None:
    for command in (run_heave, run_real, run_rock):
        command(options, output)


def _setting(options: argparse.Namespace, duration_s: float) -> Setting:
    return Setting(
        sensor=options.sensor,
        rate_hz=options.rate,
        laser=options.laser,
        duration_s=duration_s if options.duration is None else options.duration,
    )


def _parser() -> argparse.ArgumentParser:
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--seeds", type=_count, default=3, metavar="N", help="records per scenario (default 3)")
    common.add_argument("--rate", type=_positive, default=20.0, metavar="HZ", help="of the IMU (default 20)")
    common.add_argument("--sensor", default="A", choices=sorted(SENSORS), help="its errors (default A)")
    common.add_argument(
        "--laser", default="50%", metavar="PATTERN", help="on, off, 50%% (default), or START+LENGTH,... in seconds"
    )
    common.add_argument(
        "--duration", type=_positive, metavar="S", help="of a record (default 700; real: whole; rock: 240, 600, 4000)"
    )
    common.add_argument("--out", type=Path, default=CHECKOUT / "evidence", metavar="DIR", help="default: evidence/")
    common.add_argument("--no-figures", action="store_true")
    common.add_argument("--jobs", type=_count, default=1, metavar="N", help="rock: processes at once (default 1)")
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    commands = parser.add_subparsers(dest="command", required=True)
    simulated = commands.add_parser("heave", parents=[common], help="wave trains and irregular seas, simulated")
    simulated.add_argument("scenarios", nargs="*", metavar="SCENARIO", help=", ".join(heave.SCENARIOS))
    commands.add_parser("real", parents=[common], help="real seas")
    commands.add_parser("rock", parents=[common], help="roll and pitch, simulated")
    commands.add_parser("all", parents=[common], help="all of these").set_defaults(scenarios=())
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < inf:
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text}: at least 1 is needed")
    return value


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; 0 when everything is written."""
    options = _parser().parse_args(arguments)
    commands = {"heave": run_heave, "real": run_real, "rock": run_rock, "all": run_all}
    started = time.monotonic()
    try:
        laser_pattern(options.laser)
        output = Output(options.out, not options.no_figures)
        try:
            commands[options.command](options, output)
        finally:
            output.close()
    except (ValueError, OSError) as error:
        print(f"accuracy: {error}", file=sys.stderr)
        return 1
    print(f"\nResults in {options.out}; it took {time.monotonic() - started:.0f} s.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
