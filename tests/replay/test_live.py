"""A daemon's recording, replayed: made here without devices or processes but the trainer's, faster than time."""

from __future__ import annotations

import csv
import re
import shutil
from collections import Counter, deque
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np
import pytest
from recorded_hours import OFFSET_S, Desk, Scribe, frame_at, result_of
from running import demo_config

from heaved.config import RecordingParams
from heaved.daemon.acquisition import Acquisition
from heaved.daemon.daemon import make_pipeline
from heaved.daemon.metrics import Metrics
from heaved.daemon.recording import Journal, RecordingOutput
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, lead
from heaved.estimation.heave.laser.network import Network, Output
from heaved.estimation.heave.saved_state import SavedState
from heaved.estimation.heave.sea.refit import look
from heaved.recorder.files import to_parquet, whole_batches
from heaved.recorder.found import RecordedError
from heaved.recorder.layout import Call
from heaved.replay.live import LiveRecording, Rerun
from heaved.replay.replay import OutputError, replay
from heaved.report.report import report
from heaved.samples import LaserSample, TrainedNetwork
from heaved.simulate.gauge import LASER_DISTANCE_M
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import record
from heaved.workers.process import BlockingTrainer

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from heaved.config import Config
    from heaved.devices.profile import DeviceSpec
    from heaved.samples import MotionFrame, Sample, TrainingWindow

EAGER: dict[str, Any] = {
    "heave": heave.Params(lead=lead.Params(window_s=20.0, refresh_s=2.0, min_laser_s=5.0, min_coherence=0.0)),
    "correction": correction.Params(min_laser_s=20.0, window_s=30.0, period_s=6.0, epochs=300),
}
"""Learns early and trains often, so that a short recording shows all of it."""
HALF_S = 60.0
"""Then another pair of files begins."""


class Made(NamedTuple):
    """A recording, and what the daemon published meanwhile."""

    directory: Path
    config: Config
    frames: list[MotionFrame]


def carry(output: RecordingOutput, desk: Desk) -> None:
    """What the task of the daemon does with what has gathered."""
    output._cut()
    while output._kept:
        chunk = output._kept.popleft()
        if chunk.header is not output._sent_header:
            output._sent_header = chunk.header
            desk.told(chunk.header)
        desk.told(chunk.body)
    desk.recorder.write(desk.now_s)


class Acquiring:
    """The daemon's acquisition and its recording, on a clock that the test moves; its workers answer at once."""

    def __init__(self, config: Config, train: Callable[[TrainingWindow], TrainedNetwork]) -> None:
        self.frames: list[MotionFrame] = []
        self.now_s = 0.0
        self._answers: deque[Callable[[], None]] = deque()
        self.acquisition = Acquisition(
            make_pipeline(config),
            metrics=Metrics("0"),
            publish=self._publish,
            train=lambda window: self._answers.append(lambda: self.acquisition.accept(train(window))),
            fit=lambda past: self._answers.append(lambda: self.acquisition.accept_fit(look(past))),
            clock=lambda: self.now_s,
            journal=(journal := Journal(lambda: OFFSET_S, self._learned)),
        )
        self.acquisition.set_devices((msgspec.structs.replace(config.device[0], rate_hz=20.0), config.device[1]))
        self.output = journal.output_of(config)

    def _learned(self) -> SavedState:
        return self.acquisition.pipeline.state()

    def _publish(self, frame: MotionFrame) -> None:
        self.frames.append(frame)
        self.output.publish(frame)

    def poll(self, device: DeviceSpec, sample: Sample) -> None:
        self.acquisition.on_poll(result_of(device, sample))
        while self._answers:
            self._answers.popleft()()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Two minutes of regular waves; for two seconds of them the IMU is away, and the heartbeat makes the frames."""
    with BlockingTrainer() as trainer:
        return make(tmp_path_factory.mktemp("made"), trainer.fit, **EAGER)


def make(
    directory: Path, train: Callable[[TrainingWindow], TrainedNetwork], *, laser_gain: float = 1.0, **changes: Any
) -> Made:
    """``laser_gain``: what the laser shows of the heave."""
    config = demo_config(directory, recording=RecordingParams(enabled=True, vessel="Test"), **changes)
    sea = record(seaway("T3", seed=3), 110.0, imu_rate_hz=20.0, laser_rate_hz=10.0, seed=3)
    out = directory / "out"
    out.mkdir()
    desk = Desk(out, Scribe(directory))
    ship = Acquiring(config, train)
    is_renewed = False
    for number, sample in enumerate(sea.samples()):
        ship.now_s = sample.t_s
        if isinstance(sample, LaserSample):
            shown_m = LASER_DISTANCE_M + laser_gain * (sample.laser_m - LASER_DISTANCE_M)
            ship.poll(config.device[1], msgspec.structs.replace(sample, laser_m=shown_m))
        elif 80.0 < sample.t_s < 82.0:
            ship.acquisition.heartbeat()
        else:
            ship.poll(config.device[0], sample)
        if number % 40 == 0:
            carry(ship.output, desk)
        if not is_renewed and sample.t_s > HALF_S:
            ship.output.renew(config)
            is_renewed = True
    carry(ship.output, desk)
    desk.recorder.close(desk.now_s)
    to_parquet(min(out.glob("*.samples.arrows"), key=lambda path: (len(path.name), path.name)))
    return Made(out, config, ship.frames)


def again(directory: Path) -> tuple[list[MotionFrame], Counter[Call], Counter[tuple[str, str]]]:
    frames: list[MotionFrame] = []
    calls: Counter[Call] = Counter()
    became: Counter[tuple[str, str]] = Counter()
    for hour, rows in LiveRecording(directory).runs():
        rerun = Rerun(hour, None, frames.append, lambda what, result: became.update([(what, str(result))]), None)
        for row in rows:
            calls[row.call] += 1
            rerun.take(row)
    return frames, calls, became


def test_every_frame_is_the_same_to_the_last_bit(made: Made) -> None:
    frames, calls, became = again(made.directory)
    assert became["fits", "accepted"] >= 1
    assert sum(count for (what, _), count in became.items() if what == "trainings") >= 2
    assert calls[Call.COAST] > 20
    assert len(frames) == len(made.frames) > 2000
    assert [msgspec.msgpack.encode(frame) for frame in frames] == [msgspec.msgpack.encode(f) for f in made.frames]


def test_a_network_is_in_the_recording_where_the_pipeline_took_it(tmp_path: Path) -> None:
    """The laser shows 1.3 times the heave of the harmonic observer, and the trainer finds just that."""
    made = make(
        tmp_path,
        lambda window: gain_network(window.number, 0.3),
        laser_gain=1.3,
        heave=heave.Params(observer="harmonic", forecast_horizons_s=(1.0,)),
        correction=correction.Params(taps=10, hidden=1, window_s=60.0, min_laser_s=20.0, period_s=10.0),
    )
    frames, _, became = again(made.directory)
    assert became["trainings", "accepted"] >= 1
    assert any(np.isfinite(frame.correction_m) and frame.correction_m != 0.0 for frame in frames)
    assert [msgspec.msgpack.encode(frame) for frame in frames] == [msgspec.msgpack.encode(f) for f in made.frames]


def gain_network(number: int, gain: float) -> TrainedNetwork:
    """Correction = gain * observer output."""
    W1 = np.zeros((1, 10))
    W1[0, -1] = 1e-3
    network = Network(
        W1=W1, b1=np.zeros(1), w2=np.array([4e3 * gain]), b2=2e3 * gain, input_mean_m=0.0, input_std_m=1.0,
        target_mean_m=0.0, target_std_m=1.0, output=Output.LINEAR,
    )  # fmt: skip
    return TrainedNetwork(number=number, weights=network.to_bytes(), width=10, hidden=1)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_table_is_that_of_the_frames_and_the_same_every_time(made: Made, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    summary = replay(made.directory, tmp_path / "a.csv", progress=lambda done, total: told.append((done, total)))
    replay(made.directory, tmp_path / "b.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    rows = rows_of(tmp_path / "a.csv")
    assert summary.frames == len(rows) == len(made.frames)
    assert summary.remarks == ()
    assert [row["heave_m"] for row in rows] == [
        f"{frame.heave_m:.6f}" if np.isfinite(frame.heave_m) else "" for frame in made.frames
    ]
    assert told[-1][1] == sum(path.stat().st_size for path in made.directory.glob("*.samples.*"))
    assert [done for done, _ in told] == sorted(done for done, _ in told)


def test_until_counts_from_the_first_call(made: Made, tmp_path: Path) -> None:
    summary = replay(made.directory, tmp_path / "out.csv", until_s=10.0)
    assert summary.duration_s == pytest.approx(10.0, abs=0.06)
    assert summary.frames == pytest.approx(200, abs=2)


def test_learning_anew_learns_instead_of_taking_what_was_learned(made: Made, tmp_path: Path) -> None:
    """Here the daemon's answers came at once, as the replay's do: it finds the same models."""
    taken = replay(made.directory, tmp_path / "taken.csv")
    anew = replay(made.directory, tmp_path / "anew.csv", learn_anew=True)
    assert anew.fits == taken.fits
    assert anew.trainings == taken.trainings
    heaves = [
        np.array([float(row["heave_m"] or "nan") for row in rows_of(tmp_path / name)])
        for name in ("taken.csv", "anew.csv")
    ]
    assert np.nanmax(np.abs(heaves[0] - heaves[1])) < 0.02


def test_another_configuration_is_run_on_what_was_measured(made: Made, tmp_path: Path) -> None:
    other = msgspec.structs.replace(made.config, heave=heave.Params(observer="harmonic"), device=())
    summary = replay(made.directory, tmp_path / "out.csv", other)
    assert summary.fits == {}
    assert summary.frames == len(made.frames)
    assert any(row["heave_m"] for row in rows_of(tmp_path / "out.csv"))


def test_a_recording_that_begins_within_a_run_is_begun_with_what_was_known_then(made: Made, tmp_path: Path) -> None:
    part = tmp_path / "part"
    shutil.copytree(made.directory, part)
    for path in part.glob("*.parquet"):  # The first half.
        path.unlink()
    summary = replay(part, tmp_path / "out.csv")
    assert "begins within a run of the daemon: the replay begins with what a restart would know" in summary.remarks[0]
    rows = rows_of(tmp_path / "out.csv")
    published = {f"{frame.t_s:.6f}": frame for frame in made.frames}
    assert float(rows[0]["t_s"]) == pytest.approx(HALF_S, abs=0.2)
    late = [row for row in rows if float(row["t_s"]) > 100.0]
    assert len(late) > 150
    off_m = [float(row["heave_m"]) - published[row["t_s"]].heave_m for row in late]
    assert np.sqrt(np.mean(np.square(off_m))) < 0.1 * np.std([published[row["t_s"]].heave_m for row in late])


def test_calls_that_are_missing_are_said(made: Made, tmp_path: Path) -> None:
    """A whole second, in the middle of a stream."""
    part = tmp_path / "part"
    shutil.copytree(made.directory, part)
    stream = next(part.glob("*.samples.arrows"))
    ends = [end for _, end in whole_batches(stream)]
    data = stream.read_bytes()
    stream.write_bytes(data[: ends[3]] + data[ends[4] :])
    remarks = replay(part, tmp_path / "out.csv").remarks
    assert len(remarks) == 1
    assert re.search(r"\d+ calls are missing before t_s \d+", remarks[0])


def test_a_report_is_made_of_it_as_of_a_csv(made: Made, tmp_path: Path) -> None:
    found = report(made.directory, tmp_path / "out.html", None, made="today", command="heaved report")
    assert found.frames == len(made.frames)
    assert "imu.az_mps2" in found.source.columns
    assert (tmp_path / "out.html").stat().st_size > 10_000


def test_samples_alone_are_kept_if_that_is_asked(tmp_path: Path) -> None:
    config = demo_config(tmp_path, recording=RecordingParams(enabled=True, what="samples"))
    journal = Journal(lambda: OFFSET_S, SavedState)
    output = journal.output_of(config)
    output.publish(frame_at(1.0, 1))
    assert output._rows == 0
    journal.coasted(1.0)
    assert output._rows == 1


def test_a_result_may_not_be_the_recording(made: Made) -> None:
    path = next(made.directory.glob("*.samples.parquet"))
    with pytest.raises(OutputError, match="is the recording itself"):
        replay(path, path)


def test_what_a_later_release_configures_is_said(made: Made, tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    from heaved.recorder.tables import HEADER_KEY

    path = next(made.directory.glob("*.samples.parquet"))
    table = pq.read_table(path)
    header = msgspec.json.decode(table.schema.metadata[HEADER_KEY])
    header["config"]["teleport"] = {"enabled": True}
    metadata = table.schema.metadata | {HEADER_KEY: msgspec.json.encode(header)}
    pq.write_table(table.replace_schema_metadata(metadata), tmp_path / "later.parquet")
    with pytest.raises(RecordedError, match=r"with a configuration that this one does not take .*teleport"):
        replay(tmp_path / "later.parquet", tmp_path / "out.csv")
