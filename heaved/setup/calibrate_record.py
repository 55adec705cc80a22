"""What an IMU and a laser have said for a while, in the axes of the sensor, as arrays.

A recording holds the axes of the vessel: it is turned back with the mounting that the configuration has.
"""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.devices.mounting import Matrix, Vector, rotation
from heaved.devices.recording import Recording
from heaved.samples import Fault, ImuSample, LaserSample, Sample

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

Array = NDArray[np.float64]

PRESENT: Final = 0.8
"""Share of the samples that must have a reading for it to be there."""


class Record(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """Readings in order of time; nan: not known."""

    t_s: Array
    """(n,)"""
    force_mps2: Array
    """(n, 3) x, y, z,"""
    angles_rad: Array
    """(n, 3) roll, pitch, yaw as :mod:`heaved.samples` counts them,"""
    rates_radps: Array
    """(n, 3) x, y, z."""
    laser_t_s: Array
    laser_m: Array
    """(m,)"""

    @property
    def seconds(self) -> float:
        """From the first to the last."""
        return float(self.t_s[-1] - self.t_s[0]) if self.t_s.size else 0.0

    @property
    def has_force(self) -> bool:
        """Whether all three accelerations are there."""
        return _are_there(self.force_mps2)

    @property
    def has_attitude(self) -> bool:
        """Whether roll and pitch are there."""
        return _are_there(self.angles_rad[:, :2])

    @property
    def has_rates(self) -> bool:
        """Whether all three body rates are there."""
        return _are_there(self.rates_radps)

    @property
    def up(self) -> Array:
        """(n, 3) the vertical in the axes of the sensor, by its angles."""
        roll, pitch = self.angles_rad[:, 0], self.angles_rad[:, 1]
        return np.column_stack((np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)))


def record_of(samples: Iterable[Sample]) -> Record:
    """The good ones among some samples."""
    imu, laser, last_s = [], [], nan
    for one in samples:
        if one.fault is not Fault.NONE:
            continue
        if isinstance(one, ImuSample) and not one.t_s <= last_s:
            last_s = one.t_s
            imu.append((
                one.t_s, one.ax_mps2, one.ay_mps2, one.az_mps2, one.roll_rad, one.pitch_rad, one.yaw_rad,
                one.gx_radps, one.gy_radps, one.gz_radps,
            ))  # fmt: skip
        elif isinstance(one, LaserSample):
            laser.append((one.t_s, one.laser_m))
    rows = np.array(imu, dtype=np.float64).reshape(-1, 10)
    gauge = np.array(laser, dtype=np.float64).reshape(-1, 2)
    return Record(
        t_s=rows[:, 0], force_mps2=rows[:, 1:4], angles_rad=rows[:, 4:7], rates_radps=rows[:, 7:],
        laser_t_s=gauge[:, 0], laser_m=gauge[:, 1],
    )  # fmt: skip


def read_record(path: Path, rotation_deg: Vector, bias_mps2: Vector) -> Record:
    """A recording in CSV, turned back into the axes of a sensor with that mounting.

    Raises:
        heaved.devices.recording.RecordingError: the file is no recording.
    """
    samples: list[Sample] = []
    with Recording(path) as recording:
        for imu, laser, *_ in recording.instants():
            samples += [one for one in (laser, imu) if one is not None]
    record = record_of(samples)
    if not any(rotation_deg) and not any(bias_mps2):
        return record
    return turned_back(record, rotation(*rotation_deg), bias_mps2)


def turned_back(record: Record, vessel_from_sensor: Matrix, bias_mps2: Vector) -> Record:
    """What a sensor has read that was turned so, and its bias taken off."""
    R = np.array(vessel_from_sensor)
    roll, pitch, yaw = record.angles_rad.T
    has_heading = np.isfinite(yaw)
    level = _level_from(roll, pitch, np.where(has_heading, yaw, 0.0)) @ R
    angles = np.column_stack((
        np.arctan2(level[:, 2, 1], level[:, 2, 2]),
        np.arcsin(np.clip(level[:, 2, 0], -1.0, 1.0)),
        np.where(has_heading, np.arctan2(-level[:, 1, 0], level[:, 0, 0]), nan),
    ))  # fmt: skip
    return msgspec.structs.replace(
        record, force_mps2=record.force_mps2 @ R + bias_mps2, angles_rad=angles, rates_radps=record.rates_radps @ R
    )


def pieces(record: Record, hole_s: float, least_s: float) -> list[Record]:
    """Its stretches between holes, but for those that are shorter than that; lasers go with none."""
    ends = np.flatnonzero(np.diff(record.t_s) > hole_s) + 1
    none = np.zeros(0)
    return [
        Record(
            t_s=record.t_s[part], force_mps2=record.force_mps2[part], angles_rad=record.angles_rad[part],
            rates_radps=record.rates_radps[part], laser_t_s=none, laser_m=none,
        )
        for part in np.split(np.arange(len(record.t_s)), ends)
        if len(part) > 1 and record.t_s[part[-1]] - record.t_s[part[0]] >= least_s
    ]  # fmt: skip


def joined(first: Record, second: Record) -> Record:
    """One after the other."""
    return Record(
        **{name: np.concatenate((getattr(first, name), getattr(second, name))) for name in Record.__struct_fields__}
    )


def in_vessel_axes(record: Record, rotation_deg: Vector, bias_mps2: Vector) -> Record:
    """The same in the axes of a vessel on which the sensor is mounted so."""
    R = np.array(rotation(*rotation_deg))
    x, y, z = (-R @ np.array(bias_mps2)).tolist()
    first, second, third = ((row[0], row[1], row[2]) for row in R.T.tolist())
    return turned_back(record, (first, second, third), (x, y, z))


def means(t_s: Array, values: Array, rate_hz: float) -> tuple[Array, Array]:
    """Middle and mean (m,), (m, k) of even steps of straight lines through values (n, k): every sample tells, and all
    series lose the same of what is fast.
    """
    edges = np.arange(t_s[0], t_s[-1], 1.0 / rate_hz)
    integral = np.zeros_like(values)
    np.cumsum(0.5 * np.diff(t_s)[:, None] * (values[1:] + values[:-1]), axis=0, out=integral[1:])
    at = np.column_stack([np.interp(edges, t_s, column) for column in integral.T])
    return 0.5 * (edges[1:] + edges[:-1]), np.asarray(np.diff(at, axis=0) * rate_hz)


def _level_from(roll: Array, pitch: Array, yaw: Array) -> Array:
    """(n, 3, 3) ``Rz(-yaw) Ry(-pitch) Rx(roll)``."""
    sr, cr, sp, cp, sy, cy = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch), np.sin(yaw), np.cos(yaw)
    rows = (
        (cy * cp, sy * cr - cy * sp * sr, -sy * sr - cy * sp * cr),
        (-sy * cp, cy * cr + sy * sp * sr, sy * sp * cr - cy * sr),
        (sp, cp * sr, cp * cr),
    )
    return np.moveaxis(np.array(rows), -1, 0)


def _are_there(values: Array) -> bool:
    return bool(len(values)) and float(np.mean(np.isfinite(values).all(axis=1))) >= PRESENT
