"""What an estimator's trace is worth: figures of traces whose errors were put there by hand."""

from __future__ import annotations

from functools import partial
from math import inf, isnan, sqrt
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pytest
from evidence import scenarios
from evidence.heave import estimators, scores, summary
from evidence.heave.estimators import Ahead, Delayed, Trace
from evidence.heave.figures import draw_record
from evidence.scenarios import Limits, Setting, triplet

from heaved.samples import CorrectionState, DelayedHeave, HeaveState, LaserState, MotionFrame, Quality
from heaved.simulate.seaway import seaway

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

Array = np.ndarray

SETTING = Setting(rate_hz=10.0, duration_s=400.0, scored_from_s=200.0, laser="300+50", tilt="none")


@pytest.fixture
def case() -> scenarios.Case:
    """400 s of S4, the first 200 not scored; limits as they please."""
    limits = Limits(causal_m=0.01, noncausal_m=0.002, forecast_m={1.0: 0.05})
    return msgspec.structs.replace(scenarios.build("S4", triplet(1), SETTING), limits=limits)


def alternating(t: Array, size: float = 1.0) -> Array:
    return np.where(np.arange(t.size) % 2 == 0, size, -size)


def trace(case: scenarios.Case, error: Callable[[Array], Array], **published: Any) -> Trace:
    t = case.recording.t_s
    return Trace(estimator="made up", heave_m=case.recording.truth.heave_m + error(t), **published)


def test_errors_are_taken_where_they_say(case: scenarios.Case) -> None:
    """9 m before 200 s, which does not count; then 0.02 m with laser, 0.06 m in its outage of 50 s; std 0.02 m."""
    t = case.recording.t_s
    outage = (t >= 300.0) & (t < 350.0)
    size = np.where(t < 200.0, 9.0, np.where(outage, 0.06, 0.02))
    std = np.full(t.size, 0.02)
    found = scores.score(trace(case, lambda t: size * alternating(t), std_m=std), case)
    assert found.rms_m == pytest.approx(sqrt(0.75 * 0.02**2 + 0.25 * 0.06**2))
    assert (found.laser_rms_m, found.outage_rms_m) == pytest.approx((0.02, 0.06))
    assert found.coverage == pytest.approx(0.75)
    assert found.published == 1.0
    assert found.ratio_to_limit == pytest.approx(found.rms_m / 0.01)
    assert found.share_of_sigma == pytest.approx(found.rms_m / np.std(case.recording.truth.heave_m[case.scored]))
    assert found.worst_m == pytest.approx(0.06)


def test_a_gain_shows_as_one_and_a_mean_is_not_removed(case: scenarios.Case) -> None:
    truth = case.recording.truth.heave_m
    large = scores.score(trace(case, lambda t: 0.1 * truth), case)
    assert large.gain == pytest.approx(1.1)
    assert large.share_of_sigma == pytest.approx(0.1, rel=0.01)
    off = msgspec.structs.replace(trace(case, lambda t: np.full(t.size, 0.5)), estimator=estimators.INERTIAL)
    as_it_is, level = scores.scores([off], case)
    assert as_it_is.rms_m == pytest.approx(0.5)
    assert level.rms_m == pytest.approx(0.0, abs=1e-12)


def test_silence_is_counted_and_never_covered(case: scenarios.Case) -> None:
    t = case.recording.t_s
    silent = (t >= 300.0) & (t < 320.0)
    error = np.where(silent, np.nan, 0.01 * alternating(t))
    found = scores.score(trace(case, lambda t: error, std_m=np.full(t.size, 0.02)), case)
    assert found.published == found.coverage == pytest.approx(0.9)
    assert found.rms_m == pytest.approx(0.01)


def test_an_estimator_that_says_nothing_has_no_figures(case: scenarios.Case) -> None:
    t = case.recording.t_s
    late = Delayed(*(values[:5] for values in (t, t, t, t)))  # nothing for the time that is scored
    silent = trace(case, lambda t: np.full(t.size, np.nan), std_m=np.full(t.size, np.nan), delayed=late)
    found = scores.score(silent, case)
    assert found.published == found.coverage == 0.0
    assert np.isnan(found.rms_m)
    assert np.isnan(found.ratio_to_limit)
    assert found.delayed is not None
    assert np.isnan(found.delayed_age_s)


def test_quality_is_shared_out_and_coverage_is_told_for_valid(case: scenarios.Case) -> None:
    t = case.recording.t_s
    states = tuple(HeaveState.VALID if 100.0 <= at < 350.0 else HeaveState.DEGRADED for at in t.tolist())
    reasons = tuple(() if at < 350.0 else (f"settling: {at:.0f} s", "laser") for at in t.tolist())
    error = np.where(t < 300.0, 0.01, 0.05)
    given = trace(case, lambda t: error, std_m=np.full(t.size, 0.02), states=states, reasons=reasons)
    found = scores.score(given, case)
    assert found.states == {"valid": pytest.approx(0.75), "degraded": pytest.approx(0.25)}
    assert found.reasons == {"settling: … s": pytest.approx(0.25), "laser": pytest.approx(0.25)}
    assert found.valid_from_s == pytest.approx(100.0)
    assert found.valid_coverage == pytest.approx(100.0 / 150.0)
    assert found.coverage == pytest.approx(0.5)


def test_a_lie_is_a_valid_row_beyond_four_standard_deviations_at_any_time(case: scenarios.Case) -> None:
    t = case.recording.t_s
    states = tuple(HeaveState.VALID if at < 150.0 or at >= 350.0 else HeaveState.DEGRADED for at in t.tolist())
    error = np.select([t < 20.0, t < 100.0, t < 360.0], [0.09, 0.07, 0.09], -0.07)
    given = trace(case, lambda t: error, std_m=np.full(t.size, 0.02), states=states)
    wrong = (t < 20.0) | ((t >= 100.0) & (t < 150.0)) | ((t >= 350.0) & (t < 360.0))
    assert scores.score(given, case).lies == pytest.approx(np.mean(wrong))


def test_a_forecast_is_held_against_what_came(case: scenarios.Case) -> None:
    t, truth = case.recording.t_s, case.recording.truth
    came = np.append(truth.heave_m[10:], np.full(10, np.nan))  # 1 s later
    ahead = Ahead(came + 0.1 * alternating(t), np.where(t < 300.0, 0.06, 0.01))
    found = scores.score(trace(case, np.zeros_like, forecast={1.0: ahead}), case).forecast["1"]
    assert found.rms_m == pytest.approx(0.1)
    assert found.ratio_to_limit == pytest.approx(2.0)
    assert found.coverage == pytest.approx(100.0 / 199.1, rel=0.01)
    held = Ahead(truth.heave_m, np.ones(t.size))
    held_error = scores.score(trace(case, np.zeros_like, forecast={1.0: held}), case).forecast["1"].rms_m
    assert held_error == pytest.approx(np.std(truth.heave_m[2000:3990] - truth.heave_m[2010:4000]), rel=0.01)


def test_delayed_heave_is_held_against_the_truth_of_its_own_time(case: scenarios.Case) -> None:
    """Between the samples too: against the sea in closed form."""
    sea = seaway("S4", 1, attitude=False, start_s=float(np.random.default_rng(2001).uniform(0.0, 3600.0)))
    at = np.arange(100.03, 395.0, 0.7)
    error = np.where(at < 200.0, 9.0, 0.004)
    delayed = Delayed(at, sea.motion(at).heave_m + error, np.full(at.size, 0.003), np.full(at.size, 90.0))
    found = scores.score(trace(case, np.zeros_like, delayed=delayed), case)
    assert found.delayed is not None
    assert found.delayed.rms_m == pytest.approx(0.004, rel=0.02)
    assert found.delayed.ratio_to_limit == pytest.approx(2.0, rel=0.02)
    assert found.delayed.coverage == 1.0
    assert found.delayed_age_s == pytest.approx(90.0)


def test_frames_that_repeat_a_delayed_heave_count_once() -> None:
    given = ((1.0, None), (2.0, SMOOTH), (3.0, SMOOTH), (4.0, LATER))
    frames = [MotionFrame(t_s=t_s, quality=QUALITY, delayed=delayed) for t_s, delayed in given]
    found = estimators._delayed(frames)
    assert found is not None
    assert found.t_s.tolist() == [0.5, 3.0]
    assert found.age_s.tolist() == [1.5, 1.0]
    assert estimators._delayed(frames[:1]) is None


QUALITY = Quality(heave=HeaveState.VALID, laser=LaserState.OFF, correction=CorrectionState.OFF)
SMOOTH, LATER = (DelayedHeave(t_s=t_s, heave_m=heave_m, std_m=0.01) for t_s, heave_m in ((0.5, 0.1), (3.0, 0.2)))


def test_settling_is_from_where_it_stays(case: scenarios.Case) -> None:
    t = case.recording.t_s
    sigma = case.local_sigma_m[0]
    error = np.select(
        [t < 15.0, t < 60.0, t < 75.0], [np.full(t.size, np.nan), 0.3 * sigma, 0.02 * sigma], 0.01 * sigma
    )
    error[(t >= 70.0) & (t < 75.0)] = 0.07 * sigma  # once more above
    found = scores.score(trace(case, lambda t: error), case).settling
    assert len(found) == 60
    assert found[:3] == (inf, inf, inf)
    assert found[5] == pytest.approx(0.3)
    assert scores.settled_from_s(found) == 75.0
    assert scores.settled_from_s([0.01] * 4) == 0.0
    assert scores.settled_from_s([0.01, 0.01, 0.2]) == inf
    assert isnan(scores.settled_from_s([]))


def test_a_changing_sea_is_scored_against_its_local_size() -> None:
    """3 % of the local deviation all the time, but 10 % during the minute of growth."""
    case = scenarios.build("SX", triplet(1), Setting(rate_hz=5.0, tilt="none"))
    t = case.recording.t_s
    share = np.where((t >= 600.0) & (t < 660.0), 0.10, 0.03)
    found = scores.score(trace(case, lambda t: share * case.local_sigma_m * alternating(t)), case)
    assert found.segments.pop("growing") == pytest.approx(0.10)
    assert found.segments == dict.fromkeys(found.segments, pytest.approx(0.03))
    assert len(found.segments) == 7


def test_a_changing_sea_is_drawn(tmp_path: Path) -> None:
    case = scenarios.build("SX", triplet(1), Setting(rate_hz=2.0, tilt="none"))
    t = case.recording.t_s
    error = np.where(t < 40.0, np.nan, 0.01 * alternating(t))
    given = trace(case, lambda t: error, std_m=np.where(t < 40.0, np.nan, 0.01))
    draw_record(tmp_path, case, [given])
    assert {path.name.split("_")[0] for path in tmp_path.glob("*.png")} == {"heave", "change"}
    assert all(path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" for path in tmp_path.glob("*.png"))


def test_records_are_summed_up_by_mean_and_worst(case: scenarios.Case) -> None:
    records = []
    for number, error in enumerate((0.01, 0.03), start=1):
        given = trace(case, partial(alternating, size=error), std_m=np.full(case.recording.t_s.size, 0.012))
        records.append(
            msgspec.structs.replace(summary.judged([given], case), seeds=triplet(number), sigma_m=0.2 * number)
        )
    (result,) = summary.summary(records)
    assert result.rms_m == pytest.approx(0.02)
    assert result.worst_rms_m == pytest.approx(0.03)
    assert result.ratio_to_limit == pytest.approx(2.0)
    assert result.worst_ratio_to_limit == pytest.approx(3.0)
    assert (result.coverage, result.worst_coverage) == pytest.approx((0.5, 0.0))
    assert result.sigma_m == pytest.approx(0.3)
    assert result.settling[7] == pytest.approx(sqrt((0.01**2 + 0.03**2) / 2.0) / case.local_sigma_m[0])
    assert [seeds.noise for seeds in result.seeds] == [1001, 1002]
