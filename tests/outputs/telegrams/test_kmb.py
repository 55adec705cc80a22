"""KM Binary. Oracle: pykmall, which reads it within #SKM datagrams, and the offsets of the makers' tables."""

from __future__ import annotations

import struct
from io import BytesIO
from math import cos, degrees, inf, isfinite, isnan, nan, pi, radians, sin
from typing import Any

import msgspec
import pytest
from any_motion import is_told, motions, spec_of
from hypothesis import given
from hypothesis import strategies as st
from KMALL.kmall import kmall  # type: ignore[import-untyped]  # pykmall has no types.

from heaved.outputs.motion import Lead, Motion
from heaved.outputs.telegrams.kmb import FORMAT, encode
from heaved.outputs.telegrams.spec import Settling, Telegram, as_read
from heaved.samples import DelayedHeave, HeaveState

SPEC = spec_of(Telegram.KMB)
FULL = Motion(
    utc_s=1_700_000_000.25, age_s=0.01, state=HeaveState.VALID,
    heave_m=-1.25, heave_std_m=0.0625, heave_velocity_mps=0.5, heave_acceleration_mps2=-0.375,
    surge_acceleration_mps2=0.25, sway_acceleration_mps2=-0.125,
    roll_rad=radians(5.5), pitch_rad=radians(-2.25), yaw_rad=0.0,
    roll_std_rad=radians(0.5), pitch_std_rad=radians(0.25), yaw_std_rad=radians(2.0),
    roll_rate_radps=radians(1.5), pitch_rate_radps=radians(-0.75), yaw_rate_radps=radians(0.125),
    delayed=DelayedHeave(t_s=80.0, heave_m=-0.75, std_m=0.02), delayed_utc_s=1_699_999_980.5,
)  # fmt: skip

# Offset and kind of each field, as EK80's and SBG's manuals have them, and what FULL has there.
FIELDS: list[tuple[int, str, object]] = [
    (0, "4s", b"#KMB"), (4, "H", 132), (6, "H", 1), (8, "I", 1_700_000_000), (12, "I", 250_000_000), (16, "I", 1),
    (20, "d", nan), (28, "d", nan), (36, "f", nan), (40, "f", 5.5), (44, "f", -2.25), (48, "f", 0.0), (52, "f", -1.25),
    (56, "f", 1.5), (60, "f", -0.75), (64, "f", 0.125), (68, "f", nan), (72, "f", nan), (76, "f", 0.5),
    (80, "f", -1.0), (84, "f", -1.0), (88, "f", -1.0), (92, "f", 0.5), (96, "f", 0.25), (100, "f", 2.0),
    (104, "f", 0.0625), (108, "f", 0.25), (112, "f", 0.125), (116, "f", -0.375),
    (120, "I", 1_699_999_980), (124, "I", 500_000_000), (128, "f", -0.75),
]  # fmt: skip


def read(telegram: bytes) -> dict[str, Any]:
    """As pykmall reads it."""
    reader = kmall()
    reader.FID = BytesIO(telegram)
    told: dict[str, Any] = reader.read_KMbinary()
    late = reader.read_KMdelayedHeave()
    assert reader.FID.read() == b""
    return told | {f"late_{name}": value for name, value in late.items()}


def bits(status: int) -> set[int]:
    return {bit for bit in range(32) if status >> bit & 1}


def test_nanoseconds_stay_below_a_second() -> None:
    told = read(encode(msgspec.structs.replace(FULL, utc_s=1.0 - 2.0**-53), SPEC))
    assert (told["time_sec"], told["time_nanosec"]) == (0, 999_999_999)


def test_every_field_is_where_the_makers_have_it() -> None:
    telegram = encode(FULL, SPEC)
    assert len(telegram) == FORMAT.longest_bytes == 132
    for at, kind, value in FIELDS:
        (told,) = struct.unpack_from(f"<{kind}", telegram, at)
        if isinstance(value, float):
            assert told == pytest.approx(value, abs=1e-6, nan_ok=True), at
        else:
            assert told == value, at
    assert sum(struct.calcsize(f"<{kind}") for _, kind, _ in FIELDS) == 132


def test_pykmall_reads_all_of_it() -> None:
    told = read(encode(FULL, SPEC))
    assert told["dgmType"] == "#KMB"
    assert told["numBytesDgm"] == 132
    assert told["dgtime"] == pytest.approx(1_700_000_000.25, abs=1e-6)
    assert bits(told["status"]) == {0}
    assert told["heave_m"] == -1.25
    assert told["velDown"] == 0.5
    assert told["roll_deg"] == pytest.approx(5.5)
    assert told["pitchRate"] == pytest.approx(-0.75)
    assert told["heaveError_m"] == 0.0625
    assert told["late_delayedHeave_m"] == -0.75
    assert told["late_time_sec"] + 1e-9 * told["late_time_nanosec"] == 1_699_999_980.5


def test_heave_its_derivatives_and_the_delayed_one_are_positive_down() -> None:
    told = read(encode(as_read(FULL, SPEC, FORMAT.signs), SPEC))
    assert (told["heave_m"], told["velDown"], told["downAcceleration"]) == (1.25, -0.5, 0.375)
    assert told["late_delayedHeave_m"] == 0.75
    assert told["roll_deg"] == pytest.approx(5.5)
    assert told["pitch_deg"] == pytest.approx(-2.25)


def test_it_tells_its_own_time() -> None:
    assert FORMAT.lead is Lead.NONE


@pytest.mark.parametrize(
    ("changed", "settling", "set_bits", "unknown"),
    [
        ({"state": HeaveState.DEGRADED}, Settling.DEGRADED, {0, 19}, []),
        ({"state": HeaveState.SETTLING}, Settling.DEGRADED, {0, 19}, []),
        ({"state": HeaveState.SETTLING}, Settling.ERROR, {0, 3, 4}, ["heave_m", "velDown", "downAcceleration"]),
        ({"state": HeaveState.INVALID}, Settling.DEGRADED, {0, 3, 4}, ["heave_m", "velDown", "downAcceleration"]),
        ({"heave_m": nan}, Settling.DEGRADED, {0, 3}, ["heave_m"]),
        ({"heave_m": 1e39}, Settling.DEGRADED, {0, 3}, ["heave_m"]),
        ({"heave_velocity_mps": nan}, Settling.DEGRADED, {0, 3}, ["velDown"]),
        ({"roll_rad": nan}, Settling.DEGRADED, {0, 1}, ["roll_deg"]),
        ({"pitch_rad": 4.0}, Settling.DEGRADED, {0, 1}, ["pitch_deg"]),
        (
            {"yaw_rad": nan},
            Settling.DEGRADED,
            {0, 2, 4},
            ["heading_deg", "northAcceleration", "eastAcceleration"],
        ),
        ({"sway_acceleration_mps2": inf}, Settling.DEGRADED, {0, 4}, []),
        ({"yaw_rate_radps": nan}, Settling.DEGRADED, {0}, ["yawRate"]),
        ({"delayed": None}, Settling.DEGRADED, {0, 5, 6}, ["late_delayedHeave_m"]),
        ({"delayed_utc_s": nan}, Settling.DEGRADED, {0, 5, 6}, ["late_delayedHeave_m"]),
    ],
)
def test_what_is_not_known_is_nan_and_its_bit_is_set(
    changed: dict[str, object], settling: Settling, set_bits: set[int], unknown: list[str]
) -> None:
    told = read(encode(msgspec.structs.replace(FULL, **changed), spec_of(Telegram.KMB, settling=settling)))
    assert bits(told["status"]) == set_bits
    for name in unknown:
        assert isnan(told[name]), name
    assert told["heaveError_m"] == (-1.0 if "heave_m" in unknown else 0.0625)
    assert told["late_time_sec"] == (0 if 5 in set_bits else 1_699_999_980)


@pytest.mark.parametrize("std", [nan, inf, -0.1, 1e300])
def test_an_error_that_is_not_known_is_minus_one(std: float) -> None:
    motion = msgspec.structs.replace(FULL, heave_std_m=std, roll_std_rad=std, pitch_std_rad=std, yaw_std_rad=std)
    told = read(encode(motion, SPEC))
    names = ("heaveError_m", "rollError_deg", "pitchError_deg", "headingError_deg", "latitudeError_m")
    assert [told[name] for name in names] == [-1.0] * 5


@pytest.mark.parametrize("utc_s", [nan, inf, -1.0, 2.0**32])
def test_a_sample_without_a_time_is_not_sent(utc_s: float) -> None:
    assert encode(msgspec.structs.replace(FULL, utc_s=utc_s), SPEC) == b""


@pytest.mark.parametrize(
    ("heading_deg", "north_mps2", "east_mps2"),
    [(0.0, 2.0, -1.0), (90.0, 1.0, 2.0), (180.0, -2.0, 1.0), (270.0, -1.0, -2.0), (-90.0, -1.0, -2.0)],
)
def test_accelerations_north_and_east(heading_deg: float, north_mps2: float, east_mps2: float) -> None:
    """2 m/s2 forward and 1 m/s2 to port: to port is west when the bow points north, and north when it points east."""
    motion = msgspec.structs.replace(
        FULL, yaw_rad=radians(heading_deg), surge_acceleration_mps2=2.0, sway_acceleration_mps2=1.0
    )
    told = read(encode(motion, SPEC))
    assert told["northAcceleration"] == pytest.approx(north_mps2, abs=1e-6)
    assert told["eastAcceleration"] == pytest.approx(east_mps2, abs=1e-6)
    assert told["heading_deg"] == pytest.approx(heading_deg % 360.0, abs=1e-4)


@pytest.mark.parametrize("yaw_rad", [-1e-20, 2.0 * pi, 2.0 * pi * (1.0 - 1e-12), -2.0 * pi])
def test_a_heading_is_below_360_degrees(yaw_rad: float) -> None:
    told = read(encode(msgspec.structs.replace(FULL, yaw_rad=yaw_rad), SPEC))
    assert 0.0 <= told["heading_deg"] < 360.0
    assert min(told["heading_deg"], 360.0 - told["heading_deg"]) < 1e-4


def single(told: float, value: float, *, is_known: bool) -> bool:
    """Whether what is told is the value in single precision, or nan where it is not known."""
    return told == pytest.approx(value, rel=1e-6, abs=1e-30) if is_known else isnan(told)


@given(motions(), st.sampled_from(Settling))
def test_a_reader_gets_the_motion_or_is_told_that_it_is_not_known(motion: Motion, settling: Settling) -> None:
    telegram = encode(motion, spec_of(Telegram.KMB, settling=settling))
    if telegram == b"":
        assert not 0.0 <= motion.utc_s < 2.0**32
        return
    told, most = read(telegram), 3.4028e38
    assert told["numBytesDgm"] == len(telegram) == 132
    invalid = bits(told["status"])
    assert invalid <= {0, 1, 2, 3, 4, 5, 6, 19}
    assert 0 in invalid
    assert abs(told["time_sec"] + 1e-9 * told["time_nanosec"] - motion.utc_s) < 1e-6
    assert told["time_nanosec"] < 1_000_000_000

    is_worth = is_told(motion, spec_of(Telegram.KMB, settling=settling))
    has_heave = is_worth and abs(motion.heave_m) < most
    has_velocity = is_worth and abs(motion.heave_velocity_mps) < most
    assert single(told["heave_m"], motion.heave_m, is_known=has_heave)
    assert single(told["velDown"], motion.heave_velocity_mps, is_known=has_velocity)
    assert (3 in invalid) == (not (has_heave and has_velocity))
    assert (19 in invalid) == (has_heave and has_velocity and motion.state is not HeaveState.VALID)

    has_roll, has_pitch = abs(motion.roll_rad) <= pi, abs(motion.pitch_rad) <= pi
    assert single(told["roll_deg"], degrees(motion.roll_rad), is_known=has_roll)
    assert single(told["pitch_deg"], degrees(motion.pitch_rad), is_known=has_pitch)
    assert (1 in invalid) == (not (has_roll and has_pitch))
    assert (2 in invalid) == isnan(told["heading_deg"])
    if 2 in invalid:
        assert not abs(motion.yaw_rad) < 10_000.0
    else:
        off_deg = (told["heading_deg"] - degrees(motion.yaw_rad)) % 360.0
        assert min(off_deg, 360.0 - off_deg) < 1e-4

    level = (told["northAcceleration"], told["eastAcceleration"])
    if all(map(isfinite, level)):
        ahead = level[0] * cos(motion.yaw_rad) + level[1] * sin(motion.yaw_rad)
        scale = abs(motion.surge_acceleration_mps2) + abs(motion.sway_acceleration_mps2)
        assert ahead == pytest.approx(motion.surge_acceleration_mps2, abs=1e-6 * scale + 1e-30)
    assert (4 in invalid) == (not all(map(isfinite, (*level, told["downAcceleration"]))))

    for name, rate in {
        "rollRate": motion.roll_rate_radps,
        "pitchRate": motion.pitch_rate_radps,
        "yawRate": motion.yaw_rate_radps,
    }.items():
        assert single(told[name], degrees(rate), is_known=abs(degrees(rate)) < most)
    for name, std in {"rollError_deg": motion.roll_std_rad, "headingError_deg": motion.yaw_std_rad}.items():
        is_known = 0.0 <= degrees(std) < most
        assert told[name] == pytest.approx(degrees(std) if is_known else -1.0, rel=1e-6, abs=1e-30)

    assert (5 in invalid) == (6 in invalid) == isnan(told["late_delayedHeave_m"])
    if 5 not in invalid:
        assert motion.delayed is not None
        assert told["late_delayedHeave_m"] == pytest.approx(motion.delayed.heave_m, rel=1e-6, abs=1e-30)
        assert abs(told["late_time_sec"] + 1e-9 * told["late_time_nanosec"] - motion.delayed_utc_s) < 1e-6
    elif motion.delayed is not None:
        assert not (abs(motion.delayed.heave_m) < most and 0.0 <= motion.delayed_utc_s < 2.0**32)
