"""The default hull-deformation filter: errors of a rotation matrix, so that no mounting angle is special.

Source: rate matching as in Xu, Wang & Shan 2017 (hull deformation by CKF), eq. (2)-(14), with the large angles kept in
a matrix instead of Euler angles: C = C0 exp(-[(psi + theta) x]), so the problem that remains is nearly linear and the
same for every mounting. With everything turned back into the hull's axes by C0' the local gyros measure

    C0' z2 = exp(-[(psi + theta) x]) (w1(t - tau) + theta') + diag(s) w1 + epsilon + v,

psi the error of C0 (static deformation and mounting), theta the flexure, epsilon the difference of the gyro biases, s
that of the scales, tau the time by which the local stamps are late. The scale errors of gyros that do not stand along
the hull's axes also couple these axes: a symmetric coupling of m ppm looks like a rotation of up to 0.2 m arcsec, and
no rates tell them apart better than that.
"""

from __future__ import annotations

from copy import copy
from enum import IntEnum
from functools import lru_cache
from math import isfinite, sqrt
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dpotrf

from heaved.estimation.common.rotations import cross_matrix, passive
from heaved.estimation.hull.tuning import TUNING

if TYPE_CHECKING:
    from heaved.estimation.hull.markov import Flexure

Array = NDArray[np.float64]

_EYE = np.eye(16)
_EYE3 = np.eye(3)


class At(IntEnum):
    """First element of each part of the state (16)."""

    PSI = 0
    THETA = 3
    THETA_RATE = 6
    BIAS = 9
    SCALE = 12
    DELAY = 15


class Noise(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """Prior standard deviations and what they grow by; SI units, rad and s."""

    alignment_rad: float
    bias_radps: float
    scale: float
    delay_s: float
    static_walk_rad_rts: float
    bias_walk_radps_rts: float
    delay_walk_s_rts: float
    sample_radps: Array
    """(3,) white noise of one slow reading of the rate difference, in hull axes, beyond what holes and vibration leave.
    """
    left: Array
    """(3,) how much of the variance that these are reckoned to leave is there, in hull axes ..."""
    ordinary: Array
    """... up to this variance (3,). What is beyond counts in full: none of it was there when ``left`` was found."""

    def of(self, variance: Array) -> Array:
        """(3,) variance of a slow reading in which holes and vibration are reckoned to leave ``variance`` (3,)."""
        beyond = np.maximum(variance - self.ordinary, 0.0)
        return np.asarray(self.sample_radps**2 + self.left * (variance - beyond) + beyond)


@lru_cache(maxsize=50)
def transition(flexure: Flexure, noise: Noise, size: int, dt_s: float) -> tuple[Array, Array]:
    """F and Q over ``dt_s``, exact, of a state (size,): psi, theta, theta', epsilon; scales, which stay; delay."""
    F, Q = np.eye(size), np.zeros((size, size))
    bends = slice(At.THETA, At.BIAS)
    F[bends, bends], Q[bends, bends] = flexure.transition(dt_s)
    walk = np.zeros(size)
    walk[At.PSI : At.THETA] = noise.static_walk_rad_rts**2
    walk[At.BIAS : At.SCALE] = noise.bias_walk_radps_rts**2
    walk[At.DELAY :] = noise.delay_walk_s_rts**2
    Q[np.diag_indices(size)] += walk * dt_s
    return F, Q


class So3Filter:
    """State x (16,), covariance P (16, 16), linearised about C0 (3, 3): each is replaced, never changed in place."""

    def __init__(self, C0: Array, delay_s: float, flexure: Flexure, noise: Noise) -> None:
        self.C0 = C0
        self.x = np.zeros(16)
        self.x[At.DELAY] = delay_s
        self.noise = noise
        self.iterations = 1
        variances = np.concatenate(
            [
                np.full(3, noise.alignment_rad**2),
                flexure.stationary(),
                np.full(3, noise.bias_radps**2),
                np.full(3, noise.scale**2),
                [noise.delay_s**2],
            ]
        )
        self.P = np.diag(variances)
        self.flexure = flexure

    # --- time ---------------------------------------------------------------------------------------------------------

    def predict(self, dt_s: float) -> None:
        """Move on by ``dt_s`` (any positive step: the discretisation is exact)."""
        F, Q = transition(self.flexure, self.noise, len(self.x), round(dt_s, 9))
        self.x = F.dot(self.x)
        P = F.dot(self.P).dot(F.T)
        P += Q
        self.P = P

    def ahead(self, dt_s: float) -> So3Filter:
        """Another filter, as this one will be after ``dt_s`` without a reading."""
        twin = copy(self)
        twin.predict(dt_s)
        return twin

    # --- measurement --------------------------------------------------------------------------------------------------

    def update(self, motion: Array, local_radps: Array, variance: Array) -> float:
        """Take a local reading (3,); ``motion`` (k, 3): midships rates as a polynomial in time about its stamp.

        ``variance`` (3,): what holes and vibration leave of both, in hull axes. Returns the normalised innovation
        squared; beyond the gate nothing has changed. nan: the covariance is no longer one or something is not finite;
        the caller starts over and counts.
        """
        x0, P = self.x, self.P
        z = self.C0.T.dot(local_radps)
        R = self.noise.of(variance)
        x, nis = x0, float("nan")
        for iteration in range(self.iterations):
            expected, H = self.measured(x, motion)
            y = z - expected + H.dot(x - x0)
            HP = H.dot(P)
            S = HP.dot(H.T)
            S.flat[::4] += R
            factor, info = dpotrf(S, 1, 1)
            if info != 0:
                return float("nan")
            # S = L L': W = L^-1 H P, so that K = W' L^-1.
            W = dtrsm(1.0, factor, HP, 0, 1)
            v = dtrsm(1.0, factor, y[:, None], 0, 1)[:, 0]
            if iteration == 0:
                nis = float(v.dot(v))
                if not isfinite(nis):
                    return float("nan")
                if nis > TUNING.gate_nis:
                    return nis
            x = x0 + v.dot(W)
        K = dtrsm(1.0, factor, W, 0, 1, 1).T
        A = _EYE - K.dot(H)
        P = A.dot(P).dot(A.T) + (K * R).dot(K.T)
        self.x, self.P = x, 0.5 * (P + P.T)
        if not isfinite(float(x.dot(x))) or not float(self.P.diagonal().min()) > 0.0:
            return float("nan")
        return nis

    def measured(self, x: Array, motion: Array) -> tuple[Array, Array]:
        """Expected rate (3,) in hull axes and its derivative H (3, 16) at the state x."""
        late = -float(x[At.DELAY])
        powers = late ** np.arange(len(motion))
        rate = powers.dot(motion)
        slope = (powers[:-1] * np.arange(1, len(motion))).dot(motion[1:])
        turning = rate + x[At.THETA_RATE : At.BIAS]
        # exp(-[d x]) to second order; d is folded away long before the third matters.
        D = cross_matrix(x[At.PSI : At.THETA] + x[At.THETA : At.THETA_RATE])
        bent = D.dot(turning)
        bent = turning - bent + 0.5 * D.dot(bent)
        H = np.zeros((3, 16))
        H[:, At.PSI : At.THETA] = H[:, At.THETA : At.THETA_RATE] = cross_matrix(bent)
        H[:, At.THETA_RATE : At.BIAS] = _EYE3 - D
        H[:, At.BIAS : At.SCALE] = _EYE3
        H[0, At.SCALE], H[1, At.SCALE + 1], H[2, At.SCALE + 2] = rate.tolist()
        H[:, At.DELAY] = D.dot(slope) - slope
        expected = bent + rate * x[At.SCALE : At.DELAY] + x[At.BIAS : At.SCALE]
        return expected, H

    def fold(self, always: bool = False) -> None:
        """Move psi into C0."""
        psi = self.x[At.PSI : At.THETA]
        if always or float(psi.dot(psi)) > TUNING.fold_rad**2:
            self.C0 = self.C0.dot(passive(psi))
            self.x = np.concatenate([np.zeros(3), self.x[At.THETA :]])

    # --- what it says -------------------------------------------------------------------------------------------------

    @property
    def static(self) -> Array:
        """(3, 3) local from midships without the flexure."""
        return np.asarray(self.C0.dot(passive(self.x[At.PSI : At.THETA])))

    @property
    def dynamic_rad(self) -> Array:
        """(3,) flexure about the hull's axes."""
        return self.x[At.THETA : At.THETA_RATE]

    @property
    def total(self) -> Array:
        """(3, 3) local from midships, C."""
        return np.asarray(self.C0.dot(passive(self.x[At.PSI : At.THETA] + self.x[At.THETA : At.THETA_RATE])))

    @property
    def covariance(self) -> Array:
        """(3, 3) of the total deformation about the hull's axes, rad^2."""
        P = self.P
        cross = P[At.PSI : At.THETA, At.THETA : At.THETA_RATE]
        return np.asarray(P[:3, :3] + cross + cross.T + P[3:6, 3:6])

    @property
    def bias_radps(self) -> Array:
        """(3,) local minus midships, in local axes."""
        return np.asarray(self.C0.dot(self.x[At.BIAS : At.SCALE]))

    @property
    def delay_s(self) -> float:
        """By which local stamps are late."""
        return float(self.x[At.DELAY])

    @property
    def delay_std_s(self) -> float:
        """Its standard deviation."""
        return sqrt(max(float(self.P[At.DELAY, At.DELAY]), 0.0))

    def residual(self, motion: Array, local_radps: Array) -> Array:
        """(3,) flexure rate with noise, hull axes: the reading less all that the state explains but theta'."""
        x = self.x.copy()
        x[At.THETA : At.BIAS] = 0.0
        return np.asarray(self.C0.T.dot(local_radps) - self.measured(x, motion)[0])

    def variance(self, midships: Array, local: Array) -> Array:
        """(3,) of the rate difference, hull axes: variances (3,) of both rates, each in its own axes."""
        return np.asarray(midships + (self.C0**2).T.dot(local))
