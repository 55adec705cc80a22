"""What ``heaved status`` prints."""

from __future__ import annotations

import json
import re

import msgspec
import pytest
from stream_peers import make_frame, make_status

from heaved.client.report import CheckState, check_line, duration, json_text, table
from heaved.client.stream_client import Snapshot, Trouble, UnreachableError
from heaved.outputs import wire
from heaved.outputs.records import (
    ClockStatus,
    CorrectionStatus,
    DeviceStatus,
    HeaveStatus,
    LaserStatus,
    MotionRecord,
    ObserverStatus,
    OutputStatus,
    ReferenceStatus,
    StatusRecord,
    VersionRecord,
)
from heaved.samples import CorrectionState, HeaveState, LaserState, Quality, Vibration

# Label=value[unit];[warn];[crit];[min];[max], as the monitoring plugins' guidelines have it.
PERFORMANCE = re.compile(r"[a-z_]+=-?[0-9.e-]+[a-z]*;;;;")


def motion(age_s: float = 0.002) -> MotionRecord:
    frame = make_frame(5.0)
    line = wire.encode_motion(frame, seq=1, utc_s=1767225600.0, sent_mono_s=5.0 + age_s)
    return msgspec.json.decode(line, type=MotionRecord)


def quality(heave: HeaveState, *reasons: str) -> Quality:
    return Quality(heave=heave, laser=LaserState.VALID, correction=CorrectionState.ACTIVE, reasons=tuple(reasons))


def snapshot(status: StatusRecord | None = None, frame: MotionRecord | None = None) -> Snapshot:
    return Snapshot(version=VersionRecord(release="1.2.3"), status=status or make_status(), motion=frame)


MRU = ReferenceStatus(
    heave_difference_m=0.123, heave_std_difference_m=0.21, heave_explained_m=0.06, heave_correlation=0.95,
    heave_delay_s=0.4, heave_scale=0.9, roll_mean_difference_deg=1.5, roll_std_difference_deg=0.1, compared_s=300.0,
    age_s=0.1, warnings=("reference MRU: heave differs by 0.21 m RMS over 300 s, both explain 0.06 m",),
)  # fmt: skip


def test_an_mru_beside_ours_is_shown_and_one_that_differs_is_a_warning() -> None:
    shown = table(snapshot(make_status(reference_mru=MRU), motion()))
    assert "reference   heave +0.123 m from ours   0.210 m RMS over 300 s, both explain 0.060 m" in shown
    assert "correlation 0.950, +400 ms late, 0.900 times ours   age 100.0 ms" in shown
    assert "minus ours, in the mean: roll +1.50° ±0.10°" in shown
    assert MRU.warnings[0] in shown
    state, line = check_line(snapshot(make_status(reference_mru=MRU), motion()))
    assert state is CheckState.WARNING
    assert MRU.warnings[0] in line
    good = msgspec.structs.replace(MRU, warnings=())
    assert check_line(snapshot(make_status(reference_mru=good), motion()))[0] is CheckState.OK
    for status, words in ((ReferenceStatus(), "nothing to compare yet"), (ReferenceStatus(age_s=30.0), "for 30.0 s")):
        assert words in table(snapshot(make_status(reference_mru=status), motion()))
    assert "reference" not in table(snapshot(make_status(), motion()))


LASER_DOWN = DeviceStatus(
    name="laser",
    role="laser",
    up=False,
    wanted_rate_hz=20.0,
    results={"none": 7, "timeout": 1234},
    last_fault="timeout",
    last_fault_age_s=0.05,
    detail="rtu:///dev/ttyUSB0: no answer: check the cable",
)
IMU = make_status().devices[0]
DP = OutputStatus(
    name="dp",
    kind="EM3000",
    link="tcp-listen://0.0.0.0:5000",
    up=True,
    sent=1234,
    detail="listening, nobody is connected",
)
PLC_DOWN = OutputStatus(
    name="plc",
    kind="TSS1",
    link="/dev/ttyUSB2 (9600 8N1)",
    up=False,
    sent=77,
    lost={"down": 12, "slow": 3},
    detail="/dev/ttyUSB2 is not there: plug the adapter in",
)


@pytest.mark.parametrize(
    ("result", "state", "said"),
    [
        (snapshot(frame=motion()), CheckState.OK, "OK - heave valid, age 2.0 ms |"),
        (snapshot(), CheckState.OK, "OK - heave valid, age 2.0 ms |"),
        (
            snapshot(make_status(quality=quality(HeaveState.DEGRADED, "long | swell")), motion()),
            CheckState.WARNING,
            "WARNING - heave degraded (long / swell), age",
        ),
        (snapshot(make_status(quality=quality(HeaveState.SETTLING)), motion()), CheckState.WARNING, "heave settling"),
        (snapshot(make_status(devices=(IMU, LASER_DOWN)), motion()), CheckState.WARNING, "down: laser"),
        (snapshot(make_status(outputs=(DP, PLC_DOWN)), motion()), CheckState.WARNING, "down: output plc"),
        (snapshot(make_status(outputs=(DP,)), motion()), CheckState.OK, "OK - heave valid"),
        (
            snapshot(make_status(quality=quality(HeaveState.INVALID, "no IMU")), motion()),
            CheckState.CRITICAL,
            "CRITICAL - heave invalid (no IMU)",
        ),
        (
            snapshot(frame=msgspec.structs.replace(motion(), quality=quality(HeaveState.INVALID, "no IMU"))),
            CheckState.CRITICAL,
            "CRITICAL - heave invalid (no IMU)",
        ),
        (
            snapshot(frame=msgspec.structs.replace(motion(), heave_m=None)),
            CheckState.CRITICAL,
            "heave valid, but there is none",
        ),
        (snapshot(frame=motion(age_s=1.5)), CheckState.CRITICAL, "last frame is 1.5 s old"),
        (snapshot(make_status(heave=HeaveStatus(age_s=90.0))), CheckState.CRITICAL, "last frame is 90.0 s old"),
        (snapshot(make_status(heave=HeaveStatus())), CheckState.CRITICAL, "no frame yet"),
        (UnreachableError(Trouble.REFUSED, "h:1: refused"), CheckState.CRITICAL, "CRITICAL - h:1: refused"),
        (UnreachableError(Trouble.SILENT, "h:1: open,\nbut"), CheckState.CRITICAL, "CRITICAL - h:1: open, but"),
        (UnreachableError(Trouble.TURNED_AWAY, "h:1: full"), CheckState.CRITICAL, "h:1: full"),
        (UnreachableError(Trouble.NOT_HEAVED, "h:1: smtp"), CheckState.UNKNOWN, "UNKNOWN - h:1: smtp"),
        (UnreachableError(Trouble.NO_ADDRESS, "h:1: no such host"), CheckState.UNKNOWN, "UNKNOWN"),
    ],
)
def test_check_line(result: Snapshot | UnreachableError, state: CheckState, said: str) -> None:
    code, line = check_line(result)
    assert (code, int(code)) == (state, ["OK", "WARNING", "CRITICAL", "UNKNOWN"].index(line.split(" - ")[0]))
    assert said in line
    assert "\n" not in line
    assert line.count("|") == isinstance(result, Snapshot)
    if isinstance(result, Snapshot):
        assert all(PERFORMANCE.fullmatch(item) for item in line.split(" | ")[1].split())


def test_performance_data() -> None:
    _, line = check_line(snapshot(frame=motion()))
    assert line.split(" | ")[1] == (
        "age=0.002s;;;; heave=1.25m;;;; heave_std=0.02m;;;; rate=100;;;; clients=1;;;; dropped=0c;;;;"
    )


def test_json() -> None:
    body = json.loads(json_text(snapshot(frame=motion())))
    assert body["reachable"] is True
    assert body["version"]["release"] == "1.2.3"
    assert body["status"]["heave"] == {"heave_m": 1.25, "heave_std_m": 0.02, "age_s": 0.002}
    assert body["motion"]["quality"]["heave"] == "valid"
    assert json.loads(json_text(UnreachableError(Trouble.SILENT, "h:1: nothing"))) == {
        "reachable": False, "trouble": "silent", "message": "h:1: nothing",
    }  # fmt: skip


def test_table_shows_what_there_is() -> None:
    status = make_status(
        devices=(IMU, LASER_DOWN),
        lead_s=0.0123,
        dropped=44,
        observer=ObserverStatus(
            name="sea", frequencies_hz=(0.121, 0.2104), fit_age_s=12.0, resets=3, roll_pitch_weight=0.9
        ),
        correction=CorrectionStatus(
            state=CorrectionState.ACTIVE, runs=12, last_result="accepted", age_s=35.0, nothing_to_learn=3
        ),
        laser=LaserStatus(is_elsewhere=True, ahead_m=8.124, ahead_std_m=0.05, port_m=-0.031, port_std_m=0.004),
        clock=ClockStatus(utc_offset_s=1.7e9, steps=2),
        config_file="/etc/heaved/heaved.toml",
        state_file="/var/lib/heaved/state.json",
        quality=quality(HeaveState.DEGRADED, "laser and estimate disagree"),
    )
    text = table(snapshot(status, motion()))
    for expected in (
        "heaved 1.2.3, up 60.0 s",
        "/etc/heaved/heaved.toml",
        "/var/lib/heaved/state.json",
        "+1.250 m ±0.020 m   age 2.0 ms   100.0 frames/s",
        "degraded   laser valid",
        "laser and estimate disagree",
        "roll +5.73°   pitch -2.86°   yaw -",
        "sea at 0.121, 0.210 Hz, with roll and pitch, fitted 12.0 s ago, started afresh 3 times",
        "+12.3 ms",
        "active, 12 trainings, the last accepted, 3 times nothing to learn, network in use since 35.0 s",
        "rtu:///dev/ttyUSB0: no answer: check the cable",
        "elsewhere: 8.12 m ±0.05 m ahead, 0.03 m ±0.00 m to starboard of where it is configured",
        "1 connected, 44 lines dropped",
        "stepped 2 times",
    ):
        assert expected in text
    rows = {line.split()[0]: line for line in text.splitlines() if line}
    assert "up" in rows["imu"]
    assert "crc 2" in rows["imu"]
    assert "DOWN" in rows["laser"]
    assert "timeout 1234" in rows["laser"]
    assert re.search(r"rock +in +roll +pitch +yaw", text)
    assert re.search(r"50 ms +\+5\.730° ±0\.057° +-2\.865° ±0\.057° +-$", text, re.MULTILINE)
    assert re.search(r"5 s +\+1\.000 m +±0\.100 m$", text, re.MULTILINE)


def test_table_names_what_shakes_and_the_noise() -> None:
    shaking = (Vibration(frequency_hz=3.1, width_hz=0.02, rms_mps2=0.21),)
    observer = ObserverStatus(name="sea", vibration=shaking, noise_mps2_rthz=1.02e-3, bias_walk_mps2_rts=3e-5)
    expected = "noise 1.0e-03 m/s2/√Hz   bias walk 3.0e-05 m/s2/√s   vibration: seen at 3.1 Hz, 0.21 m/s2"
    assert re.search(rf"^sensor +{re.escape(expected)}$", table(snapshot(make_status(observer=observer))), re.MULTILINE)
    assert "sensor" not in table(snapshot(make_status(observer=ObserverStatus(name="sea"))))


def test_table_of_outputs() -> None:
    text = table(snapshot(make_status(outputs=(DP, PLC_DOWN))))
    assert re.search(r"^output +speaks +link +state +sent +lost$", text, re.MULTILINE)
    assert re.search(r"^dp +EM3000 +tcp-listen://0.0.0.0:5000 +up +1234 +-$", text, re.MULTILINE)
    assert re.search(r"^plc +TSS1 +/dev/ttyUSB2 \(9600 8N1\) +DOWN +77 +down 12, slow 3$", text, re.MULTILINE)
    assert "  plc: /dev/ttyUSB2 is not there: plug the adapter in" in text
    assert "  dp: listening, nobody is connected" in text
    assert "output" not in table(snapshot(make_status()))


def test_table_of_a_daemon_that_knows_nothing_yet() -> None:
    status = make_status(heave=HeaveStatus(), devices=(), rate_hz=None, quality=quality(HeaveState.SETTLING))
    text = table(snapshot(status))
    assert "no frame yet" in text
    assert "no frame came while waiting" in text
    assert "None" not in text
    assert "nan" not in text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (-0.01, "-10.0 ms"),
        (0.0021, "2.1 ms"),
        (1.0, "1.0 s"),
        (119.9, "119.9 s"),
        (120.0, "2 min"),
        (7199.0, "119 min"),
        (7200.0, "2 h 0 min"),
        (172799.0, "47 h 59 min"),
        (172800.0, "2 d 0 h"),
        (30 * 86400 + 5 * 3600.0, "30 d 5 h"),
    ],
)
def test_duration(seconds: float, text: str) -> None:
    assert duration(seconds) == text


EVIL = "\x1b]0;x\x07\x9b31m\u202e\x7f\U000e0041"


def test_nothing_of_a_daemon_commands_the_terminal() -> None:
    """Whatever text it sends, in whatever place."""

    def corrupted(found: object) -> object:
        if isinstance(found, dict):
            return {key: corrupted(value) for key, value in found.items()}
        if isinstance(found, list | tuple):
            return [corrupted(value) for value in found]
        kept = ("valid", "active", "degraded", "VERSION", "STATUS", "MOTION")
        return found + EVIL if isinstance(found, str) and found not in kept else found

    status = make_status(
        devices=(LASER_DOWN,),
        outputs=(PLC_DOWN,),
        config_file="/etc",
        state_file="/var",
        observer=ObserverStatus(name="sea", frequencies_hz=(0.1,)),
        quality=quality(HeaveState.DEGRADED, "swell"),
        correction=CorrectionStatus(state=CorrectionState.ACTIVE, runs=1, last_result="accepted"),
    )
    evil = msgspec.convert(corrupted(msgspec.to_builtins(snapshot(status, motion()))), Snapshot)
    for text in (table(evil), json_text(evil), check_line(evil)[1]):
        assert all(line.isprintable() for line in text.split("\n"))
    assert json.loads(json_text(evil))["status"]["devices"][0]["name"] == f"laser{EVIL}"
    refused = UnreachableError(Trouble.TURNED_AWAY, f"h:1: the daemon says: {EVIL}")
    for text in (str(refused), json_text(refused), check_line(refused)[1]):
        assert all(line.isprintable() for line in text.split("\n"))
