"""Change keys in a configuration as a person would: in the text, with its comments, its order and its line ends.

A key that is there gets another value; one that stands behind ``#`` as a default is taken out of the comment, beside
what explains it; any other goes below the last key of its table. What the text then means is held against what it
shall mean, by the parser that reads it in the end: a text that is written in another way than we understand is
refused, never spoiled.
"""

from __future__ import annotations

import copy
import difflib
import json
import os
import re
import tempfile
import tomllib
from contextlib import suppress
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec

from heaved.config.read import parse

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from heaved.config import Config

Value = bool | int | float | str | list[Any] | tuple[Any, ...]

_KEY: Final = re.compile(r"""[ \t]*(?:"(?:[^"\\\n]|\\.)*"|'[^'\n]*'|[A-Za-z0-9_.\-]|[ \t])+=""")
_PART: Final = re.compile(
    r'"""(?:[^\\]|\\.)*?"""|'
    r"'''.*?'''|"
    r'"(?:[^"\\\n]|\\.)*"|'
    r"'[^'\n]*'|"
    r"#[^\n]*|[\[\]{}]|\n|[^\"'#\[\]{}\n]+",
    re.DOTALL,
)
"""Strings, comments, brackets, the end of a line, and what stands between them."""
_COMMENTED_HEADER: Final = re.compile(r"[ \t]*#[ \t]*\[")
_BOM: Final = b"\xef\xbb\xbf"


class EditError(Exception):
    """A configuration that cannot be changed; the message says where, why and what to do."""


class _Key(msgspec.Struct, frozen=True):
    """A key with its value: offsets in the text."""

    name: str
    value: int
    """Where its value begins,"""
    value_end: int
    """ends, before blanks and a comment,"""
    end: int
    """and where the next line begins."""


class _Table(msgspec.Struct, frozen=True):
    """A table, from its header to the next one: offsets in the text."""

    path: tuple[str, ...]
    """() of what stands before the first header."""
    is_listed: bool
    """Whether its header is in double brackets."""
    body: int
    """Where the line after the header begins,"""
    end: int
    """and the next header."""
    keys: tuple[_Key, ...]


# ---- the text --------------------------------------------------------------------------------------------------------


def with_keys(text: str, table: str, values: Mapping[str, Value], *, index: int | None = None) -> str:
    """The text of a configuration with keys of one table set.

    Args:
        table: such as "laser"; it is added at the end where there is none.
        values: what to set; floats are written in full.
        index: of ``[[table]]`` where there may be several, from 0.

    Raises:
        EditError: the text is no TOML, has no such table, or is written in a way that is not understood.
    """
    meant = copy.deepcopy(_decoded(text))
    target = meant.setdefault(table, {}) if index is None else _listed(meant, table, index)
    if not isinstance(target, dict):
        raise EditError(f"{table} is no table: write [{table}]")
    target.update({name: _plain(value) for name, value in values.items()})
    result = text
    for name, value in values.items():
        result = _with_key(result, table, name, _written(value), index)
    return _checked(result, meant, f"[{table}]" if index is None else f"[[{table}]] number {index + 1}")


def difference(before: str, after: str, name: str) -> list[str]:
    """What changes, as a unified diff without line ends; empty: nothing."""
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), name, f"{name} (new)", lineterm="", n=2)
    return list(lines)


def _with_key(text: str, table: str, name: str, value: str, index: int | None) -> str:
    newline = _newline(text)
    tables = [one for one in _tables(text) if one.path == (table,) and one.is_listed is (index is not None)]
    if index is None and not tables:
        gap = "" if not text else newline if text.endswith("\n") else 2 * newline
        return f"{text}{gap}[{table}]{newline}{name} = {value}{newline}"
    if (index or 0) >= len(tables):
        raise EditError(f"there is no [[{table}]] number {(index or 0) + 1} as a table of its own: write it so")
    found = tables[index or 0]
    for key in found.keys:
        if key.name == name:
            return text[: key.value] + value + text[key.value_end :]
    if (default := _default(text, found, name)) is not None:
        start, end, comment = default
        line = f"{name} = {value}"
        if comment:
            # The explanations of neighbouring keys stand below each other.
            line = line.ljust(text.index(comment, start) - start - 1) + " " + comment
        return text[:start] + line + text[end:]
    at = _below_keys(text, found)
    gap = "" if at == 0 or text[at - 1] == "\n" else newline
    return f"{text[:at]}{gap}{name} = {value}{newline}{text[at:]}"


def _below_keys(text: str, table: _Table) -> int:
    """Where the line after its last key begins, or after a default of it that stands behind ``#``."""
    at = table.keys[-1].end if table.keys else table.body
    for start, end in _lines(text, at, table.end):
        line = text[start:end]
        if _COMMENTED_HEADER.match(line) or not line.strip():
            break
        if _uncommented(line):
            at = end
    return at


def _default(text: str, table: _Table, name: str) -> tuple[int, int, str] | None:
    """The line on which a key of the table stands behind ``#``: from, to, and the comment that it ends with."""
    for start, end in _lines(text, table.body, table.end):
        line = text[start:end]
        if _COMMENTED_HEADER.match(line):
            return None
        if bare := _uncommented(line):
            (key,) = _tables(bare)[0].keys
            if key.name == name:
                return start, start + len(line.rstrip("\r\n")), bare[key.value_end :].strip()
    return None


def _uncommented(line: str) -> str:
    """A key with its value that stands behind ``#``; empty: the line is none."""
    found = re.match(r"[ \t]*#[ \t]?(?=[A-Za-z0-9_\-]+[ \t]*=)", line)
    bare = line[found.end() :] if found else ""
    try:
        tomllib.loads(bare)
    except ValueError:
        return ""
    return bare


def _lines(text: str, start: int, end: int) -> Iterator[tuple[int, int]]:
    while start < end:
        found = text.find("\n", start, end)
        following = end if found < 0 else found + 1
        yield start, following
        start = following


def _tables(text: str) -> list[_Table]:
    """The tables of a text that is TOML, in order."""
    tables: list[_Table] = []
    path: tuple[str, ...] = ()
    keys: list[_Key] = []
    is_listed, body = False, 0
    at = 0
    while at < len(text):
        line_end = _line_end(text, at)
        line = text[at:line_end].strip()
        if line.startswith("["):
            tables.append(_Table(path, is_listed, body, at, tuple(keys)))
            path, is_listed, body, keys = _names(line), line.startswith("[["), line_end, []
        elif line and not line.startswith("#") and (found := _KEY.match(text, at)) is not None:
            value_end, line_end = _value_end(text, found.end())
            begin = found.end() + len(text[found.end() : value_end]) - len(text[found.end() : value_end].lstrip())
            keys.append(_Key(".".join(_names(found.group() + "0")), begin, value_end, line_end))
        at = line_end
    tables.append(_Table(path, is_listed, body, len(text), tuple(keys)))
    return tables


def _value_end(text: str, start: int) -> tuple[int, int]:
    """Where a value that begins at or after ``start`` ends, and where the line after it begins."""
    depth, end, at = 0, start, start
    while at < len(text):
        found = _PART.match(text, at)
        if found is None:
            break
        part = found.group()
        at = found.end()
        if part == "\n" and depth == 0:
            return end, at
        depth += part in ("[", "{")
        depth -= part in ("]", "}")
        if not part.startswith("#") and part.strip():
            end = found.start() + len(part.rstrip())
    return end, len(text)


def _line_end(text: str, at: int) -> int:
    found = text.find("\n", at)
    return len(text) if found < 0 else found + 1


def _names(line: str) -> tuple[str, ...]:
    """The names on the way to the one thing that a line of TOML defines."""
    tree: Any = tomllib.loads(line)
    names = []
    while tree:
        if isinstance(tree, list):
            tree = tree[0]
            continue
        ((name, tree),) = tree.items()
        names.append(name)
    return tuple(names)


def _newline(text: str) -> str:
    return "\r\n" if "\r\n" in text else "\n"


# ---- what it means ---------------------------------------------------------------------------------------------------


def _decoded(text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise EditError(f"is not valid TOML: {error}") from error


def _listed(tree: dict[str, Any], table: str, index: int) -> Any:
    listed = tree.get(table)
    if not isinstance(listed, list) or index >= len(listed):
        raise EditError(f"there is no [[{table}]] number {index + 1}")
    return listed[index]


def _checked(text: str, meant: Mapping[str, Any], where: str) -> str:
    """The text, if it means that."""
    try:
        is_meant = tomllib.loads(text) == meant
    except ValueError:
        is_meant = False
    if not is_meant:
        raise EditError(f"{where} is written in a way that is not understood: change it by hand")
    return text


def _plain(value: Value) -> Any:
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def _written(value: Value) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_written(one) for one in value) + "]"
    if isinstance(value, float) and not isfinite(value):
        raise ValueError(f"{value} is no value for a configuration")
    return repr(value)


# ---- the file --------------------------------------------------------------------------------------------------------


def read_text(path: Path) -> str:
    """The text of a configuration, line ends as they are.

    Raises:
        EditError: it cannot be read, or is no UTF-8 text.
    """
    try:
        return path.read_bytes().removeprefix(_BOM).decode("utf-8")
    except OSError as error:
        raise EditError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise EditError(f"{path}: is not UTF-8 text, save it as such: {error}") from error


def validated(path: Path, text: str, *, to_run: bool = False) -> Config:
    """What a text says as the configuration at ``path``. ``to_run``: every stage has its devices, too.

    Raises:
        EditError: it is not TOML.
        heaved.config.read.ConfigError: it has faults.
    """
    return parse(_decoded(text), file=str(path), directory=path.parent, to_run=to_run)


def write(path: Path, text: str, *, before: str | None) -> None:
    """Put a text in the place of the configuration at once, or not at all; its mode and owner stay.

    ``before``: what the file holds as far as is known; None: there is none yet.

    Raises:
        EditError: the file has been changed meanwhile, or cannot be written.
        heaved.config.read.ConfigError: the text has faults. Nothing is written.
    """
    validated(path, text)
    target = path.resolve()  # A link stays a link.
    if before is None and target.exists():
        raise EditError(f"{path}: is there already: nothing was written")
    if before is not None and read_text(target) != before:
        raise EditError(f"{path}: was changed by somebody else meanwhile: nothing was written; begin again")
    try:
        _replace(target, text)
    except OSError as error:
        reason = error.strerror or error
        raise EditError(f"{path}: cannot be written: {reason}; it is as it was. Write to its directory?") from error


def _replace(target: Path, text: str) -> None:
    is_there = target.exists()
    mark = _BOM if is_there and target.read_bytes().startswith(_BOM) else b""
    number, name = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
    try:
        with os.fdopen(number, "wb") as file:
            file.write(mark + text.encode())
            file.flush()
            if is_there:
                old = target.stat()
                with suppress(PermissionError):  # Only root may give files away.
                    os.fchown(file.fileno(), old.st_uid, old.st_gid)
                os.fchmod(file.fileno(), old.st_mode & 0o7777)
            else:
                os.fchmod(file.fileno(), 0o644)
            os.fsync(file.fileno())
        Path(name).replace(target)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    directory = os.open(target.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)


def coloured(lines: Sequence[str]) -> list[str]:
    """The lines of a :func:`difference` in the colours of terminals."""
    colours = {"+": "32", "-": "31", "@": "36"}
    return [f"\x1b[{colours[line[0]]}m{line}\x1b[0m" if line[:1] in colours else line for line in lines]
