"""Heave in figures: Table 2 of Zhang et al. 2022 run again, beside the least error that is possible at all.

A scenario is a wave train or an irregular sea of the simulator, or a real buoy record, through a sensor with its
errors. Every estimator gets the same samples. The first 200 s are not scored. Errors are those against the true heave,
nothing removed; only the row "mean removed" takes its own mean out, after the fact, as no real-time output could.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from math import nan
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import recordings
from numpy.typing import NDArray
from scipy.signal import welch

from evidence import baselines
from evidence.limits import causal_heave_limit
from heaved.samples import GRAVITY_MPS2, ImuSample
from heaved.simulate.seaway import RAMPS, SEAS, TRAINS, heave_spectrum, seaway
from heaved.simulate.sensors import LASER_NOISE_M, REGISTER_STEPS, SENSORS, Recording, imu_model, laser_pattern, record

Array = NDArray[np.float64]

DEFAULT_SCENARIOS: Final = ("T1", "T2", "T3", "S4", "S5", "S6")
SCENARIOS: Final = (*TRAINS, *SEAS)
SCORED_FROM_S: Final = 200.0
LEVEL_INERTIAL: Final = f"{baselines.INERTIAL}, mean removed"
COVER: Final = 1.96
"""Standard deviations that hold 95 % of a Gaussian."""
SENSOR_SEEDS: Final = 1000
"""Added to the seed of the waves: sensor errors are drawn independently of them."""
GRID_POINTS: Final = 2**15
"""Frequencies of the limit: from 8192 on it changes by less than 1 %."""

PAPER_M: Final[dict[str, tuple[float, float, float]]] = {
    baselines.INERTIAL: (0.0692, 0.0843, 0.0469),
    baselines.IIR: (0.0382, 0.0308, 0.0392),
    baselines.KF: (0.0430, 0.0245, 0.0491),
    baselines.UKF: (0.0349, 0.0237, 0.0294),
    baselines.CORRECTED: (0.0072, 0.0055, 0.0136),
}
"""Zhang et al. 2022, Table 2: RMSE of trials 1 to 3."""


class Setting(msgspec.Struct, frozen=True, kw_only=True):
    """How the scenarios are run."""

    sensor: str = "A"
    rate_hz: float = 20.0
    laser: str = "50%"
    duration_s: float = 700.0


class Case(msgspec.Struct, frozen=True, kw_only=True):
    """One record to run the estimators on."""

    scenario: str
    seed: int
    recording: Recording
    period_s: float
    """What the Kalman filter is told."""
    limit_m: float
    """nan: the sea has no continuous spectrum, or not one only."""
    end_s: float
    """Scored until here."""


class Traces(msgspec.Struct, frozen=True, kw_only=True):
    """What the estimators made of a record; arrays (n,), one value per IMU sample."""

    case: Case
    t_s: Array
    truth_m: Array
    heave_m: dict[str, Array]
    """By estimator, in the order of the table."""
    std_m: Array
    """Published with the last of them."""
    laser_on: NDArray[np.bool_]
    scored: NDArray[np.bool_]


class Score(msgspec.Struct, frozen=True, kw_only=True):
    """Errors of one estimator on one record."""

    estimator: str
    rms_m: float
    laser_rms_m: float
    """While the laser is there."""
    outage_rms_m: float
    """While it is not; nan: it always is."""
    coverage: float = nan
    """Share of errors within 1.96 published standard deviations; nan: none is published."""


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """One estimator on one scenario, over its seeds: means, and the worst."""

    scenario: str
    setting: Setting
    scored_from_s: float
    seeds: tuple[int, ...]
    estimator: str
    rms_m: float
    worst_rms_m: float
    sigma_m: float
    """Standard deviation of the true heave while scored."""
    share_of_sigma: float
    limit_m: float
    ratio_to_limit: float
    laser_rms_m: float
    outage_rms_m: float
    coverage: float
    worst_coverage: float
    paper_m: float


# --- records ---------------------------------------------------------------------------------------------------------


def simulated(scenario: str, seed: int, setting: Setting) -> Case:
    """A sea of the simulator, one of :data:`SCENARIOS`.

    Raises:
        ValueError: unknown scenario, sensor or laser pattern, or too short a record to score.
    """
    if scenario not in SCENARIOS:
        raise ValueError(f"unknown scenario {scenario!r}: choose from {', '.join(SCENARIOS)}")
    recording = record(
        seaway(scenario, seed),
        _long_enough(setting.duration_s),
        imu_rate_hz=setting.rate_hz,
        sensor=setting.sensor,
        laser=setting.laser,
        seed=SENSOR_SEEDS + seed,
    )
    limit = nan
    if scenario in SEAS and scenario not in RAMPS:
        limit = limit_m(lambda f: heave_spectrum(scenario, f), setting)
    return Case(
        scenario=scenario,
        seed=seed,
        recording=recording,
        period_s=TRAINS[scenario].period_s if scenario in TRAINS else SEAS[scenario][0].tp_s,
        limit_m=limit,
        end_s=setting.duration_s,
    )


def hebrides(path: Path, seed: int, setting: Setting) -> Case:
    """A real half-hour of a wave-rider buoy, or its start; the Kalman filter is told the record's own peak period.

    Raises:
        ValueError: not such a file, unknown sensor or laser pattern, or too short a record to score.
        OSError: the file cannot be read.
    """
    recording = recordings.hebrides(
        path, rate_hz=setting.rate_hz, sensor=setting.sensor, laser=setting.laser, seed=SENSOR_SEEDS + seed
    )
    t, heave = recording.t_s, recording.truth.heave_m
    end = min(_long_enough(setting.duration_s), float(t[-1]) - recordings.FADE_S)
    inside = (t >= recordings.FADE_S) & (t < end)
    f, density = welch(heave[inside], setting.rate_hz, nperseg=round(100.0 * setting.rate_hz))
    low, high = recordings.BUOY_BAND_HZ
    density = np.where((f >= low) & (f <= high), density, 0.0)
    return Case(
        scenario="Hebrides",
        seed=seed,
        recording=recording,
        period_s=1.0 / float(f[np.argmax(density)]),
        limit_m=limit_m(lambda grid: np.interp(grid, f, density), setting),
        end_s=end,
    )


def _long_enough(duration_s: float) -> float:
    if not duration_s >= SCORED_FROM_S + 20.0:
        raise ValueError(f"a record of {duration_s:g} s cannot be scored from {SCORED_FROM_S:g} s on: give more")
    return duration_s


def limit_m(spectrum: Callable[[Array], Array], setting: Setting) -> float:
    """RMS error (m) of the best causal estimate from this sensor's accelerometer alone, for a one-sided heave spectrum.

    Sensor noise: white, random walk of the bias (2 q^2 / omega^2), rounding to registers; scale and low-pass are
    undone, which raises the noise as they lower the signal. Errors of the attitude are second-order small and left out.
    """
    sensor = imu_model(setting.sensor)
    f = np.linspace(0.0, setting.rate_hz / 2.0, GRID_POINTS + 1)
    omega = 2.0 * np.pi * np.maximum(f, f[1])
    noise = sensor.noise_mps2_rthz**2 + 2.0 * sensor.bias_walk_mps2_rts**2 / omega**2
    if sensor.sixteen_bit:
        noise = noise + REGISTER_STEPS[0] ** 2 / 12.0 / (setting.rate_hz / 2.0)
    through = sensor.scale**2 / (1.0 + (f / sensor.bandwidth_hz) ** 4)
    return causal_heave_limit(f, spectrum(f), noise / through)


# --- runs ------------------------------------------------------------------------------------------------------------


def run(case: Case, setting: Setting) -> Traces:
    """Every estimator of the table over one record, sample by sample."""
    estimators = baselines.table_2(setting.rate_hz, case.period_s)
    series: dict[str, list[float]] = {name: [] for estimator in estimators for name in estimator.columns}
    for sample in case.recording.samples():
        if sample.t_s >= case.end_s:
            break
        for estimator in estimators:
            values = estimator.step(sample)
            for name, value in zip(estimator.columns, values or (), strict=values is not None):
                series[name].append(value)
    arrays = {name: np.array(values) for name, values in series.items()}
    std = arrays.pop("std")
    t = case.recording.t_s[: std.size]
    pattern = laser_pattern(setting.laser)
    return Traces(
        case=case,
        t_s=t,
        truth_m=case.recording.truth.heave_m[: std.size],
        heave_m=arrays,
        std_m=std,
        laser_on=np.array([pattern.on(at) for at in (t - t[0]).tolist()], dtype=bool),
        scored=t >= SCORED_FROM_S,
    )


def scores(traces: Traces) -> list[Score]:
    """One for each row of the table."""
    kept = traces.scored
    result = []
    for name, heave in traces.heave_m.items():
        error = heave - traces.truth_m
        result.append(_score(name, error, traces))
        if name == baselines.INERTIAL:
            result.append(_score(LEVEL_INERTIAL, error - np.mean(error[kept]), traces))
        if name == baselines.CORRECTED:
            covered = np.abs(error[kept]) <= COVER * traces.std_m[kept]
            result[-1] = msgspec.structs.replace(result[-1], coverage=float(np.mean(covered)))
    return result


def _score(name: str, error: Array, traces: Traces) -> Score:
    kept = traces.scored
    return Score(
        estimator=name,
        rms_m=_rms(error[kept]),
        laser_rms_m=_rms(error[kept & traces.laser_on]),
        outage_rms_m=_rms(error[kept & ~traces.laser_on]),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else nan


def summary(setting: Setting, runs: Sequence[tuple[Case, float, list[Score]]]) -> list[Result]:
    """Means and worst over the runs of one scenario: (case, standard deviation of its scored truth, scores)."""
    scenario = runs[0][0].scenario
    trial = list(TRAINS).index(scenario) if scenario in TRAINS else -1
    result = []
    for row in zip(*(found for _, _, found in runs), strict=True):
        name, rms = row[0].estimator, [score.rms_m for score in row]
        ratios = [score.rms_m / case.limit_m for score, (case, _, _) in zip(row, runs, strict=True)]
        shares = [score.rms_m / sigma for score, (_, sigma, _) in zip(row, runs, strict=True)]
        result.append(
            Result(
                scenario=scenario,
                setting=setting,
                scored_from_s=SCORED_FROM_S,
                seeds=tuple(case.seed for case, _, _ in runs),
                estimator=name,
                rms_m=float(np.mean(rms)),
                worst_rms_m=max(rms),
                sigma_m=float(np.mean([sigma for _, sigma, _ in runs])),
                share_of_sigma=float(np.mean(shares)),
                limit_m=float(np.mean([case.limit_m for case, _, _ in runs])),
                ratio_to_limit=float(np.mean(ratios)),
                laser_rms_m=float(np.mean([score.laser_rms_m for score in row])),
                outage_rms_m=float(np.mean([score.outage_rms_m for score in row])),
                coverage=float(np.mean([score.coverage for score in row])),
                worst_coverage=min(score.coverage for score in row),
                paper_m=PAPER_M[name][trial] if trial >= 0 and name in PAPER_M else nan,
            )
        )
    return result


def evaluate(cases: Iterable[Case], setting: Setting, watch: Callable[[Traces], None] = lambda _: None) -> list[Result]:
    """Run and sum up the cases of one scenario; ``watch`` is shown each run."""
    runs = []
    for case in cases:
        traces = run(case, setting)
        watch(traces)
        runs.append((case, float(np.std(traces.truth_m[traces.scored])), scores(traces)))
    return summary(setting, runs)


def equal_tuning(setting: Setting) -> float:
    """Largest difference (m) between KF and UKF on T1 with equal model and tuning."""
    case = simulated("T1", 1, setting)
    inertial = baselines.Inertial()
    samples = (sample for sample in case.recording.samples() if isinstance(sample, ImuSample))
    measured = np.array([inertial.step(sample.t_s, baselines.vertical(sample)) for sample in samples])
    return baselines.ukf_against_kf(measured, setting.rate_hz, case.period_s)


# --- tables ----------------------------------------------------------------------------------------------------------


def report(results: Sequence[Result], kf_ukf_m: float) -> str:
    """All tables as Markdown, with what has to be said below them."""
    setting = results[0].setting
    lines = [
        f"## Heave: sensor {setting.sensor}, {setting.rate_hz:g} Hz, laser {setting.laser}",
        "",
        _conditions(results),
        "",
    ]
    if any(result.scenario in TRAINS for result in results):
        lines += [*_paper_table(results), ""]
    for scenario in dict.fromkeys(result.scenario for result in results):
        lines += [*_scenario_table([result for result in results if result.scenario == scenario]), ""]
    return "\n".join(lines + _notes(kf_ukf_m))


def _conditions(results: Sequence[Result]) -> str:
    setting = results[0].setting
    pattern = laser_pattern(setting.laser)
    blocks = f" ({pattern.on_s:g} s on, {pattern.off_s:g} s off)" if 0.0 < pattern.off_s < np.inf else ""
    number = max(len(result.seeds) for result in results)
    until = f"{setting.duration_s:g} s" if np.isfinite(setting.duration_s) else "the end of the record"
    return (
        f"Scored from {SCORED_FROM_S:g} s to {until}; laser {setting.laser}{blocks}, {LASER_NOISE_M * 1e3:g} mm noise; "
        f"records per scenario: {number}, each with sensor errors of its own: mean of their RMS errors (worst)."
    )


def _paper_table(results: Sequence[Result]) -> list[str]:
    """The layout of the paper's Table 2, our figure beside theirs."""
    trains = [name for name in TRAINS if any(result.scenario == name for result in results)]
    head = " | ".join(f"{name} ours / m | {name} paper / m" for name in trains)
    lines = [f"| RMS error | {head} |", "|---" * (1 + 2 * len(trains)) + "|"]
    by_name: dict[str, dict[str, Result]] = {}
    for result in results:
        by_name.setdefault(result.estimator, {})[result.scenario] = result
    for name, row in by_name.items():
        cells = [f"{_with_worst(row[train])} | {_plain(row[train].paper_m, '.4f')}" for train in trains]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def _scenario_table(results: Sequence[Result]) -> list[str]:
    first = results[0]
    limit = f", causal limit {first.limit_m:.4f} m" if np.isfinite(first.limit_m) else ""
    lines = [
        f"### {first.scenario}: σ {first.sigma_m:.4f} m{limit}",
        "",
        "| estimator | RMS / m (worst) | % of σ | × limit | laser on / m | laser out / m | within ±1.96 std (worst) |",
        "|---|---|---|---|---|---|---|",
    ]
    for r in results:
        cover = f"{100 * r.coverage:.1f} % ({100 * r.worst_coverage:.1f} %)" if np.isfinite(r.coverage) else "–"
        lines.append(
            f"| {r.estimator} | {_with_worst(r)} | {100 * r.share_of_sigma:.1f} | {_plain(r.ratio_to_limit, '.1f')} "
            f"| {_plain(r.laser_rms_m, '.4f')} | {_plain(r.outage_rms_m, '.4f')} | {cover} |"
        )
    return lines


def _notes(kf_ukf_m: float) -> list[str]:
    corner = 2.0 * np.pi / baselines.HIGHPASS_PERIOD_S
    constants = "; ".join(
        f"sensor {name}: bias {sensor.bias_mps2 / corner**2:.2f} m, "
        f"scale {(sensor.scale - 1.0) * GRAVITY_MPS2 / corner**2:.2f} m"
        for name, sensor in SENSORS.items()
        if sensor.bias_mps2
    )
    return [
        f"* {baselines.INERTIAL}: {baselines.HIGHPASS_PERIOD_S:g} s high-pass, as it comes. What the accelerometer's "
        f"bias, and its scale times gravity, leave as a constant dominates it where waves are small ({constants}); "
        "without the mean it is the lead of the high-pass.",
        f"* {baselines.IIR}: double integration with a Butterworth high-pass, order {baselines.IIR_ORDER}, "
        f"{baselines.IIR_CORNER_HZ:g} Hz.",
        f"* {baselines.KF}: the paper's model, Q and R at the scenario's nominal (for a real record: its own peak) "
        "period. UKF rows: the product's defaults (process noise 100 times the paper's), period from the FFT.",
        f"* The model is linear, so KF and UKF with equal model and tuning are one filter: they differ by "
        f"{kf_ukf_m:.1e} m at most on T1. What separates their rows is tuning and frequency.",
        "* Limit: the best causal linear estimate from the accelerometer alone (no laser), for the sea's spectrum.",
        "* The paper measured a platform with a sensor of its own; its figures compare in kind, not in the last digit.",
    ]


def _with_worst(result: Result) -> str:
    return f"{result.rms_m:.4f} ({result.worst_rms_m:.4f})"


def _plain(value: float, spec: str) -> str:
    return format(value, spec) if np.isfinite(value) else "–"
