"""The daemon's state as the STATUS record of the stream and as the one line that ``systemctl status`` shows."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Final

from heaved import __version__
from heaved.outputs import wire
from heaved.outputs.fields import ATTITUDE, HULL, HULL_STD, MOTION, rounded
from heaved.outputs.records import (
    AttitudeStatus,
    ClockStatus,
    CorrectionStatus,
    DeviceStatus,
    HeaveStatus,
    HullStatus,
    LaserStatus,
    ObserverStatus,
    OutputStatus,
    ReferenceStatus,
    StatusRecord,
)
from heaved.samples import CorrectionState, Fault, HeaveState, LaserState, MotionFrame, Quality, SeaState

if TYPE_CHECKING:
    from collections.abc import Iterable

    from heaved.config import Config
    from heaved.daemon.acquisition import Acquisition
    from heaved.daemon.utc_clock import UtcClock
    from heaved.outputs.output import OutputHealth
    from heaved.pipeline import PipelineSummary

_SHOWN_S: Final = (0.15, 1.0)
"""Horizons whose predictions the status judges."""
_HEAVE: Final = MOTION.only("heave_m", "heave_std_m")
_ATTITUDE: Final = ATTITUDE.only("heave_m", "heave_std_m", "pitch_deg", "pitch_std_deg")
_HULL_STD: Final = HULL_STD.only("x_std_arcsec", "y_std_arcsec", "z_std_arcsec")
_NO_QUALITY: Final = Quality(
    heave=HeaveState.INVALID, laser=LaserState.OFF, correction=CorrectionState.OFF, reasons=("no frame yet",)
)


def status_record(
    acquisition: Acquisition,
    config: Config,
    *,
    now_s: float,
    started_s: float,
    utc: UtcClock,
    outputs: Iterable[OutputHealth],
    clients: int,
    dropped: int,
    config_file: str | None,
    state_file: str | None,
) -> StatusRecord:
    """All that is known of the daemon at ``now_s`` (monotonic, as ``started_s``)."""
    frame = acquisition.last_frame
    summary = acquisition.pipeline.summary()
    return StatusRecord(
        release=__version__,
        uptime_s=round(now_s - started_s, 3),
        frames=acquisition.frames,
        rate_hz=rounded(acquisition.rate_hz(now_s)),
        heave=_heave(frame, now_s),
        quality=_NO_QUALITY if frame is None else frame.quality,
        devices=_devices(acquisition, config, now_s),
        outputs=tuple([_output(health) for health in outputs]),
        clients=clients,
        dropped=dropped,
        lead_s=rounded(summary.lead_s),
        observer=_observer(acquisition, summary, config, frame.sea if frame is not None else None, now_s),
        correction=_correction(acquisition, summary, frame, now_s),
        laser=_laser(summary) if config.has_laser else None,
        hull=_hull(frame) if config.hull.enabled else None,
        attitude=_attitude(frame, now_s) if config.attitude.enabled else None,
        reference_mru=_reference(frame, now_s)
        if any(device.role == "reference_mru" for device in config.device)
        else None,
        rock=wire.rock_status(acquisition.rock_scores(), _SHOWN_S),
        quiet=wire.quiet_status(frame.quiet) if frame is not None else None,
        clock=ClockStatus(utc_offset_s=round(utc.offset_s, 6), steps=utc.steps),
        config_file=config_file,
        state_file=state_file,
    )


def status_line(record: StatusRecord) -> str:
    """``heave valid +0.12 m ± 0.03 m, 100.0 Hz, 2 clients, imu up, laser down (timeout), output plc down``"""
    parts = [f"heave {record.quality.heave.value}"]
    if record.heave.heave_m is not None:
        parts[0] += f" {record.heave.heave_m:+.2f} m"
    if record.heave.heave_std_m is not None:
        parts[0] += f" ± {record.heave.heave_std_m:.2f} m"
    parts.append(f"{record.rate_hz or 0.0:.1f} Hz")
    parts.append(f"{record.clients} client{'' if record.clients == 1 else 's'}")
    parts += [
        f"{device.name} up" if device.up else f"{device.name} down ({device.last_fault or 'not polled yet'})"
        for device in record.devices
    ]
    if not record.devices:
        parts.append("no devices configured")
    parts += [f"output {output.name} down" for output in record.outputs if not output.up]
    if record.reference_mru is not None and record.reference_mru.warnings:
        parts.append("reference MRU differs")
    return ", ".join(parts)


def _heave(frame: MotionFrame | None, now_s: float) -> HeaveStatus:
    if frame is None:
        return HeaveStatus()
    return HeaveStatus(
        **_HEAVE.known(frame),
        age_s=rounded(now_s - frame.t_s),
    )


def _observer(
    acquisition: Acquisition, summary: PipelineSummary, config: Config, sea: SeaState | None, now_s: float
) -> ObserverStatus:
    """``sea``: as it was fitted last, with what the accelerometer has shown beside it."""
    told = summary.roll_pitch
    return ObserverStatus(
        name=config.heave.observer,
        frequencies_hz=tuple(round(frequency_hz, 5) for frequency_hz in summary.frequencies_hz),
        fit_age_s=rounded(now_s - sea.t_s) if sea is not None else None,
        resets=sum(count for (name, _), count in acquisition.pipeline.resets.items() if name == "heave"),
        vibration=wire.vibration_record(sea.vibration) if sea is not None else (),
        noise_mps2_rthz=wire.density(sea.noise_mps2_rthz) if sea is not None else None,
        bias_walk_mps2_rts=wire.density(sea.bias_walk_mps2_rts) if sea is not None else None,
        roll_pitch_coherence=rounded(round(told.coherence, 2)),
        roll_pitch_weight=rounded(round(told.weight, 2)) if isfinite(told.coherence) else None,
    )


def _laser(summary: PipelineSummary) -> LaserStatus:
    place = summary.laser_place
    return LaserStatus(
        is_elsewhere=place.is_elsewhere,
        ahead_m=rounded(place.ahead_m),
        ahead_std_m=rounded(place.ahead_std_m),
        port_m=rounded(place.port_m),
        port_std_m=rounded(place.port_std_m),
    )


def _hull(frame: MotionFrame | None) -> HullStatus:
    if frame is None or frame.hull is None:
        return HullStatus(state="no rates of both IMUs yet")
    hull = frame.hull
    return HullStatus(
        state=hull.state,
        z_deg=HULL.known(hull).get("z_deg"),
        std_arcsec=max(_HULL_STD.known(hull).values(), default=None),
        warnings=hull.warnings,
        resets=hull.resets,
    )


def _attitude(frame: MotionFrame | None, now_s: float) -> AttitudeStatus:
    if frame is None or frame.attitude is None:
        return AttitudeStatus()
    motion = frame.attitude
    return AttitudeStatus(
        **_ATTITUDE.known(motion),
        age_s=rounded(now_s - motion.t_s),
        cautions=motion.cautions,
        resets=motion.resets,
    )


def _reference(frame: MotionFrame | None, now_s: float) -> ReferenceStatus:
    return wire.reference_status(None if frame is None else frame.reference_mru, now_s)


def _devices(acquisition: Acquisition, config: Config, now_s: float) -> tuple[DeviceStatus, ...]:
    devices = []
    for spec in config.device:
        health = acquisition.health[spec.name]
        devices.append(
            DeviceStatus(
                name=spec.name,
                role=spec.role,
                up=health.up,
                link=spec.link,
                rate_hz=rounded(health.rate_hz(now_s)),
                wanted_rate_hz=spec.rate_hz,
                results={fault.value: health.results[fault] for fault in Fault if health.results[fault]},
                last_fault=health.last_fault.value if health.last_fault else None,
                last_fault_age_s=rounded(now_s - health.last_fault_s),
                detail="" if health.up else health.detail,
            )
        )
    return tuple(devices)


def _output(health: OutputHealth) -> OutputStatus:
    return OutputStatus(
        name=health.name,
        kind=health.kind,
        link=health.where,
        up=health.is_up,
        sent=health.sent,
        lost=dict(health.lost),
        detail=health.detail,
    )


def _correction(
    acquisition: Acquisition, summary: PipelineSummary, frame: MotionFrame | None, now_s: float
) -> CorrectionStatus:
    age_s = now_s - acquisition.accepted_s
    return CorrectionStatus(
        state=frame.quality.correction if frame else CorrectionState.OFF,
        runs=acquisition.trainings,
        last_result=acquisition.last_training or None,
        age_s=round(age_s, 3) if isfinite(age_s) else None,
        nothing_to_learn=summary.windows_with_nothing_to_learn,
    )
