"""Files that a crash or a full disk may leave: what is whole is read, the rest is said; old ones go whole."""

from __future__ import annotations

import errno
import os
import time
from typing import TYPE_CHECKING, Any

import pyarrow.parquet as pq
import pytest
from recorded_hours import BEGAN_S, OFFSET_S, Desk, Scribe, write_recording
from running import demo_config

from heaved.recorder import files
from heaved.recorder.files import delete_old, new_stem, pairs, to_parquet, whole_batches
from heaved.recorder.found import RecordedError
from heaved.recorder.layout import HANDOVER, SAMPLES
from heaved.recorder.read import open_recorded, rows_of

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def stream(tmp_path: Path) -> Path:
    """Three seconds of samples."""
    write_recording(tmp_path / "out", Scribe(tmp_path), 3)
    return next((tmp_path / "out").glob(f"*.{SAMPLES}.arrows"))


def test_a_tail_torn_at_any_byte_costs_the_last_batch_and_no_more(tmp_path: Path) -> None:
    laser = demo_config(tmp_path).device[1:]
    write_recording(tmp_path / "out", Scribe(tmp_path, device=laser), 3)
    stream = next((tmp_path / "out").glob(f"*.{SAMPLES}.arrows"))
    whole = stream.read_bytes()
    ends = [end for _, end in whole_batches(stream)]
    assert len(ends) == 3
    assert ends[-1] == len(whole)
    torn = tmp_path / "torn.samples.arrows"
    first, end = ends[1:]
    # Every byte of its head and of its end, and of what is between every seventh: messages are aligned to eight.
    for cut in sorted({*range(first, first + 100), *range(first, end, 7), *range(end - 100, end)}):
        torn.write_bytes(whole[:cut])
        assert [end for _, end in whole_batches(torn)] == ends[:2], cut


@pytest.mark.parametrize("batches", [0, 1, 2, 3])
@pytest.mark.parametrize("more", [0, 1, 7, 8, 9, 300])
def test_a_torn_stream_becomes_the_parquet_of_what_is_whole(stream: Path, batches: int, more: int) -> None:
    whole = stream.read_bytes()
    ends = [0, *(end for _, end in whole_batches(stream))]
    kept = (whole + b"\0" * 300)[: ends[batches] + more]
    stream.write_bytes(kept)
    done = to_parquet(stream)
    assert done.rows == 120 * batches
    target = stream.with_suffix(".parquet")
    assert not stream.exists()
    assert target.exists() is (batches > 0)
    assert done.torn_bytes == (more if batches else len(kept))
    if batches:
        rows = [row for hour in open_recorded(target, SAMPLES).hours for row in rows_of(hour)]
        assert [row.seq for row in rows] == list(range(120 * batches))


def test_a_stream_that_is_damaged_in_its_middle_is_kept_beside_what_is_whole(tmp_path: Path) -> None:
    write_recording(tmp_path / "out", Scribe(tmp_path), 9)
    stream = next((tmp_path / "out").glob(f"*.{SAMPLES}.arrows"))
    spoilt = bytearray(stream.read_bytes())
    ends = [end for _, end in whole_batches(stream)]
    spoilt[ends[1] : ends[1] + 64] = bytes(64)
    stream.write_bytes(spoilt)
    done = to_parquet(stream)
    assert (done.rows, done.torn_bytes) == (240, len(spoilt) - ends[1])
    kept = stream.with_name(done.kept)
    assert kept.read_bytes() == spoilt
    assert not stream.exists()
    (pair,) = [pair for pair in pairs(kept.parent) if kept in pair.paths]  # So that it goes when its hour does.
    assert stream.with_suffix(".parquet") in pair.paths


def test_a_byte_that_the_disk_has_turned_is_not_read_as_a_value(stream: Path) -> None:
    to_parquet(stream)
    path = stream.with_suffix(".parquet")
    with pq.ParquetFile(path) as file:
        group = file.metadata.row_group(0)
        column = next(group.column(i) for i in range(group.num_columns) if group.column(i).path_in_schema == "t_s")
    spoilt = bytearray(path.read_bytes())
    spoilt[column.data_page_offset + column.total_compressed_size - 3] ^= 1
    path.write_bytes(spoilt)
    with pytest.raises(RecordedError, match="is damaged"):
        [row for hour in open_recorded(path, SAMPLES).hours for row in rows_of(hour)]


def test_parquet_is_as_private_as_the_stream(stream: Path) -> None:
    mode = stream.stat().st_mode
    to_parquet(stream)
    assert stream.with_suffix(".parquet").stat().st_mode == mode


def test_parquet_is_made_of_integers_packed_as_differences(stream: Path) -> None:
    to_parquet(stream)
    with pq.ParquetFile(stream.with_suffix(".parquet")) as file:
        group = file.metadata.row_group(0)
        columns = {group.column(i).path_in_schema: group.column(i) for i in range(group.num_columns)}
    for name in ("seq", "t_s", "utc_offset_us"):
        assert "DELTA_BINARY_PACKED" in columns[name].encodings
        assert columns[name].compression == "ZSTD"


def test_a_crash_between_the_renaming_and_the_end_of_the_stream_repeats_nothing(stream: Path) -> None:
    kept = stream.read_bytes()
    to_parquet(stream)
    stream.write_bytes(kept)
    recorded = open_recorded(stream.parent, SAMPLES)
    assert [hour.rows for hour in recorded.hours] == [360]
    assert to_parquet(stream).rows == 0
    assert not stream.exists()


def test_a_disk_that_is_full_while_parquet_is_written_leaves_the_stream(
    stream: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, schema: Any) -> Any:
        path.write_bytes(b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    before = stream.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(files, "_writer", full)
        with pytest.raises(OSError, match="No space"):
            to_parquet(stream)
    assert stream.read_bytes() == before
    assert [path.name for path in stream.parent.iterdir() if "parquet" in path.name] == []
    assert to_parquet(stream).rows == 360


def make(directory: Path, day: int, hour: int, size: int) -> str:
    stem = f"heaved-202611{day:02d}T{hour:02d}0000Z"
    for table in ("samples", "frames"):
        (directory / f"{stem}.{table}.parquet").write_bytes(b"x" * (size // 2))
    return stem


def test_the_oldest_go_whole_until_the_rest_is_small_enough(tmp_path: Path) -> None:
    stems = [make(tmp_path, 1, hour, 1000) for hour in range(6)]
    other = tmp_path / "heaved-notes.txt"
    other.write_bytes(b"x" * 5000)
    now_s = pairs(tmp_path)[-1].began_utc_s
    gone = delete_old(tmp_path, max_bytes=3500, max_age_s=1e9, now_utc_s=now_s, keep=stems[-1])
    assert gone == stems[:3]
    assert [pair.stem for pair in pairs(tmp_path)] == stems[3:]
    assert other.exists()


def test_those_that_are_too_old_go_and_the_one_that_is_written_stays(tmp_path: Path) -> None:
    stems = [make(tmp_path, day, 0, 10) for day in (1, 2, 3)]
    now_s = pairs(tmp_path)[-1].began_utc_s
    assert delete_old(tmp_path, max_bytes=10**9, max_age_s=1.5 * 86400.0, now_utc_s=now_s, keep="") == stems[:1]
    assert delete_old(tmp_path, max_bytes=0, max_age_s=0.0, now_utc_s=now_s + 1e6, keep=stems[2]) == stems[1:2]


def test_no_two_pairs_have_one_name(tmp_path: Path) -> None:
    names = []
    for _ in range(3):
        names.append(new_stem(tmp_path, 1.8e9))
        (tmp_path / f"{names[-1]}.samples.arrows").touch()
    assert len(set(names)) == 3
    assert all(files.NAME.fullmatch(f"{name}.samples.arrows") for name in names)


def test_a_clock_that_is_stepped_deletes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A year ahead, by a wrong fix; a day of it is another matter, and by then somebody knows."""
    out = tmp_path / "out"
    write_recording(out, Scribe(tmp_path), 1)
    (old,) = pairs(out)
    utc_s = [old.began_utc_s + 60.0]
    monkeypatch.setattr(time, "time", lambda: utc_s[0])
    scribe = Scribe(tmp_path, run="next")
    desk = Desk(out, scribe, max_age_s=30.0 * 86400.0)

    def passes(seconds: float, step_s: float = 0.0) -> list[str]:
        utc_s[0] += seconds + step_s
        desk.told(scribe.header() + scribe.offset() + scribe.instants(0, 10), elapsed_s=seconds)
        desk.told(b"", elapsed_s=0.0)
        return [pair.stem for pair in pairs(out)]

    passes(1.0)
    desk.recorder.write(desk.now_s)
    assert old.stem in passes(100.0)
    assert old.stem in passes(100.0, step_s=365.0 * 86400.0)
    for _ in range(10):
        assert old.stem in passes(3600.0)
    assert old.stem in passes(100.0, step_s=-365.0 * 86400.0)
    for _ in range(30):
        assert old.stem in passes(3600.0)
    for _ in range(31):
        there = passes(86400.0)
    assert old.stem not in there


# ---- a disk that does not do its part --------------------------------------------------------------------------------


DISKS = [
    (errno.ENOSPC, "no room is left: free some, or lower", True),
    (errno.EROFS, "is read-only: mount it writable", True),
    (errno.EIO, "cannot be written to", False),
]
"""Failure, what is said of it, and whether the system shows when it is over."""


def _statvfs(*, free: bool, writable: bool) -> os.statvfs_result:
    """Of a disk with blocks of 4 KiB."""
    room = 1 << 20 if free else 0
    return os.statvfs_result((4096, 4096, 1 << 21, room, room, 100, 100, 100, 0 if writable else os.ST_RDONLY, 255))


@pytest.mark.parametrize(("number", "said", "is_shown"), DISKS)
def test_a_disk_that_takes_nothing_is_said_counted_and_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, said: str, is_shown: bool
) -> None:
    scribe = Scribe(tmp_path)
    out = tmp_path / "out"
    out.mkdir()
    desk = Desk(out, scribe, retry_s=60.0)
    desk.told(scribe.header() + scribe.offset())
    desk.told(scribe.instants(0, 100))
    desk.told(b"", elapsed_s=1.0)
    assert desk.reports[-1].is_up
    with monkeypatch.context() as patch:
        written: list[int] = []

        def fail(fd: int, data: Any) -> int:
            if not written:  # Half of it is taken, as a disk does that has a little room.
                written.append(fd)
                return real(fd, data[: len(data) // 2])
            raise OSError(number, os.strerror(number))

        real = os.write
        patch.setattr(os, "write", fail)
        desk.told(scribe.instants(100, 200))
        desk.told(b"", elapsed_s=1.0)
    assert not desk.reports[-1].is_up
    assert said in desk.reports[-1].detail
    assert ("tried again every 60 s" in desk.reports[-1].detail) is not is_shown
    assert desk.reports[-1].lost == 220
    # Nothing has changed, and it is not tried.
    with monkeypatch.context() as patch:
        patch.setattr(os, "statvfs", lambda _: _statvfs(free=number == errno.EROFS, writable=number != errno.EROFS))
        desk.told(scribe.instants(200, 300))
        desk.told(b"", elapsed_s=10.0)
    assert (desk.reports[-1].is_up, desk.reports[-1].lost) == (False, 440)
    # What the system shows to be over is tried at once, the rest after its time.
    monkeypatch.setattr(os, "statvfs", lambda _: _statvfs(free=True, writable=True))
    if not is_shown:
        desk.told(b"", elapsed_s=60.0)
    desk.told(scribe.instants(300, 400))
    desk.told(b"", elapsed_s=1.0)
    assert desk.reports[-1].is_up
    assert (desk.reports[-1].rows, desk.reports[-1].lost) == (440, 440)
    # And from then on all goes there as ever.
    for second in (4, 5):
        desk.told(scribe.instants(100 * second, 100 * second + 100))
        desk.told(b"", elapsed_s=1.0)
        assert (desk.reports[-1].rows, desk.reports[-1].lost) == (220 * (second - 1), 440)
    desk.recorder.close(desk.now_s)
    recorded = open_recorded(out, SAMPLES)
    rows = [row.seq for hour in recorded.hours for row in rows_of(hour)]
    assert rows == [*range(120), *range(360, 720)]
    assert not any(hour.torn_bytes for hour in recorded.hours)  # The half that was taken was taken back.


def test_a_directory_that_is_not_there_is_made_but_not_what_it_should_stand_on(tmp_path: Path) -> None:
    scribe = Scribe(tmp_path)
    desk = Desk(tmp_path / "mount" / "recordings", scribe, retry_s=60.0)
    desk.told(scribe.header() + scribe.offset() + scribe.instants(0, 100))
    desk.told(b"", elapsed_s=1.0)
    assert "is not there: mount or make it" in desk.reports[-1].detail
    assert not (tmp_path / "mount").exists()
    (tmp_path / "mount").mkdir()
    desk.told(scribe.instants(100, 200))
    desk.told(b"", elapsed_s=1.0)
    assert desk.reports[-1].is_up
    desk.recorder.close(desk.now_s)
    assert len(pairs(tmp_path / "mount" / "recordings")) == 1


def test_what_a_daemon_had_to_leave_is_recorded_by_the_next(tmp_path: Path) -> None:
    left, scribe, out = Scribe(tmp_path, run="left"), Scribe(tmp_path, run="next"), tmp_path / "out"
    out.mkdir()
    # Two hours of it, and beside it one that nobody can read.
    told = left.header() + left.offset() + left.instants(0, 100)
    told += left.header() + left.offset() + left.instants(100, 150)
    (out / f"heaved-left-1{HANDOVER}").write_bytes(told)
    (out / f"heaved-none-1{HANDOVER}").write_bytes(b"\xff" * 100)
    desk = Desk(out, scribe)
    desk.told(scribe.header() + scribe.offset() + scribe.instants(0, 100))
    desk.told(b"", elapsed_s=1.0)
    assert desk.reports[-1].rows == 220
    desk.recorder.close(desk.now_s)
    runs = {hours[0].header.run: hours for hours in open_recorded(out, SAMPLES).runs}
    assert [row.seq for hour in runs["left"] for row in rows_of(hour)] == list(range(180))
    assert [row.seq for hour in runs["next"] for row in rows_of(hour)] == list(range(120))
    assert [path.name for path in out.glob(f"*{HANDOVER}*")] == [f"heaved-none-1{HANDOVER}.damaged"]
    notes = " ".join(report.note for report in desk.reports)
    assert "330 rows that the daemon before had to leave are recorded (heaved-left-1.handover)" in notes
    assert "heaved-none-1.handover cannot be taken over" in notes


def test_a_directory_of_another_daemon_is_left_to_it(tmp_path: Path) -> None:
    first, second = Scribe(tmp_path, run="first"), Scribe(tmp_path, run="second")
    out = tmp_path / "out"
    out.mkdir()
    desks = [Desk(out, first), Desk(out, second)]
    for desk, scribe in zip(desks, (first, second), strict=True):
        desk.told(scribe.header() + scribe.offset() + scribe.instants(0, 100))
        desk.told(b"", elapsed_s=1.0)
    assert desks[0].reports[-1].is_up
    assert "another daemon records into" in desks[1].reports[-1].detail
    assert desks[1].reports[-1].lost == 220


def test_each_header_begins_another_pair(tmp_path: Path) -> None:
    scribe = Scribe(tmp_path)
    out = tmp_path / "out"
    out.mkdir()
    desk = Desk(out, scribe)
    for hour in range(3):
        desk.told(scribe.header(OFFSET_S + BEGAN_S + hour) + scribe.offset())
        desk.told(scribe.instants(100 * hour, 100 * hour + 100))
    desk.recorder.close(desk.now_s)
    hours = open_recorded(out, SAMPLES).hours
    assert [(hour.first, hour.last) for hour in hours] == [(0, 119), (120, 239), (240, 359)]
