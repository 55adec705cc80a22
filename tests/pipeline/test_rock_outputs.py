"""Attitude predictions, quiet windows and the check of the forecasts, from the pipeline to what people read."""

from __future__ import annotations

import json
from math import isfinite, nan, radians, sin, tau

import msgspec
import numpy as np
import pytest
from pipelines import run

from heaved.client import report
from heaved.config.read import ConfigError, parse
from heaved.estimation import quiescence
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.forecast_check import DOUBT, ForecastCheck
from heaved.estimation.heave.laser import correction, reference
from heaved.estimation.lever_arm import Point
from heaved.estimation.rock import params as rock
from heaved.outputs import wire
from heaved.outputs.requests import Subscription, parse_request
from heaved.pipeline import Pipeline, assemble
from heaved.replay.table import Table
from heaved.samples import (
    GRAVITY_MPS2,
    HeaveForecast,
    ImuSample,
    MotionFrame,
    QuietForecast,
    QuietWindow,
    RockPrediction,
    RockScore,
)

AMPLITUDE_M, PERIOD_S = 0.3, 8.0


def build(*, rock_params: rock.Params | None = None, quiet: quiescence.Params | None = None) -> Pipeline:
    return assemble(
        heave=heave.Params(observer="harmonic"),
        laser=reference.Params(),
        correction=correction.Params(),
        rock=rock_params or rock.Params(),
        has_laser=False,
        point=(Point(name="tip", forward_m=10.0),),
        quiet=quiet,
    )


def swell(duration_s: float, rate_hz: float = 20.0, pitch: float = 1.0) -> list[ImuSample]:
    """Regular heave and attitude; ``pitch`` scales it, nan: none."""
    w = tau / PERIOD_S
    return [
        ImuSample(
            t_s=t,
            ax_mps2=0.0,
            ay_mps2=0.0,
            az_mps2=GRAVITY_MPS2 - AMPLITUDE_M * w * w * sin(w * t),
            roll_rad=0.01 * sin(w * t + 1.0),
            pitch_rad=pitch * 0.005 * sin(w * t),
            yaw_rad=1.0,
        )
        for t in (k / rate_hz for k in range(round(duration_s * rate_hz)))
    ]


@pytest.mark.parametrize("rate_hz", [20.0, 100.0])
def test_a_frame_and_one_in_between_tell_what_comes(rate_hz: float) -> None:
    pipe = build()
    frames = run(pipe, swell(60.0, rate_hz))
    coasted = pipe.coast(frames[-1].t_s + 0.03)
    for frame in (frames[-1], coasted):
        for p in frame.rock:
            assert abs(p.roll_rad - 0.01 * sin(tau * (frame.t_s + p.horizon_s) / PERIOD_S + 1.0)) < 2e-4
            assert p.roll_interval_rad >= p.roll_std_rad > 0.0
    assert len(pipe.summary().rock) == 3 * len(frames[-1].rock)
    assert pipe.resets.total() == 0


def test_an_attitude_that_is_not_there_takes_nothing_else_with_it() -> None:
    whole, lame = run(build(), swell(60.0)), run(build(), swell(60.0, pitch=nan))
    assert isfinite(lame[-1].heave_m)
    for p, q in zip(whole[-1].rock, lame[-1].rock, strict=True):
        assert not isfinite(q.pitch_rad)
        assert abs(p.roll_rad - q.roll_rad) < 1e-9
        assert abs(p.yaw_rad - q.yaw_rad) < 1e-9


@pytest.mark.parametrize(("limit_m", "is_quiet"), [(2.0, True), (0.1, False)])
def test_quiet_windows(limit_m: float, is_quiet: bool) -> None:
    """A swell of 0.3 m, 0.35 m at the point, is always within 2 m and never within 0.1 m for 10 s."""
    params = quiescence.Params(enabled=True, point="tip", heave_limit_m=limit_m)
    frames = run(build(quiet=params), swell(400.0, 10.0))
    last = frames[-1].quiet
    assert last is not None
    assert (last.window is not None) is is_quiet
    assert (last.best > 0.8) is is_quiet
    assert frames[100].quiet is not None
    assert not isfinite(frames[100].quiet.best)  # nothing has been learned
    assert build().coast(0.0).quiet is None


def test_the_replay_has_the_same_columns_for_either_predictor() -> None:
    config = parse({}, file="x", directory=None)  # type: ignore[arg-type]
    paper = msgspec.structs.replace(config, rock=rock.Params(predictor="ml"))
    names = Table(config, str).names
    assert Table(paper, str).names == names
    assert "pitch_5s_std_deg" in names


def test_a_quiet_point_must_exist() -> None:
    with pytest.raises(ConfigError, match=r"quiet\.point: no \[\[point\]\] is named 'tip'"):
        parse({"quiet": {"point": "tip"}}, file="x", directory=None)  # type: ignore[arg-type]


# ---- the forecasts' check --------------------------------------------------------------------------------------------


def foretold(heave_m: float) -> tuple[HeaveForecast, ...]:
    """A second ahead, beside others."""
    return HeaveForecast(horizon_s=0.5, heave_m=9.0), HeaveForecast(horizon_s=1.0, heave_m=heave_m)


def test_the_horizon_nearest_to_a_second_is_checked_if_it_tells_anything() -> None:
    check = ForecastCheck.of((0.1, 0.6, 1.2, 5.0), 0.1)
    assert check is not None
    assert check._horizon_s == 1.2
    for horizons_s, lead_s in (((), 0.0), ((0.1, 5.0), 0.0), ((1.0,), 0.5)):
        assert ForecastCheck.of(horizons_s, lead_s) is None


@pytest.mark.parametrize(("error_m", "is_doubted"), [(0.0, False), (0.4, True)])
def test_forecasts_that_are_worse_than_a_regression_are_doubted(error_m: float, is_doubted: bool) -> None:
    check = ForecastCheck(1.0)
    rng = np.random.default_rng(1)
    for k in range(4000):
        t = k / 20
        truth = sin(tau * t / 8) + 1e-3 * rng.standard_normal()
        check.step(t, truth, foretold(sin(tau * (t + 1.0) / 8) + error_m * rng.standard_normal()))
    observer_m, plain_m = check.errors_m
    assert abs(observer_m - (error_m or 1e-3)) < 0.15 * (error_m or 1e-3)
    assert plain_m < 0.1
    assert check.doubts == ((DOUBT,) if is_doubted else ())


def test_the_lead_of_the_heave_is_allowed_for() -> None:
    check = ForecastCheck(1.0, 0.3)
    for k in range(2000):
        t = k / 20
        check.step(t, sin(tau * (t + 0.3) / 8), foretold(sin(tau * (t + 1.0) / 8)))
    assert check.errors_m[0] < 2e-3  # linear interpolation between frames


def test_unknown_forecasts_are_not_compared() -> None:
    for unknown in (foretold(nan), foretold(0.0)[:1], ()):
        check = ForecastCheck(1.0)
        for k in range(1000):
            check.step(k / 20, sin(k / 20), unknown)
        assert not isfinite(check.errors_m[0])
        assert check.doubts == ()


# ---- what is read ----------------------------------------------------------------------------------------------------


def test_intervals_on_the_wire() -> None:
    frame = build().coast(0.0)
    known = RockPrediction(horizon_s=0.1, roll_rad=0.0, roll_interval_rad=radians(2.0))
    line = wire.encode_motion(msgspec.structs.replace(frame, rock=(known,)), seq=1, utc_s=0.0, sent_mono_s=0.0)
    (record,) = json.loads(line)["rock"]
    assert record == {"horizon_s": 0.1, "roll_deg": 0.0, "roll_interval_deg": 2.0}


def test_quiet_on_the_wire() -> None:
    window = QuietWindow(t_s=10.0, start_s=12.0, length_s=15.0, confidence=0.85)
    line = wire.encode_record(wire.quiet_record(QuietForecast(t_s=10.0, window=window, best=0.9), 100.0))
    assert json.loads(line) == {
        "class": "QUIET", "time": "1970-01-01T00:01:40.000000Z", "mono_s": 10.0, "is_expected": True,
        "start": "1970-01-01T00:01:52.000000Z", "start_s": 12.0, "length_s": 15.0, "confidence": 0.85,
        "best_confidence": 0.9,
    }  # fmt: skip
    none = json.loads(wire.encode_record(wire.quiet_record(QuietForecast(t_s=10.0), 100.0)))
    assert none == {"class": "QUIET", "time": "1970-01-01T00:01:40.000000Z", "mono_s": 10.0, "is_expected": False}
    assert isinstance(parse_request(b'?WATCH={"classes":["QUIET"]}'), Subscription)


def test_what_a_person_reads() -> None:
    scores = tuple(
        RockScore(axis=axis, horizon_s=h, error_rad=radians(0.1), coverage=0.95)
        for axis in ("roll", "pitch")
        for h in (0.05, 0.15, 1.0)
    )
    rows = report._score_rows(wire.rock_status(scores, (0.15, 1.0)))
    cell = "0.100° (95 % within 95 %)"
    assert rows == [("in", "roll", "pitch"), ("150 ms", cell, cell), ("1 s", cell, cell)]
    window = QuietWindow(t_s=10.0, start_s=12.0, length_s=15.0, confidence=0.85)
    for quiet, text in (
        (QuietForecast(t_s=0.0, window=window, best=0.9), "in 12 s for 15 s, 85 % sure"),
        (QuietForecast(t_s=0.0, best=0.4), "none is sure enough, the best 40 %"),
        (QuietForecast(t_s=0.0), "not known yet"),
    ):
        status = wire.quiet_status(quiet)
        assert status is not None
        assert report._quiet_text(status) == text
    assert wire.quiet_status(None) is None
    assert isinstance(build().coast(0.0), MotionFrame)
