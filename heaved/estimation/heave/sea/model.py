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

Beside the waves the accelerometer shows white noise, the wander of its bias, and what shakes it: engines, propellers,
the hull's own bending. Each of these is a resonance: two equal resonators, the position of the first driving the
second, whose acceleration is what is measured; it falls with f^4 towards the waves, as the acceleration of everything
does that stays where it is. Noise drives it at the samples, not between them, and in that direction of the state (n =
4) in which the two zeros at f = 0 stay where they are: were it driven in between, what its broad flank has above half
the rate of the samples would fold back into the waves, where there is nothing of it. With z = exp(2 pi i f dt) and the
poles p, p* of a resonator,

    S(f) ~ |(z - 1) / ((z - p) (z - p*))|^4,     L = S(f0).

States of it are kept in m/s2. What lies right above the waves and is broad is short waves: a resonance that counts as
heave.
"""

from __future__ import annotations

from functools import cached_property
from math import ceil, log2, pi, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.linalg.lapack import dgesv

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]

DOUBLINGS: Final = 40
"""Of the Riccati recursion: 2^40 samples are thirty years at 1 kHz."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What is not fitted of the model."""

    riccati_tolerance: float = 1e-8
    """Relative change of P at which the doubling has converged; it is quadratic, so the next one would change
    nothing."""
    bias_spread_mps2: float = 0.5
    """What is known of the accelerometer's bias at the start, with what a wrong tilt adds."""
    blow: float = 30.0
    """Times that what rings may ring more after a slam than it does on the whole."""
    short_waves_step_s: float = 0.05
    """Samples so often show short waves as they are."""


TUNING: Final = Tuning()


PAIR: Final = 4
"""States of a resonance."""


class Resonance(msgspec.Struct, frozen=True, kw_only=True):
    """What shakes the accelerometer beside the waves."""

    frequency_hz: float
    damping: float
    level: float
    """Spectrum of the acceleration at that frequency, one-sided, (m/s2)2/Hz."""
    is_heave: bool = False
    """Short waves: its displacement is part of the heave."""
    variance: float = 0.0
    """Of the acceleration that the record shows, (m/s2)2."""

    def spectrum(self, f_hz: Array, dt_s: float) -> Array:
        """One-sided spectrum of the acceleration, (m/s2)2/Hz, at ``f_hz`` (n,), of samples every ``dt_s``."""
        peak = resonance_shape(np.array([self.frequency_hz]), self.frequency_hz, self.damping, dt_s)
        return np.asarray(self.level / peak * resonance_shape(f_hz, self.frequency_hz, self.damping, dt_s))


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
    resonances: tuple[Resonance, ...] = ()

    def heave_spectrum(self, f_hz: Array) -> Array:
        """One-sided heave spectrum, m2/Hz, at ``f_hz`` (n,) > 0."""
        total = self.wave_spectrum(f_hz)
        for one in self.resonances:
            if one.is_heave:
                total += one.spectrum(f_hz, TUNING.short_waves_step_s) / (2.0 * np.pi * f_hz) ** 4
        return total

    def wave_spectrum(self, f_hz: Array) -> Array:
        """That of the chains alone."""
        total = np.zeros_like(f_hz)
        for f0, zeta, level in zip(self.frequency_hz, self.damping, self.level_m2phz, strict=True):
            total += level * chain_shape(f_hz / f0, zeta, self.stages)
        return total

    def acceleration_spectrum(self, f_hz: Array, dt_s: float) -> Array:
        """One-sided spectrum of the vertical acceleration as it is measured every ``dt_s``, (m/s2)2/Hz: with what
        shakes the sensor, its noise and its bias.
        """
        w2 = (2.0 * np.pi * f_hz) ** 2
        waves = w2**2 * self.wave_spectrum(f_hz) + shaking_spectrum(self.resonances, f_hz, dt_s)
        return waves + self.noise_psd + 2.0 * self.bias_walk_psd / w2

    @property
    def size(self) -> int:
        """n states: (x, x'/w) of each stage of each chain, and of both of each resonance, then the bias."""
        return 2 * self.stages * len(self.frequency_hz) + PAIR * len(self.resonances) + 1


def chain_shape(x: Array, zeta: float, stages: int) -> Array:
    """Spectrum of one chain over x = f / f0 (n,), 1 at its resonance."""
    c = 4.0 * zeta * zeta
    return np.asarray(c**stages * x ** (4 * (stages - 3)) / ((1.0 - x * x) ** 2 + c * x * x) ** stages)


def resonance_shape(f_hz: Array, f0_hz: float, zeta: float, dt_s: float) -> Array:
    """Spectrum (n,) of the acceleration of a resonance, ``zeta`` < 1, but for its level."""
    z = np.exp(2j * pi * dt_s * f_hz)
    w = 2.0 * pi * f0_hz
    pole = np.exp(complex(-zeta, sqrt(1.0 - zeta * zeta)) * w * dt_s)
    return np.asarray(np.abs((z - 1.0) / ((z - pole) * (z - np.conj(pole)))) ** 4)


def shaking_spectrum(resonances: Sequence[Resonance], f_hz: Array, dt_s: float) -> Array:
    """One-sided spectrum of the acceleration (m/s2)2/Hz of all of them, at ``f_hz`` (n,), of samples every ``dt_s``."""
    return np.asarray(sum([one.spectrum(f_hz, dt_s) for one in resonances], np.zeros_like(f_hz)))


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
        self.blocks = [slice(at, at + 2 * M) for at in range(0, 2 * M * len(model.frequency_hz), 2 * M)]
        """The parts of the state, but for the bias, that nothing of the rest acts upon."""
        self._shaken = self.blocks[-1].stop if self.blocks else 0
        for one in model.resonances:
            w, at = 2.0 * np.pi * one.frequency_hz, self.blocks[-1].stop
            for x in (at, at + 2):
                self.A[x, x + 1], self.A[x + 1, x], self.A[x + 1, x + 1] = w, -w, -2.0 * one.damping * w
            self.A[at + 1, at + 2] = 2.0 * one.damping * w
            self.H[:] += self.A[at + 1] / w
            if one.is_heave:
                self.heave[at], self.velocity[at + 1] = 1.0 / w**2, 1.0 / w
            self.diffusion[at + 3] = 2.0 * (one.damping * w) ** 2 * one.level
            self.blocks.append(slice(at, at + PAIR))
        self.H[-1] = 1.0
        self.diffusion[-1] = model.bias_walk_psd

    def transition(self, dt_s: float) -> tuple[Array, Array]:
        """F = expm(A dt) and Q of the same step (n, n) each, exact (Van Loan 1978). ``dt_s`` > 0."""
        # Van Loan's exponential runs backwards too, where a damped chain explodes: a long step is doubled from a short.
        fastest = float(np.max(np.abs(self.A[: self._shaken, : self._shaken])))
        doublings = max(0, ceil(log2(max(dt_s * fastest, 1.0))))
        whole_s, dt_s = dt_s, dt_s / 2.0**doublings
        n = len(self.H)
        F, Q = np.eye(n), np.zeros((n, n))
        for block in self.blocks[: len(self.model.frequency_hz)]:
            A = self.A[block, block]
            size = len(A)
            joint = np.zeros((2 * size, 2 * size))
            joint[:size, :size], joint[size:, size:] = -A, A.T
            joint[:size, size:] = np.diag(self.diffusion[block])
            e = expm(joint * dt_s)
            F[block, block] = e[size:, size:].T
            q = F[block, block] @ e[:size, size:]
            Q[block, block] = 0.5 * (q + q.T)
        Q[-1, -1] = self.diffusion[-1] * dt_s
        for _ in range(doublings):
            Q = Q + F @ Q @ F.T
            F, Q = F @ F, 0.5 * (Q + Q.T)
        for one, block in zip(self.model.resonances, self.blocks[len(self.model.frequency_hz) :], strict=True):
            F[block, block] = moved = expm(self.A[block, block] * whole_s)
            if 2.0 * one.frequency_hz * whole_s < 1.0:
                driven = _driven(moved, self.H[block])
                z = np.exp(2j * pi * one.frequency_hz * whole_s)
                gain = self.H[block] @ np.linalg.solve(z * np.eye(PAIR) - moved, driven)
                Q[block, block] = np.outer(driven, driven) * (one.level / (2.0 * whole_s * abs(gain) ** 2))
            else:
                P = self.stationary[block, block]
                q = P - moved @ P @ moved.T
                Q[block, block] = 0.5 * (q + q.T)
        return F, Q

    def moved(self, tau_s: float) -> Array:
        """F^(tau / dt) without Q, for any sign of ``tau_s``: (n, n)."""
        F = np.eye(len(self.H))
        for block in self.blocks:
            F[block, block] = expm(self.A[block, block] * tau_s)
        return F

    def opened(self, P: Array, *, bias: bool = False, resonances: bool = False) -> Array:
        """``P`` (n, n), when nothing is known any more of the bias, or of what rings."""
        P = P.copy()
        if bias:
            P[-1, -1] += TUNING.bias_spread_mps2**2
        if resonances:
            ringing = slice(self._shaken, len(P) - 1)
            P[ringing, ringing] += TUNING.blow**2 * self.stationary[ringing, ringing]
        return P

    @cached_property
    def stationary(self) -> Array:
        """Covariance (n, n) of the state of which nothing is known but the spectrum: P = F P F' + Q of any step."""
        n = len(self.H)
        P = np.zeros((n, n))
        for block in self.blocks:
            P[block, block] = _stationary(self.A[block, block], np.diag(self.diffusion[block]))
        P[-1, -1] = TUNING.bias_spread_mps2**2
        return P

    @cached_property
    def stationary_rates(self) -> Array:
        """Covariance (n, n) of A x, likewise."""
        return np.asarray(self.A @ self.stationary @ self.A.T)

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
            if float(np.trace(step)) <= TUNING.riccati_tolerance * float(np.trace(p)):
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


def _driven(F: Array, H: Array) -> Array:
    """(4,) the direction in which noise drives a resonance: H (z I - F)^-1 g = (z - 1)^2 z / det(z I - F)."""
    coefficients = np.poly(F)
    adjoint = [np.eye(PAIR)]  # Of z I - F, by descending powers of z (Faddeev, Le Verrier).
    for k in range(1, PAIR):
        adjoint.append(F @ adjoint[-1] + coefficients[k] * np.eye(PAIR))
    return np.linalg.solve(np.array([H @ matrix for matrix in adjoint]), np.array([1.0, -2.0, 1.0, 0.0]))


def heave_std(model: SeaModel) -> float:
    """Standard deviation of the heave that the model describes, m."""
    system = SeaSystem(model)
    return sqrt(float(system.heave @ system.stationary @ system.heave))
