"""Cost of one sample in the rock predictors, at several sample rates, with everything that falls due in between.

    python tools/bench_rock.py [--blocks 20]

CPU time, hot: back to back after 150 s of motion, mean over blocks of 30 s (all that is solved and moved in turn is in
them), best and median of the blocks. The figures do not carry over between machines; that they hardly depend on the
rate does.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from heaved.estimation.rock import direct as rock_direct
from heaved.estimation.rock import estimator as rock_chain
from heaved.estimation.rock import maximum_likelihood as rock

WARM_S, BLOCK_S = 150.0, 30.0
RATES_HZ = (5.0, 20.0, 100.0, 200.0)
ML_HORIZONS_S = (0.5, 1.0, 2.0, 5.0)
Step = Callable[[float, list[float]], object]


def contenders() -> dict[str, Step]:
    """Fresh predictors, three axes and seven horizons unless it says otherwise."""
    direct, rated = rock_chain.DirectRockPredictor(), rock_chain.DirectRockPredictor()
    single = rock_direct.DirectPredictor(1)
    paper = rock.RockPredictor(rock.Params(horizons_s=ML_HORIZONS_S))
    return {
        "ml": lambda t, x: paper.step(t, *x[:3]),
        "direct": lambda t, x: direct.step(t, (x[0], x[1], x[2])),
        "direct, with rates": lambda t, x: rated.step(t, (x[0], x[1], x[2]), (x[3], x[4], x[5])),
        "direct, one channel": lambda t, x: single.step(t, x[:1]),
    }


def motion(t_s: np.ndarray) -> np.ndarray:
    """(n, 6) roll, pitch, yaw of harmonics with noise, and their rates; rad, rad/s."""
    rng = np.random.default_rng(1)
    columns, rates = [], []
    for period_s, size in ((12.0, 0.05), (6.5, 0.02), (10.0, 0.01)):
        w = 2 * np.pi / period_s
        columns.append(size * (np.sin(w * t_s) + 0.4 * np.sin(1.17 * w * t_s)) + 1e-5 * rng.standard_normal(len(t_s)))
        rates.append(size * w * (np.cos(w * t_s) + 0.47 * np.cos(1.17 * w * t_s)))
    return np.stack([*columns, *rates], axis=1)


def blocks_us(step: Step, rate_hz: float, blocks: int) -> list[float]:
    """Mean cost of a sample in each block."""
    t = np.arange(round((WARM_S + blocks * BLOCK_S) * rate_hz)) / rate_hz
    samples = list(zip(t.tolist(), motion(t).tolist(), strict=True))
    warm, size = round(WARM_S * rate_hz), round(BLOCK_S * rate_hz)
    for now, sample in samples[:warm]:
        step(now, sample)
    values = []
    for first in range(warm, len(samples) - size + 1, size):
        block = samples[first : first + size]
        start = time.process_time_ns()
        for now, sample in block:
            step(now, sample)
        values.append((time.process_time_ns() - start) / 1000.0 / size)
    return values


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--blocks", type=int, default=20, help="of 30 s each")
    parser.add_argument("--rates", type=float, nargs="+", default=RATES_HZ, metavar="HZ")
    options = parser.parse_args()
    print(f"{'predictor':20} {'Hz':>5} {'best µs':>8} {'median µs':>10}")
    for rate_hz in options.rates:
        for name, step in contenders().items():
            found = blocks_us(step, rate_hz, options.blocks)
            print(f"{name:20} {rate_hz:5g} {min(found):8.1f} {statistics.median(found):10.1f}", flush=True)


if __name__ == "__main__":
    main()
