"""The judge of what is published while things go wrong: the table of disasters through the pipeline of the daemon.

A record of a sea is spoiled as ``disasters.py`` says and goes through the pipeline as a replay does it; where rows are
missing it is asked in between as well, as the daemon does for a poll that is lost. Every frame is held against the
truth of its own moment. Asked of all: no lie (an error beyond four published standard deviations in a frame that is
``valid``; of the measured angles, one degree), nothing beyond what a vessel can do in any state, no infinity, no
exception. Asked of most: back soon after it is over, and in the last minute no worse than without it.
"""

from __future__ import annotations

import re
import resource
import traceback
from collections import Counter
from functools import lru_cache
from math import erfc, inf, isfinite, isinf, isnan, nan, radians, sqrt
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from evidence.commands import completed
from evidence.faults.disasters import DISASTERS, HONEST_OF, IMU, Disaster, spoiled
from evidence.learning import learn
from evidence.scenarios import Setting, build, triplet
from heaved.estimation.common import bounds
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, reference
from heaved.estimation.heave.saved_state import SavedState
from heaved.estimation.lever_arm import Point
from heaved.estimation.rock import params as rock
from heaved.outputs.wire import motion_head
from heaved.pipeline import Pipeline, assemble
from heaved.samples import Fault, HeaveState, ImuSample, MotionFrame, Sample
from heaved.simulate.seaway import TRAINS
from heaved.simulate.sensors import Recording, measure

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from heaved.simulate.vessel import Motion

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SEAS: Final = ("S4", "S6", "S6S")
RATES_HZ: Final = (20.0, 100.0)
POINT: Final = Point(name="tip", forward_m=30.0, port_m=10.0, up_m=20.0)
FORECASTS_S: Final = (0.5, 1.0)
ROCK_S: Final = (0.05, 0.15, 0.5, 1.0)
AHEAD_S: Final = 0.5
"""The rock prediction that is compared with that of the honest record."""
LIE: Final = 4.0
BY_CHANCE: Final = erfc(LIE / sqrt(2.0))
"""Share of Gaussian errors that are beyond so many standard deviations, 6.3e-5."""
"""Published standard deviations."""
ATTITUDE_LIE_RAD: Final = radians(1.0)
"""Of a measured angle, which carries no standard deviation."""
LAST_S: Final = 60.0
WHOLE_FROM_S: Final = 120.0
"""What goes wrong from the first sample on, and all the time, is compared with the honest record from here on. Its
error is another draw of what is as large: by minutes the ratio scatters by a seventh (S6, one row in 200 lost), over
ten of them by a twentieth. What is over long before the last minute has the same error as the honest record there, and
is compared by it alone."""
HOLDS_S: Final = 20.0
"""A state counts as there again when it holds for so long: what is still valid before it is found out does not."""
ENCODED_EVERY: Final = 10
"""One frame in so many is put into the words of the stream as well, which has to be possible."""
LARGEST_MEMORY: Final = 8 << 30
"""Of a process, bytes of its address space: what asks for more fails instead of taking the machine along."""
STATES: Final = tuple(HeaveState)
VALID, DEGRADED, INVALID = (STATES.index(s) for s in (HeaveState.VALID, HeaveState.DEGRADED, HeaveState.INVALID))
KINDS: Final = ("heave", "forecast", "delayed", "rock", "attitude", "point")
"""Of lies."""


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """How long a record is, and when it goes wrong."""

    at_s: float = 400.0
    duration_s: float = 700.0
    memory_s: float = 300.0
    """Length of the run whose state is restored."""


class Task(msgspec.Struct, frozen=True, kw_only=True):
    """One disaster on one record."""

    name: str
    sea: str
    rate_hz: float
    seed: int
    plan: Plan = Plan()


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """What was published in one run. Errors are against the truth; nan: nothing of the kind was published."""

    task: Task
    crash: str
    """The exception that ended it; empty: none."""
    lies: dict[str, int]
    """By kind; of all frames from the beginning of the disaster on."""
    forecasts: int
    """Those that are valid: of so many some are lies by chance."""
    off: dict[str, int]
    """The same in frames that are ``degraded`` or ``settling``: no lie, but nothing to be proud of."""
    beyond: int
    """Numbers that no vessel has, in any state."""
    infinite: int
    """Numbers that are none, and valid frames without heave or standard deviation."""
    largest_sigma: float
    """Largest heave published in any state, in standard deviations of true heave."""
    largest_rock_deg: float
    """Largest roll or pitch, measured or predicted, published in any state."""
    worst_stds: float
    """Largest error of a valid heave in its published standard deviations."""
    worst_std_at_s: float
    states: dict[str, float]
    """Share of the frames in each state."""
    valid_after_s: float
    """From the end of the disaster (its beginning, where it stays) until the heave is valid again; inf: never."""
    usable_after_s: float
    delayed_m: float
    """RMS error of the delayed heave that was published from the beginning of the disaster on."""
    point_m: float
    """Largest error of the monitoring point in a valid frame."""
    sigma_m: float
    """Standard deviation of true heave."""
    last_heave_m: float
    """RMS error of what was published of the heave in the last minute."""
    last_rock_deg: float
    """The same of roll and pitch half a second ahead, the worse of them."""
    whole_heave_m: float
    """The same two of everything from WHOLE_FROM_S on."""
    whole_rock_deg: float
    last_published: float
    """Share of that minute in which there was a heave, and not an invalid one."""
    resets: dict[str, int]
    reasons: dict[str, float]
    """The most frequent ones, by the share of frames that gave them."""


# --- run -------------------------------------------------------------------------------------------------------------


def pipeline(disaster: Disaster) -> Pipeline:
    """The daemon's with all its defaults, and a monitoring point."""
    has_laser = disaster.laser != "off"
    return assemble(
        heave=heave.Params(),
        laser=reference.Params(role="aiding" if disaster.laser == "aiding" else "reference"),
        correction=correction.Params(),
        rock=rock.Params(),
        has_laser=has_laser,
        point=(POINT,),
    )


def run(task: Task) -> Outcome:
    """Make the record, spoil it, run it, judge it; an exception of the pipeline is part of the result.

    Raises:
        ValueError: unknown sea.
        KeyError: unknown disaster.
    """
    disaster = DISASTERS[task.name]
    setting = Setting(
        rate_hz=task.rate_hz,
        duration_s=task.plan.duration_s,
        laser="off" if disaster.laser == "off" else "on",
        scored_from_s=0.0,
    )
    seeds = triplet(task.seed)
    honest = build(task.sea, seeds, setting).recording
    span = disaster.span(task.plan.at_s)
    if disaster.move is not None:
        truth = disaster.move(honest.truth, span)
        honest = measure(truth, imu_rate_hz=task.rate_hz, sensor=setting.sensor, laser=setting.laser, seed=seeds.noise)
    delivered = spoiled(honest, disaster, span, task.seed)
    published = Published()
    crash = ""
    pipe = pipeline(disaster)
    try:
        _remember(pipe, disaster, task)
        for frame, is_coasted in frames(pipe, delivered, honest.t_s):
            published.take(frame, is_coasted)
    except Exception as error:  # noqa: BLE001  # Whatever it is, it would have ended the daemon or the replay: that is the finding.
        crash = _named(error)
    resets = {" ".join(key): count for key, count in pipe.resets.items()}
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what is published may be anything
        return judged(task, disaster, published, honest.truth, crash=crash, resets=resets)


def frames(pipe: Pipeline, delivered: Recording, polls_s: Array) -> Iterator[tuple[MotionFrame, bool]]:
    """Every frame, and whether it is one without a sample; what is due to be learned is learned before the next.

    polls_s: times at which a sensor that answers every poll would have had a sample.
    """
    interval_s = float(np.median(np.diff(polls_s)))
    last_s = inf
    for sample in delivered.samples():
        if sample.t_s - last_s > 1.5 * interval_s:
            missed = polls_s[(polls_s > last_s + 0.5 * interval_s) & (polls_s < sample.t_s - 0.5 * interval_s)]
            for t_s in missed.tolist():
                yield pipe.coast(t_s), True
        last_s = sample.t_s
        frame = pipe.step(_polled(sample))
        learn(pipe)
        if frame is not None:
            yield frame, False


def _polled(sample: Sample) -> Sample:
    """A row without any reading of the IMU is a poll that failed, as the daemon hands it on."""
    if isinstance(sample, ImuSample) and all(isnan(getattr(sample, name)) for name in IMU):
        return ImuSample(t_s=sample.t_s, fault=Fault.TIMEOUT)
    return sample


def _named(error: Exception) -> str:
    """The exception with the place that raised it."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    text = str(error).split("\n", 1)[0][:120]
    return f"{type(error).__name__}: {text} ({frame.filename.rsplit('/', 1)[-1]}:{frame.lineno})"


def _remember(pipe: Pipeline, disaster: Disaster, task: Task) -> None:
    """Restore what an earlier run would have saved; what the pipeline refuses is set aside, as the daemon does."""
    if disaster.memory == "none":
        return
    is_calmer = disaster.memory == "calmer sea"
    calmer = next(iter(TRAINS)) if task.sea == "S4" else "S4"
    try:
        sea = calmer if is_calmer else task.sea
        state = _state(sea, task.rate_hz, task.seed + 500, task.plan.memory_s)
        if disaster.memory in ("zeros", "huge"):
            number = 0.0 if disaster.memory == "zeros" else 1e300
            state = msgspec.convert(_with_all(msgspec.to_builtins(state), number), SavedState)
        pipe.restore(state)
    except ValueError:
        pass


@lru_cache
def _state(sea: str, rate_hz: float, seed: int, duration_s: float) -> SavedState:
    """Of a pipeline that has seen so much of a sea."""
    setting = Setting(rate_hz=rate_hz, duration_s=duration_s, scored_from_s=0.0)
    record = build(sea, triplet(seed), setting).recording
    pipe = pipeline(DISASTERS["clean"])
    for _ in frames(pipe, record, record.t_s):
        pass
    return pipe.state()


def _with_all(value: Any, number: float) -> Any:
    """The same structure with every float replaced; whole numbers, which are sizes, stay."""
    if isinstance(value, dict):
        return {key: _with_all(part, number) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_with_all(part, number) for part in value]
    return number if isinstance(value, float) else value


# --- what is published -----------------------------------------------------------------------------------------------


class Row(NamedTuple):
    """The numbers of one frame that are judged."""

    t_s: float
    state: int
    is_coasted: bool
    heave_m: float
    std_m: float
    roll_rad: float
    pitch_rad: float
    point_m: float
    point_std_m: float


class Published:
    """Collects the frames of one run."""

    def __init__(self) -> None:
        self.rows: list[Row] = []
        self.ahead: list[tuple[float, ...]] = []
        """Heave and standard deviation for each of FORECASTS_S."""
        self.rock: list[tuple[float, ...]] = []
        """Roll, pitch and their standard deviations for each of ROCK_S."""
        self.delayed: list[tuple[float, float, float, float, int]] = []
        """Time and, last, state of the frame that brought it; its own time of validity, heave, standard deviation."""
        self.beyond: list[tuple[float, int]] = []
        """Time of a frame, and how many of its numbers no vessel has."""
        self.infinite: list[tuple[float, int]] = []
        self.largest: list[tuple[float, float, float]] = []
        """Time, largest heave (m) and largest angle (rad) among all that the frame holds."""
        self.reasons: list[tuple[float, tuple[str, ...]]] = []

    def take(self, frame: MotionFrame, is_coasted: bool) -> None:
        """
        Raises:
            Exception: the stream could not send the frame.
        """
        if len(self.rows) % ENCODED_EVERY == 0:
            motion_head(frame, seq=0, utc_s=frame.t_s)
        point = frame.points[0] if frame.points else None
        point_std_m = getattr(point, "heave_std_m", nan)
        state = STATES.index(frame.quality.heave)
        t_s = frame.t_s
        self.rows.append(
            Row(
                t_s, state, is_coasted, frame.heave_m, frame.heave_std_m, frame.roll_rad, frame.pitch_rad,
                point.heave_m if point is not None else nan, point_std_m,
            )
        )  # fmt: skip
        forecasts, predictions = list(frame.forecast), list(frame.rock)
        self.ahead.append(_at(FORECASTS_S, {f.horizon_s: (f.heave_m, f.std_m) for f in forecasts}, 2))
        by_horizon = {p.horizon_s: (p.roll_rad, p.pitch_rad, p.roll_std_rad, p.pitch_std_rad) for p in predictions}
        self.rock.append(_at(ROCK_S, by_horizon, 4))
        heaves = [frame.heave_m, frame.observer_m, frame.correction_m, *(f.heave_m for f in forecasts)]
        later = frame.delayed
        if later is not None and (not self.delayed or later.t_s > self.delayed[-1][1]):
            self.delayed.append((t_s, later.t_s, later.heave_m, later.std_m, state))
            heaves.append(later.heave_m)
        angles = [frame.roll_rad, frame.pitch_rad]
        for p in predictions:
            angles += (p.roll_rad, p.pitch_rad)
        limited = (
            (heaves, bounds.HEAVE_M),
            ([frame.heave_velocity_mps], bounds.HEAVE_VELOCITY_MPS),
            ([frame.heave_acceleration_mps2], bounds.HEAVE_ACCELERATION_MPS2),
            (angles, bounds.ANGLE_RAD),
            ([p.heave_m for p in frame.points], bounds.POINT_HEAVE_M),
        )
        if beyond := sum(abs(value) > bound for values, bound in limited for value in values):
            self.beyond.append((t_s, int(beyond)))
        stds = [frame.heave_std_m, point_std_m, *(f.std_m for f in forecasts)]
        for p in predictions:
            stds += (p.roll_std_rad, p.pitch_std_rad)
        infinite = sum(isinf(value) for values, _ in limited for value in values) + sum(isinf(std) for std in stds)
        infinite += state == VALID and not isfinite(frame.heave_m + frame.heave_std_m)
        if infinite:
            self.infinite.append((t_s, int(infinite)))
        self.largest.append((t_s, _largest(heaves), _largest(angles)))
        if frame.quality.reasons:
            self.reasons.append((t_s, frame.quality.reasons))


def _at(horizons_s: Iterable[float], found: Mapping[float, tuple[float, ...]], width: int) -> tuple[float, ...]:
    """The numbers for these horizons in a row, nan where there is none."""
    nothing = (nan,) * width
    return tuple(value for horizon in horizons_s for value in found.get(horizon, nothing))


def _largest(values: Iterable[float]) -> float:
    return float(max((abs(value) for value in values if not isnan(value)), default=0.0))


# --- judged ----------------------------------------------------------------------------------------------------------


class Truth:
    """The true motion at any moment of the record: cubic between samples whose rates are known too."""

    def __init__(self, motion: Motion[Array]) -> None:
        t = motion.t_s
        self.heave_m = CubicHermiteSpline(t, motion.heave_m, motion.heave_velocity_mps)
        self.roll_rad = CubicHermiteSpline(t, motion.roll_rad, motion.roll_rate_radps)
        self.pitch_rad = CubicHermiteSpline(t, motion.pitch_rad, motion.pitch_rate_radps)

    def point_m(self, t_s: Array) -> Array:
        """Heave of the monitoring point: its lever arm turned by pitch (bow up), then roll (port up), less itself."""
        attitude = Rotation.from_euler("YX", np.column_stack([-self.pitch_rad(t_s), self.roll_rad(t_s)]))
        arm = np.array([POINT.forward_m, POINT.port_m, POINT.up_m])
        return np.asarray(self.heave_m(t_s) + (attitude.apply(arm) - arm)[:, 2], dtype=np.float64)


def judged(
    task: Task,
    disaster: Disaster,
    published: Published,
    motion: Motion[Array],
    *,
    crash: str = "",
    resets: dict[str, int] | None = None,
) -> Outcome:
    """Hold what was published against the true motion."""
    plan, truth = task.plan, Truth(motion)
    span = disaster.span(plan.at_s)
    table = np.array(published.rows, dtype=np.float64).reshape(-1, len(Row._fields))
    counted = (table[:, 0] >= span.start_s) & (table[:, 0] < plan.duration_s)
    t, state, is_coasted, heave_m, std_m, roll_rad, pitch_rad, point_m, point_std_m = table[counted].T
    states, sampled = state.astype(int), is_coasted == 0.0
    valid = states == VALID
    lies, off = dict.fromkeys(KINDS, 0), dict.fromkeys(KINDS, 0)

    def count(kind: str, wrong: Mask, state: NDArray[np.int64] = states) -> None:
        lies[kind] += int(np.sum(wrong & (state == VALID)))
        off[kind] += int(np.sum(wrong & (state != VALID) & (state != INVALID)))

    error = heave_m - truth.heave_m(t)
    count("heave", np.abs(error) > LIE * std_m)
    ahead = np.array(published.ahead, dtype=np.float64).reshape(len(table), 2 * len(FORECASTS_S))[counted]
    forecasts = 0
    for k, horizon_s in enumerate(FORECASTS_S):
        later_m, later_std_m = ahead[:, 2 * k : 2 * k + 2].T
        count("forecast", np.abs(later_m - truth.heave_m(t + horizon_s)) > LIE * later_std_m)
        forecasts += int(np.sum(np.isfinite(later_m) & (states == VALID)))
    turned = np.array(published.rock, dtype=np.float64).reshape(len(table), 4 * len(ROCK_S))[counted]
    rock_ahead = (np.empty(0), np.empty(0))
    for k, horizon_s in enumerate(ROCK_S):
        roll, pitch, roll_std, pitch_std = turned[:, 4 * k : 4 * k + 4].T
        roll_error, pitch_error = roll - truth.roll_rad(t + horizon_s), pitch - truth.pitch_rad(t + horizon_s)
        wrong = (np.abs(roll_error) > LIE * roll_std) | (np.abs(pitch_error) > LIE * pitch_std)
        count("rock", wrong & ~((t + horizon_s >= span.start_s) & (t < span.start_s + disaster.unforeseen_s)))
        if horizon_s == AHEAD_S:
            rock_ahead = (roll_error, pitch_error)
    off_rad = np.maximum(np.abs(roll_rad - truth.roll_rad(t)), np.abs(pitch_rad - truth.pitch_rad(t)))
    count("attitude", off_rad > ATTITUDE_LIE_RAD)
    point_error = np.abs(point_m - truth.point_m(t))
    count("point", point_error > LIE * point_std_m)
    delayed = np.array(published.delayed, dtype=np.float64).reshape(-1, 5)
    delayed = delayed[(delayed[:, 0] >= span.start_s) & (delayed[:, 0] < plan.duration_s)]
    _, then_s, delayed_m, delayed_std_m, delayed_state = delayed.T
    delayed_error = delayed_m - truth.heave_m(then_s)
    count("delayed", np.abs(delayed_error) > LIE * delayed_std_m, delayed_state.astype(int))

    stds = np.where(valid & np.isfinite(error), np.abs(error) / std_m, -1.0)
    last = sampled & (t >= plan.duration_s - LAST_S)
    whole = sampled & (t >= min(WHOLE_FROM_S, plan.duration_s - LAST_S))
    served = np.isfinite(error) & (states != INVALID)
    worst = int(np.argmax(stds)) if stds.size else -1
    sigma_m = float(np.std(motion.heave_m)) or nan  # of a still ship there is no share
    largest = [row for row in published.largest if span.start_s <= row[0] < plan.duration_s]
    over_s = disaster.over_s(plan.at_s)
    shown = states[sampled]
    return Outcome(
        task=task,
        crash=crash,
        lies=lies,
        forecasts=forecasts,
        off=off,
        beyond=_since(published.beyond, span.start_s),
        infinite=_since(published.infinite, span.start_s),
        largest_sigma=max((row[1] for row in largest), default=nan) / sigma_m,
        largest_rock_deg=float(np.degrees(max((row[2] for row in largest), default=nan))),
        worst_stds=float(stds[worst]) if worst >= 0 and stds[worst] >= 0.0 else nan,
        worst_std_at_s=float(t[worst]) if worst >= 0 and stds[worst] >= 0.0 else nan,
        states={state.value: float(np.mean(shown == k)) if shown.size else nan for k, state in enumerate(STATES)},
        valid_after_s=_back_s(t[sampled], shown == VALID, over_s),
        usable_after_s=_back_s(t[sampled], (shown == VALID) | (shown == DEGRADED), over_s),
        delayed_m=_rms(delayed_error),
        point_m=float(np.max(point_error[valid & np.isfinite(point_error)], initial=0.0)),
        sigma_m=sigma_m,
        last_heave_m=_rms(error[last & served]),
        last_rock_deg=float(np.degrees(np.max([_rms(axis[last]) for axis in rock_ahead]))),
        whole_heave_m=_rms(error[whole & served]),
        whole_rock_deg=float(np.degrees(np.max([_rms(axis[whole]) for axis in rock_ahead]))),
        last_published=float(np.mean(served[last])) if np.any(last) else 0.0,
        resets=resets or {},
        reasons=_most_given([row for row in published.reasons if row[0] >= span.start_s], max(t.size, 1)),
    )


def _since(counts: Iterable[tuple[float, int]], start_s: float) -> int:
    return sum(count for t_s, count in counts if t_s >= start_s)


def _back_s(t: Array, there: Mask, since_s: float) -> float:
    """Seconds from ``since_s`` until it is there for HOLDS_S on end; inf: never."""
    after = t >= since_s
    t, there = t[after], there[after]
    begins = np.flatnonzero(there & ~np.append(False, there[:-1]))
    for begin in begins.tolist():
        gone = np.flatnonzero(~there[begin:])
        held_s = (t[begin + gone[0]] if gone.size else inf) - t[begin]
        if held_s >= HOLDS_S:
            return float(t[begin] - since_s)
    return inf


def _rms(values: Array) -> float:
    there = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(there**2))) if there.size else nan


def _most_given(given: Sequence[tuple[float, tuple[str, ...]]], total: int, most: int = 4) -> dict[str, float]:
    """Reasons without their numbers, by how many frames gave them."""
    texts = Counter(re.sub(r"\d+(\.\d+)?", "…", text) for _, reasons in given for text in reasons)
    return {text: round(count / total, 3) for text, count in texts.most_common(most)}


# --- campaign --------------------------------------------------------------------------------------------------------


def tasks(
    names: Iterable[str], seas: Sequence[str], rates_hz: Sequence[float], seeds: Sequence[int], plan: Plan
) -> list[Task]:
    """Every disaster on every record, and the honest records that they are compared with first."""
    wanted = list(dict.fromkeys(names))
    honest = dict.fromkeys(HONEST_OF[DISASTERS[name].laser] for name in wanted)
    return [
        Task(name=name, sea=sea, rate_hz=rate_hz, seed=seed, plan=plan)
        for rate_hz in sorted(rates_hz, reverse=True)  # the long ones first: no core waits at the end
        for name in dict.fromkeys((*honest, *wanted))
        for sea in seas
        for seed in seeds
    ]


def run_all(todo: Sequence[Task], jobs: int, watch: Callable[[Outcome], None] = lambda _: None) -> list[Outcome]:
    """Run in ``jobs`` processes of bounded memory; outcomes in the order of the tasks."""
    found: dict[int, Outcome] = {}
    for place, outcome in completed(run, todo, jobs, _bounded):
        found[place] = outcome
        watch(outcome)
    return [found[place] for place in range(len(todo))]


def _bounded() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (LARGEST_MEMORY, LARGEST_MEMORY))
