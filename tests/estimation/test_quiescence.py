"""The quiescence forecast: against seas whose quiet is known, by its calibration, and with bad input."""

from __future__ import annotations

from math import nan, pi
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest
from evidence.rock.quiescence import judge, report
from numpy.typing import NDArray

from heaved.estimation.lever_arm import Point
from heaved.estimation.quiescence import MotionForecast, Params, PointQuiescence, Quiescence
from heaved.samples import (
    CorrectionState,
    HeaveForecast,
    HeaveState,
    ImuSample,
    LaserState,
    MotionFrame,
    PointMotion,
    Quality,
    RockPrediction,
)

if TYPE_CHECKING:
    from heaved.samples import QuietWindow

Array = NDArray[np.float64]

LIMITS = Params(roll_limit_deg=2.0, pitch_limit_deg=1.0, heave_limit_m=0.5, duration_s=10.0, look_ahead_s=30.0)
RATE_HZ = 5.0


def grouped(t: Array) -> Array:
    """Heave of 0 to 1 m in groups of 100 s: below 0.5 m for a third of each."""
    return 0.5 * (1.0 - np.cos(2 * pi * t / 100.0)) * np.sin(2 * pi * t / 8.0)


def feed(
    quiescence: Quiescence, t: Array, heave: Array, roll: float = 0.0, pitch: float = 0.0
) -> list[QuietWindow | None]:
    return [quiescence.step(a, roll, pitch, b) for a, b in zip(t.tolist(), np.asarray(heave).tolist(), strict=True)]


def test_strictly_periodic_groups_are_foreseen() -> None:
    """Envelope known: |h| <= 0.5 (1 - cos) < 0.5 m within 25 s of each full hundred seconds."""
    t = np.arange(0.0, 2500.0, 1 / RATE_HZ)
    quiescence = Quiescence(LIMITS)
    said = feed(quiescence, t, grouped(t))
    late = t > 1500.0
    announced = [w for w, keep in zip(said, late, strict=True) if keep and w is not None]
    assert len(announced) > 0.4 * late.sum()
    quiet = []
    for window in announced:
        inside = window.t_s + window.start_s + np.arange(0.0, LIMITS.duration_s, 0.05)
        quiet.append(np.abs(grouped(inside)).max() < 0.5)
        assert window.length_s >= LIMITS.duration_s
        assert LIMITS.min_confidence <= window.confidence <= 1.0
    assert np.mean(quiet) > 0.9


def test_a_still_ship_is_quiet_now_and_a_rolling_one_never() -> None:
    t = np.arange(0.0, 700.0, 1 / RATE_HZ)
    still = feed(Quiescence(LIMITS), t, 0.01 * np.sin(t))[-1]
    assert still is not None
    assert still.start_s == 0.0
    assert still.length_s == LIMITS.duration_s + LIMITS.look_ahead_s
    rolling = Quiescence(LIMITS)
    for moment in t.tolist():
        window = rolling.step(moment, 0.1 * np.sin(moment), 0.0, 0.0)
    assert window is None
    assert np.all(rolling.probabilities < 0.1)


def test_nothing_is_said_before_it_is_learned() -> None:
    t = np.arange(0.0, 180.0, 1 / RATE_HZ)
    quiescence = Quiescence(LIMITS)
    assert feed(quiescence, t, 0.01 * np.sin(t)) == [None] * len(t)
    assert np.isnan(quiescence.probabilities).all()


def test_on_a_random_sea_it_beats_climate_and_is_calibrated() -> None:
    """A good half hour of wind sea, windows that begin at once: hits outnumber false alarms, chances come true."""
    verdicts = judge("wind sea, moderate", LIMITS, 2400.0, seeds=(1,))
    first = verdicts[0]
    assert first.brier < 0.85 * first.brier_climate
    assert first.brier < first.brier_persistence
    assert first.hits > 4 * first.false_alarms
    counted = sum(n for _, _, n in first.reliability)
    off = sum(abs(given - came) * n for given, came, n in first.reliability) / counted
    assert off < 0.15
    far = verdicts[-1]
    assert far.brier < 1.15 * far.brier_climate, "where nothing is foreseen it should say the base rate"
    assert "| wind sea, moderate | 0 |" in report(verdicts)


@pytest.mark.parametrize("disaster", ["nan", "gap", "backwards"])
def test_bad_input_is_survived(disaster: str) -> None:
    t = np.arange(0.0, 1400.0, 1 / RATE_HZ)
    heave = grouped(t)
    if disaster == "nan":
        heave[(t > 700) & (t < 710)] = nan
    elif disaster == "gap":
        keep = (t < 700) | (t > 900)
        t, heave = t[keep], heave[keep]
    else:
        t = np.where(t > 700, t - 5000.0, t)
    quiescence = Quiescence(LIMITS)
    said = feed(quiescence, t, heave)
    assert any(w is not None for w in said[-500:])
    chance = quiescence.probabilities
    assert np.all((chance >= 0.0) & (chance <= 1.0))


def test_an_unknown_motion_is_not_quiet() -> None:
    t = np.arange(0.0, 400.0, 1 / RATE_HZ)
    assert feed(Quiescence(LIMITS), t, 0.01 * np.sin(t), roll=nan) == [None] * len(t)


def test_a_forecast_that_tells_is_used() -> None:
    """Quiet and loud seconds at random: the past says nothing, a perfect forecast of 2 s says all."""
    params = Params(duration_s=2.0, look_ahead_s=2.0, roll_limit_deg=2.0, pitch_limit_deg=1.0, heave_limit_m=0.5)
    rng = np.random.default_rng(3)
    loud = np.repeat(rng.choice([0.1, 0.9], 400), 4)
    informed, blind = Quiescence(params), Quiescence(params)
    horizons = np.array([0.5, 1.5])
    right: dict[Quiescence, list[float]] = {informed: [], blind: []}
    for second, size in enumerate(loud[:-8].tolist()):
        coming = loud[second : second + 2]
        mean = np.zeros((2, 3))
        mean[:, 2] = coming
        informed.step(float(second), 0.0, 0.0, size, MotionForecast(horizons, mean, np.zeros((2, 3))))
        blind.step(float(second), 0.0, 0.0, size)
        if second > 500:
            for q, score in right.items():
                score.append((q.probabilities[0] - float(coming.max() < 0.5)) ** 2)
    assert np.mean(right[informed]) < 0.3 * np.mean(right[blind])


@pytest.mark.parametrize(("tip_m", "least", "most"), [(0.1, 0.9, 1.0), (2.0, 0.0, 0.1)])
def test_on_a_crane_that_moves_the_frame_says_how_the_point_does(tip_m: float, least: float, most: float) -> None:
    """The vessel by itself is at times quiet and at times not; the tip always is, or never."""
    params = Params(duration_s=2.0, look_ahead_s=4.0, heave_limit_m=0.5, enabled=True, point="tip")
    quiescence = PointQuiescence(params, Point(name="tip", frame="boom"))
    rng = np.random.default_rng(5)
    ahead = tuple(RockPrediction(horizon_s=h, roll_rad=0.0, pitch_rad=0.0, roll_std_rad=0.0, pitch_std_rad=0.0)
                  for h in (1.0, 2.0))  # fmt: skip
    valid = Quality(heave=HeaveState.VALID, laser=LaserState.OFF, correction=CorrectionState.OFF)
    for second, heave_m in enumerate(rng.choice([0.0, 3.0], 900).tolist()):
        t_s = float(second)
        point = PointMotion(
            name="tip",
            heave_m=tip_m,
            forecast=tuple(HeaveForecast(horizon_s=h, heave_m=tip_m, std_m=0.01) for h in (1.0, 2.0)),
        )
        frame = MotionFrame(t_s=t_s, quality=valid, heave_m=heave_m, points=(point,), rock=ahead)
        quiescence.step(ImuSample(t_s=t_s, roll_rad=0.0, pitch_rad=0.0), frame)
    assert least <= quiescence.at(899.0).best <= most


@pytest.mark.parametrize("table", [{"limit": 1}, {"duration_s": 0.0}, {"min_confidence": 1.0}, {"heave_limit_m": -1.0}])
def test_wrong_settings_are_refused(table: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(table, Params)
