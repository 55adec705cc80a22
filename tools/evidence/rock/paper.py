"""Rock prediction in figures: the table of Wei et al. 2019 run again on synthetic ships with the least possible error.

Motion is a Gaussian process: a JONSWAP sea (gamma 2) through a second-order response per axis, scaled to a stated
standard deviation, plus white sensor noise. As in the paper's eq. (9) errors are taken against the *measured* angle;
the limit is the optimal linear predictor of the same record, with the same noise added (``limits.prediction_limit``).
"""

from __future__ import annotations

from functools import partial
from math import hypot, pi
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from evidence.commands import in_order
from evidence.limits import prediction_limit
from heaved.estimation.rock.maximum_likelihood import MaximumLikelihoodPredictor
from heaved.estimation.rock.params import STANDARD_HORIZONS_S, STEP_S, Params

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

Array = NDArray[np.float64]
ARCSEC = pi / 180 / 3600
AXES = ("roll", "pitch", "yaw")
FINE_HZ = 200.0
"""Truth is made at this rate, so that every horizon falls on a sample; the predictor sees every n-th."""
SETTLED_S = 40.0
"""Steady figures are taken from here on."""


class Axis(msgspec.Struct, frozen=True):
    """Response of one axis and the deviation of its motion."""

    std_deg: float
    period_s: float
    damping: float


class Scene(msgspec.Struct, frozen=True, kw_only=True):
    name: str
    sea_period_s: float
    axes: tuple[Axis, Axis, Axis]
    noise_arcsec: float
    """White, per sample, the same at every sample rate."""


SCENES = (
    Scene(
        name="under way",
        sea_period_s=8.2,
        axes=(Axis(3.0, 12.0, 0.07), Axis(1.0, 6.5, 0.35), Axis(0.5, 10.0, 0.3)),
        noise_arcsec=2.0,
    ),
    Scene(
        name="moored",
        sea_period_s=6.0,
        axes=(Axis(0.05, 12.0, 0.07), Axis(0.02, 6.5, 0.35), Axis(0.01, 10.0, 0.3)),
        noise_arcsec=0.3,
    ),
    Scene(
        name="on task",
        sea_period_s=8.2,
        axes=(Axis(0.02, 12.0, 0.2), Axis(0.01, 6.5, 0.35), Axis(0.01, 10.0, 0.3)),
        noise_arcsec=0.05,
    ),
    Scene(
        name="under way, MEMS",
        sea_period_s=8.2,
        axes=(Axis(3.0, 12.0, 0.07), Axis(1.0, 6.5, 0.35), Axis(0.5, 10.0, 0.3)),
        noise_arcsec=72.0,
    ),
)

PAPER_ARCSEC = {
    ("under way", "roll"): "210 points 6.11 (max 178.74), 41 points 18.27 (73.53)",
    ("under way", "pitch"): "210 points 3.53 (max 18.41), 41 points 14.04 (16.88)",
    ("moored", "roll"): "210 points 0.85 (max 22.25), 41 points 1.01 (4.66)",
    ("moored", "pitch"): "210 points 0.42 (max 5.91), 41 points 0.46 (1.69)",
    ("on task", "roll"): "210 points 0.062 (max 0.27), 41 points 0.11 (0.45)",
    ("on task", "pitch"): "210 points 0.058 (max 0.28), 41 points 0.11 (0.49)",
}
"""Wei et al. 2019, Table 1: three-step RMS and largest error. Other ships, other seas: the order of things compares."""

METHODS: tuple[tuple[str, Params | None, float], ...] = (
    ("zero/210, theta 0.75", Params(mode="zero", thetas=(0.75,), horizons_s=()), 20.0),
    ("endpoint/67, theta 0.75", Params(thetas=(0.75,), horizons_s=()), 20.0),
    ("endpoint/67, default", Params(horizons_s=()), 20.0),
    ("41-point extrapolation", None, 20.0),
    ("hold", None, 20.0),
    ("endpoint/67, default", Params(horizons_s=()), 50.0),
    ("endpoint/67, default", Params(horizons_s=()), 100.0),
)


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """Errors in arcsec against the measured angle, per standard horizon."""

    scene: str
    axis: str
    method: str
    rate_hz: float
    rms_arcsec: tuple[float, ...]
    worst_arcsec: float
    """Largest error at 150 ms, from the first prediction on."""
    ratio: float
    """RMS at 150 ms over the optimal linear predictor's, both against the measured angle."""
    truth_ratio: float
    """The same against the true angle: noise does not flatter it."""
    first_ratio: float
    """RMS of the first 100 predictions (5 s) at 150 ms over the steady RMS."""


def spectrum(f_hz: Array, sea_period_s: float, axis: Axis) -> Array:
    """One-sided spectrum of the axis in rad^2/Hz on the uniform grid ``f_hz``: JONSWAP times |response|^2."""
    f = np.maximum(f_hz, 1e-6)
    peak = 1.0 / sea_period_s
    width = np.where(f <= peak, 0.07, 0.09)
    sea = f**-5 * np.exp(-1.25 * (peak / f) ** 4) * 2.0 ** np.exp(-0.5 * ((f / peak - 1) / width) ** 2)
    ratio = f * axis.period_s
    shape = sea / ((1 - ratio**2) ** 2 + (2 * axis.damping * ratio) ** 2)
    scale = np.radians(axis.std_deg) ** 2 / (np.sum(shape) * (f_hz[1] - f_hz[0]))
    return np.asarray(shape * scale, dtype=np.float64)


def motion(scene: Scene, rate_hz: float, duration_s: float, rng: np.random.Generator) -> Array:
    """(n, 3) true angles in rad: a Gaussian process made in the frequency domain, half of its period used."""
    count = round(2 * duration_s * rate_hz)
    f = np.linspace(0.0, rate_hz / 2, count // 2 + 1)
    columns = []
    for axis in scene.axes:
        amplitude = np.sqrt(spectrum(f, scene.sea_period_s, axis) * f[1] / 4) * count
        waves = rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f))
        columns.append(np.fft.irfft(waves * amplitude, count)[: count // 2])
    return np.stack(columns, axis=1)


def predictions(t_s: Array, measured: Array, method: str, params: Params | None) -> Array:
    """(n, 3 horizons, 3 axes) predicted angles, unwrapped; nan before the first."""
    if params is None:
        return _baseline(measured, method)
    predictor = MaximumLikelihoodPredictor(params)
    where = [predictor.horizons_s.index(h) for h in STANDARD_HORIZONS_S]
    result = np.empty((len(t_s), len(where), 3))
    for i, (t, sample) in enumerate(zip(t_s.tolist(), measured.tolist(), strict=True)):
        found = predictor.step(t, (sample[0], sample[1], sample[2]))
        result[i] = [(found[k].roll_rad, found[k].pitch_rad, found[k].yaw_rad) for k in where]
    result[..., 2] = (result[..., 2] + pi) % (2 * pi) - pi
    return result


def _baseline(measured: Array, method: str) -> Array:
    """Hold, or the cubic through the last 41 points (2 s at 20 Hz) extrapolated."""
    if method == "hold":
        return np.repeat(measured[:, None, :], len(STANDARD_HORIZONS_S), axis=1)
    powers = np.arange(4)
    fit = np.linalg.pinv((-np.arange(41.0) / 40)[:, None] ** powers)
    result = []
    for horizon in STANDARD_HORIZONS_S:
        taps = np.asarray(((horizon / STEP_S / 40) ** powers) @ fit, dtype=np.float64)
        ahead = np.asarray(lfilter(taps, [1.0], measured, axis=0), dtype=np.float64)
        ahead[:40] = np.nan
        result.append(ahead)
    return np.stack(result, axis=1)


def evaluate(
    scene: Scene,
    method: str,
    params: Params | None,
    rate_hz: float,
    seeds: Sequence[int],
    duration_s: float,
    axes: Sequence[int] = (0, 1, 2),
) -> list[Row]:
    """Run one method on one scene; errors are pooled over the seeds.

    Raises:
        ValueError: rate_hz does not divide 200 Hz.
    """
    if FINE_HZ % rate_hz:
        raise ValueError(f"rate_hz must divide {FINE_HZ:g} Hz, got {rate_hz:g}")
    every = round(FINE_HZ / rate_hz)
    ahead = [round(h * FINE_HZ) for h in STANDARD_HORIZONS_S]
    noise = scene.noise_arcsec * ARCSEC
    steady, true_steady, first, worst = [], [], [], []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        truth = motion(scene, FINE_HZ, duration_s, rng)
        measured = truth + noise * rng.standard_normal(truth.shape)
        made = np.arange(0, len(truth) - ahead[-1], every)
        predicted = predictions(made / FINE_HZ, measured[made], method, params)
        settled = made >= SETTLED_S * FINE_HZ
        errors = [predicted[:, k] - measured[made + n] for k, n in enumerate(ahead)]
        steady.append([np.mean(error[settled] ** 2, axis=0) for error in errors])
        true_steady.append(np.mean((predicted[:, -1] - truth[made + ahead[-1]])[settled] ** 2, axis=0))
        begin = int(np.flatnonzero(np.isfinite(errors[-1][:, 0]))[0])
        first.append(np.mean(errors[-1][begin : begin + round(100 * STEP_S * rate_hz)] ** 2, axis=0))
        worst.append(np.nanmax(np.abs(errors[-1]), axis=0))
    rms = np.sqrt(np.mean(steady, axis=0))
    true_rms = np.sqrt(np.mean(true_steady, axis=0))
    first_rms = np.sqrt(np.mean(first, axis=0))
    f = np.arange(0.0, 4.0, 1 / 400)
    result = []
    for i in axes:
        density = spectrum(f, scene.sea_period_s, scene.axes[i])
        limit = float(prediction_limit(f, density, noise, rate_hz, np.array(STANDARD_HORIZONS_S[-1:]), 20.0)[0])
        result.append(
            Row(
                scene=scene.name,
                axis=AXES[i],
                method=method,
                rate_hz=rate_hz,
                rms_arcsec=tuple((rms[:, i] / ARCSEC).tolist()),
                worst_arcsec=float(np.max(worst, axis=0)[i] / ARCSEC),
                ratio=float(rms[-1, i]) / hypot(limit, noise),
                truth_ratio=float(true_rms[i]) / limit,
                first_ratio=float(first_rms[i] / rms[-1, i]),
            )
        )
    return result


def table(seeds: Sequence[int], duration_s: float, jobs: int = 1) -> list[Row]:
    """Every scene by every method, roll and pitch."""
    todo = [(scene, *method) for scene in SCENES for method in METHODS]
    rows = in_order(partial(_evaluate, seeds=seeds, duration_s=duration_s), todo, jobs)
    return [row for of_scene in rows for row in of_scene]


def _evaluate(case: tuple[Scene, str, Params | None, float], seeds: Sequence[int], duration_s: float) -> list[Row]:
    return evaluate(*case, seeds, duration_s, axes=(0, 1))


def report(rows: Sequence[Row]) -> str:
    """The table as Markdown, the paper's figures under each scene."""
    lines = []
    for scene in SCENES:
        settings = ", ".join(
            f"{name} σ {a.std_deg:g}° {a.period_s:g} s ζ {a.damping:g}"
            for name, a in zip(AXES[:2], scene.axes[:2], strict=True)
        )
        lines += [
            f"### {scene.name}: {settings}; sea {scene.sea_period_s:g} s; noise {scene.noise_arcsec:g}″",
            "",
            "| axis | method | Hz | 50 ms ″ | 100 ms ″ | 150 ms ″ | max ″ | × limit | × limit (truth) | first 100 |",
            "|---|---|---|---|---|---|---|---|---|---|",
        ]
        for row in sorted((r for r in rows if r.scene == scene.name), key=lambda r: AXES.index(r.axis)):
            errors = " | ".join(f"{e:.3g}" for e in row.rms_arcsec)
            lines.append(
                f"| {row.axis} | {row.method} | {row.rate_hz:g} | {errors} | {row.worst_arcsec:.3g} | {row.ratio:.2f} "
                f"| {row.truth_ratio:.2f} | {row.first_ratio:.2f} |"
            )
        paper = [f"{axis}: {text}" for (name, axis), text in PAPER_ARCSEC.items() if name == scene.name]
        lines += ["", *(["Paper, Table 1, 150 ms: " + "; ".join(paper) + ".", ""] if paper else [])]
    return "\n".join(lines)


def figure(path: Path, seed: int = 1, duration_s: float = 60.0) -> None:
    """Roll under way: truth and prediction above, error with its published deviation below, as a PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    scene, rate_hz = SCENES[-1], 100.0
    rng = np.random.default_rng(seed)
    truth = motion(scene, rate_hz, duration_s, rng)
    measured = truth + scene.noise_arcsec * ARCSEC * rng.standard_normal(truth.shape)
    t_s = np.arange(len(truth)) / rate_hz
    predictor = MaximumLikelihoodPredictor()
    found = [
        predictor.step(t, (sample[0], sample[1], sample[2]))[-1]
        for t, sample in zip(t_s.tolist(), measured.tolist(), strict=True)
    ]
    due_s = t_s + found[0].horizon_s
    predicted = np.degrees([p.roll_rad for p in found])
    std = np.array([p.roll_std_rad for p in found]) / ARCSEC
    error = predicted * 3600 - np.interp(due_s, t_s, measured[:, 0], right=np.nan) / ARCSEC

    fig, (above, below) = pyplot.subplots(2, 1, sharex=True, figsize=(10, 6), layout="constrained")
    above.plot(t_s, np.degrees(truth[:, 0]), label="true roll", color="0.2", linewidth=2.5)
    above.plot(due_s, predicted, label="predicted 150 ms before", color="tab:orange", linewidth=1.2)
    above.set_ylabel("roll / °")
    above.legend(loc="upper right")
    above.set_title(f"Rock prediction, {scene.name}: {rate_hz:g} Hz, sensor noise {scene.noise_arcsec:g}″")
    below.plot(due_s, error, color="tab:blue", linewidth=0.6, label="prediction − measured")
    below.fill_between(due_s, -2 * std, 2 * std, color="tab:blue", alpha=0.2, label="± 2 published σ")
    below.set_ylabel("error / ″")
    below.set_xlabel("t / s")
    below.legend(loc="upper right")
    fig.savefig(path, dpi=110)
    pyplot.close(fig)
