"""The 8-state model of a bank of filters: the nonlinear craft, and a coloured wave acceleration on each of its axes."""

from __future__ import annotations

from enum import IntEnum
from math import isfinite
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.craft import filter_bank as bank
from heaved.estimation.craft.dynamics import Craft, Vessel
from heaved.estimation.craft.filter_bank import Bank, Points
from heaved.estimation.craft.tuning import TUNING
from heaved.estimation.craft.wave_force import Sea, WaveShape, propagation, white_acceleration

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]


class State(IntEnum):
    """Of one filter; heave about the trim at the speed at hand, m, up; pitch rad, bow up; waves m/s2, rad/s2."""

    Z = 0
    Z_RATE = 1
    THETA = 2
    THETA_RATE = 3
    HEAVE_WAVE = 4
    PITCH_WAVE = 5
    HEAVE_WAVE_RATE = 6
    PITCH_WAVE_RATE = 7


class _Step(msgspec.Struct, frozen=True, eq=False, gc=False):
    """What a step of one length needs: wave rows (6, 4) and process noise (B, 8, 8)."""

    dt_s: float
    waves: Array
    Q: Array


class CraftModel:
    """One vessel in B seas. Speeds in m/s, flaps (2, 1) rad."""

    def __init__(self, vessel: Vessel, shape: WaveShape, seas: Sequence[Sea], white: tuple[float, float]) -> None:
        """``white``: densities of the accelerations that nothing explains, m/s2/sqrt(Hz) and rad/s2/sqrt(Hz).

        Raises:
            ArithmeticError: the vessel comes to no rest at some speed.
        """
        self._craft = Craft(vessel)
        self._shape, self._white = shape, white
        self._trim_speeds = np.linspace(0.0, vessel.max_speed_mps, 61)
        self._trims = self._craft.trims(self._trim_speeds)
        self._wave_variance = np.array([[sea.heave_rms_mps2**2, sea.pitch_rms_radps2**2] for sea in seas])
        self._steps: dict[int, _Step] = {}

    def trim(self, speed_mps: float) -> tuple[float, float]:
        """Heave (m) and pitch (rad), on straight lines between speeds that are a 60th of the range apart."""
        z, theta = (float(np.interp(speed_mps, self._trim_speeds, row)) for row in self._trims)
        return z, theta

    def start(self, readings: tuple[float, float], variances: tuple[float, float], speed_mps: float) -> Bank:
        """At heave and pitch as read, or the trim where there is none (nan); the waves unknown but for their RMS."""
        count, size = len(self._wave_variance), len(State)
        x, P = np.zeros((count, size)), np.zeros((count, size, size))
        at_rest = (0.0, self.trim(speed_mps)[1])
        for axis, state in enumerate((State.Z, State.THETA)):
            known = isfinite(readings[axis])
            x[:, state] = readings[axis] if known else at_rest[axis]
            P[:, state, state] = variances[axis] if known else TUNING.start_std[axis] ** 2
            P[:, state + 1, state + 1] = TUNING.start_std[axis] ** 2
        waves = np.array([State.HEAVE_WAVE, State.PITCH_WAVE])
        P[:, waves, waves] = self._wave_variance
        peaks = np.array([self._shape.heave_peak_radps, self._shape.pitch_peak_radps])
        P[:, waves + 2, waves + 2] = self._wave_variance * peaks**2
        return Bank(x, P)

    def predict(self, points: Points, filters: Bank, dt_s: float, speed_mps: float, flaps_rad: Array) -> Bank | None:
        """Time update of all filters. None: a covariance is none any more."""
        steps = max(1, -int(-dt_s // TUNING.longest_step_s))
        step = self._step(dt_s / steps)
        trim_m = self.trim(speed_mps)[0]

        def move(columns: Array) -> Array:
            waves = step.waves.dot(columns[4:])
            moved, craft = np.empty_like(columns), columns[:4].copy()
            craft[0] += trim_m
            forces = np.stack((columns[4:6], waves[0:2], waves[2:4]))
            moved[:4] = self._craft.advance(craft, step.dt_s, speed_mps, flaps_rad, forces)
            moved[0] -= trim_m
            moved[4:] = waves[2:]
            return moved

        moved: Bank | None = filters
        for _ in range(steps):
            if moved is not None:
                moved = bank.predict(points, moved, move, step.Q)
        return moved

    def _step(self, dt_s: float) -> _Step:
        key = max(1, round(dt_s / TUNING.same_step_s))
        found = self._steps.get(key)
        if found is None:
            if len(self._steps) >= 1000:
                self._steps.clear()
            found = self._steps[key] = self._new_step(key * TUNING.same_step_s)
        return found

    def _new_step(self, dt_s: float) -> _Step:
        moved = propagation(self._shape, dt_s)
        Q = np.zeros((len(self._wave_variance), len(State), len(State)))
        for axis, density in enumerate(self._white):
            craft = slice(2 * axis, 2 * axis + 2)
            Q[:, craft, craft] = white_acceleration(density, dt_s)
            wave = slice(State.HEAVE_WAVE + axis, None, 2)
            Q[:, wave, wave] = self._wave_variance[:, axis, None, None] * moved.Q[axis]
        return _Step(dt_s, moved.rows, Q)
