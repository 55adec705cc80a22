"""What is published of an estimator that runs away again and again. Oracle: the moments at which it did."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import numpy as np
from pipelines import imu_only, pipeline, sea

from heaved.estimation.heave import params as heave
from heaved.estimation.heave.sea.refit import look
from heaved.estimation.motion_frame import BEYOND, TUNING
from heaved.samples import HeaveState


def test_an_estimator_that_runs_away_twice_is_not_believed_for_a_while() -> None:
    """An accelerometer that wanders by 1 m/s2 in 40 s shows a swell of forty metres, and the heave leaves physics, once
    more each time that it has begun anew.
    """
    pipe = pipeline(has_laser=False, heave_params=heave.Params(forecast_horizons_s=()))
    left_s: list[float] = []
    said_s: list[float] = []
    count = 0
    for made in imu_only(sea("S6", 600.0, rate_hz=10.0, laser="off").samples()):
        wander_mps2 = np.sin(2.0 * np.pi * made.t_s / 40.0) if made.t_s > 120.0 else 0.0
        frame = pipe.step(msgspec.structs.replace(made, az_mps2=made.az_mps2 + wander_mps2))
        if (past := pipe.fit_due()) is not None:
            pipe.accept_fit(look(past))
        assert frame is not None
        if (now := pipe.heave.observer.resets[BEYOND] + pipe.resets["frame", BEYOND]) > count:
            count = now
            left_s.append(frame.t_s)
        if np.isfinite(frame.heave_m):
            said_s.append(frame.t_s)
            assert frame.quality.heave is not HeaveState.INVALID
    again_s = [second for first, second in pairwise(left_s) if second - first < TUNING.runs_away_within_s]
    assert again_s, "nothing ran away twice: the test shows nothing"
    for t_s in again_s:
        assert not [one for one in said_s if t_s <= one < t_s + TUNING.not_believed_s]
