"""tools/accuracy.py closed-loop: the hook under a winch that reads the lines of the daemon's own pipeline."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import accuracy
import numpy as np
import pytest
from evidence import closed_loop
from evidence.closed_loop_figure import hook_motion

from heaved.estimation.heave import Params

SETTING = closed_loop.Setting(observer=Params().observer, laser="on", warm_up_s=90.0, duration_s=16.0)
"""A wave train of 8 s: the heave settles for 30 s, then the compensation is faded in; two waves are scored."""


@cache
def trial() -> closed_loop.Trial:
    return closed_loop.replay("T3", SETTING)


def test_the_hook_moves_far_less_with_a_forecast_than_with_the_present_heave() -> None:
    none, present, paper, ours, perfect = trial().rows()
    # 0.05 m with side lines of 15 % and 10 %, over two periods.
    assert none.hook_rms_m == pytest.approx(0.05 * np.sqrt((1.0 + 0.15**2 + 0.1**2) / 2.0), rel=0.25)
    assert none.share == 1.0
    # A delay of 0.26 s at 8 s is 0.2 rad, so that without a lead a fifth is left, less what the trim takes off.
    assert 0.08 < present.share < 0.25
    assert ours.share < 0.7 * present.share
    assert paper.share < 0.7 * present.share
    assert perfect.share < 1e-3
    assert {row.held for row in (present, paper, ours, perfect)} == {0.0}


def test_the_hook_is_off_by_what_the_forecast_is_off_by() -> None:
    """What the winch was asked to cancel and did: the error of the one is that of the other, but for the trim."""
    ours = trial().rows()[3]
    assert ours.forecast_share == pytest.approx(ours.share, rel=0.3)


def test_the_figure_is_drawn(tmp_path: Path) -> None:
    hook_motion(tmp_path / "hook.png", trial())
    assert (tmp_path / "hook.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def replay(name: str, setting: closed_loop.Setting) -> closed_loop.Trial:
        asked.append((name, setting))
        return trial()

    monkeypatch.setattr(closed_loop, "replay", replay)
    words = ["--replay", "--laser", "on", "--warm-up", "90", "--duration", "16", "--no-figures", "--out", str(tmp_path)]
    assert accuracy.main(["closed-loop", "T3", *words]) == 0
    assert asked == [("T3", SETTING)]
    table = capsys.readouterr().out
    assert "## Hook motion, replay: T3, sensor A, laser on" in table
    assert "dead time 0.15 s, lag 0.1 s" in table
    rows = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert [row["method"] for row in rows] == [row.method for row in trial().rows()]
    assert all(row["kind"] == "closed_loop" and row["commit"] for row in rows)
    assert rows[0]["forecast_share"] is None


def test_faults_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, message in (
        (["S9", "--replay"], "unknown sea 'S9'"),
        (["T3", "--replay", "--observer", "psychic"], "heave.observer"),
        (["T3", "--replay", "--shifted"], "live only"),
    ):
        assert accuracy.main(["closed-loop", *words, "--out", str(tmp_path)]) == 1
        assert message in capsys.readouterr().err
