"""The comparison with an existing MRU. Oracle: sinusoids at the moments of the readings, whatever the frames' own."""

from __future__ import annotations

from itertools import pairwise
from math import asin, cos, degrees, hypot, inf, isnan, nan, pi, radians, remainder, sin, sqrt
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

from heaved.estimation.reference_mru.estimator import HeavePositive, Params, ReferenceMru, RollConvention
from heaved.samples import (
    CorrectionState,
    Fault,
    HeaveState,
    LaserState,
    MotionFrame,
    MotionNow,
    MruComparison,
    MruSample,
    PointMotion,
    Quality,
)

if TYPE_CHECKING:
    from collections.abc import Callable

OMEGA = 2.0 * pi / 7.0
QUALITY = Quality(heave=HeaveState.VALID, laser=LaserState.OFF, correction=CorrectionState.OFF)
STD_M = 0.03


def heave_m(t_s: float) -> float:
    return sin(OMEGA * t_s) + 0.3 * sin(2.3 * OMEGA * t_s + 1.0)


def velocity_mps(t_s: float) -> float:
    return OMEGA * cos(OMEGA * t_s) + 0.3 * 2.3 * OMEGA * cos(2.3 * OMEGA * t_s + 1.0)


def roll_rad(t_s: float) -> float:
    return 0.1 * sin(OMEGA * t_s + 0.5)


def pitch_rad(t_s: float) -> float:
    return 0.05 * sin(1.1 * OMEGA * t_s + 2.0)


def yaw_rad(t_s: float) -> float:
    """Through south again and again."""
    return remainder(3.1 + 0.2 * sin(0.3 * OMEGA * t_s), 2.0 * pi)


def frame(t_s: float, **changed: Any) -> MotionFrame:
    return msgspec.structs.replace(
        MotionFrame(
            t_s=t_s, quality=QUALITY, heave_m=heave_m(t_s), heave_std_m=STD_M, heave_velocity_mps=velocity_mps(t_s),
            roll_rad=roll_rad(t_s), pitch_rad=pitch_rad(t_s), yaw_rad=yaw_rad(t_s),
        ),
        **changed,
    )  # fmt: skip


def reading(t_s: float, late_s: float = 0.0, scale: float = 1.0, **added: float) -> MruSample:
    """Of a motion ``late_s`` ago, with what is added to it."""
    at = t_s - late_s
    return MruSample(
        t_s=t_s,
        heave_m=scale * heave_m(at) + added.get("heave_m", 0.0),
        heave_velocity_mps=scale * velocity_mps(at),
        roll_rad=roll_rad(at) + added.get("roll_rad", 0.0),
        pitch_rad=pitch_rad(at) + added.get("pitch_rad", 0.0),
        yaw_rad=yaw_rad(at) % (2.0 * pi),
    )


def compared(
    read: Callable[[float], MruSample | None],
    *,
    params: Params | None = None,
    made: Callable[[float], MotionFrame | None] = frame,
    until_s: float = 150.0,
    rate_hz: float = 20.0,
    arrives_s: float = 0.4,
) -> MruComparison:
    """What the estimator says in the end: readings at odd times, each arriving ``arrives_s`` after it was valid."""
    stage = ReferenceMru(params or Params(window_s=120.0))
    period_s = 1.0 / rate_hz + 1.7e-4
    readings = [k * period_s + 0.0123 for k in range(round((until_s - arrives_s) / period_s))]
    events = [(k / 50.0, 0, k / 50.0) for k in range(round(50.0 * until_s))]
    events += [(t_s + arrives_s, 1, t_s) for t_s in readings]
    for _, kind, t_s in sorted(events):
        if kind and (sample := read(t_s)) is not None:
            stage.push(sample)
        elif not kind and (one := made(t_s)) is not None:
            stage.push_frame(one)
    assert stage.comparison is not None
    return stage.comparison


@pytest.mark.parametrize("arrives_s", [-0.3, 0.0, 0.4, 2.0])
@pytest.mark.parametrize("rate_hz", [1.0, 20.0])
def test_equal_motions_agree_whenever_the_readings_come(arrives_s: float, rate_hz: float) -> None:
    said = compared(reading, arrives_s=arrives_s, rate_hz=rate_hz)
    for one in (said.heave, said.heave_velocity, said.roll, said.pitch, said.yaw):
        assert abs(one.difference) < 1e-3
        assert one.std_difference < 1e-3
        assert one.correlation == pytest.approx(1.0, abs=1e-3)
        assert one.delay_s == pytest.approx(0.0, abs=0.01)
        assert one.scale == pytest.approx(1.0, abs=0.01)
    assert said.warnings == ()
    assert 110.0 < said.compared_s <= 120.0
    assert said.heave.reference == pytest.approx(heave_m(said.t_s), abs=1e-3)


def test_what_is_late_and_too_small_is_told_so() -> None:
    said = compared(lambda t_s: reading(t_s, late_s=0.4, scale=0.9))
    assert said.heave.delay_s == pytest.approx(0.4, abs=0.01)
    assert said.heave.scale == pytest.approx(0.9, abs=0.01)
    late = 0.5 * abs(0.9 - 1.0 * complex(cos(0.4 * OMEGA), sin(0.4 * OMEGA))) ** 2
    late += 0.5 * abs(0.27 - 0.3 * complex(cos(0.92 * OMEGA), sin(0.92 * OMEGA))) ** 2
    assert said.heave.std_difference == pytest.approx(sqrt(late), rel=0.02)
    assert said.heave.explained == pytest.approx(hypot(STD_M, 0.05), rel=1e-6)
    (heave, roll, _) = said.warnings
    assert heave.startswith("reference MRU: heave differs by ")
    assert heave.endswith("it is 0.4 s late (latency_ms, or its own filter)")
    assert roll.startswith("reference MRU: roll differs by ")


def test_how_it_is_mounted_is_a_mean_and_no_divergence() -> None:
    said = compared(lambda t_s: reading(t_s, heave_m=2.0, roll_rad=radians(3.0), pitch_rad=radians(-1.5)))
    assert degrees(said.roll.mean_difference) == pytest.approx(3.0, abs=1e-3)
    assert degrees(said.pitch.mean_difference) == pytest.approx(-1.5, abs=1e-3)
    assert said.roll.rms_difference == pytest.approx(abs(said.roll.mean_difference), rel=1e-4)
    assert said.heave.mean_difference == pytest.approx(2.0, abs=1e-3)
    assert said.warnings == ()


CAUSES: dict[str, tuple[Callable[[float], MruSample | None], Params, str]] = {
    "counts down": (lambda t: reading(t, scale=-1.0), Params(), "it counts the other way (heave_positive?)"),
    "in decimetres": (lambda t: reading(t, scale=10.0), Params(), "it moves 10 times as much as ours"),
    "hangs": (lambda t: msgspec.structs.replace(reading(t), heave_m=0.31), Params(), "it stands still"),
    "of another ship": (
        lambda t: msgspec.structs.replace(reading(t), heave_m=sin(0.61 * OMEGA * t)),
        Params(),
        "they do not move alike (point?)",
    ),
}


@pytest.mark.parametrize("name", CAUSES)
def test_the_likely_cause_is_named(name: str) -> None:
    read, params, words = CAUSES[name]
    said = compared(read, params=params, until_s=130.0)
    assert any(text.startswith("reference MRU: heave differs") and text.endswith(words) for text in said.warnings)


def test_signs_and_conventions_by_name() -> None:
    def told(t_s: float) -> MruSample:
        roll, pitch = 0.6 + roll_rad(t_s), 4.0 * pitch_rad(t_s)
        return MruSample(
            t_s=t_s, heave_m=-heave_m(t_s), heave_velocity_mps=-velocity_mps(t_s),
            roll_rad=asin(sin(roll) * cos(pitch)), pitch_rad=pitch,
        )  # fmt: skip

    def ours(t_s: float) -> MotionFrame:
        return frame(t_s, roll_rad=0.6 + roll_rad(t_s), pitch_rad=4.0 * pitch_rad(t_s))

    said = compared(
        told,
        made=ours,
        params=Params(heave_positive=HeavePositive.DOWN, roll_convention=RollConvention.TSS, window_s=60.0),
    )
    for one in (said.heave, said.heave_velocity, said.roll, said.pitch):
        assert one.std_difference < 1e-3
        assert abs(one.mean_difference) < 1e-3
    assert all(isnan(value) for value in msgspec.structs.astuple(msgspec.structs.replace(said.yaw, own=nan)))


def test_the_heave_of_a_point_at_the_frame_s_own_time() -> None:
    """With a compensation lead the frame's heave is of a later moment; ``now`` has that of its own."""

    def ours(t_s: float) -> MotionFrame:
        at = PointMotion(
            name="mru", heave_m=0.5 * heave_m(t_s), heave_std_m=0.1, heave_velocity_mps=0.5 * velocity_mps(t_s)
        )
        now = MotionNow(
            heave_m=heave_m(t_s), heave_std_m=STD_M, heave_velocity_mps=velocity_mps(t_s),
            points=(PointMotion(name="other", heave_m=9.0), at),
        )  # fmt: skip
        return frame(t_s, heave_m=heave_m(t_s + 0.5), compensation_lead_s=0.5, now=now)

    said = compared(lambda t_s: reading(t_s, scale=0.5), made=ours, params=Params(point="mru"))
    assert said.heave.std_difference < 1e-3
    assert said.heave.explained == pytest.approx(hypot(0.1, 0.05), rel=1e-3)
    assert isnan(compared(reading, made=ours, params=Params(point="gone"), until_s=70.0).heave.own)


BAD_FRAMES: dict[str, dict[str, Any]] = {
    "settling": {"quality": msgspec.structs.replace(QUALITY, heave=HeaveState.SETTLING)},
    "invalid": {"quality": msgspec.structs.replace(QUALITY, heave=HeaveState.INVALID), "heave_m": nan},
    "of a later moment alone": {"compensation_lead_s": 0.5},
}


@pytest.mark.parametrize("name", BAD_FRAMES)
def test_a_heave_of_ours_that_is_none_is_not_compared(name: str) -> None:
    said = compared(lambda t_s: reading(t_s, scale=5.0), made=lambda t_s: frame(t_s, **BAD_FRAMES[name]), until_s=80.0)
    assert isnan(said.heave.difference)
    assert isnan(said.heave.std_difference)
    assert said.roll.std_difference < 1e-3
    assert said.warnings == ()


def test_no_line_is_drawn_over_a_hole_of_ours() -> None:
    """Our frames stop for ten seconds: readings of that time are compared with nothing."""
    stage = ReferenceMru(Params())
    differences: list[float] = []
    for k in range(4000):
        t_s = k / 50.0
        if not 40.0 < t_s < 50.0:
            stage.push_frame(frame(t_s))
        if k % 5 == 2:
            stage.push(reading(t_s - 0.006))
            if stage.comparison is not None:
                differences.append(stage.comparison.heave.difference)
    known = [difference for difference in differences if not isnan(difference)]
    assert max(map(abs, known)) < 1e-3
    assert len(known) > 0.5 * len(differences)


DISASTERS: dict[str, Callable[[int, MruSample], list[MruSample]]] = {
    "faulty": lambda k, one: [MruSample(t_s=one.t_s, fault=Fault.CRC)] if k % 3 else [one],
    "twice": lambda _, one: [one, one],
    "backwards now and then": lambda k, one: [msgspec.structs.replace(one, t_s=one.t_s - 5.0 * (k % 7 == 0))],
    "at no time": lambda k, one: [msgspec.structs.replace(one, t_s=(nan, inf, -inf)[k % 3]), one],
    "from the future": lambda k, one: [one, *([msgspec.structs.replace(one, t_s=one.t_s + 1e6)] if k == 2000 else [])],
    "not a number": lambda k, one: [msgspec.structs.replace(one, heave_m=nan if k % 2 else one.heave_m)],
    "beyond all": lambda k, one: [msgspec.structs.replace(one, heave_m=1e300 * (k % 2), pitch_rad=1e9, roll_rad=-1e9)],
    "thousands at once": lambda k, one: [
        msgspec.structs.replace(one, t_s=one.t_s + 1e-7 * i) for i in range(500 if k % 500 == 0 else 1)
    ],
    "upright": lambda _, one: [msgspec.structs.replace(one, pitch_rad=0.5 * pi, roll_rad=0.5 * pi)],
}


@pytest.mark.parametrize("name", DISASTERS)
@pytest.mark.parametrize("convention", RollConvention)
def test_disasters(name: str, convention: RollConvention) -> None:
    """No exception, no infinity, and what is kept stays bounded."""
    stage = ReferenceMru(Params(window_s=60.0, roll_convention=convention))
    seen: list[float] = []
    for k in range(4000):
        t_s = k / 50.0
        stage.push_frame(frame(t_s))
        for sample in DISASTERS[name](k, reading(t_s + 0.01)):
            stage.push(sample)
        assert len(stage._waiting) <= 400
        if stage.comparison is not None and (not seen or seen[-1] != stage.comparison.t_s):
            seen.append(stage.comparison.t_s)
            for one in (stage.comparison.heave, stage.comparison.roll):
                assert all(value < inf for value in msgspec.structs.astuple(one) if not isnan(value))
    assert all(b - a > 0.09 for a, b in pairwise(seen))
    assert len(stage._pairs) <= 320
    assert len(stage._own) <= 320


def test_without_readings_nothing_is_kept() -> None:
    stage = ReferenceMru(Params())
    for k in range(100):
        stage.push_frame(frame(k / 50.0))
    assert stage.comparison is None
    assert len(stage._own) == 0
