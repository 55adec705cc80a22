"""What has been recorded: run again, exported, reported, compared."""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import Annotated

import typer

from heaved.cli.common import EX_UNAVAILABLE, fail, load, progress_bar, say
from heaved.text import printable, printable_lines


def replay(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="A CSV with t_s, az_mps2 and what else was measured; or the directory of a daemon's [recording], or a "
            "file of it.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Result; IN.heaved.csv beside it by default, - for standard output."),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            help="Parameters of the estimators, no device is needed; by default those that a daemon recorded, with "
            "what it had learned."
        ),
    ] = None,
    until: Annotated[float | None, typer.Option(min=0.0, help="Stop after so many seconds of the recording.")] = None,
    learn_anew: Annotated[
        bool, typer.Option("--learn-anew", help="Do not take the models of a daemon's recording: learn from it again.")
    ] = False,
) -> None:
    """Run a recording through the daemon's pipeline: causal, and the same to the byte every time.

    Of a daemon's recording the frames come out as the daemon published them.
    """
    parameters = None if config is None else load(config)
    from heaved.devices.recording import RecordingError
    from heaved.recorder.found import RecordedError
    from heaved.replay.replay import OutputError
    from heaved.replay.replay import replay as run_replay

    target = _beside(recording, ".heaved.csv") if out is None else out
    to_stdout = target == Path("-")
    try:
        with progress_bar() as progress:
            summary = run_replay(
                recording,
                None if to_stdout else target,
                parameters,
                learn_anew=learn_anew,
                until_s=inf if until is None else until,
                progress=progress,
            )
    except (RecordingError, RecordedError, OutputError, OSError) as error:
        fail(str(error), 1)
    say(str(summary), err=True)
    if out is None:
        say(f"written to {target}", err=True)


def export(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="The directory of a daemon's [recording], or a file of it.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="OUT.csv or OUT.nc (netCDF); - for CSV on standard output.")],
    every: Annotated[float, typer.Option(min=0.0, help="Seconds; the first frame in each such span, 0: all.")] = 0.0,
    columns: Annotated[
        str, typer.Option(help="Names, with commas between; all for every one; by default those of a replay.")
    ] = "",
    json: Annotated[bool, typer.Option("--json", help="Say what was written as one JSON object.")] = False,
) -> None:
    """Write what a daemon has recorded as CSV or netCDF, with UTC."""
    import msgspec

    from heaved.recorder.found import RecordedError
    from heaved.replay.export import export as run_export
    from heaved.replay.replay import OutputError

    names = [name.strip() for name in columns.split(",") if name.strip()]
    try:
        with progress_bar("export") as progress:
            done = run_export(recording, out, columns=names, every_s=every, progress=progress)
    except (RecordedError, OutputError) as error:
        fail(str(error), 1)
    to_stderr = not json or out == Path("-")
    say(msgspec.json.encode(done).decode() if json else printable_lines(str(done)), err=to_stderr)


def report(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="As for replay.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="The page; FILE.report.html beside it by default.")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="Parameters of the estimators, as for replay.")] = None,
    png: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write the figures into this directory, too, as PNG.")
    ] = None,
    until: Annotated[float | None, typer.Option(min=0.0, help="Stop after so many seconds of the recording.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the numbers as one JSON object.")] = False,
) -> None:
    """Make a page of a recording: what the sea was, how well what was known, and what was wrong."""
    import shlex
    from datetime import UTC, datetime

    parameters = None if config is None else load(config)
    from heaved.devices.recording import RecordingError
    from heaved.recorder.found import RecordedError
    from heaved.report.report import ReportError, json_text
    from heaved.report.report import report as make_report

    target = _beside(recording, ".report.html") if out is None else out
    options = [
        *(["--config", str(config)] if config else []),
        *(["--until", f"{until:g}"] if until is not None else []),
    ]
    try:
        with progress_bar() as progress:
            found = make_report(
                recording,
                target,
                parameters,
                made=datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC"),
                command=shlex.join(["heaved", "report", str(recording), *options]),
                config_name="" if config is None else config.name,
                png_directory=png,
                until_s=inf if until is None else until,
                progress=progress,
            )
    except (RecordingError, RecordedError, ReportError, OSError) as error:
        fail(str(error), 1)
    if json:
        say(json_text(found))
    say(f"written to {target}", err=True)


def backtest(
    directory: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="Holds recordings, CSV or those of daemons; directories within, too."),
    ],
    config: Annotated[
        list[Path] | None,
        typer.Option(
            help="A configuration to test, as for replay; may be repeated, to compare them with the first. By default "
            "that of each recording."
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="tcp://host:8786: the workers of a Dask scheduler, which must see both directories under the same "
            "path; by default processes of this machine.",
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes of this machine; as many as processors by default.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Directory of the results; DIR.backtest beside it by default.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Say what was done as one JSON object.")] = False,
) -> None:
    """Run an archive of recordings through the pipeline with some configurations, side by side.

    Makes backtest.parquet (a row for each recording and configuration) and backtest.html. What is done is kept: the
    same command goes on where it was ended, and does again only what has changed. Exit code 1 if a recording failed.
    """
    import shlex
    from datetime import UTC, datetime

    import msgspec

    from heaved.backtest.backtest import backtest as run_backtest
    from heaved.backtest.backtest import named
    from heaved.backtest.units import BacktestError, UnreachableError

    if scheduler is not None and workers is not None:
        raise typer.BadParameter("--scheduler and --workers exclude each other: it has its own")
    target = _beside(directory, ".backtest") if out is None else out
    command = ["heaved", "backtest", str(directory), "-o", str(target)]
    for file in config or ():
        command += ["--config", str(file)]
    try:
        configs = {name: load(file) for name, file in named(config or []).items()}
        with progress_bar("backtest") as progress:
            summary = run_backtest(
                directory,
                target,
                configs,
                scheduler=scheduler,
                workers=workers,
                made=datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC"),
                command=shlex.join(command),
                progress=progress,
            )
    except UnreachableError as error:
        fail(str(error), EX_UNAVAILABLE)
    except BacktestError as error:
        fail(str(error), 1)
    except KeyboardInterrupt:
        fail("ended: what is done is kept, and the same command does the rest", 130)
    if json:
        say(msgspec.json.encode(summary).decode())
    say(printable_lines(str(summary)), err=True)
    say(f"written to {printable(summary.page)} and {printable(summary.table)}", err=True)
    if summary.failed:
        raise typer.Exit(1)


def _beside(recording: Path, ending: str) -> Path:
    """The file beside a recording that is called like it."""
    whole = recording.resolve()
    return whole.with_name(f"{whole.name if whole.is_dir() else whole.stem}{ending}")
