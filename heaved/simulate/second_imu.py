"""The IMU at the crane base of a hull that bends, read at any instants. Pure, seeded.

Flexure as in :mod:`heaved.simulate.flexure`, a second-order Markov process per axis of the hull, here as a sum of
harmonics with its spectrum, so that it is known at any instant. The frames are those of that module.
"""

from __future__ import annotations

import math
import zlib
from typing import Final

import msgspec
import numpy as np

from heaved.samples import RatesSample
from heaved.simulate.flexure import ARCSEC_RAD, local_rates, static_rotation
from heaved.simulate.gyro_shaking import GyroShake, GyroShaking
from heaved.simulate.sensors import ImuModel, reading_std
from heaved.simulate.vessel import Array, MotionSource, body_rates

HARMONICS: Final = 48
"""Per axis."""
WIDEST: Final = 4.0
"""The harmonics reach up to this many times the flexure's frequency and have all of its variance."""


class CraneBase(msgspec.Struct, frozen=True, kw_only=True):
    """How the second IMU is mounted, what it stands on, and its clock."""

    static_deg: tuple[float, float, float] = (0.5, 0.8, 30.0)
    """x, y, z of local from midships, R3(z) R2(y) R1(x) passive."""
    flexure_std_arcsec: float = 5.0
    flexure_mu_radps: float = 0.1
    flexure_hz: float = 0.16
    late_s: float = 0.004
    """It answers with rates of so long ago."""


class Bend:
    """Flexure theta(t) about the hull's axes."""

    def __init__(self, base: CraneBase, seed: int) -> None:
        rng = np.random.default_rng([seed, 4])
        w0 = 2.0 * math.pi * base.flexure_hz
        step = WIDEST * w0 / HARMONICS
        self._w = step * (np.arange(HARMONICS) + rng.random((3, HARMONICS)))
        b2, mu = w0**2 + base.flexure_mu_radps**2, base.flexure_mu_radps
        power = 1.0 / ((b2 - self._w**2) ** 2 + (2.0 * mu * self._w) ** 2)
        power /= np.sum(power, axis=1, keepdims=True)
        self._a = base.flexure_std_arcsec * ARCSEC_RAD * np.sqrt(2.0 * power)
        self._phase = 2.0 * math.pi * rng.random((3, HARMONICS))

    def at(self, t_s: float) -> tuple[Array, Array]:
        """theta and theta' (3,), rad and rad/s."""
        turned = self._w * t_s + self._phase
        return np.sum(self._a * np.sin(turned), axis=1), np.sum(self._a * self._w * np.cos(turned), axis=1)


class SecondImu:
    """The gyros at the crane base, read a poll at a time."""

    def __init__(
        self,
        sea: MotionSource,
        model: ImuModel,
        base: CraneBase,
        *,
        rate_hz: float,
        seed: int,
        name: str = "imu2",
        shake: str | GyroShake = "",
    ) -> None:
        """``model``: of its gyros, as of an :class:`~heaved.simulate.instruments.Imu`. ``shake``: what shakes them.

        Raises:
            ValueError: there is no shake of that name.
        """
        self._sea, self._base = sea, base
        self._static = static_rotation(base.static_deg)
        self._bend = Bend(base, seed)
        self._shaking = GyroShaking(shake, seed, local=True)
        self._rng = np.random.default_rng([seed, 5, zlib.crc32(name.encode())])
        self._std = reading_std(model, rate_hz)[6:]

    def deformation(self, t_s: float) -> Array:
        """(3, 3) true C, local from midships, of the moment that a reading at ``t_s`` shows."""
        theta, _ = self._bend.at(t_s - self._base.late_s)
        angle = float(np.linalg.norm(theta))
        x, y, z = theta.tolist()
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return np.asarray(self._static @ (np.eye(3) - K + (0.5 - angle**2 / 24.0) * K @ K))

    def read(self, t_s: float) -> RatesSample:
        """The reading at ``t_s``."""
        then_s = t_s - self._base.late_s
        hull = body_rates(self._sea.at(then_s))
        theta, rate = self._bend.at(then_s)
        rates = self._static @ local_rates(np.array([hull.x, hull.y, hull.z]), theta, rate)
        rates = rates + self._std * self._rng.standard_normal(3)
        gx, gy, gz = self._shaking.readings(np.array([then_s]), rates[None])[0].tolist()
        return RatesSample(t_s=t_s, gx_radps=gx, gy_radps=gy, gz_radps=gz)
