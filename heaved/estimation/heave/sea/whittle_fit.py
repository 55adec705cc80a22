"""Fitting the sea model to the recent past: Whittle's likelihood of the spectrum of the vertical acceleration.

    minimise  sum_f  (log S(f) + P(f) / S(f)) (f_1 / f)^0.7,      S = w^4 sum_k S_k + V + N + 2 B / w^2,

over log f0, log zeta and log L of each component and log N, P being the periodogram and V what shakes the sensor
(:mod:`heaved.estimation.heave.sea.noise`). The ordinates of a periodogram are nearly independent exponential variables,
so Fisher scoring applies: each step is the weighted least-squares fit of P / S - 1 by the slopes of log S, and a
handful of steps do what a general minimiser needs hundreds of evaluations for.
All starts, of all spectra that are to be fitted, run side by side, all of them to the end (one that is behind three
others after eight steps may be better than they by far); the best of each spectrum is taken.

What the error of the heave lives on is the low-frequency skirt of the spectrum, four decades below its peak. It has a
dozen ordinates, and the tail above the peak has hundreds: were they weighed alike, a skirt that is far off would be
paid for by a slightly better tail; were every octave weighed alike, the tail would be left to chance, and with it the
forecasts of a second. The weight is between the two. A window function spills the peak into the skirt: the segments are
therefore as long as they can be, and ordinates within the main lobe of zero frequency are left out. N is the noise
above the waves, unless there is clearly more within their band; as long as it is not known what shakes the sensor, and
in a record that is bridged, N soaks up what the components cannot follow, and the filter is given the noise above.
"""

from __future__ import annotations

import itertools
from math import inf, log, pi
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.heave.sea.drift import TUNING as DRIFT
from heaved.estimation.heave.sea.drift import drift_variances, drift_weights
from heaved.estimation.heave.sea.model import Resonance, SeaModel, shaking_spectrum
from heaved.estimation.heave.sea.noise import Above, groups

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of the fit."""

    band_hz: tuple[float, float] = (0.02, 0.8)
    """Where the likelihood is summed."""
    band_of_nyquist: float = 0.7
    """A slow sensor's band ends at this share of its Nyquist frequency."""
    main_lobe: float = 2.6
    """Ordinates below this over the length of a segment are left out: Hann's main lobe reaches two bins."""
    segment_s: float = 300.0
    """Longest segment of the averaged periodogram: finer than that, the fit only becomes slower."""
    least_passed: float = 0.01
    """Share of white noise: where less of it is left nothing can be said of it."""
    highest_of_nyquist: float = 0.99
    """What shakes the sensor is looked for up to here."""
    independent: float = 1.9
    """Independent periodograms in a length of a segment: Hann's window, three quarters of overlap."""
    shortened: float = 0.6
    """Segments may be that much shorter than they could be, so that more stretches of a broken record hold one."""
    noise_over_hz: float = 0.8
    """The sensor's noise is looked for above."""
    noise_bands: int = 4
    """In that many bands of equal ratio; the quietest counts, because an engine fills one of them, not all."""
    floor_width: float = 1.4
    """Ratio of the frequencies of a band within that of the waves that is looked at for noise,"""
    floor_ordinates: int = 6
    """and how many ordinates it holds at least."""
    chance: float = 3.0
    """The noise is no more than the lowest part of the periodogram within the waves' band, which has so many standard
    deviations of chance: what shakes the sensor may fill all the bands above."""
    all_shaken: float = 0.3
    """Where that is less than this share of what the quietest of them has, they do."""
    least_of_mean: float = 0.2
    """Of the mean, what chance leaves of it at the least."""
    walk_below_hz: float = 0.035
    """The walk of the bias is looked for below: no wave that counts is longer."""
    drifts: float = 4.5
    """Standard deviations of a drift that is none of the walk."""
    walk_spreads: tuple[float, float] = (0.3, 2.5)
    """Of the logarithm of that variance, before anything is seen:"""
    walk_is_other: float = 0.02
    """the first of these, a data sheet's, but in one of fifty sensors the second: a fluctuation of a few ordinates
    changes little, a bias that does walk a hundred times more is believed."""
    independent_ordinates: float = 0.7
    """Of neighbouring ordinates, under Hann's window."""
    weighed_from_hz: float = 0.15
    """f_1: ordinates at this frequency have the weight 1."""
    weight_power: float = 0.7
    """0: each ordinate weighs the same; 1: each octave does."""
    steps: int = 25
    """Of Fisher scoring, all of which are made."""
    longest_step: float = 0.7
    """Of any logarithm. Longer steps find lower costs, in corners that the heave is worse for."""
    starts: tuple[tuple[float, ...], ...] = (
        (1.0, 1.6, 2.6, 0.7),
        (1.2, 0.5, 2.2, 1.7),
        (1.0, 1.2, 0.7, 2.0),
        (1.0, 1.13, 0.88, 1.3),
    )
    """First frequencies of the components, over that of the velocity's peak; the second also tries a swell."""
    swell_hz: float = 0.05
    """Where the swell of the second start is."""
    line_damping: float = 0.07
    """Of the last start: a wave train is a few lines side by side."""
    damping_guess: float = 0.3
    """Of the other starts, and the centre of its prior."""
    pooled: float = 0.03
    """Ordinates nearer together than this share of their frequency are pooled: the model is a straight line over
    that."""
    frequency_limits_hz: tuple[float, float] = (0.033, 0.6)
    damping_limits: tuple[float, float] = (0.05, 1.0)
    """A chain that is damped less than that is a line, and costs digits; one that is damped more has a pole far above
    the waves, and its past cannot be computed back."""
    level_limits_m2phz: tuple[float, float] = (1e-10, 1e5)
    noise_limits_psd: tuple[float, float] = (1e-12, 1e2)
    """(m/s2)2/Hz"""
    frequency_prior: float = 0.05
    """Weight of a weak prior on its logarithm, 1/variance, around the start;"""
    damping_prior: float = 0.2
    """around ``damping_guess``;"""
    level_prior: float = 1e-3
    """around the start, both"""
    noise_prior: float = 1e-3
    """and this."""
    noise_is_known: float = 20.0
    """That of the noise where what shakes the sensor is known: then N is what the record shows above the waves, unless
    there is clearly more within their band. Before, it soaks up what the components cannot follow there."""

    noise_is_bound: float = 2.0
    """The same where all above the waves is shaken: the waves' own band knows it better."""


TUNING: Final = Tuning()
WALKS: Final = np.linspace(-3.0, 10.0, 66)
"""Logarithms of the variances of a walk, over that which is expected, that are tried."""
WALK_PRIOR: Final = np.log(
    (1.0 - TUNING.walk_is_other) / TUNING.walk_spreads[0] * np.exp(-0.5 * (WALKS / TUNING.walk_spreads[0]) ** 2)
    + TUNING.walk_is_other / TUNING.walk_spreads[1] * np.exp(-0.5 * (WALKS / TUNING.walk_spreads[1]) ** 2)
)


class Spectrum(msgspec.Struct, frozen=True, eq=False):
    """Averaged periodogram of the vertical acceleration within the band, and what else the accelerometer shows."""

    f_hz: Array
    """(n,)"""
    power: Array
    """(n,) one-sided, (m/s2)2/Hz"""
    noise_psd: float
    """one-sided, (m/s2)2/Hz"""
    above: Above
    """The periodogram above the band."""
    resonances: tuple[Resonance, ...] = ()
    """What has been found there."""
    is_noise_known: bool = False
    """What shakes the sensor has been looked for, and nothing of the record is bridged."""
    is_noise_bound: bool = False
    """It is not seen above the waves, where all is shaken: ``noise_psd`` is no more than what it can be at most."""

    @property
    def weight(self) -> Array:
        """(n,) of each ordinate in the likelihood."""
        return np.asarray((TUNING.weighed_from_hz / self.f_hz) ** TUNING.weight_power)


def spectrum(
    stretches: Array | Sequence[Array], rate_hz: float, passed: Callable[[Array], Array] = np.ones_like
) -> Spectrum:
    """Of a record, or of several stretches of one, each (n,), evenly sampled; n of at least some tens of seconds.

    passed: share of white noise that is left at some frequencies, where what is sampled are means.
    """
    parts = [stretches] if isinstance(stretches, np.ndarray) else stretches
    n = _segment_length([len(part) for part in parts], round(TUNING.segment_s * rate_hz))
    f, power = _welch([part for part in parts if len(part) >= n], rate_hz, n)
    top = min(TUNING.band_hz[1], TUNING.band_of_nyquist * 0.5 * rate_hz)
    inside = (f >= max(TUNING.band_hz[0], TUNING.main_lobe * rate_hz / n)) & (f <= top)
    edges = np.geomspace(min(TUNING.noise_over_hz, 0.6 * 0.5 * rate_hz), 0.9 * 0.5 * rate_hz, TUNING.noise_bands + 1)
    white = np.concatenate(([1.0], np.maximum(passed(f[1:]), TUNING.least_passed)))
    bands = [(power / white)[(f >= low) & (f < high)] for low, high in itertools.pairwise(edges)]
    quiet = min(float(np.mean(band)) for band in bands if len(band))
    low, high = TUNING.noise_limits_psd
    outside = (f > top) & (f <= TUNING.highest_of_nyquist * 0.5 * rate_hz)
    averages = max(1.0, TUNING.independent * sum([len(part) for part in parts if len(part) >= n]) / n - 1.0)
    most = _floor(f[inside], power[inside], averages)
    above = Above(f[outside], np.maximum(power[outside], 1e-300), white[outside], averages, 1.0 / rate_hz)
    noise_psd = min(max(min(quiet, most), low), high)
    return Spectrum(
        f[inside], np.maximum(power[inside], 1e-300), noise_psd, above, is_noise_bound=most < TUNING.all_shaken * quiet
    )


def _floor(f: Array, power: Array, averages: float) -> float:
    """What white noise is hardly above: the least mean of the periodogram over a band within the waves', so far up that
    chance would not have put it below.
    """
    ends = np.maximum(np.searchsorted(f, f * TUNING.floor_width), np.arange(len(f)) + TUNING.floor_ordinates)
    starts = np.flatnonzero(ends < len(f))
    if not len(starts):
        return inf
    ends, sums = ends[starts], np.concatenate(([0.0], np.cumsum(power)))
    count = (ends - starts) * averages * TUNING.independent_ordinates
    # The cube root of a mean of exponential variables is normal (Wilson & Hilferty 1931).
    least = np.maximum(1.0 - 1.0 / (9.0 * count) - TUNING.chance / (3.0 * np.sqrt(count)), TUNING.least_of_mean) ** 3
    return float(np.min((sums[ends] - sums[starts]) / (ends - starts) / least))


def _segment_length(lengths: Sequence[int], longest: int) -> int:
    """Length of the segments, the longest that there can be, or somewhat less where more of the record is seen then."""
    most = min(max(lengths), longest)
    usable = {min(length, longest) for length in lengths if length >= TUNING.shortened * most}
    return max(usable, key=lambda n: (sum([length for length in lengths if length >= n]), n))


def _welch(stretches: Sequence[Array], rate_hz: float, n: int) -> tuple[Array, Array]:
    """Averaged periodogram (Welch 1967) of segments of ``n`` samples that overlap by three quarters, each without its
    straight line and under Hann's window: frequencies and one-sided density.

    A straight line is taken out by two products, where scipy's solves a least-squares problem of every segment.
    """
    segments = np.concatenate([
        np.lib.stride_tricks.sliding_window_view(a, n)[:: n - 3 * n // 4] for a in stretches
    ])  # fmt: skip
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
    return np.fft.rfftfreq(n, 1.0 / rate_hz).astype(np.float64), power.astype(np.float64)


def _pooled(sp: Spectrum) -> tuple[Spectrum, Array]:
    """Means of neighbouring ordinates, and the weight of each in the likelihood: the sum of theirs."""
    first, count = groups(sp.f_hz, TUNING.pooled)
    f, power = (np.add.reduceat(values, first) / count for values in (sp.f_hz, sp.power))
    return msgspec.structs.replace(sp, f_hz=f, power=power), np.add.reduceat(sp.weight, first)


class Fitted(msgspec.Struct, frozen=True):
    """A model, and how well it suits the spectrum that it was fitted to."""

    model: SeaModel
    cost: float
    """What was minimised: minus the weighted log-likelihood."""
    waves: float
    """How much likelier the spectrum is with waves than with noise alone: difference of the plain log-likelihoods."""


def fit(
    spectra: Sequence[Spectrum],
    stages: int,
    components: int,
    bias_walk_psd: float,
    warm: Sequence[SeaModel | None] | None = None,
) -> list[Fitted]:
    """The most likely model of ``components`` chains of ``stages`` for each spectrum; ``warm``: an earlier one of each,
    used when it is of the same size.
    """
    earlier = warm if warm is not None else [None] * len(spectra)
    starts = [_starts(sp, components, model) for sp, model in zip(spectra, earlier, strict=True)]
    rows = np.repeat(np.arange(len(spectra)), [len(part) for part in starts])
    theta, cost = _score(_Whittle([_pooled(sp) for sp in spectra], rows, stages, bias_walk_psd), np.concatenate(starts))
    best = [int(np.argmin(np.where(rows == i, cost, np.inf))) for i in range(len(spectra))]
    return [
        _fitted(sp, theta[row], float(cost[row]), stages, bias_walk_psd) for sp, row in zip(spectra, best, strict=True)
    ]


def _fitted(sp: Spectrum, theta: Array, cost: float, stages: int, bias_walk_psd: float) -> Fitted:
    """The model of the logarithms ``theta`` (3K + 1,)."""
    K = (len(theta) - 1) // 3
    values = np.exp(theta)
    parts = [tuple(values[i * K : (i + 1) * K].tolist()) for i in range(3)]
    model = SeaModel(
        stages=stages,
        frequency_hz=parts[0],
        damping=parts[1],
        level_m2phz=parts[2],
        noise_psd=float(values[-1]),
        bias_walk_psd=bias_walk_psd,
        resonances=sp.resonances,
    )
    S = model.acceleration_spectrum(sp.f_hz, sp.above.dt_s)
    waves = _noise_cost(sp, bias_walk_psd) - float(np.sum(np.log(S) + sp.power / S))
    if not sp.is_noise_known:
        model = msgspec.structs.replace(model, noise_psd=sp.noise_psd)
    return Fitted(model, cost, waves)


def bias_walk(
    stretch: Array, rate_hz: float, model: SeaModel, expected_psd: float, recent: Sequence[SeaModel] = ()
) -> float:
    """The walk of the bias, (m/s2)2/s, that ``stretch`` (n,) shows below the waves of ``model``: the likeliest one,
    where ``expected_psd`` is what its data sheet says. A straight drift is not in the periodogram, and may have begun a
    moment ago: it is looked for by itself, beside the waves of ``model`` or of any of the ``recent`` past, if those are
    larger: so may a swell.
    """
    levels = expected_psd * np.exp(WALKS)
    quiet = msgspec.structs.replace(model, bias_walk_psd=0.0)
    cost = -WALK_PRIOR
    f, power = _welch([stretch], rate_hz, len(stretch))
    inside = (f >= TUNING.main_lobe * rate_hz / len(stretch)) & (f <= TUNING.walk_below_hz)
    if inside.any():
        f, power = f[inside], power[inside]
        S = quiet.acceleration_spectrum(f, 1.0 / rate_hz) + levels[:, None] * (2.0 / (2.0 * pi * f) ** 2)
        cost = cost + TUNING.independent_ordinates * np.sum(np.log(S) + power / S, axis=1)
    walked = float(levels[np.argmin(cost)])
    for seconds in DRIFT.drifts_s:
        weights = drift_weights(round(seconds * rate_hz))
        if len(weights) > len(stretch):
            break
        rests, walks = zip(*(drift_variances(weights, 1.0 / rate_hz, m) for m in (model, *recent)), strict=True)
        rest, walk = max(rests), walks[0]
        square = float(weights @ stretch[-len(weights) :]) ** 2
        if square > TUNING.drifts**2 * (rest + walked * walk):
            walked = (square - rest) / walk
    return walked


def measured_share(sp: Spectrum, model: SeaModel) -> float:
    """Variance of the heave that the periodogram shows, over that of ``model``: where waves stand out of the noise the
    periodogram counts, and the noise is left out as a Wiener filter would.

    The likelihood asks for the same relative fit everywhere and for no energy in particular, so that a model whose
    skirts are right may be a third too high at the peak: no matter to the filter, but not what people call the height
    of the sea.
    """
    waves = model.wave_spectrum(sp.f_hz)
    seen = waves * sp.power / model.acceleration_spectrum(sp.f_hz, sp.above.dt_s)
    whole = float(np.trapezoid(waves, sp.f_hz))
    return float(np.trapezoid(seen, sp.f_hz)) / whole if whole > 0.0 else 1.0


def _starts(sp: Spectrum, components: int, warm: SeaModel | None) -> Array:
    """Rows (s, 3K + 1) of logarithms: f0, zeta, L of each component, N."""
    f = sp.f_hz
    heave = sp.power / (2.0 * pi * f) ** 4
    peak = float(f[np.argmax(heave * f**2)])
    rows = []
    for ratios in TUNING.starts:
        f0 = peak * np.resize(np.array(ratios), components)
        if ratios is TUNING.starts[1] and components > 1:
            f0[1] = TUNING.swell_hz
        f0 = np.clip(f0, *TUNING.frequency_limits_hz)
        level = np.clip(0.7 * np.interp(f0, f, heave), *TUNING.level_limits_m2phz)
        guess = TUNING.line_damping if ratios is TUNING.starts[3] else TUNING.damping_guess
        rows.append(np.concatenate((np.log(f0), np.full(components, log(guess)), np.log(level))))
    if warm is not None and len(warm.damping) == components:
        rows.append(np.log(np.array((*warm.frequency_hz, *warm.damping, *warm.level_m2phz))))
    return np.column_stack((np.array(rows), np.full(len(rows), log(sp.noise_psd))))


class _Whittle:
    """The likelihood of spectra, for many models at once: ``theta`` (s, 3K + 1) as :func:`_starts` has it.

    Attributes:
        prior_noise: (s,) weight of the prior of each model's noise.
        power, weight: (s, n) ordinates that each model is held against; of a shorter spectrum the rest weighs nothing.
    """

    def __init__(
        self, spectra: Sequence[tuple[Spectrum, Array]], rows: NDArray[np.intp], stages: int, bias_walk_psd: float
    ) -> None:
        """``spectra``: with the weights of their ordinates. ``rows`` (s,): which of them each model is for."""
        longest = max(len(weight) for _, weight in spectra)
        padded = [
            np.array([np.pad(values, (0, longest - len(values)), constant_values=rest) for values in columns])[rows]
            for columns, rest in (
                ([sp.f_hz for sp, _ in spectra], 1.0),
                ([sp.power for sp, _ in spectra], 1.0),
                ([weight for _, weight in spectra], 0.0),
                ([_shaking(sp) for sp, _ in spectra], 0.0),
            )
        ]
        f, self.power, self.weight, shaking = padded
        known = np.array([sp.is_noise_known for sp, _ in spectra])[rows]
        bound = np.array([sp.is_noise_bound for sp, _ in spectra])[rows]
        self.prior_noise = np.where(
            known, np.where(bound, TUNING.noise_is_bound, TUNING.noise_is_known), TUNING.noise_prior
        )
        self._stages = stages
        self._f2 = f[:, None, :] ** 2
        w2 = (2.0 * pi * f) ** 2
        self._high_pass = w2[:, None, :] ** 2 * self._f2 ** (2 * (stages - 3))
        self._rest = 2.0 * bias_walk_psd / w2 + shaking

    def spectrum(self, theta: Array) -> tuple[Array, Array]:
        """S (s, n) of each model, and the slopes J (s, 3K + 1, n) of log S."""
        M, K = self._stages, (theta.shape[1] - 1) // 3
        log_f0, log_zeta, log_level = (theta[:, i * K : (i + 1) * K, None] for i in range(3))
        c = 4.0 * np.exp(2.0 * log_zeta)
        scale = np.exp(log_level - 4.0 * (M - 3) * log_f0) * c**M
        x2 = self._f2 * np.exp(-2.0 * log_f0)
        resonance = 1.0 / ((1.0 - x2) ** 2 + c * x2)
        chains = self._high_pass * scale * _power(resonance, M)
        N = np.exp(theta[:, 3 * K :])
        S = chains.sum(axis=1) + (N + self._rest)
        J = np.empty((*theta.shape, S.shape[1]))
        share = np.divide(chains, S[:, None, :], out=J[:, 2 * K : 3 * K])
        x2_resonance = x2 * resonance
        J[:, :K] = share * (x2_resonance * (4.0 * M * x2 + (2.0 * M * c - 4.0 * M)) - 4.0 * (M - 3))
        J[:, K : 2 * K] = share * (2.0 * M - 2.0 * M * c * x2_resonance)
        J[:, 3 * K] = N / S
        return S, J


def _shaking(sp: Spectrum) -> Array:
    return shaking_spectrum(sp.resonances, sp.f_hz, sp.above.dt_s)


def _power(base: Array, exponent: int) -> Array:
    """By squaring: an order faster than the general power."""
    result = base if exponent & 1 else None
    while exponent := exponent >> 1:
        base = base * base
        if exponent & 1:
            result = base if result is None else result * base
    return np.ones_like(base) if result is None else result


def _score(whittle: _Whittle, starts: Array) -> tuple[Array, Array]:
    """Fisher scoring with Levenberg's damping from each row of ``starts`` (s, p): their ends, and cost (s,)."""
    K = (starts.shape[1] - 1) // 3
    sizes = (K, K, K, 1)
    limits = (TUNING.frequency_limits_hz, TUNING.damping_limits, TUNING.level_limits_m2phz, TUNING.noise_limits_psd)
    low, high = (np.log(np.repeat([pair[end] for pair in limits], sizes)) for end in (0, 1))
    priors = (TUNING.frequency_prior, TUNING.damping_prior, TUNING.level_prior, TUNING.noise_prior)
    prior = np.tile(np.repeat(priors, sizes), (len(starts), 1))
    prior[:, -1] = whittle.prior_noise
    theta = np.clip(starts, low, high)
    centre = theta.copy()
    centre[:, K : 2 * K] = log(TUNING.damping_guess)
    eye = np.eye(starts.shape[1])

    def costs(S: Array, ratio: Array, at: Array) -> Array:
        told = np.sum((np.log(S) + ratio) * whittle.weight, axis=1)
        return np.asarray(told + 0.5 * np.sum((at - centre) ** 2 * prior, axis=1))

    S, J = whittle.spectrum(theta)
    ratio = whittle.power / S
    cost = costs(S, ratio, theta)
    damping = np.full(len(theta), 1e-2)
    for _ in range(TUNING.steps):
        JW = J * whittle.weight[:, None, :]
        slope = np.matmul(JW, (ratio - 1.0)[:, :, None])[:, :, 0] - prior * (theta - centre)
        fisher = np.matmul(JW, J.transpose(0, 2, 1)) + prior[:, :, None] * eye
        fisher += damping[:, None, None] * (fisher * eye)
        step = np.clip(np.linalg.solve(fisher, slope[:, :, None])[:, :, 0], -TUNING.longest_step, TUNING.longest_step)
        trial = np.clip(theta + step, low, high)
        S, trial_J = whittle.spectrum(trial)
        trial_ratio = whittle.power / S
        trial_cost = costs(S, trial_ratio, trial)
        better = trial_cost < cost
        theta[better], J[better], ratio[better] = trial[better], trial_J[better], trial_ratio[better]
        cost = np.where(better, trial_cost, cost)
        damping *= np.where(better, 0.3, 5.0)
    return theta, cost


def _noise_cost(sp: Spectrum, bias_walk_psd: float) -> float:
    """The cost of the best model without waves: white noise of any level, and the bias."""
    floor = 2.0 * bias_walk_psd / (2.0 * pi * sp.f_hz) ** 2 + _shaking(sp)
    levels = np.geomspace(max(float(np.min(sp.power)), 1e-12), float(np.max(sp.power)) + 1e-12, 60)
    S = levels[:, None] + floor
    return float(np.min(np.sum(np.log(S) + sp.power / S, axis=1)))
