"""What the commands share: options of several, exit codes, and how things are said."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from heaved.text import printable_lines

if TYPE_CHECKING:
    import ssl

    from heaved.config import Config
    from heaved.devices.profile import DeviceSpec
    from heaved.replay.replay import Progress

EX_UNAVAILABLE = 69
"""The daemon cannot be reached (sysexits.h)."""
EX_IOERR = 74
"""Nobody takes what is printed (sysexits.h)."""
EX_NOPERM = 77
"""It needs rights that the user has not (sysexits.h)."""
EX_CONFIG = 78
"""The configuration has faults (sysexits.h)."""

SYSTEM_CONFIG = Path("/etc/heaved/heaved.toml")


class LogFormat(StrEnum):
    """How events are logged."""

    human = "human"
    json = "json"


class LinkKind(StrEnum):
    """How simulated devices are reached."""

    tcp = "tcp"
    rtu = "rtu"


Host = Annotated[str, typer.Option(help="Where the daemon's stream is.")]
Port = Annotated[int, typer.Option(min=1, max=65535)]
TlsCa = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", envvar="HEAVED_TLS_CA", help="Speak TLS with the daemon, whose certificate this one has signed."
    ),
]
TlsCert = Annotated[
    Path | None, typer.Option(metavar="FILE", envvar="HEAVED_TLS_CERT", help="Our certificate, which it wants to see.")
]
TlsKey = Annotated[
    Path | None, typer.Option(metavar="FILE", envvar="HEAVED_TLS_KEY", help="Its key, if that file has it not.")
]
Logs = Annotated[LogFormat, typer.Option(help="Logs go to standard error, one line per event.")]
SeaName = Annotated[
    str,
    typer.Option(
        help="T1 T2 T3 (regular), S4 S5 S6 (sea states), S6S, SL (swell), SX, CRAFT, S0 (still); S6S-bow-0.8 and "
        "the like come from many directions."
    ),
]
ShakeName = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="What shakes the sensors besides: line-3.1, engines, broadband, whipping, slams, turn and others; "
        "an unknown one lists them.",
    ),
]
HOST, PORT = "127.0.0.1", 5570


def load_to_run(path: Path) -> Config:
    """A configuration that a daemon can run on; else its faults are said, and the command ends."""
    from heaved.config.read import ConfigError
    from heaved.config.read import load_to_run as read_to_run

    try:
        return read_to_run(path)
    except ConfigError as error:
        fail(str(error), EX_CONFIG)


def load(path: Path) -> Config:
    """A sound configuration, with devices or without; else its faults are said, and the command ends."""
    from heaved.config.read import ConfigError
    from heaved.config.read import load as read

    try:
        return read(path)
    except ConfigError as error:
        fail(str(error), EX_CONFIG)


def device_line(device: DeviceSpec) -> str:
    """Name, role and place of a device."""
    asked = f" id {device.device_id}" if device.is_asked else ""
    return f"{device.name} ({device.role}): {device.link}{asked}"


def tls_of(ca: Path | None, certificate: Path | None, key: Path | None) -> ssl.SSLContext | None:
    """How TLS is spoken with a daemon, None: not at all; files that cannot be used end the command."""
    if ca is None:
        if certificate is not None or key is not None:
            fail("--tls-cert, --tls-key: TLS is spoken with --tls-ca: give it, too", 1)
        return None
    if key is not None and certificate is None:
        fail("--tls-key: is the key of a certificate: give --tls-cert, too", 1)
    from heaved.outputs.credentials import tls_context

    try:
        return tls_context(str(ca), str(certificate or ""), str(key or ""))
    except ValueError as error:
        fail(str(error), 1)


@contextmanager
def progress_bar(what: str = "replay") -> Iterator[Progress | None]:
    """A bar on standard error if that is a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress as Bar

    with Bar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def fail(message: str, code: int) -> NoReturn:
    """Say why, and end the command."""
    say(printable_lines(message), err=True)
    raise typer.Exit(code)


def say(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print. Who reads it may have gone, or its disk be full: that ends the command, if it was its output."""
    stream = sys.stderr if err else sys.stdout
    try:
        typer.echo(text, err=err, nl=nl)
    except OSError as error:
        # What is still buffered cannot be written either: the interpreter would try, and say so, as it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        if err:
            return
        if not isinstance(error, BrokenPipeError):
            say(f"standard output: cannot be written: {error.strerror or error}", err=True)
        raise typer.Exit(EX_IOERR) from error
