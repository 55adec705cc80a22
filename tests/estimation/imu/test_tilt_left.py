"""Oracle: a vessel whose roll is known, and what the geometry makes of the force along its mast."""

from __future__ import annotations

import numpy as np
import pytest

from heaved.estimation.imu.tilt_left import TILT_HZ, TiltLeft
from heaved.samples import GRAVITY_MPS2

RATE_HZ = 10.0
T_S = np.arange(0.0, 600.0, 1.0 / RATE_HZ)


def random_waves(seed: int, period_s: float, rms: float, width: float = 0.2) -> np.ndarray:
    """About one period, Gaussian, of that RMS."""
    rng = np.random.default_rng(seed)
    f = (1.0 + width * np.linspace(-1.0, 1.0, 121)) / period_s
    waves = np.sin(2.0 * np.pi * (np.outer(T_S, f) + rng.random(len(f))))
    return np.asarray(rms * np.sqrt(2.0 / len(f)) * waves.sum(axis=1))


def told(up: np.ndarray, roll: np.ndarray, *, is_across: bool) -> TiltLeft:
    left = TiltLeft()
    along, across = (GRAVITY_MPS2 + up) * np.cos(roll), (GRAVITY_MPS2 + up) * np.sin(roll)
    nothing = np.full(len(T_S), np.nan)
    x, y = (np.zeros(len(T_S)), across) if is_across else (nothing, nothing)
    for row in zip(T_S.tolist(), x.tolist(), y.tolist(), along.tolist(), strict=True):
        left.step(*row)
    return left


@pytest.mark.parametrize("is_across", [True, False])
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("roll_deg", "period_s"), [(2.0, 9.0), (4.0, 14.0)])
def test_the_tilt_in_the_acceleration_is_told_as_far_as_so_short_a_record_can(
    seed: int, roll_deg: float, period_s: float, is_across: bool
) -> None:
    roll = np.radians(random_waves(seed, period_s, roll_deg))
    left = told(random_waves(seed + 50, 8.0, 0.8), roll, is_across=is_across)
    part = GRAVITY_MPS2 * (1.0 - np.cos(roll))
    rms = np.std(part[-int(300.0 * RATE_HZ) :])
    assert left.is_measured
    # Of few degrees of freedom an estimate may be off by chance.
    assert 0.4 * rms < np.sqrt(left.square) < 3.5 * rms


@pytest.mark.parametrize(("period_s", "rms"), [(3.0, 0.6), (6.0, 0.8), (12.0, 0.8), (18.0, 0.2)])
def test_a_vessel_that_does_not_lean_shows_none(period_s: float, rms: float) -> None:
    noise = 0.005 * np.random.default_rng(9).standard_normal(len(T_S))
    left = told(random_waves(4, period_s, rms) + noise, np.zeros(len(T_S)), is_across=False)
    assert left.is_measured
    assert np.sqrt(left.square) < 0.002
    quiet = 0.7 * 0.8 / period_s > TILT_HZ
    assert np.all(left.density[quiet] < 1e-4)


def test_before_that_shows_it_is_what_ships_do_and_no_measurement() -> None:
    left = TiltLeft()
    for t_s, up in zip(T_S[:800].tolist(), random_waves(5, 10.0, 0.8).tolist(), strict=False):
        left.step(t_s, np.nan, np.nan, GRAVITY_MPS2 + up)
    assert not left.is_measured
    # A lean of 3 degrees RMS: g (1 - cos) is 0.019 m/s2 RMS.
    assert np.sqrt(left.square) < 0.2
    assert left.seconds(float(T_S[799])) == pytest.approx(79.9)
    assert left.seconds(float(T_S[799]) + 1.0) == 0.0
