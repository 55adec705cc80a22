"""What waves do to a craft, as an acceleration per axis: coloured noise of one peak, exactly discretised. Pure.

f'' + 2 beta f' + omega^2 f = w, w white, scaled to a stated RMS of f: a spectrum of one peak about omega that beta
broadens. The states of heave and pitch stand side by side: (heave f, pitch f, heave f', pitch f').
"""

from __future__ import annotations

from math import cos, exp, sin, sqrt
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Positive = Annotated[float, msgspec.Meta(gt=0)]


class Sea(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[[attitude.seas]]``: RMS of the wave accelerations."""

    heave_rms_mps2: Positive
    pitch_rms_radps2: Positive


class WaveShape(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[attitude.wave]``: spectrum of the wave accelerations, at frequencies of encounter."""

    heave_peak_radps: Positive = 2.7
    """omega."""
    heave_decay_radps: Positive = 0.7
    """beta."""
    pitch_peak_radps: Positive = 4.0
    pitch_decay_radps: Positive = 1.6

    def __post_init__(self) -> None:
        if not (self.heave_decay_radps < self.heave_peak_radps and self.pitch_decay_radps < self.pitch_peak_radps):
            raise ValueError("a wave must oscillate: its decay must be below its peak frequency")


class Propagation(msgspec.Struct, frozen=True, eq=False, gc=False):
    """Wave states carried over a step."""

    rows: Array
    """(6, 4): accelerations of heave and pitch half-way, then at the end, then their rates at the end."""
    Q: Array
    """(2, 2, 2): covariance of (f, f') that the step adds per axis, for an RMS of 1."""


def propagation(shape: WaveShape, dt_s: float) -> Propagation:
    """The exact solution. Its noise is what keeps the stationary variance, diag(1, omega^2), stationary."""
    rows, Q = np.zeros((6, 4)), np.zeros((2, 2, 2))
    axes = ((shape.heave_peak_radps, shape.heave_decay_radps), (shape.pitch_peak_radps, shape.pitch_decay_radps))
    for axis, (omega, beta) in enumerate(axes):
        F = _oscillator(omega, beta, dt_s)
        own = [axis, axis + 2]
        rows[axis, own] = _oscillator(omega, beta, 0.5 * dt_s)[0]
        rows[axis + 2, own], rows[axis + 4, own] = F
        stationary = np.diag([1.0, omega**2])
        Q[axis] = stationary - F @ stationary @ F.T
    return Propagation(rows, Q)


def white_acceleration(density: float, dt_s: float) -> Array:
    """(2, 2) covariance that white acceleration of a (two-sided) density, m/s2/sqrt(Hz), adds to position and rate."""
    return density**2 * np.array([[dt_s**3 / 3.0, dt_s**2 / 2.0], [dt_s**2 / 2.0, dt_s]])


def _oscillator(omega: float, beta: float, t_s: float) -> Array:
    """(2, 2) transition of (f, f') of the free oscillator, in closed form."""
    damped = sqrt(omega**2 - beta**2)
    decay, c, s = exp(-beta * t_s), cos(damped * t_s), sin(damped * t_s) / damped
    return decay * np.array([[c + beta * s, s], [-(omega**2) * s, c - beta * s]])
