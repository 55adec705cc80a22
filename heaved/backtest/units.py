"""What of a directory is a recording, and what of it is one piece of work.

One file is one unit: a CSV, or one hour of a daemon's recording (a file of its table ``samples``). An hour begins as a
restart of the daemon would have at its beginning, with what stands in the file itself. So what comes of it depends on
this file and on the configuration alone: not on its neighbours, nor on who computes it, nor on the order. The price is
that the filters settle once an hour, and that the last minute of each has no delayed heave; it is the same for every
configuration.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

import msgspec

from heaved.recorder.found import SUFFIXES
from heaved.recorder.layout import FRAMES

CSV: Final = ".csv"
MADE_BY_REPLAY: Final = ".heaved.csv"
"""What ``heaved replay`` writes beside a recording: no recording itself."""
NAMED: Final = 3
"""Files that are told of by name."""


class BacktestError(Exception):
    """There is no backtest; the message says why and what to do."""


class UnreachableError(BacktestError):
    """There is nobody who does the work."""


class Units(msgspec.Struct, frozen=True, kw_only=True):
    """What was found in a directory."""

    directory: Path
    """Without symbolic links, absolute."""
    names: tuple[str, ...]
    """Of the recordings, relative to it, in order."""
    left_out: tuple[str, ...]
    """Files that are no recordings by their name, likewise."""

    @property
    def remark(self) -> str:
        """On what was left out; empty: nothing."""
        if not self.left_out:
            return ""
        named = ", ".join(self.left_out[:NAMED])
        more = len(self.left_out) - NAMED
        return f"left out, no recordings by their name: {named}{f' and {more} more' if more > 0 else ''}"


def find_units(directory: Path) -> Units:
    """All recordings in a directory and in those within it; hidden ones are not looked into.

    Raises:
        BacktestError: there is no such directory, or nothing to be tested in it, or it cannot be read.
    """
    if not directory.is_dir():
        what = "is no directory" if directory.exists() else "there is no such directory"
        raise BacktestError(f"{directory}: {what}: give one that holds recordings, CSV or those of a daemon")
    directory = directory.resolve()
    names: list[str] = []
    left_out: list[str] = []
    for place, within, files in os.walk(directory, onerror=_refused):
        within[:] = sorted(name for name in within if not name.startswith("."))
        relative = Path(place).relative_to(directory)
        there = set(files)
        for file in sorted(files):
            kind = _kind(file, there)
            if kind is not None:
                (names if kind else left_out).append(str(relative / file))
    if not names:
        hint = f"; it holds {left_out[0]}" if left_out else "; it is empty"
        raise BacktestError(
            f"{directory}: holds no recording (*{CSV}, or heaved-*.samples.parquet and .arrows of a daemon){hint}"
        )
    return Units(directory=directory, names=tuple(sorted(names)), left_out=tuple(sorted(left_out)))


def _kind(file: str, beside: set[str]) -> bool | None:
    """Whether a file is a recording; None: it belongs to one that is, and nobody needs to be told."""
    if file.startswith(".") or f".{FRAMES}." in file or file.endswith(".tmp"):
        return None
    if file.endswith(SUFFIXES):
        # Between the renaming of a Parquet file and the end of its stream there are both, of the same rows.
        is_twice = file.endswith(".arrows") and f"{file.removesuffix('.arrows')}.parquet" in beside
        return None if is_twice else True
    return file.endswith(CSV) and not file.endswith(MADE_BY_REPLAY)


def _refused(error: OSError) -> None:
    raise BacktestError(f"{error.filename}: cannot be read: {error.strerror or error}") from error
