"""The vessel: how it answers the waves, and what rigid-body motion does to sensors bolted to it. Pure.

Every degree of freedom answers the wave at the vessel's centre as one damped resonance; frames and signs are those of
:mod:`heaved.samples`.
"""

from __future__ import annotations

import math
from typing import Generic, Protocol, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.samples import GRAVITY_MPS2

Array = NDArray[np.float64]
Real = TypeVar("Real", float, Array)


class Response(msgspec.Struct, frozen=True, kw_only=True):
    """One degree of freedom, an oscillator driven by the wave: ``gain / (1 - r^2 + 2 i damping r)``, r = f T."""

    gain: float
    """Static gain: metres of motion, or radians, per metre of wave."""
    period_s: float
    """Natural period T."""
    damping: float
    """Fraction of critical damping."""
    phase_rad: float = 0.0
    """Phase added at every frequency: how the motion stands against heave (exp(+i w t) convention)."""

    def transfer(self, f_hz: Array) -> NDArray[np.complex128]:
        """Complex amplitude of the motion per metre of wave amplitude, same shape as ``f_hz``."""
        r = np.asarray(f_hz, dtype=np.float64) * self.period_s
        oscillator = 1.0 / (1.0 - r**2 + 2j * self.damping * r)
        return np.asarray(self.gain * np.exp(1j * self.phase_rad) * oscillator, dtype=np.complex128)

    def power(self, f_hz: Array) -> Array:
        """Squared magnitude of :meth:`transfer`."""
        return np.asarray(np.abs(self.transfer(f_hz)) ** 2, dtype=np.float64)


class Responses(msgspec.Struct, frozen=True, kw_only=True):
    """A vessel: what it makes of the waves in each degree of freedom."""

    heave: Response
    """m per m."""
    surge: Response
    """m per m; a quarter period off heave, as the orbital motion of water is."""
    sway: Response
    """m per m, + to port."""
    roll: Response
    """rad per m."""
    pitch: Response
    """rad per m."""
    yaw: Response
    """rad per m, about the mean heading."""

    def transfers(self, f_hz: Array) -> NDArray[np.complex128]:
        """(6, n) complex amplitudes per metre of wave amplitude, in the order above, at ``f_hz`` (n,)."""
        freedoms = (self.heave, self.surge, self.sway, self.roll, self.pitch, self.yaw)
        return np.array([freedom.transfer(f_hz) for freedom in freedoms])


CRANE_VESSEL = Responses(
    heave=Response(gain=1.0, period_s=8.0, damping=0.35),
    surge=Response(gain=0.5, period_s=8.0, damping=0.35, phase_rad=-math.pi / 2),
    sway=Response(gain=0.35, period_s=8.0, damping=0.35, phase_rad=math.pi / 2),
    # 3 degrees per metre, lightly damped: it rings at its own 12 s.
    roll=Response(gain=math.radians(3.0), period_s=12.0, damping=0.07, phase_rad=-math.pi / 2),
    pitch=Response(gain=math.radians(1.0), period_s=6.5, damping=0.35, phase_rad=math.pi / 2),
    yaw=Response(gain=math.radians(0.3), period_s=10.0, damping=0.5),
)
SMALL_CRAFT = Responses(
    # It follows every wave that is longer than itself, and bounces on the others.
    heave=Response(gain=1.0, period_s=0.5, damping=0.3),
    surge=Response(gain=0.7, period_s=0.5, damping=0.3, phase_rad=-math.pi / 2),
    sway=Response(gain=0.5, period_s=0.5, damping=0.3, phase_rad=math.pi / 2),
    # 8 and 5 degrees per metre; it rolls at 2 s.
    roll=Response(gain=math.radians(8.0), period_s=2.0, damping=0.15, phase_rad=-math.pi / 2),
    pitch=Response(gain=math.radians(5.0), period_s=1.0, damping=0.35, phase_rad=math.pi / 2),
    yaw=Response(gain=math.radians(2.0), period_s=3.0, damping=0.5),
)


class Motion(msgspec.Struct, Generic[Real], frozen=True, kw_only=True):
    """True motion of the vessel at ``t_s``: floats at one instant, or arrays (n,) at n instants.

    Accelerations are those of the sensors' origin in the level frame that turns with the heading (forward, port, up),
    gravity not included.
    """

    t_s: Real
    heave_m: Real
    heave_velocity_mps: Real
    heave_acceleration_mps2: Real
    surge_acceleration_mps2: Real
    sway_acceleration_mps2: Real
    roll_rad: Real
    pitch_rad: Real
    yaw_rad: Real
    roll_rate_radps: Real
    pitch_rate_radps: Real
    yaw_rate_radps: Real


class MotionSource(Protocol):
    """Anything that knows the true motion at any instant."""

    def at(self, t_s: float) -> Motion[float]:
        """The motion at ``t_s``."""


class Triad(msgspec.Struct, Generic[Real], frozen=True):
    """A vector in body axes: x forward, y port, z up."""

    x: Real
    y: Real
    z: Real


def specific_force(motion: Motion[Real]) -> Triad[Real]:
    """What an accelerometer triad fixed to the hull reads, m/s2: ``body_from_level [surge, sway, heave + g]``.

    ``level_from_body`` is roll (port up) about x, then pitch (bow up) about y; its third row
    [sin p, sin r cos p, cos r cos p] is the vertical seen from the hull, so that row times the specific force, less g,
    is the heave acceleration for any angles.
    """
    sr, cr = np.sin(motion.roll_rad), np.cos(motion.roll_rad)
    sp, cp = np.sin(motion.pitch_rad), np.cos(motion.pitch_rad)
    surge, sway = motion.surge_acceleration_mps2, motion.sway_acceleration_mps2
    up = motion.heave_acceleration_mps2 + GRAVITY_MPS2
    mast = cp * up - sp * surge  # along the z axis of the hull before it rolls
    return Triad(x=cp * surge + sp * up, y=cr * sway + sr * mast, z=cr * mast - sr * sway)


def body_rates(motion: Motion[Real]) -> Triad[Real]:
    """What a gyroscope triad fixed to the hull reads, rad/s, right-handed about x, y, z.

    Pitch (bow up) and heading (clockwise) turn against the right hand, hence the signs.
    """
    sr, cr = np.sin(motion.roll_rad), np.cos(motion.roll_rad)
    sp, cp = np.sin(motion.pitch_rad), np.cos(motion.pitch_rad)
    pitch_rate, yaw_rate = motion.pitch_rate_radps, motion.yaw_rate_radps
    return Triad(
        x=motion.roll_rate_radps - sp * yaw_rate,
        y=-cr * pitch_rate - sr * cp * yaw_rate,
        z=sr * pitch_rate - cr * cp * yaw_rate,
    )
