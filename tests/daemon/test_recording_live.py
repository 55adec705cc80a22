"""A live daemon on simulated slaves, recorded and replayed: the same frames, to the last bit of every number."""

from __future__ import annotations

import asyncio
import fcntl
import os
import signal
import sys
import time
from asyncio.subprocess import DEVNULL, PIPE
from collections import Counter
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pytest
from running import PATIENCE_S, SWELL, demo_config, plant_of, running

from heaved.config import RecordingParams
from heaved.config.read import data_directory, load
from heaved.daemon import recording
from heaved.daemon.load import Relief
from heaved.daemon.recording import EXTRA, RecordingOutput, recording_directory
from heaved.daemon.state import StateFile
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser.geometry import Geometry
from heaved.estimation.heave.laser.placement import LaserPlace, SavedPlace
from heaved.estimation.heave.params import SeaParams
from heaved.estimation.heave.saved_state import SavedState
from heaved.estimation.hull import estimate as hull
from heaved.estimation.hull.remembered import SavedHull
from heaved.estimation.imu.attitude_memory import SavedAttitudeError
from heaved.estimation.motion_frame import LEFT_OUT
from heaved.outputs import wire
from heaved.recorder.files import LOCK, lock
from heaved.recorder.layout import FRAMES, Call, Settings
from heaved.recorder.messages import Kind
from heaved.recorder.read import frame_values, open_recorded
from heaved.recorder.serve import Recorder
from heaved.replay.live import LiveRecording, Rerun
from heaved.samples import TrainedNetwork
from heaved.simulate.faults import FaultKind, PlannedFault
from heaved.simulate.instruments import Instruments
from heaved.simulate.plant import SimulatedPlant
from heaved.simulate.seaway import seaway

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from heaved.config import Config
    from heaved.daemon.daemon import Daemon
    from heaved.outputs.output import OutputHealth
    from heaved.samples import MotionFrame

LEARNS_SOON: dict[str, Any] = {
    "heave": heave.Params(sea=SeaParams(first_fit_s=30.0, refresh_s=5.0)),
    "hull": hull.Params(enabled=True, start_s=2.0, refit_after_s=8.0, converged_arcsec=3600.0, gyro_noise_deg_rth=0.3),
}


# As the plant is not, so that a replay that leaves them out does not make the same.
HULL = SavedHull(
    rotation_rad=(0.02, 0.0, 0.0),
    scale=(0.0, 0.0, 0.0),
    covariance=tuple((1e-6 * np.eye(6))[np.triu_indices(6)].tolist()),
)
ERROR = SavedAttitudeError(lean_per_s=0.1, late_s=0.05, covariance=(1e-4, 0.0, 1e-4))

PLACE = SavedPlace(
    configured=Geometry(),
    geometry=Geometry(forward_m=8.0, port_m=-3.0),
    place=LaserPlace(is_elsewhere=True, ahead_m=8.0, ahead_std_m=0.1, port_m=-3.0, port_std_m=0.1),
)


def recording_config(directory: Path, **changes: Any) -> Config:
    """An IMU with gyros, a laser, a second IMU; a point on the crane needs [hull], and is left out."""
    devices = load(data_directory() / "hull.toml").device
    return demo_config(directory, device=devices, recording=RecordingParams(enabled=True, vessel="Test"), **changes)


@asynccontextmanager
async def published(
    config: Config, path: Path | None = None, *, imu_is_away_s: tuple[float, ...] = ()
) -> AsyncIterator[tuple[Daemon, list[MotionFrame]]]:
    """A daemon that records, and the frames that it publishes; its IMU is away for half a second now and then."""
    faults = [
        PlannedFault(device="imu", kind=FaultKind.DROPOUT, start_s=start, duration_s=0.5) for start in imu_is_away_s
    ]
    plant = SimulatedPlant(config.device, Instruments(seaway("S5", 1), seed=1), any_port=True, faults=faults)
    await plant.start()
    frames: list[MotionFrame] = []
    try:
        async with running(msgspec.structs.replace(config, device=plant.devices), path) as daemon:
            publish = daemon.acquisition._publish
            assert daemon.acquisition.frames == 0

            def listen(frame: MotionFrame) -> None:
                frames.append(frame)
                publish(frame)

            daemon.acquisition._publish = listen
            yield daemon, frames
    finally:
        await plant.stop()
    # On a busy machine the recorder's end may be left behind, and hands over a little later.
    if left := asyncio.all_tasks() - {asyncio.current_task()}:
        await asyncio.wait(left, timeout=PATIENCE_S)


async def until(holds: Callable[[], object]) -> None:
    async with asyncio.timeout(4.0 * PATIENCE_S):
        while not holds():  # noqa: ASYNC110  # What is waited for happens in a device, a process, a file.
            await asyncio.sleep(0.05)


def device_tables(config: Config, *roles: str) -> str:
    """``[[device]]`` as TOML, of these roles; of all, if none is named."""
    return "".join(
        f'[[device]]\nname = "{one.name}"\nrole = "{one.role}"\nlink = "{one.link}"\n'
        f'device_id = {one.device_id}\nrate_hz = {one.rate_hz}\nprofile = "{one.profile.name}"\n'
        for one in config.device
        if not roles or one.role in roles
    )


def health_of(daemon: Daemon) -> OutputHealth:
    return daemon._outputs.health[0]


def again(directory: Path) -> tuple[list[MotionFrame], Counter[Call], Counter[tuple[str, str]], list[str]]:
    """The frames that a replay makes; the calls of the recording; what became of the models; the remarks."""
    frames: list[MotionFrame] = []
    calls: Counter[Call] = Counter()
    became: Counter[tuple[str, str]] = Counter()
    take_over(directory)
    source = LiveRecording(directory)
    for hour, rows in source.runs():
        rerun = Rerun(hour, None, frames.append, lambda what, result: became.update([(what, str(result))]), None)
        for row in rows:
            calls[row.call] += 1
            rerun.take(row)
    # A recorder that had no time for its end may leave a file without a batch: its rows are in that of the next one.
    return (
        frames,
        calls,
        became,
        [one for one in source.remarks if not one.endswith("was torn before its first second")],
    )


def take_over(directory: Path) -> None:
    """As the next recorder does: on a busy machine there was no time for the end of it."""
    with (directory / LOCK).open("a") as of_the_one_before:
        fcntl.flock(of_the_one_before, fcntl.LOCK_EX)  # One that was killed is gone in a moment.
    recorder, held = Recorder(lambda _report: None, lambda: None), lock(directory)
    settings = Settings(directory=str(directory), max_bytes=1 << 40, max_age_s=1e9)
    recorder.take(Kind.SETTINGS, msgspec.json.encode(settings), 0.0)
    recorder._take_over(held)
    os.close(held)
    assert not list(directory.glob("*.handover*"))


def assert_same(found: list[MotionFrame], expected: list[MotionFrame]) -> None:
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        assert msgspec.msgpack.encode(one) == msgspec.msgpack.encode(other)


async def test_a_replay_makes_the_very_frames_that_the_daemon_published(tmp_path: Path) -> None:
    config = recording_config(tmp_path, **LEARNS_SOON)
    (tmp_path / "state").mkdir()
    learned = SavedState(sea=SWELL, hull=HULL, attitude_error=ERROR, laser_place=PLACE)
    StateFile(tmp_path / "state", SavedState).write(StateFile.encode(learned, time.time()))
    async with published(config, imu_is_away_s=(6.0, 15.0)) as (daemon, frames):
        done = daemon.acquisition
        await until(lambda: done.last_fit)
        await until(lambda: done.pipeline.stages.angles.refits if done.pipeline.stages.angles else 0)
        done.accept(TrainedNetwork(number=1, message="nothing was learned"))
        told = len(frames)
        await until(lambda: len(frames) > told + 50)
        assert done.last_fit == "accepted"
    directory = recording_directory(config)
    found, calls, became, remarks = again(directory)
    assert remarks == []
    stems = {path.name.partition(".")[0] for path in directory.glob("heaved-*")}
    assert len(stems) == len({stem[:18] for stem in stems})  # One pair an hour.
    assert calls[Call.COAST] > 20
    assert (calls[Call.RESTORED], calls[Call.REFIT]) == (1, 1)
    assert became["fits", "accepted"] >= 1
    assert became["trainings", "failed"] == 1
    assert_same(found, frames)
    # The table of frames says the same, rounded.
    heave_m: list[float] = []
    for hour in open_recorded(directory, FRAMES).hours:
        for batch in hour.batches():
            heave_m += frame_values(hour, ["heave_m"], batch)["heave_m"].tolist()
    assert heave_m == pytest.approx([frame.heave_m for frame in frames], abs=0.51e-4, nan_ok=True)
    assert any(value == value for value in heave_m)


async def test_a_replay_follows_a_new_configuration_where_the_daemon_did(tmp_path: Path) -> None:
    config, path = recording_config(tmp_path), tmp_path / "heaved.toml"
    async with published(config, path) as (daemon, frames):

        def write(text: str) -> None:
            tables = f'[stream]\nport = 0\n[http]\nport = 0\n[state]\ndirectory = "{tmp_path / "state"}"\n'
            tables += '[recording]\nenabled = true\nvessel = "Test"\n[correction]\nenabled = false\n'
            roles = ("imu", "imu2", "laser") if "laser" in text else ("imu", "imu2")
            path.write_text(tables + device_tables(daemon.config, *roles) + text)

        await until(lambda: len(frames) > 100)
        write(
            "[rock]\ndegree = 2\n[hull]\nenabled = true\nstart_s = 2.0\n[heave]\nforecast_horizons_s = [1.0]\n# laser\n"
        )
        await daemon.reload()
        assert len(daemon.config.heave.forecast_horizons_s) == 1
        await until(lambda: frames[-1].hull is not None)
        write("[rock]\ndegree = 2\n")
        await daemon.reload()
        assert not daemon.config.has_laser
        told = len(frames)
        await until(lambda: len(frames) > told + 100)
    found, calls, _, remarks = again(recording_directory(config))
    assert remarks == []
    assert calls[Call.PIPELINE] == 2
    assert calls[Call.HULL] == 2
    assert_same(found, frames)


async def test_a_replay_leaves_out_what_the_daemon_left_out(tmp_path: Path) -> None:
    """On a machine that did not keep up for a while, and read its configuration again meanwhile."""
    config, path = recording_config(tmp_path), tmp_path / "heaved.toml"
    async with published(config, path) as (daemon, frames):
        await until(lambda: health_of(daemon).is_up and len(frames) > 100)
        daemon._load.relief = Relief.LEFT_OUT
        daemon._relieve(Relief.NONE, Relief.LEFT_OUT)
        told = len(frames)
        await until(lambda: len(frames) > told + 50)
        tables = f'[stream]\nport = 0\n[http]\nport = 0\n[state]\ndirectory = "{tmp_path / "state"}"\n'
        tables += '[recording]\nenabled = true\nvessel = "Test"\n[heave]\nforecast_horizons_s = [1.0]\n'
        path.write_text(tables + device_tables(daemon.config))
        await daemon.reload()
        assert len(daemon.config.heave.forecast_horizons_s) == 1
        told = len(frames)
        await until(lambda: len(frames) > told + 50)
        daemon._relieve(Relief.LEFT_OUT, Relief.NONE)
        told = len(frames)
        await until(lambda: len(frames) > told + 50)
    assert sum(LEFT_OUT[0] in frame.quality.reasons for frame in frames) >= 100
    found, calls, _, remarks = again(recording_directory(config))
    assert remarks == []
    assert (calls[Call.RELIEVED], calls[Call.RESUMED]) == (2, 1)
    assert_same(found, frames)


async def test_other_limits_take_effect_at_once(tmp_path: Path) -> None:
    """Another process has the directory then: the first has ended, and what it had is on the disk."""
    config, path = recording_config(tmp_path), tmp_path / "heaved.toml"
    async with published(config, path) as (daemon, frames):
        first = health_of(daemon)
        await until(lambda: first.is_up)
        tables = f'[stream]\nport = 0\n[http]\nport = 0\n[state]\ndirectory = "{tmp_path / "state"}"\n'
        tables += '[recording]\nenabled = true\nvessel = "Test"\nmax_gb = 1.0\n[correction]\nenabled = false\n'
        path.write_text(tables + device_tables(daemon.config))
        await daemon.reload()
        assert health_of(daemon) is not first
        await until(lambda: health_of(daemon).is_up)
        told = len(frames)
        await until(lambda: len(frames) > told + 50)
        path.write_text(path.read_text().replace("enabled = true", "enabled = false"))
        await daemon.reload()
        assert daemon._outputs.health == []
    found, _, _, remarks = again(recording_directory(config))
    assert all("calls are missing" in remark for remark in remarks)
    assert found[-1].t_s > frames[told].t_s
    assert frames[0].t_s == found[0].t_s


async def test_a_daemon_that_is_killed_has_all_on_the_disk_but_the_last_second(tmp_path: Path) -> None:
    """A process of its own, kill -9; a client has seen what it published."""
    config, path = demo_config(tmp_path), tmp_path / "heaved.toml"
    seen_s: list[float] = []
    async with plant_of(config) as (_, config):
        tables = f'[stream]\nport = 0\n[http]\nenabled = false\n[state]\ndirectory = "{tmp_path}"\n'
        path.write_text(tables + "[recording]\nenabled = true\n" + device_tables(config))
        daemon = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "heaved", "run", "--config", str(path), stdout=PIPE, stderr=DEVNULL
        )
        try:
            assert daemon.stdout is not None
            _, where = (await daemon.stdout.readline()).decode().split()
            reader, writer = await asyncio.open_connection(*where.split(":"))
            directory = tmp_path / "recordings"
            async with asyncio.timeout(4.0 * PATIENCE_S):
                while len(seen_s) < 300 or not list(directory.glob("*.frames.arrows")):
                    record = wire.decode(await reader.readline())
                    if record["class"] == "MOTION":
                        seen_s.append(record["mono_s"])
            recorder = _recorder_of(daemon.pid)
            daemon.kill()
            await daemon.wait()
            writer.close()
            # Its end is that of the recorder's stdin, which then writes what it was given, and ends.
            await until(lambda: not Path(f"/proc/{recorder}/cmdline").exists())
        finally:
            if daemon.returncode is None:
                daemon.kill()
                await daemon.wait()
    frames, calls, _, remarks = again(directory)
    assert remarks == []
    # A second, on a machine of its own: it is killed just after its recorder has come up, which is behind then.
    assert frames[-1].t_s > seen_s[-1] - 3.0
    assert calls[Call.POLL] > len(frames)
    # Whole microseconds, as the stream tells them: half a one may be rounded to either side.
    told = {round(1e6 * frame.t_s) for frame in frames}
    assert all(round(1e6 * t_s) in told for t_s in seen_s if t_s <= frames[-1].t_s)


async def test_a_recorder_that_is_killed_is_started_again_and_the_stream_goes_on(tmp_path: Path) -> None:
    config = recording_config(tmp_path)
    async with published(config) as (daemon, frames):
        health = health_of(daemon)
        await until(lambda: health.is_up)
        told = health.sent
        await until(lambda: health.sent > told)
        os.kill(_recorder_of(os.getpid()), signal.SIGKILL)
        await until(lambda: not health.is_up)
        assert "the recorder has ended" in health.detail
        told = len(frames)
        await until(lambda: health.is_up and health.sent > 400)
        assert len(frames) > told
    # What it had been given, and had not written, the next one was given again; what it had written stands there once.
    found, _, _, remarks = again(recording_directory(config))
    assert [remark for remark in remarks if "torn" not in remark] == []
    assert_same(found, frames)
    assert not any(health.lost.values())


async def test_a_recorder_that_takes_nothing_costs_the_daemon_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is stopped, as one whose disk hangs: what does not fit is lost, and counted."""
    monkeypatch.setattr(recording, "MOST_KEPT_BYTES", 100_000)
    config = recording_config(tmp_path)
    async with published(config) as (daemon, frames):
        health = health_of(daemon)
        await until(lambda: health.is_up)
        child = _recorder_of(os.getpid())
        os.kill(child, signal.SIGSTOP)
        await until(lambda: health.lost["full"])
        told = len(frames)
        await until(lambda: len(frames) > told + 100)
        os.kill(child, signal.SIGCONT)
        lost = health.lost["full"]
        told = len(frames)
        await until(lambda: len(frames) > told + 300)
        assert health.lost["full"] < lost + 2000
    _, _, _, remarks = again(recording_directory(config))
    assert any("calls are missing" in remark for remark in remarks)


async def test_a_recorder_that_cannot_end_in_time_leaves_the_rest_to_the_next(tmp_path: Path) -> None:
    """It hangs, and is killed: what it was given is as good as what it was not."""
    config = recording_config(tmp_path)
    async with published(config) as (daemon, frames):
        health = health_of(daemon)
        await until(lambda: health.sent > 100)
        os.kill(_recorder_of(os.getpid()), signal.SIGSTOP)
        told = len(frames)
        await until(lambda: len(frames) > told + 150)
    await until(lambda: list(recording_directory(config).glob("*.handover")))
    assert any("had no time for" in remark for remark in LiveRecording(recording_directory(config)).remarks)
    async with published(config) as (daemon, _):
        await until(lambda: health_of(daemon).is_up)
    assert_same(rerun_of_the_first(recording_directory(config)), frames)


async def test_what_ends_every_recorder_is_not_given_to_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It reads what it is given and ends, each time: rows are counted as lost, and what comes later has its chance."""
    monkeypatch.setattr(recording, "FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr(recording, "LONGEST_PAUSE_S", 0.01)
    ends = 'import os; print(\'{"is_up":false,"has_begun":true}\', flush=True); '
    ends += "[os.read(0, 100) for _ in range(20)]"
    made = partial(RecordingOutput, command=(sys.executable, "-c", ends))
    monkeypatch.setattr(recording, "RecordingOutput", made)
    async with published(recording_config(tmp_path)) as (daemon, _):
        await until(lambda: health_of(daemon).lost["given_up"] > 0)


@pytest.mark.parametrize("command", ["import time; time.sleep(100)", "raise SystemExit('no memory')"])
async def test_a_daemon_that_stops_before_its_recorder_has_begun_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """One that still loads, and one that does not start: the next one has the rows."""
    config = recording_config(tmp_path)
    with monkeypatch.context() as patch:
        made = partial(RecordingOutput, command=(sys.executable, "-c", command))
        patch.setattr(recording, "RecordingOutput", made)
        async with published(config) as (_, frames):
            await until(lambda: len(frames) > 150)
    assert len(list(recording_directory(config).iterdir())) == 1
    async with published(config) as (daemon, _):
        await until(lambda: health_of(daemon).is_up)
    assert_same(rerun_of_the_first(recording_directory(config)), frames)


def rerun_of_the_first(directory: Path) -> list[MotionFrame]:
    """The frames of the first of the runs that a directory holds, made again."""
    take_over(directory)
    source = LiveRecording(directory)
    assert [remark for remark in source.remarks if "torn" not in remark] == []
    emitted: list[MotionFrame] = []
    hour, rows = next(iter(source.runs()))
    rerun = Rerun(hour, None, emitted.append, lambda what, result: None, None)
    for row in rows:
        rerun.take(row)
    return emitted


async def test_without_the_extra_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "has_extra", lambda: False)
    async with published(recording_config(tmp_path)) as (daemon, frames):
        await until(lambda: len(frames) > 20)
        assert EXTRA in health_of(daemon).detail
        assert not health_of(daemon).is_up


def _recorder_of(parent: int) -> int:
    """The child of ours that records."""
    for pid in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
        if b"heaved.recorder.serve" in Path(f"/proc/{pid}/cmdline").read_bytes():
            return int(pid)
    raise AssertionError("no recorder runs")
