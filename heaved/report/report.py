"""A recording in, a report out: the replay, what is taken down of it, the page and its figures."""

from __future__ import annotations

import hashlib
import os
from math import inf
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.replay.replay import replaying
from heaved.report.collect import Collector
from heaved.report.findings import Findings, Source, findings

if TYPE_CHECKING:
    from pathlib import Path

    from heaved.config import Config
    from heaved.replay.live import RecordedRun
    from heaved.replay.replay import Progress, Run

HASHED_BYTES: Final = 1 << 20
"""Of the recording, at a time."""
NO_MATPLOTLIB: Final = "the figures of a report need matplotlib: pip install 'heaved[report]'"


class ReportError(Exception):
    """There is no report; the message says why and what to do."""


def report(
    source: Path,
    out: Path,
    config: Config | None,
    *,
    made: str,
    command: str,
    config_name: str = "",
    png_directory: Path | None = None,
    until_s: float = inf,
    progress: Progress | None = None,
) -> Findings:
    """Run ``source`` through the pipeline and write the page ``out``; the figures also as PNG into a directory.

    config: None: of what a daemon has recorded, as it was recorded; of a CSV, the defaults.
    made: when, for the page. command: that makes the same report again. config_name: the file of ``config``; empty:
    there is none, all of it is default.

    Raises:
        RecordingError, RecordedError: the recording is malformed; nothing is written.
        ReportError: matplotlib is missing, or something cannot be written.
    """
    # First of all: who lacks it shall not wait for the whole replay to be told.
    try:
        from heaved.report import figures, page
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "matplotlib":
            raise
        raise ReportError(NO_MATPLOTLIB) from error
    if out.exists() and source.exists() and out.samefile(source):
        raise ReportError(f"{out} is the recording itself: name another file with -o")
    _check_writable(out)
    if png_directory is not None:
        _make(png_directory)
    with replaying(source, config) as run:
        config = run.config
        collector = followed(run, until_s=until_s, progress=progress)
        columns, learned = run.recording.columns, run.pipeline.summary()
    found = findings(
        collector,
        source=_described(source, columns),
        made=made,
        command=_as_text(command),
        config=config,
        config_name=_as_text(config_name),
        summary=run.summary(),
        learned=learned,
    )
    drawings = figures.draw(collector, found, with_png=png_directory is not None)
    _write(out, page.page(found, {key: drawing.svg for key, drawing in drawings.items()}, config).encode())
    if png_directory is not None:
        for key, drawing in drawings.items():
            _write(png_directory / f"{key}.png", drawing.png)
    return found


def followed(run: Run | RecordedRun, *, until_s: float = inf, progress: Progress | None = None) -> Collector:
    """Take a replay to its end, and down what it gives.

    Raises:
        RecordingError, RecordedError: the recording is malformed.
    """
    collector = Collector(run.config)
    for sample, frame in run.steps(until_s=until_s, progress=progress):
        collector.take(run, sample, frame)
    collector.finish()
    return collector


def json_text(found: Findings) -> str:
    """All numbers as one JSON object; what is not known is null."""
    return msgspec.json.format(msgspec.json.encode(found), indent=2).decode()


def _as_text(name: str) -> str:
    """A name of a file, which may hold bytes that are no text and have no place in JSON."""
    return name.encode("utf-8", "replace").decode()


def _described(source: Path, columns: tuple[str, ...]) -> Source:
    """What can be said of the file; of a pipe, that cannot be read twice, no more than its name."""
    if not source.is_file():
        return Source(name=_as_text(source.name), size_bytes=0, sha256="", columns=columns)
    digest = hashlib.sha256()
    try:
        with source.open("rb") as file:
            while piece := file.read(HASHED_BYTES):
                digest.update(piece)
            size = file.tell()
    except OSError as error:
        raise ReportError(f"{source}: cannot be read again for its hash: {error.strerror or error}") from error
    return Source(name=_as_text(source.name), size_bytes=size, sha256=digest.hexdigest(), columns=columns)


def _check_writable(out: Path) -> None:
    """Before anything is done.

    Raises:
        ReportError: it cannot be written.
    """
    directory = out.parent
    if out.is_dir():
        raise ReportError(f"{out}: is a directory; name a file with -o")
    if not directory.is_dir():
        raise ReportError(f"{directory}: there is no such directory; make it, or name another file with -o")
    if not os.access(directory, os.W_OK):
        raise ReportError(f"{directory}: cannot be written to; name another file with -o")


def _make(directory: Path) -> None:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ReportError(f"{directory}: cannot be made: {error.strerror or error}; name another with --png") from error


def _write(path: Path, content: bytes) -> None:
    """A file that appears under its name only when it is whole; pipes and devices are written as they are."""
    is_special = path.exists() and not path.is_file()
    target = path.resolve()
    partial = target if is_special else target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        partial.write_bytes(content)
        if not is_special:
            partial.replace(target)
    except OSError as error:
        raise ReportError(f"{path}: cannot be written: {error.strerror or error}; name another file with -o") from error
    finally:
        if not is_special:
            partial.unlink(missing_ok=True)
