"""Asking a daemon, and looking at it."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from heaved.cli.common import EX_UNAVAILABLE, HOST, PORT, Host, LogFormat, Logs, Port, fail, say


def status(
    json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
    check: Annotated[
        bool, typer.Option("--check", help="One line and exit code 0/1/2/3 = OK/WARNING/CRITICAL/UNKNOWN.")
    ] = False,
    host: Host = HOST,
    port: Port = PORT,
) -> None:
    """Say how a daemon is. Answers within a second; exit code 69 if there is none."""
    from heaved.client import report
    from heaved.client.stream_client import Snapshot, UnreachableError, fetch_status

    if json and check:
        raise typer.BadParameter("--json and --check exclude each other")
    result: Snapshot | UnreachableError
    try:
        result = fetch_status(host, port)
    except UnreachableError as error:
        result = error
    if check:
        state, line = report.check_line(result)
        say(line)
        raise typer.Exit(int(state))
    if json:
        say(report.json_text(result))
    elif isinstance(result, Snapshot):
        say(report.table(result))
    else:
        say(str(result), err=True)
    if isinstance(result, UnreachableError):
        raise typer.Exit(EX_UNAVAILABLE)


def wait(
    timeout: Annotated[float, typer.Option(min=0.0, help="Seconds to wait at most.")] = 60.0,
    host: Host = HOST,
    port: Port = PORT,
) -> None:
    """Wait until a daemon gives a heave that can be used."""
    from heaved.client.stream_client import UnreachableError, fetch_status, wait_until_ready

    if wait_until_ready(host, port, timeout):
        return
    try:
        quality = fetch_status(host, port).status.quality
    except UnreachableError as error:
        fail(str(error), EX_UNAVAILABLE)
    reasons = f" ({', '.join(quality.reasons)})" if quality.reasons else ""
    fail(f"{host}:{port}: not ready after {timeout:g} s: heave {quality.heave.value}{reasons}", 1)


def watch(host: Host = HOST, port: Port = PORT) -> None:
    """Show the motion live in the terminal, until Ctrl-C."""
    from heaved.client.screen import watch

    if not sys.stdout.isatty() or os.environ.get("TERM") in ("dumb", "unknown"):
        fail(f"watch draws on a terminal, and this is none; for the data itself read the stream: nc {host} {port}", 1)
    try:
        watch(host, port, sys.stdout)
    except KeyboardInterrupt:
        return


def page(
    host: Annotated[str, typer.Option(help="Where the page is served.")] = HOST,
    port: Annotated[int, typer.Option(min=1, max=65535)] = 8570,
    stream_host: Annotated[str, typer.Option(help="Where the daemon's stream is.")] = HOST,
    stream_port: Port = PORT,
    allow: Annotated[
        list[str] | None,
        typer.Option(metavar="NETWORK", help="Who may look, besides this machine: 192.168.10.0/24; may be repeated."),
    ] = None,
    log_format: Logs = LogFormat.human,
) -> None:
    """Serve a web page that shows the motion, until Ctrl-C. Only another client of the stream; nothing can be set."""
    import asyncio

    from heaved.daemon.logs import configure_logging
    from heaved.page.server import PageError, PageServer, serve

    with configure_logging(log_format.value).in_background():
        try:
            server = PageServer(
                host=host, port=port, allow=allow or (), stream_host=stream_host, stream_port=stream_port
            )
            asyncio.run(serve(server, lambda address: say(f"page {address}")))
        except PageError as error:
            fail(str(error), 1)
