"""Lean and lateness of an attitude sensor. Oracle: the simulator's truth, and the time constant and delay put in."""

from __future__ import annotations

from functools import cache
from math import hypot, inf, pi, sqrt

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from heaved.estimation.imu import attitude_fit
from heaved.estimation.imu.attitude import angle_rates, level_acceleration
from heaved.estimation.imu.attitude_error import Amendment, AttitudeError
from heaved.estimation.imu.attitude_fit import NOTHING, UP, Belief, averaged
from heaved.estimation.imu.leaks import leaks_mps2
from heaved.samples import ImuSample
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import SENSORS, ImuModel, Recording, record
from heaved.simulate.wrong_physics import Wrong, crooked

Array = NDArray[np.float64]
RATE_HZ = 10.0
LASTS_S = 420.0
QUIET = msgspec.structs.replace(SENSORS["A"], noise_mps2_rthz=3e-4, bias_walk_mps2_rts=1e-6)
"""So that its own noise is not most of what is left below the waves."""
STEADY_S = 220.0
"""Three pieces of two minutes are there by then."""


@cache
def recorded(lean_s: float, late_s: float, seed: int = 1, sea: str = "S6", of: ImuModel = QUIET) -> Recording:
    sensor = msgspec.structs.replace(of, attitude_lean_s=lean_s, attitude_late_s=late_s)
    return record(seaway(sea, seed), LASTS_S, imu_rate_hz=RATE_HZ, sensor=sensor, laser="off", seed=seed)


def run(
    recording: Recording, *, has_gyros: bool, hole: range = range(0), leaked: Array | None = None
) -> tuple[AttitudeError, Array, Array]:
    """After the record, and the vertical acceleration as measured and corrected, less the true one; no samples in
    ``hole``. ``leaked``: what is known of it beforehand to be no acceleration.
    """
    one, found = AttitudeError(), []
    slope = [np.gradient(angle, 1.0 / RATE_HZ) for angle in (recording.roll_rad, recording.pitch_rad)]
    samples = [sample for sample in recording.samples() if isinstance(sample, ImuSample)]
    true = recording.truth.heave_acceleration_mps2
    known = np.zeros(len(samples)) if leaked is None else leaked
    for i, sample in enumerate(samples):
        if i in hole:
            continue
        roll, pitch = sample.roll_rad, sample.pitch_rad
        rates = angle_rates(sample, roll, pitch)[:2] if has_gyros else (slope[0][i], slope[1][i])
        x, y, up = level_acceleration(sample.ax_mps2, sample.ay_mps2, sample.az_mps2, roll, pitch)
        up -= known[i]
        corrected = one.step(sample.t_s, x, y, up, roll, pitch, *rates, are_rates_measured=has_gyros)
        found.append((up - true[i], corrected - true[i]))
    off = np.array(found)
    return one, off[:, 0], off[:, 1]


def below_waves(off: Array) -> float:
    """RMS below 0.05 Hz once it is steady, m/s2, without the bias."""
    slow = sosfiltfilt(butter(4, 0.05, fs=RATE_HZ, output="sos"), off)[int(STEADY_S * RATE_HZ) : -100]
    return float(np.std(slow))


ERRORS = [(8.0, 0.04), (5.0, 0.02), (20.0, 0.06), (8.0, 0.0), (inf, 0.04)]


@pytest.mark.parametrize(("lean_s", "late_s"), ERRORS)
def test_gyroscopes_show_lean_and_lateness(lean_s: float, late_s: float) -> None:
    one, raw, corrected = run(recorded(lean_s, late_s), has_gyros=True)
    assert one.lean_per_s == pytest.approx(1.0 / lean_s, abs=0.005)
    assert one.late_s == pytest.approx(late_s, abs=0.012)
    assert below_waves(corrected) < 0.5 * below_waves(raw)


@pytest.mark.parametrize(("lean_s", "late_s"), ERRORS)
def test_without_gyroscopes_the_harm_is_found(lean_s: float, late_s: float) -> None:
    one, raw, corrected = run(recorded(lean_s, late_s), has_gyros=False)
    assert one.lean_per_s == pytest.approx(1.0 / lean_s, abs=0.06)
    assert one.late_s == pytest.approx(late_s, abs=0.03)
    assert below_waves(corrected) < 0.6 * below_waves(raw)


@pytest.mark.parametrize("has_gyros", [True, False], ids=["gyroscopes", "none"])
def test_accelerometers_behind_a_low_pass_are_late(has_gyros: bool) -> None:
    sensor = msgspec.structs.replace(QUIET, bandwidth_hz=2.0)
    recording = record(seaway("S6", 1), LASTS_S, imu_rate_hz=RATE_HZ, sensor=sensor, laser="off", seed=1)
    one, raw, corrected = run(recording, has_gyros=has_gyros)
    # Delay of a Butterworth low-pass of second order far below its corner.
    assert one.late_s == pytest.approx(-sqrt(2.0) / (2.0 * pi * 2.0), abs=0.05)
    assert below_waves(corrected) < 0.7 * below_waves(raw)


@pytest.mark.parametrize("has_gyros", [True, False], ids=["gyroscopes", "none"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_attitude_without_errors_is_left_alone(seed: int, has_gyros: bool) -> None:
    recording = record(seaway("S6", seed), LASTS_S, imu_rate_hz=RATE_HZ, sensor="A", laser="off", seed=seed)
    one, raw, corrected = run(recording, has_gyros=has_gyros)
    assert one.lean_per_s < 0.02
    assert abs(one.late_s) < 0.015
    assert below_waves(corrected) < 1.1 * below_waves(raw)


def test_gyroscopes_show_both_within_half_a_minute() -> None:
    recording = recorded(8.0, 0.04)
    one, found = AttitudeError(), []
    for sample in recording.samples():
        assert isinstance(sample, ImuSample)
        roll, pitch = sample.roll_rad, sample.pitch_rad
        x, y, up = level_acceleration(sample.ax_mps2, sample.ay_mps2, sample.az_mps2, roll, pitch)
        rates = angle_rates(sample, roll, pitch)[:2]
        one.step(sample.t_s, x, y, up, roll, pitch, *rates, are_rates_measured=True)
        found.append((sample.t_s, one.lean_per_s, one.late_s))
        if sample.t_s > 35.0:
            break
    assert found[-1][1] == pytest.approx(1.0 / 8.0, rel=0.1)
    assert found[-1][2] == pytest.approx(0.04, abs=0.005)


@pytest.mark.parametrize(("lean_s", "late_s"), [(8.0, 0.04), (20.0, 0.08), (inf, 0.0)])
def test_angles_are_as_good_as_they_are_said_to_be_where_nothing_shows_their_errors(
    lean_s: float, late_s: float
) -> None:
    """In short waves they do little harm to the heave, and a point at the end of a boom has them whole."""
    ratios = []
    for seed in (1, 2, 3):
        made = recorded(lean_s, late_s, seed, "S4", SENSORS["A"])
        one, _, _ = run(made, has_gyros=False)
        end = made.t_s > LASTS_S - 60.0
        lean = one.lean(float(made.t_s[-1]), 1.0)
        for measured, true, std in (
            (made.roll_rad, made.truth.roll_rad, hypot(lean.roll_std_rad, lean.late_roll_std_rad)),
            (made.pitch_rad, made.truth.pitch_rad, hypot(lean.pitch_std_rad, lean.late_pitch_std_rad)),
        ):
            off = (measured - true)[end]
            ratios.append(float(np.mean(off**2)) / (std**2 + SENSORS["A"].attitude_noise_rad ** 2))
    assert 0.05 < np.mean(ratios) < 1.7
    assert np.max(ratios) < 4.0


def test_a_hole_in_the_record_costs_little() -> None:
    one, raw, holed = run(recorded(8.0, 0.04), has_gyros=True, hole=range(2000, 2050))
    assert one.lean_per_s == pytest.approx(1.0 / 8.0, rel=0.1)
    assert np.isfinite(holed).all()
    assert below_waves(holed) < 0.9 * below_waves(raw)


def test_the_amendments_add_up_to_what_was_found_late() -> None:
    recording = recorded(8.0, 0.04)
    one, past = AttitudeError(), []
    slope = [np.gradient(angle, 1.0 / RATE_HZ) for angle in (recording.roll_rad, recording.pitch_rad)]
    for i, sample in enumerate(recording.samples()):
        assert isinstance(sample, ImuSample)
        roll, pitch = sample.roll_rad, sample.pitch_rad
        x, y, up = level_acceleration(sample.ax_mps2, sample.ay_mps2, sample.az_mps2, roll, pitch)
        up = one.step(sample.t_s, x, y, up, roll, pitch, slope[0][i], slope[1][i], are_rates_measured=False)
        past.append((sample.t_s, up))
        if one.amendment is not None:
            t_s = np.array(past)[:, 0]
            more = np.interp(t_s, one.amendment.t_s, one.amendment.more_mps2, left=0.0, right=0.0)
            past = list(zip(t_s.tolist(), (np.array(past)[:, 1] + more).tolist(), strict=True))
            one.amendment = None
    true = recording.truth.heave_acceleration_mps2
    first = slice(int(20.0 * RATE_HZ), int(180.0 * RATE_HZ))  # Nothing was known of it at the time.
    slow = butter(4, 0.05, fs=RATE_HZ, output="sos")
    amended, live = (
        sosfiltfilt(slow, off)[first] for off in (np.array(past)[:, 1] - true, run(recording, has_gyros=False)[2])
    )
    assert np.std(amended) < 0.6 * np.std(live)


def test_what_is_told_late_of_the_past_counts_as_if_it_had_been_known() -> None:
    """Leaks of 2 % from one axis into another: a record that is told of them is that of an acceleration without."""
    leaky = crooked(recorded(0.0, 0.0), Wrong(cross_axis=0.02))
    columns = (leaky.ax_mps2, leaky.ay_mps2, leaky.az_mps2, leaky.roll_rad, leaky.pitch_rad)
    leaked = 0.02 * np.array([sum(leaks_mps2(*row)[:5]) for row in zip(*(c.tolist() for c in columns), strict=True)])
    untold, told = (run(leaky, has_gyros=False)[0] for _ in range(2))
    known, _, _ = run(leaky, has_gyros=False, leaked=leaked)
    told.amend(Amendment(leaky.t_s, -leaked))
    up, as_known, wrong = (one.record.last(len(one.record))[:, UP] for one in (told, known, untold))
    assert np.std(up - as_known) < 0.02 * np.std(wrong - as_known)
    for one in (untold, told, known):
        one._look()
    assert (told.lean_per_s, told.late_s) == pytest.approx((known.lean_per_s, known.late_s), rel=0.02, abs=1e-4)
    assert abs(untold.late_s - known.late_s) > 10.0 * abs(told.late_s - known.late_s)


def test_noise_is_what_the_covariance_leaves_open() -> None:
    """Against errors drawn from it: their variance is the area under the density."""
    one, _, _ = run(recorded(8.0, 0.04), has_gyros=False)
    record_ = attitude_fit.runs(one.record.last(len(one.record)))
    solution, covariance = np.array([0.125, 0.04]), np.diag([1e-4, 1e-4])
    noise = attitude_fit.noise(record_, solution, covariance)
    assert noise is not None
    made = record_[0].made
    drawn = np.random.default_rng(1).multivariate_normal(np.zeros(2), covariance, 400)
    off = [attitude_fit.error(made, solution + one_off) - attitude_fit.error(made, solution) for one_off in drawn]
    band = butter(
        4, (noise.f_hz[0], noise.f_hz[-1]), btype="bandpass", fs=1.0 / attitude_fit.TUNING.row_s, output="sos"
    )
    variance = np.mean([np.var(sosfiltfilt(band, values)) for values in off])
    assert np.sum(noise.psd) * (noise.f_hz[1] - noise.f_hz[0]) == pytest.approx(variance, rel=0.35)


def test_bayes_average_against_a_grid() -> None:
    """Spikes and broad normals, integrated by brute force."""
    belief = Belief(np.diag([50.0, 0.0]), np.array([4.0, 0.0]), null=(0.0, 0.01), spread=(0.15, 0.1))
    information, right = np.array([[900.0, 300.0], [300.0, 2500.0]]), np.array([90.0, 120.0])
    mean, covariance, if_any = averaged(belief, information, right)
    A, b = belief.information + information, belief.right + right
    axis = [np.linspace(-1.0, 1.0, 2001), np.linspace(-1.0, 1.0, 2001)]
    total, first, second = 0.0, np.zeros(2), np.zeros((2, 2))
    of_any = np.zeros((2, 2))
    for broad in ((False, False), (True, False), (False, True), (True, True)):
        points = [axis[i] if broad[i] else np.zeros(1) for i in range(2)]
        off = np.stack(np.meshgrid(*points, indexing="ij"), -1).reshape(-1, 2)
        at = off + np.array(belief.null)
        density = np.exp(at @ b - 0.5 * np.einsum("pi,ij,pj->p", at, A, at))
        for i in range(2):
            if broad[i]:
                s = belief.spread[i]
                density = density * np.exp(-0.5 * (off[:, i] / s) ** 2) / (s * sqrt(2.0 * np.pi)) * 1e-3
        total += density.sum()
        first += density @ at
        second += np.einsum("p,pi,pj->ij", density, at, at)
        for i in range(2):
            if broad[i]:
                of_any[i] += density.sum(), density @ at[:, i] ** 2
    np.testing.assert_allclose(mean, first / total, rtol=1e-6)
    np.testing.assert_allclose(covariance, second / total - np.outer(mean, mean), rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(if_any, np.sqrt(of_any[:, 1] / of_any[:, 0]), rtol=1e-4)


def test_nothing_is_concluded_from_nothing() -> None:
    mean, covariance, if_any = averaged(NOTHING, np.zeros((2, 2)), np.zeros(2))
    np.testing.assert_allclose(if_any, attitude_fit.TUNING.usual)
    np.testing.assert_allclose(mean, 0.0)
    np.testing.assert_allclose(np.sqrt(2.0 * np.diag(covariance)), attitude_fit.TUNING.usual)


def test_a_lateness_that_was_measured_serves_from_the_first_sample() -> None:
    recording = recorded(inf, 0.08)
    slope = recording.truth.roll_rate_radps, recording.truth.pitch_rate_radps
    true = recording.truth.heave_acceleration_mps2
    errors = {}
    for told_s in (0.0, 0.08):
        one, off = AttitudeError(told_s), []
        assert one.angles_late_s == told_s
        for i, sample in enumerate(sample for sample in recording.samples() if isinstance(sample, ImuSample)):
            if sample.t_s > 120.0:
                break
            roll, pitch = sample.roll_rad, sample.pitch_rad
            x, y, up = level_acceleration(sample.ax_mps2, sample.ay_mps2, sample.az_mps2, roll, pitch)
            rates = slope[0][i], slope[1][i]
            off.append(one.step(sample.t_s, x, y, up, roll, pitch, *rates, are_rates_measured=False) - true[i])
        # Before three pieces of the record are there nothing else can know it.
        errors[told_s] = float(np.std(sosfiltfilt(butter(4, 0.4, fs=RATE_HZ, output="sos"), off)))
    assert errors[0.08] < 0.8 * errors[0.0]


def test_gyroscopes_are_believed_before_what_was_measured_once() -> None:
    recording = recorded(inf, 0.08)
    one = AttitudeError(0.2)
    for sample in recording.samples():
        assert isinstance(sample, ImuSample)
        roll, pitch = sample.roll_rad, sample.pitch_rad
        x, y, up = level_acceleration(sample.ax_mps2, sample.ay_mps2, sample.az_mps2, roll, pitch)
        rates = angle_rates(sample, roll, pitch)[:2]
        one.step(sample.t_s, x, y, up, roll, pitch, *rates, are_rates_measured=True)
        if sample.t_s > 60.0:
            break
    assert one.late_s == pytest.approx(0.08, abs=0.01)


def test_what_is_not_known_is_known_in_shape() -> None:
    """Against the corrected acceleration with either of the two a little larger, row by row."""
    recording, row_s, little = recorded(8.0, 0.04), attitude_fit.TUNING.row_s, 1e-4
    slope = [np.gradient(angle, 1.0 / RATE_HZ) for angle in (recording.roll_rad, recording.pitch_rad)]
    ones = [AttitudeError() for _ in range(3)]
    for one, lean, late_s in zip(ones, (0.1, 0.1 + little, 0.1), (0.03, 0.03, 0.03 + little), strict=True):
        one.lean_per_s, one.late_s = lean, late_s
    corrected: dict[int, list[list[float]]] = {}
    shapes: dict[int, tuple[float, float]] = {}
    for i, sample in enumerate(recording.samples()):
        assert isinstance(sample, ImuSample)
        if sample.t_s > 15.0:  # before the first look
            break
        roll, pitch = sample.roll_rad, sample.pitch_rad
        x, y, up = level_acceleration(sample.ax_mps2, sample.ay_mps2, sample.az_mps2, roll, pitch)
        given = sample.t_s, x, y, up, roll, pitch, slope[0][i], slope[1][i]
        ups = [one.step(*given, are_rates_measured=False) for one in ones]
        corrected.setdefault(int(sample.t_s // row_s), []).append(ups)
        if (unsized := ones[0].unsized) is not None:
            shapes[int(unsized.t_s // row_s)] = unsized.by_lean, unsized.by_lateness
            ones[0].unsized = None
    means = np.array([np.mean(corrected[row], axis=0) for row in shapes])
    expected = (means[:, :1] - means[:, 1:]) / little
    assert len(shapes) > 50
    assert np.all(np.std(np.array(list(shapes.values())) - expected, axis=0) < 0.1 * np.std(expected, axis=0))
