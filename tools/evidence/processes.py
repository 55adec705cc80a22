"""Processes beside the daemon, started and ended from here."""

from __future__ import annotations

import multiprocessing
import socket
import subprocess
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from multiprocessing.connection import Connection
    from pathlib import Path


@contextmanager
def child(target: Callable[..., None], *arguments: object) -> Iterator[Connection]:
    """``target(*arguments, pipe)`` in a process of its own, and our end of the pipe, whose end is its own."""
    ours, theirs = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=target, args=(*arguments, theirs), daemon=True)
    process.start()
    theirs.close()  # So that a child that dies is an end of file, not an endless wait.
    try:
        yield ours
    finally:
        ours.close()
        process.join(2.0)
        process.kill()
        process.join()


@contextmanager
def page(stream_port: int, folder: Path) -> Iterator[int]:
    """``heaved page`` on a daemon's stream, and its port."""
    port = free_port()
    command = (sys.executable, "-m", "heaved", "page", "--port", str(port), "--stream-port", str(stream_port))
    with (folder / "page.log").open("ab") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
    try:
        yield port
    finally:
        process.terminate()
        process.wait(10.0)


def free_port() -> int:
    """A TCP port of 127.0.0.1 that nobody has now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
