"""What comes from elsewhere cannot command the terminal that shows it."""

from __future__ import annotations

import pytest

from heaved.text import printable, printable_lines


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("", ""),
        ("heave +1.25 m ±0.02 m, 3° 12″", "heave +1.25 m ±0.02 m, 3° 12″"),
        ("Höhe 波", "Höhe 波"),
        ("\x1b[31mred\x1b[0m", r"\x1b[31mred\x1b[0m"),
        ("\x9b31m", r"\x9b31m"),
        ("\x1b]0;title\x07", r"\x1b]0;title\x07"),
        ("over\rwritten\b\x7f", r"over\rwritten\x08\x7f"),
        ("two\nlines\t", r"two\nlines\t"),
        ("a\u2028b\u2029", r"a\u2028b\u2029"),
        ("\u202ereversed\u202c \u2066x\u2069", r"\u202ereversed\u202c \u2066x\u2069"),
        ("\u200b\ufeff\u00ad", r"\u200b\ufeff\xad"),
        ("\ud800", r"\ud800"),
        ("\U000e0041", r"\U000e0041"),
    ],
)
def test_printable(text: str, shown: str) -> None:
    assert printable(text) == shown
    assert printable(text).isprintable()


def test_line_ends_may_stay() -> None:
    assert printable_lines("one\x1b\ntwo\r\n") == "one\\x1b\ntwo\\r\n"
