"""Figures for print, at the width of a column; colours are those of Okabe and Ito, which everyone can tell apart."""

from __future__ import annotations

from math import sqrt
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from evidence import baselines
from evidence.heave import COVER, SCORED_FROM_S, Traces

Array = NDArray[np.float64]

COLUMN_IN: Final = 3.5
"""Width of a column, inches."""
DPI: Final = 300
WINDOW_S: Final = 50.0
WINDOW_AT: Final = 0.45
"""Where in the scored time the window begins: with 60 s of laser in 120 s and 700 s, inside an outage."""

BLACK, ORANGE, SKY, BLUE, GREEN = "#000000", "#E69F00", "#56B4E9", "#0072B2", "#009E73"


def heave_trial(path: Path, traces: Traces, title: str) -> None:
    """Heave over a window, and below it the error over all of the scored time with what was published about it.

    The inertial output is drawn without its mean, which would push everything else into a corner.

    Raises:
        OSError: the file cannot be written.
    """
    figure = Figure(figsize=(COLUMN_IN, 3.9), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 1, height_ratios=(1.15, 1.0))
    _heave(above, traces)
    _error(below, traces)
    above.set_title(title, fontsize=8)
    for axes in (above, below):
        axes.tick_params(labelsize=7)
        axes.yaxis.set_major_locator(MaxNLocator(5))
        axes.grid(linewidth=0.3, alpha=0.5)
        axes.set_axisbelow(True)
    figure.savefig(path)


def _heave(axes: Axes, traces: Traces) -> None:
    end = float(traces.t_s[-1])
    start = SCORED_FROM_S + WINDOW_AT * (end - SCORED_FROM_S)
    start = max(min(start, end - WINDOW_S), SCORED_FROM_S)
    shown = (traces.t_s >= start) & (traces.t_s <= start + WINDOW_S)
    t, heave = traces.t_s[shown], traces.heave_m
    inertial = heave[baselines.INERTIAL] - np.mean((heave[baselines.INERTIAL] - traces.truth_m)[traces.scored])
    axes.plot(t, traces.truth_m[shown], color=BLACK, linewidth=2.0, alpha=0.45, label="truth")
    axes.plot(t, inertial[shown], color=ORANGE, linestyle=":", label="inertial, mean removed", linewidth=0.9)
    axes.plot(t, heave[baselines.KF][shown], color=GREEN, linestyle="--", label="KF", linewidth=0.9)
    axes.plot(t, heave[baselines.CORRECTED][shown], color=BLUE, label="ours", linewidth=0.9)
    _shade_laser(axes, t, traces.laser_on[shown])
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.28 * (high - low))  # room for the legend
    axes.set_xlim(t[0], t[-1])
    axes.set_ylabel("heave / m", fontsize=8)
    axes.legend(loc="upper center", ncols=4, fontsize=6, frameon=False, columnspacing=1.0, handlelength=1.6)


def _error(axes: Axes, traces: Traces) -> None:
    t, kept = traces.t_s[traces.scored], traces.scored
    unit, name = (1000.0, "mm") if np.nanmax(traces.std_m[kept]) < 0.02 else (100.0, "cm")
    error = unit * (traces.heave_m[baselines.CORRECTED] - traces.truth_m)[kept]
    std = unit * traces.std_m[kept]
    axes.plot(t, error, color=BLUE, linewidth=0.35, label=f"error of ours, RMS {_rms(error):.1f} {name}")
    for sign in (-1.0, 1.0):
        axes.plot(t, sign * COVER * std, color=BLACK, linewidth=0.8, label="±1.96 std" if sign > 0.0 else None)
    _shade_laser(axes, t, traces.laser_on[kept], label="laser on")
    bound = 1.7 * max(float(np.nanmax(np.abs(error))), COVER * float(np.nanmax(std)))
    axes.set_ylim(-bound / 1.5, bound)
    axes.set_xlim(t[0], t[-1])
    axes.set_xlabel("time / s", fontsize=8)
    axes.set_ylabel(f"error / {name}", fontsize=8)
    axes.legend(loc="upper center", ncols=3, fontsize=6, frameon=False, columnspacing=1.0, handlelength=1.6)


def _shade_laser(axes: Axes, t_s: Array, on: NDArray[np.bool_], label: str | None = None) -> None:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], on, [False])).astype(int)))
    for i, (start, stop) in enumerate(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)):
        axes.axvspan(
            t_s[start], t_s[stop - 1], color=SKY, alpha=0.22, linewidth=0.0, label=label if i == 0 else None, zorder=0
        )


def _rms(values: Array) -> float:
    return sqrt(float(np.mean(values**2)))
