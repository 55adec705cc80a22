"""The command line. What a command needs is imported inside it: ``heaved status`` must be quick."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from heaved import __version__
from heaved.text import printable, printable_lines

if TYPE_CHECKING:
    from heaved.config import Config
    from heaved.devices.profile import DeviceSpec
    from heaved.replay.replay import Progress

EX_UNAVAILABLE = 69
"""The daemon cannot be reached (sysexits.h)."""
EX_IOERR = 74
"""Nobody takes what is printed (sysexits.h)."""
EX_CONFIG = 78
"""The configuration has faults (sysexits.h)."""

SYSTEM_CONFIG = Path("/etc/heaved/heaved.toml")

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
Logs = Annotated[LogFormat, typer.Option(help="Logs go to standard error, one line per event.")]
SeaName = Annotated[
    str, typer.Option(help="T1 T2 T3 (regular), S4 S5 S6 (sea states), S6S, SL (swell), SX, CRAFT, S0 (still).")
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
        _say(f"heaved {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Take the options that stand before a command."""


# ---- the daemon ------------------------------------------------------------------------------------------------------


@app.command()
def run(
    config: Annotated[
        Path | None, typer.Option(help=f"Configuration file; else {SYSTEM_CONFIG} if it is there.")
    ] = None,
    log_format: Logs = LogFormat.human,
) -> None:
    """Run the daemon until SIGTERM or SIGINT. SIGHUP reads the configuration again."""
    if config is None and not SYSTEM_CONFIG.exists():
        from heaved.config.read import data_directory

        _fail(
            f"no configuration: give one with --config FILE, or put one at {SYSTEM_CONFIG}; "
            f"the default to start from, with every key explained, is {data_directory() / 'heaved.toml'}",
            EX_CONFIG,
        )
    path = config or SYSTEM_CONFIG
    loaded = _load_to_run(path)
    from heaved.daemon import daemon

    raise typer.Exit(daemon.run(loaded, path, log_format=log_format.value))


@app.command("check-config")
def check_config(file: Annotated[Path, typer.Argument(metavar="FILE")]) -> None:
    """Check a configuration file: names every fault, and rates that a serial line cannot carry (exit code 78)."""
    config = _load_to_run(file)
    from heaved.config.rules import cautions, rate_faults
    from heaved.devices.bandwidth import bandwidth_hz, lag_ms

    if faults := rate_faults(config):
        _fail("\n".join(f"{file}: {fault}" for fault in faults), EX_CONFIG)
    _say(f"{file}: well")
    for device in config.device:
        hertz = bandwidth_hz(device)
        bandwidth = f", bandwidth {hertz:g} Hz (a lag of about {lag_ms(hertz):.0f} ms)" if hertz else ""
        _say(f"  {_device_line(device)}, {device.profile.name} at {device.rate_hz:g} Hz{bandwidth}")
    if not any(device.role == "imu" for device in config.device):
        _say('  no device of role "imu": enough for a replay, but the daemon would have no heave')
    for output in config.output:
        point = f" of {output.point}" if output.point else ""
        _say(f"  {output.name} (output): {output.link}, {output.telegram}{point} at {output.rate_hz:g} Hz")
    for name, table in (("registers", config.registers), ("mqtt", config.mqtt), ("influx", config.influx)):
        if table.enabled:
            _say(f"  [{name}]: {table.link}")
    for caution in cautions(config):
        _say(f"  caution: {printable(caution)}")


def _load_to_run(path: Path) -> Config:
    from heaved.config.read import ConfigError, load_to_run

    try:
        return load_to_run(path)
    except ConfigError as error:
        _fail(str(error), EX_CONFIG)


def _load(path: Path) -> Config:
    from heaved.config.read import ConfigError, load

    try:
        return load(path)
    except ConfigError as error:
        _fail(str(error), EX_CONFIG)


def _device_line(device: DeviceSpec) -> str:
    asked = f" id {device.device_id}" if device.is_asked else ""
    return f"{device.name} ({device.role}): {device.link}{asked}"


# ---- asking a daemon -------------------------------------------------------------------------------------------------


@app.command()
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
        _say(line)
        raise typer.Exit(int(state))
    if json:
        _say(report.json_text(result))
    elif isinstance(result, Snapshot):
        _say(report.table(result))
    else:
        _say(str(result), err=True)
    if isinstance(result, UnreachableError):
        raise typer.Exit(EX_UNAVAILABLE)


@app.command()
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
        _fail(str(error), EX_UNAVAILABLE)
    reasons = f" ({', '.join(quality.reasons)})" if quality.reasons else ""
    _fail(f"{host}:{port}: not ready after {timeout:g} s: heave {quality.heave.value}{reasons}", 1)


@app.command()
def watch(host: Host = HOST, port: Port = PORT) -> None:
    """Show the motion live in the terminal, until Ctrl-C."""
    from heaved.client.screen import watch

    if not sys.stdout.isatty() or os.environ.get("TERM") in ("dumb", "unknown"):
        _fail(f"watch draws on a terminal, and this is none; for the data itself read the stream: nc {host} {port}", 1)
    try:
        watch(host, port, sys.stdout)
    except KeyboardInterrupt:
        return


@app.command()
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
            asyncio.run(serve(server, lambda address: _say(f"page {address}")))
        except PageError as error:
            _fail(str(error), 1)


# ---- looking for devices ---------------------------------------------------------------------------------------------


@app.command()
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
        _fail(str(error), 1)

    def asking(device_id: int) -> None:
        if sys.stderr.isatty():
            _say(f"\rasking id {device_id} ", err=True, nl=False)

    try:
        report = asyncio.run(probing.probe(parsed, wanted, packaged_profiles(), timeout, asking))
    except ConnectionError as error:
        _fail(f"{link}: {error}", EX_UNAVAILABLE)
    if sys.stderr.isatty():
        _say("\r\x1b[K", err=True, nl=False)
    for line in report.lines:
        _say(printable(line))
    for hint in report.hints:
        _say(printable(f"{link}: {hint}"), err=True)
    if not report.lines:
        _fail(
            f"{link}: nobody answers within {timeout:g} s; check id, baud rate, parity and wiring (A and B swapped?), "
            "and raise --timeout for a slow device",
            EX_UNAVAILABLE,
        )


# ---- recordings ------------------------------------------------------------------------------------------------------


@app.command()
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
    parameters = None if config is None else _load(config)
    from heaved.devices.recording import RecordingError
    from heaved.recorder.found import RecordedError
    from heaved.replay.replay import OutputError
    from heaved.replay.replay import replay as run_replay

    target = _beside(recording, ".heaved.csv") if out is None else out
    to_stdout = target == Path("-")
    try:
        with _progress() as progress:
            summary = run_replay(
                recording,
                None if to_stdout else target,
                parameters,
                learn_anew=learn_anew,
                until_s=inf if until is None else until,
                progress=progress,
            )
    except (RecordingError, RecordedError, OutputError, OSError) as error:
        _fail(str(error), 1)
    _say(str(summary), err=True)
    if out is None:
        _say(f"written to {target}", err=True)


@app.command()
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
        with _progress("export") as progress:
            done = run_export(recording, out, columns=names, every_s=every, progress=progress)
    except (RecordedError, OutputError) as error:
        _fail(str(error), 1)
    to_stderr = not json or out == Path("-")
    _say(msgspec.json.encode(done).decode() if json else printable_lines(str(done)), err=to_stderr)


@app.command()
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

    parameters = None if config is None else _load(config)
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
        with _progress() as progress:
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
        _fail(str(error), 1)
    if json:
        _say(json_text(found))
    _say(f"written to {target}", err=True)


@app.command()
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
        configs = {name: _load(file) for name, file in named(config or []).items()}
        with _progress("backtest") as progress:
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
        _fail(str(error), EX_UNAVAILABLE)
    except BacktestError as error:
        _fail(str(error), 1)
    except KeyboardInterrupt:
        _fail("ended: what is done is kept, and the same command does the rest", 130)
    if json:
        _say(msgspec.json.encode(summary).decode())
    _say(printable_lines(str(summary)), err=True)
    _say(f"written to {printable(summary.page)} and {printable(summary.table)}", err=True)
    if summary.failed:
        raise typer.Exit(1)


def _beside(recording: Path, ending: str) -> Path:
    """The file beside a recording that is called like it."""
    whole = recording.resolve()
    return whole.with_name(f"{whole.name if whole.is_dir() else whole.stem}{ending}")


@contextmanager
def _progress(what: str = "replay") -> Iterator[Progress | None]:
    """A bar on standard error if that is a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress as Bar

    with Bar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


# ---- simulation ------------------------------------------------------------------------------------------------------


@app.command()
def demo(
    sea: SeaName = "S5",
    link: Annotated[LinkKind, typer.Option(help="Modbus TCP, or RTU on a pseudo-terminal.")] = LinkKind.tcp,
    duration: Annotated[float | None, typer.Option(min=0.0, help="End after so many seconds.")] = None,
    config: Annotated[Path | None, typer.Option(help="What to run and whose devices to simulate.")] = None,
    shake: ShakeName = "",
    log_format: Logs = LogFormat.human,
) -> None:
    """Run the daemon on simulated sensors, with a simulated winch on its stream: the whole chain on this machine."""
    from heaved.demo import demo as demonstration

    def announce(config: Config) -> None:
        for device in config.device:
            _say(f"sea {sea}, simulated {_device_line(device)}")
        port = "" if config.stream.port == PORT else f" --port {config.stream.port}"
        _say(f"look at it: heaved watch{port}, heaved status{port}, nc {config.stream.host} {config.stream.port}")
        for line in demonstration.how_to_look(config):
            _say(line)

    try:
        code = demonstration.run(
            sea,
            serial=link is LinkKind.rtu,
            duration_s=duration,
            log_format=log_format.value,
            announce=announce,
            config=None if config is None else _load_to_run(config),
            shake=shake,
        )
    except demonstration.DemoError as error:
        _fail(str(error), 1)
    raise typer.Exit(code)


@app.command()
def sim(
    config: Annotated[
        Path | None, typer.Option(help="Whose devices to simulate; those of the demo by default.")
    ] = None,
    sea: SeaName = "S5",
    link: Annotated[LinkKind | None, typer.Option(help="rtu: all devices on one pseudo-terminal.")] = None,
    play: Annotated[Path | None, typer.Option(metavar="FILE.csv", help="A recording in place of a sea.")] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(metavar="DEVICE:KIND@START+DURATION[=AMOUNT]", help="Misbehave; may be repeated."),
    ] = None,
    sensor: Annotated[str, typer.Option(help="A (tactical MEMS), B (industrial), C (consumer) or ideal.")] = "A",
    laser: Annotated[str, typer.Option(help="on, off, a share such as 50%, or outages such as 300+120.")] = "on",
    shake: ShakeName = "",
    seed: Annotated[int, typer.Option(min=0, help="Of the sea and of all errors.")] = 1,
) -> None:
    """Serve simulated Modbus sensors until Ctrl-C."""
    import tempfile

    from heaved.demo import demo as demonstration
    from heaved.simulate.faults import parse_faults
    from heaved.simulate.play import Player, read_recording

    devices = (demonstration.demo_config() if config is None else _load(config)).device

    def ready(served: tuple[DeviceSpec, ...]) -> None:
        for device in served:
            _say(_device_line(device))

    with tempfile.TemporaryDirectory(prefix="heaved-sim-") as directory:
        if link is LinkKind.rtu:
            devices = demonstration.on_serial_line(devices, Path(directory))
        try:
            source = (
                demonstration.instruments(sea, devices, sensor=sensor, laser=laser, shake=shake, seed=seed)
                if play is None
                else Player(read_recording(play))
            )
            demonstration.serve(devices, source, parse_faults(",".join(fault or ())), seed=seed, ready=ready)
        except OSError as error:
            in_use = "; stop what serves there (another heaved sim?), or change the link"
            reason = f"{error.strerror or error}{in_use if error.errno == errno.EADDRINUSE else ''}"
            _fail(f"{error.filename}: {reason}" if error.filename else reason, 1)
        except ValueError as error:
            _fail(str(error), 1)


def _fail(message: str, code: int) -> NoReturn:
    _say(printable_lines(message), err=True)
    raise typer.Exit(code)


def _say(text: str, *, err: bool = False, nl: bool = True) -> None:
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
            _say(f"standard output: cannot be written: {error.strerror or error}", err=True)
        raise typer.Exit(EX_IOERR) from error
