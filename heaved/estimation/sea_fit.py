"""Fitting the sea model to the recent past: Whittle's likelihood of the spectrum of the vertical acceleration.

    minimise  sum_f  (log S(f) + P(f) / S(f)) (f_1 / f)^0.7,      S = w^4 sum_k S_k + N + 2 B / w^2,

over log f0, log zeta and log L of each component and log N, P being the periodogram. The ordinates of a periodogram are
nearly independent exponential variables, so Fisher scoring applies: each step is the weighted least-squares fit of
P / S - 1 by the slopes of log S, and a handful of steps do what a general minimiser needs hundreds of evaluations for.
All starts run side by side; the best one is taken.

What the error of the heave lives on is the low-frequency skirt of the spectrum, four decades below its peak. It has a
dozen ordinates, and the tail above the peak has hundreds: were they weighed alike, a skirt that is far off would be
paid for by a slightly better tail; were every octave weighed alike, the tail would be left to chance, and with it the
forecasts of a second. The weight is between the two. A window function spills the peak into the skirt: the segments are
therefore as long as they can be, and ordinates within the main lobe of zero frequency are left out. N soaks up what the
components cannot follow above the waves; the noise that the filter is given is taken from above the wave band instead.
"""

from __future__ import annotations

import itertools
from math import log, pi
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.sea_model import SeaModel

Array = NDArray[np.float64]

BAND_HZ: Final = (0.02, 0.8)
"""Where the likelihood is summed."""
BAND_OF_NYQUIST: Final = 0.7
"""A slow sensor's band ends at this share of its Nyquist frequency."""
MAIN_LOBE: Final = 2.6
"""Ordinates below this over the length of a segment are left out: Hann's main lobe reaches two bins."""
SEGMENT_S: Final = 300.0
"""Longest segment of the averaged periodogram: finer than that, the fit only becomes slower."""
NOISE_OVER_HZ: Final = 0.8
"""The sensor's noise is looked for above."""
NOISE_BANDS: Final = 4
"""In that many bands of equal ratio; the quietest counts, because an engine fills one of them, not all."""
WEIGHED_FROM_HZ: Final = 0.15
"""f_1: ordinates at this frequency have the weight 1."""
WEIGHT_POWER: Final = 0.7
"""0: each ordinate weighs the same; 1: each octave does."""
STEPS: Final = 25
GAIN_ENOUGH: Final = 1e-2
"""Fall of the likelihood in one step below which a start has converged: the data cannot tell such models apart."""
LONGEST_STEP: Final = 0.7
"""Of any logarithm."""
STARTS: Final = ((1.0, 1.6, 2.6, 0.7), (1.2, 0.5, 2.2, 1.7), (1.0, 1.2, 0.7, 2.0), (1.0, 1.13, 0.88, 1.3))
"""First frequencies of the components, over that of the velocity's peak; the second also tries a swell at 0.05 Hz."""
SWELL_HZ: Final = 0.05
LINE_DAMPING: Final = 0.07
"""Of the last start: a wave train is a few lines side by side."""
DAMPING_GUESS: Final = 0.3

LIMITS: Final = {"frequency_hz": (0.025, 0.6), "damping": (0.05, 1.0), "level": (1e-10, 1e5), "noise": (1e-12, 1e2)}
"""A chain that is damped less than that is a line, and costs digits; one that is damped more has a pole far above the
waves, and its past cannot be computed back."""
PRIOR: Final = {"frequency": 0.05, "damping": 0.2, "level": 1e-3, "noise": 1e-3}
"""Weights of weak priors on the logarithms, 1/variance: around the start, and around DAMPING_GUESS."""


class Spectrum(msgspec.Struct, frozen=True, eq=False):
    """Averaged periodogram of the vertical acceleration within the band, and the sensor's noise."""

    f_hz: Array
    """(n,)"""
    power: Array
    """(n,) one-sided, (m/s2)2/Hz"""
    noise_psd: float
    """one-sided, (m/s2)2/Hz"""

    @property
    def weight(self) -> Array:
        """(n,) of each ordinate in the likelihood."""
        return np.asarray((WEIGHED_FROM_HZ / self.f_hz) ** WEIGHT_POWER)


def spectrum(a_mps2: Array, rate_hz: float) -> Spectrum:
    """Of ``a_mps2`` (n,), evenly sampled; n of at least some tens of seconds."""
    n = min(len(a_mps2), round(SEGMENT_S * rate_hz))
    f, power = _welch(a_mps2, rate_hz, n)
    top = min(BAND_HZ[1], BAND_OF_NYQUIST * 0.5 * rate_hz)
    inside = (f >= max(BAND_HZ[0], MAIN_LOBE * rate_hz / n)) & (f <= top)
    edges = np.geomspace(min(NOISE_OVER_HZ, 0.6 * 0.5 * rate_hz), 0.9 * 0.5 * rate_hz, NOISE_BANDS + 1)
    bands = [power[(f >= low) & (f < high)] for low, high in itertools.pairwise(edges)]
    quiet = min(float(np.mean(band)) for band in bands if len(band))
    low, high = LIMITS["noise"]
    return Spectrum(f[inside], np.maximum(power[inside], 1e-300), min(max(quiet, low), high))


def _welch(a: Array, rate_hz: float, n: int) -> tuple[Array, Array]:
    """Averaged periodogram (Welch 1967) of segments of ``n`` samples that overlap by three quarters, each without its
    straight line and under Hann's window: frequencies and one-sided density.

    A straight line is taken out by two products, where scipy's solves a least-squares problem of every segment.
    """
    segments = np.lib.stride_tricks.sliding_window_view(a, n)[:: n - 3 * n // 4]
    slope = np.linspace(-1.0, 1.0, n)
    slope /= np.sqrt(slope @ slope)
    segments = segments - segments.mean(axis=1, keepdims=True)
    segments -= np.outer(segments @ slope, slope)
    window = 0.5 - 0.5 * np.cos(2.0 * pi * np.arange(n) / n)
    segments *= window
    power = np.mean(np.abs(np.fft.rfft(segments)) ** 2, axis=0) * (2.0 / (rate_hz * float(window @ window)))
    power[0] *= 0.5
    if n % 2 == 0:
        power[-1] *= 0.5  # Nyquist's frequency has no other side either.
    return np.fft.rfftfreq(n, 1.0 / rate_hz), power


class Fitted(msgspec.Struct, frozen=True):
    """A model, and how well it suits the spectrum that it was fitted to."""

    model: SeaModel
    cost: float
    """What was minimised: minus the weighted log-likelihood."""
    waves: float
    """How much likelier the spectrum is with waves than with noise alone: difference of the plain log-likelihoods."""


def fit(sp: Spectrum, stages: int, components: int, bias_walk_psd: float, warm: SeaModel | None = None) -> Fitted:
    """The most likely model of ``components`` chains of ``stages``; ``warm`` is an earlier one of the same size."""
    starts = _starts(sp, components, warm)
    theta, cost = _score(sp, starts, stages, bias_walk_psd)
    best = int(np.argmin(cost))
    values = np.exp(theta[best])
    parts = [tuple(values[i * components : (i + 1) * components].tolist()) for i in range(3)]
    model = SeaModel(
        stages=stages,
        frequency_hz=parts[0],
        damping=parts[1],
        level_m2phz=parts[2],
        noise_psd=sp.noise_psd,
        bias_walk_psd=bias_walk_psd,
    )
    log_S = _log_spectrum(theta[best : best + 1], sp.f_hz, stages, bias_walk_psd)[0][0]
    waves = _noise_cost(sp, bias_walk_psd) - float(np.sum(log_S + sp.power * np.exp(-log_S)))
    return Fitted(model, float(cost[best]), waves)


def measured_share(sp: Spectrum, model: SeaModel) -> float:
    """Variance of the heave that the periodogram shows, over that of ``model``: where waves stand out of the noise the
    periodogram counts, and the noise is left out as a Wiener filter would.

    The likelihood asks for the same relative fit everywhere and for no energy in particular, so that a model whose
    skirts are right may be a third too high at the peak: no matter to the filter, but not what people call the height
    of the sea.
    """
    waves = model.heave_spectrum(sp.f_hz)
    seen = waves * sp.power / model.acceleration_spectrum(sp.f_hz)
    whole = float(np.trapezoid(waves, sp.f_hz))
    return float(np.trapezoid(seen, sp.f_hz)) / whole if whole > 0.0 else 1.0


def _starts(sp: Spectrum, components: int, warm: SeaModel | None) -> Array:
    """Rows (s, 3K + 1) of logarithms: f0, zeta, L of each component, N."""
    f = sp.f_hz
    heave = sp.power / (2.0 * pi * f) ** 4
    peak = float(f[np.argmax(heave * f**2)])
    rows = []
    for ratios in STARTS:
        f0 = peak * np.resize(np.array(ratios), components)
        if ratios is STARTS[1] and components > 1:
            f0[1] = SWELL_HZ
        f0 = np.clip(f0, *LIMITS["frequency_hz"])
        level = np.clip(0.7 * np.interp(f0, f, heave), *LIMITS["level"])
        guess = LINE_DAMPING if ratios is STARTS[3] else DAMPING_GUESS
        rows.append(np.concatenate((np.log(f0), np.full(components, log(guess)), np.log(level))))
    if warm is not None and len(warm.damping) == components:
        rows.append(np.log(np.array((*warm.frequency_hz, *warm.damping, *warm.level_m2phz))))
    return np.column_stack((np.array(rows), np.full(len(rows), log(sp.noise_psd))))


def _score(sp: Spectrum, starts: Array, stages: int, bias_walk_psd: float) -> tuple[Array, Array]:
    """Fisher scoring with Levenberg's damping from each row of ``starts`` (s, p): their ends, and cost (s,)."""
    K = (starts.shape[1] - 1) // 3
    sizes = (K, K, K, 1)
    low, high = (np.log(np.repeat([limits[end] for limits in LIMITS.values()], sizes)) for end in (0, 1))
    prior = np.repeat(list(PRIOR.values()), sizes)
    theta = np.clip(starts, low, high)
    centre = theta.copy()
    centre[:, K : 2 * K] = log(DAMPING_GUESS)
    eye = np.eye(starts.shape[1])

    weight = sp.weight

    def cost_of(log_S: Array, at: Array) -> Array:
        whittle = (log_S + sp.power * np.exp(-log_S)) @ weight
        return np.asarray(whittle + 0.5 * np.sum(prior * (at - centre) ** 2, axis=1))

    log_S, J = _log_spectrum(theta, sp.f_hz, stages, bias_walk_psd)
    cost = cost_of(log_S, theta)
    damping = np.full(len(theta), 1e-2)
    for _ in range(STEPS):
        slope = np.matmul(J, (weight * (sp.power * np.exp(-log_S) - 1.0))[:, :, None])[:, :, 0]
        slope -= prior * (theta - centre)
        fisher = np.matmul(J * weight, J.transpose(0, 2, 1)) + prior * eye
        fisher += damping[:, None, None] * (fisher * eye)
        step = np.clip(np.linalg.solve(fisher, slope[:, :, None])[:, :, 0], -LONGEST_STEP, LONGEST_STEP)
        trial = np.clip(theta + step, low, high)
        trial_log_S, trial_J = _log_spectrum(trial, sp.f_hz, stages, bias_walk_psd)
        trial_cost = cost_of(trial_log_S, trial)
        better = trial_cost < cost
        gain = np.where(better, cost - trial_cost, 0.0)
        theta[better], log_S[better], J[better] = trial[better], trial_log_S[better], trial_J[better]
        cost = np.where(better, trial_cost, cost)
        damping = np.where(better, 0.3 * damping, 5.0 * damping)
        if np.all((gain < GAIN_ENOUGH) & (better | (damping > 1e3))):
            break
    return theta, cost


def _log_spectrum(theta: Array, f: Array, stages: int, bias_walk_psd: float) -> tuple[Array, Array]:
    """log S (s, n) of each row of theta (s, 3K + 1), and its slopes J (s, 3K + 1, n)."""
    K = (theta.shape[1] - 1) // 3
    x2 = (f / np.exp(theta[:, :K, None])) ** 2
    c = 4.0 * np.exp(2.0 * theta[:, K : 2 * K, None])
    D = (1.0 - x2) ** 2 + c * x2
    w2 = (2.0 * pi * f) ** 2
    log_chain = theta[:, 2 * K : 3 * K, None] + stages * (np.log(c) - np.log(D)) + 2 * (stages - 3) * np.log(x2)
    S_chain = np.exp(log_chain) * w2**2
    N = np.exp(theta[:, 3 * K :])
    S = S_chain.sum(axis=1) + N + 2.0 * bias_walk_psd / w2
    J = np.empty((*theta.shape, len(f)))
    share = S_chain / S[:, None, :]
    q = 2.0 * stages * c * x2 / D
    J[:, :K] = share * (q - 4.0 * (stages - 3) - 4.0 * stages * x2 * (1.0 - x2) / D)
    J[:, K : 2 * K] = share * (2.0 * stages - q)
    J[:, 2 * K : 3 * K] = share
    J[:, 3 * K] = N / S
    return np.log(S), J


def _noise_cost(sp: Spectrum, bias_walk_psd: float) -> float:
    """The cost of the best model without waves: white noise of any level, and the bias."""
    floor = 2.0 * bias_walk_psd / (2.0 * pi * sp.f_hz) ** 2
    levels = np.geomspace(max(float(np.min(sp.power)), 1e-12), float(np.max(sp.power)) + 1e-12, 60)
    S = levels[:, None] + floor
    return float(np.min(np.sum(np.log(S) + sp.power / S, axis=1)))
