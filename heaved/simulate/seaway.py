"""Seaways: named, seeded seas whose motion is known exactly at any instant. Pure.

A sea is a sum of harmonic waves with random phases; the motion of the vessel is the sum of its responses to them, so
that displacement, velocity and acceleration are evaluated in closed form at any time, in any order.

* ``T1 T2 T3``: wave trains after trials 1 to 3 of Zhang et al. 2022 (UKF multi-step + BP): 0.03 m at 5 s, 0.04 m at
  6 s, 0.05 m at 8 s (amplitudes). Ours each have 15 % at 1.13 f and 10 % at 0.9 f besides.
* ``CRAFT``: chop and an old swell under a small craft that follows them up to 2.5 Hz.
* ``S4 S5 S6``: irregular seas of sea state 4, 5, 6 (JONSWAP, gamma 2); ``S6S`` sea and swell together; ``SL`` long
  swell; ``SX`` a sea of state 4's period that grows from 1.5 to 4 m in 60 s and later falls again; ``S0`` still.
* ``S6S-bow-0.8`` and the like: an irregular sea from many directions (:mod:`heaved.simulate.directional`).

Significant heights are those of the *waves*; the vessel makes more or less of them (:mod:`heaved.simulate.vessel`).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.simulate.directional import Directional, Turn, directed, directional, directions, moments
from heaved.simulate.vessel import CRANE_VESSEL, SMALL_CRAFT, Array, Motion, Real, Responses

if TYPE_CHECKING:
    from collections.abc import Sequence

MEAN_HEADING_RAD = math.radians(40.0)
COMPONENTS = 384
"""Waves in an irregular sea. Their frequencies are drawn one per cell of equal ratio (0.7 %), so nothing repeats.

Not more: from about 420 on the product with the weights is large enough for BLAS to wake its threads, and a single
instant costs several times as much beside other work."""
_BLOCK = 1024  # instants evaluated at once: bounds the memory of the phases to a few MB

Complex = NDArray[np.complex128]


class WaveSystem(msgspec.Struct, frozen=True):
    """One JONSWAP system: significant height, peak period, peak enhancement."""

    hs_m: float
    tp_s: float
    gamma: float = 2.0

    def spectrum(self, f_hz: Array) -> Array:
        """One-sided spectrum of the wave elevation, m2/Hz, scaled to exactly ``(hs_m / 4)**2`` (Hasselmann 1973)."""
        fp = 1.0 / self.tp_s
        x = np.asarray(f_hz, dtype=np.float64) / fp
        return (self.hs_m / 4.0) ** 2 / (fp * _jonswap_area(self.gamma)) * _jonswap_shape(x, self.gamma)


class Ramp(msgspec.Struct, frozen=True):
    """The factor on the sea's amplitude, 1 at first, changes by ``change``; twice differentiable throughout."""

    start_s: float
    duration_s: float
    change: float


class Train(msgspec.Struct, frozen=True):
    """A wave train of the paper's trials: amplitude and period of the main line."""

    amplitude_m: float
    period_s: float


SEAS: dict[str, tuple[WaveSystem, ...]] = {
    "S4": (WaveSystem(2.01, 5.1),),
    "S5": (WaveSystem(3.32, 6.6),),
    "S6": (WaveSystem(5.15, 8.2),),
    "S6S": (WaveSystem(3.0, 8.2), WaveSystem(1.5, 16.0, 6.0)),
    "SX": (WaveSystem(1.5, 5.1),),
    # Long swell of 18 to 20 s: two systems of equal energy, together Hs 1.2 m.
    "SL": (WaveSystem(1.2 / math.sqrt(2.0), 18.0, 6.0), WaveSystem(1.2 / math.sqrt(2.0), 20.0, 6.0)),
    "CRAFT": (WaveSystem(0.14, 2.2), WaveSystem(0.16, 7.0, 6.0)),
}
VESSELS: dict[str, Responses] = {"CRAFT": SMALL_CRAFT}
"""On which seas it is not the crane vessel that floats."""
HIGHEST_HZ: dict[str, float] = {name: 3.0 if name in VESSELS else 1.2 for name in SEAS}
"""There are no waves above."""
TRAINS: dict[str, Train] = {"T1": Train(0.03, 5.0), "T2": Train(0.04, 6.0), "T3": Train(0.05, 8.0)}
RAMPS: dict[str, tuple[Ramp, ...]] = {
    # Significant height 1.5 -> 4.0 m during 600..660 s and back during 1260..1320 s.
    "SX": (Ramp(600.0, 60.0, 2.5 / 1.5), Ramp(1260.0, 60.0, -2.5 / 1.5)),
}
STILL = "S0"
NAMES: tuple[str, ...] = (*TRAINS, *SEAS, STILL)

# A train's heave, and the roll and pitch that give tilt removal something to do: (frequency ratio, amplitude).
_TRAIN_HEAVE = ((1.0, 1.0), (1.13, 0.15), (0.9, 0.10))  # ratio to the main amplitude
_TRAIN_ROLL = ((0.83, math.radians(1.0)), (1.07, math.radians(0.4)))  # rad
_TRAIN_PITCH = ((1.21, math.radians(0.7)), (0.94, math.radians(0.3)))  # rad


def _jonswap_shape(x: Array, gamma: float) -> Array:
    """Unscaled JONSWAP spectrum over x = f / fp; nothing at and below zero."""
    safe = np.where(x > 0.05, x, 1.0)
    width = np.where(safe <= 1.0, 0.07, 0.09)
    peak = gamma ** np.exp(-((safe - 1.0) ** 2) / (2.0 * width**2))
    shape: Array = np.where(x > 0.05, safe**-5.0 * np.exp(-1.25 * safe**-4.0) * peak, 0.0)
    return shape


@lru_cache
def _jonswap_area(gamma: float) -> float:
    """Integral of the shape over x: a fine grid, and the f^-5 tail in closed form."""
    end = 20.0
    x = np.linspace(0.2, end, 400_001)
    body = float(np.trapezoid(_jonswap_shape(x, gamma), x))
    return body + 0.25 / end**4


def wave_spectrum(name: str, f_hz: Array) -> Array:
    """One-sided spectrum of the wave elevation of an irregular sea, m2/Hz, same shape as ``f_hz``.

    That of ``SX`` holds before the sea grows; the growth multiplies it by the square of :meth:`Seaway.envelope`.

    Raises:
        ValueError: ``name`` is no irregular sea (a train has lines, not a spectrum).
    """
    if name not in SEAS:
        raise ValueError(f"{name!r} has no continuous spectrum; the irregular seas are {', '.join(SEAS)}")
    f = np.asarray(f_hz, dtype=np.float64)
    total: Array = np.sum([system.spectrum(f) for system in SEAS[name]], axis=0)
    return total


def heave_spectrum(name: str, f_hz: Array) -> Array:
    """One-sided spectrum of true heave, m2/Hz. ``name`` and ``Raises`` as :func:`wave_spectrum`."""
    return vessel_on(name).heave.power(f_hz) * wave_spectrum(name, f_hz)


def vessel_on(name: str) -> Responses:
    """Which vessel floats on the sea ``name``."""
    return VESSELS.get(name, CRANE_VESSEL)


def motion_spectra(name: str, f_hz: Array, turned_rad: float = 0.0) -> Complex:
    """One-sided spectra (n, 3, 3) of true heave, roll and pitch (m2/Hz, m rad/Hz, rad2/Hz) and between them, as they
    are in a record: there are no waves above an end. ``name`` may have directions in it; ``turned_rad``: the vessel has
    turned to starboard by that since.

    That of x and y is the one of X conj(Y), for complex amplitudes of ``exp(+i w t)``.

    Raises:
        ValueError: ``name`` is no irregular sea.
    """
    asked = directional(name)
    sea = name if asked is None else asked.sea
    waves = np.asarray(wave_spectrum(sea, f_hz))  # unknown seas are refused here
    waves = np.where(f_hz <= HIGHEST_HZ[sea], waves, 0.0)
    answers = vessel_on(sea).transfers(f_hz)[[0, 3, 4]].T
    shares = np.ones((3, 3))
    if asked is not None:
        shares[0, 1:], shares[1:, 1:] = moments(asked.coherence, asked.from_rad + turned_rad)
        shares[1:, 0] = shares[0, 1:]
    spectra = waves[:, None, None] * shares * answers[:, :, None] * answers[:, None, :].conj()
    return np.asarray(spectra, dtype=np.complex128)


class Seaway:
    """The motion of a vessel in one realisation of a sea. Build it with :func:`seaway`."""

    def __init__(
        self,
        omega: Array,
        amplitudes: Complex,
        *,
        ramps: Sequence[Ramp] = (),
        turn: Turn | None = None,
        quarter: Complex | None = None,
    ) -> None:
        """Take N waves and what the vessel makes of each.

        ``omega`` (N,): angular frequencies, rad/s. ``amplitudes`` (6, N): complex amplitudes of heave, surge, sway
        (m), roll, pitch, yaw (rad), each ``Re sum z exp(i omega t)``. In a ``turn``, ``quarter`` (6, N) are those once
        it has turned by a quarter of a circle: between them it goes with the cosine and the sine of the angle.
        """
        self._omega = omega
        self._ramps = tuple(ramps)
        self._turn = turn
        rows = _rows(omega, amplitudes)
        if turn is not None and quarter is not None:
            rows = np.concatenate([rows, _rows(omega, quarter)])
        self._rows = rows  # (11, N) complex: order of _motion; (22, N) of a vessel that turns
        self._weights = _on_cos_and_sin(rows)
        self._trigonometry = np.empty(2 * omega.size)
        self.heave_std_m = float(np.sqrt(np.sum(np.abs(amplitudes[0]) ** 2) / 2.0))
        """Standard deviation of true heave, before any growth."""

    def at(self, t_s: float) -> Motion[float]:
        """Motion at one instant. Not for two threads at once: it has one work space."""
        n = self._omega.size
        phase = self._omega * t_s
        np.cos(phase, out=self._trigonometry[:n])
        np.sin(phase, out=self._trigonometry[n:])
        rows = self._shaped(self._weights @ self._trigonometry, np.array(t_s))
        channels: list[float] = rows.tolist()
        return _motion(t_s, channels)

    def motion(self, t_s: Array) -> Motion[Array]:
        """Motion at many instants ``t_s`` (n,), in any order."""
        t = np.asarray(t_s, dtype=np.float64)
        rows = np.empty((len(self._rows), t.size))
        starts = range(0, t.size, _BLOCK)
        if _evenly_spaced(t):
            # The waves from t[0] on serve every block, each turned to the block's own start: no new sines.
            ahead = np.multiply.outer(self._omega, t[:_BLOCK] - t[0])
            waves = np.vstack([np.cos(ahead), np.sin(ahead)])
            for start in starts:
                turned = _on_cos_and_sin(self._rows * np.exp(1j * self._omega * t[start]))
                rows[:, start : start + _BLOCK] = turned @ waves[:, : t.size - start]
        else:
            for start in starts:
                phase = np.multiply.outer(self._omega, t[start : start + _BLOCK])
                rows[:, start : start + _BLOCK] = self._weights @ np.vstack([np.cos(phase), np.sin(phase)])
        return _motion(t, list(self._shaped(rows, t)))

    def envelope(self, t_s: Array) -> Array:
        """Factor on the sea's amplitude at ``t_s`` (n,): 1 but for a growing sea."""
        return self._growth(np.asarray(t_s, dtype=np.float64))[0]

    def _shaped(self, rows: Array, t: Array) -> Array:
        """Rows (11, ...) of the turned vessel in the grown sea."""
        if self._turn is not None:
            rows = _turned(rows, *self._turn.at(t))
        return _grown(rows, self._growth(t)) if self._ramps else rows

    def _growth(self, t: Array) -> tuple[Array, Array, Array]:
        """The amplitude factor and its first and second time derivative, shape of ``t``: a quintic step per ramp."""
        e, e1, e2 = np.ones_like(t), np.zeros_like(t), np.zeros_like(t)
        for ramp in self._ramps:
            step, d = ramp.change, ramp.duration_s
            u = np.clip((t - ramp.start_s) / d, 0.0, 1.0)
            e = e + step * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
            e1 = e1 + step / d * 30.0 * u**2 * (1.0 - u) ** 2
            e2 = e2 + step / d**2 * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)
        return e, e1, e2


def _rows(omega: Array, amplitudes: Complex) -> Complex:
    """What :func:`_motion` names, (11, N), of amplitudes (6, N)."""
    heave, surge, sway, roll, pitch, yaw = amplitudes
    first = 1j * omega
    second = -(omega**2)
    return np.array(
        [
            *(heave, first * heave, second * heave, second * surge, second * sway),
            *(roll, pitch, yaw, first * roll, first * pitch, first * yaw),
        ]
    )


def _on_cos_and_sin(rows: Complex) -> Array:
    """Real weights (k, 2N) that make ``Re sum z exp(i phase)`` of complex ones (k, N): on [cos phase, sin phase]."""
    return np.ascontiguousarray(np.hstack([rows.real, -rows.imag]))


def _evenly_spaced(t: Array) -> bool:
    """Whether ``t`` (n,) is a grid, to a nanosecond."""
    if t.size < 2:
        return False
    grid = t[0] + (t[-1] - t[0]) / (t.size - 1) * np.arange(t.size)
    return bool(np.max(np.abs(t - grid)) < 1e-9)


def _grown(rows: Array, growth: tuple[Array, Array, Array]) -> Array:
    """Rows (11,) or (11, n) of a sea of varying amplitude: the product rule keeps each rate the exact derivative."""
    e, e1, e2 = growth
    grown = e * rows
    grown[1] += e1 * rows[0]
    grown[2] += 2.0 * e1 * rows[1] + e2 * rows[0]
    grown[8:] += e1 * rows[5:8]
    return grown


def _turned(rows: Array, angle: Array, rate: Array) -> Array:
    """Rows (22,) or (22, n), before the turn and a quarter of a circle on, for a vessel that has turned so far and
    does so at that rate: the product rule keeps each rate the exact derivative. The heading turns with it.
    """
    before, quarter = rows[:11], rows[11:]
    cosine, sine = np.cos(angle), np.sin(angle)
    turned = np.concatenate([before[:3], cosine * before[3:] + sine * quarter[3:]])
    turned[8:] += rate * (cosine * quarter[5:8] - sine * before[5:8])
    turned[7] += angle
    turned[10] += rate
    return turned


def _motion(t_s: Real, channels: Sequence[Real]) -> Motion[Real]:
    """Name the rows of the seaway's weights."""
    return Motion(
        t_s=t_s,
        heave_m=channels[0],
        heave_velocity_mps=channels[1],
        heave_acceleration_mps2=channels[2],
        surge_acceleration_mps2=channels[3],
        sway_acceleration_mps2=channels[4],
        roll_rad=channels[5],
        pitch_rad=channels[6],
        yaw_rad=channels[7] + MEAN_HEADING_RAD,
        roll_rate_radps=channels[8],
        pitch_rate_radps=channels[9],
        yaw_rate_radps=channels[10],
    )


def seaway(name: str, seed: int = 1, *, attitude: bool = True, start_s: float = 0.0) -> Seaway:
    """A realisation of the sea ``name``, one of :data:`NAMES` or one with directions, such as ``S6S-bow-0.8``; the same
    ``seed`` gives the same waves.

    Without ``attitude`` the vessel neither rolls nor pitches and keeps its heading: heave, surge and sway alone.
    ``start_s``: how long the waves have been running at t = 0; when a sea grows, or the vessel turns, is counted from
    t = 0 all the same.

    Raises:
        ValueError: there is no sea of that name.
    """
    asked = directional(name)
    if asked is not None:
        return _directional(asked, seed, attitude=attitude, start_s=start_s)
    if name not in NAMES:
        raise ValueError(f"unknown sea {name!r}: choose one of {', '.join(NAMES)}")
    rng = np.random.default_rng([seed, NAMES.index(name)])
    if name in SEAS:
        omega, amplitudes = _irregular(name, rng)
    elif name in TRAINS:
        omega, amplitudes = _train(TRAINS[name], rng)
    else:
        omega, amplitudes = np.ones(1), np.zeros((6, 1), dtype=np.complex128)
    if not attitude:
        amplitudes[3:] = 0.0
    amplitudes = amplitudes * np.exp(1j * omega * start_s)
    return Seaway(omega, amplitudes, ramps=RAMPS.get(name, ()))


def _directional(asked: Directional, seed: int, *, attitude: bool, start_s: float) -> Seaway:
    """The waves of the sea of that seed, each from a direction of its own."""
    if asked.sea not in SEAS or asked.sea in RAMPS:
        steady = ", ".join(sea for sea in SEAS if sea not in RAMPS)
        raise ValueError(f"waves of {asked.sea!r} have no directions: choose one of {steady}")
    rng = np.random.default_rng([seed, NAMES.index(asked.sea)])
    omega, ahead = _irregular(asked.sea, rng)
    come_from = directions(omega.size, asked.coherence, asked.from_rad, rng)
    now, quarter = (
        directed(ahead, angle) * np.exp(1j * omega * start_s) for angle in (come_from, come_from + math.pi / 2.0)
    )
    if not attitude:
        now[3:], quarter[3:] = 0.0, 0.0
        return Seaway(omega, now)
    return Seaway(omega, now, turn=asked.turn, quarter=quarter)


def _irregular(name: str, rng: np.random.Generator) -> tuple[Array, Complex]:
    """One wave per cell of the band: frequency anywhere in the cell, energy that of the cell, phase random."""
    systems = SEAS[name]
    lowest = 0.4 / max(system.tp_s for system in systems)  # a JONSWAP spectrum is empty (e^-49) below
    edges = np.geomspace(lowest, HIGHEST_HZ[name], COMPONENTS + 1)
    f = edges[:-1] * (edges[1:] / edges[:-1]) ** rng.random(COMPONENTS)
    inside = np.linspace(edges[:-1], edges[1:], 9)  # (9, COMPONENTS): fine enough for the sharpest peak
    energy = np.trapezoid(np.sum([system.spectrum(inside) for system in systems], axis=0), inside, axis=0)
    wave = np.sqrt(2.0 * energy) * np.exp(2j * np.pi * rng.random(COMPONENTS))
    return 2.0 * np.pi * f, vessel_on(name).transfers(f) * wave


def _train(train: Train, rng: np.random.Generator) -> tuple[Array, Complex]:
    """The trial's platform heaves on three lines; it rolls and pitches a little, and stays where it is."""
    lines = [(0, ratio, part * train.amplitude_m) for ratio, part in _TRAIN_HEAVE]
    lines += [(3, ratio, angle) for ratio, angle in _TRAIN_ROLL] + [(4, ratio, angle) for ratio, angle in _TRAIN_PITCH]
    amplitudes = np.zeros((6, len(lines)), dtype=np.complex128)
    for column, (dof, _, amplitude) in enumerate(lines):
        amplitudes[dof, column] = amplitude
    amplitudes *= np.exp(2j * np.pi * rng.random(len(lines)))
    return 2.0 * np.pi / train.period_s * np.array([ratio for _, ratio, _ in lines]), amplitudes
