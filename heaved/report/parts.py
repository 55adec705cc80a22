"""What pages are made of: their style, tables, numbers as texts; every text is escaped. Pure."""

from __future__ import annotations

from html import escape
from math import isfinite
from typing import TYPE_CHECKING, Final

from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

NOT_KNOWN: Final = "—"

STYLE: Final = """
:root { color-scheme: light; }
body { font: 15px/1.5 Arial, Helvetica, "Liberation Sans", sans-serif; color: #1a1a1a; background: #fff;
  max-width: 52rem; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.25rem; margin: 2.4rem 0 .6rem; padding-top: .5rem; border-top: 1.5px solid #1a1a1a; }
h3 { font-size: 1rem; margin: 1.4rem 0 .4rem; }
p { margin: .5rem 0; }
a { color: #00507d; }
.of { color: #444; overflow-wrap: anywhere; }
.summary { background: #f2f6f9; border-left: 4px solid #0072b2; padding: .4rem 1rem; margin: 1rem 0; }
nav { columns: 2; font-size: .93rem; margin: 1rem 0; }
nav ol { margin: 0; padding-left: 1.6rem; }
figure { margin: 1rem 0 1.2rem; break-inside: avoid; }
svg.figure { display: block; width: 100%; height: auto; }
figcaption, caption { font-size: .87rem; color: #333; text-align: left; padding: .3rem 0; caption-side: top; }
table { border-collapse: collapse; width: 100%; font-size: .87rem; margin: .8rem 0;
  font-variant-numeric: tabular-nums; break-inside: avoid; }
th, td { padding: .22rem .5rem; border-bottom: 1px solid #ccc; text-align: left; vertical-align: top;
  overflow-wrap: anywhere; min-width: 7em; }
thead th { border-bottom: 1.5px solid #1a1a1a; vertical-align: bottom; }
.n { text-align: right; white-space: nowrap; overflow-wrap: normal; min-width: 0; }
thead .n { white-space: normal; }
tr { break-inside: avoid; }
code, pre { font: .86em/1.4 "DejaVu Sans Mono", Consolas, monospace; overflow-wrap: anywhere; white-space: pre-wrap; }
.missing { color: #444; font-style: italic; }
footer { margin-top: 2.5rem; border-top: 1px solid #ccc; font-size: .8rem; color: #444; }
@page { size: A4; margin: 16mm 15mm 18mm; }
@media print {
  body { font-size: 10pt; margin: 0; padding: 0; max-width: none; }
  h2, h3 { break-after: avoid; }
  a { color: inherit; text-decoration: none; }
  .summary { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
}
"""


def document(title: str, body: str) -> str:
    """A whole document of that title, plain text; ``body`` is HTML."""
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\">\n"
        f"<title>{escaped(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n{body}</body>\n</html>\n"
    )


def escaped(text: str) -> str:
    """A text as it stands in a page: on one line, with nothing that HTML would take for its own."""
    return escape(printable(text), quote=True)


def paragraph(text: str) -> str:
    """A paragraph of plain text."""
    return f"<p>{escaped(text)}</p>\n"


def missing(text: str) -> str:
    """Says why something is not there."""
    return f'<p class="missing">{escaped(text)}</p>\n'


def figure(figures: Mapping[str, str], key: str, caption: str) -> str:
    """A drawing, an SVG element, with its caption; nothing if there is none of that key."""
    if key not in figures:
        return ""
    drawing = figures[key].replace("<svg ", f'<svg aria-label="{escaped(caption)}" ', 1)
    return f'<figure id="figure-{key}">\n{drawing}\n<figcaption>{escaped(caption)}</figcaption>\n</figure>\n'


def table(
    key: str, head: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "", *, words: Sequence[int] = (0,)
) -> str:
    """Rows of texts; columns but those of ``words`` are numbers, to the right. The first cell names its row."""

    def cells(tag: str, row: Sequence[str]) -> str:
        parts = []
        for i, cell in enumerate(row):
            name = "th" if i == 0 and tag == "td" else tag
            scope = ' scope="row"' if name == "th" and tag == "td" else ' scope="col"' if tag == "th" else ""
            to_the_right = "" if i in words else ' class="n"'
            parts.append(f"<{name}{scope}{to_the_right}>{escaped(cell)}</{name}>")
        return f"<tr>{''.join(parts)}</tr>\n"

    body = "".join(cells("td", row) for row in rows)
    title = f"<caption>{escaped(caption)}</caption>\n" if caption else ""
    return f'<table id="table-{key}">\n{title}<thead>\n{cells("th", head)}</thead>\n<tbody>\n{body}</tbody>\n</table>\n'


def number(value: float, digits: int = 3) -> str:
    """With so many significant digits, never as a power of ten where it can be helped."""
    if not isfinite(value):
        return NOT_KNOWN
    text = f"{value:#.{digits}g}".removesuffix(".")
    return f"{value:.0f}" if "e+" in text else text


def decimals(value: float, places: int) -> str:
    """With so many decimal places; zero has no sign."""
    if not isfinite(value):
        return NOT_KNOWN
    text = f"{value:.{places}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def percent(share: float) -> str:
    """A share with one decimal; a dash where it is not known."""
    return f"{100.0 * share:.1f} %" if isfinite(share) else NOT_KNOWN
