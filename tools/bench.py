#!/usr/bin/env python
"""What things cost on this machine: single steps, replays, and what training does to the event loop.

    tools/bench.py replay [--seconds 600] [--sea S6] [--rates 100 20]    a whole ``heaved replay``, files in and out
    tools/bench.py rock [--blocks 20] [--rates 5 20 100 200]    a sample in the rock predictors
    tools/bench.py hull [--seconds 120]     a step of the hull deformation, its refit, the crane-base attitude
    tools/bench.py fusion [--repeats 20] [--ticks 150]    a step of the attitude fusion in each mode
    tools/bench.py sigma [--repeats 30] [--ticks 150]     sigma points beside a plain Kalman step
    tools/bench.py telegrams [--repeats 200] [--ticks 100]    a telegram of each format, and the PLC's registers
    tools/bench.py training [--seconds 15] [--rows 3000]    lateness of a 10 ms tick while a network is trained

Hot: back to back, the best of many blocks. Cold: once per 10 ms tick with 32 MB touched in between, which is how a
daemon meets it. Figures do not carry over between machines; ratios within one run do. ``--record`` puts the table into
tools/RESULTS.md.
"""

from __future__ import annotations

import argparse
import asyncio
import csv
import os
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Iterator, Sequence
from functools import partial
from itertools import count
from math import isfinite, nan
from pathlib import Path
from typing import Final, NamedTuple

os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
from evidence import results
from evidence.commands import Options, Parser, positive
from evidence.commands import count as whole
from evidence.results import Report
from numpy.typing import NDArray

from heaved.config import Config
from heaved.daemon.daemon import make_pipeline
from heaved.devices.timer import DeadlineTimer
from heaved.estimation.common import sigma
from heaved.estimation.common.rotations import AttitudeAngles, crane_base_attitude
from heaved.estimation.craft.dynamics import Craft, Vessel
from heaved.estimation.craft.fusion import AttitudeFusion, Differ, Mode
from heaved.estimation.craft.fusion import Params as FusionParams
from heaved.estimation.craft.model import State
from heaved.estimation.craft.wave_force import WaveShape, propagation
from heaved.estimation.heave.sea.refit import look
from heaved.estimation.hull import estimate
from heaved.estimation.hull.estimator import HullDeformation
from heaved.estimation.hull.refit import refit
from heaved.estimation.rock.direct import DirectPredictor
from heaved.estimation.rock.estimator import DirectRockPredictor
from heaved.estimation.rock.maximum_likelihood import MaximumLikelihoodPredictor
from heaved.estimation.rock.params import Params
from heaved.outputs.motion import Lead, motion_at
from heaved.outputs.register_map import RegisterMap, RegistersParams
from heaved.outputs.telegrams.formats import FORMATS
from heaved.outputs.telegrams.spec import Format, OutputSpec, as_read
from heaved.replay.replay import replay
from heaved.samples import MotionFrame, TrainedNetwork, TrainingWindow
from heaved.simulate.flexure import SCENES, Record, simulate
from heaved.simulate.play import write_recording
from heaved.simulate.seaway import SEAS, seaway
from heaved.simulate.sensors import record
from heaved.workers.jobs import TRAINING
from heaved.workers.process import Worker

Array = NDArray[np.float64]
Step = Callable[[], object]
TICK_S: Final = 0.01
CACHE_BYTES: Final = 32 * 1024 * 1024
BLOCKS: Final = 50


# --- timers and the table --------------------------------------------------------------------------------------------


def timed_us(step: Step) -> float:
    """Duration of one call, in microseconds."""
    start = time.perf_counter_ns()
    step()
    return (time.perf_counter_ns() - start) / 1000.0


def hot_us(step: Step, repeats: int) -> float:
    """Duration of one call when it follows another: the best of the blocks, each of so many calls."""

    def block() -> None:
        for _ in range(repeats):
            step()

    return min(timed_us(block) for _ in range(BLOCKS)) / repeats


def cold_us(step: Step, ticks: int) -> Array:
    """Durations of calls that find a cold cache, one per tick."""
    cache = np.zeros(CACHE_BYTES, dtype=np.uint8)
    durations = []
    for _ in range(ticks):
        cache += 1
        time.sleep(TICK_S)
        durations.append(timed_us(step))
    return np.array(durations)


def table(heads: Sequence[str], rows: Iterator[Sequence[str | float]], digits: int = 0) -> str:
    """Markdown, each row shown on the standard error as soon as it is there; numbers with so many digits."""
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for row in rows:
        cells = [cell if isinstance(cell, str) else f"{cell:.{digits}f}" if isfinite(cell) else "–" for cell in row]
        lines.append(f"| {' | '.join(cells)} |")
        print(lines[-1], file=sys.stderr, flush=True)
    return "\n".join(lines)


# --- replay ----------------------------------------------------------------------------------------------------------

GYROS: Final = ("gx_radps", "gy_radps", "gz_radps")
CONTENTS: Final[dict[str, tuple[str, ...]]] = {
    "acceleration, attitude, gyros, laser": (),
    "acceleration, attitude, gyros": ("laser_m",),
    "acceleration, attitude": ("laser_m", *GYROS),
    "vertical acceleration": ("laser_m", *GYROS, "ax_mps2", "ay_mps2", "roll_deg", "pitch_deg", "yaw_deg"),
}
"""What is in a recording -> columns that are left out of it."""


def without(source: Path, target: Path, columns: tuple[str, ...]) -> None:
    """Copy a recording but for some columns."""
    with source.open(newline="") as given, target.open("w", newline="") as made:
        rows = csv.reader(given)
        names = next(rows)
        kept = [i for i, name in enumerate(names) if name not in columns]
        writer = csv.writer(made, lineterminator="\n")
        writer.writerow([names[i] for i in kept])
        writer.writerows([row[i] for i in kept] for row in rows)


def bench_replay(options: Options) -> Report:
    """Processor time of the whole command, the start of the interpreter left out."""

    def rows(folder: Path) -> Iterator[Sequence[str | float]]:
        for rate_hz in options.rates:
            made = record(seaway(options.sea, 1), options.seconds, imu_rate_hz=rate_hz, laser="on", seed=1001)
            write_recording(folder / "whole.csv", made)
            for content, columns in CONTENTS.items():
                without(folder / "whole.csv", folder / "part.csv", columns)
                started_s = time.process_time()
                done = replay(folder / "part.csv", folder / "out.csv", Config())
                cost_s = time.process_time() - started_s
                speed, cost_us = f"{done.duration_s / cost_s:.0f}", f"{1e6 * cost_s / done.rows:.1f}"
                yield f"{rate_hz:g} Hz", content, f"{cost_s:.2f}", speed, cost_us

    with tempfile.TemporaryDirectory() as folder:
        shown = table(("rate", "recording", "s", "times real time", "µs per row"), rows(Path(folder)))
    return Report(f"{options.seconds:g} s of {options.sea}, one process:\n\n{shown}", (1,))


# --- rock ------------------------------------------------------------------------------------------------------------

WARM_S, BLOCK_S = 150.0, 30.0
ML_HORIZONS_S: Final = (0.5, 1.0, 2.0, 5.0)
Sample = tuple[float, float, float, float, float, float]
"""Roll, pitch, yaw and their rates."""


def predictors() -> dict[str, Callable[[float, Sample], object]]:
    """Fresh ones; three axes and seven horizons unless it says otherwise."""
    direct, rated = DirectRockPredictor(), DirectRockPredictor()
    single = DirectPredictor(1)
    paper = MaximumLikelihoodPredictor(Params(horizons_s=ML_HORIZONS_S))
    return {
        "ml": lambda t, x: paper.step(t, x[:3]),
        "direct": lambda t, x: direct.step(t, x[:3]),
        "direct, with rates": lambda t, x: rated.step(t, x[:3], x[3:]),
        "direct, one channel": lambda t, x: single.step(t, x[:1]),
    }


def motion(t_s: Array) -> list[Sample]:
    """Roll, pitch, yaw of harmonics with noise, and their rates; rad, rad/s."""
    rng = np.random.default_rng(1)
    angles, rates = [], []
    for period_s, size in ((12.0, 0.05), (6.5, 0.02), (10.0, 0.01)):
        w = 2 * np.pi / period_s
        angles.append(size * (np.sin(w * t_s) + 0.4 * np.sin(1.17 * w * t_s)) + 1e-5 * rng.standard_normal(len(t_s)))
        rates.append(size * w * (np.cos(w * t_s) + 0.47 * np.cos(1.17 * w * t_s)))
    return list(zip(*(column.tolist() for column in (*angles, *rates)), strict=True))


def blocks_us(step: Callable[[float, Sample], object], rate_hz: float, blocks: int) -> list[float]:
    """Processor time of a sample, mean of each block of 30 s: all that is solved and moved in turn is in it."""
    t = np.arange(round((WARM_S + blocks * BLOCK_S) * rate_hz), dtype=np.float64) / rate_hz
    samples = list(zip(t.tolist(), motion(t), strict=True))
    warm, size = round(WARM_S * rate_hz), round(BLOCK_S * rate_hz)
    for now, sample in samples[:warm]:
        step(now, sample)
    means = []
    for first in range(warm, len(samples) - size + 1, size):
        start = time.process_time_ns()
        for now, sample in samples[first : first + size]:
            step(now, sample)
        means.append((time.process_time_ns() - start) / 1000.0 / size)
    return means


def bench_rock(options: Options) -> Report:
    """A sample with everything that falls due in between, hot, after 150 s of motion."""

    def rows() -> Iterator[Sequence[str | float]]:
        for rate_hz in options.rates:
            for name, step in predictors().items():
                means = blocks_us(step, rate_hz, options.blocks)
                yield name, f"{rate_hz:g}", min(means), float(np.median(means))

    return Report(table(("predictor", "Hz", "best µs", "median µs"), rows(), digits=1), (1,))


# --- hull ------------------------------------------------------------------------------------------------------------

STARTED_S: Final = 30.0
"""The steps are timed from here on: each update is taken once."""


def hull_steps_us(record: Record, estimator: HullDeformation) -> Array:
    """Duration of every step through a record."""
    rows = zip(record.midships_t_s.tolist(), record.midships_radps, record.local_radps, strict=True)
    return np.array([timed_us(lambda row=row: estimator.step(*row)) for row in rows])  # type: ignore[misc]  # a default


def bench_hull(options: Options) -> Report:
    """Step after step. What is due every ten seconds (the forecast) is in the largest; the start (an alignment and two
    passes through 5 s) and the refit (a fit and a pass through the record) are given by themselves.
    """
    made = simulate(SCENES["A1"], 1, duration_s=max(options.seconds, STARTED_S + 10.0))
    first = round(10 * STARTED_S)

    def rows() -> Iterator[Sequence[str | float]]:
        for method in estimate.Method:
            us = hull_steps_us(made, HullDeformation(estimate.Params(method=method, refit_after_s=0.0)))
            late = us[first:]
            yield method, float(np.median(late)), float(np.percentile(late, 99)), late.max(), us[:first].max()

    shown = table(("method", "step, median µs", "99 %", "largest", "start"), rows())
    base = hot_us(lambda: crane_base_attitude(AttitudeAngles(0.01, 0.02, 1.0), made.static), 40)
    waiting = HullDeformation(estimate.Params(refit_after_s=300.0), refit_inline=False)
    hull_steps_us(simulate(SCENES["A1"], 1, duration_s=310.0), waiting)
    job = waiting.due_refit
    assert job is not None
    refit_ms = timed_us(lambda: refit(job)) / 1000.0
    return Report(f"{shown}\n\ncrane-base attitude {base:.1f} µs; refit of 300 s {refit_ms:.0f} ms", (1,))


# --- attitude fusion and sigma points --------------------------------------------------------------------------------


def fused(params: FusionParams) -> Step:
    """Steps of a filter on a sine of a few decimetres and degrees, at 100 Hz."""
    fusion, number = AttitudeFusion(params), count()

    def step() -> object:
        t = next(number) * TICK_S
        swing = float(np.sin(2.0 * t))
        return fusion.step(t, 0.3 * swing, 0.02 * swing, 18.0, -0.02 * swing, 0.02 * swing)

    for _ in range(50):
        step()
    return step


def one_by_one() -> Step:
    """Three filters of the same size by ``sigma.predict`` and ``sigma.update``, nothing mixed, nothing checked."""
    craft, points = Craft(Vessel()), sigma.cubature(len(State))
    waves, flaps = propagation(WaveShape(), TICK_S).rows, np.zeros((2, 1))
    x, P, Q = np.zeros(len(State)), 0.01 * np.eye(len(State)), 1e-6 * np.eye(len(State))
    H, R, z = np.eye(len(State))[[State.Z, State.THETA]], np.diag([2.5e-3, 2.5e-5]), np.zeros(2)

    def move(rows: Array) -> Array:
        columns = rows.T
        carried = waves.dot(columns[4:])
        forces = np.stack((columns[4:6], carried[0:2], carried[2:4]))
        return np.vstack((craft.advance(columns[:4], TICK_S, 18.0, flaps, forces), carried[2:])).T

    def step() -> object:
        last: object = None
        for _ in range(3):
            predicted = sigma.predict(points, x, P, move, Q)
            assert predicted is not None
            last = sigma.update(points, predicted.x, predicted.P, z, H, R)
        return last

    return step


def bench_fusion(options: Options) -> Report:
    """Each mode beside its filters one by one through the sigma-point core."""
    contenders = {
        "imm, three seas": fused(FusionParams()),
        "ewma, three seas": fused(FusionParams(mode=Mode.EWMA)),
        "instant, three seas": fused(FusionParams(mode=Mode.INSTANT, bank=Differ.SEAS)),
        "instant, two point sets": fused(FusionParams(mode=Mode.INSTANT)),
        "three filters one by one": one_by_one(),
    }

    def rows() -> Iterator[Sequence[str | float]]:
        for name, step in contenders.items():
            cold = cold_us(step, options.ticks)
            yield name, hot_us(step, options.repeats), float(np.median(cold)), float(np.percentile(cold, 99))

    return Report(table(("mode", "hot µs", "cold µs", "99 % µs"), rows()))


def linear_steps(n: int) -> dict[str, Step]:
    """A Kalman step and one with each point set, on the same linear model with one measurement."""
    rng = np.random.default_rng(n)
    F, Q, H, R = 0.99 * np.eye(n), 1e-5 * np.eye(n), rng.normal(size=(1, n)), np.array([[0.022]])
    x, P, z = np.zeros(n), 0.1 * np.eye(n), np.array([0.1])

    def kalman() -> object:
        predicted, cov = F @ x, F @ P @ F.T + Q
        gain = cov @ H.T / (H @ cov @ H.T + R)
        return predicted + gain @ (z - H @ predicted), cov - gain @ (H @ cov)

    def sigma_point(points: sigma.PointSet) -> Step:
        def step() -> object:
            predicted = sigma.predict(points, x, P, F, Q)
            assert predicted is not None
            return sigma.update(points, predicted.x, predicted.P, z, H, R)

        return step

    makers = (sigma.symmetric, sigma.cubature, sigma.spherical_simplex, sigma.minimal_skew_simplex)
    return {"linear Kalman": kalman} | {points.name: sigma_point(points) for points in (make(n) for make in makers)}


def bench_sigma(options: Options) -> Report:
    """One predict and update; ratios are to the plain Kalman step of the same size."""

    def rows() -> Iterator[Sequence[str | float]]:
        for n in (3, 11, 21):
            found = {
                name: (hot_us(step, options.repeats), float(np.median(cold_us(step, options.ticks))))
                for name, step in linear_steps(n).items()
            }
            base_hot, base_cold = found["linear Kalman"]
            for name, (hot, cold) in found.items():
                yield str(n), name, hot, f"{hot / base_hot:.2f}", cold, f"{cold / base_cold:.2f}"

    return Report(table(("n", "step", "hot µs", "ratio", "cold µs", "ratio"), rows(), digits=1))


# --- training --------------------------------------------------------------------------------------------------------

WIDTH: Final = 50


def training_window(rows: int) -> TrainingWindow:
    """A residual that is a delayed share of the heave."""
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


async def lateness_us(seconds: float) -> Array:
    """How long after its deadline each tick runs on the loop."""
    first_s = time.monotonic() + TICK_S
    with DeadlineTimer() as timer:
        return np.array([1e6 * await timer.wait_until(first_s + n * TICK_S) for n in range(round(seconds / TICK_S))])


async def idle(_: TrainingWindow, seconds: float) -> tuple[Array, int]:
    """No training."""
    return await lateness_us(seconds), 0


async def process(window: TrainingWindow, seconds: float) -> tuple[Array, int]:
    """Our trainer process, which begins anew as soon as it is done."""
    trained = 0

    def next_one(_: TrainedNetwork) -> None:
        nonlocal trained
        trained += 1
        trainer.submit(window)

    trainer = Worker(TRAINING, next_one, print)
    await trainer.start()
    trainer.submit(window)
    try:
        return await lateness_us(seconds), trained
    finally:
        await trainer.stop()


async def thread(window: TrainingWindow, seconds: float) -> tuple[Array, int]:
    """Torch in a thread of this process. Last of all, because it leaves torch behind."""
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


VARIANTS: Final[dict[str, Callable[[TrainingWindow, float], Awaitable[tuple[Array, int]]]]] = {
    "no training": idle,
    "trainer process": process,
    "torch in a thread": thread,
}


def bench_training(options: Options) -> Report:
    """Lateness of a timerfd tick of 10 ms while training repeats without a pause."""
    window = training_window(options.rows)

    async def measured(name: str) -> tuple[Array, int]:
        return await VARIANTS[name](window, options.seconds)

    def rows() -> Iterator[Sequence[str | float]]:
        for name in VARIANTS:
            late, trained = asyncio.run(measured(name))
            yield name, float(trained), *np.percentile(late, [50, 99]).tolist(), late.max()

    return Report(table(("", "trainings", "p50 µs", "p99 µs", "max µs"), rows()), (1,))


# --- telegrams -------------------------------------------------------------------------------------------------------


def a_frame() -> MotionFrame:
    """The last one of two minutes at sea, with a delayed heave."""
    made = record(seaway("S6", 1), 120.0, imu_rate_hz=20.0, laser="off", seed=1001)
    pipeline = make_pipeline(Config())
    frame = None
    for sample in made.samples():
        frame = pipeline.step(sample) or frame
        if (past := pipeline.fit_due()) is not None:
            pipeline.accept_fit(look(past))
    assert frame is not None
    return frame


def bench_telegrams(options: Options) -> Report:
    """What one message costs the event loop: the motion of the moment, its signs, its bytes."""
    frame = a_frame()
    now_s = frame.t_s + 0.002

    def telegram(form: Format, spec: OutputSpec) -> Step:
        def step() -> bytes:
            motion = motion_at(frame, "", form.lead, now_s, lambda t_s: 1.8e9 + t_s)
            return form.encode(as_read(motion, spec, form.signs), spec)

        return step

    def rows() -> Iterator[Sequence[str | float]]:
        motion = motion_at(frame, "", Lead.TRANSMISSION, now_s, lambda t_s: 1.8e9 + t_s)
        for name, form in FORMATS.items():
            spec = OutputSpec(name="bench", telegram=name, link="udp://127.0.0.1:5000")
            encoded = hot_us(partial(form.encode, motion, spec), options.repeats)
            whole_us, cold = hot_us(telegram(form, spec), options.repeats), cold_us(telegram(form, spec), options.ticks)
            yield form.title, encoded, whole_us, *np.percentile(cold, [50, 99]).tolist()
        registers = RegisterMap(RegistersParams(), (), lambda t_s: 1.8e9 + t_s)

        def words() -> object:
            registers.push(frame)
            return registers.at(now_s)

        cold = cold_us(words, options.ticks)
        yield "registers", nan, hot_us(words, options.repeats), *np.percentile(cold, [50, 99]).tolist()

    heads = ("", "its bytes µs", "with motion and signs µs", "cold p50 µs", "cold p99 µs")
    return Report(table(heads, rows(), digits=1), (1,))


# --- command line ----------------------------------------------------------------------------------------------------


class Bench(NamedTuple):
    """A subcommand: what it does, and its options with their defaults."""

    run: Callable[[Options], Report]
    options: dict[str, int | float | str | tuple[float, ...]]
    help: str


BENCHES: Final[dict[str, Bench]] = {
    "replay": Bench(bench_replay, {"seconds": 600.0, "sea": "S6", "rates": (100.0, 20.0)}, "a recording, replayed"),
    "rock": Bench(bench_rock, {"blocks": 20, "rates": (5.0, 20.0, 100.0, 200.0)}, "a sample in the rock predictors"),
    "hull": Bench(bench_hull, {"seconds": 120.0}, "a step of the hull deformation"),
    "fusion": Bench(bench_fusion, {"repeats": 20, "ticks": 150}, "a step of the attitude fusion"),
    "sigma": Bench(bench_sigma, {"repeats": 30, "ticks": 150}, "sigma points beside a Kalman step"),
    "telegrams": Bench(bench_telegrams, {"repeats": 200, "ticks": 100}, "a telegram of each format"),
    "training": Bench(bench_training, {"seconds": 15.0, "rows": 3000}, "the event loop while a network is trained"),
}


def _parser() -> Parser:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    commands = parser.add_subparsers(dest="bench", required=True)
    for name, bench in BENCHES.items():
        command = commands.add_parser(name, help=bench.help)
        for option, default in bench.options.items():
            if isinstance(default, tuple):
                command.add_argument(f"--{option}", type=positive, nargs="+", default=default, metavar="HZ")
            elif isinstance(default, str):
                command.add_argument(f"--{option}", default=default, choices=sorted(SEAS))
            else:
                kind = whole if isinstance(default, int) else positive
                command.add_argument(f"--{option}", type=kind, default=default, help=f"default {default:g}")
        command.add_argument("--record", action="store_true", help="put the table into tools/RESULTS.md")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    options = _parser().parse_args(words)
    made_with, started = results.provenance(), time.monotonic()
    report = BENCHES[options.bench].run(options)
    print(report.text)
    if options.record:
        results.record(__file__, words, report, made_with, time.monotonic() - started)
    return 0


if __name__ == "__main__":
    sys.exit(main())
