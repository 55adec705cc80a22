"""Reading what was recorded: a directory of hours, or one of them, Parquet and streams of Arrow alike, in order.

Everything that is read is checked first: who wrote it, that all of it is of one vessel, that no file repeats another.
"""

from __future__ import annotations

from collections import defaultdict
from contextlib import suppress
from itertools import pairwise
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from heaved import samples
from heaved.recorder.files import NAME, PARQUET, STREAM, whole_batches
from heaved.recorder.found import SUFFIXES, RecordedError
from heaved.recorder.layout import FRAMES, HANDOVER, SAMPLES, Call, Column, Header, table_columns
from heaved.recorder.tables import KEYS, Doubles, header_of, numbers_to_values, samples_of
from heaved.samples import Fault, Sample

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_ROWS_AT_A_TIME: Final = 20_000
_SAMPLES: Final[dict[str, Any]] = {
    kind.__name__: kind
    for kind in vars(samples).values()
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct) and "fault" in kind.__struct_fields__
}


class Row(msgspec.Struct, frozen=True, gc=False):
    """One call into the pipeline."""

    call: Call
    seq: int
    t_s: float
    """Of what is called at a time; else nan."""
    sample: Sample | None = None
    record: bytes = b""


class Hour(msgspec.Struct, frozen=True, kw_only=True):
    """One file of a table."""

    path: Path
    header: Header
    table: str
    first: int
    """Of ``samples``: number of the first call. Of ``frames``: time of the first, µs."""
    last: int
    """Likewise of the last row."""
    rows: int
    size_bytes: int
    torn_bytes: int = 0
    """At its end, of a stream, that are no whole batch."""

    def batches(self, columns: Sequence[str] | None = None) -> Iterator[Any]:
        """Its rows, in batches of Arrow.

        Raises:
            RecordedError: it has become unreadable.
        """
        try:
            if self.path.name.endswith(PARQUET):
                with pq.ParquetFile(self.path, page_checksum_verification=True) as file:
                    yield from file.iter_batches(_ROWS_AT_A_TIME, columns=columns, use_threads=False)
            else:
                for batch, _ in whole_batches(self.path):
                    yield batch
        except (OSError, pa.ArrowException) as error:
            raise RecordedError(f"{self.path}: is damaged: {_first_line(error)}") from error


class Recorded(msgspec.Struct, frozen=True, kw_only=True):
    """A table of a recording, in order."""

    hours: tuple[Hour, ...]
    remarks: tuple[str, ...]
    """What a person should know: torn ends, files that hold nothing."""

    @property
    def size_bytes(self) -> int:
        """Of all files."""
        return sum(hour.size_bytes for hour in self.hours)

    @property
    def runs(self) -> list[list[Hour]]:
        """Hours of one run of the daemon each, in order."""
        found: dict[str, list[Hour]] = {}
        for hour in self.hours:
            found.setdefault(hour.header.run, []).append(hour)
        return list(found.values())


def open_recorded(path: Path, table: str) -> Recorded:
    """The recording in a directory, or in one file of it: either table is found by the name of the other.

    Raises:
        RecordedError: there is none, or it is not one.
    """
    remarks: list[str] = []
    hours = []
    for one in _files(path, table):
        hour = _hour(one, table, remarks)
        if hour is not None:
            hours.append(hour)
    if path.is_dir():
        remarks += [
            f"{one.name} is the end of a run that its recorder had no time for: the next heaved run records it"
            for one in sorted(path.glob(f"*{HANDOVER}"))
        ]
    if not hours:
        raise RecordedError(f"{path}: holds no row" + "".join(f"; {remark}" for remark in remarks))
    vessels = {hour.header.vessel: hour.path for hour in hours}
    if len(vessels) > 1:
        told = ", ".join(f"{file.name} of {vessel!r}" for vessel, file in vessels.items())
        raise RecordedError(f"{path}: holds recordings of {len(vessels)} vessels ({told}): read each by itself")
    began: dict[str, float] = defaultdict(lambda: float("inf"))
    for hour in hours:
        began[hour.header.run] = min(began[hour.header.run], hour.header.began_utc_s)
    hours.sort(key=lambda hour: (began[hour.header.run], hour.header.run, hour.first))
    for before, after in pairwise(hours):
        if before.header.run == after.header.run and after.first <= before.last:
            raise RecordedError(
                f"{after.path}: begins before {before.path.name} ends: the same hour twice? Remove one of them"
            )
    return Recorded(hours=tuple(hours), remarks=tuple(remarks))


def rows_there(directory: Path, table: str, run: str) -> list[tuple[int, int]]:
    """First and last row, as :class:`Hour` has them, of each file that holds rows of that run of the daemon; what
    cannot be read holds none.
    """
    found = []
    for path in directory.iterdir():
        if NAME.fullmatch(path.name) and f".{table}." in path.name and path.name.endswith(SUFFIXES):
            with suppress(RecordedError):
                hour = _hour(path, table, [], run)
                if hour is not None:
                    found.append((hour.first, hour.last))
    return found


def _files(path: Path, table: str) -> list[Path]:
    try:
        if not path.is_dir():
            return [_file_of(path, table)]
        there = sorted(one for one in path.iterdir() if one.name.endswith(SUFFIXES))
    except OSError as error:
        raise RecordedError(f"{path}: cannot be read: {error.strerror or error}") from error
    mine = [one for one in there if f".{table}." in one.name or NAME.fullmatch(one.name) is None]
    # Between the renaming of a Parquet file and the end of its stream there are both, of the same rows.
    whole = {one.name.removesuffix(PARQUET) for one in mine if one.name.endswith(PARQUET)}
    mine = [one for one in mine if not (one.name.endswith(STREAM) and one.name.removesuffix(STREAM) in whole)]
    if not there:
        raise RecordedError(f"{path}: holds no recording (files named heaved-*.{SAMPLES}.parquet or .arrows)")
    if not mine:
        hint = '; [recording] what = "samples" keeps none: heaved replay makes them' if table == FRAMES else ""
        raise RecordedError(f"{path}: holds no {table}{hint}")
    return mine


def _file_of(path: Path, table: str) -> Path:
    if not path.exists():
        raise RecordedError(f"{path}: there is no such file")
    other = FRAMES if table == SAMPLES else SAMPLES
    if NAME.fullmatch(path.name) is None or f".{other}." not in path.name:
        return path
    stem = path.name.split(".")[0]
    for suffix in (PARQUET, STREAM):
        beside = path.with_name(f"{stem}.{table}{suffix}")
        if beside.exists():
            return beside
    raise RecordedError(f"{path}: holds {other} alone, and {stem}.{table}{PARQUET} is not beside it")


def _hour(path: Path, table: str, remarks: list[str], run: str | None = None) -> Hour | None:
    """None: there is no row in it, or it is of another run than is asked for."""
    name = KEYS[table]
    size = _size(path)
    try:
        if path.name.endswith(PARQUET):
            with pq.ParquetFile(path, page_checksum_verification=True) as file:
                header = _header(path, file.schema_arrow, table)
                if run not in (None, header.run):
                    return None
                ends = [(batch.column(0)[0].as_py(), batch.column(0)[-1].as_py())
                        for batch in file.iter_batches(_ROWS_AT_A_TIME, columns=[name], use_threads=False)
                        if len(batch)]  # fmt: skip
                rows, torn = file.metadata.num_rows, 0
        else:
            with pa.OSFile(str(path)) as source:
                header = _header(path, pa.ipc.open_stream(source).schema, table)
            if run not in (None, header.run):
                return None
            ends, rows, end = [], 0, 0
            for batch, end in whole_batches(path):  # noqa: B007  # How far the last of them goes is wanted below.
                ends.append((batch.column(name)[0].as_py(), batch.column(name)[-1].as_py()))
                rows += len(batch)
            torn = max(size - end, 0) if rows else 0  # It may have grown since its size was looked at.
    except (OSError, pa.ArrowException) as error:
        if path.name.endswith(STREAM) and isinstance(error, pa.ArrowInvalid) and NAME.fullmatch(path.name):
            remarks.append(f"{path.name} was torn before its first second")
            return None
        what = "is empty" if size == 0 else f"is no whole file of its kind ({_first_line(error)})"
        raise RecordedError(f"{path}: {what}: copy it again, or leave it out") from error
    if torn:
        remarks.append(f"{path.name} is torn: the last {torn} bytes are no whole second, or are being written")
    if not rows:
        remarks.append(f"{path.name} holds no row")
        return None
    return Hour(
        path=path, header=header, table=table, first=ends[0][0], last=ends[-1][1], rows=rows,
        size_bytes=size, torn_bytes=torn,
    )  # fmt: skip


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError as error:
        raise RecordedError(f"{path}: cannot be read: {error.strerror or error}") from error


def _header(path: Path, schema: Any, table: str) -> Header:
    try:
        header = header_of(schema, table)
    except ValueError as error:
        raise RecordedError(f"{path}: {error}") from error
    if header is None:
        raise RecordedError(
            f"{path}: was not recorded by heaved (columns {', '.join(schema.names[:6])}, ...): "
            "write it as CSV, whose columns the manual names"
        )
    return header


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [repr(error)])[0]


# ---- rows ------------------------------------------------------------------------------------------------------------


def rows_of(hour: Hour) -> Iterator[Row]:
    """The calls of an hour of ``samples``, in order.

    Raises:
        RecordedError: it holds what no daemon has recorded.
    """
    calls = {call.value: call for call in Call}
    faults: dict[str | None, Fault] = {fault.value: fault for fault in Fault} | {None: Fault.NONE}
    time = next(column for column in table_columns(hour.header.layout, SAMPLES) if column.name == "t_s")
    for batch in hour.batches():
        times_s = np.where(
            batch.column("t_s").is_null().to_numpy(zero_copy_only=False),
            nan,
            numbers_to_values(time, batch.column("t_s")),
        ).tolist()
        readings = {device.name: _readings(hour, device.name, batch) for device in hour.header.layout.devices}
        columns = [batch.column(name).to_pylist() for name in ("call", "seq", "device", "fault", "record")]
        try:
            for i, (call, seq, device, fault, record) in enumerate(zip(*columns, strict=True)):
                t_s = times_s[i]
                if call != "poll":
                    yield Row(calls[call], seq, t_s, None, record or b"")
                    continue
                kind, names, values = readings[device]
                said = dict(zip(names, values[i], strict=True))
                yield Row(Call.POLL, seq, t_s, kind(t_s=t_s, fault=faults[fault], **said))
        except KeyError as error:
            raise RecordedError(f"{hour.path}: holds {error}, which no daemon has recorded") from error


def _readings(hour: Hour, name: str, batch: Any) -> tuple[Any, list[str], list[tuple[float, ...]]]:
    """Kind of the samples of a device, the names of what it measures, and the values row by row."""
    device = next(one for one in hour.header.layout.devices if one.name == name)
    kind = _SAMPLES.get(device.sample)
    if kind is None:
        raise RecordedError(f"{hour.path}: device {name} gives {device.sample}, which this release does not know")
    columns = [column for column in device.columns if column.name in kind.__struct_fields__]
    values = samples_of(columns, name, batch)
    rows: list[tuple[float, ...]] = list(zip(*(one.tolist() for one in values), strict=True))
    return kind, [column.name for column in columns], rows


def frame_values(hour: Hour, names: Sequence[str], batch: Any) -> dict[str, Doubles]:
    """Columns of numbers of ``frames``, by name: values (n,), nan where there is none."""
    columns: dict[str, Column] = {column.name: column for column in table_columns(hour.header.layout, FRAMES)}
    return {name: numbers_to_values(columns[name], batch.column(name)) for name in names}
