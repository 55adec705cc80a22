"""A craft under way in head seas that rise and fall: true heave and pitch, and what its sensors say. Pure, seeded.

The equations of motion are handed in (an :class:`Accelerations`): a simulator that brought its own copy would have to
be kept in step. What is added here the estimator does not know: the waves. They meet the craft at the frequency of
encounter, w + k U, lift its hulls (decaying with draught, averaged over their length), and move the water at its foils.

Sea: JONSWAP, one peak period, its height stepping. Heave and pitch carry white noise; the flaps hold the pitch steady,
with a lag, and are read back as they stand.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Protocol

import msgspec
import numpy as np

from heaved.samples import GRAVITY_MPS2
from heaved.simulate.seaway import WaveSystem
from heaved.simulate.vessel import Array

if TYPE_CHECKING:
    from collections.abc import Sequence

COMPONENTS: Final = 120
"""Waves in a sea."""
LONGEST, SHORTEST = 0.45, 3.0
"""Frequencies over that of the peak: what is left out beyond holds 2 % of the energy and hardly moves a hull."""
RAMP_S: Final = 4.0
"""A change of sea takes this long, half of it before its time."""
SUBSTEPS: Final = 2
"""Steps of integration per sample."""


class Accelerations(Protocol):
    """z'' and q' (2, k) of states (4, k) = z, z', theta, q, but for the waves on the hulls.

    flaps_rad, water_mps, elevation_m: (2, k), at the fore and aft foil.
    """

    def __call__(
        self, state: Array, speed_mps: float, flaps_rad: Array, water_mps: Array, elevation_m: Array, /
    ) -> Array:
        """See the class."""


class Hull(msgspec.Struct, frozen=True, kw_only=True):
    """What the waves get hold of."""

    heave_force_ps2: float
    """Heave acceleration per metre of wave: waterplane stiffness over mass."""
    pitch_force_ps2: float
    """Pitch acceleration per radian of wave slope: pitch stiffness over inertia."""
    foil_arms_m: tuple[float, float]
    """Fore and aft, forward of the centre of gravity."""
    foil_depths_m: tuple[float, float]
    length_m: float = 26.0
    """Of the waterline."""
    draught_m: float = 1.2


class CraftLine(msgspec.Struct, frozen=True, kw_only=True):
    """The feet of the heave and the pitch sensor vibrate: amplitudes of what they read too much."""

    hz: float
    heave_m: float
    pitch_rad: float


class CraftShake(msgspec.Struct, frozen=True, kw_only=True):
    """What disturbs the readings of heave and pitch."""

    lines: tuple[CraftLine, ...] = ()
    spike_share: float = 0.0
    """Readings of either channel that are wrong, each on its own."""
    spikes: tuple[float, float] = (10.0, 100.0)
    """By so many standard deviations of the noise, either way."""
    lost_share: float = 0.0
    """Readings of either channel that never arrive, each on its own."""


_LINE: Final = CraftLine(hz=3.1, heave_m=0.1, pitch_rad=0.01)
_STRONG: Final = CraftLine(hz=3.1, heave_m=0.2, pitch_rad=0.02)

CRAFT_SHAKES: Final[dict[str, CraftShake]] = {
    "line-3.1": CraftShake(lines=(_LINE,)),
    "line-3.1-strong": CraftShake(lines=(_STRONG,)),
    "lines": CraftShake(lines=(_LINE, CraftLine(hz=4.4, heave_m=0.1, pitch_rad=0.01))),
    "line-8.7": CraftShake(lines=(CraftLine(hz=8.7, heave_m=0.1, pitch_rad=0.01),)),
    "spikes": CraftShake(spike_share=0.005),
    "losses": CraftShake(lost_share=0.3),
    "line-3.1, spikes, losses": CraftShake(lines=(_LINE,), spike_share=0.005, lost_share=0.3),
}


def craft_shake(shake: str | CraftShake) -> CraftShake:
    """The one of :data:`CRAFT_SHAKES` by name, nothing for ""; a :class:`CraftShake` stays what it is.

    Raises:
        ValueError: there is none of that name.
    """
    if isinstance(shake, CraftShake):
        return shake
    if shake and shake not in CRAFT_SHAKES:
        raise ValueError(f"unknown shake of a craft {shake!r}: choose one of {', '.join(CRAFT_SHAKES)}")
    return CRAFT_SHAKES[shake] if shake else CraftShake()


class CraftShaking:
    """One realisation, known at any instant."""

    def __init__(self, shake: str | CraftShake, seed: int, noise: tuple[float, float]) -> None:
        """``noise``: standard deviations of heave and pitch readings, which spikes are counted in.

        Raises:
            ValueError: as :func:`craft_shake`.
        """
        self._shake = craft_shake(shake)
        self._rng = np.random.default_rng([seed, 0x5A4E])
        self._noise = np.array(noise)
        self._phases = 2.0 * np.pi * self._rng.random((len(self._shake.lines), 2))

    def readings(self, t_s: Array, values: Array) -> Array:
        """(n, 2) heave and pitch as they are read; nan: lost."""
        shake, rng, read = self._shake, self._rng, np.array(values)
        for line, phases in zip(shake.lines, self._phases, strict=True):
            amplitude = np.array([line.heave_m, line.pitch_rad])
            read += amplitude * np.sin(2.0 * np.pi * line.hz * t_s[:, None] + phases)
        size = rng.uniform(*shake.spikes, read.shape) * rng.choice([-1.0, 1.0], read.shape) * self._noise
        read += np.where(rng.random(read.shape) < shake.spike_share, size, 0.0)
        read[rng.random(read.shape) < shake.lost_share] = np.nan
        return read


class Passage(msgspec.Struct, frozen=True, kw_only=True):
    """The sea met, the speed, the sensors."""

    stages: tuple[tuple[float, float], ...] = ((0.0, 0.3), (80.0, 2.5), (160.0, 0.3))
    """(from s, significant height m), in order of time."""
    duration_s: float = 240.0
    peak_period_s: float = 6.5
    rate_hz: float = 20.0
    speed_mps: float = 18.0
    heave_noise_m: float = 0.05
    """Standard deviation per sample, white."""
    pitch_noise_rad: float = 0.005
    flap_gain: tuple[float, float] = (0.4, 0.3)
    """Flap angle per pitch (rad/rad) and per pitch rate (rad per rad/s); the fore flap goes against, the aft with."""
    flap_lag_s: float = 0.15
    flap_limit_rad: float = 0.2
    outlier_share: float = 0.0
    """Readings of either channel that are wrong, each on its own, by 5 to 20 standard deviations of the noise."""
    shake: str | CraftShake = ""
    """What else disturbs the readings, by itself or by its name in ``CRAFT_SHAKES``; "": nothing."""


class Voyage(msgspec.Struct, frozen=True, kw_only=True):
    """One realisation, arrays (n,)."""

    t_s: Array
    heave_m: Array
    """True heave from the design attitude."""
    heave_velocity_mps: Array
    pitch_rad: Array
    pitch_rate_radps: Array
    measured_heave_m: Array
    measured_pitch_rad: Array
    speed_mps: Array
    flap_fore_rad: Array
    flap_aft_rad: Array
    wave_heave_mps2: Array
    """Acceleration of the hulls by the waves, but for that of the foils."""
    wave_pitch_radps2: Array

    @property
    def truth(self) -> Array:
        """(4, n): z, z', theta, q."""
        return np.array([self.heave_m, self.heave_velocity_mps, self.pitch_rad, self.pitch_rate_radps])


class Waves(msgspec.Struct, frozen=True):
    """What the sea does to one craft at the instants of integration (m,): all that a step needs."""

    force: Array
    """(2, m): heave m/s2, pitch rad/s2, on the hulls."""
    water_mps: Array
    """(2, m): vertical speed of the water at the foils."""
    elevation_m: Array
    """(2, m): of the surface above the foils."""


def significant_height_m(passage: Passage, t_s: Array) -> Array:
    """Hs at ``t_s`` (n,): constant, with a smooth ramp of RAMP_S at each change."""
    height = np.full_like(t_s, passage.stages[0][1])
    for (_, before), (at_s, after) in zip(passage.stages, passage.stages[1:], strict=False):
        u = np.clip((t_s - at_s) / RAMP_S + 0.5, 0.0, 1.0)
        height = height + (after - before) * u * u * (3.0 - 2.0 * u)
    return height


def waves(hull: Hull, passage: Passage, t_s: Array, rng: np.random.Generator) -> Waves:
    """One realisation of the sea, met head on at constant speed, at ``t_s`` (m,)."""
    peak_hz = 1.0 / passage.peak_period_s
    edges = np.geomspace(LONGEST * peak_hz, SHORTEST * peak_hz, COMPONENTS + 1)
    f = edges[:-1] * (edges[1:] / edges[:-1]) ** rng.random(COMPONENTS)
    energy = WaveSystem(1.0, passage.peak_period_s).spectrum(f) * np.diff(edges)
    amplitude = np.sqrt(2.0 * energy) * np.exp(2j * np.pi * rng.random(COMPONENTS))
    omega = 2.0 * np.pi * f
    k = omega**2 / GRAVITY_MPS2
    # Deep water; the average of cos(k x) over the waterplane is sin(kL/2) / (kL/2), that of the slope alike.
    hold = amplitude * np.exp(-k * hull.draught_m) * np.sinc(k * hull.length_m / (2.0 * np.pi))
    rows = [hull.heave_force_ps2 * hold, hull.pitch_force_ps2 * 1j * k * hold]
    depths = zip(hull.foil_arms_m, hull.foil_depths_m, strict=True)
    at_foils = [(amplitude * np.exp(1j * k * arm), np.exp(-k * depth)) for arm, depth in depths]
    rows += [1j * omega * wave * decay for wave, decay in at_foils]
    rows += [wave for wave, _ in at_foils]
    weights = np.array(rows)
    envelope = significant_height_m(passage, t_s)
    made = np.empty((6, t_s.size))
    for start in range(0, t_s.size, 1024):
        block = slice(start, start + 1024)
        phase = np.multiply.outer(omega + k * passage.speed_mps, t_s[block])
        made[:, block] = weights.real @ np.cos(phase) - weights.imag @ np.sin(phase)
    made *= envelope
    return Waves(made[0:2], made[2:4], made[4:6])


def sail(
    accelerations: Accelerations,
    trim: tuple[float, float],
    seeds: Sequence[int],
    passage: Passage,
    hull: Hull,
) -> list[Voyage]:
    """One voyage per seed, integrated side by side from the trim (heave m, pitch rad) with the classic Runge-Kutta."""
    rngs = [np.random.default_rng([seed, 0x5EA]) for seed in seeds]
    count = round(passage.duration_s * passage.rate_hz)
    dt = 1.0 / (passage.rate_hz * SUBSTEPS)
    fine = 0.5 * dt * np.arange(2 * SUBSTEPS * (count - 1) + 1, dtype=np.float64)
    met = [waves(hull, passage, fine, rng) for rng in rngs]
    force = np.stack([sea.force for sea in met], axis=-1)  # (2, m, k)
    water = np.stack([sea.water_mps for sea in met], axis=-1)
    elevation = np.stack([sea.elevation_m for sea in met], axis=-1)
    state = np.repeat(np.array([[trim[0]], [0.0], [trim[1]], [0.0]]), len(rngs), axis=1)
    flaps = np.zeros((2, len(rngs)))
    states, flown = np.empty((count, 4, len(rngs))), np.empty((count, 2, len(rngs)))

    followed = 1.0 - np.exp(-1.0 / (passage.rate_hz * passage.flap_lag_s))

    def rate(at: Array, i: int) -> Array:
        slope = np.empty_like(at)
        slope[0::2] = at[1::2]
        slope[1::2] = accelerations(at, passage.speed_mps, flaps, water[:, i], elevation[:, i]) + force[:, i]
        return slope

    for n in range(count):
        states[n], flown[n] = state, flaps
        if n == count - 1:
            break
        for i in range(2 * SUBSTEPS * n, 2 * SUBSTEPS * (n + 1), 2):
            first = rate(state, i)
            second = rate(state + 0.5 * dt * first, i + 1)
            third = rate(state + 0.5 * dt * second, i + 1)
            fourth = rate(state + dt * third, i + 2)
            state = state + dt / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
        asked = passage.flap_gain[0] * (state[2] - trim[1]) + passage.flap_gain[1] * state[3]
        asked = np.clip(asked, -passage.flap_limit_rad, passage.flap_limit_rad)
        # Held over the next sample interval, as the read-back says.
        flaps = flaps + followed * (np.stack([-asked, asked]) - flaps)
    at = slice(None, None, 2 * SUBSTEPS)
    noise = (passage.heave_noise_m, passage.pitch_noise_rad)
    shaking = [CraftShaking(passage.shake, seed, noise) for seed in seeds]
    return [
        _voyage(passage, states[:, :, k], flown[:, :, k], met[k].force[:, at], rng, shaking[k])
        for k, rng in enumerate(rngs)
    ]


def _voyage(
    passage: Passage, states: Array, flaps: Array, force: Array, rng: np.random.Generator, shaking: CraftShaking
) -> Voyage:
    """Add the sensors to states (n, 4) and flaps (n, 2)."""
    n = len(states)
    noise = np.array([passage.heave_noise_m, passage.pitch_noise_rad])
    measured = states[:, 0::2] + noise * rng.standard_normal((n, 2))
    wrong = rng.uniform(5.0, 20.0, (n, 2)) * np.sign(rng.standard_normal((n, 2))) * noise
    measured += wrong * (rng.random((n, 2)) < passage.outlier_share)
    t = np.arange(n) / passage.rate_hz
    measured = shaking.readings(t, measured)
    return Voyage(
        t_s=t,
        heave_m=states[:, 0],
        heave_velocity_mps=states[:, 1],
        pitch_rad=states[:, 2],
        pitch_rate_radps=states[:, 3],
        measured_heave_m=measured[:, 0],
        measured_pitch_rad=measured[:, 1],
        speed_mps=np.full(n, passage.speed_mps),
        flap_fore_rad=flaps[:, 0],
        flap_aft_rad=flaps[:, 1],
        wave_heave_mps2=force[0],
        wave_pitch_radps2=force[1],
    )
