"""Flexure of the hull as a second-order Markov process: discretisation, spectrum, fit, and the accuracy it allows.

Source: Xu, Wang & Shan 2017 (hull deformation by CKF), eq. (7)-(8); Mochalov & Kazantsev 2002. Per axis

    theta'' + 2 mu theta' + b^2 theta = 2 sigma b sqrt(mu) w,   b^2 = mu^2 + lambda^2,

with unit white noise w. The standard deviation is sigma, the autocorrelation at lag t is
sigma^2 exp(-mu|t|) (cos lambda t + mu/lambda sin lambda|t|), and the rate has the two-sided spectrum
4 mu b^2 sigma^2 omega^2 / ((b^2 - omega^2)^2 + 4 mu^2 omega^2).

The fit is Whittle's likelihood, sum of log S + I / S over the periodogram I, per axis, with the white noise of the
gyros as a fourth parameter and the configured flexure as a broad prior. The accuracy forecast is the information about
a fixed misalignment that the motion gives through the flexure that it is seen through.
"""

from __future__ import annotations

from math import cos, exp, log, pi, sin, sqrt
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.hull.tuning import TUNING

Array = NDArray[np.float64]

LOG_BOUNDS: Final = np.log(TUNING.fit_bounds)


class Flexure(msgspec.Struct, frozen=True, eq=False):
    """The process of each axis (3,), about the hull's x, y, z."""

    std_rad: Array
    mu_radps: Array
    lambda_radps: Array

    @property
    def b2(self) -> Array:
        """b^2, (3,), rad2/s2."""
        return self.mu_radps**2 + self.lambda_radps**2

    def transition(self, dt_s: float) -> tuple[Array, Array]:
        """Exact discretisation of [theta (3), theta' (3)] over ``dt_s``: F and Q, each (6, 6).

        Q is what keeps the stationary covariance diag(sigma^2, b^2 sigma^2) stationary.
        """
        F, Q = np.zeros((6, 6)), np.zeros((6, 6))
        rows = zip(self.std_rad.tolist(), self.mu_radps.tolist(), self.lambda_radps.tolist(), strict=True)
        for i, (std, mu, lam) in enumerate(rows):
            b2, decay = mu**2 + lam**2, exp(-mu * dt_s)
            c, s = cos(lam * dt_s), sin(lam * dt_s) / lam
            f = decay * np.array([[c + mu * s, s], [-b2 * s, c - mu * s]])
            stationary = np.array([[std**2, 0.0], [0.0, b2 * std**2]])
            q = stationary - f @ stationary @ f.T
            F[i::3, i::3] = f
            # For steps far below the period the difference loses its digits; its leading terms are exact then.
            drive = 4.0 * mu * b2 * std**2
            if dt_s * b2**0.5 < 1e-3:
                q = drive * np.array([[dt_s**3 / 3.0, dt_s**2 / 2.0], [dt_s**2 / 2.0, dt_s]])
            Q[i::3, i::3] = 0.5 * (q + q.T)
        return F, Q

    def stationary(self) -> Array:
        """Variances (6,) of [theta, theta']."""
        return np.concatenate([self.std_rad**2, self.b2 * self.std_rad**2])

    def rate_spectrum(self, omega: Array) -> Array:
        """Two-sided spectrum (n, 3) of theta' at omega (n,) rad/s, (rad/s)^2 per Hz."""
        return np.asarray(rate_spectrum(omega[:, None], self.std_rad, self.mu_radps, self.lambda_radps))


class Fit(msgspec.Struct, frozen=True, eq=False):
    """What the residual rates say of the flexure and of the white noise of one sample of them (3,), rad/s."""

    flexure: Flexure
    noise_radps: Array


def rate_spectrum(omega: Array, std: Array | float, mu: Array | float, lam: Array | float) -> Array:
    """Two-sided spectrum of theta', (unit of std / s)^2 per Hz."""
    b2 = mu**2 + lam**2
    w2 = omega**2
    return np.asarray(4.0 * mu * b2 * std**2 * w2 / ((b2 - w2) ** 2 + 4.0 * mu**2 * w2))


def fit(residual_radps: Array, rate_hz: float, prior: Flexure, noise_radps: float) -> Fit:
    """Whittle's maximum of the likelihood of evenly sampled residual rates (n, 3), axis by axis.

    The record is tapered (Hann) and its mean removed; above ``fine_hz``, where the spectrum is smooth, lines are
    averaged. An axis whose search does not end well keeps its prior.
    """
    n = len(residual_radps)
    taper = np.hanning(n)
    centred = residual_radps - np.mean(residual_radps, axis=0)
    power = np.abs(np.fft.rfft(centred * taper[:, None], axis=0)) ** 2 / (rate_hz * np.sum(taper**2))
    f = np.fft.rfftfreq(n, 1.0 / rate_hz)
    used = (f > TUNING.lowest_cycles * rate_hz / n) & (f < 0.5 * rate_hz)
    f, power = f[used], power[used]
    fine = f < TUNING.fine_hz
    groups = np.concatenate([np.arange(np.sum(fine)), np.sum(fine) + np.arange(np.sum(~fine)) // TUNING.averaged_lines])
    count = np.bincount(groups).astype(np.float64)
    f = np.bincount(groups, f) / count
    omega = 2.0 * np.pi * (f[:, None] + rate_hz * np.arange(-TUNING.aliases, TUNING.aliases + 1))
    found = np.empty((3, 4))
    for i in range(3):
        start = np.log([prior.std_rad[i], prior.mu_radps[i], prior.lambda_radps[i], max(noise_radps, 1e-10)])
        mean = np.bincount(groups, power[:, i]) / count
        found[i] = np.exp(_search(omega, mean, count, rate_hz, np.clip(start, *LOG_BOUNDS.T)))
    std, mu, lam, noise = found.T
    return Fit(Flexure(std, mu, lam), noise)


def _search(omega: Array, power: Array, count: Array, rate_hz: float, prior: Array) -> Array:
    """Logarithms (4,) of sigma, mu, lambda, noise that make the power (n,), each of ``count`` lines, likely.

    omega (n, images): the lines with those that fold onto them.
    """
    # Loaded where it is needed, in the process that fits: it would cost the daemon 10 MB.
    from scipy.optimize import Bounds, minimize

    # Further images lie on the flank c / omega^2: 2 c / ws^2 times the rest of the sum of 1 / k^2.
    rest = 2.0 * (pi**2 / 6.0 - sum(1.0 / k**2 for k in range(1, TUNING.aliases + 1))) / (2.0 * pi * rate_hz) ** 2

    def cost(p: Array) -> float:
        std, mu, lam, noise = np.exp(p).tolist()
        flank = 4.0 * mu * (mu**2 + lam**2) * std**2
        S = rate_spectrum(omega, std, mu, lam).sum(axis=1) + flank * rest + noise**2 / rate_hz
        away = (p - prior) / TUNING.prior_log_std
        # A Hann taper makes neighbours alike: the lines carry 2/3 of their number of independent values.
        return float(count.dot(np.log(S) + power / S)) * 2.0 / 3.0 + 0.5 * float(away.dot(away))

    best, lowest = prior, cost(prior)
    strongest = abs(float(omega[int(np.argmax(power)), TUNING.aliases]))
    step = float(omega[1, TUNING.aliases] - omega[0, TUNING.aliases]) / (2.0 * pi)
    scale = sqrt(float(power.dot(count)) * 2.0 * step)
    for lam in (exp(prior[2]), strongest):
        start = prior.copy()
        start[2] = log(lam)
        start[0] = log(max(scale, 1e-12) / lam)
        # Half of what is left at the top of the band: from far below, the slope towards more noise is too faint.
        start[3] = 0.5 * log(max(0.5 * rate_hz * float(np.mean(power[-8:])), 1e-20))
        result = minimize(cost, np.clip(start, *LOG_BOUNDS.T), method="L-BFGS-B", bounds=Bounds(*LOG_BOUNDS.T))
        if np.isfinite(result.fun) and result.fun < lowest:
            best, lowest = np.asarray(result.x), float(result.fun)
    return best


def information(rates_radps: Array, rate_hz: float, flexure: Flexure, noise_radps: Array) -> Array:
    """J (3, 3), 1/rad^2: what evenly sampled midships rates (n, 3) tell about a fixed misalignment about x, y, z.

    J = sum over the lines of H^H S^-1 H with H = [omega x] of the motion and S the spectrum that it is seen through:
    flexure rate plus gyro noise. The bound of a record is the square root of the diagonal of J^-1; J grows with time.
    """
    n = len(rates_radps)
    taper = np.hanning(n)
    centred = rates_radps - np.mean(rates_radps, axis=0)
    W = np.fft.rfft(centred * taper[:, None], axis=0)[1:]
    f = np.fft.rfftfreq(n, 1.0 / rate_hz)[1:].astype(np.float64)
    inverse = 1.0 / (flexure.rate_spectrum(2.0 * np.pi * f) + noise_radps**2 / rate_hz)
    # sum |H|^2 / S = 2 sum |W|^2 dt^2 / (S T), and the taper passes sum(taper^2) / n of the power.
    gain = 2.0 / (rate_hz * float(np.sum(taper**2)))
    x, y, z = W.T
    sx, sy, sz = inverse.T

    def moment(a: NDArray[np.complex128], b: NDArray[np.complex128], s: Array) -> float:
        return float(np.sum((a.conj() * b).real * s))

    # Rows of [w x]: x: (0, -wz, wy), y: (wz, 0, -wx), z: (-wy, wx, 0).
    xx = moment(z, z, sy) + moment(y, y, sz)
    yy = moment(z, z, sx) + moment(x, x, sz)
    zz = moment(y, y, sx) + moment(x, x, sy)
    xy, xz, yz = -moment(x, y, sz), -moment(x, z, sy), -moment(y, z, sx)
    return gain * np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
