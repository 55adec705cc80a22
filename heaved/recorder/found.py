"""Whether something is a recording of a daemon, and what it takes to read it. pyarrow is not loaded for the asking."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pathlib import Path

SUFFIXES: Final = (".arrows", ".arrow", ".parquet")


class RecordedError(Exception):
    """Something that cannot be read as a recording; says which file, why, and what to do."""


def is_recorded(path: Path) -> bool:
    """Whether ``path`` is meant to be a recording of a daemon, a directory or a file of one; else it is a CSV."""
    return path.is_dir() or path.name.endswith(SUFFIXES)


def need_reader(path: Path) -> None:
    """
    Raises:
        RecordedError: what reads it is not installed.
    """
    if importlib.util.find_spec("pyarrow") is None:
        raise RecordedError(f"{path}: reading it needs pyarrow: pip install 'heaved[recording]'")
