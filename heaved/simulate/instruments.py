"""Live sensors: read one instant at a time, at whatever instants a bus asks. Pure, seeded.

The errors are those of :mod:`heaved.simulate.sensors`, drawn reading by reading.
"""

from __future__ import annotations

import math
import zlib
from typing import TYPE_CHECKING

import numpy as np

from heaved.samples import CraftSample, Fault, ImuSample, LaserSample, Sample
from heaved.simulate.crane import CraneAtWork, CraneSensors
from heaved.simulate.gauge import AT_THE_IMU, Gauge
from heaved.simulate.gyro_shaking import GyroLine, GyroShake
from heaved.simulate.hydrofoil import CraftShake, CraftShaking, Passage, Voyage
from heaved.simulate.mru import MruModel, SimulatedMru
from heaved.simulate.second_imu import CraneBase, SecondImu
from heaved.simulate.sensors import (
    LASER_NOISE_M,
    REGISTER_STEPS,
    ImuModel,
    LaserPattern,
    imu_model,
    laser_pattern,
    leaning,
    mounted,
    reading_std,
)
from heaved.simulate.shaking import BUTTERWORTH_DAMPING, NONE, Line, Shake, Shaking, shake_of, shaking
from heaved.simulate.vessel import Array, Motion, MotionSource, Triad, body_rates, specific_force

if TYPE_CHECKING:
    from heaved.devices.profile import DeviceSpec


class Imu:
    """An IMU read at increasing instants, a poll at a time."""

    def __init__(
        self, sea: MotionSource, model: ImuModel, *, rate_hz: float, seed: int, name: str = "imu",
        shaken: Shaking | None = None,
    ) -> None:  # fmt: skip
        """``rate_hz`` is the nominal polling rate, which turns noise densities into the noise of a reading.

        The same ``seed`` and ``name`` give the same errors; they have nothing to do with the seed of the sea.
        ``shaken``: what adds to the readings; its turn and list are for ``sea`` to have.
        """
        self._sea, self._model, self._shaken = sea, model, shaken
        self._rng = np.random.default_rng([seed, 1, zlib.crc32(name.encode())])
        self._bias = model.bias_mps2 * self._rng.choice([-1.0, 1.0], 3)
        self._std = reading_std(model, rate_hz)
        self._low_pass = LowPass(model.bandwidth_hz) if math.isfinite(model.bandwidth_hz) else None
        self._attitude = Attitude(sea, model.attitude_lean_s, model.attitude_late_s)
        self._t_s: float | None = None

    def read(self, t_s: float) -> ImuSample:
        """The reading at ``t_s``.

        Raises:
            ValueError: ``t_s`` lies before the reading before.
        """
        elapsed = 0.0 if self._t_s is None else t_s - self._t_s
        if elapsed < 0.0:
            raise ValueError(f"IMU read at {t_s} s after a reading at {self._t_s} s: time must not run backwards")
        self._t_s = t_s
        model, motion = self._model, self._sea.at(t_s)
        noise = self._rng.standard_normal(12)
        self._bias += model.bias_walk_mps2_rts * math.sqrt(elapsed) * noise[9:]
        force = _vector(mounted(specific_force(motion), model.mounting_roll_rad)) * model.scale
        if self._low_pass is not None:
            force = self._low_pass.step(force, elapsed)
        rates = _vector(mounted(body_rates(motion), model.mounting_roll_rad))
        angles = self._attitude.at(t_s)
        values = np.concatenate([force + self._bias, angles, rates]) + self._std * noise[:9]
        if self._shaken is not None:
            values += self._shaken.readings(np.array([t_s]))[:, 0]
        if model.sixteen_bit:
            values = np.round(values / REGISTER_STEPS) * REGISTER_STEPS
        ax, ay, az, roll, pitch, yaw, gx, gy, gz = values.tolist()
        return ImuSample(
            t_s=t_s, ax_mps2=ax, ay_mps2=ay, az_mps2=az, roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw,
            gx_radps=gx, gy_radps=gy, gz_radps=gz,
        )  # fmt: skip


class Attitude:
    """Roll, pitch and yaw as a complementary filter of the IMU shows them, at increasing instants; exact for an
    apparent vertical that runs straight between them.
    """

    def __init__(self, sea: MotionSource, lean_s: float, late_s: float) -> None:
        self._sea, self._lean_s, self._late_s = sea, lean_s, late_s
        self._t_s: float | None = None
        self._off = self._lean = np.zeros(2)

    def at(self, t_s: float) -> Array:
        """(3,) what it shows at ``t_s``."""
        shown = self._sea.at(t_s - self._late_s)
        angles = np.array([shown.roll_rad, shown.pitch_rad, shown.yaw_rad])
        if math.isfinite(self._lean_s):
            off = np.array(leaning(shown))
            if self._t_s is not None and t_s > self._t_s:
                # The filter is that far behind a steadily growing lean; what it is off that dies out.
                behind = self._lean_s * (off - self._off) / (t_s - self._t_s)
                left = math.exp((self._t_s - t_s) / self._lean_s)
                self._lean = off - behind + left * (self._lean - self._off + behind)
            self._t_s, self._off = t_s, off
            angles[:2] += self._lean
        return angles


class Laser:
    """A laser gauge, read at any instants."""

    def __init__(
        self, sea: MotionSource, pattern: LaserPattern, *, seed: int, name: str = "laser", gauge: Gauge = AT_THE_IMU
    ) -> None:
        self._sea, self._pattern, self._gauge = sea, pattern, gauge
        self._rng = np.random.default_rng([seed, 2, zlib.crc32(name.encode())])

    def read(self, t_s: float) -> LaserSample:
        """The reading at ``t_s``; without an echo it is nan, and the device refuses the request."""
        noise = LASER_NOISE_M * float(self._rng.standard_normal())
        distance_m = self._gauge.read(self._sea.at(t_s)) if self._pattern.on(t_s) else math.nan
        if math.isnan(distance_m):
            return LaserSample(t_s=t_s, fault=Fault.EXCEPTION)
        return LaserSample(t_s=t_s, laser_m=distance_m + noise)


class Moved:
    """A sea with the turn and the list of a shake in it: what the vessel really does."""

    def __init__(self, sea: MotionSource, shaken: Shaking) -> None:
        self._sea, self._shaken = sea, shaken

    def at(self, t_s: float) -> Motion[float]:
        """The true motion at ``t_s``."""
        return self._shaken.moved(self._sea.at(t_s))


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
        """The reading at ``t_s``."""
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


class Instruments:
    """All sensors of one vessel in one sea, told apart by the name of their device: a source for simulated slaves."""

    def __init__(
        self, sea: MotionSource, *, sensor: str | ImuModel = "A", laser: str = "on", shake: str | Shake = NONE,
        seed: int = 1, base: CraneBase | None = None, voyage: Voyage | None = None, crane: CraneAtWork | None = None,
        mru: MruModel | None = None, gauge: Gauge = AT_THE_IMU,
    ) -> None:  # fmt: skip
        """``base``: of a second IMU. ``voyage``: of a craft, whose sensors share no sea with the others. ``crane``: by
        default one at work. ``mru``: an existing motion reference unit at the IMU. ``gauge``: where the laser is.

        Raises:
            ValueError: unknown ``sensor`` (:data:`SENSORS`), ``laser`` pattern (:func:`laser_pattern`) or ``shake``
                (:data:`~heaved.simulate.shaking.SHAKES`).
        """
        self._model, self._pattern, self._seed = imu_model(sensor), laser_pattern(laser), seed
        self._shaken = shaking(shake, seed, self._model.bandwidth_hz)
        self._sea = Moved(sea, self._shaken)
        self._imus: dict[str, Imu] = {}
        self._lasers: dict[str, Laser] = {}
        self._base, self._voyage, self._gauge = base or CraneBase(), voyage, gauge
        self._second: dict[str, SecondImu] = {}
        lines = [part for part in shake_of(shake).vibration if isinstance(part, Line) and part.rate_radps > 0.0]
        self._crane_shake = GyroShake(
            vibration=tuple(
                GyroLine(hz=line.hz, midships_radps=line.rate_radps, local_radps=line.rate_radps) for line in lines
            )
        )
        """What turns the feet of the IMU amidships turns those at the crane base as much."""
        self._craft: dict[str, CraftSensors] = {}
        self.crane = crane or CraneAtWork(seed=seed)
        self._encoders: dict[str, CraneSensors] = {}
        self._mru, self._mrus = mru or MruModel(), dict[str, SimulatedMru]()

    def read(self, device: DeviceSpec, t_s: float) -> Sample:
        """What ``device`` measures at ``t_s``, seconds from the start of the simulation."""
        if device.role == "laser":
            if device.name not in self._lasers:
                self._lasers[device.name] = Laser(
                    self._sea, self._pattern, seed=self._seed, name=device.name, gauge=self._gauge
                )
            return self._lasers[device.name].read(t_s)
        if device.role == "imu2":
            return self.second_imu(device).read(t_s)
        if device.role == "crane":
            if device.name not in self._encoders:
                self._encoders[device.name] = CraneSensors(self.crane, seed=self._seed, name=device.name)
            return self._encoders[device.name].read(t_s)
        if device.role == "reference_mru":
            if device.name not in self._mrus:
                self._mrus[device.name] = SimulatedMru(self._sea, self._mru, seed=self._seed, name=device.name)
            return self._mrus[device.name].read(t_s)
        if device.role != "imu":
            return self._craft_sensors(device).read(t_s) if self._voyage else CraftSample(t_s=t_s)
        if device.name not in self._imus:
            self._imus[device.name] = Imu(
                self._sea, self._model, rate_hz=device.rate_hz, seed=self._seed, name=device.name, shaken=self._shaken
            )
        return self._imus[device.name].read(t_s)

    def second_imu(self, device: DeviceSpec) -> SecondImu:
        """The IMU at the crane base, which knows the true deformation."""
        if device.name not in self._second:
            self._second[device.name] = SecondImu(
                self._sea,
                self._model,
                self._base,
                rate_hz=device.rate_hz,
                seed=self._seed,
                name=device.name,
                shake=self._crane_shake,
            )
        return self._second[device.name]

    def _craft_sensors(self, device: DeviceSpec) -> CraftSensors:
        assert self._voyage is not None
        if device.name not in self._craft:
            usual = Passage()
            self._craft[device.name] = CraftSensors(
                self._voyage,
                heave_noise_m=usual.heave_noise_m,
                pitch_noise_rad=usual.pitch_noise_rad,
                seed=self._seed,
                name=device.name,
            )
        return self._craft[device.name]


class LowPass:
    """Second-order Butterworth low-pass of three channels, exact for an input that runs straight between readings."""

    def __init__(self, corner_hz: float) -> None:
        self._w = 2.0 * math.pi * corner_hz
        self._input: Array | None = None
        # Distance of the output from the steady answer to the present ramp, and that distance's rate; each (3,).
        self._output = np.zeros(3)
        self._output_rate = np.zeros(3)

    def step(self, value: Array, elapsed_s: float) -> Array:
        """Output after the input went to ``value`` (3,) in ``elapsed_s``; starts in the steady state of the first."""
        if self._input is None:
            self._input, self._output = value, value
        elif elapsed_s > 0.0:
            slope = (value - self._input) / elapsed_s
            lag = 2.0 * BUTTERWORTH_DAMPING / self._w * slope  # a ramp is followed at this distance
            error, rate = self._output - (self._input - lag), self._output_rate - slope
            damped = self._w * BUTTERWORTH_DAMPING  # decay and ringing coincide at this damping
            c, s = math.cos(damped * elapsed_s), math.sin(damped * elapsed_s)
            decay = math.exp(-damped * elapsed_s)
            mixed = (rate + damped * error) / damped
            self._output = value - lag + decay * (c * error + s * mixed)
            self._output_rate = slope + decay * damped * (c * (mixed - error) - s * (error + mixed))
            self._input = value
        return self._output


def _vector(triad: Triad[float]) -> Array:
    return np.array([triad.x, triad.y, triad.z])
