"""What a regression could still take off the heave: on its own past, attitude, rates and level accelerations.

The teacher is the laser, with the correction on, or the delayed heave where there is no laser. A ridge regression of
what the teacher says more than the heave is fitted to the first part of a record and applied to the rest, where its
penalty is the best in hindsight: what it leaves of the error there is a floor for a network with these inputs. 1: there
is nothing in them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from evidence.commands import in_order
from evidence.heave.wrong_physics import CASES, RATE_HZ, Case, recording
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, reference
from heaved.estimation.heave.sea.refit import look
from heaved.estimation.rock import params as rock
from heaved.pipeline import assemble
from heaved.simulate.sensors import LASER_NOISE_M

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]
Teacher = Literal["laser", "delayed heave"]

DURATION_S: Final = 900.0
FROM_S: Final = 300.0
UNTIL_S: Final = 600.0
AGAIN_S: Final = 610.0
"""The regression is fitted between the first two, and judged after the third: no input is seen twice."""
HEAVE_LAGS_S: Final = tuple(np.arange(0.0, 5.0, 0.5).tolist())
MOTION_LAGS_S: Final = (0.0, 1.0, 2.0, 3.0, 4.0)
PENALTIES: Final = (1e-1, 1e-2, 1e-3)


class Task(msgspec.Struct, frozen=True, kw_only=True):
    case: Case
    sea: str
    teacher: Teacher
    seed: int


class Left(msgspec.Struct, frozen=True, kw_only=True):
    """Of one record."""

    case: str
    sea: str
    teacher: str
    error_m: float
    """RMS of the error of the heave where the regression is judged."""
    with_heave: float
    """What a regression of lagged heave leaves of it,"""
    with_motion: float
    """and one of motion beside."""


def run(task: Task) -> Left:
    """One record through the pipeline of the daemon, and the regressions."""
    is_laser = task.teacher == "laser"
    made = recording(task.case, task.sea, task.seed, "on" if is_laser else "off", DURATION_S)
    pipe = assemble(
        heave=heave.Params(forecast_horizons_s=()),
        laser=reference.Params(),
        correction=correction.Params(),
        rock=rock.Params(predictor="ml", thetas=(0.7,), horizons_s=()),
        has_laser=is_laser,
    )
    rows: list[tuple[float, ...]] = []
    delayed: dict[float, float] = {}
    for sample in made.samples():
        frame = pipe.step(sample)
        if (past := pipe.fit_due()) is not None:
            pipe.accept_fit(look(past))
        if frame is None:
            continue
        level = frame.surge_acceleration_mps2, frame.sway_acceleration_mps2
        angles = frame.roll_rad, frame.pitch_rad, frame.roll_rate_radps, frame.pitch_rate_radps
        rows.append((frame.t_s, frame.heave_m, *angles, *level))
        if frame.delayed is not None:
            delayed[frame.delayed.t_s] = frame.delayed.heave_m
    table = np.array(rows)
    t_s, found_m = table[:, 0], table[:, 1]
    if is_laser:
        noise_m = LASER_NOISE_M * np.random.default_rng(task.seed).standard_normal(len(t_s))
        taught_m = made.truth.heave_m + noise_m
    else:
        taught_m = np.interp(t_s, np.array(list(delayed)), np.array(list(delayed.values())), right=np.nan)
    own = lagged(found_m, HEAVE_LAGS_S)
    moved = np.hstack([lagged(column, MOTION_LAGS_S) for column in table[:, 2:].T])
    is_known = np.isfinite(np.hstack((own, moved))).all(axis=1)
    learned = (t_s >= FROM_S) & (t_s < UNTIL_S) & is_known & np.isfinite(taught_m)
    judged = (t_s >= AGAIN_S) & is_known
    error_m = made.truth.heave_m - found_m

    def left(inputs: Array) -> float:
        return least_left(inputs[learned], (taught_m - found_m)[learned], inputs[judged], error_m[judged])

    return Left(
        case=task.case.name,
        sea=task.sea,
        teacher=task.teacher,
        error_m=float(np.sqrt(np.mean(error_m[judged] ** 2))),
        with_heave=left(own),
        with_motion=left(np.hstack((own, moved))),
    )


def lagged(column: Array, lags_s: Sequence[float]) -> Array:
    """(n, lags) of (n,), evenly sampled; nan before it begins."""
    found = np.full((len(column), len(lags_s)), np.nan)
    for which, lag_s in enumerate(lags_s):
        steps = round(lag_s * RATE_HZ)
        found[steps:, which] = column[: len(column) - steps]
    return found


def least_left(inputs: Array, taught: Array, later: Array, error: Array) -> float:
    """RMS of what the best of the ridge regressions of ``taught`` (n,) on ``inputs`` (n, d) leaves of ``error`` (m,),
    whose inputs are ``later`` (m, d), over its RMS.
    """
    mean, spread = np.mean(inputs, axis=0), np.std(inputs, axis=0)
    x, z = (inputs - mean) / spread, (later - mean) / spread
    normal, moments = x.T @ x / len(x), x.T @ (taught - np.mean(taught)) / len(x)
    left = [
        float(np.mean((error - z @ np.linalg.solve(normal + penalty * np.eye(len(normal)), moments)) ** 2))
        for penalty in PENALTIES
    ]
    return float(np.sqrt(min(left) / np.mean(error**2)))


RECORDS: Final[tuple[tuple[Case, str, Teacher], ...]] = (
    *((case, "S6-bow-0.8", "laser") for case in CASES),
    (CASES[0], "S6-bow-0.8", "delayed heave"),
    (Case(name="right physics, a poor sensor", sensor="C"), "S6S-bow-0.8", "delayed heave"),
)


def table(seed: int, jobs: int) -> list[Left]:
    """All records, once: a record is long enough to show a tenth."""
    return in_order(run, [Task(case=case, sea=sea, teacher=by, seed=seed) for case, sea, by in RECORDS], jobs)


def report(found: Sequence[Left]) -> str:
    """Markdown."""
    lines = [
        "## What is left to learn",
        "",
        f"With the correction on; ridge regressions fitted from {FROM_S:g} to {UNTIL_S:g} s and judged from "
        f"{AGAIN_S:g} s on, the best penalty in hindsight. Left: RMS over that of the heave as it is published.",
        "",
        "| sea | what is wrong | teacher | error / mm | left with lagged heave | and with attitude, rates, level "
        "accelerations |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {one.sea} | {one.case} | {one.teacher} | {1e3 * one.error_m:.1f} | {one.with_heave:.3f} "
        f"| {one.with_motion:.3f} |"
        for one in found
    ]
    return "\n".join(lines)
