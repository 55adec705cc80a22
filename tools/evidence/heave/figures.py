"""Figures for print, at the width of a column; colours are those of Okabe and Ito, which everyone can tell apart."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator
from numpy.typing import NDArray
from scipy.signal import detrend, welch

from evidence.heave.estimators import KF, Trace
from evidence.heave.scores import BIN_S, COVER, SETTLED_SHARE, SETTLING_END_S, laser_times, rms
from evidence.limits import causal_heave_limit
from evidence.scenarios import Case, accelerometer_noise, simulated_spectrum
from heaved.simulate.seaway import RAMPS, SEAS

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

    from evidence.heave.summary import Result

Array = NDArray[np.float64]

COLUMN_IN: Final = 3.5
"""Width of a column, inches."""
DPI: Final = 300
WINDOW_S: Final = 50.0
WINDOW_AT: Final = 0.45
"""Where in the scored time the window of the upper panel begins."""
SPECTRUM_S: Final = 120.0
"""Segments of the spectra."""
CURVE_POINTS: Final = 2**13
"""Frequencies of the limits that are drawn."""
LOCAL_S: Final = 20.0
"""Windows in which the error of a changing sea is taken."""

BLACK, ORANGE, SKY, BLUE, GREEN = "#000000", "#E69F00", "#56B4E9", "#0072B2", "#009E73"
VERMILION, PURPLE = "#D55E00", "#CC79A7"
OF_SCENARIO: Final = {"S4": ORANGE, "S5": GREEN, "S6": BLUE, "S6S": PURPLE, "SL": SKY, "Hebrides": BLACK}


def stem(case: Case) -> str:
    """Of the names of a record's figures."""
    setting = case.setting
    return f"{case.scenario}_{setting.sensor}_tilt-{setting.tilt}_laser-{setting.laser.replace('%', '')}"


def draw_record(folder: Path, case: Case, traces: Sequence[Trace]) -> None:
    """One record: heave and error through time, the spectrum of both, and a changing sea against its own size.

    Raises:
        OSError: a file cannot be written.
    """
    published = [trace for trace in traces if trace.std_m is not None]
    if not published:
        return
    ours = published[-1]
    others = [trace for trace in traces if trace is not ours and (trace.std_m is not None or trace.estimator == KF)]
    setting = case.setting
    title = f"{case.scenario}, sensor {setting.sensor}, tilt {setting.tilt}, laser {setting.laser}"
    heave_through_time(folder / f"heave_{stem(case)}.png", case, ours, others, title)
    if case.scenario in SEAS and case.scenario not in RAMPS:
        spectra(folder / f"spectrum_{stem(case)}.png", case, ours, others, title)
    if case.segments:
        changing_sea(folder / f"change_{stem(case)}.png", case, [*others, ours], title)


def draw_results(folder: Path, results: Sequence[Result]) -> None:
    """Over all records: forecasts against their limits, and settling, one figure each for an estimator that has them.

    Raises:
        OSError: a file cannot be written.
    """
    for estimator in dict.fromkeys(result.estimator for result in results if result.forecast):
        own = [r for r in results if r.estimator == estimator and r.setting == _first_setting(r, results)]
        name = estimator.replace(" ", "-").replace("+", "and")
        ahead = [result for result in own if np.isfinite(result.ratio_to_limit)]
        if ahead:
            forecasts(folder / f"forecast_{name}.png", ahead, estimator)
        starting = [result for result in own if result.settling and result.scenario in OF_SCENARIO]
        if starting:
            settling(folder / f"settling_{name}.png", starting, estimator)


def _first_setting(result: Result, results: Sequence[Result]) -> object:
    """Of several settings of a scenario the first one is drawn."""
    return next(r.setting for r in results if (r.scenario, r.estimator) == (result.scenario, result.estimator))


# --- one record ------------------------------------------------------------------------------------------------------


def heave_through_time(path: Path, case: Case, ours: Trace, others: Sequence[Trace], title: str) -> None:
    """Heave over a window, and below it the error over all of the scored time with what was published about it."""
    figure, (above, below) = _panels(3.9, (1.15, 1.0))
    above.set_title(title, fontsize=8)
    _heave(above, case, ours, others)
    _error(below, case, ours)
    figure.savefig(path)


def _heave(axes: Axes, case: Case, ours: Trace, others: Sequence[Trace]) -> None:
    times = case.recording.t_s
    start = case.start_s + WINDOW_AT * (case.end_s - case.start_s)
    start = max(min(start, case.end_s - WINDOW_S), case.start_s)
    shown = (times >= start) & (times <= start + WINDOW_S)
    t = times[shown]
    axes.plot(t, case.recording.truth.heave_m[shown], color=BLACK, linewidth=2.0, alpha=0.45, label="truth")
    for trace, color, style in zip(others, (GREEN, ORANGE, PURPLE), ("--", ":", "-."), strict=False):
        axes.plot(t, trace.heave_m[shown], color=color, linestyle=style, linewidth=0.9, label=trace.estimator)
    axes.plot(t, ours.heave_m[shown], color=BLUE, label=ours.estimator, linewidth=0.9)
    _shade_laser(axes, t, laser_times(case)[shown])
    _head_room(axes, 0.28)
    axes.set_xlim(t[0], t[-1])
    axes.set_ylabel("heave / m", fontsize=8)
    _legend(axes)


def _error(axes: Axes, case: Case, ours: Trace) -> None:
    kept = case.scored
    t, error_m = case.recording.t_s[kept], (ours.heave_m - case.recording.truth.heave_m)[kept]
    assert ours.std_m is not None
    std_m = ours.std_m[kept]
    unit, name = (1000.0, "mm") if np.nanmax(std_m) < 0.02 else (100.0, "cm")
    axes.fill_between(
        t, -COVER * unit * std_m, COVER * unit * std_m, color=SKY, alpha=0.45, linewidth=0.0, label="±1.96 std"
    )
    axes.plot(t, unit * error_m, color=BLUE, linewidth=0.35, label=f"error, RMS {unit * rms(error_m):.2g} {name}")
    if np.isfinite(case.limits.causal_m):
        for sign in (-1.0, 1.0):
            label = "±1.96 causal limit" if sign > 0.0 else None
            level = sign * COVER * unit * case.limits.causal_m
            axes.axhline(level, color=BLACK, linewidth=0.6, linestyle="--", label=label)
    laser = laser_times(case)[kept]
    _shade_laser(axes, t, laser, label="laser on")
    bound = unit * max(float(np.nanmax(np.abs(error_m))), COVER * float(np.nanmax(std_m)))
    axes.set_ylim(-1.1 * bound, 1.65 * bound)
    axes.set_xlim(t[0], t[-1])
    axes.set_xlabel("time / s", fontsize=8)
    axes.set_ylabel(f"error / {name}", fontsize=8)
    _legend(axes)


def spectra(path: Path, case: Case, ours: Trace, others: Sequence[Trace], title: str) -> None:
    """Spectra of heave, of the errors, and of the error that past and future together would leave."""
    figure, (axes,) = _panels(2.9, (1.0,))
    kept, rate_hz = case.scored, case.rate_hz
    truth = case.recording.truth.heave_m[kept]

    def density(values: Array) -> tuple[Array, Array]:
        there = values[np.isfinite(values)]
        segment = min(there.size, round(SPECTRUM_S * rate_hz))
        f, found = welch(there, rate_hz, nperseg=segment, detrend=detrend)
        shown = (f >= 0.016) & (f <= 1.3)
        return f[shown], found[shown]

    f = np.linspace(0.0, rate_hz / 2.0, 4097)
    noise = accelerometer_noise(f, case.setting.sensor, rate_hz)
    heave = simulated_spectrum(case.scenario, f)
    shown = (f >= 0.016) & (f <= 1.3)
    least = heave * noise / ((2.0 * np.pi * f) ** 4 * heave + noise)
    axes.loglog(f[shown], heave[shown], color=BLACK, linewidth=1.0, label="heave, theory")
    axes.loglog(*density(truth), color=BLACK, linewidth=0.6, alpha=0.5, label="heave, record")
    for trace, color in zip(others, (GREEN, ORANGE, PURPLE), strict=False):
        axes.loglog(
            *density(trace.heave_m[kept] - truth), color=color, linewidth=0.8, label=f"error, {trace.estimator}"
        )
    axes.loglog(*density(ours.heave_m[kept] - truth), color=BLUE, linewidth=1.0, label=f"error, {ours.estimator}")
    axes.loglog(f[shown], least[shown], color=VERMILION, linewidth=0.9, linestyle="--", label="least, non-causal")
    axes.loglog(
        f[shown][1:], (noise / (2.0 * np.pi * np.maximum(f, f[1])) ** 4)[shown][1:], color=VERMILION, linewidth=0.7,
        linestyle=":", label="sensor noise as heave",
    )  # fmt: skip
    axes.set_ylim(1e-9, 3e3 * float(np.max(heave)))
    axes.set_xlim(0.016, 1.3)
    axes.set_xlabel("frequency / Hz", fontsize=8)
    axes.set_ylabel("density / m²/Hz", fontsize=8)
    axes.set_title(title, fontsize=8)
    axes.legend(loc="upper right", fontsize=5.5, frameon=False, ncols=2)
    figure.savefig(path)


def changing_sea(path: Path, case: Case, traces: Sequence[Trace], title: str) -> None:
    """Heave of a sea that grows and falls; below it the RMS error in windows of 20 s over the local deviation."""
    figure, (above, below) = _panels(3.6, (0.8, 1.2))
    t, truth = case.recording.t_s, case.recording.truth.heave_m
    kept = t < case.end_s
    above.plot(t[kept], truth[kept], color=BLACK, linewidth=0.25)
    for sign in (-1.0, 1.0):
        above.plot(t[kept], sign * COVER * case.local_sigma_m[kept], color=VERMILION, linewidth=0.8)
    above.set_ylabel("heave / m", fontsize=8)
    above.set_title(title, fontsize=8)
    starts = np.arange(60.0, case.end_s - LOCAL_S + 1e-9, LOCAL_S)
    for trace, color in zip(traces, (GREEN, ORANGE, BLUE, PURPLE), strict=False):
        relative = (trace.heave_m - truth) / case.local_sigma_m
        levels = [100.0 * rms(relative[(t >= start) & (t < start + LOCAL_S)]) for start in starts]
        below.semilogy(starts + LOCAL_S / 2.0, levels, color=color, linewidth=0.8, label=trace.estimator)
    for axes in (above, below):
        for part in case.segments:
            if part.name in ("growing", "falling"):
                axes.axvspan(part.start_s, part.end_s, color=SKY, alpha=0.3, linewidth=0.0)
        axes.set_xlim(0.0, case.end_s)
    low, high = below.get_ylim()
    below.set_ylim(low, high * (high / low) ** 0.25)
    below.yaxis.set_major_locator(_decades())
    below.yaxis.set_major_formatter("{x:g}")
    below.set_xlabel("time / s", fontsize=8)
    below.set_ylabel("error / % of local σ", fontsize=8)
    _legend(below)
    figure.savefig(path)


# --- all records -----------------------------------------------------------------------------------------------------


def forecasts(path: Path, results: Sequence[Result], title: str) -> None:
    """Error over horizon, the least possible beside it, as shares of the deviation of the heave."""
    figure, (axes,) = _panels(2.7, (1.0,))
    for result in results:
        color = OF_SCENARIO.get(result.scenario, VERMILION)
        x = [float(horizon) for horizon in result.forecast]
        reached = [100.0 * later.rms_m / result.sigma_m for later in result.forecast.values()]
        now = 100.0 * result.rms_m / result.sigma_m
        axes.semilogy([0.0, *x], [now, *reached], color=color, marker="o", markersize=2.5, linewidth=0.9,
                      label=result.scenario)  # fmt: skip
        axes.semilogy(*_limit_ahead(result), color=color, linestyle="--", linewidth=0.8)
    axes.plot([], [], color=BLACK, linestyle="--", linewidth=0.8, label="limit")
    axes.set_xlabel("horizon / s", fontsize=8)
    axes.set_ylabel("RMS error / % of σ", fontsize=8)
    axes.yaxis.set_major_locator(_decades())
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_title(title, fontsize=8)
    axes.legend(loc="lower right", fontsize=6, frameon=False, ncols=2)
    figure.savefig(path)


def _limit_ahead(result: Result) -> tuple[Array, Array]:
    """Horizons (s) and the least error (% of the deviation of the heave) at each: a curve for a sea whose spectrum is
    known, the points of the records for another.
    """
    if result.scenario in SEAS:
        horizons = np.linspace(0.0, 5.0, 41)
        rate_hz, sensor = result.setting.rate_hz, result.setting.sensor
        f = np.linspace(0.0, rate_hz / 2.0, CURVE_POINTS + 1)
        heave, noise = simulated_spectrum(result.scenario, f), accelerometer_noise(f, sensor, rate_hz)
        least_m = np.array([causal_heave_limit(f, heave, noise, -horizon) for horizon in horizons.tolist()])
    else:
        horizons = np.array([0.0, *map(float, result.forecast)])
        least_m = np.array([result.limit_m, *(at.rms_m / at.ratio_to_limit for at in result.forecast.values())])
    return horizons, 100.0 * least_m / result.sigma_m


def settling(path: Path, results: Sequence[Result], title: str) -> None:
    """Error in bins of 5 s from a cold start, over the deviation of the heave."""
    figure, (axes,) = _panels(2.7, (1.0,))
    for result in results:
        middles = BIN_S * (0.5 + np.arange(len(result.settling)))
        levels = np.array([100.0 * share if np.isfinite(share) else np.nan for share in result.settling])
        color = OF_SCENARIO[result.scenario]
        axes.semilogy(middles, levels, color=color, linewidth=0.9, label=result.scenario)
    asked = 100.0 * SETTLED_SHARE
    axes.plot([60.0, 60.0, SETTLING_END_S], [1e3, asked, asked], color=VERMILION, linewidth=0.9, linestyle="--",
              label="asked")  # fmt: skip
    axes.set_ylim(None, 500.0)
    axes.set_xlim(0.0, None)
    axes.yaxis.set_major_locator(_decades())
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("time since the first sample / s", fontsize=8)
    axes.set_ylabel("RMS error / % of σ", fontsize=8)
    axes.set_title(title, fontsize=8)
    axes.legend(loc="upper right", fontsize=6, frameon=False, ncols=3)
    figure.savefig(path)


# --- style -----------------------------------------------------------------------------------------------------------


def _panels(height_in: float, heights: tuple[float, ...]) -> tuple[Figure, tuple[Axes, ...]]:
    figure = Figure(figsize=(COLUMN_IN, height_in), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    panels = tuple(np.atleast_1d(figure.subplots(len(heights), 1, height_ratios=heights)).tolist())
    for axes in panels:
        axes.tick_params(labelsize=7)
        axes.yaxis.set_major_locator(MaxNLocator(5))
        axes.grid(linewidth=0.3, alpha=0.5)
        axes.set_axisbelow(True)
    return figure, panels


def _decades() -> LogLocator:
    return LogLocator(subs=(1.0, 2.0, 5.0))


def _legend(axes: Axes) -> None:
    axes.legend(loc="upper center", ncols=4, fontsize=5.5, frameon=False, columnspacing=0.9, handlelength=1.4)


def _head_room(axes: Axes, share: float) -> None:
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + share * (high - low))


def _shade_laser(axes: Axes, t_s: Array, on: NDArray[np.bool_], label: str | None = None) -> None:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], on, [False])).astype(int)))
    for i, (start, stop) in enumerate(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)):
        axes.axvspan(
            t_s[start],
            t_s[stop - 1],
            color=ORANGE,
            alpha=0.12,
            linewidth=0.0,
            label=label if i == 0 else None,
            zorder=0,
        )
