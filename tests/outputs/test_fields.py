"""The table of what is published: names, units and rounding. Oracle: plain arithmetic, and the records sent."""

from __future__ import annotations

from math import inf, nan, pi, radians
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from heaved.outputs import fields
from heaved.outputs.fields import Fields, compiled, rounded
from heaved.outputs.records import (
    AttitudeRecord,
    DelayedRecord,
    ForecastRecord,
    HullRecord,
    MotionRecord,
    PointRecord,
    RockRecord,
    RockStatus,
)
from heaved.samples import DelayedHeave, HeaveForecast, HullAngles, RockPrediction

if TYPE_CHECKING:
    import msgspec

SENT: dict[str, tuple[tuple[Fields[Any], ...], type[msgspec.Struct]]] = {
    "MOTION": ((fields.MOTION,), MotionRecord),
    "point": ((fields.POINT,), PointRecord),
    "rock": ((fields.ROCK,), RockRecord),
    "rock score": ((fields.ROCK_SCORE,), RockStatus),
    "forecast": ((fields.FORECAST,), ForecastRecord),
    "DELAYED": ((fields.DELAYED,), DelayedRecord),
    "HULL": ((fields.HULL, fields.HULL_STD), HullRecord),
    "ATTITUDE": ((fields.ATTITUDE,), AttitudeRecord),
}


@pytest.mark.parametrize("name", SENT)
def test_every_name_of_the_table_is_one_of_the_record(name: str) -> None:
    tables, record = SENT[name]
    names = [name for table in tables for name in table.names]
    assert set(names) <= set(record.__struct_fields__)
    assert len(names) == len(set(names))


def test_a_record_is_made_of_what_is_known_what_is_the_same_and_what_it_is_given() -> None:
    make = fields.FORECAST.into(ForecastRecord, "horizon_s")
    forecast = HeaveForecast(horizon_s=2.0, heave_m=-0.25, std_m=nan)
    assert make(forecast) == ForecastRecord(2.0, heave_m=-0.25, std_m=None)
    make = fields.FORECAST.into(ForecastRecord, given=["horizon_s"])
    assert make(forecast, 5.0) == ForecastRecord(5.0, heave_m=-0.25, std_m=None)


def test_units_are_converted_and_what_is_not_known_is_left_out() -> None:
    prediction = RockPrediction(horizon_s=0.1, roll_rad=pi, pitch_rad=-radians(0.25), roll_std_rad=inf)
    assert fields.ROCK.known(prediction) == {"roll_deg": 180.0, "pitch_deg": -0.25}
    assert fields.ROCK.sent(prediction) == (180.0, -0.25, *[None] * 7)
    hull = HullAngles(t_s=0.0, state="", std_rad=(radians(1.0 / 3600.0), nan, radians(2.3456 / 3600.0)))
    assert fields.HULL_STD.known(hull) == {"x_std_arcsec": 1.0, "z_std_arcsec": 2.346}
    assert fields.HULL.known(hull) == {}


def test_some_of_a_table() -> None:
    few = fields.HULL.only("delay_s", "static_z_deg")
    assert few.names == ("delay_s", "static_z_deg")
    hull = HullAngles(t_s=0.0, state="", static_rad=(0.0, 0.0, radians(30.0)), delay_s=0.004)
    assert few.known(hull) == {"delay_s": 0.004, "static_z_deg": 30.0}
    assert fields.DELAYED.only("std_m", "heave_m").sent(DelayedHeave(t_s=0.0, heave_m=1.0, std_m=2.0)) == (2.0, 1.0)
    assert compiled(f"({', '.join(few.outside('hull'))})", ["hull"])(hull) == pytest.approx((0.004, 30.0))
    with pytest.raises(ValueError, match="not in tuple"):
        fields.ATTITUDE.only("yaw_deg", "heave_m")


@given(st.floats(-1e6, 1e6))
def test_numbers_are_rounded_to_the_sixth_decimal(value: float) -> None:
    heave_m, std_m = fields.FORECAST.sent(HeaveForecast(horizon_s=1.0, heave_m=value, std_m=-value))
    assert heave_m is not None
    assert heave_m == rounded(value)
    assert heave_m == pytest.approx(value, abs=0.5001e-6)
    assert std_m == -heave_m
    assert round(heave_m, 6) == heave_m


@pytest.mark.parametrize("value", [nan, inf, -inf, 1e10, -1e300])
def test_what_is_absurd_is_not_known(value: float) -> None:
    assert rounded(value) is None
    assert fields.FORECAST.known(HeaveForecast(horizon_s=1.0, heave_m=value, std_m=0.5)) == {"std_m": 0.5}
