"""Welch's average in blocks against that of scipy over the whole series."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import detrend, lfilter, welch

from heaved.report.spectra import ENOUGH, Spectra, Spectrum, Welch


@pytest.mark.parametrize("block", [1, 7, 256, 5000])
def test_is_that_of_scipy(block: int) -> None:
    rng = np.random.default_rng(1)
    dt, n = 0.05, 5000
    x: np.ndarray = lfilter([1.0], [1.0, -1.8, 0.9], rng.standard_normal(n)) + 3.0 + 0.001 * np.arange(n)
    t: np.ndarray = 1e6 + dt * np.arange(n)
    average = Welch(dt, 32.0)
    for begin in range(0, n if block > 1 else 1500, block):
        average.push(t[begin : begin + block], x[begin : begin + block])
    used = n if block > 1 else 1500
    f, expected = welch(x[:used], 1.0 / dt, window="hann", nperseg=640, noverlap=320, detrend=detrend)
    found = average.spectrum()
    assert found is not None
    assert found.segments == (used - 640) // 320 + 1
    assert found.f_hz == pytest.approx(f)
    assert found.density == pytest.approx(expected, rel=1e-5, abs=1e-9)


def test_uneven_times_are_brought_to_an_even_grid() -> None:
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.03, 0.07, 8000))
    x = np.sin(2.0 * np.pi * 0.25 * t)
    average = Welch(0.05, 64.0)
    average.push(t, x)
    found = average.spectrum()
    assert found is not None
    assert found.f_hz[np.argmax(found.density)] == pytest.approx(0.25, abs=1.0 / 64.0)
    assert found.variance == pytest.approx(0.5, rel=0.02)


def test_no_segment_reaches_across_a_hole() -> None:
    """Two stretches that are level in themselves, at levels far apart: across the hole there would be a step."""
    dt = 0.1
    t = np.concatenate((np.arange(400) * dt, 100.0 + np.arange(700) * dt))
    x = np.where(t < 50.0, 0.0, 100.0)
    x[200:210] = np.nan
    average = Welch(dt, 16.0)
    for part_t, part_x in zip(np.array_split(t, 9), np.array_split(x, 9), strict=True):
        average.push(part_t, part_x)
    found = average.spectrum()
    assert found is not None
    # 20 s, 19 s and 70 s hold 1, 1 and 7 segments of 16 s with half overlap.
    assert found.segments == 9
    assert float(found.density.max()) < 1e-15


def test_the_longest_segments_of_which_there_are_enough() -> None:
    rng = np.random.default_rng(4)
    spectra = Spectra(0.1)
    assert spectra.spectrum() is None
    t: np.ndarray = np.arange(6000) * 0.1
    spectra.push(t, rng.standard_normal(6000))
    found = spectra.spectrum()
    assert found is not None
    # 600 s: 8.375 segments of 128 s with half overlap, 3.7 of 256 s.
    assert found.segment_s == pytest.approx(128.0)
    assert found.segments == 8 >= ENOUGH


def test_a_short_series_has_the_shortest_segments() -> None:
    spectra = Spectra(0.1)
    t: np.ndarray = np.arange(400) * 0.1
    spectra.push(t, np.random.default_rng(5).standard_normal(400))
    found = spectra.spectrum()
    assert found is not None
    assert found.segment_s == pytest.approx(32.0)


def test_independent_time_of_a_first_order_process() -> None:
    """r = exp(-|tau| / T0): the integral of r^2 is T0. Its spectrum is 4 T0 / (1 + (2 pi f T0)^2)."""
    f = np.linspace(0.0, 200.0, 400_001)
    spectrum = Spectrum(f, 4.0 * 2.5 / (1.0 + (2.0 * np.pi * f * 2.5) ** 2), 1, 1.0)
    assert spectrum.independent_s == pytest.approx(2.5, rel=2e-3)


def test_the_mean_square_scatters_as_the_independent_time_says() -> None:
    rng = np.random.default_rng(6)
    dt, n, runs = 0.1, 3000, 400
    x = lfilter([1.0], [1.0, -0.95], rng.standard_normal((runs, n + 500)), axis=1)[:, 500:]
    squares = np.mean(x**2, axis=1)
    average = Welch(dt, 64.0)
    t: np.ndarray = np.arange(n) * dt
    for k in range(40):
        average.push(t + 1e4 * k, x[k])
    found = average.spectrum()
    assert found is not None
    expected = np.sqrt(2.0 * found.independent_s / (n * dt))
    assert squares.std() / squares.mean() == pytest.approx(expected, rel=0.15)
