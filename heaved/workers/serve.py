"""A worker process, its own side: requests in on stdin, results out on stdout, nothing else there.

It ends when stdin does, so it never outlives the daemon by more than one request.
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

Request = TypeVar("Request", bound=msgspec.Struct)


def serve(name: str, kind: type[Request], work: Callable[[Request], msgspec.Struct]) -> int:
    """Answer requests of ``kind`` until the end of stdin (0) or a malformed frame (1, with a message on stderr)."""
    os.nice(NICENESS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the daemon's to handle; its end is our end of file
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a library that prints must not break the frames
    while True:
        try:
            request = protocol.read(sys.stdin.buffer, kind)
        except protocol.FrameError as error:
            print(f"{name}: {error}", file=sys.stderr)
            return 1
        if request is None:
            return 0
        try:
            answers.write(protocol.encode(work(request)))
            answers.flush()
        except BrokenPipeError:
            return 0
