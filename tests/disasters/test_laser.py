"""What goes wrong with a laser: one table of disasters over two seas, for one that aids and for one that teaches.

Oracle: the simulator's truth, and the same recording without a laser. A lie is an error of more than four published
standard deviations while ``valid``. What is done to the readings is of the table of ``tools/accuracy.py faults`` where
that has it.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import cache
from math import inf
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np
import pytest
from evidence.faults.disasters import Deed, blank, creeping, mapped, noisy, raised, rows
from evidence.faults.moves import Span
from numpy.typing import NDArray
from pipelines import pipeline, rms

from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, reference
from heaved.estimation.heave.sea.refit import SeaFit, SeaWindow, look
from heaved.samples import HeaveState, LaserSample, LaserState, MotionFrame
from heaved.simulate.gauge import LASER_DISTANCE_M
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import Recording, record

if TYPE_CHECKING:
    from heaved.pipeline import Pipeline

Array = NDArray[np.float64]
Instead = Callable[[Array, Array, np.random.Generator], Array]
"""Readings (n,) at times (n,) since the beginning of the disaster, of honest ones; nan: there is none."""


class Change(NamedTuple):
    """What is done to the laser, and for how long."""

    deed: Deed
    lasts_s: float = inf


SETTLED_S, BEGIN_S, END_S = 40.0, 120.0, 220.0
RATE_HZ = 20.0
NEAR_M = 0.004
"""Errors that make no difference, in metres: twice the noise of a reading."""


@cache
def sea(name: str) -> Recording:
    return record(seaway(name, 5), END_S, imu_rate_hz=RATE_HZ, sensor="A", seed=5)


_fits: dict[bytes, SeaFit] = {}


def looked(window: SeaWindow) -> SeaFit:
    """A fit of the sea, which no disaster of the laser changes: made once for all of them."""
    key = msgspec.json.encode(window)
    if key not in _fits:
        _fits[key] = look(window)
    return _fits[key]


Frames = list[tuple[float, MotionFrame]]


def run(pipe: Pipeline, name: str, start_s: float, end_s: float, change: Change | None = None) -> Frames:
    """Frames from ``start_s`` to ``end_s``, each with the error of its heave; the laser changed as asked."""
    honest, frames = sea(name), []
    delivered = rows(honest, (honest.t_s >= start_s) & (honest.t_s < end_s))
    if change is not None:
        delivered = change.deed(delivered, Span(start_s, start_s + change.lasts_s), np.random.default_rng(7))
    truth = dict(zip(delivered.t_s.tolist(), delivered.truth.heave_m.tolist(), strict=True))
    for sample in delivered.samples():
        frame = pipe.step(sample)
        if (window := pipe.fit_due()) is not None:
            pipe.accept_fit(looked(window))
        if frame is not None:
            frames.append((frame.heave_m - truth[frame.t_s], frame))
    return frames


@cache
def before(name: str, role: str, begin_s: float) -> Pipeline:
    """A pipeline up to the disaster; role "": without a laser."""
    pipe = pipeline(
        has_laser=bool(role),
        heave_params=heave.Params(forecast_horizons_s=()),
        laser_params=msgspec.convert({"role": role or "reference"}, reference.Params),
        correction_params=correction.Params(enabled=False),
    )
    run(pipe, name, 0.0, begin_s)
    return pipe


@cache
def suffered(name: str, role: str, begin_s: float, change: Change | None) -> tuple[Pipeline, Frames]:
    pipe = copy.deepcopy(before(name, role, begin_s))
    return pipe, run(pipe, name, begin_s, END_S, change)


def errors(frames: Frames, start_s: float = 0.0) -> Array:
    return np.array([error for error, frame in frames if frame.t_s >= start_s])


def stds(frames: Frames, start_s: float = 0.0) -> Array:
    return np.array([frame.heave_std_m for _, frame in frames if frame.t_s >= start_s])


def reasons(frames: Frames) -> str:
    return "\n".join(sorted({reason for _, frame in frames for reason in frame.quality.reasons}))


def lies(frames: Frames) -> int:
    return sum(f.quality.heave is HeaveState.VALID and abs(e) > 4.0 * f.heave_std_m for e, f in frames)


LASER = ("laser_m",)


def of(instead: Instead) -> Change:
    """Other readings from its beginning on."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        inside = span.holds(recording.t_s)
        values = instead(recording.t_s - span.start_s, recording.laser_m, rng)
        return msgspec.structs.replace(recording, laser_m=np.where(inside, values, recording.laser_m))

    return Change(deed)


def during(seconds: float, change: Change) -> Change:
    return Change(change.deed, seconds)


def leap(metres: float) -> Change:
    return Change(raised("laser_m", metres))


def times(ratio: float) -> Change:
    return Change(mapped(LASER, lambda m: ratio * m))


OPPOSED = Change(mapped(LASER, lambda m: 2.0 * LASER_DISTANCE_M - m))
SILENT = Change(blank(LASER, 1.0))
NOISY = Change(noisy(LASER, 0.01))
"""Five times what is configured."""
SHORT = Change(mapped(LASER, lambda m: np.clip(m, LASER_DISTANCE_M - 0.25, LASER_DISTANCE_M + 0.25)))
"""The end of its range lies within the waves."""


@of
def boat(t: Array, m: Array, rng: np.random.Generator) -> Array:
    return 2.0 + 0.2 * np.sin(1.1 * t) + 0.01 * rng.standard_normal(len(t))


@of
def ship(t: Array, m: Array, rng: np.random.Generator) -> Array:
    """A target that moves with the sensor."""
    return 7.0 + 0.002 * rng.standard_normal(len(t))


@of
def spray(t: Array, m: Array, rng: np.random.Generator) -> Array:
    return np.where(rng.random(len(t)) < 0.1, m + rng.standard_normal(len(t)), m)


@of
def random(t: Array, m: Array, rng: np.random.Generator) -> Array:
    return np.where(np.isnan(m), np.nan, rng.uniform(0.0, 30.0, len(t)))


def late(seconds: float) -> Change:
    count = round(seconds * RATE_HZ)
    return of(lambda t, m, rng: np.concatenate((m[:1].repeat(count), m[:-count])))


def one_in(count: int) -> Change:
    return of(lambda t, m, rng: np.where(np.arange(len(t)) % count == 0, m, np.nan))


def then(first: Change, second: Change, after_s: float) -> Change:
    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        begun = first.deed(recording, Span(span.start_s, span.start_s + after_s), rng)
        return second.deed(begun, Span(span.start_s + after_s, span.end_s), rng)

    return Change(deed)


class Disaster(msgspec.Struct, frozen=True):
    name: str
    change: Change
    says: str
    """Part of a reason that must be given; "": nothing is said of the laser."""
    is_over: bool = True
    """Whether the laser aids again, or still, in the last half minute."""
    begin_s: float = BEGIN_S


NO_AID = "laser: no aid for "
AIDING = [
    Disaster("nothing", leap(0.0), ""),
    Disaster("a leap of 1 m", leap(1.0), "another target"),
    Disaster("a leap of 5 cm", leap(0.05), NO_AID),
    Disaster("a leap of 3 cm", leap(0.03), NO_AID),
    Disaster("a leap while it settles", during(15.0, leap(1.0)), "no fresh reference", begin_s=SETTLED_S),
    Disaster("a leap in a pause", then(SILENT, leap(-0.7), 10.0), "another target"),
    Disaster("a pause", during(30.0, SILENT), "no fresh reference"),
    Disaster("zero", during(30.0, times(0.0)), "laser: stuck"),
    Disaster("stuck", times(0.0), "laser: stuck", False),
    Disaster("opposed for a while", during(30.0, OPPOSED), NO_AID),
    Disaster("opposed", OPPOSED, "it moves against the heave: sign?", False, SETTLED_S),
    Disaster("a boat", during(20.0, boat), NO_AID),
    Disaster("a part of the ship", ship, "it does not follow the heave", False, SETTLED_S),
    Disaster("millimetres", times(1000.0), "no fresh reference", False, SETTLED_S),
    Disaster("feet", times(3.2808), "it shows 3.28 times the heave: is it in feet?", False, SETTLED_S),
    Disaster("late by 0.3 s", late(0.3), "s behind the accelerometer: latency_ms?", False, SETTLED_S),
    Disaster("random", random, NO_AID, False),
    Disaster("spray", spray, ""),
    Disaster("noise", NOISY, ""),
    Disaster("a short range", SHORT, "laser: stuck"),
    Disaster("a target that gives way", Change(creeping("laser_m", 0.01 / 60.0)), ""),
    Disaster("one reading a second", one_in(20), "no fresh reference", begin_s=SETTLED_S),
]


@pytest.mark.parametrize(
    ("disaster", "name"),
    [(d, "S6" if i % 3 == 1 else "S4") for i, d in enumerate(AIDING)],
    ids=lambda v: v if isinstance(v, str) else v.name,
)
def test_an_aiding_laser_never_makes_the_heave_lie(disaster: Disaster, name: str) -> None:
    _, alone = suffered(name, "", disaster.begin_s, None)
    _, frames = suffered(name, "aiding", disaster.begin_s, disaster.change)
    assert lies(frames) <= lies(alone)
    assert np.nanmax(np.abs(errors(frames))) < 1.25 * np.nanmax(np.abs(errors(alone))) + NEAR_M
    told = reasons(frames)
    assert disaster.says in told
    assert disaster.says or "laser: no aid" not in told
    last_s = END_S - 30.0
    error_m, alone_m = rms(errors(frames, last_s)), rms(errors(alone, last_s))
    if disaster.is_over:
        assert rms(errors(frames, END_S - 60.0)) < 0.75 * rms(errors(alone, END_S - 60.0))
        assert error_m < 1.1 * alone_m
        assert frames[-1][1].quality.laser is LaserState.VALID or "one" in disaster.name
    else:  # It is the heave without a laser, and as sure of itself.
        assert error_m < 1.1 * alone_m
        assert np.mean(stds(frames, last_s)) == pytest.approx(np.mean(stds(alone, last_s)), rel=0.4)
        assert frames[-1][1].quality.laser is LaserState.STALE


@pytest.mark.parametrize("ratio", [0.97, 1.03])
def test_a_scale_that_laser_and_accelerometer_differ_by_makes_no_lie(ratio: float) -> None:
    """Neither can say which of them is wrong."""
    _, frames = suffered("S6", "aiding", SETTLED_S, times(ratio))
    assert lies(frames) == 0


def test_without_a_fault_an_aiding_laser_is_worth_what_it_was() -> None:
    """Millimetres, while the accelerometer alone is off by centimetres."""
    for name, most_m in (("S4", 0.0025), ("S6", 0.005)):
        _, frames = suffered(name, "aiding", BEGIN_S, leap(0.0))
        late = errors(frames, BEGIN_S + 30.0)
        assert rms(late) < most_m
        assert np.mean(np.abs(late) < 1.96 * stds(frames, BEGIN_S + 30.0)) > 0.9


TEACHING = [
    ("millimetres", times(1000.0), "no fresh reference"),
    ("centimetres", times(100.0), "it shows 100 times the heave: is it in cm?"),
    ("feet", times(3.2808), "it shows 3.28 times the heave: is it in feet?"),
    ("a fifth too much", times(1.2), "it shows 1.2 times the heave: scale?"),
    ("opposed", OPPOSED, "it moves against the heave: sign?"),
    ("a part of the ship", ship, "it does not follow the heave"),
    ("stuck", times(0.0), "laser: stuck"),
    ("random", random, "no fresh reference"),
]


@pytest.mark.parametrize(("name", "change", "says"), TEACHING, ids=[row[0] for row in TEACHING])
def test_a_laser_that_does_not_show_the_heave_teaches_nothing_and_is_named(
    name: str, change: Change, says: str
) -> None:
    _, alone = suffered("S4", "", SETTLED_S, None)
    pipe, frames = suffered("S4", "reference", SETTLED_S, change)
    assert says in reasons(frames)
    summary = pipe.summary()
    assert (summary.gain_learned, summary.lead_comparisons) == (1.0, 0)
    assert errors(frames) == pytest.approx(errors(alone), abs=1e-12, nan_ok=True)
    assert np.all((stds(frames) >= 0.999 * stds(alone))[np.isfinite(stds(alone))])
    assert frames[-1][1].quality.laser is LaserState.STALE
    wide = stds(frames) > 3.5 * stds(alone)
    assert all("laser and observer disagree" in f.quality.reasons for (_, f), w in zip(frames, wide, strict=True) if w)


def test_a_lead_beyond_what_sensors_have_is_told() -> None:
    pipe, frames = suffered("S6", "reference", SETTLED_S, late(0.7))
    assert pipe.summary().lead_learned_s == pytest.approx(0.7, abs=0.05)
    assert "laser: it is 0.7 s behind the accelerometer: latency_ms?" in reasons(frames)


PASSING = {
    "a leap of 1 m": leap(1.0),
    "opposed for a while": during(30.0, OPPOSED),
    "spray": spray,
    "a short range": SHORT,
    "a leap in a pause": then(SILENT, leap(-0.7), 10.0),
}


@pytest.mark.parametrize("change", PASSING.values(), ids=PASSING)
def test_what_happens_to_a_laser_for_a_while_is_not_learned(change: Change) -> None:
    pipe, frames = suffered("S4", "reference", BEGIN_S, change)
    clean, usual = suffered("S4", "reference", BEGIN_S, leap(0.0))
    assert lies(frames) == 0
    a, b = pipe.summary(), clean.summary()
    assert a.gain_learned == pytest.approx(b.gain_learned, abs=0.01)
    assert a.lead_learned_s == pytest.approx(b.lead_learned_s, abs=0.02)
    ratio = stds(frames) / stds(usual)
    assert float(np.min(ratio)) > 0.8
    # Lead and gain from spray are less well known, which shows at the crests.
    assert rms(stds(frames)) < 2.0 * rms(stds(usual))


def test_readings_from_before_the_first_fit_do_no_harm() -> None:
    """And one that is far in the future, or no number."""
    pipe = copy.deepcopy(before("S4", "aiding", SETTLED_S))
    for odd in (LaserSample(t_s=1.0, laser_m=3.0), LaserSample(t_s=SETTLED_S, laser_m=np.nan)):
        pipe.step(odd)
    assert lies(run(pipe, "S4", SETTLED_S, 100.0)) == 0
