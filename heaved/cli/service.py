"""The manual, and the daemon as a service of the machine."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heaved.cli.common import EX_CONFIG, EX_NOPERM, fail, say
from heaved.text import printable

if TYPE_CHECKING:
    from heaved.setup.service import Plan


def install_service(
    config: Annotated[
        Path | None,
        typer.Option(help="Configuration to install; without it, the one in /etc/heaved, else the default."),
    ] = None,
    write: Annotated[bool, typer.Option("--write", help="Make the files; without it they are only shown.")] = False,
    remove: Annotated[
        bool,
        typer.Option("--remove", help="Stop the service and take away what was made; configuration and state stay."),
    ] = False,
    root: Annotated[
        Path,
        typer.Option(metavar="DIR", help="Below this directory, as of another machine's root; nothing is started."),
    ] = Path("/"),
    program: Annotated[
        Path | None, typer.Option(metavar="PATH", help="What the service runs; this program by default.")
    ] = None,
) -> None:
    """Make heaved a service of systemd: unit, permitted networks, lasting names of adapters, configuration."""
    from heaved.config.read import ConfigError
    from heaved.setup import service
    from heaved.setup.adapters import adapters

    is_here = root.resolve() == Path("/")
    if write and remove:
        raise typer.BadParameter("--write and --remove exclude each other")
    if (write or remove) and is_here and os.geteuid() != 0:
        options = " ".join(sys.argv[2:])
        fail(f"this needs root: sudo {Path(sys.prefix) / 'bin' / 'heaved'} install-service {options}", EX_NOPERM)
    run = _run_command if is_here and Path("/run/systemd/system").is_dir() else _leave_command
    chosen = program or Path(sys.prefix) / "bin" / "heaved"
    try:
        if remove:
            for line in service.remove(root, run):
                say(printable(line))
            return
        wanted = service.plan(source=config, root=root, program=chosen, plugged=adapters() if is_here else ())
        if write and is_here and (faults := service.program_faults(chosen)):
            fail("\n".join(faults), 1)
        done = service.write(wanted, root, run) if write else None
    except ConfigError as error:
        fail(str(error), EX_CONFIG)
    except service.ServiceError as error:
        fail(str(error), 1)
    _say_plan(wanted, done)


def _say_plan(wanted: Plan, done: list[str] | None) -> None:
    """What was done, or, None, what would be; then what is to be known and done next."""
    if done is None:
        for file in wanted.files:
            say(f"# {file.path}: {file.said}\n{file.text}")
        say("Nothing was written; with --write these files are made.")
    for line in done or ():
        say(printable(line))
    for note in wanted.notes:
        say(printable(f"  {note}"))
    say("next:")
    for step in wanted.next_steps:
        say(printable(f"  {step}"))


def _run_command(command: Sequence[str]) -> None:
    """systemctl or udevadm; where it fails, what is to be done by hand."""
    try:
        failed = subprocess.run(command, check=False).returncode != 0  # noqa: S603  # Our own words, no shell.
    except OSError:
        failed = True
    if failed:
        say(f"{' '.join(command)}: failed; do it again by hand", err=True)


def _leave_command(_: Sequence[str]) -> None:
    """For another machine, or one without systemd."""


def manual(
    topic: Annotated[str | None, typer.Argument(metavar="TOPIC", help="Such as first-hour or reasons.")] = None,
    list_topics: Annotated[bool, typer.Option("--list", help="Topics, and what each is about.")] = False,
    search: Annotated[
        str | None, typer.Option(metavar="WORD", help="Lines that hold it, of all topics or of one.")
    ] = None,
) -> None:
    """Show the manual: how to begin, what each reason means, every key, telegrams, registers, the method."""
    from heaved.cli.described import tables
    from heaved.manual import topics as manual_topics
    from heaved.manual.screen import show

    known = manual_topics.topics()
    if list_topics:
        wide = max(map(len, known))
        for one in known.values():
            say(f"{one.name:{wide}}  {one.summary}")
        return
    if topic is not None and topic not in known:
        close = [name for name in known if name.startswith(topic)] or [name for name in known if topic in name]
        if len(close) != 1:
            fail(f"no topic {topic!r}; topics: {', '.join(close or known)}; or heaved manual --search {topic}", 1)
        (topic,) = close
    if search is None:
        show(manual_topics.filled(known[topic or manual_topics.INDEX], tables()), sys.stdout)
        return
    among = [known[topic]] if topic is not None else list(known.values())
    found = [
        hit for one in among for hit in manual_topics.search(manual_topics.filled(one, tables()), one.name, search)
    ]
    for hit in found:
        say(f"{hit.topic}: {hit.heading}: {hit.line}")
    if not found:
        fail(f"nothing about {search!r}; heaved manual --list has the topics", 1)
