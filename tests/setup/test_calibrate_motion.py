"""Lateness of the angles, signs, and place of the laser from motion. Oracle: what was put into the simulation."""

from __future__ import annotations

from math import pi, radians

import msgspec
import numpy as np
import pytest
from askew import AHRS_B, any_mount, cut, lifted, read, without_angles, without_rates

from heaved.estimation.heave.laser.geometry import Geometry
from heaved.setup.calibrate_laser import LaserError, geometry_of, motion_of
from heaved.setup.calibrate_latency import LatencyError, latency_of
from heaved.setup.calibrate_record import Record, joined
from heaved.setup.calibrate_rest import rest_of
from heaved.setup.calibrate_signs import Lift, Sign, SignsError, judge_lift, judge_motion
from heaved.simulate.gauge import Gauge
from heaved.simulate.sensors import SENSORS, ImuModel

LATE_A = msgspec.structs.replace(SENSORS["A"], attitude_late_s=0.03)
LATE_B = msgspec.structs.replace(SENSORS["B"], attitude_late_s=0.03)
LAG_B_S = 0.113
"""Of a low-pass of 2 Hz."""


@pytest.mark.parametrize(
    ("model", "rate_hz", "true_s", "lag_s"),
    [
        ("A", 20.0, 0.0, 0.0),
        (LATE_A, 20.0, 0.03, 0.0),
        ("AHRS", 100.0, 0.04, 0.0),
        (LATE_B, 100.0, 0.03, LAG_B_S),
    ],
    ids=["A", "A that is late", "AHRS", "B that is late"],
)
def test_five_minutes_of_a_sea_show_the_lateness_to_three_milliseconds(
    model: str | ImuModel, rate_hz: float, true_s: float, lag_s: float
) -> None:
    found = latency_of(read(any_mount(2), model=model, seed=2, rate_hz=rate_hz), lag_s)
    assert abs(found.late_s - true_s) < 0.003
    assert found.late_std_s < 0.0055
    assert found.explained > 0.99


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_where_less_is_known_the_standard_error_says_so(seed: int) -> None:
    """Noisy gyroscopes, slow accelerometers and a lean at once: the limit is 7 ms in so little motion."""
    found = latency_of(read(any_mount(seed), model=AHRS_B, seed=seed), LAG_B_S)
    assert 0.004 < found.late_std_s < 0.010
    assert abs(found.late_s - 0.04) < 3.0 * found.late_std_s
    assert found.lean_per_s == pytest.approx(1.0 / 8.0, abs=4.0 * found.lean_std_per_s)


def test_angles_that_do_not_lean_are_told_not_to() -> None:
    found = latency_of(read(any_mount(1), seed=1))
    assert found.lean_per_s < 2.0 * max(found.lean_std_per_s, 1e-3)
    assert latency_of(read(any_mount(1), model="AHRS", seed=1)).lean_per_s == pytest.approx(0.125, abs=0.01)


def test_holes_in_a_record_do_no_harm_and_more_of_it_makes_it_surer() -> None:
    whole = read(any_mount(2), model=LATE_A, seed=2)
    holed = cut(whole, (whole.t_s % 130.0 > 5.0) & (whole.t_s % 0.35 > 0.04))
    found = latency_of(holed)
    assert abs(found.late_s - 0.03) < 3.0 * found.late_std_s
    after = read(any_mount(2), model=LATE_A, seed=3)
    more = joined(whole, msgspec.structs.replace(after, t_s=after.t_s + 400.0))
    both = latency_of(more)
    assert both.late_std_s < 0.85 * latency_of(whole).late_std_s
    assert abs(both.late_s - 0.03) < 3.0 * both.late_std_s


def test_records_that_do_not_tell_say_why() -> None:
    record = read((0.0, 0.0, 0.0))
    for poor, reason in (
        (without_rates(record), "gyroscopes"),
        (without_angles(record), "no roll and pitch"),
        (cut(record, record.t_s < 30.0), "60 s without a hole"),
        (cut(record, np.arange(len(record.t_s)) % 10 == 0), "samples a second are too few"),
        (msgspec.structs.replace(record, rates_radps=0.0 * record.rates_radps), "do not move"),
    ):
        with pytest.raises(LatencyError, match=reason):
            latency_of(poor)


def test_in_a_harbour_nothing_is_claimed() -> None:
    assert latency_of(read(any_mount(1), sea="S0", seconds=120.0)).late_std_s > 0.05


# ---- signs -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lift", list(Lift))
def test_a_lift_shows_every_sign_that_is_wrong(lift: Lift) -> None:
    right = lifted(lift)
    assert {verdict.sign for verdict in judge_lift(right, lift)} == {Sign.RIGHT}
    axis, angle, rate = (1, 0, 0) if lift is Lift.PORT_UP else (0, 1, 1)
    for name, column, places in (
        (("ax_mps2", "ay_mps2")[axis], axis, "force_mps2"),
        ("az_mps2", 2, "force_mps2"),
        (("roll_rad", "pitch_rad")[angle], angle, "angles_rad"),
        (("gx_radps", "gy_radps")[rate], rate, "rates_radps"),
    ):
        signs = np.ones(3)
        signs[column] = -1.0
        wrong = msgspec.structs.replace(right, **{places: getattr(right, places) * signs})
        assert [one.quantity for one in judge_lift(wrong, lift) if one.sign is Sign.WRONG] == [name]


def test_what_is_not_there_or_does_not_answer_is_said() -> None:
    right = lifted(Lift.PORT_UP)
    poor = without_rates(without_angles(right))
    assert [one.sign for one in judge_lift(poor, Lift.PORT_UP)] == [
        Sign.RIGHT, Sign.RIGHT, Sign.MISSING, Sign.MISSING,
    ]  # fmt: skip
    other = {one.quantity: one.sign for one in judge_lift(right, Lift.BOW_UP)}
    assert other == {
        "az_mps2": Sign.RIGHT, "ax_mps2": Sign.UNCLEAR, "pitch_rad": Sign.UNCLEAR, "gy_radps": Sign.UNCLEAR,
    }  # fmt: skip
    with pytest.raises(SignsError, match="lift it by 20 to 60 degrees"):
        judge_lift(lifted(Lift.PORT_UP, 3.0), Lift.PORT_UP)


def test_a_roll_through_half_a_turn_is_no_jump() -> None:
    """Mounted upside down its angles lie about 180 degrees."""
    record = lifted(Lift.PORT_UP)
    roll = (record.angles_rad[:, 0] + radians(160.0) + pi) % (2.0 * pi) - pi
    turned = msgspec.structs.replace(record, angles_rad=np.column_stack((roll, record.angles_rad[:, 1:])))
    assert {one.quantity: one.sign for one in judge_lift(turned, Lift.PORT_UP)}["roll_rad"] is Sign.RIGHT


@pytest.mark.parametrize("seed", [1, 4])
def test_motion_shows_which_signs_do_not_go_together(seed: int) -> None:
    record = read(any_mount(seed), seed=seed)
    assert judge_motion(record) == []
    for axis, name in enumerate(("gx_radps", "gy_radps", "gz_radps")):
        signs = np.ones(3)
        signs[axis] = -1.0
        (line,) = judge_motion(msgspec.structs.replace(record, rates_radps=record.rates_radps * signs))
        assert f"with the sign of {name} turned" in line
    (line,) = judge_motion(msgspec.structs.replace(record, force_mps2=record.force_mps2 * (1.0, -1.0, 1.0)))
    assert "with the sign of ay_mps2 turned" in line


# ---- the laser -------------------------------------------------------------------------------------------------------

AT = Gauge(at_m=(8.0, -5.0, 2.0))


def place_error_m(
    record: Record, mount: tuple[float, float, float], late_s: float, gauge: Gauge
) -> tuple[float, float]:
    motion = motion_of(record, rotation_deg=mount, bias_mps2=rest_of(record).bias_mps2, attitude_late_s=late_s)
    found = geometry_of(record, motion, Geometry())
    assert found.geometry.sign == gauge.sign
    assert max(found.foot_forward_std_m, found.foot_port_std_m) < 0.2
    return found.foot_forward_m - gauge.at_m[0], found.foot_port_m - gauge.at_m[1]


@pytest.mark.parametrize(("model", "late_s"), [("A", 0.0), ("AHRS", 0.04)])
def test_five_minutes_of_a_sea_show_where_the_laser_is_to_a_decimetre(model: str, late_s: float) -> None:
    errors = [
        place_error_m(read(any_mount(seed), model=model, seed=seed, gauge=AT), any_mount(seed), late_s, AT)
        for seed in (1, 2, 3, 4)
    ]
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert rms.tolist() == pytest.approx([0.0, 0.0], abs=0.1)


@pytest.mark.parametrize(("crooked_deg", "sea", "most_m"), [(1.0, "S4", 0.3), (0.0, "S5", 0.1)])
def test_slow_and_noisy_accelerometers_show_it_to_three_decimetres_or_in_more_sea_to_one(
    crooked_deg: float, sea: str, most_m: float
) -> None:
    """A lag of 0.11 s, a scale of 1.02; where they are crooked, too, sway is in the heave."""
    model = msgspec.structs.replace(SENSORS["B"], mounting_roll_rad=radians(crooked_deg))
    errors = [
        place_error_m(read(any_mount(seed), model=model, seed=seed, sea=sea, gauge=AT), any_mount(seed), 0.0, AT)
        for seed in (1, 2, 3)
    ]
    assert np.sqrt(np.mean(np.square(errors), axis=0)).tolist() == pytest.approx([0.0, 0.0], abs=most_m)


def test_a_laser_that_looks_up_counts_the_other_way() -> None:
    gauge = Gauge(at_m=(-3.0, 4.0, 0.0), beam=(0.0, 0.0, 1.0))
    forward, port = place_error_m(read((0.0, 0.0, 40.0), seed=5, gauge=gauge), (0.0, 0.0, 40.0), 0.0, gauge)
    assert max(abs(forward), abs(port)) < 0.25


def test_angles_that_lean_make_metres_of_it_unless_gyroscopes_correct_them() -> None:
    mount = any_mount(2)
    record = without_rates(read(mount, model="AHRS", seed=2, gauge=AT))
    motion = motion_of(record, rotation_deg=mount, bias_mps2=(0.0, 0.0, 0.0), attitude_late_s=0.04)
    assert abs(geometry_of(record, motion, Geometry()).foot_forward_m - 8.0) > 0.5


def test_a_laser_of_which_nothing_can_be_told_says_why() -> None:
    mount = (0.0, 0.0, 0.0)
    record = read(mount, gauge=AT)
    motion = motion_of(record, rotation_deg=mount, bias_mps2=mount, attitude_late_s=0.0)
    none = np.zeros(0)
    other = np.random.default_rng(1).normal(12.0, 0.3, record.laser_m.size)
    for laser_t_s, laser_m, reason in (
        (none, none, "no reading"),
        (record.laser_t_s, np.full_like(record.laser_m, np.nan), "no reading"),
        (record.laser_t_s, other, "do not go with the heave|too little motion"),
        (record.laser_t_s[:2000:200], record.laser_m[:2000:200], "too few"),
    ):
        with pytest.raises(LaserError, match=reason):
            geometry_of(msgspec.structs.replace(record, laser_t_s=laser_t_s, laser_m=laser_m), motion, Geometry())
    with pytest.raises(LaserError, match="120 s without a hole"):
        motion_of(cut(record, record.t_s < 90.0), rotation_deg=mount, bias_mps2=mount, attitude_late_s=0.0)
    with pytest.raises(LaserError, match="no heave"):
        motion_of(without_angles(record), rotation_deg=mount, bias_mps2=mount, attitude_late_s=0.0)
