"""Brokers, databases and certificates that tests talk to: real programs, each on a port of its own."""

from __future__ import annotations

import asyncio
import shutil
import socket
import subprocess
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from pathlib import Path

MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
MOSQUITTO_PASSWD = shutil.which("mosquitto_passwd")
OPENSSL = shutil.which("openssl")
INFLUXD = shutil.which("influxd") or shutil.which("influxd", path="/usr/sbin")
PROMTOOL = shutil.which("promtool")

needs_mosquitto = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
needs_openssl = pytest.mark.skipif(OPENSSL is None, reason="openssl is not installed")
needs_influxd = pytest.mark.skipif(INFLUXD is None, reason="influxd is not installed")
needs_promtool = pytest.mark.skipif(PROMTOOL is None, reason="promtool is not installed")


TIMEOUT_S = 30.0
"""Nothing takes so long; it ends what hangs."""


async def until(condition: Callable[[], object], seen: Callable[[], object]) -> None:
    """Wait for a condition that has no event; what was ``seen`` instead is said when it does not come."""

    async def wait() -> None:
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.005)

    try:
        await asyncio.wait_for(wait(), TIMEOUT_S)
    except TimeoutError:
        raise AssertionError(seen()) from None


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


async def until_listening(port: int, process: asyncio.subprocess.Process) -> None:
    while True:
        try:
            _, writer = await asyncio.open_connection("127.0.0.1", port)
        except OSError:
            assert process.returncode is None, "the program has ended"
            await asyncio.sleep(0.01)
        else:
            writer.close()
            await writer.wait_closed()
            return


@asynccontextmanager
async def running(port: int, *command: str) -> AsyncIterator[asyncio.subprocess.Process]:
    """A program while it listens on ``port``; it is killed at the end."""
    quiet = asyncio.subprocess.DEVNULL
    process = await asyncio.create_subprocess_exec(*command, stdin=quiet, stdout=quiet, stderr=quiet)
    try:
        await until_listening(port, process)
        yield process
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()


def certificates(directory: Path) -> None:
    """``ca.pem``; ``server.pem`` for localhost and ``client.pem``, signed by it, each with its ``.key``; ``other.pem``,
    a certificate of nobody's; ``locked.key``, which has a password.
    """
    assert OPENSSL is not None

    def openssl(*arguments: str) -> None:
        subprocess.run([str(OPENSSL), *arguments], cwd=directory, check=True, capture_output=True, timeout=60)

    key = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2")
    for name in ("ca", "other"):
        openssl("req", "-x509", *key, "-keyout", f"{name}.key", "-out", f"{name}.pem", "-subj", f"/CN=Test {name}")
    openssl("pkey", "-in", "ca.key", "-out", "locked.key", "-aes128", "-passout", "pass:secret")
    for name in ("server", "client"):
        openssl("req", *key[:-2], "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={name}")
        (directory / "names").write_text("subjectAltName=DNS:localhost")
        signed = ("-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "2", "-extfile", "names")
        openssl("x509", "-req", "-in", f"{name}.csr", "-out", f"{name}.pem", *signed)
