"""Going through a record of two rate streams: the step of the filter, its start, the refit with a second pass.

Everything here is a pure function of a record, so that what takes long can be computed elsewhere and accepted later.
"""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.rotations import to_euler
from heaved.estimation.hull.alignment import Alignment, align
from heaved.estimation.hull.estimate import Method
from heaved.estimation.hull.euler import EulerFilter
from heaved.estimation.hull.markov import Flexure, fit
from heaved.estimation.hull.slow_motion import SlowPair, SlowReading
from heaved.estimation.hull.so3 import Noise, So3Filter
from heaved.estimation.hull.tuning import TUNING

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = NDArray[np.float64]
Filter = So3Filter | EulerFilter


def make_filter(method: Method, C0: Array, delay_s: float, flexure: Flexure, noise: Noise) -> Filter:
    """The filter of a method, from a static deformation C0 (3, 3)."""
    if method == Method.SO3:
        return So3Filter(C0, delay_s, flexure, noise)
    return EulerFilter(method, to_euler(C0), flexure, noise)


def advance(filter: Filter, dt_s: float, reading: SlowReading, age_s: float) -> float | None:
    """One step: time, then the local reading. Its normalised innovation squared; None: there was no usable reading.

    ``age_s``: since the filter began. nan: it has broken down.
    """
    if dt_s > 0.0:
        filter.predict(dt_s)
    _, midships, local = reading
    if midships is None or local is None:
        return None
    filter.iterations = 2 if age_s < TUNING.iterated_s else 1
    variance = filter.variance(midships.variance, local.variance)
    nis = filter.update(midships.motion, local.motion[0], variance)
    filter.fold(always=age_s < TUNING.iterated_s)
    return nis


def run(filter: Filter, record: Sequence[SlowReading], began_s: float, filtered_s: float) -> bool:
    """Take a filter that stands at ``filtered_s`` through the readings after it; False: it has broken down."""
    for reading in record:
        t = reading[0]
        if t <= filtered_s:
            continue
        nis = advance(filter, t - max(filtered_s, began_s), reading, t - began_s)
        if nis is not None and isnan(nis):
            return False
        filtered_s = t
    return True


def align_record(record: Sequence[SlowReading], rate_hz: float, longest_delay_s: float) -> Alignment | None:
    """Alignment of a record, ``rate_hz`` its own; None: too little of it is usable.

    Its noise is what is left beyond holes and vibration.
    """
    usable = [(midships, local) for _, midships, local in record if midships is not None and local is not None]
    if len(usable) < max(TUNING.fewest_aligned, TUNING.aligned_share * len(record)):
        return None
    motions = np.array([midships.motion for midships, _ in usable])
    found = align(motions, np.array([local.motion[0] for _, local in usable]), rate_hz, longest_delay_s)
    known = np.mean([midships.variance + (found.C**2).T.dot(local.variance) for midships, local in usable], axis=0)
    noise = np.sqrt(np.maximum(found.noise_radps**2 - known, 0.0))
    return msgspec.structs.replace(found, noise_radps=noise)


def about_two_axes(record: Sequence[SlowReading]) -> bool:
    """The midships motion of a record alone would do for an alignment."""
    both = [midships for _, midships, local in record if midships is not None and local is not None]
    rates = np.array([midships.motion[0] for midships in both])
    spread = np.linalg.eigvalsh(rates.T @ rates) if len(rates) else np.zeros(3)
    return bool(spread[1] > TUNING.one_axis_motion * spread[2] > 0.0)


def first_filter(
    method: Method, found: Alignment, record: Sequence[SlowReading], flexure: Flexure, noise: Noise, passes: int
) -> Filter | None:
    """A filter that has gone through the record from an alignment, each pass about the last one. None: in vain."""
    C0, delay = found.C, found.delay_s
    for _ in range(passes):
        filter = make_filter(method, C0, delay, flexure, noise)
        if not run(filter, record, record[0][0], -np.inf):
            return None
        C0, delay = filter.static, filter.delay_s
    return filter


class RefitJob(msgspec.Struct, frozen=True, eq=False, kw_only=True):
    """All that a refit needs, copied: it may be computed anywhere."""

    rows: Array
    """(n, 9): as of :class:`SlowPair`; nan where missing. Contiguous."""
    pair: SlowPair
    """As it stands at the last row."""
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
    pair: SlowPair
    """With what vibrates in the record."""
    noise: Noise
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
    rows, pair = job.rows.copy(), job.pair.copy()
    pair.identify(rows, TUNING.rounds)
    record = pair.through(rows)
    rates, known = np.full((len(record), 3), np.nan), np.full((len(record), 3), np.nan)
    for i, (_, midships, local) in enumerate(record):
        if midships is not None and local is not None:
            rates[i] = job.filter.residual(midships.motion, local.motion[0])
            known[i] = job.filter.variance(midships.variance, local.variance)
    # What is ordinary: a slam is no part of the spectrum, nor is what remains of a reading across holes.
    size = known.sum(axis=1)
    used = (
        size <= TUNING.ordinary_std**2 * np.nanmedian(size)
        if np.isfinite(size).any()
        else np.zeros(len(record), dtype=bool)
    )
    share = float(np.mean(used)) if len(record) else 0.0
    if share < TUNING.ordinary_share:
        return None
    t = np.array([reading[0] for reading in record])
    rates = np.array([np.interp(t, t[used], column) for column in (rates[used] - np.mean(rates[used], axis=0)).T]).T
    left_over = np.mean(known[used], axis=0)
    before = job.filter.noise.sample_radps
    found = fit(rates, pair.out_hz, job.prior, float(np.min(before)))
    if not all(np.isfinite(a).all() for a in (found.noise_radps, *msgspec.structs.astuple(found.flexure))):
        return None
    # Noise that the flexure does not explain: that of holes and vibration, and what is white beyond it.
    variance = found.noise_radps**2 / share
    left = np.minimum(variance / left_over, 1.0)
    noise = msgspec.structs.replace(
        job.filter.noise,
        sample_radps=np.sqrt(np.maximum(variance - left_over, job.least_noise_radps**2)),
        left=left,
        ordinary=TUNING.ordinary_std**2 * left_over,
    )
    filter = None
    if job.whole:
        filter = make_filter(job.method, job.filter.static, job.filter.delay_s, found.flexure, noise)
        if not run(filter, record, record[0][0], -np.inf):
            return None
    return RefitResult(
        flexure=found.flexure,
        pair=pair,
        noise=noise,
        filter=filter,
        filtered_s=record[-1][0],
        generation=job.generation,
    )
