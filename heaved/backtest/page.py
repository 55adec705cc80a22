"""The page of a backtest: configurations beside each other, in one HTML file; every text in it is escaped. Pure."""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING, Final

from heaved.report.findings import duration, length
from heaved.report.parts import (
    NOT_KNOWN,
    decimals,
    document,
    escaped,
    figure,
    missing,
    number,
    paragraph,
    percent,
    table,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from heaved.backtest.compare import Compared, Row
    from heaved.backtest.task import Accuracy, Ahead

MOST_RECORDINGS: Final = 50
"""In the table of them; the Parquet table has all."""
MOST_FAILURES: Final = 50
COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
"""Of Okabe and Ito (2008): apart for every kind of eye."""
DASHES: Final = ("", "6 3", "2 2", "8 3 2 3")
"""When all colours are used, lines differ by these."""
WIDTH, HEIGHT, LEFT, TOP, RIGHT, BOTTOM = 640.0, 300.0, 56.0, 12.0, 12.0, 40.0


def page(
    rows: Sequence[Row], compared: Sequence[Compared], *, directory: str, made: str, release: str, command: str
) -> str:
    """The whole document. ``made``: UTC; ``command``: that makes the same again."""
    sections = (
        ("Configurations", _configurations(compared)),
        ("Heave", _heave(compared)),
        ("Heave forecasts", _ahead("forecasts", "forecast", [(one.configuration, one.forecasts) for one in compared])),
        ("Roll ahead", _ahead("roll", "prediction", [(one.configuration, one.roll) for one in compared])),
        ("Pitch ahead", _ahead("pitch", "prediction", [(one.configuration, one.pitch) for one in compared])),
        ("Recordings", _recordings(rows, compared)),
        ("What failed", _failures(rows)),
        ("Method", "".join(paragraph(text) for text in METHOD)),
    )
    body = "".join(
        f"<section>\n<h2>{place}. {escaped(title)}</h2>\n{told}</section>\n"
        for place, (title, told) in enumerate(sections, start=1)
    )
    words = "".join(paragraph(sentence) for sentence in in_words(rows, compared))
    return document(
        f"Backtest: {directory}",
        f'<header>\n<h1>Backtest</h1>\n<p class="of">{escaped(directory)}, made {escaped(made)} by heaved '
        f'{escaped(release)}</p>\n</header>\n<div class="summary" id="summary">\n{words}</div>\n{body}'
        f"<footer><pre>{escaped(command)}</pre></footer>\n",
    )


def in_words(rows: Sequence[Row], compared: Sequence[Compared]) -> list[str]:
    """The outcome in some sentences."""
    sources = {row.source for row in rows}
    together = compared[0].recordings if compared else 0
    words = [
        f"{_counted(len(compared), 'configuration')} on {_counted(len(sources), 'recording')}; compared over "
        f"{_counted(together, 'recording')} of {duration(compared[0].duration_s if compared else 0.0)} that "
        f"{'it' if len(compared) == 1 else 'all of them'} got through."
    ]
    failed = sum(bool(row.result.failure) for row in rows)
    if failed:
        words.append(f"{_counted(failed, 'task')} failed: the reasons stand below.")
    known = [(one.realtime.rms, one) for one in compared if one.realtime.rms is not None]
    if known:
        parts = [f"{length(rms)} with {one.configuration}" for rms, one in known]
        words.append(f"Once settled, the real-time heave was off from the delayed one by {', '.join(parts)} (RMS).")
    return words


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _value(value: float | None) -> float:
    return nan if value is None else value


def _configurations(compared: Sequence[Compared]) -> str:
    rows = [
        (
            one.configuration,
            one.configuration_sha256[:12],
            *(percent(share) for share in one.shares.values()),
            duration(_value(one.first_valid_s)),
            str(one.never_valid),
            str(one.resets),
            duration(one.run_s),
        )
        for one in compared
    ]
    states = tuple(compared[0].shares) if compared else ()
    return table(
        "configurations",
        ("configuration", "SHA-256", *states, "first valid", "never valid", "resets", "computing"),
        rows,
        "Share of the time in each state of the heave; median time from the first sample to the first valid heave, "
        "and recordings without one; resets of estimators; time of one processor.",
        words=(0, 1),
    )


ERROR_HEAD: Final = ("errors", "RMS", "claimed RMS", "NEES", "within 1 std", "2 std", "3 std")


def _error_cells(errors: Accuracy, unit: Callable[[float], str]) -> tuple[str, ...]:
    return (
        str(errors.count),
        unit(_value(errors.rms)),
        unit(_value(errors.claimed_rms)),
        number(_value(errors.nees)),
        *(percent(_value(share)) for share in (errors.within_1std, errors.within_2std, errors.within_3std)),
    )


def _heave(compared: Sequence[Compared]) -> str:
    told = table(
        "realtime",
        ("configuration", *ERROR_HEAD, "right NEES", "better", "worse"),
        [
            (
                one.configuration,
                *_error_cells(one.realtime, length),
                number(_value(one.expected_nees)),
                *((str(one.better), str(one.worse)) if place else (NOT_KNOWN, NOT_KNOWN)),
            )
            for place, one in enumerate(compared)
        ],
        "Real-time minus delayed heave, once settled; right: the NEES, were every claim right. Better and worse: "
        "recordings with a smaller and a greater RMS than with the first configuration.",
    )
    if not any(one.laser.count for one in compared):
        return told + missing("No recording has a laser with which the heave could be compared.")
    return told + table(
        "laser",
        ("configuration", *ERROR_HEAD),
        [(one.configuration, *_error_cells(one.laser, length)) for one in compared],
        "Real-time heave minus laser, once settled; the claim holds the noise of a reading.",
    )


def _ahead(key: str, what: str, ahead: Sequence[tuple[str, Sequence[Ahead]]]) -> str:
    """RMS by horizon: drawn, and as a table with a column for each configuration."""
    is_heave = key == "forecasts"
    by_name = {
        name: {one.horizon_s: one.errors for one in horizons if one.errors.rms is not None} for name, horizons in ahead
    }
    horizons_s = sorted({horizon_s for errors in by_name.values() for horizon_s in errors})
    if not horizons_s:
        return missing(f"There is no {what} whose moment has something to be compared with.")
    scale, unit = (1000.0, "mm") if is_heave else (1.0, "°")
    lines = {
        name: [(h, scale * rms) for h, one in sorted(errors.items()) if (rms := one.rms) is not None]
        for name, errors in by_name.items()
    }
    shown: Callable[[float], str] = length if is_heave else (lambda value: f"{decimals(value, 3)}°")

    def cell(errors: Accuracy | None) -> str:
        if errors is None or errors.rms is None:
            return NOT_KNOWN
        return f"{shown(errors.rms)} ({number(_value(errors.nees))})"

    return figure(
        {key: lines_drawn(lines, "horizon / s", f"RMS error / {unit}")},
        key,
        f"RMS error of each {what} by how far it looks ahead, one line for each configuration.",
    ) + table(
        key,
        ("horizon", *by_name),
        [(f"{h:g} s", *(cell(errors.get(h)) for errors in by_name.values())) for h in horizons_s],
        f"RMS error of each {what}, and its NEES in brackets (1: a right claim).",
    )


def lines_drawn(lines: dict[str, list[tuple[float, float]]], across: str, up: str) -> str:
    """An SVG element of lines through their points, by name, over axes that begin at zero."""
    points = [point for line in lines.values() for point in line]
    most_x, most_y = (_round_up(max(one[axis] for one in points)) for axis in (0, 1))
    wide, high = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM

    def at(x: float, y: float) -> str:
        return f"{LEFT + wide * x / most_x:.1f},{TOP + high * (1.0 - y / most_y):.1f}"

    parts = [f'<svg class="figure" role="img" viewBox="0 0 {WIDTH:g} {HEIGHT + 16.0 * len(lines):g}" font-size="11">']
    for k in range(6):
        y = TOP + high * (1.0 - k / 5.0)
        x = LEFT + wide * k / 5.0
        parts.append(f'<path d="M{LEFT:g} {y:.1f}h{wide:g}" stroke="#ddd"/>')
        parts.append(f'<text x="{LEFT - 5.0:g}" y="{y + 4.0:.1f}" text-anchor="end">{most_y * k / 5.0:.3g}</text>')
        parts.append(f'<text x="{x:.1f}" y="{TOP + high + 15.0:g}" text-anchor="middle">{most_x * k / 5.0:.3g}</text>')
    middle = TOP + high / 2.0
    parts.append(f'<text x="{LEFT + wide / 2.0:g}" y="{HEIGHT - 8.0:g}" text-anchor="middle">{escaped(across)}</text>')
    parts.append(
        f'<text x="12" y="{middle:g}" text-anchor="middle" transform="rotate(-90 12 {middle:g})">{escaped(up)}</text>'
    )
    for place, (name, line) in enumerate(lines.items()):
        colour, dash = COLOURS[place % len(COLOURS)], DASHES[place // len(COLOURS) % len(DASHES)]
        style = f'stroke="{colour}" fill="none" stroke-width="2" stroke-dasharray="{dash or "none"}"'
        y = HEIGHT + 16.0 * place + 4.0
        parts.append(f'<polyline points="{" ".join(at(*point) for point in line)}" {style}/>')
        parts += [f'<circle cx="{x}" cy="{y}" r="2.5" fill="{colour}"/>' for x, y in (at(*p).split(",") for p in line)]
        parts.append(f'<path d="M{LEFT:g} {y:g}h24" {style}/>')
        parts.append(f'<text x="{LEFT + 30.0:g}" y="{y + 4.0:g}">{escaped(name)}</text>')
    return "\n".join(parts) + "\n</svg>"


def _round_up(value: float) -> float:
    """To a number that five parts of an axis can be labelled with."""
    if value <= 0.0:
        return 1.0
    decade = float(f"1e{f'{value:e}'.partition('e')[2]}")
    return next(step * decade for step in (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0) if step * decade >= value)


def _recordings(rows: Sequence[Row], compared: Sequence[Compared]) -> str:
    """RMS of the heave of each recording, by configuration; the worst first."""
    by_source: dict[str, dict[str, Row]] = {}
    for row in rows:
        if not row.result.failure:
            by_source.setdefault(row.source, {})[row.configuration] = row
    if not by_source:
        return missing("No recording could be tested.")

    def rms(row: Row | None) -> float:
        return nan if row is None or row.result.realtime is None else _value(row.result.realtime.rms)

    def worst(source: str) -> float:
        return max((value for row in by_source[source].values() if (value := rms(row)) == rms(row)), default=-1.0)

    names = [one.configuration for one in compared]
    shown = sorted(by_source, key=lambda source: (-worst(source), source))[:MOST_RECORDINGS]
    cells = []
    for source in shown:
        result = next(iter(by_source[source].values())).result
        cells.append(
            (
                source,
                duration(result.duration_s),
                length(_value(result.significant_height_m)),
                f"{number(_value(result.peak_period_s))} s",
                *(length(rms(by_source[source].get(name))) for name in names),
            )
        )
    more = len(by_source) - len(shown)
    return table(
        "recordings",
        ("recording", "length", "significant height", "peak period", *names),
        cells,
        "RMS of real-time minus delayed heave once settled, by configuration; the greatest first."
        + (f" {more} more stand in the Parquet table." if more > 0 else ""),
    )


def _failures(rows: Sequence[Row]) -> str:
    failed = [row for row in rows if row.result.failure]
    if not failed:
        return paragraph("Nothing.")
    more = len(failed) - MOST_FAILURES
    return table(
        "failures",
        ("recording", "configuration", "reason"),
        [(row.source, row.configuration, row.result.failure) for row in failed[:MOST_FAILURES]],
        f"{more} more stand in the Parquet table." if more > 0 else "",
        words=(0, 1, 2),
    )


METHOD: Final = (
    "Each recording went, sample by sample, through the program that runs on board, once with each configuration. A "
    "recording is a CSV file, or one hour of what a daemon has recorded, which begins as a restart would then: what "
    "comes of it depends on this file and on the configuration alone.",
    "Without a configuration, a daemon's recording is replayed with its own and takes the models that the daemon had; "
    "with one, everything is learned anew. Configurations are only compared with each other.",
    "Errors of several recordings are taken together with the weight of their number, over recordings that every "
    "configuration got through: none looks better because the hard ones failed with it.",
    "The delayed heave comes from the same sensor as the real-time one: an error of its scale or mounting does not "
    "show. Errors that follow each other closely are not independent: small differences mean nothing. Where a laser "
    "aids the heave, their difference says less than it seems to.",
)
