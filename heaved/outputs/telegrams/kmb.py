"""KM Binary, ``#KMB``: the 132 bytes in which Kongsberg's motion sensors tell all that they know, little-endian.

Sources: Simrad EK80 Reference Manual, "KM Binary datagram format"; SBG Systems, "Kongsberg MB"; for the bits also
Kongsberg's EMdgmFormat (#SKM, revisions before and from I).

=======  ==================================================  ====================================================
Bytes    What                                                Unit, sign
=======  ==================================================  ====================================================
0-7      ``#KMB``, length 132, version 1
8-15     UTC of validity: seconds since 1970, nanoseconds    uint32 each
16-19    status, below                                       bits, uint32
20-39    latitude, longitude, height                         nan: this software knows no position
40-55    roll, pitch, heading, heave                         degrees (+ port side up, + bow up, 0 to 360), m + down
56-67    rates of roll, pitch, yaw                           degrees/s
68-79    velocity north, east, down                          m/s; nan, nan, that of the heave
80-91    error of latitude, longitude, height                -1: not known
92-107   error of roll, pitch, heading, heave                one standard deviation, degrees and m; -1: not known
108-119  acceleration north, east, down, without gravity     m/s2
120-131  delayed heave: its own UTC as above, value          m + down
=======  ==================================================  ====================================================

Whatever is not known, or does not fit, is nan, never zero, and the bit of its group is set:

* Invalid: 0 position and horizontal velocity, always; 1 roll and pitch; 2 heading; 3 heave and its velocity, when
  either is not known, so also while the heave settles with ``settling = "error"``; 4 acceleration, when any of the
  three is not known, as north and east are without a heading (down is told all the same); 5 and 6 delayed heave, since
  its bit is one or the other by the revision of the reader.
* Reduced performance: 19 heave and its velocity, while the heave is degraded or settles.

Rates have no bit. Where there is no delayed heave its time is 0. A sample without a time says nothing to a reader that
sorts by it: when UTC is not known, or not between 1970 and 2106, nothing is sent.

It tells its own time of validity, so nothing is forecast to the moment of transmission unless the output says so.
"""

from __future__ import annotations

from math import cos, degrees, isfinite, nan, radians, sin
from struct import Struct
from typing import TYPE_CHECKING, Final

from heaved.outputs.motion import Lead
from heaved.outputs.telegrams.known import heading_deg, vertical
from heaved.outputs.telegrams.spec import Format, HeavePositive, Signs
from heaved.samples import HeaveState

if TYPE_CHECKING:
    from heaved.outputs.motion import Motion
    from heaved.outputs.telegrams.spec import OutputSpec

_TELEGRAM: Final = Struct("<4s2H2II2d21f2If")
_VERSION: Final = 1
_MOST_SINGLE: Final = 3.4028234663852886e38
_MOST_S: Final = 2.0**32

_NO_POSITION: Final = 1 << 0
_NO_ROLL_PITCH: Final = 1 << 1
_NO_HEADING: Final = 1 << 2
_NO_HEAVE: Final = 1 << 3
_NO_ACCELERATION: Final = 1 << 4
_NO_DELAYED_HEAVE: Final = 1 << 5 | 1 << 6
_REDUCED_HEAVE: Final = 1 << 19


def encode(motion: Motion, spec: OutputSpec) -> bytes:
    """The telegram of this motion, 132 bytes; empty when the time of its validity is not known."""
    if not 0.0 <= motion.utc_s < _MOST_S:
        return b""
    status = _NO_POSITION

    roll_deg, pitch_deg = _angle(motion.roll_rad), _angle(motion.pitch_rad)
    if not isfinite(roll_deg + pitch_deg):
        status |= _NO_ROLL_PITCH
    heading = heading_deg(motion.yaw_rad)
    if not isfinite(heading):
        status |= _NO_HEADING

    heave_m, velocity_mps, down_mps2 = map(_single, vertical(motion, spec))
    if not isfinite(heave_m + velocity_mps):
        status |= _NO_HEAVE
    elif motion.state is not HeaveState.VALID:
        status |= _REDUCED_HEAVE

    # The heading turns clockwise from north, and sway is to port.
    surge_mps2, sway_mps2, turn_rad = motion.surge_acceleration_mps2, motion.sway_acceleration_mps2, radians(heading)
    north_mps2 = _single(surge_mps2 * cos(turn_rad) + sway_mps2 * sin(turn_rad))
    east_mps2 = _single(surge_mps2 * sin(turn_rad) - sway_mps2 * cos(turn_rad))
    if not isfinite(north_mps2 + east_mps2 + down_mps2):
        status |= _NO_ACCELERATION

    delayed_m, delayed_utc_s = nan, 0.0
    if motion.delayed is not None and 0.0 <= motion.delayed_utc_s < _MOST_S:
        delayed_m = _single(motion.delayed.heave_m)
    if isfinite(delayed_m):
        delayed_utc_s = motion.delayed_utc_s
    else:
        status |= _NO_DELAYED_HEAVE

    return _TELEGRAM.pack(
        b"#KMB",
        _TELEGRAM.size,
        _VERSION,
        *_time(motion.utc_s),
        status,
        *(nan, nan, nan),
        roll_deg,
        pitch_deg,
        # A hair below 360 degrees is 360 in single precision.
        heading if heading < 359.99998 or heading != heading else 0.0,
        heave_m,
        _single(degrees(motion.roll_rate_radps)),
        _single(degrees(motion.pitch_rate_radps)),
        _single(degrees(motion.yaw_rate_radps)),
        *(nan, nan),
        velocity_mps,
        *(-1.0, -1.0, -1.0),
        _error(degrees(motion.roll_std_rad)),
        _error(degrees(motion.pitch_std_rad)),
        _error(degrees(motion.yaw_std_rad)),
        _error(motion.heave_std_m) if isfinite(heave_m) else -1.0,
        north_mps2,
        east_mps2,
        down_mps2,
        *_time(delayed_utc_s),
        delayed_m,
    )


def _single(value: float) -> float:
    """As it is, where single precision can hold it; else nan."""
    return value if -_MOST_SINGLE <= value <= _MOST_SINGLE else nan


def _angle(angle_rad: float) -> float:
    """In degrees, where it is one; else nan."""
    angle_deg = degrees(angle_rad)
    return angle_deg if -180.0 <= angle_deg <= 180.0 else nan


def _error(std: float) -> float:
    return std if 0.0 <= std <= _MOST_SINGLE else -1.0


def _time(utc_s: float) -> tuple[int, int]:
    """Seconds and nanoseconds."""
    seconds = int(utc_s)
    return seconds, int((utc_s - seconds) * 1e9)


FORMAT: Final = Format(
    title="Kongsberg KM Binary",
    encode=encode,
    longest_bytes=132,
    lead=Lead.NONE,
    signs=Signs(heave=HeavePositive.DOWN),
    options=("settling",),
)
