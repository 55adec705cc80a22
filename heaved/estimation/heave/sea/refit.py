"""One look at the recent past: which model the sea has now, and the state of its filter. Runs beside the event loop.

Several lengths of the past are fitted side by side. Long ones are exact in a steady sea, short ones follow a change;
which serves best is decided by what each *foretold*: the models of the last look are run over the samples that came
since, and the likelihood of what they made of the wave band, with a memory of a few looks, picks the length whose new
model is used.
"""

from __future__ import annotations

import itertools
from functools import partial
from math import isfinite, nan
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common import down_sampler
from heaved.estimation.heave.sea import (
    batch_filter,
    blow_removal,
    drift_removal,
    gap_bridge,
    joint_design,
    noise,
    whittle_fit,
)
from heaved.estimation.heave.sea.filter import SeaFilter
from heaved.estimation.heave.sea.joint_design import Joint
from heaved.estimation.heave.sea.joint_learning import even_angles, heading
from heaved.estimation.heave.sea.model import SeaModel, SeaSystem, Steady
from heaved.estimation.heave.sea.record import EvenRecord, even, stretches_of
from heaved.estimation.heave.sea.sea_state import longest_period_s, sea_state
from heaved.estimation.heave.sea.smoother import smoothed
from heaved.samples import SeaState

if TYPE_CHECKING:
    from collections.abc import Callable

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of a look at the past."""

    score_memory: float = 0.7
    """Share of the score of a length that is kept from look to look."""
    judged_hz: float = 0.5
    """Models are judged up to here: what the innovations are above is the end of the tail, and no matter to the
    heave."""
    patience: float = 3.0
    """Log-likelihood that a length must be ahead of the next longer one: differences of this size come by chance."""
    few_components_below_s: float = 30.0
    """A shorter record does not bear more than two components."""
    settle_s: float = 400.0
    """After this nothing of the start of a filter is left, in swell of 16 s either (after two minutes it is more than
    what models differ by): before the first sample whose innovation is looked at, a filter runs this long."""
    same_dt: float = 1e-3
    """Relative change of the usual interval up to which the gain of a steady filter stays as it was."""
    whiteness_s: float = 2.0
    """Innovations are averaged over this: engines and slams cancel, what a wrong sea leaves stays."""
    whiteness_over_s: float = 60.0
    """The newest so many seconds of them are held against the model,"""
    newest_s: float = 10.0
    """and the very newest."""
    min_record_s: float = 20.0
    """Shorter records are not looked at: they hold two waves or three."""
    min_stretch_s: float = 30.0
    """A record with holes that are too long to be bridged is fitted between them, and not at all when that is shorter
    and there is a model already."""
    long_hole_s: float = 1.0
    """Holes are bridged up to here where there are enough stretches without them,"""
    long_s: float = 60.0
    """that is, stretches that long."""
    mostly: float = 0.6
    """Longer holes are bridged only where the stretches between them that are that long are a smaller share of the
    record: what is drawn into three seconds may raise the skirt of a spectrum tenfold."""
    few_in_long_holes: float = 0.1
    """Share of the shortest window that may lie in longer holes than that, bridged, when there is a model already: more
    of it is better not learned from. (A sensor at the end of its range loses just the highest waves.)"""
    slowest_s: float = 0.8
    """Samples further apart than this, in the mean, do not show the waves (up to 0.6 Hz) at all."""
    walk_seen_s: float = 300.0
    """An unbroken stretch that long shows how the bias of the accelerometer walks."""
    shaken_alike_s: tuple[float, ...] = (120.0, 60.0, 30.0, 15.0, 10.0)
    """Lengths of the past that may show what shakes the sensor."""
    shaken_otherwise: float = 2.0
    """Ratio of variances."""
    noise_most_psd: float = 1e-4
    """Of the white noise of an accelerometer that is worth its cable, (m/s2)2/Hz: what there is more of above the waves
    is vibration, as long as there is not clearly more below them, too."""
    noise_seen_s: float = 200.0
    """One that long shows the noise below the waves."""
    walk_of_noise: float = 0.03
    """Walk of the bias, per root second, over the density of the white noise, that is expected of a sensor at least:
    accelerometers that are noisier wander more (data sheets: 0.02 to 0.05)."""
    bridge_seed: int = 1
    """The same record gives the same answer."""
    rough: int = 2
    """Times that a record is fitted and bridged anew when there was no model to bridge its holes with."""
    many_holes_s: float = 5.0
    """With a hole every so many seconds, or more, the filter takes the samples one by one."""
    start_s: float = 100.0
    """Then they are taken from so long before the first that is looked at."""
    noise_known: float = 0.95
    """Where less of the record is known than this share, its noise is taken from the innovations: what bridges the
    holes has that of an earlier model."""
    noise_factors: tuple[float, float] = (0.1, 30.0)
    """By which the noise changes at once,"""
    noise_is_known: tuple[float, float] = (0.8, 1.25)
    """and need not change."""


TUNING: Final = Tuning()


class Candidate(msgspec.Struct, frozen=True, kw_only=True):
    """The model of one length of the past."""

    window_s: float
    model: SeaModel
    score: float = 0.0
    """Log-likelihood of what came after its predecessors, less that of the best length; forgotten slowly."""
    steady_dt_s: float = 0.0
    """Interval of the samples that its steady filter is for; 0: that was not solved for, the model was not used."""
    steady_covariance: bytes = b""
    """(n, n) covariance of that filter before a sample is taken in."""


class SeaWindow(msgspec.Struct, frozen=True, kw_only=True, tag="sea"):
    """A request: the past, and what the last look made of it. Arrays travel as float64 bytes."""

    number: int
    t_s: bytes
    """(n,) times of the samples, increasing."""
    a_mps2: bytes
    """(n,) vertical acceleration."""
    stages: int
    components: int
    windows_s: tuple[float, ...]
    bias_walk_psd: float
    delay_s: float
    """Lag of the smoother."""
    looked_s: float
    """End of the past at the last look; nan: there was none, or that past was forgotten."""
    candidates: tuple[Candidate, ...] = ()
    """Of the last look."""
    period_s: float = nan
    """Interval of the samples of which each of these is the mean,"""
    averaged: int = 1
    """and how many those are."""
    cuts_s: tuple[tuple[float, float], ...] = ()
    """Spans (s) after which it is measured otherwise than before, and in which it is neither: no spectrum is taken
    across, and of the bias nothing is known."""
    spoilt_s: tuple[tuple[float, float], ...] = ()
    """Spans (s) that are not of the sea."""
    blows_s: tuple[float, ...] = ()
    """First moments (s) after something struck the hull."""
    drifts_s: tuple[tuple[float, float], ...] = ()
    """Spans (s) in which the level goes on in one direction; until inf: it does still."""
    angles: bytes = b""
    """(m, 4) time, roll, pitch and yaw (rad), nan where they are not known; empty: they are not to be looked at."""
    horizons_s: tuple[float, ...] = ()
    """What they may tell of the heave is wanted for so long after the last sample, too."""


class SeaFit(msgspec.Struct, frozen=True, kw_only=True):
    """The answer. ``message`` is empty when well, and only then the rest is there."""

    number: int
    message: str = ""
    candidates: tuple[Candidate, ...] = ()
    window_s: float = 0.0
    """Length of the past that the model in use was fitted to."""
    record_s: float = 0.0
    """Seconds of samples that there were."""
    model: SeaModel | None = None
    sea: SeaState | None = None
    t_s: float = 0.0
    """Time of the last sample, and of the state."""
    dt_s: float = 0.0
    """Usual interval of the samples."""
    x: bytes = b""
    """(n,) filtered state."""
    P: bytes = b""
    """(n, n) its covariance; empty: the steady one."""
    rate: tuple[float, float] | None = None
    """At which the bias goes on at the end, m/s3, and the variance of that; None: it does not."""
    rate_covariance: bytes = b""
    """(n,) of the rate with the state."""
    steady_covariance: bytes = b""
    """(n, n) of the steady filter, before a sample is taken in."""
    predicted_m: bytes = b""
    """(k,) heave before each of the last samples, for the smoother; one every ``dt_s`` up to ``t_s``."""
    innovation: bytes = b""
    """(l,) of at least as many of the last samples, m/s2."""
    delayed: bytes = b""
    """(k, 3) time, heave and its standard deviation for times that are not yet as old as the delayed heave: where the
    recent past has holes, and the smoother's weights are not those of its filter."""
    whiteness: float = 1.0
    """Variance of the averaged innovations over the last minute, over what the model has for it; 1 when it is right."""
    newest: float = 1.0
    """The same over the last ten seconds: noise that has begun then, and is not in the model."""
    waves_seen: float = 0.0
    """How many of the longest waves the record of that model holds."""
    waves: float = 0.0
    """How much likelier the record is with waves than with noise alone (log-likelihood)."""
    joint: Joint | None = None
    """What roll and pitch tell of the heave; None: nothing."""


def look(window: SeaWindow) -> SeaFit:
    """Fit, judge, run. Never raises for what the samples may be: what is wrong is the message."""
    t, a = np.frombuffer(window.t_s), np.frombuffer(window.a_mps2)
    if len(t) < 8 or not t[-1] - t[0] >= TUNING.min_record_s:
        return SeaFit(number=window.number, message="the record is too short")
    if not (np.isfinite(a).all() and np.isfinite(t).all() and bool(np.all(np.diff(t) > 0.0))):
        return SeaFit(number=window.number, message="the record has gaps in its numbers")
    if float(np.ptp(a)) <= 0.0:
        return SeaFit(number=window.number, message="the record is constant")
    if (t[-1] - t[0]) > TUNING.slowest_s * (len(t) - 1) and float(np.median(np.diff(t))) > TUNING.slowest_s:
        return SeaFit(number=window.number, message="the samples are too far apart to show waves")
    try:
        return _look(window, even(t, a).cut(window.cuts_s, window.spoilt_s, window.blows_s))
    except np.linalg.LinAlgError as error:
        return SeaFit(number=window.number, message=f"the record has no spectrum that can be fitted: {error}")


def _look(window: SeaWindow, record: EvenRecord) -> SeaFit:
    """
    Raises:
        LinAlgError: no model can be made of the record.
    """
    drifted = _drifted(window, record)
    if drifted is not None:
        record = msgspec.structs.replace(record, a_mps2=record.a_mps2 - drifted.a_mps2)
    rung = _rung(window, record)
    still = record if rung is None else msgspec.structs.replace(record, a_mps2=record.a_mps2 - rung.a_mps2, blows=())
    whole = _bridged(window, still, is_drawn=True)
    record = record.without_mixed(_mixed(window))
    recent = still.last(round(min(window.windows_s) / record.dt_s))
    drawn = whole.last(len(recent.is_known)).is_known & ~gap_bridge.closed(
        recent.is_known, record.dt_s, TUNING.long_hole_s
    )
    if window.candidates and np.mean(drawn) > TUNING.few_in_long_holes:
        return SeaFit(number=window.number, message="the record has too many holes")
    parts = unbroken(whole, round(max(window.windows_s) / record.dt_s))
    stretch_s = max(map(len, parts), default=0) * record.dt_s
    if stretch_s < (TUNING.min_stretch_s if window.candidates else TUNING.min_record_s) and not whole.is_known.all():
        return SeaFit(number=window.number, message="the record has too many holes")
    # What is drawn is no measurement: a filter would be surprised by the next sample, whatever its model.
    told = _bridged(window, record, is_drawn=False) if window.candidates and _has_many_holes(record) else record
    scores = _scores(window, told, record.is_known)
    fitted, shares, seconds, waves = _fit_all(window, whole, scores, still.is_known, rung)
    # Candidates come shortest first: a longer past is exact where the sea is steady, a shorter one has to earn it.
    chosen = max(range(len(fitted)), key=lambda rank: fitted[rank].score + TUNING.patience * rank)
    best, share = fitted[chosen], shares[chosen]
    kept = round(window.delay_s / record.dt_s) + round(30.0 / record.dt_s)
    judged, settle = max(kept, round(TUNING.whiteness_over_s / record.dt_s)), round(TUNING.settle_s / record.dt_s)
    recent = record.last(settle + judged)
    ran = _settled(best, recent, settle, judged)
    if isinstance(ran, str):
        return SeaFit(number=window.number, message=ran)
    best, system, steady, done = ran
    used = msgspec.structs.replace(best, steady_dt_s=record.dt_s, steady_covariance=steady.P.tobytes())
    x, P, rate, rate_covariance = _with_drift(drifted, system, steady, done)
    return SeaFit(
        number=window.number,
        candidates=(*fitted[:chosen], used, *fitted[chosen + 1 :]),
        window_s=best.window_s,
        record_s=len(record.a_mps2) * record.dt_s,
        model=best.model,
        sea=sea_state(best.model, share),
        t_s=record.end_s,
        dt_s=record.dt_s,
        x=x.tobytes(),
        P=b"" if P is None else P.tobytes(),
        rate=rate,
        rate_covariance=rate_covariance.tobytes(),
        steady_covariance=steady.P.tobytes(),
        predicted_m=done.predicted_m[-kept:].tobytes(),
        innovation=done.innovation[-max(kept, round(joint_design.TUNING.filter_s / record.dt_s)) :].tobytes(),
        delayed=_delayed(window, system, steady, recent, settle, is_drifting=rate is not None).tobytes(),
        whiteness=whiteness(done.innovation, steady),
        newest=whiteness(done.innovation, steady, TUNING.newest_s),
        waves_seen=seconds[chosen] / longest_period_s(best.model),
        waves=waves,
        joint=_joint(window, whole, system, steady),
    )


def _joint(window: SeaWindow, whole: EvenRecord, system: SeaSystem, steady: Steady) -> Joint | None:
    """What roll and pitch tell of the heave, of the past since the level was last another, and in which the vessel
    headed as it does now.
    """
    if not window.angles or not (whole.is_known.any() and whole.is_known[-1]):
        return None
    rows, count = np.frombuffer(window.angles).reshape(-1, 4), len(whole.a_mps2)
    heading_rad, since_s = heading(rows[:, 0], rows[:, 3])
    heads_for = int(min(max(whole.end_s - since_s, 0.0) / whole.dt_s, count))
    since = max([count - heads_for, *whole.cuts[-1:]])
    a = np.where(whole.is_known, whole.a_mps2, nan)[since:]
    angles = even_angles(rows[:, :3], whole.end_s, whole.dt_s, len(a))
    try:
        return joint_design.joint(system, steady, a, angles, window.horizons_s, heading_rad)
    except np.linalg.LinAlgError:
        return None  # The heave of the acceleration is no worse for that.


def _drifted(window: SeaWindow, record: EvenRecord) -> drift_removal.Level | None:
    """How the bias has drifted, as the model in use has it; None: it has not."""
    if not window.drifts_s or not window.candidates:
        return None
    best = max(window.candidates, key=lambda one: (one.steady_dt_s > 0.0, one.score))
    system = SeaSystem(best.model)
    steady = _steady(system, best, record.dt_s)
    return None if steady is None else drift_removal.level(record, system, steady, window.drifts_s)


def _with_drift(
    drifted: drift_removal.Level | None, system: SeaSystem, steady: Steady, done: batch_filter.Run
) -> tuple[Array, Array | None, tuple[float, float] | None, Array]:
    """State and covariance at the end, with the drift that was taken out of the record; the rate, if it goes on, its
    variance, and its covariance with the state.
    """
    if drifted is None:
        return done.x, done.P, None, np.empty(0)
    x = done.x.copy()
    x[-1] += drifted.a_mps2[-1]
    if not drifted.is_going_on:
        return x, done.P, None, np.empty(0)
    P = steady.P - np.outer(steady.K, steady.K) * steady.S if done.P is None else done.P
    missing = drifted.missing(system, steady)
    return x, P + missing[:-1, :-1], (float(drifted.rates_mps3[-1]), float(missing[-1, -1])), missing[:-1, -1]


def _mixed(window: SeaWindow) -> int:
    """Samples from a blow's first on that are in part of before it."""
    return 2 if window.averaged > 1 else 1


def _rung(window: SeaWindow, record: EvenRecord) -> blow_removal.Rung | None:
    """What the blows in the record have added to it; None: there are none."""
    if not record.blows:
        return None
    best = max(window.candidates, key=lambda one: one.score, default=None)
    model = None if best is None else best.model
    if model is None:
        lines = msgspec.structs.replace(record, is_known=gap_bridge.closed(record.is_known, record.dt_s))
        model = _fit_all(window, lines, {}, record.is_known)[0][-1].model
    return blow_removal.ringing(record, model, _mixed(window))


def _has_many_holes(record: EvenRecord) -> bool:
    """More than can be taken as exceptions."""
    known = record.is_known
    return int(np.count_nonzero(known[:-1] & ~known[1:])) * TUNING.many_holes_s > len(known) * record.dt_s


def _longest_bridge(record: EvenRecord) -> float:
    """Longest holes (s) that are bridged: as short as stretches without holes are there to be fitted."""
    closed = gap_bridge.closed(record.is_known, record.dt_s, TUNING.long_hole_s)
    stretches = stretches_of(msgspec.structs.replace(record, is_known=closed))
    most = TUNING.long_s / record.dt_s
    fitted = sum([end - first for first, end, is_known in stretches if is_known and end - first > most])
    return TUNING.long_hole_s if fitted > TUNING.mostly * len(closed) else gap_bridge.TUNING.longest_s


def _bridged(window: SeaWindow, record: EvenRecord, *, is_drawn: bool) -> EvenRecord:
    """The record with its holes bridged, as far as they are short: what a spectrum can be had of when it ``is_drawn``.

    The model that bridges them is the last one; without one it is found with the holes bridged by straight lines first.
    """
    if record.is_known.all():
        return record
    best = max(window.candidates, key=lambda candidate: candidate.score, default=None)
    rng = np.random.default_rng(TUNING.bridge_seed) if is_drawn else None
    longest_s = _longest_bridge(record)
    model, whole = (None if best is None else best.model), record
    for _ in range(1 if model is not None else TUNING.rough):
        if model is None:
            lines = msgspec.structs.replace(whole, is_known=gap_bridge.closed(whole.is_known, whole.dt_s, longest_s))
            model = _fit_all(window, lines, {}, record.is_known)[0][-1].model
        # Not across a cut: the level is another one there.
        parts = [
            gap_bridge.bridged(record.a_mps2[first:end], record.is_known[first:end], record.dt_s, model, rng, longest_s)
            for first, end in itertools.pairwise([0, *record.cuts, len(record.a_mps2)])
        ]
        a, is_known = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        whole, model = msgspec.structs.replace(record, a_mps2=a, is_known=is_known), None
    return whole


def _settled(
    candidate: Candidate, recent: EvenRecord, settle: int, judged: int
) -> tuple[Candidate, SeaSystem, Steady, batch_filter.Run] | str:
    """The candidate, with the noise that its innovations show, and what its filter makes of the recent past; or why
    there is no such filter.
    """
    found: tuple[Candidate, SeaSystem, Steady, batch_filter.Run] | None = None
    excess = 1.0
    while found is None or not TUNING.noise_is_known[0] <= excess <= TUNING.noise_is_known[1]:
        is_last, candidate = found is not None, _noisier(candidate, excess)
        system = SeaSystem(candidate.model)
        steady = system.steady(recent.dt_s)
        if steady is None:
            return "the filter of the fitted model does not converge"
        done, excess = _run(system, steady, recent, settle, judged)
        if not (np.isfinite(done.x).all() and isfinite(excess)):
            return "the filter of the fitted model left the finite numbers"
        found = candidate, system, steady, done
        if is_last:
            break
    return found


def _run(
    system: SeaSystem, steady: Steady, recent: EvenRecord, settle: int, judged: int
) -> tuple[batch_filter.Run, float]:
    """The filter over the recent past; and variance of the innovations over the model's, where noise is known by that
    alone, else 1.
    """
    if not _has_many_holes(recent):
        return batch_filter.run(system, steady, recent, full_start=len(recent.a_mps2) < settle, kept=judged), 1.0
    # It begins with all that is not known of the state: nothing has to settle.
    recent = recent.last(judged + round(TUNING.start_s / recent.dt_s))
    f = SeaFilter(system, steady, nan, np.zeros(len(system.H)), system.stationary)
    done, excess = batch_filter.one_by_one(f, recent, judged)
    return done, excess if np.mean(recent.is_known[-judged:]) < TUNING.noise_known else 1.0


def _delayed(
    window: SeaWindow, system: SeaSystem, steady: Steady, recent: EvenRecord, settle: int, *, is_drifting: bool
) -> Array:
    """What :attr:`SeaFit.delayed` holds."""
    count = round(window.delay_s / recent.dt_s)
    known = recent.is_known
    is_whole = known[-count:].all() and not any(at > len(known) - count for at in (*recent.cuts, *recent.blows))
    if (is_whole and not is_drifting) or not known[:-count].any():
        return np.empty((0, 3))
    last = int(np.flatnonzero(known[:-count])[-1])
    before = EvenRecord(
        recent.end_s - (len(known) - 1 - last) * recent.dt_s,
        recent.dt_s,
        recent.a_mps2[: last + 1],
        known[: last + 1],
        tuple([cut for cut in recent.cuts if cut <= last]),
        tuple([blow for blow in recent.blows if blow <= last]),
    )
    done, _ = _run(system, steady, before, settle, 1)
    f = SeaFilter(system, steady, before.end_s, done.x, done.P)
    after = recent.last(len(known) - 1 - last)
    # The newer half is delayed heave of the next look.
    return smoothed(f, after, len(after.a_mps2) - count // 2)


def _noisier(candidate: Candidate, factor: float) -> Candidate:
    """With ``factor`` times the noise, within what it may change at once."""
    noise_psd = candidate.model.noise_psd * min(max(factor, TUNING.noise_factors[0]), TUNING.noise_factors[1])
    return msgspec.structs.replace(candidate, model=msgspec.structs.replace(candidate.model, noise_psd=noise_psd))


def _scores(window: SeaWindow, record: EvenRecord, is_known: NDArray[np.bool_]) -> dict[float, float]:
    """Each length's score with what came since the last look; ``is_known`` (n,): what of that was measured."""
    fresh = 0
    if window.candidates and isfinite(window.looked_s):  # Not after a reset: the candidates outlive the past.
        fresh = min(len(record.a_mps2), round((record.end_s - window.looked_s) / record.dt_s))
    if fresh < 2:
        return {candidate.window_s: candidate.score for candidate in window.candidates}
    recent = record.last(fresh + round(TUNING.settle_s / record.dt_s))
    measured = is_known[-fresh:]
    if not measured.any():
        return {candidate.window_s: candidate.score for candidate in window.candidates}
    is_whole = bool(recent.is_known.all()) and not recent.cuts and not recent.blows
    found: dict[float, float] = {}
    for candidate in window.candidates:
        system = SeaSystem(candidate.model)
        steady = _steady(system, candidate, record.dt_s)
        if steady is None:
            continue
        done = batch_filter.run(system, steady, recent, full_start=False, full_holes=not is_whole, kept=fresh)
        likelihood = _likelihood(candidate.model, steady, np.where(measured, done.innovation[-fresh:], nan))
        found[candidate.window_s] = TUNING.score_memory * candidate.score + (
            likelihood if np.isfinite(likelihood) else -1e9
        )
    best = max(found.values(), default=0.0)
    return {window_s: score - best for window_s, score in found.items()}


def _steady(system: SeaSystem, candidate: Candidate, dt_s: float) -> Steady | None:
    """The steady filter of a candidate: solved for again only where it was not kept, or the interval has changed."""
    if not abs(dt_s - candidate.steady_dt_s) <= TUNING.same_dt * dt_s:
        return system.steady(dt_s)
    n = len(system.H)
    return system.steady_of(dt_s, np.frombuffer(candidate.steady_covariance).reshape(n, n))


def _likelihood(model: SeaModel, steady: Steady, innovation: Array) -> float:
    """Log-likelihood (Whittle's) of a stretch of acceleration within the wave band, from the innovations (n,) that a
    model's filter left of it, nan in a hole: they are the samples whitened, so that nothing leaks in so short a
    stretch, and their periodogram is that of the acceleration over the model's spectrum.
    """
    known = np.isfinite(innovation)
    count = max(1, int(np.count_nonzero(known)))
    white = np.abs(np.fft.rfft(np.where(known, innovation, 0.0))) ** 2 / (steady.S * count)
    f: Array = np.fft.rfftfreq(len(innovation), steady.dt_s).astype(np.float64)
    judged = (f > 0.0) & (f <= TUNING.judged_hz)
    return -float(np.sum(np.log(model.acceleration_spectrum(f[judged], steady.dt_s)) + white[judged]))


def _fit_all(
    window: SeaWindow,
    record: EvenRecord,
    scores: dict[float, float],
    is_measured: NDArray[np.bool_],
    rung: blow_removal.Rung | None = None,
) -> tuple[tuple[Candidate, ...], list[float], list[float], float]:
    """A model for each length that the record reaches, the longest that it does not reach gets all there is; the share
    of each model's variance that was measured; seconds that each was fitted to; how much likelier than noise the waves
    are. ``is_measured`` (n,): what of the record is not bridged. ``rung``: what was taken out of it.
    """
    rate, seconds = 1.0 / record.dt_s, len(record.a_mps2) * record.dt_s
    earlier = {candidate.window_s: candidate.model for candidate in window.candidates}
    known = list(scores)
    every = sorted(window.windows_s)
    lengths, stretches, longest = [], [], []
    for shorter, length in zip([0.0, *every], every, strict=False):
        if shorter <= seconds:
            parts = unbroken(record, round(min(length, seconds) * rate))
            if (most := max(map(len, parts), default=0)) >= TUNING.min_record_s * rate:
                lengths.append(length)
                stretches.append(parts)
                longest.append(most)
    if not lengths:
        raise np.linalg.LinAlgError("no stretch of it is long enough")
    passed = partial(down_sampler.passed, period_s=window.period_s, averaged=window.averaged)
    spectra = [whittle_fit.spectrum(parts, rate, passed) for parts in stretches]
    few = [most < TUNING.few_components_below_s * rate for most in longest]
    last = max(window.candidates, key=lambda one: one.window_s, default=None)
    bias_walk_psd = window.bias_walk_psd if last is None else last.model.bias_walk_psd

    def fit(models: dict[float, SeaModel]) -> dict[float, whittle_fit.Fitted]:
        fitted: dict[float, whittle_fit.Fitted] = {}
        for are_few in set(few):
            components = min(2, window.components) if are_few else window.components
            of = [i for i, is_few in enumerate(few) if is_few == are_few]
            warm = [models.get(lengths[i]) for i in of]
            made = whittle_fit.fit([spectra[i] for i in of], window.stages, components, bias_walk_psd, warm)
            fitted.update(zip([lengths[i] for i in of], made, strict=True))
        return fitted

    # What shakes the sensor now is in the newest past: all lengths are told of it.
    if not earlier:
        earlier = {length: one.model for length, one in fit({}).items()}
    quietest_psd = min([TUNING.noise_most_psd, *(sp.noise_psd for sp in spectra)])
    above = _newest_above(record, is_measured, spectra[0], passed)
    shaking, noise_psd = noise.resonances(above, earlier.get(lengths[0]), quietest_psd)
    if rung is not None:
        # The filter has to know of what rings, while short waves are those that are there without it.
        are_waves = any(one.is_heave for one in shaking)
        rings = rung.density(above.f_hz, min(round(lengths[0] * rate), len(record.a_mps2)), record.dt_s)
        struck = msgspec.structs.replace(above, power=above.power + rings)
        shaking, noise_psd = noise.resonances(struck, earlier.get(lengths[0]), noise_psd)
        shaking = shaking if are_waves else tuple([msgspec.structs.replace(one, is_heave=False) for one in shaking])
    shaking = noise.remembered(shaking, earlier[lengths[0]].resonances if lengths[0] in earlier else (), noise_psd)
    # What is left of a blow has power within the waves' band, too, which is no noise to a filter that knows of it.
    is_whole = bool(np.all(is_measured | ~record.is_known)) and not record.blows and rung is None
    spectra = [
        msgspec.structs.replace(
            sp,
            resonances=shaking,
            noise_psd=noise_psd,
            is_noise_known=is_whole and most >= TUNING.noise_seen_s * rate,
        )
        for sp, most in zip(spectra, longest, strict=True)
    ]
    fitted = fit(earlier)
    models = [fitted[length].model for length in lengths]
    walk = _walk(window, record, is_measured, models, is_struck=rung is not None)
    fitted = {
        length: msgspec.structs.replace(one, model=msgspec.structs.replace(one.model, bias_walk_psd=walk))
        for length, one in fitted.items()
    }
    # A length that is new starts as well as the longest one before it.
    unknown = scores[known[-1]] if known else 0.0
    candidates = tuple(
        Candidate(window_s=length, model=fitted[length].model, score=scores.get(length, unknown)) for length in lengths
    )
    shares = [whittle_fit.measured_share(sp, fitted[length].model) for sp, length in zip(spectra, lengths, strict=True)]
    return candidates, shares, [sum(map(len, parts)) / rate for parts in stretches], fitted[lengths[0]].waves


def _walk(
    window: SeaWindow, record: EvenRecord, is_measured: NDArray[np.bool_], models: list[SeaModel], *, is_struck: bool
) -> float:
    """The walk of the bias (m/s2)2/s that the record shows beside the waves of the longest past, the last of
    ``models``, or the one that this has. To shorter pasts, which are before it, waves that have just come are larger.
    """
    model = models[-1]
    measured = msgspec.structs.replace(record, is_known=is_measured)
    stretch = max(unbroken(measured, len(is_measured)), key=len, default=np.empty(0))
    noise_psd = model.noise_psd if model.noise_psd < 0.5 * TUNING.noise_most_psd else 0.0
    expected_psd = max(window.bias_walk_psd, TUNING.walk_of_noise**2 * noise_psd)
    # Neither what bridges a hole nor a blow is noise of the sensor.
    if len(record.a_mps2) * record.dt_s < TUNING.walk_seen_s:
        return expected_psd
    if len(stretch) * record.dt_s < TUNING.walk_seen_s or record.blows or is_struck:
        return model.bias_walk_psd
    return whittle_fit.bias_walk(stretch, 1.0 / record.dt_s, model, expected_psd, models)


def _newest_above(
    record: EvenRecord,
    is_measured: NDArray[np.bool_],
    shortest: whittle_fit.Spectrum,
    passed: Callable[[Array], Array],
) -> noise.Above:
    """The periodogram above the waves of what is shaken as now: that of the ``shortest`` length, or of less of it."""
    alike_s = TUNING.shaken_alike_s[0] if record.blows else _shaken_alike_s(record, is_measured)
    parts = unbroken(record, round(alike_s / record.dt_s))
    if (
        alike_s == TUNING.shaken_alike_s[0]
        or max(map(len, parts), default=0) * record.dt_s < 0.5 * TUNING.shaken_alike_s[-1]
    ):
        return shortest.above
    return whittle_fit.spectrum(parts, 1.0 / record.dt_s, passed).above


def _shaken_alike_s(record: EvenRecord, is_measured: NDArray[np.bool_]) -> float:
    """How long (s) it has been shaken as it is now: the longest of some lengths in which the second differences, that
    see no waves, are on the whole as large as in the last seconds.
    """
    squares = np.diff(record.a_mps2, n=2) ** 2
    known = is_measured[2:] & is_measured[1:-1] & is_measured[:-2]

    def mean(seconds: float) -> float:
        count = round(seconds / record.dt_s)
        part = known[-count:]
        return float(np.mean(squares[-count:][part])) if np.mean(part) > TUNING.mostly else nan

    now = mean(TUNING.shaken_alike_s[-1])
    for seconds in TUNING.shaken_alike_s:
        if not now > TUNING.shaken_otherwise * mean(seconds) and not mean(seconds) > TUNING.shaken_otherwise * now:
            return seconds
    return TUNING.shaken_alike_s[0]


def unbroken(record: EvenRecord, count: int) -> list[Array]:
    """The stretches without a hole or a cut among the last ``count`` samples, oldest first.

    A spectrum cannot bridge a hole: whatever stands in it has power at low frequencies, four decades above the skirt of
    the waves that the error of the heave depends on.
    """
    newest = record.last(count)
    return [newest.a_mps2[first:end] for first, end, is_known in stretches_of(newest) if is_known]


def whiteness(innovation: Array, steady: Steady, over_s: float = TUNING.whiteness_over_s) -> float:
    """Variance of averaged innovations, in the last ``over_s``, over that of the model: 1 when it fits."""
    each = max(1, round(TUNING.whiteness_s / steady.dt_s))
    count = min(round(over_s / TUNING.whiteness_s), int(np.count_nonzero(np.isfinite(innovation))) // each)
    if count < 1:
        return 1.0
    means = innovation[-count * each :].reshape(count, each).mean(axis=1)
    return float(np.mean(means**2)) * each / steady.S
