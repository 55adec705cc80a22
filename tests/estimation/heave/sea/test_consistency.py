"""What the sea observer says against itself, as a table."""

from __future__ import annotations

from math import nan, sqrt

import msgspec
import numpy as np
import pytest
from seas import model, simulated

from heaved.estimation.heave.sea.consistency import TUNING, Consistency, Divergence, Trial
from heaved.estimation.heave.sea.filter import SeaFilter
from heaved.estimation.heave.sea.model import SeaModel, SeaSystem
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
    consistency = Consistency(100)
    consistency.fitted(whiteness, 1e3, 0.01, 1.0, 50.0)
    consistency.step(surprise, is_recovering, sea)
    assert consistency.doubts(settled_s) == expected
    assert consistency.is_changing == (max(whiteness, surprise) > 3.0)


def test_what_no_fit_explains_is_no_change() -> None:
    """One look that is far off may be a sea that has just come; after a second one more of them help nothing."""
    consistency = Consistency(100)
    seen = []
    for whiteness in (1.0, 300.0, 40.0, 25.0, 300.0, 300.0):
        consistency.fitted(whiteness, 1e3, 0.01, 1.0, 50.0)
        consistency.step(1.0, False, None)
        assert (consistency.doubts(100.0) == (CHANGING,)) == (whiteness > 3.0)
        seen.append(consistency.is_changing)
    assert seen == [False, True, False, True, True, False]


@pytest.mark.parametrize(
    ("surprise", "factor"), [(0.5, 1.0), (2.0, 1.0), (8.0, 2.0), (18.0, 3.0), (1e4, TUNING.factor_limit)]
)
def test_errors_grow_with_the_innovations(surprise: float, factor: float) -> None:
    consistency = Consistency(100)
    consistency.step(surprise, False, None)
    assert consistency.factor == pytest.approx(factor)


def test_what_was_said_is_held_against_what_is_known_later() -> None:
    """A heave that is 3.5 standard deviations off all the time."""
    consistency = Consistency(2000)
    error_m, std_m = 0.07, 0.02
    for k in range(1, 1201):
        consistency.divergence.say(0.05 * k, error_m, std_m)
        if k > 100:
            consistency.divergence.check(DelayedHeave(t_s=0.05 * (k - 100), heave_m=0.0, std_m=0.001))
    consistency.step(1.0, False, None)
    assert consistency.factor == pytest.approx(error_m / std_m, rel=0.01)
    assert consistency.doubts(100.0) == (f"{error_m / std_m:.1f} times its standard deviation off the delayed heave",)


@pytest.mark.parametrize(("waves", "error_m", "is_still"), [(1e3, 0.1, False), (14.0, 0.1, True), (1e3, 0.6, True)])
def test_a_ship_is_still_when_waves_explain_nothing(waves: float, error_m: float, is_still: bool) -> None:
    consistency = Consistency(100)
    consistency.fitted(1.0, waves, error_m, 1.0, 50.0)
    assert consistency.is_still == is_still
    assert bool(consistency.notes) == is_still


@pytest.mark.parametrize(("waves_seen", "factor"), [(2.0, 16.0), (4.0, 4.0), (8.0, 1.0), (50.0, 1.0)])
def test_a_spectrum_of_few_waves_is_a_coarse_one(waves_seen: float, factor: float) -> None:
    consistency = Consistency(100)
    assert not consistency.is_model_known
    consistency.fitted(1.0, 1e3, 0.01, 1.0, waves_seen)
    consistency.step(1.0, False, None)
    assert consistency.factor == pytest.approx(factor)
    assert consistency.is_model_known == (factor < 1.8)


def test_divergence_is_the_rms_over_the_modelled_error() -> None:
    rng = np.random.default_rng(7)
    check = Divergence()
    for k in range(3000):
        t = 0.05 * k
        check.compare(DelayedHeave(t_s=t, heave_m=0.0, std_m=0.001), float(0.03 * rng.standard_normal()), 0.01)
        assert check.ratio == 1.0 or t >= TUNING.check_min_s - 0.1
    assert check.ratio == pytest.approx(3.0, rel=0.1)
    for value in (nan, 0.0):
        check.compare(DelayedHeave(t_s=200.0, heave_m=0.0, std_m=0.001), value, value)
    assert check.ratio == pytest.approx(3.0, rel=0.1)


# --- a model on trial ------------------------------------------------------------------------------------------------

DT_S = 0.05


def tried(of: SeaModel, sea: SeaModel, seed: int) -> tuple[Trial, list[float]]:
    """The trial after 30 s, and |error| over what is published, from when something is."""
    system = SeaSystem(of)
    steady = system.steady(DT_S)
    assert steady is not None
    truth, a = simulated(SeaSystem(sea), DT_S, 600, seed)
    heave = truth @ SeaSystem(sea).heave
    f = SeaFilter(system, steady, -DT_S, np.zeros(len(system.H)), system.stationary.copy())
    trial, errors = Trial(system, 0.0), []
    for k in range(600):
        f.step(k * DT_S, a[k])
        trial.step(k * DT_S, a[k], f.innovation / sqrt(f.innovation_variance))
        assert trial.is_told == (k * DT_S >= TUNING.told_s)
        if trial.is_another:
            break
        if trial.is_told:
            std_m = trial.factor * sqrt(system.heave @ f.covariance @ system.heave)
            errors.append(abs(float(system.heave @ f.x) - heave[k]) / std_m)
    return trial, errors


def scaled(height: float) -> SeaModel:
    return msgspec.structs.replace(model(), level_m2phz=tuple([height**2 * level for level in model().level_m2phz]))


@pytest.mark.parametrize("height", [0.5, 1.0, 1.5])
def test_a_sea_that_is_nearly_the_same_serves_and_is_as_good_as_it_says(height: float) -> None:
    served = 0
    for seed in range(6):
        trial, errors = tried(model(), scaled(height), seed)
        served += not trial.is_another
        assert trial.factor >= TUNING.doubt
        assert max(errors, default=0.0) < 4.0
    assert served >= 5


def test_a_sea_many_times_as_high_is_another() -> None:
    """Or it takes some seconds more to tell, and is no lie until then."""
    refused = 0
    for seed in range(6):
        trial, errors = tried(model(), scaled(5.0), seed)
        refused += trial.is_another
        assert max(errors, default=0.0) < 4.5
    assert refused >= 5


@pytest.mark.parametrize(
    ("age_s", "doubt"),
    [(0.0, TUNING.doubt), (3600.0, TUNING.doubt + 0.5), (1e6, TUNING.most_doubt), (nan, TUNING.most_doubt)],
)
def test_an_old_model_is_doubted_more(age_s: float, doubt: float) -> None:
    assert Trial(SeaSystem(model()), age_s).factor == pytest.approx(doubt)
