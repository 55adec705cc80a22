"""The figures of a report, for print at the width of an A4 page; what there is nothing of is not drawn.

Colours are those of Okabe and Ito, which everyone can tell apart, and wherever they carry meaning so does a hatch, a
dash or a label. Long records are drawn as envelopes: the least and the greatest value of each bin of time.
"""

from __future__ import annotations

import io
from math import isfinite, nan, pi
from typing import TYPE_CHECKING, Any, Final

import matplotlib as mpl
import msgspec
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from heaved.replay.table import MAX_STEP_S
from heaved.report.collect import AXES, HEAVE, PITCH, READ, REFERENCE, ROLL, STD, VALID, T
from heaved.report.statistics import HISTOGRAM_EDGES, LEVELS, between
from heaved.report.svg import embedded
from heaved.samples import HeaveState
from heaved.text import printable

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes

    from heaved.report.collect import Collector, Stretch
    from heaved.report.findings import Findings, HorizonErrors
    from heaved.report.statistics import Drawn

Array = NDArray[np.float64]

WIDTH_IN: Final = 7.0
"""Of the text on an A4 page."""
PNG_DPI: Final = 200
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILION, PURPLE, GREY = "#F0E442", "#0072B2", "#D55E00", "#CC79A7", "#999999"
STATE_LOOK: Final = {
    HeaveState.VALID: (GREEN, ""),
    HeaveState.DEGRADED: (YELLOW, "//"),
    HeaveState.SETTLING: (SKY, ".."),
    HeaveState.INVALID: (VERMILION, "xx"),
}
NO_SAMPLES: Final = ("#FFFFFF", "--")
MOST_LANES: Final = 10
"""Reasons that are drawn; the table has all of them."""
LANE_LETTERS: Final = 84
NEES_POINTS: Final = 60
MOST_OF_USUAL: Final = 8.0
"""Errors of so many times the usual claim call for logarithms."""
SHOWN_EVERY: Final = 2
"""Rows of a stretch: ten a second show waves."""
STRETCH_HORIZONS_S: Final = (2.0, 5.0)
"""Those nearest to these are shown in a stretch."""
STYLE: Final[dict[Any, Any]] = {
    "svg.fonttype": "none",  # Text that can be searched and copied.
    "svg.hashsalt": "heaved",  # The same file for the same figures.
    "font.family": ["DejaVu Sans"],
    "font.size": 8.0,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "legend.frameon": False,
    "lines.linewidth": 0.9,
    "hatch.linewidth": 0.5,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.linewidth": 0.3,
    "grid.alpha": 0.5,
    "axes.axisbelow": True,
    "path.simplify": True,
    "path.simplify_threshold": 0.3,
}


class Drawing(msgspec.Struct, frozen=True):
    """One figure."""

    key: str
    """Its name as a file and as an anchor."""
    svg: str
    """Element to be put into a page: no prolog, and no id that another figure has."""
    png: bytes
    """Empty unless asked for."""


def draw(collector: Collector, found: Findings, *, with_png: bool = False) -> dict[str, Drawing]:
    """All figures that there is something for, by their keys."""
    drawers: dict[str, Callable[[Collector, Findings], Figure | None]] = {
        "motion": motion,
        "quality": quality,
        "errors": errors,
        "histogram": histogram,
        "acceleration": acceleration,
        "heave-spectrum": heave_spectrum,
        "sea": sea,
        "forecasts": forecasts,
        "typical": typical,
        "worst": worst,
        "rock": rock,
        "rock-stretch": rock_stretch,
        "points": points,
        "laser": laser,
    }
    drawings = {}
    with mpl.rc_context(STYLE):
        for key, drawer in drawers.items():
            figure = drawer(collector, found)
            if figure is not None:
                drawings[key] = Drawing(key, _svg(figure, key), _png(figure) if with_png else b"")
    return drawings


def _svg(figure: Figure, key: str) -> str:
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    return embedded(text.getvalue(), key)


def _png(figure: Figure) -> bytes:
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=PNG_DPI)
    return image.getvalue()


def _panels(
    height_in: float, heights: Sequence[float], *, shared: bool = True, across: int = 1
) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    found = figure.subplots(len(heights), across, height_ratios=heights, sharex=shared, squeeze=False)
    return figure, list(found.ravel())


# --- through time ----------------------------------------------------------------------------------------------------


class _Clock:
    """Time from the first frame, in the unit that its length calls for."""

    def __init__(self, collector: Collector) -> None:
        length_s = collector.end_s - collector.begin_s
        self.begin_s = collector.begin_s
        self.unit, self.per_s = ("s", 1.0)
        if length_s > 3.0 * 3600.0:
            self.unit, self.per_s = "h", 1.0 / 3600.0
        elif length_s > 300.0:
            self.unit, self.per_s = "min", 1.0 / 60.0
        self.end = max(length_s, 1e-9) * self.per_s

    def __call__(self, t_s: Array) -> Array:
        return (t_s - self.begin_s) * self.per_s

    def label(self, axes: Axes) -> None:
        axes.set_xlabel(f"time from the first sample / {self.unit}")
        axes.set_xlim(0.0, self.end)


def _band(axes: Axes, clock: _Clock, drawn: Drawn, name: str, factor: float, color: str, label: str) -> None:
    """A quantity between its least and its greatest value in each bin."""
    there = np.isfinite(drawn.least[name])
    t, low, high = _broken(drawn, there, clock(drawn.t_s), factor * drawn.least[name], factor * drawn.most[name])
    axes.fill_between(t, low, high, color=color, linewidth=0.5, label=label)


def _broken(drawn: Drawn, there: NDArray[np.bool_], t: Array, *values: Array) -> tuple[Array, ...]:
    """Only bins where it is there, with nan where some are missing between two."""
    at = np.flatnonzero(there)
    holes = np.flatnonzero(np.diff(drawn.t_s[at]) > 1.5 * drawn.width_s) + 1
    return tuple(np.insert(series[at], holes, nan) for series in (t, *values))


def motion(collector: Collector, found: Findings) -> Figure | None:
    """Heave and its uncertainty, roll and pitch, over all of the time."""
    drawn = collector.envelope.drawn()
    there = [name for name in ("heave", *AXES) if np.isfinite(drawn.mean[name]).any()]
    if not there:
        return None
    clock = _Clock(collector)
    figure, panels = _panels(1.0 + 1.15 * len(there), [1.5 if name == "heave" else 1.0 for name in there])
    for axes, name in zip(panels, there, strict=True):
        if name == "heave":
            _band(axes, clock, drawn, "heave", 1.0, BLUE, "real-time heave")
            if collector.all_laser.count:
                lane = collector.laser_states.lane("valid")
                _steps(axes, clock, lane.begin_s, lane.width_s, np.zeros(len(lane.share)), lane.share, "#FCEBC8", "",
                       "laser fresh", transform=axes.get_xaxis_transform(), zorder=0)  # fmt: skip
            t, std = _broken(drawn, np.isfinite(drawn.mean["std"]), clock(drawn.t_s), drawn.mean["std"])
            low, high = axes.get_ylim()
            axes.plot(t, 2.0 * std, color=VERMILION, linestyle="--", linewidth=0.8, label="2 claimed std")
            axes.set_ylim(low, high)
            axes.set_ylabel("heave / m")
            _legend_above(axes)
        else:
            _band(axes, clock, drawn, name, 1.0, GREEN if name == "roll" else PURPLE, name)
            axes.set_ylabel(f"{name} / °")
        axes.yaxis.set_major_locator(MaxNLocator(5))
    clock.label(panels[-1])
    return figure


def _legend_above(axes: Axes) -> None:
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5, borderaxespad=0.1, handlelength=1.6)


def quality(collector: Collector, found: Findings) -> Figure | None:
    """What could be believed when, and why not."""
    if found.told_s <= 0.0:
        return None
    clock = _Clock(collector)
    reasons = collector.reasons.names[:MOST_LANES]
    figure, panels = _panels(1.4 + 0.33 * len(reasons), [2.0, *[1.0] * len(reasons)])
    bar = panels[0]
    floor: Array | None = None
    for state, (color, hatch) in STATE_LOOK.items():
        lane = collector.quality.lane(state.value)
        floor = np.zeros(len(lane.share)) if floor is None else floor
        if lane.share.any():
            label = f"{state.value} {100.0 * found.share(found.quality[state.value]):.1f} %"
            _steps(bar, clock, lane.begin_s, lane.width_s, floor, floor + lane.share, color, hatch, label)
        floor = floor + lane.share
    bar.set_ylim(0.0, 1.0)
    handles, _ = bar.get_legend_handles_labels()
    if found.silent_s > 0.0:
        share = found.silent_s / (found.told_s + found.silent_s)
        silent = bar.fill_between(
            [0.0, clock.end], 0.0, 1.0, facecolor=NO_SAMPLES[0], edgecolor=GREY, hatch=NO_SAMPLES[1], linewidth=0.0,
            zorder=0, label=f"no samples {100.0 * share:.1f} %",
        )  # fmt: skip
        handles.append(silent)
    bar.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=5,
        borderaxespad=0.1,
        handlelength=2.2,
        handleheight=1.0,
    )
    for axes, kind in zip(panels[1:], reasons, strict=True):
        lane = collector.reasons.lane(kind)
        _steps(axes, clock, lane.begin_s, lane.width_s, np.zeros(len(lane.share)), lane.share, GREY, "", "")
        axes.set_ylim(0.0, 1.0)
        text = _lane_text(collector.reason_texts.get(kind, kind))
        share = found.share(collector.reasons.spells(kind))
        axes.set_title(f"{100.0 * share:5.1f} %   {text}", loc="left", fontsize=7.0, pad=1.5, parse_math=False)
    for axes in panels:
        axes.set_yticks([])
        axes.grid(visible=False)
        axes.spines["left"].set_visible(False)
    clock.label(panels[-1])
    return figure


def _lane_text(text: str) -> str:
    """In letters that the font has, of a length that there is room for."""
    plain = printable(text).encode("latin-1", "replace").decode("latin-1")
    return plain if len(plain) <= LANE_LETTERS else plain[: LANE_LETTERS - 1] + "…"


def _steps(
    axes: Axes,
    clock: _Clock,
    begin_s: Array,
    width_s: float,
    low: Array,
    high: Array,
    color: str,
    hatch: str,
    label: str,
    **others: Any,
) -> None:
    """An area whose ends are steps; bins like the one before are not drawn."""
    if len(begin_s) == 0:
        return
    is_new = (np.diff(low, prepend=nan) != 0.0) | (np.diff(high, prepend=nan) != 0.0)
    edges = clock(np.append(begin_s[is_new], begin_s[-1] + width_s))
    low, high = low[is_new], high[is_new]
    axes.fill_between(
        edges, np.append(low, low[-1]), np.append(high, high[-1]), step="post", facecolor=color,
        edgecolor="#404040" if hatch else "none", hatch=hatch or None, linewidth=0.0, label=label or None, **others,
    )  # fmt: skip


def errors(collector: Collector, found: Findings) -> Figure | None:
    """Real-time heave minus delayed heave and minus laser, with what was claimed; and how right the claim was when."""
    drawn = collector.envelope.drawn()
    kinds = [
        (name, claim, nees, title)
        for name, claim, nees, title in (
            ("error", "std", "nees", "real-time minus delayed"),
            ("laser_error", "laser_std", "laser_nees", "real-time minus laser"),
        )
        if np.isfinite(drawn.mean[name]).any()
    ]
    if not kinds:
        return None
    clock = _Clock(collector)
    figure, panels = _panels(1.0 + 1.45 * (len(kinds) + 1), [1.0] * (len(kinds) + 1))
    for axes, (name, claim, _, title) in zip(panels, kinds, strict=False):
        there = np.isfinite(drawn.mean[name]) & np.isfinite(drawn.mean[claim])
        factor, unit = (1000.0, "mm") if float(np.nanpercentile(drawn.mean[claim][there], 90)) < 0.02 else (100.0, "cm")
        _band(axes, clock, drawn, name, factor, BLUE, f"{title} (least to greatest)")
        t, std = _broken(drawn, there, clock(drawn.t_s), factor * drawn.mean[claim])
        for sign in (-2.0, 2.0):
            axes.plot(
                t,
                sign * std,
                color=VERMILION,
                linestyle="--",
                linewidth=0.9,
                label="±2 claimed std" if sign > 0 else None,
            )
        _error_scale(axes, drawn.least[name][there], drawn.most[name][there], drawn.mean[claim][there], factor)
        axes.set_ylabel(f"error / {unit}")
        _legend_above(axes)
    below = panels[-1]
    times = max(round(len(drawn.t_s) / NEES_POINTS), 1)
    for (_, _, nees, title), color, marker in zip(kinds, (BLUE, ORANGE), ("o", "s"), strict=False):
        t, mean = drawn.joined(nees, times)
        holes = np.flatnonzero(np.diff(t) > 1.5 * times * drawn.width_s) + 1
        t, mean = np.insert(t, holes, nan), np.insert(mean, holes, nan)
        below.semilogy(
            clock(t), np.maximum(mean, 1e-3), color=color, marker=marker, markersize=2.5, linewidth=0.6, label=title
        )
    below.axhline(1.0, color=BLACK, linewidth=0.8, linestyle="--", label="a right claim")
    low, high = below.get_ylim()
    below.set_ylim(min(low, 0.1), max(high, 10.0))
    below.yaxis.set_major_formatter("{x:g}")
    below.set_ylabel("NEES")
    _legend_above(below)
    clock.label(below)
    return figure


def _error_scale(axes: Axes, least: Array, most: Array, std: Array, factor: float) -> None:
    """An axis for errors: with logarithms outside of what is usual, where a disaster would press all else together."""
    limit = 1.1 * factor * float(max(np.max(most), np.max(-least), 2.0 * np.max(std)))
    usual = 2.0 * factor * float(np.median(std))
    if limit > MOST_OF_USUAL * usual:
        axes.set_yscale("symlog", linthresh=2.0 * usual, subs=(2, 5))
        axes.axhspan(-2.0 * usual, 2.0 * usual, facecolor="#F2F2F2", linewidth=0.0, zorder=0, label="linear within")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_ylim(-limit, limit)


def sea(collector: Collector, found: Findings) -> Figure | None:
    """Significant height and periods of the heave, fit by fit."""
    if len(collector.sea) < 2:
        return None
    clock = _Clock(collector)
    t = clock(np.array([one.t_s for one in collector.sea]))
    figure, (above, below) = _panels(2.6, (1.0, 1.0))
    above.plot(t, [one.sea.significant_height_m for one in collector.sea], color=BLUE, marker="o", markersize=2.0)
    above.set_ylim(0.0, None)
    above.set_ylabel("Hs of heave / m")
    below.plot(
        t,
        [one.sea.peak_period_s for one in collector.sea],
        color=VERMILION,
        marker="o",
        markersize=2.0,
        label="peak period",
    )
    below.plot(
        t,
        [one.sea.mean_period_s for one in collector.sea],
        color=GREEN,
        linestyle="--",
        marker="s",
        markersize=2.0,
        label="mean period m0/m1",
    )
    below.set_ylim(0.0, None)
    below.set_ylabel("period / s")
    _legend_above(below)
    clock.label(below)
    return figure


def laser(collector: Collector, found: Findings) -> Figure | None:
    """What the laser has taught, through time."""
    if not collector.all_laser.count:
        return None
    drawn = collector.envelope.drawn()
    clock = _Clock(collector)
    is_corrected = collector.moments["correction"].rms > 0.0
    figure, panels = _panels(2.4 if is_corrected else 1.5, [1.0, 1.0] if is_corrected else [1.0])
    t, lead = _broken(drawn, np.isfinite(drawn.mean["lead"]), clock(drawn.t_s), drawn.mean["lead"])
    panels[0].plot(t, 1000.0 * lead, color=BLUE)
    panels[0].set_ylabel("lead / ms")
    if is_corrected:
        _band(panels[1], clock, drawn, "correction", 1000.0, GREEN, "correction")
        panels[1].set_ylabel("correction / mm")
    clock.label(panels[-1])
    return figure


def points(collector: Collector, found: Findings) -> Figure | None:
    """Heave of the monitoring points."""
    drawn = collector.points.drawn()
    names = [name for name in collector.layout.points if np.isfinite(drawn.mean[name]).any()][:6]
    if not names:
        return None
    clock = _Clock(collector)
    figure, panels = _panels(0.8 + 1.1 * len(names), [1.0] * len(names))
    for axes, name in zip(panels, names, strict=True):
        _band(axes, clock, drawn, name, 1.0, BLUE, name)
        axes.set_title(name, loc="left", parse_math=False)
        axes.set_ylabel("heave / m")
    clock.label(panels[-1])
    return figure


# --- claims ----------------------------------------------------------------------------------------------------------


def histogram(collector: Collector, found: Findings) -> Figure | None:
    """Errors over what was claimed for them, beside the normal distribution that they would have."""
    kinds = [
        (counted, title)
        for counted, title in (
            (collector.all_realtime, "real-time minus delayed"),
            (collector.all_laser, "real-time minus laser"),
        )
        if counted.count
    ]
    if not kinds:
        return None
    figure, panels = _panels(2.2, (1.0,), shared=False, across=2)
    middles = 0.5 * (HISTOGRAM_EDGES[1:] + HISTOGRAM_EDGES[:-1])
    fine = np.linspace(HISTOGRAM_EDGES[0], HISTOGRAM_EDGES[-1], 301)
    width = HISTOGRAM_EDGES[1] - HISTOGRAM_EDGES[0]
    for axes, (counted, title) in zip(panels, kinds, strict=False):
        axes.bar(
            middles,
            counted.histogram / counted.count / width,
            width,
            color=SKY,
            edgecolor=BLUE,
            linewidth=0.4,
            label="errors",
        )
        axes.plot(
            fine,
            np.exp(-0.5 * fine**2) / np.sqrt(2.0 * pi),
            color=VERMILION,
            linestyle="--",
            linewidth=1.2,
            label="claimed",
        )
        axes.set_title(f"{title}, {counted.count} errors")
        axes.set_xlabel("error / claimed standard deviation")
        axes.set_ylabel("density")
        axes.legend(loc="upper right")
    for axes in panels[len(kinds) :]:
        axes.remove()
    return figure


def _by_horizon(axes: Axes, ahead: Sequence[HorizonErrors], factor: float, unit: str, std: float) -> None:
    x = [one.horizon_s for one in ahead]
    axes.loglog(
        x, [factor * one.errors.rms for one in ahead], color=BLUE, marker="o", markersize=4.0, label="RMS error"
    )
    axes.loglog(
        x,
        [factor * one.errors.claimed_rms for one in ahead],
        color=VERMILION,
        linestyle="--",
        marker="s",
        markersize=3.0,
        label="claimed std",
    )
    if isfinite(std) and std > 0.0:
        axes.axhline(factor * std, color=BLACK, linestyle=":", linewidth=0.9, label="std of motion")
    axes.set_xticks(x, [f"{value:g}" for value in x])
    axes.xaxis.set_minor_formatter(NullFormatter())
    _plain_decades(axes)
    axes.set_xlabel("horizon / s")
    axes.set_ylabel(f"error / {unit}")
    _legend_above(axes)


def _plain_decades(axes: Axes) -> None:
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    low, high = axes.get_ylim()
    is_narrow = high / low < 2000.0
    axes.yaxis.set_minor_formatter(
        FuncFormatter(lambda value, _: f"{value:g}" if is_narrow and f"{value:e}"[0] in "25" else "")
    )
    axes.tick_params(axis="y", which="minor", labelsize=7.0)


def _reliability(axes: Axes, curves: Sequence[tuple[float, Array]]) -> None:
    axes.plot([0.0, 100.0], [0.0, 100.0], color=BLACK, linestyle="--", linewidth=0.8, label="right claims")
    looks = (
        (BLUE, "-", "o"),
        (ORANGE, "-", "s"),
        (GREEN, "-", "^"),
        (PURPLE, "-", "v"),
        (VERMILION, "-", "D"),
        (SKY, "-", "x"),
        (BLACK, "-", "+"),
        (GREY, "-", "*"),
    )
    for (horizon_s, shares), (color, style, marker) in zip(curves, looks, strict=False):
        axes.plot(
            100.0 * np.array(LEVELS),
            100.0 * shares,
            color=color,
            linestyle=style,
            marker=marker,
            markersize=2.5,
            linewidth=0.7,
            label=f"{horizon_s:g} s",
        )
    axes.set_xlim(0.0, 100.0)
    axes.set_ylim(0.0, 100.0)
    axes.set_xlabel("interval claimed to hold / %")
    axes.set_ylabel("errors that it held / %")
    axes.legend(loc="lower right", ncols=2)


def forecasts(collector: Collector, found: Findings) -> Figure | None:
    """Forecasts of the heave against the delayed heave."""
    ahead = [one for one in found.forecasts if one.errors.count]
    if not ahead:
        return None
    figure, (left, right) = _panels(2.9, (1.0,), shared=False, across=2)
    _by_horizon(left, ahead, 100.0, "cm", 0.25 * found.sea.delayed_height_m)
    curves = [
        (horizon_s, counted.reliability)
        for horizon_s, counted in zip(collector.layout.forecasts_s, collector.forecasts, strict=True)
        if counted.count
    ]
    _reliability(right, curves)
    return figure


def rock(collector: Collector, found: Findings) -> Figure | None:
    """Predictions of roll and pitch against what was measured then."""
    there = [axis for axis in AXES if any(one.errors.count for one in found.rock[axis])]
    if not there:
        return None
    figure, panels = _panels(2.8 * len(there), [1.0] * len(there), shared=False, across=2)
    std = {"roll": found.roll_std_deg, "pitch": found.pitch_std_deg}
    for axis, left, right in zip(there, panels[::2], panels[1::2], strict=True):
        _by_horizon(left, [one for one in found.rock[axis] if one.errors.count], 1.0, "°", std[axis])
        left.set_ylabel(f"error of {axis} / °")
        curves = [
            (horizon_s, counted.reliability)
            for horizon_s, counted in zip(collector.layout.rock_s, collector.rock[axis], strict=True)
            if counted.count
        ]
        _reliability(right, curves)
        right.set_title(axis)
    return figure


# --- spectra ---------------------------------------------------------------------------------------------------------


def acceleration(collector: Collector, found: Findings) -> Figure | None:
    """Periodogram of the vertical acceleration, and what was fitted to it."""
    measured = collector.spectra["acceleration"].spectrum() if collector.spectra else None
    if measured is None:
        return None
    figure, (axes,) = _panels(3.2, (1.0,))
    shown = measured.f_hz > 1.5 / measured.segment_s
    shown_to_hz = float(measured.f_hz[-1])
    if (every := collector.spectra.get("all acceleration")) is not None and (whole := every.spectrum()) is not None:
        beyond = whole.f_hz > 1.5 / whole.segment_s
        shown_to_hz = float(whole.f_hz[-1])
        axes.loglog(
            *_thinned(whole.f_hz[beyond], whole.density[beyond]),
            color=GREY,
            linewidth=0.5,
            label="samples as they come",
        )
    label = "means over 50 ms, which are fitted" if every is not None else "samples"
    axes.loglog(*_thinned(measured.f_hz[shown], measured.density[shown]), color=BLACK, linewidth=0.6, label=label)
    low, high = float(np.min(measured.density[shown])), float(np.max(measured.density[shown]))
    if (parts := collector.mean_sea.acceleration()) is not None:
        f = parts.f_hz
        for values, color, style, name in (
            (parts.waves, BLUE, "-", "fit: sea"),
            (parts.vibration, ORANGE, "-.", "fit: vibration"),
            (parts.noise, GREEN, ":", "fit: noise and bias"),
            (parts.whole, VERMILION, "--", "fit: all of it"),
        ):
            if (values > 0.01 * low).any():
                axes.loglog(*_thinned(f, values), color=color, linestyle=style, linewidth=1.1, label=name)
    axes.set_ylim(0.2 * low, 10.0 * high)
    axes.set_xlim(0.02, 1.02 * shown_to_hz)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_xlabel("frequency / Hz")
    axes.set_ylabel("vertical acceleration / (m/s²)²/Hz")
    axes.legend(loc="upper right", ncols=2)
    return figure


def _thinned(f_hz: Array, density: Array) -> tuple[Array, Array]:
    """A spectrum for an axis of logarithms: where points are closer than half a percent, the least and the greatest of
    them alone.
    """
    group = np.floor(np.log(f_hz) / 0.01).astype(np.int64)
    starts = np.flatnonzero(np.diff(group, prepend=group[0] - 1))
    sizes = np.diff(np.append(starts, len(f_hz)))
    low, high = np.minimum.reduceat(density, starts), np.maximum.reduceat(density, starts)
    middle = np.add.reduceat(f_hz, starts) / sizes
    single = sizes == 1
    x = np.stack((middle, np.where(single, nan, middle)), axis=1).ravel()
    y = np.stack((low, np.where(single, nan, high)), axis=1).ravel()
    there = np.isfinite(y) & (y > 0.0)
    return x[there], y[there]


def heave_spectrum(collector: Collector, found: Findings) -> Figure | None:
    """Spectra of heave and error."""
    if not collector.spectra:
        return None
    curves = [
        (spectrum, color, style, label)
        for name, color, style, label in (
            ("delayed", BLACK, "-", "delayed heave"),
            ("heave", BLUE, "-", "real-time heave"),
            ("error", VERMILION, "-", "real-time minus delayed"),
        )
        if (spectrum := collector.spectra[name].spectrum()) is not None
    ]
    if not curves:
        return None
    figure, (axes,) = _panels(3.0, (1.0,))
    top = 0.0
    for spectrum, color, style, label in curves:
        shown = (spectrum.f_hz > 1.5 / spectrum.segment_s) & (spectrum.f_hz <= 1.0)
        top = max(top, float(spectrum.density[shown].max()))
        axes.loglog(
            spectrum.f_hz[shown], spectrum.density[shown], color=color, linestyle=style, linewidth=0.8, label=label
        )
    if (fitted := collector.mean_sea.heave()) is not None:
        f, density = fitted
        axes.loglog(f, density, color=ORANGE, linestyle="--", linewidth=1.4, label="fitted sea, mean of all fits")
        top = max(top, float(density.max()))
    axes.set_ylim(1e-7 * top, 5.0 * top)
    axes.set_xlim(0.02, 1.0)
    for period_s in (20.0, 10.0, 5.0, 2.0):
        axes.annotate(
            f"{period_s:g} s",
            (1.0 / period_s, 1.0),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="bottom",
            fontsize=6.5,
        )
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_xlabel("frequency / Hz (periods above)")
    axes.set_ylabel("heave / m²/Hz")
    axes.legend(loc="lower left", ncols=2)
    return figure


# --- stretches -------------------------------------------------------------------------------------------------------


def typical(collector: Collector, found: Findings) -> Figure | None:
    """A minute as most were."""
    return _stretch(collector, collector.typical)


def worst(collector: Collector, found: Findings) -> Figure | None:
    """The minute whose heave was furthest from what was claimed."""
    stretch = collector.worst
    usual = collector.typical
    return (
        None
        if usual is not None and stretch is not None and stretch.begin_s == usual.begin_s
        else _stretch(collector, stretch)
    )


def _nearest(horizons_s: Sequence[float], wanted_s: Sequence[float]) -> list[int]:
    """Places of those nearest to what is wanted, each once."""
    found = [
        min(range(len(horizons_s)), key=lambda i: abs(horizons_s[i] - wanted)) for wanted in wanted_s if horizons_s
    ]
    return sorted(set(found))


def _stretch(collector: Collector, stretch: Stretch | None) -> Figure | None:
    if stretch is None:
        return None
    layout, rows = collector.layout, stretch.rows[::SHOWN_EVERY]
    shown = _nearest(layout.forecasts_s, STRETCH_HORIZONS_S)
    figure, panels = _panels(1.2 + 1.25 * (len(shown) + 2), [1.0] * (len(shown) + 2))
    rows[:, [T, VALID, READ]] -= collector.begin_s
    own = rows[rows[:, T] >= stretch.begin_s - collector.begin_s]
    at_s, heave, std, delayed = own[:, VALID], own[:, HEAVE], own[:, STD], own[:, -2]
    read_s, reference = own[:, READ], own[:, REFERENCE]
    fresh = np.isfinite(reference) & (np.diff(read_s, prepend=nan) > 0.0)
    now, off = panels[:2]
    now.plot(at_s, heave, color=BLUE, linewidth=1.4, label="real-time heave")
    now.plot(at_s, delayed, color=BLACK, linewidth=0.9, linestyle="--", label="delayed heave")
    now.set_ylabel("heave / m")
    off.fill_between(at_s, -200.0 * std, 200.0 * std, color=SKY, alpha=0.5, linewidth=0.0, label="±2 claimed std")
    off.plot(at_s, 100.0 * (heave - delayed), color=BLUE, label="real-time minus delayed")
    if fresh.any():
        now.plot(read_s[fresh][::3], reference[fresh][::3], color=ORANGE, marker="o", markersize=1.8, linestyle="none",
                 label="laser")  # fmt: skip
        error = 100.0 * (between(read_s[fresh], at_s, heave, MAX_STEP_S) - reference[fresh])
        off.plot(read_s[fresh], error, color=ORANGE, marker="o", markersize=1.4, linestyle="none",
                 label="real-time minus laser")  # fmt: skip
    off.set_ylabel("error / cm")
    for axes, i in zip(panels[2:], shown, strict=True):
        foretold, claimed = rows[:, layout.forecast(i)].T
        at_s = rows[:, T] + layout.forecasts_s[i]
        low, high = foretold - 2.0 * claimed, foretold + 2.0 * claimed
        axes.fill_between(at_s, low, high, color=SKY, alpha=0.5, linewidth=0.0, label="±2 claimed std")
        axes.plot(at_s, foretold, color=BLUE, linewidth=1.0, label=f"foretold {layout.forecasts_s[i]:g} s before")
        axes.plot(own[:, VALID], delayed, color=BLACK, linewidth=0.8, linestyle="--", label="delayed heave")
        axes.set_ylabel("heave / m")
    for axes in panels:
        _legend_above(axes)
    panels[-1].set_xlim(stretch.begin_s - collector.begin_s, stretch.end_s - collector.begin_s)
    panels[-1].set_xlabel("time from the first sample / s")
    return figure


def rock_stretch(collector: Collector, found: Findings) -> Figure | None:
    """Roll and pitch of a typical minute, as measured and as predicted."""
    stretch, layout = collector.typical, collector.layout
    if stretch is None:
        return None
    rows = stretch.rows[::SHOWN_EVERY]
    axes_there = [(i, name) for i, name in enumerate(AXES) if np.isfinite(rows[:, (ROLL, PITCH)[i]]).any()]
    shown = _nearest(layout.rock_s, (0.5, 2.0))
    if not axes_there or not shown:
        return None
    figure, panels = _panels(0.8 + 1.15 * len(axes_there) * len(shown), [1.0] * (len(axes_there) * len(shown)))
    base_s = collector.begin_s
    pairs = [(axis, name, i) for axis, name in axes_there for i in shown]
    for axes, (axis, name, i) in zip(panels, pairs, strict=True):
        predicted, _, width = np.degrees(rows[:, layout.rock(axis, i)]).T
        at = rows[:, T] + layout.rock_s[i] - base_s
        axes.fill_between(
            at, predicted - width, predicted + width, color=SKY, alpha=0.5, linewidth=0.0, label="95 % interval"
        )
        axes.plot(at, predicted, color=BLUE, linewidth=1.0, label=f"predicted {layout.rock_s[i]:g} s before")
        axes.plot(
            rows[:, T] - base_s,
            np.degrees(rows[:, (ROLL, PITCH)[axis]]),
            color=BLACK,
            linestyle="--",
            linewidth=0.8,
            label="measured",
        )
        axes.set_ylabel(f"{name} / °")
        _legend_above(axes)
    panels[-1].set_xlim(stretch.begin_s - base_s, stretch.end_s - base_s)
    panels[-1].set_xlabel("time from the first sample / s")
    return figure
