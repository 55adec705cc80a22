"""The winch against its closed forms and against the matrix exponential."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm

from heaved.simulate.winch import SetPoint, Winch, WinchParams

FREE = WinchParams(max_speed_mps=1e6, max_acceleration_mps2=1e6, watchdog_s=1e6)


def changed(**changes: float) -> WinchParams:
    return WinchParams(**{name: getattr(FREE, name) for name in FREE.__struct_fields__} | changes)


@pytest.mark.parametrize("dt_s", [0.001, 0.01, 0.037, 1.3])
def test_a_step_of_speed_is_answered_after_the_dead_time_as_a_first_order_lag(dt_s: float) -> None:
    winch = Winch(FREE, t_s=5.0, position_m=2.0)
    winch.command(5.0, SetPoint(1.5))
    for t in np.arange(0.0, 3.0, dt_s):
        state = winch.advance(5.0 + t)
        since = max(0.0, t - 0.15)
        assert state.velocity_mps == pytest.approx(1.5 * (1.0 - np.exp(-since / 0.1)), abs=1e-9)
        assert state.position_m == pytest.approx(2.0 + 1.5 * (since - 0.1 * (1.0 - np.exp(-since / 0.1))), abs=1e-9)


@pytest.mark.parametrize("gain", [0.0, 1.0, 2.5, 30.0], ids=["speed alone", "overdamped", "critical", "ringing"])
@pytest.mark.parametrize("dt_s", [0.004, 0.11])
def test_a_course_of_set_points_is_followed_as_the_linear_system_has_it(gain: float, dt_s: float) -> None:
    """x' = v, lag v' = v_set + gain (x_set - x) - v: one matrix exponential per stretch of constant set-point."""
    rng = np.random.default_rng(4)
    params = changed(position_gain_1ps=gain, lag_s=0.1, dead_time_s=0.15)
    given = [(0.2 * k, SetPoint(*rng.normal(0.0, 1.0, 2))) for k in range(10)]
    winch = Winch(params, t_s=0.0)
    effects = [(0.0, SetPoint(0.0, 0.0)), *((t + 0.15, s) for t, s in given)]
    oracle = np.array([0.0, 0.0, 1.0])
    at, coming = 0.0, list(given)
    for t in np.arange(dt_s, 2.4, dt_s):
        while coming and coming[0][0] < t:
            winch.command(*coming.pop(0))
        state = winch.advance(t)
        edges = [at, *(effect for effect, _ in effects if at < effect < t), t]
        for start, end in pairwise(edges):
            s = [s for effect, s in effects if effect <= start][-1]
            drive = (s.velocity_mps + gain * s.position_m) / 0.1
            A = np.array([[0.0, 1.0, 0.0], [-gain / 0.1, -1.0 / 0.1, drive], [0.0, 0.0, 0.0]])
            oracle = expm(A * (end - start)) @ oracle
        at = t
        assert (state.position_m, state.velocity_mps) == pytest.approx(tuple(oracle[:2]), abs=1e-9)


def test_it_goes_to_the_position_that_is_asked_for() -> None:
    winch = Winch(FREE, t_s=0.0)
    winch.command(0.0, SetPoint(position_m=-3.0))
    assert winch.advance(30.0).position_m == pytest.approx(-3.0, abs=1e-9)


def test_limits_of_acceleration_and_speed() -> None:
    """4 m/s is asked for: 2 m/s2 until what is missing is 2 m/s2 * lag, then the lag; or the speed has its limit."""
    winch = Winch(changed(max_acceleration_mps2=2.0, dead_time_s=0.0), t_s=0.0)
    winch.command(0.0, SetPoint(4.0))
    assert winch.advance(1.5).velocity_mps == pytest.approx(3.0, abs=1e-6)
    assert winch.advance(1.5).position_m == pytest.approx(2.25, abs=1e-6)
    # From 3.8 m/s at 1.9 s on, to within a step of the limited stretch.
    assert winch.advance(2.0).velocity_mps == pytest.approx(4.0 - 0.2 * np.exp(-1.0), abs=0.003)
    slow = Winch(changed(max_speed_mps=2.5), t_s=0.0)
    slow.command(0.0, SetPoint(4.0))
    states = [slow.advance(t) for t in np.arange(0.0, 3.0, 0.01)]
    assert max(state.velocity_mps for state in states) <= 2.5
    assert states[-1].velocity_mps == pytest.approx(2.5, abs=1e-6)
    assert max(state.acceleration_mps2 for state in states) <= 25.0 + 1e-9


def test_a_limited_winch_gets_where_it_is_asked_to_and_stays() -> None:
    winch = Winch(WinchParams(), t_s=0.0)
    for t in np.arange(0.0, 20.0, 0.1):
        winch.command(t, SetPoint(0.0, 8.0))
        state = winch.advance(t)
        assert abs(state.velocity_mps) <= 5.0
        assert abs(state.acceleration_mps2) <= 5.0
    assert state.position_m == pytest.approx(8.0, abs=1e-4)


def test_without_set_points_the_rope_comes_to_rest() -> None:
    """The area under the lagged speed is that of the speed asked for, so it stops speed * watchdog further."""
    winch = Winch(changed(watchdog_s=0.5), t_s=0.0)
    winch.command(0.0, SetPoint(1.0))
    winch.command(0.1, SetPoint(1.0))
    begun = winch.advance(0.25)  # The second one takes effect, and is in force for half a second.
    rest = winch.advance(60.0)
    assert rest.velocity_mps == pytest.approx(0.0, abs=1e-9)
    assert rest.position_m == pytest.approx(begun.position_m + 0.1 * begun.velocity_mps + 0.5, abs=1e-9)


def test_time_that_has_passed_changes_nothing() -> None:
    winch = Winch(FREE, t_s=0.0)
    winch.command(0.0, SetPoint(1.0))
    later = winch.advance(1.0)
    assert winch.advance(0.5) == later


@pytest.mark.parametrize(
    "change",
    [{"lag_s": 0.0}, {"max_speed_mps": -1.0}, {"dead_time_s": -0.1}, {"position_gain_1ps": -1.0}, {"lag_s": np.nan}],
)
def test_what_is_no_winch_is_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="must be above 0"):
        Winch(changed(**change), t_s=0.0)
