"""A gyroscope on a hull that shakes: the short, seeded version of what ``tools/accuracy.py rock --shake`` measures."""

from __future__ import annotations

import numpy as np
import pytest
from evidence.rock import shaken as rock_shaken

from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import record

NAMES = (
    "line 3.1 Hz, 4 mrad/s, wandering 5 %",
    "1-10 Hz, 4 mrad/s, angles too",
    "0.5 % spikes of the gyroscopes",
    "0.5 % small spikes",
)


@pytest.fixture(scope="module")
def rows() -> dict[str, rock_shaken.Row]:
    return {row.shake: row for row in rock_shaken.rows(20.0, 5, 250.0, NAMES)}


@pytest.mark.parametrize("name", NAMES)
def test_body_rates_never_cost_and_deviations_are_true(rows: dict[str, rock_shaken.Row], name: str) -> None:
    row = rows[name]
    assert max(row.over_without) < 1.02
    assert min(row.least_coverage) > 0.9
    assert max(row.most_coverage[:-1]) < 0.998  # of errors 2 s ahead there are few
    assert row.lies < 1e-4 * row.predictions


def test_spikes_cost_nothing(rows: dict[str, rock_shaken.Row]) -> None:
    """They have been a factor of 25."""
    for name in ("0.5 % spikes of the gyroscopes", "0.5 % small spikes"):
        assert max(rows[name].over_still) < 1.05


def test_a_steady_vibration_that_is_predicted_with_the_motion_is_in_the_deviations() -> None:
    """Of the waves alone a prediction is off by all of it."""
    (row,) = rock_shaken.rows(20.0, 5, 250.0, ("line 3.1 Hz, 40 mrad/s, angles too",))
    assert max(row.over_still[:3]) > 5.0
    assert row.lies < 1e-3 * row.predictions


def test_the_report_has_every_row(rows: dict[str, rock_shaken.Row]) -> None:
    text = rock_shaken.report(list(rows.values()))
    assert all(f"| {name} | 20 |" in text for name in NAMES)


def test_rates_that_miss_the_horizons_are_refused() -> None:
    with pytest.raises(ValueError, match="50 Hz"):
        rock_shaken.rows(50.0, 1, 200.0)


def test_a_shaken_record_keeps_its_truth_and_its_seed() -> None:
    still = record(seaway("S4", seed=1), 30.0, imu_rate_hz=20.0, laser="off", seed=1)
    shake = rock_shaken.SHAKES["1-10 Hz, 4 mrad/s, angles too"]
    once, again = (rock_shaken.shaken(still, shake, 3) for _ in range(2))
    np.testing.assert_array_equal(once.gx_radps, again.gx_radps)
    assert once.truth is still.truth
    rate = once.gx_radps - still.gx_radps
    assert np.std(rate) == pytest.approx(4e-3, rel=0.05)
    assert 1e-5 < np.std(once.roll_rad - still.roll_rad) < 4e-3 / (2.0 * np.pi)
