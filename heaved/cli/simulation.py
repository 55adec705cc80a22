"""Simulated sensors, with the daemon on them and without it."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heaved.cli.common import (
    PORT,
    LinkKind,
    LogFormat,
    Logs,
    SeaName,
    ShakeName,
    device_line,
    fail,
    load,
    load_to_run,
    say,
)

if TYPE_CHECKING:
    from heaved.config import Config
    from heaved.devices.profile import DeviceSpec
    from heaved.simulate.slave import Source


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
            say(f"sea {sea}, simulated {device_line(device)}")
        port = "" if config.stream.port == PORT else f" --port {config.stream.port}"
        say(f"look at it: heaved watch{port}, heaved status{port}, nc {config.stream.host} {config.stream.port}")
        for line in demonstration.how_to_look(config):
            say(line)

    try:
        code = demonstration.run(
            sea,
            serial=link is LinkKind.rtu,
            duration_s=duration,
            log_format=log_format.value,
            announce=announce,
            config=None if config is None else load_to_run(config),
            shake=shake,
        )
    except demonstration.DemoError as error:
        fail(str(error), 1)
    raise typer.Exit(code)


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
    mount: Annotated[
        list[str] | None,
        typer.Option(metavar="DEVICE:X,Y,Z", help="An IMU stands so, not as its rotation_deg says. May be repeated."),
    ] = None,
    tilt: Annotated[
        str, typer.Option(metavar="ROLL,PITCH", help="What IMUs are bolted to is tilted, port up and bow up, degrees.")
    ] = "0,0",
    laser_at: Annotated[
        str, typer.Option(metavar="FORWARD,PORT,UP", help="Where the laser is from the IMU, in metres.")
    ] = "0,0,0",
    laser_beam: Annotated[
        str, typer.Option(metavar="X,Y,Z", help="Where its beam points; upwards, it looks at something over the ship.")
    ] = "0,0,-1",
    shake: ShakeName = "",
    mru: Annotated[
        str, typer.Option(help="Of an existing MRU (role reference_mru): delay=0.15,noise=0.01,highpass=100, s, m, s.")
    ] = "",
    seed: Annotated[int, typer.Option(min=0, help="Of the sea and of all errors.")] = 1,
) -> None:
    """Serve simulated sensors until Ctrl-C: slaves on Modbus, and an existing MRU with its telegrams."""
    import tempfile

    from heaved.demo import demo as demonstration
    from heaved.simulate.faults import parse_faults
    from heaved.simulate.gauge import gauge_at
    from heaved.simulate.mounted import Mounted, parse_mounts, parse_tilt
    from heaved.simulate.mru import parse_mru
    from heaved.simulate.play import Player, read_recording

    devices = (demonstration.demo_config() if config is None else load(config)).device

    def ready(served: tuple[DeviceSpec, ...]) -> None:
        for device in served:
            say(device_line(device))

    with tempfile.TemporaryDirectory(prefix="heaved-sim-") as directory:
        if link is LinkKind.rtu:
            devices = demonstration.on_serial_line(devices, Path(directory))
        try:
            source: Source = (
                demonstration.instruments(
                    sea,
                    devices,
                    sensor=sensor,
                    laser=laser,
                    gauge=gauge_at(laser_at, laser_beam),
                    shake=shake,
                    seed=seed,
                    mru=parse_mru(mru),
                )
                if play is None
                else Player(read_recording(play))
            )
            source = Mounted(source, parse_mounts(mount or (), devices), parse_tilt(tilt))
            demonstration.serve(devices, source, parse_faults(",".join(fault or ())), seed=seed, ready=ready)
        except OSError as error:
            in_use = "; stop what serves there (another heaved sim?), or change the link"
            reason = f"{error.strerror or error}{in_use if error.errno == errno.EADDRINUSE else ''}"
            fail(f"{error.filename}: {reason}" if error.filename else reason, 1)
        except ValueError as error:
            fail(str(error), 1)
