"""The sea observer against the truth, the causal limit of its seas, and what can come between.

Sensor A, no tilt, 20 Hz; seeds of waves, noise and start are those of the accuracy tool. Bounds are what is asked for.
"""

from __future__ import annotations

from functools import cache
from math import isfinite, isnan, nan, sqrt
from typing import NamedTuple

import msgspec
import numpy as np
import pytest
from evidence.scenarios import HORIZONS_S, Case, Setting, build, sea_limits, triplet
from seas import model as some_model

from heaved.estimation.heave.observer import SavedObserver
from heaved.estimation.heave.params import SeaParams
from heaved.estimation.heave.sea.model import SeaSystem
from heaved.estimation.heave.sea.observer import TUNING, SeaObserver
from heaved.estimation.heave.sea.refit import SeaFit, SeaWindow, look
from heaved.samples import GRAVITY_MPS2
from heaved.simulate.seaway import seaway

Array = np.ndarray
SMALL = SeaParams(stages=6, components=2, windows_s=(120.0, 300.0), delay_s=30.0)
"""For what is no matter of the last per cent."""


class Result(NamedTuple):
    case: Case
    heave_m: Array
    """(n, 5): now and at the horizons."""
    std_m: Array
    velocity_mps: Array
    delayed: Array
    """(k, 3): time, heave, standard deviation."""
    fitted_s: tuple[float, ...]
    observer: SeaObserver


@cache
def result(name: str, duration_s: float) -> Result:
    """A cold start, every fit at once."""
    case = build(name, triplet(1), Setting(tilt="none", duration_s=duration_s))
    observer = SeaObserver(SeaParams(), HORIZONS_S)
    heave, std, velocity, delayed, fitted = [], [], [], {}, []
    acceleration = case.recording.az_mps2 - GRAVITY_MPS2
    for t, a in zip(case.recording.t_s.tolist(), acceleration.tolist(), strict=True):
        observer.step(t, a)
        if (past := observer.due()) is not None:
            assert observer.accept(look(past)) == "accepted"
            fitted.append(t)
        motions = [observer.at(shift_s) for shift_s in (0.0, *HORIZONS_S)]
        heave.append([motion.heave_m for motion in motions])
        velocity.append(motions[0].velocity_mps)
        std.append([observer.error_std_m(shift) for shift in (0.0, *HORIZONS_S)])
        if (found := observer.delayed) is not None:
            delayed[found.t_s] = (found.t_s, found.heave_m, found.std_m)
    return Result(
        case,
        np.array(heave),
        np.array(std),
        np.array(velocity),
        np.array(list(delayed.values())),
        tuple(fitted),
        observer,
    )


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


IRREGULAR = {"S4": (600.0, 1.25), "S6": (600.0, 1.25), "S6S": (700.0, 1.25), "SL": (700.0, 1.4)}


@pytest.mark.parametrize("name", IRREGULAR)
def test_heave_is_near_the_causal_limit_and_its_std_is_true(name: str) -> None:
    duration_s, ratio = IRREGULAR[name]
    r = result(name, duration_s)
    scored = r.case.scored
    error = (r.heave_m[:, 0] - r.case.recording.truth.heave_m)[scored]
    assert rms(error) <= ratio * r.case.limits.causal_m
    assert 0.90 <= np.mean(np.abs(error) < 1.96 * r.std_m[scored, 0]) <= 0.995


@pytest.mark.parametrize("name", ["S4", "S6", "S6S"])
@pytest.mark.parametrize(("column", "ratio"), [(1, 1.5), (2, 1.5), (3, 1.6), (4, 1.4)])
def test_forecasts_are_near_theirs_and_so_are_their_stds(name: str, column: int, ratio: float) -> None:
    r = result(name, IRREGULAR[name][0])
    horizon_s = HORIZONS_S[column - 1]
    ahead = round(horizon_s * 20.0)
    truth = r.case.recording.truth.heave_m
    made = np.flatnonzero(r.case.scored)
    made = made[made + ahead < len(truth)]
    error = r.heave_m[made, column] - truth[made + ahead]
    assert rms(error) <= ratio * r.case.limits.forecast_m[horizon_s]
    assert 0.90 <= np.mean(np.abs(error) < 1.96 * r.std_m[made, column]) <= 0.995


@pytest.mark.parametrize("name", ["S4", "S6", "S6S"])
def test_delayed_heave_is_right_to_a_few_thousandths(name: str) -> None:
    r = result(name, IRREGULAR[name][0])
    truth = r.case.recording.truth.heave_m
    late = r.delayed[r.delayed[:, 0] >= r.case.start_s]
    error = late[:, 1] - np.interp(late[:, 0], r.case.recording.t_s, truth)
    assert len(late) > 4000
    assert rms(error) <= 0.006 * np.std(truth)
    assert rms(error) < 0.5 * rms((r.heave_m[:, 0] - truth)[r.case.scored])
    assert np.mean(np.abs(error) < 1.96 * late[:, 2]) >= 0.85
    assert r.case.recording.t_s[-1] - r.delayed[-1, 0] == pytest.approx(60.0, abs=0.3)


@pytest.mark.parametrize(("name", "asked_m"), [("T1", 0.0010), ("T2", 0.0012), ("T3", 0.0020)])
def test_wave_trains_are_right_to_a_millimetre_or_two(name: str, asked_m: float) -> None:
    r = result(name, 500.0)
    error = (r.heave_m[:, 0] - r.case.recording.truth.heave_m)[r.case.scored]
    assert rms(error) <= asked_m
    assert np.mean(np.abs(error) < 1.96 * r.std_m[r.case.scored, 0]) >= 0.90


@pytest.mark.parametrize("name", ["S4", "S6"])
def test_it_settles_within_a_minute(name: str) -> None:
    """The first heave after 40 s; 6 % of the standard deviation from the 60th second on, over 10 s each."""
    r = result(name, IRREGULAR[name][0])
    t, truth = r.case.recording.t_s, r.case.recording.truth.heave_m
    known = np.isfinite(r.heave_m[:, 0])
    assert t[np.argmax(known)] == pytest.approx(40.0, abs=0.2)
    assert known[np.argmax(known) :].all()
    for start_s in range(60, 300, 10):
        inside = (t >= start_s) & (t < start_s + 10.0)
        assert rms((r.heave_m[:, 0] - truth)[inside]) <= 0.06 * np.std(truth)


@pytest.mark.parametrize("name", ["S4", "S6", "SL"])
def test_a_new_model_takes_over_without_a_jump(name: str) -> None:
    """From sample to sample the heave is the integral of its velocity, at a fit as in the second before it; what
    is left is what each sample teaches, at first more than later.
    """
    r = result(name, IRREGULAR[name][0])
    heave, velocity, t = r.heave_m[:, 0], r.velocity_mps, r.case.recording.t_s
    jump = np.abs(np.diff(heave) - 0.05 * 0.5 * (velocity[1:] + velocity[:-1]))
    assert len(r.fitted_s) > 20
    sigma = float(np.std(r.case.recording.truth.heave_m))
    for fit in np.flatnonzero(np.isin(t[1:], np.array(r.fitted_s)) & np.isfinite(jump)).tolist():
        usual = jump[max(fit - 20, 0) : fit]
        assert jump[fit] < 3.0 * np.nanmax(usual, initial=0.0) + 0.002 * sigma
        assert t[fit] < 120.0 or jump[fit] < 0.02 * sigma


def test_the_height_of_the_sea_is_published() -> None:
    r = result("S6", 600.0)
    sea = r.observer.sea
    assert sea is not None
    t = r.case.recording.t_s
    seen = (t > sea.t_s - sea.window_s) & (t <= sea.t_s)
    truth = r.case.recording.truth.heave_m[seen]
    assert sea.significant_height_m == pytest.approx(4.0 * np.std(truth), rel=0.25)
    assert sea.peak_period_s == pytest.approx(8.2, abs=1.5)
    assert not sea.is_still
    assert r.observer.doubts == ()


# --- rates -----------------------------------------------------------------------------------------------------------


def samples(name: str, seconds: float, rate_hz: float = 20.0, seed: int = 1) -> tuple[Array, Array, Array]:
    """Times, heave, and acceleration with the white noise of sensor A."""
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    motion = seaway(name, seed, attitude=False, start_s=50.0).motion(t)
    noise = 1e-3 * np.sqrt(rate_hz / 2.0) * np.random.default_rng(seed).standard_normal(len(t))
    return t, motion.heave_m, motion.heave_acceleration_mps2 + noise + 0.03


def feed(observer: SeaObserver, t: Array, a: Array, late_s: float = 0.0) -> Array:
    """Heave after each sample; each fit is answered ``late_s`` later."""
    heave = np.full(len(t), nan)
    waiting: list[tuple[float, SeaFit]] = []
    for i, (at, value) in enumerate(zip(t.tolist(), a.tolist(), strict=True)):
        observer.step(at, value)
        if (past := observer.due()) is not None:
            waiting.append((at + late_s, look(past)))
        while waiting and at >= waiting[0][0]:
            assert observer.accept(waiting.pop(0)[1]) == "accepted"
        heave[i] = observer.at(0.0).heave_m
    return heave


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 20.0, 50.0, 100.0, 200.0])
def test_the_rate_of_the_sensor_makes_no_difference(rate_hz: float) -> None:
    """The noise has the same density: so has what it costs, and what is published between the beats is as good."""
    t, truth, a = samples("S6", 260.0, rate_hz)
    heave = feed(SeaObserver(SMALL, ()), t, a)
    scored = t > 130.0
    assert rms((heave - truth)[scored]) < 1.7 * sea_limits("S6", "A", 20.0).causal_m
    steps = np.abs(np.diff(heave[scored]))
    assert np.max(steps) < 1.3 * np.max(np.abs(np.diff(truth))) + 0.005


def test_readings_that_come_unevenly_cost_little() -> None:
    """Jitter of a fifth of the interval, one in twenty lost."""
    rng = np.random.default_rng(8)
    t, _, a = samples("S6", 260.0, 20.0)
    noise = a - 0.03 - seaway("S6", 1, attitude=False, start_s=50.0).motion(t).heave_acceleration_mps2
    t = np.sort(t + rng.uniform(-0.01, 0.01, len(t)))
    motion = seaway("S6", 1, attitude=False, start_s=50.0).motion(t)
    kept = rng.random(len(t)) > 0.05
    heave = feed(SeaObserver(SMALL, ()), t[kept], (motion.heave_acceleration_mps2 + noise)[kept])
    error = (heave - motion.heave_m[kept])[t[kept] > 130.0]
    assert rms(error) < 2.0 * sea_limits("S6", "A", 20.0).causal_m


def test_a_third_of_the_readings_lost_costs_little_at_a_high_rate() -> None:
    t, truth, a = samples("S6", 260.0, 100.0)
    kept = np.random.default_rng(9).random(len(t)) > 1 / 3
    observer = SeaObserver(SMALL, ())
    heave = feed(observer, t[kept], a[kept])
    assert rms((heave - truth[kept])[t[kept] > 130.0]) < 1.7 * sea_limits("S6", "A", 20.0).causal_m
    assert observer.refreshes > 5


# --- fits that are late, stale, wrong --------------------------------------------------------------------------------


@pytest.mark.parametrize("late_s", [1.0, 5.0])
def test_a_late_fit_is_as_good_as_one_at_once(late_s: float) -> None:
    t, truth, a = samples("S6", 260.0)
    at_once, late = feed(SeaObserver(SMALL, ()), t, a), feed(SeaObserver(SMALL, ()), t, a, late_s)
    scored = t > 130.0
    assert rms((late - truth)[scored]) < 1.2 * rms((at_once - truth)[scored])
    assert np.max(np.abs(np.diff(late[scored]))) < 1.3 * np.max(np.abs(np.diff(truth)))


def warm(seconds: float = 150.0, name: str = "S5") -> tuple[SeaObserver, Array, Array, Array]:
    """An observer after that many seconds, and the whole of its record, 200 s longer."""
    t, truth, a = samples(name, seconds + 200.0)
    observer = SeaObserver(SMALL, (1.0,))
    count = round(seconds * 20.0)
    feed(observer, t[:count], a[:count])
    return observer, t, truth, a


def ask(observer: SeaObserver, t: Array, a: Array, begin: int) -> tuple[SeaWindow, int]:
    """The next request, and the place of the sample after it."""
    for i in range(begin, len(t)):
        observer.step(float(t[i]), float(a[i]))
        if (past := observer.due()) is not None:
            return past, i + 1
    raise AssertionError("nothing was asked for")


def test_a_stale_answer_is_rejected_and_a_failed_one_changes_nothing() -> None:
    observer, t, truth, a = warm()
    kept = observer.model
    first, i = ask(observer, t, a, 3000)
    second, i = ask(observer, t, a, i)
    assert second.number > first.number
    before = observer.at(0.0)
    assert observer.accept(look(first)) == "rejected"
    assert observer.accept(SeaFit(number=second.number, message="it did not converge")) == "failed"
    assert observer.model == kept
    assert observer.at(0.0) == before
    answer = look(second)
    assert observer.accept(answer) == "accepted"
    assert observer.accept(answer) == "rejected"
    heave = feed(observer, t[i:], a[i:])
    assert rms((heave - truth[i:])[-400:]) < 0.05 * np.std(truth)


def test_an_answer_from_before_a_reset_is_rejected() -> None:
    observer, t, _, a = warm()
    past, i = ask(observer, t, a, 3000)
    observer.step(float(t[i]) + 100.0, 0.0)
    assert observer.resets == {"gap": 1}
    assert observer.accept(look(past)) == "rejected"


# --- restart, gaps, readings that are none ---------------------------------------------------------------------------


def test_a_restart_gives_heave_in_ten_seconds_and_knows_how_little_it_knows() -> None:
    before, t, truth, a = warm()
    assert before.model is not None
    restored = SeaObserver(SMALL, (1.0,))
    assert isnan(restored.at(0.0).heave_m)
    restored.restore(before.saved(), 60.0)
    heave, std = [], []
    for at, value in zip(t[3000:6000].tolist(), a[3000:6000].tolist(), strict=True):
        restored.step(at, value)
        heave.append(restored.at(0.0).heave_m)
        std.append(restored.error_std_m(0.0))
    error = np.abs(np.array(heave) - truth[3000:6000])
    std_m = np.array(std)
    sigma = float(np.std(truth))
    assert np.isnan(error[:200]).all()
    assert np.isfinite(error[208:]).all()  # seven intervals tell the usual one
    assert std_m[1200] < 0.15 * sigma
    for part in (slice(208, 600), slice(600, 1800), slice(1800, 3000)):
        assert np.mean(error[part] < 1.96 * std_m[part]) >= 0.85
    assert rms(error[2000:]) < 0.05 * sigma


@pytest.mark.parametrize("changed_mps2", [0.0, 0.02, -0.05])
def test_the_bias_of_before_brings_the_heave_back_unless_the_sensor_is_another(changed_mps2: float) -> None:
    before, t, truth, a = warm()
    saved = before.saved()
    assert saved.bias_mps2 is not None
    for start in (3000, 3170, 3330):
        restored, without = SeaObserver(SMALL, ()), SeaObserver(SMALL, ())
        restored.restore(saved, 60.0)
        without.restore(SavedObserver(sea=saved.sea), 60.0)
        worst = 0.0
        for i in range(start, start + 800):
            restored.step(float(t[i]), float(a[i]) + changed_mps2)
            without.step(float(t[i]), float(a[i]) + changed_mps2)
            std_m = restored.error_std_m(0.0)
            if isfinite(std_m):
                worst = max(worst, abs(restored.at(0.0).heave_m - truth[i]) / std_m)
            if i == start + 210 and changed_mps2 == 0.0:
                assert restored.settled_s >= restored.needed_s
                assert std_m < 0.9 * without.error_std_m(0.0)
        if changed_mps2 == -0.05:
            assert restored.needed_s == without.needed_s
        assert worst < 4.0


def test_a_model_of_another_configuration_is_refused() -> None:
    observer = SeaObserver(SMALL, ())
    with pytest.raises(ValueError, match="does not fit"):
        observer.restore(SavedObserver(sea=some_model(8, 2)))
    with pytest.raises(ValueError, match="does not"):
        observer.restore(SavedObserver(sea=msgspec.structs.replace(some_model(6, 2), level_m2phz=(nan, 1.0))))
    assert observer.model is None


def test_a_gap_is_owned_up_to_and_recovered_from() -> None:
    """Ten seconds: the standard deviation grows to that of a forecast so far ahead, and comes down with the error."""
    observer, t, truth, a = warm()
    calm = observer.error_std_m(0.0)
    ahead = [observer.error_std_m(shift) for shift in (0.5, 1.0, 2.0)]
    assert calm < ahead[0] < ahead[1] < ahead[2]
    begin = 3000 + 200
    rest = slice(begin, begin + 1600)
    heave, std = np.empty(1600), np.empty(1600)
    for i, (at, value) in enumerate(zip(t[rest].tolist(), a[rest].tolist(), strict=True)):
        observer.step(at, value)
        if (past := observer.due()) is not None:
            observer.accept(look(past))
        heave[i], std[i] = observer.at(0.0).heave_m, observer.error_std_m(0.0)
        if i == 20:
            assert "recovering from a gap" in observer.doubts
    error = np.abs(heave - truth[rest])
    assert std[0] > 10.0 * calm
    assert np.mean(error[:200] < 1.96 * std[:200]) > 0.85
    assert std[-1] < 2.0 * calm
    assert rms(error[800:]) < 0.05 * np.std(truth)
    assert observer.resets == {}
    assert "recovering from a gap" not in observer.doubts


def test_after_a_longer_gap_the_past_is_forgotten_and_the_model_is_not() -> None:
    observer, t, truth, a = warm()
    kept = observer.model
    feed(observer, t[3000:3001] + 61.0, a[3000:3001])
    assert observer.resets == {"gap": 1}
    assert observer.settled_s == 0.0
    assert observer.model == kept
    heave = feed(observer, t[3001:] + 61.0, a[3001:])
    assert np.isnan(heave[:195]).all()
    assert np.isfinite(heave[208:]).all()
    assert rms((heave - truth[3001:])[-1000:]) < 0.05 * np.std(truth)


def test_missing_readings_are_passed_over() -> None:
    observer, t, truth, _ = warm()
    for at in t[3000:3010].tolist():
        observer.step(at, nan)
        assert observer.t_s == t[2999]
    assert observer.at(float(t[3009] - t[2999])).heave_m == pytest.approx(truth[3009], abs=0.1 * np.std(truth))


def test_the_published_std_is_the_modelled_one_and_a_margin() -> None:
    """While innovations and the delayed heave have nothing to say against it."""
    observer, *_ = warm()
    assert observer.model is not None
    modelled = observer.error_std_m(0.0) / TUNING.overconfidence
    system = SeaSystem(observer.model)
    steady = system.steady(0.05)
    assert steady is not None
    P = steady.P - np.outer(steady.K, steady.K) * steady.S
    assert modelled == pytest.approx(np.sqrt(system.heave @ P @ system.heave), rel=0.6)
    assert observer.error_std_m(0.0, 2.0) == pytest.approx(2.0 * observer.error_std_m(0.0))


def test_a_still_ship_is_still() -> None:
    """Sensor A at rest: no waves are seen, and what is published stays within a few millimetres."""
    rng = np.random.default_rng(3)
    t = np.arange(4800) / 20.0
    a = 1e-3 * np.sqrt(10.0) * rng.standard_normal(4800) + 0.02
    observer = SeaObserver(SMALL, ())
    heave = feed(observer, t, a)
    assert rms(heave[2400:]) < 0.005
    assert observer.sea is not None
    assert observer.sea.is_still
    assert observer.notes != ()
    assert isfinite(observer.error_std_m(0.0))


@cache
def _with_angles(channels: str, *, are_of_this_sea: bool = True, one_is_missing_in: int = 10**9) -> Array:
    """In a swell, with a noisy accelerometer; pitch follows from the heave, or from that of another sea. (n, 5) errors
    of the heave now and 1 s ahead, their standard deviations, and how much of what the angles tell is in them.
    """
    t = np.linspace(0.0, 330.0, 3301)
    sea = seaway("SL", 1, attitude=False)
    motion, other = sea.motion(t), seaway("SL", 2, attitude=False).motion(t)
    noise = np.random.default_rng(3).normal(size=(2, len(t)))
    a = motion.heave_acceleration_mps2 + 4e-3 * sqrt(5.0) * noise[0]
    pitch = 0.02 * (motion if are_of_this_sea else other).heave_velocity_mps + 0.003 * other.heave_m + 3e-4 * noise[1]
    observer = SeaObserver(msgspec.structs.replace(SMALL, channels=channels), (1.0,))
    said = []
    for i, (at, a_mps2, pitch_rad) in enumerate(zip(t.tolist(), a.tolist(), pitch.tolist(), strict=True), 1):
        if i % one_is_missing_in:
            observer.step(at, a_mps2, 0.01, pitch_rad)
        if (past := observer.due()) is not None:
            assert observer.accept(look(past)) == "accepted"
        (ahead,) = observer.forecast(0.0)
        errors = observer.at(0.0).heave_m - sea.at(at).heave_m, ahead.heave_m - sea.at(at + 1.0).heave_m
        said.append((*errors, observer.error_std_m(0.0), ahead.std_m, observer.roll_pitch.weight))
    return np.array(said)[-700:]


def test_pitch_makes_the_heave_better_where_it_is_of_the_same_waves() -> None:
    alone, joint = _with_angles("single"), _with_angles("auto")
    assert np.all(alone[:, 4] == 0.0)
    assert np.mean(joint[:, 4]) > 0.5
    for k in (0, 1):
        assert np.std(joint[:, k]) < 0.9 * np.std(alone[:, k])
        assert np.mean(joint[:, 2 + k]) < 0.95 * np.mean(alone[:, 2 + k])
        assert np.mean(np.abs(joint[:, k]) < 1.96 * joint[:, 2 + k]) > 0.9


def test_a_reading_that_is_missing_now_and_then_takes_little_of_that() -> None:
    """One in a hundred, every ten seconds."""
    alone, joint = _with_angles("single"), _with_angles("auto", one_is_missing_in=100)
    assert np.mean(joint[:, 4]) > 0.5
    assert np.std(joint[:, 0]) < 0.9 * np.std(alone[:, 0])
    assert np.mean(np.abs(joint[:, 0]) < 1.96 * joint[:, 2]) > 0.9


def test_pitch_of_other_waves_changes_nothing() -> None:
    assert np.array_equal(_with_angles("auto", are_of_this_sea=False), _with_angles("single"))
