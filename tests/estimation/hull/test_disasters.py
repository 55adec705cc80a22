"""What goes wrong with two IMUs, as a table: each disaster is named by a warning or a state, and survived."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from heaved.estimation.common.rotations import ARCSEC, rotation_vector
from heaved.estimation.hull.estimate import HullEstimate, HullState, HullWarning, Params
from heaved.estimation.hull.estimator import HullDeformation
from heaved.simulate.flexure import SCENES, Record, Scene, simulate

Rates = tuple[np.ndarray, np.ndarray, np.ndarray]
"""t (n,), midships (n, 3), local (n, 3)."""
MIDSHIPS, LOCAL = 1, 2
SCENE = SCENES["A1"]
HIT_S = 60.0
"""Disasters in the course of a record strike here ..."""
CURED_S = 90.0
"""... and end here."""
END_S = 150.0


class Disaster(msgspec.Struct, frozen=True):
    name: str
    mutate: Callable[[Record], Rates]
    warning: HullWarning | None = None
    """Shown while it lasts; it was not there before."""
    state: HullState | None = None
    scene: Scene = SCENE
    cured: bool = True
    """The estimate is right again at the end."""
    passing: bool = False
    """It strikes at 60 s and ends at 90 s; otherwise it is there from the start to the end."""
    params: Params = Params()
    within_arcsec: float = 120.0


def rates(record: Record) -> Rates:
    return record.local_t_s.copy(), record.midships_radps.copy(), record.local_radps.copy()


def to(stream: int, change: Callable[[np.ndarray], None]) -> Callable[[Record], Rates]:
    """``change`` edits the rates of one IMU between HIT_S and CURED_S in place."""

    def mutate(record: Record) -> Rates:
        series = rates(record)
        hit = (series[0] > HIT_S) & (series[0] <= CURED_S)
        struck = series[stream][hit]
        change(struck)
        series[stream][hit] = struck
        return series

    return mutate


def held(values: np.ndarray) -> None:
    values[:] = values[0]


def gone(values: np.ndarray) -> None:
    values[:] = np.nan


def now_and_then_nan(values: np.ndarray) -> None:
    values[::3] = np.nan


def spikes(values: np.ndarray) -> None:
    values[::17] = 1e6


def half_rate(record: Record) -> Rates:
    t, midships, local = rates(record)
    local[1::2] = local[: len(local) - 1 : 2]
    return t, midships, local


def swapped(record: Record) -> Rates:
    t, midships, local = rates(record)
    return t, local, midships


def mirrored(record: Record) -> Rates:
    t, midships, local = rates(record)
    local[:, 1] *= -1.0
    return t, midships, local


def strangers(record: Record) -> Rates:
    """The local IMU is on another ship."""
    other = simulate(msgspec.structs.replace(record.scene, sea="irregular"), seed=99, duration_s=END_S)
    t, midships, _ = rates(record)
    return t, midships, other.local_radps


def turned(record: Record) -> Rates:
    """Somebody takes the local IMU off and puts it back by 20 degrees from where it was."""
    t, midships, local = rates(record)
    C = simulate(msgspec.structs.replace(record.scene, static_deg=(0.5, 0.8, 50.0)), seed=1, duration_s=END_S)
    local[t > HIT_S] = C.local_radps[t > HIT_S]
    return t, midships, local


def gap(record: Record) -> Rates:
    t, midships, local = rates(record)
    stays = (t <= HIT_S) | (t > CURED_S)
    return t[stays], midships[stays], local[stays]


def clock_steps_back(record: Record) -> Rates:
    t, midships, local = rates(record)
    return np.where(t > HIT_S, t - 40.0, t), midships, local


def stamps_out_of_order(record: Record) -> Rates:
    t, midships, local = rates(record)
    t[700], t[701] = t[701], t[700]
    t[800] = np.nan
    t[900] = t[899]
    return t, midships, local


def scene(**changes: object) -> Scene:
    return msgspec.structs.replace(SCENE, **changes)


W, S = HullWarning, HullState
EXPECTED_MOUNT = Params(mount_deg=(0.0, 0.0, 30.0))
DISASTERS = [
    Disaster("IMUs swapped", swapped, W.SWAPPED, params=EXPECTED_MOUNT, cured=False),
    Disaster("mounted otherwise", rates, W.MOUNT, params=Params(mount_deg=(0.0, 0.0, -60.0))),
    Disaster("midships stuck", to(MIDSHIPS, held), W.STUCK_MIDSHIPS, S.HOLDING, passing=True),
    Disaster("local stuck", to(LOCAL, held), W.STUCK_LOCAL, S.HOLDING, passing=True),
    Disaster("local stuck from the start", lambda r: (*rates(r)[:2], 0.0 * r.local_radps), W.STUCK_LOCAL, S.STARTING,
             cured=False),
    Disaster("midships gone", to(MIDSHIPS, gone), W.MISSING_MIDSHIPS, S.HOLDING, passing=True),
    Disaster("local gone", to(LOCAL, gone), W.MISSING_LOCAL, S.HOLDING, passing=True),
    Disaster("every third reading nan", to(LOCAL, now_and_then_nan), W.MISSING_LOCAL,
             passing=True),
    Disaster("spikes of the local IMU", to(LOCAL, spikes), passing=True),
    Disaster("spikes amidships", to(MIDSHIPS, spikes), passing=True),
    Disaster("local at half rate", half_rate, W.LOW_RATE_LOCAL),
    Disaster("50 ms late", rates, W.DELAY, scene=scene(delay_s=0.05)),
    Disaster("50 ms early", rates, W.DELAY, scene=scene(delay_s=-0.05)),
    Disaster("one clock drifts", rates, W.CLOCK_DRIFT, scene=scene(clock_ppm=50.0), within_arcsec=60.0),
    Disaster("no motion", rates, W.WEAK_MOTION, S.WEAK, scene=scene(sea="still"), cured=False),
    Disaster("roll alone", rates, W.SINGLE_AXIS, S.WEAK, scene=scene(amplitudes_deg=(4.0, 0.0, 0.0)), cured=False),
    Disaster("mount at pitch 90", rates, W.GIMBAL, scene=scene(static_deg=(0.5, 90.0, 30.0))),
    Disaster("one axis mirrored", mirrored, W.INCONSISTENT, S.STARTING, cured=False),
    Disaster("local IMU on another ship", strangers, W.INCONSISTENT, S.STARTING, cured=False),
    Disaster("silence of both", gap, None),
    Disaster("clock steps back", clock_steps_back, None),
    Disaster("stamps out of order", stamps_out_of_order, None),
]  # fmt: skip


def through(params: Params, series: Rates) -> list[HullEstimate]:
    estimator = HullDeformation(params)
    return [estimator.step(t, a, b) for t, a, b in zip(series[0].tolist(), *series[1:], strict=True)]


@pytest.mark.parametrize("disaster", DISASTERS, ids=lambda d: d.name)
def test_named_and_survived(disaster: Disaster) -> None:
    record = simulate(disaster.scene, seed=1, duration_s=END_S)
    series = disaster.mutate(record)
    estimates = through(disaster.params, series)
    t = np.array([e.angles.t_s for e in estimates])
    last = estimates[-1]
    if disaster.passing:
        before, while_it_lasts = estimates[int(10 * HIT_S) - 10], estimates[int(10 * CURED_S) - 10]
        if disaster.warning is not None:
            assert disaster.warning not in before.angles.warnings
            assert disaster.warning not in last.angles.warnings
    else:
        while_it_lasts = last
    if disaster.warning is not None:
        assert disaster.warning in while_it_lasts.angles.warnings, while_it_lasts.angles.warnings
    if disaster.state is not None:
        assert while_it_lasts.angles.state is disaster.state
    if disaster.cured:
        error = rotation_vector(record.deformation()[-3].T @ last.local_from_midships) / ARCSEC
        assert last.angles.state is HullState.CONVERGED
        assert np.max(np.abs(error)) < disaster.within_arcsec, error
        assert last.angles.t_s == t[-1]


def test_nothing_of_it_is_named_on_a_good_day() -> None:
    record = simulate(SCENE, seed=1, duration_s=END_S)
    estimates = through(EXPECTED_MOUNT, rates(record))
    assert {w for e in estimates for w in e.angles.warnings} == set()
    assert estimates[-1].angles.resets == 0
