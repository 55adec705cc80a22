"""Heave near the last sample, against the exponential of the whole matrix and F P F' + Q."""

from __future__ import annotations

from math import inf, isnan, nan

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_lyapunov
from seas import model, simulated, whole

from heaved.estimation.heave.sea.filter import SeaFilter
from heaved.estimation.heave.sea.model import SeaSystem
from heaved.estimation.heave.sea.output import NO_TRANSFER, TUNING, BumplessTransfer, SeaHeave

DT_S = 0.05
HORIZONS_S = (0.1, 0.5, 2.0)
LEAD_S = 0.15
BEAT_S = 500.0


@pytest.fixture(scope="module")
def system() -> SeaSystem:
    return SeaSystem(model(6, 2))


@pytest.fixture
def heave(system: SeaSystem) -> SeaHeave:
    """In the middle of a simulated sea, with the steady filter's covariance."""
    steady = system.steady(DT_S)
    assert steady is not None
    states, _ = simulated(system, DT_S, 400, seed=4)
    return SeaHeave(SeaFilter(system, steady, BEAT_S, states[-1].copy(), None), HORIZONS_S, LEAD_S)


def moved(heave: SeaHeave, tau_s: float) -> tuple[float, float]:
    """Heave and velocity of the state ``tau_s`` on."""
    system = heave.filter.system
    x = expm(system.A * tau_s) @ heave.filter.x
    return float(system.heave @ x), float(system.velocity @ x)


@pytest.mark.parametrize("learned_s", [0.0, -0.03, 0.012])
@pytest.mark.parametrize("late_s", [0.0, 0.024, 0.05])
def test_heave_is_the_state_moved_on(heave: SeaHeave, late_s: float, learned_s: float) -> None:
    """Whatever moment is asked for: those that are made ready for, and others."""
    heave.set_lead(learned_s)
    for shift_s in (0.0, LEAD_S, *HORIZONS_S, 0.123, 0.777):
        found = heave.at(BEAT_S + late_s, shift_s)
        expected = moved(heave, late_s + shift_s - learned_s)
        assert (found.heave_m, found.velocity_mps) == pytest.approx(expected, abs=2e-5 * heave.sea_std_m)
    found = heave.unshifted(BEAT_S + late_s)
    assert (found.heave_m, found.velocity_mps) == pytest.approx(moved(heave, late_s), abs=2e-5 * heave.sea_std_m)


def test_standard_deviations_are_those_of_the_covariance_moved_on(heave: SeaHeave, system: SeaSystem) -> None:
    """Times the scale; whatever the age of the beat, to the next half of its length."""
    heave.scale = 1.5
    heave.set_lead(0.0)
    P = heave.filter.covariance
    for late_s, halves in ((0.0, 0), (0.011, 0), (0.014, 1), (0.03, 1), (0.06, 2), (0.8, 32)):
        for shift_s in (0.0, LEAD_S):
            tau_s = shift_s + halves * 0.5 * DT_S
            F, Q = (np.eye(len(P)), np.zeros_like(P)) if tau_s == 0.0 else whole(system, tau_s)
            expected = 1.5 * np.sqrt(system.heave @ (F @ P @ F.T + Q) @ system.heave)
            # Linear between whole beats, a little more than the truth.
            assert heave.std_m(BEAT_S + late_s, shift_s) == pytest.approx(expected, rel=2e-2 if halves % 2 else 5e-3)
    for shift_s in (*HORIZONS_S, 0.777):
        F, Q = whole(system, shift_s)
        expected = 1.5 * np.sqrt(system.heave @ (F @ P @ F.T + Q) @ system.heave)
        assert heave.std_m(BEAT_S, shift_s) == pytest.approx(expected, rel=5e-3)


def test_forecasts_are_heave_and_deviation_of_each_horizon(heave: SeaHeave) -> None:
    """With a model before that has just been left, and one that is as good as forgotten."""
    for transfer in (None, BumplessTransfer(0.2, -0.1, BEAT_S - 1.0), BumplessTransfer(0.2, -0.1, BEAT_S - 14.0)):
        heave.transfer = transfer or heave.transfer
        heave.set_lead(0.01)
        t_s = BEAT_S + 0.03
        found = heave.forecast(t_s, 3.0, 0.9)
        assert [f.horizon_s for f in found] == list(HORIZONS_S)
        assert [f.heave_m for f in found] == pytest.approx(
            [0.9 * heave.at(t_s, h).heave_m for h in HORIZONS_S], rel=1e-12, abs=1e-12
        )
        left = [heave.transfer.at(t_s + h)[0] for h in HORIZONS_S]
        heave.transfer = NO_TRANSFER
        modelled = [heave.std_m(t_s, h - 0.005) for h in HORIZONS_S]  # 0.025 s after the beat: half of its length
        assert [f.std_m for f in found] == pytest.approx((0.9 * 3.0 * np.hypot(modelled, left)).tolist(), rel=1e-12)


def test_what_is_left_of_the_old_model_is_in_heave_velocity_and_deviation(heave: SeaHeave) -> None:
    heave.set_lead(0.0)
    plain, std_m = heave.at(BEAT_S, 0.5), heave.std_m(BEAT_S, 0.5)
    heave.transfer = BumplessTransfer(0.2, -0.1, BEAT_S - 1.0)
    left_m, left_mps = heave.transfer.at(BEAT_S + 0.5)
    found = heave.at(BEAT_S, 0.5)
    assert (found.heave_m, found.velocity_mps) == pytest.approx((plain.heave_m + left_m, plain.velocity_mps + left_mps))
    assert heave.std_m(BEAT_S, 0.5) == pytest.approx(np.sqrt(std_m**2 + left_m**2))


def test_a_state_that_has_moved_gives_other_numbers(heave: SeaHeave) -> None:
    heave.set_lead(0.0)
    before, std_m = heave.forecast(BEAT_S), heave.std_m(BEAT_S, 0.5)
    first = before[0].heave_m
    heave.filter.x = 2.0 * heave.filter.x
    heave.filter.P = 4.0 * heave.filter.covariance
    heave.moved()
    assert heave.forecast(BEAT_S)[0].heave_m == pytest.approx(2.0 * first)
    assert before[0].heave_m == first
    assert [f.heave_m for f in heave.forecast(BEAT_S)] == pytest.approx([2.0 * f.heave_m for f in before])
    assert heave.std_m(BEAT_S, 0.0) > 1.9 * heave.steady_std_m
    assert heave.std_m(BEAT_S, 0.5) > std_m


def test_it_is_converged_when_the_heave_is_nearly_as_sure_as_it_will_be(heave: SeaHeave) -> None:
    assert heave.is_converged
    for factor, expected in ((0.98 * TUNING.converged, True), (1.02 * TUNING.converged, False)):
        heave.filter.P = factor**2 * heave.filter.steady_covariance
        heave.moved()
        assert heave.state_std_m == pytest.approx(factor * heave.steady_std_m)
        assert heave.is_converged == expected


def test_without_a_beat_for_too_long_nothing_is_known(heave: SeaHeave) -> None:
    t_s = BEAT_S + TUNING.stale_s + 0.01
    assert isnan(heave.at(t_s, 0.0).heave_m)
    assert isnan(heave.std_m(t_s, 0.5))
    forecast = heave.forecast(t_s)
    assert [f.horizon_s for f in forecast] == list(HORIZONS_S)
    assert all(isnan(f.heave_m) and isnan(f.std_m) for f in forecast)


def test_a_disturbance_is_in_every_standard_deviation(heave: SeaHeave, system: SeaSystem) -> None:
    """White noise up to half of the rate: what the steady filter makes of it, by Lyapunov's equation."""
    heave.set_lead(0.0)
    before_m = [heave.std_m(BEAT_S + 0.02, shift_s) for shift_s in (0.0, LEAD_S, 0.3)]
    f_hz = np.arange(0.001, 0.5 / DT_S, 0.002)
    psd = 1e-5
    heave.disturb(f_hz, np.full(len(f_hz), psd))
    steady = heave.filter.steady
    loop = (np.eye(len(system.H)) - np.outer(steady.K, system.H)) @ steady.F
    P = solve_discrete_lyapunov(loop, np.outer(steady.K, steady.K) * psd * 0.5 / DT_S)
    more_m2 = float(system.heave @ P @ system.heave)
    after_m = [heave.std_m(BEAT_S + 0.02, shift_s) for shift_s in (0.0, LEAD_S, 0.3)]
    assert np.sqrt(np.square(before_m) + more_m2) == pytest.approx(after_m, rel=1e-2)
    assert all(one.std_m**2 > more_m2 for one in heave.forecast(BEAT_S))
    heave.disturb(f_hz, np.zeros(len(f_hz)))
    assert [heave.std_m(BEAT_S + 0.02, shift_s) for shift_s in (0.0, LEAD_S, 0.3)] == before_m


# --- from one model to the next ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("heave_m", "velocity_mps"), [(0.3, 0.0), (0.0, -0.2), (-0.1, 0.4)])
def test_a_transfer_begins_as_the_difference_and_is_critically_damped(heave_m: float, velocity_mps: float) -> None:
    transfer = BumplessTransfer(heave_m, velocity_mps, BEAT_S)
    assert transfer.at(BEAT_S) == pytest.approx((heave_m, velocity_mps))
    h = 1e-3
    for t_s in np.linspace(BEAT_S + 0.1, BEAT_S + 10.0, 25).tolist():
        before, now, after = (transfer.at(t_s + d)[0] for d in (-h, 0.0, h))
        slope, bend = (after - before) / (2.0 * h), (after - 2.0 * now + before) / h**2
        assert transfer.at(t_s)[1] == pytest.approx(slope, abs=1e-6)
        assert bend + 2.0 * slope / TUNING.time_s + now / TUNING.time_s**2 == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize(
    ("heave_m", "velocity_mps"), [(1.0, 0.5), (-1e-3, 2e-3), (0.0, -0.3), (1e-3, -1e-3 / TUNING.time_s)]
)
def test_a_transfer_is_over_when_next_to_nothing_is_left(heave_m: float, velocity_mps: float) -> None:
    transfer = BumplessTransfer(heave_m, velocity_mps, BEAT_S)
    assert 0.0 < abs(transfer.at(transfer.until_s - 1e-6)[0]) < 1.001 * TUNING.least_m
    assert abs(transfer.at(transfer.until_s - 1.5 * TUNING.time_s)[0]) > TUNING.least_m
    assert transfer.at(transfer.until_s) == (0.0, 0.0)


@pytest.mark.parametrize("difference", [(0.0, 0.0), (0.5 * TUNING.least_m, 0.0), (nan, 0.0), (0.0, nan), (inf, 0.0)])
def test_a_difference_that_is_nothing_or_not_known_is_none(difference: tuple[float, float]) -> None:
    transfer = BumplessTransfer(*difference, BEAT_S)
    assert transfer.until_s == BEAT_S
    assert transfer.at(BEAT_S) == (0.0, 0.0)
    assert NO_TRANSFER.at(-1e9) == (0.0, 0.0)
