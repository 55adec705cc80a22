"""A model on trial against seas drawn from models: its own, higher and lower ones, and another period."""

from __future__ import annotations

from math import nan, sqrt

import msgspec
import numpy as np
import pytest
from seas import model, simulated

from heaved.estimation.heave.sea.filter import SeaFilter
from heaved.estimation.heave.sea.model import SeaModel, SeaSystem
from heaved.estimation.heave.sea.trial import DOUBT, MOST_DOUBT, TOLD_S, Trial

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
        trial.take(k * DT_S, a[k], f.innovation / sqrt(f.innovation_variance))
        assert trial.is_told == (k * DT_S >= TOLD_S)
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
        assert trial.factor >= DOUBT
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
    ("age_s", "doubt"), [(0.0, DOUBT), (3600.0, DOUBT + 0.5), (1e6, MOST_DOUBT), (nan, MOST_DOUBT)]
)
def test_an_old_model_is_doubted_more(age_s: float, doubt: float) -> None:
    assert Trial(SeaSystem(model()), age_s).factor == pytest.approx(doubt)
