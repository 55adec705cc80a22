"""Motions for the tests of what is sent: one that is known in full, and any that there can be."""

from __future__ import annotations

from math import degrees, inf, nan, pi, radians
from typing import Any, Final

import msgspec
from hypothesis import strategies as st

from heaved.outputs.motion import Lead, Motion
from heaved.outputs.telegrams.spec import OutputSpec, Settling, Telegram
from heaved.samples import DelayedHeave, HeaveState

NOON_UTC_S: Final = 19_675 * 86_400.0 + 43_200.0
"""Of the 14th of November 2023."""
KNOWN: Final = Motion(
    utc_s=NOON_UTC_S + 12.345,
    age_s=0.012,
    state=HeaveState.VALID,
    heave_m=1.234,
    heave_std_m=0.02,
    heave_velocity_mps=-0.56,
    heave_acceleration_mps2=0.789,
    surge_acceleration_mps2=0.123,
    sway_acceleration_mps2=-0.456,
    roll_rad=radians(-5.25),
    pitch_rad=radians(2.5),
    yaw_rad=radians(123.75),
    roll_std_rad=radians(0.021),
    pitch_std_rad=radians(0.034),
    yaw_std_rad=radians(1.5),
    roll_rate_radps=radians(3.125),
    pitch_rate_radps=radians(-1.5),
    yaw_rate_radps=radians(0.25),
)
"""All of it is known."""

_NUMBERS: Final = [
    name for name in Motion.__struct_fields__ if name.endswith(("_m", "_mps", "_mps2", "_rad", "_radps"))
]


def but(**changed: Any) -> Motion:
    """The known motion, with some of it changed."""
    return msgspec.structs.replace(KNOWN, **changed)


def motions() -> st.SearchStrategy[Motion]:
    """Any motion: every number as on a ship, nearly nothing, huge, infinite or not known; of each state."""
    number = st.one_of(
        st.floats(-2.0, 2.0),
        st.floats(-200.0, 200.0),
        st.floats(-1e-2, 1e-2),
        *(st.floats(0.99 * most, 1.01 * most) for most in (9.99, 32.77, 100.0, pi)),
        st.floats(),
        st.sampled_from([nan, inf, -inf, 0.0, -0.0, 1e308, -1e308, 5e-324]),
    )
    utc_s = st.one_of(st.floats(0.0, 4e9), st.floats())
    return st.builds(
        Motion,
        utc_s=utc_s,
        age_s=st.one_of(st.floats(0.0, 0.5), st.floats()),
        state=st.sampled_from(HeaveState),
        delayed=st.none() | st.builds(DelayedHeave, t_s=st.floats(0.0, 1e9), heave_m=number, std_m=number),
        delayed_utc_s=utc_s,
        **dict.fromkeys(_NUMBERS, number),
    )


def specs(telegram: Telegram, **fixed: Any) -> st.SearchStrategy[OutputSpec]:
    """Any output of that format, as far as an encoder can tell."""
    return st.builds(
        spec_of,
        st.just(telegram),
        settling=st.sampled_from(Settling),
        ins_good=st.integers(0, 9),
        lead=st.sampled_from([None, *Lead]),
        **fixed,
    )


def spec_of(telegram: Telegram, **keys: Any) -> OutputSpec:
    """An output of that format as a configuration gives it."""
    table = {"name": "test", "telegram": telegram, "link": "udp://127.0.0.1:5600"} | keys
    return msgspec.convert(table, OutputSpec)


def says(told: float | None, value: float, most: float, half: float) -> bool:
    """Whether the value is told to ``half`` a unit, or is told to be unknown, and is that or beyond ``most``."""
    if told is None:
        return not abs(value) <= most
    return abs(told - value) <= half * (1.0 + 1e-9)


def is_told(motion: Motion, spec: OutputSpec) -> bool:
    """Whether a reader is to have the heave of it, as the configuration describes ``settling``."""
    withheld = {HeaveState.INVALID} | ({HeaveState.SETTLING} if spec.settling == "error" else set())
    return motion.state not in withheld


def assert_says(text: str, value: float, unit: float, largest: float) -> None:
    """The field gives that value to half a unit of its last decimal, without a minus before nothing; or it is empty,
    and the value is not known or beyond what the field takes.
    """
    if abs(value) <= largest:
        assert abs(float(text) - value) <= 0.5 * unit * (1.0 + 1e-6) + 1e-12 * abs(value)
        assert float(text) != 0.0 or "-" not in text
    else:
        assert not text


def assert_says_heading(text: str, yaw_rad: float, unit: float) -> None:
    """The field gives that compass angle to half a unit, on the circle from 0 to below 360; or it is not known."""
    if abs(yaw_rad) < 1e4:
        assert 0.0 <= float(text) < 360.0
        assert abs((float(text) - degrees(yaw_rad) + 180.0) % 360.0 - 180.0) <= 0.5 * unit * (1.0 + 1e-6) + 1e-8
    elif not abs(yaw_rad) < 1e7:
        assert not text
