"""The reference of the configuration, made from the file that ships: its comments are the one place where keys are
described.

The file has, above each key or group of keys, comments that say what it is, and behind its value unit and range. Lines
of a comment that are indented are examples or tables.
"""

from __future__ import annotations

import re
from typing import Final

import msgspec

RULER: Final = re.compile(r"# -{4} (.*?) -{4,}")
TABLE: Final = re.compile(r"\[{1,2}([a-z0-9_.]+)\]{1,2}$")
KEY: Final = re.compile(r"(#?)([a-z][a-z0-9_]*) = (.*)")
_INDENTED: Final = "   "
_SPECIAL: Final = re.compile(r"([\\`*_<\[\]])")


class Key(msgspec.Struct, frozen=True, kw_only=True):
    """One key as the file has it."""

    name: str
    value: str
    remark: str
    """Unit and range; empty: its comment says all."""
    is_default: bool
    """It stands behind ``#``; else the value is an example."""


def split_value(text: str) -> tuple[str, str]:
    """A value and the comment behind it. A ``#`` within quotes belongs to the value."""
    quoted = False
    for i, letter in enumerate(text):
        quoted ^= letter == '"'
        if letter == "#" and not quoted:
            return text[:i].strip(), text[i + 1 :].strip()
    return text.strip(), ""


def reference(text: str) -> str:
    """Markdown: a heading for each table, its keys with unit, range and default, and what they are."""
    out: list[str] = []
    comment: list[str] = []
    keys: list[Key] = []
    shown: set[str] = set()
    is_shown = True
    for line in [*text.splitlines(), ""]:
        key = KEY.fullmatch(line)
        if key is not None:
            value, remark = split_value(key[3])
            keys.append(Key(name=key[2], value=value, remark=remark, is_default=key[1] == "#"))
            continue
        if keys:
            out += _entry(keys, comment) if is_shown else []
            comment, keys = [], []
        if ruler := RULER.fullmatch(line):
            out += [*_prose(comment), f"## {ruler[1].capitalize()}", ""]
            comment = []
        elif TABLE.fullmatch(line):
            # A second one of a kind is an example, and its keys have been described.
            is_shown = line not in shown
            shown.add(line)
            out += [*_prose(comment), f"### `{line}`", ""] if is_shown else []
            comment = []
        elif line.startswith("#"):
            comment.append(line[1:].removeprefix(" "))
        else:
            out += _prose(comment)
            comment = []
    return "\n".join(out)


def _entry(keys: list[Key], comment: list[str]) -> list[str]:
    """Keys that share a comment. A table that can be switched on says first what it is for."""
    before = _prose(comment) if keys[0].name == "enabled" else []
    described = [] if before else [f"  {line}".rstrip() for line in _prose(comment)]
    heads = []
    for key in keys:
        told = f"default `{key.value}`" if key.is_default else f"such as `{key.value}`"
        heads.append(f"`{key.name}`: {told}{f'; {_plain(key.remark)}' if key.remark else ''}")
    # A trailing backslash is a line break.
    return [*before, "- " + "\\\n  ".join(heads), "", *described]


def _prose(comment: list[str]) -> list[str]:
    """Paragraphs; what is indented is a code block."""
    out: list[str] = []
    inside = False
    for line in comment:
        is_code = line.startswith(_INDENTED)
        if is_code is not inside and line:
            out += (["```toml"] if out and not out[-1] else ["", "```toml"]) if is_code else ["```", ""]
            inside = is_code
        out.append(line.removeprefix("    ") if inside else _plain(line))
    if inside:
        out.append("```")
    return [*out, ""] if out else []


def _plain(text: str) -> str:
    """Text in which nothing means anything to Markdown."""
    return _SPECIAL.sub(r"\\\1", text)
