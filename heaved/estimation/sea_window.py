"""One look at the recent past: which model the sea has now, and the state of its filter. Runs beside the event loop.

Several lengths of the past are fitted side by side. Long ones are exact in a steady sea, short ones follow a change;
which serves best is decided by what each *foretold*: the models of the last look are run over the samples that came
since, and the likelihood of what they made of the wave band, with a memory of a few looks, picks the length whose new
model is used.
"""

from __future__ import annotations

from math import isfinite, nan, sqrt
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation import sea_fit, sea_run
from heaved.estimation.sea_model import SeaModel, SeaSystem, Steady
from heaved.estimation.sea_state import sea_state
from heaved.samples import SeaState

Array = NDArray[np.float64]

SCORE_MEMORY: Final = 0.7
"""Share of the score of a length that is kept from look to look."""
JUDGED_HZ: Final = 0.5
"""Models are judged up to here: what the innovations are above is the end of the tail, and no matter to the heave."""
PATIENCE: Final = 3.0
"""Log-likelihood that a length must be ahead of the next longer one: differences of this size come by chance."""
FEW_COMPONENTS_BELOW_S: Final = 30.0
"""A shorter record does not bear more than two components."""
SETTLE_S: Final = 400.0
"""After this nothing of the start of a filter is left, in swell of 16 s either (after two minutes it is more than what
models differ by): before the first sample whose innovation is looked at, a filter runs this long."""
SAME_DT: Final = 1e-3
"""Relative change of the usual interval up to which the gain of a steady filter stays as it was."""
NEWEST_S: Final = 60.0
"""The newest stretch is taken when it is that long: the sea may have changed in the hole."""
WHITENESS_S: Final = 2.0
"""Innovations are averaged over this: engines and slams cancel, what a wrong sea leaves stays."""
WHITENESS_OVER_S: Final = 60.0
MIN_RECORD_S: Final = 20.0
MIN_STRETCH_S: Final = 30.0
"""A record with holes is fitted between them, and not at all when that is shorter and there is a model already."""


class Candidate(msgspec.Struct, frozen=True, kw_only=True):
    """The model of one length of the past."""

    window_s: float
    model: SeaModel
    score: float = 0.0
    """Log-likelihood of what came after its predecessors, less that of the best length; forgotten slowly."""
    steady_dt_s: float = 0.0
    """Interval of the samples that its steady filter is for; 0: that was not solved for, the model was not used."""
    steady_P: bytes = b""
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
    steady_P: bytes = b""
    """(n, n) of the steady filter, before a sample is taken in."""
    predicted_m: bytes = b""
    """(k,) heave before each of the last samples, for the smoother; one every ``dt_s`` up to ``t_s``."""
    innovation: bytes = b""
    """(k,) m/s2"""
    whiteness: float = 1.0
    """Variance of the averaged innovations over the last minute, over what the model has for it; 1 when it is right."""
    heave_std_m: float = 0.0
    """Of the heave that the model describes."""
    waves: float = 0.0
    """How much likelier the record is with waves than with noise alone (log-likelihood)."""


def look(window: SeaWindow) -> SeaFit:
    """Fit, judge, run. Never raises for what the samples may be: what is wrong is the message."""
    t, a = np.frombuffer(window.t_s), np.frombuffer(window.a_mps2)
    if len(t) < 8 or not t[-1] - t[0] >= MIN_RECORD_S:
        return SeaFit(number=window.number, message="the record is too short")
    if not (np.isfinite(a).all() and np.isfinite(t).all() and bool(np.all(np.diff(t) > 0.0))):
        return SeaFit(number=window.number, message="the record has gaps in its numbers")
    if float(np.ptp(a)) <= 0.0:
        return SeaFit(number=window.number, message="the record is constant")
    record = sea_run.even(t, a)
    stretch_s = len(unbroken(record, round(max(window.windows_s) / record.dt_s))) * record.dt_s
    if stretch_s < (MIN_STRETCH_S if window.candidates else MIN_RECORD_S) and stretch_s < len(t) * record.dt_s:
        return SeaFit(number=window.number, message="the record has too many holes")
    scores = _scores(window, record)
    fitted, shares, waves = _fit_all(window, record, scores)
    # Candidates come shortest first: a longer past is exact where the sea is steady, a shorter one has to earn it.
    chosen = max(range(len(fitted)), key=lambda rank: fitted[rank].score + PATIENCE * rank)
    best, share = fitted[chosen], shares[chosen]
    system = SeaSystem(best.model)
    steady = system.steady(record.dt_s)
    if steady is None:
        return SeaFit(number=window.number, message="the filter of the fitted model does not converge")
    kept = round(window.delay_s / record.dt_s) + round(30.0 / record.dt_s)
    judged, settle = max(kept, round(WHITENESS_OVER_S / record.dt_s)), round(SETTLE_S / record.dt_s)
    recent = _newest(record, settle + judged)
    done = sea_run.run(system, steady, recent, full_start=len(recent.a_mps2) < settle, kept=judged)
    if not np.isfinite(done.x).all():
        return SeaFit(number=window.number, message="the filter of the fitted model left the finite numbers")
    used = msgspec.structs.replace(best, steady_dt_s=record.dt_s, steady_P=steady.P.tobytes())
    return SeaFit(
        number=window.number,
        candidates=tuple(used if candidate is best else candidate for candidate in fitted),
        window_s=best.window_s,
        record_s=len(record.a_mps2) * record.dt_s,
        model=best.model,
        sea=sea_state(best.model, share),
        t_s=record.end_s,
        dt_s=record.dt_s,
        x=done.x.tobytes(),
        P=b"" if done.P is None else done.P.tobytes(),
        steady_P=steady.P.tobytes(),
        predicted_m=done.predicted_m[-kept:].tobytes(),
        innovation=done.innovation[-kept:].tobytes(),
        whiteness=whiteness(done.innovation, steady),
        heave_std_m=sqrt(float(system.heave @ system.stationary @ system.heave)),
        waves=waves,
    )


def _scores(window: SeaWindow, record: sea_run.Record) -> dict[float, float]:
    """Each length's score with what came since the last look."""
    fresh = 0
    if window.candidates and isfinite(window.looked_s):  # Not after a reset: the candidates outlive the past.
        fresh = min(len(record.a_mps2), round((record.end_s - window.looked_s) / record.dt_s))
    if fresh < 2:
        return {candidate.window_s: candidate.score for candidate in window.candidates}
    recent = _newest(record, fresh + round(SETTLE_S / record.dt_s))
    found: dict[float, float] = {}
    for candidate in window.candidates:
        system = SeaSystem(candidate.model)
        steady = _steady(system, candidate, record.dt_s)
        if steady is None:
            continue
        y = sea_run.run(system, steady, recent, full_start=False, full_holes=False).innovation[-fresh:]
        likelihood = _likelihood(candidate.model, steady, np.where(recent.is_known[-fresh:], y, nan))
        found[candidate.window_s] = SCORE_MEMORY * candidate.score + (likelihood if np.isfinite(likelihood) else -1e9)
    best = max(found.values(), default=0.0)
    return {window_s: score - best for window_s, score in found.items()}


def _steady(system: SeaSystem, candidate: Candidate, dt_s: float) -> Steady | None:
    """The steady filter of a candidate: solved for again only where it was not kept, or the interval has changed."""
    if not abs(dt_s - candidate.steady_dt_s) <= SAME_DT * dt_s:
        return system.steady(dt_s)
    n = len(system.H)
    return system.steady_of(dt_s, np.frombuffer(candidate.steady_P).reshape(n, n))


def _newest(record: sea_run.Record, count: int) -> sea_run.Record:
    return sea_run.Record(record.end_s, record.dt_s, record.a_mps2[-count:], record.is_known[-count:])


def _likelihood(model: SeaModel, steady: Steady, innovation: Array) -> float:
    """Log-likelihood (Whittle's) of a stretch of acceleration within the wave band, from the innovations (n,) that a
    model's filter left of it, nan in a hole: they are the samples whitened, so that nothing leaks in so short a
    stretch, and their periodogram is that of the acceleration over the model's spectrum."""
    known = np.isfinite(innovation)
    count = max(1, int(np.count_nonzero(known)))
    white = np.abs(np.fft.rfft(np.where(known, innovation, 0.0))) ** 2 / (steady.S * count)
    f: Array = np.fft.rfftfreq(len(innovation), steady.dt_s).astype(np.float64)
    judged = (f > 0.0) & (f <= JUDGED_HZ)
    return -float(np.sum(np.log(model.acceleration_spectrum(f[judged])) + white[judged]))


def _fit_all(
    window: SeaWindow, record: sea_run.Record, scores: dict[float, float]
) -> tuple[tuple[Candidate, ...], list[float], float]:
    """A model for each length that the record reaches, the longest that it does not reach gets all there is; the share
    of each model's variance that was measured; how much likelier than noise the waves are."""
    rate, seconds = 1.0 / record.dt_s, len(record.a_mps2) * record.dt_s
    earlier = {candidate.window_s: candidate.model for candidate in window.candidates}
    known = list(scores)
    every = sorted(window.windows_s)
    lengths = [length for shorter, length in zip([0.0, *every], every, strict=False) if shorter <= seconds]
    stretches = [unbroken(record, round(min(length, seconds) * rate)) for length in lengths]
    spectra = [sea_fit.spectrum(stretch, rate) for stretch in stretches]
    few = [len(stretch) < FEW_COMPONENTS_BELOW_S * rate for stretch in stretches]
    fitted: dict[float, sea_fit.Fitted] = {}
    for are_few in set(few):
        components = min(2, window.components) if are_few else window.components
        of = [i for i, is_few in enumerate(few) if is_few == are_few]
        warm = [earlier.get(lengths[i]) for i in of]
        made = sea_fit.fit([spectra[i] for i in of], window.stages, components, window.bias_walk_psd, warm)
        fitted.update(zip([lengths[i] for i in of], made, strict=True))
    # A length that is new starts as well as the longest one before it.
    unknown = scores[known[-1]] if known else 0.0
    candidates = tuple(
        Candidate(window_s=length, model=fitted[length].model, score=scores.get(length, unknown)) for length in lengths
    )
    shares = [sea_fit.measured_share(sp, fitted[length].model) for sp, length in zip(spectra, lengths, strict=True)]
    return candidates, shares, fitted[lengths[0]].waves


def unbroken(record: sea_run.Record, count: int) -> Array:
    """Samples without a hole among the last ``count``: the newest NEWEST_S or more of them, else the longest run.

    A spectrum cannot bridge a hole: whatever stands in it has power at low frequencies, four decades above the skirt of
    the waves that the error of the heave depends on.
    """
    known = record.is_known[-count:]
    edges = np.flatnonzero(np.diff(np.concatenate(([False], known, [False])).astype(np.int8)))
    runs = edges.reshape(-1, 2)
    lengths = runs[:, 1] - runs[:, 0]
    enough = np.flatnonzero(lengths * record.dt_s >= NEWEST_S)
    first, end = runs[int(enough[-1]) if len(enough) else int(np.argmax(lengths))]
    return record.a_mps2[-count:][first:end]


def whiteness(innovation: Array, steady: Steady) -> float:
    """Variance of innovations averaged over WHITENESS_S, in the last minute, over that of the model: 1 when it fits."""
    each = max(1, round(WHITENESS_S / steady.dt_s))
    count = min(round(WHITENESS_OVER_S / WHITENESS_S), int(np.count_nonzero(np.isfinite(innovation))) // each)
    if count < 1:
        return 1.0
    means = innovation[-count * each :].reshape(count, each).mean(axis=1)
    return float(np.mean(means**2)) * each / steady.S
