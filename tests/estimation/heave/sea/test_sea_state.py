"""Heights and periods against moments of the spectrum on a grid of their own."""

from __future__ import annotations

import numpy as np
import pytest

from heaved.estimation.heave.sea.model import SeaModel
from heaved.estimation.heave.sea.sea_state import TUNING, sea_state


def model(*chains: tuple[float, float, float], stages: int = 8) -> SeaModel:
    f0, zeta, level = zip(*chains, strict=True)
    return SeaModel(stages=stages, frequency_hz=f0, damping=zeta, level_m2phz=level, noise_psd=1e-6, bias_walk_psd=1e-9)


def of_height(f0: float, zeta: float, hs_m: float) -> tuple[float, float, float]:
    """A chain whose significant height is ``hs_m``."""
    f = np.linspace(1e-3, 3.0, 300_000)
    return f0, zeta, (hs_m / 4.0) ** 2 / float(np.trapezoid(model((f0, zeta, 1.0)).heave_spectrum(f), f))


def peak_ratio(zeta: float, stages: int = 8) -> float:
    """Frequency of a chain's highest spectrum over its resonance: the root of d log S / d x^2 = 0."""
    a, b, c = 6.0, -(stages - 6) * (4.0 * zeta**2 - 2.0), -2.0 * (stages - 3)
    return float(np.sqrt((-b + np.sqrt(b * b - 4.0 * a * c)) / (2.0 * a)))


def test_height_and_periods_are_moments() -> None:
    m = model(of_height(0.12, 0.3, 2.5), of_height(0.2, 0.5, 1.0))
    f = np.linspace(1e-3, 3.0, 300_000)
    S = m.heave_spectrum(f)
    found = sea_state(m)
    assert found.significant_height_m == pytest.approx(4.0 * np.sqrt(np.trapezoid(S, f)), rel=5e-3)
    assert found.significant_height_m == pytest.approx(np.hypot(2.5, 1.0), rel=5e-3)
    assert found.mean_period_s == pytest.approx(np.trapezoid(S, f) / np.trapezoid(f * S, f), rel=5e-3)
    assert found.peak_period_s == pytest.approx(1.0 / f[np.argmax(S)], rel=0.02)
    assert len(found.frequencies_hz) == len(found.spectrum_m2phz) == TUNING.published_points
    np.testing.assert_allclose(found.spectrum_m2phz, m.heave_spectrum(np.array(found.frequencies_hz)))


def test_the_share_that_was_measured_scales_variance_and_nothing_else() -> None:
    m = model(of_height(0.12, 0.3, 2.5))
    half = sea_state(m, 0.5)
    assert half.significant_height_m == pytest.approx(sea_state(m).significant_height_m * np.sqrt(0.5))
    assert half.peak_period_s == sea_state(m).peak_period_s
    assert half.mean_period_s == pytest.approx(sea_state(m).mean_period_s)


def test_swell_and_wind_sea_are_told_apart() -> None:
    """0.8 m at 16 s has a steepness of 0.002, 2 m at 6 s one of 0.036; longest waves first."""
    found = sea_state(model(of_height(1 / 6.0, 0.35, 2.0), of_height(1 / 16.0, 0.15, 0.8)))
    assert [system.kind for system in found.systems] == ["swell", "wind sea"]
    swell, wind = found.systems
    peaks = (16.0 / peak_ratio(0.15), 6.0 / peak_ratio(0.35))
    assert (swell.peak_period_s, wind.peak_period_s) == pytest.approx(peaks, rel=0.03)
    assert swell.significant_height_m == pytest.approx(0.8, rel=0.1)
    assert wind.significant_height_m == pytest.approx(2.0, rel=0.05)


def test_one_sea_is_one_system() -> None:
    for chains in (
        [of_height(0.12, 0.3, 2.0)],
        [of_height(0.12, 0.3, 2.0), of_height(0.14, 0.3, 2.0)],
        [of_height(0.12, 0.3, 2.0), of_height(0.3, 0.2, 0.05)],
    ):
        found = sea_state(model(*chains))
        assert len(found.systems) == 1
        assert found.systems[0].significant_height_m == pytest.approx(found.significant_height_m, rel=0.01)


def test_of_nothing_there_is_nothing_and_no_error() -> None:
    found = sea_state(model((0.1, 0.3, 1e-10)))
    assert found.significant_height_m < 1e-4
    assert all(np.isfinite([found.peak_period_s, found.mean_period_s, *found.spectrum_m2phz]))
