"""Points on a ship that rolls and a crane that moves: heave, velocity, acceleration against the chain of rotations."""

from __future__ import annotations

from math import cos, isfinite, isnan, nan, sin

import msgspec
import numpy as np
import pytest
from cranes import BUILD, PARAMS, height, tip_on_ship
from scipy.spatial.transform import Rotation

from heaved.estimation.crane.estimator import Place
from heaved.estimation.crane.geometry import Params, tip
from heaved.estimation.lever_arm import Arm, AttitudeMotion, Crane, Point, arm_motion, lever_acceleration, moving_arm
from heaved.estimation.point_motion import Ahead, Moment, PointMotions
from heaved.estimation.stages import Stages
from heaved.samples import CraneSample, HeaveForecast, HeaveState, PointMotion, RockPrediction

Array = np.ndarray
TIP, HOOK = Point(name="tip", frame="boom"), Point(name="hook", frame="hook")


class Course:
    """Everything moves along its own sinusoid, so that any derivative can be had."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        # heave, roll, pitch; slew, boom, jib, line
        self.mean = np.array([0, 0, 0, rng.uniform(-3, 3), 0.9, -0.2, 40.0])
        self.size = np.array([2.0, 0.15, 0.08, 0.3, 0.1, 0.1, 5.0])
        self.omega = rng.uniform(0.3, 0.8, 7)
        self.phase = rng.uniform(0, 6, 7)

    def at(self, t_s: float) -> Array:
        found: Array = self.mean + self.size * np.sin(self.omega * t_s + self.phase)
        return found

    def rate(self, t_s: float) -> Array:
        found: Array = self.size * self.omega * np.cos(self.omega * t_s + self.phase)
        return found

    def bend(self, t_s: float) -> Array:
        found: Array = -self.size * self.omega**2 * np.sin(self.omega * t_s + self.phase)
        return found

    def height(self, t_s: float, *, hook: bool) -> float:
        heave, roll, pitch, *joints = self.at(t_s).tolist()
        return float(heave) + height(np.array(joints), roll, pitch, hook=hook)

    def own(self, t_s: float, *, hook: bool) -> float:
        return height(self.at(t_s)[3:], 0.0, 0.0, hook=hook)


def place_at(course: Course, t_s: float, *, hook: bool) -> Place:
    """As the estimator makes it, from what is really so."""
    *_, slew, boom, jib, line = course.at(t_s).tolist()
    rates = course.rate(t_s)[3:]
    made = tip(PARAMS, slew, boom, jib)
    x, y, z = (np.array([made.by_slew, made.by_boom, made.by_jib]).T @ rates[:3]).tolist()
    hang = line / BUILD.falls + BUILD.hook_below_m
    return Place(made.at_m, (x, y, z), (), *((hang, float(rates[3]) / BUILD.falls) if hook else (0.0, 0.0)))


def attitude_at(course: Course, t_s: float) -> AttitudeMotion:
    (_, roll, pitch, *_), (_, droll, dpitch, *_), (_, broll, bpitch, *_) = (
        made.tolist() for made in (course.at(t_s), course.rate(t_s), course.bend(t_s))
    )
    return AttitudeMotion(roll, pitch, droll, dpitch, 0.0, 0.0, broll, bpitch)


@pytest.mark.parametrize("hook", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_heave_is_the_height_less_the_own_one_and_velocity_their_derivative(seed: int, hook: bool) -> None:
    course, t_s = Course(seed), 3.7 * seed
    heave, velocity = float(course.at(t_s)[0]), float(course.rate(t_s)[0])
    found = arm_motion(
        "a", moving_arm(place_at(course, t_s, hook=hook), None), heave, velocity, attitude_at(course, t_s), 0.0
    )
    assert found.own_height_m == pytest.approx(course.own(t_s, hook=hook), abs=1e-9)
    assert found.heave_m + found.own_height_m == pytest.approx(course.height(t_s, hook=hook), abs=1e-9)
    h = 1e-4
    own = (course.own(t_s + h, hook=hook) - course.own(t_s - h, hook=hook)) / (2 * h)
    whole = (course.height(t_s + h, hook=hook) - course.height(t_s - h, hook=hook)) / (2 * h)
    assert found.own_velocity_mps == pytest.approx(own, abs=1e-6)
    assert found.heave_velocity_mps == pytest.approx(whole - own, abs=1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_acceleration_is_the_second_derivative_but_for_that_of_the_crane(seed: int) -> None:
    course, t_s = Course(seed), 3.7 * seed
    arm = moving_arm(place_at(course, t_s, hook=False), None)
    found = lever_acceleration(arm, attitude_at(course, t_s))
    h = 1e-3

    def lever(at_s: float) -> float:
        """The crane goes on evenly, the ship along its sinusoids: the heave of the tip without that of the IMU."""
        _, roll, pitch, *_ = course.at(at_s).tolist()
        body = np.array(arm.at_m) + (at_s - t_s) * np.array(arm.velocity_mps)
        return float(Rotation.from_euler("xy", [roll, -pitch]).apply(body)[2] - body[2])

    assert found == pytest.approx((lever(t_s + h) - 2 * lever(t_s) + lever(t_s - h)) / h**2, abs=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_on_a_crane_base_that_bends_the_crane_goes_with_it(seed: int) -> None:
    """C passive, local from midships; heave counts from the level ship in its static shape C0."""
    rng = np.random.default_rng(seed)
    C0 = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3)).as_matrix()
    C = Rotation.from_rotvec(rng.uniform(-1e-3, 1e-3, 3)).as_matrix() @ C0
    base = (20.0, -5.0, 4.0)
    local, velocity, way = (rng.uniform(-40, 40, 3) for _ in range(3))
    roll, pitch, droll, dpitch = rng.uniform(-0.2, 0.2, 4)

    def vertical(t: float) -> Array:
        turned = Rotation.from_euler("xy", [roll + t * droll, -(pitch + t * dpitch)])
        found: Array = turned.as_matrix()[2]
        return found

    def heave_at(t: float) -> float:
        at = local + t * velocity
        return float(vertical(t) @ (np.array(base) + C.T @ at) - (base[2] + (C0.T @ at)[2]))

    def three(values: Array) -> tuple[float, float, float]:
        x, y, z = values.tolist()
        return x, y, z

    place = Place(three(local), three(velocity), (three(way),))
    arm = moving_arm(place, Crane(base, C, C0))
    found = arm_motion("a", arm, 0.0, 0.0, AttitudeMotion(roll, pitch, droll, dpitch, 0.0, 0.0), 0.0)
    assert found.heave_m == pytest.approx(heave_at(0.0), abs=1e-9)
    assert found.heave_velocity_mps == pytest.approx((heave_at(1e-5) - heave_at(-1e-5)) / 2e-5, abs=1e-6)
    assert found.own_height_m == pytest.approx(base[2] + (C0.T @ local)[2])
    assert found.own_velocity_mps == pytest.approx((C0.T @ velocity)[2])
    assert found.heave_std_m == pytest.approx(abs(vertical(0.0) @ C.T @ way - (C0.T @ way)[2]), abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_the_deviation_is_that_of_heave_attitude_its_moment_and_joints(seed: int) -> None:
    """Against the spread of many draws."""
    rng = np.random.default_rng(seed)
    slew, boom, jib = rng.uniform(-3, 3), 0.9, -0.2
    roll, pitch = 0.15, -0.1
    roll_rate, pitch_rate = 0.08, -0.05
    stds = np.array([0.03, 0.002, 0.001, 0.1, 0.05, 0.05, 0.03])
    made = tip(PARAMS, slew, boom, jib)
    spread = [
        tuple((std * np.array(way)).tolist())
        for way, std in zip((made.by_slew, made.by_boom, made.by_jib), stds[3:6].tolist(), strict=True)
    ]
    x, y, z = spread
    arm = moving_arm(Place(made.at_m, (0.0, 0.0, 0.0), (x, y, z)), None)
    attitude = AttitudeMotion(roll, pitch, roll_rate, pitch_rate, stds[1], stds[2], late_std_s=stds[6])
    found = arm_motion("a", arm, 0.0, 0.0, attitude, stds[0])
    drawn = []
    for h, r, p, s, b, j, late in (stds * rng.standard_normal((4000, 7))).tolist():
        joints = np.array([slew + s, boom + b, jib + j, 0.0])
        drawn.append(
            h
            + height(joints, roll + r + late * roll_rate, pitch + p + late * pitch_rate, hook=False)
            - height(joints, 0.0, 0.0, hook=False)
        )
    assert found.heave_std_m == pytest.approx(np.std(drawn), rel=0.06)


# ---- points of a frame -----------------------------------------------------------------------------------------------

LEVEL = AttitudeMotion(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
NO_MORE = Ahead(nan, LEVEL, (), ())


def moment(t_s: float = 10.0, attitude: AttitudeMotion = LEVEL, heave_m: float = 1.0) -> Moment:
    return Moment(from_s=t_s, t_s=t_s, heave_m=heave_m, std_m=0.01, velocity_mps=0.5, attitude=attitude)


def stages(params: Params = PARAMS, *, until_s: float = 10.0) -> Stages:
    found = Stages(None, None, params)
    for t_s in np.arange(0.0, until_s, 0.1).tolist():
        found.push(CraneSample(t_s=t_s, slew_rad=0.5, boom_rad=0.9, jib_rad=-0.2, line_out_m=40.0))
    return found


def points(of: Stages, at: Moment = moment(), ahead: Ahead = NO_MORE) -> tuple[PointMotion, ...]:  # noqa: B008
    made = PointMotions((TIP, HOOK), of)
    return made.at(at, ahead, made.foretold(at.from_s, ahead))


def test_on_a_level_ship_the_tip_heaves_as_the_ship_does_and_stands_where_it_stands() -> None:
    tip_now, hook = points(stages())
    assert (tip_now.heave_m, tip_now.heave_velocity_mps) == (1.0, 0.5)
    joints = np.array([0.5, 0.9, -0.2, 40.0])
    assert tip_now.own_height_m == pytest.approx(tip_on_ship(joints)[2], abs=1e-6)
    assert hook.own_height_m == pytest.approx(tip_now.own_height_m - 21.2, abs=1e-6)
    assert hook.heave_m == tip_now.heave_m
    assert tip_now.state is None


@pytest.mark.parametrize(
    ("made", "reason"),
    [
        (Stages(None, None, None), "no [crane] is configured"),
        (Stages(None, None, PARAMS), "no reading of the crane yet"),
        (stages(until_s=2.0), "crane angles 8.1 s old"),
        (stages(msgspec.structs.replace(PARAMS, frame="crane")), "it is not known yet how the crane base stands"),
    ],
)
def test_where_it_is_not_known_nothing_is_published_and_a_reason_is(made: Stages, reason: str) -> None:
    for point in points(made):
        assert isnan(point.heave_m)
        assert isnan(point.own_height_m)
        assert point.state is HeaveState.INVALID
        assert point.reasons == (reason,)


def test_without_an_attitude_only_its_own_motion_is_known() -> None:
    unknown = AttitudeMotion(nan, nan, nan, nan)
    for point in points(stages(), moment(attitude=unknown)):
        assert isnan(point.heave_m)
        assert isfinite(point.own_height_m)
        assert point.forecast == ()


def test_the_forecast_is_for_the_horizons_in_common() -> None:
    rock = tuple(
        RockPrediction(horizon_s=h, roll_rad=0.1 * h, pitch_rad=0.0, roll_std_rad=0.001, pitch_std_rad=0.001)
        for h in (0.1, 1.0, 3.0)
    )
    heave = tuple(HeaveForecast(horizon_s=h, heave_m=h, std_m=0.02) for h in (0.1, 0.5, 1.0))
    tip_now, _ = points(stages(), ahead=Ahead(nan, LEVEL, heave, rock))
    assert [one.horizon_s for one in tip_now.forecast] == [0.1, 1.0]
    _, later = tip_now.forecast
    x, y, z = tip_on_ship(np.array([0.5, 0.9, -0.2, 40.0])).tolist()
    assert later.heave_m == pytest.approx(1.0 + sin(0.1) * y + (cos(0.1) - 1.0) * z, abs=1e-4)
    by_angles = np.hypot((cos(0.1) * y - sin(0.1) * z) * 0.001, (x) * 0.001)
    assert later.std_m > np.hypot(0.02, by_angles)


def test_what_no_vessel_does_is_not_published() -> None:
    assert isnan(points(stages(), moment(heave_m=60.0))[0].heave_m)


def test_a_bug_in_the_crane_costs_its_points_and_is_told() -> None:
    made = stages()
    broken = made._crane

    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    assert broken is not None
    broken.places = fail  # type: ignore[method-assign, assignment]
    imu = Point(name="imu")
    tip_now, fixed = PointMotions((TIP, imu), made).at(moment(), NO_MORE, ((), ()))
    assert isinstance(made.failure, ZeroDivisionError)
    assert made.resets["crane", "ZeroDivisionError"] == 1
    assert (tip_now.state, tip_now.reasons) == (
        HeaveState.INVALID, ("the estimator of the crane failed: see the log",)
    )  # fmt: skip
    assert fixed.heave_m == 1.0
    assert made._crane is not broken, "it starts anew"


def test_a_fixed_point_has_its_height_and_no_motion_of_its_own() -> None:
    made = arm_motion("a", Arm((1.0, 2.0, 3.0), 3.0), 0.0, 0.0, LEVEL, 0.0)
    assert (made.own_height_m, made.own_velocity_mps) == (3.0, 0.0)
