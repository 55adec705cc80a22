"""Another bias after a gap, in a sea that is the model's own: it is found, and until then the error is as said."""

from __future__ import annotations

from math import hypot

import numpy as np
import pytest
from seas import model, simulated

from heaved.estimation.heave.sea.after_gap import TUNING, AfterGap, Finding
from heaved.estimation.heave.sea.filter import SeaFilter
from heaved.estimation.heave.sea.model import SeaSystem

DT_S, GAP, COUNT = 0.05, slice(3000, 3300), 4800


@pytest.fixture(scope="module")
def system() -> SeaSystem:
    return SeaSystem(model())


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(
    ("jump_mps2", "expected"), [(0.0, Finding.SAME), (0.1, Finding.ANOTHER), (-0.3, Finding.ANOTHER)]
)
def test_it_is_found_whether_the_bias_is_another(
    system: SeaSystem, jump_mps2: float, expected: Finding, seed: int
) -> None:
    states, a = simulated(system, DT_S, COUNT, seed=seed)
    steady = system.steady(DT_S)
    assert steady is not None
    f = SeaFilter(system, steady, -DT_S, np.zeros(len(system.H)), system.stationary.copy())
    for k in range(GAP.start):
        f.step(k * DT_S, a[k])
    asked = AfterGap(f, GAP.stop * DT_S)
    assert asked.silent_s == pytest.approx(((GAP.start - 1) * DT_S, GAP.stop * DT_S))
    found, k = Finding.OPEN, GAP.stop
    while found is Finding.OPEN:
        reading = a[k] + jump_mps2
        f.step(k * DT_S, reading)
        found = asked.step(f, k * DT_S, reading)
        error_m = float(system.heave @ (f.x - states[k]))
        std_m = float(np.sqrt(system.heave @ f.covariance @ system.heave))
        assert abs(error_m) < 5.0 * hypot(std_m, asked.apart_m)
        k += 1
    assert found is expected
    assert (k - GAP.stop) * DT_S < TUNING.longest_s
    if expected is Finding.ANOTHER:
        f.restore(asked.other.state())
    while k < COUNT:
        f.step(k * DT_S, a[k] + jump_mps2)
        k += 1
    assert abs(float(f.x[-1] - states[-1, -1]) - jump_mps2) < 0.01
