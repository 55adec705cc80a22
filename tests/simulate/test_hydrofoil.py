"""The simulated craft: the sea against its spectrum and the geometry of encounter, the sensors against their noise."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.signal import welch

from heaved.simulate.hydrofoil import RAMP_S, Hull, Passage, Voyage, sail, significant_height_m, waves

Array = NDArray[np.float64]
HULL = Hull(heave_force_ps2=3.0, pitch_force_ps2=4.0, foil_arms_m=(6.0, -7.0), foil_depths_m=(1.3, 0.9))
STEADY = Passage(stages=((0.0, 2.0),), duration_s=60.0)
OMEGA, DAMPING = np.array([[2.0], [2.5]]), np.array([[1.5], [2.0]])


def oscillators(state: Array, speed: float, flaps: Array, water: Array, elevation: Array) -> Array:
    """A craft of two damped springs that the foils and the water at them push a little."""
    position, velocity = state[0::2], state[1::2]
    push = 0.5 * water + 0.3 * elevation + flaps
    return -(OMEGA**2) * position - DAMPING * velocity + push


def test_the_same_seed_is_the_same_voyage() -> None:
    first, again, other = (sail(oscillators, (0.0, 0.0), (seed,), STEADY, HULL)[0] for seed in (1, 1, 2))
    for name in Voyage.__struct_fields__:
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert not np.allclose(first.heave_m, other.heave_m)


def test_voyages_side_by_side_are_those_alone() -> None:
    together = sail(oscillators, (0.0, 0.0), (3, 4), STEADY, HULL)
    for seed, made in zip((3, 4), together, strict=True):
        alone = sail(oscillators, (0.0, 0.0), (seed,), STEADY, HULL)[0]
        np.testing.assert_allclose(made.truth, alone.truth, rtol=0, atol=1e-12)
        np.testing.assert_allclose(made.measured_heave_m, alone.measured_heave_m, rtol=0, atol=1e-12)


def test_the_elevation_has_the_height_and_the_frequencies_of_encounter() -> None:
    """Hs is four times its standard deviation; head on, omega becomes omega + omega^2 U / g, stopped it stays."""
    t = np.arange(0.0, 3000.0, 0.1)
    for speed in (0.0, 18.0):
        passage = msgspec.structs.replace(STEADY, speed_mps=speed)
        elevation = waves(HULL, passage, t, np.random.default_rng(1)).elevation_m[0]
        # The band that is simulated leaves out 2 % of the energy.
        assert 4.0 * np.std(elevation) == pytest.approx(2.0, rel=0.05)
        f, power = welch(elevation, 10.0, nperseg=1024)
        peak = 2.0 * np.pi / passage.peak_period_s
        assert 2.0 * np.pi * f[np.argmax(power)] == pytest.approx(peak + peak**2 * speed / 9.80665, rel=0.15)


def test_the_water_at_the_foils_belongs_to_the_elevation_above_them() -> None:
    """Stopped, and at no depth, the water's vertical speed is the rate of the elevation; depth only takes from it."""
    t = np.arange(0.0, 200.0, 0.01)
    at_surface = msgspec.structs.replace(HULL, foil_depths_m=(0.0, 2.0))
    sea = waves(at_surface, msgspec.structs.replace(STEADY, speed_mps=0.0), t, np.random.default_rng(2))
    rate = np.gradient(sea.elevation_m, t, axis=1)
    np.testing.assert_allclose(sea.water_mps[0, 1:-1], rate[0, 1:-1], atol=2e-3 * np.abs(rate).max())
    assert np.std(sea.water_mps[1]) < 0.9 * np.std(rate[1])


def test_the_fore_foil_meets_the_waves_first() -> None:
    """Long waves at speed: the aft foil sees what the fore foil saw its distance over (phase speed plus U) before."""
    t = np.arange(0.0, 600.0, 0.01)
    passage = msgspec.structs.replace(STEADY, peak_period_s=9.0)
    fore, aft = waves(HULL, passage, t, np.random.default_rng(3)).elevation_m
    lags = range(-200, 201)
    best = max(lags, key=lambda lag: float(np.dot(fore[300:-300], aft[300 + lag : len(aft) - 300 + lag])))
    phase_speed = 9.80665 * passage.peak_period_s / (2.0 * np.pi)
    assert 0.01 * best == pytest.approx(13.0 / (phase_speed + passage.speed_mps), rel=0.2)


def test_long_waves_lift_the_whole_hull_and_short_ones_cancel() -> None:
    t = np.arange(0.0, 2000.0, 0.1)
    for period, low, high in ((20.0, 0.8, 1.0), (3.0, 0.0, 0.2)):
        sea = waves(HULL, msgspec.structs.replace(STEADY, peak_period_s=period), t, np.random.default_rng(4))
        ratio = np.std(sea.force[0]) / (HULL.heave_force_ps2 * np.std(sea.elevation_m[0]))
        assert low < ratio < high


def test_the_sea_steps_as_it_is_told() -> None:
    passage = Passage(stages=((0.0, 0.3), (80.0, 2.5), (160.0, 0.3)))
    t = np.array([0.0, 80.0 - RAMP_S / 2, 80.0, 80.0 + RAMP_S / 2, 159.0 - RAMP_S / 2, 165.0])
    np.testing.assert_allclose(significant_height_m(passage, t), [0.3, 0.3, 1.4, 2.5, 2.5, 0.3], atol=1e-12)


def test_the_motion_obeys_the_equations_that_were_handed_in() -> None:
    """The same forces through a far better solver, sample by sample, because the flaps are held between them."""
    passage = msgspec.structs.replace(STEADY, duration_s=6.0)
    made = sail(oscillators, (0.1, 0.02), (5,), passage, HULL)[0]

    def rate(t: float, state: Array, flaps: Array) -> Array:
        sea = waves(HULL, passage, np.array([t]), np.random.default_rng([5, 0x5EA]))
        pushed = oscillators(state[:, None], 18.0, flaps[:, None], sea.water_mps, sea.elevation_m) + sea.force
        return np.array([state[1], pushed[0, 0], state[3], pushed[1, 0]])

    state = np.array([0.1, 0.0, 0.02, 0.0])
    for k in range(20):
        np.testing.assert_allclose(made.truth[:, k], state, atol=1e-5)
        flaps = np.array([made.flap_fore_rad[k], made.flap_aft_rad[k]])
        span = (made.t_s[k], made.t_s[k + 1])
        state = solve_ivp(rate, span, state, args=(flaps,), rtol=1e-9, atol=1e-11).y[:, -1]


def test_the_sensors_are_as_noisy_as_they_are_told() -> None:
    passage = msgspec.structs.replace(STEADY, duration_s=300.0)
    made = sail(oscillators, (0.0, 0.0), (6,), passage, HULL)[0]
    wrong = sail(oscillators, (0.0, 0.0), (6,), msgspec.structs.replace(passage, outlier_share=0.02), HULL)[0]
    for measured, truth, outlying, std in (
        (made.measured_heave_m, made.heave_m, wrong.measured_heave_m, passage.heave_noise_m),
        (made.measured_pitch_rad, made.pitch_rad, wrong.measured_pitch_rad, passage.pitch_noise_rad),
    ):
        noise = measured - truth
        assert np.std(noise) == pytest.approx(std, rel=0.05)
        assert abs(np.corrcoef(noise[:-1], noise[1:])[0, 1]) < 0.05
        off = np.abs(outlying - measured) / std
        assert np.mean(off > 0.0) == pytest.approx(0.02, abs=0.006)
        assert np.all((off < 1e-9) | ((off >= 5.0 - 1e-9) & (off <= 20.0 + 1e-9)))
    np.testing.assert_array_equal(made.truth, wrong.truth)


def test_the_flaps_oppose_the_pitch_within_their_limit() -> None:
    passage = msgspec.structs.replace(STEADY, flap_limit_rad=0.01)
    made = sail(oscillators, (0.0, 0.0), (7,), passage, HULL)[0]
    assert np.max(np.abs(made.flap_fore_rad)) <= 0.01
    np.testing.assert_array_equal(made.flap_fore_rad, -made.flap_aft_rad)
    free = sail(oscillators, (0.0, 0.0), (7,), msgspec.structs.replace(STEADY, flap_limit_rad=1.0), HULL)[0]
    # What is asked for, delayed by a lag of 0.15 s: nearly the asked one, a little late.
    asked = -(STEADY.flap_gain[0] * free.pitch_rad + STEADY.flap_gain[1] * free.pitch_rate_radps)
    delays = [np.corrcoef(asked[100 : 1000 - d], free.flap_fore_rad[100 + d : 1000])[0, 1] for d in range(10)]
    assert max(delays) > 0.98
    assert 2 <= int(np.argmax(delays)) <= 4
