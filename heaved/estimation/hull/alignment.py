"""The start of the hull-deformation filter: alignment of two rate streams, with the delay between them.

Source: the orthogonal Procrustes problem (Kabsch 1976; Wahba 1965): the rotation C that makes sum |z2 - C w1|^2 least
comes from the singular value decomposition of sum z2 w1'. It needs motion about two axes; how well it is determined
follows from the residual, and that decides whether the record is long enough. The delay is searched before it: 50 ms at
a wave period of 8 s put a twentieth of the motion into the residual.
"""

from __future__ import annotations

from math import inf, sqrt

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.hull.tuning import TUNING

Array = NDArray[np.float64]


class Alignment(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """What two rate streams say of the rotation between them."""

    C: Array
    """(3, 3) local from midships."""
    delay_s: float
    std_rad: float
    """Of the worst direction; inf when the motion does not determine the rotation."""
    misfit: float
    """RMS residual over the RMS of the motion."""
    noise_radps: Array
    """(3,) white part of the residual, in hull axes."""


def align(motions: Array, local: Array, rate_hz: float, longest_delay_s: float) -> Alignment:
    """Rotation and delay from polynomials (n, 5, 3) of the midships rate and local rates (n, 3) at the same stamps.

    ``rate_hz``: of these. ``longest_delay_s`` bounds the search; 0: no search.
    """
    delay = 0.0
    if longest_delay_s > 0.0:
        tried = np.linspace(-longest_delay_s, longest_delay_s, 33)
        while tried[1] - tried[0] > 1e-4:
            misfits = [_rotation(_rates(motions, d), local)[1] for d in tried.tolist()]
            delay = float(tried[int(np.argmin(misfits))])
            step = float(tried[1] - tried[0])
            tried = np.clip(np.linspace(delay - step, delay + step, 9), -longest_delay_s, longest_delay_s)
    rates = _rates(motions, delay)
    C, square = _rotation(rates, local)
    residual = local @ C - rates
    # Information about a rotation d: sum [w x]'[w x] = sum |w|^2 1 - w w'.
    moment = rates.T @ rates
    information = np.linalg.eigvalsh(np.trace(moment) * np.eye(3) - moment)
    power = float(np.trace(moment))
    variance = square / (3.0 * len(local)) * max(1.0, TUNING.correlated_s * rate_hz)
    bends = np.diff(residual, 2, axis=0)
    return Alignment(
        C=C,
        delay_s=delay,
        std_rad=sqrt(variance / float(information[0])) if information[0] > 1e-9 * power > 0.0 else inf,
        misfit=sqrt(square / power) if power > 0.0 else inf,
        # The second difference of white noise has six times its variance, and little of anything slower.
        noise_radps=np.sqrt(np.mean(bends**2, axis=0) / 6.0),
    )


def _rates(motions: Array, delay_s: float) -> Array:
    return np.asarray(np.tensordot((-delay_s) ** np.arange(motions.shape[1]), motions, axes=(0, 1)))


def _rotation(rates: Array, local: Array) -> tuple[Array, float]:
    """The best proper rotation (3, 3) and the sum of squares that it leaves."""
    U, _, Vt = np.linalg.svd(local.T @ rates)
    C = (U * np.array([1.0, 1.0, np.linalg.det(U @ Vt)])) @ Vt
    residual = local - rates @ C.T
    return C, float(np.vdot(residual, residual))
