"""Holes in a record bridged by what the samples on both sides, and a model of the sea, say of them.

A spectrum cannot be had of a record with holes: whatever stands in them has power at low frequencies, four decades
above the skirt of the waves that the error of the heave depends on. What is likeliest there is the conditional mean of
the missing samples, given all the others and the covariance. For an autoregression, x_k = sum a_i x_{k-i} + e_k, that
is the solution of a banded system of equations: sum e_k^2 is least (Janssen, Veldhuis & Vries 1986). The autoregression
is that of the model's own covariance (Yule 1927, Walker 1931).

The mean alone is too calm: the waves would swell and fall with the holes, and each of them stand in the spectrum as
two more, a hole's frequency above and below. So what the mean leaves open is drawn as well (Hoffman & Ribak 1991): a
record of the autoregression itself, less what bridging makes of it. Then the whole has the covariance of the model.
"""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz, solveh_banded
from scipy.linalg.lapack import dtbtrs

if TYPE_CHECKING:
    from heaved.estimation.heave.sea.model import SeaModel

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of the bridges across holes."""

    memory_s: float = 5.0
    """Order of the autoregression, in seconds: what is further away says little of a hole that is bridged."""
    longest_s: float = 5.0
    """A longer hole is not bridged: in its middle nothing is known, and a spectrum would show it as a calm."""
    settled: int = 10
    """Lengths of the autoregression after which a record that begins with nothing is like any other part of it."""
    lowest_hz: float = 1.0 / 400.0
    """The covariance is summed from here: slower parts of the bias are a constant to a hole."""


TUNING: Final = Tuning()


def closed(is_known: NDArray[np.bool_], dt_s: float, longest_s: float = TUNING.longest_s) -> NDArray[np.bool_]:
    """What is known (n,) of an even record once its holes of up to ``longest_s`` between two samples are bridged."""
    found = is_known.copy()
    for first, end in np.flatnonzero(np.diff(is_known.astype(np.int8), prepend=1, append=1)).reshape(-1, 2).tolist():
        found[first:end] |= (end - first) * dt_s <= longest_s and first > 0 and end < len(is_known)
    return found


def bridged(
    a: Array,
    is_known: NDArray[np.bool_],
    dt_s: float,
    model: SeaModel,
    rng: np.random.Generator | None,
    longest_s: float = TUNING.longest_s,
) -> tuple[Array, NDArray[np.bool_]]:
    """``a`` (n,), evenly sampled, with its holes filled as far as they are bridged, and what is known then (n,).

    rng: draws what the conditional mean leaves open; None: the mean alone. longest_s: of the holes that are bridged.

    Raises:
        LinAlgError: the covariance of the model is too near to a pure line for a solution.
    """
    bridged_too = closed(is_known, dt_s, longest_s)
    if bool(np.all(bridged_too == is_known)):
        return a, is_known
    weights, std = _whitening(model, dt_s)
    places = np.flatnonzero(~is_known)
    level = float(np.mean(a[is_known]))
    there = [np.where(is_known, a - level, 0.0)]
    if rng is not None:
        drawn = _autoregression(weights, std * rng.standard_normal(len(a) + TUNING.settled * len(weights)))[-len(a) :]
        there.append(np.where(is_known, drawn, 0.0))
    # The products of the whitening filter with itself, by distance; beyond its length they are zero.
    products = np.append(np.correlate(weights, weights, mode="full")[len(weights) - 1 :], 0.0)
    bands = np.zeros((len(weights), len(places)))
    for ahead in range(min(len(weights), len(places))):
        distance = np.minimum(places[ahead:] - places[: len(places) - ahead], len(weights))
        bands[ahead, : len(places) - ahead] = products[distance]
    slopes = [np.correlate(np.convolve(x, weights), weights, mode="valid")[places] for x in there]
    means = -solveh_banded(bands, np.column_stack(slopes), lower=True)
    found = level + means[:, 0]
    if rng is not None:
        found += drawn[places] - means[:, 1]
    filled = a.copy()
    filled[places] = found
    return np.where(bridged_too, filled, a), bridged_too


def _autoregression(weights: Array, noise: Array) -> Array:
    """What the whitening filter makes ``noise`` (n,) of. (By a banded solution: scipy.signal would cost 24 MB.)"""
    made, _ = dtbtrs(np.repeat(weights[:, None], len(noise), axis=1), noise[:, None], uplo="L")
    return np.asarray(made[:, 0])


def _whitening(model: SeaModel, dt_s: float) -> tuple[Array, float]:
    """(p + 1,) filter that leaves white noise of samples every ``dt_s``, 1, -a_1 ... -a_p, and the std of that."""
    count = 1 << int(np.ceil(np.log2(1.0 / (TUNING.lowest_hz * dt_s))))
    f: Array = np.fft.rfftfreq(count, dt_s)[1:].astype(np.float64)
    covariance = np.fft.irfft(np.append(0.0, model.acceleration_spectrum(f, dt_s))) / (2.0 * dt_s)
    order = max(8, round(TUNING.memory_s / dt_s))
    a = solve_toeplitz(covariance[:order], covariance[1 : order + 1])
    variance = float(covariance[0] - a @ covariance[1 : order + 1])
    return np.append(1.0, -a), sqrt(max(variance, 0.0))
