"""tools/accuracy.py: the baselines are what their names say, the scores are right, machines can read the results."""

from __future__ import annotations

import json
from math import nan, pi, sqrt
from pathlib import Path

import accuracy
import numpy as np
import pytest
from evidence import baselines, heave
from evidence.figures import heave_trial
from scipy.signal import butter, freqs

from heaved.simulate.seaway import heave_spectrum, seaway
from heaved.simulate.sensors import record

RATE_HZ = 20.0
BIAS_MPS2 = 0.03
RESULT_FIELDS = {
    "kind", "scenario", "setting", "seeds", "estimator", "rms_m", "worst_rms_m", "sigma_m", "share_of_sigma", "limit_m",
    "ratio_to_limit", "outage_rms_m", "coverage", "paper_m", "commit", "versions",
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


def test_the_limit_is_what_was_found_independently() -> None:
    """1.7 % and 0.8 % of the standard deviation for sensor A; a worse sensor has a higher one."""
    setting = heave.Setting()
    f = np.linspace(0.0, 2.0, 4001)
    for sea, share in (("S4", 0.017), ("S6", 0.008)):
        sigma = sqrt(np.trapezoid(heave_spectrum(sea, f), f))
        limit = heave.limit_m(lambda grid, sea=sea: heave_spectrum(sea, grid), setting)
        assert limit / sigma == pytest.approx(share, rel=0.15)
        worse = heave.limit_m(lambda grid, sea=sea: heave_spectrum(sea, grid), heave.Setting(sensor="B"))
        assert 1.3 * limit < worse < 4.0 * limit


def made_up_traces() -> heave.Traces:
    """400 s: the first 200 are not scored; then 0.02 m of error with laser, 0.06 m without, and an offset of 1 m."""
    setting = heave.Setting(rate_hz=10.0, duration_s=400.0, laser="200+0.5,250+50,300+100")
    case = heave.Case(
        scenario="T1",
        seed=1,
        recording=record(seaway("T1", 1), 400.0, imu_rate_hz=10.0, laser=setting.laser),
        period_s=5.0,
        limit_m=nan,
        end_s=400.0,
    )
    t = case.recording.t_s
    truth = case.recording.truth.heave_m
    sign = np.where(np.arange(t.size) % 2 == 0, 1.0, -1.0)
    laser_on = (t < 300.0) | (t >= 350.0)
    error = np.where(t < 200.0, 9.0, np.where(laser_on, 0.02, 0.06)) * sign
    names = (baselines.IIR, baselines.KF, baselines.UKF, baselines.MULTI_STEP, baselines.CORRECTED)
    return heave.Traces(
        case=case,
        t_s=t,
        truth_m=truth,
        heave_m={baselines.INERTIAL: truth + 1.0 + error} | dict.fromkeys(names, truth + error),
        std_m=np.full(t.size, 0.02),
        laser_on=laser_on,
        scored=t >= 200.0,
    )


def test_scores_are_taken_where_they_say() -> None:
    scores = {score.estimator: score for score in heave.scores(made_up_traces())}
    corrected = scores[baselines.CORRECTED]
    both = sqrt(0.75 * 0.02**2 + 0.25 * 0.06**2)
    assert corrected.rms_m == pytest.approx(both)
    assert (corrected.laser_rms_m, corrected.outage_rms_m) == (pytest.approx(0.02), pytest.approx(0.06))
    assert corrected.coverage == pytest.approx(0.75)
    assert scores[baselines.INERTIAL].rms_m == pytest.approx(sqrt(1.0 + both**2))
    assert scores[heave.LEVEL_INERTIAL].rms_m == pytest.approx(both)
    assert np.isnan(scores[baselines.KF].coverage)


def test_a_figure_is_drawn(tmp_path: Path) -> None:
    path = tmp_path / "heave.png"
    heave_trial(path, made_up_traces(), "T1")
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    width = int.from_bytes(data[16:20], "big")
    assert width == 3.5 * 300  # a column of print


def test_a_short_run_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["heave", "T1", "--seeds", "1", "--rate", "10", "--duration", "225", "--no-figures"]
    assert accuracy.main([*command, "--out", str(tmp_path)]) == 0
    table = capsys.readouterr().out
    assert "| UKF multi-step + BP |" in table
    assert "60 s on, 60 s off" in table
    lines = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    rows = {line["estimator"]: line for line in lines}
    assert {baselines.INERTIAL, baselines.IIR, baselines.KF, baselines.UKF, baselines.CORRECTED} <= set(rows)
    assert set(rows[baselines.CORRECTED]) >= RESULT_FIELDS
    assert set(rows[baselines.CORRECTED]["versions"]) >= {"python", "heaved", "numpy", "scipy", "torch"}
    assert rows[baselines.KF]["coverage"] is None
    # 0.03 m with side lines of 15 % and 10 %, over five periods; the bias alone is 0.19 m in the inertial output.
    expected = 0.03 * sqrt((1.0 + 0.15**2 + 0.1**2) / 2.0)
    assert rows[baselines.CORRECTED]["sigma_m"] == pytest.approx(expected, rel=0.25)
    assert rows[baselines.INERTIAL]["rms_m"] == pytest.approx(BIAS_MPS2 / (2.0 * pi / 16.0) ** 2, rel=0.1)
    assert rows[baselines.CORRECTED]["rms_m"] < 0.0072 < rows[baselines.KF]["rms_m"]  # the paper's figure for trial 1


def test_without_records_the_real_seas_are_skipped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(accuracy, "RECORDS", tmp_path / "nowhere")
    assert accuracy.main(["real", "--out", str(tmp_path)]) == 0
    assert f"skipped, there are no records (*.raw) in {tmp_path / 'nowhere'}" in capsys.readouterr().out
    assert (tmp_path / "results.jsonl").read_bytes() == b""


def test_a_real_record_becomes_a_case() -> None:
    files = sorted(accuracy.RECORDS.glob("*.raw"))
    if not files:
        pytest.skip(f"no buoy records in {accuracy.RECORDS}")
    case = heave.hebrides(files[0], 1, heave.Setting(duration_s=float("inf")))
    scored = case.recording.truth.heave_m[(case.recording.t_s >= 200.0) & (case.recording.t_s < case.end_s)]
    assert 2.5 < 4.0 * np.std(scored) < 4.1  # the buoy's own significant heights were 2.9 to 3.7 m that day
    assert 0.02 < case.limit_m / np.std(scored) < 0.045  # 3.1 % was found independently
    assert 6.0 < case.period_s < 16.0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["heave", "T9"], "unknown scenario 'T9'"),
        (["heave", "S0"], "unknown scenario 'S0'"),  # a still ship has no heave to be a share of
        (["heave", "T1", "--duration", "100"], "cannot be scored from 200 s on"),
        (["heave", "T1", "--laser", "half"], "laser pattern 'half' is not understood"),
    ],
)
def test_faults_are_named(words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert accuracy.main([*words, "--out", str(tmp_path)]) == 1
    assert message in capsys.readouterr().err
