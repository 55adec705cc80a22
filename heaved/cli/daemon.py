"""The daemon, and its configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from heaved.cli.common import EX_CONFIG, SYSTEM_CONFIG, LogFormat, Logs, device_line, fail, load_to_run, say
from heaved.text import printable


def run(
    config: Annotated[
        Path | None, typer.Option(help=f"Configuration file; else {SYSTEM_CONFIG} if it is there.")
    ] = None,
    log_format: Logs = LogFormat.human,
) -> None:
    """Run the daemon until SIGTERM or SIGINT. SIGHUP reads the configuration again."""
    if config is None and not SYSTEM_CONFIG.exists():
        from heaved.config.read import data_directory

        fail(
            f"no configuration: give one with --config FILE, or put one at {SYSTEM_CONFIG}; "
            f"the default to start from, with every key explained, is {data_directory() / 'heaved.toml'}",
            EX_CONFIG,
        )
    path = config or SYSTEM_CONFIG
    loaded = load_to_run(path)
    from heaved.daemon import daemon

    raise typer.Exit(daemon.run(loaded, path, log_format=log_format.value))


def check_config(file: Annotated[Path, typer.Argument(metavar="FILE")]) -> None:
    """Check a configuration file: names every fault, and rates that a serial line cannot carry (exit code 78)."""
    config = load_to_run(file)
    from heaved.config.rules import cautions, rate_faults
    from heaved.devices.bandwidth import bandwidth_hz, lag_ms
    from heaved.devices.mounting import mounting_lines

    if faults := rate_faults(config):
        fail("\n".join(f"{file}: {fault}" for fault in faults), EX_CONFIG)
    say(f"{file}: well")
    for device in config.device:
        hertz = bandwidth_hz(device)
        bandwidth = f", bandwidth {hertz:g} Hz (a lag of about {lag_ms(hertz):.0f} ms)" if hertz else ""
        say(f"  {device_line(device)}, {device.profile.name} at {device.rate_hz:g} Hz{bandwidth}")
        for line in mounting_lines(device):
            say(f"    {line}")
    if not any(device.role == "imu" for device in config.device):
        say('  no device of role "imu": enough for a replay, but the daemon would have no heave')
    for output in config.output:
        point = f" of {output.point}" if output.point else ""
        say(f"  {output.name} (output): {output.link}, {output.telegram}{point} at {output.rate_hz:g} Hz")
    for name, table in (("registers", config.registers), ("mqtt", config.mqtt), ("influx", config.influx)):
        if table.enabled:
            say(f"  [{name}]: {table.link}")
    for caution in cautions(config):
        say(f"  caution: {printable(caution)}")
