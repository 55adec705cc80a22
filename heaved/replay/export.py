"""What a daemon has recorded of its frames, as files for others: CSV like the table of a replay, or netCDF.

Times are UTC. Where the clock of the daemon was stepped within a run, all of the run is given by the clock after the
last step, which is the one that somebody has set right: times go on as the motion did, and nothing stands there twice.
"""

from __future__ import annotations

import importlib.util
import os
import re
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from math import inf, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

import msgspec
import numpy as np

from heaved import __version__
from heaved.recorder.found import RecordedError, is_recorded, need_reader
from heaved.recorder.layout import FRAMES, Column, Stored, table_columns
from heaved.replay.replay import OutputError, writing
from heaved.replay.table import MAX_STEP_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from typing import TextIO

    from numpy.typing import NDArray

    from heaved.recorder.read import Hour, Recorded
    from heaved.replay.replay import Progress

    Array = NDArray[np.float64]

STEP_S: Final = 0.5
"""A change of the clock by more than this from one frame to the next is a step; it is followed at 5 ms/s otherwise."""
ALL: Final = "all"
TIMES: Final = ("t_s", "time")
"""Columns that stand first in any case."""
DELAYED: Final = "delayed_heave_m"
"""Aligned to its own time, as in the table of a replay: in the recording it stands where it became known."""
QUALITY: Final = "quality"
STATES: Final = ("settling", "valid", "degraded", "invalid")
"""Of the quality, as numbers from 0 on in netCDF."""

_FIRST: Final = (
    "heave_m", "heave_std_m", "heave_velocity_mps", "observer_m", "correction_m", "lead_s", QUALITY, DELAYED,
)  # fmt: skip
_AHEAD: Final = re.compile(r"(forecast|roll|pitch|yaw)_[0-9.]+s_(std_)?(m|deg)")
_STAGES: Final = re.compile(r"(hull_(static_)?[xyz]_(deg|std_arcsec)|attitude_(?!age).*)")
_ORDER: Final = ("forecast", "roll", "pitch", "yaw", "hull", "attitude")
"""Of the table of a replay."""
_INTERNAL: Final = ("t_us", "utc_offset_us", "delayed_t_s", "delayed_m", "delayed_std_m")
_TEXTS: Final = ("laser", "correction", "reasons")


class Exported(msgspec.Struct, frozen=True, kw_only=True):
    """What was written."""

    out: str
    vessel: str
    rows: int
    began: str
    """UTC, ISO 8601, of the first and the last row."""
    ended: str
    columns: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    """What should be known of the recording."""

    def __str__(self) -> str:
        told = "".join(f"\nremark: {remark}" for remark in self.remarks)
        return f"{self.rows} rows of {self.vessel} from {self.began} to {self.ended}: {self.out}{told}"


class Block(msgspec.Struct, frozen=True, eq=False):
    """Some rows."""

    t_s: Array
    """Monotonic."""
    utc_s: Array
    """Since 1970."""
    columns: dict[str, Any]
    """By name: numbers (n,), nan where not known, or a list of texts."""


class Writer(Protocol):
    """One kind of file."""

    def push(self, block: Block) -> None:
        """Add rows."""


def export(
    source: Path,
    out: Path,
    *,
    columns: Sequence[str] = (),
    every_s: float = 0.0,
    progress: Progress | None = None,
) -> Exported:
    """Write the frames of the recording ``source`` to ``out``: netCDF if it ends in ``.nc``, else CSV.

    columns: names; none: those of the table of a replay; "all": every one.
    every_s: the first frame in each such span of UTC; 0: every one.

    Raises:
        RecordedError: it is not a recording of a daemon, has no frames, or none of these columns.
        OutputError: the result cannot be written; nothing is left behind.
    """
    if not source.exists():
        raise RecordedError(f"{source}: there is no such file or directory")
    if not is_recorded(source):
        raise RecordedError(
            f"{source}: export reads what a daemon has recorded, a directory or a file of it; the results of a CSV are "
            "made by heaved replay"
        )
    need_reader(source)
    from heaved.recorder.read import open_recorded  # What it reads with need not be installed.

    is_netcdf = out.suffix in (".nc", ".nc4")
    if not is_netcdf and out.suffix not in ("", ".csv", ".txt"):
        raise OutputError(f"{out}: {out.suffix} is neither CSV nor netCDF: end it in .csv or .nc")
    if is_netcdf and importlib.util.find_spec("netCDF4") is None:
        raise OutputError(f"{out}: writing netCDF needs netCDF4: pip install 'heaved[export]'; or name a .csv with -o")
    recorded = open_recorded(source, FRAMES)
    known = _known(recorded)
    names = _chosen(source, known, columns)
    remarks = list(recorded.remarks)
    timeline = _Timeline(recorded, remarks)
    rows, began_s, ended_s = 0, inf, -inf
    opened: Any = _netcdf(out, recorded, names, known) if is_netcdf else _csv(out, names, known)
    with opened as writer:
        for block in _blocks(recorded, names, timeline, every_s, progress):
            writer.push(block)
            rows += len(block.t_s)
            began_s, ended_s = min(began_s, float(block.utc_s[0])), max(ended_s, float(block.utc_s[-1]))
    return Exported(
        out=str(out),
        vessel=recorded.hours[0].header.vessel,
        rows=rows,
        began=_iso(began_s),
        ended=_iso(ended_s),
        columns=tuple(names),
        remarks=tuple(remarks),
    )


# ---- which columns ---------------------------------------------------------------------------------------------------


def _known(recorded: Recorded) -> dict[str, Column]:
    """All that can be exported, by name: what any of the hours has."""
    found: dict[str, Column] = {}
    for hour in recorded.hours:
        for column in table_columns(hour.header.layout, FRAMES):
            found.setdefault(column.name, column)
    delayed = found["delayed_m"]
    found[DELAYED] = msgspec.structs.replace(delayed, name=DELAYED)
    return {
        name: column for name, column in found.items() if name not in _INTERNAL and name not in ("sea", "hull_state")
    }


def _chosen(source: Path, known: dict[str, Column], asked: Sequence[str]) -> list[str]:
    if list(asked) == [ALL]:
        return [*_FIRST, *(name for name in known if name not in _FIRST)]
    asked = [name for name in asked if name not in TIMES]
    unknown = [name for name in asked if name not in known]
    if unknown:
        there = ", ".join(name for name in known if not _AHEAD.fullmatch(name) and "interval" not in name)
        raise RecordedError(
            f"{source}: has no column {', '.join(unknown)}; there are {there}, and those of each horizon, "
            f"forecast_1s_m and roll_1s_std_deg say; {ALL} for every one"
        )
    usual = [name for name in known if _AHEAD.fullmatch(name) or _STAGES.fullmatch(name)]
    usual.sort(key=lambda name: _ORDER.index(name.partition("_")[0]))
    return list(dict.fromkeys(asked)) or [*_FIRST, *usual]


# ---- which times -----------------------------------------------------------------------------------------------------


class _Timeline:
    """What must be known before the first row is written: the steps of the clock, and the delayed heave."""

    def __init__(self, recorded: Recorded, remarks: list[str]) -> None:
        """``remarks`` gets the steps."""
        from heaved.recorder.read import frame_values

        self._steps: dict[str, list[tuple[float, float]]] = {}
        """By run: times (monotonic, s) from which the clock was another one, and by how much."""
        self._delayed: dict[str, tuple[Array, Array]] = {}
        names = ("t_us", "utc_offset_us", "delayed_t_s", "delayed_m")
        for hours in recorded.runs:
            run = hours[0].header.run
            steps: list[tuple[float, float]] = []
            known_s, heaves_m = [np.empty(0)], [np.empty(0)]
            last_s: float | None = None
            for hour in hours:
                for batch in hour.batches(names):
                    values = frame_values(hour, names, batch)
                    offsets_s = values["utc_offset_us"]
                    before_s = np.concatenate(([offsets_s[0] if last_s is None else last_s], offsets_s[:-1]))
                    stepped = np.flatnonzero(np.abs(offsets_s - before_s) > STEP_S)
                    steps += zip(
                        values["t_us"][stepped].tolist(), (offsets_s - before_s)[stepped].tolist(), strict=True
                    )
                    last_s = float(offsets_s[-1])
                    is_there = np.isfinite(values["delayed_t_s"] + values["delayed_m"])
                    known_s.append(values["delayed_t_s"][is_there])
                    heaves_m.append(values["delayed_m"][is_there])
            times_s, where = np.unique(np.concatenate(known_s), return_index=True)
            self._steps[run], self._delayed[run] = steps, (times_s, np.concatenate(heaves_m)[where])
            remarks += [
                f"the clock was stepped by {size_s:+.3f} s at t_s {t_s:.2f}: times before are of the clock after it"
                for t_s, size_s in steps
            ]

    def utc_s(self, run: str, t_s: Array, offset_s: Array) -> Array:
        """UTC (n,) of these times, by the clock after the last step of the run."""
        utc_s = t_s + offset_s
        for step_s, size_s in self._steps[run]:
            utc_s[t_s < step_s] += size_s
        return utc_s

    def delayed_m(self, run: str, t_s: Array) -> Array:
        """The delayed heave (n,) of these times: between two of its neighbours, nan in holes and beyond."""
        known_s, heaves_m = self._delayed[run]
        if len(known_s) < 2:
            return np.full(len(t_s), np.nan)
        found: Array = np.interp(t_s, known_s, heaves_m, left=np.nan, right=np.nan)
        after = np.clip(np.searchsorted(known_s, t_s, side="left"), 1, len(known_s) - 1)
        is_hole = (
            (known_s[after] - known_s[after - 1] > MAX_STEP_S) & (t_s != known_s[after]) & (t_s != known_s[after - 1])
        )
        found[is_hole] = np.nan
        return found


# ---- which rows ------------------------------------------------------------------------------------------------------


def _blocks(
    recorded: Recorded, names: Sequence[str], timeline: _Timeline, every_s: float, progress: Progress | None
) -> Iterator[Block]:
    read, last_span = 0, -inf
    for hour in recorded.hours:
        done = 0
        for block in _blocks_of(hour, names, timeline):
            done += len(block.t_s)
            if progress is not None:
                progress(read + hour.size_bytes * done // hour.rows, recorded.size_bytes)
            if every_s <= 0.0:
                yield block
                continue
            spans = np.floor(block.utc_s / every_s)
            is_first = np.diff(spans, prepend=last_span) > 0.0
            last_span = float(spans[-1])
            if is_first.any():
                yield _only(block, is_first)
        read += hour.size_bytes


def _only(block: Block, which: NDArray[np.bool_]) -> Block:
    columns: dict[str, Any] = {}
    for name, values in block.columns.items():
        if isinstance(values, list):
            columns[name] = [text for text, wanted in zip(values, which.tolist(), strict=True) if wanted]
        else:
            columns[name] = values[which]
    return Block(block.t_s[which], block.utc_s[which], columns)


def _blocks_of(hour: Hour, names: Sequence[str], timeline: _Timeline) -> Iterator[Block]:
    from heaved.recorder.read import frame_values

    run = hour.header.run
    stored = {column.name: column.stored for column in table_columns(hour.header.layout, FRAMES)}
    numbers = [name for name in names if stored.get(name, Stored.TEXT) is not Stored.TEXT]
    texts = [name for name in names if stored.get(name) is Stored.TEXT]
    read = ["t_us", "utc_offset_us", *numbers]
    for batch in hour.batches([*read, *texts]):
        values = frame_values(hour, read, batch)
        t_s = values["t_us"]
        columns: dict[str, Any] = {}
        for name in names:
            if name == DELAYED:
                columns[name] = timeline.delayed_m(run, t_s)
            elif name in values:
                columns[name] = values[name]
            elif name in texts:
                columns[name] = [text or "" for text in batch.column(name).to_pylist()]
            else:  # Other hours have it.
                columns[name] = [""] * len(t_s) if name in (QUALITY, *_TEXTS) else np.full(len(t_s), np.nan)
        yield Block(t_s, timeline.utc_s(run, t_s, values["utc_offset_us"]), columns)


def _iso(utc_s: float) -> str:
    return datetime.fromtimestamp(utc_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


# ---- CSV -------------------------------------------------------------------------------------------------------------


class CsvWriter:
    """A row for each frame: ``t_s`` and ``time``, then the columns; what is not known is blank."""

    def __init__(self, write: Callable[[str], object], names: Sequence[str], known: dict[str, Column]) -> None:
        """``write`` gets the header at once."""
        self._write, self._names = write, list(names)
        cells = ["%.6f", "%s"]
        for name in names:
            column = known[name]
            cells.append("%s" if column.stored is Stored.TEXT else f"%.{max(0, round(-log10(column.scale)))}f")
        self._row = ",".join(cells) + "\n"
        write(",".join((*TIMES, *names)) + "\n")

    def push(self, block: Block) -> None:
        """Add rows."""
        times = np.datetime_as_string(np.round(block.utc_s * 1e6).astype("datetime64[us]"), timezone="UTC").tolist()
        columns = []
        for name in self._names:
            values = block.columns[name]
            columns.append(list(map(_quoted, values)) if isinstance(values, list) else values.tolist())
        lines = [self._row % row for row in zip(block.t_s.tolist(), times, *columns, strict=True)]
        self._write("".join([_blank(line) for line in lines]))


def _quoted(text: str) -> str:
    """As RFC 4180 has it."""
    return '"' + text.replace('"', '""') + '"' if any(char in text for char in ',"\n\r') else text


def _blank(line: str) -> str:
    return line.replace(",nan", ",") if ",nan" in line else line


@contextmanager
def _csv(out: Path, names: Sequence[str], known: dict[str, Column]) -> Iterator[Writer]:
    with writing(None if out == Path("-") else out) as file:
        handle: TextIO = file
        yield CsvWriter(handle.write, names, known)


# ---- netCDF ----------------------------------------------------------------------------------------------------------

_UNITS: Final = {
    "m": "m", "mps": "m s-1", "mps2": "m s-2", "s": "s", "deg": "degree", "degps": "degree s-1", "arcsec": "arcsecond",
}  # fmt: skip
"""Of UDUNITS, by the ending of a name; else it is a number."""
_STANDARD: Final = {
    "heave_m": "platform_heave_up",
    "heave_std_m": "platform_heave_up standard_error",
    "heave_velocity_mps": "platform_heave_rate_up",
    "roll_deg": "platform_roll_starboard_down",
    "pitch_deg": "platform_pitch_fore_up",
    "yaw_deg": "platform_yaw_fore_starboard",
    "roll_rate_degps": "platform_roll_rate_starboard_down",
    "pitch_rate_degps": "platform_pitch_rate_fore_up",
    "yaw_rate_degps": "platform_yaw_rate_fore_starboard",
}
"""Names of the CF table; what is predicted or learned has none."""
_NOT_KNOWN: Final = 9.96921e36
"""The usual fill value of netCDF for float32."""
_NO_STATE: Final = -1


class NetcdfWriter:
    """One dimension, time; a variable for each column, packed as 32-bit floats; the quality as flags."""

    def __init__(self, dataset: Any, names: Sequence[str], known: dict[str, Column]) -> None:
        self._rows = 0
        dataset.createDimension("time", None)
        self._time = dataset.createVariable("time", "f8", ("time",), zlib=True)
        self._time.setncatts({
            "standard_name": "time", "long_name": "time of validity, UTC", "axis": "T",
            "units": "seconds since 1970-01-01 00:00:00", "calendar": "standard",
        })  # fmt: skip
        self._variables: dict[str, Any] = {}
        for name in names:
            column = known[name]
            if name == QUALITY:
                variable = dataset.createVariable(name, "i1", ("time",), zlib=True, fill_value=_NO_STATE)
                variable.setncatts({
                    "standard_name": "quality_flag", "long_name": "how far the heave can be trusted",
                    "flag_values": np.arange(len(STATES), dtype=np.int8), "flag_meanings": " ".join(STATES),
                })  # fmt: skip
            elif column.stored is Stored.TEXT:
                variable = dataset.createVariable(variable_name(name), str, ("time",))
                variable.long_name = name
            else:
                variable = dataset.createVariable(
                    variable_name(name), "f4", ("time",), zlib=True, shuffle=True, fill_value=np.float32(_NOT_KNOWN)
                )
                variable.units = _UNITS.get(column.unit, "1")
                variable.long_name = name.replace("_", " ")
                if name in _STANDARD:
                    variable.standard_name = _STANDARD[name]
                if name == "heave_m":
                    variable.ancillary_variables = " ".join(n for n in ("heave_std_m", QUALITY) if n in names)
            self._variables[name] = variable

    def push(self, block: Block) -> None:
        """Add rows."""
        end = self._rows + len(block.t_s)
        self._time[self._rows : end] = block.utc_s
        for name, variable in self._variables.items():
            values = block.columns[name]
            if name == QUALITY:
                values = np.array([STATES.index(text) if text in STATES else _NO_STATE for text in values], np.int8)
            elif isinstance(values, list):
                values = np.array(values, dtype=object)
            else:
                values = np.where(np.isfinite(values), values, _NOT_KNOWN).astype(np.float32)
            variable[self._rows : end] = values
        self._rows = end


def variable_name(name: str) -> str:
    """A column's name as CF wants it, letters, digits and underscores: ``forecast_0.05s_m`` is ``forecast_0p05s_m``."""
    return re.sub(r"[^A-Za-z0-9_]", "_", re.sub(r"(\d)\.(\d)", r"\1p\2", name))


@contextmanager
def _netcdf(out: Path, recorded: Recorded, names: Sequence[str], known: dict[str, Column]) -> Iterator[Writer]:
    """A file that appears under its name only when it is whole.

    Raises:
        OutputError: it cannot be written.
    """
    import netCDF4  # An extra of its own, and slow to load.

    target = out.resolve()
    partial = target.with_name(f".{target.name}.{os.getpid()}.part")
    header = recorded.hours[0].header
    dataset: Any = None
    try:
        dataset = netCDF4.Dataset(partial, "w", format="NETCDF4")
        dataset.setncatts({
            "Conventions": "CF-1.11",
            "title": f"Motion of {header.vessel}",
            "source": f"heaved {header.release}, recorded while it ran",
            "history": f"{_iso(datetime.now(UTC).timestamp())} heaved {__version__} export",
            "platform": header.vessel,
            "comment": "Heave up, roll port side up, pitch bow up, yaw clockwise from above. A column with a time in "
            "its name holds what was predicted at its row for so much later.",
        })  # fmt: skip
        yield NetcdfWriter(dataset, names, known)
        dataset.close()
        dataset = None
        partial.replace(target)
    except (OSError, RuntimeError) as error:  # netCDF4 says a full disk by either.
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise OutputError(f"{out}: cannot be written: {reason}; name another file with -o") from error
    finally:
        if dataset is not None:
            with suppress(RuntimeError):  # What could not be written cannot be closed either; the file goes.
                dataset.close()
        partial.unlink(missing_ok=True)
