"""What shakes a sensor beside the sea: engines, propellers, a ringing hull, slams; turns and lists. Pure, seeded.

A :class:`Shake` says what there is; :data:`SHAKES` has those with a name. :func:`shaking` draws one realisation of it,
which is known at any instant in any order: so polls of one hull at 200, 100, 20 and 10 Hz see the same vibration, and
what lies above half their rate folds as it does in a real register that is read too seldom.

Vibration adds to what the sensor reads and is no part of the true heave (its displacement is some millimetres). A turn
and a list are true motion: the truth has them too. Sizes are of the vertical; both horizontal axes have half of it,
with phases of their own.
"""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.special import j0

from heaved.simulate.seaway import COMPONENTS, Seaway
from heaved.simulate.vessel import Array, Motion, Real, Response

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

Complex = NDArray[np.complex128]

HORIZONTAL: Final = 0.5
"""Vibration along each horizontal axis over that along the vertical."""
BUTTERWORTH_DAMPING: Final = math.sqrt(0.5)
"""Damping of the sensors' second-order low-pass."""
LINE_WIDTH_HZ: Final = 0.02
"""Standard deviation of the peak that stands for a pure line in a density.

A line without any width costs the best linear estimate nothing: it is known for ever once it has been heard. What a
narrow peak costs grows with its width times the logarithm of its height; this one is coherent for some 8 s, costs
one or two per cent of the limit, and a grid of 5 mHz still resolves it."""
HIGHEST_HZ: Final = 64.0
"""Vibration above is left out of a folded density: there is none but what is left of a slam's onset."""
_SPEEDS: Final = 3
"""Harmonics of an engine's wandering speed."""
_SPEED_PERIODS_S: Final = (15.0, 75.0)
_HARMONICS: Final = 900
"""Of a noise. A cell is some 0.02 Hz wide, a hundredth of a resonance's peak and one in sixty of its frequency at the
low end, where the waves are."""
_QUIET: Final = 12.0
"""Time constants after which a ringing is no more than a few millionths of what it was."""


class Line(msgspec.Struct, frozen=True, kw_only=True):
    """One harmonic, of an engine or a propeller."""

    hz: float
    amplitude_mps2: float
    wander: float = 0.0
    """The frequency wanders within this share to both sides, with the speed of the engine over some tens of seconds."""
    rate_radps: float = 0.0
    """The sensor also turns to and fro about both horizontal axes: amplitude of what its gyros read. A line that does
    so does not wander."""

    def spectrum(self, f_hz: Array) -> Array:
        """One-sided density of the vertical, (m/s2)^2/Hz: over all the engine's speeds, or of a narrow peak."""
        power = self.amplitude_mps2**2 / 2.0
        if self.wander == 0.0:
            peak = np.exp(-0.5 * ((f_hz - self.hz) / LINE_WIDTH_HZ) ** 2)
            return np.asarray(power / (math.sqrt(2.0 * math.pi) * LINE_WIDTH_HZ) * peak, dtype=np.float64)
        reach = self.wander * self.hz
        return np.asarray(power / reach * _speed_density((f_hz - self.hz) / reach), dtype=np.float64)


class Band(msgspec.Struct, frozen=True, kw_only=True):
    """Noise of even density between two frequencies, with nothing above.

    Below, the density falls with the fourth power of the frequency (``from_hz`` has half of it), as the acceleration of
    a place that stays where it is.
    """

    from_hz: float
    to_hz: float
    rms_mps2: float

    def spectrum(self, f_hz: Array) -> Array:
        """One-sided density of the vertical, (m/s2)^2/Hz."""
        return self.rms_mps2**2 * _noise(self).spectrum(f_hz)

    @property
    def ends_hz(self) -> tuple[float, float]:
        """There is nothing beyond."""
        return self.from_hz / 30.0, self.to_hz

    def shape(self, f_hz: Array) -> Array:
        """The density without its scale."""
        r = f_hz / self.from_hz
        return np.asarray(r**4 / (1.0 + r**4), dtype=np.float64)


class Resonance(msgspec.Struct, frozen=True, kw_only=True):
    """A mode of the hull under random forces: density ``r^4 / ((1 - r^2)^2 + (2 damping r)^2)``, r = f / hz."""

    hz: float
    damping: float
    """Fraction of critical damping."""
    rms_mps2: float

    def spectrum(self, f_hz: Array) -> Array:
        """One-sided density of the vertical, (m/s2)^2/Hz."""
        return self.rms_mps2**2 * _noise(self).spectrum(f_hz)

    @property
    def ends_hz(self) -> tuple[float, float]:
        """There is nothing beyond: the forces have an end, too."""
        return self.hz / 30.0, 4.0 * self.hz

    def shape(self, f_hz: Array) -> Array:
        """The density without its scale."""
        r = f_hz / self.hz
        return np.asarray(r**4 / ((1.0 - r**2) ** 2 + (2.0 * self.damping * r) ** 2), dtype=np.float64)


class Slams(msgspec.Struct, frozen=True, kw_only=True):
    """Blows at random times, each followed by ``size exp(-damping w t) sin(w' t)``, upwards first."""

    size_mps2: float
    hz: float
    damping: float
    every_s: float
    """Mean distance: the times are those of a Poisson process."""

    @property
    def pole(self) -> complex:
        """The upper pole of the ringing, 1/s."""
        w = 2.0 * math.pi * self.hz
        return complex(-self.damping * w, w * math.sqrt(1.0 - self.damping**2))

    def transform(self, s: Complex) -> Complex:
        """Laplace transform of one blow, m/s."""
        pole = self.pole
        return np.asarray(self.size_mps2 * pole.imag / ((s - pole.real) ** 2 + pole.imag**2), dtype=np.complex128)

    def spectrum(self, f_hz: Array) -> Array:
        """One-sided density of the vertical, (m/s2)^2/Hz: that of shot noise (Campbell), its mean left out."""
        blow = np.abs(self.transform(np.asarray(2j * np.pi * f_hz, dtype=np.complex128))) ** 2
        return np.asarray(2.0 / self.every_s * blow, dtype=np.float64)


class Drift(msgspec.Struct, frozen=True, kw_only=True):
    """The accelerometers' bias runs away: from ``start_s`` on by ``size_mps2``, evenly over ``duration_s``."""

    size_mps2: float
    start_s: float
    duration_s: float


class Turn(msgspec.Struct, frozen=True, kw_only=True):
    """The ship turns to port: a steady sideways acceleration and the change of heading that makes it."""

    sideways_mps2: float
    start_s: float
    duration_s: float
    speed_mps: float = 5.0
    ease_s: float = 10.0
    """The helm takes so long each way, within the duration."""

    @property
    def end_s(self) -> float:
        """When it is over."""
        return self.start_s + self.duration_s


class List(msgspec.Struct, frozen=True, kw_only=True):
    """The crane takes a load: the ship lists, and stays so."""

    roll_rad: float
    start_s: float
    duration_s: float
    """How long it takes to lie over."""

    @property
    def end_s(self) -> float:
        """When it is over."""
        return self.start_s + self.duration_s


class Shake(msgspec.Struct, frozen=True, kw_only=True):
    """All that disturbs one vessel's sensors."""

    vibration: tuple[Line | Band | Resonance | Slams, ...] = ()
    drift: Drift | None = None
    turn: Turn | None = None
    list: List | None = None

    def density(self, f_hz: Array, rate_hz: float, bandwidth_hz: float = math.inf) -> Array:
        """One-sided density of the vertical vibration as an accelerometer with this low-pass reads it when it is polled
        at ``rate_hz``, (m/s2)^2/Hz, for ``f_hz`` from 0 to half that rate: what lies above is folded in.

        A drift, a turn and a list have none.
        """
        f = np.asarray(f_hz, dtype=np.float64)
        total = self._density(f, bandwidth_hz)
        for k in range(1, 1 + math.ceil(HIGHEST_HZ / rate_hz)):
            total = total + self._density(k * rate_hz - f, bandwidth_hz) + self._density(k * rate_hz + f, bandwidth_hz)
        return total

    def _density(self, f: Array, bandwidth_hz: float) -> Array:
        total = np.zeros_like(f)
        for part in self.vibration:
            total += part.spectrum(f)
        return total * _low_pass(bandwidth_hz).power(f)


_ENGINES: Final = (
    Line(hz=2.2, amplitude_mps2=0.3, wander=0.05),  # a slow main engine at 132 / min
    Line(hz=7.3, amplitude_mps2=0.3, wander=0.05),  # a medium-speed one at 438 / min
)
_GIRDER: Final = Resonance(hz=1.5, damping=0.02, rms_mps2=0.1)
_EVENT_S: Final = 420.0
"""When what happens once happens: after any start-up."""

SHAKES: Final[Mapping[str, Shake]] = {
    "line-1.3": Shake(vibration=(Line(hz=1.3, amplitude_mps2=0.5),)),
    "line-3.1": Shake(vibration=(Line(hz=3.1, amplitude_mps2=0.3),)),
    "line-3.1-small": Shake(vibration=(Line(hz=3.1, amplitude_mps2=0.05),)),
    "line-25.1": Shake(vibration=(Line(hz=25.1, amplitude_mps2=0.5),)),
    "engines": Shake(vibration=_ENGINES),
    "broadband": Shake(vibration=(Band(from_hz=1.0, to_hz=10.0, rms_mps2=0.3),)),
    "broadband-strong": Shake(vibration=(Band(from_hz=1.0, to_hz=10.0, rms_mps2=1.0),)),
    "whipping": Shake(vibration=(_GIRDER,)),
    "slams": Shake(vibration=(Slams(size_mps2=2.0, hz=2.2, damping=0.07, every_s=15.0),)),
    "gyros": Shake(vibration=(Line(hz=3.1, amplitude_mps2=0.3, rate_radps=2e-3),)),
    "engine-room": Shake(
        vibration=(
            Line(hz=12.5, amplitude_mps2=0.3, rate_radps=2e-3),
            Line(hz=25.1, amplitude_mps2=0.5, rate_radps=2e-3),
            Line(hz=6.8, amplitude_mps2=0.2, wander=0.05),  # the propeller's blades
            Band(from_hz=1.0, to_hz=10.0, rms_mps2=0.2),
            _GIRDER,
        )
    ),
    "warm-up": Shake(drift=Drift(size_mps2=0.05, start_s=_EVENT_S, duration_s=180.0)),
    "turn": Shake(turn=Turn(sideways_mps2=0.15, start_s=_EVENT_S, duration_s=80.0)),
    "list-step": Shake(list=List(roll_rad=math.radians(3.0), start_s=_EVENT_S, duration_s=4.0)),
}
"""By name. Amplitudes of lines and slams, RMS of the others."""
NONE: Final = ""
"""Name of nothing at all."""


def shake_of(shake: str | Shake) -> Shake:
    """The one of :data:`SHAKES` by name, nothing for :data:`NONE`; a :class:`Shake` stays what it is.

    Raises:
        ValueError: there is none of that name.
    """
    if isinstance(shake, Shake):
        return shake
    if shake == NONE:
        return Shake()
    if shake not in SHAKES:
        raise ValueError(f"unknown shake {shake!r}: choose one of {', '.join(SHAKES)}")
    return SHAKES[shake]


class Shaking:
    """One realisation of a shake, as a sensor with a certain low-pass has it. Build it with :func:`shaking`."""

    def __init__(self, shake: Shake, rng: np.random.Generator, bandwidth_hz: float) -> None:
        """``rng`` draws the phases and the blows; ``bandwidth_hz``: corner of the accelerometers' low-pass."""
        self._shake = shake
        low_pass = _low_pass(bandwidth_hz)
        steady: list[tuple[Array, Complex]] = []
        self._unsteady: list[_Wandering | _Blows] = []
        for part in shake.vibration:
            if isinstance(part, Slams):
                self._unsteady.append(_Blows(part, rng, bandwidth_hz))
            elif isinstance(part, Line) and part.wander > 0.0:
                self._unsteady.append(_Wandering(part, rng, low_pass))
            else:
                steady.append(_harmonics(part, rng, low_pass))
        self._harmonics = _as_motion(steady)

    def readings(self, t_s: Array) -> Array:
        """What adds to the sensor's readings at ``t_s`` (n,): (9, n) specific force (m/s2), roll, pitch and yaw (rad),
        rates (rad/s), each about or along x, y, z.
        """
        t = np.asarray(t_s, dtype=np.float64)
        added = np.zeros((9, t.size))
        for harmonics in self._harmonics:
            motion = harmonics.motion(t)
            added[0] += motion.surge_acceleration_mps2
            added[1] += motion.sway_acceleration_mps2
            added[2] += motion.heave_acceleration_mps2
            added[3] += motion.roll_rad
            added[4] += motion.pitch_rad
            added[6] += motion.roll_rate_radps
            added[7] -= motion.pitch_rate_radps  # bow up turns against the right hand about y
        for part in self._unsteady:
            added[:3] += part.force(t)
        if (drift := self._shake.drift) is not None:
            added[:3] += drift.size_mps2 * np.clip((t - drift.start_s) / drift.duration_s, 0.0, 1.0)
        return added

    def moved(self, motion: Motion[Real]) -> Motion[Real]:
        """The true motion with the turn and the list in it."""
        if (turn := self._shake.turn) is not None:
            motion = _turned(motion, turn)
        if (heel := self._shake.list) is not None:
            motion = _listed(motion, heel)
        return motion


def shaking(shake: str | Shake, seed: int, bandwidth_hz: float = math.inf) -> Shaking:
    """A realisation of a shake, or of the one of that name; the same ``seed`` gives the same vibration.

    Raises:
        ValueError: there is none of that name.
    """
    return Shaking(shake_of(shake), np.random.default_rng([seed, 6]), bandwidth_hz)


# --- steady vibration: a sum of harmonics, as the sea is -------------------------------------------------------------


def _low_pass(bandwidth_hz: float) -> Response:
    return Response(gain=1.0, period_s=1.0 / bandwidth_hz, damping=BUTTERWORTH_DAMPING)


def _harmonics(part: Line | Band | Resonance, rng: np.random.Generator, low_pass: Response) -> tuple[Array, Complex]:
    """Angular frequencies (N,) and complex amplitudes (6, N) of displacement along z, x, y (m), of roll and pitch (rad)
    and of yaw, which does not shake: in the order of :class:`~heaved.simulate.seaway.Seaway`.
    """
    rate_radps = 0.0
    if isinstance(part, Line):
        f, size = np.array([part.hz]), np.array([part.amplitude_mps2])
        rate_radps = part.rate_radps
    else:
        noise = _noise(part)
        f = rng.uniform(noise.edges_hz[:-1], noise.edges_hz[1:])
        size = part.rms_mps2 * np.sqrt(2.0 * noise.energy)
    omega = 2.0 * np.pi * f
    phases = np.exp(2j * np.pi * rng.random((5, f.size)))
    displacement = -size / omega**2 * low_pass.transfer(f)
    amplitudes = np.zeros((6, f.size), dtype=np.complex128)
    amplitudes[:3] = displacement * np.array([[1.0], [HORIZONTAL], [HORIZONTAL]]) * phases[:3]
    amplitudes[3:5] = rate_radps / omega * phases[3:]
    return omega, amplitudes


def _as_motion(parts: Sequence[tuple[Array, Complex]]) -> list[Seaway]:
    """Motions small enough for one thread each (see :data:`~heaved.simulate.seaway.COMPONENTS`)."""
    if not parts:
        return []
    omega = np.concatenate([omega for omega, _ in parts])
    amplitudes = np.concatenate([amplitudes for _, amplitudes in parts], axis=1)
    pieces = range(0, omega.size, COMPONENTS)
    return [Seaway(omega[i : i + COMPONENTS], amplitudes[:, i : i + COMPONENTS]) for i in pieces]


class _Noise:
    """A noise of RMS 1 in cells of frequency, one harmonic each: narrow where it is strong, and of even ratio."""

    def __init__(self, part: Band | Resonance) -> None:
        self._part = part
        lowest, highest = part.ends_hz
        f = np.geomspace(lowest, highest, 200_001)
        areas = [_cumulated(values, f) for values in (part.shape(f), np.sqrt(part.shape(f)), 1.0 / f)]
        self._area = areas[0][-1]
        share = sum(area / area[-1] for area in areas[1:])
        self.edges_hz = np.interp(np.linspace(0.0, 2.0, _HARMONICS + 1), share, f)
        self.energy = np.diff(np.interp(self.edges_hz, f, areas[0])) / self._area
        """(N,) of each cell."""

    def spectrum(self, f_hz: Array) -> Array:
        """One-sided density, 1/Hz."""
        lowest, highest = self._part.ends_hz
        inside = np.clip(f_hz, lowest, highest)
        return np.where(inside == f_hz, self._part.shape(inside) / self._area, 0.0)


_noise = cache(_Noise)


def _cumulated(values: Array, f: Array) -> Array:
    """Integral over ``f`` from its first up to each."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(f))])


# --- an engine whose speed wanders -----------------------------------------------------------------------------------


class _Wandering:
    """A line whose frequency is ``hz (1 + wander u(t))``, u the mean of three slow harmonics, so within +-1."""

    def __init__(self, line: Line, rng: np.random.Generator, low_pass: Response) -> None:
        self._line, self._low_pass = line, low_pass
        self._w = 2.0 * np.pi / rng.uniform(*_SPEED_PERIODS_S, _SPEEDS)
        self._slow = 2.0 * np.pi * rng.random(_SPEEDS)
        self._phases = 2.0 * np.pi * rng.random((3, 1))

    def force(self, t: Array) -> Array:
        """(3, n) along x, y, z, m/s2; behind the low-pass as if each speed were steady, for it changes slowly."""
        line = self._line
        turned = np.multiply.outer(self._w, t) + self._slow[:, None]
        frequency = line.hz * (1.0 + line.wander * np.mean(np.cos(turned), axis=0))
        cycles = line.hz * (t + line.wander * np.mean(np.sin(turned) / self._w[:, None], axis=0))
        wave = line.amplitude_mps2 * self._low_pass.transfer(frequency) * np.exp(2j * np.pi * cycles)
        sizes = np.array([[HORIZONTAL], [HORIZONTAL], [1.0]])
        return np.asarray(sizes * np.real(wave * np.exp(1j * self._phases)), dtype=np.float64)


def _speed_density(u: Array) -> Array:
    """Probability density of the mean of three harmonics of random phase: the cosine series of its characteristic
    function, a product of Bessel functions.
    """
    inside = np.abs(u) <= 1.0
    n = np.arange(1, 400)
    weights = j0(n * np.pi / _SPEEDS) ** _SPEEDS  # of a period of 2: the density is zero outside
    values = 0.5 + np.cos(np.pi * np.multiply.outer(u[inside], n)) @ weights
    density = np.zeros_like(u)
    density[inside] = np.maximum(values, 0.0)
    return density


# --- slams -----------------------------------------------------------------------------------------------------------


class _Blows:
    """The ringing after every blow so far, behind the low-pass: a sum of decaying exponentials for each."""

    def __init__(self, slams: Slams, rng: np.random.Generator, bandwidth_hz: float) -> None:
        self._slams = slams
        self._seed = int(rng.integers(2**32))
        self._times: dict[int, Array] = {}
        ringing, size = slams.pole, slams.size_mps2
        if math.isinf(bandwidth_hz):
            self._poles, self._residues = np.array([ringing]), np.array([size / 2j])
        else:  # partial fractions of blow times low-pass
            w = 2.0 * math.pi * bandwidth_hz
            own = w * complex(-BUTTERWORTH_DAMPING, math.sqrt(1.0 - BUTTERWORTH_DAMPING**2))
            through = w**2 / ((ringing - own) * (ringing - own.conjugate()))
            self._poles = np.array([ringing, own])
            at_own = complex(slams.transform(np.array(own)))
            self._residues = np.array([size / 2j * through, w**2 / (own - own.conjugate()) * at_own])
        self._rings_s = _QUIET / float(np.min(-self._poles.real))

    def force(self, t: Array) -> Array:
        """(3, n) along x, y, z, m/s2."""
        up = np.zeros(t.size)
        if t.size == 0:
            return np.zeros((3, 0))
        every = self._slams.every_s
        first, last = max(0, math.floor((np.min(t) - self._rings_s) / every)), math.floor(np.max(t) / every)
        for cell in range(first, last + 1):
            for blow_s in self._in_cell(cell).tolist():
                heard = (t >= blow_s) & (t < blow_s + self._rings_s)
                rung = np.exp(np.multiply.outer(t[heard] - blow_s, self._poles)) @ self._residues
                up[heard] += 2.0 * rung.real
        return np.array([[HORIZONTAL], [HORIZONTAL], [1.0]]) * up

    def _in_cell(self, cell: int) -> Array:
        """Times of the blows in the ``cell``-th mean distance from the start."""
        if cell not in self._times:
            rng, every = np.random.default_rng([self._seed, cell]), self._slams.every_s
            self._times[cell] = every * (cell + rng.random(rng.poisson(1.0)))
        return self._times[cell]


# --- true motion -----------------------------------------------------------------------------------------------------


def _turned(motion: Motion[Real], turn: Turn) -> Motion[Real]:
    begun, ended = turn.start_s, turn.end_s - turn.ease_s
    share = _eased(motion.t_s, begun, turn.ease_s)[0] - _eased(motion.t_s, ended, turn.ease_s)[0]
    turned_s = _eased(motion.t_s, begun, turn.ease_s)[2] - _eased(motion.t_s, ended, turn.ease_s)[2]
    rate_radps = turn.sideways_mps2 / turn.speed_mps  # to port, while heading counts clockwise
    return msgspec.structs.replace(
        motion,
        sway_acceleration_mps2=motion.sway_acceleration_mps2 + turn.sideways_mps2 * share,
        yaw_rad=motion.yaw_rad - rate_radps * turned_s,
        yaw_rate_radps=motion.yaw_rate_radps - rate_radps * share,
    )


def _listed(motion: Motion[Real], heel: List) -> Motion[Real]:
    share, rate, _ = _eased(motion.t_s, heel.start_s, heel.duration_s)
    return msgspec.structs.replace(
        motion,
        roll_rad=motion.roll_rad + heel.roll_rad * share,
        roll_rate_radps=motion.roll_rate_radps + heel.roll_rad * rate,
    )


def _eased(t_s: Real, start_s: float, duration_s: float) -> tuple[Real, Real, Real]:
    """A step from 0 to 1 that is twice differentiable (a quintic), its rate (1/s) and its integral (s)."""
    u = np.clip((t_s - start_s) / duration_s, 0.0, 1.0)
    value = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    rate = 30.0 * u**2 * (1.0 - u) ** 2 / duration_s
    integral = duration_s * u**4 * (2.5 - 3.0 * u + u**2) + np.maximum(t_s - start_s - duration_s, 0.0)
    return value, rate, integral
