#!/usr/bin/env python
"""The daemon's process against slaves, lines, disks and clients that misbehave, for as long as wanted.

    python tools/campaign.py --seed 1 --minutes 25
    python tools/campaign.py --only "TCP" --minutes 3

``python -m heaved run`` polls slaves made of sockets and pseudo-terminals, which answer from the simulator's motion;
five more do nothing but answer wrongly, some hundred times a second each. A client of the stream knows the truth: a
heave that is published as valid must be right within four of its standard deviations, roll and pitch within a degree,
and fresh readings must flow within a second after the device is back. Then the recording is read: no row is missing,
no reading may be of another moment than that which it was recorded for. As root, disks are filled and made read-only.
The system's clock is left alone: the daemon is given one that is stepped.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from evidence import results
from evidence.campaign.run import Settings, campaign, table
from evidence.commands import positive
from evidence.results import Report


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=positive, default=20.0, metavar="M", help="of faults (default 20)")
    parser.add_argument("--sea", default="S4", help="default S4")
    parser.add_argument("--only", action="append", default=[], metavar="WORD", help="parts or faults with this word")
    parser.add_argument("--folder", type=Path, help="keep configuration, log and recordings there")
    parser.add_argument("--record", action="store_true", help="put the table into tools/RESULTS.md")
    options = parser.parse_args()
    made_with, started = results.provenance(), time.monotonic()
    settings = Settings(seed=options.seed, minutes=options.minutes, sea=options.sea, only=tuple(options.only))
    if options.folder is not None:
        options.folder.mkdir(parents=True, exist_ok=True)
    found = campaign(settings, lambda text: print(text, file=sys.stderr, flush=True), options.folder)
    report = Report(table(found), (options.seed,))
    print(report.text)
    if options.record:
        results.record(__file__, sys.argv[1:], report, made_with, time.monotonic() - started)
    return 1 if found.failures else 0


if __name__ == "__main__":
    raise SystemExit(main())
