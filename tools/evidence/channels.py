"""How far below the limit of a single channel heave could be known: tools/accuracy.py channels.

For seas from many directions, and for a real ship where its record is present: the least error from the vertical
acceleration alone, with roll, with pitch and with both, and what the product does on the very records.
"""

from __future__ import annotations

from functools import lru_cache
from math import inf, nan, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
import recordings
from numpy.typing import NDArray
from scipy.signal import csd

from evidence import scenarios
from evidence.channel_limits import (
    PITCH,
    ROLL,
    Spectra,
    causal_filters,
    causal_limits,
    error_of,
    measured_spectra,
    multiple_coherence,
)
from evidence.commands import (
    Command,
    Options,
    Parser,
    add_common,
    add_duration,
    add_jobs,
    add_seeds,
    count,
    in_order,
)
from evidence.heave import estimators
from evidence.heave.commands import add_observer
from evidence.heave.scores import rms
from evidence.learned_limits import learned_heave_limit
from evidence.results import Output, Report
from evidence.scenarios import HORIZONS_S, Setting, accelerometer_noise, grid, triplet
from heaved.estimation.heave.sea.joint_design import TUNING as JOINT
from heaved.estimation.heave.sea.joint_learning import TUNING as LEARNING
from heaved.simulate.directional import NAMES, directional
from heaved.simulate.seaway import motion_spectra
from heaved.simulate.sensors import REGISTER_STEPS, imu_model

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SHIP: Final = "palmer"
SENSORS: Final = ("A", "B", "C")
RATE_HZ: Final = 20.0
AHEAD_S: Final = (0.0, *HORIZONS_S)
"""Heave now, and ahead."""
CHANNELS: Final = ((), (ROLL,), (PITCH,), (ROLL, PITCH))
"""What is looked at besides the vertical acceleration."""
PIECE_S: Final = 100.0
"""Spectra of a ship's record are means over pieces of so long, overlapping by half."""
LEARNED_S: Final = LEARNING.learned_s
"""Of a record, that teaches what roll and pitch have in common with the heave,"""
LOOKS: Final = round(1.9 * LEARNED_S / LEARNING.piece_s)
"""in so many independent looks at each frequency: windows of Hann that overlap by three quarters."""
DRAWS: Final = 4
"""Records of which the error of what is learned is the RMS."""
COARSE: Final = 8193
"""Frequencies of the grid for what is learned: 0.0012 Hz apart."""
PARTS: Final = {"before": 0.0, "turning": 0.5, "after": 1.0}
"""Of a turn: how much of it is done in the middle of each."""
AFTER: Final = "after"
IN_USE: Final = 0.5
"""Weight above which roll and pitch count as in use,"""
STAYS_S: Final = 30.0
"""when it is for so long."""
ASKED_AGAIN_S: Final = 180.0
"""After a turn they are to be so again within that."""


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One sea and sensor, or one part of a record in which the vessel turns. Each error: now, and for the horizons."""

    scenario: str
    part: str
    """Empty: all of it."""
    sensor: str
    sigma_m: float
    """Standard deviation of true heave, of the spectrum."""
    alone_m: tuple[float, ...]
    """Least RMS error from the vertical acceleration alone,"""
    roll_m: tuple[float, ...]
    """and with roll,"""
    pitch_m: tuple[float, ...]
    """and with pitch,"""
    both_m: tuple[float, ...]
    """and with both."""
    wandering_m: float
    """The least now with both, where list and trim wander: as little as the product takes them to, at sea as they
    did."""
    learned_m: float
    """The error then of the best filter of spectra whose angles were learned of :data:`LEARNED_S` of the record, with
    the heave as it was."""
    fitted_m: float
    """That of the best filter of the vertical acceleration alone for a spectrum of the product's family that was fitted
    to :data:`LEARNED_S` of it."""
    unaware_m: tuple[float, ...]
    """RMS error with both, of the best filter of the heading before the turn; nan: there is none."""
    ours_m: tuple[float, ...]
    """RMS error of the product; nan: not run."""
    within: float
    """Share of its errors now within 1.96 of the standard deviations that it publishes."""
    again_s: float = nan
    """The longest time after a turn until roll and pitch were in use again, :func:`again_s`; nan: there was none."""


class Limit(msgspec.Struct, frozen=True):
    """The least errors (m) for :data:`CHANNELS`, each for :data:`AHEAD_S`."""

    sigma_m: float
    errors_m: tuple[tuple[float, ...], ...]
    fitted_m: float
    """Now, of the vertical acceleration alone with a spectrum of heave that was learned, too."""


class Task(msgspec.Struct, frozen=True, kw_only=True):
    """One record that the product is to run over."""

    scenario: str
    sensor: str
    observer: str
    number: int
    duration_s: float | None
    folder: Path | None


class Part(msgspec.Struct, frozen=True):
    """What the product did on a part of a record."""

    errors_m: tuple[float, ...]
    within: float
    again_s: float = nan
    """See :func:`again_s`; nan: the vessel has not turned before it."""


# --- limits ----------------------------------------------------------------------------------------------------------


@lru_cache
def limits_at_sea(scenario: str, sensor: str, turned_rad: float = 0.0) -> Limit:
    """Of a simulated sea, for a vessel that has turned so far and keeps that heading."""
    f = grid(RATE_HZ)
    return limits(f, motion_spectra(scenario, f, turned_rad), sensor)


@lru_cache
def unaware_at_sea(scenario: str, sensor: str, turned_rad: float) -> tuple[float, ...]:
    """RMS errors (m) for :data:`AHEAD_S` of the filters that were best before the vessel turned so far."""
    f = grid(RATE_HZ)
    before, now = (seen(f, motion_spectra(scenario, f, angle), sensor, (ROLL, PITCH)) for angle in (0.0, turned_rad))
    filters = causal_filters(before, AHEAD_S)
    return tuple(error_of(one, now, horizon_s) for one, horizon_s in zip(filters, AHEAD_S, strict=True))


@lru_cache
def attainable_at_sea(scenario: str, sensor: str, turned_rad: float = 0.0) -> tuple[float, float]:
    """:func:`attainable` of a simulated sea, for a vessel that has turned so far and keeps that heading."""
    f = np.linspace(0.0, RATE_HZ / 2.0, COARSE)
    return attainable(f, motion_spectra(scenario, f, turned_rad), sensor, least_wander(f))


def attainable(f_hz: Array, motion: Complex, sensor: str, wander_psd: Array) -> tuple[float, float]:
    """:attr:`Row.wandering_m` and :attr:`Row.learned_m`."""
    (limit_m,) = causal_limits(seen(f_hz, motion, sensor, (ROLL, PITCH), wander_psd))
    return limit_m, learned_m(f_hz, motion, sensor, wander_psd)


def limits(f_hz: Array, motion: Complex, sensor: str) -> Limit:
    """Of heave, roll and pitch with these spectra (n, 3, 3), on a grid of :func:`evidence.scenarios.grid`."""
    found = [causal_limits(seen(f_hz, motion, sensor, angles), AHEAD_S) for angles in CHANNELS]
    sigma_m = sqrt(float(np.trapezoid(motion[:, 0, 0].real, f_hz)))
    fitted_m = learned_heave_limit(f_hz, motion[:, 0, 0].real, accelerometer_noise(f_hz, sensor, RATE_HZ), LEARNED_S)
    return Limit(sigma_m, tuple(tuple(errors) for errors in found), fitted_m)


def seen(f_hz: Array, motion: Complex, sensor: str, angles: Sequence[int], wander_psd: Array | float = 0.0) -> Spectra:
    """What a sensor shows of a motion. ``wander_psd`` (n, 2): of list and trim beside it."""
    noise = accelerometer_noise(f_hz, sensor, RATE_HZ)
    return measured_spectra(f_hz, motion, noise, angle_noise(sensor) + wander_psd, angles)


def least_wander(f_hz: Array) -> Array:
    """(n, 2) spectra of list and trim as the product takes them to wander at least."""
    psd = JOINT.least_wander / np.maximum(f_hz, 0.5e-3) ** 2
    return np.column_stack([psd, psd])


def learned_m(f_hz: Array, motion: Complex, sensor: str, wander_psd: Array) -> float:
    """RMS error (m) now, in this sea, of the filter that is best for what :data:`LEARNED_S` of it show of the angles.

    The heave's own spectrum is known. Estimates of a matrix of spectra are drawn (complex Wishart) as Welch's method
    makes them, where the sea has a thousandth of its peak; beyond, they are held.
    """
    rng = np.random.default_rng(1)
    at = np.flatnonzero(motion[:, 0, 0].real > 1e-3 * np.max(motion[:, 0, 0].real))
    at = at[:: max(round(1.0 / LEARNING.piece_s / f_hz[1]), 1)]
    root = np.linalg.cholesky(motion[at] + 1e-6 * np.einsum("fii,ij->fij", motion[at], np.eye(3)))
    truth = seen(f_hz, motion, sensor, (ROLL, PITCH), wander_psd)
    squares = []
    for _ in range(DRAWS):
        drawn = rng.standard_normal((2, len(at), 3, LOOKS)) / sqrt(2.0 * LOOKS)
        looks = root @ (drawn[0] + 1j * drawn[1])
        found = looks @ looks.conj().transpose(0, 2, 1)
        found /= found[:, :1, :1].real
        flat = found.reshape(len(at), 9).T
        held = [np.interp(f_hz, f_hz[at], x.real) + 1j * np.interp(f_hz, f_hz[at], x.imag) for x in flat]
        learned = motion[:, :1, :1] * np.stack(held, axis=1).reshape(-1, 3, 3)
        (filter_,) = causal_filters(seen(f_hz, learned, sensor, (ROLL, PITCH), wander_psd))
        squares.append(error_of(filter_, truth) ** 2)
    return sqrt(float(np.mean(squares)))


def angle_noise(sensor: str) -> float:
    """One-sided noise density of roll and of pitch, rad2/Hz: white, and rounding to registers."""
    model = imu_model(sensor)
    variance = model.attitude_noise_rad**2 + (REGISTER_STEPS[3] ** 2 / 12.0 if model.sixteen_bit else 0.0)
    return float(variance / (RATE_HZ / 2.0))


def _ship_densities(path: Path) -> tuple[Array, Complex, int]:
    """Frequencies (n,), spectra (n, 3, 3) of heave, roll and pitch of a real ship, and how many pieces these are of.

    Raises:
        ValueError: the file has not these columns, or is too short.
        OSError: the file cannot be read.
    """
    truth = recordings.palmer(path, rate_hz=RATE_HZ, laser="off").truth
    kept = (truth.t_s >= recordings.FADE_S) & (truth.t_s < truth.t_s[-1] - recordings.FADE_S)
    series = [values[kept] for values in (truth.heave_m, truth.roll_rad, truth.pitch_rad)]
    length = round(PIECE_S * RATE_HZ)
    pieces = 2 * series[0].size // length - 1
    if pieces < 4:
        raise ValueError(f"{path}: too short for spectra of pieces of {PIECE_S:g} s")
    # SciPy's cross-spectrum is that of conj(X) Y.
    found = [[csd(y, x, fs=RATE_HZ, nperseg=length) for y in series] for x in series]
    motion = np.moveaxis(np.array([[density for _, density in row] for row in found]), 2, 0).astype(np.complex128)
    return found[0][0][0], motion, pieces


def ship_wander(path: Path, f_hz: Array) -> Array:
    """(n, 2) spectra of what roll and pitch of a real ship do below its waves, at ``f_hz``, and at least
    :func:`least_wander`.

    Raises:
        ValueError, OSError: as :func:`ship_spectra`.
    """
    at, motion, _ = _ship_densities(path)
    below = (at > 0.0) & (at < recordings.SHIP_BAND_HZ[0])
    psd = [
        np.where(f_hz < recordings.SHIP_BAND_HZ[0], np.interp(f_hz, at[below], motion[below, k, k].real), 0.0)
        for k in (ROLL, PITCH)
    ]
    return np.asarray(np.maximum(np.column_stack(psd), least_wander(f_hz)), dtype=np.float64)


def ship_spectra(path: Path, f_hz: Array) -> Complex:
    """Spectra (n, 3, 3) of heave, roll and pitch of a real ship, at ``f_hz``.

    Means over K pieces find a coherence even between what has nothing in common, with two inputs about 2 / K: what of
    heave does not follow from the angles is made greater by K / (K - 2), and its cross-spectra the smaller for it.

    Raises:
        ValueError: the file has not these columns, or is too short.
        OSError: the file cannot be read.
    """
    at, motion, pieces = _ship_densities(path)
    motion[(at < recordings.SHIP_BAND_HZ[0]) | (at > recordings.SHIP_BAND_HZ[1])] = 0.0
    apparent = np.nan_to_num(multiple_coherence(motion))
    true = np.maximum(1.0 - (1.0 - apparent) * pieces / (pieces - 2.0), 0.0)
    shrunk = np.sqrt(np.divide(true, apparent, out=np.zeros_like(true), where=apparent > 0.0))
    motion[:, 0, 1:] *= shrunk[:, None]
    motion[:, 1:, 0] *= shrunk[:, None]
    flat = motion.reshape(len(at), -1)
    between = [np.interp(f_hz, at, flat[:, k].real) + 1j * np.interp(f_hz, at, flat[:, k].imag) for k in range(9)]
    return np.stack(between, axis=1).reshape(-1, 3, 3)


def coherence_of(motion: Complex) -> float:
    """Squared multiple coherence of heave with roll and pitch, each frequency weighing as much as its heave has."""
    heave = motion[:, 0, 0].real
    return float(np.nansum(multiple_coherence(motion) * heave) / np.sum(heave))


# --- the product -----------------------------------------------------------------------------------------------------


def run(task: Task) -> dict[str, Part]:
    """The errors of the product on one record, by part.

    Raises:
        ValueError: as :func:`evidence.scenarios.build`.
        OSError: a real record cannot be read.
    """
    setting = Setting(sensor=task.sensor, rate_hz=RATE_HZ, duration_s=task.duration_s)
    case = scenarios.build(task.scenario, triplet(task.number), setting, task.folder)
    conditions = estimators.Conditions(
        rate_hz=case.rate_hz, period_s=case.period_s, has_laser=False, horizons_s=HORIZONS_S
    )
    (trace,) = estimators.traces(task.observer, list(case.recording.samples()), conditions)
    t, truth = case.recording.t_s, case.recording.truth.heave_m
    windows = {part.name: (part.start_s, part.end_s) for part in case.segments} or {"": (case.start_s, case.end_s)}
    found = {}
    for name, (start_s, end_s) in windows.items():
        errors = []
        for horizon_s in AHEAD_S:
            made = (t >= start_s) & (t + horizon_s < end_s)
            said = trace.forecast[horizon_s].heave_m if horizon_s else trace.heave_m
            errors.append(rms(said[made] - np.interp(t[made] + horizon_s, t, truth)))
        inside = (t >= start_s) & (t < end_s)
        std = trace.std_m if trace.std_m is not None else np.full(t.size, nan)
        covered = float(np.mean(np.abs(trace.heave_m - truth)[inside] <= 1.96 * std[inside]))
        weight = trace.angles_weight
        has_turned = name == AFTER and weight is not None
        found[name] = Part(
            tuple(errors), covered, again_s(t[inside], weight[inside]) if has_turned and weight is not None else nan
        )
    return found


def again_s(t_s: Array, weight: Array) -> float:
    """Time after the first of ``t_s`` (n,) from which the weight (n,) of roll and pitch is above one half for
    :data:`STAYS_S` at least; inf: not in that time.
    """
    ends = np.append(np.flatnonzero(weight <= IN_USE), t_s.size)
    begins = np.append(0, ends[:-1] + 1)
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        if end > begin and t_s[end - 1] - t_s[begin] >= STAYS_S:
            return float(t_s[begin] - t_s[0])
    return inf


def together(parts: Sequence[Part]) -> Part:
    """Several records: the RMS of their errors."""
    errors = np.sqrt(np.mean(np.square([part.errors_m for part in parts]), axis=0))
    within = float(np.mean([part.within for part in parts]))
    return Part(tuple(errors.tolist()), within, max(part.again_s for part in parts))


# --- rows and tables -------------------------------------------------------------------------------------------------


def rows(names: Sequence[str], sensors: Sequence[str], found: dict[tuple[str, str], list[dict[str, Part]]],
         folder: Path | None = None) -> list[Row]:  # fmt: skip
    """Limits, and beside them what the product did on the records of a scenario and sensor, where it has run.

    Raises:
        ValueError, OSError: as :func:`ship_spectra`.
    """
    made = []
    for name in names:
        asked = directional(name)
        turn = None if asked is None else asked.turn
        for sensor in sensors:
            records = found.get((name, sensor), [])
            for part in PARTS if turn is not None else ("",):
                unaware_m = (nan,) * len(AHEAD_S)
                if asked is None:
                    f = grid(RATE_HZ)
                    path = scenarios.files(name, folder)[0]
                    limit = limits(f, ship_spectra(path, f), sensor)
                    f = np.linspace(0.0, RATE_HZ / 2.0, COARSE)
                    reached = attainable(f, ship_spectra(path, f), sensor, ship_wander(path, f))
                elif turn is None:
                    limit, reached = limits_at_sea(name, sensor), attainable_at_sea(name, sensor)
                else:
                    turned_rad = turn.angle_rad * PARTS[part]
                    limit = limits_at_sea(name, sensor, turned_rad)
                    reached = attainable_at_sea(name, sensor, turned_rad)
                    unaware_m = unaware_at_sea(name, sensor, turned_rad)
                there = [record[part] for record in records if part in record]
                ours = together(there) if there else Part((nan,) * len(AHEAD_S), nan)
                alone, roll, pitch, both = limit.errors_m
                made.append(
                    Row(
                        scenario=name,
                        part=part,
                        sensor=sensor,
                        sigma_m=limit.sigma_m,
                        alone_m=alone,
                        roll_m=roll,
                        pitch_m=pitch,
                        both_m=both,
                        wandering_m=reached[0],
                        learned_m=reached[1],
                        fitted_m=limit.fitted_m,
                        unaware_m=unaware_m,
                        ours_m=ours.errors_m,
                        within=ours.within,
                        again_s=ours.again_s,
                    )
                )
    return made


def report(made: Sequence[Row], folder: Path | None = None) -> str:
    """Markdown."""
    has_ours = any(row.ours_m[0] > 0.0 for row in made)
    heads = ["sea", "sensor", "σ / m", "alone", "+ roll", "+ pitch", "+ both", "to be gained", "wandering", "learned"]
    heads += ["alone, fitted"]
    heads += ["**ours**", "times alone", "times both", "times learned", "within 1.96 std"] if has_ours else []
    lines = [
        f"RMS error of heave in % of σ, {RATE_HZ:g} Hz, no laser. Limits: the vertical acceleration alone, with roll, "
        "with pitch, with both; in a turn, those of a vessel that keeps the heading it has then. Wandering: with both, "
        "while list and trim wander beside the waves (at sea as the product takes them to at least, "
        f"{JOINT.least_wander:g} rad² Hz over f², of a ship as they did). Learned: then, what the angles have to do "
        f"with heave being known of {LEARNED_S:g} s of it alone. Alone, fitted: the acceleration alone, with a "
        "spectrum of the product's family that is fitted to so much of it.",
        "",
        *_head(heads),
    ]
    for row in made:
        now = [100.0 * errors[0] / row.sigma_m for errors in (row.alone_m, row.roll_m, row.pitch_m, row.both_m)]
        gain = max(1.0 - row.both_m[0] / row.alone_m[0], 0.0)
        cells = [_name(row), row.sensor, f"{row.sigma_m:.3f}", *[f"{value:.2f}" for value in now], f"{gain:.0%}"]
        cells += [f"{100.0 * value / row.sigma_m:.2f}" for value in (row.wandering_m, row.learned_m, row.fitted_m)]
        if has_ours:
            cells += [
                _known(100.0 * row.ours_m[0] / row.sigma_m, ".2f", "**"),
                _known(row.ours_m[0] / row.alone_m[0], ".2f"),
                _known(row.ours_m[0] / row.both_m[0], ".2f"),
                _known(row.ours_m[0] / row.learned_m, ".2f"),
                _known(row.within, ".0%"),
            ]
        lines.append(f"| {' | '.join(cells)} |")
    lines += ["", f"Ahead, in % of σ: limit alone / with both{' / ours' if has_ours else ''}.", ""]
    lines += _head(["sea", "sensor", *[f"{horizon:g} s" for horizon in HORIZONS_S]])
    for row in made:
        shown = (row.alone_m, row.both_m, row.ours_m) if has_ours else (row.alone_m, row.both_m)
        cells = [
            " / ".join(_known(100.0 * errors[k] / row.sigma_m, ".1f") for errors in shown)
            for k in range(1, len(AHEAD_S))
        ]
        lines.append(f"| {_name(row)} | {row.sensor} | {' | '.join(cells)} |")
    if turned := [row for row in made if row.unaware_m[0] > 0.0]:
        lines += ["", "Nobody has noticed the turn: the filter of both that was best before it, in % of σ.", ""]
        lines += _head(["sea", "sensor", *[f"{horizon:g} s" for horizon in AHEAD_S]])
        for row in turned:
            cells = [f"{100.0 * error / row.sigma_m:.1f}" for error in row.unaware_m]
            lines.append(f"| {_name(row)} | {row.sensor} | {' | '.join(cells)} |")
    if turned := [row for row in made if row.again_s >= 0.0]:
        lines += ["", f"After the turn, until roll and pitch are in use again with a weight above {IN_USE:g}, for "
                  f"{STAYS_S:g} s at least (the slowest of the records):", ""]  # fmt: skip
        lines += _head(["sea", "sensor", "s", "asked"])
        for row in turned:
            met = "met" if row.again_s <= ASKED_AGAIN_S else "**missed**"
            lines.append(f"| {row.scenario} | {row.sensor} | {_known(row.again_s, '.0f')} | {met} |")
        lines += ["", f"Asked: {ASKED_AGAIN_S:g} s at most. –: not before the end of the record."]
    if any(row.scenario == SHIP for row in made):
        f = grid(RATE_HZ)
        share = coherence_of(ship_spectra(scenarios.files(SHIP, folder)[0], f))
        lines += [
            "",
            f"{SHIP}: squared multiple coherence of heave with roll and pitch, weighted by heave: {share:.3f}.",
        ]
    return "\n".join(lines)


def _head(names: Sequence[str]) -> list[str]:
    return [f"| {' | '.join(names)} |", "|---" * len(names) + "|"]


def _name(row: Row) -> str:
    return f"{row.scenario}, {row.part}" if row.part else row.scenario


def _known(value: float, form: str, around: str = "") -> str:
    return f"{around}{value:{form}}{around}" if -inf < value < inf else "–"


# --- the command -----------------------------------------------------------------------------------------------------


def run_channels(options: Options, output: Output) -> Report:
    """
    Raises:
        ValueError: a scenario is not known, or its record too short.
        OSError: a real record cannot be read.
    """
    names = options.scenarios or [*NAMES, *([SHIP] if scenarios.files(SHIP, options.data) else [])]
    for name in names:
        if name != SHIP and directional(name) is None:
            raise ValueError(f"{name!r} is no sea with directions: write one such as {NAMES[0]}, or {SHIP}")
        if name == SHIP and not scenarios.files(SHIP, options.data):
            raise ValueError(
                f"{SHIP}: there is no record in {options.data or scenarios.DATA}: give its folder by --data"
            )
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    todo = [
        Task(
            scenario=name,
            sensor=sensor,
            observer=options.observer,
            number=number,
            duration_s=options.duration,
            folder=options.data,
        )
        for name in ([] if options.limits_only else names)
        for sensor in options.sensors
        for number in ((1,) if name == SHIP else seeds)
    ]
    found: dict[tuple[str, str], list[dict[str, Part]]] = {}
    for task, parts in zip(todo, in_order(run, todo, options.jobs), strict=True):
        found.setdefault((task.scenario, task.sensor), []).append(parts)
    made = rows(names, options.sensors, found, options.data)
    output.write("channels", made)
    return Report(report(made, options.data), () if options.limits_only else tuple(seeds))


def _words(parser: Parser) -> None:
    parser.add_argument(
        "scenarios", nargs="*", metavar="SCENARIO", help=f"such as {NAMES[0]}, or {SHIP} (default: all that there are)"
    )
    parser.add_argument(
        "--sensors", nargs="+", default=SENSORS, choices=SENSORS, metavar="NAME", help=f"of {', '.join(SENSORS)}"
    )
    parser.add_argument("--limits-only", action="store_true", help="do not run the product")
    parser.add_argument("--data", type=Path, metavar="DIR", help=f"where {scenarios.REAL[SHIP]} is")
    add_seeds(parser, 1)
    parser.add_argument("--first-seed", type=count, default=1, metavar="N", help="of the records (default 1)")
    for add in (add_jobs, add_duration, add_observer, add_common):
        add(parser)


COMMANDS = {"channels": Command(run_channels, _words, "limits of heave with roll and pitch looked at, and ours")}
