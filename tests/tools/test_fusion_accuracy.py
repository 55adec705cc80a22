"""Attitude fusion on a sea that steps from calm to rough and back: what fusing is worth, and what it is not worth.

Short voyages; the bands leave room for them. The figures of 50 full ones are those of tools/evidence/craft.py.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest
from evidence import craft
from evidence.craft import FIVE, IMM, INSTANT, METHODS, OUTLIERS, POINT_SETS, Row

from heaved.simulate.hydrofoil import Passage

if TYPE_CHECKING:
    from pathlib import Path

SHORT = Passage(stages=((0.0, 0.3), (40.0, 2.5), (80.0, 0.3)), duration_s=120.0)
SEEDS = (1, 2)
HEAVE_RATE, PITCH_RATE = 1, 3


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    used = [m for m in METHODS if m.name in (IMM, craft.EWMA, INSTANT, POINT_SETS, OUTLIERS)]
    return craft.table(SEEDS, methods=used, passage=SHORT)


def row(rows: list[Row], method: str, part: str = "whole") -> Row:
    return next(r for r in rows if r.method == method and r.part == part)


def test_mixing_beats_the_best_single_filter(rows: list[Row]) -> None:
    whole = row(rows, IMM)
    assert whole.against_best[HEAVE_RATE] < 0.90
    assert whole.against_best[PITCH_RATE] < 0.92


def test_in_a_steady_sea_mixing_costs_next_to_nothing(rows: list[Row]) -> None:
    steady = [r for r in rows if r.method == IMM and r.part != "whole"]
    assert len(steady) == 3
    for segment in steady:
        assert max(segment.against_best) < 1.06, segment


def test_the_published_covariance_is_right(rows: list[Row]) -> None:
    assert 0.8 < row(rows, IMM).nees < 1.4


def test_switching_by_the_average_is_nearly_as_good_and_calm(rows: list[Row]) -> None:
    imm, ewma = row(rows, IMM), row(rows, craft.EWMA)
    for state in (HEAVE_RATE, PITCH_RATE):
        assert ewma.rms[state] < 1.05 * imm.rms[state]
    assert ewma.switches_per_s < 0.5


def test_switching_at_every_instant_is_worse_than_the_better_filter(rows: list[Row]) -> None:
    """By a single innovation: it chatters, and is off by more than it says."""
    instant = row(rows, INSTANT)
    for state in (HEAVE_RATE, PITCH_RATE):
        assert instant.rms[state] > 1.03 * min(alone[state] for alone in instant.filter_rms)
    assert instant.switches_per_s > 5.0
    assert instant.nees > 2.0


def test_point_sets_make_no_difference_that_could_be_chosen(rows: list[Row]) -> None:
    """The patent as printed: the errors of both filters are one, and even who knows the truth gains nothing."""
    sets = row(rows, POINT_SETS)
    assert min(sets.correlation) > 0.9995
    assert min(sets.oracle) > 0.99
    assert sets.rms == pytest.approx(sets.filter_rms[0], rel=0.005)
    assert sets.rms == pytest.approx(sets.filter_rms[1], rel=0.005)


def test_outliers_cost_little(rows: list[Row]) -> None:
    clean, wrong = row(rows, IMM), row(rows, OUTLIERS)
    for ours, without in zip(wrong.rms, clean.rms, strict=True):
        assert ours < 1.05 * without
    assert wrong.gated > clean.gated + 0.015
    assert wrong.resets == 0


def test_a_sensor_that_shakes_costs_little_and_is_said() -> None:
    """Readings with a line of four deviations of their noise, or spikes: at most 1.5 times the clean error."""
    calm = Passage(stages=((0.0, 1.5),), duration_s=70.0)
    used = [m for m in craft.SHAKEN if m.shake in ("", "line-3.1-strong", "spikes")]
    rows = [r for r in craft.table((1, 2), methods=used, passage=calm) if r.part == "whole"]
    clean = next(r for r in rows if r.method == IMM)
    for shaken in rows:
        assert max(np.array(shaken.rms) / np.array(clean.rms)) < 1.5, shaken.method
        assert 0.7 < shaken.nees < 1.4, shaken.method


def test_report_and_figure(tmp_path: Path, rows: list[Row]) -> None:
    text = craft.report(rows)
    assert "### 40 s, Hs 2.5 m" in text
    assert f"| {POINT_SETS}: filter 2 alone |" in text
    assert "* imm: heave 1.000" in text
    brief = Passage(stages=((0.0, 0.3), (8.0, 2.5)), duration_s=20.0)
    craft.figure(tmp_path / "craft.png", passage=brief)
    assert (tmp_path / "craft.png").read_bytes().startswith(b"\x89PNG")


def test_processes_share_the_work_and_change_nothing() -> None:
    brief = Passage(stages=((0.0, 0.3),), duration_s=20.0)
    used = [m for m in METHODS if m.name in (IMM, FIVE)]
    assert craft.table((1, 2), jobs=2, methods=used, passage=brief) == craft.table((1, 2), 1, used, brief)
    assert msgspec.json.encode(craft.table((1,), methods=used, passage=brief)[0])
