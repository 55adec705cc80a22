"""What befalls the readings of an IMU on their way: disasters as data, put into simulated seas whose truth is known.

A value that is published as valid is right within four of its standard deviations, whatever the sensor says.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from math import isfinite, pi, radians
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from pipelines import pipeline, rms

from heaved.estimation.heave import params as heave
from heaved.estimation.heave.estimator import Heave, HeaveEstimator
from heaved.estimation.heave.observer import foretold
from heaved.estimation.heave.quality import BEYOND_PHYSICS
from heaved.estimation.heave.sea.refit import look
from heaved.estimation.lever_arm import Point
from heaved.estimation.motion_frame import MotionFrames
from heaved.samples import GRAVITY_MPS2, HeaveState, ImuSample, MotionFrame
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import REGISTER_STEPS, measure

if TYPE_CHECKING:
    from heaved.pipeline import Pipeline
    from heaved.simulate.vessel import Motion

Array = NDArray[np.float64]
COLUMNS = (
    *("ax_mps2", "ay_mps2", "az_mps2", "roll_rad", "pitch_rad", "yaw_rad"),
    *("gx_radps", "gy_radps", "gz_radps"),
)
TIP = Point(name="tip", forward_m=30.0, port_m=-8.0, up_m=20.0)
FORCES, ANGLES, RATES = (0, 1, 2), (3, 4, 5), (6, 7, 8)
BEGIN_S, END_S = 90.0, 130.0
TILT = "no attitude or no horizontal acceleration"


class Sea(NamedTuple):
    t_s: Array
    readings: Array
    """(9, n)"""
    truth: Motion[Array]


@cache
def sea(name: str, rate_hz: float, duration_s: float = END_S) -> Sea:
    t = np.arange(round(duration_s * rate_hz)) / rate_hz
    truth = seaway(name, 7).motion(t)
    made = measure(truth, imu_rate_hz=rate_hz, laser="off", seed=7)
    return Sea(t, np.array([getattr(made, column) for column in COLUMNS]), truth)


def samples(t_s: Array, readings: Array) -> Iterator[ImuSample]:
    for t, row in zip(t_s.tolist(), readings.T.tolist(), strict=True):
        yield ImuSample(t_s=t, **dict(zip(COLUMNS, row, strict=True)))


def new_pipeline(*, with_rock: bool = True) -> Pipeline:
    return pipeline(heave_params=heave.Params(), has_laser=False, with_rock=with_rock, point=(TIP,))


def run(pipe: Pipeline, given: Iterable[ImuSample]) -> list[MotionFrame]:
    frames = []
    for sample in given:
        frame = pipe.step(sample)
        if (past := pipe.fit_due()) is not None:
            pipe.accept_fit(look(past))
        assert frame is not None
        frames.append(frame)
    return frames


@cache
def before(name: str, rate_hz: float) -> Pipeline:
    """After BEGIN_S of a sea in which all was well."""
    pipe, made = new_pipeline(), sea(name, rate_hz)
    calm = made.t_s < BEGIN_S
    run(pipe, samples(made.t_s[calm], made.readings[:, calm]))
    return pipe


def lift(truth: Motion[Array]) -> Array:
    """Heave of the tip: that of the IMU, and the third row of the rotation times the lever arm."""
    sr, cr = np.sin(truth.roll_rad), np.cos(truth.roll_rad)
    sp, cp = np.sin(truth.pitch_rad), np.cos(truth.pitch_rad)
    return truth.heave_m + sp * TIP.forward_m + sr * cp * TIP.port_m + (cr * cp - 1.0) * TIP.up_m


class Judged(NamedTuple):
    lies: int
    """Frames whose heave is valid and wrong."""
    point_lies: int
    tilt_error_deg: float
    """The largest of roll and pitch that was published."""
    reasons: set[str]
    states: set[HeaveState]


def judged(frames: list[MotionFrame], made: Sea) -> Judged:
    at = np.searchsorted(made.t_s, [f.t_s for f in frames])
    valid = np.array([f.quality.heave is HeaveState.VALID for f in frames])

    def lying(values: list[float], stds: list[float], truth: Array) -> int:
        return int(np.sum(valid & (np.abs(np.array(values) - truth[at]) > 4.0 * np.array(stds))))

    names = ("roll_rad", "pitch_rad")
    tilt = [np.array([getattr(f, name) for f in frames]) - getattr(made.truth, name)[at] for name in names]
    return Judged(
        lies=lying([f.heave_m for f in frames], [f.heave_std_m for f in frames], made.truth.heave_m),
        point_lies=lying(
            [f.points[0].heave_m for f in frames], [f.points[0].heave_std_m for f in frames], lift(made.truth)
        ),
        tilt_error_deg=float(np.degrees(np.nanmax(np.abs(tilt)))),
        reasons={reason for f in frames for reason in f.quality.reasons},
        states={f.quality.heave for f in frames},
    )


# --- what is done to the readings -----------------------------------------------------------------------------------

Change = Callable[[Array, Array, np.random.Generator], None]
"""Given the seconds since it began (n,) and the readings (9, n), which it changes in place."""


def turned_round(t: Array, x: Array, rng: np.random.Generator) -> None:
    x[3:5] %= 2.0 * pi


def random_registers(rows: tuple[int, ...], share: float, seconds: float) -> Change:
    def change(t: Array, x: Array, rng: np.random.Generator) -> None:
        hit = np.flatnonzero((t < seconds) & (rng.random(t.size) < share))
        drawn = rng.integers(-32768, 32768, (len(rows), hit.size)) * REGISTER_STEPS[list(rows), None]
        x[np.array(rows)[:, None], hit] = drawn

    return change


def shifted(t: Array, x: Array, rng: np.random.Generator) -> None:
    hit = np.flatnonzero((t < 20.0) & (rng.random(t.size) < 0.2))
    x[:, hit] = np.roll(x[:, hit], 1, axis=0)


def frozen(rows: tuple[int, ...], seconds: float) -> Change:
    def change(t: Array, x: Array, rng: np.random.Generator) -> None:
        for row in rows:
            x[row, t < seconds] = x[row, 0]

    return change


class Disaster(NamedTuple):
    name: str
    change: Change
    says: str = ""
    """Part of a reason that must be given; "": nothing need be said."""
    tilt_error_deg: float = 2.5
    """That no published roll or pitch may exceed: the last good ones serve for half a second."""


DISASTERS = [
    Disaster("nothing", lambda t, x, rng: None, tilt_error_deg=0.15),
    Disaster("angles of 0 to 360 degrees", turned_round, tilt_error_deg=0.15),
    Disaster("random registers now and then", random_registers((*FORCES, *ANGLES, *RATES), 0.3, 20.0)),
    Disaster("random registers for 10 s", random_registers((*FORCES, *ANGLES, *RATES), 1.0, 10.0), "imu: out_of_range"),
    Disaster("random angles now and then", random_registers(ANGLES, 0.3, 20.0)),
    Disaster("random angles for 10 s", random_registers(ANGLES, 1.0, 10.0), TILT),
    Disaster("registers of their neighbours", shifted, tilt_error_deg=3.0),
    Disaster("angles frozen for 4 s", frozen(ANGLES, 4.0), "roll and pitch stuck"),
    Disaster("angles frozen for 20 s", frozen(ANGLES, 20.0), TILT),
    Disaster("roll frozen", frozen((3,), 20.0), "imu: roll stuck"),
    Disaster("pitch frozen", frozen((4,), 20.0), "imu: pitch stuck"),
    Disaster("az frozen", frozen((2,), 10.0), "imu: stuck", tilt_error_deg=0.15),
    Disaster("ay frozen", frozen((1,), 10.0), "imu: ay stuck", tilt_error_deg=0.15),
    Disaster("rates frozen", frozen(RATES, 20.0), tilt_error_deg=0.15),
]


@pytest.mark.parametrize(("name", "rate_hz"), [("S6", 20.0), ("S5", 5.0)])
def test_a_copy_goes_on_as_the_pipeline_does(name: str, rate_hz: float) -> None:
    """What befalls copies of one that has run for long tells what would befall that one."""
    made = sea(name, rate_hz)
    hit = made.t_s >= BEGIN_S
    t, readings = made.t_s[hit], made.readings[:, hit].copy()
    shifted(t - BEGIN_S, readings, np.random.default_rng(5))
    original = before.__wrapped__(name, rate_hz)
    copied = copy.deepcopy(original)

    def published(frame: MotionFrame) -> list[float]:
        rock = [(p.roll_rad, p.pitch_rad, p.yaw_rad, p.roll_std_rad, p.pitch_std_rad) for p in frame.rock]
        heave = [frame.heave_m, frame.heave_std_m, *(point.heave_m for point in frame.points)]
        return [*heave, frame.roll_rad, frame.pitch_rad, *(value for values in rock for value in values)]

    mine, other = ([published(f) for f in run(pipe, samples(t, readings))] for pipe in (copied, original))
    np.testing.assert_allclose(mine, other, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(("name", "rate_hz"), [("S6", 20.0), ("S5", 5.0), ("S4", 25.0)])
@pytest.mark.parametrize("disaster", DISASTERS, ids=lambda d: d.name)
def test_no_reading_makes_a_valid_value_wrong(disaster: Disaster, name: str, rate_hz: float) -> None:
    made = sea(name, rate_hz)
    hit = made.t_s >= BEGIN_S
    t, readings = made.t_s[hit], made.readings[:, hit].copy()
    disaster.change(t - BEGIN_S, readings, np.random.default_rng(5))
    found = judged(run(copy.deepcopy(before(name, rate_hz)), samples(t, readings)), made)
    assert found.lies == 0
    # A register that passes for an angle, once: the point is off by its lever arm until the next reading.
    assert found.point_lies <= 1
    assert found.tilt_error_deg < disaster.tilt_error_deg
    assert any(disaster.says in reason for reason in found.reasons) or not disaster.says
    assert HeaveState.VALID in found.states


# --- sensors that are slower than their polls -----------------------------------------------------------------------


SLOW_SEED = 2


def polled(name: str, poll_hz: float, forces_hz: float, angles_hz: float, duration_s: float) -> Sea:
    """A device that measures at these rates and answers with what it measured last."""
    vessel = seaway(name, SLOW_SEED)
    t = np.arange(round(duration_s * poll_hz)) / poll_hz
    readings = np.empty((9, t.size))
    for rate_hz, rows in ((forces_hz, (*FORCES, *RATES)), (angles_hz, ANGLES)):
        ticks = (np.arange(-1, round(duration_s * rate_hz) + 1, dtype=np.float64) + 0.3) / rate_hz
        own = measure(vessel.motion(ticks), imu_rate_hz=rate_hz, laser="off", seed=7)
        shown = np.searchsorted(ticks, t + 1e-9) - 1
        for row in rows:
            readings[row] = getattr(own, COLUMNS[row])[shown]
    return Sea(t, readings, vessel.motion(t))


@pytest.mark.parametrize(
    ("poll_hz", "forces_hz", "angles_hz", "says"),
    [
        (100.0, 30.0, 30.0, "accelerations measured 30 times a second, polled 100 times"),
        (100.0, 10.0, 10.0, "accelerations measured 10 times a second, polled 100 times"),
        (20.0, 16.0, 16.0, "accelerations measured 16 times a second, polled 20 times"),
        (50.0, 50.0, 10.0, "attitude measured 10 times a second, polled 50 times"),
        (40.0, 10.0, 40.0, "accelerations measured 10 times a second, polled 40 times"),
    ],
)
def test_a_sensor_slower_than_its_polls_is_taken_at_its_own_rate(
    poll_hz: float, forces_hz: float, angles_hz: float, says: str
) -> None:
    """Oracle: the same sensor, read at the moments at which it measures."""
    made = polled("S6", poll_hz, forces_hz, angles_hz, 110.0)
    frames = run(new_pipeline(with_rock=False), samples(made.t_s, made.readings))
    assert len(frames) == made.t_s.size
    late = made.t_s > 75.0
    last = [frame for frame in frames if frame.t_s > 75.0]
    found = judged(last, made)
    assert (found.lies, found.states) == (0, {HeaveState.VALID})
    assert says in found.reasons
    error = np.array([f.heave_m for f in last]) - made.truth.heave_m[late]
    ticks = (np.arange(round(110.0 * forces_hz), dtype=np.float64) + 0.3) / forces_hz
    truth = seaway("S6", SLOW_SEED).motion(ticks)
    own = measure(truth, imu_rate_hz=forces_hz, laser="off", seed=7)
    readings = np.array([getattr(own, column) for column in COLUMNS])
    right = run(new_pipeline(with_rock=False), samples(ticks, readings))
    best = rms((np.array([f.heave_m for f in right]) - truth.heave_m)[ticks > 75.0])
    assert rms(error) < 1.3 * best + 0.004


# --- points ---------------------------------------------------------------------------------------------------------


def test_points_are_as_well_known_as_they_say() -> None:
    made = sea("S6", 20.0)
    hit = made.t_s >= BEGIN_S
    frames = run(copy.deepcopy(before("S6", 20.0)), samples(made.t_s[hit], made.readings[:, hit]))
    tips = [frame.points[0] for frame in frames]
    z = (np.array([p.heave_m for p in tips]) - lift(made.truth)[hit]) / np.array([p.heave_std_m for p in tips])
    assert 0.1 < rms(z) < 1.3
    assert np.mean(np.abs(z) < 1.96) > 0.9


# --- bounds ---------------------------------------------------------------------------------------------------------


class Told(HeaveEstimator):
    """Says what it is told to."""

    def __init__(self, of: HeaveEstimator, told: Heave) -> None:
        vars(self).update(vars(of))
        self.told = told

    def at(self, shift_s: float) -> Heave:
        return self.told


@pytest.mark.parametrize(
    "wild", [{"heave_m": 21.0}, {"heave_m": -1e9}, {"velocity_mps": 16.0}, {"acceleration_mps2": 9.0}], ids=str
)
def test_what_no_vessel_does_is_not_published_and_counted_once(
    wild: dict[str, float],
) -> None:
    pipe = copy.deepcopy(before("S4", 50.0))
    usual = pipe.coast(BEGIN_S)
    told = Heave(
        heave_m=usual.heave_m,
        std_m=usual.heave_std_m,
        velocity_mps=usual.heave_velocity_mps,
        acceleration_mps2=0.1,
        observer_m=usual.heave_m,
        correction_m=0.0,
        lead_s=0.0,
        forecast=(foretold(1.0, 25.0, 0.1), foretold(2.0, 0.5, 0.1)),
    )
    told_to = Told(pipe.heave, told)
    frames = MotionFrames(pipe.vertical, told_to, pipe.stages, point=(TIP,), rock_horizons_s=pipe.rock.horizons_s)
    predictions = pipe.rock.at(BEGIN_S)
    fine = frames.at(BEGIN_S, predictions, None, ())
    assert isfinite(fine.heave_m)
    assert [isfinite(f.heave_m) for f in fine.forecast] == [False, True]
    told_to.told = msgspec.structs.replace(told, **wild)
    for _ in range(3):
        frame = frames.at(BEGIN_S, predictions, None, ())
        assert frame.quality.heave is HeaveState.INVALID
        assert frame.quality.reasons[0] == BEYOND_PHYSICS
        assert not any(isfinite(v) for v in (frame.heave_m, frame.heave_std_m, frame.heave_velocity_mps))
        assert not isfinite(frame.points[0].heave_m)
    assert frames.resets["frame", "beyond physics"] == 1


# --- signs and units ------------------------------------------------------------------------------------------------


def upside_down(x: Array) -> None:
    x[2] *= -1.0


def in_g(x: Array) -> None:
    x[:3] /= GRAVITY_MPS2


def without_gravity(x: Array) -> None:
    x[2] -= GRAVITY_MPS2


def in_millimetres(x: Array) -> None:
    x[:3] *= 1000.0


def of_wrong_sign(row: int) -> Callable[[Array], None]:
    def change(x: Array) -> None:
        x[row] *= -1.0

    return change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (upside_down, "az about -9.8"),
        (in_g, "in g?"),
        (without_gravity, "gravity removed?"),
        (in_millimetres, "mm/s2?"),
        (of_wrong_sign(3), "roll and ay disagree"),
        (of_wrong_sign(1), "roll and ay disagree"),
        (of_wrong_sign(4), "pitch and ax disagree"),
    ],
)
@pytest.mark.parametrize("name", ["S4", "S6"])
def test_signs_and_units_are_named_and_never_valid(name: str, change: Callable[[Array], None], says: str) -> None:
    made = sea(name, 20.0)
    readings = made.readings.copy()
    change(readings)
    frames = run(new_pipeline(with_rock=False), samples(made.t_s, readings))
    assert HeaveState.VALID not in {frame.quality.heave for frame in frames}
    last = frames[-1].quality
    assert any(says in reason for reason in last.reasons)
    if "disagree" not in says:
        assert last.heave is HeaveState.INVALID
        assert {frame.quality.heave for frame in frames if frame.t_s > 7.0} == {HeaveState.INVALID}
        assert all(frame.heave_m != frame.heave_m for frame in frames)
    assert all(abs(frame.heave_m) <= 20.0 or frame.heave_m != frame.heave_m for frame in frames)


def test_a_still_ship_with_a_coarse_attitude_is_valid() -> None:
    made = sea("S0", 20.0, 100.0)
    readings = made.readings.copy()
    readings[3:5] = np.round(readings[3:5] / radians(0.1)) * radians(0.1)
    frames = run(new_pipeline(with_rock=False), samples(made.t_s, readings))
    assert {frame.quality.heave for frame in frames if frame.t_s > 70.0} == {HeaveState.VALID}


def test_without_a_sample_there_is_no_attitude_and_no_point() -> None:
    frame = new_pipeline().coast(1.0)
    assert frame.points[0].heave_m != frame.points[0].heave_m
    assert frame.roll_rad != frame.roll_rad
