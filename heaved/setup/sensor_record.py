"""What a burst of polls shows of a sensor: how often it measures, its noise, what shakes it, how fast it answers. Pure.

A record says only what its length and its rate allow; what it cannot say is nan, with the length that could.
"""

from __future__ import annotations

from math import inf, log, nan, sqrt
from typing import TYPE_CHECKING, Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """When a record is believed. Without a source where none is named: chosen, and held by the tests."""

    fewest: int = 32
    """Values, of fewer nothing is said of noise and lines."""
    few_changes: int = 10
    """Of fewer new values nothing is said of how often they come."""
    even: float = 0.5
    """New values of a clock lie about an even row of times by less than this share of its period: polls that see one
    period in n scatter them by 1 / (n sqrt(12)) of it, at most 0.29. Values that repeat by chance scatter more with
    every one of them."""
    missed: float = 1.4
    """The clock of the new values is faster than their number says, if some were missed, by so much at the most;"""
    clear: float = 0.85
    """and slower than so much of the polls' own rate, or it is taken for that."""
    on_clock: float = 0.3
    """Length of the mean of the phases of new values from which each belongs to a tick: sin(pi r) / (pi r) where the
    sensor measures r times as often as it is asked."""
    all_new: float = 0.98
    """Share of new values from which each poll is one."""
    vibration_hz: float = 1.0
    """Where lines and noise are looked for: above the waves."""
    passband: float = 0.7
    """Share of its bandwidth up to which a low-pass leaves white noise alone: one of the second order takes a tenth of
    the power there."""
    nyquist: float = 0.9
    """Share of half the rate up to which a spectrum is looked at."""
    segments: int = 16
    """Of which the spectrum is the mean."""
    padding: int = 4
    """Frequencies looked at in each bin of the record."""
    lobe: int = 2
    """Bins to either side over which the window spreads a line,"""
    flank: int = 6
    """and those up to which it must stand out of what is beside it."""
    longest: int = 2048
    """Newest values in which lines are looked for: more would cost time and show engines that change their speed;"""
    ticks: int = 8192
    """and of which a clock is refined."""
    chance: float = 1e-3
    """That a line of a record is none."""
    blocks: float = 5.0
    """Longest mean of which the walk is taken, as a share of the record."""
    surely: float = 3.0
    """Standard deviations by which a walk exceeds what white noise makes."""
    upper: float = 0.4
    """Share of the band from which white noise is taken: below it a hull bends, and what is there leaks."""


TUNING: Final = Tuning()


# ---- how often it measures -------------------------------------------------------------------------------------------


class Pace(msgspec.Struct, frozen=True, kw_only=True):
    """How often there is a new value among polls."""

    polls_hz: float
    new_hz: float
    kind: Literal["every poll", "clock", "by chance", "hardly"]
    """every poll: the sensor measures as often as it was asked, or more often. clock: values repeat as those of a
    slower clock do. by chance: they repeat, but not evenly, as coarse registers of something that hardly moves do.
    hardly: too few new ones to say more."""

    @property
    def is_slower(self) -> bool:
        """Whether the sensor measures more slowly than it was asked."""
        return self.kind == "clock"


def pace(t_s: Array, is_new: NDArray[np.bool_]) -> Pace:
    """How often the sensor measures.

    ``t_s`` (n,): when it was asked, increasing. ``is_new`` (n,): whether the answer differs from the one before, or its
    device time does.
    """
    if len(t_s) < 2 or not t_s[-1] > t_s[0]:
        return Pace(polls_hz=nan, new_hz=nan, kind="hardly")
    span_s = float(t_s[-1] - t_s[0])
    polls_hz = (len(t_s) - 1) / span_s
    changes_s = t_s[1:][is_new[1:]]
    if len(changes_s) < TUNING.few_changes:
        return Pace(polls_hz=polls_hz, new_hz=len(changes_s) / span_s, kind="hardly")
    if len(changes_s) >= TUNING.all_new * (len(t_s) - 1):
        return Pace(polls_hz=polls_hz, new_hz=polls_hz, kind="every poll")
    counted_hz = (len(changes_s) - 1) / float(changes_s[-1] - changes_s[0])
    clock_hz = _clock_hz(changes_s, counted_hz, polls_hz)
    if clock_hz:
        return Pace(polls_hz=polls_hz, new_hz=clock_hz, kind="clock")
    row = np.arange(len(changes_s))
    off = (changes_s - np.polyval(np.polyfit(row, changes_s, 1), row)) * counted_hz
    return Pace(polls_hz=polls_hz, new_hz=counted_hz, kind="clock" if float(np.std(off)) < TUNING.even else "by chance")


def _clock_hz(changes_s: Array, counted_hz: float, polls_hz: float) -> float:
    """Rate of the clock on which the changes (n,) are; 0: on none that is clearly slower than the polls.

    Polls that see one period in 1/r scatter the phases of the changes over a share r of it, whose mean has the length
    sin(pi r) / (pi r), however many of them were missed. That of changes by chance exceeds sqrt(log(m / p) / n) at one
    of m rates with probability p.
    """
    changes_s = changes_s[-TUNING.ticks :]
    span_s = float(changes_s[-1] - changes_s[0])
    rates = np.arange(0.98 * counted_hz, min(TUNING.missed * counted_hz, TUNING.clear * polls_hz), 0.1 / span_s)
    if len(rates) == 0:
        return 0.0
    agreement = np.abs(_transform(changes_s - changes_s[0], np.ones(len(changes_s)), rates)) / len(changes_s)
    best = int(np.argmax(agreement))
    least = sqrt(log(len(rates) / TUNING.chance) / len(changes_s))
    return float(rates[best]) if agreement[best] > least else 0.0


def measured(t_s: Array, values: Array, is_new: NDArray[np.bool_], found: Pace) -> tuple[Array, Array]:
    """The record of the sensor itself: of a clock each value once, at the clock's times if they show; else every poll.

    ``t_s``, ``is_new`` (n,), ``values`` (n,). Returns times (m,), increasing, and values (m,).
    """
    if not found.is_slower:
        return t_s, values
    new = is_new.copy()
    new[0] = False  # Nobody knows since when it had been there.
    changes_s, period_s = t_s[new] - t_s[0], 1.0 / found.new_hz
    turn = np.mean(np.exp(2j * np.pi * changes_s / period_s))
    if abs(turn) < TUNING.on_clock:
        return t_s[new], values[new]
    # A new value is seen at the first poll after a tick: half an interval of the polls late, in the mean.
    mean_s = float(np.angle(turn)) / (2.0 * np.pi) * period_s
    ticks, once = np.unique(np.round((changes_s - mean_s) / period_s), return_index=True)
    return t_s[0] + mean_s - 0.5 / found.polls_hz + period_s * ticks, values[new][once]


# ---- noise -----------------------------------------------------------------------------------------------------------


class Noise(msgspec.Struct, frozen=True, kw_only=True):
    """Of one channel, in its own unit u."""

    density: float
    """One-sided density of the white noise, u/sqrt(Hz); nan: the record is too short or too slow to say."""
    walk: float = nan
    """Of the bias, u/sqrt(s); nan: not seen."""
    walk_limit: float = nan
    """More than so much would have been seen; nan: nothing can be said, because it moves or is too short."""
    is_moved: bool = False
    """The record holds a motion that hides the walk."""
    steps: float = nan
    """Density that the rounding of the register makes by itself; nan: not known."""


def noise(
    t_s: Array,
    x: Array,
    *,
    bandwidth_hz: float = 0.0,
    step: float = 0.0,
    moving: float = inf,
    shaken_by: Sequence[Line] = (),
) -> Noise:
    """White noise and walk of the bias of a sensor.

    ``t_s``, ``x`` (n,): a record. ``bandwidth_hz``: of its low-pass, 0: not known. ``step``: of its register, 0: none.
    ``moving``: who wanders by more than that (u) in seconds is moved, and not by a bias. ``shaken_by``: lines that were
    found, which are taken out.

    The white noise is the median of the spectrum above the waves and below bandwidth and half the rate, so that lines
    do not count: S = N^2. The walk shows in the Allan variance, N^2 / (2 tau) + K^2 tau / 3 (IEEE 952-1997, annex C).
    """
    rate_hz = (len(t_s) - 1) / float(t_s[-1] - t_s[0]) if len(t_s) > 1 else 0.0
    top_hz = 0.5 * TUNING.nyquist * rate_hz
    if bandwidth_hz:
        top_hz = min(top_hz, TUNING.passband * bandwidth_hz)
    if len(x) < TUNING.fewest or top_hz < 2.0 * TUNING.vibration_hz:
        return Noise(density=nan)
    density = _white_density(_without(t_s, x, shaken_by), rate_hz, top_hz)
    # Rounding spreads step^2 / 12 over the band up to half the rate.
    steps = step / sqrt(6.0 * rate_hz) if step else nan
    if not density > 0.0:  # It has hardly changed: what it is lies within the rounding.
        return Noise(density=density, steps=steps)
    tau_s = float(t_s[-1] - t_s[0]) / TUNING.blocks
    variance, white = _allan_variance(x, max(round(tau_s * rate_hz), 1)), density**2 / (2.0 * tau_s)
    short = _allan_variance(x, max(round(min(1.0, tau_s) * rate_hz), 1))
    if sqrt(max(variance, short)) > moving:
        return Noise(density=density, is_moved=True, steps=steps)
    excess, unsure = variance - white, TUNING.surely * white * sqrt(2.0 / TUNING.blocks)
    if excess > unsure:
        return Noise(density=density, walk=sqrt(3.0 * excess / tau_s), steps=steps)
    return Noise(density=density, walk_limit=sqrt(3.0 * (max(excess, 0.0) + unsure) / tau_s), steps=steps)


def record_to_see_s(walk: float, density: float) -> float:
    """Length of a record of a sensor that lies still in which :func:`noise` sees such a walk (u/sqrt(s)) through such a
    white noise (u/sqrt(Hz)).
    """
    if not (walk > 0.0 and density > 0.0):
        return inf
    # From the excess that it asks for, K^2 tau / 3 = surely N^2 / (2 tau) sqrt(2 / blocks), with tau = record / blocks.
    return TUNING.blocks * sqrt(1.5 * TUNING.surely * sqrt(2.0 / TUNING.blocks)) * density / walk


def _white_density(x: Array, rate_hz: float, top_hz: float) -> float:
    from scipy.signal import detrend, welch
    from scipy.stats import chi2

    length = min(len(x), max(2 * len(x) // (TUNING.segments + 1), TUNING.fewest))
    f, power = welch(x, rate_hz, nperseg=length, detrend=detrend)
    inside = (f >= max(TUNING.vibration_hz, TUNING.upper * top_hz)) & (f <= top_hz) & (f > 2.0 * f[1])
    if not inside.any():
        return nan
    # The median of a mean of chi-square variables lies below their mean; half overlapping segments count less than one.
    freedom = 2.0 * max(1.0, 0.95 * (2 * len(x) // length - 1))
    return sqrt(float(np.median(power[inside])) * freedom / float(chi2.ppf(0.5, freedom)))


def _without(t_s: Array, x: Array, shaken_by: Sequence[Line]) -> Array:
    """x (n,) less the lines, each by least squares."""
    if not shaken_by:
        return x
    angles = 2.0 * np.pi * np.outer(t_s - t_s[0], [line.frequency_hz for line in shaken_by])
    waves = np.column_stack((np.ones(len(x)), t_s - t_s[0], np.cos(angles), np.sin(angles)))
    return np.asarray(x - waves @ np.linalg.lstsq(waves, x, rcond=None)[0])


def _allan_variance(x: Array, n: int) -> float:
    """Of means over ``n`` values, overlapping."""
    if len(x) < 2 * n + 1:
        return nan
    total = np.concatenate(([0.0], np.cumsum(x - np.mean(x))))
    means = (total[n:] - total[:-n]) / n
    return 0.5 * float(np.mean((means[n:] - means[:-n]) ** 2))


# ---- what shakes it --------------------------------------------------------------------------------------------------


class Line(msgspec.Struct, frozen=True):
    """One frequency that stands out of a record."""

    frequency_hz: float
    """As the record shows it: what is faster than half its rate shows at another one."""
    amplitude: float


def lines(t_s: Array, x: Array, most: int = 3) -> list[Line]:
    """The strongest lines above the waves, each taken out of the record before the next is looked for.

    ``t_s``, ``x`` (n,): a record whose times need not be even. A line counts when its power exceeds what the noise
    beside it, on either side, shows in one of a thousand records: short waves fall with the frequency, and are none.
    """
    if len(x) < TUNING.fewest:
        return []
    t_s, x = t_s[-TUNING.longest :], x[-TUNING.longest :]
    span_s = float(t_s[-1] - t_s[0])
    t, rest = t_s - t_s[0], np.asarray(x - np.polyval(np.polyfit(t_s - t_s[0], x, 1), t_s - t_s[0]))
    top_hz = 0.5 * TUNING.nyquist * (len(x) - 1) / span_s
    bottom_hz = max(TUNING.vibration_hz, 4.0 / span_s)
    f = np.arange(max(bottom_hz - TUNING.flank / span_s, 1.0 / span_s), top_hz, 1.0 / (TUNING.padding * span_s))
    if len(f) < (8 + TUNING.flank) * TUNING.padding:
        return []
    window = np.hanning(len(x))
    least = log(len(f) / TUNING.padding / TUNING.chance) / log(2.0)
    found: list[Line] = []
    may_be = f >= bottom_hz
    while len(found) < most and may_be.any():
        power = np.abs(_transform(t, rest * window, f)) ** 2
        k = int(np.argmax(power * may_be))
        floor = _beside(power, k)
        if power[k] <= least * floor or 2.0 * sqrt(power[k]) / float(np.sum(window)) <= 1e-9:
            break
        at = float(f[k] + (f[1] - f[0]) * _vertex(power, k))
        waves = np.column_stack((np.cos(2.0 * np.pi * at * t), np.sin(2.0 * np.pi * at * t)))
        parts = np.linalg.lstsq(waves * window[:, None], rest * window, rcond=None)[0]
        rest = rest - waves @ parts
        found.append(Line(at, float(np.hypot(*parts))))
        may_be &= np.abs(f - at) > TUNING.lobe / span_s  # What is left of it, where its speed or strength changes.
    return found


def _transform(t: Array, x: Array, f: Array) -> NDArray[np.complex128]:
    """Fourier sums of x (n,) at times t (n,), for evenly spaced frequencies f (k,).

    Each is the one before, turned on by the spacing: many times cheaper than k n exponentials, and exact to some 1e-13.
    """
    turning = x * np.exp(-2j * np.pi * f[0] * t)
    turn = np.exp(-2j * np.pi * (f[1] - f[0]) * t) if len(f) > 1 else np.ones(len(t))
    sums = np.empty(len(f), dtype=np.complex128)
    for k in range(len(f)):
        sums[k] = turning.sum()
        turning *= turn
    return sums


def _beside(power: Array, k: int) -> float:
    """Of the spectrum about bin ``k``: the largest of the medians about it, on its left and on its right."""
    reach, lobe, flank = 32 * TUNING.padding, TUNING.lobe * TUNING.padding, TUNING.flank * TUNING.padding
    start = min(max(k - reach, 0), max(len(power) - 2 * reach, 0))
    parts = power[start : start + 2 * reach], power[max(k - flank, 0) : max(k - lobe, 0)], power[k + lobe : k + flank]
    return float(max(np.median(part) for part in parts if len(part)))


def _vertex(power: Array, k: int) -> float:
    """Where, in bins from ``k``, the parabola through the logarithm has its top."""
    if not 0 < k < len(power) - 1:
        return 0.0
    left, top, right = np.log(power[k - 1 : k + 2] + 1e-300)
    curvature = left - 2.0 * top + right
    return float(np.clip(0.5 * (left - right) / curvature, -0.5, 0.5)) if curvature < 0.0 else 0.0


def folded_hz(frequency_hz: float, rate_hz: float) -> float:
    """At which frequency a line shows when it is polled ``rate_hz`` times a second."""
    return abs(frequency_hz - rate_hz * round(frequency_hz / rate_hz))


# ---- how fast it answers ---------------------------------------------------------------------------------------------


class RoundTrips(msgspec.Struct, frozen=True, kw_only=True):
    """From the request to the whole answer."""

    answers: int
    lost: int
    median_s: float = nan
    p95_s: float = nan
    p99_s: float = nan
    worst_s: float = nan

    @property
    def timeout_ms(self) -> float:
        """To wait for an answer: half as long again as for 99 % of this record, and four times as far above the usual
        one as 95 % are; nan: there was none. The few that are slower yet are lost: they are this machine's, mostly.
        """
        if not self.answers:
            return nan
        least_ms = 1e3 * max(1.5 * self.p99_s, self.median_s + 4.0 * (self.p95_s - self.median_s))
        return next((choice for choice in TIMEOUTS_MS if choice >= least_ms - 1e-6), TIMEOUTS_MS[-1])


TIMEOUTS_MS: Final[tuple[float, ...]] = (
    *(20.0, 25.0, 30.0, 40.0, 50.0, 75.0, 100.0, 150.0, 200.0, 300.0, 500.0),
    *(1000.0, 2000.0, 5000.0, 10000.0),
)
"""Worth writing. None below 20: a machine that is busy for once takes so long."""


def round_trips(durations_s: Sequence[float], lost: int) -> RoundTrips:
    """Of some answers, and of requests without one."""
    if not durations_s:
        return RoundTrips(answers=0, lost=lost)
    median_s, p95_s, p99_s = map(float, np.percentile(durations_s, (50.0, 95.0, 99.0)))
    return RoundTrips(
        answers=len(durations_s), lost=lost, median_s=median_s, p95_s=p95_s, p99_s=p99_s, worst_s=max(durations_s)
    )


def age_spread_s(t_s: Array, device_time_s: Array) -> float:
    """By how much the age of an answer varies, 5 to 95 %, from the device's own clock; its drift against ours, a
    straight line, is taken out. What is constant of the age cannot be seen.

    ``t_s``, ``device_time_s`` (n,): when it was asked, and what it said. nan: too few, or a clock that leapt.
    """
    if len(t_s) < TUNING.fewest:
        return nan
    age = np.asarray(t_s - device_time_s)
    age = age - np.polyval(np.polyfit(t_s - t_s[0], age, 1), t_s - t_s[0])
    low, high = np.percentile(age, (5.0, 95.0))
    return float(high - low) if high - low < 1.0 else nan
