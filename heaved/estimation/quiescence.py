"""Quiescence forecast: when, within the next half minute, roll, pitch and heave will all stay small for long enough.

The phase of a sea is lost after a few waves, its grouping is not: envelopes change slowly. What is predicted is
therefore the *largest excursion* (in units of the limits) of a window to come: the regression, one per start of the
window, of its logarithm on those of the largest excursions in past windows that grow with their age, and on what the
motion forecasts say of the window. The probability that it stays below 1 is how often it did after forecasts like this
one (a kernel regression of what came true on what the regression had said), drawn towards what the regression's own
residuals say (a conformal predictive distribution, Vovk et al. 2017) while such forecasts are few. So it is calibrated
whatever the distribution, and falls back to how often the sea is quiet at all where nothing can be foreseen.
"""

from __future__ import annotations

from itertools import pairwise
from math import exp, hypot, inf, isfinite, log, nan, radians
from typing import TYPE_CHECKING, Annotated, Final, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation import lever_arm
from heaved.estimation.lever_arm import AttitudeMotion, Point
from heaved.samples import (
    HeaveForecast,
    ImuSample,
    MotionFrame,
    PointMotion,
    QuietForecast,
    QuietWindow,
    RockPrediction,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]


Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)]


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The table ``[quiet]``: limits at the monitoring point, on the absolute values."""

    enabled: bool = False
    point: str = ""
    """Name of the monitoring point whose heave is meant; empty: the IMU."""
    roll_limit_deg: Positive = 2.0
    pitch_limit_deg: Positive = 1.0
    heave_limit_m: Positive = 0.5
    duration_s: Annotated[float, msgspec.Meta(ge=2.0, le=120.0)] = 10.0
    """How long all three must stay within their limits."""
    look_ahead_s: Annotated[float, msgspec.Meta(ge=2.0, le=120.0)] = 30.0
    """The window begins no later than this."""
    min_confidence: Annotated[float, msgspec.Meta(ge=0.5, lt=1.0)] = 0.8


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Chosen on simulated seas."""

    block_s: float = 1.0
    """Largest excursions are taken, and windows begin, in steps of this."""
    past_edges: tuple[int, ...] = (0, 1, 2, 4, 8, 16, 32, 64)
    """Past windows, in blocks."""
    memory_s: float = 1800.0
    """Of the regressions, and of the residuals."""
    ridge: float = 0.01
    """Per equation, against features of about unit variance."""
    learned_s: float = 180.0
    """Windows that have come true before anything is said."""
    solve_every: int = 5
    """Blocks."""
    alike: float = 0.1
    """Forecasts are alike within about this (in the logarithm: 10 % of the excursion)."""
    prior: float = 10.0
    """Forecasts alike that weigh as much as the residuals; seconds that follow each other are hardly different ones."""
    least: float = 1e-3
    """Excursions below this share of the limit are all alike."""
    old_s: float = 3.0
    """Without samples for this long nothing is foreseen any more."""


TUNING: Final = Tuning()


class MotionForecast(msgspec.Struct, frozen=True):
    """What is foreseen of the motion: horizons (H,) in s; roll, pitch (rad), heave (m) and deviations, (H, 3) each."""

    horizons_s: Array
    mean: Array
    std: Array


class Quiescence:
    """Learns from what passes; takes every sample of the motion at the point."""

    def __init__(self, params: Params | None = None) -> None:
        self._params = p = params if params is not None else Params()
        self._limits = np.array([radians(p.roll_limit_deg), radians(p.pitch_limit_deg), p.heave_limit_m])
        self._duration = max(round(p.duration_s / TUNING.block_s), 1)
        self._starts = np.arange(round(p.look_ahead_s / TUNING.block_s) + 1)
        self._width = len(TUNING.past_edges) + 1
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        starts, width = len(self._starts), self._width
        self._block_end_s = -inf
        self._excursion = 0.0
        self._whole = True
        self._blocks: list[float] = []
        self._features: list[Array] = []
        self._gram = np.zeros((starts, width, width))
        self._right = np.zeros((starts, width))
        self._coefficients = np.zeros((starts, width))
        self._said = np.full((round(TUNING.memory_s / TUNING.block_s), starts), np.nan)
        self._came = np.full((round(TUNING.memory_s / TUNING.block_s), starts), np.nan)
        self._learned = np.zeros(starts, dtype=np.intp)
        self._since_solved = 0
        self.probabilities: Array = np.full(starts, np.nan)
        """Of a quiet window that begins 0, 1, 2 ... s from the last full second on; nan: not known."""
        self._window: QuietWindow | None = None

    def is_due(self, t_s: float) -> bool:
        """Whether a sample of this time ends a second, so that the forecast is looked at."""
        return t_s >= self._block_end_s

    def step(
        self, t_s: float, roll_rad: float, pitch_rad: float, heave_m: float, forecast: MotionForecast | None = None
    ) -> QuietWindow | None:
        """Take one sample at the monitoring point; the next window that is sure enough, renewed every second.

        A sample that is not known (nan) makes its second unknown. ``forecast`` is looked at once a second.
        """
        if not isfinite(t_s):
            return self._window
        if not self._block_end_s - 2 * TUNING.block_s <= t_s < self._block_end_s + 64 * TUNING.block_s:
            self._begin(t_s)
        while t_s >= self._block_end_s:
            self._end_block(forecast)
            self._window = self._announce(t_s)
        values = (abs(roll_rad), abs(pitch_rad), abs(heave_m))
        for value, limit in zip(values, self._limits.tolist(), strict=True):
            if not value < inf:
                self._whole = False
            elif value > self._excursion * limit:
                self._excursion = value / limit
        return self._window

    def _begin(self, t_s: float) -> None:
        """After a gap, or a step of the clock: the past is gone, what was learned from it stays."""
        self._block_end_s = t_s + TUNING.block_s
        self._excursion, self._whole = 0.0, True
        self._blocks.clear()
        self._features.clear()
        self._window = None

    def _end_block(self, forecast: MotionForecast | None) -> None:
        """A second is over: learn from the windows that end with it, then look ahead."""
        seen = self._whole and self._excursion > 0.0
        self._blocks.append(log(max(self._excursion, TUNING.least)) if seen else np.nan)
        self._block_end_s += TUNING.block_s
        self._excursion, self._whole = 0.0, True
        self._learn()
        keep = max(TUNING.past_edges[-1], len(self._starts) + self._duration) + 1
        del self._blocks[:-keep]
        self._features.append(self._look(forecast))
        del self._features[:-keep]
        expected = np.einsum("sp,sp->s", self._features[-1], self._coefficients)
        enough = (self._learned * TUNING.block_s >= TUNING.learned_s) & np.isfinite(expected)
        self.probabilities = np.where(enough, self._probability(expected), np.nan)

    def _probability(self, expected: Array) -> Array:
        """Chance (starts,) that the largest excursion stays below 1, its logarithm being ``expected`` (starts,)."""
        quiet = self._came < 0.0
        known = np.count_nonzero(np.isfinite(self._came), axis=0)
        residual = (np.count_nonzero(self._came - self._said + expected < 0.0, axis=0) + 0.5) / (known + 1.0)
        alike = np.nan_to_num(np.exp(-0.5 * ((self._said - expected) / TUNING.alike) ** 2))
        chance: Array = (np.sum(alike * quiet, axis=0) + TUNING.prior * residual) / (
            np.sum(alike, axis=0) + TUNING.prior
        )
        return chance

    def _look(self, forecast: MotionForecast | None) -> Array:
        """Features of a window for each of its starts, (starts, p): constant, past maxima, the forecast's."""
        past = np.array(self._blocks[::-1])
        features = np.zeros((len(self._starts), self._width))
        features[:, 0] = 1.0
        if len(past) < TUNING.past_edges[-1]:
            features[:] = np.nan
            return features
        features[:, 1:-1] = [past[a:b].max() for a, b in pairwise(TUNING.past_edges)]
        if forecast is not None and len(forecast.horizons_s):
            size = np.max(np.sqrt(forecast.mean**2 + forecast.std**2) / self._limits, axis=1)
            at = forecast.horizons_s / TUNING.block_s
            within = (at >= self._starts[:, None]) & (at <= self._starts[:, None] + self._duration)
            largest = np.max(np.where(within & np.isfinite(size), size, 0.0), axis=1)
            told = largest > 0.0
            features[told, -1] = np.log(np.maximum(largest[told], TUNING.least))
        return features

    def _learn(self) -> None:
        """Start s: the window that ends now was looked at s + duration blocks ago."""
        back = self._starts + self._duration
        usable = back <= len(self._features)
        if not usable.any() or len(self._blocks) < self._duration:
            return
        target = float(np.max(self._blocks[-self._duration :]))
        rows = np.array([self._features[-b][s] for s, b in zip(self._starts[usable], back[usable], strict=True)])
        known = np.isfinite(rows).all(axis=1) & isfinite(target)
        which, rows = self._starts[usable][known], rows[known]
        if not len(which):
            return
        keep = exp(-TUNING.block_s / TUNING.memory_s)
        solved = self._learned[which] > self._width * 2
        for ring in (self._said, self._came):
            ring[:-1] = ring[1:]
            ring[-1] = np.nan
        said = np.einsum("sp,sp->s", rows, self._coefficients[which])
        self._said[-1, which[solved]] = said[solved]
        self._came[-1, which[solved]] = target
        self._gram[which] = keep * self._gram[which] + rows[:, :, None] * rows[:, None, :]
        self._right[which] = keep * self._right[which] + target * rows
        self._learned[which] += 1
        self._since_solved += 1
        if self._since_solved >= TUNING.solve_every:
            self._since_solved = 0
            ridge = TUNING.ridge * np.maximum(self._gram[:, 0, 0], 1.0)[:, None, None] * np.eye(self._width)
            ridge[:, 0, 0] *= 1e-6
            self._coefficients[:] = np.linalg.solve(self._gram + ridge, self._right[:, :, None])[:, :, 0]

    def _announce(self, t_s: float) -> QuietWindow | None:
        sure = np.nan_to_num(self.probabilities) >= self._params.min_confidence
        if not sure.any():
            return None
        first = int(np.argmax(sure))
        run = int(np.argmin(np.append(sure[first:], False)))
        return QuietWindow(
            t_s=t_s,
            start_s=float(first * TUNING.block_s),
            length_s=self._duration * TUNING.block_s + (run - 1) * TUNING.block_s,
            confidence=float(self.probabilities[first]),
        )


class PointQuiescence:
    """Quiescence at a monitoring point, from the motion of the IMU, the rock predictions and the heave forecasts.

    Takes every sample's motion; what is foreseen is renewed once a second.
    """

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
        if self._point is not None and self._point.rides:
            # Where the crane has it: the frame knows.
            found = next((p for p in frame.points if p.name == self._point.name), PointMotion(name=self._point.name))
            there_m, forecast = found.heave_m, found.forecast
        else:
            there_m = self._heave(heave_m, roll_rad, pitch_rad)
        ahead = self._ahead(rock, forecast) if is_due else None
        window = quiescence.step(t_s, roll_rad, pitch_rad, there_m, ahead)
        if is_due:
            known = quiescence.probabilities[np.isfinite(quiescence.probabilities)]
            self._latest = QuietForecast(t_s=t_s, window=window, best=float(known.max()) if len(known) else nan)

    def at(self, t_s: float) -> QuietForecast:
        """The newest forecast, while it is not too old."""
        return self._latest if t_s - self._latest.t_s <= TUNING.old_s else QuietForecast(t_s=t_s)

    def _heave(self, heave_m: float, roll_rad: float, pitch_rad: float) -> float:
        if self._point is None:
            return heave_m
        return lever_arm.motion(self._point, heave_m, 0.0, AttitudeMotion(roll_rad, pitch_rad, 0.0, 0.0)).heave_m

    def _ahead(self, rock: Sequence[RockPrediction], forecast: Sequence[HeaveForecast]) -> MotionForecast:
        """For the horizons of both; heave at the point, errors of heave and attitude taken as independent."""
        heaves = {f"{f.horizon_s:g}": f for f in forecast}
        point = self._point if self._point is None or not self._point.rides else None
        x, y = (point.forward_m, point.port_m) if point is not None else (0.0, 0.0)
        horizons, mean, std = [], [], []
        for r in rock:
            f = heaves.get(f"{r.horizon_s:g}")
            if f is None or not isfinite(r.roll_std_rad + r.pitch_std_rad):
                continue
            horizons.append(r.horizon_s)
            there_m = f.heave_m if point is None else self._heave(f.heave_m, r.roll_rad, r.pitch_rad)
            mean.append((r.roll_rad, r.pitch_rad, there_m))
            by_lever_m = hypot(y * r.roll_std_rad, x * r.pitch_std_rad)
            std.append((r.roll_std_rad, r.pitch_std_rad, hypot(f.std_m, by_lever_m)))
        return MotionForecast(np.array(horizons), np.array(mean).reshape(-1, 3), np.array(std).reshape(-1, 3))
