"""Replay: a recording through the very pipeline of the daemon, causal and repeatable to the byte.

Nothing here depends on the time of day or on how fast the machine is: the pipeline hands over a training window at a
time of the recording, replay waits for the network, and the pipeline judges it before the next sample.
"""

from __future__ import annotations

import os
import sys
import time
from array import array
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain, groupby, islice
from math import inf, isnan, nan, pi
from operator import attrgetter
from pathlib import Path
from typing import Final, TextIO

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.config import Config
from heaved.decimals import cell, lines
from heaved.devices.recording import Recording
from heaved.estimation.rock import STANDARD_HORIZONS_S
from heaved.estimation.sea_window import look
from heaved.estimation.stages import Stages
from heaved.pipeline import Pipeline
from heaved.predictions import HeaveForecasts, RockPredictions, turned
from heaved.samples import DelayedHeave, HeaveState, MotionFrame
from heaved.training.process import BlockingTrainer

Array = NDArray[np.float64]

_TEXTS: Final = {state: state.value for state in HeaveState}
_DEGREES: Final = 180.0 / pi
_ATTITUDE: Final = (("z", "m"), ("z_rate", "mps"), ("pitch", "deg"), ("pitch_rate", "degps"))
DELAYED: Final = "~"
"""Stands for a cell that is not known yet."""
MAX_STEP_S: Final = 0.5
"""Delayed heaves further apart than this have a hole between them."""
BLOCK_ROWS: Final = 256
"""Rows that are made into text together; they wait for their delayed heave anyway."""
_PROGRESS_ROWS: Final = 500
"""Rows between two calls of ``progress``."""

Progress = Callable[[int, int], None]
"""(bytes read, bytes in all)"""


class OutputError(Exception):
    """The result cannot be written; the message says where, why and what to do."""


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
    """Training windows by what became of them: accepted, rejected, failed."""
    fits: dict[str, int]
    """Fits of the sea likewise."""

    def __str__(self) -> str:
        speed = self.duration_s / self.elapsed_s if self.elapsed_s > 0.0 else inf
        shares = ", ".join(
            f"{100.0 * self.quality[state] / self.frames:.1f} % {state.value}"
            for state in HeaveState
            if self.quality.get(state)
        )
        fitted = ", ".join(f"{count} {result}" for result, count in sorted(self.fits.items()))
        trained = ", ".join(f"{count} {result}" for result, count in sorted(self.trainings.items()))
        return (
            f"{self.rows} rows, {self.duration_s:.1f} s of motion in {self.elapsed_s:.1f} s "
            f"({speed:.0f} x real time)\n"
            f"{self.frames} frames: {shares or 'no row has az_mps2'}\n"
            f"fits of the sea: {fitted or 'none'}; training windows: {trained or 'none'}"
        )


_OF_FRAME: Final = attrgetter(
    "heave_m", "heave_std_m", "heave_velocity_mps", "observer_m", "correction_m", "lead_s"
)  # fmt: skip


class Columns:
    """The columns of the result for one configuration, and the text of frames in them."""

    def __init__(self, config: Config) -> None:
        self._forecasts = config.heave.forecast_horizons_s
        self._rocks = tuple(sorted({*config.rock.horizons_s, *STANDARD_HORIZONS_S}))
        forecasts = [f"forecast_{h:g}s_{what}" for h in self._forecasts for what in ("m", "std_m")]
        rocks = [
            f"{axis}_{h:g}s_{what}"
            for axis in ("roll", "pitch", "yaw")
            for h in self._rocks
            for what in ("deg", "std_deg")
        ]
        heave = ["heave_m", "heave_std_m", "heave_velocity_mps", "observer_m", "correction_m", "lead_s"]
        self._hull, self._attitude = config.hull.enabled, config.attitude.enabled
        hull = [*(f"hull_{axis}_deg" for axis in "xyz"), *(f"hull_static_{axis}_deg" for axis in "xyz"),
                *(f"hull_{axis}_std_arcsec" for axis in "xyz")]  # fmt: skip
        attitude = [f"attitude_{what}_{unit}" for quantity, unit in _ATTITUDE for what in (quantity, f"{quantity}_std")]
        staged = (hull if self._hull else []) + (attitude if self._attitude else [])
        self.names = ("t_s", *heave, "quality", "delayed_heave_m", *forecasts, *rocks, *staged)

    def header(self) -> str:
        return ",".join(self.names) + "\n"

    def row(self, frame: MotionFrame) -> str:
        """One line, as of :meth:`rows`."""
        return self.rows([frame])[0][1]

    def rows(self, frames: Iterable[MotionFrame]) -> list[tuple[float, str, DelayedHeave | None]]:
        """For each of ``frames`` its time, its line but for the delayed heave of that time, whose place is held by
        DELAYED, and the delayed heave that is newest by then. What is not known is blank, never zero."""
        frames = list(frames)
        if not frames:
            return []
        now = lines(np.frombuffer(array("d", chain.from_iterable(map(_OF_FRAME, frames)))).reshape(len(frames), -1))
        parts = [_forecast_numbers(frames, self._forecasts), _rock_numbers(frames, self._rocks)]
        if self._hull:
            parts.append(np.array([_hull_numbers(frame) for frame in frames]))
        if self._attitude:
            parts.append(np.array([_attitude_numbers(frame) for frame in frames]))
        ahead = lines(np.concatenate(parts, axis=1))
        return [
            (frame.t_s, f"{frame.t_s:.6f},{first},{_TEXTS[frame.quality.heave]},{DELAYED},{later}\n", frame.delayed)
            for frame, first, later in zip(frames, now, ahead, strict=True)
        ]


def _forecast_numbers(frames: Sequence[MotionFrame], horizons_s: tuple[float, ...]) -> Array:
    """(n, 2 H): heave and its standard deviation, horizon by horizon."""
    forecasts = [HeaveForecasts.of(frame.forecast, horizons_s) for frame in frames]
    flat = array("d")
    for forecast in forecasts:
        flat.extend(forecast.heaves_m)
        flat.extend(forecast.stds_m)
    return np.frombuffer(flat).reshape(len(frames), 2, -1).transpose(0, 2, 1).reshape(len(frames), -1)


def _rock_numbers(frames: Sequence[MotionFrame], horizons_s: tuple[float, ...]) -> Array:
    """(n, 6 H): angle and its standard deviation in degrees, axis by axis and there horizon by horizon."""
    rocks = [RockPredictions.of(frame.rock, horizons_s) for frame in frames]
    numbers = np.empty((len(rocks), 3, len(horizons_s), 2))
    angles, stds = numbers[..., 0], numbers[..., 1]
    angles[:] = RockPredictions.angles_of(rocks).transpose(0, 2, 1)
    angles[:, 2] = turned(angles[:, 2] + np.array([rock.yaw_from_rad for rock in rocks])[:, None])
    end = 0
    for _, alike in groupby([rock.stds_rad for rock in rocks], key=id):  # they change once every few seconds
        same = list(alike)
        stds[end : end + len(same)] = same[0].T
        end += len(same)
    return numbers.reshape(len(rocks), -1) * _DEGREES


def _hull_numbers(frame: MotionFrame) -> list[float]:
    """The newest deformation, some tenths of a second older than the row."""
    if frame.hull is None:
        return [nan] * 9
    angles = [_DEGREES * angle for angle in (*frame.hull.total_rad, *frame.hull.static_rad)]
    return angles + [3600.0 * _DEGREES * std for std in frame.hull.std_rad]


def _attitude_numbers(frame: MotionFrame) -> list[float]:
    motion = frame.attitude
    if motion is None:
        return [nan] * 8
    return [
        motion.heave_m,
        motion.heave_std_m,
        motion.heave_velocity_mps,
        motion.heave_velocity_std_mps,
        _DEGREES * motion.pitch_rad,
        _DEGREES * motion.pitch_std_rad,
        _DEGREES * motion.pitch_rate_radps,
        _DEGREES * motion.pitch_rate_std_radps,
    ]


class DelayedColumn:
    """Holds rows back until the delayed heave of their time is known, a minute later, and puts it in."""

    def __init__(self, write: Callable[[str], object]) -> None:
        self._write = write
        self._rows: deque[tuple[float, str]] = deque()
        self._last: DelayedHeave | None = None

    def put(self, t_s: float, row: str, delayed: DelayedHeave | None) -> None:
        """A row and its time; ``delayed``: what is newest now."""
        self._rows.append((t_s, row))
        if delayed is None or delayed is self._last:
            return
        before, self._last = self._last, delayed
        while self._rows and self._rows[0][0] <= delayed.t_s:
            at_s, waiting = self._rows.popleft()
            self._write(waiting.replace(DELAYED, cell(_between(before, delayed, at_s)), 1))

    def flush(self) -> None:
        """What has no delayed heave any more."""
        while self._rows:
            self._write(self._rows.popleft()[1].replace(DELAYED, "", 1))


def _between(before: DelayedHeave | None, after: DelayedHeave, t_s: float) -> float:
    """Linear, since neighbours are 50 ms apart; nan outside, and in holes."""
    if t_s == after.t_s:
        return after.heave_m
    if before is None or not before.t_s <= t_s or after.t_s - before.t_s > MAX_STEP_S:
        return nan
    share = (t_s - before.t_s) / (after.t_s - before.t_s)
    return before.heave_m + share * (after.heave_m - before.heave_m)


def replay(
    source: Path, out: Path | None, config: Config, *, until_s: float = inf, progress: Progress | None = None
) -> Summary:
    """Run the recording ``source`` through the pipeline; the result goes to ``out``, or to standard output if None.

    until_s: seconds of the recording, from its first row, after which to stop.

    Raises:
        RecordingError: the recording is malformed; nothing is written.
        OutputError: the result cannot be written; nothing is left behind.
    """
    begun_s = time.monotonic()
    if out is not None and out.exists() and out.samefile(source):
        raise OutputError(f"{out} is the recording itself: name another file with -o")
    with Recording(source) as recording, BlockingTrainer() as trainer, _writing(out) as file:
        columns = Columns(config)
        file.write(columns.header())
        run = _Run(_pipeline(config, recording.has_laser), trainer)
        rows = DelayedColumn(file.write)
        frames = run.frames(recording, until_s, progress)
        while block := columns.rows(islice(frames, BLOCK_ROWS)):
            for t_s, row, delayed in block:
                rows.put(t_s, row, delayed)
        rows.flush()
    return run.summary(time.monotonic() - begun_s)


def _pipeline(config: Config, has_laser: bool) -> Pipeline:
    return Pipeline(
        heave=config.heave,
        laser=config.laser,
        correction=config.correction,
        rock=config.rock,
        has_laser=has_laser,
        point=config.point,
        lead_s=config.compensation.lead_s,
        stages=Stages(config.hull, config.attitude),
        quiet=config.quiet,
    )


class _Run:
    """One pass over a recording, and what it counts."""

    def __init__(self, pipeline: Pipeline, trainer: BlockingTrainer) -> None:
        self._pipeline = pipeline
        self._trainer = trainer
        self._rows = 0
        self._duration_s = 0.0
        self._quality: Counter[HeaveState] = Counter()
        self._trainings: Counter[str] = Counter()
        self._fits: Counter[str] = Counter()

    def frames(self, recording: Recording, until_s: float, progress: Progress | None) -> Iterator[MotionFrame]:
        first_s = nan
        for imu, laser, rates, craft in recording.instants():
            sample = imu or laser or rates or craft
            if sample is not None:
                first_s = sample.t_s if isnan(first_s) else first_s
                if sample.t_s - first_s > until_s:
                    break
                self._duration_s = sample.t_s - first_s
            self._rows += 1
            # The IMU last: a row is one instant, and what the others say is known when its frame is made.
            for reading in (laser, rates, craft, imu):
                if reading is None:
                    continue
                frame = self._pipeline.step(reading)
                if (past := self._pipeline.fit_due()) is not None:
                    self._fits[self._pipeline.accept_fit(look(past))] += 1
                if (window := self._pipeline.training_due()) is not None:
                    self._trainings[self._pipeline.accept(self._trainer.fit(window))] += 1
                if frame is not None:
                    self._quality[frame.quality.heave] += 1
                    yield frame
            if progress is not None and self._rows % _PROGRESS_ROWS == 0:
                progress(recording.read_bytes, recording.total_bytes)

    def summary(self, elapsed_s: float) -> Summary:
        return Summary(
            rows=self._rows,
            frames=self._quality.total(),
            duration_s=self._duration_s,
            elapsed_s=elapsed_s,
            quality=dict(self._quality),
            trainings=dict(self._trainings),
            fits=dict(self._fits),
        )


@contextmanager
def _writing(out: Path | None) -> Iterator[TextIO]:
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
