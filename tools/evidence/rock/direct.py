"""The direct rock predictor in figures, beside the paper's method, simple extrapolations and the optimal predictor.

Errors are against the measured angle, sensor noise included, as in the paper's eq. (9). The bound is the optimal linear
predictor for the known spectrum (``limits.prediction_limit``) with the same noise added.
"""

from __future__ import annotations

from functools import partial
from math import nan
from typing import TYPE_CHECKING, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from evidence.commands import in_order
from evidence.limits import prediction_limit
from evidence.rock.seas import F_HZ, RATE_HZ, SHIPS, Sea, Ship, gaussian, known_spectrum, motion, palmer, spectrum
from heaved.estimation.rock import params as rock
from heaved.estimation.rock.direct import DirectPredictor, Params
from heaved.estimation.rock.fading import finite_taps
from heaved.estimation.rock.maximum_likelihood import MaximumLikelihoodPredictor

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

Array = NDArray[np.float64]
Found = TypeVar("Found")

HORIZONS_S = Params().horizons_s
SCORED_FROM_S = 120.0
RATED = ("under way, roll", "under way, roll, MEMS", "confused sea, roll")
GYRO_NOISES_RADPS = (1.6e-5, 1.6e-4, 6e-4)
"""Per sample; 1.6e-4 is that of 5e-5 rad/s/sqrt(Hz) at 20 Hz."""
PAPER = {
    "paper, zero/210": rock.Params(mode="zero", thetas=(0.75,), horizons_s=HORIZONS_S),
    "paper, endpoint/67": rock.Params(horizons_s=HORIZONS_S),
}


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One method on one scene: RMS over the bound per horizon; share of errors in its 95 % interval, if it has one."""

    scene: str
    method: str
    ratio: tuple[float, ...]
    coverage: tuple[float, ...] = ()


class Disturbance(msgspec.Struct, frozen=True, kw_only=True):
    """What a disturbance costs: RMS at each standard horizon over that of the same record without it."""

    scene: str
    disturbance: str
    ratio: tuple[float, ...]


def direct(t_s: Array, x: Array, params: Params | None = None, rates: Array | None = None) -> tuple[Array, Array]:
    """Predictions and half-widths (n, H, channels) of measured columns x (n, channels), with their rates if given."""
    predictor = DirectPredictor(x.shape[1], params, rates=rates is not None)
    given = [None] * len(x) if rates is None else rates.tolist()
    out, half = [], []
    for t, row, rate in zip(t_s.tolist(), x.tolist(), given, strict=True):
        out.append(predictor.step(t, row, rate))
        half.append(predictor.half_width)
    return np.array(out), np.array(half)


def paper(t_s: Array, x: Array, params: rock.Params) -> Array:
    """Predictions (n, H) of one column x (n,)."""
    predictor = MaximumLikelihoodPredictor(params)
    keep = [predictor.horizons_s.index(h) for h in HORIZONS_S]
    found = []
    for t, value in zip(t_s.tolist(), x.tolist(), strict=True):
        records = predictor.step(t, (value, nan, nan))
        found.append([records[k].roll_rad for k in keep])
    return np.array(found)


def simple(x: Array, method: str) -> Array:
    """Predictions (n, H) by hold, by the slope of the fading memory, or by the cubic through the last 41 points."""
    horizons = np.array(HORIZONS_S)
    if method == "hold":
        return np.repeat(x[:, None], len(horizons), axis=1)
    if method == "rate":
        taps = finite_taps(1 / RATE_HZ, np.array([0.0, 1e-3]))
        slope = np.convolve(x, (taps[1] - taps[0])[::-1] / 1e-3)[: len(x)]
        return np.asarray(x[:, None] + horizons * slope[:, None])
    powers = np.arange(4)
    fit = np.linalg.pinv((-np.arange(41.0) / 40)[:, None] ** powers)
    taps = (horizons[:, None] * RATE_HZ / 40) ** powers @ fit
    return np.stack([np.convolve(x, row)[: len(x)] for row in taps], axis=1)


def errors(predicted: Array, measured: Array, from_s: float = SCORED_FROM_S) -> list[Array]:
    """Errors per horizon of predictions (n, H) made from ``from_s`` on until the record ends."""
    steps = [round(h * RATE_HZ) for h in HORIZONS_S]
    made = np.arange(round(from_s * RATE_HZ), len(measured) - steps[-1])
    return [predicted[made, k] - measured[made + n] for k, n in enumerate(steps)]


def rms(per_horizon: Sequence[Array]) -> Array:
    return np.array([np.sqrt(np.nanmean(e**2)) for e in per_horizon])


def scene(ship: Ship, seeds: Sequence[int], duration_s: float) -> list[Row]:
    """Every method on one ship; errors are pooled over the seeds."""
    density = known_spectrum(ship)
    bound = np.hypot(prediction_limit(F_HZ, density, ship.noise, RATE_HZ, np.array(HORIZONS_S)), ship.noise)
    squares: dict[str, list[Array]] = {}
    inside = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        truth = motion(ship, duration_s, rng)
        x = truth + ship.noise * rng.standard_normal(len(truth))
        t = np.arange(len(x)) / RATE_HZ
        out, half = direct(t, x[:, None])
        predicted = {"direct": out[..., 0]}
        predicted |= {name: paper(t, x, params) for name, params in PAPER.items()}
        predicted |= {name: simple(x, name) for name in ("41 points", "rate", "hold")}
        for name, values in predicted.items():
            found = errors(values, x)
            squares.setdefault(name, []).append(rms(found) ** 2)
            if name == "direct":
                made = slice(round(SCORED_FROM_S * RATE_HZ), round(SCORED_FROM_S * RATE_HZ) + len(found[0]))
                inside.append([np.mean(np.abs(e) <= half[made, k, 0]) for k, e in enumerate(found)])
    return [
        Row(
            scene=ship.name,
            method=name,
            ratio=tuple((np.sqrt(np.mean(found, axis=0)) / bound).tolist()),
            coverage=tuple(np.mean(inside, axis=0).tolist()) if name == "direct" else (),
        )
        for name, found in squares.items()
    ]


def disturbances(ship: Ship, seeds: Sequence[int], duration_s: float) -> list[Disturbance]:
    """What missing samples, spikes, the start and a change of the sea cost."""
    totals: dict[str, list[Array]] = {}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        truth = motion(ship, duration_s, rng)
        x = truth + ship.noise * rng.standard_normal(len(truth))
        t = np.arange(len(x)) / RATE_HZ
        plain = direct(t, x[:, None])[0][..., 0]
        steady = rms(errors(plain, x))
        missing, spiked = x.copy(), x.copy()
        missing[rng.random(len(x)) < 0.1] = nan
        hit = np.flatnonzero((rng.random(len(x)) < 0.005) & (t > 70.0))
        spiked[hit] += ship.std * rng.uniform(2.0, 10.0, len(hit)) * rng.choice([-1.0, 1.0], len(hit))
        for name, disturbed in (("10 % missing", missing), ("0.5 % spikes of 2 to 10 σ", spiked)):
            out = direct(t, disturbed[:, None])[0][..., 0]
            totals.setdefault(name, []).append(rms(errors(out, x)) / steady)
        for name, begin, end in (("5th to 15th second", 5.0, 15.0), ("15th to 60th second", 15.0, 60.0)):
            found = [e[: round((end - begin) * RATE_HZ)] for e in errors(plain, x, begin)]
            totals.setdefault(name, []).append(rms(found) / steady)
        totals.setdefault("sea change, first minute after", []).append(_sea_change(ship, rng, duration_s))
    return [
        Disturbance(scene=ship.name, disturbance=name, ratio=tuple(np.sqrt(np.mean(np.square(v), axis=0)).tolist()))
        for name, v in totals.items()
    ]


def _sea_change(ship: Ship, rng: np.random.Generator, duration_s: float) -> Array:
    """RMS in the minute after the sea has grown threefold and 3 s longer within a minute, over that of a predictor
    that has known nothing but the new sea.
    """
    new = msgspec.structs.replace(ship, seas=tuple(_longer(sea) for sea in ship.seas), std=3 * ship.std)
    t = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    u = np.clip((t - 0.5 * duration_s) / 60.0, 0.0, 1.0)
    turn = np.pi / 2 * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    first, second = (gaussian(F_HZ, spectrum(s, F_HZ), duration_s, rng) for s in (ship, new))
    noise = ship.noise * rng.standard_normal(len(t))
    changing = np.cos(turn) * first + np.sin(turn) * second + noise
    begin = 0.5 * duration_s + 60.0
    after = round(60.0 * RATE_HZ)
    found = [
        rms([e[:after] for e in errors(direct(t, x[:, None])[0][..., 0], x, begin)]) for x in (changing, second + noise)
    ]
    return found[0] / found[1]


def _longer(sea: Sea) -> Sea:
    return msgspec.structs.replace(sea, period_s=sea.period_s + 3.0)


def real(path: Path) -> list[Row]:
    """A real ship at 1 Hz; no bound is known, so the RMS is over that of hold. Scored from 200 s on."""
    t, angles = palmer(path)
    horizons = (1.0, 2.0, 5.0)
    out, half = direct(t, angles, Params(horizons_s=horizons))
    made = np.arange(200, len(t) - 5)
    rows = []
    for c, axis in enumerate(("roll", "pitch")):
        ratio, coverage = [], []
        for k, h in enumerate((1, 2, 5)):
            error = out[made, k, c] - angles[made + h, c]
            ratio.append(float(np.sqrt(np.mean(error**2) / np.mean((angles[made, c] - angles[made + h, c]) ** 2))))
            coverage.append(float(np.mean(np.abs(error) <= half[made, k, c])))
        rows.append(
            Row(scene=f"real ship, {axis}, 1 Hz", method="direct", ratio=tuple(ratio), coverage=tuple(coverage))
        )
    return rows


def _of_ships(
    work: Callable[..., list[Found]],
    ships: Sequence[Ship],
    seeds: Sequence[int],
    duration_s: float,
    jobs: int,
) -> list[Found]:
    rows = in_order(partial(work, seeds=seeds, duration_s=duration_s), ships, jobs)
    return [row for of_ship in rows for row in of_ship]


def table(seeds: Sequence[int], duration_s: float, jobs: int) -> list[Row]:
    return _of_ships(scene, SHIPS, seeds, duration_s, jobs)


def costs(seeds: Sequence[int], duration_s: float, jobs: int) -> list[Disturbance]:
    return _of_ships(disturbances, [ship for ship in SHIPS if ship.cubic == 0.0], seeds, duration_s, jobs)


def rates(ship: Ship, seeds: Sequence[int], duration_s: float) -> list[Disturbance]:
    """What a gyroscope's rates save, per its noise: RMS against the *true* angle over that without them."""
    found: dict[str, list[Array]] = {}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        truth = motion(ship, duration_s, rng)
        x = truth + ship.noise * rng.standard_normal(len(truth))
        t = np.arange(len(x)) / RATE_HZ
        rate = np.convolve(truth, np.array([-1.0, 8.0, 0.0, -8.0, 1.0]) / 12 * RATE_HZ, mode="same")
        plain = rms(errors(direct(t, x[:, None])[0][..., 0], truth))
        for noise in GYRO_NOISES_RADPS:
            given = (rate + noise * rng.standard_normal(len(rate)))[:, None]
            out = direct(t, x[:, None], rates=given)[0][..., 0]
            name = f"gyro noise {np.degrees(noise):.3f} °/s"
            found.setdefault(name, []).append(rms(errors(out, truth)) / plain)
    return [
        Disturbance(scene=ship.name, disturbance=name, ratio=tuple(np.sqrt(np.mean(np.square(v), axis=0)).tolist()))
        for name, v in found.items()
    ]


def rates_table(seeds: Sequence[int], duration_s: float, jobs: int) -> list[Disturbance]:
    return _of_ships(rates, [ship for ship in SHIPS if ship.name in RATED], seeds, duration_s, jobs)


def figure(path: Path, rows: Sequence[Row], seed: int = 1, duration_s: float = 240.0) -> None:
    """RMS over the bound by horizon; and 40 s of roll with what was predicted 2 s before and its interval."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    ship = SHIPS[0]
    rng = np.random.default_rng(seed)
    truth = motion(ship, duration_s, rng)
    x = truth + ship.noise * rng.standard_normal(len(truth))
    t = np.arange(len(x)) / RATE_HZ
    out, half = direct(t, x[:, None])
    k = HORIZONS_S.index(2.0)
    made = np.arange(round((duration_s - 50) * RATE_HZ), round((duration_s - 10) * RATE_HZ))
    fig, (above, below) = pyplot.subplots(2, 1, figsize=(8, 8), layout="constrained")
    for method in dict.fromkeys(row.method for row in rows):
        ratios = np.array([row.ratio for row in rows if row.method == method and len(row.ratio) == len(HORIZONS_S)])
        above.loglog(HORIZONS_S, np.median(ratios, axis=0), marker="o", label=method)
    above.set_xlabel("horizon / s")
    above.set_ylabel("RMS error / bound, median of the scenes")
    above.grid(which="both", linewidth=0.3)
    above.legend(loc="upper left", ncols=2, fontsize=8)
    above.set_ylim(top=300.0)
    due_s = t[made] + HORIZONS_S[k]
    predicted, width = np.degrees(out[made, k, 0]), np.degrees(half[made, k, 0])
    below.plot(due_s, np.degrees(x[made + round(HORIZONS_S[k] * RATE_HZ)]), color="0.3", linewidth=2.5, label="roll")
    below.plot(due_s, predicted, color="tab:orange", linewidth=1.2, label="predicted 2 s before")
    below.fill_between(due_s, predicted - width, predicted + width, color="tab:orange", alpha=0.25, label="95 %")
    below.set_xlabel("t / s")
    below.set_ylabel("roll / °")
    below.legend(loc="upper center", ncols=3)
    below.set_ylim(top=1.4 * below.get_ylim()[1])
    below.set_title(ship.name)
    fig.savefig(path, dpi=110)
    pyplot.close(fig)


def report(
    rows: Sequence[Row], disturbed: Sequence[Disturbance], rated: Sequence[Disturbance], real_rows: Sequence[Row]
) -> str:
    """The tables as Markdown."""
    head = " | ".join(f"{h:g} s" for h in HORIZONS_S)
    lines = [f"RMS over the bound, 20 Hz, from {SCORED_FROM_S:g} s on", "", f"| scene | method | {head} |"]
    lines.append("|" + "---|" * (2 + len(HORIZONS_S)))
    for row in rows:
        lines.append(f"| {row.scene} | {row.method} | " + " | ".join(f"{r:.2f}" for r in row.ratio) + " |")
        if row.coverage:
            lines.append(f"| {row.scene} | coverage | " + " | ".join(f"{c:.3f}" for c in row.coverage) + " |")
    lines += ["", "RMS over that without the disturbance", "", f"| scene | disturbance | {head} |"]
    lines.append("|" + "---|" * (2 + len(HORIZONS_S)))
    lines += [f"| {d.scene} | {d.disturbance} | " + " | ".join(f"{r:.2f}" for r in d.ratio) + " |" for d in disturbed]
    lines += ["", "RMS against the truth with rates over that without", "", f"| scene | rates | {head} |"]
    lines.append("|" + "---|" * (2 + len(HORIZONS_S)))
    lines += [f"| {d.scene} | {d.disturbance} | " + " | ".join(f"{r:.2f}" for r in d.ratio) + " |" for d in rated]
    if real_rows:
        lines += ["", "RMS over that of hold, real ship", "", "| scene | 1 s | 2 s | 5 s | coverage |"]
        lines.append("|---|---|---|---|---|")
        for row in real_rows:
            cells = [f"{r:.2f}" for r in row.ratio] + [" ".join(f"{c:.3f}" for c in row.coverage)]
            lines.append(f"| {row.scene} | " + " | ".join(cells) + " |")
    return "\n".join(lines)
