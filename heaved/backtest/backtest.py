"""A directory of recordings and some configurations in, a table and a page out; what is done is never done again."""

from __future__ import annotations

import hashlib
import os
import time
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from heaved import __version__
from heaved.backtest.compare import Compared, Row, compared
from heaved.backtest.page import page
from heaved.backtest.task import Result, Task, done_result, perform, write_whole
from heaved.backtest.units import BacktestError, Units, find_units
from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from heaved.config import Config

TABLE: Final = "backtest.parquet"
PAGE: Final = "backtest.html"
RESULTS: Final = "results"
"""Directory of one small file for each task."""
AS_RECORDED: Final = "as recorded"
"""Name of the configuration that is none: a daemon's own, and of a CSV the defaults."""
NOT_INSTALLED: Final = "a backtest needs Dask and pyarrow: pip install 'heaved[backtest]'"


class Failed(msgspec.Struct, frozen=True, kw_only=True):
    """A task that did."""

    source: str
    configuration: str
    reason: str


class Summary(msgspec.Struct, frozen=True, kw_only=True):
    """What a backtest did."""

    directory: str
    table: str
    page: str
    release: str
    recordings: int
    tasks: int
    """Recordings times configurations."""
    already: int
    """Done by an earlier run,"""
    done: int
    """by this one,"""
    failed: tuple[Failed, ...]
    """and not."""
    again: int
    """Times that a task was handed out once more, since its worker had died."""
    elapsed_s: float
    remark: str
    configurations: tuple[Compared, ...]

    def __str__(self) -> str:
        lost = f"; {self.again} times a task again, since its worker had died" if self.again else ""
        lines = [
            f"{self.recordings} recordings, {self.tasks} tasks: {self.done} done in {self.elapsed_s:.1f} s, "
            f"{self.already} already done, {len(self.failed)} failed{lost}",
            *([self.remark] if self.remark else []),
            *(f"failed: {one.source} with {one.configuration}: {one.reason}" for one in self.failed[:20]),
        ]
        if len(self.failed) > 20:
            lines.append(f"and {len(self.failed) - 20} more, which stand in {self.table}")
        return "\n".join(lines)


def backtest(
    directory: Path,
    out: Path,
    configs: Mapping[str, Config],
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    made: str,
    command: str,
    progress: Callable[[int, int], None] | None = None,
    work: Callable[[Task], Result] = perform,
) -> Summary:
    """Test all recordings of ``directory`` with each of ``configs``, by name; results go into the directory ``out``.

    configs: none: as recorded. scheduler: its address; None: ``workers`` processes of this machine, by default as many
    as processors may be used. made: when, UTC; command: that does the same again; both for the page.
    progress: is told how many tasks are done, of how many. work: what is done for each.

    What was done before a KeyboardInterrupt is kept, and is not done again.

    Raises:
        BacktestError: there is nothing to be done, or nobody to do it, or no place for the results.
    """
    begun_s = time.monotonic()
    need_dask()
    units = find_units(directory)
    out = _made(out, units)
    results_directory = str(out / RESULTS)
    given: dict[str, bytes | None] = {name: msgspec.json.encode(config) for name, config in configs.items()}
    tasks: dict[tuple[str, str], Task] = {}
    for source in units.names:
        for name, config in (given or {AS_RECORDED: None}).items():
            tasks[source, name] = Task(
                name=source,
                source=str(units.directory / source),
                config=config,
                config_sha256=hashlib.sha256(config or b"").hexdigest(),
                release=__version__,
                results=results_directory,
            )
    by_key = {task.key: task for task in tasks.values()}
    found = {key: result for key, task in by_key.items() if (result := done_result(task)) is not None}
    already = sum(task.key in found for task in tasks.values())
    again: list[Task] = []
    if missing := [task for key, task in by_key.items() if key not in found]:
        _done(missing, found, scheduler, workers, work, again.append, progress)
    rows = [
        Row(
            source=printable(source),
            configuration=printable(name),
            configuration_sha256=task.config_sha256,
            release=task.release,
            result=found[task.key],
        )
        for (source, name), task in tasks.items()
    ]
    return _written(rows, units, out, made, command, already=already, again=len(again), begun_s=begun_s)


def _done(
    missing: list[Task],
    found: dict[str, Result],
    scheduler: str | None,
    workers: int | None,
    work: Callable[[Task], Result],
    again: Callable[[Task], None],
    progress: Callable[[int, int], None] | None,
) -> None:
    """Have tasks done, and their results put to those that are found."""
    from heaved.backtest.distribute import distributed, local_workers, remote_workers

    missing = sorted(missing, key=_size, reverse=True)  # The longest first: none is begun when all others are over.
    total = len(found) + len(missing)
    if progress is not None:
        progress(len(found), total)
    count = min(workers or len(os.sched_getaffinity(0)), len(missing))
    with (
        local_workers(count) if scheduler is None else remote_workers(scheduler) as client,
        closing(distributed(client, missing, work, again)) as coming,
    ):
        for task, result in coming:
            found[task.key] = result
            if progress is not None:
                progress(len(found), total)


def _size(task: Task) -> int:
    try:
        return Path(task.source).stat().st_size
    except OSError:
        return 0


def _written(
    rows: list[Row], units: Units, out: Path, made: str, command: str, *, already: int, again: int, begun_s: float
) -> Summary:
    from heaved.backtest.table import parquet

    side_by_side = compared(rows)
    text = page(rows, side_by_side, directory=str(units.directory), made=made, release=__version__, command=command)
    try:
        write_whole(out / TABLE, parquet(rows))
        write_whole(out / PAGE, text.encode("utf-8", "replace"))
    except OSError as error:
        raise BacktestError(f"{out}: cannot be written to: {error.strerror or error}; name another with -o") from error
    failed = tuple(
        Failed(source=row.source, configuration=row.configuration, reason=row.result.failure)
        for row in rows
        if row.result.failure
    )
    return Summary(
        directory=printable(str(units.directory)),
        table=printable(str(out / TABLE)),
        page=printable(str(out / PAGE)),
        release=__version__,
        recordings=len(units.names),
        tasks=len(rows),
        already=already,
        done=len(rows) - already - len(failed),
        failed=failed,
        again=again,
        elapsed_s=time.monotonic() - begun_s,
        remark=printable(units.remark),
        configurations=tuple(side_by_side),
    )


def named(files: list[Path]) -> dict[str, Path]:
    """Configuration files by the names that the results give them.

    Raises:
        BacktestError: two have one name.
    """
    found: dict[str, Path] = {}
    for file in files:
        other = found.setdefault(file.stem, file)
        if other is not file:
            raise BacktestError(
                f"{file} and {other}: two configurations of the name {file.stem}: the results could not be told apart; "
                "rename one"
            )
    return found


def need_dask() -> None:
    """
    Raises:
        BacktestError: what it needs is not installed.
    """
    import importlib.util

    if any(importlib.util.find_spec(name) is None for name in ("dask", "distributed", "pyarrow")):
        raise BacktestError(NOT_INSTALLED)


def _made(out: Path, units: Units) -> Path:
    """The directory for results, which must not be found by the next search for recordings.

    Raises:
        BacktestError: it is within the recordings, or cannot be used.
    """
    if out.resolve().is_relative_to(units.directory):
        raise BacktestError(f"{out}: is within {units.directory}, which is tested: name a directory beside it with -o")
    if out.exists() and not out.is_dir():
        raise BacktestError(f"{out}: is a file: name a directory with -o")
    try:
        (out / RESULTS).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BacktestError(f"{out}: cannot be made: {error.strerror or error}; name another with -o") from error
    if not os.access(out, os.W_OK) or not os.access(out / RESULTS, os.W_OK):
        raise BacktestError(f"{out}: cannot be written to; name another with -o")
    return out.resolve()
