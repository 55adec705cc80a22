"""PRDID, against its makers' descriptions and pynmea2."""

from __future__ import annotations

from math import degrees, inf, nan, pi, radians
from typing import TYPE_CHECKING, Any

import pytest
from any_motion import KNOWN, assert_says, assert_says_heading, but, motions, spec_of, specs
from hypothesis import given
from sentence_parsers import by_pynmea2, only

from heaved.outputs.telegrams.prdid import FORMAT
from heaved.outputs.telegrams.spec import OutputSpec, Telegram, as_read

if TYPE_CHECKING:
    from heaved.outputs.motion import Motion

SPEC = spec_of(Telegram.PRDID)


def test_it_is_the_example_of_a_maker() -> None:
    """Norwegian Subsea prints ``$PRDID,-000.19,+000.04,158.32``; the checksum, which it leaves out, is by hand."""
    motion = but(pitch_rad=radians(-0.19), roll_rad=radians(0.04), yaw_rad=radians(158.32))

    assert FORMAT.encode(motion, SPEC) == b"$PRDID,-000.19,+000.04,158.32*7E\r\n"


def test_an_independent_reader_has_the_motion() -> None:
    (read,) = by_pynmea2(FORMAT.encode(KNOWN, SPEC))

    assert type(read).__name__ == "RDID"
    assert (read.pitch, read.roll, read.heading) == (2.5, -5.25, 123.75)


def test_the_string_of_tss_differs_in_roll_alone() -> None:
    """At 60 degrees of pitch, a roll of 30 lifts the transverse axis by asin(0.25), 14.48 degrees."""
    steep = but(roll_rad=radians(30.0), pitch_rad=radians(60.0))
    spec = spec_of(Telegram.PRDID, roll_convention="tss")

    assert only(FORMAT.encode(as_read(steep, SPEC, FORMAT.signs), SPEC))[1:3] == ["+060.00", "+030.00"]
    assert only(FORMAT.encode(as_read(steep, spec, FORMAT.signs), spec))[1:3] == ["+060.00", "+014.48"]


@pytest.mark.parametrize(
    ("changed", "fields"),
    [
        ({"pitch_rad": nan}, ["", "-005.25", "123.75"]),
        ({"pitch_rad": 2.0}, ["", "-005.25", "123.75"]),
        ({"roll_rad": inf}, ["+002.50", "", "123.75"]),
        ({"yaw_rad": nan}, ["+002.50", "-005.25", ""]),
        ({"roll_rad": -1e-9, "yaw_rad": -1e-9}, ["+002.50", "+000.00", "000.00"]),
    ],
)
def test_what_is_not_known_is_empty_and_moves_nothing(changed: dict[str, Any], fields: list[str]) -> None:
    assert only(FORMAT.encode(but(**changed), SPEC)) == ["PRDID", *fields]


@given(motions(), specs(Telegram.PRDID))
def test_whatever_the_motion_each_field_says_it_or_is_empty(motion: Motion, spec: OutputSpec) -> None:
    sent = FORMAT.encode(motion, spec)

    address, pitch, roll, yaw = only(sent)
    assert address == "PRDID"
    assert len(sent) <= FORMAT.longest_bytes
    assert_says(pitch, degrees(motion.pitch_rad), 0.01, 90.0)
    assert_says(roll, degrees(motion.roll_rad), 0.01, 180.0)
    assert_says_heading(yaw, motion.yaw_rad, 0.01)
    assert {len(pitch), len(roll)} <= {0, 7}
    assert len(yaw) in (0, 6)


def test_the_longest_is_as_long_as_it_says() -> None:
    assert len(FORMAT.encode(but(roll_rad=-pi), SPEC)) == FORMAT.longest_bytes
