"""Configuration: every fault of a file is found in one go and named; a sound file gives exactly what it says."""

from __future__ import annotations

import importlib.util
import math
import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin, get_type_hints

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heaved.config import Config
from heaved.config.read import ConfigError, data_directory, load, parse
from heaved.config.rules import cautions, rate_faults
from heaved.devices.profile import Block, Condition, DeviceSpec, Field, Profile, Sentence, SentenceField
from heaved.estimation.lever_arm import Point
from heaved.outputs.telegrams.spec import OutputSpec

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

IMU_PROFILE = """
[device.profile]
name = "inline"
[[device.profile.blocks]]
start = 0
fields = [{ quantity = "az_mps2", offset = 0, type = "float32", unit = "m/s2" }]
"""
IMU = """
[[device]]
name = "imu"
role = "imu"
link = "tcp://127.0.0.1:15020"
rate_hz = 100
"""
LASER = """
[[device]]
name = "laser"
role = "laser"
link = "tcp://127.0.0.1:15021"
rate_hz = 20
[device.profile]
name = "inline"
[[device.profile.blocks]]
start = 0
fields = [{ quantity = "laser_m", offset = 0, type = "float32", unit = "m" }]
"""


def read(text: str, directory: Path = Path("/nonexistent")) -> Config:
    return parse(tomllib.loads(text), file="test.toml", directory=directory)


def faults_of(text: str, directory: Path = Path("/nonexistent")) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        read(text, directory)
    assert caught.value.file == "test.toml"
    assert all(line.startswith("test.toml: ") for line in str(caught.value).splitlines())
    return caught.value.faults


def test_an_empty_file_is_all_defaults() -> None:
    assert read("") == Config()


def test_a_device_with_an_inline_profile() -> None:
    config = read(IMU + IMU_PROFILE + LASER)
    assert [device.name for device in config.device] == ["imu", "laser"]
    assert config.device[0].rate_hz == 100.0
    assert config.device[0].profile.blocks[0].fields[0].quantity == "az_mps2"


def test_values_reach_their_tables() -> None:
    ahead = "[heave.sea]\nwindows_s = [60, 240]\n[compensation]\nlead_s = 0.25"
    config = read(f'[[point]]\nname = "tip"\nup_m = 30\n{ahead}')
    assert config.point == (Point(name="tip", up_m=30.0),)
    assert (config.heave.sea.windows_s, config.compensation.lead_s) == ((60.0, 240.0), 0.25)
    config = read('[heave]\ncomponents = 3\n[heave.lead]\nenabled = false\n[stream]\nport = 0\nallow = ["10.0.0.0/8"]')
    assert (config.heave.components, config.heave.lead.enabled, config.stream.port) == (3, False, 0)
    assert config.stream.allow == ("10.0.0.0/8",)


FAULTS: dict[str, tuple[str, str]] = {
    "unknown table": ("[haeve]", "haeve: unknown key; known here: device, heave"),
    "unknown key": ("[stream]\nprot = 1", "stream.prot: unknown key; known here: host, port"),
    "unknown nested key": ("[heave.lead]\nwindow = 1", "heave.lead.window: unknown key"),
    "unknown key of a device": (IMU + "baud = 9600" + IMU_PROFILE, "device[0].baud: unknown key"),
    "missing key of a device": (IMU.replace("rate_hz = 100", "") + IMU_PROFILE, "device[0].rate_hz: missing"),
    "wrong type": ('[stream]\nport = "5570"', "stream.port: Expected `int`, got `str` (got '5570')"),
    "out of range": ("[stream]\nport = 70000", "stream.port: Expected `int` <= 65535 (got 70000)"),
    "no such choice": ('[heave]\nobserver = "kalman"', "heave.observer: must be 'harmonic' or 'sea' (got 'kalman')"),
    "no such role": (LASER.replace('role = "laser"', 'role = "gps"'), "'crane' or 'reference_mru' (got 'gps')"),
    "neither sign": ("[laser]\nsign = 2", "laser.sign: must be 1 or -1 (got 2)"),
    "a laser on another ship": ("[laser]\nforward_m = 501", "laser.forward_m: Expected `float` <= 500.0 (got 501)"),
    "a laser nowhere": ("[laser]\nup_m = nan", "laser.up_m: Expected `float` >= -500.0 (got nan)"),
    "a beam that points nowhere": ("[laser]\nbeam = [0, 0, 0]", "laser.beam: must point down or up"),
    "a level beam": ("[laser]\nbeam = [1, 0, 0]", "laser.beam: must point down or up, by no more than 60 degrees"),
    "a beam that leans too far": ("[laser]\nbeam = [0.9, 0, -0.5]", "from it (got [0.9, 0, -0.5])"),
    "a beam of two numbers": ("[laser]\nbeam = [0, -1]", "laser.beam: Expected `array` of length 3"),
    "a beam of nan": ("[laser]\nbeam = [0, 0, nan]", "laser.beam: must be finite"),
    "nan": ("[heave]\nmax_gap_s = nan", "heave.max_gap_s: "),
    "nan in a list": ("[heave]\nband_hz = [nan, 0.6]", "heave.band_hz: must be finite"),
    "infinity": ("[correction]\nstep_s = inf", "correction.step_s: "),
    "a number beyond floats": (f"[heave]\nmax_gap_s = {10**400}", "heave.max_gap_s: "),
    "band upside down": ("[heave]\nband_hz = [0.6, 0.04]", "heave.band_hz: must be a lower and a higher frequency"),
    "horizon twice": ("[heave]\nforecast_horizons_s = [1, 1.0]", "heave.forecast_horizons_s: names a horizon twice"),
    "a recording anywhere": (
        '[recording]\ndirectory = "recordings"',
        "recording.directory: 'recordings' must be an absolute path",
    ),
    "a recording of nothing": ("[recording]\nmax_gb = 0", "recording.max_gb: Expected `float` >= 0.1 (got 0)"),
    "a recording of what": (
        '[recording]\nwhat = "frames"',
        "recording.what: must be 'all' or 'samples' (got 'frames')",
    ),
    "no window": ("[heave.sea]\nwindows_s = []", "heave.sea.windows_s: must be lengths that increase (got [])"),
    "windows that shrink": ("[heave.sea]\nwindows_s = [300, 120]", "heave.sea.windows_s: must be lengths that incr"),
    "a window twice": ("[heave.sea]\nwindows_s = [120, 120.0]", "heave.sea.windows_s: must be lengths that increase"),
    "a window too short": ("[heave.sea]\nwindows_s = [59, 300]", "heave.sea.windows_s: Expected `float` >= 60.0"),
    "a window that is nan": ("[heave.sea]\nwindows_s = [120, nan]", "heave.sea.windows_s: "),
    "rock horizon twice": ("[rock]\nhorizons_s = [0.1, 0.5, 0.1]", "rock.horizons_s: names a horizon twice"),
    "horizon of zero": ("[heave]\nforecast_horizons_s = [0]", "heave.forecast_horizons_s: "),
    "lead backwards": ("[compensation]\nlead_s = -0.1", "compensation.lead_s: Expected `float` >= 0.0 (got -0.1)"),
    "points as one table": ('[point]\nname = "tip"', "point: is one table; write [[point]]"),
    "points as a value": ("point = false", "point: Expected `array`, got `bool` (got False)"),
    "point without name": ("[[point]]\nup_m = 3", "point[0].name: missing"),
    "name with a space": ('[[point]]\nname = "crane tip"', "point[0].name: Expected `str` matching regex"),
    "name with a line end": ('[[point]]\nname = "tip\\n"', "point[0].name: Expected `str` matching regex"),
    "point at infinity": ('[[point]]\nname = "tip"\nport_m = inf', "point[0].port_m: must be finite (got inf)"),
    "two points of one name": (
        '[[point]]\nname = "tip"\n[[point]]\nname = "pool"\n[[point]]\nname = "tip"\nup_m = 9',
        "point[2].name: 'tip' is already the name of point[0]",
    ),
    "table where a value is": ("[stream.port]\na = 1", "stream.port: Expected `int`, got `object`"),
    "value where a table is": ("stream = 5", "stream: Expected `object`, got `int`"),
    "device as one table": ('[device]\nname = "imu"', "device: is one table; write [[device]]"),
    "broken link": (IMU.replace("tcp:", "udp:") + IMU_PROFILE, "device[0].link: link 'udp://127.0.0.1:15020': unknown"),
    "no such profile": (IMU + 'profile = "acme"', "device[0].profile: no profile 'acme'; give a file or one of: "),
    "profile name too long": (IMU + f'profile = "{"x" * 5000}"', "device[0].profile: no profile 'xxx"),
    "a role that is not served": (LASER.replace('role = "laser"', 'role = "imu"'), "'inline' has no az_mps2"),
    "two of one name": (
        IMU + IMU_PROFILE + LASER.replace('name = "laser"', 'name = "imu"', 1),
        "device[1].name: 'imu' is already the name of device[0]",
    ),
    "two of one role": (
        IMU + IMU_PROFILE + IMU.replace('"imu"', '"imu2"', 1) + "device_id = 2" + IMU_PROFILE,
        "device[1].role: 'imu' is already the role of device[0]",
    ),
    "fields overlap": (
        LASER.replace("fields = [", 'fields = [{ quantity = "signal", offset = 1 }, '),
        "device[0].profile: profile inline: block 0 (holding, start 0): laser_m overlaps signal",
    ),
    "one serial port, two settings": (
        (IMU + IMU_PROFILE).replace("tcp://127.0.0.1:15020", "rtu:///dev/ttyUSB0?baudrate=9600")
        + LASER.replace("tcp://127.0.0.1:15021", "rtu:///dev/ttyUSB0?baudrate=19200"),
        "give both the same settings",
    ),
    "a comment in a link": (
        IMU.replace("tcp://127.0.0.1:15020", "rtu:///dev/ttyUSB0#1?baudrate=115200") + IMU_PROFILE,
        'what follows "#" would be ignored',
    ),
    "a space in a link": (IMU.replace(":15020", ":15020 ") + IMU_PROFILE, "a character that no link has (SPACE)"),
    "a tab in a link": (IMU.replace(":15020", ":15020\\t") + IMU_PROFILE, "a character that no link has (U+0009)"),
    "wide digits": (IMU.replace(":15020", ":１５") + IMU_PROFILE, "no link has (FULLWIDTH DIGIT ONE)"),
    "bare IPv6": (IMU.replace("127.0.0.1", "fd00::7") + IMU_PROFILE, "stands in brackets, e.g. tcp://[fd00::7]:502"),
    "one id twice on a serial line": (
        (IMU + IMU_PROFILE + LASER)
        .replace("rate_hz = 100", "rate_hz = 9")
        .replace("rate_hz = 20", "rate_hz = 9")
        .replace("tcp://127.0.0.1:15020", "rtu:///dev/ttyS0")
        .replace("tcp://127.0.0.1:15021", "rtu:///dev/ttyS0"),
        "device laser: device_id 1 on /dev/ttyS0 (9600 8N1) is that of device imu already",
    ),
    "one id twice, the same registers": (
        IMU + IMU_PROFILE + LASER.replace(":15021", ":15020"),
        "device laser: device_id 1 on tcp://127.0.0.1:15020 is that of device imu already",
    ),
    "measured after the answer": (
        IMU + "latency_ms = 80" + IMU_PROFILE,
        "device[0].latency_ms: 80 is beyond timeout_ms (50): no device measures after it has answered",
    ),
    "a laser that is turned": (
        LASER.replace("rate_hz = 20", "rate_hz = 20\nrotation_deg = [0, 0, 90]"),
        "device[0].rotation_deg: is for an IMU; a device in role 'laser' has nothing to apply it to",
    ),
    "a lateness of what has no angles": (
        LASER.replace("rate_hz = 20", "rate_hz = 20\nattitude_latency_ms = 10"),
        "device[0].attitude_latency_ms: is for an IMU; a device in role 'laser' has nothing to apply it to",
    ),
    "a tilted sensor of one axis": (
        IMU + "rotation_deg = [0.0, 3.0, 0.0]" + IMU_PROFILE,
        "device[0].rotation_deg: the vertical acceleration of a tilted sensor takes all three, and profile 'inline' "
        "has no ax_mps2 and no ay_mps2",
    ),
    "a bias that is none": (
        IMU + "bias_mps2 = [9.8, 0, 0]" + IMU_PROFILE,
        "device[0].bias_mps2: Expected `float` <= 5.0",
    ),
    "a profile that is not there": (
        IMU + 'profile = "mine/imu.toml"',
        "no profile 'mine/imu.toml'; there is no file /nonexistent/mine/imu.toml; give a file or one of: ",
    ),
    "off-host without allow": ('[stream]\nhost = "0.0.0.0"', "stream.host: 0.0.0.0 listens beyond this machine"),
    "http off-host": ('[http]\nhost = "::"', "http.host: :: listens beyond this machine"),
    "host is a name": ('[stream]\nhost = "ship.example"', "stream.host: 'ship.example' is no IP address"),
    "allow is no network": ('[stream]\nallow = ["10.0.0.1/8"]', "stream.allow[0]: 10.0.0.1/8 has host bits set"),
    "one port twice": ("[http]\nport = 5570", "http.port: port 5570 is also that of stream.port"),
}


def test_a_recording_needs_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    text = "[recording]\nenabled = true"
    assert read(text).recording.enabled
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert faults_of(text) == [
        "recording.enabled: needs pyarrow, which is not installed: pip install 'heaved[recording]'"
    ]
    assert not read("[recording]\nenabled = false").recording.enabled


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_named_with_its_path(name: str) -> None:
    text, expected = FAULTS[name]
    found = faults_of(text)
    assert len(found) == 1, found
    assert expected in found[0]


def test_every_fault_is_reported_in_one_go() -> None:
    text = f"""
    [heave]
    components = 0
    window = 30
    [stream]
    port = "x"
    host = "0.0.0.0"
    [http]
    allow = ["nonsense"]
    {IMU}profile = "acme"
    {LASER.replace("tcp://", "serial://").replace("rate_hz = 20", "rate_hz = 0")}
    """
    found = faults_of(text)
    for path in ("heave.components", "heave.window", "stream.port", "http.allow[0]", "device[0].profile",
                 "device[1].rate_hz"):  # fmt: skip
        assert sum(fault.startswith(path + ":") for fault in found) == 1, (path, found)


def test_a_wrong_key_hides_no_other_fault_of_its_table() -> None:
    """Keys that are wrong only beside each other are found although a third is wrong in itself."""
    text = f"""
    [heave]
    windows = 3
    band_hz = [0.6, 0.04]
    [heave.lead]
    limit_s = -1
    [rock]
    points = "many"
    horizons_s = [0.1, 0.1]
    [stream]
    port = 70000
    host = "0.0.0.0"
    [http]
    port = 5570
    allow = ["10.0.0.0/33", 3]
    [[point]]
    name = "tip"
    up = 3
    [[point]]
    name = "tip"
    {(IMU + IMU_PROFILE).replace("tcp:", "udp:")}
    {LASER.replace('"laser"', '"imu"', 1).replace('role = "laser"', 'role = "imu"').replace("rate_hz = 20", "")}
    {LASER.replace('"laser"', '"imu"', 1).replace("tcp:", "serial:").replace("rate_hz = 20", "rate_hz = -1")}
    """
    assert sorted({fault.split(":")[0] for fault in faults_of(text)}) == sorted((
        "heave.windows", "heave.band_hz", "heave.lead.limit_s", "rock.points", "rock.horizons_s",
        "stream.port", "stream.host", "http.allow", "point[0].up", "point[1].name", "device[0].link",
        "device[1].name", "device[1].role", "device[1].rate_hz",
        "device[2].name", "device[2].link", "device[2].rate_hz",
    ))  # fmt: skip


def test_a_rate_beyond_the_line_is_reported_beside_other_faults() -> None:
    found = faults_of((IMU + IMU_PROFILE).replace("tcp://127.0.0.1:15020", "rtu:///dev/ttyS0") + "[haeve]")
    assert [fault.split(":")[0] for fault in found] == ["haeve", "line /dev/ttyS0 (9600 8N1)"]


def test_faults_of_a_profile_file_name_the_file(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("name = ")
    (fault,) = faults_of(IMU + 'profile = "mine.toml"', tmp_path)
    assert fault.startswith(f"device[0].profile: {tmp_path / 'mine.toml'}: is not valid TOML")


def test_a_profile_beside_the_file_comes_before_the_packaged_ones(tmp_path: Path) -> None:
    (tmp_path / "devices").mkdir()
    packaged = sorted((data_directory() / "devices").glob("*.toml"))[0].stem
    content = 'name = "mine"\n[[blocks]]\nstart = 0\nfields = [{ quantity = "az_mps2", offset = 0, unit = "g" }]'
    (tmp_path / "devices" / f"{packaged}.toml").write_text(content)
    assert read(IMU + f'profile = "{packaged}"', tmp_path).device[0].profile.name == "mine"


def test_a_plc_may_hold_two_sensors_under_one_id() -> None:
    """Their registers are others, and a TCP connection has no collisions."""
    text = IMU + IMU_PROFILE + LASER.replace(":15021", ":15020").replace("start = 0", "start = 2")
    assert len(read(text).device) == 2


def test_a_port_under_two_names_is_refused_with_both(tmp_path: Path) -> None:
    (tmp_path / "ttyUSB0").touch()
    (tmp_path / "by-id").symlink_to("ttyUSB0")
    text = (IMU + IMU_PROFILE + LASER + "\n").replace("rate_hz = 100", "rate_hz = 9").replace("= 20", "= 9")
    text = text.replace("tcp://127.0.0.1:15020", f"rtu://{tmp_path}/ttyUSB0?baudrate=9600&parity=N")
    (fault,) = faults_of(text.replace("tcp://127.0.0.1:15021", f"rtu://{tmp_path}/by-id"))
    assert f"device[1].link: {tmp_path}/by-id is the same port as {tmp_path}/ttyUSB0 of device[0]" in fault
    (fault,) = faults_of(text.replace("tcp://127.0.0.1:15021", f"rtu://{tmp_path}/./ttyUSB0"))
    assert "is the same port as" in fault
    # The options in another order are the same line, which they share.
    same = text.replace("tcp://127.0.0.1:15021", f"rtu://{tmp_path}/ttyUSB0?parity=N&baudrate=9600")
    assert len(read(same.replace('role = "laser"', 'role = "laser"\ndevice_id = 2')).device) == 2


@pytest.mark.parametrize("rate_hz", [0.2, 0.5, 1.0, 1.5])
def test_an_imu_too_slow_for_waves_is_refused(rate_hz: float) -> None:
    """Waves are fitted up to 0.8 Hz; half the rate must be more (Nyquist)."""
    text = IMU.replace("rate_hz = 100", f"rate_hz = {rate_hz}") + IMU_PROFILE
    with pytest.raises(ConfigError, match=r"device\[0\].rate_hz: .* is too slow for waves: .* takes 1.6 Hz at least"):
        parse(tomllib.loads(text), file="test.toml", directory=Path("/nonexistent"), to_run=True)
    assert read(text).device[0].rate_hz == rate_hz  # For a replay it is not asked.


def test_other_devices_may_be_slow() -> None:
    text = IMU + IMU_PROFILE + LASER.replace("rate_hz = 20", "rate_hz = 0.5")
    config = parse(tomllib.loads(text), file="test.toml", directory=Path("/nonexistent"), to_run=True)
    assert cautions(config) == []


CAUTIONS: dict[str, tuple[str, str]] = {
    "a slow IMU": (IMU.replace("rate_hz = 100", "rate_hz = 2") + IMU_PROFILE, "no wave shorter than 1 s"),
    "a sensor wider than its polls": (
        IMU.replace("rate_hz = 100", "rate_hz = 20") + 'profile = "witmotion-wt901c485"',
        "device[0].rate_hz: at 20 Hz, less than twice its bandwidth of 20 Hz, vibration of 19.4-20.6, 39.4-40.6 Hz "
        "folds into the waves, and nothing can tell it from them; poll at 40 Hz or more, or set register 0x1F",
    ),
    "a sensor set wider than it is delivered": (
        IMU + 'bandwidth_hz = 98\nprofile = "witmotion-hwt905-485"',
        "vibration of 99.4-100.6 Hz folds into the waves",
    ),
    "a wide sensor on a slow line": (
        IMU.replace("rate_hz = 100", "rate_hz = 20").replace("tcp://127.0.0.1:15020", "rtu:///dev/ttyS0")
        + 'profile = "witmotion-wt901c485"',
        "poll at 40 Hz or more (the line carries 21.8: raise its baud rate first)",
    ),
    "a long timeout": (IMU + "timeout_ms = 3000" + IMU_PROFILE, "device[0].timeout_ms: 3000 ms of waiting"),
    "stuck at once": (IMU + "stuck_after_s = 0.001" + IMU_PROFILE, "0.001 s is less than the period (10 ms)"),
    "a neighbour that waits": (
        (IMU + "timeout_ms = 9" + IMU_PROFILE + LASER.replace(":15021", ":15020") + "\n").replace(
            'role = "laser"', 'role = "laser"\ndevice_id = 2'
        ),
        "device laser: timeout_ms 50 is longer than the period of imu (10 ms) on the same line",
    ),
    "a laser that may look at the ship": (
        IMU + 'profile = "witmotion-wt901c485"\n' + LASER + "\n[laser]\nsign = -1\nforward_m = 3",
        "laser.sign: -1 with a beam that looks down is a laser that stands on something fixed and looks at the ship; "
        "for one on board that looks the other way write beam = [0, 0, 1]",
    ),
    "a laser elsewhere without an attitude": (
        IMU + IMU_PROFILE + LASER + "\n[laser]\nport_m = 3",
        "laser.forward_m, laser.port_m: no imu measures roll and pitch",
    ),
}


@pytest.mark.parametrize("name", CAUTIONS)
def test_what_costs_is_said(name: str) -> None:
    text, expected = CAUTIONS[name]
    (caution,) = cautions(read(text))
    assert expected in caution


@pytest.mark.parametrize(
    ("rate_hz", "said", "count"),
    [(100, "", 0), (40, "", 0), (39.9, "folds", 1), (2, "no wave shorter than 1 s: the heave errs more", 2)],
)
def test_a_known_bandwidth_says_what_folds(rate_hz: float, said: str, count: int) -> None:
    found = cautions(read(IMU.replace("rate_hz = 100", f"rate_hz = {rate_hz}") + 'profile = "witmotion-wt901c485"'))
    assert len(found) == count
    assert said in "".join(found[:1])


def test_the_bandwidth_of_the_device_comes_before_that_of_its_profile() -> None:
    text = IMU.replace("rate_hz = 100", "rate_hz = 20") + 'bandwidth_hz = 10\nprofile = "witmotion-wt901c485"'
    assert cautions(read(text)) == []


def test_a_correction_needs_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    config = load(data_directory() / "heaved.toml")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    (said,) = cautions(config)
    assert said.startswith("correction.enabled: torch is not installed, so no correction is trained")
    assert not cautions(msgspec.structs.replace(config, device=config.device[:1]))
    off = msgspec.structs.replace(config.correction, enabled=False)
    assert not cautions(msgspec.structs.replace(config, correction=off))


SENTENCES = """
[device.profile]
name = "inline"
[[device.profile.sentences]]
header = "$PA"
fields = [
    { quantity = "ax_mps2", index = 1, unit = "m/s2" },
    { quantity = "ay_mps2", index = 2, unit = "m/s2" },
    { quantity = "az_mps2", index = 3, unit = "m/s2" },
    { quantity = "roll_rad", index = 4, unit = "rad" },
]
[[device.profile.sentences]]
header = "$PB"
fields = [{ quantity = "pitch_rad", index = 1, unit = "rad" }]
"""


@pytest.mark.parametrize(
    ("rotation", "profile", "expected"),
    [
        ("[0, -85, 0]", 'profile = "witmotion-wt901c485"', ["its x axis stands 85 degrees up or down"]),
        ("[180, 0, 90]", 'profile = "witmotion-wt901c485"', []),
        ("[0, 0, 30]", SENTENCES, ["roll and pitch take each other"]),
        ("[30, 0, 180]", SENTENCES, []),
    ],
)
def test_what_a_mounting_costs_is_said(rotation: str, profile: str, expected: list[str]) -> None:
    link = 'link = "tcp://127.0.0.1:15020"'
    text = IMU.replace(link, 'link = "serial:///dev/x"') if profile is SENTENCES else IMU
    found = cautions(read(f"{text}\nrotation_deg = {rotation}\nbandwidth_hz = 20\n{profile}"))
    assert len(found) == len(expected)
    assert all(part in caution for part, caution in zip(expected, found, strict=True))


@pytest.mark.parametrize("name", ["heaved.toml", "demo.toml", "sensors.toml", "hull.toml", "hydrofoil.toml"])
def test_packaged_files_need_no_caution(name: str) -> None:
    assert cautions(load(data_directory() / name)) == []


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    (tmp_path / "heaved.toml").write_bytes(b"\xef\xbb\xbf[stream]\r\nport = 1234\r\n")
    assert load(tmp_path / "heaved.toml").stream.port == 1234


UNREADABLE: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing": (lambda _path: None, "cannot be read: No such file"),
    "directory": (lambda path: path.mkdir(), "cannot be read: Is a directory"),
    "not UTF-8": (lambda path: path.write_bytes(b"\xff\xfe"), "is not UTF-8 text"),
    "UTF-16": (lambda path: path.write_text("[stream]", encoding="utf-16"), "is not UTF-8 text, save it as such"),
    "not TOML": (lambda path: path.write_text("[stream"), "is not valid TOML"),
    "curly quotes": (
        lambda path: path.write_text("[stream]\nhost = \N{LEFT DOUBLE QUOTATION MARK}::1"),
        "(at line 2, column 8); the line holds a LEFT DOUBLE QUOTATION MARK: type it anew",
    ),
    "a space that does not break": (
        lambda path: path.write_text("[stream]\n\N{NO-BREAK SPACE}port = 1"),
        "the line holds a NO-BREAK SPACE",
    ),
    "a number without end": (lambda path: path.write_text("a = " + "9" * 5000), "is not valid TOML"),
    "brackets without end": (lambda path: path.write_text("a = " + "[" * 100_000), "is not valid TOML"),
}


@pytest.mark.parametrize("name", UNREADABLE)
def test_unreadable_files(tmp_path: Path, name: str) -> None:
    make, expected = UNREADABLE[name]
    path = tmp_path / "heaved.toml"
    make(path)
    with pytest.raises(ConfigError, match=re.escape(expected)) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_a_rate_that_the_line_cannot_carry_is_a_fault_of_the_plan() -> None:
    """8 + 9 bytes of 10 bits at 9600 baud take 17.7 ms, and two silences of 3.5 characters 7.3 ms: 40 Hz at most."""
    rtu = (IMU + IMU_PROFILE).replace("tcp://127.0.0.1:15020", "rtu:///dev/ttyUSB0?baudrate=9600")
    (fault,) = rate_faults(read(rtu))
    assert "imu at 100 Hz needs 25.0 ms a poll" in fault
    assert rate_faults(read(rtu.replace("rate_hz = 100", "rate_hz = 39"))) == []
    assert rate_faults(read(IMU + IMU_PROFILE)) == []


# ---- hostile input ---------------------------------------------------------------------------------------------------

ARRAYS = ("device", "point", "output")
"""Tables of which there may be several."""

_KEYS = sorted(
    {field.name for kind in (Config, DeviceSpec, Profile, Block, Field, Point, OutputSpec)
       for field in msgspec.structs.fields(kind)}
    | {field.name for table in Config() .__struct_fields__ if table not in ARRAYS
       for field in msgspec.structs.fields(getattr(Config(), table))}
)  # fmt: skip
_WORDS = st.sampled_from(
    ("imu", "laser", "tcp://h:1", "rtu:///dev/x", "az_mps2", "holding", "0.0.0.0", "", "a/b", "\0")
)
_LEAVES = st.booleans() | st.integers() | st.floats() | st.text(max_size=10) | _WORDS | st.dates() | st.times()
_TREES = st.recursive(
    _LEAVES,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(_KEYS) | st.text(max_size=5), inner),
    max_leaves=20,
)


@given(st.dictionaries(st.sampled_from(_KEYS), _TREES, max_size=4))
def test_no_document_raises_anything_but_config_error(document: dict[str, Any]) -> None:
    try:
        config = parse(document, file="x.toml", directory=Path("/nonexistent"))
    except ConfigError as error:
        assert error.faults  # noqa: PT017 - either outcome is right, an empty refusal is not
    else:
        assert isinstance(config, Config)


_POINTS = st.lists(
    st.dictionaries(
        st.sampled_from([field.name for field in msgspec.structs.fields(Point)] * 5 + ["up"]),
        _LEAVES | st.floats(-100.0, 100.0) | st.sampled_from(("tip", "moon-pool", "A.1", "tip\n", "x" * 32, "x" * 33)),
        max_size=4,
    ),
    max_size=4,
)


def is_sound_point(table: dict[str, Any]) -> bool:
    """As the manual has it: a name of up to 32 letters, digits, ``_``, ``.`` or ``-``, and finite metres."""
    metres = [table.get(key, 0.0) for key in ("forward_m", "port_m", "up_m")]
    name = table.get("name")
    return (
        set(table) <= {"name", "forward_m", "port_m", "up_m"}
        and isinstance(name, str)
        and re.fullmatch(r"[A-Za-z0-9_.-]{1,32}", name) is not None
        and all(type(metre) in (int, float) and math.isfinite(metre) for metre in metres)
    )


@given(_POINTS)
def test_points_are_taken_as_written_or_the_wrong_ones_are_named(listed: list[dict[str, Any]]) -> None:
    wrong = {i for i, table in enumerate(listed) if not is_sound_point(table)}
    names = [table.get("name") for table in listed]
    doubled = {i for i, name in enumerate(names) if isinstance(name, str) and name in names[:i]}
    try:
        config = parse({"point": listed}, file="x.toml", directory=Path("/nonexistent"))
    except ConfigError as error:
        named = {int(re.match(r"point\[(\d)\]\.", fault)[1]) for fault in error.faults}  # type: ignore[index]
        assert named - doubled == wrong - doubled
        assert wrong <= named
    else:
        assert not wrong | doubled
        assert config.point == tuple(Point(**table) for table in listed)


# ---- the files that come with the program ----------------------------------------------------------------------------


def uncommented(path: Path) -> str:
    """The file with its switched-off keys switched on."""
    return re.sub(r"(?m)^#(?=[a-z_0-9]+ = )", "", path.read_text(encoding="utf-8"))


def tables(table: msgspec.Struct, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """(path, default, type) of every key of ``table`` and below that is not a table itself."""
    hints = get_type_hints(type(table), include_extras=True)
    for field in msgspec.structs.fields(table):
        default = getattr(table, field.name)
        if isinstance(default, msgspec.Struct):
            yield from tables(default, f"{path}{field.name}.")
        elif path or field.name not in ARRAYS:
            yield f"{path}{field.name}", msgspec.to_builtins(default), hints[field.name]


KEYS = {path: (default, hint) for path, default, hint in tables(Config())}


@pytest.mark.parametrize("key", KEYS)
def test_the_default_file_documents_every_key_with_its_default(key: str) -> None:
    node: Any = tomllib.loads(uncommented(data_directory() / "heaved.toml"))
    for part in key.split("."):
        assert part in node, f"{key} is not in heaved.toml"
        node = node[part]
    default = KEYS[key][0]
    if default is not None:
        assert node == (list(default) if isinstance(default, tuple) else default)


def bounds(hint: Any) -> str:
    """``0..1`` or ``>0..1`` as the default file writes it; empty when the type has no two bounds."""
    if get_origin(hint) is Annotated:
        meta = get_args(hint)[1]
        low = meta.ge if meta.ge is not None else meta.gt
        if low is not None and meta.le is not None:
            return f"{'' if meta.ge is not None else '>'}{low:.10g}..{meta.le:.10g}"
    return next((found for part in get_args(hint) if (found := bounds(part))), "")


@pytest.mark.parametrize("key", [key for key, (_, hint) in KEYS.items() if bounds(hint)])
def test_the_default_file_states_the_true_range(key: str) -> None:
    text = (data_directory() / "heaved.toml").read_text(encoding="utf-8")
    table, _, name = key.rpartition(".")
    section = re.split(r"(?m)^\[", text.split(f"\n[{table}]\n")[1])[0]
    line = next(line for line in section.splitlines() if line.startswith(f"#{name} = "))
    assert bounds(KEYS[key][1]) in line


def test_the_default_file_documents_devices_and_profiles() -> None:
    text = uncommented(data_directory() / "heaved.toml")
    device = tomllib.loads(text)["device"][0]
    for field in msgspec.structs.fields(DeviceSpec):
        assert field.name in device
        if not field.required and field.name != "device_id":
            assert msgspec.convert(device[field.name], field.type) == field.default
    for kind in (Profile, Block, Field, Sentence, SentenceField, Condition):
        for field in msgspec.structs.fields(kind):
            assert re.search(rf"(?m)^#.*\b{field.name}\b", text), f"{field.name} of {kind.__name__} is not documented"


@pytest.mark.parametrize("name", ["heaved.toml", "sensors.toml"])
def test_packaged_files_are_sound(name: str) -> None:
    config = load(data_directory() / name)
    assert [device.role for device in config.device] == ["imu", "laser"]
    assert rate_faults(config) == []
