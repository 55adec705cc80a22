"""What a restart remembers of the hull: as good as if the program had never stopped, and no lie where an IMU was moved.

The truth is that of the simulation; a restart is another estimator that is given the rest of the record.
"""

from __future__ import annotations

from math import radians

import msgspec
import numpy as np
import pytest

from heaved.estimation.common.rotations import ARCSEC, passive, rotation_vector
from heaved.estimation.heave import saved_state
from heaved.estimation.heave.saved_state import SavedState
from heaved.estimation.hull.estimate import HullState, Method, Params, ResetReason
from heaved.estimation.hull.estimator import HullDeformation
from heaved.estimation.hull.remembered import SavedHull
from heaved.simulate.flexure import SCENES, Record, simulate

PARAMS = Params(refit_after_s=90.0)
STOPPED_S, AWAY_S, END_S = 100.0, 60.0, 200.0
AXIS = np.array([0.0, 0.6, 0.8])


class Seen(msgspec.Struct, frozen=True, eq=False):
    """Of every estimate that is known."""

    since_s: np.ndarray
    error_rad: np.ndarray
    std_rad: np.ndarray

    def worst_rad(self, from_s: float) -> float:
        return float(np.max(np.abs(self.error_rad[self.since_s >= from_s])))

    def worst_in_std(self) -> float:
        return float(np.max(np.abs(self.error_rad) / self.std_rad))


def go(estimator: HullDeformation, record: Record, from_s: float, to_s: float) -> Seen:
    truth, rows = record.deformation(), []
    for row in np.flatnonzero((record.midships_t_s >= from_s) & (record.midships_t_s < to_s)).tolist():
        found = estimator.step(float(record.midships_t_s[row]), record.midships_radps[row], record.local_radps[row])
        if np.isfinite(found.angles.std_rad).all():
            at = truth[round(10.0 * found.angles.t_s) - 1]
            error = rotation_vector(at.T @ found.local_from_midships)
            rows.append((found.angles.t_s - from_s, *error, *found.angles.std_rad))
    values = np.array(rows)
    return Seen(values[:, 0], values[:, 1:4], values[:, 4:])


class Ship(msgspec.Struct, frozen=True, eq=False):
    record: Record
    saved: SavedHull
    never_stopped: Seen
    cold: Seen


@pytest.fixture(scope="module", params=[("A1", 4), ("A4", 1)], ids=lambda p: p[0])
def ship(request: pytest.FixtureRequest) -> Ship:
    scene, seed = request.param
    record = simulate(SCENES[scene], seed, duration_s=END_S)
    never, cold = HullDeformation(PARAMS), HullDeformation(PARAMS)
    go(never, record, 0.0, STOPPED_S)
    saved = never.saved()
    assert saved is not None
    assert saved.flexure is not None
    # Through the file.
    text = msgspec.json.encode(SavedState(hull=saved))
    state = msgspec.json.decode(text, type=SavedState)
    saved_state.check(state)
    assert state.hull is not None
    assert state.hull == saved
    return Ship(record, state.hull, go(never, record, STOPPED_S, END_S), go(cold, record, STOPPED_S, END_S))


def turned(saved: SavedHull, by_deg: float) -> SavedHull:
    """As another mounting would have been remembered."""
    C = passive(np.array(saved.rotation_rad)) @ passive(AXIS * radians(by_deg))
    return msgspec.structs.replace(saved, rotation_rad=tuple(rotation_vector(C).tolist()))


def test_a_restart_goes_on_as_if_it_had_never_stopped(ship: Ship) -> None:
    """From the first alignment on: where a cold start is minutes of arc off, within arcseconds of one that went on."""
    estimator = HullDeformation(PARAMS)
    estimator.restore(ship.saved, AWAY_S)
    warm = go(estimator, ship.record, STOPPED_S, END_S)
    assert warm.worst_in_std() < 4.0
    assert warm.worst_rad(5.0) < ship.never_stopped.worst_rad(5.0) + 8.0 * ARCSEC
    assert warm.worst_rad(5.0) < 0.5 * ship.cold.worst_rad(5.0)
    assert not estimator.resets
    # What is not known shrinks faster, too.
    at_40 = [np.max(seen.std_rad[seen.since_s >= 40.0][0]) for seen in (warm, ship.cold)]
    assert at_40[0] < 0.85 * at_40[1]


@pytest.mark.parametrize("by_deg", [0.02, 0.1, 1.0, 90.0])
def test_another_mounting_is_never_lied_about_and_found_out(ship: Ship, by_deg: float) -> None:
    estimator = HullDeformation(PARAMS)
    estimator.restore(turned(ship.saved, by_deg), AWAY_S)
    seen = go(estimator, ship.record, STOPPED_S, END_S)
    assert seen.worst_in_std() < 4.0
    if by_deg >= 0.1:
        assert estimator.resets == {ResetReason.REMEMBERED: 1}
        # What goes on is the cold start, to the bit.
        assert np.array_equal(seen.error_rad[-600:], ship.cold.error_rad[-600:])
        assert np.array_equal(seen.std_rad[-600:], ship.cold.std_rad[-600:])


def test_it_is_confirmed_in_the_end_and_goes_on_honestly() -> None:
    """Of a record of seven minutes, so that the cold start has come as far."""
    record, params = simulate(SCENES["A1"], 2, duration_s=420.0), Params(refit_after_s=60.0)
    first = HullDeformation(params)
    go(first, record, 0.0, 70.0)
    saved = first.saved()
    assert saved is not None
    second = HullDeformation(params)
    second.restore(saved, 600.0)
    seen = go(second, record, 70.0, 420.0)
    now = second.saved()
    assert now is not None
    assert now.unconfirmed_s == 0.0
    assert not second.resets
    assert second.latest is not None
    assert second.latest.angles.state is HullState.CONVERGED
    assert seen.worst_in_std() < 4.0


def test_until_it_is_confirmed_it_is_saved_again_as_it_was(ship: Ship) -> None:
    """With its age: a row of short runs makes nothing surer."""
    estimator = HullDeformation(PARAMS)
    estimator.restore(ship.saved, AWAY_S)
    assert estimator.saved() == msgspec.structs.replace(ship.saved, unconfirmed_s=AWAY_S)
    go(estimator, ship.record, STOPPED_S, STOPPED_S + 10.0)
    found = estimator.saved()
    assert found is not None
    assert found.unconfirmed_s == pytest.approx(AWAY_S + 9.9)
    assert msgspec.structs.replace(found, unconfirmed_s=0.0) == ship.saved


@pytest.mark.parametrize("age_s", [3601.0, float("nan"), float("inf")])
def test_what_is_too_old_is_not_taken(ship: Ship, age_s: float) -> None:
    estimator = HullDeformation(PARAMS)
    estimator.restore(ship.saved, age_s)
    assert estimator.saved() is None


def test_nor_what_was_not_confirmed_for_too_long_nor_by_another_method_nor_once_readings_came(ship: Ship) -> None:
    old = HullDeformation(PARAMS)
    old.restore(msgspec.structs.replace(ship.saved, unconfirmed_s=3590.0), AWAY_S)
    assert old.saved() is None
    other = HullDeformation(Params(method=Method.CKF))
    other.restore(ship.saved, AWAY_S)
    go(other, ship.record, 0.0, 10.0)
    assert other.saved() is None
    late = HullDeformation(PARAMS)
    late.step(0.1, np.zeros(3), np.zeros(3))
    late.restore(ship.saved, AWAY_S)
    assert late.saved() is None


def test_age_widens_what_is_known(ship: Ship) -> None:
    """20 arcsec per root hour, in the deviations of the first estimate of one IMU pair that agrees."""
    spreads = []
    for age_s in (0.0, 3000.0):
        estimator = HullDeformation(PARAMS)
        estimator.restore(ship.saved, age_s)
        go(estimator, ship.record, STOPPED_S, STOPPED_S + 8.0)
        assert estimator._trial is not None
        spreads.append(np.diag(estimator._trial.filter.P)[:3])
    assert np.all(spreads[1] < spreads[0] + (20.0 * ARCSEC) ** 2 * 3000.0 / 3600.0)
    assert np.all(np.sqrt(spreads[1]) > 10.0 * ARCSEC)
    assert np.all(spreads[1] > spreads[0])


def test_a_sea_that_shows_nothing_neither_confirms_nor_refutes_it(ship: Ship) -> None:
    """At rest nothing is published from it: it is kept."""
    estimator = HullDeformation(PARAMS)
    estimator.restore(ship.saved, AWAY_S)
    still = simulate(SCENES["A1"], 4, duration_s=30.0)
    for t_s in still.midships_t_s.tolist():
        found = estimator.step(t_s, np.zeros(3), np.zeros(3))
    assert not np.isfinite(found.angles.std_rad).any()
    kept = estimator.saved()
    assert kept is not None
    assert kept.unconfirmed_s == pytest.approx(AWAY_S + 29.9)
