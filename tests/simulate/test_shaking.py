"""What shakes the sensors, against periodograms of long records, aliasing arithmetic and numerical derivatives."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import butter, lsim, welch

from heaved.devices.profile import Block, DeviceSpec, Field, Profile
from heaved.samples import ImuSample
from heaved.simulate.instruments import Instruments
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import ImuModel, measure, record
from heaved.simulate.shaking import SHAKES, Line, Resonance, Shake, Slams, shake_of, shaking

VIBRATING = [name for name, shake in SHAKES.items() if shake.vibration]
COLUMNS = (
    "ax_mps2", "ay_mps2", "az_mps2", "roll_rad", "pitch_rad", "yaw_rad", "gx_radps", "gy_radps", "gz_radps",
)  # fmt: skip


def power(f_hz: np.ndarray, density: np.ndarray, low_hz: float, high_hz: float) -> float:
    part = (f_hz >= low_hz) & (f_hz <= high_hz)
    return float(np.trapezoid(density[part], f_hz[part]))


@pytest.mark.parametrize("rate_hz", [10.0, 20.0, 100.0, 200.0])
@pytest.mark.parametrize("name", VIBRATING)
def test_density_is_that_of_a_long_record_at_any_poll(name: str, rate_hz: float) -> None:
    """Band by band, folded as it is; two long records, for an engine's speed and blows vary much."""
    t = np.arange(round((1800.0 if rate_hz < 50.0 else 700.0) * rate_hz)) / rate_hz
    periodograms = []
    for seed in (1, 2):
        f, found = welch(shaking(name, seed).readings(t)[2], rate_hz, nperseg=round(100.0 * rate_hz))
        periodograms.append(found)
    mean = np.mean(periodograms, axis=0)
    fine = np.arange(0.0, rate_hz / 2.0 + 1e-9, 0.002)
    expected = SHAKES[name].density(fine, rate_hz)
    total = power(fine, expected, 0.0, rate_hz / 2.0)
    assert power(f, mean, 0.02, rate_hz / 2.0) == pytest.approx(total, rel=0.12)
    edges = np.arange(0.15, rate_hz / 2.0, 0.5) if rate_hz < 50.0 else np.arange(0.25, rate_hz / 2.0, 2.0)
    for low, high in pairwise(edges):
        wanted = power(fine, expected, low, high)
        assert power(f, mean, low, high) == pytest.approx(wanted, rel=0.3, abs=0.012 * total)


@pytest.mark.parametrize(
    ("name", "rate_hz", "apparent_hz"),
    [("line-25.1", 20.0, 5.1), ("line-25.1", 10.0, 4.9), ("line-25.1", 100.0, 25.1), ("line-3.1", 10.0, 3.1)],
)
def test_a_line_above_half_the_poll_rate_appears_where_it_folds_to(
    name: str, rate_hz: float, apparent_hz: float
) -> None:
    t = np.arange(round(200.0 * rate_hz)) / rate_hz
    spectrum = np.abs(np.fft.rfft(shaking(name, 3).readings(t)[2])) ** 2
    assert np.argmax(spectrum) / 200.0 == pytest.approx(apparent_hz, abs=0.006)
    f = np.linspace(0.0, rate_hz / 2.0, 20_001)
    assert f[np.argmax(SHAKES[name].density(f, rate_hz))] == pytest.approx(apparent_hz, abs=0.003)


@pytest.mark.parametrize("name", VIBRATING)
def test_polls_of_any_rate_and_order_see_the_same_vibration(name: str) -> None:
    t = np.arange(0.0, 60.0, 0.005)
    finest = shaking(name, 4).readings(t)
    again = shaking(name, 4)
    for step in (2, 10, 20):
        np.testing.assert_allclose(again.readings(t[::step]), finest[:, ::step], atol=1e-9)
    shuffled = np.random.default_rng(1).permutation(t.size)[:200]
    np.testing.assert_allclose(again.readings(t[shuffled]), finest[:, shuffled], atol=1e-9)
    one = np.hstack([again.readings(t[i : i + 1]) for i in shuffled[:20]])
    np.testing.assert_allclose(one, finest[:, shuffled[:20]], atol=1e-9)
    assert np.abs(shaking(name, 5).readings(t)[2] - finest[2]).max() > 0.01


@pytest.mark.parametrize("name", VIBRATING)
def test_sizes_are_as_named_and_the_displacement_is_small(name: str) -> None:
    t = np.arange(0.0, 1000.0, 0.01)
    x, y, z = shaking(name, 6).readings(t)[:3]
    f = np.linspace(0.0, 200.0, 400_001)
    expected = math.sqrt(sum(np.trapezoid(part.spectrum(f), f) for part in SHAKES[name].vibration))
    assert np.std(z) == pytest.approx(expected, rel=0.2)
    for horizontal in (x, y):
        assert np.std(horizontal) == pytest.approx(0.5 * np.std(z), rel=0.15)
    if name != "slams":  # whose blows leave a velocity behind: they are no vibration about a place
        inside = f > 0.0
        moved = sum(np.trapezoid(p.spectrum(f[inside]) / (2 * np.pi * f[inside]) ** 4, f[inside])
                    for p in SHAKES[name].vibration if not isinstance(p, Line))  # fmt: skip
        assert math.sqrt(moved) < 0.01


def test_a_resonance_has_its_power_and_its_width() -> None:
    girder = Resonance(hz=1.5, damping=0.02, rms_mps2=0.1)
    area = quad(lambda f: float(girder.spectrum(np.array(f))), 0.0, 6.0, points=[1.4, 1.5, 1.6], limit=400)[0]
    assert area == pytest.approx(0.01, rel=1e-3)
    f = np.linspace(1.4, 1.6, 200_001)
    half = f[girder.spectrum(f) > 0.5 * girder.spectrum(f).max()]
    assert half[-1] - half[0] == pytest.approx(2.0 * 0.02 * 1.5, rel=0.02)


def test_an_engine_keeps_within_five_percent_and_wanders_over_tens_of_seconds() -> None:
    line = Line(hz=7.3, amplitude_mps2=0.3, wander=0.05)
    t = np.arange(0.0, 600.0, 0.005)
    z = shaking(Shake(vibration=(line,)), 7).readings(t)[2]
    rising = t[1:][(z[:-1] < 0.0) & (z[1:] >= 0.0)]
    turns = np.diff(rising[::7])  # over seven turns, a second
    speed = 7.0 / turns
    assert 7.3 * 0.945 < speed.min() < 7.3 * 0.985
    assert 7.3 * 1.015 < speed.max() < 7.3 * 1.055
    assert np.max(np.abs(np.diff(speed))) < 0.15  # in a second
    f = np.linspace(6.8, 7.8, 10_001)
    assert np.trapezoid(line.spectrum(f), f) == pytest.approx(0.045, rel=0.01)


def test_slams_come_at_random_and_ring_down() -> None:
    t = np.arange(0.0, 3000.0, 0.01)
    z = shaking("slams", 8).readings(t)[2]
    quiet = np.abs(z) < 0.01
    assert 0.1 < np.mean(quiet) < 0.9
    assert 1.4 < z.max() < 3.6
    onsets = np.count_nonzero(np.diff((np.abs(z) > 0.5).astype(int)) == 1)
    assert onsets > 150
    np.testing.assert_array_equal(z, shaking("slams", 8).readings(t)[2])


def test_a_low_pass_acts_before_the_sampling() -> None:
    """A 25 Hz line behind a 5 Hz low-pass: at a 20 Hz poll what folds to 5.1 Hz is as weak as it was at 25.1 Hz."""
    weak = shaking("line-25.1", 1, bandwidth_hz=5.0)
    t = np.arange(0.0, 100.0, 0.05)
    expected = 0.5 / math.sqrt(1.0 + (25.1 / 5.0) ** 4)
    assert math.sqrt(2.0) * np.std(weak.readings(t)[2]) == pytest.approx(expected, rel=1e-3)
    f = np.linspace(0.0, 10.0, 20_001)
    assert math.sqrt(2.0 * np.trapezoid(SHAKES["line-25.1"].density(f, 20.0, 5.0), f)) == pytest.approx(
        expected, rel=0.01
    )


def test_a_slam_through_a_low_pass_is_what_a_simulation_of_it_gives() -> None:
    slams = Shake(vibration=(Slams(size_mps2=2.0, hz=2.2, damping=0.07, every_s=15.0),))
    t = np.arange(0.0, 60.0, 0.002)
    bare, passed = (shaking(slams, 9, bandwidth_hz=bandwidth).readings(t)[2] for bandwidth in (math.inf, 3.0))
    b, a = butter(2, 2.0 * np.pi * 3.0, analog=True)
    _, simulated, _ = lsim((b, a), bare, t)
    np.testing.assert_allclose(passed, simulated, atol=5e-3)


def test_angles_and_gyros_shake_together() -> None:
    t = np.arange(0.0, 5.0, 1e-3)
    readings = shaking("gyros", 10).readings(t)
    rate, angle = readings[6], readings[3]
    assert rate.max() == pytest.approx(2e-3, rel=1e-3)
    np.testing.assert_allclose((angle[2:] - angle[:-2]) / 2e-3, rate[1:-1], atol=2e-6)
    pitch, pitch_rate = readings[4], -readings[7]  # bow up turns against the right hand about y
    np.testing.assert_allclose((pitch[2:] - pitch[:-2]) / 2e-3, pitch_rate[1:-1], atol=2e-6)


@pytest.mark.parametrize("name", ["turn", "list-step"])
def test_turn_and_list_are_true_motion_whose_rates_are_derivatives(name: str) -> None:
    t = np.arange(400.0, 540.0, 0.01)
    sea = seaway("S0")
    still, moved = sea.motion(t), shaking(name, 1).moved(sea.motion(t))
    for value, rate in ((moved.roll_rad, moved.roll_rate_radps), (moved.yaw_rad, moved.yaw_rate_radps)):
        np.testing.assert_allclose((value[2:] - value[:-2]) / 0.02, rate[1:-1], atol=1e-6)
    np.testing.assert_array_equal(moved.heave_m, still.heave_m)
    if name == "turn":
        sideways = moved.sway_acceleration_mps2 - still.sway_acceleration_mps2
        assert sideways.max() == pytest.approx(0.15)
        assert np.sum(sideways > 1e-6) * 0.01 == pytest.approx(80.0, abs=0.5)
        np.testing.assert_allclose(sideways, -5.0 * moved.yaw_rate_radps, atol=1e-12)
    else:
        assert np.degrees(moved.roll_rad[-1] - still.roll_rad[-1]) == pytest.approx(3.0)
        lying_over = t[(moved.roll_rad > 1e-6) & (moved.roll_rad < math.radians(3.0) - 1e-6)]
        assert np.ptp(lying_over) < 4.0
    one = shaking(name, 1).moved(sea.at(450.0))
    assert one.yaw_rad == pytest.approx(moved.yaw_rad[5000])
    assert one.roll_rad == pytest.approx(moved.roll_rad[5000])


def test_a_record_has_the_motion_in_its_truth_and_the_vibration_in_its_readings() -> None:
    sea = seaway("S4", 1)
    clean, shaken = (record(sea, 500.0, sensor="ideal", shake=shake, seed=3) for shake in ("", "engine-room"))
    np.testing.assert_array_equal(clean.truth.heave_m, shaken.truth.heave_m)
    np.testing.assert_allclose(
        shaken.az_mps2 - clean.az_mps2, shaking("engine-room", 3).readings(clean.t_s)[2], atol=1e-12
    )
    listed = record(sea, 500.0, sensor="ideal", shake="list-step", seed=3)
    late = listed.t_s > 430.0
    difference = listed.truth.roll_rad - clean.truth.roll_rad
    np.testing.assert_allclose(difference[late], math.radians(3.0))
    np.testing.assert_allclose(listed.roll_rad - clean.roll_rad, difference, atol=1e-12)
    warm = record(sea, 700.0, sensor="ideal", shake="warm-up", seed=3)
    assert np.mean(warm.az_mps2[warm.t_s > 650.0] - sea.motion(warm.t_s[warm.t_s > 650.0]).heave_acceleration_mps2
                   - 9.80665) == pytest.approx(0.05, abs=0.02)  # fmt: skip


@pytest.mark.parametrize("name", [*SHAKES, ""])
def test_sensors_on_a_bus_are_shaken_as_a_record_is(name: str) -> None:
    block = Block(start=0, fields=(Field(quantity="az_mps2", offset=0, unit="m/s2", scale=0.01),))
    profile = Profile(name="p", blocks=(block,))
    device = DeviceSpec(name="imu", role="imu", link="tcp://h:1", profile=profile, rate_hz=10.0)
    sea, t = seaway("S5", 2), np.array([*np.arange(0.0, 2.0, 0.1), *np.arange(419.0, 430.0, 0.5), 600.0])
    expected = measure(sea.motion(t), imu_rate_hz=10.0, sensor="ideal", shake=name, seed=5)
    instruments = Instruments(sea, sensor="ideal", shake=name, seed=5)
    for row, at in enumerate(t.tolist()):
        read = instruments.read(device, at)
        assert isinstance(read, ImuSample)
        for column in COLUMNS:
            assert getattr(read, column) == pytest.approx(getattr(expected, column)[row], abs=1e-9)


def test_registers_and_errors_come_after_the_shaking() -> None:
    recording = record(seaway("S0"), 5.0, sensor=ImuModel(sixteen_bit=True), shake="line-3.1", seed=1)
    step = 16.0 * 9.80665 / 32768
    np.testing.assert_allclose(recording.az_mps2 / step, np.round(recording.az_mps2 / step), atol=1e-6)


def test_names_that_are_not_there_list_those_that_are() -> None:
    with pytest.raises(ValueError, match=r"'earthquake'.*line-1\.3, .*engine-room"):
        shake_of("earthquake")
    assert shake_of("") == Shake()
    assert shake_of(SHAKES["slams"]) is SHAKES["slams"]
