"""tools/accuracy.py shake: the limits by another road, the normal equations of the sampled record; and the table."""

from __future__ import annotations

import json
from functools import cache
from typing import TYPE_CHECKING

import accuracy
import msgspec
import numpy as np
import pytest
from evidence import scenarios
from evidence.heave import shake
from evidence.limits import causal_heave_limit
from scipy.linalg import solve_toeplitz
from scipy.signal import fftconvolve

from heaved.samples import GRAVITY_MPS2
from heaved.simulate import shaking
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import ImuModel, record

if TYPE_CHECKING:
    from pathlib import Path

    from evidence.heave.summary import Result

SENSOR = ImuModel(noise_mps2_rthz=1e-3)
MEMORY_S = 150.0


def optimal(sea: str, name: str, rate_hz: float) -> tuple[np.ndarray, float]:
    """Optimal weights on the last 150 s of samples, newest first, and their RMS error: R w = r, with the covariances
    as Fourier sums of the densities.
    """
    f = scenarios.grid(rate_hz)
    heave, omega = scenarios.simulated_spectrum(sea, f), 2.0 * np.pi * f
    noise = scenarios.accelerometer_noise(f, SENSOR, rate_hz, name)
    count = round(MEMORY_S * rate_hz)
    to_variance = rate_hz / 2.0
    measured = np.fft.irfft(omega**4 * heave + noise)[:count] * to_variance
    wanted = np.fft.irfft(-(omega**2) * heave)[:count] * to_variance
    weights = solve_toeplitz(measured, wanted)
    variance = np.fft.irfft(heave)[0] * to_variance
    return weights, float(np.sqrt(variance - wanted @ weights))


@pytest.mark.parametrize(
    ("sea", "name", "rate_hz"),
    [
        ("S4", "line-1.3", 20.0),
        ("S6", "line-3.1", 10.0),
        ("S4", "engines", 20.0),
        ("S6", "broadband", 20.0),
        ("S6", "broadband", 10.0),
        ("S4", "whipping", 10.0),
        ("S6", "slams", 10.0),
        ("CRAFT", "engine-room", 20.0),
    ],
)
def test_limit_under_vibration_is_that_of_the_normal_equations(sea: str, name: str, rate_hz: float) -> None:
    f = scenarios.grid(rate_hz)
    noise = scenarios.accelerometer_noise(f, SENSOR, rate_hz, name)
    found = causal_heave_limit(f, scenarios.simulated_spectrum(sea, f), noise)
    assert found == pytest.approx(optimal(sea, name, rate_hz)[1], rel=0.02)


@pytest.mark.parametrize("name", ["line-3.1", "whipping", "broadband", "slams"])
def test_the_optimal_filter_reaches_the_limit_on_a_shaken_record(name: str) -> None:
    """Simulator, density and limit agree: 3000 s of S4 through the weights above."""
    rate_hz = 10.0
    made = record(
        seaway("S4", 5, attitude=False), 3000.0, imu_rate_hz=rate_hz, sensor=SENSOR, laser="off", shake=name, seed=6
    )
    weights, limit = optimal("S4", name, rate_hz)
    reading = made.az_mps2 - GRAVITY_MPS2
    estimate = fftconvolve(reading - np.mean(reading), weights)[: reading.size]
    error = (made.truth.heave_m - estimate)[weights.size :]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(limit, rel=0.15)


@pytest.mark.parametrize(("sea", "name"), [("S4", "line-1.3"), ("S6", "line-3.1"), ("S6", "line-25.1")])
def test_the_width_that_stands_for_a_line_hardly_matters(sea: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scenarios.sea_limits.cache_clear()
    clean = scenarios.sea_limits(sea, "A", 20.0).causal_m
    limits = []
    for width_hz in (0.01, 0.02, 0.04):
        monkeypatch.setattr(shaking, "LINE_WIDTH_HZ", width_hz)
        scenarios.sea_limits.cache_clear()
        limits.append(scenarios.sea_limits(sea, "A", 20.0, name).causal_m)
    scenarios.sea_limits.cache_clear()
    assert clean < limits[0] < limits[1] < limits[2] < 1.05 * clean


def test_what_is_no_vibration_leaves_the_limit_alone() -> None:
    clean = scenarios.sea_limits("S6", "A", 20.0)
    for name in ("warm-up", "turn", "list-step"):
        assert scenarios.sea_limits("S6", "A", 20.0, name).causal_m == clean.causal_m


def test_a_finer_grid_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    found = scenarios.sea_limits("S4", "A", 20.0, "engine-room")
    monkeypatch.setattr(scenarios, "GRID_STEP_HZ", scenarios.GRID_STEP_HZ / 4.0)
    scenarios.sea_limits.cache_clear()
    finer = scenarios.sea_limits("S4", "A", 20.0, "engine-room")
    scenarios.sea_limits.cache_clear()
    assert finer.causal_m == pytest.approx(found.causal_m, rel=0.01)
    assert finer.noncausal_m == pytest.approx(found.noncausal_m, rel=0.01)


# --- the table -------------------------------------------------------------------------------------------------------


def test_every_disturbance_is_asked_about_and_nothing_twice() -> None:
    rows = shake.plan()
    assert {question.shake for question in rows.values()} == {"", *shaking.SHAKES}
    assert {how.rate_hz for _, how in rows} == {20.0, 100.0}
    assert {sea for sea, how in rows if how.sensor == "C"} == {"S4", "SL"}
    lined = shake.plan(["line-3.1"])
    assert {(sea, how.rate_hz, how.tilt) for sea, how in lined} == {
        (sea, rate, "none") for sea in ("S4", "S6") for rate in (20.0, 100.0)
    }
    (after,) = {how.scored_from_s for _, how in shake.plan(["turn"])}
    turn = shaking.SHAKES["turn"].turn
    assert turn is not None
    assert after == turn.start_s + turn.duration_s + 60.0
    only = shake.plan(["slams", "none"], seas=["S5"], rates_hz=[10.0], duration_s=500.0)
    assert {(sea, how.rate_hz, how.duration_s) for sea, how in only} == {("S5", 10.0, 500.0)}
    with pytest.raises(ValueError, match=r"'gale'.*none, line-1\.3"):
        shake.plan(["gale"])


@pytest.mark.parametrize(
    ("what", "changes", "expected"),
    [
        ("line-3.1", {}, []),
        ("line-3.1", {"ratio_to_limit": 1.31}, ["error 1.31 × the limit"]),
        ("line-3.1", {"ratio_to_limit": 1.40, "ratio_to_limit_here": 1.32}, ["error 1.32 × the limit"]),
        ("line-3.1", {"ratio_to_limit": 1.40, "ratio_to_limit_here": 1.29}, []),
        ("line-3.1", {"ratio_to_limit": float("nan")}, ["error nan × the limit"]),
        ("line-3.1", {"states": {"valid": 0.9, "degraded": 0.1}}, ["valid 90 %"]),
        ("line-3.1", {"states": {}, "coverage": 0.5}, ["valid 0 %", "covered 50 %"]),
        ("slams", {"ratio_to_limit": 0.6, "states": {}}, []),
        ("slams", {"published": 0.9}, ["silent 10 %"]),
        ("slams", {"coverage": 0.999}, ["covered 100 %"]),
        ("turn", {"ratio_to_limit": 9.0}, []),
        ("turn", {"share_of_sigma": 0.025, "lies": 1e-3}, ["error 2.5 %", "lies 1.0 ‰"]),
        ("warm-up", {"ratio_to_limit": 1.4, "share_of_sigma": 0.019}, []),
        ("warm-up", {"ratio_to_limit": 1.4, "share_of_sigma": 0.021}, ["error 1.40 × the limit"]),
        ("warm-up", {"lies": 2e-3, "limit_lies": 3e-3}, []),
        ("warm-up", {"lies": 4e-3, "limit_lies": 3e-3}, ["lies 4.0 ‰"]),
    ],
)
def test_what_is_missed_is_said(what: str, changes: dict[str, object], expected: list[str]) -> None:
    result = msgspec.structs.replace(short(), **(GOOD | changes))
    assert shake.missed(result, shake.QUESTIONS[what]) == expected


GOOD = {
    "published": 1.0, "ratio_to_limit": 1.1, "share_of_sigma": 0.01, "states": {"valid": 1.0}, "coverage": 0.95,
    "lies": 0.0, "ratio_to_limit_here": float("nan"),
}  # fmt: skip


@cache
def short() -> Result:
    """The product on a short quiet record, just long enough for a delayed heave to be scored."""
    return shake.answer(shake.QUESTIONS["none"], "S4", 10.0, duration_s=390.0)


def test_the_product_is_near_the_limit_where_nothing_shakes() -> None:
    found = short()
    assert found.ratio_to_limit < 1.3
    assert found.lies == 0.0
    assert found.states["valid"] > 0.9


def test_the_tool_prints_limit_ours_textbook_and_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["shake", "line-3.1-small", "--seas", "S6", "--rates", "10", "--duration", "390", "--no-figures"]
    assert accuracy.main([*words, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    row = next(line for line in printed.splitlines() if line.startswith("| line-3.1-small"))
    _, what, sea, rate, limit, ours, ratio, here, textbook, asked, *_ = (cell.strip() for cell in row.split("|"))
    assert (what, sea, rate, asked) == ("line-3.1-small", "S6", "10", "≤ 1.3 ×")
    assert float(limit) == pytest.approx(0.83, abs=0.1)
    assert float(ours.split()[0]) / float(limit) == pytest.approx(float(ratio), rel=0.05)
    assert float(here) == pytest.approx(float(ratio), rel=0.5)  # Of ninety seconds.
    assert 5.0 < float(textbook) < 40.0
    assert "1 rows: " in printed
    lines = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert {(line["kind"], line["setting"]["shake"]) for line in lines} == {("shake", "line-3.1-small")}
    assert {line["estimator"] for line in lines} == {"sea observer", "double integrator"}
    assert accuracy.main(["shake", "gale", "--out", str(tmp_path)]) == 1
    assert "unknown disturbance 'gale'" in capsys.readouterr().err
