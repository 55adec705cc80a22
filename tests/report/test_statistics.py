"""Statistics in blocks against those of the whole arrays, and claims of known worth against the normal distribution."""

from __future__ import annotations

from math import erf, isnan, nan, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heaved.replay.table import MAX_STEP_S, DelayedColumn
from heaved.report.statistics import HISTOGRAM_EDGES, LEVELS, Envelope, Errors, Moments, between
from heaved.samples import DelayedHeave

values = st.floats(-1e3, 1e3, width=32) | st.just(nan)
series = st.lists(st.tuples(values, st.floats(0.0, 10.0, width=32) | st.just(nan)), max_size=60)
cuts = st.lists(st.integers(0, 60), max_size=5)


def blocks(array: np.ndarray, at: list[int]) -> list[np.ndarray]:
    return np.split(array, sorted(min(cut, len(array)) for cut in at))


@given(series, cuts)
def test_errors_are_those_of_the_whole_array(pairs: list[tuple[float, float]], at: list[int]) -> None:
    table = np.array(pairs, dtype=float).reshape(-1, 2)
    t_s = np.arange(len(table), dtype=float)
    errors = Errors()
    for t, error, std in zip(blocks(t_s, at), blocks(table[:, 0], at), blocks(table[:, 1], at), strict=True):
        errors.push(t, error, std)
    kept = [(t, e, s) for t, (e, s) in zip(t_s.tolist(), pairs, strict=True) if not isnan(e) and s > 0.0]
    found = errors.statistics()
    assert found.count == len(kept)
    if not kept:
        assert isnan(found.rms)
        return
    t, e, s = np.array(kept).T
    assert found.mean == pytest.approx(e.mean(), abs=1e-9)
    assert found.rms == pytest.approx(sqrt(np.mean(e * e)))
    assert found.claimed_rms == pytest.approx(sqrt(np.mean(s * s)))
    assert found.nees == pytest.approx(np.mean((e / s) ** 2))
    assert found.within == pytest.approx([np.mean(np.abs(e / s) <= k) for k in (1, 2, 3)])
    assert abs(found.worst) == np.max(np.abs(e))
    assert np.abs(e[t == found.worst_t_s]).tolist() == [abs(found.worst)]
    assert errors.histogram.sum() == len(kept)


@pytest.mark.parametrize("claimed", [0.5, 1.0, 2.0])
def test_coverage_of_claims_that_are_so_many_times_right(claimed: float) -> None:
    """Normal errors of std 3, claimed to be 3 times ``claimed``: within k of these lie erf(k claimed / sqrt 2)."""
    rng = np.random.default_rng(7)
    n = 200_000
    error = 3.0 * rng.standard_normal(n)
    errors = Errors()
    for part in np.array_split(error, 13):
        errors.push(np.zeros(len(part)), part, np.full(len(part), 3.0 * claimed), np.full(len(part), 5.88 * claimed))
    found = errors.statistics()
    for share, k in zip(found.within, (1.0, 2.0, 3.0), strict=True):
        assert share == pytest.approx(erf(k * claimed / sqrt(2.0)), abs=5.0 * 0.5 / sqrt(n))
    assert found.nees == pytest.approx(1.0 / claimed**2, rel=5.0 * sqrt(2.0 / n))
    assert found.interval == pytest.approx(erf(1.96 * claimed / sqrt(2.0)), abs=5.0 * 0.5 / sqrt(n))
    if claimed == 1.0:
        assert errors.reliability == pytest.approx(np.array(LEVELS), abs=5.0 * 0.5 / sqrt(n))
        middles = 0.5 * (HISTOGRAM_EDGES[1:] + HISTOGRAM_EDGES[:-1])
        density = errors.histogram / n / 0.2
        assert density == pytest.approx(np.exp(-0.5 * middles**2) / sqrt(2.0 * np.pi), abs=0.006)


def test_what_is_beyond_the_histogram_is_in_its_outermost_bins() -> None:
    errors = Errors()
    errors.push(np.zeros(3), np.array([-100.0, 0.1, 7.0]), np.ones(3))
    assert (errors.histogram[0], errors.histogram[-1], errors.histogram.sum()) == (1, 1, 3)


@given(st.lists(values, max_size=60), cuts)
def test_moments_are_those_of_the_whole_array(numbers: list[float], at: list[int]) -> None:
    moments = Moments()
    for part in blocks(np.array(numbers, dtype=float), at):
        moments.push(part)
    kept = np.array([number for number in numbers if not isnan(number)])
    assert moments.count == len(kept)
    if len(kept):
        assert moments.mean == pytest.approx(kept.mean(), abs=1e-9)
        assert moments.std == pytest.approx(kept.std(), abs=1e-9, rel=1e-6)
        assert moments.rms == pytest.approx(sqrt(np.mean(kept**2)), abs=1e-9)
        assert (moments.least, moments.most) == (kept.min(), kept.max())


@given(
    st.lists(st.tuples(st.floats(0.001, 3.0), values), min_size=1, max_size=80),
    cuts,
)
def test_an_envelope_holds_what_is_in_each_of_its_bins(steps: list[tuple[float, float]], at: list[int]) -> None:
    """However often its bins had to be joined: the same as sorting all values into bins of the final width."""
    t_s = 1.7e9 + np.cumsum([step for step, _ in steps])
    x = np.array([value for _, value in steps])
    envelope = Envelope(("x", "twice"), bins=8, width_s=0.25)
    for t, part in zip(blocks(t_s, at), blocks(x, at), strict=True):
        envelope.push(t, part, 2.0 * part)
    drawn = envelope.drawn()
    assert len(drawn.t_s) <= 8
    place = np.floor((t_s - t_s[0]) / drawn.width_s)
    expected = {}
    for i in np.unique(place).tolist():
        inside = x[(place == i) & np.isfinite(x)]
        if len(inside):
            expected[t_s[0] + (i + 0.5) * drawn.width_s] = inside
    assert drawn.t_s.tolist() == pytest.approx(list(expected))
    assert drawn.least["x"].tolist() == [part.min() for part in expected.values()]
    assert drawn.most["twice"].tolist() == [2.0 * part.max() for part in expected.values()]
    assert drawn.mean["x"].tolist() == pytest.approx([part.mean() for part in expected.values()], abs=1e-6)
    assert drawn.count["x"].tolist() == [len(part) for part in expected.values()]
    _, means = drawn.joined("x", 8)
    there = x[np.isfinite(x)]
    assert means.tolist() == ([pytest.approx(there.mean(), abs=1e-6)] if len(there) else [])


def test_between_is_the_delayed_column_of_a_replay() -> None:
    rng = np.random.default_rng(3)
    known_s = np.cumsum(rng.choice([0.05, 0.05, 0.3, 0.7], 200))
    heave = rng.standard_normal(200)
    # Before all, after all, at known times, in holes, in between.
    t_s = np.sort(np.concatenate((known_s[::7], rng.uniform(-1.0, known_s[-1] + 1.0, 500))))
    column = DelayedColumn()
    for at_s, heave_m in zip(known_s.tolist(), heave.tolist(), strict=True):
        column.push(DelayedHeave(t_s=at_s, heave_m=heave_m, std_m=0.01))
    expected = [column.at(at_s) for at_s in t_s.tolist()]
    assert between(t_s, known_s, heave, MAX_STEP_S) == pytest.approx(np.array(expected), nan_ok=True, abs=1e-12)
    assert 50 < np.isnan(expected).sum() < 450


def test_between_nothing_is_nothing() -> None:
    assert np.isnan(between(np.array([1.0, 2.0]), np.empty(0), np.empty(0), 1.0)).all()
    assert between(np.array([1.0, nan]), np.array([1.0]), np.array([5.0]), 1.0) == pytest.approx(
        [5.0, nan], nan_ok=True
    )
