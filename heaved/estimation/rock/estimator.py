"""Roll, pitch and yaw a moment ahead, by the predictor that is configured, at any moment near the last sample."""

from __future__ import annotations

from collections import Counter
from math import isfinite, nan, pi
from typing import TYPE_CHECKING, Final, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.imu.attitude import angle_rates
from heaved.estimation.rock import direct
from heaved.estimation.rock.direct import DirectPredictor
from heaved.estimation.rock.limits import LIMITS, USELESS_RAD, possible
from heaved.estimation.rock.maximum_likelihood import MaximumLikelihoodPredictor
from heaved.estimation.rock.params import STANDARD_HORIZONS_S, Params
from heaved.samples import RockPrediction, RockScore

if TYPE_CHECKING:
    from heaved.estimation.imu.conditioning import Conditioned

Array = NDArray[np.float64]

TURN: Final = 2.0 * pi
AXES: Final = ("roll", "pitch", "yaw")
DEVIATIONS: Final = (*(f"{axis}_std_rad" for axis in AXES), *(f"{axis}_interval_rad" for axis in AXES))
Angles = tuple[float, float, float]
"""Roll, pitch and yaw, or their rates; nan: not known."""
Predictions = tuple[RockPrediction, ...]
"""One record per horizon, shortest first."""


class Predictor(Protocol):
    """What a method that predicts roll, pitch and yaw can be asked."""

    def step(self, t_s: float, angles_rad: Angles, rates_radps: Angles) -> Predictions:
        """Take one sample and predict from it."""

    def at(self, t_s: float) -> Predictions:
        """Predictions as seen from a moment without a sample; nothing is advanced."""

    def scores(self) -> tuple[RockScore, ...]:
        """How the predictions have fared, by axis and horizon; empty: no account is kept."""

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """By (filter, reason), since the predictor was made."""


class RockEstimator:
    """The configured predictor, fed with every sample of the IMU."""

    def __init__(self, params: Params) -> None:
        self.horizons_s = tuple(sorted({*params.horizons_s, *STANDARD_HORIZONS_S}))
        self.unknown: Predictions = tuple(RockPrediction(horizon_s=h) for h in self.horizons_s)
        """What is predicted by nobody."""
        self._predictor: Predictor = (
            MaximumLikelihoodPredictor(params)
            if params.predictor == "ml"
            else DirectRockPredictor(
                direct.Params(
                    horizons_s=self.horizons_s,
                    memory_s=params.memory_s,
                    **({} if params.max_gap_s is None else {"max_gap_s": params.max_gap_s}),
                )
            )
        )
        self._time_std_s = 0.0
        """How well the times of the angles are known: of a sensor that measures more slowly than it is polled."""
        self._roll_rad = self._pitch_rad = nan

    def step(self, readings: Conditioned) -> Predictions:
        """Take one sample; predictions for its time.

        They are made from when its angles were measured: earlier, with a slow sensor. A sample between two readings of
        such a one is not a sample with missing angles, but a moment without a sample.
        """
        sample, attitude = readings.sample, readings.attitude
        self._time_std_s = readings.attitude_std_s
        if attitude is None and readings.attitude_is_slow:
            return self.at(sample.t_s)
        measured_s = sample.t_s if attitude is None else attitude.t_s
        angles_rad = possible(sample.roll_rad), possible(sample.pitch_rad), sample.yaw_rad
        # Without angles the last ones do: what they add to the rates is small.
        self._roll_rad = angles_rad[0] if isfinite(angles_rad[0]) else self._roll_rad
        self._pitch_rad = angles_rad[1] if isfinite(angles_rad[1]) else self._pitch_rad
        rates_radps = angle_rates(sample, self._roll_rad, self._pitch_rad)
        predictions = self._predictor.step(measured_s, angles_rad, rates_radps)
        return predictions if measured_s == sample.t_s else self.at(sample.t_s)

    def at(self, t_s: float) -> Predictions:
        """Predictions as seen from a moment without a sample; nothing is advanced."""
        predictions = self._predictor.at(t_s)
        return of_uncertain_time(predictions, self._time_std_s) if self._time_std_s > 0.0 else predictions

    def scores(self) -> tuple[RockScore, ...]:
        """How the predictions have fared, by axis and horizon; empty for a predictor that keeps no account."""
        return self._predictor.scores()

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """By (filter, reason): streams begun anew, steps of the level; spikes that were held back."""
        return self._predictor.resets


class DirectRockPredictor:
    """Direct regression; whether samples carry body rates shows with the first attitude."""

    def __init__(self, params: direct.Params | None = None) -> None:
        self._params = params if params is not None else direct.Params()
        self.horizons_s = tuple(sorted(set(self._params.horizons_s)))
        self._unknown = tuple(RockPrediction(horizon_s=h) for h in self.horizons_s)
        self.predictor: DirectPredictor | None = None
        """None until there has been an attitude."""
        self._with_rates = False
        self._yaw_reference_rad = nan
        self._yaw_rad = 0.0
        self._deviations: tuple[Array, Array, list[list[float]], NDArray[np.bool_] | None] | None = None

    def step(self, t_s: float, angles_rad: Angles, rates_radps: Angles = (nan, nan, nan)) -> Predictions:
        """Take one sample (nan: not known) and predict from it."""
        predictor = self.predictor
        if predictor is None:
            if not any(map(isfinite, angles_rad)):
                return self._unknown
            self._with_rates = isfinite(sum(rates_radps))
            predictor = self.predictor = DirectPredictor(3, self._params, rates=self._with_rates, limits=LIMITS)
        roll_rad, pitch_rad, yaw_rad = angles_rad
        values = [roll_rad, pitch_rad, self._unwrapped(yaw_rad)]
        predicted_rad = predictor.step(t_s, values, rates_radps if self._with_rates else None)
        return self._records(predicted_rad, t_s)

    def at(self, t_s: float) -> Predictions:
        """Predictions as seen from a moment without a sample, with the deviations of horizons that much longer."""
        predictor = self.predictor
        return self._unknown if predictor is None else self._records(predictor.at(t_s), max(t_s, predictor.t_s))

    def _records(self, predicted_rad: Array, t_s: float) -> Predictions:
        """Of the angles (H, 3) predicted from ``t_s``, as far as a ship has them."""
        predictor = self.predictor
        if predictor is None:
            return self._unknown
        std, half_width = predictor.deviations(t_s)
        known = self._deviations
        if known is None or std is not known[0] or half_width is not known[1]:  # they change once a second
            useless = np.logical_or.accumulate(std > USELESS_RAD, axis=0)  # And so is what is further ahead.
            told = [np.where(useless, nan, one) for one in (std, half_width)] if useless.any() else (std, half_width)
            rows = np.concatenate(told, axis=1).tolist()
            known = self._deviations = std, half_width, rows, useless if useless.any() else None
        if known[3] is not None:
            predicted_rad = np.where(known[3], nan, predicted_rad)
        angles_rad = predicted_rad.tolist()
        if not LIMITS.hold(angles_rad, self.horizons_s):
            angles_rad = LIMITS.kept(predicted_rad, self.horizons_s).tolist()
        reference_rad = self._yaw_reference_rad
        return tuple([
            RockPrediction(
                horizon_s=h,
                roll_rad=roll,
                pitch_rad=pitch,
                yaw_rad=heading(yaw + reference_rad),
                roll_std_rad=roll_std,
                pitch_std_rad=pitch_std,
                yaw_std_rad=yaw_std,
                roll_interval_rad=roll_width,
                pitch_interval_rad=pitch_width,
                yaw_interval_rad=yaw_width,
            )
            for h, (roll, pitch, yaw), (roll_std, pitch_std, yaw_std, roll_width, pitch_width, yaw_width) in zip(
                self.horizons_s, angles_rad, known[2], strict=True
            )
        ])  # fmt: skip

    def scores(self) -> tuple[RockScore, ...]:
        """By axis and horizon."""
        if self.predictor is None:
            return ()
        error, coverage = (a.tolist() for a in (self.predictor.rms_error, self.predictor.coverage))
        return tuple(
            RockScore(axis=axis, horizon_s=h, error_rad=error[i][c], coverage=coverage[i][c])
            for c, axis in enumerate(AXES)
            for i, h in enumerate(self.horizons_s)
        )

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """By (filter, reason): streams begun anew, steps of the level; spikes that were held back."""
        predictor = self.predictor
        return Counter() if predictor is None else Counter({("rock", r.value): n for r, n in predictor.resets.items()})

    def _unwrapped(self, yaw_rad: float) -> float:
        """Yaw relative to the first reading, without jumps."""
        if not isfinite(yaw_rad):
            return nan
        if self._yaw_reference_rad != self._yaw_reference_rad:
            self._yaw_reference_rad = yaw_rad
        self._yaw_rad += (yaw_rad - self._yaw_reference_rad - self._yaw_rad + pi) % TURN - pi
        return self._yaw_rad


def heading(yaw_rad: float) -> float:
    """The same, 0 <= yaw < 2 pi."""
    return yaw_rad % TURN % TURN  # x % 2 pi may round up to 2 pi


def of_uncertain_time(predictions: Predictions, std_s: float) -> Predictions:
    """The same where it is known so well only of when they are: they are off by as much of their own rates."""
    angles = np.unwrap([(p.roll_rad, p.pitch_rad, p.yaw_rad) for p in predictions], axis=0)
    off = std_s * np.abs(np.gradient(angles, [p.horizon_s for p in predictions], axis=0))
    stds = np.array([(p.roll_std_rad, p.pitch_std_rad, p.yaw_std_rad) for p in predictions])
    widths = np.array([(p.roll_interval_rad, p.pitch_interval_rad, p.yaw_interval_rad) for p in predictions])
    rows = np.concatenate((np.hypot(stds, off), np.hypot(widths, 2.0 * off)), axis=1).tolist()
    return tuple(
        msgspec.structs.replace(prediction, **dict(zip(DEVIATIONS, row, strict=True)))
        for prediction, row in zip(predictions, rows, strict=True)
    )
