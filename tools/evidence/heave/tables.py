"""Tables of heave as Markdown: Table 2 of Zhang et al. 2022 with the trains, the limit beside each error."""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING, Final

import numpy as np

from evidence.heave import baselines
from evidence.heave.estimators import CORRECTED, DOUBLE, IIR, INERTIAL, KF, UKF
from evidence.heave.scores import SETTLED_SHARE
from evidence.scenarios import HORIZONS_S, grid, sea_limits, simulated_spectrum
from heaved.samples import GRAVITY_MPS2
from heaved.simulate.seaway import RAMPS, SEAS, TRAINS
from heaved.simulate.sensors import LASER_NOISE_M, SENSORS, laser_pattern
from heaved.simulate.shaking import NONE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from evidence.heave.summary import Result

PAPER_M: Final[dict[str, tuple[float, float, float]]] = {
    INERTIAL: (0.0692, 0.0843, 0.0469),
    IIR: (0.0382, 0.0308, 0.0392),
    KF: (0.0430, 0.0245, 0.0491),
    UKF: (0.0349, 0.0237, 0.0294),
    CORRECTED: (0.0072, 0.0055, 0.0136),
}
"""Zhang et al. 2022, Table 2: RMSE of trials 1 to 3."""


def report(results: Sequence[Result], kf_ukf_m: float) -> str:
    """All tables as Markdown, with what has to be said below them."""
    lines: list[str] = []
    for setting in dict.fromkeys(result.setting for result in results):
        here = [result for result in results if result.setting == setting]
        lines += [f"## Heave: {_conditions(here)}", ""]
        if any(result.scenario in TRAINS for result in here):
            lines += [*_paper_table(here), ""]
        for scenario in dict.fromkeys(result.scenario for result in here):
            lines += [*_scenario_table([result for result in here if result.scenario == scenario]), ""]
    return "\n".join(lines + _notes(kf_ukf_m))


def limits_table(sensors: tuple[str, ...], rate_hz: float, shake: str = NONE) -> str:
    """Markdown: the least errors on every steady irregular sea, for each sensor, shaken by what that name says.

    Raises:
        ValueError: there is no such shake.
    """
    heads = " | ".join(f"{horizon:g} s ahead" for horizon in HORIZONS_S)
    lines = [
        f"Least RMS error from the accelerometer alone, {shake or 'not shaken'}, {rate_hz:g} Hz, in mm (% of σ):",
        "",
        f"| sea | sensor | σ / m | causal | {heads} | delayed |",
        "|---" * (5 + len(HORIZONS_S)) + "|",
    ]
    f = grid(rate_hz)
    for scenario in (name for name in SEAS if name not in RAMPS):
        sigma_m = sqrt(np.trapezoid(simulated_spectrum(scenario, f), f))
        for sensor in sensors:
            limits = sea_limits(scenario, sensor, rate_hz, shake)
            errors = (limits.causal_m, *limits.forecast_m.values(), limits.noncausal_m)
            cells = " | ".join(f"{1e3 * error:.1f} ({100.0 * error / sigma_m:.2f})" for error in errors)
            lines.append(f"| {scenario} | {sensor} | {sigma_m:.4f} | {cells} |")
    return "\n".join(lines)


def _conditions(results: Sequence[Result]) -> str:
    setting = results[0].setting
    pattern = laser_pattern(setting.laser)
    blocks = f" ({pattern.on_s:g} s on, {pattern.off_s:g} s off)" if 0.0 < pattern.off_s < np.inf else ""
    laser = f"{setting.laser}{blocks}" + (f", {LASER_NOISE_M * 1e3:g} mm noise" if setting.laser != "off" else "")
    number = max(len(result.seeds) for result in results)
    return (
        f"sensor {setting.sensor}, tilt {setting.tilt}, {setting.rate_hz:g} Hz, laser {laser}; scored from "
        f"{setting.scored_from_s:g} s after a cold start; up to {number} records per scenario, mean of their RMS errors"
    )


def _paper_table(results: Sequence[Result]) -> list[str]:
    """The layout of the paper's Table 2, our figure beside theirs."""
    trains = [name for name in TRAINS if any(result.scenario == name for result in results)]
    head = " | ".join(f"{name} ours / m | {name} paper / m" for name in trains)
    lines = [f"| RMS error | {head} |", "|---" * (1 + 2 * len(trains)) + "|"]
    by_name: dict[str, dict[str, Result]] = {}
    for result in results:
        if result.scenario in TRAINS:
            by_name.setdefault(result.estimator, {})[result.scenario] = result
    for name, row in by_name.items():
        paper = PAPER_M.get(name, (np.nan,) * len(TRAINS))
        cells = [f"{row[train].rms_m:.4f} | {_plain(paper[list(TRAINS).index(train)], '.4f')}" for train in trains]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def _scenario_table(results: Sequence[Result]) -> list[str]:
    first = results[0]
    limit = f", causal limit {1e3 * first.limit_m:.1f} mm" if np.isfinite(first.limit_m) else ""
    lines = [
        f"### {first.scenario}: σ {first.sigma_m:.4f} m{limit}",
        "",
        "| estimator | RMS / mm (worst) | % of σ | % of Hs | × limit (worst) | laser on / out, mm | gain "
        "| in ±1.96 std (worst) | the same in valid | valid | settled |",
        "|---" * 11 + "|",
    ]
    for r in results:
        laser = f"{_mm(r.laser_rms_m)} / {_mm(r.outage_rms_m)}" if np.isfinite(r.laser_rms_m) else "–"
        ratio = f"{r.ratio_to_limit:.2f} ({r.worst_ratio_to_limit:.2f})" if np.isfinite(r.ratio_to_limit) else "–"
        cover = f"{_percent(r.coverage)} ({_percent(r.worst_coverage)})" if np.isfinite(r.coverage) else "–"
        valid = _percent(r.states.get("valid", 0.0)) if r.states else "–"
        silent = f" ({_percent(r.published)} % of the time)" if r.published < 1.0 else ""
        lines.append(
            f"| {r.estimator}{silent} | {_mm(r.rms_m)} ({_mm(r.worst_rms_m)}) | {_percent(r.share_of_sigma, 2)} "
            f"| {_percent(r.share_of_hs, 2)} | {ratio} | {laser} | {_plain(r.gain, '.3f')} | {cover} "
            f"| {_percent(r.valid_coverage)} | {valid} | {_plain(r.settled_s, '.0f')} |"
        )
    return lines + _ahead_table(results) + _segment_table(results)


def _ahead_table(results: Sequence[Result]) -> list[str]:
    """Forecasts and delayed heave: error, over the limit of its own, share within 1.96 std."""
    there = [result for result in results if result.forecast]
    if not there:
        return []
    heads = [f"{horizon} s ahead" for horizon in there[0].forecast] + ["delayed"]
    lines = ["", f"| % of σ (× limit; in ±1.96 std) | {' | '.join(heads)} |", "|---" * (1 + len(heads)) + "|"]
    for r in there:
        cells = [
            f"{_percent(later.share_of_sigma, 2)} ({_plain(later.ratio_to_limit, '.2f')}; {_percent(later.coverage)})"
            if later is not None
            else "–"
            for later in (*r.forecast.values(), r.delayed)
        ]
        lines.append(f"| {r.estimator} | {' | '.join(cells)} |")
    return lines


def _segment_table(results: Sequence[Result]) -> list[str]:
    names = list(results[0].segments)
    if not names:
        return []
    lines = ["", f"| % of the local σ | {' | '.join(names)} |", "|---" * (1 + len(names)) + "|"]
    return lines + [f"| {r.estimator} | {' | '.join(_percent(r.segments[n]) for n in names)} |" for r in results]


def _notes(kf_ukf_m: float) -> list[str]:
    corner = 2.0 * np.pi / baselines.HIGHPASS_PERIOD_S
    constants = "; ".join(
        f"sensor {name}: bias {sensor.bias_mps2 / corner**2:.2f} m, "
        f"scale {(sensor.scale - 1.0) * GRAVITY_MPS2 / corner**2:.2f} m"
        for name, sensor in SENSORS.items()
        if sensor.bias_mps2
    )
    return [
        f"* {INERTIAL}: {baselines.HIGHPASS_PERIOD_S:g} s high-pass, as it comes. What the accelerometer's "
        f"bias, and its scale times gravity, leave as a constant dominates it where waves are small ({constants}); "
        "without the mean it is the lead of the high-pass.",
        f"* {IIR}: double integration with a Butterworth high-pass, order {baselines.IIR_ORDER}, "
        f"{baselines.IIR_CORNER_HZ:g} Hz. {DOUBLE}: with two of the second order, {baselines.DOUBLE_CORNER_HZ:g} Hz.",
        f"* {KF}: the paper's model, Q and R at the scenario's nominal (for a real record: its own peak) "
        "period. UKF rows: process noise 100 times the paper's, period from the FFT.",
        f"* The model is linear, so KF and UKF with equal model and tuning are one filter: they differ by "
        f"{kf_ukf_m:.1e} m at most on T1. What separates their rows is tuning and frequency.",
        "* Limits: the best linear estimate from the accelerometer alone (no laser), for the sea's spectrum: causal, "
        "as long ahead, or from past and future. The attitude's errors are not in them.",
        f"* Settled: from this second on, the RMS error in bins of 5 s stays within {100 * SETTLED_SHARE:g} % of σ; "
        "inf: never within 300 s.",
        "* Real records: Hebrides and palmer are real motions through a simulated sensor, flume and static real "
        "accelerometers; the truth of a flume run is its own zero-phase double integral.",
        "* The paper measured a platform with a sensor of its own; its figures compare in kind, not in the last digit.",
    ]


def _mm(value_m: float) -> str:
    return f"{1e3 * value_m:.1f}"


def _percent(value: float, digits: int = 1) -> str:
    return f"{100.0 * value:.{digits}f}" if np.isfinite(value) else "–"


def _plain(value: float, spec: str) -> str:
    return "–" if np.isnan(value) else format(value, spec)
