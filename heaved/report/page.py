"""The page: one HTML file that needs nothing from elsewhere and runs nothing; every text in it is escaped."""

from __future__ import annotations

from html import escape
from math import isfinite
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.report.findings import EVERYWHERE, SETTLED, duration, in_words, keys, length
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
from heaved.report.statistics import EXPECTED
from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from heaved.config import Config
    from heaved.report.findings import Findings, HorizonErrors
    from heaved.report.statistics import ErrorStatistics
    from heaved.report.timeline import Spells


def page(found: Findings, figures: Mapping[str, str], config: Config) -> str:
    """The whole document. ``figures``: SVG elements by key; what is missing is said to be."""
    sections: list[tuple[str, str, Callable[[], str]]] = [
        ("figures", "Key figures", lambda: _key_figures(found)),
        ("recording", "The recording", lambda: _recording(found)),
        ("motion", "Motion", lambda: _motion(figures)),
        ("quality", "What could be believed, and when", lambda: _quality(found, figures)),
        ("accuracy", "Heave: errors and claims", lambda: _accuracy(found, figures)),
        ("sea", "Sea and spectra", lambda: _sea(found, figures)),
        ("forecasts", "Heave forecasts", lambda: _forecasts(found, figures)),
        ("stretches", "Stretches as they were", lambda: _stretches(figures)),
        ("rock", "Roll and pitch ahead", lambda: _rock(found, figures)),
        ("points", "Monitoring points", lambda: _points(found, figures)),
        ("sensors", "Sensors", lambda: _sensors(found)),
        ("learned", "What was learned", lambda: _learned(found, figures)),
        ("configuration", "Configuration", lambda: _configuration(found, config)),
        ("method", "Method and limits", lambda: _method(found)),
        ("again", "The same report again", lambda: _again(found)),
    ]
    contents = "".join(f'<li><a href="#{key}">{escaped(title)}</a></li>\n' for key, title, _ in sections)
    bodies = "".join(
        f'<section id="{key}">\n<h2>{place}. {escaped(title)}</h2>\n{body()}</section>\n'
        for place, (key, title, body) in enumerate(sections, start=1)
    )
    words = "".join(f"<p>{escaped(sentence)}</p>\n" for sentence in in_words(found))
    name = escaped(found.source.name)
    return document(
        f"Motion report: {found.source.name}",
        f'<header>\n<h1>Motion report</h1>\n<p class="of">{name}, {escaped(duration(found.duration_s))}, '
        f"made {escaped(found.made)} by heaved {escaped(found.release)}</p>\n</header>\n"
        f'<div class="summary" id="summary">\n{words}</div>\n<nav aria-label="Contents"><ol>\n{contents}</ol></nav>\n'
        f"{bodies}<footer><p>heaved {escaped(found.release)}; recording SHA-256 "
        f"{escaped(found.source.sha256 or NOT_KNOWN)}</p></footer>\n",
    )


def _at(found: Findings, t_s: float) -> str:
    """A time of the recording, from its first sample."""
    return f"{t_s - found.begin_s:.1f} s" if isfinite(t_s) else NOT_KNOWN


# --- sections --------------------------------------------------------------------------------------------------------


def _key_figures(found: Findings) -> str:
    settled, laser, sea = found.realtime[SETTLED], found.laser[SETTLED], found.sea
    rows = [
        ("duration", duration(found.duration_s), f"{found.rows} rows, {found.frames} frames"),
        ("rate", f"{number(found.rate_hz)} Hz", "of the samples of the IMU"),
        (
            "significant height of the heave",
            f"{number(sea.significant_height_m)} m",
            f"median of {sea.fits} fits; 4 std of the delayed heave: {number(sea.delayed_height_m)} m",
        ),
        ("peak period", f"{number(sea.peak_period_s)} s", f"mean period m0/m1 {number(sea.mean_period_s)} s"),
        (
            "real-time heave, RMS error",
            length(settled.rms),
            f"against the delayed heave, once settled; claimed {length(settled.claimed_rms)}",
        ),
        (
            "real-time heave, within 2 claimed std",
            percent(settled.within[1]),
            f"of {settled.count} errors; a right claim: {percent(EXPECTED[1])}",
        ),
        (
            "delayed heave, claimed std",
            length(found.delayed_std_rms_m),
            "RMS of what it says about its own error",
        ),
        (
            "real-time heave minus laser, RMS",
            length(laser.rms),
            f"{laser.count} readings, once settled; claimed {length(laser.claimed_rms)}",
        ),
    ]
    rows += [
        (
            f"heave {one.horizon_s:g} s ahead, RMS error",
            length(one.errors.rms),
            f"claimed {length(one.errors.claimed_rms)}",
        )
        for one in found.forecasts
        if one.horizon_s in (1.0, 5.0)
    ]
    rows += [
        (f"{axis}, standard deviation", f"{number(std)} °", "about its mean")
        for axis, std in (("roll", found.roll_std_deg), ("pitch", found.pitch_std_deg))
    ]
    usable = sum(found.share(found.quality[state]) for state in ("valid", "degraded"))
    rows.append(("time with a usable heave", percent(usable), "valid or degraded"))
    return table("figures", ("quantity", "value", ""), rows, words=(0, 2))


def _recording(found: Findings) -> str:
    source = found.source
    rows = [
        ("file", source.name),
        ("size", f"{source.size_bytes} bytes" if source.sha256 else NOT_KNOWN),
        ("SHA-256", source.sha256 or NOT_KNOWN),
        ("columns", ", ".join(source.columns)),
        ("first time", f"t_s = {found.begin_s:.6f} s" if isfinite(found.begin_s) else NOT_KNOWN),
        ("length", f"{duration(found.duration_s)} ({found.duration_s:.2f} s)"),
        ("rows, frames", f"{found.rows}, {found.frames}"),
        ("samples of the IMU", f"every {number(1.0 / found.rate_hz)} s ({number(found.rate_hz)} Hz), usually"),
        ("sensor lines", "; ".join(found.devices) or "none are configured: a recording carries none"),
        ("release", f"heaved {found.release}"),
        ("configuration", found.config_name or "all keys at their defaults"),
        ("made", found.made),
    ]
    return table("recording", ("", ""), rows, words=(0, 1))


def _motion(figures: Mapping[str, str]) -> str:
    return figure(
        figures,
        "motion",
        "Heave (up), roll (port side up) and pitch (bow up): least and greatest value of each bin of time. The dashed "
        "line is twice the standard deviation that was claimed for the heave.",
    ) or missing("There is no heave and there are no angles to be shown.")


def _quality(found: Findings, figures: Mapping[str, str]) -> str:
    if found.told_s <= 0.0:
        return missing("There are no frames.")
    told = figure(
        figures,
        "quality",
        "Above: share of each bin of time in each state; where there is none, there were no samples. Below: when each "
        "reason was given, with its share of the time.",
    )
    told += table(
        "states",
        ("state", "share", "time", "spells", "longest", "first", "last until"),
        [
            (
                state,
                percent(found.share(one)),
                duration(one.seconds),
                str(one.spells),
                duration(one.longest_s),
                _at(found, one.first_s),
                _at(found, one.last_s),
            )
            for state, one in found.quality.items()
        ]
        + [
            (
                "no samples",
                percent(found.silent_s / (found.told_s + found.silent_s)),
                duration(found.silent_s),
                "",
                "",
                "",
                "",
            )
        ],
        "State of the heave. A frame's state holds until the next one, and for one second at most.",
    )
    if not found.reasons:
        return told + paragraph("No frame gave a reason to doubt its heave.")
    return told + table(
        "reasons",
        ("reason", "share", "time", "spells", "longest", "first", "last until"),
        [
            (
                reason.text + (" (later with other numbers)" if reason.varies else ""),
                percent(found.share(reason.held)),
                duration(reason.held.seconds),
                str(reason.held.spells),
                duration(reason.held.longest_s),
                _at(found, reason.held.first_s),
                _at(found, reason.held.last_s),
            )
            for reason in found.reasons
        ],
        "Every reason that frames gave, the longest first; times from the first sample.",
    )


ERROR_HEAD: Final = (
    "errors",
    "mean",
    "RMS",
    "claimed RMS",
    "claimed median",
    "NEES",
    "within 1 std",
    "2 std",
    "3 std",
    "worst",
)


def _error_cells(errors: ErrorStatistics, unit: Callable[[float], str]) -> tuple[str, ...]:
    return (
        str(errors.count),
        unit(errors.mean),
        unit(errors.rms),
        unit(errors.claimed_rms),
        unit(errors.claimed_median),
        number(errors.nees),
        *(percent(share) for share in errors.within),
        unit(errors.worst),
    )


def _error_table(key: str, errors: Mapping[str, ErrorStatistics], caption: str) -> str:
    expected = ("a right claim", "", "0", "", "as claimed", "", "1", *(percent(share) for share in EXPECTED), "")
    rows = [(state, *_error_cells(one, length)) for state, one in errors.items() if one.count or state == SETTLED]
    return table(key, ("state", *ERROR_HEAD), [*rows, expected], caption)


def _accuracy(found: Findings, figures: Mapping[str, str]) -> str:
    told = figure(
        figures,
        "errors",
        "Errors between their least and greatest value in each bin of time, with twice the standard deviation claimed "
        "then; below, the mean square of error over claim (NEES) in sixty parts of the time: 1 is a right claim, more "
        "is too bold, less too careful.",
    )
    told += figure(
        figures,
        "histogram",
        "Errors over the standard deviation claimed for each, and the normal distribution claimed.",
    )
    if found.realtime[EVERYWHERE].count:
        told += _error_table(
            "realtime",
            found.realtime,
            "Real-time heave minus delayed heave of the same moment, by the state of the frame.",
        )
        told += paragraph(
            f"The delayed heave is made of the same samples and of those of the minute after. It has part of the same "
            f"error, so that with every claim right the NEES would be {number(found.expected_nees)}; with what is "
            f"claimed for it added in square, the settled real-time heave is off by {length(found.implied_rms_m)} RMS. "
            f"Errors follow each other closely: by their spectrum they are worth "
            f"{number(found.independent_errors)} independent ones, and the NEES scatters by "
            f"{number(found.nees_scatter)} (1 std) by chance alone."
        )
    else:
        told += missing(
            "No real-time heave could be compared with a delayed one: that is known a minute later, and only where "
            "there is a heave at all."
        )
    if found.laser[EVERYWHERE].count:
        told += _error_table(
            "laser",
            found.laser,
            "Real-time heave minus laser, at the readings that were accepted; the claim holds the noise of a reading.",
        )
        told += paragraph(
            "The laser's constant (mounting, tide, target) is followed slowly, with a time constant of a minute by "
            "default, so errors that are slower do not show here. What the laser has taught is in the heave."
        )
    elif found.has_laser:
        told += missing("The recording has a laser, but none of its readings could be compared with the heave.")
    else:
        told += missing("The recording has no laser.")
    return told


def _sea(found: Findings, figures: Mapping[str, str]) -> str:
    sea = found.sea
    told = figure(
        figures,
        "acceleration",
        "Vertical acceleration, gravity and (where there are angles) tilt removed: averaged periodogram (Welch, Hann) "
        "over the whole recording, and the mean of all fits in the time that each was in force. What is faster than "
        "half the rate of the samples shows at another frequency.",
    )
    told += figure(figures, "heave-spectrum", "Spectra of the heave, of its error and of the fitted sea.")
    told += figure(figures, "sea", "Significant height and periods of the heave, fit by fit.")
    if sea.fits == 0:
        return told + missing("No sea was fitted: the recording is too short, or has no acceleration that can be used.")
    return told + table(
        "sea",
        ("quantity", "median", "least", "greatest"),
        [
            (
                "significant height of the heave / m",
                number(sea.significant_height_m),
                number(sea.least_height_m),
                number(sea.greatest_height_m),
            ),
            (
                "peak period / s",
                number(sea.peak_period_s),
                number(sea.shortest_peak_period_s),
                number(sea.longest_peak_period_s),
            ),
            ("mean period m0/m1 / s", number(sea.mean_period_s), "", ""),
            ("4 std of the real-time heave / m", number(sea.heave_height_m), "", ""),
            ("4 std of the delayed heave / m", number(sea.delayed_height_m), "", ""),
            ("accelerometer noise / (mm/s²)/√Hz", number(1e3 * sea.noise_mps2_rthz), "", ""),
            ("walk of its bias / (mm/s²)/√s", number(1e3 * sea.bias_walk_mps2_rts), "", ""),
        ],
        f"The sea as the vessel's heave shows it, over {sea.fits} fits. At the end: {sea.systems or 'no waves'}."
        + (f" {sea.vibration[:1].upper()}{sea.vibration[1:]}." if sea.vibration else ""),
    )


def _ahead_table(key: str, ahead: Sequence[HorizonErrors], unit: Callable[[float], str], caption: str) -> str:
    with_interval = any(isfinite(one.errors.interval) for one in ahead)
    head = ("horizon", *ERROR_HEAD, *(("in 95 % interval",) if with_interval else ()))
    rows = [
        (
            f"{one.horizon_s:g} s",
            *_error_cells(one.errors, unit),
            *((percent(one.errors.interval),) if with_interval else ()),
        )
        for one in ahead
    ]
    return table(key, head, rows, caption)


def _forecasts(found: Findings, figures: Mapping[str, str]) -> str:
    if not any(one.errors.count for one in found.forecasts):
        return missing("There were no forecasts of the heave whose moment has a delayed heave.")
    return figure(
        figures,
        "forecasts",
        "Left: RMS error of the forecasts against the delayed heave of the moment that they were for, and what was "
        "claimed. Right: share of the errors within each claimed interval; below the diagonal the claim is too bold.",
    ) + _ahead_table(
        "forecasts", found.forecasts, length, "Forecast minus delayed heave of the foretold moment, all published ones."
    )


def _stretches(figures: Mapping[str, str]) -> str:
    told = figure(
        figures,
        "typical",
        "A typical minute: of evenly spaced ones that with the median NEES. Each forecast is drawn at the moment that "
        "it was for, with twice the standard deviation claimed for it.",
    )
    told += figure(
        figures, "worst", "The worst minute: that with the greatest NEES of the real-time heave in the whole recording."
    )
    return told or missing("There is no minute with both a real-time and a delayed heave.")


def _rock(found: Findings, figures: Mapping[str, str]) -> str:
    axes = [axis for axis, ahead in found.rock.items() if any(one.errors.count for one in ahead)]
    if not axes:
        return missing(
            "There are no predictions of roll and pitch to be compared with angles: the recording has no angles that "
            "could be used."
        )
    told = figure(
        figures,
        "rock",
        "Left: RMS error of the predictions against the angle measured then, and the standard deviation claimed. "
        "Right: share of the errors within each claimed interval of a normal error.",
    )
    told += figure(figures, "rock-stretch", "The same typical minute: angles as measured and as predicted.")
    for axis in axes:
        told += _ahead_table(
            f"rock-{axis}",
            found.rock[axis],
            _degrees,
            f"Predicted minus measured {axis}; the interval is the one given.",
        )
    return told


def _degrees(value: float) -> str:
    return f"{decimals(value, 3)}°" if isfinite(value) else NOT_KNOWN


def _points(found: Findings, figures: Mapping[str, str]) -> str:
    if not found.points:
        return missing("No monitoring points are configured.")
    return figure(
        figures, "points", "Heave of the monitoring points: least and greatest value of each bin of time."
    ) + table(
        "points",
        ("point", "significant height", "lowest", "highest", "claimed std"),
        [
            (
                point.name,
                length(point.significant_height_m),
                length(point.lowest_m),
                length(point.highest_m),
                length(point.claimed_rms_m),
            )
            for point in found.points
        ],
        "Heave of the monitoring points, from that of the IMU, the attitude and the lever arm. There is nothing to "
        "compare it with.",
    )


def _sensors(found: Findings) -> str:
    if not found.columns:
        return missing("The recording has no values.")
    told = table(
        "columns",
        ("column", "values", "rate / Hz", "jitter / ms", "gaps", "missing / s", "longest gap / s", "unchanged / s"),
        [
            (
                f"{one.device} {one.column}",
                str(one.values),
                number(one.rate_hz),
                decimals(1e3 * one.jitter_s, 2),
                str(one.gaps),
                decimals(one.missing_s, 2),
                decimals(one.longest_gap_s, 2),
                decimals(one.unchanged_s, 2),
            )
            for one in found.columns
        ],
        "When the values of each column came. A gap is an interval of more than two and a half usual ones; unchanged "
        "is the longest time without another value.",
    )
    told += table(
        "values",
        ("column", "least", "mean", "greatest", "standard deviation"),
        [
            (f"{one.device} {one.column}", *(number(value, 4) for value in (one.least, one.mean, one.most, one.std)))
            for one in found.columns
        ],
        "What they were, in the unit of the column's name, as recorded: before any reading is judged.",
    )
    learned = found.learned
    told += table(
        "judged",
        ("judged by the pipeline", "count"),
        [
            ("accelerations refused (spikes, impossible values)", str(learned.spikes)),
            ("means of 50 ms kept out of the heave by its own gate", str(learned.rejected)),
            ("samples that came out of order", str(learned.out_of_order)),
            *((f"faults: {name}", str(count)) for name, count in found.faults.items()),
        ],
    )
    return told


def _learned(found: Findings, figures: Mapping[str, str]) -> str:
    learned = found.learned
    told = figure(
        figures,
        "laser",
        "What the laser has taught: lead of the accelerometer over the truth, and the learned correction.",
    )
    rows = [
        ("fits of the sea", _counted(learned.fits)),
        ("lead of the observer at the end", f"{number(1e3 * learned.lead_s)} ms"),
        (
            "of it learned from the laser",
            f"{number(1e3 * learned.learned_lead_s)} ms, {learned.comparisons} comparisons",
        ),
        ("scale of the accelerometer", f"{number(learned.gain, 4)}"),
        ("constant of the laser", f"{number(learned.laser_constant_m, 4)} m"),
        ("training windows", _counted(learned.trainings)),
        ("correction, RMS", length(learned.correction_rms_m)),
        ("state of the correction", _states(found, found.corrections)),
        ("state of the laser", _states(found, found.laser_states)),
    ]
    if learned.failure:
        rows.append(("a fit died of", learned.failure))
    if not found.has_laser:
        told += missing("Without a laser neither lead, scale nor correction are learned.")
    return told + table("learned", ("", ""), rows, words=(0, 1))


def _counted(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in sorted(counts.items())) or "none"


def _states(found: Findings, states: Mapping[str, Spells]) -> str:
    shares = [(name, found.share(one)) for name, one in states.items()]
    return ", ".join(f"{name} {percent(share)}" for name, share in shares) or NOT_KNOWN


def _configuration(found: Findings, config: Config) -> str:
    changed = (
        table(
            "changed",
            ("key", "value"),
            [(path, _value(value)) for path, value in found.config.items()],
            "Keys that are not at their default.",
            words=(0, 1),
        )
        if found.config
        else paragraph("Every key that changes the result is at its default.")
    )
    all_keys = "\n".join(f"{path} = {_value(value)}" for path, value in keys(config).items())
    return (
        f"{changed}<details><summary>All keys that a replay uses</summary>\n"
        f"<pre>{escape(all_keys, quote=True)}</pre></details>\n"
    )


def _value(value: object) -> str:
    return printable(msgspec.json.encode(value).decode())


METHOD: Final = (
    (
        "What was done",
        "The recording went, sample by sample and in order of time, through the same program that runs on board. "
        "Nothing that is called real time, forecast or predicted has seen a later sample. The same file and "
        "configuration give the same numbers.",
    ),
    (
        "Claimed",
        "Every published value comes with the standard deviation of its error, made before the error is known. Claims "
        "are tested here: of normal errors 68.3 % lie within one claimed standard deviation, 95.4 % within two, 99.7 % "
        "within three, and the mean square of error over claim (NEES, normalised estimation error squared) is 1.",
    ),
    (
        "Delayed heave",
        "A minute later the same heave is known several times better, from the samples before and after its moment "
        "(fixed-lag smoothing). It is the yardstick where there is no laser. It comes from the same sensor: an error "
        "of the sensor's scale or mounting is in both and does not show. Its own claimed error is given among the key "
        "figures.",
    ),
    (
        "Errors",
        "Estimate minus yardstick, at the moment for which the estimate was made; between two values of the delayed "
        "heave on a straight line, and not at all where it has a hole. Predictions of roll and pitch are held against "
        "the nearest reading, which has noise of its own. The statistics are of every frame, not of those that "
        "are drawn.",
    ),
    (
        "Spectra",
        "Averages of periodograms of Hann segments with half overlap, each less its straight line; segments with a "
        "hole are left out. They are as long (32 to 256 s) as still leaves eight of them.",
    ),
    (
        "Limits",
        "Errors of neighbouring frames are not independent: shares of a short recording scatter. The heave has no "
        "mean and nothing slower than about 28 s. Significant heights are of the vessel's heave, not of the waves. "
        "Vibration at a multiple of the sensor's rate reads as waves, and nothing here can tell.",
    ),
)


def _method(found: Findings) -> str:
    told = "".join(f"<h3>{escaped(title)}</h3>\n{paragraph(text)}" for title, text in METHOD)
    if found.learned.comparisons == 0 and found.has_laser and found.config.get("laser.role") == "aiding":
        told += paragraph(
            "The laser aids the heave here: it is a measurement of it, so the two are not independent, and their "
            "difference says less than it seems to."
        )
    return told


def _again(found: Findings) -> str:
    source = found.source
    same = f" and the recording whose SHA-256 begins with {source.sha256[:16]}" if source.sha256 else ""
    return f"<pre>{escaped(found.command)}</pre>\n" + paragraph(f"with heaved {found.release}{same}.")
