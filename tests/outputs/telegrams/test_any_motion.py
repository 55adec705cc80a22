"""What holds for each fixed-width format, with the signs that any output may ask for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import pytest
from any_motion import motions, spec_of
from hypothesis import given
from hypothesis import strategies as st

from heaved.outputs.telegrams import em, kmb, smc_hex, tss1
from heaved.outputs.telegrams.spec import (
    Format,
    HeavePositive,
    PitchPositive,
    RollConvention,
    RollPositive,
    Telegram,
    as_read,
)

if TYPE_CHECKING:
    from heaved.outputs.motion import Motion

FORMATS = {
    Telegram.TSS1: tss1.FORMAT,
    Telegram.EM1000: em.EM1000,
    Telegram.EM3000: em.EM3000,
    Telegram.SMC_HEX: smc_hex.FORMAT,
    Telegram.KMB: kmb.FORMAT,
}
MAY_BE_SILENT = {Telegram.EM1000, Telegram.SMC_HEX, Telegram.KMB}


@pytest.mark.parametrize(("telegram", "form"), FORMATS.items())
@given(
    motion=motions(),
    heave=st.none() | st.sampled_from(HeavePositive),
    roll=st.none() | st.sampled_from(RollPositive),
    pitch=st.none() | st.sampled_from(PitchPositive),
    convention=st.none() | st.sampled_from(RollConvention),
)
def test_whatever_the_numbers_it_is_as_long_as_stated_or_nothing(
    telegram: Telegram,
    form: Format,
    motion: Motion,
    heave: HeavePositive | None,
    roll: RollPositive | None,
    pitch: PitchPositive | None,
    convention: RollConvention | None,
) -> None:
    spec = msgspec.structs.replace(
        spec_of(telegram), heave_positive=heave, roll_positive=roll, pitch_positive=pitch, roll_convention=convention
    )
    told = form.encode(as_read(motion, spec, form.signs), spec)
    assert len(told) == form.longest_bytes or (told == b"" and telegram in MAY_BE_SILENT)
