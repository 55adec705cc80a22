"""What of a directory is a recording, and what is not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from heaved.backtest.units import BacktestError, find_units

if TYPE_CHECKING:
    from pathlib import Path

HOUR = "heaved-20260101T000000Z"


def test_each_file_of_a_recording_is_one(tmp_path: Path) -> None:
    there = [
        "b.csv",
        "a.csv",
        "ship/" + HOUR + ".samples.parquet",
        "ship/" + HOUR + ".frames.parquet",
        "ship/" + HOUR + ".samples.arrows",  # The same rows: Parquet has just been made of it.
        "ship/heaved-20260101T010000Z.samples.arrows",
        "ship/heaved-20260101T010000Z.frames.arrows",
        "ship/heaved-20260101T010000Z.samples.parquet.tmp",
        "ship/.heaved.lock",
        "ship/renamed.parquet",
        ".hidden/c.csv",
        "a.heaved.csv",
        "notes.txt",
    ]
    for name in there:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    units = find_units(tmp_path)
    assert units.names == (
        "a.csv",
        "b.csv",
        "ship/" + HOUR + ".samples.parquet",
        "ship/heaved-20260101T010000Z.samples.arrows",
        "ship/renamed.parquet",
    )
    assert units.left_out == ("a.heaved.csv", "notes.txt")
    assert "a.heaved.csv, notes.txt" in units.remark


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda path: path.mkdir(), "it is empty"),
        (lambda path: None, "there is no such directory"),
        (lambda path: path.write_text("t_s,az_mps2\n"), "is no directory"),
        (lambda path: (path.mkdir(), (path / "notes.txt").touch()), "it holds notes.txt"),
    ],
    ids=["empty", "not there", "a file", "foreign files alone"],
)
def test_nothing_to_be_tested_is_said(tmp_path: Path, make: object, said: str) -> None:
    path = tmp_path / "archive"
    assert callable(make)
    make(path)
    with pytest.raises(BacktestError, match=said):
        find_units(path)
