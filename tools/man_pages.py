#!/usr/bin/env python3
"""Make the man pages of the manual: tools/man DIR. Needs heaved and what it depends on, as in .venv/bin/python."""

from __future__ import annotations

import os
import sys
from datetime import UTC, datetime
from pathlib import Path

from heaved import __version__
from heaved.cli.described import tables
from heaved.manual.man_page import man_page, page_name
from heaved.manual.topics import filled, topics


def main(arguments: list[str]) -> int:
    if len(arguments) != 1:
        sys.stderr.write("usage: tools/man DIR\n")
        return 1
    made, known = tables(), topics()
    # Of a reproducible build, the time that it is told.
    made_s = float(os.environ.get("SOURCE_DATE_EPOCH", datetime.now(UTC).timestamp()))
    date = datetime.fromtimestamp(made_s, UTC).date().isoformat()
    for topic in known.values():
        name, section = page_name(topic.name)
        path = Path(arguments[0]) / f"man{section}" / f"{name}.{section}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(man_page(topic, filled(topic, made), __version__, date, known), encoding="utf-8")
        sys.stdout.write(f"{path}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
