"""PSXN 20, 23 and 24, against Kongsberg's description and pynmea2."""

from __future__ import annotations

from math import degrees, nan, pi, radians
from typing import Any

import pytest
from any_motion import KNOWN, assert_says, assert_says_heading, but, is_told, motions, spec_of, specs
from hypothesis import given
from sentence_parsers import by_pynmea2, split

from heaved.outputs.motion import Motion
from heaved.outputs.telegrams.psxn import FORMAT
from heaved.outputs.telegrams.spec import OutputSpec, Telegram, as_read
from heaved.samples import HeaveState

SPEC = spec_of(Telegram.PSXN)


def test_it_is_what_a_seapath_sent() -> None:
    """``$PSXN,20,0,0,0,0*3B`` and ``$PSXN,23,1.28,1.93,104.68,-0.24*18`` (NOAA NCEI 0086548): but for the quality of
    the position, which we do not have: 2 for 0, and so a checksum of 39. 24 is by hand.
    """
    motion = but(
        roll_rad=radians(1.28),
        pitch_rad=radians(1.93),
        yaw_rad=radians(104.68),
        heave_m=-0.24,
        heave_velocity_mps=0.5,
        roll_rate_radps=radians(-1.25),
        pitch_rate_radps=radians(0.5),
        yaw_rate_radps=0.0,
    )

    assert FORMAT.encode(motion, SPEC) == (
        b"$PSXN,20,2,0,0,0*39\r\n$PSXN,23,1.28,1.93,104.68,-0.24*18\r\n$PSXN,24,-1.25,0.50,0.00,0.50*14\r\n"
    )


def test_an_independent_reader_has_the_motion_with_heave_down() -> None:
    sent = FORMAT.encode(as_read(KNOWN, SPEC, FORMAT.signs), SPEC)

    quality, motion, rates = by_pynmea2(sent)

    assert [type(one).__name__ for one in (quality, motion, rates)] == ["SXN20", "SXN23", "SXN24"]
    assert (quality.horiz_qual, quality.hgt_qual, quality.head_qual, quality.rp_qual) == (2, 0, 0, 0)
    assert (motion.roll, motion.pitch, motion.head, motion.heave) == (-5.25, 2.5, 123.75, -1.23)
    assert (rates.pitch_rate, rates.yaw_rate, rates.vertical_vel) == (-1.5, 0.25, 0.56)
    assert rates.roll_rate == pytest.approx(3.125, abs=0.005001)


@pytest.mark.parametrize(
    ("changed", "quality"),
    [
        ({}, "2,0,0,0"),
        ({"state": HeaveState.DEGRADED}, "2,1,0,0"),
        ({"state": HeaveState.SETTLING}, "2,1,0,0"),
        ({"state": HeaveState.INVALID}, "2,2,0,0"),
        ({"heave_m": nan}, "2,2,0,0"),
        ({"heave_m": 1e5}, "2,2,0,0"),
        ({"heave_velocity_mps": nan}, "2,1,0,0"),
        ({"yaw_rad": nan}, "2,0,2,0"),
        ({"roll_rad": nan}, "2,0,0,2"),
        ({"pitch_rad": nan}, "2,0,0,2"),
        ({"roll_rad": 4.0}, "2,0,0,2"),
        ({"roll_rad": nan, "pitch_rad": nan, "yaw_rad": nan, "state": HeaveState.INVALID}, "2,2,2,2"),
    ],
)
def test_each_group_says_what_it_is_worth(changed: dict[str, Any], quality: str) -> None:
    first = split(FORMAT.encode(but(**changed), SPEC))[0]

    assert first == ["PSXN", "20", *quality.split(",")]


def test_what_is_not_known_is_empty_and_moves_nothing() -> None:
    nothing = Motion(utc_s=0.0, age_s=0.0, state=HeaveState.INVALID)

    assert split(FORMAT.encode(nothing, SPEC)) == [
        ["PSXN", "20", "2", "2", "2", "2"],
        ["PSXN", "23", "", "", "", ""],
        ["PSXN", "24", "", "", "", ""],
    ]


def test_heave_that_settles_is_invalid_and_withheld_where_that_is_an_error() -> None:
    spec = spec_of(Telegram.PSXN, settling="error")

    quality, motion, rates = split(FORMAT.encode(but(state=HeaveState.SETTLING), spec))

    assert (quality[3], motion[5], rates[5]) == ("2", "", "")
    assert (quality[4:], motion[2:5]) == (["0", "0"], ["-5.25", "2.50", "123.75"])


@given(motions(), specs(Telegram.PSXN))
def test_whatever_the_motion_each_field_says_it_or_is_empty(motion: Motion, spec: OutputSpec) -> None:
    sent = FORMAT.encode(motion, spec)

    quality, angles, rates = split(sent)
    assert len(sent) <= FORMAT.longest_bytes
    assert (quality[:3], angles[:2], rates[:2]) == (["PSXN", "20", "2"], ["PSXN", "23"], ["PSXN", "24"])
    told = is_told(motion, spec)
    assert_says(angles[2], degrees(motion.roll_rad), 0.01, 180.0)
    assert_says(angles[3], degrees(motion.pitch_rad), 0.01, 90.0)
    assert_says_heading(angles[4], motion.yaw_rad, 0.01)
    assert_says(angles[5], motion.heave_m if told else nan, 0.01, 99.0)
    assert_says(rates[2], degrees(motion.roll_rate_radps), 0.01, 999.0)
    assert_says(rates[3], degrees(motion.pitch_rate_radps), 0.01, 999.0)
    assert_says(rates[4], degrees(motion.yaw_rate_radps), 0.01, 999.0)
    assert_says(rates[5], motion.heave_velocity_mps if told else nan, 0.01, 99.0)
    assert (quality[3] == "2") is (angles[5] == "")
    assert (quality[3] == "0") <= (motion.state is HeaveState.VALID)
    assert (quality[4] == "2") is (angles[4] == "")
    assert (quality[5] == "2") is ("" in angles[2:4])


def test_the_longest_is_as_long_as_it_says_and_each_within_a_sentence() -> None:
    rates = dict.fromkeys(("roll_rate_radps", "pitch_rate_radps", "yaw_rate_radps"), radians(-998.0))

    sent = FORMAT.encode(but(roll_rad=-pi, pitch_rad=-pi / 2, heave_m=-99.0, heave_velocity_mps=-99.0, **rates), SPEC)

    assert len(sent) == FORMAT.longest_bytes
    assert all(len(line) <= 82 for line in sent.splitlines(keepends=True))
