"""A frame moved on to the moment at which an output tells of it. Oracle: a motion that is known at every moment."""

from math import cos, hypot, isnan, nan, pi, sin

import msgspec
import pytest

from heaved.outputs.motion import LONGEST_S, Lead, motion_at
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
)

OMEGA = 2.0 * pi / 8.0
HEAVE_M, ROLL_RAD, PITCH_RAD = 2.0, 0.08, 0.03
LEAD_S = 0.2
HORIZONS_S = (0.05, 0.1, 0.15, 0.5, 1.0)
UTC_S = 1_700_000_000.0


def heave(t_s: float) -> tuple[float, float, float]:
    return HEAVE_M * sin(OMEGA * t_s), HEAVE_M * OMEGA * cos(OMEGA * t_s), -HEAVE_M * OMEGA**2 * sin(OMEGA * t_s)


def angles(t_s: float) -> tuple[float, float, float]:
    return ROLL_RAD * sin(OMEGA * t_s + 1.0), PITCH_RAD * cos(OMEGA * t_s), 1.0 + 0.01 * sin(OMEGA * t_s)


def utc_s(t_s: float) -> float:
    return UTC_S + t_s


def frame(t_s: float, *, lead_s: float = 0.0, state: HeaveState = HeaveState.VALID) -> MotionFrame:
    h, v, _ = heave(t_s + lead_s)
    roll, pitch, yaw = angles(t_s)
    now = None
    if lead_s:
        h0, v0, _ = heave(t_s)
        now = MotionNow(heave_m=h0, heave_std_m=0.01, heave_velocity_mps=v0)
    rock = []
    for horizon_s in HORIZONS_S:
        r, p, y = angles(t_s + horizon_s)
        rock.append(
            RockPrediction(
                horizon_s=horizon_s, roll_rad=r, pitch_rad=p, yaw_rad=y,
                roll_std_rad=0.001 * horizon_s, pitch_std_rad=0.002 * horizon_s, yaw_std_rad=0.003 * horizon_s,
            )
        )  # fmt: skip
    return MotionFrame(
        t_s=t_s,
        quality=Quality(heave=state, laser=LaserState.OFF, correction=CorrectionState.OFF),
        heave_m=h,
        heave_std_m=0.03 if lead_s else 0.01,
        heave_velocity_mps=v,
        heave_acceleration_mps2=heave(t_s)[2],
        roll_rad=roll,
        pitch_rad=pitch,
        yaw_rad=yaw,
        points=(
            PointMotion(
                name="tip",
                heave_m=10.0 + h,
                heave_std_m=0.05,
                heave_velocity_mps=v,
                heave_acceleration_mps2=heave(t_s)[2],
                state=HeaveState.DEGRADED,
                reasons=("crane angles 1.3 s old",),
            ),
        ),
        rock=tuple(rock),
        forecast=tuple(HeaveForecast(horizon_s=s, heave_m=heave(t_s + s)[0], std_m=0.02 + 0.1 * s) for s in HORIZONS_S),
        compensation_lead_s=lead_s,
        now=now,
        delayed=DelayedHeave(t_s=t_s - 60.0, heave_m=0.5, std_m=0.005),
    )


@pytest.mark.parametrize("age_s", [0.0, 0.001, 0.01, 0.045, 0.12])
@pytest.mark.parametrize("t_s", [0.0, 1.3, 2.1, 4.4, 6.9])
def test_a_telegram_is_of_the_moment_at_which_it_is_sent(t_s: float, age_s: float) -> None:
    motion = motion_at(frame(t_s), "", Lead.TRANSMISSION, t_s + age_s, utc_s)
    h, v, _ = heave(t_s + age_s)
    # What is left out: the jerk of the heave, the bend of an angle between predictions that are 0.1 s apart at most.
    jerk, bend = HEAVE_M * OMEGA**3, ROLL_RAD * OMEGA**2
    assert motion.heave_m == pytest.approx(h, abs=jerk * age_s**3 / 6.0 + 1e-12)
    assert motion.heave_velocity_mps == pytest.approx(v, abs=jerk * age_s**2 / 2.0 + 1e-12)
    for found, true in zip((motion.roll_rad, motion.pitch_rad, motion.yaw_rad), angles(t_s + age_s), strict=True):
        assert found == pytest.approx(true, abs=bend * 0.05**2 / 8.0 + 1e-12)
    assert motion.utc_s == pytest.approx(UTC_S + t_s + age_s, abs=1e-6)
    assert motion.age_s == pytest.approx(age_s, abs=1e-12)


def test_without_a_lead_it_is_that_of_the_sample() -> None:
    motion = motion_at(frame(3.0), "", Lead.NONE, 3.25, utc_s)
    assert (motion.heave_m, motion.heave_velocity_mps) == heave(3.0)[:2]
    assert (motion.roll_rad, motion.pitch_rad, motion.yaw_rad) == angles(3.0)
    assert motion.heave_std_m == 0.01
    assert motion.utc_s == UTC_S + 3.0
    assert motion.age_s == 0.25


@pytest.mark.parametrize(
    ("lead", "ahead_s", "std_m"),
    [
        (Lead.NONE, 0.0, 0.01),
        (Lead.TRANSMISSION, 0.01, hypot(0.01 * 0.8**0.5, 0.025 * 0.2**0.5)),
        (Lead.COMPENSATION, 0.21, 0.03),
    ],
)
def test_the_compensators_lead_is_for_who_asks_for_it(lead: Lead, ahead_s: float, std_m: float) -> None:
    motion = motion_at(frame(3.0, lead_s=LEAD_S), "", lead, 3.01, utc_s)
    assert motion.heave_m == pytest.approx(heave(3.0 + ahead_s)[0], abs=1e-4)
    assert motion.heave_velocity_mps == pytest.approx(heave(3.0 + ahead_s)[1], abs=0.02)
    # The prediction after 0.15 s is that of 0.5 s: so far apart a roll of 8 s bends away from a line.
    assert motion.roll_rad == pytest.approx(angles(3.0 + ahead_s)[0], abs=ROLL_RAD * OMEGA**2 * 0.35**2 / 8.0)
    assert motion.heave_std_m == pytest.approx(std_m)
    assert motion.utc_s == pytest.approx(UTC_S + 3.0 + ahead_s, abs=1e-6)


def test_a_point_has_its_own_motion_and_its_own_worth() -> None:
    motion = motion_at(frame(3.0), "tip", Lead.TRANSMISSION, 3.02, utc_s)
    assert motion.heave_m == pytest.approx(10.0 + heave(3.02)[0], abs=1e-5)
    assert motion.heave_std_m == 0.05
    assert motion.state is HeaveState.DEGRADED
    assert motion.reasons == ("crane angles 1.3 s old",)
    assert motion.delayed is None
    assert isnan(motion.delayed_utc_s)


def test_a_point_is_worth_no_more_than_the_heave() -> None:
    settling = frame(3.0, state=HeaveState.SETTLING)
    assert motion_at(settling, "tip", Lead.NONE, 3.0, utc_s).state is HeaveState.SETTLING


def test_the_delayed_heave_has_its_own_time() -> None:
    motion = motion_at(frame(100.0), "", Lead.NONE, 100.0, utc_s)
    assert motion.delayed is not None
    assert motion.delayed.heave_m == 0.5
    assert motion.delayed_utc_s == UTC_S + 40.0


def without(**changed: object) -> MotionFrame:
    return msgspec.structs.replace(frame(3.0), **changed)


UNKNOWN = {
    "no heave": (without(heave_m=nan, heave_std_m=nan, heave_velocity_mps=nan), "", 3.0, True),
    "no velocity to move it on with": (without(heave_velocity_mps=nan), "", 3.01, True),
    "no acceleration: a line will do": (without(heave_acceleration_mps2=nan), "", 3.01, False),
    "a point that is not there": (frame(3.0), "moonpool", 3.0, True),
    "a frame that is too old": (frame(3.0), "", 3.0 + LONGEST_S + 0.01, True),
    "a frame of the future, as of a clock that is off": (frame(3.0), "", 3.0 - LONGEST_S - 0.01, True),
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_what_is_not_known_is_invalid(name: str) -> None:
    given, point, now_s, is_invalid = UNKNOWN[name]
    motion = motion_at(given, point, Lead.TRANSMISSION, now_s, utc_s)
    assert (motion.state is HeaveState.INVALID) == is_invalid == isnan(motion.heave_m)
    if is_invalid:
        assert isnan(motion.heave_std_m)
        assert isnan(motion.heave_velocity_mps)
        assert isnan(motion.heave_acceleration_mps2)


def test_what_an_old_frame_knew_of_the_angles_is_not_known_either() -> None:
    motion = motion_at(frame(3.0), "", Lead.TRANSMISSION, 3.6, utc_s)
    assert not motion.has_attitude
    assert "the newest frame is 0.6 s old" in motion.reasons


def test_without_predictions_angles_are_those_of_the_reading_or_none() -> None:
    bare = without(rock=())
    assert motion_at(bare, "", Lead.NONE, 3.0, utc_s).roll_rad == angles(3.0)[0]
    assert motion_at(bare, "", Lead.TRANSMISSION, 3.01, utc_s).roll_rad == angles(3.0)[0]
    assert isnan(motion_at(bare, "", Lead.TRANSMISSION, 3.03, utc_s).roll_rad)


def test_predictions_that_know_nothing_yet_are_none() -> None:
    begun = without(rock=tuple(RockPrediction(horizon_s=s) for s in HORIZONS_S))
    assert motion_at(begun, "", Lead.TRANSMISSION, 3.01, utc_s).roll_rad == angles(3.0)[0]
    assert isnan(motion_at(begun, "", Lead.TRANSMISSION, 3.03, utc_s).roll_rad)
