"""Every command of the manual: run as it stands, run against a daemon, or, where it needs hardware, root or another
machine, held against the command line's own table of options.

Fences say which: ``console`` is run in a directory of its own, ``console live`` against a daemon on simulated sensors,
``console parse`` is parsed. What stands below a command is what it prints, ``...`` being anything. ``toml NAME`` is a
file of that name in the directory, and a sound configuration.
"""

from __future__ import annotations

import asyncio
import re
import shlex
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
import typer.main
from running import demo_config, plant_of, running, until

from heaved.cli import app
from heaved.config.read import load
from heaved.estimation.heave import params as heave
from heaved.manual.topics import topics

if TYPE_CHECKING:
    from collections.abc import Iterator

FENCE = re.compile(r"^```(\w+)(?: ([^\n]*))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
OTHERS = {
    "adduser", "curl", "id", "journalctl", "ls", "mbpoll", "mosquitto_sub", "nc", "openssl",
    "systemctl", "systemd-analyze",
}  # fmt: skip
"""Programs of the machine that the manual names."""
ATTEMPTS = 5
ROOT = Path(__file__).resolve().parents[2]


class Block(NamedTuple):
    topic: str
    kind: str
    how: str
    text: str


class Step(NamedTuple):
    command: str
    printed: str


BLOCKS = [Block(name, *match.groups("")) for name, topic in topics().items() for match in FENCE.finditer(topic.source)]
CONSOLES = [block for block in BLOCKS if block.kind == "console"]
FILES = [block for block in BLOCKS if block.kind == "toml" and block.how]


def steps(block: Block) -> Iterator[Step]:
    first, *rest = re.split(r"^\$ ", block.text, flags=re.MULTILINE)
    assert not first, f"{block.topic}: a block begins with a command"
    for one in rest:
        command, _, printed = one.partition("\n")
        yield Step(command, printed)


def named(block: Block) -> str:
    return f"{block.topic}: {block.text.splitlines()[0]}"


def prints(expected: str, printed: str) -> bool:
    """Whether it is that; ``...`` is anything, lines too, and spaces in a row are one."""
    words = [re.escape(" ".join(part.split())) for part in expected.split("...")]
    return re.fullmatch(".*".join(words), " ".join(printed.split()), re.DOTALL) is not None


def test_the_comparison_sees_a_difference() -> None:
    assert prints("a\n...\nd\n", "a\nb\nc\nd\n")
    assert prints("a  b ...", "a b  c")
    assert not prints("a\n...\nd\n", "a\nb\n")
    assert not prints("a", "a b")


def test_every_fence_says_what_it_is() -> None:
    kinds = {(block.kind, block.how if block.kind == "console" else "") for block in BLOCKS}
    assert kinds <= {("console", ""), ("console", "live"), ("console", "parse"), ("toml", ""), ("text", "")}
    assert {block.how for block in CONSOLES} == {"", "live", "parse"}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with the files of the manual, a recording of five seconds, and the command."""
    place = tmp_path_factory.mktemp("manual")
    for block in FILES:
        (place / block.how).write_text(block.text)
    rows = (f"{k / 20},{9.80665 + 0.1 * (k % 7 - 3)}\n" for k in range(100))
    (place / "rec.csv").write_text("t_s,az_mps2\n" + "".join(rows))
    (place / "bin").mkdir()
    command = place / "bin" / "heaved"
    command.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m heaved "$@"\n')
    command.chmod(0o755)
    return place


def run(command: str, place: Path) -> str:
    """What is printed, errors too. It must succeed."""
    done = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {command}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        cwd=place,
        timeout=60,
        env={"PATH": f"{place / 'bin'}:/usr/bin:/bin", "PYTHONPATH": str(ROOT), "HOME": str(place)},
    )
    assert done.returncode in (0, -13, 141), f"{command}: {done.stdout}"  # head may have seen enough.
    return done.stdout


def said(command: str, place: Path, expected: str) -> str:
    """The same of one that gives up when it is not answered within a second: a busy machine is asked again."""
    for _ in range(ATTEMPTS - 1):
        with suppress(AssertionError):
            printed = run(command, place)
            if prints(expected, printed):
                return printed
    return run(command, place)


@pytest.mark.parametrize("block", FILES, ids=lambda block: f"{block.topic}: {block.how}")
def test_configurations_are_sound(block: Block, place: Path) -> None:
    assert load(place / block.how).device


@pytest.mark.parametrize("block", [block for block in CONSOLES if not block.how], ids=named)
def test_commands_do_what_is_said(block: Block, place: Path) -> None:
    for step in steps(block):
        if step.command.startswith("openssl") and shutil.which("openssl") is None:
            pytest.skip("openssl is not installed")
        printed = run(step.command, place)
        assert not step.printed or prints(step.printed, printed), f"{step.command}: {printed}"


async def test_commands_to_a_daemon_do_what_is_said(place: Path, tmp_path: Path) -> None:
    # Not so long that the sea is fitted: a worker that has just begun would be in the way of the end.
    patient = heave.Params(sea=heave.SeaParams(first_fit_s=300.0))
    async with plant_of(demo_config(tmp_path, heave=patient)) as (_, config), running(config) as daemon:
        await until(daemon, lambda frame: frame["seq"] > 10)
        host, port = daemon.addresses["stream"]
        for step in (step for block in CONSOLES if block.how == "live" for step in steps(block)):
            there = re.sub(r"(heaved (?:status|wait))", rf"\1 --host {host} --port {port}", step.command)
            assert there != step.command
            # A monitoring state is no failure: what there is to say of a heave that has just begun.
            shown = there if "--check" not in there else f"({there}) || test $? -le 2"
            printed = await asyncio.to_thread(said, shown, place, step.printed)
            assert not step.printed or prints(step.printed, printed), f"{step.command}: {printed}"


def programs(command: str) -> Iterator[list[str]]:
    """The words of each program of a command line."""
    lexer = shlex.shlex(command, posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    words: list[str] = []
    for word in lexer:
        if set(word) <= set("|&;()"):
            yield words
            words = []
        else:
            words.append(word)
    yield words


def parse(words: list[str]) -> None:
    """Hold a command of ours against its own table.

    Raises:
        Exception: it is not understood.
    """
    group: Any = typer.main.get_command(app)
    name, *arguments = words
    with group.commands[name].make_context(name, arguments):
        pass


COMMANDS = [step.command for block in CONSOLES for step in steps(block)]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_is_understood(command: str) -> None:
    for words in programs(command):
        if words[0] == "sudo":
            words = words[1:]  # noqa: PLW2901
        if words[0] == "heaved":
            if not words[1].startswith("--"):
                parse(words[1:])
        else:
            assert words[0] in OTHERS | {"cat", "echo", "head"}, words[0]


@pytest.mark.parametrize("words", [["status", "--nonsense"], ["replay"], ["status", "--port", "x"]], ids=str)
def test_what_is_wrong_would_be_seen(words: list[str]) -> None:
    with pytest.raises(Exception, match=r"(?i)no such option|missing|valid"):
        parse(words)


def inline_commands() -> list[tuple[str, str]]:
    """Commands of ours within the text."""
    text_of = {name: FENCE.sub("", topic.source) for name, topic in topics().items()}
    return [(name, command) for name, text in text_of.items() for command in re.findall(r"`(heaved [a-z][^`]*)`", text)]


@pytest.mark.parametrize(("topic", "command"), inline_commands())
def test_commands_within_the_text_are_there(topic: str, command: str) -> None:
    """Their name and options; arguments may be left out."""
    group: Any = typer.main.get_command(app)
    name, *words = shlex.split(command)[1:]
    assert name in group.commands, f"{topic}: {command}"
    known = {option for parameter in group.commands[name].params for option in parameter.opts}
    assert {word for word in words if word.startswith("--")} <= known
