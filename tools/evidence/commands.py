"""What the subcommands of tools/accuracy.py have in common: options, processes, and how one is registered.

Each group of evidence has its own ``COMMANDS``.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor, as_completed
from math import inf
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from evidence.results import CHECKOUT, Output, Report

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

Task = TypeVar("Task")
Found = TypeVar("Found")
Parser = argparse.ArgumentParser
Options = argparse.Namespace


class Command(NamedTuple):
    """A subcommand."""

    run: Callable[[Options, Output], Report]
    words: Callable[[Parser], None]
    """Adds its options."""
    help: str


# --- options ---------------------------------------------------------------------------------------------------------


def positive(text: str) -> float:
    """A number above 0."""
    value = float(text)
    if not 0.0 < value < inf:
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value


def count(text: str) -> int:
    """A whole number, at least 1."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text}: at least 1 is needed")
    return value


def add_common(parser: Parser) -> None:
    """Where the results go."""
    parser.add_argument("--out", type=Path, default=CHECKOUT / "evidence", metavar="DIR", help="default: evidence/")
    parser.add_argument("--no-figures", action="store_true")
    parser.add_argument("--record", action="store_true", help="put what is printed into tools/RESULTS.md")


def add_jobs(parser: Parser) -> None:
    """How many processes share the work."""
    parser.add_argument("--jobs", type=count, default=1, metavar="N", help="processes (default 1)")


def add_seeds(parser: Parser, default: int = 3) -> None:
    """How many records."""
    parser.add_argument(
        "--seeds", type=count, default=default, metavar="N", help=f"records of each (default {default})"
    )


def add_duration(parser: Parser, default: float | None = None) -> None:
    """How long a record is."""
    parser.add_argument(
        "--duration", type=positive, default=default, metavar="S", help="of a record (default: the scenario's own)"
    )


def add_runs(parser: Parser) -> None:
    """A Monte-Carlo of so many runs, undisturbed or shaken."""
    parser.add_argument("--runs", type=count, default=50, metavar="N", help="Monte-Carlo runs (default 50)")
    parser.add_argument("--shake", action="store_true", help="on a hull that shakes, beside one that does not")
    for add in (add_jobs, add_duration, add_common):
        add(parser)


def seeds_of(options: Options) -> range:
    """The seeds that ``--seeds`` asks for."""
    return range(1, options.seeds + 1)


# --- processes -------------------------------------------------------------------------------------------------------


def completed(
    work: Callable[[Task], Found],
    todo: Sequence[Task],
    jobs: int = 1,
    prepare: Callable[[], None] | None = None,
) -> Iterator[tuple[int, Found]]:
    """Do all of ``todo`` in ``jobs`` processes: the place of each in it and what was found, as soon as it is.

    prepare: called in each process before its first task; without it a single job is done in this process.
    """
    if jobs == 1 and prepare is None:
        yield from enumerate(map(work, todo))
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=prepare) as pool:
        pending = {pool.submit(work, task): place for place, task in enumerate(todo)}
        try:
            for done in as_completed(pending):
                yield pending[done], done.result()
        finally:
            pool.shutdown(cancel_futures=True)


def in_order(work: Callable[[Task], Found], todo: Sequence[Task], jobs: int = 1) -> list[Found]:
    """Do all of ``todo`` in ``jobs`` processes; what was found, in its order."""
    found = dict(completed(work, todo, jobs))
    return [found[place] for place in range(len(todo))]
