"""Sentences of devices that speak by themselves. Oracle: the values that stand in them, and the checksum of NMEA 0183
worked out with functools; bytes in any pieces say the same.
"""

from functools import reduce
from itertools import pairwise
from math import radians

import msgspec
import pynmea2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heaved.devices.profile import Profile, Sentence, SentenceField, profile_faults
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
    "a sentence twice": (Profile(name="p", sentences=(BOX, BOX)), "sentence CRN is given twice"),
}


@pytest.mark.parametrize("name", WRONG)
def test_faults_of_a_profile_are_named(name: str) -> None:
    profile, words = WRONG[name]
    assert any(words in fault for fault in profile_faults(profile))


def test_a_value_stands_at_a_place_or_at_a_transducer() -> None:
    for keys in ({}, {"index": 1, "transducer": "ROLL"}):
        with pytest.raises(msgspec.ValidationError, match="index or transducer"):
            msgspec.convert({"quantity": "roll_rad", "unit": "deg", **keys}, SentenceField)
