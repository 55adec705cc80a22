"""What the learned correction takes out where the physics is wrong, and what it costs where it is right.

Each case is one thing that nobody has configured. The same sea and the same noise are run with the fault and without
it, with the correction and without. *Put in* is the error that the fault adds where nothing is corrected, *taken out*
the share of it that the correction takes away again, both of RMS errors of the published heave:

    put in = without - right,     taken out = (without - with) / (without - right),

right: the error of the same record with the right physics. Lead, gain and the place of the gauge are learned in all of
them, as by default. The laser is there for half the time, with outages of two minutes, and errors count from
:data:`FROM_S` on.
"""

from __future__ import annotations

from math import isfinite, isnan, nan, radians
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from evidence.commands import in_order
from evidence.learning import learn
from evidence.scenarios import limits_of
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, reference
from heaved.estimation.heave.sea.refit import look
from heaved.estimation.rock import params as rock
from heaved.pipeline import assemble
from heaved.samples import CorrectionState
from heaved.simulate.gauge import AT_THE_IMU, Gauge
from heaved.simulate.seaway import heave_spectrum, seaway
from heaved.simulate.sensors import laser_pattern, record
from heaved.simulate.wrong_physics import RIGHT, Wrong, crooked

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.simulate.sensors import Recording

Array = NDArray[np.float64]

LASER: Final = "120+120,360+120,600+120,840+120"
DURATION_S: Final = 960.0
FROM_S: Final = 300.0
RATE_HZ: Final = 10.0
SEAS: Final = ("S6-bow-0.8", "S6S-bow-0.8", "S6")
"""The waves of most seas come from several directions; from one, nearly all that is wrong looks like a lag, which is
learned as such."""
LEAST_PUT_IN: Final = 0.02
"""Of less than that share of the error of right physics there is nothing to take out,"""
ASKED_PUT_IN: Final = 0.1
"""and of less than that so little that it is only asked not to make it worse."""
ASKED_TAKEN_OUT: Final = 0.5
ASKED_ACTIVE: Final = 0.8
ASKED_OUTAGE: Final = 1.02
"""Ratio in the worst outage, with a correction to without,"""
ASKED_RIGHT: Final = 1.01
"""and in all where nothing was put in."""


class Case(msgspec.Struct, frozen=True, kw_only=True):
    """What is wrong."""

    name: str
    wrong: Wrong = RIGHT
    sensor: str = "A"
    gauge: Gauge = AT_THE_IMU


CASES: Final = (
    Case(name="right physics"),
    Case(name="laser 12 m ahead, 4 m to port", gauge=Gauge(at_m=(12.0, 4.0, 2.0))),
    Case(name="IMU askew by 2.5° twice", wrong=Wrong(askew_roll_rad=radians(2.5), askew_pitch_rad=radians(2.5))),
    Case(name="2 % cross-axis", wrong=Wrong(cross_axis=0.02)),
    Case(name="1 % more per g", wrong=Wrong(bent_per_g=0.01)),
    Case(name="AHRS that leans (8 s) and is late", sensor="AHRS"),
)  # fmt: skip


class Run(msgspec.Struct, frozen=True, kw_only=True):
    """One pass over one record."""

    case: Case
    sea: str
    seed: int
    corrected: bool
    trained: bool = True
    """The network, too, where it is worth it; it takes seconds to load what does that."""
    laser: str = LASER
    duration_s: float = DURATION_S
    from_s: float = FROM_S


class Found(msgspec.Struct, frozen=True, kw_only=True):
    """Of one pass, from the moment on from which errors count."""

    squares_m2: tuple[float, float]
    """Mean squares of the error with the laser and in its outages; nan where there was no heave at all."""
    outages_m2: tuple[float, ...]
    """Mean square of the error in each outage."""
    published: float
    """Share of the time with a heave to score."""
    delayed_m2: float
    """Mean square of the error of the delayed heave."""
    within: float
    """Share of errors within 1.96 standard deviations."""
    active: float
    """Share of the time with a laser in which a correction was applied."""
    first_s: float
    """When one was for the first time; nan: never."""
    sigma_m: float
    """Of true heave."""


class Line(msgspec.Struct, frozen=True, kw_only=True):
    """A case on a sea: pooled over the seeds; RMS errors in metres."""

    case: str
    sea: str
    limit_m: float
    right_m: float
    without_m: tuple[float, float, float]
    """In all, with the laser, in outages."""
    corrected_m: tuple[float, float, float]
    delayed_m: tuple[float, float]
    """Without and with."""
    worst_outage: float
    """Ratio of the errors, with and without, of the one outage in which that is largest."""
    within: float
    active: float
    first_s: float
    published: float

    @property
    def put_in(self) -> float:
        """Share of the error of right physics that the fault adds."""
        return self.without_m[0] / self.right_m - 1.0

    @property
    def taken_out(self) -> float:
        """Share of what was put in; nan: nothing worth the name was."""
        if self.put_in < LEAST_PUT_IN:
            return nan
        return (self.without_m[0] - self.corrected_m[0]) / (self.without_m[0] - self.right_m)

    @property
    def ratio(self) -> float:
        """Of the error with the correction to that without."""
        return self.corrected_m[0] / self.without_m[0]

    @property
    def outage_ratio(self) -> float:
        """The same in outages."""
        return self.corrected_m[2] / self.without_m[2]

    @property
    def misses(self) -> list[str]:
        """What is asked of it and is not so."""
        found = [] if self.worst_outage <= ASKED_OUTAGE else [f"worst outage {self.worst_outage:.3f}"]
        if self.put_in >= ASKED_PUT_IN:
            if self.taken_out < ASKED_TAKEN_OUT:
                found.append(f"{self.taken_out:.0%} out")
            if self.active < ASKED_ACTIVE:
                found.append(f"active {self.active:.0%}")
        elif self.ratio > (most := ASKED_RIGHT if self.put_in < LEAST_PUT_IN else ASKED_OUTAGE):
            found.append(f"{self.ratio:.3f} > {most:g}")
        return found


def recording(case: Case, sea: str, seed: int, laser: str, duration_s: float) -> Recording:
    """The record of a case."""
    return crooked(
        record(
            seaway(sea, seed, start_s=37.0 * seed), duration_s, imu_rate_hz=RATE_HZ, sensor=case.sensor, laser=laser,
            gauge=case.gauge, seed=1000 + seed,
        ),
        case.wrong,
    )  # fmt: skip


def run(task: Run) -> Found:
    """Through the pipeline of the daemon; what is due to be learned is learned before the next sample."""
    made = recording(task.case, task.sea, task.seed, task.laser, task.duration_s)
    pipe = assemble(
        heave=heave.Params(forecast_horizons_s=()),
        laser=reference.Params(),
        correction=correction.Params(enabled=task.corrected),
        rock=rock.Params(predictor="ml", thetas=(0.7,), horizons_s=()),
        has_laser=True,
    )
    rows: list[tuple[float, float, float, float]] = []
    delayed: list[tuple[float, float]] = []
    first_s = nan
    for sample in made.samples():
        frame = pipe.step(sample)
        if task.trained:
            learn(pipe)
        elif (past := pipe.fit_due()) is not None:
            pipe.accept_fit(look(past))
        if frame is None:
            continue
        is_active = frame.quality.correction is CorrectionState.ACTIVE
        first_s = frame.t_s if is_active and isnan(first_s) else first_s
        rows.append((frame.t_s, frame.heave_m, frame.heave_std_m, float(is_active)))
        if frame.delayed is not None:
            delayed.append((frame.delayed.t_s, frame.delayed.heave_m))
    t, found, std, active = np.array(rows).T
    truth = made.truth.heave_m
    error = found - truth
    pattern = laser_pattern(task.laser)
    seen = np.array([pattern.on(at) for at in t.tolist()], dtype=bool)
    counts = t >= task.from_s
    known = counts & np.isfinite(error)
    late_t, late = np.array(delayed).T
    late_counts = late_t >= task.from_s
    return Found(
        squares_m2=(_square(error[known & seen]), _square(error[known & ~seen])),
        outages_m2=tuple(_square(error[known & outage]) for outage in _outages(seen) if (known & outage).any()),
        published=float(np.mean(np.isfinite(error[counts]))),
        delayed_m2=_square((late - np.interp(late_t, t, truth))[late_counts]),
        within=float(np.mean(np.abs(error[known]) < 1.96 * std[known])) if known.any() else nan,
        active=float(np.mean(active[counts & seen])),
        first_s=first_s,
        sigma_m=float(np.std(truth[counts])),
    )


def _outages(seen: Array) -> list[Array]:
    """(n,) where each stretch without the laser is."""
    number = np.cumsum(np.diff(seen.astype(int), prepend=1) < 0)
    return [np.logical_not(seen) & (number == one) for one in range(1, int(number[-1]) + 1)]


def _square(values: Array) -> float:
    return float(np.mean(values**2)) if len(values) else nan


def table(seeds: Sequence[int], jobs: int, seas: Sequence[str] = SEAS, cases: Sequence[Case] = CASES) -> list[Line]:
    """Every case on every sea; the first case is the right physics."""
    todo = [
        Run(case=case, sea=sea, seed=seed, corrected=corrected)
        for sea in seas
        for case in cases
        for corrected in (False, True)
        for seed in seeds
    ]
    found = iter(in_order(run, todo, jobs))
    lines: list[Line] = []
    for sea in seas:
        right_m = nan
        for case in cases:
            without, corrected = ([next(found) for _ in seeds] for _ in range(2))
            without_m, corrected_m = _pooled(without), _pooled(corrected)
            if case is cases[0]:
                right_m = without_m[0]
            firsts = [one.first_s for one in corrected]
            lines.append(
                Line(
                    case=case.name,
                    sea=sea,
                    limit_m=limit_m(sea, case),
                    right_m=right_m,
                    without_m=without_m,
                    corrected_m=corrected_m,
                    delayed_m=(_rms(without, "delayed_m2"), _rms(corrected, "delayed_m2")),
                    worst_outage=_worst(without, corrected),
                    within=float(np.mean([one.within for one in corrected])),
                    active=float(np.mean([one.active for one in corrected])),
                    first_s=float(np.max(firsts)),
                    published=float(np.mean([one.published for one in corrected])),
                )
            )
    return lines


def limit_m(sea: str, case: Case) -> float:
    """The causal limit of the sea for that sensor's accelerometer alone."""
    name = sea.split("-", 1)[0]
    return limits_of(lambda f: heave_spectrum(name, f), case.sensor, RATE_HZ).causal_m


def _pooled(records: Sequence[Found]) -> tuple[float, float, float]:
    on, off = (float(np.mean([one.squares_m2[which] for one in records])) for which in (0, 1))
    return float(np.sqrt(0.5 * (on + off))), float(np.sqrt(on)), float(np.sqrt(off))


def _worst(without: Sequence[Found], corrected: Sequence[Found]) -> float:
    """Ratio of the errors in the one outage in which that is largest."""
    with_m2, without_m2 = (np.array([one.outages_m2 for one in records]) for records in (corrected, without))
    return float(np.sqrt(np.max(with_m2 / without_m2)))


def _rms(records: Sequence[Found], name: str) -> float:
    return float(np.sqrt(np.mean([getattr(one, name) for one in records])))


def report(lines: Sequence[Line]) -> str:
    """Markdown."""
    rows = [
        "## Where the physics is wrong",
        "",
        f"IMU at {RATE_HZ:g} Hz, sensor A but where the case has another; laser for half the time, outages of 120 s, "
        f"errors from {FROM_S:g} s on, RMS in mm, with the laser / in outages. Put in: what the fault adds to the "
        f"error of right physics; taken out: how much of that the correction takes away (where less than "
        f"{LEAST_PUT_IN:.0%} is put in, there is nothing to). Active: of the time with a laser. Asked: at least "
        f"{ASKED_TAKEN_OUT:.0%} taken out and active {ASKED_ACTIVE:.0%} where at least {ASKED_PUT_IN:.0%} is put in, "
        f"else at most {ASKED_OUTAGE:g} × without, and {ASKED_RIGHT:g} × where nothing is; "
        f"in no single outage more than {ASKED_OUTAGE:g} × without.",
        "",
        "| sea | what is wrong | limit | right | without | with | put in | taken out | with/without | in outages "
        "| worst outage | delayed, without → with | active | first | within 1.96 std "
        "| asked |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for one in lines:
        off, on = one.without_m, one.corrected_m
        taken = f"**{one.taken_out:.0%}**" if isfinite(one.taken_out) else "–"
        first = f"{one.first_s:.0f} s" if isfinite(one.first_s) else "–"
        rows.append(
            f"| {one.sea} | {one.case} | {1e3 * one.limit_m:.1f} | {1e3 * one.right_m:.1f} "
            f"| {1e3 * off[1]:.1f} / {1e3 * off[2]:.1f} | {1e3 * on[1]:.1f} / {1e3 * on[2]:.1f} "
            f"| {one.put_in:.0%} | {taken} | {one.ratio:.3f} | {one.outage_ratio:.3f} | {one.worst_outage:.3f} "
            f"| {1e3 * one.delayed_m[0]:.1f} → {1e3 * one.delayed_m[1]:.1f} | {one.active:.0%} | {first} "
            f"| {one.within:.1%} | {'met' if not one.misses else '**missed**: ' + ', '.join(one.misses)} |"
        )
    met = sum(not one.misses for one in lines)
    rows += ["", f"{len(lines)} rows: {met} met, {len(lines) - met} missed."]
    return "\n".join(rows)
