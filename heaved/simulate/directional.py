"""Seas whose waves come from many directions, so that roll and pitch tell of heave only so much. Pure.

Names are ``S6S-bow-0.8``: an irregular sea, where it comes from, and the squared multiple coherence of heave with roll
and pitch together. Waves are spread about their main direction as cos^2s of half the angle (Longuet-Higgins). Heave
answers a wave from anywhere alike, pitch and surge with the cosine of its direction from the bow, roll, sway and yaw
with the sine, as a hull does that is short beside the waves. The coherence then is that of the spreading alone,
whatever the heading (:func:`spread_of`): real seas are at 0.7 to 0.95, a swell above.

``bow`` comes from 30 degrees off the bow, ``beam`` from abeam. In ``turn`` the vessel, which keeps its place, turns
from the first to the second within two minutes. Heave is that of the same sea without a direction, wave by wave.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from heaved.simulate.vessel import Array

HEADINGS_RAD: Final = {"bow": math.radians(30.0), "beam": math.radians(90.0), "turn": math.radians(30.0)}
"""How far to port of the bow the main direction is at first."""
SEAS: Final = ("S6S", "SL")
COHERENCES: Final = {"bow": (0.0, 0.5, 0.8, 0.95), "beam": (0.0, 0.5, 0.8, 0.95), "turn": (0.8, 0.95)}
NAMES: Final = tuple(
    f"{sea}-{heading}-{share:g}" for sea in SEAS for heading, shares in COHERENCES.items() for share in shares
)
"""The standard ones. Any steady irregular sea, heading and coherence may be named."""
ALONG: Final = (1, 4)
ACROSS: Final = (2, 3, 5)
"""Surge and pitch; sway, roll and yaw: their places in :class:`~heaved.simulate.vessel.Responses`."""
_GOLDEN: Final = (math.sqrt(5.0) - 1.0) / 2.0


class Turn(msgspec.Struct, frozen=True):
    """The vessel turns to starboard, at rest in rate and acceleration at both ends (a quintic)."""

    start_s: float = 480.0
    duration_s: float = 120.0
    angle_rad: float = math.radians(60.0)

    def at(self, t: Array) -> tuple[Array, Array]:
        """By how much it has turned, rad, and how fast it does, rad/s; of the shape of ``t``."""
        u = np.clip((t - self.start_s) / self.duration_s, 0.0, 1.0)
        angle: Array = self.angle_rad * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        rate: Array = self.angle_rad / self.duration_s * 30.0 * u**2 * (1.0 - u) ** 2
        return angle, rate


class Directional(msgspec.Struct, frozen=True):
    """What a name says."""

    sea: str
    heading: str
    coherence: float

    @property
    def turn(self) -> Turn | None:
        """Of its vessel, if it makes one."""
        return Turn() if self.heading == "turn" else None

    @property
    def from_rad(self) -> float:
        """Main direction to port of the bow, at first."""
        return HEADINGS_RAD[self.heading]


def directional(name: str) -> Directional | None:
    """What the name of a directional sea says; None: it has no direction in it.

    Raises:
        ValueError: a direction or a coherence that there is not.
    """
    sea, *words = name.split("-", 2)
    if not words:
        return None
    heading, share = words if len(words) == 2 else (words[0], "")
    try:
        coherence = float(share)
    except ValueError:
        coherence = math.nan
    if heading not in HEADINGS_RAD or not 0.0 <= coherence <= 1.0:
        raise ValueError(
            f"unknown sea {name!r}: a sea with directions is written SEA-HEADING-COHERENCE, such as S6S-bow-0.8, "
            f"with a heading of {', '.join(HEADINGS_RAD)} and a squared coherence of 0 to 1"
        )
    return Directional(sea, heading, coherence)


def spread_of(coherence: float) -> float:
    """The exponent s at which cos^2s of half the angle gives this squared multiple coherence; infinite for 1.

    With the first two moments s / (s + 1) and s (s - 1) / ((s + 1)(s + 2)) of the cosine it is
    s^2 (s + 2) / ((s + 1)(s^2 + s + 1)): 0 for waves from everywhere alike.
    """
    if coherence >= 1.0:
        return math.inf
    rest = 1.0 - coherence
    roots = np.roots([rest, 2.0 * rest, -2.0 * coherence, -coherence])
    return max(0.0, float(np.max(roots.real)))


def moments(coherence: float, from_rad: float) -> tuple[Array, Array]:
    """Means over the directions: (2,) of the sine and the cosine, (2, 2) of their products."""
    s = spread_of(coherence)
    first, second = (s / (s + 1.0), s * (s - 1.0) / ((s + 1.0) * (s + 2.0))) if math.isfinite(s) else (1.0, 1.0)
    sine, cosine = math.sin(from_rad), math.cos(from_rad)
    twice, mixed = math.cos(2.0 * from_rad), math.sin(2.0 * from_rad)
    products = 0.5 * np.array([[1.0 - second * twice, second * mixed], [second * mixed, 1.0 + second * twice]])
    return first * np.array([sine, cosine]), products


def directions(count: int, coherence: float, from_rad: float, rng: np.random.Generator) -> Array:
    """Directions (count,) of waves, rad to port of the bow: neighbours share out the spreading between them, in steps
    of the golden section, so that every narrow band of frequencies has all of it.
    """
    s = spread_of(coherence)
    if not math.isfinite(s):
        return np.full(count, from_rad)
    angle = np.linspace(-math.pi, math.pi, 20_001)
    density = np.abs(np.cos(angle / 2.0)) ** (2.0 * s)
    below = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2.0)])
    shares = (rng.random() + _GOLDEN * np.arange(count)) % 1.0
    return np.asarray(from_rad + np.interp(shares * below[-1], below, angle), dtype=np.float64)


def directed(amplitudes: NDArray[np.complex128], from_rad: Array) -> NDArray[np.complex128]:
    """Amplitudes (6, N) of waves from ``from_rad`` (N,), of what they would be from ahead, and from abeam."""
    result = amplitudes.copy()
    result[list(ALONG)] *= np.cos(from_rad)
    result[list(ACROSS)] *= np.sin(from_rad)
    return result
