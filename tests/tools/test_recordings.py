"""The tool that makes recordings: against analytic motions written as if measured, and against the real files."""

from pathlib import Path

import numpy as np
import pytest
import recordings

from heaved.samples import GRAVITY_MPS2
from heaved.simulate.seaway import seaway

DATA = Path(__file__).parents[3] / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the real recordings are not on this machine")


def inside(t: np.ndarray, fade_s: float = recordings.FADE_S) -> np.ndarray:
    return np.asarray((t > fade_s + 5.0) & (t < t[-1] - fade_s - 5.0))


def test_a_buoy_on_a_sine_becomes_an_imu_on_that_sine(tmp_path: Path) -> None:
    t = np.arange(1024) / recordings.BUOY_RATE_HZ
    w = 2 * np.pi * 0.11

    def heave_m(at: np.ndarray) -> np.ndarray:
        return 1.2 * np.sin(w * at) + 0.4 * np.cos(2.3 * w * at)

    rows = np.column_stack([np.zeros(t.size), 100 * heave_m(t), 50 * np.cos(w * t), -30 * np.cos(w * t)])
    rows[500, :2] = 2.0, 999.0  # a reading that the buoy itself calls bad
    np.savetxt(tmp_path / "b.raw", rows, fmt=["%2d", "%5.1f", "%5.1f", "%5.1f"], delimiter=",")
    recording = recordings.hebrides(tmp_path / "b.raw", rate_hz=20.0, sensor="ideal")
    # Where the bad reading was bridged by a straight line the curve is only nearly met.
    bad_s = 500 / recordings.BUOY_RATE_HZ
    bridged = np.abs(recording.t_s - bad_s) < 15.0
    np.testing.assert_allclose(recording.truth.heave_m[bridged], heave_m(recording.t_s[bridged]), atol=0.15)
    part = inside(recording.t_s) & ~bridged
    at = recording.t_s[part]
    assert recording.t_s[1] == pytest.approx(0.05)
    np.testing.assert_allclose(recording.truth.heave_m[part], heave_m(at), atol=0.03)
    up = -1.2 * w**2 * np.sin(w * at) - 0.4 * (2.3 * w) ** 2 * np.cos(2.3 * w * at)
    np.testing.assert_allclose(recording.az_mps2[part] - GRAVITY_MPS2, up, atol=0.05)
    np.testing.assert_allclose(recording.ax_mps2[part], -0.5 * w**2 * np.cos(w * at), atol=0.03)
    np.testing.assert_allclose(recording.ay_mps2[part], 0.3 * w**2 * np.cos(w * at), atol=0.03)
    assert abs(recording.truth.heave_m[0]) < 0.02  # faded in from rest


def test_a_ship_keeps_its_list_and_its_course(tmp_path: Path) -> None:
    t = np.arange(600.0)
    w = 2 * np.pi * 0.1
    heading = (350.0 + 0.05 * t) % 360.0  # turns slowly through north
    columns = [t + 40.16, 3.0 + np.sin(w * t), -2.0 * np.ones_like(t), heading, -0.5 * np.cos(w * t), np.zeros_like(t)]
    np.savetxt(tmp_path / "s.csv", np.column_stack(columns), fmt="%.4f", delimiter=",", header="h", comments="")
    recording = recordings.palmer(tmp_path / "s.csv", rate_hz=10.0, sensor="ideal")
    part = inside(recording.t_s)
    at = recording.t_s[part]
    np.testing.assert_allclose(np.degrees(recording.roll_rad[part]), 3.0 + np.sin(w * at), atol=0.03)
    np.testing.assert_allclose(np.degrees(recording.pitch_rad[part]), -2.0, atol=1e-6)
    np.testing.assert_allclose(np.degrees(recording.yaw_rad[part]), 350.0 + 0.05 * at, atol=0.01)
    np.testing.assert_allclose(recording.truth.heave_m[part], 0.5 * np.cos(w * at), atol=0.02)
    rate = np.radians(1.0) * w * np.cos(w * at)
    np.testing.assert_allclose(recording.truth.roll_rate_radps[part], rate, atol=1e-3)


def test_flume_truth_is_in_phase_and_scales_as_froude_says(tmp_path: Path) -> None:
    t = np.arange(8000) / recordings.FLUME_RATE_HZ
    w = 2 * np.pi * 0.8
    vertical = -0.01 * w**2 * np.sin(w * t) - 0.03  # 10 mm of heave, and a bias
    rows = np.zeros((t.size, 8))
    rows[:, 0], rows[:, 4], rows[:, 5] = t, vertical + 0.1, vertical - 0.1
    np.savetxt(tmp_path / "f.csv", rows, fmt="%.6f", delimiter=",", header="h", comments="")
    recording = recordings.flume(tmp_path / "f.csv", froude=64.0)
    assert recording.t_s[1] == pytest.approx(8 / 200)
    part = inside(recording.t_s, 8 * recordings.FLUME_FADE_S)
    np.testing.assert_allclose(recording.truth.heave_m[part], 0.64 * np.sin(w / 8 * recording.t_s[part]), atol=0.02)
    np.testing.assert_allclose(recording.az_mps2, vertical + GRAVITY_MPS2, atol=1e-6)
    assert np.isnan(recording.roll_rad).all()
    assert np.isnan(recording.laser_m).all()


def test_command_line_writes_readings_and_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "x.csv"
    assert recordings.main(["sea", "S4", "--duration", "30", "--laser", "10+10", "--seed", "3", "--out", str(out)]) == 0
    readings = np.genfromtxt(out, delimiter=",", names=True)
    truth = np.genfromtxt(tmp_path / "x.truth.csv", delimiter=",", names=True)
    assert readings.size == truth.size == 600
    np.testing.assert_allclose(truth["heave_m"], seaway("S4", 3).motion(truth["t_s"]).heave_m, atol=1e-6)
    assert np.isnan(readings["laser_m"]).sum() == 200
    assert "600 rows" in capsys.readouterr().out


def test_command_line_explains_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "x.csv")
    (tmp_path / "b.raw").write_text("0, 1, 2\n0, 1, 2\n")
    for arguments, message in (
        (["sea", "S4", "--sensor", "Z", "--out", out], "unknown sensor 'Z'"),
        (["sea", "S4", "--shake", "quake", "--out", out], "unknown shake 'quake'"),
        (["hebrides", str(tmp_path / "b.raw"), "--out", out], "3 columns instead of 4"),
        (["palmer", str(tmp_path / "none.csv"), "--out", out], "none.csv"),
    ):
        assert recordings.main(arguments) == 1
        assert message in capsys.readouterr().err
    assert not Path(out).exists()


@needs_data
def test_real_buoy_has_its_published_height() -> None:
    for path in sorted((DATA / "hebrides_waverider").glob("*.raw"))[::3]:
        recording = recordings.hebrides(path, sensor="A", laser="50%")
        assert 2.8 < 4.0 * recording.truth.heave_m[inside(recording.t_s)].std() < 3.8
        assert np.std(recording.az_mps2 - GRAVITY_MPS2 - recording.truth.heave_acceleration_mps2) < 0.02


@needs_data
def test_real_ship_and_flume_and_still_sensor() -> None:
    ship = recordings.palmer(next((DATA / "palmer").glob("*.csv")))
    part = inside(ship.t_s)
    assert ship.truth.heave_m[part].std() == pytest.approx(1.12, abs=0.1)
    assert np.degrees(ship.truth.pitch_rad[part].std()) == pytest.approx(1.86, abs=0.2)
    run = DATA / "ntnu_flume" / "3061_2.csv"
    hull = recordings.flume(run)
    optical = np.loadtxt(run, delimiter=",", skiprows=1, usecols=1)
    middle = inside(hull.t_s, 10.0)
    # The optical reference is good for amplitude alone: the acceleration makes 1.04 to 1.17 of it.
    assert 1.0 < hull.truth.heave_m[middle].std() / optical[middle].std() < 1.2
    still = recordings.microswift(next((DATA / "microswift").glob("*.dat")))
    assert still.t_s[-1] == 878.0
    assert np.mean(still.az_mps2) == pytest.approx(10.12, abs=0.02)
    assert not still.truth.heave_m.any()
