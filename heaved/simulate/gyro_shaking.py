"""What shakes the gyros of both IMUs of a hull, and what is wrong with their readings. Pure, seeded.

A :class:`GyroShake` says what there is; :data:`GYRO_SHAKES` has those with a name. Engines turn the feet of both IMUs
at one frequency, each by its own amount and with its own phases; a hum and slams are different at both places. A
realisation (:class:`GyroShaking`) is known at any instant, so polls of one hull at any rate see the same vibration, and
what lies above half their rate folds as it does in a real register that is read too seldom.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

if TYPE_CHECKING:
    from heaved.simulate.vessel import Array

HARMONICS: Final = 400
"""Of a hum."""
SPEEDS: Final = 3
"""Harmonics of an engine's wandering speed."""
SPEED_PERIODS_S: Final = (15.0, 75.0)
LEAST_SPIKE: Final = 0.1
"""Of the largest one."""
QUIET: Final = 12.0
"""Time constants after which a ringing is no more than a few millionths of what it was."""
LONGEST_S: Final = 4000.0
"""Slams are drawn up to here."""


class GyroLine(msgspec.Struct, frozen=True, kw_only=True):
    """A harmonic about each axis, of an engine or a propeller; amplitudes per axis."""

    hz: float
    midships_radps: float
    local_radps: float
    wander: float = 0.0
    """The frequency wanders within this share to both sides, over some tens of seconds."""
    in_phase: bool = False
    """All axes of both IMUs turn at once: nothing looks more like a rotation between them."""


class GyroHum(msgspec.Struct, frozen=True, kw_only=True):
    """Noise of even density between two frequencies; RMS per axis."""

    from_hz: float
    to_hz: float
    midships_radps: float
    local_radps: float


class GyroSlams(msgspec.Struct, frozen=True, kw_only=True):
    """Blows at random times, each followed by a ringing of the hull girder about every axis; first amplitudes."""

    hz: float
    damping: float
    every_s: float
    midships_radps: float
    local_radps: float


class GyroShake(msgspec.Struct, frozen=True, kw_only=True):
    """All that disturbs the readings of both triads."""

    vibration: tuple[GyroLine | GyroHum | GyroSlams, ...] = ()
    spike_share: float = 0.0
    """Readings of either triad in which one axis is wrong."""
    spike_radps: float = 0.3
    """The largest; sizes are even between a tenth of it and this."""
    lost_share: float = 0.0
    """Readings of either triad that never arrive."""


_LINE: Final = GyroLine(hz=3.1, midships_radps=2e-3, local_radps=4e-3)
_ENGINES: Final = (
    GyroLine(hz=2.2, midships_radps=2e-3, local_radps=3e-3, wander=0.05),
    GyroLine(hz=3.7, midships_radps=1e-3, local_radps=4e-3, wander=0.05),
)

GYRO_SHAKES: Final[dict[str, GyroShake]] = {
    "line-1.3": GyroShake(vibration=(GyroLine(hz=1.3, midships_radps=1e-3, local_radps=2e-3),)),
    "line-3.1": GyroShake(vibration=(_LINE,)),
    "line-3.1 in phase": GyroShake(vibration=(msgspec.structs.replace(_LINE, in_phase=True),)),
    "engines": GyroShake(vibration=_ENGINES),
    "hum": GyroShake(vibration=(GyroHum(from_hz=1.0, to_hz=4.5, midships_radps=5e-4, local_radps=1e-3),)),
    "whipping": GyroShake(
        vibration=(GyroSlams(hz=1.5, damping=0.02, every_s=20.0, midships_radps=1e-3, local_radps=2e-3),)
    ),
    "slams": GyroShake(
        vibration=(GyroSlams(hz=2.2, damping=0.07, every_s=15.0, midships_radps=1e-2, local_radps=2e-2),)
    ),
    "spikes": GyroShake(spike_share=0.005),
    "losses": GyroShake(lost_share=0.3),
    "line-3.1, spikes, losses": GyroShake(vibration=(_LINE,), spike_share=0.005, lost_share=0.3),
    "engines, spikes, losses": GyroShake(vibration=_ENGINES, spike_share=0.005, lost_share=0.3),
}


def gyro_shake(shake: str | GyroShake) -> GyroShake:
    """The one of :data:`GYRO_SHAKES` by name, nothing for ""; a :class:`GyroShake` stays what it is.

    Raises:
        ValueError: there is none of that name.
    """
    if isinstance(shake, GyroShake):
        return shake
    if shake and shake not in GYRO_SHAKES:
        raise ValueError(f"unknown shake of the gyros {shake!r}: choose one of {', '.join(GYRO_SHAKES)}")
    return GYRO_SHAKES[shake] if shake else GyroShake()


class GyroShaking:
    """One realisation, at one of both IMUs."""

    def __init__(self, shake: str | GyroShake, seed: int, *, local: bool) -> None:
        """
        Raises:
            ValueError: as :func:`gyro_shake`.
        """
        self.shake = gyro_shake(shake)
        # Both IMUs are drawn each time, so that they hang on one engine.
        rng = np.random.default_rng([seed, 7])
        self._parts = [_Part(part, rng, int(local)) for part in self.shake.vibration]
        self._rng = np.random.default_rng([seed, 8, int(local)])

    def rates(self, t_s: Array) -> Array:
        """(n, 3) what the vibration adds at ``t_s`` (n,), rad/s."""
        total = np.zeros((len(t_s), 3))
        for part in self._parts:
            total += part.rates(t_s)
        return total

    def readings(self, t_s: Array, rates: Array) -> Array:
        """(n, 3) rates as they are read: with the vibration, the spikes, and nan where nothing arrives."""
        n, shake = len(t_s), self.shake
        read = rates + self.rates(t_s)
        size = shake.spike_radps * self._rng.uniform(LEAST_SPIKE, 1.0, n) * self._rng.choice([-1.0, 1.0], n)
        axis, wrong, lost = self._rng.integers(0, 3, n), self._rng.random(n), self._rng.random(n)
        read[np.arange(n), axis] += np.where(wrong < shake.spike_share, size, 0.0)
        read[lost < shake.lost_share] = np.nan
        return read


class _Part:
    """One kind of vibration at one IMU (0: midships, 1: local)."""

    def __init__(self, part: GyroLine | GyroHum | GyroSlams, rng: np.random.Generator, which: int) -> None:
        self._part = part
        self._size = (part.midships_radps, part.local_radps)[which]
        if isinstance(part, GyroLine):
            self._w = 2.0 * math.pi / rng.uniform(*SPEED_PERIODS_S, SPEEDS)
            self._slow = 2.0 * math.pi * rng.random(SPEEDS)
            phases = 2.0 * math.pi * rng.random((2, 3))
            self._phases = np.full(3, phases[0, 0]) if part.in_phase else phases[which]
        elif isinstance(part, GyroHum):
            cells = np.linspace(part.from_hz, part.to_hz, HARMONICS + 1)
            f, phases = rng.random((2, HARMONICS)), 2.0 * math.pi * rng.random((2, HARMONICS, 3))
            self._w = 2.0 * math.pi * (cells[:-1] + (cells[1] - cells[0]) * f[which])
            self._phases = phases[which]
        else:
            count = int(3.0 * LONGEST_S / part.every_s) + 10
            self._at_s = np.cumsum(rng.exponential(part.every_s, count))
            self._blows = rng.standard_normal((2, count, 3))[which]

    def rates(self, t_s: Array) -> Array:
        part = self._part
        if isinstance(part, GyroLine):
            turned = np.multiply.outer(t_s, self._w) + self._slow
            # Phase of hz (1 + wander u), u the mean of three slow harmonics.
            ahead = t_s + part.wander * np.mean((np.sin(turned) - np.sin(self._slow)) / self._w, axis=1)
            return np.asarray(self._size * np.sin(2.0 * math.pi * part.hz * ahead[:, None] + self._phases))
        if isinstance(part, GyroHum):
            total, each = np.empty((len(t_s), 3)), self._size * math.sqrt(2.0 / HARMONICS)
            for start in range(0, len(t_s), 1024):
                turned = np.multiply.outer(t_s[start : start + 1024], self._w)[:, :, None] + self._phases
                total[start : start + 1024] = each * np.cos(turned).sum(axis=1)
            return total
        w = 2.0 * math.pi * part.hz
        total = np.zeros((len(t_s), 3))
        for at_s, blow in zip(self._at_s.tolist(), self._blows, strict=True):
            since = t_s - at_s
            rings = (since > 0.0) & (since < QUIET / (part.damping * w))
            if rings.any():
                s = since[rings]
                ring = np.exp(-part.damping * w * s) * np.sin(w * math.sqrt(1.0 - part.damping**2) * s)
                total[rings] += self._size * ring[:, None] * blow
        return total
