"""Where the tip is, against the same chain of joints by scipy's rotations."""

from __future__ import annotations

from math import degrees, radians
from typing import Literal

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from heaved.estimation.crane.geometry import Params, needed, tip

Array = np.ndarray


def drawn(rng: np.random.Generator) -> Params:
    """A crane of any build."""
    jib_angle: Literal["deck", "boom"] = "deck" if rng.random() < 0.5 else "boom"
    return Params(
        pedestal_m=(rng.uniform(-40, 40), rng.uniform(-40, 40), rng.uniform(-40, 40)),
        heel_outward_m=rng.uniform(-3, 3),
        heel_up_m=rng.uniform(0, 10),
        boom_length_m=rng.uniform(5, 100),
        jib_length_m=rng.uniform(5, 40) if rng.random() < 0.7 else 0.0,
        jib_angle=jib_angle,
        sheave_outward_m=rng.uniform(-1, 1) if rng.random() < 0.7 else 0.0,
        sheave_up_m=rng.uniform(-1, 1),
    )


def by_rotations(params: Params, joints: Array, offset: Array) -> Array:
    """From the head back to the pedestal, each member a vector along its own x axis."""
    slew, boom, jib = joints.tolist()
    jib_on_deck = boom + jib if params.jib_angle == "boom" else jib
    last = jib_on_deck if params.jib_length_m else boom
    # Elevation is a turn about the port axis against the right hand, slew one about the mast likewise.
    members = (
        Rotation.from_euler("y", -boom).apply([params.boom_length_m, 0, 0])
        + Rotation.from_euler("y", -jib_on_deck).apply([params.jib_length_m, 0, 0])
        + Rotation.from_euler("y", -last).apply([params.sheave_outward_m, 0, params.sheave_up_m])
    )
    on_turntable = np.array([params.heel_outward_m, 0, params.heel_up_m]) + members + offset
    found: Array = np.array(params.pedestal_m) + Rotation.from_rotvec([0, 0, -slew]).apply(on_turntable)
    return found


@pytest.mark.parametrize("seed", range(50))
def test_the_tip_is_where_the_chain_of_rotations_ends(seed: int) -> None:
    rng = np.random.default_rng(seed)
    params = drawn(rng)
    joints = rng.uniform((-7, -0.3, -1.5), (7, 1.5, 1.5))
    offset = rng.uniform(-5, 5, 3)
    x, y, z = offset.tolist()
    slew, boom, jib = joints.tolist()
    found = tip(params, slew, boom, jib, (x, y, z))
    np.testing.assert_allclose(np.array(found.at_m), by_rotations(params, joints, offset), atol=1e-9)
    step = 1e-6
    for derivative, way in zip((found.by_slew, found.by_boom, found.by_jib), np.eye(3), strict=True):
        ahead = by_rotations(params, joints + step * way, offset)
        behind = by_rotations(params, joints - step * way, offset)
        # A jib that is not there moves nothing, whatever its encoder says.
        expected = np.zeros(3) if way[2] and not params.jib_length_m else (ahead - behind) / (2 * step)
        np.testing.assert_allclose(np.array(derivative), expected, atol=1e-6)


def test_the_signs_are_those_that_people_use() -> None:
    params = Params(boom_length_m=10.0)
    assert tip(params, 0.0, 0.0, 0.0).at_m == pytest.approx((10.0, 0.0, 0.0))
    assert tip(params, radians(90.0), 0.0, 0.0).at_m == pytest.approx((0.0, -10.0, 0.0)), "clockwise is to starboard"
    assert tip(params, 0.0, radians(90.0), 0.0).at_m == pytest.approx((0.0, 0.0, 10.0))
    assert tip(params, 0.0, 0.0, 0.0, (0.0, 1.0, 0.0)).at_m == pytest.approx((10.0, 1.0, 0.0)), "left is port"
    assert tip(params, radians(180.0), 0.0, 0.0, (0.0, 1.0, 0.0)).at_m == pytest.approx((-10.0, -1.0, 0.0))
    folded = Params(boom_length_m=10.0, jib_length_m=4.0)
    upright = radians(90.0)
    assert tip(folded, 0.0, upright, 0.0).at_m == pytest.approx((4.0, 0.0, 10.0)), "level against the deck"
    against_boom = msgspec.structs.replace(folded, jib_angle="boom")
    assert tip(against_boom, 0.0, upright, 0.0).at_m == pytest.approx((0.0, 0.0, 14.0)), "in line with the boom"


def test_what_has_to_be_read() -> None:
    assert list(needed(Params(boom_length_m=1.0), hook=False)) == [0, 1]
    assert list(needed(Params(boom_length_m=1.0, jib_length_m=1.0), hook=True)) == [0, 1, 2, 3]
    assert list(needed(Params(boom_length_m=1.0, jib_length_m=1.0, slew_fixed_deg=degrees(1.0)), hook=False)) == [1, 2]
