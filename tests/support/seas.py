"""Models of seas for the tests of the sea observer, and textbook computations on their matrices."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm, solve_continuous_lyapunov

from heaved.estimation.heave.sea.model import SeaModel, SeaSystem

Array = np.ndarray


def model(stages: int = 6, chains: int = 2, noise_psd: float = 1e-6) -> SeaModel:
    """A wind sea of 7 s and a swell of 11 s; a third chain in the tail."""
    return SeaModel(
        stages=stages,
        frequency_hz=(0.15, 0.09, 0.25)[:chains],
        damping=(0.3, 0.2, 0.6)[:chains],
        level_m2phz=(3.0, 1.0, 0.05)[:chains],
        noise_psd=noise_psd,
        bias_walk_psd=9e-10,
    )


def whole(system: SeaSystem, dt_s: float) -> tuple[Array, Array]:
    """F and Q of the whole matrix at once, doubled from a step so short that three terms of the series suffice:
    Q(2h) = Q(h) + F(h) Q(h) F(h)'.
    """
    doublings = 20
    h, A, D = dt_s / 2**doublings, system.A, np.diag(system.diffusion)
    F = expm(A * h)
    Q = D * h + (A @ D + D @ A.T) * h**2 / 2 + (A @ A @ D + 2 * A @ D @ A.T + D @ A.T @ A.T) * h**3 / 6
    for _ in range(doublings):
        Q = Q + F @ Q @ F.T
        F = F @ F
    return expm(A * dt_s), Q


def stationary(system: SeaSystem) -> Array:
    """A P + P A' + D = 0 of the waves (n - 1, n - 1): the bias has no stationary state."""
    A, D = system.A[:-1, :-1], np.diag(system.diffusion[:-1])
    return solve_continuous_lyapunov(A, -D)


def simulated(system: SeaSystem, dt_s: float, count: int, seed: int) -> tuple[Array, Array]:
    """A realisation of the model: states (count, n) without bias, and noisy samples of the acceleration (count,)."""
    rng = np.random.default_rng(seed)
    F, Q = whole(system, dt_s)
    values, vectors = np.linalg.eigh(Q)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    values, vectors = np.linalg.eigh(stationary(system))
    x = np.zeros(len(F))
    x[:-1] = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(F) - 1))
    driven = rng.standard_normal((count, len(F))) @ root.T
    driven[:, -1] = 0.0
    states = np.empty((count, len(F)))
    for i in range(count):
        x = F @ x + driven[i]
        states[i] = x
    noise = np.sqrt(0.5 * system.model.noise_psd / dt_s) * rng.standard_normal(count)
    return states, states @ system.H + noise


class Kalman:
    """The textbook filter, one line per equation, in Joseph's form."""

    def __init__(self, system: SeaSystem, x: Array, P: Array, R: float) -> None:
        self.system, self.x, self.P, self.R = system, x.copy(), P.copy(), R

    def predict(self, dt_s: float) -> None:
        F, Q = whole(self.system, dt_s)
        self.x, self.P = F @ self.x, F @ self.P @ F.T + Q

    def update(self, z: float) -> tuple[float, float]:
        """(heave before, innovation)"""
        H = self.system.H
        before, y = float(self.system.heave @ self.x), z - float(H @ self.x)
        K = self.P @ H / (H @ self.P @ H + self.R)
        L = np.eye(len(H)) - np.outer(K, H)
        self.x, self.P = self.x + K * y, L @ self.P @ L.T + self.R * np.outer(K, K)
        return before, y
