"""Oracle: the simulated gauge, which follows its beam, and what was put into it."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lfilter

from heaved.estimation.heave.laser.geometry import Geometry, GeometryFit, fit_geometry
from heaved.simulate.gauge import Gauge
from heaved.simulate.seaway import seaway
from heaved.simulate.vessel import Motion

Array = NDArray[np.float64]
UP = (0.0, 0.0, 1.0)


def geometry_of(gauge: Gauge) -> Geometry:
    forward, port, up = gauge.at_m
    return Geometry(forward_m=forward, port_m=port, up_m=up, beam=gauge.beam, sign=1 if gauge.sign > 0 else -1)


def motion_at(**values: float) -> Motion[float]:
    return Motion(**(dict.fromkeys(Motion.__struct_fields__, 0.0) | values))


metres = st.floats(-20.0, 20.0)


@given(
    roll=st.floats(-0.5, 0.5), pitch=st.floats(-0.5, 0.5), heave=st.floats(-3, 3),
    at=st.tuples(metres, metres, metres), ahead=st.floats(-0.2, 0.2), across=st.floats(-0.2, 0.2),
    down=st.sampled_from([-1.0, 1.0]),
)  # fmt: skip
def test_reading_and_heave_are_those_of_a_beam_from_the_vessel(
    roll: float, pitch: float, heave: float, at: tuple[float, float, float], ahead: float, across: float, down: float
) -> None:
    gauge = Gauge(at_m=at, beam=(ahead, across, down), distance_m=40.0)
    geometry = geometry_of(gauge)
    reading = gauge.read(motion_at(roll_rad=roll, pitch_rad=pitch, heave_m=heave))
    assert geometry.reading_m(heave, roll, pitch, 40.0) == pytest.approx(reading, abs=1e-9)
    assert geometry.heave_m(reading, roll, pitch) == pytest.approx(heave + geometry.sign * 40.0, abs=1e-9)


def test_a_fixed_gauge_sees_the_lever_arm_and_no_tilt_of_its_beam() -> None:
    gauge = Gauge(at_m=(8.0, 3.0, 0.0), is_fixed=True)
    geometry = geometry_of(gauge)
    assert not geometry.beam_tilts
    reading = gauge.read(motion_at(roll_rad=0.02, pitch_rad=-0.01, heave_m=0.5))
    # To second order in the angles: 8 m times 0.01 times the square of 0.02 and the like.
    assert geometry.heave_m(reading, 0.02, -0.01) == pytest.approx(0.5 - 12.0, abs=1e-4)


def test_readings_that_are_no_distances_have_no_tilt_removed() -> None:
    geometry = Geometry(forward_m=2.0, is_distance=False)
    assert geometry.heave_m(-0.5, 0.3, 0.1) == pytest.approx(-0.5 - 2.0 * math.sin(0.1))


def test_a_beam_that_nearly_lies_level_says_nothing() -> None:
    assert math.isnan(Geometry().heave_m(12.0, math.pi / 2.0, 0.0))
    assert np.isnan(Geometry().heave_m(np.array([12.0, 12.0]), np.array([0.0, 1.6]), np.zeros(2))).tolist() == [
        False,
        True,
    ]


# --- fits -------------------------------------------------------------------------------------------------------------


def readings(
    gauge: Gauge, seed: int, *, span_s: float = 300.0, error_m: float = 0.015, sea: str = "S6"
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Arguments of a fit: a laser with 2 mm of noise, and a heave whose errors are waves of 12 s that grow and fade."""
    t = np.arange(int(span_s * 20.0)) / 20.0
    truth = seaway(sea, seed).motion(t)
    rng = np.random.default_rng(seed)
    turn, fade = 2.0 * math.pi / 12.0 / 20.0, math.exp(-1.0 / 15.0 / 20.0)
    error = lfilter([1.0], [1.0, -2.0 * fade * math.cos(turn), fade**2], rng.standard_normal(len(t) + 4000))[4000:]
    heave = truth.heave_m + error_m * error / float(np.std(error))
    laser = gauge.read(truth) + 0.002 * rng.standard_normal(len(t))
    return t, laser, heave, truth.heave_velocity_mps, truth.roll_rad, truth.pitch_rad


LEAN = math.tan(math.radians(1.0))
TILTED = Gauge(at_m=(8.0, 3.0, 2.0), beam=(LEAN, 0.0, -1.0))


def fitted(gauge: Gauge, start: Geometry, seed: int = 1, **how: float) -> GeometryFit:
    fit = fit_geometry(*readings(gauge, seed, **how), start=start)  # type: ignore[arg-type]
    assert fit is not None
    return fit


@pytest.mark.parametrize(
    ("gauge", "start", "sign"),
    [
        (TILTED, Geometry(), 1),
        (msgspec.structs.replace(TILTED, beam=(LEAN, 0.0, 1.0)), Geometry(sign=-1, beam=UP), -1),
        (msgspec.structs.replace(TILTED, beam=(LEAN, 0.0, 1.0)), Geometry(), -1),
        (Gauge(at_m=(8.0 + 12.0 * LEAN, 3.0, 0.0), is_fixed=True), Geometry(sign=-1), -1),
    ],
    ids=["looks down", "looks up", "looks up, thought to look down", "looks at the vessel"],
)
def test_foot_of_the_beam_and_sign_are_found(gauge: Gauge, start: Geometry, sign: int) -> None:
    fit = fitted(gauge, start)
    assert (fit.geometry.sign, fit.is_sign_found) == (sign, True)
    assert fit.foot_forward_m == pytest.approx(8.21, abs=1.5)
    assert fit.foot_port_m == pytest.approx(3.0, abs=0.25)
    assert fit.foot_port_std_m < 0.1  # it rolls by 3 degrees and pitches by one
    assert fit.foot_forward_std_m < 0.6
    assert fit.scale == pytest.approx(1.0, abs=0.03)
    assert fit.height_m == pytest.approx(12.0, abs=0.01)
    assert fit.residual_rms_m == pytest.approx(0.015, rel=0.3)


def test_foot_scale_and_lag_lie_within_their_standard_errors() -> None:
    """Over twenty seas no bias, and errors as large as is said."""
    normalised = []
    for seed in range(20):
        fit = fitted(TILTED, Geometry(), seed)
        normalised.append(
            (
                (fit.foot_forward_m - 8.0 - 12.0 * LEAN) / fit.foot_forward_std_m,
                (fit.foot_port_m - 3.0) / fit.foot_port_std_m,
                (fit.scale - 1.0) / fit.scale_std,
                fit.late_s / fit.late_std_s,
            )
        )
    assert np.abs(np.mean(normalised, axis=0)) == pytest.approx(0.0, abs=0.7)
    size = np.sqrt(np.mean(np.square(normalised), axis=0))
    assert np.all(size > 0.6)
    assert np.all(size < 1.5)


def test_a_late_heave_of_another_scale_is_no_lever_arm() -> None:
    t, laser, heave, velocity, roll, pitch = readings(TILTED, 3)
    fit = fit_geometry(t, laser, 1.05 * (heave - 0.1 * velocity), 1.05 * velocity, roll, pitch, start=Geometry())
    assert fit is not None
    assert fit.scale == pytest.approx(1.0 / 1.05, abs=0.03)
    assert fit.late_s == pytest.approx(-0.1, abs=0.04)  # the reading is ahead of it
    assert fit.foot_port_m == pytest.approx(3.0, abs=0.25)


def test_place_and_lean_are_told_apart_hardly_and_that_is_said() -> None:
    """The product of heave and pitch is all there is: a metre times a degree, against 15 mm."""
    fit = fitted(TILTED, Geometry())
    assert not fit.is_lean_found
    assert math.degrees(fit.lean_forward_std_rad) > 0.3
    assert fit.forward_std_m > fit.foot_forward_std_m
    assert fit.is_up_found
    assert fit.geometry.up_m == pytest.approx(2.0, abs=4.0 * fit.up_std_m)
    ideal = fitted(TILTED, Geometry(), error_m=1e-4, span_s=900.0)
    assert ideal.is_lean_found
    assert math.degrees(ideal.lean_forward_rad) == pytest.approx(1.0, abs=0.3)
    assert ideal.geometry.forward_m == pytest.approx(8.0, abs=0.1)


def test_a_fixed_gauge_has_no_lean() -> None:
    fit = fitted(Gauge(at_m=(8.0, 3.0, 0.0), is_fixed=True), Geometry(sign=-1))
    assert math.isinf(fit.lean_forward_std_rad)
    assert not fit.is_lean_found


def test_nothing_is_said_of_a_vessel_that_does_not_roll() -> None:
    t, laser, heave, velocity, roll, pitch = readings(Gauge(), 1)
    assert fit_geometry(t, laser, heave, velocity, 0.0 * roll, 0.0 * pitch, start=Geometry()) is None
    barely = 1e-3  # of the roll and pitch of the others: nobody sees where the gauge is
    laser = Gauge().read(seaway("S6", 1, attitude=False).motion(t))
    fit = fit_geometry(t, laser, heave, velocity, barely * roll, barely * pitch, start=Geometry())
    assert fit is not None
    assert min(fit.foot_forward_std_m, fit.foot_port_std_m) > 20.0
    assert not fit.is_up_found


def test_too_few_readings_say_nothing() -> None:
    few = [column[:300] for column in readings(Gauge(), 1)]
    assert fit_geometry(*few, start=Geometry()) is None
    assert fit_geometry(*[column * np.nan for column in few], start=Geometry()) is None
    assert fit_geometry(*[column[:0] for column in few], start=Geometry()) is None


def test_gaps_and_spray_do_no_harm() -> None:
    t, laser, heave, velocity, roll, pitch = readings(TILTED, 2)
    laser = laser.copy()
    laser[(t % 50.0) < 20.0] = np.nan
    laser[(t > 121.0) & (t < 123.0)] = 3.0
    fit = fit_geometry(t, laser, heave, velocity, roll, pitch, start=Geometry())
    assert fit is not None
    assert fit.left_out == 8
    assert fit.foot_port_m == pytest.approx(3.0, abs=5.0 * fit.foot_port_std_m)


def test_a_heave_with_a_constant_is_no_distance() -> None:
    t, _, heave, velocity, roll, pitch = readings(Gauge(), 2, error_m=0.002)
    truth = seaway("S6", 2).motion(t)
    shown = truth.heave_m + 4.0 * np.sin(truth.pitch_rad) + 0.3
    fit = fit_geometry(t, shown, heave, velocity, roll, pitch, start=Geometry())
    assert fit is not None
    assert not fit.geometry.is_distance
    assert fit.foot_forward_m == pytest.approx(4.0, abs=5.0 * fit.foot_forward_std_m)
    assert fit.off_m(Geometry(is_distance=False)) == (fit.foot_forward_m, fit.foot_port_m)
