"""EM Attitude 1000 and 3000. Oracle: the maker's frame and map, and a reader written from them."""

from __future__ import annotations

from math import degrees, inf, isfinite, nan, radians

import msgspec
import pytest
from any_motion import is_told, motions, says, spec_of
from hypothesis import given
from hypothesis import strategies as st
from telegram_parsers import parse_em

from heaved.outputs.motion import Lead, Motion
from heaved.outputs.telegrams.em import EM1000, EM3000
from heaved.outputs.telegrams.spec import Settling, Telegram
from heaved.samples import HeaveState

GOOD = Motion(
    utc_s=1.7e9, age_s=0.01, state=HeaveState.VALID, heave_m=0.16,
    roll_rad=radians(0.60), pitch_rad=radians(3.25), yaw_rad=radians(3.02),
)  # fmt: skip
ATTITUDE_AND_HEADING = "3c00 4501 {} 2e01"


def em3000(motion: Motion, settling: Settling = Settling.DEGRADED) -> bytes:
    return EM3000.encode(motion, spec_of(Telegram.EM3000, settling=settling))


def em1000(motion: Motion, settling: Settling = Settling.DEGRADED) -> bytes:
    return EM1000.encode(motion, spec_of(Telegram.EM1000, settling=settling))


def test_the_frame_that_the_maker_prints() -> None:
    assert em3000(GOOD) == bytes.fromhex("90 90 3C00 4501 1000 2E01")
    assert em1000(GOOD) == bytes.fromhex("00 90 3C00 4501 1000 2E01")


@pytest.mark.parametrize(
    ("changed", "settling", "frame"),
    [
        ({"state": HeaveState.DEGRADED}, Settling.DEGRADED, "91 90 3c00 4501 1000 2e01"),
        ({"state": HeaveState.SETTLING}, Settling.DEGRADED, "9a 90 3c00 4501 1000 2e01"),
        ({"state": HeaveState.SETTLING}, Settling.ERROR, "a0 90 3c00 4501 ff7f 2e01"),
        ({"state": HeaveState.INVALID}, Settling.DEGRADED, "a0 90 3c00 4501 ff7f 2e01"),
        ({"heave_m": nan}, Settling.DEGRADED, "a0 90 3c00 4501 ff7f 2e01"),
        ({"heave_m": -9.99}, Settling.DEGRADED, "90 90 3c00 4501 19fc 2e01"),
        ({"heave_m": 9.996}, Settling.DEGRADED, "a0 90 3c00 4501 ff7f 2e01"),
        ({"heave_m": -12.0}, Settling.DEGRADED, "a0 90 3c00 4501 ff7f 2e01"),
        ({"roll_rad": nan}, Settling.DEGRADED, "a0 90 ff7f 4501 1000 2e01"),
        ({"pitch_rad": -inf}, Settling.DEGRADED, "a0 90 3c00 ff7f 1000 2e01"),
        ({"roll_rad": radians(-179.99)}, Settling.DEGRADED, "90 90 b1b9 4501 1000 2e01"),
        ({"yaw_rad": nan}, Settling.DEGRADED, "90 90 3c00 4501 1000 ffff"),
        ({"yaw_rad": radians(-0.01)}, Settling.DEGRADED, "90 90 3c00 4501 1000 9f8c"),  # 359.99
        ({"yaw_rad": radians(359.996)}, Settling.DEGRADED, "90 90 3c00 4501 1000 0000"),
        ({"yaw_rad": radians(723.02)}, Settling.DEGRADED, "90 90 3c00 4501 1000 2e01"),
    ],
)
def test_what_is_not_known_or_does_not_fit(changed: dict[str, object], settling: Settling, frame: str) -> None:
    expected = bytes.fromhex(frame)
    motion = msgspec.structs.replace(GOOD, **changed)
    assert em3000(motion, settling) == expected
    # Without a status, it is all or nothing.
    assert em1000(motion, settling) == (b"" if expected[0] == 0xA0 else b"\0" + expected[1:])


def test_they_are_for_the_moment_of_transmission() -> None:
    assert EM1000.lead is EM3000.lead is Lead.TRANSMISSION


@given(motions(), st.sampled_from(Settling))
def test_a_reader_gets_the_motion_or_is_told_that_it_is_not_known(motion: Motion, settling: Settling) -> None:
    telegram = em3000(motion, settling)
    assert len(telegram) == EM3000.longest_bytes == EM1000.longest_bytes == 10
    told = parse_em(telegram)
    heave_m = motion.heave_m if is_told(motion, spec_of(Telegram.EM3000, settling=settling)) else nan
    assert says(told.heave_m, heave_m, 9.99, 0.005)
    assert says(told.roll_deg, degrees(motion.roll_rad), 179.99, 0.005)
    assert says(told.pitch_deg, degrees(motion.pitch_rad), 179.99, 0.005)
    if told.heading_deg is None:
        assert not abs(motion.yaw_rad) < 10_000.0
    else:
        assert isfinite(motion.yaw_rad)
        off_deg = (told.heading_deg - degrees(motion.yaw_rad)) % 360.0
        assert min(off_deg, 360.0 - off_deg) <= 0.005 + 1e-8
    is_whole = None not in (told.heave_m, told.roll_deg, told.pitch_deg)
    assert (told.status >= 0xA0) == (not is_whole)
    if is_whole:
        assert (told.status == 0x90) == (motion.state is HeaveState.VALID)
    assert em1000(motion, settling) == (b"\0" + telegram[1:] if is_whole else b"")
