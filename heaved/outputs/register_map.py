"""``[registers]``: the motion as 16-bit words for a PLC. One table says what stands where; words are made of it, and
the description in ``config/heaved.toml`` is checked against it. Pure.

The first six are the map that crane PLCs know from other makers' sensors, in its order, the watchdog counter last of
them; ours follow, those of a fixed place first. What is not known, and what a word cannot hold, is 8000h where a word
is signed and FFFFh (FFFFFFFFh) where it is not: never zero, never the nearest that fits. The quality says so too, of
the heave and its velocity.

The counter counts the frames. Frames come with or without sensors, ten a second or more on any useful configuration: a
counter that has stood for a second means that the daemon is dead, whatever the words beside it say.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from enum import Enum, StrEnum
from math import degrees, inf, isfinite, nan
from typing import TYPE_CHECKING, Annotated, Final

import msgspec

from heaved.links import SerialLink, character_s, silence_s
from heaved.outputs.motion import LONGEST_S, Lead, Motion, motion_at
from heaved.outputs.telegrams.spec import HeavePositive, PitchPositive, RollPositive
from heaved.samples import HeaveState, MotionFrame, RockPrediction, SeaState

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.links import Link

COMMON_WORDS: Final = 6
"""The map that other makers have."""
MOST_WRITTEN: Final = 123
"""Registers that one write (function 16) may hold."""
REVISION: Final = 1
"""Of the map; another one has a word in another place."""
_WRAP: Final = 0x8000
_FRESH_S: Final = 1e-3
"""The words of one moment serve so long: the age has no finer unit, and a flood of reads costs one computation each."""


# ---- what a user sets ------------------------------------------------------------------------------------------------


class Mode(StrEnum):
    """Who asks."""

    SERVE = "serve"
    """The PLC reads; heaved is the slave (server)."""
    PUSH = "push"
    """heaved is the master (client) and writes into the PLC."""


class RegistersParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[registers]``."""

    enabled: bool = False
    mode: Mode = Mode.SERVE
    link: str = "tcp://127.0.0.1:5502"
    """``tcp://host:port``: where to listen, or, to push, where the PLC does; or ``rtu:///dev/ttyUSB0?baudrate=...``."""
    device_id: Annotated[int, msgspec.Meta(ge=0, le=255)] = 1
    start: Annotated[int, msgspec.Meta(ge=0, le=65535)] = 3
    """Zero-based address of the first word: 3 is what manuals call 400004."""
    rate_hz: Annotated[float, msgspec.Meta(gt=0, le=100)] = 10.0
    """Writes per second; pushing alone."""
    count: Annotated[int, msgspec.Meta(ge=1, le=MOST_WRITTEN)] = COMMON_WORDS
    """Words that are written, from the first on; pushing alone."""
    point: str = ""
    """Name of the ``[[point]]`` that the first words tell of; empty: the IMU."""
    lead: Lead = Lead.TRANSMISSION
    heave_positive: HeavePositive = HeavePositive.UP
    roll_positive: RollPositive = RollPositive.PORT_UP
    pitch_positive: PitchPositive = PitchPositive.BOW_DOWN
    horizons_s: tuple[Annotated[float, msgspec.Meta(gt=0, le=30)], ...] = (0.05, 0.1, 0.15, 0.5, 1.0, 2.0, 5.0)
    """Of the forecasts, in this order."""
    allow: tuple[str, ...] = ()
    """Networks (CIDR) from which may be read, besides loopback."""


def write_time_s(link: Link, count: int) -> float:
    """Least time that a write of ``count`` registers takes on the line: request, answer, a silence after each; the
    PLC's own time comes on top. 0 on TCP.
    """
    if not isinstance(link, SerialLink):
        return 0.0
    # Id, function, first register, their number, bytes, checksum; the answer has no bytes.
    characters = 9 + 2 * count + 8
    return characters * character_s(link) + 2.0 * silence_s(link)


# ---- the table -------------------------------------------------------------------------------------------------------


class Kind(Enum):
    """What one entry is on the wire: words, least and greatest value, and the one for "not known"."""

    INT16 = (1, -0x7FFF, 0x7FFF, 0x8000)
    UINT16 = (1, 0, 0xFFFE, 0xFFFF)
    UINT32 = (2, 0, 0xFFFF_FFFE, 0xFFFF_FFFF)
    """High word first."""

    def __init__(self, words: int, least: int, most: int, unknown: int) -> None:
        self.words, self.least, self.most, self.unknown = words, least, most, unknown


class Axis(Enum):
    """Whose sign an entry has."""

    NONE = "none"
    HEAVE = "heave"
    ROLL = "roll"
    PITCH = "pitch"


class Moment(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """What the words of one moment are made of."""

    counter: int
    motion: Motion
    points: tuple[Motion, ...]
    """Of each monitoring point, as the configuration has them."""
    forecast: Mapping[float, tuple[float, float]]
    """By horizon, heave and standard deviation."""
    rock: Mapping[float, RockPrediction]
    sea: SeaState | None
    horizons: int


class Register(msgspec.Struct, frozen=True, kw_only=True):
    """One entry of the table."""

    name: str
    kind: Kind
    unit: str
    """Empty: a number by itself."""
    per_unit: int = 1
    """Steps of the word in one unit."""
    axis: Axis = Axis.NONE
    value: Callable[[Moment], float]
    """In ``unit``, with our own signs; nan: not known."""


QUALITIES: Final = {HeaveState.INVALID: 0, HeaveState.SETTLING: 1, HeaveState.DEGRADED: 2, HeaveState.VALID: 3}


def _fits(value: float, kind: Kind, per_unit: int) -> bool:
    return kind.least - 0.5 < value * per_unit < kind.most + 0.5


def _quality(motion: Motion) -> int:
    """What the heave is worth; 0 as well where heave or velocity do not fit into their words."""
    fits = _fits(motion.heave_m, Kind.INT16, 1000) and _fits(motion.heave_velocity_mps, Kind.INT16, 1000)
    return QUALITIES[motion.state] if fits else 0


def _heading_deg(motion: Motion) -> float:
    """From 0 to 359.99."""
    turned_deg = degrees(motion.yaw_rad) % 360.0
    return round(turned_deg * 100.0) % 36000 / 100.0 if isfinite(turned_deg) else nan


def _milliseconds(utc_s: float) -> float:
    return utc_s % 1.0 * 1000.0 // 1.0


def _delayed(moment: Moment) -> tuple[float, float, float]:
    """Delayed heave, its standard deviation, and how long it lies before the time of the words."""
    delayed, motion = moment.motion.delayed, moment.motion
    if delayed is None:
        return nan, nan, nan
    return delayed.heave_m, delayed.std_m, motion.utc_s - motion.delayed_utc_s


def _word(
    name: str,
    kind: Kind,
    unit: str,
    per_unit: int,
    value: Callable[[Moment], float],
    axis: Axis = Axis.NONE,
) -> Register:
    return Register(name=name, kind=kind, unit=unit, per_unit=per_unit, value=value, axis=axis)


FIXED: Final = (
    _word("heave", Kind.INT16, "m", 1000, lambda m: m.motion.heave_m, Axis.HEAVE),
    _word("heave velocity", Kind.INT16, "m/s", 1000, lambda m: m.motion.heave_velocity_mps, Axis.HEAVE),
    _word("vertical acceleration", Kind.INT16, "m/s2", 1000, lambda m: m.motion.heave_acceleration_mps2, Axis.HEAVE),
    _word("roll", Kind.INT16, "deg", 100, lambda m: degrees(m.motion.roll_rad), Axis.ROLL),
    _word("pitch", Kind.INT16, "deg", 100, lambda m: degrees(m.motion.pitch_rad), Axis.PITCH),
    _word("watchdog counter", Kind.UINT16, "", 1, lambda m: m.counter),
    # Other makers' maps end here.
    _word("quality", Kind.UINT16, "", 1, lambda m: _quality(m.motion)),
    _word("age of the sample", Kind.UINT16, "s", 1000, lambda m: m.motion.age_s),
    _word("standard deviation of heave", Kind.UINT16, "m", 1000, lambda m: m.motion.heave_std_m),
    _word("heading", Kind.UINT16, "deg", 100, lambda m: _heading_deg(m.motion)),
    _word("roll rate", Kind.INT16, "deg/s", 100, lambda m: degrees(m.motion.roll_rate_radps), Axis.ROLL),
    _word("pitch rate", Kind.INT16, "deg/s", 100, lambda m: degrees(m.motion.pitch_rate_radps), Axis.PITCH),
    _word("UTC since 1970", Kind.UINT32, "s", 1, lambda m: m.motion.utc_s // 1.0),
    _word("UTC within the second", Kind.UINT16, "ms", 1, lambda m: _milliseconds(m.motion.utc_s)),
    _word("delayed heave", Kind.INT16, "m", 1000, lambda m: _delayed(m)[0], Axis.HEAVE),
    _word("standard deviation of delayed heave", Kind.UINT16, "m", 1000, lambda m: _delayed(m)[1]),
    _word("age of delayed heave", Kind.UINT16, "s", 100, lambda m: _delayed(m)[2]),
    _word("significant height", Kind.UINT16, "m", 100, lambda m: m.sea.significant_height_m if m.sea else nan),
    _word("peak period", Kind.UINT16, "s", 100, lambda m: m.sea.peak_period_s if m.sea else nan),
    _word("mean period", Kind.UINT16, "s", 100, lambda m: m.sea.mean_period_s if m.sea else nan),
    _word("revision of the map", Kind.UINT16, "", 1, lambda _: REVISION),
    _word("horizons", Kind.UINT16, "", 1, lambda m: m.horizons),
    _word("points", Kind.UINT16, "", 1, lambda m: len(m.points)),
)

_NO_FORECAST: Final = (nan, nan)
_NO_ROCK: Final = RockPrediction(horizon_s=nan)


def of_horizon(horizon_s: float) -> tuple[Register, ...]:
    """What is foreseen for a moment so long after the sample: six words."""
    key, within = _key(horizon_s), f"in {horizon_s:g} s"

    def heave(m: Moment) -> tuple[float, float]:
        return m.forecast.get(key, _NO_FORECAST)

    def rock(m: Moment) -> RockPrediction:
        return m.rock.get(key, _NO_ROCK)

    return (
        _word(f"heave {within}", Kind.INT16, "m", 1000, lambda m: heave(m)[0], Axis.HEAVE),
        _word(f"its standard deviation {within}", Kind.UINT16, "m", 1000, lambda m: heave(m)[1]),
        _word(f"roll {within}", Kind.INT16, "deg", 100, lambda m: degrees(rock(m).roll_rad), Axis.ROLL),
        _word(f"standard deviation of roll {within}", Kind.UINT16, "deg", 100, lambda m: degrees(rock(m).roll_std_rad)),
        _word(f"pitch {within}", Kind.INT16, "deg", 100, lambda m: degrees(rock(m).pitch_rad), Axis.PITCH),
        _word(
            f"standard deviation of pitch {within}", Kind.UINT16, "deg", 100, lambda m: degrees(rock(m).pitch_std_rad)
        ),
    )


def of_point(number: int, name: str) -> tuple[Register, ...]:
    """A monitoring point: four words."""
    return (
        _word(f"heave of {name}", Kind.INT16, "m", 1000, lambda m: m.points[number].heave_m, Axis.HEAVE),
        _word(
            f"heave velocity of {name}",
            Kind.INT16,
            "m/s",
            1000,
            lambda m: m.points[number].heave_velocity_mps,
            Axis.HEAVE,
        ),
        _word(f"standard deviation of heave of {name}", Kind.UINT16, "m", 1000, lambda m: m.points[number].heave_std_m),
        _word(f"quality of {name}", Kind.UINT16, "", 1, lambda m: _quality(m.points[number])),
    )


def _key(horizon_s: float) -> float:
    return round(horizon_s, 6)


def table(horizons_s: Sequence[float], points: Sequence[str]) -> tuple[Register, ...]:
    """All entries in their order; ``points``: names of the monitoring points."""
    return (
        *FIXED,
        *(register for horizon_s in horizons_s for register in of_horizon(horizon_s)),
        *(register for number, name in enumerate(points) for register in of_point(number, name)),
    )


# ---- words -----------------------------------------------------------------------------------------------------------


class RegisterMap:
    """The words of ``[registers]`` at any moment, of the newest frame; told every frame.

    Attributes:
        registers: the table.
        words: how many there are.
    """

    def __init__(self, params: RegistersParams, points: Sequence[str], utc_s: Callable[[float], float]) -> None:
        """``points``: names of all monitoring points. ``utc_s``: UTC, seconds since 1970, of a time on the clock of the
        frames.
        """
        self.registers = table(params.horizons_s, points)
        self.words = sum(register.kind.words for register in self.registers)
        self._point, self._lead, self._points, self._utc_s = params.point, params.lead, tuple(points), utc_s
        self._horizons = len(params.horizons_s)
        down = {
            Axis.HEAVE: params.heave_positive is HeavePositive.DOWN,
            Axis.ROLL: params.roll_positive is RollPositive.STARBOARD_UP,
            Axis.PITCH: params.pitch_positive is PitchPositive.BOW_DOWN,
        }
        self._rows = [
            (
                register.value,
                -register.per_unit if down.get(register.axis) else register.per_unit,
                register.kind.least - 0.5,
                register.kind.most + 0.5,
                register.kind.unknown,
                0xFFFF if register.kind.words == 1 else 0xFFFF_FFFF,
            )
            for register in self.registers
        ]
        self._format = struct.Struct(">" + "".join("H" if r.kind.words == 1 else "I" for r in self.registers))
        self._frame: MotionFrame | None = None
        self._counter = 0
        self._made, self._made_s = b"", -inf

    def push(self, frame: MotionFrame) -> None:
        """The newest frame: the counter goes on."""
        self._frame = frame
        self._counter = (self._counter + 1) % _WRAP
        self._made_s = -inf

    def at(self, now_s: float) -> bytes:
        """All words of one moment, high byte first: two bytes for each of :attr:`words`."""
        if not 0.0 <= now_s - self._made_s < _FRESH_S:
            self._made, self._made_s = self.encode(self._moment(now_s)), now_s
        return self._made

    def encode(self, moment: Moment) -> bytes:
        """The words that say this."""
        return self._format.pack(
            *[
                round(scaled) & mask if least < (scaled := value(moment) * per_unit) < most else unknown
                for value, per_unit, least, most, unknown, mask in self._rows
            ]
        )

    def _moment(self, now_s: float) -> Moment:
        frame = self._frame
        if frame is None or not abs(now_s - frame.t_s) <= LONGEST_S:
            # Whatever it said then, it says nothing of now.
            age_s = nan if frame is None else now_s - frame.t_s
            nothing = Motion(utc_s=nan, age_s=age_s, state=HeaveState.INVALID)
            return Moment(
                counter=self._counter,
                motion=nothing,
                points=(nothing,) * len(self._points),
                forecast={},
                rock={},
                sea=None,
                horizons=self._horizons,
            )
        motion = motion_at(frame, self._point, self._lead, now_s, self._utc_s)
        return Moment(
            counter=self._counter,
            motion=motion,
            points=tuple([motion_at(frame, name, self._lead, now_s, self._utc_s) for name in self._points]),
            forecast={_key(horizon_s): (heave_m, std_m) for horizon_s, heave_m, std_m in motion.forecast},
            rock={_key(one.horizon_s): one for one in frame.rock},
            sea=frame.sea,
            horizons=self._horizons,
        )
