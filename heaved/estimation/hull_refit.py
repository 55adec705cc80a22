"""Going through a record of two rate streams: the step of the filter, its start, the refit with a second pass.

Everything here is a pure function of a record, so that what takes long can be computed elsewhere and accepted later.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import isnan
from typing import Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.hull_euler import EulerFilter
from heaved.estimation.hull_markov import Flexure, fit
from heaved.estimation.hull_so3 import Noise, So3Filter
from heaved.estimation.hull_start import WINDOW, Alignment, align, motion_polynomial
from heaved.estimation.rotations import to_euler

Array = NDArray[np.float64]
Filter = So3Filter | EulerFilter
Method = Literal["so3", "ckf", "ukf"]

CENTRE: Final = WINDOW // 2
"""A row is filtered when it has this many neighbours on either side."""
LONGEST_STEP: Final = 2.5
"""Sampling intervals between neighbours above which no polynomial is laid through them."""
ITERATED_S: Final = 30.0
"""Each update is iterated twice, and psi folded into C0, for so long."""

FEWEST: Final = 6
USABLE: Final = 0.3
"""Readings, and share of the record, that an alignment needs: an IMU of half the rate leaves not quite a half."""
ONE_AXIS: Final = 0.02
"""Second over largest eigenvalue of the motion's mean square below which it is about one axis."""


def make_filter(method: Method, C0: Array, delay_s: float, flexure: Flexure, noise: Noise) -> Filter:
    if method == "so3":
        return So3Filter(C0, delay_s, flexure, noise)
    return EulerFilter(method, to_euler(C0), flexure, noise)


def polynomial_at(rows: Array, rate_hz: float) -> Array | None:
    """Midships rates about the middle of five rows, or None (``motion_polynomial``)."""
    return motion_polynomial(rows, LONGEST_STEP / rate_hz)


def advance(filter: Filter, dt_s: float, motion: Array | None, local_radps: Array, age_s: float) -> float | None:
    """One step: time, then the local reading. Its normalised innovation squared; None: there was no usable reading.

    ``age_s``: since the filter began. nan: it has broken down.
    """
    if dt_s > 0.0:
        filter.predict(dt_s)
    if motion is None or not np.isfinite(local_radps).all():
        return None
    filter.iterations = 2 if age_s < ITERATED_S else 1
    nis = filter.update(motion, local_radps)
    filter.fold(always=age_s < ITERATED_S)
    return nis


def centres(rows: Array, rate_hz: float) -> Iterator[tuple[float, Array | None, Array]]:
    """(time, motion, local rates) of every row (n, 7) that has its neighbours: t, midships, local."""
    for i in range(CENTRE, len(rows) - CENTRE):
        window = rows[i - CENTRE : i + CENTRE + 1]
        yield float(rows[i, 0]), polynomial_at(window, rate_hz), rows[i, 4:]


def run(filter: Filter, rows: Array, rate_hz: float, began_s: float, filtered_s: float) -> bool:
    """Take a filter that stands at ``filtered_s`` through the rows after it; False: it has broken down."""
    for t, motion, local in centres(rows, rate_hz):
        if t <= filtered_s:
            continue
        nis = advance(filter, t - max(filtered_s, began_s), motion, local, t - began_s)
        if nis is not None and isnan(nis):
            return False
        filtered_s = t
    return True


def align_record(rows: Array, rate_hz: float, longest_delay_s: float) -> Alignment | None:
    """Alignment of a record (n, 7); None: too little of it is usable."""
    usable = [
        (motion, local)
        for _, motion, local in centres(rows, rate_hz)
        if motion is not None and np.isfinite(local).all()
    ]
    if len(usable) < max(FEWEST, USABLE * len(rows)):
        return None
    motions, local_rates = (np.array(column) for column in zip(*usable, strict=True))
    return align(motions, local_rates, longest_delay_s)


def about_two_axes(rows: Array) -> bool:
    """The midships motion of a record (n, 7) alone would do for an alignment."""
    rates = rows[np.isfinite(rows).all(axis=1), 1:4]
    spread = np.linalg.eigvalsh(rates.T @ rates) if len(rates) else np.zeros(3)
    return bool(spread[1] > ONE_AXIS * spread[2] > 0.0)


def start(
    method: Method, found: Alignment, rows: Array, rate_hz: float, flexure: Flexure, noise: Noise, passes: int
) -> Filter | None:
    """A filter that has gone through the record from an alignment, each pass about the last one. None: in vain."""
    C0, delay = found.C, found.delay_s
    for _ in range(passes):
        filter = make_filter(method, C0, delay, flexure, noise)
        if not run(filter, rows, rate_hz, float(rows[CENTRE, 0]), -np.inf):
            return None
        C0, delay = filter.static, filter.delay_s
    return filter


class RefitJob(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """All that a refit needs, copied: it may be computed anywhere."""

    rows: Array
    """(n, 7): t, midships rates, local rates; nan where missing. Contiguous."""
    rate_hz: float
    method: Method
    filter: Filter
    """As it stands at the last row."""
    whole: bool
    """The record reaches back to where the filter began: it can be gone through again."""
    prior: Flexure
    least_noise_radps: float
    generation: int
    """Of the estimator: counts its resets."""


class RefitResult(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """The flexure, the noise, and the filter that went through the record with them."""

    flexure: Flexure
    noise_radps: Array
    filter: Filter | None
    """None: only the parameters are new."""
    filtered_s: float
    """Where that filter stands."""
    generation: int


def refit(job: RefitJob) -> RefitResult | None:
    """Fit the flexure to the residual rates of a record, then filter the record again from its start.

    The filter's first pass knew the flexure only broadly; its estimates are good enough to leave residual rates that
    are flexure and noise, and the second pass weighs the motion as the flexure at hand allows. None: in vain.
    """
    residuals = [
        job.filter.residual(motion, local) if motion is not None else np.full(3, np.nan)
        for _, motion, local in centres(job.rows, job.rate_hz)
    ]
    rates = np.array(residuals)
    if not len(rates) or np.isfinite(rates).all(axis=1).mean() < 0.8:
        return None
    rates = rates - np.nanmean(rates, axis=0)
    before = job.filter.noise.sample_radps
    found = fit(np.nan_to_num(rates), job.rate_hz, job.prior, float(np.min(before)))
    if not all(np.isfinite(a).all() for a in (found.noise_radps, *_arrays(found.flexure))):
        return None
    sample = np.maximum(found.noise_radps, job.least_noise_radps)
    filter = None
    end = float(job.rows[-1 - CENTRE, 0])
    if job.whole:
        noise = msgspec.structs.replace(job.filter.noise, sample_radps=sample)
        filter = make_filter(job.method, job.filter.static, job.filter.delay_s, found.flexure, noise)
        if not run(filter, job.rows, job.rate_hz, float(job.rows[CENTRE, 0]), -np.inf):
            return None
    return RefitResult(
        flexure=found.flexure, noise_radps=sample, filter=filter, filtered_s=end, generation=job.generation
    )


def _arrays(flexure: Flexure) -> tuple[Array, Array, Array]:
    return flexure.std_rad, flexure.mu_radps, flexure.lambda_radps
