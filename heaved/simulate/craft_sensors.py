"""The sensors of a craft on a voyage, read at any instants: heave, pitch, speed and flaps. Pure, seeded."""

from __future__ import annotations

import zlib

import numpy as np

from heaved.samples import CraftSample
from heaved.simulate.hydrofoil import CraftShake, CraftShaking, Voyage


class CraftSensors:
    """Reads a voyage, which starts over at its end: in between its samples it runs straight."""

    def __init__(
        self,
        voyage: Voyage,
        *,
        heave_noise_m: float,
        pitch_noise_rad: float,
        seed: int,
        name: str,
        shake: str | CraftShake = "",
    ) -> None:
        """Noise: white, per reading.

        Raises:
            ValueError: there is no shake of that name.
        """
        self._voyage = voyage
        self._noise = (heave_noise_m, pitch_noise_rad)
        self._shaking = CraftShaking(shake, seed, self._noise)
        self._rng = np.random.default_rng([seed, 6, zlib.crc32(name.encode())])

    def read(self, t_s: float) -> CraftSample:
        made = self._voyage
        at = t_s % float(made.t_s[-1])
        columns = (made.heave_m, made.pitch_rad, made.speed_mps, made.flap_fore_rad, made.flap_aft_rad)
        heave, pitch, speed, fore, aft = (float(np.interp(at, made.t_s, column)) for column in columns)
        read = np.array([[heave, pitch]]) + self._rng.standard_normal(2) * self._noise
        heave, pitch = self._shaking.readings(np.array([t_s]), read)[0].tolist()
        return CraftSample(
            t_s=t_s,
            heave_m=heave,
            pitch_rad=pitch,
            speed_mps=speed,
            flap_fore_rad=fore,
            flap_aft_rad=aft,
        )
