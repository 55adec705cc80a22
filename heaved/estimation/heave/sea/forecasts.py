"""Forecasts of the heave as they follow from the last beat, worked out when they are asked for, and many at a time.

All samples of a beat share the state that its filter had, and with it, for each horizon, the heave as a polynomial in
the time since (:mod:`outlook`) and the standard deviation. What is a sample's own is the time since the beat, and what
is left of the model before (:mod:`splice`). Most samples' forecasts are never looked at, or a block at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, hypot
from typing import Final, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.sea.bumpless_transfer import TIME_S
from heaved.estimation.heave.sea.propagate import ORDER
from heaved.predictions import HeaveForecasts
from heaved.samples import HeaveForecast

Array = NDArray[np.float64]

NOTHING_LEFT: Final = (0.0, 0.0, 0.0)
Own = tuple[float, float, float, float, float, float, float]
"""Time since the beat, s; gain of the heave; factors of the modelled error, and of the whole of it; what is left of the
model before, as :meth:`Splice.state` has it."""


class Ahead(msgspec.Struct, frozen=True, eq=False):
    """What the samples after a beat have in common, for H horizons; never written to."""

    series: Array
    """(H, ORDER) heave and its derivatives over factorials, at the beat and the horizon."""
    stds_m: Array
    """(H,) of the model's error."""


class SeaForecasts(HeaveForecasts):
    """For one moment after a beat."""

    __slots__ = ("_ahead", "_own")

    def __init__(self, horizons_s: tuple[float, ...], ahead: Ahead, own: Own) -> None:
        self.horizons_s, self._ahead, self._own = horizons_s, ahead, own

    @classmethod
    def numbers(cls, forecasts: Sequence[Self]) -> Array:
        own = np.array([one._own for one in forecasts])
        late_s, gain, modelled, whole, left_m, slope_mps, elapsed_s = own.T[:, :, None]
        beats: list[Ahead] = []
        place: list[int] = []
        for one in forecasts:
            if not beats or one._ahead is not beats[-1]:
                beats.append(one._ahead)
            place.append(len(beats) - 1)
        shape = len(beats), len(forecasts[0].horizons_s)
        series = np.concatenate([beat.series for beat in beats]).reshape(*shape, ORDER)
        stds_m = np.concatenate([beat.stds_m for beat in beats]).reshape(shape)
        if len(beats) > 1:
            series, stds_m = series[place], stds_m[place]
        found = np.empty((len(forecasts), shape[1], 2))
        heaves, stds = found[..., 0], found[..., 1]
        heaves[:] = series[..., -1]
        for k in range(ORDER - 2, -1, -1):
            heaves *= late_s
            heaves += series[..., k]
        np.multiply(modelled, stds_m, out=stds)
        if own[:, 4:].any():
            later_s = np.array(forecasts[0].horizons_s)
            left = (left_m + slope_mps * later_s) * np.exp(-(elapsed_s + later_s) / TIME_S)
            heaves += left
            np.hypot(stds, left, out=stds)
        heaves *= gain
        stds *= whole
        return found

    def _made(self) -> tuple[HeaveForecast, ...]:
        """The same of a single one, for which arrays are four times as slow."""
        d, gain, modelled, whole, left_m, slope_mps, elapsed_s = self._own
        is_left = left_m != 0.0 or slope_mps != 0.0
        found = []
        columns = zip(self.horizons_s, self._ahead.series.tolist(), self._ahead.stds_m.tolist(), strict=True)
        for h, (c0, c1, c2, c3, c4, c5), std_m in columns:
            heave_m = ((((c5 * d + c4) * d + c3) * d + c2) * d + c1) * d + c0
            std_m *= modelled
            if is_left:
                left = (left_m + slope_mps * h) * exp(-(elapsed_s + h) / TIME_S)
                heave_m, std_m = heave_m + left, hypot(std_m, left)
            found.append(HeaveForecast(horizon_s=h, heave_m=gain * heave_m, std_m=whole * std_m))
        return tuple(found)
