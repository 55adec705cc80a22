"""PASHR, against its makers' descriptions and pynmea2."""

from __future__ import annotations

from math import degrees, inf, nan, pi, radians
from typing import Any

import pytest
from any_motion import KNOWN, NOON_UTC_S, assert_says, assert_says_heading, but, is_told, motions, spec_of, specs
from hypothesis import given
from sentence_parsers import by_pynmea2, only

from heaved.outputs.motion import Motion
from heaved.outputs.telegrams.pashr import FORMAT
from heaved.outputs.telegrams.spec import OutputSpec, Telegram
from heaved.samples import HeaveState

SPEC = spec_of(Telegram.PASHR)


def test_it_is_the_example_of_a_maker() -> None:
    """NovAtel prints ``$PASHR,163029.000,158.09,T,-0.30,+0.31,+0.01,0.029,0.029,0.059,1,1*3B``: but for the quality of
    the satellite fix, which we do not have, and the checksum, in which that changes one bit.
    """
    motion = Motion(
        utc_s=NOON_UTC_S + 4.5 * 3600.0 + 29.0,
        age_s=0.0,
        state=HeaveState.VALID,
        yaw_rad=radians(158.09),
        roll_rad=radians(-0.30),
        pitch_rad=radians(0.31),
        heave_m=0.01,
        roll_std_rad=radians(0.029),
        pitch_std_rad=radians(0.029),
        yaw_std_rad=radians(0.059),
    )

    sent = FORMAT.encode(motion, SPEC)

    assert sent == b"$PASHR,163029.000,158.09,T,-0.30,+0.31,+0.01,0.029,0.029,0.059,0,1*3A\r\n"


def test_an_independent_reader_has_the_motion() -> None:
    (read,) = by_pynmea2(FORMAT.encode(KNOWN, SPEC))

    assert type(read).__name__ == "ASHRATT"
    assert read.timestamp.isoformat() == "12:00:12.345000+00:00"
    assert (read.true_heading, read.is_true_heading) == (123.75, "T")
    assert (read.roll, read.pitch, read.heave) == (-5.25, 2.5, 1.23)
    assert (read.roll_accuracy, read.pitch_accuracy, read.heading_accuracy) == (0.021, 0.034, 1.5)
    assert (read.aiding_status, read.imu_status) == (0, 1)


@pytest.mark.parametrize(
    ("good", "valid", "degraded", "settling", "invalid"),
    [
        (1, "1", "0", "0", "0"),
        (0, "0", "1", "1", "1"),
        (2, "2", "0", "0", "0"),
        (3, "3", "2", "1", "0"),
        (4, "4", "2", "1", "0"),
    ],
)
def test_the_status_is_good_for_valid_heave_alone(
    good: int, valid: str, degraded: str, settling: str, invalid: str
) -> None:
    spec = spec_of(Telegram.PASHR, ins_good=good)
    by_state = {
        HeaveState.VALID: valid,
        HeaveState.DEGRADED: degraded,
        HeaveState.SETTLING: settling,
        HeaveState.INVALID: invalid,
    }

    assert {state: only(FORMAT.encode(but(state=state), spec))[11] for state in HeaveState} == by_state
    for unknown in ("heave_m", "roll_rad", "pitch_rad"):
        assert only(FORMAT.encode(but(**{unknown: nan}), spec))[11] == invalid


@pytest.mark.parametrize(
    ("changed", "at"),
    [
        ({"utc_s": nan}, 1),
        ({"yaw_rad": nan}, 2),
        ({"roll_rad": nan}, 4),
        ({"roll_rad": 1.001 * pi}, 4),
        ({"pitch_rad": -inf}, 5),
        ({"pitch_rad": 0.501 * pi}, 5),
        ({"heave_m": nan}, 6),
        ({"heave_m": -123.4}, 6),
        ({"state": HeaveState.INVALID}, 6),
        ({"roll_std_rad": nan}, 7),
        ({"pitch_std_rad": 2.0}, 8),
        ({"yaw_std_rad": -0.1}, 9),
    ],
)
def test_what_is_not_known_or_has_no_place_is_empty_and_moves_nothing(changed: dict[str, Any], at: int) -> None:
    known = only(FORMAT.encode(KNOWN, SPEC))

    fields = only(FORMAT.encode(but(**changed), SPEC))

    assert fields[at] == ""
    assert [field for i, field in enumerate(fields) if i not in (at, 11)] == [
        field for i, field in enumerate(known) if i not in (at, 11)
    ]


def test_nothing_is_written_without_a_minus() -> None:
    names = ("roll_rad", "pitch_rad", "yaw_rad", "heave_m", "roll_std_rad", "pitch_std_rad", "yaw_std_rad")

    fields = only(FORMAT.encode(but(**dict.fromkeys(names, -0.0)), SPEC))

    assert fields[2:10] == ["000.00", "T", "+0.00", "+0.00", "+0.00", "0.000", "0.000", "0.000"]


def test_heave_that_settles_is_withheld_where_that_is_an_error() -> None:
    settling = but(state=HeaveState.SETTLING)

    assert only(FORMAT.encode(settling, SPEC))[6] == "+1.23"
    assert only(FORMAT.encode(settling, spec_of(Telegram.PASHR, settling="error")))[6] == ""


@given(motions(), specs(Telegram.PASHR))
def test_whatever_the_motion_each_field_says_it_or_is_empty(motion: Motion, spec: OutputSpec) -> None:
    sent = FORMAT.encode(motion, spec)

    address, _, yaw, true, roll, pitch, heave, *stds, fix, status = only(sent)
    assert len(sent) <= FORMAT.longest_bytes
    assert (address, true, fix) == ("PASHR", "T", "0")
    assert_says_heading(yaw, motion.yaw_rad, 0.01)
    assert_says(roll, degrees(motion.roll_rad), 0.01, 180.0)
    assert_says(pitch, degrees(motion.pitch_rad), 0.01, 90.0)
    assert_says(heave, motion.heave_m if is_told(motion, spec) else nan, 0.01, 99.0)
    for text, std_rad in zip(stds, (motion.roll_std_rad, motion.pitch_std_rad, motion.yaw_std_rad), strict=True):
        assert_says(text, degrees(std_rad) if std_rad >= 0.0 else nan, 0.001, 99.0)
    assert all(text[0] in "+-" for text in (roll, pitch, heave) if text)
    all_well = motion.state is HeaveState.VALID and bool(roll and pitch and heave)
    assert (status == str(spec.ins_good)) is all_well


def test_the_longest_is_as_long_as_it_says_and_within_a_sentence() -> None:
    stds = dict.fromkeys(("roll_std_rad", "pitch_std_rad", "yaw_std_rad"), radians(98.0))

    sent = FORMAT.encode(but(roll_rad=-pi, pitch_rad=-pi / 2, heave_m=-99.0, **stds), SPEC)

    assert len(sent) == FORMAT.longest_bytes <= 82
