"""IMUs that nobody has configured so: against rotations, and against what cannot change."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from heaved.samples import GRAVITY_MPS2
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import Recording, record
from heaved.simulate.wrong_physics import RIGHT, Wrong, crooked

if TYPE_CHECKING:
    from heaved.simulate.vessel import Array

TRUE = record(seaway("S6", 3), 20.0, imu_rate_hz=10.0, sensor="ideal", seed=3)


def force(recording: Recording) -> Array:
    return np.array((recording.ax_mps2, recording.ay_mps2, recording.az_mps2))


def test_the_right_physics_is_the_recording_itself() -> None:
    assert crooked(TRUE, RIGHT) is TRUE


def test_an_imu_askew_shows_the_force_turned_and_nothing_else() -> None:
    roll, pitch = math.radians(3.0), math.radians(-2.0)
    made = crooked(TRUE, Wrong(askew_roll_rad=roll, askew_pitch_rad=pitch))
    # As the vessel's own attitude: roll about x, then pitch about y, bow up against the right hand.
    axes = Rotation.from_euler("YX", [-pitch, roll])
    np.testing.assert_allclose(force(made), axes.inv().apply(force(TRUE).T).T, atol=1e-12)
    assert made.roll_rad is TRUE.roll_rad
    assert made.laser_m is TRUE.laser_m


def test_axes_leak_and_bend() -> None:
    x, y, z = force(TRUE)
    leaking = force(crooked(TRUE, Wrong(cross_axis=0.02)))
    np.testing.assert_allclose(leaking, (x + 0.02 * (y + z), y + 0.02 * (x + z), z + 0.02 * (x + y)))
    bent = force(crooked(TRUE, Wrong(bent_per_g=0.01)))
    np.testing.assert_allclose(bent[2], z + 0.01 * z * np.abs(z) / GRAVITY_MPS2)
    np.testing.assert_allclose(bent[1], y + 0.01 * y * np.abs(y) / GRAVITY_MPS2)
