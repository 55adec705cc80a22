"""Replay: a recording through the very pipeline of the daemon, causal and repeatable to the byte.

Nothing here depends on the time of day or on how fast the machine is. Of a CSV, the pipeline hands over a training
window at a time of the recording, replay waits for the network, and the pipeline judges it before the next sample. What
a daemon has recorded has its models with it, and where it took them: see :mod:`heaved.replay.live`.
"""

from __future__ import annotations

import os
import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from math import inf, isnan, nan
from typing import TYPE_CHECKING, Final, TextIO

import msgspec

from heaved.config import Config
from heaved.devices.recording import Recording
from heaved.estimation.heave.observer import Verdict
from heaved.estimation.heave.sea.refit import SeaFit, SeaWindow, look
from heaved.estimation.stages import Stages
from heaved.pipeline import Pipeline, assemble
from heaved.recorder.found import is_recorded, need_reader
from heaved.replay.table import Table
from heaved.samples import HeaveState, MotionFrame, Quality, Sample
from heaved.text import printable
from heaved.workers.process import BlockingTrainer

if TYPE_CHECKING:
    from pathlib import Path

    from heaved.replay.live import RecordedRun


PROGRESS_SAMPLES: Final = 64
"""Progress is told after so many."""
NOTHING_TO_LEARN: Final = "with nothing to learn"
"""Of training windows: no network would have been accepted, as a regression has shown."""
MOST_REASONS: Final = 12
"""That are printed."""
_NUMBER: Final = re.compile(r"[-+]?\d+(\.\d+)?")

Progress = Callable[[int, int], None]
"""(bytes read, bytes in all)"""


class OutputError(Exception):
    """The result cannot be written; the message says where, why and what to do."""


class Reason(msgspec.Struct, frozen=True, kw_only=True):
    """One reason that frames gave for their quality."""

    text: str
    """As the first of them gave it."""
    varies: bool = False
    """Others gave it with other numbers."""
    frames: int
    first_s: float
    """``t_s`` of the first frame that gave it."""


class Summary(msgspec.Struct, frozen=True, kw_only=True):
    """What a replay did."""

    rows: int
    """Of the recording."""
    frames: int
    """Rows of the result."""
    duration_s: float
    """Of the recording, from the first row to the last one replayed."""
    elapsed_s: float
    """By the clock on the wall."""
    quality: dict[HeaveState, int]
    """Frames by how far their heave can be trusted."""
    trainings: dict[str, int]
    """Training windows by what became of them: accepted, rejected, failed, or not trained: nothing to learn."""
    fits: dict[str, int]
    """Fits of the sea likewise."""
    failure: str = ""
    """What the last fit that could not be made died of, if one did: a fault of the program."""
    reasons: tuple[Reason, ...] = ()
    """What frames said of their quality, the most frequent first."""
    remarks: tuple[str, ...] = ()
    """What should be known of the recording."""

    def __str__(self) -> str:
        speed = self.duration_s / self.elapsed_s if self.elapsed_s > 0.0 else inf
        shares = ", ".join(
            f"{100.0 * self.quality[state] / self.frames:.1f} % {state.value}"
            for state in HeaveState
            if self.quality.get(state)
        )
        fitted = ", ".join(f"{count} {result}" for result, count in sorted(self.fits.items()))
        fitted += f" (the last one died of {printable(self.failure)})" if self.failure else ""
        trained = ", ".join(f"{count} {result}" for result, count in sorted(self.trainings.items()))
        return (
            f"{self.rows} rows, {self.duration_s:.1f} s of motion in {self.elapsed_s:.1f} s "
            f"({speed:.0f} x real time)\n"
            f"{self.frames} frames: {shares or 'no row has az_mps2'}\n"
            f"fits of the sea: {fitted or 'none'}; training windows: {trained or 'none'}{self._told_reasons()}"
            + "".join(f"\nremark: {printable(remark)}" for remark in self.remarks)
        )

    def _told_reasons(self) -> str:
        lines = [
            f"\n  {100.0 * reason.frames / self.frames:5.1f} % of the frames, first at t_s {reason.first_s:.2f}: "
            f"{printable(reason.text)}{' (later with other numbers)' if reason.varies else ''}"
            for reason in self.reasons[:MOST_REASONS]
        ]
        more = len(self.reasons) - len(lines)
        return (f"\nreasons:{''.join(lines)}" if lines else "") + (f"\n  and {more} more" if more else "")


def replay(
    source: Path,
    out: Path | None,
    config: Config | None = None,
    *,
    learn_anew: bool = False,
    until_s: float = inf,
    progress: Progress | None = None,
) -> Summary:
    """Run the recording ``source`` through the pipeline; the result goes to ``out``, or to standard output if None.

    config: None: of what a daemon has recorded, as it was recorded; of a CSV, the defaults.
    learn_anew: what a daemon has recorded is learned from again, instead of taking its models; so it is with another
        configuration in any case, to which they need not fit.
    until_s: seconds of the recording, from its first row, after which to stop.

    Raises:
        RecordingError, RecordedError: the recording is malformed; nothing is written.
        OutputError: the result cannot be written; nothing is left behind.
    """
    if out is not None and out.exists() and out.samefile(source):
        raise OutputError(f"{out} is the recording itself: name another file with -o")
    with replaying(source, config, learn_anew=learn_anew) as run, writing(out) as file:
        table = Table(run.config, file.write)
        number = run.number
        for _, frame in run.steps(until_s=until_s, progress=progress):
            if run.number != number:
                number = run.number
                table.begin_run()
            if frame is not None:
                table.push(frame)
        table.flush()
    return run.summary()


@contextmanager
def replaying(source: Path, config: Config | None = None, *, learn_anew: bool = False) -> Iterator[Run | RecordedRun]:
    """The recording ``source``, ready to go through the pipeline; ``config`` and ``learn_anew`` as for :func:`replay`.

    Raises:
        RecordingError, RecordedError: the recording is malformed.
    """
    if is_recorded(source):
        need_reader(source)
        from heaved.replay.live import LiveRecording, RecordedRun  # What they read with need not be installed.

        live = LiveRecording(source)
        with BlockingTrainer() as trainer:
            yield RecordedRun(live, trainer, config, learn_anew or config is not None)
        return
    with Recording(source) as recording, BlockingTrainer() as trainer:
        yield Run(recording, trainer, config or Config())


class Run:
    """A recording on its way through the pipeline. Go once over its :meth:`steps`.

    Attributes:
        recording: the open file.
        config: of the pipeline.
        number: of the run that it is of; a CSV is one.
        pipeline: its state is that after the sample given last.
        fit: of the sea, that was taken over last; None: none yet.
    """

    def __init__(self, recording: Recording, trainer: BlockingTrainer, config: Config) -> None:
        self.recording = recording
        self.config = config
        self.number = 1
        self.pipeline = assembled(
            config,
            Stages(config.hull, config.attitude, config.crane, config.reference_mru),
            has_laser=recording.has_laser,
        )
        self.fit: SeaFit | None = None
        self._trainer = trainer
        self._tally = Tally()
        self._begun_s = time.monotonic()

    def steps(
        self, *, until_s: float = inf, progress: Progress | None = None
    ) -> Iterator[tuple[Sample, MotionFrame | None]]:
        """Each sample of the recording, and the frame that it gives: one of the IMU does.

        until_s: seconds of the recording, from its first row, after which to stop.

        Raises:
            RecordingError: at the row that is malformed.
        """
        recording, pipeline, tally = self.recording, self.pipeline, self._tally
        for number, sample in enumerate(_samples(recording, until_s, tally), start=1):
            frame = pipeline.step(sample)
            if frame is not None:
                tally.count(frame.t_s, frame.quality)
                if (past := pipeline.fit_due()) is not None:
                    tally.fits[self._fit(past)] += 1
                if (window := pipeline.training_due()) is not None:
                    tally.trainings[pipeline.accept(self._trainer.fit(window))] += 1
            yield sample, frame
            if progress is not None and number % PROGRESS_SAMPLES == 0:
                progress(recording.read_bytes, recording.total_bytes)
        if progress is not None:
            progress(recording.read_bytes, recording.total_bytes)

    def _fit(self, past: SeaWindow) -> str:
        try:
            fit = look(past)
        except Exception as error:  # The daemon's fitter would die of it, too: what was learned stays.  # noqa: BLE001
            self._tally.failure = repr(error)
            return "failed"
        verdict = self.pipeline.accept_fit(fit)
        if verdict is Verdict.ACCEPTED:
            self.fit = fit
        return verdict

    def summary(self) -> Summary:
        """What has been done so far."""
        if (spared := self.pipeline.summary().windows_with_nothing_to_learn) > 0:
            self._tally.trainings[NOTHING_TO_LEARN] = spared
        return self._tally.summary(time.monotonic() - self._begun_s)


def assembled(config: Config, stages: Stages, *, has_laser: bool) -> Pipeline:
    """The pipeline of a configuration."""
    return assemble(
        heave=config.heave,
        laser=config.laser,
        correction=config.correction,
        rock=config.rock,
        has_laser=has_laser,
        point=config.point,
        lead_s=config.compensation.lead_s,
        stages=stages,
        quiet=config.quiet,
        attitude_late_s=config.attitude_late_s,
    )


def _samples(recording: Recording, until_s: float, tally: Tally) -> Iterator[Sample]:
    """All samples up to ``until_s``, in order."""
    first_s = nan
    for imu, laser, rates, craft, crane in recording.instants():
        sample = imu or laser or rates or craft or crane
        if sample is not None:
            first_s = sample.t_s if isnan(first_s) else first_s
            if sample.t_s - first_s > until_s:
                return
            tally.duration_s = sample.t_s - first_s
        tally.rows += 1
        # The IMU last: a row is one instant, and what the others say is known when its frame is made.
        for reading in (laser, rates, craft, crane, imu):
            if reading is not None:
                yield reading


class Tally:
    """What is counted while a recording goes through the pipeline; see :class:`Summary`."""

    def __init__(self) -> None:
        self.rows = 0
        self.duration_s = 0.0
        self.trainings: Counter[str] = Counter()
        self.fits: Counter[str] = Counter()
        self.failure = ""
        self.remarks: list[str] = []
        self.errors: Counter[str] = Counter()
        self._quality: Counter[HeaveState] = Counter()
        self._reasons: dict[str, _CountedReason] = {}
        """By their texts without the numbers."""

    def count(self, t_s: float, quality: Quality) -> None:
        """One frame."""
        self._quality[quality.heave] += 1
        for text in quality.reasons:
            kind = without_numbers(text)
            reason = self._reasons.get(kind)
            if reason is None:
                reason = self._reasons[kind] = _CountedReason(text, t_s)
            reason.frames += 1
            reason.varies |= text != reason.text

    def became(self, what: str, result: str) -> None:
        """``fits``, ``trainings`` or ``errors``: what became of one."""
        {"fits": self.fits, "trainings": self.trainings, "errors": self.errors}[what][result] += 1

    def summary(self, elapsed_s: float, remarks: Sequence[str] = ()) -> Summary:
        """``elapsed_s``: by the clock on the wall. ``remarks``: on the recording."""
        return Summary(
            rows=self.rows,
            frames=self._quality.total(),
            duration_s=self.duration_s,
            elapsed_s=elapsed_s,
            quality=dict(self._quality),
            trainings=dict(self.trainings),
            fits=dict(self.fits),
            failure=self.failure,
            reasons=tuple(
                Reason(text=one.text, varies=one.varies, frames=one.frames, first_s=one.first_s)
                for one in sorted(self._reasons.values(), key=lambda one: -one.frames)
            ),
            remarks=(
                *self.remarks,
                *remarks,
                *(f"{count} times an error: {what}" for what, count in self.errors.items()),
            ),
        )


class _CountedReason(msgspec.Struct):
    """A reason, while it is counted."""

    text: str
    first_s: float
    frames: int = 0
    varies: bool = False


@lru_cache(maxsize=256)
def without_numbers(text: str) -> str:
    """What a reason is, whatever the numbers in it."""
    return _NUMBER.sub("…", text)


@contextmanager
def writing(out: Path | None) -> Iterator[TextIO]:
    """A file that appears under its name only when it is whole; pipes and devices are written as they are.

    Raises:
        OutputError: it cannot be written.
    """
    if out is None:
        try:
            yield sys.stdout
            sys.stdout.flush()
        except OSError as error:
            # What is still buffered cannot be written either: the interpreter would try, and say so, as it exits.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise OutputError(f"standard output: cannot be written: {error.strerror or error}") from error
        return
    is_special = out.exists() and not out.is_file()
    target = out.resolve()
    partial = target if is_special else target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with partial.open("w", encoding="utf-8", newline="") as file:
            yield file
        if not is_special:
            partial.replace(target)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written: {error.strerror or error}; name another file with -o") from error
    finally:
        if not is_special:
            partial.unlink(missing_ok=True)
