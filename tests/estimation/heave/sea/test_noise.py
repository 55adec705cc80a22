"""What shakes the sensor: its state space against its formula, and known disturbances found in a record."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from scipy.signal import lfilter
from seas import model

from heaved.estimation.common.down_sampler import passed
from heaved.estimation.heave.sea import whittle_fit
from heaved.estimation.heave.sea.model import Resonance, SeaModel, SeaSystem
from heaved.estimation.heave.sea.noise import HALF_POWER, TUNING, _Whittle, remembered, resonances
from heaved.estimation.heave.sea.sea_state import vibration
from heaved.simulate.seaway import seaway

DT_S, RATE_HZ, COUNT = 0.05, 20.0, 12_000
NOISE_PSD = 1e-6
T = DT_S * np.arange(COUNT, dtype=np.float64)
Array = np.ndarray


def shaken(*found: Resonance) -> SeaModel:
    return msgspec.structs.replace(model(), resonances=found)


LINE = Resonance(frequency_hz=3.1, damping=0.05, level=0.1)
BROAD = Resonance(frequency_hz=6.0, damping=0.9, level=0.01)
SHORT_WAVES = Resonance(frequency_hz=1.5, damping=0.5, level=0.01, is_heave=True)


@pytest.mark.parametrize("one", [LINE, BROAD, SHORT_WAVES])
def test_sampled_state_space_has_the_spectrum_of_the_formula(one: Resonance) -> None:
    """H (z - F)^-1 Q (z - F)^-* H' from the bottom of the waves' band to half the rate, each with its own samples."""
    system = SeaSystem(shaken(one))
    F, Q = system.transition(DT_S)
    f = np.array([0.05, 0.3, 0.8, 1.5, 3.1, 6.0, 9.5])
    ringing = slice(len(F) - 5, len(F) - 1)
    F, Q, H = F[ringing, ringing], Q[ringing, ringing], system.H[ringing]
    turns = np.exp(2j * np.pi * f * DT_S)
    transfer = np.array([np.linalg.solve((z * np.eye(4) - F).T, H.astype(complex)) for z in turns])
    density = 2.0 * DT_S * np.real(np.einsum("ki,ij,kj->k", transfer, Q, transfer.conj()))
    np.testing.assert_allclose(density, one.spectrum(f, DT_S), rtol=1e-3)
    assert one.spectrum(np.array([one.frequency_hz]), DT_S)[0] == pytest.approx(one.level)
    # Nothing of the broad one folds from above half the rate into the waves.
    assert one.spectrum(np.array([0.05]), DT_S)[0] < 2e-6 * one.level


def test_short_waves_are_the_double_integral_of_their_acceleration() -> None:
    system = SeaSystem(shaken(SHORT_WAVES))
    F, Q = system.transition(DT_S)
    values, vectors = np.linalg.eigh(Q[-5:-1, -5:-1])
    driven = vectors[:, -1] * np.sqrt(values[-1])
    for f in (0.5, 1.0, 1.5, 2.0):
        state = np.linalg.solve(np.exp(2j * np.pi * f * DT_S) * np.eye(4) - F[-5:-1, -5:-1], driven)
        ideal = -(system.H[-5:-1] @ state) / (2.0 * np.pi * f) ** 2
        assert abs(system.heave[-5:-1] @ state / ideal - 1.0) < 0.01


def test_long_steps_forget_what_rings() -> None:
    system = SeaSystem(shaken(LINE))
    F, Q = system.transition(30.0)
    assert np.max(np.abs(F[-5:-1, -5:-1])) < 1e-3
    np.testing.assert_allclose(Q[-5:-1, -5:-1], system.stationary[-5:-1, -5:-1], rtol=1e-3, atol=1e-6)


def test_slopes_are_differences_of_the_logarithm() -> None:
    f = np.linspace(0.8, 9.5, 100)
    one = np.ones(100)
    whittle = _Whittle(f, one, one, 0.0 * one, one, DT_S, NOISE_PSD)
    theta = np.log([1e-6, 3.0, 0.3, 1e-3, 1.5, 0.05, 1e-5])
    _, slopes = whittle.spectrum(theta)
    for i, nudge in enumerate(1e-6 * np.eye(len(theta))):
        ahead, behind = (np.log(whittle.spectrum(theta + s * nudge)[0]) for s in (1, -1))
        np.testing.assert_allclose(slopes[i], (ahead - behind) / 2e-6, atol=1e-6)


def acceleration(added: Array, sea: str = "S6") -> Array:
    white = np.sqrt(NOISE_PSD * RATE_HZ / 2) * np.random.default_rng(4).standard_normal(COUNT)
    return np.asarray(seaway(sea, 2, attitude=False).motion(T).heave_acceleration_mps2 + white + added)


def found(a: Array, before: tuple[Resonance, ...] = ()) -> tuple[tuple[Resonance, ...], float]:
    """``before``: what shook the sensor at the last look."""
    sp = whittle_fit.spectrum(a, RATE_HZ)
    waves = msgspec.structs.replace(whittle_fit.fit([sp], 7, 3, 9e-10)[0].model, resonances=before)
    return resonances(sp.above, waves, sp.noise_psd)


def rung(f0_hz: float, damping: float, rms: float) -> Array:
    """A lightly damped mode under white noise."""
    pole = np.exp(2.0 * np.pi * f0_hz * DT_S * complex(-damping, np.sqrt(1.0 - damping**2)))
    driven = np.random.default_rng(5).standard_normal(COUNT + 4000)
    y = lfilter([1.0, -1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], driven)[4000:]
    return np.asarray(y * rms / np.std(y))


def band(low_hz: float, high_hz: float, rms: float) -> Array:
    spectrum = np.fft.rfft(np.random.default_rng(6).standard_normal(COUNT))
    f = np.fft.rfftfreq(COUNT, DT_S)
    y = np.fft.irfft(np.where((f > low_hz) & (f < high_hz), spectrum, 0.0), COUNT)
    return np.asarray(y * rms / np.std(y))


@pytest.mark.parametrize(
    ("added", "f_hz", "rms"),
    [
        (0.3 * np.sin(2 * np.pi * 3.1 * T), 3.1, 0.3 / np.sqrt(2)),
        (0.5 * np.sin(2 * np.pi * 1.3 * T), 1.3, 0.5 / np.sqrt(2)),
        (0.5 * np.sin(2 * np.pi * 9.2 * T), 9.2, 0.5 / np.sqrt(2)),
        (rung(1.5, 0.02, 0.1), 1.5, 0.1),
        (rung(6.0, 0.05, 0.3), 6.0, 0.3),
    ],
    ids=["line 3.1", "line 1.3", "line 9.2", "whipping", "mode 6"],
)
def test_what_shakes_is_named(added: Array, f_hz: float, rms: float) -> None:
    shaking, noise_psd = found(acceleration(added))
    named = vibration(msgspec.structs.replace(model(), resonances=shaking))
    assert named[0].frequency_hz == pytest.approx(f_hz, rel=0.02)
    assert named[0].rms_mps2 == pytest.approx(rms, rel=0.3)
    assert named[0].width_hz < 0.2 * f_hz
    assert not any(one.is_heave for one in shaking)
    assert noise_psd < 4.0 * NOISE_PSD  # The skirts of a mode are hardly told from it.


def test_two_lines_are_two_and_no_narrower_than_they_may_wander() -> None:
    two = 0.2 * np.sin(2 * np.pi * 3.4 * T) + 0.3 * np.sin(2 * np.pi * 5.1 * T)
    shaking, _ = found(acceleration(two))
    assert sorted(one.frequency_hz for one in shaking[:2]) == pytest.approx([3.4, 5.1], rel=0.02)
    assert all(one.damping >= 0.999 * TUNING.narrowest for one in shaking)
    assert HALF_POWER * TUNING.narrowest > 0.03


def test_a_broad_band_is_no_white_noise_of_the_sensor() -> None:
    """It fills everything above the waves up to half the rate; below them it is quiet."""
    shaking, noise_psd = found(acceleration(band(1.0, 10.0, 0.5)))
    f = np.linspace(1.2, 9.0, 50)
    ratio = sum(one.spectrum(f, DT_S) for one in shaking) / (0.25 / 9.0)
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.2)
    assert noise_psd < 30.0 * NOISE_PSD
    assert not any(one.is_heave for one in shaking)


def test_content_right_above_the_waves_is_heave() -> None:
    shaking, _ = found(acceleration(band(1.0, 2.5, 0.3)))
    assert sum(one.variance for one in shaking if one.is_heave) == pytest.approx(0.09, rel=0.3)
    assert vibration(msgspec.structs.replace(model(), resonances=shaking)) == ()


def test_what_was_heave_stays_heave_while_it_may_be() -> None:
    """With a fifth of it above the waves it may be either: it does not change from one look to the next."""
    a = acceleration(band(1.0, 2.5, 0.3) + band(3.2, 4.5, 0.15))
    assert not any(one.is_heave for one in found(a)[0])
    assert any(one.is_heave for one in found(a, (SHORT_WAVES,))[0])
    line = acceleration(0.3 * np.sin(2 * np.pi * 3.1 * T))
    assert not any(one.is_heave for one in found(line, (SHORT_WAVES,))[0])


@pytest.mark.parametrize("sea", ["S4", "S6", "SL"])
def test_nothing_is_named_on_a_quiet_hull(sea: str) -> None:
    shaking, noise_psd = found(acceleration(np.zeros(COUNT), sea))
    assert vibration(msgspec.structs.replace(model(), resonances=shaking)) == ()
    assert noise_psd == pytest.approx(NOISE_PSD, rel=0.15)


def test_white_noise_of_means_is_taken_for_white() -> None:
    """Five samples in a beat, and the beat before: its noise is a quarter at the upper end."""
    rng = np.random.default_rng(7)
    fast = np.sqrt(NOISE_PSD * 50.0) * rng.standard_normal(5 * COUNT + 9)
    weights = np.convolve(np.ones(5), np.ones(5)) / 25.0
    means = np.convolve(fast, weights, mode="valid")[::5][:COUNT]
    waves = seaway("S6", 2, attitude=False).motion(T).heave_acceleration_mps2
    sp = whittle_fit.spectrum(waves + means, RATE_HZ, lambda f: passed(f, 0.01, 5))
    shaking, noise_psd = resonances(sp.above, whittle_fit.fit([sp], 7, 3, 9e-10)[0].model, sp.noise_psd)
    assert noise_psd == pytest.approx(NOISE_PSD, rel=0.15)
    assert sum(one.variance for one in shaking) < 0.02**2


def test_a_line_that_is_switched_off_is_remembered_for_some_minutes() -> None:
    """A thruster runs every other minute: its line is known when it starts again, and named only while it runs."""
    kept: tuple[Resonance, ...] = (LINE,)
    looks = 0
    while kept:
        looks += 1
        kept = remembered((), kept, NOISE_PSD)
        assert not vibration(shaken(*kept))
    assert 10 < looks < 100


@pytest.mark.parametrize("one", [BROAD, SHORT_WAVES])
def test_neither_a_broad_band_nor_waves_are_remembered(one: Resonance) -> None:
    assert remembered((), (one,), NOISE_PSD) == ()


def test_a_line_that_is_seen_is_not_remembered_beside_itself() -> None:
    now = msgspec.structs.replace(LINE, frequency_hz=3.3)
    assert remembered((now,), (LINE,), NOISE_PSD) == (now,)
    assert len(remembered((msgspec.structs.replace(LINE, frequency_hz=5.0),), (LINE,), NOISE_PSD)) == 2
