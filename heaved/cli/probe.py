"""Looking for sensors, and writing down what they are."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, get_args

import typer

from heaved.cli.common import EX_CONFIG, EX_UNAVAILABLE, fail, say
from heaved.text import printable, printable_lines

if TYPE_CHECKING:
    from heaved.links import Link, SerialLink
    from heaved.setup.probe import Tell, Wishes
    from heaved.setup.probe_report import Examined

_ROLE_HELP = "What the device is to be, such as imu or laser; an unknown one lists them."


def probe(
    link: Annotated[
        str | None,
        typer.Argument(
            metavar="[LINK]",
            help="tcp://host:port or rtu:///dev/ttyUSB0?baudrate=9600; without a baud rate it is looked for. "
            "Left out: the serial adapters of this machine are listed.",
        ),
    ] = None,
    scan: Annotated[
        bool, typer.Option("--scan", help="Try baud rates, parities and ids; without LINK on every adapter.")
    ] = False,
    ids: Annotated[
        str | None, typer.Option(help="Device ids to ask, such as 1-16,80. All by default, the usual ones first.")
    ] = None,
    timeout: Annotated[float, typer.Option(min=0.01, max=10.0, help="Seconds to wait for an answer.")] = 0.1,
    seconds: Annotated[
        float, typer.Option(min=0.0, max=1800.0, help="Measure what fits for so long; 0: do not.")
    ] = 10.0,
    rate: Annotated[
        float | None, typer.Option(min=0.01, max=1000.0, help="Polls a second that are planned; else what suits.")
    ] = None,
    live: Annotated[bool, typer.Option("--live", help="Registers and values side by side, until Ctrl-C.")] = False,
    registers: Annotated[
        str, typer.Option(help="Of a device that nobody knows: which registers to look for.")
    ] = "0-255",
    write: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Put the [[device]] at the end of this configuration.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Write without asking.")] = False,
    name: Annotated[str, typer.Option(help="Of the device; its role by default.")] = "",
    role: Annotated[str, typer.Option(help=_ROLE_HELP)] = "",
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
) -> None:
    """Find sensors and the profiles that fit them, measure them, and write their [[device]] tables.

    Only reads from devices; the daemon must not use the line meanwhile.
    """
    from heaved.devices.profile import Role
    from heaved.setup.probe import Wishes

    _refuse_odd_options(live=live, as_json=as_json, write=write, yes=yes)
    if link is None and not scan:
        _list_adapters(as_json=as_json)
    if role and role not in get_args(Role):
        fail(f"--role {role!r}: must be one of {', '.join(get_args(Role))}", 1)
    if write is not None:
        _refuse_faulty(write)
    wanted = _ids(ids)
    wishes = Wishes(
        ids=wanted[0], timeout_s=timeout, seconds=0.0 if live else seconds, rate_hz=rate, name=name,
        role=role or None,  # type: ignore[arg-type]  # It is one of them.
        registers=_registers(registers),
    )  # fmt: skip
    links, hints = _links(link, wanted[1], timeout, scan=scan, as_json=as_json)
    if live:
        _live(links, hints, wishes)
        return
    _report(links, hints, wishes, write, yes=yes, as_json=as_json)


def _refuse_odd_options(*, live: bool, as_json: bool, write: Path | None, yes: bool) -> None:
    if live and (as_json or write is not None):
        fail("--live shows, and neither writes nor speaks JSON: leave one of them out", 1)
    if live and not sys.stdout.isatty():
        fail("--live needs a terminal on standard output", 1)
    if yes and write is None:
        fail("--yes says to what? Name the configuration: --write FILE", 1)
    if write is not None and not yes and not (sys.stdin.isatty() and sys.stdout.isatty()):
        fail("--write asks before it writes, and there is no terminal to answer on: add --yes", 1)


def _refuse_faulty(path: Path) -> None:
    """A file that could not be added to is named before anybody waits for a scan."""
    from heaved.setup.config_file import Addition, RefusedError

    try:
        Addition(path, "")
    except RefusedError as error:
        fail(str(error), EX_CONFIG)


def _ids(text: str | None) -> tuple[tuple[int, ...], tuple[int, ...] | None]:
    """Ids to ask, and those that the user has named, if any."""
    from heaved.devices.probe import parse_ids
    from heaved.setup.scan import ALL_IDS

    if text is None:
        return ALL_IDS, None
    try:
        named = parse_ids(text)
    except ValueError as error:
        fail(str(error), 1)
    return named, named


def _registers(text: str) -> tuple[int, int]:
    first, _, last = text.partition("-")
    try:
        low, high = int(first, 0), int(last or first, 0)
    except ValueError:
        low, high = -1, -1
    if not 0 <= low <= high <= 65535:
        fail(f"--registers {text!r}: write two numbers from 0 to 65535, such as 0-255 or 0x30-0x4F", 1)
    return low, high


def _list_adapters(*, as_json: bool) -> NoReturn:
    from heaved.setup.adapters import adapters
    from heaved.setup.probe_report import adapter_lines

    found = adapters()
    if as_json:
        _say_json({"adapters": found})
    for line in () if as_json else adapter_lines(found):
        say(line)
    if not found:
        fail(
            "no serial adapter is plugged in, or the kernel has no driver for it (dmesg says); one behind a gateway "
            "is asked by heaved probe tcp://host:502",
            EX_UNAVAILABLE,
        )
    if not as_json:
        say("heaved probe --scan looks at all of them; heaved probe rtu://PATH at one")
    raise typer.Exit(0)


# ---- where to look ---------------------------------------------------------------------------------------------------


def _links(
    text: str | None, ids: tuple[int, ...] | None, timeout_s: float, *, scan: bool, as_json: bool
) -> tuple[list[Link], list[str]]:
    """Lines with their settings, and what was noticed while they were looked for."""
    from heaved.links import SerialLink, TcpLink, parse_link

    if text is None:
        paths = _free_adapters()
    else:
        try:
            link = parse_link(text)
        except ValueError as error:
            fail(str(error), 1)
        if isinstance(link, TcpLink) and scan:
            fail(f"{text}: a TCP link has no baud rate to look for: leave --scan out", 1)
        if isinstance(link, TcpLink) or ("baudrate=" in text and not scan):
            return [link], []
        assert isinstance(link, SerialLink)
        paths = [link.path]
    links: list[Link] = []
    hints: list[str] = []
    for path in paths:
        found = _scanned(path, ids, timeout_s, hints, is_only=len(paths) == 1)
        if found is not None:
            links.append(found)
    if not links:
        if as_json:
            _say_json({"devices": [], "hints": hints})
        for hint in hints:
            say(printable(hint), err=True)
        fail(
            f"{', '.join(paths)}: nobody answers at any usual baud rate within {timeout_s:g} s; check power and wiring "
            "(A and B swapped?), try the other ids (--ids), and raise --timeout for a slow device",
            EX_UNAVAILABLE,
        )
    return links, hints


def _free_adapters() -> list[str]:
    """Paths of the adapters that can be asked; why others cannot is said."""
    from heaved.setup.adapters import adapters

    paths = []
    for adapter in adapters():
        if trouble := adapter.refusal or (f"in use: {', '.join(adapter.held_by)}" if adapter.held_by else ""):
            say(f"{adapter.path}: left out: {trouble}", err=True)
        else:
            paths.append(adapter.path)
    if not paths:
        fail("no serial adapter that could be asked (heaved probe lists them)", EX_UNAVAILABLE)
    return paths


def _scanned(
    path: str, ids: tuple[int, ...] | None, timeout_s: float, hints: list[str], *, is_only: bool
) -> SerialLink | None:
    """The line with the settings at which somebody answers."""
    import asyncio

    from heaved.config.read import packaged_profiles
    from heaved.setup.scan import plan
    from heaved.setup.scan import scan as look

    asked = plan(ids, timeout_s, packaged_profiles())
    bounds = f"at most {_long(asked.bound_s())}"
    if len(asked.rounds) > 1:
        bounds += f", the usual ids within {_long(asked.bound_s(1))}"
    say(f"{path}: {len(asked.settings)} settings, {asked.requests} requests: {bounds}; Ctrl-C ends it", err=True)
    try:
        with _telling() as tell:
            found = asyncio.run(look(path, asked, lambda done, total, what: tell(done, total, f"{path} {what}")))
    except ConnectionError as error:
        if is_only:
            fail(f"{path}: {error}", EX_UNAVAILABLE)
        hints.append(f"{path}: {error}")
        return None
    hints += [f"{path}: {note}" for note in found.notes]
    if found.link is not None:
        say(f"{path}: id {', '.join(map(str, found.ids))} at {found.link}", err=True)
    return found.link


def _long(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.0f} min"


# ---- what is found ---------------------------------------------------------------------------------------------------


def _report(
    links: list[Link], hints: list[str], wishes: Wishes, write: Path | None, *, yes: bool, as_json: bool
) -> None:
    from heaved.setup.config_file import taken_names
    from heaved.setup.device_table import link_text
    from heaved.setup.probe_report import lines, tree

    taken = set(taken_names(write)) if write is not None else set()
    everybody: list[Examined] = []
    for link in links:

        def found(examined: Examined) -> None:
            everybody.append(examined)
            if examined.table is not None:
                taken.add(examined.table.device.name)
            if not as_json:
                rate_hz = examined.table.device.rate_hz if examined.table is not None else wishes.rate_hz or 100.0
                for line in lines(examined, rate_hz):
                    say(printable(line))

        _examine(link, wishes, taken, hints, found, is_only=len(links) == 1)
    if as_json:
        _say_json({"devices": [{"link": link_text(one.device.link)} | tree(one) for one in everybody], "hints": hints})
    for hint in hints:
        say(printable(hint), err=True)
    if not everybody:
        fail(
            f"{', '.join(map(str, links))}: nobody answers within {wishes.timeout_s:g} s; check id, baud rate, parity "
            "and wiring (A and B swapped?), and raise --timeout for a slow device",
            EX_UNAVAILABLE,
        )
    if write is not None:
        _write(write, [one for one in everybody if one.table is not None], yes=yes, quiet=as_json)


def _examine(
    link: Link,
    wishes: Wishes,
    taken: Collection[str],
    hints: list[str],
    found: Callable[[Examined], None],
    *,
    is_only: bool,
) -> None:
    import asyncio

    from heaved.config.read import packaged_profiles
    from heaved.setup.adapters import beside_us
    from heaved.setup.probe import examine_line

    if sys.stderr.isatty():
        say(
            f"{link}: asking {len(wishes.ids)} ids: at most {_long(len(wishes.ids) * wishes.timeout_s + 1.0)}", err=True
        )
    if warning := beside_us(link):
        hints.append(f"{link}: {warning}")
    try:
        with _telling() as tell:
            told = asyncio.run(examine_line(link, wishes, packaged_profiles(), taken, tell, found))
    except ConnectionError as error:
        if is_only:
            fail(f"{link}: {error}", EX_UNAVAILABLE)
        told = [str(error)]
    hints += [f"{link}: {hint}" for hint in told]


def _say_json(value: dict[str, Any]) -> None:
    import msgspec

    from heaved.setup.probe_report import known_only

    say(msgspec.json.encode(known_only(msgspec.to_builtins(value))).decode())


def _tell_nobody(done: float, total: float, what: str) -> None:
    """Standard error is no terminal."""


@contextmanager
def _telling() -> Iterator[Tell]:
    """A bar on standard error if that is a terminal, which goes when all is done; else nothing is told."""
    if not sys.stderr.isatty():
        yield _tell_nobody
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, redirect_stdout=True) as bar:
        task = bar.add_task("", total=None, visible=False)
        yield lambda done, total, what: bar.update(
            task, completed=done, total=total if isfinite(total) else None, description=printable(what), visible=True
        )


# ---- live ------------------------------------------------------------------------------------------------------------


def _live(links: list[Link], hints: list[str], wishes: Wishes) -> None:
    import asyncio

    from heaved.setup.live import Screen, View
    from heaved.setup.probe import live_profile, watch

    everybody: list[Examined] = []
    for link in links:
        _examine(link, wishes, (), hints, everybody.append, is_only=len(links) == 1)
    for hint in hints:
        say(printable(hint), err=True)
    # What is known first; of several the first: --ids chooses.
    shown = sorted(everybody, key=lambda one: not one.device.findings)
    for one in shown:
        profile = live_profile(one)
        if profile is None:
            continue
        device = one.device
        view = View(f"id {device.device_id} on {device.link}: {profile.name} ({device.verdict})", profile)
        try:
            with Screen(view, sys.stdout) as screen:
                asyncio.run(watch(view, device.link, device.device_id, wishes, screen.push))
        except ConnectionError as error:
            fail(f"{device.link}: {error}", EX_UNAVAILABLE)
        return
    fail(f"{', '.join(map(str, links))}: nobody there has registers that could be shown", EX_UNAVAILABLE)


# ---- writing ---------------------------------------------------------------------------------------------------------


def _write(path: Path, everybody: list[Examined], *, yes: bool, quiet: bool) -> None:
    """Put the tables of all that were found at the end of a configuration."""
    from heaved.setup.config_file import Addition, RefusedError
    from heaved.setup.device_table import toml

    tables = [one.table for one in everybody if one.table is not None]
    proved = {table.device.role: table.device.device_id for table in tables if not table.doubt}
    for table in [one for one in tables if one.doubt and one.device.role in proved]:
        role, known = table.device.role, proved[table.device.role]
        say(f"id {table.device.device_id}: is not written: id {known} is the {role}, and this is a guess", err=True)
        tables.remove(table)
    text = "\n".join(map(toml, tables))
    if not text:
        fail(f"{path}: was left alone: there is no device that could be written", EX_CONFIG)
    try:
        addition = Addition(path, text)
        say(printable_lines(addition.diff), nl=False, err=quiet)
        for remark in addition.remarks:
            say(f"{path}: {printable(remark)}", err=True)
        if not yes and not typer.confirm(f"Write this to {path}?"):
            fail(f"{path}: was left alone", 1)
        addition.keep()
    except RefusedError as error:
        fail(str(error), EX_CONFIG)
    say(f"{path}: written; heaved check-config {path} says the rest", err=True)
