"""Checksum, numbers, headings and times of the sentences."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from math import inf, nan, pi, radians
from typing import TYPE_CHECKING

import pytest
from any_motion import NOON_UTC_S, but, motions, spec_of
from hypothesis import given
from hypothesis import strategies as st
from sentence_parsers import by_pynmea2

from heaved.outputs.telegrams import pashr, prdid, psxn, xdr
from heaved.outputs.telegrams.known import tells_heave
from heaved.outputs.telegrams.nmea import checksum, heading, number, sentence, time_of_day
from heaved.outputs.telegrams.spec import Format, Telegram
from heaved.samples import HeaveState

if TYPE_CHECKING:
    from heaved.outputs.motion import Motion

MIDNIGHT_UTC_S = NOON_UTC_S + 43_200.0


@pytest.mark.parametrize(
    ("printed", "by"),
    [
        (b"$PASHR,163029.000,158.09,T,-0.30,+0.31,+0.01,0.029,0.029,0.059,1,1*3B", "NovAtel, OEM7, PASHR"),
        (b"$PSXN,20,0,0,0,0*3B", "a Seapath 320+"),
        (b"$PSXN,23,1.28,1.93,104.68,-0.24*18", "a Seapath 320+"),
        (b"$GPHDT,104.68,T*0E", "a Seapath 320+"),
    ],
)
def test_the_checksum_is_that_of_what_makers_printed_and_recorded(printed: bytes, by: str) -> None:
    assert sentence(printed[1:-3].decode()) == printed + b"\r\n"


def test_a_checksum_has_two_digits() -> None:
    assert checksum(b"AA") == 0
    assert sentence("AA") == b"$AA*00\r\n"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "+0.00"),
        (-0.0, "+0.00"),
        (-0.0049, "+0.00"),
        (-0.0051, "-0.01"),
        (99.0, "+99.00"),
        (99.01, ""),
        (-99.01, ""),
        (1e300, ""),
        (inf, ""),
        (-inf, ""),
        (nan, ""),
    ],
)
def test_a_number_has_its_width_or_is_empty_and_nothing_has_no_minus(value: float, text: str) -> None:
    assert number(value, "+z.2f", 99.0) == text


@pytest.mark.parametrize(
    ("yaw_deg", "text"),
    [
        (0.0, "000.00"),
        (-0.0, "000.00"),
        (-1e-18, "000.00"),
        (359.994, "359.99"),
        (359.996, "000.00"),
        (360.0, "000.00"),
        (-90.0, "270.00"),
        (725.5, "005.50"),
        (-0.004, "000.00"),
        (36.0, "036.00"),
        (1e15, ""),
        (inf, ""),
        (-inf, ""),
        (nan, ""),
    ],
)
def test_a_heading_is_on_the_circle_and_never_360(yaw_deg: float, text: str) -> None:
    assert heading(radians(yaw_deg), "z06.2f") == text


def test_a_heading_without_leading_zeros_is_not_taken_for_a_full_circle() -> None:
    assert heading(radians(36.0), "z.2f") == "36.00"
    assert heading(2.0 * pi - 1e-9, "z.2f") == "0.00"


@pytest.mark.parametrize(
    ("utc_s", "text"),
    [
        (0.0, "000000.000"),
        (NOON_UTC_S, "120000.000"),
        (NOON_UTC_S + 59.9994, "120059.999"),
        (NOON_UTC_S + 59.9996, "120100.000"),
        (NOON_UTC_S + 3599.9996, "130000.000"),
        (MIDNIGHT_UTC_S - 0.0006, "235959.999"),
        (MIDNIGHT_UTC_S - 0.0004, "000000.000"),
        (-1.0, ""),
        (1e300, ""),
        (inf, ""),
        (nan, ""),
    ],
)
def test_a_time_is_rounded_over_the_minute_and_over_midnight(utc_s: float, text: str) -> None:
    assert time_of_day(utc_s) == text


@given(st.integers(0, 4_000_000_000_000))
def test_a_time_is_that_of_the_calendar(ms: int) -> None:
    then = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(milliseconds=ms)

    assert time_of_day(ms / 1e3) == then.strftime("%H%M%S.%f")[:-3]


@pytest.mark.parametrize("settling", ["degraded", "error"])
@pytest.mark.parametrize("state", HeaveState)
def test_heave_is_told_unless_it_is_invalid_or_settles_and_that_is_an_error(state: HeaveState, settling: str) -> None:
    spec = spec_of(Telegram.PASHR, settling=settling)

    withheld = [HeaveState.INVALID, HeaveState.SETTLING] if settling == "error" else [HeaveState.INVALID]
    assert tells_heave(but(state=state), spec) is (state not in withheld)


@pytest.mark.parametrize(
    ("form", "telegram", "sentences"),
    [
        (pashr.FORMAT, Telegram.PASHR, {1}),
        (psxn.FORMAT, Telegram.PSXN, {3}),
        (prdid.FORMAT, Telegram.PRDID, {1}),
        (xdr.FORMAT, Telegram.XDR, {0, 1}),
    ],
    ids=lambda value: value.title if isinstance(value, Format) else "",
)
@given(motion=motions())
def test_an_independent_reader_takes_whatever_is_sent(
    form: Format, telegram: Telegram, sentences: set[int], motion: Motion
) -> None:
    assert len(by_pynmea2(form.encode(motion, spec_of(telegram)))) in sentences
