"""Waiting for what tells nobody that it has happened."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

PATIENCE_S: Final = 20.0
"""For what normally takes a fraction of a second, on a machine that has other things to do."""


async def holds(condition: Callable[[], object]) -> None:
    """Return once the condition holds; looks a hundred times a second."""
    async with asyncio.timeout(PATIENCE_S):
        while not condition():  # noqa: ASYNC110  # What is waited for has no event.
            await asyncio.sleep(0.01)
