"""Oracles: scipy's matrix exponential, tones whose heave is known, and seas."""

from collections.abc import Iterable

import numpy as np
import pytest
from scipy.linalg import expm

from heaved.estimation.heave.harmonic.observer import HarmonicObserver
from heaved.estimation.heave.observer import SavedObserver
from heaved.estimation.heave.params import Params
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import record


def rotation(omega: np.ndarray, dt: float) -> np.ndarray:
    """F = expm(A dt) of x = [h1, h1', ..., dh], Zhang et al. 2022 (UKF multi-step + BP), eq. (12)-(13)."""
    A = np.zeros((2 * len(omega) + 1,) * 2)
    for i, w in enumerate(omega):
        A[2 * i, 2 * i + 1] = 1.0
        A[2 * i + 1, 2 * i] = -(w**2)
    return expm(A * dt)


def irregular(rng: np.random.Generator, duration_s: float, low: float = 0.01, high: float = 0.14) -> np.ndarray:
    times = np.cumsum(rng.uniform(low, high, int(2.5 * duration_s / (low + high))))
    return times[times < duration_s]


def feed(observer: HarmonicObserver, times: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Rows of heave, velocity and standard deviation at every sample."""
    rows = []
    for t, value in zip(times.tolist(), a.tolist(), strict=True):
        observer.step(t, value)
        motion = observer.at(0.0)
        rows.append((motion.heave_m, motion.velocity_mps, observer.error_std_m(0.0)))
    return np.array(rows)


def tone(t: np.ndarray, period_s: float, amplitude_m: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Heave and its acceleration."""
    w = 2.0 * np.pi / period_s
    heave = amplitude_m * np.sin(w * t)
    return heave, -(w**2) * heave


def rms(values: Iterable[float]) -> float:
    return float(np.sqrt(np.mean(np.square(np.asarray(values)))))


# --- the filter ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("components", [1, 2])
def test_a_shift_is_a_power_of_the_transition_matrix(components: int) -> None:
    """The state is recovered from outputs at 2n shifts by expm; every other shift must follow from it."""
    observer = HarmonicObserver(Params(components=components))
    t = np.arange(0.0, 40.0, 0.05)
    feed(observer, t, tone(t, 6.0)[1] + 0.3 * tone(t, 9.0)[1])
    omega = 2.0 * np.pi * np.array(observer.frequencies_hz)
    H = np.array([1.0, 0.0] * components)

    def row(shift: float) -> np.ndarray:
        return np.asarray(H @ rotation(omega, shift)[:-1, :-1])

    known = 0.9 * np.arange(2 * components)
    x = np.linalg.solve(np.array([row(s) for s in known]), [observer.at(s).heave_m for s in known])
    for shift in (-7.3, -1.0, 0.05, 2.4, 11.0):
        F = rotation(omega, shift)[:-1, :-1]
        assert observer.at(shift).heave_m == pytest.approx(H @ F @ x, abs=1e-9)
        assert observer.at(shift).velocity_mps == pytest.approx(np.sum((F @ x)[1::2]), abs=1e-9)
    lead_s = 0.37
    assert observer.at(0.0, lead_s).heave_m == pytest.approx(observer.at(-lead_s).heave_m, abs=1e-12)


def test_a_measurement_that_leads_is_moved_back() -> None:
    """The unshifted output leads the truth; the published one takes just that lead off."""
    t = np.arange(0.0, 70.0, 0.05)
    a = tone(t, 6.0)[1]
    observer = HarmonicObserver(Params())
    unshifted = []
    for time, value in zip(t.tolist(), a.tolist(), strict=True):
        observer.step(time, value)
        unshifted.append(observer.unshifted().heave_m)
    last = t > 50.0
    lags = np.arange(-40, 41)
    match = [np.dot(np.array(unshifted)[last], np.sin(2 * np.pi / 6.0 * (t[last] + 0.05 * k))) for k in lags]
    early_s = 0.05 * lags[int(np.argmax(match))]
    assert early_s > 0.3
    assert observer.design_lead_s == pytest.approx(early_s, abs=0.05)


# --- the whole chain -------------------------------------------------------------------------------------------------

CHAIN = [(T, rate) for T in (5.0, 8.0, 12.0) for rate in (10.0, 20.0, 50.0, None)] + [(8.0, 100.0), (8.0, 200.0)]


@pytest.mark.parametrize(("period_s", "rate_hz"), CHAIN)
def test_a_tone_comes_out_with_its_amplitude_and_phase(period_s: float, rate_hz: float | None) -> None:
    """At any rate alike, and the published standard deviation is never below the error of the settled chain."""
    t = irregular(np.random.default_rng(6), 80.0) if rate_hz is None else np.arange(0.0, 80.0, 1.0 / rate_hz)
    heave, a = tone(t, period_s)
    out = feed(HarmonicObserver(Params()), t, a + 0.05)
    late = t > 55.0
    w = 2.0 * np.pi / period_s
    basis = np.column_stack((np.sin(w * t), np.cos(w * t), np.ones(len(t))))[late]
    s, c, _ = np.linalg.lstsq(basis, out[late, 0], rcond=None)[0]
    assert np.hypot(s, c) == pytest.approx(1.0, abs=0.03)
    assert np.arctan2(c, s) == pytest.approx(0.0, abs=0.03 if period_s < 6 else 0.06 if period_s < 9 else 0.14)  # rad
    assert rms((out[:, 1] - w * np.cos(w * t))[late]) < 0.14 * w
    error = rms((out[:, 0] - heave)[late])
    assert error <= rms(out[late, 2])
    assert error < 0.14


def test_the_rate_changes_nothing_to_speak_of() -> None:
    """The same tone at 10 and 50 Hz: the outputs at common moments agree."""
    outputs = {}
    for rate in (10.0, 50.0):
        t = np.arange(0.0, 60.0, 1.0 / rate)
        outputs[rate] = feed(HarmonicObserver(Params()), t, tone(t, 7.3)[1])[:: int(rate / 10.0), 0][400:]
    assert outputs[10.0] == pytest.approx(outputs[50.0], abs=0.03)


@pytest.mark.parametrize(
    ("name", "low", "high"), [("T1", 1.0, 2.2), ("T2", 1.0, 2.2), ("T3", 1.0, 2.6), ("S4", 0.8, 1.5)]
)
def test_the_published_deviation_is_that_of_the_error(name: str, low: float, high: float) -> None:
    """Wave trains and an irregular sea: between the realised error and a bounded excess over it."""
    r = record(seaway(name, 3, attitude=False), 260.0, imu_rate_hz=10.0, sensor="A", laser="off", seed=3)
    out = feed(HarmonicObserver(Params()), r.t_s, r.az_mps2 - 9.80665)
    late = r.t_s > 80.0
    assert low < rms(out[late, 2]) / rms((out[:, 0] - r.truth.heave_m)[late]) < high


def test_far_from_time_zero_it_is_the_same() -> None:
    t = np.arange(0.0, 40.0, 0.0625)  # exact in binary at 1e6 too
    a = tone(t, 6.0)[1]
    assert feed(HarmonicObserver(Params()), t + 2.0**20, a) == pytest.approx(
        feed(HarmonicObserver(Params()), t, a), abs=1e-6, nan_ok=True
    )


# --- gaps, resets, odd input -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("gap_s", [0.3, 1.0, 2.0, 4.9])
@pytest.mark.parametrize("period_s", [5.0, 8.0])
def test_a_gap_is_bridged_and_the_deviation_says_what_it_cost(gap_s: float, period_s: float) -> None:
    t = np.arange(0.0, 130.0, 0.05)
    t = t[(t < 80.0) | (t >= 80.0 + gap_s)]
    heave, a = tone(t, period_s)
    observer = HarmonicObserver(Params())
    out = feed(observer, t, a + 0.02)
    error, std = out[:, 0] - heave, out[:, 2]
    after = (t >= 80.0 + gap_s) & (t < 90.0 + gap_s)
    assert not observer.resets
    assert rms(error[after]) < 0.15  # of an amplitude of 1
    assert np.mean(np.abs(error[after]) < 1.96 * std[after]) > 0.9
    settled = rms(error[(t > 60.0) & (t < 80.0)])
    assert rms(error[t > 110.0]) < settled + 0.01


def test_a_gap_does_not_enter_the_search_as_a_straight_line() -> None:
    """A gap of one period on a small wave train once made the search name 0.05 Hz for half a minute."""
    r = record(seaway("T1", 1, attitude=False), 340.0, imu_rate_hz=10.0, sensor="A", laser="off", seed=1)
    keep = (r.t_s < 300.0) | (r.t_s >= 304.9)
    observer = HarmonicObserver(Params())
    frequencies = []
    out = []
    for t, az in zip(r.t_s[keep].tolist(), r.az_mps2[keep].tolist(), strict=True):
        observer.step(t, az - 9.80665)
        out.append(observer.at(0.0).heave_m)
        frequencies.append(observer.frequencies_hz[0])
    assert np.ptp(np.array(frequencies)[r.t_s[keep] > 200.0]) < 0.02
    assert rms((np.array(out) - r.truth.heave_m[keep])[r.t_s[keep] > 315.0]) < 0.004


def test_after_a_gap_the_deviation_is_that_of_a_forecast_as_long() -> None:
    """On a wave train, whose settled error is small; the next search is due within the gap and has to wait."""
    r = record(seaway("T2", 1, attitude=False), 232.0, imu_rate_hz=10.0, sensor="A", laser="off", seed=1)
    keep = (r.t_s < 202.0) | (r.t_s >= 206.9)
    observer = HarmonicObserver(Params())
    t, a = r.t_s[keep], r.az_mps2[keep] - 9.80665
    first = t < 209.0
    out = feed(observer, t[first], a[first])
    modelled = observer.error_std_m(0.0, 1e6) / 1e6  # without what the gap adds
    assert modelled == pytest.approx(out[t[first] < 202.0][-1, 2], rel=0.3)
    out = np.concatenate((out, feed(observer, t[~first], a[~first])))
    error, std = out[:, 0] - r.truth.heave_m[keep], out[:, 2]
    after = (t >= 206.9) & (t < 212.0)
    assert rms(error[after]) > 1.5 * rms(error[(t > 150.0) & (t < 202.0)])  # or the test shows nothing
    assert rms(error[after]) < 1.2 * rms(std[after])
    assert rms(std[t > 225.0]) < 0.6 * rms(std[after])


def test_a_longer_gap_starts_again_and_is_counted() -> None:
    t = np.arange(0.0, 60.0, 0.05)
    observer = HarmonicObserver(Params())
    feed(observer, t, tone(t, 6.0)[1])
    frequencies = observer.frequencies_hz
    assert np.isfinite(observer.error_std_m(0.0))
    observer.step(t[-1] + 5.2, 0.1)
    assert dict(observer.resets) == {"gap": 1}
    assert observer.settled_s == 0.0
    assert np.isnan(observer.error_std_m(0.0))
    assert observer.frequencies_hz == frequencies
    t = np.arange(100.0, 190.0, 0.05)
    heave, a = tone(t, 6.0)
    out = feed(observer, t, a)
    assert dict(observer.resets) == {"gap": 2}
    assert rms((out[:, 0] - heave)[t > 170.0]) < 0.02
    fresh = HarmonicObserver(Params())
    fresh.restore(SavedObserver(frequencies_hz=frequencies))
    assert feed(fresh, t, a) == pytest.approx(out, abs=1e-12, nan_ok=True)  # nothing is left of what was before


def test_what_is_missing_is_passed_over() -> None:
    t = np.arange(0.0, 30.0, 0.05)
    a = tone(t, 6.0)[1]
    with_holes, without = HarmonicObserver(Params()), HarmonicObserver(Params())
    keep = np.random.default_rng(8).random(len(t)) > 0.3
    feed(with_holes, t[:-1], np.where(keep, a, np.nan)[:-1])
    feed(without, t[:-1][keep[:-1]], a[:-1][keep[:-1]])
    assert with_holes.at(0.3) == without.at(0.3)
    assert np.isnan(HarmonicObserver(Params()).settled_s)


@pytest.mark.parametrize("still", [0.0, 0.7])
def test_a_long_stillness_and_then_a_sea(still: float) -> None:
    """A still ship, or a constant bias, gives no heave and no nan; the sea that follows is found again."""
    t = np.arange(0.0, 400.0, 0.1)
    heave, a = tone(t, 6.0)
    calm = t < 280.0
    observer = HarmonicObserver(Params())
    out = feed(observer, t, np.where(calm, still, a + still))
    assert np.isfinite(out[t > 16.0]).all()
    assert rms(out[calm & (t > 90.0), 0]) < 1e-3  # by then the 4.5 m to which a bias of 0.7 integrates have died out
    assert not observer.resets
    assert rms((out[:, 0] - heave)[t > 360.0]) < 0.05


def test_the_rounding_of_a_constant_is_no_sea() -> None:
    """Lead and gain once were fitted to it: the last bit of a bias, or another processor, then changed the heave."""
    t = np.arange(0.0, 90.0, 0.1)
    outputs = []
    for still in (0.7, np.nextafter(0.7, 1.0), 0.7 + 1e-13):
        observer = HarmonicObserver(Params())
        outputs.append(feed(observer, t, np.full(len(t), still)))
    assert outputs[1] == pytest.approx(outputs[0], abs=1e-9, nan_ok=True)
    assert outputs[2] == pytest.approx(outputs[0], abs=1e-9, nan_ok=True)


def test_values_beyond_all_bounds_are_survived() -> None:
    """What a float32 register can hold: the filter starts again rather than stay at infinity."""
    t = np.arange(0.0, 220.0, 0.1)
    heave, a = tone(t, 6.0)
    a[600:610] = [3e38, -3e38] * 5
    observer = HarmonicObserver(Params())
    with np.errstate(all="ignore"):
        out = feed(observer, t, a)
    assert observer.resets["covariance"] >= 1
    assert rms((out[:, 0] - heave)[t > 200.0]) < 0.05


def test_a_sensor_of_four_readings_a_second_is_not_all_gaps() -> None:
    t = np.arange(0.0, 200.0, 0.25)
    heave, a = tone(t, 8.0)
    out = feed(HarmonicObserver(Params()), t, a)
    assert rms((out[:, 0] - heave)[t > 140.0]) < 0.06
    assert rms(out[t > 140.0, 2]) > rms((out[:, 0] - heave)[t > 140.0])


# --- memory ----------------------------------------------------------------------------------------------------------


def test_restored_frequencies_are_used_from_the_first_sample() -> None:
    observer = HarmonicObserver(Params(components=2))
    observer.restore(SavedObserver(frequencies_hz=(0.21, 0.11)))
    assert observer.frequencies_hz == pytest.approx((0.11, 0.21))


@pytest.mark.parametrize("frequencies", [(0.1, 0.2), (0.01,), (0.7,), (float("nan"),)])
def test_restored_frequencies_that_do_not_fit_are_refused(frequencies: tuple[float, ...]) -> None:
    observer = HarmonicObserver(Params())
    before = observer.frequencies_hz
    with pytest.raises(ValueError, match=r"do not fit the configured 1 in 0\.04\.\.0\.6 Hz"):
        observer.restore(SavedObserver(frequencies_hz=frequencies))
    assert observer.frequencies_hz == before


def test_what_is_saved_of_a_sea_is_nothing_to_a_harmonic_observer() -> None:
    observer = HarmonicObserver(Params())
    before = observer.frequencies_hz
    observer.restore(SavedObserver())
    assert observer.frequencies_hz == before


def test_whatever_was_found_can_be_restored() -> None:
    """Swell at the very edge of the band: a peak refined past it must not be saved as something to be refused."""
    t = np.arange(0.0, 45.0, 0.1)
    for period_s in (22.0, 25.0, 30.0):
        observer = HarmonicObserver(Params())
        feed(observer, t, tone(t, period_s)[1])
        HarmonicObserver(Params()).restore(observer.saved())
