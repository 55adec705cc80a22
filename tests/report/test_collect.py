"""What is taken down of frames whose errors were drawn, with claims of known worth; and that memory does not grow."""

from __future__ import annotations

from math import erf, nan, pi, radians, sin, sqrt
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import msgspec
import numpy as np
import pytest
import seas

from heaved.config import CompensationParams, Config
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.sea.model import Resonance
from heaved.estimation.rock import params as rock
from heaved.report.collect import MOST_STRETCHES, STRETCH_S, Collector, MeanSpectra, parts_of
from heaved.samples import (
    CorrectionState,
    DelayedHeave,
    HeaveForecast,
    HeaveState,
    ImuSample,
    LaserSample,
    LaserState,
    MotionFrame,
    MruAgreement,
    MruComparison,
    Quality,
    RockPrediction,
    SeaState,
)

if TYPE_CHECKING:
    from heaved.replay.replay import Run

LEAD_S = 0.1
CONFIG = Config(
    heave=heave.Params(forecast_horizons_s=(1.0,), sea=heave.SeaParams(delay_s=20.0)),
    rock=rock.Params(horizons_s=(0.5,)),
    compensation=CompensationParams(lead_s=LEAD_S),
)
STD_M, DELAYED_STD_M, READING_STD_M = 0.05, 0.01, 0.002
VALID = Quality(heave=HeaveState.VALID, laser=LaserState.VALID, correction=CorrectionState.OFF)


def truth_m(t_s: float) -> float:
    return 1.5 * sin(0.7 * t_s)


def roll_rad(t_s: float) -> float:
    return radians(4.0 * sin(0.5 * t_s))


def collected(t_s: list[float]) -> Collector:
    """Frames at these times. Real-time heave as bold as right, forecasts half as bold, roll twice as bold; the laser
    reads 30 ms before a frame.
    """
    rng = np.random.default_rng(11)
    collector = Collector(CONFIG)
    reference = SimpleNamespace(value_t_s=nan, value_m=nan, is_known=True)
    attitude = SimpleNamespace(measured_s=nan)
    run = cast(
        "Run",
        SimpleNamespace(
            fit=None,
            pipeline=SimpleNamespace(
                laser=SimpleNamespace(reference=reference), vertical=SimpleNamespace(attitude=attitude)
            ),
        ),
    )
    compared: MruComparison | None = None
    for number, t in enumerate(t_s):
        off = rng.standard_normal(4).tolist()
        attitude.measured_s = t
        reference.value_t_s = t - 0.03
        reference.value_m = truth_m(t - 0.03) + READING_STD_M * rng.standard_normal()
        delayed_s = t - 20.0
        quality = (
            VALID if number % 4 else msgspec.structs.replace(VALID, heave=HeaveState.DEGRADED, reasons=("every 4",))
        )
        frame = MotionFrame(
            t_s=t,
            quality=quality,
            heave_m=truth_m(t + LEAD_S) + STD_M * off[0],
            heave_std_m=STD_M,
            roll_rad=roll_rad(t),
            pitch_rad=0.0,
            forecast=(HeaveForecast(horizon_s=1.0, heave_m=truth_m(t + 1.0) + 0.1 * off[1], std_m=0.2),),
            rock=tuple(
                RockPrediction(
                    horizon_s=h,
                    roll_rad=roll_rad(t + h) + radians(0.2) * off[2],
                    roll_std_rad=radians(0.1),
                    roll_interval_rad=radians(0.5),
                )
                for h in collector.layout.rock_s
            ),
            compensation_lead_s=LEAD_S,
            delayed=DelayedHeave(t_s=delayed_s, heave_m=truth_m(delayed_s), std_m=DELAYED_STD_M),
            reference_mru=(compared := _compared(t, number, off[1], compared)),
        )
        collector.take(run, LaserSample(t_s=t - 0.03, laser_m=1.0), None)
        collector.take(run, ImuSample(t_s=t, az_mps2=9.8 + 0.1 * off[3], roll_rad=roll_rad(t), pitch_rad=0.0), frame)
    collector.finish()
    return collector


def _compared(t_s: float, number: int, off: float, before: MruComparison | None) -> MruComparison | None:
    """Every second frame has a new one: off by 0.07 m about a mean of 3 m, where 0.1 m is explained."""
    if number % 2:
        return before
    heave = MruAgreement(difference=3.0 + 0.07 * off, mean_difference=3.0, explained=0.1)
    return MruComparison(t_s=t_s, heave=heave if number > 100 else MruAgreement(difference=3.0))


@pytest.fixture(scope="module")
def steady() -> Collector:
    """Twenty minutes at 20 Hz, with a pause of half a minute."""
    return collected([1e5 + 0.05 * k for k in range(24_000) if not 12_000 <= k < 12_600])


def normal_share(k: float) -> float:
    return erf(k / sqrt(2.0))


def test_claims_are_worth_what_they_were_drawn_with(steady: Collector) -> None:
    realtime = steady.all_realtime.statistics()
    # All but the last 20 s and those before the pause, whose delayed heave never came.
    assert realtime.count == pytest.approx(23_400 - 2 * 400, abs=10)
    assert realtime.rms == pytest.approx(STD_M, rel=0.02)
    assert realtime.within == pytest.approx([normal_share(k) for k in (1.0, 2.0, 3.0)], abs=0.015)
    forecast = steady.forecasts[0].statistics()
    assert forecast.rms == pytest.approx(0.1, rel=0.02)
    assert forecast.nees == pytest.approx(0.25, rel=0.04)
    assert steady.expected_nees.mean == pytest.approx(1.0 - (DELAYED_STD_M / STD_M) ** 2)
    roll = steady.rock["roll"][-1].statistics()
    assert roll.rms == pytest.approx(0.2, rel=0.02)
    assert roll.nees == pytest.approx(4.0, rel=0.04)
    assert roll.interval == pytest.approx(normal_share(2.5), abs=0.005)
    assert steady.rock["pitch"][-1].statistics().count == 0


def test_the_laser_is_compared_at_its_own_time(steady: Collector) -> None:
    """Between two frames, on a straight line between their independent errors: a little less than one of them has."""
    laser = steady.all_laser.statistics()
    assert laser.count > 23_300
    # Heave for 30 ms before a frame less the lead: 0.6 of the way from frames earlier by the lead to the next ones.
    share = 0.4
    expected = sqrt((share**2 + (1.0 - share) ** 2) * STD_M**2 + READING_STD_M**2)
    assert laser.rms == pytest.approx(expected, rel=0.03)
    assert laser.claimed_rms == pytest.approx(sqrt(STD_M**2 + CONFIG.laser.noise_std_m**2), rel=1e-6)


def test_an_existing_mru_is_compared_once_for_each_of_its_readings(steady: Collector) -> None:
    mru = steady.reference_mru.statistics()
    assert mru.count == pytest.approx(23_400 / 2 - 50, abs=2)
    assert mru.rms == pytest.approx(0.07, rel=0.03)
    assert mru.mean == pytest.approx(0.0, abs=0.003)
    assert mru.claimed_rms == pytest.approx(0.1)


def test_states_are_kept_apart(steady: Collector) -> None:
    counts = {state: steady.realtime[state].count for state in HeaveState}
    assert counts[HeaveState.SETTLING] == counts[HeaveState.INVALID] == 0
    assert counts[HeaveState.VALID] == pytest.approx(3 * counts[HeaveState.DEGRADED], abs=8)
    assert steady.settled_realtime.count == steady.all_realtime.count
    assert steady.quality.silent_s == pytest.approx(30.05 - 1.0)
    assert steady.reasons.spells(next(iter(steady.reason_texts))).seconds == pytest.approx(0.05 * 23_400 / 4, abs=1.0)


def test_a_stretch_holds_its_forecasts_from_before_it(steady: Collector) -> None:
    assert steady.typical is not None
    assert steady.worst is not None
    assert steady.worst.nees >= steady.typical.nees
    for stretch in (steady.typical, steady.worst):
        assert STRETCH_S <= stretch.end_s - stretch.begin_s < STRETCH_S + 5.0
        assert stretch.rows[0, 0] <= stretch.begin_s
        delayed = [truth_m(t + LEAD_S) for t in stretch.rows[:, 0].tolist()]
        known = np.isfinite(stretch.rows[:, -2])
        assert stretch.rows[known, -2] == pytest.approx(np.array(delayed)[known], abs=1e-3)


def test_memory_does_not_grow() -> None:
    """Four hours at 2 Hz: as many bins, stretches and waiting frames as of twenty minutes, or fewer."""
    collector = collected([0.5 * k for k in range(28_800)])
    assert len(collector.envelope.drawn().t_s) <= 1024
    assert 1 < len(collector.stretches) <= MOST_STRETCHES
    waiting: Any = collector._blocks
    assert len(waiting) == 0
    assert len(collector._delayed_known) < 5000
    assert collector.frames == 28_800


def test_nothing_is_nothing() -> None:
    collector = Collector(CONFIG)
    collector.finish()
    assert collector.frames == 0
    assert collector.typical is None
    assert collector.mean_sea.heave() is None


# ---- spectra of the fits ---------------------------------------------------------------------------------------------


def test_the_parts_of_a_model_make_up_its_whole() -> None:
    model = msgspec.structs.replace(
        seas.model(),
        resonances=(
            Resonance(frequency_hz=3.1, damping=0.02, level=1e-3),
            Resonance(frequency_hz=0.9, damping=0.3, level=1e-4, is_heave=True),
        ),
    )
    f = np.linspace(0.01, 10.0, 2000)
    parts = parts_of(model, f, 0.05)
    assert parts.whole == pytest.approx(model.acceleration_spectrum(f, 0.05))
    assert parts.waves + parts.vibration + parts.noise == pytest.approx(parts.whole, rel=1e-9)
    assert f[np.argmax(parts.vibration)] == pytest.approx(3.1, abs=0.05)


def sea_of(height_m: float) -> SeaState:
    f = np.linspace(0.02, 0.5, 50)
    spectrum = height_m**2 * np.exp(-((f - 0.1) ** 2) / 1e-3) / pi
    return SeaState(
        significant_height_m=height_m,
        peak_period_s=10.0,
        mean_period_s=9.0,
        systems=(),
        frequencies_hz=tuple(f.tolist()),
        spectrum_m2phz=tuple(spectrum.tolist()),
    )


def test_each_fit_counts_for_as_long_as_it_was_in_force() -> None:
    mean = MeanSpectra()
    mean.change(10.0, sea_of(1.0), None, nan)
    mean.change(20.0, sea_of(3.0), seas.model(), 0.05)
    mean.end(50.0)
    found = mean.heave()
    assert found is not None
    expected = (10.0 * np.array(sea_of(1.0).spectrum_m2phz) + 30.0 * np.array(sea_of(3.0).spectrum_m2phz)) / 40.0
    assert found[1] == pytest.approx(expected)
    parts = mean.acceleration()
    assert parts is not None
    assert parts.whole == pytest.approx(seas.model().acceleration_spectrum(parts.f_hz, 0.05))
