"""Cost of one step of the hull-deformation estimator, of its refit, and of composing the crane-base attitude.

    python tools/bench_hull.py [--seconds 120]

Hot: step after step on a recorded hull; the median, the 99th percentile and the largest, in microseconds. What is due
every ten seconds (the forecast) is in the largest; the start (an alignment and two passes through 5 s) and the refit
(a fit and a pass through the record) are given by themselves. A busy machine shows in the percentiles, not the median.
"""

from __future__ import annotations

import argparse
import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from heaved.estimation.common.rotations import AttitudeAngles, crane_base_attitude
from heaved.estimation.hull.estimate import Method, Params
from heaved.estimation.hull.estimator import HullDeformation
from heaved.estimation.hull.refit import refit
from heaved.simulate.flexure import SCENES, Record, simulate

STARTED_S = 30.0
"""The steps are timed from here on: each update is taken once."""


def steps_us(record: Record, method: Method) -> tuple[np.ndarray, float]:
    """Duration of every step after the start, and of the dearest one before, in microseconds."""
    estimator = HullDeformation(Params(method=method, refit_after_s=0.0))
    durations = []
    for t, a, b in zip(record.midships_t_s.tolist(), record.midships_radps, record.local_radps, strict=True):
        begin = time.perf_counter_ns()
        estimator.step(t, a, b)
        durations.append((time.perf_counter_ns() - begin) / 1000.0)
    first = round(10 * STARTED_S)
    return np.array(durations[first:]), max(durations[:first])


def refit_ms(seconds: float) -> float:
    record = simulate(SCENES["A1"], 1, duration_s=seconds + 10.0)
    estimator = HullDeformation(Params(refit_after_s=seconds), refit_inline=False)
    for t, a, b in zip(record.midships_t_s.tolist(), record.midships_radps, record.local_radps, strict=True):
        estimator.step(t, a, b)
    assert estimator.due_refit is not None
    begin = time.perf_counter_ns()
    refit(estimator.due_refit)
    return (time.perf_counter_ns() - begin) / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(prog="bench_hull", description="Cost of the hull-deformation estimator.")
    parser.add_argument("--seconds", type=float, default=120.0, help="record per method (default 120)")
    seconds = max(parser.parse_args().seconds, STARTED_S + 10.0)
    record = simulate(SCENES["A1"], 1, duration_s=seconds)
    print("| method | step, median µs | 99 % | largest | start |\n|---|---|---|---|---|")
    for method in Method:
        us, start = steps_us(record, method)
        print(f"| {method} | {np.median(us):.0f} | {np.percentile(us, 99):.0f} | {np.max(us):.0f} | {start:.0f} |")
    C, attitude = record.static, AttitudeAngles(0.01, 0.02, 1.0)
    begin = time.perf_counter_ns()
    for _ in range(2000):
        crane_base_attitude(attitude, C)
    composed_us = (time.perf_counter_ns() - begin) / 2e6
    print(f"\ncrane-base attitude {composed_us:.1f} µs; refit of 300 s {refit_ms(300.0):.0f} ms")


if __name__ == "__main__":
    main()
