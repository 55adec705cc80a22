"""Texts of the configuration that come to stand in topics, labels, file names and lines: no line end gets in."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from msgspec import inspect

from heaved.config import Config
from heaved.config.read import ConfigError, parse

if TYPE_CHECKING:
    from pathlib import Path


def patterns(kind: Any, seen: set[type]) -> set[str]:
    """Of all texts within a type."""
    if isinstance(kind, inspect.StrType):
        return {kind.pattern} if kind.pattern else set()
    if isinstance(kind, inspect.StructType):
        if kind.cls in seen:
            return set()
        seen.add(kind.cls)
        inner = [field.type for field in kind.fields]
    elif isinstance(kind, inspect.UnionType):
        inner = list(kind.types)
    elif isinstance(kind, inspect.VarTupleType | inspect.ListType):
        inner = [kind.item_type]
    elif isinstance(kind, inspect.TupleType):
        inner = list(kind.item_types)
    elif isinstance(kind, inspect.DictType):
        inner = [kind.key_type, kind.value_type]
    else:
        return set()
    return set().union(*(patterns(one, seen) for one in inner))


def test_no_pattern_lets_a_line_end_follow() -> None:
    """In a pattern "$" matches before a line end too."""
    found = patterns(inspect.type_info(Config), set())
    assert len(found) > 5
    assert {pattern for pattern in found if not (pattern.startswith("^") and pattern.endswith(r"\Z"))} == set()


HOSTILE = {
    "a line end": "imu\n",
    "an escape": "imu\x1b[2J",
    "another direction": "imu\u202e",
    "HTML": "<b>imu</b>",
    "a path": "../imu",
    "a thousand": "i" * 1000,
    "nothing": "",
}


@pytest.mark.parametrize("what", HOSTILE)
def test_what_no_device_is_called(what: str, tmp_path: Path) -> None:
    device = {
        "name": HOSTILE[what], "role": "imu", "link": "tcp://127.0.0.1:502", "profile": "witmotion-wt901c485",
        "rate_hz": 50.0,
    }  # fmt: skip
    with pytest.raises(ConfigError, match=r"device\[0\]\.name"):
        parse({"device": [device]}, file="heaved.toml", directory=tmp_path)
    parse({"device": [device | {"name": "imu"}]}, file="heaved.toml", directory=tmp_path)


@pytest.mark.parametrize("topic", ["crane\n", "crane\x1b", "crane\x9b2J", "+/crane", "crane/#", "$SYS", "/crane", ""])
def test_what_no_topic_is(topic: str) -> None:
    from heaved.outputs.mqtt import MqttParams

    with pytest.raises(msgspec.ValidationError, match="topic"):
        msgspec.convert({"topic": topic}, MqttParams)
    msgspec.convert({"topic": "ship/crane 1"}, MqttParams)
