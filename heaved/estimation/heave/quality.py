"""What a consumer may believe: the state of the heave and the reasons, from facts that the pipeline collects."""

from __future__ import annotations

from math import isfinite
from typing import Final

import msgspec

from heaved.estimation.imu.conditioning import NOTHING, Notes
from heaved.samples import Fault, HeaveState

BEYOND_PHYSICS: Final = "estimate beyond what a vessel does: withheld"


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What is set by us, not by the user."""

    coast_s: float = 1.0
    """Without samples for this long the heave is no longer worth publishing: half a second is nearly free, two are
    not."""
    missing_s: float = 0.1
    """Without samples for this long (and for at least two periods) the frame says so."""
    broad_sea: float = 0.2
    """Share of the heave's own standard deviation above which the model does not fit the sea."""
    useless: float = 0.5
    """The same from which nothing is known that is worth sending."""
    small_m: float = 0.01
    """Errors below this are well whatever the sea: a still ship has no heave to compare with."""
    still_m: float = 0.05
    """The same where the ship is still: what it does not see is then all of the heave."""
    useless_small: float = 2.5
    """Of what is small, so much is never useless."""
    disagreement: float = 3.0
    """The laser shows this many times the modelled error."""
    good_rate_hz: float = 4.0
    """A slower sensor loses the short waves, and their forecasts: it says so,"""
    least_rate_hz: float = 1.6
    """and one slower than this does not show the band that is fitted (0.8 Hz) at all."""
    seen: float = 0.7
    """Share of the Nyquist frequency up to which waves are seen."""
    many_missing: float = 0.25
    """Share of lost samples from which the line, not the sea, is what to look at."""


TUNING: Final = Tuning()


class Facts(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """What is known about one moment."""

    imu_fault: Fault
    since_sample_s: float
    """Since the last good IMU sample; nan: there never was one."""
    period_s: float
    """Usual interval of the IMU samples; nan: not known yet."""
    settled_s: float
    """Length of the observer's record; nan: none."""
    needed_s: float
    """Length from which it counts as settled."""
    error_std_m: float
    heave_std_m: float
    missing: float
    """Share of the samples that were lost in the last minute."""
    doubts: tuple[str, ...]
    """What the observer itself holds against its output."""
    notes: tuple[str, ...]
    """What people should know, and no reason to trust it less."""
    is_still: bool
    """The observer sees no motion above the noise of the sensor."""
    remarks: tuple[str, ...]
    """What people should know of the laser: the heave does without it."""
    tilt_removed: bool
    std_scale: float
    laser_fault: Fault
    laser_configured: bool
    laser_fresh: bool
    imu: Notes = NOTHING
    """What is held against the IMU."""
    withheld: str = ""
    """Why accelerations that are there are not taken."""
    is_beyond_physics: bool = False
    is_recovering: bool = False
    """From tilt that was not removed."""


def judge(facts: Facts) -> tuple[HeaveState, tuple[str, ...]]:
    """State and reasons; the reasons are for people and name what to look at."""
    state, reasons = _judge_heave(facts)
    imu = facts.imu
    if facts.withheld:
        reasons = (facts.withheld, *reasons)
    if imu.unusable or facts.is_beyond_physics:
        state = HeaveState.INVALID
        reasons = (imu.unusable or BEYOND_PHYSICS, *reasons)
    elif imu.signs:
        # Waves can do that to a vessel that leans less than they do. But if the heave is in doubt besides, it is
        # that: gravity is not taken out, but put in twice. And so it is until it has been found out.
        is_usable = state is HeaveState.VALID and not imu.are_signs_open
        state = HeaveState.DEGRADED if is_usable else HeaveState.INVALID
        reasons = (imu.signs, *reasons)
    if facts.is_recovering:
        state = HeaveState.DEGRADED if state is HeaveState.VALID else state
        reasons = (*reasons, "recovering: the tilt was not removed")
    return state, (*reasons, *imu.remarks) if imu.remarks else reasons


def _judge_heave(facts: Facts) -> tuple[HeaveState, tuple[str, ...]]:
    """The same as far as observer, line and laser say it."""
    reasons: list[str] = []
    f, t = facts, TUNING
    state = HeaveState.VALID
    if f.laser_configured and not f.laser_fresh:
        what = f.laser_fault.value if f.laser_fault is not Fault.NONE else "no fresh reference"
        reasons.append(f"laser: {what}")
    reasons += f.remarks
    if not isfinite(f.since_sample_s) or f.since_sample_s > t.coast_s:
        what = f.imu_fault.value if f.imu_fault is not Fault.NONE else "no samples"
        return HeaveState.INVALID, (f"imu: {what}", *reasons)
    if f.period_s * t.least_rate_hz > 1.0:
        return HeaveState.INVALID, (f"imu: samples {f.period_s:.1f} s apart do not show waves", *reasons)
    if not isfinite(f.error_std_m):
        return HeaveState.SETTLING, (f"settling: {max(0.0, f.settled_s):.0f} s of {f.needed_s:.0f} s", *reasons)
    if f.settled_s < f.needed_s:
        state = HeaveState.SETTLING
        reasons.insert(0, f"settling: {f.settled_s:.0f} s of {f.needed_s:.0f} s")
    degraded = []
    if f.since_sample_s > t.missing_s and not (isfinite(f.period_s) and f.since_sample_s <= 2.0 * f.period_s):
        what = f.imu_fault.value if f.imu_fault is not Fault.NONE else "samples missing"
        degraded.append(f"imu: {what}, extrapolated")
    if not f.tilt_removed:
        degraded.append("no attitude or no horizontal acceleration: tilt not removed")
    if f.period_s * t.good_rate_hz > 1.0:
        shortest_s = 2.0 * f.period_s / t.seen
        degraded.append(f"imu: {1.0 / f.period_s:.1f} samples a second: waves shorter than {shortest_s:.1f} s are lost")
    if f.missing > t.many_missing:
        degraded.append(f"imu: {100.0 * f.missing:.0f} % of the samples missing")
    degraded += f.doubts
    small_m = t.still_m if f.is_still else t.small_m
    limit_m = max(t.broad_sea * f.heave_std_m, small_m)
    useless_m = max(t.useless * f.heave_std_m, t.useless_small * small_m) * max(f.std_scale, 1.0)
    if f.error_std_m > useless_m and state is not HeaveState.SETTLING:
        return HeaveState.INVALID, ("error above half of the heave", *degraded, *f.notes, *reasons)
    if f.error_std_m > limit_m * max(f.std_scale, 1.0):
        degraded.append("error above a fifth of the heave")
    elif f.error_std_m > limit_m or f.std_scale > t.disagreement:
        degraded.append("laser and observer disagree")
    if degraded and state is HeaveState.VALID:
        state = HeaveState.DEGRADED
    return state, (*degraded, *f.notes, *reasons)
