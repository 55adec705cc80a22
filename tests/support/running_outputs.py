"""Outputs beside the stream, run within a test, and a frame for them to tell."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, TypeVar

from heaved.samples import CorrectionState, HeaveState, LaserState, MotionFrame, Quality

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from heaved.outputs.output import Output

PATIENCE_S = 20.0
"""No test measures time: this only ends one that hangs."""
Kind = TypeVar("Kind", bound="Output")


def golden_frame(t_s: float | None = None) -> MotionFrame:
    """The motion of the makers' golden frame of registers; of now unless ``t_s`` says otherwise."""
    return MotionFrame(
        t_s=time.monotonic() if t_s is None else t_s,
        quality=Quality(heave=HeaveState.VALID, laser=LaserState.OFF, correction=CorrectionState.OFF),
        heave_m=0.305,
        heave_std_m=0.02,
        heave_velocity_mps=-0.088,
        heave_acceleration_mps2=-0.070,
        roll_rad=math.radians(0.16),
        pitch_rad=math.radians(0.63),
    )


@asynccontextmanager
async def output_running(output: Kind) -> AsyncIterator[Kind]:
    task = asyncio.create_task(output.run())
    try:
        yield output
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


async def until(condition: Callable[[], object]) -> None:
    """Let the loop run until ``condition()`` holds."""
    async with asyncio.timeout(PATIENCE_S):
        while not condition():  # noqa: ASYNC110  # What is looked at is no part of this program's to signal it.
            await asyncio.sleep(0.002)
