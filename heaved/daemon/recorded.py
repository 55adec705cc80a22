"""What is recorded of a poll and of a frame: their columns, and how each is packed for the process that records.

Packing is all that the loop pays for, so what is packed is compiled once for each configuration, as for the stream.
"""

from __future__ import annotations

import struct
from math import nan
from typing import TYPE_CHECKING, Any, Final

import msgspec

from heaved.devices.profile import SI, told_together
from heaved.devices.station import KINDS
from heaved.estimation.rock.params import STANDARD_HORIZONS_S
from heaved.outputs.fields import (
    ATTITUDE,
    FORECAST,
    HULL,
    HULL_STD,
    MOTION,
    MRU_ANGLE,
    MRU_HEAVE,
    MRU_VELOCITY,
    POINT,
    ROCK,
    Fields,
    compiled,
)
from heaved.recorder import messages
from heaved.recorder.layout import Column, Device, Layout, Stored
from heaved.recorder.messages import Kind, packed
from heaved.samples import Fault, MotionFrame, MruAgreement, Quality

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from heaved.config import Config
    from heaved.devices.profile import DeviceSpec
    from heaved.devices.station import PollResult


# ---- what a poll gave ------------------------------------------------------------------------------------------------

_FAULT: Final = {fault: number for number, fault in enumerate(Fault)}


def device_of(spec: DeviceSpec) -> Device:
    """The columns of a device.

    A register's number is kept as it is, with the scale that its profile has: the value of the sample to the last bit,
    in two bytes instead of eight. What comes from no register, or has a scale of its own, is kept as a double.
    """
    columns = [
        Column(
            name=field.quantity,
            stored=Stored(field.type),
            scale=field.scale,
            offset=field.offset_value,
            factor=field.sign * SI[field.unit][0],
            unit=_unit_of(field.quantity),
            is_exact=True,
        )
        for block in spec.profile.blocks
        for field in block.fields
        if field.scale_from is None  # Its scale is known with each reading alone.
    ]
    carried = {column.name for column in columns}
    columns += [
        Column(name=name, stored=Stored.FLOAT64, unit=_unit_of(name), is_exact=True)
        for names in told_together(spec.profile)
        for name in names
        if name not in carried
    ]
    return Device(name=spec.name, role=spec.role, sample=KINDS[spec.role].__name__, columns=tuple(columns))


class PollPacker:
    """Polls of one device."""

    def __init__(self, number: int, device: Device) -> None:
        """``number``: of the device in the header."""
        self._number = number
        kind = next(kind for kind in KINDS.values() if kind.__name__ == device.sample)
        attributes = set(kind.__struct_fields__)  # type: ignore[attr-defined]
        values = [
            f"sample.{column.name}" if column.name in attributes else f"extra.get({column.name!r}, nan)"
            for column in device.columns
        ]
        self._values: Callable[..., tuple[float, ...]] = compiled(
            f"({', '.join(values)},)", ["sample", "extra"], nan=nan
        )
        self._struct = struct.Struct(f"{messages.SAMPLE.format}{len(values)}d")

    def pack(self, result: PollResult, seq: int) -> bytes:
        """The message of a poll; ``seq``: number of the call."""
        sample = result.sample
        values = self._values(sample, result.extra)
        body = self._struct.pack(self._number, seq, _FAULT[sample.fault], sample.t_s, *values)
        return packed(Kind.SAMPLE, body)


# ---- what a frame says -----------------------------------------------------------------------------------------------

_RESOLUTION: Final = {
    "m": 1e-4, "mps": 1e-3, "mps2": 1e-3, "s": 1e-4, "deg": 1e-3, "degps": 1e-2, "arcsec": 1e-1,
}  # fmt: skip
"""Of what a frame says, by unit: a tenth of what the best sensors are worth, or less."""
_SOON_S: Final = 0.2
_AHEAD: Final = {"m": (1e-3, 1e-2), "deg": (1e-3, 1e-2)}
"""Of what is predicted for sooner than that, and for later: a tenth of its error, or less. This is what most of a
recording consists of."""

_NOW: Final = ("heave_m", "heave_std_m", "heave_velocity_mps")
_QUIET: Final = ("start_s", "length_s", "confidence", "best_confidence")
_CRANE: Final = tuple(f"crane_{axis}_deg" for axis in ("roll", "pitch", "yaw"))

MRU: Final[dict[str, Fields[MruAgreement]]] = {
    "heave": MRU_HEAVE,
    "heave_velocity": MRU_VELOCITY,
    **dict.fromkeys(("roll", "pitch", "yaw"), MRU_ANGLE),
}
"""What of an existing MRU is compared."""
_MRU_TOLD: Final = ("reference", "difference")
"""Of each; the statistics are made of these again. The readings themselves are in the other table."""

QUALITY: Final = ("quality", "laser", "correction", "reasons")
"""Texts that hold until they change."""
BETWEEN: Final = "; "
"""Reasons."""


class FramePacker:
    """Frames of one configuration.

    What a frame carries again and again, the same object, is told once: the delayed heave, the sea, the stages.

    Attributes:
        numbers: columns of what is told with each frame.
        texts: columns of what is told when it changes.
    """

    def __init__(self, config: Config) -> None:
        self._forecast_s = list(config.heave.forecast_horizons_s)
        self._rock_s = sorted({*config.rock.horizons_s, *STANDARD_HORIZONS_S})
        self._points = [point.name for point in config.point]
        motion: Fields[MotionFrame] = MOTION if config.hull.enabled else MOTION.only(
            *(name for name in MOTION.names if name not in _CRANE)
        )  # fmt: skip
        numbers = [_column(name) for name in motion.names]
        values = motion.outside("frame")
        self._has_lead = config.compensation.lead_s > 0.0
        if self._has_lead:
            numbers += [_column(f"now_{name}") for name in _NOW]
            values += [f"(nan if frame.now is None else frame.now.{name})" for name in _NOW]
        numbers += [_column(f"delayed_{name}", scale) for name, scale in (("t_s", 1e-6), ("m", 1e-4), ("std_m", 1e-4))]
        values += [f"(nan if delayed is None else delayed.{name})" for name in ("t_s", "heave_m", "std_m")]
        if config.quiet.enabled:
            numbers += [_column(f"quiet_{name}", 1e-3) for name in _QUIET]
            values += [
                *(f"(nan if quiet is None or quiet.window is None else quiet.window.{name})" for name in _QUIET[:3]),
                "(nan if quiet is None else quiet.best)",
            ]
        if config.hull.enabled:
            numbers += [_column("hull_age_s"), *(_column(f"hull_{name}") for name in (*HULL.names, *HULL_STD.names))]
            values += [
                f"(nan if hull is None else {value})"
                for value in ("frame.t_s - hull.t_s", *HULL.outside("hull"), *HULL_STD.outside("hull"))
            ]
        if config.attitude.enabled:
            craft = [name.replace("heave_velocity", "z_rate").replace("heave", "z") for name in ATTITUDE.names]
            numbers += [_column("attitude_age_s"), *(_column(f"attitude_{name}") for name in craft)]
            values += [
                f"(nan if attitude is None else {value})"
                for value in ("frame.t_s - attitude.t_s", *ATTITUDE.outside("attitude"))
            ]
        if any(device.role == "reference_mru" for device in config.device):
            numbers.append(_column("mru_age_s"))
            values.append("(nan if mru is None else frame.t_s - mru.t_s)")
            for quantity, fields in MRU.items():
                told = fields.only(*(name for name in fields.names if name.startswith(_MRU_TOLD)))
                numbers += [_column(f"mru_{quantity}_{name}") for name in told.names]
                values += [f"(nan if mru is None else {value})" for value in told.outside(f"mru.{quantity}")]
        self._of_frame: Callable[..., tuple[float, ...]] = compiled(
            f"(frame.t_s, {', '.join(values)})", ["frame", "delayed", "quiet", "hull", "attitude", "mru"], nan=nan
        )
        numbers += [_column(f"point_{name}_{field}") for name in self._points for field in POINT.names]
        self._of_point = _tuple_of(POINT)
        for horizon_s in self._forecast_s:
            numbers += [_column(f"forecast_{horizon_s:g}s_{name}", _ahead("m", horizon_s)) for name in ("m", "std_m")]
        self._of_forecast = _tuple_of(FORECAST)
        for horizon_s in self._rock_s:
            numbers += [_column(name, _ahead("deg", horizon_s)) for name in map(_at(horizon_s), ROCK.names)]
        self._of_rock = _tuple_of(ROCK)
        self.numbers = tuple(numbers)
        self.texts = tuple(
            Column(name=name, stored=Stored.TEXT)
            for name in (*QUALITY, "sea", *(["hull_state"] if config.hull.enabled else []))
        )
        self._no_points = (nan,) * (len(POINT.names) * len(self._points))
        self._no_forecast = (nan,) * (len(FORECAST.names) * len(self._forecast_s))
        self._no_rock = (nan,) * (len(ROCK.names) * len(self._rock_s))
        self._struct = struct.Struct(f"<{1 + len(self.numbers)}d")
        self._text = {column.name: bytes([i]) for i, column in enumerate(self.texts)}
        self._quality: Quality | None = None
        self._hull_state = ""
        self._told: dict[str, object] = {}
        """The last of what is told once."""

    def begin(self) -> None:
        """Whoever reads on from here knows none of what holds until it changes."""
        self._quality, self._hull_state = None, ""

    def pack(self, frame: MotionFrame) -> bytes:
        """The messages of a frame."""
        before = self._texts(frame) if frame.quality is not self._quality or frame.sea is not None else b""
        values = self._of_frame(
            frame,
            self._new("delayed", frame.delayed),
            self._new("quiet", frame.quiet),
            hull := self._new("hull", frame.hull),
            self._new("attitude", frame.attitude),
            self._new("mru", frame.reference_mru),
        )
        # While a new configuration is taken up there may be frames of the hull of before.
        if hull is not None and hull.state != self._hull_state and "hull_state" in self._text:
            self._hull_state = hull.state
            before += packed(Kind.TEXT, self._text["hull_state"] + hull.state.encode())
        if self._points:
            named = [point.name for point in frame.points] == self._points
            values += _joined(self._of_point, frame.points) if named else self._no_points
        ahead = frame.forecast
        there = [one.horizon_s for one in ahead] == self._forecast_s
        values += _joined(self._of_forecast, ahead) if there else self._no_forecast
        rocks = frame.rock
        there = [one.horizon_s for one in rocks] == self._rock_s
        values += _joined(self._of_rock, rocks) if there else self._no_rock
        return before + packed(Kind.FRAME, self._struct.pack(*values))

    def _new(self, name: str, record: Any) -> Any:
        """The record, if it was not told before; else None."""
        if record is None or record is self._told.get(name):
            return None
        self._told[name] = record
        return record

    def _texts(self, frame: MotionFrame) -> bytes:
        said = b""
        quality = frame.quality
        if quality != self._quality:
            words = (quality.heave.value, quality.laser.value, quality.correction.value, BETWEEN.join(quality.reasons))
            for name, word in zip(QUALITY, words, strict=True):
                said += packed(Kind.TEXT, self._text[name] + word.encode())
        self._quality = quality
        sea = self._new("sea", frame.sea)
        if sea is not None:
            said += packed(Kind.TEXT, self._text["sea"] + msgspec.json.encode(sea))
        return said


def layout_of(config: Config, frames: FramePacker) -> Layout:
    """Both tables of a configuration."""
    return Layout(
        devices=tuple(device_of(spec) for spec in config.device),
        numbers=frames.numbers,
        texts=frames.texts,
        lasting=(*QUALITY, "hull_state"),
    )


def _joined(values: Callable[[Any], tuple[float, ...]], records: Sequence[Any]) -> tuple[float, ...]:
    return tuple([value for record in records for value in values(record)])


def _tuple_of(fields: Fields[Any]) -> Callable[[Any], tuple[float, ...]]:
    return compiled(f"({', '.join(fields.outside('record'))},)")


def _at(horizon_s: float) -> Callable[[str], str]:
    """Names as in the table of a replay: ``roll_std_deg`` of 0.1 s is ``roll_0.1s_std_deg``."""

    def named(name: str) -> str:
        axis, _, rest = name.partition("_")
        return f"{axis}_{horizon_s:g}s_{rest}"

    return named


def _ahead(unit: str, horizon_s: float) -> float:
    soon, later = _AHEAD[unit]
    return soon if horizon_s < _SOON_S else later


def _unit_of(name: str) -> str:
    return name.rpartition("_")[2]


def _column(name: str, scale: float | None = None) -> Column:
    unit = _unit_of(name)
    is_time = name == "delayed_t_s"
    return Column(
        name=name,
        stored=Stored.INT64 if is_time else Stored.INT32,
        scale=_RESOLUTION.get(unit, 1e-3) if scale is None else scale,
        unit=unit,
    )
