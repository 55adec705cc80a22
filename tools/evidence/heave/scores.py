"""What a trace is worth against the truth: error now, ahead and delayed, beside the least that is possible.

Nothing is removed from an error, no mean and no lag: what is published is what is scored. (The row "mean removed" takes
its own mean out, after the fact, as no real-time output could: it shows what the rest of that method does.)
"""

from __future__ import annotations

import re
from math import inf, nan
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from evidence.heave.estimators import INERTIAL, Trace, shares
from heaved.samples import HeaveState
from heaved.simulate.sensors import laser_pattern

if TYPE_CHECKING:
    from collections.abc import Sequence

    from evidence.scenarios import Case

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

COVER: Final = 1.96
"""Standard deviations that hold 95 % of a Gaussian."""
LIE: Final = 4.0
"""An error of more standard deviations than this, published as valid, is a lie."""
SETTLED_SHARE: Final = 0.06
"""Of the standard deviation of the heave: below it an estimator has settled."""
BIN_S: Final = 5.0
SETTLING_END_S: Final = 300.0
"""Settling is looked for until here."""
LEVEL: Final = ", mean removed"


class ForecastScore(msgspec.Struct, frozen=True, kw_only=True):
    """Heave so much ahead, and delayed heave, against the truth of the time it was for."""

    rms_m: float
    share_of_sigma: float
    ratio_to_limit: float
    coverage: float
    """Share of errors within 1.96 published standard deviations."""


class Score(msgspec.Struct, frozen=True, kw_only=True):
    """One estimator on one record."""

    estimator: str
    published: float
    """Share of the scored time with a heave; errors are those of what was published."""
    rms_m: float
    worst_m: float
    share_of_sigma: float
    """Of the standard deviation of true heave while scored; where that changes, of the local one."""
    ratio_to_limit: float
    gain: float
    """Regression of the estimate on the truth: above 1, it is too large."""
    optical_gain: float = nan
    """Standard deviation of the estimate over that of another instrument."""
    laser_rms_m: float
    """While the laser is there."""
    outage_rms_m: float
    """While it is not."""
    coverage: float = nan
    """Share of errors within 1.96 published standard deviations; nan: none is published."""
    valid_coverage: float = nan
    """The same while the quality is ``valid``."""
    lies: float = nan
    """Share of all rows, from the first of the record on, that are valid and off by more than 4 published standard
    deviations."""
    states: dict[str, float] = msgspec.field(default_factory=dict)
    """Share of the scored time by state of quality."""
    reasons: dict[str, float] = msgspec.field(default_factory=dict)
    """Share of the scored time in which each was given; numbers in a reason are left out."""
    valid_from_s: float = nan
    forecast: dict[str, ForecastScore] = msgspec.field(default_factory=dict)
    """By horizon in seconds."""
    delayed: ForecastScore | None = None
    delayed_age_s: float = nan
    settling: tuple[float, ...] = ()
    """RMS error over the standard deviation of the heave in bins of 5 s from the start; inf: nothing published."""
    segments: dict[str, float] = msgspec.field(default_factory=dict)
    """RMS of the error over the local standard deviation, by part of a changing sea."""


def score(trace: Trace, case: Case) -> Score:
    """Judge a trace of ``case.recording``."""
    t, truth = case.recording.t_s, case.recording.truth.heave_m
    sigma_m, error = sigma_of(case), trace.heave_m - truth
    kept = case.scored & np.isfinite(error)
    laser_on = laser_times(case)
    result = Score(
        estimator=trace.estimator,
        published=float(np.mean(np.isfinite(error[case.scored]))),
        rms_m=rms(error[kept]),
        worst_m=float(np.max(np.abs(error[kept]), initial=0.0)),
        share_of_sigma=_share(error[kept], case.local_sigma_m[kept] if case.segments else sigma_m),
        ratio_to_limit=rms(error[kept]) / case.limits.causal_m,
        gain=float(np.sum(trace.heave_m[kept] * truth[kept])) / _positive(float(np.sum(truth[kept] ** 2))),
        optical_gain=(float(np.std(trace.heave_m[kept])) if np.any(kept) else nan) / case.optical_std_m,
        laser_rms_m=rms(error[kept & laser_on]),
        outage_rms_m=rms(error[kept & ~laser_on]),
        settling=_settling(t, error, case),
        segments={
            part.name: _share(error[inside], case.local_sigma_m[inside])
            for part in case.segments
            for inside in [(t >= part.start_s) & (t < part.end_s)]
        },
    )
    return msgspec.structs.replace(result, **_published(trace, case, error))


def scores(traces: Sequence[Trace], case: Case) -> list[Score]:
    """One for each row of the table: the inertial output also without its mean."""
    result = []
    for trace in traces:
        result.append(score(trace, case))
        if trace.estimator == INERTIAL:
            mean = np.nanmean((trace.heave_m - case.recording.truth.heave_m)[case.scored])
            level = Trace(estimator=INERTIAL + LEVEL, heave_m=trace.heave_m - mean)
            result.append(score(level, case))
    return result


def sigma_of(case: Case) -> float:
    """Standard deviation of true heave while scored, m."""
    return float(np.std(case.recording.truth.heave_m[case.scored]))


def laser_times(case: Case) -> Mask:
    """(n,) instants at which the laser sees its target."""
    t, pattern = case.recording.t_s, laser_pattern(case.setting.laser)
    return np.array([pattern.on(at) for at in (t - t[0]).tolist()], dtype=bool)


def covered(error: Array, std: Array) -> float:
    """Share of errors within 1.96 standard deviations; one without any counts as outside. nan: there is none."""
    return float(np.mean(np.abs(error) <= COVER * std)) if error.size else nan


def rms(values: Array) -> float:
    """Of what is there."""
    there = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(there**2))) if there.size else nan


def _share(error: Array, sigma_m: Array | float) -> float:
    return rms(error / sigma_m) if np.all(np.asarray(sigma_m) > 0.0) else nan


def _positive(value: float) -> float:
    return value if value > 0.0 else nan


def _published(trace: Trace, case: Case, error: Array) -> dict[str, object]:
    """What an estimator that says more than a heave has said."""
    kept = case.scored
    fields: dict[str, object] = {}
    if trace.std_m is not None:
        fields["coverage"] = covered(error[kept], trace.std_m[kept])
    if trace.states is not None:
        states = np.array([state.value for state in trace.states])
        valid = states == HeaveState.VALID.value
        fields["states"] = shares(states[kept].tolist())
        fields["valid_from_s"] = float(case.recording.t_s[np.argmax(valid)]) if np.any(valid) else inf
        if trace.std_m is not None:
            fields["valid_coverage"] = covered(error[kept & valid], trace.std_m[kept & valid])
            fields["lies"] = float(np.mean(valid & (np.abs(error) > LIE * trace.std_m)))
    if trace.reasons is not None:
        fields["reasons"] = _reasons([trace.reasons[i] for i in np.flatnonzero(kept)])
    fields["forecast"] = {f"{horizon:g}": _forecast(trace, horizon, case) for horizon in trace.forecast}
    if trace.delayed is not None:
        fields["delayed"], fields["delayed_age_s"] = _delayed(trace, case)
    return fields


def _reasons(given: Sequence[tuple[str, ...]]) -> dict[str, float]:
    texts = [re.sub(r"\d+(\.\d+)?", "…", text) for reasons in given for text in reasons]
    return {text: share * len(texts) / len(given) for text, share in shares(texts).items()}


def _forecast(trace: Trace, horizon_s: float, case: Case) -> ForecastScore:
    t, truth = case.recording.t_s, case.recording.truth.heave_m
    made = case.scored & (t + horizon_s <= min(t[-1], case.end_s))
    ahead = trace.forecast[horizon_s]
    error = ahead.heave_m[made] - np.interp(t[made] + horizon_s, t, truth)
    return _later(error, ahead.std_m[made], case.limits.forecast_m.get(horizon_s, nan), case)


def _delayed(trace: Trace, case: Case) -> tuple[ForecastScore, float]:
    delayed = trace.delayed
    assert delayed is not None
    t, truth = case.recording.t_s, case.recording.truth.heave_m
    kept = (delayed.t_s >= case.start_s) & (delayed.t_s < case.end_s)
    # Times of validity may lie between samples: a straight line between them would cost 1e-4 of the amplitude.
    error = delayed.heave_m[kept] - _between(delayed.t_s[kept], t, truth, case.recording.truth.heave_velocity_mps)
    age_s = float(np.median(delayed.age_s[kept])) if np.any(kept) else nan
    return _later(error, delayed.std_m[kept], case.limits.noncausal_m, case), age_s


def _between(at_s: Array, t_s: Array, value: Array, rate: Array) -> Array:
    """Cubic Hermite interpolation of a quantity whose rate of change is known."""
    return np.asarray(CubicHermiteSpline(t_s, value, rate)(at_s), dtype=np.float64)


def _later(error: Array, std: Array, limit_m: float, case: Case) -> ForecastScore:
    return ForecastScore(
        rms_m=rms(error),
        share_of_sigma=rms(error) / _positive(sigma_of(case)),
        ratio_to_limit=rms(error) / limit_m,
        coverage=covered(error, std),
    )


def _settling(t: Array, error: Array, case: Case) -> tuple[float, ...]:
    """By bin; nothing of a record whose heave does not go on from the start as it is scored."""
    end_s = min(SETTLING_END_S, case.end_s)
    sigma_m = case.local_sigma_m[0]
    if not sigma_m > 0.0 or not case.from_start:
        return ()
    bins = [error[(t >= start) & (t < start + BIN_S)] for start in np.arange(0.0, end_s, BIN_S)]
    return tuple(rms(values) / sigma_m if np.all(np.isfinite(values)) else inf for values in bins)


def settled_from_s(settling: Sequence[float]) -> float:
    """Start of the first bin from which on all stay within the share; inf: none; nan: there are no bins."""
    if not settling:
        return nan
    above = np.flatnonzero(~(np.asarray(settling) <= SETTLED_SHARE))
    first = int(above[-1]) + 1 if above.size else 0
    return first * BIN_S if first < len(settling) else inf
