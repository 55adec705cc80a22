"""The stages at the edges: configuration, devices, recordings, replay, the stream, status, metrics."""

from __future__ import annotations

import csv
import json
import math
import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pytest
from accuracy import main as accuracy

from heaved.cli import main
from heaved.client import report
from heaved.config import Config
from heaved.config.read import ConfigError, data_directory, load, load_to_run, parse
from heaved.config.rules import cautions, rate_faults, stage_faults
from heaved.daemon.metrics import Metrics
from heaved.devices.liveness import Contact
from heaved.devices.profile import Quantity, encode, profile_faults
from heaved.devices.recording import STAGE_COLUMNS, Recording, RecordingError
from heaved.devices.station import Reading, Station
from heaved.estimation.craft import fusion
from heaved.estimation.hull import estimate as hull
from heaved.estimation.hull.estimator import HullDeformation
from heaved.estimation.hull.refit import refit
from heaved.links import TcpLink
from heaved.outputs import wire
from heaved.outputs.records import AttitudeStatus, HeaveStatus, HullStatus, StatusRecord
from heaved.replay.replay import replay
from heaved.replay.table import Table
from heaved.samples import (
    CorrectionState,
    CraftMotion,
    CraftSample,
    CraneSample,
    Fault,
    HeaveState,
    HullAngles,
    LaserState,
    MotionFrame,
    Quality,
    RatesSample,
)
from heaved.simulate.flexure import SCENES, simulate
from heaved.workers import refit_hull as hull_fitter

if TYPE_CHECKING:
    from collections.abc import Iterable

RATES = """fields = [
  { quantity = "gx_radps", offset = 0, type = "float32", unit = "rad/s" },
  { quantity = "gy_radps", offset = 2, type = "float32", unit = "deg/s" },
  { quantity = "gz_radps", offset = 4, type = "float32", unit = "rad/s" },
  { quantity = "az_mps2", offset = 6, type = "float32", unit = "m/s2" },
]"""


ENCODERS = """fields = [
  { quantity = "slew_rad", offset = 0, unit = "deg", scale = 0.1 },
  { quantity = "boom_rad", offset = 1, unit = "deg", scale = 0.1 },
]"""
ON_BOOM = '[crane]\nboom_length_m = 40\n[[point]]\nname = "tip"\nframe = "boom"\n'
ON_HOOK = ON_BOOM.replace('"boom"', '"hook"')


def device(role: str, fields: str) -> str:
    return f"""
[[device]]
name = "{role}"
role = "{role}"
link = "tcp://{role.replace("_", "-")}:502"
rate_hz = 100
[device.profile]
name = "inline"
[[device.profile.blocks]]
start = 0
{fields}
"""


def one(quantity: str, unit: str) -> str:
    return f'fields = [{{ quantity = "{quantity}", offset = 0, type = "float32", unit = "{unit}" }}]'


def read(text: str) -> Config:
    return parse(tomllib.loads(text), file="x.toml", directory=Path("/nonexistent"))


def faults_of(text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        read(text)
    return caught.value.faults


# ---- configuration ---------------------------------------------------------------------------------------------------


def test_both_are_off_by_default() -> None:
    assert not Config().hull.enabled
    assert not Config().attitude.enabled
    assert stage_faults(Config()) == []


LACKS: dict[str, tuple[str, str]] = {
    "no second IMU": ("[hull]\nenabled = true\n" + device("imu", RATES), 'a device of role "imu2"'),
    "no first IMU": ("[hull]\nenabled = true\n" + device("imu2", RATES), 'body rates of a device of role "imu"'),
    "a first IMU without rates": (
        "[hull]\nenabled = true\n" + device("imu", one("az_mps2", "m/s2")) + device("imu2", RATES),
        "has no gx_radps, gy_radps, gz_radps",
    ),
    "no craft": ("[attitude]\nenabled = true\n" + device("imu", RATES), "attitude.source"),
    "a craft of nothing but speed": (
        "[attitude]\nenabled = true\n" + device("craft", one("speed_mps", "kn")),
        "attitude.source",
    ),
    "no crane": (ON_BOOM, "point[0].frame: 'boom' needs the readings of a device of role \"crane\""),
    "a crane of nothing but a slew": (
        ON_BOOM + device("crane", one("slew_rad", "deg")),
        "has no boom_rad; if that joint is fixed, set crane.boom_fixed_deg",
    ),
    "a jib that nobody reads": (
        ON_BOOM.replace("= 40", "= 40\njib_length_m = 9") + device("crane", ENCODERS),
        "has no jib_rad; if that joint is fixed, set crane.jib_fixed_deg",
    ),
    "a hook without its line": (ON_HOOK + device("crane", ENCODERS), "has no line_out_m"),
    "own without an IMU": ('[attitude]\nenabled = true\nsource = "own"', "attitude.source"),
}


@pytest.mark.parametrize("name", LACKS)
def test_a_stage_without_its_devices_is_a_fault_of_the_run_but_not_of_the_file(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, expected = LACKS[name]
    path = tmp_path / "x.toml"
    path.write_text(text)
    load(path)  # A replay needs no device.
    with pytest.raises(ConfigError) as caught:
        load_to_run(path)
    (fault,) = caught.value.faults
    assert expected in fault
    for command in (["check-config", str(path)], ["run", "--config", str(path)], ["demo", "--config", str(path)]):
        assert main(command) == 78
        assert expected in capsys.readouterr().err


def faults_to_run(text: str, path: Path, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """What ``check-config`` prints, without the name of the file."""
    path.write_text(text)
    assert main(["check-config", str(path)]) == 78
    lines = capsys.readouterr().err.splitlines()
    assert all(line.startswith(f"{path}: ") for line in lines)
    return [line.removeprefix(f"{path}: ") for line in lines]


def test_what_stages_and_devices_lack_is_named_beside_every_other_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    serial = device("imu", one("az_mps2", "m/s2")).replace("tcp://imu:502", "rtu:///dev/ttyS0?baudrate=1200")
    text = (
        '[hull]\nenabled = true\nmethod = "ekf"\n[attitude]\nenabled = true\nmode = "best"\n'
        "[stream]\nport = 70000\n[haeve]\n" + serial
    )
    found = faults_to_run(text, tmp_path / "x.toml", capsys)
    assert sorted(fault.split(":")[0] for fault in found) == [
        "attitude.mode", "attitude.source", "haeve", "hull.enabled", "hull.enabled", "hull.method",
        "line /dev/ttyS0 (1200 8N1)", "stream.port",
    ]  # fmt: skip
    assert any('a device of role "imu2"' in fault for fault in found)
    assert any("has no gx_radps, gy_radps, gz_radps" in fault for fault in found)


WRONG_ONLY: dict[str, tuple[str, list[str]]] = {
    "a second IMU with a wrong rate": (device("imu2", RATES).replace("rate_hz = 100", "rate_hz = -1"), ["rate_hz"]),
    "a second IMU with a profile that is not there": (
        device("imu2", RATES).split("[device.profile]")[0] + 'profile = "acme"\n', ["profile"],
    ),
    "a second IMU with a wrong unit": (device("imu2", RATES.replace('"rad/s"', '"furlongs"')), ["profile"]),
    "a role that may be the one": (device("imu2", RATES).replace('role = "imu2"', 'role = "imu 2"'), ["role"]),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG_ONLY)
def test_a_device_that_is_there_and_wrong_is_not_said_to_be_absent(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong, keys = WRONG_ONLY[name]
    found = faults_to_run("[hull]\nenabled = true\n" + device("imu", RATES) + wrong, tmp_path / "x.toml", capsys)
    assert {re.split(r"[.:\[]", fault.removeprefix("device[1]."))[0] for fault in found} == set(keys)


def test_a_source_that_is_not_one_is_named_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (fault,) = faults_to_run('[attitude]\nenabled = true\nsource = "both"', tmp_path / "x.toml", capsys)
    assert fault.startswith("attitude.source: must be ")


def test_devices_as_one_table_hide_no_other_fault(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = '[hull]\nenabled = true\n[device]\nrole = "imu"\n[stream]\nport = -1\n'
    found = faults_to_run(text, tmp_path / "x.toml", capsys)
    assert [fault.split(":")[0] for fault in found] == ["device", "stream.port"]


def test_each_point_counts_as_it_is_written() -> None:
    """One that is wrong hides neither that another needs the hull's stage nor that it is the one for quiet windows."""
    text = '[quiet]\npoint = "tip"\n[[point]]\nname = "tip"\nup = 3\n[[point]]\nname = "hook"\nframe = "crane"\n'
    assert [fault.split(":")[0] for fault in faults_of(text)] == ["point[0].up", "point[1].frame"]


def test_with_their_devices_there_is_no_fault() -> None:
    both = read("[hull]\nenabled = true\n[attitude]\nenabled = true\n" + device("imu", RATES) + device("imu2", RATES)
                + device("heave_sensor", one("heave_m", "cm")))  # fmt: skip
    assert stage_faults(both) == []
    own = read('[attitude]\nenabled = true\nsource = "own"\n' + device("imu", RATES))
    assert stage_faults(own) == []
    assert stage_faults(read(ON_BOOM + device("crane", ENCODERS))) == []
    pinned = ON_BOOM.replace("= 40", "= 40\njib_length_m = 9\njib_fixed_deg = 0")
    assert stage_faults(read(pinned + device("crane", ENCODERS))) == []


def test_a_crane_that_is_read_for_nothing_is_worth_a_caution() -> None:
    (told,) = cautions(read(device("crane", ENCODERS)))
    assert told.startswith("device[0].role: its readings go nowhere")
    assert cautions(read(ON_BOOM + device("crane", ENCODERS))) == []


FAULTS: dict[str, tuple[str, str]] = {
    "a second IMU without a rate": (
        device("imu2", one("gx_radps", "rad/s")),
        "has no gy_radps and no gz_radps, which role 'imu2' needs",
    ),
    "a heave sensor that measures pitch": (device("heave_sensor", one("pitch_rad", "deg")), "has no heave_m"),
    "a craft that measures its temperature": (device("craft", one("temperature_c", "degC")), "of no use in role"),
    "speed in metres": (device("craft", one("speed_mps", "m")), "measures length, not speed"),
    "so3 from zero": ('[hull]\nstart = "zero"', "hull.start: "),
    "no such method": ('[hull]\nmethod = "ekf"', "hull.method: must be 'so3', 'ckf' or 'ukf'"),
    "a point on a crane that is not known": ('[[point]]\nname = "tip"\nframe = "crane"', "point[0].frame: "),
    "a point on a moving crane that is not described": (
        '[[point]]\nname = "tip"\nframe = "boom"',
        "point[0].frame: 'boom' needs [crane]: its boom_length_m is not given",
    ),
    "a hook that is pushed aside": (ON_HOOK + "port_m = 2", "point[0].port_m: the hook hangs plumb"),
    "a crane on a base that is not known": (
        '[crane]\nframe = "crane"\nboom_length_m = 9',
        'crane.frame: "crane" needs [hull] enabled',
    ),
    "a crane of no falls": ("[crane]\nfalls = 0", "crane.falls: Expected `int` >= 1 (got 0)"),
    "a crane that is measured in millimetres": ("[crane]\nboom_length_m = 40000", "crane.boom_length_m: Expected"),
    "a crane of no use": (device("crane", one("signal", "1")), "of no use in role 'crane'"),
    "a line in degrees": (device("crane", one("line_out_m", "deg")), "measures angle, not length"),
    "two angles of three": ("[hull]\nmount_deg = [1.0, 2.0]", "hull.mount_deg: "),
    "a wave that does not oscillate": (
        "[attitude.wave]\nheave_peak_radps = 1.0\nheave_decay_radps = 2.0",
        "attitude.wave: a wave must oscillate",
    ),
    "six seas": (
        f"[attitude]\nseas = [{', '.join(['{ heave_rms_mps2 = 1, pitch_rms_radps2 = 1 }'] * 6)}]",
        "attitude.seas: Expected `array` of length <= 5",
    ),
    "a foil without its arm": ("[attitude.vessel.fore_foil]\narea_m2 = 1", "attitude.vessel.fore_foil.arm_m: missing"),
    "no mass": ("[attitude.vessel]\nmass_kg = 0.0", "attitude.vessel.mass_kg: "),
}


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_named_with_its_path(name: str) -> None:
    text, expected = FAULTS[name]
    (fault,) = faults_of(text)
    assert expected in fault


@pytest.mark.parametrize(
    ("name", "roles"),
    [
        ("hull.toml", ["imu", "laser", "imu2"]),
        ("hydrofoil.toml", ["craft"]),
        ("demo.toml", ["imu", "laser", "crane"]),
    ],
)
def test_packaged_files_are_sound(name: str, roles: list[str]) -> None:
    config = load_to_run(data_directory() / name)
    assert [spec.role for spec in config.device] == roles
    assert rate_faults(config) == []
    assert all(profile_faults(spec.profile) == [] for spec in config.device)


# ---- devices ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "values", "expected"),
    [
        (
            device("imu2", RATES),
            {"gx_radps": 0.25, "gy_radps": math.radians(90.0), "gz_radps": -0.5, "az_mps2": 9.75},
            {"gx_radps": 0.25, "gy_radps": math.pi / 2, "gz_radps": -0.5},
        ),
        (device("craft", one("speed_mps", "kn")), {"speed_mps": 10.0 * 1852.0 / 3600.0}, {"speed_mps": 5.144444}),
        (device("heave_sensor", one("heave_m", "cm")), {"heave_m": 0.5}, {"heave_m": 0.5}),
        (device("pitch_sensor", one("pitch_rad", "deg")), {"pitch_rad": -0.1}, {"pitch_rad": -0.1}),
        (device("crane", one("boom_rad", "deg")), {"boom_rad": math.pi / 4}, {"boom_rad": math.pi / 4}),
        (device("crane", one("line_out_m", "cm")), {"line_out_m": 12.5}, {"line_out_m": 12.5}),
    ],
)
def test_a_role_makes_samples_of_its_own_kind(
    text: str, values: dict[Quantity, float], expected: dict[str, float]
) -> None:
    (spec,) = read(text).device
    contact = Contact(numbered=True, lengths=(), alone=True, timeout_s=0.05, opened_s=0.0)
    station = Station(spec, TcpLink("h", 1), contact, 0.0)
    decoded = station.codecs[0].decode(encode(spec.profile.blocks[0], values))
    result = station.result(Reading(5.0, decoded.values), 5.0, 5.0, 5.001, 1)
    sample = result.sample
    assert isinstance(sample, {"imu2": RatesSample, "crane": CraneSample}.get(spec.role, CraftSample))
    assert sample.t_s == 5.0
    found = {name: value for name, value in msgspec.structs.asdict(sample).items() if name in expected}
    assert found == pytest.approx(expected, rel=1e-6)
    others = {name for name, value in msgspec.structs.asdict(sample).items() if isinstance(value, float)}
    assert all(math.isnan(getattr(sample, name)) for name in others - expected.keys() - {"t_s"})
    failed = station.result(Reading(6.0, fault=Fault.CRC), 6.0, 6.0, 6.1, 1).sample
    assert type(failed) is type(sample)
    assert failed.fault is Fault.CRC


# ---- recordings ------------------------------------------------------------------------------------------------------


def instants(tmp_path: Path, text: str) -> list[Any]:
    path = tmp_path / "x.csv"
    path.write_text(text)
    with Recording(path) as recording:
        return list(recording.instants())


def test_the_columns_of_the_stages_become_their_samples(tmp_path: Path) -> None:
    header = ",".join(("t_s", "az_mps2", "gx_radps", *STAGE_COLUMNS))
    cells = "1,9.8,7,1,2,3,4,5,6,0.5,90,18,-45,30,350,60,,12.5"
    (row, bare) = instants(tmp_path, f"{header}\n{cells}\n2,9.8,7,,,,4,,6,,,,,,,,,\n")
    imu, laser, rates, craft, crane = row
    assert (imu.gx_radps, imu.gy_radps, imu.gz_radps) == (1.0, 2.0, 3.0)
    assert laser is None
    assert rates == RatesSample(t_s=1.0, gx_radps=4.0, gy_radps=5.0, gz_radps=6.0)
    assert (craft.t_s, craft.heave_m, craft.pitch_rad, craft.speed_mps) == (1.0, 0.5, math.pi / 2, 18.0)
    assert (craft.flap_fore_rad, craft.flap_aft_rad) == pytest.approx((-math.pi / 4, math.pi / 6))
    assert (crane.t_s, crane.slew_rad, crane.boom_rad) == (1.0, math.radians(350.0), math.radians(60.0))
    assert math.isnan(crane.jib_rad)
    assert crane.line_out_m == 12.5
    assert bare[1:] == (None, None, None, None)
    assert math.isnan(bare[0].gx_radps)


def test_without_midships_columns_the_rates_of_the_imu_are_those(tmp_path: Path) -> None:
    ((imu, _, rates, *_),) = instants(tmp_path, "t_s,az_mps2,gx_radps,gx2_radps,gy2_radps,gz2_radps\n1,9.8,7,4,5,6\n")
    assert imu.gx_radps == 7.0
    assert rates.gz_radps == 6.0


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("t_s,az_mps2,gx2_radps\n1,9.8,x\n", ", line 2, column gx2_radps: 'x' is not a number"),
        ("t_s,az_mps2,flap_aft_deg\n1,9.8,1\n2,9.8,inf\n", ", line 3, column flap_aft_deg: 'inf' is not finite"),
        ("t_s,az_mps2,gy1_radps,gy1_radps\n1,9.8,1,1\n", ", line 1, column gy1_radps: is named twice"),
        ("t_s,az_mps2,gx3_radps\n1,9.8,1\n", ", line 1, column gx3_radps: unknown column"),
        ("t_s,gx1_radps\n1,1\n", ", line 1: column az_mps2 is missing"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(tmp_path: Path, text: str, where: str) -> None:
    with pytest.raises(RecordingError) as caught:
        instants(tmp_path, text)
    assert where in str(caught.value)


# ---- replay ----------------------------------------------------------------------------------------------------------


def write(path: Path, columns: dict[str, Iterable[float]]) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_replay_gives_the_deformation_of_a_scene(tmp_path: Path) -> None:
    record = simulate(SCENES["A1"], 5, duration_s=60.0)
    axes = ("gx", "gy", "gz")
    source = write(
        tmp_path / "in.csv",
        {"t_s": record.midships_t_s.tolist(), "az_mps2": (9.8 + 0.1 * np.sin(record.midships_t_s)).tolist()}
        | {f"{axis}1_radps": record.midships_radps[:, i].tolist() for i, axis in enumerate(axes)}
        | {f"{axis}2_radps": record.local_radps[:, i].tolist() for i, axis in enumerate(axes)},
    )
    plain, staged = tmp_path / "plain.csv", tmp_path / "staged.csv"
    replay(source, plain, Config())
    replay(source, staged, Config(hull=hull.Params(enabled=True)))
    before, after = rows_of(plain), rows_of(staged)
    # Appended, and nothing before has changed.
    names = list(after[0])
    assert names[: len(before[0])] == list(before[0])
    assert names[len(before[0]) :] == [
        "hull_x_deg", "hull_y_deg", "hull_z_deg", "hull_static_x_deg", "hull_static_y_deg", "hull_static_z_deg",
        "hull_x_std_arcsec", "hull_y_std_arcsec", "hull_z_std_arcsec",
    ]  # fmt: skip
    assert all(row.items() <= staged_row.items() for row, staged_row in zip(before, after, strict=True))
    assert after[0]["hull_x_deg"] == ""
    last = {name: float(value) for name, value in after[-1].items() if name.startswith("hull")}
    truth = dict(zip("xyz", record.scene.static_deg, strict=True))
    for axis, angle in truth.items():
        std = last[f"hull_{axis}_std_arcsec"]
        assert 1.0 < std < 60.0
        for name in (f"hull_{axis}_deg", f"hull_static_{axis}_deg"):
            assert abs(last[name] - angle) * 3600.0 < 4.0 * std + 3.0 * record.scene.flexure_std_arcsec


def test_a_replay_gives_the_attitude_of_a_craft(tmp_path: Path) -> None:
    t = np.arange(0.0, 20.0, 0.05)
    heave, pitch = 0.2 * np.sin(2.0 * t), 0.01 * np.sin(2.5 * t)
    rng = np.random.default_rng(3)
    source = write(
        tmp_path / "in.csv",
        {
            "t_s": t.tolist(),
            "az_mps2": (9.8 + 0.1 * np.sin(t)).tolist(),
            "heave_sensor_m": (heave + 0.05 * rng.standard_normal(t.size)).tolist(),
            "pitch_sensor_deg": np.degrees(pitch + 0.005 * rng.standard_normal(t.size)).tolist(),
            "speed_mps": [18.0] * t.size,
            "flap_fore_deg": [0.0] * t.size,
            "flap_aft_deg": [0.0] * t.size,
        },
    )
    out = tmp_path / "out.csv"
    replay(source, out, Config(attitude=fusion.Params(enabled=True)))
    rows = rows_of(out)
    assert list(rows[0])[-8:] == [
        "attitude_z_m", "attitude_z_std_m", "attitude_z_rate_mps", "attitude_z_rate_std_mps",
        "attitude_pitch_deg", "attitude_pitch_std_deg", "attitude_pitch_rate_degps", "attitude_pitch_rate_std_degps",
    ]  # fmt: skip
    settled = slice(200, None)
    for name, truth, noise in (("z_m", heave, 0.05), ("pitch_deg", np.degrees(pitch), np.degrees(0.005))):
        off = np.array([float(row[f"attitude_{name}"]) for row in rows])[settled] - truth[settled]
        assert np.sqrt(np.mean(off**2)) < noise
    rate = np.array([float(row["attitude_z_rate_mps"]) for row in rows])[settled]
    assert np.corrcoef(rate, np.cos(2.0 * t)[settled])[0, 1] > 0.9


def test_without_the_stages_there_are_no_columns_of_theirs() -> None:
    assert not [name for name in Table(Config(), str).names if "hull" in name or "attitude" in name]


# ---- the stream ------------------------------------------------------------------------------------------------------

ANGLES = HullAngles(
    t_s=12.5,
    state="converging",
    warnings=("delay",),
    total_rad=(math.radians(0.5), math.radians(-0.8), math.radians(30.0)),
    static_rad=(math.radians(0.4), math.radians(-0.7), math.radians(29.0)),
    dynamic_rad=(math.radians(1.0 / 3600.0), 0.0, math.nan),
    std_rad=(math.radians(10.0 / 3600.0), math.radians(20.0 / 3600.0), math.radians(30.0 / 3600.0)),
    reachable_std_rad=(math.radians(5.0 / 3600.0), math.inf, math.nan),
    delay_s=0.004,
    delay_std_s=0.0005,
    refits=2,
    resets=1,
)
MOTION = CraftMotion(
    t_s=12.5, heave_m=0.25, heave_velocity_mps=-1.5, pitch_rad=math.radians(2.0), pitch_rate_radps=math.radians(-3.0),
    heave_std_m=0.02, heave_velocity_std_mps=0.1, pitch_std_rad=math.radians(0.25),
    pitch_rate_std_radps=math.radians(0.5), probabilities=(0.75, 0.25), switches=3, resets=1, cautions=("settling",),
)  # fmt: skip
FRAME = MotionFrame(
    t_s=12.6,
    quality=Quality(heave=HeaveState.VALID, laser=LaserState.OFF, correction=CorrectionState.OFF),
    crane_roll_rad=math.radians(1.0),
    crane_pitch_rad=math.radians(-2.0),
    hull=ANGLES,
    attitude=MOTION,
)


def test_hull_on_the_wire() -> None:
    """Degrees and arcseconds; what is not known, or infinite, is left out."""
    assert json.loads(wire.encode_record(wire.hull_record(ANGLES, 0.0))) == {
        "class": "HULL", "time": "1970-01-01T00:00:00.000000Z", "mono_s": 12.5, "state": "converging",
        "x_deg": 0.5, "y_deg": -0.8, "z_deg": 30.0, "static_x_deg": 0.4, "static_y_deg": -0.7, "static_z_deg": 29.0,
        "dynamic_x_deg": 0.000278, "dynamic_y_deg": 0.0, "x_std_arcsec": 10.0, "y_std_arcsec": 20.0,
        "z_std_arcsec": 30.0, "x_reachable_std_arcsec": 5.0, "delay_s": 0.004, "delay_std_s": 0.0005,
        "refits": 2, "resets": 1, "warnings": ["delay"],
    }  # fmt: skip


def test_a_hull_of_which_nothing_is_known_on_the_wire() -> None:
    bare = json.loads(wire.encode_record(wire.hull_record(HullAngles(t_s=1.0, state="starting"), 0.0)))
    assert set(bare) == {"class", "time", "mono_s", "state", "refits", "resets"}


def test_attitude_on_the_wire() -> None:
    assert json.loads(wire.encode_record(wire.attitude_record(MOTION, 0.0))) == {
        "class": "ATTITUDE", "time": "1970-01-01T00:00:00.000000Z", "mono_s": 12.5, "heave_m": 0.25,
        "heave_std_m": 0.02, "heave_velocity_mps": -1.5, "heave_velocity_std_mps": 0.1, "pitch_deg": 2.0,
        "pitch_std_deg": 0.25, "pitch_rate_degps": -3.0, "pitch_rate_std_degps": 0.5, "probabilities": [0.75, 0.25],
        "switches": 3, "resets": 1, "cautions": ["settling"],
    }  # fmt: skip


def test_the_crane_base_in_the_motion_line() -> None:
    line = json.loads(wire.encode_motion(FRAME, seq=1, utc_s=0.0, sent_mono_s=12.6))
    assert line["crane_roll_deg"] == 1.0
    assert line["crane_pitch_deg"] == -2.0
    assert "crane_yaw_deg" not in line
    for key in ("hull", "attitude"):
        assert key not in line


def test_metrics_of_the_stages() -> None:
    metrics = Metrics("1")
    assert 'heaved_hull_angle_radians{axis="z"} NaN' in metrics.render().decode()
    metrics.record_stages(FRAME)
    text = metrics.render().decode()
    assert f'heaved_hull_angle_radians{{axis="z"}} {math.radians(30.0)}' in text
    assert f'heaved_hull_std_radians{{axis="y"}} {math.radians(20.0 / 3600.0)}' in text
    assert "heaved_attitude_heave_meters 0.25" in text
    assert f"heaved_attitude_pitch_std_radians {math.radians(0.25)}" in text


def test_status_says_a_line_of_each() -> None:
    quality = Quality(heave=HeaveState.VALID, laser=LaserState.OFF, correction=CorrectionState.OFF)
    status = StatusRecord(
        release="1", uptime_s=1.0, frames=1, heave=HeaveStatus(), quality=quality, devices=(), clients=0,
        dropped=0, hull=HullStatus(state="weak", z_deg=30.0, std_arcsec=45.0, warnings=("delay",), resets=2),
        attitude=AttitudeStatus(heave_m=0.25, heave_std_m=0.02, pitch_deg=2.0, pitch_std_deg=0.25, age_s=0.05),
    )  # fmt: skip
    lines = list(report._stage_rows(status))
    assert lines[0] == "hull        weak   z +30.0000° ±45.0″   delay   started afresh 2 times"
    assert lines[1] == "craft       heave +0.250 m ±0.020 m   pitch +2.00° ±0.25°   age 50.0 ms"
    assert list(report._stage_rows(msgspec.structs.replace(status, hull=None, attitude=None))) == []


# ---- work beside the loop --------------------------------------------------------------------------------------------


def test_a_refit_survives_its_journey() -> None:
    record = simulate(SCENES["A2"], 3, duration_s=40.0)
    estimator = HullDeformation(hull.Params(refit_after_s=30.0), refit_inline=False)
    for t, midships, local in zip(record.midships_t_s, record.midships_radps, record.local_radps, strict=True):
        estimator.step(float(t), midships, local)
    job = estimator.due_refit
    assert job is not None
    sent = msgspec.msgpack.decode(msgspec.msgpack.encode(hull_fitter.pack(7, job)), type=hull_fitter.HullJob)
    back = msgspec.msgpack.decode(msgspec.msgpack.encode(hull_fitter.work(sent)), type=hull_fitter.HullFit)
    assert back.number == 7
    found, here = hull_fitter.unpack(back), refit(job)
    assert found is not None
    assert here is not None
    assert found.flexure.std_rad.tolist() == here.flexure.std_rad.tolist()
    assert estimator.accept(found)


# ---- the tool --------------------------------------------------------------------------------------------------------


def test_the_tool_knows_the_stages(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert accuracy(["hull", "--runs", "1", "--duration", "8", "--no-figures", "--out", str(tmp_path)]) == 0
    kinds = {json.loads(line)["kind"] for line in (tmp_path / "results.jsonl").read_bytes().splitlines()}
    assert kinds == {"hull"}
    assert "### A1" in capsys.readouterr().out
    assert accuracy(["attitude", "--runs", "1", "--duration", "8", "--out", str(tmp_path)]) == 1
    assert "longer --duration" in capsys.readouterr().err
