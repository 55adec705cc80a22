"""A worker process: jobs in on stdin, results out on stdout, nothing else there.

It ends when stdin does, so it never outlives the daemon by more than one job.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import TYPE_CHECKING, TypeVar

import msgspec

from heaved.workers import protocol

if TYPE_CHECKING:
    from collections.abc import Callable

NICENESS = 10

Job = TypeVar("Job", bound=msgspec.Struct)


def serve(name: str, kind: type[Job], work: Callable[[Job], msgspec.Struct]) -> int:
    """Serve jobs of ``kind`` until the end of stdin (0) or a malformed frame (1, with a message on stderr)."""
    os.nice(NICENESS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the daemon's to handle; its end is our end of file
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a library that prints must not break the frames
    while True:
        try:
            job = protocol.read(sys.stdin.buffer, kind)
        except protocol.FrameError as error:
            print(f"{name}: {error}", file=sys.stderr)
            return 1
        if job is None:
            return 0
        try:
            answers.write(protocol.encode(work(job)))
            answers.flush()
        except BrokenPipeError:
            return 0
