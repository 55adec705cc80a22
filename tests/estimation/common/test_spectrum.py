"""Oracles: tones of known frequency, and seas of known variance."""

import numpy as np
import pytest

from heaved.estimation.common.spectrum import dominant_frequencies, heave_spectrum, resample

BAND_HZ = (0.04, 0.6)
HIGHPASS_HZ = 1.0 / 16.0
WINDOW_S = 30.0
BIN_HZ = 1.0 / WINDOW_S


def acceleration(t: np.ndarray, *tones: tuple[float, float, float]) -> np.ndarray:
    """Of heave made of (amplitude m, frequency Hz, phase rad)."""
    return np.asarray(
        -np.sum([A * (2 * np.pi * f) ** 2 * np.sin(2 * np.pi * f * t + phase) for A, f, phase in tones], axis=0)
    )


def found(t: np.ndarray, a: np.ndarray, count: int = 1, band: tuple[float, float] = BAND_HZ) -> np.ndarray:
    return dominant_frequencies(t, a, count, band, HIGHPASS_HZ)


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 20.0, 100.0, 200.0])
@pytest.mark.parametrize("period_s", [2.5, 4.0, 5.0, 6.3, 8.0])
def test_a_tone_is_found_within_a_twentieth_of_a_bin(rate_hz: float, period_s: float) -> None:
    t = 1000.0 + np.arange(0.0, WINDOW_S, 1.0 / rate_hz)
    for phase in np.arange(8) * np.pi / 4:
        f = found(t, acceleration(t, (0.05, 1.0 / period_s, phase)))
        assert f == pytest.approx([1.0 / period_s], abs=BIN_HZ / 20)


@pytest.mark.parametrize("period_s", [10.0, 12.0, 16.0, 18.0])
def test_a_long_swell_of_two_periods_is_found_within_a_fifth_of_a_bin(period_s: float) -> None:
    t = np.arange(0.0, WINDOW_S, 0.05)
    for phase in np.arange(8) * np.pi / 4:
        f = found(t, acceleration(t, (1.0, 1.0 / period_s, phase)))
        assert f == pytest.approx([1.0 / period_s], abs=BIN_HZ / 5)


def test_irregular_sampling_bias_and_trend_change_nothing() -> None:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.01, 0.12, 500))
    t = t[t < WINDOW_S + t[0]]
    a = acceleration(t, (0.03, 0.17, 0.4)) + 0.3 - 0.005 * t + 1e-3 * rng.standard_normal(len(t))
    assert found(t, a) == pytest.approx([0.17], abs=BIN_HZ / 10)


def test_two_tones_come_in_ascending_order_and_the_larger_heave_comes_first_when_one_is_asked() -> None:
    t = np.arange(0.0, WINDOW_S, 0.05)
    # The acceleration of the short wave is the larger, its heave the smaller.
    a = acceleration(t, (0.10, 0.11, 0.3), (0.02, 0.30, 1.0))
    assert np.ptp(acceleration(t, (0.02, 0.30, 1.0))) > 1.4 * np.ptp(acceleration(t, (0.10, 0.11, 0.3)))
    assert found(t, a, 2) == pytest.approx([0.11, 0.30], abs=BIN_HZ / 5)
    assert found(t, a, 1) == pytest.approx([0.11], abs=BIN_HZ / 5)


def test_fewer_peaks_than_asked_give_fewer_frequencies() -> None:
    t = np.arange(0.0, WINDOW_S, 0.1)
    assert len(found(t, np.zeros(300), 3)) == 0
    assert len(found(t, np.full(300, 0.7), 3)) == 0
    assert len(found(t[:5], np.ones(5))) == 0
    assert len(found(t[:1], np.ones(1))) == 0
    # One tone and its side lobes: whatever else is named lies a resolution away, and the tone is among them.
    several = found(t, acceleration(t, (0.05, 0.2, 0.0)), 8)
    assert np.min(np.abs(several - 0.2)) < BIN_HZ / 20
    assert np.all(np.diff(several) > BIN_HZ)


def test_what_lies_outside_the_band_is_not_named() -> None:
    t = np.arange(0.0, WINDOW_S, 0.05)
    a = acceleration(t, (5.0, 0.02, 0.0), (0.05, 0.2, 0.0), (0.05, 0.9, 0.0))
    assert np.all((found(t, a, 4) >= BAND_HZ[0]) & (found(t, a, 4) <= BAND_HZ[1]))
    t = np.arange(0.0, WINDOW_S, 0.1)
    for f in np.linspace(0.599, 0.602, 13):
        for phase in np.arange(8) * np.pi / 4:
            named = dominant_frequencies(t, acceleration(t, (1.0, f, phase)), 1, BAND_HZ, 1.0 / 5.0)
            assert np.all(named <= BAND_HZ[1]), f  # the refined peak too


def test_resample_is_linear_interpolation() -> None:
    t = np.array([2.0, 2.05, 2.3, 3.0])
    assert resample(t, 4.0 * t - 1.0) == pytest.approx(4.0 * np.arange(2.0, 3.0, 0.1) - 1.0)


@pytest.mark.parametrize("rate_hz", [10.0, 50.0])
@pytest.mark.parametrize(("f0", "excess"), [(0.08, 0.20), (0.13, 0.08), (0.3, 0.02)])
def test_heave_spectrum_holds_the_variance_of_a_tone(rate_hz: float, f0: float, excess: float) -> None:
    """The lower skirt of the window's line weighs more after the division by omega^4: never less than the truth."""
    t = np.arange(0.0, 120.0, 1.0 / rate_hz)
    f, S = heave_spectrum(t, acceleration(t, (0.4, f0, 0.2)) + 0.5 + 1e-3 * t, BAND_HZ, 60.0)
    assert 1.0 <= np.sum(S) * (f[1] - f[0]) / (0.4**2 / 2) < 1.0 + excess
    assert abs(f[np.argmax(S)] - f0) <= f[1] - f[0]


def test_heave_spectrum_follows_the_density_of_a_broad_sea() -> None:
    """200 lines with the energy of a flat acceleration density between 0.1 and 0.4 Hz; average over 20 records."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 120.0, 0.1)
    lines = np.linspace(0.1, 0.4, 201)
    density, total = 2e-3, []  # (m/s2)^2/Hz
    for _ in range(20):
        phases = rng.uniform(0.0, 2 * np.pi, len(lines))
        A = np.sqrt(2 * density * (lines[1] - lines[0]))
        a = A * np.sum(np.cos(2 * np.pi * lines[:, None] * t + phases[:, None]), axis=0)
        f, S = heave_spectrum(t, a, BAND_HZ, 60.0)
        total.append(S)
    inside = (f > 0.13) & (f < 0.37)
    ratio = np.mean(total, axis=0)[inside] * (2 * np.pi * f[inside]) ** 4 / density
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.06)  # 60 averages of a chi-square with 2 degrees of freedom
    assert np.all((f >= BAND_HZ[0]) & (f <= BAND_HZ[1]))


@pytest.mark.parametrize("constant", [0.0, 0.7, -9.80665])
def test_the_rounding_of_a_straight_line_has_a_spectrum_of_zero(constant: float) -> None:
    t = 1000.0 + np.arange(0.0, 120.0, 0.05)
    f, S = heave_spectrum(t, constant + 1e-4 * (t - 1000.0), BAND_HZ, 60.0)
    assert len(f) > 20
    assert np.all(S == 0.0)


def test_too_short_a_record_has_no_spectrum() -> None:
    f, S = heave_spectrum(np.arange(5.0) * 0.1, np.ones(5), BAND_HZ, 60.0)
    assert len(f) == len(S) == 0
