#!/usr/bin/env python
"""Accuracy in figures, from the very pipeline of the daemon: tables to standard output, results and figures to files.

    tools/accuracy.py heave [T1 ... S6S] [--sensor A|B] [--laser off|50%|on] [--tilt none|exact|noisy] [--seeds 3]
    tools/accuracy.py real [Hebrides palmer flume static]    real records, where they are present
    tools/accuracy.py headline [SCENARIO ...]    every scenario and setting that a figure is asked for
    tools/accuracy.py table       those figures, asked and measured, out of OUT/results.jsonl
    tools/accuracy.py limits [--shake NAME]    the least error that is possible, alone
    tools/accuracy.py channels [S6S-bow-0.8 ... palmer]    the least error if roll and pitch are looked at, and ours
    tools/accuracy.py gates [--set]    short runs against their regression gates
    tools/accuracy.py shake [line-3.1 slams] [--seas S6] [--rates 20]    heave while something shakes the sensor
    tools/accuracy.py correction [--seeds 3]  the learned correction: wrong physics, right, a network in use
    tools/accuracy.py rock [--shake]    roll and pitch ahead: the paper's method, the direct predictor, quiet windows;
                                  or what a gyroscope adds to it on a hull that shakes
    tools/accuracy.py hull [--runs 50] [--shake]    deformation between two IMUs, 600 s a run
    tools/accuracy.py attitude [--runs 50] [--shake]    heave and pitch of a foil-assisted catamaran
    tools/accuracy.py crane [--seeds 3]    heave of the tip of a crane, parked and at work
    tools/accuracy.py laser-geometry [--seeds 2]    a laser elsewhere than at the IMU, configured so and not
    tools/accuracy.py faults [DISASTER ...] [--seas S6] [--rates 20]    what is published while things go wrong
    tools/accuracy.py closed-loop [S6 T3] [--replay]    a hook under a winch that the stream drives, in real time
    tools/accuracy.py results [WORD ...] [--list]    run all (or those with these words) that RESULTS.md holds

Beside the tables, OUT/results.jsonl gets one more line per result, with what made it, and OUT the figures. Of two lines
for the same, the later one counts. ``--jobs 2`` runs two records at a time; ``--record`` puts what is printed into
tools/RESULTS.md, in the place of what the same command has put there before.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

# The matrices are small: threads cost more than they give. To be said before numpy is loaded, here and in processes.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["OMP_NUM_THREADS"] = "1"

from typing import TYPE_CHECKING

from evidence import channels, craft, crane, hull, laser_geometry, results
from evidence.closed_loop import commands as closed_loop
from evidence.commands import Command, Options, Parser, add_jobs
from evidence.faults import commands as faults
from evidence.heave import commands as heave
from evidence.results import CHECKOUT, Output, Report
from evidence.rock import commands as rock

if TYPE_CHECKING:
    from collections.abc import Sequence

RECORDED: tuple[tuple[str, str], ...] = (
    ("accuracy.py gates", "1 min"),
    ("accuracy.py headline --estimators sea --seeds 4", "35 min"),
    ("accuracy.py headline --estimators harmonic --seeds 4", "15 min"),
    ("accuracy.py heave T1 T2 T3 --laser 50% --from 200", "10 min"),
    ("accuracy.py shake --rates 20 --seeds 2", "25 min"),
    ("accuracy.py shake --rates 100", "60 min"),
    ("accuracy.py channels S6S-bow-0.8 SL-bow-0.8 S6S-turn-0.8 SL-turn-0.8 palmer", "3 min"),
    ("accuracy.py channels --limits-only", "2 min"),
    ("accuracy.py correction", "20 min"),
    ("accuracy.py rock --seeds 2", "25 min"),
    ("accuracy.py rock --shake", "15 min"),
    ("accuracy.py hull", "45 min"),
    ("accuracy.py hull --shake --runs 16", "15 min"),
    ("accuracy.py attitude", "20 min"),
    ("accuracy.py attitude --shake --runs 16", "10 min"),
    ("accuracy.py crane --seeds 1", "4 min"),
    ("accuracy.py faults --seas S6 --rates 20", "15 min"),
    ("accuracy.py closed-loop --duration 120", "14 min, in real time: on a quiet machine"),
    ("accuracy.py closed-loop S6 --replay --shake line-3.1 --duration 120", "3 min"),
    ("bench.py replay", "2 min, on a quiet machine"),
    ("bench.py rock", "5 min, on a quiet machine"),
    ("bench.py hull", "1 min, on a quiet machine"),
    ("bench.py fusion", "1 min, on a quiet machine"),
    ("bench.py sigma", "2 min, on a quiet machine"),
    ("bench.py training", "1 min, on a quiet machine"),
    ("latency.py --duration 30", "1 min, in real time: on a quiet machine"),
    ("latency.py --duration 30 --compare-training", "4 min, in real time: on a quiet machine"),
)
"""What RESULTS.md holds, and about how long each takes with one process: a guess until its section says it."""


def run_results(options: Options, output: Output) -> Report:
    """Every command of RESULTS.md, one after the other, each in a process of its own.

    Raises:
        ValueError: no command has these words.
        RuntimeError: one of them has failed; those after it were run all the same.
    """
    chosen = [(line, long) for line, long in RECORDED if all(word in line for word in options.words)]
    if not chosen:
        raise ValueError(f"no command of RESULTS.md has {' '.join(options.words)!r} in it")
    if options.list:
        return Report("\n".join(f"tools/{line:70} {long}" for line, long in chosen))
    failed = []
    for line, _ in chosen:
        program, *words = line.split()
        if program == "accuracy.py":
            words += ["--out", str(output.folder)]
            words += ["--jobs", str(options.jobs)] if "closed-loop" not in words else []
        print(f"tools/{line}", file=sys.stderr, flush=True)
        if subprocess.run(
            [sys.executable, str(CHECKOUT / "tools" / program), *words, "--record"], check=False
        ).returncode:
            failed.append(line)
    if failed:
        raise RuntimeError(f"failed: {'; '.join(failed)}")
    return Report(f"{len(chosen)} sections of {results.RESULTS}")


def _results(parser: Parser) -> None:
    parser.add_argument("words", nargs="*", metavar="WORD", help="only commands that have all of these in them")
    parser.add_argument("--list", action="store_true", help="name them and say how long they take")
    parser.add_argument("--out", type=Path, default=CHECKOUT / "evidence", metavar="DIR", help="default: evidence/")
    parser.set_defaults(no_figures=False, record=False)
    add_jobs(parser)


COMMANDS: dict[str, Command] = {
    **heave.COMMANDS,
    **channels.COMMANDS,
    **rock.COMMANDS,
    **hull.COMMANDS,
    **craft.COMMANDS,
    **crane.COMMANDS,
    **laser_geometry.COMMANDS,
    **faults.COMMANDS,
    **closed_loop.COMMANDS,
    "results": Command(run_results, _results, "run the commands of RESULTS.md again"),
}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    commands = parser.add_subparsers(dest="command", required=True)
    for name, command in COMMANDS.items():
        command.words(commands.add_parser(name, help=command.help))
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; 0 when everything is written."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    options = _parser().parse_args(words)
    started = time.monotonic()
    try:
        output = Output(options.out, not options.no_figures)
        report = COMMANDS[options.command].run(options, output)
        print(report.text)
        took_s = time.monotonic() - started
        if options.record:
            results.record(__file__, words, report, output.made_with, took_s)
    except (ValueError, OSError, RuntimeError) as error:
        print(f"accuracy: {error}", file=sys.stderr)
        return 1
    print(f"\nResults in {options.out}; it took {took_s:.0f} s.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
