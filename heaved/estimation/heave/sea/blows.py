"""Blows: slams, a load that is set down, a wave against the bow. Told by how suddenly it begins to ring.

The second difference of the samples hardly sees the waves; what is left, noise and steady vibration, has a usual size.
A blow stands far out of it within one sample, and out of the ringing of the one before, which only dies away.
"""

from __future__ import annotations

from math import exp, inf, sqrt
from typing import Final

import msgspec


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What counts as a blow."""

    usual_s: float = 30.0
    """Nothing counts as one in the first half of that."""
    at_first_s: float = 3.0
    """What is usual is a mean at first,"""
    follows_s: float = 4.0
    """and then a median, which follows what is larger, or smaller, by a factor of e in that time: what rings after a
    slam does so for less of the time than not, and is not usual, for half a minute even in a train of slams."""
    stands_out: float = 7.0
    """Times the usual size: noise does that once in centuries, a steady vibration never."""
    of_normal: float = 1.48
    """Standard deviation over median of what is normal."""
    quietest_mps2: float = 1e-4
    """A sensor whose readings stand still is not more quiet than that."""
    louder: float = 1.5
    """Times what is left of the last blow."""
    rings_s: float = 1.0
    """In which ringing falls to a third; the hulls' is shorter, and then nothing is missed but the smaller of two
    blows."""
    rises_s: float = 0.3
    """In which a blow reaches its height."""
    missed: float = 4.5
    """Readings of a blow may be withheld at first, as spikes: after so many intervals it still shows."""
    longer: float = 1.5
    """Two readings before that which are further apart, over the usual interval, tell nothing: what the waves do grows
    with the square of the time."""
    rarely: float = 0.25
    """The usual interval is one that a quarter of the time is made of shorter ones, about: where most readings are
    lost, that of those that are not."""
    least_mps2: float = 0.05
    """A smaller one costs nothing."""


TUNING: Final = Tuning()


class BlowDetector:
    """Step it with every sample."""

    def __init__(self) -> None:
        self._last: tuple[float, float] | None = None
        self._before: tuple[float, float] | None = None
        self._usual = self._seconds = self._ringing = 0.0
        self._interval_s = self._learned_s = self._sum2 = 0.0
        self._struck_s = -inf

    def step(self, t_s: float, a_mps2: float) -> float:
        """Size (m/s2) of the blow that has struck just before this sample, or while it was measured; 0: there was
        none.
        """
        last, before = self._last, self._before
        self._last, self._before = (t_s, a_mps2), last
        if last is None or before is None:
            return 0.0
        dt, earlier = t_s - last[0], last[0] - before[0]
        if not earlier < TUNING.missed * dt < TUNING.missed**2 * earlier:
            self._ringing = 0.0
            return 0.0
        self._interval_s = _followed(self._interval_s or dt, dt, dt, TUNING.rarely)
        self._ringing *= exp(-dt / TUNING.rings_s)
        if earlier > TUNING.longer * self._interval_s:
            return 0.0
        if not self._interval_s < TUNING.longer * self._learned_s < TUNING.longer**2 * self._interval_s:
            # Readings come otherwise than they did.
            self._seconds = self._sum2 = 0.0
            self._learned_s = self._interval_s
        missed = dt / earlier
        # From where the two before it lead; what the waves do meanwhile grows with the square of the time.
        size = abs(a_mps2 - last[1] - missed * (last[1] - before[1]))
        limit = max(TUNING.stands_out * TUNING.of_normal * self._usual, TUNING.least_mps2) * max(missed, 1.0) ** 2
        is_blow = (
            self._seconds > 0.5 * TUNING.usual_s
            and size > limit
            and size > TUNING.louder * self._ringing
            and t_s - self._struck_s > TUNING.rises_s
        )
        if is_blow:
            self._struck_s = t_s
        self._ringing = max(self._ringing, size)
        if 0.5 < missed < 1.5:
            self._learn(size, dt)
        return size if is_blow else 0.0

    def _learn(self, size: float, dt: float) -> None:
        """What is usual, from one more difference."""
        self._seconds = min(self._seconds + dt, TUNING.usual_s)
        if self._seconds < TUNING.at_first_s:
            self._sum2 += dt * size * size
            self._usual = sqrt(self._sum2 / self._seconds) / TUNING.of_normal
        else:
            self._usual = max(_followed(self._usual, size, dt), TUNING.quietest_mps2)


def _followed(usual: float, value: float, dt: float, rises: float = 1.0) -> float:
    """What is usual after one more value, a median; ``rises``: so much more slowly than it falls, a lower quantile."""
    if value == usual:
        return usual
    return usual * exp(rises * dt / TUNING.follows_s if value > usual else -dt / TUNING.follows_s)
