"""Where the laser is and which way it counts, from the vessel's own motion.

The readings are regressed on heave, roll and pitch by :mod:`heaved.estimation.heave.laser.geometry`; these come from
the IMU alone, of the whole record at once and so without any lag: the angles from the gyroscopes where there are any,
for an attitude sensor that leans into sway does so in step with the waves, and makes metres of lever arm of it; the
heave by integrating the vertical acceleration twice, without what is slower than waves.

**Limit.** Five minutes of a sea of 1.9 m, which rolls and pitches a vessel by 0.4 degrees, show the foot of the beam to
0.05 to 0.1 m with accelerometers of 1e-3 m/s2/sqrt(Hz), and to 0.1 to 0.2 m with noise twice and bias wander five times
as large; a lever arm of a decimetre is less than a millimetre there. Accelerometers that are crooked by one degree
against the angles put sway into the heave, in step with the waves: another 0.1 to 0.3 m that no standard error shows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.laser.geometry import Geometry, GeometryFit, fit_geometry
from heaved.samples import GRAVITY_MPS2
from heaved.setup.calibrate_record import Record, in_vessel_axes, means

if TYPE_CHECKING:
    from heaved.devices.mounting import Vector

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """How the record is looked at."""

    rate_hz: float = 20.0
    """No wave needs more."""
    least_s: float = 120.0
    hole_s: float = 1.0
    """Longer without a sample nobody knows how it has moved: the record is taken in pieces, none shorter than that."""
    slow_hz: float = 0.03
    """Corner below which nothing is integrated, for noise of the accelerometers grows with the square,"""
    steepness: int = 16
    """and how it falls off: 1 / (1 + (corner / f)^16). A swell of 20 s loses 0.03 %."""
    end_s: float = 30.0
    """At either end of the record what came before it, or after it, is missing. Not used."""
    slower: float = 0.5
    """What is slower than the waves by that, in what the regression leaves over, is no lever arm but what the
    accelerometers have wandered: it is taken out, and the rest fitted again,"""
    rounds: int = 4
    """until hardly anything changes: by as much as the waves have of what is slow, a hundredth, each time."""
    latest_s: float = 0.5
    """A lag that is greater is none."""
    wander_hz: float = 4.0
    good_m: float = 0.1
    """Standard error of the foot of the beam up to which it is known."""


TUNING: Final = Tuning()
WITHOUT_RATES: Final = 5
"""Columns of forces and angles."""


class LaserError(Exception):
    """A record that does not tell it; the message says why and what to do."""


class Motion(msgspec.Struct, frozen=True, eq=False):
    """Of the IMU, in the axes of the vessel, (n,) each at even times."""

    t_s: Array
    heave_m: Array
    velocity_mps: Array
    roll_rad: Array
    pitch_rad: Array


def motion_of(record: Record, *, rotation_deg: Vector, bias_mps2: Vector, attitude_late_s: float) -> Motion:
    """What a record shows of the motion of a vessel on which its sensor is mounted so.

    Raises:
        LaserError: nothing.
    """
    if not record.has_force or not record.has_attitude:
        raise LaserError("without the three accelerations, roll and pitch there is no heave to hold readings against")
    vessel = in_vessel_axes(record, rotation_deg, bias_mps2)
    columns = np.column_stack((vessel.force_mps2, vessel.angles_rad[:, :2]))
    if record.has_rates:
        columns = np.column_stack((columns, vessel.rates_radps))
    good = np.isfinite(columns).all(axis=1)
    t_s, columns = vessel.t_s[good], columns[good]
    ends = np.flatnonzero(np.diff(t_s) > TUNING.hole_s) + 1
    parts = [
        _piece(t_s[part], columns[part], attitude_late_s)
        for part in np.split(np.arange(len(t_s)), ends)
        if len(part) > 1 and t_s[part[-1]] - t_s[part[0]] >= TUNING.least_s
    ]
    if not parts:
        raise LaserError(
            f"there are no {TUNING.least_s:.0f} s without a hole in the record: make a longer one, better 300 s"
        )
    return Motion(*(np.concatenate([getattr(one, name) for one in parts]) for name in Motion.__struct_fields__))


def _piece(t_s: Array, columns: Array, attitude_late_s: float) -> Motion:
    t_s, rows = means(t_s, columns, TUNING.rate_hz)
    step_s = 1.0 / TUNING.rate_hz
    # What the angles show is so much older.
    roll, pitch = (np.interp(t_s + attitude_late_s, t_s, rows[:, i]) for i in (3, 4))
    if rows.shape[1] > WITHOUT_RATES:
        gx, gy, gz = rows[:, WITHOUT_RATES:].T
        across, along = gy * np.sin(roll) + gz * np.cos(roll), gy * np.cos(roll) - gz * np.sin(roll)
        turned = (gx - across * np.tan(pitch), -along)
        roll, pitch = (
            angle + _integrated(rate - np.gradient(angle, step_s), step_s, 1)
            for angle, rate in zip((roll, pitch), turned, strict=True)
        )
    up = np.sin(pitch) * rows[:, 0] + np.cos(pitch) * (np.sin(roll) * rows[:, 1] + np.cos(roll) * rows[:, 2])
    up = up - GRAVITY_MPS2
    inner = slice(round(TUNING.end_s / step_s), len(t_s) - round(TUNING.end_s / step_s))
    heave, velocity = _integrated(up, step_s, 2), _integrated(up, step_s, 1)
    return Motion(t_s[inner], heave[inner], velocity[inner], roll[inner], pitch[inner])


def geometry_of(record: Record, motion: Motion, start: Geometry) -> GeometryFit:
    """What the readings of a record say of their gauge, thought to be at ``start``.

    Raises:
        LaserError: nothing.
    """
    seen = np.isfinite(record.laser_m)
    t_s, reading_m = record.laser_t_s[seen], record.laser_m[seen]
    # Not in a hole, nor near the end of a piece.
    after = np.clip(np.searchsorted(motion.t_s, t_s), 1, len(motion.t_s) - 1)
    inside = (t_s >= motion.t_s[0]) & (t_s <= motion.t_s[-1])
    inside &= motion.t_s[after] - motion.t_s[after - 1] < TUNING.hole_s
    t_s, reading_m = t_s[inside], reading_m[inside]
    if not len(t_s):
        raise LaserError("the laser has no reading: check that it sees a target")
    roll, pitch = (np.interp(t_s, motion.t_s, column) for column in (motion.roll_rad, motion.pitch_rad))
    moves_mps, moves_m = float(np.std(motion.velocity_mps)), float(np.std(motion.heave_m))
    slow_hz = TUNING.slower * moves_mps / max(moves_m, 1e-9) / (2.0 * np.pi)
    fit, wander, late_s = None, np.zeros(len(t_s)), 0.0
    for _ in range(TUNING.rounds):
        # A lag is a shift; to first order alone, as the regression has it, that of a slow accelerometer would look like
        # a scale that grows with the frequency, and so like a lever arm.
        heave, velocity = (
            np.interp(t_s - late_s, motion.t_s, column) for column in (motion.heave_m, motion.velocity_mps)
        )
        fit = fit_geometry(t_s, reading_m, heave - wander, velocity, roll, pitch, start=start)
        if fit is None:
            break
        rise = fit.geometry.heave_m(reading_m, roll, pitch)
        left = heave - (rise - rise.mean()) / fit.scale - fit.late_s * velocity
        wander = _slow(t_s, np.where(np.isfinite(left), left, 0.0), slow_hz)
        fit = msgspec.structs.replace(fit, late_s=late_s + fit.late_s)
        if abs(fit.late_s) < TUNING.latest_s:
            late_s = fit.late_s
    if fit is None:
        raise LaserError("too few readings, or too little motion, to tell where the laser is: wait for more sea")
    if not fit.is_sign_found:
        raise LaserError(
            f"the readings do not go with the heave (scale {fit.scale:.2f}, standard error {fit.scale_std:.2f}): does "
            "the laser look at a fixed target?"
        )
    return fit


def _slow(t_s: Array, left_m: Array, slow_hz: float) -> Array:
    """What is slower than waves in what is left over (n,), at the same times; nothing where there are no readings."""
    place = np.floor((t_s - t_s[0]) * TUNING.wander_hz).astype(np.int64)
    size = 2 * (int(place[-1]) + 1)
    counts = np.bincount(place, minlength=size)
    grid = np.bincount(place, left_m - left_m.mean(), size) / np.maximum(counts, 1)
    f_hz = np.fft.rfftfreq(size, 1.0 / TUNING.wander_hz)
    smooth = np.fft.irfft(np.fft.rfft(grid) / (1.0 + (f_hz / slow_hz) ** 8), size)
    return np.asarray(np.interp(t_s, t_s[0] + (np.arange(size) + 0.5) / TUNING.wander_hz, smooth))


def _integrated(values: Array, step_s: float, times: int) -> Array:
    """Integral of a series without what is slower than waves, and without a lag."""
    count = len(values)
    taper = np.minimum(np.arange(count), np.arange(count)[::-1]) * step_s / TUNING.end_s
    taper = 0.5 - 0.5 * np.cos(np.pi * np.minimum(taper, 1.0))
    spectrum = np.fft.rfft(taper * (values - values.mean()))
    f_hz = np.fft.rfftfreq(count, step_s)
    f_hz[0] = 1.0
    passed = spectrum / (2j * np.pi * f_hz) ** times / (1.0 + (TUNING.slow_hz / f_hz) ** TUNING.steepness)
    passed[0] = 0.0
    return np.asarray(np.fft.irfft(passed, count))
