"""tools/accuracy.py rock: roll and pitch ahead, and quiet windows."""

from __future__ import annotations

from typing import Final

from evidence.commands import Command, Options, Parser, add_common, add_duration, add_jobs, add_seeds, seeds_of
from evidence.results import CHECKOUT, Output, Report
from evidence.rock import direct, paper, quiescence, shaken

SHIP_RECORD: Final = CHECKOUT.parent / "shared" / "data" / "palmer" / "NBP1406_2014-08-01_seapath330.csv"
PAPER_S: Final = 240.0
DIRECT_S: Final = 600.0
QUIESCENCE_S: Final = 4000.0
SHAKEN_S: Final = 420.0


def run_rock(options: Options, output: Output) -> Report:
    """The paper's method, the direct predictor and quiet windows; or, on a hull that shakes, what gyroscopes add."""
    seeds = seeds_of(options)
    if options.shake:
        found = shaken.table(seeds, options.duration or SHAKEN_S, options.jobs)
        output.write("rock_shaken", found)
        return Report(shaken.report(found), tuple(seeds))
    rows = paper.table(seeds, options.duration or PAPER_S, options.jobs)
    output.write("rock", rows)
    duration_s = options.duration or DIRECT_S
    table = direct.table(seeds, duration_s, options.jobs)
    costs = direct.costs(seeds, duration_s, options.jobs)
    rates = direct.rates_table(seeds, duration_s, options.jobs)
    ship = direct.real(SHIP_RECORD) if SHIP_RECORD.exists() else []
    for part in (table, costs, rates, ship):
        output.write("rock", part)
    texts = [paper.report(rows), direct.report(table, costs, rates, ship)]
    if not ship:
        texts.append(f"real ship: skipped, there is no {SHIP_RECORD}")
    if options.duration is None or options.duration > quiescence.SCORED_FROM_S + 300.0:
        verdicts = quiescence.table(seeds, options.duration or QUIESCENCE_S, options.jobs)
        output.write("quiescence", verdicts)
        texts.append(quiescence.report(verdicts))
    if output.figures:
        paper.figure(output.folder / "rock.png")
        direct.figure(output.folder / "rock_direct.png", table)
    return Report("\n\n".join(texts), tuple(seeds))


def _rock(parser: Parser) -> None:
    parser.add_argument("--shake", action="store_true", help="on a hull that shakes, with body rates and without")
    for add in (add_seeds, add_jobs, add_duration, add_common):
        add(parser)


COMMANDS = {"rock": Command(run_rock, _rock, "roll and pitch, simulated")}
