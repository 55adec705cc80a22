"""Cost of one step of attitude fusion in each mode, beside its filters one by one through the sigma-point core.

    python tools/bench_fusion.py [--repeats 20] [--ticks 150]

Hot: back to back, best of 50 blocks. Cold: once per 10 ms tick with 32 MB touched in between, which is how a daemon
meets it; median and 99th percentile. The ratio carries over between machines; the figures do not.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from itertools import count

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from heaved.estimation.common import sigma
from heaved.estimation.craft.dynamics import Craft, Vessel
from heaved.estimation.craft.fusion import AttitudeFusion, Differ, Mode, Params
from heaved.estimation.craft.model import State
from heaved.estimation.craft.wave_force import WaveShape, propagation

TICK_S = 0.01
RATE_HZ = 100.0
CACHE_BYTES = 32 * 1024 * 1024
BLOCKS = 50


def fused(params: Params) -> Callable[[], object]:
    """Steps of a filter on a sine of a few decimetres and degrees, at 100 Hz."""
    fusion, number = AttitudeFusion(params), count()

    def step() -> object:
        t = next(number) / RATE_HZ
        swing = float(np.sin(2.0 * t))
        return fusion.step(t, 0.3 * swing, 0.02 * swing, 18.0, -0.02 * swing, 0.02 * swing)

    for _ in range(50):
        step()
    return step


def one_by_one() -> Callable[[], object]:
    """Three filters of the same size by ``sigma.predict`` and ``sigma.update``, nothing mixed, nothing checked."""
    craft, points, dt_s = Craft(Vessel()), sigma.cubature(len(State)), 1.0 / RATE_HZ
    waves, flaps = propagation(WaveShape(), dt_s).rows, np.zeros((2, 1))
    x, P, Q = np.zeros(len(State)), 0.01 * np.eye(len(State)), 1e-6 * np.eye(len(State))
    H, R, z = np.eye(len(State))[[State.Z, State.THETA]], np.diag([2.5e-3, 2.5e-5]), np.zeros(2)

    def move(rows: np.ndarray) -> np.ndarray:
        columns = rows.T
        carried = waves.dot(columns[4:])
        forces = np.stack((columns[4:6], carried[0:2], carried[2:4]))
        return np.vstack((craft.advance(columns[:4], dt_s, 18.0, flaps, forces), carried[2:])).T

    def step() -> object:
        last: object = None
        for _ in range(3):
            predicted = sigma.predict(points, x, P, move, Q)
            assert predicted is not None
            last = sigma.update(points, predicted.x, predicted.P, z, H, R)
        return last

    return step


def contenders() -> dict[str, Callable[[], object]]:
    return {
        "imm, three seas": fused(Params()),
        "ewma, three seas": fused(Params(mode=Mode.EWMA)),
        "instant, three seas": fused(Params(mode=Mode.INSTANT, bank=Differ.SEAS)),
        "instant, two point sets": fused(Params(mode=Mode.INSTANT)),
        "three filters one by one": one_by_one(),
    }


def once_us(step: Callable[[], object]) -> float:
    start = time.perf_counter_ns()
    step()
    return (time.perf_counter_ns() - start) / 1000.0


def hot_us(step: Callable[[], object], repeats: int) -> float:
    return min(sum(once_us(step) for _ in range(repeats)) / repeats for _ in range(BLOCKS))


def cold_us(step: Callable[[], object], ticks: int, cache: np.ndarray) -> list[float]:
    values = []
    for _ in range(ticks):
        cache += 1
        time.sleep(TICK_S)
        values.append(once_us(step))
    return values


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=20, help=f"hot steps in each of {BLOCKS} blocks")
    parser.add_argument("--ticks", type=int, default=150, help="cold steps of each")
    options = parser.parse_args()
    cache = np.zeros(CACHE_BYTES, dtype=np.uint8)
    print(f"{'mode':26} {'hot µs':>8} {'cold µs':>8} {'99 % µs':>8}")
    for name, step in contenders().items():
        cold = cold_us(step, options.ticks, cache)
        print(f"{name:26} {hot_us(step, options.repeats):8.0f} {np.median(cold):8.0f} {np.percentile(cold, 99):8.0f}")


if __name__ == "__main__":
    main()
