"""Roll, pitch and yaw a moment ahead, by the predictor that is configured, at any moment near the last sample."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import isfinite, nan, pi
from typing import Final

import msgspec

from heaved.estimation.imu.attitude import angle_rates
from heaved.estimation.rock import direct as rock_direct
from heaved.estimation.rock import maximum_likelihood as rock
from heaved.estimation.rock.paced import PacedPredictor
from heaved.predictions import TURN, RockPredictions
from heaved.samples import ImuSample, RockPrediction, RockScore

AXES: Final = ("roll", "pitch", "yaw")


class DirectRockPredictor:
    """Roll, pitch and yaw by direct regression, with the face of
    :class:`heaved.estimation.rock.maximum_likelihood.RockPredictor`."""

    def __init__(self, params: rock_direct.Params | None = None, *, rates: bool = False) -> None:
        """``rates``: the angles' rates will be given with each sample."""
        self.predictor = PacedPredictor(3, params, rates=rates, limits=rock.LIMITS)
        self.horizons_s = self.predictor.horizons_s
        self._yaw_reference_rad = nan
        self._yaw_rad = 0.0

    def reset(self) -> None:
        """Forget everything."""
        self.predictor.reset()
        self._yaw_reference_rad = nan
        self._yaw_rad = 0.0

    def step(
        self,
        t_s: float,
        roll_rad: float,
        pitch_rad: float,
        yaw_rad: float,
        rates_radps: tuple[float, float, float] | None = None,
    ) -> RockPredictions:
        """Take one sample (nan: not known) and predict from it, one record per horizon, shortest first."""
        latest = self.predictor.take(t_s, [roll_rad, pitch_rad, self._unwrapped(yaw_rad)], rates_radps)
        deviations = self.predictor.deviations(t_s)
        return RockPredictions(self.horizons_s, latest, self._yaw_reference_rad, *deviations, rock.LIMITS)

    def at(self, t_s: float) -> RockPredictions:
        """Predictions as seen from a moment without a sample, with the deviations of horizons that much longer."""
        predictor = self.predictor
        deviations = predictor.deviations(max(t_s, predictor.t_s))
        return RockPredictions(self.horizons_s, predictor.at(t_s), self._yaw_reference_rad, *deviations, rock.LIMITS)

    def _unwrapped(self, yaw_rad: float) -> float:
        """Yaw relative to the first reading, without jumps."""
        if not isfinite(yaw_rad):
            return nan
        if self._yaw_reference_rad != self._yaw_reference_rad:
            self._yaw_reference_rad = yaw_rad
        self._yaw_rad += (yaw_rad - self._yaw_reference_rad - self._yaw_rad + pi) % TURN - pi
        return self._yaw_rad


class RockChain:
    """The configured predictor, fed with samples; whether they carry body rates shows with the first attitude."""

    def __init__(self, params: rock.Params) -> None:
        self._params = params
        self.horizons_s = tuple(sorted({*params.horizons_s, *rock.STANDARD_HORIZONS_S}))
        self._unknown = RockPredictions.unknown(self.horizons_s)
        self.latest: Sequence[RockPrediction] = self._unknown
        """Predictions from the last sample."""
        self.time_std_s = 0.0
        """How well the times of the angles are known: of a sensor that measures more slowly than it is polled."""
        self._t_s = self._roll_rad = self._pitch_rad = nan
        self._ml = rock.RockPredictor(params) if params.predictor == "ml" else None
        self._direct: DirectRockPredictor | None = None
        self._rated = False
        self._spikes = self._level_steps = 0
        self._begun_anew: Counter[str] = Counter()
        self._resets: Counter[tuple[str, str]] = Counter()

    def step(self, sample: ImuSample, *, good: bool) -> Sequence[RockPrediction]:
        """Take one sample, of which nothing is known unless it is ``good``; one record per horizon, shortest first."""
        t_s = sample.t_s
        attitude = nan, nan, nan
        if good:
            attitude = rock.possible(sample.roll_rad), rock.possible(sample.pitch_rad), sample.yaw_rad
        if self._ml is not None:
            if not any(isfinite(angle) for angle in attitude):
                return self.at(t_s)
            self._t_s = t_s
            self.latest = self._ml.step(t_s, *attitude)
            return self.latest
        if self._direct is None:
            if not any(isfinite(angle) for angle in attitude):
                return self.latest
            self._rated = isfinite(sample.gx_radps + sample.gy_radps + sample.gz_radps)
            params = rock_direct.Params(horizons_s=self.horizons_s, memory_s=self._params.memory_s)
            if (gap_s := self._params.max_gap_s) is not None:
                params = msgspec.structs.replace(params, max_gap_s=gap_s)
            self._direct = DirectRockPredictor(params, rates=self._rated)
        rates = None
        if self._rated:
            # Without angles the last ones do: what they add to the rates is small.
            self._roll_rad = attitude[0] if isfinite(attitude[0]) else self._roll_rad
            self._pitch_rad = attitude[1] if isfinite(attitude[1]) else self._pitch_rad
            rates = angle_rates(sample, self._roll_rad, self._pitch_rad) if good else (nan, nan, nan)
        self.latest = self._direct.step(t_s, *attitude, rates)
        return self.latest

    def at(self, t_s: float) -> Sequence[RockPrediction]:
        """Predictions as seen from a moment without a sample; nothing is advanced."""
        if self._ml is not None:
            return rock.carried(tuple(self.latest), t_s - self._t_s)
        if self._direct is None:
            return self._unknown
        seen = self._direct.at(t_s)
        return seen.of_uncertain_time(self.time_std_s) if self.time_std_s > 0.0 else seen

    def scores(self) -> tuple[RockScore, ...]:
        """How the predictions have fared, by axis and horizon; empty for a predictor that keeps no account."""
        if self._direct is None:
            return ()
        error, coverage = (a.tolist() for a in (self._direct.predictor.rms_error, self._direct.predictor.coverage))
        return tuple(
            RockScore(axis=axis, horizon_s=h, error_rad=error[i][c], coverage=coverage[i][c])
            for c, axis in enumerate(AXES)
            for i, h in enumerate(self.horizons_s)
        )

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """By (filter, reason): streams begun anew, steps of the level; spikes that were held back."""
        if self._ml is not None:
            return Counter({("rock", reason): count for reason, count in self._ml.begun_anew.items()})
        if self._direct is None:
            return self._resets
        predictor = self._direct.predictor
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
