"""One joint of a crane, against the truth of simulated cranes and of joysticks that are let go of."""

from __future__ import annotations

from math import nan, pi, radians

import numpy as np
import pytest

from heaved.estimation.crane.joint import Joint
from heaved.simulate.crane import CraneAtWork

Array = np.ndarray
FASTEST = radians(2.0)
STEP = radians(0.1)


def joint(std: float = STEP, *, fastest: float = FASTEST, turns: bool = True) -> Joint:
    return Joint(std=std, fastest=fastest, turns=turns)


def stepped(values: Array, step: float = STEP) -> Array:
    found: Array = np.round(values / step) * step
    return found


def run(one: Joint, times: Array, values: Array, ahead_s: float = 0.0) -> Array:
    """(n, 3) position, rate, standard deviation, each so long after its reading."""
    found = []
    for t_s, value in zip(times.tolist(), values.tolist(), strict=True):
        one.step(t_s, value)
        found.append(one.at(t_s + ahead_s))
    return np.array(found)


def at_work(times: Array, joint_number: int, seed: int) -> tuple[Array, Array]:
    """True angles and rates of a simulated crane."""
    crane = CraneAtWork(seed=seed)
    truth = [crane.at(t_s) for t_s in times.tolist()]
    return np.array([t.at[joint_number] for t in truth]), np.array([t.rate[joint_number] for t in truth])


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 50.0])
@pytest.mark.parametrize("seed", range(3))
def test_the_rate_of_a_coarse_encoder_is_better_than_differences_by_far(rate_hz: float, seed: int) -> None:
    """Times jitter by a fifth of the period, as those of a busy PLC."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, 300.0, 1.0 / rate_hz) + rng.uniform(-0.1, 0.1, int(300 * rate_hz)) / rate_hz
    truth, rates = at_work(times, 1, seed)
    readings = stepped(truth)
    found = run(joint(), times, readings)
    error = np.std(found[50:, 1] - rates[50:])
    assert error < radians(0.08)
    assert error < 0.5 * np.std(np.diff(readings)[50:] / np.diff(times)[50:] - rates[51:])
    np.testing.assert_array_less(np.abs(found[50:, 0] - truth[50:]), 5.0 * found[50:, 2])


@pytest.mark.parametrize("seed", range(4))
def test_its_deviation_is_that_of_its_errors(seed: int) -> None:
    """Readings with the noise that it is told of, and a joint that moves as the filter thinks: NEES of 1."""
    rng = np.random.default_rng(seed)
    dt, tau, std = 0.1, 5.0, radians(0.05)
    rate, truth, rates = 0.0, 0.0, []
    angles = []
    for _ in range(20000):
        truth += dt * rate
        rate += -dt / tau * rate + 0.577 * FASTEST * np.sqrt(2.0 * dt / tau) * rng.standard_normal()
        angles.append(truth)
        rates.append(rate)
    times = dt * np.arange(20000)
    found = run(joint(std), times, np.array(angles) + std * rng.standard_normal(20000))
    nees = float(np.mean(((found[100:, 0] - angles[100:]) / found[100:, 2]) ** 2))
    assert 0.9 < nees < 1.1


@pytest.mark.parametrize("ramp_s", [0.5, 2.0])
def test_a_joystick_let_go_is_seen_within_seconds(ramp_s: float) -> None:
    times = np.arange(0.0, 40.0, 0.1)
    rates = np.interp(times, [10.0, 10.0 + ramp_s, 20.0, 20.0 + ramp_s], [0.0, FASTEST, FASTEST, 0.0])
    truth = np.concatenate(([0.0], np.cumsum(0.05 * (rates[1:] + rates[:-1]))))
    found = run(joint(), times, stepped(truth))
    late = times > 20.0 + ramp_s + 2.0
    assert np.max(np.abs(found[late, 1])) < 0.1 * FASTEST
    assert np.max(np.abs(found[:, 0] - truth)) < radians(0.5)
    assert abs(found[-1, 1]) < 0.01 * FASTEST, "it comes to rest"


def test_an_encoder_that_is_asked_too_often_repeats_itself_and_does_no_harm() -> None:
    """New readings five times a second, asked fifty times."""
    times = np.arange(0.0, 60.0, 0.02)
    truth = 0.01 * times
    held = stepped(0.01 * np.floor(times * 5.0 + 1e-9) / 5.0, radians(0.01))
    found = run(joint(), times, held)
    assert np.max(np.abs(found[500:, 1] - 0.01)) < 0.1 * 0.01
    # Readings are as old as their hold: a tenth of a second is not seen from here.
    assert np.max(np.abs(found[500:, 0] - truth[500:])) < 0.01 * 0.25


def test_a_full_turn_is_no_jump() -> None:
    times = np.arange(0.0, 30.0, 0.1)
    truth = radians(350.0) + 0.02 * times
    found = run(joint(fastest=radians(6.0)), times, stepped(truth) % (2.0 * pi))
    off = (found[20:, 0] - truth[20:] + pi) % (2.0 * pi) - pi
    assert np.max(np.abs(off)) < radians(0.15)
    assert np.max(np.abs(found[50:, 1] - 0.02)) < 0.005


def test_spikes_are_kept_out_and_an_encoder_set_anew_is_followed() -> None:
    rng = np.random.default_rng(1)
    times = np.arange(0.0, 60.0, 0.1)
    truth, _ = at_work(times, 1, 1)
    readings = stepped(truth)
    hit = rng.choice(np.arange(20, 400), 30, replace=False)
    readings[hit] = rng.uniform(-3.0, 3.0, 30)
    readings[400:] += 1.0
    one = joint()
    found = run(one, times, readings)
    assert np.max(np.abs(found[10:400, 0] - truth[10:400])) < radians(0.6)
    assert np.max(np.abs(found[412:, 0] - truth[412:] - 1.0)) < radians(0.6)
    assert one.jumps == 1
    assert one.spikes >= 30


def test_what_is_not_known_grows_as_fast_as_a_crane_moves_and_no_faster() -> None:
    """Without readings: the deviation after some seconds is that of a rate that may be anything up to the fastest."""
    one = joint()
    run(one, np.arange(0.0, 10.0, 0.1), np.zeros(100))
    stds = [one.at(9.9 + age_s)[2] for age_s in (0.0, 0.5, 1.0, 2.0, 5.0, 20.0)]
    assert stds == sorted(stds)
    assert 0.3 * FASTEST * 5.0 < stds[4] < FASTEST * 5.0
    assert stds[5] < FASTEST * 20.0
    assert one.at(1e9)[0] == pytest.approx(0.0, abs=radians(0.1)), "held where it was"


def test_nothing_is_known_before_the_first_reading_and_old_ones_say_nothing() -> None:
    one = joint()
    assert all(np.isnan(one.at(5.0)))
    one.step(1.0, nan)
    assert all(np.isnan(one.at(5.0)))
    one.step(2.0, 0.5)
    one.step(2.0, 9.0)
    one.step(1.0, -9.0)
    assert one.at(2.0)[0] == 0.5
    assert one.seen_s == 2.0
