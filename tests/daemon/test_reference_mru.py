"""A daemon beside an existing MRU that speaks PASHR: stream, status, metrics, recording and replay."""

from __future__ import annotations

import asyncio
import tomllib
from typing import TYPE_CHECKING, Any

import msgspec
from running import PATIENCE_S, demo_config, get, running

from heaved.config import RecordingParams
from heaved.config.read import data_directory
from heaved.daemon.recording import recording_directory
from heaved.devices.profile import DeviceSpec, Profile
from heaved.outputs import wire
from heaved.recorder.layout import FRAMES, SAMPLES, Call
from heaved.recorder.read import frame_values, open_recorded
from heaved.recorder.tables import samples_of
from heaved.replay.live import LiveRecording, Rerun
from heaved.simulate.instruments import Instruments
from heaved.simulate.mru import MruModel
from heaved.simulate.plant import SimulatedPlant
from heaved.simulate.seaway import seaway

if TYPE_CHECKING:
    from pathlib import Path

    from heaved.samples import MotionFrame

MOUNTED = MruModel(delay_s=0.0, noise_m=0.0, noise_deg=0.0, highpass_s=0.0)


def mru(profile: str = "pashr") -> DeviceSpec:
    file = data_directory() / "devices" / f"{profile}.toml"
    read = msgspec.convert(tomllib.loads(file.read_text()), Profile)
    return DeviceSpec(name="mru", role="reference_mru", link="tcp://127.0.0.1:1", profile=read, rate_hz=20.0)


async def test_an_mru_beside_ours(tmp_path: Path) -> None:
    config = demo_config(tmp_path, recording=RecordingParams(enabled=True, vessel="Test"))
    config = msgspec.structs.replace(config, device=(*config.device, mru()))
    plant = SimulatedPlant(config.device, Instruments(seaway("S5", 1), seed=1, mru=MOUNTED), any_port=True)
    await plant.start()
    frames: list[MotionFrame] = []
    records: list[dict[str, Any]] = []
    try:
        async with (
            running(msgspec.structs.replace(config, device=plant.devices)) as daemon,
            asyncio.timeout(PATIENCE_S),
        ):
            publish = daemon.acquisition._publish

            def listen(frame: MotionFrame) -> None:
                frames.append(frame)
                publish(frame)

            daemon.acquisition._publish = listen
            reader, writer = await asyncio.open_connection(*daemon.addresses["stream"])
            writer.write(b'?WATCH={"classes":["REFERENCE"]}\n')
            while len(records) < 12:
                record = wire.decode(await reader.readline())
                records += [record] if record["class"] == "REFERENCE" else []
            writer.close()
            so_far, so_many = len(frames), len(frames) + daemon._journal.calls
            while daemon._outputs.health[0].sent < so_many:  # noqa: ASYNC110  # It is a process.
                await asyncio.sleep(0.05)
            status = daemon.status()
            daemon.keep_house()
            _, metrics = await get(daemon, "/metrics")
    finally:
        await plant.stop()
    times = [record["mono_s"] for record in records]
    assert times == sorted(set(times))
    for record in records:
        # PASHR tells hundredths of a degree; the IMU's roll has its noise.
        assert abs(record["roll"]["difference_deg"]) < 1.0
        assert record["heave"].keys() <= {"reference_m"}, "ours is not settled: it is compared with nothing"
    assert status.reference_mru is not None
    assert status.reference_mru.age_s is not None
    assert status.reference_mru.warnings == ()
    assert [device.up for device in status.devices if device.name == "mru"] == [True]
    assert 'heaved_reference_difference_radians{axis="roll",kind="latest"}' in metrics

    # What was recorded: each reading to the last bit, and each difference once.
    recorded = open_recorded(recording_directory(config), SAMPLES)
    hour = recorded.hours[0]
    (place, device) = next((i, one) for i, one in enumerate(hour.header.layout.devices) if one.name == "mru")
    assert place == 2
    assert device.sample == "MruSample"
    heaves = [
        float(value)
        for batch in hour.batches()
        for value in samples_of(device.columns, "mru", batch)[[c.name for c in device.columns].index("heave_m")]
        if value == value
    ]
    assert {record["heave"]["reference_m"] for record in records} <= {round(value, 6) for value in heaves}
    (frames_hour,) = open_recorded(recording_directory(config), FRAMES).hours
    differences = [
        float(value)
        for batch in frames_hour.batches()
        for value in frame_values(frames_hour, ["mru_roll_difference_deg"], batch)["mru_roll_difference_deg"]
        if value == value
    ]
    for record in records:
        assert min(abs(value - record["roll"]["difference_deg"]) for value in differences) < 1.1e-3

    again: list[MotionFrame] = []
    for hour, rows in LiveRecording(recording_directory(config)).runs():
        rerun = Rerun(hour, None, again.append, lambda what, result: None, None)
        for row in rows:
            assert row.call in (Call.POLL, Call.COAST)
            rerun.take(row)
    assert len(again) >= so_far
    expected = [repr(frame.reference_mru) for frame in frames]
    assert [repr(frame.reference_mru) for frame in again] == expected[: len(again)]


async def test_other_parameters_take_effect_at_once_and_are_recorded(tmp_path: Path) -> None:
    config = demo_config(tmp_path, recording=RecordingParams(enabled=True, vessel="Test"))
    config = msgspec.structs.replace(config, device=(*config.device, mru()))
    plant = SimulatedPlant(config.device, Instruments(seaway("S5", 1), seed=1, mru=MOUNTED), any_port=True)
    await plant.start()
    path = tmp_path / "heaved.toml"
    try:
        async with running(msgspec.structs.replace(config, device=plant.devices), path) as daemon:
            async with asyncio.timeout(PATIENCE_S):
                health = daemon._outputs.health[0]
                while not health.is_up or daemon.acquisition.pipeline.stages.reference_mru is None:  # noqa: ASYNC110
                    await asyncio.sleep(0.02)
            tables = f'[stream]\nport = 0\n[http]\nport = 0\n[state]\ndirectory = "{tmp_path / "state"}"\n'
            tables += '[recording]\nenabled = true\nvessel = "Test"\n[correction]\nenabled = false\n'
            devices = "".join(
                f'[[device]]\nname = "{one.name}"\nrole = "{one.role}"\nlink = "{one.link}"\n'
                f'device_id = {one.device_id}\nrate_hz = {one.rate_hz}\nprofile = "{one.profile.name}"\n'
                for one in daemon.config.device
            )
            path.write_text(f'{tables}[reference_mru]\nheave_positive = "down"\n{devices}')
            before = daemon.acquisition.pipeline.stages.reference_mru
            await daemon.reload()
            async with asyncio.timeout(PATIENCE_S):
                stages = daemon.acquisition.pipeline.stages
                while stages.reference_mru in (None, before):  # noqa: ASYNC110
                    await asyncio.sleep(0.02)
    finally:
        await plant.stop()
    calls = [row.call for _, rows in LiveRecording(recording_directory(config)).runs() for row in rows]
    assert calls.count(Call.REFERENCE_MRU) == 1
