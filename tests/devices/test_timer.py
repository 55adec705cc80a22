"""Deadlines: their arithmetic on invented clocks, and that the timer fires, re-arms and survives a cancellation."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from heaved.devices.timer import DeadlineTimer, Heartbeat, Pace, TimeLimit

if TYPE_CHECKING:
    from collections.abc import Callable


def test_deadlines_are_counted_from_the_start() -> None:
    pace = Pace(0.01, 1000.0)
    for number in range(1, 100_001):
        assert pace.advance(1000.0 + (number - 0.5) * 0.01) == 0
    assert pace.due_s == 1000.0 + 100_000 * 0.01


@pytest.mark.parametrize(
    ("now_s", "skipped", "due_s"),
    [
        (10.0, 0, 11.0),  # at once
        (10.9, 0, 11.0),
        (11.9, 0, 11.0),  # late, but the latest that has passed: it is served at once
        (12.1, 1, 12.0),
        (17.5, 6, 17.0),
        (3.0, 0, 11.0),  # a clock before the start
    ],
)
def test_a_stall_is_counted_and_never_bunched(now_s: float, skipped: int, due_s: float) -> None:
    pace = Pace(1.0, 10.0)
    assert pace.advance(now_s) == skipped
    assert pace.due_s == due_s


@given(st.floats(1e-3, 10.0), st.lists(st.floats(0.0, 5.0), max_size=50))
def test_no_deadline_is_lost_or_repeated(period_s: float, polls_s: list[float]) -> None:
    """Served and skipped deadlines together are all there were, whatever the polls take."""
    pace, now_s, number = Pace(period_s, 0.0), 0.0, 0
    for poll_s in polls_s:
        now_s = max(now_s, pace.due_s) + poll_s
        number += 1 + pace.advance(now_s)
        assert pace.due_s == pytest.approx(number * period_s)
        # Never more than one deadline behind.
        assert pace.due_s > now_s - period_s * (1 + 1e-9)


def test_a_period_must_be_positive() -> None:
    with pytest.raises(ValueError, match="positive"):
        Pace(0.0, 0.0)


async def test_deadlines_are_not_early() -> None:
    with DeadlineTimer() as timer:
        for _ in range(5):
            deadline_s = time.monotonic() + 0.003
            lateness_s = await timer.wait_until(deadline_s)
            assert lateness_s >= 0.0
            assert time.monotonic() >= deadline_s


async def test_a_past_deadline_returns_but_lets_the_loop_run() -> None:
    ran: list[bool] = []
    with DeadlineTimer() as timer:
        asyncio.get_running_loop().call_soon(ran.append, True)
        assert await timer.wait_until(time.monotonic() - 5.0) >= 5.0
        assert await timer.wait_until(-1.0) > 0.0
    assert ran


async def test_a_cancelled_wait_leaves_the_timer_usable() -> None:
    with DeadlineTimer() as timer:
        waiting = asyncio.create_task(timer.wait_until(time.monotonic() + 3600.0))
        await asyncio.sleep(0)
        with pytest.raises(RuntimeError, match="already"):
            await timer.wait_until(0.0)
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        deadline_s = time.monotonic() + 0.002
        await timer.wait_until(deadline_s)
        assert time.monotonic() >= deadline_s


class Beats:
    """What a heart does on a loop whose clock and timers the test turns."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 100.0
        self.lateness_s: list[float] = []
        self.due: list[tuple[float, asyncio.Handle]] = []
        loop = asyncio.get_running_loop()
        monkeypatch.setattr(loop, "time", lambda: self.now_s)
        monkeypatch.setattr(loop, "call_at", self._call_at)
        self.heart = Heartbeat(self.lateness_s.append)

    def _call_at(self, due_s: float, callback: Callable[[], None]) -> asyncio.TimerHandle:
        handle = asyncio.TimerHandle(due_s, callback, (), asyncio.get_running_loop())
        self.due.append((due_s, handle))
        self.due.sort(key=lambda entry: entry[0])
        return handle

    def run(self, until_s: float) -> int:
        """To that time; returns how often it beat."""
        before = len(self.lateness_s)
        while self.due and self.due[0][0] <= until_s:
            due_s, handle = self.due.pop(0)
            self.now_s = max(self.now_s, due_s)
            if not handle.cancelled():
                handle._run()
        self.now_s = until_s
        return len(self.lateness_s) - before


async def test_a_heart_beats_once_a_period(monkeypatch: pytest.MonkeyPatch) -> None:
    beats = Beats(monkeypatch)
    beats.heart.put_off()  # Not begun yet: nothing to put off.
    assert beats.due == []
    beats.heart.start(0.01)
    assert beats.run(101.001) == 100
    assert max(beats.lateness_s) < 1e-9
    beats.heart.start(0.1)
    assert beats.run(102.002) == 10
    beats.heart.stop()
    assert beats.run(103.0) == 0


async def test_a_heart_that_is_put_off_does_not_beat_until_two_periods_have_passed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    beats = Beats(monkeypatch)
    beats.heart.start(0.01)
    for number in range(1, 101):
        assert beats.run(100.0 + 0.0099 * number) == 0
        beats.heart.put_off()
    assert beats.run(beats.now_s + 0.0199) == 0
    assert beats.run(beats.now_s + 0.0002) == 1
    assert beats.run(beats.now_s + 0.05) == 5
    assert sum(not handle.cancelled() for _, handle in beats.due) == 1


async def test_a_stall_is_not_followed_by_a_burst(monkeypatch: pytest.MonkeyPatch) -> None:
    beats = Beats(monkeypatch)
    beats.heart.start(0.01)
    beats.now_s += 0.046
    beats.run(beats.now_s)
    # Of what was due at 10, 20, 30 and 40 ms, the first and the last; a millisecond is the loop's own.
    assert beats.lateness_s == pytest.approx([0.035, 0.005])
    assert beats.run(100.0501) == 1


async def test_a_time_limit_is_reached_unless_it_is_lifted_and_costs_few_timers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    beats = Beats(monkeypatch)
    reached: list[float] = []
    limit = TimeLimit(lambda: reached.append(beats.now_s))
    for number in range(100):  # Answered in time, each of them.
        limit.set(0.05)
        beats.run(100.0 + 0.01 * number + 0.002)
        limit.lift()
        beats.run(100.0 + 0.01 * (number + 1))
    assert reached == []
    assert len(beats.due) <= 1
    limit.set(0.05)  # And one that is not.
    beats.run(101.049)
    assert reached == []
    beats.run(101.051)
    assert reached == [pytest.approx(101.05)]
    limit.set(0.2)
    limit.set(0.02)  # In place of the longer one.
    beats.run(102.0)
    assert len(reached) == 2
    limit.set(0.01)
    limit.close()
    beats.run(103.0)
    assert len(reached) == 2
