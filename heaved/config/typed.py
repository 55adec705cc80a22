"""Every fault of a decoded document against the types of its tables, each named with its path.

msgspec alone stops at the first. What is sound of a document that has faults is told too, so that the rest of it can
still be checked.
"""

from __future__ import annotations

import types
from enum import StrEnum
from math import isfinite
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec


def check(kind: Any, value: Any, path: str, faults: list[str]) -> None:
    """Collect every fault of ``value`` against type ``kind``; msgspec alone would stop at the first."""
    struct, element, before = table_of(kind), _element_of(kind), len(faults)
    if struct is not None and isinstance(value, dict):
        hints = get_type_hints(struct, include_extras=True)
        fields = {field.name: field for field in msgspec.structs.fields(struct)}
        unknown = [key for key in value if key not in fields]
        faults += [f"{_join(path, key)}: unknown key; known here: {', '.join(fields)}" for key in unknown]
        for name, field in fields.items():
            if name in value:
                check(hints[name], value[name], _join(path, name), faults)
            elif field.required:
                faults.append(f"{_join(path, name)}: missing")
        if path and len(faults) == before:
            _convert(struct, value, path, faults)  # What no key can get wrong alone.
    elif element is not None and isinstance(value, list) and table_of(element) is not None:
        for i, item in enumerate(value):
            check(element, item, f"{path}[{i}]", faults)
        if len(faults) == before:
            _convert(kind, value, path, faults)
    else:
        _convert(kind, value, path, faults)


def _convert(kind: Any, value: Any, path: str, faults: list[str]) -> None:
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        choices = _choices_of(kind)
        reason = f"must be {choices}" if choices and "Invalid enum value" in str(error) else str(error)
        faults.append(f"{path}: {reason} (got {shown(value)})")
        return
    numbers = value if isinstance(value, list) else [value]
    if any(isinstance(number, float) and not isfinite(number) for number in numbers):
        faults.append(f"{path}: must be finite (got {shown(value)})")


def shown(value: Any) -> str:
    """As Python writes it, cut where it grows long."""
    text = repr(value)
    return text if len(text) <= 80 else text[:80] + "…"


def _strip(kind: Any) -> Any:
    return _strip(get_args(kind)[0]) if get_origin(kind) is Annotated else kind


def table_of(kind: Any) -> Any:
    """The struct type behind ``kind`` (also ``Struct | None``), or None."""
    kind = _strip(kind)
    if get_origin(kind) in (Union, types.UnionType):
        structs = [table_of(option) for option in get_args(kind) if table_of(option) is not None]
        return structs[0] if len(structs) == 1 else None
    return kind if isinstance(kind, type) and issubclass(kind, msgspec.Struct) else None


def _element_of(kind: Any) -> Any:
    kind = _strip(kind)
    return get_args(kind)[0] if get_origin(kind) is tuple else None


def _choices_of(kind: Any) -> str:
    """``'a', 'b' or 'c'`` for a Literal or an enum of strings, or None; empty for any other type."""
    kind = _strip(kind)
    if get_origin(kind) in (Union, types.UnionType):
        options = [option for option in get_args(kind) if option is not type(None)]
        return _choices_of(options[0]) if len(options) == 1 else ""
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        names = [member.value for member in kind]
    elif get_origin(kind) is Literal:
        names = list(get_args(kind))
    else:
        return ""
    *others, last = map(repr, names)
    return f"{', '.join(others)} or {last}" if others else last


def _join(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key


def sound_keys(kind: Any, table: Any) -> dict[str, Any]:
    """The keys of a table that have no fault of their own, tables within it likewise."""
    sound: dict[str, Any] = {}
    for name, hint in get_type_hints(table_of(kind), include_extras=True).items():
        if isinstance(table, dict) and name in table:
            value = sound_keys(hint, table[name]) if table_of(hint) is not None else table[name]
            faults: list[str] = []
            check(hint, value, name, faults)
            if not faults:
                sound[name] = value
    return sound
