"""A recording as a source of samples: CSV in, the records of :mod:`heaved.samples` out, row by row.

One header row, then one row per instant; a blank cell is a missing value. ``t_s`` (any start, strictly increasing) and
``az_mps2`` are required. Degrees in the file, radians in the samples. The reader is strict: a row that is not exactly
what the header promises is refused with file, line, column and reason, because a silently skipped or misread row would
make every figure drawn from the recording wrong. So is what no sensor has measured, and samples too far apart to show
waves, which mostly are seconds that were written in another unit.
"""

from __future__ import annotations

import csv
import io
import os
from functools import partial
from itertools import pairwise
from math import isfinite, isnan, nan, radians
from operator import gt, itemgetter
from statistics import median_low
from typing import TYPE_CHECKING, Final, Self

import msgspec

from heaved.samples import CraftSample, CraneSample, ImuSample, LaserSample, RatesSample

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import TracebackType

COLUMNS: Final = (
    "t_s",
    "ax_mps2", "ay_mps2", "az_mps2",
    "roll_deg", "pitch_deg", "yaw_deg",
    "gx_radps", "gy_radps", "gz_radps",
    "laser_m",
)  # fmt: skip
"""Columns that are read."""
STAGE_COLUMNS: Final = (
    "gx1_radps", "gy1_radps", "gz1_radps",
    "gx2_radps", "gy2_radps", "gz2_radps",
    "heave_sensor_m", "pitch_sensor_deg", "speed_mps", "flap_fore_deg", "flap_aft_deg",
    "slew_deg", "boom_deg", "jib_deg", "line_out_m",
)  # fmt: skip
"""Columns of the stages beside the heave: body rates amidships (the same as gx_radps, gy_radps, gz_radps, before which
they come) and at the crane base, each in its own axes; what a craft's own sensors say, and a crane's encoders."""
REQUIRED: Final = ("t_s", "az_mps2")
IGNORED: Final = (
    "ax2_mps2", "ay2_mps2", "az2_mps2",
    "roll2_deg", "pitch2_deg", "yaw2_deg",
)  # fmt: skip
"""Columns of a second IMU beside its rates: allowed, never looked at."""

LIMITS: Final = {"mps2": 1e3, "deg": 1e4, "radps": 1e3, "m": 1e4, "mps": 1e3, "s": 1e11}
"""By the unit in a column's name: what is beyond, either way, no sensor on board has measured. (Of t_s: 3000 years.)"""
TOO_SLOW_S: Final = 2.0
"""Samples this far apart show no wave of less than twice as long, and of longer ones not enough."""
FIRST_SAMPLES: Final = 21
"""The usual interval is judged by these: one with a hole among them is as good as any."""
FEWEST_SAMPLES: Final = 3
"""A recording of fewer has no usual interval."""
SHORTEST_STEP_S: Final = 1e-9
"""Between two rows. What is shorter is the last digit of a double, and no time that has passed."""
_UNITS_OF_TIME: Final = (("ms", 1e3, 250.0), ("µs", 1e6, 1e3), ("ns", 1e9, 1e3))
"""How many make a second, and the most samples a second of who would stamp them so. (Samples "2 s apart" would be 500 a
second, were they in ms: they are slow.)"""
_EPOCH_S: Final = (5e8, 5e9)
"""Seconds since 1970, in our century and a little more."""
_LONGEST_LINE: Final = 65536
"""Characters. What is longer is read in pieces, none of which is a row."""

_DECODER: Final = msgspec.json.Decoder(list[float])
_RADIANS_PER_DEGREE: Final = radians(1.0)
_LONGEST_HEADER: Final = 4096
"""Characters. A first line beyond this is no header of ours, whatever it is."""
_ALSO_CALLED: Final = {"t": "t_s", "time": "t_s", "timestamp": "t_s", "heading": "yaw_deg", "laser": "laser_m"}

Instant = tuple[ImuSample | None, LaserSample | None, RatesSample | None, CraftSample | None, CraneSample | None]


class RecordingError(Exception):
    """A file that is no recording. Its text says where and why; ``line`` counts from 1, 0 is the file as a whole."""

    def __init__(self, file: str, reason: str, *, line: int = 0, column: str = "") -> None:
        place = file + (f", line {line}" if line else "") + (f", column {column}" if column else "")
        super().__init__(f"{place}: {reason}")
        self.file, self.line, self.column, self.reason = file, line, column, reason


class Recording:
    """An open recording. Go once over its :meth:`instants`; memory does not grow with its length.

    A row gives an ImuSample when ``az_mps2`` is there (without it the row's other motion values are of no use and are
    left out) and a LaserSample when ``laser_m`` is there; a row may give both or neither. What there
    is for the stages comes beside them.

    Attributes:
        columns: names in the header, in the file's order.
        total_bytes: size of the file.
    """

    def __init__(self, path: Path) -> None:
        """Open ``path`` and read its header.

        Raises:
            RecordingError: the file cannot be opened, or its header is not that of a recording.
        """
        self._file = str(path)
        try:
            self._raw = path.open("rb", buffering=0)
        except OSError as error:
            raise self._error(f"cannot be read: {error.strerror or error}") from error
        self._text = io.TextIOWrapper(io.BufferedReader(self._raw, 1 << 18), encoding="utf-8-sig", newline="")
        self.total_bytes = os.fstat(self._raw.fileno()).st_size
        try:
            self.columns = self._header()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._text.close()

    @property
    def has_laser(self) -> bool:
        """Whether there is a column of the laser."""
        return "laser_m" in self.columns

    @property
    def read_bytes(self) -> int:
        """How much of the file has been read: for progress, in steps of the read buffer; 0 of what is no file."""
        return self._raw.tell() if self._raw.seekable() else 0

    def instants(self) -> Iterator[Instant]:
        """The rows, in order: each a sample of the IMU, the laser, the second IMU, the craft and the crane, as far as
        it has them.

        Raises:
            RecordingError: at the row that is malformed; the rows before it have been given.
        """
        lines = iter(partial(self._text.readline, _LONGEST_LINE), "")
        rows = csv.reader(lines, skipinitialspace=True, strict=True)
        try:
            yield from self._rows(rows)
        except UnicodeDecodeError as error:
            # Text is decoded in pieces, ahead of the rows: the line itself is not known.
            raise self._error(f"{_not_utf8(error)}; somewhere after line {rows.line_num + 1}") from error
        except csv.Error as error:
            raise self._error(f"is not CSV: {error}", line=rows.line_num + 1) from error
        except OSError as error:
            raise self._error(f"cannot be read: {error.strerror or error}", line=rows.line_num + 1) from error

    def _rows(self, rows: Iterator[list[str]]) -> Iterator[Instant]:
        width = len(self.columns)
        read = COLUMNS if set(STAGE_COLUMNS).isdisjoint(self.columns) else COLUMNS + STAGE_COLUMNS
        has_midships = not set(STAGE_COLUMNS[:3]).isdisjoint(self.columns)
        there = [name for name in read if name in self.columns]
        pick = itemgetter(*map(self.columns.index, there))
        # What the file does not have is picked from the nan that is appended to each row of numbers.
        arrange = itemgetter(*(there.index(name) if name in there else -1 for name in read))
        limits = tuple(_limit(name) for name in there)
        first: list[tuple[float, int]] = []
        last_s = -float("inf")
        for row in rows:
            if len(row) != width:
                if not row:
                    continue  # An empty line, as editors leave at the end.
                raise self._error(f"{len(row)} cells, but the header has {width}", line=_line(rows))
            cells = pick(row)
            found = _numbers(cells)
            if found is None or any(map(gt, map(abs, found), limits)):
                raise self._bad_cell(row, _line(rows))
            found.append(nan)
            t_s, ax, ay, az, roll, pitch, yaw, gx, gy, gz, laser, *staged = arrange(found)
            if not t_s - last_s >= SHORTEST_STEP_S:
                raise self._bad_time(cells[there.index("t_s")], last_s, _line(rows))
            last_s = t_s
            if has_midships:
                gx, gy, gz = staged[:3]
            imu = None if isnan(az) else ImuSample(
                t_s=t_s,
                ax_mps2=ax,
                ay_mps2=ay,
                az_mps2=az,
                roll_rad=roll * _RADIANS_PER_DEGREE,
                pitch_rad=pitch * _RADIANS_PER_DEGREE,
                yaw_rad=yaw * _RADIANS_PER_DEGREE,
                gx_radps=gx,
                gy_radps=gy,
                gz_radps=gz,
            )  # fmt: skip
            if imu is not None and len(first) < FIRST_SAMPLES:
                first.append((t_s, _line(rows)))
                if len(first) == FIRST_SAMPLES:
                    self._check_interval(first)
            rates, craft, crane = _staged(t_s, staged) if staged else (None, None, None)
            yield imu, None if isnan(laser) else LaserSample(t_s=t_s, laser_m=laser), rates, craft, crane
        if last_s == -float("inf"):
            raise self._error("has a header but no rows")
        if len(first) < FIRST_SAMPLES:
            self._check_interval(first)

    def _header(self) -> tuple[str, ...]:
        try:
            line = self._text.readline(_LONGEST_HEADER)
        except UnicodeDecodeError as error:
            # The text is decoded in pieces, and this is the first one: its line ends count the lines.
            raise self._error(_not_utf8(error), line=1 + error.object.count(b"\n", 0, error.start)) from error
        except OSError as error:
            raise self._error(f"cannot be read: {error.strerror or error}") from error
        if not line.strip():
            raise self._error("is empty" if not line else "the first line is blank; it must name the columns", line=1)
        try:
            names = tuple(name.strip() for name in next(csv.reader([line], skipinitialspace=True, strict=True)))
        except csv.Error as error:
            raise self._error(f"is not CSV: {error}", line=1) from error
        if len(line) >= _LONGEST_HEADER or all(_is_number(name) for name in names):
            raise self._error(f"no header row; the first line must name the columns: {', '.join(COLUMNS)}", line=1)
        if len(names) == 1 and (";" in line or "\t" in line):
            raise self._error("cells must be separated by commas", line=1)
        for name in names:
            if name not in COLUMNS and name not in STAGE_COLUMNS and name not in IGNORED:
                raise self._error(_unknown_column(name), line=1, column=name or "(blank)")
            if names.count(name) > 1:
                raise self._error("is named twice", line=1, column=name)
        for name in REQUIRED:
            if name not in names:
                raise self._error(f"column {name} is missing; a recording needs {' and '.join(REQUIRED)}", line=1)
        return names

    def _check_interval(self, first: list[tuple[float, int]]) -> None:
        """Of the first samples: times and lines.

        Raises:
            RecordingError: they are too far apart, as a rule.
        """
        steps = [(after[0] - before[0], after[1]) for before, after in pairwise(first)]
        usual_s = median_low([step_s for step_s, _ in steps]) if len(first) >= FEWEST_SAMPLES else 0.0
        if usual_s >= TOO_SLOW_S:
            line = next(line for step_s, line in steps if step_s >= TOO_SLOW_S)
            raise self._error(f"samples {usual_s:g} s apart{_why_so_slow(usual_s)}", line=line, column="t_s")

    def _bad_cell(self, row: list[str], line: int) -> RecordingError:
        """The fault of the first cell that is neither blank nor a finite number in plain digits that may be."""
        for name in COLUMNS + STAGE_COLUMNS:
            cell = row[self.columns.index(name)] if name in self.columns else ""
            if cell and not _is_number(cell):
                return self._error(
                    f"{_shown(cell)} is not a number; leave a missing value blank", line=line, column=name
                )
            if cell and not isfinite(float(cell)):
                return self._error(f"{_shown(cell)} is not finite; leave a missing value blank", line=line, column=name)
            if cell and abs(float(cell)) > _limit(name):
                return self._error(f"{_shown(cell)} {_too_large(name, float(cell))}", line=line, column=name)
        raise AssertionError("a row was refused, but every cell of it is sound")

    def _bad_time(self, cell: str, last_s: float, line: int) -> RecordingError:
        if not cell:
            return self._error("is blank; every row needs its time", line=line, column="t_s")
        return self._error(f"{_shown(cell)} does not come after {last_s!r}, the row before", line=line, column="t_s")

    def _error(self, reason: str, *, line: int = 0, column: str = "") -> RecordingError:
        return RecordingError(self._file, reason, line=line, column=column)


def _numbers(cells: tuple[str, ...]) -> list[float] | None:
    """The numbers in some cells, nan for a blank one; None: one is no finite number in plain digits, and not blank."""
    blank = [i for i, cell in enumerate(cells) if not cell] if "" in cells else []
    try:
        # Four times as fast as float(), to the same digits, and stricter: what it does not take is looked at again.
        found = _DECODER.decode(f"[{','.join([cell or '0' for cell in cells] if blank else cells)}]")
    except msgspec.DecodeError:
        found = []
    if len(found) == len(cells):
        for i in blank:
            found[i] = nan
        return found
    try:
        found = [float(cell) if cell else nan for cell in cells]
    except ValueError:
        return None
    text = "".join(cells)
    is_plain = sum(map(isfinite, found)) + cells.count("") == len(cells) and "_" not in text and text.isascii()
    return found if is_plain else None


def _staged(t_s: float, values: list[float]) -> tuple[RatesSample | None, CraftSample | None, CraneSample | None]:
    """What the cells of STAGE_COLUMNS say; nothing where all of a device's are blank."""
    _, _, _, gx, gy, gz, heave, pitch, speed, fore, aft, slew, boom, jib, line_out = values
    rates = RatesSample(t_s=t_s, gx_radps=gx, gy_radps=gy, gz_radps=gz) if isfinite(gx + gy + gz) else None
    craft = crane = None
    if any(map(isfinite, (heave, pitch, speed, fore, aft))):
        craft = CraftSample(
            t_s=t_s,
            heave_m=heave,
            pitch_rad=pitch * _RADIANS_PER_DEGREE,
            speed_mps=speed,
            flap_fore_rad=fore * _RADIANS_PER_DEGREE,
            flap_aft_rad=aft * _RADIANS_PER_DEGREE,
        )
    if any(map(isfinite, (slew, boom, jib, line_out))):
        crane = CraneSample(
            t_s=t_s,
            slew_rad=slew * _RADIANS_PER_DEGREE,
            boom_rad=boom * _RADIANS_PER_DEGREE,
            jib_rad=jib * _RADIANS_PER_DEGREE,
            line_out_m=line_out,
        )
    return rates, craft, crane


def _line(rows: Iterator[list[str]]) -> int:
    """Line of the file that was read last: the header came before the reader's first."""
    return int(rows.line_num) + 1  # type: ignore[attr-defined]


def _is_number(text: str) -> bool:
    """Whether ``text`` is a number as CSV has it; Python also takes ``1_000`` and the digits of other scripts."""
    try:
        float(text)
    except ValueError:
        return False
    return text.isascii() and "_" not in text


def _limit(column: str) -> float:
    return LIMITS[column.rpartition("_")[2]]


def _too_large(column: str, value: float) -> str:
    if column != "t_s":
        unit = column.rpartition("_")[2]
        return f"is more than any sensor measures ({_limit(column):g} {unit}); leave a missing value blank"
    for unit, factor, _ in _UNITS_OF_TIME:
        if _EPOCH_S[0] <= value / factor <= _EPOCH_S[1]:
            return f"is no time in seconds: is t_s in {unit}?"
    return "is no time in seconds"


def _why_so_slow(step_s: float) -> str:
    for unit, factor, fastest_hz in _UNITS_OF_TIME:
        rate_hz = factor / step_s
        if 1.0 <= rate_hz <= fastest_hz:
            return f": is t_s in {unit}? ({rate_hz:g} samples a second, then; it must be in seconds)"
    return f": too slow to show waves, which takes 4 a second or more (and less than {TOO_SLOW_S:g} s between them)"


def _shown(text: str) -> str:
    return repr(text if len(text) <= 40 else text[:40] + "…")


def _not_utf8(error: UnicodeDecodeError) -> str:
    return f"is not UTF-8 text (byte 0x{error.object[error.start]:02x}: {error.reason}); save it as CSV in UTF-8"


def _unknown_column(name: str) -> str:
    stem = name.lower().split("_")[0].split("(")[0].split("[")[0].strip()
    stems = {column.split("_")[0]: column for column in COLUMNS}
    meant = _ALSO_CALLED.get(stem) or stems.get(stem)
    hint = f"did you mean {meant}? (the name says the unit: convert the values too); " if meant else ""
    return f"unknown column; {hint}columns are {', '.join(COLUMNS + STAGE_COLUMNS)}"
