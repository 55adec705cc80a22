"""Roll and pitch ahead on a hull that shakes: what a shaken gyroscope still adds to the angles, and whether it is said.

A record of a sea is shaken as a row of :data:`SHAKES` says, the gyroscopes and, where the hull turns to and fro, the
angles by what these rates add up to. It goes through the daemon's rock predictor with its body rates and without.
Errors are against the roll and pitch of the *waves*; standard deviations and intervals are of readings, so coverage is
of these. Asked: with body rates never more than 2 % worse than without, 90-99 % of the readings within 1.96 standard
deviations, and no error against the waves beyond 4.
"""

from __future__ import annotations

from functools import partial
from itertools import product
from math import nan
from operator import attrgetter
from typing import TYPE_CHECKING, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from evidence.commands import in_order
from heaved.estimation.imu.attitude import Attitude
from heaved.estimation.imu.conditioning import NOTHING, Conditioned
from heaved.estimation.rock import params as rock
from heaved.estimation.rock.estimator import RockEstimator
from heaved.samples import Fault, ImuSample
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import Recording, record

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]

HORIZONS_S: Final = (0.05, 0.1, 0.15, 0.5, 1.0, 2.0)
SEA: Final = "S6"
RATES_HZ: Final = (20.0, 100.0)
SCORED_FROM_S: Final = 150.0
LIE: Final = 4.0
WANDERS_S: Final = 20.0
"""Time constant of an engine's speed."""
BAND_HZ: Final = (1.0, 10.0)
ANGLES, GYROS = ("roll_rad", "pitch_rad", "yaw_rad"), ("gx_radps", "gy_radps", "gz_radps")
_OF_PREDICTION: Final = attrgetter("roll_rad", "pitch_rad", "roll_std_rad", "pitch_std_rad")
SIGNS: Final = (1.0, -1.0, -1.0)
"""Of the rates of the angles, as the gyroscopes read them on a level ship."""


class Shake(msgspec.Struct, frozen=True, kw_only=True):
    """What shakes the gyroscopes; of each of several the same kind, drawn for itself."""

    line_hz: float = 0.0
    """0: there is none."""
    line_radps: float = 0.0
    wanders: float = 0.0
    """Standard deviation of its frequency, of itself."""
    band_radps: float = 0.0
    """RMS of a broad band, between BAND_HZ; what a poll folds down is in it."""
    spikes: float = 0.0
    """Share of the readings."""
    spike_radps: float = 0.0
    """Largest of them, the least a fifth of it."""
    turns: bool = False
    """The hull itself turns to and fro, and the angles with it."""


SHAKES: Final = {
    "still": Shake(),
    "line 3.1 Hz, 2 mrad/s": Shake(line_hz=3.1, line_radps=2e-3),
    "line 3.1 Hz, 4 mrad/s, angles too": Shake(line_hz=3.1, line_radps=4e-3, turns=True),
    "line 1.3 Hz, 4 mrad/s, angles too": Shake(line_hz=1.3, line_radps=4e-3, turns=True),
    "line 25.1 Hz, 20 mrad/s, angles too": Shake(line_hz=25.1, line_radps=20e-3, turns=True),
    "line 3.1 Hz, 4 mrad/s, wandering 5 %": Shake(line_hz=3.1, line_radps=4e-3, wanders=0.05, turns=True),
    "line 3.1 Hz, 40 mrad/s, angles too": Shake(line_hz=3.1, line_radps=40e-3, turns=True),
    "1-10 Hz, 4 mrad/s, angles too": Shake(band_radps=4e-3, turns=True),
    "0.5 % spikes of the gyroscopes": Shake(spikes=0.005, spike_radps=0.5),
    "0.5 % small spikes": Shake(spikes=0.005, spike_radps=0.02),
}


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """The worse of roll and pitch for each of HORIZONS_S."""

    shake: str
    rate_hz: float
    over_without: tuple[float, ...]
    """RMS with body rates over that without."""
    over_still: tuple[float, ...]
    """RMS with body rates over that of the still record."""
    least_coverage: tuple[float, ...]
    most_coverage: tuple[float, ...]
    lies: int
    """Predictions that are off by more than LIE standard deviations, with body rates or without, of..."""
    predictions: int


def shaken(recording: Recording, shake: Shake, seed: int) -> Recording:
    """The same readings, shaken; the truth beside them stays that of the waves."""
    rng = np.random.default_rng([seed, 31])
    t = recording.t_s
    interval_s = float(t[1] - t[0])
    new = {}
    for angle, gyro, sign in zip(ANGLES, GYROS, SIGNS, strict=True):
        rate, turned = np.zeros(t.size), np.zeros(t.size)
        if shake.line_hz:
            share = float(np.exp(-interval_s / WANDERS_S))
            driven = np.sqrt(1.0 - share**2) * rng.standard_normal(t.size)
            speed = 1.0 + shake.wanders * np.asarray(lfilter([1.0], [1.0, -share], driven))
            phase = 2.0 * np.pi * (rng.random() + shake.line_hz * interval_s * np.cumsum(speed))
            rate += shake.line_radps * np.cos(phase)
            turned += shake.line_radps / (2.0 * np.pi * shake.line_hz) * np.sin(phase)
        if shake.band_radps:
            band, integral = _band(t.size, interval_s, rng)
            rate += shake.band_radps * band
            turned += shake.band_radps * integral
        if shake.spikes:
            hit = rng.random(t.size) < shake.spikes
            rate += shake.spike_radps * hit * rng.choice([-1.0, 1.0], t.size) * rng.uniform(0.2, 1.0, t.size)
        new[gyro] = getattr(recording, gyro) + sign * rate
        if shake.turns:
            new[angle] = getattr(recording, angle) + turned
    return msgspec.structs.replace(recording, **new)


def _band(count: int, interval_s: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Noise of RMS 1 in BAND_HZ, made at a rate that holds all of it and polled, and its integral."""
    finer = int(np.ceil(4.0 * BAND_HZ[1] * interval_s))
    f = np.fft.rfftfreq(count * finer, interval_s / finer)
    inside = (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
    waves = np.where(inside, rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size), 0.0)
    both = [np.fft.irfft(z, count * finer) for z in (waves, waves / (2j * np.pi * np.maximum(f, f[1])))]
    size = float(np.std(both[0]))
    return both[0][::finer] / size, both[1][::finer] / size


def unjudged(sample: ImuSample) -> Conditioned:
    """A sample whose readings are all believed, with angles of its own time: for a predictor by itself."""
    t_s = sample.t_s
    return Conditioned(
        sample=sample,
        fault=Fault.NONE,
        force_t_s=t_s,
        force_std_s=0.0,
        attitude=Attitude(t_s, sample.roll_rad, sample.pitch_rad, sample.yaw_rad, measured_s=t_s),
        attitude_std_s=0.0,
        attitude_is_slow=False,
        notes=NOTHING,
    )


class Predicted(NamedTuple):
    """Roll and pitch ahead, and their standard deviations, (n, H, 2) each."""

    rad: Array
    std_rad: Array


def predicted(recording: Recording, *, gyros: bool) -> Predicted:
    """What the daemon's predictor makes of a record, with its body rates or as if there were none."""
    estimator = RockEstimator(rock.Params())
    kept = [estimator.horizons_s.index(h) for h in HORIZONS_S]
    found = []
    for sample in recording.samples():
        if not isinstance(sample, ImuSample):
            continue
        given = sample if gyros else msgspec.structs.replace(sample, gx_radps=nan, gy_radps=nan, gz_radps=nan)
        latest = estimator.step(unjudged(given))
        found.append([_OF_PREDICTION(latest[k]) for k in kept])
    numbers = np.array(found)
    return Predicted(numbers[..., :2], numbers[..., 2:])


def scored(predictions: Predicted, recording: Recording, rate_hz: float) -> tuple[Array, Array, int]:
    """RMS error against the waves and coverage of the readings, (H, 2) each; how many errors beyond LIE."""
    truth = np.stack([recording.truth.roll_rad, recording.truth.pitch_rad], axis=1)
    readings = np.stack([recording.roll_rad, recording.pitch_rad], axis=1)
    rms, coverage, lies = [], [], 0
    for k, horizon_s in enumerate(HORIZONS_S):
        ahead = round(horizon_s * rate_hz)
        made = np.arange(round(SCORED_FROM_S * rate_hz), len(truth) - ahead)
        error, std = predictions.rad[made, k] - truth[made + ahead], predictions.std_rad[made, k]
        rms.append(np.sqrt(np.mean(error**2, axis=0)))
        off = np.abs(predictions.rad[made, k] - readings[made + ahead])
        coverage.append(np.mean(off <= 1.96 * std, axis=0))
        lies += int(np.sum(np.abs(error) > LIE * std))
    return np.array(rms), np.array(coverage), lies


def rows(rate_hz: float, seed: int, duration_s: float, names: Sequence[str] = tuple(SHAKES)) -> list[Row]:
    """Of one record of the sea, each shake beside the same record that is still.

    Raises:
        ValueError: rate_hz does not hold the horizons.
    """
    if any(abs(h * rate_hz - round(h * rate_hz)) > 1e-6 for h in HORIZONS_S):
        raise ValueError(f"{rate_hz:g} Hz: no sample falls on some of the horizons")
    still = record(seaway(SEA, seed=seed), duration_s, imu_rate_hz=rate_hz, laser="off", seed=seed + 100)
    quiet, _, _ = scored(predicted(still, gyros=True), still, rate_hz)
    table = []
    for name in names:
        recording = shaken(still, SHAKES[name], seed)
        rms, covered, lies = scored(predicted(recording, gyros=True), recording, rate_hz)
        plain, _, others = scored(predicted(recording, gyros=False), recording, rate_hz)
        table.append(
            Row(
                shake=name,
                rate_hz=rate_hz,
                over_without=tuple(np.max(rms / plain, axis=1).tolist()),
                over_still=tuple(np.max(rms / quiet, axis=1).tolist()),
                least_coverage=tuple(np.min(covered, axis=1).tolist()),
                most_coverage=tuple(np.max(covered, axis=1).tolist()),
                lies=lies + others,
                predictions=4 * len(HORIZONS_S) * round((duration_s - SCORED_FROM_S) * rate_hz),
            )
        )
    return table


def table(seeds: Sequence[int], duration_s: float, jobs: int) -> list[Row]:
    runs = list(product(RATES_HZ, seeds))
    return [row for of_run in in_order(partial(_rows, duration_s=duration_s), runs, jobs) for row in of_run]


def _rows(run: tuple[float, int], duration_s: float) -> list[Row]:
    return rows(*run, duration_s)


def report(found: Sequence[Row]) -> str:
    """The table as Markdown: the worst of the records."""
    head = " | ".join(f"{h:g} s" for h in HORIZONS_S)
    lines = [
        f"Roll and pitch ahead on a hull that shakes, {SEA}, sensor A, from {SCORED_FROM_S:g} s on, against the waves:",
        "RMS with body rates over that without / over that of the still record; coverage of 1.96 std, against readings",
        "",
        f"| shake | Hz | {head} | coverage | beyond {LIE:g} std |",
        "|" + "---|" * (len(HORIZONS_S) + 4),
    ]
    for name, rate_hz in dict.fromkeys((row.shake, row.rate_hz) for row in found):
        same = [row for row in found if (row.shake, row.rate_hz) == (name, rate_hz)]
        without = np.max([row.over_without for row in same], axis=0)
        still = np.max([row.over_still for row in same], axis=0)
        cells = " | ".join(f"{a:.2f} / {b:.2f}" for a, b in zip(without, still, strict=True))
        least = min(min(row.least_coverage) for row in same)
        most = max(max(row.most_coverage) for row in same)
        lies, of = sum(row.lies for row in same), sum(row.predictions for row in same)
        lines.append(f"| {name} | {rate_hz:g} | {cells} | {100 * least:.0f}-{100 * most:.0f} % | {lies} of {of} |")
    return "\n".join(lines)
