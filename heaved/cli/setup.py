"""From a box to a service."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from heaved.cli.common import EX_UNAVAILABLE, fail, say
from heaved.text import printable


def probe(
    link: Annotated[str, typer.Argument(metavar="LINK", help="tcp://host:port or rtu:///dev/ttyUSB0?baudrate=9600")],
    ids: Annotated[str, typer.Option(help="Device ids to ask, such as 1-16,80.")] = "1-247",
    timeout: Annotated[float, typer.Option(min=0.01, max=10.0, help="Seconds to wait for an answer.")] = 0.1,
) -> None:
    """Find Modbus devices on a line and the profiles that fit them. Only reads; the daemon must not use the line."""
    import asyncio

    from heaved.config.read import packaged_profiles
    from heaved.devices import probe as probing
    from heaved.links import parse_link

    try:
        wanted, parsed = probing.parse_ids(ids), parse_link(link)
    except ValueError as error:
        fail(str(error), 1)

    def asking(device_id: int) -> None:
        if sys.stderr.isatty():
            say(f"\rasking id {device_id} ", err=True, nl=False)

    try:
        report = asyncio.run(probing.probe(parsed, wanted, packaged_profiles(), timeout, asking))
    except ConnectionError as error:
        fail(f"{link}: {error}", EX_UNAVAILABLE)
    if sys.stderr.isatty():
        say("\r\x1b[K", err=True, nl=False)
    for line in report.lines:
        say(printable(line))
    for hint in report.hints:
        say(printable(f"{link}: {hint}"), err=True)
    if not report.lines:
        fail(
            f"{link}: nobody answers within {timeout:g} s; check id, baud rate, parity and wiring (A and B swapped?), "
            "and raise --timeout for a slow device",
            EX_UNAVAILABLE,
        )
