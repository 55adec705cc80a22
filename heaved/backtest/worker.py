"""What Dask loads into each local worker before anything else."""

from __future__ import annotations

import signal


def dask_setup(worker: object) -> None:  # noqa: ARG001  # Dask calls it with the worker.
    """Leave Ctrl-C, which a terminal sends to all of its processes, to the one that started the workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
