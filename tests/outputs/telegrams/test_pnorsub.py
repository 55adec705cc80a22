"""PNORSUB2 and PNORSUB7B, against the maker's description, by our own reader: pynmea2 takes the one for another."""

from __future__ import annotations

from math import degrees, nan, pi, radians
from typing import TYPE_CHECKING, Any

import pytest
from any_motion import KNOWN, assert_says, assert_says_heading, but, is_told, motions, spec_of, specs
from hypothesis import given
from sentence_parsers import health, pnorsub

from heaved.outputs.telegrams.pnorsub import FORMAT_2, FORMAT_7B
from heaved.outputs.telegrams.spec import Format, OutputSpec, Telegram, as_read
from heaved.samples import HeaveState

if TYPE_CHECKING:
    from heaved.outputs.motion import Motion

SPEC_2 = spec_of(Telegram.PNORSUB2)
SPEC_7B = spec_of(Telegram.PNORSUB7B)
BOTH = [pytest.param(FORMAT_2, SPEC_2, 1000.0, id="2"), pytest.param(FORMAT_7B, SPEC_7B, 1e6, id="7B")]

RUNS = {"SYSTEM_OK", "SYSTEM_HEALTH"}
ANSWERS = {"SENSOR_OK", "SENSOR_HEALTH", "SENSOR_LIMITS"}
HEADING = {"ALG_HEADING_INIT", "ALG_HEAD_OK", "ALG_HEAD_HEALTH"}
ATTITUDE = {"ALG_ROLLP_OK", "ALG_ROLLP_HEALTH"}
USABLE = {"MAIN_HEALTH", "ALG_HEALTH"}
VALID = {"MAIN_OK", "ALG_OK"}
SETTLED = {"ALG_OBS_INIT"}
HEAVE = {"ALG_HEAVE_HEALTH"}
HEAVE_OK = {"ALG_HEAVE_OK"}


def test_2_is_the_example_of_the_maker() -> None:
    """It prints ``$PNORSUB2,203798,2,+0.117,-0.505,259.893,1.350,0.023,1*62``; but for the four decimals of its own
    table, and a checksum that is not that of its example either. Ours is by hand.
    """
    motion = but(
        utc_s=203.798,
        age_s=0.002,
        roll_rad=radians(0.117),
        pitch_rad=radians(-0.505),
        yaw_rad=radians(259.893),
        heave_m=1.35,
        heave_velocity_mps=0.023,
    )

    sent = FORMAT_2.encode(motion, SPEC_2)

    assert sent == b"$PNORSUB2,203798,2,0.1170,-0.5050,259.8930,1.3500,0.0230,1*4F\r\n"


def test_7b_has_each_quantity_in_its_field_with_down_and_starboard_positive() -> None:
    fields = pnorsub(FORMAT_7B.encode(as_read(KNOWN, SPEC_7B, FORMAT_7B.signs), SPEC_7B))

    assert {name: float(text) for name, text in fields.items() if text and name not in ("T1", "T2")} == {
        "roll": -5.25,
        "pitch": 2.5,
        "heading": 123.75,
        "heave": -1.234,
        "heave_vel": 0.56,
        "roll_rate": 3.125,
        "pitch_rate": -1.5,
        "yaw_rate": 0.25,
        "acc_x": 0.123,
        "acc_y": 0.456,
        "acc_z": -0.789,
        "status_A": float(fields["status_A"]),
        "status_B": float(fields["status_B"]),
    }
    assert health(fields) == RUNS | ANSWERS | HEADING | ATTITUDE | USABLE | VALID | SETTLED | HEAVE | HEAVE_OK


@pytest.mark.parametrize(("form", "spec", "per_s"), BOTH)
def test_heave_counts_down_unless_the_reader_is_told_otherwise(form: Format, spec: OutputSpec, per_s: float) -> None:
    up = spec_of(spec.telegram, heave_positive="up")

    assert float(pnorsub(form.encode(as_read(KNOWN, spec, form.signs), spec))["heave"]) == -1.234
    assert float(pnorsub(form.encode(as_read(KNOWN, up, form.signs), up))["heave"]) == 1.234


@pytest.mark.parametrize(("form", "spec", "per_s"), BOTH)
@pytest.mark.parametrize(
    ("lead", "age_s", "delay_s"),
    [
        ("none", 0.012, 0.012),
        (None, 0.012, 0.012),
        ("transmission", 0.012, 0.0),
        ("compensation", 0.012, None),
        ("none", -0.001, None),
        ("none", 4000.0, None),
        ("none", nan, None),
    ],
)
def test_the_delay_is_from_the_moment_of_validity_to_sending(
    form: Format, spec: OutputSpec, per_s: float, lead: str | None, age_s: float, delay_s: float | None
) -> None:
    spec = spec_of(spec.telegram, lead=lead)

    assert pnorsub(form.encode(but(age_s=age_s), spec))["T2"] == ("" if delay_s is None else f"{delay_s * per_s:.0f}")


@pytest.mark.parametrize(("form", "spec", "per_s"), BOTH)
def test_the_moment_of_validity_is_counted_in_32_bits(form: Format, spec: OutputSpec, per_s: float) -> None:
    start_s = 2**32 / per_s

    told = [
        pnorsub(form.encode(but(utc_s=utc_s), spec))["T1"]
        for utc_s in (0.0, start_s - 1.0 / per_s, start_s, start_s + 0.5, nan, -1.0, 1e300)
    ]

    assert told == ["0", str(2**32 - 1), "0", f"{0.5 * per_s:.0f}", "", "", ""]


@pytest.mark.parametrize(
    ("changed", "status"),
    [
        ({}, "1"),
        ({"state": HeaveState.DEGRADED}, "0"),
        ({"state": HeaveState.SETTLING}, "0"),
        ({"state": HeaveState.INVALID}, "0"),
        ({"heave_m": nan}, "0"),
        ({"roll_rad": nan}, "0"),
        ({"pitch_rad": 2.0}, "0"),
        ({"yaw_rad": nan}, "1"),
    ],
)
def test_2_is_ok_while_heave_is_valid_and_roll_and_pitch_are_known(changed: dict[str, Any], status: str) -> None:
    assert pnorsub(FORMAT_2.encode(but(**changed), SPEC_2))["status"] == status


@pytest.mark.parametrize(
    ("changed", "so"),
    [
        ({"state": HeaveState.DEGRADED}, RUNS | ANSWERS | HEADING | ATTITUDE | USABLE | SETTLED | HEAVE),
        ({"state": HeaveState.SETTLING}, RUNS | ANSWERS | HEADING | ATTITUDE | USABLE | HEAVE),
        ({"state": HeaveState.INVALID}, RUNS | ANSWERS | HEADING | ATTITUDE),
        ({"heave_m": nan}, RUNS | ANSWERS | HEADING | ATTITUDE),
        ({"yaw_rad": nan}, RUNS | ANSWERS | ATTITUDE | USABLE | VALID | SETTLED | HEAVE | HEAVE_OK),
        ({"roll_rad": nan}, RUNS | ANSWERS | HEADING | SETTLED | HEAVE | HEAVE_OK),
        ({"roll_rad": nan, "pitch_rad": nan, "yaw_rad": nan, "state": HeaveState.INVALID}, RUNS),
    ],
)
def test_7b_says_of_each_group_what_is_so(changed: dict[str, Any], so: set[str]) -> None:
    assert health(pnorsub(FORMAT_7B.encode(but(**changed), SPEC_7B))) == so


@pytest.mark.parametrize(("form", "spec", "per_s"), BOTH)
def test_heave_that_settles_is_withheld_where_that_is_an_error(form: Format, spec: OutputSpec, per_s: float) -> None:
    fields = pnorsub(form.encode(but(state=HeaveState.SETTLING), spec_of(spec.telegram, settling="error")))

    assert (fields["heave"], fields["heave_vel"], fields.get("acc_z", "")) == ("", "", "")
    assert float(fields["roll"]) == -5.25


@given(motions(), specs(Telegram.PNORSUB2))
def test_2_says_whatever_the_motion_is_or_is_empty(motion: Motion, spec: OutputSpec) -> None:
    sent = FORMAT_2.encode(motion, spec)

    fields = pnorsub(sent)
    told = is_told(motion, spec)
    assert len(sent) <= FORMAT_2.longest_bytes
    _assert_says_attitude(fields, motion)
    assert_says(fields["heave"], motion.heave_m if told else nan, 0.0001, 99.0)
    assert_says(fields["heave_vel"], motion.heave_velocity_mps if told else nan, 0.0001, 99.0)
    is_well = motion.state is HeaveState.VALID and "" not in (fields["heave"], fields["roll"], fields["pitch"])
    assert fields["status"] == str(int(is_well))


@given(motions(), specs(Telegram.PNORSUB7B))
def test_7b_says_whatever_the_motion_is_or_is_empty(motion: Motion, spec: OutputSpec) -> None:
    sent = FORMAT_7B.encode(motion, spec)

    fields = pnorsub(sent)
    told = is_told(motion, spec)
    assert len(sent) <= FORMAT_7B.longest_bytes
    _assert_says_attitude(fields, motion)
    assert_says(fields["heave"], motion.heave_m if told else nan, 0.001, 99.0)
    assert_says(fields["heave_vel"], motion.heave_velocity_mps if told else nan, 0.001, 99.0)
    assert_says(fields["acc_x"], motion.surge_acceleration_mps2, 0.001, 99.0)
    assert_says(fields["acc_y"], -motion.sway_acceleration_mps2, 0.001, 99.0)
    assert_says(fields["acc_z"], motion.heave_acceleration_mps2 if told else nan, 0.001, 99.0)
    for axis in ("roll", "pitch", "yaw"):
        assert_says(fields[f"{axis}_rate"], degrees(getattr(motion, f"{axis}_rate_radps")), 0.001, 999.0)
    unknown = ["surge", "sway", "surge_vel", "sway_vel", "T_x", "T_y", "T_z", "A_x", "A_y", "A_z"]
    assert not any(fields[name] for name in unknown)
    so = health(fields)
    assert (so >= HEAVE) is bool(fields["heave"])
    assert (so >= HEAVE_OK) is (bool(fields["heave"]) and motion.state is HeaveState.VALID)
    assert (so >= ATTITUDE) is bool(fields["roll"] and fields["pitch"])
    assert (so >= HEADING) is bool(fields["heading"])


def _assert_says_attitude(fields: dict[str, str], motion: Motion) -> None:
    assert_says(fields["roll"], degrees(motion.roll_rad), 0.0001, 180.0)
    assert_says(fields["pitch"], degrees(motion.pitch_rad), 0.0001, 90.0)
    assert_says_heading(fields["heading"], motion.yaw_rad, 0.0001)


@pytest.mark.parametrize(("form", "spec", "per_s"), BOTH)
def test_the_longest_is_as_long_as_it_says(form: Format, spec: OutputSpec, per_s: float) -> None:
    rates = dict.fromkeys(("roll_rate_radps", "pitch_rate_radps", "yaw_rate_radps"), radians(-998.0))
    of_heave = dict.fromkeys(("heave_m", "heave_velocity_mps", "heave_acceleration_mps2"), -98.0)
    level = {"surge_acceleration_mps2": -98.0, "sway_acceleration_mps2": 98.0}
    angles = {"roll_rad": -pi, "pitch_rad": -pi / 2}
    time = {"utc_s": (2**32 - 1) / per_s, "age_s": 3600.0}

    sent = form.encode(but(**time, **angles, **rates, **of_heave, **level), spec)

    assert len(sent) == form.longest_bytes


def test_2_is_within_a_sentence() -> None:
    assert FORMAT_2.longest_bytes <= 82
