"""The command line. What a command needs is imported inside it: ``heaved status`` must be quick.

One module for each kind of command; ``heaved --help`` shows them in the order in which they stand here.
"""

from __future__ import annotations

import os
from typing import Annotated

import typer

from heaved import __version__
from heaved.cli import calibrate, client, daemon, probe, recordings, service, simulation
from heaved.cli.common import say

# Before numpy is loaded: its matrices are tiny here, and a second BLAS thread costs milliseconds when it wakes.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

app = typer.Typer(
    name="heaved",
    help="Real-time heave and roll/pitch prediction for crane vessels.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    try:
        result = app(arguments, prog_name="heaved", standalone_mode=False)
    except _UsageError as error:
        error.show()  # type: ignore[attr-defined]
        return 1  # Not click's 2, which would be CRITICAL for whoever runs status --check.
    except (typer.Abort, KeyboardInterrupt):
        return 130
    return result if isinstance(result, int) else 0


_UsageError: type[Exception] = typer.BadParameter.__mro__[1]
"""What a command line that is not understood raises. Typer brings its own click and exports only some of it."""


def _print_version(wanted: bool) -> None:
    if wanted:
        say(f"heaved {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Take the options that stand before a command."""


for _command in (
    daemon.run,
    daemon.check_config,
    client.status,
    client.wait,
    client.watch,
    client.page,
    probe.probe,
    calibrate.calibrate,
    service.install_service,
    service.manual,
    recordings.replay,
    recordings.export,
    recordings.report,
    recordings.backtest,
    simulation.demo,
    simulation.sim,
):
    app.command()(_command)
