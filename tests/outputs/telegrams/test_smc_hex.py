"""The hexadecimal heave for drives. Oracle: the maker's examples, and a reader written from his description."""

from __future__ import annotations

from math import inf, nan

import msgspec
import pytest
from any_motion import is_told, motions, spec_of
from hypothesis import given
from hypothesis import strategies as st
from telegram_parsers import parse_smc_hex

from heaved.outputs.motion import Lead, Motion
from heaved.outputs.telegrams.smc_hex import FORMAT, encode
from heaved.outputs.telegrams.spec import Settling, Telegram
from heaved.samples import HeaveState

SPEC = spec_of(Telegram.SMC_HEX)
STILL = Motion(
    utc_s=1.7e9, age_s=0.01, state=HeaveState.VALID,
    heave_m=0.0, heave_velocity_mps=0.0, heave_acceleration_mps2=0.0,
)  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "telegram"),
    [
        ({"heave_acceleration_mps2": -0.010}, b"$SMC00000000FFF6\r\n"),  # the maker's three examples
        ({"heave_m": 0.001}, b"$SMC000100000000\r\n"),
        ({"heave_m": -0.002}, b"$SMCFFFE00000000\r\n"),
        ({"heave_m": 1.234, "heave_velocity_mps": -0.3}, b"$SMC04D2FED40000\r\n"),
        ({"heave_m": 32.766, "heave_velocity_mps": -32.766}, b"$SMC7FFE80020000\r\n"),
        ({"state": HeaveState.DEGRADED, "heave_m": 0.001}, b"$SMC000100000000\r\n"),
        ({"state": HeaveState.SETTLING, "heave_m": 0.001}, b"$SMC000100000000\r\n"),
    ],
)
def test_the_telegram(changed: dict[str, object], telegram: bytes) -> None:
    assert encode(msgspec.structs.replace(STILL, **changed), SPEC) == telegram


@pytest.mark.parametrize(
    ("changed", "settling"),
    [
        ({"state": HeaveState.INVALID}, Settling.DEGRADED),
        ({"state": HeaveState.SETTLING}, Settling.ERROR),
        ({"heave_m": nan}, Settling.DEGRADED),
        ({"heave_velocity_mps": nan}, Settling.DEGRADED),
        ({"heave_acceleration_mps2": nan}, Settling.DEGRADED),
        ({"heave_m": inf}, Settling.DEGRADED),
        ({"heave_m": 32.767}, Settling.DEGRADED),
        ({"heave_m": -32.768}, Settling.DEGRADED),
        ({"heave_velocity_mps": 40.0}, Settling.DEGRADED),
        ({"heave_acceleration_mps2": -1e300}, Settling.DEGRADED),
    ],
)
def test_nothing_is_said_to_a_drive_that_could_not_be_told_that_it_is_not_known(
    changed: dict[str, object], settling: Settling
) -> None:
    assert encode(msgspec.structs.replace(STILL, **changed), spec_of(Telegram.SMC_HEX, settling=settling)) == b""


def test_it_is_for_the_moment_of_transmission_and_at_most_100_times_a_second() -> None:
    assert FORMAT.lead is Lead.TRANSMISSION
    assert FORMAT.most_hz == 100.0


@given(motions(), st.sampled_from(Settling))
def test_a_drive_gets_the_motion_or_nothing(motion: Motion, settling: Settling) -> None:
    telegram = encode(motion, spec_of(Telegram.SMC_HEX, settling=settling))
    values = (motion.heave_m, motion.heave_velocity_mps, motion.heave_acceleration_mps2)
    if telegram == b"":
        assert not is_told(motion, spec_of(Telegram.SMC_HEX, settling=settling)) or not all(
            abs(value) <= 32.766 for value in values
        )
        return
    assert len(telegram) == FORMAT.longest_bytes == 18
    assert is_told(motion, spec_of(Telegram.SMC_HEX, settling=settling))
    told = parse_smc_hex(telegram)
    for said, value in zip((told.heave_m, told.velocity_mps, told.acceleration_mps2), values, strict=True):
        assert said == pytest.approx(value, abs=0.000501)
