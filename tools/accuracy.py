#!/usr/bin/env python
"""Accuracy in figures, from the very pipeline of the daemon: tables to standard output, results and figures to files.

    tools/accuracy.py heave [T1 ... S6S] [--sensor A|B] [--laser off|50%|on] [--tilt none|exact|noisy] [--seeds 3]
    tools/accuracy.py real [Hebrides palmer flume static]    real records, where they are present
    tools/accuracy.py headline [SCENARIO ...]    every scenario and setting that a figure is asked for
    tools/accuracy.py table       those figures, asked and measured, out of OUT/results.jsonl
    tools/accuracy.py limits [--shake NAME]    the least error that is possible, alone
    tools/accuracy.py gates [--set]    short runs against their regression gates
    tools/accuracy.py rock [--shake]    roll and pitch ahead: the paper's method, the direct predictor, quiet windows;
                                  or what a gyroscope adds to it on a hull that shakes
    tools/accuracy.py correction [--seeds 3]  the learned correction while a network is in use, laser on and off
    tools/accuracy.py closed-loop [S6 T3] [--replay]    a hook under a winch that the stream drives, in real time
    tools/accuracy.py faults [DISASTER ...] [--seas S6] [--rates 20]    what is published while things go wrong
    tools/accuracy.py shake [line-3.1 slams] [--seas S6] [--rates 20]    heave while something shakes the sensor
    tools/accuracy.py hull [--runs 50] [--shake]    deformation between two IMUs, 600 s a run
    tools/accuracy.py attitude [--runs 50] [--shake]    heave and pitch of a foil-assisted catamaran
    tools/accuracy.py all         headline and rock

Beside the tables, OUT/results.jsonl gets one more line per result, with what made it, and OUT the figures. Of two lines
for the same, the later one counts. ``--jobs 2`` runs two records at a time.
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
from typing import NamedTuple, get_args

# The matrices are small: threads cost more than they give. To be said before numpy is loaded.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["OMP_NUM_THREADS"] = "1"

import msgspec
from evidence import (
    asked,
    attitude,
    closed_loop,
    correction,
    disasters,
    estimators,
    fault_table,
    faults,
    gates,
    heave,
    hull,
    quiescence,
    rock,
    rock_direct,
    rock_shaken,
    scenarios,
    shake,
    tables,
)
from evidence.scenarios import Setting
from evidence.summary import Judged, Result

from heaved.simulate.sensors import SENSORS, laser_pattern
from heaved.simulate.shaking import NONE, shake_of

CHECKOUT = Path(__file__).resolve().parent.parent
RESULTS = "results.jsonl"
SHIP_RECORD = CHECKOUT.parent / "shared" / "data" / "palmer" / "NBP1406_2014-08-01_seapath330.csv"
QUIESCENCE_S = 4000.0
SHAKEN_S = 420.0
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
            OSError: the folder cannot be made.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.figures = folder, figures
        self.made_with = provenance()

    def write(self, kind: str, results: Sequence[msgspec.Struct]) -> None:
        """Add a line for each.

        Raises:
            OSError: the file cannot be written to.
        """
        with (self.folder / RESULTS).open("ab") as file:
            file.writelines(json_line(kind, result, self.made_with) for result in results)


def run_heave(options: argparse.Namespace, output: Output) -> None:
    _evaluate([(name, _setting(options)) for name in _chosen(options, scenarios.SIMULATED)], options, output)


def run_real(options: argparse.Namespace, output: Output) -> None:
    """Every file is a record of its own, so --seeds does not matter here."""
    _evaluate([(name, _setting(options)) for name in _chosen(options, tuple(scenarios.REAL))], options, output)


def run_headline(options: argparse.Namespace, output: Output) -> None:
    names = _chosen(options, scenarios.NAMES)
    _evaluate([row for row in heave.HEADLINE if row[0] in names], options, output)
    run_table(options, output)


def _chosen(options: argparse.Namespace, known: Sequence[str]) -> Sequence[str]:
    """Scenarios that were named, all that are known if none was.

    Raises:
        ValueError: one of them is not known here.
    """
    if unknown := [name for name in options.scenarios if name not in known]:
        raise ValueError(f"unknown scenario {unknown[0]!r}: choose from {', '.join(known)}")
    return options.scenarios or known


def run_table(options: argparse.Namespace, output: Output) -> None:
    path = output.folder / RESULTS
    lines = [msgspec.json.decode(line) for line in path.read_bytes().splitlines()]
    print(asked.table(lines, options.observer))


def run_limits(options: argparse.Namespace, output: Output) -> None:
    """
    Raises:
        ValueError: a disturbance is not known.
    """
    print(tables.limits_table(("A", "B", "C"), options.rate, options.shake))


def run_gates(options: argparse.Namespace, output: Output) -> None:
    """
    Raises:
        ValueError: a gate does not hold.
    """
    observers = estimators.OBSERVERS if options.set else gates.load().observers
    results = [result for row in heave.run_all(gates.tasks(observers), options.jobs, _tell) for result in row]
    output.write("gate", results)
    if options.set:
        gates.save(gates.made_of(results, output.made_with.commit, observers))
        print(f"gates: set in {gates.FILE}")
        return
    if messages := gates.broken(gates.load().gates, results):
        raise ValueError("gates that do not hold:\n" + "\n".join(messages))
    print("gates: all hold")


def _evaluate(rows: Sequence[tuple[str, Setting]], options: argparse.Namespace, output: Output) -> None:
    """Run, write, draw and show."""
    present = [row for row in rows if row[0] not in scenarios.REAL or scenarios.files(row[0])]
    for name in dict.fromkeys(row[0] for row in rows if row not in present):
        print(f"{name}: skipped, there are no records in {scenarios.DATA / scenarios.REAL[name]}")
    todo = heave.tasks(present, tuple(options.estimators), options.seeds, output.folder if output.figures else None)
    results: list[Result] = []
    for found in heave.run_all(todo, options.jobs, _tell):
        output.write("heave", found)
        results += found
    if not results:
        return
    if output.figures:
        from evidence.figures import draw_results  # matplotlib only when it is wanted

        draw_results(output.folder, results)
    print(tables.report(results, heave.equal_tuning()))


def _tell(record: Judged) -> None:
    print(f"{record.scenario}, record {record.seeds.waves}: done", file=sys.stderr, flush=True)


def run_rock(options: argparse.Namespace, output: Output) -> None:
    if options.shake:
        shaken = rock_shaken.table(range(1, options.seeds + 1), options.duration or SHAKEN_S, options.jobs)
        output.write("rock_shaken", shaken)
        print(rock_shaken.report(shaken))
        return
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


def run_hull(options: argparse.Namespace, output: Output) -> None:
    duration_s = 600.0 if options.duration is None else options.duration
    rows = hull.table(range(options.runs), duration_s, options.jobs, options.shake)
    output.write("hull", rows)
    print(hull.report(rows))
    if output.figures and not options.shake:
        hull.figure(output.folder / "hull.png", rows, duration_s=duration_s)


def run_attitude(options: argparse.Namespace, output: Output) -> None:
    """
    Raises:
        ValueError: the duration ends before the last change of sea.
    """
    passage = attitude.SHAKEN_PASSAGE if options.shake else attitude.PASSAGE
    if options.duration is not None:
        if options.duration <= passage.stages[-1][0]:
            raise ValueError(f"the last change of sea is at {passage.stages[-1][0]:g} s: give a longer --duration")
        passage = msgspec.structs.replace(passage, duration_s=options.duration)
    methods = attitude.SHAKEN if options.shake else attitude.METHODS
    rows = attitude.table(range(1, options.runs + 1), options.jobs, methods, passage)
    output.write("attitude", rows)
    print(attitude.report(rows))
    if output.figures and not options.shake:
        attitude.figure(output.folder / "attitude.png", passage=passage)


def run_correction(options: argparse.Namespace, output: Output) -> None:
    outcomes = correction.table(range(1, options.seeds + 1), options.jobs)
    output.write("correction", outcomes)
    print(correction.report(outcomes))


def run_faults(options: argparse.Namespace, output: Output) -> None:
    """
    Raises:
        ValueError: a disaster is not known, or begins too late.
    """
    if unknown := [name for name in options.disasters if name not in disasters.DISASTERS]:
        raise ValueError(f"unknown disaster {unknown[0]!r}: choose from {', '.join(disasters.DISASTERS)}")
    if options.list:
        print("\n".join(f"{name:24} {disaster.what}" for name, disaster in disasters.DISASTERS.items()))
        return
    if options.duration < options.at + 2.0 * faults.LAST_S:
        raise ValueError(f"a disaster at {options.at:g} s needs a --duration of {options.at + 2.0 * faults.LAST_S:g} s")
    plan = faults.Plan(at_s=options.at, duration_s=options.duration)
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    todo = faults.tasks(options.disasters or disasters.DISASTERS, options.seas, options.rates, seeds, plan)

    def watch(outcome: faults.Outcome) -> None:
        task = outcome.task
        print(f"{task.name}, {task.sea}, {task.rate_hz:g} Hz, record {task.seed}: done", file=sys.stderr, flush=True)
        output.write("fault", [outcome])

    print(fault_table.report(faults.run_all(todo, options.jobs, watch), options.detail))


def run_shake(options: argparse.Namespace, output: Output) -> None:
    """
    Raises:
        ValueError: a disturbance is not known, or a record too short for it.
    """
    rows = shake.plan(options.shakes or shake.QUESTIONS, options.seas, options.rates, options.duration)
    todo = heave.tasks(rows, (shake.TEXTBOOK, shake.OURS), options.seeds)
    results: list[Result] = []
    for found in heave.run_all(todo, options.jobs, _tell_shaken):
        output.write("shake", found)
        results += found
    print(shake.report(results, rows))


def _tell_shaken(record: Judged) -> None:
    how = record.setting
    print(f"{how.shake or 'not shaken'}, sensor {how.sensor}, {how.rate_hz:g} Hz: ", end="", file=sys.stderr)
    _tell(record)


def run_closed_loop(options: argparse.Namespace, output: Output) -> None:
    laser_pattern(options.laser)
    shake_of(options.shake)
    setting = closed_loop.Setting(
        observer=options.observer,
        sensor=options.sensor,
        laser=options.laser,
        shake=options.shake,
        seed=options.seed,
        warm_up_s=options.warm_up,
        duration_s=180.0 if options.duration is None else options.duration,
        shifted=options.shifted,
    )

    def draw(trial: closed_loop.Trial) -> None:
        print(f"{trial.sea}: done", file=sys.stderr, flush=True)
        output.write("closed_loop", trial.rows())
        if output.figures:
            from evidence.closed_loop_figure import hook_motion  # matplotlib only when it is wanted

            shaken = f"_{setting.shake}" if setting.shake else ""
            hook_motion(output.folder / f"hook_{trial.sea}_{setting.sensor}{shaken}.png", trial)

    seas = options.seas or closed_loop.DEFAULT_SEAS
    print(closed_loop.report(closed_loop.run(seas, setting, options.replay, draw)))


def run_all(options: argparse.Namespace, output: Output) -> None:
    options.scenarios = ()
    for command in (run_headline, run_rock):
        command(options, output)


# --- command line ----------------------------------------------------------------------------------------------------


def _common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=Path, default=CHECKOUT / "evidence", metavar="DIR", help="default: evidence/")
    parser.add_argument("--no-figures", action="store_true")


def _records(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seeds", type=_count, default=3, metavar="N", help="records per scenario (default 3)")
    parser.add_argument("--jobs", type=_count, default=1, metavar="N", help="processes (default 1)")
    parser.add_argument(
        "--estimators",
        nargs="+",
        default=estimators.NAMES,
        choices=estimators.NAMES,
        metavar="NAME",
        help=f"of {', '.join(estimators.NAMES)} (default: all)",
    )
    _observer(parser)


def _observer(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--observer", default=estimators.OBSERVERS[-1], choices=estimators.OBSERVERS, help="in the table of figures"
    )


def _duration(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--duration", type=_positive, metavar="S", help="of a record (default: the scenario's own)")


def _rate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rate", type=_positive, default=20.0, metavar="HZ", help="of the IMU (default 20)")


def _scenarios(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenarios", nargs="*", metavar="SCENARIO", help=f"of {', '.join(scenarios.NAMES)}")


def _one_setting(parser: argparse.ArgumentParser) -> None:
    _scenarios(parser)
    parser.add_argument("--sensor", default="A", choices=sorted(SENSORS), help="its errors (default A)")
    parser.add_argument(
        "--tilt",
        default="noisy",
        choices=get_args(scenarios.Tilt),
        help="none: a level vessel; exact: its attitude is known without error (default noisy)",
    )
    parser.add_argument(
        "--laser", default="off", metavar="PATTERN", help="on, off (default), 50%%, or START+LENGTH,... in seconds"
    )
    parser.add_argument("--from", dest="scored_from", type=_positive, default=300.0, metavar="S", help="scored (300)")
    for add in (_rate, _duration, _records, _common):
        add(parser)


def _headline(parser: argparse.ArgumentParser) -> None:
    for add in (_scenarios, _records, _common):
        add(parser)


def _rock(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--shake", action="store_true", help="on a hull that shakes, with body rates and without")
    for add in (_records, _duration, _common):
        add(parser)


def _table(parser: argparse.ArgumentParser) -> None:
    for add in (_observer, _common):
        add(parser)


def _shaken(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--shake", default=NONE, metavar="NAME", help="what shakes the sensors besides")


def _limits(parser: argparse.ArgumentParser) -> None:
    for add in (_rate, _shaken, _common):
        add(parser)


def _gates(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--set", action="store_true", help="to what is measured now, for every observer there is")
    parser.add_argument("--jobs", type=_count, default=1, metavar="N", help="processes (default 1)")
    _common(parser)


def _closed_loop(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("seas", nargs="*", metavar="SEA", help=f"default {' '.join(closed_loop.DEFAULT_SEAS)}")
    parser.add_argument("--replay", action="store_true", help="without sockets, faster than real time")
    parser.add_argument("--sensor", default="A", choices=sorted(SENSORS), help="its errors (default A)")
    parser.add_argument("--laser", default="off", metavar="PATTERN", help="on, off (default), 50%%")
    _shaken(parser)
    parser.add_argument("--seed", type=_count, default=1, help="of sea and sensors")
    parser.add_argument(
        "--warm-up", type=_positive, default=closed_loop.SCORED_FROM_S, metavar="S", help="not scored (default 300)"
    )
    parser.add_argument("--shifted", action="store_true", help="a daemon with [compensation] lead_s as well; live only")
    for add in (_observer, _duration, _common):
        add(parser)


def _correction(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seeds", type=_count, default=3, metavar="N", help="records per trial (default 3)")
    parser.add_argument("--jobs", type=_count, default=1, metavar="N", help="processes (default 1)")
    _common(parser)


def _faults(parser: argparse.ArgumentParser) -> None:
    plan = faults.Plan()
    parser.add_argument("disasters", nargs="*", metavar="DISASTER", help="default: all; see --list")
    parser.add_argument("--list", action="store_true", help="name them and say what they are")
    parser.add_argument("--seas", nargs="+", default=faults.SEAS, choices=scenarios.SIMULATED, metavar="SEA")
    parser.add_argument("--rates", nargs="+", type=_positive, default=faults.RATES_HZ, metavar="HZ")
    parser.add_argument("--seeds", type=_count, default=1, metavar="N", help="records of each sea (default 1)")
    parser.add_argument("--first-seed", type=_count, default=1, metavar="N", help="of them (default 1)")
    parser.add_argument("--at", type=_positive, default=plan.at_s, metavar="S", help=f"it happens ({plan.at_s:g})")
    parser.add_argument("--duration", type=_positive, default=plan.duration_s, metavar="S", help="of a record")
    parser.add_argument("--jobs", type=_count, default=1, metavar="N", help="processes (default 1)")
    parser.add_argument("--detail", action="store_true", help="every run by itself as well, with its reasons")
    _common(parser)


def _shake(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shakes", nargs="*", metavar="NAME", help=f"of {', '.join(shake.QUESTIONS)} (default: all)")
    asked_about = "default: those that are asked about"
    parser.add_argument("--seas", nargs="+", default=(), choices=scenarios.NAMES, metavar="SEA", help=asked_about)
    parser.add_argument("--rates", nargs="+", type=_positive, default=(), metavar="HZ", help=asked_about)
    parser.add_argument("--seeds", type=_count, default=1, metavar="N", help="records of each (default 1)")
    parser.add_argument("--jobs", type=_count, default=1, metavar="N", help="processes (default 1)")
    for add in (_duration, _common):
        add(parser)


def _runs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--runs", type=_count, default=50, metavar="N", help="Monte-Carlo runs (default 50)")
    parser.add_argument("--shake", action="store_true", help="on a hull that shakes, beside one that does not")
    parser.add_argument("--jobs", type=_count, default=1, metavar="N", help="processes (default 1)")
    for add in (_duration, _common):
        add(parser)


class Command(NamedTuple):
    """A subcommand."""

    run: Callable[[argparse.Namespace, Output], None]
    words: Callable[[argparse.ArgumentParser], None]
    """Adds its options."""
    help: str


COMMANDS: dict[str, Command] = {
    "heave": Command(run_heave, _one_setting, "wave trains and irregular seas, simulated, in one setting"),
    "real": Command(run_real, _one_setting, "real records, in one setting"),
    "headline": Command(run_headline, _headline, "every scenario and setting that a figure is asked for"),
    "table": Command(run_table, _table, "the asked figures out of the results"),
    "limits": Command(run_limits, _limits, "the least errors that are possible"),
    "gates": Command(run_gates, _gates, "short runs against their regression gates"),
    "rock": Command(run_rock, _rock, "roll and pitch, simulated"),
    "hull": Command(run_hull, _runs, "deformation between two IMUs, simulated"),
    "attitude": Command(run_attitude, _runs, "heave and pitch of a foil-assisted catamaran, simulated"),
    "correction": Command(run_correction, _correction, "the learned correction while a network is in use"),
    "faults": Command(run_faults, _faults, "what is published while things go wrong"),
    "shake": Command(run_shake, _shake, "heave on a hull that shakes: limit, ours, textbook, what is asked"),
    "closed-loop": Command(run_closed_loop, _closed_loop, "hook motion under a winch driven by the stream"),
    "all": Command(run_all, _rock, "headline and rock"),
}


def _setting(options: argparse.Namespace) -> Setting:
    laser_pattern(options.laser)
    return Setting(
        sensor=options.sensor,
        tilt=options.tilt,
        rate_hz=options.rate,
        laser=options.laser,
        duration_s=options.duration,
        scored_from_s=options.scored_from,
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    commands = parser.add_subparsers(dest="command", required=True)
    for name, command in COMMANDS.items():
        command.words(commands.add_parser(name, help=command.help))
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
    started = time.monotonic()
    try:
        COMMANDS[options.command].run(options, Output(options.out, not options.no_figures))
    except (ValueError, OSError, RuntimeError) as error:
        print(f"accuracy: {error}", file=sys.stderr)
        return 1
    print(f"\nResults in {options.out}; it took {time.monotonic() - started:.0f} s.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
