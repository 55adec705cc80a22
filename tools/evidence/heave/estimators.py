"""Every estimator of heave behind one adapter: the samples of a record in, a trace of what it published out.

Each is causal: a value of the trace is what was known when its sample came. Which ones run is said by name:

* ``inertial``, ``iir``, ``double``, ``kf``, ``ukf``: the filters of ``baselines.py``, blind to the laser;
* the name of an observer of the product (``harmonic``, ``sea``): the daemon's own pipeline with that observer, networks
  trained in-process where they are due. With a laser it gives two traces, before and after the learned correction.
"""

from __future__ import annotations

from collections import Counter
from math import nan
from typing import TYPE_CHECKING, Final, get_args, get_type_hints

import msgspec
import numpy as np
from numpy.typing import NDArray

from evidence.heave import baselines
from evidence.learning import learn
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, reference
from heaved.estimation.rock import params as rock
from heaved.pipeline import Pipeline, assemble
from heaved.samples import HeaveState, ImuSample, MotionFrame, Sample

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

Array = NDArray[np.float64]

INERTIAL: Final = "inertial output"
IIR: Final = "IIR filter"
DOUBLE: Final = "double integrator"
KF: Final = "KF"
UKF: Final = "UKF, one step"
WITH_LASER: Final = " + BP"
TITLES: Final = {
    "inertial": INERTIAL,
    "iir": IIR,
    "double": DOUBLE,
    "kf": KF,
    "ukf": UKF,
    "harmonic": "UKF multi-step",
    "sea": "sea observer",
}
"""What they are called in tables."""
CORRECTED: Final = TITLES["harmonic"] + WITH_LASER
OBSERVERS: Final[tuple[str, ...]] = get_args(get_type_hints(heave.Params)["observer"])
BASELINES: Final = ("inertial", "iir", "double", "kf", "ukf")
NAMES: Final = (*BASELINES, *OBSERVERS)


class Ahead(msgspec.Struct, frozen=True):
    """Forecasts of one horizon: (n,) each, made at the row for so much later; nan where there is none."""

    heave_m: Array
    std_m: Array


class Delayed(msgspec.Struct, frozen=True):
    """Smoothed heave: (k,) each, one per time of validity, in order."""

    t_s: Array
    heave_m: Array
    std_m: Array
    age_s: Array
    """How long after its time of validity each was first published."""


class Trace(msgspec.Struct, frozen=True, kw_only=True):
    """What an estimator published about a record: arrays (n,), one value per IMU sample, nan where nothing was said."""

    estimator: str
    heave_m: Array
    std_m: Array | None = None
    forecast: dict[float, Ahead] = msgspec.field(default_factory=dict)
    """By horizon, s."""
    delayed: Delayed | None = None
    states: tuple[HeaveState, ...] | None = None
    reasons: tuple[tuple[str, ...], ...] | None = None
    correction_m: Array | None = None
    angles_weight: Array | None = None
    """With which roll and pitch are in the heave, 0 to 1."""


class Conditions(msgspec.Struct, frozen=True, kw_only=True):
    """What is told an estimator before the first sample."""

    rate_hz: float
    period_s: float
    """Nominal period of the sea."""
    has_laser: bool
    horizons_s: tuple[float, ...] = ()
    """Forecasts that are wanted."""


def title(name: str) -> str:
    """What the plain trace of an estimator is called."""
    return TITLES.get(name, name)


def traces(name: str, samples: Sequence[Sample], conditions: Conditions) -> list[Trace]:
    """Run one estimator, fresh, over a record.

    Raises:
        ValueError: there is none of that name.
    """
    filters: dict[str, Callable[[], baselines.Filter]] = {
        "inertial": baselines.Inertial,
        "iir": lambda: baselines.Iir(conditions.rate_hz),
        "double": lambda: baselines.Iir(conditions.rate_hz, baselines.DOUBLE_CORNER_HZ, passes=2),
        "kf": lambda: baselines.LinearKalman(conditions.rate_hz, conditions.period_s),
        "ukf": lambda: baselines.OneStep(heave.Params(observer="harmonic")),
    }
    if name in filters:
        filter_ = filters[name]()
        imu = (sample for sample in samples if isinstance(sample, ImuSample))
        values = [filter_.step(sample.t_s, baselines.vertical(sample)) for sample in imu]
        return [Trace(estimator=title(name), heave_m=np.array(values))]
    if name not in OBSERVERS:
        raise ValueError(f"unknown estimator {name!r}: choose from {', '.join(NAMES)}")
    pipe, weights = pipeline(name, conditions), []
    found = frames(pipe, samples, lambda: weights.append(pipe.heave.observer.roll_pitch.weight))
    return _observer_traces(name, found, conditions, np.array(weights))


def pipeline(observer: str, conditions: Conditions) -> Pipeline:
    """The daemon's, with its defaults but for the observer and the horizons. The rock predictor, which shares nothing
    with the heave, is the cheapest there is: the published method with one memory.
    """
    settings = {"observer": observer, "forecast_horizons_s": conditions.horizons_s}
    return assemble(
        heave=msgspec.convert(settings, heave.Params),
        laser=reference.Params(),
        correction=correction.Params(),
        rock=rock.Params(predictor="ml", thetas=(0.7,), horizons_s=()),
        has_laser=conditions.has_laser,
    )


def frames(pipe: Pipeline, samples: Sequence[Sample], after: Callable[[], None] = lambda: None) -> list[MotionFrame]:
    """Every frame of a record; what is due to be learned is learned before the next sample. ``after``: each frame."""
    result = []
    for sample in samples:
        frame = pipe.step(sample)
        learn(pipe)
        if frame is not None:
            result.append(frame)
            after()
    return result


def _observer_traces(
    name: str, found: Sequence[MotionFrame], conditions: Conditions, angles_weight: Array
) -> list[Trace]:
    published = Trace(
        estimator=title(name) + (WITH_LASER if conditions.has_laser else ""),
        heave_m=np.array([frame.heave_m for frame in found]),
        std_m=np.array([frame.heave_std_m for frame in found]),
        forecast={horizon: _ahead(found, k) for k, horizon in enumerate(conditions.horizons_s)},
        delayed=_delayed(found),
        states=tuple(frame.quality.heave for frame in found),
        reasons=tuple(frame.quality.reasons for frame in found),
        correction_m=np.array([frame.correction_m for frame in found]) if conditions.has_laser else None,
        angles_weight=angles_weight,
    )
    if not conditions.has_laser:
        return [published]
    return [Trace(estimator=title(name), heave_m=np.array([frame.observer_m for frame in found])), published]


def _ahead(found: Sequence[MotionFrame], k: int) -> Ahead:
    pairs = [(f.forecast[k].heave_m, f.forecast[k].std_m) if f.forecast else (nan, nan) for f in found]
    values, std = np.array(pairs).T
    return Ahead(values, std)


def _delayed(found: Sequence[MotionFrame]) -> Delayed | None:
    """Several frames may carry the same one: the first counts."""
    rows = []
    last_s = -np.inf
    for frame in found:
        smoothed = getattr(frame, "delayed", None)
        if smoothed is not None and smoothed.t_s > last_s:
            last_s = smoothed.t_s
            rows.append((smoothed.t_s, smoothed.heave_m, smoothed.std_m, frame.t_s - smoothed.t_s))
    return Delayed(*np.array(rows).T) if rows else None


def shares(values: Sequence[str]) -> dict[str, float]:
    """Share of each value, the most frequent first."""
    return {value: count / len(values) for value, count in Counter(values).most_common()}
