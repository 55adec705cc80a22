"""Roll, pitch and yaw a moment ahead, by the predictor that is configured, at any moment near the last sample."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import isfinite, nan, pi
from typing import Final, Protocol

from heaved.estimation.imu.attitude import angle_rates
from heaved.estimation.imu.conditioning import Conditioned
from heaved.estimation.rock import direct as rock_direct
from heaved.estimation.rock import maximum_likelihood as rock
from heaved.estimation.rock.paced import PacedPredictor
from heaved.predictions import TURN, RockPredictions
from heaved.samples import RockPrediction, RockScore

AXES: Final = ("roll", "pitch", "yaw")
Angles = tuple[float, float, float]
"""Roll, pitch and yaw, or their rates; nan: not known."""


class Predictor(Protocol):
    """What a method that predicts roll, pitch and yaw can be asked."""

    def step(self, t_s: float, angles_rad: Angles, rates_radps: Angles) -> Sequence[RockPrediction]:
        """Take one sample and predict from it, one record per horizon, shortest first."""

    def at(self, t_s: float) -> Sequence[RockPrediction]:
        """Predictions as seen from a moment without a sample; nothing is advanced."""

    def scores(self) -> tuple[RockScore, ...]:
        """How the predictions have fared, by axis and horizon; empty: no account is kept."""

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """By (filter, reason), since the predictor was made."""


class RockEstimator:
    """The configured predictor, fed with every sample of the IMU."""

    def __init__(self, params: rock.Params) -> None:
        self.horizons_s = tuple(sorted({*params.horizons_s, *rock.STANDARD_HORIZONS_S}))
        self._predictor: Predictor = (
            LikelihoodRockPredictor(params)
            if params.predictor == "ml"
            else DirectRockPredictor(
                rock_direct.Params(
                    horizons_s=self.horizons_s,
                    memory_s=params.memory_s,
                    **({} if params.max_gap_s is None else {"max_gap_s": params.max_gap_s}),
                )
            )
        )
        self._time_std_s = 0.0
        """How well the times of the angles are known: of a sensor that measures more slowly than it is polled."""
        self._roll_rad = self._pitch_rad = nan

    def step(self, conditioned: Conditioned) -> Sequence[RockPrediction]:
        """Take one sample; predictions for its time, one record per horizon, shortest first.

        They are made from when its angles were measured: earlier, with a slow sensor. A sample between two readings of
        such a one is not a sample with missing angles, but a moment without a sample.
        """
        sample, attitude = conditioned.sample, conditioned.attitude
        self._time_std_s = conditioned.attitude_std_s
        if attitude is None and conditioned.attitude_is_slow:
            return self.at(sample.t_s)
        measured_s = sample.t_s if attitude is None else attitude.t_s
        angles_rad = rock.possible(sample.roll_rad), rock.possible(sample.pitch_rad), sample.yaw_rad
        # Without angles the last ones do: what they add to the rates is small.
        self._roll_rad = angles_rad[0] if isfinite(angles_rad[0]) else self._roll_rad
        self._pitch_rad = angles_rad[1] if isfinite(angles_rad[1]) else self._pitch_rad
        rates_radps = angle_rates(sample, self._roll_rad, self._pitch_rad)
        predictions = self._predictor.step(measured_s, angles_rad, rates_radps)
        return predictions if measured_s == sample.t_s else self.at(sample.t_s)

    def at(self, t_s: float) -> Sequence[RockPrediction]:
        """Predictions as seen from a moment without a sample; nothing is advanced."""
        seen = self._predictor.at(t_s)
        if self._time_std_s > 0.0 and isinstance(seen, RockPredictions):
            return seen.of_uncertain_time(self._time_std_s)
        return seen

    def scores(self) -> tuple[RockScore, ...]:
        """How the predictions have fared, by axis and horizon; empty for a predictor that keeps no account."""
        return self._predictor.scores()

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """By (filter, reason): streams begun anew, steps of the level; spikes that were held back."""
        return self._predictor.resets


class LikelihoodRockPredictor:
    """The maximum-likelihood method; it makes no use of rates, and keeps no account."""

    def __init__(self, params: rock.Params) -> None:
        self._predictor = rock.RockPredictor(params)
        self._t_s = nan
        self._latest = tuple(RockPrediction(horizon_s=h) for h in self._predictor.horizons_s)

    def step(self, t_s: float, angles_rad: Angles, rates_radps: Angles) -> Sequence[RockPrediction]:
        """Take one sample, if any of its angles is known."""
        if not any(map(isfinite, angles_rad)):
            return self.at(t_s)
        self._t_s = t_s
        self._latest = self._predictor.step(t_s, *angles_rad)
        return self._latest

    def at(self, t_s: float) -> Sequence[RockPrediction]:
        """On straight lines through neighbouring horizons."""
        return rock.carried(self._latest, t_s - self._t_s)

    def scores(self) -> tuple[RockScore, ...]:
        """None."""
        return ()

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """Of axes that were begun anew."""
        return Counter({("rock", reason): count for reason, count in self._predictor.begun_anew.items()})


class DirectRockPredictor:
    """Direct regression; whether samples carry body rates shows with the first attitude."""

    def __init__(self, params: rock_direct.Params | None = None) -> None:
        self._params = params if params is not None else rock_direct.Params()
        self.horizons_s = tuple(sorted(set(self._params.horizons_s)))
        self._unknown = RockPredictions.unknown(self.horizons_s)
        self.predictor: PacedPredictor | None = None
        """None until there has been an attitude."""
        self._with_rates = False
        self._yaw_reference_rad = nan
        self._yaw_rad = 0.0
        self._spikes = self._level_steps = 0
        self._begun_anew: Counter[str] = Counter()
        self._resets: Counter[tuple[str, str]] = Counter()

    def step(self, t_s: float, angles_rad: Angles, rates_radps: Angles = (nan, nan, nan)) -> RockPredictions:
        """Take one sample (nan: not known) and predict from it, one record per horizon, shortest first."""
        if self.predictor is None:
            if not any(map(isfinite, angles_rad)):
                return self._unknown
            self._with_rates = isfinite(sum(rates_radps))
            self.predictor = PacedPredictor(3, self._params, rates=self._with_rates, limits=rock.LIMITS)
        roll_rad, pitch_rad, yaw_rad = angles_rad
        values = [roll_rad, pitch_rad, self._unwrapped(yaw_rad)]
        latest = self.predictor.take(t_s, values, rates_radps if self._with_rates else None)
        deviations = self.predictor.deviations(t_s)
        return RockPredictions(self.horizons_s, latest, self._yaw_reference_rad, *deviations, rock.LIMITS)

    def at(self, t_s: float) -> RockPredictions:
        """Predictions as seen from a moment without a sample, with the deviations of horizons that much longer."""
        predictor = self.predictor
        if predictor is None:
            return self._unknown
        deviations = predictor.deviations(max(t_s, predictor.t_s))
        return RockPredictions(self.horizons_s, predictor.at(t_s), self._yaw_reference_rad, *deviations, rock.LIMITS)

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
        if predictor is None:
            return self._resets
        begun_anew = predictor.begun_anew
        if begun_anew != self._begun_anew:
            for reason, count in (begun_anew - self._begun_anew).items():
                self._resets["rock", reason] += count
            if sum(begun_anew.values()) - begun_anew["lost track"] != (
                sum(self._begun_anew.values()) - self._begun_anew["lost track"]
            ):
                self._spikes = self._level_steps = 0  # which are counted from zero then
            self._begun_anew = begun_anew
        for reason, now, before in (
            ("level step", predictor.level_steps, self._level_steps),
            ("spike", predictor.spikes, self._spikes),
        ):
            if now > before:
                self._resets["rock", reason] += now - before
        self._level_steps, self._spikes = predictor.level_steps, predictor.spikes
        return self._resets

    def _unwrapped(self, yaw_rad: float) -> float:
        """Yaw relative to the first reading, without jumps."""
        if not isfinite(yaw_rad):
            return nan
        if self._yaw_reference_rad != self._yaw_reference_rad:
            self._yaw_reference_rad = yaw_rad
        self._yaw_rad += (yaw_rad - self._yaw_reference_rad - self._yaw_rad + pi) % TURN - pi
        return self._yaw_rad
