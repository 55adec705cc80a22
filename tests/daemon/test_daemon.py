"""The daemon in one process with a simulated plant: start, what it says, reload, stop, start again."""

from __future__ import annotations

import asyncio
import json
import socket
from contextlib import closing
from datetime import datetime
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from running import (
    HARMONIC,
    SEA,
    demo_config,
    frames_of,
    get,
    median_period_s,
    metric,
    plant_of,
    running,
    stream_of,
    until,
)
from structlog.testing import capture_logs

from heaved.config import Config, HttpParams, StreamParams
from heaved.daemon.daemon import Daemon
from heaved.daemon.sdnotify import Notifier
from heaved.daemon.supervise import supervise
from heaved.samples import (
    CorrectionState,
    DelayedHeave,
    HeaveState,
    LaserState,
    MotionFrame,
    Quality,
    SeaState,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from heaved.devices.bus import PollResult
    from heaved.estimation.heave import params as heave
    from heaved.estimation.heave.saved_state import SavedState


async def test_frames_flow_at_the_rate_of_the_imu(tmp_path: Path) -> None:
    async with plant_of(demo_config(tmp_path)) as (_, config), running(config) as daemon:
        async with asyncio.timeout(20), stream_of(daemon) as records:
            assert (await anext(records))["class"] == "VERSION"
            frames = [await anext(records) for _ in range(200)]
        assert [frame["seq"] for frame in frames] == list(range(frames[0]["seq"], frames[0]["seq"] + 200))
        assert median_period_s(frames) == pytest.approx(0.01, rel=0.3)
        assert all(frame["dropped"] == 0 and 0.0 <= frame["age_s"] < 1.0 for frame in frames)
        assert metric(daemon, 'heaved_polls_total{device="imu",result="none"}') > 100


async def test_status_knows_it_all(tmp_path: Path) -> None:
    async with plant_of(demo_config(tmp_path)) as (_, config), running(config) as daemon:
        await until(daemon, lambda record: record["seq"] > 250)
        reader, writer = await asyncio.open_connection(*daemon.addresses["stream"])
        writer.write(b'?WATCH={"classes":[]}\n?STATUS\n')
        while (record := json.loads(await reader.readline()))["class"] != "STATUS":
            pass
        writer.close()
    assert record["frames"] > 250
    assert record["rate_hz"] == pytest.approx(100.0, rel=0.5)  # Measured: a busy machine skips some.
    assert {device["name"]: device["up"] for device in record["devices"]} == {"imu": True, "laser": True}
    assert record["devices"][0]["wanted_rate_hz"] == 100.0
    assert record["observer"]["name"] == "sea"
    assert record["clock"]["steps"] == 0
    assert record["state_file"] == str(tmp_path / "state" / "state.json")
    assert record["quality"]["heave"] == "settling"


async def test_who_watches_status_gets_it_without_asking(tmp_path: Path) -> None:
    async with running(demo_config(tmp_path, device=())) as daemon:
        reader, writer = await asyncio.open_connection(*daemon.addresses["stream"])
        writer.write(b'?WATCH={"classes":["STATUS"]}\n')
        for _ in range(2):
            while (record := json.loads(await reader.readline()))["class"] != "STATUS":
                pass
        writer.close()
    assert record["devices"] == []


async def test_sea_and_delayed_heave_are_sent_once_each_to_who_watches_them(tmp_path: Path) -> None:
    state = SeaState(
        significant_height_m=2.5, peak_period_s=9.0, mean_period_s=7.5, systems=(), frequencies_hz=(0.1,),
        spectrum_m2phz=(3.0,), t_s=40.0, window_s=300.0,
    )  # fmt: skip
    async with running(demo_config(tmp_path, device=())) as daemon:
        reader, writer = await asyncio.open_connection(*daemon.addresses["stream"])

        async def until_status() -> list[dict[str, Any]]:
            writer.write(b"?STATUS\n")
            records: list[dict[str, Any]] = []
            while not records or records[-1]["class"] != "STATUS":
                records.append(json.loads(await reader.readline()))
            return records[:-1]

        writer.write(b'?WATCH={"classes":["SEA","DELAYED"]}\n')
        await until_status()
        early, late = (DelayedHeave(t_s=40.0 + k, heave_m=-0.5 * k, std_m=0.01) for k in (1, 2))
        for number, delayed in enumerate((early, early, late)):
            quality = Quality(heave=HeaveState.VALID, laser=LaserState.OFF, correction=CorrectionState.OFF)
            frame = MotionFrame(t_s=100.0 + number, quality=quality, sea=state, delayed=delayed)
            daemon._publish(frame)
            daemon.acquisition.last_frame = frame
            daemon.keep_house()
        records = await until_status()
        writer.close()
        assert [record["class"] for record in records] == ["DELAYED", "SEA", "DELAYED"]
        first, sea, second = records
        assert [(record["mono_s"], record["heave_m"], record["std_m"]) for record in (first, second)] == [
            (41.0, -0.5, 0.01), (42.0, -1.0, 0.01),
        ]  # fmt: skip
        # Each at its own time of validity.
        assert utc_s(second["time"]) - utc_s(first["time"]) == pytest.approx(1.0, abs=1e-5)
        assert utc_s(first["time"]) - utc_s(sea["time"]) == pytest.approx(1.0, abs=1e-5)
        assert (sea["significant_height_m"], sea["spectrum_m2phz"], sea["window_s"]) == (2.5, [3.0], 300.0)
        assert metric(daemon, "heaved_delayed_heave_meters") == -1.0
        assert metric(daemon, "heaved_peak_period_seconds") == 9.0


def utc_s(text: str) -> float:
    return datetime.fromisoformat(text).timestamp()


async def test_http_says_alive_and_not_yet_ready_without_sensors(tmp_path: Path) -> None:
    async with running(demo_config(tmp_path, device=())) as daemon:
        await until(daemon, lambda record: True)
        status, body = await get(daemon, "/healthz")
        assert (status, json.loads(body)["alive"]) == (200, True)
        status, body = await get(daemon, "/readyz")
        assert (status, json.loads(body)["ready"]) == (503, False)
        status, body = await get(daemon, "/metrics")
        assert status == 200
        assert 'heaved_quality{state="invalid"} 1.0' in body


async def test_without_devices_the_stream_runs_at_ten_hertz(tmp_path: Path) -> None:
    async with running(demo_config(tmp_path, device=())) as daemon:
        frames = await frames_of(daemon, 11)
        assert median_period_s(frames) == pytest.approx(0.1, rel=0.3)
        assert all(frame["quality"]["heave"] == "invalid" and "heave_m" not in frame for frame in frames)


async def test_http_off(tmp_path: Path) -> None:
    async with running(demo_config(tmp_path, http=HttpParams(enabled=False), device=())) as daemon:
        assert list(daemon.addresses) == ["stream"]


# ---- state -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("params", "learned", "frequency_hz"), [(*HARMONIC[:2], 0.0987), (*SEA[:2], 0.2)])
async def test_a_restart_remembers(
    tmp_path: Path, params: heave.Params, learned: SavedState, frequency_hz: float
) -> None:
    config = demo_config(tmp_path, device=(), heave=params)
    async with running(config) as daemon:
        assert daemon.acquisition.pipeline.state() != learned
        daemon.acquisition.pipeline.restore(learned)
    async with running(config) as daemon:
        assert daemon.acquisition.pipeline.state() == learned
        observer = daemon.status().observer
        assert observer is not None
        assert observer.frequencies_hz == (frequency_hz,)
        assert metric(daemon, 'heaved_state_loads_total{result="restored"}') == 1


async def test_the_state_is_saved_now_and_then(tmp_path: Path) -> None:
    state = msgspec.structs.replace(demo_config(tmp_path).state, save_period_s=1.0)
    async with running(demo_config(tmp_path, device=(), state=state)) as daemon:
        await until(daemon, lambda record: metric(daemon, 'heaved_state_saves_total{result="saved"}') >= 1)
        saved = daemon.memory.file.read()
        assert saved is not None
        assert saved.state == daemon.acquisition.pipeline.state()


# ---- reload ----------------------------------------------------------------------------------------------------------


def to_toml(config: Config) -> str:
    """A configuration file of the tables that these tests change."""
    lines = []
    for device in config.device:
        lines += ["[[device]]", *(f"{key} = {json.dumps(getattr(device, key))}" for key in ("name", "role", "link"))]
        lines += [f"device_id = {device.device_id}", f"rate_hz = {device.rate_hz}"]
        lines += [f'profile = "{device.profile.name}"']
    lines += ["[stream]", f"port = {config.stream.port}", "[http]", f"port = {config.http.port}"]
    lines += ["[state]", f"directory = {json.dumps(config.state.directory)}", "[correction]", "enabled = false"]
    lines += ["[heave]", f'observer = "{config.heave.observer}"', f"components = {config.heave.components}"]
    return "\n".join([*lines, "[heave.sea]", f"stages = {config.heave.sea.stages}", ""])


async def test_reload_restarts_only_what_has_changed(tmp_path: Path) -> None:
    path = tmp_path / "heaved.toml"
    async with plant_of(demo_config(tmp_path)) as (_, config):
        path.write_text(to_toml(config))
        async with running(config, path) as daemon:
            pipeline = daemon.acquisition.pipeline
            await until(daemon, lambda record: record["seq"] > 20)

            await daemon.reload()  # Nothing has changed.
            assert daemon.acquisition.pipeline is pipeline

            imu, _ = config.device
            slower = msgspec.structs.replace(imu, rate_hz=50.0)
            path.write_text(to_toml(msgspec.structs.replace(config, device=(slower,))))
            await daemon.reload()
            polls = metric(daemon, 'heaved_polls_total{device="laser"')
            assert daemon.config.device == (slower,)
            assert daemon.acquisition.pipeline is not pipeline  # There is no laser any more.
            await until(daemon, lambda record: record["quality"]["laser"] == "off")
            assert median_period_s(await frames_of(daemon, 51)) == pytest.approx(0.02, rel=0.3)
            assert metric(daemon, 'heaved_polls_total{device="laser"') == polls
            assert metric(daemon, 'heaved_config_reloads_total{result="applied"}') == 2


async def test_reload_turns_a_sensor_and_begins_to_estimate_anew(tmp_path: Path) -> None:
    path = tmp_path / "heaved.toml"
    async with plant_of(demo_config(tmp_path)) as (_, config):
        path.write_text(to_toml(config))
        async with running(config, path) as daemon:
            before = await until(daemon, lambda record: "yaw_deg" in record)
            pipeline = daemon.acquisition.pipeline
            # Its x axis to port: the vessel heads a quarter of a turn further to starboard than it does.
            path.write_text(to_toml(config).replace("[[device]]", "[[device]]\nrotation_deg = [0.0, 0.0, 90.0]", 1))
            await daemon.reload()
            assert daemon.acquisition.pipeline is not pipeline
            wanted = (before["yaw_deg"] + 90.0) % 360.0
            await until(daemon, lambda record: abs(record.get("yaw_deg", 1e9) - wanted) < 5.0)


@pytest.mark.parametrize(("params", "learned", "other"), [HARMONIC, SEA])
async def test_reload_of_an_estimator_keeps_what_was_learned(
    tmp_path: Path, params: heave.Params, learned: SavedState, other: dict[str, Any]
) -> None:
    path = tmp_path / "heaved.toml"
    config = demo_config(tmp_path, device=(), heave=params)
    async with running(config, path) as daemon:
        daemon.acquisition.pipeline.restore(msgspec.structs.replace(learned, lead_learned_s=0.125))
        laser = msgspec.structs.replace(config.laser, sign=-1)
        path.write_text(to_toml(config) + "[laser]\nsign = -1\n")
        await daemon.reload()
        assert daemon.config.laser == laser
        assert daemon.acquisition.pipeline.state() == msgspec.structs.replace(learned, lead_learned_s=0.125)
        with capture_logs() as logs:
            path.write_text(to_toml(msgspec.structs.replace(config, heave=msgspec.structs.replace(params, **other))))
            await daemon.reload()
        assert any("start cold" in line["event"] for line in logs)
        frame = await until(daemon, lambda record: True)
        assert frame["quality"]["heave"] == "invalid"


async def test_a_fitter_runs_for_the_observer_that_needs_it_and_only_then(tmp_path: Path) -> None:
    path = tmp_path / "heaved.toml"
    sea = demo_config(tmp_path, device=())
    harmonic = msgspec.structs.replace(sea, heave=HARMONIC[0])
    async with running(sea, path) as daemon:
        first = daemon.workers.running["fitter"]
        for config, name in ((harmonic, "harmonic"), (sea, "sea")):
            path.write_text(to_toml(config))
            await daemon.reload()
            assert ("fitter" in daemon.workers.running) == (name == "sea")
            observer = daemon.status().observer
            assert observer is not None
            assert observer.name == name
        assert daemon.workers.running["fitter"] is not first
        await until(daemon, lambda record: True)


async def test_reload_says_what_needs_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "heaved.toml"
    config = demo_config(tmp_path, device=())
    path.write_text(to_toml(msgspec.structs.replace(config, stream=StreamParams(port=5999))))
    async with running(config, path) as daemon:
        for _ in range(2):  # It is still true the second time.
            with capture_logs() as logs:
                await daemon.reload()
            assert [line["event"] for line in logs if line["log_level"] == "warning"] == [
                "[stream] has changed: restart the daemon to bring it into force"
            ]
        assert daemon.config.stream == config.stream


# ---- service manager -------------------------------------------------------------------------------------------------


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as receiver:
        receiver.bind(str(tmp_path / "notify"))
        receiver.setblocking(False)
        yield receiver


def received(manager: socket.socket) -> list[str]:
    messages = []
    while True:
        try:
            messages.append(manager.recv(4096).decode())
        except BlockingIOError:
            return messages


async def test_what_the_service_manager_is_told(tmp_path: Path, manager: socket.socket) -> None:
    path = tmp_path / "heaved.toml"
    config = demo_config(tmp_path, device=())
    path.write_text("[heave]\ncomponents = 99\n")
    notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "1000000"})
    async with running(config, path, notifier=notifier) as daemon:
        await until(daemon, lambda record: record["seq"] > 15)
        told = received(manager)
        assert told[0].startswith("READY=1")
        assert any(message.startswith("STATUS=heave invalid, ") and "no devices" in message for message in told)
        # 250 ms apart at most: four chances before a second is over.
        assert told.count("WATCHDOG=1") >= 2
        await daemon.reload()
        told = received(manager)
        begun = next(message for message in told if message.startswith("RELOADING=1\nMONOTONIC_USEC="))
        assert told.index("READY=1") > told.index(begun)
    assert received(manager)[-1].startswith("STOPPING=1")


async def test_the_watchdog_starves_when_no_frame_is_made(
    tmp_path: Path, manager: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "40000"})
    async with running(demo_config(tmp_path, device=()), notifier=notifier) as daemon:
        await until(daemon, lambda record: record["seq"] > 5)
        assert "WATCHDOG=1" in received(manager)

        def broken(t_s: float) -> None:
            raise FloatingPointError("a bug")

        monkeypatch.setattr(daemon.acquisition.pipeline, "coast", broken)
        frames = daemon.acquisition.frames
        received(manager)
        for _ in range(10):
            daemon.acquisition.heartbeat()
            daemon._feed_watchdog()
        assert daemon.acquisition.frames == frames
        assert "WATCHDOG=1" not in received(manager)[1:]


# ---- supervision -----------------------------------------------------------------------------------------------------


async def test_a_task_that_fails_is_said_and_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heaved.daemon.supervise.FIRST_PAUSE_S", 0.0)
    lives = []
    done = asyncio.Event()

    async def run() -> None:
        lives.append(1)
        if len(lives) == 3:
            done.set()
            await asyncio.Event().wait()
        raise RuntimeError("out of luck")

    with capture_logs() as logs:
        task = asyncio.create_task(supervise("poll", run))
        await asyncio.wait_for(done.wait(), 10)
        task.cancel()
        await asyncio.wait([task])
    assert [line["event"] for line in logs] == ["task failed: starting it again"] * 2
    assert all(line["task"] == "poll" and str(line["exc_info"]) == "out of luck" for line in logs)


async def test_a_bus_that_fails_is_polled_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The callback of a bus never raises; if a bug lets it, the bus comes back."""
    async with plant_of(demo_config(tmp_path)) as (_, config):
        daemon = Daemon(config)
        on_poll = daemon.acquisition.on_poll
        failures: list[PollResult] = []

        def fail_once(result: PollResult) -> None:
            if not failures:
                failures.append(result)
                raise RuntimeError("a bug")
            on_poll(result)

        monkeypatch.setattr(daemon.acquisition, "on_poll", fail_once)
        await daemon.start()
        try:
            await until(daemon, lambda record: daemon.status().devices[0].up and daemon.status().devices[1].up)
        finally:
            await daemon.stop()
        assert failures


async def test_frames_carry_utc_of_validity(tmp_path: Path) -> None:
    frames = []
    async with running(demo_config(tmp_path, device=()), realtime=lambda: 1_767_225_600.0) as daemon:
        record = await until(daemon, lambda record: True)
        frames.append(daemon.acquisition.last_frame)
        assert record["time"].startswith("2026-01-01T00:00:00.") or record["time"].startswith("2025-12-31T23:59:59.")
    assert isinstance(frames[0], MotionFrame)
