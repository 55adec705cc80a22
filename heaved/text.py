"""Text that comes from elsewhere (a peer, a device, a file), made safe to print on a terminal."""

from __future__ import annotations


def printable(text: str) -> str:
    """``text`` on one line, with every character that a terminal would obey or hide written as its escape.

    That is all that Unicode calls other or a separator, but the space: control characters of both ranges (with ``ESC``
    and its eight-bit cousins), line ends, marks that turn the direction of writing, what has no width, lone surrogates.
    """
    if text.isprintable():
        return text
    return "".join([letter if letter.isprintable() else _escape(letter) for letter in text])


def printable_lines(text: str) -> str:
    """The same, with the line ends left in."""
    return "\n".join(map(printable, text.split("\n")))


def _escape(letter: str) -> str:
    return letter.encode("unicode_escape").decode("ascii")
