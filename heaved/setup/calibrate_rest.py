"""How a sensor stands when the vessel lies still, and the bias of its accelerometers, from the mean of a record.

The mean is weighed by a Hann window: waves of which there are several in the record are not in it. What it does not
know is told by the scatter of parts of the record, each taken by itself.

With an attitude, the vertical is that of the angles, and a bias what the specific force, turned level, has beside
gravity. Such a bias is the error of the accelerometers only as far as the angles do not come from them: a sensor that
levels itself by its own accelerometers hides their bias across the vertical, and is tilted by it. Without an attitude
only the length of the specific force tells anything, which is the bias along the vertical; across it, a bias of 0.01
m/s2 is a tilt of 0.06 degrees and nothing at rest tells one from the other. What gravity differs from the standard one
where she lies (-0.03 to +0.03 m/s2 from the equator to the poles) counts as bias, and so is taken off the heave, too.
"""

from __future__ import annotations

from math import degrees, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.samples import GRAVITY_MPS2

if TYPE_CHECKING:
    from heaved.setup.calibrate_record import Record

Array = NDArray[np.float64]
Vector = tuple[float, float, float]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What a rest is."""

    still_s: float = 20.0
    """So long a record does in a harbour;"""
    moving_s: float = 300.0
    """at a mooring, some thirty waves."""
    parts: int = 5
    still_rad: float = 0.0009
    """RMS of the tilt, 0.05 degrees, and"""
    still_mps2: float = 0.03
    """of the length of the mean force over a second, below which it is still."""
    tilts_rad: float = 0.09
    """RMS of 5 degrees, beyond which a mean is none: of a vessel that lists as she rolls,"""
    shakes_mps2: float = 1.2
    """or is thrown about."""
    wanders_rad: float = 0.0035
    """First and last part of the record further apart, 0.2 degrees: she is being loaded, or not at rest yet."""
    known_rad: float = 0.00087
    """Standard error of the tilt, 0.05 degrees, beyond which it is of no use."""
    least: int = 50
    """Samples."""
    great_mps2: float = 0.5
    """More is no bias but a wrong unit or sign, or a scale of more than 5 %."""
    agree_rad: float = 0.0003
    """Angles that agree with the specific force to 0.02 degrees come from it."""
    unknown_mps2: float = 0.03
    """What a bias may be that nothing shows: the turn-on bias of good MEMS accelerometers, 3 mg."""


TUNING: Final = Tuning()


class Rest(msgspec.Struct, frozen=True, kw_only=True):
    """How the sensor stood."""

    up: Vector
    """The vertical in its axes, a unit vector."""
    up_std_rad: float
    has_attitude: bool
    """Whether the vertical is that of its angles."""
    bias_mps2: Vector
    """Without an attitude, that part which is along the vertical."""
    bias_std_mps2: float
    """Of each axis, by the scatter of the record."""
    seconds: float
    tilt_rms_rad: float
    """How far it moved,"""
    force_rms_mps2: float
    """and how much the length of the force."""
    levels_itself: bool
    """Its angles agree so well with its accelerometers that they come from them."""


class RestError(Exception):
    """A record of which nothing can be told; the message says why and what to do."""


def is_still(record: Record) -> bool:
    """Whether a short record will do."""
    try:
        rest = rest_of(record)
    except RestError:
        return False
    return rest.tilt_rms_rad < TUNING.still_rad and rest.force_rms_mps2 < TUNING.still_mps2


def rest_of(record: Record) -> Rest:
    """What a record says of how its sensor stands.

    Raises:
        RestError: nothing.
    """
    if not record.has_force:
        raise RestError("the three accelerations are not all there: without them nothing is known of how it stands")
    has_attitude = record.has_attitude
    force, up, t_s = record.force_mps2, record.up, record.t_s
    good = np.isfinite(force).all(axis=1)
    if has_attitude:
        good &= np.isfinite(up).all(axis=1)
    force, up, t_s = force[good], up[good], t_s[good]
    if len(t_s) < TUNING.least:
        raise RestError(f"only {len(t_s)} samples: make a longer record, or ask more often")
    weight = _hann(t_s)
    mean_force = weight @ force
    length = float(np.linalg.norm(mean_force))
    if abs(length - GRAVITY_MPS2) > 4.0:
        raise RestError(
            f"the specific force is {length:.2f} m/s2, and at rest it is 9.81 whatever the orientation: unit or scale "
            "of the accelerations in the profile are wrong"
        )
    smooth = _smoothed(force, t_s)
    vertical = up if has_attitude else smooth / np.linalg.norm(smooth, axis=1)[:, None]
    mean_up = _unit(weight @ vertical if has_attitude else mean_force)
    off = vertical - mean_up
    tilt_rms = float(np.sqrt(np.mean(np.sum((off - off.mean(axis=0)) ** 2, axis=1))))
    force_rms = float(np.std(np.linalg.norm(smooth, axis=1)))
    if tilt_rms > TUNING.tilts_rad or force_rms > TUNING.shakes_mps2:
        raise RestError(
            f"it moves: {degrees(tilt_rms):.1f} degrees and {force_rms:.2f} m/s2 RMS; wait for calm weather, or hold "
            "the sensor still"
        )
    level = _levelled(force, up, mean_up) if has_attitude else force
    parts = np.array_split(np.arange(len(t_s)), TUNING.parts)
    ups = np.array([_unit(_hann(t_s[part]) @ vertical[part]) for part in parts])
    forces = np.array([_hann(t_s[part]) @ level[part] for part in parts])
    up_std = float(np.sqrt(np.mean(np.var(ups, axis=0, ddof=1)) * 1.5 / TUNING.parts))
    wandered = float(np.linalg.norm(ups[-1] - ups[0]))
    if wandered > TUNING.wanders_rad and wandered > 2.0 * tilt_rms / sqrt(TUNING.parts):
        raise RestError(
            f"its tilt has changed by {degrees(wandered):.2f} degrees within {record.seconds:.0f} s: wait until "
            "loading or ballasting is done, or until it is held still"
        )
    if up_std > TUNING.known_rad:
        raise RestError(
            f"the tilt is known to {degrees(up_std):.2f} degrees only, for it moves by {degrees(tilt_rms):.1f} degrees "
            f"RMS: make a longer record, {TUNING.moving_s:.0f} s or more, or wait for less motion"
        )
    found = weight @ level - GRAVITY_MPS2 * mean_up if has_attitude else (length - GRAVITY_MPS2) * mean_up
    across = found - float(found @ mean_up) * mean_up
    return Rest(
        up=_triple(mean_up),
        up_std_rad=up_std,
        has_attitude=has_attitude,
        bias_mps2=_triple(found),
        bias_std_mps2=float(np.sqrt(np.mean(np.var(forces, axis=0, ddof=1)) / TUNING.parts)),
        seconds=record.seconds,
        tilt_rms_rad=tilt_rms,
        force_rms_mps2=force_rms,
        levels_itself=has_attitude and float(np.linalg.norm(across)) < TUNING.agree_rad * GRAVITY_MPS2,
    )


def _hann(t_s: Array) -> Array:
    """Weights (n,) of a window over the times, their sum 1."""
    weight = 1.0 - np.cos(2.0 * np.pi * (t_s - t_s[0] + 0.5 * _step(t_s)) / (t_s[-1] - t_s[0] + _step(t_s)))
    return np.asarray(weight / weight.sum())


def _step(t_s: Array) -> float:
    return float((t_s[-1] - t_s[0]) / (len(t_s) - 1))


def _smoothed(force: Array, t_s: Array) -> Array:
    """Means over a second: vibration and noise are no motion."""
    count = max(round(1.0 / _step(t_s)), 1)
    rows = len(force) // count
    if rows < TUNING.parts:
        return force
    means = force[: rows * count].reshape(rows, count, 3).mean(axis=1)
    return (
        np.asarray(np.repeat(means, count, axis=0)) if rows * count == len(force) else _padded(means, count, len(force))
    )


def _padded(means: Array, count: int, length: int) -> Array:
    repeated = np.repeat(means, count, axis=0)
    return np.concatenate((repeated, np.repeat(means[-1:], length - len(repeated), axis=0)))


def _levelled(force: Array, up: Array, mean_up: Array) -> Array:
    """Each force turned by the least rotation that takes its vertical to the mean one: in a level frame that has no
    heading, whatever the orientation of the sensor.
    """
    axis, cosine = np.cross(up, mean_up), up @ mean_up
    once = np.cross(axis, force)
    return np.asarray(force + once + np.cross(axis, once) / (1.0 + cosine)[:, None])


def _unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v))


def _triple(v: Array) -> Vector:
    x, y, z = v.tolist()
    return x, y, z
