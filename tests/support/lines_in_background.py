"""A serial slave with an event loop and a thread of its own, for what blocks the test's: a command."""

from __future__ import annotations

import asyncio
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from picky_slaves import PickySlave


@contextmanager
def in_background(make: Callable[[], PickySlave]) -> Iterator[PickySlave]:
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()

    async def begin() -> PickySlave:
        return make()

    async def end(slave: PickySlave) -> None:
        slave.close()

    try:
        slave = asyncio.run_coroutine_threadsafe(begin(), loop).result(10.0)
        try:
            yield slave
        finally:
            asyncio.run_coroutine_threadsafe(end(slave), loop).result(10.0)
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()
