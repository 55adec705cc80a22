"""``python -m heaved.recorder.serve``: the process that records. Messages in on stdin, reports out on stdout.

What the disk does concerns nobody but this process: while it takes nothing, rows are counted as lost and the daemon
goes on. When stdin ends, so does it, with all that it was given on the disk.
"""

from __future__ import annotations

import errno
import os
import select
import signal
import struct
import sys
import threading
import time
from contextlib import suppress
from math import inf, nan
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Final

import msgspec
import numpy as np
import pyarrow as pa

from heaved.recorder import messages
from heaved.recorder.files import (
    DAMAGED,
    STREAM,
    InUseError,
    StreamFile,
    delete_old,
    lock,
    looks_well,
    new_stem,
    pairs,
    to_parquet,
)
from heaved.recorder.layout import FORMAT, FRAMES, HANDOVER, SAMPLES, Header, Report, Settings
from heaved.recorder.messages import Kind, MessageError, Splitter
from heaved.recorder.read import rows_there
from heaved.recorder.tables import KEYS, FrameRows, SampleRows

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

NICENESS: Final = 5
"""The daemon goes first. At 10 a busy machine lets it wait for seconds, and what waits may be lost."""
CONVERTER_NICENESS: Final = 19
"""Of the thread that makes Parquet of an hour that is over, which may take as long as it likes."""
_CHUNK_BYTES: Final = 1 << 18
_TICK_S: Final = 0.25
"""It looks around so often when nothing comes."""
_LIMITS_S: Final = 60.0
"""Sizes are looked at so often."""
STEADY_S: Final = 86_400.0
"""What is old by a clock that was not stepped for so long is. One that is set wrong would have all recordings deleted,
and one that is set right those of before."""
_STEP_S: Final = 60.0
"""A greater change of UTC against the monotonic clock between two looks is a step."""
_IN_USE_S: Final = 1.0
_LOOK_S: Final = 1.0
"""A disk that takes nothing is looked at so often."""
_MOST_OFFSET_S: Final = 1e12
"""Of UTC to the monotonic clock; a column has room for nine times as much."""
_STDIN, _STDOUT = 0, 1


class Recorder:
    """What the process does with each message. It is told the time, and raises only for messages that are not ours.

    Attributes:
        rows: written.
        lost: rows that could not be.
    """

    def __init__(self, report: Callable[[Report], None], wake: Callable[[], None]) -> None:
        """``report`` sends a report; ``wake`` has old streams turned into Parquet, elsewhere."""
        self.settings: Settings | None = None
        self.rows = self.lost = 0
        self._settled = 0
        self._report, self._wake = report, wake
        self._offset_s = 0.0
        self._samples: SampleRows | None = None
        self._frames: FrameRows | None = None
        self._files: tuple[StreamFile, StreamFile] | None = None
        self._stem = ""
        self._run = ""
        self._there: dict[str, list[tuple[int, int]]] | None = None
        """Rows of this run that others have written, by their table: looked for before the first of ours."""
        self._lock: int | None = None
        self._first_s = 0.0
        """When the first of the rows that wait came."""
        self._retry_s = -inf
        """The disk is not tried before, unless it looks well again:"""
        self._refused: OSError | None = None
        """why it took nothing; None: it does."""
        self._look_s = 0.0
        self._limits_s = 0.0
        self._size_bytes = 0
        self._utc_offset_s, self._steady_since_s = nan, 0.0
        """UTC minus the monotonic clock at the last look, and since when it has not been stepped."""
        self._fault = ""

    @property
    def directory(self) -> Path:
        """Of the recording; before the settings, the present one."""
        return Path(self.settings.directory if self.settings else ".")

    @property
    def current(self) -> str:
        """The pair that is being written; empty: none."""
        return self._stem

    @property
    def is_owner(self) -> bool:
        """The directory is ours."""
        return self._lock is not None

    def take(self, kind: Kind, body: bytes, now_s: float) -> None:
        """A message. ``now_s``: monotonic.

        Raises:
            MessageError: it is none of ours.
        """
        try:
            self._take(kind, body, now_s)
        except (msgspec.MsgspecError, ValueError, IndexError, struct.error) as error:
            raise MessageError(f"a message of kind {kind.name}: {error}") from error

    def _take(self, kind: Kind, body: bytes, now_s: float) -> None:
        if kind is Kind.SETTINGS:
            self.settings = msgspec.json.decode(body, type=Settings)
        elif kind is Kind.HEADER:
            self._begin(msgspec.json.decode(body, type=Header), now_s)
        elif kind is Kind.OFFSET:
            (offset_s,) = messages.OFFSET.unpack(body)
            if not abs(offset_s) <= _MOST_OFFSET_S:
                raise MessageError(f"an offset of {offset_s:g} s: not from this daemon")
            self._offset_s = offset_s
        else:
            samples, frames = self._samples, self._frames
            if samples is None or frames is None:
                raise MessageError(f"a message of kind {kind.name} before the header")
            if not len(samples) + len(frames):
                self._first_s = now_s
            if kind is Kind.SAMPLE:
                samples.push_sample(body, self._offset_s)
            elif kind is Kind.CALL:
                samples.push_call(body, self._offset_s)
            elif kind is Kind.FRAME:
                frames.push(body, self._offset_s)
            elif kind is Kind.TEXT:
                frames.push_text(body)

    def look(self, now_s: float) -> None:
        """Write what has waited long enough, and look after sizes; to be called often."""
        if self.settings is None:
            return
        if self._waiting() and now_s - self._first_s >= self.settings.batch_s:
            self.write(now_s)
        if now_s >= self._limits_s:
            self._limits_s = now_s + _LIMITS_S
            self._limit(now_s)

    def write(self, now_s: float) -> None:
        """Write what waits; what the disk does not take is lost, and said."""
        samples, frames = self._samples, self._frames
        if samples is None or frames is None or not self._waiting():
            return
        rows = self._waiting()
        try:
            if not self._is_worth_while(now_s):
                self.lost += rows
            else:
                self.rows += self._write(samples, frames)
                self._fault, self._refused, self._retry_s = "", None, -inf
        except (OSError, InUseError, pa.ArrowException) as error:
            self.lost += rows
            assert self.settings is not None
            # Who has the directory may just be ending: one like this, before the configuration was read again.
            retry_s = min(_IN_USE_S, self.settings.retry_s) if isinstance(error, InUseError) else self.settings.retry_s
            self._retry_s = now_s + retry_s
            self._refused = error if isinstance(error, OSError) else None
            self._fault = explain(error, self.directory, retry_s)
            self._close()
        self._settled += rows
        samples.clear()
        frames.clear()
        self.tell()

    def _is_worth_while(self, now_s: float) -> bool:
        """Whether the disk is tried: it took the last rows, it is time to, or it looks well again."""
        if now_s >= self._retry_s:
            return True
        if self._refused is None or now_s < self._look_s:
            return False
        self._look_s = now_s + _LOOK_S
        return looks_well(self.directory, self._refused)

    def close(self, now_s: float) -> None:
        """Write the rest; no more comes, and others may have the directory."""
        self.write(now_s)
        self._close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def tell(self, note: str = "") -> None:
        """Say how it is."""
        self._report(
            Report(
                is_up=not self._fault,
                detail=self._fault,
                rows=self.rows,
                lost=self.lost,
                settled=self._settled,
                size_bytes=self._size_bytes,
                note=note,
            )
        )

    def _waiting(self) -> int:
        return len(self._samples or ()) + len(self._frames or ())

    def _begin(self, header: Header, now_s: float) -> None:
        if header.format != FORMAT:
            raise MessageError(f"a header of format {header.format}, this program has {FORMAT}")
        self.write(now_s)
        self._close()
        self._samples, self._frames, self._run = SampleRows(header), FrameRows(header), header.run
        self._wake()

    def _write(self, samples: SampleRows, frames: FrameRows) -> int:
        """How many rows were written: all that are new."""
        if self._lock is None:
            with suppress(FileExistsError):
                # Not its parents: where a disk should be mounted and is not, nothing shall be filled in its place.
                self.directory.mkdir(mode=0o750)
            held = lock(self.directory)
            self._take_over(held)
            self._lock = held
            self._wake()
        if self._there is None:
            assert self.settings is not None
            tables = (SAMPLES, FRAMES) if self.settings.is_again else ()
            self._there = {table: rows_there(self.directory, table, self._run) for table in tables}
        if self._files is None:
            self._stem = new_stem(self.directory, time.time())
            first = StreamFile(self.directory / f"{self._stem}.{SAMPLES}{STREAM}", samples.schema)
            try:
                second = StreamFile(self.directory / f"{self._stem}.{FRAMES}{STREAM}", frames.schema)
            except OSError:
                first.close()
                raise
            self._files = (first, second)
        batches = (samples.batch() if len(samples) else None, frames.batch() if len(frames) else None)
        written = 0
        for file, table, batch in zip(self._files, (SAMPLES, FRAMES), batches, strict=True):
            if batch is not None and len(new := without(batch, KEYS[table], self._there.get(table, ()))):
                file.write(new)
                written += len(new)
        return written

    def _take_over(self, held: int) -> None:
        """Write what an earlier daemon has left for us, in files of its own, before ours begin. ``held``: the lock."""
        for path in sorted(self.directory.glob(f"*{HANDOVER}")):
            scribe = Recorder(lambda _report: None, lambda: None)
            assert self.settings is not None
            scribe.settings, scribe._lock = msgspec.structs.replace(self.settings, is_again=True), held
            try:
                for kind, body in Splitter().push(path.read_bytes()):
                    scribe.take(kind, body, 0.0)
                scribe.write(0.0)
            except (OSError, MessageError) as error:
                with suppress(OSError):
                    path.rename(f"{path}{DAMAGED}")
                self.tell(f"{path.name} cannot be taken over and is kept: {error}")
                continue
            finally:
                scribe._close()
            if scribe.lost:
                continue  # The disk takes nothing, as the rows that are written next will find: with the next start.
            path.unlink()
            self.tell(f"{scribe.rows} rows that the daemon before had to leave are recorded ({path.name})")

    def _close(self) -> None:
        files, self._files = self._files, None
        for file in files or ():
            file.close()
        if self._stem:
            self._stem = ""
            self._wake()

    def _limit(self, now_s: float) -> None:
        assert self.settings is not None
        now_utc_s = time.time()
        offset_s, before_s = now_utc_s - now_s, self._utc_offset_s
        self._utc_offset_s = offset_s
        if not abs(offset_s - before_s) < _STEP_S:
            self._steady_since_s = now_s
        if self._lock is None:  # Not ours to delete in.
            return
        try:
            gone = delete_old(
                self.directory,
                max_bytes=self.settings.max_bytes,
                max_age_s=self.settings.max_age_s if now_s - self._steady_since_s >= STEADY_S else inf,
                now_utc_s=now_utc_s,
                keep=self.current,
            )
            self._size_bytes = sum(pair.size_bytes for pair in pairs(self.directory))
        except OSError as error:
            self.tell(f"old recordings cannot be deleted: {explain(error, self.directory, _LIMITS_S)}")
            return
        if gone:
            self.tell(f"old recordings deleted, as [recording] max_gb and max_days say: {', '.join(gone)}")


def without(batch: Any, key: str, there: Sequence[tuple[int, int]]) -> Any:
    """The rows of a batch of Arrow whose key is in none of the ranges ``there``, first and last of each included."""
    if not there:
        return batch
    keys = batch.column(key).to_numpy()
    return batch.filter(pa.array(~np.any([(first <= keys) & (keys <= last) for first, last in there], axis=0)))


class Converter:
    """Turns streams that are not written any more into Parquet, in a thread: rows are written meanwhile."""

    def __init__(self, recorder: Recorder, notes: SimpleQueue[str]) -> None:
        self._recorder, self._notes = recorder, notes
        self._awake = threading.Event()
        self._said: dict[Path, str] = {}
        threading.Thread(target=self._run, name="converter", daemon=True).start()

    def wake(self) -> None:
        """There is something to do."""
        self._awake.set()

    def _run(self) -> None:
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), CONVERTER_NICENESS)
        while True:
            settings = self._recorder.settings
            self._awake.wait(settings.retry_s if settings else None)
            self._awake.clear()
            if self._recorder.is_owner:
                self._convert_all()

    def _convert_all(self) -> None:
        directory = self._recorder.directory
        with suppress(OSError):
            for pair in pairs(directory):
                for path in pair.paths:
                    if pair.stem != self._recorder.current and path.name.endswith(STREAM):
                        self._convert(path)
                    elif path.name.endswith(".tmp"):
                        path.unlink(missing_ok=True)
        pa.default_memory_pool().release_unused()  # An hour's columns are much, and the next hour is an hour away.

    def _convert(self, path: Path) -> None:
        try:
            done = to_parquet(path)
        except (OSError, pa.ArrowException) as error:
            said = f"{path.name} stays as it is: {explain(error, path.parent, 0.0)}"
            if self._said.get(path) != said:
                self._said[path] = said
                self._notes.put(said)
            return
        if done.torn_bytes:
            kept = f"; more than a crash tears off: it is kept as {done.kept}" if done.kept else ""
            self._notes.put(
                f"{path.name} was torn: {done.rows} rows are whole, {done.torn_bytes} bytes at its end are not{kept}"
            )


def explain(error: Exception, directory: Path, retry_s: float) -> str:
    """Why nothing can be recorded, and what to do."""
    again = f"; tried again every {retry_s:g} s" if retry_s else "; tried again"
    if retry_s and isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EROFS, errno.ENOENT):
        again = f"; tried again once that is so, at the latest after {retry_s:g} s"
    if not isinstance(error, OSError):
        return f"{error}{again}"
    what = {
        errno.ENOSPC: "no room is left: free some, or lower [recording] max_gb",
        errno.EDQUOT: "the quota is used up: raise it, or lower [recording] max_gb",
        errno.EROFS: "is read-only: mount it writable, name it in the unit (ReadWritePaths=), or correct "
        "[recording] directory",
        errno.EACCES: "may not be written to: correct its permissions, or [recording] directory",
        errno.EPERM: "may not be written to: correct its permissions, or [recording] directory",
        errno.ENOENT: "is not there: mount or make it, or correct [recording] directory",
        errno.ENOTDIR: "is no directory: correct [recording] directory",
    }.get(error.errno or 0, f"cannot be written to: {error.strerror or error}")
    return f"{directory}: {what}{again}"


def main() -> int:
    """Record until stdin ends (0), or something else than our messages comes (1, with a message on stderr)."""
    os.nice(NICENESS)
    # Ctrl-C, and the end of a service, are the daemon's to handle: it has something to say after them, and its end is
    # our end of file.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    pa.set_cpu_count(1)
    out = os.fdopen(os.dup(_STDOUT), "wb", buffering=0)
    os.dup2(2, _STDOUT)  # A library that prints must not break the reports.
    notes: SimpleQueue[str] = SimpleQueue()
    converter: Converter | None = None

    def report(said: Report) -> None:
        with suppress(BrokenPipeError):
            out.write(msgspec.json.encode(said) + b"\n")

    recorder = Recorder(report, lambda: converter.wake() if converter is not None else None)
    converter = Converter(recorder, notes)
    report(Report(is_up=False, has_begun=True))
    code = _serve(recorder, notes)
    os._exit(code)  # A conversion that is under way is begun again next time.


def _serve(recorder: Recorder, notes: SimpleQueue[str]) -> int:
    splitter = Splitter()
    while True:
        ready, _, _ = select.select([_STDIN], [], [], _TICK_S)
        data = os.read(_STDIN, _CHUNK_BYTES) if ready else None
        now_s = time.monotonic()
        try:
            for kind, body in splitter.push(data or b""):
                recorder.take(kind, body, now_s)
        except MessageError as error:
            recorder.close(now_s)
            print(f"recorder: {error}", file=sys.stderr, flush=True)
            return 1
        recorder.look(now_s)
        while True:
            try:
                recorder.tell(notes.get_nowait())
            except Empty:
                break
        if data == b"":
            recorder.close(now_s)
            return 0


if __name__ == "__main__":
    sys.exit(main())
