"""How two measurements of one motion agree: difference at equal times; correlation, delay and scale. Pure.

Delay: the greatest correlation of the reference with ours moved by up to a second either way (Bendat and Piersol,
*Random Data*, section 5.1.4, normalised by the parts that overlap), with a parabola through the three greatest. Where
the reference counts the other way it is negative, and so is the scale, the regression of the reference on ours.
"""

from __future__ import annotations

from math import inf, nan
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S: Final = 0.2
"""Of our series: the shortest waves have ten steps, and a parabola tells the delay to some milliseconds."""
LAGS: Final = 6
"""Steps either way: a second, and one more for the parabola."""
OPPOSED: Final = 0.9
"""A negative correlation counts where no positive one is as great as that share of it: half a short wave away there is
always one of the other sign."""
LEAST: Final = 20
"""Pairs; of fewer nothing is said."""
STILL: Final = 1e-9
"""Share of the greatest value below which a variation is rounding."""


class Agreement(msgspec.Struct, frozen=True):
    """Of a reference and ours; nan: not known."""

    pairs: int = 0
    mean: float = nan
    """Reference minus ours."""
    std: float = nan
    rms: float = nan
    reference_std: float = nan
    own_std: float = nan
    correlation: float = nan
    delay_s: float = nan
    """Of the reference; nan, too, when they agree best more than a second apart."""
    scale: float = nan
    """Reference over ours."""


def agree(reference: Array, own: Array, moved: Array) -> Agreement:
    """Compare the reference (n,) with ours (n,) at its times, and with ours ``moved`` (2 LAGS + 1, n), at its times
    plus -LAGS to LAGS times STEP_S. nan: missing.
    """
    there = np.isfinite(reference) & np.isfinite(own)
    pairs = int(np.count_nonzero(there))
    if pairs < LEAST:
        return Agreement(pairs=pairs)
    r, o = reference[there], own[there]
    difference = r - o
    found = Agreement(
        pairs=pairs,
        mean=float(np.mean(difference)),
        std=float(np.std(difference)),
        rms=float(np.sqrt(np.mean(difference**2))),
        reference_std=_spread(r),
        own_std=_spread(o),
    )
    if found.reference_std == 0.0 or found.own_std == 0.0:
        return found
    correlation, scale = _correlations(reference - np.mean(r), moved - np.mean(o))
    if not np.any(np.isfinite(correlation)):
        return found
    sign = 1.0 if np.nanmax(correlation) > -OPPOSED * np.nanmin(correlation) else -1.0
    best = int(np.nanargmax(sign * correlation))
    shift = _peak(sign * correlation, best)
    return msgspec.structs.replace(
        found,
        correlation=float(correlation[best]),
        scale=float(scale[best]),
        delay_s=nan if shift is None else -STEP_S * (shift - LAGS),
    )


def _spread(values: Array) -> float:
    """Standard deviation; 0 where that is rounding."""
    spread = float(np.std(values))
    return spread if spread > STILL * float(np.max(np.abs(values))) else 0.0


def _correlations(reference: Array, moved: Array) -> tuple[Array, Array]:
    """Correlation and regression (lags,) of the reference (n,) with each of ``moved`` (lags, n)."""
    there = np.isfinite(reference) & np.isfinite(moved)
    n = np.maximum(np.count_nonzero(there, axis=1), 1)
    r, o = np.where(there, reference, 0.0), np.where(there, moved, 0.0)
    mean_r, mean_o = r.sum(axis=1) / n, o.sum(axis=1) / n
    var_r = np.einsum("ij,ij->i", r, r) / n - mean_r**2
    var_o = np.einsum("ij,ij->i", o, o) / n - mean_o**2
    covariance = np.einsum("ij,ij->i", r, o) / n - mean_r * mean_o
    with np.errstate(divide="ignore", invalid="ignore"):
        enough = (n >= LEAST) & (var_r > 0.0) & (var_o > 0.0)
        return np.where(enough, covariance / np.sqrt(var_r * var_o), nan), np.where(enough, covariance / var_o, nan)


def _peak(values: Array, best: int) -> float | None:
    """Where the peak about the greatest value lies, in steps; None: at the edge, so it may lie beyond."""
    if not 0 < best < len(values) - 1:
        return None
    before, at, after = map(float, values[best - 1 : best + 2])
    bend = before - 2.0 * at + after
    return best + 0.5 * (before - after) / bend if -inf < bend < 0.0 else None
