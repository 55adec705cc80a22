"""What held when, against a loop that takes one frame after the other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heaved.report.timeline import HOLDS_S, MOST_KINDS, OTHERS, Spells, Timeline

NAMES = ("a", "b", "c")
frames = st.lists(
    st.tuples(st.sampled_from([0.05, 0.05, 0.5, 1.0, 3.0]), st.sets(st.sampled_from(NAMES))), min_size=1, max_size=50
)


def looped(steps: list[tuple[float, set[str]]], name: str) -> Spells:
    """One frame after the other."""
    t_s, seconds, spells, longest_s, now_s, first_s, last_s = 10.0, 0.0, 0, 0.0, 0.0, float("nan"), float("nan")
    for step_s, held in steps:
        lasts_s = min(step_s, HOLDS_S)
        if name in held:
            if now_s == 0.0:
                spells += 1
                first_s = t_s if spells == 1 else first_s
            now_s += lasts_s
            seconds += lasts_s
            longest_s = max(longest_s, now_s)
            last_s = t_s + lasts_s
        else:
            now_s = 0.0
        if step_s > HOLDS_S:
            now_s = 0.0
        t_s += step_s
    return Spells(seconds=seconds, spells=spells, longest_s=longest_s, first_s=first_s, last_s=last_s)


@given(frames, st.integers(1, 20))
def test_spells_are_those_of_a_loop_however_they_come_in_blocks(steps: list[tuple[float, set[str]]], size: int) -> None:
    timeline = Timeline(bins=16, width_s=0.25)
    t_s = 10.0 + np.concatenate(([0.0], np.cumsum([step for step, _ in steps])))
    for begin in range(0, len(steps), size):
        part = steps[begin : begin + size]
        timeline.push(
            t_s[begin : begin + len(part)],
            np.array([step for step, _ in part]),
            [tuple(timeline.place(name) for name in sorted(held)) for _, held in part],
        )
    for name in NAMES:
        found, expected = timeline.spells(name), looped(steps, name)
        assert found.spells == expected.spells
        for key in ("seconds", "longest_s", "first_s", "last_s"):
            assert getattr(found, key) == pytest.approx(getattr(expected, key), nan_ok=True), key
        lane = timeline.lane(name)
        # What is cut off are holds that reach over the end of their bin.
        assert float(lane.share.sum() * lane.width_s) <= expected.seconds + 1e-9
        if expected.spells == 0:
            assert not lane.share.any()
    told = sum(min(step, HOLDS_S) for step, _ in steps)
    assert timeline.seconds == pytest.approx(told)
    assert timeline.seconds + timeline.silent_s == pytest.approx(sum(step for step, _ in steps))


def test_a_lane_shows_the_share_of_each_bin() -> None:
    timeline = Timeline(bins=8, width_s=1.0)
    place = timeline.place("held")
    t_s: np.ndarray = np.arange(40) * 0.1
    timeline.push(t_s, np.full(40, 0.1), [(place,) if 1.0 <= t < 1.5 or t >= 3.0 else () for t in t_s.tolist()])
    lane = timeline.lane("held")
    assert lane.begin_s.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert lane.share.tolist() == pytest.approx([0.0, 0.5, 0.0, 1.0])


def test_a_day_has_no_more_bins_than_a_minute() -> None:
    timeline = Timeline(bins=8, width_s=1.0)
    place = timeline.place("held")
    for begin in range(0, 86400, 3600):
        t_s = begin + np.arange(3600.0)
        timeline.push(t_s, np.ones(3600), [(place,)] * 3600)
    lane = timeline.lane("held")
    assert len(lane.share) <= 8
    assert timeline.spells("held") == Spells(seconds=86400.0, spells=1, longest_s=86400.0, first_s=0.0, last_s=86400.0)


def test_more_kinds_than_there_is_room_for_are_one() -> None:
    timeline = Timeline()
    places = [timeline.place(f"kind {i}") for i in range(3 * MOST_KINDS)]
    timeline.push(np.array([0.0]), np.array([1.0]), [tuple(dict.fromkeys(places))])
    assert len(timeline.names) == MOST_KINDS + 1
    assert timeline.spells(OTHERS).seconds == 1.0
    assert timeline.spells("kind 0").seconds == 1.0
    assert timeline.spells("never seen") == Spells()
