"""The topics: which there are, what each is about, and their text with its tables filled in.

A topic is a file ``<name>.md`` here: a title, then a paragraph whose first sentence says what it is about. ``index.md``
links to all others, in the order of the list. Where a topic has ``<!-- table: NAME -->`` on a line of its own, stands
what :mod:`heaved.manual.tables` makes of the code.
"""

from __future__ import annotations

import re
from importlib import resources
from typing import TYPE_CHECKING, Final

import msgspec

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

INDEX: Final = "index"
MARKER: Final = re.compile(r"^<!-- table: ([a-z-]+) -->$", re.MULTILINE)
LINK: Final = re.compile(r"\[([^\]]+)\]\(([a-z0-9-]+)\.md\)")
_SENTENCE: Final = re.compile(r"(.+?[.:])(?:\s|$)", re.DOTALL)
_ESCAPE: Final = re.compile(r"\\(?=[^\w\s])|\\$")
_FENCE: Final = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


class Topic(msgspec.Struct, frozen=True, kw_only=True):
    """One topic."""

    name: str
    title: str
    summary: str
    """One sentence, without its full stop."""
    source: str
    """Markdown as it is written, tables not filled in."""


class Found(msgspec.Struct, frozen=True, kw_only=True):
    """A line in which something was found."""

    topic: str
    heading: str
    line: str


def topics() -> dict[str, Topic]:
    """All of them by name, in the order of the index, which is the first."""
    index = _read(INDEX)
    names = dict.fromkeys(target for _, target in LINK.findall(index.source))
    return {INDEX: index} | {name: _read(name) for name in names}


def _read(name: str) -> Topic:
    source = (resources.files("heaved.manual") / f"{name}.md").read_text(encoding="utf-8")
    title, _, rest = source.partition("\n")
    opening = rest.strip().partition("\n\n")[0]
    sentence = _SENTENCE.match(opening)
    summary = " ".join((opening if sentence is None else sentence[1]).split()).rstrip(".:")
    return Topic(name=name, title=title.removeprefix("# "), summary=summary, source=source)


def filled(topic: Topic, tables: Mapping[str, Callable[[], str]]) -> str:
    """The text of a topic, its tables made.

    Raises:
        KeyError: it asks for a table that nobody makes.
    """
    return MARKER.sub(lambda marker: tables[marker[1]]().strip("\n"), topic.source)


def search(text: str, topic: str, word: str) -> list[Found]:
    """Lines of a topic's filled text that hold ``word``, in whatever case, each with the heading that it is under."""
    found, heading = [], ""
    fenced = {
        number
        for fence in _FENCE.finditer(text)
        for number in range(text.count("\n", 0, fence.start()), text.count("\n", 0, fence.end()) + 1)
    }
    for number, line in enumerate(text.splitlines()):
        if line.startswith("#") and number not in fenced:
            heading = line.lstrip("# ").replace("`", "")
        if word.casefold() in _ESCAPE.sub("", line).casefold() and not line.startswith("```"):
            found.append(Found(topic=topic, heading=heading, line=_ESCAPE.sub("", line).replace("`", "").strip("#|- ")))
    return found
