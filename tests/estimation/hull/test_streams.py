"""Two streams of unlike rates on one time base: what comes out must be the motion at the instants of the grid."""

from __future__ import annotations

import numpy as np
import pytest

from heaved.estimation.common.rotations import ARCSEC, rotation_vector
from heaved.estimation.hull.estimate import HullState, HullWarning, Params
from heaved.estimation.hull.estimator import HullDeformation
from heaved.estimation.hull.streams import TwoStreams
from heaved.simulate.flexure import SCENES, simulate


def stamps(rng: np.random.Generator, rate_hz: float, end_s: float, jitter: float = 0.2) -> np.ndarray:
    """Increasing instants, each off its place by up to ``jitter`` of a step."""
    n = int(end_s * rate_hz)
    return (np.arange(1, n + 1) + jitter * rng.uniform(-1.0, 1.0, n)) / rate_hz


def tone(t: np.ndarray) -> np.ndarray:
    """Rates of a ship that rolls 4 deg at 8 s, pitches 2 deg at 6 s, yaws 3 deg at 10 s."""
    a, w = np.radians([4.0, 2.0, 3.0]), 2.0 * np.pi / np.array([8.0, 6.0, 10.0])
    return np.asarray(a * w * np.cos(np.multiply.outer(t, w)))


def merged(*streams: np.ndarray) -> list[tuple[int, int]]:
    """(stream, index) in order of time."""
    keys = [(float(t), k, i) for k, times in enumerate(streams) for i, t in enumerate(times)]
    return [(k, i) for _, k, i in sorted(keys)]


@pytest.mark.parametrize(
    ("midships_hz", "local_hz", "grid_hz"),
    [
        (10.0, 10.0, 10.0),
        (100.0, 24.0, 24.0),
        (50.0, 10.0, 10.0),
        (12.5, 100.0, 12.5),
        (10.0, 5.0, 10.0),
        (50.0, 50.0, 25.0),
    ],
)
def test_the_grid_follows_the_slower_stream_and_says_when_each_rate_was(
    midships_hz: float, local_hz: float, grid_hz: float
) -> None:
    """A reading of a stream that is not averaged is what it was, when it was; what is averaged is flat to 1e-5."""
    rng = np.random.default_rng(1)
    times = stamps(rng, midships_hz, 30.0), stamps(rng, local_hz, 30.0)
    streams = TwoStreams(10.0)
    pairs = []
    for k, i in merged(*times):
        (streams.midships, streams.local)[k].push(times[k][i], tone(times[k][i : i + 1])[0])
        pairs += streams.due()
    assert streams.rate_hz == pytest.approx(grid_hz, rel=0.05)
    t = np.array([p.t_s for p in pairs])
    assert np.allclose(np.diff(t), 1.0 / streams.rate_hz)
    assert t[0] < 0.5
    assert t[-1] > 29.0
    for own_hz, rates, after_s in (
        (midships_hz, np.array([p.midships_radps for p in pairs]), np.array([p.midships_after_s for p in pairs])),
        (local_hz, np.array([p.local_radps for p in pairs]), np.array([p.local_after_s for p in pairs])),
    ):
        known = np.isfinite(rates[:, 0])
        is_fast = own_hz > streams.rate_hz / 0.75
        assert np.mean(known[t > 1.0]) > 0.9 * min(1.0, own_hz / streams.rate_hz)
        off = np.max(np.abs(rates - tone(t + after_s))[known])
        assert off < (1e-5 if is_fast else 1e-12)
        assert not (is_fast and after_s.any())
        assert np.max(np.abs(after_s)) <= 1.0 / streams.rate_hz
        assert np.all(np.diff((t + after_s)[known]) > 0.0)


def test_a_fast_stream_is_averaged() -> None:
    """Under the taper a quarter of the 25 readings is left of a cubic's; what would fold to 0 Hz is gone."""
    rng = np.random.default_rng(2)
    t = np.arange(1, 6001) / 100.0
    noise = rng.standard_normal((len(t), 3))
    vibration = np.cos(2.0 * np.pi * 25.0 * t)[:, None] * np.ones(3)
    for values, allowed in ((noise, 1.2 * np.sqrt(9.0 / 4.0 / 12.5)), (vibration, 4e-3)):
        streams = TwoStreams(10.0)
        got = []
        for time, rates in zip(t.tolist(), values, strict=True):
            streams.midships.push(time, rates)
            streams.local.push(time, rates)
            got += [p.midships_radps for p in streams.due()]
        assert np.std(np.array(got)[20:]) < allowed


def test_holes_are_holes_and_silence_is_not_waited_for() -> None:
    t = np.arange(1, 301) / 20.0
    streams = TwoStreams(10.0)
    pairs = []
    for time in t.tolist():
        streams.midships.push(time, tone(np.array([time]))[0])
        if not 5.0 < time < 9.0:
            streams.local.push(time, tone(np.array([time]))[0])
        pairs += streams.due()
        assert not pairs or time - pairs[-1].t_s < 1.2
    missing = [p.t_s for p in pairs if p.t_s > 1.0 and np.isnan(p.local_radps).all()]
    assert min(missing) == pytest.approx(5.0, abs=0.2)
    assert max(missing) == pytest.approx(9.0, abs=0.2)
    assert len(missing) == pytest.approx(80, abs=3)
    assert all(np.isfinite(p.midships_radps).all() for p in pairs if p.t_s > 0.5)


def test_rubbish_is_dropped_and_no_more_is_due_than_there_can_be() -> None:
    streams = TwoStreams(10.0, max_rate_hz=50.0)
    good = np.array([0.01, 0.02, 0.03])
    streams.local.push(1.0, good)
    for t, rates in ((np.nan, good), (0.5, good), (2.0, good * np.nan), (np.inf, good)):
        streams.local.push(t, rates)
    assert streams.local.t_s == 1.0
    rng = np.random.default_rng(3)
    for k in range(20_000):
        streams.local.push(1.0 + 1e-3 * k, rng.standard_normal(3))
    assert len(streams.due()) < 1000


def test_a_clock_that_steps_moves_the_grid() -> None:
    streams = TwoStreams(10.0)
    pairs = []
    for t in [*(100.0 + np.arange(60) / 20.0), *(50.0 + np.arange(60) / 20.0), *(900.0 + np.arange(60) / 20.0)]:
        for stream in (streams.midships, streams.local):
            stream.push(float(t), tone(np.array([t]))[0])
        got = streams.due()
        assert len(got) <= 101
        pairs += got
    t = np.array([p.t_s for p in pairs])
    assert [round(float(start)) for start in t[np.abs(np.diff(t, prepend=0.0)) > 1.0]] == [100, 50, 900]
    known = np.array([np.isfinite(p.local_radps).all() for p in pairs])
    assert known.mean() > 0.9
    settled = [p for p in pairs if np.isfinite(p.local_radps).all()]
    taken = np.array([p.t_s + p.local_after_s for p in settled])
    assert np.array([p.local_radps for p in settled]) == pytest.approx(tone(taken), abs=1e-12)


def test_two_imus_of_unlike_rate_push_the_deformation() -> None:
    """50 Hz amidships, 20 Hz at the crane, both with jitter; its stamps are 30 ms early, and 5 ms late by the scene."""
    rng = np.random.default_rng(4)
    scene = SCENES["A4"]
    times = stamps(rng, 50.0, 60.0, 0.1), stamps(rng, 20.0, 60.0, 0.1)
    record = simulate(scene, 3, times[0], times[1] + 0.03)
    estimator = HullDeformation(Params())
    push = (estimator.push_midships, estimator.push_local)
    rates = (record.midships_radps, record.local_radps)
    for k, i in merged(*times):
        estimate = push[k](times[k][i], rates[k][i])
        last = estimate or estimator.latest
    assert last is not None
    assert last.angles.state in (HullState.CONVERGING, HullState.CONVERGED)
    assert HullWarning.LOW_RATE_LOCAL not in last.angles.warnings
    row = int(np.argmin(np.abs(record.midships_t_s - last.angles.t_s)))
    error = rotation_vector(record.deformation()[row].T @ last.local_from_midships)
    assert np.max(np.abs(error) / np.array(last.angles.std_rad)) < 4.0
    assert last.angles.delay_s == pytest.approx(0.005 - 0.03, abs=2e-3)


def test_a_stream_at_half_the_rate_or_held_by_its_slave_is_named_and_used() -> None:
    fast = np.arange(1, 1201) / 20.0
    slow = np.arange(1, 301) / 5.0
    record = simulate(SCENES["A1"], 6, fast, slow)
    estimator = HullDeformation(Params())
    for i, t in enumerate(fast.tolist()):
        estimator.push_midships(t, record.midships_radps[i])
        newest = int(np.floor(t * 5.0 + 1e-9)) - 1
        if newest >= 0:
            estimator.push_local(t, record.local_radps[newest])
    last = estimator.latest
    assert last is not None
    assert HullWarning.LOW_RATE_LOCAL in last.angles.warnings
    assert HullWarning.STUCK_LOCAL not in last.angles.warnings
    assert last.angles.state in (HullState.CONVERGING, HullState.CONVERGED)
    row = int(np.argmin(np.abs(fast - last.angles.t_s)))
    error = rotation_vector(record.deformation()[row].T @ last.local_from_midships) / ARCSEC
    assert np.max(np.abs(error)) < 60.0
