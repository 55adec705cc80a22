"""What gives way when the loop does not keep up, and when it is taken up again."""

from __future__ import annotations

import pytest

from heaved.daemon.load import TUNING, Load, Relief

PERIOD_S = 0.01


class Clock:
    """Asks a load for so many seconds, each answer late by as much."""

    def __init__(self) -> None:
        self.load, self.now_s = Load(), 1000.0

    def passes(self, seconds: float, late_s: float) -> list[Relief]:
        """What gave way, changes alone."""
        changes = []
        for _ in range(round(seconds / TUNING.probe_s)):
            self.now_s += TUNING.probe_s
            if self.load.step(self.now_s, late_s, PERIOD_S):
                changes.append(self.load.relief)
        return changes


LATE_S, IN_TIME_S = 1.2 * PERIOD_S, 0.8 * PERIOD_S


def test_more_gives_way_for_as_long_as_the_loop_does_not_keep_up_and_comes_back_step_by_step() -> None:
    clock = Clock()
    assert clock.passes(60.0, IN_TIME_S) == []
    assert clock.passes(TUNING.busy_s + 2.0, LATE_S) == [Relief.GATHERED]
    assert clock.passes(60.0, LATE_S) == [Relief.LEFT_OUT]
    assert clock.passes(TUNING.calm_s - 2.0, IN_TIME_S) == []
    assert clock.passes(2.0 * TUNING.calm_s + 4.0, IN_TIME_S) == [Relief.GATHERED, Relief.NONE]


@pytest.mark.parametrize("held_up_s", [0.05, 1.0, 30.0])
def test_a_loop_that_was_held_up_once_keeps_up(held_up_s: float) -> None:
    """A stopped process, a machine that slept: one answer is very late."""
    clock = Clock()
    clock.passes(20.0, IN_TIME_S)
    clock.now_s += held_up_s
    assert not clock.load.step(clock.now_s, held_up_s, PERIOD_S)
    assert clock.passes(20.0, IN_TIME_S) == []


def test_what_is_late_by_less_than_matters_is_in_time() -> None:
    clock = Clock()
    for _ in range(2000):
        clock.now_s += TUNING.probe_s
        # A polling rate of 1000 a second: half a period is less than the loop's timers can tell.
        assert not clock.load.step(clock.now_s, 0.9 * TUNING.late_least_s, 0.001)


def test_what_has_to_give_way_again_soon_stays_so_for_longer() -> None:
    clock = Clock()
    needed: list[float] = []
    for _ in range(8):
        clock.passes(60.0, LATE_S)
        since_s, changes = clock.now_s, 0
        while changes < 2:
            changes += len(clock.passes(TUNING.probe_s, IN_TIME_S))
        needed.append(clock.now_s - since_s)
    assert needed[:3] == sorted(needed[:3])
    assert needed[0] < 3.0 * TUNING.calm_s
    assert needed[-1] > 10.0 * needed[0]
    assert max(needed) < 2.0 * TUNING.calm_most_s + 25.0
    # Long after it is as at the beginning.
    clock.passes(2.0 * TUNING.calm_most_s, IN_TIME_S)
    clock.passes(60.0, LATE_S)
    assert clock.passes(3.0 * TUNING.calm_s, IN_TIME_S) == [Relief.GATHERED, Relief.NONE]
