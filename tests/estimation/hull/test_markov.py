"""The flexure process against matrix exponentials, its own covariance function, and records with a known answer."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm, solve_continuous_lyapunov

from heaved.estimation.common.rotations import ARCSEC
from heaved.estimation.hull.markov import Flexure, fit, information, rate_spectrum
from heaved.simulate.flexure import SCENES, simulate

TRUE = Flexure(np.array([3.0, 5.0, 8.0]) * ARCSEC, np.array([0.1, 0.2, 0.05]), 2 * np.pi * np.array([0.16, 0.2, 0.3]))
PRIOR = Flexure(np.full(3, 10 * ARCSEC), np.full(3, 0.3), np.full(3, 2 * np.pi * 0.2))


@pytest.mark.parametrize("dt", [1e-5, 1e-3, 0.1, 7.0, 3600.0])
def test_the_discretisation_is_exact(dt: float) -> None:
    """F by the matrix exponential; Q by the integral of exp(As) G exp(A's), from the Lyapunov equation."""
    F, Q = TRUE.transition(dt)
    for i in range(3):
        mu, b2, std = TRUE.mu_radps[i], TRUE.b2[i], TRUE.std_rad[i]
        A = np.array([[0.0, 1.0], [-b2, -2.0 * mu]])
        G = np.diag([0.0, 4.0 * mu * b2 * std**2])
        f = expm(A * dt)
        assert F[i::3, i::3] == pytest.approx(f, abs=1e-12)
        stationary = solve_continuous_lyapunov(A, -G)
        assert np.diag(stationary) == pytest.approx([std**2, b2 * std**2], rel=1e-9)
        block = expm(dt * np.block([[-A, G], [np.zeros((2, 2)), A.T]])) if dt < 10.0 else None
        q = f @ block[:2, 2:] if block is not None else stationary - f @ stationary @ f.T
        scale = np.sqrt(np.outer(np.diag(q), np.diag(q)))
        assert Q[i::3, i::3] / scale == pytest.approx(q / scale, abs=2e-3 if dt < 1e-2 else 1e-6)
    off = F.copy()
    for i in range(3):
        off[i::3, i::3] = 0.0
    assert not off.any()


def test_the_spectrum_holds_the_variance_of_the_rate() -> None:
    """The integral over all frequencies is b^2 sigma^2."""
    for i in range(3):
        std, mu, lam = TRUE.std_rad[i] / ARCSEC, TRUE.mu_radps[i], TRUE.lambda_radps[i]
        area = 2.0 * quad(lambda f, s=std, m=mu, k=lam: float(rate_spectrum(2 * np.pi * np.array(f), s, m, k)), 0, 40,
                          limit=400, points=[lam / 2 / np.pi])[0]  # fmt: skip
        assert area == pytest.approx((mu**2 + lam**2) * std**2, rel=2e-3)


def process(seed: int, seconds: float, noise: float) -> np.ndarray:
    """Rates (n, 3) at 10 Hz of the process, with white noise."""
    rng = np.random.default_rng(seed)
    F, Q = TRUE.transition(0.1)
    root = np.linalg.cholesky(Q / ARCSEC**2) * ARCSEC
    x = np.sqrt(TRUE.stationary()) * rng.standard_normal(6)
    rows = []
    for _ in range(round(10 * seconds)):
        x = F @ x + root @ rng.standard_normal(6)
        rows.append(x[3:] + noise * rng.standard_normal(3))
    return np.array(rows)


def test_the_fit_finds_the_parameters() -> None:
    """300 s hold some 300 mu / pi independent periods: sigma to a fifth, mu to a half, the frequency to a few per cent.

    Nine records, so that the mean is three times as sharp.
    """
    noise = 1.5 * ARCSEC  # above the flank of the flexure at the top of the band
    found = [fit(process(seed, 300.0, noise), 10.0, PRIOR, 0.1 * ARCSEC) for seed in range(9)]
    std = np.array([f.flexure.std_rad for f in found]) / TRUE.std_rad
    mu = np.array([f.flexure.mu_radps for f in found]) / TRUE.mu_radps
    lam = np.array([f.flexure.lambda_radps for f in found]) / TRUE.lambda_radps
    assert np.mean(std, axis=0) == pytest.approx(np.ones(3), abs=0.15)
    assert np.exp(np.mean(np.log(mu), axis=0)) == pytest.approx(np.ones(3), abs=0.35)
    assert np.mean(lam, axis=0) == pytest.approx(np.ones(3), abs=0.03)
    assert np.array([f.noise_radps for f in found]).mean(axis=0) == pytest.approx(np.full(3, noise), rel=0.05)


def test_a_fit_of_nothing_stays_within_its_bounds() -> None:
    for residual in (np.zeros((3000, 3)), np.full((3000, 3), 0.01)):
        result = fit(residual, 10.0, PRIOR, 1e-8)
        values = np.concatenate([result.flexure.std_rad, result.flexure.mu_radps, result.noise_radps])
        assert np.isfinite(values).all()
        assert (values > 0.0).all()


def test_information_of_tones_is_their_power_over_the_spectrum() -> None:
    """A tone of rate amplitude A about x, a record of T: A^2 T / (2 S) about y (seen by z) and about z (seen by y)."""
    T, rate, f, A = 400.0, 10.0, 0.125, 0.05
    t = np.arange(round(T * rate)) / rate
    rates = np.zeros((len(t), 3))
    rates[:, 0] = A * np.cos(2 * np.pi * f * t)
    noise = np.full(3, 0.3 * ARCSEC)
    J = information(rates, rate, TRUE, noise)
    S = TRUE.rate_spectrum(np.array([2 * np.pi * f]))[0] + noise**2 / rate
    expected = A**2 * T / 2 / S
    # The taper spreads the line over a resonance that is not flat: a few per cent.
    assert J[1, 1] == pytest.approx(expected[2], rel=0.05)
    assert J[2, 2] == pytest.approx(expected[1], rel=0.05)
    assert abs(J[0, 0]) < 1e-6 * J[1, 1]


def test_the_forecast_is_the_bound_that_monte_carlo_reaches() -> None:
    """Seed conditions: square root of the inverse information beside the covariance recursion of ``evidence.hull``."""
    from evidence.hull import bound

    record = simulate(SCENES["A1"], 1)
    scene = record.scene
    flexure = Flexure(*(np.full(3, v) for v in (scene.flexure_std_arcsec * ARCSEC, 0.1, 2 * np.pi * 0.16)))
    J = information(record.midships_radps, 10.0, flexure, np.full(3, 0.02 * ARCSEC))
    forecast = np.sqrt(np.diag(np.linalg.inv(J)))
    assert forecast == pytest.approx(bound(record), rel=0.25)
