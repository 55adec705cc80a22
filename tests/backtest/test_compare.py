"""Configurations beside each other, the table and the page: against all errors taken together by hand."""

from __future__ import annotations

import io
from html.parser import HTMLParser

import numpy as np
import pyarrow.parquet as pq
import pytest

from heaved.backtest.compare import Row, common, compared, together
from heaved.backtest.page import lines_drawn, page
from heaved.backtest.table import parquet
from heaved.backtest.task import Ahead, Result, accuracy
from heaved.report.statistics import Errors

rng = np.random.default_rng(7)
PARTS = [(rng.normal(0.0, 0.03, n), np.full(n, claim)) for n, claim in ((500, 0.02), (40, 0.05), (1500, 0.03))]


def errors_of(error: np.ndarray, std: np.ndarray) -> Errors:
    errors = Errors()
    errors.push(np.arange(len(error), dtype=float), error, std)
    return errors


def row(source: str, name: str, rms: float, **changes: object) -> Row:
    errors = accuracy(errors_of(np.array([rms, -rms]), np.array([0.1, 0.1])).statistics())
    result = Result(
        realtime=errors, laser=errors, forecasts=(Ahead(horizon_s=1.0, errors=errors),), duration_s=10.0,
        shares={"valid": 0.5}, first_valid_s=3.0, expected_nees=0.9,
    )  # fmt: skip
    if changes:
        result = Result(**changes)  # type: ignore[arg-type]
    return Row(source=source, configuration=name, configuration_sha256="0" * 64, release="0", result=result)


def test_errors_of_parts_are_those_of_the_whole() -> None:
    whole = errors_of(*(np.concatenate(columns) for columns in zip(*PARTS, strict=True))).statistics()
    found = together(
        [None, *(accuracy(errors_of(*part).statistics()) for part in PARTS), accuracy(Errors().statistics())]
    )
    assert found.count == whole.count
    for name in ("rms", "claimed_rms", "nees"):
        assert getattr(found, name) == pytest.approx(getattr(whole, name), rel=1e-12), name
    assert (found.within_1std, found.within_2std, found.within_3std) == pytest.approx(whole.within)


def test_nothing_is_compared_that_one_did_not_get_through() -> None:
    """A recording that is hard, and that only one configuration survives, must not speak against that one."""
    rows = [
        row("easy", "brave", 0.1), row("hard", "brave", 5.0), row("other", "brave", 0.2),
        row("easy", "meek", 0.3), row("hard", "meek", 0.0, failure="no"), row("other", "meek", 0.1),
    ]  # fmt: skip
    assert common(rows) == ["easy", "other"]
    brave, meek = compared(rows)
    assert brave.realtime.rms == pytest.approx(np.sqrt((0.1**2 + 0.2**2) / 2.0))
    assert meek.forecasts[0].errors.rms == pytest.approx(np.sqrt((0.3**2 + 0.1**2) / 2.0))
    assert (meek.better, meek.worse) == (1, 1)
    assert (brave.recordings, brave.duration_s, brave.shares["valid"]) == (2, 20.0, 0.5)


def test_all_have_failed() -> None:
    rows = [row("a", "one", 0.0, failure="no"), row("a", "two", 0.0, failure="neither")]
    one, _ = compared(rows)
    assert (one.recordings, one.realtime.rms, one.first_valid_s) == (0, None, None)
    assert "neither" in page(rows, compared(rows), directory="d", made="", release="", command="")
    assert pq.read_table(io.BytesIO(parquet(rows))).column("failure").to_pylist() == ["no", "neither"]


def test_the_table_has_everything() -> None:
    rows = [row("a", "one", 0.1), row("b", "one", 0.0, failure="torn")]
    good, bad = pq.read_table(io.BytesIO(parquet(rows))).to_pylist()
    assert good["realtime_rms_m"] == pytest.approx(0.1)
    assert good["forecasts"][0]["horizon_s"] == 1.0
    assert good["forecasts"][0]["rms_m"] == pytest.approx(0.1)
    assert (good["share_valid"], good["share_invalid"], good["failure"]) == (0.5, None, None)
    assert {name: value for name, value in bad.items() if value is not None} == {
        "source": "b", "configuration": "one", "configuration_sha256": "0" * 64, "release": "0", "failure": "torn",
    }  # fmt: skip


class Tags(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.seen: set[str] = set()
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.add(tag)
        if tag not in {"meta", "path", "circle", "polyline"}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.add(tag)


def test_the_page_is_whole_and_runs_nothing() -> None:
    evil = "<script>alert(1)</script>\"'&\x1b[2J"
    rows = [row(evil, evil, 0.1), row(evil, "two", 0.2), row("c", evil, 0.0, failure=evil), row("c", "two", 1.0)]
    text = page(rows, compared(rows), directory=evil, made=evil, release=evil, command=evil)
    tags = Tags(text)
    assert tags.open == []
    assert not {"script", "img", "link", "iframe"} & tags.seen
    assert "\x1b" not in text
    assert "nan" not in text
    assert len(text) < 40_000


def test_lines_are_drawn_where_they_are() -> None:
    """The greatest value of these is the end of both axes."""
    svg = lines_drawn({"one": [(0.0, 0.0), (5.0, 2.0)]}, "x", "y")
    assert 'points="56.0,260.0 628.0,12.0"' in svg
