"""The vertical acceleration where the attitude comes and goes. Oracle: a vessel at rest that lists."""

from __future__ import annotations

from math import cos, nan, radians, sin

import pytest

from heaved.estimation.imu.conditioning import Conditioner
from heaved.estimation.imu.vertical import Vertical
from heaved.estimation.rock.estimator import RockEstimator
from heaved.estimation.rock.params import Params
from heaved.samples import GRAVITY_MPS2, ImuSample

RATE_HZ = 20.0


@pytest.mark.parametrize("list_deg", [2.0, 2.5])
def test_a_list_is_no_step_of_the_level_where_the_attitude_is_missing(list_deg: float) -> None:
    """Gravity leans by as much as the vessel lists: 6 and 9 mm/s2 less along the mast."""
    conditioner, rock, vertical = Conditioner(), RockEstimator(Params()), Vertical(100.0)
    found = []
    for i in range(round(90.0 * RATE_HZ)):
        t_s = i / RATE_HZ
        # A little motion, or a sensor at rest would be one that hangs.
        roll = radians(list_deg) + radians(0.02) * sin(1.7 * t_s) + 1e-6 * (i * 7 % 13)
        is_there = t_s < 80.0 or t_s > 84.0
        sample = ImuSample(
            t_s=t_s,
            ax_mps2=1e-4 * (i * 5 % 11),
            ay_mps2=GRAVITY_MPS2 * sin(roll),
            az_mps2=GRAVITY_MPS2 * cos(roll) + 1e-5 * (i * 3 % 7),
            roll_rad=roll if is_there else nan,
            pitch_rad=1e-6 * (i * 3 % 5) if is_there else nan,
        )
        readings = conditioner.step(sample)
        up = vertical.step(readings, rock.step(readings), lag_s=0.0, bias_mps2=0.0)
        if up is not None:
            found.append((t_s, up.up_mps2))
    missing = [up_mps2 for t_s, up_mps2 in found if 82.5 < t_s < 84.0]
    assert len(missing) > 20
    assert max(abs(up_mps2) for up_mps2 in missing) < 1e-3
