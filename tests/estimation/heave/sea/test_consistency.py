"""What the sea observer says against itself, as a table."""

from __future__ import annotations

import pytest

from heaved.estimation.heave.sea.consistency import FACTOR_LIMIT, SeaTrust
from heaved.samples import DelayedHeave, SeaState

GAP, CHANGING = "recovering from a gap", "the sea or the sensor is changing"


def swell(peak_period_s: float, *, is_still: bool = False) -> SeaState:
    return SeaState(
        significant_height_m=2.0,
        peak_period_s=peak_period_s,
        mean_period_s=10.0,
        systems=(),
        frequencies_hz=(),
        spectrum_m2phz=(),
        is_still=is_still,
    )


DOUBTS = {
    "well": (1.0, 1.0, False, swell(10.0), 100.0, ()),
    "recovering, and long enough under way": (1.0, 1.0, True, None, 60.1, (GAP,)),
    "recovering, as at every start": (1.0, 1.0, True, None, 60.0, ()),
    "innovations at the fit": (3.1, 1.0, False, None, 100.0, (CHANGING,)),
    "innovations since, a little": (1.0, 8.9, False, None, 100.0, ()),
    "innovations since": (1.0, 9.1, True, None, 100.0, (GAP, CHANGING)),
    "swell": (1.0, 1.0, False, swell(30.0), 100.0, ("swell of 30 s: longer than the sensor can follow",)),
    "swell of a ship that is still": (1.0, 1.0, False, swell(30.0, is_still=True), 100.0, ()),
}


@pytest.mark.parametrize("name", DOUBTS)
def test_doubts(name: str) -> None:
    whiteness, surprise, is_recovering, sea, settled_s, expected = DOUBTS[name]
    trust = SeaTrust(100)
    trust.fitted(whiteness, 1e3, 0.01, 1.0, 50.0)
    trust.beat(surprise, is_recovering, sea)
    assert trust.doubts(settled_s) == expected
    assert trust.is_changing == (max(whiteness, surprise) > 3.0)


def test_what_no_fit_explains_is_no_change() -> None:
    """One look that is far off may be a sea that has just come; after a second one more of them help nothing."""
    trust = SeaTrust(100)
    seen = []
    for whiteness in (1.0, 300.0, 40.0, 25.0, 300.0, 300.0):
        trust.fitted(whiteness, 1e3, 0.01, 1.0, 50.0)
        trust.beat(1.0, False, None)
        assert (trust.doubts(100.0) == (CHANGING,)) == (whiteness > 3.0)
        seen.append(trust.is_changing)
    assert seen == [False, True, False, True, True, False]


@pytest.mark.parametrize(("surprise", "factor"), [(0.5, 1.0), (2.0, 1.0), (8.0, 2.0), (18.0, 3.0), (1e4, FACTOR_LIMIT)])
def test_errors_grow_with_the_innovations(surprise: float, factor: float) -> None:
    trust = SeaTrust(100)
    trust.beat(surprise, False, None)
    assert trust.factor == pytest.approx(factor)


def test_what_was_said_is_held_against_what_is_known_later() -> None:
    """A heave that is 3.5 standard deviations off all the time."""
    trust = SeaTrust(2000)
    error_m, std_m = 0.07, 0.02
    for k in range(1, 1201):
        trust.divergence.say(0.05 * k, error_m, std_m)
        if k > 100:
            trust.divergence.check(DelayedHeave(t_s=0.05 * (k - 100), heave_m=0.0, std_m=0.001))
    trust.beat(1.0, False, None)
    assert trust.factor == pytest.approx(error_m / std_m, rel=0.01)
    assert trust.doubts(100.0) == (f"{error_m / std_m:.1f} times its standard deviation off the delayed heave",)


@pytest.mark.parametrize(("waves", "error_m", "is_still"), [(1e3, 0.1, False), (14.0, 0.1, True), (1e3, 0.6, True)])
def test_a_ship_is_still_when_waves_explain_nothing(waves: float, error_m: float, is_still: bool) -> None:
    trust = SeaTrust(100)
    trust.fitted(1.0, waves, error_m, 1.0, 50.0)
    assert trust.is_still == is_still
    assert bool(trust.notes) == is_still


@pytest.mark.parametrize(("waves_seen", "factor"), [(2.0, 16.0), (4.0, 4.0), (8.0, 1.0), (50.0, 1.0)])
def test_a_spectrum_of_few_waves_is_a_coarse_one(waves_seen: float, factor: float) -> None:
    trust = SeaTrust(100)
    assert not trust.is_model_known
    trust.fitted(1.0, 1e3, 0.01, 1.0, waves_seen)
    trust.beat(1.0, False, None)
    assert trust.factor == pytest.approx(factor)
    assert trust.is_model_known == (factor < 1.8)
