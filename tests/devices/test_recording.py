"""The recording reader: sound files give exactly their numbers, everything else is refused with its place."""

from __future__ import annotations

import contextlib
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from heaved.devices.recording import (
    COLUMNS,
    IGNORED,
    STAGE_COLUMNS,
    Recording,
    RecordingError,
)
from heaved.samples import ImuSample, LaserSample

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

HEADER = "t_s,az_mps2,laser_m\n"


def read_recording(path: Path) -> Iterator[tuple[ImuSample | None, LaserSample | None]]:
    """Its rows, as far as they concern the heave."""
    with Recording(path) as recording:
        for imu, laser, *_ in recording.instants():
            yield imu, laser


def write(directory: Path, content: str | bytes) -> Path:
    path = directory / "rec.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def refusal(path: Path) -> RecordingError:
    with pytest.raises(RecordingError) as caught:
        list(read_recording(path))
    assert caught.value.file == str(path)
    assert str(caught.value).startswith(str(path))
    return caught.value


def test_every_column_reaches_its_field_in_si_units(tmp_path: Path) -> None:
    path = write(tmp_path, ",".join(COLUMNS) + "\n100.5,0.1,-0.2,9.8,90,-45,180,0.01,0.02,0.03,12.345\n")
    ((imu, laser),) = read_recording(path)
    assert imu is not None
    assert imu == ImuSample(
        t_s=100.5, ax_mps2=0.1, ay_mps2=-0.2, az_mps2=9.8, roll_rad=imu.roll_rad, pitch_rad=imu.pitch_rad,
        yaw_rad=imu.yaw_rad, gx_radps=0.01, gy_radps=0.02, gz_radps=0.03,
    )  # fmt: skip
    angles = (imu.roll_rad, imu.pitch_rad, imu.yaw_rad)
    assert angles == pytest.approx((math.pi / 2, -math.pi / 4, math.pi), rel=1e-15)
    assert laser == LaserSample(t_s=100.5, laser_m=12.345)


def test_blank_cells_and_absent_columns_are_missing_never_zero(tmp_path: Path) -> None:
    path = write(tmp_path, "t_s,roll_deg,az_mps2,laser_m\n0,,9.8,\n1,2,,3\n2,2,,\n")
    first, second, third = read_recording(path)
    assert first[0] is not None
    assert math.isnan(first[0].roll_rad)
    assert math.isnan(first[0].ax_mps2)
    assert first[1] is None
    assert second == (None, LaserSample(t_s=1.0, laser_m=3.0))
    assert third == (None, None)


def test_forms_that_spreadsheets_and_loggers_write(tmp_path: Path) -> None:
    """Byte-order mark, CRLF, spaces after commas, quotes, exponents, an empty last line, no newline at the end."""
    path = write(tmp_path, b'\xef\xbb\xbf"t_s", az_mps2 ,laser_m\r\n-1.5, +9.8e0, \r\n"-1",.5,-2E-3\r\n\r\n')
    (first, _), (second, laser) = read_recording(path)
    assert first is not None
    assert second is not None
    assert (first.t_s, first.az_mps2, second.t_s, second.az_mps2) == (-1.5, 9.8, -1.0, 0.5)
    assert laser == LaserSample(t_s=-1.0, laser_m=-0.002)
    assert len(list(read_recording(write(tmp_path, HEADER + "0,9.8,1")))) == 1


def test_columns_of_other_stages_are_passed_over(tmp_path: Path) -> None:
    path = write(tmp_path, ",".join(("t_s", *IGNORED, "az_mps2")) + "\n0" + ",junk" * len(IGNORED) + ",9.8\n")
    ((imu, laser),) = read_recording(path)
    assert imu is not None
    assert (imu.az_mps2, laser) == (9.8, None)
    assert math.isnan(imu.gx_radps)


def test_progress_is_measured_in_bytes(tmp_path: Path) -> None:
    path = write(tmp_path, HEADER + "".join(f"{k},9.8,1\n" for k in range(100)))
    with Recording(path) as recording:
        assert recording.has_laser
        assert recording.columns == ("t_s", "az_mps2", "laser_m")
        assert recording.total_bytes == path.stat().st_size
        assert len(list(recording.instants())) == 100
        assert recording.read_bytes == recording.total_bytes


def test_a_pipe_is_read_as_a_file_is() -> None:
    reading, writing = os.pipe()
    os.write(writing, (HEADER + "0,9.8,1\n1,9.8,1\n").encode())
    os.close(writing)
    with Recording(Path(f"/dev/fd/{reading}")) as recording:
        assert len(list(recording.instants())) == 2
        assert (recording.read_bytes, recording.total_bytes) == (0, 0)
    os.close(reading)


REFUSED_ROWS = {
    "word": ("0,9.8,1\n1,abc,1\n", 3, "az_mps2", "'abc' is not a number"),
    "nan text": ("0,nan,1\n", 2, "az_mps2", "'nan' is not finite"),
    "inf text": ("0,9.8,-Infinity\n", 2, "laser_m", "is not finite"),
    "beyond a double": ("0,1e999,1\n", 2, "az_mps2", "is not finite"),
    "python's underscore": ("0,1_000,1\n", 2, "az_mps2", "is not a number"),
    "digits of another script": ("0,٣,1\n", 2, "az_mps2", "is not a number"),
    "decimal comma": ('0,"9,8",1\n', 2, "az_mps2", "is not a number"),
    "hexadecimal": ("0,0x10,1\n", 2, "az_mps2", "is not a number"),
    "two numbers": ('0,"9.8, 1",1\n', 2, "az_mps2", "is not a number"),
    "null": ("0,null,1\n", 2, "az_mps2", "is not a number"),
    "true": ("0,true,1\n", 2, "az_mps2", "is not a number"),
    "brackets": ("0,[9.8],1\n", 2, "az_mps2", "is not a number"),
    "too few cells": ("0,9.8,1\n1,9.8\n", 3, "", "2 cells, but the header has 3"),
    "too many cells": ("0,9.8,1,4\n", 2, "", "4 cells, but the header has 3"),
    "cut short": ("0,9.8,1\n1,9.", 3, "", "2 cells"),
    "time repeats": ("0,9.8,1\n1,9.8,1\n1,9.8,1\n", 4, "t_s", "does not come after 1.0"),
    "time runs back": ("5,9.8,1\n\n4,9.8,1\n", 4, "t_s", "'4' does not come after 5.0"),
    "time stands still": ("0,9.8,1\n5e-324,9.8,1\n", 3, "t_s", "'5e-324' does not come after 0.0"),
    "no time": ("0,9.8,1\n,9.8,1\n", 3, "t_s", "is blank"),
    "open quote": ('0,"9.8,1\n', 2, "", "is not CSV"),
    "no rows": ("", 0, "", "no rows"),
    "a long cell": ("0," + "x" * 1000 + ",1\n", 2, "az_mps2", "…' is not a number"),
    "beyond any accelerometer": ("0,1001,1\n", 2, "az_mps2", "more than any sensor measures (1000 mps2)"),
    "near the end of a double": ("0,9.8,1\n1,-1e308,1\n", 3, "az_mps2", "'-1e308' is more than any sensor"),
    "beyond any laser": ("0,9.8,1e5\n", 2, "laser_m", "more than any sensor measures (10000 m)"),
    "a time of 1e300": ("1e300,9.8,1\n", 2, "t_s", "is no time in seconds"),
    "milliseconds since 1970": ("1767225600000,9.8,1\n", 2, "t_s", "is t_s in ms?"),
    "microseconds since 1970": ("1767225600000000,9.8,1\n", 2, "t_s", "is t_s in µs?"),
    "nanoseconds since 1970": ("1767225600000000000,9.8,1\n", 2, "t_s", "is t_s in ns?"),
    "an endless line": ("0,9.8,1\n" + "1" * 200_000 + ",9.8,1\n", 3, "", "1 cells, but the header has 3"),
    "null bytes": ("0,\0\0,1\n", 2, "", "is not"),
}


@pytest.mark.parametrize("name", REFUSED_ROWS)
def test_malformed_rows_are_refused_with_their_place(tmp_path: Path, name: str) -> None:
    body, line, column, reason = REFUSED_ROWS[name]
    error = refusal(write(tmp_path, HEADER + body))
    assert error.line == line
    assert reason in error.reason
    if column:
        assert error.column == column
        assert f"line {line}, column {column}" in str(error)


@pytest.mark.parametrize("name", [name for name in COLUMNS + STAGE_COLUMNS if name not in ("t_s", "az_mps2")])
def test_no_column_takes_what_no_sensor_measures(tmp_path: Path, name: str) -> None:
    error = refusal(write(tmp_path, f"t_s,az_mps2,{name}\n0,9.8,-9.9e9\n"))
    assert (error.line, error.column) == (2, name)
    assert "more than any sensor measures" in error.reason
    largest = {"mps2": 1e3, "deg": 1e4, "radps": 1e3, "m": 1e4, "mps": 1e3}[name.rpartition("_")[2]]
    assert len(list(read_recording(write(tmp_path, f"t_s,az_mps2,{name}\n0,9.8,{-largest}\n")))) == 1


def stamped(times: Iterable[float]) -> str:
    return "t_s,az_mps2\n" + "".join(f"{t!r},9.8\n" for t in times)


TOO_SLOW = {
    "ms, 20 Hz": ([50.0 * k for k in range(30)], 3, "samples 50 s apart: is t_s in ms? (20 samples a second"),
    "ms, 200 Hz": ([5.0 * k for k in range(30)], 3, "samples 5 s apart: is t_s in ms? (200 samples a second"),
    "ms, a file of three": ([0.0, 50.0, 100.0], 3, "samples 50 s apart: is t_s in ms?"),
    "ms, a hole and jitter": (
        [0.0, 5e6, *(5e6 + 50.0 * k + k % 3 for k in range(1, 30))], 3, "s apart: is t_s in ms?"
    ),
    "µs, 100 Hz": ([1e4 * k for k in range(30)], 3, "samples 10000 s apart: is t_s in µs? (100 samples a second"),
    "µs, 500 Hz": ([2e3 * k for k in range(30)], 3, "samples 2000 s apart: is t_s in µs? (500 samples a second"),
    "ns, 100 Hz": ([1e7 * k for k in range(30)], 3, "samples 1e+07 s apart: is t_s in ns? (100 samples a second"),
    "2 s": ([2.0 * k for k in range(30)], 3, "samples 2 s apart: too slow to show waves"),
    "3 s": ([1.7e9 + 3.0 * k for k in range(30)], 3, "samples 3 s apart: too slow to show waves"),
    "2.5 s after a quick start": ([0.0, 0.1, *(2.5 * k for k in range(1, 30))], 4, "samples 2.5 s apart: too slow"),
}  # fmt: skip


@pytest.mark.parametrize("name", TOO_SLOW)
def test_samples_seconds_apart_are_refused_with_what_is_likely(tmp_path: Path, name: str) -> None:
    times, line, reason = TOO_SLOW[name]
    error = refusal(write(tmp_path, stamped(times)))
    assert (error.line, error.column) == (line, "t_s")
    assert reason in error.reason


NOT_TOO_SLOW = {
    "one row": [0.0],
    "two rows": [0.0, 60.0],
    "1 Hz": [1.0 * k for k in range(30)],
    "a hole at the start": [0.0, 3600.0, *(3600.0 + 0.05 * k for k in range(1, 30))],
    "a hole at the start of a short one": [0.0, 3600.0, 3600.05, 3600.1],
    "every other sample lost for long": [t for k in range(30) for t in (10.0 * k, 10.0 * k + 0.05)],
    "slow later": [0.05 * k for k in range(30)] + [10.0 + 3.0 * k for k in range(30)],
}


@pytest.mark.parametrize("name", NOT_TOO_SLOW)
def test_a_recording_with_holes_is_not_slow(tmp_path: Path, name: str) -> None:
    times = NOT_TOO_SLOW[name]
    assert len(list(read_recording(write(tmp_path, stamped(times))))) == len(times)


def test_rows_without_an_imu_say_nothing_of_its_interval(tmp_path: Path) -> None:
    body = "".join(f"{10.0 * k!r},,1\n" for k in range(30)) + "".join(f"{300 + 0.05 * k:.2f},9.8,\n" for k in range(30))
    assert len(list(read_recording(write(tmp_path, HEADER + body)))) == 60


REFUSED_HEADERS: dict[str, tuple[str | bytes, str]] = {
    "empty file": ("", "is empty"),
    "blank first line": ("\nt_s,az_mps2\n", "first line is blank"),
    "numbers at once": ("0,9.8,1\n", "no header row"),
    "no t_s": ("az_mps2\n1\n", "column t_s is missing"),
    "no az_mps2": ("t_s,ax_mps2\n1,1\n", "column az_mps2 is missing"),
    "unknown": ("t_s,az_mps2,speed\n", "unknown column; columns are t_s"),
    "radians": ("t_s,az_mps2,roll_rad\n", "did you mean roll_deg?"),
    "millimetres": ("t_s,az_mps2,laser_mm\n", "did you mean laser_m?"),
    "g": ("t_s,az_g\n", "did you mean az_mps2?"),
    "degrees a second": ("t_s,az_mps2,gx_dps\n", "did you mean gx_radps?"),
    "another time": ("time_s,az_mps2\n", "did you mean t_s?"),
    "twice": ("t_s,az_mps2,az_mps2\n", "is named twice"),
    "unnamed": ("t_s,az_mps2,\n0,1,2\n", "unknown column"),
    "semicolons": ("t_s;az_mps2\n0;9,8\n", "separated by commas"),
    "latin-1": ("t_s,az_mps2,größe\n".encode("latin-1"), "is not UTF-8"),
    "binary": (bytes(range(128, 256)) * 100, "is not UTF-8"),
    "one endless line": ("x" * 100_000, "no header row"),
}


@pytest.mark.parametrize("name", REFUSED_HEADERS)
def test_what_is_no_header_is_refused(tmp_path: Path, name: str) -> None:
    content, reason = REFUSED_HEADERS[name]
    error = refusal(write(tmp_path, content))
    assert error.line == 1
    assert reason in str(error)


def test_bytes_that_are_not_utf8_far_in_the_file(tmp_path: Path) -> None:
    body = "".join(f"{k},9.8,1\n" for k in range(50_000))
    error = refusal(write(tmp_path, (HEADER + body).encode() + b"60000,9.8,\xff\n"))
    assert "is not UTF-8 text (byte 0xff" in error.reason
    assert "after line" in error.reason


def test_bytes_that_are_not_utf8_near_the_start_are_on_their_line(tmp_path: Path) -> None:
    body = "".join(f"{k},9.8,1\n" for k in range(50))
    assert refusal(write(tmp_path, (HEADER + body).encode() + b"60,9.8,\xff\n")).line == 52


def test_files_that_cannot_be_opened(tmp_path: Path) -> None:
    assert "cannot be read: No such file" in refusal(tmp_path / "absent.csv").reason
    assert "cannot be read: Is a directory" in refusal(tmp_path).reason


@given(st.binary(max_size=200))
def test_arbitrary_bytes_give_finite_samples_or_a_refusal(
    tmp_path_factory: pytest.TempPathFactory, tail: bytes
) -> None:
    path = write(tmp_path_factory.mktemp("fuzz"), HEADER.encode() + tail)
    with contextlib.suppress(RecordingError):
        for imu, laser in read_recording(path):
            assert imu is None or math.isfinite(imu.az_mps2)
            assert laser is None or math.isfinite(laser.laser_m)


@given(st.lists(st.floats(-100, 100), min_size=1, max_size=20))
def test_numbers_come_back_exactly(tmp_path_factory: pytest.TempPathFactory, numbers: list[float]) -> None:
    """Whether a cell of their row is blank or none is."""
    body = "".join(f"{k},{value!r},{'' if k % 2 else k}\n" for k, value in enumerate(numbers))
    rows = list(read_recording(write(tmp_path_factory.mktemp("exact"), HEADER + body)))
    assert [imu.az_mps2 for imu, _ in rows if imu is not None] == numbers
