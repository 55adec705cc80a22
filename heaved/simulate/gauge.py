"""A laser gauge that is somewhere: what it reads of a vessel that heaves, rolls and pitches over a level target. Pure.

The beam is followed from where it begins to where it ends: turned with the vessel, or standing still.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

if TYPE_CHECKING:
    from heaved.simulate.vessel import Array, Motion, Real

LASER_DISTANCE_M: Final = 12.0
"""Usual height between gauge and target: what a laser straight over it reads at zero heave."""
LEAST_STEEP: Final = 0.1
"""Cosine to the vertical of a beam that still meets a level target somewhere near."""


class Gauge(msgspec.Struct, frozen=True, kw_only=True):
    """Where a gauge is; by default where the IMU is, looking straight down."""

    at_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From the IMU, vessel axes x forward, y port, z up. Of a fixed gauge: where its beam meets the level vessel."""
    beam: tuple[float, float, float] = (0.0, 0.0, -1.0)
    """Direction from the gauge to its target, of any length: in vessel axes, of a fixed gauge in level ones."""
    distance_m: float = LASER_DISTANCE_M
    """Height between gauge and target with the vessel level and at heave zero."""
    is_fixed: bool = False
    """It stands on something fixed and looks at the vessel's deck, a plane."""

    @property
    def sign(self) -> int:
        """+1: it reads more as the vessel heaves up."""
        looks_up = self.beam[2] > 0.0
        return 1 if looks_up is self.is_fixed else -1

    def read(self, motion: Motion[Real]) -> Real:
        """The true distance along the beam; nan: it meets nothing."""
        rotation = _level_from_body(motion.roll_rad, motion.pitch_rad)
        beam = np.array(self.beam) / math.sqrt(sum(part * part for part in self.beam))
        at = np.array(self.at_m)
        heave = np.asarray(motion.heave_m, dtype=np.float64)
        if self.is_fixed:
            # It stands over or under a spot of the level vessel; the deck is a plane through that spot.
            gauge = at - beam * self.distance_m / abs(beam[2])
            normal = rotation[:, 2]
            spot = np.tensordot(rotation, at, (1, 0))
            spot[2] = spot[2] + heave
            reach = np.tensordot(normal, gauge, (0, 0)) - np.einsum("i...,i...->...", normal, spot)
            distance = -reach / np.tensordot(normal, beam, (0, 0))
        else:
            down = math.copysign(1.0, beam[2])
            height = heave + np.tensordot(rotation[2], at, (0, 0))
            target_m = self.at_m[2] + down * self.distance_m
            distance = (target_m - height) / np.tensordot(rotation[2], beam, (0, 0))
        distance = np.where(distance > 0.0, distance, np.nan)
        found: Real = float(distance) if distance.ndim == 0 else distance  # type: ignore[assignment]
        return found


AT_THE_IMU: Final = Gauge()
"""It reads more as the vessel rises, and more when she leans."""


def gauge_at(at: str, beam: str) -> Gauge:
    """A gauge on the vessel from the words of a command line: where it is (``FORWARD,PORT,UP``, m) and where its beam
    points (``X,Y,Z``).

    Raises:
        ValueError: that is no such place, or no such beam.
    """
    direction = _triple(beam, "direction of the laser's beam")
    if not abs(direction[2]) > LEAST_STEEP * math.hypot(*direction):
        raise ValueError(f"direction of the laser's beam {beam!r}: it must point down or up")
    return Gauge(at_m=_triple(at, "place of the laser"), beam=direction)


def _triple(text: str, what: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not math.isfinite(x + y + z):
        raise ValueError(f"{what} {text!r} is not understood: write three numbers such as '8,0,2'")
    return x, y, z


def _level_from_body(roll_rad: Real, pitch_rad: Real) -> Array:
    """(3, 3, ...): roll, port side up, about x, then pitch, bow up, about y."""
    roll, pitch = np.asarray(roll_rad, dtype=np.float64), np.asarray(pitch_rad, dtype=np.float64)
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    nil, one = np.zeros_like(roll), np.ones_like(roll)
    rolled = np.array([[one, nil, nil], [nil, cr, -sr], [nil, sr, cr]])
    pitched = np.array([[cp, nil, -sp], [nil, one, nil], [sp, nil, cp]])
    found: Array = np.einsum("ij...,jk...->ik...", pitched, rolled)
    return found
