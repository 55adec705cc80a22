"""tools/accuracy.py correction, where the physics is wrong: a short run of what the tool runs for long.

Oracle: the truth of the simulated sea, and the same record with right physics.
"""

from __future__ import annotations

from math import nan, sqrt

import msgspec
import numpy as np
import pytest
from evidence.heave.left_over import lagged, least_left
from evidence.heave.wrong_physics import CASES, Found, Line, Run, report, run

LASER = "200+40"
"""It has been there for two minutes when the heave has settled, and is away for a while."""


def rms_m(found: Found) -> float:
    return sqrt(sum(found.squares_m2) / 2.0)


def test_what_a_fault_puts_in_is_taken_out_and_right_physics_costs_nothing() -> None:
    right, askew = (case for case in CASES if case.name in ("right physics", "IMU askew by 2.5° twice"))
    runs = ((right, True), (askew, False), (askew, True))
    of_right, without, corrected = (
        run(
            Run(
                case=case,
                sea="S6-bow-0.8",
                seed=1,
                corrected=is_on,
                trained=False,
                laser=LASER,
                duration_s=270.0,
                from_s=180.0,
            )
        )
        for case, is_on in runs
    )
    print(of_right, without, corrected)
    assert of_right.active == 0.0  # It is the heave without a correction.
    put_in = rms_m(without) - rms_m(of_right)
    assert put_in > 0.3 * rms_m(of_right)
    assert rms_m(without) - rms_m(corrected) > 0.5 * put_in
    assert corrected.outages_m2 == pytest.approx((corrected.squares_m2[1],))
    assert corrected.squares_m2[1] < 1.02**2 * without.squares_m2[1]
    assert corrected.active > 0.8
    assert corrected.published == 1.0
    assert corrected.within > 0.9
    assert corrected.delayed_m2 < 0.7 * without.delayed_m2


def test_a_line_says_what_was_put_in_and_what_was_taken_out() -> None:
    line = Line(
        case="crooked", sea="S6", limit_m=0.008, right_m=0.010, without_m=(0.020, 0.018, 0.022),
        corrected_m=(0.012, 0.013, 0.011), delayed_m=(0.004, 0.002), worst_outage=0.7, within=0.95, active=0.9,
        first_s=123.0, published=1.0,
    )  # fmt: skip
    assert line.put_in == pytest.approx(1.0)
    assert line.taken_out == pytest.approx(0.8)
    assert line.outage_ratio == pytest.approx(0.5)
    text = report([line])
    assert (
        "| 18.0 / 22.0 | 13.0 / 11.0 | 100% | **80%** | 0.600 | 0.500 | 0.700 | 4.0 → 2.0 | 90% | 123 s | 95.0% | met |"
        in text
    )
    assert text.endswith("1 rows: 1 met, 0 missed.")
    little = msgspec.structs.replace(line, corrected_m=(0.016, 0.013, 0.011), active=0.7, worst_outage=1.03)
    assert little.misses == ["worst outage 1.030", "40% out", "active 70%"]
    assert msgspec.structs.replace(line, without_m=(0.0105,) * 3, corrected_m=(0.0108,) * 3).misses == ["1.029 > 1.02"]
    assert msgspec.structs.replace(line, without_m=(0.0105,) * 3, corrected_m=(0.0107,) * 3).misses == []
    assert msgspec.structs.replace(line, without_m=(0.0100,) * 3, corrected_m=(0.0102,) * 3).misses == ["1.020 > 1.01"]
    nothing = Line(
        case="right", sea="S6", limit_m=0.008, right_m=0.010, without_m=(0.0101,) * 3, corrected_m=(0.0101,) * 3,
        delayed_m=(0.004, 0.004), worst_outage=1.0, within=0.95, active=0.0, first_s=nan, published=1.0,
    )  # fmt: skip
    assert "| 1% | – | 1.000 | 1.000 | 1.000 |" in report([nothing])


def test_a_regression_leaves_what_its_inputs_do_not_hold() -> None:
    rng = np.random.default_rng(1)
    known, hidden = rng.standard_normal((2, 4000))
    inputs = np.column_stack((known, rng.standard_normal(4000)))
    error = known + 0.5 * hidden
    left = least_left(inputs[:2000], error[:2000] + 3.0, inputs[2000:], error[2000:])
    assert left == pytest.approx(0.5 / np.sqrt(1.25), rel=0.05)
    assert least_left(inputs[:2000, 1:], error[:2000], inputs[2000:, 1:], error[2000:]) == pytest.approx(1.0, abs=0.01)


def test_what_lies_behind_is_not_known_before_the_beginning() -> None:
    found = lagged(np.arange(30.0), (0.0, 1.0))
    assert found[25].tolist() == [25.0, 15.0]
    assert np.isnan(found[9, 1])
