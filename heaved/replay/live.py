"""A daemon's recording through the pipeline again: each call that the daemon made, in the order in which it made them.

The samples, the moments at which frames were made without one, the models and when each was taken are in the recording;
all the rest is a pure function of these, so the frames come out the same, to the last bit.
"""

from __future__ import annotations

import time
from functools import partial
from math import inf, isfinite, isnan, nan
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.config import Config
from heaved.estimation.heave.observer import Verdict
from heaved.estimation.heave.saved_state import SavedState
from heaved.estimation.heave.sea.refit import SeaFit, SeaWindow, look
from heaved.estimation.hull.refit import RefitJob, RefitResult, refit
from heaved.estimation.stages import Stages
from heaved.recorder.calls import Restored, unpack_fit
from heaved.recorder.found import RecordedError
from heaved.recorder.layout import SAMPLES, Call
from heaved.recorder.read import Hour, Recorded, Row, open_recorded, rows_of
from heaved.replay.replay import NOTHING_TO_LEARN, Summary, Tally, assembled
from heaved.samples import Fault, ImuSample, MotionFrame, TrainedNetwork

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
        progress: is told now and then how much of it has been read.
    """

    def __init__(self, path: Path) -> None:
        """
        Raises:
            RecordedError: it is not one.
        """
        self.progress: Progress | None = None
        self._recorded: Recorded = open_recorded(path, SAMPLES)
        self.remarks = list(self._recorded.remarks)
        self.config = config_of(self._recorded.hours[0])
        self._read_bytes = 0

    @property
    def columns(self) -> tuple[str, ...]:
        """What was measured: a device and a quantity each."""
        layout = self._recorded.hours[0].header.layout
        return tuple(f"{device.name}.{column.name}" for device in layout.devices for column in device.columns)

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
                if self.progress is not None and number % PROGRESS_ROWS == 0:
                    read = self._read_bytes + hour.size_bytes * number // hour.rows
                    self.progress(read, self._recorded.size_bytes)
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

    def look_after(self, pipeline: Pipeline) -> SeaFit | None:
        """Do what is due; the fit that was accepted, if one was."""
        accepted = None
        if (past := pipeline.fit_due()) is not None:
            fit = _looked(past)
            verdict = Verdict.FAILED if fit is None else pipeline.accept_fit(fit)
            self._count("fits", verdict)
            accepted = fit if verdict is Verdict.ACCEPTED else None
        if (window := pipeline.training_due()) is not None:
            self._count("trainings", pipeline.accept(self._trainer.fit(window)))
        return accepted


def _looked(past: SeaWindow) -> SeaFit | None:
    try:
        return look(past)
    except Exception:  # The daemon's fitter would die of it, too: what was learned stays.  # noqa: BLE001
        return None


class Rerun:
    """One run of the daemon, again.

    Attributes:
        pipeline: as the daemon had it.
        has_begun: a call was made.
        fit: of the sea, that was taken over last; None: none yet.
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
        stages = Stages(
            config.hull, config.attitude, config.crane, config.reference_mru, refit_inline=learning is not None
        )
        self.pipeline = self._assembled(config, stages)
        self.has_begun = False
        self.fit: SeaFit | None = None
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
        elif call in (Call.PIPELINE, Call.HULL, Call.ATTITUDE, Call.CRANE, Call.REFERENCE_MRU):
            if self._is_as_recorded:
                self._configure(call, _decoded(self._hour, row.record))
        elif call in (Call.RELIEVED, Call.RESUMED):
            if self._is_as_recorded and self._learning is None:
                self.pipeline.relieve(is_relieved=call is Call.RELIEVED)
        elif self._learning is None:
            self._learn(row)

    def _learn(self, row: Row) -> None:
        """Take what the daemon took, where it took it."""
        if row.call is Call.NETWORK:
            network = msgspec.msgpack.decode(row.record, type=TrainedNetwork)
            self._count("trainings", self._accepted(partial(self.pipeline.accept, network)))
        elif row.call is Call.FIT:
            fit = unpack_fit(row.record)
            verdict = self._accepted(partial(self.pipeline.accept_fit, fit))
            self._count("fits", verdict)
            self.fit = fit if verdict is Verdict.ACCEPTED else self.fit
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
            self.fit = self._learning.look_after(self.pipeline) or self.fit
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
        elif call is Call.REFERENCE_MRU:
            stages.configure_reference_mru(config.reference_mru)
        else:
            learned = self.pipeline.state()
            self._has_laser = config.has_laser
            self.pipeline = self._assembled(config, stages)
            try:
                self.pipeline.restore(learned)
            except ValueError:
                self._count("errors", "what was learned does not fit the new configuration")


class RecordedRun:
    """A daemon's recording on its way through the pipeline; the same to whoever follows it as
    :class:`heaved.replay.replay.Run`.

    Attributes:
        recording: what is replayed.
        config: of its beginning.
        number: of the run of the daemon that is being replayed, from 1 on.
    """

    def __init__(self, recording: LiveRecording, trainer: BlockingTrainer, config: Config | None, learn: bool) -> None:
        """``config``: in place of the recorded ones; None: those. ``learn``: anew, instead of taking the models."""
        self.recording = recording
        self.config = config or recording.config
        self.number = 0
        self._other, self._trainer, self._learn = config, trainer, learn
        self._tally = Tally()
        self._begun_s = time.monotonic()
        self._rerun: Rerun | None = None

    @property
    def pipeline(self) -> Pipeline:
        """Its state is that after the step given last."""
        assert self._rerun is not None
        return self._rerun.pipeline

    @property
    def fit(self) -> SeaFit | None:
        """Of the sea, that was taken over last; None: none yet."""
        return None if self._rerun is None else self._rerun.fit

    def steps(
        self, *, until_s: float = inf, progress: Progress | None = None
    ) -> Iterator[tuple[Sample, MotionFrame | None]]:
        """Each sample, and the frame that the daemon published of it. For a frame that was made without a sample, one
        of the IMU that says so.

        until_s: seconds of the recording, from its first call, after which to stop.

        Raises:
            RecordedError: something in it cannot be read.
        """
        self.recording.progress = progress
        for hour, rows in self.recording.runs():
            self.number += 1
            made: list[MotionFrame] = []
            learning = Learning(self._trainer, self._tally.became) if self._learn else None
            rerun = self._rerun = Rerun(hour, self._other, made.append, self._tally.became, learning)
            for row in self._rows(rerun, hour, rows, until_s):
                rerun.take(row)
                for frame in made:
                    self._tally.count(frame.t_s, frame.quality)
                frame_or_none = made[0] if made else None
                made.clear()
                if row.sample is not None:
                    yield row.sample, frame_or_none
                elif frame_or_none is not None:
                    yield ImuSample(t_s=row.t_s, fault=Fault.TIMEOUT), frame_or_none
            if (spared := rerun.pipeline.summary().windows_with_nothing_to_learn) > 0:
                self._tally.trainings[NOTHING_TO_LEARN] += spared
            if self._tally.duration_s >= until_s:
                return

    def _rows(self, rerun: Rerun, hour: Hour, rows: Iterator[Row], until_s: float) -> Iterator[Row]:
        """Those up to ``until_s``; a run whose beginning is not there begins with what was known then."""
        tally = self._tally
        before_s, first_s = tally.duration_s, nan
        for row in rows:
            if row.seq > 0 and not rerun.has_begun:
                tally.remarks.append(_within_a_run(hour.path.name, rerun.warm_up()))
            if isfinite(row.t_s):
                first_s = row.t_s if isnan(first_s) else first_s
                elapsed_s = before_s + row.t_s - first_s
                if elapsed_s > until_s:
                    tally.duration_s = until_s
                    return
                tally.duration_s = max(tally.duration_s, elapsed_s)
            tally.rows += row.sample is not None
            yield row

    def summary(self) -> Summary:
        """What has been done so far."""
        return self._tally.summary(time.monotonic() - self._begun_s, self.recording.remarks)


def _within_a_run(name: str, failure: str) -> str:
    warm = f"and nothing can be taken from the run before ({failure})" if failure else "with what a restart would know"
    return (
        f"{name} begins within a run of the daemon: the replay begins {warm}, and is the same as what the daemon "
        "published once the filters have settled"
    )
