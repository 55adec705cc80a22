"""Blocks of numbers as text: the text of "%.6f", whatever the number."""

from __future__ import annotations

from decimal import ROUND_HALF_EVEN, Decimal, localcontext
from math import inf, isfinite, nan

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from heaved.replay.decimals import lines

ANY = st.floats(allow_nan=True, allow_infinity=True)
NEAR = st.floats(min_value=-2000.0, max_value=2000.0)
HALVES = st.integers(-(10**9), 10**9).map(lambda n: (n + 0.5) / 1e6)
"""As near as a double comes to the middle between two texts."""


def exact(value: float) -> str:
    """By decimal arithmetic, in which a double is a fraction like any other: to the nearest, ties to even."""
    with localcontext(prec=400):
        return f"{Decimal(value).quantize(Decimal('0.000001'), ROUND_HALF_EVEN):f}" if isfinite(value) else ""


@given(st.integers(1, 5).flatmap(lambda k: st.lists(st.lists(ANY | NEAR | HALVES, min_size=k, max_size=k), min_size=1)))
def test_each_cell_is_the_number_to_six_decimals(rows: list[list[float]]) -> None:
    assert lines(np.array(rows)) == [",".join([exact(value) for value in row]) for row in rows]


def test_no_rows_are_no_lines() -> None:
    assert lines(np.empty((0, 3))) == []


def test_what_is_left_to_python_comes_in_its_own_row() -> None:
    rows = [[1.0, 2.0], [999.9999994, -999.9999996], [nan, 1000.0], [inf, -0.0], [-1e-9, 0.0000005], [nan, nan]]
    assert lines(np.array(rows)) == [
        "1.000000,2.000000",
        "999.999999,-1000.000000",
        ",1000.000000",
        ",-0.000000",
        "-0.000000,0.000000",
        ",",
    ]


def test_a_block_of_random_numbers_of_all_sizes() -> None:
    rng = np.random.default_rng(2)
    numbers = rng.standard_normal((500, 40)) * 10.0 ** rng.uniform(-9, 6, (500, 40))
    numbers[rng.random(numbers.shape) < 0.1] = nan
    assert lines(numbers) == [",".join([exact(value) for value in row]) for row in numbers.tolist()]
