"""Oracle: a simulated gauge of known place, and a heave that is the true one but for slow waves of millimetres."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest

from heaved.estimation.heave.laser.geometry import Geometry
from heaved.estimation.heave.laser.placement import Placement, SavedPlace, heaves_m
from heaved.estimation.heave.laser.tilts import Tilt
from heaved.samples import DelayedHeave
from heaved.simulate.gauge import AT_THE_IMU, Gauge
from heaved.simulate.seaway import seaway

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.simulate.vessel import Array

ELSEWHERE = Gauge(at_m=(8.0, -3.0, 2.0))
NOISE_M = 0.002


def shown(
    gauge: Gauge,
    span_s: float = 200.0,
    *,
    configured: Geometry | None = None,
    sea: str = "S6",
    delay_s: float = 60.0,
    scale: float = 1.0,
    has_tilt: bool = True,
    leap_s: float = math.inf,
    remembered: SavedPlace | None = None,
    watch: Callable[[float, Placement], None] = lambda _t_s, _placement: None,
) -> Placement:
    """A placement after so many seconds of readings at 5 Hz; ``leap_s``: the target rises by a metre then;
    ``remembered``: of an earlier run, a minute ago; ``watch`` is told after each reading.
    """
    t = np.arange(round(span_s * 5.0)) / 5.0
    truth = seaway(sea, 2).motion(t)
    reading = scale * gauge.read(truth) + NOISE_M * np.random.default_rng(1).standard_normal(len(t))
    reading[t >= leap_s] -= 1.0
    heave: Array = truth.heave_m + 0.003 * np.sin(0.5 * t) * np.sin(0.03 * t)
    placement = Placement(configured or Geometry(), NOISE_M)
    if remembered is not None:
        placement.restore(remembered, 60.0)
    was_before = True
    for i, now in enumerate(t.tolist()):
        tilt = Tilt(float(truth.roll_rad[i]), float(truth.pitch_rad[i])) if has_tilt else None
        if was_before and now >= leap_s:
            placement.retarget()
            was_before = False
        placement.push(now, float(reading[i]), float(heave[i]), float(truth.heave_velocity_mps[i]), tilt)
        if (j := i - round(5.0 * delay_s)) >= 0:
            placement.push_delayed(DelayedHeave(t_s=float(t[j]), heave_m=float(heave[j]), std_m=0.003))
        placement.look(now)
        watch(now, placement)
    return placement


def test_a_gauge_where_it_is_configured_is_that() -> None:
    placement = shown(AT_THE_IMU)
    assert placement.is_known
    assert not placement.is_off
    assert not placement.is_open(200.0)
    assert (placement.changes, placement.remark) == (0, "")
    assert not placement.shown.is_elsewhere
    assert abs(placement.shown.ahead_m) < 0.1
    assert abs(placement.shown.port_m) < 0.1


def test_one_that_is_elsewhere_is_found_and_named() -> None:
    placement = shown(ELSEWHERE)
    assert placement.is_off
    assert not placement.is_lost
    assert re.fullmatch(
        r"laser: 8\.[56] m from where it is configured \(8\.[01] m ahead, 3\.0 m to starboard\)", placement.remark
    )
    assert placement.geometry.forward_m == pytest.approx(8.0, abs=0.1)
    assert placement.geometry.port_m == pytest.approx(-3.0, abs=0.05)
    assert not placement.is_open(200.0)
    truth = seaway("S6", 2).at(77.0)
    found = placement.heave_m(ELSEWHERE.read(truth), Tilt(truth.roll_rad, truth.pitch_rad))
    assert found - 12.0 == pytest.approx(truth.heave_m, abs=0.02)


def test_one_that_is_configured_there_is_not_named() -> None:
    placement = shown(ELSEWHERE, configured=Geometry(forward_m=8.0, port_m=-3.0, up_m=2.0))
    assert not placement.is_off
    assert placement.changes == 0
    assert placement.is_known


def test_until_it_is_known_nothing_is_to_be_learned() -> None:
    placement = shown(ELSEWHERE, 22.0)
    assert placement.is_open(22.0)
    assert shown(AT_THE_IMU, 22.0).is_open(22.0)
    assert not placement.is_open(200.0)  # for minutes nobody has told roll and pitch: they will not show it


def test_without_roll_and_pitch_nothing_is_known_of_it() -> None:
    placement = shown(ELSEWHERE, has_tilt=False)
    assert placement.fit is None
    assert not placement.is_open(200.0)
    assert math.isnan(placement.shown.ahead_m)
    assert placement.heave_m(12.0, None) == 12.0  # as configured: at the IMU
    assert math.isnan(Placement(Geometry(port_m=2.0), NOISE_M).heave_m(12.0, None))
    assert math.isnan(Placement(Geometry(beam=(0.1, 0.0, -1.0)), NOISE_M).heave_m(12.0, None))


def test_another_target_in_between_does_no_harm() -> None:
    placement = shown(ELSEWHERE, leap_s=110.0)
    assert placement.shown.ahead_m == pytest.approx(8.0, abs=0.5)
    assert placement.shown.port_m == pytest.approx(-3.0, abs=0.2)


@pytest.mark.parametrize("scale", [100.0, -1.0])
def test_what_is_no_laser_on_a_fixed_target_is_left_to_others(scale: float) -> None:
    placement = shown(AT_THE_IMU, scale=scale)
    assert not placement.is_off
    assert not placement.is_open(200.0)


def test_readings_that_are_not_above_zero_are_no_distances() -> None:
    placement = shown(Gauge(distance_m=0.3), 60.0, sea="S4", configured=Geometry())
    assert placement.geometry.is_distance  # a gauge that meets nothing says nothing
    placement = Placement(Geometry(), NOISE_M)
    for i in range(20):
        placement.push(0.2 * i, -0.5, -0.5, 0.0, Tilt(0.1, 0.0))
    assert not placement.geometry.is_distance
    assert placement.changes == 1
    assert placement.heave_m(-0.5, Tilt(0.1, 0.0)) == -0.5


def test_many_readings_at_once_are_as_each() -> None:
    placement = Placement(Geometry(forward_m=4.0), NOISE_M)
    reading, roll, pitch = np.array([12.0, 12.5, 11.0]), np.array([0.1, math.nan, 0.0]), np.array([0.0, math.nan, 0.1])
    found = heaves_m(placement.geometry, reading, roll, pitch)
    assert math.isnan(found[1])
    for i in (0, 2):
        assert found[i] == placement.heave_m(float(reading[i]), Tilt(float(roll[i]), float(pitch[i])))


# --- over a restart --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def remembered() -> SavedPlace:
    saved = shown(ELSEWHERE).saved()
    assert saved is not None
    # Through the file.
    return msgspec.json.decode(msgspec.json.encode(saved), type=SavedPlace)


def test_a_place_that_was_found_is_said_and_used_at_once_and_nothing_learned_until_it_shows_again(
    remembered: SavedPlace,
) -> None:
    truth, was_open, errors_m, remarks = seaway("S6", 2), {}, [], set()

    def watch(t_s: float, placement: Placement) -> None:
        was_open[t_s] = placement.is_open(t_s)
        now = truth.at(t_s)
        found_m = placement.heave_m(ELSEWHERE.read(now), Tilt(now.roll_rad, now.pitch_rad))
        errors_m.append(found_m - 12.0 - now.heave_m)
        remarks.add(placement.remark)
        assert placement.shown.is_elsewhere
        assert not placement.is_lost

    placement = shown(ELSEWHERE, remembered=remembered, watch=watch)
    assert np.max(np.abs(errors_m)) < 0.03
    assert all(re.match(r"laser: 8\.[56] m from where it is configured", remark) for remark in remarks)
    assert all(is_open for t_s, is_open in was_open.items() if t_s < 25.0)
    assert not was_open[199.8]
    assert placement.is_known
    now = placement.saved()
    assert now is not None
    assert now.unconfirmed_s == 0.0


@pytest.mark.parametrize(
    ("gauge", "is_elsewhere"), [(AT_THE_IMU, False), (Gauge(at_m=(2.0, 4.0, 2.0)), True)], ids=["back", "elsewhere"]
)
def test_one_that_has_been_moved_since_is_found_out_and_teaches_nothing_before(
    remembered: SavedPlace, gauge: Gauge, is_elsewhere: bool
) -> None:
    taught_at_the_old_place = []

    def watch(t_s: float, placement: Placement) -> None:
        if placement.geometry == remembered.geometry:
            taught_at_the_old_place.append(not placement.is_open(t_s))

    placement = shown(gauge, remembered=remembered, watch=watch)
    alone = shown(gauge)
    assert not any(taught_at_the_old_place)
    assert placement.is_known
    assert placement.is_off is is_elsewhere
    assert placement.geometry == alone.geometry
    assert placement.remark == alone.remark
    assert (placement.saved() is not None) is is_elsewhere


def test_until_it_shows_again_it_is_saved_as_it_was(remembered: SavedPlace) -> None:
    placement = shown(ELSEWHERE, span_s=10.2, remembered=remembered)
    found = placement.saved()
    assert found is not None
    assert found.unconfirmed_s == pytest.approx(70.0)
    assert msgspec.structs.replace(found, unconfirmed_s=0.0) == remembered
    still = Placement(Geometry(), NOISE_M)
    still.restore(remembered, math.nan)
    assert still.saved() == remembered


def test_it_says_nothing_of_a_gauge_that_is_configured_otherwise_nor_when_it_is_old(remembered: SavedPlace) -> None:
    for configured, age_s in ((Geometry(forward_m=8.0, port_m=-3.0, up_m=2.0), 60.0), (Geometry(), 8.0 * 86400.0)):
        placement = Placement(configured, NOISE_M)
        placement.restore(remembered, age_s)
        assert not placement.is_off
        assert placement.geometry == configured
        assert placement.saved() is None


def test_a_gauge_at_its_place_leaves_nothing_to_remember() -> None:
    assert shown(AT_THE_IMU).saved() is None
    assert Placement(Geometry(), NOISE_M).saved() is None
