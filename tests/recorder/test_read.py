"""What may stand where a recording should: each is refused with what, where and what to do, or read with a remark."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from recorded_hours import BEGAN_S, OFFSET_S, Desk, Scribe, write_recording

from heaved.recorder.files import to_parquet
from heaved.recorder.found import RecordedError, is_recorded
from heaved.recorder.layout import FRAMES, SAMPLES
from heaved.recorder.read import open_recorded, rows_of
from heaved.recorder.tables import HEADER_KEY

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    """Two hours: one turned into Parquet, one that is being written."""
    scribe, out = Scribe(tmp_path), tmp_path / "out"
    write_recording(out, scribe, 2)
    for path in sorted(out.glob("*.arrows")):
        to_parquet(path)
    write_recording(out, scribe, 2, first_s=2)
    return out


def all_of(directory: Path) -> list[int]:
    return [row.seq for hour in open_recorded(directory, SAMPLES).hours for row in rows_of(hour)]


def file_of(directory: Path, table: str, ending: str) -> Path:
    return next(directory.glob(f"*.{table}.{ending}"))


def test_parquet_and_arrow_are_read_alike_and_in_order(directory: Path) -> None:
    recorded = open_recorded(directory, SAMPLES)
    assert [hour.path.suffix for hour in recorded.hours] == [".parquet", ".arrows"]
    assert [row.seq for hour in recorded.hours for row in rows_of(hour)] == list(range(480))
    assert recorded.remarks == ()


def test_one_file_is_read_alone_and_found_by_the_name_of_the_other_table(directory: Path) -> None:
    whole = open_recorded(file_of(directory, FRAMES, "parquet"), SAMPLES)
    assert [hour.path for hour in whole.hours] == [file_of(directory, SAMPLES, "parquet")]
    renamed = directory.parent / "monday.parquet"
    shutil.copy(file_of(directory, SAMPLES, "parquet"), renamed)
    assert open_recorded(renamed, SAMPLES).hours[0].rows == 240
    assert open_recorded(directory / file_of(directory, SAMPLES, "arrows").name, FRAMES).hours[0].rows == 200


# ---- what is refused -------------------------------------------------------------------------------------------------


def truncated(directory: Path) -> None:
    path = file_of(directory, SAMPLES, "parquet")
    path.write_bytes(path.read_bytes()[:-100])


def empty_file(directory: Path) -> None:
    file_of(directory, SAMPLES, "parquet").write_bytes(b"")


def damaged_inside(directory: Path) -> None:
    path = file_of(directory, SAMPLES, "parquet")
    data = bytearray(path.read_bytes())
    data[200:2000] = b"\xa5" * 1800
    path.write_bytes(data)


def of_somebody_else(directory: Path) -> None:
    pq.write_table(pa.table({"temperature": [1.0, 2.0]}), directory / "weather.parquet")


def stream_of_somebody_else(directory: Path) -> None:
    with pa.ipc.new_stream(str(directory / "weather.arrows"), pa.schema([("wind", pa.float64())])) as stream:
        stream.write_batch(pa.record_batch({"wind": [1.0]}))


def no_stream_at_all(directory: Path) -> None:
    (directory / "notes.arrows").write_text("this is no Arrow")


def of_another_vessel(directory: Path) -> None:
    write_recording(directory, Scribe(directory.parent, vessel="Other", run="other"), 1, first_s=100)


def the_same_hour_twice(directory: Path) -> None:
    path = file_of(directory, SAMPLES, "parquet")
    shutil.copy(path, path.with_name("copy of monday.parquet"))


def changed(directory: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    path = file_of(directory, SAMPLES, "parquet")
    pq.write_table(change(pq.read_table(path)), path)


def without_a_column(directory: Path) -> None:
    changed(directory, lambda table: table.drop_columns(["fault"]))


def of_a_later_format(directory: Path) -> None:
    def later(table: pa.Table) -> pa.Table:
        header = msgspec.json.decode(table.schema.metadata[HEADER_KEY]) | {"format": 2, "later": True}
        metadata = table.schema.metadata | {HEADER_KEY: msgspec.json.encode(header)}
        return table.replace_schema_metadata(metadata)

    changed(directory, later)


def with_a_call_that_is_none(directory: Path) -> None:
    def odd(table: pa.Table) -> pa.Table:
        column = pa.array(["dance"] * len(table))
        return table.set_column(0, table.schema.field(0), column)

    changed(directory, odd)


REFUSED = [
    (truncated, "is no whole file of its kind"),
    (empty_file, "is empty: copy it again, or leave it out"),
    (damaged_inside, "damaged|no whole file"),
    (of_somebody_else, r"weather.parquet: was not recorded by heaved \(columns temperature"),
    (stream_of_somebody_else, r"weather.arrows: was not recorded by heaved \(columns wind"),
    (no_stream_at_all, "notes.arrows: is no whole file of its kind"),
    (of_another_vessel, r"recordings of 2 vessels \(.* of 'Test', .* of 'Other'\): read each by itself"),
    (the_same_hour_twice, "the same hour twice"),
    (without_a_column, "has other columns than it says"),
    (of_a_later_format, "is of format 2, this release reads 1: use a newer heaved"),
    (with_a_call_that_is_none, "holds 'dance', which no daemon has recorded"),
]


@pytest.mark.parametrize(("spoil", "said"), REFUSED, ids=[spoil.__name__ for spoil, _ in REFUSED])
def test_what_is_no_recording_is_said_to_be_none(directory: Path, spoil: Callable[[Path], None], said: str) -> None:
    spoil(directory)
    with pytest.raises(RecordedError, match=said):
        all_of(directory)


def test_an_empty_directory_and_a_file_that_is_not_there(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordedError, match="holds no recording"):
        open_recorded(tmp_path / "empty", SAMPLES)
    with pytest.raises(RecordedError, match="there is no such file"):
        open_recorded(tmp_path / "nothing.parquet", SAMPLES)
    assert not is_recorded(tmp_path / "in.csv")


def test_samples_alone_have_no_frames(directory: Path) -> None:
    for path in directory.glob(f"*.{FRAMES}.*"):
        path.unlink()
    with pytest.raises(RecordedError, match='what = "samples" keeps none: heaved replay makes them'):
        open_recorded(directory, FRAMES)
    with pytest.raises(RecordedError, match=r"frames\.parquet is not beside it"):
        open_recorded(file_of(directory, SAMPLES, "parquet"), FRAMES)


# ---- what is read with a remark --------------------------------------------------------------------------------------


def test_a_torn_end_is_read_up_to_it(directory: Path) -> None:
    path = file_of(directory, SAMPLES, "arrows")
    path.write_bytes(path.read_bytes()[:-50])
    recorded = open_recorded(directory, SAMPLES)
    assert [row.seq for hour in recorded.hours for row in rows_of(hour)] == list(range(360))
    assert "is torn: the last " in recorded.remarks[0]


def test_a_file_torn_before_its_first_second_is_left_out(directory: Path) -> None:
    path = file_of(directory, SAMPLES, "arrows")
    path.write_bytes(path.read_bytes()[:100])
    recorded = open_recorded(directory, SAMPLES)
    assert [hour.rows for hour in recorded.hours] == [240]
    assert recorded.remarks == (f"{path.name} was torn before its first second",)


def test_an_hour_of_nothing_is_nothing(tmp_path: Path) -> None:
    """Neither samples nor frames came for an hour: there is no file of it, and none is missed."""
    scribe, out = Scribe(tmp_path), tmp_path / "out"
    out.mkdir()
    desk = Desk(out, scribe)
    for second in (0, 3600, 7200):
        desk.told(scribe.header(OFFSET_S + BEGAN_S + second) + scribe.offset())
        if second != 3600:
            desk.told(scribe.instants(100 * second, 100 * second + 100))
    desk.recorder.close(desk.now_s)
    hours = open_recorded(out, SAMPLES).hours
    assert [(hour.first, hour.last) for hour in hours] == [(0, 119), (120, 239)]


def test_runs_of_one_vessel_stand_one_after_the_other(tmp_path: Path) -> None:
    """The second began after a restart of the machine: its clock and its calls begin anew."""
    out = tmp_path / "out"
    write_recording(out, Scribe(tmp_path, run="z first"), 2)
    write_recording(out, Scribe(tmp_path, run="a second"), 1, first_s=50)
    runs = open_recorded(out, SAMPLES).runs
    assert [hours[0].header.run for hours in runs] == ["z first", "a second"]
