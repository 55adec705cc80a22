"""What goes wrong on a ship: each fault has a message and a metric, and the daemon stays up."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import itertools
import math
import os
import signal
import socket
import sys
from collections.abc import AsyncIterator, Callable, MutableMapping, Sequence
from contextlib import asynccontextmanager, closing
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from running import (
    HARMONIC,
    PATIENCE_S,
    SEA,
    SWELL,
    Record,
    demo_config,
    get,
    metric,
    plant_of,
    running,
    stream_of,
    until,
)
from structlog.testing import capture_logs

from heaved.config import HttpParams, StreamParams
from heaved.daemon import daemon as daemon_module
from heaved.daemon.daemon import Daemon, run
from heaved.daemon.realtime import set_real_time
from heaved.daemon.state import StateFile
from heaved.estimation.heave.saved_state import SavedState
from heaved.outputs.listen import ListenError
from heaved.pipeline import Pipeline
from heaved.samples import CorrectionState, HeaveState, LaserState, MotionFrame, Quality
from heaved.simulate.faults import FaultKind, PlannedFault
from heaved.workers.process import Worker

if TYPE_CHECKING:
    from asyncio.subprocess import Process

    from heaved.estimation.heave import params as heave
    from heaved.simulate.plant import SimulatedPlant
    from heaved.workers.jobs import Job

Logs = Sequence[MutableMapping[str, Any]]
"""What structlog has captured."""

FOR_EVER_S = 1e6


def fault(kind: FaultKind, plant: SimulatedPlant, device: str = "imu") -> PlannedFault:
    """From now on, until the plant's plan is cleared."""
    return PlannedFault(device=device, kind=kind, start_s=plant.time_s(), duration_s=FOR_EVER_S)


def events(logs: Logs, level: str = "warning") -> list[str]:
    return [line["event"] for line in logs if line["log_level"] == level]


# ---- ports -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("table", ["stream", "http"])
async def test_a_port_in_use(tmp_path: Path, table: str) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = taken.getsockname()[1]
        params = {"stream": StreamParams(port=port), "http": HttpParams(port=port)}[table]
        daemon = Daemon(demo_config(tmp_path, **{table: params}))
        with pytest.raises(ListenError) as failure:
            await daemon.start()
    assert f"[{table}]" in str(failure.value)
    assert f"127.0.0.1:{port}" in str(failure.value)
    assert "in use" in str(failure.value)
    assert not (tmp_path / "state").exists()  # The other daemon's state is not touched.


def test_a_port_in_use_ends_the_process_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = taken.getsockname()[1]
        assert run(demo_config(tmp_path, stream=StreamParams(port=port)), None, log_format="human") == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert f"127.0.0.1:{port}" in printed.err


# ---- devices ---------------------------------------------------------------------------------------------------------


async def test_absent_at_the_start_then_plugged_in(tmp_path: Path) -> None:
    async with plant_of(demo_config(tmp_path)) as (plant, config):
        await plant.stop()
        with capture_logs() as logs:
            async with running(config) as daemon:
                first = await until(daemon, lambda _record: not daemon.status().devices[0].up)
                await until(daemon, lambda _record: events(logs).count("device down") == 2)
                assert first["quality"]["heave"] == "invalid"
                assert metric(daemon, 'heaved_device_up{device="imu"}') == 0
                await plant.start()
                await until(daemon, lambda record: record["quality"]["heave"] == "settling")
                await until(daemon, lambda _record: events(logs, "info").count("device back") == 2)
                assert metric(daemon, 'heaved_device_up{device="imu"}') == 1
    down = next(line for line in logs if line["event"] == "device down")
    assert down["fault"] == "disconnected"
    assert "refused" in down["detail"]
    assert events(logs).count("device down") == 2


async def test_unplugged_and_back(tmp_path: Path) -> None:
    async with plant_of(demo_config(tmp_path)) as (plant, config):
        with capture_logs() as logs:
            async with running(config) as daemon:
                await until(daemon, lambda record: record["quality"]["heave"] == "settling")
                plant.inject(fault(FaultKind.DISCONNECT, plant))
                away = await until(daemon, lambda record: record["quality"]["heave"] == "invalid")
                # The laser is on another bus and knows nothing of it.
                good = metric(daemon, 'heaved_polls_total{device="laser",result="none"}')
                await until(daemon, lambda record: record["mono_s"] > away["mono_s"] + 0.5)
                assert metric(daemon, 'heaved_polls_total{device="laser",result="none"}') >= good + 5
                assert metric(daemon, 'heaved_device_up{device="imu"}') == 0
                plant.clear()
                await until(daemon, lambda record: record["quality"]["heave"] == "settling")
                await until(daemon, lambda _record: "device back" in events(logs, "info"))
                assert metric(daemon, 'heaved_reconnects_total{device="imu"}') == 1
    assert events(logs).count("device down") == 1


async def test_a_pipeline_that_stops_is_seen(tmp_path: Path) -> None:
    """By who asks whether it is ready, and by who looks at gauges: no value stands still."""
    late_s = [0.0]
    now = asyncio.get_running_loop().time
    async with running(demo_config(tmp_path, device=()), clock=lambda: now() + late_s[0]) as daemon:
        await until(daemon, lambda _record: True)
        quality = Quality(heave=HeaveState.VALID, laser=LaserState.VALID, correction=CorrectionState.ACTIVE)
        frame = MotionFrame(t_s=now(), quality=quality, heave_m=1.0, heave_std_m=0.1, lead_s=0.0, reference_m=1.0)
        daemon.acquisition.last_frame = frame
        daemon.metrics.record_frame(frame, age_s=0.0, step_s=0.0)
        daemon._heartbeat.stop()
        assert (await get(daemon, "/readyz"))[0] == 200
        daemon.keep_house()
        assert metric(daemon, "heaved_heave_meters") == 1.0
        late_s[0] = 10.0
        status, body = await get(daemon, "/readyz")
        assert status == 503
        assert "last frame is 1" in body
        daemon.keep_house()
        assert math.isnan(metric(daemon, "heaved_heave_meters"))
        assert metric(daemon, 'heaved_quality{state="valid"}') == 0
        assert metric(daemon, 'heaved_quality{state="invalid"}') == 1


@pytest.mark.parametrize(
    ("kind", "result"),
    [
        (FaultKind.NAN, "not_finite"),
        (FaultKind.EXCEPTION, "exception"),
        (FaultKind.DROPOUT, "timeout"),
    ],
)
async def test_bad_answers_end_to_end(tmp_path: Path, kind: FaultKind, result: str) -> None:
    """No nan, no stale value, no gap in the stream: an invalid heave that says why, and then a good one again."""
    async with plant_of(demo_config(tmp_path)) as (plant, config), running(config) as daemon:
        await until(daemon, lambda record: record["quality"]["heave"] == "settling")
        frames: list[Record] = []
        plant.inject(fault(kind, plant))
        async with asyncio.timeout(PATIENCE_S), stream_of(daemon) as records:
            assert (await anext(records))["class"] == "VERSION"
            while not frames or frames[-1]["quality"]["heave"] != "invalid":
                frames.append(await anext(records))
            assert "heave_m" not in frames[-1]
            assert result in " ".join(frames[-1]["quality"]["reasons"])
            assert metric(daemon, f'heaved_polls_total{{device="imu",result="{result}"}}') > 0
            plant.clear()
            while frames[-1]["quality"]["heave"] == "invalid":
                frames.append(await anext(records))
        steps = [after["seq"] - before["seq"] for before, after in itertools.pairwise(frames)]
        assert set(steps) == {1}
        assert all(after["mono_s"] > before["mono_s"] for before, after in itertools.pairwise(frames))


async def test_garbage_on_a_serial_line(tmp_path: Path) -> None:
    config = demo_config(tmp_path)
    imu = msgspec.structs.replace(config.device[0], link=f"rtu://{tmp_path}/imu?baudrate=921600", rate_hz=50.0)
    async with plant_of(msgspec.structs.replace(config, device=(imu,))) as (plant, config), running(config) as daemon:
        await until(daemon, lambda record: record["quality"]["heave"] == "settling")
        plant.inject(fault(FaultKind.GARBAGE, plant))
        bad = await until(daemon, lambda record: record["quality"]["heave"] == "invalid")
        assert metric(daemon, 'heaved_polls_total{device="imu",result="crc"}') > 0
        assert "heave_m" not in bad
        plant.clear()
        await until(daemon, lambda record: record["quality"]["heave"] == "settling")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open every port")
async def test_no_permission_on_the_serial_port(tmp_path: Path) -> None:
    port = tmp_path / "ttyUSB0"
    port.touch(mode=0o000)
    await check_forbidden_port(tmp_path, port)


async def test_permission_refused_by_the_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same for root, to whom the system would not refuse it."""
    port = tmp_path / "ttyUSB0"
    port.touch()
    really_open = os.open

    def refuse(path: str | Path, *args: Any, **kwargs: Any) -> int:
        if str(path) == str(port):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return really_open(path, *args, **kwargs)

    monkeypatch.setattr(os, "open", refuse)
    await check_forbidden_port(tmp_path, port)


async def check_forbidden_port(tmp_path: Path, port: Path) -> None:
    config = demo_config(tmp_path)
    imu = msgspec.structs.replace(config.device[0], link=f"rtu://{port}?baudrate=115200")
    with capture_logs() as logs:
        async with running(msgspec.structs.replace(config, device=(imu,))) as daemon:
            await until(daemon, lambda _record: "device down" in events(logs))
            assert "dialout" in daemon.status().devices[0].detail
    line = next(line for line in logs if line["event"] == "device down")
    assert str(port) in line["detail"]
    assert "dialout" in line["detail"]


# ---- clock -----------------------------------------------------------------------------------------------------------


async def test_a_clock_step_of_an_hour_changes_no_estimate(tmp_path: Path) -> None:
    """The published UTC follows, monotonic time goes on, and the filters see nothing of it."""
    now = asyncio.get_running_loop().time
    offset_s = [1_767_225_600.0]
    async with (
        plant_of(demo_config(tmp_path)) as (_, config),
        running(config, realtime=lambda: now() + offset_s[0]) as daemon,
    ):
        before = await until(daemon, lambda record: record["quality"]["heave"] == "settling")
        offset_s[0] += 3600.0
        with capture_logs() as logs:
            daemon.keep_house()
        after = await until(daemon, lambda record: record["seq"] > before["seq"] + 20)
        assert metric(daemon, "heaved_clock_steps_total") == 1
        assert [line["step_s"] for line in logs] == [pytest.approx(3600.0, abs=0.01)]
        mono_s = after["mono_s"] - before["mono_s"]
        assert 0.0 < mono_s < PATIENCE_S
        assert utc_s(after) - utc_s(before) == pytest.approx(mono_s + 3600.0, abs=0.01)
        assert metric(daemon, 'heaved_filter_resets_total{filter="heave"') == 0
        clock = daemon.status().clock
        assert clock is not None
        assert clock.steps == 1
        assert daemon.acquisition.pipeline.summary().out_of_order == 0


def utc_s(record: Record) -> float:
    return datetime.fromisoformat(record["time"]).timestamp()


# ---- state -----------------------------------------------------------------------------------------------------------


async def test_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(fd: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with capture_logs() as logs:
        async with running(demo_config(tmp_path, device=())) as daemon:
            await daemon.memory.save()
            content = daemon.memory.file.path.read_bytes()
            monkeypatch.setattr("heaved.daemon.state.os.fsync", full)
            await daemon.memory.save()
            await daemon.memory.save()
            await until(daemon, lambda _record: True)
            assert metric(daemon, 'heaved_state_saves_total{result="failed"}') == 2
            assert daemon.memory.file.path.read_bytes() == content
    assert events(logs) == ["the state cannot be saved"]


async def test_a_corrupt_state(tmp_path: Path) -> None:
    config = demo_config(tmp_path, device=())
    (tmp_path / "state").mkdir()
    (tmp_path / "state" / "state.json").write_text('{"version":1,"sha')
    with capture_logs() as logs:
        async with running(config) as daemon:
            await until(daemon, lambda _record: True)
            assert metric(daemon, 'heaved_state_loads_total{result="refused"}') == 1
    line = next(line for line in logs if line["log_level"] == "warning")
    assert line["kept"] == str(tmp_path / "state" / "state.corrupt")
    assert (tmp_path / "state" / "state.corrupt").read_text() == '{"version":1,"sha'


NOWHERE = msgspec.structs.replace(SWELL, frequency_hz=(1e300,))


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (StateFile.encode(SavedState(sea=NOWHERE)), "holds nonsense: frequency of the sea 1e+300 Hz"),
        (StateFile.encode(SavedState(), 4e9), "ahead of this machine's clock"),
        (b'{"version":4}', "is of version 4, this release reads 2 and 3"),
        (b"[" * 100_000, "is damaged"),
    ],
)
async def test_a_state_of_nonsense(tmp_path: Path, content: bytes, reason: str) -> None:
    """Set aside, named, and no reason not to start."""
    (tmp_path / "state").mkdir()
    (tmp_path / "state" / "state.json").write_bytes(content)
    with capture_logs() as logs:
        async with running(demo_config(tmp_path, device=())) as daemon:
            await until(daemon, lambda _record: True)
            assert metric(daemon, 'heaved_state_loads_total{result="refused"}') == 1
    line = next(line for line in logs if line["log_level"] == "warning")
    assert reason in line["reason"]
    assert line["file"] == str(tmp_path / "state" / "state.json")
    assert (tmp_path / "state" / "state.corrupt").read_bytes() == content


async def test_a_state_that_an_estimator_stumbles_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever it raises, the daemon starts, and with new estimators."""

    def stumble(self: Any, state: SavedState, age_s: float) -> None:
        self.stumbled = True
        raise ZeroDivisionError("float division by zero")

    monkeypatch.setattr(Pipeline, "restore", stumble)
    config = demo_config(tmp_path, device=())
    StateFile(tmp_path / "state", SavedState).write(StateFile.encode(SEA[1]))
    with capture_logs() as logs:
        async with running(config) as daemon:
            await until(daemon, lambda _record: True)
            assert not hasattr(daemon.acquisition.pipeline, "stumbled")
    assert "ZeroDivisionError" in next(line for line in logs if "reason" in line)["reason"]


@pytest.mark.parametrize(("params", "learned", "other"), [HARMONIC, SEA])
async def test_a_state_of_other_parameters(
    tmp_path: Path, params: heave.Params, learned: SavedState, other: dict[str, Any]
) -> None:
    config = demo_config(tmp_path, device=(), heave=params)
    async with running(config) as daemon:
        daemon.acquisition.pipeline.restore(learned)
    heave = msgspec.structs.replace(params, **other)
    with capture_logs() as logs:
        async with running(msgspec.structs.replace(config, heave=heave)) as daemon:
            await until(daemon, lambda _record: True)
    assert "does not fit this configuration" in next(line for line in logs if "reason" in line)["reason"]


# ---- trainer and fitter ----------------------------------------------------------------------------------------------


def let_die(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """The worker of that name dies again and again; the other is well."""
    command = (sys.executable, "-c", "import sys; sys.exit('no such module')")

    def make(job: Job[Any, Any], *callbacks: Callable[[Any], None]) -> Worker[Any, Any]:
        if job.name != name:
            return Worker(job, *callbacks)
        dying = msgspec.structs.replace(job, command=command, waits_for_work=False)
        return Worker(dying, *callbacks, first_backoff_s=0.01)

    monkeypatch.setattr("heaved.daemon.learning.Worker", make)


def check_said_once(logs: Logs, name: str) -> None:
    (line,) = [line for line in logs if "has failed" in line["event"]]
    assert name in line["event"]
    assert line["log_level"] == "warning"
    assert "no such module" in line["reason"]


async def test_the_trainer_dies_again_and_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    let_die(monkeypatch, "trainer")
    config = demo_config(tmp_path)
    correction = msgspec.structs.replace(config.correction, enabled=True)
    async with plant_of(msgspec.structs.replace(config, correction=correction)) as (_, config):
        with capture_logs() as logs:
            async with running(config) as daemon:
                await until(daemon, lambda _record: metric(daemon, 'heaved_training_runs_total{result="failed"}') >= 3)
                await until(daemon, lambda record: record["quality"]["heave"] == "settling")
                assert metric(daemon, 'heaved_sea_fits_total{result="failed"}') == 0
    check_said_once(logs, "trainer")


async def test_the_fitter_dies_again_and_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The stream goes on without a gap, with what was learned: here the sea of an earlier run."""
    let_die(monkeypatch, "fitter")
    config = demo_config(tmp_path, heave=SEA[0])
    StateFile(tmp_path / "state", SavedState).write(StateFile.encode(SEA[1]))
    async with plant_of(config) as (_, config):
        with capture_logs() as logs:
            async with running(config) as daemon:
                await until(daemon, lambda _record: metric(daemon, 'heaved_sea_fits_total{result="failed"}') >= 3)
                first = await until(daemon, lambda record: "heave_m" in record)
                frames: list[Record] = []
                async with asyncio.timeout(PATIENCE_S), stream_of(daemon) as records:
                    while len(frames) < 100:
                        record = await anext(records)
                        frames += [record] if record["class"] == "MOTION" else []
                assert [frame["seq"] for frame in frames] == list(range(frames[0]["seq"], frames[0]["seq"] + 100))
                assert frames[0]["seq"] > first["seq"]
                assert {frame["quality"]["heave"] for frame in frames} == {"settling"}
                assert daemon.workers.running["fitter"].failures >= 3
    check_said_once(logs, "fitter")


# ---- configuration ---------------------------------------------------------------------------------------------------


async def test_a_bad_file_at_reload_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "heaved.toml"
    path.write_text("[heave]\ncomponents = 99\n[stream]\nprot = 1\n")
    async with plant_of(demo_config(tmp_path)) as (_, config), running(config, path) as daemon:
        with capture_logs() as logs:
            await daemon.reload()
        frame = await until(daemon, lambda record: record["quality"]["heave"] == "settling")
        assert daemon.config == config
        assert metric(daemon, 'heaved_config_reloads_total{result="refused"}') == 1
        await until(daemon, lambda record: record["seq"] > frame["seq"] + 10)
    refused = [line for line in logs if "refused" in line["event"]]
    assert sorted(line["fault"].split(":")[0] for line in refused) == ["heave.components", "stream.prot"]
    assert {line["file"] for line in refused} == {str(path)}


# ---- process ---------------------------------------------------------------------------------------------------------

PROGRAM = """
import sys, time
from pathlib import Path
from heaved.daemon import daemon, state
from heaved.config.read import load
def hang(*arguments, **options):
    time.sleep(3600)
path = Path(sys.argv[1])
config = load(path)
daemon._EXIT_S = float(sys.argv[2])
match sys.argv[3]:
    case "disk hangs":
        state.os.fsync = hang
    case "disk hangs at the start":
        state._content = hang
    case "loop hangs":
        daemon.Daemon.keep_house = hang
    case "start hangs":
        daemon.Daemon._poll_devices = hang
sys.exit(daemon.run(config, path, log_format="json"))
"""
PLAIN = """
[stream]
port = 0
[http]
port = 0
[state]
directory = "{}/state"
"""


@asynccontextmanager
async def process(
    path: Path,
    exit_s: float = PATIENCE_S,
    what: str = "",
    stdout: int = asyncio.subprocess.PIPE,
    stderr: int = asyncio.subprocess.PIPE,
) -> AsyncIterator[Process]:
    """The daemon as a process; killed at the end, if it is still there. ``exit_s``: in place of the 1.8 s after which
    the process ends whatever hangs, so that a slow machine does not need that. ``what``: hangs.
    """
    command = (sys.executable, "-c", PROGRAM, str(path), str(exit_s), what)
    daemon = await asyncio.create_subprocess_exec(*command, stdout=stdout, stderr=stderr)
    try:
        yield daemon
    finally:
        if daemon.returncode is None:
            daemon.kill()
            await daemon.wait()


async def listening(daemon: Process) -> dict[str, tuple[str, int]]:
    """Addresses by name, as the daemon prints them."""
    addresses = {}
    assert daemon.stdout is not None
    for _ in range(2):
        line = (await asyncio.wait_for(daemon.stdout.readline(), 60)).decode()
        name, address = line.split()
        host, _, port = address.rpartition(":")
        addresses[name] = host, int(port)
    return addresses


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
async def test_signals_end_it_in_time_whatever_hangs(tmp_path: Path, number: signal.Signals) -> None:
    """A client that never reads, an HTTP client that never asks, a device that accepts and never answers."""
    path = tmp_path / "heaved.toml"
    with closing(socket.create_server(("127.0.0.1", 0))) as silent:
        path.write_text(
            f"""
            [[device]]
            name = "imu"
            role = "imu"
            link = "tcp://127.0.0.1:{silent.getsockname()[1]}"
            profile = "heaved-sim-imu"
            rate_hz = 100.0
            [stream]
            port = 0
            queue_frames = 1
            [http]
            port = 0
            [state]
            directory = "{tmp_path}/state"
            """
        )
        async with process(path) as daemon:
            addresses = await listening(daemon)
            with closing(socket.socket()) as client:
                client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
                client.connect(addresses["stream"])
                await frames_dropped(addresses["stream"])
                with closing(socket.create_connection(addresses["http"])):
                    daemon.send_signal(number)
                    output, errors = await asyncio.wait_for(daemon.communicate(), PATIENCE_S)
        assert daemon.returncode == 0, errors.decode()
        # It went by itself, and was not ended by the deadline that is there for what hangs.
        assert msgspec.json.decode(errors.splitlines()[-1])["event"] == "stopped"
        assert output == b""
        assert (tmp_path / "state" / "state.json").is_file()


def plain(tmp_path: Path) -> Path:
    """A configuration without devices."""
    path = tmp_path / "heaved.toml"
    path.write_text(PLAIN.format(tmp_path))
    return path


async def test_an_impatient_ctrl_c_comes_twice(tmp_path: Path) -> None:
    """While the first one is obeyed; what hangs keeps it waiting for that."""
    async with process(plain(tmp_path), 3.0, "disk hangs") as daemon:
        await listening(daemon)
        daemon.send_signal(signal.SIGINT)
        assert daemon.stderr is not None
        while b"left behind" not in (line := await asyncio.wait_for(daemon.stderr.readline(), PATIENCE_S)):
            assert line, "it ended before what hangs was given up"
        daemon.send_signal(signal.SIGINT)
        _, errors = await asyncio.wait_for(daemon.communicate(), PATIENCE_S)
    assert daemon.returncode == 0
    assert [line for line in errors.splitlines() if b"xception" in line or b"Traceback" in line] == []


async def test_a_disk_that_hangs_does_not_hold_the_process(tmp_path: Path) -> None:
    async with process(plain(tmp_path), exit_s=0.5, what="disk hangs") as daemon:
        await listening(daemon)
        daemon.send_signal(signal.SIGTERM)
        await asyncio.wait_for(daemon.communicate(), PATIENCE_S)
    assert daemon.returncode == 0
    assert not (tmp_path / "state" / "state.json").exists()


async def test_a_disk_that_hangs_at_the_start_does_not_hold_the_stream(tmp_path: Path) -> None:
    async with process(plain(tmp_path), exit_s=0.5, what="disk hangs at the start") as daemon:
        reader, writer = await asyncio.open_connection(*(await listening(daemon))["stream"])
        assert b"VERSION" in await asyncio.wait_for(reader.readline(), PATIENCE_S)
        assert b"MOTION" in await asyncio.wait_for(reader.readline(), PATIENCE_S)
        writer.close()
        daemon.send_signal(signal.SIGTERM)
        _, errors = await asyncio.wait_for(daemon.communicate(), PATIENCE_S)
    assert daemon.returncode == 0
    assert b"the disk has not answered" in errors


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
async def test_a_loop_that_hangs_does_not_hold_the_process(tmp_path: Path, number: signal.Signals) -> None:
    async with process(plain(tmp_path), exit_s=0.5, what="loop hangs") as daemon:
        reader, writer = await asyncio.open_connection(*(await listening(daemon))["stream"])
        with contextlib.suppress(TimeoutError):
            while await asyncio.wait_for(reader.readline(), 1.0):  # Until it hangs: housekeeping begins a second later.
                pass
        daemon.send_signal(number)
        _, errors = await asyncio.wait_for(daemon.communicate(), PATIENCE_S)
        writer.close()
    assert daemon.returncode == 0
    assert b"not everything has stopped in time" in errors


async def test_a_start_that_hangs_can_be_ended(tmp_path: Path) -> None:
    async with process(plain(tmp_path), exit_s=0.5, what="start hangs") as daemon:
        await log_line(daemon, b"no saved state")
        daemon.send_signal(signal.SIGTERM)
        await asyncio.wait_for(daemon.communicate(), PATIENCE_S)
    assert daemon.returncode == 0


def full_device() -> int:
    return os.open("/dev/full", os.O_WRONLY)


def pipe_without_reader() -> int:
    reading, writing = os.pipe()
    os.close(reading)
    return writing


def full_pipe() -> int:
    """Nobody reads it, and who writes to it waits for ever. (The reading end is left open on purpose.)"""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, bytes(4096))
    os.set_blocking(writing, True)
    FULL_PIPES.append(reading)
    return writing


FULL_PIPES: list[int] = []


@pytest.mark.parametrize("make", [full_device, pipe_without_reader, full_pipe])
@pytest.mark.parametrize("name", ["stdout", "stderr"])
async def test_whoever_reads_what_it_prints_does_not_hold_the_process(
    tmp_path: Path, name: str, make: Callable[[], int]
) -> None:
    """It serves the stream, and ends when it is told to, by itself."""
    path = tmp_path / "heaved.toml"
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = taken.getsockname()[1]
    path.write_text(PLAIN.format(tmp_path).replace("[stream]\nport = 0", f"[stream]\nport = {port}"))
    file = make()
    pipes = {"stdout": asyncio.subprocess.PIPE, "stderr": asyncio.subprocess.PIPE} | {name: file}
    async with process(path, stdout=pipes["stdout"], stderr=pipes["stderr"]) as daemon:
        os.close(file)
        reader, writer = await connected(port)
        for _ in range(5):
            assert await asyncio.wait_for(reader.readline(), PATIENCE_S)
        daemon.send_signal(signal.SIGTERM)
        output, errors = await asyncio.wait_for(daemon.communicate(), PATIENCE_S)
        writer.close()
    assert daemon.returncode == 0
    assert (tmp_path / "state" / "state.json").is_file()
    if name == "stdout":
        assert msgspec.json.decode(errors.splitlines()[-1])["event"] == "stopped"
    else:
        assert f"stream 127.0.0.1:{port}".encode() in output
    while FULL_PIPES:
        os.close(FULL_PIPES.pop())


async def connected(port: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    async with asyncio.timeout(60):
        while True:
            with contextlib.suppress(ConnectionRefusedError):
                return await asyncio.open_connection("127.0.0.1", port)
            await asyncio.sleep(0.05)


def standard_files(pid: int) -> list[str]:
    """What stands behind the first three descriptors of a process."""
    return [str(Path(f"/proc/{pid}/fd/{fd}").readlink()) for fd in range(3)]


async def test_without_standard_files_nothing_takes_their_place(tmp_path: Path) -> None:
    """A line of the log would go into whatever socket was opened instead, and to its client."""
    path = tmp_path / "heaved.toml"
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = taken.getsockname()[1]
    path.write_text(PLAIN.format(tmp_path).replace("[stream]\nport = 0", f"[stream]\nport = {port}"))
    shell = f"exec {sys.executable} -c \"$0\" {path} 20 '' <&- >&- 2>&-"
    daemon = await asyncio.create_subprocess_exec("sh", "-c", shell, PROGRAM)
    try:
        reader, writer = await connected(port)
        for _ in range(5):
            assert (await asyncio.wait_for(reader.readline(), PATIENCE_S)).startswith(b'{"class":')
        links = standard_files(daemon.pid)
        daemon.send_signal(signal.SIGTERM)
        assert await asyncio.wait_for(daemon.wait(), PATIENCE_S) == 0
        writer.close()
    finally:
        if daemon.returncode is None:
            daemon.kill()
            await daemon.wait()
    assert links == ["/dev/null"] * 3


def test_the_process_is_gone_within_two_seconds() -> None:
    assert daemon_module._EXIT_S < 2.0
    assert 2.0 * daemon_module._CANCEL_S + daemon_module._STOP_S < daemon_module._EXIT_S


async def frames_dropped(address: tuple[str, int]) -> None:
    """Returns when the daemon has dropped frames: another client is stuck."""
    reader, writer = await asyncio.open_connection(*address)
    async with asyncio.timeout(PATIENCE_S):
        while line := await reader.readline():
            record = msgspec.json.decode(line)
            if record["class"] == "STATUS" and record["dropped"] > 0:
                break
            if record["class"] == "MOTION" and record["seq"] % 20 == 0:
                writer.write(b"?STATUS\n")
    writer.close()


async def test_a_hang_up_reads_the_file_again(tmp_path: Path) -> None:
    path = tmp_path / "heaved.toml"
    good = f'[stream]\nport = 0\n[http]\nport = 0\n[state]\ndirectory = "{tmp_path}/state"\n'
    path.write_text(good)
    async with process(path) as daemon:
        await listening(daemon)
        path.write_text(good + "[heave]\ncomponents = 99\n")
        daemon.send_signal(signal.SIGHUP)
        await log_line(daemon, b"refused")
        path.write_text(good + "[heave]\ncomponents = 2\n")
        daemon.send_signal(signal.SIGHUP)
        await log_line(daemon, b"configuration read again")
        daemon.send_signal(signal.SIGTERM)
        await asyncio.wait_for(daemon.communicate(), 30)
    assert daemon.returncode == 0


async def log_line(daemon: Process, wanted: bytes) -> None:
    assert daemon.stderr is not None
    async with asyncio.timeout(PATIENCE_S):
        while line := await daemon.stderr.readline():
            record = msgspec.json.decode(line)  # Every line is a record.
            assert record["timestamp"].endswith("Z")
            if wanted in line:
                return
    raise AssertionError("the log has ended")


def test_no_real_time_permission_is_a_warning_with_advice(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with capture_logs() as logs:
        set_real_time(20)
        set_real_time(0)
    (line,) = logs
    assert line["log_level"] == "warning"
    assert "LimitRTPRIO=20" in line["hint"]
    assert "CAP_SYS_NICE" in line["hint"]


def test_real_time_scheduling_is_not_inherited(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(os, "sched_setscheduler", lambda *arguments: asked.append(arguments))
    set_real_time(20)
    ((who, policy, param),) = asked
    assert (who, param.sched_priority) == (0, 20)
    assert policy == os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
