"""How a sensor is mounted, against scipy's rotations, which know nothing of our signs."""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
from math import isnan, nan, radians
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from heaved.devices.listening import Listening
from heaved.devices.liveness import Contact
from heaved.devices.mounting import ANGLES, FORCES, RATES, Mounting, angles_deg, mounting_lines, mounting_of, rotation
from heaved.devices.profile import Block, DeviceSpec, Field, Profile, Quantity, Sentence, SentenceField
from heaved.devices.station import PollResult, Reading, Station
from heaved.links import parse_link
from heaved.samples import Fault, ImuSample

if TYPE_CHECKING:
    from heaved.devices.mounting import Vector

PROFILE = Profile(name="p", blocks=(Block(start=0, fields=(Field(quantity="az_mps2", offset=0, unit="m/s2"),)),))
MOUNTS: list[Vector] = [
    (0.0, 0.0, 90.0), (180.0, 0.0, 0.0), (0.0, -90.0, 0.0), (90.0, 0.0, 180.0), (3.0, -2.0, 47.0), (178.0, 1.0, -120.0),
    (10.0, 89.0, 30.0), (-77.0, 20.0, 200.0),
]  # fmt: skip


def turned_by(mount: Vector) -> Rotation:
    """Capital letters: about the axes as they have become, z first."""
    x, y, z = mount
    return Rotation.from_euler("ZYX", [z, y, x], degrees=True)


def level_from(angles: Vector) -> Rotation:
    """Heading clockwise, then bow up, then port up: two of them against the right hand."""
    roll, pitch, yaw = angles
    return Rotation.from_euler("ZYX", [-yaw, -pitch, roll])


def readings(force: Vector, angles: Vector, rates: Vector) -> dict[Quantity, float]:
    names = (*FORCES, *ANGLES, *RATES)
    return dict(zip(names, (*force, *angles, *rates), strict=True))


@pytest.mark.parametrize("mount", MOUNTS)
def test_vectors_and_attitude_of_a_vessel_come_back_from_a_sensor_that_is_turned(mount: Vector) -> None:
    rng = np.random.default_rng(1)
    vessel_from_sensor = turned_by(mount)
    mounting = Mounting(mount)
    for _ in range(50):
        force, rates = rng.normal(size=3) * 5.0, rng.normal(size=3)
        roll, yaw = rng.uniform(-math.pi, math.pi), rng.uniform(0.0, 2.0 * math.pi)
        pitch = rng.uniform(-1.4, 1.4)
        sensor = level_from((roll, pitch, yaw)) * vessel_from_sensor
        yaw_s, pitch_s, roll_s = sensor.as_euler("ZYX").tolist()
        read = readings(
            tuple(vessel_from_sensor.inv().apply(force).tolist()),
            (roll_s, -pitch_s, -yaw_s),
            tuple(vessel_from_sensor.inv().apply(rates).tolist()),
        )
        found = mounting.turn(read | {"temperature_c": 21.0})
        assert [found[name] for name in FORCES] == pytest.approx(force, abs=1e-12)
        assert [found[name] for name in RATES] == pytest.approx(rates, abs=1e-12)
        back = level_from((found["roll_rad"], found["pitch_rad"], found["yaw_rad"]))
        assert (back.inv() * level_from((roll, pitch, yaw))).magnitude() < 1e-7
        assert 0.0 <= found["yaw_rad"] < 2.0 * math.pi
        assert found["temperature_c"] == 21.0


def test_the_two_ways_between_angles_and_matrix_agree_with_scipy() -> None:
    for mount in MOUNTS:
        np.testing.assert_allclose(rotation(*mount), turned_by(mount).as_matrix(), atol=1e-15)
        np.testing.assert_allclose(rotation(*angles_deg(rotation(*mount))), turned_by(mount).as_matrix(), atol=1e-9)
    assert angles_deg(rotation(5.0, -90.0, 20.0))[0] == 0.0


def test_a_bias_is_taken_off_in_the_axes_of_the_sensor() -> None:
    bias = (0.1, -0.2, 0.3)
    found = Mounting((0.0, 0.0, 90.0), bias).turn({"ax_mps2": 0.1, "ay_mps2": 0.8, "az_mps2": 10.3})
    assert [found[name] for name in FORCES] == pytest.approx([-1.0, 0.0, 10.0])
    alone = Mounting((0.0, 0.0, 0.0), bias).turn({"az_mps2": 10.3, "roll_rad": 0.1})
    assert alone["az_mps2"] == pytest.approx(10.0)
    assert isnan(alone["ax_mps2"])
    assert alone["roll_rad"] == 0.1


PARTIAL: list[tuple[str, Vector, Vector, Vector]] = [
    # what, mounting, angles of the sensor (deg), angles of the vessel (deg)
    ("no heading, tilted", (10.0, 20.0, 0.0), (10.0, -20.0, nan), (0.0, 0.0, nan)),
    ("no heading, a quarter turn", (0.0, 0.0, 90.0), (5.0, 0.0, nan), (0.0, -5.0, nan)),
    ("roll alone, about x", (10.0, 0.0, 0.0), (14.0, nan, nan), (4.0, nan, nan)),
    ("pitch alone, about x", (10.0, 0.0, 0.0), (nan, 3.0, 40.0), (nan, 3.0, 40.0)),
    ("pitch alone, upside down", (180.0, 0.0, 0.0), (nan, 3.0, 40.0), (nan, 3.0, 40.0)),
    ("pitch alone, back to front", (0.0, 0.0, 180.0), (nan, 3.0, 40.0), (nan, -3.0, 220.0)),
    ("roll alone, back to front", (0.0, 0.0, 180.0), (2.0, nan, nan), (-2.0, nan, nan)),
    ("roll alone, askew", (0.0, 0.0, 10.0), (2.0, nan, 5.0), (nan, nan, nan)),
    ("nothing", (0.0, 0.0, 10.0), (nan, nan, 5.0), (nan, nan, nan)),
]


@pytest.mark.parametrize(("mount", "sensor", "vessel"), [row[1:] for row in PARTIAL], ids=[row[0] for row in PARTIAL])
def test_what_cannot_be_turned_is_not_known(mount: Vector, sensor: Vector, vessel: Vector) -> None:
    read: dict[Quantity, float] = {
        name: radians(angle) for name, angle in zip(ANGLES, sensor, strict=True) if not isnan(angle)
    }
    found = Mounting(mount).turn(read)
    shown = [math.degrees(found.get(name, nan)) for name in ANGLES]
    assert shown == pytest.approx(vessel, abs=1e-9, nan_ok=True)


def test_axes_that_have_no_share_of_a_missing_one_are_known() -> None:
    about_z = Mounting((0.0, 0.0, 90.0)).turn({"az_mps2": 9.8, "ax_mps2": 1.0})
    assert about_z["az_mps2"] == 9.8
    assert about_z["ay_mps2"] == 1.0
    assert isnan(about_z["ax_mps2"])
    askew = Mounting((1.0, 0.0, 0.0)).turn({"az_mps2": 9.8})
    assert all(isnan(askew[name]) for name in ("ay_mps2", "az_mps2"))


def test_a_sensor_along_the_axes_of_the_vessel_costs_nothing() -> None:
    plain = DeviceSpec(name="imu", role="imu", link="tcp://h:1", profile=PROFILE, rate_hz=20.0)
    assert mounting_of(plain) is None
    whole = DeviceSpec(
        name="imu", role="imu", link="tcp://h:1", profile=PROFILE, rate_hz=20.0, rotation_deg=(0.0, 360.0, -360.0)
    )
    assert mounting_of(whole) is None


def test_on_a_bulkhead_the_tilt_is_right_whatever_roll_and_yaw_of_the_sensor_say_alone() -> None:
    """Its x axis up: roll and yaw turn about the same axis, and the sensor may tell any pair of the same sum."""
    mounting = Mounting((0.0, -90.0, 0.0))
    for roll in (-2.0, 0.3, 1.9):
        found = mounting.turn({"roll_rad": roll, "pitch_rad": radians(90.0), "yaw_rad": 1.0 + roll})
        assert found["roll_rad"] == pytest.approx(0.0, abs=1e-9)
        assert found["pitch_rad"] == pytest.approx(0.0, abs=1e-9)


IMU = DeviceSpec(
    name="imu", role="imu", link="tcp://127.0.0.1:1", profile=PROFILE, rate_hz=20.0,
    rotation_deg=(180.0, 0.0, 0.0), bias_mps2=(0.0, 0.0, -0.2), attitude_latency_ms=-30.0,
)  # fmt: skip


def test_a_device_that_is_asked_gives_samples_in_the_axes_of_the_vessel() -> None:
    link = parse_link(IMU.link)
    contact = Contact(numbered=True, lengths={1}, alone=True, timeout_s=0.05, opened_s=0.0)
    station = Station(IMU, link, contact, 0.0)
    values: dict[Quantity, float] = {
        "ax_mps2": 0.5, "ay_mps2": 1.0, "az_mps2": -10.0, "pitch_rad": 0.1, "roll_rad": math.pi, "temperature_c": 20.0,
    }  # fmt: skip
    result = station.result(Reading(1.0, values), 1.0, 1.0, 1.01, 1)
    sample = result.sample
    assert isinstance(sample, ImuSample)
    assert (sample.ax_mps2, sample.ay_mps2, sample.az_mps2) == pytest.approx((0.5, -1.0, 9.8))
    assert (sample.roll_rad, sample.pitch_rad) == pytest.approx((0.0, 0.1), abs=1e-12)
    assert isnan(sample.yaw_rad)
    assert result.extra == {"temperature_c": 20.0}
    failed = station.result(Reading(2.0, {}, Fault.TIMEOUT, "silent"), 2.0, 2.0, 2.01, 1)
    assert failed.sample == ImuSample(t_s=2.0, fault=Fault.TIMEOUT)


async def test_a_device_that_speaks_gives_samples_in_the_axes_of_the_vessel() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    fields = tuple(SentenceField(quantity=name, index=i + 1, unit="m/s2") for i, name in enumerate(FORCES))
    speaking = DeviceSpec(
        name="imu", role="imu", link=f"udp-listen://127.0.0.1:{port}", rate_hz=20.0, rotation_deg=(0.0, 0.0, 90.0),
        profile=Profile(name="box", sentences=(Sentence(header="$F", fields=fields),)),
    )  # fmt: skip
    heard: asyncio.Queue[PollResult] = asyncio.Queue(100)
    task = asyncio.create_task(Listening([speaking], heard.put_nowait).run())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box:
        async with asyncio.timeout(20.0):
            result = await heard.get()  # Silence: it listens.
            while result.fault is not Fault.NONE:
                box.sendto(b"$F,1.0,2.0,9.8\r\n", ("127.0.0.1", port))
                result = await heard.get()
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task
    sample = result.sample
    assert isinstance(sample, ImuSample)
    assert (sample.ax_mps2, sample.ay_mps2, sample.az_mps2) == pytest.approx((-2.0, 1.0, 9.8))


def test_a_person_is_told_how_it_stands() -> None:
    assert mounting_lines(IMU) == [
        "mounting: its x axis points forward, its y axis points to starboard, its z axis points down",
        "bias taken off, in its own axes: +0.000, +0.000, -0.200 m/s2",
        "its angles are 30 ms younger than its accelerations",
    ]
    plain = DeviceSpec(name="imu", role="imu", link="tcp://h:1", profile=PROFILE, rate_hz=20.0)
    assert mounting_lines(plain) == []
