"""TSS1, the 27 characters that the motion sensors of Teledyne TSS made common: ``:XXAAAA MHHHHQMRRRR MPPPP`` CR LF.

Sources: Teledyne TSS as quoted by UHDAS (MAHRS diagnostics) and NovAtel (OEM7, log TSS1); Simrad EK15, EK80 and ES80
reference manuals; what readers make of the letter: QPS Qinsy, driver "TSS R-P-H".

=======  ===================================================  ==============================  ===================
Field    What                                                 Unit, range                     Not known
=======  ===================================================  ==============================  ===================
XX       horizontal acceleration, magnitude                   3.83 cm/s2, 00 to FE            FF, also beyond FE
AAAA     vertical acceleration, two's complement, + up        0.0625 cm/s2, +-7FFF            8000
MHHHH    heave, M is a space or ``-``, + up                   1 cm, +-99.98 m                 `` 9999``
Q        what it is worth, below
MRRRR    roll, + port side up                                 0.01 degrees, +-90.00           `` 9999``
MPPPP    pitch, + bow up                                      0.01 degrees, +-90.00           `` 9999``
=======  ===================================================  ==============================  ===================

Q is one of four, since neither a velocity log nor a gyrocompass aids this heave (``G``, ``H`` and ``F`` say so):

* ``U``: unaided and settled, heave and attitude can be used; also of a degraded heave, which the format cannot tell.
* ``u``: settling; readers use nothing of the telegram. Also while roll or pitch is not known: the format has no letter
  for that, and readers are not to take 99.99 degrees for an angle.
* ``?``: the heave is not known, roll and pitch are good (the letter of the TSS 320). With ``settling = "error"`` it
  also stands for a heave that settles, so that roll and pitch can be used meanwhile.

The values are those of the moment at which the telegram is begun to be sent. The roll is that of the TSS convention,
unless the output says otherwise, as the manuals of Simrad define it in this format. The vertical acceleration is that
of the motion, without gravity, as Kongsberg, NovAtel and SMC send it (some sensors include 9.81 m/s2); the horizontal
one is a magnitude, as TSS has it, where Kongsberg has that of sway. Few readers look at either.
"""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING, Final

from heaved.outputs.motion import Lead
from heaved.outputs.telegrams.known import CENTIDEGREES, vertical, whole
from heaved.outputs.telegrams.spec import Format, RollConvention, Signs
from heaved.samples import HeaveState

if TYPE_CHECKING:
    from heaved.outputs.motion import Motion
    from heaved.outputs.telegrams.spec import OutputSpec

_PER_MPS2_LEVEL: Final = 1.0 / 0.0383
_PER_MPS2_VERTICAL: Final = 1.0 / 0.000625
_MOST_CM: Final = 9998
_MOST_CENTIDEGREES: Final = 9000


def encode(motion: Motion, spec: OutputSpec) -> bytes:
    """The telegram of this motion: 27 bytes, whatever is known."""
    heave_m, _, acceleration_mps2 = vertical(motion, spec)
    heave = whole(heave_m, 100.0, _MOST_CM)
    roll = whole(motion.roll_rad, CENTIDEGREES, _MOST_CENTIDEGREES)
    pitch = whole(motion.pitch_rad, CENTIDEGREES, _MOST_CENTIDEGREES)
    if roll is None or pitch is None:
        worth = "u"
    elif heave is None:
        worth = "?"
    else:
        worth = "u" if motion.state is HeaveState.SETTLING else "U"
    level = whole(hypot(motion.surge_acceleration_mps2, motion.sway_acceleration_mps2), _PER_MPS2_LEVEL, 0xFE)
    up = whole(acceleration_mps2, _PER_MPS2_VERTICAL, 0x7FFF)
    return (
        f":{0xFF if level is None else level:02X}{0x8000 if up is None else up & 0xFFFF:04X} "
        f"{_signed(heave)}{worth}{_signed(roll)} {_signed(pitch)}\r\n"
    ).encode("ascii")


def _signed(number: int | None) -> str:
    """Sign and four digits."""
    if number is None:
        return " 9999"
    return f"-{-number:04d}" if number < 0 else f" {number:04d}"


FORMAT: Final = Format(
    title="TSS1",
    encode=encode,
    longest_bytes=27,
    lead=Lead.TRANSMISSION,
    signs=Signs(convention=RollConvention.TSS),
    most_hz=25.0,
    options=("settling",),
)
