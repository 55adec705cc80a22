"""Cost of one sigma-point predict + update beside a plain numpy Kalman step, in one run.

    python tools/bench_sigma.py [--repeats 30] [--ticks 150]

Hot: back to back, best of 200 blocks. Cold: once per 10 ms tick with 32 MB touched in between, which is how a daemon
meets it; the median. The ratio carries over between machines; the figures do not.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
import timeit
from collections.abc import Callable

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from heaved.estimation.common import sigma

TICK_S = 0.01
CACHE_BYTES = 32 * 1024 * 1024
STATES = (3, 11, 21)
SETS = (sigma.symmetric, sigma.cubature, sigma.spherical_simplex, sigma.minimal_skew_simplex)


def steps(n: int) -> dict[str, Callable[[], object]]:
    """The contenders, on the same linear model with one measurement."""
    rng = np.random.default_rng(n)
    F, Q, H, R = 0.99 * np.eye(n), 1e-5 * np.eye(n), rng.normal(size=(1, n)), np.array([[0.022]])
    x, P, z = np.zeros(n), 0.1 * np.eye(n), np.array([0.1])

    def kalman() -> object:
        predicted, cov = F @ x, F @ P @ F.T + Q
        gain = cov @ H.T / (H @ cov @ H.T + R)
        return predicted + gain @ (z - H @ predicted), cov - gain @ (H @ cov)

    def sigma_point(points: sigma.PointSet) -> Callable[[], object]:
        def step() -> object:
            predicted = sigma.predict(points, x, P, F, Q)
            assert predicted is not None
            return sigma.update(points, predicted.x, predicted.P, z, H, R)

        return step

    return {"linear Kalman": kalman} | {points.name: sigma_point(points) for points in (make(n) for make in SETS)}


def once_us(step: Callable[[], object]) -> float:
    start = time.perf_counter_ns()
    step()
    return (time.perf_counter_ns() - start) / 1000.0


def hot_us(step: Callable[[], object], repeats: int) -> float:
    return min(timeit.repeat(step, number=repeats, repeat=200)) / repeats * 1e6


def cold_us(step: Callable[[], object], ticks: int, cache: np.ndarray) -> float:
    values = []
    for _ in range(ticks):
        cache += 1
        time.sleep(TICK_S)
        values.append(once_us(step))
    return statistics.median(values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=30, help="hot runs in each of 200 blocks")
    parser.add_argument("--ticks", type=int, default=150, help="cold runs of each")
    options = parser.parse_args()
    cache = np.zeros(CACHE_BYTES, dtype=np.uint8)
    print(f"{'n':>3} {'step':22} {'hot µs':>8} {'ratio':>6} {'cold µs':>8} {'ratio':>6}")
    for n in STATES:
        hot_base = cold_base = 0.0
        for name, step in steps(n).items():
            hot = hot_us(step, options.repeats)
            cold = cold_us(step, options.ticks, cache)
            hot_base, cold_base = hot_base or hot, cold_base or cold
            print(f"{n:3} {name:22} {hot:8.1f} {hot / hot_base:6.2f} {cold:8.1f} {cold / cold_base:6.2f}")


if __name__ == "__main__":
    main()
