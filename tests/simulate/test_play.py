"""Recordings as files and as sources."""

import math
from pathlib import Path

import numpy as np
import pytest

from heaved.devices.profile import Block, DeviceSpec, Field, Profile
from heaved.samples import CraneSample, Fault, ImuSample, LaserSample
from heaved.simulate.play import Player, read_recording, write_recording, write_truth
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import record

PROFILE = Profile(name="p", blocks=(Block(start=0, fields=(Field(quantity="az_mps2", offset=0, unit="m/s2"),)),))
IMU = DeviceSpec(name="imu", role="imu", link="tcp://h:1", profile=PROFILE, rate_hz=20.0)
LASER = DeviceSpec(name="laser", role="laser", link="tcp://h:1", profile=PROFILE, rate_hz=20.0)
HAND_MADE = """t_s,az_mps2,roll_deg,yaw_deg,laser_m,remark
5.0,9.8,1.0,359,12.0,a
5.1,9.9,,1,,b
5.2,10.0,2.0,3,12.2,c
6.0,10.1,2.0,5,12.4,d
"""


def hand_made(tmp_path: Path) -> Path:
    path = tmp_path / "hand.csv"
    path.write_text(HAND_MADE)
    return path


def test_written_recordings_read_back_to_the_digits_written(tmp_path: Path) -> None:
    recording = record(seaway("S5", seed=2), 90.0, sensor="A", laser="50%")
    write_recording(tmp_path / "x.csv", recording)
    assert (tmp_path / "x.csv").read_text().splitlines()[0] == (
        "t_s,ax_mps2,ay_mps2,az_mps2,roll_deg,pitch_deg,yaw_deg,gx_radps,gy_radps,gz_radps,laser_m"
    )
    columns = read_recording(tmp_path / "x.csv")
    for quantity, precision in (("t_s", 1e-6), ("az_mps2", 1e-6), ("roll_rad", 1e-7), ("laser_m", 1e-4)):
        np.testing.assert_allclose(columns[quantity], getattr(recording, quantity), atol=precision)
    write_truth(tmp_path / "x.truth.csv", recording)
    truth = np.genfromtxt(tmp_path / "x.truth.csv", delimiter=",", names=True)
    np.testing.assert_allclose(truth["heave_m"], recording.truth.heave_m, atol=1e-6)
    np.testing.assert_allclose(np.radians(truth["pitch_deg"]), recording.truth.pitch_rad, atol=1e-7)


def test_player_interpolates_and_knows_what_is_missing(tmp_path: Path) -> None:
    player = Player(read_recording(hand_made(tmp_path)))
    assert player.duration_s == pytest.approx(1.0)
    sample = player.read(IMU, 0.05)
    assert isinstance(sample, ImuSample)
    assert sample.t_s == 0.05
    assert sample.az_mps2 == pytest.approx(9.85)
    assert math.degrees(sample.roll_rad) == pytest.approx(1.25)  # across one blank
    assert math.degrees(sample.yaw_rad) == pytest.approx(0.0, abs=1e-9)  # across north
    assert math.isnan(sample.ax_mps2)
    assert math.isnan(sample.pitch_rad)
    laser = player.read(LASER, 0.1)
    assert isinstance(laser, LaserSample)
    assert laser.laser_m == pytest.approx(12.1)
    assert player.read(LASER, 0.0).fault is Fault.NONE
    for t in (-0.1, 0.6, 1.1):  # before, in a gap of 0.8 s, after
        missing = player.read(LASER, t)
        assert isinstance(missing, LaserSample)
        assert math.isnan(missing.laser_m)
        assert missing.fault is Fault.EXCEPTION


def test_player_starts_over_when_told_to(tmp_path: Path) -> None:
    player = Player(read_recording(hand_made(tmp_path)), loop=True)
    sample = player.read(IMU, 7.05)
    assert isinstance(sample, ImuSample)
    assert sample.az_mps2 == pytest.approx(9.85)
    assert sample.t_s == 7.05


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "needs a header row"),
        ("t_s,az_mps2\n", "rows below"),
        ("az_mps2\n9.8\n", "column t_s"),
        ("t_s,az_mps2\n0,9.8\n1,x\n", r"line 3, column az_mps2: 'x'"),
        ("t_s,az_mps2\n0,9.8\n0,9.8\n", "increase"),
        ("t_s,az_mps2\n0,9.8\n,9.8\n", "present in every row"),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_recording(path)


def test_a_cranes_record_is_played_with_its_slew_across_north(tmp_path: Path) -> None:
    path = tmp_path / "crane.csv"
    path.write_text("t_s,az_mps2,slew_deg,boom_deg,line_out_m\n0,9.8,359,60,10\n0.1,9.8,1,61,12\n0.2,9.8,3,62,14\n")
    crane = DeviceSpec(name="crane", role="crane", link="tcp://h:1", profile=PROFILE, rate_hz=10.0)
    sample = Player(read_recording(path)).read(crane, 0.05)
    assert isinstance(sample, CraneSample)
    assert math.remainder(sample.slew_rad, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert math.degrees(sample.boom_rad) == pytest.approx(60.5)
    assert sample.line_out_m == pytest.approx(11.0)
    assert math.isnan(sample.jib_rad)
