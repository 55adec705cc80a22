"""What a wrong IMU puts into the vertical acceleration: the columns against matrices applied to the true force."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heaved.estimation.imu.attitude import up_acceleration
from heaved.estimation.imu.leaks import Leak, leaks_mps2
from heaved.samples import GRAVITY_MPS2

tilts = st.floats(-0.6, 0.6)
parts = st.floats(-3.0, 3.0)
SMALL = 1e-6


@given(roll=tilts, pitch=tilts, fx=parts, fy=parts, more=parts, which=st.sampled_from(Leak))
def test_a_column_is_what_its_fault_adds(
    roll: float, pitch: float, fx: float, fy: float, more: float, which: Leak
) -> None:
    force = np.array((fx, fy, GRAVITY_MPS2 + more))
    places = {
        Leak.FORWARD_UPRIGHT: [(2, 0)],
        Leak.PORT_UPRIGHT: [(2, 1)],
        Leak.UPRIGHT_FORWARD: [(0, 2)],
        Leak.UPRIGHT_PORT: [(1, 2)],
        Leak.ACROSS: [(0, 1), (1, 0)],
    }
    shown = force.copy()
    for to, of in places.get(which, []):
        shown[to] += SMALL * force[of]
    if which is Leak.BEND:
        shown = force * (1.0 + SMALL * np.abs(force) / GRAVITY_MPS2)
    right, wrong = (up_acceleration(x, y, z, roll, pitch) for x, y, z in (force.tolist(), shown.tolist()))
    added = (wrong - right) / SMALL
    if which is Leak.BEND:  # A scale of 2 and a level of g are learned elsewhere.
        added -= GRAVITY_MPS2 + 2.0 * right
    assert leaks_mps2(fx, fy, GRAVITY_MPS2 + more, roll, pitch)[which] == pytest.approx(added, abs=1e-4)


def test_a_triad_that_is_turned_shows_no_gravity_in_the_waves() -> None:
    # Two columns of one sign each are a rotation: of a vessel that only tilts it leaves nothing in the first order.
    roll, pitch = math.radians(5.0), math.radians(3.0)
    force = (
        GRAVITY_MPS2 * math.sin(pitch),
        GRAVITY_MPS2 * math.sin(roll) * math.cos(pitch),
        GRAVITY_MPS2 * math.cos(roll) * math.cos(pitch),
    )
    leaks = leaks_mps2(*force, roll, pitch)
    assert leaks[0] - leaks[2] == pytest.approx(0.0, abs=1e-12)
    assert leaks[1] - leaks[3] == pytest.approx(0.0, abs=1e-12)
    assert leaks[0] + leaks[2] == pytest.approx(2.0 * GRAVITY_MPS2 * math.sin(pitch), rel=0.01)
