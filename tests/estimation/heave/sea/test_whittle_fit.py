"""The fit: its slopes by differences, the spectrum of known seas, and records that are no sea at all."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy.signal import detrend, welch
from seas import model, simulated

from heaved.estimation.heave.sea import whittle_fit
from heaved.estimation.heave.sea.model import Resonance, SeaModel, SeaSystem
from heaved.estimation.heave.sea.noise import Above
from heaved.simulate.seaway import heave_spectrum, seaway

RATE_HZ = 20.0
WALK = 9e-10
Array = np.ndarray


def acceleration(name: str, duration_s: float, seed: int = 1, noise: float = 1e-3) -> Array:
    """Of a named sea, with white noise of that density (m/s2/sqrt(Hz))."""
    t = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    white = noise * np.sqrt(RATE_HZ / 2) * np.random.default_rng(seed).standard_normal(len(t))
    return np.asarray(seaway(name, seed, attitude=False).motion(t).heave_acceleration_mps2 + white)


@pytest.mark.parametrize("stages", [4, 6, 7, 12])
def test_slopes_are_differences_of_the_logarithm(stages: int) -> None:
    f = np.linspace(0.02, 0.8, 60)
    none = np.empty(0)
    shaking = (Resonance(frequency_hz=1.1, damping=0.3, level=1e-3),)
    sp = whittle_fit.Spectrum(f, np.ones(60), 1e-5, Above(none, none, none, 1.0, 1 / RATE_HZ), shaking)
    whittle = whittle_fit._Whittle([(sp, np.ones(60))], np.zeros(4, int), stages, WALK)
    rng = np.random.default_rng(2)
    parts = [rng.uniform(*limits, (4, 2)) for limits in ((0.06, 0.3), (0.1, 0.9), (0.1, 3.0))]
    theta = np.log(np.column_stack((*parts, np.full(4, 1e-5))))
    S, J = whittle.spectrum(theta)
    for i, row in enumerate(np.exp(theta)):
        m = SeaModel(
            stages=stages, frequency_hz=tuple(row[:2]), damping=tuple(row[2:4]), level_m2phz=tuple(row[4:6]),
            noise_psd=row[6], bias_walk_psd=WALK, resonances=shaking,
        )  # fmt: skip
        np.testing.assert_allclose(S[i], m.acceleration_spectrum(f, 1 / RATE_HZ), rtol=1e-9)
    h = 1e-5
    for j in range(theta.shape[1]):
        nudge = h * np.eye(theta.shape[1])[j]
        ahead, behind = (np.log(whittle.spectrum(theta + s * nudge)[0]) for s in (1, -1))
        np.testing.assert_allclose(J[:, j], (ahead - behind) / (2 * h), atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("seconds", [60.0, 120.0, 600.0])
def test_pooling_keeps_the_sums_and_leaves_the_low_ordinates_alone(seconds: float) -> None:
    """Of weights and frequencies; groups as wide as 3 % of their frequency, and the likelihood of a smooth sea as it
    was, to a hundredth: how closely two models can be told apart.
    """
    sp = whittle_fit.spectrum(acceleration("S6", seconds), RATE_HZ)
    pooled, weight = whittle_fit._pooled(sp)
    spacing = sp.f_hz[1] - sp.f_hz[0]
    single = sp.f_hz < 2.0 * spacing / 0.03 - 1e-9
    count = int(np.count_nonzero(single))
    np.testing.assert_allclose(pooled.f_hz[:count], sp.f_hz[single])
    np.testing.assert_allclose(pooled.power[:count], sp.power[single])
    assert np.sum(weight) == pytest.approx(np.sum((0.15 / sp.f_hz) ** 0.7))
    edges = np.diff(pooled.f_hz)
    assert np.all(edges > 0.999 * spacing)
    assert np.all(edges < np.maximum(0.03 * pooled.f_hz[1:] + spacing, 1.001 * spacing))
    assert pooled.f_hz[-1] > 0.8 - 0.03 * 0.8
    S = partial(model(7, 2).acceleration_spectrum, dt_s=1 / RATE_HZ)
    pooled_cost = float(np.sum(weight * (np.log(S(pooled.f_hz)) + pooled.power / S(pooled.f_hz))))
    cost = float(np.sum((np.log(S(sp.f_hz)) + sp.power / S(sp.f_hz)) * (0.15 / sp.f_hz) ** 0.7))
    assert pooled_cost == pytest.approx(cost, rel=0.01)


@pytest.mark.parametrize("name", ["S4", "S6", "S6S"])
def test_the_spectrum_of_a_jonswap_sea_is_found(name: str) -> None:
    """1800 s: Kullback's divergence of the acceleration's spectrum, r - 1 - log r on average over the band (five
    decades of it), r = true over fitted: a factor of two everywhere would be 0.3. The measured height to a tenth.
    """
    sp = whittle_fit.spectrum(acceleration(name, 1800.0), RATE_HZ)
    fitted = whittle_fit.fit([sp], 8, 3, WALK)[0].model
    f = np.linspace(0.02, 0.8, 800)
    r = ((2 * np.pi * f) ** 4 * heave_spectrum(name, f) + 1e-6) / fitted.acceleration_spectrum(f, 1 / RATE_HZ)
    assert np.mean(r - 1.0 - np.log(r)) < 0.15
    height = np.sqrt(whittle_fit.measured_share(sp, fitted) * np.trapezoid(fitted.heave_spectrum(f), f))
    realised = np.std(seaway(name, 1, attitude=False).motion(np.arange(18_000) / 10.0).heave_m)
    assert height == pytest.approx(realised, rel=0.1)


def test_the_cost_is_whittles_with_its_weights_and_no_worse_than_that_of_the_truth() -> None:
    m = model(6, 2)
    _, a = simulated(SeaSystem(m), 1 / RATE_HZ, 24_000, seed=5)
    sp = whittle_fit.spectrum(a, RATE_HZ)
    fitted = whittle_fit.fit([sp], 6, 2, WALK)[0]

    def whittle(of: SeaModel) -> float:
        S = of.acceleration_spectrum(sp.f_hz, 1 / RATE_HZ)
        return float(np.sum((np.log(S) + sp.power / S) * (0.15 / sp.f_hz) ** 0.7))

    assert fitted.cost <= whittle(m) + 1.0  # the weak priors, and where a start counts as converged
    assert whittle(fitted.model) < whittle(m) + 15.0  # its N is taken from above the waves
    assert fitted.waves > 100.0


@pytest.mark.parametrize("noise", [1e-3, 1e-2])
def test_the_noise_floor_is_that_above_the_waves(noise: float) -> None:
    sp = whittle_fit.spectrum(acceleration("S4", 600.0, noise=noise), RATE_HZ)
    assert sp.noise_psd == pytest.approx(noise**2, rel=0.15)
    t = np.arange(12_000) / RATE_HZ
    engine = 0.05 * np.sin(2 * np.pi * 6.3 * t)
    sp = whittle_fit.spectrum(acceleration("S4", 600.0, noise=noise) + engine, RATE_HZ)
    assert sp.noise_psd == pytest.approx(noise**2, rel=0.15)


@pytest.mark.parametrize("seconds", [400.0, 299.95, 45.0])
def test_the_periodogram_is_welchs(seconds: float) -> None:
    """Three overlapping segments, or one, of an even or an odd number of samples."""
    a = acceleration("S6", seconds) + 1e-3 * np.arange(round(seconds * RATE_HZ))
    sp = whittle_fit.spectrum(a, RATE_HZ)
    n = min(6000, len(a))
    f, power = welch(a, RATE_HZ, nperseg=n, noverlap=3 * n // 4, detrend=lambda part: detrend(part, type="linear"))
    kept = (f >= max(0.02, 2.6 * RATE_HZ / n) - 1e-12) & (f <= 0.8 + 1e-12)
    np.testing.assert_allclose(sp.f_hz, f[kept])
    np.testing.assert_allclose(sp.power, power[kept], rtol=1e-6)


@pytest.mark.parametrize("name", ["S4", "S6S", "SL"])
def test_a_warm_start_is_never_worse(name: str) -> None:
    a = acceleration(name, 620.0)
    earlier = whittle_fit.fit([whittle_fit.spectrum(a[:12_000], RATE_HZ)], 8, 3, WALK)[0].model
    sp = whittle_fit.spectrum(a[-12_000:], RATE_HZ)
    cold, warm = whittle_fit.fit([sp], 8, 3, WALK)[0], whittle_fit.fit([sp], 8, 3, WALK, [earlier])[0]
    assert warm.cost <= cold.cost + 1e-9
    other = model(8, 2)  # of another size: passed over
    assert whittle_fit.fit([sp], 8, 3, WALK, [other]) == [cold]


def test_spectra_side_by_side_are_fitted_as_each_by_itself() -> None:
    """Of different lengths, one with a warm start: what is padded weighs nothing."""
    a = acceleration("S6S", 620.0)
    spectra = [whittle_fit.spectrum(a[-round(seconds * RATE_HZ) :], RATE_HZ) for seconds in (60.0, 120.0, 600.0)]
    warm = [None, model(7, 3), None]
    together = whittle_fit.fit(spectra, 7, 3, WALK, warm)
    for fitted, sp, earlier in zip(together, spectra, warm, strict=True):
        alone = whittle_fit.fit([sp], 7, 3, WALK, [earlier])[0]
        assert fitted.cost == pytest.approx(alone.cost, abs=0.5)
        assert fitted.waves == pytest.approx(alone.waves, rel=0.02)


RECORDS = {
    "flat": np.zeros(2400),
    "one value": np.full(2400, 0.3),
    "tiny": 1e-9 * np.sin(0.05 * np.arange(2400)),
    "huge": 1e6 * np.sin(0.05 * np.arange(2400)),
    "spiky": np.where(np.arange(2400) % 400 == 17, 50.0, 0.0),
    "a step": np.where(np.arange(2400) > 1000, 3.0, 0.0),
    "a ramp": 1e-3 * np.arange(2400.0),
    "one line": np.sin(2 * np.pi * 0.125 * np.arange(2400) / RATE_HZ),
    "white": np.random.default_rng(1).standard_normal(2400),
    "very short": np.sin(0.05 * np.arange(400)),
    "slow waves": np.sin(2 * np.pi * 0.01 * np.arange(2400) / RATE_HZ),
}


@pytest.mark.parametrize("name", RECORDS)
@pytest.mark.parametrize(("stages", "components"), [(6, 2), (8, 3)])
def test_what_is_no_sea_gives_a_model_all_the_same(name: str, stages: int, components: int) -> None:
    """Finite, within its limits, and one whose steady filter exists."""
    m = whittle_fit.fit([whittle_fit.spectrum(RECORDS[name], RATE_HZ)], stages, components, WALK)[0].model
    tuning = whittle_fit.TUNING
    for (low, high), values in (
        (tuning.frequency_limits_hz, m.frequency_hz),
        (tuning.damping_limits, m.damping),
        (tuning.level_limits_m2phz, m.level_m2phz),
    ):
        assert all(low * 0.999 <= v <= high * 1.001 for v in values)
    assert np.isfinite(m.acceleration_spectrum(np.linspace(0.02, 0.8, 50), 1 / RATE_HZ)).all()
    assert SeaSystem(m).steady(1 / RATE_HZ) is not None


@pytest.mark.parametrize("rate_hz", [2.0, 5.0, 10.0, 20.0])
def test_a_slow_sensor_is_fitted_in_the_band_that_it_has(rate_hz: float) -> None:
    a = acceleration("S6", 600.0)[:: round(RATE_HZ / rate_hz)]
    sp = whittle_fit.spectrum(a, rate_hz)
    assert sp.f_hz[-1] <= 0.36 * rate_hz
    found = whittle_fit.fit([sp], 8, 2, WALK)[0].model
    f = np.linspace(0.02, 0.6, 600)
    assert np.trapezoid(found.heave_spectrum(f), f) == pytest.approx(np.trapezoid(heave_spectrum("S6", f), f), rel=0.5)
