"""The hexadecimal heave that drives of winches read: ``$SMCHHHHVVVVAAAA`` CR LF, 18 characters, up to 100 Hz.

Source: SMC IMU User Guide 3.1, section 4.3.3, "Bosch Rexroth hexadecimal heave".

HHHH heave in mm, VVVV its velocity in mm/s, AAAA its acceleration in mm/s2, each in two's complement, + up, -32767 to
32766 by the maker; here +-32766, 32.766 m.

The format has neither status nor checksum. A drive that is told zero stands still against a vessel that moves, and one
that is told the end of a range follows it there. So while heave, velocity or acceleration is not known or out of range,
nothing at all is sent: the drive's time-out for this line must be set, short, and bring the winch to a safe state. (The
maker's own sensor sends zeros while it settles.) While the heave is degraded or settles it is sent as good, unless
``settling = "error"``, with which nothing is sent while it settles: what a drive should have.

Values are those of the moment at which the telegram is begun to be sent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from heaved.outputs.motion import Lead
from heaved.outputs.telegrams.known import vertical, whole
from heaved.outputs.telegrams.spec import Format

if TYPE_CHECKING:
    from heaved.outputs.motion import Motion
    from heaved.outputs.telegrams.spec import OutputSpec

_MOST: Final = 32766


def encode(motion: Motion, spec: OutputSpec) -> bytes:
    """The telegram of this motion, 18 bytes; empty while any of its three quantities is not known."""
    heave_m, velocity_mps, acceleration_mps2 = vertical(motion, spec)
    heave = whole(heave_m, 1000.0, _MOST)
    velocity = whole(velocity_mps, 1000.0, _MOST)
    acceleration = whole(acceleration_mps2, 1000.0, _MOST)
    if heave is None or velocity is None or acceleration is None:
        return b""
    return b"$SMC%04X%04X%04X\r\n" % (heave & 0xFFFF, velocity & 0xFFFF, acceleration & 0xFFFF)


FORMAT: Final = Format(
    title="SMC hexadecimal",
    encode=encode,
    longest_bytes=18,
    lead=Lead.TRANSMISSION,
    most_hz=100.0,
    options=("settling",),
)
