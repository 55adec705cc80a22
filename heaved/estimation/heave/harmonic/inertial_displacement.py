"""Inertial displacement: vertical acceleration integrated twice through a second-order high-pass.

This is the "inertial measurement" of Zhang et al. 2022, section 1: it leads in phase (its high-pass) and carries a
constant of bias / omega_c^2. Both are known here, because the filter is ours: :meth:`InertialDisplacement.response`.
"""

from __future__ import annotations

from math import cos, exp, isfinite, pi, sin, sqrt
from typing import Final

DAMPING: Final = 1.0 / sqrt(2.0)
"""Butterworth: the flattest amplitude above the corner."""


class InertialDisplacement:
    """z'' + 2 D w z' + w^2 z = a, w = 2 pi / highpass_period_s, integrated exactly for a(t) linear between samples."""

    def __init__(self, highpass_period_s: float) -> None:
        self._w = 2.0 * pi / highpass_period_s
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next sample starts at its own resting point."""
        self._z = self._v = self._a = 0.0
        self._started = False

    @property
    def displacement_m(self) -> float:
        """After the last step."""
        return self._z

    def step(self, dt_s: float, a_mps2: float) -> float:
        """Displacement (m) after ``dt_s`` seconds in which the acceleration went linearly to ``a_mps2``.

        The first sample only sets the starting point: the rest position of a constant acceleration.

        Raises:
            ValueError: ``a_mps2`` is not finite, or ``dt_s`` is negative.
        """
        if not isfinite(a_mps2) or not dt_s >= 0.0:
            raise ValueError(f"inertial displacement: step of {dt_s} s to {a_mps2} m/s2")
        w, D = self._w, DAMPING
        if not self._started:
            self._started, self._z, self._a = True, a_mps2 / w**2, a_mps2
            return self._z
        if dt_s == 0.0:
            self._a = a_mps2
            return self._z
        # Particular solution for u + s t: z = c0 + c1 t; the rest decays and swings.
        u, s = self._a, (a_mps2 - self._a) / dt_s
        c1 = s / w**2
        c0 = u / w**2 - 2.0 * D * c1 / w
        z0, v0 = self._z - c0, self._v - c1
        wd = w * sqrt(1.0 - D * D)
        decay, c, sn = exp(-D * w * dt_s), cos(wd * dt_s), sin(wd * dt_s)
        b = (v0 + D * w * z0) / wd
        self._z = decay * (z0 * c + b * sn) + c0 + c1 * dt_s
        self._v = decay * (v0 * c - (D * w * b + wd * z0) * sn) + c1
        self._a = a_mps2
        return self._z

    def response(self, omega_radps: float) -> complex:
        """Displacement out over true displacement in: s^2 / (s^2 + 2 D w s + w^2) at s = j omega."""
        w = self._w
        return -(omega_radps**2) / complex(w**2 - omega_radps**2, 2.0 * DAMPING * w * omega_radps)
