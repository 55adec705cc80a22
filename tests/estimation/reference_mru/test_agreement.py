"""Statistics of two series. Oracle: the algebra of sinusoids, and numpy's own correlation coefficient."""

from __future__ import annotations

from math import isnan, pi, sqrt

import numpy as np
import pytest

from heaved.estimation.reference_mru.agreement import LAGS, LEAST, STEP_S, Agreement, agree

T = np.arange(0.0, 300.0, 0.25)
LAG_S = STEP_S * np.arange(-LAGS, LAGS + 1)[:, np.newaxis]


def agreed(delay_s: float, scale: float, period_s: float = 7.0, mean: float = 0.0, noise: float = 0.0) -> Agreement:
    omega = 2.0 * pi / period_s
    rng = np.random.default_rng(3)
    reference = scale * np.sin(omega * (T - delay_s)) + mean + noise * rng.standard_normal(T.size)
    return agree(reference, np.sin(omega * T), np.sin(omega * (T + LAG_S)))


@pytest.mark.parametrize("period_s", [3.0, 7.0, 15.0])
@pytest.mark.parametrize("scale", [0.8, 1.0, 1.3])
@pytest.mark.parametrize("delay_s", [-0.9, -0.33, 0.0, 0.05, 0.71])
def test_delay_and_scale_of_a_sinusoid(delay_s: float, scale: float, period_s: float) -> None:
    found = agreed(delay_s, scale, period_s, mean=0.4)
    assert found.delay_s == pytest.approx(delay_s, abs=0.01)
    assert found.scale == pytest.approx(scale, rel=0.03)
    assert found.correlation == pytest.approx(1.0, abs=0.03)
    # |scale exp(-j omega delay) - 1| / sqrt(2): what a phasor makes of the difference.
    off = abs(scale * np.exp(-2j * pi / period_s * delay_s) - 1.0) / sqrt(2.0)
    assert found.std == pytest.approx(off, rel=0.02, abs=2e-3)
    assert found.mean == pytest.approx(0.4, abs=0.01)
    assert found.rms == pytest.approx(np.hypot(off, 0.4), rel=0.02)


def test_noise_lowers_the_correlation_and_nothing_else() -> None:
    found = agreed(0.3, 1.0, noise=0.5)
    assert found.correlation == pytest.approx(sqrt(0.5 / (0.5 + 0.25)), abs=0.02)
    assert found.delay_s == pytest.approx(0.3, abs=0.05)
    assert found.scale == pytest.approx(1.0, abs=0.05)


def test_one_that_counts_the_other_way() -> None:
    found = agreed(0.2, -1.0)
    assert found.correlation == pytest.approx(-1.0, abs=0.01)
    assert found.scale == pytest.approx(-1.0, abs=0.02)
    assert found.delay_s == pytest.approx(0.2, abs=0.01)


def test_a_delay_beyond_a_second_is_not_told() -> None:
    found = agreed(1.4, 1.0)
    assert isnan(found.delay_s)
    assert found.correlation == pytest.approx(np.cos(2.0 * pi / 7.0 * (1.4 - STEP_S * LAGS)), abs=0.02)


def test_holes_are_left_out() -> None:
    rng = np.random.default_rng(5)
    own = rng.standard_normal(T.size)
    reference = 0.7 * own + 0.3 * rng.standard_normal(T.size)
    reference[50:400] = np.nan
    own[700:720] = np.nan
    moved = np.full((2 * LAGS + 1, T.size), np.nan)
    moved[LAGS] = own
    found = agree(reference, own, moved)
    there = np.isfinite(reference + own)
    assert found.pairs == there.sum()
    assert found.correlation == pytest.approx(np.corrcoef(reference[there], own[there])[0, 1])
    assert found.scale == pytest.approx(np.polyfit(own[there], reference[there], 1)[0])
    assert found.std == pytest.approx(np.std((reference - own)[there]))


def test_what_cannot_be_said() -> None:
    few = agree(T[: LEAST - 1], T[: LEAST - 1], np.tile(T[: LEAST - 1], (2 * LAGS + 1, 1)))
    assert isnan(few.std)
    constant = np.full(T.size, 3.3)
    still = agree(constant, np.sin(T), np.sin(T + LAG_S))
    assert still.reference_std == 0.0
    assert isnan(still.correlation)
    assert still.std == pytest.approx(np.std(np.sin(T)), rel=1e-6)
    nothing = agree(np.full(T.size, np.nan), np.sin(T), np.sin(T + LAG_S))
    assert nothing == Agreement(pairs=0) or nothing.pairs == 0
