"""What shakes the accelerometer above the waves, found in the periodogram: engines, propellers, the hull's own bending.

Whatever stands there and is not in the model is taken for waves by a filter that trusts the acceleration to a
thousandth of a m/s2: a line of 0.3 m/s2 then costs several times the heave. So it is described: by a few resonances
(:class:`Resonance`), wide ones for broad bands and narrow ones for lines, beside white noise. They are added one by one
where the periodogram stands most significantly above the spectrum so far, and all of them then fitted to it (Whittle's
likelihood, Fisher scoring), until nothing significant is left. Of the noise *within* the waves' band this says nothing:
a resonance falls with f^4 towards them.

Lines wander with the speed of their engine. None is therefore taken for narrower than a damping of 0.03: so steep are
the skirts that the width costs the heave nothing.

Waves do not end with the band that is fitted. A broad spectrum that ends below 3 Hz is short waves, the
heave of a small craft, and counts as heave.
"""

from __future__ import annotations

from math import cos, exp, log, pi, sin, sqrt
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.sea.model import Resonance, SeaModel, resonance_shape

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of the search for what shakes the sensor."""

    most: int = 5
    """Resonances: each costs the filter four states."""
    line: float = 0.15
    """What is damped less is a line,"""
    above_short_waves_hz: float = 1.5
    """and lower it may be a wave that was not understood;"""
    most_remembered: int = 2
    """so many of them are remembered when they are not there any more,"""
    forgotten: float = 0.8
    """with this share of their level at each look,"""
    remembered: float = 10.0
    """as long as that is so many times the noise,"""
    same: float = 0.15
    """and they are not within this share of the frequency of one that is seen."""
    significant: float = 12.0
    """Log-likelihood that one more has to gain; it has three parameters, and some thousand places to be at."""
    narrowest: float = 0.03
    """Damping: 4 % between the half-power points."""
    widest: float = 0.95
    """Damping: at 1 a resonance has no pair of poles any more."""
    broad: float = 0.2
    """Width of the spectrum over its frequency from which it may be that of waves."""
    shortest_waves_hz: float = 3.0
    """The shortest waves that move a small craft."""
    above_waves: float = 0.15
    """Share of the power that may lie above while it is still waves."""
    stays: float = 2.0
    """What was waves at the last look is until it is this much further from them: heave that is counted in one look and
    not in the next jumps by as much."""
    pooled: float = 0.01
    """Ordinates nearer together than this share of their frequency are pooled."""
    widths: tuple[int, ...] = (1, 3, 8, 20, 50, 120)
    """In pooled ordinates, over which the periodogram is held against the spectrum so far."""
    noise: tuple[float, float] = (0.7, 1.3)
    """Share of the noise that is expected within which it is fitted: the skirts of resonances may not take its
    place."""
    steps: int = 12
    """Of Fisher scoring, at most: four or five are enough."""
    longest_step: float = 0.7
    """Of any logarithm, in one of them."""


TUNING: Final = Tuning()
HALF_POWER: Final = 1.29
"""Width between the half-power points over damping and frequency, of a narrow resonance."""


class Above(msgspec.Struct, frozen=True, eq=False):
    """Averaged periodogram of the vertical acceleration above the band of the waves."""

    f_hz: Array
    """(n,)"""
    power: Array
    """(n,) one-sided, (m/s2)2/Hz"""
    white: Array
    """(n,) share of white noise that is left, where what is sampled are means."""
    averages: float
    """Independent periodograms in it."""
    dt_s: float
    """Interval of the samples."""


def resonances(above: Above, waves: SeaModel | None, noise_psd: float) -> tuple[tuple[Resonance, ...], float]:
    """What shakes the sensor, strongest first, and the density of its white noise (m/s2)2/Hz.

    waves: whose tail is there as well; None: not known. noise_psd: of the quietest part of the periodogram.
    """
    f, power, white, weight = _pooled(above)
    if len(f) < TUNING.widths[1]:
        return (), noise_psd
    tail = np.zeros_like(f) if waves is None else (2.0 * np.pi * f) ** 4 * waves.wave_spectrum(f)
    scored = _Whittle(f, power, weight, tail, white, above.dt_s, noise_psd)
    theta = np.array([log(noise_psd)])
    cost, theta = scored.fitted(theta)
    for _ in range(TUNING.most):
        more, better = scored.fitted(np.concatenate((theta, scored.standing_out(theta))))
        if not more < cost - TUNING.significant:
            break
        cost, theta = more, better
    found = scored.resonances(theta, np.gradient(f))
    found.sort(key=lambda one: -one.variance)
    were_waves = waves is not None and any(one.is_heave for one in waves.resonances)
    return _told_apart(tuple(found), above.dt_s, TUNING.stays if were_waves else 1.0), float(np.exp(theta[0]))


def remembered(found: tuple[Resonance, ...], before: tuple[Resonance, ...], noise_psd: float) -> tuple[Resonance, ...]:
    """With the lines of the last look that are not seen any more: what is switched off is switched on again, and a
    filter that knows it is not surprised then. It costs the heave nothing meanwhile.
    """
    kept = [
        msgspec.structs.replace(one, level=TUNING.forgotten * one.level, variance=0.0)
        for one in sorted(before, key=lambda one: -one.level)
        if one.damping < TUNING.line
        and one.frequency_hz > TUNING.above_short_waves_hz
        and not one.is_heave
        and one.level > TUNING.remembered * noise_psd
        and all(abs(one.frequency_hz - other.frequency_hz) > TUNING.same * other.frequency_hz for other in found)
    ]
    return (*found, *kept[: max(min(TUNING.most - len(found), TUNING.most_remembered), 0)])


def _pooled(above: Above) -> tuple[Array, Array, Array, Array]:
    """Means of neighbouring ordinates: frequency, power, share of white noise, and how many independent ones there are
    in each.
    """
    f = above.f_hz
    if len(f) < 2:
        return f, above.power, above.white, np.full(len(f), above.averages)
    first, count = groups(f, TUNING.pooled)
    f, power, white = (np.add.reduceat(values, first) / count for values in (f, above.power, above.white))
    return f, power, white, np.asarray(count * above.averages, dtype=np.float64)


def groups(f_hz: Array, share: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Evenly spaced frequencies (n,), n >= 2, in groups that are no wider than ``share`` of their frequency: the first
    of each, and how many there are in it.
    """
    width = np.maximum(np.floor(share * f_hz / (f_hz[1] - f_hz[0])), 1.0)
    # Of a group of m, each takes up 1 / m.
    first = np.flatnonzero(np.diff(np.floor(np.cumsum(1.0 / width) - 1.0 / width + 1e-9), prepend=-1.0))
    return first, np.diff(first, append=len(f_hz))


def _told_apart(found: tuple[Resonance, ...], dt_s: float, slack: float) -> tuple[Resonance, ...]:
    """With short waves marked; ``slack``: by how much further they may be from what counts as such."""
    f = np.linspace(0.0, 0.5 / dt_s, 1000)[1:]
    power = np.sum([one.spectrum(f, dt_s) for one in found], axis=0) if found else np.zeros_like(f)
    are_waves, whole = f < TUNING.shortest_waves_hz, float(np.sum(power))
    inside = power[are_waves]
    if float(np.sum(inside)) < (1.0 - slack * TUNING.above_waves) * whole or not whole > 0.0:
        return found
    width_hz = float(np.sum(inside)) ** 2 / float(np.sum(inside**2)) * (f[1] - f[0])
    if slack * width_hz < TUNING.broad * float(np.average(f[are_waves], weights=inside)):
        return found
    return tuple([msgspec.structs.replace(one, is_heave=one.frequency_hz < TUNING.shortest_waves_hz) for one in found])


class _Whittle:
    """The likelihood of the pooled periodogram; ``theta`` (3J + 1,): logarithms of the noise, then of frequency,
    damping and level of each resonance, the last over that of its shape at its frequency.
    """

    def __init__(
        self, f: Array, power: Array, weight: Array, tail: Array, white: Array, dt_s: float, noise_psd: float
    ) -> None:
        self._f, self._power, self._weight, self._tail, self._white = f, power, weight, tail, white
        self._dt_s = dt_s
        self._back = np.exp(-2j * pi * dt_s * f)
        self._zeros = np.abs(1.0 - self._back) ** 4
        self._low = np.log([TUNING.noise[0] * noise_psd, f[0], TUNING.narrowest, 1e-18])
        self._high = np.log([TUNING.noise[1] * noise_psd, f[-1], TUNING.widest, 1e12])

    def spectrum(self, theta: Array) -> tuple[Array, Array]:
        """S (n,), and the slopes (3J + 1, n) of log S."""
        noise = float(np.exp(theta[0])) * self._white
        slopes = np.empty((len(theta), len(self._f)))
        slopes[0] = noise
        S = self._tail + noise
        for j in range(1, len(theta), 3):
            f0, zeta, level = np.exp(theta[j : j + 3])
            turn = 2.0 * pi * f0 * self._dt_s
            root = sqrt(1.0 - zeta * zeta)
            # A resonator's denominator in 1/z, 1 - 2 r c / z + r^2 / z^2, and what it changes with r and c.
            r, c = exp(-zeta * turn), cos(turn * root)
            denominator = 1.0 - 2.0 * r * c * self._back + (r * self._back) ** 2
            by_r = (2.0 * r * self._back**2 - 2.0 * c * self._back) / denominator
            by_c = -2.0 * r * self._back / denominator
            part = level * self._zeros / np.abs(denominator) ** 4
            sine = sin(turn * root)
            slopes[j] = part * -4.0 * np.real(by_r * (-zeta * turn * r) - by_c * (sine * turn * root))
            slopes[j + 1] = part * -4.0 * np.real(by_r * (-zeta * turn * r) + by_c * (sine * turn * zeta**2 / root))
            slopes[j + 2] = part
            S = S + part
        return S, slopes / S

    def resonances(self, theta: Array, width_hz: Array) -> list[Resonance]:
        """Of ``theta``, each with the power that the periodogram shows where it is what stands out; ``width_hz`` (n,)
        of the pooled ordinates. The likelihood asks for the same relative fit everywhere: a line that is narrower than
        a resonance may be would be left with too little.
        """
        S, slopes = self.spectrum(theta)
        found = []
        for j, (f0, zeta, level) in enumerate(np.exp(theta[1:].reshape(-1, 3)).tolist()):
            share = slopes[3 * j + 3]
            seen, modelled = (float(np.sum(values * share * width_hz)) for values in (self._power, S))
            scale = max(seen / modelled, 1.0) * self.level(f0, zeta) if modelled > 0.0 else 0.0
            found.append(Resonance(frequency_hz=f0, damping=zeta, level=level * scale, variance=seen))
        return found

    def level(self, f0: float, zeta: float) -> float:
        """Of the spectrum at ``f0`` for a level of 1 in ``theta``."""
        return float(resonance_shape(np.array([f0]), f0, zeta, self._dt_s)[0])

    def fitted(self, theta: Array) -> tuple[float, Array]:
        """The least cost from there, and where."""
        count = (len(theta) - 1) // 3
        low = np.concatenate((self._low[:1], np.tile(self._low[1:], count)))
        high = np.concatenate((self._high[:1], np.tile(self._high[1:], count)))
        theta = np.clip(theta, low, high)
        S, slopes = self.spectrum(theta)
        cost = self._cost(S)
        damping = 1e-2
        for _ in range(TUNING.steps):
            weighed = slopes * self._weight
            slope = weighed @ (self._power / S - 1.0)
            fisher = weighed @ slopes.T
            fisher[np.diag_indices_from(fisher)] *= 1.0 + damping
            fisher[np.diag_indices_from(fisher)] += 1e-3
            trial = np.clip(
                theta + np.clip(np.linalg.solve(fisher, slope), -TUNING.longest_step, TUNING.longest_step), low, high
            )
            trial_S, trial_slopes = self.spectrum(trial)
            trial_cost = self._cost(trial_S)
            if trial_cost < cost:
                is_done = cost - trial_cost < 1e-3
                theta, S, slopes, cost = trial, trial_S, trial_slopes, trial_cost
                damping *= 0.3
                if is_done:
                    break
            else:
                damping *= 5.0
        return cost, theta

    def _cost(self, S: Array) -> float:
        return float(np.sum(self._weight * (np.log(S) + self._power / S)))

    def standing_out(self, theta: Array) -> Array:
        """(3,) a resonance where the periodogram stands most significantly above the spectrum of ``theta``."""
        S, _ = self.spectrum(theta)
        sums = np.concatenate(([0.0], np.cumsum(self._weight * self._power / S)))
        weights = np.concatenate(([0.0], np.cumsum(self._weight)))
        best, place = -1.0, (0, 1)
        for width in TUNING.widths:
            if width >= len(S):
                break
            w = weights[width:] - weights[:-width]
            ratio = (sums[width:] - sums[:-width]) / w
            gain = np.where(ratio > 1.0, w * (ratio - 1.0 - np.log(np.maximum(ratio, 1e-300))), 0.0)
            k = int(np.argmax(gain))
            if gain[k] > best:
                best, place = float(gain[k]), (k, k + width)
        inside = slice(*place)
        excess = np.maximum(self._power[inside] - S[inside], 0.0) + 1e-12
        f0 = float(np.average(self._f[inside], weights=excess))
        step = self._f[min(place[1], len(S) - 1)] - self._f[place[0]]
        zeta = min(max(float(step) / (HALF_POWER * f0), TUNING.narrowest), TUNING.widest)
        span_hz = max(float(step), TUNING.narrowest * HALF_POWER * f0)
        level = float(np.mean(excess)) * float(step) / span_hz if step > 0.0 else float(np.mean(excess))
        return np.log([f0, zeta, level / self.level(f0, zeta)])
