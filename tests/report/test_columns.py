"""Health of columns whose faults were put in by hand."""

from __future__ import annotations

from math import isnan, nan

import numpy as np
import pytest

from heaved.report.columns import Column, ColumnHealth


def health(t_s: np.ndarray, values: np.ndarray, parts: int = 1) -> ColumnHealth:
    column = Column("IMU", "x")
    for part_t, part_x in zip(np.array_split(t_s, parts), np.array_split(values, parts), strict=True):
        column.push(part_t, part_x)
    return column.health()


@pytest.mark.parametrize("parts", [1, 3, 40])
def test_rate_gaps_and_what_stood_still(parts: int) -> None:
    rng = np.random.default_rng(1)
    t_s = 100.0 + 0.05 * np.arange(2000)
    x = rng.standard_normal(2000)
    x[500:540] = nan
    x[1200:1300] = x[1200]
    found = health(t_s, x, parts)
    assert found.values == 1960
    assert found.rate_hz == pytest.approx(20.0)
    assert found.jitter_s == pytest.approx(0.0, abs=1e-9)
    assert found.gaps == 1
    assert found.longest_gap_s == pytest.approx(41 * 0.05)
    assert found.missing_s == pytest.approx(41 * 0.05)
    # From its first showing until another one.
    assert found.unchanged_s == pytest.approx(100 * 0.05)
    known = x[np.isfinite(x)]
    assert (found.least, found.most) == (known.min(), known.max())
    assert [found.mean, found.std] == pytest.approx([known.mean(), known.std()])


def test_a_single_missing_value_is_no_gap_but_jitter() -> None:
    x = np.arange(1000.0)
    x[400] = nan
    found = health(0.05 * np.arange(1000), x, 3)
    assert found.gaps == 0
    intervals = np.append(np.full(997, 0.05), 0.1)
    assert found.rate_hz == pytest.approx(1.0 / intervals.mean())
    assert found.jitter_s == pytest.approx(intervals.std())


def test_jitter_is_the_deviation_of_the_intervals() -> None:
    rng = np.random.default_rng(2)
    steps = 0.01 + 0.001 * rng.uniform(-1.0, 1.0, 5000)
    found = health(np.cumsum(steps), np.arange(5000.0), 7)
    assert found.jitter_s == pytest.approx(0.001 / np.sqrt(3.0), rel=0.05)
    assert found.rate_hz == pytest.approx(1.0 / steps[1:].mean())


def test_a_column_slower_than_the_rows_has_its_own_rate() -> None:
    t_s = 0.01 * np.arange(1000)
    found = health(t_s, np.where(np.arange(1000) % 10 == 0, t_s, nan), 4)
    assert (found.values, found.gaps) == (100, 0)
    assert found.rate_hz == pytest.approx(10.0)


def test_one_value_or_none_says_nothing_of_a_rate() -> None:
    for values in (np.full(5, nan), np.array([nan, 2.0, nan, nan, nan])):
        found = health(np.arange(5.0), values)
        assert isnan(found.rate_hz)
        assert found.unchanged_s == 0.0
