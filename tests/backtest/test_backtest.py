"""Whole backtests: by processes of this machine, some of which are killed, and what is said where there can be none."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import os
import shutil
import signal
import socket
import sys
import threading
from asyncio.subprocess import PIPE
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pyarrow.parquet as pq
import pytest
from dying_workers import killed_once
from waiting import holds

from heaved.backtest import distribute
from heaved.backtest.backtest import NOT_INSTALLED, PAGE, RESULTS, TABLE, Summary, backtest, named
from heaved.backtest.task import Result, Task, keep, kept_result, perform, seen_of
from heaved.backtest.units import BacktestError, UnreachableError
from heaved.cli import main
from heaved.config import Config
from heaved.simulate.play import write_recording
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import record

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

CONFIGS = {
    name: msgspec.convert({"heave": {"sea": {"delay_s": delay_s}}}, Config)
    for name, delay_s in (("short", 10.0), ("long", 20.0))
}


def run(directory: Path, out: Path, configs: dict[str, Config] = CONFIGS, **others: Any) -> Summary:
    return backtest(directory, out, configs, made="", command="", **others)


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("archive")
    for seed, name in enumerate(("victim.csv", "other.csv")):
        recording = record(seaway("S4", seed=seed), 60.0, imu_rate_hz=10.0, laser_rate_hz=5.0, sensor="A", seed=seed)
        write_recording(directory / name, recording)
    (directory / "foreign.csv").write_text("name,price\nbread,2\n")
    (directory / "deadly.csv").write_text("t_s,az_mps2\n")
    (directory / "notes.txt").write_text("calm")
    return directory


@pytest.mark.timeout(60)
def test_a_killed_worker_costs_nothing(archive: Path, tmp_path: Path) -> None:
    """Two processes, one of which is killed: the rows are those that its tasks give here. A task that kills whoever
    does it ends as a failure, and takes no other with it.
    """
    out = tmp_path / "out"
    (out / RESULTS).mkdir(parents=True)
    told: list[tuple[int, int]] = []
    summary = run(archive, out, workers=2, work=killed_once, progress=lambda *done: told.append(done))
    assert (out / RESULTS / "killed").exists()
    assert summary.again >= 1 + 2 * (distribute.MOST_ATTEMPTS - 1)
    assert (summary.recordings, summary.tasks, summary.already, summary.done) == (4, 8, 0, 4)
    assert {(one.source, one.configuration) for one in summary.failed} == {
        (name, config) for name in ("foreign.csv", "deadly.csv") for config in CONFIGS
    }
    assert "notes.txt" in summary.remark
    assert told[0] == (0, 8)
    assert told[-1] == (8, 8)
    rows = pq.read_table(out / TABLE).to_pylist()
    assert len(rows) == 8
    for row in rows:
        if row["failure"] is not None:
            assert ("workers died" if row["source"] == "deadly.csv" else "az_mps2") in row["failure"]
            continue
        config = msgspec.json.encode(CONFIGS[row["configuration"]])
        here = perform(
            Task(
                name=row["source"],
                source=str(archive / row["source"]),
                config=config,
                config_sha256="",
                release=row["release"],
                results=str(tmp_path / "here"),
            )
        )
        assert here.failure == ""
        assert here.source_sha256 == row["source_sha256"]
        assert here.frames == row["frames"] == 600
        assert here.realtime is not None
        assert here.realtime.rms == row["realtime_rms_m"]
        assert [one.errors.rms for one in here.forecasts] == [one["rms_m"] for one in row["forecasts"]]
    assert "victim.csv" in (out / PAGE).read_text()


@pytest.mark.timeout(60)
async def test_ctrl_c_ends_all_processes(archive: Path, tmp_path: Path) -> None:
    """A terminal sends it to each of them: none says more than one sentence, and what was done is kept."""
    directory, out = tmp_path / "many", tmp_path / "out"
    directory.mkdir()
    for i in range(300):
        shutil.copy(archive / "other.csv", directory / f"{i}.csv")
    command = [sys.executable, "-m", "heaved", "backtest", str(directory), "-o", str(out), "--workers", "1"]
    process = await asyncio.create_subprocess_exec(
        *command,
        stdout=PIPE,
        stderr=PIPE,
        start_new_session=True,
        env=os.environ | {"TMPDIR": str(tmp_path)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # Where tests run in the background it is not.
    )
    await holds(lambda: list(out.rglob("*.json")))
    os.killpg(process.pid, signal.SIGINT)
    said, complained = await process.communicate()
    assert (process.returncode, said) == (130, b"")
    assert complained.decode() == "ended: what is done is kept, and the same command does the rest\n"
    assert 1 <= len(list(out.rglob("*.json"))) < 300
    assert not list(tmp_path.rglob("heaved-backtest-*"))  # noqa: ASYNC240  # A handful of names.
    await holds(lambda: running_in(process.pid) == [])


def running_in(group: int) -> list[str]:
    """Processes of a group, but for those that only wait to be buried."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # It has ended meanwhile.
            state, _, its_group, *_ = path.read_text().rpartition(")")[2].split()
            if int(its_group) == group and state != "Z":
                found.append(path.parent.name)
    return found


# ---- in this process -------------------------------------------------------------------------------------------------


@dataclass
class Nobody:
    """In place of Dask: tasks are done here, one after another."""

    done: list[Task]
    ends_after: int = 1000

    def distributed(
        self, client: object, tasks: Sequence[Task], work: Callable[[Task], Result], again: object
    ) -> Iterator[tuple[Task, Result]]:
        for task in tasks:
            if len(self.done) == self.ends_after:
                raise KeyboardInterrupt
            self.done.append(task)
            yield task, work(task)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> Nobody:
    nobody = Nobody([])
    monkeypatch.setattr(distribute, "local_workers", lambda count: nullcontext())
    monkeypatch.setattr(distribute, "distributed", nobody.distributed)
    return nobody


def quick(task: Task) -> Result:
    """A result that is kept, of a file that is not looked into."""
    result = Result(source_sha256=Path(task.source).read_text(), seen=seen_of(Path(task.source)), frames=7)
    keep(task, result)
    return result


@pytest.fixture
def two(tmp_path: Path) -> Path:
    directory = tmp_path / "two"
    directory.mkdir()
    for name in ("a.csv", "b.csv"):
        (directory / name).write_text(name)
    return directory


def test_a_second_run_does_nothing(two: Path, tmp_path: Path, here: Nobody) -> None:
    out = tmp_path / "out"
    first = run(two, out, work=quick)
    assert (first.done, first.already, len(here.done)) == (4, 0, 4)
    second = run(two, out, work=quick)
    assert (second.done, second.already, len(here.done)) == (0, 4, 4)
    assert pq.read_table(out / TABLE).num_rows == 4


def test_only_what_has_changed_is_done(two: Path, tmp_path: Path, here: Nobody) -> None:
    out = tmp_path / "out"
    run(two, out, work=quick)
    here.done.clear()
    changed = {**CONFIGS, "long": msgspec.convert({"heave": {"sea": {"delay_s": 30.0}}}, Config)}
    assert run(two, out, changed, work=quick).done == 2
    assert {task.config for task in here.done} == {msgspec.json.encode(changed["long"])}
    here.done.clear()
    (two / "a.csv").write_text("something else")
    (two / "c.csv").write_text("new")
    run(two, out, changed, work=quick)
    assert sorted(task.name for task in here.done) == ["a.csv", "a.csv", "c.csv", "c.csv"]
    here.done.clear()
    assert run(two, out, work=quick).already == 4, "what was done with the other configuration is still there"


def test_what_is_done_is_kept_when_it_is_ended(two: Path, tmp_path: Path, here: Nobody) -> None:
    here.ends_after = 3
    with pytest.raises(KeyboardInterrupt):
        run(two, tmp_path / "out", work=quick)
    assert sum(kept_result(task) is not None for task in here.done) == 3
    here.ends_after = 1000
    here.done.clear()
    assert run(two, tmp_path / "out", work=quick).already == 3
    assert len(here.done) == 1


def test_one_configuration_of_two_names_is_tested_once(two: Path, tmp_path: Path, here: Nobody) -> None:
    summary = run(two, tmp_path / "out", {"one": CONFIGS["long"], "two": CONFIGS["long"]}, work=quick)
    assert len(here.done) == 2
    assert (summary.tasks, summary.done) == (4, 4)


def test_a_moved_archive_is_not_tested_again(two: Path, tmp_path: Path, here: Nobody) -> None:
    run(two, tmp_path / "out", work=quick)
    moved = two.rename(tmp_path / "moved")
    assert run(moved, tmp_path / "out", work=quick).already == 4


def test_the_command_says_what_it_did(
    two: Path, tmp_path: Path, here: Nobody, capsys: pytest.CaptureFixture[str]
) -> None:
    """These files are no recordings: the exit code is 1, and the reasons stand in the JSON."""
    assert main(["backtest", str(two), "-o", str(tmp_path / "out"), "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert (said["tasks"], said["done"], len(said["failed"])) == (2, 0, 2)
    assert said["configurations"][0]["configuration"] == "as recorded"
    assert "a.csv" in said["failed"][0]["reason"]


def test_ctrl_c_is_no_fault(two: Path, here: Nobody, capsys: pytest.CaptureFixture[str]) -> None:
    here.ends_after = 1
    assert main(["backtest", str(two)]) == 130
    assert "the same command does the rest" in capsys.readouterr().err


# ---- where there can be none -----------------------------------------------------------------------------------------


def test_results_do_not_go_into_the_archive(two: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(two)
    for out in (two, two / "out", tmp_path / "link" / "deep" / "out"):
        with pytest.raises(BacktestError, match="name a directory beside it"):
            run(two, out)
    assert sorted(path.name for path in two.iterdir()) == ["a.csv", "b.csv"]


def test_a_file_is_no_place_for_results(two: Path, tmp_path: Path) -> None:
    (tmp_path / "out").touch()
    with pytest.raises(BacktestError, match="is a file"):
        run(two, tmp_path / "out")
    with pytest.raises(BacktestError, match="cannot be made"):
        run(two, tmp_path / "out" / "deeper")


def test_two_configurations_of_one_name_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(BacktestError, match="rename one"):
        named([tmp_path / "a" / "x.toml", tmp_path / "b" / "x.toml"])


def test_what_is_missing_is_said(two: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(BacktestError) as said:
        run(two, tmp_path / "out")
    assert str(said.value) == NOT_INSTALLED


@pytest.mark.parametrize("address", ["ship:8786", "http://ship:8786", "tcp://ship", "tcp://:1", "tcp://ship:port", ""])
def test_a_bad_address_is_refused(address: str) -> None:
    with pytest.raises(UnreachableError, match="write it as tcp://host:8786"), distribute.remote_workers(address):
        pass


def test_nobody_listens(two: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{bound.getsockname()[1]}"
        assert main(["backtest", str(two), "-o", str(tmp_path / "o"), "--scheduler", address]) == 69
    assert "dask scheduler --port" in capsys.readouterr().err


@pytest.mark.parametrize("says", [b"", b"HTTP/1.1 400 Bad Request\r\n\r\n", b"SSH-2.0-OpenSSH_9.2\r\n"])
def test_who_listens_is_no_scheduler(monkeypatch: pytest.MonkeyPatch, says: bytes) -> None:
    """It takes each connection, and says nothing, or something else."""
    monkeypatch.setattr(distribute, "ANSWERS_WITHIN_S", 0.3)

    def answer(server: socket.socket) -> None:
        taken = []
        with suppress(OSError):
            while True:
                taken.append(server.accept()[0])
                taken[-1].sendall(says)
        for connection in taken:
            connection.close()

    with socket.create_server(("127.0.0.1", 0)) as silent:
        thread = threading.Thread(target=answer, args=(silent,))
        thread.start()
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(UnreachableError, match="does not answer"), distribute.remote_workers(address):
            pass
        silent.shutdown(socket.SHUT_RDWR)
        thread.join()


def test_a_scheduler_without_workers() -> None:
    from distributed import LocalCluster

    with (
        LocalCluster(
            n_workers=0,
            host="127.0.0.1",
            dashboard_address=None,
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
            protocol="tcp://",
            processes=False,
        ) as cluster,
        pytest.raises(UnreachableError, match="has no workers"),
        distribute.remote_workers(cluster.scheduler_address),
    ):
        pass
