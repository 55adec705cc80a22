"""tools/bench.py: every subcommand measures and prints a table; what it measures is this machine's affair."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bench
import pytest
from evidence import results

if TYPE_CHECKING:
    from pathlib import Path

BRIEF = {
    "replay": ["--seconds", "20", "--rates", "10"],
    "rock": ["--blocks", "1", "--rates", "5"],
    "fusion": ["--repeats", "1", "--ticks", "2"],
    "sigma": ["--repeats", "1", "--ticks", "2"],
    "telegrams": ["--repeats", "1", "--ticks", "1"],
    "training": ["--seconds", "0.2", "--rows", "300"],
}
"""The hull takes its time: 40 s of record and a refit."""


@pytest.mark.parametrize("name", BRIEF)
def test_a_bench_prints_its_table(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.main([name, *BRIEF[name]]) == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert len(rows) > 4
    assert len({row.count("|") for row in rows}) == 1
    assert all(any(character.isdigit() for character in row) for row in rows[2:])


def test_a_bench_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "RESULTS", tmp_path / "RESULTS.md")
    assert bench.main(["fusion", *BRIEF["fusion"], "--record"]) == 0
    written = (tmp_path / "RESULTS.md").read_text()
    assert "## `tools/bench.py fusion --repeats 1 --ticks 2`\n" in written
    assert "| imm, three seas |" in written


def test_timers_measure_what_is_called() -> None:
    calls: list[int] = []
    assert bench.hot_us(lambda: calls.append(1), 3) >= 0.0
    assert len(calls) == 3 * bench.BLOCKS
    assert len(bench.cold_us(lambda: calls.append(1), 2)) == 2
