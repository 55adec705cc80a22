"""Records from devices on lines: simulated slaves that stand askew, and lines on which nobody is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest
from askew import vessel_from_sensor

from heaved.config.read import packaged_profiles
from heaved.devices.profile import DeviceSpec
from heaved.samples import Fault, ImuSample
from heaved.setup import calibrate_live
from heaved.setup.calibrate_live import DeviceError, read_for
from heaved.simulate.instruments import Instruments
from heaved.simulate.mounted import Mounted
from heaved.simulate.plant import SimulatedPlant
from heaved.simulate.seaway import seaway

if TYPE_CHECKING:
    from collections.abc import Container
    from pathlib import Path

    from heaved.samples import Sample
    from heaved.simulate.slave import Source

PROFILES = {profile.name: profile for profile in packaged_profiles()}
MOUNT = (170.0, 10.0, 40.0)


def devices(directory: Path) -> list[DeviceSpec]:
    link = f"rtu://{directory}/bus?baudrate=230400"
    return [
        DeviceSpec(name="imu", role="imu", link=link, profile=PROFILES["heaved-sim-imu"], rate_hz=50.0),
        DeviceSpec(
            name="laser", role="laser", link=link, device_id=2, profile=PROFILES["heaved-sim-laser"], rate_hz=20.0
        ),
    ]


async def test_a_record_is_in_the_axes_of_the_sensor_whatever_the_configuration_says(tmp_path: Path) -> None:
    there = devices(tmp_path)
    plant = SimulatedPlant(there, Mounted(Instruments(seaway("S0", 1), sensor="ideal"), {"imu": MOUNT}))
    await plant.start()
    told: list[float] = []
    turned = msgspec.structs.replace(
        there[0], rotation_deg=MOUNT, bias_mps2=(1.0, 1.0, 1.0), stuck_after_s=0.0
    )  # An ideal sensor in a harbour reads always the same.
    record = await read_for([turned, msgspec.structs.replace(there[1], stuck_after_s=0.0)], 1.0, told.append)
    await plant.stop()
    up = vessel_from_sensor(MOUNT).inv().apply((0.0, 0.0, 1.0))
    assert record.force_mps2.mean(axis=0) == pytest.approx(9.80665 * up, abs=0.01)
    assert record.up.mean(axis=0) == pytest.approx(up, abs=1e-3)
    assert record.laser_m.size > 5
    assert told
    assert told[-1] == pytest.approx(1.0)
    assert np.all(np.diff(record.t_s) > 0.0)


async def test_a_line_that_is_not_there_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibrate_live, "SILENT_S", 0.5)
    with pytest.raises(DeviceError, match=r"no reading for 1 s: imu .*is not there: plug the adapter in"):
        await read_for(devices(tmp_path)[:1], 5.0, lambda _: None)


class Failing:
    """An IMU that refuses some of its reads, by their number."""

    def __init__(self, source: Source, refused: Container[int]) -> None:
        self._source, self._refused = source, refused
        self.reads = 0

    def read(self, device: DeviceSpec, t_s: float) -> Sample:
        self.reads += 1
        sample = self._source.read(device, t_s)
        return ImuSample(t_s=t_s, fault=Fault.EXCEPTION) if self.reads in self._refused else sample


async def test_a_plug_that_is_found_again_leaves_a_hole_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calibrate_live, "AWAY_S", 0.2)
    monkeypatch.setattr(calibrate_live, "LEAST_GOOD", 0.1)
    there = devices(tmp_path)[:1]
    plant = SimulatedPlant(there, Failing(Instruments(seaway("S4", 1)), range(20, 60)))
    await plant.start()
    waited: list[str] = []
    record = await read_for(there, 1.0, lambda _: None, waited.append)
    await plant.stop()
    assert len(waited) == 1
    assert "imu" in waited[0]
    assert np.max(np.diff(record.t_s)) > 0.3


async def test_a_device_that_stops_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibrate_live, "LOST_S", 0.5)
    there = devices(tmp_path)[:1]
    plant = SimulatedPlant(there, Failing(Instruments(seaway("S4", 1)), range(20, 10**6)))
    await plant.start()
    with pytest.raises(DeviceError, match="no reading for 1 s: imu"):
        await read_for(there, 30.0, lambda _: None)
    await plant.stop()


async def test_a_device_that_hardly_answers_is_not_taken(tmp_path: Path) -> None:
    there = devices(tmp_path)[:1]
    plant = SimulatedPlant(there, Failing(Instruments(seaway("S4", 1)), [n for n in range(10**4) if n % 5]))
    await plant.start()
    with pytest.raises(DeviceError, match="polls were answered: imu"):
        await read_for(there, 0.5, lambda _: None)
    await plant.stop()
