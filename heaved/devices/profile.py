"""Register profiles: what the registers of a Modbus sensor mean, in both directions. Pure: no bus, no clock.

A profile lists blocks of neighbouring registers, each read in one request, and the fields in them. ``decode`` turns
registers into the values of :mod:`heaved.samples`, ``encode`` turns values into registers (the simulator's side).
"""

from __future__ import annotations

import struct
import sys
from functools import lru_cache
from math import isfinite, isnan, pi
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec

from heaved.samples import GRAVITY_MPS2, Fault

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

RegisterType = Literal["int16", "uint16", "int32", "uint32", "float32"]
ByteOrder = Literal["ABCD", "DCBA", "BADC", "CDAB"]
Unit = Literal["m/s2", "g", "m", "cm", "mm", "deg", "rad", "deg/s", "rad/s", "m/s", "kn", "degC", "s", "ms", "us", "1"]
Quantity = Literal[
    "ax_mps2", "ay_mps2", "az_mps2",
    "roll_rad", "pitch_rad", "yaw_rad",
    "gx_radps", "gy_radps", "gz_radps",
    "laser_m",
    "heave_m", "heave_velocity_mps", "speed_mps", "flap_fore_rad", "flap_aft_rad",
    "slew_rad", "boom_rad", "jib_rad", "line_out_m",
    "temperature_c", "signal", "device_time_s",
]  # fmt: skip
Role = Literal["imu", "laser", "imu2", "craft", "heave_sensor", "pitch_sensor", "crane", "reference_mru"]
MountAngle = Annotated[float, msgspec.Meta(ge=-360, le=360)]
Bias = Annotated[float, msgspec.Meta(ge=-5, le=5)]
Name = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_.-]{1,64}\Z")]


class Field(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One value: ``si = sign * to_si(unit, raw * scale + offset_value)``, where ``scale_from`` names a register whose
    number belongs to the scale.
    """

    quantity: Quantity
    offset: Annotated[int, msgspec.Meta(ge=0, le=124)]
    """First register, counted from the block's start."""
    type: RegisterType = "int16"
    byte_order: ByteOrder = "ABCD"
    """Order in which the bytes of the value stand on the line; AB for 16 bits is big-endian, as Modbus has it."""
    scale: float = 1.0
    scale_from: Annotated[int, msgspec.Meta(ge=0, le=124)] | None = None
    """A register of the block that holds a factor of the scale (uint16): of a sensor that tells its own range."""
    offset_value: float = 0.0
    unit: Unit = "1"
    sign: Literal[1, -1] = 1
    min: float | None = None
    """Smallest plausible value, in ``unit``, before the sign; outside is a fault, never a value."""
    max: float | None = None
    raw_min: float | None = None
    """The same of the number in the register: a sensor's codes for "no reading" are outside."""
    raw_max: float | None = None


class Block(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Neighbouring registers, read in one request."""

    function: Literal["holding", "input"] = "holding"
    start: Annotated[int, msgspec.Meta(ge=0, le=65535)]
    fields: Annotated[tuple[Field, ...], msgspec.Meta(min_length=1)]


Index = Annotated[int, msgspec.Meta(ge=1, le=80)]
Columns = tuple[Annotated[int, msgspec.Meta(ge=1, le=512)], Annotated[int, msgspec.Meta(ge=1, le=512)]]
"""First and last character, counted from 1, as manuals do."""


class SentenceField(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One value: ``si = sign * to_si(unit, number * scale + offset_value)``."""

    quantity: Quantity
    index: Index | None = None
    """Which of the values after the header, from 1; or"""
    columns: Columns | None = None
    """which characters of a line of fixed columns; or"""
    transducer: Annotated[str, msgspec.Meta(pattern=r"^[!-)+.-~]{1,32}\Z")] | None = None
    """the identifier that stands behind the number and its unit, as XDR has it."""
    scale: float = 1.0
    offset_value: float = 0.0
    unit: Unit = "1"
    sign: Literal[1, -1] = 1
    min: float | None = None
    """Smallest plausible value, in ``unit``, before the sign; outside is a fault, never a value."""
    max: float | None = None

    def __post_init__(self) -> None:
        if (self.index, self.columns, self.transducer).count(None) != 2:
            raise ValueError("give index, columns or transducer, one of the three")


class Condition(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What must stand at a place of a sentence: else what it says of these quantities counts as not known."""

    index: Index | None = None
    columns: Columns | None = None
    """The one or the other, as of a value."""
    one_of: Annotated[tuple[Annotated[str, msgspec.Meta(max_length=32)], ...], msgspec.Meta(min_length=1)]
    """Capitals and small letters are told apart."""
    quantities: tuple[Quantity, ...] = ()
    """Left out: all of them."""

    def __post_init__(self) -> None:
        if (self.index is None) == (self.columns is None):
            raise ValueError("give index or columns, one of the two")


class Sentence(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One kind of sentence, and what is taken from it."""

    header: Annotated[str, msgspec.Meta(pattern=r"^[!-)+-~]{1,32}\Z")]
    """All up to the first separator, or to a later one (``$PSXN,23``); a ``-`` stands for any character, as in
    ``$--XDR``. Of a line of fixed columns, how it begins."""
    length: Annotated[int, msgspec.Meta(ge=1, le=512)] | None = None
    """Characters of a line of fixed columns, without its end; None: values stand between separators."""
    separator: Annotated[str, msgspec.Meta(pattern=r"^[ ,;:|\t]\Z")] = ","
    checksum: Literal["optional", "required"] = "optional"
    fields: Annotated[tuple[SentenceField, ...], msgspec.Meta(min_length=1)]
    conditions: tuple[Condition, ...] = ()

    def __post_init__(self) -> None:
        if self.header.endswith(self.separator):
            raise ValueError("header ends with the separator: write what stands before it")
        places: tuple[SentenceField | Condition, ...] = (*self.fields, *self.conditions)
        for place in places:
            if (place.columns is None) != (self.length is None):
                raise ValueError("columns are for a line of fixed columns, whose length is given, and nothing else is")
            if place.columns is not None and not place.columns[0] <= place.columns[1] <= (self.length or 0):
                raise ValueError(f"columns {list(place.columns)} are not first and last of {self.length}")
        if self.length is not None and self.checksum == "required":
            raise ValueError("a line of fixed columns has no checksum")


class BandwidthRegister(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The holding register that sets a sensor's bandwidth. It is never written: that is for its owner to do."""

    address: Annotated[int, msgspec.Meta(ge=0, le=65535)]
    choices_hz: Annotated[tuple[Annotated[float, msgspec.Meta(gt=0)], ...], msgspec.Meta(min_length=1)]
    """What its values 0, 1, 2, ... mean."""


class Profile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the registers of one kind of device mean."""

    name: str
    description: str = ""
    bandwidth_hz: Annotated[float, msgspec.Meta(ge=0, le=10_000)] = 0.0
    """Corner of the low-pass of its accelerometers and gyros, as delivered; 0: not known."""
    bandwidth_register: BandwidthRegister | None = None
    blocks: tuple[Block, ...] = ()
    """Of a device that is asked over Modbus,"""
    sentences: tuple[Sentence, ...] = ()
    """and of one that speaks by itself."""


class DeviceSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One ``[[device]]``: what it is, where it is, how often it is asked."""

    name: Name
    role: Role
    link: str
    """``tcp://host:port`` or ``rtu:///dev/ttyUSB0?baudrate=115200&parity=N&stopbits=1`` of a device that is asked;
    ``serial:///dev/ttyUSB0?...``, ``udp-listen://host:port`` or ``tcp://host:port`` of one that speaks by itself."""
    device_id: Annotated[int, msgspec.Meta(ge=0, le=247)] = 1
    profile: Profile
    rate_hz: Annotated[float, msgspec.Meta(gt=0, le=1000)]
    timeout_ms: Annotated[float, msgspec.Meta(ge=1, le=10_000)] = 50.0
    latency_ms: Annotated[float, msgspec.Meta(ge=-1000, le=1000)] = 0.0
    """Sample time minus the time at which the request was sent; negative for a device that answers old values."""
    stuck_after_s: Annotated[float, msgspec.Meta(ge=0, le=3600)] = 2.0
    """Identical registers for longer than this are a fault (0: never). In role "crane" they are not: a crane stands
    still, and its encoders with it; nor in role "reference_mru", which tells whole centimetres."""
    bandwidth_hz: Annotated[float, msgspec.Meta(ge=0, le=10_000)] = 0.0
    """To which the sensor's low-pass is set; 0: as its profile says."""
    rotation_deg: tuple[MountAngle, MountAngle, MountAngle] = (0.0, 0.0, 0.0)
    """How an IMU is mounted: turned from the vessel's axes by z, then by y, then by x, see
    :mod:`heaved.devices.mounting`."""
    bias_mps2: tuple[Bias, Bias, Bias] = (0.0, 0.0, 0.0)
    """Of its accelerometers, in its own axes; taken off before it is turned."""
    attitude_latency_ms: Annotated[float, msgspec.Meta(ge=-1000, le=1000)] = 0.0
    """By how much its angles are older than the accelerations of the same answer."""
    allow: tuple[str, ...] = ()
    """Networks (CIDR) whose sentences are taken on a ``udp-listen`` link, besides those of this machine."""

    @property
    def is_asked(self) -> bool:
        """Whether it is polled over Modbus; else it speaks by itself."""
        return not self.profile.sentences


# ---- codec -----------------------------------------------------------------------------------------------------------

MAX_REGISTERS = 125
"""Most registers that one read may ask for (Modbus application protocol V1.1b3, 6.3)."""

SI: dict[str, tuple[float, str]] = {
    "m/s2": (1.0, "acceleration"),
    "g": (GRAVITY_MPS2, "acceleration"),
    "m": (1.0, "length"),
    "cm": (1e-2, "length"),
    "mm": (1e-3, "length"),
    "rad": (1.0, "angle"),
    "deg": (pi / 180.0, "angle"),
    "rad/s": (1.0, "angular rate"),
    "deg/s": (pi / 180.0, "angular rate"),
    "m/s": (1.0, "speed"),
    "kn": (1852.0 / 3600.0, "speed"),
    "degC": (1.0, "temperature"),
    "s": (1.0, "time"),
    "ms": (1e-3, "time"),
    "us": (1e-6, "time"),
    "1": (1.0, "number"),
}
"""Unit -> factor to SI (degrees Celsius stay), and what kind of thing it measures."""

_KIND: dict[str, str] = {
    **dict.fromkeys(("ax_mps2", "ay_mps2", "az_mps2"), "acceleration"),
    **dict.fromkeys(("roll_rad", "pitch_rad", "yaw_rad"), "angle"),
    **dict.fromkeys(("gx_radps", "gy_radps", "gz_radps"), "angular rate"),
    **dict.fromkeys(("laser_m", "heave_m", "line_out_m"), "length"),
    **dict.fromkeys(("speed_mps", "heave_velocity_mps"), "speed"),
    **dict.fromkeys(("flap_fore_rad", "flap_aft_rad", "slew_rad", "boom_rad", "jib_rad"), "angle"),
    "temperature_c": "temperature",
    "signal": "number",
    "device_time_s": "time",
}

_CODE: dict[str, str] = {"int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f"}
_FINITE_MAX = sys.float_info.max
_FLOAT32_MAX = 3.4028234663852886e38
_LIMITS: dict[str, tuple[float, float]] = {
    "int16": (-(2**15), 2**15 - 1),
    "uint16": (0, 2**16 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
    "float32": (-_FLOAT32_MAX, _FLOAT32_MAX),
}
_ROLE_QUANTITIES: dict[Role, tuple[Quantity, ...]] = {
    "imu": ("ax_mps2", "ay_mps2", "az_mps2", "roll_rad", "pitch_rad", "yaw_rad", "gx_radps", "gy_radps", "gz_radps"),
    "laser": ("laser_m",),
    "imu2": ("gx_radps", "gy_radps", "gz_radps"),
    "craft": ("heave_m", "pitch_rad", "speed_mps", "flap_fore_rad", "flap_aft_rad"),
    "heave_sensor": ("heave_m",),
    "pitch_sensor": ("pitch_rad",),
    "crane": ("slew_rad", "boom_rad", "jib_rad", "line_out_m"),
    "reference_mru": ("heave_m", "heave_velocity_mps", "roll_rad", "pitch_rad", "yaw_rad"),
}
_ROLE_NEEDS: dict[Role, tuple[Quantity, ...]] = {
    "imu": ("az_mps2",),
    "laser": ("laser_m",),
    "imu2": ("gx_radps", "gy_radps", "gz_radps"),
    "craft": (),
    "heave_sensor": ("heave_m",),
    "pitch_sensor": ("pitch_rad",),
    "crane": (),
    "reference_mru": (),
}


def told_together(profile: Profile) -> list[tuple[Quantity, ...]]:
    """The quantities of a profile, by the block or sentence that they stand in."""
    of_blocks = [tuple(field.quantity for field in block.fields) for block in profile.blocks]
    return of_blocks + [tuple(field.quantity for field in sentence.fields) for sentence in profile.sentences]


def role_quantities(role: Role) -> tuple[Quantity, ...]:
    """What a device in that role measures; the other quantities (temperature, signal, device time) accompany it."""
    return _ROLE_QUANTITIES[role]


def role_needs(role: Role) -> tuple[Quantity, ...]:
    """Without which a device is of no use in that role. The first of them dates the sample."""
    return _ROLE_NEEDS[role]


def field_registers(field: Field) -> int:
    """Registers that the field takes: 1 or 2."""
    return 1 if field.type in ("int16", "uint16") else 2


def block_registers(block: Block) -> int:
    """Registers to ask for: up to the end of the last field. Gaps between fields are read and ignored."""
    ends = [field.offset + field_registers(field) for field in block.fields]
    return max(ends + [field.scale_from + 1 for field in block.fields if field.scale_from is not None])


def si_step(field: Field) -> float:
    """Resolution of an integer field in SI units: what one count of the register means."""
    return abs(field.scale) * SI[field.unit][0] if field.type != "float32" else 0.0


class Decoded(msgspec.Struct, frozen=True):
    """What the registers of one block say: every value in SI units, or a fault and no values at all."""

    values: dict[Quantity, float]
    fault: Fault = Fault.NONE
    detail: str = ""
    """What, where, what to do; empty when well."""


class _Group:
    """Fields of one block that one ``struct`` format reads: all big-endian, or all little-endian.

    The four byte orders are two choices: the bytes within the value (ABCD, CDAB big; DCBA, BADC little) and the order
    in which its two registers are picked (as they stand, or swapped). A 16-bit value has only the first.
    """

    def __init__(self, fields: list[Field], little: bool) -> None:
        self.fields = fields
        self.indices: list[int] = []
        for field in fields:
            registers = list(range(field.offset, field.offset + field_registers(field)))
            if field.byte_order in ("CDAB", "BADC"):
                registers.reverse()
            self.indices += registers
        self.words = struct.Struct(f">{len(self.indices)}H")
        self.numbers = struct.Struct(("<" if little else ">") + "".join(_CODE[field.type] for field in fields))
        self.steps = [
            (
                field.quantity,
                field.scale,
                field.offset_value,
                # The largest finite number stands for "no limit", so that one comparison refuses inf and nan too.
                -_FINITE_MAX if field.min is None else max(field.min, -_FINITE_MAX),
                _FINITE_MAX if field.max is None else min(field.max, _FINITE_MAX),
                field.sign * SI[field.unit][0],
                field,
            )
            for field in fields
        ]


class BlockCodec:
    """Registers of one block to values and back; compiled once, because a fast sensor is decoded hundreds of times a
    second on the daemon's only loop.
    """

    def __init__(self, block: Block) -> None:
        self.block = block
        self.registers = block_registers(block)
        rare = [field for field in block.fields if _is_rare(field)]
        big = [field for field in block.fields if field.byte_order in ("ABCD", "CDAB") and field not in rare]
        little = [field for field in block.fields if field.byte_order in ("DCBA", "BADC") and field not in rare]
        self._groups = [_Group(fields, fields is little) for fields in (big, little) if fields]
        self._rare = [_Group([field], field.byte_order in ("DCBA", "BADC")) for field in rare]

    def decode(self, registers: Sequence[int]) -> Decoded:
        """Values in SI units; a wrong length, a non-finite float or an implausible value is a fault, not a value.

        Raises:
            struct.error: a register is not within 0..65535.
        """
        if len(registers) != self.registers:
            return Decoded({}, Fault.LENGTH, f"{len(registers)} registers instead of {self.registers} {self._where()}")
        values: dict[Quantity, float] = {}
        for group in self._groups:
            raw = group.numbers.unpack(group.words.pack(*[registers[i] for i in group.indices]))
            for number, (quantity, scale, offset_value, low, high, factor, field) in zip(raw, group.steps, strict=True):
                value = number * scale + offset_value
                if not low <= value <= high:
                    return self._implausible(field, value)
                values[quantity] = value * factor
        for group in self._rare:
            (number,) = group.numbers.unpack(group.words.pack(*[registers[i] for i in group.indices]))
            ((quantity, scale, offset_value, low, high, factor, field),) = group.steps
            if fault := self._no_reading(field, number, registers):
                return fault
            scale *= 1 if field.scale_from is None else registers[field.scale_from]
            value = number * scale + offset_value
            if not low <= value <= high:
                return self._implausible(field, value)
            values[quantity] = value * factor
        return Decoded(values)

    def encode(self, values: Mapping[Quantity, float]) -> list[int]:
        """Registers that ``decode`` turns back into ``values``, but for quantisation.

        Integers are rounded to the nearest and saturate at the limits of their type, float32 at its largest finite
        value. A register that holds a factor of the scale gets the smallest one of 1, 2, 5, 10, 20, ... with which the
        value can be told: ranges are such numbers, and stay while the value moves.
        Fields without a value, and gaps, are zero.

        Raises:
            ValueError: nan for an integer field.
        """
        registers = [0] * self.registers
        for group in self._rare:
            (field,) = group.fields
            if field.quantity in values:
                raw_value, factor = _raw_and_factor(field, values[field.quantity])
                if field.scale_from is not None:
                    registers[field.scale_from] = factor
                for index, word in zip(group.indices, group.words.unpack(group.numbers.pack(raw_value)), strict=True):
                    registers[index] = word
        for group in self._groups:
            raw = [_raw(field, values[field.quantity]) if field.quantity in values else 0 for field in group.fields]
            for index, word in zip(group.indices, group.words.unpack(group.numbers.pack(*raw)), strict=True):
                registers[index] = word
        return registers

    def _where(self) -> str:
        last = self.block.start + self.registers - 1
        return f"({self.block.function} registers {self.block.start}..{last})"

    def _no_reading(self, field: Field, number: float, registers: Sequence[int]) -> Decoded | None:
        """What is wrong with the number itself, or with the register of its scale; None: nothing."""
        low = field.raw_min if field.raw_min is not None else -_FINITE_MAX
        high = field.raw_max if field.raw_max is not None else _FINITE_MAX
        where = self._place(field)
        if isfinite(number) and not low <= number <= high:
            limits = [f"{one:g}" if one is not None else "any" for one in (field.raw_min, field.raw_max)]
            hint = "the sensor has no reading (out of its range?)"
            detail = f"{where} holds {number:.6g}, outside {'..'.join(limits)}: {hint}"
            return Decoded({}, Fault.OUT_OF_RANGE, detail)
        if field.scale_from is not None and registers[field.scale_from] == 0:
            register = self.block.start + field.scale_from
            detail = f"{where}: its scale, register {register}, is 0: is the profile's map that of this sensor?"
            return Decoded({}, Fault.OUT_OF_RANGE, detail)
        return None

    def _place(self, field: Field) -> str:
        return f"{field.quantity} ({self.block.function} register {self.block.start + field.offset})"

    def _implausible(self, field: Field, value: float) -> Decoded:
        where = self._place(field)
        if not isfinite(value):
            hint = "the sensor has no reading, or the profile's byte order or address is wrong"
            return Decoded({}, Fault.NOT_FINITE, f"{where} is {value}: {hint}")
        low = "-inf" if field.min is None else f"{field.min:g}"
        high = "inf" if field.max is None else f"{field.max:g}"
        detail = f"{where} is {value:.6g}, outside {low}..{high} {field.unit}: check the sensor, or the profile's map"
        return Decoded({}, Fault.OUT_OF_RANGE, detail)


def _is_rare(field: Field) -> bool:
    """Whether it has what few have, and is decoded apart, so that the others do not wait for it."""
    return any(one is not None for one in (field.scale_from, field.raw_min, field.raw_max))


_RANGES = (*(digit * 10**power for power in range(5) for digit in (1, 2, 5)), 65535)
"""Factors of a scale that a register may hold."""


def _raw_and_factor(field: Field, si: float) -> tuple[float, int]:
    """The number for a value in SI units, and what stands in the register of its scale (1: there is none)."""
    factor = 1
    if field.scale_from is not None:
        most = _LIMITS[field.type][1] if field.raw_max is None else field.raw_max
        whole = (si / (field.sign * SI[field.unit][0]) - field.offset_value) / field.scale
        if isfinite(whole):
            factor = next((one for one in _RANGES if one * most >= abs(whole)), _RANGES[-1])
    return _raw(msgspec.structs.replace(field, scale=field.scale * factor), si), factor


def _raw(field: Field, si: float) -> float:
    """The number that stands in the registers for a value in SI units."""
    raw = (si / (field.sign * SI[field.unit][0]) - field.offset_value) / field.scale
    if isnan(raw) and field.type != "float32":
        raise ValueError(f"{field.quantity}: {field.type} registers cannot say nan")
    low, high = _LIMITS[field.type]
    raw = raw if isnan(raw) else min(max(raw, low), high)
    return raw if field.type == "float32" else round(raw)


@lru_cache(maxsize=256)
def codec(block: Block) -> BlockCodec:
    """The compiled codec of a block. Looking it up costs more than decoding: keep it where it is used often."""
    return BlockCodec(block)


def decode(block: Block, registers: Sequence[int]) -> Decoded:
    """See :meth:`BlockCodec.decode`."""
    return codec(block).decode(registers)


def encode(block: Block, values: Mapping[Quantity, float]) -> list[int]:
    """See :meth:`BlockCodec.encode`."""
    return codec(block).encode(values)


# ---- validation ------------------------------------------------------------------------------------------------------


def profile_faults(profile: Profile) -> list[str]:
    """Everything that is wrong with a profile beyond its types, one message each; empty when it is sound."""
    faults: list[str] = []
    if bool(profile.blocks) == bool(profile.sentences):
        one = "has both blocks and" if profile.blocks else "has neither blocks nor"
        faults.append(
            f"profile {profile.name}: {one} sentences: blocks are for a device that is asked over Modbus, "
            "sentences for one that speaks by itself"
        )
    carried: dict[str, str] = {}
    for number, block in enumerate(profile.blocks):
        where = f"profile {profile.name}: block {number} ({block.function}, start {block.start})"
        length = block_registers(block)
        if length > MAX_REGISTERS:
            faults.append(f"{where}: {length} registers, but one read carries {MAX_REGISTERS} at most: split the block")
        if block.start + length > 65536:
            faults.append(f"{where}: ends beyond register 65535")
        taken: dict[int, str] = {}
        for field in block.fields:
            faults += [f"{where}: {field.quantity}: {message}" for message in _field_faults(field)]
            if field.quantity in carried:
                faults.append(f"{where}: {field.quantity} is given twice: also in {carried[field.quantity]}")
            else:
                carried[field.quantity] = f"block {number}"
            registers = range(field.offset, field.offset + field_registers(field))
            if field.scale_from in registers:
                faults.append(f"{where}: {field.quantity}: scale_from is a register of the value itself")
            clashes = sorted({taken[register] for register in registers if register in taken})
            faults += [f"{where}: {field.quantity} overlaps {other} (offset {field.offset})" for other in clashes]
            taken.update(dict.fromkeys(registers, field.quantity))
    for sentence in profile.sentences:
        where = f"profile {profile.name}: sentence {sentence.header}"
        names = [value.quantity for value in sentence.fields]
        faults += [
            f"{where}: a condition is of {name}, which no field gives"
            for condition in sentence.conditions
            for name in condition.quantities
            if name not in names
        ]
        faults += [f"{where}: {name} is given twice" for name in sorted({n for n in names if names.count(n) > 1})]
        faults += [f"{where}: {value.quantity}: {fault}" for value in sentence.fields for fault in _field_faults(value)]
    headers = [sentence.header for sentence in profile.sentences]
    faults += [
        f"profile {profile.name}: sentence {header} is given twice: write its fields together"
        for header in sorted({header for header in headers if headers.count(header) > 1})
    ]
    return faults


def _field_faults(field: Field | SentenceField) -> list[str]:
    faults = []
    kind = SI[field.unit][1]
    if kind != _KIND[field.quantity]:
        faults.append(f"unit {field.unit!r} measures {kind}, not {_KIND[field.quantity]}")
    if field.scale == 0.0 or not isfinite(field.scale):
        faults.append(f"scale is {field.scale}; it must be finite and not 0")
    if not isfinite(field.offset_value):
        faults.append(f"offset_value is {field.offset_value}; it must be finite")
    if any(limit is not None and isnan(limit) for limit in (field.min, field.max)):
        faults.append("min and max must be numbers")
    elif field.min is not None and field.max is not None and field.min > field.max:
        faults.append(f"min {field.min:g} is above max {field.max:g}")
    if isinstance(field, Field):
        raw = (field.raw_min, field.raw_max)
        if any(limit is not None and not isfinite(limit) for limit in raw):
            faults.append("raw_min and raw_max must be finite numbers")
        elif raw[0] is not None and raw[1] is not None and raw[0] > raw[1]:
            faults.append(f"raw_min {raw[0]:g} is above raw_max {raw[1]:g}")
    return faults
