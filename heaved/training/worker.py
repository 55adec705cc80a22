"""The trainer process: windows in on stdin, networks out on stdout, nothing else there.

It ends when stdin does, so it never outlives the daemon by more than one training.
"""

from __future__ import annotations

import os
import signal
import sys

from heaved.samples import TrainingWindow
from heaved.training import protocol
from heaved.training.fit import fit

NICENESS = 10


def main() -> int:
    """Serve until the end of stdin (0) or a malformed frame (1, with a message on stderr)."""
    os.nice(NICENESS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the daemon's to handle; its end is our end of file
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a library that prints must not break the frames
    while True:
        try:
            window = protocol.read(sys.stdin.buffer, TrainingWindow)
        except protocol.FrameError as error:
            print(f"trainer: {error}", file=sys.stderr)
            return 1
        if window is None:
            return 0
        try:
            answers.write(protocol.encode(fit(window)))
            answers.flush()
        except BrokenPipeError:
            return 0
