"""A laser that is elsewhere, in figures: configured rightly, configured at the IMU, and with no attitude at all.

The gauge stands 8 m ahead of the IMU, 2 m over it, its beam leaning by a degree. Beside each heave is that of the same
record without a laser: a laser may teach a better heave, and never a worse one.
"""

from __future__ import annotations

from math import isfinite, nan, radians, tan
from typing import TYPE_CHECKING, Final, Literal

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
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, reference
from heaved.estimation.heave.sea.refit import look
from heaved.estimation.rock import params as rock
from heaved.pipeline import Pipeline, assemble
from heaved.simulate.gauge import AT_THE_IMU, Gauge
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import Recording, record

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.samples import MotionFrame

Array = NDArray[np.float64]

SEA: Final = "S6"
CALM: Final = "S4"
SENSORS: Final = ("A", "B", "AHRS")
DURATION_S: Final = 420.0
FROM_S: Final = 60.0
"""The observer has settled; the laser has hardly begun."""
LATE_S: Final = 240.0
"""By then the laser has taught what it teaches."""
ELSEWHERE: Final = Gauge(at_m=(8.0, 0.0, 2.0), beam=(tan(radians(1.0)), 0.0, -1.0))


class Case(msgspec.Struct, frozen=True, kw_only=True):
    """Where the gauge is, and where it is configured."""

    name: str
    gauge: Gauge | None = ELSEWHERE
    """None: there is no laser."""
    configured: Gauge = AT_THE_IMU
    has_attitude: bool = True
    """Without one no heave at all is published in S6: too much of it would be tilt."""

    @property
    def sea(self) -> str:
        """Of the record."""
        return SEA if self.has_attitude else CALM


NO_LASER: Final = "no laser"
NO_LASER_NO_ATTITUDE: Final = "no laser, no attitude, S4"
CASES: Final = (
    Case(name=NO_LASER, gauge=None),
    Case(name="at the IMU", gauge=AT_THE_IMU),
    Case(name="8 m off, configured so", configured=ELSEWHERE),
    Case(name="8 m off, configured at the IMU"),
    Case(name=NO_LASER_NO_ATTITUDE, gauge=None, has_attitude=False),
    Case(name="at the IMU, no attitude, S4", gauge=AT_THE_IMU, has_attitude=False),
    Case(name="8 m off, configured at the IMU, no attitude, S4", has_attitude=False),
)


class Task(msgspec.Struct, frozen=True):
    sensor: str
    role: Literal["reference", "aiding"]
    case: Case
    seed: int
    duration_s: float


class Found(msgspec.Struct, frozen=True, kw_only=True):
    """Of one record."""

    early_m: float
    """RMS of the error from :data:`FROM_S` to :data:`LATE_S`,"""
    late_m: float
    """and after that."""
    within: float
    """Share of errors after :data:`FROM_S` within 1.96 standard deviations."""
    told: float
    """Share of the frames after that which have a heave at all."""
    named_s: float
    """When the place was named for good; nan: never."""
    off_m: tuple[float, float]
    """How far the beam meets the target from where it is configured, ahead and to port; nan: not known."""
    off_std_m: tuple[float, float]


class Row(msgspec.Struct, frozen=True, kw_only=True):
    sensor: str
    role: str
    case: str
    records: tuple[Found, ...]

    def rms_m(self, name: str) -> float:
        return float(np.sqrt(np.mean([getattr(one, name) ** 2 for one in self.records])))


def pipeline(task: Task) -> Pipeline:
    """The daemon's, with the gauge where it is thought to be."""
    case, (forward, port, up) = task.case, task.case.configured.at_m
    return assemble(
        heave=heave.Params(),
        laser=reference.Params(role=task.role, forward_m=forward, port_m=port, up_m=up, beam=case.configured.beam),
        correction=correction.Params(enabled=False),
        rock=rock.Params(),
        has_laser=case.gauge is not None,
    )


def made_of(task: Task) -> Recording:
    """The record of a task."""
    gauge = task.case.gauge
    made = record(
        seaway(task.case.sea, task.seed), task.duration_s, imu_rate_hz=20.0, sensor=task.sensor, seed=100 + task.seed,
        laser="off" if gauge is None else "on", gauge=gauge or AT_THE_IMU,
    )  # fmt: skip
    if task.case.has_attitude:
        return made
    nothing = np.full(len(made.t_s), nan)
    return msgspec.structs.replace(made, roll_rad=nothing, pitch_rad=nothing, yaw_rad=nothing)


def run(task: Task) -> Found:
    """Errors of one record, and what was said of its gauge."""
    made, pipe = made_of(task), pipeline(task)
    frames: list[MotionFrame] = []
    named_s = nan
    for sample in made.samples():
        frame = pipe.step(sample)
        if (past := pipe.fit_due()) is not None:
            pipe.accept_fit(look(past))
        if frame is not None:
            frames.append(frame)
            is_named = any("from where it is configured" in reason for reason in frame.quality.reasons)
            named_s = (named_s if isfinite(named_s) else frame.t_s) if is_named else nan
    t, heave_m, std_m = np.array([(frame.t_s, frame.heave_m, frame.heave_std_m) for frame in frames]).T
    error = heave_m - made.truth.heave_m
    early, late = (t >= FROM_S) & (t < LATE_S), t >= LATE_S
    scored = (t >= FROM_S) & np.isfinite(error)
    placement = pipe.laser.placement
    fit, off_m, off_std_m = placement.fit, (nan, nan), (nan, nan)
    if fit is not None:
        off_m, off_std_m = fit.off_m(placement.configured), (fit.foot_forward_std_m, fit.foot_port_std_m)
    return Found(
        early_m=_rms(error[early]),
        late_m=_rms(error[late]),
        within=float(np.mean(np.abs(error[scored]) < 1.96 * std_m[scored])) if scored.any() else nan,
        told=float(np.mean(np.isfinite(error[t >= FROM_S]))) if np.any(t >= FROM_S) else nan,
        named_s=named_s,
        off_m=off_m,
        off_std_m=off_std_m,
    )


def _rms(values: Array) -> float:
    found = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(found**2))) if len(found) else nan


def table(
    seeds: Sequence[int], jobs: int, duration_s: float = DURATION_S, sensors: Sequence[str] = SENSORS,
    cases: Sequence[Case] = CASES,
) -> list[Row]:  # fmt: skip
    """Every sensor and case, of either role; without a laser there is but one."""
    roles: tuple[Literal["reference", "aiding"], ...] = ("reference", "aiding")
    kinds = [
        (sensor, role, case)
        for sensor in sensors
        for role in roles
        for case in cases
        if role == "reference" or case.gauge is not None
    ]
    found = in_order(run, [Task(*kind, seed, duration_s) for kind in kinds for seed in seeds], jobs)
    return [
        Row(
            sensor=sensor,
            role=role,
            case=case.name,
            records=tuple(found[number * len(seeds) : (number + 1) * len(seeds)]),
        )
        for number, (sensor, role, case) in enumerate(kinds)
    ]


def report(rows: Sequence[Row]) -> str:
    """Markdown."""
    lines = [
        f"{SEA}; the gauge 8 m ahead of the IMU and 2 m over it, its beam leaning 1° ahead, 12 m over its target; IMU "
        f"at 20 Hz. Errors from {FROM_S:g} to {LATE_S:g} s and later; their ratio to those of the same records without "
        "a laser; told: frames with a heave, of which errors are counted (without an attitude a laser lets more of "
        "them have one, in higher waves, than there are without it); place: where the beam meets the target, from "
        "where it is configured, at the end.",
        "",
        "| sensor | role | laser | told | error / mm | later / mm | ratio | later | within 1.96 std | "
        "named after / s | ahead / m | to port / m |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    alone = {(row.sensor, row.case): row for row in rows if row.case in (NO_LASER, NO_LASER_NO_ATTITUDE)}
    for row in rows:
        of_none = alone.get((row.sensor, NO_LASER_NO_ATTITUDE if "no attitude" in row.case else NO_LASER))
        errors = [row.rms_m("early_m"), row.rms_m("late_m")]
        ratios = (
            [nan, nan]
            if of_none is None
            else [errors[0] / of_none.rms_m("early_m"), errors[1] / of_none.rms_m("late_m")]
        )
        told = np.mean([one.told for one in row.records])
        named = [one.named_s for one in row.records]
        names = f"{max(named):.0f}" if all(map(isfinite, named)) else "some" if any(map(isfinite, named)) else "never"
        place = [
            f"{np.mean([one.off_m[axis] for one in row.records]):.2f} ± "
            f"{np.mean([one.off_std_m[axis] for one in row.records]):.2f}"
            for axis in (0, 1)
        ]
        lines.append(
            f"| {row.sensor} | {row.role} | {row.case} | {told:.0%} | {1e3 * errors[0]:.1f} | "
            f"**{1e3 * errors[1]:.1f}** | {ratios[0]:.2f} | {ratios[1]:.2f} | "
            f"{np.mean([one.within for one in row.records]):.0%} | {names} | {place[0]} | {place[1]} |"
        )
    return "\n".join(lines)


def run_laser_geometry(options: Options, output: Output) -> Report:
    """
    Raises:
        ValueError: the records end before they are scored.
    """
    duration_s = options.duration or DURATION_S
    if duration_s <= LATE_S:
        raise ValueError(f"errors count up to {LATE_S:g} s and beyond: give a longer --duration")
    seeds = seeds_of(options)
    rows = table(seeds, options.jobs, duration_s)
    output.write("laser geometry", rows)
    return Report(report(rows), tuple(seeds))


def _words(parser: Parser) -> None:
    add_seeds(parser, 2)
    for add in (add_jobs, add_duration, add_common):
        add(parser)


COMMANDS = {
    "laser-geometry": Command(
        run_laser_geometry, _words, "a laser that is elsewhere than at the IMU, and configured so"
    )
}
