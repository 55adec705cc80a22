"""InfluxDB's line protocol: a line for each thing that is told of at one moment. Pure.

    heaved_motion,host=ship heave_m=0.123,quality="valid" 1767225600123456000

Source: InfluxDB v2 documentation, "Line protocol" (v1 has the same). Names, units and rounding are those of the stream,
of the same table (:mod:`heaved.outputs.fields`); what is not known is left out, and a line that says nothing is none.
Numbers are sent as floats but for counts, always: a field keeps the type in which it came first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from heaved.outputs import fields, wire

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from heaved.outputs.records import StatusRecord
    from heaved.samples import (
        CraftMotion,
        DelayedHeave,
        HullAngles,
        MotionFrame,
        MruComparison,
        QuietForecast,
        SeaState,
    )

Value = float | int | bool | str

_NOT_SAID: Final = {"\n": "_", "\r": "_", "\t": "_", "\\": "/"}
"""Names have no sign for these: a line would end there, and a backslash take the meaning of what follows."""
_IN_NAME: Final = str.maketrans({",": "\\,", "=": "\\=", " ": "\\ ", **_NOT_SAID})
"""Of tags and keys."""
_IN_MEASUREMENT: Final = str.maketrans({",": "\\,", " ": "\\ ", **_NOT_SAID})
_IN_TEXT: Final = str.maketrans({'"': '\\"', "\\": "\\\\", "\n": " ", "\r": " "})


def encode(measurement: str, tags: Mapping[str, str], values: Mapping[str, Value], utc_s: float) -> bytes:
    """One line with its end; empty where there are no values. Tags without a value are left out.

    ``utc_s``: seconds since 1970; to the microsecond, as on the stream, though it is sent in nanoseconds.
    """
    if not values:
        return b""
    head = measurement.translate(_IN_MEASUREMENT)
    for key, tag in sorted(tags.items()):  # Sorted they are taken fastest, says its documentation.
        if tag:
            head += f",{_name(key)}={_name(tag)}"
    told = ",".join([f"{_name(key)}={_value(value)}" for key, value in values.items()])
    return f"{head} {told} {round(utc_s * 1e6)}000\n".encode()


def _name(text: str) -> str:
    return text.translate(_IN_NAME)


def _value(value: Value) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value.translate(_IN_TEXT)}"'
    return f"{value}i" if isinstance(value, int) else repr(value)


class Lines:
    """Lines of what the daemon says, with the measurements and tags of one configuration.

    Each method gives whole lines. ``utc_s``: of the validity of what it is given.
    """

    def __init__(self, measurement: str, tags: Mapping[str, str]) -> None:
        """``measurement``: what the names of all begin with."""
        self._measurement = measurement
        self._tags = dict(tags)
        self.slow: dict[str, Callable[..., list[bytes]]] = {
            "sea": self.sea,
            "delayed": self.delayed,
            "hull": self.hull,
            "attitude": self.attitude,
            "reference_mru": self.reference_mru,
            "quiet": self.quiet,
        }
        """By the attribute of a frame that many frames share: see :mod:`heaved.outputs.slower`."""

    def motion(self, frame: MotionFrame, utc_s: float) -> list[bytes]:
        """The frame; its points, and what it foretells for each horizon, as lines of their own."""
        quality = frame.quality
        values: dict[str, Value] = {**fields.MOTION.known(frame)}
        if frame.compensation_lead_s:
            values["compensation_lead_s"] = frame.compensation_lead_s
        values |= {
            "quality": quality.heave.value,
            "laser": quality.laser.value,
            "correction": quality.correction.value,
            "reasons": "; ".join(quality.reasons),
        }
        lines = [self._line("motion", utc_s, values)]
        lines += [self._line("point", utc_s, fields.POINT.known(one), point=one.name) for one in frame.points]
        lines += [
            self._line("rock", utc_s, fields.ROCK.known(one), horizon_s=f"{one.horizon_s:g}") for one in frame.rock
        ]
        lines += [
            self._line("forecast", utc_s, fields.FORECAST.known(one), horizon_s=f"{one.horizon_s:g}")
            for one in frame.forecast
        ]
        return [line for line in lines if line]

    def sea(self, sea: SeaState, utc_s: float) -> list[bytes]:
        """Heights and periods, those of swell and wind sea apart, and what shakes the hull."""
        record = wire.sea_record(sea, utc_s)
        values: dict[str, Value] = {
            "significant_height_m": float(record.significant_height_m),
            "peak_period_s": float(record.peak_period_s),
            "mean_period_s": float(record.mean_period_s),
            "is_still": record.is_still,
            "window_s": float(record.window_s),
        }
        noise = {"noise_mps2_rthz": record.noise_mps2_rthz, "bias_walk_mps2_rts": record.bias_walk_mps2_rts}
        values |= {name: value for name, value in noise.items() if value is not None}
        lines = [self._line("sea", utc_s, values)]
        lines += [
            self._line(
                "wave_system",
                utc_s,
                {
                    "significant_height_m": float(one.significant_height_m),
                    "peak_period_s": float(one.peak_period_s),
                    "kind": one.kind,
                },
                rank=str(rank),
            )
            for rank, one in enumerate(record.systems, start=1)
        ]
        lines += [
            self._line(
                "vibration",
                utc_s,
                {"frequency_hz": one.frequency_hz, "width_hz": one.width_hz, "rms_mps2": one.rms_mps2},
                rank=str(rank),
            )
            for rank, one in enumerate(record.vibration, start=1)
        ]
        return lines

    def delayed(self, delayed: DelayedHeave, utc_s: float) -> list[bytes]:
        """The delayed heave, at its own time."""
        return self._lines("delayed", utc_s, fields.DELAYED.known(delayed))

    def hull(self, hull: HullAngles, utc_s: float) -> list[bytes]:
        """The deformation of the hull."""
        told: dict[str, Value] = {"state": hull.state, "refits": hull.refits, "resets": hull.resets}
        return self._lines("hull", utc_s, {**fields.HULL.known(hull), **fields.HULL_STD.known(hull), **told})

    def attitude(self, motion: CraftMotion, utc_s: float) -> list[bytes]:
        """The attitude of a craft."""
        told = {"switches": motion.switches, "resets": motion.resets}
        return self._lines("attitude", utc_s, {**fields.ATTITUDE.known(motion), **told})

    def reference_mru(self, compared: MruComparison, utc_s: float) -> list[bytes]:
        """How an existing MRU stands to ours, each quantity as a line of its own."""
        told = {
            "heave": fields.MRU_HEAVE.known(compared.heave),
            "heave_velocity": fields.MRU_VELOCITY.known(compared.heave_velocity),
            "roll": fields.MRU_ANGLE.known(compared.roll),
            "pitch": fields.MRU_ANGLE.known(compared.pitch),
            "yaw": fields.MRU_ANGLE.known(compared.yaw),
        }
        return [
            line
            for quantity, values in told.items()
            if values and (line := self._line("reference_mru", utc_s, values, quantity=quantity))
        ]

    def quiet(self, quiet: QuietForecast, utc_s: float) -> list[bytes]:
        """The next quiet window."""
        record = wire.quiet_record(quiet, utc_s)
        told = {
            name: float(value)
            for name in ("start_s", "length_s", "confidence", "best_confidence")
            if (value := getattr(record, name)) is not None
        }
        return self._lines("quiet", utc_s, {"is_expected": record.is_expected, **told})

    def status(self, status: StatusRecord, utc_s: float) -> list[bytes]:
        """The daemon, and each device."""
        values: dict[str, Value] = {
            "uptime_s": float(status.uptime_s),
            "frames": status.frames,
            "clients": status.clients,
            "dropped": status.dropped,
            "quality": status.quality.heave.value,
            "release": status.release,
        }
        if status.rate_hz is not None:
            values["rate_hz"] = float(status.rate_hz)
        lines = self._lines("status", utc_s, values)
        for device in status.devices:
            told: dict[str, Value] = {"up": device.up}
            if device.rate_hz is not None:
                told["rate_hz"] = float(device.rate_hz)
            told |= {f"polls_{result}": count for result, count in device.results.items()}
            lines += self._lines("device", utc_s, told, device=device.name, role=device.role)
        return lines

    def _lines(self, name: str, utc_s: float, values: Mapping[str, Value], **tags: str) -> list[bytes]:
        line = self._line(name, utc_s, values, **tags)
        return [line] if line else []

    def _line(self, name: str, utc_s: float, values: Mapping[str, Value], **tags: str) -> bytes:
        return encode(f"{self._measurement}_{name}", {**self._tags, **tags}, values, utc_s)
