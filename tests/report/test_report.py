"""Whole reports: their numbers against those worked out from a replay's own table, and recordings of every bad kind."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import os
import re
import sys
from html.parser import HTMLParser
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pytest

from heaved.cli import main
from heaved.config import CompensationParams, Config
from heaved.devices.recording import RecordingError
from heaved.estimation.heave import params as heave
from heaved.estimation.lever_arm import Point
from heaved.replay.replay import replay
from heaved.report.findings import EVERYWHERE, SETTLED, Findings, changed_keys, duration, length
from heaved.report.page import page
from heaved.report.parts import NOT_KNOWN
from heaved.report.report import NO_MATPLOTLIB, ReportError, report
from heaved.report.svg import embedded
from heaved.simulate.play import write_recording
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import Recording, record

if TYPE_CHECKING:
    from pathlib import Path

VOID = {"meta", "br", "hr", "img", "link", "input"}
MADE = "2026-01-01 00:00:00 UTC"
CONFIG = Config(point=(Point(name="crane-tip", forward_m=30.0, port_m=-8.0, up_m=12.0),))


class Document(HTMLParser):
    """Ids, links, texts of table cells by the id of the table; complains of elements that are not closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.ids: list[str] = []
        self.references: list[str] = []
        self.tags: set[str] = set()
        self.attributes: list[tuple[str, str, str]] = []
        self.tables: dict[str, list[list[str]]] = {}
        self.words = ""
        self._table = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            self.attributes.append((tag, name, value or ""))
            if name == "id":
                self.ids.append(value or "")
            if name in ("href", "xlink:href", "src"):
                self.references.append(value or "")
            self.references += re.findall(r"url\(([^)]*)\)", value or "")
        if tag == "table":
            self._table = dict(attrs)["id"] or ""
            self.tables[self._table] = []
        if tag == "tr":
            self.tables[self._table].append([])
        if tag in ("td", "th"):
            self.tables[self._table][-1].append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("td", "th"):
            self.tables[self._table][-1][-1] += data
        self.words += data

    def row(self, table: str, name: str) -> dict[str, str]:
        """Cells of the row of that name, by the heads of their columns."""
        head, *rows = self.tables[f"table-{table}"]
        (row,) = (row for row in rows if row[0] == name)
        return dict(zip(head, row, strict=True))


def checked(path: Path) -> Document:
    """A page that is whole in itself: every anchor is there once, and nothing is asked for from elsewhere."""
    text = path.read_text(encoding="utf-8")
    document = Document(text)
    assert len(document.ids) == len(set(document.ids))
    assert {reference for reference in document.references if not reference.startswith("#")} == set()
    assert {reference[1:] for reference in document.references} <= set(document.ids)
    assert not {"script", "link", "img", "iframe", "object", "foreignobject"} & document.tags
    assert not any(name.startswith("on") for _, name, _ in document.attributes)
    assert "nan" not in re.sub(r"<[^>]*>", " ", text).lower().split()
    return document


def made(source: Path, config: Config = CONFIG, **others: Any) -> tuple[Findings, Document]:
    out = source.with_suffix(".html")
    found = report(source, out, config, made=MADE, command="heaved report x", **others)
    return found, checked(out)


# ---- a whole one -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sea() -> Recording:
    """With the laser for half of the time, so that what is learned of it is among the figures."""
    return record(seaway("S4", seed=4), 200.0, imu_rate_hz=20.0, laser_rate_hz=10.0, sensor="A", laser="50%", seed=4)


@pytest.fixture(scope="module")
def source(sea: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "s4.csv"
    write_recording(path, sea)
    return path


@pytest.fixture(scope="module")
def whole(source: Path) -> tuple[Findings, Document]:
    return made(source, png_directory=source.parent / "png")


@pytest.fixture(scope="module")
def rows(source: Path) -> list[dict[str, str]]:
    """What a replay of the same makes."""
    out = source.with_name("out.csv")
    replay(source, out, CONFIG)
    with out.open(newline="") as file:
        return list(csv.DictReader(file))


def column(rows: list[dict[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name]) if row[name] else math.nan for row in rows])


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def metres(text: str) -> float:
    number, unit = text.split()
    return float(number) * {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[unit]


def test_errors_of_the_heave_are_those_of_the_replay(
    whole: tuple[Findings, Document], rows: list[dict[str, str]]
) -> None:
    found, document = whole
    error = column(rows, "heave_m") - column(rows, "delayed_heave_m")
    std = column(rows, "heave_std_m")
    settled = np.array([row["quality"] in ("valid", "degraded") for row in rows])
    for name, those in ((EVERYWHERE, np.full(len(rows), fill_value=True)), (SETTLED, settled)):
        kept = those & np.isfinite(error) & np.isfinite(std)
        e, s = error[kept], std[kept]
        numbers = found.realtime[name]
        assert numbers.count == len(e) > 1000
        assert numbers.rms == pytest.approx(rms(e), rel=1e-3)
        assert numbers.claimed_rms == pytest.approx(rms(s), rel=1e-3)
        assert numbers.nees == pytest.approx(np.mean((e / s) ** 2), rel=1e-3)
        assert numbers.within == pytest.approx([np.mean(np.abs(e) <= k * s) for k in (1, 2, 3)], abs=2.0 / len(e))
        cells = document.row("realtime", name)
        assert cells["errors"] == str(len(e))
        assert metres(cells["RMS"]) == pytest.approx(rms(e), rel=0.02)
        assert metres(cells["claimed RMS"]) == pytest.approx(rms(s), rel=0.02)
        assert float(cells["2 std"].removesuffix(" %")) == pytest.approx(100.0 * np.mean(np.abs(e) <= 2 * s), abs=0.1)
    value = document.row("figures", "real-time heave, RMS error")["value"]
    assert metres(value) == pytest.approx(rms(error[settled & np.isfinite(error)]), rel=0.02)


@pytest.mark.parametrize("horizon_s", [0.5, 1.0, 5.0])
def test_forecasts_are_held_against_the_moment_that_they_were_for(
    whole: tuple[Findings, Document], rows: list[dict[str, str]], horizon_s: float
) -> None:
    found, document = whole
    later = round(horizon_s * 20.0)
    foretold, std = (column(rows, f"forecast_{horizon_s:g}s{kind}_m")[:-later] for kind in ("", "_std"))
    error = foretold - column(rows, "delayed_heave_m")[later:]
    kept = np.isfinite(error)
    (numbers,) = (one.errors for one in found.forecasts if one.horizon_s == horizon_s)
    assert numbers.count == pytest.approx(np.count_nonzero(kept), abs=2)
    assert numbers.rms == pytest.approx(rms(error[kept]), rel=2e-3)
    assert numbers.nees == pytest.approx(np.mean((error[kept] / std[kept]) ** 2), rel=2e-3)
    assert metres(document.row("forecasts", f"{horizon_s:g} s")["RMS"]) == pytest.approx(rms(error[kept]), rel=0.02)


@pytest.mark.parametrize(("axis", "horizon_s"), [("roll", 0.15), ("roll", 2.0), ("pitch", 0.5)])
def test_predictions_are_held_against_what_was_measured_then(
    whole: tuple[Findings, Document], rows: list[dict[str, str]], sea: Recording, axis: str, horizon_s: float
) -> None:
    found, document = whole
    later = round(horizon_s * 20.0)
    measured = np.degrees(getattr(sea, f"{axis}_rad"))
    predicted, std = (column(rows, f"{axis}_{horizon_s:g}s{kind}_deg")[:-later] for kind in ("", "_std"))
    error = predicted - measured[later:]
    kept = np.isfinite(error) & np.isfinite(std)
    (numbers,) = (one.errors for one in found.rock[axis] if one.horizon_s == horizon_s)
    assert numbers.count == pytest.approx(np.count_nonzero(kept), abs=2)
    assert numbers.rms == pytest.approx(rms(error[kept]), rel=2e-3)
    assert numbers.within[1] == pytest.approx(np.mean(np.abs(error[kept]) <= 2.0 * std[kept]), abs=0.002)
    cells = document.row(f"rock-{axis}", f"{horizon_s:g} s")
    assert float(cells["RMS"].removesuffix("°")) == pytest.approx(rms(error[kept]), abs=6e-4)
    assert 90.0 < float(cells["in 95 % interval"].removesuffix(" %")) <= 100.0


def test_the_laser_is_compared_at_its_own_readings(
    whole: tuple[Findings, Document], rows: list[dict[str, str]], sea: Recording
) -> None:
    """Its constant is followed slowly, so that minute by minute the readings less their own mean are the same."""
    found, document = whole
    numbers = found.laser[SETTLED]
    settled = np.array([row["quality"] in ("valid", "degraded") for row in rows])
    error = np.where(settled, column(rows, "heave_m") - sea.laser_m, math.nan)
    kept = np.isfinite(error)
    # All but what the pipeline itself takes for no reading of this target.
    assert 0.99 * np.count_nonzero(kept) <= numbers.count <= np.count_nonzero(kept)
    parts = [error[begin : begin + 1200] for begin in range(0, len(error), 1200)]
    there = [part[np.isfinite(part)] for part in parts if np.isfinite(part).any()]
    about_mean = np.concatenate([part - part.mean() for part in there])
    assert numbers.rms == pytest.approx(rms(about_mean), rel=0.15)
    assert int(document.row("laser", SETTLED)["errors"]) == numbers.count
    (laser,) = (one for one in found.columns if one.device == "laser")
    assert laser.values == np.count_nonzero(np.isfinite(sea.laser_m))
    assert laser.rate_hz == pytest.approx(10.0)


def test_states_and_reasons_share_the_time(whole: tuple[Findings, Document], rows: list[dict[str, str]]) -> None:
    found, document = whole
    for state, spells in found.quality.items():
        assert spells.seconds == pytest.approx(0.05 * sum(row["quality"] == state for row in rows), abs=1e-6)
    assert found.told_s == pytest.approx(200.0)
    assert found.silent_s == 0.0
    share = float(document.row("states", "settling")["share"].removesuffix(" %"))
    assert share == pytest.approx(100.0 * np.mean([row["quality"] == "settling" for row in rows]), abs=0.1)
    laser = next(one for one in found.reasons if one.text == "laser: no fresh reference")
    assert document.row("reasons", laser.text)["spells"] == str(laser.held.spells)


def test_the_sea_is_that_of_the_simulation(whole: tuple[Findings, Document], sea: Recording) -> None:
    found, document = whole
    truth_m = 4.0 * float(np.std(sea.truth.heave_m))
    assert found.sea.delayed_height_m == pytest.approx(truth_m, rel=0.15)
    assert found.sea.significant_height_m == pytest.approx(truth_m, rel=0.3)
    cell = document.row("sea", "4 std of the delayed heave / m")["median"]
    assert float(cell) == pytest.approx(found.sea.delayed_height_m, rel=0.01)


def test_the_delayed_heave_is_nearer_to_the_truth_than_the_errors_against_it(
    whole: tuple[Findings, Document], rows: list[dict[str, str]], sea: Recording
) -> None:
    """So they are errors of the real-time heave; with its own claim added, they are those against the truth."""
    found, _ = whole
    settled = np.array([row["quality"] in ("valid", "degraded") for row in rows])
    delayed = column(rows, "delayed_heave_m")
    kept = settled & np.isfinite(delayed)
    truth = sea.truth.heave_m[kept]
    assert rms(delayed[kept] - truth) < 0.6 * found.realtime[SETTLED].rms
    assert found.implied_rms_m == pytest.approx(rms(column(rows, "heave_m")[kept] - truth), rel=0.25)


def test_head_and_contents(whole: tuple[Findings, Document], source: Path) -> None:
    found, document = whole
    assert found.source.sha256 == hashlib.sha256(source.read_bytes()).hexdigest()
    (file,) = (row for row in document.tables["table-recording"] if row[0] == "SHA-256")
    assert file[1] == found.source.sha256
    assert ("point[0].forward_m", "30.0") in {tuple(row) for row in document.tables["table-changed"]}
    assert document.row("points", "crane-tip")["significant height"] == length(found.points[0].significant_height_m)
    sections = [key for key in document.ids if key in {reference[1:] for reference in document.references}]
    assert {"figures", "quality", "accuracy", "method", "again"} <= set(sections)


def test_every_figure_is_on_the_page_and_a_picture(whole: tuple[Findings, Document], source: Path) -> None:
    _, document = whole
    pictures = {path.stem: path.read_bytes() for path in (source.parent / "png").iterdir()}
    assert {f"figure-{key}" for key in pictures} == {key for key in document.ids if key.startswith("figure-")}
    assert set(pictures) >= {
        "motion", "quality", "errors", "histogram", "acceleration", "heave-spectrum", "sea", "forecasts", "typical",
        "rock", "rock-stretch", "points", "laser",
    }  # fmt: skip
    assert all(picture.startswith(b"\x89PNG\r\n") for picture in pictures.values())
    # Text is text: it can be searched, copied and read out.
    assert "real-time minus delayed" in document.words
    assert source.with_suffix(".html").stat().st_size < 3_000_000


def test_the_same_again_is_the_same_to_the_byte(source: Path, whole: tuple[Findings, Document]) -> None:
    first = source.with_suffix(".html").read_bytes()
    again = source.with_name("again.html")
    report(source, again, CONFIG, made=MADE, command="heaved report x")
    assert again.read_bytes() == first


def test_heave_for_a_moment_ahead_is_held_against_that_moment(source: Path, tmp_path: Path) -> None:
    """Published half a second ahead, it is what is foretold for half a second otherwise."""
    config = msgspec.structs.replace(CONFIG, compensation=CompensationParams(lead_s=0.5))
    found = report(source, tmp_path / "lead.html", config, made=MADE, command="", until_s=150.0)
    now = report(source, tmp_path / "now.html", CONFIG, made=MADE, command="", until_s=150.0)
    (ahead,) = (one.errors for one in now.forecasts if one.horizon_s == 0.5)
    assert found.realtime[EVERYWHERE].rms == pytest.approx(ahead.rms, rel=0.1)
    assert found.realtime[EVERYWHERE].claimed_rms == pytest.approx(ahead.claimed_rms, rel=0.1)


# ---- bad ones --------------------------------------------------------------------------------------------------------


def written(path: Path, sea: Recording, seconds: float, spoil: str) -> Path:
    """The first seconds of a recording, spoilt."""
    n = round(20.0 * seconds)
    columns = {
        name: getattr(sea, name)[:n].copy()
        for name in ("t_s", "ax_mps2", "ay_mps2", "az_mps2", "roll_rad", "pitch_rad", "yaw_rad", "laser_m")
    }
    names = list(columns)
    if spoil == "vertical alone":
        names = ["t_s", "az_mps2"]
    elif spoil == "nothing vertical":
        columns["az_mps2"][:] = math.nan
    elif spoil == "still":
        columns["az_mps2"][:] = 9.81
    elif spoil == "constant":
        columns |= {name: np.full_like(columns[name], 10.0 * (name == "az_mps2")) for name in names if name != "t_s"}
    elif spoil == "in g":
        columns["az_mps2"] /= 9.81
    elif spoil == "laser alone":
        columns["az_mps2"][:] = math.nan
        names = ["t_s", "az_mps2", "laser_m"]
    elif spoil == "angles lost":
        columns["roll_rad"][n // 2 :] = math.nan
    elif spoil == "silence":
        gap = slice(n // 3, n // 2)
        for name in names:
            columns[name] = np.delete(columns[name], gap)
    elif spoil == "long ago":
        columns["t_s"] += 1.7e9
    elif spoil == "one row":
        columns = {name: values[:1] for name, values in columns.items()}
    with path.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow([name.replace("_rad", "_deg") for name in names])
        for row in zip(*(columns[name].tolist() for name in names), strict=True):
            table.writerow(["" if math.isnan(value) else f"{value:.6f}" for value in row])
    return path


@pytest.mark.parametrize(
    ("spoil", "seconds", "said"),
    [
        ("vertical alone", 110.0, "The recording has no laser."),
        ("nothing vertical", 20.0, "there is nothing to report"),
        ("laser alone", 20.0, "there is nothing to report"),
        ("still", 60.0, "there is no heave"),
        ("constant", 100.0, "there is no heave"),
        ("in g", 60.0, "no sea could be fitted"),
        ("too short", 30.0, "No real-time heave could be compared"),
        ("too short for a delayed heave", 70.0, "There were no forecasts of the heave whose moment"),
        ("one row", 1.0, "no sea could be fitted"),
        ("angles lost", 120.0, "Forecasts of the heave"),
        ("silence", 150.0, "For 24."),
        ("long ago", 70.0, "t_s = 1700000000.000000 s"),
    ],
)
def test_a_bad_recording_has_a_report_that_says_so(
    sea: Recording, tmp_path: Path, spoil: str, seconds: float, said: str
) -> None:
    _, document = made(written(tmp_path / "bad.csv", sea, seconds, spoil))
    assert said in document.words


def test_no_forecasts_and_the_harmonic_observer(sea: Recording, tmp_path: Path) -> None:
    config = Config(heave=heave.Params(observer="harmonic", forecast_horizons_s=()))
    found, document = made(written(tmp_path / "short.csv", sea, 60.0, ""), config)
    assert found.config == {"heave.forecast_horizons_s": (), "heave.observer": "harmonic"}
    assert "There were no forecasts" in document.words


def test_until_ends_it(source: Path, tmp_path: Path) -> None:
    out = tmp_path / "part.html"
    found = report(source, out, CONFIG, made=MADE, command="", until_s=10.0)
    assert found.duration_s == pytest.approx(10.0)
    checked(out)


def test_progress_is_told(source: Path, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    report(source, tmp_path / "x.html", CONFIG, made=MADE, command="", until_s=20.0,
           progress=lambda done, total: told.append((done, total)))  # fmt: skip
    assert told
    assert {total for _, total in told} == {source.stat().st_size}


HOSTILE = '<script>alert(1)</script>"&$x^2$\x1b[31m\u202e日本'


def test_what_a_file_is_called_runs_nothing(sea: Recording, tmp_path: Path) -> None:
    name = '<img src=x onerror=alert(1)>&"$\\frac{1}$\x1b[2J.csv'
    source = written(tmp_path / name, sea, 5.0, "")
    out = tmp_path / "out.html"
    found = report(source, out, Config(), made=MADE, command=f"heaved report {name}", config_name=HOSTILE)
    assert found.source.name == name
    text = out.read_text()
    document = checked(out)
    assert "<img" not in text
    assert "<script" not in text
    assert not re.search("[\x1b\u202e]", text)
    assert '<img src=x onerror=alert(1)>&"$\\frac{1}$\\x1b[2J.csv' in document.words


def test_what_a_reason_says_runs_nothing(whole: tuple[Findings, Document], tmp_path: Path) -> None:
    """Every text that there is among the findings, in its place."""
    found, _ = whole

    def spoilt(value: Any) -> Any:
        if isinstance(value, str):
            return HOSTILE
        if isinstance(value, dict):
            return {key: spoilt(part) for key, part in value.items()}
        if isinstance(value, list):
            return [spoilt(part) for part in value]
        return value

    hostile = msgspec.convert(spoilt(msgspec.to_builtins(found)), Findings)
    out = tmp_path / "hostile.html"
    out.write_text(page(hostile, {}, CONFIG))
    document = checked(out)
    assert "<script" not in out.read_text()
    assert document.words.count("alert(1)") > 10


def test_reasons_of_every_alphabet_can_be_drawn(
    sea: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither a formula nor a letter that the font lacks ends in an error or a warning."""
    from heaved.report.collect import Collector

    take = Collector.take

    def hostile(self: Collector, run: Any, sample: Any, frame: Any) -> None:
        if frame is not None:
            quality = msgspec.structs.replace(frame.quality, reasons=(HOSTILE, "$\\bad{", "x" * 500))
            frame = msgspec.structs.replace(frame, quality=quality)
        take(self, run, sample, frame)

    monkeypatch.setattr(Collector, "take", hostile)
    found, document = made(written(tmp_path / "x.csv", sea, 5.0, ""))
    assert len(found.reasons) == 3
    assert "$\\bad{" in document.words


# ---- faults of a user ------------------------------------------------------------------------------------------------


def test_a_malformed_recording_writes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_text("t_s,az_mps2\n0,9.8\n0.05,9.8\nhello,9.8\n")
    with pytest.raises(RecordingError, match="line 4"):
        report(path, tmp_path / "x.html", Config(), made=MADE, command="")
    assert [file.name for file in tmp_path.iterdir()] == ["bad.csv"]


def test_places_that_cannot_be_written_are_named_before_anything_is_done(source: Path, tmp_path: Path) -> None:
    def too_late(done: int, total: int) -> None:
        pytest.fail("the recording was read")

    def fails(out: Path, png: Path | None = None) -> str:
        with pytest.raises(ReportError) as error:
            report(source, out, CONFIG, made=MADE, command="", png_directory=png, progress=too_late)
        return str(error.value)

    assert "no such directory" in fails(tmp_path / "none" / "x.html")
    assert "is a directory" in fails(tmp_path)
    assert "is the recording itself" in fails(source)
    (tmp_path / "file").touch()
    assert "--png" in fails(tmp_path / "x.html", tmp_path / "file" / "png")


def test_without_matplotlib_it_is_said_how_to_get_it(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in list(sys.modules):
        if name.startswith(("matplotlib", "heaved.report.figures")):
            monkeypatch.delitem(sys.modules, name)
    import heaved.report as package

    monkeypatch.delattr(package, "figures", raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ReportError) as error:
        report(source, tmp_path / "x.html", CONFIG, made=MADE, command="")
    assert str(error.value) == NO_MATPLOTLIB


# ---- the command -----------------------------------------------------------------------------------------------------


def test_the_command(sea: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = written(tmp_path / "my rec.csv", sea, 5.0, "")
    config = tmp_path / "my.toml"
    config.write_text("[heave]\nobserver = 'harmonic'\n")
    arguments = ["report", str(source), "--json", "--config", str(config), "--until", "4", "--png", str(tmp_path / "p")]
    assert main(arguments) == 0
    out, err = capsys.readouterr()
    numbers = json.loads(out)
    assert numbers["rows"] == 81
    assert numbers["config"] == {"heave.observer": "harmonic"}
    assert numbers["config_name"] == "my.toml"
    assert numbers["realtime"]["valid"]["rms"] is None
    assert err == f"written to {tmp_path / 'my rec.report.html'}\n"
    document = checked(tmp_path / "my rec.report.html")
    assert f"heaved report '{source}' --config {config} --until 4" in document.words
    assert (tmp_path / "p" / "motion.png").exists()


def test_a_name_that_is_no_text(sea: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = written(tmp_path / os.fsdecode(b"r\xffn.csv"), sea, 2.0, "")
    assert main(["report", str(source), "-o", str(tmp_path / "x.html"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["source"]["name"] == "r?n.csv"
    checked(tmp_path / "x.html")


def test_the_command_says_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(tmp_path / "none.csv")]) == 1
    assert "none.csv: cannot be read" in capsys.readouterr().err


# ---- small things ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seconds", "text"), [(12.34, "12.3 s"), (200.4, "3 min 20 s"), (3600.0, "1 h 00 min"), (math.nan, NOT_KNOWN)]
)
def test_durations(seconds: float, text: str) -> None:
    assert duration(seconds) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.00321, "3.2 mm"),
        (-0.0414, "-41.4 mm"),
        (-1e-5, "0.0 mm"),
        (0.253, "25.3 cm"),
        (1.254, "1.25 m"),
        (math.nan, NOT_KNOWN),
    ],
)
def test_lengths(value: float, text: str) -> None:
    assert length(value) == text


def test_only_what_was_changed_is_listed() -> None:
    assert changed_keys(Config()) == {}
    assert changed_keys(CONFIG)["point[0].name"] == "crane-tip"


def test_figures_on_one_page_share_no_id() -> None:
    svg = (
        '<?xml version="1.0"?>\n<!DOCTYPE svg>\n<svg xmlns:xlink="http://www.w3.org/1999/xlink" width="504pt" '
        'height="72pt" viewBox="0 0 504 72" xmlns="http://www.w3.org/2000/svg" version="1.1">\n<metadata>x</metadata>'
        '<defs>\n  <style type="text/css">*{a:b}</style>\n </defs><g id="figure_1"><defs><path id="m1" d="M 1.23456 2 '
        '\nL 3 -4.9999"/></defs><use xlink:href="#m1" x="1.005" y="7"/><path clip-path="url(#p9)"/>'
        '<clipPath id="p9"/></g></svg>'
    )
    found = embedded(svg, "motion")
    assert found.startswith("<svg ")
    assert 'viewBox="0 0 504 72"' in found
    assert "pt" not in re.findall(r"<svg[^>]*>", found)[0].replace("linecap:butt", "")
    assert re.findall(r' id="([^"]*)"', found) == ["motion-m1", "motion-p9"]
    assert 'href="#motion-m1"' in found
    assert "url(#motion-p9)" in found
    assert 'd="M 1.23 2 L 3 -5"' in found
    assert "metadata" not in found
    assert "text/css" not in found
