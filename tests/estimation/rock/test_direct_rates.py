"""The direct predictor at any rate of the samples: against slower ones, closed forms, and a table of disasters."""

from __future__ import annotations

import copy
from math import inf, nan, pi
from typing import TYPE_CHECKING

import numpy as np
import pytest
from evidence.rock.paper import ARCSEC, SCENES, motion
from numpy.typing import NDArray

from heaved.estimation.common.sample_rate import usual_interval
from heaved.estimation.rock.direct import DirectPredictor, Params

if TYPE_CHECKING:
    from collections.abc import Callable

Array = NDArray[np.float64]

TURN = 2 * pi
RATE_HZ = 100.0
HORIZONS = Params().horizons_s
SCENE = {scene.name: scene for scene in SCENES}


def measured(scene: str, duration_s: float, seed: int = 5) -> Array:
    rng = np.random.default_rng(seed)
    truth = motion(SCENE[scene], RATE_HZ, duration_s, rng)
    return truth + SCENE[scene].noise_arcsec * ARCSEC * rng.standard_normal(truth.shape)


def predict(predictor: DirectPredictor, t: Array, x: Array) -> Array:
    found = [predictor.step(moment, sample) for moment, sample in zip(t.tolist(), x.tolist(), strict=True)]
    return np.array(found)


def rms(x: Array, predicted: Array, horizon: int, start: int, every: int = 1, truth: Array | None = None) -> Array:
    """Of what came later against what was predicted, (n,)."""
    shift = round(HORIZONS[horizon] * RATE_HZ)
    error = (x if truth is None else truth)[shift:] - predicted[:-shift, horizon]
    return np.asarray(np.sqrt(np.nanmean(error[start::every] ** 2, axis=0)))


@pytest.mark.parametrize("every", [1, 5, 20])
def test_a_copy_goes_on_as_the_original_does(every: int) -> None:
    """At 100, 20 and 5 Hz, with readings missing and spikes; neither moves the other."""
    x = measured("under way, MEMS", 120.0)[::every]
    rng = np.random.default_rng(3)
    x[rng.random(x.shape) < 0.05] = nan
    x[rng.random(len(x)) < 0.01] += 0.5
    t = np.arange(len(x)) * every / RATE_HZ
    half = len(x) // 2
    original = DirectPredictor(3)
    expected = predict(DirectPredictor(3), t, x)[half:]
    predict(original, t[:half], x[:half])
    copied = copy.deepcopy(original)
    # Arrays lie in memory otherwise than those they were copied from, and sums may be rounded otherwise.
    np.testing.assert_allclose(predict(copied, t[half:], x[half:]), expected, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(predict(original, t[half:], x[half:]), expected, rtol=0.0, atol=1e-9)
    assert np.isfinite(expected).mean() > 0.9


@pytest.mark.parametrize("rate_hz", [50.0, 70.0, 100.0])
def test_deviations_are_no_less_than_the_noise_of_one_reading(rate_hz: float) -> None:
    """Also at horizons that lie between readings, where errors are those against a mean of some."""
    noise = 3.5e-4
    t = np.arange(round(90.0 * rate_hz)) / rate_hz
    motion = np.stack([0.05 * np.sin(TURN * t / period_s) for period_s in (9.0, 11.0, 13.0)], axis=-1)
    predictor = DirectPredictor(3)
    predict(predictor, t, motion + noise * np.random.default_rng(2).standard_normal(motion.shape))
    assert np.all(predictor.std[:3] > 0.92 * noise)
    assert np.all(predictor.std[:3] < 1.25 * noise)


@pytest.mark.parametrize("scene", ["under way", "under way, MEMS"])
def test_more_samples_are_no_worse_at_any_phase(scene: str) -> None:
    """Fed 100 times a second: not worse than the same predictor fed every fifth sample, where that predicts from."""
    x = measured(scene, 260.0)
    t = np.arange(len(x)) / RATE_HZ
    fast = DirectPredictor(3)
    mine = predict(fast, t, x)
    for phase in (0, 2):
        slow = predict(DirectPredictor(3), t[phase::5], x[phase::5])
        for horizon in range(5):
            shift = round(HORIZONS[horizon] * RATE_HZ)
            later = x[phase + shift :: 5][: len(slow)]
            errors = [predicted[: len(later), horizon] - later for predicted in (mine[phase::5], slow)]
            mine_rms, slow_rms = (np.sqrt(np.mean(error[3000:] ** 2, axis=0)) for error in errors)
            assert np.all(mine_rms < (1.02 if horizon < 4 else 1.1) * slow_rms), (horizon, phase, mine_rms / slow_rms)
    assert np.all((fast.coverage[:5] > 0.92) & (fast.coverage[:5] < 0.985))
    for horizon in range(4):  # what it says of itself is what came true
        steady = rms(x, mine, horizon, 15_000)
        assert np.all((fast.rms_error[horizon] > 0.9 * steady) & (fast.rms_error[horizon] < 2.0 * steady))
        # Errors were larger a minute or two ago, while it learned.
        assert np.all((fast.std[horizon] > 0.75 * steady) & (fast.std[horizon] < 1.9 * steady))


def test_lost_samples_jitter_and_spikes_cost_little() -> None:
    x = measured("under way, MEMS", 120.0)
    t = np.arange(len(x)) / RATE_HZ
    rng = np.random.default_rng(2)
    whole = predict(DirectPredictor(3), t, x)
    lost, spiked = x.copy(), x.copy()
    lost[rng.random(len(x)) < 0.1] = nan
    hit = np.flatnonzero(rng.random(len(x)) < 0.01)
    spiked[hit] += 1.0
    predictor = DirectPredictor(3)
    for name, predicted, limit in (
        ("lost", predict(DirectPredictor(3), t, lost), 1.1),
        ("spiked", predict(predictor, t, spiked), 1.1),
    ):
        for horizon in range(3):
            with_all, found = rms(x, whole, horizon, 8_000), rms(x, predicted, horizon, 8_000)
            assert np.all(found < limit * with_all), (name, horizon, found / with_all)
    assert predictor.spikes > 0.8 * 3 * np.count_nonzero(hit > 1000)
    late = t + rng.uniform(-0.002, 0.002, len(t))
    period_s = 9.0
    predicted = predict(DirectPredictor(1), late, np.sin(TURN * late / period_s)[:, None])
    after = np.sin(TURN * (late + 0.15) / period_s)
    assert np.sqrt(np.mean((predicted[4000:, 2, 0] - after[4000:]) ** 2)) < 2e-3


@pytest.mark.parametrize("jitter", ["uniform", "late"])
def test_jitter_of_half_an_interval_costs_little(jitter: str) -> None:
    """Stamps that are true, but not even: within 4 of 10 ms, or late by as much, as on a busy machine. The
    grid is that of regular samples; were it another, errors would be ten times as large.
    """
    even = np.arange(15_000) / RATE_HZ
    rng = np.random.default_rng(6)
    off = rng.uniform(-0.004, 0.004, len(even)) if jitter == "uniform" else 0.004 * abs(rng.standard_normal(len(even)))
    f, phase = np.linspace(0.06, 0.2, 40), rng.uniform(0.0, TURN, 40)
    a = np.exp(-0.5 * ((f - 0.1) / 0.02) ** 2)

    def roll(t: Array) -> Array:
        return np.asarray((a * np.cos(TURN * f * t[:, None] + phase)).sum(axis=1) / np.sqrt(0.5 * (a**2).sum()))

    found = []
    for t in (even, np.sort(even + off)):
        x = roll(t) + 1e-3 * rng.standard_normal(len(t))
        predictor = DirectPredictor(1)
        predicted = predict(predictor, t, x[:, None])[:, :, 0]
        assert predictor.restarts == 0
        late = t > 60.0
        found.append([rms_of(predicted[late, h] - roll(t[late] + HORIZONS[h])) for h in range(5)])
    regular, jittered = np.array(found)
    assert np.all(jittered[:3] < 3.0 * regular[:3]), jittered / regular
    assert np.all(jittered[3:] < 1.5 * regular[3:]), jittered / regular
    assert np.all(jittered[:3] < 1e-3)


def rms_of(error: Array) -> float:
    return float(np.sqrt(np.nanmean(error**2)))


def test_rows_that_are_not_there_at_all_cost_little() -> None:
    x = measured("under way, MEMS", 120.0)
    t = np.arange(len(x)) / RATE_HZ
    keep = np.random.default_rng(3).random(len(x)) > 0.2
    keep[9000:9030] = False
    predicted = np.full((len(x), len(HORIZONS), 3), nan)
    predicted[keep] = predict(DirectPredictor(3), t[keep], x[keep])
    whole = predict(DirectPredictor(3), t, x)
    whole[~keep] = nan
    for horizon in range(3):
        assert np.all(rms(x, predicted, horizon, 8_000) < 1.15 * rms(x, whole, horizon, 8_000))


def test_after_a_gap_and_a_clock_set_back_it_begins_anew() -> None:
    t = np.arange(6000) / RATE_HZ
    x = np.sin(TURN * t / 8)[:, None]
    predictor = DirectPredictor(1)
    predict(predictor, t, x)
    assert np.isfinite(predictor.values).all()
    assert np.isnan(predictor.step(t[-1] + 30.0, [0.0])).all()
    again = predict(predictor, t[-1] + 30.0 + t[1:400], x[1:400])
    assert np.isfinite(again[-1]).all()
    for _ in range(25):
        predictor.step(1.0, [0.0])
    assert predictor.restarts == 1
    assert np.isnan(predictor.values).all()
    back = predict(predictor, 2.0 + t, x)
    assert np.max(np.abs(back[3000:, 2, 0] - np.sin(TURN * (t[3000:] + 0.15) / 8))) < 1e-4


def test_another_rate_begins_anew() -> None:
    predictor = DirectPredictor(1)
    t = np.concatenate([np.arange(3000) / 100.0, 30.0 + np.arange(3000) / 50.0])
    predicted = predict(predictor, t, np.sin(TURN * t / 8)[:, None])
    assert predictor.restarts == 1
    assert np.max(np.abs(predicted[-500:, 2, 0] - np.sin(TURN * (t[-500:] + 0.15) / 8))) < 1e-4


def busy(rate_hz: float, duration_s: float, seed: int, tick_s: float = 0.004) -> Array:
    """Stamps on a machine that is busy: a poll waits for the next tick of the scheduler, or the one after that, and now
    and then for a stall of 20-50 ms, in which the other deadlines are skipped.
    """
    rng = np.random.default_rng(seed)
    due = np.arange(round(duration_s * rate_hz)) / rate_hz
    ticks = np.floor((due + rng.uniform(0.0, tick_s)) / tick_s) + 1.0 + (rng.random(len(due)) < 0.3)
    t = tick_s * ticks + rng.exponential(3e-4, len(due))
    taken = np.ones(len(due), dtype=bool)
    stall_s = 0.05
    while stall_s < duration_s:
        end_s = stall_s + rng.uniform(0.02, 0.05)
        inside = np.flatnonzero((due >= stall_s) & (due < end_s))
        t[inside[:1]] = end_s
        taken[inside[1:]] = False
        stall_s = end_s + rng.exponential(0.2 if stall_s < 2.0 else 1.0)
    t = np.maximum.accumulate(t[taken])
    return t[np.diff(t, prepend=-1.0) > 0.0]


@pytest.mark.parametrize("rate_hz", [100.0, 50.0, 20.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_polls_that_are_held_up_are_no_other_rate(rate_hz: float, seed: int) -> None:
    """And the time axis stays: what is predicted for a moment is what the wave is then."""
    t = busy(rate_hz, 40.0, seed)
    assert np.diff(t).max() > 1.9 / rate_hz or rate_hz == 20.0
    predictor = DirectPredictor(1)
    predicted = predict(predictor, t, np.sin(TURN * t / 8)[:, None])[:, 2, 0]
    assert predictor.restarts == 0
    known = t > 2.2
    error = (predicted - np.sin(TURN * (t + 0.15) / 8))[known]
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error**2)) < 0.01 * np.sqrt(0.5)  # of the wave; half a millisecond would be 0.0004


def free(due: Array, lateness_s: Array, rate_hz: float) -> Array:
    """Each poll is as late as it is."""
    return np.maximum.accumulate(due + lateness_s)


def skipping(due: Array, lateness_s: Array, rate_hz: float) -> Array:
    """Deadlines that have passed meanwhile are skipped."""
    stamps, k = [], 0
    while k < len(due):
        stamps.append(due[k] + lateness_s[k])
        k = max(k + 1, int(np.ceil(stamps[-1] * rate_hz)))
    return np.array(stamps)


def queued(due: Array, lateness_s: Array, rate_hz: float) -> Array:
    """Each poll waits for the one before."""
    stamps = [0.0]
    for moment, late_s in zip(due.tolist(), lateness_s.tolist(), strict=True):
        stamps.append(max(moment, stamps[-1]) + 4e-3 + late_s)
    return np.array(stamps[1:])


def late_polls(kind: Callable[[Array, Array, float], Array], rate_hz: float, duration_s: float, seed: int) -> Array:
    """Stamps on a busy line: 30 % of the polls 10-40 ms late, all of them by some milliseconds of jitter."""
    rng = np.random.default_rng(seed)
    due = np.arange(round(duration_s * rate_hz)) / rate_hz
    lateness_s = np.where(rng.random(len(due)) < 0.3, rng.uniform(0.01, 0.04, len(due)), 0.0)
    t = kind(due, lateness_s + 2e-3 * np.abs(rng.standard_normal(len(due))), rate_hz)
    return t[np.diff(t, prepend=-1.0) > 0.0]


@pytest.mark.parametrize("kind", [free, skipping, queued])
@pytest.mark.parametrize("rate_hz", [10.0, 20.0, 33.0, 50.0])
@pytest.mark.parametrize("seed", [2, 3])
def test_a_third_of_the_polls_late_is_no_other_rate(
    kind: Callable[[Array, Array, float], Array], rate_hz: float, seed: int
) -> None:
    t = late_polls(kind, rate_hz, 40.0, seed)
    predictor = DirectPredictor(1)
    predicted = predict(predictor, t, np.sin(TURN * t / 8)[:, None])[:, 2, 0]
    assert predictor.restarts <= 2 * (rate_hz == 33.0)  # which the first seconds may not show yet
    error = (predicted - np.sin(TURN * (t + 0.15) / 8))[t > 10.0]
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(0.5)


def overloaded(rate_hz: float, duration_s: float, seed: int) -> Array:
    """Stamps of a machine that does not keep up from 20 to 40 s: each poll waits its turn, deadlines that have passed
    meanwhile are skipped, and what is left lies on no grid.
    """
    rng = np.random.default_rng(seed)
    stamps, due = [], 0.0
    while due < duration_s:
        stamps.append(due + (rng.exponential(8e-3) if 20.0 <= due < 40.0 else 0.0))
        due = (np.floor((stamps[-1] + 1e-3) * rate_hz) + 1.0) / rate_hz
    return np.array(stamps)


@pytest.mark.parametrize("seed", range(4))
def test_a_machine_that_does_not_keep_up_polls_at_no_other_rate(seed: int) -> None:
    t = overloaded(100.0, 50.0, seed)
    busy = t[(t > 22.0) & (t < 38.0)]
    assert abs(np.exp(1j * TURN * busy * 100.0).mean()) < 0.3
    assert len(busy) < 0.8 * 16.0 * 100.0
    predictor = DirectPredictor(1)
    predicted = predict(predictor, t, np.sin(TURN * t / 8)[:, None])[:, 2, 0]
    assert predictor.restarts == 0
    error = (predicted - np.sin(TURN * (t + 0.15) / 8))[t > 2.2]
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(0.5)


@pytest.mark.parametrize("share", [0.6, 0.75])
def test_samples_that_get_lost_are_no_other_rate(share: float) -> None:
    t = np.arange(7500) / 100.0
    t = t[(np.random.default_rng(3).random(len(t)) > share) | (t < 50.0)]
    predictor = DirectPredictor(1)
    predicted = predict(predictor, t, np.sin(TURN * t / 8)[:, None])[:, 2, 0]
    assert predictor.restarts == 0
    error = (predicted - np.sin(TURN * (t + 0.15) / 8))[t > 50.0]
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(0.5)


def test_samples_that_come_at_random_after_a_while_are_another_rate() -> None:
    rng = np.random.default_rng(1)
    t = np.concatenate([np.arange(0.0, 20.0, 0.01), 20.0 + np.cumsum(rng.exponential(0.02, 2500))])
    predictor = DirectPredictor(1)
    noticed_s: list[float] = []
    for moment in t[np.diff(t, prepend=-1.0) > 0.0].tolist():
        predictor.step(moment, [np.sin(TURN * moment / 8)])
        if predictor.restarts > len(noticed_s):
            noticed_s.append(moment)
    assert len(noticed_s) == 1
    assert 40.0 < noticed_s[0] < 60.0


@pytest.mark.parametrize(("kind", "rate_hz"), [(free, 20.0), (skipping, 20.0), (skipping, 50.0), (queued, 33.0)])
def test_the_usual_interval_where_a_third_of_the_polls_is_late(
    kind: Callable[[Array, Array, float], Array], rate_hz: float
) -> None:
    """Of 5 s, as others look at them."""
    t = late_polls(kind, rate_hz, 60.0, 4)
    found = [usual_interval(t[(t >= begin) & (t < begin + 5.0)]) for begin in np.arange(0.0, 55.0, 2.5)]
    np.testing.assert_allclose(found, 1.0 / rate_hz, rtol=0.01)


@pytest.mark.parametrize(("before_hz", "after_hz"), [(20.0, 10.0), (10.0, 20.0), (100.0, 50.0), (50.0, 100.0)])
def test_another_rate_is_noticed_among_held_up_polls(before_hz: float, after_hz: float) -> None:
    t = np.concatenate([busy(before_hz, 20.0, 3), 20.1 + busy(after_hz, 20.0, 4)])
    predictor = DirectPredictor(1)
    predicted: list[Array] = []
    noticed_s: list[float] = []
    for moment in t.tolist():
        predicted.append(predictor.step(moment, [np.sin(TURN * moment / 8)])[2, 0])
        if predictor.restarts > len(noticed_s):
            noticed_s.append(moment)
    assert len(noticed_s) == 1
    assert 20.0 < noticed_s[0] < 23.5
    late = t > noticed_s[0] + 3.0
    error = np.array(predicted)[late] - np.sin(TURN * (t[late] + 0.15) / 8)
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error**2)) < 0.01 * np.sqrt(0.5)


@pytest.mark.parametrize("seed", range(4))
def test_the_usual_interval_among_held_up_polls(seed: int) -> None:
    """Never off by half of what would be another rate, and hardly ever by more than the clock's loop follows."""
    t = busy(100.0, 30.0, seed)
    found = np.array([usual_interval(t[begin : begin + 76]) for begin in range(0, len(t) - 80, 40)])
    assert np.median(np.abs(found - 0.01)) < 0.01 * 0.01
    assert np.max(np.abs(found - 0.01)) < 0.1 * 0.01


@pytest.mark.parametrize("value", [nan, inf, 0.0, 1e6])
def test_whatever_is_fed_nothing_breaks(value: float) -> None:
    predictor = DirectPredictor(2)
    rng = np.random.default_rng(1)
    x = 0.01 * rng.standard_normal((3000, 2))
    x[1000:1100, 0] = value
    predicted = predict(predictor, np.arange(3000) / RATE_HZ, x)
    assert np.isfinite(predicted[400:, :, 1]).all()
    assert np.all(np.abs(predicted[400:, :, 1]) < 1.0)
    assert np.isfinite(predicted[-1]).all()
    assert value == 1e6 or np.all(np.abs(predicted[-1]) < 1.0)


def test_an_axis_that_is_missing_does_not_touch_the_others() -> None:
    t = np.arange(4000) / RATE_HZ
    x = np.stack([np.sin(TURN * t / 9), np.cos(TURN * t / 7), np.sin(TURN * t / 11)], axis=1)
    lame = x.copy()
    lame[:, 1] = nan
    whole, without = predict(DirectPredictor(3), t, x), predict(DirectPredictor(3), t, lame)
    assert np.isnan(without[:, :, 1]).all()
    np.testing.assert_allclose(without[:, :, [0, 2]], whole[:, :, [0, 2]], rtol=0, atol=1e-9)


@pytest.mark.parametrize("rate_hz", [10.0, 20.0, 100.0])
def test_between_samples_the_curve_is_followed(rate_hz: float) -> None:
    t = np.arange(round(60 * rate_hz)) / rate_hz
    predictor = DirectPredictor(1)
    predict(predictor, t, np.sin(TURN * t / 8)[:, None])
    for after_s in (0.0, 0.004, 0.04, 0.3):
        moment = t[-1] + after_s
        found = predictor.at(moment)[:4, 0]
        expected = np.sin(TURN * (moment + np.array(HORIZONS[:4])) / 8)
        assert np.max(np.abs(found - expected)) < 2e-3, after_s
    assert np.isnan(predictor.at(t[-1] + 3.0)).all()
    assert np.isnan(predictor.at(t[-1] - 1.0)).all()


def test_what_is_scored_has_come_true_though_the_rate_was_first_taken_for_another() -> None:
    """The first seconds come 3 % too slowly: later on more samples lie within a horizon than there seemed to."""
    gaps_s = np.where(np.arange(20_000) < 250, 0.0103, 0.01)
    t = np.cumsum(gaps_s)
    rng = np.random.default_rng(8)
    x = np.sin(TURN * t / 7.3) + 0.5 * np.sin(TURN * t / 9.1) + 1e-3 * rng.standard_normal(len(t))
    predictor = DirectPredictor(1)
    predicted = predict(predictor, t, x[:, None])
    assert predictor.restarts == 0
    for horizon in range(len(HORIZONS)):
        steady = rms(x[:, None], predicted, horizon, 14_000)[0]
        assert 0.75 * steady < predictor.std[horizon, 0] < 1.5 * steady, horizon  # few of 5 s there are in 200 s
