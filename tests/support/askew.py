"""What a sensor that stands askew reads on a simulated vessel, turned by scipy's rotations."""

from __future__ import annotations

from functools import cache
from math import degrees, radians
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from heaved.setup.calibrate_record import Record
from heaved.setup.calibrate_signs import Lift
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import SENSORS, ImuModel, Recording, record

if TYPE_CHECKING:
    from heaved.simulate.gauge import Gauge

Array = NDArray[np.float64]
Angles = tuple[float, float, float]

AHRS_B = msgspec.structs.replace(SENSORS["B"], attitude_lean_s=8.0, attitude_late_s=0.04)


def any_mount(seed: int) -> Angles:
    """Any orientation, as rotation_deg."""
    z, y, x = Rotation.random(random_state=seed).as_euler("ZYX", degrees=True).tolist()
    return x, y, z


def vessel_from_sensor(mount: Angles) -> Rotation:
    x, y, z = mount
    return Rotation.from_euler("ZYX", [z, y, x], degrees=True)


def off_deg(found: Angles, mount: Angles) -> float:
    """Between two mountings."""
    return degrees((vessel_from_sensor(found).inv() * vessel_from_sensor(mount)).magnitude())


def tilt_off_deg(found: Angles, mount: Angles) -> float:
    """Between the verticals of two."""
    up = np.array([vessel_from_sensor(one).inv().apply((0.0, 0.0, 1.0)) for one in (found, mount)])
    return degrees(float(np.arctan2(np.linalg.norm(np.cross(up[0], up[1])), up[0] @ up[1])))


@cache
def at_sea(sea: str, model: str | ImuModel, seed: int, seconds: float, rate_hz: float) -> Recording:
    return record(seaway(sea, seed), seconds, imu_rate_hz=rate_hz, sensor=model, seed=seed)


def read(
    mount: Angles, *, sea: str = "S4", model: str | ImuModel = "A", seed: int = 1, seconds: float = 300.0,
    rate_hz: float = 20.0, tilt: tuple[float, float] = (0.0, 0.0), gauge: Gauge | None = None,
) -> Record:  # fmt: skip
    """``tilt``: roll and pitch (degrees) by which what the sensor is bolted to is tilted: bow up first, then port up
    about the new x axis.
    """
    made = at_sea(sea, model, seed, seconds, rate_hz)
    roll, pitch = tilt
    stands = Rotation.from_euler("ZYX", [0.0, -pitch, roll], degrees=True) * vessel_from_sensor(mount)
    force = stands.inv().apply(np.column_stack((made.ax_mps2, made.ay_mps2, made.az_mps2)))
    rates = stands.inv().apply(np.column_stack((made.gx_radps, made.gy_radps, made.gz_radps)))
    vessel = Rotation.from_euler("ZYX", np.column_stack((-made.yaw_rad, -made.pitch_rad, made.roll_rad)))
    yaw_s, pitch_s, roll_s = (vessel * stands).as_euler("ZYX").T
    laser = made.laser_m
    if gauge is not None:
        laser = gauge.read(made.truth) + np.random.default_rng(seed).normal(0.0, 0.002, made.t_s.size)
    return Record(
        t_s=made.t_s, force_mps2=force, angles_rad=np.column_stack((roll_s, -pitch_s, -yaw_s)), rates_radps=rates,
        laser_t_s=made.t_s, laser_m=laser,
    )  # fmt: skip


def without_angles(record: Record) -> Record:
    return msgspec.structs.replace(record, angles_rad=np.full_like(record.angles_rad, np.nan))


def without_rates(record: Record) -> Record:
    return msgspec.structs.replace(record, rates_radps=np.full_like(record.rates_radps, np.nan))


def cut(record: Record, keep: Array | NDArray[np.bool_]) -> Record:
    """Without some samples of the IMU."""
    return msgspec.structs.replace(
        record, t_s=record.t_s[keep], force_mps2=record.force_mps2[keep], angles_rad=record.angles_rad[keep],
        rates_radps=record.rates_radps[keep],
    )  # fmt: skip


def lifted(lift: Lift, angle_deg: float = 40.0) -> Record:
    """A sensor in the hand: flat, lifted about one of its axes within five seconds, held."""
    t_s = np.arange(0.0, 10.0, 0.05)
    at = radians(angle_deg) * np.clip((t_s - 2.5) / 5.0, 0.0, 1.0)
    rate, nil = np.gradient(at, t_s), np.zeros_like(t_s)
    s, c = 9.81 * np.sin(at), 9.81 * np.cos(at)
    if lift is Lift.PORT_UP:
        force, angles, rates = (nil, s, c), (at, nil, nil), (rate, nil, nil)
    else:
        force, angles, rates = (s, nil, c), (nil, at, nil), (nil, -rate, nil)
    return Record(
        t_s=t_s, force_mps2=np.column_stack(force), angles_rad=np.column_stack(angles),
        rates_radps=np.column_stack(rates), laser_t_s=nil[:0], laser_m=nil[:0],
    )  # fmt: skip
