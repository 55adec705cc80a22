"""The two-IMU simulator: its statistics are those asked for, its kinematics those of two frames."""

from __future__ import annotations

from math import pi

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from heaved.simulate.flexure import ARCSEC_RAD, DEG_H_RADPS, EARTH_RADPS, SCENES, Scene, simulate, static_rotation

QUIET = Scene(name="quiet", bias_deg_h=0.0, noise_deg_h=0.0, flexure_std_arcsec=1e-9)


def varied(scene: Scene, **changes: object) -> Scene:
    return msgspec.structs.replace(scene, **changes)


def test_the_same_seed_gives_the_same_record_and_another_another() -> None:
    a, b, c = (simulate(SCENES["A4"], seed, duration_s=20.0) for seed in (1, 1, 2))
    assert np.array_equal(a.local_radps, b.local_radps)
    assert not np.array_equal(a.local_radps, c.local_radps)


def test_a_stiff_hull_without_errors_gives_two_views_of_one_rate() -> None:
    record = simulate(varied(QUIET, random_mount=True), 3, duration_s=30.0)
    C = record.static
    assert np.max(np.abs(C @ C.T - np.eye(3))) < 1e-12
    assert np.linalg.det(C) == pytest.approx(1.0)
    assert record.local_radps == pytest.approx(record.midships_radps @ C.T, abs=1e-12)


def test_the_static_rotation_is_r3_r2_r1() -> None:
    C = static_rotation((0.0, 0.0, 90.0))
    assert C @ np.array([0.0, 1.0, 0.0]) == pytest.approx([1.0, 0.0, 0.0], abs=1e-12)
    assert static_rotation((0.0, 90.0, 0.0)) @ np.array([0.0, 0.0, 1.0]) == pytest.approx([-1.0, 0.0, 0.0], abs=1e-12)
    assert static_rotation((90.0, 0.0, 0.0)) @ np.array([0.0, 0.0, 1.0]) == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
    assert static_rotation((10.0, 20.0, 30.0)) == pytest.approx(
        static_rotation((0.0, 0.0, 30.0)) @ static_rotation((0.0, 20.0, 0.0)) @ static_rotation((10.0, 0.0, 0.0))
    )


def test_local_rates_turn_the_frame_by_the_deformation() -> None:
    """Integrated rates of both IMUs, as rotations, differ by C at the start and at the end: C2 A1 C1' = A2.

    At 1 kHz, midpoint rule; flexure of a quarter of a degree, so that its second order shows; the third is left out.
    """
    scene = varied(QUIET, flexure_std_arcsec=900.0, static_deg=(3.0, 4.0, 50.0))
    t = np.arange(1, 4001) / 1000.0
    record = simulate(scene, 5, t, t)
    truth = record.deformation()

    def turned(rates: np.ndarray) -> np.ndarray:
        steps = Rotation.from_rotvec(-0.5 * (rates[1:] + rates[:-1]) * 1e-3).as_matrix()
        total = np.eye(3)
        for step in steps:
            total = step @ total
        return total

    found = truth[-1] @ turned(record.midships_radps) @ truth[0].T
    alone = record.static @ turned(record.midships_radps) @ record.static.T
    expected = turned(record.local_radps)
    assert np.max(np.abs(found - expected)) < 3e-6
    assert np.max(np.abs(alone - expected)) > 1e-3  # without the flexure it is another rotation


def test_flexure_has_the_variance_and_correlation_of_its_process() -> None:
    """sigma^2 exp(-mu t) (cos(lambda t) + mu / lambda sin(lambda t)) over 40 records."""
    scene = varied(QUIET, flexure_std_arcsec=5.0)
    theta = np.array([simulate(scene, seed, duration_s=60.0).flexure_rad for seed in range(40)]) / ARCSEC_RAD
    assert np.mean(theta**2) == pytest.approx(25.0, rel=0.15)
    lam, mu = 2 * pi * scene.flexure_hz, scene.flexure_mu_radps
    for lag in (1.5, 3.0, 6.0):
        k = round(10 * lag)
        expected = np.exp(-mu * lag) * (np.cos(lam * lag) + mu / lam * np.sin(lam * lag))
        assert np.mean(theta[:, k:] * theta[:, :-k]) / np.mean(theta**2) == pytest.approx(expected, abs=0.08)


@pytest.mark.parametrize("sea", ["tones", "irregular"])
def test_motion_has_the_size_of_the_seed(sea: str) -> None:
    """The RMS of angle rates: amplitude times frequency over root two; of the band, between its ends."""
    scene = varied(QUIET, sea=sea)
    rates = np.concatenate([simulate(scene, seed, duration_s=300.0).midships_radps for seed in range(4)])
    rms = np.std(rates, axis=0)
    angle = np.radians(scene.amplitudes_deg) / np.sqrt(2.0)
    if sea == "tones":
        # Yaw about a ship that pitches, pitch about one that rolls: cross terms of a few per cent.
        assert rms == pytest.approx(angle * 2 * pi / np.array(scene.periods_s), rel=0.05)
    else:
        mean_square = np.mean((2 * pi * np.linspace(0.07, 0.20, 1001)) ** 2)
        assert rms == pytest.approx(angle * np.sqrt(mean_square), rel=0.2)


def test_still_water_leaves_the_rate_of_the_earth() -> None:
    record = simulate(varied(QUIET, sea="still", speed_mps=0.0), 1, duration_s=5.0)
    assert np.linalg.norm(record.midships_radps, axis=1) == pytest.approx(np.full(50, EARTH_RADPS), rel=1e-9)
    latitude = np.radians(QUIET.latitude_deg)
    assert record.midships_radps[0] == pytest.approx(EARTH_RADPS * np.array([np.cos(latitude), 0.0, np.sin(latitude)]))


def test_delay_clock_scale_bias_and_noise_are_as_stated() -> None:
    still = varied(QUIET, static_deg=(0.0, 0.0, 0.0))
    late = simulate(varied(still, delay_s=0.2), 1, duration_s=20.0)
    assert late.local_radps[2:] == pytest.approx(late.midships_radps[:-2], abs=1e-9)
    fast = simulate(varied(still, clock_ppm=1e5), 1, duration_s=20.0)  # a reading stamped 10 s was taken at 9 s
    assert fast.local_radps[99] == pytest.approx(fast.midships_radps[89], abs=1e-9)
    scaled = simulate(varied(still, scale_ppm=1e4), 1, duration_s=20.0)
    ratio = scaled.local_radps / scaled.midships_radps
    assert np.std(ratio, axis=0) == pytest.approx(np.zeros(3), abs=1e-9)
    assert 1e-4 < np.max(np.abs(ratio - 1.0)) < 5e-2
    biased = simulate(varied(still, bias_deg_h=2.0), 1, duration_s=5.0)
    difference = biased.local_radps - biased.midships_radps
    assert set(np.round(np.abs(difference).ravel() / DEG_H_RADPS, 6)) <= {0.0, 4.0}
    noisy = simulate(varied(still, angle_random_walk_deg_rth=0.6, noise_deg_h=0.0), 1, duration_s=300.0)
    # 0.6 deg/sqrt(h) is 0.01 deg/sqrt(s); at 10 Hz 0.0316 deg/s per reading, sqrt(2) times that in the difference.
    assert np.std(noisy.local_radps - noisy.midships_radps) == pytest.approx(np.radians(0.0447), rel=0.05)


def test_stamps_may_be_any() -> None:
    rng = np.random.default_rng(1)
    t1, t2 = np.cumsum(rng.uniform(0.01, 0.1, 200)), np.cumsum(rng.uniform(0.03, 0.2, 90))
    record = simulate(SCENES["A1"], 1, t1, t2)
    assert record.midships_radps.shape == (200, 3)
    assert record.local_radps.shape == (90, 3)
    assert record.flexure_rad.shape == (200, 3)
    assert np.isfinite(record.local_radps).all()
