"""How far the real-time heave was from the delayed one, against a heave that is known at every moment."""

from __future__ import annotations

from math import pi, sin, sqrt

import pytest

from heaved.page.divergence import WINDOW_S, DivergenceMeter

DELAY_S = 60.0
PERIOD_S = 6.0


def truth(t_s: float) -> float:
    return sin(2.0 * pi * t_s / PERIOD_S)


def run(meter: DivergenceMeter, until_s: float, error_m: float, *, rate_hz: float = 20.0) -> None:
    """Frames that are too high by ``error_m``, and the truth of a minute ago with each of them."""
    for step in range(round(until_s * rate_hz)):
        now_s = step / rate_hz
        meter.said(now_s, truth(now_s) + error_m, 0.03)
        if now_s >= DELAY_S:
            meter.delayed(now_s - DELAY_S + 0.013, truth(now_s - DELAY_S + 0.013), 0.04)


def test_a_constant_error_is_its_own_rms() -> None:
    meter = DivergenceMeter()
    run(meter, 200.0, 0.2)
    result = meter.result()
    assert result is not None
    assert result.rms_m == pytest.approx(0.2, abs=1e-3)  # The wave's curvature between two frames is worth that much.
    assert result.expected_m == pytest.approx(sqrt(0.03**2 + 0.04**2), abs=1e-5)
    assert result.span_s == pytest.approx(140.0, abs=0.1)


def test_what_is_older_than_the_window_is_forgotten() -> None:
    meter = DivergenceMeter()
    run(meter, 2.0 * WINDOW_S, 0.1)
    result = meter.result()
    assert result is not None
    assert result.span_s <= WINDOW_S


def test_what_nothing_was_said_of_is_not_compared() -> None:
    meter = DivergenceMeter()
    meter.delayed(1.0, 5.0, 0.1)  # Nothing was said at all.
    meter.said(10.0, 0.0, 0.1)
    meter.delayed(9.0, 5.0, 0.1)  # Before the first.
    meter.said(11.0, 0.0, 0.1)
    meter.delayed(10.5, 5.0, 0.1)  # In a hole of a second.
    meter.delayed(12.0, 5.0, 0.1)  # After the last.
    assert meter.result() is None


def test_times_that_do_not_go_on_are_passed_over() -> None:
    meter = DivergenceMeter()
    for t_s in (1.0, 1.0, 0.5, 1.1):
        meter.said(t_s, t_s, 0.1)
    meter.delayed(1.05, 1.05, 0.1)
    result = meter.result()
    assert result is not None
    assert (result.count, result.rms_m) == (1, 0.0)
