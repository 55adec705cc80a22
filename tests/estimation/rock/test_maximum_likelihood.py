"""The rock predictor: against closed forms, an independent least squares, and what a user must never see."""

from __future__ import annotations

from math import isnan, nan, pi
from typing import TYPE_CHECKING, Literal

import msgspec
import numpy as np
import numpy.typing as npt
import pytest
from numpy.typing import NDArray

from heaved.estimation.rock.maximum_likelihood import MaximumLikelihoodPredictor, regression, seen_later
from heaved.estimation.rock.params import STANDARD_HORIZONS_S, Params
from heaved.samples import RockPrediction

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

Mode = Literal["endpoint", "zero"]

Array = NDArray[np.float64]

TURN = 2 * pi


def run(t: npt.ArrayLike, angles: npt.ArrayLike, params: Params | None = None) -> tuple[Array, Array]:
    """Feed (n, 3) angles; values and deviations, each (n, horizons, 3)."""
    predictor = MaximumLikelihoodPredictor(params if params is not None else Params(horizons_s=STANDARD_HORIZONS_S))
    value, std = [], []
    for moment, sample in zip(np.asarray(t).tolist(), np.asarray(angles).tolist(), strict=True):
        found = predictor.step(moment, tuple(sample))
        value.append([(p.roll_rad, p.pitch_rad, p.yaw_rad) for p in found])
        std.append([(p.roll_std_rad, p.pitch_std_rad, p.yaw_std_rad) for p in found])
    return np.array(value), np.array(std)


def ship(t: npt.ArrayLike) -> Array:
    """Three axes of incommensurate harmonics, rad."""
    t = np.asarray(t)
    roll = 0.05 * np.sin(TURN * t / 12) + 0.01 * np.sin(TURN * t / 9.1 + 1)
    pitch = 0.02 * np.sin(TURN * t / 6.5 + 2) + 0.004 * np.cos(TURN * t / 8.3)
    yaw = 0.01 * np.sin(TURN * t / 10 + 0.5)
    return np.stack([roll, pitch, yaw], axis=-1)


def wrapped(angle: Array) -> Array:
    return (angle + pi) % TURN - pi


def ahead(t: npt.ArrayLike, horizons: Sequence[float] = (0.05, 0.10, 0.15)) -> Array:
    """The true angles at each horizon after t, (n, horizons, 3)."""
    return np.stack([ship(np.asarray(t) + h) for h in horizons], axis=1)


def rms(error: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(error**2, axis=(0, 1))))


# -- the regression of eq. (6) ------------------------------------------------------------------------------------


def sums(x: Array, v: Array, y: Array) -> list[list[float]]:
    columns = np.stack([x, v, np.ones_like(x), y])
    return [[float(value) for value in row] for row in columns @ columns.T]


@pytest.mark.parametrize("doubt", [0.0, 0.02, 1.0])
def test_regression_is_least_squares_with_a_prior_on_the_constant(doubt: float) -> None:
    rng = np.random.default_rng(5)
    x, v = rng.standard_normal(80) + 0.3, 0.05 * rng.standard_normal(80)
    y = 0.998 * (x - 0.2) + 1.1 * v + 0.2 + 0.01 + 0.003 * rng.standard_normal(80)
    mean = 0.2
    design = np.stack([x - mean, v, np.ones(80)], axis=1)
    plain = np.linalg.lstsq(design, y - mean, rcond=None)[0]
    residual = np.mean((y - mean - design @ plain) ** 2)
    spread, frequency2 = np.mean((x - mean) ** 2), np.sum(v**2) / np.sum((x - mean) ** 2)
    prior = (doubt * frequency2 / 2) ** 2 * spread
    if doubt:  # the prior as one more equation: sqrt(residual / prior) c = 0
        design = np.vstack([design, [0.0, 0.0, np.sqrt(residual / prior)]])
        expected = np.linalg.lstsq(design, np.append(y - mean, 0.0), rcond=None)[0]
    else:
        expected = np.append(np.linalg.lstsq(design[:, :2], y - mean, rcond=None)[0], 0.0)
    phi_x, phi_v, constant = regression(sums(x, v, y), mean, doubt)
    found = np.array([phi_x, phi_v, constant - mean * (1 - phi_x)])
    assert found == pytest.approx(expected, abs=1e-9)


def test_without_motion_the_prediction_is_hold() -> None:
    still = np.full(9, 0.1)
    phi_x, phi_v, constant = regression(sums(still, 0 * still, still), 0.1, 1.0)
    assert (phi_x, phi_v) == (1.0, 0.0)
    assert constant == pytest.approx(0.0, abs=1e-15)


# -- the whole predictor ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_hz", [12.8, 20.0, 30.0, 62.5, 100.0, 200.0])
@pytest.mark.parametrize("jitter_s", [0.0, 0.001])
def test_horizons_are_exact_at_any_rate(rate_hz: float, jitter_s: float) -> None:
    """A horizon that is off by 2 ms would show as 2 ms of slope: 5e-5 rad here."""
    rng = np.random.default_rng(2)
    t = np.arange(int(9 * rate_hz)) / rate_hz
    t = t + rng.uniform(-jitter_s, jitter_s, len(t))
    value, _ = run(t, ship(t))
    settled = t > 6
    error = wrapped(value - ahead(t))[settled]
    assert rms(error).max() < 1.2e-5


def test_other_horizons_too() -> None:
    t = np.arange(1500) / 50
    params = Params(horizons_s=(0.12, 0.5, 0.034))
    assert MaximumLikelihoodPredictor(params).horizons_s == (0.034, 0.05, 0.10, 0.12, 0.15, 0.5)
    value, _ = run(t, ship(t), params)
    error = np.sqrt(
        np.mean(wrapped(value - ahead(t, MaximumLikelihoodPredictor(params).horizons_s))[t > 10] ** 2, axis=(0, 2))
    )
    assert np.all(error < [1e-6, 2e-6, 5e-6, 1e-5, 2e-5, 5e-4])


def test_a_constant_list_costs_nothing() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(800) / 20
    motion = ship(t) + 1e-5 * rng.standard_normal((len(t), 3))
    level, _ = run(t, motion)
    lists = np.radians([7.0, -3.0, 200.0])
    heeled, _ = run(t, motion + lists)
    settled = t > 10
    straight = rms(wrapped(level - ahead(t))[settled])
    bent = rms(wrapped(heeled - lists - ahead(t))[settled])
    assert bent == pytest.approx(straight, rel=1e-3)


def test_before_two_seconds_nothing_is_claimed() -> None:
    t = np.arange(400) / 20
    value, std = run(t, ship(t))
    assert np.all(np.isnan(value[:39]))
    assert np.all(np.isfinite(value[41:]))
    assert np.all(np.isnan(std[: 40 + 5 * 20 - 20]))
    assert np.all(np.isfinite(std[40 + 7 * 20 :]))


def test_zero_start_waits_for_its_window_and_is_worse_at_first() -> None:
    rng = np.random.default_rng(1)
    t = np.arange(1200) / 20
    motion = ship(t) + [0.1, 0.1, 0.0] + 1e-5 * rng.standard_normal((len(t), 3))
    params = Params(mode="zero", thetas=(0.75,), horizons_s=())
    value, _ = run(t, motion, params)
    assert np.all(np.isnan(value[:208]))
    assert np.all(np.isfinite(value[210:]))
    error = wrapped(value - ahead(t) - [0.1, 0.1, 0.0])
    assert np.all(rms(error[210:310])[:2] > 3 * rms(error[500:])[:2])


def test_yaw_wraps() -> None:
    t = np.arange(1000) / 50
    heading = np.radians(359.5) + 0.03 * np.sin(TURN * t / 10)
    angles = np.stack([0 * t, 0 * t, heading % TURN], axis=1)
    value, std = run(t, angles)
    settled = t > 5
    later = np.radians(359.5) + 0.03 * np.sin(TURN * (t + 0.15) / 10)
    assert np.all((value[settled, :, 2] >= 0) & (value[settled, :, 2] < TURN))
    assert np.abs(wrapped(value[settled, 2, 2] - later[settled])).max() < 1e-4
    assert np.nanmax(std[settled, :, 2]) < 1e-3


@pytest.mark.parametrize("noise_rad", [0.0, 1e-4])
def test_a_steady_turn_does_not_lag(noise_rad: float) -> None:
    """3 degrees/s: predicting 'hold' would be off by 7.9e-3 rad."""
    rng = np.random.default_rng(9)
    t = np.arange(1000) / 50
    rate = np.radians(3.0)
    yaw = rate * t + noise_rad * rng.standard_normal(len(t))
    value, _ = run(t, np.stack([0 * t, 0 * t, yaw % TURN], axis=1))
    error = wrapped(value[t > 10, 2, 2] - rate * (t[t > 10] + 0.15))
    assert np.sqrt(np.mean(error**2)) < 3e-6 + 2.5 * noise_rad


@pytest.mark.parametrize(
    ("name", "signal"),
    [
        ("zeros", np.zeros),
        ("constant", lambda n: np.full(n, 0.123)),
        ("one quantum", lambda n: 0.1 + 1e-4 * (np.arange(n) > n // 2)),
        ("toggling quantum", lambda n: 0.1 + 1e-4 * (np.arange(n) % 7 == 0)),
        ("dying out", lambda n: 0.1 * np.exp(-np.arange(n) / 20)),
    ],
)
@pytest.mark.parametrize("mode", ["endpoint", "zero"])
def test_still_ship(name: str, signal: Callable[[int], Array], mode: Mode) -> None:
    n = 900
    x = signal(n)
    value, std = run(np.arange(n) / 20, np.stack([x, x, x % TURN], axis=1), Params(mode=mode, horizons_s=()))
    settled = slice(650, None)
    assert np.all(np.isfinite(value[settled]))
    assert np.all(np.isfinite(std[settled]))
    assert np.abs(wrapped(value[settled] - x[settled, None, None])).max() <= 3e-4


def test_a_missing_axis_is_unknown_and_disturbs_no_other() -> None:
    rng = np.random.default_rng(6)
    t = np.arange(600) / 50
    motion = ship(t) + 1e-4 * rng.standard_normal((len(t), 3))
    whole, whole_std = run(t, motion)
    lame = motion.copy()
    lame[:, 1] = nan
    value, std = run(t, lame)
    assert np.all(np.isnan(value[..., 1]))
    assert np.all(np.isnan(std[..., 1]))
    np.testing.assert_array_equal(value[..., [0, 2]], whole[..., [0, 2]])
    np.testing.assert_array_equal(std[..., [0, 2]], whole_std[..., [0, 2]])


def test_all_missing_is_all_unknown() -> None:
    value, std = run(np.arange(200) / 20, np.full((200, 3), nan))
    assert np.all(np.isnan(value))
    assert np.all(np.isnan(std))


@pytest.mark.parametrize("absent", ["nan", "no sample"])
@pytest.mark.parametrize("rate_hz", [20.0, 100.0])
def test_a_short_gap_is_bridged(absent: str, rate_hz: float) -> None:
    rng = np.random.default_rng(8)
    t = np.arange(int(30 * rate_hz)) / rate_hz
    motion = ship(t) + 1e-5 * rng.standard_normal((len(t), 3))
    gap = (t > 15.01) & (t < 15.21)
    if absent == "nan":
        motion[gap] = nan
    else:
        t, motion = t[~gap], motion[~gap]
    value, _ = run(t, motion)
    error = np.abs(wrapped(value - ahead(t)))
    assert np.all(np.isfinite(error[t > 5]))
    assert error[(t > 15) & (t < 17)].max() < 2e-3  # hold would be off by 9e-3 at the end of the gap
    assert error[t > 19].max() < 2.5e-4


def test_after_a_long_gap_an_axis_starts_anew() -> None:
    t = np.arange(1500) / 50
    motion = ship(t) + 1e-5 * np.random.default_rng(3).standard_normal((len(t), 3))
    out = (t > 15) & (t < 17)
    motion[out, 0] = nan
    value, _ = run(t, motion)
    assert np.all(np.isnan(value[(t > 15.4) & (t < 18.9), :, 0]))
    assert np.all(np.isfinite(value[t > 4, :, 1:]))
    again = t > 19.1
    assert np.all(np.isfinite(value[again, :, 0]))
    assert np.abs(wrapped(value - ahead(t)))[again].max() < 5e-4


def test_garbage_does_not_stay() -> None:
    t = np.arange(900) / 20
    motion = ship(t) + 1e-5 * np.random.default_rng(3).standard_normal((len(t), 3))
    motion[200], motion[201], motion[210] = np.inf, -np.inf, 3.0
    value, _ = run(t, motion)
    later = t > 25
    assert np.all(np.isfinite(value[t > 5, :, :2]))
    assert np.all(np.isfinite(value[(t > 5) & ~((t > 10.4) & (t < 14.0))]))  # a yaw that no ship turns with is left out
    assert np.abs(wrapped(value - ahead(t)))[later].max() < 5e-4


def test_published_deviation_is_the_error_that_follows() -> None:
    rng = np.random.default_rng(12)
    noise = 3e-4
    for rate_hz in (20.0, 62.5):
        t = np.arange(int(60 * rate_hz)) / rate_hz
        value, std = run(t, ship(t) + noise * rng.standard_normal((len(t), 3)))
        late = t > 30
        error = wrapped(value - ahead(t))[late]
        actual = np.sqrt(np.mean(error**2, axis=0) + noise**2)
        assert std[-1] == pytest.approx(actual, rel=0.15)


def test_late_samples_are_ignored_and_reset_forgets() -> None:
    t = np.arange(200) / 20
    predictor = MaximumLikelihoodPredictor(Params(horizons_s=()))
    first = [predictor.step(m, tuple(s)) for m, s in zip(t.tolist(), ship(t).tolist(), strict=True)]
    assert predictor.step(t[-1], (9.0, 9.0, 9.0)) == first[-1]
    assert predictor.step(nan, (9.0, 9.0, 9.0)) == first[-1]
    predictor.reset()
    again = [predictor.step(m, tuple(s)) for m, s in zip(t.tolist(), ship(t).tolist(), strict=True)]
    np.testing.assert_equal(
        [msgspec.structs.astuple(p[0]) for p in again], [msgspec.structs.astuple(p[0]) for p in first]
    )


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"pionts": 67}, "pionts"),
        ({"mode": "warm"}, "mode"),
        ({"thetas": []}, "thetas"),
        ({"thetas": [1.0]}, "thetas"),
        ({"degree": 0}, "degree"),
        ({"horizons_s": [0.0]}, "horizons_s"),
        ({"points": 5}, "points"),
    ],
)
def test_wrong_settings_are_refused(table: dict[str, object], message: str) -> None:
    with pytest.raises(msgspec.ValidationError, match=message):
        msgspec.convert(table, Params)


def test_carried_predictions_are_those_of_a_straight_motion_and_end_after_a_step() -> None:
    def at(t: float, horizon_s: float) -> RockPrediction:
        when = t + horizon_s
        return RockPrediction(
            horizon_s=horizon_s,
            roll_rad=0.1 - 0.3 * when,
            pitch_rad=0.2 * when,
            yaw_rad=(6.2 + when) % (2 * pi),
            roll_std_rad=0.01 * horizon_s,
        )

    given = tuple(at(0.0, h) for h in (0.05, 0.1, 0.15))
    for by_s in (0.0, 0.013, 0.05):
        for seen, expected in zip(seen_later(given, by_s), (at(by_s, h) for h in (0.05, 0.1, 0.15)), strict=True):
            assert seen.horizon_s == expected.horizon_s
            assert seen.roll_rad == pytest.approx(expected.roll_rad, abs=1e-12)
            assert seen.pitch_rad == pytest.approx(expected.pitch_rad, abs=1e-12)
            assert seen.yaw_rad == pytest.approx(expected.yaw_rad, abs=1e-12)
            assert seen.roll_std_rad >= expected.roll_std_rad
    assert all(isnan(seen.roll_rad) for seen in seen_later(given, 0.0501))
