"""Replay: the same to the byte, causal, whole or not there at all, and columns that hold what their names say."""

from __future__ import annotations

import contextlib
import csv
import math
import stat
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heaved.config import Config
from heaved.devices.recording import COLUMNS, RecordingError
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, lead
from heaved.estimation.rock import params as rock
from heaved.replay.replay import OutputError, Summary, Tally, replay
from heaved.replay.table import MAX_STEP_S, Table
from heaved.samples import (
    CorrectionState,
    DelayedHeave,
    HeaveForecast,
    HeaveState,
    LaserState,
    MotionFrame,
    Quality,
    RockPrediction,
)
from heaved.simulate.play import write_recording
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import Recording, record

if TYPE_CHECKING:
    from collections.abc import Sequence

# Learns early and trains often, so that a short recording shows all of it.
EAGER = Config(
    heave=heave.Params(lead=lead.Params(window_s=20.0, refresh_s=2.0, min_laser_s=5.0, min_coherence=0.0)),
    correction=correction.Params(min_laser_s=20.0, window_s=30.0, period_s=12.0, epochs=50),
)


@pytest.fixture(scope="module")
def sea() -> Recording:
    return record(seaway("T3", seed=3), 110.0, imu_rate_hz=20.0, laser_rate_hz=10.0, seed=3)


@pytest.fixture(scope="module")
def source(sea: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "in.csv"
    write_recording(path, sea)
    return path


@pytest.fixture(scope="module")
def replayed(source: Path) -> tuple[Path, Summary]:
    out = source.with_name("out.csv")
    return out, replay(source, out, EAGER)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_one_row_for_each_row_with_an_imu_sample(sea: Recording, replayed: tuple[Path, Summary]) -> None:
    rows, summary = rows_of(replayed[0]), replayed[1]
    assert [float(row["t_s"]) for row in rows] == pytest.approx(sea.t_s[np.isfinite(sea.az_mps2)].tolist(), abs=1e-6)
    assert summary.frames == len(rows) == sum(summary.quality.values())
    assert summary.duration_s == pytest.approx(sea.t_s[-1] - sea.t_s[0])
    # The delayed heave of the last minute comes a minute later.
    assert {row["delayed_heave_m"] for row in rows if float(row["t_s"]) > sea.t_s[-1] - 59.0} == {""}


def test_what_comes_out_is_the_heave(sea: Recording, replayed: tuple[Path, Summary]) -> None:
    rows = [row for row in rows_of(replayed[0]) if row["heave_m"] and float(row["t_s"]) > 50.0]
    assert len(rows) > 300
    estimate = np.array([float(row["heave_m"]) for row in rows])
    truth = np.interp([float(row["t_s"]) for row in rows], sea.truth.t_s, sea.truth.heave_m)
    assert np.corrcoef(estimate, truth)[0, 1] > 0.95


def test_trains_and_is_the_same_to_the_byte_every_time(source: Path, replayed: tuple[Path, Summary]) -> None:
    out, summary = replayed
    assert sum(summary.trainings.values()) >= 2
    assert "failed" not in summary.trainings
    again = source.with_name("again.csv")
    assert replay(source, again, EAGER).trainings == summary.trainings
    assert again.read_bytes() == out.read_bytes()


def test_what_comes_later_changes_nothing_before(source: Path, replayed: tuple[Path, Summary]) -> None:
    lines = source.read_text().splitlines(keepends=True)
    cut = int(0.9 * len(lines))
    shorter = source.with_name("shorter.csv")
    shorter.write_text("".join(lines[:cut]))
    out = source.with_name("shorter.out.csv")
    replay(shorter, out, EAGER)
    # But for the delayed heave, which is said of a row a minute after it.
    expected, found = ([{**row, "delayed_heave_m": ""} for row in rows_of(path)] for path in (replayed[0], out))
    assert len(found) > 0.85 * len(expected)
    assert found == expected[: len(found)]


def test_until_counts_from_the_first_row(tmp_path: Path) -> None:
    path = tmp_path / "in.csv"
    path.write_text("t_s,az_mps2\n" + "".join(f"{1.7e9 + 0.05 * k:.2f},9.8\n" for k in range(100)))
    out = tmp_path / "out.csv"
    replay(path, out, Config(), until_s=2.0)
    rows = rows_of(out)
    assert (rows[0]["t_s"], rows[-1]["t_s"]) == ("1700000000.000000", "1700000002.000000")


def test_rows_without_imu_give_no_frame_and_a_laser_may_be_absent(tmp_path: Path) -> None:
    path = tmp_path / "in.csv"
    path.write_text("t_s,az_mps2,laser_m\n0,9.8,\n0.05,,12\n0.1,,\n0.15,9.8,12\n")
    summary = replay(path, tmp_path / "out.csv", Config())
    assert (summary.rows, summary.frames) == (4, 2)
    assert [row["t_s"] for row in rows_of(tmp_path / "out.csv")] == ["0.000000", "0.150000"]


def test_the_columns_hold_what_their_names_say() -> None:
    config = Config(heave=heave.Params(forecast_horizons_s=(0.5, 2.0)), rock=rock.Params(horizons_s=(0.05, 1.0)))
    degree = math.pi / 180.0
    frame = MotionFrame(
        t_s=12.5,
        quality=Quality(heave=HeaveState.DEGRADED, laser=LaserState.OFF, correction=CorrectionState.LEARNING),
        heave_m=1.0,
        heave_std_m=0.1,
        heave_velocity_mps=-0.5,
        observer_m=0.9,
        correction_m=0.1,
        lead_s=-0.25,
        forecast=(HeaveForecast(horizon_s=2.0, heave_m=3.0, std_m=0.3), HeaveForecast(horizon_s=0.5)),
        rock=(
            RockPrediction(horizon_s=1.0, roll_rad=1 * degree, pitch_rad=2 * degree, yaw_rad=3 * degree),
            RockPrediction(horizon_s=0.05, roll_std_rad=4 * degree, pitch_std_rad=5 * degree, yaw_std_rad=6 * degree),
        ),
    )
    written: list[str] = []
    table = Table(config, written.append)
    assert written.pop() == (
        "t_s,heave_m,heave_std_m,heave_velocity_mps,observer_m,correction_m,lead_s,quality,delayed_heave_m,"
        "forecast_0.5s_m,forecast_0.5s_std_m,forecast_2s_m,forecast_2s_std_m,"
        "roll_0.05s_deg,roll_0.05s_std_deg,roll_0.1s_deg,roll_0.1s_std_deg,"
        "roll_0.15s_deg,roll_0.15s_std_deg,roll_1s_deg,roll_1s_std_deg,"
        "pitch_0.05s_deg,pitch_0.05s_std_deg,pitch_0.1s_deg,pitch_0.1s_std_deg,"
        "pitch_0.15s_deg,pitch_0.15s_std_deg,pitch_1s_deg,pitch_1s_std_deg,"
        "yaw_0.05s_deg,yaw_0.05s_std_deg,yaw_0.1s_deg,yaw_0.1s_std_deg,"
        "yaw_0.15s_deg,yaw_0.15s_std_deg,yaw_1s_deg,yaw_1s_std_deg\n"
    )
    table.push(frame)
    table.flush()
    assert "".join(written) == (
        "12.500000,1.000000,0.100000,-0.500000,0.900000,0.100000,-0.250000,degraded,,"
        ",,3.000000,0.300000,"
        ",4.000000,,,,,1.000000,,"
        ",5.000000,,,,,2.000000,,"
        ",6.000000,,,,,3.000000,\n"
    )


# ---- the delayed heave, put in where it belongs ----------------------------------------------------------------------


def delayed(t_s: float, heave_m: float) -> DelayedHeave:
    return DelayedHeave(t_s=t_s, heave_m=heave_m, std_m=0.01)


def merged(arrivals: Sequence[tuple[float, DelayedHeave | None]]) -> tuple[list[str], list[int]]:
    """Cells in the order of writing, and how many rows were out after each frame."""
    written: list[str] = []
    table = Table(Config(), written.append)
    place = written.pop().split(",").index("delayed_heave_m")
    quality = Quality(heave=HeaveState.VALID, laser=LaserState.OFF, correction=CorrectionState.OFF)
    frames = [MotionFrame(t_s=t_s, quality=quality, heave_m=9.0, delayed=newest) for t_s, newest in arrivals]
    out = []
    for frame in frames:
        table.push(frame)
        out.append("".join(written).count("\n"))
    table.flush()
    rows = list(csv.reader("".join(written).splitlines()))
    assert [row[0] for row in rows] == [f"{t_s:.6f}" for t_s, _ in arrivals]
    assert {row[1] for row in rows} == {"9.000000"}
    return [row[place] for row in rows], out


def test_a_delayed_heave_goes_into_the_row_of_its_own_time() -> None:
    """Rows every 0.1 s, delayed heaves 0.3 s old from 0.5 s on: at the very times, so as they are."""
    values = {0.2: 1.0, 0.3: -2.0, 0.4: 3.5}
    arrivals: list[tuple[float, DelayedHeave | None]] = [(round(0.1 * k, 1), None) for k in range(5)]
    arrivals += [(0.5, delayed(0.2, 1.0)), (0.6, delayed(0.3, -2.0)), (0.7, delayed(0.4, 3.5))]
    cells, out = merged(arrivals)
    assert cells == [f"{values[t_s]:.6f}" if t_s in values else "" for t_s, _ in arrivals]
    # As soon as it is known, and in order.
    assert out == [0, 0, 0, 0, 0, 3, 4, 5]


def test_between_two_delayed_heaves_it_is_linear() -> None:
    """Four rows to one of them; the same one is offered with each of its rows."""
    first, second = delayed(0.0, 1.0), delayed(0.4, 2.0)
    cells, _ = merged([(0.0, None), (0.1, first), (0.2, first), (0.3, first), (0.4, first), (0.5, second)])
    assert cells == ["1.000000", "1.250000", "1.500000", "1.750000", "2.000000", ""]


def test_a_hole_in_the_delayed_heaves_stays_blank() -> None:
    """Linear over MAX_STEP_S at most, whose two ends are known all the same."""
    before, after = delayed(0.0, 1.0), delayed(MAX_STEP_S + 0.1, 2.0)
    cells, _ = merged([(0.0, before), (0.3, before), (MAX_STEP_S + 0.1, after), (0.7, after)])
    assert cells == ["1.000000", "", "2.000000", ""]


def test_a_delayed_heave_that_goes_back_changes_nothing() -> None:
    """The sensor's lead has been learned anew, and with it the time that the delayed heave is for."""
    kept = [(0.0, delayed(0.0, 1.0)), (0.1, delayed(0.1, 2.0)), (0.2, delayed(0.05, 9.0)), (0.3, delayed(0.2, 4.0))]
    assert merged(kept)[0] == ["1.000000", "2.000000", "4.000000", ""]


def test_without_any_delayed_heave_all_rows_come_out_with_a_blank() -> None:
    cells, out = merged([(0.1 * k, None) for k in range(50)])
    assert cells == [""] * 50
    assert out == [0] * 50


def test_the_column_is_the_delayed_heave(tmp_path: Path) -> None:
    """Of a whole replay: known from the end of the first minute, over which the filter starts, up to the smoother's lag
    before the end, near the truth there; blank elsewhere.
    """
    sea = record(seaway("T3", seed=3), 150.0, imu_rate_hz=20.0, laser="off", seed=3)
    path, out = tmp_path / "in.csv", tmp_path / "out.csv"
    write_recording(path, sea)
    replay(path, out, Config())
    rows = rows_of(out)
    assert len(rows) == sea.t_s.size
    assert [float(row["t_s"]) for row in rows] == pytest.approx(sea.t_s.tolist(), abs=1e-6)
    known = np.array([bool(row["delayed_heave_m"]) for row in rows])
    assert not known[sea.t_s > 90.1].any()
    assert known[(sea.t_s > 61.0) & (sea.t_s < 89.8)].all()
    delayed_m = np.array([float(row["delayed_heave_m"] or "nan") for row in rows])
    error = (delayed_m - sea.truth.heave_m)[known]
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.std(sea.truth.heave_m)


@pytest.mark.parametrize("times", ["at one moment", "days apart"])
def test_rows_that_wait_for_a_delayed_heave_are_not_kept_for_ever(times: str) -> None:
    """Whatever their times, a bounded number: twice what the longest wait at the highest rate has."""
    written: list[str] = []
    table = Table(Config(heave=heave.Params(sea=heave.SeaParams(delay_s=10.0))), written.append)
    quality = Quality(heave=HeaveState.SETTLING, laser=LaserState.OFF, correction=CorrectionState.OFF)
    step_s = 1e-7 if times == "at one moment" else 86400.0
    most = 2 * 10 * 250
    for k in range(2 * most):
        table.push(MotionFrame(t_s=step_s * k, quality=quality))
        assert k + 1 - (len(written) - 1) <= most
    table.flush()
    assert "".join(written).count("\n") == 1 + 2 * most


# ---- what it says ----------------------------------------------------------------------------------------------------


def summary(reasons: list[tuple[float, tuple[str, ...]]]) -> Summary:
    tally = Tally()
    for t_s, texts in reasons:
        tally.count(
            t_s, Quality(heave=HeaveState.DEGRADED, laser=LaserState.OFF, correction=CorrectionState.OFF, reasons=texts)
        )
    return tally.summary(1.0)


def test_reasons_are_counted_and_dated_the_most_frequent_first() -> None:
    sign, line = "az is about -9.8: wrong sign", "imu: 37 % of the samples missing"
    text = str(summary([(10.0, ()), (11.0, (line,)), (12.0, (line, sign)), (13.0, (sign,)), (14.0, (sign,))]))
    assert text.split("reasons:\n")[1].split("\n") == [
        f"   60.0 % of the frames, first at t_s 12.00: {sign}",
        f"   40.0 % of the frames, first at t_s 11.00: {line}",
    ]


def test_reasons_that_differ_in_numbers_alone_are_one() -> None:
    told = summary([(float(k), (f"settling: {k} s of 40 s", f"{-0.5 * k} m off")) for k in range(40)])
    assert [(reason.text, reason.varies, reason.frames, reason.first_s) for reason in told.reasons] == [
        ("settling: 0 s of 40 s", True, 40, 0.0), ("-0.0 m off", True, 40, 0.0),
    ]  # fmt: skip
    assert "settling: 0 s of 40 s (later with other numbers)" in str(told)


def test_few_reasons_are_printed_and_the_others_counted() -> None:
    told = summary([(0.0, tuple(f"reason {chr(65 + i)}\x1b" for i in range(20)))])
    assert str(told).count("reason ") == 12
    assert str(told).endswith("and 8 more")
    assert "\x1b" not in str(told)


def test_a_whole_replay_gives_its_reasons(tmp_path: Path) -> None:
    """An upright accelerometer alone: there is nothing to remove a tilt with, from the first frame to the last."""
    sea = record(seaway("T3", seed=3), 60.0, imu_rate_hz=20.0, laser="off", seed=3)
    path = tmp_path / "in.csv"
    rows = zip(sea.t_s.tolist(), sea.az_mps2.tolist(), strict=True)
    path.write_text("t_s,az_mps2\n" + "".join(f"{t!r},{az:.5f}\n" for t, az in rows))
    told = replay(path, tmp_path / "out.csv", Config())
    tilt = next(reason for reason in told.reasons if "tilt not removed" in reason.text)
    settling = next(reason for reason in told.reasons if "settling" in reason.text)
    assert settling.first_s == sea.t_s[0]
    assert settling.frames == told.quality[HeaveState.SETTLING]
    assert 0 < tilt.frames <= told.frames
    assert "tilt not removed" in str(told)


def test_a_fit_that_dies_costs_no_row(sea: Recording, source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def die(past: object) -> None:
        raise ZeroDivisionError("float division by zero")

    monkeypatch.setattr("heaved.replay.replay.look", die)
    told = replay(source, source.with_name("dies.csv"), Config(), until_s=70.0)
    assert told.fits == {"failed": told.fits["failed"]}
    assert told.frames == np.isfinite(sea.az_mps2[sea.t_s <= sea.t_s[0] + 70.0]).sum()
    assert "failed (the last one died of ZeroDivisionError" in str(told)


NASTY = (
    "", "0", "-0.0", "9.8", "-9.8", "1", "1000", "-1000", "1e3", "5e-324", "1e-300", "9999.999", "1e308", "-1e308",
    "1e999", "nan", "inf", "x", "1,5", '"', "\0", "\x1b[31m", "\u0663", "9.8 ", "0x10", "1_0", "\ufeff", "\r", "\n",
)  # fmt: skip


@settings(max_examples=80)
@given(
    width=st.integers(0, 8),
    rows=st.lists(st.lists(st.sampled_from(NASTY) | st.just("9.7"), min_size=9, max_size=9), max_size=40),
    sound=st.booleans(),
)
def test_whatever_is_in_the_cells_a_replay_gives_numbers_or_says_where(
    tmp_path_factory: pytest.TempPathFactory, width: int, rows: list[list[str]], sound: bool
) -> None:
    """``sound``: only cells that a recording may have, so that estimators see the extremes of it."""
    folder = tmp_path_factory.mktemp("fuzz")
    path, out = folder / "in.csv", folder / "out.csv"
    columns = COLUMNS[3:4] + COLUMNS[1:3] + COLUMNS[4 : 4 + width]
    lines = [",".join(("t_s", *columns))]
    for k, row in enumerate(rows):
        cells = [cell if not sound or cell in NASTY[:11] else "9.7" for cell in row[: len(columns)]]
        lines.append(",".join((f"{0.05 * k:.2f}", *cells, *("",) * (len(columns) - len(cells)))))
    path.write_text("\n".join(lines))
    if not sound:
        with contextlib.suppress(RecordingError):
            replay(path, out, Config())
        return
    if not rows:
        rows.append([])
        lines.append(",".join(("0", *("",) * len(columns))))
    path.write_text("\n".join(lines))
    replay(path, out, Config())
    for result in rows_of(out):
        assert all(math.isfinite(float(cell)) for name, cell in result.items() if name != "quality" and cell)


# ---- the file that is written ----------------------------------------------------------------------------------------


def test_a_malformed_recording_leaves_what_was_there(tmp_path: Path) -> None:
    path, out = tmp_path / "in.csv", tmp_path / "out.csv"
    path.write_text("t_s,az_mps2\n0,9.8\n1,x\n")
    out.write_text("of last time")
    with pytest.raises(RecordingError, match=r"in\.csv, line 3, column az_mps2: 'x' is not a number"):
        replay(path, out, Config())
    assert out.read_text() == "of last time"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["in.csv", "out.csv"]


def test_the_recording_itself_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "in.csv"
    path.write_text("t_s,az_mps2\n0,9.8\n")
    (tmp_path / "link.csv").symlink_to(path)
    for out in (path, tmp_path / "link.csv"):
        with pytest.raises(OutputError, match="is the recording itself"):
            replay(path, out, Config())
    assert path.read_text() == "t_s,az_mps2\n0,9.8\n"


def test_where_nothing_can_be_written(tmp_path: Path) -> None:
    path = tmp_path / "in.csv"
    path.write_text("t_s,az_mps2\n0,9.8\n")
    with pytest.raises(OutputError, match="cannot be written: No such file or directory; name another file with -o"):
        replay(path, tmp_path / "absent" / "out.csv", Config())
    with pytest.raises(OutputError, match="cannot be written"):
        replay(path, tmp_path, Config())


def test_a_device_is_written_to_never_replaced(tmp_path: Path) -> None:
    path = tmp_path / "in.csv"
    path.write_text("t_s,az_mps2\n0,9.8\n")
    replay(path, Path("/dev/null"), Config())
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)


def test_progress_ends_at_the_size_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "in.csv"
    path.write_text("t_s,az_mps2\n" + "".join(f"{k / 20},9.8\n" for k in range(1000)))
    seen: list[tuple[int, int]] = []
    replay(path, tmp_path / "out.csv", Config(), progress=lambda done, total: seen.append((done, total)))
    assert seen
    assert seen[-1] == (path.stat().st_size, path.stat().st_size)
