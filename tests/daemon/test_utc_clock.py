"""UTC against clocks that the test turns."""

from __future__ import annotations

import itertools

import pytest

from heaved.daemon.utc_clock import SLEW, STEP_S, UtcClock

UTC_2026_S = 1_767_225_600.0


class Clocks:
    """A monotonic clock and a system clock that can be set."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.offset_s = UTC_2026_S
        self.interruptions: list[float] = []

    def monotonic(self) -> float:
        return self.now_s

    def realtime(self) -> float:
        utc_s = self.now_s + self.offset_s
        if self.interruptions:  # The process loses the processor between the two clocks.
            self.now_s += self.interruptions.pop()
        return utc_s


@pytest.fixture
def clocks() -> Clocks:
    return Clocks()


@pytest.fixture
def utc(clocks: Clocks) -> UtcClock:
    return UtcClock(clocks.monotonic, clocks.realtime)


def test_offset_and_conversion(utc: UtcClock) -> None:
    assert utc.offset_s == UTC_2026_S
    assert utc.utc_s(1234.5) == UTC_2026_S + 1234.5
    assert utc.steps == 0


def test_reads_that_were_interrupted_do_not_count(clocks: Clocks) -> None:
    clocks.interruptions = [0.3, 0.2]
    assert UtcClock(clocks.monotonic, clocks.realtime).offset_s == UTC_2026_S


@pytest.mark.parametrize("step_s", [3600.0, -3600.0, 0.6, -0.6])
def test_a_step_is_adopted_at_once_and_counted(clocks: Clocks, utc: UtcClock, step_s: float) -> None:
    clocks.now_s += 1.0
    clocks.offset_s += step_s
    assert utc.update() == pytest.approx(step_s)
    assert utc.offset_s == pytest.approx(UTC_2026_S + step_s)
    assert utc.steps == 1
    assert utc.update() == 0.0


@pytest.mark.parametrize("drift_s", [0.4, -0.4])
def test_a_small_departure_is_slewed(clocks: Clocks, utc: UtcClock, drift_s: float) -> None:
    clocks.offset_s += drift_s
    offsets = [utc.offset_s]
    for _ in range(200):
        clocks.now_s += 1.0
        assert utc.update() == 0.0
        offsets.append(utc.offset_s)
    steps = [after - before for before, after in itertools.pairwise(offsets)]
    assert max(map(abs, steps)) <= SLEW * 1.0 + 1e-6
    # Published times would have to go back by more than a second in a second to stop increasing.
    assert min(steps) > -1.0
    assert offsets[-1] == pytest.approx(UTC_2026_S + drift_s, abs=1e-6)
    assert utc.steps == 0


def test_the_border_between_slew_and_step(clocks: Clocks, utc: UtcClock) -> None:
    clocks.now_s += 1.0
    clocks.offset_s += STEP_S - 0.001
    assert utc.update() == 0.0
    clocks.offset_s += 0.01
    assert utc.update() != 0.0
