"""Tilt, bias and rotation of a sensor from records at rest. Oracle: how it was put there, by scipy's rotations."""

from __future__ import annotations

from math import degrees, radians, sqrt
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest
from askew import AHRS_B, Angles, any_mount, cut, off_deg, read, tilt_off_deg, vessel_from_sensor, without_angles

from heaved.samples import GRAVITY_MPS2
from heaved.setup.calibrate_record import in_vessel_axes, turned_back
from heaved.setup.calibrate_rest import RestError, is_still, rest_of
from heaved.setup.calibrate_turn import Tilted, TiltError, apart_rad, by_rest, by_two

if TYPE_CHECKING:
    from heaved.simulate.sensors import ImuModel

HARBOUR: dict[str, float | str] = {"sea": "S0", "seconds": 20.0}


@pytest.mark.parametrize("model", ["A", "AHRS", AHRS_B], ids=["A", "AHRS", "B that leans"])
@pytest.mark.parametrize("seed", [1, 2])
def test_five_minutes_of_a_sea_show_tilt_to_a_twentieth_of_a_degree_and_the_rotation_to_a_fifth(
    model: str | ImuModel, seed: int
) -> None:
    mount = any_mount(seed)
    first = rest_of(read(mount, model=model, seed=seed))
    found = by_rest(first.up, first.up_std_rad, z_deg=mount[2])
    assert tilt_off_deg(found.rotation_deg, mount) < 0.05
    second = rest_of(read(mount, model=model, seed=seed + 1, tilt=(0.0, 10.0)))
    turned = by_two(first.up, second.up, max(first.up_std_rad, second.up_std_rad), Tilted.BOW_UP)
    assert off_deg(turned.rotation_deg, mount) < 0.2
    assert degrees(turned.turn_std_rad) < 0.2


@pytest.mark.parametrize(
    ("tilted", "tilt"),
    [
        (Tilted.BOW_UP, (0.0, 5.0)),
        (Tilted.BOW_DOWN, (0.0, -5.0)),
        (Tilted.PORT_UP, (5.0, 0.0)),
        (Tilted.PORT_DOWN, (-5.0, 0.0)),
    ],
)
@pytest.mark.parametrize("seed", range(5))
def test_a_rest_in_harbour_takes_twenty_seconds(tilted: Tilted, tilt: tuple[float, float], seed: int) -> None:
    mount = any_mount(seed)
    record = read(mount, sea="S0", seconds=20.0)
    assert is_still(record)
    first, second = rest_of(record), rest_of(read(mount, sea="S0", seconds=20.0, tilt=tilt))
    found = by_two(first.up, second.up, max(first.up_std_rad, second.up_std_rad), tilted)
    assert off_deg(found.rotation_deg, mount) < 0.2
    assert degrees(found.apart_rad) == pytest.approx(5.0, abs=0.02)


@pytest.mark.parametrize("lies", [(2.0, -1.5), (-1.0, 3.0)])
@pytest.mark.parametrize("tilted", [Tilted.BOW_UP, Tilted.PORT_UP])
def test_list_and_trim_at_rest_are_taken_into_account(lies: tuple[float, float], tilted: Tilted) -> None:
    roll, pitch = lies
    mount = (20.0, -30.0, 100.0)
    first = rest_of(read(mount, sea="S0", seconds=20.0, tilt=lies))
    lifted = (roll, pitch + 6.0) if tilted is Tilted.BOW_UP else (roll + 6.0, pitch)
    second = rest_of(read(mount, sea="S0", seconds=20.0, tilt=lifted))
    rest = by_rest(first.up, first.up_std_rad, z_deg=100.0, roll_rad=radians(roll), pitch_rad=radians(pitch))
    assert off_deg(rest.rotation_deg, mount) < 0.02
    assert tilt_off_deg(rest.rotation_deg, mount) < 0.02
    found = by_two(
        first.up, second.up, first.up_std_rad, tilted, roll_rad=radians(roll), pitch_rad=radians(pitch)
    )  # fmt: skip
    assert off_deg(found.rotation_deg, mount) < 0.05


@pytest.mark.parametrize("mount", [(0.0, -90.0, 0.0), (0.0, 90.0, 33.0), (180.0, 0.0, 0.0), (-90.0, 0.0, 10.0)])
def test_bulkheads_and_ceilings_are_orientations_like_others(mount: Angles) -> None:
    records = [read(mount, sea="S0", seconds=20.0, tilt=tilt) for tilt in ((0.0, 0.0), (8.0, 0.0))]
    first, second = (rest_of(record) for record in records)
    assert off_deg(by_two(first.up, second.up, first.up_std_rad, Tilted.PORT_UP).rotation_deg, mount) < 0.1


def test_the_bias_is_that_of_the_sensor_in_its_own_axes() -> None:
    mount = any_mount(7)
    found = rest_of(read(mount, model="A", seed=3))
    in_vessel = vessel_from_sensor(mount).apply(found.bias_mps2)
    # 0.03 m/s2 along each axis, of either sign; its walk makes 0.0003 of five minutes.
    assert np.abs(in_vessel) == pytest.approx([0.03, 0.03, 0.03], abs=0.002)
    assert found.bias_std_mps2 < 0.001
    assert not found.levels_itself


def test_without_angles_only_the_bias_along_the_vertical_shows_and_the_rest_tilts() -> None:
    mount = (10.0, 5.0, 0.0)
    found = rest_of(without_angles(read(mount, sea="S0", seconds=20.0)))
    assert not found.has_attitude
    tilted = tilt_off_deg(by_rest(found.up, found.up_std_rad, z_deg=0.0).rotation_deg, mount)
    assert tilted == pytest.approx(degrees(0.03 * sqrt(2.0) / GRAVITY_MPS2), abs=0.02)
    along = float(np.dot(found.bias_mps2, found.up))
    assert abs(along) == pytest.approx(0.03, abs=0.002)
    assert np.linalg.norm(found.bias_mps2) == pytest.approx(abs(along), rel=1e-6)


def test_angles_that_come_from_the_accelerometers_are_known_as_such() -> None:
    made = read((30.0, 0.0, 0.0), sea="S0", seconds=20.0)
    fx, fy, fz = made.force_mps2.mean(axis=0)
    angles = np.tile((np.arctan2(fy, fz), np.arctan2(fx, np.hypot(fy, fz)), 0.0), (len(made.t_s), 1))
    assert rest_of(msgspec.structs.replace(made, angles_rad=angles)).levels_itself


def test_tilts_that_are_too_alike_are_said_to_be() -> None:
    mount = (3.0, 4.0, 5.0)
    first = rest_of(read(mount, **HARBOUR))  # type: ignore[arg-type]
    second = rest_of(read(mount, **HARBOUR, tilt=(0.0, 1.0)))  # type: ignore[arg-type]
    with pytest.raises(TiltError, match=r"1\.0 degrees apart: too alike"):
        by_two(first.up, second.up, first.up_std_rad, Tilted.BOW_UP)
    third = rest_of(read(mount, **HARBOUR, tilt=(0.0, 3.0)))  # type: ignore[arg-type]
    with pytest.raises(TiltError, match="lift it further"):
        by_two(first.up, third.up, radians(0.1), Tilted.BOW_UP)


def test_records_of_no_rest_are_refused_with_the_reason() -> None:
    rough = read((0.0, 0.0, 0.0), sea="S6S", seconds=60.0)
    with pytest.raises(RestError, match="make a longer record, 300 s or more"):
        rest_of(rough)
    with pytest.raises(RestError, match="it moves: "):
        rest_of(msgspec.structs.replace(rough, angles_rad=2.5 * rough.angles_rad))
    still = read((0.0, 0.0, 0.0), **HARBOUR)  # type: ignore[arg-type]
    with pytest.raises(RestError, match="unit or scale"):
        rest_of(msgspec.structs.replace(still, force_mps2=still.force_mps2 / GRAVITY_MPS2))
    with pytest.raises(RestError, match="not all there"):
        rest_of(msgspec.structs.replace(still, force_mps2=still.force_mps2 * (1.0, np.nan, 1.0)))
    with pytest.raises(RestError, match="only 10 samples"):
        rest_of(cut(still, np.arange(len(still.t_s)) < 10))
    listing = still.angles_rad + np.column_stack(
        (np.radians(0.05) * (still.t_s - still.t_s[0]), *np.zeros((2, len(still.t_s))))
    )
    with pytest.raises(RestError, match="wait until loading"):
        rest_of(msgspec.structs.replace(still, angles_rad=listing))


def test_a_sea_is_no_harbour() -> None:
    assert not is_still(read((0.0, 0.0, 0.0), seconds=20.0))


def test_a_recording_in_the_axes_of_the_vessel_is_turned_back() -> None:
    mount, bias = (15.0, -40.0, 120.0), (0.1, -0.2, 0.05)
    own = read(mount, seconds=20.0)
    vessel = in_vessel_axes(own, mount, bias)
    matrix = vessel_from_sensor(mount).as_matrix()
    assert vessel.force_mps2 == pytest.approx((own.force_mps2 - bias) @ matrix.T)
    (first, second, third) = ((row[0], row[1], row[2]) for row in matrix.tolist())
    back = turned_back(vessel, (first, second, third), bias)
    assert back.force_mps2 == pytest.approx(own.force_mps2)
    assert back.rates_radps == pytest.approx(own.rates_radps)
    assert np.cos(back.angles_rad - own.angles_rad) == pytest.approx(1.0)


def test_how_far_two_mountings_are_apart() -> None:
    for seed in range(5):
        one, other = any_mount(seed), any_mount(seed + 10)
        assert degrees(apart_rad(one, other)) == pytest.approx(off_deg(one, other), abs=1e-5)
