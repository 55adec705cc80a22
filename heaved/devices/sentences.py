"""Sentences of devices that speak by themselves: lines of text with a header and values between separators. Pure.

``$--XDR,A,231.5,D,SLEW,A,62.1,D,BOOM*hh`` of NMEA 0183 is one, and so is what a crane's encoder box makes up by itself.
A profile says what stands where; ``*hh`` at the end is the checksum of NMEA 0183 (exclusive or of all between ``$`` and
``*``), which must be right where there is one. Lines of fixed columns, as TSS1 has them, have none: they must have
their length, and numbers where numbers belong.
"""

from __future__ import annotations

from collections import Counter
from math import isfinite
from typing import TYPE_CHECKING, Final

from heaved.devices.profile import SI, Condition, Decoded, Quantity, Sentence, SentenceField
from heaved.samples import Fault
from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Sequence

MOST_BYTES: Final = 512
"""Of a line: longer is no sentence. NMEA 0183 allows 82."""
_MOST_HEARD: Final = 8
"""Other headers that are remembered, to tell whoever has configured the wrong one."""
_SHOWN: Final = 24
"""Characters of what is no sentence, for people."""


class SentenceReader:
    """Bytes as they come to what the sentences of a profile say.

    Attributes:
        others: headers of sentences that are not in the profile, and how often they came.
    """

    def __init__(self, sentences: Sequence[Sentence]) -> None:
        self.others: Counter[str] = Counter()
        self._sentences = tuple(sentences)
        self._rest = b""
        self._is_overlong = False

    def feed(self, data: bytes) -> list[Decoded]:
        """What the sentences that end with ``data`` say: values in SI units, or a fault of one that is in the profile.
        All else is passed over, and counted in ``others``.
        """
        *lines, self._rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        found = []
        for line in lines:
            if self._is_overlong:
                self._is_overlong = False
            elif line and len(line) <= MOST_BYTES and (decoded := self._decode(line)) is not None:
                found.append(decoded)
        if len(self._rest) > MOST_BYTES:
            self._rest, self._is_overlong = b"", True
        return found

    def datagram(self, data: bytes) -> list[Decoded]:
        """The same of a datagram, which is whole whether it ends with an end of line or not."""
        self._rest, self._is_overlong = b"", False
        return self.feed(data + b"\n")

    def reset(self) -> None:
        """The line is new: what has come of a sentence is of the past."""
        self._rest, self._is_overlong = b"", False

    def heard(self) -> str:
        """In words, what came that is not in the profile; empty: nothing."""
        most = [printable(header) for header, _ in self.others.most_common(3)]
        return ", ".join(most)

    def _decode(self, line: bytes) -> Decoded | None:
        text = line.decode("ascii", "backslashreplace")
        body, star, sum_ = text.rpartition("*")
        if not star:
            body = text
        for sentence in self._sentences:
            if sentence.length is not None:
                if not _is(text[: len(sentence.header)], sentence.header):
                    continue
                if len(text) != sentence.length:
                    what = f"{len(text)} characters instead of {sentence.length}"
                    hint = "check the line's cable and speed, and the profile"
                    return Decoded({}, Fault.LENGTH, f"{name_of(sentence)}: {what}: {hint}")
                return _values(sentence, text, ())
            parts = body.split(sentence.separator)
            named = 1 + sentence.header.count(sentence.separator)
            if not _is(sentence.separator.join(parts[:named]), sentence.header):
                continue
            if (star and not _is_right(body, sum_)) or (not star and sentence.checksum == "required"):
                what = f"its checksum is {sum_!r}, not {_checksum(body):02X}" if star else "it has no checksum"
                return Decoded({}, Fault.CRC, f"{name_of(sentence)}: {what}: check the line's cable, speed and parity")
            return _values(sentence, body, parts[named:])
        self._note(body)
        return None

    def _note(self, body: str) -> None:
        header = body.split(",", 1)[0][:_SHOWN]
        if header in self.others or len(self.others) < _MOST_HEARD:
            self.others[header] += 1


def name_of(sentence: Sentence) -> str:
    """For people."""
    return sentence.header if sentence.length is None else f"line {sentence.header!r}"


def _is(header: str, wanted: str) -> bool:
    return len(header) == len(wanted) and all(w in ("-", c) for c, w in zip(header, wanted, strict=True))


def _checksum(body: str) -> int:
    total = 0
    for character in body.removeprefix("$").removeprefix("!"):
        total ^= ord(character) & 0xFF
    return total


def _is_right(body: str, sum_: str) -> bool:
    return sum_.strip().upper() == f"{_checksum(body):02X}"


def _values(sentence: Sentence, line: str, parts: Sequence[str]) -> Decoded:
    """What a sentence says: without what it leaves empty or calls bad itself, and a fault if that is all of it."""
    values: dict[Quantity, float] = {}
    unmet = [one for one in sentence.conditions if _text(one, line, parts) not in one.one_of]
    for field in sentence.fields:
        text = _text(field, line, parts)
        if not text or any(field.quantity in one.quantities or not one.quantities for one in unmet):
            continue
        where = f"{field.quantity} ({name_of(sentence)}, {_place(field)})"
        try:
            # What Python takes for a number and no device writes: 1_000, nan, infinity.
            number = float(text) if text.strip("+-.0123456789eE") == "" else float("nan")
        except ValueError:
            number = float("nan")
        value = number * field.scale + field.offset_value
        if not isfinite(value):
            detail = f"{where} is {printable(text[:_SHOWN])!r}, which is no number: check the profile's place of it"
            return Decoded({}, Fault.NOT_FINITE, detail)
        low, high = (limit if limit is not None else value for limit in (field.min, field.max))
        if not low <= value <= high:
            detail = f"{where} is {value:.6g}, outside {_limits(field)}: check the sensor, or the profile"
            return Decoded({}, Fault.OUT_OF_RANGE, detail)
        values[field.quantity] = value * field.sign * SI[field.unit][0]
    if not values and unmet:
        said = ", ".join(f"{_place(one)} is {printable(_text(one, line, parts)[:_SHOWN])!r}" for one in unmet)
        wanted = " or ".join(repr(text) for text in unmet[0].one_of)
        detail = f"{name_of(sentence)}: {said}, not {wanted}: by what it says the sensor has no reading"
        return Decoded({}, Fault.NOT_FINITE, detail)
    if not values:
        places = ", ".join(_place(field) for field in sentence.fields)
        return Decoded(
            {}, Fault.NOT_FINITE, f"{name_of(sentence)}: nothing stands at {places}: the sensor has no reading"
        )
    return Decoded(values)


def _place(field: SentenceField | Condition) -> str:
    if field.columns is not None:
        first, last = field.columns
        return f"columns {first} to {last}" if last > first else f"column {first}"
    if field.index is not None:
        return f"value {field.index}"
    return f"transducer {field.transducer}" if isinstance(field, SentenceField) else ""


def _limits(field: SentenceField) -> str:
    low = "-inf" if field.min is None else f"{field.min:g}"
    high = "inf" if field.max is None else f"{field.max:g}"
    return f"{low}..{high} {field.unit}"


def _text(field: SentenceField | Condition, line: str, parts: Sequence[str]) -> str:
    """As it stands in the sentence; empty where there is none."""
    if field.columns is not None:
        first, last = field.columns
        return line[first - 1 : last].strip()
    if field.index is not None:
        return parts[field.index - 1].strip() if field.index <= len(parts) else ""
    for place in range(3, len(parts), 4):  # kind, number, unit, identifier
        if isinstance(field, SentenceField) and parts[place].strip() == field.transducer:
            return parts[place - 2].strip()
    return ""
