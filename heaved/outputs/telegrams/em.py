"""Kongsberg EM Attitude 1000 and 3000: ten bytes of roll, pitch, heave and heading, little-endian.

Sources: Simrad EK15 and EK80 reference manuals, "Kongsberg EM Attitude 3000"; SBG Systems, "Simrad 3000 status flags";
what readers make of the status: QPS Qinsy, driver "Simrad EM1000/3000".

=====  ==================  ======================================  ==========================
Bytes  What                Unit, range                             Not known
=====  ==================  ======================================  ==========================
0      status              EM1000: 00h; EM3000: below
1      90h
2-3    roll, int16         0.01 degrees, +-179.99, + port side up  7FFFh (EM1000: not sent)
4-5    pitch, int16        0.01 degrees, +-179.99, + bow up        7FFFh (EM1000: not sent)
6-7    heave, int16        1 cm, +-9.99 m, + up                    7FFFh (EM1000: not sent)
8-9    heading, uint16     0.01 degrees, 0 to 359.99               FFFFh
=====  ==================  ======================================  ==========================

The maker's rule is that a value outside its range is not valid and is rejected: that is how the heading says that there
is none, which is usual without a compass. The heading is unsigned: 359.99 degrees do not fit an int16.

Status of EM3000, one for roll, pitch and heave together:

* 90h: valid.
* 91h: the heave is degraded.
* 9Ah: the heave settles. For the maker that is "not valid, but normal operation"; Qinsy uses what has 91h to 9Fh. With
  ``settling = "error"`` it is A0h instead, and the heave not known.
* A0h: heave, roll or pitch is not known; the others are as they are.

EM1000 has no status, and not every reader knows the rule of the ranges: while heave, roll or pitch is not known,
nothing is sent, so that the reader's time-out acts. While the heave is degraded or settles it is sent as good, unless
``settling = "error"``, with which nothing is sent while it settles.

Values are those of the moment at which the telegram is begun to be sent.
"""

from __future__ import annotations

from struct import Struct
from typing import TYPE_CHECKING, Final

from heaved.outputs.motion import Lead
from heaved.outputs.telegrams.known import CENTIDEGREES, heading_deg, vertical, whole
from heaved.outputs.telegrams.spec import Format
from heaved.samples import HeaveState

if TYPE_CHECKING:
    from heaved.outputs.motion import Motion
    from heaved.outputs.telegrams.spec import OutputSpec

_TELEGRAM: Final = Struct("<BBhhhH")
_SYNC: Final = 0x90
_NOT_KNOWN: Final = 0x7FFF
_NO_HEADING: Final = 0xFFFF
_MOST_CENTIDEGREES: Final = 17999
_MOST_CM: Final = 999
_ERROR: Final = 0xA0
_STATUS: Final = {HeaveState.VALID: 0x90, HeaveState.DEGRADED: 0x91, HeaveState.SETTLING: 0x9A}


def encode_em1000(motion: Motion, spec: OutputSpec) -> bytes:
    """The telegram of this motion, 10 bytes; empty while heave, roll or pitch is not known."""
    roll, pitch, heave = _quantities(motion, spec)
    if roll is None or pitch is None or heave is None:
        return b""
    return _TELEGRAM.pack(0x00, _SYNC, roll, pitch, heave, _heading(motion))


def encode_em3000(motion: Motion, spec: OutputSpec) -> bytes:
    """The telegram of this motion: 10 bytes, whatever is known."""
    roll, pitch, heave = _quantities(motion, spec)
    status = _ERROR if roll is None or pitch is None or heave is None else _STATUS[motion.state]
    return _TELEGRAM.pack(
        status,
        _SYNC,
        _NOT_KNOWN if roll is None else roll,
        _NOT_KNOWN if pitch is None else pitch,
        _NOT_KNOWN if heave is None else heave,
        _heading(motion),
    )


def _quantities(motion: Motion, spec: OutputSpec) -> tuple[int | None, int | None, int | None]:
    """Roll, pitch and heave, in their units."""
    return (
        whole(motion.roll_rad, CENTIDEGREES, _MOST_CENTIDEGREES),
        whole(motion.pitch_rad, CENTIDEGREES, _MOST_CENTIDEGREES),
        whole(vertical(motion, spec)[0], 100.0, _MOST_CM),
    )


def _heading(motion: Motion) -> int:
    heading = heading_deg(motion.yaw_rad)
    return round(100.0 * heading) % 36000 if heading == heading else _NO_HEADING


EM1000: Final = Format(
    title="Kongsberg EM Attitude 1000",
    encode=encode_em1000,
    longest_bytes=10,
    lead=Lead.TRANSMISSION,
    options=("settling",),
)
EM3000: Final = Format(
    title="Kongsberg EM Attitude 3000",
    encode=encode_em3000,
    longest_bytes=10,
    lead=Lead.TRANSMISSION,
    options=("settling",),
)
