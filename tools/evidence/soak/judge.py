"""Whether what a daemon uses grows: slopes with their standard errors, held against what would matter. Pure."""

from __future__ import annotations

from enum import Enum
from math import inf, isfinite, isnan, nan
from statistics import median
from typing import TYPE_CHECKING, Final, NamedTuple

import msgspec
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

SETTLING_S: Final = 600.0
"""The longest past that an estimator keeps: buffers fill until then, and slopes are taken after it."""
_LEAST: Final = 20
"""Samples of a slope."""
_BEYOND: Final = 2.0
"""Standard errors."""


class Sample(msgspec.Struct, frozen=True, kw_only=True):
    """Some ten seconds of a daemon. nan: not known then. Percentiles: 50, 99, 99.9."""

    t_s: float
    """Since the start."""
    rss_mb: float
    workers_pss_mb: dict[str, float]
    descriptors: int
    threads: int
    cpu_percent: float
    workers_cpu_percent: float
    ages_ms: tuple[float, float, float]
    """At the clients."""
    lateness_ms: tuple[float, float, float]
    """Of polls."""
    frames_per_s: float
    lost: int
    """Frames that clients missed."""
    valid: float
    """Share of the frames."""
    missed_polls: float
    output_lost: float
    """Messages of outputs beside the stream that did not go out, and rows that were not recorded."""


class Verdict(Enum):
    """Of one quantity."""

    FLAT = "flat"
    GROWS = "grows"
    FALLS = "falls"
    OPEN = "not shown"


class Slope(NamedTuple):
    """Of a straight line through samples."""

    per_h: float
    std_per_h: float


class Quantity(NamedTuple):
    """What is looked at."""

    name: str
    of: Callable[[Sample], float]
    least_per_h: float = inf
    """A slope below this does not matter ..."""
    least_share_per_h: float = 0.0
    """... nor one below this share of the value; inf and 0: it is told and not judged."""
    is_counted: bool = False
    """It is rare: its mean says more than its median."""


class Found(NamedTuple):
    """Of one quantity: what is usual in the first ten minutes, between, and in the last ten."""

    quantity: Quantity
    first: float
    middle: float
    last: float
    slope: Slope
    limit_per_h: float
    verdict: Verdict | None


MEMORY_MB_PER_H: Final = 1.0
MEMORY_SHARE_PER_H: Final = 0.01


def _worker(name: str) -> Callable[[Sample], float]:
    return lambda sample: sample.workers_pss_mb.get(name, nan)


def _percentiles(title: str, of: Callable[[Sample], tuple[float, float, float]]) -> list[Quantity]:
    return [
        Quantity(f"{title}, p50 (ms)", lambda sample: of(sample)[0]),
        Quantity(f"{title}, p99 (ms)", lambda sample: of(sample)[1]),
        Quantity(f"{title}, p99.9 (ms)", lambda sample: of(sample)[2]),
    ]


def quantities(samples: Sequence[Sample]) -> list[Quantity]:
    """Of a soak, in the order of the table."""
    workers = sorted({name for sample in samples for name in sample.workers_pss_mb})
    memory = (MEMORY_MB_PER_H, MEMORY_SHARE_PER_H)
    return [
        Quantity("memory of the daemon, resident (MB)", lambda sample: sample.rss_mb, *memory),
        *(Quantity(f"memory of its {name}, PSS (MB)", _worker(name), *memory) for name in workers),
        Quantity("descriptors", lambda sample: float(sample.descriptors), 0.5),
        Quantity("threads", lambda sample: float(sample.threads), 0.5),
        Quantity("frames per second at a client", lambda sample: sample.frames_per_s, 0.1),
        Quantity("processor, % of a core", lambda sample: sample.cpu_percent),
        Quantity("processor of its processes, %", lambda sample: sample.workers_cpu_percent),
        *_percentiles("age at the client", lambda sample: sample.ages_ms),
        *_percentiles("lateness of polls", lambda sample: sample.lateness_ms),
        Quantity("valid (% of the frames)", lambda sample: 100.0 * sample.valid),
        Quantity("frames lost by clients, per 10 s", lambda sample: float(sample.lost), is_counted=True),
        Quantity("polls missed, per 10 s", lambda sample: sample.missed_polls, is_counted=True),
        Quantity("messages and rows lost, per 10 s", lambda sample: sample.output_lost, is_counted=True),
    ]


def slope(t_s: Sequence[float], values: Sequence[float]) -> Slope:
    """Least squares per hour. Neighbouring samples tell partly the same: by the correlation r of the residuals with
    their next, the standard error is that of n (1 - r)/(1 + r) samples. nan: too few.
    """
    known = [(t, value) for t, value in zip(t_s, values, strict=True) if isfinite(value)]
    if len(known) < _LEAST:
        return Slope(nan, nan)
    x, y = np.array(known).T
    x = (x - x.mean()) / 3600.0
    per_h = float(x @ (y - y.mean()) / (x @ x))
    residual = y - y.mean() - per_h * x
    power = float(residual @ residual)
    if power <= 1e-18 * max(1.0, float(y @ y)):
        return Slope(per_h, 0.0)
    r = min(max(float(residual[1:] @ residual[:-1]) / power, 0.0), 0.99)
    least = len(y) * (1.0 - r) / (1.0 + r) - 2.0
    if least < 1.0:
        return Slope(per_h, inf)
    return Slope(per_h, float(np.sqrt(power / len(y) * (len(y) / least) / (x @ x))))


def verdict(found: Slope, limit_per_h: float) -> Verdict:
    """Flat: even two standard errors off the slope stays within the limit; growing (falling): even two standard errors
    less is beyond it; else the time was too short to show either.
    """
    reach = _BEYOND * found.std_per_h
    if abs(found.per_h) + reach <= limit_per_h:
        return Verdict.FLAT
    if found.per_h - reach > limit_per_h:
        return Verdict.GROWS
    return Verdict.FALLS if found.per_h + reach < -limit_per_h else Verdict.OPEN


def judge(samples: Sequence[Sample]) -> list[Found]:
    """All quantities of a soak."""
    end_s = samples[-1].t_s
    settling_s = min(SETTLING_S, 0.25 * end_s)
    first = [sample for sample in samples if sample.t_s <= settling_s]
    last = [sample for sample in samples if sample.t_s > end_s - settling_s]
    middle = [sample for sample in samples if settling_s < sample.t_s <= end_s - settling_s]
    settled = [*middle, *last]
    found = []
    for quantity in quantities(samples):
        line = slope([one.t_s for one in settled], [quantity.of(one) for one in settled])
        level = _usual(settled, quantity)
        is_judged = quantity.least_per_h < inf
        limit = max(quantity.least_per_h, quantity.least_share_per_h * abs(level)) if is_judged else inf
        said = verdict(line, limit) if is_judged and isfinite(level) else None
        usual = [_usual(part, quantity) for part in (first, middle, last)]
        found.append(Found(quantity, usual[0], usual[1], usual[2], line, limit, said))
    return found


def _usual(samples: Sequence[Sample], quantity: Quantity) -> float:
    values = [value for sample in samples if not isnan(value := quantity.of(sample))]
    if not values:
        return nan
    return sum(values) / len(values) if quantity.is_counted else median(values)


def is_flat(found: Sequence[Found]) -> bool:
    """All that is judged is."""
    return all(one.verdict in (None, Verdict.FLAT) for one in found)


def table(found: Sequence[Found], end_s: float) -> str:
    """Markdown."""
    minutes = min(SETTLING_S, 0.25 * end_s) / 60.0
    lines = [
        f"|  | first {minutes:.3g} min | between | last {minutes:.3g} min | slope per hour | matters from |  |",
        "|---|---|---|---|---|---|---|",
    ]
    for one in found:
        slope_text = f"{one.slope.per_h:+.3g} ± {one.slope.std_per_h:.2g}" if isfinite(one.slope.per_h) else "-"
        limit = f"{one.limit_per_h:.3g}" if one.limit_per_h < inf else "-"
        said = f"**{one.verdict.value}**" if one.verdict else "-"
        usual = " | ".join("-" if isnan(value) else f"{value:.4g}" for value in (one.first, one.middle, one.last))
        lines.append(f"| {one.quantity.name} | {usual} | {slope_text} | {limit} | {said} |")
    lines += [
        "",
        f"Medians; of what is counted, means. Slope: least squares over all but the first {minutes:.3g} min (buffers",
        "fill), ± one standard error, which counts neighbouring samples as alike as their residuals are. Flat: the",
        f"slope and two standard errors stay below what would matter: {MEMORY_MB_PER_H:g} MB an hour (or",
        f"{MEMORY_SHARE_PER_H:.0%}, where that is more), half a descriptor or thread, 0.1 frames per second.",
    ]
    return "\n".join(lines)
