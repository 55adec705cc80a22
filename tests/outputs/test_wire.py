"""Lines of the stream: strict JSON out, anything in."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from typing import Any, NoReturn

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from heaved.outputs import wire
from heaved.outputs.records import (
    DeviceStatus,
    ErrorRecord,
    HeaveStatus,
    ReferenceStatus,
    StatusRecord,
    VersionRecord,
)
from heaved.outputs.requests import (
    ACCEPTED,
    MAX_REQUEST_BYTES,
    STREAM_CLASSES,
    BadRequest,
    LineSplitter,
    Request,
    StatusQuery,
    Subscription,
    VersionQuery,
    parse_request,
)
from heaved.samples import (
    CorrectionState,
    DelayedHeave,
    HeaveForecast,
    HeaveState,
    LaserState,
    MotionFrame,
    MruAgreement,
    MruComparison,
    PointMotion,
    Quality,
    RockPrediction,
    SeaState,
    Vibration,
    WaveSystem,
)

numbers = st.floats(allow_nan=True, allow_infinity=True)
horizons = st.floats(min_value=0.01, max_value=60.0)
qualities = st.builds(
    Quality,
    heave=st.sampled_from(HeaveState),
    laser=st.sampled_from(LaserState),
    correction=st.sampled_from(CorrectionState),
    reasons=st.lists(st.text(max_size=20), max_size=3).map(tuple),
)
rocks = st.builds(
    RockPrediction,
    horizon_s=horizons,
    roll_rad=numbers,
    pitch_rad=numbers,
    yaw_rad=numbers,
    roll_std_rad=numbers,
    pitch_std_rad=numbers,
    yaw_std_rad=numbers,
)
forecasts = st.builds(HeaveForecast, horizon_s=horizons, heave_m=numbers, std_m=numbers)
points = st.builds(PointMotion, name=st.text(min_size=1, max_size=10), heave_m=numbers, heave_velocity_mps=numbers)
frames = st.builds(
    MotionFrame,
    t_s=st.floats(min_value=0.0, max_value=1e8),
    quality=qualities,
    heave_m=numbers,
    heave_std_m=numbers,
    heave_velocity_mps=numbers,
    heave_acceleration_mps2=numbers,
    observer_m=numbers,
    correction_m=numbers,
    lead_s=numbers,
    reference_m=numbers,
    roll_rad=numbers,
    pitch_rad=numbers,
    yaw_rad=numbers,
    rock=st.lists(rocks, max_size=3).map(tuple),
    forecast=st.lists(forecasts, max_size=3).map(tuple),
    points=st.lists(points, max_size=3).map(tuple),
    compensation_lead_s=st.floats(min_value=0.0, max_value=5.0),
)


def strict(line: bytes) -> dict[str, Any]:
    """One line of JSON as the standard has it: no NaN, no infinity, no key twice, nothing null."""

    def refuse(constant: str) -> NoReturn:
        raise AssertionError(f"{constant} is not JSON")

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        assert len({key for key, _ in pairs}) == len(pairs), f"a key twice in {pairs}"
        assert all(value is not None for _, value in pairs), f"null in {pairs}"
        return dict(pairs)

    assert line.endswith(b"\n")
    assert line.count(b"\n") == 1
    record = json.loads(line.decode("utf-8"), parse_constant=refuse, object_pairs_hook=unique)
    assert isinstance(record, dict)
    return record


def check_value(record: dict[str, Any], key: str, value: float, factor: float = 1.0) -> None:
    """``record[key]`` is ``value`` to six decimals, or left out when ``value`` means nothing."""
    if math.isfinite(value) and abs(value) < 1e6:
        assert record[key] == pytest.approx(value * factor, abs=5.1e-7, rel=1e-15)
    elif not math.isfinite(value):
        assert key not in record


@given(frame=frames, seq=st.integers(1, 2**53), dropped=st.integers(0, 2**40))
def test_any_frame_is_one_strict_line_with_class_first(frame: MotionFrame, seq: int, dropped: int) -> None:
    line = wire.encode_motion(frame, seq=seq, utc_s=1.75e9, sent_mono_s=frame.t_s + 0.25, dropped=dropped)
    record = strict(line)
    assert line.startswith(b'{"class":"MOTION",')
    assert (record["seq"], record["dropped"]) == (seq, dropped)
    assert record["age_s"] == pytest.approx(0.25, abs=1e-6)
    assert record["mono_s"] == pytest.approx(frame.t_s, abs=1e-6)
    for key in ("heave_m", "heave_std_m", "heave_velocity_mps", "heave_acceleration_mps2", "observer_m",
                "correction_m", "lead_s", "reference_m"):  # fmt: skip
        check_value(record, key, getattr(frame, key))
    for axis in ("roll", "pitch", "yaw"):
        check_value(record, f"{axis}_deg", getattr(frame, f"{axis}_rad"), math.degrees(1.0))
    for sent, rock in zip(record.get("rock", []), frame.rock, strict=True):
        assert sent["horizon_s"] == rock.horizon_s
        for name in ("roll", "pitch", "yaw", "roll_std", "pitch_std", "yaw_std"):
            check_value(sent, f"{name}_deg", getattr(rock, f"{name}_rad"), math.degrees(1.0))
    for sent, forecast in zip(record.get("forecast", []), frame.forecast, strict=True):
        assert sent["horizon_s"] == forecast.horizon_s
        check_value(sent, "heave_m", forecast.heave_m)
        check_value(sent, "std_m", forecast.std_m)
    for sent, point in zip(record.get("points", []), frame.points, strict=True):
        assert sent["name"] == point.name
        check_value(sent, "heave_m", point.heave_m)
        check_value(sent, "heave_velocity_mps", point.heave_velocity_mps)
    assert record.get("compensation_lead_s", 0.0) == frame.compensation_lead_s
    assert record["quality"] == {
        "heave": frame.quality.heave.value,
        "laser": frame.quality.laser.value,
        "correction": frame.quality.correction.value,
        "reasons": list(frame.quality.reasons),
    }


def test_golden_motion_line() -> None:
    frame = MotionFrame(
        t_s=12.5,
        quality=Quality(
            heave=HeaveState.DEGRADED, laser=LaserState.STALE, correction=CorrectionState.HOLDING, reasons=("swell",)
        ),
        heave_m=-1.5,
        roll_rad=math.pi / 180.0,
        rock=(RockPrediction(horizon_s=0.05, roll_rad=math.pi / 90.0, roll_std_rad=math.pi / 1800.0),),
        forecast=(HeaveForecast(horizon_s=2.0, heave_m=0.25),),
    )
    assert wire.encode_motion(frame, seq=7, utc_s=1767225600.123456, sent_mono_s=12.502, dropped=3) == (
        b'{"class":"MOTION","seq":7,"time":"2026-01-01T00:00:00.123456Z","mono_s":12.5,"heave_m":-1.5,'
        b'"roll_deg":1.0,"rock":[{"horizon_s":0.05,"roll_deg":2.0,"roll_std_deg":0.1}],'
        b'"forecast":[{"horizon_s":2.0,"heave_m":0.25}],'
        b'"quality":{"heave":"degraded","laser":"stale","correction":"holding","reasons":["swell"]},'
        b'"age_s":0.002000,"dropped":3}\n'
    )


def test_golden_motion_line_of_a_stream_that_is_ahead_of_time_with_points() -> None:
    """Neither is on a line when it is not configured: see the golden line before."""
    frame = MotionFrame(
        t_s=12.5,
        quality=Quality(heave=HeaveState.VALID, laser=LaserState.OFF, correction=CorrectionState.OFF),
        heave_m=0.5,
        compensation_lead_s=0.25,
        points=(
            PointMotion(name="crane tip", heave_m=1.0000004, heave_std_m=0.02, heave_velocity_mps=-0.5),
            PointMotion(name="moon pool", heave_m=math.nan),
        ),
    )
    assert wire.encode_motion(frame, seq=7, utc_s=1767225600.0, sent_mono_s=12.5) == (
        b'{"class":"MOTION","seq":7,"time":"2026-01-01T00:00:00.000000Z","mono_s":12.5,"heave_m":0.5,'
        b'"compensation_lead_s":0.25,'
        b'"points":[{"name":"crane tip","heave_m":1.0,"heave_std_m":0.02,"heave_velocity_mps":-0.5},'
        b'{"name":"moon pool"}],'
        b'"quality":{"heave":"valid","laser":"off","correction":"off","reasons":[]},'
        b'"age_s":0.000000,"dropped":0}\n'
    )


SEA = SeaState(
    significant_height_m=2.50004,
    peak_period_s=11.0,
    mean_period_s=8.1234,
    systems=(
        WaveSystem(kind="swell", significant_height_m=2.0, peak_period_s=12.0),
        WaveSystem(kind="wind sea", significant_height_m=1.5, peak_period_s=6.0),
    ),
    frequencies_hz=(0.05, 0.123456),
    spectrum_m2phz=(0.0123456, 12.5),
    t_s=100.0,
    window_s=300.0,
    model="3 chains of 8 resonators",
)


def test_golden_sea_line() -> None:
    assert wire.encode_record(wire.sea_record(SEA, 1767225600.5)) == (
        b'{"class":"SEA","time":"2026-01-01T00:00:00.500000Z","significant_height_m":2.5,"peak_period_s":11.0,'
        b'"mean_period_s":8.123,"is_still":false,'
        b'"systems":[{"kind":"swell","significant_height_m":2.0,"peak_period_s":12.0},'
        b'{"kind":"wind sea","significant_height_m":1.5,"peak_period_s":6.0}],'
        b'"frequencies_hz":[0.05,0.12346],"spectrum_m2phz":[0.01235,12.5],'
        b'"model":"3 chains of 8 resonators","window_s":300.0,"vibration":[]}\n'
    )


def test_golden_sea_line_of_a_hull_that_shakes() -> None:
    vibration = (Vibration(frequency_hz=3.10004, width_hz=0.0216, rms_mps2=0.212134),)
    shaken = msgspec.structs.replace(SEA, vibration=vibration, noise_mps2_rthz=0.00102345, bias_walk_mps2_rts=3e-5)
    assert wire.encode_record(wire.sea_record(shaken, 1767225600.5)).endswith(
        b',"window_s":300.0,"vibration":[{"frequency_hz":3.1,"width_hz":0.022,"rms_mps2":0.2121}],'
        b'"noise_mps2_rthz":0.00102,"bias_walk_mps2_rts":0.00003}\n'
    )


def test_golden_delayed_line() -> None:
    delayed = DelayedHeave(t_s=12.5000004, heave_m=-1.23456789, std_m=0.0125)
    assert wire.encode_record(wire.delayed_record(delayed, 1767225600.0)) == (
        b'{"class":"DELAYED","time":"2026-01-01T00:00:00.000000Z","mono_s":12.5,"heave_m":-1.234568,"std_m":0.0125}\n'
    )


def test_golden_reference_line() -> None:
    """What an MRU does not tell is absent, a quantity that it knows nothing of altogether."""
    compared = MruComparison(
        t_s=12.5,
        heave=MruAgreement(
            reference=1.25, own=1.0, difference=0.25, mean_difference=0.5, std_difference=0.125, rms_difference=0.5154,
            explained=0.0625, correlation=0.99, delay_s=math.nan, scale=1.05,
        ),
        roll=MruAgreement(reference=0.5 * math.pi, own=0.25 * math.pi, difference=0.25 * math.pi),
        compared_s=300.0,
        warnings=("reference MRU: ...",),
    )  # fmt: skip
    assert strict(wire.encode_record(wire.reference_record(compared, 1767225600.0))) == {
        "class": "REFERENCE", "time": "2026-01-01T00:00:00.000000Z", "mono_s": 12.5,
        "heave": {
            "reference_m": 1.25, "own_m": 1.0, "difference_m": 0.25, "mean_difference_m": 0.5,
            "std_difference_m": 0.125, "rms_difference_m": 0.5154, "explained_m": 0.0625, "correlation": 0.99,
            "scale": 1.05,
        },
        "roll": {"reference_deg": 90.0, "own_deg": 45.0, "difference_deg": 45.0},
        "compared_s": 300.0, "warnings": ["reference MRU: ..."],
    }  # fmt: skip
    status = wire.reference_status(compared, 13.0)
    assert (status.heave_std_difference_m, status.heave_delay_s, status.age_s) == (0.125, None, 0.5)
    assert wire.reference_status(compared, 30.0) == ReferenceStatus(age_s=17.5)
    assert wire.reference_status(None, 30.0) == ReferenceStatus()


@given(st.integers(0, 4102444800 * 10**6))
@example(1767225600 * 10**6)  # A whole second keeps its six zeros.
@example(1767225600 * 10**6 - 1)
def test_time_is_utc_to_the_microsecond(microseconds: int) -> None:
    text = wire.iso_time(microseconds / 1e6)
    assert len(text) == len("2026-01-01T00:00:00.123456Z")
    assert text.endswith("Z")
    back = datetime.fromisoformat(text) - datetime(1970, 1, 1, tzinfo=UTC)
    assert abs(back.total_seconds() - microseconds / 1e6) <= 1.1e-6


def test_records_that_are_not_known_are_left_out() -> None:
    device = DeviceStatus(name="imu", role="imu", up=False)
    status = StatusRecord(
        release="1", uptime_s=1.0, frames=0, heave=HeaveStatus(), devices=(device,), clients=0, dropped=0,
        quality=Quality(
            heave=HeaveState.INVALID, laser=LaserState.OFF, correction=CorrectionState.OFF, reasons=()
        ),
    )  # fmt: skip
    assert strict(wire.encode_record(status)) == {
        "class": "STATUS", "release": "1", "uptime_s": 1.0, "frames": 0, "heave": {}, "clients": 0, "dropped": 0,
        "devices": [{"name": "imu", "role": "imu", "up": False}],
        "quality": {"heave": "invalid", "laser": "off", "correction": "off", "reasons": []},
    }  # fmt: skip
    assert wire.encode_record(VersionRecord(release="1.2.3")) == (
        b'{"class":"VERSION","release":"1.2.3","proto_major":1,"proto_minor":5}\n'
    )
    assert wire.encode_record(ErrorRecord(message="no")) == b'{"class":"ERROR","message":"no"}\n'


@pytest.mark.parametrize(
    ("line", "request_"),
    [
        (b'?WATCH={"classes":["MOTION","SEA"],"rate_hz":10}', Subscription(classes=("MOTION", "SEA"), rate_hz=10.0)),
        (b'?WATCH={"rate_hz":0.5}\r', Subscription(rate_hz=0.5)),
        (b'?WATCH={"classes":[]}', Subscription(classes=())),
        (b"?WATCH={}", Subscription(classes=("MOTION",), rate_hz=None)),
        (b"?STATUS", StatusQuery()),
        (b"?VERSION\r\n", VersionQuery()),
    ],
)
def test_requests(line: bytes, request_: Request) -> None:
    assert parse_request(line) == request_


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (b"", "not understood"),
        (b"GET / HTTP/1.1\r", "GET / HTTP/1.1"),
        (b"?status", "?status"),
        (b'?WATCH={"classes":["MOTIONS"]}', "MOTIONS"),
        (b'?WATCH={"rate":5}', "`rate`"),
        (b'?WATCH={"rate_hz":0}', "above 0"),
        (b'?WATCH={"rate_hz":-1}', "above 0"),
        (b'?WATCH={"rate_hz":1e400}', "rate_hz"),
        (b'?WATCH={"rate_hz":NaN}', "malformed"),
        (b'?WATCH={"rate_hz":10} now', "trailing"),
        (b'?WATCH={"classes":["\xff"]}', "?WATCH"),
        (b"?WATCH=" + b"[" * 500, "?WATCH"),
        (b"?STATUS" + b" " * 506, "513 bytes"),
    ],
)
def test_anything_else_is_told_what_was_wrong_and_what_is_accepted(line: bytes, said: str) -> None:
    answer = parse_request(line)
    assert isinstance(answer, BadRequest)
    assert said in answer.message
    assert ACCEPTED in answer.message


@given(
    st.one_of(
        st.binary(max_size=600),
        st.binary(max_size=500).map(lambda tail: b"?WATCH=" + tail),
        st.recursive(
            st.none() | st.booleans() | st.floats() | st.text(max_size=8) | st.sampled_from(STREAM_CLASSES),
            lambda inner: (
                st.lists(inner, max_size=3)
                | st.dictionaries(st.sampled_from(["classes", "rate_hz", "x"]), inner, max_size=3)
            ),
        ).map(lambda value: b"?WATCH=" + json.dumps(value).encode()),
    )
)
def test_no_line_raises(line: bytes) -> None:
    request = parse_request(line)
    assert isinstance(request, Subscription | StatusQuery | VersionQuery | BadRequest)
    if isinstance(request, BadRequest):
        strict(wire.encode_record(ErrorRecord(message=request.message)))
    if isinstance(request, Subscription):
        assert set(request.classes) <= set(STREAM_CLASSES)
        assert request.rate_hz is None or 0.0 < request.rate_hz < math.inf


@given(data=st.lists(st.sampled_from([b"?STATUS\n", b"\n", b"x" * 300, b"\r\n", b"ab"]), max_size=12).map(b"".join),
       cuts=st.lists(st.integers(0, 4000), max_size=8))  # fmt: skip
def test_pieces_do_not_matter_to_the_splitter(data: bytes, cuts: list[int]) -> None:
    pieces, start = [], 0
    for cut in [*sorted(cut for cut in cuts if cut <= len(data)), len(data)]:
        pieces.append(data[start:cut])
        start = cut
    whole, parts, bytewise = LineSplitter(), LineSplitter(), LineSplitter()
    lines = whole.feed(data)
    assert [line for piece in pieces for line in parts.feed(piece)] == lines
    assert [line for byte in data for line in bytewise.feed(bytes([byte]))] == lines
    assert parts.overflow == bytewise.overflow == whole.overflow
    too_long = [len(line) + 1 > MAX_REQUEST_BYTES for line in data.split(b"\n")]
    assert whole.overflow == any(too_long)
    expected = data.split(b"\n")[:-1]
    assert lines == (expected[: too_long.index(True)] if whole.overflow else expected)


@pytest.mark.parametrize("line", [b"", b"\xff\xfe", b"[]", b"1", b"{}", b'{"class":1}', b"HTTP/1.1 400 Bad Request",
                                  b"[" * 100_000])  # fmt: skip
def test_decode_says_what_is_not_a_line(line: bytes) -> None:
    with pytest.raises(ValueError, match="not a line of the stream"):
        wire.decode(line)


def test_decode_reads_what_is_sent() -> None:
    assert wire.decode(b'{"class":"SEA","hs_m":2.5}\n') == {"class": "SEA", "hs_m": 2.5}
