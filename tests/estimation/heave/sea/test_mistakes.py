"""What errors of known shape do to the heave. Oracle: the steady filter's recursion, fed with them alone."""

from __future__ import annotations

import numpy as np
import pytest

from heaved.estimation.heave.sea.filter import SeaFilter
from heaved.estimation.heave.sea.mistakes import TUNING, Mistakes
from heaved.estimation.heave.sea.model import SeaModel, SeaSystem
from heaved.estimation.heave.sea.output import SeaHeave

DT_S = 0.05
ROW = round(TUNING.row_s / DT_S)
LATE_STD_S = 0.02


@pytest.fixture(scope="module")
def system() -> SeaSystem:
    return SeaSystem(
        SeaModel(
            stages=3, frequency_hz=(0.09, 0.14), damping=(0.15, 0.3), level_m2phz=(10.0, 1.0), noise_psd=1e-6,
            bias_walk_psd=1e-10,
        )
    )  # fmt: skip


def filtered(system: SeaSystem) -> SeaFilter:
    steady = system.steady(DT_S)
    assert steady is not None
    return SeaFilter(system, steady, 0.0, np.zeros(len(system.H)), None)


def shape(t_s: np.ndarray) -> np.ndarray:
    """The product of two waves, in groups."""
    return np.asarray(0.3 * np.cos(0.25 * t_s) * (1.0 + np.cos(0.04 * t_s)) + 0.1)


def test_it_is_what_the_filter_makes_of_them_at_that_moment(system: SeaSystem) -> None:
    f, mistakes = filtered(system), Mistakes()
    answer = SeaHeave(f, (1.0,), 0.0).answer
    steady, x = f.steady, np.zeros(len(system.H))
    found, expected = [], []
    for row in range(1200):
        t_s = TUNING.row_s * (row + 0.5)
        for _ in range(ROW):
            x = steady.F @ x
            x += steady.K * (float(shape(np.array(t_s))) - system.H @ x)
        mistakes.push(t_s, (0.0, float(shape(np.array(t_s)))), np.diag([0.0, LATE_STD_S**2]))
        found.append(mistakes.square_m2(answer) ** 0.5)
        expected.append(LATE_STD_S * abs(float(system.heave @ x)))
    held = round(TUNING.held_s / TUNING.row_s)
    for k in range(400, 1200):
        largest = max(expected[k - held + 1 : k + 1])
        assert found[k] == pytest.approx(largest, rel=0.02, abs=1e-4)
    assert max(found[400:]) > 3.0 * min(found[400:])  # it follows the groups


def test_what_has_become_known_counts_until_the_filter_knows_it(system: SeaSystem) -> None:
    mistakes, answer = Mistakes(), SeaHeave(filtered(system), (1.0,), 0.0).answer
    for row in range(400):
        mistakes.push(TUNING.row_s * (row + 0.5), (0.0, 0.0), np.eye(2))
    assert mistakes.square_m2(answer) == 0.0
    mistakes.amend(np.array([50.0, 90.0]), np.array([0.01, 0.01]))
    lacking_m2 = mistakes.square_m2(answer)
    assert lacking_m2 > 0.0
    mistakes.known_until(100.0)
    for row in range(400, 400 + round(TUNING.held_s / TUNING.row_s)):
        mistakes.push(TUNING.row_s * (row + 0.5), (0.0, 0.0), np.eye(2))
        last_m2 = mistakes.square_m2(answer)
    assert last_m2 < 1e-20 * lacking_m2 + 1e-30
    assert not mistakes.are_over(130.0)
    assert mistakes.are_over(106.1 + TUNING.lasts_s)


def test_before_the_first_row_there_is_nothing(system: SeaSystem) -> None:
    mistakes = Mistakes()
    mistakes.known_until(10.0)
    mistakes.amend(np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    assert mistakes.are_over(0.0)
