"""The figure of the closed loop: heave, and the hook with and without compensation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from evidence.closed_loop.loop import PERFECT, Trial
from evidence.heave.figures import BLACK, BLUE, COLUMN_IN, DPI, GREEN, ORANGE

if TYPE_CHECKING:
    from pathlib import Path

WINDOW_S: Final = 60.0


def hook_motion(path: Path, trial: Trial) -> None:
    """The first minute that is scored: above with the heave, below what is left, enlarged.

    Raises:
        OSError: the file cannot be written.
    """
    start = trial.setting.warm_up_s
    shown = (trial.t_s >= start) & (trial.t_s <= start + WINDOW_S)
    t = trial.t_s[shown]
    none, present, paper, ours = list(trial.hook_m)[:4]
    colours = {none: BLACK, present: ORANGE, paper: GREEN, ours: BLUE}
    styles = {paper: "--", PERFECT: ":"}
    labels = {none: "heave = hook uncompensated", present: "no lead", paper: "paper's method", ours: "ours"}
    figure = Figure(figsize=(COLUMN_IN, 3.6), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 1, sharex=True)
    unit, name = (1000.0, "mm") if trial.rows()[0].heave_rms_m < 0.2 else (100.0, "cm")
    for axes, methods, scale in ((above, (none, present, ours), 1.0), (below, (ours, paper, PERFECT), unit)):
        for method in methods:
            colour = colours.get(method, BLACK)
            label, style = labels.get(method, method), styles.get(method, "-")
            axes.plot(t, scale * trial.hook_m[method][shown], style, color=colour, label=label, linewidth=0.9)
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.25 * (high - low))  # room for the legend
        axes.legend(loc="upper center", ncols=3, fontsize=6, frameon=False, columnspacing=1.0, handlelength=1.6)
        axes.tick_params(labelsize=7)
        axes.yaxis.set_major_locator(MaxNLocator(5))
        axes.grid(linewidth=0.3, alpha=0.5)
        axes.set_axisbelow(True)
        axes.set_xlim(t[0], t[-1])
    above.set_title(f"{trial.sea}, sensor {trial.setting.sensor}, {trial.way}", fontsize=8)
    above.set_ylabel("hook / m", fontsize=8)
    below.set_ylabel(f"hook / {name}", fontsize=8)
    below.set_xlabel("time / s", fontsize=8)
    figure.savefig(path)
