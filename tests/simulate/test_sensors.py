"""Sensors against rotation matrices, noise densities and the two forms (recorded, polled) against each other."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, csd, freqs, welch
from scipy.spatial.transform import Rotation

from heaved.devices.profile import Block, DeviceSpec, Field, Profile, Role
from heaved.samples import GRAVITY_MPS2, Fault, ImuSample, LaserSample
from heaved.simulate.gauge import LASER_DISTANCE_M
from heaved.simulate.instruments import Imu, Instruments, Laser, LowPass
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import SENSORS, ImuModel, laser_pattern, leaning, measure, record
from heaved.simulate.vessel import Motion, Real, body_rates, specific_force

angles = st.floats(-math.pi, math.pi)
small = st.floats(-20.0, 20.0)


def motion_at(**values: float) -> Motion[float]:
    return Motion(**(dict.fromkeys(Motion.__struct_fields__, 0.0) | values))


def over_a_level_target_m(motion: Motion[Real]) -> Real:
    """Reading of a laser that looks straight down from the vessel."""
    found: Real = (LASER_DISTANCE_M + motion.heave_m) / np.cos(motion.roll_rad) / np.cos(motion.pitch_rad)
    return found


def hull_from_ship(roll: float, pitch: float, yaw: float) -> Rotation:
    """Level frame of heading zero <- body: roll about x, then pitch about y and yaw about z, both against the hand."""
    return Rotation.from_euler("ZYX", [-yaw, -pitch, roll])


@given(roll=angles, pitch=angles, heave=small, surge=small, sway=small)
def test_tilt_removal_gives_heave_back_for_any_angles(
    roll: float, pitch: float, heave: float, surge: float, sway: float
) -> None:
    force = specific_force(
        motion_at(
            roll_rad=roll,
            pitch_rad=pitch,
            heave_acceleration_mps2=heave,
            surge_acceleration_mps2=surge,
            sway_acceleration_mps2=sway,
        )
    )
    up = math.sin(pitch) * force.x + math.sin(roll) * math.cos(pitch) * force.y
    up += math.cos(roll) * math.cos(pitch) * force.z - GRAVITY_MPS2
    assert up == pytest.approx(heave, abs=1e-12)
    expected = hull_from_ship(roll, pitch, 0.0).inv().apply([surge, sway, heave + GRAVITY_MPS2])
    np.testing.assert_allclose([force.x, force.y, force.z], expected, atol=1e-12)


def test_signs_at_rest_and_tilted() -> None:
    level = specific_force(motion_at())
    assert (level.x, level.y, level.z) == (0.0, 0.0, GRAVITY_MPS2)
    assert specific_force(motion_at(pitch_rad=0.1)).x > 0.0  # bow up: the reaction to gravity has a part forward
    assert specific_force(motion_at(roll_rad=0.1)).y > 0.0  # port up: it has a part to port


@given(
    roll=angles, pitch=st.floats(-1.5, 1.5), yaw=angles, rates=st.tuples(*[st.floats(-1.0, 1.0)] * 3)
)  # fmt: skip
def test_body_rates_are_those_of_the_turning_hull(
    roll: float, pitch: float, yaw: float, rates: tuple[float, float, float]
) -> None:
    h = 1e-5
    start, end = (hull_from_ship(*(np.array([roll, pitch, yaw]) + s * h * np.array(rates))) for s in (-1, 1))
    expected = (start.inv() * end).as_rotvec() / (2 * h)
    motion = motion_at(
        roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw,
        roll_rate_radps=rates[0], pitch_rate_radps=rates[1], yaw_rate_radps=rates[2],
    )  # fmt: skip
    found = body_rates(motion)
    np.testing.assert_allclose([found.x, found.y, found.z], expected, atol=1e-5)


def test_ideal_record_is_the_truth() -> None:
    sea = seaway("S6", seed=4)
    recording = record(sea, 60.0, imu_rate_hz=50.0, sensor="ideal")
    force = specific_force(sea.motion(recording.t_s))
    np.testing.assert_allclose(recording.az_mps2, force.z, atol=1e-12)
    assert recording.t_s[-1] == pytest.approx(59.98)
    there = np.isfinite(recording.laser_m)
    assert there.sum() == 1200  # 20 Hz on a 50 Hz grid
    assert np.std((recording.laser_m - over_a_level_target_m(recording.truth))[there]) == pytest.approx(0.002, rel=0.1)


@pytest.mark.parametrize("sensor", ["A", "B"])
@pytest.mark.parametrize("rate_hz", [20.0, 100.0])
def test_noise_density_is_the_same_at_any_rate(sensor: str, rate_hz: float) -> None:
    recording = record(seaway("S0"), 30_000.0 / rate_hz, imu_rate_hz=rate_hz, sensor=sensor, seed=3)
    f, density = welch(recording.ax_mps2, fs=rate_hz, nperseg=1000)
    white = np.sqrt(density[(f > 1.0) & (f < 0.45 * rate_hz)].mean())
    assert white == pytest.approx(SENSORS[sensor].noise_mps2_rthz, rel=0.03)
    assert np.std(recording.roll_rad) == pytest.approx(math.radians(0.02), rel=0.03)


def test_bias_and_scale_and_mounting_and_registers() -> None:
    still = record(seaway("S0"), 400.0, sensor="B", seed=5)
    step = 16.0 * GRAVITY_MPS2 / 32768
    np.testing.assert_allclose(still.az_mps2 / step, np.round(still.az_mps2 / step), atol=1e-6)
    tilt = math.radians(1.0)
    for reading, true in (
        (still.ax_mps2, 0.0),
        (still.ay_mps2, 1.02 * GRAVITY_MPS2 * math.sin(tilt)),
        (still.az_mps2, 1.02 * GRAVITY_MPS2 * math.cos(tilt)),
    ):
        # 400 s of walk add 1e-4 sqrt(400) = 2e-3 m/s2 to the bias of 0.05.
        assert abs(np.mean(reading) - true) == pytest.approx(0.05, abs=0.008)


def test_random_walk_of_the_bias_grows_with_the_root_of_time() -> None:
    walking = ImuModel(bias_walk_mps2_rts=1e-2)
    ends = [record(seaway("S0"), 100.0, sensor=walking, seed=s).ax_mps2[-1] for s in range(200)]
    assert np.std(ends) == pytest.approx(1e-2 * math.sqrt(100.0), rel=0.15)


def test_low_pass_has_the_answer_of_a_butterworth_filter() -> None:
    low_pass, rng = LowPass(2.0), np.random.default_rng(2)
    fs = 100.0
    value = rng.standard_normal((20_000, 3))
    output = np.array([low_pass.step(row, 1.0 / fs) for row in value])
    f, cross = csd(value[:, 0], output[:, 0], fs=fs, nperseg=2000)
    f, power = welch(value[:, 0], fs=fs, nperseg=2000)
    part = (f > 0.1) & (f < 6.0)
    numerator, denominator = butter(2, 2 * np.pi * 2.0, analog=True)
    expected = freqs(numerator, denominator, 2 * np.pi * f[part])[1]
    assert np.abs((cross / power)[part] - expected).max() < 0.03


def test_low_pass_does_not_care_how_a_straight_line_is_cut() -> None:
    whole, cut = LowPass(2.0), LowPass(2.0)
    start, slope = np.array([1.0, -2.0, 0.5]), np.array([0.3, 1.0, -4.0])
    whole.step(start, 0.0)
    cut.step(start, 0.0)
    steps = np.array([0.01, 0.2, 0.05, 0.003, 0.0, 0.11])
    for t, step in zip(np.cumsum(steps), steps, strict=True):
        piece = cut.step(start + slope * t, float(step))
    np.testing.assert_allclose(whole.step(start + slope * steps.sum(), steps.sum()), piece, atol=1e-12)


@pytest.mark.parametrize("sensor", ["A", "B"])
def test_polled_readings_have_the_statistics_of_recorded_ones(sensor: str) -> None:
    sea = seaway("S5", seed=6)
    recording = record(sea, 200.0, imu_rate_hz=20.0, sensor=sensor, seed=1)
    imu = Imu(sea, SENSORS[sensor], rate_hz=20.0, seed=8)
    polled = [imu.read(t) for t in recording.t_s.tolist()]
    noise = SENSORS[sensor].noise_mps2_rthz * math.sqrt(10.0)
    for field, std in (
        ("az_mps2", noise),
        ("ax_mps2", noise),
        ("roll_rad", math.radians(0.02)),
        ("gy_radps", SENSORS[sensor].gyro_noise_radps_rthz * math.sqrt(10.0)),
    ):
        difference = np.array([getattr(sample, field) for sample in polled]) - getattr(recording, field)
        # Two independent readings of one motion: what is left is noise (and quantisation) twice, and two biases.
        assert np.std(difference) == pytest.approx(math.sqrt(2.0) * std, rel=0.25)
        assert abs(np.mean(difference)) < 2.2 * SENSORS[sensor].bias_mps2 + 1e-3


def test_polling_is_repeatable_and_never_goes_back() -> None:
    sea = seaway("S4")
    twice = [Imu(sea, SENSORS["B"], rate_hz=100.0, seed=3) for _ in range(2)]
    times = np.cumsum(np.random.default_rng(0).uniform(0.0, 0.03, 50)).tolist()
    assert [twice[0].read(t) for t in times] == [twice[1].read(t) for t in times]
    with pytest.raises(ValueError, match="backwards"):
        twice[0].read(0.0)


def test_seeds_of_waves_and_errors_are_apart() -> None:
    first = record(seaway("S4", seed=1), 50.0, seed=1)
    other_noise = record(seaway("S4", seed=1), 50.0, seed=2)
    np.testing.assert_array_equal(first.truth.heave_m, other_noise.truth.heave_m)
    assert (first.az_mps2 != other_noise.az_mps2).all()
    np.testing.assert_array_equal(first.az_mps2, record(seaway("S4", seed=1), 50.0, seed=1).az_mps2)


@pytest.mark.parametrize(
    ("text", "on", "off"),
    [
        ("on", [0.0, 1e6], []),
        ("off", [], [0.0, 1e6]),
        ("50%", [0.0, 59.9, 120.0, 179.0], [60.0, 119.9, 180.0]),
        ("80%", [0.0, 59.0, 75.0], [60.0, 74.9]),
        ("100%", [0.0, 60.0], []),
        ("300+120,900+30", [0.0, 299.9, 420.0, 930.0], [300.0, 419.9, 900.0]),
    ],
)
def test_laser_patterns(text: str, on: list[float], off: list[float]) -> None:
    pattern = laser_pattern(text)
    assert all(pattern.on(t) for t in on)
    assert not any(pattern.on(t) for t in off)


@pytest.mark.parametrize("text", ["", "half", "0%", "150%", "300", "300+", "-3+4"])
def test_laser_patterns_that_are_none(text: str) -> None:
    with pytest.raises(ValueError, match="50%"):
        laser_pattern(text)


def test_laser_without_an_echo_says_so() -> None:
    laser = Laser(seaway("S4"), laser_pattern("10+10"), seed=1)
    assert laser.read(5.0).fault is Fault.NONE
    assert laser.read(12.0).fault is Fault.EXCEPTION
    assert math.isnan(laser.read(12.0).laser_m)
    recording = record(seaway("S4"), 30.0, laser="10+10")
    missing = np.isnan(recording.laser_m)
    np.testing.assert_array_equal(missing, (recording.t_s >= 10.0) & (recording.t_s < 20.0))


def test_samples_come_in_order_with_the_laser_where_there_is_one() -> None:
    samples = list(record(seaway("S4"), 2.0, imu_rate_hz=40.0, laser_rate_hz=20.0, laser="1+5").samples())
    assert sum(isinstance(sample, ImuSample) for sample in samples) == 80
    assert sum(isinstance(sample, LaserSample) for sample in samples) == 20
    assert [sample.t_s for sample in samples] == sorted(sample.t_s for sample in samples)


def test_measure_takes_any_motion_that_is_known_on_a_grid() -> None:
    t = 100.0 + np.arange(0.0, 20.0, 0.05)
    zero = np.zeros_like(t)
    truth = Motion(**(dict.fromkeys(Motion.__struct_fields__, zero) | {"t_s": t, "heave_m": zero + 0.7}))
    recording = measure(truth, imu_rate_hz=20.0, laser_rate_hz=10.0, sensor="ideal", laser="5+5")
    assert np.nanmean(recording.laser_m) == pytest.approx(LASER_DISTANCE_M + 0.7, abs=0.001)
    assert np.isfinite(recording.laser_m).sum() == 150
    with pytest.raises(ValueError, match=r"'Z'.*A, B, C, AHRS, ideal"):
        measure(truth, imu_rate_hz=20.0, sensor="Z")


def test_instruments_keep_one_sensor_for_each_device() -> None:
    block = Block(start=0, fields=(Field(quantity="az_mps2", offset=0, unit="m/s2", scale=0.01),))
    profile = Profile(name="p", blocks=(block,))
    roles: tuple[tuple[str, Role], ...] = (("imu", "imu"), ("imu2", "imu"), ("laser", "laser"))
    imu, second, laser = (
        DeviceSpec(name=name, role=role, link="tcp://h:1", profile=profile, rate_hz=20.0) for name, role in roles
    )
    sea = seaway("S4")
    instruments = Instruments(sea, sensor="A", seed=1)
    first, other = instruments.read(imu, 1.0), instruments.read(second, 1.0)
    assert isinstance(first, ImuSample)
    assert isinstance(other, ImuSample)
    assert 0.0 < abs(first.az_mps2 - other.az_mps2) < 0.1
    assert first == Instruments(sea, sensor="A", seed=1).read(imu, 1.0)
    reading = instruments.read(laser, 1.0)
    assert isinstance(reading, LaserSample)
    assert reading.laser_m == pytest.approx(over_a_level_target_m(sea.at(1.0)), abs=0.01)


def test_an_attitude_leans_into_a_turn_with_its_time_constant() -> None:
    still = seaway("S0").motion(np.arange(0.0, 60.0, 0.1))
    turning = msgspec.structs.replace(still, sway_acceleration_mps2=np.full(600, 0.15))
    found = measure(turning, imu_rate_hz=10.0, sensor=ImuModel(attitude_lean_s=8.0), laser="off")
    expected = math.atan2(0.15, GRAVITY_MPS2) * (1.0 - np.exp(-still.t_s / 8.0))
    np.testing.assert_allclose(found.roll_rad, expected, atol=1e-9)
    np.testing.assert_allclose(found.pitch_rad, 0.0, atol=1e-9)


def test_a_late_attitude_is_that_of_before() -> None:
    sea, t_s = seaway("S6", seed=2), np.arange(0.0, 60.0, 0.05)
    found = record(sea, 60.0, imu_rate_hz=20.0, sensor=ImuModel(attitude_late_s=0.04), laser="off")
    before = sea.motion(t_s - 0.04)
    for angle, expected in (
        (found.roll_rad, before.roll_rad), (found.pitch_rad, before.pitch_rad), (found.yaw_rad, before.yaw_rad),
    ):  # fmt: skip
        np.testing.assert_allclose(angle[1:], expected[1:], atol=2e-6)
    np.testing.assert_allclose(found.gx_radps, body_rates(sea.motion(t_s)).x, atol=1e-12)


@pytest.mark.parametrize(("lean_s", "late_s"), [(8.0, 0.04), (5.0, 0.0), (math.inf, 0.06)])
def test_a_polled_attitude_errs_as_a_recorded_one(lean_s: float, late_s: float) -> None:
    sea, sensor = seaway("S6", seed=3), ImuModel(attitude_lean_s=lean_s, attitude_late_s=late_s)
    recording = record(sea, 60.0, imu_rate_hz=50.0, sensor=sensor, laser="off")
    imu = Imu(sea, sensor, rate_hz=50.0, seed=1)
    polled = np.array([[s.roll_rad, s.pitch_rad, s.yaw_rad] for s in map(imu.read, recording.t_s.tolist())])
    recorded = np.column_stack((recording.roll_rad, recording.pitch_rad, recording.yaw_rad))
    np.testing.assert_allclose(polled[3:], recorded[3:], atol=1e-4)


def test_the_apparent_vertical_is_along_the_specific_force() -> None:
    motion = motion_at(roll_rad=0.1, pitch_rad=-0.05, sway_acceleration_mps2=0.5, surge_acceleration_mps2=-0.3)
    roll, pitch = leaning(motion)
    apparent = hull_from_ship(0.1 + float(roll), -0.05 + float(pitch), 0.0)
    force = specific_force(motion)
    along = apparent.apply([force.x, force.y, force.z])
    np.testing.assert_allclose(along[:2], 0.0, atol=1e-12)
