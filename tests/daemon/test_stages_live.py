"""The stages live over loopback: simulated slaves, the daemon, a client, and the process that fits the flexure."""

from __future__ import annotations

import asyncio
import math
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from running import PATIENCE_S, Record, demo_config, metric, running

from heaved.config import Config, HttpParams, StateParams, StreamParams
from heaved.config.read import data_directory, load
from heaved.demo.craft_at_sea import voyages
from heaved.estimation.craft import fusion
from heaved.estimation.craft.dynamics import Vessel
from heaved.estimation.hull import estimate as hull
from heaved.outputs import wire
from heaved.simulate.crane import CraneBuild, height_m
from heaved.simulate.faults import FaultKind, PlannedFault
from heaved.simulate.hydrofoil import Passage
from heaved.simulate.instruments import Instruments
from heaved.simulate.plant import SimulatedPlant
from heaved.simulate.vessel import Motion

if TYPE_CHECKING:
    from collections.abc import AsyncIterator
    from pathlib import Path

    from heaved.daemon.daemon import Daemon

Array = NDArray[np.float64]

LATE_S = 0.004
"""The simulated second IMU answers with rates of so long ago."""


class Rolling:
    """Roll, pitch and yaw of 6, 3 and 4 degrees at 4, 3 and 5 s."""

    def at(self, t_s: float) -> Motion[float]:
        angles, rates = [], []
        for degrees, period_s in ((6.0, 4.0), (3.0, 3.0), (4.0, 5.0)):
            w = 2.0 * math.pi / period_s
            angles.append(math.radians(degrees) * math.sin(w * t_s))
            rates.append(math.radians(degrees) * w * math.cos(w * t_s))
        return Motion(
            t_s=t_s, heave_m=0.0, heave_velocity_mps=0.0, heave_acceleration_mps2=0.0, surge_acceleration_mps2=0.0,
            sway_acceleration_mps2=0.0, roll_rad=angles[0], pitch_rad=angles[1], yaw_rad=1.0 + angles[2],
            roll_rate_radps=rates[0], pitch_rate_radps=rates[1], yaw_rate_radps=rates[2],
        )  # fmt: skip


QUICK = hull.Params(enabled=True, start_s=2.0, refit_after_s=8.0, converged_arcsec=3600.0, gyro_noise_deg_rth=0.3)
"""Converges in seconds, to what is enough to know that every sign and frame on the way is right."""


def hull_config(directory: Path, **changes: Any) -> Config:
    devices = load(data_directory() / "hull.toml").device
    return demo_config(directory, device=devices, hull=QUICK, **changes)


async def watching(daemon: Daemon, *classes: str) -> AsyncIterator[Record]:
    """Records of those classes only."""
    reader, writer = await asyncio.open_connection(*daemon.addresses["stream"])
    writer.write(b"?WATCH=" + msgspec.json.encode({"classes": classes}) + b"\n")
    try:
        while line := await reader.readline():
            record = wire.decode(line)
            if record["class"] in classes:
                yield record
    finally:
        writer.close()


async def test_the_deformation_of_a_simulated_hull_is_on_the_stream(tmp_path: Path) -> None:
    config = hull_config(tmp_path)
    instruments = Instruments(Rolling(), seed=1)
    plant = SimulatedPlant(config.device, instruments, any_port=True)
    await plant.start()
    config = msgspec.structs.replace(config, device=plant.devices)
    crane = next(device for device in plant.devices if device.role == "imu2")
    hulls: list[Record] = []
    motions: list[Record] = []
    try:
        async with running(config) as daemon, asyncio.timeout(3.0 * PATIENCE_S):
            async for record in watching(daemon, "HULL", "MOTION"):
                (hulls if record["class"] == "HULL" else motions).append(record)
                if hulls and hulls[-1]["refits"] and "crane_roll_deg" in motions[-1]:
                    break
            assert metric(daemon, 'heaved_hull_std_radians{axis="x"}') > 0.0
            assert metric(daemon, 'heaved_filter_resets_total{filter="hull"') == 0
            status = daemon.status()
    finally:
        await plant.stop()
    last, motion = hulls[-1], motions[-1]
    assert last["state"] == "converged"
    assert status.hull is not None
    assert status.hull.state == "converged"
    # At the configured rate, whatever the grid: none twice, none left out but where the machine stood still.
    steps = np.diff([record["mono_s"] for record in hulls])
    assert np.median(steps) == pytest.approx(0.1, abs=0.02)
    truth = np.degrees(np.array(angles_of(instruments.second_imu(crane).deformation(10.0))))
    for axis, angle in zip("xyz", truth.tolist(), strict=True):
        allowed = 5.0 * last[f"{axis}_std_arcsec"] + 60.0  # Flexure of 5 arcsec, and polls that the machine delays.
        assert abs(last[f"{axis}_deg"] - angle) * 3600.0 < allowed < 1200.0
    assert last["delay_s"] == pytest.approx(LATE_S, abs=0.01)
    # The crane base is turned by 30 degrees to port: it heads 30 degrees less than the ship.
    assert (motion["yaw_deg"] - motion["crane_yaw_deg"]) % 360.0 == pytest.approx(30.0, abs=3.0)


def angles_of(C: Array) -> tuple[float, float, float]:
    """x, y, z of C = R3(z) R2(y) R1(x), from its first column and last row."""
    return math.atan2(-C[2, 1], C[2, 2]), math.asin(C[2, 0]), math.atan2(-C[1, 0], C[0, 0])


async def test_a_second_imu_that_is_dead_is_named_and_the_stream_goes_on(tmp_path: Path) -> None:
    config = hull_config(tmp_path)
    plant = SimulatedPlant(
        config.device, Instruments(Rolling(), seed=1), any_port=True,
        faults=[PlannedFault(device="crane", kind=FaultKind.DROPOUT, start_s=0.0, duration_s=1e6)],
    )  # fmt: skip
    await plant.start()
    try:
        async with (
            running(msgspec.structs.replace(config, device=plant.devices)) as daemon,
            asyncio.timeout(2.0 * PATIENCE_S),
        ):
            motions = []
            async for record in watching(daemon, "HULL", "MOTION"):
                if record["class"] == "MOTION":
                    motions.append(record)
                elif "missing_local" in record.get("warnings", ()):
                    break
    finally:
        await plant.stop()
    assert record["state"] in ("starting", "weak")
    assert np.median(np.diff([motion["mono_s"] for motion in motions])) == pytest.approx(0.01, abs=0.005)
    assert not any("crane_roll_deg" in motion for motion in motions)


async def test_the_attitude_of_a_simulated_craft_is_on_the_stream(tmp_path: Path) -> None:
    voyage = voyages(Vessel(), [2], Passage(stages=((0.0, 1.0),), duration_s=60.0))[0]
    config = msgspec.structs.replace(
        load(data_directory() / "hydrofoil.toml"),
        stream=StreamParams(port=0),
        http=HttpParams(port=0),
        state=StateParams(directory=str(tmp_path)),
    )
    plant = SimulatedPlant(config.device, Instruments(Rolling(), seed=1, voyage=voyage), any_port=True)
    await plant.start()
    records, epoch_s = [], asyncio.get_running_loop().time() - plant.time_s()
    try:
        async with running(msgspec.structs.replace(config, device=plant.devices)) as daemon:
            async with asyncio.timeout(2.0 * PATIENCE_S):
                async for record in watching(daemon, "ATTITUDE"):
                    records.append(record)
                    if len(records) > 60:
                        break
            status = daemon.status()
    finally:
        await plant.stop()
    assert status.attitude is not None
    assert status.attitude.heave_m is not None
    assert np.median(np.diff([record["mono_s"] for record in records])) == pytest.approx(0.05, abs=0.01)
    t = np.array([record["mono_s"] for record in records]) - epoch_s
    heave = np.array([record["heave_m"] for record in records])
    pitch = np.array([record["pitch_deg"] for record in records])
    off = heave - np.interp(t, voyage.t_s, voyage.heave_m)
    assert np.sqrt(np.mean(off[20:] ** 2)) < 0.05  # The noise of a reading.
    off = pitch - np.degrees(np.interp(t, voyage.t_s, voyage.pitch_rad))
    assert np.sqrt(np.mean(off[20:] ** 2)) < math.degrees(0.005)
    assert all(sum(record["probabilities"]) == pytest.approx(1.0, abs=1e-5) for record in records)


async def test_a_reload_switches_a_stage_without_touching_the_heave(tmp_path: Path) -> None:
    path = tmp_path / "heaved.toml"

    def write(text: str) -> None:
        listens = f'[stream]\nport = 0\n[http]\nport = 0\n[state]\ndirectory = "{tmp_path}"\n'
        path.write_text(listens + (data_directory() / "sensors.toml").read_text() + text)

    write("")
    async with running(load(path), path) as daemon:
        pipeline, stages = daemon.acquisition.pipeline, daemon.acquisition.pipeline.stages
        write('[attitude]\nenabled = true\nsource = "own"\n')
        await daemon.reload()
        assert daemon.acquisition.pipeline is pipeline
        assert stages.attitude is not None
        attitude = stages.attitude
        write('[attitude]\nenabled = true\nsource = "own"\n[rock]\ndegree = 2\n')
        await daemon.reload()
        assert daemon.acquisition.pipeline is not pipeline
        assert daemon.acquisition.pipeline.stages.attitude is attitude
        # Without a second IMU the file is refused whole.
        write("[hull]\nenabled = true\n")
        await daemon.reload()
        assert daemon.config.attitude == fusion.Params(enabled=True, source=fusion.Source.OWN)
        assert daemon.acquisition.pipeline.stages.hull is None
        assert metric(daemon, 'heaved_config_reloads_total{result="refused"}') == 1
        write("")
        await daemon.reload()
        assert daemon.acquisition.pipeline.stages.attitude is None


async def test_the_tip_of_a_simulated_crane_is_on_the_stream_and_a_reload_moves_it(tmp_path: Path) -> None:
    path = tmp_path / "heaved.toml"
    listens = f'[stream]\nport = 0\n[http]\nport = 0\n[state]\ndirectory = "{tmp_path}"\n'
    packaged = listens + (data_directory() / "demo.toml").read_text().partition("[[output]]")[0]
    config = load(data_directory() / "demo.toml")
    instruments = Instruments(Rolling(), seed=1)
    plant = SimulatedPlant(config.device, instruments, any_port=True)
    await plant.start()
    try:
        text = packaged
        for device, reached in zip(config.device, plant.devices, strict=True):
            text = text.replace(device.link, reached.link)
        path.write_text(text)
        async with running(load(path), path) as daemon, asyncio.timeout(2.0 * PATIENCE_S):
            known = 0
            async for record in watching(daemon, "MOTION"):
                tip, hook = record["points"]
                known += "own_height_m" in tip
                if known > 20:
                    break
            # The crane rests for five seconds before it begins.
            true_m = height_m(CraneBuild(), instruments.crane.at(0.0).at, 0.0, 0.0)
            assert tip["own_height_m"] == pytest.approx(true_m, abs=0.5)
            assert hook["own_height_m"] < tip["own_height_m"] - 5.0
            stages = daemon.acquisition.pipeline.stages
            pipeline = daemon.acquisition.pipeline
            path.write_text(text.replace("pedestal_m = [20.0, -6.0, 8.0]", "pedestal_m = [20.0, -6.0, 108.0]"))
            await daemon.reload()
            assert daemon.acquisition.pipeline is pipeline, "the heave goes on"
            assert daemon.acquisition.pipeline.stages is stages
            async for record in watching(daemon, "MOTION"):
                tip, _ = record["points"]
                if tip.get("own_height_m", 0.0) > 100.0:
                    break
            path.write_text(text.replace('role = "crane"', 'role = "laser"'))
            await daemon.reload()
            assert metric(daemon, 'heaved_config_reloads_total{result="refused"}') == 1
    finally:
        await plant.stop()
