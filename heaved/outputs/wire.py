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

from heaved.outputs import fields
from heaved.outputs.fields import rounded
from heaved.outputs.records import (
    AngleAgreementRecord,
    AttitudeRecord,
    DelayedRecord,
    ForecastRecord,
    HeaveAgreementRecord,
    HullRecord,
    MotionRecord,
    PointRecord,
    QuietRecord,
    QuietStatus,
    ReferenceRecord,
    ReferenceStatus,
    RockRecord,
    RockStatus,
    SeaRecord,
    VelocityAgreementRecord,
    WaveSystemRecord,
)
from heaved.samples import (
    CraftMotion,
    DelayedHeave,
    HullAngles,
    MotionFrame,
    MruComparison,
    QuietForecast,
    RockScore,
    SeaState,
    Vibration,
)

REFERENCE_OLD_S: Final = 10.0
"""A reference MRU that has said nothing for so long is not beside ours any more."""

_encoder = msgspec.json.Encoder()
_motion_record = fields.MOTION.into(
    MotionRecord,
    "quality",
    given=("seq", "time", "mono_s", "compensation_lead_s", "points", "rock", "forecast"),
)
"""All but its tail."""
_point_record = fields.POINT.into(PointRecord, "name", "state", "reasons", given=("forecast",))
_rock_record = fields.ROCK.into(RockRecord, "horizon_s")
_forecast_record = fields.FORECAST.into(ForecastRecord, "horizon_s")


def encode_record(record: msgspec.Struct) -> bytes:
    """One line of any record but MOTION. Not-finite numbers must have been left out: JSON has none (they would
    become ``null``).
    """
    return _encoder.encode(record) + b"\n"


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
    record = _motion_record(
        frame,
        seq=seq,
        time=iso_time(utc_s),
        mono_s=_micro(frame.t_s),
        compensation_lead_s=frame.compensation_lead_s or None,
        points=tuple(
            [
                _point_record(point, forecast=tuple([_forecast_record(one) for one in point.forecast]))
                for point in frame.points
            ]
        ),
        rock=tuple([_rock_record(one) for one in frame.rock]),
        forecast=tuple([_forecast_record(one) for one in frame.forecast]),
    )
    return _encoder.encode(record)[:-1]


def motion_tail(age_s: float, dropped: int) -> bytes:
    """What completes :func:`motion_head`: the age at sending and the frames lost just before."""
    return b',"age_s":%.6f,"dropped":%d}\n' % (age_s, dropped)


def _micro(t_s: float) -> float:
    """A time to the microsecond."""
    return round(t_s * 1e6) / 1e6


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
    return DelayedRecord(time=iso_time(utc_s), mono_s=_micro(delayed.t_s), **fields.DELAYED.known(delayed))


def quiet_record(quiet: QuietForecast, utc_s: float) -> QuietRecord:
    """``utc_s``: of ``quiet.t_s``, seconds since 1970."""
    window = quiet.window
    return QuietRecord(
        time=iso_time(utc_s),
        mono_s=_micro(quiet.t_s),
        is_expected=window is not None,
        start=iso_time(utc_s + window.start_s) if window is not None else None,
        start_s=window.start_s if window is not None else None,
        length_s=window.length_s if window is not None else None,
        confidence=rounded(window.confidence) if window is not None else None,
        best_confidence=rounded(quiet.best),
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
            **fields.ROCK_SCORE.known(score),
        )
        for score in scores
        if score.horizon_s in horizons_s
    )


def hull_record(hull: HullAngles, utc_s: float) -> HullRecord:
    """``utc_s``: of its own validity, seconds since 1970."""
    return HullRecord(
        time=iso_time(utc_s),
        mono_s=_micro(hull.t_s),
        state=hull.state,
        **fields.HULL.known(hull),
        **fields.HULL_STD.known(hull),
        refits=hull.refits,
        resets=hull.resets,
        warnings=hull.warnings,
    )


def attitude_record(motion: CraftMotion, utc_s: float) -> AttitudeRecord:
    """``utc_s``: of its own validity, seconds since 1970."""
    return AttitudeRecord(
        time=iso_time(utc_s),
        mono_s=_micro(motion.t_s),
        **fields.ATTITUDE.known(motion),
        probabilities=tuple([round(p, 6) for p in motion.probabilities]),
        switches=motion.switches,
        resets=motion.resets,
        cautions=motion.cautions,
    )


def reference_record(compared: MruComparison, utc_s: float) -> ReferenceRecord:
    """``utc_s``: of its own validity, seconds since 1970."""
    heave, velocity = fields.MRU_HEAVE.known(compared.heave), fields.MRU_VELOCITY.known(compared.heave_velocity)
    roll, pitch, yaw = (fields.MRU_ANGLE.known(one) for one in (compared.roll, compared.pitch, compared.yaw))
    return ReferenceRecord(
        time=iso_time(utc_s),
        mono_s=_micro(compared.t_s),
        heave=HeaveAgreementRecord(**heave) if heave else None,
        heave_velocity=VelocityAgreementRecord(**velocity) if velocity else None,
        roll=AngleAgreementRecord(**roll) if roll else None,
        pitch=AngleAgreementRecord(**pitch) if pitch else None,
        yaw=AngleAgreementRecord(**yaw) if yaw else None,
        compared_s=rounded(compared.compared_s),
        warnings=compared.warnings,
    )


def reference_status(compared: MruComparison | None, now_s: float) -> ReferenceStatus:
    """The part of a REFERENCE record that a status shows, its age alone once that is great; None: nothing has been
    compared yet.
    """
    if compared is None:
        return ReferenceStatus()
    if now_s - compared.t_s > REFERENCE_OLD_S:
        return ReferenceStatus(age_s=rounded(now_s - compared.t_s))
    record = reference_record(compared, 0.0)
    heave = record.heave or HeaveAgreementRecord()
    roll, pitch = record.roll or AngleAgreementRecord(), record.pitch or AngleAgreementRecord()
    return ReferenceStatus(
        heave_difference_m=heave.difference_m,
        heave_std_difference_m=heave.std_difference_m,
        heave_explained_m=heave.explained_m,
        heave_correlation=heave.correlation,
        heave_delay_s=heave.delay_s,
        heave_scale=heave.scale,
        roll_mean_difference_deg=roll.mean_difference_deg,
        roll_std_difference_deg=roll.std_difference_deg,
        pitch_mean_difference_deg=pitch.mean_difference_deg,
        pitch_std_difference_deg=pitch.std_difference_deg,
        compared_s=record.compared_s,
        age_s=rounded(now_s - compared.t_s),
        warnings=compared.warnings,
    )


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
