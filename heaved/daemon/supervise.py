"""Tasks that nobody may lose: supervised while they run, stopped in bounded time."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Final

import structlog

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Collection

FIRST_PAUSE_S: Final = 0.1
LONGEST_PAUSE_S: Final = 10.0
LONG_LIFE_S: Final = 60.0
"""A task that ran for so long before it failed is started again without delay."""

_log = structlog.get_logger(__name__)


async def supervise(name: str, run: Callable[[], Awaitable[None]]) -> None:
    """Keep ``run`` running until cancelled: an error is logged, and after a pause that grows it is started again."""
    pause_s = FIRST_PAUSE_S
    while True:
        started_s = time.monotonic()
        try:
            await run()
            _log.error("task ended: starting it again", task=name, pause_s=pause_s)
        except Exception as error:  # Whatever it was, the rest of the daemon goes on.  # noqa: BLE001
            _log.error("task failed: starting it again", task=name, pause_s=pause_s, exc_info=error)
        if time.monotonic() - started_s > LONG_LIFE_S:
            pause_s = FIRST_PAUSE_S
        await asyncio.sleep(pause_s)
        pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)


async def cancelled(tasks: Collection[asyncio.Task[None]], timeout_s: float) -> bool:
    """Cancel the tasks; returns whether all have ended within ``timeout_s``."""
    for task in tasks:
        task.cancel()
    _, hanging = await asyncio.wait(tasks, timeout=timeout_s) if tasks else (tasks, set())
    for task in hanging:
        _log.error("task does not stop: left behind", task=task.get_name())
    return not hanging


async def in_time(name: str, part: Awaitable[object], timeout_s: float) -> bool:
    """Await the end of a part; returns whether it came within ``timeout_s`` and without an error."""
    try:
        await asyncio.wait_for(part, timeout_s)
    except TimeoutError:
        _log.warning("does not stop in time: left behind", part=name)
    except Exception as error:  # The other parts must stop all the same.  # noqa: BLE001
        _log.error("error while stopping", part=name, exc_info=error)
    else:
        return True
    return False
