"""Fused heave and pitch in figures: a hydrofoil craft on a sea that steps from calm to rough and back, run many times.

Every way of fusing is run on the same voyages, beside each of its filters alone. Rates are what it is about: nobody
measures them. What the filters know of the craft is right (but for the row that says otherwise); of the waves they know
a spectrum of one peak, while the sea is JONSWAP, met at 18 m/s, moving hulls and foils.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from evidence.commands import Command, Options, add_runs, in_order
from evidence.results import Output, Report
from heaved.demo.craft_at_sea import hull
from heaved.estimation.craft.dynamics import Craft, Vessel
from heaved.estimation.craft.fusion import AttitudeFusion, Differ, Mode, Params
from heaved.estimation.craft.wave_force import Sea
from heaved.samples import CraftMotion
from heaved.simulate.hydrofoil import CRAFT_SHAKES, Passage, Voyage, sail

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

Array = NDArray[np.float64]

SETTLED_S: Final = 15.0
"""Figures are taken from here on, and a steady segment begins this long after a change of sea."""
STATES: Final = ("heave", "heave rate", "pitch", "pitch rate")
UNITS: Final = ("m", "m/s", "rad", "rad/s")
PASSAGE: Final = Passage()
VESSEL: Final = Vessel()
WRONG_VESSEL: Final = msgspec.structs.replace(
    VESSEL,
    heave_stiffness_npm=0.8 * VESSEL.heave_stiffness_npm,
    heave_damping_nspm=1.4 * VESSEL.heave_damping_nspm,
    pitch_damping_nmsprad=1.4 * VESSEL.pitch_damping_nmsprad,
    lift_slope_per_rad=1.25 * VESSEL.lift_slope_per_rad,
)
"""The worst of four ways to be wrong that were tried; wrong the other way is even a little better than right."""
FIVE_SEAS: Final = tuple(
    Sea(heave_rms_mps2=heave, pitch_rms_radps2=pitch)
    for heave, pitch in ((0.3, 0.03), (0.52, 0.055), (0.9, 0.1), (1.5, 0.16), (2.5, 0.25))
)


class Method(msgspec.Struct, frozen=True, kw_only=True):
    name: str
    params: Params
    outlier_share: float = 0.0
    shake: str = ""
    """Of ``CRAFT_SHAKES``."""


IMM: Final = "imm"
EWMA: Final = "ewma"
INSTANT: Final = "instant, seas"
POINT_SETS: Final = "instant, point sets"
OUTLIERS: Final = "imm, 2 % outliers"
FIVE: Final = "ewma, five seas"
METHODS: Final = (
    Method(name=IMM, params=Params()),
    Method(name=EWMA, params=Params(mode=Mode.EWMA)),
    Method(name=INSTANT, params=Params(mode=Mode.INSTANT, bank=Differ.SEAS)),
    Method(name=POINT_SETS, params=Params(mode=Mode.INSTANT)),
    Method(name=OUTLIERS, params=Params(), outlier_share=0.02),
    Method(name="imm, craft 20 to 40 % wrong", params=Params(vessel=WRONG_VESSEL)),
    Method(name=FIVE, params=Params(mode=Mode.EWMA, seas=FIVE_SEAS)),
)


SHAKEN: Final = (
    Method(name=IMM, params=Params()),
    *(Method(name=f"{IMM}, {shake}", params=Params(), shake=shake) for shake in CRAFT_SHAKES),
)
"""The default method, undisturbed and on readings that shake."""
SHAKEN_PASSAGE: Final = Passage(stages=((0.0, 1.5),), duration_s=180.0)
"""One sea: the disturbance is what differs."""


class Run(msgspec.Struct, frozen=True, kw_only=True):
    """One voyage by one method, per part of it: the whole, then each steady segment. Arrays as nested tuples."""

    fused: tuple[tuple[float, ...], ...]
    """(parts, 4): mean squared errors."""
    filters: tuple[tuple[tuple[float, ...], ...], ...]
    """(filters, parts, 4): the same of each filter alone."""
    nees: tuple[float, ...]
    """(parts,): normalised error squared over 4."""
    product: tuple[float, ...]
    """(4,): mean product of the errors of the first two filters, over the whole."""
    oracle: tuple[float, ...]
    """(4,): mean squared error of whichever filter is nearer to the truth at every instant, over the whole."""
    switches_per_s: float
    gated: float
    """Share of the readings that were beyond the gate."""
    resets: int


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One method over all runs; states in the order heave, heave rate, pitch, pitch rate; SI units."""

    method: str
    runs: int
    part: str
    """"whole", or the steady segment by its significant height."""
    rms: tuple[float, ...]
    filter_rms: tuple[tuple[float, ...], ...]
    """Each of its filters alone."""
    against_best: tuple[float, ...]
    """RMS over that of the best single filter of the table, which may be another one for each state and part."""
    nees: float
    """Over 4; 1 when the published covariance is right."""
    switches_per_s: float
    gated: float
    resets: int
    correlation: tuple[float, ...]
    """Between the errors of the first two filters, over the whole."""
    oracle: tuple[float, ...]
    """RMS over the best single filter's of a choice that knows the truth, over the whole."""


def voyage(seed: int, passage: Passage = PASSAGE) -> tuple[Voyage, tuple[float, float]]:
    """One voyage of the default craft, and its trim: heave is measured from there."""
    craft = Craft(VESSEL)
    trim = craft.trim(passage.speed_mps)
    return sail(craft.accelerations, trim, (seed,), passage, hull(VESSEL))[0], trim


def parts(passage: Passage) -> list[tuple[str, float, float]]:
    """(name, from s, to s): the whole, and between the changes of sea."""
    result = [("whole", SETTLED_S, passage.duration_s)]
    ends = [start for start, _ in passage.stages[1:]] + [passage.duration_s]
    for (start, height), end in zip(passage.stages, ends, strict=True):
        result.append((f"{start:g} s, Hs {height:g} m", start + SETTLED_S, min(end, passage.duration_s) - 3.0))
    return result


class Trace(msgspec.Struct, frozen=True, kw_only=True):
    """One voyage by one method, at every sample."""

    estimates: list[CraftMotion]
    error: Array
    """(n, 4)."""
    filter_error: Array
    """(filters, n, 4)."""
    nees: Array
    """(n,): over 4."""


def follow(made: Voyage, trim: tuple[float, float], fusion: AttitudeFusion) -> Trace:
    """Run a filter over a voyage; nan where the very first readings are lost."""
    truth = made.truth.T - np.array([trim[0], 0.0, 0.0, 0.0])
    measured = (made.measured_heave_m - trim[0], made.measured_pitch_rad)
    columns = (made.t_s, *measured, made.speed_mps, made.flap_fore_rad, made.flap_aft_rad)
    estimates: list[CraftMotion] = []
    filters: list[Array] = []
    moments: list[Array] = []
    covariances: list[Array] = []
    for sample in zip(*(column.tolist() for column in columns), strict=True):
        estimate, now = fusion.step(*sample), fusion.filters
        if estimate is None or now is None:
            if estimates:
                raise ValueError(f"no estimate at {sample[0]:g} s")
            continue
        x, P = fusion.moments()
        estimates.append(estimate)
        filters.append(now.x[:, :4])
        moments.append(x[:4])
        covariances.append(P[:4, :4])
    before = len(truth) - len(moments)
    error = np.array(moments) - truth[before:]
    filter_error = np.array(filters).swapaxes(0, 1) - truth[before:]
    solved = np.linalg.solve(np.array(covariances), error[:, :, None])[:, :, 0]
    return Trace(
        estimates=estimates,
        error=np.pad(error, ((before, 0), (0, 0)), constant_values=np.nan),
        filter_error=np.pad(filter_error, ((0, 0), (before, 0), (0, 0)), constant_values=np.nan),
        nees=np.pad(np.sum(error * solved, axis=1) / 4.0, (before, 0), constant_values=np.nan),
    )


def evaluate(seed: int, methods: Sequence[Method] = METHODS, passage: Passage = PASSAGE) -> list[Run]:
    """One voyage by every method; the same sea and the same noise for all."""
    runs = []
    wrongs = {(method.outlier_share, method.shake) for method in methods}
    voyages = {
        (share, shake): voyage(seed, msgspec.structs.replace(passage, outlier_share=share, shake=shake))
        for share, shake in wrongs
    }
    for method in methods:
        made, trim = voyages[method.outlier_share, method.shake]
        fusion = AttitudeFusion(method.params)
        trace = follow(made, trim, fusion)
        shown = [(made.t_s >= start) & (made.t_s <= end) for _, start, end in parts(passage)]
        whole = trace.filter_error[:, shown[0]]
        runs.append(
            Run(
                fused=tuple(_mean(trace.error[mask] ** 2) for mask in shown),
                filters=tuple(tuple(_mean(error[mask] ** 2) for mask in shown) for error in trace.filter_error),
                nees=tuple(float(np.mean(trace.nees[mask])) for mask in shown),
                product=_mean(whole[0] * whole[1]),
                oracle=_mean(np.min(whole**2, axis=0)),
                switches_per_s=fusion.switches / passage.duration_s,
                gated=sum(fusion.gated) / (2 * len(made.t_s)),
                resets=fusion.resets.total(),
            )
        )
    return runs


def _mean(values: Array) -> tuple[float, ...]:
    return tuple(np.mean(values, axis=0).tolist())


def table(
    seeds: Sequence[int] = range(1, 51),
    jobs: int = 1,
    methods: Sequence[Method] = METHODS,
    passage: Passage = PASSAGE,
) -> list[Row]:
    """Every method on every part; ``jobs`` processes share the voyages."""
    by_seed = in_order(partial(evaluate, methods=methods, passage=passage), seeds, jobs)
    names = [name for name, _, _ in parts(passage)]
    # Filters that nothing is mixed into; five tunings include the three, so that the best is not one between them.
    alone = [m.name for m in methods if m.params.mode != Mode.IMM and m.outlier_share == 0.0] or [methods[0].name]
    best = methods[[m.name for m in methods].index(FIVE if FIVE in alone else alone[0])]
    singles = [runs[methods.index(best)] for runs in by_seed]
    return [
        _row(method.name, [runs[i] for runs in by_seed], singles, part, name)
        for i, method in enumerate(methods)
        for part, name in enumerate(names)
    ]


def _row(method: str, runs: Sequence[Run], singles: Sequence[Run], part: int, name: str) -> Row:
    fused = np.sqrt(np.mean([run.fused[part] for run in runs], axis=0))
    alone = np.mean([run.filters for run in runs], axis=0)  # (filters, parts, 4) of squares
    best = np.sqrt(np.min(np.mean([run.filters for run in singles], axis=0)[:, part], axis=0))
    whole = alone[:, 0]
    return Row(
        method=method,
        runs=len(runs),
        part=name,
        rms=tuple(fused.tolist()),
        filter_rms=tuple(tuple(row) for row in np.sqrt(alone[:, part]).tolist()),
        against_best=tuple((fused / best).tolist()),
        nees=float(np.mean([run.nees[part] for run in runs])),
        switches_per_s=float(np.mean([run.switches_per_s for run in runs])),
        gated=float(np.mean([run.gated for run in runs])),
        resets=sum(run.resets for run in runs),
        correlation=tuple((np.mean([run.product for run in runs], axis=0) / np.sqrt(whole[0] * whole[1])).tolist()),
        oracle=tuple(np.sqrt(np.mean([run.oracle for run in runs], axis=0) / np.min(whole, axis=0)).tolist()),
    )


def report(rows: Sequence[Row]) -> str:
    """The tables as Markdown: errors per part, then the bookkeeping, then what the choice of point sets is worth."""
    lines = [f"{rows[0].runs} runs; RMS error (and over the best single filter's).", ""]
    columns = " | ".join(f"{state} {unit}" for state, unit in zip(STATES, UNITS, strict=True))
    for part in dict.fromkeys(row.part for row in rows):
        lines += [f"### {part}", "", f"| method | {columns} | NEES/4 |", "|---|---|---|---|---|---|"]
        for row in (r for r in rows if r.part == part):
            errors = (f"{rms:.4f} ({ratio:.3f})" for rms, ratio in zip(row.rms, row.against_best, strict=True))
            lines.append(f"| {row.method} | {' | '.join(errors)} | {row.nees:.2f} |")
            if row.method in (FIVE, POINT_SETS):
                for i, alone in enumerate(row.filter_rms, start=1):
                    single = " | ".join(f"{rms:.4f}" for rms in alone)
                    lines.append(f"| {row.method}: filter {i} alone | {single} | |")
        lines.append("")
    whole = [row for row in rows if row.part == "whole"]
    lines += [
        "### Bookkeeping, and two filters compared",
        "",
        "| method | switches 1/s | beyond the gate | resets | error correlation | choice by truth, × best single |",
        "|---|---|---|---|---|---|",
    ]
    for row in whole:
        correlation = ", ".join(f"{value:.5f}" for value in row.correlation)
        oracle = ", ".join(f"{value:.3f}" for value in row.oracle)
        lines.append(
            f"| {row.method} | {row.switches_per_s:.2f} | {100 * row.gated:.1f} % | {row.resets} "
            f"| {correlation} | {oracle} |"
        )
    return "\n".join([*lines, "", *_summary(whole)])


def _summary(whole: Sequence[Row]) -> list[str]:
    """What each method is to IMM, state by state."""
    imm = next((row for row in whole if row.method == IMM), None)
    if imm is None:
        return []
    lines = ["RMS over that of imm, whole voyage:", ""]
    for row in whole:
        ratios = ", ".join(
            f"{name.rsplit(' ', 1)[0]} {a / b:.3f}" for name, a, b in zip(STATES, row.rms, imm.rms, strict=True)
        )
        lines.append(f"* {row.method}: {ratios}")
    return lines


def figure(path: Path, seed: int = 1, passage: Passage = PASSAGE) -> None:
    """The sea's steps in heave rate, its error by three ways of fusing, and the probabilities of the seas, as a PNG.

    Raises:
        OSError: the file cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    made, trim = voyage(seed, passage)
    shown = {name: follow(made, trim, AttitudeFusion(params)) for name, params in _DRAWN}
    t, imm = made.t_s, shown[IMM]
    colours = ("#56B4E9", "#E69F00", "#0072B2")
    fig, axes = pyplot.subplots(4, 1, sharex=True, figsize=(9, 9), layout="constrained")
    axes[0].plot(t, made.heave_velocity_mps, color="0.3", linewidth=0.7)
    axes[0].set_ylabel("heave rate / m/s")
    stages = ", ".join(f"{height:g} m from {start:g} s" for start, height in passage.stages)
    axes[0].set_title(f"Hydrofoil craft at {passage.speed_mps:g} m/s, Hs {stages}")
    for (name, trace), colour in zip(shown.items(), ("#009E73", "#E69F00", "#000000"), strict=True):
        memory = max(1, round(3.0 * passage.rate_hz))
        rms = np.sqrt(np.convolve(trace.error[:, 1] ** 2, np.full(memory, 1.0 / memory), mode="same"))
        axes[1].plot(t, rms, color=colour, linewidth=1.1, label=name)
    axes[1].set_ylabel("rate error, RMS of 3 s / m/s")
    axes[1].legend(loc="upper left", ncols=3, fontsize=8)
    std = np.array([estimate.heave_velocity_std_mps for estimate in imm.estimates])
    axes[2].plot(t, imm.error[:, 1], color="#0072B2", linewidth=0.5, label="error of imm")
    axes[2].fill_between(t, -2 * std, 2 * std, color="#0072B2", alpha=0.2, label="± 2 published σ")
    axes[2].set_ylim(-1.0, 1.0)
    axes[2].set_ylabel("rate error / m/s")
    axes[2].legend(loc="upper left", ncols=2, fontsize=8)
    probabilities = np.array([estimate.probabilities for estimate in imm.estimates]).T
    axes[3].stackplot(t, probabilities, colors=colours, labels=("calm", "moderate", "rough"), alpha=0.8)
    axes[3].set_ylim(0.0, 1.0)
    axes[3].set_ylabel("probability")
    axes[3].set_xlabel("t / s")
    axes[3].legend(loc="upper left", ncols=3, fontsize=8)
    axes[3].set_xlim(t[0], t[-1])
    fig.savefig(path, dpi=110)
    pyplot.close(fig)


_DRAWN: Final = (
    (INSTANT, Params(mode=Mode.INSTANT, bank=Differ.SEAS)),
    (EWMA, Params(mode=Mode.EWMA)),
    (IMM, Params()),
)


# --- command line ----------------------------------------------------------------------------------------------------


def run_attitude(options: Options, output: Output) -> Report:
    """
    Raises:
        ValueError: the duration ends before the last change of sea.
    """
    passage = SHAKEN_PASSAGE if options.shake else PASSAGE
    if options.duration is not None:
        if options.duration <= passage.stages[-1][0]:
            raise ValueError(f"the last change of sea is at {passage.stages[-1][0]:g} s: give a longer --duration")
        passage = msgspec.structs.replace(passage, duration_s=options.duration)
    seeds = range(1, options.runs + 1)
    rows = table(seeds, options.jobs, SHAKEN if options.shake else METHODS, passage)
    output.write("attitude", rows)
    if output.figures and not options.shake:
        figure(output.folder / "attitude.png", passage=passage)
    return Report(report(rows), tuple(seeds))


COMMANDS = {"attitude": Command(run_attitude, add_runs, "heave and pitch of a foil-assisted catamaran, simulated")}
