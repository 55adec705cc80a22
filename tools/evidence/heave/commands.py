"""tools/accuracy.py heave, real, headline, table, limits, gates, shake, correction."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, get_args

import msgspec

from evidence import scenarios
from evidence.commands import (
    Command,
    Options,
    Parser,
    add_common,
    add_duration,
    add_jobs,
    add_seeds,
    positive,
    seeds_of,
)
from evidence.heave import asked, correction, estimators, evaluate, gates, left_over, shake, tables, wrong_physics
from evidence.results import LINES, Output, Report
from evidence.scenarios import Setting
from heaved.simulate import directional
from heaved.simulate.sensors import SENSORS, laser_pattern
from heaved.simulate.shaking import NONE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from evidence.heave.summary import Judged, Result


def run_heave(options: Options, output: Output) -> Report:
    """Simulated scenarios in one setting."""
    return _evaluated(
        [(name, _setting(options)) for name in _chosen(options, scenarios.SIMULATED, directional.NAMES)],
        options,
        output,
    )


def run_real(options: Options, output: Output) -> Report:
    """Every file is a record of its own, so --seeds does not matter here."""
    rows = [(name, _setting(options)) for name in _chosen(options, tuple(scenarios.REAL))]
    return _evaluated(rows, options, output)


def run_headline(options: Options, output: Output) -> Report:
    """All that a figure is asked for, and the table of what is asked."""
    names = _chosen(options, scenarios.NAMES)
    found = _evaluated([row for row in evaluate.HEADLINE if row[0] in names], options, output)
    return msgspec.structs.replace(found, text=f"{found.text}\n\n{run_table(options, output).text}")


def _chosen(options: Options, known: Sequence[str], besides: Sequence[str] = ()) -> Sequence[str]:
    """Scenarios that were named, all that are known if none was; those ``besides`` have to be named.

    Raises:
        ValueError: one of them is not known here.
    """
    if unknown := [name for name in options.scenarios if name not in (*known, *besides)]:
        raise ValueError(f"unknown scenario {unknown[0]!r}: choose from {', '.join((*known, *besides))}")
    return list(options.scenarios) or known


def _setting(options: Options) -> Setting:
    laser_pattern(options.laser)
    return Setting(
        sensor=options.sensor,
        tilt=options.tilt,
        rate_hz=options.rate,
        laser=options.laser,
        duration_s=options.duration,
        scored_from_s=options.scored_from,
    )


def _evaluated(rows: Sequence[tuple[str, Setting]], options: Options, output: Output) -> Report:
    """Run, write and draw."""
    present = [row for row in rows if row[0] not in scenarios.REAL or scenarios.files(row[0])]
    texts = [
        f"{name}: skipped, there are no records in {scenarios.DATA / scenarios.REAL[name]}"
        for name in dict.fromkeys(row[0] for row in rows if row not in present)
    ]
    todo = evaluate.tasks(present, tuple(options.estimators), options.seeds, output.folder if output.figures else None)
    results: list[Result] = []
    for found in evaluate.run_all(todo, options.jobs, _tell):
        output.write("heave", found)
        results += found
    if results:
        if output.figures:
            from evidence.heave.figures import draw_results

            draw_results(output.folder, results)
        texts.append(tables.report(results, evaluate.equal_tuning()))
    return Report("\n".join(texts), tuple(seeds_of(options)))


def _tell(record: Judged) -> None:
    how = record.setting
    shaken = f", {how.shake}" if how.shake else ""
    print(
        f"{record.scenario}{shaken}, sensor {how.sensor}, {how.rate_hz:g} Hz, record {record.seeds.waves}: done",
        file=sys.stderr,
        flush=True,
    )


def run_table(options: Options, output: Output) -> Report:
    """The asked figures out of the results that there are."""
    lines = [msgspec.json.decode(line) for line in (output.folder / LINES).read_bytes().splitlines()]
    return Report(asked.table(lines, options.observer))


def run_limits(options: Options, _: Output) -> Report:
    """
    Raises:
        ValueError: a disturbance is not known.
    """
    return Report(tables.limits_table(("A", "B", "C"), options.rate, options.shake))


def run_gates(options: Options, output: Output) -> Report:
    """
    Raises:
        ValueError: a gate does not hold.
    """
    observers = estimators.OBSERVERS if options.set else gates.load().observers
    todo = gates.tasks(observers)
    results = [result for row in evaluate.run_all(todo, options.jobs, _tell) for result in row]
    output.write("gate", results)
    if options.set:
        gates.save(gates.made_of(results, output.made_with.commit, observers))
    elif messages := gates.broken(gates.load().gates, results):
        raise ValueError("gates that do not hold:\n" + "\n".join(messages))
    seeds = tuple(sorted({task.seeds.waves for task in todo}))
    text = f"gates: set in {gates.FILE}" if options.set else "gates: all hold"
    return Report(f"{gates.table(gates.load().gates, results)}\n\n{text}", seeds)


def run_shake(options: Options, output: Output) -> Report:
    """
    Raises:
        ValueError: a disturbance is not known, or a record too short for it.
    """
    rows = shake.plan(options.shakes or shake.QUESTIONS, options.seas, options.rates, options.duration)
    todo = evaluate.tasks(rows, (shake.TEXTBOOK, shake.OURS), options.seeds)
    results: list[Result] = []
    for found in evaluate.run_all(todo, options.jobs, _tell):
        output.write("shake", found)
        results += found
    return Report(shake.report(results, rows), tuple(seeds_of(options)))


def run_correction(options: Options, output: Output) -> Report:
    """The learned correction: where the physics is wrong and where it is right, and while a network is in use."""
    seeds = seeds_of(options)
    lines = wrong_physics.table(seeds, options.jobs)
    output.write("wrong physics", lines)
    outcomes = correction.table(seeds, options.jobs)
    output.write("correction", outcomes)
    left = left_over.table(seeds[0], options.jobs)
    output.write("left over", left)
    parts = wrong_physics.report(lines), correction.report(outcomes), left_over.report(left)
    return Report("\n\n".join(parts), tuple(seeds))


# --- options ---------------------------------------------------------------------------------------------------------


def add_observer(parser: Parser) -> None:
    """Whose figures are the product's."""
    parser.add_argument(
        "--observer", default=estimators.OBSERVERS[-1], choices=estimators.OBSERVERS, help="in the table of figures"
    )


def _scenarios(parser: Parser) -> None:
    parser.add_argument("scenarios", nargs="*", metavar="SCENARIO", help=f"of {', '.join(scenarios.NAMES)}")


def _records(parser: Parser) -> None:
    parser.add_argument(
        "--estimators",
        nargs="+",
        default=estimators.NAMES,
        choices=estimators.NAMES,
        metavar="NAME",
        help=f"of {', '.join(estimators.NAMES)} (default: all)",
    )
    for add in (add_seeds, add_jobs, add_observer, add_common):
        add(parser)


def _rate(parser: Parser) -> None:
    parser.add_argument("--rate", type=positive, default=20.0, metavar="HZ", help="of the IMU (default 20)")


def _one_setting(parser: Parser) -> None:
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
    parser.add_argument("--from", dest="scored_from", type=positive, default=300.0, metavar="S", help="scored (300)")
    for add in (_rate, add_duration, _records):
        add(parser)


def _headline(parser: Parser) -> None:
    _scenarios(parser)
    _records(parser)


def _table(parser: Parser) -> None:
    add_observer(parser)
    add_common(parser)


def _limits(parser: Parser) -> None:
    parser.add_argument("--shake", default=NONE, metavar="NAME", help="what shakes the sensors besides")
    _rate(parser)
    add_common(parser)


def _gates(parser: Parser) -> None:
    parser.add_argument("--set", action="store_true", help="to what is measured now, for every observer there is")
    add_jobs(parser)
    add_common(parser)


def _shake(parser: Parser) -> None:
    parser.add_argument("shakes", nargs="*", metavar="NAME", help=f"of {', '.join(shake.QUESTIONS)} (default: all)")
    asked_about = "default: those that are asked about"
    parser.add_argument("--seas", nargs="+", default=(), choices=scenarios.NAMES, metavar="SEA", help=asked_about)
    parser.add_argument("--rates", nargs="+", type=positive, default=(), metavar="HZ", help=asked_about)
    add_seeds(parser, 1)
    for add in (add_jobs, add_duration, add_common):
        add(parser)


def _correction(parser: Parser) -> None:
    for add in (add_seeds, add_jobs, add_common):
        add(parser)


COMMANDS = {
    "heave": Command(run_heave, _one_setting, "wave trains and irregular seas, simulated, in one setting"),
    "real": Command(run_real, _one_setting, "real records, in one setting"),
    "headline": Command(run_headline, _headline, "every scenario and setting that a figure is asked for"),
    "table": Command(run_table, _table, "the asked figures out of the results"),
    "limits": Command(run_limits, _limits, "the least errors that are possible"),
    "gates": Command(run_gates, _gates, "short runs against their regression gates"),
    "shake": Command(run_shake, _shake, "heave on a hull that shakes: limit, ours, textbook, what is asked"),
    "correction": Command(
        run_correction, _correction, "the learned correction: wrong physics, right, a network in use"
    ),
}
