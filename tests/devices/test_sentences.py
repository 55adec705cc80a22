"""Sentences of devices that speak by themselves. Oracle: the values that stand in them, and the checksum of NMEA 0183
worked out with functools; bytes in any pieces say the same.
"""

import tomllib
from functools import reduce
from itertools import pairwise
from math import radians
from pathlib import Path

import msgspec
import pynmea2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heaved.devices.profile import Condition, Profile, Sentence, SentenceField, profile_faults
from heaved.devices.sentences import MOST_BYTES, SentenceReader
from heaved.samples import Fault

XDR = Sentence(
    header="$--XDR",
    fields=(
        SentenceField(quantity="roll_rad", transducer="ROLL", unit="deg", min=-90.0, max=90.0),
        SentenceField(quantity="pitch_rad", transducer="PTCH", unit="deg", sign=-1),
    ),
)
BOX = Sentence(
    header="CRN",
    separator=";",
    fields=(
        SentenceField(quantity="heave_m", index=2, unit="m", scale=0.01, offset_value=1.0),
        SentenceField(quantity="speed_mps", index=4, unit="kn"),
    ),
)


FOLDER = Path(__file__).parents[2] / "config" / "devices"
TSS1, PASHR, PSXN = [
    msgspec.convert(tomllib.loads((FOLDER / f"{name}.toml").read_text()), Profile).sentences[0]
    for name in ("tss1", "pashr", "psxn23")
]
GOOD_TSS1 = b":05FEFF -0123H 0102 -0049\r\n"


def summed(body: str) -> bytes:
    return f"${body}*{reduce(lambda a, b: a ^ b, body.encode(), 0):02X}\r\n".encode()


def read(data: bytes, *sentences: Sentence) -> SentenceReader:
    reader = SentenceReader(sentences or (XDR, BOX))
    reader.feed(data)
    return reader


def test_values_by_their_transducer() -> None:
    (found,) = SentenceReader([XDR]).feed(summed("YXXDR,A,-1.5,D,PTCH,A,12.25,D,ROLL"))
    assert found.fault is Fault.NONE
    assert found.values == {"roll_rad": pytest.approx(radians(12.25)), "pitch_rad": pytest.approx(radians(1.5))}


def test_values_by_their_place() -> None:
    (found,) = SentenceReader([BOX]).feed(b"CRN;7;250;x;10\n")
    assert found.values == {"heave_m": pytest.approx(3.5), "speed_mps": pytest.approx(10.0 * 1852.0 / 3600.0)}


def test_what_an_independent_writer_makes() -> None:
    made = pynmea2.XDR("II", "XDR", ("A", "4.0", "D", "ROLL", "A", "-2.0", "D", "PTCH"))
    (found,) = SentenceReader([XDR]).feed((str(made) + "\r\n").encode())
    assert found.values == {"roll_rad": pytest.approx(radians(4.0)), "pitch_rad": pytest.approx(radians(2.0))}


FAULTS = {
    "a checksum that is wrong": (b"$YXXDR,A,1.0,D,ROLL*00\r\n", Fault.CRC, "its checksum is '00', not "),
    "a checksum that is cut": (summed("YXXDR,A,1.0,D,ROLL")[:-3] + b"\n", Fault.CRC, "check the line's cable"),
    "letters": (b"$YXXDR,A,one,D,ROLL\n", Fault.NOT_FINITE, "'one', which is no number"),
    "nan": (b"$YXXDR,A,nan,D,ROLL\n", Fault.NOT_FINITE, "no number"),
    "infinity": (b"$YXXDR,A,inf,D,ROLL\n", Fault.NOT_FINITE, "no number"),
    "more than a float holds": (b"$YXXDR,A,1e999,D,ROLL\n", Fault.NOT_FINITE, "no number"),
    "two points": (b"$YXXDR,A,1.2.3,D,ROLL\n", Fault.NOT_FINITE, "no number"),
    "what only Python reads": (b"$YXXDR,A,1_0,D,ROLL\n", Fault.NOT_FINITE, "no number"),
    "out of range": (b"$YXXDR,A,91.0,D,ROLL\n", Fault.OUT_OF_RANGE, "is 91, outside -90..90 deg"),
    "all of it empty": (b"$YXXDR,A,,D,ROLL\n", Fault.NOT_FINITE, "the sensor has no reading"),
    "nothing of what is wanted": (b"$YXXDR,C,19.5,C,AIR\n", Fault.NOT_FINITE, "nothing stands at transducer ROLL"),
    "the header alone": (b"$YXXDR\n", Fault.NOT_FINITE, "no reading"),
    "cut short": (b"$YXXDR,A,1.0,D\n", Fault.NOT_FINITE, "no reading"),
    "a terminal's escape": (b"$YXXDR,A,\x1b[2J,D,ROLL\n", Fault.NOT_FINITE, "\\x1b[2J"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_faulty_sentence_is_a_fault_and_no_value(name: str) -> None:
    data, fault, words = FAULTS[name]
    (found,) = SentenceReader([XDR]).feed(data)
    assert (found.fault, found.values) == (fault, {})
    assert words in found.detail
    assert found.detail.isprintable()


def test_one_value_is_enough() -> None:
    (found,) = SentenceReader([XDR]).feed(b"$YXXDR,A,,D,ROLL,A,3.0,D,PTCH\n")
    assert found.values == {"pitch_rad": pytest.approx(-radians(3.0))}


def test_a_checksum_may_be_required() -> None:
    strict = msgspec.structs.replace(XDR, checksum="required")
    (found,) = SentenceReader([strict]).feed(b"$YXXDR,A,1.0,D,ROLL\n")
    assert found.fault is Fault.CRC
    assert "it has no checksum" in found.detail


PASSED_OVER = {
    "other sentences": b"$GPGGA,1,2*33\r\n",
    "a header that is longer": b"$YXXDRS,A,1.0,D,ROLL\n",
    "a header that is shorter": b"$XDR,A,1.0,D,ROLL\n",
    "empty lines": b"\r\n\r\n\n",
    "a line that never ends": b"A" * (3 * MOST_BYTES) + b"\n",
    "binary": bytes(range(256)).replace(b"\n", b"").replace(b"\r", b"") + b"\n",
}


@pytest.mark.parametrize("name", PASSED_OVER)
def test_what_is_no_sentence_of_the_profile_is_passed_over(name: str) -> None:
    reader = SentenceReader([XDR, BOX])
    assert reader.feed(PASSED_OVER[name]) == []
    (found,) = reader.feed(b"CRN;7;250;x;\n")
    assert found.values == {"heave_m": pytest.approx(3.5)}


def test_what_else_is_heard_is_told() -> None:
    assert read(b"$GPGGA,1\n$GPGGA,2\n$GPVTG,1\n\x1b]0;x,1\n").heard() == "$GPGGA, $GPVTG, \\x1b]0;x"


def test_many_other_headers_take_no_memory() -> None:
    reader = read(b"".join(b"$X%d,1\n" % i for i in range(5000)))
    assert len(reader.others) <= 8


@given(st.lists(st.integers(0, 200), max_size=20))
def test_the_pieces_in_which_bytes_come_do_not_matter(cuts: list[int]) -> None:
    data = summed("YXXDR,A,5.0,D,ROLL") + b"$GPGGA,1\r\nCRN;7;250;x;10\r" + b"\xff\xfe\n" + summed("IIXDR,A,1.0,D,PTCH")
    whole = SentenceReader([XDR, BOX]).feed(data)
    reader = SentenceReader([XDR, BOX])
    places = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    assert [one for a, b in pairwise(places) for one in reader.feed(data[a:b])] == whole
    assert len(whole) == 3


@given(st.binary(max_size=700))
def test_no_bytes_are_an_error(data: bytes) -> None:
    reader = SentenceReader([XDR, BOX])
    for one in reader.feed(data) + reader.datagram(data):
        assert bool(one.values) == (one.fault is Fault.NONE)


# ---- lines of fixed columns, and what a sentence says of its own worth -----------------------------------------------

COLUMNS = {
    "cut at its end": (GOOD_TSS1[:-4] + b"\n", Fault.LENGTH, "23 characters instead of 25"),
    "two that were merged": (GOOD_TSS1[:-2] + GOOD_TSS1, Fault.LENGTH, "50 characters instead of 25"),
    "a cut one before a whole one": (GOOD_TSS1[:13] + GOOD_TSS1, Fault.LENGTH, "38 characters instead of 25"),
    "a character lost within": (GOOD_TSS1[:10] + GOOD_TSS1[11:], Fault.LENGTH, "24 characters"),
    "a letter in the heave": (GOOD_TSS1.replace(b"-0123", b"-01O3"), Fault.NOT_FINITE, "'-01O3', which is no number"),
    "a sign in the middle": (GOOD_TSS1.replace(b"-0123", b"0-123"), Fault.NOT_FINITE, "no number"),
    "bytes of another speed": (b":" + bytes(range(128, 152)) + b"\r\n", Fault.LENGTH, "characters instead of 25"),
    "settling": (GOOD_TSS1.replace(b"H", b"h"), Fault.NOT_FINITE, "column 14 is 'h', not 'U' or 'G'"),
    "a letter that nobody defines": (GOOD_TSS1.replace(b"H", b"X"), Fault.NOT_FINITE, "column 14 is 'X'"),
    "no letter": (GOOD_TSS1.replace(b"H", b" "), Fault.NOT_FINITE, "column 14 is ''"),
    "nothing but a letter": (b":              H          ".replace(b"  H", b"H") + b" \r\n", Fault.NOT_FINITE, ""),
    "more than the format's most": (GOOD_TSS1.replace(b"-0123", b" 9999"), Fault.OUT_OF_RANGE, "is 99.99, outside"),
}


@pytest.mark.parametrize("name", COLUMNS)
def test_a_faulty_line_of_fixed_columns_is_a_fault(name: str) -> None:
    data, fault, words = COLUMNS[name]
    (found,) = SentenceReader([TSS1]).feed(data)
    assert (found.fault, found.values) == (fault, {})
    assert words in found.detail
    assert found.detail.isprintable()


def test_after_a_faulty_line_the_next_is_read() -> None:
    for data, _, _ in COLUMNS.values():
        found = SentenceReader([TSS1]).feed(data + GOOD_TSS1)[-1]
        assert found.values["heave_m"] == pytest.approx(-1.23)


@given(st.binary(max_size=200), st.lists(st.integers(0, 400), max_size=8))
def test_garbage_around_a_line_changes_nothing_of_it(garbage: bytes, cuts: list[int]) -> None:
    data = garbage + b"\r\n" + GOOD_TSS1 + garbage + b"\n"
    reader = SentenceReader([TSS1, PASHR])
    places = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    found = [one for a, b in pairwise(places) for one in reader.feed(data[a:b])]
    assert any(one.values.get("pitch_rad") == pytest.approx(radians(-0.49)) for one in found)
    assert all(bool(one.values) == (one.fault is Fault.NONE) for one in found)


@given(
    heave_cm=st.integers(-9998, 9998), roll=st.integers(-9000, 9000), pitch=st.integers(-9000, 9000),
    letter=st.sampled_from("UuGgHhFf?"), level=st.integers(0, 255), up=st.integers(0, 65535), small=st.booleans(),
)  # fmt: skip
def test_any_tss1(heave_cm: int, roll: int, pitch: int, letter: str, level: int, up: int, small: bool) -> None:
    def told(number: int) -> str:
        return f"{'-' if number < 0 else ' '}{abs(number):04d}"

    accelerations = f"{level:02X}{up:04X}"
    accelerations = accelerations.lower() if small else accelerations
    line = f":{accelerations} {told(heave_cm)}{letter}{told(roll)} {told(pitch)}\r\n"
    assert len(line) == 27
    (found,) = SentenceReader([TSS1]).feed(line.encode())
    if letter.islower():
        assert found.values == {}
        return
    expected = {"roll_rad": radians(roll / 100), "pitch_rad": radians(pitch / 100)}
    if letter != "?":
        expected["heave_m"] = heave_cm / 100
    assert found.values == {name: pytest.approx(value, abs=1e-12) for name, value in expected.items()}


def test_a_sentence_named_by_its_second_value() -> None:
    data = summed("PSXN,20,2,0,0,0") + summed("PSXN,23,1.50,-0.76,330.56,0.11") + summed("PSXN,24,0.1,0.2,0.3,0.4")
    reader = SentenceReader([PSXN])
    (found,) = reader.feed(data)
    assert found.values["roll_rad"] == pytest.approx(radians(1.5))
    assert reader.heard() == "$PSXN"


def test_pashr_as_an_independent_reader_has_it() -> None:
    line = summed("PASHR,085335.000,224.19,T,-1.26,+0.83,+0.52,0.101,0.113,0.267,1,1")
    read_by_others = pynmea2.parse(line.decode().strip())
    (found,) = SentenceReader([PASHR]).feed(line)
    assert found.values == {
        "heave_m": pytest.approx(float(read_by_others.heave)),
        "roll_rad": pytest.approx(radians(float(read_by_others.roll))),
        "pitch_rad": pytest.approx(radians(float(read_by_others.pitch))),
        "yaw_rad": pytest.approx(radians(float(read_by_others.true_heading))),
    }


def test_a_condition_may_be_of_one_quantity() -> None:
    careful = msgspec.structs.replace(PASHR, conditions=(*PASHR.conditions, Condition(index=11, one_of=("1",))))
    (found,) = SentenceReader([careful]).feed(summed("PASHR,,224.19,T,-1.26,+0.83,+0.52,,,,1,0"))
    assert found.fault is Fault.NOT_FINITE
    assert "value 11 is '0', not '1'" in found.detail


def test_a_datagram_is_whole() -> None:
    reader = SentenceReader([XDR])
    reader.feed(b"$YXXDR,A,9")
    (found,) = reader.datagram(b"$YXXDR,A,2.0,D,ROLL")
    assert found.values == {"roll_rad": pytest.approx(radians(2.0))}


LONG_ROLL = SentenceField(quantity="roll_rad", index=1, unit="m")
WRONG = {
    "neither blocks nor sentences": (Profile(name="p"), "has neither blocks nor sentences"),
    "a unit of another kind": (
        Profile(name="p", sentences=(Sentence(header="A", fields=(LONG_ROLL,)),)),
        "measures length, not angle",
    ),
    "a quantity twice": (
        Profile(name="p", sentences=(Sentence(header="A", fields=(BOX.fields[0], BOX.fields[0])),)),
        "heave_m is given twice",
    ),
    "a condition of what no field gives": (
        Profile(
            name="p",
            sentences=(
                msgspec.structs.replace(BOX, conditions=(Condition(index=1, one_of=("A",), quantities=("roll_rad",)),)),
            ),
        ),
        "a condition is of roll_rad, which no field gives",
    ),
    "a sentence twice": (Profile(name="p", sentences=(BOX, BOX)), "sentence CRN is given twice"),
}


@pytest.mark.parametrize("name", WRONG)
def test_faults_of_a_profile_are_named(name: str) -> None:
    profile, words = WRONG[name]
    assert any(words in fault for fault in profile_faults(profile))


def test_a_value_stands_at_a_place_or_at_a_transducer() -> None:
    for keys in ({}, {"index": 1, "transducer": "ROLL"}):
        with pytest.raises(msgspec.ValidationError, match="index, columns or transducer"):
            msgspec.convert({"quantity": "roll_rad", "unit": "deg", **keys}, SentenceField)
