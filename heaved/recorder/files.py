"""The files of a recording: streams of Arrow while they grow, Parquet afterwards; torn ends mended, old ones deleted.

While an hour lasts, each batch is at once on the disk, whole: a stream of Arrow has no end that could be missing. What
a crash tore off is at most the last batch. Once the hour is over the stream becomes Parquet, a fraction of its size,
under a temporary name that is renamed when it is whole; only then the stream goes. At each moment a row stands in one
of them.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
from collections import defaultdict
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

STREAM: Final = ".arrows"
PARQUET: Final = ".parquet"
UNFINISHED: Final = ".parquet.tmp"
LOCK: Final = ".heaved.lock"
ROWS_OF_GROUP: Final = 60_000
"""Of Parquet: ten minutes at 100 Hz."""
ROOM_BYTES: Final = 16 << 20
"""Of a disk that was full: an hour's recording at 100 Hz, so that it is not full again at once."""
LEVEL: Final = 9
"""Of zstd: a minute's work for an hour's rows would be too much, seconds are not."""
DAMAGED: Final = ".damaged"
"""Behind the name of a stream of which more than an end is not whole: it is kept beside what could be read."""
NAME: Final = re.compile(
    r"heaved-(\d{8}T\d{6}Z)(-\d+)?\.(samples|frames)(\.arrows|\.arrows\.damaged|\.parquet|\.parquet\.tmp)"
)
_TIME: Final = "%Y%m%dT%H%M%SZ"


class InUseError(Exception):
    """Another process records into the directory."""


def lock(directory: Path) -> int:
    """Have the directory to ourselves for as long as the returned file is open.

    Raises:
        InUseError: somebody else has it.
        OSError: it cannot be used.
    """
    fd = os.open(directory / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o640)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(fd)
        if isinstance(error, BlockingIOError):
            raise InUseError(f"another daemon records into {directory}: give each its own directory") from error
        raise
    return fd


def new_stem(directory: Path, utc_s: float) -> str:
    """Name of a pair of files that begins then; no other has it."""
    name = f"heaved-{datetime.fromtimestamp(utc_s, UTC).strftime(_TIME)}"
    taken = {path.name.split(".")[0] for path in directory.glob(f"{name}*")}
    number, stem = 1, name
    while stem in taken:
        number += 1
        stem = f"{name}-{number}"
    return stem


def looks_well(directory: Path, error: OSError) -> bool:
    """Whether a disk that has failed like this is worth another try, as far as the system can be asked without one. A
    failure that it does not show is not known to be over.
    """
    try:
        found = os.statvfs(directory if error.errno != errno.ENOENT else directory.parent)
    except OSError:
        return False
    if error.errno == errno.ENOSPC:
        return found.f_bavail * found.f_frsize >= ROOM_BYTES and (found.f_favail > 0 or found.f_files == 0)
    if error.errno == errno.EROFS:
        return not found.f_flag & os.ST_RDONLY
    return error.errno == errno.ENOENT


# ---- while it grows --------------------------------------------------------------------------------------------------


class _Sink:
    """Where the writer of Arrow leaves its bytes, until they are written as one."""

    closed = False

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self._told = 0

    def write(self, data: Any) -> int:
        part = bytes(data)
        self.parts.append(part)
        self._told += len(part)
        return len(part)

    def tell(self) -> int:
        return self._told

    def flush(self) -> None:
        pass

    def writable(self) -> bool:
        return True

    def readable(self) -> bool:
        return False

    def seekable(self) -> bool:
        return False

    def close(self) -> None:
        self.closed = True


class StreamFile:
    """A stream of batches that grows; each is whole on the disk, or not there."""

    def __init__(self, path: Path, schema: Any) -> None:
        """
        Raises:
            OSError: it cannot be made.
        """
        self.path = path
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW, 0o640)
        self._sink = _Sink()
        options = pa.ipc.IpcWriteOptions(compression="zstd", use_threads=False)
        self._writer = pa.ipc.new_stream(self._sink, schema, options=options)
        self._size = 0

    def write(self, batch: Any) -> None:
        """Add a batch.

        Raises:
            OSError: the disk does not take it; the file is as it was.
        """
        self._writer.write_batch(batch)
        data = b"".join(self._sink.parts)
        self._sink.parts.clear()
        try:
            left = memoryview(data)
            while left:
                left = left[os.write(self._fd, left) :]
            os.fdatasync(self._fd)
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._fd, self._size)
            raise
        self._size += len(data)

    def close(self) -> None:
        """No more batches."""
        with suppress(OSError):  # An end is not needed: a reader knows the last batch by there being no other.
            os.close(self._fd)


def whole_batches(path: Path) -> Iterator[tuple[Any, int]]:
    """The batches of a stream up to where it is torn, and how far into the file each goes.

    Raises:
        OSError: it cannot be read.
        pa.ArrowInvalid: it is torn before its first batch, or is no stream of Arrow.
    """
    with pa.OSFile(str(path)) as file:
        reader = pa.ipc.open_stream(file)
        while True:
            try:
                batch = reader.read_next_batch()
                batch.validate(full=True)
            except (StopIteration, pa.ArrowException, OSError):
                # pyarrow says a torn end by any of them.
                return
            yield batch, file.tell()


# ---- afterwards ------------------------------------------------------------------------------------------------------


class Converted(msgspec.Struct, frozen=True, kw_only=True):
    """What became of a stream."""

    rows: int
    torn_bytes: int
    """At its end, that were no whole batch."""
    kept: str = ""
    """Name under which the stream is kept, because that is more than a crash tears off."""


def to_parquet(source: Path, *, table_rows: int = ROWS_OF_GROUP) -> Converted:
    """Turn a stream into the Parquet file of the same name; the stream goes once that is safe on the disk.

    Raises:
        OSError: the disk does not take it; the stream stays.
    """
    target, unfinished = source.with_suffix(PARQUET), source.with_suffix(UNFINISHED)
    if target.exists():  # The crash came between the two.
        source.unlink()
        return Converted(rows=0, torn_bytes=0)
    size, rows, end, largest = source.stat().st_size, 0, 0, 0
    writer: Any = None
    waiting: list[Any] = []
    try:
        try:
            for batch, reached in whole_batches(source):
                largest, end = max(largest, reached - end), reached
                if writer is None:
                    writer = _writer(unfinished, batch.schema)
                waiting.append(batch)
                rows += len(batch)
                if sum(map(len, waiting)) >= table_rows:
                    writer.write_table(pa.Table.from_batches(waiting).combine_chunks())
                    waiting = []
        except pa.ArrowInvalid:
            pass  # Torn before its first batch: nothing of it is whole.
        if writer is not None:
            if waiting:
                writer.write_table(pa.Table.from_batches(waiting).combine_chunks())
            writer.close()
            _sync(unfinished)
            unfinished.replace(target)
            _sync(target.parent)
    except BaseException:
        with suppress(OSError, pa.ArrowException):
            if writer is not None:
                writer.close()
        with suppress(OSError):
            unfinished.unlink(missing_ok=True)
        raise
    torn = max(size - end, 0)
    if torn > 2 * largest > 0:
        kept = source.with_name(f"{source.name}{DAMAGED}")
        source.replace(kept)
        return Converted(rows=rows, torn_bytes=torn, kept=kept.name)
    source.unlink(missing_ok=True)
    return Converted(rows=rows, torn_bytes=torn)


def _writer(path: Path, schema: Any) -> Any:
    # As private as the stream was: the library would have it readable by everybody.
    os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o640))
    texts = [field.name for field in schema if pa.types.is_string(field.type)]
    encodings = {field.name: "DELTA_BINARY_PACKED" for field in schema if pa.types.is_integer(field.type)}
    encodings |= {field.name: "BYTE_STREAM_SPLIT" for field in schema if pa.types.is_floating(field.type)}
    encodings |= {field.name: "PLAIN" for field in schema if pa.types.is_binary(field.type)}
    return pq.ParquetWriter(
        path,
        schema,
        compression="zstd",
        compression_level=LEVEL,
        use_dictionary=texts,
        column_encoding=encodings,
        data_page_version="2.0",
        data_page_size=1 << 20,
        write_page_checksum=True,
        store_schema=True,
    )


def _sync(path: Path) -> None:
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


# ---- all of them -----------------------------------------------------------------------------------------------------


class Pair(msgspec.Struct, frozen=True, kw_only=True):
    """The files of one name, of both tables."""

    stem: str
    began_utc_s: float
    """As its name says."""
    paths: tuple[Path, ...]
    size_bytes: int


def pairs(directory: Path) -> list[Pair]:
    """What there is, oldest first; files of other names are nobody's of ours.

    Raises:
        OSError: the directory cannot be read.
    """
    found: dict[str, list[Path]] = defaultdict(list)
    for path in directory.iterdir():
        if NAME.fullmatch(path.name):
            found[path.name.split(".")[0]].append(path)
    return sorted((_pair(stem, paths) for stem, paths in found.items()), key=lambda pair: (pair.began_utc_s, pair.stem))


def _pair(stem: str, paths: Sequence[Path]) -> Pair:
    began = datetime.strptime(stem.split("-")[1], _TIME).replace(tzinfo=UTC)
    size = 0
    for path in paths:
        with suppress(FileNotFoundError):
            size += path.stat().st_size
    return Pair(stem=stem, began_utc_s=began.timestamp(), paths=tuple(sorted(paths)), size_bytes=size)


def delete_old(directory: Path, *, max_bytes: int, max_age_s: float, now_utc_s: float, keep: str) -> list[str]:
    """Delete the oldest pairs, whole, until the rest is small and young enough; returns their names.

    ``keep``: the one that is being written, which stays in any case.

    Raises:
        OSError: one cannot be deleted.
    """
    there = pairs(directory)
    size = sum(pair.size_bytes for pair in there)
    deleted = []
    for pair in there:
        is_old = now_utc_s - pair.began_utc_s > max_age_s
        if pair.stem == keep or not (is_old or size > max_bytes):
            continue
        for path in pair.paths:
            path.unlink(missing_ok=True)
        size -= pair.size_bytes
        deleted.append(pair.stem)
    return deleted
