"""tools/accuracy.py faults: the judge finds the lies that were put there by hand, and nothing else; disasters are what
their names say.
"""

from __future__ import annotations

import json
import subprocess
import sys
from functools import cache
from math import cos, inf, isnan, nan, radians, sin
from pathlib import Path
from typing import TYPE_CHECKING

import accuracy
import msgspec
import numpy as np
import pytest
from evidence.faults import judge as faults
from evidence.faults import table as fault_table
from evidence.faults.disasters import DISASTERS, HONEST_OF, IMU, Disaster, spoiled
from evidence.faults.judge import Outcome, Plan, Published, Task
from evidence.faults.moves import Move, Span, growing, listed, met_by_a_swell, turned_into_the_sea

from heaved.pipeline import Pipeline
from heaved.samples import (
    CorrectionState,
    DelayedHeave,
    Fault,
    HeaveForecast,
    HeaveState,
    ImuSample,
    LaserSample,
    LaserState,
    MotionFrame,
    PointMotion,
    Quality,
    RockPrediction,
    Sample,
)
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import REGISTER_STEPS, Recording, record
from heaved.simulate.vessel import Motion

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

Array = np.ndarray

RATE_HZ = 10.0
PLAN = Plan(at_s=100.0, duration_s=220.0)
W_HEAVE, W_ROLL, W_PITCH = 0.8, 0.6, 1.1
STD_M, STD_RAD = 0.02, radians(0.1)
TASK = Task(name="gap_1", sea="S6", rate_hz=RATE_HZ, seed=1, plan=PLAN)
"""One second from 100 s on."""
VALID, DEGRADED, INVALID = HeaveState.VALID, HeaveState.DEGRADED, HeaveState.INVALID


def heave(t: float) -> float:
    return 1.5 * sin(W_HEAVE * t)


def roll(t: float) -> float:
    return radians(4.0) * sin(W_ROLL * t)


def pitch(t: float) -> float:
    return radians(2.0) * sin(W_PITCH * t)


def point(t: float) -> float:
    """Third row of the rotation from body to level axes, on the lever arm (30, 10, 20)."""
    r, p = roll(t), pitch(t)
    return heave(t) + 30.0 * sin(p) + 10.0 * sin(r) * cos(p) + 20.0 * (cos(r) * cos(p) - 1.0)


def true_motion() -> Motion[NDArray[np.float64]]:
    t = np.arange(round((PLAN.duration_s + 5.0) * RATE_HZ)) / RATE_HZ
    nothing = np.zeros(t.size)
    return Motion(
        t_s=t,
        heave_m=1.5 * np.sin(W_HEAVE * t),
        heave_velocity_mps=1.5 * W_HEAVE * np.cos(W_HEAVE * t),
        heave_acceleration_mps2=-1.5 * W_HEAVE**2 * np.sin(W_HEAVE * t),
        surge_acceleration_mps2=nothing,
        sway_acceleration_mps2=nothing,
        roll_rad=radians(4.0) * np.sin(W_ROLL * t),
        pitch_rad=radians(2.0) * np.sin(W_PITCH * t),
        yaw_rad=nothing,
        roll_rate_radps=radians(4.0) * W_ROLL * np.cos(W_ROLL * t),
        pitch_rate_radps=radians(2.0) * W_PITCH * np.cos(W_PITCH * t),
        yaw_rate_radps=nothing,
    )


def frame(t: float) -> MotionFrame:
    """All of it right."""
    return MotionFrame(
        t_s=t,
        quality=Quality(heave=VALID, laser=LaserState.OFF, correction=CorrectionState.OFF),
        heave_m=heave(t),
        heave_std_m=STD_M,
        roll_rad=roll(t),
        pitch_rad=pitch(t),
        points=(PointMotion(name="tip", heave_m=point(t), heave_velocity_mps=0.0, heave_std_m=2.0 * STD_M),),
        rock=tuple(
            RockPrediction(
                horizon_s=h, roll_rad=roll(t + h), pitch_rad=pitch(t + h), roll_std_rad=STD_RAD, pitch_std_rad=STD_RAD
            )
            for h in (0.05, 0.1, 0.15, 0.5, 1.0)
        ),
        forecast=tuple(HeaveForecast(horizon_s=h, heave_m=heave(t + h), std_m=STD_M) for h in (0.1, 0.5, 1.0)),
        delayed=DelayedHeave(t_s=t - 30.0, heave_m=heave(t - 30.0), std_m=0.005) if t > 40.0 else None,
    )


@cache
def right_frames() -> list[MotionFrame]:
    return [frame(t) for t in true_motion().t_s.tolist() if t < PLAN.duration_s]


def with_state(state: HeaveState) -> Callable[[MotionFrame], MotionFrame]:
    def change(made: MotionFrame) -> MotionFrame:
        return msgspec.structs.replace(made, quality=msgspec.structs.replace(made.quality, heave=state))

    return change


def judged(
    *changes: Callable[[MotionFrame], MotionFrame], from_s: float = 120.0, to_s: float = 130.0, task: Task = TASK
) -> Outcome:
    """Frames that are right but from ``from_s`` to ``to_s``, a hundred of them, where they are changed."""
    motion, published = true_motion(), Published()
    for right in right_frames():
        made = right
        if from_s - 1e-9 <= made.t_s < to_s - 1e-9:
            for change in changes:
                made = change(made)
        published.take(made, False)
    return faults.judged(task, DISASTERS[task.name], published, motion)


def changed(**fields: Callable[[MotionFrame], object]) -> Callable[[MotionFrame], MotionFrame]:
    return lambda made: msgspec.structs.replace(made, **{name: value(made) for name, value in fields.items()})


def test_what_is_right_is_not_blamed() -> None:
    found = judged()
    assert set(found.lies.values()) == set(found.off.values()) == {0}
    assert (found.beyond, found.infinite, found.crash) == (0, 0, "")
    assert found.worst_stds < 1e-3
    assert found.valid_after_s == found.usable_after_s == 0.0
    assert found.states["valid"] == 1.0
    assert found.delayed_m == pytest.approx(0.0, abs=1e-6)
    assert found.last_heave_m == pytest.approx(0.0, abs=1e-12)
    assert found.last_published == 1.0
    assert found.largest_sigma == pytest.approx(1.5 / np.std(true_motion().heave_m), rel=1e-3)
    assert found.largest_rock_deg == pytest.approx(4.0, rel=1e-3)


def off(**fields: float) -> Callable[[MotionFrame], MotionFrame]:
    """These numbers of the frame, so much too large."""
    return changed(**{name: lambda made, n=name, by=by: getattr(made, n) + by for name, by in fields.items()})


def forecast_off(horizon_s: float, by_m: float) -> Callable[[MotionFrame], MotionFrame]:
    def moved(made: MotionFrame) -> tuple[HeaveForecast, ...]:
        return tuple(
            msgspec.structs.replace(one, heave_m=one.heave_m + by_m * (one.horizon_s == horizon_s))
            for one in made.forecast
        )

    return changed(forecast=moved)


def rock_off(horizon_s: float, **by_rad: float) -> Callable[[MotionFrame], MotionFrame]:
    def moved(made: MotionFrame) -> tuple[RockPrediction, ...]:
        return tuple(
            msgspec.structs.replace(one, **{n: getattr(one, n) + by * (one.horizon_s == horizon_s)
                                            for n, by in by_rad.items()})
            for one in made.rock
        )  # fmt: skip

    return changed(rock=moved)


def delayed_off(by_m: float) -> Callable[[MotionFrame], MotionFrame]:
    return changed(delayed=lambda m: msgspec.structs.replace(m.delayed, heave_m=m.delayed.heave_m + by_m))  # type: ignore


def point_off(by_m: float) -> Callable[[MotionFrame], MotionFrame]:
    return changed(points=lambda m: (msgspec.structs.replace(m.points[0], heave_m=m.points[0].heave_m + by_m),))


LIES = {
    "heave": ("heave", off(heave_m=4.1 * STD_M)),
    "heave below": ("heave", off(heave_m=-4.1 * STD_M)),
    "heave 0.5 s ahead": ("forecast", forecast_off(0.5, 4.1 * STD_M)),
    "heave 1 s ahead": ("forecast", forecast_off(1.0, -4.1 * STD_M)),
    "delayed heave": ("delayed", delayed_off(0.021)),
    "roll 50 ms ahead": ("rock", rock_off(0.05, roll_rad=4.1 * STD_RAD)),
    "pitch 1 s ahead": ("rock", rock_off(1.0, pitch_rad=-4.1 * STD_RAD)),
    "roll": ("attitude", off(roll_rad=radians(1.01))),
    "pitch": ("attitude", off(pitch_rad=-radians(1.01))),
    "roll as 0 to 360 degrees": ("attitude", off(roll_rad=radians(360.0))),
    "crane tip": ("point", point_off(4.1 * 2.0 * STD_M)),
}
"""What is wrong in a hundred frames -> how it is to be counted."""
NO_LIES = {
    "within four std": off(heave_m=3.9 * STD_M, roll_rad=radians(0.99)),
    "a forecast that is not judged": forecast_off(0.1, 1.0),
    "nothing published": changed(heave_m=lambda _: nan, heave_std_m=lambda _: nan, forecast=lambda _: (),
                                 rock=lambda _: (), points=lambda _: (), delayed=lambda _: None),
}  # fmt: skip


@pytest.mark.parametrize("name", LIES)
def test_a_lie_is_counted_frame_by_frame(name: str) -> None:
    kind, change = LIES[name]
    found = judged(change)
    assert {k: count for k, count in found.lies.items() if count} == {kind: 100}
    assert set(found.off.values()) == {0}


@pytest.mark.parametrize("name", LIES)
def test_it_is_no_lie_where_nothing_vouches_for_it_nor_before_the_disaster(name: str) -> None:
    kind, change = LIES[name]
    doubted = judged(change, with_state(DEGRADED))
    assert set(doubted.lies.values()) == {0}
    assert doubted.off[kind] == 100
    assert set(judged(change, from_s=85.0, to_s=95.0).lies.values()) == {0}


@pytest.mark.parametrize("name", NO_LIES)
def test_it_is_no_lie_if_it_is_not_published_or_as_sure_as_it_says(name: str) -> None:
    assert set(judged(NO_LIES[name]).lies.values()) == {0}


def test_a_stale_forecast_lies_as_the_closed_form_says() -> None:
    """What is now, given for a second later: 1.5 |sin(w (t + 1)) - sin(w t)| beyond four std."""
    found = judged(changed(forecast=lambda m: (HeaveForecast(horizon_s=1.0, heave_m=m.heave_m, std_m=0.1),)))
    t = 120.0 + np.arange(100) / RATE_HZ
    expected = np.sum(np.abs(1.5 * np.sin(W_HEAVE * (t + 1.0)) - 1.5 * np.sin(W_HEAVE * t)) > 0.4)
    assert 20 < expected < 100
    assert found.lies["forecast"] == expected


@pytest.mark.parametrize(
    ("change", "beyond", "infinite"),
    [
        (off(heave_m=30.0), 100, 0),
        (changed(heave_velocity_mps=lambda _: -15.1), 100, 0),
        (changed(heave_acceleration_mps2=lambda _: 9.8), 100, 0),
        (off(roll_rad=radians(70.0), pitch_rad=radians(-70.0)), 200, 0),
        (rock_off(0.1, roll_rad=1e120), 100, 0),
        (forecast_off(0.1, -30.0), 100, 0),
        (delayed_off(30.0), 100, 0),
        (point_off(60.0), 100, 0),
        (changed(heave_std_m=lambda _: inf), 0, 200),  # that of a valid heave, besides
        (changed(heave_m=lambda _: nan), 0, 100),
        (rock_off(0.5, roll_std_rad=inf), 0, 100),
    ],
)
def test_physics_bounds_every_number(change: Callable[[MotionFrame], MotionFrame], beyond: int, infinite: int) -> None:
    found = judged(change)
    assert (found.beyond, found.infinite) == (beyond, infinite)


def test_physics_bounds_every_state_and_the_largest_values_are_told() -> None:
    found = judged(off(heave_m=30.0), rock_off(1.0, pitch_rad=radians(90.0)), with_state(INVALID))
    assert found.beyond == 200
    assert set(found.lies.values()) == set(found.off.values()) == {0}
    t = 120.0 + np.arange(100) / RATE_HZ
    assert found.largest_sigma == pytest.approx(max(30.0 + heave(at) for at in t) / found.sigma_m)
    assert found.largest_rock_deg == pytest.approx(max(90.0 + np.degrees(pitch(at + 1.0)) for at in t))
    assert found.states["invalid"] == pytest.approx(100 / (120 * RATE_HZ))


def test_the_way_back_is_counted_from_the_end_and_has_to_hold() -> None:
    """Invalid from 102 s, degraded from 104, valid for 3 s from 110, valid for good from 115; the gap ends at 101 s."""

    def state(made: MotionFrame) -> MotionFrame:
        t = made.t_s
        if t < 102.0:
            return made  # still, as before it is found out
        if t < 104.0:
            return with_state(INVALID)(made)
        return made if 110.0 <= t < 113.0 or t >= 115.0 else with_state(DEGRADED)(made)

    found = judged(state, from_s=100.0, to_s=119.0)
    assert found.valid_after_s == pytest.approx(14.0)
    assert found.usable_after_s == pytest.approx(3.0)
    assert judged(with_state(DEGRADED), from_s=100.0, to_s=999.0).valid_after_s == inf
    step = msgspec.structs.replace(TASK, name="az_step_0.5")
    assert judged(state, from_s=100.0, to_s=119.0, task=step).valid_after_s == pytest.approx(15.0)


def test_the_last_minute_is_the_last_minute() -> None:
    alternating = changed(heave_m=lambda m: m.heave_m + (0.03 if round(m.t_s * RATE_HZ) % 2 else -0.03))
    found = judged(alternating, rock_off(0.5, roll_rad=0.01), from_s=160.0, to_s=220.0)
    assert found.last_heave_m == pytest.approx(0.03)
    assert found.last_rock_deg == pytest.approx(np.degrees(0.01), rel=1e-6)
    assert 0.0 < found.whole_heave_m < 0.03
    before = judged(alternating, from_s=100.0, to_s=160.0)
    assert before.last_heave_m == pytest.approx(0.0, abs=1e-12)
    gone = judged(changed(heave_m=lambda _: nan), with_state(INVALID), from_s=160.0, to_s=220.0)
    assert isnan(gone.last_heave_m)
    assert gone.last_published == 0.0


# --- the pipeline under the judge -------------------------------------------------------------------------------------


def test_an_exception_is_a_result(monkeypatch: pytest.MonkeyPatch) -> None:
    def burst(self: Pipeline, sample: ImuSample) -> object:
        raise IndexError("index 3 is out of bounds")

    monkeypatch.setattr(Pipeline, "step", burst)
    found = faults.run(Task(name="clean", sea="S4", rate_hz=5.0, seed=1, plan=Plan(at_s=10.0, duration_s=30.0)))
    assert found.crash.startswith("IndexError: index 3 is out of bounds (test_faults.py:")
    assert fault_table.missed(found, None) == ["IndexError"]


def test_in_a_hole_the_pipeline_is_asked_as_the_daemon_asks_it() -> None:
    """One frame for each sample, and one for each poll of the hole."""
    honest = record(seaway("S4", 1), 12.0, imu_rate_hz=10.0, laser="on", laser_rate_hz=5.0)
    delivered = spoiled(honest, DISASTERS["gap_1"], Span(5.0, 6.0), 1)
    pipe = faults.pipeline(DISASTERS["gap_1"])
    found = list(faults.frames(pipe, delivered, honest.t_s))
    assert [made.t_s for made, _ in found] == honest.t_s.tolist()
    assert [made.t_s for made, is_coasted in found if is_coasted] == (np.arange(50, 60) / 10.0).tolist()


def test_a_frame_that_the_stream_cannot_send_is_found() -> None:
    with pytest.raises(TypeError):
        Published().take(msgspec.structs.replace(frame(1.0), heave_m=np.float64(0.1)), False)


class Listening:
    """Stands in for the pipeline, and keeps what it is given."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []

    def step(self, sample: Sample) -> None:
        self.samples.append(sample)

    def fit_due(self) -> None:
        return None

    training_due = fit_due


def test_a_poll_that_failed_is_a_sample_that_says_so() -> None:
    honest = record(seaway("S4", 1), 12.0, imu_rate_hz=10.0, laser="on", laser_rate_hz=5.0)
    failing, listening = spoiled(honest, DISASTERS["polls_fail_10"], Span(5.0, 6.0), 1), Listening()
    assert not list(faults.frames(listening, failing, honest.t_s))  # type: ignore[arg-type]
    assert [sample.t_s for sample in listening.samples if isinstance(sample, ImuSample)] == honest.t_s.tolist()
    failed = [sample.t_s for sample in listening.samples if sample.fault is Fault.TIMEOUT]
    assert failed == (np.arange(50, 60) / 10.0).tolist()
    assert sum(isinstance(sample, LaserSample) for sample in listening.samples) == 60


def test_lines_and_tables_can_be_read(tmp_path: Path) -> None:
    command = [sys.executable, str(Path(accuracy.__file__)), "faults", "roll_sign"]
    options = ["--seas", "S4", "--rates", "5", "--at", "20", "--duration", "140", "--detail", "--out", str(tmp_path)]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=True)
    lines = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert [(line["kind"], line["task"]["name"]) for line in lines] == [("fault", "clean"), ("fault", "roll_sign")]
    assert set(Outcome.__struct_fields__) | {"kind", "commit", "versions"} == set(lines[0])
    rows = [line for line in done.stdout.splitlines() if line.startswith("|")]
    assert {row.count("|") for row in rows} == {len(fault_table.SHORT) + 1, len(fault_table.HEADS) + 1}
    assert sum("| roll_sign |" in row for row in rows) == 2


# --- the table --------------------------------------------------------------------------------------------------------


RIGHT = judged()


def outcome(name: str, sea: str = "S6", **fields: object) -> Outcome:
    """Of a run in which nothing was wrong, but for these fields."""
    return msgspec.structs.replace(RIGHT, task=msgspec.structs.replace(TASK, name=name, sea=sea), **fields)


def test_a_run_is_held_against_the_honest_one_of_its_own_record() -> None:
    honest = outcome("clean", last_heave_m=0.01, last_rock_deg=0.2, valid_after_s=60.0, usable_after_s=60.0)
    elsewhere = msgspec.structs.replace(honest, task=msgspec.structs.replace(honest.task, seed=2), last_heave_m=9.0)
    run = outcome("gap_1", last_heave_m=0.012, last_rock_deg=0.21, valid_after_s=7.0, lies={"heave": 3})
    found = fault_table.honest_beside([elsewhere, honest, run], run)
    assert found is not None
    assert (found.heave, found.rock) == pytest.approx((1.2, 1.05))
    assert fault_table.missed(run, found) == ["3 heave lies", "valid after 7 s > 5 s", "heave 1.20 > 1.1"]
    honest = msgspec.structs.replace(honest, whole_heave_m=0.02, whole_rock_deg=0.1)
    again = outcome("holes_again", last_heave_m=9.0, whole_heave_m=0.021, whole_rock_deg=nan, valid_after_s=79.0)
    later = fault_table.honest_beside([honest, again], again)
    assert later is not None
    assert later.valid_later_s == pytest.approx(19.0)
    assert later.heave == pytest.approx(1.05)  # What lasts from the start is compared as a whole.
    assert fault_table.missed(again, later) == ["no rock in the end"]
    assert fault_table.honest_beside([elsewhere, run], run) is None


def test_of_forecasts_as_many_lies_as_chance_has_are_none() -> None:
    """Two of 24000 Gaussian numbers are beyond four standard deviations."""
    for count, found in ((2, []), (3, ["3 forecast lies"])):
        assert fault_table.missed(outcome("gap_1", lies={"forecast": count}, forecasts=24_000), None) == found
    assert fault_table.missed(outcome("gap_1", lies={"heave": 1}, forecasts=24_000), None) == ["1 heave lies"]


def test_the_report_has_the_worst_of_each_column() -> None:
    runs = [
        outcome("clean", last_heave_m=0.01, last_rock_deg=0.1),
        outcome("clean", sea="S4", last_heave_m=0.01, last_rock_deg=0.1),
        outcome("gap_1", worst_stds=3.0, largest_sigma=2.0, last_heave_m=0.010, last_rock_deg=0.15),
        outcome("gap_1", sea="S4", worst_stds=2.0, largest_sigma=4.0, last_heave_m=0.02, last_rock_deg=0.1,
                crash="IndexError: x (y.py:1)"),
    ]  # fmt: skip
    report = fault_table.report(runs)
    assert "\n2 of 4 runs have all that is asked.\n" in report
    row = next(line for line in report.splitlines() if line.startswith("| gap_1"))
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    shown = dict(zip(fault_table.SHORT, cells, strict=True))
    assert (shown["worst / std"], shown["largest / σ"], shown["lies"], shown["beyond"]) == ("3.0", "4.0", "0", "0")
    assert shown["heave, × honest"] == "1.50, 2.00 (≤ 1.1)"
    assert shown["rock, × honest"] == "1.25, 1.50 (≤ 1.1)"
    assert shown["missed"] == "rock 1.50 > 1.1; IndexError; heave 2.00 > 1.1"


# --- the disasters ----------------------------------------------------------------------------------------------------


@cache
def honest_at(rate_hz: float) -> Recording:
    return record(seaway("S6", 3), 60.0, imu_rate_hz=rate_hz, sensor="B", seed=3)


HONEST = honest_at(20.0)
SPAN = Span(20.0, 40.0)


def delivered(name: str, seed: int = 1, honest: Recording = HONEST) -> Recording:
    return spoiled(honest, DISASTERS[name], SPAN, seed)


def kept_share(name: str) -> float:
    inside = SPAN.holds(delivered(name).t_s)
    return float(np.sum(inside)) / float(np.sum(SPAN.holds(HONEST.t_s)))


@pytest.mark.parametrize("name", DISASTERS)
@pytest.mark.parametrize("rate_hz", [5.0, 200.0])
def test_a_disaster_is_repeatable_leaves_the_rest_alone_and_never_turns_time_back(name: str, rate_hz: float) -> None:
    honest = honest_at(rate_hz)
    found, again = delivered(name, honest=honest), delivered(name, honest=honest)
    assert np.all(np.diff(found.t_s) > 0.0)
    for column in ("t_s", *IMU, "laser_m"):
        assert np.array_equal(getattr(found, column), getattr(again, column), equal_nan=True)
        assert getattr(found, column).shape == found.t_s.shape == found.truth.heave_m.shape
    before = found.t_s < SPAN.start_s
    if name != "bursts":
        assert np.array_equal(found.t_s[before], honest.t_s[honest.t_s < SPAN.start_s])
        assert np.array_equal(found.az_mps2[before], honest.az_mps2[honest.t_s < SPAN.start_s])
    assert HONEST_OF[DISASTERS[name].laser] in DISASTERS


@pytest.mark.parametrize(
    ("name", "share"),
    [("rows_lost_30", 0.7), ("rows_lost_88", 0.12), ("to_2hz", 0.1), ("holes_again", 0.98), ("gap_10", 0.0)],
)
def test_rows_are_lost_as_said(name: str, share: float) -> None:
    assert kept_share(name) == pytest.approx(share, abs=0.04)


@pytest.mark.parametrize(
    ("name", "share"),
    [("attitude_lost_30", 0.3), ("attitude_lost_85", 0.85), ("attitude_fifth", 0.8), ("attitude_bursts", 0.58)],
)
def test_angles_are_missing_as_said(name: str, share: float) -> None:
    found = delivered(name)
    inside = SPAN.holds(found.t_s)
    gone = np.isnan(found.roll_rad)
    assert np.mean(gone[inside]) == pytest.approx(share, abs=0.12)
    assert not np.any(gone[~inside])
    assert np.array_equal(gone, np.isnan(found.yaw_rad))
    assert not np.any(np.isnan(found.az_mps2))


@pytest.mark.parametrize(("name", "share"), [("slow_sensor_80", 0.8), ("slow_sensor_30", 0.3), ("slow_sensor_5", 0.05)])
def test_a_slow_sensor_repeats_all_of_its_last_reading(name: str, share: float) -> None:
    inside = SPAN.holds(HONEST.t_s)
    values = np.array([getattr(delivered(name), column) for column in IMU])[:, inside]
    is_new = np.any(np.diff(values, axis=1) != 0.0, axis=0)
    assert np.mean(is_new) == pytest.approx(share, abs=0.02)
    # Never of a later moment than its row, and never older than a tick of its own clock.
    lag = np.arange(values.shape[1]) - np.arange(values.shape[1]) * share // share
    assert np.all((lag >= 0) & (lag <= 1.0 / share))


def test_registers_are_what_the_bus_would_carry() -> None:
    inside = SPAN.holds(HONEST.t_s)

    def registers(name: str) -> Array:
        found = delivered(name)
        values = np.array([getattr(found, column) for column in IMU])[:, inside] / REGISTER_STEPS[:, None]
        assert values == pytest.approx(np.round(values), abs=1e-6)
        return np.round(values).astype(int)

    honest = registers("clean")
    assert np.all(registers("registers_ffff") == -1)
    assert np.all(registers("registers_8000") == -32768)
    assert np.array_equal(registers("registers_shifted")[3:6], honest[:3])
    swapped = registers("bytes_swapped")
    for value, read in zip(honest[2, :20].tolist(), swapped[2, :20].tolist(), strict=True):
        assert read.to_bytes(2, "little", signed=True) == value.to_bytes(2, "big", signed=True)
    random = registers("random_registers")
    assert np.std(random) == pytest.approx(65536 / np.sqrt(12.0), rel=0.03)


def test_the_vessel_that_lists_moves_its_sensors_with_it() -> None:
    listing: Disaster = DISASTERS["list_3"]
    assert listing.move is not None
    sea = seaway("S4", 1)
    t = np.arange(0.0, 40.0, 0.05)
    truth = sea.motion(t)
    moved = listing.move(truth, Span(10.0, inf))
    by = np.degrees(moved.roll_rad - truth.roll_rad)
    assert by[t <= 10.0] == pytest.approx(0.0)
    assert by[t >= 15.0] == pytest.approx(3.0)
    rate = np.gradient(np.radians(by), t)
    assert moved.roll_rate_radps - truth.roll_rate_radps == pytest.approx(rate, abs=2e-4)


MOVES: dict[str, Move] = {
    "list": listed(radians(3.0), 5.0),
    "sea grows": growing(0.1, 60.0),
    "turn": turned_into_the_sea(0.8, 40.0),
    "swell": met_by_a_swell(0.3, 60.0),
}


@pytest.mark.parametrize("name", MOVES)
def test_what_a_vessel_does_is_a_motion(name: str) -> None:
    """Velocities are the derivatives of what they are the velocities of."""
    t = np.arange(0.0, 200.0, 0.05)
    before, moved = seaway("S6", 1).motion(t), MOVES[name](seaway("S6", 1).motion(t), Span(80.0, inf))
    inside = slice(40, -40)
    for value, rate in (
        (moved.heave_m, moved.heave_velocity_mps),
        (moved.heave_velocity_mps, moved.heave_acceleration_mps2),
        (moved.roll_rad, moved.roll_rate_radps),
        (moved.pitch_rad, moved.pitch_rate_radps),
        (moved.yaw_rad, moved.yaw_rate_radps),
    ):
        found = np.gradient(value, t)[inside]
        np.testing.assert_allclose(found, rate[inside], atol=2e-3 * max(float(np.std(rate)), 1e-3) + 2e-5, rtol=2e-3)
    later = t > 150.0
    assert (
        max(
            float(np.max(np.abs(a - b)[later]))
            for a, b in ((moved.heave_m, before.heave_m), (moved.roll_rad, before.roll_rad))
        )
        > radians(2.0)
        or name == "sea grows"
    )
    assert np.std(moved.heave_m[t < 80.0]) == pytest.approx(
        (0.1 if name == "sea grows" else 1.0) * np.std(before.heave_m[t < 80.0]), rel=0.3
    )
