"""A crane at work: how its joints move, what its encoders say of it, where its tip and its hook are. Pure, seeded.

It rests, slews, luffs and hoists, one after the other and some at a time, and after some minutes comes back to where it
began and starts over, so that it is known at any instant. Each move is a smooth step (a quintic, at rest at both ends
in rate and acceleration).

The chain from the joints to the tip is a product of homogeneous matrices, and shares nothing with the estimator's.
"""

from __future__ import annotations

import math
import zlib
from bisect import bisect_right
from typing import Final

import msgspec
import numpy as np

from heaved.samples import CraneSample
from heaved.simulate.vessel import Array

_PEAK: Final = 1.875
"""Greatest rate of a quintic step over the mean one."""
JOINTS: Final = ("slew", "boom", "jib", "line")


class CraneModel(msgspec.Struct, frozen=True, kw_only=True):
    """What the crane does, in degrees and metres: slew, boom, jib, line out."""

    low: tuple[float, float, float, float] = (-110.0, 30.0, -40.0, 10.0)
    high: tuple[float, float, float, float] = (110.0, 75.0, 20.0, 60.0)
    """Between these each move ends anywhere."""
    fastest: tuple[float, float, float, float] = (3.0, 1.0, 1.0, 1.0)
    """Per second."""
    rest_s: tuple[float, float] = (5.0, 20.0)
    moves: int = 24
    """Before it starts over."""
    is_parked: bool = False
    """It stands where it begins."""


class Encoders(msgspec.Struct, frozen=True, kw_only=True):
    """What they make of it."""

    step_deg: float = 0.1
    step_m: float = 0.01
    noise_deg: float = 0.0
    noise_m: float = 0.0
    """White, before the steps."""
    turn_deg: float = 360.0
    """The slew encoder starts over."""


class Joints(msgspec.Struct, frozen=True):
    """True positions (4,), rates and accelerations of slew, boom, jib (rad) and line (m)."""

    at: Array
    rate: Array
    acceleration: Array


class CraneAtWork:
    """The true motion of the joints at any instant."""

    def __init__(self, model: CraneModel | None = None, *, seed: int = 1) -> None:
        self.model = made = model or CraneModel()
        rng = np.random.default_rng([seed, 7])
        low, high, fastest = (np.array(values) for values in (made.low, made.high, made.fastest))
        self._units = np.array([math.pi / 180.0] * 3 + [1.0])
        here = low + (high - low) * rng.random(4)
        start = here
        self._starts_s, self._moves = [], []
        t_s = 0.0
        for number in range(made.moves + 1):
            t_s += float(rng.uniform(*made.rest_s))
            there = start.copy()
            if number < made.moves:
                moving = rng.random(4) < 0.5
                moving[rng.integers(4)] = True
                there = np.where(moving, low + (high - low) * rng.random(4), here)
            length_s = max(1.0, float(np.max(_PEAK * np.abs(there - here) / fastest)))
            self._starts_s.append(t_s)
            self._moves.append((length_s, here, there))
            t_s, here = t_s + length_s, there
        self._period_s = t_s

    def at(self, t_s: float) -> Joints:
        """The joints at ``t_s``."""
        if self.model.is_parked:
            return Joints(self._units * self._moves[0][1], np.zeros(4), np.zeros(4))
        t_s %= self._period_s
        number = bisect_right(self._starts_s, t_s) - 1
        if number < 0:
            return Joints(self._units * self._moves[0][1], np.zeros(4), np.zeros(4))
        length_s, here, there = self._moves[number]
        s = min((t_s - self._starts_s[number]) / length_s, 1.0)
        way = self._units * (there - here)
        return Joints(
            self._units * here + way * (s**3 * (10.0 - 15.0 * s + 6.0 * s * s)),
            way * (30.0 * s * s * (1.0 - s) ** 2 / length_s),
            way * (60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / length_s**2),
        )


class CraneSensors:
    """Its encoders, read at any instants."""

    def __init__(
        self, crane: CraneAtWork, encoders: Encoders | None = None, *, seed: int = 1, name: str = "crane"
    ) -> None:
        self._crane, self._encoders = crane, encoders or Encoders()
        self._rng = np.random.default_rng([seed, 8, zlib.crc32(name.encode())])

    def read(self, t_s: float) -> CraneSample:
        """The reading at ``t_s``; slew from 0 to a full turn."""
        made = self._encoders
        degrees = np.degrees(self._crane.at(t_s).at[:3])
        noise = self._rng.standard_normal(4)
        slew, boom, jib = (np.round((degrees + made.noise_deg * noise[:3]) / made.step_deg) * made.step_deg).tolist()
        line = float(self._crane.at(t_s).at[3]) + made.noise_m * float(noise[3])
        return CraneSample(
            t_s=t_s,
            slew_rad=math.radians(slew % made.turn_deg),
            boom_rad=math.radians(boom),
            jib_rad=math.radians(jib),
            line_out_m=round(line / made.step_m) * made.step_m,
        )


# --- where that puts the tip ------------------------------------------------------------------------------------------


class CraneBuild(msgspec.Struct, frozen=True, kw_only=True):
    """How a crane is built, metres; names as in the configuration's ``[crane]``."""

    pedestal_m: tuple[float, float, float] = (20.0, -6.0, 8.0)
    heel_outward_m: float = 1.5
    heel_up_m: float = 2.0
    boom_length_m: float = 40.0
    jib_length_m: float = 12.0
    is_jib_against_boom: bool = False
    sheave_outward_m: float = 0.4
    sheave_up_m: float = 0.6
    falls: int = 2
    hook_below_m: float = 1.2


def tip_in_ship_axes(build: CraneBuild, joints: Array, offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Array:
    """(3,) forward, port, up from the IMU, of the place that much outward, left and up of the tip, by the chain
    pedestal, slew, heel, luff, boom, luff of the jib, jib, sheave. ``joints``: (4,) as of :class:`Joints`.
    """
    slew, boom, jib, _ = joints.tolist()
    knee = jib if build.is_jib_against_boom else jib - boom
    has_jib = build.jib_length_m > 0.0
    turntable = _moved(*build.pedestal_m) @ _turned(2, -slew)
    luffed = turntable @ _moved(build.heel_outward_m, 0.0, build.heel_up_m) @ _turned(1, -boom)
    head = luffed @ _moved(build.boom_length_m, 0.0, 0.0)
    if has_jib:
        head = head @ _turned(1, -knee) @ _moved(build.jib_length_m, 0.0, 0.0)
    sheave = head @ np.array([build.sheave_outward_m, 0.0, build.sheave_up_m, 1.0])
    return np.asarray(sheave[:3] + (turntable[:3, :3] @ np.array(offset_m)))


def height_m(build: CraneBuild, joints: Array, roll_rad: float, pitch_rad: float, *, hook: bool = False) -> float:
    """Height over the IMU of the tip, or of the hook plumb below it, with the ship at that attitude."""
    body = tip_in_ship_axes(build, joints)
    level = _turned(1, -pitch_rad)[:3, :3] @ _turned(0, roll_rad)[:3, :3] @ body
    hang_m = float(joints[3]) / build.falls + build.hook_below_m if hook else 0.0
    return float(level[2]) - hang_m


def _moved(x: float, y: float, z: float) -> Array:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def _turned(axis: int, angle_rad: float) -> Array:
    """By the right hand about x, y or z."""
    s, c = math.sin(angle_rad), math.cos(angle_rad)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(4)
    matrix[first, first] = matrix[second, second] = c
    matrix[second, first], matrix[first, second] = s, -s
    return matrix
