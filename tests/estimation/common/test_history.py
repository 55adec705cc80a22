"""The past that is seldom asked for, against numpy's interpolation."""

import numpy as np
import pytest

from heaved.estimation.common.history import Trail


def test_between_rows_it_is_linear_and_on_them_exact() -> None:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.01, 0.2, 40))
    a, b = rng.standard_normal((2, 40))
    trail = Trail(100)
    for row in zip(t.tolist(), a.tolist(), b.tolist(), strict=True):
        trail.push(row)
        assert trail.at(row[0]) == row
    for at in rng.uniform(t[0], t[-1], 50).tolist():
        assert trail.at(at) == pytest.approx((at, np.interp(at, t, a), np.interp(at, t, b)))


def test_outside_of_what_is_kept_nothing_is_known() -> None:
    trail = Trail(3)
    assert trail.at(0.0) is None
    for k in range(5):
        trail.push((float(k), 10.0 * k))
    assert [trail.at(t_s) for t_s in (1.9, 2.0, 2.5, 4.0, 4.1)] == [None, (2.0, 20.0), (2.5, 25.0), (4.0, 40.0), None]
