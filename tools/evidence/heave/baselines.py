"""The filters that Zhang et al. 2022 compare with in their Table 2: vertical acceleration in, heave out.

Every one of them is causal and sees each sample once, with the tilt removed as the product removes it. They are tuned
as their source has it or, where it says nothing, as suits them best.
"""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.signal import bilinear_zpk, butter, sosfilt, sosfilt_zi, zpk2sos

from heaved.estimation.common import sigma
from heaved.estimation.heave.harmonic.inertial_displacement import InertialDisplacement
from heaved.estimation.heave.harmonic.observer import HarmonicObserver
from heaved.estimation.imu.attitude import up_acceleration
from heaved.samples import GRAVITY_MPS2, ImuSample

if TYPE_CHECKING:
    from heaved.estimation.heave import params as heave

Array = NDArray[np.float64]

HIGHPASS_PERIOD_S: Final = 16.0
"""Corner of the inertial displacement, the product's own: what KF and UKF measure."""
IIR_ORDER: Final = 4
IIR_CORNER_HZ: Final = 0.03
"""Of the usual 0.03, 0.04 and 0.05 Hz the one with the least error on every standard scenario: the lead of the filter
outweighs the drift that it lets through. (Unusual 0.02 Hz: a third to two fifths less error on irregular seas, and on
the small trains with sensor B up to three quarters more.)"""
DOUBLE_CORNER_HZ: Final = 0.007
"""Of the double integrator: where it is about as good on S4 (which forgets the sensor's bias late) as on S6 (which it
leads)."""
PAPER_P0: Final = 0.1
PAPER_Q: Final = 1e-5
PAPER_R: Final = 0.022
"""Section 4: P0 = 0.1 I3, Q = 1e-5 I3, R = 0.022, X0 = 0; per sample."""


class Filter(Protocol):
    """Something that makes heave of vertical acceleration."""

    def step(self, t_s: float, a_up_mps2: float) -> float:
        """Heave (m) at ``t_s``."""


def vertical(sample: ImuSample) -> float:
    """Vertical acceleration (m/s2), the tilt removed where it is known."""
    if isnan(sample.roll_rad + sample.pitch_rad):
        return sample.az_mps2 - GRAVITY_MPS2
    return up_acceleration(sample.ax_mps2, sample.ay_mps2, sample.az_mps2, sample.roll_rad, sample.pitch_rad)


class Inertial:
    """The paper's inertial output, with the product's second-order high-pass: it leads, and a bias b stays in it as
    b / omega_c^2 (0.2 m for 0.03 m/s2 and a corner of 16 s).
    """

    def __init__(self) -> None:
        self._chain = InertialDisplacement(HIGHPASS_PERIOD_S)
        self._t_s = 0.0

    def step(self, t_s: float, a_up_mps2: float) -> float:
        dt, self._t_s = max(t_s - self._t_s, 0.0), t_s
        return self._chain.step(dt, a_up_mps2)


class Iir:
    """The conventional heave filter: double integration and a fourth-order high-pass in one causal IIR.

    The two integrators cancel two of the high-pass's four zeros at s = 0, k s^2 / B4(s), so that nothing grows and a
    constant bias leaves nothing. Bilinear, in second-order sections, started at rest under the first reading.
    """

    def __init__(self, rate_hz: float, corner_hz: float = IIR_CORNER_HZ, passes: int = 1) -> None:
        """``passes``: 1: one Butterworth high-pass of the fourth order; 2: one of the second for each integration."""
        zeros, poles, gain = butter(IIR_ORDER // passes, 2.0 * np.pi * corner_hz, "highpass", analog=True, output="zpk")
        digital = bilinear_zpk(np.tile(zeros, passes)[2:], np.tile(poles, passes), gain**passes, rate_hz)
        self._sections = zpk2sos(*digital)  # type: ignore[arg-type]  # the stubs know of real poles only
        self._state: Array | None = None

    def step(self, t_s: float, a_up_mps2: float) -> float:  # noqa: ARG002  # Filter
        if self._state is None:
            self._state = sosfilt_zi(self._sections) * a_up_mps2
        out, self._state = sosfilt(self._sections, [a_up_mps2], zi=self._state)
        return float(out[0])


class LinearKalman:
    """The textbook Kalman filter on the paper's harmonic model, eq. (11)-(13), n = 1, at one known, fixed period.

    State [h, h', dh]; the measurement is the inertial displacement; h is published without any shift in time. Written
    from the textbook, with none of the product's sigma-point code.
    """

    def __init__(self, rate_hz: float, period_s: float) -> None:
        w, T = 2.0 * np.pi / period_s, 1.0 / rate_hz
        c, s = np.cos(w * T), np.sin(w * T)
        self.F = np.array([[c, s / w, 0.0], [-w * s, c, 0.0], [0.0, 0.0, 1.0]])
        self.H = np.array([1.0, 0.0, 1.0])
        self.x = np.zeros(3)
        self.P = PAPER_P0 * np.eye(3)
        self._inertial = Inertial()

    def step(self, t_s: float, a_up_mps2: float) -> float:
        return self.measure(self._inertial.step(t_s, a_up_mps2))

    def measure(self, z_m: float) -> float:
        """Predict, then update with an inertial displacement."""
        x = self.F @ self.x
        P = self.F @ self.P @ self.F.T + PAPER_Q * np.eye(3)
        S = float(self.H @ P @ self.H) + PAPER_R
        K = P @ self.H / S
        self.x = x + K * (z_m - float(self.H @ x))
        joseph = np.eye(3) - np.outer(K, self.H)
        self.P = joseph @ P @ joseph.T + PAPER_R * np.outer(K, K)
        return float(self.x[0])


class OneStep:
    """The product's UKF with m = 0 in eq. (14): its frequency follows the FFT, its lead stays."""

    def __init__(self, params: heave.Params) -> None:
        self._observer = HarmonicObserver(params)

    def step(self, t_s: float, a_up_mps2: float) -> float:
        self._observer.step(t_s, a_up_mps2)
        return self._observer.unshifted().heave_m


def ukf_against_kf(inertial_m: Array, rate_hz: float, period_s: float) -> float:
    """Largest difference (m) between KF and UKF with equal model and tuning over one measurement series (n,)."""
    kalman = LinearKalman(rate_hz, period_s)
    points = sigma.symmetric(3)
    x, P, H, R = np.zeros(3), PAPER_P0 * np.eye(3), kalman.H[None, :], np.array([[PAPER_R]])
    worst = 0.0
    for z in inertial_m.tolist():
        predicted = sigma.predict(points, x, P, kalman.F, PAPER_Q * np.eye(3))
        updated = None if predicted is None else sigma.update(points, predicted.x, predicted.P, np.array([z]), H, R)
        if updated is None:
            return float("nan")
        x, P = updated.x, updated.P
        worst = max(worst, abs(float(x[0]) - kalman.measure(z)))
    return worst
