"""All joints together: postures, what they are worth, and what befalls a crane's encoders."""

from __future__ import annotations

from math import isnan, nan, pi, radians
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pytest
from cranes import BUILD, PARAMS

from heaved.estimation.crane.estimator import CraneEstimator
from heaved.estimation.crane.geometry import Params
from heaved.samples import CraneSample, Fault, HeaveState
from heaved.simulate.crane import CraneAtWork, CraneModel, CraneSensors, tip_in_ship_axes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

TIP = ((0.0, 0.0, 0.0), False)
HOOK = ((0.0, 0.0, 0.0), True)
CRANE = CraneAtWork(seed=2)


def readings(
    crane: CraneAtWork = CRANE, *, start_s: float = 0.0, end_s: float = 60.0, rate_hz: float = 10.0
) -> Iterator[CraneSample]:
    sensors = CraneSensors(crane, seed=2)
    for t_s in np.arange(start_s, end_s, 1.0 / rate_hz).tolist():
        yield sensors.read(t_s)


def fed(samples: Iterator[CraneSample], params: Params = PARAMS) -> CraneEstimator:
    one = CraneEstimator(params)
    for sample in samples:
        one.push(sample)
    return one


def off(one: CraneEstimator, t_s: float, crane: CraneAtWork = CRANE) -> float:
    """Distance of the tip from the truth."""
    (place,) = one.places(t_s, [TIP])
    return float(np.linalg.norm(np.array(place.at_m) - tip_in_ship_axes(BUILD, crane.at(t_s).at)))


@pytest.mark.parametrize("end_s", [20.0, 47.3, 90.0, 133.0])
def test_tip_and_hook_are_where_the_crane_has_them_and_move_as_it_does(end_s: float) -> None:
    one = fed(readings(end_s=end_s))
    t_s = end_s - 0.05
    tip, hook = one.places(t_s, [TIP, HOOK])
    h = 1e-3
    ahead, behind = (CRANE.at(t_s + s * h).at for s in (1, -1))
    velocity = (tip_in_ship_axes(BUILD, ahead) - tip_in_ship_axes(BUILD, behind)) / (2 * h)
    # 0.1 degrees at 50 m are 9 cm, and a quarter of a degree per second 20 cm/s.
    np.testing.assert_allclose(np.array(tip.at_m), tip_in_ship_axes(BUILD, CRANE.at(t_s).at), atol=0.1)
    np.testing.assert_allclose(np.array(tip.velocity_mps), velocity, atol=0.2)
    assert hook.at_m == tip.at_m
    assert hook.hang_m == pytest.approx(float(CRANE.at(t_s).at[3]) / 2 + 1.2, abs=0.02)
    assert hook.hang_velocity_mps == pytest.approx(float(CRANE.at(t_s).rate[3]) / 2, abs=0.03)


def test_points_beside_the_tip_turn_with_the_slew_and_above_the_hook_hang_above_it() -> None:
    parked = CraneAtWork(CraneModel(is_parked=True), seed=2)
    one = fed(readings(parked))
    tip, beside, hook, above = one.places(60.0, [TIP, ((1.0, 2.0, 3.0), False), HOOK, ((0.0, 0.0, 3.0), True)])
    slew = float(parked.at(0.0).at[0])
    outward, left = np.array([np.cos(slew), -np.sin(slew), 0]), np.array([np.sin(slew), np.cos(slew), 0])
    expected = np.array(tip.at_m) + outward + 2.0 * left + [0.0, 0.0, 3.0]
    np.testing.assert_allclose(np.array(beside.at_m), expected, atol=5e-3)
    assert above.at_m == hook.at_m
    assert hook.hang_m - above.hang_m == pytest.approx(3.0)


def test_zeros_and_fixed_joints() -> None:
    """An encoder with an offset of its own, and a jib that is pinned."""
    params = Params(boom_length_m=10.0, jib_length_m=5.0, slew_zero_deg=30.0, boom_zero_deg=-10.0, jib_fixed_deg=0.0)
    one = CraneEstimator(params)
    for t_s in np.arange(0.0, 5.0, 0.1).tolist():
        one.push(CraneSample(t_s=t_s, slew_rad=radians(30.0), boom_rad=radians(80.0)))
    (place,) = one.places(5.0, [TIP])
    assert place.at_m == pytest.approx((5.0, 0.0, 10.0), abs=1e-6)
    assert one.worth(5.0, hook=False).state is None
    assert one.worth(5.0, hook=True).state is HeaveState.INVALID


# ---- what befalls it -------------------------------------------------------------------------------------------------


def without(name: str) -> Callable[[CraneSample], CraneSample]:
    return lambda sample: msgspec.structs.replace(sample, **{name: nan})


def worth_of(one: CraneEstimator, t_s: float, *, hook: bool = False) -> tuple[HeaveState | None, tuple[str, ...]]:
    found = one.worth(t_s, hook=hook)
    return found.state, found.reasons


MISSING: dict[str, tuple[str, bool, HeaveState | None, tuple[str, ...]]] = {
    "no jib, tip": ("jib_rad", False, HeaveState.INVALID, ("no jib angle from the crane",)),
    "no slew, tip": ("slew_rad", False, HeaveState.INVALID, ("no slew angle from the crane",)),
    "no line, tip": ("line_out_m", False, None, ()),
    "no line, hook": ("line_out_m", True, HeaveState.INVALID, ("no line out from the crane",)),
}


@pytest.mark.parametrize("name", MISSING)
def test_a_joint_that_is_never_read_is_named(name: str) -> None:
    column, hook, state, reasons = MISSING[name]
    one = fed(map(without(column), readings()))
    assert worth_of(one, 60.0, hook=hook) == (state, reasons)
    (place,) = one.places(60.0, [HOOK if hook else TIP])
    assert isnan(sum(place.at_m) - place.hang_m) is (state is not None)


@pytest.mark.parametrize(
    ("age_s", "state", "reasons"),
    [
        (0.2, None, ()),
        (1.3, HeaveState.DEGRADED, ("crane angles 1.3 s old",)),
        (4.9, HeaveState.DEGRADED, ("crane angles 4.9 s old",)),
        (5.2, HeaveState.INVALID, ("crane angles 5.2 s old",)),
    ],
)
def test_old_readings_are_worth_less_and_then_nothing(
    age_s: float, state: HeaveState | None, reasons: tuple[str, ...]
) -> None:
    one = fed(readings(end_s=60.05))
    for t_s in np.arange(60.1, 60.0 + age_s, 0.1).tolist():
        one.push(CraneSample(t_s=t_s, fault=Fault.DISCONNECTED))
    assert worth_of(one, 60.0 + age_s) == (state, reasons)


def test_one_joint_that_falls_silent_is_the_one_that_is_named() -> None:
    samples = list(readings(end_s=60.05))
    cut = [without("boom_rad")(s) if s.t_s > 58.0 else s for s in samples]
    assert worth_of(fed(iter(cut)), 60.0) == (HeaveState.DEGRADED, ("boom angle 2.0 s old",))
    line = [without("line_out_m")(s) if s.t_s > 58.0 else s for s in samples]
    assert worth_of(fed(iter(line)), 60.0) == (None, ())
    assert worth_of(fed(iter(line)), 60.0, hook=True) == (HeaveState.DEGRADED, ("line out 2.0 s old",))


def test_a_slow_encoder_is_not_late() -> None:
    one = fed(readings(rate_hz=2.0))
    assert worth_of(one, 60.4) == (None, ())
    assert worth_of(one, 60.9)[0] is HeaveState.DEGRADED


def spiky(sample: CraneSample) -> CraneSample:
    return msgspec.structs.replace(sample, boom_rad=-1.0) if round(10 * sample.t_s) % 7 == 0 else sample


def turned(sample: CraneSample) -> CraneSample:
    return msgspec.structs.replace(sample, slew_rad=(sample.slew_rad + pi) % (2 * pi) - pi)


def repeated(sample: CraneSample) -> CraneSample:
    return msgspec.structs.replace(sample, t_s=sample.t_s + 0.03) if round(10 * sample.t_s) % 2 else sample


DISASTERS: dict[str, Callable[[CraneSample], CraneSample]] = {
    "spikes": spiky,
    "slew from -180 to 180": turned,
    "jitter": repeated,
    "a nan now and then": lambda s: without("jib_rad")(s) if round(10 * s.t_s) % 3 == 0 else s,
}


@pytest.mark.parametrize("name", DISASTERS)
@pytest.mark.parametrize("seed", range(3))
def test_the_tip_stays_where_it_is(name: str, seed: int) -> None:
    crane = CraneAtWork(seed=seed)
    one = CraneEstimator(PARAMS)
    for sample in readings(crane, end_s=200.0):
        one.push(DISASTERS[name](sample))
        if sample.t_s > 10.0:
            assert off(one, sample.t_s, crane) < 0.35
            (place,) = one.places(sample.t_s, [TIP])
            spread = np.sqrt(np.sum(np.square(place.spread_m)))
            assert off(one, sample.t_s, crane) < 5.0 * spread


def test_after_a_silence_it_is_found_again_at_once_wherever_it_is() -> None:
    one = fed(readings(end_s=30.0))
    for sample in readings(start_s=90.0, end_s=92.0):
        one.push(sample)
    assert off(one, 92.0) < 0.2
    assert worth_of(one, 92.0) == (None, ())


def test_what_a_stale_tip_may_be_off_by_is_in_its_spread() -> None:
    """At any moment of the crane's work the readings stop: within three seconds, three deviations hold 95 % or more."""
    held = []
    for stop_s in np.arange(12.0, 400.0, 4.7).tolist():
        one = fed(readings(start_s=stop_s - 10.0, end_s=stop_s))
        for age_s in (0.5, 1.0, 3.0):
            (place,) = one.places(stop_s + age_s, [TIP])
            held.append(off(one, stop_s + age_s) < 3.0 * np.sqrt(np.sum(np.square(place.spread_m))))
    assert np.mean(held) > 0.95


def test_its_joints_tell_what_befell_them() -> None:
    jumped: list[Any] = [
        msgspec.structs.replace(s, boom_rad=s.boom_rad - 0.7) if s.t_s > 30.0 else s for s in readings()
    ]
    resets = fed(iter(jumped)).resets
    assert resets["crane", "boom jumped"] == 1
    assert resets["crane", "spike"] >= 2
    assert set(resets) == {("crane", "boom jumped"), ("crane", "spike")}
