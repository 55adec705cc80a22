"""A laser that is elsewhere, through the whole pipeline. Oracle: the simulated truth, and the same without a laser."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Literal

import msgspec
import numpy as np
import pytest
from pipelines import column, pipeline, rms, run

from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, reference
from heaved.samples import ImuSample, LaserState, MotionFrame
from heaved.simulate.gauge import AT_THE_IMU, Gauge
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import Recording, record

if TYPE_CHECKING:
    from heaved.pipeline import Pipeline

Role = Literal["reference", "aiding"]
SPAN_S, LATE_S = 215.0, 190.0
AHEAD = Gauge(at_m=(8.0, 0.0, 2.0), beam=(math.tan(math.radians(1.0)), 0.0, -1.0))
MISPLACED = "from where it is configured"


@cache
def recorded(gauge: Gauge | None) -> Recording:
    """Of a sea that rolls the ship by nearly 5 degrees RMS and pitches it by two."""
    return record(
        seaway("S6", 1), SPAN_S, imu_rate_hz=10.0, laser_rate_hz=10.0, sensor="A", seed=101,
        gauge=gauge or AT_THE_IMU, laser="off" if gauge is None else "on",
    )  # fmt: skip


@cache
def seen(
    gauge: Gauge | None, role: Role, params: reference.Params | None = None, until_s: float = SPAN_S
) -> tuple[Pipeline, list[MotionFrame]]:
    pipe = pipeline(
        has_laser=gauge is not None,
        heave_params=heave.Params(forecast_horizons_s=()),
        laser_params=params or reference.Params(role=role),
        correction_params=correction.Params(enabled=False),
    )
    return pipe, run(pipe, (sample for sample in recorded(gauge).samples() if sample.t_s < until_s))


def error_m(frames: list[MotionFrame], from_s: float) -> float:
    t = column(frames, "t_s")
    off = column(frames, "heave_m") - recorded(AHEAD).truth.heave_m[: len(frames)]
    return rms(off[t >= from_s])


def is_named(frame: MotionFrame) -> bool:
    return any(MISPLACED in reason for reason in frame.quality.reasons)


@pytest.mark.parametrize("role", ["reference", "aiding"])
def test_a_laser_that_is_elsewhere_is_named_and_never_makes_the_heave_worse(role: Role) -> None:
    pipe, frames = seen(AHEAD, role)
    _, alone = seen(None, "reference")
    place = pipe.summary().laser_place
    assert place.is_elsewhere
    assert place.ahead_m == pytest.approx(8.0 + 12.0 * math.tan(math.radians(1.0)), abs=0.5)
    assert place.port_m == pytest.approx(0.0, abs=0.2)
    assert all(is_named(frame) for frame in frames if frame.t_s > 150.0)
    assert error_m(frames, 60.0) < 1.05 * error_m(alone, 60.0)
    assert abs(pipe.laser.lead.learned_s) < 0.01
    assert frames[-1].quality.laser is LaserState.VALID
    if role == "aiding":
        assert error_m(frames, LATE_S) < 0.5 * error_m(alone, LATE_S)


def test_one_that_is_configured_there_is_as_good_as_one_at_the_imu() -> None:
    forward, port, up = AHEAD.at_m
    there = reference.Params(role="aiding", forward_m=forward, port_m=port, up_m=up, beam=AHEAD.beam)
    pipe, frames = seen(AHEAD, "aiding", there, 145.0)
    _, usual = seen(AT_THE_IMU, "aiding", None, 145.0)
    assert not any(map(is_named, frames))
    assert pipe.laser.placement.changes == 0
    assert error_m(frames, 105.0) < 1.2 * error_m(usual, 105.0) < 0.01


def test_without_an_attitude_a_laser_elsewhere_is_no_reference() -> None:
    """It is lost at 100 s; the reading of a gauge 8 m ahead says nothing of the heave then, and that is said."""
    pipe = pipeline(
        heave_params=heave.Params(forecast_horizons_s=()),
        laser_params=reference.Params(forward_m=8.0, up_m=2.0, beam=AHEAD.beam),
        correction_params=correction.Params(enabled=False),
    )
    frames = run(
        pipe,
        (
            msgspec.structs.replace(sample, roll_rad=np.nan, pitch_rad=np.nan, gx_radps=np.nan)
            if isinstance(sample, ImuSample) and sample.t_s > 100.0
            else sample
            for sample in recorded(AHEAD).samples()
            if sample.t_s < 110.0
        ),
    )
    assert frames[990].quality.laser is LaserState.VALID
    assert frames[-1].quality.laser is LaserState.STALE
    assert "laser: without roll and pitch nothing is known of the heave from where it is" in frames[-1].quality.reasons
    assert math.isnan(frames[-1].reference_m)


def test_without_an_attitude_it_is_said_that_the_laser_is_believed_to_be_at_the_imu() -> None:
    made = record(
        seaway("S4", 1), 90.0, imu_rate_hz=10.0, laser_rate_hz=10.0, sensor="A", seed=101, laser="on", gauge=AHEAD
    )
    pipe = pipeline(
        heave_params=heave.Params(forecast_horizons_s=()), correction_params=correction.Params(enabled=False)
    )
    samples = [
        msgspec.structs.replace(sample, roll_rad=np.nan, pitch_rad=np.nan) if isinstance(sample, ImuSample) else sample
        for sample in made.samples()
    ]
    frames = run(pipe, samples)
    assert "laser: without roll and pitch it is believed to stand at the IMU" in frames[-1].quality.reasons
