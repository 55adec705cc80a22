"""Ring buffer and history against collections.deque and numpy.interp."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heaved.estimation.common.ring import History, RingBuffer

steps = st.lists(st.tuples(st.floats(1e-3, 10.0), st.floats(-1e6, 1e6)) | st.none(), max_size=60)  # None: clear


@given(capacity=st.integers(1, 9), events=steps, data=st.data())
def test_it_behaves_as_a_deque(capacity: int, events: list[tuple[float, float] | None], data: st.DataObject) -> None:
    ring, oracle, t = RingBuffer(capacity, 2), deque[tuple[float, float]](maxlen=capacity), 0.0
    for event in events:
        if event is None:
            ring.clear()
            oracle.clear()
            continue
        t += event[0]
        ring.push((t, event[1]))
        oracle.append((t, event[1]))
        assert len(ring) == len(oracle)
        n = data.draw(st.integers(0, capacity + 2))
        view = ring.last(n)
        assert view.tolist() == [list(row) for row in list(oracle)[max(0, len(oracle) - n) :]]
        assert view.flags.c_contiguous
        assert view.base is not None
        when = data.draw(st.floats(-1.0, t + 1.0) | st.sampled_from([row[0] for row in oracle]))
        assert ring.since(when).tolist() == [list(row) for row in oracle if row[0] >= when]
        times, values = zip(*oracle, strict=True)
        expected = float(np.interp(when, times, values, left=np.nan, right=np.nan))
        assert ring.at(when)[1] == pytest.approx(expected, rel=1e-9, abs=1e-6, nan_ok=True)


def test_an_empty_ring_is_empty() -> None:
    ring = RingBuffer(4, 3)
    assert len(ring) == 0
    assert ring.last(4).shape == ring.since(0.0).shape == (0, 3)
    assert np.isnan(ring.at(0.0)).all()
    assert ring.at(0.0).shape == (3,)


def test_interpolation_takes_the_whole_row_and_the_asked_time() -> None:
    ring = RingBuffer(4, 3)
    ring.push((1.0, 10.0, np.nan))
    ring.push(np.array([2.0, 20.0, -1.0]))
    ring.push([3.0, 40.0, -2.0])
    np.testing.assert_array_equal(ring.at(2.25), [2.25, 25.0, -1.25])
    np.testing.assert_array_equal(ring.at(1.5), [1.5, 15.0, np.nan])
    np.testing.assert_array_equal(ring.at(2.0), [2.0, 20.0, -1.0])
    for outside in (0.999, 3.001, np.nan):
        assert np.isnan(ring.at(outside)).all()


@pytest.mark.parametrize("row", [(1.0, 0.0), (0.5, 0.0), (np.nan, 0.0), (np.inf, 0.0), (2.0,), (2.0, 0.0, 0.0)])
def test_a_bad_row_is_refused_and_leaves_no_trace(row: tuple[float, ...]) -> None:
    ring = RingBuffer(2, 2)
    for t in (0.0, 0.5, 1.0):
        ring.push((t, t))
    with pytest.raises(ValueError, match="ring"):
        ring.push(row)
    assert ring.last(9).tolist() == [[0.5, 0.5], [1.0, 1.0]]
    ring.push((1.5, 1.5))
    assert ring.last(9).tolist() == [[1.0, 1.0], [1.5, 1.5]]


def test_views_are_read_only_and_cost_no_copy() -> None:
    ring = RingBuffer(3, 2)
    ring.push((0.0, 1.0))
    with pytest.raises(ValueError, match="read-only"):
        ring.last(1)[0, 1] = 5.0
    assert np.shares_memory(ring.last(1), ring.since(0.0))


def test_time_may_start_again_after_a_clear() -> None:
    ring = RingBuffer(3, 1)
    ring.push((100.0,))
    ring.clear()
    ring.push((1.0,))
    assert ring.last(3).tolist() == [[1.0]]


@pytest.mark.parametrize(("capacity", "columns"), [(0, 1), (1, 0), (-1, 2)])
def test_an_impossible_ring_is_refused(capacity: int, columns: int) -> None:
    with pytest.raises(ValueError, match="at least 1"):
        RingBuffer(capacity, columns)


def test_values_are_added_to_a_column_where_there_are_any() -> None:
    ring = RingBuffer(4, 2)
    for t in range(6):
        ring.push((float(t), 10.0 * t))
    ring.add(1, np.array([2.5, 4.5]), np.array([1.0, 3.0]))
    np.testing.assert_allclose(ring.last(4), [[2.0, 20.0], [3.0, 31.5], [4.0, 42.5], [5.0, 50.0]])
    ring.push((6.0, 60.0))
    np.testing.assert_allclose(ring.last(4), [[3.0, 31.5], [4.0, 42.5], [5.0, 50.0], [6.0, 60.0]])


def test_between_rows_it_is_linear_and_on_them_exact() -> None:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.01, 0.2, 40))
    a, b = rng.standard_normal((2, 40))
    history = History(100)
    for row in zip(t.tolist(), a.tolist(), b.tolist(), strict=True):
        history.push(row)
        assert history.at(row[0]) == row
    for at in rng.uniform(t[0], t[-1], 50).tolist():
        assert history.at(at) == pytest.approx((at, np.interp(at, t, a), np.interp(at, t, b)))


def test_outside_of_what_is_kept_nothing_is_known() -> None:
    history = History(3)
    assert history.at(0.0) is None
    for k in range(5):
        history.push((float(k), 10.0 * k))
    assert [history.at(t_s) for t_s in (1.9, 2.0, 2.5, 4.0, 4.1)] == [None, (2.0, 20.0), (2.5, 25.0), (4.0, 40.0), None]
