"""A simulated motion reference unit: the true motion with what a real one makes of it. Pure, seeded.

Its heave has passed a high-pass, as the double integral of any MRU has: two poles at one period, which lead where the
waves are long. What it says is of some moment ago, and has noise.
"""

from __future__ import annotations

import math
import zlib
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

from heaved.samples import MruSample

if TYPE_CHECKING:
    from heaved.simulate.vessel import MotionSource

STEP_S: Final = 0.05
"""Of the high-pass: a hundred and more to a wave."""
SETTLED_PERIODS: Final = 1.0
"""Of the high-pass, before the first reading: its poles have fallen to exp(-2 pi) by then."""


class MruModel(msgspec.Struct, frozen=True, kw_only=True):
    """What a real one makes of the motion."""

    delay_s: float = 0.15
    """What it says is of so long ago."""
    noise_m: float = 0.01
    noise_deg: float = 0.02
    highpass_s: float = 100.0
    """Period of the high-pass of its heave; 0: none."""


_KEYS: Final = {"delay": "delay_s", "noise": "noise_m", "angle_noise": "noise_deg", "highpass": "highpass_s"}


def parse_mru(text: str) -> MruModel:
    """``delay=0.3,noise=0.02,angle_noise=0.05,highpass=60``, any of them: seconds, metres, degrees, seconds.

    Raises:
        ValueError: it is not so; says what is.
    """
    changed: dict[str, float] = {}
    for part in filter(None, text.split(",")):
        key, _, number = part.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if key.strip() not in _KEYS or not 0.0 <= value <= 1e4:
            raise ValueError(f"{part!r} is nothing of an MRU: give {', '.join(_KEYS)}, each =NUMBER from 0 on")
        changed[_KEYS[key.strip()]] = value
    return msgspec.structs.replace(MruModel(), **changed)


class SimulatedMru:
    """Read at increasing instants."""

    def __init__(self, sea: MotionSource, model: MruModel, *, seed: int, name: str = "mru") -> None:
        """The same ``seed`` and ``name`` give the same noise."""
        self._sea, self._model = sea, model
        self._rng = np.random.default_rng([seed, 7, zlib.crc32(name.encode())])
        self._k: int | None = None
        """Steps that the high-pass has taken."""
        self._heave = (0.0, 0.0, 0.0)
        """Input of the last step, what the first pole makes of it, what the second makes of that."""
        self._before_m = 0.0

    def read(self, t_s: float) -> MruSample:
        """What it says at ``t_s``."""
        model, at_s = self._model, t_s - self._model.delay_s
        truth = self._sea.at(at_s)
        noise_m, *noise = self._rng.standard_normal(4)
        noise_rad = [math.radians(model.noise_deg) * one for one in noise]
        heave_m = self._passed(at_s) if model.highpass_s > 0.0 else truth.heave_m
        velocity_mps = self._slope() if model.highpass_s > 0.0 else truth.heave_velocity_mps
        return MruSample(
            t_s=t_s,
            heave_m=heave_m + model.noise_m * float(noise_m),
            heave_velocity_mps=velocity_mps,
            roll_rad=truth.roll_rad + noise_rad[0],
            pitch_rad=truth.pitch_rad + noise_rad[1],
            yaw_rad=truth.yaw_rad + noise_rad[2],
        )

    def _passed(self, t_s: float) -> float:
        """The heave of ``t_s`` behind the high-pass."""
        k = math.floor(t_s / STEP_S) + 1
        if self._k is None:
            self._k = k - math.ceil(SETTLED_PERIODS * self._model.highpass_s / STEP_S)
            self._heave = (float(self._sea.at(self._k * STEP_S).heave_m), 0.0, 0.0)
        while self._k < k:
            self._k += 1
            self._before_m = self._heave[2]
            self._step(float(self._sea.at(self._k * STEP_S).heave_m))
        share = t_s / STEP_S - (self._k - 1)
        return self._before_m + share * (self._heave[2] - self._before_m)

    def _step(self, heave_m: float) -> None:
        """Each pole by the bilinear transform."""
        ratio = self._model.highpass_s / (math.pi * STEP_S)  # 2 tau / step, tau = period / 2 pi
        kept, gain = (ratio - 1.0) / (ratio + 1.0), ratio / (ratio + 1.0)
        last, once, twice = self._heave
        first = kept * once + gain * (heave_m - last)
        self._heave = (heave_m, first, kept * twice + gain * (first - once))

    def _slope(self) -> float:
        return (self._heave[2] - self._before_m) / STEP_S
