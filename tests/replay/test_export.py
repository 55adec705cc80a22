"""What is exported, read back by others: the csv module, netCDF4. Times are UTC, units and names those of CF."""

from __future__ import annotations

import csv
import importlib.util
import math
import os
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import netCDF4
import numpy as np
import pytest
from recorded_hours import BEGAN_S, OFFSET_S, Desk, Scribe, write_recording

from heaved.estimation import quiescence
from heaved.recorder.files import to_parquet
from heaved.recorder.found import RecordedError
from heaved.replay.export import STATES, export, variable_name
from heaved.replay.replay import OutputError
from heaved.replay.table import Table

if TYPE_CHECKING:
    from pathlib import Path

    pass


@pytest.fixture
def recorded(tmp_path: Path) -> tuple[Path, Scribe]:
    """Ten seconds, as Parquet, and two more as a stream of Arrow."""
    scribe, directory = Scribe(tmp_path), tmp_path / "out"
    write_recording(directory, scribe, 10)
    for path in sorted(directory.glob("*.arrows")):
        to_parquet(path, table_rows=300)
    write_recording(directory, scribe, 2, first_s=10)
    return directory, scribe


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_csv_has_the_columns_of_a_replay_and_utc(recorded: tuple[Path, Scribe], tmp_path: Path) -> None:
    directory, scribe = recorded
    done = export(directory, tmp_path / "out.csv")
    rows = rows_of(tmp_path / "out.csv")
    table = Table(scribe.config, lambda _: None)
    assert list(rows[0]) == ["t_s", "time", *table.names[1:]]
    assert done.rows == len(rows) == len(scribe.frames) == 1200
    assert (done.vessel, done.began, done.ended) == ("Test", rows[0]["time"][:23] + "Z", done.ended)
    for row, frame in zip(rows, scribe.frames, strict=True):
        assert float(row["t_s"]) == pytest.approx(frame.t_s, abs=0.6e-6)
        utc = np.datetime64(row["time"].removesuffix("Z")).astype("datetime64[us]").astype(int) * 1e-6
        assert utc == pytest.approx(frame.t_s + OFFSET_S, abs=2e-6)
        assert float(row["heave_m"]) == pytest.approx(frame.heave_m, abs=0.51e-4)
        assert float(row["forecast_5s_m"]) == pytest.approx(frame.forecast[6].heave_m, abs=0.51e-2)
        assert row["correction_m"] == row["yaw_1s_deg"] == ""
        assert row["quality"] == "valid"


def test_the_delayed_heave_stands_at_its_own_time(tmp_path: Path) -> None:
    """It is told a minute after the row where it belongs: the first ten seconds get it from the last ten of 70."""
    scribe = Scribe(tmp_path)
    write_recording(tmp_path / "out", scribe, 70)
    export(tmp_path / "out", tmp_path / "out.csv", columns=["delayed_heave_m", "heave_m"])
    rows = rows_of(tmp_path / "out.csv")
    known = [row for row in rows if row["delayed_heave_m"]]
    assert {math.floor(float(row["t_s"]) - BEGAN_S) for row in known} == set(range(10))
    # It is that of the wave at the row, since that of the helper is: sin(0.01 k - 60) at k hundredths less a minute.
    for row in known:
        k = (float(row["t_s"]) - BEGAN_S) * 100.0
        assert float(row["delayed_heave_m"]) == pytest.approx(math.sin(0.01 * (k + 6000.0) - 60.0), abs=2e-4)


def test_netcdf_is_read_back_with_names_units_and_what_is_not_known(
    recorded: tuple[Path, Scribe], tmp_path: Path
) -> None:
    directory, scribe = recorded
    export(directory, tmp_path / "out.nc", columns=["all"])
    frames = scribe.frames
    with netCDF4.Dataset(tmp_path / "out.nc") as data:
        assert data.Conventions == "CF-1.11"
        assert data.platform == "Test"
        time = data["time"]
        assert (time.units, time.standard_name, time.axis) == ("seconds since 1970-01-01 00:00:00", "time", "T")
        assert np.diff(time[:]).min() > 0.0
        np.testing.assert_allclose(time[:], [frame.t_s + OFFSET_S for frame in frames], atol=1e-6)
        for name, expected, standard, units in (
            ("heave_m", [frame.heave_m for frame in frames], "platform_heave_up", "m"),
            ("heave_std_m", [frame.heave_std_m for frame in frames], "platform_heave_up standard_error", "m"),
            ("roll_deg", [math.degrees(f.roll_rad) for f in frames], "platform_roll_starboard_down", "degree"),
            ("pitch_deg", [math.degrees(f.pitch_rad) for f in frames], "platform_pitch_fore_up", "degree"),
        ):
            variable = data[name]
            assert (variable.standard_name, variable.units) == (standard, units)
            np.testing.assert_allclose(variable[:], expected, atol=0.6e-3)
        assert data["forecast_0p05s_m"].units == "m"
        assert data["heave_velocity_mps"].units == "m s-1"
        unknown = data["yaw_deg"]
        assert unknown[:].mask.all()
        assert unknown._FillValue > 1e36
        quality = data["quality"]
        assert quality.flag_meanings.split() == list(STATES)
        assert set(quality[:].tolist()) == {list(quality.flag_values)[STATES.index("valid")]}
        assert set(data["reasons"][:].tolist()) == {"one; two"}
        assert all(dimensions == ("time",) for dimensions in (v.dimensions for v in data.variables.values()))


@pytest.mark.parametrize(
    ("name", "said"),
    [("forecast_0.05s_m", "forecast_0p05s_m"), ("point_crane-tip_heave_m", "point_crane_tip_heave_m")],
)
def test_names_are_those_that_cf_takes(name: str, said: str) -> None:
    assert variable_name(name) == said


def test_every_so_many_seconds_the_first_frame(recorded: tuple[Path, Scribe], tmp_path: Path) -> None:
    done = export(recorded[0], tmp_path / "out.csv", every_s=0.5, columns=["heave_m"])
    times = [float(row["t_s"]) for row in rows_of(tmp_path / "out.csv")]
    assert done.rows == len(times) == 24
    spans = np.floor((np.array(times) + OFFSET_S) / 0.5)
    assert (np.diff(spans) == 1.0).all()


def test_a_clock_that_is_stepped_leaves_the_times_in_order(tmp_path: Path) -> None:
    """Twice, an hour ahead and a minute back; the recording itself keeps what was published."""
    scribe, directory = Scribe(tmp_path), tmp_path / "out"
    directory.mkdir()
    desk = Desk(directory, scribe)
    desk.told(scribe.header())
    for second, offset_s in enumerate((OFFSET_S, OFFSET_S + 0.004, OFFSET_S + 3600.0, OFFSET_S + 3540.0)):
        desk.told(scribe.offset(offset_s) + scribe.instants(100 * second, 100 * second + 100))
        desk.recorder.write(desk.now_s)
    desk.recorder.close(desk.now_s)
    done = export(directory, tmp_path / "out.nc", columns=["heave_m"])
    assert [remark.split(" at ")[0] for remark in done.remarks] == [
        "the clock was stepped by +3599.996 s",
        "the clock was stepped by -60.000 s",
    ]
    with netCDF4.Dataset(tmp_path / "out.nc") as data:
        utc_s = np.array(data["time"][:])
    # The last second is told by its own clock, the others as they were before it; what was slewed stays so.
    expected = [frame.t_s + OFFSET_S + 3540.0 - (0.004 if k < 100 else 0.0) for k, frame in enumerate(scribe.frames)]
    np.testing.assert_allclose(utc_s, expected, atol=2e-6)


def test_hours_of_another_configuration_have_blanks_where_it_had_no_column(tmp_path: Path) -> None:
    directory = tmp_path / "out"
    write_recording(directory, Scribe(tmp_path), 1)
    quiet: dict[str, Any] = {"quiet": quiescence.Params(enabled=True)}
    write_recording(directory, Scribe(tmp_path, run="second", **quiet), 1, first_s=10)
    export(directory, tmp_path / "out.csv", columns=["t_s", "quiet_confidence", "heave_m"])
    rows = rows_of(tmp_path / "out.csv")
    assert len(rows) == 200
    assert {row["quiet_confidence"] for row in rows} == {""}
    assert "" not in {row["heave_m"] for row in rows}


# ---- what cannot be exported -----------------------------------------------------------------------------------------


def test_what_cannot_be_exported_is_said_and_nothing_is_left_behind(
    recorded: tuple[Path, Scribe], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory, _ = recorded
    (tmp_path / "in.csv").write_text("t_s,az_mps2\n0,9.8\n")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(RecordedError, match="has no column heave; there are heave_m"):
        export(directory, tmp_path / "out.csv", columns=["heave"])
    with pytest.raises(RecordedError, match="made by heaved replay"):
        export(tmp_path / "in.csv", tmp_path / "out.csv")
    with pytest.raises(RecordedError, match="there is no such file"):
        export(tmp_path / "absent", tmp_path / "out.csv")
    with pytest.raises(OutputError, match=r"\.xls is neither CSV nor netCDF"):
        export(directory, tmp_path / "out.xls")
    for name in ("out.csv", "out.nc"):
        with pytest.raises(OutputError, match="cannot be written"):
            export(directory, tmp_path / "nowhere" / name)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(RecordedError, match=r"pip install 'heaved\[recording\]'"):
        export(directory, tmp_path / "out.csv")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "netCDF4" else name)
    with pytest.raises(OutputError, match=r"pip install 'heaved\[export\]'"):
        export(directory, tmp_path / "out.nc")
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("name", ["out.csv", "out.nc"])
def test_a_full_disk_leaves_nothing_behind(recorded: tuple[Path, Scribe], tmp_path: Path, name: str) -> None:
    directory, _ = recorded
    target = tmp_path / "target"
    target.mkdir()
    script = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000));"
        f"from heaved.cli import main; sys.exit(main(['export', {str(directory)!r}, '-o', {str(target / name)!r}]))"
    )
    done = subprocess.run((sys.executable, "-c", script), capture_output=True, text=True, check=False, env=os.environ)
    assert done.returncode == 1
    assert f"{target / name}: cannot be written" in done.stderr
    assert list(target.iterdir()) == []
