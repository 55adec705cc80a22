"""The crane's tip in figures: heave, its velocity and acceleration and its forecasts, of a crane parked and at work.

The least that an error can be is shown beside it: the same tip with the crane's posture known exactly, so that what the
encoders cost is what lies between the two. What is left then is that of the heave and of the measured attitude.
"""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from evidence.commands import (
    Command,
    Options,
    Parser,
    add_common,
    add_duration,
    add_jobs,
    add_seeds,
    in_order,
    seeds_of,
)
from evidence.results import Output, Report
from heaved.estimation.crane.geometry import Params
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, reference
from heaved.estimation.heave.sea.refit import look
from heaved.estimation.lever_arm import Point
from heaved.estimation.rock import params as rock
from heaved.estimation.stages import Stages
from heaved.pipeline import Pipeline, assemble
from heaved.simulate.crane import CraneAtWork, CraneBuild, CraneModel, CraneSensors, Encoders, height_m
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import Recording, record

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from heaved.samples import MotionFrame, Sample

Array = NDArray[np.float64]

SEAS: Final = ("S4", "S6")
SENSORS: Final = ("A", "AHRS")
HORIZONS_S: Final = (0.5, 1.0, 2.0)
DURATION_S: Final = 420.0
FROM_S: Final = 120.0
"""The observer has settled."""
BUILD: Final = CraneBuild()
READINGS_HZ: Final = 10.0


class Crane(msgspec.Struct, frozen=True, kw_only=True):
    """What the crane does, and how it is read."""

    name: str
    model: CraneModel = CraneModel()
    encoders: Encoders = Encoders()
    rate_hz: float = READINGS_HZ
    angle_std_deg: float = 0.1


EXACT: Final = Encoders(step_deg=1e-6, step_m=1e-6)
CRANES: Final = (
    Crane(name="parked", model=CraneModel(is_parked=True)),
    Crane(name="at work"),
    Crane(name="at work, 5 readings a second", rate_hz=5.0),
    Crane(name="at work, posture known", encoders=EXACT, rate_hz=20.0, angle_std_deg=0.001),
)


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One sea, sensor and crane, of all its records."""

    sea: str
    sensor: str
    crane: str
    imu_error_m: float
    heave_rms_m: float
    """Of the tip."""
    error_m: float
    std_m: float
    """RMS of what is published."""
    within: float
    """Share of errors within 1.96 of it."""
    velocity_error_mps: float
    velocity_rms_mps: float
    acceleration_error_mps2: float
    acceleration_rms_mps2: float
    own_velocity_error_mps: float
    own_velocity_rms_mps: float
    ahead_m: tuple[float, ...]
    """Errors of the forecasts for :data:`HORIZONS_S`,"""
    ahead_within: tuple[float, ...]
    """and the share within 1.96 of their deviations."""


class Task(msgspec.Struct, frozen=True):
    """One record."""

    sea: str
    sensor: str
    crane: Crane
    seed: int
    duration_s: float


def pipeline(crane: Crane) -> Pipeline:
    """The daemon's, with the simulated crane's measures."""
    params = Params(
        pedestal_m=BUILD.pedestal_m,
        heel_outward_m=BUILD.heel_outward_m,
        heel_up_m=BUILD.heel_up_m,
        boom_length_m=BUILD.boom_length_m,
        jib_length_m=BUILD.jib_length_m,
        sheave_outward_m=BUILD.sheave_outward_m,
        sheave_up_m=BUILD.sheave_up_m,
        falls=BUILD.falls,
        hook_below_m=BUILD.hook_below_m,
        angle_std_deg=crane.angle_std_deg,
    )
    return assemble(
        heave=heave.Params(),
        laser=reference.Params(),
        correction=correction.Params(),
        rock=rock.Params(),
        has_laser=False,
        point=(Point(name="tip", frame="boom"),),
        stages=Stages(None, None, params),
    )


def samples(made: Recording, crane: Crane, work: CraneAtWork, seed: int) -> Iterator[Sample]:
    """Of the IMU and of the encoders, by time."""
    sensors = CraneSensors(work, crane.encoders, seed=seed)
    next_s = float(made.t_s[0])
    for sample in made.samples():
        while next_s <= sample.t_s:
            yield sensors.read(next_s)
            next_s += 1.0 / crane.rate_hz
        yield sample


def frames(task: Task) -> tuple[Recording, CraneAtWork, list[MotionFrame]]:
    """A record, and what the pipeline makes of it."""
    made = record(
        seaway(task.sea, task.seed), task.duration_s, imu_rate_hz=20.0, sensor=task.sensor, laser="off", seed=task.seed
    )
    work, pipe = CraneAtWork(task.crane.model, seed=task.seed), pipeline(task.crane)
    found = []
    for sample in samples(made, task.crane, work, task.seed):
        frame = pipe.step(sample)
        if (past := pipe.fit_due()) is not None:
            pipe.accept_fit(look(past))
        if frame is not None:
            found.append(frame)
    return made, work, found


def run(task: Task) -> dict[str, Array]:
    """Errors and truths of one record, by name, from :data:`FROM_S` on."""
    made, work, found = frames(task)
    truth = made.truth
    joints = [work.at(t).at for t in truth.t_s.tolist()]
    own = np.array([height_m(BUILD, at, 0.0, 0.0) for at in joints])
    moved = np.array([
        height_m(BUILD, at, roll, pitch)
        for at, roll, pitch in zip(joints, truth.roll_rad.tolist(), truth.pitch_rad.tolist(), strict=True)
    ])  # fmt: skip
    heave_m = truth.heave_m + moved - own
    velocity, own_velocity = np.gradient(heave_m, truth.t_s), np.gradient(own, truth.t_s)
    acceleration = np.gradient(velocity, truth.t_s)
    points = [frame.points[0] for frame in found]

    def of(name: str) -> Array:
        return np.array([getattr(point, name) for point in points])

    late = truth.t_s - truth.t_s[0] > FROM_S
    kept = {
        "imu": np.array([frame.heave_m for frame in found]) - truth.heave_m,
        "heave": heave_m,
        "error": of("heave_m") - heave_m,
        "std": of("heave_std_m"),
        "velocity error": of("heave_velocity_mps") - velocity,
        "velocity": velocity,
        "acceleration error": of("heave_acceleration_mps2") - acceleration,
        "acceleration": acceleration,
        "own error": of("own_velocity_mps") - own_velocity,
        "own": own_velocity,
    }
    result = {name: values[late] for name, values in kept.items()}
    for horizon_s in HORIZONS_S:
        later = round(horizon_s * 20.0)
        foretold = [next((f for f in point.forecast if f.horizon_s == horizon_s), None) for point in points]
        said = np.array([(nan, nan) if one is None else (one.heave_m, one.std_m) for one in foretold])[late][:-later]
        result[f"ahead {horizon_s:g}"] = said[:, 0] - heave_m[late][later:]
        result[f"ahead std {horizon_s:g}"] = said[:, 1]
    return result


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def table(
    seeds: Sequence[int], jobs: int, duration_s: float = DURATION_S, seas: Sequence[str] = SEAS,
    sensors: Sequence[str] = SENSORS, cranes: Sequence[Crane] = CRANES,
) -> list[Row]:  # fmt: skip
    """Every sea, sensor and crane, its records put together."""
    kinds = [(sea, sensor, crane) for sea in seas for sensor in sensors for crane in cranes]
    tasks = [Task(*kind, seed, duration_s) for kind in kinds for seed in seeds]
    found = in_order(run, tasks, jobs)
    rows = []
    for number, (sea, sensor, crane) in enumerate(kinds):
        of_kind = found[number * len(seeds) : (number + 1) * len(seeds)]
        all_of = {name: np.concatenate([one[name] for one in of_kind]) for name in of_kind[0]}
        rows.append(
            Row(
                sea=sea,
                sensor=sensor,
                crane=crane.name,
                imu_error_m=_rms(all_of["imu"]),
                heave_rms_m=_rms(all_of["heave"]),
                error_m=_rms(all_of["error"]),
                std_m=_rms(all_of["std"]),
                within=float(np.mean(np.abs(all_of["error"]) < 1.96 * all_of["std"])),
                velocity_error_mps=_rms(all_of["velocity error"]),
                velocity_rms_mps=_rms(all_of["velocity"]),
                acceleration_error_mps2=_rms(all_of["acceleration error"]),
                acceleration_rms_mps2=_rms(all_of["acceleration"]),
                own_velocity_error_mps=_rms(all_of["own error"]),
                own_velocity_rms_mps=_rms(all_of["own"]),
                ahead_m=tuple(_rms(all_of[f"ahead {h:g}"]) for h in HORIZONS_S),
                ahead_within=tuple(
                    float(np.mean(np.abs(all_of[f"ahead {h:g}"]) < 1.96 * all_of[f"ahead std {h:g}"]))
                    for h in HORIZONS_S
                ),
            )
        )
    return rows


def report(rows: Sequence[Row]) -> str:
    """Markdown."""
    horizons = " / ".join(f"{h:g}" for h in HORIZONS_S)
    lines = [
        f"Heave of the tip, {BUILD.boom_length_m:g} m of boom and {BUILD.jib_length_m:g} m of jib, encoders of "
        f"{Encoders().step_deg:g}°, {READINGS_HZ:g} readings a second; IMU at 20 Hz.",
        "",
        "| sea | sensor | crane | heave of the IMU, error / mm | of the tip, RMS / m | error / mm | std / mm | "
        "within 1.96 std | velocity, error of RMS / mm/s | acceleration, error of RMS / m/s² | "
        f"own velocity, error of RMS / mm/s | {horizons} s ahead, error / mm (within 1.96 std) |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        ahead = " / ".join(f"{1e3 * e:.0f} ({w:.0%})" for e, w in zip(r.ahead_m, r.ahead_within, strict=True))
        lines.append(
            f"| {r.sea} | {r.sensor} | {r.crane} | {1e3 * r.imu_error_m:.1f} | {r.heave_rms_m:.2f} | "
            f"**{1e3 * r.error_m:.1f}** | {1e3 * r.std_m:.1f} | {r.within:.0%} | "
            f"{1e3 * r.velocity_error_mps:.0f} of {1e3 * r.velocity_rms_mps:.0f} | "
            f"{r.acceleration_error_mps2:.3f} of {r.acceleration_rms_mps2:.2f} | "
            f"{1e3 * r.own_velocity_error_mps:.0f} of {1e3 * r.own_velocity_rms_mps:.0f} | {ahead} |"
        )
    return "\n".join(lines)


def run_crane(options: Options, output: Output) -> Report:
    """
    Raises:
        ValueError: the records end before they are scored.
    """
    duration_s = options.duration or DURATION_S
    if duration_s <= FROM_S + max(HORIZONS_S):
        raise ValueError(f"errors count from {FROM_S:g} s on: give a longer --duration")
    seeds = seeds_of(options)
    rows = table(seeds, options.jobs, duration_s)
    output.write("crane", rows)
    return Report(report(rows), tuple(seeds))


def _words(parser: Parser) -> None:
    add_seeds(parser)
    for add in (add_jobs, add_duration, add_common):
        add(parser)


COMMANDS = {"crane": Command(run_crane, _words, "heave of a crane's tip, the crane parked and at work")}
