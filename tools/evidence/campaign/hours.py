"""Faults that last for hours, where time is data: the daemon's own pipeline on samples of a simulated sea."""

from __future__ import annotations

from math import inf, isfinite
from typing import TYPE_CHECKING, Final

import msgspec

from evidence.campaign.judge import MOST_STDS, Score
from heaved.config.read import data_directory, load
from heaved.daemon.daemon import make_pipeline
from heaved.estimation.heave.sea.refit import look
from heaved.samples import HeaveState, LaserSample, LaserState
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import record
from heaved.workers.train_correction import fit

if TYPE_CHECKING:
    from collections.abc import Callable

LEARNS_S: Final = 600.0
"""With the laser, before it goes: lead, scale and network are there."""
AFTER_S: Final = 300.0
RATE_HZ: Final = 20.0


class LaserLost(msgspec.Struct, frozen=True):
    """What a laser that was away for so long has shown."""

    away_s: float
    score: Score
    """Of the time without it."""
    afterwards: Score
    back_s: float
    """Until the heave is held against it again; inf: never."""
    trainings: int


def laser_lost(sea: str, seed: int, away_s: float, say: Callable[[str], None] = lambda _text: None) -> LaserLost:
    """The laser goes once all is learned, and comes again ``away_s`` later, its target elsewhere by then."""
    gone_s, until_s = LEARNS_S, LEARNS_S + away_s
    recording = record(
        seaway(sea, seed), until_s + AFTER_S, imu_rate_hz=RATE_HZ, laser_rate_hz=RATE_HZ, sensor="A", seed=seed
    )
    pipe = make_pipeline(load(data_directory() / "sensors.toml"))
    score, afterwards, back_s, trainings, row = Score(), Score(), inf, 0, 0
    for sample in recording.samples():
        if isinstance(sample, LaserSample):
            if not gone_s <= sample.t_s < until_s:
                off_m = 0.0 if sample.t_s < gone_s else 1.5  # The tide.
                pipe.step(msgspec.structs.replace(sample, laser_m=sample.laser_m + off_m))
            continue
        frame = pipe.step(sample)
        if (past := pipe.fit_due()) is not None:
            pipe.accept_fit(look(past))
        if (window := pipe.training_due()) is not None:
            pipe.accept(fit(window))
            trainings += 1
        if row % round(600.0 * RATE_HZ) == 0:
            say(f"laser lost: {sample.t_s / 60.0:.0f} min")
        true_m = float(recording.truth.heave_m[row])
        row += 1
        if frame is None or frame.t_s < gone_s:
            continue
        if frame.t_s >= until_s and frame.quality.laser is LaserState.VALID:
            back_s = min(back_s, frame.t_s - until_s)
        one = score if frame.t_s < until_s else afterwards
        one.lines += 1
        if frame.quality.heave is not HeaveState.VALID:
            continue
        one.valid += 1
        off_m = abs(frame.heave_m - true_m)
        stds = off_m / frame.heave_std_m if frame.heave_std_m > 0.0 else inf
        one.worst_stds, one.worst_m = max(one.worst_stds, stds), max(one.worst_m, off_m)
        if not (stds <= MOST_STDS and isfinite(off_m)):
            one.wrong.append(f"heave {frame.heave_m:.3f} m where {true_m:.3f} m was true, at {frame.t_s:.2f} s")
    return LaserLost(away_s, score, afterwards, back_s, trainings)
