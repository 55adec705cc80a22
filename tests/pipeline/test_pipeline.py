"""The whole block diagram on short recordings whose truth is known."""

import copy
import subprocess
import sys
from collections import deque
from collections.abc import Mapping, Sequence, Set
from math import inf, isfinite, isinf, isnan, nan
from typing import Literal

import msgspec
import numpy as np
import pytest
from pipelines import column, imu_only, laser_only, numbers, pipeline, rms, run, sea
from scipy.spatial.transform import Rotation

from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction
from heaved.estimation.heave.laser.network import Network, Output
from heaved.estimation.heave.saved_state import SavedState
from heaved.estimation.heave.sea.refit import SeaFit, look
from heaved.estimation.lever_arm import Point
from heaved.outputs import wire
from heaved.outputs.records import SeaRecord
from heaved.pipeline import Pipeline
from heaved.samples import (
    CorrectionState,
    DelayedHeave,
    Fault,
    HeaveState,
    ImuSample,
    LaserSample,
    LaserState,
    MotionFrame,
    Sample,
    TrainedNetwork,
)
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import Recording, record

Observer = Literal["harmonic", "sea"]
SMALL = correction.Params(taps=10, hidden=1, window_s=60.0, min_laser_s=20.0, period_s=10.0)
TILT = "no attitude or no horizontal acceleration: tilt not removed"


@pytest.fixture(scope="module")
def short() -> Recording:
    return sea("T2", 70.0)


@pytest.fixture(scope="module")
def longer() -> Recording:
    return sea("T2", 122.0)


@pytest.fixture(scope="module")
def at_61_s(short: Recording) -> tuple[Pipeline, list[Sample]]:
    """A pipeline that has seen 61 seconds (take a copy), and the samples from there on."""
    pipe = pipeline()
    run(pipe, (s for s in short.samples() if s.t_s < 61.0))
    return pipe, [s for s in short.samples() if s.t_s >= 61.0]


def bytes_of(frames: list[MotionFrame]) -> bytes:
    return msgspec.json.encode(frames, enc_hook=list)


def changed(sample: Sample, **values: object) -> Sample:
    return msgspec.structs.replace(sample, **values)


def gain_network(number: int, gain: float, taps: int = 10) -> TrainedNetwork:
    """Correction = gain * observer output."""
    W1 = np.zeros((1, taps))
    W1[0, -1] = 1e-3
    network = Network(
        W1=W1, b1=np.zeros(1), w2=np.array([4e3 * gain]), b2=2e3 * gain, input_mean_m=0.0, input_std_m=1.0,
        target_mean_m=0.0, target_std_m=1.0, output=Output.LINEAR,
    )  # fmt: skip
    return TrainedNetwork(number=number, weights=network.to_bytes(), width=taps, hidden=1)


# --- the first frames ------------------------------------------------------------------------------------------------


def test_before_any_sample_a_frame_says_so() -> None:
    frame = pipeline().coast(12.0)
    assert frame.quality.heave is HeaveState.INVALID
    assert frame.quality.reasons == ("imu: no samples", "laser: no fresh reference")
    assert all(isnan(v) for v in (frame.heave_m, frame.heave_std_m, frame.roll_rad, frame.lead_s))
    assert [rock.horizon_s for rock in frame.rock][:3] == [0.05, 0.10, 0.15]


@pytest.mark.parametrize(("observer", "first_s", "needed_s"), [("harmonic", 15.0, 30.0), ("sea", 40.0, 60.0)])
def test_the_first_frames_have_attitude_and_no_heave_and_then_both(
    short: Recording, observer: Observer, first_s: float, needed_s: float
) -> None:
    frames = run(pipeline(with_rock=True, heave_params=heave.Params(observer=observer)), short.samples())
    assert len(frames) == len(short.t_s)
    first = frames[0]
    assert (first.roll_rad, first.pitch_rad, first.yaw_rad) == (short.roll_rad[0], short.pitch_rad[0], short.yaw_rad[0])
    assert isnan(first.heave_m)
    assert first.quality.heave is HeaveState.SETTLING
    assert first.quality.reasons[0] == f"settling: 0 s of {needed_s:.0f} s"
    states = [frame.quality.heave for frame in frames]
    since = next(frame.t_s for frame in frames if isfinite(frame.heave_m))
    assert since == pytest.approx(first_s, abs=0.1)
    valid = states.index(HeaveState.VALID)
    assert needed_s <= frames[valid].t_s < needed_s + 6.0
    assert {f.quality.heave for f in frames if f.t_s < needed_s - 0.1} == {HeaveState.SETTLING}
    # No number without its deviation, and the other way round.
    assert all(isfinite(f.heave_m) == isfinite(f.heave_std_m) == isfinite(f.observer_m) for f in frames)
    assert not any(isinf(v) for frame in frames for v in numbers(frame))
    assert len(frames[-1].rock) == 7
    assert isfinite(frames[-1].rock[2].roll_rad)
    assert len(frames[-1].forecast) == 7


def test_heave_is_observer_plus_correction_and_follows_the_truth(longer: Recording) -> None:
    frames = run(pipeline(heave_params=heave.Params()), longer.samples())
    late = longer.t_s > 80.0
    published, velocity = column(frames, "heave_m")[late], column(frames, "heave_velocity_mps")[late]
    assert published == pytest.approx((column(frames, "observer_m") + column(frames, "correction_m"))[late])
    assert rms(published - longer.truth.heave_m[late]) < 0.004
    assert rms(velocity - longer.truth.heave_velocity_mps[late]) < 0.008
    assert rms(column(frames, "heave_acceleration_mps2")[late] - longer.truth.heave_acceleration_mps2[late]) < 0.008
    assert rms(column(frames, "reference_m")[late] - longer.truth.heave_m[late]) < 0.004
    # Forecasts hold what will be, for the moment they name.
    for k, horizon in enumerate((0.05, 0.1, 0.15, 0.5, 1.0)):
        ahead = round(20.0 * horizon)
        forecast = np.array([f.forecast[k].heave_m for f in frames[1600:-ahead]])
        assert frames[0].forecast == ()
        assert frames[-1].forecast[k].horizon_s == horizon
        error = forecast - longer.truth.heave_m[1600 + ahead :]
        assert rms(error) < 0.003 + 0.006 * horizon
        assert np.mean(np.abs(error) < 1.96 * np.array([f.forecast[k].std_m for f in frames[1600:-ahead]])) > 0.9


# --- attitude --------------------------------------------------------------------------------------------------------


def without(sample: Sample, names: str) -> Sample:
    return changed(sample, **dict.fromkeys(names.split(), nan)) if isinstance(sample, ImuSample) else sample


@pytest.mark.parametrize("names", ["roll_rad pitch_rad yaw_rad", "pitch_rad", "ax_mps2 ay_mps2", "ay_mps2"])
def test_without_tilt_the_heave_goes_on_and_says_so(longer: Recording, names: str) -> None:
    frames = run(pipeline(), (without(s, names) for s in longer.samples()))
    last = frames[-1]
    assert last.quality.heave is HeaveState.DEGRADED
    assert TILT in last.quality.reasons
    late = longer.t_s > 80.0
    assert rms(column(frames, "heave_m")[late] - longer.truth.heave_m[late]) < 0.5 * np.std(longer.truth.heave_m)
    assert isnan(last.roll_rad) == ("pitch_rad" in names)


@pytest.mark.parametrize("has_rates", [True, False])
def test_an_outage_of_the_attitude_is_carried_with_the_rates_or_on_a_line(short: Recording, has_rates: bool) -> None:
    """Oracle: the true angles. No reading is held: a line serves while the motion is straight, rates for two seconds,
    and what is known no better than that is not published.
    """
    outages = ((50.0, 50.3), (55.0, 57.8))
    names = "roll_rad pitch_rad yaw_rad"

    def spoiled(sample: Sample) -> Sample:
        if not has_rates:
            sample = without(sample, "gx_radps gy_radps gz_radps")
        return without(sample, names) if any(start <= sample.t_s < end for start, end in outages) else sample

    frames = run(pipeline(), (spoiled(s) for s in short.samples()))
    whole = run(pipeline(), short.samples())
    roll, t = column(frames, "roll_rad"), short.t_s
    off = np.degrees(np.abs(roll - short.truth.roll_rad))
    assert np.isfinite(roll[(t >= 50.0) & (t < 50.3)]).all()
    assert np.nanmax(off[(t >= 50.0) & (t < 58.0)]) < (0.2 if has_rates else 0.5)
    gone = t[(t >= 55.0) & (t < 57.8) & np.isnan(roll)]
    assert gone[0] == pytest.approx(56.95 if has_rates else 55.4, abs=0.15)
    assert gone[-1] == pytest.approx(57.75, abs=0.06)
    flagged = [f.t_s for f in frames if TILT in f.quality.reasons]
    assert min(flagged) == pytest.approx(57.5 if has_rates else 55.5, abs=0.11)
    assert max(flagged) < 57.8
    assert frames[-1].quality.heave is HeaveState.VALID
    error = column(frames, "heave_m")[1000:] - column(whole, "heave_m")[1000:]
    assert np.abs(error).max() < 0.02


# --- points, and a stream that is ahead of time ---------------------------------------------------------------------


def test_points_move_with_the_heave_and_the_attitude(longer: Recording) -> None:
    """Oracle: scipy's rotations, from body to level axes; pitch is bow up, the other way round than about y."""
    lever = np.array([40.0, -8.0, 30.0])
    tip, here = Point(name="tip", forward_m=40.0, port_m=-8.0, up_m=30.0), Point(name="imu")
    frames = run(
        pipeline(heave_params=heave.Params(), has_laser=False, with_rock=True, point=(tip, here)), longer.samples()
    )
    late = longer.t_s > 80.0
    assert {tuple(point.name for point in frame.points) for frame in frames} == {("tip", "imu")}
    moved = np.array([[p.heave_m for p in f.points] + [p.heave_velocity_mps for p in f.points] for f in frames]).T

    def lift(roll_rad: np.ndarray, pitch_rad: np.ndarray) -> np.ndarray:
        angles = np.stack([np.zeros(len(roll_rad)), -pitch_rad, roll_rad], axis=1)
        return np.asarray(Rotation.from_euler("ZYX", angles).apply(lever)[:, 2] - lever[2])

    own, own_velocity = column(frames, "heave_m"), column(frames, "heave_velocity_mps")
    lifted = lift(column(frames, "roll_rad"), column(frames, "pitch_rad"))
    assert moved[0][late] == pytest.approx((own + lifted)[late], abs=1e-9)
    assert moved[1][late] == pytest.approx(own[late], abs=1e-12)
    assert moved[3][late] == pytest.approx(own_velocity[late], abs=1e-12)
    # The velocity of the lever arm is that of the true one, to what the rates of the attitude are known.
    true_rate = np.gradient(lift(longer.truth.roll_rad, longer.truth.pitch_rad), longer.t_s)[late]
    assert rms((moved[2] - own_velocity)[late] - true_rate) < 0.3 * rms(true_rate)
    assert all(isnan(value) for value in moved[:, 0])


@pytest.mark.parametrize("observer", ["harmonic", "sea"])
def test_a_lead_for_the_consumer_publishes_what_was_the_forecast(longer: Recording, observer: Observer) -> None:
    params = heave.Params(observer=observer, forecast_horizons_s=(0.5, 2.0))
    usual, ahead = (
        run(pipeline(heave_params=params, has_laser=False, lead_s=lead_s), longer.samples()) for lead_s in (0.0, 0.5)
    )
    assert {frame.compensation_lead_s for frame in usual} == {0.0}
    assert {frame.compensation_lead_s for frame in ahead} == {0.5}
    for before, after in zip(usual[1500:], ahead[1500:], strict=True):
        assert after.heave_m == pytest.approx(before.forecast[0].heave_m, abs=1e-4)
        assert after.heave_std_m == pytest.approx(before.forecast[0].std_m, rel=0.02)
    error = column(ahead[1500:-10], "heave_m") - longer.truth.heave_m[1510:]
    assert rms(error) < 0.25 * np.std(longer.truth.heave_m)


# --- faults and order of the IMU -------------------------------------------------------------------------------------


@pytest.mark.parametrize("fault", [fault for fault in Fault if fault is not Fault.NONE])
def test_a_faulted_sample_is_a_frame_without_its_values(at_61_s: tuple[Pipeline, list[Sample]], fault: Fault) -> None:
    """Whatever it carries: the estimate goes on as if the sample had not come, and the frame says what is wrong."""
    hit, missed = copy.deepcopy(at_61_s[0]), copy.deepcopy(at_61_s[0])
    for sample in at_61_s[1]:
        if isinstance(sample, ImuSample) and sample.t_s < 61.5:
            frame = hit.step(ImuSample(t_s=sample.t_s, az_mps2=1e6, roll_rad=3.0, pitch_rad=1.0, fault=fault))
            coasted = missed.coast(sample.t_s)
            assert frame is not None
            assert frame.heave_m == coasted.heave_m
            assert frame.heave_std_m == pytest.approx(coasted.heave_std_m, rel=1e-3)
            if sample.t_s > 61.11:
                assert frame.quality.heave is HeaveState.DEGRADED
                assert f"imu: {fault.value}, extrapolated" in frame.quality.reasons
        else:
            frame, other = hit.step(sample), missed.step(sample)
            if frame is not None and other is not None:
                assert frame.heave_m == other.heave_m or isnan(frame.heave_m)
    assert frame is None or frame.quality.heave is HeaveState.VALID


@pytest.mark.parametrize(
    ("az", "word"), [(nan, "not_finite"), (inf, "not_finite"), (0.0, "out_of_range"), (156.0, "out_of_range")]
)
def test_values_that_cannot_be_are_withheld_and_named(
    at_61_s: tuple[Pipeline, list[Sample]], short: Recording, az: float, word: str
) -> None:
    def bad(s: Sample) -> Sample:
        return changed(s, az_mps2=az) if isinstance(s, ImuSample) and s.t_s < 64.0 else s

    frames = run(copy.deepcopy(at_61_s[0]), map(bad, at_61_s[1]))
    during = [f for f in frames if 61.2 <= f.t_s < 64.0]
    assert all(any(r.startswith(f"imu: {word}") for r in f.quality.reasons) for f in during)
    assert {f.quality.heave for f in during if f.t_s > 62.1} == {HeaveState.INVALID}
    assert all(isnan(f.heave_m) for f in during if f.t_s > 62.1)
    assert rms(column(frames[-20:], "heave_m") - short.truth.heave_m[-20:]) < 0.02


def test_a_sample_older_than_the_last_is_counted_and_changes_nothing(short: Recording) -> None:
    pipe, clean = pipeline(), pipeline()
    imu = imu_only(short.samples())[:900]
    for k, sample in enumerate(imu):
        frame = pipe.step(sample)
        assert bytes_of([frame]) == bytes_of([clean.step(sample)])  # type: ignore[list-item]
        if k in (10, 500, 800):
            assert pipe.step(imu[k - 3]) is None
            assert pipe.step(sample) is None
    assert pipe.summary().out_of_order == 6
    assert clean.summary().out_of_order == 0


def test_jitter_is_not_taken_for_lost_samples(longer: Recording) -> None:
    """Polls of a busy machine, up to 0.4 of an interval early or late."""
    rng = np.random.default_rng(9)
    jittered = [changed(s, t_s=s.t_s + 0.02 * rng.uniform(-1.0, 1.0)) for s in imu_only(longer.samples())]
    frames = run(pipeline(has_laser=False), jittered)
    assert not [f for f in frames if any("missing" in reason for reason in f.quality.reasons)]
    assert frames[-1].quality.heave is HeaveState.VALID


# --- coasting --------------------------------------------------------------------------------------------------------


def test_without_samples_frames_go_on_and_lose_their_standing(short: Recording) -> None:
    pipe = pipeline()
    run(pipe, short.samples())
    end = float(short.t_s[-1])
    frames = [pipe.coast(end + 0.05 * k) for k in range(1, 60)]
    for frame in frames:
        age = frame.t_s - end
        expected = HeaveState.VALID if age < 0.101 else HeaveState.DEGRADED if age < 1.001 else HeaveState.INVALID
        assert frame.quality.heave is expected, age
        assert isfinite(frame.heave_m) == (age < 1.001)
        assert isnan(frame.heave_acceleration_mps2)
        if age < 0.3 or age > 0.5:  # on a line, which a motion of so little angle follows for a while
            assert isfinite(frame.roll_rad) == (age < 0.5)
        if abs(age - 0.5) > 0.01:
            assert (frame.quality.laser is LaserState.VALID) == (age < 0.5)
        assert not any(isinf(v) for v in numbers(frame))
    assert "imu: samples missing, extrapolated" in frames[10].quality.reasons
    assert frames[30].quality.reasons[0] == "imu: no samples"
    # The extrapolation is a forecast, with the deviation of one.
    truth = sea("T2", 72.0).truth.heave_m[1400:]
    assert rms(column(frames[:19], "heave_m") - truth[:19]) < 0.012
    deviations = column(frames[:19], "heave_std_m")
    assert deviations[-1] > deviations[0]


def test_coasting_advances_nothing_and_samples_bring_it_back(short: Recording) -> None:
    pipe, quiet = pipeline(), pipeline()
    for k, sample in enumerate(short.samples()):
        left_out = 60.0 <= sample.t_s < 61.5
        if left_out:
            assert pipe.coast(sample.t_s).t_s == sample.t_s
            continue
        frame, other = pipe.step(sample), quiet.step(sample)
        if k % 50 == 0:
            pipe.coast(sample.t_s + 0.2)
        if frame is not None:
            assert bytes_of([frame]) == bytes_of([other])  # type: ignore[list-item]
    assert frame is None or frame.quality.heave is HeaveState.VALID
    assert not pipe.resets


@pytest.mark.parametrize("odd", [0, 700], ids=["at the start", "later"])
@pytest.mark.parametrize("early_s", [0.005, 0.045])
@pytest.mark.parametrize("observer", ["harmonic", "sea"])
def test_one_interval_that_is_far_too_short_changes_little(
    longer: Recording, observer: Observer, odd: int, early_s: float
) -> None:
    """A poll that was held up is followed by its successor at once: the sample after ``odd`` comes early."""
    imu = imu_only(longer.samples())
    held_up = list(imu)
    held_up[odd + 1] = msgspec.structs.replace(imu[odd + 1], t_s=imu[odd + 1].t_s - early_s)
    frames = run(pipeline(heave_params=heave.Params(observer=observer), has_laser=False), held_up)
    late = longer.t_s > 80.0
    assert {frame.quality.heave for frame in np.array(frames)[late]} == {HeaveState.VALID}
    assert rms(column(frames, "heave_m")[late] - longer.truth.heave_m[late]) < 0.1 * np.std(longer.truth.heave_m)


def test_a_gap_does_not_blunt_the_sense_for_the_next(at_61_s: tuple[Pipeline, list[Sample]]) -> None:
    pipe = copy.deepcopy(at_61_s[0])
    run(pipe, (s for s in at_61_s[1] if 65.0 <= s.t_s < 65.2))
    assert "imu: samples missing, extrapolated" in pipe.coast(65.35).quality.reasons


def test_what_follows_a_restart_is_not_learned_before_it_has_settled(short: Recording, longer: Recording) -> None:
    pipe = pipeline(correction_params=SMALL)
    run(pipe, short.samples())
    assert pipe.summary().lead_comparisons > 0
    for sample in longer.samples():
        pipe.step(changed(sample, t_s=sample.t_s + 100.0))
        if pipe.training_due() is not None or pipe.summary().windows_with_nothing_to_learn > 0:
            break
    assert sample.t_s == pytest.approx(60.0 + 20.0, abs=2.0)


def test_a_long_gap_starts_the_observer_again_and_is_counted(short: Recording) -> None:
    pipe = pipeline()
    run(pipe, (s for s in short.samples() if not 40.0 <= s.t_s < 46.0))
    assert dict(pipe.resets) == {("heave", "gap"): 1}
    frame = pipe.coast(70.0)
    assert frame.quality.heave is HeaveState.SETTLING
    run(pipe, (changed(s, t_s=s.t_s + 3600.0) for s in short.samples()))
    assert dict(pipe.resets) == {("heave", "gap"): 2}


# --- the laser -------------------------------------------------------------------------------------------------------


def test_no_laser_is_no_fault(short: Recording) -> None:
    pipe = pipeline(has_laser=False)
    frames = run(pipe, imu_only(short.samples()))
    assert {f.quality.laser for f in frames} == {LaserState.OFF}
    assert frames[-1].quality.heave is HeaveState.VALID
    assert frames[-1].quality.reasons == ()
    assert all(isnan(f.reference_m) for f in frames)
    assert pipe.training_due() is None
    summary = pipe.summary()
    assert isnan(summary.lead_learned_s)
    assert isnan(summary.laser_constant_m)


def test_a_silent_laser_is_stale_and_its_value_is_not_published(longer: Recording) -> None:
    frames = run(pipeline(), (s for s in longer.samples() if isinstance(s, ImuSample) or s.t_s < 100.0))
    after = [f for f in frames if f.t_s > 100.6]
    assert {f.quality.laser for f in after} == {LaserState.STALE}
    assert all(isnan(f.reference_m) for f in after)
    assert {f.quality.heave for f in after} == {HeaveState.VALID}
    assert after[0].quality.reasons == ("laser: no fresh reference",)
    before = [f for f in frames if 60.0 < f.t_s < 99.9]
    assert {f.quality.laser for f in before} == {LaserState.VALID}


@pytest.mark.parametrize("fault", [Fault.STUCK, Fault.TIMEOUT])
def test_a_faulted_laser_is_named_and_not_used(longer: Recording, fault: Fault) -> None:
    def bad(s: Sample) -> Sample:
        return changed(s, laser_m=99.0, fault=fault) if isinstance(s, LaserSample) and s.t_s >= 100.0 else s

    pipe = pipeline()
    frames = run(pipe, map(bad, longer.samples()))
    assert f"laser: {fault.value}" in frames[-1].quality.reasons
    assert pipe.summary().laser_constant_m == pytest.approx(12.0, abs=0.003)


def teach(samples: list[Sample]) -> Pipeline:
    pipe = pipeline()
    run(pipe, samples)
    return pipe


def test_a_late_laser_teaches_what_one_in_time_does(longer: Recording) -> None:
    """Four seconds late: each reading is compared with the heave of its own moment."""
    in_time = teach(list(longer.samples()))
    late = sorted(longer.samples(), key=lambda s: s.t_s + (3.99 if isinstance(s, LaserSample) else 0.0))
    behind = teach(late)
    a, b = in_time.summary(), behind.summary()
    assert b.laser_constant_m == pytest.approx(a.laser_constant_m, abs=0.001)
    assert b.lead_learned_s == pytest.approx(a.lead_learned_s, abs=0.02)
    assert b.laser_error_rms_m == pytest.approx(a.laser_error_rms_m, rel=0.15)
    assert b.lead_comparisons > 5


def test_a_laser_ahead_of_the_imu_waits_for_it(longer: Recording) -> None:
    early = sorted(longer.samples(), key=lambda s: s.t_s - (0.73 if isinstance(s, LaserSample) else 0.0))
    a, b = teach(list(longer.samples())).summary(), teach(early).summary()
    assert b.laser_constant_m == pytest.approx(a.laser_constant_m, abs=1e-4)
    assert b.lead_learned_s == pytest.approx(a.lead_learned_s, abs=1e-3)


def test_a_laser_out_of_order_or_repeated_does_no_harm(longer: Recording) -> None:
    """Blocks of two seconds in reverse order, every reading twice, one from the far future and some without sense."""
    samples = list(longer.samples())
    lasers = laser_only(samples)
    blocks = [lasers[k : k + 40] for k in range(0, len(lasers), 40)]
    mixed: list[tuple[float, Sample]] = [
        (max(s.t_s for s in block), s) for block in blocks for s in reversed(block) for _ in range(2)
    ]
    odd = [LaserSample(t_s=1e9, laser_m=3.0), LaserSample(t_s=nan, laser_m=3.0), LaserSample(t_s=70.0, laser_m=inf)]
    mixed += [(120.0, s) for s in odd]
    mixed = [(s.t_s, s) for s in imu_only(samples)] + mixed
    merged = sorted(mixed, key=lambda pair: pair[0])
    summary = teach([s for _, s in merged]).summary()
    assert summary.laser_constant_m == pytest.approx(12.0, abs=0.005)
    assert summary.laser_error_rms_m < 0.006


# --- learning, memory ------------------------------------------------------------------------------------------------


def scaled_laser(s: Sample) -> Sample:
    """A laser that shows 1.3 times the heave: what a network of gain 0.3 corrects."""
    return changed(s, laser_m=12.0 + 1.3 * (s.laser_m - 12.0)) if isinstance(s, LaserSample) else s


@pytest.fixture(scope="module")
def trained(longer: Recording) -> tuple[Pipeline, list[tuple[float, str]], list[MotionFrame]]:
    """Four windows in turn: failed, rejected, accepted, and a late answer to a window that is no longer open."""
    pipe = pipeline(correction_params=SMALL)
    verdicts: list[tuple[float, str]] = []
    frames = []
    answers = [
        lambda n: TrainedNetwork(number=n, message="no luck"),
        lambda n: gain_network(n, -0.3),
        lambda n: gain_network(n, 0.3),
        lambda n: gain_network(n - 1, 0.3),
    ]
    for sample in map(scaled_laser, longer.samples()):
        frame = pipe.step(sample)
        frames += [frame] if frame is not None else []
        window = pipe.training_due()
        if window is not None:
            assert pipe.training_due() is None  # given out once
            if len(verdicts) < len(answers):
                verdicts.append((sample.t_s, pipe.accept(answers[len(verdicts)](window.number))))
    return pipe, verdicts, frames


def test_the_course_of_learning(trained: tuple[Pipeline, list[tuple[float, str]], list[MotionFrame]]) -> None:
    pipe, verdicts, frames = trained
    assert [verdict for _, verdict in verdicts] == ["failed", "rejected", "accepted", "rejected"]
    # Sixty seconds of observer, the lead known, twenty seconds of laser: then the first.
    assert verdicts[0][0] == pytest.approx(82.0, abs=3.0)
    summary = pipe.summary()
    assert (summary.trained_failed, summary.trained_rejected, summary.trained_accepted) == (1, 2, 1)
    assert summary.training_windows >= 4
    states = [f.quality.correction for f in frames]
    assert states[0] is CorrectionState.LEARNING
    assert states[-1] is CorrectionState.ACTIVE
    assert all(f.correction_m == 0.0 for f in frames if isfinite(f.heave_m) and f.t_s < verdicts[2][0] - 0.1)
    last = frames[-300:]
    assert column(last, "correction_m") == pytest.approx(0.3 * column(last, "observer_m"), abs=0.004)


def test_what_is_remembered_survives_json(
    trained: tuple[Pipeline, list[tuple[float, str]], list[MotionFrame]], longer: Recording
) -> None:
    pipe = trained[0]
    state = msgspec.json.decode(msgspec.json.encode(pipe.state()), type=SavedState)
    assert state == pipe.state()
    again = pipeline(correction_params=SMALL)
    again.restore(state)
    assert again.state() == state
    frames = run(again, imu_only(longer.samples()))
    assert frames[-1].quality.correction is CorrectionState.HOLDING
    last = frames[-300:]
    assert column(last, "correction_m") == pytest.approx(0.3 * column(last, "observer_m"), abs=0.004)
    assert again.summary().lead_learned_s == pipe.summary().lead_learned_s
    cold = SavedState(frequencies_hz=(0.125,))
    fresh = pipeline()
    fresh.restore(msgspec.json.decode(msgspec.json.encode(cold), type=SavedState))
    assert fresh.state() == cold


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        ({"frequencies_hz": (5.0,)}, "frequency of the observer"),
        ({"frequencies_hz": (0.1, 0.2, 0.3, 0.1)}, "saved frequencies"),
        ({}, "saved network"),
    ],
)
def test_a_state_that_does_not_fit_is_refused_whole(
    trained: tuple[Pipeline, list[tuple[float, str]], list[MotionFrame]], spoil: dict[str, object], message: str
) -> None:
    state = msgspec.structs.replace(trained[0].state(), **spoil)
    pipe = pipeline(correction_params=SMALL if spoil else correction.Params())
    before = pipe.state()
    with pytest.raises(ValueError, match=message):
        pipe.restore(state)
    assert pipe.state() == before
    assert pipe.coast(0.0).quality.correction is CorrectionState.LEARNING


@pytest.fixture(scope="module")
def seen(longer: Recording) -> Pipeline:
    """The default observer after two minutes."""
    pipe = pipeline(heave_params=heave.Params())
    run(pipe, longer.samples())
    return pipe


def test_the_sea_is_remembered(seen: Pipeline, longer: Recording) -> None:
    """The next start has a heave after ten seconds, from the spectrum of the last run, and says that it settles."""
    state = msgspec.json.decode(msgspec.json.encode(seen.state()), type=SavedState)
    assert state == seen.state()
    assert state.sea is not None
    assert state.frequencies_hz == ()
    again = pipeline(heave_params=heave.Params())
    again.restore(state)
    assert again.state() == state
    assert again.summary().frequencies_hz == state.sea.frequency_hz
    frames = run(again, (s for s in longer.samples() if s.t_s < 39.0))
    assert again.summary().fitted == {}
    assert isnan(frames[150].heave_m)
    assert isfinite(frames[210].heave_m)
    assert {frame.quality.heave for frame in frames[1:]} == {HeaveState.SETTLING}
    # Three periods on, the model of the same sea is all it takes.
    late = column(frames, "t_s") > 24.0
    error = column(frames, "heave_m")[late] - longer.truth.heave_m[: len(frames)][late]
    assert rms(error) < 0.2 * rms(longer.truth.heave_m)
    assert np.mean(np.abs(error) < 3.0 * column(frames, "heave_std_m")[late]) > 0.9


@pytest.mark.parametrize(
    ("sea_params", "spoil", "message"),
    [
        (heave.SeaParams(stages=4), {}, "chains of 7 does not fit"),
        (heave.SeaParams(components=1), {}, "does not fit the configured 1 of 7"),
        (heave.SeaParams(), {"level_m2phz": (nan, nan, nan)}, "level of the sea"),
    ],
    ids=["stages", "components", "nan"],
)
def test_a_saved_sea_that_does_not_fit_is_refused_whole(
    seen: Pipeline, sea_params: heave.SeaParams, spoil: dict[str, object], message: str
) -> None:
    state = seen.state()
    assert state.sea is not None
    state = msgspec.structs.replace(state, sea=msgspec.structs.replace(state.sea, **spoil))
    pipe = pipeline(heave_params=heave.Params(sea=sea_params))
    before = pipe.state()
    with pytest.raises(ValueError, match=message):
        pipe.restore(state)
    assert pipe.state() == before
    assert before == SavedState()


def test_what_one_observer_has_learned_is_not_forced_upon_the_other(seen: Pipeline) -> None:
    harmonic, default = pipeline(), pipeline(heave_params=heave.Params())
    harmonic.restore(seen.state())
    default.restore(SavedState(frequencies_hz=(0.1,)))
    assert harmonic.state().frequencies_hz == pipeline().state().frequencies_hz
    assert default.state() == SavedState()


def test_late_and_failed_fits_change_nothing_and_are_counted(short: Recording) -> None:
    pipe, bare = (pipeline(heave_params=heave.Params(), has_laser=False) for _ in range(2))
    pasts, verdicts = [], []
    for sample in imu_only(short.samples()):
        frame, other = pipe.step(sample), bare.step(sample)
        assert bytes_of([frame]) == bytes_of([other])  # type: ignore[list-item]
        bare.fit_due()
        past = pipe.fit_due()
        if past is not None:
            assert pipe.fit_due() is None  # given out once
            pasts.append(past)
            verdicts.append(pipe.accept_fit(SeaFit(number=past.number, message="no luck")))
    # 40 s of record, then every 10 s.
    assert [np.frombuffer(past.t_s)[-1] for past in pasts] == pytest.approx([40.0, 50.0, 60.0], abs=0.2)
    assert verdicts == ["failed"] * 3
    assert pipe.accept_fit(look(pasts[1])) == "rejected"
    assert pipe.summary().fitted == {"failed": 3, "rejected": 1}
    assert pipe.accept_fit(look(pasts[2])) == "accepted"
    assert pipe.accept_fit(look(pasts[2])) == "rejected"


def test_what_is_published_of_the_sea_is_json(seen: Pipeline, longer: Recording) -> None:
    """Plain numbers throughout, whatever they were calculated with."""
    frame = seen.coast(float(longer.t_s[-1]))
    assert frame.sea is not None
    assert frame.delayed is not None
    told = wire.sea_record(frame.sea, 0.0)
    assert msgspec.json.decode(wire.encode_record(told), type=SeaRecord) == told
    assert msgspec.json.decode(msgspec.json.encode(frame.delayed), type=DelayedHeave) == frame.delayed
    # Significant height: 4 standard deviations of the heave. In two minutes there are fifteen waves.
    assert frame.sea.significant_height_m == pytest.approx(4.0 * np.std(longer.truth.heave_m), rel=0.25)
    assert frame.delayed.t_s == pytest.approx(longer.t_s[-1] - 60.0, abs=0.1)


def parts(kept: object) -> list[tuple[str, object]]:
    """What is within something of the house, with its name there; of others, what they contain."""
    if isinstance(kept, msgspec.Struct):
        return list(msgspec.structs.asdict(kept).items())
    if isinstance(kept, Mapping):
        return [("", one) for pair in kept.items() for one in pair]
    if isinstance(kept, (Sequence, Set, deque)) and not isinstance(kept, (str, bytes)):
        return [("", one) for one in kept]
    if not type(kept).__module__.startswith("heaved."):
        return []
    slots = [slot for kind in type(kept).__mro__ for slot in getattr(kind, "__slots__", ())]
    names = [*getattr(kept, "__dict__", {}), *(slot for slot in slots if hasattr(kept, slot))]
    return [(name, getattr(kept, name)) for name in names]


def test_what_is_kept_are_plain_numbers(seen: Pipeline) -> None:
    """A number of numpy in what is kept makes numbers of numpy of all that comes of it, which are times as slow."""
    of_numpy: set[str] = set()
    met: dict[int, object] = {}
    to_see: list[tuple[str, object]] = [("pipeline", seen)]
    while to_see:
        name, kept = to_see.pop()
        if isinstance(kept, np.generic):
            of_numpy.add(name)
        elif id(kept) not in met:
            met[id(kept)] = kept
            to_see += [(f"{name}.{part}", one) for part, one in parts(kept)]
    assert len(met) > 1000
    assert of_numpy == set()


def test_the_sea_is_fitted_again_after_a_gap_that_starts_it_over(short: Recording) -> None:
    pipe = pipeline(heave_params=heave.Params(), has_laser=False)
    imu = imu_only(short.samples())
    run(pipe, imu)
    before = pipe.summary().fitted["accepted"]
    frames = run(pipe, (changed(s, t_s=s.t_s + 3600.0) for s in imu))
    assert dict(pipe.resets) == {("heave", "gap"): 1}
    assert pipe.summary().fitted == {"accepted": 2 * before}
    # Nothing but the gap itself is held against it.
    assert all("samples missing" in reason for reason in frames[-1].quality.reasons)
    assert frames[-1].quality.heave is not HeaveState.SETTLING
    assert isfinite(frames[-1].heave_m)


# --- the nature of the thing -----------------------------------------------------------------------------------------


def test_it_is_deterministic(short: Recording) -> None:
    assert bytes_of(run(pipeline(with_rock=True), short.samples())) == bytes_of(
        run(pipeline(with_rock=True), short.samples())
    )


def test_the_sample_rate_does_not_matter() -> None:
    errors = []
    for rate in (20.0, 100.0):
        r = record(seaway("T2", 1), 90.0, imu_rate_hz=rate, sensor="ideal", laser="off")
        frames = run(pipeline(has_laser=False), r.samples())
        late = r.t_s > 60.0
        errors.append(rms(column(frames, "heave_m")[late] - r.truth.heave_m[late]))
    assert errors[1] == pytest.approx(errors[0], rel=0.1)


def test_importing_it_brings_in_nothing_that_talks_to_the_world() -> None:
    code = "import sys, heaved.pipeline; print(' '.join(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "heaved.pipeline" in loaded
    forbidden = {"torch", "pymodbus", "serial", "aiohttp", "prometheus_client", "structlog", "typer", "asyncio"}
    assert not forbidden & set(loaded)
    inside = [name for name in loaded if name.startswith("heaved.")]
    pure = ("heaved.estimation", "heaved.pipeline", "heaved.samples", "heaved.unchanged")
    assert all(name.startswith(pure) for name in inside)


@pytest.mark.parametrize("observer", ["sea", "harmonic"])
def test_the_very_first_poll_may_fail(observer: Literal["sea", "harmonic"]) -> None:
    """The laser is there, and nothing yet that it could be compared with."""
    pipe = pipeline(heave_params=heave.Params(observer=observer, forecast_horizons_s=()))
    pipe.step(LaserSample(t_s=0.0, laser_m=10.0))
    for t_s in (0.01, 0.02):
        frame = pipe.step(ImuSample(t_s=t_s, fault=Fault.TIMEOUT))
        assert frame is not None
        assert frame.quality.heave is HeaveState.INVALID
