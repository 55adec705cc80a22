"""Heave from an accelerometer that shakes, as the observer publishes it; beside the least error that is possible."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from evidence.scenarios import sea_limits

from heaved.estimation.heave.params import SeaParams
from heaved.estimation.heave.sea.observer import SeaObserver
from heaved.estimation.heave.sea.refit import look
from heaved.samples import GRAVITY_MPS2
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import record
from heaved.simulate.shaking import NONE

DURATION_S, SCORED_S = 480.0, 300.0
Array = np.ndarray


class Ran(NamedTuple):
    observer: SeaObserver
    t_s: Array
    error_m: Array
    std_m: Array
    sigma_m: float


def ran(
    sea: str,
    rate_hz: float,
    shake: str = NONE,
    added: object = 0.0,
    seed: int = 3,
    late_s: Array | float = 0.0,
    duration_s: float = DURATION_S,
) -> Ran:
    """``late_s`` (n,): by which the stamps are."""
    made = record(
        seaway(sea, seed, attitude=False), duration_s, imu_rate_hz=rate_hz, laser="off", seed=seed, shake=shake
    )
    a = made.az_mps2 - GRAVITY_MPS2 + (added(made.t_s) if callable(added) else 0.0)
    observer, heave, std = SeaObserver(SeaParams(), ()), [], []
    t = made.t_s + late_s
    for t_s, a_mps2 in zip(t.tolist(), a.tolist(), strict=True):
        observer.step(t_s, a_mps2)
        if (past := observer.due()) is not None:
            observer.accept(look(past))
        heave.append(observer.at(0.0).heave_m)
        std.append(observer.error_std_m(0.0))
    truth = np.interp(t, made.t_s, made.truth.heave_m)
    return Ran(observer, made.t_s, np.array(heave) - truth, np.array(std), float(np.std(truth)))


@pytest.mark.parametrize(
    ("sea", "rate_hz", "shake"),
    [
        ("S6", 20.0, "line-3.1"),
        ("S4", 20.0, "line-1.3"),
        ("S6", 100.0, "line-25.1"),
        ("S4", 20.0, "engines"),
        ("S6", 20.0, "broadband-strong"),
        ("S4", 20.0, "whipping"),
        ("S6", 10.0, "line-3.1"),
        ("S6", 20.0, "engine-room"),
        ("CRAFT", 20.0, NONE),
    ],
)
def test_vibration_costs_hardly_more_than_it_must(sea: str, rate_hz: float, shake: str) -> None:
    """Three minutes of one record: within 1.4 times the limit, which has the vibration as coloured noise."""
    run = ran(sea, rate_hz, shake)
    scored = run.t_s >= SCORED_S
    error = run.error_m[scored]
    limit_m = sea_limits(sea, "A", rate_hz, shake).causal_m
    assert np.sqrt(np.mean(error**2)) < 1.4 * limit_m
    beyond = np.abs(error) / run.std_m[scored]
    assert np.mean(beyond < 1.96) > 0.9
    assert np.max(beyond) < 4.0
    assert run.observer.doubts == ()


def test_a_generator_that_would_fold_into_the_waves_costs_nothing() -> None:
    """1202 revolutions at 100 Hz: between the beats it would be a swell of 30 s and a tenth of a metre."""
    run = ran("S6", 100.0, added=lambda t: 0.5 * np.sin(2 * np.pi * 20.03 * t))
    scored = run.t_s >= SCORED_S
    assert np.sqrt(np.mean(run.error_m[scored] ** 2)) < 1.4 * sea_limits("S6", "A", 100.0).causal_m


@pytest.mark.parametrize("shake", ["line", "band"])
def test_an_engine_that_starts_is_known_in_half_a_minute(shake: str) -> None:
    """Until then the heave is as good as it says, and it is never a metre off."""
    begin = 330.0

    def added(t: Array) -> Array:
        noise = np.convolve(np.random.default_rng(4).standard_normal(len(t)), [0.3, -0.3], mode="same")
        vibration = 0.3 * np.sin(2 * np.pi * 3.1 * t) if shake == "line" else noise
        return np.where(t >= begin, vibration, 0.0)

    run = ran("S6", 20.0, added=added)
    inside = run.t_s >= begin
    beyond = np.abs(run.error_m / run.std_m)[inside]
    assert np.mean(beyond > 4.0) < 0.01
    assert np.max(np.abs(run.error_m[inside])) < run.sigma_m
    known = run.t_s >= begin + 60.0
    assert np.sqrt(np.mean(run.error_m[known] ** 2)) < 0.04 * run.sigma_m


def test_slams_cost_less_than_a_linear_filter_could_make_of_them() -> None:
    run = ran("S6", 20.0, "slams", seed=2)
    scored = run.t_s >= SCORED_S
    beyond = np.abs(run.error_m / run.std_m)[scored]
    assert np.sqrt(np.mean(run.error_m[scored] ** 2)) < sea_limits("S6", "A", 20.0, "slams").causal_m
    assert np.mean(beyond < 1.96) > 0.9
    # Of two slams within a second the impulse is not known as well as it seems.
    assert np.mean(beyond > 4.0) < 0.03
    assert np.max(beyond) < 8.0


def test_slams_from_the_start_on_neither_lie_nor_silence_the_heave() -> None:
    """The first of them strike before there is a model, or while it is too young to judge anything."""
    run = ran("S6", 20.0, "slams", seed=3, duration_s=210.0)
    told = run.t_s >= 60.0
    assert np.mean(np.abs(run.error_m / run.std_m)[told] > 4.0) < 0.005
    assert np.mean(run.std_m[told] < 0.5 * run.sigma_m) > 0.99
    # What is left of the slams in the record is no swell.
    assert run.observer.sea is not None
    assert run.observer.sea.peak_period_s < 15.0


def thruster(t: Array) -> Array:
    """It runs for 25 s of every minute."""
    return np.where((t > 100.0) & (t % 60.0 < 25.0), 0.4 * np.sin(2.0 * np.pi * 4.3 * t), 0.0)


def trains_of_slams(t: Array) -> Array:
    """Six in a quarter of a minute, once a minute, while the hull still rings from the one before."""
    rng, total = np.random.default_rng(5), np.zeros_like(t)
    for first_s in np.arange(80.0, DURATION_S, 60.0).tolist():
        for blow_s in (first_s + 2.7 * np.arange(6) + rng.uniform(-0.3, 0.3, 6)).tolist():
            since = np.maximum(t - blow_s, 0.0)
            total += 2.0 * np.exp(-0.97 * since) * np.sin(2.0 * np.pi * 2.2 * since)
    return total


@pytest.mark.parametrize(("added", "share"), [(thruster, 0.06), (trains_of_slams, 0.15)])
def test_what_comes_and_goes_costs_little_and_never_lies(added: object, share: float) -> None:
    run = ran("S6", 20.0, added=added, duration_s=300.0)
    told = run.t_s >= 120.0
    assert np.mean(np.abs(run.error_m / run.std_m)[told] > 4.0) < 0.005
    assert np.sqrt(np.mean(run.error_m[told] ** 2)) < share * run.sigma_m
    assert np.mean(run.std_m[told] < 0.5 * run.sigma_m) > 0.99


def test_a_sensor_that_warms_up_is_followed() -> None:
    """0.28 mm/s2 a second for two minutes: a tenth of the heave where the bias is taken to wander as ever."""
    run = ran("S6", 20.0, added=lambda t: 2.8e-4 * np.clip(t - 320.0, 0.0, 120.0))
    scored = run.t_s >= SCORED_S
    assert np.sqrt(np.mean(run.error_m[scored] ** 2)) < 0.03 * run.sigma_m
    later = run.t_s >= 345.0
    assert np.max(np.abs(run.error_m / run.std_m)[later]) < 4.0
    assert np.mean(run.std_m[later]) < 0.06 * run.sigma_m


def test_stamps_that_are_wrong_for_half_a_minute_on_a_hull_that_shakes_are_owned_up_to() -> None:
    """By up to 40 ms, of a line that is then noise in the waves' band too: no resonance, and no longer known after."""
    t = np.arange(round(DURATION_S * 20.0)) / 20.0
    late_s = np.where((t > 320.0) & (t < 350.0), np.random.default_rng(4).uniform(0.0, 0.04, t.size), 0.0)
    run = ran("S6", 20.0, "line-3.1", late_s=late_s)
    beyond = np.abs(run.error_m / run.std_m)
    wrong, after = (run.t_s > 321.0) & (run.t_s < 350.0), run.t_s >= 350.0
    assert np.max(beyond[wrong]) < 4.5
    assert np.max(beyond[after]) < 4.0
    assert np.mean(run.std_m[wrong]) < 0.3 * run.sigma_m
    assert np.mean(run.std_m[run.t_s > 380.0]) < 0.06 * run.sigma_m


def test_a_knock_while_a_sensor_warms_up_leaves_no_drift_behind() -> None:
    """A step of the level ends what is known of the drift: what goes on after it is found anew, and fits go on."""
    run = ran("S6", 20.0, added=lambda t: 2.8e-4 * np.clip(t - 320.0, 0.0, 120.0) + 0.3 * (t > 370.0))
    assert run.observer.steps == 1
    later = run.t_s >= 375.0
    assert np.max(np.abs(run.error_m / run.std_m)[later]) < 6.0
    assert np.sqrt(np.mean(run.error_m[run.t_s > 410.0] ** 2)) < 0.05 * run.sigma_m
    assert run.observer.sea is not None
    assert run.observer.sea.t_s > DURATION_S - 70.0


@pytest.mark.parametrize(("sea", "seed"), [("S4", 3), ("SL", 3)])
def test_a_poor_sensor_is_known_for_one(sea: str, seed: int) -> None:
    made = record(seaway(sea, seed, attitude=False), DURATION_S, sensor="C", laser="off", seed=seed)
    observer = SeaObserver(SeaParams(), ())
    for t_s, a_mps2 in zip(made.t_s.tolist(), (made.az_mps2 - GRAVITY_MPS2).tolist(), strict=True):
        observer.step(t_s, a_mps2)
        if (past := observer.due()) is not None:
            observer.accept(look(past))
    assert observer.sea is not None
    assert observer.sea.noise_mps2_rthz == pytest.approx(4e-3, rel=0.25)
    assert 8e-5 < observer.sea.bias_walk_mps2_rts < 5e-4
