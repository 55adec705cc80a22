"""A topic on a terminal: colours and a pager there, plain text where it is piped."""

from __future__ import annotations

import os
import shutil
import sys
from typing import TYPE_CHECKING, ClassVar, Final, TextIO

from rich.console import Console
from rich.markdown import Heading, Markdown, MarkdownElement
from rich.text import Text

from heaved.manual.topics import LINK

if TYPE_CHECKING:
    from rich.console import ConsoleOptions, RenderResult

WIDTH: Final = 100
"""Lines longer than this are hard to read."""
PIPED_WIDTH: Final = 120


class _LeftHeading(Heading):
    """At the left, with a mark of its depth, so that it is seen without colours too."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        depth = int(self.tag[1:])
        text = Text("#" * depth + " ") + self.text if depth > 1 else Text(self.text.plain.upper())
        text.stylize("bold")
        yield Text()
        yield text


class _Page(Markdown):
    elements: ClassVar[dict[str, type[MarkdownElement]]] = {**Markdown.elements, "heading_open": _LeftHeading}


def spoken(text: str) -> str:
    """Links to other topics, in words that can be typed."""
    return LINK.sub(lambda link: f"{link[1]} (`heaved manual {link[2]}`)", text)


def show(text: str, out: TextIO) -> None:
    """Print Markdown: through a pager if ``out`` is a terminal and lower than the text."""
    page = _Page(spoken(text), code_theme="ansi_dark", hyperlinks=False, inline_code_lexer=None)
    console = Console(file=out, highlight=False)
    if not console.is_terminal:
        plain = Console(file=out, width=PIPED_WIDTH, color_system=None, highlight=False)
        with plain.capture() as captured:
            plain.print(page)
        out.write("\n".join(line.rstrip() for line in captured.get().split("\n")).lstrip("\n"))
        return
    width = min(console.width, WIDTH)
    with console.capture() as captured:
        console.print(page, width=width)
    if captured.get().count("\n") < console.height or out is not sys.stdout:
        console.print(page, width=width)
        return
    less = "less" in os.environ.get("PAGER", "less") and shutil.which("less") is not None
    os.environ.setdefault("LESS", "-R")  # It shows colours, then.
    with console.pager(styles=less):
        console.print(page, width=width)
