"""The words of the register map: the makers' golden frame, the description in heaved.toml as an independent decoder,
and whatever numbers there are.
"""

from __future__ import annotations

import math
import re
import struct
from math import inf, nan
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heaved.config.read import data_directory
from heaved.outputs.motion import LONGEST_S, Lead
from heaved.outputs.register_map import (
    FIXED,
    Register,
    RegisterMap,
    RegistersParams,
    of_horizon,
    of_point,
)
from heaved.outputs.telegrams.spec import HeavePositive, PitchPositive, RollPositive
from heaved.samples import (
    CorrectionState,
    DelayedHeave,
    HeaveForecast,
    HeaveState,
    LaserState,
    MotionFrame,
    MotionNow,
    PointMotion,
    Quality,
    RockPrediction,
    SeaState,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

T_S = 1000.0
UTC_S = 1_700_000_000.25
"""Of ``T_S``."""
HORIZONS_S = RegistersParams().horizons_s


def utc_s(t_s: float) -> float:
    return UTC_S + (t_s - T_S)


def quality(state: HeaveState = HeaveState.VALID) -> Quality:
    return Quality(heave=state, laser=LaserState.OFF, correction=CorrectionState.OFF)


SEA = SeaState(
    significant_height_m=2.34, peak_period_s=8.76, mean_period_s=7.65, systems=(), frequencies_hz=(), spectrum_m2phz=()
)
FULL = MotionFrame(
    t_s=T_S,
    quality=quality(),
    heave_m=0.305,
    heave_std_m=0.021,
    heave_velocity_mps=-0.088,
    heave_acceleration_mps2=-0.070,
    roll_rad=math.radians(0.16),
    pitch_rad=math.radians(0.63),
    yaw_rad=math.radians(-0.5),
    roll_rate_radps=math.radians(1.25),
    pitch_rate_radps=math.radians(-2.5),
    points=(
        PointMotion(name="tip", heave_m=-1.5, heave_std_m=0.04, heave_velocity_mps=0.25),
        PointMotion(name="pool", heave_m=0.5, heave_velocity_mps=0.1, state=HeaveState.DEGRADED),
    ),
    rock=tuple(
        RockPrediction(horizon_s=h, roll_rad=0.01 * h, pitch_rad=-0.02 * h, roll_std_rad=0.001, pitch_std_rad=0.002)
        for h in HORIZONS_S
    ),
    forecast=tuple(HeaveForecast(horizon_s=h, heave_m=0.1 * h, std_m=0.01 * h) for h in HORIZONS_S),
    delayed=DelayedHeave(t_s=T_S - 60.0, heave_m=-0.4, std_m=0.008),
    sea=SEA,
)


def words_of(frame: MotionFrame | None, now_s: float = T_S, points: tuple[str, ...] = (), **params: Any) -> list[int]:
    registers = RegisterMap(RegistersParams(**params), points, utc_s)
    if frame is not None:
        registers.push(frame)
    image = registers.at(now_s)
    assert len(image) == 2 * registers.words
    return [int.from_bytes(image[i : i + 2]) for i in range(0, len(image), 2)]


# ---- the common map --------------------------------------------------------------------------------------------------


def test_the_golden_frame_of_the_common_map() -> None:
    registers = RegisterMap(RegistersParams(), (), utc_s)
    for _ in range(0x9F):
        registers.push(FULL)
    assert registers.at(T_S)[:12].hex(" ", 2).upper() == "0131 FFA8 FFBA 0010 FFC1 009F"


@pytest.mark.parametrize(
    ("params", "turned"),
    [
        ({"heave_positive": HeavePositive.DOWN}, (0, 1, 2)),
        ({"roll_positive": RollPositive.STARBOARD_UP}, (3,)),
        ({"pitch_positive": PitchPositive.BOW_UP}, (4,)),
    ],
)
def test_signs(params: dict[str, Any], turned: tuple[int, ...]) -> None:
    usual, other = words_of(FULL), words_of(FULL, **params)
    for place in range(6):
        assert other[place] == (-usual[place] % 0x10000 if place in turned else usual[place])


def test_the_counter_counts_frames_and_comes_round() -> None:
    registers = RegisterMap(RegistersParams(), (), utc_s)
    counted = []
    for _ in range(0x8001):
        counted.append(int.from_bytes(registers.at(T_S)[10:12]))
        registers.push(FULL)
    assert counted == [*range(0x8000), 0]


def test_the_words_are_those_of_the_moment_at_which_they_are_asked_for() -> None:
    later_s = 0.1
    words = words_of(FULL, T_S + later_s)
    assert words[0] == round(1000 * (0.305 - 0.088 * later_s - 0.5 * 0.070 * later_s**2))
    assert words[1] == round(1000 * (-0.088 - 0.070 * later_s)) % 0x10000
    assert words[7] == 100
    assert words_of(FULL, T_S + later_s, lead=Lead.NONE)[:3] == words_of(FULL, T_S)[:3]


def test_between_two_frames_a_plc_reads_the_present() -> None:
    """Of a heave of 1 m and 6 s, of which there is a frame every 100 ms."""
    w = 2.0 * math.pi / 6.0
    errors_m: dict[Lead, list[float]] = {lead: [] for lead in (Lead.TRANSMISSION, Lead.NONE)}
    for lead, errors in errors_m.items():
        registers = RegisterMap(RegistersParams(lead=lead), (), utc_s)
        for i in range(600):
            now_s = T_S + 0.01 * i
            if i % 10 == 0:
                s, c = math.sin(w * now_s), math.cos(w * now_s)
                registers.push(
                    msgspec.structs.replace(
                        FULL, t_s=now_s, heave_m=s, heave_velocity_mps=w * c, heave_acceleration_mps2=-w * w * s
                    )
                )
            (word,) = struct.unpack_from(">h", registers.at(now_s))
            errors.append(abs(0.001 * word - math.sin(w * now_s)))
    assert max(errors_m[Lead.TRANSMISSION]) < 0.0005 + (w * 0.09) ** 3 / 6.0
    assert max(errors_m[Lead.NONE]) > 0.09


def test_one_moment_is_computed_once_and_the_next_anew() -> None:
    registers = RegisterMap(RegistersParams(), (), utc_s)
    registers.push(FULL)
    first = registers.at(T_S)
    assert registers.at(T_S + 0.0005) is first
    assert registers.at(T_S + 0.002) != first
    registers.push(FULL)
    assert registers.at(T_S + 0.002)[10:12] == b"\x00\x02"


def test_a_lead_of_the_compensator() -> None:
    now = MotionNow(heave_m=0.1, heave_std_m=0.01, heave_velocity_mps=0.2)
    ahead = msgspec.structs.replace(FULL, compensation_lead_s=0.5, now=now)
    assert words_of(ahead)[:2] == [100, 200]
    assert words_of(ahead, lead=Lead.COMPENSATION)[:2] == [305, 0xFFA8]


# ---- the description, as a decoder -----------------------------------------------------------------------------------


class Row(NamedTuple):
    """A line of the table in heaved.toml."""

    place: int
    name: str
    kind: str
    step: str


def described() -> tuple[list[Row], list[Row], list[Row]]:
    """Those of a fixed place, of a horizon, of a point."""
    text = (data_directory() / "heaved.toml").read_text(encoding="utf-8")
    section = text.split("\n[registers]\n")[1].split("\n#enabled")[0]
    parts = re.split(r"\n# then, for each .*", section)
    assert len(parts) == 3
    row = re.compile(r"(?m)^# +\+?(\d+)  (\S.*?) +(int16|uint16|uint32)(?: +(\S.*))?$")
    fixed, horizon, point = (
        [Row(int(m[1]), m[2], m[3], m[4] or "") for m in row.finditer(part)] for part in parts
    )  # fmt: skip
    return fixed, horizon, point


def rows_of(registers: tuple[Register, ...], without: str) -> Iterator[Row]:
    place = 0
    for register in registers:
        step = f"{1 / register.per_unit:g} {register.unit}" if register.unit else ""
        yield Row(place, register.name.replace(without, ""), register.kind.name.lower(), step)
        place += register.kind.words


def test_the_default_file_describes_the_map() -> None:
    fixed, horizon, point = described()
    assert fixed == list(rows_of(FIXED, "\0"))
    assert horizon == list(rows_of(of_horizon(0.5), " in 0.5 s"))
    assert point == list(rows_of(of_point(0, "tip"), " of tip"))


def decoded(words: list[int], points: int = 0) -> dict[str, float | None]:
    """What a reader of the description makes of the words; None: not known."""
    fixed, horizon, point = described()
    rows = list(fixed)
    place = 24
    for each in HORIZONS_S:
        rows += [Row(place + row.place, f"{row.name} in {each:g} s", row.kind, row.step) for row in horizon]
        place += 6
    for number in range(points):
        rows += [Row(place + row.place, f"{row.name} of {number}", row.kind, row.step) for row in point]
        place += 4
    assert place == len(words)
    values: dict[str, float | None] = {}
    for row in rows:
        raw = words[row.place]
        if row.kind == "uint32":
            raw = words[row.place] * 0x10000 + words[row.place + 1]
        if row.kind == "int16":
            raw -= 0x10000 * (raw > 0x7FFF)
        unknown = {"int16": -0x8000, "uint16": 0xFFFF, "uint32": 0xFFFFFFFF}[row.kind]
        values[row.name] = None if raw == unknown else raw * float(row.step.split()[0] if row.step else 1)
    return values


def test_every_word_is_what_its_description_says() -> None:
    values = decoded(words_of(FULL, points=("tip", "pool")), points=2)
    expected: dict[str, float | None] = {
        "heave": 0.305, "heave velocity": -0.088, "vertical acceleration": -0.07, "roll": 0.16, "pitch": -0.63,
        "watchdog counter": 1, "quality": 3, "age of the sample": 0, "standard deviation of heave": 0.021,
        "heading": 359.5, "roll rate": 1.25, "pitch rate": 2.5, "UTC since 1970": 1_700_000_000,
        "UTC within the second": 250, "delayed heave": -0.4, "standard deviation of delayed heave": 0.008,
        "age of delayed heave": 60.0, "significant height": 2.34, "peak period": 8.76, "mean period": 7.65,
        "revision of the map": 1, "horizons": 7, "points": 2,
        "heave of 0": -1.5, "heave velocity of 0": 0.25, "standard deviation of heave of 0": 0.04, "quality of 0": 3,
        "heave of 1": 0.5, "heave velocity of 1": 0.1, "standard deviation of heave of 1": None, "quality of 1": 2,
    }  # fmt: skip
    for h in HORIZONS_S:
        expected |= {
            f"heave in {h:g} s": 0.1 * h,
            f"its standard deviation in {h:g} s": 0.01 * h,
            f"roll in {h:g} s": math.degrees(0.01 * h),
            f"standard deviation of roll in {h:g} s": math.degrees(0.001),
            f"pitch in {h:g} s": math.degrees(0.02 * h),
            f"standard deviation of pitch in {h:g} s": math.degrees(0.002),
        }
    assert values.keys() == expected.keys()
    for name, value in expected.items():
        tolerance = 0.0051 if any(word in name for word in ("roll", "pitch", "heading")) else 0.00051
        assert values[name] == (None if value is None else pytest.approx(value, abs=tolerance)), name


def test_the_words_of_a_point() -> None:
    values = decoded(words_of(FULL, point="tip"))
    assert (values["heave"], values["heave velocity"]) == (-1.5, 0.25)
    assert values["delayed heave"] is None
    assert values["significant height"] == 2.34


# ---- what is not known -----------------------------------------------------------------------------------------------

ALWAYS = {"watchdog counter", "quality", "revision of the map", "horizons", "points"}


@pytest.mark.parametrize(
    ("frame", "now_s", "age_s"),
    [
        (None, T_S, None),
        (FULL, T_S + LONGEST_S + 0.001, 0.501),
        (FULL, T_S + 65.534, 65.534),
        (FULL, T_S + 66.0, None),
        (FULL, T_S + 1e9, None),
        (FULL, T_S - 10.0, None),
        (FULL, nan, None),
    ],
)
@pytest.mark.parametrize("lead", Lead)
def test_without_a_recent_frame_nothing_is_known(
    frame: MotionFrame | None, now_s: float, age_s: float | None, lead: Lead
) -> None:
    values = decoded(words_of(frame, now_s, points=("tip",), lead=lead), points=1)
    assert values["quality"] == values["quality of 0"] == 0
    assert values["watchdog counter"] == (frame is not None)
    assert values.pop("age of the sample") == (None if age_s is None else pytest.approx(age_s))
    assert {name for name, value in values.items() if value is not None} == ALWAYS | {"quality of 0"}


@pytest.mark.parametrize(
    ("state", "number"),
    [(HeaveState.INVALID, 0), (HeaveState.SETTLING, 1), (HeaveState.DEGRADED, 2), (HeaveState.VALID, 3)],
)
def test_quality(state: HeaveState, number: int) -> None:
    assert words_of(msgspec.structs.replace(FULL, quality=quality(state)))[6] == number


@pytest.mark.parametrize(
    ("changes", "unknown", "is_valid"),
    [
        ({"heave_m": nan}, {0, 1, 2, 8}, False),
        ({"heave_m": 32.7677}, {0}, False),
        ({"heave_m": -32.7677}, {0}, False),
        ({"heave_m": 32.767}, set(), True),
        ({"heave_m": -32.767}, set(), True),
        ({"heave_m": inf}, {0, 1, 2, 8}, False),
        ({"heave_velocity_mps": 40.0}, {1}, False),
        ({"heave_acceleration_mps2": nan}, {2}, True),
        ({"heave_acceleration_mps2": -1e300}, {2}, True),
        ({"heave_std_m": 70.0}, {8}, True),
        ({"heave_std_m": -1.0}, {8}, True),
        ({"roll_rad": 6.0}, {3}, True),
        ({"pitch_rad": nan}, {4}, True),
        ({"yaw_rad": nan}, {9}, True),
        ({"yaw_rad": inf}, {9}, True),
        ({"yaw_rad": 1e308}, {9}, True),
        ({"sea": None}, {18, 19, 20}, True),
        ({"delayed": None}, {15, 16, 17}, True),
        ({"forecast": (), "rock": ()}, set(range(24, 66)), True),
    ],
)
def test_what_is_not_known_or_does_not_fit_is_never_cut_off(
    changes: dict[str, Any], unknown: set[int], is_valid: bool
) -> None:
    usual, words = words_of(FULL), words_of(msgspec.structs.replace(FULL, **changes))
    found = {place for place, word in enumerate(words) if word in (0x8000, 0xFFFF) and word != usual[place]}
    assert found == unknown
    assert words[6] == (3 if is_valid else 0)


@pytest.mark.parametrize(("yaw_deg", "word"), [(0.0, 0), (359.994, 35999), (359.996, 0), (-0.001, 0), (720.5, 50)])
def test_the_heading_never_says_360(yaw_deg: float, word: int) -> None:
    assert words_of(msgspec.structs.replace(FULL, yaw_rad=math.radians(yaw_deg)))[9] == word


@pytest.mark.parametrize(
    ("utc", "seconds", "milliseconds"),
    [(1_700_000_000.9996, 1_700_000_000, 999), (2.0**32 - 1.5, 2**32 - 2, 500), (2.0**32, 2**32 - 1, 0), (-1.0, -1, 0)],
)
def test_utc_until_2106(utc: float, seconds: int, milliseconds: int) -> None:
    registers = RegisterMap(RegistersParams(), (), lambda _t_s: utc)
    registers.push(FULL)
    image = registers.at(T_S)
    assert int.from_bytes(image[24:28]) == seconds % 2**32
    assert int.from_bytes(image[28:30]) == milliseconds


@pytest.mark.parametrize("points", [0, 1, 12])
def test_how_long_it_is(points: int) -> None:
    names = tuple(f"p{i}" for i in range(points))
    assert len(words_of(FULL, points=names)) == 24 + 6 * 7 + 4 * points


ANY = st.floats(allow_nan=True, allow_infinity=True)
NUMBER = st.one_of(ANY, st.floats(-40.0, 40.0))


@st.composite
def frames(draw: st.DrawFn) -> MotionFrame:
    fields = msgspec.structs.fields(MotionFrame)
    names = [field.name for field in fields if isinstance(field.default, float) and math.isnan(field.default)]
    assert "heave_m" in names
    place = PointMotion(
        name="tip", heave_m=draw(NUMBER), heave_std_m=draw(NUMBER), heave_velocity_mps=draw(NUMBER),
        heave_acceleration_mps2=draw(NUMBER), state=draw(st.sampled_from([None, *HeaveState])),
    )  # fmt: skip
    known: dict[str, Any] = {name: draw(NUMBER) for name in names}
    return MotionFrame(
        t_s=T_S,
        quality=quality(draw(st.sampled_from(HeaveState))),
        points=(place,),
        forecast=tuple(HeaveForecast(horizon_s=h, heave_m=draw(NUMBER), std_m=draw(NUMBER)) for h in (0.5, 1.0)),
        rock=tuple(RockPrediction(horizon_s=h, roll_rad=draw(NUMBER), pitch_std_rad=draw(NUMBER)) for h in (0.1, 5.0)),
        delayed=draw(st.none() | st.builds(DelayedHeave, t_s=NUMBER, heave_m=NUMBER, std_m=NUMBER)),
        sea=msgspec.structs.replace(SEA, significant_height_m=draw(NUMBER), peak_period_s=draw(NUMBER)),
        **known,
    )  # fmt: skip


@given(frame=frames(), lead=st.sampled_from(Lead), point=st.sampled_from(["", "tip", "nowhere"]), late_s=ANY)
def test_whatever_the_numbers_a_word_is_right_or_says_that_it_is_not_known(
    frame: MotionFrame, lead: Lead, point: str, late_s: float
) -> None:
    words_of(frame, T_S + late_s, points=("tip",), point=point, lead=lead)
    values = decoded(words_of(frame, points=("tip",), point=point, lead=Lead.NONE), points=1)
    places: dict[str, MotionFrame | PointMotion] = {"": frame, "tip": frame.points[0]}
    source = places.get(point, PointMotion(name=""))
    known = (
        ("heave", source.heave_m, 0.001, 32.7675),
        ("heave velocity", source.heave_velocity_mps, 0.001, 32.7675),
        ("standard deviation of heave", source.heave_std_m, 0.001, 65.5345),
        ("roll", math.degrees(frame.roll_rad), 0.01, 327.675),
        ("significant height", frame.sea.significant_height_m if frame.sea else nan, 0.01, 655.345),
    )
    for name, true, step, most in known:
        value = values[name]
        if value is None:
            is_unsigned = name[0] == "s"
            heave_known = math.isfinite(source.heave_m) or name in ("roll", "significant height")
            assert not abs(true) < most or not heave_known or (is_unsigned and true < 0.0), name
        else:
            assert value == pytest.approx(true, abs=0.5 * step + 1e-9), name
    if values["heave"] is None or values["heave velocity"] is None:
        assert values["quality"] == 0
