"""RESULTS.md: a section per command, replaced when the command runs again, that says what made it."""

from __future__ import annotations

import os
from pathlib import Path

import accuracy
import pytest
from evidence import results
from evidence.results import Provenance, Report

MADE_WITH = Provenance("0123456789abcdef+", {"python": "3.11.7", "numpy": "2.3.1"})


def section(command: str, text: str, *seeds: int) -> str:
    return results.section(command, Report(text, seeds), MADE_WITH, "2026-07-01", 12.3)


@pytest.mark.parametrize(
    ("words", "command"),
    [
        (["gates", "--record"], "tools/accuracy.py gates"),
        (["hull", "--runs", "16", "--jobs", "2", "--out", "there", "--record"], "tools/accuracy.py hull --runs 16"),
        (["heave", "--jobs=2", "--laser", "50%", "T1", "--no-figures"], "tools/accuracy.py heave --laser 50% T1"),
        (["shake", "a b"], "tools/accuracy.py shake 'a b'"),
    ],
)
def test_the_heading_is_what_makes_the_same_figures_again(words: list[str], command: str) -> None:
    assert results.command_line("/somewhere/tools/accuracy.py", words) == command


def test_a_section_says_what_made_it_and_keeps_its_own_headings_below() -> None:
    found = section("tools/accuracy.py gates", "## Disasters\n\n| a |\n|---|\n| # 1 |\n", 1, 2, 3)
    assert found.splitlines() == [
        "## `tools/accuracy.py gates`", "",
        f"2026-07-01; commit 0123456789ab+; seeds 1 to 3; python 3.11.7, numpy 2.3.1; {os.cpu_count()} cores; 12 s.",
        "", "#### Disasters", "", "| a |", "|---|", "| # 1 |",
    ]  # fmt: skip
    assert "seeds 7;" in section("x", "y", 7)
    assert "seeds 1, 4;" in section("x", "y", 1, 4)
    assert "seeds" not in section("x", "y")


def test_a_command_replaces_its_own_section_and_no_other() -> None:
    document = ""
    for command, text in (("tools/a.py one", "first"), ("tools/a.py one two", "second"), ("tools/b.py", "third")):
        document = results.replaced(document, section(command, text))
    assert document.startswith(results.HEAD.rstrip())
    again = results.replaced(document, section("tools/a.py one", "## anew"))
    assert [line for line in again.splitlines() if line.startswith("## ")] == [
        "## `tools/a.py one`", "## `tools/a.py one two`", "## `tools/b.py`",
    ]  # fmt: skip
    assert again == document.replace("first", "#### anew")
    assert results.replaced(again, section("tools/a.py one", "## anew")) == again


def test_a_command_records_what_it_prints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(results, "RESULTS", tmp_path / "RESULTS.md")
    words = ["faults", "--list", "--out", str(tmp_path)]
    assert accuracy.main(words) == 0
    assert not (tmp_path / "RESULTS.md").exists()
    assert accuracy.main([*words, "--record"]) == 0
    written = (tmp_path / "RESULTS.md").read_text()
    assert "## `tools/accuracy.py faults --list`\n" in written
    assert results.provenance().commit.removesuffix("+")[:12] in written
    printed = capsys.readouterr().out
    assert all(line in written for line in printed.split("\nResults in")[0].splitlines())


def test_the_commands_of_the_file_are_named_and_can_be_chosen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert accuracy.main(["results", "--list", "hull", "--out", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines[:2]] == [["tools/accuracy.py", "hull"]] * 2
    assert "tools/bench.py hull" in lines[2]
    assert accuracy.main(["results", "--list", "moon", "--out", str(tmp_path)]) == 1
    for line, _ in accuracy.RECORDED:
        program, *words = line.split()
        assert (Path(accuracy.__file__).parent / program).is_file()
        if program == "accuracy.py":
            accuracy._parser().parse_args([*words, "--record"])
