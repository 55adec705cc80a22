"""All records of a scenario together: means of their figures, and the worst; a line of results.jsonl per estimator."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import numpy as np

from evidence.heave.scores import ForecastScore, Score, scores, settled_from_s, sigma_of
from evidence.scenarios import Case, Seeds, Setting, limit_here_m

if TYPE_CHECKING:
    from collections.abc import Sequence

    from evidence.heave.estimators import Trace


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """One estimator on one scenario over its records: means of their figures, and the worst."""

    scenario: str
    setting: Setting
    seeds: tuple[Seeds, ...]
    estimator: str
    published: float
    rms_m: float
    worst_rms_m: float
    sigma_m: float
    """Standard deviation of the true heave while scored."""
    share_of_sigma: float
    share_of_hs: float
    """Of the significant height of the heave, 4 standard deviations."""
    limit_m: float
    limit_lies: float
    """See :attr:`evidence.scenarios.Limits.lies`."""
    ratio_to_limit: float
    worst_ratio_to_limit: float
    limit_here_m: float
    """What the filter that reaches the limit makes of these very records (:func:`evidence.scenarios.limit_here_m`),"""
    ratio_to_limit_here: float
    """and the error over that."""
    gain: float
    optical_gain: float
    laser_rms_m: float
    outage_rms_m: float
    coverage: float
    worst_coverage: float
    valid_coverage: float
    lies: float
    states: dict[str, float]
    reasons: dict[str, float]
    valid_from_s: float
    forecast: dict[str, ForecastScore]
    delayed: ForecastScore | None
    delayed_age_s: float
    settled_s: float
    """RMS over all records in bins of 5 s: from here on it stays within 6 % of the standard deviation; inf: never."""
    worst_settled_s: float
    """Of a single record."""
    settling: tuple[float, ...]
    segments: dict[str, float]


class Judged(msgspec.Struct, frozen=True, kw_only=True):
    """The scores of one record."""

    scenario: str
    seeds: Seeds
    setting: Setting
    sigma_m: float
    limit_m: float
    limit_lies: float
    limit_here_m: float
    scores: tuple[Score, ...]


def judged(traces: Sequence[Trace], case: Case) -> Judged:
    return Judged(
        scenario=case.scenario,
        seeds=case.seeds,
        setting=case.setting,
        sigma_m=sigma_of(case),
        limit_m=case.limits.causal_m,
        limit_lies=case.limits.lies,
        limit_here_m=limit_here_m(case),
        scores=tuple(scores(traces, case)),
    )


def summary(records: Sequence[Judged]) -> list[Result]:
    """Means and worst over the records of one scenario in one setting, a result for each estimator."""
    first = records[0]
    sigma_m = float(np.mean([record.sigma_m for record in records]))
    result = []
    for row in zip(*(record.scores for record in records), strict=True):
        numbers = {
            name: _mean([getattr(one, name) for one in row])
            for name in (
                *(
                    "published",
                    "rms_m",
                    "share_of_sigma",
                    "ratio_to_limit",
                    "gain",
                    "optical_gain",
                    "laser_rms_m",
                    "outage_rms_m",
                ),
                *("coverage", "valid_coverage", "lies", "valid_from_s", "delayed_age_s"),
            )
        }
        delayed = [one.delayed for one in row if one.delayed is not None]
        settling = _pooled([one.settling for one in row])
        result.append(
            Result(
                scenario=first.scenario,
                setting=first.setting,
                seeds=tuple(record.seeds for record in records),
                estimator=row[0].estimator,
                worst_rms_m=max(one.rms_m for one in row),
                sigma_m=sigma_m,
                share_of_hs=numbers["share_of_sigma"] / 4.0,
                limit_m=_mean([record.limit_m for record in records]),
                limit_lies=_mean([record.limit_lies for record in records]),
                worst_ratio_to_limit=max(one.ratio_to_limit for one in row),
                limit_here_m=_mean([record.limit_here_m for record in records]),
                ratio_to_limit_here=_mean(
                    [one.rms_m / record.limit_here_m for one, record in zip(row, records, strict=True)]
                ),
                worst_coverage=min(one.coverage for one in row),
                states=_means([one.states for one in row]),
                reasons=_means([one.reasons for one in row]),
                forecast={key: _mean_score([one.forecast[key] for one in row]) for key in row[0].forecast},
                delayed=_mean_score(delayed) if delayed else None,
                settled_s=settled_from_s(settling),
                worst_settled_s=max(settled_from_s(one.settling) for one in row),
                settling=settling,
                segments=_means([one.segments for one in row]),
                **numbers,
            )
        )
    return result


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def _means(values: Sequence[dict[str, float]]) -> dict[str, float]:
    """Means by key; one that is missing counts as 0."""
    keys = dict.fromkeys(key for one in values for key in one)
    return {key: _mean([one.get(key, 0.0) for one in values]) for key in keys}


def _mean_score(values: Sequence[ForecastScore]) -> ForecastScore:
    return ForecastScore(
        **{name: _mean([getattr(one, name) for one in values]) for name in ForecastScore.__struct_fields__}
    )


def _pooled(settling: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
    """RMS over the records, bin by bin."""
    return tuple(np.sqrt(np.mean(np.square(settling), axis=0)).tolist()) if settling[0] else ()
