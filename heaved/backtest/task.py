"""One task of a backtest: one recording with one configuration, from the file to a row of the table.

It may be done twice, by two workers at once, or be cut off at any moment: its result is written under another name and
renamed when it is whole, and both of two results are the same. What has failed is a result, too, but is not kept.
"""

from __future__ import annotations

import hashlib
import os
import platform
import tempfile
import time
from contextlib import suppress
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from heaved import __version__
from heaved.config import Config
from heaved.devices.recording import RecordingError
from heaved.recorder.found import RecordedError
from heaved.replay.replay import replaying
from heaved.report.findings import SETTLED, Source, findings
from heaved.report.report import followed
from heaved.samples import HeaveState
from heaved.text import printable

if TYPE_CHECKING:
    from heaved.report.findings import Findings
    from heaved.report.statistics import ErrorStatistics

HASHED_BYTES: Final = 1 << 20
"""Of a file, at a time."""


class Task(msgspec.Struct, frozen=True, kw_only=True):
    """One recording, to be tested with one configuration."""

    name: str
    """Of the recording, within the directory that is tested."""
    source: str
    """Absolute path, the same on every machine that works."""
    config: bytes | None
    """As JSON; None: as recorded, and of a CSV the defaults."""
    config_sha256: str
    release: str
    """That asks for it: another one would give other numbers."""
    results: str
    """Directory of the results, absolute, likewise."""

    @property
    def key(self) -> str:
        """The same for the same file, configuration and release."""
        return hashlib.sha256(os.fsencode("\0".join((self.name, self.config_sha256, self.release)))).hexdigest()[:40]

    @property
    def place(self) -> Path:
        """Where its result is kept: in 256 directories, since a year has many hours."""
        return Path(self.results) / self.key[:2] / f"{self.key}.json"


class Accuracy(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of one quantity beside their claims, in its unit; None: not known."""

    count: int
    rms: float | None
    claimed_rms: float | None
    nees: float | None
    within_1std: float | None
    """Shares of the errors; of right claims 68.3, 95.4 and 99.7 %."""
    within_2std: float | None
    within_3std: float | None


class Ahead(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of what was foretold for one horizon."""

    horizon_s: float
    errors: Accuracy


class Seen(msgspec.Struct, frozen=True, kw_only=True):
    """How a file looked when it was read: one that looks the same is not read again for its hash."""

    size_bytes: int
    modified_ns: int


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """What came of a task; of one that failed no more than the reason. None: not known."""

    failure: str = ""
    """Why there is nothing else, and what to do."""
    source_sha256: str = ""
    seen: Seen | None = None
    rows: int = 0
    frames: int = 0
    duration_s: float = 0.0
    told_s: float = 0.0
    """With samples."""
    significant_height_m: float | None = None
    """Of the heave: the median of the fits; likewise the period."""
    peak_period_s: float | None = None
    delayed_height_m: float | None = None
    """4 standard deviations of the delayed heave."""
    realtime: Accuracy | None = None
    """Real-time minus delayed heave, m, once settled."""
    expected_nees: float | None = None
    """Of that, were every claim right."""
    laser: Accuracy | None = None
    """Real-time heave minus laser, m, likewise; its count is 0 where there is none."""
    forecasts: tuple[Ahead, ...] = ()
    """m"""
    roll: tuple[Ahead, ...] = ()
    """degrees"""
    pitch: tuple[Ahead, ...] = ()
    shares: dict[str, float] = {}
    """Of the whole time, by the state of the heave; what is missing of 1 had no samples."""
    first_valid_s: float | None = None
    """From the first sample."""
    resets: int = 0
    """Of all estimators."""
    remarks: tuple[str, ...] = ()
    """What should be known of the recording."""
    run_s: float = 0.0
    """Time that the task took."""
    memory_bytes: int = 0
    """The most that its process ever had."""


def perform(task: Task) -> Result:
    """Do a task, unless its result is there. Nothing that a file holds ends more than its own task."""
    try:
        return _performed(task)
    except (RecordingError, RecordedError) as error:
        return failed(str(error))
    except OSError as error:
        where = error.filename or task.source
        return failed(f"{where}: {error.strerror or error} (on {platform.node()})")
    except Exception as error:  # A fault of the program: the row says so, and others go on.  # noqa: BLE001
        return failed(f"{task.source}: the program failed: {error!r}")


def failed(reason: str) -> Result:
    """Of a file whose name may be no text."""
    return Result(failure=printable(reason))


def _performed(task: Task) -> Result:
    if task.release != __version__:
        return failed(
            f"the worker on {platform.node()} has heaved {__version__}, {task.release} is asked for: "
            "install that release there"
        )
    source = Path(task.source)
    if not source.exists():
        return failed(
            f"{source}: is not there on {platform.node()}: the directory must be mounted on every worker "
            "under the same path"
        )
    if not source.is_file():
        return failed(f"{source}: is no file")
    begun_s = time.perf_counter()
    seen = seen_of(source)
    sha256 = _hash(source)
    kept = kept_result(task)
    if kept is not None and kept.source_sha256 == sha256:
        result = msgspec.structs.replace(kept, seen=seen)
    else:
        result = _followed(source, task, sha256, seen)
        if result.failure:
            return result
        if seen_of(source) != seen:
            return failed(
                f"{source}: has changed while it was read: an hour that is still being recorded? "
                "Once it is whole, the same command tests it"
            )
        result = msgspec.structs.replace(result, run_s=time.perf_counter() - begun_s)
    keep(task, result)
    return result


def _followed(source: Path, task: Task, sha256: str, seen: Seen) -> Result:
    given = None if task.config is None else msgspec.json.decode(task.config, type=Config)
    with replaying(source, given) as run:
        config = run.config
        collector = followed(run)
        learned, resets, summary = run.pipeline.summary(), run.pipeline.resets.total(), run.summary()
        columns = run.recording.columns
    found = findings(
        collector,
        source=Source(name=source.name, size_bytes=seen.size_bytes, sha256=sha256, columns=columns),
        made="",
        command="",
        config=config,
        config_name="",
        summary=summary,
        learned=learned,
    )
    if found.frames == 0:
        return failed(f"{source}: no row has a vertical acceleration: there is no heave to be tested")
    return result_of(found, seen=seen, resets=resets, remarks=tuple(map(printable, summary.remarks)))


def result_of(found: Findings, *, seen: Seen | None, resets: int, remarks: tuple[str, ...] = ()) -> Result:
    """The row of a recording whose report holds ``found``."""
    first_s = found.quality[HeaveState.VALID.value].first_s
    return Result(
        source_sha256=found.source.sha256,
        seen=seen,
        rows=found.rows,
        frames=found.frames,
        duration_s=found.duration_s,
        told_s=found.told_s,
        significant_height_m=_known(found.sea.significant_height_m),
        peak_period_s=_known(found.sea.peak_period_s),
        delayed_height_m=_known(found.sea.delayed_height_m),
        realtime=accuracy(found.realtime[SETTLED]),
        expected_nees=_known(found.expected_nees),
        laser=accuracy(found.laser[SETTLED]),
        forecasts=tuple(Ahead(horizon_s=one.horizon_s, errors=accuracy(one.errors)) for one in found.forecasts),
        roll=tuple(Ahead(horizon_s=one.horizon_s, errors=accuracy(one.errors)) for one in found.rock["roll"]),
        pitch=tuple(Ahead(horizon_s=one.horizon_s, errors=accuracy(one.errors)) for one in found.rock["pitch"]),
        shares={state: share for state, one in found.quality.items() if isfinite(share := found.share(one))},
        first_valid_s=_known(first_s - found.begin_s),
        resets=resets,
        remarks=remarks,
        memory_bytes=_most_memory_bytes(),
    )


def accuracy(errors: ErrorStatistics) -> Accuracy:
    """The part of a report's statistics that a backtest keeps."""
    return Accuracy(
        count=errors.count,
        rms=_known(errors.rms),
        claimed_rms=_known(errors.claimed_rms),
        nees=_known(errors.nees),
        within_1std=_known(errors.within[0]),
        within_2std=_known(errors.within[1]),
        within_3std=_known(errors.within[2]),
    )


def _known(value: float) -> float | None:
    return value if isfinite(value) else None


def _most_memory_bytes() -> int:
    import resource

    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


# ---- what is kept ----------------------------------------------------------------------------------------------------


def seen_of(source: Path) -> Seen:
    """
    Raises:
        OSError: it is not there.
    """
    status = source.stat()
    return Seen(size_bytes=status.st_size, modified_ns=status.st_mtime_ns)


def _hash(source: Path) -> str:
    digest = hashlib.sha256()
    with source.open("rb") as file:
        while piece := file.read(HASHED_BYTES):
            digest.update(piece)
    return digest.hexdigest()


def kept_result(task: Task) -> Result | None:
    """Of the same file, configuration and release, whatever the file held then; None: there is none that is whole."""
    try:
        return msgspec.json.decode(task.place.read_bytes(), type=Result)
    except (OSError, msgspec.MsgspecError):
        return None


def done_result(task: Task) -> Result | None:
    """The kept result, if the file still looks as it did then; None: somebody has to read it."""
    kept = kept_result(task)
    try:
        return kept if kept is not None and kept.seen == seen_of(Path(task.source)) else None
    except OSError:
        return None


def keep(task: Task, result: Result) -> None:
    """Write a result, whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    task.place.parent.mkdir(parents=True, exist_ok=True)
    write_whole(task.place, msgspec.json.encode(result))


def write_whole(path: Path, content: bytes) -> None:
    """A file that appears under its name when it is whole, whoever else writes it at the same time.

    Raises:
        OSError: it cannot be written.
    """
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        mask = os.umask(0)
        os.umask(mask)
        Path(name).chmod(0o666 & ~mask)
        Path(name).replace(path)
    except BaseException:
        with suppress(OSError):
            Path(name).unlink()
        raise
