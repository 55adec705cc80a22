"""The register codec: byte orders against numbers written out by hand, round trips against the quantisation bound."""

from __future__ import annotations

import math
import struct
from typing import Any, Literal

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heaved.devices.profile import (
    Block,
    ByteOrder,
    Field,
    Profile,
    Quantity,
    RegisterType,
    Unit,
    block_registers,
    decode,
    encode,
    profile_faults,
    si_step,
)
from heaved.samples import Fault

ORDERS: tuple[ByteOrder, ...] = ("ABCD", "DCBA", "BADC", "CDAB")
LIMITS: dict[RegisterType, tuple[int, int]] = {
    "int16": (-32768, 32767),
    "uint16": (0, 65535),
    "int32": (-(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
}


def one(quantity: Quantity = "signal", **settings: Any) -> Block:
    return Block(start=0, fields=(Field(quantity=quantity, offset=0, **settings),))


# 305419896 = 0x12345678: the bytes A, B, C, D are 12, 34, 56, 78.
@pytest.mark.parametrize(
    ("order", "registers"),
    [
        ("ABCD", [0x1234, 0x5678]),
        ("DCBA", [0x7856, 0x3412]),
        ("BADC", [0x3412, 0x7856]),
        ("CDAB", [0x5678, 0x1234]),
    ],
)
def test_byte_orders_of_32_bits(order: str, registers: list[int]) -> None:
    block = one(type="uint32", byte_order=order)
    assert decode(block, registers).values == {"signal": 305419896.0}
    assert encode(block, {"signal": 305419896.0}) == registers


@pytest.mark.parametrize(
    ("order", "register"), [("ABCD", 0xFF38), ("CDAB", 0xFF38), ("DCBA", 0x38FF), ("BADC", 0x38FF)]
)
def test_byte_orders_of_16_bits(order: str, register: int) -> None:
    block = one(type="int16", byte_order=order)
    assert decode(block, [register]).values == {"signal": -200.0}
    assert encode(block, {"signal": -200.0}) == [register]


@pytest.mark.parametrize(
    ("unit", "quantity", "raw", "si"),
    [
        ("m/s2", "az_mps2", 5, 5.0),
        ("g", "az_mps2", 1, 9.80665),
        ("m", "laser_m", 3, 3.0),
        ("cm", "laser_m", 250, 2.5),
        ("mm", "laser_m", 1803, 1.803),
        ("deg", "roll_rad", 180, math.pi),
        ("rad", "roll_rad", 1, 1.0),
        ("deg/s", "gx_radps", 90, math.pi / 2),
        ("rad/s", "gx_radps", 2, 2.0),
        ("degC", "temperature_c", 21, 21.0),
        ("s", "device_time_s", 7, 7.0),
        ("ms", "device_time_s", 1500, 1.5),
        ("us", "device_time_s", 2000, 0.002),
        ("1", "signal", 42, 42.0),
    ],
)
def test_units(unit: Unit, quantity: Quantity, raw: int, si: float) -> None:
    assert decode(one(quantity, unit=unit), [raw]).values == {quantity: pytest.approx(si, rel=1e-15)}


def test_scale_offset_and_sign() -> None:
    block = one("pitch_rad", unit="deg", scale=0.5, offset_value=10.0, sign=-1)
    # -(40 * 0.5 + 10) degrees
    assert decode(block, [40]).values["pitch_rad"] == pytest.approx(-math.radians(30.0))
    assert encode(block, {"pitch_rad": -math.radians(30.0)}) == [40]


@st.composite
def fields_and_values(draw: st.DrawFn) -> tuple[Block, dict[Quantity, float]]:
    """A block of up to six fields of any type and order, with gaps, and values within the types' reach."""
    units: dict[Quantity, Unit] = {
        "ax_mps2": "g", "ay_mps2": "m/s2", "az_mps2": "g", "roll_rad": "deg", "laser_m": "mm", "signal": "1",
    }  # fmt: skip
    names = draw(st.permutations(list(units)))
    to_si: dict[Unit, float] = {"g": 9.80665, "m/s2": 1.0, "deg": math.pi / 180, "mm": 1e-3, "1": 1.0}
    fields: list[Field] = []
    values: dict[Quantity, float] = {}
    offset = 0
    for name in names[: draw(st.integers(1, 6))]:
        offset += draw(st.integers(0, 3))
        kind: RegisterType = draw(st.sampled_from((*LIMITS, "float32")))
        scale = draw(st.floats(1e-4, 1e3)) * draw(st.sampled_from([1, -1]))
        shift = draw(st.floats(-100.0, 100.0))
        sign: Literal[1, -1] = draw(st.sampled_from((1, -1)))
        raw = draw(st.integers(*LIMITS[kind])) if kind in LIMITS else draw(st.floats(-(2.0**66), 2.0**66, width=32))
        fields.append(Field(
            quantity=name, offset=offset, type=kind, byte_order=draw(st.sampled_from(ORDERS)), scale=scale,
            offset_value=shift, unit=units[name], sign=sign,
        ))  # fmt: skip
        values[name] = sign * (raw * scale + shift) * to_si[units[name]]
        offset += 1 if kind.endswith("16") else 2
    return Block(start=0, fields=tuple(draw(st.permutations(fields)))), values


@given(fields_and_values())
def test_round_trip_up_to_quantisation(case: tuple[Block, dict[Quantity, float]]) -> None:
    block, values = case
    registers = encode(block, values)
    assert len(registers) == block_registers(block)
    assert all(0 <= register <= 65535 for register in registers)
    decoded = decode(block, registers)
    assert decoded.fault is Fault.NONE
    assert set(decoded.values) == set(values)
    for field in block.fields:
        value = values[field.quantity]
        # Half a count of an integer register; 24 bits of mantissa, of the raw number, in a float register.
        si_scale = abs(field.scale) * {"g": 9.80665, "deg": math.pi / 180, "mm": 1e-3}.get(field.unit, 1.0)
        shift = abs(field.offset_value / field.scale)
        bound = si_step(field) / 2 or (abs(value) / si_scale + shift) * si_scale * 2**-23
        assert decoded.values[field.quantity] == pytest.approx(value, abs=1.01 * bound + 1e-9 * abs(value) + 1e-12)


@given(fields_and_values())
def test_encoding_what_was_decoded_gives_the_same_registers(case: tuple[Block, dict[Quantity, float]]) -> None:
    block, values = case
    registers = encode(block, values)
    again = encode(block, decode(block, registers).values)
    integers = [field for field in block.fields if field.type != "float32"]
    for field in integers:
        span = slice(field.offset, field.offset + (1 if field.type.endswith("16") else 2))
        assert again[span] == registers[span]


@pytest.mark.parametrize("kind", list(LIMITS))
def test_integers_saturate(kind: RegisterType) -> None:
    block = one(type=kind)
    low, high = LIMITS[kind]
    for value, limit in ((1e12, high), (-1e12, low), (math.inf, high), (-math.inf, low)):
        assert decode(block, encode(block, {"signal": value})).values["signal"] == limit


def test_float32_saturates_and_says_nan() -> None:
    block = one(type="float32")
    largest = struct.unpack(">f", bytes.fromhex("7f7fffff"))[0]
    assert encode(block, {"signal": 1e300}) == [0x7F7F, 0xFFFF]
    assert decode(block, [0x7F7F, 0xFFFF]).values["signal"] == largest
    assert decode(block, encode(block, {"signal": math.nan})).fault is Fault.NOT_FINITE


def test_integers_cannot_say_nan() -> None:
    with pytest.raises(ValueError, match="signal: int16 registers cannot say nan"):
        encode(one(type="int16"), {"signal": math.nan})


@pytest.mark.parametrize("words", [[0x7FC0, 0], [0x7F80, 0], [0xFF80, 0]], ids=["nan", "inf", "-inf"])
@pytest.mark.parametrize("limits", [{}, {"min": -1e9, "max": 1e9}, {"min": -math.inf, "max": math.inf}])
def test_not_finite_is_a_fault_whatever_the_limits(words: list[int], limits: dict[str, Any]) -> None:
    decoded = decode(one(type="float32", **limits), words)
    assert decoded.fault is Fault.NOT_FINITE
    assert decoded.values == {}
    assert "signal" in decoded.detail


def test_limits_hold_in_the_unit_before_the_sign_and_include_themselves() -> None:
    block = Block(start=0x34, fields=(
        Field(quantity="pitch_rad", offset=1, type="int16", scale=0.1, unit="deg", sign=-1, min=-10.0, max=20.0),
    ))  # fmt: skip
    assert decode(block, [0, 200]).values["pitch_rad"] == pytest.approx(-math.radians(20.0))
    assert decode(block, [0, 0xFF9C]).values["pitch_rad"] == pytest.approx(math.radians(10.0))
    for raw in (201, 0xFF9B):
        decoded = decode(block, [0, raw])
        assert decoded.fault is Fault.OUT_OF_RANGE
        assert decoded.values == {}
    assert "register 53" in decoded.detail
    assert "-10.1" in decoded.detail
    assert "-10..20 deg" in decoded.detail


@pytest.mark.parametrize("registers", [[], [1], [1, 2, 3]])
def test_wrong_length_is_a_fault(registers: list[int]) -> None:
    decoded = decode(one(type="int32"), registers)
    assert decoded.fault is Fault.LENGTH
    assert f"{len(registers)} registers instead of 2" in decoded.detail


def test_every_fault_of_a_profile_is_reported_at_once() -> None:
    profile = Profile(name="bad", blocks=(
        Block(start=65534, fields=(
            Field(quantity="ax_mps2", offset=0, type="int32", unit="g"),
            Field(quantity="ay_mps2", offset=1, unit="deg"),
            Field(quantity="az_mps2", offset=2, unit="g", scale=0.0, min=2.0, max=1.0),
        )),
        Block(start=0, fields=(
            Field(quantity="ax_mps2", offset=0, unit="g", min=math.nan),
            Field(quantity="roll_rad", offset=124, type="float32", unit="deg", offset_value=math.inf),
        )),
    ))  # fmt: skip
    text = "\n".join(profile_faults(profile))
    for words in (
        "ends beyond register 65535",
        "ay_mps2 overlaps ax_mps2",
        "ay_mps2: unit 'deg' measures angle, not acceleration",
        "az_mps2: scale is 0.0",
        "min 2 is above max 1",
        "ax_mps2 is given twice",
        "ax_mps2: min and max must be numbers",
        "126 registers, but one read carries 125",
        "roll_rad: offset_value is inf",
    ):
        assert words in text
    assert len(text.splitlines()) == 9
    assert all("profile bad: block" in line for line in text.splitlines())


# ---- a scale that the device tells itself, and numbers that are none -------------------------------------------------

RANGED = Field(
    quantity="laser_m", offset=1, type="uint16", scale=0.5, scale_from=0, unit="mm", raw_min=1, raw_max=1000,
    offset_value=100.0,
)  # fmt: skip


def test_the_scale_is_read_with_the_value() -> None:
    block = Block(start=10, fields=(RANGED,))
    for factor, raw in ((1, 1), (7, 1000), (65535, 3)):
        decoded = decode(block, [factor, raw])
        assert decoded.values == {"laser_m": pytest.approx((raw * 0.5 * factor + 100.0) / 1000.0)}


@given(st.floats(0.2, 30_000.0))
def test_what_is_told_with_a_scale_is_read_again(laser_m: float) -> None:
    block = Block(start=10, fields=(RANGED,))
    decoded = decode(block, encode(block, {"laser_m": laser_m}))
    assert decoded.values["laser_m"] == pytest.approx(laser_m, rel=2e-3, abs=1e-3)


@pytest.mark.parametrize(
    ("registers", "words"),
    [
        ([5, 0], "laser_m (holding register 11) holds 0, outside 1..1000: the sensor has no reading"),
        ([5, 1001], "holds 1001, outside 1..1000"),
        ([0, 5], "its scale, register 10, is 0"),
    ],
)
def test_numbers_that_are_no_reading(registers: list[int], words: str) -> None:
    decoded = decode(Block(start=10, fields=(RANGED,)), registers)
    assert (decoded.fault, decoded.values) == (Fault.OUT_OF_RANGE, {})
    assert words in decoded.detail


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"scale_from": 1}, "scale_from is a register of the value itself"),
        ({"raw_min": 2.0, "raw_max": 1.0}, "raw_min 2 is above raw_max 1"),
        ({"raw_min": float("nan")}, "raw_min and raw_max must be finite"),
    ],
)
def test_faults_of_such_a_field(changed: dict[str, float], words: str) -> None:
    field = msgspec.structs.replace(RANGED, **changed)
    faults = profile_faults(Profile(name="p", blocks=(Block(start=10, fields=(field,)),)))
    assert any(words in fault for fault in faults)


def test_the_register_of_the_scale_is_asked_for() -> None:
    assert block_registers(Block(start=0, fields=(msgspec.structs.replace(RANGED, scale_from=6),))) == 7
