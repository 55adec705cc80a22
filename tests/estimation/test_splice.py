"""From one model to the next: the difference has no edge, and obeys the equation of critical damping."""

import numpy as np
import pytest

from heaved.estimation.splice import LASTS, NO_SPLICE, TIME_S, Splice, fade

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


def test_it_is_over_when_next_to_nothing_is_left() -> None:
    splice = Splice(1.0, 0.5, SINCE_S)
    assert splice.until_s == SINCE_S + LASTS * TIME_S
    assert 0.0 < splice.at(splice.until_s - 1e-6)[0] < 2e-4
    assert splice.at(splice.until_s) == (0.0, 0.0)
    assert NO_SPLICE.at(-1e9) == (0.0, 0.0)


def test_several_moments_at_once_are_each_of_them() -> None:
    splice = Splice(0.2, -0.1, SINCE_S)
    ahead = (0.0, 0.15, 1.0, 5.0, 30.0)
    for t_s in (SINCE_S, SINCE_S + 0.33, SINCE_S + 14.0):
        expected = [splice.at(t_s + s)[0] for s in ahead]
        assert splice.heaves(t_s, [(s, fade(s)) for s in ahead]) == pytest.approx(expected, rel=1e-12, abs=1e-15)
