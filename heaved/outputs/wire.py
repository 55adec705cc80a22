"""Lines of the stream from what the estimators say, and back. Pure: bytes and times are arguments, there is no socket
and no clock here.

One object of JSON per line, UTF-8; its fields are those of :mod:`heaved.outputs.records`.

A MOTION line is encoded once for all clients. Only its tail, ``age_s`` and ``dropped``, belongs to one client at one
moment, so it is put on when the line is handed to that client's socket: see :func:`motion_head`, :func:`motion_tail`.
"""

from __future__ import annotations

import functools
import math
from datetime import UTC, datetime
from typing import Any, Final

import msgspec

from heaved.outputs.records import (
    DelayedRecord,
    ForecastRecord,
    MotionRecord,
    PointRecord,
    QualityRecord,
    QuietRecord,
    QuietStatus,
    RockRecord,
    RockStatus,
    SeaRecord,
    WaveSystemRecord,
)
from heaved.samples import (
    DelayedHeave,
    HeaveForecast,
    MotionFrame,
    PointMotion,
    QuietForecast,
    RockPrediction,
    RockScore,
    SeaState,
    Vibration,
)

_MICRO_PER_RADIAN: Final = 1e6 * 180.0 / math.pi
_LIMIT: Final = 1e15
"""Millionths. Nothing that is published comes near it: what is beyond is as unknown as infinity."""
_ROUND: Final = 1.5 * 2.0**52
"""Adding it to a double below 2**51 and taking it away again rounds to a whole number: a third of the time of round(),
which matters for the sixty numbers of a frame."""

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
        name=point.name,
        heave_m=finite(point.heave_m),
        heave_std_m=finite(point.heave_std_m),
        heave_velocity_mps=finite(point.heave_velocity_mps),
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
        vibration=vibration_record(sea.vibration),
        noise_mps2_rthz=density(sea.noise_mps2_rthz),
        bias_walk_mps2_rts=density(sea.bias_walk_mps2_rts),
    )


def vibration_record(vibration: tuple[Vibration, ...]) -> tuple[Vibration, ...]:
    """The same, to a millihertz and a tenth of a mm/s2."""
    return tuple(
        Vibration(
            frequency_hz=round(one.frequency_hz, 3), width_hz=round(one.width_hz, 3), rms_mps2=round(one.rms_mps2, 4)
        )
        for one in vibration
    )


def density(value: float) -> float | None:
    """A density of noise to three digits, since it may be of any size; None when it is not known."""
    return float(f"{value:.3g}") if math.isfinite(value) else None


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
    return ForecastRecord(horizon_s=forecast.horizon_s, heave_m=finite(forecast.heave_m), std_m=finite(forecast.std_m))


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
