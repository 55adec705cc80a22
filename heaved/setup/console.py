"""Lines out, answers in: a dialogue that works over any terminal, and over none."""

from __future__ import annotations

import shutil
import sys
import textwrap
from typing import TYPE_CHECKING, Final

from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

WIDTH: Final = 80
BAR: Final = 30
"""Characters of a bar."""


class QuitError(Exception):
    """The person wants to stop, or there is nobody."""


class Console:
    """Where a person is asked. Plain lines; a bar that is drawn over itself only on a terminal."""

    def __init__(
        self,
        say: Callable[[str], None],
        ask: Callable[[str], str] = input,
        *,
        draw: Callable[[str], None] | None = None,
        is_coloured: bool = False,
    ) -> None:
        """``draw``: writes without a line end, on a terminal; None: there is none."""
        self._say, self._ask, self._draw = say, ask, draw
        self.is_coloured = is_coloured
        self._drawn = False

    def say(self, text: str = "", indent: str = "") -> None:
        """A paragraph, in lines that fit."""
        self._end_drawing()
        width = min(shutil.get_terminal_size((WIDTH, 24)).columns, WIDTH) - 1
        lines = textwrap.wrap(printable(text), width, initial_indent=indent, subsequent_indent=indent)
        for line in lines or [""]:
            self._say(line)

    def line(self, text: str) -> None:
        """A line as it is."""
        self._end_drawing()
        self._say(text)

    def choose(self, choices: Mapping[str, str], default: str = "") -> str:
        """Ask for one of some keys; an empty answer is ``default``, and what is none is asked again.

        Args:
            choices: what each key does.
            default: of them, chosen by Enter.

        Raises:
            QuitError: "q", or the end of the input.
        """
        keys = ", ".join(f"{'Enter' if key == default else key} {what}" for key, what in choices.items())
        while True:
            answer = self.answer(f"[{keys}] ").lower() or default
            if answer in choices:
                if answer == "q":
                    raise QuitError
                return answer
            self.say(f"{answer!r} is none of these.")

    def answer(self, prompt: str) -> str:
        """What a person types, without blanks around it.

        Raises:
            QuitError: the end of the input.
        """
        self._end_drawing()
        try:
            return self._ask(prompt).strip()
        except EOFError as error:
            raise QuitError from error

    def progress(self, done: float, total: float, unit: str = "s") -> None:
        """How far something is."""
        if self._draw is None:
            return
        filled = round(BAR * min(done / total, 1.0)) if total > 0.0 else BAR
        self._draw(f"\r  [{'#' * filled}{'.' * (BAR - filled)}] {done:.0f} of {total:.0f} {unit} ")
        self._drawn = True

    def _end_drawing(self) -> None:
        if self._drawn and self._draw is not None:
            self._draw("\r" + " " * (WIDTH - 2) + "\r")
        self._drawn = False


def terminal(*, to_stderr: bool = False) -> Console:
    """Of this process: says all on standard output, or on standard error if that is wanted for something else."""
    out = sys.stderr if to_stderr else sys.stdout
    is_terminal = out.isatty()

    def draw(text: str) -> None:
        out.write(text)
        out.flush()

    def say(text: str) -> None:
        draw(text + "\n")

    def ask(prompt: str) -> str:
        draw(prompt)
        line = sys.stdin.readline()
        if not line or not sys.stdin.isatty():
            draw("\n")
        if not line:
            raise EOFError
        return line

    return Console(say, ask, draw=draw if is_terminal else None, is_coloured=is_terminal)
