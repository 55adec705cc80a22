"""Sensors with their errors: what an IMU and a laser gauge make of the true motion. Pure, seeded.

:func:`record` and :func:`measure` make a whole recording at once. Sensors that a bus asks one instant at a time, with
the same errors, are in :mod:`heaved.simulate.instruments`.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import cont2discrete, lfilter, lfilter_zi

from heaved.samples import GRAVITY_MPS2, ImuSample, LaserSample, Sample
from heaved.simulate.gauge import AT_THE_IMU, Gauge
from heaved.simulate.shaking import BUTTERWORTH_DAMPING, NONE, Shake, shaking
from heaved.simulate.vessel import Array, Motion, Real, Triad, body_rates, specific_force

if TYPE_CHECKING:
    from collections.abc import Iterator

    from heaved.simulate.seaway import Seaway

LASER_NOISE_M = 0.002

REGISTER_STEPS = np.repeat([16.0 * GRAVITY_MPS2, math.pi, math.radians(2000.0)], 3) / 32768
"""(9,) What one bit is worth in forces, angles and rates when 16-bit registers span +-16 g, 180 deg, 2000 deg/s."""


class ImuModel(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of an IMU with attitude output, in the order in which they arise."""

    noise_mps2_rthz: float = 0.0
    """One-sided white noise density of each accelerometer, m/s2/sqrt(Hz)."""
    bias_mps2: float = 0.0
    """Size of each accelerometer's bias at the start; its signs are drawn."""
    bias_walk_mps2_rts: float = 0.0
    """Random walk of the bias, m/s2/sqrt(s)."""
    scale: float = 1.0
    """Reading per true specific force."""
    bandwidth_hz: float = math.inf
    """Corner of the accelerometers' second-order Butterworth low-pass; the noise above is added behind it."""
    mounting_roll_rad: float = 0.0
    """The inertial triads are rolled by this against the frame in which the attitude is given."""
    attitude_lean_s: float = math.inf
    """Time constant with which roll and pitch follow the apparent vertical, that of the true specific force; above it
    they follow the gyroscopes, and so they lean into horizontal acceleration. Infinite: they do not."""
    attitude_late_s: float = 0.0
    """Roll, pitch and yaw are those of so much earlier than the forces and the rates."""
    attitude_noise_rad: float = 0.0
    """White, per reading, on roll, pitch and yaw alike."""
    gyro_noise_radps_rthz: float = 0.0
    """One-sided white noise density of each gyroscope, rad/s/sqrt(Hz)."""
    sixteen_bit: bool = False
    """Values come from 16-bit registers of +-16 g, +-180 degrees, +-2000 degrees/s."""


SENSORS: dict[str, ImuModel] = {
    "A": ImuModel(
        noise_mps2_rthz=1e-3,
        bias_mps2=0.03,
        bias_walk_mps2_rts=2e-5,
        attitude_noise_rad=math.radians(0.02),
        gyro_noise_radps_rthz=5e-5,
    ),
    "B": ImuModel(
        noise_mps2_rthz=2e-3,
        bias_mps2=0.05,
        bias_walk_mps2_rts=1e-4,
        scale=1.02,
        bandwidth_hz=2.0,
        mounting_roll_rad=math.radians(1.0),
        attitude_noise_rad=math.radians(0.02),
        gyro_noise_radps_rthz=2e-4,
        sixteen_bit=True,
    ),
    "C": ImuModel(
        noise_mps2_rthz=4e-3,
        bias_mps2=0.03,
        bias_walk_mps2_rts=2e-4,
        attitude_noise_rad=math.radians(0.1),
        gyro_noise_radps_rthz=5e-5,
    ),
    "AHRS": ImuModel(
        noise_mps2_rthz=1e-3,
        bias_mps2=0.03,
        bias_walk_mps2_rts=2e-5,
        attitude_lean_s=8.0,
        attitude_late_s=0.04,
        attitude_noise_rad=math.radians(0.02),
        gyro_noise_radps_rthz=5e-5,
    ),
    "ideal": ImuModel(),
}
"""A: tactical MEMS. B: industrial MEMS, slow and a little crooked. C: consumer MEMS, noisy, its bias wanders. AHRS: A
with an attitude that is not known from elsewhere but by a complementary filter of its own. ideal: the truth, to test
against."""


def imu_model(name: str | ImuModel) -> ImuModel:
    """The model of :data:`SENSORS` by name; a model stays what it is.

    Raises:
        ValueError: there is no such sensor.
    """
    if isinstance(name, ImuModel):
        return name
    if name not in SENSORS:
        raise ValueError(f"unknown sensor {name!r}: choose one of {', '.join(SENSORS)}")
    return SENSORS[name]


class LaserPattern(msgspec.Struct, frozen=True, kw_only=True):
    """When the laser sees its target: in blocks ``on_s`` long with ``off_s`` between them, and not in an outage."""

    on_s: float = math.inf
    off_s: float = 0.0
    outages: tuple[tuple[float, float], ...] = ()
    """(start, duration), s."""

    def on(self, t_s: float) -> bool:
        """Whether a reading at ``t_s`` (seconds from the start of the simulation) returns a distance."""
        block = self.off_s == 0.0 or (self.on_s > 0.0 and t_s % (self.on_s + self.off_s) < self.on_s)
        return block and not any(start <= t_s < start + length for start, length in self.outages)


def laser_pattern(text: str) -> LaserPattern:
    """Read a pattern: ``on``, ``off``, ``50%`` (that share of the time, 60 s at a stretch) or ``300+120,900+30``
    (outages: start and length in seconds).

    Raises:
        ValueError: the text is none of these.
    """
    if text == "on":
        return LaserPattern()
    if text == "off":
        return LaserPattern(on_s=0.0, off_s=math.inf)
    if share := re.fullmatch(r"(\d+(?:\.\d+)?)%", text):
        percent = float(share[1])
        if 0.0 < percent <= 100.0:
            return LaserPattern(on_s=60.0, off_s=60.0 * (100.0 / percent - 1.0))
    number = r"\d+(?:\.\d+)?"
    if re.fullmatch(rf"{number}\+{number}(?:,{number}\+{number})*", text):
        pairs = (outage.split("+") for outage in text.split(","))
        return LaserPattern(outages=tuple((float(start), float(length)) for start, length in pairs))
    raise ValueError(
        f"laser pattern {text!r} is not understood: write 'on', 'off', a share such as '50%', "
        "or outages as START+LENGTH in seconds, such as '300+120,900+30'"
    )


class Recording(msgspec.Struct, frozen=True, kw_only=True):
    """Readings at common instants ``t_s`` (n,) with the truth beside them; every array (n,), nan where missing."""

    t_s: Array
    ax_mps2: Array
    ay_mps2: Array
    az_mps2: Array
    roll_rad: Array
    pitch_rad: Array
    yaw_rad: Array
    gx_radps: Array
    gy_radps: Array
    gz_radps: Array
    laser_m: Array
    truth: Motion[Array]

    def samples(self) -> Iterator[Sample]:
        """The readings in time order: an IMU sample per row, then the laser's where it has one."""
        imu = (self.ax_mps2, self.ay_mps2, self.az_mps2, self.roll_rad, self.pitch_rad, self.yaw_rad)
        rates = (self.gx_radps, self.gy_radps, self.gz_radps)
        for t, laser, ax, ay, az, roll, pitch, yaw, gx, gy, gz in zip(
            *(column.tolist() for column in (self.t_s, self.laser_m, *imu, *rates)), strict=True
        ):
            yield ImuSample(
                t_s=t, ax_mps2=ax, ay_mps2=ay, az_mps2=az, roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw,
                gx_radps=gx, gy_radps=gy, gz_radps=gz,
            )  # fmt: skip
            if not math.isnan(laser):
                yield LaserSample(t_s=t, laser_m=laser)


def record(
    sea: Seaway,
    duration_s: float,
    *,
    imu_rate_hz: float = 20.0,
    laser_rate_hz: float = 20.0,
    sensor: str | ImuModel = "A",
    laser: str = "on",
    gauge: Gauge = AT_THE_IMU,
    shake: str | Shake = NONE,
    seed: int = 1,
) -> Recording:
    """Record a sea from 0 to ``duration_s``. Parameters and ``Raises`` as :func:`measure`."""
    t = np.arange(round(duration_s * imu_rate_hz)) / imu_rate_hz
    return measure(
        sea.motion(t), imu_rate_hz=imu_rate_hz, laser_rate_hz=laser_rate_hz, sensor=sensor, laser=laser, gauge=gauge,
        shake=shake, seed=seed,
    )  # fmt: skip


def measure(
    truth: Motion[Array],
    *,
    imu_rate_hz: float,
    laser_rate_hz: float = 20.0,
    sensor: str | ImuModel = "A",
    laser: str = "on",
    gauge: Gauge = AT_THE_IMU,
    shake: str | Shake = NONE,
    seed: int = 1,
) -> Recording:
    """Put a sensor's errors on a true motion given at ``imu_rate_hz``, and what shakes it.

    ``sensor`` is a model, or names one of :data:`SENSORS`; ``laser`` is a pattern of :func:`laser_pattern`, counted
    from the first instant; ``gauge`` is where it is. The laser is read at those IMU instants that are the first at or
    after its own ticks, so that every reading is exactly as old as its row says. ``shake`` is one, or names one of
    :data:`~heaved.simulate.shaking.SHAKES`, happens at the instants that it says, and what of it is true motion is in
    the recording's truth. ``seed`` draws the errors and the vibration alone.

    Raises:
        ValueError: unknown sensor, pattern or shake.
    """
    model, pattern = imu_model(sensor), laser_pattern(laser)
    shaken = shaking(shake, seed, model.bandwidth_hz)
    truth = shaken.moved(truth)
    imu_rng, laser_rng = np.random.default_rng([seed, 1]), np.random.default_rng([seed, 2])
    n = truth.t_s.size
    bias = model.bias_mps2 * imu_rng.choice([-1.0, 1.0], (3, 1))
    walk = model.bias_walk_mps2_rts / math.sqrt(imu_rate_hz) * np.cumsum(imu_rng.standard_normal((3, n)), axis=1)
    force = _matrix(mounted(specific_force(truth), model.mounting_roll_rad)) * model.scale
    if math.isfinite(model.bandwidth_hz):
        force = _low_passed(force, model.bandwidth_hz, imu_rate_hz)
    rates = _matrix(mounted(body_rates(truth), model.mounting_roll_rad))
    angles = shown_angles(truth, model.attitude_lean_s, model.attitude_late_s)
    noise = reading_std(model, imu_rate_hz)[:, None] * imu_rng.standard_normal((9, n))
    values = np.concatenate([force + bias + walk, angles, rates]) + shaken.readings(truth.t_s) + noise
    if model.sixteen_bit:
        values = np.round(values / REGISTER_STEPS[:, None]) * REGISTER_STEPS[:, None]
    distance = np.full(n, np.nan)
    since_start = truth.t_s - truth.t_s[:1]
    ticks = np.floor(since_start * laser_rate_hz + 1e-6)
    due = np.diff(ticks, prepend=-1.0) > 0
    seen = due & np.array([pattern.on(t) for t in since_start.tolist()], dtype=bool)
    reading = gauge.read(truth) + LASER_NOISE_M * laser_rng.standard_normal(n)
    distance[seen] = reading[seen]
    ax, ay, az, roll, pitch, yaw, gx, gy, gz = values
    return Recording(
        t_s=truth.t_s, ax_mps2=ax, ay_mps2=ay, az_mps2=az, roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw,
        gx_radps=gx, gy_radps=gy, gz_radps=gz, laser_m=distance, truth=truth,
    )  # fmt: skip


def reading_std(model: ImuModel, rate_hz: float) -> Array:
    """Standard deviation (9,) of the white noise of one reading: force, angles, rates.

    White noise of one-sided density N read at a rate f fills the band up to f / 2, hence N sqrt(f / 2).
    """
    band = math.sqrt(rate_hz / 2.0)
    std = [model.noise_mps2_rthz * band, model.attitude_noise_rad, model.gyro_noise_radps_rthz * band]
    return np.repeat(std, 3)


def mounted(true: Triad[Real], roll_rad: float) -> Triad[Real]:
    """A body vector as read by a triad rolled by ``roll_rad`` about x."""
    c, s = math.cos(roll_rad), math.sin(roll_rad)
    return Triad(x=true.x, y=c * true.y + s * true.z, z=c * true.z - s * true.y)


def leaning(truth: Motion[Real]) -> tuple[Real, Real]:
    """How far the apparent vertical, along the specific force, is off the true one: in roll and in pitch, rad."""
    force = specific_force(truth)
    return (
        np.arctan2(force.y, force.z) - truth.roll_rad,
        np.arctan2(force.x, np.hypot(force.y, force.z)) - truth.pitch_rad,
    )


def shown_angles(truth: Motion[Array], lean_s: float, late_s: float) -> Array:
    """Roll, pitch and yaw (3, n) as a complementary filter of time constant ``lean_s`` shows them ``late_s`` later: the
    true ones, and what has come into them of the apparent vertical. At the start nothing has; before it, all moved
    evenly.
    """
    angles = np.array([truth.roll_rad, truth.pitch_rad, truth.yaw_rad])
    rates = np.array([truth.roll_rate_radps, truth.pitch_rate_radps, truth.yaw_rate_radps])
    t_s, shown_s = truth.t_s, truth.t_s - late_s
    if late_s > 0.0:
        between = CubicHermiteSpline(t_s, angles, rates, axis=1)(shown_s)
        angles = np.where(shown_s < t_s[0], angles[:, :1] + rates[:, :1] * (shown_s - t_s[0]), between)
    if math.isfinite(lean_s):
        analogue = (np.array([1.0]), np.array([lean_s, 1.0]))
        found, denominator, _ = cont2discrete(analogue, float(np.mean(np.diff(t_s))), method="foh")
        numerator = found.ravel()
        for axis, off in enumerate(leaning(truth)):
            lean, _ = lfilter(numerator, denominator, off, zi=-numerator[:1] * off[:1])
            angles[axis] += np.interp(shown_s, t_s, lean)
    return np.asarray(angles, dtype=np.float64)


def _matrix(triad: Triad[Array]) -> Array:
    return np.array([triad.x, triad.y, triad.z])


def _low_passed(values: Array, corner_hz: float, rate_hz: float) -> Array:
    """Low-pass series (3, n) at an even rate, from the steady state of the first; exact for straight-line inputs."""
    w = 2.0 * math.pi * corner_hz
    analogue = (np.array([w**2]), np.array([1.0, 2.0 * BUTTERWORTH_DAMPING * w, w**2]))
    numerator, denominator, _ = cont2discrete(analogue, 1.0 / rate_hz, method="foh")
    steady = lfilter_zi(numerator.ravel(), denominator)
    filtered, _ = lfilter(numerator.ravel(), denominator, values, axis=1, zi=steady * values[:, :1])
    return np.asarray(filtered, dtype=np.float64)
