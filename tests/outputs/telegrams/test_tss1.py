"""TSS1. Oracle: telegrams that makers print, and a reader written from their descriptions."""

from __future__ import annotations

from math import asin, cos, degrees, hypot, inf, nan, radians, sin

import msgspec
import pytest
from any_motion import is_told, motions, says, spec_of
from hypothesis import given
from hypothesis import strategies as st
from telegram_parsers import parse_tss1

from heaved.outputs.motion import Lead, Motion
from heaved.outputs.telegrams.spec import RollConvention, Settling, Telegram, as_read
from heaved.outputs.telegrams.tss1 import FORMAT, encode
from heaved.samples import HeaveState

SPEC = spec_of(Telegram.TSS1)
GOOD = Motion(
    utc_s=1.7e9, age_s=0.01, state=HeaveState.VALID, heave_m=1.5, heave_acceleration_mps2=0.0,
    surge_acceleration_mps2=0.0, sway_acceleration_mps2=0.0, roll_rad=radians(2.0), pitch_rad=radians(-3.0),
)  # fmt: skip


# The letter tells what aids the maker's own heave; nothing aids ours, so that it is the U of the same case.
@pytest.mark.parametrize(
    ("printed", "letter", "level_mps2", "up_mps2", "heave_m", "roll_deg", "pitch_deg"),
    [
        (b":000064 -0003U 0007 -0056\r\n", b"U", 0.0, 0.0625, -0.03, 0.07, -0.56),  # Seatex MRU of USCGC Healy, NCEI
        (b":00FFCA -0003F-0325  0319\r\n", b"U", 0.0, -0.03375, -0.03, -3.25, 3.19),  # NovAtel
        (b":05FEFF  0000H 0102 -0049\r\n", b"U", 0.1915, -0.160625, 0.0, 1.02, -0.49),  # SMC
        (b":1A4770 -0016H 0429 -0680\r\n", b"U", 0.9958, 11.43, -0.16, 4.29, -6.80),  # SBG
        (b":053C22  0000f-0046 -0563\r\n", b"u", 0.1915, 9.62125, 0.0, -0.46, -5.63),  # CodaOctopus
    ],
)
def test_what_makers_print(
    printed: bytes, letter: bytes, level_mps2: float, up_mps2: float, heave_m: float, roll_deg: float, pitch_deg: float
) -> None:
    motion = Motion(
        utc_s=1.7e9,
        age_s=0.01,
        state=HeaveState.VALID if letter == b"U" else HeaveState.SETTLING,
        heave_m=heave_m,
        heave_acceleration_mps2=up_mps2,
        surge_acceleration_mps2=-0.6 * level_mps2,
        sway_acceleration_mps2=0.8 * level_mps2,
        roll_rad=radians(roll_deg),
        pitch_rad=radians(pitch_deg),
    )
    assert encode(motion, SPEC) == printed[:13] + letter + printed[14:]


@pytest.mark.parametrize(
    ("changed", "settling", "telegram"),
    [
        ({}, Settling.DEGRADED, b":000000  0150U 0200 -0300\r\n"),
        ({"state": HeaveState.DEGRADED}, Settling.DEGRADED, b":000000  0150U 0200 -0300\r\n"),
        ({"state": HeaveState.SETTLING}, Settling.DEGRADED, b":000000  0150u 0200 -0300\r\n"),
        ({"state": HeaveState.SETTLING}, Settling.ERROR, b":008000  9999? 0200 -0300\r\n"),
        ({"state": HeaveState.INVALID}, Settling.DEGRADED, b":008000  9999? 0200 -0300\r\n"),
        ({"heave_m": nan}, Settling.DEGRADED, b":000000  9999? 0200 -0300\r\n"),
        ({"heave_m": -99.984}, Settling.DEGRADED, b":000000 -9998U 0200 -0300\r\n"),
        ({"heave_m": -99.99}, Settling.DEGRADED, b":000000  9999? 0200 -0300\r\n"),
        ({"heave_m": 312.0}, Settling.DEGRADED, b":000000  9999? 0200 -0300\r\n"),
        ({"heave_m": -0.004}, Settling.DEGRADED, b":000000  0000U 0200 -0300\r\n"),
        ({"roll_rad": nan}, Settling.DEGRADED, b":000000  0150u 9999 -0300\r\n"),
        ({"pitch_rad": inf}, Settling.DEGRADED, b":000000  0150u 0200  9999\r\n"),
        ({"pitch_rad": nan, "heave_m": nan}, Settling.DEGRADED, b":000000  9999u 0200  9999\r\n"),
        ({"sway_acceleration_mps2": nan}, Settling.DEGRADED, b":FF0000  0150U 0200 -0300\r\n"),
        ({"surge_acceleration_mps2": -9.72}, Settling.DEGRADED, b":FE0000  0150U 0200 -0300\r\n"),
        ({"surge_acceleration_mps2": 40.0}, Settling.DEGRADED, b":FF0000  0150U 0200 -0300\r\n"),
        ({"heave_acceleration_mps2": nan}, Settling.DEGRADED, b":008000  0150U 0200 -0300\r\n"),
        ({"heave_acceleration_mps2": 20.479375}, Settling.DEGRADED, b":007FFF  0150U 0200 -0300\r\n"),
        ({"heave_acceleration_mps2": -20.479375}, Settling.DEGRADED, b":008001  0150U 0200 -0300\r\n"),
        ({"heave_acceleration_mps2": 25.0}, Settling.DEGRADED, b":008000  0150U 0200 -0300\r\n"),
    ],
)
def test_what_is_not_known_or_does_not_fit(changed: dict[str, object], settling: Settling, telegram: bytes) -> None:
    assert encode(msgspec.structs.replace(GOOD, **changed), spec_of(Telegram.TSS1, settling=settling)) == telegram


def test_roll_is_the_elevation_of_the_transverse_axis_unless_the_output_says_otherwise() -> None:
    roll, pitch = radians(30.0), radians(20.0)
    motion = msgspec.structs.replace(GOOD, roll_rad=roll, pitch_rad=pitch)
    told = parse_tss1(encode(as_read(motion, SPEC, FORMAT.signs), SPEC))
    # The transverse axis is tilted by the roll in its own plane, which is then tilted by the pitch.
    across, up = cos(roll), sin(roll) * cos(pitch)
    along = sin(roll) * sin(pitch)
    assert hypot(across, up, along) == pytest.approx(1.0)
    assert told.roll_deg == pytest.approx(degrees(asin(up)), abs=0.005)
    assert told.pitch_deg == 20.0
    euler = msgspec.structs.replace(SPEC, roll_convention=RollConvention.TAIT_BRYAN)
    assert parse_tss1(encode(as_read(motion, euler, FORMAT.signs), euler)).roll_deg == 30.0


def test_it_is_for_the_moment_of_transmission_and_at_most_25_times_a_second() -> None:
    assert FORMAT.lead is Lead.TRANSMISSION
    assert FORMAT.most_hz == 25.0


@given(motions(), st.sampled_from(Settling))
def test_a_reader_gets_the_motion_or_is_told_that_it_is_not_known(motion: Motion, settling: Settling) -> None:
    telegram = encode(motion, spec_of(Telegram.TSS1, settling=settling))
    assert len(telegram) == FORMAT.longest_bytes == 27
    told = parse_tss1(telegram)
    is_worth = is_told(motion, spec_of(Telegram.TSS1, settling=settling))
    assert says(told.heave_m, motion.heave_m if is_worth else nan, 99.98, 0.005)
    assert says(told.up_mps2, motion.heave_acceleration_mps2 if is_worth else nan, 20.479, 0.0003125)
    level_mps2 = hypot(motion.surge_acceleration_mps2, motion.sway_acceleration_mps2)
    assert says(told.level_mps2, level_mps2, 9.72, 0.01915)
    assert says(told.roll_deg, degrees(motion.roll_rad), 90.0, 0.005)
    assert says(told.pitch_deg, degrees(motion.pitch_rad), 90.0, 0.005)
    has_attitude = told.roll_deg is not None and told.pitch_deg is not None
    if told.letter == "U":
        assert motion.state in (HeaveState.VALID, HeaveState.DEGRADED)
    assert (told.letter == "?") == (has_attitude and told.heave_m is None)
    assert (told.letter == "U") <= (has_attitude and told.heave_m is not None)
