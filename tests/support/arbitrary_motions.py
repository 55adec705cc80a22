"""Motions of every kind, as hypothesis makes them: likely and absurd numbers, none at all, every state."""

from __future__ import annotations

from math import inf, nan, pi

from hypothesis import strategies as st

from heaved.outputs.motion import Motion
from heaved.outputs.telegrams.spec import OutputSpec, Settling, Telegram
from heaved.samples import DelayedHeave, HeaveState


def numbers(most: float) -> st.SearchStrategy[float]:
    """Up to some ``most`` and about it, else anything that a float can be."""
    return (
        st.floats(-most, most)
        | st.floats(0.99 * most, 1.01 * most)
        | st.floats()
        | st.sampled_from([nan, inf, -inf, 0.0, -0.0, 1e308, -1e308, 5e-324])
    )


delayed = st.builds(DelayedHeave, t_s=st.floats(0.0, 1e9), heave_m=numbers(10.0), std_m=numbers(1.0))
motions = st.builds(
    Motion,
    utc_s=st.floats(1.6e9, 1.9e9) | numbers(2.0**32),
    age_s=st.floats(0.0, 0.5),
    state=st.sampled_from(HeaveState),
    heave_m=numbers(10.0) | numbers(33.0) | numbers(100.0),
    heave_std_m=numbers(1.0),
    heave_velocity_mps=numbers(33.0),
    heave_acceleration_mps2=numbers(20.5) | numbers(33.0),
    surge_acceleration_mps2=numbers(9.8),
    sway_acceleration_mps2=numbers(9.8),
    roll_rad=numbers(pi) | numbers(0.5 * pi),
    pitch_rad=numbers(0.5 * pi),
    yaw_rad=numbers(2.0 * pi),
    roll_std_rad=numbers(0.1),
    pitch_std_rad=numbers(0.1),
    yaw_std_rad=numbers(0.1),
    roll_rate_radps=numbers(1.0),
    pitch_rate_radps=numbers(1.0),
    yaw_rate_radps=numbers(1.0),
    delayed=st.none() | delayed,
    delayed_utc_s=st.floats(1.6e9, 1.9e9) | numbers(2.0**32),
)


def output(telegram: Telegram, settling: Settling = Settling.DEGRADED) -> OutputSpec:
    """One that is as its format has it."""
    return OutputSpec(name="winch", telegram=telegram, link="udp://127.0.0.1:5000", settling=settling)


def is_worth_telling(motion: Motion, settling: Settling) -> bool:
    """Whether a reader may be told a heave."""
    if motion.state is HeaveState.SETTLING:
        return settling is Settling.DEGRADED
    return motion.state in (HeaveState.VALID, HeaveState.DEGRADED)


def says(told: float | None, value: float, most: float, half: float) -> bool:
    """Whether the value is told to ``half`` a unit, or is told to be unknown, and is that or beyond ``most``."""
    if told is None:
        return not abs(value) <= most
    return abs(told - value) <= half * (1.0 + 1e-9)
