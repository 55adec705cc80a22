"""tools/accuracy.py: the baselines are what their names say, people and machines can read the results."""

from __future__ import annotations

import json
import subprocess
import sys
from math import inf, pi, sqrt
from typing import TYPE_CHECKING

import accuracy
import msgspec
import numpy as np
import pytest
from evidence import scenarios
from evidence.closed_loop import loop as closed_loop
from evidence.heave import asked, baselines, estimators, gates
from evidence.heave import evaluate as heave
from evidence.scenarios import Setting, triplet
from scipy.signal import butter, freqs

if TYPE_CHECKING:
    from pathlib import Path

RATE_HZ = 20.0
BIAS_MPS2 = 0.03
RESULT_FIELDS = {
    "kind", "scenario", "setting", "seeds", "estimator", "published", "rms_m", "worst_rms_m", "sigma_m",
    "share_of_sigma", "share_of_hs", "limit_m", "ratio_to_limit", "gain", "outage_rms_m", "coverage", "valid_coverage",
    "lies", "states", "reasons", "forecast", "delayed", "settled_s", "settling", "segments", "commit", "versions",
}  # fmt: skip


def answer(filter_: baselines.Filter, period_s: float) -> tuple[complex, float]:
    """What a filter makes of a biased sinusoid of heave, 1 m, once settled: complex amplitude and mean."""
    t = np.arange(round(60 * period_s * RATE_HZ)) / RATE_HZ
    w = 2.0 * pi / period_s
    out = np.array([filter_.step(at, a) for at, a in zip(t.tolist(), BIAS_MPS2 - w**2 * np.cos(w * t), strict=True)])
    last = t >= 40 * period_s  # 20 whole periods
    amplitude = 2.0 * np.mean(out[last] * np.exp(-1j * w * t[last]))
    return complex(amplitude), float(np.mean(out[last]))


@pytest.mark.parametrize("period_s", [5.0, 8.0])
def test_the_inertial_output_leads_and_keeps_the_bias(period_s: float) -> None:
    amplitude, mean = answer(baselines.Inertial(), period_s)
    corner = 2.0 * pi / 16.0
    _, expected = freqs([1.0, 0.0, 0.0], [1.0, sqrt(2.0) * corner, corner**2], worN=[2.0 * pi / period_s])
    assert amplitude == pytest.approx(complex(expected[0]), abs=2e-3)
    assert mean == pytest.approx(BIAS_MPS2 / corner**2, rel=1e-3)


@pytest.mark.parametrize("period_s", [5.0, 8.0])
def test_the_iir_filter_is_a_butterworth_high_pass_of_heave(period_s: float) -> None:
    amplitude, mean = answer(baselines.Iir(RATE_HZ), period_s)
    b, a = butter(4, 2.0 * pi * baselines.IIR_CORNER_HZ, "highpass", analog=True)
    _, expected = freqs(b, a, worN=[2.0 * pi / period_s])
    assert amplitude == pytest.approx(complex(expected[0]), rel=0.01)  # bilinear: (w T)^2 / 12 per integrator
    assert mean == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("period_s", [5.0, 8.0])
def test_the_double_integrator_has_a_high_pass_for_each_integration(period_s: float) -> None:
    corner_hz = 0.03  # that of the table would take a quarter of an hour to settle
    amplitude, mean = answer(baselines.Iir(RATE_HZ, corner_hz, passes=2), period_s)
    b, a = butter(2, 2.0 * pi * corner_hz, "highpass", analog=True)
    _, expected = freqs(b, a, worN=[2.0 * pi / period_s])
    assert amplitude == pytest.approx(complex(expected[0]) ** 2, rel=0.01)
    assert mean == pytest.approx(0.0, abs=1e-4)


def test_the_kalman_filter_is_the_conditional_mean() -> None:
    """Against the joint Gaussian of all states and measurements, conditioned at once."""
    n, z = 12, np.random.default_rng(1).normal(0.0, 0.2, 12)
    kalman = baselines.LinearKalman(RATE_HZ, 6.0)
    w, T = 2.0 * pi / 6.0, 1.0 / RATE_HZ
    F = np.array([[np.cos(w * T), np.sin(w * T) / w, 0], [-w * np.sin(w * T), np.cos(w * T), 0], [0, 0, 1]])
    H = np.array([[1.0, 0.0, 1.0]])
    powers = [np.linalg.matrix_power(F, k) for k in range(n + 1)]
    # x_k = F^k x_0 + sum F^(k-j) q_j: the sources are x_0 and the n process noises.
    paths = np.vstack(
        [np.hstack([powers[k], *(powers[k - j] if j <= k else np.zeros((3, 3)) for j in range(1, n + 1))])
         for k in range(1, n + 1)]
    )  # fmt: skip
    states = paths @ np.diag([0.1] * 3 + [1e-5] * (3 * n)) @ paths.T
    seen = np.kron(np.eye(n), H)
    gain = states @ seen.T @ np.linalg.inv(seen @ states @ seen.T + 0.022 * np.eye(n))
    for value in z.tolist():
        kalman.measure(value)
    assert kalman.x == pytest.approx((gain @ z)[-3:], abs=1e-12)
    assert pytest.approx((states - gain @ seen @ states)[-3:, -3:], abs=1e-12) == kalman.P


def test_ukf_and_kalman_filter_are_one_on_the_linear_model() -> None:
    z = np.random.default_rng(2).normal(0.0, 1.0, 400)
    assert baselines.ukf_against_kf(z, RATE_HZ, 5.0) < 1e-11


def test_no_waves_noise_or_start_shares_a_seed() -> None:
    values = [getattr(triplet(number), name) for number in range(1, 200) for name in ("waves", "noise", "start")]
    assert len(set(values)) == len(values)


SHORT = Setting(rate_hz=10.0, duration_s=225.0, scored_from_s=200.0, laser="50%")


def test_each_seed_draws_its_own_part() -> None:
    def case(**seeds: int) -> scenarios.Case:
        return scenarios.build("S4", msgspec.structs.replace(triplet(1), **seeds), SHORT)

    same, waves, noise, start = case(), case(waves=7), case(noise=7), case(start=7)

    def heave_of(case: scenarios.Case) -> np.ndarray:
        return case.recording.truth.heave_m

    def errors_of(case: scenarios.Case) -> np.ndarray:
        return case.recording.roll_rad - case.recording.truth.roll_rad

    assert np.array_equal(heave_of(same), heave_of(noise))
    assert not np.array_equal(errors_of(same), errors_of(noise))
    for other in (waves, start):
        assert np.allclose(errors_of(same), errors_of(other), atol=1e-12)
        assert np.std(heave_of(same) - heave_of(other)) > 0.1
    # Another start moves the same waves in time: their energy stays to the last digit.
    assert start.local_sigma_m == pytest.approx(same.local_sigma_m, rel=1e-12)
    assert waves.local_sigma_m != pytest.approx(same.local_sigma_m, rel=1e-4)


@pytest.mark.parametrize(
    ("tilt", "rolls", "noise_rad"), [("none", False, 3.5e-4), ("exact", True, 0.0), ("noisy", True, 3.5e-4)]
)
def test_the_tilt_is_known_as_said(tilt: scenarios.Tilt, rolls: bool, noise_rad: float) -> None:
    recording = scenarios.build("S6", triplet(1), msgspec.structs.replace(SHORT, tilt=tilt)).recording
    assert (np.std(recording.truth.roll_rad) > 0.01) == rolls
    error = recording.roll_rad - recording.truth.roll_rad
    assert np.std(error) == pytest.approx(noise_rad, rel=0.05, abs=1e-12)


def test_a_growing_sea_is_cut_where_it_changes() -> None:
    case = scenarios.build("SX", triplet(1), Setting(rate_hz=5.0, tilt="none"))
    t = case.recording.t_s
    names = [part.name for part in case.segments]
    assert names[1] == "growing"
    assert names[-3:] == ["first minute after", "second and third", "then"]
    assert [part.start_s for part in case.segments[1:]] == [part.end_s for part in case.segments[:-1]]
    truth = case.recording.truth.heave_m / case.local_sigma_m
    for part in case.segments:
        inside = (t >= part.start_s) & (t < part.end_s)
        deviation = np.std(truth[inside])  # that of the motion everywhere; a minute holds twelve waves only
        assert deviation == pytest.approx(1.0, abs=0.5 if part.end_s - part.start_s < 100.0 else 0.25)
    before, grown = (case.local_sigma_m[np.searchsorted(t, at)] for at in (400.0, 1000.0))
    assert grown / before == pytest.approx(4.0 / 1.5, rel=1e-9)


def test_every_estimator_sees_the_same_and_only_the_past() -> None:
    """What is published until 100 s does not change when the samples end there."""
    case = scenarios.build("T1", triplet(1), SHORT)
    samples = list(case.recording.samples())
    early = [sample for sample in samples if sample.t_s < 100.0]
    conditions = estimators.Conditions(rate_hz=10.0, period_s=5.0, has_laser=True, horizons_s=(1.0,))
    for name in estimators.NAMES:
        whole, part = (estimators.traces(name, given, conditions) for given in (samples, early))
        assert [trace.estimator for trace in whole] == [trace.estimator for trace in part]
        for long, short in zip(whole, part, strict=True):
            assert np.array_equal(long.heave_m[: short.heave_m.size], short.heave_m, equal_nan=True)
    assert [trace.estimator for trace in whole] == [estimators.title(name), estimators.title(name) + " + BP"]


def test_an_observer_that_there_is_not_is_named() -> None:
    conditions = estimators.Conditions(rate_hz=10.0, period_s=5.0, has_laser=False)
    with pytest.raises(ValueError, match="unknown estimator 'guess'"):
        estimators.traces("guess", [], conditions)


# --- the command line ------------------------------------------------------------------------------------------------


def test_a_short_run_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = [
        "heave",
        "T1",
        "S4",
        "--seeds",
        "1",
        "--rate",
        "10",
        "--duration",
        "225",
        "--from",
        "200",
        "--laser",
        "50%",
    ]
    assert accuracy.main([*command, "--estimators", "inertial", "kf", "harmonic", "--out", str(tmp_path)]) == 0
    table = capsys.readouterr().out
    assert "| UKF multi-step + BP |" in table
    assert "60 s on, 60 s off" in table
    lines = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    rows = {(line["scenario"], line["estimator"]): line for line in lines}
    corrected = rows["T1", estimators.CORRECTED]
    assert set(corrected) >= RESULT_FIELDS
    assert set(corrected["versions"]) >= {"python", "heaved", "numpy", "scipy", "torch"}
    assert corrected["seeds"] == [{"waves": 1, "noise": 1001, "start": 2001}]
    assert rows["T1", estimators.KF]["coverage"] is None
    # 0.03 m with side lines of 15 % and 10 %, over five periods; the bias alone is 0.19 m in the inertial output.
    expected = 0.03 * sqrt((1.0 + 0.15**2 + 0.1**2) / 2.0)
    assert corrected["sigma_m"] == pytest.approx(expected, rel=0.25)
    inertial = rows["T1", estimators.INERTIAL]
    assert inertial["rms_m"] == pytest.approx(BIAS_MPS2 / (2.0 * pi / 16.0) ** 2, rel=0.1)
    assert corrected["rms_m"] < 0.0072 < rows["T1", estimators.KF]["rms_m"]  # the paper's figure for trial 1
    irregular = rows["S4", estimators.CORRECTED]
    assert irregular["ratio_to_limit"] == pytest.approx(irregular["rms_m"] / irregular["limit_m"])
    assert irregular["share_of_hs"] == pytest.approx(irregular["share_of_sigma"] / 4.0)
    for path in tmp_path.glob("*.png"):
        data = path.read_bytes()
        assert data[:8] == b"\x89PNG\r\n\x1a\n"
        assert int.from_bytes(data[16:20], "big") == 3.5 * 300  # a column of print
    assert {path.name.split("_")[0] for path in tmp_path.glob("*.png")} == {"heave", "spectrum", "forecast", "settling"}


def test_a_second_run_adds_its_lines(tmp_path: Path) -> None:
    command = ["heave", "T1", "--seeds", "1", "--rate", "10", "--duration", "225", "--from", "200", "--no-figures"]
    for _ in range(2):
        assert accuracy.main([*command, "--estimators", "kf", "--out", str(tmp_path)]) == 0
    first, second = (tmp_path / "results.jsonl").read_text().splitlines()
    assert first == second


def test_two_processes_find_the_same(tmp_path: Path) -> None:
    """The two run from outside: a pool leaves a helper process with whoever made it."""
    words = ["heave", "T1", "S4", "--seeds", "2", "--rate", "10", "--duration", "225", "--from", "200", "--no-figures"]
    words += ["--estimators", "kf"]
    assert accuracy.main([*words, "--jobs", "1", "--out", str(tmp_path / "1")]) == 0
    command = [sys.executable, accuracy.__file__, *words, "--jobs", "2", "--out", str(tmp_path / "2")]
    subprocess.run(command, check=True, capture_output=True)
    one, two = (sorted((tmp_path / jobs / "results.jsonl").read_text().splitlines()) for jobs in "12")
    assert len(one) == 2
    assert one == two


def test_without_records_the_real_seas_are_skipped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scenarios, "DATA", tmp_path / "nowhere")
    assert accuracy.main(["real", "--out", str(tmp_path)]) == 0
    assert f"Hebrides: skipped, there are no records in {tmp_path / 'nowhere'}" in capsys.readouterr().out
    assert not (tmp_path / "results.jsonl").exists()


def real_case(scenario: str) -> scenarios.Case:
    if not scenarios.files(scenario):
        pytest.skip(f"no {scenario} records in {scenarios.DATA}")
    return scenarios.build(scenario, triplet(1), Setting(tilt="none"))


def test_a_buoy_record_becomes_a_case() -> None:
    case = real_case("Hebrides")
    scored = case.recording.truth.heave_m[case.scored]
    assert 2.5 < 4.0 * np.std(scored) < 4.1  # the buoy's own significant heights were 2.9 to 3.7 m that day
    assert 0.02 < case.limits.causal_m / np.std(scored) < 0.045  # 3.1 % was found independently
    assert 6.0 < case.period_s < 16.0
    short = scenarios.build("Hebrides", triplet(1), Setting(tilt="none", duration_s=400.0))
    assert short.recording.t_s[-1] == pytest.approx(405.0, abs=0.06)  # with the longest forecast's due time
    assert np.array_equal(short.recording.az_mps2, case.recording.az_mps2[: short.recording.t_s.size])
    todo = heave.tasks([("Hebrides", short.setting)], ("kf",), 1)[:1]
    (row,) = heave.run_all(todo)
    assert row[0].ratio_to_limit > 1.0


def test_a_flume_run_becomes_a_case() -> None:
    case = real_case("flume")
    scored = case.recording.truth.heave_m[case.scored]
    assert case.end_s - case.start_s > 60.0
    assert case.rate_hz == pytest.approx(25.0)  # 200 Hz at model scale, times root of 64
    assert 0.95 < np.std(scored) / case.optical_std_m < 1.17  # the camera shows a little less than the accelerometers
    assert 4.0 < case.period_s < 14.0
    assert not case.from_start


def test_a_still_record_becomes_a_case() -> None:
    case = real_case("static")
    assert not np.any(case.recording.truth.heave_m)
    assert np.isnan(case.limits.causal_m)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["heave", "T9"], "unknown scenario 'T9'"),
        (["real", "S4"], "unknown scenario 'S4'"),
        (["heave", "T1", "--duration", "100"], "cannot be scored from 300 s on"),
        (["heave", "T1", "--laser", "half"], "laser pattern 'half' is not understood"),
        (["limits", "--shake", "quake"], "unknown shake 'quake'"),
        (["table"], "results.jsonl"),
    ],
)
def test_faults_are_named(words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert accuracy.main([*words, "--out", str(tmp_path)]) == 1
    assert message in capsys.readouterr().err


# --- asked figures ---------------------------------------------------------------------------------------------------


def line(scenario: str, estimator: str, tilt: str, **fields: object) -> dict[str, object]:
    setting = {"sensor": "A", "tilt": tilt, "laser": "off", "rate_hz": 20.0, "duration_s": None, "scored_from_s": 300.0}
    return {"kind": "heave", "scenario": scenario, "estimator": estimator, "setting": setting, **fields}


def closed_loop_row(way: str, share: float) -> closed_loop.Row:
    return closed_loop.Row(
        sea="T3",
        way=way,
        method=closed_loop.OURS.format("sea"),
        setting=closed_loop.Setting(observer="sea", laser="off"),
        heave_rms_m=0.036,
        hook_rms_m=0.036 * share,
        share=share,
        hook_peak_m=0.1,
        forecast_share=share,
        held=0.0,
    )


def json_of(row: closed_loop.Row) -> dict[str, object]:
    """As the tool writes it into results.jsonl."""
    found: dict[str, object] = {"kind": "closed_loop", **msgspec.to_builtins(row)}
    return found


def test_asked_figures_are_found_in_the_lines() -> None:
    figures = {(figure.what, figure.of): figure for figure in asked.ASKED}
    assert len(figures) == len(asked.ASKED)
    lines = [
        line("S4", "UKF multi-step", "none", ratio_to_limit=9.0, settled_s=None),
        line("S4", "sea observer", "noisy", ratio_to_limit=3.0),
        line("S4", "sea observer", "none", ratio_to_limit=2.0, settled_s=45.0),
        line("S4", "sea observer", "none", ratio_to_limit=1.1, settled_s=45.0, published=1.0),
        line("static", "sea observer", "noisy", rms_m=0.004, reasons={"still: no waves": 0.97}),
        line("SX", "sea observer", "exact", segments={"then": 0.05}, forecast={}),
        line("S6S", "sea observer", "none", ratio_to_limit=1.0, published=0.9),
        json_of(closed_loop_row("live", 0.031)),
        json_of(closed_loop_row("replay", 0.5)),
    ]
    found = {name: asked.measured(lines, figure, "sea") for name, figure in figures.items()}
    over, settled, change = (
        "A: error over the causal limit",
        "A: within 6 % of σ from a cold start after",
        "A, SX: error over the local σ",
    )
    assert found[over, "S4"] == 1.1
    assert asked.kept(figures[over, "S4"], 1.1)
    assert not asked.kept(figures[over, "S4"], 9.0)
    assert found[over, "S6S"] == inf  # it was silent for a tenth of the time
    assert asked.measured(lines, figures[over, "S4"], "harmonic") == 9.0
    assert found[settled, "S4"] == 45.0
    assert asked.measured(lines, figures[settled, "S4"], "harmonic") == inf
    assert found["real IMU at rest, still ship: error", "static"] == pytest.approx(4.0)
    assert found['real IMU at rest, still ship: says "still"', "static"] == pytest.approx(97.0)
    assert found[change, "then"] == pytest.approx(5.0)
    assert not asked.kept(figures[change, "then"], found[change, "then"])
    assert np.isnan(found[change, "growing"])
    assert found["closed loop, live: hook motion over heave", "T3"] == pytest.approx(3.1)
    rows = asked.table(lines, "sea").splitlines()
    assert (
        f"| {over} | S4 / S6S / Hebrides / SL | ≤ 1.25 / ≤ 1.4 | 1.1 / never / – / – "
        "| **not reached**: S6S; not measured: Hebrides, SL | 9 / – / – / – |"
    ) in rows
    assert (
        "| closed loop, live: hook motion over heave | S6 / T3 | ≤ 4 % of heave | – / 3.1 | not measured: S6 | – / – |"
    ) in rows
    assert "| real IMU at rest, still ship: error | static / S0 | ≤ 5 mm | 4 / – | not measured: S0 | – / – |" in rows
    assert rows[-1] == f"{len(figures)} figures: 5 ok, 2 not reached, {len(figures) - 7} not measured."


# --- regression gates ------------------------------------------------------------------------------------------------


def test_gates_hold() -> None:
    """The short runs of the gates, against what is written down of them."""
    held = gates.load()
    assert held.observers
    assert {gate.scenario for gate in held.gates} == {name for name, _ in gates.CASES}
    results = [result for row in heave.run_all(gates.tasks(held.observers)) for result in row]
    assert gates.broken(held.gates, results) == []


def test_a_gate_that_breaks_is_told(tmp_path: Path) -> None:
    todo = heave.tasks([("T1", SHORT)], ("harmonic",), 1)
    (results,) = heave.run_all(todo)
    made = gates.made_of(results, "abc", ("harmonic",))
    gates.save(made, tmp_path / "gates.json")
    again = gates.load(tmp_path / "gates.json")
    assert again == made
    assert gates.broken(again.gates, results) == []
    strict = [
        msgspec.structs.replace(gate, measured={name: 0.9 * value - 0.03 for name, value in gate.measured.items()})
        for gate in again.gates
    ]
    assert len(gates.broken(strict, results)) == sum(len(gate.measured) for gate in again.gates)
    assert all("is not there any more" in message for message in gates.broken(again.gates, []))
