"""``$PASHR``: time, heading, roll, pitch and heave with their standard deviations (inertial systems of many makers).

    $PASHR,hhmmss.sss,hhh.hh,T,±r.rr,±p.pp,±h.hh,r.rrr,p.ppp,h.hhh,g,i*CS

UTC of validity; heading; roll (port side up), pitch (bow up), heave (up), always with their sign; standard deviations
of roll, pitch and heading. Angles in degrees to 0.01, their deviations to 0.001, heave in metres to 0.01. What is not
known, or beyond 180 degrees of roll, 90 of pitch and 99 m, is empty.

* ``T`` (true) belongs to the sentence: readers tell by it this PASHR from those of Ashtech. The heading is the one that
  the sensor gives; whether it is true, magnetic or that of no north at all is a matter of the sensor.
* ``g``, the quality of the satellite fix, is 0 at all times: there is none.
* ``i``, the status, is ``ins_good`` while the heave is valid and roll and pitch are known. Else, by the scale that it
  is of:

  * ``ins_good`` 3 or more (Trimble: 1 coarse levelling, 2 degraded, 3 aligned, 4 full navigation): 2 while the heave is
    degraded, 1 while it settles, 0 when heave, roll or pitch is not known;
  * ``ins_good`` 1 or 2 (NovAtel: 1 aligned): 0;
  * ``ins_good`` 0 (makers whose flag tells a fault): 1.

  So a reader who asks for good has valid heave alone; one who does not still sees by the empty field what is not known.

Which way heave counts differs from maker to maker too, and some keep its field empty (Trimble).

Sources: NovAtel OEM7, log PASHR (message 1177; its example is in the tests); Trimble OEM GNSS, PASHR.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from heaved.outputs.motion import Lead
from heaved.outputs.telegrams.known import DEGREES, tells_heave
from heaved.outputs.telegrams.nmea import HEAVE_M, PITCH_DEG, ROLL_DEG, heading, number, sentence, time_of_day
from heaved.outputs.telegrams.spec import Format
from heaved.samples import HeaveState

if TYPE_CHECKING:
    from heaved.outputs.motion import Motion
    from heaved.outputs.telegrams.spec import OutputSpec

_STD_DEG: Final = 99.0
_SIGNED: Final = "+z.2f"
_TRIMBLE_GOOD: Final = 3
"""From it on, ``ins_good`` is of Trimble's scale."""
_TRIMBLE: Final = {HeaveState.DEGRADED: 2, HeaveState.SETTLING: 1}


def encode(motion: Motion, spec: OutputSpec) -> bytes:
    """The sentence of a motion."""
    roll = number(motion.roll_rad * DEGREES, _SIGNED, ROLL_DEG)
    pitch = number(motion.pitch_rad * DEGREES, _SIGNED, PITCH_DEG)
    heave = number(motion.heave_m, _SIGNED, HEAVE_M) if tells_heave(motion, spec) else ""
    status = _status(motion.state, spec.ins_good) if roll and pitch and heave else _bad(spec.ins_good)
    return sentence(
        f"PASHR,{time_of_day(motion.utc_s)},{heading(motion.yaw_rad, 'z06.2f')},T,{roll},{pitch},{heave},"
        f"{_std(motion.roll_std_rad)},{_std(motion.pitch_std_rad)},{_std(motion.yaw_std_rad)},0,{status}"
    )


def _std(std_rad: float) -> str:
    return number(std_rad * DEGREES, "z.3f", _STD_DEG) if std_rad >= 0.0 else ""


def _status(state: HeaveState, good: int) -> int:
    """Of a motion whose heave, roll and pitch are told."""
    if state is HeaveState.VALID:
        return good
    return _TRIMBLE[state] if good >= _TRIMBLE_GOOD else _bad(good)


def _bad(good: int) -> int:
    return 1 if good == 0 else 0


FORMAT: Final = Format(
    title="PASHR",
    encode=encode,
    longest_bytes=78,
    lead=Lead.NONE,
    options=("ins_good", "settling"),
)
