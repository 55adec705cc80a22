"""Two IMUs on a hull that bends: what each of them reads, and the truth. Pure, seeded.

Seed conditions are those of Xu, Wang & Shan 2017 (hull deformation by CKF), section 3: roll, pitch and yaw of 4, 2 and
3 degrees at 8, 6 and 10 s, gyro bias 0.005 deg/h, random drift 0.01 deg/h, 10 Hz, 600 s, static deformation 0.5, 0.8
and 30 degrees, flexure at 0.16 Hz. The paper does not state the two numbers that decide its result, the standard
deviation and the damping of the flexure; they stand in every :class:`Scene` here. Phases and signs are drawn.

Frames: body axes x forward, y port, z up; rates right-handed. The local IMU reads in its own frame,
``C(t) = C0 exp(-[theta(t) x])`` from midships, C0 the static deformation with the mounting (passive rotations
R3 R2 R1), theta the flexure about the hull's axes.
"""

from __future__ import annotations

import math
from typing import Literal

import msgspec
import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from heaved.simulate.gyro_shaking import GyroShake, GyroShaking
from heaved.simulate.vessel import Array, Motion, body_rates

ARCSEC_RAD = math.radians(1.0 / 3600.0)
DEG_H_RADPS = math.radians(1.0) / 3600.0
EARTH_RADPS = 7.292115e-5
EARTH_RADIUS_M = 6.371e6
BAND_HZ = (0.07, 0.20)
"""Of the irregular sea."""
COMPONENTS = 48
"""Harmonic waves per axis in it, one per cell of equal width: nothing repeats within hours."""


class Scene(msgspec.Struct, frozen=True, kw_only=True):
    """Motion, flexure, mounting and errors of the two IMUs."""

    name: str
    sea: Literal["tones", "irregular", "still"] = "tones"
    """tones: one harmonic per axis. irregular: all axes in one band, Gaussian, same RMS. still: the Earth alone."""
    amplitudes_deg: tuple[float, float, float] = (4.0, 2.0, 3.0)
    """Roll, pitch, yaw; of the tones."""
    periods_s: tuple[float, float, float] = (8.0, 6.0, 10.0)
    flexure_std_arcsec: float = 3.0
    flexure_mu_radps: float = 0.1
    flexure_hz: float = 0.16
    """lambda / 2 pi."""
    static_deg: tuple[float, float, float] = (0.5, 0.8, 30.0)
    """x, y, z of C0 = R3(z) R2(y) R1(x)."""
    random_mount: bool = False
    """C0 is drawn evenly from all rotations instead."""
    bias_deg_h: float = 0.005
    """Of each gyro; the sign is drawn."""
    noise_deg_h: float = 0.01
    """White, per reading, of each gyro."""
    angle_random_walk_deg_rth: float = 0.0
    """Of each gyro; the noise of a reading then depends on the reading rate."""
    scale_ppm: float = 0.0
    """Standard deviation of the scale error of each local gyro."""
    midships_scale_ppm: float = 0.0
    delay_s: float = 0.0
    """A local reading stamped t was taken at t - delay_s."""
    clock_ppm: float = 0.0
    """The local clock gains this much."""
    shake: str | GyroShake = ""
    """What shakes the gyros, by itself or by its name in ``GYRO_SHAKES``, and what is wrong with their readings; "":
    nothing."""
    latitude_deg: float = 45.7796
    speed_mps: float = 10.0
    """Towards north."""
    heading_deg: float = 0.0


SCENES: dict[str, Scene] = {
    "A1": Scene(name="A1"),
    "A2": Scene(name="A2", flexure_std_arcsec=5.0),
    "A3 heading": Scene(name="A3 heading", flexure_std_arcsec=5.0, static_deg=(0.5, 0.8, 180.0)),
    "A3 pitch": Scene(name="A3 pitch", flexure_std_arcsec=5.0, static_deg=(0.5, 90.0, 30.0)),
    "A3 random": Scene(name="A3 random", flexure_std_arcsec=5.0, random_mount=True),
    "A4": Scene(
        name="A4",
        sea="irregular",
        flexure_std_arcsec=5.0,
        delay_s=0.005,
        scale_ppm=30.0,
        angle_random_walk_deg_rth=0.003,
    ),
}


class Record(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """Readings and truth. Midships at ``midships_t_s`` (n,), local at its stamps ``local_t_s`` (m,)."""

    scene: Scene
    seed: int
    midships_t_s: Array
    midships_radps: Array
    """(n, 3); nan: lost."""
    local_t_s: Array
    local_radps: Array
    """(m, 3)"""
    static: Array
    """(3, 3) C0, local from midships."""
    flexure_rad: Array
    """(n, 3) theta at ``midships_t_s``, about the hull's axes."""

    def deformation(self) -> Array:
        """(n, 3, 3) true C at ``midships_t_s``."""
        return np.asarray(self.static @ Rotation.from_rotvec(-self.flexure_rad).as_matrix())


def simulate(
    scene: Scene,
    seed: int,
    midships_t_s: Array | None = None,
    local_t_s: Array | None = None,
    duration_s: float = 600.0,
) -> Record:
    """Readings at increasing stamps (n,), (m,); default: both at 10 Hz from 0.1 s to ``duration_s``.

    The same seed draws the same motion, flexure and mounting whatever the stamps are, the flexure as far as the union
    of the instants is the same.
    """
    regular = np.arange(1, round(10.0 * duration_s) + 1) / 10.0
    t1 = regular if midships_t_s is None else np.asarray(midships_t_s, dtype=np.float64)
    stamps = regular if local_t_s is None else np.asarray(local_t_s, dtype=np.float64)
    t2 = stamps * (1.0 - 1e-6 * scene.clock_ppm) - scene.delay_s
    motion_rng, flexure_rng, noise_rng = (np.random.default_rng([seed, k]) for k in range(3))
    waves = _waves(scene, motion_rng)
    static = static_rotation(scene.static_deg)
    if scene.random_mount:
        static = Rotation.from_quat(motion_rng.standard_normal(4)).as_matrix()  # even over all rotations
    instants, where = np.unique(np.concatenate([t1, t2]), return_inverse=True)
    theta, theta_rate = _flexure(scene, instants, flexure_rng)
    at1, at2 = where[: len(t1)], where[len(t1) :]
    midships = _hull_rates(scene, waves, t1)
    bent = _hull_rates(scene, waves, t2)
    bent = local_rates(bent, theta[at2], theta_rate[at2])
    shaking = [GyroShaking(scene.shake, seed, local=local) for local in (False, True)]
    return Record(
        scene=scene,
        seed=seed,
        midships_t_s=t1,
        midships_radps=shaking[0].readings(t1, _read(scene, midships, scene.midships_scale_ppm, t1, noise_rng)),
        local_t_s=stamps,
        local_radps=shaking[1].readings(t2, _read(scene, bent @ static.T, scene.scale_ppm, stamps, noise_rng)),
        static=static,
        flexure_rad=theta[at1],
    )


def local_rates(hull_radps: Array, theta: Array, theta_rate: Array) -> Array:
    """Rates (..., 3) where the hull is bent by theta, before the static rotation; all about the hull's axes.

    C = C0 exp(-[theta x]) turns against the hull with C0 (I - [theta x] / 2 + ...) theta'; the rest is theta^2.
    """
    bent = hull_radps - np.cross(theta, hull_radps) + 0.5 * np.cross(theta, np.cross(theta, hull_radps))
    return np.asarray(bent + theta_rate - 0.5 * np.cross(theta, theta_rate))


def static_rotation(angles_deg: tuple[float, float, float]) -> Array:
    """R3(z) R2(y) R1(x), passive: the turns back of active ones, about the axes as they are turned."""
    return np.asarray(Rotation.from_euler("XYZ", angles_deg, degrees=True).as_matrix().T)


def _waves(scene: Scene, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Amplitude (rad), angular frequency and phase of each axis's harmonics, each (3, k)."""
    amplitudes = np.radians(scene.amplitudes_deg)[:, None]
    phases = 2.0 * np.pi * rng.random((3, COMPONENTS))
    cells, heights = rng.random((3, COMPONENTS)), rng.rayleigh(size=(3, COMPONENTS))
    if scene.sea == "still":
        return np.zeros((3, 1)), np.ones((3, 1)), phases[:, :1]
    if scene.sea == "tones":
        return amplitudes, 2.0 * np.pi / np.array(scene.periods_s)[:, None], phases[:, :1]
    low, high = BAND_HZ
    f = low + (high - low) * (np.arange(COMPONENTS) + cells) / COMPONENTS
    # Rayleigh heights and free phases make the process Gaussian; the mean square is that of the tone.
    return amplitudes * heights / math.sqrt(2.0 * COMPONENTS), 2.0 * np.pi * f, phases


def _hull_rates(scene: Scene, waves: tuple[Array, Array, Array], t: Array) -> Array:
    """(n, 3) rates of the unbent hull against inertial space, body axes, rad/s."""
    amplitude, omega, phase = waves
    turned = omega[:, :, None] * t + phase[:, :, None]
    angle = np.sum(amplitude[:, :, None] * np.sin(turned), axis=1)
    rate = np.sum((amplitude * omega)[:, :, None] * np.cos(turned), axis=1)
    nothing = np.zeros_like(t)
    motion = Motion(
        t_s=t, heave_m=nothing, heave_velocity_mps=nothing, heave_acceleration_mps2=nothing,
        surge_acceleration_mps2=nothing, sway_acceleration_mps2=nothing,
        roll_rad=angle[0], pitch_rad=angle[1], yaw_rad=angle[2] + math.radians(scene.heading_deg),
        roll_rate_radps=rate[0], pitch_rate_radps=rate[1], yaw_rate_radps=rate[2],
    )  # fmt: skip
    body = body_rates(motion)
    return np.stack([body.x, body.y, body.z], axis=1) + _navigation_rates(scene, motion)


def _navigation_rates(scene: Scene, motion: Motion[Array]) -> Array:
    """(n, 3) turning of the level frame (Earth and passage over it) in body axes."""
    latitude = math.radians(scene.latitude_deg)
    north = EARTH_RADPS * math.cos(latitude)
    west = scene.speed_mps / EARTH_RADIUS_M
    up = EARTH_RADPS * math.sin(latitude)
    sy, cy = np.sin(motion.yaw_rad), np.cos(motion.yaw_rad)
    forward, port = cy * north - sy * west, sy * north + cy * west
    sp, cp = np.sin(motion.pitch_rad), np.cos(motion.pitch_rad)
    sr, cr = np.sin(motion.roll_rad), np.cos(motion.roll_rad)
    x, mast = cp * forward + sp * up, cp * up - sp * forward
    return np.stack([x, cr * port + sr * mast, cr * mast - sr * port], axis=1)


def _flexure(scene: Scene, t: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """theta and theta' (n, 3) at increasing instants, rad and rad/s, from the stationary distribution on.

    The exact discretisation of the second-order Markov process, with the matrix exponential per distinct step.
    """
    std, mu = scene.flexure_std_arcsec * ARCSEC_RAD, scene.flexure_mu_radps
    b2 = mu**2 + (2.0 * math.pi * scene.flexure_hz) ** 2
    A = np.array([[0.0, 1.0], [-b2, -2.0 * mu]])
    stationary = np.diag([std**2, b2 * std**2])
    known: dict[int, tuple[Array, Array]] = {}
    draws = rng.standard_normal((len(t), 2, 3))
    x = np.sqrt(stationary) @ draws[0]
    result = np.empty((len(t), 2, 3))
    result[0] = x
    for i, step in enumerate(np.diff(t).tolist(), start=1):
        key = round(step * 1e9)
        if key not in known:
            F, Q = _discretised(A, 4.0 * mu * b2 * std**2, step)
            known[key] = F, _root(Q)
        F, root = known[key]
        x = F @ x + root @ draws[i]
        result[i] = x
    return result[:, 0], result[:, 1]


def _discretised(A: Array, drive: float, step_s: float) -> tuple[Array, Array]:
    """F (2, 2) and Q (2, 2) over one step, by Van Loan's block exponential."""
    block = np.zeros((4, 4))
    block[:2, :2], block[2:, 2:] = -A, A.T
    block[1, 3] = drive
    exponential = expm(block * step_s)
    F = exponential[2:, 2:].T
    return F, F @ exponential[:2, 2:]


def _root(Q: Array) -> Array:
    """Lower factor (2, 2) of a covariance that may have lost its definiteness to rounding."""
    a = math.sqrt(max(float(Q[0, 0]), 0.0))
    b = float(Q[0, 1]) / a if a > 0.0 else 0.0
    return np.array([[a, 0.0], [b, math.sqrt(max(float(Q[1, 1]) - b * b, 0.0))]])


def _read(scene: Scene, true: Array, scale_ppm: float, stamps: Array, rng: np.random.Generator) -> Array:
    """(n, 3) readings: scale, bias, white noise."""
    scale = 1.0 + 1e-6 * scale_ppm * rng.standard_normal(3)
    bias = scene.bias_deg_h * DEG_H_RADPS * rng.choice([-1.0, 1.0], 3)
    walk = math.radians(scene.angle_random_walk_deg_rth) / 60.0  # rad per root second
    step = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 1.0
    noise = math.hypot(scene.noise_deg_h * DEG_H_RADPS, walk / math.sqrt(step))
    return true * scale + bias + noise * rng.standard_normal(true.shape)
