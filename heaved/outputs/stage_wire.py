"""HULL and ATTITUDE lines of the stream: what the stages beside the heave have to say. Pure, as :mod:`wire`."""

from __future__ import annotations

import math

import msgspec

from heaved.outputs import wire
from heaved.samples import CraftMotion, HullAngles


class HullRecord(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag_field="class", tag="HULL"):
    """Deformation between the IMUs amidships and at the crane base: ``v_local = R3(z) R2(y) R1(x) v_midships``."""

    time: str
    """UTC of validity."""
    mono_s: float
    state: str
    """"starting", "converging", "converged", "weak" or "holding"."""
    x_deg: float | None = None
    """Total: static, mounting and flexure."""
    y_deg: float | None = None
    z_deg: float | None = None
    static_x_deg: float | None = None
    static_y_deg: float | None = None
    static_z_deg: float | None = None
    dynamic_x_deg: float | None = None
    """Flexure about the hull's axes."""
    dynamic_y_deg: float | None = None
    dynamic_z_deg: float | None = None
    x_std_arcsec: float | None = None
    """Of the total, about the hull's axes."""
    y_std_arcsec: float | None = None
    z_std_arcsec: float | None = None
    x_reachable_std_arcsec: float | None = None
    """What the motion at hand would give in the end; absent: nothing."""
    y_reachable_std_arcsec: float | None = None
    z_reachable_std_arcsec: float | None = None
    delay_s: float | None = None
    """By which the second IMU is late, its configured latency included already."""
    delay_std_s: float | None = None
    refits: int
    resets: int
    warnings: tuple[str, ...] = ()


class AttitudeRecord(msgspec.Struct, frozen=True, kw_only=True, tag_field="class", tag="ATTITUDE"):
    """Fused heave (about the trim, up) and pitch (bow up) of a craft."""

    time: str
    """UTC of validity."""
    mono_s: float
    heave_m: float
    heave_std_m: float
    heave_velocity_mps: float
    heave_velocity_std_mps: float
    pitch_deg: float
    pitch_std_deg: float
    pitch_rate_degps: float
    pitch_rate_std_degps: float
    probabilities: tuple[float, ...]
    """Of the filters."""
    switches: int
    resets: int
    cautions: tuple[str, ...]


def hull_record(hull: HullAngles, utc_s: float) -> HullRecord:
    """``utc_s``: of its own validity, seconds since 1970."""
    x, y, z = map(wire.degrees, hull.total_rad)
    static_x, static_y, static_z = map(wire.degrees, hull.static_rad)
    dynamic_x, dynamic_y, dynamic_z = map(wire.degrees, hull.dynamic_rad)
    x_std, y_std, z_std = map(wire.arcsec, hull.std_rad)
    x_reachable, y_reachable, z_reachable = map(wire.arcsec, hull.reachable_std_rad)
    return HullRecord(
        time=wire.iso_time(utc_s),
        mono_s=round(hull.t_s * 1e6) / 1e6,
        state=hull.state,
        x_deg=x,
        y_deg=y,
        z_deg=z,
        static_x_deg=static_x,
        static_y_deg=static_y,
        static_z_deg=static_z,
        dynamic_x_deg=dynamic_x,
        dynamic_y_deg=dynamic_y,
        dynamic_z_deg=dynamic_z,
        x_std_arcsec=x_std,
        y_std_arcsec=y_std,
        z_std_arcsec=z_std,
        x_reachable_std_arcsec=x_reachable,
        y_reachable_std_arcsec=y_reachable,
        z_reachable_std_arcsec=z_reachable,
        delay_s=wire.finite(hull.delay_s),
        delay_std_s=wire.finite(hull.delay_std_s),
        refits=hull.refits,
        resets=hull.resets,
        warnings=hull.warnings,
    )


def attitude_record(motion: CraftMotion, utc_s: float) -> AttitudeRecord:
    """``utc_s``: of its own validity, seconds since 1970."""
    return AttitudeRecord(
        time=wire.iso_time(utc_s),
        mono_s=round(motion.t_s * 1e6) / 1e6,
        heave_m=round(motion.heave_m, 6),
        heave_std_m=round(motion.heave_std_m, 6),
        heave_velocity_mps=round(motion.heave_velocity_mps, 6),
        heave_velocity_std_mps=round(motion.heave_velocity_std_mps, 6),
        pitch_deg=round(math.degrees(motion.pitch_rad), 6),
        pitch_std_deg=round(math.degrees(motion.pitch_std_rad), 6),
        pitch_rate_degps=round(math.degrees(motion.pitch_rate_radps), 6),
        pitch_rate_std_degps=round(math.degrees(motion.pitch_rate_std_radps), 6),
        probabilities=tuple([round(p, 6) for p in motion.probabilities]),
        switches=motion.switches,
        resets=motion.resets,
        cautions=motion.cautions,
    )
