"""The process that records, as a process: killed, starved of room, left alone, told nonsense."""

from __future__ import annotations

import signal
import subprocess
import sys
from contextlib import contextmanager, suppress
from typing import IO, TYPE_CHECKING

import msgspec
import pytest
from recorded_hours import Scribe

from heaved.recorder.layout import FRAMES, SAMPLES, Report
from heaved.recorder.read import open_recorded, rows_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

SERVE = ("from heaved.recorder.serve import main; main()",)


@contextmanager
def process(*before: str) -> Iterator[subprocess.Popen[bytes]]:
    running = subprocess.Popen(
        (sys.executable, "-c", "\n".join(before + SERVE)),
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        yield running
    finally:
        running.kill()
        running.wait()
        for end in (running.stdin, running.stdout, running.stderr):
            with suppress(OSError):  # What could not be flushed.
                pipe(end).close()


def pipe(end: IO[bytes] | None) -> IO[bytes]:
    assert end is not None
    return end


def until(running: subprocess.Popen[bytes], holds: Callable[[Report], bool]) -> Report:
    """The first report of which it holds."""
    for line in pipe(running.stdout):
        report = msgspec.json.decode(line, type=Report)
        if holds(report):
            return report
    raise AssertionError(pipe(running.stderr).read().decode())


def tell(running: subprocess.Popen[bytes], data: bytes) -> None:
    pipe(running.stdin).write(data)
    pipe(running.stdin).flush()


def seqs_in(directory: Path) -> list[int]:
    return [row.seq for hour in open_recorded(directory, SAMPLES).hours for row in rows_of(hour)]


def test_the_end_of_its_stdin_ends_it_with_everything_on_the_disk(tmp_path: Path) -> None:
    scribe, out = Scribe(tmp_path), tmp_path / "out"
    with process() as running:
        tell(running, scribe.settings(out) + scribe.header() + scribe.offset() + scribe.instants(0, 130))
        pipe(running.stdin).close()
        assert running.wait(30) == 0
    assert seqs_in(out) == list(range(156))


def test_what_the_one_before_had_written_is_not_written_again(tmp_path: Path) -> None:
    """It was killed, and what it had not reported as settled comes again."""
    scribe, out = Scribe(tmp_path), tmp_path / "out"
    told = scribe.header() + scribe.offset() + scribe.instants(0, 100)
    with process() as running:
        tell(running, scribe.settings(out, batch_s=0.05) + told)
        assert until(running, lambda report: report.rows >= 220).settled == 220
        running.send_signal(signal.SIGKILL)
        running.wait(30)
    with process() as running:
        tell(running, scribe.settings(out, batch_s=0.05, is_again=True) + told + scribe.instants(100, 150))
        report = until(running, lambda report: report.settled >= 330)
        assert (report.rows, report.lost) == (110, 0)
        pipe(running.stdin).close()
        assert running.wait(30) == 0
    assert seqs_in(out) == list(range(180))
    assert [hour.rows for hour in open_recorded(out, FRAMES).hours] == [100, 50]


def test_killed_it_has_lost_what_was_not_reported_and_no_more(tmp_path: Path) -> None:
    scribe, out = Scribe(tmp_path), tmp_path / "out"
    with process() as running:
        tell(running, scribe.settings(out, batch_s=0.05) + scribe.header() + scribe.offset())
        tell(running, scribe.instants(0, 100))
        until(running, lambda report: report.rows >= 220)
        tell(running, scribe.instants(100, 150))
        running.send_signal(signal.SIGKILL)
        running.wait(30)
    found = seqs_in(out)
    assert found[:120] == list(range(120))
    # What the next one finds it turns into Parquet, and goes on beside it.
    again = Scribe(tmp_path, run="second")
    with process() as running:
        tell(running, again.settings(out, batch_s=0.05, retry_s=0.1) + again.header() + again.offset())
        tell(running, again.instants(0, 100))
        until(running, lambda report: report.rows >= 220)
        pipe(running.stdin).close()
        running.wait(30)
    runs = open_recorded(out, SAMPLES).runs
    assert [[row.seq for hour in hours for row in rows_of(hour)] for hours in runs] == [found, list(range(120))]


def test_what_a_crash_left_behind_is_turned_into_parquet_at_the_next_start(tmp_path: Path) -> None:
    scribe, out = Scribe(tmp_path), tmp_path / "out"
    out.mkdir()
    with process() as running:
        tell(running, scribe.settings(out) + scribe.header() + scribe.offset() + scribe.instants(0, 100))
        pipe(running.stdin).close()
        running.wait(30)
    left = next(out.glob(f"*.{SAMPLES}.arrows"))
    left.write_bytes(left.read_bytes() + b"\xff\xff\xff\xff\x10\x00\x00\x00torn")
    (out / left.name.replace(".arrows", ".parquet.tmp")).write_bytes(b"half")
    again = Scribe(tmp_path, run="second")
    with process() as running:
        tell(running, again.settings(out, batch_s=0.05, retry_s=0.1) + again.header() + again.offset())
        tell(running, again.instants(0, 10))
        note = until(running, lambda report: "torn" in report.note).note
        assert note == f"{left.name} was torn: 120 rows are whole, 12 bytes at its end are not"
        for k in range(10, 1000):  # A report comes with each batch: until the frames are done, too.
            tell(running, again.instants(k, k + 1))
            until(running, lambda report: True)
            if len(list(out.glob("*.parquet"))) == 2:
                break
        pipe(running.stdin).close()
        running.wait(30)
    assert not left.exists()
    assert left.with_suffix(".parquet").exists()
    assert not list(out.glob("*.tmp"))


def test_a_disk_that_is_full_costs_what_does_not_fit_and_nothing_before(tmp_path: Path) -> None:
    """A file may not grow beyond so many bytes: for the process the same as a disk without room."""
    scribe, out = Scribe(tmp_path), tmp_path / "out"
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (60000, 60000))"
    with process(limit) as running:
        tell(running, scribe.settings(out, batch_s=0.05, retry_s=1000.0) + scribe.header() + scribe.offset())
        for second in range(40):
            tell(running, scribe.instants(100 * second, 100 * second + 100))
            if not until(running, lambda report, rows=220 * (second + 1): report.rows + report.lost >= rows).is_up:  # type: ignore[misc]
                break
        report = until(running, lambda report: True) if second == 39 else None
        assert report is None, "it has never been full"
        pipe(running.stdin).close()
        assert running.wait(30) == 0
    found = seqs_in(out)
    assert len(found) >= 120
    assert found == list(range(len(found)))


@pytest.mark.parametrize("data", [b"GET / HTTP/1.1\r\n\r\n", b"\x02\0\0\0\x02{}", b"\x02\0\0\0\x00{}"])
def test_who_tells_it_something_else_is_told_so(data: bytes) -> None:
    with process() as running:
        _, said = running.communicate(data, timeout=30)
        assert running.returncode == 1
        assert said.startswith(b"recorder: a message of kind ")


def test_it_ends_quietly_when_nothing_was_recorded() -> None:
    with process() as running:
        said, errors = running.communicate(b"", timeout=30)
        assert msgspec.json.decode(said, type=Report) == Report(is_up=False, has_begun=True)
        assert errors == b""
        assert running.returncode == 0
