"""A crane at work on a vessel at sea, through the whole pipeline: its tip and its hook against the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest
from cranes import PARAMS, height, heights, with_crane
from pipelines import run, sea

from heaved.config import Config
from heaved.devices.recording import Recording as File
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, reference
from heaved.estimation.lever_arm import Point
from heaved.estimation.rock import params as rock
from heaved.estimation.stages import Stages
from heaved.pipeline import Pipeline, assemble
from heaved.replay.replay import replay
from heaved.samples import CraneSample, Fault, HeaveState, ImuSample, MotionFrame, PointMotion, Sample
from heaved.simulate.crane import CraneAtWork, CraneModel, CraneSensors
from heaved.simulate.play import write_recording
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import record

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from heaved.simulate.sensors import Recording

Array = np.ndarray
POINTS = (Point(name="tip", frame="boom"), Point(name="hook", frame="hook"))
RATE_HZ = 20.0
FROM_S = 90.0
"""The observer has settled, and the predictor learned."""
AT_WORK = CraneAtWork(seed=3)


def pipeline(*, has_crane: bool = True, lead_s: float = 0.0, point: tuple[Point, ...] = POINTS) -> Pipeline:
    return assemble(
        heave=heave.Params(),
        laser=reference.Params(),
        correction=correction.Params(),
        rock=rock.Params(),
        has_laser=False,
        point=point,
        lead_s=lead_s,
        stages=Stages(None, None, PARAMS) if has_crane else None,
    )


@pytest.fixture(scope="module")
def recording() -> Recording:
    return sea("S6", 240.0, rate_hz=RATE_HZ, seed=3, laser="off")


def imu_samples(recording: Recording) -> list[Sample]:
    return list(recording.samples())


@pytest.fixture(scope="module")
def frames(recording: Recording) -> list[MotionFrame]:
    return run(pipeline(), with_crane(imu_samples(recording), AT_WORK, seed=3))


def of(frames: Iterable[MotionFrame], name: str, place: int) -> Array:
    return np.array([getattr(frame.points[place], name) for frame in frames])


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize(("place", "hook"), [(0, False), (1, True)])
def test_tip_and_hook_heave_as_they_say_within_their_deviation(
    recording: Recording, frames: list[MotionFrame], place: int, hook: bool
) -> None:
    late = recording.t_s > FROM_S
    heave_m, own_m = (column[late] for column in heights(recording, AT_WORK, hook=hook))
    errors = of(frames, "heave_m", place)[late] - heave_m
    stds = of(frames, "heave_std_m", place)[late]
    assert rms(errors) < 0.02 * rms(heave_m)
    # Errors of waves last for periods: 150 s hold some 40 independent ones, whose chi-square is within a factor of two.
    # What the attitude may lean is counted in full, so they are rather smaller.
    assert 0.2 < np.mean((errors / stds) ** 2) < 1.6
    assert np.mean(np.abs(errors) < 2.0 * stds) > 0.9
    assert {frame.points[place].state for frame in frames[int(RATE_HZ * FROM_S) :]} == {None}
    assert rms(of(frames, "own_height_m", place)[late] - own_m) < 0.05
    assert np.std(own_m) > 1.0, "it has been at work"


@pytest.mark.parametrize(("place", "hook"), [(0, False), (1, True)])
def test_velocities_and_acceleration_are_the_derivatives(
    recording: Recording, frames: list[MotionFrame], place: int, hook: bool
) -> None:
    late = recording.t_s > FROM_S
    heave_m, own_m = heights(recording, AT_WORK, hook=hook)
    velocity, own = np.gradient(heave_m, recording.t_s), np.gradient(own_m, recording.t_s)
    acceleration = np.gradient(velocity, recording.t_s)[late]
    assert rms(of(frames, "heave_velocity_mps", place)[late] - velocity[late]) < 0.02 * rms(velocity[late])
    assert rms(of(frames, "own_velocity_mps", place)[late] - own[late]) < 0.04
    assert rms(of(frames, "heave_acceleration_mps2", place)[late] - acceleration) < 0.12 * rms(acceleration)


def test_the_velocity_with_the_ship_does_not_hold_that_of_the_crane(
    recording: Recording, frames: list[MotionFrame]
) -> None:
    """While only the winch runs the hook's heave is the tip's, whatever the winch does."""
    hoisted = of(frames, "own_velocity_mps", 1) - of(frames, "own_velocity_mps", 0)
    fast = np.abs(hoisted) > 0.2
    assert np.count_nonzero(fast) > 200
    assert np.array_equal(of(frames, "heave_m", 0)[fast], of(frames, "heave_m", 1)[fast])
    assert np.array_equal(of(frames, "heave_velocity_mps", 0)[fast], of(frames, "heave_velocity_mps", 1)[fast])


@pytest.mark.parametrize(("number", "horizon_s"), [(0, 0.05), (3, 0.5), (4, 1.0), (5, 2.0), (6, 5.0)])
def test_forecasts_cover_what_comes(
    recording: Recording, frames: list[MotionFrame], number: int, horizon_s: float
) -> None:
    heave_m, _ = heights(recording, AT_WORK, hook=False)
    ahead = round(horizon_s * RATE_HZ)
    start = int(FROM_S * RATE_HZ)
    forecasts = [frame.points[0].forecast[number] for frame in frames[start : len(frames) - ahead]]
    assert {one.horizon_s for one in forecasts} == {horizon_s}
    off = np.array([one.heave_m for one in forecasts]) - heave_m[start + ahead :]
    stds = np.array([one.std_m for one in forecasts])
    assert np.mean(np.abs(off) < 2.0 * stds) > 0.9
    assert rms(off) < 0.02 * rms(heave_m) + 0.25 * horizon_s


def test_a_parked_crane_has_no_motion_of_its_own(recording: Recording) -> None:
    parked = CraneAtWork(CraneModel(is_parked=True), seed=3)
    samples = [sample for sample in imu_samples(recording) if sample.t_s < 60.0]
    made = run(pipeline(), with_crane(samples, parked, seed=3))
    assert np.max(np.abs(of(made[200:], "own_velocity_mps", 0))) < 1e-6


def test_the_heave_of_the_imu_is_the_same_to_the_bit_with_and_without_a_crane(
    recording: Recording, frames: list[MotionFrame]
) -> None:
    alone = run(pipeline(has_crane=False, point=()), imu_samples(recording))
    for one, other in zip(frames, alone, strict=True):
        stripped = msgspec.structs.replace(one, points=())
        # nan is not equal to itself: what is written of it is.
        assert msgspec.json.encode(msgspec.to_builtins(stripped, enc_hook=list)) == msgspec.json.encode(
            msgspec.to_builtins(other, enc_hook=list)
        )


def test_with_a_lead_the_frame_tells_of_now_too(recording: Recording, frames: list[MotionFrame]) -> None:
    samples = [sample for sample in with_crane(imu_samples(recording), AT_WORK, seed=3) if sample.t_s < 150.0]
    led = run(pipeline(lead_s=0.5), samples)
    heave_m, _ = heights(recording, AT_WORK, hook=False)
    start, later = int(FROM_S * RATE_HZ), round(0.5 * RATE_HZ)
    for i in range(start, len(led) - later):
        now = led[i].now
        assert now is not None
        assert (now.heave_m, now.heave_velocity_mps) == (frames[i].heave_m, frames[i].heave_velocity_mps)
        assert now.heave_std_m == pytest.approx(frames[i].heave_std_m)
        assert now.points[0].heave_m == pytest.approx(frames[i].points[0].heave_m, abs=1e-9)
        point = led[i].points[0]
        assert abs(point.heave_m - heave_m[i + later]) < 5.0 * point.heave_std_m
    assert frames[start].now is None


# ---- rates and horizontal accelerations ------------------------------------------------------------------------------


def test_rates_and_horizontal_accelerations_are_those_of_the_ship(
    recording: Recording, frames: list[MotionFrame]
) -> None:
    late, truth = recording.t_s > FROM_S, recording.truth
    for name, bound in (
        ("roll_rate_radps", 0.01),
        ("pitch_rate_radps", 0.02),
        ("yaw_rate_radps", 0.15),
        ("surge_acceleration_mps2", 0.15),
        ("sway_acceleration_mps2", 0.25),
    ):
        found = np.array([getattr(frame, name) for frame in frames])[late]
        true = np.asarray(getattr(truth, name))[late]
        assert rms(found - true - np.mean(found - true)) < bound * rms(true), name


def test_without_a_sample_only_what_is_predicted_is_known(recording: Recording) -> None:
    made = pipeline()
    frames = run(made, [sample for sample in imu_samples(recording) if sample.t_s < 80.0])
    coasted = made.coast(frames[-1].t_s + 0.05)
    assert np.isnan(coasted.surge_acceleration_mps2)
    assert np.isnan(coasted.points[0].heave_acceleration_mps2)
    assert coasted.roll_rate_radps == pytest.approx(frames[-1].roll_rate_radps, abs=0.02)


# ---- disasters -------------------------------------------------------------------------------------------------------


def every(n: int, change: Callable[[CraneSample], CraneSample | None]) -> Callable[[CraneSample], CraneSample | None]:
    return lambda sample: change(sample) if round(10 * sample.t_s) % n == 0 else sample


def between(
    start_s: float, end_s: float, change: Callable[[CraneSample], CraneSample | None]
) -> Callable[[CraneSample], CraneSample | None]:
    return lambda sample: change(sample) if start_s <= sample.t_s < end_s else sample


def put(**values: float) -> Callable[[CraneSample], CraneSample]:
    return lambda sample: msgspec.structs.replace(sample, **values)


def lost(sample: CraneSample) -> CraneSample:
    return CraneSample(t_s=sample.t_s, fault=Fault.DISCONNECTED)


def wrapped(sample: CraneSample) -> CraneSample:
    return msgspec.structs.replace(sample, slew_rad=(sample.slew_rad + np.pi) % (2 * np.pi) - np.pi)


DISASTERS: dict[str, tuple[Callable[[CraneSample], CraneSample | None], float, set[HeaveState | None]]] = {
    "as it is": (lambda sample: sample, 10.0, {None}),
    "5 readings a second": (lambda sample: sample, 5.0, {None}),
    "20 a second": (lambda sample: sample, 20.0, {None}),
    "spikes": (every(6, put(slew_rad=2.0, boom_rad=-0.5)), 10.0, {None}),
    "slew from -180 to 180": (wrapped, 10.0, {None}),
    "half of the readings lost": (every(2, lambda sample: None), 10.0, {None}),
    "the line of the device torn for 3 s": (between(100.0, 103.0, lost), 10.0, {None, HeaveState.DEGRADED}),
    "lost and back": (between(100.0, 120.0, lost), 10.0, {None, HeaveState.DEGRADED, HeaveState.INVALID}),
    "no jib for a while": (
        between(100.0, 110.0, put(jib_rad=np.nan)), 10.0, {None, HeaveState.DEGRADED, HeaveState.INVALID}
    ),
    "no jib at all": (put(jib_rad=np.nan), 10.0, {HeaveState.INVALID}),
}  # fmt: skip


@pytest.mark.parametrize("name", DISASTERS)
def test_whatever_befalls_the_encoders_no_point_is_off_by_more_than_it_says(recording: Recording, name: str) -> None:
    as_read, rate_hz, states = DISASTERS[name]
    samples = [sample for sample in imu_samples(recording) if sample.t_s < 135.0]
    made = run(pipeline(point=POINTS[:1]), with_crane(samples, AT_WORK, rate_hz=rate_hz, seed=3, as_read=as_read))
    heave_m, _ = heights(recording, AT_WORK, hook=False)
    start = int(FROM_S * RATE_HZ)
    points: list[PointMotion] = [frame.points[0] for frame in made[start:]]
    assert {point.state for point in points} == states
    for point, true_m in zip(points, heave_m[start:].tolist(), strict=False):
        if point.state is HeaveState.INVALID:
            assert np.isnan(point.heave_m)
            assert point.reasons
        else:
            assert abs(point.heave_m - true_m) < 4.0 * point.heave_std_m
            assert (point.state is None) is (point.reasons == ())
    if HeaveState.INVALID not in states or None in states:
        assert points[-1].state is None, "it comes back"


def test_frames_with_no_attitude_have_no_heave_of_the_tip(recording: Recording) -> None:
    blind = [
        msgspec.structs.replace(
            sample, roll_rad=np.nan, pitch_rad=np.nan, gx_radps=np.nan, gy_radps=np.nan, gz_radps=np.nan
        )
        if isinstance(sample, ImuSample)
        else sample
        for sample in imu_samples(recording)
        if sample.t_s < 60.0
    ]
    made = run(pipeline(), with_crane(blind, AT_WORK, seed=3))
    assert np.all(np.isnan(of(made, "heave_m", 0)))
    assert np.isfinite(of(made, "own_height_m", 0)[100:]).all()
    assert np.isnan(made[-1].roll_rate_radps)


def test_a_fast_imu_and_a_slow_encoder(recording: Recording) -> None:
    """100 Hz and 5 Hz: between two readings the tip moves on smoothly, no step is seen in its velocity."""
    fast = sea("S4", 60.0, rate_hz=100.0, seed=3, laser="off")
    made = run(pipeline(), with_crane(list(fast.samples()), AT_WORK, rate_hz=5.0, seed=3))[4500:]
    own = of(made, "own_height_m", 0)
    assert np.max(np.abs(np.diff(own))) < 0.05
    assert np.max(np.abs(np.diff(of(made, "own_velocity_mps", 0)))) < 0.1


# ---- an attitude that leans ------------------------------------------------------------------------------------------


def test_what_an_attitude_sensor_leans_and_is_late_is_taken_out_of_the_tip() -> None:
    """A complementary filter of 8 s, 40 ms late: half a degree in sea S6, which is 40 cm at the end of a boom."""
    made = record(seaway("S6", 1), 300.0, imu_rate_hz=RATE_HZ, sensor="AHRS", laser="off", seed=1)
    frames = run(pipeline(point=POINTS[:1]), with_crane(list(made.samples()), AT_WORK, seed=3))
    late = made.t_s > 150.0
    heave_m, own_m = heights(made, AT_WORK, hook=False)
    as_measured = [
        frame.heave_m + height(AT_WORK.at(frame.t_s).at, frame.roll_rad, frame.pitch_rad, hook=False) - own
        for frame, own in zip(frames, own_m.tolist(), strict=True)
    ]
    leaning = rms(np.array(as_measured)[late] - heave_m[late])
    errors = of(frames, "heave_m", 0)[late] - heave_m[late]
    assert leaning > 0.25
    assert rms(errors) < 0.35 * leaning
    assert np.mean(np.abs(errors) < 2.0 * of(frames, "heave_std_m", 0)[late]) > 0.85
    acceleration = np.gradient(np.gradient(heave_m, made.t_s), made.t_s)[late]
    assert rms(of(frames, "heave_acceleration_mps2", 0)[late] - acceleration) < 0.2 * rms(acceleration)
    later = round(0.5 * RATE_HZ)
    ahead = [frame.points[0].forecast[3] for frame in frames if frame.t_s > 150.0]
    foretold = np.array([(one.heave_m, one.std_m) for one in ahead])[:-later]
    off = foretold[:, 0] - heave_m[late][later:]
    assert rms(off) < 0.4 * leaning
    assert np.mean(np.abs(off) < 2.0 * foretold[:, 1]) > 0.85


# ---- a recording -----------------------------------------------------------------------------------------------------


def test_a_cranes_record_replays_and_the_heave_knows_nothing_of_it(recording: Recording, tmp_path: Path) -> None:
    plain, crane = tmp_path / "plain.csv", tmp_path / "crane.csv"
    write_recording(plain, recording)
    sensors = CraneSensors(AT_WORK, seed=3)
    header, *rows = plain.read_text().splitlines()
    with crane.open("w") as file:
        file.write(f"{header},slew_deg,boom_deg,jib_deg,line_out_m\n")
        for number, row in enumerate(rows[:1400]):
            read = sensors.read(recording.t_s[number].item())
            angles = ",".join(f"{np.degrees(angle):.1f}" for angle in (read.slew_rad, read.boom_rad, read.jib_rad))
            cells = f"{angles},{read.line_out_m:.2f}" if number % 2 == 0 else ",,,"
            file.write(f"{row},{cells}\n")
    with File(crane) as file_of:
        made = run(pipeline(), [one for row in file_of.instants() for one in reversed(row) if one is not None])
    heave_m, _ = heights(recording, AT_WORK, hook=False)
    tip = made[-1].points[0]
    assert abs(tip.heave_m - heave_m[1399]) < 4.0 * tip.heave_std_m
    with_points = Config(crane=PARAMS, point=POINTS)
    replay(crane, tmp_path / "a.csv", with_points)
    replay(plain, tmp_path / "b.csv", Config(), until_s=1399 / RATE_HZ + 0.01)
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
