"""XDR, against NMEA 0183 and pynmea2."""

from __future__ import annotations

import string
from math import degrees, inf, nan, pi
from typing import Any

import msgspec
import pytest
from any_motion import KNOWN, assert_says, but, is_told, motions, spec_of, specs
from hypothesis import given
from hypothesis import strategies as st
from sentence_parsers import by_pynmea2, split

from heaved.outputs.motion import Motion
from heaved.outputs.telegrams.spec import OutputSpec, Telegram
from heaved.outputs.telegrams.xdr import FORMAT
from heaved.samples import HeaveState

SPEC = spec_of(Telegram.XDR)
LONG = ("A_NAME_OF_HEAVE_", "A_NAME_OF_PITCH_", "A_NAME_OF_ROLL_X")
NAMES = st.text(string.ascii_letters + string.digits + "_", min_size=1, max_size=16)


def transducers(sent: bytes) -> list[tuple[str, ...]]:
    """The groups of all sentences, in the order in which they come: type, value, unit, name."""
    groups: list[tuple[str, ...]] = []
    for _, *fields in split(sent):
        assert len(fields) % 4 == 0
        groups += zip(*[iter(fields)] * 4, strict=True)
    return groups


def test_it_is_one_sentence_of_three_transducers() -> None:
    """The checksum is by hand."""
    assert FORMAT.encode(KNOWN, SPEC) == b"$IIXDR,D,1.234,M,HEAVE,A,2.50,D,PTCH,A,-5.25,D,ROLL*08\r\n"


def test_an_independent_reader_has_the_motion() -> None:
    spec = spec_of(Telegram.XDR, talker="HC", transducers=["HEAVE", "PITCH", "ROLL"])

    (read,) = by_pynmea2(FORMAT.encode(KNOWN, spec))

    assert (read.talker, read.sentence_type, read.num_transducers) == ("HC", "XDR", 3)
    assert [(one.type, float(one.value), one.units, one.id) for one in (read.get_transducer(i) for i in range(3))] == [
        ("D", 1.234, "M", "HEAVE"),
        ("A", 2.5, "D", "PITCH"),
        ("A", -5.25, "D", "ROLL"),
    ]


@pytest.mark.parametrize(
    ("changed", "names"),
    [
        ({"heave_m": nan}, ["PTCH", "ROLL"]),
        ({"heave_m": -100.0}, ["PTCH", "ROLL"]),
        ({"state": HeaveState.INVALID}, ["PTCH", "ROLL"]),
        ({"pitch_rad": inf}, ["HEAVE", "ROLL"]),
        ({"roll_rad": nan, "pitch_rad": nan}, ["HEAVE"]),
        ({"state": HeaveState.DEGRADED}, ["HEAVE", "PTCH", "ROLL"]),
        ({"state": HeaveState.SETTLING}, ["HEAVE", "PTCH", "ROLL"]),
    ],
)
def test_what_is_not_known_is_left_out_with_its_name(changed: dict[str, Any], names: list[str]) -> None:
    assert [group[3] for group in transducers(FORMAT.encode(but(**changed), SPEC))] == names


def test_heave_that_settles_is_left_out_where_that_is_an_error() -> None:
    spec = spec_of(Telegram.XDR, settling="error")

    assert [group[3] for group in transducers(FORMAT.encode(but(state=HeaveState.SETTLING), spec))] == ["PTCH", "ROLL"]


@pytest.mark.parametrize("names", [SPEC.transducers, LONG])
def test_nothing_is_sent_of_nothing(names: tuple[str, ...]) -> None:
    nothing = Motion(utc_s=0.0, age_s=0.0, state=HeaveState.INVALID)

    assert FORMAT.encode(nothing, spec_of(Telegram.XDR, transducers=names)) == b""


@pytest.mark.parametrize("letters", [33, 34])
def test_three_names_that_do_not_fit_into_a_sentence_have_one_each(letters: int) -> None:
    names = ["H" * 15, "P" * 15, "R" * (letters - 30)]
    longest = but(heave_m=-98.765, pitch_rad=-pi / 2, roll_rad=-pi)

    sent = FORMAT.encode(longest, spec_of(Telegram.XDR, transducers=names))

    assert len(split(sent)) == (1 if letters == 33 else 3)
    assert [group[3] for group in transducers(sent)] == names
    if letters == 33:
        assert len(sent) == 82


def test_the_longest_is_as_long_as_it_says() -> None:
    longest = but(heave_m=-98.765, pitch_rad=-pi / 2, roll_rad=-pi)

    assert len(FORMAT.encode(longest, spec_of(Telegram.XDR, transducers=LONG))) == FORMAT.longest_bytes


@pytest.mark.parametrize("name", ["", "A,B", "ROLL*00", "ROLL\r\n$IIXDR", "$", "ÄNGLE", "SEVENTEEN_LETTERS", "ROLL\n"])
def test_a_name_that_would_end_a_field_or_a_sentence_is_refused(name: str) -> None:
    with pytest.raises(msgspec.ValidationError):
        spec_of(Telegram.XDR, transducers=["HEAVE", "PTCH", name])


@given(motions(), specs(Telegram.XDR, transducers=st.tuples(NAMES, NAMES, NAMES)))
def test_whatever_the_motion_each_transducer_says_it_or_is_not_there(motion: Motion, spec: OutputSpec) -> None:
    sent = FORMAT.encode(motion, spec)

    assert len(sent) <= FORMAT.longest_bytes
    assert all(len(line) <= 82 for line in sent.splitlines(keepends=True))
    assert all(fields[0] == "IIXDR" for fields in split(sent))
    groups = transducers(sent)
    for name, (kind, unit), value, step, largest in zip(
        spec.transducers,
        [("D", "M"), ("A", "D"), ("A", "D")],
        [motion.heave_m if is_told(motion, spec) else nan, degrees(motion.pitch_rad), degrees(motion.roll_rad)],
        [0.001, 0.01, 0.01],
        [99.0, 90.0, 180.0],
        strict=True,
    ):
        if abs(value) <= largest:
            told_kind, text, told_unit, told_name = groups.pop(0)
            assert (told_kind, told_unit, told_name) == (kind, unit, name)
            assert_says(text, value, step, largest)
    assert not groups
