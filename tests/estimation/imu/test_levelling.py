import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from heaved.estimation.imu.levelling import up_acceleration
from heaved.samples import GRAVITY_MPS2


def body_force(level: np.ndarray, roll: float, pitch: float) -> np.ndarray:
    """Oracle: scipy's rotations. Right-handed about x (port up) and, bow up being positive, minus about y (port)."""
    level_from_body = Rotation.from_euler("ZYX", [0.3, -pitch, roll])
    return level_from_body.inv().apply(Rotation.from_euler("Z", 0.3).apply(level))


@pytest.mark.parametrize("roll", [-1.2, -0.05, 0.0, 0.4, 3.0])
@pytest.mark.parametrize("pitch", [-1.5, -0.1, 0.0, 0.02, 1.1])
def test_vanishes_at_rest_for_any_attitude(roll: float, pitch: float) -> None:
    f = body_force(np.array([0.0, 0.0, GRAVITY_MPS2]), roll, pitch)
    assert up_acceleration(f[0], f[1], f[2], roll, pitch) == pytest.approx(0.0, abs=1e-12)


def test_gives_the_vertical_part_of_any_motion() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        level = rng.normal(0.0, 3.0, 3)
        roll, pitch = rng.uniform(-1.0, 1.0, 2)
        f = body_force(level + np.array([0.0, 0.0, GRAVITY_MPS2]), roll, pitch)
        assert up_acceleration(f[0], f[1], f[2], roll, pitch) == pytest.approx(level[2], abs=1e-12)


def test_signs_at_small_angles() -> None:
    # Bow up: gravity's reaction has a part along +x (forward). Port up: along +y (port).
    assert body_force(np.array([0.0, 0.0, 9.8]), 0.0, 0.1)[0] > 0.9
    assert body_force(np.array([0.0, 0.0, 9.8]), 0.1, 0.0)[1] > 0.9
