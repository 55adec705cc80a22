"""Sensors that stand askew, against scipy's rotations."""

from __future__ import annotations

import math
import re

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from heaved.devices.profile import Block, DeviceSpec, Field, Profile
from heaved.samples import Fault, ImuSample, LaserSample, RatesSample, Sample
from heaved.simulate.mounted import Mounted, parse_mounts, parse_tilt

PROFILE = Profile(name="p", blocks=(Block(start=0, fields=(Field(quantity="az_mps2", offset=0, unit="m/s2"),)),))
IMU = DeviceSpec(name="imu", role="imu", link="tcp://h:1", profile=PROFILE, rate_hz=20.0)
SECOND = DeviceSpec(name="second", role="imu2", link="tcp://h:2", profile=PROFILE, rate_hz=20.0)
LASER = DeviceSpec(name="laser", role="laser", link="tcp://h:3", profile=PROFILE, rate_hz=20.0)


class One:
    """A source that always says the same."""

    def __init__(self, sample: Sample) -> None:
        self._sample = sample

    def read(self, device: DeviceSpec, t_s: float) -> Sample:
        return self._sample


def test_the_readings_are_those_of_a_sensor_that_is_turned() -> None:
    force, rates = np.array([0.3, -1.2, 9.6]), np.array([0.1, 0.2, -0.3])
    roll, pitch, yaw = 0.2, -0.1, 2.0
    sample = ImuSample(
        t_s=1.0, ax_mps2=force[0], ay_mps2=force[1], az_mps2=force[2], roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw,
        gx_radps=rates[0], gy_radps=rates[1], gz_radps=rates[2],
    )  # fmt: skip
    tilted = Rotation.from_euler("ZYX", [0.0, -6.0, 4.0], degrees=True)  # bow up, then port up
    stands = tilted * Rotation.from_euler("ZYX", [40.0, 30.0, -150.0], degrees=True)
    source = Mounted(One(sample), parse_mounts(["imu:-150,30,40"], [IMU]), parse_tilt("4,6"))
    found = source.read(IMU, 1.0)
    assert isinstance(found, ImuSample)
    assert [found.ax_mps2, found.ay_mps2, found.az_mps2] == pytest.approx(stands.inv().apply(force))
    assert [found.gx_radps, found.gy_radps, found.gz_radps] == pytest.approx(stands.inv().apply(rates))
    shown = Rotation.from_euler("ZYX", [-found.yaw_rad, -found.pitch_rad, found.roll_rad])
    true = Rotation.from_euler("ZYX", [-yaw, -pitch, roll]) * stands
    assert (shown.inv() * true).magnitude() < 1e-7


def test_rates_of_a_second_imu_are_turned_and_all_else_is_left() -> None:
    mounts = parse_mounts(["second:0,0,90"], [IMU, SECOND])
    rates = Mounted(One(RatesSample(t_s=0.0, gx_radps=1.0, gy_radps=0.0, gz_radps=2.0)), mounts).read(SECOND, 0.0)
    assert isinstance(rates, RatesSample)
    assert (rates.gx_radps, rates.gy_radps, rates.gz_radps) == pytest.approx((0.0, -1.0, 2.0))
    for sample in (LaserSample(t_s=0.0, laser_m=12.0), ImuSample(t_s=0.0, fault=Fault.STUCK)):
        assert Mounted(One(sample), mounts, parse_tilt("0,10")).read(LASER, 0.0) is sample
    still = Mounted(One(ImuSample(t_s=0.0, az_mps2=9.8)), {}).read(IMU, 0.0)
    assert isinstance(still, ImuSample)
    assert still.az_mps2 == 9.8
    assert math.isnan(still.roll_rad)


@pytest.mark.parametrize("text", ["imu", "imu:1,2", "laser:0,0,90", "imu:a,b,c", "imu:1,2,3,4"])
def test_a_mounting_that_is_none_is_named(text: str) -> None:
    with pytest.raises(ValueError, match=re.escape(repr(text))):
        parse_mounts([text], [IMU, LASER])


def test_a_tilt_that_is_none_is_named() -> None:
    with pytest.raises(ValueError, match="ROLL,PITCH"):
        parse_tilt("5")


def test_by_default_a_sensor_stands_and_errs_as_its_device_says() -> None:
    """So that what a configuration takes off is there, whichever it is."""
    spec = msgspec.structs.replace(IMU, rotation_deg=(-150.0, 30.0, 40.0), bias_mps2=(0.1, -0.2, 0.3))
    true = ImuSample(
        t_s=1.0, ax_mps2=0.3, ay_mps2=-1.2, az_mps2=9.6, roll_rad=0.2, pitch_rad=-0.1, yaw_rad=2.0, gx_radps=0.1,
        gy_radps=0.2, gz_radps=-0.3,
    )  # fmt: skip
    found = Mounted(One(true), {}).read(spec, 1.0)
    assert isinstance(found, ImuSample)
    stands = Rotation.from_euler("ZYX", [40.0, 30.0, -150.0], degrees=True)
    read = stands.inv().apply((0.3, -1.2, 9.6)) + spec.bias_mps2
    assert (found.ax_mps2, found.ay_mps2, found.az_mps2) == pytest.approx(read)
    assert (found.gx_radps, found.gy_radps, found.gz_radps) == pytest.approx(stands.inv().apply((0.1, 0.2, -0.3)))
    assert Mounted(One(true), {}).read(IMU, 1.0) is true
