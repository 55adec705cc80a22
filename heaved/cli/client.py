"""Asking a daemon, and looking at it."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from heaved.cli.common import (
    EX_UNAVAILABLE,
    HOST,
    PORT,
    Host,
    LogFormat,
    Logs,
    Port,
    TlsCa,
    TlsCert,
    TlsKey,
    fail,
    say,
    tls_of,
)


def status(
    json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
    check: Annotated[
        bool, typer.Option("--check", help="One line and exit code 0/1/2/3 = OK/WARNING/CRITICAL/UNKNOWN.")
    ] = False,
    host: Host = HOST,
    port: Port = PORT,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """Say how a daemon is. Answers within a second; exit code 69 if there is none."""
    from heaved.client import report
    from heaved.client.stream_client import Snapshot, UnreachableError, fetch_status

    if json and check:
        raise typer.BadParameter("--json and --check exclude each other")
    tls = tls_of(tls_ca, tls_cert, tls_key)
    result: Snapshot | UnreachableError
    try:
        result = fetch_status(host, port, tls=tls)
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
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """Wait until a daemon gives a heave that can be used."""
    from heaved.client.stream_client import UnreachableError, fetch_status, wait_until_ready

    tls = tls_of(tls_ca, tls_cert, tls_key)
    if wait_until_ready(host, port, timeout, tls):
        return
    try:
        quality = fetch_status(host, port, tls=tls).status.quality
    except UnreachableError as error:
        fail(str(error), EX_UNAVAILABLE)
    reasons = f" ({', '.join(quality.reasons)})" if quality.reasons else ""
    fail(f"{host}:{port}: not ready after {timeout:g} s: heave {quality.heave.value}{reasons}", 1)


def watch(
    host: Host = HOST, port: Port = PORT, tls_ca: TlsCa = None, tls_cert: TlsCert = None, tls_key: TlsKey = None
) -> None:
    """Show the motion live in the terminal, until Ctrl-C."""
    from heaved.client.screen import watch

    if not sys.stdout.isatty() or os.environ.get("TERM") in ("dumb", "unknown"):
        fail(f"watch draws on a terminal, and this is none; for the data itself read the stream: nc {host} {port}", 1)
    try:
        watch(host, port, sys.stdout, tls_of(tls_ca, tls_cert, tls_key))
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
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
    cert: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Serve https, with this certificate, --key and --client-ca."),
    ] = None,
    key: Annotated[Path | None, typer.Option(metavar="FILE", help="Its key.")] = None,
    client_ca: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Who has signed the certificate that a browser must show.")
    ] = None,
    log_format: Logs = LogFormat.human,
) -> None:
    """Serve a web page that shows the motion, until Ctrl-C. Only another client of the stream; nothing can be set."""
    import asyncio

    from heaved.daemon.logs import configure_logging
    from heaved.outputs.tls import TlsParams
    from heaved.page.server import PageError, PageServer, serve

    tls = tls_of(tls_ca, tls_cert, tls_key)
    files = [str(file) if file else "" for file in (cert, key, client_ca)]
    if any(files) and not all(files):
        fail("--cert, --key, --client-ca: https takes all three", 1)
    own = TlsParams(certificate_file=files[0], key_file=files[1], client_ca_file=files[2]) if all(files) else None
    with configure_logging(log_format.value).in_background():
        try:
            server = PageServer(
                host=host, port=port, allow=allow or (), stream_host=stream_host, stream_port=stream_port,
                stream_tls=tls, files=own,
            )  # fmt: skip
            asyncio.run(serve(server, lambda address: say(f"page {address}")))
        except PageError as error:
            fail(str(error), 1)
