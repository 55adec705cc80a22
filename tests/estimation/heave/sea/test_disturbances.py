"""Steps, bursts and wild readings in the acceleration of a sea that is the model's own: the truth is known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from seas import model, simulated

from heaved.estimation.heave.sea.disturbances import TUNING, DisturbanceDetector
from heaved.estimation.heave.sea.filter import SeaFilter
from heaved.estimation.heave.sea.model import SeaSystem

DT_S, BEGIN, COUNT = 0.05, 3000, 6000
Array = np.ndarray


class Ran(NamedTuple):
    error_m: Array
    std_m: Array
    steps_s: list[tuple[float, float]]
    burst: Array


@pytest.fixture(scope="module")
def system() -> SeaSystem:
    return SeaSystem(model())


@pytest.fixture(scope="module")
def sea(system: SeaSystem) -> tuple[Array, Array]:
    return simulated(system, DT_S, COUNT, seed=11)


def ran(system: SeaSystem, sea: tuple[Array, Array], added: Array) -> Ran:
    states, a = sea
    steady = system.steady(DT_S)
    assert steady is not None
    f = SeaFilter(system, steady, -DT_S, np.zeros(len(system.H)), system.stationary.copy())
    detector = DisturbanceDetector()
    error, std, steps, burst = [], [], [], []
    for k in range(COUNT):
        detector.step(f, k * DT_S, a[k] + added[k])
        if detector.step_s is not None:
            steps.append(detector.step_s)
        error.append(float(system.heave @ (f.x - states[k])))
        std.append(float(np.sqrt(system.heave @ f.covariance @ system.heave)))
        burst.append(detector.is_burst)
    return Ran(np.array(error), np.array(std), steps, np.array(burst))


def from_(begin: int, end: int = COUNT) -> Array:
    return ((np.arange(COUNT) >= begin) & (np.arange(COUNT) < end)).astype(float)


def test_a_sea_that_is_the_models_own_goes_through_as_if_it_were_not_there(
    system: SeaSystem, sea: tuple[Array, Array]
) -> None:
    steady = system.steady(DT_S)
    assert steady is not None
    f = SeaFilter(system, steady, -DT_S, np.zeros(len(system.H)), system.stationary.copy())
    for k in range(COUNT):
        f.step(k * DT_S, sea[1][k])
    done = ran(system, sea, np.zeros(COUNT))
    assert not done.steps_s
    assert not done.burst.any()
    assert done.error_m[-1] == pytest.approx(float(system.heave @ (f.x - sea[0][-1])), abs=1e-12)


@pytest.mark.parametrize("step_mps2", [0.05, -0.2, 0.5, 2.0])
def test_a_step_of_the_level_is_found_within_a_second_and_costs_little(
    step_mps2: float, system: SeaSystem, sea: tuple[Array, Array]
) -> None:
    done = ran(system, sea, step_mps2 * from_(BEGIN))
    assert len(done.steps_s) == 1
    left_out, at = done.steps_s[0]
    assert BEGIN * DT_S - 0.3 <= left_out < at <= BEGIN * DT_S + 0.3
    after = slice(BEGIN + round(1.0 / DT_S), COUNT)
    assert np.max(np.abs(done.error_m[after]) / done.std_m[after]) < 4.5
    assert np.max(done.std_m[after]) < 0.2 * np.sqrt(system.heave @ system.stationary @ system.heave)


def test_a_step_that_is_taken_back_is_two(system: SeaSystem, sea: tuple[Array, Array]) -> None:
    done = ran(system, sea, from_(BEGIN, BEGIN + 60))
    assert len(done.steps_s) == 2
    late = slice(BEGIN + 100, COUNT)
    assert np.max(np.abs(done.error_m[late]) / done.std_m[late]) < 4.5


@pytest.mark.parametrize("noise_mps2", [0.1, 1.0])
def test_in_a_burst_of_noise_the_heave_is_as_unsure_as_it_then_is(
    noise_mps2: float, system: SeaSystem, sea: tuple[Array, Array]
) -> None:
    length = round(15.0 / DT_S)
    noise = noise_mps2 * np.random.default_rng(3).standard_normal(COUNT) * from_(BEGIN, BEGIN + length)
    done = ran(system, sea, noise)
    assert done.burst[BEGIN + 20 : BEGIN + length].mean() > 0.9
    assert not done.burst[BEGIN + length + round(8.0 / DT_S) :].any()
    assert np.max(np.abs(done.error_m[BEGIN + 20 :]) / done.std_m[BEGIN + 20 :]) < 4.5
    usual_m = np.std(done.error_m[1000:BEGIN])
    assert np.std(done.error_m[-1000:]) < 1.5 * usual_m
    assert np.mean(done.std_m[BEGIN + 100 : BEGIN + length]) > 2.0 * usual_m


def test_noise_that_stays_is_left_to_the_fits(system: SeaSystem, sea: tuple[Array, Array]) -> None:
    noise = 0.3 * np.random.default_rng(4).standard_normal(COUNT) * from_(BEGIN)
    done = ran(system, sea, noise)
    assert not done.burst[BEGIN + round((TUNING.burst_s + 1.0) / DT_S) :].any()
    assert np.max(np.abs(done.error_m[BEGIN + 20 :]) / done.std_m[BEGIN + 20 :]) < 4.5


def test_a_wild_reading_is_no_step_and_soon_over(system: SeaSystem, sea: tuple[Array, Array]) -> None:
    done = ran(system, sea, 3.0 * from_(BEGIN, BEGIN + 2))
    assert not done.steps_s
    assert not done.burst[BEGIN + round(3.0 / DT_S) :].any()
    assert np.max(np.abs(done.error_m[1000:]) / done.std_m[1000:]) < 4.5
