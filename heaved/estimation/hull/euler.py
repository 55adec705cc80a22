"""The hull-deformation filter of the source: 12 states on Euler angles, cubature or unscented, kept for comparison.

Source: Xu, Wang & Shan 2017 (hull deformation by CKF), eq. (2)-(14): eta = phi + theta, phi constant, theta a
second-order Markov process per axis, epsilon the gyro bias, and the local gyros measure

    z2 = C(eta) w1 + E(eta) theta' + epsilon + v,   C = R3(z) R2(y) R1(x),

E the matrix from Euler-angle rates to local axes. ``ckf`` is the cubature rule, ``ukf`` the symmetric set with
kappa = 3 - n = -9: a centre weight of -3. The paper tells the filters the parameters of the flexure and starts them at
zero, 30 degrees off, without saying how sure of it they are; that decides everything (``start = "zero"`` with
``alignment_std_deg``), and that the one beats the other is a matter of this start. Started by an alignment both do as
well as any. Delay and scale are not in the model: a few milliseconds between the clocks ruin it. Near y = +-90 degrees
the angles degenerate.
"""

from __future__ import annotations

from copy import copy
from math import isfinite, nan
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common import sigma
from heaved.estimation.common.rotations import from_euler
from heaved.estimation.hull.estimate import Method
from heaved.estimation.hull.so3 import Noise, transition
from heaved.estimation.hull.tuning import TUNING

if TYPE_CHECKING:
    from heaved.estimation.hull.markov import Flexure

Array = NDArray[np.float64]

N: Final = 12
PHI, THETA, RATE, BIAS = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)


class EulerFilter:
    """State x (12,) = [phi, theta, theta', epsilon], covariance P (12, 12)."""

    def __init__(self, method: Method, angles_rad: tuple[float, float, float], flexure: Flexure, noise: Noise) -> None:
        """``method``: ckf or ukf."""
        self.method = method
        self._points = sigma.cubature(N) if method == Method.CKF else sigma.symmetric(N, 1.0, 0.0, 3.0 - N)
        self.noise = noise
        self.iterations = 1
        self.x = np.zeros(N)
        self.x[PHI] = angles_rad
        self.P = np.diag(
            np.concatenate([np.full(3, noise.alignment_rad**2), flexure.stationary(), np.full(3, noise.bias_radps**2)])
        )
        self.flexure = flexure

    def predict(self, dt_s: float) -> None:
        """Time update; linear, hence without sigma points, which would give the same."""
        F, Q = transition(self.flexure, self.noise, N, round(dt_s, 9))
        self.x = F.dot(self.x)
        self.P = F.dot(self.P).dot(F.T) + Q

    def ahead(self, dt_s: float) -> EulerFilter:
        """As ``So3Filter.ahead``."""
        twin = copy(self)
        twin.predict(dt_s)
        return twin

    def update(self, motion: Array, local_radps: Array, variance: Array) -> float:
        """As ``So3Filter.update``; only the constant term of ``motion`` is used: the model knows no delay.

        The gate stays open: from a start at zero the first innovations are as large as the motion.
        """
        rates = motion[0]
        R = np.diag(self.noise.of(variance))
        updated = sigma.update(self._points, self.x, self.P, local_radps, lambda points: _measured(points, rates), R)
        if updated is None or not isfinite(updated.nis):
            return nan
        self.x, self.P = updated.x, updated.P
        return min(updated.nis, TUNING.gate_nis)

    def fold(self, always: bool = False) -> None:
        """Nothing to fold: the angles are the state."""

    @property
    def static(self) -> Array:
        """C0, as that of ``So3Filter``."""
        return from_euler(*self.x[PHI].tolist())

    @property
    def total(self) -> Array:
        """C, as that of ``So3Filter``."""
        return from_euler(*(self.x[PHI] + self.x[THETA]).tolist())

    @property
    def dynamic_rad(self) -> Array:
        """(3,) flexure about the hull's axes."""
        return np.asarray(self._to_hull().dot(self.x[THETA]))

    @property
    def covariance(self) -> Array:
        """(3, 3) of the total deformation about the hull's axes, rad^2."""
        P = self.P
        angles = P[PHI, PHI] + P[PHI, THETA] + P[THETA, PHI] + P[THETA, THETA]
        G = self._to_hull()
        return np.asarray(G.dot(angles).dot(G.T))

    def _to_hull(self) -> Array:
        """(3, 3): small changes of the Euler angles as a rotation about the hull's axes."""
        angles = self.x[PHI] + self.x[THETA]
        return np.asarray(from_euler(*angles.tolist()).T.dot(euler_rate_matrix(angles[None])[0]))

    @property
    def bias_radps(self) -> Array:
        """(3,) local minus midships, in local axes."""
        return self.x[BIAS]

    @property
    def delay_s(self) -> float:
        """None is known of."""
        return 0.0

    @property
    def delay_std_s(self) -> float:
        """Not known."""
        return nan

    def residual(self, motion: Array, local_radps: Array) -> Array:
        """As ``So3Filter.residual``."""
        x = self.x.copy()
        x[THETA] = x[RATE] = 0.0
        return np.asarray(self.static.T.dot(local_radps - _measured(x[None], motion[0])[0]))

    def variance(self, midships: Array, local: Array) -> Array:
        """As ``So3Filter.variance``."""
        return np.asarray(midships + (self.static**2).T.dot(local))


def euler_rate_matrix(angles: Array) -> Array:
    """E (k, 3, 3) of angles (k, 3): Euler-angle rates to the local rate, columns R3 R2 e1, R3 e2, e3."""
    sy, cy = np.sin(angles[:, 1]), np.cos(angles[:, 1])
    sz, cz = np.sin(angles[:, 2]), np.cos(angles[:, 2])
    E = np.zeros((len(angles), 3, 3))
    E[:, 0, 0], E[:, 1, 0], E[:, 2, 0] = cz * cy, -sz * cy, sy
    E[:, 0, 1], E[:, 1, 1] = sz, cz
    E[:, 2, 2] = 1.0
    return E


def _measured(points: Array, rates: Array) -> Array:
    """Local rates (k, 3) that the states (k, 12) expect at midships rates (3,)."""
    angles = points[:, PHI] + points[:, THETA]
    (sx, sy, sz), (cx, cy, cz) = np.sin(angles).T, np.cos(angles).T
    x, y, z = rates.tolist()
    dx, dy, dz = points[:, RATE].T
    # R1 w, then R2 and R3, adding each axis's own rate where it acts.
    y, z = cx * y + sx * z, cx * z - sx * y
    x = x + dx
    x, z = cy * x - sy * z, cy * z + sy * x
    y = y + dy
    x, y = cz * x + sz * y, cz * y - sz * x
    z = z + dz
    return np.stack([x, y, z], axis=1) + points[:, BIAS]
