"""What the vessel itself does: it lists, turns, meets another sea. The truth moves, and honest sensors with it.

Each is a pure function of the true motion and of when it happens.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from heaved.simulate.vessel import Motion

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SWELL_HZ: Final = (0.056, 0.0603, 0.0649)
"""Three lines of a swell that comes from far away: groups of some four minutes."""


class Span(NamedTuple):
    """When it happens, s of the record."""

    start_s: float
    end_s: float

    def holds(self, t_s: Array) -> Mask:
        """(n,) instants at which it does."""
        return (t_s >= self.start_s) & (t_s < self.end_s)


Move = Callable[[Motion[Array], Span], Motion[Array]]


def listed(by_rad: float, within_s: float) -> Move:
    """The vessel lists to a new mean roll, in a smooth step; the sensors' origin does not rise."""

    def move(truth: Motion[Array], span: Span) -> Motion[Array]:
        u, du, _ = _step(truth.t_s, span.start_s, within_s)
        return msgspec.structs.replace(
            truth, roll_rad=truth.roll_rad + by_rad * u, roll_rate_radps=truth.roll_rate_radps + by_rad * du
        )

    return move


def growing(from_share: float, within_s: float) -> Move:
    """The sea grows from that share of what it is at last; it has that share before."""

    def move(truth: Motion[Array], span: Span) -> Motion[Array]:
        u, du, ddu = _step(truth.t_s, span.start_s, within_s)
        e, de, dde = from_share + (1.0 - from_share) * u, (1.0 - from_share) * du, (1.0 - from_share) * ddu
        h, v, a = truth.heave_m, truth.heave_velocity_mps, truth.heave_acceleration_mps2
        return msgspec.structs.replace(
            truth,
            heave_m=e * h,
            heave_velocity_mps=e * v + de * h,
            heave_acceleration_mps2=e * a + 2.0 * de * v + dde * h,
            surge_acceleration_mps2=e * truth.surge_acceleration_mps2,
            sway_acceleration_mps2=e * truth.sway_acceleration_mps2,
            roll_rad=e * truth.roll_rad,
            pitch_rad=e * truth.pitch_rad,
            roll_rate_radps=e * truth.roll_rate_radps + de * truth.roll_rad,
            pitch_rate_radps=e * truth.pitch_rate_radps + de * truth.pitch_rad,
        )

    return move


def turned_into_the_sea(slower: float, within_s: float) -> Move:
    """The waves come as they are from then on, and before that were met that much slower; the heading goes round by 90
    degrees meanwhile.
    """

    def move(truth: Motion[Array], span: Span) -> Motion[Array]:
        t = truth.t_s
        u, du, _ = _step(t, span.start_s, within_s)
        rate, bend = slower + (1.0 - slower) * u, (1.0 - slower) * du
        met_s = t[0] + CubicSpline(t, rate).antiderivative()(t)
        heave = CubicHermiteSpline(t, truth.heave_m, truth.heave_velocity_mps)(met_s)
        velocity = CubicHermiteSpline(t, truth.heave_velocity_mps, truth.heave_acceleration_mps2)(met_s)
        acceleration, surge, sway, roll_rate, pitch_rate = (
            CubicSpline(t, values)(met_s)
            for values in (
                truth.heave_acceleration_mps2,
                truth.surge_acceleration_mps2,
                truth.sway_acceleration_mps2,
                truth.roll_rate_radps,
                truth.pitch_rate_radps,
            )
        )
        return msgspec.structs.replace(
            truth,
            heave_m=heave,
            heave_velocity_mps=rate * velocity,
            heave_acceleration_mps2=rate**2 * acceleration + bend * velocity,
            surge_acceleration_mps2=rate**2 * surge,
            sway_acceleration_mps2=rate**2 * sway,
            roll_rad=CubicHermiteSpline(t, truth.roll_rad, truth.roll_rate_radps)(met_s),
            pitch_rad=CubicHermiteSpline(t, truth.pitch_rad, truth.pitch_rate_radps)(met_s),
            roll_rate_radps=rate * roll_rate,
            pitch_rate_radps=rate * pitch_rate,
            yaw_rad=truth.yaw_rad + 0.5 * np.pi * u,
            yaw_rate_radps=truth.yaw_rate_radps + 0.5 * np.pi * du,
        )

    return move


def met_by_a_swell(amplitude_m: float, within_s: float) -> Move:
    """A long swell arrives from another direction: three lines, that the vessel follows, and rolls by their slope."""

    def move(truth: Motion[Array], span: Span) -> Motion[Array]:
        u, du, ddu = _step(truth.t_s, span.start_s, within_s)
        heave, velocity, acceleration, roll, roll_rate = (np.zeros_like(truth.t_s) for _ in range(5))
        for number, hz in enumerate(SWELL_HZ):
            omega = 2.0 * np.pi * hz
            phase = omega * truth.t_s + 2.0 * number
            s, c = amplitude_m * np.sin(phase), amplitude_m * np.cos(phase)
            heave += u * s
            velocity += u * omega * c + du * s
            acceleration += -u * omega**2 * s + 2.0 * du * omega * c + ddu * s
            slope = omega**2 / 9.81
            roll += u * slope * c
            roll_rate += -u * slope * omega * s + du * slope * c
        return msgspec.structs.replace(
            truth,
            heave_m=truth.heave_m + heave,
            heave_velocity_mps=truth.heave_velocity_mps + velocity,
            heave_acceleration_mps2=truth.heave_acceleration_mps2 + acceleration,
            roll_rad=truth.roll_rad + roll,
            roll_rate_radps=truth.roll_rate_radps + roll_rate,
        )

    return move


def _step(t_s: Array, start_s: float, within_s: float) -> tuple[Array, Array, Array]:
    """A smooth step from 0 to 1, twice differentiable, and its derivatives."""
    u = np.clip((t_s - start_s) / within_s, 0.0, 1.0)
    return (
        u**3 * (10.0 - 15.0 * u + 6.0 * u**2),
        30.0 * u**2 * (1.0 - u) ** 2 / within_s,
        60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / within_s**2,
    )
