"""A topic as a page of man(7): a renderer for the part of Markdown that the topics use.

Source: man(7) and groff_man(7); tbl(1) for tables. What it does not know it refuses, so that nothing of a topic is lost
in silence.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from markdown_it import MarkdownIt

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from markdown_it.token import Token

    from heaved.manual.topics import Topic

PAGES: Final = {"index": ("heaved-manual", 7), "commands": ("heaved", 1), "configuration": ("heaved.toml", 5)}
"""Topics that are pages under other names than ``heaved-<topic>(7)``."""
_LONG_CELL: Final = 14
_LINK: Final = re.compile(r"([a-z0-9-]+)\.md")


def page_name(topic: str) -> tuple[str, int]:
    """Name and section of a topic's page."""
    return PAGES.get(topic, (f"heaved-{topic}", 7))


def man_page(topic: Topic, text: str, version: str, date: str, others: Mapping[str, Topic]) -> str:
    """The page of a topic whose tables are filled in; it points to all ``others``. ``date``: ISO 8601.

    Raises:
        ValueError: it uses a part of Markdown that this does not know.
    """
    name, section = page_name(topic.name)
    _, _, body = text.partition("\n")
    see = sorted({page_name(other) for other in others if other != topic.name}, key=lambda page: (page[1], page[0]))
    lines = [
        "'\\\" t",
        f'.TH {_quoted(name.upper())} {section} {date} {_quoted(f"heaved {version}")} "heaved manual"',
        ".ad l",  # Ragged: words of a narrow cell are not drawn apart.
        ".SH NAME",
        f"{_escaped(name)} \\- {_escaped(topic.summary)}",
        ".SH DESCRIPTION",
        *_Renderer().render(body),
        ".SH SEE ALSO",
        ",\n".join(f".BR {_escaped(other)} ({number})" for other, number in see).replace(",\n", " ,\n"),
    ]
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    return '"' + _escaped(text).replace('"', "\\(dq") + '"'


def _escaped(text: str) -> str:
    """Text whose characters mean themselves; a line of it begins with no request."""
    text = (
        text.replace("\\", "\\e").replace("-", "\\-").replace("`", "\\(ga").replace("^", "\\(ha").replace("~", "\\(ti")
    )
    return "\n".join(f"\\&{line}" if line.startswith((".", "'")) else line for line in text.split("\n"))


class _Renderer:
    """Turns the blocks of one text into lines, in order."""

    def __init__(self) -> None:
        self._lines: list[str] = []
        self._depth = 0
        """Of lists."""
        self._after_item = False
        """A list item has begun, whose first paragraph needs no request."""
        self._row: list[str] = []
        self._rows: list[list[str]] = []
        self._in_table = False

    def render(self, text: str) -> list[str]:
        """All of it.

        Raises:
            ValueError: there is something in it that this does not know.
        """
        for token in MarkdownIt("commonmark", {"html": False}).enable("table").parse(text):
            getattr(self, f"_{token.type}", self._unknown)(token)
        return self._lines

    def _unknown(self, token: Token) -> None:
        if token.type not in _SILENT:
            raise ValueError(f"no page of man can be made of {token.type}: {token.content[:60]!r}")

    def _heading_open(self, token: Token) -> None:
        self._lines.append({"h2": ".SH", "h3": ".SS"}.get(token.tag, ".SS"))

    def _paragraph_open(self, token: Token) -> None:
        if not token.hidden:
            self._begin_block()
        self._after_item = False

    def _begin_block(self) -> None:
        """A paragraph of its own, unless a heading or an item has just begun one."""
        begun = self._after_item or not self._lines or self._lines[-1].startswith((".SH", ".SS"))
        if not begun:
            # Within a list, .IP goes on at its indentation.
            self._lines.append(".IP" if self._depth else ".PP")

    def _inline(self, token: Token) -> None:
        text = _inline(token.children or [])
        if self._in_table:
            self._row.append(text)
        elif self._lines and self._lines[-1] in (".SH", ".SS"):
            plain = "".join(part.content for part in token.children or [] if part.type in ("text", "code_inline"))
            self._lines[-1] += " " + _quoted(plain.upper() if self._lines[-1] == ".SH" else plain)
        else:
            self._lines += text.split("\n")

    def _fence(self, token: Token) -> None:
        code = [_escaped(line) for line in token.content.rstrip("\n").split("\n")]
        self._begin_block()
        self._lines += [".in +4n", ".EX", *code, ".EE", ".in"]
        self._after_item = False

    _code_block = _fence

    def _bullet_list_open(self, _: Token) -> None:
        if self._depth:
            self._lines.append(".RS 4")
        self._depth += 1

    def _bullet_list_close(self, _: Token) -> None:
        self._depth -= 1
        if self._depth:
            self._lines.append(".RE")

    _ordered_list_open, _ordered_list_close = _bullet_list_open, _bullet_list_close

    def _list_item_open(self, token: Token) -> None:
        self._lines.append(f'.IP "{token.info}." 4' if token.info else ".IP \\(bu 4")
        self._after_item = True

    def _table_open(self, _: Token) -> None:
        self._in_table, self._rows = True, []

    def _tr_open(self, _: Token) -> None:
        self._row = []

    def _tr_close(self, _: Token) -> None:
        self._rows.append(self._row)

    def _table_close(self, _: Token) -> None:
        self._in_table = False
        self._begin_block()
        self._lines += _table(self._rows)


_SILENT: Final = frozenset(
    ("heading_close", "paragraph_close", "list_item_close", "thead_open", "thead_close", "tbody_open", "tbody_close",
     "th_open", "th_close", "td_open", "td_close")
)  # fmt: skip
"""Ends of what was begun, and parts of a table."""


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    """For tbl: the first row is the head."""
    columns = len(rows[0])
    widest = [max(len(row[i]) for row in rows) for i in range(columns)]
    # What is long is set in lines, in what the others leave of the width.
    formats = " ".join("lx" if width > _LONG_CELL else "l" for width in widest)
    lines = [".TS", "tab(\t);", " ".join(["lb"] * columns), f"{formats}."]
    for row in rows:
        cells = [f"T{{\n{cell}\nT}}" if widest[i] > _LONG_CELL else cell for i, cell in enumerate(row)]
        lines += "\t".join(cells).split("\n")
    return [*lines, ".TE"]


def _inline(parts: Sequence[Token]) -> str:
    """Text, with what is code or strong in bold. A link to a topic becomes the name of its page."""
    out, target = "", ""
    for part in parts:
        match part.type:
            case "text":
                out += _escaped(part.content)
            case "softbreak":
                out += "\n"
            case "hardbreak":
                out += "\n.br\n"
            case "code_inline":
                out += f"\\fB{_escaped(part.content)}\\fR"
            case "strong_open":
                out += "\\fB"
            case "em_open":
                out += "\\fI"
            case "strong_close" | "em_close":
                out += "\\fR"
            case "link_open":
                target = str(part.attrs["href"])
            case "link_close":
                topic = _LINK.fullmatch(target)
                name, section = page_name(topic[1]) if topic else (target, 0)
                out += f" (\\fB{_escaped(name)}\\fR({section}))" if topic else f" ({_escaped(target)})"
            case _:
                raise ValueError(f"no page of man can be made of {part.type}: {part.content!r}")
    return out
