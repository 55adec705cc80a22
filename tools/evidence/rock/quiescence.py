"""The quiescence forecast on trial: hits, misses and false alarms, Brier scores beside climate and persistence, and how
often what it gave a chance of p came true.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from evidence.commands import in_order
from evidence.rock.seas import DEGREE, RATE_HZ, Sea, Ship, motion
from heaved.estimation.quiescence import MotionForecast, Params, Quiescence
from heaved.estimation.rock import direct as rock_direct

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]

FORECAST_S = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
SCORED_FROM_S = 900.0
STARTS = (0, 2, 5, 10, 20, 30)
BINS = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
SCENES = {
    "swell": ((Sea(13.0),), 1.0),
    "wind sea": ((Sea(8.2),), 1.0),
    "wind sea, moderate": ((Sea(8.2),), 0.7),
}
"""The sea, and the size of the motion."""


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """One sea and one start of the window, judged every second."""

    scene: str
    start_s: float
    base_rate: float
    brier: float
    brier_climate: float
    brier_persistence: float
    hits: int
    misses: int
    false_alarms: int
    reliability: tuple[tuple[float, float, int], ...]
    """Mean probability given, share that came true, how many; per bin."""


def ships(seas: tuple[Sea, ...], size: float) -> tuple[Ship, Ship, Ship]:
    """Roll, pitch and heave at a monitoring point."""
    angle = 0.02 * DEGREE
    return (
        Ship(name="roll", seas=seas, std=1.5 * DEGREE * size, noise=angle, period_s=12, damping=0.07),
        Ship(name="pitch", seas=seas, std=0.6 * DEGREE * size, noise=angle, period_s=6.5, damping=0.35),
        Ship(name="heave", seas=seas, std=0.4 * size, noise=0.01, period_s=8, damping=0.35),
    )


def run(seas: tuple[Sea, ...], size: float, params: Params, duration_s: float, seed: int) -> tuple[Array, Array]:
    """Probabilities (seconds, starts) and largest excursions (seconds,) of the truth in each second."""
    rng = np.random.default_rng(seed)
    axes = ships(seas, size)
    truth = np.stack([motion(ship, duration_s, rng) for ship in axes], axis=1)
    measured = truth + np.array([ship.noise for ship in axes]) * rng.standard_normal(truth.shape)
    predictor = rock_direct.DirectPredictor(3, rock_direct.Params(horizons_s=FORECAST_S))
    horizons = np.array(FORECAST_S)
    quiescence = Quiescence(params)
    every = round(RATE_HZ)
    given = []
    for i, row in enumerate(measured.tolist()):
        t = i / RATE_HZ
        if i and i % every == 0:
            roll, pitch, heave = row
            quiescence.step(t, roll, pitch, heave, MotionForecast(horizons, predictor.values, predictor.std))
            given.append(quiescence.probabilities)
        else:
            quiescence.step(t, *row)
        predictor.step(t, row)
    limits = np.array([params.roll_limit_deg * DEGREE, params.pitch_limit_deg * DEGREE, params.heave_limit_m])
    reach = np.max(np.abs(truth) / limits, axis=1)
    seconds = reach[: len(reach) // every * every].reshape(-1, every).max(axis=1)
    return np.array(given), seconds


def judge(name: str, params: Params, duration_s: float, seeds: Sequence[int]) -> list[Verdict]:
    """Forecasts made at the end of each second against what followed; pooled over the seeds."""
    length = round(params.duration_s)
    begin = round(SCORED_FROM_S)
    pooled: dict[int, list[tuple[Array, Array, Array]]] = {}
    for seed in seeds:
        given, seconds = run(*SCENES[name], params, duration_s, seed)
        quiet = np.lib.stride_tricks.sliding_window_view(seconds, length).max(axis=1) < 1.0
        for start in STARTS:
            made = np.arange(begin, len(quiet) - start - 1)
            # given[i] was made when second i was over; the window begins with second i + 1 + start.
            pooled.setdefault(start, []).append((given[made, start], quiet[made + 1 + start], quiet[made + 1 - length]))
    verdicts = []
    for start, parts in pooled.items():
        p, came, was = (np.concatenate(column) for column in zip(*parts, strict=True))
        base = float(np.mean(came))
        persistent = np.where(was, np.mean(came[was]) if was.any() else base, np.mean(came[~was]))
        announced = p >= params.min_confidence
        bins = np.digitize(p, BINS[1:-1])
        verdicts.append(
            Verdict(
                scene=name,
                start_s=float(start),
                base_rate=base,
                brier=float(np.mean((p - came) ** 2)),
                brier_climate=base * (1 - base),
                brier_persistence=float(np.mean((persistent - came) ** 2)),
                hits=int(np.sum(announced & came)),
                misses=int(np.sum(~announced & came)),
                false_alarms=int(np.sum(announced & ~came)),
                reliability=tuple(
                    (float(np.mean(p[bins == b])), float(np.mean(came[bins == b])), int(np.sum(bins == b)))
                    for b in range(len(BINS) - 1)
                    if np.any(bins == b)
                ),
            )
        )
    return verdicts


def table(seeds: Sequence[int], duration_s: float, jobs: int) -> list[Verdict]:
    """Every sea, with windows of 10 s within 30 s.

    Raises:
        ValueError: the record is too short to be judged.
    """
    if duration_s < SCORED_FROM_S + 300.0:
        raise ValueError(f"quiet windows need records of {SCORED_FROM_S + 300.0:g} s, got {duration_s:g} s")
    work = partial(judge, params=Params(), duration_s=duration_s, seeds=seeds)
    return [verdict for verdicts in in_order(work, list(SCENES), jobs) for verdict in verdicts]


def report(verdicts: Sequence[Verdict]) -> str:
    """The tables as Markdown."""
    lines = [
        "| sea | starts in s | base rate | Brier | climate | persistence | hits | misses | false alarms "
        "| given -> came (n) |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for v in verdicts:
        pairs = ", ".join(f"{given:.2f} -> {came:.2f} ({count})" for given, came, count in v.reliability)
        lines.append(
            f"| {v.scene} | {v.start_s:g} | {v.base_rate:.3f} | {v.brier:.4f} | {v.brier_climate:.4f} "
            f"| {v.brier_persistence:.4f} | {v.hits} | {v.misses} | {v.false_alarms} | {pairs} |"
        )
    return "\n".join(lines)
