"""Rock prediction on random seas: how far from the optimal linear predictor, steady and just after the start."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from evidence.rock.paper import SCENES, evaluate, figure, report

from heaved.estimation.rock.params import Params

if TYPE_CHECKING:
    from pathlib import Path

SCENE = {scene.name: scene for scene in SCENES}


@pytest.mark.parametrize("rate_hz", [20.0, 100.0])
@pytest.mark.parametrize(("scene", "bound"), [("under way", 1.75), ("under way, MEMS", 1.75), ("moored", 2.0)])
def test_error_over_the_optimal_linear_predictor(scene: str, bound: float, rate_hz: float) -> None:
    rows = evaluate(SCENE[scene], "default", Params(horizons_s=()), rate_hz, seeds=(1, 2), duration_s=60.0)
    for row in rows:
        assert row.truth_ratio > 1.0, f"{row.axis}: better than possible, so the limit or the record is wrong"
        assert row.ratio <= bound, row
    pooled = sum(row.first_ratio**2 for row in rows) / len(rows)  # one start alone is a matter of luck
    assert pooled <= 1.2**2, [row.first_ratio for row in rows]


@pytest.mark.parametrize(("scene", "right", "wrong"), [("under way", 0.65, 0.85), ("under way, MEMS", 0.85, 0.65)])
def test_the_memory_follows_the_noise(scene: str, right: float, wrong: float) -> None:
    """A noisy sensor wants a long memory, a quiet one a short: side by side, the better of the two is published."""
    both, alone, other = (
        evaluate(SCENE[scene], "", Params(thetas=thetas), 20.0, (1,), 80.0, axes=(0,))[0].rms_arcsec[-1]
        for thetas in ((right, wrong), (right,), (wrong,))
    )
    assert both == pytest.approx(alone, rel=0.02)
    assert other > 1.4 * alone


def test_the_endpoint_start_is_what_makes_the_first_predictions_good() -> None:
    zero, endpoint = (
        evaluate(SCENE["under way"], mode, Params(mode=mode, thetas=(0.75,)), 20.0, (1, 2), 90.0, axes=(0,))[0]
        for mode in ("zero", "endpoint")
    )
    assert zero.first_ratio > 2.0
    assert endpoint.first_ratio <= 1.2


def test_the_order_of_the_paper_holds() -> None:
    """Wei et al. 2019, Table 1, under way: the method beats the 41-point extrapolation, and that beats hold."""
    method, extrapolation, hold = (
        evaluate(SCENE["under way"], name, params, 20.0, (1,), 90.0, axes=(0,))[0].rms_arcsec[-1]
        for name, params in (("default", Params(horizons_s=())), ("41-point extrapolation", None), ("hold", None))
    )
    assert method < extrapolation / 3 < hold / 6


def test_report_and_figure(tmp_path: Path) -> None:
    rows = evaluate(SCENE["moored"], "hold", None, 20.0, (1,), 60.0, axes=(0, 1))
    text = report(rows)
    assert "| roll | hold | 20 |" in text
    assert "0.85 (max 22.25)" in text
    figure(tmp_path / "rock.png", duration_s=12.0)
    assert (tmp_path / "rock.png").read_bytes().startswith(b"\x89PNG")


def test_rates_that_miss_the_horizons_are_refused() -> None:
    with pytest.raises(ValueError, match="divide 200"):
        evaluate(SCENE["moored"], "hold", None, 30.0, (1,), 60.0)
