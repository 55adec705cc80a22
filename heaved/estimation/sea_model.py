"""The sea as a linear stochastic model: cascaded resonators, their spectrum, and the filter that belongs to them.

K components; each is a chain of M equal resonators. White noise drives the first, the position of the first the second,
of the second the third, and from there on the acceleration of each the next; heave is the position of the last (index 0
here, the noise enters at M - 1):

    x_s'' = -w^2 x_s - 2 zeta w x_s' + 2 zeta w u_s,    w u_s = x_{s+1}'' (s < M - 3),  w^2 x_{s+1} (M - 3, M - 2),

three low-passes and M - 3 high-passes, each with gain 1 at its resonance. The displacement spectrum of one component,
x = f / f0,

    S(f) = L (2 zeta)^(2M) x^(4(M-3)) / ((1 - x^2)^2 + (2 zeta x)^2)^M,      L = S(f0),

falls to zero at f = 0: heave has no mean, and nothing drifts, because the model says so. Its two sides are apart: the
skirt towards long waves, in which the error of the heave lives, is as steep as M says, while above the peak it falls
with f^-12 whatever M, between the f^-9 of a small vessel and the end of all heave in waves much shorter than the hull.
(Were every resonator driven by the velocity of the one before, a steep skirt would bring an equally steep tail, and a
component would be spent on the tail.) The vertical acceleration is an exact linear function of the state, without the
driving noise in it; a slow bias is a state of its own.

Velocities are kept as x'/w, so that every element of the state is in metres and of the size of the heave.
"""

from __future__ import annotations

from functools import cached_property
from math import ceil, log2, sqrt
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.linalg.lapack import dgesv

Array = NDArray[np.float64]

DOUBLINGS: Final = 40
"""Of the Riccati recursion: 2^40 samples are thirty years at 1 kHz."""
RICCATI_TOLERANCE: Final = 1e-8
"""Relative change of P at which the doubling has converged; it is quadratic, so the next one would change nothing."""
BIAS_SPREAD_MPS2: Final = 0.5
"""What is known of the accelerometer's bias at the start, with what a wrong tilt adds."""


class SeaModel(msgspec.Struct, frozen=True, kw_only=True):
    """Spectrum of the sea and noise of its measurement; K components, each of ``stages`` resonators."""

    stages: int
    """M, resonators in one chain."""
    frequency_hz: tuple[float, ...]
    """(K,) f0."""
    damping: tuple[float, ...]
    """(K,) zeta of each resonator; the chain is narrower than one of them."""
    level_m2phz: tuple[float, ...]
    """(K,) displacement spectrum at f0, one-sided, m2/Hz."""
    noise_psd: float
    """White noise of the vertical acceleration, one-sided, (m/s2)2/Hz."""
    bias_walk_psd: float
    """Random walk of its bias: variance per second, (m/s2)2/s."""

    def heave_spectrum(self, f_hz: Array) -> Array:
        """One-sided heave spectrum, m2/Hz, at ``f_hz`` (n,) > 0."""
        total = np.zeros_like(f_hz)
        for f0, zeta, level in zip(self.frequency_hz, self.damping, self.level_m2phz, strict=True):
            total += level * chain_shape(f_hz / f0, zeta, self.stages)
        return total

    def acceleration_spectrum(self, f_hz: Array) -> Array:
        """One-sided spectrum of the measured vertical acceleration, noise and bias included, (m/s2)2/Hz."""
        w2 = (2.0 * np.pi * f_hz) ** 2
        return w2**2 * self.heave_spectrum(f_hz) + self.noise_psd + 2.0 * self.bias_walk_psd / w2

    @property
    def size(self) -> int:
        """n = 2 M K + 1 states: (x, x'/w) of each stage of each chain, then the bias."""
        return 2 * self.stages * len(self.frequency_hz) + 1


def chain_shape(x: Array, zeta: float, stages: int) -> Array:
    """Spectrum of one chain over x = f / f0 (n,), 1 at its resonance."""
    c = 4.0 * zeta * zeta
    return np.asarray(c**stages * x ** (4 * (stages - 3)) / ((1.0 - x * x) ** 2 + c * x * x) ** stages)


class SeaSystem:
    """The model as a state space, x' = A x + G w, z = H x + v.

    Attributes:
        A: (n, n), 1/s.
        H: (n,), vertical acceleration from the state, 1/s2 (bias: 1).
        heave, velocity: (n,), rows that give heave (m) and its velocity (m/s).
        diffusion: (n,), diagonal of G G', per second.
    """

    def __init__(self, model: SeaModel) -> None:
        self.model = model
        M, n = model.stages, model.size
        self.A, self.H = np.zeros((n, n)), np.zeros(n)
        self.heave, self.velocity, self.diffusion = np.zeros(n), np.zeros(n), np.zeros(n)
        chains = zip(model.frequency_hz, model.damping, model.level_m2phz, strict=True)
        for k, (f0, zeta, level) in enumerate(chains):
            w, at = 2.0 * np.pi * f0, 2 * M * k
            for s in reversed(range(M)):
                x, v = at + 2 * s, at + 2 * s + 1
                self.A[x, v] = w
                if s < M - 3:
                    self.A[v] = 2.0 * zeta * self.A[v + 2]
                elif s < M - 1:
                    self.A[v, x + 2] = 2.0 * zeta * w
                self.A[v, x] -= w
                self.A[v, v] -= 2.0 * zeta * w
            self.H[:] += w * self.A[at + 1] * _inside(n, at, at + 2 * M)
            self.heave[at], self.velocity[at + 1] = 1.0, w
            self.diffusion[at + 2 * M - 1] = 2.0 * (zeta * w) ** 2 * level
        self.H[-1] = 1.0
        self.diffusion[-1] = model.bias_walk_psd

    def transition(self, dt_s: float) -> tuple[Array, Array]:
        """F = expm(A dt) and Q of the same step (n, n) each, exact (Van Loan 1978). ``dt_s`` > 0."""
        # Van Loan's exponential runs backwards too, where a damped chain explodes: a long step is doubled from a short.
        doublings = max(0, ceil(log2(max(dt_s * float(np.max(np.abs(self.A))), 1.0))))
        dt_s /= 2.0**doublings
        n, M2 = len(self.H), 2 * self.model.stages
        F, Q = np.eye(n), np.zeros((n, n))
        for at in range(0, n - 1, M2):
            block = slice(at, at + M2)
            A = self.A[block, block]
            joint = np.zeros((2 * M2, 2 * M2))
            joint[:M2, :M2], joint[M2:, M2:] = -A, A.T
            joint[:M2, M2:] = np.diag(self.diffusion[block])
            e = expm(joint * dt_s)
            F[block, block] = e[M2:, M2:].T
            q = F[block, block] @ e[:M2, M2:]
            Q[block, block] = 0.5 * (q + q.T)
        Q[-1, -1] = self.diffusion[-1] * dt_s
        for _ in range(doublings):
            Q = Q + F @ Q @ F.T
            F, Q = F @ F, 0.5 * (Q + Q.T)
        return F, Q

    def moved(self, tau_s: float) -> Array:
        """F^(tau / dt) without Q, for any sign of ``tau_s``: (n, n)."""
        n, M2 = len(self.H), 2 * self.model.stages
        F = np.eye(n)
        for at in range(0, n - 1, M2):
            block = slice(at, at + M2)
            F[block, block] = expm(self.A[block, block] * tau_s)
        return F

    @cached_property
    def stationary(self) -> Array:
        """Covariance (n, n) of the state of which nothing is known but the spectrum: P = F P F' + Q of any step."""
        n, M2 = len(self.H), 2 * self.model.stages
        P = np.zeros((n, n))
        for at in range(0, n - 1, M2):
            block = slice(at, at + M2)
            P[block, block] = _stationary(self.A[block, block], np.diag(self.diffusion[block]))
        P[-1, -1] = BIAS_SPREAD_MPS2**2
        return P

    def steady(self, dt_s: float) -> Steady | None:
        """The filter that the Kalman filter becomes when samples arrive every ``dt_s``; None: it does not converge.

        The Riccati equation is solved by doubling: each pass covers twice as many samples (Anderson & Moore 1979,
        section 6.7; Chu, Fan & Lin 2005).
        """
        F, Q = self.transition(dt_s)
        R = measurement_variance(self.model.noise_psd, dt_s)
        n, identity = len(F), np.eye(len(F))
        a, g, p = F.T, np.outer(self.H, self.H) / R, Q
        for _ in range(DOUBLINGS):
            right = np.empty((n, 2 * n), order="F")
            right[:, :n], right[:, n:] = a, g
            _, _, solved, info = dgesv(identity + g @ p, right, overwrite_a=True, overwrite_b=True)
            t, tg = solved[:, :n], solved[:, n:]
            step = a.T @ p @ t
            p = p + 0.5 * (step + step.T)
            if info != 0 or not np.isfinite(p).all():
                return None
            if float(np.trace(step)) <= RICCATI_TOLERANCE * float(np.trace(p)):
                return self._steady(dt_s, F, Q, p)
            step = a @ tg @ a.T
            a, g = a @ t, g + 0.5 * (step + step.T)
        return None

    def steady_of(self, dt_s: float, P: Array) -> Steady:
        """That filter from its covariance ``P`` (n, n) before a sample is taken in."""
        return self._steady(dt_s, *self.transition(dt_s), P)

    def _steady(self, dt_s: float, F: Array, Q: Array, P: Array) -> Steady:
        PH = P @ self.H
        S = float(self.H @ PH) + measurement_variance(self.model.noise_psd, dt_s)
        return Steady(dt_s=dt_s, F=F, Q=Q, P=P, K=PH / S, S=S)


class Steady(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """What a regular stream of samples makes of the Kalman filter."""

    dt_s: float
    F: Array
    """(n, n)"""
    Q: Array
    """(n, n)"""
    P: Array
    """(n, n) covariance of the state *before* the sample of its own time is taken in."""
    K: Array
    """(n,) gain."""
    S: float
    """Variance of the innovation, (m/s2)2."""


def measurement_variance(noise_psd: float, dt_s: float) -> float:
    """Variance of one sample (m/s2)2 of white noise of one-sided density ``noise_psd``, taken every ``dt_s``."""
    return 0.5 * noise_psd / dt_s


def _inside(n: int, first: int, end: int) -> Array:
    mask = np.zeros(n)
    mask[first:end] = 1.0
    return mask


def _stationary(A: Array, D: Array) -> Array:
    """P of A P + P A' + D = 0 for a stable A, by doubling F P F' + Q."""
    scale = 1.0 / float(np.max(np.abs(A)))
    n = len(A)
    joint = np.zeros((2 * n, 2 * n))
    joint[:n, :n], joint[:n, n:], joint[n:, n:] = -A, D, A.T
    e = expm(joint * scale)
    F: Array = e[n:, n:].T
    P = F @ e[:n, n:]
    while True:
        more = F @ P @ F.T
        P = P + more
        if not float(np.trace(more)) > 1e-15 * float(np.trace(P)):
            return 0.5 * (P + P.T)
        F = F @ F


def heave_std(model: SeaModel) -> float:
    """Standard deviation of the heave that the model describes, m."""
    system = SeaSystem(model)
    return sqrt(float(system.heave @ system.stationary @ system.heave))
