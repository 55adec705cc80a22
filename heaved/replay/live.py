"""A daemon's recording through the pipeline again: each call that the daemon made, in the order in which it made them.

The samples, the moments at which frames were made without one, the models and when each was taken are in the recording;
all the rest is a pure function of these, so the frames come out the same, to the last bit.
"""

from __future__ import annotations

from functools import partial
from math import inf
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.config import Config
from heaved.estimation.heave.observer import Verdict
from heaved.estimation.heave.saved_state import SavedState
from heaved.estimation.heave.sea.refit import SeaFit, look
from heaved.estimation.hull.refit import RefitJob, RefitResult, refit
from heaved.estimation.stages import Stages
from heaved.recorder.calls import Restored
from heaved.recorder.found import RecordedError
from heaved.recorder.layout import SAMPLES, Call
from heaved.recorder.read import Hour, Recorded, Row, open_recorded, rows_of
from heaved.replay.replay import assembled
from heaved.samples import ImuSample, MotionFrame, TrainedNetwork

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from heaved.pipeline import Pipeline
    from heaved.replay.replay import Progress
    from heaved.samples import Sample
    from heaved.workers.process import BlockingTrainer

PROGRESS_ROWS: Final = 1024
"""Progress is told after so many."""


class LiveRecording:
    """A recording of a daemon, to be replayed.

    Attributes:
        config: in force when it begins.
        remarks: what a person should know of it.
    """

    def __init__(self, path: Path, progress: Progress | None = None) -> None:
        """``progress`` is told now and then how much of it has been read.

        Raises:
            RecordedError: it is not one.
        """
        self._progress = progress
        self._recorded: Recorded = open_recorded(path, SAMPLES)
        self.remarks = list(self._recorded.remarks)
        self.config = config_of(self._recorded.hours[0])
        self._read_bytes = 0

    def runs(self) -> Iterator[tuple[Hour, Iterator[Row]]]:
        """Each run of the daemon: its first hour, and all its rows."""
        for hours in self._recorded.runs:
            yield hours[0], self._rows(hours)

    def _rows(self, hours: list[Hour]) -> Iterator[Row]:
        expected = None
        for hour in hours:
            for number, row in enumerate(rows_of(hour)):
                if expected is not None and row.seq != expected:
                    self.remarks.append(
                        f"{hour.path.name}: {row.seq - expected} calls are missing before t_s {row.t_s:.2f}: what "
                        "follows is the same only once the filters have forgotten it"
                    )
                expected = row.seq + 1
                if self._progress is not None and number % PROGRESS_ROWS == 0:
                    read = self._read_bytes + hour.size_bytes * number // hour.rows
                    self._progress(read, self._recorded.size_bytes)
                yield row
            self._read_bytes += hour.size_bytes


def config_of(hour: Hour) -> Config:
    """The configuration of a file.

    Raises:
        RecordedError: this release has other keys.
    """
    return _decoded(hour, bytes(hour.header.config))


def _decoded(hour: Hour, text: bytes) -> Config:
    try:
        return msgspec.json.decode(text, type=Config)
    except msgspec.MsgspecError as error:
        raise RecordedError(
            f"{hour.path}: was recorded by release {hour.header.release} with a configuration that this one does not "
            f"take ({error}): give one with --config, or use that release"
        ) from error


class Learning:
    """What the replay learns by itself, instead of taking what the daemon had learned."""

    def __init__(self, trainer: BlockingTrainer, count: Callable[[str, str], None]) -> None:
        """``count`` is told ``fits`` or ``trainings``, and what became of one."""
        self._trainer, self._count = trainer, count

    def look_after(self, pipeline: Pipeline) -> None:
        """Do what is due."""
        if (past := pipeline.fit_due()) is not None:
            self._count("fits", pipeline.accept_fit(look(past)))
        if (window := pipeline.training_due()) is not None:
            self._count("trainings", pipeline.accept(self._trainer.fit(window)))


class Rerun:
    """One run of the daemon, again.

    Attributes:
        pipeline: as the daemon had it.
        has_begun: a call was made.
    """

    def __init__(
        self,
        hour: Hour,
        config: Config | None,
        emit: Callable[[MotionFrame], None],
        count: Callable[[str, str], None],
        learning: Learning | None,
    ) -> None:
        """``config``: in place of the recorded ones; None: those. ``emit`` is given the frames that the daemon
        published. ``learning``: None takes the models as recorded.
        """
        self._hour, self._is_as_recorded = hour, config is None
        self._emit, self._count, self._learning = emit, count, learning
        self._has_laser = any(device.role == "laser" for device in hour.header.layout.devices)
        config = config_of(hour) if config is None else config
        stages = Stages(config.hull, config.attitude, config.crane, refit_inline=learning is not None)
        self.pipeline = self._assembled(config, stages)
        self.has_begun = False
        self._published_s = -inf
        self._job: RefitJob | None = None
        self._refit: RefitResult | None = None
        """Of that job, made where it was due."""

    def warm_up(self) -> str:
        """Begin as a restart would at the beginning of the file; why not, if that cannot be."""
        self.has_begun = True
        try:
            state = msgspec.json.decode(bytes(self._hour.header.learned), type=SavedState)
            self.pipeline.restore(state, 0.0)
        except (msgspec.MsgspecError, ValueError) as error:
            return str(error)
        return ""

    def take(self, row: Row) -> None:
        """Make this call again.

        Raises:
            RecordedError: it goes with a record that cannot be read.
        """
        self.has_begun = True
        try:
            self._take(row)
        except msgspec.MsgspecError as error:
            raise RecordedError(f"{self._hour.path}: {row.call.value} at call {row.seq} is damaged: {error}") from error

    def _take(self, row: Row) -> None:
        call = row.call
        if row.sample is not None:
            self._published(self._step(row.sample))
            self._look_after_work()
        elif call is Call.COAST:
            self._published(self._coast(row.t_s))
        elif call is Call.RESTORED:
            restored = msgspec.msgpack.decode(row.record, type=Restored)
            self.pipeline.restore(restored.state, restored.age_s)
        elif call in (Call.PIPELINE, Call.HULL, Call.ATTITUDE, Call.CRANE):
            if self._is_as_recorded:
                self._configure(call, _decoded(self._hour, row.record))
        elif self._learning is None:
            self._learn(row)

    def _learn(self, row: Row) -> None:
        """Take what the daemon took, where it took it."""
        if row.call is Call.NETWORK:
            network = msgspec.msgpack.decode(row.record, type=TrainedNetwork)
            self._count("trainings", self._accepted(partial(self.pipeline.accept, network)))
        elif row.call is Call.FIT:
            fit = msgspec.msgpack.decode(row.record, type=SeaFit)
            self._count("fits", self._accepted(partial(self.pipeline.accept_fit, fit)))
        else:
            job, self._job = self._job, None
            if job is not None and self.pipeline.stages.due_refit is job:
                self.pipeline.stages.accept(self._refit if row.call is Call.REFIT else None)

    def _accepted(self, accept: Callable[[], Verdict]) -> Verdict:
        try:
            return accept()
        except Exception:  # As the daemon does, and the recording shows what it came from.  # noqa: BLE001
            return Verdict.FAILED

    def _step(self, sample: Sample) -> MotionFrame | None:
        try:
            return self.pipeline.step(sample)
        except Exception:  # Likewise.  # noqa: BLE001
            self._count("errors", "step")
        return self._coast(sample.t_s) if isinstance(sample, ImuSample) else None

    def _coast(self, t_s: float) -> MotionFrame | None:
        try:
            return self.pipeline.coast(t_s)
        except Exception:  # Likewise.  # noqa: BLE001
            self._count("errors", "coast")
            return None

    def _published(self, frame: MotionFrame | None) -> None:
        if frame is not None and frame.t_s > self._published_s:
            self._published_s = frame.t_s
            self._emit(frame)

    def _look_after_work(self) -> None:
        """What the daemon hands out after each poll: handing out is part of the estimators' state."""
        if self._learning is not None:
            self._learning.look_after(self.pipeline)
            return
        self.pipeline.training_due()
        self.pipeline.fit_due()
        job = self.pipeline.stages.due_refit
        if job is not None and job is not self._job:
            self._job, self._refit = job, refit(job)

    def _assembled(self, config: Config, stages: Stages) -> Pipeline:
        return assembled(config, stages, has_laser=self._has_laser)

    def _configure(self, call: Call, config: Config) -> None:
        stages = self.pipeline.stages
        if call is Call.HULL:
            stages.configure_hull(config.hull)
        elif call is Call.ATTITUDE:
            stages.configure_attitude(config.attitude)
        elif call is Call.CRANE:
            stages.configure_crane(config.crane)
        else:
            learned = self.pipeline.state()
            self._has_laser = config.has_laser
            self.pipeline = self._assembled(config, stages)
            try:
                self.pipeline.restore(learned)
            except ValueError:
                self._count("errors", "what was learned does not fit the new configuration")
