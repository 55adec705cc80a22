"""Waves that the model does not know: a swell that arrives, by what it leaves in the innovations.

A swell that comes from far begins as millimetres per second squared, far below the noise of a single sample, and is
decimetres of heave by then: the filter knows of no power there, takes it for a bias that wanders, and says that it
errs by millimetres. The last innovations show it. They are white, of unit variance over what the model has for them,
and what is more than that at some frequency is a share of the model's spectrum there: with P their periodogram, S the
spectrum of the acceleration by the model, and R what the steady filter makes of an acceleration of 1 m/s2, the heave is
off by

    E^2 = sum (P - 1) S |1 / omega^2 + R|^2 df

beside what the model says. By chance the sum is not zero either; as much as that does is left out. A short past shows
one that grows quickly, a longer one less of it.

A bias that goes on in one direction leaves next to nothing at these frequencies, once the ramp that it is has been
taken out of them: so they tell, too, how far a ramp that is found is to be believed.
"""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING, Final, NamedTuple

import msgspec
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from heaved.estimation.heave.sea.model import SeaSystem, Steady

    Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What is looked at, and what counts."""

    looked_s: tuple[float, ...] = (20.0, 40.0)
    """So long a past each, of about one wave of the longest swell that is common, and of two."""
    longest_hz: float = 0.045
    """Of those, waves up to 22 s, and less by the width of a bin,"""
    shortest_hz: float = 0.155
    """down to 6.5 s: shorter ones the sea's own model has, or learns within a few of them."""
    chance: float = 1.5
    """Standard deviations of the sum by chance that are left out of it."""
    grows: float = 1.5
    """What shows is of some ten seconds ago, in the mean: a swell that arrives is so many times as high by now."""


TUNING: Final = Tuning()


class Past(NamedTuple):
    """Of one length."""

    samples: int
    basis: Array
    """(2 k, count) cosines and sines at the frequencies, by which innovations become the roots of a periodogram."""
    square_m2: Array
    """(k,) m2 that the heave is off by for each unit of it."""


class LongWaves:
    """What the innovations of a steady filter tell of waves that its model does not have.

    Attributes:
        count: innovations that are looked at.
    """

    def __init__(self, system: SeaSystem, steady: Steady) -> None:
        self._pasts = [_past(seconds, system, steady) for seconds in TUNING.looked_s]
        self.count = max(past.samples for past in self._pasts)

    def look(self, innovations: Array) -> tuple[float, float]:
        """Standard deviation of the heave, m, for waves that the model does not have, and by how much those are more
        than what it has; of the last innovations (count,), each over its standard deviation.
        """
        most_m2, most = 0.0, 1.0
        for samples, basis, square_m2 in self._pasts:
            found = basis @ innovations[-samples:]
            power = found[: len(square_m2)] ** 2 + found[len(square_m2) :] ** 2
            by_chance_m2 = TUNING.chance * sqrt(float(square_m2 @ square_m2))
            most_m2 = max(most_m2, float(square_m2 @ (power - 1.0)) - by_chance_m2)
            most = max(most, float(np.mean(power)))
        return TUNING.grows * sqrt(most_m2), most


def _past(seconds: float, system: SeaSystem, steady: Steady) -> Past:
    dt_s, H = steady.dt_s, system.H
    count = max(round(seconds / dt_s), 8)
    bins = np.arange(1, count // 2) / (count * dt_s)
    f_hz = bins[(bins > TUNING.longest_hz) & (bins < TUNING.shortest_hz)]
    omega = 2.0 * np.pi * f_hz
    turns = np.exp(-1j * np.outer(omega, dt_s * np.arange(count))) / sqrt(count)
    loop = steady.F - np.outer(steady.K, H @ steady.F)
    one = np.eye(len(H))
    made = np.array([system.heave @ np.linalg.solve(one - loop * np.exp(-1j * w * dt_s), steady.K) for w in omega])
    shown = system.model.acceleration_spectrum(f_hz, dt_s) / (count * dt_s)
    return Past(count, np.concatenate((turns.real, turns.imag)), shown * np.abs(1.0 / omega**2 + made) ** 2)
