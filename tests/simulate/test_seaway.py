"""Seaways against numerical differentiation, their own target spectrum, and the arithmetic of JONSWAP."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import welch

from heaved.simulate.seaway import (
    MEAN_HEADING_RAD,
    NAMES,
    SEAS,
    WaveSystem,
    heave_spectrum,
    seaway,
    vessel_on,
    wave_spectrum,
)

MOVING = [name for name in NAMES if name != "S0"]


@pytest.mark.parametrize("name", MOVING)
def test_velocities_and_accelerations_are_derivatives_also_while_the_sea_grows(name: str) -> None:
    sea = seaway(name, seed=3)
    for t0 in (12.0, 615.0, 1290.0):  # calm, growing and falling part of SX
        h = 4e-4
        t = t0 + np.arange(-50.0, 51.0) * h
        m = sea.motion(t)
        pairs = [
            (m.heave_m, m.heave_velocity_mps),
            (m.heave_velocity_mps, m.heave_acceleration_mps2),
            (m.roll_rad, m.roll_rate_radps),
            (m.pitch_rad, m.pitch_rate_radps),
            (m.yaw_rad, m.yaw_rate_radps),
        ]
        for value, rate in pairs:
            central = (value[2:] - value[:-2]) / (2 * h)
            np.testing.assert_allclose(central, rate[1:-1], atol=2e-5 * max(np.ptp(value) / np.ptp(t), 1e-6))


@pytest.mark.parametrize("name", NAMES)
def test_one_instant_and_many_agree_on_grids_and_off_them(name: str) -> None:
    sea = seaway(name, seed=5)
    grid = np.arange(3000, dtype=np.float64) * 0.5
    ragged = np.sort(np.random.default_rng(1).uniform(0.0, 1500.0, 300))
    for t in (grid, ragged):
        many = sea.motion(t)
        for i in (0, 1, 77, t.size - 1):
            one = sea.at(float(t[i]))
            for field in many.__struct_fields__:
                assert getattr(one, field) == pytest.approx(getattr(many, field)[i], abs=1e-10)


@pytest.mark.parametrize("name", sorted(SEAS))
def test_variance_is_that_of_the_spectrum(name: str) -> None:
    f = np.linspace(0.01, 3.0, 60_001)
    expected = np.sqrt(np.trapezoid(heave_spectrum(name, f), f))
    assert seaway(name, seed=2).heave_std_m == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("name", ["S4", "S6", "S6S", "SL"])
def test_a_long_realisation_has_the_target_spectrum(name: str) -> None:
    motion = seaway(name, seed=7).motion(np.arange(0.0, 20_000.0, 0.8))
    vessel = vessel_on(name)
    for response, series in (
        (vessel.heave, motion.heave_m),
        (vessel.roll, motion.roll_rad),
        (vessel.pitch, motion.pitch_rad),
    ):
        f, found = welch(series, fs=1.25, nperseg=400)
        target = response.power(f) * wave_spectrum(name, f)
        band = target > 0.05 * target.max()
        # Over bands of a few bins the ratio of energies is 1 within the scatter of ~100 segments.
        edges = np.array_split(np.flatnonzero(band), max(1, band.sum() // 8))
        ratios = [found[part].sum() / target[part].sum() for part in edges]
        assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)
        assert found[band].sum() == pytest.approx(target[band].sum(), rel=0.1)


def test_acceleration_spectrum_extends_past_the_peak_without_a_step() -> None:
    t = np.arange(0.0, 10_000.0, 0.25)
    f, found = welch(seaway("S5", seed=4).motion(t).heave_acceleration_mps2, fs=4.0, nperseg=400)
    target = (2 * np.pi * f) ** 4 * heave_spectrum("S5", f)
    for low, high in ((0.1, 0.2), (0.2, 0.4), (0.4, 0.8), (0.8, 1.1)):
        part = (f >= low) & (f < high)
        assert found[part].sum() == pytest.approx(target[part].sum(), rel=0.15)


def test_a_small_craft_moves_little_and_accelerates_as_much_above_one_hertz_as_at_the_peak() -> None:
    t = np.arange(0.0, 4000.0, 0.1)
    motion = seaway("CRAFT", seed=4).motion(t)
    assert 0.04 < motion.heave_m.std() < 0.07
    f, found = welch(motion.heave_acceleration_mps2, fs=10.0, nperseg=1000)
    density = [np.mean(found[(f >= low) & (f < high)]) for low, high in ((0.4, 0.6), (1.0, 1.5), (1.5, 2.2))]
    assert 0.5 < density[1] / density[0] < 2.0
    assert 0.5 < density[2] / density[0] < 2.0
    assert np.trapezoid(found[f > 3.05], f[f > 3.05]) < 1e-3 * np.trapezoid(found, f)


@pytest.mark.parametrize("gamma", [1.0, 2.0, 6.0])
def test_jonswap_holds_its_significant_height_and_peak(gamma: float) -> None:
    system = WaveSystem(2.0, 5.0, gamma)
    area = quad(lambda f: float(system.spectrum(np.array(f))), 0.01, 0.2, limit=500)[0]
    area += quad(lambda f: float(system.spectrum(np.array(f))), 0.2, 20.0, limit=500)[0]
    assert 4.0 * np.sqrt(area) == pytest.approx(2.0, rel=1e-4)
    f = np.linspace(0.1, 0.4, 30_001)
    assert f[np.argmax(system.spectrum(f))] == pytest.approx(0.2, abs=1e-4)
    # Peak enhancement is defined against gamma = 1 of the same scale: compare shapes at the peak and far from it.
    plain = WaveSystem(2.0, 5.0, 1.0)
    at_peak = system.spectrum(np.array([0.2])) / plain.spectrum(np.array([0.2]))
    afar = system.spectrum(np.array([0.6])) / plain.spectrum(np.array([0.6]))
    assert (at_peak / afar)[0] == pytest.approx(gamma, rel=1e-6)


@pytest.mark.parametrize(("name", "amplitude", "period"), [("T1", 0.03, 5.0), ("T2", 0.04, 6.0), ("T3", 0.05, 8.0)])
def test_trains_have_the_three_lines_of_the_paper(name: str, amplitude: float, period: float) -> None:
    lines = np.array([1.0, 1.13, 0.9]) / period
    t = np.arange(0.0, 100 * period, 0.1)
    basis = np.exp(2j * np.pi * np.multiply.outer(lines, t))
    heave = seaway(name, seed=9).motion(t).heave_m
    real = np.vstack([basis.real, basis.imag])
    weights, residual, *_ = np.linalg.lstsq(real.T, heave, rcond=None)
    np.testing.assert_allclose(np.hypot(weights[:3], weights[3:]), amplitude * np.array([1.0, 0.15, 0.10]), rtol=1e-9)
    assert residual[0] < 1e-18


def test_sx_grows_from_1_5_to_4_m_and_falls_back() -> None:
    sea = seaway("SX", seed=1)
    np.testing.assert_allclose(
        1.5 * sea.envelope(np.array([0.0, 600.0, 630.0, 660.0, 1000.0, 1260.0, 1320.0, 5000.0])),
        [1.5, 1.5, 2.75, 4.0, 4.0, 4.0, 1.5, 1.5],
    )
    before, after = (sea.motion(t0 + np.arange(0, 500, 0.5)).heave_m.std() for t0 in (50.0, 700.0))
    assert after / before == pytest.approx(4.0 / 1.5, rel=0.15)


def test_attitude_has_its_size_and_can_be_left_out() -> None:
    t = np.arange(0.0, 3600.0, 1.0)
    for name in ("S5", "S6"):
        motion = seaway(name).motion(t)
        assert 0.5 < np.degrees(motion.roll_rad.std()) < 8.0
        assert 0.5 < np.degrees(motion.pitch_rad.std()) < 4.0
        assert motion.yaw_rad.mean() == pytest.approx(MEAN_HEADING_RAD, abs=1e-3)
    level = seaway("S6", attitude=False).motion(t)
    assert not level.roll_rad.any()
    assert not level.pitch_rad.any()
    assert (level.yaw_rad == MEAN_HEADING_RAD).all()
    np.testing.assert_array_equal(level.heave_m, seaway("S6").motion(t).heave_m)


def test_seeds_decide_and_the_sea_does_not_repeat() -> None:
    t = np.arange(0.0, 3000.0, 0.5)
    first = seaway("S4", seed=1).motion(t).heave_m
    np.testing.assert_array_equal(first, seaway("S4", seed=1).motion(t).heave_m)
    assert abs(np.corrcoef(first, seaway("S4", seed=2).motion(t).heave_m)[0, 1]) < 0.15
    later = seaway("S4", seed=1).motion(t + 3000.0).heave_m
    spectrum = np.fft.rfft(first, 2 * t.size) * np.conj(np.fft.rfft(later, 2 * t.size))
    assert np.abs(np.fft.irfft(spectrum)).max() / (t.size * first.var()) < 0.6


def test_still_is_still_and_unknown_names_are_refused() -> None:
    motion = seaway("S0").motion(np.arange(10.0))
    assert not motion.heave_m.any()
    assert not motion.heave_acceleration_mps2.any()
    with pytest.raises(ValueError, match=r"'S9'.*T1, .*S0"):
        seaway("S9")
    with pytest.raises(ValueError, match=r"'T1' has no continuous spectrum"):
        wave_spectrum("T1", np.array([0.1]))


@pytest.mark.parametrize("name", ["S4", "T2"])
def test_a_later_start_is_the_same_sea_further_on(name: str) -> None:
    t = np.arange(0.0, 30.0, 0.1)
    later, first = seaway(name, 3, start_s=500.0).motion(t), seaway(name, 3).motion(t + 500.0)
    for field in ("heave_m", "heave_acceleration_mps2", "roll_rad"):
        assert getattr(later, field) == pytest.approx(getattr(first, field), abs=1e-9)


def test_a_later_start_does_not_move_the_growth_of_the_sea() -> None:
    t = np.linspace(0.0, 1500.0, 301)
    assert np.array_equal(seaway("SX", 1, start_s=900.0).envelope(t), seaway("SX", 1).envelope(t))
