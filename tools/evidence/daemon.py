"""The real daemon on simulated sensors: ``python -m heaved run``, started and ended from here."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

import msgspec

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Collection, Sequence
    from pathlib import Path

    from heaved.devices.profile import DeviceSpec

STARTS_S = 20.0


class Running(msgspec.Struct, frozen=True):
    """A daemon that runs: its process, and where it listens by name."""

    pid: int
    addresses: dict[str, tuple[str, int]]


@asynccontextmanager
async def running_daemon(
    devices: Sequence[DeviceSpec],
    folder: Path,
    settings: str = "",
    *,
    http: bool = False,
    cores: Collection[int] = (),
) -> AsyncIterator[Running]:
    """A daemon that polls ``devices``, its stream and, if it is asked for, its HTTP server on 127.0.0.1.

    Configuration, state and the log (``folder/log``) go to ``folder``. ``settings``: further tables, as TOML.
    ``cores``: on which it runs, and its processes; none: on any.

    Raises:
        RuntimeError: it does not start; says what it has logged.
    """
    config, log = folder / "heaved.toml", folder / "log"
    tables = "".join(
        f'[[device]]\nname = "{d.name}"\nrole = "{d.role}"\nlink = "{d.link}"\ndevice_id = {d.device_id}\n'
        f'profile = "{d.profile.name}"\nrate_hz = {d.rate_hz}\n'
        for d in devices
    )
    own = f'[stream]\nport = 0\n[http]\nenabled = {str(http).lower()}\nport = 0\n[state]\ndirectory = "{folder}"\n'
    config.write_text(tables + own + settings, encoding="utf-8")
    with log.open("wb") as errors:
        daemon = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "heaved", "run", "--config", str(config),
            stdout=asyncio.subprocess.PIPE, stderr=errors, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            start_new_session=True,  # Ctrl-C is for the tool, which then ends it.
        )  # fmt: skip
    if cores:  # Long before it has threads or processes, which go where it is.
        os.sched_setaffinity(daemon.pid, cores)
    try:
        assert daemon.stdout is not None
        addresses: dict[str, tuple[str, int]] = {}
        while len(addresses) < 1 + http:
            line = (await asyncio.wait_for(daemon.stdout.readline(), STARTS_S)).decode()
            if not line:
                raise RuntimeError(f"the daemon did not start:\n{log.read_text()}")
            name, where = line.split()
            host, _, port = where.rpartition(":")
            addresses[name] = host, int(port)
        yield Running(daemon.pid, addresses)
    finally:
        with contextlib.suppress(ProcessLookupError):
            daemon.send_signal(signal.SIGTERM)
        await daemon.wait()
