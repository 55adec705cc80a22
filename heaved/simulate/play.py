"""A recording in place of a simulated sea, and recordings of simulated seas as files.

Columns are those of a recording: ``t_s``, ``ax_mps2 ay_mps2 az_mps2``, ``roll_deg pitch_deg yaw_deg``, ``gx_radps
gy_radps gz_radps``, ``laser_m``, ``slew_deg boom_deg jib_deg line_out_m``; a blank is a missing reading. Here they are
read leniently, for the simulator alone.
"""

from __future__ import annotations

import csv
import math
from typing import TYPE_CHECKING

import numpy as np

from heaved.samples import CraftSample, CraneSample, Fault, ImuSample, LaserSample, MruSample, Sample

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from heaved.devices.profile import DeviceSpec
    from heaved.simulate.sensors import Recording
    from heaved.simulate.vessel import Array

LONGEST_GAP_S = 0.5
"""Between readings further apart than this a quantity is missing, not interpolated."""

# Column of the file, quantity inside, inside per file unit, decimals written.
_COLUMNS: tuple[tuple[str, str, float, int], ...] = (
    ("t_s", "t_s", 1.0, 6),
    ("ax_mps2", "ax_mps2", 1.0, 6),
    ("ay_mps2", "ay_mps2", 1.0, 6),
    ("az_mps2", "az_mps2", 1.0, 6),
    ("roll_deg", "roll_rad", math.pi / 180.0, 5),
    ("pitch_deg", "pitch_rad", math.pi / 180.0, 5),
    ("yaw_deg", "yaw_rad", math.pi / 180.0, 5),
    ("gx_radps", "gx_radps", 1.0, 6),
    ("gy_radps", "gy_radps", 1.0, 6),
    ("gz_radps", "gz_radps", 1.0, 6),
    ("laser_m", "laser_m", 1.0, 4),
)
_CRANE_COLUMNS: tuple[tuple[str, str, float], ...] = (
    ("slew_deg", "slew_rad", math.pi / 180.0),
    ("boom_deg", "boom_rad", math.pi / 180.0),
    ("jib_deg", "jib_rad", math.pi / 180.0),
    ("line_out_m", "line_out_m", 1.0),
)
_READ = tuple((header, quantity, unit) for header, quantity, unit, _ in _COLUMNS) + _CRANE_COLUMNS
_TURNING = ("yaw_rad", "slew_rad")
"""Angles that pass a full turn."""


def write_recording(path: Path, recording: Recording) -> None:
    """Write the readings; a quantity that was never read has no column."""
    columns = {
        header: (np.asarray(getattr(recording, quantity)) / unit, decimals)
        for header, quantity, unit, decimals in _COLUMNS
    }
    _write(path, columns)


def write_truth(path: Path, recording: Recording) -> None:
    """Write the true motion: ``t_s, heave_m, heave_velocity_mps, roll_deg, pitch_deg, yaw_deg``."""
    truth = recording.truth
    _write(
        path,
        {
            "t_s": (truth.t_s, 6),
            "heave_m": (truth.heave_m, 6),
            "heave_velocity_mps": (truth.heave_velocity_mps, 6),
            "roll_deg": (np.degrees(truth.roll_rad), 5),
            "pitch_deg": (np.degrees(truth.pitch_rad), 5),
            "yaw_deg": (np.degrees(truth.yaw_rad), 5),
        },
    )


def _write(path: Path, columns: Mapping[str, tuple[Array, int]]) -> None:
    columns = {header: column for header, column in columns.items() if np.any(np.isfinite(column[0]))}
    rendered: Sequence[list[str]] = [
        [f"{value:.{decimals}f}" if math.isfinite(value) else "" for value in column.tolist()]
        for column, decimals in columns.values()
    ]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*rendered, strict=True))


def read_recording(path: Path) -> dict[str, Array]:
    """Columns of a recording in SI units and radians, by quantity (``t_s``, ``az_mps2``, ``roll_rad``, ``laser_m``...),
    each (n,), nan where blank. Columns that the simulator has no use for are left out.

    Raises:
        ValueError: no ``t_s`` column, no rows, time that does not increase, or a cell that is no number.
        OSError: the file cannot be read.
    """
    with path.open(newline="", encoding="utf-8") as file:
        rows = csv.DictReader(file)
        cells: dict[str, list[float]] = {header: [] for header, *_ in _READ if header in (rows.fieldnames or ())}
        for number, row in enumerate(rows, start=2):
            for header, column in cells.items():
                text = (row[header] or "").strip()
                try:
                    column.append(float(text) if text else math.nan)
                except ValueError:
                    raise ValueError(f"{path}, line {number}, column {header}: {text!r} is not a number") from None
    if not cells.get("t_s"):
        raise ValueError(f"{path} is no recording: it needs a header row with the column t_s, and rows below it")
    columns = {quantity: np.array(cells[header]) * unit for header, quantity, unit in _READ if header in cells}
    if not np.all(np.diff(columns["t_s"]) > 0.0):
        raise ValueError(f"{path}: t_s must be present in every row and increase from row to row")
    return columns


class Player:
    """Serves a recording as if its sensors were read now: a source for simulated slaves.

    Between two readings of a quantity it is interpolated. Where it is missing (blanks longer than
    :data:`LONGEST_GAP_S`, before the first and after the last row) it is nan, and the simulated device refuses the
    request with the exception "slave device failure", as a laser without an echo does.
    """

    def __init__(self, columns: Mapping[str, Array], *, loop: bool = False) -> None:
        """``columns`` as :func:`read_recording` gives them; with ``loop`` the recording starts over at its end."""
        t = columns["t_s"] - columns["t_s"][0]
        self.duration_s = float(t[-1])
        self._loop = loop
        self._present: dict[str, tuple[Array, Array]] = {}
        for quantity, column in columns.items():
            there = np.isfinite(column)
            if quantity == "t_s" or not np.any(there):
                continue
            # A heading that passes north must not be interpolated through south.
            values = np.unwrap(column[there]) if quantity in _TURNING else column[there]
            self._present[quantity] = t[there], values

    def read(self, device: DeviceSpec, t_s: float) -> Sample:
        """What ``device`` reads ``t_s`` seconds after the first row."""
        at = t_s % self.duration_s if self._loop and self.duration_s > 0.0 else t_s
        if device.role == "laser":
            laser = self._value("laser_m", at)
            return LaserSample(t_s=t_s, laser_m=laser, fault=Fault.EXCEPTION if math.isnan(laser) else Fault.NONE)
        if device.role == "crane":
            return CraneSample(
                t_s=t_s,
                slew_rad=self._value("slew_rad", at) % (2.0 * math.pi),  # 0..2 pi, as registers hold it
                boom_rad=self._value("boom_rad", at),
                jib_rad=self._value("jib_rad", at),
                line_out_m=self._value("line_out_m", at),
            )
        if device.role == "reference_mru":
            return MruSample(t_s=t_s)  # Nor of an MRU.
        if device.role != "imu":
            return CraftSample(t_s=t_s)  # A recording of the heave has none of theirs.
        return ImuSample(
            t_s=t_s,
            ax_mps2=self._value("ax_mps2", at),
            ay_mps2=self._value("ay_mps2", at),
            az_mps2=self._value("az_mps2", at),
            roll_rad=self._value("roll_rad", at),
            pitch_rad=self._value("pitch_rad", at),
            yaw_rad=math.remainder(self._value("yaw_rad", at), 2.0 * math.pi),  # -pi..pi, as registers hold it
            gx_radps=self._value("gx_radps", at),
            gy_radps=self._value("gy_radps", at),
            gz_radps=self._value("gz_radps", at),
        )

    def _value(self, quantity: str, t_s: float) -> float:
        if quantity not in self._present:
            return math.nan
        t, values = self._present[quantity]
        after = int(np.searchsorted(t, t_s))
        if after < t.size and t[after] == t_s:
            return float(values[after])
        if after in (0, t.size) or t[after] - t[after - 1] > LONGEST_GAP_S:
            return math.nan
        share = (t_s - t[after - 1]) / (t[after] - t[after - 1])
        return float(values[after - 1] + share * (values[after] - values[after - 1]))
