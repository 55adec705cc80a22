"""The tool that makes the tables: its bound, its clocks, its report and its figure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest
from evidence.hull import METHODS, SCENE, Run, bound, evaluate, figure, kept_s, reached_s, report, summary, told

from heaved.estimation.common.rotations import ARCSEC
from heaved.simulate.flexure import SCENES, simulate

if TYPE_CHECKING:
    from pathlib import Path


def test_the_bound_scales_with_the_flexure_and_is_the_power_over_the_spectrum() -> None:
    """Gyro noise apart, 5 arcsec are 5/3 of 3; about y, seen through x and z by the tones of z and x, 1 / sqrt(J)."""
    three, five = (bound(simulate(SCENES[name], 1)) for name in ("A1", "A2"))
    assert five / three == pytest.approx(np.full(3, 5.0 / 3.0), rel=0.01)
    mu, lam, sigma, T = 0.1, 2 * np.pi * 0.16, 3.0 * ARCSEC, 600.0
    b2 = mu**2 + lam**2
    J = 0.0
    for degrees, period in ((4.0, 8.0), (3.0, 10.0)):
        w = 2 * np.pi / period
        A = np.radians(degrees) * w
        J += A**2 * T / 2 / (4 * mu * b2 * sigma**2 * w**2 / ((b2 - w**2) ** 2 + 4 * mu**2 * w**2))
    assert three[1] == pytest.approx(J**-0.5, rel=0.1)


def test_the_bound_falls_with_the_root_of_time() -> None:
    short, long = (bound(simulate(SCENES["A1"], 1, duration_s=s)) for s in (240.0, 480.0))
    assert short / long == pytest.approx(np.full(3, 2**0.5), rel=0.15)


def test_convergence_is_counted_to_the_last_excursion() -> None:
    t = np.arange(1, 301) / 10.0
    error = np.zeros((300, 3))
    error[:20] = 1000.0
    error[150, 1] = -61.0  # 15.1 s
    error[250:, 2] = 61.0
    assert kept_s(t, error) == pytest.approx((2.1, 15.2, 30.0))
    assert reached_s(t, error) == pytest.approx((2.1, 2.1, 2.1), abs=0.11)


def test_a_summary_is_the_statistics_of_its_runs() -> None:
    t = np.arange(1, 11) / 10.0
    runs = [
        Run(t_s=t, error_arcsec=np.full((10, 3), e), nees=3.0, bound_arcsec=np.full(3, 2.0), resets=1)
        for e in (3.0, -1.0)
    ]
    row = summary("A1", "so3", runs)
    assert row.mean_arcsec == (2.0, 2.0, 2.0)
    assert row.worst_arcsec == (3.0, 3.0, 3.0)
    assert row.rms_arcsec == pytest.approx((5**0.5,) * 3)
    assert row.ratio == pytest.approx(5**0.5 / 2)
    assert (row.nees, row.resets, row.runs) == (1.0, 2, 2)
    assert msgspec.json.decode(msgspec.json.encode(row), type=type(row)) == row


def test_processes_make_no_difference() -> None:
    one, two = (evaluate("A1", "so3", (1, 2), 12.0, jobs) for jobs in (1, 2))
    assert one == two


def test_told_is_the_flexure_of_the_scene_without_a_refit() -> None:
    params = told(METHODS["ckf, told"].params, SCENE["A2"])
    assert (params.flexure_std_arcsec, params.flexure_mu_radps, params.flexure_hz) == (5.0, 0.1, 0.16)
    assert params.refit_after_s == 0.0
    assert params.method == "ckf"


def test_report_and_figure(tmp_path: Path) -> None:
    rows = [evaluate("A1", name, (1,), 15.0) for name in ("so3", "ckf, told", "ckf, told, zero ± 10°")]
    text = report(rows)
    assert "| so3 | 1 |" in text
    assert "Paper: ckf mean 2.5, 2.5, 5″" in text
    assert "Asked: mean 3.5" in text
    figure(tmp_path / "hull.png", rows, duration_s=15.0)
    assert (tmp_path / "hull.png").read_bytes().startswith(b"\x89PNG")
