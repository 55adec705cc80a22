"""What keeps the event loop punctual within an ordinary process: its scheduling, and when memory is collected."""

from __future__ import annotations

import gc
import os

import structlog

_log = structlog.get_logger(__name__)


def freeze_memory() -> None:
    """Call once when everything has started: what lives now lives for ever, no collection needs to look at it again.

    A full collection would otherwise visit 100 000 objects, which shows as a tick that is 30 ms late.
    """
    gc.collect()
    gc.freeze()


def set_real_time(priority: int) -> None:
    """SCHED_FIFO for the event loop's thread (0: no change); not for threads and processes that it starts."""
    if priority == 0:
        return
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError as error:
        hint = (
            "a service: heaved install-service --write permits it (RestrictRealtime=no, "
            f"LimitRTPRIO={priority}, SystemCallFilter=sched_setscheduler); else give the program CAP_SYS_NICE, or set "
            "[runtime] fifo_priority = 0"
        )
        _log.warning("no real-time scheduling, ordinary scheduling instead", reason=error.strerror, hint=hint)
