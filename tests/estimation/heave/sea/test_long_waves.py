"""Waves that the model does not know. Oracle: what the steady filter, run sample by sample, makes of them."""

from __future__ import annotations

import numpy as np
import pytest
from seas import model

from heaved.estimation.heave.sea.drift import DriftDetector
from heaved.estimation.heave.sea.filter import SeaFilter
from heaved.estimation.heave.sea.long_waves import LongWaves
from heaved.estimation.heave.sea.model import SeaSystem, Steady, heave_std

DT_S = 0.05
Array = np.ndarray


@pytest.fixture(scope="module")
def steady() -> tuple[SeaSystem, Steady]:
    system = SeaSystem(model())
    found = system.steady(DT_S)
    assert found is not None
    return system, found


def filtered(system: SeaSystem, steady: Steady, a: Array) -> tuple[Array, Array]:
    """Innovations over their deviation, and heave, of the steady filter that is fed with ``a``."""
    f = SeaFilter(system, steady, -DT_S, np.zeros(len(system.H)), None)
    rows = []
    for i, value in enumerate(a.tolist()):
        f.step(i * DT_S, value)
        rows.append((f.innovation / np.sqrt(steady.S), float(system.heave @ f.x)))
    innovation, heave_m = np.array(rows).T
    return innovation, heave_m


@pytest.mark.parametrize("period_s", [10.0, 14.0, 18.0])
def test_what_a_swell_makes_of_the_heave_is_known(steady: tuple[SeaSystem, Steady], period_s: float) -> None:
    system, of = steady
    waves, t, w = LongWaves(system, of), DT_S * np.arange(4_000), 2.0 * np.pi / period_s
    unit = np.sin(w * t)
    innovation, heave_m = filtered(system, of, -(w**2) * unit)
    off_m = np.sqrt(np.mean((heave_m - unit)[-2_000:] ** 2))
    # As high as makes an error of several deviations of the model's.
    size = 8.0 * np.sqrt(system.heave @ (of.P - np.outer(of.K, of.K) * of.S) @ system.heave) / off_m
    noise = np.random.default_rng(5).standard_normal(waves.count)
    found_m, excess = waves.look(size * innovation[-waves.count :] + noise)
    assert 0.6 * size * off_m < found_m < 3.0 * size * off_m
    assert excess > 2.0


def test_white_innovations_show_next_to_none(steady: tuple[SeaSystem, Steady]) -> None:
    system, of = steady
    waves, rng = LongWaves(system, of), np.random.default_rng(6)
    found_m = [waves.look(rng.standard_normal(waves.count))[0] for _ in range(300)]
    std_m = np.sqrt(system.heave @ (of.P - np.outer(of.K, of.K) * of.S) @ system.heave)
    assert np.sqrt(np.mean(np.square(found_m))) < 0.6 * std_m
    assert np.median(found_m) == 0.0


def test_a_swell_that_arrives_is_no_drift(steady: tuple[SeaSystem, Steady]) -> None:
    """Without what is known of long waves it is one for half a minute."""
    system, of = steady
    t, w = DT_S * np.arange(4_800), 2.0 * np.pi / 16.0
    heave_m = 0.4 * heave_std(model()) * np.exp((t - t[-1]) / 30.0) * np.sin(w * t)
    innovation, _ = filtered(system, of, np.gradient(np.gradient(heave_m, DT_S), DT_S))
    innovation += np.random.default_rng(7).standard_normal(len(t))
    detector = DriftDetector(system, of)
    for i, one in enumerate(innovation.tolist()):
        detector.push(one)
        assert not detector.look(i * DT_S), i * DT_S
    assert detector.doubt_m > 0.0
