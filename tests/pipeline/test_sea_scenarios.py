"""Bad input to the whole pipeline with the default observer: each is told of, survived, and forgotten.

Oracle: the truth of the simulated sea, and the table below of what a consumer must be told.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from functools import cache
from math import cos, inf, isfinite, isinf, nan, radians, sin
from typing import NamedTuple

import msgspec
import numpy as np
import pytest
from pipelines import NoRock, numbers

from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, reference
from heaved.estimation.heave.saved_state import SavedState
from heaved.estimation.heave.sea.refit import look
from heaved.pipeline import Pipeline, assemble
from heaved.samples import GRAVITY_MPS2, HeaveState, ImuSample, LaserSample, MotionFrame, Sample
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import record

Change = Callable[[Sample], Sample | None]
RATE_HZ = 10.0
BEGIN_S = 150.0
SURVIVED = 0.06
"""Of the standard deviation of the heave: what the error must be back to."""
G = GRAVITY_MPS2


def built(*, has_laser: bool) -> Pipeline:
    """The default pipeline, but for the rock predictor and the training of a network."""
    return assemble(
        heave=heave.Params(forecast_horizons_s=(1.0,)),
        laser=reference.Params(),
        correction=correction.Params(),
        rock=NoRock(),
        has_laser=has_laser,
    )


class Sea(NamedTuple):
    samples: tuple[Sample, ...]
    truth: dict[float, float]
    sigma_m: float


@cache
def sea(seconds: float = 900.0) -> Sea:
    made = record(seaway("S5", 3, start_s=100.0), seconds, imu_rate_hz=RATE_HZ, sensor="A", laser="on", seed=11)
    truth = dict(zip(made.t_s.tolist(), made.truth.heave_m.tolist(), strict=True))
    return Sea(tuple(made.samples()), truth, float(np.std(made.truth.heave_m)))


Frames = list[tuple[float, MotionFrame]]


def run(pipe: Pipeline, begin_s: float, end_s: float, change: Change = lambda s: s) -> Frames:
    """Frames by the time of the untouched sample; a missing one is coasted over, and every fit is at once."""
    frames = []
    for sample in sea().samples:
        if not begin_s <= sample.t_s < end_s:
            continue
        now = change(sample)
        frame = pipe.step(now) if now is not None else pipe.coast(sample.t_s) if isinstance(sample, ImuSample) else None
        if (past := pipe.fit_due()) is not None:
            pipe.accept_fit(look(past))
        if frame is not None:
            frames.append((sample.t_s, frame))
    return frames


@cache
def before(has_laser: bool) -> tuple[Pipeline, Frames]:
    """Two and a half minutes of a good sea."""
    pipe = built(has_laser=has_laser)
    return pipe, run(pipe, 0.0, BEGIN_S)


def errors(frames: Frames, begin_s: float, end_s: float = inf) -> np.ndarray:
    found = [f.heave_m - sea().truth[t] for t, f in frames if begin_s <= t < end_s]
    return np.array(found)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def plain(reason: str) -> str:
    """A reason without its numbers."""
    return re.sub(r"\d+(\.\d+)?", "#", reason)


def reasons(frames: Frames, begin_s: float = -inf, end_s: float = inf) -> set[str]:
    return {plain(r) for t, f in frames if begin_s <= t < end_s for r in f.quality.reasons}


def covered(frames: Frames, begin_s: float = -inf) -> tuple[int, float]:
    """How many frames are valid, and the share of them with an error within 1.96 standard deviations."""
    valid = [
        abs(f.heave_m - sea().truth[t]) < 1.96 * f.heave_std_m
        for t, f in frames
        if t >= begin_s and f.quality.heave is HeaveState.VALID
    ]
    return len(valid), float(np.mean(valid)) if valid else nan


# --- what can be done to a sample ------------------------------------------------------------------------------------


def to(kind: type[ImuSample] | type[LaserSample], **values: float) -> Change:
    return lambda s: msgspec.structs.replace(s, **values) if isinstance(s, kind) else s


def clipped(s: Sample) -> Sample:
    """At the end of its range, a third of a metre per second squared about gravity."""
    if not isinstance(s, ImuSample):
        return s
    return msgspec.structs.replace(s, az_mps2=min(max(s.az_mps2, G - 0.3), G + 0.3))


def bumped(s: Sample) -> Sample:
    return msgspec.structs.replace(s, az_mps2=s.az_mps2 + 1.0) if isinstance(s, ImuSample) else s


def listing(s: Sample) -> Sample:
    """Port side rises by 5 degrees in five minutes and comes down again: the body is rolled on by so much, and the
    attitude says so.
    """
    if not isinstance(s, ImuSample):
        return s
    angle = radians(5.0) * (1.0 - abs((s.t_s - BEGIN_S) / 300.0 - 1.0))
    c, n = cos(angle), sin(angle)
    return msgspec.structs.replace(
        s,
        ay_mps2=c * s.ay_mps2 + n * s.az_mps2,
        az_mps2=c * s.az_mps2 - n * s.ay_mps2,
        roll_rad=s.roll_rad + angle,
    )


def boat(s: Sample) -> Sample:
    """A boat under the beam, that heaves as it likes."""
    if not isinstance(s, LaserSample):
        return s
    return msgspec.structs.replace(s, laser_m=4.0 + 0.5 * sin(0.9 * s.t_s) + 0.03 * sin(37.0 * s.t_s))


def standing(s: Sample) -> Sample:
    """A laser that looks at a part of the ship, which shakes a little."""
    return msgspec.structs.replace(s, laser_m=12.02 + 1e-3 * sin(1e3 * s.t_s)) if isinstance(s, LaserSample) else s


def nothing(s: Sample) -> None:
    return None


def holed(s: Sample) -> Sample:
    """Three readings lost of every five."""
    lost = isinstance(s, ImuSample) and round(s.t_s * RATE_HZ) % 5 < 3
    return msgspec.structs.replace(s, az_mps2=nan) if lost else s


class Disaster(NamedTuple):
    name: str
    seconds: float
    change: Change
    says: str
    """A reason that must be given while it lasts, numbers left out; "" when nothing need be said."""
    state: HeaveState
    """That the heave must have at some time meanwhile."""
    told_s: float
    """Within that time from its beginning it is told."""
    calm_s: float = 60.0
    """After its end, until the error must be small; 0: all the time."""
    has_laser: bool = False


V, D = HeaveState.VALID, HeaveState.DEGRADED
BAD, S = HeaveState.INVALID, HeaveState.SETTLING
EXTRAPOLATED = ", extrapolated"
CHANGING = "the sea or the sensor is changing"
TILT = "no attitude or no horizontal acceleration: tilt not removed"
DISAGREE = "laser and observer disagree"
DISASTERS = [
    Disaster("nan for 20 s", 20.0, to(ImuSample, az_mps2=nan), "imu: not_finite", BAD, 2.0),
    Disaster("nan for 0.4 s", 0.4, to(ImuSample, az_mps2=nan), "imu: not_finite" + EXTRAPOLATED, D, 0.4, 0.0),
    Disaster("no samples for 10 s", 10.0, nothing, "imu: no samples", BAD, 2.0),
    Disaster("no samples for 90 s", 90.0, nothing, "imu: no samples", BAD, 2.0),
    Disaster("flat for 2 min", 120.0, to(ImuSample, ax_mps2=0.0, ay_mps2=0.0, az_mps2=G), "imu: stuck", BAD, 2.0),
    Disaster("stuck for 2 min", 120.0, to(ImuSample, az_mps2=G + 0.37), "imu: stuck", BAD, 2.0),
    Disaster("zero for 2 min", 120.0, to(ImuSample, az_mps2=0.0), "imu: out_of_range", BAD, 2.0),
    Disaster("clipped for 30 s", 30.0, clipped, "imu: stuck" + EXTRAPOLATED, D, 5.0, 30.0),
    Disaster("a docking bump", 0.5, bumped, "", V, 3.0, 0.0),
    Disaster("a list of 5 degrees", 600.0, listing, "", V, 600.0, 0.0),
    Disaster("no attitude for 30 s", 30.0, to(ImuSample, roll_rad=nan, pitch_rad=nan, yaw_rad=nan), TILT, D, 4.0),
    Disaster("three of five lost", 60.0, holed, "imu: # % of the samples missing", D, 60.0),
    Disaster("laser frozen", 100.0, to(LaserSample, laser_m=12.02), "laser: stuck", V, 5.0, 0.0, True),
    Disaster("laser on the ship", 100.0, standing, DISAGREE, D, 100.0, 0.0, True),
    Disaster("laser on a boat", 20.0, boat, "laser: no fresh reference", V, 5.0, 0.0, True),
    Disaster("laser gone", 20.0, to(LaserSample, laser_m=nan), "laser: no fresh reference", V, 2.0, 0.0, True),
]


@cache
def suffered(name: str) -> tuple[Pipeline, Frames]:
    disaster = next(d for d in DISASTERS if d.name == name)
    pipe = copy.deepcopy(before(disaster.has_laser)[0])
    end_s = BEGIN_S + disaster.seconds
    hit: Change = lambda s: disaster.change(s) if s.t_s < end_s else s  # noqa: E731
    return pipe, run(pipe, BEGIN_S, end_s + disaster.calm_s + 60.0, hit)


@pytest.mark.parametrize("disaster", DISASTERS, ids=lambda d: d.name)
def test_a_disaster_is_told_survived_and_over(disaster: Disaster) -> None:
    pipe, frames = suffered(disaster.name)
    end_s = BEGIN_S + disaster.seconds
    assert not any(isinf(v) for _, frame in frames[::10] for v in numbers(frame))
    for _, frame in frames:
        assert isfinite(frame.heave_m) == isfinite(frame.heave_std_m)
        assert frame.quality.heave is not V or isfinite(frame.heave_m)
    meanwhile = [f.quality.heave for t, f in frames if t < end_s + 10.0]
    assert disaster.state in meanwhile
    told = reasons(frames, BEGIN_S, BEGIN_S + disaster.told_s + 0.1)
    if disaster.says:
        assert disaster.says in told
    else:
        assert told == set()
    calm = errors(frames, BEGIN_S if disaster.calm_s == 0.0 else end_s + disaster.calm_s)
    assert len(calm) > 500
    assert rms(calm) < SURVIVED * sea().sigma_m
    count, share = covered(frames)
    assert count == 0 or share > 0.85
    assert frames[-1][1].quality.heave is not BAD
    # A record that lacks just the highest waves is not fitted; the model stays.
    assert "failed" not in pipe.summary().fitted or disaster.change is clipped


def test_before_the_disaster_it_is_well() -> None:
    for has_laser in (False, True):
        _, frames = before(has_laser)
        assert rms(errors(frames, 60.0)) < 0.03 * sea().sigma_m
        assert covered(frames)[1] > 0.9
        assert {f.quality.heave for _, f in frames} <= {S, V, D}
        assert np.mean([f.quality.heave is V for t, f in frames if t > 60.0]) > 0.85


@pytest.mark.parametrize("name", ["no samples for 10 s", "nan for 20 s"])
def test_afterwards_it_is_valid_again(name: str) -> None:
    _, frames = suffered(name)
    assert V in {f.quality.heave for t, f in frames if t > frames[-1][0] - 60.0}


@pytest.mark.parametrize("name", ["no samples for 90 s", "flat for 2 min"])
def test_a_past_that_is_too_old_is_forgotten_and_counted(name: str) -> None:
    pipe, _ = suffered(name)
    assert pipe.resets == {("heave", "gap"): 1}


# --- a bad beginning -------------------------------------------------------------------------------------------------

BEGINNINGS: dict[str, Change] = {
    "flat": to(ImuSample, ax_mps2=0.0, ay_mps2=0.0, az_mps2=G, roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0),
    "stuck": to(ImuSample, ax_mps2=0.1, ay_mps2=-0.2, az_mps2=G - 0.4, roll_rad=0.02, pitch_rad=0.01),
    "zero": to(ImuSample, ax_mps2=0.0, ay_mps2=0.0, az_mps2=0.0, roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0),
    "nan": to(ImuSample, ax_mps2=nan, ay_mps2=nan, az_mps2=nan, roll_rad=nan, pitch_rad=nan, yaw_rad=nan),
}


@pytest.mark.parametrize("name", BEGINNINGS)
def test_two_minutes_of_nothing_are_forgotten_within_a_minute_of_a_live_sea(name: str) -> None:
    pipe = built(has_laser=False)
    dead: Change = lambda s: BEGINNINGS[name](s) if s.t_s < 120.0 else s  # noqa: E731
    frames = run(pipe, 0.0, 270.0, dead)
    assert not any(isinf(v) for _, frame in frames[::10] for v in numbers(frame))
    for t, frame in frames:
        assert t > 125.0 or frame.quality.heave in (BAD, S)
    said = reasons(frames, 10.0, 119.0)
    assert any(reason.startswith("imu: ") for reason in said)
    assert rms(errors(frames, 180.0)) < SURVIVED * sea().sigma_m
    assert isfinite(frames[-1][1].heave_m)
    count, share = covered(frames, 180.0)
    assert count == 0 or share > 0.85


# --- the rest of what can be said ------------------------------------------------------------------------------------


def fed(acceleration: Callable[[float], float], seconds: float) -> Frames:
    """A level vessel that heaves as it is told."""
    pipe = built(has_laser=False)
    noise = 2.2e-3 * np.random.default_rng(7).standard_normal(round(seconds * RATE_HZ))
    frames = []
    for i, n in enumerate(noise.tolist()):
        t = i / RATE_HZ
        frame = pipe.step(
            ImuSample(
                t_s=t,
                ax_mps2=0.0,
                ay_mps2=0.0,
                az_mps2=G + acceleration(t) + n,
                roll_rad=0.0,
                pitch_rad=0.0,
                yaw_rad=0.0,
            )
        )
        if (past := pipe.fit_due()) is not None:
            pipe.accept_fit(look(past))
        assert frame is not None
        frames.append((t, frame))
    return frames


@cache
def still() -> Frames:
    return fed(lambda t: 0.01, 150.0)


@cache
def endless_swell() -> Frames:
    """A fit that finds its peak at 33 s."""
    pipe, frames = copy.deepcopy(before(False)[0]), []
    for sample in sea().samples:
        if not BEGIN_S <= sample.t_s < BEGIN_S + 45.0:
            continue
        frame = pipe.step(sample)
        if (past := pipe.fit_due()) is not None:
            fit = look(past)
            assert fit.sea is not None
            slow = msgspec.structs.replace(fit.sea, peak_period_s=33.0)
            pipe.accept_fit(msgspec.structs.replace(fit, sea=slow))
        if frame is not None:
            frames.append((sample.t_s, frame))
    return frames


def test_a_still_ship_is_valid_and_says_still() -> None:
    frames = still()
    assert np.mean([f.quality.heave is V for t, f in frames if t > 60.0]) > 0.7
    assert any(reason.startswith("still") for reason in frames[-1][1].quality.reasons)
    assert rms(np.array([f.heave_m for t, f in frames if t > 60.0])) < 0.005


def test_waves_longer_than_the_sensor_can_follow_are_named() -> None:
    assert "swell of # s: longer than the sensor can follow" in reasons(endless_swell())
    assert endless_swell()[-1][1].quality.heave is D


def test_every_state_and_every_reason_has_its_scenario() -> None:
    frames = [frame for name in (d.name for d in DISASTERS) for frame in suffered(name)[1]]
    frames += before(False)[1] + before(True)[1] + still() + endless_swell()
    assert {f.quality.heave for _, f in frames} == set(HeaveState)
    assert reasons(frames) >= {
        "settling: # s of # s",
        "imu: no samples",
        "imu: samples missing, extrapolated",
        "imu: not_finite",
        "imu: stuck",
        "imu: out_of_range, extrapolated",
        "imu: # % of the samples missing",
        "no attitude or no horizontal acceleration: tilt not removed",
        "recovering from a gap",
        "the sea or the sensor is changing",
        "swell of # s: longer than the sensor can follow",
        "error above a fifth of the heave",
        "laser and observer disagree",
        "laser: no fresh reference",
        "still: no motion above the noise of the sensor",
    }


# --- attitude --------------------------------------------------------------------------------------------------------


def test_the_attitude_is_taken_from_when_the_accelerometers_measured() -> None:
    """Accelerometers that are 0.2 s late, as the laser has shown: a lag of the heave, but none between force and
    attitude. With the attitude of now, gravity is removed for another moment.
    """
    late_s = 0.2
    shift = round(late_s * RATE_HZ)
    imu = [s for s in sea().samples if isinstance(s, ImuSample) and s.t_s < 300.0]
    pipe = built(has_laser=False)
    pipe.restore(SavedState(lead_learned_s=-late_s))
    frames = []
    for then, now in zip(imu, imu[shift:], strict=False):
        force = {axis: getattr(then, axis) for axis in ("ax_mps2", "ay_mps2", "az_mps2")}
        frame = pipe.step(msgspec.structs.replace(now, **force))
        if (past := pipe.fit_due()) is not None:
            pipe.accept_fit(look(past))
        assert frame is not None
        frames.append((now.t_s, frame))
    assert rms(errors(frames, 150.0)) < 0.03 * sea().sigma_m
