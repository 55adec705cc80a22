"""The filters and the alignment against derivatives, a Kalman filter written out here, and rotations that are known."""

from __future__ import annotations

from math import pi

import msgspec
import numpy as np
import pytest

from heaved.estimation.common.rotations import ARCSEC, from_euler, passive, rotation_vector
from heaved.estimation.hull.alignment import align
from heaved.estimation.hull.estimate import Method
from heaved.estimation.hull.euler import EulerFilter, euler_rate_matrix
from heaved.estimation.hull.markov import Flexure
from heaved.estimation.hull.so3 import At, Noise, So3Filter
from heaved.estimation.hull.tuning import TUNING

FLEXURE = Flexure(np.full(3, 5 * ARCSEC), np.full(3, 0.1), np.full(3, 2 * pi * 0.16))
NOISE = Noise(
    alignment_rad=np.radians(2.0),
    bias_radps=1e-6,
    scale=1e-4,
    delay_s=0.02,
    static_walk_rad_rts=1e-8,
    bias_walk_radps_rts=1e-9,
    delay_walk_s_rts=1e-5,
    sample_radps=np.array([1.0, 1.5, 2.0]) * ARCSEC,
    left=np.ones(3),
    ordinary=np.full(3, np.inf),
)
NOTHING = np.zeros(3)
"""What holes and vibration leave."""
MOUNT = from_euler(0.1, -0.4, 2.0)
RNG = np.random.default_rng(1)
MOTION = np.vstack([RNG.normal(0.0, 0.05, (2, 3)), RNG.normal(0.0, 0.02, (3, 3))])


def so3_filter() -> So3Filter:
    return So3Filter(MOUNT, 0.004, FLEXURE, NOISE)


def expected_rate(x: np.ndarray) -> np.ndarray:
    """The measurement equation as it is written in the module, with the exponential in full."""
    late = -x[At.DELAY]
    rate = sum(MOTION[k] * late**k for k in range(5))
    bent = passive(x[At.PSI : At.PSI + 3] + x[At.THETA : At.THETA + 3]) @ (rate + x[At.THETA_RATE : At.THETA_RATE + 3])
    return np.asarray(bent + x[At.SCALE : At.SCALE + 3] * rate + x[At.BIAS : At.BIAS + 3])


def test_the_measurement_and_its_derivative() -> None:
    filter = so3_filter()
    x = RNG.normal(0.0, 1e-4, 16)
    x[At.DELAY] = 0.013
    value, H = filter.measured(x, MOTION)
    assert value == pytest.approx(expected_rate(x), abs=1e-12)
    for i in range(16):
        d = np.zeros(16)
        d[i] = 1e-5
        slope = (expected_rate(x + d) - expected_rate(x - d)) / 2e-5
        assert H[:, i] == pytest.approx(slope, abs=2e-5), i


def test_prediction_and_update_are_those_of_a_kalman_filter() -> None:
    """Covariances by the short form; equal where the problem is well conditioned, which it is after the first steps."""
    filter = so3_filter()
    F6, Q6 = FLEXURE.transition(0.1)
    F, Q = np.eye(16), np.zeros((16, 16))
    F[3:9, 3:9], Q[3:9, 3:9] = F6, Q6
    Q[:3, :3] += 1e-16 * 0.1 * np.eye(3)
    Q[9:12, 9:12] += 1e-18 * 0.1 * np.eye(3)
    Q[15, 15] += 1e-10 * 0.1
    x, P = filter.x.copy(), filter.P.copy()
    for _ in range(20):
        motion = MOTION * RNG.normal(0.0, 1.0, (1, 3))
        z = MOUNT @ (motion[0] + RNG.normal(0.0, 1e-5, 3))
        _, H = filter.measured(F @ x, motion)
        y = MOUNT.T @ z - filter.measured(F @ x, motion)[0]
        x, P = F @ x, F @ P @ F.T + Q
        S = H @ P @ H.T + np.diag(NOISE.sample_radps**2)
        K = np.linalg.solve(S, H @ P).T
        nis = float(y @ np.linalg.solve(S, y))
        x, P = x + K @ y, P - K @ S @ K.T
        filter.predict(0.1)
        assert filter.update(motion, z, NOTHING) == pytest.approx(nis, rel=1e-6)
        scale = np.sqrt(np.diag(P))
        assert (filter.x - x) / scale == pytest.approx(np.zeros(16), abs=1e-5)
        assert filter.P / np.outer(scale, scale) == pytest.approx(P / np.outer(scale, scale), abs=1e-4)


def test_folding_changes_the_linearisation_and_not_the_deformation() -> None:
    filter = so3_filter()
    filter.x[:6] = RNG.normal(0.0, 1e-5, 6)
    before, static = filter.total, filter.static
    filter.fold()  # too small to be worth it
    assert filter.C0 is MOUNT
    filter.fold(always=True)
    assert not filter.x[:3].any()
    assert rotation_vector(before.T @ filter.total) == pytest.approx(np.zeros(3), abs=1e-9)
    assert filter.static == pytest.approx(static, abs=1e-12)


def test_an_impossible_reading_is_gated_and_a_broken_covariance_is_said() -> None:
    filter = so3_filter()
    x, P = filter.x.copy(), filter.P.copy()
    assert filter.update(MOTION, np.array([5.0, 5.0, 5.0]), NOTHING) > TUNING.gate_nis
    assert np.array_equal(filter.x, x)
    assert np.array_equal(filter.P, P)
    filter.P = -P
    assert np.isnan(filter.update(MOTION, MOUNT @ MOTION[0], NOTHING))


@pytest.mark.parametrize("kind", [Method.CKF, Method.UKF])
def test_the_euler_filter_measures_what_the_kinematics_say(kind: Method) -> None:
    """C(eta) w1 + the local rate of the frame, the latter by differencing C: [w x] = -dC/dt C'."""
    filter = EulerFilter(kind, (0.3, -0.5, 2.0), FLEXURE, NOISE)
    eta, rate, h = np.array([0.3, -0.5, 2.0]), np.array([0.02, -0.03, 0.05]), 1e-6
    C = from_euler(*eta)
    slope = (from_euler(*(eta + h * rate)) - from_euler(*(eta - h * rate))) / (2 * h)
    W = -slope @ C.T
    turning = np.array([W[2, 1], W[0, 2], W[1, 0]])
    assert euler_rate_matrix(eta[None])[0] @ rate == pytest.approx(turning, abs=1e-9)
    filter.x[6:9] = rate
    filter.P *= 1e-12
    z = C @ MOTION[0] + turning
    assert filter.update(MOTION, z, NOTHING) == pytest.approx(0.0, abs=1e-3)
    assert filter.residual(MOTION, z) == pytest.approx(C.T @ turning, abs=1e-9)


@pytest.mark.parametrize("kind", [Method.CKF, Method.UKF])
def test_near_the_truth_the_euler_filter_is_the_default_one(kind: Method) -> None:
    """The same linear problem in two coordinates: the deviations about the hull's axes agree."""
    noise = Noise(
        alignment_rad=1e-3, bias_radps=1e-7, scale=1e-9, delay_s=1e-9, static_walk_rad_rts=0.0,
        bias_walk_radps_rts=0.0, delay_walk_s_rts=0.0, sample_radps=np.full(3, ARCSEC),
        left=np.ones(3), ordinary=np.full(3, np.inf),
    )  # fmt: skip
    C = from_euler(0.0, 0.0, 0.5)
    euler, so3 = EulerFilter(kind, (0.0, 0.0, 0.5), FLEXURE, noise), So3Filter(C, 0.0, FLEXURE, noise)
    for k in range(150):
        w = np.array([0.05 * np.cos(0.08 * k), 0.04 * np.sin(0.1 * k), 0.03 * np.cos(0.06 * k + 1.0)])
        motion = np.vstack([w, np.zeros((4, 3))])
        for filter in (euler, so3):
            filter.predict(0.1)
            filter.update(motion, C @ w, NOTHING)
    assert np.sqrt(np.diag(euler.covariance)) == pytest.approx(np.sqrt(np.diag(so3.covariance)), rel=0.01)


# --- alignment -------------------------------------------------------------------------------------------------------


def motions(t: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Taylor polynomials (n, 5, 3) of tones at 8, 6 and 10 s about ``t``."""
    w, a = 2 * pi / np.array([8.0, 6.0, 10.0]), np.radians([4.0, 2.0, 3.0]) * axes
    phase = np.multiply.outer(t, w)
    factorial = np.array([1.0, 1.0, 2.0, 6.0, 24.0])
    return np.stack([a * w ** (k + 1) * np.cos(phase + k * pi / 2) / factorial[k] for k in range(5)], axis=1)


T = np.arange(50) / 10.0


@pytest.mark.parametrize("delay", [0.0, 0.005, -0.05, 0.12])
def test_alignment_finds_the_rotation_and_the_delay(delay: float) -> None:
    known = motions(T, np.ones(3))
    late = motions(T - delay, np.ones(3))[:, 0]
    found = align(known, late @ MOUNT.T, 10.0, 0.15)
    assert found.delay_s == pytest.approx(delay, abs=2e-4)
    assert np.linalg.norm(rotation_vector(found.C.T @ MOUNT)) < 3e-4
    assert found.misfit < 1e-3
    assert found.std_rad < 1e-2


def test_alignment_is_a_proper_rotation_and_says_how_well_it_is_known() -> None:
    rng = np.random.default_rng(2)
    known = motions(T, np.ones(3))
    noise = 1e-3 * rng.standard_normal((len(T), 3))
    found = align(known, known[:, 0] @ MOUNT.T + noise, 10.0, 0.0)
    assert np.linalg.det(found.C) == pytest.approx(1.0)
    assert found.noise_radps == pytest.approx(np.full(3, 1e-3), rel=0.4)
    # One direction of motion leaves the rotation about it open, whatever the residual.
    roll = motions(T, np.array([1.0, 0.0, 0.0]))
    assert align(roll, roll[:, 0] @ MOUNT.T + noise, 10.0, 0.0).std_rad > 10 * found.std_rad
    assert align(0.0 * known, noise, 10.0, 0.0).std_rad == np.inf
    mirrored = known[:, 0] * np.array([1.0, -1.0, 1.0])
    assert align(known, mirrored, 10.0, 0.0).misfit > 0.1


def test_what_holes_leave_counts_as_it_was_found_and_beyond_that_in_full() -> None:
    noise = msgspec.structs.replace(
        NOISE, sample_radps=np.full(3, 2.0), left=np.full(3, 0.25), ordinary=np.full(3, 8.0)
    )
    assert noise.of(np.array([0.0, 4.0, 10.0])) == pytest.approx([4.0, 5.0, 8.0])
