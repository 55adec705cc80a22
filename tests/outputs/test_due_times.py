"""What is due: at exactly the wanted mean rate, each the nearest to its due time."""

from __future__ import annotations

import random

import pytest

from heaved.outputs.due_times import DueTimes


def taken(times_s: list[float], rate_hz: float | None) -> list[float]:
    due = DueTimes(rate_hz)
    return [t_s for t_s in times_s if due.is_due(t_s)]


def test_without_a_rate_everything_is() -> None:
    times_s = [0.0, 0.0, 0.1, 0.05, 7.0]
    assert taken(times_s, None) == times_s


COME_HZ = (7.3, 20.0, 100.0, 123.4)
RATES_HZ = (0.1, 1.0, 3.0, 7.0, 10.0, 30.0, 70.0, 99.0)


@pytest.mark.parametrize(
    ("come_hz", "rate_hz"), [(come, rate) for come in COME_HZ for rate in RATES_HZ if rate <= come]
)
@pytest.mark.parametrize("jitter", [0.0, 0.4])
def test_the_mean_rate_is_the_wanted_one_and_the_nearest_is_taken(
    come_hz: float, rate_hz: float, jitter: float
) -> None:
    """Against the definition: due at whole periods after the first, and for each the nearest of all that come."""
    random.seed(1)
    count = round(1000 * come_hz / rate_hz)
    times_s = [(i + jitter * random.uniform(-0.5, 0.5)) / come_hz for i in range(count)]
    found = taken(times_s, rate_hz)
    assert len(found) == pytest.approx(1000, abs=1.5)
    if not jitter:
        off_s = [t_s - times_s[0] - k / rate_hz for k, t_s in enumerate(found)]
        assert max(map(abs, off_s)) <= 0.5 / come_hz + 1e-9


def test_what_comes_more_seldom_is_all_taken() -> None:
    """A STATUS comes a little less than once a second, for a client that wants one a second."""
    times_s = [1.0013 * i for i in range(5000)]
    assert taken(times_s, 1.0) == times_s


def test_after_a_gap_the_next_one_is_due_and_nothing_is_made_up_for() -> None:
    times_s = [0.01 * i for i in range(100)] + [10.0 + 0.01 * i for i in range(100)]
    found = taken(times_s, 10.0)
    assert 10.0 in found
    assert sum(t_s >= 10.0 for t_s in found) == pytest.approx(10, abs=1)
