"""Quiescence at a monitoring point: what the motion, the rock predictions and the heave forecasts say of it."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, isfinite, nan
from typing import Final, Self

import numpy as np

from heaved.estimation import lever_arm as points
from heaved.estimation.lever_arm import Attitude, Point
from heaved.estimation.quiescence import MotionForecast, Params, Quiescence
from heaved.samples import HeaveForecast, ImuSample, MotionFrame, QuietForecast, RockPrediction

OLD_S: Final = 3.0
"""Without samples for this long nothing is foreseen any more."""


class QuietWindows:
    """Feed it every sample's motion; what is foreseen is renewed once a second."""

    def __init__(self, params: Params, point: Point | None) -> None:
        """``point``: where; None: at the IMU."""
        self._quiescence = Quiescence(params)
        self._point = point
        self._latest = QuietForecast(t_s=nan)

    @classmethod
    def of(cls, params: Params | None, points: Sequence[Point]) -> Self | None:
        """At the point that is named, or at the IMU; None: nobody asks for it."""
        if params is None or not params.enabled:
            return None
        return cls(params, next((point for point in points if point.name == params.point), None))

    def step(self, sample: ImuSample, frame: MotionFrame) -> None:
        """Take the motion of the IMU as it was measured, and the frame of that moment with what is predicted."""
        t_s, roll_rad, pitch_rad = sample.t_s, sample.roll_rad, sample.pitch_rad
        heave_m, rock, forecast = frame.heave_m, frame.rock, frame.forecast
        quiescence = self._quiescence
        is_due = quiescence.is_due(t_s)
        ahead = self._ahead(rock, forecast) if is_due else None
        window = quiescence.step(t_s, roll_rad, pitch_rad, self._heave(heave_m, roll_rad, pitch_rad), ahead)
        if is_due:
            known = quiescence.probabilities[np.isfinite(quiescence.probabilities)]
            self._latest = QuietForecast(t_s=t_s, window=window, best=float(known.max()) if len(known) else nan)

    def at(self, t_s: float) -> QuietForecast:
        """The newest forecast, while it is not too old."""
        return self._latest if t_s - self._latest.t_s <= OLD_S else QuietForecast(t_s=t_s)

    def _heave(self, heave_m: float, roll_rad: float, pitch_rad: float) -> float:
        if self._point is None:
            return heave_m
        return points.motion(self._point, heave_m, 0.0, Attitude(roll_rad, pitch_rad, 0.0, 0.0)).heave_m

    def _ahead(self, rock: Sequence[RockPrediction], forecast: Sequence[HeaveForecast]) -> MotionForecast:
        """For the horizons of both; heave at the point, errors of heave and attitude taken as independent."""
        heaves = {f"{f.horizon_s:g}": f for f in forecast}
        x, y = (self._point.forward_m, self._point.port_m) if self._point is not None else (0.0, 0.0)
        horizons, mean, std = [], [], []
        for r in rock:
            f = heaves.get(f"{r.horizon_s:g}")
            if f is None or not isfinite(r.roll_std_rad + r.pitch_std_rad):
                continue
            horizons.append(r.horizon_s)
            mean.append((r.roll_rad, r.pitch_rad, self._heave(f.heave_m, r.roll_rad, r.pitch_rad)))
            by_lever_m = hypot(y * r.roll_std_rad, x * r.pitch_std_rad)
            std.append((r.roll_std_rad, r.pitch_std_rad, hypot(f.std_m, by_lever_m)))
        return MotionForecast(np.array(horizons), np.array(mean).reshape(-1, 3), np.array(std).reshape(-1, 3))
