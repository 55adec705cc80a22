"""From one model to the next: the difference has no edge, and obeys the equation of critical damping."""

from math import inf, nan

import numpy as np
import pytest

from heaved.estimation.heave.sea.bumpless_transfer import LEAST_M, NO_SPLICE, TIME_S, Splice

SINCE_S = 100.0


@pytest.mark.parametrize(("heave_m", "velocity_mps"), [(0.3, 0.0), (0.0, -0.2), (-0.1, 0.4)])
def test_it_begins_as_the_difference_and_dies_down_critically_damped(heave_m: float, velocity_mps: float) -> None:
    splice = Splice(heave_m, velocity_mps, SINCE_S)
    assert splice.at(SINCE_S) == pytest.approx((heave_m, velocity_mps))
    h = 1e-3
    for t_s in np.linspace(SINCE_S + 0.1, SINCE_S + 10.0, 25).tolist():
        before, now, after = (splice.at(t_s + d)[0] for d in (-h, 0.0, h))
        slope, bend = (after - before) / (2.0 * h), (after - 2.0 * now + before) / h**2
        assert splice.at(t_s)[1] == pytest.approx(slope, abs=1e-6)
        assert bend + 2.0 * slope / TIME_S + now / TIME_S**2 == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize(("heave_m", "velocity_mps"), [(1.0, 0.5), (-1e-3, 2e-3), (0.0, -0.3), (1e-3, -1e-3 / TIME_S)])
def test_it_is_over_when_next_to_nothing_is_left(heave_m: float, velocity_mps: float) -> None:
    splice = Splice(heave_m, velocity_mps, SINCE_S)
    assert 0.0 < abs(splice.at(splice.until_s - 1e-6)[0]) < 1.001 * LEAST_M
    assert abs(splice.at(splice.until_s - 1.5 * TIME_S)[0]) > LEAST_M
    assert splice.at(splice.until_s) == (0.0, 0.0)


@pytest.mark.parametrize("difference", [(0.0, 0.0), (0.5 * LEAST_M, 0.0), (nan, 0.0), (0.0, nan), (inf, 0.0)])
def test_a_difference_that_is_nothing_or_not_known_is_none(difference: tuple[float, float]) -> None:
    splice = Splice(*difference, SINCE_S)
    assert splice.until_s == SINCE_S
    assert splice.at(SINCE_S) == (0.0, 0.0)
    assert NO_SPLICE.at(-1e9) == (0.0, 0.0)


def test_later_moments_follow_from_the_state() -> None:
    splice = Splice(0.2, -0.1, SINCE_S)
    for t_s in (SINCE_S, SINCE_S + 0.33, SINCE_S + 9.0):
        linear, slope, elapsed = splice.state(t_s)
        for s in (0.0, 0.15, 1.0, 3.0):
            expected = (linear + slope * s) * np.exp(-(elapsed + s) / TIME_S)
            assert splice.at(t_s + s)[0] == pytest.approx(expected, rel=1e-12)
