"""What a record shows, against signals whose noise, lines and clocks are known, and scipy's own spectra."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import butter, lfilter, welch

from heaved.setup.sensor_record import (
    age_spread_s,
    folded_hz,
    lines,
    measured,
    noise,
    pace,
    record_to_see_s,
    round_trips,
)

DENSITY = 1e-3


def white(seed: int, rate_hz: float, seconds: float, density: float = DENSITY) -> tuple[np.ndarray, np.ndarray]:
    """White noise of one-sided density N, sampled at f: N sqrt(f / 2) each."""
    rng = np.random.default_rng(seed)
    n = int(rate_hz * seconds)
    return np.arange(n) / rate_hz, 9.81 + density * math.sqrt(rate_hz / 2.0) * rng.standard_normal(n)


def jittered(rng: np.random.Generator, rate_hz: float, seconds: float) -> np.ndarray:
    """Poll times of a line: some early, some late, one in fifty held up."""
    steps = (1.0 + 0.1 * rng.uniform(-1.0, 1.0, int(rate_hz * seconds))) / rate_hz
    steps[::50] += 0.5 / rate_hz
    return np.cumsum(steps)


# ---- how often it measures -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("measures_hz", [7.0, 20.0, 50.0, 100.0, 120.0])
def test_a_sensor_slower_than_its_polls_is_timed(measures_hz: float) -> None:
    rng = np.random.default_rng(3)
    t_s = jittered(rng, 150.0, 10.0)
    reading = np.floor((t_s + 0.3 / measures_hz) * measures_hz)
    is_new = np.concatenate(([True], np.diff(reading) > 0))
    found = pace(t_s, is_new)
    assert found.kind == "clock"
    assert found.new_hz == pytest.approx(measures_hz, rel=0.005)
    times, values = measured(t_s, reading, is_new, found)
    assert len(times) == len(values) >= 0.9 * 10.0 * measures_hz
    assert np.all(np.diff(times) > 0)
    # Each value with the time at which it was measured, but for a constant and the polls that saw none.
    off = (times - values / measures_hz) * measures_hz
    assert np.std(off) < (0.1 if measures_hz <= 100.0 else 0.3)


@pytest.mark.parametrize("measures_hz", [7.0, 20.0, 50.0, 100.0])
def test_a_clock_is_seen_through_polls_that_are_held_up_for_long(measures_hz: float) -> None:
    """A machine that is busy otherwise: now and then nothing is asked for a tenth of a second."""
    rng = np.random.default_rng(6)
    steps = rng.uniform(0.7, 1.3, 3000) / 300.0
    steps[rng.uniform(size=len(steps)) < 0.006] += 0.1
    t_s = np.cumsum(steps)
    reading = np.floor(t_s * measures_hz)
    found = pace(t_s, np.concatenate(([True], np.diff(reading) > 0)))
    assert found.kind == "clock"
    assert found.new_hz == pytest.approx(measures_hz, rel=0.005)


def test_a_sensor_as_fast_as_its_polls_is_not_timed_beyond_them() -> None:
    t_s = jittered(np.random.default_rng(4), 40.0, 10.0)
    found = pace(t_s, np.ones(len(t_s), dtype=bool))
    assert found.kind == "every poll"
    assert found.new_hz == found.polls_hz == pytest.approx(40.0, rel=0.05)
    assert measured(t_s, t_s, np.ones(len(t_s), dtype=bool), found)[0] is t_s


@pytest.mark.parametrize("share", [0.3, 0.6, 0.85])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_values_that_repeat_by_chance_are_no_clock(share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    t_s = jittered(rng, 100.0, 10.0)
    assert pace(t_s, rng.uniform(size=len(t_s)) < share).kind == "by chance"


def test_of_few_new_values_nothing_is_said() -> None:
    t_s = np.arange(100) / 10.0
    assert pace(t_s, np.zeros(100, dtype=bool)).kind == "hardly"
    assert math.isnan(pace(t_s[:1], np.ones(1, dtype=bool)).polls_hz)
    assert math.isnan(pace(np.zeros(3), np.ones(3, dtype=bool)).polls_hz)


# ---- noise -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate_hz", "seconds"), [(20.0, 10.0), (100.0, 10.0), (100.0, 60.0)])
def test_the_density_of_white_noise(rate_hz: float, seconds: float) -> None:
    found = [noise(*white(seed, rate_hz, seconds)).density for seed in range(20)]
    assert np.mean(found) == pytest.approx(DENSITY, rel=0.05)
    assert np.std(found) < 0.15 * DENSITY


def test_lines_waves_and_the_low_pass_do_not_count_as_noise() -> None:
    t_s, x = white(5, 100.0, 40.0)
    b, a = butter(2, 20.0, fs=100.0)
    x = lfilter(b, a, x) + 0.5 * np.sin(2 * np.pi * 9.3 * t_s) + 0.4 * np.sin(2 * np.pi * 0.1 * t_s)
    found = noise(t_s, x, bandwidth_hz=20.0, moving=0.02, shaken_by=lines(t_s, x))
    assert found.density == pytest.approx(DENSITY, rel=0.12)
    assert found.is_moved
    assert math.isnan(found.walk)
    assert math.isnan(found.walk_limit)
    # Held against the spectrum of the noise alone, by scipy.
    f, power = welch(white(5, 100.0, 40.0)[1], 100.0, nperseg=256)
    assert found.density == pytest.approx(math.sqrt(np.mean(power[(f > 1.0) & (f < 45.0)])), rel=0.12)


def test_a_walk_is_seen_when_the_record_is_long_enough_and_bounded_before() -> None:
    walk, rate_hz = 2e-4, 20.0
    long_s = record_to_see_s(walk, DENSITY)
    seen, limits, short = [], [], []
    for seed in range(12):
        t_s, x = white(seed, rate_hz, 3.0 * long_s)
        steps = np.random.default_rng(100 + seed).standard_normal(len(x))
        walks = x + np.cumsum(steps) * walk / math.sqrt(rate_hz)
        found = noise(t_s, walks)
        seen.append(math.nan if math.isnan(found.walk) else found.walk)
        n = int(0.3 * long_s * rate_hz)
        early = noise(t_s[:n], walks[:n])
        short.append(math.isnan(early.walk))
        limits.append(early.walk_limit)
    assert np.sum(np.isfinite(seen)) >= 9
    assert np.nanmean(seen) == pytest.approx(walk, rel=0.5)
    assert sum(short) >= 10
    assert np.nanmedian(limits) > walk


def test_white_noise_alone_has_no_walk() -> None:
    found = [noise(*white(seed, 50.0, 30.0)) for seed in range(30)]
    assert sum(math.isnan(one.walk) for one in found) >= 28
    assert record_to_see_s(3e-5, DENSITY) == pytest.approx(280.0, rel=0.05)
    assert record_to_see_s(0.0, DENSITY) == math.inf


def test_of_a_record_too_short_or_too_slow_nothing_is_said() -> None:
    assert math.isnan(noise(*white(1, 100.0, 0.2)).density)
    assert math.isnan(noise(*white(1, 3.0, 100.0)).density)
    assert math.isnan(noise(np.zeros(0), np.zeros(0)).density)


def test_the_rounding_of_a_register_is_known_for_what_it_is() -> None:
    t_s, x = white(2, 100.0, 30.0, density=1e-2)
    step = 0.3
    found = noise(t_s, np.round(x / step) * step, step=step)
    # The density of step^2 / 12 over 50 Hz.
    assert found.steps == pytest.approx(math.sqrt(step**2 / 12.0 / 50.0))


def test_a_register_that_never_changes_says_nothing_but_its_rounding() -> None:
    t_s = np.arange(1000) / 100.0
    found = noise(t_s, np.full(1000, 9.81), step=0.005)
    assert found.density == pytest.approx(0.0, abs=1e-12)
    assert math.isnan(found.walk)
    assert found.steps == pytest.approx(0.005 / math.sqrt(600.0))


# ---- lines -----------------------------------------------------------------------------------------------------------


def test_lines_are_found_with_their_amplitudes_at_uneven_times() -> None:
    rng = np.random.default_rng(7)
    t_s = jittered(rng, 120.0, 10.0)
    x = 9.81 + 0.3 * np.sin(2 * np.pi * 0.12 * t_s) + 0.02 * rng.standard_normal(len(t_s))
    x += 0.10 * np.sin(2 * np.pi * 25.13 * t_s + 1.0) + 0.03 * np.sin(2 * np.pi * 41.7 * t_s)
    found = lines(t_s, x)
    assert [round(line.frequency_hz, 1) for line in found] == [25.1, 41.7]
    assert found[0].frequency_hz == pytest.approx(25.13, abs=0.01)
    assert [line.amplitude for line in found] == pytest.approx([0.10, 0.03], rel=0.1)


def test_noise_alone_has_no_lines() -> None:
    assert sum(bool(lines(*white(seed, 100.0, 5.0))) for seed in range(40)) <= 1


def short_waves(seed: int, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """The tail of a sea in the acceleration, which falls as the frequency rises and ends at 1.05 Hz."""
    rng = np.random.default_rng(seed)
    t_s = jittered(rng, 100.0, seconds)
    waves = np.arange(0.1, 1.05, 0.002)
    turns = 2 * np.pi * (np.outer(t_s, waves) + rng.random(len(waves)))
    return t_s, 9.81 + np.sin(turns) @ (0.01 / waves) + 0.005 * rng.standard_normal(len(t_s))


@pytest.mark.parametrize("seconds", [10.0, 60.0])
def test_short_waves_are_no_lines(seconds: float) -> None:
    assert sum(len(lines(*short_waves(seed, seconds))) for seed in range(20)) <= 2
    t_s, x = short_waves(99, seconds)
    found = lines(t_s, x + 0.2 * np.sin(2 * np.pi * 1.6 * t_s))
    assert [round(line.frequency_hz, 1) for line in found] == [1.6]
    assert found[0].amplitude == pytest.approx(0.2, rel=0.1)


def test_a_line_that_changes_its_strength_is_named_once() -> None:
    t_s = jittered(np.random.default_rng(8), 100.0, 10.0)
    found = lines(t_s, (0.1 + 0.02 * t_s) * np.sin(2 * np.pi * 7.3 * t_s))
    assert [round(line.frequency_hz, 1) for line in found] == [7.3]


def test_a_record_that_is_constant_or_short_has_no_lines() -> None:
    t_s = np.arange(1000) / 100.0
    assert lines(t_s, np.full(1000, 9.81)) == []
    assert lines(t_s[:10], np.sin(t_s[:10])) == []


FOLDS = [
    (25.1, 25.0, 0.1),
    (25.1, 100.0, 25.1),
    (49.0, 20.0, 9.0),
    (60.0, 20.0, 0.0),
    (3.0, 20.0, 3.0),
    (11.0, 20.0, 9.0),
]


@pytest.mark.parametrize(("frequency_hz", "rate_hz", "expected_hz"), FOLDS)
def test_what_a_line_folds_to(frequency_hz: float, rate_hz: float, expected_hz: float) -> None:
    assert folded_hz(frequency_hz, rate_hz) == pytest.approx(expected_hz, abs=1e-9)
    # Sampled so, the two cannot be told from each other.
    t_s = np.arange(50) / rate_hz
    assert np.cos(2 * np.pi * frequency_hz * t_s) == pytest.approx(np.cos(2 * np.pi * expected_hz * t_s), abs=1e-9)


# ---- answers ---------------------------------------------------------------------------------------------------------


def test_the_waiting_fits_the_slowest_answers() -> None:
    found = round_trips([0.020] * 95 + [0.024] * 4 + [0.050], 2)
    assert (found.answers, found.lost, found.median_s, found.worst_s) == (100, 2, 0.020, 0.050)
    # Half as long again as 24 ms; of the one of 50 it is not known whose it was.
    assert found.timeout_ms == 40.0
    assert round_trips([0.050] * 9, 0).timeout_ms == 75.0
    assert round_trips([0.001] * 10, 0).timeout_ms == 20.0
    assert round_trips([9.0] * 10, 0).timeout_ms == 10000.0
    assert math.isnan(round_trips([], 5).timeout_ms)


def test_the_age_of_an_answer_varies_as_the_clock_of_the_device_shows() -> None:
    t_s = np.arange(500) / 100.0
    # Asked every 10 ms, measured every 32: up to 32 ms old; its quartz runs off by 50 ppm.
    stamps = np.floor(t_s / 0.032) * 0.032 * (1.0 + 5e-5) + 4711.0
    assert age_spread_s(t_s, stamps) == pytest.approx(0.9 * 0.032, rel=0.1)
    assert math.isnan(age_spread_s(t_s, np.where(t_s < 2.5, stamps, 0.0)))
    assert math.isnan(age_spread_s(t_s[:5], stamps[:5]))
