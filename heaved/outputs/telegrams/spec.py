"""``[[output]]``: what is told to whom, in which format, with which signs; and what a format is."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from math import asin, cos, nan, sin
from typing import Annotated, Final

import msgspec

from heaved.outputs.motion import Lead, Motion


class Telegram(StrEnum):
    """The formats by the names of the configuration."""

    TSS1 = "tss1"
    EM1000 = "em1000"
    EM3000 = "em3000"
    PASHR = "pashr"
    PSXN = "psxn"
    PRDID = "prdid"
    XDR = "xdr"
    SMC_HEX = "smc_hex"
    KMB = "kmb"
    PNORSUB2 = "pnorsub2"
    PNORSUB7B = "pnorsub7b"


class HeavePositive(StrEnum):
    """Which way heave, its velocity and its acceleration count."""

    UP = "up"
    DOWN = "down"


class RollPositive(StrEnum):
    """Which side is up when roll and its rate are positive."""

    PORT_UP = "port_up"
    STARBOARD_UP = "starboard_up"


class PitchPositive(StrEnum):
    """Which end is up when pitch and its rate are positive."""

    BOW_UP = "bow_up"
    BOW_DOWN = "bow_down"


class RollConvention(StrEnum):
    """What is called roll on a pitched vessel."""

    TAIT_BRYAN = "tait_bryan"
    """The angle about the vessel's own longitudinal axis, after heading and pitch."""
    TSS = "tss"
    """The elevation of the transverse axis, as the sensors of TSS and the Hippy give it."""


class Settling(StrEnum):
    """What the heave of the first minutes is to a reader that knows only good and bad."""

    DEGRADED = "degraded"
    ERROR = "error"


TRANSDUCER_LETTERS: Final = 16
"""Most letters of an identifier of XDR."""
Transducer = Annotated[str, msgspec.Meta(pattern=rf"^[A-Za-z0-9_]{{1,{TRANSDUCER_LETTERS}}}\Z")]
"""An identifier of XDR: nothing in it ends a field or a sentence."""


class OutputSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One ``[[output]]``. What is None is as the format has it."""

    name: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_.-]{1,64}\Z")]
    telegram: Telegram
    link: str
    """``udp://host:port``, ``tcp://host:port``, ``tcp-listen://host:port`` or
    ``serial:///dev/ttyUSB0?baudrate=9600&parity=N&stopbits=1``."""
    rate_hz: Annotated[float, msgspec.Meta(gt=0, le=250)] = 10.0
    point: str = ""
    """Name of the ``[[point]]`` that it tells of; empty: the IMU."""
    lead: Lead | None = None
    heave_positive: HeavePositive | None = None
    roll_positive: RollPositive | None = None
    pitch_positive: PitchPositive | None = None
    roll_convention: RollConvention | None = None
    talker: Annotated[str, msgspec.Meta(pattern="^[A-Z]{2}\\Z")] = "II"
    """Of the sentences that have one (XDR)."""
    settling: Settling = Settling.DEGRADED
    ins_good: Annotated[int, msgspec.Meta(ge=0, le=9)] = 1
    """Last field of PASHR while all is well; makers differ (1 or 0)."""
    transducers: tuple[Transducer, Transducer, Transducer] = ("HEAVE", "PTCH", "ROLL")
    """Identifiers of XDR for heave, pitch and roll."""
    allow: tuple[str, ...] = ()
    """Networks (CIDR) from which may connect to a ``tcp-listen`` link, besides loopback."""


class Signs(msgspec.Struct, frozen=True, kw_only=True):
    """How a format counts, unless it is told otherwise."""

    heave: HeavePositive = HeavePositive.UP
    roll: RollPositive = RollPositive.PORT_UP
    pitch: PitchPositive = PitchPositive.BOW_UP
    convention: RollConvention = RollConvention.TAIT_BRYAN


class Format(msgspec.Struct, frozen=True, kw_only=True):
    """One format: its encoder, and what a reader of it counts on."""

    title: str
    """For people."""
    encode: Callable[[Motion, OutputSpec], bytes]
    """Of a motion whose signs are the reader's already; the whole of what is sent at one moment, ends of line included.
    Whatever the numbers, it gives a telegram that says what is known and nothing else. Empty: something is not known,
    and the format has no way to say so; nothing is sent, so that the reader's own time-out acts."""
    longest_bytes: int
    lead: Lead
    """What is usual: NONE where it tells its time of validity, else TRANSMISSION."""
    signs: Signs = Signs()
    most_hz: float | None = None
    """More often its readers cannot take it; None: as often as the line allows."""
    options: tuple[str, ...] = ()
    """Keys of :class:`OutputSpec` that mean something to this format alone."""


def as_read(motion: Motion, spec: OutputSpec, signs: Signs) -> Motion:
    """The same motion with the signs and the roll that the reader expects."""
    changed: dict[str, float] = {}
    if (spec.roll_convention or signs.convention) is RollConvention.TSS:
        is_known = motion.has_attitude
        changed["roll_rad"] = asin(sin(motion.roll_rad) * cos(motion.pitch_rad)) if is_known else nan
    if (spec.roll_positive or signs.roll) is RollPositive.STARBOARD_UP:
        changed["roll_rad"] = -changed.get("roll_rad", motion.roll_rad)
        changed["roll_rate_radps"] = -motion.roll_rate_radps
    if (spec.pitch_positive or signs.pitch) is PitchPositive.BOW_DOWN:
        changed["pitch_rad"], changed["pitch_rate_radps"] = -motion.pitch_rad, -motion.pitch_rate_radps
    if (spec.heave_positive or signs.heave) is HeavePositive.DOWN:
        changed |= {name: -getattr(motion, name) for name in _HEAVE}
        if motion.delayed is not None:
            delayed = msgspec.structs.replace(motion.delayed, heave_m=-motion.delayed.heave_m)
            return msgspec.structs.replace(motion, delayed=delayed, **changed)
    return msgspec.structs.replace(motion, **changed) if changed else motion


_HEAVE: Final = ("heave_m", "heave_velocity_mps", "heave_acceleration_mps2")
