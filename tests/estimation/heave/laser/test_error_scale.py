"""The delayed heave as it is published, against errors whose size is known."""

from __future__ import annotations

from math import pi, sin

import numpy as np
import pytest

from heaved.estimation.heave.laser.error_scale import TUNING, DelayedScale
from heaved.estimation.heave.laser.lead import LeadTracker, Params
from heaved.samples import DelayedHeave

DELAY_S = 60.0
STEP_S = 0.05
MODELLED_M = 0.01
NOISE_M = 0.002


def sea(t_s: float) -> float:
    return sin(2.0 * pi * t_s / 9.0) + 0.3 * sin(2.0 * pi * t_s / 6.1)


def taught(learned_s: float = 0.0, gain: float = 1.0) -> LeadTracker:
    """A tracker that knows them for sure."""
    tracker = LeadTracker(Params())
    tracker.learned_s, tracker.gain = learned_s, gain
    return tracker


def run(
    output: DelayedScale,
    span: tuple[float, float],
    error_m: float,
    *,
    learned_s: float = 0.0,
    gain: float = 1.0,
    laser: bool = True,
) -> list[DelayedHeave]:
    """A delayed heave every 50 ms that is off by a swell of ``error_m`` RMS once the laser's teaching is applied."""
    rng = np.random.default_rng(int(span[0]))
    found = []
    for k in range(round(span[0] / STEP_S), round(span[1] / STEP_S)):
        t_s = STEP_S * k
        if laser and k % 2 == 0:
            output.push(t_s, sea(t_s) + NOISE_M * rng.standard_normal())
        at_s = t_s - DELAY_S
        off_m = 2.0**0.5 * error_m * sin(2.0 * pi * at_s / 23.0)
        heave_m = (sea(at_s + learned_s) + off_m) / gain
        output.step(
            DelayedHeave(t_s=at_s, heave_m=heave_m, std_m=MODELLED_M / TUNING.overconfidence), taught(learned_s, gain)
        )
        assert output.newest is not None
        found.append(output.newest)
    return found


def test_lead_and_scale_of_the_sensor_are_in_it() -> None:
    output = DelayedScale(NOISE_M)
    newest = run(output, (100.0, 110.0), 0.0, learned_s=-0.15, gain=0.98, laser=False)[-1]
    assert newest.t_s == pytest.approx(110.0 - STEP_S - DELAY_S - 0.15)
    assert newest.heave_m == pytest.approx(sea(newest.t_s))
    assert newest.std_m == pytest.approx(0.98 * MODELLED_M)


def test_how_well_lead_and_scale_are_known_is_in_its_standard_deviation() -> None:
    """Error of the product and of the shift by that of their Gaussian factors, drawn; the slope taken between two."""
    tracker = taught(-0.15, 1.02)
    tracker.gain_std, tracker.learned_std_s = 0.004, 0.006
    rng = np.random.default_rng(3)
    gains, leads_s = 0.004 * rng.standard_normal(20_000), 0.006 * rng.standard_normal(20_000)
    output = DelayedScale(NOISE_M)
    for k in range(600):
        at_s = STEP_S * k
        output.step(DelayedHeave(t_s=at_s, heave_m=3.0 * sea(at_s), std_m=0.001), tracker)
        if k % 40 == 39:
            drawn = (1.02 + gains) * 3.0 * np.array([sea(at_s + s) for s in leads_s[:4000].tolist()]).repeat(5)
            assert output.newest is not None
            due_m = float(np.hypot(np.std(drawn), 1.02 * TUNING.overconfidence * 0.001))
            assert output.newest.std_m == pytest.approx(due_m, rel=0.06)


@pytest.mark.parametrize("error_m", [0.03, 0.1])
def test_its_error_is_what_the_laser_has_shown(error_m: float) -> None:
    """From a minute of laser on, of its own time; it is remembered while there is none."""
    output = DelayedScale(NOISE_M)
    early = run(output, (0.0, DELAY_S + 0.9 * TUNING.first_s), error_m)
    assert {one.std_m for one in early} == {MODELLED_M}
    seen = run(output, (DELAY_S + 0.9 * TUNING.first_s, 500.0), error_m)[-1]
    assert seen.std_m == pytest.approx(error_m, rel=0.05)
    assert run(output, (500.0, 700.0), error_m, laser=False)[-1].std_m == pytest.approx(error_m, rel=0.05)
    run(output, (700.0, 1600.0), 0.25 * error_m)
    assert output.value == pytest.approx(max(0.25 * error_m / MODELLED_M, 1.0), rel=0.3)


@pytest.mark.parametrize("error_m", [0.0, 0.008])
def test_a_model_that_is_right_stays_as_it_is(error_m: float) -> None:
    """Noise of the laser is not held against it, and a laser that shows less makes it no surer."""
    output = DelayedScale(NOISE_M)
    assert run(output, (0.0, 400.0), error_m)[-1].std_m == pytest.approx(MODELLED_M)


def test_a_scale_has_its_limit() -> None:
    output = DelayedScale(NOISE_M)
    assert run(output, (0.0, 400.0), 5.0)[-1].std_m == pytest.approx(TUNING.largest * MODELLED_M)


def test_nothing_is_compared_across_a_hole() -> None:
    """An observer that began anew: its first delayed heave comes minutes later."""
    output = DelayedScale(NOISE_M)
    run(output, (0.0, 200.0), 0.0)
    for t_s in np.arange(200.0, 400.0, 0.1).tolist():
        output.push(t_s, sea(t_s) + 7.0)  # whatever was read then
    output.step(None, taught())
    assert output.newest is None
    run(output, (460.0, 520.0), 0.0)
    assert output.value == 1.0
