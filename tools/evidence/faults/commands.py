"""tools/accuracy.py faults: what is published while things go wrong."""

from __future__ import annotations

import sys

from evidence import scenarios
from evidence.commands import Command, Options, Parser, add_common, add_duration, add_jobs, add_seeds, count, positive
from evidence.faults import judge, table
from evidence.faults.disasters import DISASTERS
from evidence.results import Output, Report
from heaved.simulate import directional


def run_faults(options: Options, output: Output) -> Report:
    """
    Raises:
        ValueError: a disaster is not known, or begins too late.
    """
    if unknown := [name for name in options.disasters if name not in DISASTERS]:
        raise ValueError(f"unknown disaster {unknown[0]!r}: choose from {', '.join(DISASTERS)}")
    if options.list:
        return Report("\n".join(f"{name:24} {disaster.what}" for name, disaster in DISASTERS.items()))
    least_s = options.at + 2.0 * judge.LAST_S
    if options.duration < least_s:
        raise ValueError(f"a disaster at {options.at:g} s needs a --duration of {least_s:g} s")
    plan = judge.Plan(at_s=options.at, duration_s=options.duration)
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    todo = judge.tasks(options.disasters or DISASTERS, options.seas, options.rates, seeds, plan)

    def tell(outcome: judge.Outcome) -> None:
        task = outcome.task
        print(f"{task.name}, {task.sea}, {task.rate_hz:g} Hz, record {task.seed}: done", file=sys.stderr, flush=True)
        output.write("fault", [outcome])

    return Report(table.report(judge.run_all(todo, options.jobs, tell), options.detail), tuple(seeds))


def _faults(parser: Parser) -> None:
    plan = judge.Plan()
    parser.add_argument("disasters", nargs="*", metavar="DISASTER", help="default: all; see --list")
    parser.add_argument("--list", action="store_true", help="name them and say what they are")
    seas = (*scenarios.SIMULATED, *directional.NAMES)
    parser.add_argument("--seas", nargs="+", default=judge.SEAS, choices=seas, metavar="SEA")
    parser.add_argument("--rates", nargs="+", type=positive, default=judge.RATES_HZ, metavar="HZ")
    parser.add_argument("--first-seed", type=count, default=1, metavar="N", help="of the records (default 1)")
    parser.add_argument("--at", type=positive, default=plan.at_s, metavar="S", help=f"it happens ({plan.at_s:g})")
    parser.add_argument("--detail", action="store_true", help="every run by itself as well, with its reasons")
    add_duration(parser, plan.duration_s)
    add_seeds(parser, 1)
    for add in (add_jobs, add_common):
        add(parser)


COMMANDS = {"faults": Command(run_faults, _faults, "what is published while things go wrong")}
