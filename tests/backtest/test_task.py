"""One task: its numbers against those worked out from the frames, what is kept, and files of every bad kind."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pytest
from recorded_hours import Scribe
from recorded_hours import write_recording as write_hours

from heaved import __version__
from heaved.backtest import task as tasks
from heaved.backtest.task import Result, Task, done_result, kept_result, perform
from heaved.config import Config
from heaved.replay.replay import replaying
from heaved.samples import HeaveState, LaserSample, SeaState
from heaved.simulate.play import write_recording
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import record

if TYPE_CHECKING:
    from collections.abc import Callable

SHORT_DELAY = msgspec.convert({"heave": {"sea": {"delay_s": 10.0}}, "rock": {"horizons_s": [0.5]}}, Config)
"""So that a short recording has delayed heaves."""


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("archive") / "s4.csv"
    write_recording(path, record(seaway("S4", seed=4), 90.0, imu_rate_hz=10.0, laser_rate_hz=5.0, sensor="A", seed=4))
    return path


def task_of(source: Path, results: Path, config: Config | None = SHORT_DELAY, **changes: Any) -> Task:
    text = None if config is None else msgspec.json.encode(config)
    usual: dict[str, Any] = {
        "name": source.name,
        "source": str(source),
        "config": text,
        "config_sha256": str(hash(text)),
        "release": __version__,
        "results": str(results),
    }
    return Task(**(usual | changes))


@pytest.fixture(scope="module")
def result(source: Path) -> Result:
    return perform(task_of(source, source.parent / "results"))


class Direct:
    """The same recording and configuration, gone through by hand: what each frame said, and when."""

    def __init__(self, source: Path) -> None:
        now: list[tuple[float, ...]] = []
        delayed: list[tuple[float, float]] = []
        self.ahead: list[dict[float, float]] = []
        self.rock: list[dict[float, float]] = []
        self.angles: list[float] = []
        self.states: list[HeaveState] = []
        self.seas: list[SeaState] = []
        self.samples = 0
        with replaying(source, SHORT_DELAY) as run:
            for sample, frame in run.steps():
                self.samples += not isinstance(sample, LaserSample)
                if frame is None:
                    continue
                now.append((frame.t_s, frame.t_s + frame.compensation_lead_s, frame.heave_m, frame.heave_std_m))
                self.states.append(frame.quality.heave)
                if frame.sea is not None and frame.sea not in self.seas[-1:]:
                    self.seas.append(frame.sea)
                self.ahead.append({one.horizon_s: one.heave_m for one in frame.forecast})
                # One that claims nothing is not tested.
                self.rock.append({one.horizon_s: one.roll_rad for one in frame.rock if 0.0 < one.roll_std_rad < np.inf})
                self.angles.append(frame.roll_rad)
                if frame.delayed is not None and (not delayed or frame.delayed.t_s > delayed[-1][0]):
                    delayed.append((frame.delayed.t_s, frame.delayed.heave_m))
            self.resets = run.pipeline.resets.total()
        self.t_s, self.valid_s, self.heave, self.std = np.array(now).T
        self._delayed_s, self._delayed = np.array(delayed).T

    def delayed_at(self, t_s: np.ndarray) -> np.ndarray:
        return np.asarray(np.interp(t_s, self._delayed_s, self._delayed, left=np.nan, right=np.nan))


@pytest.fixture(scope="module")
def direct(source: Path) -> Direct:
    return Direct(source)


def test_the_heave_is_that_of_a_replay(result: Result, direct: Direct) -> None:
    settled = np.array([state in (HeaveState.VALID, HeaveState.DEGRADED) for state in direct.states])
    error = (direct.heave - direct.delayed_at(direct.valid_s))[settled]
    std = direct.std[settled]
    there = np.isfinite(error)
    error, std = error[there], std[there]
    assert result.realtime is not None
    assert result.realtime.count == len(error) > 100
    assert result.realtime.rms == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)
    assert result.realtime.claimed_rms == pytest.approx(np.sqrt(np.mean(std**2)), rel=1e-9)
    assert result.realtime.nees == pytest.approx(np.mean((error / std) ** 2), rel=1e-9)
    assert result.realtime.within_2std == pytest.approx(np.mean(np.abs(error) <= 2.0 * std), rel=1e-9)


def test_forecasts_are_those_of_a_replay(result: Result, direct: Direct) -> None:
    by_horizon = {one.horizon_s: one.errors for one in result.forecasts}
    assert by_horizon[1.0].count > 100
    for horizon_s, errors in by_horizon.items():
        told = np.array([one.get(horizon_s, np.nan) for one in direct.ahead])
        error = told - direct.delayed_at(direct.t_s + horizon_s)
        assert errors.rms == pytest.approx(np.sqrt(np.nanmean(error**2)), rel=1e-9), horizon_s


def test_predictions_of_roll_are_those_of_a_replay(result: Result, direct: Direct) -> None:
    """At a horizon of whole samples: five of them later, the angle was measured."""
    (errors,) = (one.errors for one in result.roll if one.horizon_s == 0.5)
    told = np.degrees([one.get(0.5, np.nan) for one in direct.rock[:-5]])
    error = told - np.degrees(direct.angles[5:])
    assert errors.count > 100
    assert errors.rms == pytest.approx(np.sqrt(np.nanmean(error**2)), rel=1e-6)


def test_the_rest_of_the_row_is_that_of_a_replay(result: Result, direct: Direct) -> None:
    assert result.failure == ""
    assert result.frames == len(direct.t_s) == direct.samples
    assert result.duration_s == pytest.approx(direct.t_s[-1] - direct.t_s[0])
    assert result.first_valid_s is not None
    assert result.first_valid_s == pytest.approx(direct.t_s[direct.states.index(HeaveState.VALID)] - direct.t_s[0])
    for state in HeaveState:
        share = direct.states.count(state) / len(direct.states)
        assert result.shares[state.value] == pytest.approx(share, abs=0.01)
    assert result.resets == direct.resets
    assert result.laser is not None
    assert result.laser.count > 50
    assert result.significant_height_m == pytest.approx(np.median([sea.significant_height_m for sea in direct.seas]))
    assert result.peak_period_s == pytest.approx(np.median([sea.peak_period_s for sea in direct.seas]))


def test_an_hour_of_a_daemon_is_one_task(tmp_path: Path) -> None:
    """And what comes of it does not depend on the hours beside it."""
    write_hours(tmp_path / "alone", Scribe(tmp_path), 3)
    (alone,) = (tmp_path / "alone").glob("*.samples.arrows")
    write_hours(tmp_path / "both", scribe := Scribe(tmp_path), 3)
    (first,) = (tmp_path / "both").glob("*.samples.arrows")
    write_hours(tmp_path / "both", scribe, 3, first_s=3)
    results = [perform(task_of(path, tmp_path / "r", None, name=str(path))) for path in (alone, first)]
    assert [one.failure for one in results] == ["", ""]
    same = {"run_s": 0.0, "seen": None, "source_sha256": "", "memory_bytes": 0}
    one, two = (msgspec.structs.replace(result, **same) for result in results)
    assert one.frames == 300
    assert msgspec.json.encode(one) == msgspec.json.encode(two)


# ---- what is kept ----------------------------------------------------------------------------------------------------


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Files that were gone through, in place of going through them."""
    found: list[str] = []

    def followed(source: Path, task: Task, sha256: str, seen: Any) -> Result:
        found.append(source.name)
        return Result(source_sha256=sha256, seen=seen, frames=1)

    monkeypatch.setattr(tasks, "_followed", followed)
    return found


def test_what_is_done_is_not_done_again(tmp_path: Path, counted: list[str]) -> None:
    source = tmp_path / "a.csv"
    source.write_text("one")
    task = task_of(source, tmp_path / "r")
    assert done_result(task) is None
    first = perform(task)
    assert done_result(task) == first
    assert perform(task) == first
    os.utime(source, ns=(1, 1))
    assert done_result(task) is None, "it has to be looked at"
    assert perform(task).source_sha256 == first.source_sha256
    assert counted == ["a.csv"], "but it holds the same"
    assert done_result(task) is not None


@pytest.mark.parametrize(
    "change",
    [
        lambda task: Path(task.source).write_text("two") and task,
        lambda task: msgspec.structs.replace(task, config_sha256="other"),
        lambda task: task.place.write_bytes(b'{"frames": 1') and task,
        lambda task: task.place.write_bytes(b"[]") and task,
    ],
    ids=["other content", "other configuration", "torn result", "foreign result"],
)
def test_what_has_changed_is_done_again(tmp_path: Path, counted: list[str], change: Callable[[Task], Task]) -> None:
    source = tmp_path / "a.csv"
    source.write_text("one")
    task = task_of(source, tmp_path / "r")
    perform(task)
    task = change(task)
    assert done_result(task) is None
    assert perform(task).failure == ""
    assert counted == ["a.csv"] * 2
    assert done_result(task) is not None


def test_twice_at_once_is_once(source: Path, tmp_path: Path) -> None:
    task = task_of(source, tmp_path / "r")
    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(perform, [task, task]))
    one, two = (msgspec.json.encode(msgspec.structs.replace(r, run_s=0.0, memory_bytes=0)) for r in results)
    assert one == two
    assert kept_result(task) in results
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == [task.place.name], "and nothing is left"


# ---- what fails ------------------------------------------------------------------------------------------------------


def _truncated(path: Path, whole: bytes) -> None:
    path.write_bytes(whole[: whole.index(b"\n") + 12])


BAD: dict[str, tuple[Callable[[Path, bytes], object], str]] = {
    "empty": (lambda path, whole: path.touch(), "empty"),
    "foreign": (lambda path, whole: path.write_text("name,price\nbread,2\n"), "az_mps2"),
    "binary": (lambda path, whole: path.write_bytes(bytes(range(256))), "bad.csv"),
    "truncated": (_truncated, "line 2"),
    "a directory": (lambda path, whole: path.mkdir(), "is no file"),
    "not there": (lambda path, whole: None, "mounted on every worker"),
    "no acceleration": (lambda path, whole: path.write_text("t_s,az_mps2\n0,\n1,\n"), "vertical acceleration"),
}


@pytest.mark.parametrize("bad", BAD)
def test_a_bad_file_is_a_row_with_its_reason(source: Path, tmp_path: Path, bad: str) -> None:
    make, reason = BAD[bad]
    path = tmp_path / "bad.csv"
    make(path, source.read_bytes())
    task = task_of(path, tmp_path / "r")
    result = perform(task)
    assert reason in result.failure
    assert str(path) in result.failure
    assert kept_result(task) is None, "it is tried again"


@pytest.mark.parametrize("content", [b"", b"PAR1 is how it begins", b"no such thing"])
def test_a_bad_hour_is_a_row_with_its_reason(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "heaved-20260101T000000Z.samples.parquet"
    path.write_bytes(content)
    assert "copy it again, or leave it out" in perform(task_of(path, tmp_path / "r")).failure


def test_another_release_is_refused(source: Path, tmp_path: Path) -> None:
    assert "install that release" in perform(task_of(source, tmp_path, release="0.0.1")).failure


def test_a_file_that_changes_meanwhile_is_no_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv"
    path.write_text("one")

    def grows(source: Path, task: Task, sha256: str, seen: Any) -> Result:
        source.write_text("one, and more")
        return Result()

    monkeypatch.setattr(tasks, "_followed", grows)
    task = task_of(path, tmp_path / "r")
    assert "still being recorded" in perform(task).failure
    assert kept_result(task) is None


def test_a_fault_of_the_program_is_a_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv"
    path.write_text("one")

    def fails(*_: Any) -> Result:
        raise ZeroDivisionError("of all things")

    monkeypatch.setattr(tasks, "_followed", fails)
    assert "the program failed: ZeroDivisionError('of all things')" in perform(task_of(path, tmp_path / "r")).failure


def test_a_full_disk_is_a_row(tmp_path: Path, counted: list[str]) -> None:
    path = tmp_path / "a.csv"
    path.write_text("one")
    (tmp_path / "r").touch()
    assert str(tmp_path / "r") in perform(task_of(path, tmp_path / "r")).failure
