"""tools/accuracy.py correction: with a network in use the heave is never worse than its own observer's, and better.

Oracle: the truth of the simulated sea. Trained as in a replay; a short run of what the tool runs for long.
"""

from __future__ import annotations

from functools import cache
from math import inf, nan

import msgspec
import pytest
from evidence.heave.correction import Outcome, Segment, Trial, report, run

from heaved.estimation.heave.laser import correction, ridge

TRIALS = {
    sea: Trial(sea=sea, laser="180+120,360+60", duration_s=420.0, rate_hz=10.0, seed=seed)
    for sea, seed in (("S6", 2), ("T3", 1))
}
"""Sensor B, whose lag nobody but the network learns: see there. Two minutes without the laser, and one."""
NEVER_WORSE = 1.02
"""Corrected over observed error in any segment: what lies above 1 is chance, of a minute's few waves."""
GAINED = 0.9
"""Over all: a network that is accepted takes a tenth off (the long runs: 0.3 to 0.75 is left)."""


CHANCE = Trial(sea="S6", sensor="slow B", laser="50%", duration_s=360.0, taught=True)
"""A sensor whose lag the laser has taught: what is left beats, and for a minute a network may seem to follow it."""


@cache
def outcome(sea: str) -> Outcome:
    return run(TRIALS[sea])


@pytest.mark.parametrize("sea", TRIALS)
def test_a_network_is_taken_into_use_and_applied(sea: str) -> None:
    found = outcome(sea)
    assert found.verdicts["accepted"] >= 1
    assert found.verdicts["failed"] == 0
    assert found.accepted_s < 260.0  # Nothing is learned before it is known where the gauge is.
    assert [part.laser_on for part in found.segments][-3:] == [False, True, False]
    assert all(part.in_use > 0.8 for part in found.segments)


@pytest.mark.parametrize("sea", TRIALS)
def test_the_correction_is_never_worse_than_its_observer_and_gains(sea: str) -> None:
    segments = outcome(sea).segments
    print(report([outcome(sea)]))
    assert {part.laser_on for part in segments} == {True, False}
    assert max(part.ratio for part in segments) < NEVER_WORSE
    for laser_on in (True, False):
        kept = [part for part in segments if part.laser_on is laser_on]
        assert sum(part.corrected_rms_m for part in kept) < GAINED * sum(part.observer_rms_m for part in kept)


def test_a_network_that_agrees_with_the_laser_by_chance_does_no_harm(monkeypatch: pytest.MonkeyPatch) -> None:
    """No chance is waited for: networks are accepted that are no better, and a little worse, on what was held out."""
    monkeypatch.setattr(correction, "TUNING", msgspec.structs.replace(correction.TUNING, worth=1.5))
    monkeypatch.setattr(ridge, "TUNING", msgspec.structs.replace(ridge.TUNING, linear=inf))
    found = run(CHANCE)
    print(report([found]))
    assert found.verdicts["accepted"] >= 1
    assert max(part.ratio for part in found.segments) < 1.01


def test_the_report_pools_by_time_and_names_the_worst() -> None:
    parts = tuple(
        Segment(
            start_s=start, end_s=start + length, laser_on=False, sigma_m=1.0, observer_rms_m=0.010,
            corrected_rms_m=corrected, in_use=1.0,
        )
        for start, length, corrected in ((100.0, 30.0, 0.004), (200.0, 90.0, 0.012))
    )  # fmt: skip
    found = Outcome(
        trial=TRIALS["S6"], verdicts={"accepted": 1, "rejected": 3, "failed": 0}, accepted_s=99.0, segments=parts
    )
    table = report([found])
    # sqrt((30 * 4^2 + 90 * 12^2) / 120)
    assert "| S6 | B | not learned | 2 | 1 / 3 | 99 s | off | 100 % | 10.00 | 10.58 | 1.058 | 1.200 |" in table
    assert table.endswith("Worst segment with the laser: nan; without: 1.200, asked 1.02: missed.")
    none = msgspec.structs.replace(found, verdicts={"accepted": 0, "rejected": 4, "failed": 0}, accepted_s=nan,
                                   segments=())  # fmt: skip
    assert "| 0 / 4 | – |" in report([none])
