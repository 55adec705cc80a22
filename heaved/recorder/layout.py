"""What stands in the two tables of a recording: columns, how their numbers are stored, and who they are of. Pure.

A recording is a pair of files for each hour. ``samples`` has a row for every call into the pipeline, in order: each
poll, each frame made without one, each model that it took. It is all that a replay needs, and it is lossless.
``frames`` has a row for each published frame, rounded to what each quantity is worth; who wants every digit replays.

Numbers are integers wherever they can be: a column says in its metadata what one count is worth.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

import msgspec

FORMAT: Final = 1
"""Of the files; a reader refuses a later one."""
SAMPLES: Final = "samples"
FRAMES: Final = "frames"
TABLES: Final = (SAMPLES, FRAMES)
HANDOVER: Final = ".handover"
"""Ends the name of a file of messages that a daemon kept because it had to end before its recorder had begun: the next
one makes rows of them."""


class Stored(Enum):
    """How the numbers of a column are stored."""

    INT8 = "int8"
    INT16 = "int16"
    UINT16 = "uint16"
    INT32 = "int32"
    UINT32 = "uint32"
    INT64 = "int64"
    FLOAT32 = "float32"
    FLOAT64 = "float64"
    FLOAT64_BITS = "float64_bits"
    """The bits of a double as int64: lossless, and differences of neighbours are small."""
    TEXT = "text"
    BYTES = "bytes"


class Column(msgspec.Struct, frozen=True, kw_only=True):
    """One column: a value is ``(number * scale + offset) * factor``, worked out in double precision in that order."""

    name: str
    stored: Stored = Stored.INT32
    scale: float = 1.0
    offset: float = 0.0
    factor: float = 1.0
    unit: str = ""
    """Of the value, for people."""
    is_exact: bool = False
    """To the last bit: a value that no number gives stands, as a double, in the column ``NAME.exact`` beside it."""


class Device(msgspec.Struct, frozen=True, kw_only=True):
    """A device that is polled."""

    name: str
    role: str
    sample: str
    """Name of the record of :mod:`heaved.samples` that a poll of it gives."""
    columns: tuple[Column, ...]
    """Quantities of that record, and what accompanies them, by their names in it."""


class Layout(msgspec.Struct, frozen=True, kw_only=True):
    """Both tables."""

    devices: tuple[Device, ...]
    numbers: tuple[Column, ...]
    """Of a frame, in the order in which they are handed over, after its time."""
    texts: tuple[Column, ...]
    """Of a frame."""
    lasting: tuple[str, ...]
    """Texts that hold until another comes; the others are told once."""


class Header(msgspec.Struct, frozen=True, kw_only=True):
    """Who a file is of: stands in its metadata, as JSON."""

    format: int = FORMAT
    vessel: str
    run: str
    """Of the daemon: from a start to its end."""
    release: str
    began_utc_s: float
    """When the file was begun."""
    layout: Layout
    config: msgspec.Raw
    """The configuration in force, JSON."""
    learned: msgspec.Raw
    """What a restart would remember at that moment, JSON."""


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What the process that records is told first."""

    directory: str
    max_bytes: int
    max_age_s: float
    batch_s: float = 0.5
    """Rows are written when the first of them is so old: with what is on its way, less than a second."""
    retry_s: float = 60.0
    """A disk that takes nothing is tried again after so long, or as soon as it looks well again."""
    is_again: bool = False
    """A process before had rows of this run: some that come first may be on the disk already."""


class Call(Enum):
    """What a row of ``samples`` is."""

    POLL = "poll"
    COAST = "coast"
    """A frame was made for a moment without a sample."""
    RESTORED = "restored"
    """What an earlier run had learned was taken over: :class:`heaved.recorder.calls.Restored`, msgpack."""
    NETWORK = "network"
    """The trainer's answer came: TrainedNetwork, msgpack."""
    FIT = "fit"
    """The fitter's answer came: :func:`heaved.recorder.calls.pack_fit`."""
    REFIT = "refit"
    """The answer of the hull's fitter came. It is a pure function of what was asked, and made again by a replay."""
    REFIT_FAILED = "refit failed"
    PIPELINE = "pipeline"
    """The estimators began anew with another configuration, with what had been learned: Config, JSON."""
    HULL = "hull"
    """This stage began anew, or ended: Config, JSON."""
    ATTITUDE = "attitude"
    CRANE = "crane"
    REFERENCE_MRU = "reference mru"
    RELIEVED = "relieved"
    """The machine could not do all: from here on predictions of roll, pitch and yaw are left out ..."""
    RESUMED = "resumed"
    """... and from here on no more."""


CALLS: Final = tuple(Call)
"""By their number on the way to the process that records."""


class Report(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What the process that records says of itself: a line of JSON on its standard output."""

    is_up: bool
    detail: str = ""
    """Why not, and what to do."""
    rows: int = 0
    """Written since it started."""
    lost: int = 0
    """Rows that could not be."""
    settled: int = 0
    """Rows that are no longer its concern: written, lost, or on the disk before it started."""
    size_bytes: int = 0
    """Of all files of the directory."""
    has_begun: bool = False
    """It reads what it is given from now on: said once, first, and nothing else with it."""
    note: str = ""
    """Something happened that a person should know: a torn file was mended, old ones were deleted."""


def exact_name(name: str) -> str:
    """Of the column that has what another cannot say."""
    return f"{name}.exact"


def table_columns(layout: Layout, table: str) -> tuple[Column, ...]:
    """All columns of a table, in order."""
    if table == FRAMES:
        head = (
            Column(name="t_us", stored=Stored.INT64, scale=1e-6, unit="s"),
            Column(name="utc_offset_us", stored=Stored.INT64, scale=1e-6, unit="s"),
        )
        return (*head, *layout.numbers, *layout.texts)
    rows = [
        Column(name="call", stored=Stored.TEXT),
        Column(name="seq", stored=Stored.INT64),
        Column(name="utc_offset_us", stored=Stored.INT64, scale=1e-6, unit="s"),
        Column(name="device", stored=Stored.TEXT),
        Column(name="t_s", stored=Stored.FLOAT64_BITS, unit="s"),
        Column(name="fault", stored=Stored.TEXT),
    ]
    for device in layout.devices:
        for column in device.columns:
            renamed = msgspec.structs.replace(column, name=f"{device.name}.{column.name}")
            rows.append(renamed)
            if renamed.is_exact:
                rows.append(Column(name=exact_name(renamed.name), stored=Stored.FLOAT64, unit=renamed.unit))
    return (*rows, Column(name="record", stored=Stored.BYTES))
