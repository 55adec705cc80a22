"""What the manual must have is told by the code: every key, reason, message, exit code and state."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args, get_origin, get_type_hints

import msgspec
import pytest

from heaved.cli import common
from heaved.cli.described import tables
from heaved.config import Config
from heaved.config.read import data_directory
from heaved.config.typed import table_of
from heaved.estimation.craft.inputs import Caution
from heaved.estimation.hull.estimate import HullWarning
from heaved.manual import configuration
from heaved.manual.topics import MARKER, filled, search, topics
from heaved.samples import CorrectionState, Fault, HeaveState, LaserState

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).resolve().parents[2]
TOPICS = topics()
TEXTS = {name: filled(topic, tables()) for name, topic in TOPICS.items()}
FENCES = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


# ---- topics ----------------------------------------------------------------------------------------------------------


def test_no_topic_is_an_orphan() -> None:
    assert {path.stem for path in (ROOT / "heaved" / "manual").glob("*.md")} == set(TOPICS)


def test_links_lead_somewhere() -> None:
    for name, topic in TOPICS.items():
        for target in re.findall(r"\]\(([^)]*)\)", FENCES.sub("", topic.source)):
            assert target.removesuffix(".md") in TOPICS, f"{name}: {target}"


def test_links_of_the_readme_lead_somewhere() -> None:
    targets = re.findall(r"\]\(([a-zA-Z][^):]*)\)", (ROOT / "README.md").read_text())
    assert len(targets) > 10
    assert not [target for target in targets if not (ROOT / target).exists()]
    assert set(re.findall(r"heaved manual ([a-z-]+)", (ROOT / "README.md").read_text())) <= set(TOPICS)


def test_a_topic_says_what_it_is_about() -> None:
    for name, topic in TOPICS.items():
        assert topic.source.startswith("# "), name
        assert 10 < len(topic.summary) < 120, f"{name}: {topic.summary}"
    assert len({topic.summary for topic in TOPICS.values()}) == len(TOPICS)


def test_every_table_that_is_made_is_in_a_topic() -> None:
    asked = [name for topic in TOPICS.values() for name in MARKER.findall(topic.source)]
    assert sorted(asked) == sorted(tables())
    assert not [name for name, text in TEXTS.items() if "<!--" in text]


def test_figures_are_those_that_were_measured() -> None:
    results = (ROOT / "tools" / "RESULTS.md").read_text().splitlines()
    rows = [line for line in TOPICS["method"].source.splitlines() if line.startswith("|")]
    assert len(rows) > 12
    assert not [row for row in rows if row not in results]


# ---- configuration ---------------------------------------------------------------------------------------------------


def structs(kind: Any = Config, path: str = "") -> Iterator[tuple[str, Any]]:
    """(path, struct) of every table of the configuration."""
    yield path, kind
    for name, hint in get_type_hints(kind, include_extras=True).items():
        inside = hint if table_of(hint) is not None else _element(hint)
        if inside is not None and table_of(inside) is not None:
            yield from structs(table_of(inside), f"{path}.{name}" if path else name)


def _element(hint: Any) -> Any:
    while get_origin(hint) is not tuple and get_args(hint) and not isinstance(hint, type):
        hint = get_args(hint)[0]
    return get_args(hint)[0] if get_origin(hint) is tuple else None


def described() -> dict[str, set[str]]:
    """By heading, the keys that are described under it, in lists and in examples."""
    found: dict[str, set[str]] = {}
    heading = ""
    for line in TEXTS["configuration"].splitlines():
        if line.startswith("### "):
            heading = line.strip("#`[] ")
        found.setdefault(heading, set()).update(re.findall(r"^(?:- |  )`([a-z][a-z0-9_]*)`:", line))
        found.setdefault("examples", set()).update(re.findall(r"\b([a-z][a-z0-9_]*) = ", line))
        # Of the keys of a profile the comment has a list.
        listed = re.match(r" *((?:[a-z0-9_]+, )*[a-z0-9_]+): ", line.replace("\\", ""))
        found["examples"].update(listed[1].split(", ") if listed else ())
    return found


@pytest.mark.parametrize(("path", "kind"), [(path, kind) for path, kind in structs() if path], ids=str)
def test_every_key_is_described(path: str, kind: Any) -> None:
    found = described()
    keys = {field.encode_name for field in msgspec.structs.fields(kind)}
    tables_within = {key for key in keys if any(other == f"{path}.{key}" for other, _ in structs())}
    own = found.get(path, set())
    missing = keys - tables_within - own - found["examples"]
    assert not missing
    # What stands as a table of its own is described there, not by an example elsewhere.
    if path in found:
        assert keys - tables_within <= own


def test_defaults_stand_as_the_file_has_them() -> None:
    """The file's own test holds them against the code."""
    for line in (data_directory() / "heaved.toml").read_text().splitlines():
        key = configuration.KEY.fullmatch(line)
        if key is not None and key[1]:
            value, remark = configuration.split_value(key[3])
            assert f"`{key[2]}`: default `{value}`" in TEXTS["configuration"], line
            words = re.sub(r"\\(.)", r"\1", TEXTS["configuration"])
            assert remark in words


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1.0                 # m, 0..1", ("1.0", "m, 0..1")),
        ('"a#b"               # text', ('"a#b"', "text")),
        ("[1, 2]", ("[1, 2]", "")),
        ('{ a = "#" }', ('{ a = "#" }', "")),
    ],
)
def test_a_value_ends_where_its_comment_begins(text: str, expected: tuple[str, str]) -> None:
    assert configuration.split_value(text) == expected


def test_examples_of_a_comment_stand_as_they_are() -> None:
    made = configuration.reference(
        "# ---- some ------------------------------------\n[t]\n# What *it* is:\n#\n#     a = 1  # x\n#\n# Goes on.\n"
        "#k = 2  # s, 1..3\n"
    )
    assert made.strip().splitlines() == [
        "## Some", "", "### `[t]`", "", "- `k`: default `2`; s, 1..3", "",
        "  What \\*it\\* is:", "", "  ```toml", "  a = 1  # x", "", "  ```", "", "  Goes on.",
    ]  # fmt: skip


# ---- words of the code -----------------------------------------------------------------------------------------------


def text_of(node: ast.AST) -> str | None:
    """A constant or f-string, its fields as ``…``."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
    return None


def sentences(node: ast.AST) -> Iterator[str]:
    """Texts of two words and more that may reach people: no docstrings, no exceptions."""
    for child in ast.iter_child_nodes(node):
        is_docstring = isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant)
        if is_docstring or isinstance(child, ast.Raise | ast.Assert):
            continue
        text = text_of(child)
        if text is None:
            yield from sentences(child)
        elif " " in text.strip():
            yield text


NOT_REASONS = {
    # Names of what a remembered state holds, in the log when it is of no use.
    "heave/saved_state.py",
    # Why a fit of the sea came to nothing, in the log.
    "heave/sea/refit.py",
    # Names of the columns of a fit.
    "imu/leaks.py",
    # Names of sets of points.
    "common/sigma.py",
}
NO_REASON = {": …", "… chains of … resonators", "… chains of …", "… in …..… Hz", "wind sea", "cm/s2 or in mg"}
"""Parts and descriptions of models."""


def reasons() -> dict[str, str]:
    """Every text that estimation may say, by its place."""
    base = ROOT / "heaved" / "estimation"
    return {
        text: place
        for path in sorted(base.rglob("*.py"))
        if (place := str(path.relative_to(base))) not in NOT_REASONS
        for text in sentences(ast.parse(path.read_text()))
        if text not in NO_REASON
    }


def test_every_reason_is_explained() -> None:
    """One that is missing is either to be explained in ``reasons.md``, or no reason: then it is named above."""
    told = set(re.findall(r"`([^`]+)`", TOPICS["reasons"].source))
    found = reasons()
    assert len(found) > 50
    assert not {text: place for text, place in found.items() if text not in told}


def test_no_reason_is_explained_that_nobody_gives() -> None:
    given = set(reasons())
    for path in ("outputs/motion.py", "outputs/http.py", "daemon/status.py", "samples.py"):
        given |= set(sentences(ast.parse((ROOT / "heaved" / path).read_text())))
    given |= {"vibration: seen at …", "not finite", "beyond physics"}
    heads = re.findall(r"^- ((?:`[^`]+`(?:, |,? and )?)+)", TOPICS["reasons"].source, re.MULTILINE)
    told = {word for head in heads for word in re.findall(r"`([^`]+)`", head) if " " in word}
    assert not told - given


@pytest.mark.parametrize(
    "words", [HeaveState, LaserState, CorrectionState, HullWarning, Caution], ids=lambda w: w.__name__
)
def test_every_state_is_explained(words: Any) -> None:
    told = set(re.findall(r"`([^`]+)`", TEXTS["reasons"]))
    assert {word.value for word in words} <= told


def test_every_fault_has_a_remedy() -> None:
    told = set(re.findall(r"`([^`]+)`", FENCES.sub("", TEXTS["wiring"])))
    assert {fault.value for fault in Fault if fault is not Fault.NONE} <= told


LEVELS = ("info", "warning", "error", "critical")


def events() -> set[str]:
    """What is logged, by the daemon and the page."""
    found = set()
    for path in (ROOT / "heaved").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Call) or not node.args:
                continue
            function = node.func
            is_log = (
                isinstance(function, ast.Attribute)
                and function.attr in LEVELS
                and ast.unparse(function.value) == "_log"
            )
            is_event = isinstance(function, ast.Name) and function.id == "Event"
            text = text_of(node.args[1 if is_event else 0]) if is_log or is_event else None
            if text is not None:
                found.add(text)
    return found


def test_every_event_of_the_log_is_explained() -> None:
    told = set(re.findall(r"`([^`]+)`", TOPICS["messages"].source))
    found = events()
    assert len(found) > 35
    assert not found - told


def test_every_exit_code_is_explained() -> None:
    codes = {str(value) for name, value in vars(common).items() if name.startswith("EX_")}
    rows = [line.split("|")[1].strip() for line in TOPICS["messages"].source.splitlines() if line.startswith("| ")]
    assert codes <= set(rows)


def test_search_finds_a_line_with_its_heading() -> None:
    (found,) = search(TEXTS["configuration"], "configuration", "Corner of the sensor's own")
    assert found.heading == "[[device]]"
    assert not search(TEXTS["configuration"], "configuration", "no such words")
    # A comment in a block of code is no heading.
    hits = search("## A\n```toml\n# not a heading\nkey\n```\n", "t", "key")
    assert [hit.heading for hit in hits] == ["A"]
