"""The learned correction with a network in use: what it gains over its own observer, and that it is never worse.

With everything on there is next to nothing to see: the laser teaches the sea observer the lag and the scale of its
sensor, and what is left is what no past can foretell (the error of an estimate that is the best of its past is
uncorrelated with that past), so that hardly any network passes the guard. The trials of ``taught = False`` leave one
something to learn: ``[heave.lead] enabled = false``, and the delay (2 Hz low-pass, 0.11 s) and the 2 % of sensor B stay
in the observer's output. A sensor slower still (a low-pass of 0.5 Hz) leaves a little to learn though its lag is
taught, now and then, and much that only looks like it. Untaught, on a wave train, with the laser all the time, a
network is in use from the first one on. Networks are trained as in a replay, by the trainer's own process, which is
waited for.
"""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from math import isfinite, nan
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from evidence.commands import in_order
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, reference
from heaved.estimation.heave.sea.refit import look
from heaved.estimation.rock import params as rock
from heaved.pipeline import Pipeline, assemble
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import SENSORS, laser_pattern, record
from heaved.workers.process import BlockingTrainer

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from heaved.samples import MotionFrame

Array = NDArray[np.float64]

SLOW_B: Final = msgspec.structs.replace(SENSORS["B"], bandwidth_hz=0.5)
SHORTEST_S: Final = 20.0
"""Of a segment that is scored: a few waves."""
ASKED_OUTAGE: Final = 1.02
"""Ratio of the error with a correction to that of the observer, in any outage."""
IN_USE_M: Final = 1e-6
"""A correction beyond it counts as applied."""


class Trial(msgspec.Struct, frozen=True, kw_only=True):
    """One record, and what the pipeline may learn of it."""

    sea: str
    laser: str
    duration_s: float
    sensor: str = "B"
    """One of the simulated ones, or "slow B"."""
    taught: bool = False
    """Whether the comparison with the laser sets lead and gain, as it does by default."""
    rate_hz: float = 20.0
    seed: int = 1
    """The sea's; that of the sensors is 1000 more."""


class Segment(msgspec.Struct, frozen=True, kw_only=True):
    """A stretch with the laser, or without, after a network was first taken into use."""

    start_s: float
    end_s: float
    laser_on: bool
    sigma_m: float
    """Of true heave."""
    observer_rms_m: float
    """Error of the observer's own output."""
    corrected_rms_m: float
    """Error of what is published."""
    in_use: float
    """Share of the time in which a correction was applied."""

    @property
    def ratio(self) -> float:
        """Corrected over observer: above 1 the correction has done harm."""
        return self.corrected_rms_m / self.observer_rms_m


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """What has become of a trial."""

    trial: Trial
    verdicts: dict[str, int]
    """Trained networks, by what the guard made of them."""
    accepted_s: float
    """When the first was taken into use; nan: none was."""
    segments: tuple[Segment, ...]


HALF: Final = "180+120,300+60,420+180,660+60,780+120"
"""Half of the time, once the first network is there; outages of one, two and three minutes."""
THROUGH_THE_GROWTH: Final = "60+60,180+60,300+60,420+60,570+300,1000+100,1220+200"
"""Away while SX grows (600-660 s) and while it falls (1260-1320 s)."""
TRIALS: Final = (
    *(Trial(sea=sea, laser=HALF, duration_s=900.0) for sea in ("S6", "T3")),
    Trial(sea="SX", laser=THROUGH_THE_GROWTH, duration_s=1500.0),
    *(
        Trial(sea=sea, laser=HALF, duration_s=900.0, taught=True, sensor=sensor)
        for sensor in ("B", "slow B")
        for sea in ("S6", "T3")
    ),
    Trial(sea="T3", laser="on", duration_s=480.0, sensor="slow B", rate_hz=10.0),
)


def run(trial: Trial) -> Outcome:
    """Through the pipeline of the daemon; what is due to be learned is learned before the next sample.

    Raises:
        ValueError: unknown sea, sensor or laser pattern.
    """
    recording = record(
        seaway(trial.sea, trial.seed, start_s=37.0 * trial.seed),
        trial.duration_s,
        imu_rate_hz=trial.rate_hz,
        sensor=SLOW_B if trial.sensor == "slow B" else trial.sensor,
        laser=trial.laser,
        seed=1000 + trial.seed,
    )
    pipe = _pipeline(trial)
    frames: list[MotionFrame] = []
    verdicts = Counter(accepted=0, rejected=0, failed=0)
    accepted_s = nan
    with BlockingTrainer() as trainer:
        for sample in recording.samples():
            frame = pipe.step(sample)
            if (past := pipe.fit_due()) is not None:
                pipe.accept_fit(look(past))
            if (window := pipe.training_due()) is not None:
                verdicts[verdict := pipe.accept(trainer.fit(window))] += 1
                if verdict == "accepted" and not isfinite(accepted_s):
                    accepted_s = sample.t_s
            if frame is not None:
                frames.append(frame)
    segments = tuple(_segments(trial, frames, recording.truth.heave_m, accepted_s))
    return Outcome(trial=trial, verdicts=dict(verdicts), accepted_s=accepted_s, segments=segments)


def _pipeline(trial: Trial) -> Pipeline:
    """The daemon's, with its defaults but for forecasts, which are not looked at, and the rock predictor, which shares
    nothing with the heave: the cheapest there is.
    """
    settings = {"forecast_horizons_s": (), "lead": {"enabled": trial.taught}}
    return assemble(
        heave=msgspec.convert(settings, heave.Params),
        laser=reference.Params(),
        correction=correction.Params(),
        rock=rock.Params(predictor="ml", thetas=(0.7,), horizons_s=()),
        has_laser=True,
    )


def _segments(trial: Trial, frames: Sequence[MotionFrame], truth_m: Array, from_s: float) -> Iterator[Segment]:
    """truth_m: (n,), of each frame."""
    t = np.array([frame.t_s for frame in frames])
    observer, published = (np.array([getattr(frame, name) for frame in frames]) for name in ("observer_m", "heave_m"))
    applied = np.abs([frame.correction_m for frame in frames]) > IN_USE_M
    pattern = laser_pattern(trial.laser)
    laser_on = np.array([pattern.on(at) for at in t.tolist()], dtype=bool)
    borders = [0, *(np.flatnonzero(np.diff(laser_on)) + 1).tolist(), t.size]
    for begin, end in pairwise(borders):
        first = max(begin, int(np.searchsorted(t, from_s, side="right"))) if isfinite(from_s) else end
        part = slice(first, end)
        if (end - first) < SHORTEST_S * trial.rate_hz:
            continue
        yield Segment(
            start_s=float(t[first]),
            end_s=float(t[end - 1]),
            laser_on=bool(laser_on[first]),
            sigma_m=float(np.std(truth_m[part])),
            observer_rms_m=_rms(observer[part] - truth_m[part]),
            corrected_rms_m=_rms(published[part] - truth_m[part]),
            in_use=float(np.mean(applied[part])),
        )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def table(seeds: Sequence[int], jobs: int) -> list[Outcome]:
    """Every trial with every seed."""
    todo = [msgspec.structs.replace(trial, seed=seed) for trial in TRIALS for seed in seeds]
    return in_order(run, todo, jobs)


def report(outcomes: Sequence[Outcome]) -> str:
    """Markdown: a line for each trial and seed, with the laser and without."""
    lines = [
        "## The learned correction with a network in use",
        "",
        "| sea | sensor | lead, gain | seed | accepted / rejected | first | laser | in use | observer, mm "
        "| corrected, mm | ratio | worst segment |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for outcome in outcomes:
        trial, verdicts = outcome.trial, outcome.verdicts
        lead = "from the laser" if trial.taught else "not learned"
        head = f"| {trial.sea} | {trial.sensor} | {lead} | {trial.seed} "
        head += f"| {verdicts['accepted']} / {verdicts['rejected'] + verdicts['failed']} "
        if not outcome.segments:
            lines.append(head + "| – | – | – | – | – | – | – |")
        for laser_on in (True, False):
            parts = [part for part in outcome.segments if part.laser_on is laser_on]
            if parts:
                lines.append(f"{head}| {outcome.accepted_s:.0f} s | {'on' if laser_on else 'off'} " + _pooled(parts))
    seen, away = (
        max((part.ratio for one in outcomes for part in one.segments if part.laser_on is is_on), default=nan)
        for is_on in (True, False)
    )
    asked = "missed" if away > ASKED_OUTAGE else "met"
    lines += ["", f"Worst segment with the laser: {seen:.3f}; without: {away:.3f}, asked {ASKED_OUTAGE:g}: {asked}."]
    return "\n".join(lines)


def _pooled(parts: Sequence[Segment]) -> str:
    """The cells of several segments together, each weighing as long as it is."""
    weights = np.array([part.end_s - part.start_s for part in parts])
    observer, corrected = (
        float(np.sqrt(np.average(np.array([getattr(part, name) for part in parts]) ** 2, weights=weights)))
        for name in ("observer_rms_m", "corrected_rms_m")
    )
    in_use = float(np.average([part.in_use for part in parts], weights=weights))
    worst = max(part.ratio for part in parts)
    return (
        f"| {100.0 * in_use:.0f} % | {1e3 * observer:.2f} | {1e3 * corrected:.2f} "
        f"| {corrected / observer:.3f} | {worst:.3f} |"
    )
