"""``$PNORSUB2`` and ``$PNORSUB7B`` of Norwegian Subsea: motion with its time of validity, its delay and its health.

    $PNORSUB2,T1,T2,roll,pitch,heading,heave,heave velocity,status*CS
    $PNORSUB7B,T1,T2,roll,pitch,heading,surge,sway,heave,roll rate,pitch rate,yaw rate,surge velocity,sway velocity,
               heave velocity,x,y,z acceleration,x,y,z period,x,y,z amplitude,status A,status B*CS

* ``T1``: the moment of validity, in milliseconds (2) or microseconds (7B), modulo 2^32: the maker counts from power-on,
  we count UTC since 1970, so it starts again after 49.7 days, or 71.6 minutes. Differences hold.
* ``T2``: from then until it is sent, in the same unit; up to an hour. 0 with ``lead = "transmission"``; empty with
  ``lead = "compensation"``, whose moment is still to come: the field has no minus.
* Roll (port side up), pitch (bow up), heading in degrees to 0.0001; rates in degrees per second to 0.001. Heave,
  velocity and acceleration, **positive down** in both, in m, m/s and m/s2, to 0.0001 (2) or 0.001 (7B).
* Accelerations of 7B are without gravity, forward, to starboard and down, in the level frame that turns with the
  heading.
* Surge and sway, their velocities, periods and amplitudes are not known to us, and empty. So is all else that is not
  known, or beyond 180 degrees of roll, 90 of pitch, 999 degrees per second, and 99 m, m/s and m/s2.
* The status of PNORSUB2 is 1 (OK) while the heave is valid and roll and pitch are known; else 0, the maker's "error":
  while it is degraded or settles, heave is there beside a 0. (The same field is called a "full status message". 0 and 1
  are right for those who read it as one, too: its lowest bit is MAIN_OK.)
* That of PNORSUB7B is 32 bits, the lower half first. Set are, of the maker's table, those that we have found to be so:
  the system runs (2, 3), the sensor answers and is within its range (7, 8, 9: heave, roll or pitch is known), heave is
  valid (22) or at least usable (23), it has settled (14), roll and pitch (16, 17) and heading (15, 18, 19) are known;
  all of heave, roll and pitch are (12 valid, 13 usable); so main (0 valid, 1 usable). All others are 0, as is what has
  not been checked: time and clock, processor, vibration, temperature, surge and sway, aiding. Degraded: 14 without 22;
  settling: neither.

PNORSUB7B is longer than the 82 characters of NMEA 0183: its maker made it so.

Sources: support.norwegian-subsea.no, NORSUB2, NORSUB7b (whose identifier is written PNORSUB7B there), "Health
monitoring system", "Reference frames and notations". The checksum that it prints beside its example of PNORSUB2 is
wrong.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from heaved.outputs.motion import Lead
from heaved.outputs.telegrams.known import DEGREES, tells_heave
from heaved.outputs.telegrams.nmea import (
    HEAVE_M,
    LAST_UTC_S,
    PITCH_DEG,
    RATE_DEGPS,
    ROLL_DEG,
    heading,
    number,
    sentence,
)
from heaved.outputs.telegrams.spec import Format, HeavePositive, Signs
from heaved.samples import HeaveState

if TYPE_CHECKING:
    from heaved.outputs.motion import Motion
    from heaved.outputs.telegrams.spec import OutputSpec

_MS: Final = 1e3
_US: Final = 1e6
_WRAP: Final = 2**32
_LONGEST_DELAY_S: Final = 3600.0
_ACCELERATION_MPS2: Final = 99.0
_FINE: Final = "z.4f"
_COARSE: Final = "z.3f"

_RUNS: Final = 1 << 2 | 1 << 3
_ANSWERS: Final = 1 << 7 | 1 << 8 | 1 << 9
_SETTLED: Final = 1 << 14
_HEADING: Final = 1 << 15 | 1 << 18 | 1 << 19
_ROLL_PITCH: Final = 1 << 16 | 1 << 17
_HEAVE_VALID: Final = 1 << 22
_HEAVE_USABLE: Final = 1 << 23
_ALL_VALID: Final = 1 << 0 | 1 << 12
_ALL_USABLE: Final = 1 << 1 | 1 << 13


def encode_2(motion: Motion, spec: OutputSpec) -> bytes:
    """The sentence PNORSUB2 of a motion."""
    tells = tells_heave(motion, spec)
    roll, pitch, yaw = _attitude(motion)
    heave = number(motion.heave_m, _FINE, HEAVE_M) if tells else ""
    velocity = number(motion.heave_velocity_mps, _FINE, HEAVE_M) if tells else ""
    status = 1 if roll and pitch and heave and motion.state is HeaveState.VALID else 0
    return sentence(
        f"PNORSUB2,{_validity(motion.utc_s, _MS)},{_delay(motion.age_s, spec.lead, _MS)},"
        f"{roll},{pitch},{yaw},{heave},{velocity},{status}"
    )


def encode_7b(motion: Motion, spec: OutputSpec) -> bytes:
    """The sentence PNORSUB7B of a motion."""
    tells = tells_heave(motion, spec)
    roll, pitch, yaw = _attitude(motion)
    heave = number(motion.heave_m, _COARSE, HEAVE_M) if tells else ""
    velocity = number(motion.heave_velocity_mps, _COARSE, HEAVE_M) if tells else ""
    roll_rate, pitch_rate, yaw_rate = [
        number(rate * DEGREES, _COARSE, RATE_DEGPS)
        for rate in (motion.roll_rate_radps, motion.pitch_rate_radps, motion.yaw_rate_radps)
    ]
    forward = number(motion.surge_acceleration_mps2, _COARSE, _ACCELERATION_MPS2)
    starboard = number(-motion.sway_acceleration_mps2, _COARSE, _ACCELERATION_MPS2)  # Ours is to port.
    vertical = number(motion.heave_acceleration_mps2, _COARSE, _ACCELERATION_MPS2) if tells else ""
    status = _health(motion.state, bool(heave), bool(roll), bool(pitch), bool(yaw))
    return sentence(
        f"PNORSUB7B,{_validity(motion.utc_s, _US)},{_delay(motion.age_s, spec.lead, _US)},"
        f"{roll},{pitch},{yaw},,,{heave},{roll_rate},{pitch_rate},{yaw_rate},,,{velocity},"
        f"{forward},{starboard},{vertical},,,,,,,{status & 0xFFFF},{status >> 16}"
    )


def _attitude(motion: Motion) -> tuple[str, str, str]:
    return (
        number(motion.roll_rad * DEGREES, _FINE, ROLL_DEG),
        number(motion.pitch_rad * DEGREES, _FINE, PITCH_DEG),
        heading(motion.yaw_rad, _FINE),
    )


def _validity(utc_s: float, per_s: float) -> str:
    return str(round(utc_s * per_s) % _WRAP) if 0.0 <= utc_s < LAST_UTC_S else ""


def _delay(age_s: float, lead: Lead | None, per_s: float) -> str:
    """From the moment of validity to that of sending."""
    if lead is Lead.TRANSMISSION:
        return "0"
    if lead is Lead.COMPENSATION or not 0.0 <= age_s <= _LONGEST_DELAY_S:
        return ""
    return str(round(age_s * per_s))


def _health(state: HeaveState, heave: bool, roll: bool, pitch: bool, yaw: bool) -> int:
    """The maker's status word, of what is told."""
    is_valid = heave and state is HeaveState.VALID
    attitude = roll and pitch
    return (
        _RUNS
        | _ANSWERS * (heave or roll or pitch)
        | _SETTLED * (heave and state is not HeaveState.SETTLING)
        | _HEADING * yaw
        | _ROLL_PITCH * attitude
        | _HEAVE_USABLE * heave
        | _HEAVE_VALID * is_valid
        | _ALL_USABLE * (heave and attitude)
        | _ALL_VALID * (is_valid and attitude)
    )


FORMAT_2: Final = Format(
    title="PNORSUB2",
    encode=encode_2,
    longest_bytes=81,
    lead=Lead.NONE,
    signs=Signs(heave=HeavePositive.DOWN),
    options=("settling",),
)
FORMAT_7B: Final = Format(
    title="PNORSUB7B",
    encode=encode_7b,
    longest_bytes=152,
    lead=Lead.NONE,
    signs=Signs(heave=HeavePositive.DOWN),
    options=("settling",),
)
