"""JSON lines of the stream, both ways. Pure: bytes and times are arguments, there is no socket and no clock here.

One object per line, UTF-8, ``class`` first. What is not known is left out, never ``null`` or ``NaN``. Angles leave in
degrees, times of validity as ISO 8601 UTC. Signs are those of :mod:`heaved.samples`.

A MOTION line is encoded once for all clients. Only its tail, ``age_s`` and ``dropped``, belongs to one client at one
moment, so it is put on when the line is handed to that client's socket: see :func:`motion_head`, :func:`motion_tail`.
"""

from __future__ import annotations

import functools
import math
from datetime import UTC, datetime
from typing import Any, Final, Literal, get_args

import msgspec

from heaved.samples import (
    CorrectionState,
    DelayedHeave,
    HeaveForecast,
    HeaveState,
    LaserState,
    MotionFrame,
    PointMotion,
    QuietForecast,
    RockPrediction,
    RockScore,
    SeaState,
)

PROTO_MAJOR: Final = 1
PROTO_MINOR: Final = 1
MAX_REQUEST_BYTES: Final = 512
"""Longest line that a client may send, its line end included."""

StreamClass = Literal["MOTION", "SEA", "DELAYED", "HULL", "ATTITUDE", "QUIET", "STATUS"]
"""What a client may watch. VERSION, ERROR and the answer to ``?STATUS`` are sent whatever it watches."""
STREAM_CLASSES: Final[tuple[str, ...]] = get_args(StreamClass)

ACCEPTED: Final = 'send ?WATCH={"classes":["MOTION","SEA"],"rate_hz":10}, ?STATUS or ?VERSION, one per line'

_MICRO_PER_RADIAN: Final = 1e6 * 180.0 / math.pi
_LIMIT: Final = 1e15
"""Millionths. Nothing that is published comes near it: what is beyond is as unknown as infinity."""
_ROUND: Final = 1.5 * 2.0**52
"""Adding it to a double below 2**51 and taking it away again rounds to a whole number: a third of the time of round(),
which matters for the sixty numbers of a frame."""


# --- what is sent ----------------------------------------------------------------------------------------------------


class VersionRecord(msgspec.Struct, frozen=True, kw_only=True, tag_field="class", tag="VERSION"):
    """First line of every connection, and the answer to ``?VERSION``."""

    release: str
    proto_major: int = PROTO_MAJOR
    """Changes when an old client would misread the stream."""
    proto_minor: int = PROTO_MINOR
    """Changes when fields or classes are added."""


class ErrorRecord(msgspec.Struct, frozen=True, kw_only=True, tag_field="class", tag="ERROR"):
    message: str


class QualityRecord(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    heave: HeaveState
    laser: LaserState
    correction: CorrectionState
    reasons: tuple[str, ...] = ()


class RockRecord(msgspec.Struct, frozen=True, gc=False, kw_only=True, omit_defaults=True):
    """Attitude predicted for ``horizon_s`` after the time of validity; standard deviations of the prediction error, and
    half-widths of the interval that holds 95 % of what is measured then."""

    horizon_s: float
    roll_deg: float | None = None
    pitch_deg: float | None = None
    yaw_deg: float | None = None
    roll_std_deg: float | None = None
    pitch_std_deg: float | None = None
    yaw_std_deg: float | None = None
    roll_interval_deg: float | None = None
    pitch_interval_deg: float | None = None
    yaw_interval_deg: float | None = None


class ForecastRecord(msgspec.Struct, frozen=True, gc=False, kw_only=True, omit_defaults=True):
    """Heave predicted for ``horizon_s`` after the time of validity."""

    horizon_s: float
    heave_m: float | None = None
    std_m: float | None = None


class PointRecord(msgspec.Struct, frozen=True, gc=False, kw_only=True, omit_defaults=True):
    """A monitoring point, as configured."""

    name: str
    heave_m: float | None = None
    heave_velocity_mps: float | None = None


class MotionRecord(
    msgspec.Struct, frozen=True, gc=False, kw_only=True, omit_defaults=True, tag_field="class", tag="MOTION"
):
    """One frame. ``age_s`` and ``dropped`` are last, because :func:`motion_tail` writes them."""

    seq: int
    """Counts the frames of the daemon since its start."""
    time: str
    """UTC of validity, microseconds."""
    mono_s: float
    """The daemon's monotonic clock at validity."""
    heave_m: float | None = None
    heave_std_m: float | None = None
    heave_velocity_mps: float | None = None
    heave_acceleration_mps2: float | None = None
    observer_m: float | None = None
    correction_m: float | None = None
    lead_s: float | None = None
    reference_m: float | None = None
    roll_deg: float | None = None
    pitch_deg: float | None = None
    yaw_deg: float | None = None
    crane_roll_deg: float | None = None
    """Attitude of the crane base, once the hull's deformation has converged."""
    crane_pitch_deg: float | None = None
    crane_yaw_deg: float | None = None
    compensation_lead_s: float | None = None
    """Heave, its standard deviation and velocity, and the points are for this long after ``time``; absent: 0."""
    points: tuple[PointRecord, ...] = ()
    rock: tuple[RockRecord, ...] = ()
    forecast: tuple[ForecastRecord, ...] = ()
    quality: QualityRecord
    age_s: float | None = None
    """From validity to the moment the line was given to the socket."""
    dropped: int | None = None
    """Frames that this client lost just before this one, because it did not keep up."""


class WaveSystemRecord(msgspec.Struct, frozen=True, kw_only=True):
    """One peak of the heave spectrum."""

    kind: str
    significant_height_m: float
    peak_period_s: float


class SeaRecord(msgspec.Struct, frozen=True, kw_only=True, tag_field="class", tag="SEA"):
    """The sea as the heave shows it, with each refit."""

    time: str
    """UTC of the end of the record that it comes from."""
    significant_height_m: float
    peak_period_s: float
    mean_period_s: float
    is_still: bool
    systems: tuple[WaveSystemRecord, ...]
    """Swell and wind sea, longest waves first."""
    frequencies_hz: tuple[float, ...]
    spectrum_m2phz: tuple[float, ...]
    """One-sided heave spectrum."""
    model: str
    window_s: float
    """Length of the record that it was fitted to."""


class DelayedRecord(msgspec.Struct, frozen=True, kw_only=True, tag_field="class", tag="DELAYED"):
    """Delayed heave: exact, and old."""

    time: str
    """UTC of validity."""
    mono_s: float
    heave_m: float
    std_m: float


class QuietRecord(
    msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag_field="class", tag="QUIET"
):
    """The next quiet window, once a second; without one, ``is_expected`` is false and its fields are absent."""

    time: str
    """UTC at which it was foreseen."""
    mono_s: float
    is_expected: bool
    start: str | None = None
    """UTC of its beginning."""
    start_s: float | None = None
    """The same, from ``time`` on."""
    length_s: float | None = None
    confidence: float | None = None
    """Probability that it is quiet for the time that was asked for."""
    best_confidence: float | None = None
    """Of the surest window within the look-ahead; absent while nothing has been learned."""


class RockStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """How the predictions of an axis for a horizon have fared over the last minutes."""

    axis: str
    horizon_s: float
    error_deg: float | None = None
    """RMS."""
    coverage: float | None = None
    """Share of the measured angles within their 95 % interval."""


class QuietStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """As the QUIET record has it."""

    is_expected: bool
    start_s: float | None = None
    length_s: float | None = None
    confidence: float | None = None
    best_confidence: float | None = None


class HeaveStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The last frame, so that a status line is complete even when no frame flows."""

    heave_m: float | None = None
    heave_std_m: float | None = None
    age_s: float | None = None
    """Age of the last frame when the status was made."""


class DeviceStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    name: str
    role: str
    up: bool
    link: str = ""
    rate_hz: float | None = None
    """Good samples a second, measured."""
    wanted_rate_hz: float | None = None
    results: dict[str, int] = {}
    """Polls since the start, counted by :class:`heaved.samples.Fault` value (``none`` is a good one)."""
    last_fault: str | None = None
    last_fault_age_s: float | None = None
    detail: str = ""
    """What is wrong and what to do, for a person."""


class ObserverStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    name: str
    """As ``[heave] observer`` has it."""
    frequencies_hz: tuple[float, ...] = ()
    """Centre frequencies of the sea model in use."""
    fit_age_s: float | None = None
    resets: int = 0


class CorrectionStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    state: CorrectionState
    runs: int = 0
    """Trainings finished since the start, of any result."""
    last_result: str | None = None
    age_s: float | None = None
    """Since the network in use was accepted."""


class HullStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The last HULL in short."""

    state: str
    z_deg: float | None = None
    std_arcsec: float | None = None
    """Of the worst axis."""
    warnings: tuple[str, ...] = ()
    resets: int = 0


class AttitudeStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The last ATTITUDE in short; without numbers before the first."""

    heave_m: float | None = None
    heave_std_m: float | None = None
    pitch_deg: float | None = None
    pitch_std_deg: float | None = None
    age_s: float | None = None
    cautions: tuple[str, ...] = ()
    resets: int = 0


class ClockStatus(msgspec.Struct, frozen=True, kw_only=True):
    utc_offset_s: float
    """UTC minus the monotonic clock."""
    steps: int = 0
    """Steps of the system's UTC since the start."""


class StatusRecord(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag_field="class", tag="STATUS"):
    """The daemon's state, for people, monitoring and the answer to ``?STATUS``. Not-finite numbers must be ``None``."""

    release: str
    uptime_s: float
    frames: int
    """Frames made since the start."""
    rate_hz: float | None = None
    """Frames a second, measured over the last seconds."""
    heave: HeaveStatus
    quality: QualityRecord
    devices: tuple[DeviceStatus, ...]
    clients: int
    dropped: int
    """Lines dropped for slow clients since the start, all clients together."""
    lead_s: float | None = None
    observer: ObserverStatus | None = None
    correction: CorrectionStatus | None = None
    hull: HullStatus | None = None
    """When [hull] is enabled."""
    attitude: AttitudeStatus | None = None
    """When [attitude] is enabled."""
    rock: tuple[RockStatus, ...] = ()
    """Of 150 ms and 1 s, where they are predicted."""
    quiet: QuietStatus | None = None
    clock: ClockStatus | None = None
    config_file: str | None = None
    state_file: str | None = None


_encoder = msgspec.json.Encoder()


def encode_record(record: msgspec.Struct) -> bytes:
    """One line of any record but MOTION. Not-finite numbers must have been left out: JSON has none (they would
    become ``null``).
    """
    return _encoder.encode(record) + b"\n"


def finite(value: float) -> float | None:
    """``value`` to the sixth decimal; None when it is not known (nan, infinite, absurd)."""
    millionths = value * 1e6
    return (millionths + _ROUND - _ROUND) / 1e6 if -_LIMIT < millionths < _LIMIT else None


def degrees(value_rad: float) -> float | None:
    """Degrees, to the sixth decimal, of an angle in radians; None when it is not known."""
    millionths = value_rad * _MICRO_PER_RADIAN
    return (millionths + _ROUND - _ROUND) / 1e6 if -_LIMIT < millionths < _LIMIT else None


def arcsec(value_rad: float) -> float | None:
    """Seconds of arc, to the thousandth, of an angle in radians; None when it is not known."""
    seconds = math.degrees(value_rad) * 3600.0
    return round(seconds, 3) if math.isfinite(seconds) else None


def iso_time(utc_s: float) -> str:
    """``2026-01-01T00:00:00.123456Z`` of seconds since 1970."""
    second, microsecond = divmod(round(utc_s * 1e6), 1_000_000)
    return f"{_iso_second(second)}.{microsecond:06d}Z"


@functools.lru_cache(maxsize=4)
def _iso_second(second: int) -> str:
    """Kept, because a hundred frames share it."""
    return datetime.fromtimestamp(second, UTC).strftime("%Y-%m-%dT%H:%M:%S")


def encode_motion(frame: MotionFrame, *, seq: int, utc_s: float, sent_mono_s: float, dropped: int = 0) -> bytes:
    """The MOTION line of ``frame``, which counts as sent at ``sent_mono_s`` (the clock of ``frame.t_s``)."""
    return motion_head(frame, seq=seq, utc_s=utc_s) + motion_tail(sent_mono_s - frame.t_s, dropped)


def motion_head(frame: MotionFrame, *, seq: int, utc_s: float) -> bytes:
    """The MOTION line of ``frame`` up to its tail. ``utc_s``: time of validity, seconds since 1970."""
    quality = frame.quality
    record = MotionRecord(
        seq=seq,
        time=iso_time(utc_s),
        mono_s=round(frame.t_s * 1e6) / 1e6,
        heave_m=finite(frame.heave_m),
        heave_std_m=finite(frame.heave_std_m),
        heave_velocity_mps=finite(frame.heave_velocity_mps),
        heave_acceleration_mps2=finite(frame.heave_acceleration_mps2),
        observer_m=finite(frame.observer_m),
        correction_m=finite(frame.correction_m),
        lead_s=finite(frame.lead_s),
        reference_m=finite(frame.reference_m),
        roll_deg=degrees(frame.roll_rad),
        pitch_deg=degrees(frame.pitch_rad),
        yaw_deg=degrees(frame.yaw_rad),
        crane_roll_deg=degrees(frame.crane_roll_rad),
        crane_pitch_deg=degrees(frame.crane_pitch_rad),
        crane_yaw_deg=degrees(frame.crane_yaw_rad),
        compensation_lead_s=frame.compensation_lead_s or None,
        points=tuple([_point(point) for point in frame.points]),
        rock=tuple([_rock(prediction) for prediction in frame.rock]),
        forecast=tuple([_forecast(forecast) for forecast in frame.forecast]),
        quality=QualityRecord(
            heave=quality.heave, laser=quality.laser, correction=quality.correction, reasons=quality.reasons
        ),
    )
    return _encoder.encode(record)[:-1]


def motion_tail(age_s: float, dropped: int) -> bytes:
    """What completes :func:`motion_head`: the age at sending and the frames lost just before."""
    return b',"age_s":%.6f,"dropped":%d}\n' % (age_s, dropped)


def _rock(prediction: RockPrediction) -> RockRecord:
    return RockRecord(
        horizon_s=prediction.horizon_s,
        roll_deg=degrees(prediction.roll_rad),
        pitch_deg=degrees(prediction.pitch_rad),
        yaw_deg=degrees(prediction.yaw_rad),
        roll_std_deg=degrees(prediction.roll_std_rad),
        pitch_std_deg=degrees(prediction.pitch_std_rad),
        yaw_std_deg=degrees(prediction.yaw_std_rad),
        roll_interval_deg=degrees(prediction.roll_interval_rad),
        pitch_interval_deg=degrees(prediction.pitch_interval_rad),
        yaw_interval_deg=degrees(prediction.yaw_interval_rad),
    )


def _point(point: PointMotion) -> PointRecord:
    return PointRecord(
        name=point.name, heave_m=finite(point.heave_m), heave_velocity_mps=finite(point.heave_velocity_mps)
    )


def sea_record(sea: SeaState, utc_s: float) -> SeaRecord:
    """``utc_s``: of ``sea.t_s``, seconds since 1970."""
    return SeaRecord(
        time=iso_time(utc_s),
        significant_height_m=round(sea.significant_height_m, 4),
        peak_period_s=round(sea.peak_period_s, 3),
        mean_period_s=round(sea.mean_period_s, 3),
        is_still=sea.is_still,
        systems=tuple(
            WaveSystemRecord(
                kind=system.kind,
                significant_height_m=round(system.significant_height_m, 4),
                peak_period_s=round(system.peak_period_s, 3),
            )
            for system in sea.systems
        ),
        frequencies_hz=tuple(round(f, 5) for f in sea.frequencies_hz),
        spectrum_m2phz=tuple(float(f"{s:.4g}") for s in sea.spectrum_m2phz),
        model=sea.model,
        window_s=round(sea.window_s, 3),
    )


def delayed_record(delayed: DelayedHeave, utc_s: float) -> DelayedRecord:
    """``utc_s``: of its own validity, seconds since 1970."""
    return DelayedRecord(
        time=iso_time(utc_s),
        mono_s=round(delayed.t_s * 1e6) / 1e6,
        heave_m=round(delayed.heave_m, 6),
        std_m=round(delayed.std_m, 6),
    )


def quiet_record(quiet: QuietForecast, utc_s: float) -> QuietRecord:
    """``utc_s``: of ``quiet.t_s``, seconds since 1970."""
    window = quiet.window
    return QuietRecord(
        time=iso_time(utc_s),
        mono_s=round(quiet.t_s * 1e6) / 1e6,
        is_expected=window is not None,
        start=iso_time(utc_s + window.start_s) if window is not None else None,
        start_s=window.start_s if window is not None else None,
        length_s=window.length_s if window is not None else None,
        confidence=finite(window.confidence) if window is not None else None,
        best_confidence=finite(quiet.best),
    )


def quiet_status(quiet: QuietForecast | None) -> QuietStatus | None:
    """The part of a QUIET record that a status shows; None: it is not asked for."""
    if quiet is None:
        return None
    record = quiet_record(quiet, 0.0)
    return QuietStatus(
        is_expected=record.is_expected,
        start_s=record.start_s,
        length_s=record.length_s,
        confidence=record.confidence,
        best_confidence=record.best_confidence,
    )


def rock_status(scores: tuple[RockScore, ...], horizons_s: tuple[float, ...]) -> tuple[RockStatus, ...]:
    """Of the horizons that are told apart on a screen."""
    return tuple(
        RockStatus(
            axis=score.axis,
            horizon_s=score.horizon_s,
            error_deg=degrees(score.error_rad),
            coverage=finite(score.coverage),
        )
        for score in scores
        if score.horizon_s in horizons_s
    )


def _forecast(forecast: HeaveForecast) -> ForecastRecord:
    return ForecastRecord(
        horizon_s=forecast.horizon_s, heave_m=finite(forecast.heave_m), std_m=finite(forecast.std_m)
    )


# --- what a client sends ---------------------------------------------------------------------------------------------


class Watch(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``?WATCH=``: which classes, and at most how many MOTION lines a second."""

    classes: tuple[StreamClass, ...] = ("MOTION",)
    rate_hz: float | None = None
    """None: every frame."""


class StatusQuery(msgspec.Struct, frozen=True):
    """``?STATUS``"""


class VersionQuery(msgspec.Struct, frozen=True):
    """``?VERSION``"""


class BadRequest(msgspec.Struct, frozen=True):
    """Anything else: what was wrong with it, and what is accepted."""

    message: str


Request = Watch | StatusQuery | VersionQuery | BadRequest

_watch_decoder = msgspec.json.Decoder(Watch)


def parse_request(line: bytes) -> Request:
    """What one line of a client (its line end may be on) asks for. Never raises, whatever the bytes."""
    if len(line) > MAX_REQUEST_BYTES:
        return BadRequest(f"line of {len(line)} bytes, at most {MAX_REQUEST_BYTES} are read; {ACCEPTED}")
    text = line.strip()
    if text == b"?STATUS":
        return StatusQuery()
    if text == b"?VERSION":
        return VersionQuery()
    if text.startswith(b"?WATCH="):
        return _parse_watch(text[len(b"?WATCH=") :])
    shown = text[:40].decode("utf-8", "backslashreplace")
    return BadRequest(f"not understood: {shown!r}; {ACCEPTED}")


def _parse_watch(text: bytes) -> Watch | BadRequest:
    try:
        watch = _watch_decoder.decode(text)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        return BadRequest(f"?WATCH: {error}; classes are {', '.join(STREAM_CLASSES)}; {ACCEPTED}")
    if watch.rate_hz is not None and not 0.0 < watch.rate_hz < math.inf:
        return BadRequest(f"?WATCH: rate_hz is {watch.rate_hz}, it must be above 0; {ACCEPTED}")
    return watch


class LineSplitter:
    """Cuts the bytes of a client into lines, whatever the pieces they arrive in, in bounded memory.

    Attributes:
        overflow: a line longer than MAX_REQUEST_BYTES has begun: nothing further can be read from this client.
    """

    def __init__(self) -> None:
        self.overflow = False
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that ``data`` completes, in order, without their line ends."""
        if self.overflow:
            return []
        *lines, rest = (self._rest + data).split(b"\n")
        for index, line in enumerate(lines):
            if len(line) >= MAX_REQUEST_BYTES:
                self.overflow, self._rest = True, b""
                return lines[:index]
        self.overflow = len(rest) >= MAX_REQUEST_BYTES
        self._rest = b"" if self.overflow else rest
        return lines


# --- what a client reads ---------------------------------------------------------------------------------------------


def decode(line: bytes) -> dict[str, Any]:
    """One line of the stream as a dictionary.

    Raises:
        ValueError: the line is not a JSON object with a ``class`` of text.
    """
    try:
        record = msgspec.json.decode(line, type=dict[str, Any])
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"not a line of the stream ({error}): {line[:60]!r}") from error
    if not isinstance(record.get("class"), str):
        raise ValueError(f"not a line of the stream (no class): {line[:60]!r}")
    return record
