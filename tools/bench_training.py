"""What training does to a 10 ms tick on an event loop: not training, torch in a thread, our trainer process.

    python tools/bench_training.py [--seconds 15] [--rows 3000]

Lateness is how long after its deadline a timerfd tick runs on the loop; training repeats without a pause. All three run
in one process, the thread last because it leaves torch behind.
"""

from __future__ import annotations

import argparse
import asyncio
import ctypes
import os
import struct
import time
from collections.abc import Awaitable, Callable

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from heaved.samples import TrainedNetwork, TrainingWindow
from heaved.workers.process import TRAINER, Worker

TICK_NS = 10_000_000
CLOCK_MONOTONIC = 1
TFD_TIMER_ABSTIME = 1
WIDTH = 50


def make_window(rows: int) -> TrainingWindow:
    rng = np.random.default_rng(1)
    t = np.arange(rows + WIDTH - 1) / 10.0
    frequencies, phases = rng.uniform(0.06, 0.35, 60), rng.uniform(0.0, 2.0 * np.pi, 60)
    heave = np.sin(2.0 * np.pi * np.outer(t, frequencies) + phases).sum(axis=1)
    inputs = np.lib.stride_tricks.sliding_window_view(heave, WIDTH)
    return TrainingWindow(
        number=1,
        inputs=inputs.astype("<f8").tobytes(),
        targets=(0.3 * inputs[:, -6]).astype("<f8").tobytes(),
        rows=rows,
        width=WIDTH,
        hidden=10,
        learning_rate=0.01,
        epochs=1000,
        output="linear",
        seed=1,
    )


async def lateness_us(seconds: float) -> np.ndarray:
    """Lateness of each tick, microseconds."""
    libc = ctypes.CDLL(None, use_errno=True)
    fd = libc.timerfd_create(CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
    if fd < 0:
        raise OSError(ctypes.get_errno(), "timerfd_create failed")
    first = time.monotonic_ns() + TICK_NS
    setting = struct.pack("4q", 0, TICK_NS, first // 1_000_000_000, first % 1_000_000_000)
    if libc.timerfd_settime(fd, TFD_TIMER_ABSTIME, setting, None) != 0:
        raise OSError(ctypes.get_errno(), "timerfd_settime failed")
    late: list[float] = []
    ticks = round(seconds * 1e9 / TICK_NS)
    done = asyncio.get_running_loop().create_future()
    passed = 0

    def tick() -> None:
        nonlocal passed
        passed += struct.unpack("Q", os.read(fd, 8))[0]
        late.append((time.monotonic_ns() - first - (passed - 1) * TICK_NS) / 1000.0)
        if passed >= ticks and not done.done():
            done.set_result(None)

    asyncio.get_running_loop().add_reader(fd, tick)
    try:
        await done
    finally:
        asyncio.get_running_loop().remove_reader(fd)
        os.close(fd)
    return np.array(late)


async def idle(window: TrainingWindow, seconds: float) -> tuple[np.ndarray, int]:
    return await lateness_us(seconds), 0


async def process(window: TrainingWindow, seconds: float) -> tuple[np.ndarray, int]:
    trained = 0

    def next_one(result: TrainedNetwork) -> None:
        nonlocal trained
        trained += 1
        trainer.submit(window)

    trainer = Worker("trainer", TrainedNetwork, next_one, print, command=TRAINER)
    await trainer.start()
    trainer.submit(window)
    try:
        return await lateness_us(seconds), trained
    finally:
        await trainer.stop()


async def thread(window: TrainingWindow, seconds: float) -> tuple[np.ndarray, int]:
    trained, stopping = 0, False

    def train() -> None:
        nonlocal trained
        from heaved.workers.train_correction import fit  # the import is part of what is measured

        while not stopping:
            fit(window)
            trained += 1

    worker = asyncio.create_task(asyncio.to_thread(train))
    late = await lateness_us(seconds)
    stopping = True
    await worker
    return late, trained


VARIANTS: dict[str, Callable[[TrainingWindow, float], Awaitable[tuple[np.ndarray, int]]]] = {
    "no training": idle,
    "trainer process": process,
    "torch in a thread": thread,
}


async def bench(seconds: float, rows: int) -> None:
    window = make_window(rows)
    print(f"{'':20} {'trainings':>9} {'p50 µs':>9} {'p99 µs':>9} {'max µs':>9}")
    for name, variant in VARIANTS.items():
        late, trained = await variant(window, seconds)
        p50, p99 = np.percentile(late, [50, 99])
        print(f"{name:20} {trained:9} {p50:9.0f} {p99:9.0f} {late.max():9.0f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=15.0, help="length of each of the three runs")
    parser.add_argument("--rows", type=int, default=3000, help="rows of the training window")
    options = parser.parse_args()
    asyncio.run(bench(options.seconds, options.rows))


if __name__ == "__main__":
    main()
